//! The session: a program, streamed into a board so that the cable may be pulled at any moment.
//!
//! What a board has been told always ends in a stop tail. To go on, the host sends a new epoch, which continues the
//! plan from the tick at which that tail would begin and ends in a tail of its own, and has the board switch to it
//! at that tick. If the switch comes too late it is refused whole, and the tail is what happens: a planned stop.
//!
//! Where epochs meet nothing is lost: every step keeps the tick that the plan gave it.
//!
//! # What is here, top down
//! - [`Session`]: fills the queues, lets time pass, stops, changes to another program; `halt`: pauses and resumes
//! - `chunk`: epochs: as much of the plan as fits, with a tail; `pace`: how far ahead
//! - `source`: a program's plan, read ahead, and its tails
//! - `items`: steps → items of an epoch
//! - `timeline`: what the board was told, replayed in integers

mod chunk;
mod error;
mod halt;
mod items;
mod pace;
mod source;
mod timeline;

pub use error::SessionError;

use chunk::{Chunk, RESERVES, Taken};
use halt::Course;
use pace::Pace;
use pulsetrain_board::{Board, Faults, Observer};
use pulsetrain_core::Epoch;
use pulsetrain_motion::program::Program;
use pulsetrain_plan::{Certificate, Origin, Start};
use source::{Source, Standing};
use std::collections::VecDeque;
use timeline::Timeline;

/// A program on its way into a board. Ticks are the board's, in 64 bits.
pub struct Session<'a, B> {
    board: B,
    source: Source<'a>,
    timelines: Vec<Timeline>,
    pace: Pace,
    /// Room in each motor's empty queue, in the board's own unit.
    capacity: Vec<usize>,
    /// The newest epoch that the board has accepted.
    epoch: Epoch,
    /// When the items leave the board's queue that it was told.
    taken: Vec<Vec<Taken>>,
    /// When its tail begins: what comes after has not been sent yet.
    tail: u64,
    /// How long the newest epoch is without its tail; 0 before the first.
    length: u64,
    /// How long before its beginning the next epoch is to be in the queue.
    margin: u64,
    /// One in so many places of the queues is kept free of it.
    reserve: usize,
    /// Beginnings of the epochs that may not have begun yet.
    waiting: VecDeque<u64>,
    /// The next epoch, as far as it is not in the queue yet.
    pending: Option<Chunk>,
    /// Nothing more is to be sent.
    complete: bool,
    /// What each motor will have counted if a switch, whose answer did not come, was accepted.
    unanswered: Option<Vec<i64>>,
    /// The program that was begun, or changed to, and how far its time is.
    course: Course<'a>,
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
    /// The same if the board did accept the last switch: the line was lost before its answer came.
    pub replayed_otherwise: Option<Vec<i64>>,
    /// What went wrong on each motor.
    pub faults: Vec<Faults>,
    /// Why the motion stopped before its end, in a planned stop.
    pub failure: Option<SessionError>,
}

