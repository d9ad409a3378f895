//! Timer/Counters, each against its section of the datasheet DS40002061B. A register written by hand takes effect in
//! the present cycle; what reads in a cycle sees the counter as it is in that cycle.

use crate::common::{Bench, reg::*};
use proptest::prelude::*;
use pulsetrain_emulator::{Level, Port};

const OC1A: (Port, u8) = (Port::B, 1);
const OC0A: (Port, u8) = (Port::D, 6);
const TOV: u8 = 1;
const OCFA: u8 = 2;
const OCFB: u8 = 4;
const ICF: u8 = 32;

/// Pins of every compare output are outputs.
fn bench() -> Bench {
    let mut bench = Bench::nops();
    bench.set(DDRB, 0xff);
    bench.set(DDRD, 0xff);
    bench.run(100);
    bench
}

/// §16.10, figure 16-10: the flag one timer clock after the match, the pin with it.
#[test]
fn a_match_shows_one_clock_later() {
    let mut bench = bench();
    bench.set_wide(OCR1A, 10);
    bench.set(TCCR1A, 0x40);
    bench.set(TCCR1B, 1);
    let start = bench.now();
    bench.run(10);
    assert_eq!((bench.get_wide(TCNT1), bench.get(TIFR1) & OCFA), (10, 0));
    bench.run(1);
    assert_eq!((bench.get_wide(TCNT1), bench.get(TIFR1) & OCFA), (11, OCFA));
    assert_eq!(bench.edges(OC1A.0, OC1A.1), [(start + 11, true)]);
}

/// §16.9.1: the counter passes 0xffff with TOV1 and goes on.
#[test]
fn a_compare_value_behind_the_counter_waits_a_whole_turn() {
    for tccr1a in [0x40, 0x80, 0xc0] {
        let mut bench = bench();
        bench.set(TCCR1A, tccr1a);
        bench.set(TCCR1B, 1);
        bench.run(1000);
        bench.set_wide(OCR1A, 999);
        bench.set(TIFR1, 0xff);
        bench.run(65_535);
        assert_eq!(bench.get(TIFR1) & OCFA, 0);
        bench.run(1);
        assert_eq!(bench.get(TIFR1), OCFA | OCFB | TOV);
    }
}

/// §16.9.2: in CTC mode too: the chip runs on to 0xffff, and only then finds its TOP.
#[test]
fn ctc_with_top_below_the_counter_runs_on_to_max() {
    let mut bench = bench();
    bench.set_wide(OCR1A, 2000);
    bench.set(TCCR1B, 0x09);
    bench.run(1000);
    bench.set_wide(OCR1A, 500);
    bench.run(65_535 - 1000);
    assert_eq!((bench.get_wide(TCNT1), bench.get(TIFR1) & (OCFA | TOV)), (65_535, 0));
    bench.run(1);
    assert_eq!((bench.get_wide(TCNT1), bench.get(TIFR1) & (OCFA | TOV)), (0, TOV));
    bench.run(501);
    assert_eq!((bench.get_wide(TCNT1), bench.get(TIFR1) & OCFA), (0, OCFA));
}

/// §16.9.2: the period is OCR1A + 1.
#[test]
fn ctc_periods() {
    let mut bench = bench();
    bench.set_wide(OCR1A, 99);
    bench.set(TCCR1A, 0x40);
    bench.set(TCCR1B, 0x09);
    let start = bench.now();
    bench.run(350);
    assert_eq!(bench.edges(OC1A.0, OC1A.1), [(start + 100, true), (start + 200, false), (start + 300, true)]);
    assert_eq!(bench.get(TIFR1) & TOV, 0);
}

/// §16.7.2: a write of TCNT1 blocks a match in the next timer clock, even if the timer was stopped when it was written.
#[test]
fn writing_the_counter_blocks_one_match() {
    let mut bench = bench();
    bench.set_wide(OCR1A, 500);
    bench.set_wide(TCNT1, 500);
    bench.set(TCCR1B, 1);
    bench.run(10);
    assert_eq!((bench.get_wide(TCNT1), bench.get(TIFR1) & OCFA), (510, 0));
    bench.set_wide(TCNT1, 499);
    bench.run(2);
    assert_eq!(bench.get(TIFR1) & OCFA, OCFA);
}

