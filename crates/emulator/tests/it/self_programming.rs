//! Self-programming (DS40002061B §27): `spm` and SPMCSR, by hand and in the cycle that is wanted.

use crate::common::{Bench, Seen, reg::*};
use pulsetrain_emulator::{Atmega328p, Boot, BootSize, ResetCause};

const SPMCSR: u16 = 0x57;
const SPMEN: u8 = 1;
const PGERS: u8 = 1 << 1;
const PGWRT: u8 = 1 << 2;
const BLBSET: u8 = 1 << 3;
const RWWSRE: u8 = 1 << 4;
const SIGRD: u8 = 1 << 5;
const RWWSB: u8 = 1 << 6;
const SPMIE: u8 = 1 << 7;

const SPM: u16 = 0x95e8;
const LPM: u16 = 0x95c8;
/// `lpm r0, Z` is `LPM`; both lie at the beginning of the boot section.
const AT_SPM: u16 = 0x3f00;
const AT_LPM: u16 = 0x3f01;
/// 4.5 ms at 16 MHz.
const WRITING: u64 = 72_000;

/// `nop` everywhere, but for a `spm` and a `lpm` in the boot section and at 0x40.
fn bench() -> Bench {
    let mut words = vec![0u16; 0x4000];
    for (at, word) in [(AT_SPM, SPM), (AT_LPM, LPM), (0x40, SPM), (0x41, LPM)] {
        words[usize::from(at)] = word;
    }
    let chip = Atmega328p::with_boot(&crate::common::image(&words), Boot { size: BootSize::Words256, start: true });
    Bench { chip: chip.expect("it fits"), seen: Seen::default() }
}

fn step_at(bench: &mut Bench, pc: u16) {
    bench.chip.set_pc(pc);
    bench.chip.step(&mut bench.seen);
}

/// `spm` with a command in SPMCSR, a byte address in Z and a word in R1:R0.
fn spm_at(bench: &mut Bench, pc: u16, command: u8, z: u16, word: u16) {
    for (register, value) in [(0, word.to_le_bytes()), (30, z.to_le_bytes())] {
        bench.chip.set_register(register, value[0]);
        bench.chip.set_register(register + 1, value[1]);
    }
    bench.set(SPMCSR, command);
    step_at(bench, pc);
}

fn spm(bench: &mut Bench, command: u8, z: u16, word: u16) {
    spm_at(bench, AT_SPM, command | SPMEN, z, word);
}

/// `lpm` with Z, after SPMCSR was written with `command` if it is not 0.
fn lpm(bench: &mut Bench, command: u8, z: u16) -> u8 {
    let [low, high] = z.to_le_bytes();
    bench.chip.set_register(30, low);
    bench.chip.set_register(31, high);
    if command != 0 {
        bench.set(SPMCSR, command | SPMEN);
    }
    step_at(bench, AT_LPM);
    bench.chip.register(0)
}

fn flash_word(bench: &Bench, at: u16) -> u16 {
    u16::from_le_bytes([bench.chip.flash_byte(2 * at), bench.chip.flash_byte(2 * at + 1)])
}

/// Waits in the boot section, whose instructions are `nop`s.
fn wait(bench: &mut Bench, cycles: u64) {
    bench.chip.set_pc(0x3f10);
    let until = bench.now() + cycles;
    while bench.now() < until {
        if bench.chip.pc() > 0x3ff0 {
            bench.chip.set_pc(0x3f10);
        }
        bench.chip.step(&mut bench.seen);
    }
}

