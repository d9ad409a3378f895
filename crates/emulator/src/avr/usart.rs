//! USART0 in asynchronous mode (DS40002061B §20). Synchronous and SPI modes are not emulated.
//!
//! Transmitter: a character that finds the transmitter idle passes the buffer at once; its start bit begins one cycle
//! after the write of UDR0 takes effect (the datasheet does not specify the alignment). Otherwise it follows directly
//! on the stop bit of the character before it.
//!
//! Receiver: it samples the line with its own clock, 16 or 8 times in a bit, and three samples vote on each bit
//! (§20.8). So a sender whose baud rate is off causes the errors that it would cause on a chip.

use crate::{LineByte, Observer, UartByte};
use std::collections::VecDeque;

// UCSR0A.
const RXC: u8 = 1 << 7;
const TXC: u8 = 1 << 6;
const UDRE: u8 = 1 << 5;
const FE: u8 = 1 << 4;
const DOR: u8 = 1 << 3;
const UPE: u8 = 1 << 2;
const U2X: u8 = 1 << 1;
const MPCM: u8 = 1;
// UCSR0B.
const RXEN: u8 = 1 << 4;
const TXEN: u8 = 1 << 3;
const UCSZ2: u8 = 1 << 2;
const RXB8: u8 = 1 << 1;
const TXB8: u8 = 1;

/// Pending interrupts, as bits of UCSR0B: RXCIE, TXCIE, UDRIE.
pub(super) const RECEIVED: u8 = 1 << 7;
pub(super) const TRANSMITTED: u8 = 1 << 6;
pub(super) const EMPTY: u8 = 1 << 5;

/// A received character: its data bits, and its error bits of UCSR0A.
#[derive(Clone, Copy, Default)]
struct Received {
    data: u16,
    errors: u8,
}

/// A character that is being sent.
#[derive(Clone, Copy)]
struct Sending {
    data: u16,
    start: u64,
    end: u64,
    bit: u32,
}

#[derive(Clone, Default)]
pub(super) struct Usart {
    /// The bits of UCSR0A that are stored: TXC, U2X, MPCM.
    a: u8,
    b: u8,
    c: u8,
    ubrr: u16,
    // Transmitter.
    buffer: Option<u16>,
    sending: Option<Sending>,
    // Receiver.
    line: VecDeque<LineByte>,
    fifo: VecDeque<Received>,
    /// A complete character in the shift register, which waits because the buffer is full.
    waiting: Option<Received>,
    overrun: bool,
    /// The cycle in which the receiver's sampling clock began.
    origin: u64,
    /// The receiver looks for a start bit from this cycle on.
    ready: u64,
    /// After a frame error the line must be high before a start bit can begin.
    needs_high: bool,
    /// The cycle of the first low sample of the present start bit.
    start: Option<u64>,
    /// Whether the vote on the start bit has confirmed it.
    confirmed: bool,
}

impl Usart {
    /// Resets the USART in `cycle`. Characters on the line to RXD go on.
    pub(super) fn reset(&mut self, cycle: u64) {
        let line = std::mem::take(&mut self.line);
        *self = Usart { c: 0x06, line, origin: cycle, ready: cycle, ..Usart::default() };
    }

    pub(super) fn receives(&self) -> bool {
        self.b & RXEN != 0
    }

    /// Whether the transmitter drives TXD: while it is enabled, and afterwards until it has sent its last character
    /// (§20.6.5).
    pub(super) fn transmits(&self) -> bool {
        self.b & TXEN != 0 || self.is_sending()
    }

    pub(super) fn is_sending(&self) -> bool {
        self.sending.is_some() || self.buffer.is_some()
    }

    /// The first cycle after the last character on the line to RXD.
    pub(super) fn line_end(&self) -> u64 {
        self.line.back().map_or(0, LineByte::end_cycle)
    }

