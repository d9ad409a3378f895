//! A native board whose motors obey verbs (orders to single motors) instead of plans, in virtual time.
//!
//! The verbs are core's code, as on a Pico. The same orders at the same ticks make the same edges as there: tests/it/chips/pico_verbs.rs compares
//! them.

use crate::native::ConfigError;
use crate::{Board, Config, Edge, Native, Observer};
use pulsetrain_core::verbs::motor::MAX_ITEMS;
use pulsetrain_core::verbs::{MotorTiming, Verbs};
use pulsetrain_core::wire::message::{Cause, Event, Reason};
use pulsetrain_core::wire::orders::{Obeyed, Orders};
use pulsetrain_core::wire::{MAX_MOTORS, Refusal};
use pulsetrain_core::{Entry, Epoch};
use std::collections::VecDeque;

/// Most ticks that are computed at once, so that the items fit in the queues.
const SLICE: u64 = 1 << 20;

/// A board in virtual time that obeys verbs.
///
/// ```
/// use pulsetrain_board::native_verbs::NativeVerbs;
/// use pulsetrain_board::{Config, Edge, MotorConfig, Wiring};
/// use pulsetrain_core::verbs::{MotorTiming, Verb};
/// use pulsetrain_core::wire::message::Cause;
/// use pulsetrain_core::wire::orders::{Orders, order};
///
/// let wiring = Wiring::StepDir { step: 2, dir: 3, forward_high: true, pulse_ticks: 10, setup_ticks: 5 };
/// let config = Config { fraction_bits: 32, motors: vec![MotorConfig { wiring, pull_in_ticks: 0 }] };
/// let mut board = NativeVerbs::new(&config, &[MotorTiming { shortest: 20, turn: 30, period: 100 }])?;
/// let obeyed = board.obey(50, &Orders::decode(&order(0, Verb::Move { steps: 2 })).unwrap()).unwrap();
/// assert_eq!((obeyed.tick, obeyed.motors()[0].wait), (50, 0));
/// let mut rises = Vec::new();
/// board.advance(1000, &mut |edge: Edge| if edge.line == 2 && edge.level { rises.push(edge.tick) });
/// assert_eq!(rises, [50, 150]);
/// let done = board.events().into_iter().find(|event| event.cause == Cause::MoveDone).unwrap();
/// assert_eq!((done.motor, done.tick, done.detail), (0, 250, 1));
/// # Ok::<(), pulsetrain_board::native::ConfigError>(())
/// ```
#[derive(Debug)]
pub struct NativeVerbs {
    native: Native,
    verbs: Verbs,
    fraction_bits: u32,
    /// The longest time before a step at which its DIR changes, ticks.
    lead: u64,
    /// By motor: finished moves that were not read yet, each with its last tick and the number of moves that are finished then.
    done: Vec<VecDeque<(u64, u32)>>,
}

impl NativeVerbs {
    /// A board at tick 0, with all lines low, and all motors at rest at position 0. `limits` has the timing of each motor, in order.
    ///
    /// # Errors
    /// When the configuration is not possible, or has more than eight motors or another number of them than `limits`.
    pub fn new(config: &Config, limits: &[MotorTiming]) -> Result<NativeVerbs, ConfigError> {
        NativeVerbs::at(config, limits, &vec![0; limits.len()], 0)
    }

    /// As [`new`](NativeVerbs::new), with the motors at `positions` and the clock at tick `now`.
    ///
    /// # Errors
    /// As [`new`](NativeVerbs::new), and with another number of positions.
    pub fn at(
        config: &Config,
        limits: &[MotorTiming],
        positions: &[i32],
        now: u64,
    ) -> Result<NativeVerbs, ConfigError> {
        let count = config.motors.len();
        if count > MAX_MOTORS || limits.len() != count || positions.len() != count {
            return Err(ConfigError::Motors(count));
        }
        let mut native = Native::new(config)?;
        if let Some(last) = now.checked_sub(1) {
            native.advance(last, &mut |_: Edge| {});
        }
        let mut verbs = Verbs::new();
        verbs.begin(limits.iter().copied().zip(positions.iter().copied()), now);
        let lead = config.motors.iter().map(|motor| u64::from(motor.wiring.lead_ticks())).max().unwrap_or(0);
        let done = vec![VecDeque::new(); limits.len()];
        Ok(NativeVerbs { native, verbs, fraction_bits: config.fraction_bits, lead, done })
    }

    /// Obeys all of the orders from tick `at` on, or none of them.
    ///
    /// # Errors
    /// As [`Verbs::obey`]. [`Reason::Timing`] if `at` is before [`open`](NativeVerbs::open). [`Reason::Full`] if the queues have no room for that many
    /// orders without time passing: [`advance`](NativeVerbs::advance) first.
    pub fn obey(&mut self, at: u64, orders: &Orders<'_>) -> Result<Obeyed, Refusal> {
        if at < self.open() {
            return Err(Refusal::of(Reason::Timing));
        }
        if !self.work_out(at) {
            return Err(Refusal::of(Reason::Full));
        }
        orders.tell(&mut self.verbs)
    }