#[test]
fn a_page_is_erased_then_written_from_the_buffer() {
    let mut bench = bench();
    let page = 0x1280; // Bytes: word 0x940.
    spm(&mut bench, PGERS, page + 6, 0);
    assert_eq!(bench.get(SPMCSR), RWWSB | PGERS | SPMEN, "it runs");
    let began = bench.now();
    wait(&mut bench, WRITING - 100);
    assert_eq!(bench.get(SPMCSR), RWWSB | PGERS | SPMEN);
    wait(&mut bench, 200);
    assert_eq!(bench.get(SPMCSR), RWWSB, "{} cycles later it is done", bench.now() - began);
    for at in 0x940..0x980 {
        assert_eq!(flash_word(&bench, at), 0xffff);
    }
    assert_eq!((flash_word(&bench, 0x93f), flash_word(&bench, 0x980)), (0, 0), "the pages beside are as they were");

    // Two words; the rest of the buffer is ones. A word cannot be loaded twice (§27.8.1).
    spm(&mut bench, 0, page + 4, 0x1234);
    assert_eq!(bench.get(SPMCSR), 0, "loading makes the section readable again");
    spm(&mut bench, 0, page + 127, 0xabcd);
    spm(&mut bench, 0, page + 4, 0x0000);
    spm(&mut bench, PGWRT, page, 0);
    wait(&mut bench, WRITING);
    let words: Vec<u16> = (0x940..0x980).map(|at| flash_word(&bench, at)).collect();
    assert_eq!((words[2], words[63]), (0x1234, 0xabcd));
    assert!(words.iter().enumerate().all(|(at, word)| at == 2 || at == 63 || *word == 0xffff), "{words:x?}");

    // The buffer is empty again, and flash that is not erased only loses bits.
    spm(&mut bench, 0, page + 4, 0xff0f);
    spm(&mut bench, PGWRT, page, 0);
    wait(&mut bench, WRITING);
    assert_eq!((flash_word(&bench, 0x942), flash_word(&bench, 0x97f)), (0x1204, 0xabcd));
}

#[test]
fn what_was_written_is_what_is_executed() {
    let mut bench = bench();
    spm(&mut bench, PGERS, 0x1280, 0);
    wait(&mut bench, WRITING);
    spm(&mut bench, 0, 0x1280, 0xe05a); // ldi r21, 10
    spm(&mut bench, PGWRT, 0x1280, 0);
    wait(&mut bench, WRITING);
    spm(&mut bench, RWWSRE, 0, 0);
    step_at(&mut bench, 0x940);
    assert_eq!(bench.chip.register(21), 10);
    // The first word of a page is the second one of a `jmp` in the page before.
    spm(&mut bench, PGERS, 0x1200, 0);
    wait(&mut bench, WRITING);
    spm(&mut bench, 0, 0x127e, 0x940c);
    spm(&mut bench, PGWRT, 0x1200, 0);
    wait(&mut bench, WRITING);
    spm(&mut bench, RWWSRE, 0, 0);
    step_at(&mut bench, 0x93f);
    assert_eq!(bench.chip.pc(), 0xe05a & 0x3fff);
    spm(&mut bench, PGERS, 0x1280, 0);
    wait(&mut bench, WRITING);
    spm(&mut bench, RWWSRE, 0, 0);
    step_at(&mut bench, 0x93f);
    assert_eq!(bench.chip.pc(), 0x3fff);
}

#[test]
fn nothing_happens_outside_the_boot_section_or_too_late_or_for_two_commands() {
    let mut bench = bench();
    spm_at(&mut bench, 0x40, PGERS | SPMEN, 0x1280, 0);
    assert_eq!((bench.chip.spm_count(), flash_word(&bench, 0x940)), (1, 0), "outside the boot section");
    spm(&mut bench, PGERS | PGWRT, 0x1280, 0);
    assert_eq!(flash_word(&bench, 0x940), 0, "two commands");
    for (nops, erased) in [(3, true), (4, false)] {
        let mut bench = bench.clone();
        bench.chip.set_register(30, 0x80);
        bench.chip.set_register(31, 0x12);
        bench.set(SPMCSR, PGERS | SPMEN);
        bench.chip.set_pc(0x3f10);
        bench.run(nops);
        step_at(&mut bench, AT_SPM);
        assert_eq!(flash_word(&bench, 0x940) == 0xffff, erased, "four cycles: {nops}");
    }
    bench.set(SPMCSR, PGERS | SPMEN);
    bench.run(5);
    assert_eq!(bench.get(SPMCSR), 0, "SPMEN does not stay");
}

