//! Motors that take orders directly, without a plan: a number of steps, with a period, in a direction.
//!
//! # What is here, top down
//! - [`Verbs`]: all motors, and the tick up to which their steps are worked out
//! - [`motor`]: one motor: from [`Verb`]s to evenly spaced steps, as items for its channel
//!
//! Steps are worked out a little ahead, slice after slice ([`Verbs::work_out`]), and are not changed afterwards. An order acts from the end
//! of the last slice on, at the same tick for all motors that it names. The answer has that tick ([`Verbs::known`]). The same verbs at
//! the same ticks make the same edges on every board.
//!
//! # What is not
//! - Acceleration: a motor has a new speed from its next step on. The caller makes ramps, or uses a plan.
//! - Bytes and lines: verbs in frames are [`wire::orders`](crate::wire::orders), verbs in text [`winch::verb_lines`](crate::winch::verb_lines).

pub mod motor;

pub use motor::{Heading, Motor, MotorTiming, Refused, Verb};

use crate::Item;

/// The most motors: each has a bit in a byte.
pub const MAX_MOTORS: usize = 8;

/// The verbs of one order for one or more motors. All begin at one tick and are executed in order.
pub trait OrderList {
    /// The motors, and a verb for each.
    fn iter(&self) -> impl Iterator<Item = (u8, Verb)>;

    /// The verbs for one motor, in order.
    fn of(&self, motor: u8) -> impl Iterator<Item = Verb> {
        self.iter().filter_map(move |(other, verb)| (other == motor).then_some(verb))
    }
}

impl OrderList for [(u8, Verb)] {
    fn iter(&self) -> impl Iterator<Item = (u8, Verb)> {
        <[(u8, Verb)]>::iter(self).copied()
    }
}

/// Why orders are refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OrderError {
    /// There is no motor of this number.
    NoSuchMotor {
        /// The number.
        motor: u8,
    },
    /// A motor refused one of its verbs.
    Refused {
        /// Which motor.
        motor: u8,
        /// Why.
        why: Refused,
    },
}

/// All motors of a board that obeys verbs.
#[derive(Clone, Debug)]
pub struct Verbs {
    motors: [Motor; MAX_MOTORS],
    count: u8,
    /// Steps before this tick are worked out.
    known: u64,
}

impl Verbs {
    /// No motors.
    #[must_use]
    pub const fn new() -> Verbs {
        Verbs { motors: [Motor::NONE; MAX_MOTORS], count: 0, known: 0 }
    }

    /// Begins with motors at rest, at most [`MAX_MOTORS`], with these limits and positions. No step comes before `known`. Moves that were
    /// finished earlier, but are not reported yet, are still [reported](Verbs::take_done).
    pub fn begin(&mut self, motors: impl Iterator<Item = (MotorTiming, i32)>, known: u64) {
        (self.count, self.known) = (0, known);
        for (motor, (limits, position)) in self.motors.iter_mut().zip(motors) {
            *motor = motor.restarted(limits, position, known);
            self.count += 1;
        }
    }

    /// Steps before this tick are worked out. An order acts from here on.
    #[must_use]
    pub const fn known(&self) -> u64 {
        self.known
    }

    /// The motors.
    #[must_use]
    pub fn motors(&self) -> &[Motor] {
        self.motors.get(..usize::from(self.count)).unwrap_or_default()
    }

    fn motors_mut(&mut self) -> &mut [Motor] {
        self.motors.get_mut(..usize::from(self.count)).unwrap_or_default()
    }

    /// A move that was finished by tick `now` and is not reported yet: its motor, its tick, and how many of the motor's moves are finished with
    /// it, wrapping. It is the oldest of the first motor that has one, also of a motor that a later configuration does not have.
    pub fn take_done(&mut self, now: u64) -> Option<(u8, u64, u32)> {
        (0..).zip(&mut self.motors).find_map(|(number, motor)| {
            let (at, count) = motor.take_done(now)?;
            Some((number, at, count))
        })
    }

    /// The tick at which the next move that is not reported yet is finished, as far as is worked out.
    #[must_use]
    pub fn next_done(&self) -> Option<u64> {
        self.motors.iter().filter_map(Motor::next_done).min()
    }

