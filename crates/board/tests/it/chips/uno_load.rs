//! Records that no planner packs, on the emulated chip: the firmware's loader, in assembly, reads what core reads and refuses what core
//! refuses, whatever the bytes; and a board that finds such a record makes the steps before it, and moves no other pin.
//!
//! `PULSETRAIN_SEED` says other random bytes, `PULSETRAIN_ROUNDS` how many times as many.

use pulsetrain_board::virtual_uno::{self, VirtualUno};
use pulsetrain_board::{Board, Edge, Lease, Leased, Native, Port, PortError, Remote, Setup, WithReference};
use pulsetrain_core::avr::Registers;
use pulsetrain_core::packing::{CHECK_LEN, Check, MAX_PACKED_LEN, Packing, State};
use pulsetrain_core::wire::frame::{Decoder, Received};
use pulsetrain_core::wire::message::{Cause, kind};
use pulsetrain_core::wire::{Baud, Encoder, MAX_FRAME};
use pulsetrain_core::{Direction, Entry, Epoch, Item, Segment, Tick32};
use pulsetrain_testkit::lab::{EXACT, Lab, SOFTWARE, SYMBOLS, Timing, address};
use pulsetrain_testkit::seed::{rounds, seed};
use pulsetrain_testkit::{Random, TICK_HZ, native_config, uno_setup};
use std::time::Duration;

/// What is read next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Read {
    /// All has been.
    Nothing,
    /// A record, and the steps that it has.
    Record(Option<Segment>),
    /// None that can be obeyed.
    Refused(Cause),
}

/// What a motor's records say, by core: the loader's answers.
#[derive(Clone, Debug)]
struct Model {
    packing: Packing,
    state: State,
    /// Its accumulator.
    registers: Registers,
    anchored: bool,
    position: i32,
    origin: u16,
}

impl Model {
    fn new(gain: i8) -> Model {
        Model {
            packing: Packing { fraction_bits: 16, gain },
            state: State::default(),
            registers: Registers::new(),
            anchored: false,
            position: 0,
            origin: 0,
        }
    }

    /// The check that is right here.
    fn check(&self) -> Check {
        let Registers { tick, fraction, .. } = self.registers;
        Check { position: (self.position as u16).wrapping_sub(self.origin), tick: Tick32(tick), fraction }
    }

    /// The next record of `rest`; checks that are right are passed over.
    fn read(&mut self, rest: &mut &[u8]) -> Read {
        loop {
            match **rest {
                [] => return Read::Nothing,
                [0x07, 0, ..] | [0x0f, 0, ..] => {
                    let way = self.state.direction;
                    self.state = State::new(if rest[0] == 0x07 { way.reversed() } else { way });
                    *rest = &rest[2..];
                    return Read::Record(None);
                }
                [0x2f, 0, ..] if rest.len() >= CHECK_LEN => {
                    let mut right = [0; CHECK_LEN];
                    self.packing.pack_check(&self.check(), &mut right).expect("room");
                    if self.anchored && !rest.starts_with(&right) {
                        return Read::Refused(Cause::CheckFailed);
                    }
                    *rest = &rest[CHECK_LEN..];
                }
                _ => return self.item(rest),
            }
        }
    }

