//! Motors of a Pico that are told directly: the edges of the native board, all of them, tick for tick, on random live scripts.

use pulsetrain_board::native_verbs::NativeVerbs;
use pulsetrain_board::virtual_pico::VirtualPico;
use pulsetrain_board::{Board, Edge, Faults, Lease, Leased, Port, Remote, RemoteError, Setup};
use pulsetrain_core::output::Sequence;
use pulsetrain_core::verbs::{Heading, MotorTiming, Verb};
use pulsetrain_core::wire::message::{Cause, MotorSetup, Reason, flags};
use pulsetrain_core::wire::orders::{Obeyed, Orders, order};
use pulsetrain_core::wire::{Baud, MAX_MOTORS};
use pulsetrain_core::{Entry, Epoch, Item, Tick32};
use pulsetrain_testkit::Random;
use pulsetrain_testkit::pico::{TICK_HZ, as_line, coils, native_config, overhead, step_dir};
use pulsetrain_testkit::seed::seeds;
use std::time::Duration;

/// What the firmware lets a motor be told: docs/verbs.md.
fn limits(setup: &Setup, motor: &MotorSetup) -> MotorTiming {
    let (work, least) = (if motor.coils().is_some() { 1000 } else { 125 }, overhead(setup, motor) + 1);
    let shortest = (work * setup.motors.len() as u32).max(least);
    let pulse = u32::from(setup.pulse_ticks).max(3);
    let turn = (pulse + u32::from(setup.hold_ticks)).max(least - 1) + u32::from(setup.setup_ticks).max(pulse + 3);
    let turn = if motor.coils().is_some() { shortest } else { turn.max(shortest) };
    MotorTiming { shortest, turn, period: shortest.max(125_000) }
}

/// A virtual Pico and a native board that is told what the Pico obeyed.
struct Pair {
    setup: Setup,
    pico: Remote<VirtualPico>,
    native: NativeVerbs,
    edges: Vec<Edge>,
    wanted: Vec<Edge>,
    /// Moves that were done: motor, tick, number.
    done: Vec<(usize, u64, u32)>,
}

impl Pair {
    fn new(setup: &Setup) -> Pair {
        let mut pico = Remote::open(VirtualPico::new(), 1).expect("it answers");
        assert_eq!(pico.set_baud(Baud::B2M), Ok(Baud::B2M));
        pico.configure(setup).unwrap_or_else(|error| panic!("{error}: {setup:?}"));
        let soon = pico.now() + TICK_HZ / 1000;
        pico.advance(soon, &mut |_: Edge| {});
        let limits: Vec<_> = setup.motors.iter().map(|motor| limits(setup, motor)).collect();
        let native = NativeVerbs::new(&native_config(setup), &limits).expect("a native board can do it");
        let (edges, wanted, done) = (Vec::new(), Vec::new(), Vec::new());
        Pair { setup: setup.clone(), pico, native, edges, wanted, done }
    }

    /// Tells both; the native board what the Pico did, from the same tick on.
    fn tell(&mut self, orders: &[(u8, Verb)]) -> Result<Obeyed, RemoteError> {
        let obeyed = self.pico.tell_motors(orders)?;
        let bytes: Vec<u8> = orders.iter().flat_map(|(motor, verb)| order(*motor, *verb)).collect();
        if let Some(last) = obeyed.tick.checked_sub(TICK_HZ / 100).filter(|last| *last > self.native.now()) {
            // Edges that nothing can change any more, so that its queues have room.
            self.native.advance(last, &mut |edge: Edge| self.wanted.push(edge));
        }
        let wanted = self.native.obey(obeyed.tick, &Orders::decode(&bytes).expect("orders"));
        assert_eq!(Ok(obeyed), wanted, "{orders:?}");
        Ok(obeyed)
    }