/// A counter written while it is stopped keeps the value.
#[test]
fn a_stopped_counter_can_be_written() {
    let mut bench = bench();
    bench.set_wide(TCNT1, 0x1234);
    bench.run(1000);
    assert_eq!(bench.get_wide(TCNT1), 0x1234);
    bench.set(TCCR1B, 1);
    bench.run(4);
    assert_eq!(bench.get_wide(TCNT1), 0x1238);
}

/// §16.11.9: a one clears its own flag alone.
#[test]
fn flags_are_cleared_one_by_one() {
    let mut bench = bench();
    bench.set_wide(OCR1A, 10);
    bench.set_wide(OCR1B, 20);
    bench.set(TCCR1B, 1);
    bench.run(65_600);
    assert_eq!(bench.get(TIFR1), OCFA | OCFB | TOV);
    bench.set(TIFR1, OCFA);
    assert_eq!(bench.get(TIFR1), OCFB | TOV);
    bench.set(TIFR1, 0);
    assert_eq!(bench.get(TIFR1), OCFB | TOV);
    bench.set(TIFR1, TOV);
    assert_eq!(bench.get(TIFR1), OCFB);
}

/// §16.11.3: FOC1A moves the pin as COM1A says; no flag, no clearing; nothing in PWM modes; reads 0.
#[test]
fn forced_compare() {
    let mut bench = bench();
    bench.set_wide(OCR1A, 1000);
    bench.set(TCCR1A, 0x40);
    bench.set(TCCR1B, 0x09);
    bench.run(50);
    let now = bench.now();
    bench.set(TCCR1C, 0x80);
    assert_eq!(bench.edges(OC1A.0, OC1A.1), [(now, true)]);
    assert_eq!((bench.get(TIFR1) & OCFA, bench.get_wide(TCNT1), bench.get(TCCR1C)), (0, 50, 0));
    bench.set(TCCR1A, 0x80);
    bench.set(TCCR1C, 0x40);
    assert_eq!(bench.edges(OC1A.0, OC1A.1), []);
    bench.set(TCCR1C, 0x80);
    assert_eq!(bench.edges(OC1A.0, OC1A.1), [(now, false)]);
    // Fast PWM, inverting: a strobe would raise it.
    bench.set(TCCR1A, 0xc1);
    bench.set(TCCR1C, 0x80);
    assert_eq!(bench.edges(OC1A.0, OC1A.1), []);
}

/// §16.8: COM takes the pin from PORT, and gives it back; DDR still decides whether it drives.
#[test]
fn compare_outputs_override_the_port() {
    let mut bench = Bench::nops();
    bench.set(TCCR1A, 0xc0);
    bench.set(TCCR1C, 0x80);
    assert_eq!(bench.chip.pin(Port::B, 1), Level::Low, "an input");
    bench.run(5);
    bench.set(DDRB, 2);
    assert_eq!(bench.edges(OC1A.0, OC1A.1), [(5, true)]);
    bench.set(PORTB, 0);
    assert_eq!(bench.edges(OC1A.0, OC1A.1), [], "writing PORTB does not move the pin");
    bench.run(1);
    bench.set(TCCR1A, 0);
    assert_eq!(bench.edges(OC1A.0, OC1A.1), [(6, false)], "PORTB again");
    bench.set(TCCR1A, 0x40);
    assert_eq!(bench.chip.pin(Port::B, 1), Level::High, "OC1A kept its state");
}

/// §16.3: TEMP is one byte for all 16-bit registers.
#[test]
fn temp_is_shared() {
    let mut bench = bench();
    bench.set_wide(TCNT1, 0x1234);
    bench.set(OCR1A + 1, 0xab);
    assert_eq!(bench.get(TCNT1), 0x34);
    bench.set(OCR1A, 0xcd);
    assert_eq!(bench.get_wide(OCR1A), 0x12cd, "reading TCNT1L replaced TEMP");
    assert_eq!(bench.get(TCNT1 + 1), 0x12);
    // A read of OCR1A leaves TEMP alone.
    bench.set(OCR1B + 1, 0x77);
    bench.get_wide(OCR1A);
    bench.set(OCR1B, 0x11);
    assert_eq!(bench.get_wide(OCR1B), 0x7711);
    // The high byte read is of the moment of the low one.
    bench.set_wide(TCNT1, 0x00ff);
    bench.set(TCCR1B, 1);
    assert_eq!(bench.get(TCNT1), 0xff);
    bench.run(3);
    assert_eq!(bench.get(TCNT1 + 1), 0x00);
    assert_eq!(bench.get_wide(TCNT1), 0x0102);
}

