//! A session streams a motion program into a board while the motors run, and survives a pulled cable.
//!
//! A *lease* says up to which tick the board may follow the plan. The session extends the lease as it sends more of the plan. If no extension
//! comes in time, the motors brake within their limits (`pulsetrain_core::braking`). The host computes the same stop from the same numbers
//! (`pulsetrain_board::replay`), so that it knows where each motor comes to rest, even if the line broke.
//!
//! # What is here, top down
//! - [`drive`]: a motion on the native board, on a virtual board or on a real one, from connecting to the final counts; [`rehearsal`]: the same on
//!   the virtual Uno, with each edge judged, before a real Uno gets the motion
//! - [`prepare`]: from a motion file to plans; [`estimate`]: how long and how large they will be; [`fit`]: what would fit if a plan is refused
//! - [`Session`]: fills the queues, lets time pass, stops, changes to another program; `halt`: its pause, resume and tempo; [`fade`]: other laws while it
//!   goes on
//! - [`control`]: commands and events of a running session, as values; [`lateness`]: how late the STEP edges were
//! - [`pause`]: the quickest change of the rate of the laws' time, within all motors' limits
//! - `lease`: how far the lease may reach, and what the motors do after its end
//! - `stream`: a program's plan as queue items, sent as the queues have room
//! - `timeline`: one motor's items in board ticks, replayed in integers
//!
//! # Where a lease may end
//! Not after the last step that the board has of each motor that goes on: data that come late then make no difference, and the replay is exact.
//! Not more than [half a second](AHEAD_MS) after the board's time: motors do not run on for long without a host. Not where a motor in motion
//! would have to stop without braking.
//!
//! # What is not
//! Planning is `pulsetrain-plan`'s, and making edges is `pulsetrain-board`'s. Files and terminals are `pulsetrain`'s.
//!
//! # Example
//! The template's motion on the native board, in virtual time:
//! ```
//! use pulsetrain_motion::{file, template};
//! use pulsetrain_session::{drive::Driven, prepare::Prepared};
//!
//! let no_files = |_: &std::path::Path| Err(std::io::ErrorKind::NotFound.into());
//! let contents = file::read_contents(&template::motion_file("example"), "example.toml", &no_files)?;
//! let prepared = Prepared::new("example.toml".to_owned(), contents, None)?.ending(None)?;
//! let mut driven = Driven::native(&prepared)?;
//! let mut edges = 0;
//! let ended = driven.run(&mut |_: pulsetrain_board::Edge| edges += 1, |_event| {})?;
//! // The motor goes there and back, and each of its steps is a rising and a falling edge.
//! assert!(!ended.stopped && edges > 0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![forbid(unsafe_code)]

pub mod control;
pub mod drive;
mod error;
pub mod estimate;
pub mod fade;
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
pub use halt::Tempo;
pub use prove::Proof;

use control::{MotorStatus, Status};
use halt::Playback;
use plans::Planned;
use pulsetrain_board::lease::{ExtendRefused, Lease, LeaseState, Leased};
use pulsetrain_board::{Board, Faults, Observer, SwitchRefused};
use pulsetrain_core::Epoch;
use pulsetrain_core::braking::Limit;
use pulsetrain_core::lease::LapseCause;
use pulsetrain_motion::program::Program;
use pulsetrain_plan::line::{AHEAD_MS, KEPT};
use pulsetrain_plan::{Certificate, Line, Origin, Start};
use std::collections::VecDeque;
use std::sync::Arc;
use stream::Stream;
use timeline::{Step, Timeline};

/// Seconds that a board may take after the last step to report that its motors rest. A working board needs milliseconds; after this the session
/// reports a fault ([`SessionError::Restless`]) instead of waiting for ever.
const PATIENCE_S: u64 = 5;

/// How many times a beginning that reached the board too late is planned and sent again, each time with as much more time as the last one took.
const RETRIES: u32 = 3;

/// Seconds that a beginning may lie ahead of the board's time. Boards have 32-bit clocks and can compare ticks within 2^31: 17 s on a Pico.
pub const FARTHEST_BEGIN_S: u64 = 10;

/// Milliseconds. When a lease ends sooner than this, the motors are about to brake, and the queues are filled completely: no room is reserved for
/// a change.
const SHORT_MS: u64 = 40;

/// The bytes of a motor's next items, with which its lease can be extended after a change.
const NEXT_BYTES: usize = 16;

/// How many extensions may be without an answer at a time. With several, a short queue need not last until one was answered and the next one arrived.
/// A slow line needs more of them, as answers come late there: one for each [`PENDING_PER_LINK_MS`] of the link's time. On a fast line more of them would
/// cost an Uno too much processor time.
const MOST_PENDING: std::ops::RangeInclusive<u64> = 3..=6;
/// Milliseconds of the link's time for each extension without an answer; see [`MOST_PENDING`].
const PENDING_PER_LINK_MS: u64 = 8;

