//! Motors of an Uno that are told directly, with the image that has verbs: the steps of the native board, on random live scripts.

mod common;

use common::lab::{EXACT, Lab, SOFTWARE, Timing};
use common::{Random, TICK_HZ, native_config, uno_setup};
use pulsetrain_board::native_verbs::NativeVerbs;
use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Board, Edge, Faults, Remote, RemoteError, Setup};
use pulsetrain_core::verbs::{Course, Limits, Verb};
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::{Cause, Reason};
use pulsetrain_core::wire::orders::{Obeyed, Orders, order};

/// Pins of motors (STEP, DIR), and what the edges' ticks are compared by.
struct Pins {
    name: &'static str,
    pins: &'static [(u8, u8)],
    timing: Timing,
}

/// Every way to wire an Uno.
const ALL: [Pins; 7] = [
    Pins { name: "one on port B", pins: &[(8, 9)], timing: SOFTWARE },
    Pins { name: "one by hardware", pins: &[(9, 8)], timing: EXACT },
    Pins { name: "two by hardware", pins: &[(9, 8), (10, 13)], timing: EXACT },
    Pins { name: "two on port D", pins: &[(2, 5), (3, 6)], timing: SOFTWARE },
    Pins { name: "two on port B", pins: &[(8, 11), (9, 12)], timing: SOFTWARE },
    Pins { name: "three on port D", pins: &[(2, 5), (3, 6), (4, 7)], timing: SOFTWARE },
    Pins { name: "the CNC shield", pins: &[(2, 5), (3, 6), (4, 7), (12, 13)], timing: SOFTWARE },
];

/// What the firmware lets motors be told: docs/pico.md.
fn limits(setup: &Setup) -> Limits {
    let pulse = u32::from(setup.pulse_ticks);
    let each = if pulse <= 31 { 320 } else { 4000 };
    let shortest = (each + 3 * pulse) * setup.motors.len() as u32;
    let turn = 640 + pulse + u32::from(setup.setup_ticks) + u32::from(setup.hold_ticks);
    Limits { shortest, turn, period: shortest.max(16_000) }
}

/// A virtual Uno and a native board that is told what the Uno obeyed.
struct Pair {
    setup: Setup,
    timing: Timing,
    uno: Remote<VirtualUno>,
    native: NativeVerbs,
    /// Edges of the Uno, steps of the native board.
    lab: Lab,
    /// Moves that were done: motor, tick, number.
    done: Vec<(usize, u64, u32)>,
}

impl Pair {
    fn new(setup: &Setup, timing: Timing) -> Pair {
        let mut uno = Remote::open(VirtualUno::with_image(&pulsetrain_board::hex::parse(&std::fs::read_to_string("/tmp/t/unoverbs/uno-verbs.hex").unwrap(), 32768).unwrap()).unwrap(), 1).expect("it answers");
        assert_eq!(uno.set_baud(Baud::B1M), Ok(Baud::B1M));
        uno.configure(setup).unwrap_or_else(|error| panic!("{error}: {setup:?}"));
        let native = NativeVerbs::new(&native_config(setup), &vec![limits(setup); setup.motors.len()]);
        let native = native.expect("a native board can do it");
        Pair { setup: setup.clone(), timing, uno, native, lab: Lab::default(), done: Vec::new() }
    }

    /// Tells both; the native board what the Uno did, from the same tick on.
    fn tell(&mut self, orders: &[(u8, Verb)]) -> Result<Obeyed, RemoteError> {
        let obeyed = self.uno.tell_motors(orders)?;
        let bytes: Vec<u8> = orders.iter().flat_map(|(motor, verb)| order(*motor, *verb)).collect();
        if let Some(last) = obeyed.tick.checked_sub(TICK_HZ / 100).filter(|last| *last > self.native.now()) {
            self.advance_native(last);
        }
        let wanted = self.native.obey(obeyed.tick, &Orders::decode(&bytes).expect("orders"));
        assert_eq!(Ok(obeyed), wanted, "{orders:?}");
        Ok(obeyed)
    }

    /// Its steps alone.
    fn advance_native(&mut self, until: u64) {
        let mut seen = Lab::default();
        self.native.advance(until, &mut seen);
        self.lab.steps.extend(seen.steps);
    }

    fn advance(&mut self, until: u64) {
        let Pair { uno, lab, .. } = self;
        uno.advance(until, &mut |edge: Edge| lab.edges.push(edge));
        for event in self.uno.events() {
            match event.cause {
                Cause::MoveDone => self.done.push((event.motor.into(), event.tick, event.detail)),
                Cause::Finished => {}
                _ => panic!("{event:?}"),
            }
        }
    }

    /// Compares all steps, and the moves that were done. Motors rest.
    fn compare(&mut self) {
        self.advance_native(self.uno.now());
        self.lab.check(&self.setup, self.timing, None);
        let mut wanted = self.native.done();
        wanted.sort_unstable();
        self.done.sort_unstable();
        assert_eq!(self.done, wanted);
        assert_eq!(self.uno.error(), None);
        let status = self.uno.status().expect("it answers");
        assert!(status.is_idle());
        assert_eq!(self.uno.positions(), self.native.positions());
        assert_eq!(self.uno.positions(), self.lab.counts(&self.setup));
        for motor in 0..self.setup.motors.len() {
            assert_eq!(self.uno.faults(motor), Faults::default());
        }
    }
}