    fn advance(&mut self, until: u64) {
        let Pair { setup, pico, edges, .. } = self;
        pico.advance(until, &mut |edge: Edge| edges.extend(as_line(setup, edge)));
        for event in self.pico.events() {
            match event.cause {
                Cause::MoveDone => self.done.push((event.motor.into(), event.tick, event.detail)),
                Cause::Finished => {}
                _ => panic!("{event:?}"),
            }
        }
    }

    /// Compares all edges before now, and the moves that were done.
    fn compare(&mut self) {
        let until = self.pico.now() - TICK_HZ / 1000;
        self.native.advance(until, &mut |edge: Edge| self.wanted.push(edge));
        for edges in [&mut self.edges, &mut self.wanted] {
            edges.retain(|edge| edge.tick <= until);
            edges.sort_by_key(|edge| (edge.tick, edge.line));
        }
        let differ = self.edges.iter().zip(&self.wanted).position(|(got, wanted)| got != wanted);
        let around = differ.map(|at| (&self.edges[at.saturating_sub(2)..=at], &self.wanted[at]));
        assert!(differ.is_none(), "edge {differ:?}: {around:?}; {:?}", self.setup);
        assert_eq!(self.edges.len(), self.wanted.len());
        for motor in 0..self.setup.motors.len() {
            let of = |(index, ..): &&(usize, u64, u32)| *index == motor;
            let told: Vec<_> = self.done.iter().filter(of).copied().collect();
            assert!(told.is_sorted_by_key(|(_, tick, _)| *tick), "{told:?}");
            assert!(told.iter().map(|(.., number)| *number).eq(1..=told.len() as u32), "{told:?}");
        }
        let done = self.native.events().into_iter().filter(|event| event.cause == Cause::MoveDone);
        let mut wanted: Vec<_> = done.map(|event| (event.motor.into(), event.tick, event.detail)).collect();
        for done in [&mut self.done, &mut wanted] {
            done.retain(|(_, tick, _)| *tick <= until);
            done.sort_unstable();
        }
        assert_eq!(self.done, wanted);
        for motor in self.setup.motors.iter().filter(|motor| motor.coils().is_none()) {
            self.compare_dir(motor);
        }
        assert_eq!(self.pico.error(), None);
        for motor in 0..self.setup.motors.len() {
            assert_eq!(self.pico.faults(motor), Faults::default());
        }
    }
}

impl Pair {
    /// The driver's own times around each turn: DIR stays for a hold after a pulse, and is there for a set-up before the next.
    fn compare_dir(&self, motor: &MotorSetup) {
        let Setup { setup_ticks, hold_ticks, .. } = self.setup;
        let (mut turned, mut fallen) = (None, None);
        for edge in &self.edges {
            if edge.line == motor.dir_pin {
                turned = Some(edge.tick);
                let held = fallen.map_or(u64::MAX, |fallen| edge.tick - fallen);
                assert!(held >= hold_ticks.into(), "DIR turns {held} ticks after a pulse, {edge:?}; {:?}", self.setup);
            } else if edge.line == motor.step_pin && edge.level {
                let before = turned.map_or(u64::MAX, |turned| edge.tick - turned);
                assert!(
                    before >= setup_ticks.into(),
                    "DIR turns {before} ticks before a step, {edge:?}; {:?}",
                    self.setup
                );
            } else if edge.line == motor.step_pin {
                fallen = Some(edge.tick);
            }
        }
    }
}

fn drivers(count: u8) -> Setup {
    let motors = (0..count).map(|motor| step_dir(2 + 2 * motor)).collect();
    Setup { pulse_ticks: 250, setup_ticks: 625, hold_ticks: 250, motors, ..Setup::default() }
}

