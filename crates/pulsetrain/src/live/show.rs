//! A running motion that is changed by requests.
//!
//! It knows no clock and no terminal: its caller gives it requests, lets it step, and hears what happens. The same requests at the same ticks of a virtual
//! board make the same edges again.

use std::collections::VecDeque;

use pulsetrain_board::{Leased, Observer};
use pulsetrain_motion::Time;
use pulsetrain_session::SessionError;
use pulsetrain_session::control::{Command, Ended, Event, Knowledge};
use pulsetrain_session::drive::{DriveError, Driven};
use pulsetrain_session::fade::{Begins, Change};
use std::sync::Arc;

use pulsetrain_motion::program::Program;

use super::desk::{Desk, NoMotion, Turn};
use crate::control_socket::{Happened, KnobValue, LiveCommand, LiveEvent, Request};

/// Hears what happens.
pub type Tell<'a> = &'a mut dyn FnMut(Happened);

/// How many values between one that is allowed and one that is not are tried: the nearest is found to a part in 4000.
const TRIES: u32 = 12;
/// Motions that begin at a cue begin this long after it, s: the transition has reached the board by then.
const CUE_LEAD_S: f64 = 0.1;

/// A running motion that is changed by requests.
pub struct Show<B> {
    driven: Driven<B>,
    desk: Desk,
    /// What the motors follow, or change to.
    followed: Desk,
    /// A change that waits until another one has begun.
    waiting: Option<PendingChange>,
    /// Commands to the session: a step takes one.
    commands: VecDeque<Command>,
    /// The motors were sent to a position, and rest there until somebody asks for the motion again.
    is_parked: bool,
    is_paused: bool,
    /// When the next cue begins without an order, s of the motion.
    follow_at_s: Option<f64>,
    now_s: f64,
    /// Whether motors that braked since the host was too slow join the motion again, and how many times they have.
    rejoins: bool,
    rejoined: u32,
}

/// A change of the motors' laws that was asked for.
struct PendingChange {
    program: Arc<Program>,
    over: Option<Time>,
    /// What was asked for, and what is told when it is done.
    answers: Vec<(LiveCommand, LiveEvent)>,
    is_parked: bool,
}

impl<B: Leased> Show<B> {
    /// A motion that is about to begin.
    #[must_use]
    pub fn new(driven: Driven<B>, desk: Desk, rejoins: bool) -> Show<B> {
        Show {
            driven: driven.staying().looking_often(),
            followed: desk.clone(),
            desk,
            waiting: None,
            commands: VecDeque::new(),
            is_parked: false,
            is_paused: false,
            follow_at_s: None,
            now_s: 0.0,
            rejoins,
            rejoined: 0,
        }
    }

    /// The board's time, ticks.
    pub fn now(&self) -> u64 {
        self.driven.now()
    }

    /// The motion as it is wanted.
    #[must_use]
    pub fn desk(&self) -> &Desk {
        &self.desk
    }

    /// The run below, when it is over.
    #[must_use]
    pub fn into_driven(self) -> Driven<B> {
        self.driven
    }

    /// Does what is asked, or tells why not. A value that is too much is looked for nearer; the motion goes on meanwhile.
    ///
    /// # Errors
    /// As [`Show::step`].
    pub fn obey(
        &mut self,
        request: Request,
        observer: &mut impl Observer,
        tell: Tell<'_>,
    ) -> Result<Option<Ended>, DriveError> {
        match request {
            Request::Session(Command::Resume) if self.is_parked && !self.is_paused => {
                self.back_to_motion(LiveCommand::Goto { position: "the motion".to_owned() }, tell);
            }
            Request::Session(command) => self.commands.push_back(command),
            Request::Live(LiveCommand::Set { knob, value }) => return self.set(knob, value, observer, tell),
            Request::Live(command @ LiveCommand::Go) => self.cue(command, tell),
            Request::Live(command @ LiveCommand::Back) => self.cue(command, tell),
            Request::Live(command @ LiveCommand::Cue { .. }) => self.cue(command, tell),
            Request::Live(LiveCommand::Goto { position }) => self.goto(position, tell),
            Request::Live(LiveCommand::Motion { text }) => self.take_file(&text, tell),
        }
        Ok(None)
    }

