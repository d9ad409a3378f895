//! Motors that take orders directly, without a plan: a number of steps, with a period, in a direction.
//!
//! # What is here, top down
//! - [`Verbs`]: all motors, and how far what they do is known
//! - [`motor`]: one motor: from [`Verb`]s to evenly spaced steps, as items for its channel
//!
//! What motors do is worked out a little ahead, slice after slice ([`Verbs::work_out`]); what was worked out stands. A verb holds
//! from the end of the last slice on, for all motors that one order names from the same tick, and the answer says which
//! ([`Verbs::known`]): the same verbs at the same ticks make the same edges on every board.
//!
//! # What is not
//! - Acceleration: a motor has a new speed with its next step. Ramps are the caller's task, or a plan's.
//! - Bytes and lines: verbs in frames are [`wire::orders`](crate::wire::orders), verbs in text [`winch::verb_lines`](crate::winch::verb_lines).

pub mod motor;

pub use motor::{Heading, Motor, MotorTiming, Refused, Verb};

use crate::Item;

/// Motors at most: a bit each in a byte.
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

/// Why orders are not obeyed.
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
    /// What happens before this tick is worked out.
    known: u64,
}

impl Verbs {
    /// No motors.
    #[must_use]
    pub const fn new() -> Verbs {
        Verbs { motors: [Motor::NONE; MAX_MOTORS], count: 0, known: 0 }
    }

    /// Begins with motors at rest, at these positions and within these limits, [`MAX_MOTORS`] at most; nothing happens before
    /// `known`. Moves of the motors before that were done and not reported yet are still [reported](Verbs::take_done).
    pub fn begin(&mut self, motors: impl Iterator<Item = (MotorTiming, i32)>, known: u64) {
        (self.count, self.known) = (0, known);
        for (motor, (limits, position)) in self.motors.iter_mut().zip(motors) {
            *motor = motor.restarted(limits, position, known);
            self.count += 1;
        }
    }

    /// What happens before this tick is worked out: a verb holds from there on.
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

    /// The oldest move of the first motor that has one which was done by tick `now` and was not reported yet: the motor, when, and how
    /// many of its moves are done with it, wrapping. Also one of a motor that is no more.
    pub fn take_done(&mut self, now: u64) -> Option<(u8, u64, u32)> {
        (0..).zip(&mut self.motors).find_map(|(number, motor)| {
            let (at, count) = motor.take_done(now)?;
            Some((number, at, count))
        })
    }

    /// When the next move that was worked out, and not reported yet, is done.
    #[must_use]
    pub fn next_done(&self) -> Option<u64> {
        self.motors.iter().filter_map(Motor::next_done).min()
    }

    /// Does all of what is ordered, from [`known`](Verbs::known) on, or none of it.
    ///
    /// # Errors
    /// What is wrong with the first order that cannot be obeyed; nothing changes then.
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
        // Each motor that has an order is tried first, on a copy. A copy of all of them would take a board longer than the orders.
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

    /// Where each motor is at [`known`](Verbs::known), and when its next step comes from there on, unless another order comes.
    pub fn next_steps(&self) -> impl Iterator<Item = (i32, Option<u64>)> {
        self.motors().iter().map(|motor| (motor.position(), motor.next_step()))
    }

    /// Works out what all motors do up to tick `until` (not included; less than 2^30 after [`known`](Verbs::known)), and hands it
    /// over as items for their channels, of `F` fraction bits: [`MOST_ITEMS`](motor::MOST_ITEMS) for each motor at most.
    pub fn work_out<const F: u32>(&mut self, until: u64, mut push: impl FnMut(u8, Item)) {
        if until <= self.known {
            return;
        }
        self.known = until;
        for (number, motor) in (0..).zip(self.motors_mut()) {
            motor.work_out::<F>(until, |item| push(number, item));
        }
    }

    /// Whether no step will come, and nothing will be done, after tick `now` unless another order comes; steps that were worked out may still
    /// have to be made.
    #[must_use]
    pub fn rest_at(&self, now: u64) -> bool {
        self.motors().iter().all(|motor| motor.rests_at(now))
    }

    /// The host is gone, and no order will come: motors drop [what has no end](Motor::drop_endless); with `lost`, all orders. Gives, bit by
    /// motor, which ones leave steps out that were to come sooner than `pull_in` ticks of that motor after the last one: they may come to
    /// stand elsewhere than they count.
    #[must_use]
    pub fn host_gone(&mut self, lost: bool, pull_in: impl Fn(u8) -> u64) -> u8 {
        let mut uncertain = 0;
        for (number, motor) in (0..).zip(self.motors_mut()) {
            let was_faster = motor.gap().is_some_and(|gap| gap < pull_in(number));
            if lost {
                // It is never refused; no step comes any more, whatever `at`.
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

    /// Another host takes over: moves of the host before are not reported to it. See [`Motor::mute_moves`].
    pub fn mute_moves(&mut self) {
        self.motors.iter_mut().for_each(Motor::mute_moves);
    }

    /// All motors were stopped at once, each after the tick that `at` gives for its number: see [`Motor::stop`].
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
