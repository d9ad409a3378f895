//! USART0 (DS40002061B §20).

use crate::common::{Bench, reg::*};
use proptest::prelude::*;
use pulsetrain_emulator::{Level, LineByte, Port};

const RXC: u8 = 0x80;
const TXC: u8 = 0x40;
const UDRE: u8 = 0x20;
const FE: u8 = 0x10;
const DOR: u8 = 0x08;
const UPE: u8 = 0x04;

/// Both directions on, 8N1; U2X or not.
fn bench(ubrr: u8, double: bool) -> Bench {
    let mut bench = Bench::nops();
    bench.set(UCSR0A, if double { 2 } else { 0 });
    bench.set(UBRR0L, ubrr);
    bench.set(UCSR0B, 0x18);
    bench
}

/// Characters back to back, from some cycles on.
fn send(bench: &mut Bench, after: u64, bit_time_256: u32, bytes: &[u8]) {
    let mut start = bench.now() + after;
    for &byte in bytes {
        let byte = LineByte::new(start, byte, bit_time_256);
        bench.chip.receive(byte);
        start = byte.end_cycle();
    }
}

/// Reads what is there: status before, data.
fn take(bench: &mut Bench) -> Vec<(u8, u8)> {
    let mut taken = Vec::new();
    loop {
        let status = bench.get(UCSR0A);
        if status & RXC == 0 {
            return taken;
        }
        taken.push((status & (FE | DOR | UPE), bench.get(UDR0)));
    }
}

/// §20.6: 10 bits of 8·(UBRR + 1) or 16·(UBRR + 1) cycles, without a gap; UDRE when the buffer is free, TXC at the end.
#[test]
fn transmitter() {
    for (ubrr, double, bit) in [(1, true, 16), (16, true, 136), (8, false, 144), (0, true, 8)] {
        let mut bench = bench(ubrr, double);
        bench.run(100);
        bench.set(UDR0, 0x55);
        assert_eq!(bench.get(UCSR0A) & (UDRE | TXC), UDRE, "the shift register was free");
        bench.set(UDR0, 0xaa);
        assert_eq!(bench.get(UCSR0A) & UDRE, 0);
        bench.set(UDR0, 0x11);
        bench.run(10 * bit);
        assert_eq!((bench.get(UCSR0A) & (UDRE | TXC), bench.seen.sent.len()), (0, 0));
        bench.run(1);
        assert_eq!((bench.get(UCSR0A) & (UDRE | TXC), bench.seen.sent.len()), (UDRE, 1));
        bench.run(10 * bit);
        assert_eq!(bench.get(UCSR0A) & (UDRE | TXC), UDRE | TXC);
        let sent: Vec<_> = bench.seen.sent.iter().map(|b| (b.start_cycle, b.end_cycle, b.byte())).collect();
        // What was written into a full buffer is lost.
        assert_eq!(sent, [(101, 101 + 10 * bit, 0x55), (101 + 10 * bit, 101 + 20 * bit, 0xaa)]);
        assert!(bench.seen.sent.iter().all(|byte| u64::from(byte.cycles_per_bit) == bit));
        bench.set(UCSR0A, TXC | if double { 2 } else { 0 });
        assert_eq!(bench.get(UCSR0A) & TXC, 0);
    }
}

/// Tables 20-9 to 20-11: data bits, parity and stop bits make the frame's length.
#[test]
fn frames() {
    for (ucsr0c, ucsr0b, bits) in
        [(0x06, 0x18, 10), (0x0e, 0x18, 11), (0x26, 0x18, 11), (0x00, 0x18, 7), (0x06, 0x1c, 11)]
    {
        let mut bench = bench(1, true);
        bench.set(UCSR0C, ucsr0c);
        bench.set(UCSR0B, ucsr0b | 1);
        bench.set(UDR0, 0xff);
        bench.run(1000);
        let sent = bench.seen.sent[0];
        assert_eq!(sent.end_cycle - sent.start_cycle, 16 * bits);
        assert_eq!(
            sent.data,
            if ucsr0b & 4 != 0 {
                0x1ff
            } else if ucsr0c == 0 {
                0x1f
            } else {
                0xff
            }
        );
    }
}

