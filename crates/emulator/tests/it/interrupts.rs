//! Interrupts, sleep and what wakes (DS40002061B §7.7, §10, §12, §13).

use crate::common::{Bench, reg::*};
use pulsetrain_emulator::{Atmega328p, Masked};
use pulsetrain_emulator::{Boot, BootSize, Level, Port, ResetCause};

const SEI: u16 = 0x9478;
const CLI: u16 = 0x94f8;
const RETI: u16 = 0x9518;
const SLEEP: u16 = 0x9588;
const NOP: u16 = 0;

/// A program at 0x40, `reti` in every vector.
fn with_vectors(program: &[u16]) -> Bench {
    let mut words = vec![NOP; 0x40 + program.len()];
    for vector in 1..26 {
        words[2 * vector] = RETI;
    }
    words[0x40..].copy_from_slice(program);
    let mut bench = Bench::with(&words);
    bench.chip.set_pc(0x40);
    bench
}

/// Timer1 counts from 0 in the present cycle; OCF1A is set `cycles` later.
fn timer_in(bench: &mut Bench, cycles: u16) {
    bench.set_wide(OCR1A, cycles - 1);
    bench.set(TIMSK1, 2);
    bench.set(TCCR1B, 1);
}

/// Steps until the program counter is at a word address; the cycle.
fn reach(bench: &mut Bench, pc: u16) -> u64 {
    for _ in 0..10_000 {
        if bench.chip.pc() == pc {
            return bench.now();
        }
        bench.chip.step(&mut bench.seen);
    }
    panic!("{pc:#x} was not reached");
}

/// §7.7.1: four cycles from the flag to the vector's instruction; a longer instruction is finished first.
#[test]
fn response_takes_four_cycles() {
    for (program, late) in
        [(&[NOP; 64][..], 0), (&[0xc000; 64][..], 1), (&[0xc000, NOP, 0xc000, 0xc000, 0xc000, 0xc000, 0xc000][..], 0)]
    {
        let mut bench = with_vectors(program);
        bench.set(SREG, 0x80);
        timer_in(&mut bench, 7);
        assert_eq!(reach(&mut bench, 22), 7 + late + 4, "{program:x?}");
        assert_eq!(bench.get(TIFR1) & 2, 0, "the flag is cleared on entry");
        assert_eq!(bench.chip.sreg() & 0x80, 0);
        assert_eq!(bench.chip.sp(), 0x8fd);
    }
}

/// The return address lies with its lower byte above; `reti` takes 4 cycles and sets I.
#[test]
fn entry_and_return() {
    let mut bench = with_vectors(&[NOP; 300]);
    bench.set(SREG, 0x80);
    timer_in(&mut bench, 0xd0);
    reach(&mut bench, 22);
    let ram = bench.chip.ram();
    assert_eq!((ram[0x7ff], ram[0x7fe]), (0x10, 0x01));
    let began = bench.now();
    bench.chip.step(&mut bench.seen);
    assert_eq!((bench.now() - began, bench.chip.pc(), bench.chip.sreg() & 0x80), (4, 0x110, 0x80));
}

/// §7.7: the instruction after `sei` is executed before an interrupt that waits; and `sei; cli` takes none, but
/// `sei; nop; cli` does.
#[test]
fn one_instruction_after_sei() {
    for (program, taken_at) in [
        (&[SEI, NOP, NOP, CLI][..], Some(0x42)),
        (&[SEI, NOP, CLI, NOP][..], Some(0x42)),
        (&[SEI, CLI, NOP, NOP][..], None),
        // out SREG, r16
        (&[0xbf0f, NOP, NOP, CLI][..], Some(0x42)),
    ] {
        let mut bench = with_vectors(program);
        bench.chip.set_register(16, 0x80);
        timer_in(&mut bench, 1);
        // The flag waits when the program begins.
        bench.chip.set_pc(0x200);
        bench.run(1);
        bench.chip.set_pc(0x40);
        let mut from = None;
        for _ in 0..6 {
            let before = bench.chip.pc();
            bench.chip.step(&mut bench.seen);
            if bench.chip.pc() == 22 {
                from = Some(before);
            }
        }
        assert_eq!(from, taken_at, "{program:x?}");
    }
}

