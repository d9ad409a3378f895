//! The virtual Pico, next to a native board that gets the same items, to compare their edges.

use super::Random;
use pulsetrain_board::lease::{Lease, LeaseState, Leased};
use pulsetrain_board::virtual_pico::VirtualPico;
use pulsetrain_board::{Board, Config, Edge, MotorConfig, Native, Remote, Setup, StopReport, SwitchRefused, Wiring};
use pulsetrain_core::braking::Limit;
use pulsetrain_core::output::Sequence;
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::{MotorSetup, coil_pins};
use pulsetrain_core::{Direction, Entry, Epoch, Item, Segment, Tick32};

/// Ticks per second.
pub const TICK_HZ: u64 = 125_000_000;

/// The GPIO of the gate; no motor may use it.
const GATE: u8 = 25;

/// Ticks that a PIO word takes besides its pulse and its wait; see `pulsetrain_core::pio`.
const STEP_DIR_OVERHEAD: u32 = 3;

/// A step/dir driver with STEP on `pin` and DIR on the next pin.
pub fn step_dir(pin: u8) -> MotorSetup {
    MotorSetup {
        step_pin: pin,
        dir_pin: pin + 1,
        forward_high: true,
        pull_in_ticks: 1_250_000,
        ..MotorSetup::default()
    }
}

/// A motor on coils, with IN1 to IN4 on the four pins from `pin` on.
pub fn coils(pin: u8, sequence: Sequence) -> MotorSetup {
    MotorSetup { pull_in_ticks: 1_250_000, ..MotorSetup::coils_on(pin, sequence) }
}

/// Steps at a constant speed, `ticks` apart.
pub fn run(count: u32, ticks: i64, direction: Direction) -> Item {
    Item::Run { segment: Segment { count, interval: ticks << 32, add: 0, add2: 0 }, direction }
}

/// The shortest time of a motor's PIO word, ticks.
pub fn overhead(setup: &Setup, motor: &MotorSetup) -> u32 {
    STEP_DIR_OVERHEAD + if motor.coils().is_some() { 0 } else { u32::from(setup.pulse_ticks).max(3) }
}

/// The pins of a motor.
pub fn pins_of(motor: &MotorSetup) -> Vec<u8> {
    if motor.coils().is_some() { coil_pins(motor.step_pin).to_vec() } else { vec![motor.step_pin, motor.dir_pin] }
}

/// The levels of a motor's coils after `edges`; bit 0 is IN1.
pub fn coil_levels(edges: &[Edge], motor: &MotorSetup) -> u8 {
    let mut levels = 0;
    for edge in edges {
        if let Some(line) = coil_pins(motor.step_pin).iter().position(|pin| *pin == edge.line) {
            levels = if edge.level { levels | 1 << line } else { levels & !(1 << line) };
        }
    }
    levels
}

/// The configuration of a native board with the motors of a setup. Its lines have the numbers of the Pico's pins.
pub fn native_config(setup: &Setup) -> Config {
    let motor = |motor: &MotorSetup| MotorConfig {
        wiring: match motor.coils() {
            Some(sequence) => Wiring::Coils {
                lines: coil_pins(motor.step_pin),
                sequence,
                release_ticks: setup.idle_ms.map(|ms| u32::from(ms) * 125_000),
            },
            None => Wiring::StepDir {
                step: motor.step_pin,
                dir: motor.dir_pin,
                forward_high: motor.forward_high,
                pulse_ticks: u32::from(setup.pulse_ticks).max(3),
                setup_ticks: u32::from(setup.setup_ticks).max(overhead(setup, motor)),
            },
        },
        pull_in_ticks: u64::from(motor.pull_in_ticks),
    };
    Config { fraction_bits: 32, motors: setup.motors.iter().map(motor).collect() }
}

/// The Pico and the native board, with their edges: `edges` are the Pico's, `wanted` the native board's.
pub struct Pair {
    pub setup: Setup,
    pub pico: Remote<VirtualPico>,
    pub native: Native,
    pub edges: Vec<Edge>,
    pub wanted: Vec<Edge>,
}

impl Pair {
    pub fn new(setup: &Setup) -> Pair {
        Pair::over(VirtualPico::new(), setup)
    }

    pub fn over(port: VirtualPico, setup: &Setup) -> Pair {
        let mut pico = Remote::open(port, 1).expect("it answers");
        assert_eq!(pico.set_baud(Baud::B2M), Ok(Baud::B2M));
        pico.configure(setup).unwrap_or_else(|error| panic!("{error}: {setup:?}"));
        let soon = pico.now() + TICK_HZ / 1000;
        // The edges of the configuration itself are not compared.
        pico.advance(soon, &mut |_: Edge| {});
        let mut native = Native::new(&native_config(setup)).expect("a native board can do it");
        native.advance(soon, &mut |_: Edge| {});
        Pair { setup: setup.clone(), pico, native, edges: Vec::new(), wanted: Vec::new() }
    }

