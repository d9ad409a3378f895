//! The UART of the programming port, and its peripheral DMA controller (Atmel-11057C §34, §26).
//!
//! What the datasheet leaves open: a character that comes while another waits to be read takes its place; the DMA moves a
//! byte in the cycle in which it can.
//!
//! Not emulated: the echo and loop-back modes but for the local one.

use crate::serial::level_of;
use crate::{LineByte, Observer, UartByte};
use std::collections::VecDeque;

const NEVER: u64 = u64::MAX;

/// Offsets of the registers (§34, §26).
mod at {
    pub(super) const CR: u32 = 0x00;
    pub(super) const MR: u32 = 0x04;
    pub(super) const IER: u32 = 0x08;
    pub(super) const IDR: u32 = 0x0c;
    pub(super) const IMR: u32 = 0x10;
    pub(super) const SR: u32 = 0x14;
    pub(super) const RHR: u32 = 0x18;
    pub(super) const THR: u32 = 0x1c;
    pub(super) const BRGR: u32 = 0x20;
    pub(super) const RPR: u32 = 0x100;
    pub(super) const TPR: u32 = 0x108;
    pub(super) const RNPR: u32 = 0x110;
    pub(super) const TNPR: u32 = 0x118;
    pub(super) const PTCR: u32 = 0x120;
    pub(super) const PTSR: u32 = 0x124;
}

/// UART_CR.
mod cr {
    pub(super) const RESET_RECEIVER: u32 = 1 << 2;
    pub(super) const RESET_TRANSMITTER: u32 = 1 << 3;
    pub(super) const RECEIVER_ON: u32 = 1 << 4;
    pub(super) const RECEIVER_OFF: u32 = 1 << 5;
    pub(super) const TRANSMITTER_ON: u32 = 1 << 6;
    pub(super) const TRANSMITTER_OFF: u32 = 1 << 7;
    pub(super) const RESET_STATUS: u32 = 1 << 8;
}

/// UART_SR.
mod sr {
    pub(super) const RECEIVED: u32 = 1;
    pub(super) const MAY_SEND: u32 = 1 << 1;
    pub(super) const RECEIVE_ENDED: u32 = 1 << 3;
    pub(super) const TRANSMIT_ENDED: u32 = 1 << 4;
    pub(super) const OVERRUN: u32 = 1 << 5;
    pub(super) const FRAMING: u32 = 1 << 6;
    pub(super) const PARITY: u32 = 1 << 7;
    pub(super) const SENT: u32 = 1 << 9;
    pub(super) const TRANSMIT_EMPTY: u32 = 1 << 11;
    pub(super) const RECEIVE_FULL: u32 = 1 << 12;
    pub(super) const ALL: u32 = 0x1afb;
}

/// UART_MR: no parity; the local loop-back.
const NO_PARITY: u32 = 4 << 9;
const MODE: u32 = 3 << 14;
const LOCAL_LOOP: u32 = 2 << 14;
/// UART_PTCR.
const RECEIVE_ON: u32 = 1;
const RECEIVE_OFF: u32 = 1 << 1;
const TRANSMIT_ON: u32 = 1 << 8;
const TRANSMIT_OFF: u32 = 1 << 9;

/// One direction of the DMA: where, how many, and what follows.
#[derive(Clone, Copy, Debug)]
struct Pdc {
    pointer: u32,
    count: u32,
    next_pointer: u32,
    next_count: u32,
    enabled: bool,
    /// The count has reached 0 since it was last written (ENDRX, ENDTX).
    ended: bool,
}

impl Pdc {
    fn new() -> Pdc {
        Pdc { pointer: 0, count: 0, next_pointer: 0, next_count: 0, enabled: false, ended: true }
    }

    fn is_ready(&self) -> bool {
        self.enabled && self.count != 0
    }

    /// Moves on by a byte. Returns the address of that byte.
    fn advance(&mut self) -> u32 {
        let address = self.pointer;
        self.pointer = self.pointer.wrapping_add(1);
        self.count -= 1;
        if self.count == 0 {
            self.ended = true;
            if self.next_count != 0 {
                (self.pointer, self.count) = (self.next_pointer, self.next_count);
                self.next_count = 0;
            }
        }
        address
    }

