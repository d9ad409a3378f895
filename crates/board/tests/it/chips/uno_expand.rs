//! The firmware's expansion, in assembly, against the recurrence: random registers, on the emulated chip.

use pulsetrain_board::virtual_uno;
use pulsetrain_core::avr::Registers;
use pulsetrain_emulator::Atmega328p;
use pulsetrain_testkit::Random;
use pulsetrain_testkit::lab::{SYMBOLS, address};

/// What a step of a list or a ring may cost, cycles: into the ring, into a list, and both with long pulses. They take 19.5, 18.5, 36.5
/// and 25.5 (`cargo xtask bench uno` has the rates that come of it).
const MOST_CYCLES_A_STEP: [u64; 4] = [25, 21, 40, 28];
/// The same of steps that are all near one another; they take 16.5.
const MOST_NEAR_CYCLES_A_STEP: u64 = 19;
/// Length of a long pulse, ticks.
const PULSE: u8 = 160;

const REGISTERS: u16 = 0x500;
const TICKS: u16 = 0x600;
const STACK: u16 = 0x8f0;
/// Where the ring's tail is: data address of OCR0A.
const TAIL_AT: u16 = 0x47;
/// Of a motor, behind the registers: whether all intervals are shorter than 256 ticks; and the bit that says, to a list, that bit 8 and those above it are the same of all of them.
const PRECHECKED: u16 = REGISTERS + 61;
const HIGH_FIXED: u8 = 0x80;
const RETURN: u16 = 0x3ff0;

fn bytes_of(registers: &Registers) -> Vec<u8> {
    let mut bytes = registers.fraction.to_le_bytes().to_vec();
    bytes.extend(registers.tick.to_le_bytes());
    bytes.extend(registers.interval_low.to_le_bytes());
    bytes.push(registers.interval_high);
    bytes.extend(registers.add.to_le_bytes());
    bytes.extend(registers.add2.to_le_bytes());
    bytes.extend(registers.left.to_le_bytes());
    bytes
}

/// Calls the function at word `entry` with the registers and `n`, ticks from `at` on; gives the cycles that it took.
fn call(chip: &mut Atmega328p, entry: u16, at: u16, is_long: bool, registers: &Registers, n: u8) -> u64 {
    for (address, byte) in (REGISTERS..).zip(bytes_of(registers)) {
        chip.write_data(address, byte, &mut ());
    }
    for (address, byte) in [(0x5d, STACK), (0x5e, STACK >> 8), (STACK + 1, RETURN >> 8), (STACK + 2, RETURN)] {
        chip.write_data(address, byte.to_le_bytes()[0], &mut ());
    }
    for (register, value) in [(28, REGISTERS), (30, at)] {
        let [low, high] = value.to_le_bytes();
        chip.set_register(register, low);
        chip.set_register(register + 1, high);
    }
    // In a ring, a step toggles 4; what was pending began with 0x22 and has 6 as its first byte once it is published, and the
    // last one 7.
    chip.write_data(TICKS, 0x22, &mut ());
    chip.set_register(17, if is_long { PULSE } else { 6 });
    chip.set_register(20, n);
    chip.set_register(18, 4);
    chip.set_register(19, TAIL_AT.to_le_bytes()[0]);
    chip.set_register(6, TICKS.to_le_bytes()[0]);
    chip.set_register(7, 7);
    chip.set_register(1, 0);
    chip.set_pc(entry);
    let begin = chip.cycle();
    while chip.pc() != RETURN {
        chip.step(&mut ());
        assert!(chip.cycle() - begin < 100_000, "it does not return");
    }
    chip.cycle() - begin
}

/// A chip with the image, and where its expanders are: for rings, for lists, and the long pulses of both.
fn chip() -> (Atmega328p, [u16; 4]) {
    let names = ["steps_expand_ring", "steps_expand_list", "steps_expand_ring_long", "steps_expand_list_long"];
    (Atmega328p::new(&virtual_uno::image()).unwrap(), names.map(|name| address(SYMBOLS, name)))
}

/// What `n` steps make of the registers, and their ticks.
fn advanced(registers: &Registers, n: u8) -> (Registers, Vec<u16>) {
    let mut registers = *registers;
    let ticks = (0..n).map(|_| {
        registers.advance();
        registers.left -= 1;
        registers.tick as u16
    });
    let ticks = ticks.collect();
    (registers, ticks)
}