    /// Pushes the items of an epoch that fit to both boards.
    pub fn push(&mut self, motor: usize, epoch: u8, items: &[Item]) {
        for item in items {
            let entry = Entry { epoch: Epoch(epoch), item: *item };
            if self.pico.room(motor) < 60 || self.pico.push(motor, entry).is_err() {
                break;
            }
            self.native.push(motor, entry).expect("the native queue is longer");
        }
    }

    /// Pushes all items of an epoch to both boards, which must have room for them.
    pub fn push_all(&mut self, motor: usize, epoch: u8, items: &[Item]) {
        for item in items {
            let entry = Entry { epoch: Epoch(epoch), item: *item };
            self.pico.push(motor, entry).expect("it has room");
            self.native.push(motor, entry).expect("the native queue is longer");
        }
    }

    /// Switches both boards, with a lease.
    pub fn switch_with(&mut self, epoch: u8, tick: u64, lease: Lease, limits: &[Limit]) {
        assert_eq!(self.pico.switch(Epoch(epoch), tick, lease, limits), Ok(()));
        assert_eq!(self.native.switch(Epoch(epoch), tick, lease, limits), Ok(()));
    }

    /// Extends the lease of both boards if the Pico accepts that. Returns whether it did.
    pub fn extend(&mut self, lease: Lease) -> bool {
        if self.pico.extend(lease, &[]).is_err() {
            return false;
        }
        while self.pico.unconfirmed().is_some() {
            // The native board's time waits meanwhile, so that it can accept what the Pico has accepted.
            let edges = &mut self.edges;
            let setup = &self.setup;
            self.pico.advance(self.pico.now(), &mut |edge: Edge| edges.extend(as_line(setup, edge)));
        }
        let accepted = match (self.pico.lease(), lease) {
            (LeaseState::Until(at), Lease::Until(until)) => at == until,
            (LeaseState::Last, Lease::Last) => true,
            _ => false,
        };
        if accepted {
            assert_eq!(self.native.extend(lease, &[]), Ok(()));
        }
        accepted
    }

    /// Orders the Pico to brake, and the native board from the same tick on.
    pub fn brake(&mut self) {
        if let Some(at) = self.pico.brake() {
            self.native.brake_at(at);
        }
    }

    pub fn switch(&mut self, epoch: u8, tick: u64) -> Result<(), SwitchRefused> {
        let answer = self.pico.switch(Epoch(epoch), tick, Lease::Last, &[]);
        match answer {
            Ok(()) => assert_eq!(self.native.switch(Epoch(epoch), tick, Lease::Last, &[]), Ok(())),
            Err(_) => Board::discard(&mut self.native, Epoch(epoch)),
        }
        answer
    }

    pub fn advance(&mut self, until: u64) {
        let Pair { setup, pico, native, edges, wanted } = self;
        pico.advance(until, &mut |edge: Edge| edges.extend(as_line(setup, edge)));
        if native.now() <= until {
            native.advance(until, &mut |edge: Edge| wanted.push(edge));
        }
    }

    /// Stops the Pico at once, and then the native board at the same tick.
    pub fn stop_now(&mut self, tick: u64) -> StopReport {
        let Pair { setup, pico, native, edges, wanted } = self;
        let report = pico.stop_now(tick, &mut |edge: Edge| edges.extend(as_line(setup, edge)));
        native.stop_now(report.tick, &mut |edge: Edge| wanted.push(edge));
        report
    }

    /// Checks that both boards made the same edges before tick `until`.
    pub fn compare(&mut self, until: u64) {
        for edges in [&mut self.edges, &mut self.wanted] {
            edges.sort_by_key(|edge| (edge.tick, edge.line));
        }
        let before = |edge: &&Edge| edge.tick < until;
        let (mut got, mut wanted) = (self.edges.iter().filter(before), self.wanted.iter().filter(before));
        let mut last = None;
        for number in 0.. {
            let (is, ought) = (got.next(), wanted.next());
            assert_eq!(is, ought, "edge {number}, after {last:?}; {:?}", self.setup);
            last = is.copied();
            if is.is_none() {
                break;
            }
        }
    }

