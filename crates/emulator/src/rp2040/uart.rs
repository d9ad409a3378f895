//! A UART: the PL011 of the RP2040 (datasheet §4.2; ARM DDI 0183).
//!
//! The lines carry characters here, not edges. The start bit of a character begins in the cycle after it was written,
//! if the transmitter is idle (on the chip it waits for the next period of the baud rate divider). Characters follow
//! one another without a gap, exact to 1/256 cycle.

use crate::serial::level_of;
use crate::{LineByte, Observer, UartByte};
use std::collections::VecDeque;

const NEVER: u64 = u64::MAX;

// UARTLCR_H.
const PEN: u32 = 1 << 1;
const EPS: u32 = 1 << 2;
const STP2: u32 = 1 << 3;
const FEN: u32 = 1 << 4;
// UARTCR.
const UARTEN: u32 = 1;
const LBE: u32 = 1 << 7;
const TXE: u32 = 1 << 8;
const RXE: u32 = 1 << 9;
// UARTDR, from bit 8.
const FE: u16 = 1 << 8;
const PE: u16 = 1 << 9;
const OE: u16 = 1 << 11;
// UARTRIS.
const RXRIS: u32 = 1 << 4;
const TXRIS: u32 = 1 << 5;
const RTRIS: u32 = 1 << 6;
const FERIS: u32 = 1 << 7;
const PERIS: u32 = 1 << 8;
const OERIS: u32 = 1 << 10;

#[derive(Clone, Copy)]
struct Sending {
    start_cycle: u64,
    end_256: u64,
    data: u8,
}

#[derive(Clone)]
pub(super) struct Uart {
    number: u8,
    ibrd: u32,
    fbrd: u32,
    lcr_h: u32,
    cr: u32,
    ifls: u32,
    imsc: u32,
    ris: u32,
    dmacr: u32,
    /// The sticky errors of UARTRSR.
    rsr: u32,
    /// Length of a bit, 1/256 cycle; 0 while the clock is off.
    bit_256: u64,
    /// Frequencies of clk_peri and clk_sys, Hz.
    clocks: (u64, u64),
    sending: Option<Sending>,
    tx: VecDeque<u8>,
    rx: VecDeque<u16>,
    overrun: bool,
    /// The characters on the line to the receiver; then the one that is being received, with the time of its last
    /// sample.
    line: VecDeque<LineByte>,
    sampled_at: u64,
    /// The receiver looks for a start bit from this time on, 1/256 cycle.
    ready_256: u64,
    timeout_at: u64,
    /// Whether a pin is connected to the transmitter, and one to the receiver.
    connected: [bool; 2],
    pub(super) next: u64,
}

impl Uart {
    pub(super) fn new(number: u8) -> Uart {
        Uart {
            number,
            ibrd: 0,
            fbrd: 0,
            lcr_h: 0,
            cr: TXE | RXE,
            ifls: 0x12,
            imsc: 0,
            ris: 0,
            dmacr: 0,
            rsr: 0,
            bit_256: 0,
            clocks: (0, 1),
            sending: None,
            tx: VecDeque::new(),
            rx: VecDeque::new(),
            overrun: false,
            line: VecDeque::new(),
            sampled_at: NEVER,
            ready_256: 0,
            timeout_at: NEVER,
            connected: [false; 2],
            next: NEVER,
        }
    }

    /// Resets the UART. Characters that are on the line still arrive.
    pub(super) fn reset(&mut self) {
        let line = std::mem::take(&mut self.line);
        let (clocks, connected) = (self.clocks, self.connected);
        *self = Uart { line, clocks, connected, ..Uart::new(self.number) };
    }

    /// Sets the frequencies of clk_peri and clk_sys, Hz, from a cycle on.
    pub(super) fn set_clocks(&mut self, peri_hz: u64, sys_hz: u64, cycle: u64) {
        if self.clocks != (peri_hz, sys_hz) {
            self.clocks = (peri_hz, sys_hz);
            self.set_baud();
            self.go_on(cycle);
        }
    }

    /// Sets whether pins are connected to the transmitter and to the receiver, from a cycle on.
    pub(super) fn connect(&mut self, connected: [bool; 2], cycle: u64) {
        if self.connected != connected {
            self.connected = connected;
            self.ready_256 = self.ready_256.max(cycle << 8);
            self.go_on(cycle);
        }
    }

    /// Starts sending and receiving where it was not possible before.
    fn go_on(&mut self, cycle: u64) {
        self.begin(cycle << 8);
        self.listen();
        self.schedule();
    }

    /// Sets the length of a bit: 16 (IBRD + FBRD/64) periods of clk_peri (§4.2.3.1).
    fn set_baud(&mut self) {
        let divisor = u64::from(self.ibrd << 6 | self.fbrd);
        let (peri, sys) = self.clocks;
        self.bit_256 = (divisor * 64 * sys).checked_div(peri).unwrap_or(0);
    }