#[test]
fn the_section_that_is_written_reads_as_ones_until_it_is_enabled() {
    let mut bench = bench();
    assert_eq!(lpm(&mut bench, 0, 0x80), 0xe8);
    spm(&mut bench, PGERS, 0x1280, 0);
    assert_eq!(lpm(&mut bench, 0, 0x80), 0xff);
    assert_eq!(lpm(&mut bench, 0, 2 * AT_SPM), 0xe8, "the other section can be read");
    let odd = bench.chip.odd().undefined;
    step_at(&mut bench, 0x20);
    assert_eq!(bench.chip.odd().undefined, odd + 1, "nothing can be executed there");
    // Not while it runs (§27.9.1).
    spm(&mut bench, RWWSRE, 0, 0);
    assert_ne!(bench.get(SPMCSR) & RWWSB, 0);
    wait(&mut bench, WRITING);
    assert_eq!(lpm(&mut bench, 0, 0x80), 0xff, "done, but not enabled");
    spm(&mut bench, RWWSRE, 0, 0);
    assert_eq!(bench.get(SPMCSR), 0);
    assert_eq!(lpm(&mut bench, 0, 0x80), 0xe8);
}

#[test]
fn the_processor_stands_still_while_its_own_section_is_written() {
    let mut bench = bench();
    let before = bench.now();
    spm(&mut bench, PGERS, 0x7000, 0);
    bench.chip.step(&mut bench.seen);
    assert!((before + WRITING..before + WRITING + 10).contains(&bench.now()), "{}", bench.now() - before);
    assert_eq!(bench.get(SPMCSR), 0);
    assert_eq!(flash_word(&bench, 0x3800), 0xffff);
}

#[test]
fn rwwsre_and_a_reset_and_the_eeprom_empty_the_buffer() {
    let full = bench();
    let empty: [fn(&mut Bench); 4] = [
        |bench| spm(bench, RWWSRE, 0, 0),
        |bench| bench.chip.reset(ResetCause::External, &mut ()),
        |bench| {
            bench.set(EECR, 4);
            bench.set(EECR, 2);
            wait(bench, 60_000);
        },
        |_| {},
    ];
    for (number, empty) in empty.into_iter().enumerate() {
        let mut bench = full.clone();
        spm(&mut bench, PGERS, 0, 0);
        wait(&mut bench, WRITING);
        spm(&mut bench, 0, 0, 0x1234);
        empty(&mut bench);
        spm(&mut bench, PGWRT, 0, 0);
        wait(&mut bench, WRITING);
        assert_eq!(flash_word(&bench, 0), if number == 3 { 0x1234 } else { 0xffff }, "{number}");
    }
}

#[test]
fn nothing_can_be_asked_while_the_eeprom_is_written() {
    let mut bench = bench();
    bench.set(EECR, 4);
    bench.set(EECR, 2);
    spm(&mut bench, PGERS, 0x1280, 0);
    assert_eq!((bench.get(SPMCSR), flash_word(&bench, 0x940)), (0, 0));
}

#[test]
fn its_interrupt_waits_as_long_as_nothing_is_written() {
    let mut bench = bench();
    bench.set(0x55, 1); // MCUCR: IVCE, then IVSEL: vectors in the boot section.
    bench.set(0x55, 2);
    spm(&mut bench, PGERS | SPMIE, 0x1280, 0);
    bench.set(SREG, 0x80);
    let began = bench.now();
    bench.chip.set_pc(0x3f80);
    while bench.chip.pc() != 0x3f00 + 50 && bench.now() < began + 2 * WRITING {
        if bench.chip.pc() > 0x3ff0 {
            bench.chip.set_pc(0x3f80);
        }
        bench.chip.step(&mut bench.seen);
    }
    let took = bench.now() - began;
    assert!((WRITING..WRITING + 10).contains(&took), "{took}: vector 25, at word 50");
}

