//! A running motion that is changed by requests.
//!
//! It knows no clock and no terminal: its caller gives it requests, lets it step, and hears what happens. The same requests at the same ticks of a virtual
//! board make the same edges again.

use std::collections::VecDeque;

use pulsetrain_board::{Leased, Observer};
use pulsetrain_motion::file::MOST_OF_A_MOTION_FILE;
use pulsetrain_motion::time::Rate;
use pulsetrain_motion::{Time, human};
use pulsetrain_session::SessionError;
use pulsetrain_session::control::{Command, Ended, Event, Knowledge};
use pulsetrain_session::drive::{DriveError, Driven};
use pulsetrain_session::fade::{Begins, Change, Shift};
use std::sync::Arc;

use pulsetrain_motion::program::Program;

use super::desk::{ChangeRefusal, Desk, FileTexts, NoMotion, Turn};
use super::nearest::Nearest;
use crate::control_socket::{Happened, KnobValue, LiveCommand, LiveEvent, Request, Together};

/// Hears what happens.
pub type Tell<'a> = &'a mut dyn FnMut(Happened);
/// Whether a stop that is to be obeyed at once waits behind the present request, at a tick of the board.
pub type StopWaits<'a> = &'a mut dyn FnMut(u64) -> bool;

/// If the reader refuses a larger value of a knob, this one is looked at in its place: it is farther than any motor goes.
const FARTHEST_VALUE: f64 = 1e9;
/// Steps that try to join the motion again after a stop, a hundred a second, before the motion is given up.
const MOST_REJOIN_STEPS: u32 = 3000;
/// Motions that begin at a cue begin this long after it, s: the transition has reached the board by then.
const CUE_LEAD_S: f64 = 0.1;

/// A step of the board's time, s.
const STEP_S: f64 = 0.01;
/// A change for a tick is asked for this long before it is too late, s: some steps.
const ASK_S: f64 = 0.04;
/// It is held against the limits this long before, s: a nearer value takes `nearest::MOST_VALUES` steps to find.
const LOOK_S: f64 = 0.3;
/// A change may be for a time that is this far ahead, s.
const FARTHEST_S: f64 = 60.0;
/// Motions before the last changes that are kept, for a change that has to be taken back.
const MOST_EARLIER: usize = 8;
/// A change that begins later than its tick by more than this is reported as late, s.
const LATE_S: f64 = 0.002;
/// The position of the command that stands for a way back to the motion.
const THE_MOTION: &str = "the motion";
/// Changes that may wait for their tick.
const MOST_TIMED: usize = 1024;

/// A running motion that is changed by requests.
pub struct Show<B> {
    driven: Driven<B>,
    desk: Desk,
    /// What the motors follow, or change to.
    followed: Desk,
    /// The program of `followed`; `None` if it was not read yet.
    followed_program: Option<Arc<Program>>,
    /// What they followed before each of the last changes, oldest first. The oldest of all is never forgotten.
    earlier: Vec<EarlierMotion>,
    /// Whether the motion was ever changed.
    is_changed: bool,
    /// The session has got the command to stop.
    is_stopping: bool,
    /// Why the last change is being taken back.
    taking_back: Option<String>,
    /// A change that waits until another one has begun.
    waiting: Option<PendingChange>,
    /// Requests that wait for their tick, soonest first.
    timed: Vec<TimedRequests>,
    /// Commands to the session, and the tick for which they are: a step takes one.
    commands: VecDeque<(Command, Option<u64>)>,
    /// The tick of the last such command.
    held_until: Option<u64>,
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
    /// What changed speeds had added to the motors' ways before the board was lost.
    shifts: Option<Vec<Shift>>,
    /// When the motors rest where they were sent, s of the motion.
    rests_from_s: f64,
    /// Whether clients know that all motors have come to the end of the motion.
    end_is_known: bool,
}

/// A motion that the motors followed, for a change that has to be taken back.
struct EarlierMotion {
    desk: Desk,
    tempo: f64,
}

/// Motors that rest are to follow the motion.
struct Joining {
    /// The laws' time.
    at: Time,
    /// What changed speeds have added to the motors' ways; `None`: a constant speed begins where they rest.
    shifts: Option<Vec<Shift>>,
    /// The request and the event that answers it; `None`: they stay at rest.
    answer: Option<(LiveCommand, LiveEvent)>,
    /// What was asked for meanwhile.
    then: Vec<Request>,
}

/// A change of the motors' laws that was asked for.
struct PendingChange {
    program: Arc<Program>,
    over: Option<Time>,
    /// What was asked for, and what is told when it is done.
    answers: Vec<(LiveCommand, LiveEvent)>,
    is_parked: bool,
    /// The first tick; `None`: as soon as it can.
    at: Option<u64>,
    /// The tick for which it was asked, perhaps too late.
    wanted: Option<u64>,
    /// The tempo from that tick on, if it changes.
    tempo: Option<f64>,
}

/// Requests that wait for their tick.
struct TimedRequests {
    tick: u64,
    requests: Vec<Request>,
    /// Whether they were held against the limits.
    is_checked: bool,
}

