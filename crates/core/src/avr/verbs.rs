//! Verbs of motors on an 8-bit processor: the steps are those of [`crate::verbs`], with ticks of 32 bits.
//!
//! Steps come one evenly spaced row at a time ([`AvrVerbs::take`]), since the chip has no room for a queue of items. What differs from there:
//! periods go up to [`LONGEST_PERIOD`], and fewer moves may wait to be reported ([`MOST_UNTOLD`]). `tests/it/avr_verbs.rs` compares the two.
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

/// Moves that may be under way, waiting, or done and not [reported](AvrVerbs::take_done): RAM is short.
pub const MOST_UNTOLD: usize = 2;

/// Motors at most.
pub const MOTORS: usize = 4;

/// Evenly spaced steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepRow {
    /// Of the first.
    pub first: Tick32,
    /// How many, at least 1.
    pub count: u16,
    /// Ticks from one to the next, [`LONGEST_PERIOD`] at most.
    pub period: u32,
    /// Which way all of them go.
    pub direction: Direction,
}

/// A move that is done: when, and how many then are, wrapping.
#[derive(Clone, Copy, Debug)]
struct AvrDone {
    at: Tick32,
    number: u32,
}

/// What an order changes.
#[derive(Clone, Copy, Debug)]
struct Setpoint {
    period: u32,
    heading: Heading,
    job: Job,
    waiting: Job,
    /// Nothing happens before it.
    open: Tick32,
}

/// One motor: its state is that of [`crate::verbs::Motor`].
#[derive(Clone, Copy, Debug)]
struct AvrMotor {
    setpoint: Setpoint,
    /// Its copy from before the order that is being done. On the stack of a small board there is no room for it.
    before: Setpoint,
    /// The last step, and which way it went; that as long as anything may follow from it.
    last: Tick32,
    facing: Option<Direction>,
    position: i32,
    done: u32,
    untold: u8,
    /// So many of those, the oldest, are known to be past: from ticks of 32 bits alone that is known for 2^31 ticks.
    past: u8,
    /// The newest first.
    dones: [AvrDone; MOST_UNTOLD],
    /// A row of steps that was worked out early, because an order came, and that is the next to be taken.
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
        let moves = self.untold + u8::from(is_move(self.setpoint.job));
        if is_move(job) && usize::from(moves) >= MOST_UNTOLD {
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

    /// When the last step's period is over.
    #[inline(never)]
    fn rested(&self) -> Tick32 {
        let Setpoint { open, period, .. } = self.setpoint;
        if self.facing.is_some() { later(open, self.last.after(period)) } else { open }
    }

    /// When the next step is due, unless the motor stands.
    fn due(&self, turn: u16) -> Option<Tick32> {
        let rested = self.rested();
        let direction = self.setpoint.heading.direction()?;
        let turns = self.facing.is_some_and(|facing| facing != direction);
        Some(if turns { later(rested, self.last.after(u32::from(turn))) } else { rested })
    }

    /// When the next step comes, if that is before `until`. Moves that are done by then are noted, and what waits behind them begins.
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
        self.untold += 1;
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
            // What comes behind it may not be seen in 16 bits.
            _ if period > u32::from(u16::MAX) => 1,
            Job::Steps(left) => saturated(left),
            _ => u16::MAX,
        };
        // A step after the other, in 16 bits: there are few, and a division takes longer.
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
        (self.last, self.facing, self.setpoint.open) = (last, Some(direction), last);
        let moved = i32::from(count);
        let moved = if direction == Direction::Forward { moved } else { -moved };
        self.position = self.position.wrapping_add(moved);
        Some(StepRow { first, count, period, direction })
    }

    /// What is long past must not come back as the future: whatever the period, it is over, and the motor might as well begin at `until`.
    fn forget(&mut self, until: Tick32) {
        if until.since(self.last) >= LONGEST_PERIOD {
            self.facing = None;
        }
        if self.facing.is_none() {
            self.setpoint.open = until;
        }
    }

    /// How many moves were done by `now` and are not setpoint.
    #[inline(never)]
    fn past(&mut self, now: Tick32) -> u8 {
        let oldest =
            |motor: &AvrMotor| motor.dones.get(usize::from(motor.untold.checked_sub(motor.past + 1)?)).copied();
        while oldest(self).is_some_and(|done| !now.is_before(done.at)) {
            self.past += 1;
        }
        self.past
    }

    fn rests_at(&mut self, now: Tick32) -> bool {
        self.past(now) == self.untold && self.setpoint.job == Job::Rest && self.setpoint.waiting == Job::Rest
    }

    fn next_step(&self, turn: u16) -> Option<Tick32> {
        match (self.setpoint.job, self.setpoint.waiting) {
            (Job::Rest, _) | (Job::Steps(0), Job::Rest | Job::Steps(0)) => None,
            _ => self.due(turn),
        }
    }
}

