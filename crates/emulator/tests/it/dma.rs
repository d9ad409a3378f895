//! The DMA controller (RP2040 datasheet §2.5).

use crate::pico::{Bench, CLR, Machine, SET};
use pio::pio_asm;
use pulsetrain_emulator::LineByte;

const DMA: u32 = 0x5000_0000;
const RAM: u32 = 0x2000_0000;

// CTRL.
const EN: u32 = 1;
const HIGH_PRIORITY: u32 = 1 << 1;
const HALF: u32 = 1 << 2;
const WORD: u32 = 2 << 2;
const INCR_READ: u32 = 1 << 4;
const INCR_WRITE: u32 = 1 << 5;
const RING_WRITES: u32 = 1 << 10;
const IRQ_QUIET: u32 = 1 << 21;
const BSWAP: u32 = 1 << 22;
const SNIFF: u32 = 1 << 23;
const BUSY: u32 = 1 << 24;

const INTR: u32 = DMA + 0x400;
const ABORT: u32 = DMA + 0x444;

const fn ring(bits: u32) -> u32 {
    bits << 6
}

const fn chain(to: u32) -> u32 {
    to << 11
}

const fn request(number: u32) -> u32 {
    number << 15
}

const PERMANENT: u32 = request(0x3f);

/// A channel's registers.
const fn read(channel: u32) -> u32 {
    DMA + 0x40 * channel
}

const fn count(channel: u32) -> u32 {
    read(channel) + 8
}

const fn ctrl(channel: u32) -> u32 {
    read(channel) + 0xc
}

/// Sets a channel up and, if it is enabled, starts it: its first transfer is issued in the next cycle.
fn start(bench: &mut Bench, channel: u32, from: u32, to: u32, transfers: u32, control: u32) {
    bench.set(read(channel), from);
    bench.set(read(channel) + 4, to);
    bench.set(count(channel), transfers);
    bench.set(ctrl(channel), control);
}

fn fill(bench: &mut Bench, address: u32, words: &[u32]) {
    for (at, word) in words.iter().enumerate() {
        bench.poke(address + 4 * at as u32, *word);
    }
}

fn words(bench: &Bench, address: u32, number: u32) -> Vec<u32> {
    (0..number).map(|at| bench.chip.peek(address + 4 * at).expect("RAM")).collect()
}

/// Measured on a chip (github.com/raspberrypi/pico-feedback, issue 202): a state machine pushes an address; one channel
/// takes it into the other's READ_ADDR_TRIG; that one copies a byte into the TX FIFO, for which the machine's `out`
/// waits: the `out` takes 11 cycles.
#[test]
fn a_chain_of_11_cycles() {
    let mut bench = Bench::new();
    let machine = Machine::new(0, 0);
    let program = pio_asm!("in x, 32", "out y, 8", "set pins, 1", "h:", "jmp h").program;
    machine.load(&mut bench, &program, 0);
    machine.outputs(&mut bench, 0, 1);
    bench.set(machine.pinctrl(), 1 << 26);
    bench.poke(RAM + 0x100, 0x1234_56a7);
    // X is the address: pull, mov x, osr; then autopush of 32 bits, autopull of 8.
    machine.push(&mut bench, RAM + 0x100);
    machine.force(&mut bench, 0x80a0);
    machine.force(&mut bench, 0xa027);
    machine.force(&mut bench, 0x6060);
    bench.set(machine.shiftctrl(), 3 << 18 | 1 << 17 | 1 << 16 | 8 << 25);
    start(&mut bench, 1, 0, machine.txf(), 1, chain(1) | PERMANENT);
    bench.set(ctrl(1) - 0xc + 0x10, EN | chain(1) | PERMANENT);
    start(&mut bench, 0, machine.rxf(), read(1) + 0x3c, 1, EN | WORD | chain(0) | request(machine.dreq() + 4));
    bench.run(20);
    let pushed = bench.now() + 1;
    machine.enable(&mut bench);
    bench.run(40);
    // `out` from pushed + 1 to pushed + 11, `set` in the next, its edge in the one after.
    assert_eq!(bench.edges(0), [(pushed + 11 + 2, true)]);
    machine.disable(&mut bench);
    assert_eq!(machine.y(&mut bench), 0xa7);
}

