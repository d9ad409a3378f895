//! A running motion that is changed by commands.
//!
//! It knows no clock and no terminal: its caller gives it commands, lets it step, and gets events. The same commands at the same ticks of a virtual board
//! make the same edges again.

use std::sync::Arc;

use pulsetrain_board::{Leased, Observer};
use pulsetrain_motion::Time;
use pulsetrain_motion::program::Program;
use pulsetrain_motion::time::Rate;
use pulsetrain_session::SessionError;
use pulsetrain_session::control::{Command, Ended, Event, Knowledge};
use pulsetrain_session::drive::{DriveError, Driven};
use pulsetrain_session::fade::{Begins, Change};

use crate::command::{Batch, RunCommand};
use crate::event::RunEvent;
use crate::setpoints::LiveSetpoints;
use gather::Interruption;
use held::{HeldCommands, MAX_TIMED, Timed};
use state::{Joining, LawPoint, RunState};
pub use suspended::SuspendedRun;

mod gather;
mod held;
mod nearest;
mod state;
mod suspended;

/// Takes events.
pub type Publish<'a> = &'a mut dyn FnMut(RunEvent);
/// Whether a stop for now waits behind the present commands, at a tick of the board.
pub type StopWaits<'a> = &'a mut dyn FnMut(u64) -> bool;

/// Steps that try to join the motion again after a stop, a hundred a second, before the motion is given up.
const MAX_REJOIN_STEPS: u32 = 3000;

/// A step of the board's time, s.
const STEP_S: f64 = 0.01;
/// A change for a tick is asked for this long before it is too late, s: some steps.
const ASK_S: f64 = 0.04;
/// It is held against the limits this long before, s: a nearer value takes `nearest::MAX_VALUES` steps to find.
const CHECK_S: f64 = 0.3;
/// A change may be for a time that is this far ahead, s.
const MAX_LOOKAHEAD_S: f64 = 60.0;
/// Motions before the last changes that are kept, for a change that has to be taken back.
const MAX_EARLIER: usize = 8;
/// A change that begins later than its tick by more than this is reported as late, s.
const LATE_S: f64 = 0.002;
/// The position of the command that stands for a way back to the motion.
pub(crate) const THE_MOTION: &str = "the motion";

/// A running motion that is changed by commands.
pub struct LiveRun<B> {
    pub(crate) driven: Driven<B>,
    /// The motion as it is wanted.
    pub(crate) setpoints: LiveSetpoints,
    history: History,
    /// What the motors do.
    pub(crate) state: RunState,
    /// Commands that are held back.
    pub(crate) held: HeldCommands,
    /// A change that waits until another one has begun.
    waiting: Option<PendingChange>,
    /// Changes begin at this tick: that of the session's last command.
    changes_at: Option<u64>,
    pub(crate) rejoining: Rejoining,
    /// The tempo that was asked for last.
    pub(crate) tempo: f64,
    /// When the next cue begins without an order, s of the motion.
    follow_at_s: Option<f64>,
    now_s: f64,
    /// Whether clients know that all motors have come to the end of the motion.
    is_end_published: bool,
}

/// What the motors follow, and followed before.
struct History {
    /// What they follow, or change to.
    followed: LiveSetpoints,
    /// The program of `followed`; `None` if it was not read yet.
    program: Option<Arc<Program>>,
    /// What they followed before each of the last changes, oldest first. The oldest of all is never forgotten.
    earlier: Vec<EarlierMotion>,
    /// Whether the motion was ever changed.
    is_changed: bool,
}

/// A motion that the motors followed, for a change that has to be taken back.
struct EarlierMotion {
    setpoints: LiveSetpoints,
    tempo: f64,
}

/// How motors that braked since the host was too slow join the motion again.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rejoining {
    /// Whether they do.
    pub(crate) is_allowed: bool,
    /// How many times they have.
    pub(crate) times: u32,
    /// How many steps in a row tried it in vain.
    tries: u32,
}

/// A change of the motors' laws that was asked for.
pub(crate) struct PendingChange {
    program: Arc<Program>,
    over: Option<Time>,
    /// What was asked for, and the event that answers it. Empty if the planner takes a change back.
    answers: Vec<(RunCommand, RunEvent)>,
    is_parked: bool,
    /// The first tick; `None`: as soon as it can.
    at: Option<u64>,
    /// The tick for which it was asked, perhaps too late.
    wanted: Option<u64>,
    /// The tempo from that tick on, if it changes.
    tempo: Option<f64>,
}

