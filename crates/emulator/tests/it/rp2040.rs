//! The RP2040 around PIO and DMA: clocks, timer, UART, SIO, pins, watchdog, flash, and the processor among them.
//! Sections are those of the RP2040 datasheet.

use crate::pico::{Bench, CLR, Machine, SET, Seen, XOR, flash};
use pio::pio_asm;
use pulsetrain_emulator::arm::FaultCause;
use pulsetrain_emulator::{Level, LineByte, Rp2040};

const CLOCKS: u32 = 0x4000_8000;
const RESETS: u32 = 0x4000_c000;
const XOSC: u32 = 0x4002_4000;
const PLL_SYS: u32 = 0x4002_8000;
const TIMER: u32 = 0x4005_4000;
const WATCHDOG: u32 = 0x4005_8000;
const UART0: u32 = 0x4003_4000;
const SIO: u32 = 0xd000_0000;

/// Waits until a register has a bit; how many cycles that took.
fn wait_for(bench: &mut Bench, address: u32, bit: u32) -> u64 {
    let start = bench.now();
    while bench.get(address) >> bit & 1 == 0 {
        bench.run(1);
        assert!(bench.now() < start + 1_000_000, "{address:#x} never gets bit {bit}");
    }
    bench.now() - start
}

/// What start-up code does: crystal, PLL at 125 MHz, clk_ref, clk_sys, clk_peri, and the tick of a microsecond.
fn start_clocks(bench: &mut Bench) {
    bench.set(XOSC + 0xc, 47);
    bench.set(XOSC, 0x00fa_baa0);
    wait_for(bench, XOSC + 4, 31);
    bench.set(CLOCKS + 0x30, 2);
    bench.set(PLL_SYS + 8, 125);
    bench.set(PLL_SYS + 4 + CLR, 1 | 1 << 5);
    wait_for(bench, PLL_SYS, 31);
    // 12 MHz · 125 / (6 · 2)
    bench.set(PLL_SYS + 0xc, 6 << 16 | 2 << 12);
    bench.set(PLL_SYS + 4 + CLR, 1 << 3);
    bench.set(CLOCKS + 0x3c, 1);
    bench.set(CLOCKS + 0x48, 1 << 11);
    bench.set(WATCHDOG + 0x2c, 12 | 1 << 9);
    bench.run(10);
}

/// §2.15, §2.16, §2.18: real locking bits; the crystal's start takes 256 · 47 of its periods, 1 ms.
#[test]
fn clocks() {
    let mut bench = Bench::new();
    assert_eq!(bench.chip.clock_hz(), 6_500_000);
    bench.set(XOSC + 0xc, 47);
    bench.set(XOSC, 0x00fa_baa0);
    let taken = wait_for(&mut bench, XOSC + 4, 31);
    assert_eq!(taken, (256 * 47 * 6_500_000u64).div_ceil(12_000_000) + 1);
    // A PLL that is off does not lock, whatever is written to it.
    bench.set(PLL_SYS + 8, 125);
    bench.run(10_000);
    assert_eq!(bench.get(PLL_SYS) >> 31, 0);
    start_clocks(&mut bench);
    assert_eq!(bench.chip.clock_hz(), 125_000_000);
    assert_eq!(bench.seen.frequencies.iter().map(|f| f.1).collect::<Vec<_>>(), [12_000_000, 125_000_000]);
    // SELECTED.
    assert_eq!((bench.get(CLOCKS + 0x38), bench.get(CLOCKS + 0x44)), (1 << 2, 1 << 1));
}

/// §2.14: a peripheral in reset answers nothing and forgets; RESET_DONE follows.
#[test]
fn resets() {
    let mut bench = Bench::new();
    let machine = Machine::new(0, 0);
    bench.set(machine.clkdiv(), 5 << 16);
    bench.run(1);
    assert_eq!((bench.get(machine.clkdiv()), bench.get(RESETS + 8)), (5 << 16, 0x01ff_ffff));
    bench.set(RESETS + SET, 1 << 10);
    bench.run(1);
    bench.set(machine.clkdiv(), 7 << 16);
    bench.run(1);
    assert_eq!((bench.get(machine.clkdiv()), bench.get(RESETS + 8)), (0, 0x01ff_ffff & !(1 << 10)));
    bench.set(RESETS + CLR, 1 << 10);
    bench.run(1);
    assert_eq!(bench.get(machine.clkdiv()), 1 << 16);
}

