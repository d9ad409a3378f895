//! The winch in the Uno's assembly against core's: random lines, the same answers; random commands to a path, the same bits;
//! and what a tick and a byte cost.
//!
//! images/winch.hex is the assembly of firmware/uno/src/bin/uno-winch/winch, behind winch_entries.s: `cargo xtask firmware uno`.

use pulsetrain_core::winch::letters::InMemory;
use pulsetrain_core::winch::path::Path;
use pulsetrain_core::winch::reply::{LONGEST, LineReply};
use pulsetrain_core::winch::spacing::Train;
use pulsetrain_core::winch::text::{Heard, LineError, LineFault, LineReader};
use pulsetrain_emulator::{Atmega328p, hex};
use pulsetrain_testkit::Random;
use pulsetrain_testkit::seed::{rounds, seed};
use std::collections::VecDeque;

const IMAGE: &str = include_str!("../../../images/winch.hex");
/// Entries, by winch_entries.s; in words.
const TICK: u16 = 0;
const LISTEN: u16 = 2;
/// The receive page.
const PAGE: u16 = 0x100;
const OBEY: u16 = 4;
const SAY: u16 = 6;
const STATUS: u16 = 8;
const START: u16 = 10;
const PATH: u16 = 0x500;
const VALUES: u16 = 0x680;
const LINE: u16 = 0x6a0;
const READER: u16 = 0x700;
const TRAIN: u16 = 0x600;
const STACK: u16 = 0x8f0;
const RETURN: u16 = 0x3ff0;

/// Four axes must leave 10 000 of the 16 000 cycles of a millisecond to others; 1308 is the most that 2 million random ticks took.
const MOST_CYCLES_AN_AXIS: u64 = 1350;

/// Of at most so many digits, with its sign.
fn number(random: &mut Random, digits: u32) -> i64 {
    let range = 10_u64.pow(1 + random.below(digits.into()) as u32);
    random.below(2 * range) as i64 - range as i64
}

fn chip() -> Atmega328p {
    Atmega328p::new(&hex::parse(IMAGE, Atmega328p::FLASH_BYTES).unwrap()).unwrap()
}

/// Calls what is at `entry`, with arguments in pairs of registers; gives r24, and the cycles that it took.
fn call(chip: &mut Atmega328p, entry: u16, arguments: &[(u8, u16)]) -> (u8, u64) {
    for (address, byte) in [(0x5d, STACK), (0x5e, STACK >> 8), (STACK + 1, RETURN >> 8), (STACK + 2, RETURN)] {
        chip.write_data(address, byte.to_le_bytes()[0], &mut ());
    }
    // What a caller has in the registers that are its own.
    for register in 0..32 {
        chip.set_register(register, 0x40 + register);
    }
    chip.set_register(1, 0);
    for (register, value) in arguments {
        let [low, high] = value.to_le_bytes();
        chip.set_register(*register, low);
        chip.set_register(register + 1, high);
    }
    chip.set_pc(entry);
    let begin = chip.cycle();
    while chip.pc() != RETURN {
        chip.step(&mut ());
        assert!(chip.cycle() - begin < 100_000, "it does not return");
    }
    assert_eq!((chip.sp(), chip.register(1)), (STACK + 2, 0));
    for register in (2..18).chain([28, 29]) {
        assert_eq!(chip.register(register), 0x40 + register, "r{register} is the caller's");
    }
    (chip.register(24), chip.cycle() - begin)
}

fn put(chip: &mut Atmega328p, at: u16, bytes: &[u8]) {
    for (address, byte) in (at..).zip(bytes) {
        chip.write_data(address, *byte, &mut ());
    }
}

fn ram(chip: &Atmega328p, at: u16, len: u16) -> &[u8] {
    &chip.ram()[usize::from(at - 0x100)..usize::from(at + len - 0x100)]
}

/// One tick on the chip, of a path as it is; gives path and train after it, and the cycles that it took.
fn tick(chip: &mut Atmega328p, path: &Path) -> (Vec<u8>, Option<Train>, u64) {
    put(chip, PATH, &path.bytes());
    let (_, cycles) = call(chip, TICK, &[(24, PATH), (22, TRAIN)]);
    let train = ram(chip, TRAIN, 10);
    let four = |at: usize| u32::from_le_bytes(train[at..at + 4].try_into().unwrap());
    let train =
        (train[0] != 0).then(|| Train { count: train[0], backward: train[1] != 0, first: four(2), interval: four(6) });
    (ram(chip, PATH, 51).to_vec(), train, cycles)
}