    fn item(&mut self, rest: &mut &[u8]) -> Read {
        let (record, mut state) = (*rest, self.state);
        let Ok(item) = self.packing.unpack(&mut state, rest) else { return Read::Refused(Cause::BadItem) };
        let steps = match item.expect("there are bytes") {
            Item::Anchor { tick } => return self.anchor(tick),
            Item::Dwell { ticks } => {
                if self.anchored {
                    self.registers.tick = self.registers.tick.wrapping_add(ticks);
                }
                return Read::Record(None);
            }
            Item::Run { segment, .. } => segment,
        };
        let Ok(count) = u16::try_from(steps.count) else { return Read::Refused(Cause::BadItem) };
        // What is said in full is to fit an Uno's registers: 40 bits of an interval, 32 of changes.
        if let [0x27, 0, widths, more, ..] = *record {
            let [interval, add, add2, count] = [widths & 15, widths >> 4, more & 15, more >> 4];
            let is_narrow = |width: u8, value: i64| width == 0 || (width <= 5 && i32::try_from(value).is_ok());
            let fits = interval <= 6 && (0..1 << 40).contains(&steps.interval) && count <= 2;
            if !(fits && is_narrow(add, steps.add) && is_narrow(add2, steps.add2)) {
                return Read::Refused(Cause::BadItem);
            }
        }
        if !self.anchored {
            return Read::Refused(Cause::StepMissed);
        }
        let [i0, i1, i2, i3, interval_high, ..] = steps.interval.to_le_bytes();
        self.registers = Registers {
            interval_low: u32::from_le_bytes([i0, i1, i2, i3]),
            interval_high,
            add: steps.add as i32,
            add2: steps.add2 as i32,
            left: count,
            ..self.registers
        };
        self.state = state;
        self.position = self.position.wrapping_add(i32::from(count) * self.state.direction.sign());
        Read::Record(Some(steps))
    }

    fn anchor(&mut self, tick: Tick32) -> Read {
        (self.registers.tick, self.registers.fraction) = (tick.0, 0x8000);
        (self.anchored, self.origin) = (true, self.position as u16);
        Read::Record(None)
    }

    /// Makes the steps of the segment; gives the shortest and the longest of their intervals, whole ticks.
    fn run(&mut self) -> (u32, u32) {
        let (mut shortest, mut longest) = (u32::MAX, 0);
        for _ in 0..std::mem::take(&mut self.registers.left) {
            let [_, _, low, high] = self.registers.interval_low.to_le_bytes();
            let whole = u32::from_le_bytes([low, high, self.registers.interval_high, 0]);
            (shortest, longest) = (shortest.min(whole), longest.max(whole));
            self.registers.advance();
        }
        (shortest, longest)
    }

    /// Whether the registers that follow are within an Uno's: beyond that, what it does with them is its own affair.
    fn is_narrow(&self) -> bool {
        let State { interval, add, add2, .. } = self.state;
        (0..1 << 39).contains(&interval) && i32::try_from(add).is_ok() && i32::try_from(add2).is_ok()
    }
}

/// A packed item.
fn packed(model: &Model, item: &Item) -> Vec<u8> {
    let mut bytes = [0; MAX_PACKED_LEN];
    let len = model.packing.pack(&mut model.state.clone(), item, &mut bytes).expect("it has steps");
    bytes[..len].to_vec()
}

/// A check: the right one, or one of another place.
fn packed_check(model: &Model, random: &mut Random, is_right: bool) -> Vec<u8> {
    let mut bytes = [0; CHECK_LEN];
    model.packing.pack_check(&model.check(), &mut bytes).expect("room");
    if !is_right {
        bytes[2 + random.below(CHECK_LEN as u64 - 2) as usize] ^= 1 << random.below(8);
    }
    bytes.to_vec()
}

// The loader routine, called alone.

/// Where the test has a motor, its queue, and the stack.
const MOTOR: u16 = 0x500;
const QUEUE: [u16; 2] = [0x240, 0x2c0];
const STACK: u16 = 0x8f0;
const RETURN: u16 = 0x3ff0;
/// Offsets in a motor and in the times (firmware/uno/src/engine/steps/motor.rs, times.rs).
const COUNT: u16 = 21;
const FLAGS: u16 = 23;
const GAIN: u16 = 27;
const NEXT: u16 = 28;
const POSITION: u16 = 50;
const PRECHECKED: u16 = 61;
const READY: u16 = 62;
const REASON: u16 = 77;
const MOTOR_BYTES: u16 = 120;
const FASTEST: u16 = 12;

/// The chip with the firmware, in the midst of a motor's plan.
struct Loader {
    chip: pulsetrain_emulator::Atmega328p,
    entry: u16,
    fastest: u16,
}

