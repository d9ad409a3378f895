//! The session: a program, streamed into a board so that the cable may be pulled at any moment.
//!
//! The plan of all motors is one epoch of the board's queues, which is only appended to. A *lease* says up to which tick it holds, and is
//! put off as more was handed over. If it is not put off in time, all motors brake by core's rule (`pulsetrain_core::braking`), which the
//! session replays: it knows what each motor counts by any tick, whatever happens to the host or the cable.
//!
//! # What is here, top down
//! - [`Session`]: fills the queues, lets time pass, stops, changes to another program; `halt`: pauses and resumes
//! - [`pause`]: how a motion is brought to a halt on its path, and goes on
//! - `lease`: how long the plan may be said to hold, and what happens if that ends
//! - `stream`: a program's plan as items, handed over as the queues have room
//! - `timeline`: what a motor was told, replayed in integers
//!
//! # The end of a lease
//! It never lies behind the last step that was handed over before it, of any motor that goes on: then data that come late never matter, and
//! the replay is exact. It lies within [half a second](AHEAD_MS) of the board's time, so that motors do not run on for long without a
//! host. And it lies where no motor would have to rest at once from a speed at which it cannot.
//!
//! # What is not
//! Planning (`pulsetrain-plan`), boards (`pulsetrain-board`), files and terminals (`pulsetrain`).
#![forbid(unsafe_code)]

pub mod control;
pub mod drive;
mod error;
pub mod estimate;
pub mod fit;
mod halt;
pub mod lateness;
mod lease;
pub mod pause;
pub mod plans;
pub mod prepare;
mod prove;
pub mod rehearsal;
mod stream;
mod timeline;

pub use error::SessionError;

use control::{MotorStatus, Status};
use halt::Playback;
use pulsetrain_board::lease::{ExtendRefused, Lease, LeaseState, Leased};
use pulsetrain_board::{Faults, Observer, SwitchRefused};
use pulsetrain_core::Epoch;
use pulsetrain_core::braking::Limit;
use pulsetrain_core::lease::LapseCause;
use pulsetrain_motion::program::Program;
use pulsetrain_plan::line::{AHEAD_MS, KEPT};
use pulsetrain_plan::{Certificate, Origin, Start};
use std::collections::VecDeque;
use std::sync::Arc;
use stream::Stream;
use timeline::{Step, Timeline};

/// So long after the last step a board may take to say that its motors rest, s.
const PATIENCE_S: u64 = 5;

/// So often a beginning is sent again that came too late.
const RETRIES: u32 = 3;

/// A beginning may lie so far ahead of the board's time, s: a board tells ticks within 2^31 of its time apart, on a Pico 17 s.
pub const FARTHEST_BEGIN_S: u64 = 10;

/// A lease that ends within so many ms is short.
const SHORT_MS: u64 = 40;

/// So many extensions of the lease may be on their way: what a queue holds need not last until two of them were answered, one after the other. Over a
/// slow line more of them, one for each [`ASKED_EVERY_MS`] that telling takes: an answer comes late there. A fast line would bring an Uno more of them
/// than it has time for.
const MOST_ASKED: std::ops::RangeInclusive<u64> = 3..=6;
const ASKED_EVERY_MS: u64 = 8;

/// A program on its way into a board. Ticks are the board's, in 64 bits.
pub struct Session<B> {
    board: B,
    stream: Stream,
    timelines: Vec<Timeline>,
    /// How the motors brake, as the board has accepted it.
    limits: Vec<Limit>,
    /// How long the plan holds, as the board has accepted it: the lease of a change that waits, too.
    held: Lease,
    /// Extensions that the board has not answered, oldest first: what each says, and how the motors brake then.
    asked: VecDeque<(Lease, Vec<Limit>)>,
    /// What the last change replaced, until it is made.
    replaced: Option<Replaced>,
    /// From this tick on all motors of the plan can brake: see [`lease::joined`].
    joined: u64,
    pace: Pace,
    /// Room in each motor's empty queue, in the board's own unit.
    capacity: Vec<usize>,
    /// The motor that was known least far when the queues were filled last, and what there was no room for.
    least: usize,
    short: Option<usize>,
    /// When that was.
    filled: u64,
    /// Nothing more is to be sent, since when the motors brake, if they do.
    over: bool,
    ended: Option<u64>,
    /// What each motor will have counted if a switch, whose answer did not come, was accepted.
    unanswered: Option<Vec<i64>>,
    /// The line broke before the board answered an order to brake.
    stop_unanswered: bool,
    /// The program that was begun, or changed to, and how far its time is.
    playback: Playback,
}