    /// Lets a hundredth of a second of the board's time pass. `Some` when somebody has stopped the motion.
    ///
    /// # Errors
    /// When the motors stopped though nobody asked for it, and cannot join the motion again.
    pub fn step(&mut self, observer: &mut impl Observer, tell: Tell<'_>) -> Result<Option<Ended>, DriveError> {
        let urgent = |wanted: Command| self.commands.iter().position(|command| *command == wanted);
        let next = urgent(Command::StopNow).or_else(|| urgent(Command::Stop)).unwrap_or(0);
        let command = self.commands.remove(next);
        let mut events = Vec::new();
        let stepped = self.driven.step(command, observer, |event| events.push(event));
        let stepped = match stepped {
            Err(error) if self.rejoins && may_rejoin(&error) => self.driven.rejoin().map(Err).map_err(|_| error),
            other => Ok(Ok(other?)),
        };
        for event in events {
            match &event {
                Event::Progress { at_s } => self.now_s = *at_s,
                Event::Pausing { .. } => self.is_paused = true,
                Event::Resuming { .. } => self.is_paused = false,
                Event::Failed { .. } if stepped.is_ok() => continue,
                _ => {}
            }
            tell(Happened::Session(event));
        }
        let ended = match stepped? {
            Ok(ended) => ended,
            Err((from_s, until_s)) => {
                self.rejoined += 1;
                tell(Happened::Live(LiveEvent::Rejoined { from_s, until_s, times: self.rejoined }));
                None
            }
        };
        if ended.is_none() {
            if let Some(pending_change) = self.waiting.take() {
                self.change(pending_change, tell);
            }
            if self.follow_at_s.is_some_and(|at_s| at_s <= self.now_s) && self.waiting.is_none() {
                self.follow_at_s = None;
                self.cue(LiveCommand::Go, tell);
            }
        }
        Ok(ended)
    }

    /// Turns a knob: to the nearest value that the motors follow.
    fn set(
        &mut self,
        knob: String,
        value: KnobValue,
        observer: &mut impl Observer,
        tell: Tell<'_>,
    ) -> Result<Option<Ended>, DriveError> {
        let command = LiveCommand::Set { knob: knob.clone(), value: value.clone() };
        let turn = match self.desk.turn(&knob, &value) {
            Ok(turn) => turn,
            Err(error) => {
                refuse(command, &error, tell);
                return Ok(None);
            }
        };
        let (mut set, mut ceiling) = (turn.to, turn.range.clone());
        let mut found = match self.allowed(&turn, set) {
            Ok(found) => found,
            Err(error) => {
                refuse(command, &error, tell);
                return Ok(None);
            }
        };
        if let Err(limit) = &found {
            ceiling = Some(limit.clone());
            let (mut holds, mut breaks) = (turn.from, turn.to);
            for _ in 0..TRIES {
                if let Some(ended) = self.step(observer, tell)? {
                    return Ok(Some(ended));
                }
                let middle = nice(0.5 * (holds + breaks), (breaks - holds).abs());
                match self.allowed(&turn, middle) {
                    Ok(Ok(allowed)) => (holds, found) = (middle, Ok(allowed)),
                    // The reader may refuse what lies between, such as a swing of half a step.
                    Ok(Err(_)) | Err(_) => breaks = middle,
                }
            }
            set = holds;
        }
        let Ok((desk, program)) = found else {
            let limit = ceiling.unwrap_or_default();
            let why = format!("{limit}: no value between {} and {} {} keeps to it", turn.from, turn.to, turn.unit);
            refuse(command, &why.trim_end(), tell);
            return Ok(None);
        };
        self.desk = desk;
        let event =
            LiveEvent::Set { knob, value: set, unit: turn.unit, ceiling, from_s: self.now_s, until_s: self.now_s };
        // Motors that were sent to a position stay there: the knob counts when they come back.
        if self.is_parked {
            self.followed = self.desk.clone();
            tell(Happened::Live(event));
            return Ok(None);
        }
        self.pending_change(
            PendingChange { program, over: turn.over, answers: vec![(command, event)], is_parked: false },
            tell,
        );
        Ok(None)
    }

