//! The SAM3X8E around its processor: clocks, timers, pins, flash, UART with DMA, matrix, resets, watchdog. Sections are
//! those of Atmel-11057C.

use crate::random::Random;
use pulsetrain_emulator::{GpioEdge, Level, LineByte, Observer, Sam3x8e, Sam3x8eTiming, UartByte};

const TC0: u32 = 0x4008_0000;
const MATRIX: u32 = 0x400e_0400;
const PMC: u32 = 0x400e_0600;
const UART: u32 = 0x400e_0800;
const EEFC0: u32 = 0x400e_0a00;
const EEFC1: u32 = 0x400e_0c00;
const PIOA: u32 = 0x400e_0e00;
const PIOB: u32 = 0x400e_1000;
const PIOD: u32 = 0x400e_1400;
const RSTC: u32 = 0x400e_1a00;
const WATCHDOG: u32 = 0x400e_1a50;
const GPBR: u32 = 0x400e_1a90;
const RAM: u32 = Sam3x8e::RAM_ADDRESS;
const FLASH: u32 = Sam3x8e::FLASH_ADDRESS;

/// Pins of port B and D, by their numbers.
const PB: u8 = 32;
const PD: u8 = 96;

#[derive(Clone, Default)]
struct Seen {
    edges: Vec<GpioEdge>,
    sent: Vec<UartByte>,
    frequencies: Vec<u64>,
    resets: u32,
}

impl Observer for Seen {
    fn gpio(&mut self, edge: GpioEdge) {
        self.edges.push(edge);
    }

    fn transmit(&mut self, byte: UartByte) {
        self.sent.push(byte);
    }

    fn clock_frequency(&mut self, _: u64, hz: u64) {
        self.frequencies.push(hz);
    }

    fn watchdog_reset(&mut self, _: u64) {
        self.resets += 1;
    }
}

struct Bench {
    chip: Sam3x8e,
    seen: Seen,
}

/// A flash with the stack at the end of RAM and a program behind two words of vectors.
fn flash(program: &[u16]) -> Vec<u8> {
    let vectors = [0x2008_8000u32, FLASH + 0x201].map(u32::to_le_bytes).concat();
    let mut image = vectors;
    image.resize(0x200, 0);
    image.extend(program.iter().flat_map(|half| half.to_le_bytes()));
    image
}

impl Bench {
    /// A processor that sleeps; registers are written by hand.
    fn new() -> Bench {
        let mut bench = Bench::with(&[0xbf30, 0xe7fd], Sam3x8eTiming::LIKELY);
        bench.run(100);
        bench
    }

    fn with(program: &[u16], timing: Sam3x8eTiming) -> Bench {
        Bench { chip: Sam3x8e::new(&flash(program), timing).expect("it fits"), seen: Seen::default() }
    }

    fn now(&self) -> u64 {
        self.chip.cycle()
    }

    fn run(&mut self, cycles: u64) {
        let end = self.now() + cycles;
        self.chip.run(end, &mut self.seen);
    }

    fn set(&mut self, address: u32, value: u32) {
        self.chip.write(address, value, &mut self.seen);
    }

    fn get(&mut self, address: u32) -> u32 {
        self.chip.read(address, &mut self.seen)
    }

    /// The edges of a pin since the last call: cycle, and whether it rose.
    fn edges(&mut self, pin: u8) -> Vec<(u64, bool)> {
        let edges = std::mem::take(&mut self.seen.edges);
        edges.iter().filter(|edge| edge.gpio == pin).map(|edge| (edge.cycle, edge.level.is_high())).collect()
    }

    /// Gives all peripherals their clocks.
    fn clock_all(&mut self) {
        self.set(PMC + 0x10, u32::MAX);
        self.set(PMC + 0x100, u32::MAX);
    }

    /// Waits until a register has a bit.
    fn wait_for(&mut self, address: u32, bit: u32) {
        let end = self.now() + 10_000_000;
        while self.get(address) >> bit & 1 == 0 {
            self.run(1);
            assert!(self.now() < end, "{address:#x} never gets bit {bit}");
        }
    }

    /// What Arduino's start-up does: the crystal of 12 MHz, PLLA at 168 MHz, its half as the master clock.
    fn start_clocks(&mut self) {
        self.set(PMC + 0x20, 0x0137_0809);
        self.wait_for(PMC + 0x68, 0);
        self.set(PMC + 0x28, 0x200d_3f01);
        self.wait_for(PMC + 0x68, 1);
        self.set(PMC + 0x30, 0x12);
        self.run(2);
    }
}