/// §2.5: a word a cycle from memory to memory; the first is written four cycles after the trigger's.
#[test]
fn a_word_a_cycle() {
    let mut bench = Bench::new();
    let data: Vec<u32> = (0..64).map(|n| n * 0x0101_0101 + 7).collect();
    fill(&mut bench, RAM, &data);
    let trigger = bench.now();
    start(&mut bench, 2, RAM, RAM + 0x1000, 64, EN | WORD | INCR_READ | INCR_WRITE | chain(2) | PERMANENT);
    for n in 0..64 {
        // Issued in trigger + 1 + n, written in + 3 of it, seen in the next cycle.
        bench.run_to(trigger + 1 + n + 3);
        assert_eq!(bench.get(RAM + 0x1000 + 4 * n as u32), 0);
        bench.run(1);
        assert_eq!(bench.get(RAM + 0x1000 + 4 * n as u32), data[n as usize]);
    }
    assert_eq!((bench.get(ctrl(2)) & BUSY, bench.get(count(2)), bench.get(INTR)), (0, 0, 1 << 2));
}

/// §2.5.1: sizes and increments; §2.1.4: a narrow write to a register writes all of it, the data repeated.
#[test]
fn sizes() {
    let mut bench = Bench::new();
    fill(&mut bench, RAM, &[0x4433_2211, 0x8877_6655]);
    start(&mut bench, 0, RAM + 1, RAM + 0x100, 3, EN | INCR_READ | INCR_WRITE | PERMANENT);
    bench.run(20);
    assert_eq!(words(&bench, RAM + 0x100, 1), [0x0044_3322]);
    start(&mut bench, 0, RAM + 2, RAM + 0x200, 2, EN | HALF | INCR_READ | INCR_WRITE | PERMANENT | BSWAP);
    bench.run(20);
    assert_eq!(words(&bench, RAM + 0x200, 1), [0x5566_3344]);
    start(&mut bench, 0, RAM + 4, RAM + 0x300, 2, EN | WORD | INCR_WRITE | PERMANENT | BSWAP);
    bench.run(20);
    assert_eq!(words(&bench, RAM + 0x300, 2), [0x5566_7788; 2]);
    let machine = Machine::new(0, 0);
    start(&mut bench, 0, RAM + 1, machine.txf(), 1, EN | PERMANENT);
    bench.run(20);
    machine.force(&mut bench, 0x80a0);
    machine.force(&mut bench, 0xa027);
    assert_eq!(machine.x(&mut bench), 0x2222_2222);
}

/// §2.5.1.1: an address wraps within its ring, read or write.
#[test]
fn rings() {
    let mut bench = Bench::new();
    fill(&mut bench, RAM + 0x40, &[1, 2, 3, 4]);
    let both = EN | WORD | INCR_READ | INCR_WRITE | PERMANENT;
    start(&mut bench, 0, RAM + 0x48, RAM + 0x100, 6, both | ring(4));
    bench.run(20);
    assert_eq!(words(&bench, RAM + 0x100, 6), [3, 4, 1, 2, 3, 4]);
    assert_eq!(bench.get(read(0)), RAM + 0x40);
    start(&mut bench, 0, RAM + 0x40, RAM + 0x20c, 4, both | ring(3) | RING_WRITES);
    bench.run(20);
    assert_eq!(words(&bench, RAM + 0x208, 2), [4, 3]);
}

/// §2.5.2: blocks of control: one channel writes the other's registers, of which the last is a trigger; the other
/// chains back; a null trigger ends it, with an interrupt because of IRQ_QUIET.
#[test]
fn control_blocks() {
    let mut bench = Bench::new();
    fill(&mut bench, RAM, &[0xaa, 0xbb, 0xcc, 0xdd]);
    // AL1: CTRL, READ, WRITE, TRANS_COUNT_TRIG.
    let control = EN | WORD | INCR_READ | INCR_WRITE | chain(1) | PERMANENT | IRQ_QUIET;
    fill(&mut bench, RAM + 0x100, &[control, RAM + 8, RAM + 0x200, 2, control, RAM, RAM + 0x208, 1, control, 0, 0, 0]);
    let blocks = EN | WORD | INCR_READ | INCR_WRITE | ring(4) | RING_WRITES | chain(1) | PERMANENT | IRQ_QUIET;
    start(&mut bench, 1, RAM + 0x100, read(0) + 0x10, 4, blocks);
    bench.run(100);
    assert_eq!(words(&bench, RAM + 0x200, 4), [0xcc, 0xdd, 0xaa, 0]);
    assert_eq!(bench.get(INTR), 1);
    assert_eq!(bench.get(ctrl(0)) & BUSY, 0);
}