/// One move: exactly its steps, from the tick that the answer says, a period apart; done a period after the last.
#[test]
fn moves_have_exactly_their_steps() {
    for (steps, ticks) in [(0, 5000), (1, 5000), (2, 125_000), (8, 12_500), (100, 7001), (2000, 2500), (70_000, 254)] {
        let mut pair = Pair::new(&drivers(1));
        let obeyed = pair.tell(&[(0, Verb::Speed { ticks }), (0, Verb::Move { steps })]).expect("it can");
        let first = obeyed.tick;
        pair.advance(first + u64::from(steps) * ticks + TICK_HZ / 100);
        let rises: Vec<_> =
            pair.edges.iter().filter(|edge| edge.line == 2 && edge.level).map(|edge| edge.tick).collect();
        let wanted: Vec<_> = (0..u64::from(steps)).map(|step| first + step * ticks).collect();
        assert_eq!(rises, wanted, "{steps} steps");
        let done = if steps == 0 { first } else { first + u64::from(steps) * ticks };
        assert_eq!(pair.done, [(0, done, 1)]);
        assert!(pair.pico.status().expect("it answers").is_idle());
        pair.compare();
    }
}

/// Moves whose lengths are around a motor's turn with the words (512), the ring (2048), and 16 bits, one after the other, so that
/// each begins somewhere else in the ring.
#[test]
fn moves_across_turns_and_rings_have_exactly_their_steps() {
    let mut pair = Pair::new(&drivers(2));
    let mut begun = 0;
    pair.tell(&[(0, Verb::Speed { ticks: 260 }), (1, Verb::Speed { ticks: 300 })]).expect("it can");
    for around in [512, 1024, 2048, 4096, 65_536] {
        for steps in around - 2..=around + 2 {
            let orders = [(0, Verb::Move { steps }), (1, Verb::Move { steps })];
            let first = pair.tell(&orders).expect("it can").tick;
            pair.advance(first + u64::from(steps) * 300 + TICK_HZ / 100);
            for (pin, ticks) in [(2, 260), (4, 300)] {
                let rises = pair.edges.iter().filter(|edge| edge.line == pin && edge.level && edge.tick >= first);
                let wanted = (0..u64::from(steps)).map(|step| first + step * ticks);
                assert!(rises.map(|edge| edge.tick).eq(wanted), "{steps} steps of pin {pin}");
            }
            begun += steps;
        }
    }
    pair.compare();
    pair.pico.status().expect("it answers");
    assert_eq!(pair.pico.positions(), [i64::from(begun); 2]);
}