    fn is_on(&self, direction: u32) -> bool {
        self.cr & UARTEN != 0 && self.cr & direction != 0 && self.bit_256 != 0
    }

    fn depth(&self) -> usize {
        if self.lcr_h & FEN != 0 { 32 } else { 1 }
    }

    fn watermark(&self, field: u32) -> usize {
        if self.depth() == 1 { 1 } else { [4, 8, 16, 24, 28, 28, 28, 28][(field & 7) as usize] }
    }

    fn data_bits(&self) -> u8 {
        5 + (self.lcr_h >> 5 & 3) as u8
    }

    // The transmitter.

    /// Sends the first of the waiting characters, from a time on.
    fn begin(&mut self, from_256: u64) {
        if self.sending.is_some() || !self.is_on(TXE) {
            return;
        }
        let Some(data) = self.tx.pop_front() else { return };
        let stop = if self.lcr_h & STP2 != 0 { 2 } else { 1 };
        let bits = u64::from(self.data_bits()) + 1 + u64::from(self.lcr_h & PEN != 0) + stop;
        let data = data & (0xff >> (8 - self.data_bits()));
        self.sending =
            Some(Sending { start_cycle: from_256.div_ceil(256), end_256: from_256 + bits * self.bit_256, data });
        // The interrupt is raised as the FIFO falls through its level (DDI 0183 §2.8.2).
        let level = if self.depth() == 1 { 0 } else { [4, 8, 16, 24, 28, 28, 28, 28][(self.ifls & 7) as usize] };
        if self.tx.len() == level {
            self.ris |= TXRIS;
        }
    }

    /// Whether it still sends, or has characters in its FIFO.
    pub(super) fn is_sending(&self) -> bool {
        self.sending.is_some() || !self.tx.is_empty()
    }

    // The receiver.

    /// Puts a character on the line to the receiver, in the order of their cycles.
    pub(super) fn receive(&mut self, byte: LineByte) {
        self.line.push_back(byte);
        self.listen();
        self.schedule();
    }

    /// The cycle by which all characters on the line have passed.
    pub(super) fn line_end(&self) -> u64 {
        self.line.back().map_or(0, LineByte::end_cycle)
    }

    fn frame_bits(&self) -> u64 {
        1 + u64::from(self.data_bits()) + u64::from(self.lcr_h & PEN != 0)
    }

    /// Finds the next start bit. The character is complete in the middle of its stop bit.
    fn listen(&mut self) {
        if self.sampled_at != NEVER {
            return;
        }
        while let Some(byte) = self.line.front() {
            let start_256 = byte.start_cycle << 8;
            let heard = self.is_on(RXE) && self.connected[1] && self.cr & LBE == 0;
            if heard && start_256 + u64::from(byte.bit_time_256) > self.ready_256 {
                let start_256 = start_256.max(self.ready_256);
                self.sampled_at = (start_256 + self.frame_bits() * self.bit_256 + self.bit_256 / 2) >> 8;
                return;
            }
            if !heard && self.ready_256 < start_256 {
                // The receiver may be enabled before the start bit comes.
                return;
            }
            self.line.pop_front();
        }
    }

    fn sample(&mut self, cycle: u64) {
        let Some(byte) = self.line.front() else { return };
        let start = (byte.start_cycle << 8).max(self.ready_256);
        let at = |bit: u64| start + bit * self.bit_256 + self.bit_256 / 2;
        let mut data = 0u16;
        for bit in 0..u64::from(self.data_bits()) {
            data |= u16::from(level_of(&self.line, at(bit + 1))) << bit;
        }
        if self.lcr_h & PEN != 0 {
            let odd = data.count_ones() & 1 != 0;
            let expected = if self.lcr_h & EPS != 0 { odd } else { !odd };
            if level_of(&self.line, at(u64::from(self.data_bits()) + 1)) != expected {
                data |= PE;
            }
        }
        let stop = at(self.frame_bits());
        if !level_of(&self.line, stop) {
            data |= FE;
        }
        self.ready_256 = stop;
        self.sampled_at = NEVER;
        // The next start bit is one that comes later: everything before the middle of the stop bit was part of this
        // character.
        self.line.pop_front();
        while self.line.front().is_some_and(|byte| (byte.start_cycle << 8) + u64::from(byte.bit_time_256) <= stop) {
            self.line.pop_front();
        }
        self.store(data, cycle);
        self.listen();
    }

    fn store(&mut self, data: u16, cycle: u64) {
        self.ris |= if data & FE != 0 { FERIS } else { 0 } | if data & PE != 0 { PERIS } else { 0 };
        if self.rx.len() >= self.depth() {
            self.overrun = true;
            self.ris |= OERIS;
        } else {
            let overrun = std::mem::take(&mut self.overrun);
            self.rx.push_back(data | if overrun { OE } else { 0 });
            if self.rx.len() >= self.watermark(self.ifls >> 3) {
                self.ris |= RXRIS;
            }
        }
        // The receive timeout: 32 bit periods without another character (DDI 0183 §2.8.3).
        self.timeout_at = cycle + ((32 * self.bit_256) >> 8);
    }