    pub(super) fn receive(&mut self, byte: LineByte) {
        debug_assert!(self.line.back().is_none_or(|last| last.start_cycle <= byte.start_cycle), "in order");
        self.line.push_back(byte);
        if self.start.is_none() {
            self.find_start();
        }
    }

    /// The pending interrupts: [`RECEIVED`], [`TRANSMITTED`], [`EMPTY`].
    pub(super) fn pending(&self) -> u8 {
        self.status() & self.b & (RECEIVED | TRANSMITTED | EMPTY)
    }

    /// The transmit complete interrupt is entered, which clears its flag.
    pub(super) fn acknowledge_transmitted(&mut self) {
        self.a &= !TXC;
    }

    fn status(&self) -> u8 {
        let received = self.fifo.front().map_or(0, |first| RXC | first.errors);
        let empty = if self.buffer.is_none() { UDRE } else { 0 };
        self.a | received | empty | if self.overrun { DOR } else { 0 }
    }

    /// Cycles from one sample of the receiver to the next: a 16th of a bit, or an 8th with U2X.
    fn sample(&self) -> u64 {
        u64::from(self.ubrr) + 1
    }

    fn samples(&self) -> u64 {
        if self.a & U2X != 0 { 8 } else { 16 }
    }

    /// Data bits, 5 to 9 (table 20-11). Reserved values count as 8.
    fn data_bits(&self) -> u8 {
        match (self.b & UCSZ2 != 0, self.c >> 1 & 3) {
            (true, 3) => 9,
            (true, _) => 8,
            (false, size) => 5 + size,
        }
    }

    /// The parity mode. 0: none; 2: even; 3: odd.
    fn parity(&self) -> u8 {
        self.c >> 4 & 3
    }

    pub(super) fn read_a(&self) -> u8 {
        self.status()
    }

    pub(super) fn read_b(&self) -> u8 {
        let ninth = self.fifo.front().is_some_and(|first| first.data & 0x100 != 0);
        self.b & !RXB8 | if ninth { RXB8 } else { 0 }
    }

    pub(super) fn read_c(&self) -> u8 {
        self.c
    }

    pub(super) fn ubrr(&self) -> u16 {
        self.ubrr
    }

    /// Reads UDR0: takes the oldest character with its errors out of the buffer. A waiting character moves into the
    /// buffer.
    pub(super) fn read_data(&mut self) -> u8 {
        let first = self.fifo.pop_front();
        if let Some(waiting) = self.waiting.take() {
            self.fifo.push_back(waiting);
        }
        self.overrun = false;
        first.map_or(0, |first| first.data.to_le_bytes()[0])
    }

    pub(super) fn write_a(&mut self, value: u8) {
        if value & TXC != 0 {
            self.a &= !TXC;
        }
        self.a = self.a & !(U2X | MPCM) | value & (U2X | MPCM);
        self.find_start();
    }

    pub(super) fn write_b(&mut self, value: u8, cycle: u64) {
        let was = self.receives();
        self.b = value & !RXB8;
        if was && !self.receives() {
            // Disabling the receiver flushes its buffer at once (§20.7.6).
            self.fifo.clear();
            (self.waiting, self.overrun, self.start) = (None, false, None);
        }
        if !was && self.receives() {
            (self.ready, self.needs_high, self.start) = (cycle, false, None);
        }
        self.find_start();
    }

    pub(super) fn write_c(&mut self, value: u8) {
        self.c = value;
    }

    /// Writes UBRR0L, which restarts the baud rate generator at once (§20.11.5).
    pub(super) fn write_ubrr(&mut self, ubrr: u16, cycle: u64) {
        self.ubrr = ubrr & 0x0fff;
        self.origin = cycle;
        self.find_start();
    }

    pub(super) fn write_high(&mut self, value: u8) {
        self.ubrr = self.ubrr & 0xff | u16::from(value & 0x0f) << 8;
    }