impl<B: Leased> LiveRun<B> {
    /// A motion that is about to begin. With `rejoins` motors that braked since the host was too slow join it again.
    #[must_use]
    pub fn new(driven: Driven<B>, setpoints: LiveSetpoints, rejoins: bool) -> LiveRun<B> {
        LiveRun {
            driven: driven.staying().looking_often(),
            history: History { followed: setpoints.clone(), program: None, earlier: Vec::new(), is_changed: false },
            setpoints,
            state: RunState::Running,
            held: HeldCommands::default(),
            waiting: None,
            changes_at: None,
            rejoining: Rejoining { is_allowed: rejoins, times: 0, tries: 0 },
            tempo: 1.0,
            follow_at_s: None,
            now_s: 0.0,
            is_end_published: false,
        }
    }

    /// A motion whose motors rest where they are until it is to begin: [`RunCommand::Begin`], or [`RunCommand::Resume`].
    #[must_use]
    pub fn at_rest(driven: Driven<B>, setpoints: LiveSetpoints, rejoins: bool) -> LiveRun<B> {
        LiveRun { state: RunState::at_rest(), ..LiveRun::new(driven, setpoints, rejoins) }
    }

    /// Whether all motors rest until somebody asks for the motion.
    #[must_use]
    pub fn is_resting(&self) -> bool {
        self.state.is_resting(self.now_s)
    }

    /// Whether the motors rejoin the motion after a failure. They do not if a client has asked for a stop: the run does not wait for the board then.
    #[must_use]
    pub fn rejoins(&self) -> bool {
        self.rejoining.is_allowed && !self.state.is_stopping() && !self.held.has_stop()
    }