/// Streams a program into a board. Ticks are the board's, extended to 64 bits.
pub struct Session<B> {
    board: B,
    /// The tick at which the first program's laws began.
    begun: u64,
    /// θ of each motor where its count is 0, steps, by the first program.
    origins: Vec<f64>,
    stream: Stream,
    timelines: Vec<Timeline>,
    /// How hard each motor may brake, as the board has accepted it.
    limits: Vec<Limit>,
    /// The lease that the board has accepted. It belongs to the new plan already while a change waits for its tick.
    confirmed_lease: Lease,
    /// Extensions that the board has not answered, oldest first.
    pending_extensions: VecDeque<Extension>,
    /// The plan before the last change, until the tick of that change is past.
    replaced: Option<Replaced>,
    /// From this tick on every motor of the plan can brake: see [`lease::brakeable_from`].
    brakeable_from: u64,
    pace: Pace,
    /// Room in each motor's empty queue, in the unit of the board's [`Sizer`](pulsetrain_board::Sizer).
    capacity: Vec<usize>,
    /// The motor whose plan on the board ended soonest when the queues were filled last.
    motor_behind: usize,
    /// That motor, if its queue was full then.
    motor_full: Option<usize>,
    /// When the queues were filled last, tick.
    filled_at: u64,
    /// No more of the plan is sent: it was stopped, or the session failed.
    is_over: bool,
    /// The tick from which the motors brake, if they do.
    braking_from: Option<u64>,
    /// If the line broke before a switch was answered: what each motor will have counted if the board accepted it.
    unanswered: Option<Vec<i64>>,
    /// The line broke before the board answered an order to brake.
    stop_unanswered: bool,
    /// The program that is followed, and whether its time runs, is paused or was stopped.
    playback: Playback,
    /// The line to the board; `None` if there is none.
    line: Option<Line>,
    /// Since when half of each queue is kept free, tick: a change did not fit.
    room_reserved_at: Option<u64>,
    /// What the last change took.
    effort: Effort,
    /// Changes do not begin before this tick.
    not_before: Option<u64>,
    /// The error of filling the queues after the last change, which [`Session::advance`] returns.
    refused_later: Option<SessionError>,
}

/// What it takes to make a change. The next one is likely to take as much.
#[derive(Clone, Copy, Debug, Default)]
struct Effort {
    /// When it was asked for, tick.
    asked_at: u64,
    /// Planning it, ticks of the board.
    planning: u64,
    /// The beginning in the board's queues, in its unit.
    room: usize,
    /// The queues have no room for more than what must be there: see [`Session::beginning_lasts`].
    is_short: bool,
}

/// An extension of the lease.
struct Extension {
    lease: Lease,
    /// How hard each motor may brake from then on.
    limits: Vec<Limit>,
    /// Whether the limits are sent with it: the board has other ones.
    brings_limits: bool,
}

/// A plan that the board follows before tick `until`; then it changes to another one.
struct Replaced {
    until: u64,
    /// Its laws, which the motors still follow; `None` before the first program.
    stream: Option<Stream>,
    timelines: Vec<Timeline>,
    limits: Vec<Limit>,
    /// The tick from which the motors brake or rest after a stop, if there was one.
    braking_from: Option<u64>,
}

/// How far ahead of the board's time the session works, ticks.
#[derive(Clone, Copy, Debug)]
struct Pace {
    tick_hz: u64,
    fraction_bits: u32,
    /// How long before a step the board must have it: the DIR setup, and the pulse and DIR hold of the step before.
    lead: u64,
    /// How long it takes to send a command and get its answer.
    link: u64,
    /// How far ahead of the board's time the plan is sent, at most.
    look_ahead: u64,
    /// How much later a frame comes that was lost once.
    repetition: u64,
    /// How much a change that came too late may be put off when it is tried again, in all.
    most_delay: u64,
}

impl Pace {
    fn of<B: Board>(program: &Program, board: &B) -> Pace {
        let tick_hz = program.board.tick_hz;
        let reversals = program.motors.iter().map(|motor| program.timing(motor).ticks(tick_hz).reversal());
        // A board accepts ticks up to 2^30 ahead of its time.
        let within = |ticks: u64| ticks.clamp(1, 1 << 28);
        Pace {
            tick_hz,
            fraction_bits: program.board.registers.fraction_bits,
            lead: reversals.max().unwrap_or(0) + 1,
            link: board.round_trip(),
            repetition: board.repetition(),
            look_ahead: within(tick_hz * AHEAD_MS / 1000),
            most_delay: within(tick_hz / 5),
        }
    }

    /// How many extensions may be without an answer.
    fn most_pending(&self) -> usize {
        let pending = self.link / (self.tick_hz * PENDING_PER_LINK_MS / 1000).max(1);
        pending.clamp(*MOST_PENDING.start(), *MOST_PENDING.end()) as usize
    }

    /// The least time in which the next part of a plan can reach the board.
    const fn margin(&self) -> u64 {
        self.lead + self.link + self.tick_hz / 500
    }
}