/// In 16 bits, as near as can be.
fn saturated(number: u32) -> u16 {
    u16::try_from(number).unwrap_or(u16::MAX)
}

#[inline(never)]
fn later(one: Tick32, other: Tick32) -> Tick32 {
    if one.is_before(other) { other } else { one }
}

/// All motors of a board that obeys verbs. All have the same timing.
///
/// Zeros are such motors, too, none: each field is of integers, or of an enum that has a 0.
#[derive(Clone, Debug)]
pub struct AvrVerbs {
    motors: [AvrMotor; MOTORS],
    count: u8,
    /// As in [`MotorTiming`](crate::verbs::MotorTiming).
    shortest: u16,
    turn: u16,
    /// What happens before it is settled.
    known: Tick32,
    /// What came of the last order: from when on it holds, and what motors do there.
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
            facing: None,
            position: 0,
            done: 0,
            untold: 0,
            past: 0,
            dones: [AvrDone { at: open, number: 0 }; MOST_UNTOLD],
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

    /// Begins with motors at rest at these positions, [`MOTORS`] at most; nothing happens before `known`. Moves of the motors before that
    /// were done and not reported yet are still [reported](AvrVerbs::take_done). Limits are as in [`MotorTiming`](crate::verbs::MotorTiming).
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
            (motor.facing, motor.position, motor.done, motor.next) = (None, position, 0, None);
            self.count += 1;
        }
    }

    /// What happens before this is settled: an order holds from there on.
    #[must_use]
    pub const fn known(&self) -> Tick32 {
        self.known
    }

    /// From now on, what happens before `until` is settled.
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

    /// Whether it is clear, behind steps that were [taken](AvrVerbs::take), that there are no more before [`known`](AvrVerbs::known) until
    /// something is ordered: a step more, or a move's end, would come a period after the last one. It costs a tenth of a `take`.
    #[inline(always)]
    #[must_use]
    pub fn has_all(&self, motor: u8) -> bool {
        let is_over = |motor: &AvrMotor| !motor.last.after(motor.setpoint.period).is_before(self.known);
        self.motors.get(usize::from(motor)).is_some_and(is_over)
    }

    /// The first motor that keeps an order from holding from [`known`](AvrVerbs::known) on: it has more to take before it than its next
    /// steps, which are put by.
    pub fn busy(&mut self) -> Option<u8> {
        let (until, turn) = (self.known, self.turn);
        (0..).zip(self.motors()).find_map(|(number, motor)| {
            if motor.next.is_none() {
                motor.next = motor.take(until, turn);
            }
            motor.due_before(until, turn).map(|_| number)
        })
    }

    /// Does all of what is ordered, from [`known`](AvrVerbs::known) on, or none of it. No motor is [busy](AvrVerbs::busy).
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

    /// What came of the last order, as an [`Obeyed`](crate::wire::orders::Obeyed) has it: from when on it holds, and what motors do there.
    #[must_use]
    pub fn obeyed(&self) -> (Tick32, &[NextStep]) {
        let (at, motors) = &self.obeyed;
        (*at, motors.get(..usize::from(self.count)).unwrap_or_default())
    }

    /// A move that was done by `now` and was not reported yet: the motor, when, and how many of its moves are done with it, wrapping.
    /// However long that may be past, if this or [`rest_at`](AvrVerbs::rest_at) was asked within 2^31 ticks, or motors were stopped.
    pub fn take_done(&mut self, now: Tick32) -> Option<(u8, Tick32, u32)> {
        let (known, turn) = (self.known, self.turn);
        (0..).zip(&mut self.motors).find_map(|(number, motor)| {
            // Its last move may be over since the last call.
            motor.due_before(known, turn);
            motor.past = motor.past(now).checked_sub(1)?;
            motor.untold -= 1;
            let AvrDone { at, number: of_motor } = *motor.dones.get(usize::from(motor.untold))?;
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

    /// All motors were stopped at once, after tick `at`: see [`crate::verbs::Motor::stop`]. `None`: not even what was due before was all
    /// made.
    pub fn stop(&mut self, at: Option<Tick32>) {
        let (known, turn) = (self.known, self.turn);
        for motor in self.motors() {
            motor.due_before(known, turn);
            motor.halt();
            motor.next = None;
            let kept = at.map_or(0, |_| motor.past);
            while motor.untold > kept && at.is_none_or(|at| at.is_before(motor.dones[0].at)) {
                motor.dones[0] = motor.dones[1];
                motor.untold -= 1;
                motor.done = motor.done.wrapping_sub(1);
            }
            motor.past = motor.untold;
        }
    }
}

impl Default for AvrVerbs {
    fn default() -> AvrVerbs {
        AvrVerbs::new()
    }
}