    fn is_over(&self) -> bool {
        self.count == 0 && self.next_count == 0
    }
}

/// A character that is being sent: times in 1/256 cycle.
#[derive(Clone, Copy, Debug)]
struct Sending {
    start_cycle: u64,
    end_256: u64,
    data: u8,
}

#[derive(Clone)]
pub(super) struct Uart {
    mode: u32,
    mask: u32,
    divisor: u32,
    receiver_on: bool,
    transmitter_on: bool,
    errors: u32,
    received: Option<u8>,
    last_received: u8,
    holding: Option<u8>,
    sending: Option<Sending>,
    receive: Pdc,
    transmit: Pdc,
    /// Whether it has its clock, and its pins.
    clocked: bool,
    connected: [bool; 2],
    line: VecDeque<LineByte>,
    /// The cycle in which the character on the line is complete.
    sampled_at: u64,
    /// From when on a start bit is seen.
    ready_256: u64,
    /// The cycle of the next event.
    pub(super) next: u64,
}

impl Uart {
    pub(super) fn new() -> Uart {
        Uart {
            mode: 0,
            mask: 0,
            divisor: 0,
            receiver_on: false,
            transmitter_on: false,
            errors: 0,
            received: None,
            last_received: 0,
            holding: None,
            sending: None,
            receive: Pdc::new(),
            transmit: Pdc::new(),
            clocked: false,
            connected: [false; 2],
            line: VecDeque::new(),
            sampled_at: NEVER,
            ready_256: 0,
            next: NEVER,
        }
    }

    /// Resets it. The characters on the line come nevertheless.
    pub(super) fn reset(&mut self, cycle: u64) {
        let line = std::mem::take(&mut self.line);
        *self = Uart { line, ready_256: cycle << 8, ..Uart::new() };
    }

    /// Sets whether it has its clock, and its transmitter and its receiver their pins.
    pub(super) fn connect(&mut self, clocked: bool, connected: [bool; 2], cycle: u64) {
        if (clocked, connected) != (self.clocked, self.connected) {
            (self.clocked, self.connected) = (clocked, connected);
            self.go_on(cycle);
        }
    }

    /// Length of a bit, 1/256 cycle: 16 CD cycles, without a fraction (§34).
    fn bit_256(&self) -> u64 {
        u64::from(self.divisor) * 16 * 256
    }

    fn has_parity(&self) -> bool {
        self.mode & NO_PARITY == 0
    }

    fn is_on(&self, enabled: bool) -> bool {
        enabled && self.clocked && self.divisor != 0
    }

    fn go_on(&mut self, cycle: u64) {
        self.begin(cycle << 8);
        self.listen();
        self.schedule();
    }

    fn schedule(&mut self) {
        let sent_at = self.sending.map_or(NEVER, |sending| sending.end_256.div_ceil(256));
        self.next = sent_at.min(self.sampled_at);
    }

    /// Start bit, eight data bits, parity.
    fn frame_bits(&self) -> u64 {
        9 + u64::from(self.has_parity())
    }

    // The transmitter.

    fn begin(&mut self, from_256: u64) {
        if self.sending.is_some() || !self.is_on(self.transmitter_on) {
            return;
        }
        let Some(data) = self.holding.take() else { return };
        let end_256 = from_256 + (self.frame_bits() + 1) * self.bit_256();
        self.sending = Some(Sending { start_cycle: from_256.div_ceil(256), end_256, data });
    }

    /// Whether it still sends, or has a character to send.
    pub(super) fn is_sending(&self) -> bool {
        self.sending.is_some() || self.holding.is_some() || self.transmit.is_ready()
    }

    // The receiver.

    pub(super) fn receive(&mut self, byte: LineByte) {
        self.line.push_back(byte);
        self.listen();
        self.schedule();
    }

    pub(super) fn line_end(&self) -> u64 {
        self.line.back().map_or(0, LineByte::end_cycle)
    }