/// Where a motor is at a tick, by its law.
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
    /// Steps of each motor, forward minus backward, as the host's replay has them.
    pub replayed: Vec<i64>,
    /// Other counts that are possible if the line broke before answers came: one entry for each change or extension without an answer, as if the
    /// board had accepted it and nothing after it. The last one comes first.
    pub replayed_otherwise: Vec<Vec<i64>>,
    /// The line broke before the board answered an order to brake. If the board obeyed the order, the motors stopped sooner than `replayed` says,
    /// and their counts are unknown.
    pub stop_unanswered: bool,
    /// The faults that the board reports for each motor.
    pub faults: Vec<Faults>,
    /// Why the motors braked before the motion's end; `None` if they did not.
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

    /// As [`Session::new`], with the laws' time 0 at a given tick of the board: several boards can begin together.
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
        let pace = Pace::of(&program, &board);
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
            let lasts = [zero, zero + pace.look_ahead];
            let begun = Beginning::new(&mut board, stream, &timelines, &capacity, &pace, lasts)?;
            match begun.switch(&mut board) {
                Ok(()) => break (zero, begun),
                // Planning and sending took longer than the begin was put off. The next try leaves that much time.
                Err(SessionError::Switch(SwitchRefused::Late { .. })) if tries < RETRIES => {
                    (took, tries) = (board.now() - called, tries + 1);
                }
                Err(SessionError::Switch(SwitchRefused::Late { .. })) => return Err(SessionError::NotBegun),
                Err(error) => return Err(error),
            }
        };
        let replaced =
            Replaced { until: zero, stream: None, timelines, limits: begun.limits.clone(), braking_from: None };
        let datum = |motor: usize| begun.stream.datum(motor);
        let origins = (0..motors).map(|motor| datum(motor).0 as f64 + datum(motor).1).collect();
        let mut session = Session {
            board,
            begun: zero,
            origins,
            stream: begun.stream,
            timelines: begun.timelines,
            limits: begun.limits,
            confirmed_lease: begun.lease,
            pending_extensions: VecDeque::new(),
            replaced: Some(replaced),
            brakeable_from: zero,
            pace,
            capacity,
            motor_behind: 0,
            motor_full: None,
            filled_at: 0,
            is_over: false,
            braking_from: None,
            unanswered: None,
            stop_unanswered: false,
            playback: Playback::begun(program),
            line: None,
            room_reserved_at: None,
            effort: Effort::default(),
            not_before: None,
            refused_later: None,
        };
        session.fill()?;
        Ok(session)
    }

    /// Sends as much of the plan as the queues have room for, and extends the lease.
    ///
    /// # Errors
    /// When the plan is refused, the board is lost, or the motors brake already. No more of the plan is sent after an error.
    pub fn fill(&mut self) -> Result<(), SessionError> {
        let filled = self.try_fill();
        self.is_over |= filled.is_err();
        filled
    }

    fn try_fill(&mut self) -> Result<(), SessionError> {
        self.check_board()?;
        // Motors that are about to brake need all of the room; else some of it is reserved for a change.
        let is_wanted = self
            .room_reserved_at
            .is_some_and(|since| self.board.now() < since + self.pace.tick_hz / 1000 * halt::RESERVED_MS);
        let (part, links) = if is_wanted { (2, 4) } else { (KEPT, 0) };
        let short = (self.pace.tick_hz / 1000 * SHORT_MS).max(links * self.pace.link);
        let is_short = self.committed_until().saturating_sub(self.board.now()) < short;
        let reserved: Vec<usize> =
            self.capacity.iter().map(|capacity| if is_short { 0 } else { capacity / part }).collect();
        let mut more = !self.is_over;
        while more {
            let planned_up_to = self.planned_up_to();
            let handed = self.stream.hand_over(&mut self.board, &mut self.timelines, &reserved, planned_up_to)?;
            (more, self.motor_full) = (handed.has_more, handed.motor_full);
            self.extend()?;
        }
        if let Some((_, motor)) = self.stream.least_handed_over() {
            self.motor_behind = motor;
        }
        self.filled_at = self.board.now();
        Ok(())
    }

    /// The tick up to which the plan may be sent, and at which a lease may end at most.
    fn planned_up_to(&self) -> u64 {
        self.board.now().max(self.stream.zero()) + self.pace.look_ahead
    }

    /// Extends the lease, if that moves its end by a quarter or more of what is left of it.
    fn extend(&mut self) -> Result<(), SessionError> {
        self.take_answers();
        let last = self.pending_extensions.back().map_or(self.confirmed_lease, |pending| pending.lease);
        let (Lease::Until(until), true) = (last, self.pending_extensions.len() < self.pace.most_pending()) else {
            return Ok(());
        };
        let brakings = lease::brakings(&self.stream)?;
        let earliest = until.max(self.board.horizon());
        let Some(next) = lease::longest(&self.stream, &self.timelines, earliest, self.planned_up_to()) else {
            return Ok(());
        };
        if let Lease::Until(next) = next
            && next - until < (until - until.min(self.board.now())) / 4
        {
            return Ok(());
        }
        let mut limits: Vec<Limit> = brakings.iter().map(|braking| braking.limit).collect();
        if self.replaced.is_some() {
            limits = self.shared_limits(limits, next);
        }
        // The limits are left out only if every pending extension brings the same: the board may refuse any one of those.
        let is_known = self.pending_extensions.iter().all(|pending| pending.limits == limits) && limits == self.limits;
        let new_limits: &[Limit] = if is_known { &[] } else { &limits };
        match self.board.extend(next, new_limits) {
            Ok(()) => {
                self.pending_extensions.push_back(Extension { lease: next, limits, brings_limits: !is_known });
                self.take_answers();
                Ok(())
            }
            // The old lease stands, or the motors brake already: the board's next answers tell which.
            Err(ExtendRefused::Late { .. } | ExtendRefused::Early { .. }) => Ok(()),
            Err(ExtendRefused::Off | ExtendRefused::Lapsed { .. } | ExtendRefused::Lost) => self.check_board(),
        }
    }

    /// Takes the board's answers to extensions: an accepted one becomes the confirmed lease.
    fn take_answers(&mut self) {
        while let Some(accepted) = self.board.extended() {
            if let Some(Extension { lease, limits, brings_limits }) = self.pending_extensions.pop_front()
                && accepted
            {
                // While a change waits for its tick they hold for the plan before it too.
                if let Some(replaced) = self.replaced.as_mut().filter(|_| brings_limits) {
                    replaced.limits.clone_from(&limits);
                }
                (self.confirmed_lease, self.limits) = (lease, limits);
            }
        }
    }

    /// Looks whether the board is lost or its motors brake, and forgets steps that are long past.
    fn check_board(&mut self) -> Result<(), SessionError> {
        let now = self.board.now();
        self.take_answers();
        if self.replaced.as_ref().is_some_and(|replaced| replaced.until < now) {
            self.replaced = None;
        }
        if let Some(why) = self.board.lost() {
            return if self.is_complete() { Ok(()) } else { Err(SessionError::Lost(why.clone())) };
        }
        if let (None, Some((at, cause))) = (self.braking_from, self.lapse()) {
            let was_over = self.is_over;
            self.brake_from(at);
            if cause != LapseCause::Ordered && !was_over {
                return Err(self.failure(at, cause));
            }
        }
        if !self.is_complete() {
            // Not beyond the lease's end: if the lease is over by now, the stop after it is still to be replayed.
            let since = now.saturating_sub(self.pace.look_ahead / 2).min(self.committed_until());
            self.timelines.iter_mut().for_each(|timeline| timeline.forget(since));
        }
        Ok(())
    }

    /// The tick from which the motors brake, as the board reports it, and why. A change after a stop may wait for its tick: until then the board still
    /// reports the old stop, which is no news.
    fn lapse(&self) -> Option<(u64, LapseCause)> {
        let LeaseState::Lapsed { at, cause, .. } = self.board.lease() else { return None };
        self.replaced.as_ref().is_none_or(|replaced| replaced.braking_from != Some(at)).then_some((at, cause))
    }

    /// The error for motors that brake from tick `at` on without an order.
    fn failure(&self, at: u64, cause: LapseCause) -> SessionError {
        let seconds = |ticks: u64| ticks as f64 / self.pace.tick_hz as f64;
        let at_s = self.law_time_at(at).seconds();
        if cause != LapseCause::NotExtended {
            return SessionError::Fault { at_s, cause };
        }
        match self.motor_full.filter(|_| at.saturating_sub(self.filled_at) <= self.pace.margin()) {
            Some(motor) => self.too_short(motor, at),
            None => {
                let late_s = seconds(self.board.now().saturating_sub(at));
                SessionError::Stopped { motor: self.motor_behind, at_s, late_s }
            }
        }
    }

    fn too_short(&self, motor: usize, at: u64) -> SessionError {
        too_short(motor, &self.capacity, self.law_time_at(at).seconds())
    }

    /// Notes that the motors brake from tick `at` on.
    fn brake_from(&mut self, at: u64) {
        self.timelines = self.if_braked_from(at);
        (self.is_over, self.braking_from, self.replaced) = (true, Some(at), None);
        self.playback.stopped();
    }

    /// Each motor's timeline if all brake from tick `until` on.
    fn if_braked_from(&self, until: u64) -> Vec<Timeline> {
        let (timelines, limits) = match &self.replaced {
            Some(replaced) if replaced.braking_from == Some(until) => return replaced.timelines.clone(),
            Some(replaced) if until < replaced.until => (&replaced.timelines, &replaced.limits),
            _ => (&self.timelines, &self.limits),
        };
        lease::braked_from(timelines, limits, self.stream.program(), until)
    }

    /// Each motor's timeline if no more is sent, by what the board has confirmed.
    fn if_nothing_more_is_sent(&self) -> Vec<Timeline> {
        let committed_until = self.committed_until();
        if self.braking_from.is_some() || committed_until == u64::MAX {
            self.timelines.clone()
        } else {
            self.if_braked_from(committed_until)
        }
    }

    /// Lets time pass up to and with tick `until`, and keeps the queues filled meanwhile.
    ///
    /// # Errors
    /// As for [`Session::fill`]; time passes up to `until` all the same.
    pub fn advance(&mut self, until: u64, observer: &mut impl Observer) -> Result<(), SessionError> {
        let mut filled = self.refused_later.take().map_or_else(|| self.fill(), Err);
        while self.board.now() <= until {
            let next = until.min(self.next_event()).max(self.board.now());
            self.board.advance(next, observer);
            if filled.is_ok() {
                filled = self.fill();
            }
        }
        filled
    }

    /// Runs to the end of the plan, or until the motors rest; `progress` gets the board's tick from time to time.
    ///
    /// Does not return for endless laws: those need [`Session::advance`] and [`Session::stop`].
    pub fn run(&mut self, observer: &mut impl Observer, mut progress: impl FnMut(u64)) -> Report {
        let step = self.pace.look_ahead / 2;
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
                let at_s = self.law_time_at(last).seconds();
                return self.report(failure.or(Some(SessionError::Restless { at_s })));
            }
            let until = self.board.now() + step;
            self.board.advance(if self.board.now() <= last { until.min(last) } else { until }, observer);
            progress(self.board.now());
        }
        // Lets the observer have the edges from the time in which the board was lost.
        self.board.advance(self.board.now().saturating_sub(1), observer);
        // A fault may have been reported after the queues were filled last.
        failure = failure.or(self.check_board().err());
        self.report(failure)
    }

    /// Brings all motors to rest within their limits, as soon as the order reaches the board. Returns the tick at which they begin to brake.
    ///
    /// # Errors
    /// When the order cannot be sent, or its answer does not come. The motors then brake at the end of their lease, or sooner.
    pub fn stop(&mut self) -> Result<u64, SessionError> {
        self.is_over = true;
        self.playback.stopped();
        self.check_board()?;
        if let Some(at) = self.braking_from {
            return Ok(at);
        }
        // Just after a change a motor may not be able to brake yet. Then the lease ends as soon as all of them can.
        let brakeable_from = self.brakeable_from;
        let is_joining = (self.stream.zero()..brakeable_from).contains(&self.board.horizon());
        if is_joining {
            let lease = Lease::Until(brakeable_from);
            let limits = self.pending_extensions.back().map_or(&self.limits, |pending| &pending.limits).clone();
            if self.board.extend(lease, &limits).is_ok() {
                self.pending_extensions.push_back(Extension { lease, limits, brings_limits: true });
                self.board.await_extensions();
                self.take_answers();
                if self.confirmed_lease == lease {
                    return Ok(brakeable_from);
                }
            }
        }
        let was_lost = self.board.lost().is_some();
        match self.board.brake() {
            Some(at) => {
                self.take_answers();
                self.brake_from(at);
                Ok(at)
            }
            None => {
                self.check_board()?;
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

    /// Changes to another program at tick `at`, which is the time 0 of its laws.
    ///
    /// Its laws have the θ of the first program: they must begin within two steps of where the motors are, and within the pull-in rate
    /// of their speed; see [`Session::state`]. Motors, wiring and board must be the same. After a stop, `at` may be any tick once the motors rest.
    ///
    /// # Errors
    /// When `at` is too early or too late, or another change waits, or the new plan is refused; the old one goes on.
    pub fn change(&mut self, at: u64, program: impl Into<Arc<Program>>) -> Result<(), SessionError> {
        let program = program.into();
        self.board.await_extensions();
        self.effort.asked_at = self.board.now();
        self.change_proven(at, Arc::clone(&program), 0)?;
        self.playback = Playback::begun(program);
        Ok(())
    }

    /// As [`Session::change`], with the first `proven` ticks planned before anything is sent. If that plan is refused, nothing changes.
    fn change_proven(&mut self, at: u64, program: Arc<Program>, proven: u64) -> Result<(), SessionError> {
        let (motors, old) = (program.motors.len(), self.timelines.len());
        let pace = Pace::of(&program, &self.board);
        if motors != old || (pace.tick_hz, pace.fraction_bits) != (self.pace.tick_hz, self.pace.fraction_bits) {
            return Err(SessionError::Motors { program: motors, board: old });
        }
        // All extensions must be answered: the old plan's limits have to be known as the board has them.
        self.board.await_extensions();
        self.check_board()?;
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
        let [least, lasts] = self.beginning_lasts();
        let sizes = halt::prove(&program, &starts, proven, lasts, &self.board)?;
        let epoch = self.next_epoch();
        let stream = Stream::from(program, at, &starts, datums, epoch, &self.board)?;
        (self.effort.planning, self.effort.room) = (self.board.now() - self.effort.asked_at, sizes.iter().sum());
        if proven > 0 {
            self.check_beginning(at, &sizes)?;
        }
        let lasts = [at + least, at + lasts];
        let mut begun = Beginning::new(&mut self.board, stream, &self.timelines, &self.capacity, &pace, lasts)?;
        if self.braking_from.is_none() {
            // Some boards brake by a plan's limits before it begins. Until then both plans have the same.
            begun.limits = self.shared_limits(begun.limits, begun.lease);
            if let Err(error) = self.take_limits(&begun.limits) {
                self.board.discard(epoch);
                return Err(error);
            }
        }
        if let Err(error) = begun.switch(&mut self.board) {
            if let SessionError::Lost(_) = error {
                // The board may have accepted the switch, and only its answer was lost.
                self.unanswered = Some(begun.if_nothing_more_is_sent());
            }
            return Err(error);
        }
        let timelines = std::mem::replace(&mut self.timelines, begun.timelines);
        let limits = std::mem::replace(&mut self.limits, begun.limits);
        let stream = Some(std::mem::replace(&mut self.stream, begun.stream));
        self.replaced = Some(Replaced { until: at, stream, timelines, limits, braking_from: self.braking_from });
        self.confirmed_lease = begun.lease;
        self.pending_extensions.clear();
        (self.brakeable_from, self.is_over, self.braking_from) = (begun.brakeable_from, false, None);
        // The change is made: what is refused of the plan after its beginning ends the motion later.
        self.refused_later = self.fill().err();
        Ok(())
    }

    /// The limits for a plan and for the one before it, which the board still follows: the harder ones. A lease without an end is not extended again, so
    /// that it keeps what it gets: the plan's own limits.
    fn shared_limits(&self, own: Vec<Limit>, lease: Lease) -> Vec<Limit> {
        if lease == Lease::Last { own } else { lease::harder(&self.limits, &own) }
    }

    /// Has the board take other braking limits for the plan that it follows, at once.
    fn take_limits(&mut self, limits: &[Limit]) -> Result<(), SessionError> {
        if limits == self.limits {
            return Ok(());
        }
        let lease = self.confirmed_lease;
        match self.board.extend(lease, limits) {
            Ok(()) => {
                let limits = limits.to_vec();
                self.pending_extensions.push_back(Extension { lease, limits, brings_limits: true });
                self.board.await_extensions();
            }
            // Nothing moves.
            Err(ExtendRefused::Off | ExtendRefused::Lapsed { .. }) => return self.check_board(),
            Err(ExtendRefused::Late { .. } | ExtendRefused::Early { .. } | ExtendRefused::Lost) => {}
        }
        self.check_board()?;
        // The lease is about to end, and the motors to brake.
        let horizon = self.board.horizon();
        if limits == self.limits { Ok(()) } else { Err(SessionError::Switch(SwitchRefused::Late { horizon })) }
    }

    /// How long the beginning of a plan must last in the board's queues, and how long it should, ticks: until more of it is there, and until it is
    /// there although a frame was lost.
    fn beginning_lasts(&self) -> [u64; 2] {
        let next = NEXT_BYTES * self.capacity.len();
        // 4 ms, since a board has little time for its line while its motors go over to the plan.
        let least = self.pace.lead + self.board.delivery(next) + self.pace.tick_hz / 250;
        [least, if self.effort.is_short { least } else { least + self.pace.repetition }]
    }

    /// Looks whether the beginning of a plan can reach the board before it begins at tick `at`, and whether the queues have room for it; `sizes` are its
    /// parts in each queue. Nothing is sent if not.
    fn check_beginning(&self, at: u64, sizes: &[usize]) -> Result<(), SessionError> {
        let earliest = self.earliest_with(self.effort.room);
        if at < earliest {
            return Err(SessionError::Early { at, earliest });
        }
        match sizes.iter().enumerate().position(|(motor, size)| self.board.room(motor) < *size) {
            Some(motor) => Err(too_short(motor, &self.capacity, 0.0)),
            None => Ok(()),
        }
    }

    /// The epoch after the last one that was sent.
    fn next_epoch(&self) -> Epoch {
        self.stream.epoch().next()
    }

    /// The state of a motor at a tick that is not past: by its law, or at rest.
    ///
    /// # Errors
    /// While the motor brakes for a stop, for ticks after [`committed_until`](Session::committed_until), or where its law cannot be evaluated.
    pub fn state(&mut self, motor: usize, tick: u64) -> Result<MotorState, SessionError> {
        let timeline = &self.timelines[motor];
        let count = timeline.count_before(tick).unwrap_or(0);
        let last = self.timelines.iter().filter_map(Timeline::last_tick).max().unwrap_or(0);
        let (whole, rest) = self.stream.datum(motor);
        let committed_until = self.committed_until();
        let rests = (self.braking_from.is_some() || committed_until == u64::MAX) && tick > last;
        if rests {
            return Ok(MotorState { count, theta: (whole + count) as f64 + rest, speed: 0.0 });
        }
        if tick > committed_until {
            return Err(SessionError::Late { at: tick, latest: committed_until });
        }
        let zero = self.stream.zero();
        let (place, is_moving) = match &mut self.replaced {
            // Until a change's tick the motors follow the laws before it.
            Some(Replaced { stream: Some(stream), braking_from: None, .. }) if tick < zero => {
                (stream.law_at(motor, tick.max(stream.zero()), count)?, true)
            }
            _ => (self.stream.law_at(motor, tick.max(zero), count)?, tick >= zero),
        };
        let theta = (whole + count) as f64 + (rest + place.offset);
        let speed = if is_moving { place.speed } else { 0.0 };
        Ok(MotorState { count, theta, speed })
    }

    /// The tick up to which the motors follow their laws even if nothing more is sent: where the confirmed lease ends or the motors began to brake.
    /// `u64::MAX` if the board has the plan to its end.
    #[must_use]
    pub fn committed_until(&self) -> u64 {
        match (self.braking_from.or(self.lapse().map(|(at, _)| at)), self.confirmed_lease) {
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
        if after <= self.committed_until() || self.braking_from.is_some() {
            return self.timelines.get(motor)?.count_before(after);
        }
        self.if_nothing_more_is_sent().get(motor)?.count_before(after)
    }

    /// The state of all motors and of the lease. Times are seconds since the session began.
    pub fn status(&mut self) -> Status {
        let now = self.board.now();
        let tick_s = 1.0 / self.pace.tick_hz as f64;
        let motors = (0..self.capacity.len()).map(|motor| {
            let state = self.state(motor, now).ok();
            let position = state.map_or_else(|| self.count_at(motor, now).unwrap_or_default(), |state| state.count);
            MotorStatus {
                position,
                target: state.map(|state| state.theta - self.origins[motor]),
                speed: state.map(|state| state.speed),
                queue: (self.board.room(motor), self.capacity[motor]),
            }
        });
        let motors = motors.collect();
        let committed_until = self.committed_until();
        Status {
            at_s: now.saturating_sub(self.begun) as f64 * tick_s,
            lease_s: (committed_until != u64::MAX).then(|| committed_until.saturating_sub(now) as f64 * tick_s),
            motors,
            lateness: None,
        }
    }

    /// Whether the motion is paused, or is slowing down to a pause.
    #[must_use]
    pub fn is_paused(&self) -> bool {
        self.playback.is_paused()
    }

    /// The first tick at which a change can be made now.
    #[must_use]
    pub fn earliest(&self) -> u64 {
        self.earliest_with(self.effort.room) + self.effort.planning
    }

    /// The first tick at which a plan can begin that is there already and takes `room` in the queues.
    fn earliest_with(&self, room: usize) -> u64 {
        self.board.horizon().max(self.board.now()) + self.pace.lead + self.board.delivery(room)
    }

    /// The tick at which the laws' time is 0; after a change, that of the new laws.
    #[must_use]
    pub fn zero(&self) -> u64 {
        self.stream.zero()
    }

    /// Whether no more of the plan is to be sent: all of it was, or the motion was stopped or failed.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.is_over || self.confirmed_lease == Lease::Last
    }

    /// The tick of the last step, if nothing more is sent.
    #[must_use]
    pub fn last_step(&self) -> Option<u64> {
        self.if_nothing_more_is_sent().iter().filter_map(Timeline::last_tick).max()
    }

    /// What is planned of each motor so far: at the end of a motion, all of it. After a change it is the plan since then.
    #[must_use]
    pub fn planned(&self) -> Vec<Planned> {
        self.stream.planned()
    }

    /// The figures proven of a motor's plan, as far as it was planned.
    #[must_use]
    pub fn certificate(&self, motor: usize) -> Certificate {
        self.stream.certificate(motor)
    }

    /// How much the session remembers: items, answers that are due, and the laws as text. However often the laws change, it does not grow.
    #[must_use]
    pub fn remembered(&self) -> usize {
        let replaced = self.replaced.iter().flat_map(|replaced| &replaced.timelines);
        let items: usize = self.timelines.iter().chain(replaced).map(Timeline::len).sum();
        items + self.stream.unsent() + self.pending_extensions.len() + format!("{:?}", self.playback).len()
    }

    /// Holds a higher tempo against the line that brings the plan to the board.
    pub fn hold_to_line(&mut self, line: Option<Line>) {
        self.line = line;
    }

    /// The board.
    #[must_use]
    pub fn board(&self) -> &B {
        &self.board
    }

    /// The board, to let its time pass or read it without filling its queues.
    pub fn board_mut(&mut self) -> &mut B {
        &mut self.board
    }

    /// Ends the session and returns the board. It gets no more of the plan: the motors brake at the end of their lease.
    #[must_use]
    pub fn into_board(self) -> B {
        self.board
    }

    fn report(&self, failure: Option<SessionError>) -> Report {
        let on_the_way = self.pending_extensions.iter().rev().map(|Extension { lease, limits, .. }| match lease {
            Lease::Until(until) => counts(&lease::braked_from(&self.timelines, limits, self.stream.program(), *until)),
            Lease::Last => counts(&self.timelines),
        });
        let otherwise = self.unanswered.clone().into_iter().chain(on_the_way).collect();
        let expected = self.if_nothing_more_is_sent();
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

    /// The tick at which the queues are to be filled next.
    fn next_event(&self) -> u64 {
        let now = self.board.now();
        if self.is_complete() {
            return u64::MAX;
        }
        // After a quarter of the time that the board can go on for, so that even a short queue is filled in time.
        let soon = (self.committed_until().saturating_sub(now) / 4).max(1);
        now + if self.pace.link > 0 { soon.min(self.look_ticks()).max(self.pace.lead) } else { soon }
    }

    /// How often to look for room in the queues of a board on a line, ticks: at least 640 times a second, as data go out little by little.
    const fn look_ticks(&self) -> u64 {
        let often = self.pace.tick_hz / 640;
        if self.pace.link < often { self.pace.link } else { often }
    }
}

/// What each motor will have counted at the end of its timeline.
fn counts(timelines: &[Timeline]) -> Vec<i64> {
    timelines.iter().filter_map(|timeline| timeline.count_before(u64::MAX)).collect()
}

fn too_short(motor: usize, capacity: &[usize], at_s: f64) -> SessionError {
    let capacity = capacity.get(motor).copied().unwrap_or(0);
    SessionError::QueueTooShort { motor, at_s, capacity }
}

/// The beginning of a plan, which is in the board's queues but not yet followed.
struct Beginning {
    stream: Stream,
    timelines: Vec<Timeline>,
    limits: Vec<Limit>,
    lease: Lease,
    brakeable_from: u64,
}

impl Beginning {
    /// Sends a plan up to the second of two ticks, or as much of it as there is room for. It takes over from `timelines` at its own tick 0, and must
    /// last up to the first of them: by then more of it can reach the board.
    fn new<B: Leased>(
        board: &mut B,
        stream: Stream,
        timelines: &[Timeline],
        capacity: &[usize],
        pace: &Pace,
        lasts: [u64; 2],
    ) -> Result<Beginning, SessionError> {
        let epoch = stream.epoch();
        let begun = Beginning::hand_over(board, stream, timelines, capacity, pace, lasts);
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
        [least, until]: [u64; 2],
    ) -> Result<Beginning, SessionError> {
        let mut timelines = timelines.to_vec();
        timelines.iter_mut().for_each(|timeline| timeline.cut(stream.zero()));
        let zero = stream.zero();
        let (mut planned_up_to, latest) = (until, zero + pace.look_ahead);
        // It is long enough when all motors can brake in it.
        let (handed, brakings, brakeable_from) = loop {
            let handed = stream.hand_over(board, &mut timelines, &vec![0; capacity.len()], planned_up_to)?;
            if handed.has_more {
                continue;
            }
            let brakings = lease::brakings(&stream)?;
            let brakeable_from = lease::brakeable_from(&timelines, &brakings, stream.program(), zero);
            let is_joined = lease::is_joined(&timelines, &brakings, stream.program(), zero);
            if (is_joined && brakeable_from < planned_up_to) || handed.motor_full.is_some() || planned_up_to >= latest {
                break (handed, brakings, brakeable_from);
            }
            planned_up_to = latest.min(2 * planned_up_to - zero);
        };
        let limits = brakings.iter().map(|braking| braking.limit).collect();
        let long_enough = |lease: &Lease| match lease {
            Lease::Until(until) => *until >= least,
            Lease::Last => true,
        };
        let longest = lease::longest(&stream, &timelines, brakeable_from, planned_up_to).filter(long_enough);
        match (longest, handed.motor_full) {
            (Some(lease), _) => Ok(Beginning { stream, timelines, limits, lease, brakeable_from }),
            (None, motor_full) => Err(too_short(motor_full.unwrap_or_default(), capacity, 0.0)),
        }
    }

    /// Has the board switch to this plan at its tick 0.
    fn switch<B: Leased>(&self, board: &mut B) -> Result<(), SessionError> {
        board.switch(self.stream.epoch(), self.stream.zero(), self.lease, &self.limits).map_err(|refused| {
            match board.lost() {
                Some(why) => SessionError::Lost(why.clone()),
                None => SessionError::Switch(refused),
            }
        })
    }

    /// What each motor will have counted if the switch is accepted and no more is sent.
    fn if_nothing_more_is_sent(&self) -> Vec<i64> {
        match self.lease {
            Lease::Until(until) => {
                counts(&lease::braked_from(&self.timelines, &self.limits, self.stream.program(), until))
            }
            Lease::Last => counts(&self.timelines),
        }
    }
}
