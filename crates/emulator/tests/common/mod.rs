//! A chip whose flash is nothing but `nop`: registers are written by hand, in the cycle that is wanted.
#![allow(dead_code, reason = "each test uses its part")]

use pulsetrain_emulator::{Atmega328p, Observer, PinEdge, Port, UartByte};

/// What left the chip.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Seen {
    pub edges: Vec<PinEdge>,
    pub sent: Vec<UartByte>,
    pub divisions: Vec<(u64, u16)>,
    pub watchdog: Vec<u64>,
}

impl Observer for Seen {
    fn pin(&mut self, edge: PinEdge) {
        self.edges.push(edge);
    }

    fn transmit(&mut self, byte: UartByte) {
        self.sent.push(byte);
    }

    fn clock_division(&mut self, cycle: u64, division: u16) {
        self.divisions.push((cycle, division));
    }

    fn watchdog_reset(&mut self, cycle: u64) {
        self.watchdog.push(cycle);
    }
}

pub fn image(words: &[u16]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_le_bytes()).collect()
}

/// A chip and what it did.
#[derive(Clone)]
pub struct Bench {
    pub chip: Atmega328p,
    pub seen: Seen,
}

impl Bench {
    /// Words at the beginning of flash, `nop` after them.
    pub fn with(words: &[u16]) -> Bench {
        let mut flash = vec![0; Atmega328p::FLASH_BYTES];
        let image = image(words);
        flash[..image.len()].copy_from_slice(&image);
        Bench { chip: Atmega328p::new(&flash).expect("it fits"), seen: Seen::default() }
    }

    pub fn nops() -> Bench {
        Bench::with(&[])
    }

    pub fn now(&self) -> u64 {
        self.chip.cycle()
    }

    /// Runs some cycles further.
    pub fn run(&mut self, cycles: u64) {
        self.chip.run(self.chip.cycle() + cycles, &mut self.seen);
    }

    pub fn set(&mut self, address: u16, value: u8) {
        self.chip.write_data(address, value, &mut self.seen);
    }

    pub fn get(&mut self, address: u16) -> u8 {
        self.chip.read_data(address, &mut self.seen)
    }

    /// A 16-bit register of Timer1, written high byte first.
    pub fn set_wide(&mut self, low: u16, value: u16) {
        self.set(low + 1, value.to_be_bytes()[0]);
        self.set(low, value.to_be_bytes()[1]);
    }

    pub fn get_wide(&mut self, low: u16) -> u16 {
        let below = self.get(low);
        u16::from_le_bytes([below, self.get(low + 1)])
    }

    /// The edges of one pin since this was last asked: cycle and whether it rose.
    pub fn edges(&mut self, port: Port, bit: u8) -> Vec<(u64, bool)> {
        let edges = std::mem::take(&mut self.seen.edges);
        edges.iter().filter(|e| (e.port, e.bit) == (port, bit)).map(|e| (e.cycle, e.level.is_high())).collect()
    }
}

/// Data addresses (DS40002061B §31).
pub mod reg {
    pub const PINB: u16 = 0x23;
    pub const DDRB: u16 = 0x24;
    pub const PORTB: u16 = 0x25;
    pub const PIND: u16 = 0x29;
    pub const DDRD: u16 = 0x2a;
    pub const PORTD: u16 = 0x2b;
    pub const TIFR0: u16 = 0x35;
    pub const TIFR1: u16 = 0x36;
    pub const PCIFR: u16 = 0x3b;
    pub const EIFR: u16 = 0x3c;
    pub const EIMSK: u16 = 0x3d;
    pub const EECR: u16 = 0x3f;
    pub const EEDR: u16 = 0x40;
    pub const EEARL: u16 = 0x41;
    pub const GTCCR: u16 = 0x43;
    pub const TCCR0A: u16 = 0x44;
    pub const TCCR0B: u16 = 0x45;
    pub const TCNT0: u16 = 0x46;
    pub const OCR0A: u16 = 0x47;
    pub const OCR0B: u16 = 0x48;
    pub const SMCR: u16 = 0x53;
    pub const MCUSR: u16 = 0x54;
    pub const SREG: u16 = 0x5f;
    pub const WDTCSR: u16 = 0x60;
    pub const CLKPR: u16 = 0x61;
    pub const PRR: u16 = 0x64;
    pub const PCICR: u16 = 0x68;
    pub const EICRA: u16 = 0x69;
    pub const PCMSK2: u16 = 0x6d;
    pub const TIMSK0: u16 = 0x6e;
    pub const TIMSK1: u16 = 0x6f;
    pub const TCCR1A: u16 = 0x80;
    pub const TCCR1B: u16 = 0x81;
    pub const TCCR1C: u16 = 0x82;
    pub const TCNT1: u16 = 0x84;
    pub const ICR1: u16 = 0x86;
    pub const OCR1A: u16 = 0x88;
    pub const OCR1B: u16 = 0x8a;
    pub const TCCR2A: u16 = 0xb0;
    pub const TCCR2B: u16 = 0xb1;
    pub const TCNT2: u16 = 0xb2;
    pub const OCR2A: u16 = 0xb3;
    pub const UCSR0A: u16 = 0xc0;
    pub const UCSR0B: u16 = 0xc1;
    pub const UCSR0C: u16 = 0xc2;
    pub const UBRR0L: u16 = 0xc4;
    pub const UDR0: u16 = 0xc6;
}