/// A reader of lines on the chip, beside core's: also for fuzz/fuzz_targets/winch_uno.rs.
pub(crate) struct Readers {
    chip: Atmega328p,
    core: LineReader,
    /// Where in the page the next byte goes.
    tail: u8,
    /// The most cycles that bytes took, each, and those that ended a line.
    most: [u64; 2],
}

impl Readers {
    pub(crate) fn new(strict: bool) -> Readers {
        let mut readers = Readers { chip: chip(), core: LineReader::new(), tail: 0, most: [0; 2] };
        readers.restart(strict);
        readers
    }

    /// Without a line, and as if no checksum had ever come.
    fn restart(&mut self, strict: bool) {
        self.core = LineReader::new();
        self.core.set_strict(strict);
        put(&mut self.chip, READER, &[2 | u8::from(strict)]);
    }

    /// What a line is, to both; on the chip in pieces, round and round the page.
    pub(crate) fn push(&mut self, line: &[u8]) {
        let mut left: VecDeque<u8> = line.iter().copied().collect();
        let text = String::from_utf8_lossy(line);
        while !left.is_empty() {
            let count = left.len().min(1 + usize::from(self.tail % 57));
            let at = (self.tail..).map(|at| PAGE + u16::from(at & 0x7f));
            at.zip(left.range(..count)).for_each(|(at, byte)| self.chip.write_data(at, *byte, &mut ()));
            let arguments = [(24, READER), (22, PAGE + u16::from(self.tail)), (20, count as u16)];
            let (heard, cycles) = call(&mut self.chip, LISTEN, &arguments);
            let taken = count - usize::from(self.chip.register(25));
            self.tail = (self.tail + taken as u8) & 0x7f;
            let most = &mut self.most[usize::from(matches!(left[taken - 1], b'\n' | b'\r'))];
            *most = (cycles / taken as u64).max(*most);
            let mut said = Heard::Nothing;
            for byte in left.drain(..taken) {
                assert_eq!(said, Heard::Nothing, "{text:?}: nothing is taken behind a line");
                said = self.core.push::<InMemory>(byte);
            }
            self.compare(heard, said, &text);
        }
    }

    fn compare(&self, heard: u8, said: Heard, text: &str) {
        match said {
            Heard::Nothing => assert_eq!(heard, 0, "{text:?}"),
            Heard::Refused(refusal) => {
                let word = ram(&self.chip, READER + 5, 1)[0];
                assert_eq!((heard, word), (refusal.what as u8, refusal.word), "{text:?}, {refusal:?}");
            }
            Heard::Command(verb) => {
                assert_eq!(heard, 0x80 | verb as u8, "{text:?}, {verb:?}");
                let values: Vec<u8> = self.core.values().iter().flat_map(|value| value.to_le_bytes()).collect();
                assert_eq!(ram(&self.chip, READER + 9, 16), values, "{text:?}");
                let axes = ram(&self.chip, READER + if verb as u8 == 5 || verb as u8 == 6 { 7 } else { 8 }, 1)[0];
                if verb as u8 <= 6 {
                    assert_eq!(axes, self.core.axes(), "{text:?}");
                }
            }
        }
    }
}