/// §15.7.3: fast PWM of 256 clocks, high from BOTTOM to the match; OCR0A takes effect at BOTTOM.
#[test]
fn fast_pwm() {
    let mut bench = bench();
    bench.set(OCR0A, 9);
    bench.set(TCCR0A, 0x83);
    bench.set(TCCR0B, 1);
    let start = bench.now();
    bench.run(256 + 100);
    assert_eq!(bench.edges(OC0A.0, OC0A.1), [(start + 256, true), (start + 266, false)]);
    // Written now, used from the next BOTTOM.
    bench.set(OCR0A, 199);
    assert_eq!(bench.get(OCR0A), 199, "the buffer is read");
    bench.run(256);
    assert_eq!(bench.edges(OC0A.0, OC0A.1), [(start + 512, true)]);
    bench.run(256);
    assert_eq!(bench.edges(OC0A.0, OC0A.1), [(start + 712, false), (start + 768, true)]);
    // OCR0A = TOP: always high; = 0: a spike of one clock.
    bench.set(OCR0A, 255);
    bench.run(256);
    bench.edges(OC0A.0, OC0A.1);
    bench.run(1000);
    assert_eq!(bench.edges(OC0A.0, OC0A.1), []);
    bench.set(OCR0A, 0);
    bench.run(512);
    let edges = bench.edges(OC0A.0, OC0A.1);
    assert_eq!(
        edges.iter().map(|e| ((e.0 - start) % 256, e.1)).collect::<Vec<_>>(),
        [(1, false), (0, true), (1, false)]
    );
}

/// Table 15-3, mode 7 with COM0A = 1: half the frequency of the period; table 15-6: OC0B does not toggle.
#[test]
fn fast_pwm_toggles_with_ocra_as_top() {
    let mut bench = bench();
    bench.set(TCCR0A, 0x53);
    bench.set(OCR0A, 49);
    bench.set(OCR0B, 20);
    bench.set(TCCR0B, 0x09);
    bench.run(256);
    bench.seen.edges.clear();
    bench.run(200);
    let periods: Vec<_> = bench.seen.edges.windows(2).map(|pair| pair[1].cycle - pair[0].cycle).collect();
    assert_eq!(periods, [50, 50, 50]);
    assert!(bench.seen.edges.iter().all(|edge| (edge.port, edge.bit) == OC0A));
}

/// §15.7.4: 510 clocks, symmetric about BOTTOM; TOV0 at BOTTOM; OCR0A takes effect at TOP.
#[test]
fn phase_correct_pwm() {
    let mut bench = bench();
    bench.set(OCR0A, 100);
    bench.set(TCCR0A, 0x81);
    bench.set(TCCR0B, 1);
    let start = bench.now();
    bench.run(10);
    bench.set(TIFR0, TOV);
    bench.run(245);
    assert_eq!(bench.get(TCNT0), 255);
    bench.run(1);
    assert_eq!(bench.get(TCNT0), 254);
    bench.run(254);
    assert_eq!((bench.get(TCNT0), bench.get(TIFR0) & TOV), (0, 0));
    bench.run(1);
    assert_eq!((bench.get(TCNT0), bench.get(TIFR0) & TOV), (1, TOV));
    bench.run(1020);
    let edges: Vec<_> = bench.edges(OC0A.0, OC0A.1).into_iter().map(|(cycle, up)| (cycle - start, up)).collect();
    // OCR0A = 100 comes from its buffer at the first TOP.
    assert_eq!(edges, [(411, true), (611, false), (921, true), (1121, false), (1431, true)]);
}