/// §28: from the RC oscillator's 4 MHz to 84 MHz; a source is ready when its time has passed.
#[test]
fn clocks() {
    let mut bench = Bench::new();
    assert_eq!((bench.chip.clock_hz(), bench.get(PMC + 0x30)), (4_000_000, 1));
    bench.set(PMC + 0x20, 0x0137_0809);
    assert_eq!(bench.get(PMC + 0x68) & 3, 0, "the crystal takes 64 slow clocks");
    bench.run(50);
    assert_eq!(bench.chip.clock_hz(), 12_000_000);
    bench.set(PMC + 0x20, 0x0109);
    assert_eq!(bench.get(PMC + 0x20), 0x0100_0809, "nothing is written without the key");
    bench.start_clocks();
    assert_eq!(bench.chip.clock_hz(), 84_000_000);
    assert_eq!(bench.seen.frequencies.last(), Some(&84_000_000));
    // The UTMI's PLL, 480 MHz: a third of its half is 80 MHz.
    bench.set(PMC + 0x1c, 1 << 16 | 3 << 20);
    bench.wait_for(PMC + 0x68, 6);
    bench.set(PMC + 0x30, 0x2073);
    assert_eq!(bench.chip.clock_hz(), 80_000_000);
    bench.set(PMC + 0x10, u32::MAX);
    bench.set(PMC + 0x14, 1 << 11);
    assert_eq!((bench.get(PMC + 0x18), bench.get(PMC + 0x108)), (0xffff_f700, 0));
}

/// Waveform mode, MCK/2, EEVT XC0 so that TIOB is an output; RA sets A and RC clears it.
const WAVE: u32 = 1 << 15 | 1 << 10 | 1 << 16 | 2 << 18;

/// A bench whose channel 0 drives PB25 (TIOA0) and PB27 (TIOB0).
fn timer() -> Bench {
    let mut bench = Bench::new();
    bench.clock_all();
    bench.set(PIOB + 0x70, 1 << 25 | 1 << 27);
    bench.set(PIOB + 4, 1 << 25 | 1 << 27);
    // Both are outputs, which are low.
    bench.set(TC0 + 4, WAVE);
    bench.edges(PB);
    bench
}

/// §36: the counter runs free; compare registers are not buffered.
#[test]
fn timer_matches() {
    let mut bench = timer();
    for (offset, value) in [(0x14, 100), (0x1c, 110), (0x24, 1 << 2), (0, 5)] {
        bench.set(TC0 + offset, value);
    }
    let start = bench.now();
    bench.run(1000);
    // The counter is 0 in the tick after the trigger; the level changes in the cycle after the match.
    let first = start / 2 * 2 + 2 + 200 + 1;
    assert_eq!(bench.edges(PB + 25), [(first, true), (first + 20, false)]);
    assert_eq!(bench.get(TC0 + 0x10), ((bench.now() - start) / 2 - 1) as u32);
    assert_eq!(bench.get(TC0 + 0x20), 1 << 4 | 1 << 2 | 1 << 16, "CPAS, CPCS, the clock is on");
    assert_eq!(bench.get(TC0 + 0x20), 1 << 16, "reading has cleared them");

    // A value that the counter has passed matches a turn later, 102 s at 84 MHz.
    let counter = bench.get(TC0 + 0x10);
    bench.set(TC0 + 0x14, counter);
    bench.run(1000);
    assert_eq!(bench.edges(PB + 25), []);
    let counter = bench.get(TC0 + 0x10);
    bench.set(TC0 + 0x14, counter + 2);
    bench.run(6);
    assert_eq!(bench.edges(PB + 25).len(), 1);
    bench.set(TC0 + 0x14, 5);
    let turn = 2 * ((1u64 << 32) - u64::from(bench.get(TC0 + 0x10)));
    bench.edges(PB + 25);
    bench.set(TC0 + 0x1c, 3);
    bench.set(WATCHDOG + 4, 1 << 15);
    bench.run(turn + 100);
    assert_eq!(bench.edges(PB + 25).iter().map(|edge| edge.1).collect::<Vec<_>>(), [false, true]);
    assert_eq!(bench.get(TC0 + 0x20) & 0xff, 1 | 1 << 2 | 1 << 3 | 1 << 4, "it has overflowed; RB is 0");
}