    /// Finds the next start bit. The character is complete in the middle of its stop bit.
    fn listen(&mut self) {
        if self.sampled_at != NEVER {
            return;
        }
        let is_on = self.is_on(self.receiver_on) && self.connected[1] && self.mode & MODE != LOCAL_LOOP;
        while let Some(byte) = self.line.front() {
            let start_256 = byte.start_cycle << 8;
            if is_on && start_256 + u64::from(byte.bit_time_256) > self.ready_256 {
                let bit = self.bit_256();
                self.sampled_at = (start_256.max(self.ready_256) + self.frame_bits() * bit + bit / 2) >> 8;
                return;
            }
            if !is_on && self.ready_256 < start_256 {
                // The receiver may be enabled before the start bit comes.
                return;
            }
            self.line.pop_front();
        }
    }

    fn sample(&mut self) {
        let Some(byte) = self.line.front() else { return };
        let (start, bit) = ((byte.start_cycle << 8).max(self.ready_256), self.bit_256());
        let level = |number: u64| level_of(&self.line, start + number * bit + bit / 2);
        let data = (0..8).fold(0u8, |data, number| data | u8::from(level(number + 1)) << number);
        let mut errors = 0;
        if self.has_parity() {
            let odd = data.count_ones() & 1 != 0;
            let expected = match self.mode >> 9 & 3 {
                0 => odd,
                1 => !odd,
                kind => kind == 3,
            };
            errors |= if level(9) == expected { 0 } else { sr::PARITY };
        }
        errors |= if level(self.frame_bits()) { 0 } else { sr::FRAMING };
        let stop = start + self.frame_bits() * bit + bit / 2;
        self.ready_256 = stop;
        self.sampled_at = NEVER;
        self.line.pop_front();
        // Everything before the middle of the stop bit was part of this character.
        while self.line.front().is_some_and(|byte| (byte.start_cycle << 8) + u64::from(byte.bit_time_256) <= stop) {
            self.line.pop_front();
        }
        self.errors |= errors;
        self.store(data);
        self.listen();
    }

    fn store(&mut self, data: u8) {
        if self.received.is_some() {
            self.errors |= sr::OVERRUN;
        }
        (self.received, self.last_received) = (Some(data), data);
    }

    /// Handles the events that are due in a cycle.
    pub(super) fn run(&mut self, cycle: u64, observer: &mut impl Observer) {
        if let Some(sending) = self.sending
            && sending.end_256.div_ceil(256) <= cycle
        {
            self.sending = None;
            if self.mode & MODE == LOCAL_LOOP {
                self.store(sending.data);
            } else if self.connected[0] {
                observer.transmit(UartByte {
                    uart: 0,
                    start_cycle: sending.start_cycle,
                    end_cycle: cycle,
                    data: sending.data.into(),
                    cycles_per_bit: u32::try_from(self.bit_256() >> 8).unwrap_or(u32::MAX),
                });
            }
            self.begin(sending.end_256);
        }
        if self.sampled_at <= cycle {
            self.sample();
        }
        self.schedule();
    }

    // The DMA, whose memory is the system's.

    /// The address from which the DMA reads a byte now, for [`put`](Uart::put).
    pub(super) fn fetches(&mut self) -> Option<u32> {
        (self.holding.is_none() && self.transmit.is_ready()).then(|| self.transmit.advance())
    }

    /// A byte that is to be sent.
    pub(super) fn put(&mut self, data: u8, cycle: u64) {
        self.holding = Some(data);
        self.go_on(cycle);
    }

    /// The address to which the DMA writes a byte now, and that byte.
    pub(super) fn stores(&mut self) -> Option<(u32, u8)> {
        if !self.receive.is_ready() {
            return None;
        }
        let data = self.received.take()?;
        Some((self.receive.advance(), data))
    }

    // Registers.

