//! Whole programs on the chip.

use pulsetrain_emulator::{Atmega328p, LineByte, Observer, PinEdge, UartByte, hex};

#[derive(Default)]
struct Seen {
    edges: Vec<(u64, u8, bool)>,
    sent: Vec<UartByte>,
}

impl Observer for Seen {
    fn pin(&mut self, edge: PinEdge) {
        self.edges.push((edge.cycle, edge.bit, edge.level.is_high()));
    }
    fn transmit(&mut self, byte: UartByte) {
        self.sent.push(byte);
    }
}

fn image(words: &[u16]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_le_bytes()).collect()
}

#[test]
fn oc1a_toggles_one_clock_after_the_match() {
    // sbi DDRB,1; ldi r16,100; sts OCR1AL,r16; ldi 0x40; sts TCCR1A; ldi 1; sts TCCR1B; rjmp .
    let program = image(&[0x9a21, 0xe604, 0x9300, 0x0088, 0xe400, 0x9300, 0x0080, 0xe001, 0x9300, 0x0081, 0xcfff]);
    let mut chip = Atmega328p::new(&program).unwrap();
    let mut seen = Seen::default();
    chip.run(190_000, &mut seen);
    // 2 + 1 + 2 + 1 + 2 + 1 + 2 = 11: TCCR1B is there in cycle 11, in which the counter is 0.
    assert_eq!(seen.edges, [(11 + 101, 1, true), (11 + 101 + 65_536, 1, false), (11 + 101 + 2 * 65_536, 1, true)]);
}

#[test]
fn the_usart_echoes() {
    // U2X, UBRR 1 (1 Mbaud); echo by polling.
    let program = image(&[
        0xe002, 0x9300, 0x00c0, // UCSR0A = U2X
        0xe001, 0x9300, 0x00c4, // UBRR0L = 1
        0xe108, 0x9300, 0x00c1, // UCSR0B = RXEN | TXEN
        0x9100, 0x00c0, 0xff07, 0xcffc, // wait for RXC
        0x9100, 0x00c6, 0x9300, 0x00c6, 0xcff7,
    ]);
    let mut chip = Atmega328p::new(&program).unwrap();
    let mut seen = Seen::default();
    for n in 0..3 {
        chip.receive(LineByte::new(1000 + n * 160, b'a' + n as u8, 16 * 256));
    }
    chip.run(3000, &mut seen);
    let sent: Vec<_> = seen.sent.iter().map(|byte| (byte.byte(), byte.end_cycle - byte.start_cycle)).collect();
    assert_eq!(sent, [(b'a', 160), (b'b', 160), (b'c', 160)]);
}

/// The program that the speed is measured on: interrupts of Timer1 that toggle pin 2 for 12 cycles, and an echo.
#[test]
fn the_busy_program() {
    let image = hex::parse(include_str!("../../benches/busy.hex"), Atmega328p::FLASH_BYTES).unwrap();
    let mut chip = Atmega328p::new(&image).unwrap();
    let mut seen = Seen::default();
    // The receiver is on from cycle 20 or so.
    let text: Vec<u8> = (0..=255).collect();
    for (at, &byte) in (100u64..).step_by(160).zip(&text) {
        chip.receive(LineByte::new(at, byte, 16 * 256));
    }
    chip.run(1_600_000, &mut seen);
    let echoed: Vec<_> = seen.sent.iter().map(UartByte::byte).collect();
    assert_eq!(echoed, text);
    assert!(seen.edges.windows(2).all(|pair| pair[0].0 <= pair[1].0), "edges in order");
    // The first match at 0 + 1, then one every 400 cycles, but for the first: OCR1A begins at 0.
    let rises: Vec<_> = seen.edges.iter().filter(|edge| edge.1 == 2 && edge.2).map(|edge| edge.0).collect();
    assert!((3995..=4000).contains(&rises.len()), "{}", rises.len());
    // Lateness is the latency of the interrupt: at most the longest instruction and the echo's 19 or so cycles.
    let phase = rises[1] % 400;
    for rise in &rises[1..] {
        assert!((rise + 440 - phase) % 400 < 80, "{rise}");
    }
    assert_eq!((chip.odd().undefined, chip.odd().outside), (0, 0));
    assert!(chip.longest_masked().cycles < 200 && chip.lowest_sp() > 0x8e0);
}