/// §36: RC as the end of a period; toggling; TIOB by RB; stops at RC.
#[test]
fn timer_waveforms() {
    let mut bench = timer();
    let toggles = 1 << 15 | 2 << 13 | 1 << 10 | 3 << 18 | 1 << 24 | 2 << 26;
    for (offset, value) in [(4, toggles), (0x18, 30), (0x1c, 50), (0, 5)] {
        bench.set(TC0 + offset, value);
    }
    bench.run(1000);
    let edges = std::mem::take(&mut bench.seen.edges);
    let of = |pin: u8| edges.iter().filter(|edge| edge.gpio == pin).map(|edge| edge.cycle).collect::<Vec<_>>();
    assert!(of(PB + 25).windows(2).all(|pair| pair[1] - pair[0] == 100) && of(PB + 25).len() == 9);
    let widths: Vec<_> = of(PB + 27).windows(2).map(|pair| pair[1] - pair[0]).collect();
    assert!(widths.len() > 15 && widths.iter().zip([40, 60].iter().cycle()).all(|(width, expected)| width == expected));

    // Without an external event other than TIOB, TIOB is no output.
    bench.set(TC0 + 4, toggles & !(3 << 10));
    assert!(!bench.chip.is_output(PB + 27) && bench.chip.is_output(PB + 25));

    // CPCSTOP: one pulse for each trigger.
    bench.set(TC0 + 4, WAVE | 1 << 6);
    for (offset, value) in [(0x14, 5), (0x1c, 9)] {
        bench.set(TC0 + offset, value);
    }
    bench.set(TC0, 4);
    bench.run(500);
    bench.edges(0);
    for _ in 0..3 {
        bench.set(TC0, 4);
        bench.run(500);
        assert_eq!(bench.edges(PB + 25).len(), 2);
    }
    assert_eq!(bench.get(TC0 + 0x10), 9);
}

/// §36.6.3: the clocks, which stop with the peripheral's; all channels of a block begin together.
#[test]
fn timer_clocks() {
    for (choice, divider) in [(0, 2), (1, 8), (2, 32), (3, 128), (4, 4_000_000 / 32_768)] {
        let mut bench = timer();
        bench.set(TC0 + 4, 1 << 15 | choice);
        bench.set(TC0, 5);
        let start = bench.now();
        bench.run(100_000);
        let expected = (bench.now() / divider - start / divider - 1) as u32;
        assert_eq!(bench.get(TC0 + 0x10), expected, "{choice}");
        bench.set(PMC + 0x14, 1 << 27);
        bench.run(1000);
        let stopped = bench.get(TC0 + 0x10);
        bench.run(1000);
        assert_eq!(bench.get(TC0 + 0x10), stopped);
    }
    let mut bench = timer();
    for channel in 0..3 {
        bench.set(TC0 + 0x40 * channel + 4, 1 << 15);
        bench.set(TC0 + 0x40 * channel, 1);
        bench.run(7);
        assert_eq!(bench.get(TC0 + 0x40 * channel + 0x10), 0, "enabled, and waits for a trigger");
    }
    bench.set(TC0 + 0xc0, 1);
    bench.run(500);
    let counters = [0, 0x40, 0x80].map(|channel| bench.get(TC0 + channel + 0x10));
    assert!(counters[0] > 240 && counters == [counters[0]; 3]);
}

/// §31: set, clear, and one store for all pins whose OWSR bit is set; pull-ups; peripherals.
#[test]
fn pins() {
    let mut bench = Bench::new();
    bench.clock_all();
    assert_eq!(bench.get(PIOD + 0x3c), u32::MAX, "pull-ups are on after a reset");
    bench.set(PIOD + 0x30, 0b10);
    bench.set(PIOD + 0x10, 0b11);
    let now = bench.now();
    assert_eq!(bench.edges(PD), [(now + 1, false)], "PD0 falls, PD1 stays high");
    bench.run(10);
    bench.set(PIOD + 0x30, 1);
    bench.run(10);
    bench.set(PIOD + 0x34, 1);
    assert_eq!(bench.edges(PD), [(now + 11, true), (now + 21, false)]);
    bench.set(PIOD + 0x38, u32::MAX);
    assert_eq!(bench.get(PIOD + 0x38), 0b10, "no pin is writable so");
    bench.set(PIOD + 0xa0, 0b101);
    bench.set(PIOD + 0x38, 0b1001);
    assert_eq!(bench.get(PIOD + 0x38), 0b0011);

    bench.chip.set_input(PD + 8, Some(Level::Low));
    assert_eq!(bench.get(PIOD + 0x3c) >> 8 & 1, 0);
    bench.chip.set_input(PD + 8, None);
    bench.set(PIOD + 0x60, 1 << 8);
    assert_eq!((bench.chip.pin(PD + 8), bench.get(PIOD + 0x68)), (Level::Low, 1 << 8));

    // A peripheral without an output does not drive its pin.
    bench.set(PIOD + 4, 1);
    assert!(!bench.chip.is_output(PD) && bench.chip.is_output(PD + 1));
}