/// §2.5.2.1: each alias ends in a trigger, other registers do not start anything; §2.5.7, MULTI_CHAN_TRIGGER.
#[test]
fn triggers() {
    for (last, value) in [(0x0c, EN | WORD | PERMANENT), (0x1c, 1), (0x2c, RAM + 0x100), (0x3c, RAM)] {
        let mut bench = Bench::new();
        bench.poke(RAM, 5);
        for (register, value) in [(0x00, RAM), (0x04, RAM + 0x100), (0x08, 1), (0x10, EN | WORD | PERMANENT)] {
            bench.set(read(3) + register, value);
        }
        bench.run(10);
        assert_eq!(words(&bench, RAM + 0x100, 1), [0]);
        bench.set(read(3) + last, value);
        bench.run(10);
        assert_eq!(words(&bench, RAM + 0x100, 1), [5], "register {last:#x}");
    }
    let mut bench = Bench::new();
    for channel in [4, 7] {
        bench.poke(RAM + 4 * channel, channel);
        start(&mut bench, channel, RAM + 4 * channel, RAM + 0x100 + 4 * channel, 1, 0);
        bench.set(read(channel) + 0x10, EN | WORD | PERMANENT | chain(channel));
    }
    bench.set(DMA + 0x430, 1 << 4 | 1 << 7);
    bench.run(10);
    assert_eq!(words(&bench, RAM + 0x110, 4), [4, 0, 0, 7]);
    assert_eq!(bench.get(INTR), 1 << 4 | 1 << 7);
}

/// §2.5.5.1: X/Y of a request a cycle.
#[test]
fn pacing_timers() {
    let mut bench = Bench::new();
    // Two transfers in five cycles.
    bench.set(DMA + 0x420, 2 << 16 | 5);
    let begin = bench.now();
    start(&mut bench, 0, RAM, RAM + 0x100, 400, EN | WORD | INCR_READ | request(0x3b));
    bench.run(1004);
    let left = bench.get(count(0));
    assert!((0..=1).contains(&left), "{left} left after {} cycles", bench.now() - begin);
    bench.run(10);
    assert_eq!(bench.get(ctrl(0)) & BUSY, 0);
}

/// §3.5.3: eight words of FIFO are enough for a word a cycle; the machine never waits once it runs.
#[test]
fn a_word_a_cycle_into_a_machine() {
    let mut bench = Bench::new();
    let machine = Machine::new(1, 2);
    machine.load(&mut bench, &pio_asm!("out null, 32").program, 0);
    bench.set(machine.shiftctrl(), 1 << 30 | 1 << 19 | 1 << 17);
    start(&mut bench, 0, RAM, machine.txf(), 10_000, EN | WORD | INCR_READ | ring(10) | request(machine.dreq()));
    bench.run(30);
    assert_eq!(machine.levels(&mut bench).0, 8);
    bench.set(machine.base() + 8, 0xf << 24);
    machine.enable(&mut bench);
    bench.run(9_000);
    assert_eq!(bench.get(machine.base() + 8), 0);
    // Every cycle but the first, which fills the OSR, took a word.
    let left = bench.get(count(0)) + machine.levels(&mut bench).0;
    assert!((1_000..=1_005).contains(&left), "{left}");
}

/// §2.5.3.2: credit. Eight channels feed eight machines that take a word every eight cycles: a word a cycle in all, none
/// of them too late, no FIFO too full.
#[test]
fn eight_machines_at_once() {
    let mut bench = Bench::new();
    for number in 0..8u32 {
        let machine = Machine::new(number / 4, number % 4);
        machine.load(&mut bench, &pio_asm!("out null, 32 [7]").program, 0);
        bench.set(machine.shiftctrl(), 1 << 30 | 1 << 19 | 1 << 17);
        let control = EN | WORD | INCR_READ | ring(10) | request(machine.dreq()) | chain(number);
        start(&mut bench, number, RAM, machine.txf(), 100_000, control);
    }
    bench.run(100);
    for block in [0x5020_0000, 0x5030_0000] {
        bench.set(block + 8, u32::MAX);
        bench.set(block, 0xf);
    }
    bench.run(80_000);
    // Neither TXSTALL nor TXOVER.
    assert_eq!((bench.get(0x5020_0008), bench.get(0x5030_0008)), (0, 0));
    for number in 0..8 {
        let moved = 100_000 - bench.get(count(number));
        assert!((10_000..10_010).contains(&moved), "channel {number}: {moved}");
    }
}