/// §2.1.2: every register can be written, toggled, set, cleared; §2.1.4: narrow writes by the processor write it whole.
#[test]
fn atomic_aliases() {
    let mut bench = Bench::new();
    let scratch = WATCHDOG + 0xc;
    bench.set(scratch, 0x0000_ff0f);
    bench.set(scratch + XOR, 0x0000_0ff0);
    bench.set(scratch + SET, 0x8000_0000);
    bench.set(scratch + CLR, 0x0000_0001);
    bench.run(1);
    assert_eq!(bench.get(scratch), 0x8000_f0fe);
}

/// §4.6, §4.7: a microsecond is 125 cycles; TIMELR latches TIMEHR; the tick goes on at another clock.
#[test]
fn the_timer() {
    let mut bench = Bench::new();
    start_clocks(&mut bench);
    let first = bench.get(TIMER + 0x28);
    bench.run(125 * 1000);
    assert_eq!(bench.get(TIMER + 0x28) - first, 1000);
    // TIMELW, TIMEHW.
    bench.set(TIMER + 4, u32::MAX);
    bench.set(TIMER, 5);
    bench.run(1);
    assert_eq!((bench.get(TIMER + 0xc), bench.get(TIMER + 8)), (u32::MAX, 5));
    bench.run(125);
    assert_eq!((bench.get(TIMER + 8), bench.get(TIMER + 0xc), bench.get(TIMER + 8)), (5, 0, 6));
    // An alarm: armed until it rings, in the cycle in which the count is there.
    let now = bench.get(TIMER + 0x28);
    bench.set(TIMER + 0x14, now + 100);
    bench.run(1);
    assert_eq!(bench.get(TIMER + 0x20), 2);
    bench.run(125 * 99);
    assert_eq!((bench.get(TIMER + 0x20), bench.get(TIMER + 0x34)), (2, 0));
    bench.run(126);
    assert_eq!((bench.get(TIMER + 0x20), bench.get(TIMER + 0x34)), (0, 2));
    // PAUSE.
    bench.set(TIMER + 0x30, 1);
    bench.run(1);
    let paused = bench.get(TIMER + 0x28);
    bench.run(10_000);
    assert_eq!(bench.get(TIMER + 0x28), paused);
}

/// §4.2: characters as the divisor says, one after the other; what comes is sampled at the chip's rate.
#[test]
fn uart_characters() {
    let mut bench = Bench::new();
    start_clocks(&mut bench);
    bench.give([0, 1], 2);
    // 115 200 baud: 125 MHz / (16 · 115 200) = 67.817 = 67 + 52/64.
    for (offset, value) in [(0x24, 67), (0x28, 52), (0x2c, 0x70), (0x30, 0x301)] {
        bench.set(UART0 + offset, value);
    }
    let write = bench.now();
    for byte in b"Pico" {
        bench.set(UART0, (*byte).into());
    }
    bench.run(50_000);
    let sent = bench.seen.sent.clone();
    assert_eq!(sent.iter().map(|byte| byte.byte()).collect::<Vec<_>>(), b"Pico");
    // A bit is 16 · 67.8125 = 1085 cycles.
    assert_eq!((sent[0].start_cycle, sent[0].cycles_per_bit), (write + 1, 1085));
    for (n, byte) in sent.iter().enumerate() {
        assert_eq!(byte.end_cycle, write + 1 + 10_850 * (n as u64 + 1));
    }
    // At the right rate, 4 % fast, and at twice the rate.
    for (rate, expected) in [(115_200u64, Some(0x55)), (119_800, Some(0x55)), (230_400, None)] {
        let bit = u32::try_from(125_000_000 * 256 / rate).expect("a bit");
        bench.chip.receive(0, LineByte::new(bench.now() + 10, 0x55, bit));
        bench.run(30_000);
        let data = bench.get(UART0);
        assert_eq!((data & 0xff == 0x55).then_some(0x55), expected, "{rate} baud: {data:#x}");
        // Whatever else came of it.
        for _ in 0..4 {
            bench.get(UART0);
        }
    }
}