impl<B: Leased> Show<B> {
    /// A motion that is about to begin.
    #[must_use]
    pub fn new(driven: Driven<B>, desk: Desk, rejoins: bool) -> Show<B> {
        Show {
            driven: driven.staying().looking_often(),
            followed: desk.clone(),
            followed_program: None,
            desk,
            earlier: Vec::new(),
            is_changed: false,
            is_stopping: false,
            taking_back: None,
            waiting: None,
            timed: Vec::new(),
            commands: VecDeque::new(),
            held_until: None,
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
            shifts: None,
            rests_from_s: 0.0,
            end_is_known: false,
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

    /// Whether the motors rejoin the motion after a failure. They do not if a client has asked for a stop.
    #[must_use]
    pub fn rejoins(&self) -> bool {
        self.rejoins && !self.has_stop()
    }

    /// Whether a client has asked for a stop, and the motion has not ended yet. The run does not wait for the board then.
    fn has_stop(&self) -> bool {
        let is_stop_of_session = |(command, _): &(Command, Option<u64>)| is_stop(*command);
        let is_timed = |timed: &TimedRequests| timed.requests.iter().any(|request| stop_of(request).is_some());
        self.is_stopping || self.commands.iter().any(is_stop_of_session) || self.timed.iter().any(is_timed)
    }

    /// How far the laws' time is, at most.
    pub fn law_time(&self) -> Time {
        self.driven.law_time()
    }

    /// Takes the motion off a board that is lost.
    #[must_use]
    pub fn suspend(self) -> (Driven<B>, SuspendedShow) {
        let (law_time, shifts) = match self.joining {
            // The board was lost again before its session had the laws' time.
            Some(Joining { at, shifts, .. }) => (at, shifts),
            None => (self.driven.law_time(), self.driven.shifts()),
        };
        let suspended = SuspendedShow {
            desk: self.desk,
            is_parked: self.is_parked,
            is_halted: self.is_paused || self.halted_at.is_some(),
            law_time: self.halted_at.unwrap_or(law_time),
            shifts: if self.halted_at.is_some() { self.shifts } else { shifts },
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

    /// The tick at which the motion begins.
    #[must_use]
    pub fn zero(&self) -> u64 {
        self.driven.zero()
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
        self.obey_until(request, &mut |_| false, observer, tell)
    }

    /// As [`Show::obey`]. While a knob's nearest value is searched, this calls `stop_waits` before each value. If a stop waits, the request is refused, and
    /// the caller gives the stop next.
    ///
    /// # Errors
    /// As [`Show::step`].
    pub fn obey_until(
        &mut self,
        request: Request,
        stop_waits: StopWaits<'_>,
        observer: &mut impl Observer,
        tell: Tell<'_>,
    ) -> Result<Option<Ended>, DriveError> {
        let mut caller = Caller { observer, tell, stop_waits };
        self.ask(request, &mut caller)
    }

    fn ask<O: Observer>(&mut self, request: Request, caller: &mut Caller<'_, O>) -> Result<Option<Ended>, DriveError> {
        let at_s = if let Request::Together(Together { at_s, .. }) = &request { *at_s } else { None };
        let requests = request.each();
        let Some(at_s) = at_s else { return self.together(&requests, (None, None), caller) };
        let tick = self.driven.tick_at(at_s);
        if tick <= self.driven.earliest() {
            return self.together(&requests, (None, Some(tick)), caller);
        }
        let why = if at_s > self.now_s + FARTHEST_S {
            format!("it is for {:.1} s from now; {FARTHEST_S} s are the most", at_s - self.now_s)
        } else if self.timed.len() == MOST_TIMED {
            format!("{MOST_TIMED} changes wait for their time already")
        } else {
            let place = self.timed.partition_point(|timed| timed.tick <= tick);
            self.timed.insert(place, TimedRequests { tick, requests, is_checked: false });
            return Ok(None);
        };
        requests.into_iter().for_each(|request| (caller.tell)(refusal(request, &why)));
        Ok(None)
    }

    /// Lets a hundredth of a second of the board's time pass. `Some` when somebody has stopped the motion.
    ///
    /// # Errors
    /// When the motors stopped though nobody asked for it, and cannot join the motion again.
    pub fn step(&mut self, observer: &mut impl Observer, tell: Tell<'_>) -> Result<Option<Ended>, DriveError> {
        self.step_until(&mut |_| false, observer, tell)
    }

    /// As [`Show::step`]. `stop_waits` is asked whether a stop waits at a tick: a stop ends the search for a knob's nearest value.
    ///
    /// # Errors
    /// As [`Show::step`].
    pub fn step_until(
        &mut self,
        stop_waits: StopWaits<'_>,
        observer: &mut impl Observer,
        tell: Tell<'_>,
    ) -> Result<Option<Ended>, DriveError> {
        let ended = self.pass(observer, tell)?;
        if ended.is_some() {
            return Ok(ended);
        }
        let mut caller = Caller { observer, tell, stop_waits };
        self.tell_end(caller.tell);
        if let Some(ended) = self.join(&mut caller)? {
            return Ok(Some(ended));
        }
        if self.follow_at_s.is_some_and(|at_s| at_s <= self.now_s) && self.waiting.is_none() {
            self.follow_at_s = None;
            let ended = self.together(&[Request::Live(LiveCommand::Go)], (None, None), &mut caller)?;
            if ended.is_some() {
                return Ok(ended);
            }
        }
        self.begin_timed(&mut caller)
    }

    /// As [`Show::step`]; nothing begins that was not asked of the session before.
    fn pass(&mut self, observer: &mut impl Observer, tell: Tell<'_>) -> Result<Option<Ended>, DriveError> {
        let soon = self.driven.now() + self.ticks(STEP_S);
        // A stop has no tick of its own: it is given just before.
        let is_due = |(command, at): &(Command, Option<u64>)| !is_stop(*command) || at.is_none_or(|at| at <= soon);
        let urgent = |wanted: Command| self.commands.iter().position(|it| it.0 == wanted && is_due(it));
        let next = urgent(Command::StopNow).or_else(|| urgent(Command::Stop));
        let next = next.or_else(|| self.commands.iter().position(is_due));
        let command = next.and_then(|next| self.commands.remove(next)).map(|(command, at)| {
            self.held_until = at;
            self.driven.hold_changes_until(at);
            self.is_stopping |= is_stop(command);
            command
        });
        let (mut events, mut refused) = (Vec::new(), None);
        let stepped = self.driven.step(command, observer, |event| events.push(event));
        let stepped = match stepped {
            // The session failed before it took the stop. The motors have braked: the next step tells it again.
            Err(error)
                if self.is_stopping
                    && self.rejoins
                    && (may_rejoin(&error) || is_refused(&error))
                    && self.driven.has_braked()
                    && self.tries_to_rejoin < MOST_REJOIN_STEPS =>
            {
                self.tries_to_rejoin += 1;
                self.commands.extend(command.filter(|command| is_stop(*command)).map(|command| (command, None)));
                Ok(Ok(None))
            }
            Err(error) if self.is_stopping => Err(error),
            Err(error) if self.rejoins && may_rejoin(&error) => match self.driven.rejoin() {
                Ok(times) => Ok(Err(times)),
                // It is too soon: `after_braking` tries again.
                Err(_) if self.driven.has_braked() => Ok(Ok(None)),
                Err(_) => Err(error),
            },
            Err(error) if self.rejoins && self.is_changed && is_refused(&error) => {
                refused = Some(match error {
                    DriveError::Halted { why, .. } => why.to_string(),
                    other => other.to_string(),
                });
                Ok(Ok(None))
            }
            other => Ok(Ok(other?)),
        };
        for event in events {
            match &event {
                Event::Progress { at_s } => self.now_s = *at_s,
                Event::Pausing { rests_s } => (self.is_paused, self.rests_from_s) = (true, *rests_s),
                Event::Resuming { .. } => self.is_paused = false,
                Event::Tempo { rate, .. } => {
                    self.is_changed = true;
                    if *rate != self.tempo {
                        self.keep(self.followed.clone());
                    }
                    self.tempo = *rate;
                }
                Event::Failed { .. } if stepped.is_ok() => continue,
                // The schedule starts a motion that a client has begun already, for example.
                Event::Refused { command: Command::Resume, .. } if self.is_running() => {
                    tell(Happened::Live(LiveEvent::AlreadyRuns));
                    continue;
                }
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
        if let Some(why) = refused {
            if let Some(dropped) = self.waiting.take() {
                let why = "the motion that it was to change is taken back; ask for it again";
                dropped.answers.into_iter().for_each(|(command, _)| refuse(command, &why, tell));
            }
            self.taking_back = Some(why);
            self.take_back(self.tempo, tell);
        }
        if ended.is_none() {
            self.after_braking(tell);
            if let Some(pending_change) = self.waiting.take() {
                self.change(pending_change, tell);
            }
        }
        Ok(ended)
    }

    /// Whether a stop without a time waits to be given to the session.
    fn is_stop_pending(&self) -> bool {
        self.commands.iter().any(|(command, at)| is_stop(*command) && at.is_none())
    }

    /// Lets motors join the motion again that braked while something else was done.
    fn after_braking(&mut self, tell: Tell<'_>) {
        if self.waiting.is_some() || !self.driven.has_braked() || self.is_stop_pending() {
            return;
        }
        if !self.rejoins || self.tries_to_rejoin >= MOST_REJOIN_STEPS {
            return self.commands.push_back((Command::Stop, None));
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

    /// The planner has refused a part of the motion long after a change, and the motors have braked: they join the last motion before it that keeps to
    /// the limits, at its tempo. If there is none, they rest where they stand, with the first tempo; `tempo` is the one that is known.
    fn take_back(&mut self, mut tempo: f64, tell: Tell<'_>) {
        self.follow_at_s = None;
        while let Some(EarlierMotion { desk, tempo: its_tempo }) = self.earlier.pop() {
            let (Ok(program), Some(rate)) = (desk.program(), Rate::of(its_tempo)) else { continue };
            let is_sound = matches!(self.driven.ceiling_at(&change(Arc::clone(&program), None), rate), Ok(None));
            (self.desk, self.followed, tempo) = (desk.clone(), desk, its_tempo);
            self.followed_program = Some(Arc::clone(&program));
            if is_sound {
                return self.change(PendingChange { tempo: Some(tempo), ..PendingChange::alone(program) }, tell);
            }
        }
        let resting = self.driven.resting().ok().and_then(|positions| self.desk.resting_at(&positions).ok());
        match resting {
            Some(resting) => {
                let alone = PendingChange::alone(Arc::new(resting));
                let resting = PendingChange { is_parked: true, tempo: Some(tempo), ..alone };
                self.change(resting, tell);
            }
            None => self.commands.push_back((Command::Stop, None)),
        }
    }

    fn tell_rejoined(&mut self, (from_s, until_s): (f64, f64), tell: Tell<'_>) {
        self.rejoined += 1;
        tell(Happened::Live(LiveEvent::Rejoined { from_s, until_s, times: self.rejoined }));
    }

    /// Tells if what was wanted for a tick begins later, at `from_s` of the motion.
    fn tell_late(&self, wanted: Option<u64>, from_s: f64, tell: Tell<'_>) {
        let Some(wanted_s) = wanted.map(|wanted| self.driven.seconds_at(wanted)) else { return };
        if from_s > wanted_s + LATE_S {
            tell(Happened::Live(LiveEvent::Late { wanted_s, by_s: from_s - wanted_s }));
        }
    }

    fn ticks(&self, seconds: f64) -> u64 {
        self.driven.tick_at(seconds) - self.driven.zero()
    }

    /// Asks for the changes whose tick is near.
    fn begin_timed<O: Observer>(&mut self, caller: &mut Caller<'_, O>) -> Result<Option<Ended>, DriveError> {
        while let Some(first) = self.timed.first() {
            let (tick, is_checked) = (first.tick, first.is_checked);
            let left = tick.saturating_sub(self.driven.earliest());
            let is_alone = self.waiting.as_ref().is_none_or(|waiting| waiting.at == Some(tick));
            if left > self.ticks(LOOK_S) || !is_alone || (left > self.ticks(ASK_S) && is_checked) {
                return Ok(None);
            }
            if left > self.ticks(ASK_S) {
                self.timed[0].is_checked = true;
                let requests = self.timed[0].requests.clone();
                let (gathered, _) = self.gather(&requests, Some(tick), None::<&mut Caller<'_, O>>)?;
                if matches!(self.verdict(&gathered), Ok(Ok(_))) {
                    return Ok(None);
                }
                // The nearest value that holds takes time to find.
            }
            let TimedRequests { requests, .. } = self.timed.remove(0);
            if let Some(ended) = self.together(&requests, (Some(tick), Some(tick)), caller)? {
                return Ok(Some(ended));
            }
        }
        Ok(None)
    }

    /// Makes one change of all that is asked, from tick `at` on. It was `wanted` for that tick, or for one that is too near.
    fn together<O: Observer>(
        &mut self,
        requests: &[Request],
        (at, wanted): (Option<u64>, Option<u64>),
        caller: &mut Caller<'_, O>,
    ) -> Result<Option<Ended>, DriveError> {
        let (stops, others): (Vec<_>, Vec<_>) =
            requests.iter().cloned().partition(|request| stop_of(request).is_some());
        self.commands.extend(stops.iter().filter_map(stop_of).map(|stop| (stop, at)));
        if !stops.is_empty() && at.is_none() {
            others.into_iter().for_each(|request| (caller.tell)(refusal(request, &"a stop came with it")));
            return Ok(None);
        }
        let requests = &self.set_apart(&others, caller.tell)[..];
        let (mut gathered, _) = self.gather(requests, at, None::<&mut Caller<'_, O>>)?;
        // Values may be too much one by one, and hold together. If they do not, each is looked at.
        let program = match self.verdict(&gathered) {
            Ok(Ok(program)) => Ok(program),
            Ok(Err(_)) | Err(_) => {
                let (again, interruption) = self.gather(requests, at, Some(&mut *caller))?;
                match interruption {
                    None => {}
                    Some(Interruption::Ended(ended)) => return Ok(Some(ended)),
                    Some(Interruption::StopWaits) => {
                        let refused =
                            requests.iter().cloned().map(|request| refusal(request, &"a stop came meanwhile"));
                        refused.for_each(&mut *caller.tell);
                        return Ok(None);
                    }
                }
                gathered = again;
                gathered.program()
            }
        };
        let tell = &mut *caller.tell;
        gathered.refusals.drain(..).for_each(&mut *tell);
        self.commands.extend(gathered.commands.iter().map(|command| (*command, at)));
        let tempo = gathered.tempo.map(|rate| (rate, Command::Tempo { rate }));
        let program = match program {
            Ok(program) => program,
            Err(error) => {
                gathered.answers.into_iter().for_each(|(command, _)| refuse(command, &error, tell));
                self.commands.extend(tempo.map(|(_, command)| (command, at)));
                return Ok(None);
            }
        };
        self.desk = gathered.desk;
        if gathered.place.is_some() {
            (self.joining, self.halted_at) = (None, None);
        }
        if let Some(follow) = gathered.follow {
            self.follow_at_s =
                follow.map(|follow| at.map_or(self.now_s, |at| self.driven.seconds_at(at)) + follow.seconds());
        }
        let Some(program) = program.filter(|_| gathered.is_moving) else {
            self.commands.extend(tempo.map(|(_, command)| (command, at)));
            if tempo.is_some() || !gathered.commands.is_empty() {
                self.tell_late(wanted, self.driven.seconds_at(self.driven.earliest()), tell);
            }
            if !gathered.answers.is_empty() {
                (self.followed, self.followed_program) = (self.desk.clone(), None);
            }
            for (_, mut event) in gathered.answers {
                set_times(&mut event, (self.now_s, self.now_s));
                tell(Happened::Live(event));
            }
            return Ok(None);
        };
        // One that is no tempo is refused where all are.
        let is_tempo = |rate: f64| Rate::of(rate).is_some_and(|rate| rate != Rate::ZERO);
        let (with, without) = tempo.map_or((None, None), |(rate, command)| match is_tempo(rate) {
            true => (Some(rate), None),
            false => (None, Some(command)),
        });
        self.commands.extend(without.map(|command| (command, at)));
        let (over, answers, is_parked) = (gathered.over, gathered.answers, gathered.is_parked);
        self.pending_change(PendingChange { program, over, answers, is_parked, at, wanted, tempo: with }, tell);
        Ok(None)
    }

    /// Does what is no change of the motion, or what waits for the motors to join it. Gives the rest.
    fn set_apart(&mut self, requests: &[Request], tell: Tell<'_>) -> Vec<Request> {
        let mut left = Vec::with_capacity(requests.len());
        for request in requests {
            match request {
                Request::Live(LiveCommand::Go | LiveCommand::Back | LiveCommand::Cue { .. })
                    if self.joining.is_some() =>
                {
                    self.joining.iter_mut().for_each(|joining| joining.then.push(request.clone()));
                }
                Request::Session(Command::Resume) if self.joining.is_some() => {}
                Request::Session(Command::Resume) if self.is_parked && self.halted_at.is_some() => {
                    let answer = (LiveCommand::Begin, LiveEvent::Returned { from_s: 0.0, until_s: 0.0 });
                    let at = self.halted_at.take().unwrap_or_default();
                    let shifts = self.shifts.take();
                    self.joining = Some(Joining { at, shifts, answer: Some(answer), then: Vec::new() });
                }
                Request::Live(LiveCommand::Begin) => self.begin(tell),
                Request::Live(LiveCommand::Rest { in_place, until }) if *in_place || self.is_parked => {
                    if !self.is_parked && !self.is_paused {
                        self.commands.push_back((Command::Pause, None));
                    }
                    tell(Happened::Live(LiveEvent::Resting { until: until.clone() }));
                }
                Request::Live(command @ LiveCommand::Here { .. }) => {
                    refuse(command.clone(), &"the motors' positions are known: the board counts their steps", tell);
                }
                other => left.push(other.clone()),
            }
        }
        left
    }

    /// Whether the motors follow the motion, and will go on to do so.
    fn is_running(&self) -> bool {
        let is_stopped = self.is_stopping || self.is_stop_pending();
        !is_stopped && !self.is_paused && !self.is_parked && !self.driven.has_ended()
    }

    /// Whether all motors have come to the end of the motion, and nothing else is asked for.
    fn has_ended(&self) -> bool {
        self.waiting.is_none() && self.driven.has_ended()
    }

    /// Says once that the motion has ended.
    fn tell_end(&mut self, tell: Tell<'_>) {
        let has_ended = self.driven.has_ended();
        self.end_is_known &= has_ended;
        let is_over = has_ended && self.waiting.is_none() && self.joining.is_none() && !self.driven.is_changing();
        if is_over && !self.end_is_known && !self.is_stopping {
            self.end_is_known = true;
            tell(Happened::Live(LiveEvent::MotionEnded { at_s: self.now_s }));
        }
    }

    /// Lets motors that rest begin the motion, from its beginning.
    fn begin(&mut self, tell: Tell<'_>) {
        let will_rest = self.waiting.as_ref().map_or(self.is_parked, |waiting| waiting.is_parked);
        if self.is_paused {
            let why = "the motion is paused: `resume` goes on with it; `goto 0` brings the motors to where it begins";
            return refuse(LiveCommand::Begin, &why, tell);
        }
        if self.is_stopping || self.is_stop_pending() {
            return refuse(LiveCommand::Begin, &"a client has stopped the motors, and the session ends", tell);
        }
        if !(will_rest || self.has_ended()) {
            return tell(Happened::Live(LiveEvent::AlreadyRuns));
        }
        self.desk = self.desk.restarted();
        self.halted_at = None;
        let answer = (LiveCommand::Begin, LiveEvent::Began { from_s: 0.0, until_s: 0.0 });
        let (at, shifts) = (Time::ZERO, Some(Vec::new()));
        self.joining = Some(Joining { at, shifts, answer: Some(answer), then: Vec::new() });
    }

    /// Lets motors that rest follow the motion, if they are to.
    fn join<O: Observer>(&mut self, caller: &mut Caller<'_, O>) -> Result<Option<Ended>, DriveError> {
        let Some(Joining { at, ref shifts, .. }) = self.joining else { return Ok(None) };
        if self.waiting.is_some() || !self.commands.is_empty() {
            return Ok(None);
        }
        match self.driven.set_law_time(at, shifts.as_deref()) {
            Err(SessionError::Waiting { .. }) => return Ok(None),
            Err(error) => {
                if let Some((command, _)) = self.joining.take().and_then(|joining| joining.answer) {
                    refuse(command, &self.driven.why(error), caller.tell);
                }
                return Ok(None);
            }
            Ok(()) => {}
        }
        let Some(Joining { answer, then, .. }) = self.joining.take() else { return Ok(None) };
        if let Some((command, event)) = answer {
            match self.desk.program() {
                Ok(program) => {
                    let answers = vec![(command, event)];
                    let joined = PendingChange { answers, ..PendingChange::alone(program) };
                    self.pending_change(joined, caller.tell);
                }
                Err(error) => refuse(command, &error, caller.tell),
            }
        }
        if then.is_empty() { Ok(None) } else { self.together(&then, (None, None), caller) }
    }

    /// What is asked, as one change. With `search` each part is held against the limits: knobs go to the nearest value that keeps to them while the
    /// motion goes on, and cues and files are refused.
    fn gather<O: Observer>(
        &mut self,
        requests: &[Request],
        at: Option<u64>,
        mut search: Option<&mut Caller<'_, O>>,
    ) -> Result<(Gathered, Option<Interruption>), DriveError> {
        let mut gathered = Gathered {
            desk: self.desk.clone(),
            place: None,
            is_parked: self.is_parked,
            is_moving: false,
            over: None,
            answers: Vec::new(),
            refusals: Vec::new(),
            tempo: None,
            commands: Vec::new(),
            follow: None,
        };
        for request in requests {
            let command = match request {
                Request::Session(Command::Resume) if gathered.is_parked && !self.is_paused => {
                    let command = LiveCommand::Goto { position: THE_MOTION.to_owned() };
                    gathered.changes(None, (command, LiveEvent::Returned { from_s: 0.0, until_s: 0.0 }));
                    continue;
                }
                Request::Session(Command::Tempo { rate }) => {
                    gathered.tempo = Some(*rate);
                    continue;
                }
                Request::Session(command) => {
                    gathered.commands.push(*command);
                    continue;
                }
                Request::Live(command) => command.clone(),
                Request::Together(_) => continue,
            };
            match &command {
                LiveCommand::Set { knob, value } => {
                    let search = search.as_deref_mut();
                    let interruption = self.gather_knob(&mut gathered, &command, (knob, value), search)?;
                    if interruption.is_some() {
                        return Ok((gathered, interruption));
                    }
                }
                LiveCommand::Goto { .. } | LiveCommand::Rest { .. } => gather_place(&mut gathered, command),
                LiveCommand::Motion { text, files } => self.gather_file(&mut gathered, text, files, search.is_some()),
                // Done before.
                LiveCommand::Begin | LiveCommand::Here { .. } => {}
                LiveCommand::Go | LiveCommand::Back | LiveCommand::Cue { .. } => {
                    self.gather_cue(&mut gathered, command, at, search.is_some());
                }
            }
        }
        Ok((gathered, None))
    }

    /// Turns a knob: to the nearest value that the motors follow.
    fn gather_knob<O: Observer>(
        &mut self,
        gathered: &mut Gathered,
        command: &LiveCommand,
        (knob, value): (&str, &KnobValue),
        search: Option<&mut Caller<'_, O>>,
    ) -> Result<Option<Interruption>, DriveError> {
        let refuse = |gathered: &mut Gathered, why: &dyn std::fmt::Display| {
            gathered.refusals.push(refusal(Request::Live(command.clone()), &why.to_string()));
        };
        let turn = match gathered.desk.turn(knob, value) {
            Ok(turn) => turn,
            Err(error) => {
                refuse(gathered, &error);
                return Ok(None);
            }
        };
        let (mut set, mut ceiling) = (turn.to, turn.range.clone());
        let mut desk = gathered.desk.turned(&turn, set);
        if let Some(caller) = search {
            match self.ceiling_of_turn(&gathered.desk, &turn) {
                Ok(None) => {}
                Ok(Some((to, limit))) => {
                    let nearest = Nearest::new(turn.from, to);
                    let found = match self.nearest(&gathered.desk, &turn, (nearest, limit), caller)? {
                        Ok(found) => found,
                        Err(interruption) => return Ok(Some(interruption)),
                    };
                    set = found.0;
                    desk = gathered.desk.turned(&turn, set);
                    // Limits may have changed since the motors began to follow the present value.
                    if set == turn.from && !matches!(self.allowed(&desk, turn.over), Ok(None)) {
                        let (from, to, limit) = (turn.from, turn.to, found.1);
                        let why = format!("{limit}: no value between {from} and {to} {} keeps to it", turn.unit);
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
        gathered.desk = desk;
        let event =
            LiveEvent::Set { knob: knob.to_owned(), value: set, unit: turn.unit, ceiling, from_s: 0.0, until_s: 0.0 };
        gathered.adds(turn.over, (command.clone(), event));
        Ok(None)
    }

    /// The limit that the wanted value of a knob would break, and that value; `None` if the motors follow it. Of a value that the reader refuses for its
    /// size, a smaller one is looked at.
    #[allow(clippy::type_complexity)]
    fn ceiling_of_turn(&self, desk: &Desk, turn: &Turn) -> Result<Option<(f64, String)>, Box<dyn std::error::Error>> {
        let look = |value: f64| Ok(self.allowed(&desk.turned(turn, value), turn.over)?.map(|limit| (value, limit)));
        let smaller = turn.to.clamp(-FARTHEST_VALUE, FARTHEST_VALUE);
        match look(turn.to) {
            Err(error) if smaller != turn.to => match look(smaller) {
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
        desk: &Desk,
        turn: &Turn,
        (mut nearest, mut limit): (Nearest, String),
        caller: &mut Caller<'_, O>,
    ) -> Result<Result<(f64, String), Interruption>, DriveError> {
        let step = desk.step_in_unit(turn);
        while let Some(mut value) = nearest.next() {
            if (caller.stop_waits)(self.driven.now()) {
                return Ok(Err(Interruption::StopWaits));
            }
            if let Some(ended) = self.pass(caller.observer, caller.tell)? {
                return Ok(Err(Interruption::Ended(ended)));
            }
            if turn.is_whole {
                let Some(whole) = nearest.whole(value, 1.0) else { break };
                value = whole;
            }
            let mut looked = self.allowed(&desk.turned(turn, value), turn.over);
            // The reader may refuse what lies between, such as a swing of half a step.
            if let (Err(_), Some(step)) = (&looked, step) {
                let Some(whole) = nearest.whole(value, step) else { break };
                value = whole;
                looked = self.allowed(&desk.turned(turn, value), turn.over);
            }
            nearest.note(value, matches!(looked, Ok(None)));
            if let Ok(Some(broken)) = looked {
                limit = broken;
            }
        }
        Ok(Ok((nearest.found(), limit)))
    }

    /// Goes to a cue.
    fn gather_cue(&self, gathered: &mut Gathered, command: LiveCommand, at: Option<u64>, is_checked: bool) {
        let begins = match at {
            Some(at) => self.driven.law_time_at(at),
            None => self.driven.law_time() + Time::from_seconds(CUE_LEAD_S),
        };
        let found = match &command {
            LiveCommand::Cue { name } => gathered.desk.at_cue(name, begins),
            LiveCommand::Back => gathered.desk.at_other_cue(false, begins),
            _ => gathered.desk.at_other_cue(true, begins),
        };
        let (desk, cue) = match found {
            Ok(found) => found,
            Err(error) => return gathered.refusals.push(refusal(Request::Live(command), &error)),
        };
        if is_checked {
            let why = match self.allowed(&desk, cue.fade) {
                Ok(None) => None,
                Ok(Some(limit)) => Some(format!("cue \"{}\" would break a limit: {limit}", cue.name)),
                Err(error) => Some(error.to_string()),
            };
            if let Some(why) = why {
                return gathered.refusals.push(refusal(Request::Live(command), &why));
            }
        }
        gathered.follow = Some(cue.follow.filter(|_| desk.has_cue_after(&cue)));
        gathered.desk = desk;
        gathered.changes(cue.fade, (command, LiveEvent::Cue { name: cue.name, from_s: 0.0, until_s: 0.0 }));
    }

    fn gather_file(&self, gathered: &mut Gathered, text: &str, files: &FileTexts, is_checked: bool) {
        let desk = match with_file(&gathered.desk, text, files) {
            Ok(None) => return,
            Ok(Some(desk)) => desk,
            Err(refused) => return gathered.refusals.push(Happened::Live(refused)),
        };
        if is_checked {
            let why = match self.allowed(&desk, None) {
                Ok(None) => None,
                Ok(Some(limit)) => Some(format!("the motion would break a limit: {limit}")),
                Err(error) => Some(error.to_string()),
            };
            if let Some(error) = why {
                let refused = LiveEvent::MotionRefused { error, line: None, column: None };
                return gathered.refusals.push(Happened::Live(refused));
            }
        }
        gathered.desk = desk;
        let command = LiveCommand::Motion { text: String::new(), files: FileTexts::new() };
        gathered.adds(None, (command, LiveEvent::Motion { from_s: 0.0, until_s: 0.0 }));
    }

    /// The limit that the motors would break at a desk, or why the reader refuses it.
    fn allowed(&self, desk: &Desk, over: Option<Time>) -> Result<Option<String>, Box<dyn std::error::Error>> {
        self.ceiling_of(&change(desk.program()?, over))
    }

    /// The limit that a change would break, or why it cannot be looked for.
    fn ceiling_of(&self, change: &Change) -> Result<Option<String>, Box<dyn std::error::Error>> {
        Ok(self.driven.ceiling_of(change).map_err(|error| self.driven.why(error))?)
    }

    /// The program that the motors follow if they do all that is asked; `None` if they go on as they are. Or the limit that they would break, or why
    /// the reader refuses it.
    #[allow(clippy::type_complexity)]
    fn verdict(&self, gathered: &Gathered) -> Result<Result<Option<Arc<Program>>, String>, Box<dyn std::error::Error>> {
        let program = gathered.program()?;
        // Motors that rest at a position, and those that come back from it, break nothing.
        let is_goto = |(command, _): &(LiveCommand, LiveEvent)| {
            matches!(command, LiveCommand::Goto { .. } | LiveCommand::Rest { .. })
        };
        if gathered.answers.iter().all(is_goto) {
            return Ok(Ok(program));
        }
        let ceiling = match (&program, &gathered.place) {
            (Some(program), None) => self.ceiling_of(&change(Arc::clone(program), gathered.over))?,
            _ => self.allowed(&gathered.desk, gathered.over)?,
        };
        Ok(ceiling.map_or(Ok(program), Err))
    }

    /// Changes to what is wished, after what waits: the last pending_change has all that was asked for before.
    fn pending_change(&mut self, mut pending_change: PendingChange, tell: Tell<'_>) {
        if let Some(mut before) = self.waiting.take() {
            before.answers.retain(|(command, _)| !is_set_again(command, &pending_change.answers));
            pending_change.answers.splice(0..0, before.answers);
            pending_change.at = pending_change.at.or(before.at);
            pending_change.wanted = pending_change.wanted.or(before.wanted);
            pending_change.tempo = pending_change.tempo.or(before.tempo);
        }
        self.change(pending_change, tell);
    }

    fn change(&mut self, pending_change: PendingChange, tell: Tell<'_>) {
        // It is asked for shortly before its tick: until then the motors can change to something else.
        if pending_change.at.is_some_and(|at| at > self.driven.earliest() + self.ticks(ASK_S)) {
            self.waiting = Some(pending_change);
            return;
        }
        let has_braked = self.driven.has_braked();
        let mut change = change(Arc::clone(&pending_change.program), pending_change.over);
        if pending_change.is_parked {
            change.begins = Begins::Now;
        }
        self.driven.hold_changes_until(pending_change.at);
        let changed = self.driven.change_with_tempo(&change, pending_change.tempo.and_then(Rate::of));
        self.driven.hold_changes_until(self.held_until);
        match changed {
            Ok((times, tempo)) => {
                self.follow(&pending_change, tempo.as_ref());
                self.is_parked = pending_change.is_parked;
                self.rests_from_s = times.1;
                let takes_back = self.taking_back.is_some();
                if let Some(why) = self.taking_back.take() {
                    let (from_s, until_s) = times;
                    let rests = pending_change.is_parked;
                    tell(Happened::Live(LiveEvent::TakenBack { why, rests, from_s, until_s }));
                } else if has_braked {
                    self.tell_rejoined(times, tell);
                }
                for (_, mut event) in pending_change.answers {
                    set_times(&mut event, times);
                    tell(Happened::Live(event));
                }
                self.tell_late(pending_change.wanted, times.0, tell);
                if let Some(event) = tempo {
                    let is_known = matches!(event, Event::Tempo { rate, .. } if rate == self.tempo) && takes_back;
                    if let Event::Tempo { rate, .. } = &event {
                        (self.tempo, self.is_changed) = (*rate, true);
                    }
                    if !is_known {
                        tell(Happened::Session(event));
                    }
                }
            }
            Err(SessionError::Waiting { .. }) => self.waiting = Some(pending_change),
            // This computer was too slow just now: the motors brake, and join these laws then.
            Err(error) if self.rejoins && self.driven.has_braked() && !is_of_laws(&error) => {
                self.waiting = Some(pending_change);
            }
            // The limits may leave no room for both at once: one after the other then.
            Err(_) if pending_change.tempo.is_some() && self.taking_back.is_none() => {
                let mut laws_alone = pending_change;
                let tempo = laws_alone.tempo.take().map(|rate| (Command::Tempo { rate }, laws_alone.at));
                self.commands.extend(tempo);
                self.change(laws_alone, tell);
            }
            Err(error) => {
                self.desk = self.followed.clone();
                self.follow_at_s = None;
                let why = self.driven.why(error);
                for (command, _) in pending_change.answers {
                    refuse(command, &why, tell);
                }
                match self.taking_back {
                    None => {}
                    Some(_) if pending_change.is_parked => self.commands.push_back((Command::Stop, None)),
                    Some(_) => self.take_back(pending_change.tempo.unwrap_or(self.tempo), tell),
                }
            }
        }
    }

    /// Notes what the motors follow after a change, and keeps what they followed before if that was another motion.
    fn follow(&mut self, change: &PendingChange, tempo: Option<&Event>) {
        let before = std::mem::replace(&mut self.followed, self.desk.clone());
        // What is taken back is no earlier motion.
        if change.answers.is_empty() {
            return;
        }
        self.is_changed = true;
        let is_place = |(command, _): &(LiveCommand, LiveEvent)| {
            matches!(command, LiveCommand::Rest { .. })
                || matches!(command, LiveCommand::Goto { position } if position != THE_MOTION)
        };
        let is_other_tempo = matches!(tempo, Some(Event::Tempo { rate, .. }) if *rate != self.tempo);
        if change.answers.iter().all(is_place) && !is_other_tempo {
            return;
        }
        let program = if change.is_parked { None } else { Some(Arc::clone(&change.program)) };
        let program_before = std::mem::replace(&mut self.followed_program, program);
        let program_before = program_before.map_or_else(|| before.program(), Ok);
        // The motors may come back to the motion that they left, or join it again.
        let is_same =
            matches!((&program_before, &self.followed_program), (Ok(one), Some(other)) if is_same_motion(one, other));
        if is_other_tempo || !is_same {
            self.keep(before);
        }
    }

    /// Keeps a motion that was followed at the present tempo, for a change that has to be taken back.
    fn keep(&mut self, desk: Desk) {
        if self.earlier.len() == MOST_EARLIER {
            self.earlier.remove(1);
        }
        self.earlier.push(EarlierMotion { desk, tempo: self.tempo });
    }
}

/// What the caller of a step gives: an observer of edges, a listener for events, and whether a stop waits.
struct Caller<'a, O> {
    observer: &'a mut O,
    tell: Tell<'a>,
    stop_waits: StopWaits<'a>,
}

/// Why the search for a knob's nearest value was given up.
enum Interruption {
    /// The motion has ended.
    Ended(Ended),
    /// A stop waits to be obeyed.
    StopWaits,
}

impl PendingChange {
    /// A change that answers no request, as soon as it can.
    fn alone(program: Arc<Program>) -> PendingChange {
        let (over, answers, is_parked) = (None, Vec::new(), false);
        PendingChange { program, over, answers, is_parked, at: None, wanted: None, tempo: None }
    }
}

/// What requests ask for, as one change.
struct Gathered {
    /// The motion as it is wanted then.
    desk: Desk,
    /// The motors at rest at a position, if the last of the requests is that.
    place: Option<Arc<Program>>,
    is_parked: bool,
    /// Whether the motors change to other laws.
    is_moving: bool,
    over: Option<Time>,
    answers: Vec<(LiveCommand, LiveEvent)>,
    refusals: Vec<Happened>,
    tempo: Option<f64>,
    /// What the session does besides.
    commands: Vec<Command>,
    /// The time until the next cue, if a cue or a position changes it.
    follow: Option<Option<Time>>,
}

impl Gathered {
    /// Adds what the motors change to, wherever they are.
    fn changes(&mut self, over: Option<Time>, answer: (LiveCommand, LiveEvent)) {
        (self.place, self.is_parked) = (None, false);
        self.adds(over, answer);
    }

    /// The program that the motors follow then; `None` if that does not change.
    fn program(&self) -> Result<Option<Arc<Program>>, ChangeRefusal> {
        match &self.place {
            Some(program) => Ok(Some(Arc::clone(program))),
            None if self.answers.is_empty() => Ok(None),
            None => self.desk.program().map(Some),
        }
    }

    /// Adds a value. Motors that were sent to a position stay there: it counts when they come back.
    fn adds(&mut self, over: Option<Time>, answer: (LiveCommand, LiveEvent)) {
        self.is_moving |= !self.is_parked;
        self.over = self.over.max(over);
        self.answers.retain(|(command, _)| !is_set_again(command, std::slice::from_ref(&answer)));
        self.answers.push(answer);
    }
}

/// Whether a knob was turned again before the motors followed its value: the last value is what they do.
fn is_set_again(command: &LiveCommand, later: &[(LiveCommand, LiveEvent)]) -> bool {
    let LiveCommand::Set { knob, .. } = command else { return false };
    later.iter().any(|(later, _)| matches!(later, LiveCommand::Set { knob: again, .. } if again == knob))
}

/// Brings the motors to rest at a position, or where the motion begins.
fn gather_place(gathered: &mut Gathered, command: LiveCommand) {
    let (position, event) = match &command {
        LiveCommand::Goto { position } => {
            (position.clone(), LiveEvent::Goto { position: position.clone(), from_s: 0.0, until_s: 0.0 })
        }
        LiveCommand::Rest { until, .. } => ("0".to_owned(), LiveEvent::Resting { until: until.clone() }),
        _ => return,
    };
    match gathered.desk.at_position(&position) {
        Ok(program) => {
            gathered.changes(None, (command, event));
            (gathered.place, gathered.is_parked, gathered.follow) = (Some(program), true, Some(None));
        }
        Err(error) => gathered.refusals.push(refusal(Request::Live(command), &error)),
    }
}

/// A motion without a board.
pub struct SuspendedShow {
    desk: Desk,
    is_parked: bool,
    is_halted: bool,
    /// When the board was lost.
    law_time: Time,
    shifts: Option<Vec<Shift>>,
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
        SuspendedShow {
            desk,
            is_parked,
            is_halted: false,
            law_time,
            shifts: Some(Vec::new()),
            tempo: 1.0,
            rejoins,
            rejoined: 0,
            is_new: true,
        }
    }

    /// The motion as it is wanted.
    #[must_use]
    pub fn desk(&self) -> &Desk {
        &self.desk
    }

    /// Notes what is asked meanwhile: a changed motion file, and what the schedule says. All else is refused.
    pub fn obey(&mut self, request: Request, tell: Tell<'_>) {
        request.each().into_iter().for_each(|request| self.obey_one(request, tell));
    }

    fn obey_one(&mut self, request: Request, tell: Tell<'_>) {
        const AWAY: &str = "the board cannot be reached, or the positions of the motors are not known";
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
                self.shifts = Some(Vec::new());
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
            Request::Together(_) => {}
        }
    }

    /// The motion in a new session with the board. The motors rest there, at the positions of `program`. If they did not rest before the board was lost, they
    /// join the motion; `passed_s` is how long the board was away, s.
    #[must_use]
    pub fn rejoin_on<B: Leased>(mut self, driven: Driven<B>, program: &Program, passed_s: f64) -> Show<B> {
        self.desk.set_up(program);
        let mut show = Show::at_rest(driven, self.desk, self.rejoins);
        show.tempo = self.tempo;
        if self.tempo != 1.0 {
            show.commands.push_back((Command::Tempo { rate: self.tempo }, None));
        }
        show.rejoined = self.rejoined + u32::from(!self.is_new);
        if self.is_halted {
            (show.halted_at, show.shifts) = (Some(self.law_time), self.shifts.clone());
        }
        let at = if self.is_halted { self.law_time } else { self.law_time + Time::from_seconds(self.tempo * passed_s) };
        let event = match self.is_new {
            true => LiveEvent::Returned { from_s: 0.0, until_s: 0.0 },
            false => LiveEvent::Rejoined { from_s: 0.0, until_s: 0.0, times: show.rejoined },
        };
        let joins = !self.is_parked && !self.is_halted;
        let answer = joins.then_some((LiveCommand::Begin, event));
        show.joining = Some(Joining { at, shifts: self.shifts, answer, then: Vec::new() });
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
    if text.len() as u64 > MOST_OF_A_MOTION_FILE {
        let [is, most] = [text.len() as u64, MOST_OF_A_MOTION_FILE].map(|bytes| human::bytes(bytes as f64));
        let error = format!("it has {is}; {most} is the most that is read");
        return Err(LiveEvent::MotionRefused { error, line: None, column: None });
    }
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

const fn is_stop(command: Command) -> bool {
    matches!(command, Command::Stop | Command::StopNow)
}

/// The stop that a request is.
const fn stop_of(request: &Request) -> Option<Command> {
    match request {
        Request::Session(command) if is_stop(*command) => Some(*command),
        _ => None,
    }
}

fn change(program: Arc<Program>, over: Option<Time>) -> Change {
    Change { program, over, begins: Begins::WithTheMotion }
}

/// Whether motors follow both in the same way: boards and wiring do not change while they run.
fn is_same_motion(one: &Arc<Program>, other: &Arc<Program>) -> bool {
    let motors = || one.motors.iter().zip(&other.motors);
    Arc::ptr_eq(one, other)
        || (motors().all(|(one, other)| one.law == other.law && one.limits == other.limits)
            && one.machines == other.machines)
}

fn refuse(command: LiveCommand, why: &impl ToString, tell: Tell<'_>) {
    tell(refusal(Request::Live(command), why));
}

fn refusal(request: Request, why: &impl ToString) -> Happened {
    let why = why.to_string();
    match request {
        Request::Live(LiveCommand::Motion { .. }) => {
            Happened::Live(LiveEvent::MotionRefused { error: why, line: None, column: None })
        }
        Request::Live(command) => Happened::Live(LiveEvent::Refused { command, why }),
        Request::Session(command) => Happened::Session(Event::Refused { command, why }),
        Request::Together(_) => Happened::Live(LiveEvent::MotionRefused { error: why, line: None, column: None }),
    }
}

/// Whether the motors braked since the host or the line was too slow, and the board has counted all the way.
fn may_rejoin(error: &DriveError) -> bool {
    let DriveError::Halted { why, positions, .. } = error else { return false };
    positions.by == Knowledge::Counted && matches!(**why, DriveError::TooLate { .. } | DriveError::QueueTooShort { .. })
}

/// Whether the planner refused a part of the motion, and the board has counted all the way.
fn is_refused(error: &DriveError) -> bool {
    let DriveError::Halted { why, positions, .. } = error else { return false };
    positions.by == Knowledge::Counted && matches!(**why, DriveError::Plan { .. })
}

/// Whether a change is refused for what its laws are, and not since this computer or the line was too slow.
const fn is_of_laws(error: &SessionError) -> bool {
    matches!(error, SessionError::Pause(_) | SessionError::Plan(_) | SessionError::Law { .. })
}

fn set_times(event: &mut LiveEvent, (from, until): (f64, f64)) {
    match event {
        LiveEvent::Set { from_s, until_s, .. }
        | LiveEvent::Cue { from_s, until_s, .. }
        | LiveEvent::Goto { from_s, until_s, .. }
        | LiveEvent::Returned { from_s, until_s }
        | LiveEvent::Began { from_s, until_s }
        | LiveEvent::Motion { from_s, until_s }
        | LiveEvent::TakenBack { from_s, until_s, .. }
        | LiveEvent::Rejoined { from_s, until_s, .. } => (*from_s, *until_s) = (from, until),
        LiveEvent::AlreadyRuns
        | LiveEvent::MotionEnded { .. }
        | LiveEvent::MotionRefused { .. }
        | LiveEvent::Refused { .. }
        | LiveEvent::Resting { .. }
        | LiveEvent::Late { .. }
        | LiveEvent::Unplugged { .. }
        | LiveEvent::Unplaced { .. }
        | LiveEvent::Placed { .. } => {}
    }
}