/// Motors of all kinds, and times of all kinds.
fn random_setup(kind: u64, random: &mut Random) -> Setup {
    let sequence = |random: &mut Random| [Sequence::Wave, Sequence::Full, Sequence::Half][random.below(3) as usize];
    let mut motors: Vec<_> = match kind {
        0 => vec![step_dir(2)],
        1 => vec![coils(2, Sequence::Half), coils(6, Sequence::Half)],
        2 => (0..MAX_MOTORS as u8).map(|motor| step_dir(2 + 2 * motor)).collect(),
        3 => (0..4).map(|motor| coils(2 + 4 * motor, sequence(random))).collect(),
        _ => vec![step_dir(2), coils(4, sequence(random)), step_dir(10), step_dir(27), coils(19, sequence(random))],
    };
    for motor in motors.iter_mut().filter(|motor| motor.coils().is_none()) {
        (motor.forward_high, motor.step_low) = (random.one_in(2), random.one_in(2));
    }
    Setup {
        pulse_ticks: [0, 13, 125, 250, 1250][random.below(5) as usize],
        setup_ticks: random.below(2000) as u16,
        hold_ticks: random.below(2000) as u16,
        idle_ms: random.one_in(2).then(|| random.between(1, 40) as u16),
        motors,
        ..Setup::default()
    }
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

/// A random live script; how many edges there were.
fn random_script(kind: u64, seed: u64) -> usize {
    let random = &mut Random::new(seed.wrapping_add(1000 * kind));
    let mut pair = Pair::new(&random_setup(kind, random));
    for _ in 0..random.between(10, 40) {
        let orders: Vec<_> = (0..random.between(1, 9))
            .map(|_| {
                let motor = random.below(pair.setup.motors.len() as u64) as u8;
                (motor, random_verb(&limits(&pair.setup, &pair.setup.motors[usize::from(motor)]), random))
            })
            .collect();
        match pair.tell(&orders) {
            Ok(_) | Err(RemoteError::Refused { reason: Reason::Busy, .. }) => {}
            Err(error) => panic!("{error}: {orders:?}"),
        }
        pair.advance(pair.pico.now() + random.below(TICK_HZ / 50));
    }
    // To rest: whatever is under way ends.
    let halts: Vec<_> = (0..pair.setup.motors.len() as u8).map(|motor| (motor, Verb::Halt)).collect();
    pair.tell(&halts).expect("always");
    pair.advance(pair.pico.now() + TICK_HZ / 10);
    pair.compare();
    assert!(pair.pico.status().expect("it answers").is_idle());
    assert_eq!(pair.pico.positions(), pair.native.positions());
    pair.edges.len()
}

#[test]
fn random_live_scripts() {
    for kind in 0..5 {
        let mut edges = 0;
        for seed in seeds(0, 2) {
            println!("kind {kind}, seed {seed}");
            edges += random_script(kind, seed);
        }
        assert!(edges > 500, "kind {kind}: {edges} edges");
    }
}

/// What docs/verbs.md promises as the shortest periods: all motors at once, all changing direction now and then.
#[test]
fn the_shortest_periods_hold() {
    let coils: Vec<_> = (0..6).map(|motor| coils(2 + 4 * motor, Sequence::Half)).collect();
    let short = Setup { pulse_ticks: 3, setup_ticks: 6, hold_ticks: 3, ..drivers(1) };
    for setup in [short, drivers(1), drivers(4), drivers(8), Setup { motors: coils, ..Setup::default() }] {
        let mut pair = Pair::new(&setup);
        let all = |verb: &dyn Fn(&MotorSetup) -> Verb| -> Vec<(u8, Verb)> {
            (0..).zip(&setup.motors).map(|(number, motor)| (number, verb(motor))).collect()
        };
        pair.tell(&all(&|motor| Verb::Speed { ticks: limits(&setup, motor).shortest.into() })).expect("it can");
        pair.tell(&all(&|_| Verb::Run)).expect("it can");
        for turn in 0..6 {
            pair.advance(pair.pico.now() + TICK_HZ / 50);
            let course = if turn % 2 == 0 { Heading::Backward } else { Heading::Forward };
            pair.tell(&all(&|_| Verb::Heading(course))).expect("it can");
        }
        pair.tell(&all(&|_| Verb::Halt)).expect("it can");
        pair.advance(pair.pico.now() + TICK_HZ / 50);
        pair.compare();
        assert!(pair.pico.status().expect("it answers").is_idle());
        assert_eq!(pair.pico.positions(), pair.native.positions());
        let fastest = setup.motors.iter().map(|motor| limits(&setup, motor).shortest).min().expect("motors");
        let least = TICK_HZ / 10 / u64::from(fastest) * setup.motors.len() as u64;
        assert!(pair.edges.len() as u64 > least, "{} edges, {least}", pair.edges.len());
    }
}

/// SPEED and DIRECTION show within six steps or 2 ms, whichever is longer.
#[test]
fn what_is_told_shows_soon() {
    for (rate, times) in [(100, 4), (1000, 12), (10_000, 30), (100_000, 30)] {
        for turns in [false, true] {
            let delay = pulsetrain_testkit::delays::delay(rate, turns, times);
            println!("{rate} steps/s, turns {turns}: {delay:?}");
            assert!(delay.is_kept(), "{rate} steps/s, turns {turns}: {delay:?}");
            // What docs/verbs.md says of the tick, and a while to be read.
            assert!(delay.held_us <= 1500.0, "{delay:?}");
        }
    }
}

/// A period beyond what an interval of a segment has, and beyond where moments are told apart, 17 s: to the tick, too.
#[test]
fn a_period_may_be_long() {
    let mut pair = Pair::new(&drivers(1));
    let ticks = (1 << 31) + 12_345;
    let obeyed = pair.tell(&[(0, Verb::Speed { ticks }), (0, Verb::Move { steps: 3 })]).expect("it can");
    pair.advance(obeyed.tick + ticks + TICK_HZ / 10);
    // The third one need not wait so long.
    let sooner = pair.tell(&[(0, Verb::Speed { ticks: 125_000 })]).expect("it can");
    pair.advance(sooner.tick + TICK_HZ / 10);
    let rises: Vec<_> = pair.edges.iter().filter(|edge| edge.line == 2 && edge.level).map(|edge| edge.tick).collect();
    assert_eq!(rises, [obeyed.tick, obeyed.tick + ticks, sooner.tick]);
    assert_eq!(pair.done, [(0, sooner.tick + 125_000, 1)]);
    pair.compare();
}

/// Short moves in a row, on a line that is slower than they are done: each that is obeyed is told, with its number.
#[test]
fn short_moves_in_a_row_are_all_told() {
    let mut pair = Pair::new(&drivers(4));
    assert_eq!(pair.pico.set_baud(Baud::B115200), Ok(Baud::B115200));
    let all = |verb| [0, 1, 2, 3].map(|motor| (motor, verb));
    pair.tell(&all(Verb::Speed { ticks: 1000 })).expect("it can");
    let (mut moves, mut refused) = (0, 0);
    for _ in 0..200 {
        match pair.tell(&[0, 0, 1, 1, 2, 2, 3, 3].map(|motor| (motor, Verb::Move { steps: 1 }))) {
            Ok(_) => moves += 2,
            Err(RemoteError::Refused { reason: Reason::Busy, .. }) => refused += 1,
            Err(error) => panic!("{error}"),
        }
    }
    pair.advance(pair.pico.now() + TICK_HZ / 2);
    pair.compare();
    assert_eq!(pair.done.len(), 4 * moves);
    assert!(moves > 10 && refused > 10, "{moves} {refused}");
}

/// A board that says that it rests has told of all moves: not before the last period is over. Who releases the motors then misses
/// nothing.
#[test]
fn rest_comes_after_the_last_period() {
    let mut pair = Pair::new(&drivers(1));
    for part in 0..16 {
        let ticks = 1_250_000 + 17_389 * part;
        let first = pair.tell(&[(0, Verb::Speed { ticks }), (0, Verb::Move { steps: 2 })]).expect("it can").tick;
        let done = first + 2 * ticks;
        pair.advance(done - TICK_HZ / 500);
        let status = loop {
            let status = pair.pico.status().expect("it answers");
            if status.is_idle() {
                break status;
            }
        };
        assert!(status.head.tick >= done, "at rest {} ticks before the move is done", done - status.head.tick);
        pair.pico.release().expect("it rests");
        pair.pico.advance(pair.pico.now() + TICK_HZ / 100, &mut |_: Edge| {});
        let events: Vec<_> = pair.pico.events().into_iter().map(|event| (event.cause, event.tick)).collect();
        let [(Cause::MoveDone, told), (Cause::Finished, finished)] = events[..] else { panic!("{events:?}") };
        assert!(told == done && finished >= done, "{events:?}, {done}");
        pair.pico.arm().expect("it rests");
    }
}

/// A new host at the port of one that is gone.
fn next_host(mut port: VirtualPico) -> Remote<VirtualPico> {
    port.set_baud(Baud::B115200).expect("a virtual port");
    Remote::open(port, 2).expect("nobody has it")
}

/// Bit by motor: stopped faster than it can.
fn uncertain(pico: &mut Remote<VirtualPico>) -> u8 {
    let status = pico.status().expect("it answers");
    let flagged = status.motors.as_slice().iter().map(|motor| u8::from(motor.faults & flags::UNCERTAIN != 0));
    (0..).zip(flagged).fold(0, |all, (motor, flag)| all | flag << motor)
}

/// A host that is gone: with Bye moves go on to their end and runs stop; one that is lost leaves nothing that moves. Motors that were
/// faster than they can stop are flagged.
#[test]
fn who_is_left_alone_stops() {
    for says_bye in [true, false] {
        let mut pair = Pair::new(&drivers(3));
        // The third has a run behind its move.
        let orders = [(0, Verb::Run), (1, Verb::Move { steps: 4000 }), (2, Verb::Move { steps: 3000 }), (2, Verb::Run)];
        let obeyed = pair.tell(&orders).expect("it can");
        pair.advance(obeyed.tick + TICK_HZ / 50);
        let (mut heard, mut edges) = (Vec::new(), std::mem::take(&mut pair.edges));
        let mut port = if says_bye { pair.pico.close() } else { pair.pico.port().clone() };
        let until = port.now() + Duration::from_secs(5);
        while port.now() < until {
            port.receive(until, &mut heard).expect("a virtual port");
        }
        port.edges(&mut edges);
        let last = |pin: u8| {
            let rises = edges.iter().filter(|edge| edge.line == pin && edge.level && edge.tick >= obeyed.tick);
            rises.map(|edge| edge.tick - obeyed.tick).max().expect("it moved") as f64 / TICK_HZ as f64
        };
        let stops = [last(2), last(4), last(6)];
        if says_bye {
            assert!(stops[0] < 0.1, "{stops:?}");
            assert!((stops[1] - 3.999).abs() < 1e-9 && (stops[2] - 2.999).abs() < 1e-9, "{stops:?}");
        } else {
            // Two seconds of silence (of 1.049 ms to the link's ms), and what was worked out.
            assert!(stops.iter().all(|stop| (2.0..2.15).contains(stop)), "{stops:?}");
        }
        let mut next = next_host(port);
        assert_eq!(uncertain(&mut next), if says_bye { 0b001 } else { 0b111 });
        next.configure(&drivers(3)).expect("it rests");
        assert_eq!(uncertain(&mut next), 0);
    }
}

/// A move that was done before a stop is told, however soon motors are armed and told anew; one that was not done is not.
#[test]
fn what_was_done_is_told_after_a_new_beginning() {
    let period = 12_500;
    let mut before = 0;
    for late in 0..16 {
        let Pair { mut pico, .. } = Pair::new(&drivers(1));
        let obeyed =
            pico.tell_motors(&[(0, Verb::Speed { ticks: period }), (0, Verb::Move { steps: 1 })]).expect("it can");
        let done = obeyed.tick + period;
        pico.advance(done - TICK_HZ / 1000 + late * TICK_HZ / 10_000, &mut |_: Edge| {});
        let (stopped, _) = pico.stop_motors().expect("it stops");
        pico.arm().expect("it can");
        let obeyed =
            pico.tell_motors(&[(0, Verb::Speed { ticks: period }), (0, Verb::Move { steps: 1 })]).expect("it can");
        pico.advance(pico.now() + TICK_HZ / 100, &mut |_: Edge| {});
        let told = pico.events().into_iter().filter(|event| event.cause == Cause::MoveDone);
        let mut wanted = vec![(obeyed.tick + period, 1)];
        if stopped.tick >= done {
            wanted.insert(0, (done, 1));
            before += 1;
        }
        assert_eq!(told.map(|event| (event.tick, event.detail)).collect::<Vec<_>>(), wanted, "{late}");
    }
    assert!((1..16).contains(&before), "{before} of them were done before the stop");
}

/// A move that goes on after Bye is stopped by the next host, which knows nothing of it, if it wants that.
#[test]
fn the_next_host_may_stop_what_goes_on() {
    let mut pair = Pair::new(&drivers(2));
    let period = 12_500;
    pair.tell(&[(0, Verb::Speed { ticks: period }), (0, Verb::Move { steps: u32::MAX })]).expect("it can");
    pair.advance(pair.pico.now() + TICK_HZ / 50);
    let mut next = next_host(pair.pico.close());
    assert!(!next.status().expect("it answers").is_idle());
    let (stopped, positions) = next.stop_motors().expect("it stops");
    assert_eq!(stopped.uncertain, 0b01, "it was faster than its pull-in");
    let [moved, 0] = positions[..] else { panic!("{positions:?}") };
    assert!(moved > 200, "{moved}");
    let mut rises = 0;
    next.advance(next.now() + TICK_HZ / 50, &mut |edge: Edge| {
        rises += u32::from(edge.line == 2 && edge.level && edge.tick > stopped.tick)
    });
    assert_eq!(rises, 0);
    assert_eq!(uncertain(&mut next), 0b01);
    assert_eq!(i64::from(next.status().expect("it answers").motors.as_slice()[0].position), moved);
}

/// Moves that go on after Bye are done for nobody: the next host is told of its own alone, whose numbers go on.
#[test]
fn moves_of_a_host_that_left_are_not_told_to_the_next() {
    let mut pair = Pair::new(&drivers(2));
    let period = 125_000;
    let go = |steps| Verb::Move { steps };
    // The second motor's are still under way, and one waits, when the next host speaks.
    let orders = [(0, go(5)), (1, Verb::Speed { ticks: period }), (1, go(40)), (1, go(20))];
    pair.tell(&orders).expect("it can");
    let mut next = next_host(pair.pico.close());
    next.advance(next.now() + TICK_HZ / 20, &mut |_: Edge| {});
    let obeyed = next.tell_motors(&[(0, go(3))]).expect("it can");
    next.advance(next.now() + TICK_HZ / 20, &mut |_: Edge| {});
    next.tell_motors(&[(1, go(1))]).expect("both are done");
    next.advance(next.now() + TICK_HZ / 50, &mut |_: Edge| {});
    let told = next.events().into_iter().filter(|event| event.cause == Cause::MoveDone);
    let told: Vec<_> = told.map(|event| (event.motor, event.tick, event.detail)).collect();
    let [(0, done, 2), (1, _, 3)] = told[..] else { panic!("{told:?}") };
    assert_eq!(done, obeyed.tick + 3 * period);
    assert_eq!(next.status().expect("it answers").motors.as_slice()[1].position, 61);
}

/// A move that waits for a way to go waits for nobody when its host is gone: the next one can have the board.
#[test]
fn who_waits_for_a_way_to_go_is_forgotten() {
    let mut pair = Pair::new(&drivers(2));
    let stands = Verb::Heading(Heading::Stationary);
    pair.tell(&[(0, stands), (0, Verb::Move { steps: 5 }), (1, stands), (1, Verb::Run)]).expect("it can");
    pair.advance(pair.pico.now() + TICK_HZ / 50);
    let mut next = next_host(pair.pico.close());
    assert_eq!(uncertain(&mut next), 0, "they stood");
    next.configure(&drivers(2)).expect("it rests");
    assert_eq!(next.positions(), [0, 0]);
}

/// Orders that are refused, and questions, leave armed motors as they are: a plan that is being sent goes on.
#[test]
fn a_first_order_that_does_nothing_changes_nothing() {
    let mut pair = Pair::new(&drivers(1));
    let pico = &mut pair.pico;
    let from = pico.now() + pico.round_trip() + TICK_HZ / 10;
    let push = |pico: &mut Remote<VirtualPico>, item| pico.push(0, Entry { epoch: Epoch(1), item }).expect("room");
    push(pico, Item::Anchor { tick: Tick32::of(from) });
    let refused = pico.tell_motors(&[(0, Verb::Speed { ticks: 3 })]).expect_err("too short");
    assert!(matches!(refused, RemoteError::Refused { reason: Reason::Period, detail: 254, .. }), "{refused}");
    assert_eq!(pico.tell_motors(&[]).expect("a question").motors()[0].position, 0);
    push(pico, pulsetrain_testkit::pico::run(500, 12_500, pulsetrain_core::Direction::Forward));
    pico.switch(Epoch(1), from, Lease::Last, &[]).expect("in time");
    let mut rises = 0;
    pico.advance(from + TICK_HZ / 10, &mut |edge: Edge| rises += u32::from(edge.line == 2 && edge.level));
    // What the host knows is up to 50 ms old.
    pico.status().expect("it answers");
    assert_eq!((rises, pico.positions(), pico.error()), (500, vec![500], None));
}

/// What docs/verbs.md says of the tick from which on the first order holds, to motors that were armed long before: 3.6 ms after it came.
#[test]
fn the_first_order_holds_later() {
    let mut latest = 0.0_f64;
    for part in 0..24 {
        let mut pair = Pair::new(&drivers(1));
        pair.pico.advance(pair.pico.now() + TICK_HZ / 100 + part * 12_345, &mut |_: Edge| {});
        let (sent, obeyed) = pulsetrain_testkit::delays::tell(&mut pair.pico, &[(0, Verb::Run)]);
        latest = latest.max(pulsetrain_testkit::delays::us(obeyed.tick, sent));
    }
    println!("at most {latest} µs");
    assert!((2400.0..=3600.0).contains(&latest), "{latest} µs");
}

/// A plan and verbs do not mix, and each says so.
#[test]
fn plans_and_verbs_keep_apart() {
    let mut pair = Pair::new(&drivers(2));
    let refused = |error: RemoteError| match error {
        RemoteError::Refused { reason, detail, .. } => (reason, detail),
        error => panic!("{error}"),
    };
    // Motors that a plan moves.
    let pico = &mut pair.pico;
    let from = pico.now() + pico.round_trip() + TICK_HZ / 100;
    for item in [
        Item::Anchor { tick: Tick32::of(from) },
        pulsetrain_testkit::pico::run(500, 12_500, pulsetrain_core::Direction::Forward),
    ] {
        pico.push(0, Entry { epoch: Epoch(1), item }).expect("room");
    }
    pico.switch(Epoch(1), from, Lease::Last, &[]).expect("in time");
    assert_eq!(refused(pico.tell_motors(&[(0, Verb::Run)]).expect_err("a plan is under way")), (Reason::Moving, 0));
    pico.advance(from + TICK_HZ / 10, &mut |_: Edge| {});
    // Where the plan has left them, verbs go on.
    let obeyed = pico.tell_motors(&[(0, Verb::Move { steps: 3 }), (1, Verb::Run)]).expect("they rest");
    assert_eq!(obeyed.motors()[0].position, 500);
    assert_eq!(refused(pico.release().expect_err("they move")), (Reason::Moving, 0));
    for (orders, reason, detail) in [
        (vec![(2, Verb::Run)], Reason::NoSuchMotor, 2),
        (vec![(0, Verb::Halt), (1, Verb::Speed { ticks: 253 })], Reason::Period, 254),
        (vec![(0, Verb::Run), (1, Verb::Move { steps: 5 }), (1, Verb::Run), (1, Verb::Run)], Reason::Busy, 1),
    ] {
        assert_eq!(refused(pico.tell_motors(&orders).expect_err("it cannot be")), (reason, detail));
    }
    pico.push(0, Entry { epoch: Epoch(2), item: Item::Anchor { tick: Tick32(0) } }).expect("the host knows no better");
    pico.advance(pico.now() + TICK_HZ / 10, &mut |_: Edge| {});
    assert!(pico.switch(Epoch(2), pico.now() + TICK_HZ / 10, Lease::Last, &[]).is_err());
    assert_eq!(pico.error().cloned().map(refused).map(|(reason, _)| reason), Some(Reason::Obeying));
}