/// §15.7.4: OCRnA at TOP holds the pin at one level, and OCRnA at BOTTOM at the opposite one, even if nothing reads the
/// counter on its way there.
#[test]
fn phase_correct_pwm_at_its_extremes() {
    for (compare, com, edge) in [(18, 0x80, true), (0, 0x80, false), (18, 0xc0, false), (0, 0xc0, true)] {
        let mut bench = bench();
        // Mode 5: TOP is OCR0A; or mode 1 with OCR0A at BOTTOM.
        let wgm = if compare == 0 { 1 } else { 5 };
        bench.set(OCR0A, compare);
        bench.set(TCNT0, 5);
        bench.set(TCCR0A, com | wgm & 3);
        bench.set(TCCR0B, wgm << 1 & 8 | 1);
        let start = bench.now();
        bench.run(2000);
        // The first match decides: at TOP in mode 5; in mode 1 what a match on the way up leaves, at TOP, and no more.
        let first = if compare == 0 { start + 256 - 5 } else { start + 19 - 5 };
        let expected: &[_] = if edge { &[(first, true)] } else { &[] };
        assert_eq!(bench.edges(OC0A.0, OC0A.1), expected, "OCR0A = {compare}, COM0A = {com:#x}");
    }
}

/// §15.7.4 is about compare values that leave TOP: OCRnA as TOP stays TOP, whatever its value.
#[test]
fn a_new_top_in_ocra_leaves_the_pin_alone() {
    let mut bench = bench();
    bench.set(OCR0A, 30);
    bench.set(TCNT0, 5);
    bench.set(TCCR0A, 0x81);
    bench.set(TCCR0B, 0x09);
    let start = bench.now();
    bench.run(40);
    bench.set(OCR0A, 10);
    bench.run(200);
    assert_eq!(bench.edges(OC0A.0, OC0A.1), [(start + 31 - 5, true)]);
}

/// A timer clock's edge looks at what is then: a TOP that was moved away from the counter in time is none.
#[test]
fn top_is_what_it_is_at_the_edge() {
    let mut bench = bench();
    // Mode 10: phase correct, TOP is ICR1; clk/8.
    bench.set(TCCR1A, 0x02);
    bench.set(TCCR1B, 0x10);
    bench.set_wide(ICR1, 4);
    bench.set(GTCCR, 1);
    bench.set(TCCR1B, 0x12);
    bench.run(4 * 8 + 4);
    assert_eq!(bench.get_wide(TCNT1), 4);
    bench.set_wide(ICR1, 100);
    bench.run(8);
    assert_eq!(bench.get_wide(TCNT1), 5);
}

/// §16.9.5: phase and frequency correct: OCR1A takes effect at BOTTOM, the period is 2·TOP.
#[test]
fn phase_and_frequency_correct_pwm() {
    let mut bench = bench();
    bench.set(TCCR1A, 0x80);
    bench.set(TCCR1B, 0x10);
    bench.set_wide(ICR1, 100);
    bench.set_wide(OCR1A, 30);
    bench.set(TCCR1B, 0x11);
    let start = bench.now();
    bench.run(350);
    bench.set_wide(OCR1A, 60);
    bench.run(350);
    let edges: Vec<_> = bench.edges(OC1A.0, OC1A.1).into_iter().map(|(cycle, up)| (cycle - start, up)).collect();
    // At 0 the buffer's 30; high about each BOTTOM; 60 from the BOTTOM at 400 on.
    assert_eq!(edges, [(171, true), (231, false), (371, true), (461, false), (541, true), (661, false)]);
    assert_eq!(bench.get(TIFR1) & (ICF | TOV), ICF | TOV);
}

/// §17: Timer0 and Timer1 share a prescaler; PSRSYNC resets it for both; TSM holds it.
#[test]
fn the_prescaler_is_shared() {
    let mut bench = Bench::nops();
    bench.run(61);
    bench.set(TCCR0B, 3);
    bench.set(TCCR1B, 2);
    bench.run(2);
    assert_eq!((bench.get(TCNT0), bench.get_wide(TCNT1)), (0, 0));
    bench.run(1);
    assert_eq!((bench.get(TCNT0), bench.get_wide(TCNT1)), (1, 1), "cycle 64: the prescaler counts from reset");
    bench.run(5);
    bench.set(GTCCR, 1);
    bench.run(7);
    assert_eq!(bench.get_wide(TCNT1), 1);
    bench.run(1);
    assert_eq!(bench.get_wide(TCNT1), 2);
    bench.set(GTCCR, 0x81);
    bench.run(1000);
    assert_eq!((bench.get_wide(TCNT1), bench.get(GTCCR)), (2, 0x81));
    bench.set(GTCCR, 0);
    bench.run(8);
    assert_eq!((bench.get_wide(TCNT1), bench.get(TCNT0), bench.get(GTCCR)), (3, 1, 0));
}