/// §4.2.3: levels of the FIFOs, the receiver's timeout of 32 bits, overrun.
#[test]
fn uart_interrupts() {
    let mut bench = Bench::new();
    bench.give([0, 1], 2);
    bench.set(CLOCKS + 0x48, 1 << 11);
    // 16 cycles a bit; receive level 1/2, transmit level 1/8.
    for (offset, value) in [(0x24, 1), (0x28, 0), (0x2c, 0x70), (0x34, 2 << 3), (0x30, 0x301)] {
        bench.set(UART0 + offset, value);
    }
    let receive = |bench: &mut Bench, number: u64| {
        let begin = bench.now() + 1;
        for n in 0..number {
            bench.chip.receive(0, LineByte::new(begin + 160 * n, n as u8, 16 * 256));
        }
        bench.run(160 * number + 20);
    };
    receive(&mut bench, 15);
    assert_eq!(bench.get(UART0 + 0x3c), 0);
    receive(&mut bench, 1);
    assert_eq!(bench.get(UART0 + 0x3c), 1 << 4);
    bench.run(32 * 16);
    assert_eq!(bench.get(UART0 + 0x3c), 1 << 4 | 1 << 6);
    for _ in 0..16 {
        bench.get(UART0);
    }
    assert_eq!((bench.get(UART0 + 0x3c), bench.get(UART0 + 0x18)), (0, 0x90));
    // 33 characters: one is lost, the one after it says so (OE).
    receive(&mut bench, 33);
    assert_eq!(bench.get(UART0 + 0x3c) & 1 << 10, 1 << 10);
    for n in 0..32 {
        assert_eq!(bench.get(UART0), n);
    }
    receive(&mut bench, 1);
    assert_eq!(bench.get(UART0), 1 << 11);
    bench.set(UART0 + 0x44, 0x7ff);
    // The transmitter asks as its FIFO falls to 4.
    for n in 0..6 {
        bench.set(UART0, n);
    }
    bench.run(100);
    assert_eq!(bench.get(UART0 + 0x3c), 0);
    bench.run(160);
    assert_eq!(bench.get(UART0 + 0x3c), 1 << 5);
}

/// Clock and pins may come last: what was written goes out then, and a character that begins after that is heard.
#[test]
fn uart_set_up_backwards() {
    let mut bench = Bench::new();
    for (offset, value) in [(0x24, 1), (0x28, 0), (0x2c, 0x70), (0x30, 0x301), (0, 5)] {
        bench.set(UART0 + offset, value);
    }
    bench.chip.receive(0, LineByte::new(bench.now() + 500, 0x77, 16 * 256));
    bench.run(100);
    bench.set(CLOCKS + 0x48, 1 << 11);
    bench.run(10);
    bench.give([0, 1], 2);
    bench.run(1000);
    assert_eq!(bench.seen.sent.iter().map(|byte| byte.byte()).collect::<Vec<_>>(), [5]);
    assert_eq!(bench.get(UART0), 0x77);
}

/// No pin, no characters: a program that forgets FUNCSEL is mute and deaf.
#[test]
fn uart_without_pins() {
    let mut bench = Bench::new();
    bench.set(CLOCKS + 0x48, 1 << 11);
    for (offset, value) in [(0x24, 1), (0x28, 0), (0x2c, 0x70), (0x30, 0x301)] {
        bench.set(UART0 + offset, value);
    }
    bench.set(UART0, 5);
    bench.chip.receive(0, LineByte::new(bench.now() + 5, 1, 16 * 256));
    bench.run(1000);
    assert_eq!((bench.seen.sent.len(), bench.get(UART0 + 0x18)), (0, 0x90));
}