/// §20.6.5: a transmitter that is switched off finishes what it has.
#[test]
fn switching_the_transmitter_off() {
    let mut bench = bench(1, true);
    bench.set(UDR0, 1);
    bench.set(UDR0, 2);
    bench.set(UCSR0B, 0);
    bench.set(UDR0, 3);
    bench.run(40);
    assert!(bench.chip.is_transmitting());
    assert_eq!(bench.chip.pin(Port::D, 1), Level::High);
    bench.run(1000);
    assert_eq!(bench.seen.sent.len(), 2);
    assert!(!bench.chip.is_output(Port::D, 1));
}

/// §20.8: RXC at the third vote of the stop bit.
#[test]
fn when_a_character_is_there() {
    for (ubrr, double, bit, last) in [(1, true, 16, 6), (8, false, 144, 10)] {
        let mut bench = bench(ubrr, double);
        bench.run(1000);
        bench.chip.receive(LineByte::new(1008, 0x42, bit * 256));
        let sample = u64::from(ubrr) + 1;
        // The first sample at or after the start bit's beginning, and 9 bits and some samples on.
        let first = 1008u64.div_ceil(sample) * sample;
        let there = first + 9 * u64::from(bit) + (last - 1) * sample;
        bench.run(there - 1 - 1000);
        assert_eq!(bench.get(UCSR0A) & RXC, 0);
        bench.run(1);
        assert_eq!(take(&mut bench), [(0, 0x42)]);
    }
}

/// §20.7.4: two characters and a shift register; the next start bit overwrites the latter, and DOR tells.
#[test]
fn overrun() {
    let mut bench = bench(1, true);
    send(&mut bench, 0, 16 * 256, b"abc");
    bench.run(1000);
    assert_eq!(take(&mut bench), [(0, b'a'), (0, b'b'), (0, b'c')], "the third waited");
    send(&mut bench, 0, 16 * 256, b"abcde");
    bench.run(1000);
    assert_eq!(take(&mut bench), [(DOR, b'a'), (0, b'b'), (0, b'e')]);
    // In time: nothing is lost.
    send(&mut bench, 0, 16 * 256, b"abcdefgh");
    let mut all = Vec::new();
    for _ in 0..5 {
        bench.run(300);
        all.extend(take(&mut bench));
    }
    assert_eq!(all, b"abcdefgh".map(|byte| (0, byte)));
}

/// A sender of another speed: up to a few percent are tolerated (table 20-2), half or double the speed is garbage or
/// framing errors.
#[test]
fn wrong_speeds() {
    let text = b"Pulsetrain 0123456789 \x00\xff\x55\xaa";
    let run = |bit_time_256| {
        let mut bench = bench(16, true);
        send(&mut bench, 500, bit_time_256, text);
        let mut taken = Vec::new();
        for _ in 0..3 * text.len() {
            bench.run(700);
            taken.extend(take(&mut bench));
        }
        taken
    };
    let clean: Vec<_> = text.iter().map(|&byte| (0, byte)).collect();
    let exact = 136 * 256;
    // 115 200 baud from a PC: 2.1 % slower than the chip's 117 647.
    // A faster one loses a part of a sample with each character that follows another without a gap: with 8 samples a
    // bit, the next start bit is looked for from sample 79 on, so that 80/78 is the limit.
    for bit in [exact, exact * 1021 / 1000, exact * 1030 / 1000, exact * 980 / 1000] {
        assert_eq!(run(bit), clean, "{bit}");
    }
    for bit in [exact * 2, exact / 2, exact * 107 / 100, exact * 93 / 100] {
        let taken = run(bit);
        assert_ne!(taken, clean, "{bit}");
        assert!(taken.iter().any(|(status, _)| status & FE != 0), "{bit}: {taken:?}");
    }
}

/// §20.8.1: a start bit shorter than the votes is noise.
#[test]
fn a_spike_is_no_start_bit() {
    let mut bench = bench(16, true);
    bench.chip.receive(LineByte { start_cycle: 500, data: 0x3ff, bits: 9, bit_time_256: 40 * 256 });
    bench.run(1500);
    send(&mut bench, 100, 136 * 256, b"x");
    bench.run(2000);
    assert_eq!(take(&mut bench), [(0, b'x')]);
}