/// Pulses out of words: delay, a pair of pins, the same pair later. Eight machines of both blocks wait for one pin, begin
/// in the same cycle, and every edge is where the words say: x + 4 + W cycles from pulse to pulse, W + 1 long.
fn pulse_trains(machines: u32, wait: u32, delay: impl Fn(u32, u32) -> u32) -> Vec<Vec<(u64, bool)>> {
    const WORDS: u32 = 64;
    let mut bench = Bench::new();
    let program = pio_asm!(
        "wait 1 gpio 25",
        ".wrap_target",
        "out x, 28",
        "l:",
        "jmp x-- l",
        "out pins, 2",
        "out pins, 2",
        ".wrap"
    )
    .program;
    for number in 0..machines {
        let machine = Machine::new(number / 4, number % 4);
        machine.load(&mut bench, &program, 0);
        bench.set(machine.base() + 0x48 + 4 * 3, u32::from(program.code[3]) | wait << 8);
        machine.outputs(&mut bench, 2 * number, 2);
        bench.set(machine.pinctrl(), 2 << 20 | number << 1);
        bench.set(machine.shiftctrl(), 1 << 30 | 1 << 19 | 1 << 17);
        let words: Vec<u32> = (0..WORDS).map(|n| delay(number, n) | 1 << 28).collect();
        let at = RAM + 0x1000 * number;
        fill(&mut bench, at, &words);
        start(
            &mut bench,
            number,
            at,
            machine.txf(),
            WORDS,
            EN | WORD | INCR_READ | request(machine.dreq()) | chain(number),
        );
    }
    bench.set(0x5020_0000, 0xf);
    bench.run(7);
    bench.set(0x5030_0000, 0xf);
    bench.run(100);
    bench.seen.edges.clear();
    let gate = bench.now();
    bench.chip.set_input(25, Some(true.into()));
    bench.run(100_000);
    // Starved, they rest low.
    assert!((0..machines).all(|number| !bench.chip.pin(2 * number as u8).is_high()));
    let edges = |number: u32| {
        let of = bench.seen.edges.iter().filter(|edge| u32::from(edge.gpio) == 2 * number);
        of.map(|edge| (edge.cycle - gate, edge.level.is_high())).collect::<Vec<_>>()
    };
    (0..machines).map(edges).collect()
}

#[test]
fn eight_pulse_trains() {
    for wait in [0, 3] {
        let delay = |number: u32, n: u32| (number * 37 + n * n * 11) % 500 + 4;
        let trains = pulse_trains(8, wait, delay);
        for (number, train) in (0u32..).zip(&trains) {
            // The gate is seen after 2 cycles of synchroniser; `out x` is the next, x + 1 jumps, `out pins`, its edge.
            let rises: Vec<u64> = train.iter().filter(|edge| edge.1).map(|edge| edge.0).collect();
            assert_eq!(rises[0], 2 + 1 + u64::from(delay(number, 0)) + 1 + 1 + 1, "machine {number}");
            for n in 1..64 {
                let period = u64::from(delay(number, n)) + 4 + u64::from(wait);
                assert_eq!(rises[n as usize] - rises[n as usize - 1], period, "machine {number}, pulse {n}");
            }
            let lengths = train.chunks(2).map(|pulse| pulse[1].0 - pulse[0].0);
            assert!(lengths.clone().eq(std::iter::repeat_n(u64::from(wait) + 1, 64)), "machine {number}");
        }
    }
}

/// The shortest periods that DMA keeps up with, a word a cycle: four machines every 4 cycles, eight every 8.
#[test]
fn the_shortest_pulses() {
    for (machines, period) in [(4, 4), (8, 8)] {
        for train in pulse_trains(machines, 0, |_, _| period - 4) {
            let rises: Vec<u64> = train.iter().filter(|edge| edge.1).map(|edge| edge.0).collect();
            assert!(rises.len() == 64 && rises.windows(2).all(|pair| pair[1] - pair[0] == u64::from(period)));
        }
    }
}