    /// The first tick from which an order can be obeyed.
    #[must_use]
    pub fn open(&self) -> u64 {
        self.verbs.known().max(self.native.now() + self.lead)
    }

    /// Lets time pass, up to and with tick `until`, and makes all edges of that time.
    pub fn advance(&mut self, until: u64, observer: &mut impl Observer) {
        while self.native.now() <= until {
            let end = until.min(self.native.now() + SLICE - 1);
            let is_known = self.work_out(end + self.lead + 1);
            // The queues are full: play what is computed first, to make room.
            let known = self.verbs.known().saturating_sub(self.lead + 1);
            let end = if is_known { end } else { end.min(known).max(self.native.now()) };
            self.native.advance(end, observer);
        }
    }

    /// Computes the motors' steps up to `until`. Returns false if the queues have no room for them.
    fn work_out(&mut self, until: u64) -> bool {
        while self.verbs.known() < until {
            let end = until.min(self.verbs.known() + SLICE);
            let native = &mut self.native;
            if (0..self.verbs.motors().len()).any(|motor| native.credit(motor) < MAX_ITEMS) {
                return false;
            }
            let push = |motor: u8, item| {
                native.push(motor.into(), Entry { epoch: Epoch(0), item }).expect("just looked");
            };
            match self.fraction_bits {
                16 => self.verbs.work_out::<16>(end, push),
                24 => self.verbs.work_out::<24>(end, push),
                _ => self.verbs.work_out::<32>(end, push),
            }
            // Finished moves are moved to a list of any length: core would refuse moves when its own short list is full.
            while let Some((motor, at, count)) = self.verbs.take_done(u64::MAX) {
                self.done[usize::from(motor)].push_back((at, count));
            }
        }
        true
    }

    /// What has happened since the last call, oldest first: moves that were [done](Cause::MoveDone), and what [`Native`] reports.
    pub fn events(&mut self) -> Vec<Event> {
        let now = self.native.now();
        let mut events = self.native.events();
        for (motor, done) in (0..).zip(&mut self.done) {
            while let Some((tick, count)) = done.pop_front_if(|(at, _)| *at <= now) {
                events.push(Event { cause: Cause::MoveDone, motor, tick, detail: count });
            }
        }
        // The last move is done before all rest.
        events.sort_by_key(|event| (event.tick, event.cause == Cause::Finished));
        events
    }

    /// The first tick that has not been passed.
    #[must_use]
    pub fn now(&self) -> u64 {
        self.native.now()
    }

    /// Steps forward minus steps backward of each motor, by the pulses that have begun.
    #[must_use]
    pub fn positions(&self) -> Vec<i64> {
        self.native.positions()
    }

    /// Drops all orders: no step follows that is not computed already. Returns a bit for each motor that was stopped between two steps; such a motor may
    /// stand elsewhere than it counts if it was faster than its pull-in rate.
    pub fn halt(&mut self) -> u8 {
        self.verbs.host_gone(true, |_| u64::MAX)
    }

    /// Whether nothing moves, and no order is left.
    #[must_use]
    pub fn is_idle(&self) -> bool {
        self.verbs.rest_at(self.native.now()) && self.native.is_idle()
    }

    /// The faults of a motor. There are none if its limits are right.
    #[must_use]
    pub fn faults(&self, motor: usize) -> crate::Faults {
        Board::faults(&self.native, motor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{MotorConfig, Wiring};
    use pulsetrain_core::verbs::Verb;
    use pulsetrain_core::wire::orders::order;

    /// More orders than the queues have room for are refused, and time that goes on makes room; no step is lost.
    #[test]
    fn too_many_orders_at_once_are_refused() {
        let wiring = Wiring::StepDir { step: 2, dir: 3, forward_high: true, pulse_ticks: 2, setup_ticks: 5 };
        let config = Config { fraction_bits: 32, motors: vec![MotorConfig { wiring, pull_in_ticks: 0 }] };
        let limits = MotorTiming { shortest: 3, turn: 9, period: 3 };
        let mut board = NativeVerbs::new(&config, &[limits]).expect("a board");
        let (mut steps, mut refused, mut rises) = (0, 0, 0);
        for time in 0..3000_u64 {
            let one = order(0, Verb::Move { steps: 1 });
            match board.obey(10 + 7 * time, &Orders::decode(&one).expect("one order")) {
                Ok(_) => steps += 1,
                Err(Refusal { reason: Reason::Full, .. }) => {
                    refused += 1;
                    board.advance(7 * time - 30, &mut |edge: crate::Edge| {
                        rises += u32::from(edge.line == 2 && edge.level)
                    });
                }
                Err(other) => panic!("{other:?}"),
            }
        }
        board.advance(100_000, &mut |edge: crate::Edge| rises += u32::from(edge.line == 2 && edge.level));
        assert!(refused > 0 && steps > 2000, "{refused} {steps}");
        assert_eq!((rises, board.positions()), (steps, vec![i64::from(steps)]));
        assert!(board.is_idle() && board.faults(0) == crate::Faults::default());
    }
}