/// A plan that is followed up to a tick.
#[derive(Clone)]
struct Replaced {
    until: u64,
    timelines: Vec<Timeline>,
    limits: Vec<Limit>,
    /// Since when the motors brake or rest after a stop, if they do.
    ended: Option<u64>,
}

/// How far ahead things are done, ticks.
#[derive(Clone, Copy, Debug)]
struct Pace {
    tick_hz: u64,
    fraction_bits: u32,
    /// How long before a step a board must know of it: DIR setup, and the pulse and hold before.
    lead: u64,
    /// How long telling the board takes.
    link: u64,
    /// Enough to have in the queue.
    ahead: u64,
    /// How much later, at most, a change is asked for that was planned too late.
    spare: u64,
}

impl Pace {
    fn of(program: &Program, link: u64) -> Pace {
        let tick_hz = program.board.tick_hz;
        let reversals = program.motors.iter().map(|motor| program.timing(motor).ticks(tick_hz).reversal());
        // Boards tell ticks apart within 2^30.
        let within = |ticks: u64| ticks.clamp(1, 1 << 28);
        Pace {
            tick_hz,
            fraction_bits: program.board.fraction_bits,
            lead: reversals.max().unwrap_or(0) + 1,
            link,
            ahead: within(tick_hz * AHEAD_MS / 1000),
            spare: within(tick_hz / 20),
        }
    }

    /// How many extensions may be on their way.
    fn most_asked(&self) -> usize {
        let asked = self.link / (self.tick_hz * ASKED_EVERY_MS / 1000).max(1);
        asked.clamp(*MOST_ASKED.start(), *MOST_ASKED.end()) as usize
    }

    /// What a board may need to be told the next thing in.
    const fn margin(&self) -> u64 {
        self.lead + self.link + self.tick_hz / 500
    }
}

/// A motor at a tick, by its law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorState {
    /// Steps made before the tick.
    pub count: i64,
    /// θ, steps, in the coordinates of the session's first program.
    pub theta: f64,
    /// θ', steps/s.
    pub speed: f64,
}

/// How a session ended.
#[derive(Debug)]
pub struct Report {
    /// The tick at which the laws' time was 0.
    pub zero: u64,
    /// The tick of the last step; `zero` if there was none.
    pub last_step: u64,
    /// Steps of each motor, forward minus backward, as the board counted them.
    pub counted: Vec<i64>,
    /// The same as the host replayed them.
    pub replayed: Vec<i64>,
    /// Other counts that are possible if the line broke before answers came: one entry for each change or extension without an answer, as if the
    /// board had accepted it and nothing after it. The last one comes first.
    pub replayed_otherwise: Vec<Vec<i64>>,
    /// The line broke before the board answered an order to brake. If the board obeyed the order, the motors stopped sooner than `replayed` says,
    /// and their counts are unknown.
    pub stop_unanswered: bool,
    /// What went wrong on each motor.
    pub faults: Vec<Faults>,
    /// Why the motors braked before the motion's end.
    pub failure: Option<SessionError>,
}

impl<B: Leased> Session<B> {
    /// Plans the beginning of `program` and sends it; the laws begin 1 ms or a little more from now.
    ///
    /// # Errors
    /// When the plan is refused, the board is not idle, or its queue is too short. Nothing moves then.
    pub fn new(board: B, program: impl Into<Arc<Program>>) -> Result<Session<B>, SessionError> {
        Session::begin(board, program.into(), None)
    }