/// §2.3.1.2: GPIO by SIO: a store's edge is in the next cycle; inputs through the synchroniser; §2.19: overrides,
/// pull-ups, output and input disable.
#[test]
fn pins() {
    let mut bench = Bench::new();
    bench.give([3, 4], 5);
    bench.set(SIO + 0x24, 1 << 3);
    let now = bench.now();
    bench.set(SIO + 0x14, 1 << 3);
    assert_eq!(bench.edges(3), [(now + 1, true)]);
    // Read three cycles after the store: one to the pin, two of synchroniser.
    bench.run(2);
    assert_eq!(bench.get(SIO + 4) & 8, 0);
    bench.run(1);
    assert_eq!(bench.get(SIO + 4) & 8, 8);
    // OUTOVER: inverted, low, high.
    for (over, level) in [(1 << 8, false), (0, true), (2 << 8, false), (3 << 8, true)] {
        bench.set(0x4001_4004 + 8 * 3, 5 | over);
        assert_eq!(bench.chip.pin(3).is_high(), level, "OUTOVER {over:#x}");
    }
    // OD in the pad; OEOVER.
    bench.set(0x4001_c004 + 4 * 3, 0x56 | 1 << 7);
    assert!(!bench.chip.is_output(3) && !bench.chip.pin(3).is_high());
    bench.set(0x4001_c004 + 4 * 3, 0x56);
    bench.set(0x4001_4004 + 8 * 3, 5 | 2 << 12);
    assert!(!bench.chip.is_output(3));
    // A pull-up, the world against it, the input disabled, and INOVER.
    bench.set(0x4001_c004 + 4 * 4, 0x4a);
    bench.run(3);
    assert_eq!(bench.get(SIO + 4) & 16, 16);
    bench.chip.set_input(4, Some(Level::Low));
    bench.run(3);
    assert_eq!(bench.get(SIO + 4) & 16, 0);
    bench.set(0x4001_4004 + 8 * 4, 5 | 1 << 16);
    bench.run(3);
    assert_eq!(bench.get(SIO + 4) & 16, 16);
    bench.set(0x4001_4004 + 8 * 4, 5);
    bench.chip.set_input(4, Some(Level::High));
    bench.set(0x4001_c004 + 4 * 4, 0x0a);
    bench.run(3);
    assert_eq!(bench.get(SIO + 4) & 16, 0);
}

/// §2.19.4: edges are kept until they are cleared, levels are not.
#[test]
fn pin_interrupts() {
    let mut bench = Bench::new();
    let intr = 0x4001_40f0;
    bench.chip.set_input(9, Some(Level::High));
    bench.run(3);
    // Pin 9 is the second of the second eight: high, and an edge up.
    assert_eq!(bench.get(intr + 4) >> 4 & 15, 0b1010);
    bench.chip.set_input(9, Some(Level::Low));
    bench.run(3);
    assert_eq!(bench.get(intr + 4) >> 4 & 15, 0b1101);
    bench.set(intr + 4, 0b1100 << 4);
    bench.run(1);
    assert_eq!(bench.get(intr + 4) >> 4 & 15, 0b0001);
}

/// §2.3.1.5: eight cycles, quotient and remainder, signs, zero.
#[test]
fn the_divider() {
    let mut bench = Bench::new();
    let mut divide = |signed: bool, dividend: i32, divisor: i32| {
        let base = SIO + if signed { 0x68 } else { 0x60 };
        bench.set(base, dividend as u32);
        bench.set(base + 4, divisor as u32);
        bench.run(7);
        assert_eq!(bench.get(SIO + 0x78), 2, "not ready, dirty");
        bench.run(1);
        assert_eq!(bench.get(SIO + 0x78), 3);
        let remainder = bench.get(SIO + 0x74) as i32;
        (bench.get(SIO + 0x70) as i32, remainder)
    };
    assert_eq!(divide(true, -100, 7), (-14, -2));
    assert_eq!(divide(false, -100, 7), (613_566_742, 2));
    assert_eq!(divide(true, i32::MIN, -1), (i32::MIN, 0));
    assert_eq!(divide(false, 5, 0), (-1, 5));
    assert_eq!(divide(true, -5, 0), (1, -5));
}

/// §2.3.1.3: a lock is taken by reading it, and given back by writing.
#[test]
fn spinlocks() {
    let mut bench = Bench::new();
    let lock = SIO + 0x100 + 4 * 9;
    assert_eq!((bench.get(lock), bench.get(lock), bench.get(SIO + 0x5c)), (1 << 9, 0, 1 << 9));
    bench.set(lock, 0);
    assert_eq!(bench.get(lock), 1 << 9);
}