    /// Obeys all orders, from [`known`](Verbs::known) on, or none.
    ///
    /// # Errors
    /// Why the first refused order is refused. Then nothing changes.
    ///
    /// ```
    /// use pulsetrain_core::verbs::{MotorTiming, OrderError, Verb, Verbs};
    /// let mut verbs = Verbs::new();
    /// verbs.begin([(MotorTiming { shortest: 10, turn: 20, period: 1000 }, 0)].into_iter(), 50);
    /// assert_eq!(verbs.obey(&[(0, Verb::Run)][..]), Ok(()));
    /// assert_eq!(verbs.next_steps().collect::<Vec<_>>(), [(0, Some(50))]);
    /// assert_eq!(verbs.obey(&[(1, Verb::Run)][..]), Err(OrderError::NoSuchMotor { motor: 1 }));
    /// ```
    pub fn obey<O: OrderList + ?Sized>(&mut self, orders: &O) -> Result<(), OrderError> {
        if let Some((motor, _)) = orders.iter().find(|(motor, _)| *motor >= self.count) {
            return Err(OrderError::NoSuchMotor { motor });
        }
        // All orders are tried first, on a copy of one motor after the other. To copy all motors would take a board longer than the orders.
        for (number, motor) in (0..).zip(self.motors()) {
            let mut trial = None;
            for verb in orders.of(number) {
                let tried = trial.get_or_insert(*motor).obey(verb, self.known);
                tried.map_err(|why| OrderError::Refused { motor: number, why })?;
            }
        }
        let known = self.known;
        for (number, motor) in (0..).zip(self.motors_mut()) {
            for verb in orders.of(number) {
                // It was not refused just now.
                let _ = motor.obey(verb, known);
            }
        }
        Ok(())
    }

    /// Each motor's position at [`known`](Verbs::known), and the tick of its next step from there on, unless another order comes.
    pub fn next_steps(&self) -> impl Iterator<Item = (i32, Option<u64>)> {
        self.motors().iter().map(|motor| (motor.position(), motor.next_step()))
    }

    /// Works out all motors' steps before tick `until`, which is less than 2^30 ticks after [`known`](Verbs::known). `push` gets them as items
    /// for the motors' channels, of `F` fraction bits: at most [`MAX_ITEMS`](motor::MAX_ITEMS) for each motor.
    pub fn work_out<const F: u32>(&mut self, until: u64, mut push: impl FnMut(u8, Item)) {
        if until <= self.known {
            return;
        }
        self.known = until;
        for (number, motor) in (0..).zip(self.motors_mut()) {
            motor.work_out::<F>(until, |item| push(number, item));
        }
    }

    /// Whether no step comes and no move ends after tick `now`, unless another order comes. Steps that were worked out may still wait in
    /// queues.
    #[must_use]
    pub fn rest_at(&self, now: u64) -> bool {
        self.motors().iter().all(|motor| motor.rests_at(now))
    }

    /// Call this when the host is gone. Motors drop [runs without an end](Motor::drop_endless); with `lost`, they drop all orders. Returns a bit
    /// for each motor that stops from above its pull-in speed, that is, at an interval shorter than its `pull_in` ticks: it may stand
    /// elsewhere than its count says.
    #[must_use]
    pub fn host_gone(&mut self, lost: bool, pull_in: impl Fn(u8) -> u64) -> u8 {
        let mut uncertain = 0;
        for (number, motor) in (0..).zip(self.motors_mut()) {
            let was_faster = motor.gap().is_some_and(|gap| gap < pull_in(number));
            if lost {
                // Halt is never refused, and makes no step, so that `at` does not matter.
                let _ = motor.obey(Verb::Halt, 0);
            } else {
                motor.drop_endless();
            }
            if was_faster && motor.gap().is_none() {
                uncertain |= 1 << number;
            }
        }
        uncertain
    }

    /// Call this when another host takes over: it gets no reports of earlier moves. See [`Motor::mute_moves`].
    pub fn mute_moves(&mut self) {
        self.motors.iter_mut().for_each(Motor::mute_moves);
    }

    /// Notes that all motors were stopped at once, each after the tick that `at` returns for its number: see [`Motor::stop`].
    pub fn stop(&mut self, at: impl Fn(u8) -> u64) {
        for (number, motor) in (0..).zip(self.motors_mut()) {
            motor.stop(at(number));
        }
    }
}

impl Default for Verbs {
    fn default() -> Verbs {
        Verbs::new()
    }
}