    /// The same, with the laws' time 0 at a tick of the board: several boards can begin together.
    ///
    /// # Errors
    /// As [`Session::new`], and [`SessionError::Early`] or [`SessionError::Late`] for a tick that the board cannot be told of in time, or that lies
    /// more than [`FARTHEST_BEGIN_S`] ahead.
    pub fn begin_at(board: B, program: impl Into<Arc<Program>>, zero: u64) -> Result<Session<B>, SessionError> {
        Session::begin(board, program.into(), Some(zero))
    }

    fn begin(mut board: B, program: Arc<Program>, wanted: Option<u64>) -> Result<Session<B>, SessionError> {
        if !board.is_idle() {
            return Err(SessionError::Busy);
        }
        let pace = Pace::of(&program, board.lead());
        let counts = board.positions();
        let motors = program.motors.len();
        if counts.len() < motors {
            return Err(SessionError::Motors { program: motors, board: counts.len() });
        }
        let capacity: Vec<usize> = (0..motors).map(|motor| board.room(motor)).collect();
        let timelines: Vec<Timeline> =
            counts.iter().take(motors).map(|count| Timeline::new(pace.fraction_bits, *count, board.now())).collect();
        let (mut took, mut tries) = (0, 0);
        let (zero, begun) = loop {
            let called = board.now();
            let earliest = called + pace.tick_hz.div_ceil(1000) + 4 * pace.lead + pace.link + 2 * took;
            let zero = wanted.unwrap_or(earliest);
            if zero < earliest {
                return Err(SessionError::Early { at: zero, earliest });
            }
            let latest = called + FARTHEST_BEGIN_S * pace.tick_hz;
            if zero > latest {
                return Err(SessionError::Late { at: zero, latest });
            }
            let stream = Stream::new(Arc::clone(&program), zero, &counts, board.epoch().next(), &board)?;
            let begun = Beginning::new(&mut board, stream, &timelines, &capacity, &pace)?;
            match begun.switch(&mut board) {
                Ok(()) => break (zero, begun),
                // Planning and sending took longer than was allowed for: once more, with time for that.
                Err(SessionError::Switch(SwitchRefused::Late { .. })) if tries < RETRIES => {
                    (took, tries) = (board.now() - called, tries + 1);
                }
                Err(SessionError::Switch(SwitchRefused::Late { .. })) => return Err(SessionError::NotBegun),
                Err(error) => return Err(error),
            }
        };
        let replaced = Replaced { until: zero, timelines, limits: begun.limits.clone(), ended: None };
        let mut session = Session {
            board,
            stream: begun.stream,
            timelines: begun.timelines,
            limits: begun.limits,
            held: begun.lease,
            asked: VecDeque::new(),
            replaced: Some(replaced),
            joined: zero,
            pace,
            capacity,
            least: 0,
            short: None,
            filled: 0,
            over: false,
            ended: None,
            unanswered: None,
            stop_unanswered: false,
            playback: Playback::begun(program),
        };
        session.fill()?;
        Ok(session)
    }

    /// Sends what the queues have room for, and puts the lease off.
    ///
    /// # Errors
    /// When the plan is refused, or the motors brake already: then nothing more is sent.
    pub fn fill(&mut self) -> Result<(), SessionError> {
        let filled = self.try_fill();
        self.over |= filled.is_err();
        filled
    }

    fn try_fill(&mut self) -> Result<(), SessionError> {
        self.look()?;
        // Where motors are about to brake, no room is kept for a change.
        let is_short = self.told().saturating_sub(self.board.now()) < self.pace.tick_hz / 1000 * SHORT_MS;
        let kept: Vec<usize> =
            self.capacity.iter().map(|capacity| if is_short { 0 } else { capacity / KEPT }).collect();
        let mut more = !self.over;
        while more {
            let reach = self.reach();
            let handed = self.stream.hand_over(&mut self.board, &mut self.timelines, &kept, reach)?;
            (more, self.short) = (handed.more, handed.short);
            self.extend()?;
        }
        if let Some((_, motor)) = self.stream.known() {
            self.least = motor;
        }
        self.filled = self.board.now();
        Ok(())
    }

    /// So far a plan may be handed over, or a lease lie.
    fn reach(&self) -> u64 {
        self.board.now().max(self.stream.zero()) + self.pace.ahead
    }