/// §4.7: the counter loses two in each tick (erratum RP2040-E1). After the reset, scratch registers and reason are
/// kept. A watchdog that may not reset anything (§2.13.5, WDSEL) resets nothing. TRIGGER sets another reason, RUN none.
#[test]
fn the_watchdog() {
    let mut bench = Bench::new();
    start_clocks(&mut bench);
    bench.give([3], 5);
    bench.set(SIO + 0x24, 1 << 3);
    bench.set(SIO + 0x14, 1 << 3);
    bench.set(WATCHDOG + 0xc, 0x1234);
    bench.set(WATCHDOG, 1 << 31);
    bench.run(10);
    assert_eq!(bench.seen.resets, [] as [u64; 0]);
    bench.set(0x4001_0008, 0x1_fffc);
    let load = bench.now();
    bench.set(WATCHDOG + 4, 2000);
    bench.set(WATCHDOG, 1 << 30);
    bench.seen.edges.clear();
    bench.run(1000 * 125 - 200);
    assert_eq!(bench.seen.resets, [] as [u64; 0]);
    let end = bench.now() + 1000;
    bench.chip.run(end, &mut bench.seen);
    assert_eq!(bench.seen.resets.len(), 1);
    let at = bench.seen.resets[0];
    assert!((1000 * 125 - 125..=1000 * 125 + 10).contains(&(at - load)), "{} cycles after", at - load);
    // The pin falls back, clocks are slow again.
    assert_eq!((bench.edges(3), bench.chip.clock_hz()), (vec![(at, false)], 6_500_000));
    assert_eq!((bench.get(WATCHDOG + 8), bench.get(WATCHDOG + 0xc)), (1, 0x1234));
    bench.set(0x4001_0008, 0x1_fffc);
    bench.set(WATCHDOG, 1 << 31);
    let end = bench.now() + 1000;
    bench.chip.run(end, &mut bench.seen);
    assert_eq!((bench.get(WATCHDOG + 8), bench.get(WATCHDOG + 0xc), bench.seen.resets.len()), (2, 0x1234, 2));
    bench.chip.reset(&mut bench.seen);
    assert_eq!((bench.get(WATCHDOG + 8), bench.get(WATCHDOG + 0xc)), (0, 0));
}

// Programs, in Thumb code by hand. The processor itself has tests of its own.

/// §2.6.3: a line of 8 bytes is missed once, and costs what is stated; then it is hit.
#[test]
fn flash_in_place() {
    // 0x1000_0108: movs r0, #0; adds r0, #1 ×6; b to the first: two lines, the last half of the first is a branch.
    let program = [0x2000, 0x3001, 0x3001, 0x3001, 0x3001, 0x3001, 0x3001, 0xe7f7];
    let mut chip = Rp2040::new(&flash(&program)).expect("it fits");
    let mut cycles = Vec::new();
    for _ in 0..16 {
        let before = chip.cycle();
        chip.step(&mut ());
        cycles.push(chip.cycle() - before);
    }
    assert_eq!(cycles[..8], [61, 1, 1, 1, 61, 1, 1, 2]);
    assert_eq!(cycles[8..], [1, 1, 1, 1, 1, 1, 1, 2]);
}