impl Loader {
    fn put(&mut self, at: u16, bytes: &[u8]) {
        for (address, byte) in (at..).zip(bytes) {
            self.chip.write_data(address, *byte, &mut ());
        }
    }

    fn get<const N: usize>(&self, at: u16) -> [u8; N] {
        self.chip.ram()[usize::from(at - 0x100)..][..N].try_into().expect("within RAM")
    }

    /// A motor at rest with these bytes in its queue, the first of them somewhere in it.
    fn begin(&mut self, gain: i8, first: u16, bytes: &[u8]) {
        self.put(MOTOR, &[0; MOTOR_BYTES as usize]);
        let mut at = QUEUE[0] + first;
        for byte in bytes {
            self.put(at, &[*byte]);
            at = if at + 1 == QUEUE[1] { QUEUE[0] } else { at + 1 };
        }
        self.put(MOTOR + COUNT, &4_u16.to_le_bytes());
        self.put(MOTOR + GAIN, &gain.to_le_bytes());
        for (offset, value) in [(NEXT, QUEUE[0] + first), (NEXT + 2, QUEUE[0]), (NEXT + 4, QUEUE[1])] {
            self.put(MOTOR + offset, &value.to_le_bytes());
        }
        self.put(MOTOR + READY, &(bytes.len() as u16).to_le_bytes());
        let times = address(SYMBOLS, "steps_times");
        self.put(times + FASTEST, &self.fastest.to_le_bytes());
    }

    /// Loads the next record; whether there was one.
    fn load(&mut self) -> bool {
        let [low, high] = RETURN.to_le_bytes();
        self.put(0x5d, &STACK.to_le_bytes());
        self.put(STACK + 1, &[high, low]);
        let [low, high] = MOTOR.to_le_bytes();
        self.chip.set_register(28, low);
        self.chip.set_register(29, high);
        self.chip.set_register(1, 0);
        self.chip.set_pc(self.entry);
        let begin = self.chip.cycle();
        while self.chip.pc() != RETURN {
            self.chip.step(&mut ());
            assert!(self.chip.cycle() - begin < 5_000, "it does not return");
        }
        self.chip.read_data(0x5f, &mut ()) & 1 == 0
    }

    fn ready(&self) -> usize {
        usize::from(u16::from_le_bytes(self.get(MOTOR + READY)))
    }

    fn registers(&self) -> Vec<u8> {
        self.get::<21>(MOTOR).to_vec()
    }

    /// What a record may not touch: all but the motor, and what is below the stack. The ports' data and directions are the first six.
    fn elsewhere(&mut self) -> Vec<u8> {
        let ports = [0x24, 0x25, 0x27, 0x28, 0x2a, 0x2b].map(|port| self.chip.read_data(port, &mut ()));
        let ram = self.chip.ram();
        let [motor, stack] = [MOTOR, STACK - 64].map(|at| usize::from(at - 0x100));
        [&ports[..], &ram[..motor], &ram[motor + usize::from(MOTOR_BYTES)..stack]].concat()
    }
}

fn bytes_of(registers: &Registers) -> Vec<u8> {
    let Registers { fraction, tick, interval_low, interval_high, add, add2, left } = *registers;
    let mut bytes =
        [&fraction.to_le_bytes()[..], &tick.to_le_bytes(), &interval_low.to_le_bytes(), &[interval_high]].concat();
    bytes.extend([&add.to_le_bytes()[..], &add2.to_le_bytes(), &left.to_le_bytes()].concat());
    bytes
}