    /// Puts the lease off, if that is worth it.
    fn extend(&mut self) -> Result<(), SessionError> {
        self.confirm();
        let last = self.asked.back().map_or(self.held, |(lease, _)| *lease);
        let (Lease::Until(until), true) = (last, self.asked.len() < self.pace.most_asked()) else { return Ok(()) };
        let brakings = lease::brakings(&self.stream)?;
        let least = until.max(self.board.horizon());
        let Some(next) = lease::longest(&self.stream, &self.timelines, least, self.reach()) else {
            return Ok(());
        };
        if let Lease::Until(next) = next
            && next - until < (until - until.min(self.board.now())) / 4
        {
            return Ok(());
        }
        let limits: Vec<Limit> = brakings.iter().map(|braking| braking.limit).collect();
        // Of those on their way the board may refuse one and accept the next.
        let is_known = self.asked.iter().all(|(_, asked)| *asked == limits) && limits == self.limits;
        let told: &[Limit] = if is_known { &[] } else { &limits };
        match self.board.extend(next, told) {
            Ok(()) => {
                self.asked.push_back((next, limits));
                self.confirm();
                Ok(())
            }
            // Then the board has no more than it had, or brakes: what it says of that is heard next.
            Err(ExtendRefused::Late { .. } | ExtendRefused::Early { .. }) => Ok(()),
            Err(ExtendRefused::Off | ExtendRefused::Lapsed { .. } | ExtendRefused::Lost) => self.look(),
        }
    }

    /// Notes what the board has answered.
    fn confirm(&mut self) {
        while let Some(accepted) = self.board.extended() {
            if let Some(answered) = self.asked.pop_front()
                && accepted
            {
                (self.held, self.limits) = answered;
            }
        }
    }

    /// Looks whether the motors brake.
    fn look(&mut self) -> Result<(), SessionError> {
        let now = self.board.now();
        self.confirm();
        if self.replaced.as_ref().is_some_and(|replaced| replaced.until < now) {
            self.replaced = None;
        }
        if let Some(why) = self.board.lost() {
            return if self.is_complete() { Ok(()) } else { Err(SessionError::Lost(why.clone())) };
        }
        if let (None, Some((at, cause))) = (self.ended, self.lapsed()) {
            let was_over = self.over;
            self.brake_from(at);
            if cause != LapseCause::Ordered && !was_over {
                return Err(self.failure(at, cause));
            }
        }
        if !self.is_complete() {
            // A lease that is over by now ends in a stop that is yet to be replayed.
            let since = now.saturating_sub(self.pace.ahead / 2).min(self.told());
            self.timelines.iter_mut().for_each(|timeline| timeline.forget(since));
        }
        Ok(())
    }

    /// Since when the motors brake, as the board has it, and why. One that goes over to another plan after a stop is still at that stop.
    fn lapsed(&self) -> Option<(u64, LapseCause)> {
        let LeaseState::Lapsed { at, cause, .. } = self.board.lease() else { return None };
        self.replaced.as_ref().is_none_or(|replaced| replaced.ended != Some(at)).then_some((at, cause))
    }

    /// Why the motors brake from tick `at` on, though nobody asked for it.
    fn failure(&self, at: u64, cause: LapseCause) -> SessionError {
        let seconds = |ticks: u64| ticks as f64 / self.pace.tick_hz as f64;
        let at_s = seconds(at.saturating_sub(self.stream.zero()));
        if cause != LapseCause::NotExtended {
            return SessionError::Fault { at_s, cause };
        }
        match self.short.filter(|_| at.saturating_sub(self.filled) <= self.pace.margin()) {
            Some(short) => self.too_short(short, at),
            None => {
                let late_s = seconds(self.board.now().saturating_sub(at));
                SessionError::Stopped { motor: self.least, at_s, late_s }
            }
        }
    }

    fn too_short(&self, motor: usize, at: u64) -> SessionError {
        too_short(motor, &self.capacity, at.saturating_sub(self.stream.zero()), &self.pace)
    }