/// §7.7: after `reti` one instruction of the main program is executed, even if another interrupt waits.
#[test]
fn one_instruction_after_reti() {
    let mut bench = with_vectors(&[NOP; 100]);
    bench.set(SREG, 0x80);
    bench.set_wide(OCR1A, 10);
    bench.set_wide(OCR1B, 10);
    bench.set(TIMSK1, 6);
    bench.set(TCCR1B, 1);
    // COMPA has the lower number; COMPB waits.
    assert_eq!(reach(&mut bench, 22), 11 + 4);
    let main = reach(&mut bench, 0x40 + 11);
    assert_eq!(main, 15 + 4);
    bench.chip.step(&mut bench.seen);
    assert_eq!(bench.chip.pc(), 0x40 + 12);
    bench.chip.step(&mut bench.seen);
    assert_eq!((bench.chip.pc(), bench.now()), (24, 15 + 4 + 1 + 4));
}

/// §10, §7.7.1: idle costs 4 cycles more; timers run on.
#[test]
fn waking_from_idle() {
    let mut bench = with_vectors(&[SLEEP, NOP, NOP]);
    bench.set(SREG, 0x80);
    bench.set(SMCR, 1);
    timer_in(&mut bench, 5000);
    assert_eq!(reach(&mut bench, 22), 5000 + 4 + 4);
    assert_eq!(bench.chip.asleep_cycles(), 5000 + 4 - 1);
    reach(&mut bench, 0x41);
    // Without SE it is a nop.
    let mut bench = with_vectors(&[SLEEP, NOP, NOP]);
    bench.run(2);
    assert_eq!((bench.chip.pc(), bench.chip.is_asleep()), (0x42, false));
}

/// `sei; sleep` cannot miss an interrupt that comes before: it sleeps first, and wakes at once (§7.7).
#[test]
fn sei_sleep() {
    let mut bench = with_vectors(&[SEI, SLEEP, NOP]);
    bench.set(SMCR, 1);
    timer_in(&mut bench, 1);
    assert_eq!(reach(&mut bench, 22), 2 + 4 + 4);
    assert_eq!(reach(&mut bench, 0x42), 14);
}

/// With interrupts off nothing but a reset ends a sleep.
#[test]
fn sleep_with_interrupts_off_is_for_ever() {
    let mut bench = with_vectors(&[SLEEP, NOP]);
    bench.set(SMCR, 1);
    timer_in(&mut bench, 100);
    bench.run(1_000_000_000);
    assert_eq!((bench.now(), bench.chip.is_asleep()), (1_000_000_000, true));
    bench.chip.reset(ResetCause::External, &mut bench.seen);
    assert_eq!((bench.chip.is_asleep(), bench.chip.pc()), (false, 0));
}

/// §10.5: in power-down Timer1 stands still; a pin change wakes after the crystal's start-up of 16 K cycles.
#[test]
fn power_down() {
    let mut bench = with_vectors(&[SLEEP, NOP, NOP, NOP, NOP, NOP, NOP, NOP]);
    bench.set(SREG, 0x80);
    bench.set(SMCR, 0x05);
    bench.set(PCICR, 4);
    bench.set(PCMSK2, 0x10);
    timer_in(&mut bench, 5000);
    bench.run(1_000_000);
    assert!(bench.chip.is_asleep());
    bench.chip.set_input(Port::D, 4, Some(Level::High));
    assert_eq!(reach(&mut bench, 10), 1_000_003 + 16_384 + 4 + 4);
    assert_eq!(bench.get_wide(TCNT1), 1 + 8, "counted while the processor was awake, and on the way to the vector");
}

/// §13.2: INT0 by edge, behind three cycles; by level as long as it lasts.
#[test]
fn external_interrupts() {
    for (sense, first, then, count) in
        [(1, Level::High, Level::Low, 2), (2, Level::High, Level::Low, 1), (3, Level::High, Level::Low, 1)]
    {
        let mut bench = with_vectors(&[NOP; 200]);
        bench.set(SREG, 0x80);
        bench.set(EICRA, sense);
        bench.set(EIMSK, 1);
        let mut entries = Vec::new();
        for n in 0..100 {
            match n {
                20 => bench.chip.set_input(Port::D, 2, Some(first)),
                50 => bench.chip.set_input(Port::D, 2, Some(then)),
                _ => {}
            }
            bench.chip.step(&mut bench.seen);
            if bench.chip.pc() == 2 {
                entries.push(n);
            }
        }
        assert_eq!(entries.len(), count, "sense {sense}: {entries:?}");
    }
    let mut bench = with_vectors(&[NOP; 200]);
    bench.chip.set_input(Port::D, 2, Some(Level::High));
    bench.set(SREG, 0x80);
    bench.set(EIMSK, 1);
    bench.run(20);
    assert_eq!(bench.chip.pc(), 0x54);
    bench.chip.set_input(Port::D, 2, Some(Level::Low));
    reach(&mut bench, 2);
    reach(&mut bench, 0x54);
    assert_eq!(bench.get(EIFR), 0, "a level has no flag");
    reach(&mut bench, 2);
}

