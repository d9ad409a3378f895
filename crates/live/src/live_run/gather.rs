//! What several commands ask for, gathered into one change that motors and board can follow.

use std::sync::Arc;

use pulsetrain_board::{Leased, Observer};
use pulsetrain_motion::file::MOST_OF_A_MOTION_FILE;
use pulsetrain_motion::program::Program;
use pulsetrain_motion::{Time, human};
use pulsetrain_session::control::{Command, Ended};
use pulsetrain_session::drive::DriveError;
use pulsetrain_session::fade::Change;

use super::nearest::Nearest;
use super::{Caller, LiveRun, THE_MOTION, change_to, is_set_again, refusal};
use crate::command::{KnobValue, RunCommand};
use crate::event::RunEvent;
use crate::setpoints::{ChangeRefusal, FileTexts, KnobMove, LiveSetpoints, NoMotion};

/// If the reader refuses a larger value of a knob, this one is looked at in its place: it is farther than any motor goes.
const MAX_KNOB_VALUE: f64 = 1e9;
/// Motions that begin at a cue begin this long after it, s: the transition has reached the board by then.
const CUE_LEAD_S: f64 = 0.1;

impl<B: Leased> LiveRun<B> {
    /// What is asked, as one change. With `search` each part is held against the limits: knobs go to the nearest value that keeps to them while the
    /// motion goes on, and cues and files are refused.
    pub(crate) fn gather<O: Observer>(
        &mut self,
        commands: &[RunCommand],
        at: Option<u64>,
        mut search: Option<&mut Caller<'_, O>>,
    ) -> Result<(Gathered, Option<Interruption>), DriveError> {
        let mut gathered = Gathered {
            setpoints: self.setpoints.clone(),
            place: None,
            is_parked: self.state.is_parked(),
            is_moving: false,
            over: None,
            answers: Vec::new(),
            refusals: Vec::new(),
            tempo: None,
            commands: Vec::new(),
            follow: None,
        };
        for command in commands {
            match command {
                RunCommand::Set { knob, value } => {
                    let search = search.as_deref_mut();
                    let interruption = self.gather_knob(&mut gathered, command, (knob, value), search)?;
                    if interruption.is_some() {
                        return Ok((gathered, interruption));
                    }
                }
                RunCommand::Goto { .. } | RunCommand::Rest { .. } => gather_place(&mut gathered, command.clone()),
                RunCommand::Motion { text, files } => self.gather_file(&mut gathered, text, files, search.is_some()),
                // Done before.
                RunCommand::Begin | RunCommand::Here { .. } => {}
                RunCommand::Go | RunCommand::Back | RunCommand::Cue { .. } => {
                    self.gather_cue(&mut gathered, command.clone(), at, search.is_some());
                }
                RunCommand::Resume if gathered.is_parked && !self.state.is_paused() => {
                    let command = RunCommand::Goto { position: THE_MOTION.to_owned() };
                    gathered.changes(None, (command, RunEvent::Returned { from_s: 0.0, until_s: 0.0 }));
                }
                RunCommand::Tempo { rate } => gathered.tempo = Some(*rate),
                RunCommand::Pause | RunCommand::Resume | RunCommand::Stop | RunCommand::StopNow => {
                    gathered.commands.extend(command.of_session());
                }
            }
        }
        Ok((gathered, None))
    }

