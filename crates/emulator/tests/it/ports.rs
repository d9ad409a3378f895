//! Ports (DS40002061B §14).

use crate::common::{Bench, reg::*};
use pulsetrain_emulator::{Level, Port};

/// `out` changes the pin in the cycle after it, `sbi`, `cbi` and `sts` after their second.
#[test]
fn when_a_pin_changes() {
    // ldi r16, 1; out DDRB, r16; out PORTB, r16; sbi PINB, 0; cbi PORTB, 0; sts PORTB, r16
    let mut bench = Bench::with(&[0xe001, 0xb904, 0xb905, 0x9a18, 0x9a28, 0x9828, 0x9300, 0x0025]);
    bench.run(20);
    assert_eq!(bench.edges(Port::B, 0), [(3, true), (5, false), (7, true), (9, false), (11, true)]);
}

/// Figure 14-4: what was put out can be read after one `nop`.
#[test]
fn the_synchroniser() {
    // ldi r16, 0xff; out DDRB, r16; out PORTB, r16; in r17, PINB; in r18, PINB
    let mut bench = Bench::with(&[0xef0f, 0xb904, 0xb905, 0xb113, 0xb123]);
    bench.run(5);
    assert_eq!((bench.chip.register(17), bench.chip.register(18)), (0x00, 0xff));
}

/// §14.2.2: ones written to PINx toggle PORTx, of inputs too; `sbi` writes a single one.
#[test]
fn toggling() {
    let mut bench = Bench::with(&[0x9a18]);
    bench.set(DDRB, 0x0f);
    bench.set(PORTB, 0x05);
    bench.run(2);
    assert_eq!(bench.get(PORTB), 0x04);
    bench.set(PINB, 0xff);
    assert_eq!(bench.get(PORTB), 0xfb);
}

/// Pull-ups, the world, and DDR; edges are those that the chip causes.
#[test]
fn directions() {
    let mut bench = Bench::nops();
    bench.set(PORTB, 1);
    assert_eq!((bench.chip.pin(Port::B, 0), bench.edges(Port::B, 0)), (Level::High, vec![(0, true)]));
    bench.chip.set_input(Port::B, 0, Some(Level::Low));
    bench.run(2);
    assert_eq!((bench.get(PINB), bench.edges(Port::B, 0)), (0, vec![]));
    bench.set(DDRB, 1);
    assert_eq!(bench.edges(Port::B, 0), [(2, true)]);
    bench.run(1);
    bench.set(DDRB, 0);
    bench.chip.set_input(Port::B, 0, None);
    assert_eq!(bench.chip.pin(Port::B, 0), Level::High);
    bench.run(1);
    // PUD takes all pull-ups off.
    bench.set(0x55, 0x10);
    assert_eq!(bench.chip.pin(Port::B, 0), Level::Low);
}

/// One write, several edges, one cycle.
#[test]
fn edges_of_one_write() {
    let mut bench = Bench::nops();
    bench.set(DDRD, 0xfc);
    bench.run(3);
    bench.set(PORTD, 0xa4);
    let edges: Vec<_> = bench.seen.edges.iter().map(|e| (e.cycle, e.bit)).collect();
    assert_eq!(edges, [(3, 2), (3, 5), (3, 7)]);
    bench.set(PIND, 0x84);
    assert_eq!(bench.seen.edges.len(), 5);
}