/// A line of what commands are made of, and sometimes of anything.
fn any_line(random: &mut Random) -> Vec<u8> {
    let mut line = Vec::new();
    for _ in 0..random.below(14) {
        let piece = match random.below(24) {
            0..=5 => random.pick(&["a", "d", "v", "r", "s", "g", "l", "g", "l"]).to_owned(),
            6 => random.pick(&["enable", "srate", "deadman", "strict", "version", "ping", "pin", "pings"]).to_owned(),
            7..=9 => random.pick(&["x", "xy", "xyza", "ax", "xx", "q", "xqz", "{", "w", "XYZ"]).to_owned(),
            10..=12 => number(random, 7).to_string(),
            13 => number(random, 11).to_string(),
            14..=16 => format!("{}.{}", number(random, 3).abs(), number(random, 4).abs()),
            17 => format!("{}e{}", number(random, 5), number(random, 2)),
            18 => random
                .pick(&[
                    "nan",
                    "2147483647",
                    "-2147483648",
                    "2147483648",
                    "4294967295",
                    "5e",
                    "1e+2",
                    "-.5",
                    ".",
                    "-",
                    "65536",
                    "-2147483649",
                    "256",
                    "1e999",
                    "4.2e38",
                    "4.3e38",
                    "-1e30",
                    "4294967.29",
                    "4294967.3",
                    "-1",
                    "2",
                ])
                .to_owned(),
            19 => "0123456789".repeat(random.below(4) as usize),
            20 => random
                .pick(&["0.01", "20", "0.07", "5", "20.0000005", "10000", "250000", "0.0009995", "15001"])
                .to_owned(),
            21 => " ".repeat(random.below(40) as usize),
            22 => char::from(random.below(128) as u8).to_string(),
            _ => "*".to_owned(),
        };
        line.extend(piece.bytes());
        if random.below(8) != 0 {
            line.push(if random.below(9) == 0 { b'\t' } else { b' ' });
        }
    }
    // Zeros are frames'.
    line.retain(|byte| *byte != b'\n' && *byte != b'\r' && *byte != 0);
    if random.below(4) == 0 {
        let sum = line.iter().fold(0, |sum, byte| sum ^ byte) ^ u8::from(random.below(4) == 0);
        let hex = format!("*{sum:02x}");
        line.extend(if random.below(2) == 0 { hex.to_uppercase() } else { hex }.bytes());
        line.extend(random.pick(&["", "", "", " ", "\t ", "  x"]).bytes());
    }
    line.push(b'\n');
    line
}

#[test]
fn the_assembly_reads_what_core_reads() {
    let mut random = Random::new(seed(242));
    for strict in [false, true] {
        let mut readers = Readers::new(strict);
        // Whole commands, what is nearly one, and anything.
        for _ in 0..1500 * rounds() {
            readers.push(line(&mut random).as_bytes());
            let mut damaged = line(&mut random).into_bytes();
            let at = random.below(damaged.len() as u64 - 1) as usize;
            damaged[at] = 1 + random.below(255) as u8;
            readers.push(&damaged);
            for _ in 0..4 {
                readers.push(&any_line(&mut random));
            }
            // After a right checksum all others are wanted, and little else is tried.
            if random.below(8) != 0 {
                readers.restart(strict);
            }
        }
        println!(
            "strict {strict}: at most {} cycles a byte, {} at the end of a line",
            readers.most[0], readers.most[1]
        );
        assert!(readers.most[0] <= 200 && readers.most[1] <= 6000, "{:?}", readers.most);
    }
}

fn line(random: &mut Random) -> String {
    let reach = [10, 1000, 30_000, 2_000_000, i32::MAX as u64][random.below(5) as usize];
    let steps = random.below(2 * reach) as i64 - reach as i64;
    let log = |random: &mut Random, low: f64, high: f64| {
        (low.ln() + (high / low).ln() * random.below(100_000) as f64 / 1e5).exp()
    };
    match random.below(12) {
        0..=3 => format!("a x {steps}\n"),
        4 => format!("d x {steps}\n"),
        5 => format!("v x {}\n", steps % 15_001),
        6 => format!("r x {steps}\n"),
        7 => format!("s x {}\n", steps.abs() % 5000),
        8 => format!("g x {:.4} {:.4}\n", log(random, 0.0101, 19.9), log(random, 0.0701, 4.9)),
        9 => format!("l x {} {}\n", random.below(12_000), 1 + random.below(300_000)),
        10 => format!("l x {} {}\n", random.below(300), 1 + random.below(3000)),
        _ => "enable 0\n".to_owned(),
    }
}

/// What the assembly writes to `LINE`.
fn written(chip: &mut Atmega328p, entry: u16, arguments: &[(u8, u16)]) -> String {
    put(chip, LINE, &[b'!'; LONGEST + 1]);
    let (len, _) = call(chip, entry, arguments);
    assert_eq!(ram(chip, LINE + u16::from(len), 1), b"!", "no byte behind it");
    String::from_utf8(ram(chip, LINE, len.into()).to_vec()).unwrap()
}

fn reply(reply: LineReply) -> String {
    let mut line = [0; LONGEST];
    let len: usize = reply.write::<InMemory>(&mut line).into();
    String::from_utf8(line[..len].to_vec()).unwrap()
}