    /// The motors brake from tick `at` on.
    fn brake_from(&mut self, at: u64) {
        self.timelines = self.ended_at(at);
        (self.over, self.ended, self.replaced) = (true, Some(at), None);
        self.playback.stopped();
    }

    /// What the motors do if they brake from tick `until` on.
    fn ended_at(&self, until: u64) -> Vec<Timeline> {
        let (timelines, limits) = match &self.replaced {
            Some(replaced) if replaced.ended == Some(until) => return replaced.timelines.clone(),
            Some(replaced) if until < replaced.until => (&replaced.timelines, &replaced.limits),
            _ => (&self.timelines, &self.limits),
        };
        lease::ended(timelines, limits, self.stream.program(), until)
    }

    /// The same if nothing more is sent, by what the board has confirmed.
    fn expected(&self) -> Vec<Timeline> {
        let told = self.told();
        if self.ended.is_some() || told == u64::MAX { self.timelines.clone() } else { self.ended_at(told) }
    }

    /// Lets time pass up to and with tick `until`, and keeps the queues filled meanwhile.
    ///
    /// # Errors
    /// As for [`Session::fill`]; time passes up to `until` all the same.
    pub fn advance(&mut self, until: u64, observer: &mut impl Observer) -> Result<(), SessionError> {
        let mut filled = self.fill();
        while self.board.now() <= until {
            let next = until.min(self.next_event()).max(self.board.now());
            self.board.advance(next, observer);
            if filled.is_ok() {
                filled = self.fill();
            }
        }
        filled
    }

    /// Runs to the end of the plan, or until the motors rest; `progress` hears the tick from time to time.
    ///
    /// Does not return for endless laws: those need [`Session::advance`] and [`Session::stop`].
    pub fn run(&mut self, observer: &mut impl Observer, mut progress: impl FnMut(u64)) -> Report {
        let step = self.pace.ahead / 2;
        let mut failure = None;
        while !self.is_complete() {
            let until = self.board.now() + step;
            failure = self.advance(until, observer).err();
            progress(self.board.now());
        }
        let last = self.last_step().unwrap_or(0);
        let patience = self.board.now().max(last) + PATIENCE_S * self.pace.tick_hz;
        while self.board.now() <= last || !self.board.is_idle() {
            if self.board.now() > patience {
                let at_s = last.saturating_sub(self.stream.zero()) as f64 / self.pace.tick_hz as f64;
                return self.report(failure.or(Some(SessionError::Restless { at_s })));
            }
            let until = self.board.now() + step;
            self.board.advance(if self.board.now() <= last { until.min(last) } else { until }, observer);
            progress(self.board.now());
        }
        // Edges of the time in which the board was lost.
        self.board.advance(self.board.now().saturating_sub(1), observer);
        // The board may have had more to say on the way.
        failure = failure.or(self.look().err());
        self.report(failure)
    }

    /// Brings all motors to rest within their limits, as soon as the board can be told; gives the tick at which they begin to brake.
    ///
    /// # Errors
    /// When the board cannot be told, or does not say since when: the motors brake at the end of their lease then, or sooner.
    pub fn stop(&mut self) -> Result<u64, SessionError> {
        self.over = true;
        self.playback.stopped();
        self.look()?;
        if let Some(at) = self.ended {
            return Ok(at);
        }
        // Where a motor would have to rest at once, all go on for a step.
        let joined = self.joined;
        let is_joining = (self.stream.zero()..joined).contains(&self.board.horizon());
        if is_joining {
            let limits = self.asked.back().map_or(&self.limits, |(_, limits)| limits).clone();
            if self.board.extend(Lease::Until(joined), &limits).is_ok() {
                self.asked.push_back((Lease::Until(joined), limits));
                self.board.await_extensions();
                self.confirm();
                if self.held == Lease::Until(joined) {
                    return Ok(joined);
                }
            }
        }
        let was_lost = self.board.lost().is_some();
        match self.board.brake() {
            Some(at) => {
                self.confirm();
                self.brake_from(at);
                Ok(at)
            }
            None => {
                self.look()?;
                match self.board.lost() {
                    Some(why) if !was_lost => {
                        self.stop_unanswered = true;
                        Err(SessionError::Lost(why.clone()))
                    }
                    _ => Ok(self.board.now()),
                }
            }
        }
    }

