//! A chip whose flash is nothing but `nop`: registers are written by hand, in the cycle that is wanted.
#![allow(dead_code, reason = "each test uses its part")]

use pulsetrain_emulator::{Atmega328p, Observer, PinEdge, Port, UartByte};

/// What left the chip.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Seen {
    pub(crate) edges: Vec<PinEdge>,
    pub(crate) sent: Vec<UartByte>,
    pub(crate) divisions: Vec<(u64, u16)>,
    pub(crate) watchdog: Vec<u64>,
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

pub(crate) fn image(words: &[u16]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_le_bytes()).collect()
}

/// A chip and what it did.
#[derive(Clone)]
pub(crate) struct Bench {
    pub(crate) chip: Atmega328p,
    pub(crate) seen: Seen,
}

impl Bench {
    /// Words at the beginning of flash, `nop` after them.
    pub(crate) fn with(words: &[u16]) -> Bench {
        let mut flash = vec![0; Atmega328p::FLASH_BYTES];
        let image = image(words);
        flash[..image.len()].copy_from_slice(&image);
        Bench { chip: Atmega328p::new(&flash).expect("it fits"), seen: Seen::default() }
    }

    pub(crate) fn nops() -> Bench {
        Bench::with(&[])
    }

    pub(crate) fn now(&self) -> u64 {
        self.chip.cycle()
    }

    /// Runs some cycles further.
    pub(crate) fn run(&mut self, cycles: u64) {
        self.chip.run(self.chip.cycle() + cycles, &mut self.seen);
    }

    pub(crate) fn set(&mut self, address: u16, value: u8) {
        self.chip.write_data(address, value, &mut self.seen);
    }

    pub(crate) fn get(&mut self, address: u16) -> u8 {
        self.chip.read_data(address, &mut self.seen)
    }

    /// A 16-bit register of Timer1, written high byte first.
    pub(crate) fn set_wide(&mut self, low: u16, value: u16) {
        self.set(low + 1, value.to_be_bytes()[0]);
        self.set(low, value.to_be_bytes()[1]);
    }

    pub(crate) fn get_wide(&mut self, low: u16) -> u16 {
        let below = self.get(low);
        u16::from_le_bytes([below, self.get(low + 1)])
    }

    /// The edges of one pin since the last call: cycle, and whether it rose.
    pub(crate) fn edges(&mut self, port: Port, bit: u8) -> Vec<(u64, bool)> {
        let edges = std::mem::take(&mut self.seen.edges);
        edges.iter().filter(|e| (e.port, e.bit) == (port, bit)).map(|e| (e.cycle, e.level.is_high())).collect()
    }
}

/// Data addresses (DS40002061B §31).
pub(crate) mod reg {
    pub(crate) const PINB: u16 = 0x23;
    pub(crate) const DDRB: u16 = 0x24;
    pub(crate) const PORTB: u16 = 0x25;
    pub(crate) const PIND: u16 = 0x29;
    pub(crate) const DDRD: u16 = 0x2a;
    pub(crate) const PORTD: u16 = 0x2b;
    pub(crate) const TIFR0: u16 = 0x35;
    pub(crate) const TIFR1: u16 = 0x36;
    pub(crate) const PCIFR: u16 = 0x3b;
    pub(crate) const EIFR: u16 = 0x3c;
    pub(crate) const EIMSK: u16 = 0x3d;
    pub(crate) const EECR: u16 = 0x3f;
    pub(crate) const EEDR: u16 = 0x40;
    pub(crate) const EEARL: u16 = 0x41;
    pub(crate) const GTCCR: u16 = 0x43;
    pub(crate) const TCCR0A: u16 = 0x44;
    pub(crate) const TCCR0B: u16 = 0x45;
    pub(crate) const TCNT0: u16 = 0x46;
    pub(crate) const OCR0A: u16 = 0x47;
    pub(crate) const OCR0B: u16 = 0x48;
    pub(crate) const SMCR: u16 = 0x53;
    pub(crate) const MCUSR: u16 = 0x54;
    pub(crate) const SREG: u16 = 0x5f;
    pub(crate) const WDTCSR: u16 = 0x60;
    pub(crate) const CLKPR: u16 = 0x61;
    pub(crate) const PRR: u16 = 0x64;
    pub(crate) const PCICR: u16 = 0x68;
    pub(crate) const EICRA: u16 = 0x69;
    pub(crate) const PCMSK2: u16 = 0x6d;
    pub(crate) const TIMSK0: u16 = 0x6e;
    pub(crate) const TIMSK1: u16 = 0x6f;
    pub(crate) const TCCR1A: u16 = 0x80;
    pub(crate) const TCCR1B: u16 = 0x81;
    pub(crate) const TCCR1C: u16 = 0x82;
    pub(crate) const TCNT1: u16 = 0x84;
    pub(crate) const ICR1: u16 = 0x86;
    pub(crate) const OCR1A: u16 = 0x88;
    pub(crate) const OCR1B: u16 = 0x8a;
    pub(crate) const TCCR2A: u16 = 0xb0;
    pub(crate) const TCCR2B: u16 = 0xb1;
    pub(crate) const TCNT2: u16 = 0xb2;
    pub(crate) const OCR2A: u16 = 0xb3;
    pub(crate) const UCSR0A: u16 = 0xc0;
    pub(crate) const UCSR0B: u16 = 0xc1;
    pub(crate) const UCSR0C: u16 = 0xc2;
    pub(crate) const UBRR0L: u16 = 0xc4;
    pub(crate) const UDR0: u16 = 0xc6;
}