/// One move: exactly its steps, from the tick that the answer says, a period apart; done a period after the last.
#[test]
fn moves_have_exactly_their_steps() {
    for (steps, ticks) in [(0, 5000), (1, 5000), (2, 125_000), (8, 12_500), (100, 7001), (2000, 2500), (70_000, 368)] {
        let mut pair = Pair::new(&uno_setup(&[(9, 8)], 16), EXACT);
        let obeyed = pair.tell(&[(0, Verb::Speed { ticks }), (0, Verb::Move { steps })]).expect("it can");
        let first = obeyed.tick;
        pair.advance(first + u64::from(steps) * ticks + TICK_HZ / 100);
        let rises: Vec<_> =
            pair.lab.edges.iter().filter(|edge| edge.line == 9 && edge.level).map(|edge| edge.tick - 1).collect();
        let wanted: Vec<_> = (0..u64::from(steps)).map(|step| first + step * ticks).collect();
        assert_eq!(rises, wanted, "{steps} steps");
        let done = if steps == 0 { first } else { first + u64::from(steps) * ticks };
        assert_eq!(pair.done, [(0, done, 1)]);
        pair.compare();
    }
}

/// Motors with levels, pulses and DIR times of any kind.
fn random_setup(pins: &Pins, random: &mut Random) -> Setup {
    let mut setup = uno_setup(pins.pins, [16, 16, 31, 80, 160][random.below(5) as usize]);
    setup.setup_ticks = random.below(100) as u16;
    setup.hold_ticks = random.below(100) as u16;
    for motor in &mut setup.motors {
        // The compare hardware makes high pulses.
        (motor.forward_high, motor.step_low) = (random.one_in(2), random.one_in(2) && pins.timing.late != 0);
    }
    setup
}

fn random_verb(limits: &Limits, random: &mut Random) -> Verb {
    match random.below(12) {
        0..3 => Verb::Move { steps: [0, 1, 2, 8, 100, 2000, u32::MAX][random.below(7) as usize] },
        3 => Verb::Run,
        4..8 => {
            let shortest = u64::from(limits.shortest);
            // Now and then one that lasts seconds: the next one does not wait for its end.
            let longest = if random.one_in(6) { 3 * TICK_HZ } else { shortest << random.between(1, 9) };
            Verb::Speed { ticks: random.between(shortest, longest) }
        }
        8 => Verb::Course(Course::Stationary),
        9 => Verb::Course(Course::Forward),
        10 => Verb::Course(Course::Backward),
        _ => Verb::Halt,
    }
}

/// A random live script; how many steps there were.
fn random_script(pins: &Pins, seed: u64) -> usize {
    let random = &mut Random::new(seed);
    let setup = random_setup(pins, random);
    println!("{setup:?}");
    let mut pair = Pair::new(&setup, pins.timing);
    let limits = limits(&setup);
    for _ in 0..random.between(10, 40) {
        let orders: Vec<_> = (0..random.between(1, 7))
            .map(|_| (random.below(setup.motors.len() as u64) as u8, random_verb(&limits, random)))
            .collect();
        match pair.tell(&orders) {
            Ok(_) | Err(RemoteError::Refused { reason: Reason::Busy, .. }) => {}
            Err(error) => panic!("{error}: {orders:?}"),
        }
        pair.advance(pair.uno.now() + random.below(TICK_HZ / 50));
    }
    // To rest: whatever is under way ends.
    let halts: Vec<_> = (0..setup.motors.len() as u8).map(|motor| (motor, Verb::Halt)).collect();
    pair.tell(&halts).expect("always");
    pair.advance(pair.uno.now() + TICK_HZ / 10);
    pair.compare();
    pair.lab.steps.len()
}

#[test]
fn random_live_scripts() {
    for pins in &ALL {
        let mut steps = 0;
        for seed in 0..6 {
            println!("{}, seed {seed}", pins.name);
            steps += random_script(pins, seed);
        }
        assert!(steps > 2000, "{}: {steps} steps", pins.name);
    }
}

/// What docs/pico.md promises as the shortest periods: all motors at once, in step and not, all changing direction now and then. What is
/// told is never put off until a host gives up.
#[test]
fn the_shortest_periods_hold() {
    for pins in &ALL {
        for pulse_ticks in [16, 31, 80] {
            for more in [0, 37] {
                println!("{}, pulses of {pulse_ticks}, periods {more} apart", pins.name);
                let setup = uno_setup(pins.pins, pulse_ticks);
                let mut pair = Pair::new(&setup, pins.timing);
                let shortest = limits(&setup).shortest;
                let all = |verb: &dyn Fn(u8) -> Verb| -> Vec<(u8, Verb)> {
                    (0..setup.motors.len() as u8).map(|motor| (motor, verb(motor))).collect()
                };
                pair.tell(&all(&|motor| Verb::Speed { ticks: u64::from(shortest) + more * u64::from(motor) })).expect("it can");
                pair.tell(&all(&|_| Verb::Run)).expect("it can");
                for turn in 0..6 {
                    pair.advance(pair.uno.now() + TICK_HZ / 50);
                    let course = if turn % 2 == 0 { Course::Backward } else { Course::Forward };
                    pair.tell(&all(&|_| Verb::Course(course))).expect("it can");
                }
                pair.tell(&all(&|_| Verb::Halt)).expect("it can");
                pair.advance(pair.uno.now() + TICK_HZ / 50);
                pair.compare();
                let least = TICK_HZ / 10 / u64::from(shortest) * setup.motors.len() as u64;
                assert!(pair.lab.steps.len() as u64 > least, "{} steps, {least}", pair.lab.steps.len());
                let measures = pair.uno.measures(false).expect("it answers");
                println!("    at least {} ticks ahead, {} bytes of stack left", measures.least_ahead_ticks, measures.stack_left);
                assert!(measures.stack_left > 0 && measures.late == 0, "{measures:?}");
            }
        }
    }
}