/// §20.4, §20.7.5: parity.
#[test]
fn parity() {
    for (ucsr0c, parity_bit, error) in [(0x26, 1u16, 0), (0x26, 0, UPE), (0x36, 0, 0), (0x36, 1, UPE)] {
        let mut bench = bench(1, true);
        bench.set(UCSR0C, ucsr0c);
        // Three ones: the even parity bit is 1.
        let data = 0x07 | parity_bit << 8;
        bench.chip.receive(LineByte { start_cycle: 100, data, bits: 9, bit_time_256: 16 * 256 });
        bench.run(1000);
        assert_eq!(take(&mut bench), [(error, 7)], "{ucsr0c:#x} {parity_bit}");
    }
}

/// §20.7.6: switched off, the receiver drops what it has; what comes meanwhile is not received.
#[test]
fn switching_the_receiver_off() {
    let mut bench = bench(1, true);
    send(&mut bench, 0, 16 * 256, b"ab");
    bench.run(400);
    bench.set(UCSR0B, 0x08);
    send(&mut bench, 0, 16 * 256, b"c");
    bench.run(400);
    bench.set(UCSR0B, 0x18);
    assert_eq!(take(&mut bench), []);
    send(&mut bench, 0, 16 * 256, b"d");
    bench.run(400);
    assert_eq!(take(&mut bench), [(0, b'd')]);
}

/// Interrupts: RXC and UDRE by level, TXC cleared on entry.
#[test]
fn interrupts() {
    let mut words = vec![0u16; 0x80];
    for vector in 1..26 {
        words[2 * vector] = 0x9518;
    }
    let mut bench = Bench::with(&words);
    bench.chip.set_pc(0x40);
    bench.set(UCSR0A, 2);
    bench.set(UBRR0L, 1);
    bench.set(UCSR0B, 0x58);
    bench.set(SREG, 0x80);
    bench.set(UDR0, 1);
    bench.run(160);
    assert_eq!(bench.get(UCSR0A) & TXC, 0);
    bench.run(2);
    assert_eq!((bench.chip.pc(), bench.get(UCSR0A) & TXC), (40, 0), "TXC is cleared by its interrupt");
    bench.set(UCSR0B, 0x98);
    send(&mut bench, 0, 16 * 256, b"a");
    let mut entries = 0;
    for _ in 0..300 {
        bench.chip.step(&mut bench.seen);
        entries += u32::from(bench.chip.pc() == 36);
    }
    assert!(entries > 10, "as long as the character is not read: {entries}");
    assert_eq!(take(&mut bench), [(0, b'a')]);
}

proptest! {
    /// What one chip sends another receives, at any baud rate, with clocks that differ by 2 %.
    #[test]
    fn round_trip(ubrr in 0u8..40, double in any::<bool>(), bytes in prop::collection::vec(any::<u8>(), 1..8),
                  permille in 980u32..1020, gap in 0u64..500) {
        let mut sender = bench(ubrr, double);
        let mut receiver = sender.clone();
        let mut taken = Vec::new();
        for &byte in &bytes {
            sender.run(gap);
            sender.set(UDR0, byte);
            while sender.chip.is_transmitting() {
                sender.run(50);
            }
        }
        let mut start = receiver.now() + 100;
        for sent in &sender.seen.sent {
            let bit = sent.cycles_per_bit * 256 * permille / 1000;
            start += 3 + gap;
            let byte = LineByte::new(start, sent.byte(), bit);
            receiver.chip.receive(byte);
            start = byte.end_cycle();
        }
        for _ in 0..bytes.len() * 12 + 20 {
            receiver.run(u64::from(sender.seen.sent[0].cycles_per_bit) + gap);
            taken.extend(take(&mut receiver));
        }
        let expected: Vec<_> = bytes.iter().map(|&byte| (0, byte)).collect();
        prop_assert_eq!(taken, expected);
    }
}