/// §2.5.7, HIGH_PRIORITY: channels in turn; a high one comes between any two of the low.
#[test]
fn priorities() {
    let mut bench = Bench::new();
    let order = |bench: &mut Bench, high: u32| {
        for channel in 0..3 {
            let control = EN | WORD | INCR_WRITE | PERMANENT | chain(channel);
            let control = control | if channel == high { HIGH_PRIORITY } else { 0 };
            start(bench, channel, RAM, RAM + 0x100 * (channel + 1), 60, 0);
            bench.set(read(channel) + 0x10, control);
        }
        bench.set(DMA + 0x430, 7);
        bench.run(40);
        (0..3).map(|channel| 60 - bench.get(count(channel))).collect::<Vec<_>>()
    };
    let fair = order(&mut bench, 99);
    assert!(fair.iter().all(|moved| (12..=13).contains(moved)), "{fair:?}");
    bench.run(200);
    let unfair = order(&mut bench, 1);
    assert!((18..=19).contains(&unfair[1]) && unfair[0] <= 10 && unfair[2] <= 10, "{unfair:?}");
}

/// §2.5.4: both lines, their enables, forces and status; a transfer's end interrupts unless it is quiet.
#[test]
fn interrupts() {
    let mut bench = Bench::new();
    start(&mut bench, 5, RAM, RAM + 0x100, 3, EN | WORD | PERMANENT | chain(5));
    start(&mut bench, 6, RAM, RAM + 0x100, 3, EN | WORD | PERMANENT | chain(6) | IRQ_QUIET);
    bench.run(20);
    bench.set(DMA + 0x404, 1 << 4);
    bench.set(DMA + 0x414, 1 << 5);
    bench.set(DMA + 0x408, 1 << 9);
    bench.run(1);
    let status = [0x400, 0x40c, 0x41c].map(|offset| bench.get(DMA + offset));
    assert_eq!(status, [1 << 5, 1 << 9, 1 << 5]);
    bench.set(DMA + 0x41c, 1 << 5);
    bench.run(1);
    assert_eq!(bench.get(INTR), 0);
}

/// §2.5.5.3, and erratum RP2040-E13: an abort ends a channel; one that makes progress interrupts.
#[test]
fn aborts() {
    let mut bench = Bench::new();
    let machine = Machine::new(0, 0);
    start(&mut bench, 0, RAM, machine.txf(), 1000, EN | WORD | INCR_READ | request(machine.dreq()));
    bench.run(50);
    assert_eq!((bench.get(count(0)), bench.get(read(0))), (996, RAM + 16));
    bench.set(ABORT, 1);
    bench.run(1);
    assert_eq!((bench.get(ABORT), bench.get(ctrl(0)) & BUSY, bench.get(INTR)), (0, 0, 0));
    // Registers stay: what went through can be read.
    assert_eq!((bench.get(count(0)), bench.get(read(0)), machine.levels(&mut bench).0), (996, RAM + 16, 4));

    start(&mut bench, 1, RAM, RAM + 0x1000, 1000, EN | WORD | INCR_READ | INCR_WRITE | PERMANENT | chain(1));
    bench.run(100);
    bench.set(ABORT, 2);
    bench.run(1);
    assert_eq!(bench.get(ABORT), 2);
    bench.run(10);
    assert_eq!((bench.get(ABORT), bench.get(ctrl(1)) & BUSY, bench.get(INTR)), (0, 0, 2));
    let moved = (1000 - bench.get(count(1))) * 4;
    assert_eq!((bench.get(read(1)), bench.get(read(1) + 4)), (RAM + moved, RAM + 0x1000 + moved));
}

/// Clearing EN pauses; setting it goes on. TRANS_COUNT is written for the next start, DBG_TCR reads what was written.
#[test]
fn pausing() {
    let mut bench = Bench::new();
    start(&mut bench, 0, RAM, RAM + 0x1000, 500, EN | WORD | INCR_READ | INCR_WRITE | PERMANENT);
    bench.run(100);
    bench.set(read(0) + 0x10 + CLR, EN);
    bench.run(10);
    let left = bench.get(count(0));
    bench.run(100);
    assert_eq!((bench.get(count(0)), bench.get(ctrl(0)) & BUSY), (left, BUSY));
    bench.set(count(0), 7);
    bench.set(read(0) + 0x10 + SET, EN);
    bench.run(1);
    assert_eq!((bench.get(DMA + 0x804), bench.get(ctrl(0)) & BUSY), (7, BUSY));
    bench.run(500);
    assert_eq!((bench.get(count(0)), bench.get(read(0))), (0, RAM + 2000));
}