    fn status(&self) -> u32 {
        let when = |condition, bit| if condition { bit } else { 0 };
        let may_send = self.transmitter_on && self.holding.is_none();
        self.errors
            | when(self.received.is_some(), sr::RECEIVED)
            | when(may_send, sr::MAY_SEND)
            | when(may_send && self.sending.is_none(), sr::SENT)
            | when(self.receive.ended, sr::RECEIVE_ENDED)
            | when(self.transmit.ended, sr::TRANSMIT_ENDED)
            | when(self.receive.is_over(), sr::RECEIVE_FULL)
            | when(self.transmit.is_over(), sr::TRANSMIT_EMPTY)
    }

    pub(super) fn line_asserted(&self) -> bool {
        self.mask != 0 && self.status() & self.mask != 0
    }

    pub(super) fn read(&mut self, offset: u32) -> u32 {
        match offset {
            at::MR => self.mode,
            at::IMR => self.mask,
            at::SR => self.status(),
            at::RHR => {
                self.received = None;
                self.last_received.into()
            }
            at::BRGR => self.divisor,
            at::RPR..at::PTCR => *self.pdc_register(offset),
            at::PTSR => u32::from(self.receive.enabled) | u32::from(self.transmit.enabled) << 8,
            _ => 0,
        }
    }

    /// Pointers and counts: receive, transmit, next receive, next transmit, 8 bytes each.
    fn pdc_register(&mut self, offset: u32) -> &mut u32 {
        let is_transmit = offset & 8 != 0;
        let pdc = if is_transmit { &mut self.transmit } else { &mut self.receive };
        match (offset & 0x10 != 0, offset & 4 != 0) {
            (false, false) => &mut pdc.pointer,
            (false, true) => &mut pdc.count,
            (true, false) => &mut pdc.next_pointer,
            (true, true) => &mut pdc.next_count,
        }
    }

    pub(super) fn write(&mut self, offset: u32, value: u32, cycle: u64) {
        match offset {
            at::CR => self.control(value, cycle),
            at::MR => self.mode = value & 0xce00,
            at::IER => self.mask |= value & sr::ALL,
            at::IDR => self.mask &= !value,
            at::THR if self.transmitter_on => self.holding = Some(value as u8),
            at::BRGR => self.divisor = value & 0xffff,
            at::RPR..at::PTCR => {
                *self.pdc_register(offset) = if offset & 4 != 0 { value & 0xffff } else { value };
                if offset & 4 != 0 && value & 0xffff != 0 {
                    let pdc = if offset & 8 != 0 { &mut self.transmit } else { &mut self.receive };
                    pdc.ended = false;
                    if pdc.count == 0 && pdc.next_count != 0 {
                        (pdc.pointer, pdc.count, pdc.next_count) = (pdc.next_pointer, pdc.next_count, 0);
                    }
                }
            }
            at::PTCR => {
                for (pdc, on, off) in
                    [(&mut self.receive, RECEIVE_ON, RECEIVE_OFF), (&mut self.transmit, TRANSMIT_ON, TRANSMIT_OFF)]
                {
                    pdc.enabled = (pdc.enabled || value & on != 0) && value & off == 0;
                }
            }
            _ => {}
        }
        self.go_on(cycle + 1);
    }

    fn control(&mut self, value: u32, cycle: u64) {
        if value & cr::RESET_RECEIVER != 0 {
            (self.receiver_on, self.received, self.sampled_at) = (false, None, NEVER);
        }
        if value & cr::RESET_TRANSMITTER != 0 {
            (self.transmitter_on, self.holding, self.sending) = (false, None, None);
        }
        if value & cr::RECEIVER_OFF != 0 {
            self.receiver_on = false;
        } else if value & cr::RECEIVER_ON != 0 {
            self.receiver_on = true;
            self.ready_256 = self.ready_256.max((cycle + 1) << 8);
        }
        if value & cr::TRANSMITTER_OFF != 0 {
            self.transmitter_on = false;
        } else if value & cr::TRANSMITTER_ON != 0 {
            self.transmitter_on = true;
        }
        if value & cr::RESET_STATUS != 0 {
            self.errors = 0;
        }
    }
}

const _: () = assert!(at::TPR == at::RPR + 8 && at::RNPR == at::RPR + 16 && at::TNPR == at::RPR + 24);