#[test]
fn expansion_is_the_recurrence() {
    let (mut chip, entries) = chip();
    // A ring's steps are published twelve at a time, and four while 56 of its 62 groups are free.
    let published: &[u16] = &[4, 8, 20];
    let mut random = Random::new(1);
    let mut lawful = [0; 4];
    for round in 0..4000 {
        let n = 1 + (random.next() % 31) as u8;
        // Intervals of 2500 to 15 500 ticks, changing by so much that they stay positive and below 32 768 for 31 steps.
        let ticks = 2500 + random.next() % 13_000;
        let steady = round % 4 == 0;
        let change = |random: &mut Random, range: i64| (random.next() as i64 % range) as i32;
        let mut registers = Registers {
            fraction: random.next() as u16,
            tick: random.next() as u32,
            interval_low: (ticks << 16) as u32 | u32::from(random.next() as u16),
            interval_high: 0,
            add: if steady { 0 } else { change(&mut random, 30 << 16) },
            add2: if steady { 0 } else { change(&mut random, 2 << 16) },
            left: u16::from(n) + (random.next() % 1000) as u16,
        };
        if round % 8 == 1 {
            // The tick's lower three bytes wrap.
            registers.tick = (random.next() as u32) << 24 | 0x00ff_f000 | u32::from(random.next() as u16);
        }
        let (expected, ticks) = advanced(&registers, n);
        for (kind, &entry) in entries.iter().enumerate() {
            let cycles = call(&mut chip, entry, TICKS, kind >= 2, &registers, n);
            let ram = |address: u16| chip.ram()[usize::from(address - 0x100)];
            let after: Vec<_> = (0..21).map(|at| ram(REGISTERS + at)).collect();
            assert_eq!(after, bytes_of(&expected), "round {round}, {n} steps of {registers:?}");
            for (index, tick) in (0..).zip(&ticks) {
                let [low, high] = tick.to_le_bytes();
                let [end_low, end_high] = tick.wrapping_add(PULSE.into()).to_le_bytes();
                match kind {
                    0 => {
                        // A group of four bytes: next's tick is in the second and third; what it toggles is there already, but
                        // for what is published at once.
                        let group = TICKS + 4 * index;
                        assert_eq!([ram(group + 1), ram(group + 2)], [high, low]);
                        assert_eq!(ram(TICKS), 6);
                        let last = index + 1 == u16::from(n);
                        if last || published.contains(&(index + 1)) {
                            assert_eq!(ram(group + 4), if last { 7 } else { 4 });
                        }
                    }
                    1 => assert_eq!([ram(TICKS + 2 * index), ram(TICKS + 2 * index + 1)], [low, high]),
                    2 => {
                        // One group for each end of the pulse.
                        let group = TICKS + 8 * index;
                        assert_eq!([ram(group + 1), ram(group + 2)], [high, low]);
                        assert_eq!([ram(group + 4), ram(group + 7)], [4, 0]);
                        assert_eq!([ram(group + 5), ram(group + 6)], [end_high, end_low]);
                        assert_eq!([ram(group + 8), ram(group + 11)], [4, 0]);
                    }
                    _ => {
                        let list = TICKS + 4 * index;
                        let said = [ram(list), ram(list + 1), ram(list + 2), ram(list + 3)];
                        assert_eq!(said, [low, high, end_low, end_high]);
                    }
                }
            }
            if !steady && n == 30 {
                lawful[kind] = cycles;
            } else if !steady && n == 20 && lawful[kind] != 0 {
                let each = (lawful[kind] - cycles) / 10;
                assert!(each <= MOST_CYCLES_A_STEP[kind], "{kind}: {each} cycles a step");
            }
        }
    }
}

/// How far the ring's expander comes.
#[derive(Debug, PartialEq, Eq)]
struct Filled {
    registers: Vec<u8>,
    /// Low bytes of the ticks that were put in.
    ticks: Vec<u16>,
    cycles: u64,
}

/// Expands `n` steps into a ring of a page, from its beginning, that is played up to `tail`.
fn fill(chip: &mut Atmega328p, entry: u16, registers: &Registers, n: u8, tail: u8, prechecked: u8) -> Filled {
    chip.write_data(TAIL_AT, tail, &mut ());
    chip.write_data(PRECHECKED, prechecked, &mut ());
    let cycles = call(chip, entry, TICKS, false, registers, n);
    chip.write_data(PRECHECKED, 0, &mut ());
    let ram = |address: u16| chip.ram()[usize::from(address - 0x100)];
    let head = u16::from(chip.register(24));
    let tick = |group: u16| u16::from_le_bytes([ram(TICKS + group + 2), ram(TICKS + group + 1)]);
    assert_eq!(ram(TICKS + head), 7, "the last one is pending");
    Filled {
        registers: (0..21).map(|at| ram(REGISTERS + at)).collect(),
        ticks: (0..head).step_by(4).map(tick).collect(),
        cycles,
    }
}