/// §2.6.3, and the flash chip's datasheet: a fetch from flash gets no instruction while flash executes a command or
/// erases. A program in RAM goes on, and afterwards a program in flash does too.
#[test]
fn nothing_is_executed_from_flash_that_is_busy() {
    const SSI: u32 = 0x1800_0000;
    const HERE: u32 = 0x1000_0108;
    let set_up = |bench: &mut Bench, frames: u32| {
        for (offset, value) in [(0x08, 0), (0x00, frames), (0x08, 1)] {
            bench.set(SSI + offset, value);
        }
    };
    let command = |bench: &mut Bench, bytes: &[u32]| {
        bench.set(0x4001_800c, 2 << 8);
        for byte in bytes {
            bench.set(SSI + 0x60, *byte);
            bench.get(SSI + 0x60);
        }
        bench.set(0x4001_800c, 0);
    };
    // Goes on there for a while: where and on what it faults first.
    let go_on = |bench: &Bench, address: u32| {
        let mut chip = bench.chip.clone();
        chip.cpu_mut().set_register(15, address);
        (0..20).find_map(|_| {
            chip.step(&mut ());
            chip.fault().map(|fault| (fault.pc, fault.cause))
        })
    };
    let ends = Some((HERE, FaultCause::Undefined));
    // A branch to itself, in flash and in RAM.
    const STAY: u16 = 0xe7fe;
    let mut bench = Bench { chip: Rp2040::new(&flash(&[STAY])).expect("it fits"), seen: Seen::default() };
    bench.chip.ram_mut()[..2].copy_from_slice(&STAY.to_le_bytes());
    bench.chip.cpu_mut().set_register(15, Rp2040::RAM_ADDRESS);
    assert_eq!(go_on(&bench, HERE), None);
    set_up(&mut bench, 7 << 16);
    assert_eq!(go_on(&bench, HERE), ends, "for commands");
    command(&mut bench, &[0x06]);
    command(&mut bench, &[0x20, 0, 0x10, 0]);
    set_up(&mut bench, 31 << 16 | 3 << 8);
    assert_eq!(go_on(&bench, HERE), ends, "it erases, another sector");
    assert_eq!(go_on(&bench, Rp2040::RAM_ADDRESS), None);
    // 45 ms.
    let end = bench.now() + bench.chip.clock_hz() * 45 / 1000;
    bench.chip.run(end, &mut ());
    assert_eq!(go_on(&bench, HERE), None);
}

/// §2.1.3: through the bridge a load takes 4 cycles in all, a store 5; through AHB-Lite 2 each, at SIO 1.
#[test]
fn bus_cycles() {
    for (address, load, store) in
        [(0x4005_8010u32, 4, 5), (0x5020_0138, 2, 2), (0xd000_0010, 1, 1), (0x2000_0000, 2, 2), (0x5000_0404, 2, 2)]
    {
        // ldr r0, [r1]; str r0, [r1]
        let mut chip = Rp2040::new(&flash(&[0x6808, 0x6008])).expect("it fits");
        chip.cpu_mut().set_register(1, address);
        let mut cycles = |wait: u64| {
            let before = chip.cycle();
            chip.step(&mut ());
            chip.cycle() - before - wait
        };
        assert_eq!((cycles(60), cycles(0)), (load, store), "{address:#x}");
    }
}

/// Two blocks enabled one after the other, by two stores, begin two cycles apart.
#[test]
fn two_enables() {
    // str r1, [r0]; str r1, [r2]; wfi; b to it
    let mut bench =
        Bench { chip: Rp2040::new(&flash(&[0x6001, 0x6011, 0xbf30, 0xe7fd])).expect("it fits"), seen: Seen::default() };
    bench.set(RESETS, 0);
    for block in 0..2 {
        let machine = Machine::new(block, 0);
        let program = pio_asm!("set pins, 1", "h:", "jmp h").program;
        for (at, word) in program.code.iter().enumerate() {
            bench.set(machine.base() + 0x48 + 4 * at as u32, (*word).into());
        }
        bench.set(machine.pinctrl(), 1 << 26 | block << 5);
        bench.give([block], 6 + block);
        // OEOVER: an output, whatever the machine says.
        bench.set(0x4001_4004 + 8 * block, 3 << 12 | (6 + block));
    }
    for (register, value) in [(0, 0x5020_0000), (1, 1), (2, 0x5030_0000)] {
        bench.chip.cpu_mut().set_register(register, value);
    }
    bench.chip.run(300, &mut bench.seen);
    let edges: Vec<_> =
        bench.seen.edges.iter().map(|edge| (edge.gpio, edge.cycle - bench.seen.edges[0].cycle)).collect();
    assert_eq!(edges, [(0, 0), (1, 2)]);
}