/// A stream that begins as a planner's, with records of all kinds, and is damaged somewhere, most often.
fn random_stream(random: &mut Random, gain: i8) -> Vec<u8> {
    let (mut stream, mut model) = (Vec::new(), Model::new(gain));
    let (mut here, most) = (Direction::Forward, random.between(1, 14));
    for number in 0..most {
        let garbage = |random: &mut Random, len| (0..1 + random.below(len)).map(|_| random.next() as u8).collect();
        let mut record = if number == 0 && !random.one_in(8) {
            packed(&model, &Item::Anchor { tick: Tick32(random.next() as u32) })
        } else {
            match random.below(16) {
                0 => packed(&model, &Item::Dwell { ticks: random.next() as u32 >> random.below(32) }),
                1 => packed(&model, &Item::Anchor { tick: Tick32(random.next() as u32) }),
                2 => packed_check(&model, random, true),
                3 => packed_check(&model, random, false),
                4 | 5 => garbage(random, 12),
                // A segment in full with widths of any kind.
                6 => [&[0x27, 0][..], &garbage(random, 14)].concat(),
                7 => [&[7 | (random.below(32) as u8) << 3, 0][..], &garbage(random, 8)].concat(),
                _ => {
                    here = if random.one_in(6) { here.reversed() } else { here };
                    let wide = |random: &mut Random, most: u64| {
                        let value = (random.next() >> (63 - random.below(most))) as i64;
                        if random.one_in(2) { -value } else { value }
                    };
                    let count = 1 + (random.next() as u16 >> random.below(16)) as u32 % 65_535;
                    let near = if random.one_in(3) { model.state.interval } else { wide(random, 40).abs() };
                    let (add, add2) = (wide(random, 26), wide(random, 14));
                    let segment = if random.one_in(3) {
                        Segment { count, interval: near, add, add2 }
                    } else {
                        // As fast motors have them.
                        let interval = ((60 + random.below(1600)) << 16) as i64;
                        Segment { count: 3 + count % 200, interval, add: add >> 8, add2: add2 >> 6 }
                    };
                    packed(&model, &Item::Run { segment, direction: here })
                }
            }
        };
        if random.one_in(12) {
            let at = random.below(record.len() as u64) as usize;
            record[at] ^= 1 << random.below(8);
        }
        stream.extend(&record);
        // What follows fits what has been said so far, as long as it can be read.
        let mut rest = &record[..];
        while !rest.is_empty() && matches!(model.read(&mut rest), Read::Record(_)) {
            model.run();
        }
        here = model.state.direction;
    }
    if random.one_in(4) {
        stream.truncate(1 + random.below(stream.len() as u64) as usize);
    }
    stream.truncate(usize::from(QUEUE[1] - QUEUE[0]));
    stream
}

/// How streams ended.
#[derive(Default)]
struct Ends {
    read: u32,
    refused: [u32; 3],
    wide: u32,
    segments: u32,
    prechecked: u32,
}