/// §31: any edge, or one, or a level; reading the status clears it; nothing without the clock.
#[test]
fn pin_interrupts() {
    let mut bench = Bench::new();
    let pulse = |bench: &mut Bench| {
        bench.chip.set_input(3, Some(Level::Low));
        let fell = bench.get(PIOA + 0x4c);
        bench.chip.set_input(3, Some(Level::High));
        (fell >> 3 & 1, bench.get(PIOA + 0x4c) >> 3 & 1)
    };
    assert_eq!(pulse(&mut bench), (0, 0));
    bench.clock_all();
    assert_eq!(pulse(&mut bench), (1, 1));
    bench.set(PIOA + 0xb0, 1 << 3);
    assert_eq!(pulse(&mut bench), (1, 0), "falling edges");
    bench.set(PIOA + 0xd4, 1 << 3);
    assert_eq!(pulse(&mut bench), (0, 1), "rising edges");
    bench.set(PIOA + 0xc4, 1 << 3);
    assert_eq!(pulse(&mut bench), (1, 1), "a high level: what was there before the fall, and again after it");
    assert_eq!(bench.get(PIOA + 0x4c) >> 3 & 1, 1, "as long as it lasts");
}

/// §9: each peripheral's line is the interrupt of its number.
#[test]
fn interrupt_numbers() {
    let tc = |channel: u32| TC0 + 0x4000 * (channel / 3) + 0x40 * (channel % 3);
    let timer = |channel| {
        vec![(tc(channel) + 0x24, 1 << 4), (tc(channel) + 4, WAVE), (tc(channel) + 0x1c, 9), (tc(channel), 5)]
    };
    let port = |port: u32| {
        vec![
            (PIOA + 0x200 * port + 0x40, 1),
            (PIOA + 0x200 * port + 0xb0, 1),
            (PIOA + 0x200 * port + 0xc4, 1),
            (PIOA + 0x200 * port + 0xd4, 1),
        ]
    };
    let mut cases = vec![(5, vec![(PMC + 0x60, 1 << 3)]), (6, vec![(EEFC0, 1)]), (7, vec![(EEFC1, 1)])];
    cases.push((8, vec![(UART, 1 << 6), (UART + 8, 1 << 1)]));
    cases.extend((0..4).map(|number| (11 + number, port(number))));
    cases.extend((0..9).map(|channel| (27 + channel, timer(channel))));
    for (number, writes) in cases {
        // str r0, [r1]; str r0, [r1, #4]; b to itself
        let mut bench = Bench::with(&[0x6008, 0x6048, 0xe7fe], Sam3x8eTiming::LIKELY);
        bench.chip.poke(FLASH + 4 * (16 + number), &(FLASH + 0x205).to_le_bytes());
        bench.chip.cpu_mut().set_register(0, u32::MAX);
        bench.chip.cpu_mut().set_register(1, 0xe000_e100);
        bench.clock_all();
        bench.run(50);
        assert_eq!(bench.chip.cpu().xpsr() & 0x1ff, 0, "{number}");
        for (address, value) in writes {
            bench.set(address, value);
        }
        bench.run(200);
        assert_eq!((bench.chip.cpu().xpsr() & 0x1ff, bench.chip.fault()), (16 + number, None));
    }
}