    /// Goes over to another program at tick `at`, which is the time 0 of its laws.
    ///
    /// Its laws speak of the same θ as those of the first program: they must begin within two steps of where the motors
    /// are, and within the pull-in rate of their speed; see [`Session::state`]. Motors, wiring and
    /// board must be the same. After a stop, `at` may be any tick once the motors rest.
    ///
    /// # Errors
    /// When `at` is too early or too late, or another change waits, or the new plan is refused; the old one goes on.
    pub fn change(&mut self, at: u64, program: impl Into<Arc<Program>>) -> Result<(), SessionError> {
        let program = program.into();
        self.go_over(at, Arc::clone(&program), 0)?;
        self.playback = Playback::begun(program);
        Ok(())
    }

    /// As [`Session::change`]. The first `proven` ticks are planned before the board hears of the change. If that plan is refused, nothing changes.
    fn go_over(&mut self, at: u64, program: Arc<Program>, proven: u64) -> Result<(), SessionError> {
        let (motors, old) = (program.motors.len(), self.timelines.len());
        let pace = Pace::of(&program, self.pace.link);
        if motors != old || (pace.tick_hz, pace.fraction_bits) != (self.pace.tick_hz, self.pace.fraction_bits) {
            return Err(SessionError::Motors { program: motors, board: old });
        }
        // The limits of the plan that is replaced are those that the board has.
        self.board.await_extensions();
        self.look()?;
        let earliest = self.earliest();
        if at < earliest {
            return Err(SessionError::Early { at, earliest });
        }
        if let Some(replaced) = &self.replaced {
            return Err(SessionError::Waiting { at, until: replaced.until + 1 });
        }
        let mut starts = Vec::with_capacity(motors);
        let mut datums = Vec::with_capacity(motors);
        for motor in 0..motors {
            let MotorState { count, speed, .. } = self.state(motor, at)?;
            let datum = self.stream.datum(motor);
            let origin = Origin { position: count, theta: datum.0 as f64 + datum.1, speed };
            let from_there = |(tick, way): Step| (tick.wrapping_sub(at).cast_signed(), way);
            starts.push(Start { origin, last_step: self.timelines[motor].last_before(at)[0].map(from_there) });
            datums.push(datum);
        }
        halt::prove(&program, &starts, proven)?;
        let epoch = self.next_epoch();
        let stream = Stream::from(program, at, &starts, datums, epoch, &self.board)?;
        let begun = Beginning::new(&mut self.board, stream, &self.timelines, &self.capacity, &pace)?;
        if let Err(error) = begun.switch(&mut self.board) {
            if let SessionError::Lost(_) = error {
                // It may have been accepted all the same.
                self.unanswered = Some(begun.expected());
            }
            return Err(error);
        }
        let timelines = std::mem::replace(&mut self.timelines, begun.timelines);
        let limits = std::mem::replace(&mut self.limits, begun.limits);
        self.replaced = Some(Replaced { until: at, timelines, limits, ended: self.ended });
        (self.stream, self.held) = (begun.stream, begun.lease);
        self.asked.clear();
        (self.joined, self.over, self.ended) = (begun.joined, false, None);
        self.fill()
    }

    /// The epoch after the one that the board was told last.
    fn next_epoch(&self) -> Epoch {
        self.stream.epoch().next()
    }

    /// The state of a motor at a tick that is not past: by its law, or at rest.
    ///
    /// # Errors
    /// While the motor brakes for a stop, for ticks that the board was not told yet, or where its law breaks.
    pub fn state(&mut self, motor: usize, tick: u64) -> Result<MotorState, SessionError> {
        let timeline = &self.timelines[motor];
        let count = timeline.count_before(tick).unwrap_or(0);
        let last = self.timelines.iter().filter_map(Timeline::last_tick).max().unwrap_or(0);
        let (whole, rest) = self.stream.datum(motor);
        let told = self.told();
        let rests = (self.ended.is_some() || told == u64::MAX) && tick > last;
        if rests {
            return Ok(MotorState { count, theta: (whole + count) as f64 + rest, speed: 0.0 });
        }
        if tick > told {
            return Err(SessionError::Late { at: tick, latest: told });
        }
        let place = self.stream.place(motor, tick.max(self.stream.zero()), count)?;
        let theta = (whole + count) as f64 + (rest + place.off);
        let speed = if tick < self.stream.zero() { 0.0 } else { place.speed };
        Ok(MotorState { count, theta, speed })
    }