fn check_stream(loader: &mut Loader, random: &mut Random, ends: &mut Ends) {
    let gain = random.below(13) as i8 - 6;
    let stream = random_stream(random, gain);
    loader.begin(gain, random.below(u64::from(QUEUE[1] - QUEUE[0])) as u16, &stream);
    let untouched = loader.elsewhere();
    let (mut model, mut rest) = (Model::new(gain), &stream[..]);
    loop {
        let before = rest;
        let read = model.read(&mut rest);
        let what = || format!("{read:?} from {before:02x?} of {stream:02x?}, gain {gain}");
        let (position, count) = (loader.get(MOTOR + POSITION), loader.get::<2>(MOTOR + COUNT));
        let loaded = loader.load();
        assert_eq!(loader.elsewhere(), untouched, "{}", what());
        let [reason] = loader.get(MOTOR + REASON);
        let left = u16::from_le_bytes(loader.get(MOTOR + 19));
        match read {
            Read::Nothing => {
                assert!(!loaded && reason == 0 && left == 0, "{}", what());
                ends.read += 1;
                return;
            }
            Read::Refused(cause) => {
                let expected = match cause {
                    Cause::StepMissed => 1,
                    Cause::CheckFailed => 2,
                    _ => 3,
                };
                assert!(
                    !loaded && reason == expected && left == 0,
                    "{}: loaded {loaded}, reason {reason}, {left} left",
                    what()
                );
                assert_eq!(loader.get::<4>(MOTOR + POSITION), position, "{}", what());
                // Nothing more is read, whatever comes.
                let after = loader.get::<{ MOTOR_BYTES as usize }>(MOTOR);
                assert!(!loader.load(), "{}", what());
                assert_eq!(loader.get::<{ MOTOR_BYTES as usize }>(MOTOR), after, "{}", what());
                ends.refused[usize::from(expected) - 1] += 1;
                return;
            }
            Read::Record(steps) => {
                assert!(loaded && reason == 0, "{}: loaded {loaded}, reason {reason}", what());
                assert_eq!(loader.ready(), rest.len(), "{}", what());
                assert_eq!(loader.get(MOTOR + POSITION), model.position.to_le_bytes(), "{}", what());
                let [flags] = loader.get(MOTOR + FLAGS);
                assert_eq!(flags & 1 == 1, model.state.direction == Direction::Backward, "{}", what());
                let Some(_) = steps else {
                    let [tick, fraction] =
                        [&loader.get::<4>(MOTOR + 2)[..], &loader.get::<2>(MOTOR)].map(<[u8]>::to_vec);
                    let expected = [&model.registers.tick.to_le_bytes()[..], &model.registers.fraction.to_le_bytes()];
                    assert_eq!([&tick[..], &fraction[..]], expected, "{}", what());
                    assert_eq!(left, 0, "{}", what());
                    continue;
                };
                ends.segments += 1;
                assert_eq!(loader.registers(), bytes_of(&model.registers), "{}", what());
                let said = u16::from_le_bytes(loader.get(MOTOR + COUNT));
                assert_eq!(u32::from(said), model.state.previous_count, "{} after {count:?}", what());
                let [prechecked] = loader.get(MOTOR + PRECHECKED);
                let (shortest, longest) = model.run();
                if prechecked != 0 {
                    // Its steps are not compared any longer.
                    let most = 256 * u32::from(prechecked & 0x7f);
                    let fits = shortest >= u32::from(loader.fastest) && longest < most;
                    assert!(fits, "{}: {shortest} to {longest} ticks, said to be below {most}", what());
                    ends.prechecked += 1;
                }
                if !model.is_narrow() {
                    ends.wide += 1;
                    return;
                }
                loader.put(MOTOR, &bytes_of(&model.registers));
            }
        }
    }
}

#[test]
fn the_loader_reads_what_core_reads_and_refuses_the_rest() {
    let chip = pulsetrain_emulator::Atmega328p::new(&virtual_uno::image()).expect("an image");
    let mut loader = Loader { chip, entry: address(SYMBOLS, "steps_load_record"), fastest: 60 };
    let mut random = Random::new(seed(1));
    let mut ends = Ends::default();
    for round in 0..6000 * rounds() {
        loader.fastest = [60, 78, 130][round as usize % 3];
        check_stream(&mut loader, &mut random, &mut ends);
    }
    let Ends { read, refused: [missed, mismatch, bad], wide, segments, prechecked } = ends;
    println!(
        "{segments} segments, {prechecked} of them prechecked; {read} streams read to the end, {wide} up to registers that are too wide; refused: \
         {bad} bad, {mismatch} by a check, {missed} without an anchor"
    );

    assert!([read, missed, mismatch, bad, wide].iter().all(|number| *number > 50) && prechecked > 500);
}

// The whole board.

/// The most that one frame takes to an Uno, bytes.
const MAX_PACKED: usize = 54;

/// A line to the board on which one record of one motor is another than the host sent, in frames that are as they should be.
struct Damaging {
    uno: VirtualUno,
    motor: u8,
    /// So many records are left as they are.
    intact: usize,
    random: Random,
    model: Model,
    decoder: Decoder,
    sent: Vec<u8>,
    /// Steps before it, and what the board is to say of it, once it is sent.
    done: Option<(usize, Cause)>,
    steps: usize,
}