impl<'a, B: Board> Session<'a, B> {
    /// Plans the beginning of `program` and sends it; the laws begin 1 ms or a little more from now.
    ///
    /// # Errors
    /// When the plan is refused, the board is not idle, or its queue is too short. Nothing moves then.
    pub fn new(board: B, program: &'a Program) -> Result<Session<'a, B>, SessionError> {
        if !board.is_idle() {
            return Err(SessionError::Busy);
        }
        let pace = Pace::of(program, board.lead(), board.shortest_lead());
        let zero = board.now() + pace.tick_hz.div_ceil(1000) + 4 * pace.lead + pace.link;
        let counts = board.positions();
        let motors = program.motors.len();
        if counts.len() < motors {
            return Err(SessionError::Motors { program: motors, board: counts.len() });
        }
        let timelines = counts.iter().take(motors);
        let timelines = timelines.map(|count| Timeline::new(pace.fraction_bits, *count, board.now())).collect();
        let mut session = Session {
            source: Source::new(program, zero, &counts)?,
            timelines,
            pace,
            capacity: (0..motors).map(|motor| board.room(motor)).collect(),
            epoch: board.epoch(),
            taken: vec![Vec::new(); motors],
            tail: zero,
            length: 0,
            margin: pace.margin,
            reserve: RESERVES[0],
            waiting: VecDeque::new(),
            pending: None,
            complete: false,
            unanswered: None,
            course: Course::begun(program),
            board,
        };
        session.fill()?;
        Ok(session)
    }

    /// Sends what the queues have room for, far enough ahead.
    ///
    /// # Errors
    /// When the plan or the switch to its next part is refused: then nothing more is sent, and the motors stop
    /// with the tail that the board has.
    pub fn fill(&mut self) -> Result<(), SessionError> {
        let filled = self.try_fill();
        if filled.is_err() {
            self.abandon();
            self.complete = true;
        }
        filled
    }

    fn try_fill(&mut self) -> Result<(), SessionError> {
        loop {
            let mut chunk = match self.pending.take() {
                Some(chunk) => chunk,
                None if self.may_wait() => return Ok(()),
                None => self.next_chunk()?,
            };
            if !self.push(&mut chunk, true) {
                self.pending = Some(chunk);
                return Ok(());
            }
            self.switch(chunk)?;
        }
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

    /// Runs to the end of the plan, or to a planned stop; `progress` hears the tick from time to time.
    ///
    /// Does not return for endless laws: those need [`Session::advance`] and [`Session::stop`].
    pub fn run(&mut self, observer: &mut impl Observer, mut progress: impl FnMut(u64)) -> Report {
        let mut failure = None;
        while !self.complete {
            let until = self.board.now() + self.pace.chunk;
            failure = self.advance(until, observer).err();
            progress(self.board.now());
        }
        let last = self.last_step().unwrap_or(0);
        while self.board.now() <= last || !self.board.is_idle() {
            let until = self.board.now() + self.pace.chunk;
            self.board.advance(if self.board.now() <= last { until.min(last) } else { until }, observer);
            progress(self.board.now());
        }
        // Edges of the time in which the board was lost.
        self.board.advance(self.board.now().saturating_sub(1), observer);
        self.report(failure)
    }

    /// Brings all motors to rest within their limits, as soon as the board can be told; gives the tick at which
    /// they begin to slow down.
    ///
    /// # Errors
    /// When the stop cannot be planned: the motors then stop with the tail that the board has.
    pub fn stop(&mut self) -> Result<u64, SessionError> {
        self.abandon();
        self.complete = true;
        self.course.stopped();
        let from = self.earliest();
        if from < self.tail {
            let sent = self.chunk(from, from, false).and_then(|chunk| self.send(chunk));
            self.complete = true;
            match sent {
                // Then the tail that is there will do.
                Ok(()) | Err(SessionError::QueueTooShort { .. }) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(self.tail)
    }

    /// Goes over to another program at tick `at`, which is the time 0 of its laws.
    ///
    /// Its laws speak of the same θ as those of the first program: they must begin within two steps of where the motors
    /// are, and within the pull-in rate of their speed; see [`Session::state`]. Motors, wiring and
    /// board must be the same. After a stop, `at` may be any tick once the motors rest.
    ///
    /// # Errors
    /// When `at` is too early or too late, or behind too many switches that wait, or the new plan is refused; the old one goes on.
    pub fn change(&mut self, at: u64, program: &'a Program) -> Result<(), SessionError> {
        self.go_over(at, program, 0)?;
        self.course = Course::begun(program);
        Ok(())
    }

    /// As [`Session::change`]; the plan of the first `proven` ticks is known to be refused by nobody.
    fn go_over(&mut self, at: u64, program: &'a Program, proven: u64) -> Result<(), SessionError> {
        let (motors, old) = (program.motors.len(), self.timelines.len());
        if motors != old || Pace::of(program, self.pace.link, self.pace.hurry).is_unlike(&self.pace) {
            return Err(SessionError::Motors { program: motors, board: old });
        }
        let earliest = self.earliest();
        if at < earliest {
            return Err(SessionError::Early { at, earliest });
        }
        let now = self.board.now();
        let mut before = self.waiting.iter().filter(|begins| (now..at).contains(begins));
        if let Some(&until) = before.next().filter(|_| before.count() + 1 >= self.board.switches()) {
            return Err(SessionError::Waiting { at, until });
        }
        let mut starts = Vec::with_capacity(motors);
        let mut datums = Vec::with_capacity(motors);
        for motor in 0..motors {
            let MotorState { count, speed, .. } = self.state(motor, at)?;
            let datum = self.source.datum(motor);
            let origin = Origin { position: count, theta: datum.0 as f64 + datum.1, speed };
            starts.push(Start { origin, last_step: self.standing(motor, at).last_before(at) });
            datums.push(datum);
        }
        halt::prove(program, &starts, proven)?;
        let source = Source::from(program, at, &starts, datums)?;
        self.abandon();
        let old = std::mem::replace(&mut self.source, source);
        let rooms: Vec<usize> = (0..motors).map(|motor| self.board.room(motor)).collect();
        let sent = self.chunk_within(at, &rooms, self.pace.shortest).and_then(|chunk| self.send(chunk));
        if sent.is_err() {
            self.source = old;
        }
        sent?;
        self.fill()
    }

    /// The state of a motor at a tick that is not past: by its law, or at rest.
    ///
    /// # Errors
    /// While the motor is slowing down for a stop, or where its law breaks.
    pub fn state(&mut self, motor: usize, tick: u64) -> Result<MotorState, SessionError> {
        let count = self.standing(motor, tick).count;
        let (whole, rest) = self.source.datum(motor);
        if tick <= self.tail {
            let place = self.source.place(motor, tick.max(self.source.zero()), count)?;
            let theta = (whole + count) as f64 + (rest + place.off);
            let speed = if tick < self.source.zero() { 0.0 } else { place.speed };
            return Ok(MotorState { count, theta, speed });
        }
        let rests = self.last_step().map_or(0, |last| last + 1);
        if tick < rests || !self.complete {
            return Err(SessionError::Late { at: tick, latest: self.tail });
        }
        Ok(MotorState { count, theta: (whole + count) as f64 + rest, speed: 0.0 })
    }

    /// The count of a motor after all steps up to and with `tick`, as the board was told; `None` for ticks that are
    /// more than 0.25 s past.
    #[must_use]
    pub fn count_at(&self, motor: usize, tick: u64) -> Option<i64> {
        self.timelines.get(motor)?.count_before(tick.saturating_add(1))
    }

    /// The first tick at which a change or a stop can be made now.
    #[must_use]
    pub fn earliest(&self) -> u64 {
        self.board.horizon().max(self.board.now()) + self.pace.lead + self.pace.link
    }

    /// The tick at which time is 0 for the laws that are being followed.
    #[must_use]
    pub fn zero(&self) -> u64 {
        self.source.zero()
    }

    /// When the motors begin to stop if nothing more is sent.
    #[must_use]
    pub fn tail(&self) -> u64 {
        self.tail
    }

    /// Whether nothing more is to be sent.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.complete
    }

    /// The tick of the last step that the board was told.
    #[must_use]
    pub fn last_step(&self) -> Option<u64> {
        self.timelines.iter().filter_map(Timeline::last_tick).max()
    }

    /// What is proven of a motor's plan, as far as it was read.
    #[must_use]
    pub fn certificate(&self, motor: usize) -> Certificate {
        self.source.certificate(motor)
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

    /// Leaves the board to itself: the motors stop with the tail that it has.
    #[must_use]
    pub fn into_board(self) -> B {
        self.board
    }

    fn report(&self, failure: Option<SessionError>) -> Report {
        let motors = 0..self.timelines.len();
        Report {
            zero: self.source.zero(),
            last_step: self.last_step().unwrap_or(self.source.zero()),
            counted: self.board.positions(),
            replayed: motors.clone().filter_map(|motor| self.timelines[motor].count_before(u64::MAX)).collect(),
            replayed_otherwise: self.unanswered.clone(),
            faults: motors.map(|motor| self.board.faults(motor)).collect(),
            failure,
        }
    }

    /// Whether there is enough in the queues, or no way to put more there.
    fn may_wait(&mut self) -> bool {
        let now = self.board.now();
        self.waiting.retain(|begins| *begins > now);
        self.complete || self.tail > now + self.pace.ahead || self.waiting.len() >= self.board.switches()
    }

    /// The tick up to which there is nothing to do.
    fn next_event(&self) -> u64 {
        let now = self.board.now();
        match &self.pending {
            // All of it fits then; if time went on without the session, a little later. Over a link it goes out
            // bit by bit, as room is made.
            Some(chunk) => {
                let deadline = self.deadline(chunk.from);
                let soon = if self.pace.link > 0 { deadline.min(now + self.pace.look()) } else { deadline };
                soon.max(now + self.pace.lead)
            }
            None if self.complete => u64::MAX,
            None if self.tail > now + self.pace.ahead => self.tail - self.pace.ahead,
            None => self.waiting.front().copied().unwrap_or(now),
        }
    }

    /// When an epoch that begins at `from` is to be in the queue.
    fn deadline(&self, from: u64) -> u64 {
        from.saturating_sub(self.margin).max(self.board.now())
    }

    fn standing(&self, motor: usize, tick: u64) -> Standing {
        let timeline = &self.timelines[motor];
        Standing { count: timeline.count_before(tick).unwrap_or(0), last_step: timeline.last_before(tick), told: None }
    }

    /// Takes back what was pushed of an epoch that is not to come.
    fn abandon(&mut self) {
        if self.pending.take().is_some() {
            self.board.discard(self.epoch.next());
        }
    }
}