    /// The tick up to which the motors follow their laws for sure: u64::MAX if that is to their end.
    #[must_use]
    pub fn told(&self) -> u64 {
        match (self.ended.or(self.lapsed().map(|(at, _)| at)), self.held) {
            (Some(at), _) => at,
            (None, Lease::Until(until)) => until,
            (None, Lease::Last) => u64::MAX,
        }
    }

    /// The count of a motor after all steps up to and with `tick`, if nothing more is sent; `None` for ticks that were
    /// more than 0.25 s past when something was sent last.
    #[must_use]
    pub fn count_at(&self, motor: usize, tick: u64) -> Option<i64> {
        let after = tick.saturating_add(1);
        if after <= self.told() || self.ended.is_some() {
            return self.timelines.get(motor)?.count_before(after);
        }
        self.expected().get(motor)?.count_before(after)
    }

    /// Where everything is. Times are seconds since tick `zero`.
    pub fn status(&mut self, zero: u64) -> Status {
        let now = self.board.now();
        let tick_s = 1.0 / self.pace.tick_hz as f64;
        let motors = (0..self.capacity.len()).map(|motor| {
            let state = self.state(motor, now).ok();
            let position = state.map_or_else(|| self.count_at(motor, now).unwrap_or_default(), |state| state.count);
            MotorStatus {
                position,
                target: state.map(|state| state.theta),
                speed: state.map(|state| state.speed),
                queue: (self.board.room(motor), self.capacity[motor]),
            }
        });
        let motors = motors.collect();
        let committed = self.told();
        Status {
            at_s: now.saturating_sub(zero) as f64 * tick_s,
            lease_s: (committed != u64::MAX).then(|| committed.saturating_sub(now) as f64 * tick_s),
            motors,
            lateness: None,
        }
    }

    /// Whether the motion is paused, or comes to a pause.
    #[must_use]
    pub fn is_paused(&self) -> bool {
        self.playback.is_paused()
    }

    /// The first tick at which a change can be made now.
    #[must_use]
    pub fn earliest(&self) -> u64 {
        self.board.horizon().max(self.board.now()) + self.pace.lead + self.pace.link
    }

    /// The tick at which time is 0 for the laws that are being followed.
    #[must_use]
    pub fn zero(&self) -> u64 {
        self.stream.zero()
    }

    /// Whether nothing more is to be sent.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.over || self.held == Lease::Last
    }

    /// The tick of the last step, if nothing more is sent.
    #[must_use]
    pub fn last_step(&self) -> Option<u64> {
        self.expected().iter().filter_map(Timeline::last_tick).max()
    }

    /// What is proven of a motor's plan, as far as it was read.
    #[must_use]
    pub fn certificate(&self, motor: usize) -> Certificate {
        self.stream.certificate(motor)
    }

    /// The board.
    #[must_use]
    pub fn board(&self) -> &B {
        &self.board
    }

    /// The board, which a late host lets run on by itself.
    pub fn board_mut(&mut self) -> &mut B {
        &mut self.board
    }

    /// Leaves the board to itself: the motors brake at the end of their lease.
    #[must_use]
    pub fn into_board(self) -> B {
        self.board
    }

    fn report(&self, failure: Option<SessionError>) -> Report {
        let on_the_way = self.asked.iter().rev().map(|(lease, limits)| match lease {
            Lease::Until(until) => counts(&lease::ended(&self.timelines, limits, self.stream.program(), *until)),
            Lease::Last => counts(&self.timelines),
        });
        let otherwise = self.unanswered.clone().into_iter().chain(on_the_way).collect();
        let expected = self.expected();
        Report {
            zero: self.stream.zero(),
            last_step: expected.iter().filter_map(Timeline::last_tick).max().unwrap_or(self.stream.zero()),
            counted: self.board.positions(),
            replayed: counts(&expected),
            replayed_otherwise: otherwise,
            stop_unanswered: self.stop_unanswered,
            faults: (0..self.timelines.len()).map(|motor| self.board.faults(motor)).collect(),
            failure,
        }
    }

    /// The tick up to which there is nothing to do.
    fn next_event(&self) -> u64 {
        let now = self.board.now();
        if self.is_complete() {
            return u64::MAX;
        }
        // In time for the end of what the queues hold, however little that is.
        let soon = (self.told().saturating_sub(now) / 4).max(1);
        now + if self.pace.link > 0 { soon.min(self.look_ticks()).max(self.pace.lead) } else { soon }
    }

    /// How often to look whether there is room, where telling takes time: it goes out bit by bit.
    const fn look_ticks(&self) -> u64 {
        let often = self.pace.tick_hz / 640;
        if self.pace.link < often { self.pace.link } else { often }
    }
}