/// §13.2.4: a change of any pin of the mask, of outputs too.
#[test]
fn pin_change_interrupts() {
    let mut bench = Bench::nops();
    bench.set(PCMSK2, 0x80);
    bench.set(DDRD, 0x80);
    bench.set(PORTD, 0x40);
    bench.run(10);
    assert_eq!(bench.get(PCIFR), 0);
    bench.set(PORTD, 0x80);
    bench.run(2);
    assert_eq!(bench.get(PCIFR), 0);
    bench.run(1);
    assert_eq!(bench.get(PCIFR), 4);
    bench.set(PCIFR, 4);
    assert_eq!(bench.get(PCIFR), 0);
}

/// The longest stretch with interrupts off, and where it began; the lowest stack pointer.
#[test]
fn what_a_developer_wants_to_know() {
    let mut bench = with_vectors(&[SEI, NOP, CLI, 0xc000, 0xc000, SEI, CLI, NOP, SEI, 0x930f, NOP]);
    bench.run(2);
    bench.chip.forget_masked();
    bench.run(20);
    assert_eq!(bench.chip.longest_masked(), Masked { cycles: 5, from: 0x43 });
    assert_eq!(bench.chip.lowest_sp(), 0x8fe);
}

/// §11.9, table 12-5: causes gather in MCUSR until power comes on; a boot section by its fuses.
#[test]
fn resets() {
    let mut bench = Bench::nops();
    assert_eq!(bench.get(MCUSR), 1);
    bench.set(MCUSR, 0);
    bench.run(100);
    bench.set(0x100, 77);
    bench.set(DDRB, 1);
    bench.set(PORTB, 1);
    bench.chip.reset(ResetCause::External, &mut bench.seen);
    assert_eq!((bench.get(MCUSR), bench.get(0x100), bench.chip.pc(), bench.now()), (2, 77, 0, 100));
    assert_eq!(bench.edges(Port::B, 0), [(100, true), (100, false)]);
    bench.chip.hold(ResetCause::BrownOut, 5000, &mut bench.seen);
    assert_eq!((bench.get(MCUSR), bench.now()), (6, 5000));
    bench.chip.reset(ResetCause::PowerOn, &mut bench.seen);
    assert_eq!(bench.get(MCUSR), 1);
    let boot = Boot { size: BootSize::Words1024, start: true };
    assert_eq!(Atmega328p::with_boot(&[], boot).expect("it fits").pc(), 0x3c00);
}

/// §9.12.2: CLKPR only in its timed sequence; the watchdog's oscillator is not divided.
#[test]
fn clock_prescaler() {
    let mut bench = Bench::nops();
    bench.set(CLKPR, 3);
    assert_eq!(bench.get(CLKPR), 0);
    bench.set(CLKPR, 0x80);
    bench.run(5);
    bench.set(CLKPR, 3);
    assert_eq!(bench.get(CLKPR), 0, "five cycles later");
    bench.set(CLKPR, 0x80);
    bench.run(3);
    bench.set(CLKPR, 3);
    assert_eq!(bench.get(CLKPR), 3);
    assert_eq!(bench.seen.divisions, [(8, 8)]);
    bench.set(WDTCSR, 0x08);
    bench.run(16 * 16_000);
    assert_eq!(bench.seen.watchdog, [8 + 2048 * 125 / 8]);
}

