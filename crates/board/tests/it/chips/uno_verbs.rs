//! Motors of an Uno that are told directly, with the image that has verbs: the steps of the native board, on random live scripts.

use pulsetrain_board::bridge::Bridge;
use pulsetrain_board::native_verbs::NativeVerbs;
use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Board, Edge, Faults, Lease, Leased, Port, Remote, RemoteError, Setup};
use pulsetrain_core::Epoch;
use pulsetrain_core::verbs::{Heading, MotorTiming, Verb};
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::{Cause, Reason};
use pulsetrain_core::wire::orders::{Obeyed, Orders, order};
use pulsetrain_testkit::delays::uno_held_ticks;
use pulsetrain_testkit::lab::{EXACT, Lab, SOFTWARE, Timing, verb_limits};
use pulsetrain_testkit::{Random, TICK_HZ, native_config, uno_setup};
use std::time::Duration;

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
        let mut uno = Remote::open(VirtualUno::with_verbs(), 1).expect("it answers");
        assert_eq!(uno.set_baud(Baud::B1M), Ok(Baud::B1M));
        uno.configure(setup).unwrap_or_else(|error| panic!("{error}: {setup:?}"));
        let native = NativeVerbs::new(&native_config(setup), &vec![verb_limits(setup); setup.motors.len()]);
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
        let done = self.native.events().into_iter().filter(|event| event.cause == Cause::MoveDone);
        let mut wanted: Vec<_> = done.map(|event| (event.motor.into(), event.tick, event.detail)).collect();
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
    let mut setup = uno_setup(pins.pins, [16, 16, 20, 31][random.below(4) as usize]);
    setup.setup_ticks = random.below(100) as u16;
    setup.hold_ticks = random.below(100) as u16;
    for motor in &mut setup.motors {
        // The compare hardware makes high pulses.
        (motor.forward_high, motor.step_low) = (random.one_in(2), random.one_in(2) && pins.timing.late != 0);
    }
    setup
}

fn random_verb(limits: &MotorTiming, random: &mut Random) -> Verb {
    match random.below(12) {
        0..3 => Verb::Move { steps: [0, 1, 2, 8, 100, 2000, u32::MAX][random.below(7) as usize] },
        3 => Verb::Run,
        4..8 => {
            let shortest = u64::from(limits.shortest);
            // Now and then one that lasts seconds: the next one does not wait for its end.
            let longest = if random.one_in(6) { 3 * TICK_HZ } else { shortest << random.between(1, 9) };
            Verb::Speed { ticks: random.between(shortest, longest) }
        }
        8 => Verb::Heading(Heading::Stationary),
        9 => Verb::Heading(Heading::Forward),
        10 => Verb::Heading(Heading::Backward),
        _ => Verb::Halt,
    }
}

