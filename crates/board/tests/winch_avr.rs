//! The path of a winch in the Uno's assembly against core's: random commands, the same bits; and what a tick costs.
//!
//! images/winch_tick.hex is firmware/uno/src/winch/tick.s, assembled: `cargo xtask firmware uno`.

use pulsetrain_core::winch::letters::InMemory;
use pulsetrain_core::winch::path::Path;
use pulsetrain_core::winch::spacing::Train;
use pulsetrain_core::winch::text::{Heard, Reader};
use pulsetrain_emulator::{Atmega328p, hex};

const IMAGE: &str = include_str!("../images/winch_tick.hex");
const PATH: u16 = 0x500;
const TRAIN: u16 = 0x600;
const STACK: u16 = 0x8f0;
const RETURN: u16 = 0x3ff0;

/// Four axes must leave so much of a millisecond, 16 000 cycles, to others: issue 4 says about 35 %.
const MOST_CYCLES_AN_AXIS: u64 = 1410;

/// A small generator of random numbers: xorshift64*.
struct Random(u64);

impl Random {
    fn below(&mut self, range: i64) -> i64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 32) as i64 % range
    }
}

fn chip() -> Atmega328p {
    Atmega328p::new(&hex::parse(IMAGE, Atmega328p::FLASH_BYTES).unwrap()).unwrap()
}

/// One tick on the chip, of a path as it is; gives path and train after it, and the cycles that it took.
fn tick(chip: &mut Atmega328p, path: &Path) -> (Vec<u8>, Option<Train>, u64) {
    for (address, byte) in (PATH..).zip(path.bytes()) {
        chip.write_data(address, byte, &mut ());
    }
    for (address, byte) in [(0x5d, STACK), (0x5e, STACK >> 8), (STACK + 1, RETURN >> 8), (STACK + 2, RETURN)] {
        chip.write_data(address, byte.to_le_bytes()[0], &mut ());
    }
    // What a caller has in the registers that are its own.
    for register in 0..32 {
        chip.set_register(register, 0x40 + register);
    }
    chip.set_register(1, 0);
    for (register, value) in [(24, PATH), (22, TRAIN)] {
        let [low, high] = value.to_le_bytes();
        chip.set_register(register, low);
        chip.set_register(register + 1, high);
    }
    chip.set_pc(0);
    let begin = chip.cycle();
    while chip.pc() != RETURN {
        chip.step(&mut ());
        assert!(chip.cycle() - begin < 100_000, "it does not return");
    }
    let cycles = chip.cycle() - begin;
    assert_eq!((chip.sp(), chip.register(1)), (STACK + 2, 0));
    for register in (2..18).chain([28, 29]) {
        assert_eq!(chip.register(register), 0x40 + register, "r{register} is the caller's");
    }
    let ram = |address: u16| chip.ram()[usize::from(address - 0x100)];
    let four = |at: u16| u32::from_le_bytes([ram(at), ram(at + 1), ram(at + 2), ram(at + 3)]);
    let train = (ram(TRAIN) != 0).then(|| Train {
        count: ram(TRAIN),
        backward: ram(TRAIN + 1) != 0,
        first: four(TRAIN + 2),
        interval: four(TRAIN + 6),
    });
    ((PATH..PATH + 51).map(ram).collect(), train, cycles)
}

fn line(random: &mut Random) -> String {
    let reach = [10, 1000, 30_000, 2_000_000, i64::from(i32::MAX)][random.below(5) as usize];
    let steps = random.below(2 * reach) - reach;
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

#[test]
fn the_assembly_is_the_path() {
    let (mut chip, mut random, mut most, mut steps) = (chip(), Random(0x9e37_79b9_7f4a_7c15), 0, 0);
    let (mut reader, mut paths) = (Reader::new(), [const { Path::new() }; 4]);
    for round in 0..60_000 {
        if round % 40 == 0 {
            for byte in line(&mut random).bytes() {
                if let Heard::Command(_) = reader.push::<InMemory>(byte) {
                    reader.obey(&mut paths);
                }
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
    println!("at most {most} cycles a tick; {steps} steps");
    assert!(most <= MOST_CYCLES_AN_AXIS && steps > 60_000, "{most} cycles, {steps} steps");
}

#[test]
fn what_a_tick_costs() {
    for (name, commands, most) in [
        ("idle", "", 700),
        ("1234 steps/s", "v x 1234\n", 1300),
        ("4000 steps/s", "l x 10000 100000\nv x 4000\n", 1300),
        ("10 000 steps/s", "l x 10000 100000\nv x 10000\n", 1350),
        ("10 000 steps/s with a ramp", "l x 10000 100000\ns x 12000\na x 100000\n", MOST_CYCLES_AN_AXIS),
    ] {
        let (mut chip, mut reader, mut paths) = (chip(), Reader::new(), [const { Path::new() }; 4]);
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