    /// Turns a knob: to the nearest value that the motors follow.
    fn gather_knob<O: Observer>(
        &mut self,
        gathered: &mut Gathered,
        command: &RunCommand,
        (knob, value): (&str, &KnobValue),
        search: Option<&mut Caller<'_, O>>,
    ) -> Result<Option<Interruption>, DriveError> {
        let refuse = |gathered: &mut Gathered, why: &dyn std::fmt::Display| {
            gathered.refusals.push(refusal(command.clone(), &why.to_string()));
        };
        let knob_move = match gathered.setpoints.knob_move(knob, value) {
            Ok(knob_move) => knob_move,
            Err(error) => {
                refuse(gathered, &error);
                return Ok(None);
            }
        };
        let (mut set, mut ceiling) = (knob_move.to, knob_move.range.clone());
        let mut setpoints = gathered.setpoints.with_knob(&knob_move, set);
        if let Some(caller) = search {
            match self.ceiling_of_turn(&gathered.setpoints, &knob_move) {
                Ok(None) => {}
                Ok(Some((to, limit))) => {
                    let nearest = Nearest::new(knob_move.from, to);
                    let found = match self.nearest(&gathered.setpoints, &knob_move, (nearest, limit), caller)? {
                        Ok(found) => found,
                        Err(interruption) => return Ok(Some(interruption)),
                    };
                    set = found.0;
                    setpoints = gathered.setpoints.with_knob(&knob_move, set);
                    // Limits may have changed since the motors began to follow the present value.
                    if set == knob_move.from && !matches!(self.allowed(&setpoints, knob_move.over), Ok(None)) {
                        let (from, to, limit) = (knob_move.from, knob_move.to, found.1);
                        let why = format!("{limit}: no value between {from} and {to} {} keeps to it", knob_move.unit);
                        refuse(gathered, &why.trim_end());
                        return Ok(None);
                    }
                    ceiling = Some(found.1);
                }
                Err(error) => {
                    refuse(gathered, &error);
                    return Ok(None);
                }
            }
        }
        gathered.setpoints = setpoints;
        let event = RunEvent::Set {
            knob: knob.to_owned(),
            value: set,
            unit: knob_move.unit,
            ceiling,
            from_s: 0.0,
            until_s: 0.0,
        };
        gathered.adds(knob_move.over, (command.clone(), event));
        Ok(None)
    }

    /// The limit that the wanted value of a knob would break, and that value; `None` if the motors follow it. Of a value that the reader refuses for its
    /// size, a smaller one is looked at.
    #[allow(clippy::type_complexity)]
    fn ceiling_of_turn(
        &self,
        setpoints: &LiveSetpoints,
        knob_move: &KnobMove,
    ) -> Result<Option<(f64, String)>, Box<dyn std::error::Error>> {
        let look = |value: f64| {
            Ok(self.allowed(&setpoints.with_knob(knob_move, value), knob_move.over)?.map(|limit| (value, limit)))
        };
        let smaller = knob_move.to.clamp(-MAX_KNOB_VALUE, MAX_KNOB_VALUE);
        match look(knob_move.to) {
            Err(error) if smaller != knob_move.to => match look(smaller) {
                Ok(Some(broken)) => Ok(Some(broken)),
                _ => Err(error),
            },
            looked => looked,
        }
    }

    /// The value of a knob nearest to the wanted one that the motors follow, and the limit that the next one would break; `limit` is the wanted one's.
    /// The motion goes on during the search, and may end. A stop ends the search.
    fn nearest<O: Observer>(
        &mut self,
        setpoints: &LiveSetpoints,
        knob_move: &KnobMove,
        (mut nearest, mut limit): (Nearest, String),
        caller: &mut Caller<'_, O>,
    ) -> Result<Result<(f64, String), Interruption>, DriveError> {
        let step = setpoints.step_in_unit(knob_move);
        while let Some(mut value) = nearest.next() {
            if (caller.stop_waits)(self.driven.now()) {
                return Ok(Err(Interruption::StopWaits));
            }
            if let Some(ended) = self.pass(caller.observer, caller.publish)? {
                return Ok(Err(Interruption::Ended(ended)));
            }
            if knob_move.is_whole {
                let Some(whole) = nearest.whole(value, 1.0) else { break };
                value = whole;
            }
            let mut looked = self.allowed(&setpoints.with_knob(knob_move, value), knob_move.over);
            // The reader may refuse what lies between, such as a swing of half a step.
            if let (Err(_), Some(step)) = (&looked, step) {
                let Some(whole) = nearest.whole(value, step) else { break };
                value = whole;
                looked = self.allowed(&setpoints.with_knob(knob_move, value), knob_move.over);
            }
            nearest.note(value, matches!(looked, Ok(None)));
            if let Ok(Some(broken)) = looked {
                limit = broken;
            }
        }
        Ok(Ok((nearest.found(), limit)))
    }

