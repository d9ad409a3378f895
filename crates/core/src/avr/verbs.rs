//! Verbs of motors on an 8-bit processor: the steps are those of [`crate::verbs`], with ticks of 32 bits.
//!
//! Steps come one evenly spaced row at a time ([`AvrVerbs::take`]), since the chip has no room for a queue of items. What differs from there:
//! periods go up to [`LONGEST_PERIOD`], and fewer moves may wait to be reported ([`MAX_UNREPORTED`]). `tests/it/avr_verbs.rs` compares the two.
//!
//! Ticks of 32 bits can be compared within 2^31 ticks of each other. So [`AvrVerbs::take`] must be called for every motor at least once
//! in 2^29 ticks.

use crate::verbs::motor::Job;
use crate::verbs::{Heading, Verb};
use crate::wire::Refusal;
use crate::wire::message::Reason;
use crate::wire::orders::{NextStep, Orders};
use crate::{Direction, Tick32};

/// The longest period, ticks: 67 s at 16 MHz.
pub const LONGEST_PERIOD: u32 = 1 << 30;

/// The most moves of a motor that are under way, waiting, or finished and not [reported](AvrVerbs::take_done). It is fewer than on larger
/// boards, because RAM is short.
pub const MAX_UNREPORTED: usize = 2;

/// Motors at most.
pub const MOTORS: usize = 4;

/// Evenly spaced steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepRow {
    /// The tick of the first step.
    pub first: Tick32,
    /// How many, at least 1.
    pub count: u16,
    /// Ticks from one to the next, [`LONGEST_PERIOD`] at most.
    pub period: u32,
    /// The direction of all of them.
    pub direction: Direction,
}

/// A finished move: when it was finished, and how many of the motor's moves are finished with it, wrapping.
#[derive(Clone, Copy, Debug)]
struct AvrDone {
    at: Tick32,
    number: u32,
}

/// The part of a motor's state that an order changes.
#[derive(Clone, Copy, Debug)]
struct Setpoint {
    period: u32,
    heading: Heading,
    job: Job,
    waiting: Job,
    /// No step and no end of a move comes before this tick.
    open: Tick32,
}

/// One motor, with the same state as a [`crate::verbs::Motor`].
#[derive(Clone, Copy, Debug)]
struct AvrMotor {
    setpoint: Setpoint,
    /// A copy from before the current order, in case it is refused. It is here because a small board's stack has no room for it.
    before: Setpoint,
    /// The tick of the last step. Its direction is forgotten when the step is so long ago that it delays nothing any more.
    last: Tick32,
    last_direction: Option<Direction>,
    position: i32,
    done: u32,
    unreported: u8,
    /// How many of these, the oldest ones, are known to be past. Their ticks alone, of 32 bits, tell it only for 2^31 ticks.
    past: u8,
    /// The newest first.
    dones: [AvrDone; MAX_UNREPORTED],
    /// The next steps to be taken, if they were worked out early, because an order came.
    next: Option<StepRow>,
}

impl AvrMotor {
    fn obey(&mut self, verb: Verb, at: Tick32, shortest: u16) -> Result<(), Reason> {
        match verb {
            Verb::Move { steps } => self.begin(Job::Steps(steps))?,
            Verb::Run => self.begin(Job::Endless)?,
            Verb::Speed { ticks } => {
                self.setpoint.period = u32::try_from(ticks)
                    .ok()
                    .filter(|ticks| (u32::from(shortest)..=LONGEST_PERIOD).contains(ticks))
                    .ok_or(Reason::Period)?;
            }
            Verb::Heading(heading) => self.setpoint.heading = heading,
            Verb::Halt => self.halt(),
        }
        self.setpoint.open = at;
        Ok(())
    }

    fn halt(&mut self) {
        (self.setpoint.job, self.setpoint.waiting) = (Job::Rest, Job::Rest);
    }

    fn begin(&mut self, job: Job) -> Result<(), Reason> {
        let is_move = |job| matches!(job, Job::Steps(_));
        let moves = self.unreported + u8::from(is_move(self.setpoint.job));
        if is_move(job) && usize::from(moves) >= MAX_UNREPORTED {
            return Err(Reason::Busy);
        }
        match (self.setpoint.job, self.setpoint.waiting) {
            (Job::Rest | Job::Endless, _) => self.setpoint.job = job,
            (Job::Steps(_), Job::Rest) => self.setpoint.waiting = job,
            (Job::Steps(_), _) => return Err(Reason::Busy),
        }
        Ok(())
    }

