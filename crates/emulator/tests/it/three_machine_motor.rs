//! A published RP2040 driver for ULN2003 motors, run as it is: three state machines a motor and DMA channels that
//! restart one another (the Pico plotter in docs/sources.md). Its programs and its wiring of channels are quoted;
//! what they do was first found by others' measurements, and must come out here.

use crate::pico::{Bench, Machine};
use pio::pio_asm;

const RAM: u32 = 0x2000_0000;
const DMA: u32 = 0x5000_0000;

/// The table of half-steps, and the same backward.
const FORWARD: [u8; 8] = [0x9, 0x8, 0xc, 0x4, 0x6, 0x2, 0x3, 0x1];
const FORWARD_AT: u32 = RAM + 0x100;
const BACKWARD_AT: u32 = RAM + 0x108;
/// Variables of the driver.
const ADDRESS_POINTER: u32 = RAM;
const PULSE_LENGTH: u32 = RAM + 4;
const PULSE_COUNT: u32 = RAM + 8;
const PULSE_LENGTH_POINTER: u32 = RAM + 12;

const STEPPER: Machine = Machine::new(0, 0);
const PACER: Machine = Machine::new(0, 1);
const COUNTER: Machine = Machine::new(0, 2);
/// IN1 to IN4.
const PIN: u32 = 2;

const AUTOPULL: u32 = 1 << 17 | 1 << 19 | 1 << 18;

struct Motor {
    bench: Bench,
    /// The cycles in which the pins took another pattern, and the pattern.
    steps: Vec<(u64, u8)>,
}

impl Motor {
    /// Set up and waiting for a move, or with `counted` false the driver for speed only, which runs at once.
    fn new(pulse_length: u32, counted: bool) -> Motor {
        let mut bench = Bench::new();
        bench.chip.ram_mut()[0x100..0x108].copy_from_slice(&FORWARD);
        let backward: Vec<u8> = FORWARD.iter().rev().copied().collect();
        bench.chip.ram_mut()[0x108..0x110].copy_from_slice(&backward);
        bench.poke(ADDRESS_POINTER, FORWARD_AT);
        bench.poke(PULSE_LENGTH, pulse_length);
        bench.poke(PULSE_LENGTH_POINTER, PULSE_LENGTH);

        let stepper = pio_asm!("wait 1 irq 3", "out pins, 4").program;
        let pacer = pio_asm!("out x, 32", "countloop:", "jmp x-- countloop", "wait 1 irq 2", "irq 3").program;
        let free_pacer = pio_asm!("out x, 32", "countloop:", "jmp x-- countloop", "irq 3").program;
        let counter =
            pio_asm!("pull block", "mov x, osr", "countloop:", "irq wait 2", "jmp x-- countloop", "irq wait 0").program;
        STEPPER.load(&mut bench, &stepper, 0);
        STEPPER.outputs(&mut bench, PIN, 4);
        bench.set(STEPPER.pinctrl(), 4 << 20 | PIN);
        bench.set(STEPPER.shiftctrl(), AUTOPULL | 4 << 25);
        PACER.load(&mut bench, if counted { &pacer } else { &free_pacer }, 8);
        bench.set(PACER.shiftctrl(), AUTOPULL);
        COUNTER.load(&mut bench, &counter, 16);

        // Channel 0 feeds patterns, byte by byte; channel 1 gives it its address again. Channel 2 feeds the length of a
        // pulse; channel 3 likewise. Channel 4 feeds the count, started by the program.
        let word = 2 << 2;
        let to = |chain: u32, request: u32| 1 | chain << 11 | request << 15;
        bench.set(DMA + 4, STEPPER.txf());
        bench.set(DMA + 8, 8);
        bench.set(DMA + 0x10, to(1, STEPPER.dreq()) | 1 << 4);
        for (register, value) in [
            (0x40, ADDRESS_POINTER),
            (0x44, DMA),
            (0x48, 1),
            (0x50, to(0, 0x3f) | word),
            (0x84, PACER.txf()),
            (0x88, 1),
            (0x90, to(3, PACER.dreq()) | word),
            (0xc0, PULSE_LENGTH_POINTER),
            (0xc4, DMA + 0x80),
            (0xc8, 1),
            (0xd0, to(2, 0x3f) | word),
            (0x100, PULSE_COUNT),
            (0x104, COUNTER.txf()),
            (0x108, 1),
            (0x110, to(4, COUNTER.dreq()) | word),
        ] {
            bench.set(DMA + register, value);
        }
        // Channels 1 and 3, which start the others; then the machines.
        bench.set(DMA + 0x430, 1 << 1 | 1 << 3);
        bench.run(100);
        bench.set(STEPPER.base(), if counted { 0b111 } else { 0b011 });
        bench.seen.edges.clear();
        Motor { bench, steps: Vec::new() }
    }

    /// MOVE_STEPS_MOTOR_1.
    fn start_move(&mut self, steps: u32) {
        self.bench.poke(PULSE_COUNT, steps);
        self.bench.set(DMA + 0x430, 1 << 4);
    }

    fn run(&mut self, cycles: u64) {
        self.bench.run(cycles);
        let mut pattern = self.steps.last().map_or(0, |step| step.1);
        for edge in std::mem::take(&mut self.bench.seen.edges) {
            let bit = 1 << (u32::from(edge.gpio) - PIN);
            pattern = if edge.level.is_high() { pattern | bit } else { pattern & !bit };
            match self.steps.last_mut() {
                Some(last) if last.0 == edge.cycle => last.1 = pattern,
                _ => self.steps.push((edge.cycle, pattern)),
            }
        }
    }