    /// Writes UDR0. Without an empty buffer or an enabled transmitter the write has no effect (§20.6.1, §20.11.1).
    pub(super) fn write_data(&mut self, value: u8, cycle: u64) {
        if self.b & TXEN == 0 || self.buffer.is_some() {
            return;
        }
        let ninth = if self.data_bits() == 9 { u16::from(self.b & TXB8) << 8 } else { 0 };
        self.buffer = Some(u16::from(value) | ninth);
        if self.sending.is_none() {
            self.load(cycle + 1);
        }
    }

    /// Moves a character from the buffer into the shift register; its start bit begins in cycle `start`.
    fn load(&mut self, start: u64) {
        self.sending = self.buffer.take().map(|data| {
            let bits = self.data_bits();
            let frame = 2 + bits + u8::from(self.parity() >= 2) + (self.c >> 3 & 1);
            let bit = (self.sample() * self.samples()) as u32;
            let end = start + u64::from(bit) * u64::from(frame);
            Sending { data: data & ((1 << bits) - 1), start, end, bit }
        });
    }

    /// The cycle of the next event of transmitter or receiver.
    pub(super) fn next_event(&self) -> u64 {
        self.sending.map_or(u64::MAX, |sending| sending.end).min(self.receiver_event())
    }

    /// Handles the events that are due in `cycle`.
    pub(super) fn event(&mut self, cycle: u64, observer: &mut impl Observer) {
        if let Some(sending) = self.sending.filter(|sending| sending.end == cycle) {
            self.sending = None;
            if self.buffer.is_some() {
                self.load(cycle);
            } else {
                self.a |= TXC;
            }
            let Sending { data, start, end, bit } = sending;
            observer.transmit(UartByte { uart: 0, start_cycle: start, end_cycle: end, data, cycles_per_bit: bit });
        }
        if self.receiver_event() == cycle {
            self.receiver(cycle);
        }
    }

    /// The clock runs again after it stood still for some cycles.
    pub(super) fn delay(&mut self, cycles: u64) {
        if let Some(sending) = &mut self.sending {
            sending.start += cycles;
            sending.end += cycles;
        }
        // Part of what came meanwhile is lost, because nothing sampled the line: the receiver looks for a new start
        // bit.
        self.origin += cycles;
        self.ready += cycles;
        self.start = None;
        self.find_start();
    }

    // The receiver. The samples of a character count from 1, its first low sample (figures 20-5 to 20-7).

    /// The first of the three samples that vote on a bit.
    fn first_vote(&self) -> u64 {
        self.samples() / 2
    }

    /// The cycle of a sample of the present character.
    fn sample_cycle(&self, start: u64, number: u64) -> u64 {
        start + (number - 1) * self.sample()
    }

    /// Bits after the start bit: data, parity, the first stop bit.
    fn bits_to_come(&self) -> u8 {
        self.data_bits() + u8::from(self.parity() >= 2) + 1
    }

    fn receiver_event(&self) -> u64 {
        let Some(start) = self.start else { return u64::MAX };
        let bits = if self.confirmed { u64::from(self.bits_to_come()) } else { 0 };
        self.sample_cycle(start, bits * self.samples() + self.first_vote() + 2)
    }

    /// The result of the three samples in the middle of bit `index`; 0 is the start bit.
    fn vote(&self, start: u64, index: u8) -> bool {
        let first = u64::from(index) * self.samples() + self.first_vote();
        (0..3).filter(|sample| self.line_is_high(self.sample_cycle(start, first + sample))).count() >= 2
    }