/// §16.6: ICP1 captures the counter behind its synchroniser; the canceller adds four cycles and ignores what is shorter.
#[test]
fn input_capture() {
    let mut bench = Bench::nops();
    bench.set(TCCR1B, 0x41);
    bench.run(100);
    bench.chip.set_input(Port::B, 0, Some(Level::High));
    bench.run(50);
    assert_eq!((bench.get_wide(ICR1), bench.get(TIFR1) & ICF), (103, ICF));
    bench.chip.set_input(Port::B, 0, Some(Level::Low));
    bench.run(50);
    assert_eq!(bench.get_wide(ICR1), 103, "ICES1 asks for rising edges");
    bench.set(TCCR1B, 0x81);
    bench.chip.set_input(Port::B, 0, Some(Level::High));
    bench.run(10);
    bench.chip.set_input(Port::B, 0, Some(Level::Low));
    bench.run(2);
    bench.chip.set_input(Port::B, 0, Some(Level::High));
    bench.run(10);
    assert_eq!(bench.get_wide(ICR1), 103, "shorter than four samples");
    bench.chip.set_input(Port::B, 0, Some(Level::Low));
    bench.run(10);
    assert_eq!(bench.get_wide(ICR1), 222 + 7);
    bench.set_wide(ICR1, 5);
    assert_eq!(bench.get_wide(ICR1), 229, "ICR1 is written in modes with it as TOP alone");
}

/// §17.3: clocked by T1, behind its edge detector.
#[test]
fn external_clock() {
    let mut bench = Bench::nops();
    bench.set(TCCR1B, 7);
    for _ in 0..5 {
        bench.chip.set_input(Port::D, 5, Some(Level::High));
        bench.run(10);
        bench.chip.set_input(Port::D, 5, Some(Level::Low));
        bench.run(10);
    }
    assert_eq!(bench.get_wide(TCNT1), 5);
    bench.set(TCCR1B, 6);
    bench.chip.set_input(Port::D, 5, Some(Level::High));
    bench.run(10);
    bench.chip.set_input(Port::D, 5, Some(Level::Low));
    bench.run(2);
    assert_eq!(bench.get_wide(TCNT1), 5);
    bench.run(1);
    assert_eq!(bench.get_wide(TCNT1), 6);
}

/// §10.11.3: a timer without its clock stands still and cannot be written; afterwards it goes on.
#[test]
fn power_reduction_stops_a_timer() {
    let mut bench = Bench::nops();
    bench.set(TCCR1B, 1);
    bench.run(100);
    bench.set(PRR, 0x08);
    bench.run(1000);
    bench.set_wide(TCNT1, 7);
    assert_eq!(bench.get_wide(TCNT1), 100);
    bench.set(PRR, 0);
    bench.run(5);
    assert_eq!(bench.get_wide(TCNT1), 105);
}

proptest! {
    /// A timer that is looked at in every cycle is the one that is not looked at: edges, counter and flags.
    #[test]
    fn looking_changes_nothing(
        a in any::<u8>(), b in 0u8..32, clock in 0u8..4, ocra in 0u16..300, ocrb in 0u16..300, icr in 0u16..300,
        mask in 0u8..8, writes in prop::collection::vec((1u64..400, 0u16..320), 0..6),
    ) {
        let mut bench = bench();
        // ICR1 can be written in a mode that has it as TOP.
        bench.set(TCCR1B, 0x18);
        bench.set_wide(ICR1, icr);
        bench.set_wide(OCR1A, ocra);
        bench.set_wide(OCR1B, ocrb);
        bench.set(TCCR1A, a);
        bench.set(TCCR1B, (b & 0x18) | clock);
        let mut looked = bench.clone();
        // Interrupts are enabled in the timer, so that events are scheduled; I stays 0.
        bench.set(TIMSK1, mask);
        for (cycles, value) in writes.into_iter().chain([(3000, 0)]) {
            bench.run(cycles);
            for _ in 0..cycles {
                looked.run(1);
                looked.get_wide(TCNT1);
            }
            prop_assert_eq!(bench.get_wide(TCNT1), looked.get_wide(TCNT1));
            prop_assert_eq!(bench.get(TIFR1), looked.get(TIFR1));
            prop_assert_eq!(&bench.seen, &looked.seen);
            for bench in [&mut bench, &mut looked] {
                bench.set_wide(if value % 2 == 0 { OCR1A } else { TCNT1 }, value);
            }
        }
    }
}
