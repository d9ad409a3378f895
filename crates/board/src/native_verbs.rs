//! A native board whose motors are told directly: core's verbs and the native stepgen, in virtual time.
//!
//! What a verb means is core's, the same code as on a Pico; here is a clock. The same orders at the same ticks make the same edges
//! as there: tests/pico_verbs.rs compares them.

use crate::native::ConfigError;
use crate::{Board, Config, Native, Observer};
use pulsetrain_core::verbs::{Limits, Motor, Verbs};
use pulsetrain_core::wire::message::Reason;
use pulsetrain_core::wire::orders::{Obeyed, Orders};
use pulsetrain_core::wire::{MAX_MOTORS, Refusal};
use pulsetrain_core::{Entry, Epoch};

/// What is worked out at once, ticks.
const SLICE: u64 = 1 << 20;

/// A board in virtual time that obeys verbs.
///
/// ```
/// use pulsetrain_board::native_verbs::NativeVerbs;
/// use pulsetrain_board::{Config, Edge, MotorConfig, Wiring};
/// use pulsetrain_core::verbs::{Limits, Verb};
/// use pulsetrain_core::wire::orders::{Orders, order};
///
/// let wiring = Wiring::StepDir { step: 2, dir: 3, forward_high: true, pulse_ticks: 10, setup_ticks: 5 };
/// let config = Config { fraction_bits: 32, motors: vec![MotorConfig { wiring, pull_in_ticks: 0 }] };
/// let mut board = NativeVerbs::new(&config, &[Limits { shortest: 20, turn: 30, period: 100 }])?;
/// let obeyed = board.obey(50, &Orders::decode(&order(0, Verb::Move { steps: 2 })).unwrap()).unwrap();
/// assert_eq!((obeyed.tick, obeyed.motors()[0].wait), (50, 0));
/// let mut rises = Vec::new();
/// board.advance(1000, &mut |edge: Edge| if edge.line == 2 && edge.level { rises.push(edge.tick) });
/// assert_eq!(rises, [50, 150]);
/// assert_eq!(board.done(), [(0, 250, 1)]);
/// # Ok::<(), pulsetrain_board::native::ConfigError>(())
/// ```
#[derive(Debug)]
pub struct NativeVerbs {
    native: Native,
    verbs: Verbs,
    fraction_bits: u32,
    /// So long before a step its DIR may have to change, ticks.
    lead: u64,
}

impl NativeVerbs {
    /// A board at tick 0, all lines low, all motors at rest at position 0; `limits` are the motors', in order.
    ///
    /// # Errors
    /// When the configuration asks for what no board has, or has more than eight motors.
    pub fn new(config: &Config, limits: &[Limits]) -> Result<NativeVerbs, ConfigError> {
        if config.motors.len() > MAX_MOTORS || limits.len() != config.motors.len() {
            return Err(ConfigError::Motors(config.motors.len()));
        }
        let mut verbs = Verbs::new();
        verbs.begin(limits.iter().map(|limits| (*limits, 0)), 0);
        let native = Native::new(config)?;
        let lead = config.motors.iter().map(|motor| u64::from(motor.wiring.lead_ticks())).max().unwrap_or(0);
        Ok(NativeVerbs { native, verbs, fraction_bits: config.fraction_bits, lead })
    }

    /// Does all of what is ordered, from tick `at` on, or none of it.
    ///
    /// # Errors
    /// As [`Verbs::obey`] says; [`Reason::Timing`] if `at` is before [`open`](NativeVerbs::open).
    pub fn obey(&mut self, at: u64, orders: &Orders<'_>) -> Result<Obeyed, Refusal> {
        if at < self.open() {
            return Err(Refusal::of(Reason::Timing));
        }
        self.work_out(at);
        self.verbs.obey(orders)
    }

    /// The first tick from which on a verb may hold.
    #[must_use]
    pub fn open(&self) -> u64 {
        self.verbs.known().max(self.native.now() + self.lead)
    }

    /// Makes all edges up to and with tick `until`.
    pub fn advance(&mut self, until: u64, observer: &mut impl Observer) {
        while self.native.now() <= until {
            let end = until.min(self.native.now() + SLICE - 1);
            self.work_out(end + self.lead + 1);
            self.native.advance(end, observer);
        }
    }

    fn work_out(&mut self, until: u64) {
        while self.verbs.known() < until {
            let end = until.min(self.verbs.known() + SLICE);
            let native = &mut self.native;
            // What the queues have no room for has to be played first: no step after it is worked out.
            let full = (0..self.verbs.motors().len())
                .any(|motor| native.credit(motor) < 2 * pulsetrain_core::verbs::motor::MOST_ITEMS);
            assert!(!full, "orders come faster than time goes on");
            let push = |motor: u8, item| {
                native.push(motor.into(), Entry { epoch: Epoch(0), item }).expect("just looked");
            };
            match self.fraction_bits {
                16 => self.verbs.work_out::<16>(end, push),
                24 => self.verbs.work_out::<24>(end, push),
                _ => self.verbs.work_out::<32>(end, push),
            }
        }
    }

    /// Moves that were done by now and were not asked for yet: motor, tick, how many of this motor's are done with it.
    pub fn done(&mut self) -> Vec<(usize, u64, u32)> {
        let now = self.native.now();
        let of = |(index, motor): (usize, &mut Motor)| {
            std::iter::from_fn(|| motor.take_done(now)).map(|(at, count)| (index, at, count)).collect::<Vec<_>>()
        };
        self.verbs.motors_mut().iter_mut().enumerate().flat_map(of).collect()
    }

    /// The first tick that has not been passed.
    #[must_use]
    pub fn now(&self) -> u64 {
        self.native.now()
    }

    /// Steps forward less steps backward of each motor: pulses begun so far.
    #[must_use]
    pub fn positions(&self) -> Vec<i64> {
        self.native.positions()
    }

    /// Whether nothing moves, and nothing is to.
    #[must_use]
    pub fn is_idle(&self) -> bool {
        self.verbs.is_at_rest() && self.native.is_idle()
    }

    /// What went wrong on a motor: nothing, while the limits are its own.
    #[must_use]
    pub fn faults(&self, motor: usize) -> crate::Faults {
        Board::faults(&self.native, motor)
    }
}