/// §18: the latch is written by words; EWP erases and writes a page; WP only clears bits.
#[test]
fn flash_commands() {
    let mut bench = Bench::with(&[0xe7fe], Sam3x8eTiming::LIKELY);
    bench.set(WATCHDOG + 4, 1 << 15);
    let command = |bench: &mut Bench, eefc: u32, command: u32, argument: u32| {
        bench.set(eefc + 4, 0x5a00_0000 | argument << 8 | command);
        let status = bench.get(eefc + 8);
        let began = bench.now();
        if status >> 1 == 0 {
            bench.wait_for(eefc + 8, 0);
        }
        bench.run(1);
        (status >> 1, (bench.now() - began - 1) * 1000 / 4_000_000)
    };
    // The page 3 of plane 1. A program in RAM, of one instruction and a branch to itself, writes the latch.
    let page = FLASH + 0x4_0000 + 3 * 256;
    let latch = |bench: &mut Bench, offset: u32, value: u32, store: u16| {
        bench.chip.poke(RAM, &[store, 0xe7fe].map(u16::to_le_bytes).concat());
        for (register, value) in [(0, value), (1, page + offset), (15, RAM)] {
            bench.chip.cpu_mut().set_register(register, value);
        }
        bench.chip.step(&mut bench.seen);
    };
    let (str, strh) = (0x6008, 0x8008);
    latch(&mut bench, 0, 0x1234_5678, str);
    latch(&mut bench, 4, 0, strh);
    latch(&mut bench, 8, 0xabcd_ef01, str);
    assert_eq!(command(&mut bench, EEFC1, 3, 3), (0, 4));
    assert_eq!([0, 4, 8].map(|at| bench.get(page + at)), [0x1234_5678, u32::MAX, 0xabcd_ef01]);
    assert_eq!(bench.get(FLASH + 3 * 256), u32::MAX, "the other plane stays");
    latch(&mut bench, 0, 0xffff_0000, str);
    assert_eq!(command(&mut bench, EEFC1, 1, 3), (0, 2));
    assert_eq!(bench.get(page), 0x1234_0000, "bits are only cleared");

    // Locks: the region of pages 0 to 63.
    command(&mut bench, EEFC1, 8, 0);
    command(&mut bench, EEFC1, 10, 0);
    assert_eq!(bench.get(EEFC1 + 0xc), 1);
    assert_eq!(command(&mut bench, EEFC1, 3, 3).0, 2, "FLOCKE");
    assert_eq!(command(&mut bench, EEFC1, 5, 0).0, 2);
    command(&mut bench, EEFC1, 9, 0);
    assert_eq!(command(&mut bench, EEFC1, 5, 0), (0, 11));
    assert_eq!(bench.get(page), u32::MAX);

    // Errors: a wrong key, no such command, no such page, a command while one is under way.
    for wrong in [0x5b00_0001, 0x5a00_0006, 0x5a00_0001 | 1024 << 8] {
        bench.set(EEFC0 + 4, wrong);
        assert_eq!((bench.get(EEFC0 + 8), bench.get(EEFC0 + 8)), (0b11, 1), "{wrong:#x}");
    }
    bench.set(EEFC1 + 4, 0x5a00_0003);
    bench.set(EEFC1 + 4, 0x5a00_0003);
    assert_eq!(bench.get(EEFC1 + 8), 0b10);
    bench.wait_for(EEFC1 + 8, 0);

    // GPNVM, and the unique number at the plane's beginning.
    command(&mut bench, EEFC0, 13, 0);
    assert_eq!(bench.get(EEFC0 + 0xc), 0b010);
    command(&mut bench, EEFC0, 12, 1);
    command(&mut bench, EEFC0, 13, 0);
    assert_eq!(bench.get(EEFC0 + 0xc), 0);
    bench.chip.set_unique_id(*b"0123456789abcdef");
    let before = bench.get(FLASH);
    command(&mut bench, EEFC0, 14, 0);
    assert_eq!(bench.get(FLASH), u32::from_le_bytes(*b"0123"));
    command(&mut bench, EEFC0, 15, 0);
    assert_eq!(bench.get(FLASH), before);
    command(&mut bench, EEFC0, 0, 0);
    assert_eq!([(); 4].map(|()| bench.get(EEFC0 + 0xc))[1..], [0x4_0000, 256, 1]);

    bench.chip.erase();
    assert!(bench.chip.flash().iter().all(|byte| *byte == 0xff));
    bench.chip.reset(&mut bench.seen);
    bench.run(10);
    assert!(bench.chip.cpu().is_locked_up(), "the ROM is not emulated");
}

/// Code in plane 0 runs while plane 1 is written, and whoever reads plane 1 waits.
#[test]
fn two_planes() {
    // adds r2, #1; b to it
    let mut bench = Bench::with(&[0x3201, 0xe7fd], Sam3x8eTiming::LIKELY);
    bench.set(WATCHDOG + 4, 1 << 15);
    bench.set(EEFC1 + 4, 0x5a00_0003);
    bench.run(10_000);
    assert!(bench.chip.cpu().register(2) > 2000);
    bench.chip.poke(FLASH + 0x200, &[0x08, 0x68]); // ldr r0, [r1]
    bench.chip.cpu_mut().set_register(1, FLASH + 0x4_0000);
    bench.chip.cpu_mut().set_register(15, FLASH + 0x200);
    let began = bench.now();
    bench.chip.step(&mut bench.seen);
    let taken = (bench.now() - began) * 1_000_000 / 4_000_000;
    assert!((1000..4600).contains(&taken), "{taken} us");
}