/// Of intervals whose bit 8 and those above it stay, an expander for lists works out the lower ones
/// alone. So does that for the ring behind lists, which may write beyond its page's end: it goes on where the ring begins.
#[test]
fn even_lists_are_the_recurrence() {
    const START: u16 = 0xa0;
    const GROUPS: u64 = 24;
    let (mut chip, [_, list, ..]) = chip();
    let ring = address(SYMBOLS, "steps_expand_shield_b");
    let mut random = Random::new(3);
    for round in 0..4000 {
        let n = 1 + (random.next() % 31) as u8;
        // 100 ticks either way at most, in 31 steps.
        let steady = round % 4 == 0;
        let change = |random: &mut Random, range: i64| if steady { 0 } else { (random.next() as i64 % range) as i32 };
        let ticks = (256 * (1 + random.next() % 6)) + 128;
        let registers = Registers {
            fraction: random.next() as u16,
            tick: random.next() as u32,
            interval_low: (ticks << 16) as u32 | u32::from(random.next() as u16),
            interval_high: 0,
            add: change(&mut random, 2 << 16),
            add2: change(&mut random, 5000),
            left: u16::from(n) + (random.next() % 1000) as u16,
        };
        for (prechecked, is_ring) in [(HIGH_FIXED | 1, false), (HIGH_FIXED | 1, true), (0, true)] {
            let n = if is_ring { n.min(23) } else { n };
            let first = START + 4 * random.below(GROUPS) as u16;
            let (expected, ticks) = advanced(&registers, n);
            chip.write_data(PRECHECKED, prechecked, &mut ());
            let (entry, at) = if is_ring { (ring, TICKS + first) } else { (list, TICKS) };
            call(&mut chip, entry, at, false, &registers, n);
            let ram = |address: u16| chip.ram()[usize::from(address - 0x100)];
            let after: Vec<_> = (0..21).map(|at| ram(REGISTERS + at)).collect();
            assert_eq!(after, bytes_of(&expected), "round {round}, {n} steps of {registers:?}");
            let group = |index: u16| TICKS + START + (first - START + 4 * index) % (0x100 - START);
            let written: Vec<_> = (0..u16::from(n))
                .map(|index| {
                    let [low, high] = if is_ring {
                        [group(index) + 2, group(index) + 1]
                    } else {
                        [TICKS + 2 * index, TICKS + 2 * index + 1]
                    };
                    u16::from_le_bytes([ram(low), ram(high)])
                })
                .collect();
            assert_eq!(written, ticks, "round {round}, {n} steps of {registers:?}");
            if is_ring {
                assert_eq!(u16::from(chip.register(24)), group(n.into()) - TICKS, "the last one");
            }
        }
    }
}

#[test]
fn a_ring_takes_what_it_has_room_for() {
    let (mut chip, [entry, ..]) = chip();
    let mut random = Random::new(2);
    let mut nearest = (0, 0);
    for round in 0..4000 {
        let n = 1 + (random.next() % 100) as u8;
        // Intervals of 100 to 200 ticks that stay between 60 and 255 for 100 steps, as those of prechecked segments do; or
        // that do not change.
        let steady = round % 4 == 0;
        let ticks = 100 + random.next() % 100;
        let change = |random: &mut Random, range: i64| if steady { 0 } else { (random.next() as i64 % range) as i32 };
        let registers = Registers {
            fraction: random.next() as u16,
            tick: random.next() as u32,
            interval_low: (ticks << 16) as u32 | u32::from(random.next() as u16),
            interval_high: 0,
            add: change(&mut random, 12_000),
            add2: change(&mut random, 200),
            left: u16::from(n) + (random.next() % 1000) as u16,
        };
        let room = 14 + (random.next() % 50) as u8;
        let tail = (4 * room + 1).wrapping_add((random.next() % 3) as u8);
        let prechecked = (random.next() % 2) as u8;
        let filled = fill(&mut chip, entry, &registers, n, tail, prechecked);
        // So much that fewer than four groups are left, or all.
        let made = filled.ticks.len();
        assert!(made == usize::from(n) || (room as usize - 3..=room as usize).contains(&made), "{made} of {n}, {room}");
        let mut expected = registers;
        for tick in &filled.ticks {
            expected.advance();
            expected.left -= 1;
            assert_eq!(expected.tick as u16, *tick, "round {round}: {registers:?}");
        }
        assert_eq!(filled.registers, bytes_of(&expected), "round {round}, {made} of {n} steps of {registers:?}");
        assert_eq!(chip.register(5), n - made as u8);
        // Where there is less room than for 32, all are published at once.
        if prechecked == 1 && !steady && made == usize::from(n) && room < 32 {
            match n {
                14 => nearest.0 = filled.cycles,
                24 => nearest.1 = filled.cycles,
                _ => {}
            }
        }
    }
    assert!(nearest.1 - nearest.0 <= 10 * MOST_NEAR_CYCLES_A_STEP, "{nearest:?}");
}