    fn drop_endless(&mut self) {
        let stands = self.setpoint.heading == Heading::Stationary;
        let ends = |job| match job {
            Job::Rest => true,
            Job::Steps(left) => left == 0 || !stands,
            Job::Endless => false,
        };
        if !ends(self.setpoint.job) {
            self.halt();
        } else if !ends(self.setpoint.waiting) {
            self.setpoint.waiting = Job::Rest;
        }
    }

    /// The tick at which the last step's period is over.
    #[inline(never)]
    fn rested(&self) -> Tick32 {
        let Setpoint { open, period, .. } = self.setpoint;
        if self.last_direction.is_some() { later(open, self.last.after(period)) } else { open }
    }

    /// The tick at which the next step is due; `None` if the heading is stationary.
    fn due(&self, turn: u16) -> Option<Tick32> {
        let rested = self.rested();
        let direction = self.setpoint.heading.direction()?;
        let turns = self.last_direction.is_some_and(|last_direction| last_direction != direction);
        Some(if turns { later(rested, self.last.after(u32::from(turn))) } else { rested })
    }

    /// The tick of the next step, if it is before `until`. Notes moves that are finished by then, and begins those that waited.
    #[inline(never)]
    fn due_before(&mut self, until: Tick32, turn: u16) -> Option<Tick32> {
        loop {
            match self.setpoint.job {
                Job::Rest if self.setpoint.waiting == Job::Rest => return None,
                Job::Rest => (self.setpoint.job, self.setpoint.waiting) = (self.setpoint.waiting, Job::Rest),
                Job::Steps(0) => {
                    let at = self.rested();
                    if !at.is_before(until) {
                        return None;
                    }
                    self.end(at);
                }
                Job::Steps(_) | Job::Endless => return self.due(turn).filter(|due| due.is_before(until)),
            }
        }
    }

    /// Notes that a move is done.
    // A call of its own, since its caller has little stack.
    #[inline(never)]
    fn end(&mut self, at: Tick32) {
        self.setpoint.job = Job::Rest;
        self.done = self.done.wrapping_add(1);
        self.unreported += 1;
        self.dones = [AvrDone { at, number: self.done }, self.dones[0]];
    }

    #[inline(never)]
    fn take(&mut self, until: Tick32, turn: u16) -> Option<StepRow> {
        let next = self.next.take();
        if next.is_some() {
            return next;
        }
        let Some(first) = self.due_before(until, turn) else {
            self.forget(until);
            return None;
        };
        let direction = self.setpoint.heading.direction()?;
        let period = self.setpoint.period;
        let most = match self.setpoint.job {
            // After a longer period the next step may be beyond 16 bits.
            _ if period > u32::from(u16::MAX) => 1,
            Job::Steps(left) => saturated(left),
            _ => u16::MAX,
        };
        // It counts step by step, in 16 bits. There are few steps, and a division would take longer.
        let (apart, span) = (saturated(period), saturated(until.since(first) - 1));
        let (mut rest, mut count) = (span, 1);
        while rest >= apart && count < most {
            rest -= apart;
            count += 1;
        }
        if let Job::Steps(left) = &mut self.setpoint.job {
            *left -= u32::from(count);
        }
        let last = first.after(u32::from(span - rest));
        (self.last, self.last_direction, self.setpoint.open) = (last, Some(direction), last);
        let moved = i32::from(count);
        let moved = if direction == Direction::Forward { moved } else { -moved };
        self.position = self.position.wrapping_add(moved);
        Some(StepRow { first, count, period, direction })
    }

    /// Forgets a last step that is long past, since its tick of 32 bits would soon look like one in the future. Its period is over in any
    /// case, so that the motor may begin at `until`.
    fn forget(&mut self, until: Tick32) {
        if until.since(self.last) >= LONGEST_PERIOD {
            self.last_direction = None;
        }
        if self.last_direction.is_none() {
            self.setpoint.open = until;
        }
    }

    /// How many moves were finished by `now` and are not reported.
    #[inline(never)]
    fn past(&mut self, now: Tick32) -> u8 {
        let oldest =
            |motor: &AvrMotor| motor.dones.get(usize::from(motor.unreported.checked_sub(motor.past + 1)?)).copied();
        while oldest(self).is_some_and(|done| !now.is_before(done.at)) {
            self.past += 1;
        }
        self.past
    }