/// §18: with 4 wait states a new line of 16 bytes costs 4 cycles; less if it was read ahead.
#[test]
fn wait_states() {
    let cycles = |timing: Sam3x8eTiming, states: u32, flags: u32| {
        let mut bench = Bench::with(&[0xbf00; 256], timing);
        bench.set(MATRIX + 0x4c, 1 << 16);
        bench.set(EEFC0, states << 8 | flags);
        bench.run(8);
        let began = bench.now();
        let count = bench.chip.cpu().instructions();
        while bench.chip.cpu().instructions() < count + 80 {
            bench.chip.step(&mut bench.seen);
        }
        bench.now() - began
    };
    let (likely, pessimistic) = (Sam3x8eTiming::LIKELY, Sam3x8eTiming::PESSIMISTIC);
    assert_eq!(cycles(likely, 0, 0), 80);
    // Eight instructions of a cycle in a line: it was read meanwhile.
    assert_eq!(cycles(likely, 4, 0), 80);
    assert_eq!(cycles(pessimistic, 4, 0), 80 + 10 * 4);
    assert_eq!(cycles(likely, 4, 1 << 16), 80 + 10 * 4, "SCOD");
    // Lines of 8 bytes: four instructions, and a line takes 5 cycles.
    assert_eq!(cycles(likely, 4, 1 << 24), 80 + 20);
    assert_eq!(cycles(pessimistic, 4, 1 << 24), 80 + 20 * 4);
}

/// Loads and stores of peripherals and RAM; without a default master (§21) each costs a cycle more.
#[test]
fn accesses() {
    let cycles = |code: &[u16], address: u32, default_master: bool, timing: Sam3x8eTiming| {
        let mut bench = Bench::with(&[code, &[0xbf00; 8]].concat(), timing);
        for slave in 0..9 {
            bench.set(MATRIX + 0x40 + 4 * slave, u32::from(default_master) << 16);
        }
        bench.chip.cpu_mut().set_register(1, address);
        bench.chip.cpu_mut().set_register(2, address);
        let began = bench.now();
        while bench.chip.cpu().pc() < FLASH + 0x200 + 2 * code.len() as u32 {
            bench.chip.step(&mut bench.seen);
        }
        bench.now() - began - u64::from(!default_master)
    };
    let (likely, pessimistic) = (Sam3x8eTiming::LIKELY, Sam3x8eTiming::PESSIMISTIC);
    let (ldr, str, nop) = (0x6808, 0x6008, 0xbf00);
    assert_eq!(cycles(&[ldr], RAM, true, likely), 2);
    assert_eq!(cycles(&[ldr], RAM, false, likely), 3);
    assert_eq!(cycles(&[ldr], PIOD + 0x3c, true, likely), 4);
    assert_eq!(cycles(&[ldr], PIOD + 0x3c, true, pessimistic), 5);
    assert_eq!(cycles(&[ldr], TC0 + 0x20, false, likely), 5);
    assert_eq!(cycles(&[str, nop, nop], PIOD + 0x30, true, likely), 3);
    // The tutorial's pair of stores: the second waits for the first.
    assert_eq!(cycles(&[str, str], PIOD + 0x30, true, likely), 3);
    assert_eq!(cycles(&[str, str, str], PIOD + 0x30, true, pessimistic), 7);
    // Nothing is there.
    let mut bench = Bench::with(&[ldr], likely);
    bench.chip.cpu_mut().set_register(1, 0x6000_0000);
    bench.chip.step(&mut bench.seen);
    assert!(bench.chip.fault().is_some());
}

/// Code in RAM: a word in two cycles (TRM DDI 0337), so that short instructions go on and long ones take two.
#[test]
fn code_in_ram() {
    let cycles = |code: &[u16], count: u64| {
        let mut bench = Bench::with(&[0xbf00], Sam3x8eTiming::LIKELY);
        bench.chip.poke(RAM, &code.iter().flat_map(|half| half.to_le_bytes()).collect::<Vec<_>>());
        bench.chip.cpu_mut().set_register(15, RAM);
        bench.chip.step(&mut bench.seen);
        let (began, before) = (bench.now(), bench.chip.cpu().instructions());
        while bench.chip.cpu().instructions() < before + count {
            bench.chip.step(&mut bench.seen);
        }
        bench.now() - began
    };
    assert_eq!(cycles(&[0xbf00; 50], 41), 41);
    assert_eq!(cycles(&[0xf3af, 0x8000].repeat(50), 40), 80);
}

/// §9: both RAMs are one piece from 0x2007_0000 on; address 0 shows flash.
#[test]
fn memories() {
    let mut bench = Bench::new();
    bench.set(0x2000_0010, 0x1111_1111);
    bench.set(0x2008_0000, 0x2222_2222);
    assert_eq!((bench.get(0x2007_0010), bench.get(RAM + 0x1_0000)), (0x1111_1111, 0x2222_2222));
    assert_eq!(bench.chip.peek(0), bench.chip.peek(FLASH));
    assert!(bench.chip.poke(RAM, &[0; Sam3x8e::RAM_BYTES]));
    assert_eq!(bench.chip.peek(0x2010_0000), None);
    assert!(Sam3x8e::new(&[0; Sam3x8e::FLASH_BYTES + 1], Sam3x8eTiming::LIKELY).is_err());
    assert_eq!(bench.get(0x400e_0940), 0x285e_0a60);
}