/// §27.9.1: the interrupt asks as long as SPMEN is clear, so that it does not come between the request and its `spm`.
#[test]
fn its_interrupt_leaves_the_request_its_four_cycles() {
    let mut bench = bench();
    bench.set(0x55, 1); // MCUCR: IVCE, then IVSEL: vectors in the boot section.
    bench.set(0x55, 2);
    bench.chip.set_pc(0x3f80);
    bench.set(SPMCSR, PGERS | SPMEN | SPMIE);
    bench.set(SREG, 0x80);
    let mut nops = 0;
    while bench.chip.pc() != 0x3f00 + 50 && nops < 20 {
        bench.chip.step(&mut bench.seen);
        nops += 1;
    }
    assert!((4..8).contains(&nops), "{nops}: vector 25, at word 50");
    // With its `spm` at once the page is erased.
    let mut bench = bench_with_interrupts();
    spm(&mut bench, PGERS | SPMIE, 0x1280, 0);
    assert_eq!(flash_word(&bench, 0x940), 0xffff);
}

fn bench_with_interrupts() -> Bench {
    let mut bench = bench();
    bench.set(SREG, 0x80);
    bench
}

#[test]
fn locks_fuses_and_signature_are_read_by_lpm() {
    let mut bench = bench();
    bench.chip.set_locks(0xcf);
    assert_eq!([0, 1, 2, 3].map(|z| lpm(&mut bench, BLBSET, z)), [0xff, 0xcf, 0xfd, 0xde], "those of an Uno");
    assert_eq!([0, 2, 4].map(|z| lpm(&mut bench, SIGRD, z)), [0x1e, 0x95, 0x0f]);
    // Three cycles (§27.8.9).
    for (nops, value) in [(2, 0x0f), (3, 0x00)] {
        bench.chip.set_register(30, 4);
        bench.set(SPMCSR, SIGRD | SPMEN);
        bench.chip.set_pc(0x3f10);
        bench.run(nops);
        step_at(&mut bench, AT_LPM);
        assert_eq!(bench.chip.register(0), value, "{nops}");
    }
}

#[test]
fn lock_bits_keep_sections_apart() {
    let mut bench = bench();
    // An Uno's: the boot section cannot be written, nor read from the application.
    bench.chip.set_locks(0xcf);
    spm(&mut bench, PGERS, 0x7f00, 0);
    assert_eq!(flash_word(&bench, 0x3f80), 0);
    assert_eq!(lpm(&mut bench, 0, 2 * AT_SPM), 0xe8, "it can read itself");
    bench.chip.set_register(30, 0x00);
    bench.chip.set_register(31, 0x7e);
    step_at(&mut bench, 0x41);
    assert_eq!(bench.chip.register(0), 0xff);
    spm(&mut bench, PGERS, 0x1280, 0);
    assert_eq!(flash_word(&bench, 0x940), 0xffff, "the application can");
    wait(&mut bench, WRITING);
    // The program may lock more, but not less.
    spm(&mut bench, BLBSET, 1, 0x00f3);
    wait(&mut bench, WRITING);
    assert_eq!(bench.chip.locks(), 0xc3);
    spm(&mut bench, BLBSET, 1, 0x00ff);
    wait(&mut bench, WRITING);
    assert_eq!(bench.chip.locks(), 0xc3);
    spm(&mut bench, PGERS, 0x1300, 0);
    assert_eq!(flash_word(&bench, 0x980), 0, "now the application cannot be written");
    spm(&mut bench, RWWSRE, 0, 0);
    assert_eq!(lpm(&mut bench, 0, 0x80), 0xff, "nor read from here");
}