    fn rests_at(&mut self, now: Tick32) -> bool {
        self.past(now) == self.unreported && self.setpoint.job == Job::Rest && self.setpoint.waiting == Job::Rest
    }

    fn next_step(&self, turn: u16) -> Option<Tick32> {
        match (self.setpoint.job, self.setpoint.waiting) {
            (Job::Rest, _) | (Job::Steps(0), Job::Rest | Job::Steps(0)) => None,
            _ => self.due(turn),
        }
    }
}

/// `number`, or the largest number of 16 bits.
fn saturated(number: u32) -> u16 {
    u16::try_from(number).unwrap_or(u16::MAX)
}

#[inline(never)]
fn later(one: Tick32, other: Tick32) -> Tick32 {
    if one.is_before(other) { other } else { one }
}

/// All motors of a board that obeys verbs. All have the same timing.
///
/// All zeros are a valid value, without motors: each field is an integer, or an enum that has a 0.
#[derive(Clone, Debug)]
pub struct AvrVerbs {
    motors: [AvrMotor; MOTORS],
    count: u8,
    /// As in [`MotorTiming`](crate::verbs::MotorTiming).
    shortest: u16,
    turn: u16,
    /// Steps before this tick are decided: orders do not change them.
    known: Tick32,
    /// The answer to the last order: the tick from which on it acts, and what motors do there.
    obeyed: (Tick32, [NextStep; MOTORS]),
}

impl AvrVerbs {
    /// No motors.
    #[must_use]
    pub fn new() -> AvrVerbs {
        let open = Tick32(0);
        let setpoint = Setpoint { period: 0, heading: Heading::Forward, job: Job::Rest, waiting: Job::Rest, open };
        let none = AvrMotor {
            setpoint,
            before: setpoint,
            last: open,
            last_direction: None,
            position: 0,
            done: 0,
            unreported: 0,
            past: 0,
            dones: [AvrDone { at: open, number: 0 }; MAX_UNREPORTED],
            next: None,
        };
        AvrVerbs {
            motors: [none; MOTORS],
            count: 0,
            shortest: 0,
            turn: 0,
            known: open,
            obeyed: (open, [NextStep { position: 0, wait: 0 }; MOTORS]),
        }
    }

    /// Begins with motors at rest at these positions, at most [`MOTORS`]; no step comes before `known`. Moves that were finished earlier, but
    /// are not reported yet, are still [reported](AvrVerbs::take_done). The three limits are those of
    /// [`MotorTiming`](crate::verbs::MotorTiming).
    pub fn begin(
        &mut self,
        positions: impl Iterator<Item = i32>,
        (shortest, turn, period): (u16, u16, u32),
        known: Tick32,
    ) {
        (self.count, self.shortest, self.turn, self.known) = (0, shortest, turn, known);
        let open = known;
        for (motor, position) in self.motors.iter_mut().zip(positions) {
            motor.setpoint = Setpoint { period, heading: Heading::Forward, job: Job::Rest, waiting: Job::Rest, open };
            (motor.last_direction, motor.position, motor.done, motor.next) = (None, position, 0, None);
            self.count += 1;
        }
    }

    /// The tick from which on an order acts. Steps before it are decided.
    #[must_use]
    pub const fn known(&self) -> Tick32 {
        self.known
    }

    /// Decides all steps before `until`: later orders do not change them.
    pub const fn foresee(&mut self, until: Tick32) {
        self.known = until;
    }

    fn motors(&mut self) -> &mut [AvrMotor] {
        self.motors.get_mut(..usize::from(self.count)).unwrap_or_default()
    }

    /// The next evenly spaced steps of a motor before [`known`](AvrVerbs::known) (less than 2^29 ticks after the last call's); `None` if there
    /// are no more.
    pub fn take(&mut self, motor: u8) -> Option<StepRow> {
        let (until, turn) = (self.known, self.turn);
        self.motors.get_mut(usize::from(motor))?.take(until, turn)
    }

    /// Whether a motor certainly has no more steps before [`known`](AvrVerbs::known) than those that were [taken](AvrVerbs::take), unless an
    /// order comes: the next step, or the end of a move, comes a period after the last step. This takes a tenth of the time of `take`.
    #[inline(always)]
    #[must_use]
    pub fn has_all(&self, motor: u8) -> bool {
        let is_over = |motor: &AvrMotor| !motor.last.after(motor.setpoint.period).is_before(self.known);
        self.motors.get(usize::from(motor)).is_some_and(is_over)
    }