impl Damaging {
    /// A record that is to be refused, and why.
    fn record(&mut self) -> (Cause, Vec<u8>) {
        match self.random.below(6) {
            0 => (Cause::BadItem, vec![7 | (7 + self.random.below(9) as u8) << 3, 0]),
            1 => (Cause::BadItem, vec![7, 255, 0, 0]),
            // In full: no steps, a register too many, one that is too wide.
            2 => (Cause::BadItem, vec![0x27, 0, 0x02, 0x10, 0, 0, 9]),
            3 => (Cause::BadItem, vec![0x27, 0, 0x12, 0x10, 1, 0, 9, 1]),
            _ => (Cause::CheckFailed, packed_check(&self.model, &mut self.random, false)),
        }
    }

    /// Data for the motor, damaged where it is time.
    fn damaged(&mut self, packed: &[u8]) -> Vec<u8> {
        let mut rest = packed;
        while !rest.is_empty() && self.done.is_none() {
            let at = packed.len() - rest.len();
            if self.intact == 0 {
                let (mut cause, mut record) = self.record();
                // No frame may be longer than the board takes.
                if at + record.len() > MAX_PACKED {
                    (cause, record) = (Cause::BadItem, vec![0x7f, 0]);
                }
                let len = packed.len().max(at + record.len());
                self.done = Some((self.steps, cause));
                return [&packed[..at], &record, rest].concat()[..len].to_vec();
            }
            self.intact -= 1;
            if let Read::Record(Some(steps)) = self.model.read(&mut rest) {
                self.steps += steps.count as usize;
                self.model.run();
            }
        }
        packed.to_vec()
    }
}

impl Port for Damaging {
    fn now(&self) -> Duration {
        self.uno.now()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
        for byte in bytes {
            self.sent.push(*byte);
            let Received::Frame(tag) = self.decoder.push(*byte) else { continue };
            let body = self.decoder.body().to_vec();
            if let [seq, what, epoch, packed @ ..] = &body[..]
                && *what == kind::DATA + self.motor
            {
                let mut frame = [0; MAX_FRAME];
                let mut encoder = Encoder::new(&mut frame);
                encoder.bytes(&[*seq, *what, *epoch]);
                encoder.bytes(&self.damaged(packed));
                let len = encoder.finish(tag).expect("room");
                // Its own zero is the first byte of the next.
                self.sent = frame[..len].to_vec();
            }
            let sent = std::mem::take(&mut self.sent);
            self.uno.send(&sent)?;
        }
        let sent = std::mem::take(&mut self.sent);
        self.uno.send(&sent)
    }

    fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
        self.uno.receive(until, into)
    }

    fn set_baud(&mut self, baud: Baud) -> Result<(), PortError> {
        self.uno.set_baud(baud)
    }

    fn edges(&mut self, into: &mut Vec<Edge>) {
        self.uno.edges(into);
    }
}

/// A short plan of each motor: runs, waits, turns.
fn plan(board: &mut impl Board, setup: &Setup, random: &mut Random, from: u64) {
    for motor in 0..setup.motors.len() {
        let mut items = vec![Item::Anchor { tick: Tick32::of(from) }];
        let mut direction = Direction::Forward;
        for _ in 0..4 {
            items.push(Item::Dwell { ticks: 4000 + random.below(20_000) as u32 });
            direction = if random.one_in(3) { direction.reversed() } else { direction };
            let (count, interval) = (20 + random.below(60) as u32, 16_000 + random.below(20_000) as i64);
            let segment = Segment { count, interval: interval << 16, add: random.below(1 << 18) as i64, add2: 0 };
            items.push(Item::Run { segment, direction });
        }
        // It rests then, while others go on.
        items.push(Item::Dwell { ticks: 0 });
        for item in items {
            board.push(motor, Entry { epoch: Epoch(1), item }).expect("room");
        }
    }
}