    /// Goes to a cue.
    fn gather_cue(&self, gathered: &mut Gathered, command: RunCommand, at: Option<u64>, is_checked: bool) {
        let begins = match at {
            Some(at) => self.driven.law_time_at(at),
            None => self.driven.law_time() + Time::from_seconds(CUE_LEAD_S),
        };
        let found = match &command {
            RunCommand::Cue { name } => gathered.setpoints.at_cue(name, begins),
            RunCommand::Back => gathered.setpoints.at_other_cue(false, begins),
            _ => gathered.setpoints.at_other_cue(true, begins),
        };
        let (setpoints, cue) = match found {
            Ok(found) => found,
            Err(error) => return gathered.refusals.push(refusal(command, &error)),
        };
        if is_checked {
            let why = match self.allowed(&setpoints, cue.fade) {
                Ok(None) => None,
                Ok(Some(limit)) => Some(format!("cue \"{}\" would break a limit: {limit}", cue.name)),
                Err(error) => Some(error.to_string()),
            };
            if let Some(why) = why {
                return gathered.refusals.push(refusal(command, &why));
            }
        }
        gathered.follow = Some(cue.follow.filter(|_| setpoints.has_cue_after(&cue)));
        gathered.setpoints = setpoints;
        gathered.changes(cue.fade, (command, RunEvent::Cue { name: cue.name, from_s: 0.0, until_s: 0.0 }));
    }

    fn gather_file(&self, gathered: &mut Gathered, text: &str, files: &FileTexts, is_checked: bool) {
        let setpoints = match with_file(&gathered.setpoints, text, files) {
            Ok(None) => return,
            Ok(Some(setpoints)) => setpoints,
            Err(refused) => return gathered.refusals.push(refused),
        };
        if is_checked {
            let why = match self.allowed(&setpoints, None) {
                Ok(None) => None,
                Ok(Some(limit)) => Some(format!("the motion would break a limit: {limit}")),
                Err(error) => Some(error.to_string()),
            };
            if let Some(error) = why {
                let refused = RunEvent::MotionRefused { error, line: None, column: None };
                return gathered.refusals.push(refused);
            }
        }
        gathered.setpoints = setpoints;
        let command = RunCommand::Motion { text: String::new(), files: FileTexts::new() };
        gathered.adds(None, (command, RunEvent::Motion { from_s: 0.0, until_s: 0.0 }));
    }

    /// The limit that the motors would break at setpoints, or why the reader refuses it.
    fn allowed(
        &self,
        setpoints: &LiveSetpoints,
        over: Option<Time>,
    ) -> Result<Option<String>, Box<dyn std::error::Error>> {
        self.ceiling_of(&change_to(setpoints.program()?, over))
    }

    /// The limit that a change would break, or why it cannot be looked for.
    fn ceiling_of(&self, change: &Change) -> Result<Option<String>, Box<dyn std::error::Error>> {
        Ok(self.driven.ceiling_of(change).map_err(|error| self.driven.why(error))?)
    }

    /// The program that the motors follow if they do all that is asked; `None` if they go on as they are. Or the limit that they would break, or why
    /// the reader refuses it.
    #[allow(clippy::type_complexity)]
    pub(crate) fn verdict(
        &self,
        gathered: &Gathered,
    ) -> Result<Result<Option<Arc<Program>>, String>, Box<dyn std::error::Error>> {
        let program = gathered.program()?;
        // Motors that rest at a position, and those that come back from it, break nothing.
        let is_goto = |(command, _): &(RunCommand, RunEvent)| {
            matches!(command, RunCommand::Goto { .. } | RunCommand::Rest { .. })
        };
        if gathered.answers.iter().all(is_goto) {
            return Ok(Ok(program));
        }
        let ceiling = match (&program, &gathered.place) {
            (Some(program), None) => self.ceiling_of(&change_to(Arc::clone(program), gathered.over))?,
            _ => self.allowed(&gathered.setpoints, gathered.over)?,
        };
        Ok(ceiling.map_or(Ok(program), Err))
    }
}

/// Why the search for a knob's nearest value was given up.
pub(crate) enum Interruption {
    /// The motion has ended.
    Ended(Ended),
    /// A stop waits to be obeyed.
    StopWaits,
}