    fn patterns(&self) -> Vec<u8> {
        self.steps.iter().map(|step| step.1).collect()
    }

    fn gaps(&self) -> Vec<u64> {
        self.steps.windows(2).map(|pair| pair[1].0 - pair[0].0).collect()
    }
}

/// "The user sets … the number of steps": n + 1 are made. The period is x + 4 cycles, not x; the first step is not
/// paced: the pacer has counted down before.
#[test]
fn a_move_makes_a_step_too_many() {
    for (count, length) in [(1, 1000), (5, 1000), (20, 12_345), (100, 77)] {
        let mut motor = Motor::new(length, true);
        motor.run(100_000);
        let start = motor.bench.now();
        assert_eq!(motor.steps, []);
        motor.start_move(count);
        motor.run(2_000_000);
        assert_eq!(motor.steps.len() as u32, count + 1, "MOVE {count}");
        assert_eq!(motor.gaps(), vec![u64::from(length) + 4; count as usize], "pulse length {length}");
        let first = motor.steps[0].0 - start;
        assert!(first < 30, "the first step comes after {first} cycles");
        let expected: Vec<u8> = FORWARD.iter().cycle().take(count as usize + 1).copied().collect();
        assert_eq!(motor.patterns(), expected);
    }
}

/// The interrupt that says that all is done comes as the last step begins, not as it ends.
#[test]
fn done_comes_before_the_last_step_has_lasted() {
    let mut motor = Motor::new(10_000, true);
    motor.run(20_000);
    motor.start_move(3);
    let mut done = None;
    while done.is_none() {
        motor.run(1);
        done = (motor.bench.get(STEPPER.base() + 0x30) & 1 != 0).then(|| motor.bench.now());
    }
    motor.run(50_000);
    let last = motor.steps[3].0;
    assert!(done.is_some_and(|done| done.abs_diff(last) < 10), "done in {done:?}, the last step began in {last}");
}

/// Without the counting machine the period is x + 3.
#[test]
fn speed_only() {
    for length in [100, 1000, 54_321] {
        let mut motor = Motor::new(length, false);
        motor.run(2_000_000);
        assert!(motor.gaps().len() > 30 && motor.gaps().iter().all(|gap| *gap == u64::from(length) + 3));
    }
}

/// A new pulse length shows only once those are through that wait in X, OSR and FIFO: with the seventh interval.
#[test]
fn a_new_speed_takes_seven_steps() {
    let mut motor = Motor::new(1000, false);
    motor.run(50_500);
    let before = motor.steps.len();
    motor.bench.poke(PULSE_LENGTH, 2000);
    motor.run(100_000);
    let gaps = &motor.gaps()[before - 1..];
    let old = gaps.iter().take_while(|gap| **gap == 1003).count();
    assert_eq!(old + 1, 7);
    assert!(gaps[old..].iter().all(|gap| *gap == 2003));
}

/// A reversal waits until the table is through, and then for OSR and FIFO: 6 to 13 half-steps still go the old way,
/// depending on the phase.
/// At the turn the last pattern comes twice: a half-step is lost.
#[test]
fn a_reversal_lags() {
    let mut lags = Vec::new();
    for phase in 0..8 {
        let mut motor = Motor::new(1000, false);
        motor.run(1003 * (40 + phase) + 500);
        let before = motor.steps.len();
        motor.bench.poke(ADDRESS_POINTER, BACKWARD_AT);
        motor.run(50_000);
        let index = |pattern: u8| FORWARD.iter().position(|other| *other == pattern).expect("a half-step");
        let after = &motor.steps[before - 1..];
        let forward = |pair: &&[(u64, u8)]| (index(pair[0].1) + 1) % 8 == index(pair[1].1);
        let lag = after.windows(2).take_while(forward).count();
        assert!(after.windows(2).skip(lag).all(|pair| (index(pair[1].1) + 1) % 8 == index(pair[0].1)));
        // The turn: two intervals in one, for the pattern that came twice.
        assert_eq!(after[lag + 1].0 - after[lag].0, 2 * 1003);
        lags.push(lag);
    }
    lags.sort_unstable();
    assert_eq!(lags, [6, 7, 8, 9, 10, 11, 12, 13]);
}

/// Two motors of the driver for position only, on one block, with the IRQ flags that are printed: one counts, and the
/// other's coils move.
#[test]
fn two_motors_move_each_other() {
    let mut bench = Bench::new();
    let counter = pio_asm!(
        "pull block",
        "mov x, osr",
        "countloop:",
        "jmp !x done",
        "irq wait 3",
        "jmp x-- countloop",
        "done:",
        "irq wait 1"
    )
    .program;
    let stepper = pio_asm!("wait 1 irq 3", "out pins, 4").program;
    let coils = [(Machine::new(0, 0), 2), (Machine::new(0, 2), 6)];
    for (machine, pin) in coils {
        machine.load(&mut bench, &stepper, 0);
        machine.outputs(&mut bench, pin, 4);
        bench.set(machine.pinctrl(), 4 << 20 | pin);
        bench.set(machine.shiftctrl(), AUTOPULL | 4 << 25);
        for pattern in [0x9, 0x8, 0xc, 0x4] {
            machine.push(&mut bench, pattern);
        }
    }
    let counts = Machine::new(0, 1);
    counts.load(&mut bench, &counter, 8);
    bench.set(STEPPER.base(), 0b111);
    bench.run(50);
    bench.seen.edges.clear();
    // A move of the first motor.
    counts.push(&mut bench, 3);
    bench.run(200);
    let moved = |range: std::ops::Range<u8>| bench.seen.edges.iter().any(|edge| range.contains(&edge.gpio));
    assert!(moved(6..10), "the other motor stands still");
}
