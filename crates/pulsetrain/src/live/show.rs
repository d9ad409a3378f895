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

use super::desk::{Desk, FileTexts, NoMotion, Turn};
use crate::control_socket::{Happened, KnobValue, LiveCommand, LiveEvent, Request};

/// Hears what happens.
pub type Tell<'a> = &'a mut dyn FnMut(Happened);

/// How many values between one that is allowed and one that is not are tried: the nearest is found to a part in 4000.
const TRIES: u32 = 12;
/// Steps that try to join the motion again after a stop, a hundred a second, before the motion is given up.
const MOST_TRIES: u32 = 3000;
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
    /// How many steps in a row tried in vain to join the motion again.
    tries_to_rejoin: u32,
    /// The tempo that was asked for last.
    tempo: f64,
    /// The motors rest, or come to rest, and are to follow the motion from there.
    joining: Option<Joining>,
    /// A pause from before the board was lost: the motion goes on at this time of its laws.
    halted_at: Option<Time>,
    /// When the motors rest where they were sent, s of the motion.
    rests_from_s: f64,
}

/// Motors that rest are to follow the motion.
struct Joining {
    /// The laws' time.
    at: Time,
    /// What is told then; `None`: they stay at rest.
    answer: Option<(LiveCommand, LiveEvent)>,
    /// What was asked for meanwhile.
    then: Vec<LiveCommand>,
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
            tries_to_rejoin: 0,
            tempo: 1.0,
            joining: None,
            halted_at: None,
            rests_from_s: 0.0,
        }
    }

    /// A motion whose motors rest where they are until it is to begin: [`LiveCommand::Begin`], or [`Command::Resume`].
    #[must_use]
    pub fn at_rest(driven: Driven<B>, desk: Desk, rejoins: bool) -> Show<B> {
        Show { is_parked: true, ..Show::new(driven, desk, rejoins) }
    }

    /// Whether all motors rest until somebody asks for the motion.
    #[must_use]
    pub fn is_resting(&self) -> bool {
        (self.is_parked || self.is_paused) && self.now_s >= self.rests_from_s
    }

    /// Whether the motors join the motion again by themselves after a stop.
    #[must_use]
    pub const fn rejoins(&self) -> bool {
        self.rejoins
    }

    /// How far the laws' time is, at most.
    pub fn law_time(&self) -> Time {
        self.driven.law_time()
    }

    /// Takes the motion off a board that is lost.
    #[must_use]
    pub fn suspend(self) -> (Driven<B>, SuspendedShow) {
        let law_time = self.driven.law_time();
        let suspended = SuspendedShow {
            desk: self.desk,
            is_parked: self.is_parked,
            is_halted: self.is_paused || self.halted_at.is_some(),
            law_time: self.halted_at.unwrap_or(law_time),
            tempo: self.tempo,
            rejoins: self.rejoins,
            rejoined: self.rejoined,
            is_new: false,
        };
        (self.driven, suspended)
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
            Request::Live(command @ (LiveCommand::Go | LiveCommand::Back | LiveCommand::Cue { .. }))
                if self.joining.is_some() =>
            {
                self.joining.iter_mut().for_each(|joining| joining.then.push(command.clone()));
            }
            Request::Session(Command::Resume) if self.joining.is_some() => {}
            Request::Session(Command::Resume) if self.is_parked && self.halted_at.is_some() => {
                let answer = (LiveCommand::Begin, LiveEvent::Returned { from_s: 0.0, until_s: 0.0 });
                let at = self.halted_at.take().unwrap_or_default();
                self.joining = Some(Joining { at, answer: Some(answer), then: Vec::new() });
            }
            Request::Session(Command::Resume) if self.is_parked && !self.is_paused => {
                self.back_to_motion(LiveCommand::Goto { position: "the motion".to_owned() }, tell);
            }
            Request::Session(command) => self.commands.push_back(command),
            Request::Live(LiveCommand::Set { knob, value }) => return self.set(knob, value, observer, tell),
            Request::Live(command @ LiveCommand::Go) => self.cue(command, tell),
            Request::Live(command @ LiveCommand::Back) => self.cue(command, tell),
            Request::Live(command @ LiveCommand::Cue { .. }) => self.cue(command, tell),
            Request::Live(LiveCommand::Goto { position }) => self.goto(position, tell),
            Request::Live(LiveCommand::Begin) => self.begin(tell),
            Request::Live(LiveCommand::Rest { in_place, until }) => self.rest(in_place, until, tell),
            Request::Live(command @ LiveCommand::Here { .. }) => {
                refuse(command, &"the motors' positions are known: the board counts their steps", tell);
            }
            Request::Live(LiveCommand::Motion { text, files }) => self.take_file(&text, &files, tell),
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
            Err(error) if self.rejoins && may_rejoin(&error) => match self.driven.rejoin() {
                Ok(times) => Ok(Err(times)),
                // It is too soon: `after_braking` tries again.
                Err(_) if self.driven.has_braked() => Ok(Ok(None)),
                Err(_) => Err(error),
            },
            other => Ok(Ok(other?)),
        };
        for event in events {
            match &event {
                Event::Progress { at_s } => self.now_s = *at_s,
                Event::Pausing { rests_s } => (self.is_paused, self.rests_from_s) = (true, *rests_s),
                Event::Resuming { .. } => self.is_paused = false,
                Event::Tempo { rate, .. } => self.tempo = *rate,
                Event::Failed { .. } if stepped.is_ok() => continue,
                _ => {}
            }
            tell(Happened::Session(event));
        }
        let ended = match stepped? {
            Ok(ended) => ended,
            Err(times) => {
                self.tell_rejoined(times, tell);
                None
            }
        };
        if ended.is_none() {
            self.join(tell);
            self.after_braking(tell);
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

    /// Lets motors join the motion again that braked while something else was done.
    fn after_braking(&mut self, tell: Tell<'_>) {
        if self.waiting.is_some() || !self.driven.has_braked() {
            return;
        }
        if !self.rejoins || self.tries_to_rejoin >= MOST_TRIES {
            return self.commands.push_back(Command::Stop);
        }
        match self.driven.rejoin() {
            Ok(times) => {
                self.tries_to_rejoin = 0;
                self.tell_rejoined(times, tell);
            }
            // The next step tries again.
            Err(_) => self.tries_to_rejoin += 1,
        }
    }

    fn tell_rejoined(&mut self, (from_s, until_s): (f64, f64), tell: Tell<'_>) {
        self.rejoined += 1;
        tell(Happened::Live(LiveEvent::Rejoined { from_s, until_s, times: self.rejoined }));
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

    /// Lets motors that rest begin the motion, from its beginning.
    fn begin(&mut self, tell: Tell<'_>) {
        let will_rest = self.waiting.as_ref().map_or(self.is_parked, |waiting| waiting.is_parked);
        if !will_rest || self.is_paused {
            let why = "the motion has begun already; `goto 0` brings the motors to rest where it begins";
            return refuse(LiveCommand::Begin, &why, tell);
        }
        self.desk = self.desk.restarted();
        self.halted_at = None;
        let answer = (LiveCommand::Begin, LiveEvent::Began { from_s: 0.0, until_s: 0.0 });
        self.joining = Some(Joining { at: Time::ZERO, answer: Some(answer), then: Vec::new() });
    }

    /// It is not time for the motion.
    fn rest(&mut self, in_place: bool, until: String, tell: Tell<'_>) {
        let event = LiveEvent::Resting { until: until.clone() };
        if self.is_parked || (in_place && self.is_paused) {
            return tell(Happened::Live(event));
        }
        if in_place {
            self.commands.push_back(Command::Pause);
            return tell(Happened::Live(event));
        }
        self.park("0", LiveCommand::Rest { in_place, until }, event, tell);
    }

    /// Lets motors that rest follow the motion, if they are to.
    fn join(&mut self, tell: Tell<'_>) {
        let Some(Joining { at, .. }) = self.joining else { return };
        if self.waiting.is_some() || !self.commands.is_empty() {
            return;
        }
        match self.driven.set_law_time(at) {
            Err(SessionError::Waiting { .. }) => return,
            Err(error) => {
                if let Some((command, _)) = self.joining.take().and_then(|joining| joining.answer) {
                    refuse(command, &error, tell);
                }
                return;
            }
            Ok(()) => {}
        }
        let Some(Joining { answer, then, .. }) = self.joining.take() else { return };
        if let Some((command, event)) = answer {
            match self.desk.program() {
                Ok(program) => self.pending_change(
                    PendingChange { program, over: None, answers: vec![(command, event)], is_parked: false },
                    tell,
                ),
                Err(error) => refuse(command, &error, tell),
            }
        }
        then.into_iter().for_each(|command| self.cue(command, tell));
    }

    fn goto(&mut self, position: String, tell: Tell<'_>) {
        let command = LiveCommand::Goto { position: position.clone() };
        let event = LiveEvent::Goto { position: position.clone(), from_s: 0.0, until_s: 0.0 };
        self.park(&position, command, event, tell);
    }

    /// Brings the motors to rest at a position.
    fn park(&mut self, position: &str, command: LiveCommand, event: LiveEvent, tell: Tell<'_>) {
        (self.joining, self.halted_at) = (None, None);
        match self.desk.at_position(position) {
            Ok(program) => {
                self.follow_at_s = None;
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

    fn take_file(&mut self, text: &str, files: &FileTexts, tell: Tell<'_>) {
        let refused = |error: String| Happened::Live(LiveEvent::MotionRefused { error, line: None, column: None });
        let desk = match with_file(&self.desk, text, files) {
            Ok(None) => return,
            Ok(Some(desk)) => desk,
            Err(refused) => return tell(Happened::Live(refused)),
        };
        let program = match desk.program() {
            Ok(program) => program,
            Err(error) => return tell(refused(error.to_string())),
        };
        let change = change(Arc::clone(&program), None);
        match self.driven.ceiling_of(&change) {
            Ok(None) => {}
            Ok(Some(limit)) => return tell(refused(format!("the motion would break a limit: {limit}"))),
            Err(error) => return tell(refused(error.to_string())),
        }
        self.desk = desk;
        let event = LiveEvent::Motion { from_s: self.now_s, until_s: self.now_s };
        if self.is_parked {
            self.followed = self.desk.clone();
            return tell(Happened::Live(event));
        }
        let command = LiveCommand::Motion { text: String::new(), files: FileTexts::new() };
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
        let has_braked = self.driven.has_braked();
        match self.driven.change_to(&change(Arc::clone(&pending_change.program), pending_change.over)) {
            Ok(times) => {
                self.followed = self.desk.clone();
                self.is_parked = pending_change.is_parked;
                self.rests_from_s = times.1;
                if has_braked {
                    self.tell_rejoined(times, tell);
                }
                for (_, mut event) in pending_change.answers {
                    set_times(&mut event, times);
                    tell(Happened::Live(event));
                }
            }
            Err(SessionError::Waiting { .. }) => self.waiting = Some(pending_change),
            // This computer was too slow just now: the motors brake, and join these laws then.
            Err(_) if self.rejoins && self.driven.has_braked() => self.waiting = Some(pending_change),
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

/// A motion without a board.
pub struct SuspendedShow {
    desk: Desk,
    is_parked: bool,
    is_halted: bool,
    /// When the board was lost.
    law_time: Time,
    tempo: f64,
    rejoins: bool,
    rejoined: u32,
    /// It has not begun yet.
    is_new: bool,
}

impl SuspendedShow {
    /// A motion that has not begun, and waits for its board. If `joins`, the motors join it from where they stand.
    #[must_use]
    pub fn new(desk: Desk, rejoins: bool, joins: bool) -> SuspendedShow {
        let (is_parked, law_time) = (!joins, Time::ZERO);
        SuspendedShow { desk, is_parked, is_halted: false, law_time, tempo: 1.0, rejoins, rejoined: 0, is_new: true }
    }

    /// The motion as it is wanted.
    #[must_use]
    pub fn desk(&self) -> &Desk {
        &self.desk
    }

    /// Notes what is asked meanwhile: a changed motion file, and what the schedule says. All else is refused.
    pub fn obey(&mut self, request: Request, tell: Tell<'_>) {
        const AWAY: &str = "the board cannot be reached, or nobody knows where the motors stand";
        match request {
            Request::Live(LiveCommand::Motion { text, files }) => match with_file(&self.desk, &text, &files) {
                Ok(None) => {}
                Ok(Some(desk)) => {
                    self.desk = desk;
                    tell(Happened::Live(LiveEvent::Motion { from_s: 0.0, until_s: 0.0 }));
                }
                Err(refused) => tell(Happened::Live(refused)),
            },
            Request::Live(LiveCommand::Rest { in_place, until }) => {
                if in_place {
                    self.is_halted = true
                } else {
                    self.is_parked = true
                }
                tell(Happened::Live(LiveEvent::Resting { until }));
            }
            Request::Live(LiveCommand::Begin) => {
                self.desk = self.desk.restarted();
                (self.is_parked, self.is_halted, self.law_time) = (false, false, Time::ZERO);
            }
            Request::Live(command @ LiveCommand::Cue { .. }) => {
                let LiveCommand::Cue { name } = &command else { return };
                match self.desk.at_cue(name, self.law_time) {
                    Ok((desk, _)) => self.desk = desk,
                    Err(error) => refuse(command, &error, tell),
                }
            }
            Request::Session(Command::Resume) => (self.is_parked, self.is_halted) = (false, false),
            Request::Session(command) => {
                tell(Happened::Session(Event::Refused { command, why: AWAY.to_owned() }));
            }
            Request::Live(command) => refuse(command, &AWAY, tell),
        }
    }

    /// Goes on with another session of the board, in which the motors rest where they are, as `program` has it. They join the motion again unless they
    /// rested before; the laws' time went on by `passed_s` seconds of the board.
    #[must_use]
    pub fn rejoin_on<B: Leased>(mut self, driven: Driven<B>, program: &Program, passed_s: f64) -> Show<B> {
        self.desk.set_up(program);
        let mut show = Show::at_rest(driven, self.desk, self.rejoins);
        show.tempo = self.tempo;
        if self.tempo != 1.0 {
            show.commands.push_back(Command::Tempo { rate: self.tempo });
        }
        show.rejoined = self.rejoined + u32::from(!self.is_new);
        if self.is_halted {
            show.halted_at = Some(self.law_time);
        }
        let at = if self.is_halted { self.law_time } else { self.law_time + Time::from_seconds(self.tempo * passed_s) };
        let event = match self.is_new {
            true => LiveEvent::Returned { from_s: 0.0, until_s: 0.0 },
            false => LiveEvent::Rejoined { from_s: 0.0, until_s: 0.0, times: show.rejoined },
        };
        let joins = !self.is_parked && !self.is_halted;
        show.joining = Some(Joining { at, answer: joins.then_some((LiveCommand::Begin, event)), then: Vec::new() });
        show
    }
}

/// The desk with a changed file; `None` if nothing has changed; or the event of the refusal.
fn with_file(desk: &Desk, text: &str, files: &FileTexts) -> Result<Option<Desk>, LiveEvent> {
    let known = desk.files();
    if text == desk.text() && files.iter().all(|(name, text)| known.get(name) == Some(text)) {
        return Ok(None);
    }
    drop(known);
    let number = |number: usize| u32::try_from(number).ok();
    let desk = desk.with_file(text, files).map_err(|error| {
        let (place, advice) = match error.as_ref() {
            NoMotion::File(error) => (Some(error.problems()[0].place()), error.problems()[0].advice()),
            NoMotion::Other(_) => (None, None),
        };
        let (line, column) = place.map_or((None, None), |(line, column)| (number(line), number(column)));
        let advice = advice.map(|advice| format!(" ({advice})"));
        LiveEvent::MotionRefused { error: format!("{error}{}", advice.unwrap_or_default()), line, column }
    })?;
    Ok(Some(desk))
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
        | LiveEvent::Began { from_s, until_s }
        | LiveEvent::Motion { from_s, until_s }
        | LiveEvent::Rejoined { from_s, until_s, .. } => (*from_s, *until_s) = (from, until),
        LiveEvent::MotionRefused { .. }
        | LiveEvent::Refused { .. }
        | LiveEvent::Resting { .. }
        | LiveEvent::Unplugged { .. }
        | LiveEvent::Unplaced { .. }
        | LiveEvent::Placed { .. } => {}
    }
}

/// A value to the digits that its distance from others deserves: people read it.
fn nice(value: f64, span: f64) -> f64 {
    let digits = (4.0 - span.abs().max(1e-12).log10()).ceil().clamp(0.0, 15.0) as usize;
    format!("{value:.digits$}").parse().unwrap_or(value)
}