    /// The desk with a knob at a value, and its program; the limit that it would break; or why the reader refuses it.
    #[allow(clippy::type_complexity)]
    fn allowed(
        &self,
        turn: &Turn,
        value: f64,
    ) -> Result<Result<(Desk, Arc<Program>), String>, Box<dyn std::error::Error>> {
        let desk = self.desk.turned(turn, value);
        let program = desk.program()?;
        let change = change(Arc::clone(&program), turn.over);
        match self.driven.ceiling_of(&change)? {
            None => Ok(Ok((desk, program))),
            Some(limit) => Ok(Err(limit)),
        }
    }

    /// Goes to a cue.
    fn cue(&mut self, command: LiveCommand, tell: Tell<'_>) {
        let begins = self.driven.law_time() + Time::from_seconds(CUE_LEAD_S);
        let found = match &command {
            LiveCommand::Cue { name } => self.desk.at_cue(name, begins),
            LiveCommand::Back => self.desk.at_other_cue(false, begins),
            _ => self.desk.at_other_cue(true, begins),
        };
        let wished = found.and_then(|(desk, cue)| Ok((desk.program()?, desk, cue)));
        let (program, desk, cue) = match wished {
            Ok(wished) => wished,
            Err(error) => return refuse(command, &error, tell),
        };
        let change = change(Arc::clone(&program), cue.fade);
        match self.driven.ceiling_of(&change) {
            Ok(None) => {}
            Ok(Some(limit)) => {
                let why = format!("cue \"{}\" would break a limit: {limit}", cue.name);
                return refuse(command, &why, tell);
            }
            Err(error) => return refuse(command, &error, tell),
        }
        self.desk = desk;
        let follow = cue.follow.filter(|_| self.desk.has_cue_after(&cue));
        self.follow_at_s = follow.map(|follow| self.now_s + follow.seconds());
        let event = LiveEvent::Cue { name: cue.name, from_s: 0.0, until_s: 0.0 };
        self.pending_change(
            PendingChange { program, over: cue.fade, answers: vec![(command, event)], is_parked: false },
            tell,
        );
    }

    fn goto(&mut self, position: String, tell: Tell<'_>) {
        let command = LiveCommand::Goto { position: position.clone() };
        match self.desk.at_position(&position) {
            Ok(program) => {
                self.follow_at_s = None;
                let event = LiveEvent::Goto { position, from_s: 0.0, until_s: 0.0 };
                self.pending_change(
                    PendingChange { program, over: None, answers: vec![(command, event)], is_parked: true },
                    tell,
                );
            }
            Err(error) => refuse(command, &error, tell),
        }
    }

    /// Lets motors that were sent to a position join the motion again.
    fn back_to_motion(&mut self, command: LiveCommand, tell: Tell<'_>) {
        match self.desk.program() {
            Ok(program) => {
                let event = LiveEvent::Returned { from_s: 0.0, until_s: 0.0 };
                self.pending_change(
                    PendingChange { program, over: None, answers: vec![(command, event)], is_parked: false },
                    tell,
                );
            }
            Err(error) => refuse(command, &error, tell),
        }
    }