    /// How far the laws' time is, at most.
    pub fn law_time(&self) -> Time {
        self.driven.law_time()
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
    pub fn setpoints(&self) -> &LiveSetpoints {
        &self.setpoints
    }

    /// The run below, when it is over.
    #[must_use]
    pub fn into_driven(self) -> Driven<B> {
        self.driven
    }

    /// Does what commands ask for, or publishes why not. For a value that is too much the nearest one is searched; the motion goes on meanwhile. Returns how
    /// the motion ended, if it did.
    ///
    /// # Errors
    /// As [`LiveRun::step`].
    pub fn handle(
        &mut self,
        batch: impl Into<Batch>,
        observer: &mut impl Observer,
        publish: Publish<'_>,
    ) -> Result<Option<Ended>, DriveError> {
        self.handle_until(batch, &mut |_| false, observer, publish)
    }

    /// As [`LiveRun::handle`]. While a knob's nearest value is searched, this calls `stop_waits` before each value. If a stop waits, the commands are
    /// refused, and the caller gives the stop next.
    ///
    /// # Errors
    /// As [`LiveRun::step`].
    pub fn handle_until(
        &mut self,
        batch: impl Into<Batch>,
        stop_waits: StopWaits<'_>,
        observer: &mut impl Observer,
        publish: Publish<'_>,
    ) -> Result<Option<Ended>, DriveError> {
        let mut caller = Caller { observer, publish, stop_waits };
        let Batch { commands, at_s } = batch.into();
        let Some(at_s) = at_s else { return self.apply_batch(&commands, (None, None), &mut caller) };
        let tick = self.driven.tick_at(at_s);
        if tick <= self.driven.earliest() {
            return self.apply_batch(&commands, (None, Some(tick)), &mut caller);
        }
        let why = if at_s > self.now_s + MAX_LOOKAHEAD_S {
            format!("it is for {:.1} s from now; {MAX_LOOKAHEAD_S} s are the most", at_s - self.now_s)
        } else if self.held.hold_for_tick(tick, commands.clone()) {
            return Ok(None);
        } else {
            format!("{MAX_TIMED} changes wait for their time already")
        };
        commands.into_iter().for_each(|command| refuse(command, &why, caller.publish));
        Ok(None)
    }

    /// Lets a hundredth of a second of the board's time pass. `Some` when somebody has stopped the motion.
    ///
    /// # Errors
    /// When the motors stopped though nobody asked for it, and cannot join the motion again.
    pub fn step(&mut self, observer: &mut impl Observer, publish: Publish<'_>) -> Result<Option<Ended>, DriveError> {
        self.step_until(&mut |_| false, observer, publish)
    }

    /// As [`LiveRun::step`]. `stop_waits` is asked whether a stop waits at a tick: a stop ends the search for a knob's nearest value.
    ///
    /// # Errors
    /// As [`LiveRun::step`].
    pub fn step_until(
        &mut self,
        stop_waits: StopWaits<'_>,
        observer: &mut impl Observer,
        publish: Publish<'_>,
    ) -> Result<Option<Ended>, DriveError> {
        let ended = self.pass(observer, publish)?;
        if ended.is_some() {
            return Ok(ended);
        }
        let mut caller = Caller { observer, publish, stop_waits };
        self.publish_end(caller.publish);
        if let Some(ended) = self.join(&mut caller)? {
            return Ok(Some(ended));
        }
        if self.follow_at_s.is_some_and(|at_s| at_s <= self.now_s) && self.waiting.is_none() {
            self.follow_at_s = None;
            let ended = self.apply_batch(&[RunCommand::Go], (None, None), &mut caller)?;
            if ended.is_some() {
                return Ok(ended);
            }
        }
        self.begin_timed(&mut caller)
    }

    /// As [`LiveRun::step`]; nothing begins that was not asked of the session before.
    pub(crate) fn pass(
        &mut self,
        observer: &mut impl Observer,
        publish: Publish<'_>,
    ) -> Result<Option<Ended>, DriveError> {
        let soon = self.driven.now() + self.ticks(STEP_S);
        let command = self.held.take_for_session(soon).map(|(command, at)| {
            self.changes_at = at;
            self.driven.hold_changes_until(at);
            command
        });
        let stop = command.filter(|command| RunCommand::from(*command).is_stop());
        if stop.is_some() {
            let dropped = self.state.stop();
            self.refuse_joining(dropped, &STOPPED, publish);
        }
        let (mut events, mut refused) = (Vec::new(), None);
        let stepped = self.driven.step(command, observer, |event| events.push(event));
        let is_stopping = self.state.is_stopping();
        let Rejoining { is_allowed, tries, .. } = self.rejoining;
        let stepped = match stepped {
            // The session failed before it took the stop. The motors have braked: the next step gives it the stop again.
            Err(error)
                if is_stopping
                    && is_allowed
                    && (may_rejoin(&error) || is_refused(&error))
                    && self.driven.has_braked()
                    && tries < MAX_REJOIN_STEPS =>
            {
                self.rejoining.tries += 1;
                stop.into_iter().for_each(|stop| self.held.hold_for_session(stop, None));
                Ok(Ok(None))
            }
            Err(error) if is_stopping => Err(error),
            Err(error) if is_allowed && may_rejoin(&error) => match self.driven.rejoin() {
                Ok(times) => Ok(Err(times)),
                // It is too soon: `after_braking` tries again.
                Err(_) if self.driven.has_braked() => Ok(Ok(None)),
                Err(_) => Err(error),
            },
            Err(error) if is_allowed && self.history.is_changed && is_refused(&error) => {
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
                Event::Pausing { rests_s } => self.state.pause(*rests_s),
                Event::Resuming { .. } => self.state.resume(),
                Event::Tempo { rate, .. } => {
                    self.history.is_changed = true;
                    if *rate != self.tempo {
                        self.history.keep(self.history.followed.clone(), self.tempo);
                    }
                    self.tempo = *rate;
                }
                Event::Failed { .. } if stepped.is_ok() => continue,
                // The schedule starts a motion that a client has begun already, for example.
                Event::Refused { command: Command::Resume, .. } if self.is_running() => {
                    publish(RunEvent::AlreadyRuns);
                    continue;
                }
                _ => {}
            }
            publish(event.into());
        }
        let ended = match stepped? {
            Ok(ended) => ended,
            Err(times) => {
                self.publish_rejoined(times, publish);
                None
            }
        };
        if let Some(why) = refused {
            const DROPPED: &str = "the motion that it was to change is taken back; ask for it again";
            if let Some(dropped) = self.waiting.take() {
                dropped.answers.into_iter().for_each(|(command, _)| refuse(command, &DROPPED, publish));
            }
            let dropped = self.state.take_back(why);
            self.refuse_joining(dropped, &DROPPED, publish);
            self.take_back(self.tempo, publish);
        }
        if ended.is_none() {
            self.after_braking(publish);
            if let Some(waiting) = self.waiting.take() {
                self.change(waiting, publish);
            }
        }
        Ok(ended)
    }

    /// Refuses what the motors were to do once they had joined the motion.
    fn refuse_joining(&mut self, joining: Option<Joining>, why: &impl ToString, publish: Publish<'_>) {
        let Some(joining) = joining else { return };
        let answer = joining.answer.map(|(command, _)| command);
        let then = self.held.take_joined();
        answer.into_iter().chain(then).for_each(|command| refuse(command, why, publish));
    }

    /// Lets motors join the motion again that braked while something else was done.
    fn after_braking(&mut self, publish: Publish<'_>) {
        if self.waiting.is_some() || !self.driven.has_braked() || self.held.has_stop_for_now() {
            return;
        }
        if !self.rejoining.is_allowed || self.rejoining.tries >= MAX_REJOIN_STEPS {
            return self.held.hold_for_session(Command::Stop, None);
        }
        match self.driven.rejoin() {
            Ok(times) => {
                self.rejoining.tries = 0;
                self.publish_rejoined(times, publish);
            }
            // The next step tries again.
            Err(_) => self.rejoining.tries += 1,
        }
    }

    /// The planner has refused a part of the motion long after a change, and the motors have braked: they join the last motion before it that keeps to
    /// the limits, at its tempo. If there is none, they rest where they stand, with the first tempo; `tempo` is the one that is known.
    fn take_back(&mut self, mut tempo: f64, publish: Publish<'_>) {
        self.follow_at_s = None;
        while let Some(EarlierMotion { setpoints, tempo: its_tempo }) = self.history.earlier.pop() {
            let (Ok(program), Some(rate)) = (setpoints.program(), Rate::of(its_tempo)) else { continue };
            let is_sound = matches!(self.driven.ceiling_at(&change_to(Arc::clone(&program), None), rate), Ok(None));
            (self.setpoints, self.history.followed, tempo) = (setpoints.clone(), setpoints, its_tempo);
            self.history.program = Some(Arc::clone(&program));
            if is_sound {
                return self.change(PendingChange { tempo: Some(tempo), ..PendingChange::alone(program) }, publish);
            }
        }
        let resting = self.driven.resting().ok().and_then(|positions| self.setpoints.resting_at(&positions).ok());
        match resting {
            Some(resting) => {
                let alone = PendingChange::alone(Arc::new(resting));
                let resting = PendingChange { is_parked: true, tempo: Some(tempo), ..alone };
                self.change(resting, publish);
            }
            None => self.held.hold_for_session(Command::Stop, None),
        }
    }

    fn publish_rejoined(&mut self, (from_s, until_s): (f64, f64), publish: Publish<'_>) {
        self.rejoining.times += 1;
        publish(RunEvent::Rejoined { from_s, until_s, times: self.rejoining.times });
    }

    /// Publishes how late it is if what was wanted for a tick begins later, at `from_s` of the motion.
    fn publish_late(&self, wanted: Option<u64>, from_s: f64, publish: Publish<'_>) {
        let Some(wanted_s) = wanted.map(|wanted| self.driven.seconds_at(wanted)) else { return };
        if from_s > wanted_s + LATE_S {
            publish(RunEvent::Late { wanted_s, by_s: from_s - wanted_s });
        }
    }

    fn ticks(&self, seconds: f64) -> u64 {
        self.driven.tick_at(seconds) - self.driven.zero()
    }

    /// Asks for the changes whose tick is near.
    fn begin_timed<O: Observer>(&mut self, caller: &mut Caller<'_, O>) -> Result<Option<Ended>, DriveError> {
        let (check, ask) = (self.ticks(CHECK_S), self.ticks(ASK_S));
        while let Some(first) = self.held.first_timed() {
            let (tick, is_checked) = (first.tick, first.is_checked);
            let left = tick.saturating_sub(self.driven.earliest());
            let is_alone = self.waiting.as_ref().is_none_or(|waiting| waiting.at == Some(tick));
            if left > check || !is_alone || (left > ask && is_checked) {
                return Ok(None);
            }
            if left > ask {
                first.is_checked = true;
                let commands = first.commands.clone();
                let (gathered, _) = self.gather(&commands, Some(tick), None::<&mut Caller<'_, O>>)?;
                if matches!(self.verdict(&gathered), Ok(Ok(_))) {
                    return Ok(None);
                }
                // The nearest value that holds takes time to find.
            }
            let Some(Timed { commands, .. }) = self.held.take_first_timed() else { return Ok(None) };
            if let Some(ended) = self.apply_batch(&commands, (Some(tick), Some(tick)), caller)? {
                return Ok(Some(ended));
            }
        }
        Ok(None)
    }

    /// Makes one change of all that is asked, from tick `at` on. It was `wanted` for that tick, or for one that is too near.
    fn apply_batch<O: Observer>(
        &mut self,
        commands: &[RunCommand],
        (at, wanted): (Option<u64>, Option<u64>),
        caller: &mut Caller<'_, O>,
    ) -> Result<Option<Ended>, DriveError> {
        let (stops, others): (Vec<_>, Vec<_>) = commands.iter().cloned().partition(RunCommand::is_stop);
        let session = stops.iter().filter_map(RunCommand::of_session);
        session.for_each(|stop| self.held.hold_for_session(stop, at));
        if !stops.is_empty() && at.is_none() {
            others.into_iter().for_each(|command| refuse(command, &"a stop came with it", caller.publish));
            return Ok(None);
        }
        let commands = &self.take_immediate(&others, caller.publish)[..];
        let (mut gathered, _) = self.gather(commands, at, None::<&mut Caller<'_, O>>)?;
        // Values may be too much one by one, and hold together. If they do not, each is looked at.
        let program = match self.verdict(&gathered) {
            Ok(Ok(program)) => Ok(program),
            Ok(Err(_)) | Err(_) => {
                let (again, interruption) = self.gather(commands, at, Some(&mut *caller))?;
                match interruption {
                    None => {}
                    Some(Interruption::Ended(ended)) => return Ok(Some(ended)),
                    Some(Interruption::StopWaits) => {
                        let commands = commands.iter().cloned();
                        commands.for_each(|command| refuse(command, &"a stop came meanwhile", caller.publish));
                        return Ok(None);
                    }
                }
                gathered = again;
                gathered.program()
            }
        };
        let publish = &mut *caller.publish;
        gathered.refusals.drain(..).for_each(&mut *publish);
        gathered.commands.iter().for_each(|command| self.held.hold_for_session(*command, at));
        let tempo = gathered.tempo.map(|rate| (rate, Command::Tempo { rate }));
        let hold_tempo = |held: &mut HeldCommands| {
            tempo.into_iter().for_each(|(_, command)| held.hold_for_session(command, at));
        };
        let program = match program {
            Ok(program) => program,
            Err(error) => {
                gathered.answers.into_iter().for_each(|(command, _)| refuse(command, &error, publish));
                hold_tempo(&mut self.held);
                return Ok(None);
            }
        };
        self.setpoints = gathered.setpoints;
        if gathered.place.is_some() {
            self.state.end_joining();
            self.held.take_joined();
            self.state.forget_pause();
        }
        if let Some(follow) = gathered.follow {
            self.follow_at_s =
                follow.map(|follow| at.map_or(self.now_s, |at| self.driven.seconds_at(at)) + follow.seconds());
        }
        let Some(program) = program.filter(|_| gathered.is_moving) else {
            hold_tempo(&mut self.held);
            if tempo.is_some() || !gathered.commands.is_empty() {
                self.publish_late(wanted, self.driven.seconds_at(self.driven.earliest()), publish);
            }
            if !gathered.answers.is_empty() {
                (self.history.followed, self.history.program) = (self.setpoints.clone(), None);
            }
            for (_, mut event) in gathered.answers {
                event.set_times((self.now_s, self.now_s));
                publish(event);
            }
            return Ok(None);
        };
        // One that is no tempo is refused where all are.
        let is_tempo = |rate: f64| Rate::of(rate).is_some_and(|rate| rate != Rate::ZERO);
        let with_change = tempo.map(|(rate, _)| rate).filter(|rate| is_tempo(*rate));
        if with_change.is_none() {
            hold_tempo(&mut self.held);
        }
        let (over, answers, is_parked) = (gathered.over, gathered.answers, gathered.is_parked);
        self.request_change(
            PendingChange { program, over, answers, is_parked, at, wanted, tempo: with_change },
            publish,
        );
        Ok(None)
    }

    /// Does what is no change of the motion, or what waits for the motors to join it. Gives the rest.
    fn take_immediate(&mut self, commands: &[RunCommand], publish: Publish<'_>) -> Vec<RunCommand> {
        let mut left = Vec::with_capacity(commands.len());
        for command in commands {
            match command {
                RunCommand::Go | RunCommand::Back | RunCommand::Cue { .. } if self.state.is_joining() => {
                    self.held.hold_until_joined(command.clone());
                }
                RunCommand::Resume if self.state.is_joining() => {}
                RunCommand::Resume if self.state.parked().is_some_and(|parked| parked.halted.is_some()) => {
                    let halted = self.state.parked().and_then(|parked| parked.halted.clone());
                    let answer = (RunCommand::Begin, RunEvent::Returned { from_s: 0.0, until_s: 0.0 });
                    if let Some(point) = halted {
                        self.state.forget_pause();
                        self.state.join(Joining { point, answer: Some(answer) });
                    }
                }
                RunCommand::Begin => self.begin(publish),
                RunCommand::Rest { in_place, until } if *in_place || self.state.is_parked() => {
                    if !self.state.is_parked() && !self.state.is_paused() {
                        self.held.hold_for_session(Command::Pause, None);
                    }
                    publish(RunEvent::Resting { until: until.clone() });
                }
                RunCommand::Here { .. } => {
                    const KNOWN: &str = "the motors' positions are known: the board counts their steps";
                    refuse(command.clone(), &KNOWN, publish);
                }
                other => left.push(other.clone()),
            }
        }
        left
    }

    /// Whether the motors follow the motion, and will go on to do so.
    fn is_running(&self) -> bool {
        let is_stopped = self.state.is_stopping() || self.held.has_stop_for_now();
        !is_stopped && !self.state.is_paused() && !self.state.is_parked() && !self.driven.has_ended()
    }

    /// Whether all motors have come to the end of the motion, and nothing else is asked for.
    fn has_ended(&self) -> bool {
        self.waiting.is_none() && self.driven.has_ended()
    }

    /// Publishes once that the motion has ended.
    fn publish_end(&mut self, publish: Publish<'_>) {
        let has_ended = self.driven.has_ended();
        self.is_end_published &= has_ended;
        let is_over = has_ended && self.waiting.is_none() && !self.state.is_joining() && !self.driven.is_changing();
        if is_over && !self.is_end_published && !self.state.is_stopping() {
            self.is_end_published = true;
            publish(RunEvent::MotionEnded { at_s: self.now_s });
        }
    }

    /// Lets motors that rest begin the motion, from its beginning.
    fn begin(&mut self, publish: Publish<'_>) {
        let will_rest = self.waiting.as_ref().map_or(self.state.is_parked(), |waiting| waiting.is_parked);
        if self.state.is_paused() {
            const PAUSED: &str =
                "the motion is paused: `resume` goes on with it; `goto 0` brings the motors to where it begins";
            return refuse(RunCommand::Begin, &PAUSED, publish);
        }
        if self.state.is_stopping() || self.held.has_stop_for_now() {
            return refuse(RunCommand::Begin, &STOPPED, publish);
        }
        if !(will_rest || self.has_ended()) {
            return publish(RunEvent::AlreadyRuns);
        }
        self.setpoints = self.setpoints.restarted();
        self.held.take_joined();
        self.state.forget_pause();
        let answer = (RunCommand::Begin, RunEvent::Began { from_s: 0.0, until_s: 0.0 });
        let point = LawPoint { at: Time::ZERO, shifts: Some(Vec::new()) };
        self.state.join(Joining { point, answer: Some(answer) });
    }

    /// Lets motors that rest follow the motion, if they are to.
    fn join<O: Observer>(&mut self, caller: &mut Caller<'_, O>) -> Result<Option<Ended>, DriveError> {
        let RunState::Joining { joining, .. } = &self.state else { return Ok(None) };
        if self.waiting.is_some() || self.held.has_for_session() {
            return Ok(None);
        }
        match self.driven.set_law_time(joining.point.at, joining.point.shifts.as_deref()) {
            Err(SessionError::Waiting { .. }) => return Ok(None),
            Err(error) => {
                let joining = self.state.end_joining();
                self.refuse_joining(joining, &self.driven.why(error), caller.publish);
                return Ok(None);
            }
            Ok(()) => {}
        }
        let Some(Joining { answer, .. }) = self.state.end_joining() else { return Ok(None) };
        let then = self.held.take_joined();
        if let Some((command, event)) = answer {
            match self.setpoints.program() {
                Ok(program) => {
                    let answers = vec![(command, event)];
                    let joined = PendingChange { answers, ..PendingChange::alone(program) };
                    self.request_change(joined, caller.publish);
                }
                Err(error) => refuse(command, &error, caller.publish),
            }
        }
        if then.is_empty() { Ok(None) } else { self.apply_batch(&then, (None, None), caller) }
    }

    /// Merges a change into the one that waits for its tick, if any, and makes it.
    fn request_change(&mut self, mut change: PendingChange, publish: Publish<'_>) {
        if let Some(mut before) = self.waiting.take() {
            before.answers.retain(|(command, _)| !is_set_again(command, &change.answers));
            change.answers.splice(0..0, before.answers);
            change.at = change.at.or(before.at);
            change.wanted = change.wanted.or(before.wanted);
            change.tempo = change.tempo.or(before.tempo);
        }
        self.change(change, publish);
    }

    fn change(&mut self, pending: PendingChange, publish: Publish<'_>) {
        // It is asked for shortly before its tick: until then the motors can change to something else.
        if pending.at.is_some_and(|at| at > self.driven.earliest() + self.ticks(ASK_S)) {
            self.waiting = Some(pending);
            return;
        }
        let has_braked = self.driven.has_braked();
        let mut change = change_to(Arc::clone(&pending.program), pending.over);
        if pending.is_parked {
            change.begins = Begins::Now;
        }
        self.driven.hold_changes_until(pending.at);
        let changed = self.driven.change_with_tempo(&change, pending.tempo.and_then(Rate::of));
        self.driven.hold_changes_until(self.changes_at);
        match changed {
            Ok((times, tempo)) => self.changed(pending, times, tempo, has_braked, publish),
            Err(SessionError::Waiting { .. }) => self.waiting = Some(pending),
            // This computer was too slow just now: the motors brake, and join these laws then.
            Err(error) if self.rejoining.is_allowed && self.driven.has_braked() && !is_of_laws(&error) => {
                self.waiting = Some(pending);
            }
            // The limits may leave no room for both at once: one after the other then.
            Err(_) if pending.tempo.is_some() && !pending.takes_back() && !self.state.is_taking_back() => {
                let mut laws_alone = pending;
                if let Some(rate) = laws_alone.tempo.take() {
                    self.held.hold_for_session(Command::Tempo { rate }, laws_alone.at);
                }
                self.change(laws_alone, publish);
            }
            Err(error) => {
                self.setpoints = self.history.followed.clone();
                self.follow_at_s = None;
                let why = self.driven.why(error);
                for (command, _) in pending.answers {
                    refuse(command, &why, publish);
                }
                match self.state.is_taking_back() {
                    false => {}
                    true if pending.is_parked => self.held.hold_for_session(Command::Stop, None),
                    true => self.take_back(pending.tempo.unwrap_or(self.tempo), publish),
                }
            }
        }
    }

    /// Notes a change that the session has made, and publishes it.
    fn changed(
        &mut self,
        pending: PendingChange,
        times: (f64, f64),
        tempo: Option<Event>,
        has_braked: bool,
        publish: Publish<'_>,
    ) {
        let new_tempo = match &tempo {
            Some(Event::Tempo { rate, .. }) => Some(*rate),
            _ => None,
        };
        self.history.follow(&pending, &self.setpoints, (self.tempo, new_tempo));
        let why_taken_back = self.state.why_taken_back().map(str::to_owned);
        self.state.change(pending.is_parked, times.1);
        let takes_back = why_taken_back.is_some();
        if let Some(why) = why_taken_back {
            let (from_s, until_s) = times;
            publish(RunEvent::TakenBack { why, rests: pending.is_parked, from_s, until_s });
        } else if has_braked {
            self.publish_rejoined(times, publish);
        }
        for (_, mut event) in pending.answers {
            event.set_times(times);
            publish(event);
        }
        self.publish_late(pending.wanted, times.0, publish);
        if let Some(event) = tempo {
            let is_known = takes_back && new_tempo == Some(self.tempo);
            if let Some(rate) = new_tempo {
                (self.tempo, self.history.is_changed) = (rate, true);
            }
            if !is_known {
                publish(event.into());
            }
        }
    }
}

impl History {
    /// Notes what the motors follow after a change, and keeps what they followed before if that was another motion. `tempo` is the one before the change, and
    /// the new one if it changes.
    fn follow(&mut self, change: &PendingChange, setpoints: &LiveSetpoints, tempo: (f64, Option<f64>)) {
        let before = std::mem::replace(&mut self.followed, setpoints.clone());
        // What is taken back is no earlier motion.
        if change.takes_back() {
            return;
        }
        self.is_changed = true;
        let is_place = |(command, _): &(RunCommand, RunEvent)| {
            matches!(command, RunCommand::Rest { .. })
                || matches!(command, RunCommand::Goto { position } if position != THE_MOTION)
        };
        let (old_tempo, new_tempo) = tempo;
        let is_other_tempo = new_tempo.is_some_and(|rate| rate != old_tempo);
        if change.answers.iter().all(is_place) && !is_other_tempo {
            return;
        }
        let program = if change.is_parked { None } else { Some(Arc::clone(&change.program)) };
        let program_before = std::mem::replace(&mut self.program, program);
        let program_before = program_before.map_or_else(|| before.program(), Ok);
        // The motors may come back to the motion that they left, or join it again.
        let is_same = matches!((&program_before, &self.program), (Ok(one), Some(other)) if is_same_motion(one, other));
        if is_other_tempo || !is_same {
            self.keep(before, old_tempo);
        }
    }

    /// Keeps a motion that was followed at a tempo, for a change that has to be taken back.
    fn keep(&mut self, setpoints: LiveSetpoints, tempo: f64) {
        if self.earlier.len() == MAX_EARLIER {
            self.earlier.remove(1);
        }
        self.earlier.push(EarlierMotion { setpoints, tempo });
    }
}

/// What the caller of a step gives: an observer of edges, where events go, and whether a stop waits.
pub(crate) struct Caller<'a, O> {
    pub(crate) observer: &'a mut O,
    pub(crate) publish: Publish<'a>,
    pub(crate) stop_waits: StopWaits<'a>,
}

impl PendingChange {
    /// A change that answers no command, as soon as it can.
    fn alone(program: Arc<Program>) -> PendingChange {
        let (over, answers, is_parked) = (None, Vec::new(), false);
        PendingChange { program, over, answers, is_parked, at: None, wanted: None, tempo: None }
    }

    /// Whether nobody asked for it: the planner takes another change back.
    fn takes_back(&self) -> bool {
        self.answers.is_empty()
    }
}

/// Why nothing begins after a stop.
const STOPPED: &str = "a client has stopped the motors, and the session ends";

pub(crate) fn change_to(program: Arc<Program>, over: Option<Time>) -> Change {
    Change { program, over, begins: Begins::WithTheMotion }
}

/// Whether a knob was turned again before the motors followed its value: the last value is what they do.
pub(crate) fn is_set_again(command: &RunCommand, later: &[(RunCommand, RunEvent)]) -> bool {
    let RunCommand::Set { knob, .. } = command else { return false };
    later.iter().any(|(later, _)| matches!(later, RunCommand::Set { knob: again, .. } if again == knob))
}

/// Whether motors follow both in the same way: boards and wiring do not change while they run.
fn is_same_motion(one: &Arc<Program>, other: &Arc<Program>) -> bool {
    let motors = || one.motors.iter().zip(&other.motors);
    Arc::ptr_eq(one, other)
        || (motors().all(|(one, other)| one.law == other.law && one.limits == other.limits)
            && one.machines == other.machines)
}

pub(crate) fn refuse(command: RunCommand, why: &impl ToString, publish: Publish<'_>) {
    publish(refusal(command, why));
}

pub(crate) fn refusal(command: RunCommand, why: &impl ToString) -> RunEvent {
    let why = why.to_string();
    match command {
        RunCommand::Motion { .. } => RunEvent::MotionRefused { error: why, line: None, column: None },
        command => RunEvent::Refused { command, why },
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