/// What commands ask for, as one change.
pub(crate) struct Gathered {
    /// The motion as it is wanted then.
    pub(crate) setpoints: LiveSetpoints,
    /// The motors at rest at a position, if the last of the requests is that.
    pub(crate) place: Option<Arc<Program>>,
    pub(crate) is_parked: bool,
    /// Whether the motors change to other laws.
    pub(crate) is_moving: bool,
    pub(crate) over: Option<Time>,
    pub(crate) answers: Vec<(RunCommand, RunEvent)>,
    pub(crate) refusals: Vec<RunEvent>,
    pub(crate) tempo: Option<f64>,
    /// What the session does besides.
    pub(crate) commands: Vec<Command>,
    /// The time until the next cue, if a cue or a position changes it.
    pub(crate) follow: Option<Option<Time>>,
}

impl Gathered {
    /// Adds what the motors change to, wherever they are.
    fn changes(&mut self, over: Option<Time>, answer: (RunCommand, RunEvent)) {
        (self.place, self.is_parked) = (None, false);
        self.adds(over, answer);
    }

    /// The program that the motors follow then; `None` if that does not change.
    pub(crate) fn program(&self) -> Result<Option<Arc<Program>>, ChangeRefusal> {
        match &self.place {
            Some(program) => Ok(Some(Arc::clone(program))),
            None if self.answers.is_empty() => Ok(None),
            None => self.setpoints.program().map(Some),
        }
    }

    /// Adds a value. Motors that were sent to a position stay there: it counts when they come back.
    fn adds(&mut self, over: Option<Time>, answer: (RunCommand, RunEvent)) {
        self.is_moving |= !self.is_parked;
        self.over = self.over.max(over);
        self.answers.retain(|(command, _)| !is_set_again(command, std::slice::from_ref(&answer)));
        self.answers.push(answer);
    }
}

/// Brings the motors to rest at a position, or where the motion begins.
fn gather_place(gathered: &mut Gathered, command: RunCommand) {
    let (position, event) = match &command {
        RunCommand::Goto { position } => {
            (position.clone(), RunEvent::Goto { position: position.clone(), from_s: 0.0, until_s: 0.0 })
        }
        RunCommand::Rest { until, .. } => ("0".to_owned(), RunEvent::Resting { until: until.clone() }),
        _ => return,
    };
    match gathered.setpoints.at_position(&position) {
        Ok(program) => {
            gathered.changes(None, (command, event));
            (gathered.place, gathered.is_parked, gathered.follow) = (Some(program), true, Some(None));
        }
        Err(error) => gathered.refusals.push(refusal(command, &error)),
    }
}

/// The setpoints with a changed file; `None` if nothing has changed; or the event of the refusal.
pub(crate) fn with_file(
    setpoints: &LiveSetpoints,
    text: &str,
    files: &FileTexts,
) -> Result<Option<LiveSetpoints>, RunEvent> {
    let known = setpoints.files();
    if text == setpoints.text() && files.iter().all(|(name, text)| known.get(name) == Some(text)) {
        return Ok(None);
    }
    drop(known);
    if text.len() as u64 > MOST_OF_A_MOTION_FILE {
        let [is, most] = [text.len() as u64, MOST_OF_A_MOTION_FILE].map(|bytes| human::bytes(bytes as f64));
        let error = format!("it has {is}; {most} is the most that is read");
        return Err(RunEvent::MotionRefused { error, line: None, column: None });
    }
    let number = |number: usize| u32::try_from(number).ok();
    let setpoints = setpoints.with_file(text, files).map_err(|error| {
        let (place, advice) = match error.as_ref() {
            NoMotion::File(error) => (Some(error.problems()[0].place()), error.problems()[0].advice()),
            NoMotion::Other(_) => (None, None),
        };
        let (line, column) = place.map_or((None, None), |(line, column)| (number(line), number(column)));
        let advice = advice.map(|advice| format!(" ({advice})"));
        RunEvent::MotionRefused { error: format!("{error}{}", advice.unwrap_or_default()), line, column }
    })?;
    Ok(Some(setpoints))
}