/// A bench whose UART runs at 250 000 baud, MCK 84 MHz.
fn uart() -> Bench {
    let mut bench = Bench::new();
    bench.start_clocks();
    bench.clock_all();
    bench.set(PIOA + 4, 3 << 8);
    bench.set(UART + 0x20, 21);
    bench.set(UART + 4, 4 << 9);
    bench.set(UART, 1 << 4 | 1 << 6);
    bench
}

/// §34: 16 CD cycles a bit, no fraction; one character waits while another is sent.
#[test]
fn uart_sends() {
    let mut bench = uart();
    assert_eq!(bench.get(UART + 0x14) & 0x202, 0x202);
    let began = bench.now();
    bench.set(UART + 0x1c, u32::from(b'A'));
    bench.set(UART + 0x1c, u32::from(b'B'));
    assert_eq!(bench.get(UART + 0x14) & 0x202, 0, "one is sent, one waits");
    bench.run(10 * 336 + 2);
    assert_eq!(bench.get(UART + 0x14) & 0x202, 2);
    bench.run(10 * 336);
    assert_eq!(bench.get(UART + 0x14) & 0x202, 0x202);
    let sent: Vec<_> =
        bench.seen.sent.iter().map(|byte| (byte.byte(), byte.start_cycle, byte.cycles_per_bit)).collect();
    assert_eq!(sent, [(b'A', began + 1, 336), (b'B', began + 1 + 3360, 336)]);
}

/// Characters at other rates; overrun; parity; framing.
#[test]
fn uart_receives() {
    let line = |bench: &mut Bench, byte: u8, percent: u32| {
        let from = bench.now().max(bench.chip.line_idle_from());
        bench.chip.receive(LineByte::new(from, byte, 336 * 256 * percent / 100));
        bench.run(11 * 336 + 400);
    };
    let mut bench = uart();
    for percent in [97, 100, 103] {
        line(&mut bench, 0x5a, percent);
        assert_eq!((bench.get(UART + 0x14) & 0xe1, bench.get(UART + 0x18)), (1, 0x5a));
    }
    line(&mut bench, 1, 100);
    line(&mut bench, 2, 100);
    assert_eq!((bench.get(UART + 0x14) & 0xe1, bench.get(UART + 0x18)), (0x21, 2), "an overrun");
    bench.set(UART, 1 << 8);
    assert_eq!(bench.get(UART + 0x14) & 0xe1, 0);
    // Even parity: 0x0f with its stop bit where the parity bit should be 0.
    bench.set(UART + 4, 0);
    line(&mut bench, 0x0f, 100);
    assert_eq!(bench.get(UART + 0x14) & 0xe1, 0x81);
    // Without a clock, or without its pin, it hears nothing.
    bench.get(UART + 0x18);
    bench.set(PIOA, 1 << 8);
    line(&mut bench, 0x33, 100);
    assert_eq!(bench.get(UART + 0x14) & 1, 0);
}

/// §26: the DMA sends and receives with two buffers each.
#[test]
fn uart_dma() {
    let mut bench = uart();
    let text = b"pulsetrain!!";
    bench.chip.poke(RAM, text);
    for (offset, value) in [(0x108, RAM), (0x10c, 5), (0x118, RAM + 5), (0x11c, 7), (0x120, 1 << 8)] {
        bench.set(UART + offset, value);
    }
    assert_eq!(bench.get(UART + 0x14) >> 4 & 0x81, 0, "neither ENDTX nor TXBUFE");
    bench.run(6 * 3360);
    assert_eq!(bench.get(UART + 0x14) >> 4 & 0x81, 1, "the first buffer has ended");
    bench.run(8 * 3360);
    assert_eq!(bench.get(UART + 0x14) >> 4 & 0x81, 0x81);
    assert_eq!(bench.seen.sent.iter().map(|byte| byte.byte()).collect::<Vec<_>>(), text);
    let ends: Vec<_> = bench.seen.sent.windows(2).map(|pair| pair[1].start_cycle - pair[0].end_cycle).collect();
    assert!(ends.iter().all(|pause| *pause == 0), "without a pause: {ends:?}");

    for (offset, value) in [(0x100, RAM + 100), (0x104, 4), (0x110, RAM + 200), (0x114, 4), (0x120, 1)] {
        bench.set(UART + offset, value);
    }
    let mut at = bench.now();
    for byte in b"abcdef" {
        bench.chip.receive(LineByte::new(at, *byte, 336 * 256));
        at += 3360;
    }
    bench.run(7 * 3360);
    assert_eq!(bench.get(RAM + 100), u32::from_le_bytes(*b"abcd"));
    assert_eq!(bench.get(RAM + 200) & 0xffff, u32::from(u16::from_le_bytes(*b"ef")));
    assert_eq!((bench.get(UART + 0x104), bench.get(UART + 0x14) >> 3 & 1, bench.get(UART + 0x14) >> 12), (2, 1, 0));
}