/// What the motors will have counted in the end.
fn counts(timelines: &[Timeline]) -> Vec<i64> {
    timelines.iter().filter_map(|timeline| timeline.count_before(u64::MAX)).collect()
}

fn too_short(motor: usize, capacity: &[usize], ticks: u64, pace: &Pace) -> SessionError {
    let capacity = capacity.get(motor).copied().unwrap_or(0);
    SessionError::QueueTooShort { motor, at_s: ticks as f64 / pace.tick_hz as f64, capacity }
}

/// The beginning of a plan, in the board's queues.
struct Beginning {
    stream: Stream,
    timelines: Vec<Timeline>,
    limits: Vec<Limit>,
    lease: Lease,
    joined: u64,
}

impl Beginning {
    /// Hands a plan over that takes over from `timelines`: as much of it as there is room for.
    fn new<B: Leased>(
        board: &mut B,
        stream: Stream,
        timelines: &[Timeline],
        capacity: &[usize],
        pace: &Pace,
    ) -> Result<Beginning, SessionError> {
        let epoch = stream.epoch();
        let begun = Beginning::hand_over(board, stream, timelines, capacity, pace);
        if begun.is_err() {
            board.discard(epoch);
        }
        begun
    }

    fn hand_over<B: Leased>(
        board: &mut B,
        mut stream: Stream,
        timelines: &[Timeline],
        capacity: &[usize],
        pace: &Pace,
    ) -> Result<Beginning, SessionError> {
        let mut timelines = timelines.to_vec();
        timelines.iter_mut().for_each(|timeline| timeline.cut(stream.zero()));
        let (zero, reach) = (stream.zero(), stream.zero() + pace.ahead);
        let handed = loop {
            let handed = stream.hand_over(board, &mut timelines, &vec![0; capacity.len()], reach)?;
            if !handed.more {
                break handed;
            }
        };
        let brakings = lease::brakings(&stream)?;
        let limits = brakings.iter().map(|braking| braking.limit).collect();
        let joined = lease::joined(&timelines, &brakings, stream.program(), zero);
        match (lease::longest(&stream, &timelines, joined, reach), handed.short) {
            (Some(lease), _) => Ok(Beginning { stream, timelines, limits, lease, joined }),
            (None, short) => Err(too_short(short.unwrap_or_default(), capacity, 0, pace)),
        }
    }

    /// Has the board go over to it.
    fn switch<B: Leased>(&self, board: &mut B) -> Result<(), SessionError> {
        board.switch(self.stream.epoch(), self.stream.zero(), self.lease, &self.limits).map_err(|refused| {
            match board.lost() {
                Some(why) => SessionError::Lost(why.clone()),
                None => SessionError::Switch(refused),
            }
        })
    }

    /// What the motors will have counted if nothing more is sent.
    fn expected(&self) -> Vec<i64> {
        match self.lease {
            Lease::Until(until) => counts(&lease::ended(&self.timelines, &self.limits, self.stream.program(), until)),
            Lease::Last => counts(&self.timelines),
        }
    }
}