    /// Steps of each motor with a step/dir driver, by the Pico's edges; `None` for coils.
    pub fn counts(&self) -> Vec<Option<i64>> {
        let count = |motor: &MotorSetup| {
            if motor.coils().is_some() {
                return None;
            }
            let (mut dir, mut count) = (false, 0);
            for edge in &self.edges {
                if edge.line == motor.dir_pin {
                    dir = edge.level;
                } else if edge.line == motor.step_pin && edge.level {
                    count += if dir == motor.forward_high { 1 } else { -1 };
                }
            }
            Some(count)
        };
        self.setup.motors.iter().map(count).collect()
    }
}

/// The most that an immediate stop may lengthen a pulse, ticks: 5 µs (docs/verbs.md).
const STOP_LENGTHENS: u64 = 5 * TICK_HZ / 1_000_000;

/// What the pins of a step/dir driver did up to an immediate stop.
pub struct StoppedDriver {
    /// Steps forward minus backward that its pins made.
    pub position: i64,
    /// If the last pulse ended after the stop: how long before the stop it began, and how much longer than configured it was, ticks.
    pub caught: Option<(u64, u64)>,
}

/// Checks the pins of a step/dir driver up to an immediate stop at tick `stop`: no step begins after it, DIR changes in no pulse, and each pulse has its
/// length.
pub fn stopped_driver(setup: &Setup, motor: &MotorSetup, edges: &[Edge], stop: u64) -> StoppedDriver {
    let configured = u64::from(setup.pulse_ticks.max(3));
    let (mut dir, mut position, mut high, mut caught) = (false, 0, None::<u64>, None);
    for edge in edges {
        if edge.line == motor.dir_pin {
            assert_eq!(high, None, "DIR changes inside a pulse");
            dir = edge.level;
        } else if edge.line == motor.step_pin && edge.level {
            assert!(edge.tick <= stop, "a step after the stop");
            position += if dir == motor.forward_high { 1 } else { -1 };
            high = Some(edge.tick);
        } else if edge.line == motor.step_pin {
            let since = high.take().expect("a pulse begins before it ends");
            let long = edge.tick - since;
            let most = configured + if edge.tick > stop { STOP_LENGTHENS } else { 0 };
            assert!(
                (configured..=most).contains(&long),
                "a pulse of {long} ticks, {configured} were configured; the stop was at {stop}: {edge:?}"
            );
            caught = (edge.tick > stop).then(|| (stop - since, long - configured));
        }
    }
    assert_eq!(high, None, "a pulse has no end");
    StoppedDriver { position, caught }
}

/// An edge of a motor's pin as one of its line, with high for active; `None` for other pins.
pub fn as_line(setup: &Setup, edge: Edge) -> Option<Edge> {
    let low = setup.motors.iter().any(|motor| motor.step_low && motor.coils().is_none() && motor.step_pin == edge.line);
    (edge.line != GATE).then_some(Edge { level: edge.level != low, ..edge })
}

/// A random plan from tick `from` on: runs that speed up and slow down, waits and reversals. No interval is shorter than `fastest` ticks.
pub fn random_items(setup: &Setup, motor: &MotorSetup, random: &mut Random, from: u64, fastest: u64) -> Vec<Item> {
    let room = 3 * overhead(setup, motor) + u32::from(setup.setup_ticks) + u32::from(setup.hold_ticks);
    let mut direction = if random.one_in(2) { Direction::Forward } else { Direction::Backward };
    let mut items = vec![Item::Anchor { tick: Tick32::of(from) }, Item::Dwell { ticks: room }];
    let interval = |random: &mut Random| (fastest as f64 * 100f64.powf(random.fraction().powi(2))) as i64;
    let mut now = interval(random);
    for _ in 0..random.between(2, 16) {
        if random.one_in(4) {
            items.push(Item::Dwell { ticks: random.below(1_000_000) as u32 });
        }
        if random.one_in(3) {
            direction = direction.reversed();
            items.push(Item::Dwell { ticks: room });
        }
        let next = interval(random);
        let count = (1 + if random.one_in(3) { random.below(5) } else { random.below(2000) }) as u32;
        // Half of the runs are curved. Their intervals lie above the straight line from the first to the last, so that none is shorter than both.
        let steps = i64::from(count);
        let bend = if random.one_in(2) { now.min(next).min(1 << 20) << 32 } else { 0 };
        let add2 = -bend / (steps * steps).max(8);
        let add = ((next - now) << 32) / steps - add2 * (steps - 1) / 2;
        let segment = Segment { count, interval: (now << 32) + random.below(1 << 32) as i64, add, add2 };
        items.push(Item::Run { segment, direction });
        now = next.max(fastest as i64);
    }
    items
}