/// §15: it runs after a reset, for 16 s; its mode is written once; it is restarted with a key.
#[test]
fn watchdog() {
    let mut bench = Bench::new();
    bench.run(15 * 4_000_000);
    assert_eq!(bench.seen.resets, 0);
    bench.run(4_100_000);
    assert_eq!((bench.seen.resets, bench.get(RSTC + 4) >> 8 & 7), (1, 2));

    // A period of 1 s, restarted each 0.9 s.
    bench.set(WATCHDOG + 4, 0x0fff_2100);
    bench.set(WATCHDOG + 4, 1 << 15);
    assert_eq!(bench.get(WATCHDOG + 4), 0x0fff_2100, "written once");
    for _ in 0..3 {
        bench.run(3_600_000);
        bench.set(WATCHDOG, 0xa500_0001);
    }
    assert_eq!(bench.seen.resets, 1);
    bench.run(3_600_000);
    bench.set(WATCHDOG, 1);
    bench.run(800_000);
    assert_eq!(bench.seen.resets, 2, "the key was missing");

    bench.set(WATCHDOG + 4, 1 << 15);
    bench.run(100_000_000);
    assert_eq!(bench.seen.resets, 2);
}

/// §12, §17: why it was reset; what survives.
#[test]
fn resets() {
    let mut bench = Bench::new();
    assert_eq!(bench.get(RSTC + 4), 1 << 16);
    bench.set(GPBR + 8, 0x1234_5678);
    bench.set(RAM, 0x55);
    bench.set(PIOD + 0x10, 1);
    bench.start_clocks();
    bench.set(RSTC, 0x0000_000d);
    bench.run(10);
    assert_eq!(bench.seen.resets, 0, "the key was missing");
    bench.set(RSTC, 0xa500_000d);
    bench.run(100);
    assert_eq!((bench.seen.resets, bench.get(RSTC + 4) >> 8 & 7), (1, 3));
    assert_eq!((bench.get(GPBR + 8), bench.get(RAM), bench.chip.clock_hz()), (0x1234_5678, 0x55, 4_000_000));
    assert!(!bench.chip.is_output(PD));
    bench.chip.reset(&mut bench.seen);
    assert_eq!((bench.get(RSTC + 4), bench.get(RSTC + 4)), (4 << 8 | 1 << 16 | 1, 4 << 8 | 1 << 16));
}

/// Any register, any value, in any order: no panic, and time goes on.
#[test]
fn any_register() {
    let regions = [
        0x400a_c000,
        0x400a_c100,
        0x400a_c1c0,
        0x400a_c800,
        0x2018_0000,
        TC0,
        TC0 + 0x4000,
        PMC,
        UART,
        UART + 0x100,
        EEFC0,
        EEFC1,
        PIOA,
        PIOB,
        PIOD,
        RSTC,
        WATCHDOG,
        MATRIX,
        RAM,
    ];
    for seed in 1..=150u64 {
        let mut random = Random::new(seed);
        let mut bench = Bench::new();
        bench.chip.usb_plug(true);
        bench.chip.usb_open(true);
        for _ in 0..400 {
            let address = regions[random.below(19) as usize] + random.below(0x50) * 4;
            let value = match random.below(4) {
                0 => random.below(64),
                1 => 1 << random.below(32),
                2 => RAM + random.below(0x1000),
                _ => random.next(),
            };
            match random.below(4) {
                0 => {
                    bench.get(address);
                }
                1 => {
                    let from = bench.now().max(bench.chip.line_idle_from());
                    bench.chip.receive(LineByte::new(from, value as u8, 256 * (20 + random.below(2000))));
                }
                _ => bench.set(address, value),
            }
            let before = bench.now();
            bench.run(1 + u64::from(random.below(3000)));
            assert!(bench.now() > before);
        }
        assert!(bench.seen.edges.windows(2).all(|pair| pair[0].cycle <= pair[1].cycle), "seed {seed}");
    }
}