/// A program that sleeps until the timer's alarm, and toggles a pin in its handler, from RAM: what comes between the
/// match and the edge is 1 cycle to the flag, 15 of entry (TRM: 15 without waiting; here 12 of stacking and 3 to the
/// handler), and the handler's.
#[test]
fn an_alarm_wakes_the_processor() {
    let mut image = flash(&[
        // ldr r0, =0xe000_e100; movs r1, #1; str r1, [r0]; wfi; b to wfi
        0x4801, 0x2101, 0x6001, 0xbf30, 0xe7fd,
    ]);
    // ISER, after the code: 0x1000_0110 is where the load looks.
    image.truncate(0x108);
    for half in [0x4802u16, 0x2101, 0x6001, 0xbf30, 0xe7fd, 0] {
        image.extend(half.to_le_bytes());
    }
    image.extend(0xe000_e100u32.to_le_bytes());
    image.resize(0x140, 0);
    // Vector 16: TIMER_IRQ_0, in RAM.
    image.extend(0x2000_0001u32.to_le_bytes());
    let mut bench = Bench { chip: Rp2040::new(&image).expect("it fits"), seen: Seen::default() };
    // ldr r0, =SIO GPIO_OUT_XOR; ldr r1, =1 << 25; str r1, [r0]; ldr r0, =INTR; movs r1, #1; str r1, [r0]; bx lr
    let handler = [0x4803u16, 0x4904, 0x6001, 0x4804, 0x2101, 0x6001, 0x4770, 0];
    let code: Vec<u8> = handler.iter().flat_map(|half| half.to_le_bytes()).collect();
    let literals: Vec<u8> =
        [0xd000_001cu32, 1 << 25, TIMER + 0x34].iter().flat_map(|word| word.to_le_bytes()).collect();
    bench.chip.ram_mut()[..16].copy_from_slice(&code);
    bench.chip.ram_mut()[16..28].copy_from_slice(&literals);
    bench.run(400);
    bench.set(RESETS, 0);
    bench.run(1);
    start_clocks(&mut bench);
    bench.give([25], 5);
    bench.set(SIO + 0x24, 1 << 25);
    bench.set(TIMER + 0x38, 1);
    let mut latencies = Vec::new();
    for _ in 0..3 {
        let time = bench.get(TIMER + 0x28);
        bench.set(TIMER + 0x10, time + 10);
        // The cycle of the match.
        while bench.get(TIMER + 0x28) != time + 10 {
            bench.run(1);
        }
        let matched = bench.now();
        let end = bench.now() + 500;
        bench.chip.run(end, &mut bench.seen);
        assert!(bench.chip.is_asleep(), "{:?}", bench.chip.fault());
        let edges = bench.edges(25);
        assert_eq!(edges.len(), 1);
        latencies.push(edges[0].0 - matched);
    }
    // The first time the vector comes from flash. Then: 1 + 15 + ldr, ldr, str to the I/O port = 2 + 2 + 1.
    assert_eq!(latencies[1..], [1 + 15 + 5; 2], "{latencies:?}");
    assert_eq!(latencies[0], 1 + 15 + 5 + 60);
}

/// An hour of a chip that sleeps while a state machine counts down 2 s at a time and toggles a pin takes hardly any
/// time. Its 4.5 · 10^11 cycles one by one would take far too long.
#[test]
fn an_hour_of_sleep() {
    let mut bench = Bench::new();
    start_clocks(&mut bench);
    let machine = Machine::new(0, 0);
    let program = pio_asm!(
        ".wrap_target",
        "mov x, y",
        "l:",
        "jmp x-- l",
        "set pins, 1",
        "mov x, y",
        "k:",
        "jmp x-- k",
        "set pins, 0",
        ".wrap"
    )
    .program;
    machine.load(&mut bench, &program, 0);
    machine.outputs(&mut bench, 0, 1);
    bench.set(machine.pinctrl(), 1 << 26);
    // Y: 250 000 000 cycles less the four of the loop's other instructions and the last jump.
    machine.push(&mut bench, 250_000_000 - 3);
    machine.force(&mut bench, 0x80a0);
    machine.force(&mut bench, 0xa047);
    let begin = bench.now();
    machine.enable(&mut bench);
    let hour = 3600 * 125_000_000;
    bench.run(hour + 10);
    let edges = bench.edges(0);
    assert_eq!(edges.len(), 1800);
    let late = edges.iter().zip(1..).filter(|(edge, n)| edge.0 != begin + 1 + 250_000_000 * n).count();
    assert_eq!(late, 0, "{:?} from {begin}", &edges[..3]);
    assert!(bench.chip.asleep_cycles() >= hour);
}