#[test]
fn the_assembly_says_what_core_says() {
    let mut chip = chip();
    let whats = [
        LineFault::Command,
        LineFault::Flags,
        LineFault::Number,
        LineFault::Range,
        LineFault::Missing,
        LineFault::Extra,
        LineFault::Long,
        LineFault::Noise,
        LineFault::Checksum,
        LineFault::Frequency,
        LineFault::Ratio,
        LineFault::Rate,
        LineFault::Words,
    ];
    for (what, word) in whats.into_iter().zip([1, 2, 3, 4, 9, 10, 11, 40, 0, 3, 4, 2, 11]) {
        let said = written(&mut chip, SAY, &[(24, LINE), (22, what as u16), (20, word)]);
        assert_eq!(said, reply(LineReply::Refused(LineError { what, word: word as u8 })));
    }
    for (what, of_core) in [(14, LineReply::Awake), (15, LineReply::Id)] {
        assert_eq!(written(&mut chip, SAY, &[(24, LINE), (22, what)]), reply(of_core));
    }
    assert_eq!(written(&mut chip, SAY, &[(24, LINE), (22, 16)]), "err taken\r\n");
    let (mut random, mut most) = (Random::new(7), 0);
    let ends = [0, 1, -1, 9, 10, 99, -100, i32::MAX, i32::MIN, 999_999_999, 1_000_000_000, -1_999_999_999];
    for round in 0..400 {
        let values: [i32; 5] = std::array::from_fn(|at| {
            if round < ends.len() { ends[(round + at) % ends.len()] } else { number(&mut random, 10) as i32 }
        });
        put(&mut chip, VALUES, &values.map(i32::to_le_bytes).concat());
        let said = written(&mut chip, STATUS, &[(24, LINE), (22, VALUES)]);
        let (_, cycles) = call(&mut chip, STATUS, &[(24, LINE), (22, VALUES)]);
        most = most.max(cycles);
        let [usec, positions @ ..] = values;
        assert_eq!(said, reply(LineReply::Status { usec, positions }));
    }
    println!("a status line takes at most {most} cycles");
    assert!(most < 6000);
}

#[test]
fn the_assembly_begins_as_core_does() {
    let mut chip = chip();
    call(&mut chip, START, &[(24, PATH)]);
    assert_eq!(ram(&chip, PATH, 204), Path::new().bytes().repeat(4));
}

#[test]
fn the_assembly_is_the_path() {
    let (mut chip, mut random, mut most, mut steps) = (chip(), Random::new(seed(353)), 0, 0);
    let mut longest = 0;
    let (mut reader, mut paths) = (LineReader::new(), [const { Path::new() }; 4]);
    for round in 0..60_000 * rounds() {
        if round % 20 == 0 {
            for byte in line(&mut random).bytes() {
                let Heard::Command(verb) = reader.push::<InMemory>(byte) else { continue };
                put(&mut chip, PATH, &paths[0].bytes());
                let values: Vec<u8> = reader.values().iter().flat_map(|value| value.to_le_bytes()).collect();
                put(&mut chip, VALUES, &values);
                let before = paths[0].clone();
                let (_, cycles) = call(&mut chip, OBEY, &[(24, PATH), (22, VALUES), (20, verb as u16)]);
                longest = longest.max(cycles);
                reader.obey(&mut paths);
                assert_eq!(ram(&chip, PATH, 51), paths[0].bytes(), "{verb:?} {:?} to {before:?}", reader.values());
            }
        }
        let path = &mut paths[0];
        let before = path.clone();
        let (bytes, train, cycles) = tick(&mut chip, path);
        let expected = path.tick().train();
        assert_eq!(train, expected, "round {round}: {before:?}");
        assert_eq!(bytes, path.bytes(), "round {round}: {before:?}");
        most = most.max(cycles);
        steps += train.map_or(0, |train| u64::from(train.count));
    }
    println!("at most {most} cycles a tick, {longest} a command; {steps} steps");
    assert!(longest <= 800, "{longest} cycles");
    assert!(most <= MOST_CYCLES_AN_AXIS && steps > 60_000, "{most} cycles, {steps} steps");
}