    /// The first motor for which no order can be executed yet, because steps before [`known`](AvrVerbs::known) are not taken. One row of such
    /// steps for each motor is stored here and does not count.
    pub fn busy(&mut self) -> Option<u8> {
        let (until, turn) = (self.known, self.turn);
        (0..).zip(self.motors()).find_map(|(number, motor)| {
            if motor.next.is_none() {
                motor.next = motor.take(until, turn);
            }
            motor.due_before(until, turn).map(|_| number)
        })
    }

    /// Obeys all orders, from [`known`](AvrVerbs::known) on, or none. No motor may be [busy](AvrVerbs::busy).
    ///
    /// # Errors
    /// As [`crate::verbs::Verbs::obey`].
    pub fn obey(&mut self, orders: &Orders<'_>) -> Result<(), Refusal> {
        let (at, shortest, turn) = (self.known, self.shortest, self.turn);
        for motor in &mut self.motors {
            motor.before = motor.setpoint;
        }
        for (number, verb) in orders.iter() {
            let refused = match self.motors().get_mut(usize::from(number)) {
                Some(motor) => motor.obey(verb, at, shortest).err(),
                None => Some(Reason::NoSuchMotor),
            };
            if let Some(reason) = refused {
                for motor in &mut self.motors {
                    motor.setpoint = motor.before;
                }
                let detail = if reason == Reason::Period { shortest } else { u16::from(number) };
                return Err(Refusal { reason, detail });
            }
        }
        self.obeyed.0 = self.known;
        for (place, motor) in self.obeyed.1.iter_mut().zip(&self.motors) {
            let wait = motor.next_step(turn).map_or(u32::MAX, |next| next.since(at));
            *place = NextStep { position: motor.position, wait };
        }
        Ok(())
    }

    /// The answer to the last order, the parts of an [`Obeyed`](crate::wire::orders::Obeyed): the tick from which on it acts, and what motors do
    /// there.
    #[must_use]
    pub fn obeyed(&self) -> (Tick32, &[NextStep]) {
        let (at, motors) = &self.obeyed;
        (*at, motors.get(..usize::from(self.count)).unwrap_or_default())
    }

    /// A move that was finished by `now` and is not reported yet: its motor, its tick, and how many of the motor's moves are finished with it,
    /// wrapping. The move may be long past if this or [`rest_at`](AvrVerbs::rest_at) is called at least once in 2^31 ticks.
    pub fn take_done(&mut self, now: Tick32) -> Option<(u8, Tick32, u32)> {
        let (known, turn) = (self.known, self.turn);
        (0..).zip(&mut self.motors).find_map(|(number, motor)| {
            // Its last move may be over since the last call.
            motor.due_before(known, turn);
            motor.past = motor.past(now).checked_sub(1)?;
            motor.unreported -= 1;
            let AvrDone { at, number: of_motor } = *motor.dones.get(usize::from(motor.unreported))?;
            Some((number, at, of_motor))
        })
    }

    /// See [`crate::verbs::Verbs::rest_at`].
    pub fn rest_at(&mut self, now: Tick32) -> bool {
        // All motors are asked, even after the first answer is known, because each call also notes steps that are past.
        self.motors().iter_mut().fold(true, |rest, motor| rest & motor.rests_at(now))
    }

    /// The host is lost and no order will come: see [`crate::verbs::Motor::drop_endless`].
    pub fn drop_endless(&mut self) {
        for motor in self.motors() {
            motor.drop_endless();
        }
    }

    /// Notes that all motors were stopped at once, after tick `at`: see [`crate::verbs::Motor::stop`]. With `None`, not even all steps that
    /// were due before were made.
    pub fn stop(&mut self, at: Option<Tick32>) {
        let (known, turn) = (self.known, self.turn);
        for motor in self.motors() {
            motor.due_before(known, turn);
            motor.halt();
            motor.next = None;
            let kept = at.map_or(0, |_| motor.past);
            while motor.unreported > kept && at.is_none_or(|at| at.is_before(motor.dones[0].at)) {
                motor.dones[0] = motor.dones[1];
                motor.unreported -= 1;
                motor.done = motor.done.wrapping_sub(1);
            }
            motor.past = motor.unreported;
        }
    }
}

impl Default for AvrVerbs {
    fn default() -> AvrVerbs {
        AvrVerbs::new()
    }
}