/// A random live script; how many steps there were.
fn random_script(pins: &Pins, seed: u64) -> usize {
    let random = &mut Random::new(seed);
    let setup = random_setup(pins, random);
    println!("{setup:?}");
    let mut pair = Pair::new(&setup, pins.timing);
    let limits = verb_limits(&setup);
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

/// What docs/verbs.md promises as the shortest periods: all motors at once, in step and not, all changing direction now and then. What is
/// told is never put off until a host gives up.
#[test]
fn the_shortest_periods_hold() {
    for pins in &ALL {
        for pulse_ticks in [2, 16, 18, 31] {
            for more in [0, 6, 29] {
                println!("{}, pulses of {pulse_ticks}, periods {more} apart", pins.name);
                let setup = uno_setup(pins.pins, pulse_ticks);
                let mut pair = Pair::new(&setup, pins.timing);
                let shortest = verb_limits(&setup).shortest;
                let all = |verb: &dyn Fn(u8) -> Verb| -> Vec<(u8, Verb)> {
                    (0..setup.motors.len() as u8).map(|motor| (motor, verb(motor))).collect()
                };
                pair.tell(&all(&|motor| Verb::Speed { ticks: u64::from(shortest) + more * u64::from(motor) }))
                    .expect("it can");
                pair.tell(&all(&|_| Verb::Run)).expect("it can");
                for turn in 0..6 {
                    pair.advance(pair.uno.now() + TICK_HZ / 50);
                    let course = if turn % 2 == 0 { Heading::Backward } else { Heading::Forward };
                    pair.tell(&all(&|_| Verb::Heading(course))).expect("it can");
                }
                pair.tell(&all(&|_| Verb::Halt)).expect("it can");
                pair.advance(pair.uno.now() + TICK_HZ / 50);
                pair.compare();
                let least = TICK_HZ / 10 / u64::from(shortest) * setup.motors.len() as u64;
                assert!(pair.lab.steps.len() as u64 > least, "{} steps, {least}", pair.lab.steps.len());
                let measures = pair.uno.measures(false).expect("it answers");
                println!(
                    "    at least {} ticks ahead, {} bytes of stack left",
                    measures.least_ahead_ticks, measures.stack_left
                );
                assert!(measures.stack_left > 0 && measures.late == 0, "{measures:?}");
            }
        }
    }
}

/// Behind other bridges no frame is repeated although its answer comes late. An order waits for the answer to the poll before it.
#[test]
fn orders_hold_soon_behind_any_bridge() {
    let shield = [(2, 5), (3, 6), (4, 7), (12, 13)];
    for (name, bridge) in Bridge::ALL {
        let ticks = uno_held_ticks(&shield, 4, bridge);
        let most_ms = if bridge == Bridge::Ftdi { 26 } else { 13 };
        assert!(ticks <= most_ms * TICK_HZ / 1000, "{name}: {ticks} ticks");
    }
}

/// From a host's call, over USB at 1 Mbaud, to the tick from which an order holds: what docs/verbs.md promises, at the shortest periods and at
/// longer ones. `cargo xtask bench verbs` measures it.
#[test]
fn what_is_told_holds_soon() {
    for (bridge, most_ms) in [(Bridge::Ch340, [6, 10, 12, 13]), (Bridge::Atmega16u2, [7, 11, 13, 14])] {
        for pins in &ALL {
            for slower in [1, 4] {
                let ticks = uno_held_ticks(pins.pins, slower, bridge);
                let most = most_ms[pins.pins.len() - 1] * TICK_HZ / 1000;
                assert!(ticks <= most, "{bridge:?}, {}, {slower} times the shortest period: {ticks} ticks", pins.name);
            }
        }
    }
}

/// Periods up to the longest one, 2^30 ticks, which need not be waited for.
#[test]
fn a_period_may_be_long() {
    let mut pair = Pair::new(&uno_setup(&[(9, 8)], 16), EXACT);
    let ticks = (1 << 23) + 12_345;
    let obeyed = pair.tell(&[(0, Verb::Speed { ticks }), (0, Verb::Move { steps: 3 })]).expect("it can");
    pair.advance(obeyed.tick + ticks + TICK_HZ / 10);
    pair.tell(&[(0, Verb::Speed { ticks: 1 << 30 })]).expect("it can");
    pair.advance(pair.uno.now() + TICK_HZ);
    let sooner = pair.tell(&[(0, Verb::Speed { ticks: 160_000 })]).expect("the third step need not wait so long");
    pair.advance(sooner.tick + TICK_HZ / 10);
    pair.compare();
    assert_eq!(
        pair.lab.steps.iter().map(|step| step.tick).collect::<Vec<_>>(),
        [obeyed.tick, obeyed.tick + ticks, sooner.tick]
    );
    let too_long = pair.uno.tell_motors(&[(0, Verb::Speed { ticks: (1 << 30) + 1 })]);
    assert!(matches!(too_long, Err(RemoteError::Refused { reason: Reason::Period, detail: 368, .. })), "{too_long:?}");
}

/// An immediate stop in the middle of moves: the count is the pins', moves that were not done are not told, and verbs begin again.
#[test]
fn a_stop_keeps_the_count() {
    let setup = uno_setup(ALL[6].pins, 16);
    for late in 0..12 {
        let mut pair = Pair::new(&setup, SOFTWARE);
        let orders = [(0, Verb::Move { steps: 20 }), (1, Verb::Run), (2, Verb::Move { steps: 1 }), (3, Verb::Run)];
        let first = pair.tell(&orders).expect("it can").tick;
        pair.advance(first + 10_000 * late);
        let stopped = pair.uno.stop_motors().expect("it stops").0.tick;
        pair.uno.advance(stopped + TICK_HZ / 50, &mut |edge: Edge| pair.lab.edges.push(edge));
        pair.uno.status().expect("it answers");
        assert_eq!(pair.uno.positions(), pair.lab.counts(&setup), "stopped {late}");
        let events = pair.uno.events().into_iter().filter(|event| event.cause == Cause::MoveDone);
        pair.done.extend(events.map(|event| (event.motor.into(), event.tick, event.detail)));
        let done = first + 16_000;
        assert_eq!(pair.done, if stopped >= done { vec![(2, done, 1)] } else { vec![] }, "stopped {late}");
        assert_eq!(refused(pair.uno.tell_motors(&[(0, Verb::Run)])), (Reason::NotArmed, 0));
        pair.uno.arm().expect("it can");
        let again = pair.uno.tell_motors(&[(0, Verb::Move { steps: 2 })]).expect("it can");
        pair.uno.advance(again.tick + TICK_HZ / 10, &mut |edge: Edge| pair.lab.edges.push(edge));
        pair.uno.status().expect("it answers");
        assert_eq!(pair.uno.positions(), pair.lab.counts(&setup), "restarted {late}");
    }
}

/// Moves at the shortest period, stopped around their last steps: of those that are told as done all steps were made.
#[test]
fn what_is_told_as_done_was_made() {
    /// So near their end, ticks, stops are looked for.
    const NEAR: u64 = 8000;
    for pins in [&ALL[1], &ALL[6]] {
        let setup = uno_setup(pins.pins, 16);
        let ticks = u64::from(verb_limits(&setup).shortest);
        let all =
            |verb: Verb| -> Vec<(u8, Verb)> { (0..setup.motors.len() as u8).map(|motor| (motor, verb)).collect() };
        let mut seen = [0, 0];
        // A stop comes with the next frame of USB: the moves' ends are what changes, around the millisecond that follows.
        let rounds = || (0..40_000).step_by(ticks as usize).map(|later| later / ticks);
        for (round, nudge) in
            [0, 400, 800, 1200].into_iter().flat_map(|nudge| rounds().map(move |round| (round, nudge)))
        {
            let steps = 1000 + round as u32;
            let mut pair = Pair::new(&setup, pins.timing);
            pair.tell(&all(Verb::Speed { ticks })).expect("it can");
            let first = pair.tell(&all(Verb::Move { steps })).expect("it can").tick;
            let end = first + u64::from(steps) * ticks;
            pair.advance(first + 1000 * ticks + 10_000 + nudge);
            let stopped = pair.uno.stop_motors().expect("it stops").0.tick;
            pair.advance(stopped + TICK_HZ / 50);
            pair.uno.status().expect("it answers");
            assert_eq!(pair.uno.positions(), pair.lab.counts(&setup), "{}, round {round}", pins.name);
            let is_done = stopped >= end;
            assert_eq!(pair.done.len(), if is_done { setup.motors.len() } else { 0 }, "{}, round {round}", pins.name);
            for (motor, tick, number) in &pair.done {
                assert_eq!((*tick, *number), (end, 1), "{}, round {round}", pins.name);
                assert_eq!(pair.uno.positions()[*motor], i64::from(steps), "{}, round {round}", pins.name);
            }
            seen[usize::from(is_done)] += u32::from(stopped.abs_diff(end) < NEAR);
        }
        println!("{}: stopped {seen:?} times just before and after the end", pins.name);
        assert!(seen[0] >= 4 && seen[1] >= 4, "{}: {seen:?}", pins.name);
    }
}

/// A host that is gone: with Bye moves go on to their end and runs stop; one that is lost leaves nothing that moves. The drivers are
/// released a while after either.
#[test]
fn who_is_left_alone_stops() {
    let setup = Setup { enable: Some((8, false)), idle_ms: Some(200), ..uno_setup(ALL[5].pins, 16) };
    for says_bye in [true, false] {
        let mut pair = Pair::new(&setup, SOFTWARE);
        let orders =
            [(0, Verb::Run), (1, Verb::Move { steps: 30_000 }), (2, Verb::Move { steps: 20_000 }), (2, Verb::Run)];
        pair.tell(&[0, 1, 2].map(|motor| (motor, Verb::Speed { ticks: 2000 }))).expect("it can");
        let first = pair.tell(&orders).expect("it can").tick;
        pair.advance(first + TICK_HZ / 50);
        let (mut heard, mut edges) = (Vec::new(), std::mem::take(&mut pair.lab.edges));
        let mut port = if says_bye { pair.uno.close() } else { pair.uno.port().clone() };
        let until = port.now() + Duration::from_secs(5);
        while port.now() < until {
            port.receive(until, &mut heard).expect("a virtual port");
        }
        port.edges(&mut edges);
        let last = |pin: u8| edges.iter().filter(|edge| edge.line == pin && edge.level).map(|edge| edge.tick).max();
        let stops = [2, 3, 4].map(|pin| (last(pin).expect("it moved") - first) as f64 / TICK_HZ as f64);
        if says_bye {
            assert!(stops[0] < 0.1, "{stops:?}");
            // Pins are a microsecond after the ticks.
            for (stop, steps) in [(stops[1], 29_999), (stops[2], 19_999)] {
                assert!((stop - f64::from(steps) * 2000.0 / TICK_HZ as f64).abs() < 5e-6, "{stops:?}");
            }
        } else {
            // Two seconds of silence (of 1.024 ms to the link's ms), and what was worked out.
            assert!(stops.iter().all(|stop| (2.0..2.15).contains(stop)), "{stops:?}");
        }
        let last_step = stops.iter().fold(0.0, |last: f64, stop| last.max(*stop));
        let released = edges.iter().rev().find(|edge| edge.line == 8).expect("they were on");
        let held = (released.tick - first) as f64 / TICK_HZ as f64 - last_step;
        // Of 1.024 ms to the board's ms; looked at every four of those, when the last period is over and what was worked out is played.
        assert!(released.level && (0.2..0.22).contains(&held), "released after {held} s, says Bye: {says_bye}");
        Port::set_baud(&mut port, Baud::B115200).expect("a virtual port");
        let mut next = Remote::open(port, 2).expect("nobody has it");
        assert!(next.status().expect("it answers").is_idle());
        let stack_left = next.measures(false).expect("it answers").stack_left;
        println!("{stack_left} bytes of stack left");
        assert!(stack_left > 0);
        let lost = next.info().last_stop == Cause::HostLost;
        assert_eq!(lost, !says_bye);
        next.configure(&setup).expect("it rests");
    }
}

fn refused<T: std::fmt::Debug>(result: Result<T, RemoteError>) -> (Reason, u16) {
    match result {
        Err(RemoteError::Refused { reason, detail, .. }) => (reason, detail),
        other => panic!("{other:?}"),
    }
}

#[test]
fn what_cannot_be_is_refused() {
    let mut pair = Pair::new(&uno_setup(ALL[3].pins, 16), SOFTWARE);
    let uno = &mut pair.uno;
    let obeyed = uno.tell_motors(&[(0, Verb::Move { steps: 3 }), (1, Verb::Run)]).expect("they rest");
    assert_eq!(obeyed.motors()[0].position, 0);
    assert_eq!(refused(uno.release()), (Reason::Moving, 0));
    for (orders, reason, detail) in [
        (vec![(2, Verb::Run)], Reason::NoSuchMotor, 2),
        (vec![(0, Verb::Halt), (1, Verb::Speed { ticks: 735 })], Reason::Period, 736),
        (vec![(0, Verb::Run), (1, Verb::Move { steps: 5 }), (1, Verb::Run), (1, Verb::Run)], Reason::Busy, 1),
    ] {
        assert_eq!(refused(uno.tell_motors(&orders)), (reason, detail));
    }
    let seven = [(0, Verb::Halt); 7];
    assert_eq!(uno.tell_motors(&seven), Err(RemoteError::TooManyOrders { orders: 7, most: 6 }));
    // This image takes no plans.
    assert!(uno.switch(Epoch(2), uno.now() + TICK_HZ / 10, Lease::Last, &[]).is_err());
    assert_eq!(uno.error().cloned().map(|error| refused::<()>(Err(error)).0), Some(Reason::UnknownKind));
}

#[test]
fn who_cannot_obey_says_so() {
    let mut plain = Remote::open(VirtualUno::new(), 1).expect("it answers");
    assert_eq!(plain.obeys(), Ok(false));
    plain.configure(&uno_setup(&[(9, 8)], 16)).expect("it can");
    let said = plain.tell_motors(&[(0, Verb::Run)]).expect_err("it knows no verbs").to_string();
    assert!(said.contains("pulsetrain flash uno --port PORT --image verbs"), "{said}");
    let mut uno = Remote::open(VirtualUno::with_verbs(), 1).expect("it answers");
    assert_eq!(uno.obeys(), Ok(true));
    assert_eq!(refused(uno.configure(&uno_setup(&[(9, 8), (10, 8)], 16))), (Reason::SharedDir, 0));
    uno.configure(&uno_setup(&[(8, 9)], 32)).expect("it can");
    assert_eq!(refused(uno.tell_motors(&[(0, Verb::Run)])), (Reason::Timing, 31));
}