fn check_board(pins: &[(u8, u8)], timing: Timing, random: &mut Random) -> Cause {
    let setup = uno_setup(pins, 16);
    let motor = random.below(pins.len() as u64) as u8;
    let port = Damaging {
        uno: VirtualUno::new(),
        motor,
        intact: 2 + random.below(7) as usize,
        random: Random::new(random.next()),
        model: Model::new(setup.motors[usize::from(motor)].gain),
        decoder: Decoder::new(),
        sent: Vec::new(),
        done: None,
        steps: 0,
    };
    let mut remote = Remote::open(port, 7).expect("it answers");
    assert_eq!(remote.set_baud(Baud::B1M), Ok(Baud::B1M));
    remote.configure(&setup).expect("it takes the configuration");
    let mut native = Native::unbounded(&native_config(&setup)).expect("the native board takes it too");
    native.advance(remote.now() - 1, &mut |_: Edge| {});
    let mut board = WithReference::new(remote, native);
    let from = board.now() + board.round_trip() + TICK_HZ / 100;
    plan(&mut board, &setup, random, from);
    board.switch(Epoch(1), from, Lease::Last, &[]).expect("it is in time");
    let mut lab = Lab::default();
    let until = from + TICK_HZ * 2;
    board.advance(until, &mut lab);
    let remote = board.board_mut();
    let port = remote.port_mut();
    let (steps, cause) = port.done.expect("there are so many records");
    let told: Vec<_> = remote.events().into_iter().filter(|event| event.cause != Cause::Finished).collect();
    let whose: Vec<_> = told.iter().map(|event| (event.cause, event.motor)).collect();
    assert_eq!(whose, [(cause, motor)], "{pins:?}");
    let counts = lab.counts(&setup);
    // The steps before it are made, none of what comes after, and the others' up to where all brake: within a step, which is no part of the plan.
    for (index, (step_line, _)) in pins.iter().enumerate() {
        let (mut kept, mut rises) = (0, 0);
        lab.steps.retain(|step| {
            let is_made = if index == usize::from(motor) { kept < steps } else { step.tick < told[0].tick };
            kept += usize::from(step.motor == index && is_made);
            step.motor != index || is_made
        });
        lab.edges.retain(|edge| {
            rises += usize::from(edge.line == *step_line && edge.level);
            edge.line != *step_line || rises <= kept
        });
        assert!((kept..=kept + 1).contains(&rises), "motor {index} of {pins:?}: {rises} steps, {kept} of the plan");
    }
    lab.check(&setup, timing, None);
    // TX goes high as the line is opened.
    let lines: Vec<u8> =
        std::iter::once((1, 1)).chain(pins.iter().copied()).flat_map(|(step, dir)| [step, dir]).collect();
    let other: Vec<_> = lab.edges.iter().filter(|edge| !lines.contains(&edge.line)).take(3).collect();
    assert!(other.is_empty(), "other pins moved: {other:?}");
    let status = board.board_mut().status().expect("it answers");
    let positions: Vec<_> = status.motors.as_slice().iter().map(|motor| i64::from(motor.position)).collect();
    assert_eq!(positions, counts, "what it counted, and the pins");
    cause
}

#[test]
fn a_record_that_is_refused_moves_no_pin() {
    let wirings: [(&[(u8, u8)], Timing); 5] = [
        (&[(8, 9)], SOFTWARE),
        (&[(9, 8)], EXACT),
        (&[(2, 5), (3, 6)], SOFTWARE),
        (&[(2, 5), (3, 6), (4, 7)], SOFTWARE),
        (&[(2, 5), (3, 6), (4, 7), (12, 13)], SOFTWARE),
    ];
    let mut random = Random::new(seed(2));
    let (mut bad, mut mismatch) = (0, 0);
    for (pins, timing) in wirings {
        for _ in 0..6 * rounds() {
            match check_board(pins, timing, &mut random) {
                Cause::CheckFailed => mismatch += 1,
                _ => bad += 1,
            }
        }
    }
    println!("{bad} bad records, {mismatch} wrong checks");
    assert!(bad > 5 && mismatch > 3);
}