/// READ_ADDR and WRITE_ADDR take off what is under way, whatever INCR and RING say: with a ring the value may lie
/// before it (pico-feedback, issue 208).
#[test]
fn addresses_under_way() {
    let mut bench = Bench::new();
    start(&mut bench, 0, RAM, RAM + 0x1000, 8, EN | WORD | INCR_READ | PERMANENT);
    bench.run(3);
    // Issued in +1 and +2: none is written, and this is cycle 3, in which the first has been read.
    assert_eq!((bench.get(read(0)), bench.get(read(0) + 4)), (RAM + 4, RAM + 0x1000 - 8));
}

/// An address without memory or register halts the channel (AHB_ERROR).
#[test]
fn bus_errors() {
    let mut bench = Bench::new();
    start(&mut bench, 0, 0x6000_0000, RAM, 8, EN | WORD | PERMANENT);
    bench.run(20);
    assert_eq!(bench.get(ctrl(0)) & (BUSY | 7 << 29), 1 << 31 | 1 << 30);
    bench.set(ctrl(0), 1 << 30);
    bench.run(1);
    assert_eq!(bench.get(ctrl(0)) >> 29, 0);
    // SIO is the processors' alone.
    start(&mut bench, 1, RAM, 0xd000_0010, 1, EN | WORD | PERMANENT | chain(1));
    bench.run(20);
    assert_eq!(bench.get(ctrl(1)) >> 29, 0b101);
}

/// §2.5.5.2: checksums of "123456789", known everywhere.
#[test]
fn sniffing() {
    let sniff = |control: u32, seed: u32| {
        let mut bench = Bench::new();
        for (at, byte) in b"123456789".iter().enumerate() {
            bench.chip.ram_mut()[at] = *byte;
        }
        bench.set(DMA + 0x438, seed);
        bench.set(DMA + 0x434, control | 1);
        start(&mut bench, 0, RAM, RAM + 0x100, 9, EN | INCR_READ | PERMANENT | SNIFF);
        bench.run(40);
        bench.get(DMA + 0x438)
    };
    // CRC-32: data bits reversed, result reversed and inverted.
    assert_eq!(sniff(1 << 5 | 1 << 10 | 1 << 11, u32::MAX), 0xcbf4_3926);
    // CRC-32/MPEG-2, CRC-16/CCITT-FALSE, sum.
    assert_eq!(sniff(0, u32::MAX), 0x0376_e6e7);
    assert_eq!(sniff(2 << 5, 0xffff) & 0xffff, 0x29b1);
    assert_eq!(sniff(0xf << 5, 0), b"123456789".iter().map(|byte| u32::from(*byte)).sum::<u32>());
}

/// A UART's receiver fills a ring by itself, as the DREQ says; a transmitter is fed.
#[test]
fn a_uart() {
    let mut bench = Bench::new();
    // clk_peri from clk_sys; 16 (1 + 0/64) cycles a bit; 8 bits, FIFOs; UARTEN, TXE, RXE; both DMA enables.
    bench.set(0x4000_8048, 1 << 11);
    bench.give([0, 1], 2);
    for (offset, value) in [(0x24, 1), (0x28, 0), (0x2c, 0x70), (0x30, 0x301), (0x48, 3)] {
        bench.set(0x4003_4000 + offset, value);
    }
    let uart = 0x4003_4000;
    start(&mut bench, 0, uart, RAM + 0x100, 100, EN | INCR_WRITE | ring(4) | RING_WRITES | request(21));
    bench.poke(RAM, 0x6463_6261);
    start(&mut bench, 1, RAM, uart, 4, EN | INCR_READ | request(20) | chain(1));
    let begin = bench.now() + 10;
    for (n, byte) in b"hello, world: mor".iter().enumerate() {
        bench.chip.receive(0, LineByte::new(begin + 160 * n as u64, *byte, 16 * 256));
    }
    bench.run(5000);
    let sent: Vec<u16> = bench.seen.sent.iter().map(|byte| byte.data).collect();
    assert_eq!(sent, b"abcd".map(u16::from));
    assert_eq!(&bench.chip.ram()[0x100..0x110], b"rello, world: mo");
}