    // Time.

    fn schedule(&mut self) {
        let sent_at = self.sending.map_or(NEVER, |sending| sending.end_256.div_ceil(256));
        self.next = sent_at.min(self.sampled_at).min(self.timeout_at);
    }

    /// Handles the events that are due in a cycle. Returns whether the FIFOs changed.
    pub(super) fn run(&mut self, cycle: u64, observer: &mut impl Observer) -> bool {
        let mut changed = false;
        if let Some(sending) = self.sending
            && sending.end_256.div_ceil(256) <= cycle
        {
            self.sending = None;
            changed = true;
            if self.cr & LBE != 0 {
                self.store(u16::from(sending.data), cycle);
            }
            if self.connected[0] {
                observer.transmit(UartByte {
                    uart: self.number,
                    start_cycle: sending.start_cycle,
                    end_cycle: cycle,
                    data: sending.data.into(),
                    cycles_per_bit: u32::try_from((self.bit_256 + 128) >> 8).unwrap_or(u32::MAX),
                });
            }
            self.begin(sending.end_256);
        }
        if self.sampled_at <= cycle {
            self.sample(cycle);
            changed = true;
        }
        if self.timeout_at <= cycle {
            self.timeout_at = NEVER;
            if !self.rx.is_empty() {
                self.ris |= RTRIS;
            }
        }
        self.schedule();
        changed
    }

    /// The transfers that the DMA may make: words to read, or places to write.
    pub(super) fn credit(&self, receives: bool) -> u8 {
        let enabled = self.dmacr >> u32::from(!receives) & 1 != 0;
        let amount = if receives { self.rx.len() } else { self.depth() - self.tx.len().min(self.depth()) };
        if enabled { amount as u8 } else { 0 }
    }

    pub(super) fn line_asserted(&self) -> bool {
        self.ris & self.imsc != 0
    }

    // Registers (§4.2.8).

    pub(super) fn read(&mut self, offset: u32) -> u32 {
        match offset {
            0x000 => {
                let Some(data) = self.rx.pop_front() else { return 0 };
                self.rsr = u32::from(data >> 8);
                if self.rx.len() < self.watermark(self.ifls >> 3) {
                    self.ris &= !RXRIS;
                }
                if self.rx.is_empty() {
                    self.ris &= !RTRIS;
                    self.timeout_at = NEVER;
                    self.schedule();
                }
                data.into()
            }
            0x004 => self.rsr,
            0x018 => {
                u32::from(self.is_sending()) << 3
                    | u32::from(self.rx.is_empty()) << 4
                    | u32::from(self.tx.len() >= self.depth()) << 5
                    | u32::from(self.rx.len() >= self.depth()) << 6
                    | u32::from(self.tx.is_empty()) << 7
            }
            0x024 => self.ibrd,
            0x028 => self.fbrd,
            0x02c => self.lcr_h,
            0x030 => self.cr,
            0x034 => self.ifls,
            0x038 => self.imsc,
            0x03c => self.ris,
            0x040 => self.ris & self.imsc,
            0x048 => self.dmacr,
            // The identification registers: PL011, revision 3; PrimeCell.
            0xfe0 => 0x11,
            0xfe4 => 0x10,
            0xfe8 => 0x34,
            0xff0 => 0x0d,
            0xff4 => 0xf0,
            0xff8 => 0x05,
            0xffc => 0xb1,
            _ => 0,
        }
    }

    pub(super) fn write(&mut self, offset: u32, value: u32, merge: impl Fn(u32) -> u32, cycle: u64) {
        match offset {
            0x000 => {
                if self.tx.len() < self.depth() {
                    self.tx.push_back(value as u8);
                }
                let level =
                    if self.depth() == 1 { 0 } else { [4, 8, 16, 24, 28, 28, 28, 28][(self.ifls & 7) as usize] };
                if self.tx.len() > level {
                    self.ris &= !TXRIS;
                }
            }
            0x004 => self.rsr = 0,
            0x024 => self.ibrd = merge(self.ibrd) & 0xffff,
            0x028 => self.fbrd = merge(self.fbrd) & 0x3f,
            // A write of this register takes over the divisor (DDI 0183 §3.3.7).
            0x02c => {
                self.lcr_h = merge(self.lcr_h) & 0xff;
                self.set_baud();
            }
            0x030 => {
                self.cr = merge(self.cr) & 0xff87;
                self.ready_256 = self.ready_256.max((cycle + 1) << 8);
            }
            0x034 => self.ifls = merge(self.ifls) & 0x3f,
            0x038 => self.imsc = merge(self.imsc) & 0x7ff,
            0x044 => self.ris &= !value,
            0x048 => self.dmacr = merge(self.dmacr) & 7,
            _ => {}
        }
        self.go_on(cycle + 1);
    }
}