    fn take_file(&mut self, text: &str, tell: Tell<'_>) {
        if text == self.desk.text() {
            return;
        }
        let refused = |error: String, place: Option<(usize, usize)>| {
            let number = |number: usize| u32::try_from(number).ok();
            let (line, column) = place.map_or((None, None), |(line, column)| (number(line), number(column)));
            Happened::Live(LiveEvent::MotionRefused { error, line, column })
        };
        let desk = match self.desk.with_file(text) {
            Ok(desk) => desk,
            Err(error) => {
                let place = match error.as_ref() {
                    NoMotion::File(error) => Some(error.problems()[0].place()),
                    NoMotion::Other(_) => None,
                };
                let advice = match error.as_ref() {
                    NoMotion::File(error) => error.problems()[0].advice().map(|advice| format!(" ({advice})")),
                    NoMotion::Other(_) => None,
                };
                return tell(refused(format!("{error}{}", advice.unwrap_or_default()), place));
            }
        };
        let program = match desk.program() {
            Ok(program) => program,
            Err(error) => return tell(refused(error.to_string(), None)),
        };
        let change = change(Arc::clone(&program), None);
        match self.driven.ceiling_of(&change) {
            Ok(None) => {}
            Ok(Some(limit)) => return tell(refused(format!("the motion would break a limit: {limit}"), None)),
            Err(error) => return tell(refused(error.to_string(), None)),
        }
        self.desk = desk;
        let event = LiveEvent::Motion { from_s: self.now_s, until_s: self.now_s };
        if self.is_parked {
            self.followed = self.desk.clone();
            return tell(Happened::Live(event));
        }
        let command = LiveCommand::Motion { text: String::new() };
        self.pending_change(
            PendingChange { program, over: None, answers: vec![(command, event)], is_parked: false },
            tell,
        );
    }

    /// Changes to what is wished, after what waits: the last pending_change has all that was asked for before.
    fn pending_change(&mut self, mut pending_change: PendingChange, tell: Tell<'_>) {
        if let Some(before) = self.waiting.take() {
            pending_change.answers.splice(0..0, before.answers);
        }
        self.change(pending_change, tell);
    }

    fn change(&mut self, pending_change: PendingChange, tell: Tell<'_>) {
        match self.driven.change_to(&change(Arc::clone(&pending_change.program), pending_change.over)) {
            Ok(times) => {
                self.followed = self.desk.clone();
                self.is_parked = pending_change.is_parked;
                for (_, mut event) in pending_change.answers {
                    set_times(&mut event, times);
                    tell(Happened::Live(event));
                }
            }
            Err(SessionError::Waiting { .. }) => self.waiting = Some(pending_change),
            Err(error) => {
                self.desk = self.followed.clone();
                self.follow_at_s = None;
                for (command, _) in pending_change.answers {
                    refuse(command, &error, tell);
                }
            }
        }
    }
}

fn change(program: Arc<Program>, over: Option<Time>) -> Change {
    Change { program, over, begins: Begins::WithTheMotion }
}

fn refuse(command: LiveCommand, why: &impl ToString, tell: Tell<'_>) {
    let why = why.to_string();
    tell(Happened::Live(match command {
        LiveCommand::Motion { .. } => LiveEvent::MotionRefused { error: why, line: None, column: None },
        command => LiveEvent::Refused { command, why },
    }));
}

/// Whether the motors braked since the host or the line was too slow, and the board has counted all the way.
fn may_rejoin(error: &DriveError) -> bool {
    let DriveError::Halted { why, positions, .. } = error else { return false };
    positions.by == Knowledge::Counted && matches!(**why, DriveError::TooLate { .. } | DriveError::QueueTooShort { .. })
}

fn set_times(event: &mut LiveEvent, (from, until): (f64, f64)) {
    match event {
        LiveEvent::Set { from_s, until_s, .. }
        | LiveEvent::Cue { from_s, until_s, .. }
        | LiveEvent::Goto { from_s, until_s, .. }
        | LiveEvent::Returned { from_s, until_s }
        | LiveEvent::Motion { from_s, until_s }
        | LiveEvent::Rejoined { from_s, until_s, .. } => (*from_s, *until_s) = (from, until),
        LiveEvent::MotionRefused { .. } | LiveEvent::Refused { .. } => {}
    }
}

/// A value to the digits that its distance from others deserves: people read it.
fn nice(value: f64, span: f64) -> f64 {
    let digits = (4.0 - span.abs().max(1e-12).log10()).ceil().clamp(0.0, 15.0) as usize;
    format!("{value:.digits$}").parse().unwrap_or(value)
}