/// §11.8, §11.9.2: interrupt, reset, both; the timed sequence; WDRF keeps it on.
#[test]
fn watchdog() {
    const TIME_OUT: u64 = 2048 * 125;
    // Interrupt alone: again and again.
    let mut bench = with_vectors(&[0xcfff]);
    bench.set(SREG, 0x80);
    bench.set(WDTCSR, 0x40);
    let first = reach_after(&mut bench, 12, TIME_OUT);
    assert!((TIME_OUT + 4..TIME_OUT + 6).contains(&first), "{first}");
    let second = reach_after(&mut bench, 12, TIME_OUT);
    assert!((2 * TIME_OUT + 4..2 * TIME_OUT + 6).contains(&second), "{second}");
    // Both: the interrupt clears WDIE, the next time-out resets.
    let mut bench = with_vectors(&[0xcfff]);
    bench.set(SREG, 0x80);
    bench.set(WDTCSR, 0x48);
    bench.run(TIME_OUT + 100);
    assert_eq!(bench.get(WDTCSR), 0x08);
    assert_eq!(bench.seen.watchdog, [] as [u64; 0]);
    bench.run(TIME_OUT);
    assert_eq!((bench.seen.watchdog.len(), bench.get(MCUSR), bench.get(WDTCSR)), (1, 9, 8));
    // WDRF: WDE cannot be cleared; then it can, in its sequence.
    bench.chip.set_pc(0x100);
    bench.set(WDTCSR, 0x18);
    bench.set(WDTCSR, 0);
    assert_eq!(bench.get(WDTCSR) & 8, 8);
    bench.set(MCUSR, 0);
    bench.set(WDTCSR, 0);
    assert_eq!(bench.get(WDTCSR) & 8, 8, "not without the sequence");
    bench.set(WDTCSR, 0x18);
    bench.run(5);
    bench.set(WDTCSR, 0);
    assert_eq!(bench.get(WDTCSR) & 8, 8, "too late");
    bench.set(WDTCSR, 0x18);
    bench.run(3);
    bench.set(WDTCSR, 0);
    assert_eq!(bench.get(WDTCSR), 0);
    bench.run(3 * TIME_OUT);
    assert_eq!(bench.seen.watchdog.len(), 1);
    // The longest time: 1024 K cycles of 128 kHz, 8 s.
    bench.set(WDTCSR, 0x18);
    bench.set(WDTCSR, 0x29);
    let start = bench.now();
    bench.run(8 * 16_777_216);
    assert_eq!(bench.seen.watchdog[1] - start, 1024 * 1024 * 125);
}

/// Runs some cycles, then steps to a word address.
fn reach_after(bench: &mut Bench, pc: u16, cycles: u64) -> u64 {
    bench.run(cycles - 50);
    reach(bench, pc)
}

/// `wdr` restarts the time-out.
#[test]
fn watchdog_is_fed() {
    let mut bench = Bench::with(&[0x95a8, 0xcffe]);
    bench.set(WDTCSR, 0x08);
    // wdr takes a cycle, rjmp two; wdr comes first.
    bench.run(9_999_999);
    assert_eq!(bench.seen.watchdog, [] as [u64; 0]);
    assert_eq!(bench.chip.watchdog_feeds(), 3_333_333);
    // The count is since power came on: a reset does not clear it.
    bench.chip.reset(ResetCause::External, &mut bench.seen);
    assert_eq!(bench.chip.watchdog_feeds(), 3_333_333);
}

/// §8.6: a write takes 3.4 ms and a timed sequence, halts 2 cycles; a read halts 4; the interrupt is by level.
#[test]
fn eeprom() {
    // sbi EECR, EEMPE; sbi EECR, EEPE
    let mut bench = Bench::with(&[0x9afa, 0x9af9]);
    bench.set(EEARL, 5);
    bench.set(EEDR, 0xa5);
    bench.run(5);
    assert_eq!(bench.now(), 6, "sbi, sbi, two cycles of halt");
    assert_eq!((bench.get(EECR), bench.chip.eeprom()[5]), (2, 0xa5));
    bench.set(EEARL, 6);
    assert_eq!(bench.get(EEARL), 5, "the address stays while it is written");
    bench.run(54_397);
    assert_eq!(bench.get(EECR), 2);
    bench.run(1);
    assert_eq!(bench.get(EECR), 0);
    bench.set(EEDR, 0);
    bench.set(EECR, 1);
    let began = bench.now();
    bench.chip.step(&mut bench.seen);
    assert_eq!((bench.now() - began, bench.get(EEDR)), (4, 0xa5));
    // EEPE without EEMPE does nothing; nor too late.
    bench.set(EECR, 2);
    bench.set(EECR, 4);
    bench.run(5);
    bench.set(EECR, 2);
    assert_eq!(bench.get(EECR) & 2, 0);
    // Writing alone can only clear bits.
    bench.set(EEDR, 0x0f);
    bench.set(EECR, 0x24);
    bench.set(EECR, 0x22);
    assert_eq!(bench.chip.eeprom()[5], 0x05);
}

/// What the chip does not have is one cycle of nothing, and counted; `spm` outside the boot section does nothing.
#[test]
fn odd_instructions() {
    let mut bench = Bench::with(&[NOP, 0x0001, 0x95e8, 0x95d8]);
    bench.run(4);
    let odd = bench.chip.odd();
    assert_eq!((odd.undefined, odd.last_undefined, bench.chip.spm_count()), (2, 3, 1));
}