#[test]
fn the_assembly_takes_targets_at_any_distance() {
    let ends = [0, 1, -1, 100, 1 << 30, -1 << 30, i32::MAX - 1, i32::MAX, i32::MIN, i32::MIN + 1];
    let (mut chip, mut reader) = (chip(), LineReader::new());
    for (from, to) in ends.into_iter().flat_map(|from| ends.map(|to| (from, to))) {
        for verb in ["a", "d", "r"] {
            let mut paths = [const { Path::new() }; 4];
            paths[0] = Path::at(from);
            put(&mut chip, PATH, &paths[0].bytes());
            for byte in format!("{verb} x {to}\n").bytes() {
                let Heard::Command(verb) = reader.push::<InMemory>(byte) else { continue };
                put(&mut chip, VALUES, &to.to_le_bytes());
                call(&mut chip, OBEY, &[(24, PATH), (22, VALUES), (20, verb as u16)]);
                reader.obey(&mut paths);
            }
            assert_eq!(ram(&chip, PATH, 51), paths[0].bytes(), "{verb} x {to}, from {from}");
        }
    }
}

#[test]
fn what_a_tick_costs() {
    for (name, commands, most) in [
        ("idle", "", 380),
        ("1234 steps/s", "v x 1234\n", 1100),
        ("4000 steps/s", "l x 10000 100000\nv x 4000\n", 1100),
        ("10 000 steps/s", "l x 10000 100000\nv x 10000\n", 1100),
        ("10 000 steps/s with a ramp", "l x 10000 100000\ns x 12000\na x 100000\n", MOST_CYCLES_AN_AXIS),
    ] {
        let (mut chip, mut reader, mut paths) = (chip(), LineReader::new(), [const { Path::new() }; 4]);
        for byte in commands.bytes() {
            if let Heard::Command(_) = reader.push::<InMemory>(byte) {
                reader.obey(&mut paths);
            }
        }
        let (mut sum, mut worst) = (0, 0);
        for _ in 0..2000 {
            let (_, _, cycles) = tick(&mut chip, &paths[0]);
            let _ = paths[0].tick();
            (sum, worst) = (sum + cycles, worst.max(cycles));
        }
        let mean = sum / 2000;
        println!(
            "{name}: {mean} cycles a tick, at most {worst}; four axes {:.1} % of a CPU",
            mean as f64 * 4.0 / 160.0
        );
        assert!(worst <= most, "{name}: {worst} cycles");
    }
}

#[test]
fn what_a_line_costs() {
    // Cycles to read it and to do it, and bytes times those that a byte takes on the line at 115 200 baud.
    for (line, most) in [
        ("v x 1\n", 1200),
        ("d x 10\n", 1500),
        ("a x 1\n", 1300),
        ("l a 1 1\n", 2300),
        ("l xyza 1 1\n", 4000),
        ("l xyza 9999.999 249999.999\n", 5000),
        ("g a 1 1\n", 2100),
        ("g xyza 1 1\n", 4500),
        ("g xyza .1 .1\n", 4600),
        ("g xyza 1.147198 0.333333\n", 5500),
        ("a xyza 1 2 3 4\n", 3500),
        ("a xyza -100000 200000 -300000 400000\n", 5200),
        ("s xyza 1 2 3 4\n", 3600),
        ("enable 0\n", 1900),
        ("deadman 1\n", 1400),
        ("ping\n", 1200),
        ("q\n", 1100),
    ] {
        let mut chip = chip();
        call(&mut chip, START, &[(24, PATH)]);
        put(&mut chip, READER, &[2]);
        put(&mut chip, PAGE, line.as_bytes());
        let (heard, reading) = call(&mut chip, LISTEN, &[(24, READER), (22, PAGE), (20, line.len() as u16)]);
        let verb = u16::from(heard & 0x7f);
        let mut doing = 0;
        for axis in 0..4 {
            let axes = ram(&chip, READER + if verb == 5 || verb == 6 { 7 } else { 8 }, 1)[0];
            if verb == 7 || (verb < 7 && axes & 1 << axis != 0) {
                let values = READER + 9 + if verb < 5 { 4 * axis } else { 0 };
                let (_, cycles) = call(&mut chip, OBEY, &[(24, PATH + 51 * axis), (22, values), (20, verb)]);
                doing += cycles;
            }
        }
        println!("{:<40} {reading:>6} {doing:>6} of {:>6}", line.trim_end(), line.len() * 1389);
        assert!(reading + doing <= most, "{line:?}");
    }
}