    fn receiver(&mut self, cycle: u64) {
        let Some(start) = self.start else { return };
        if !self.confirmed {
            if self.vote(start, 0) {
                // The low sample was noise: the receiver looks for the next start bit (§20.8.1).
                (self.start, self.ready, self.needs_high) = (None, cycle + 1, false);
                self.find_start();
            } else {
                self.confirmed = true;
                if self.waiting.take().is_some() {
                    // The waiting character in the shift register is overwritten (§20.7.4).
                    self.overrun = true;
                }
            }
            return;
        }
        let (bits, parity) = (self.data_bits(), self.parity());
        // All bits after the start bit, lowest first; the stop bit is the highest.
        let all = self.aligned(start).unwrap_or_else(|| {
            (0..self.bits_to_come()).fold(0, |all, bit| all | u16::from(self.vote(start, bit + 1)) << bit)
        });
        let data = all & ((1 << bits) - 1);
        let mut errors = 0;
        if parity >= 2 {
            let odd = (data.count_ones() + u32::from(all >> bits & 1)) % 2;
            errors |= if odd == u32::from(parity == 3) { 0 } else { UPE };
        }
        let stop = all >> (self.bits_to_come() - 1) & 1 != 0;
        errors |= if stop { 0 } else { FE };
        (self.start, self.ready, self.needs_high) = (None, cycle + 1, !stop);
        let received = Received { data, errors };
        // In multi-processor mode the receiver drops characters that are no addresses (§20.9).
        let address = if bits == 9 { data & 0x100 != 0 } else { stop };
        if self.a & MPCM == 0 || address {
            if self.fifo.len() < 2 {
                self.fifo.push_back(received);
            } else {
                self.waiting = Some(received);
            }
        }
        while self.line.front().is_some_and(|first| first.end_cycle() < cycle) {
            self.line.pop_front();
        }
        self.find_start();
    }

    /// A short cut for the votes on all bits: the bits of one character, if every sample of bit n lies within the
    /// sender's bit n. Samples and bits are both evenly spaced, so that checking the first and the last bit is enough.
    fn aligned(&self, start: u64) -> Option<u16> {
        let byte = self.line.iter().rfind(|byte| byte.start_cycle <= start)?;
        let (bit_time, last) = (u64::from(byte.bit_time_256), self.bits_to_come());
        if byte.bits + 1 != last {
            return None;
        }
        let inside = |bit: u8, sample: u64| {
            let number = u64::from(bit) * self.samples() + self.first_vote() + sample;
            let at = (self.sample_cycle(start, number) - byte.start_cycle) * 256;
            (u64::from(bit) * bit_time..u64::from(bit + 1) * bit_time).contains(&at)
        };
        let all = inside(0, 0) && inside(0, 2) && inside(last, 0) && inside(last, 2);
        all.then_some(byte.data & ((1 << byte.bits) - 1) | 1 << byte.bits)
    }

    fn line_is_high(&self, cycle: u64) -> bool {
        self.line.iter().take_while(|byte| byte.start_cycle <= cycle).all(|byte| {
            let bit = (cycle - byte.start_cycle) * 256 / u64::from(byte.bit_time_256.max(1));
            bit > u64::from(byte.bits) || bit > 0 && byte.data >> (bit - 1) & 1 != 0
        })
    }

    /// The first sample at or after a cycle.
    fn sample_from(&self, cycle: u64) -> u64 {
        self.origin + cycle.saturating_sub(self.origin).div_ceil(self.sample()) * self.sample()
    }

    /// Looks for the next start bit among the characters on the line.
    fn find_start(&mut self) {
        if self.start.is_some() && self.confirmed {
            return;
        }
        (self.start, self.confirmed) = (None, false);
        if !self.receives() {
            return;
        }
        let mut from = self.sample_from(self.ready);
        while self.needs_high && !self.line_is_high(from) {
            from += self.sample();
        }
        for byte in &self.line {
            let bit_time = u64::from(byte.bit_time_256.max(1));
            for bit in 0..=u64::from(byte.bits) {
                if bit > 0 && byte.data >> (bit - 1) & 1 != 0 {
                    continue;
                }
                let end = byte.start_cycle * 256 + (bit + 1) * bit_time;
                let begin = (byte.start_cycle * 256 + bit * bit_time).div_ceil(256);
                let sample = self.sample_from(begin.max(from));
                if sample * 256 < end {
                    self.start = Some(sample);
                    return;
                }
            }
        }
    }
}
