//! The registers of Timer/Counter 1: 16 bits behind an 8-bit bus (DS40002061B §16.3, §16.11). The counter itself is in
//! `timer`.
//!
//! One byte, TEMP, holds the high byte of all 16-bit registers: a program writes the high byte first and reads it last.
//! An interrupt between the two accesses that uses another 16-bit register overwrites TEMP.

use super::timer::{Clock, Mode, Outputs, Shape, Timer, Top};
use super::timer8::shared_clock;

/// Which 16-bit register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Wide {
    Counter,
    Capture,
    CompareA,
    CompareB,
}

#[derive(Clone)]
pub(super) struct Timer16 {
    pub(super) timer: Timer,
    pub(super) a: u8,
    pub(super) b: u8,
    temp: u8,
}

impl Timer16 {
    pub(super) fn new() -> Timer16 {
        Timer16 { timer: Timer::new(0xffff), a: 0, b: 0, temp: 0 }
    }

    pub(super) fn reset(&mut self, cycle: u64) {
        self.timer.reset(cycle);
        (self.a, self.b, self.temp) = (0, 0, 0);
    }

    pub(super) fn write_a(&mut self, value: u8, cycle: u64, outputs: &mut impl Outputs) {
        self.a = value & 0xf3;
        self.configure(cycle, outputs);
    }

    pub(super) fn write_b(&mut self, value: u8, cycle: u64, outputs: &mut impl Outputs) {
        self.b = value & 0xdf;
        self.configure(cycle, outputs);
        self.timer.set_clock(shared_clock(value));
    }

    /// Writes TCCR1C, the strobes FOC1A and FOC1B.
    pub(super) fn write_c(&mut self, value: u8, cycle: u64, outputs: &mut impl Outputs) {
        for channel in 0..2 {
            if value << channel & 0x80 != 0 {
                self.timer.force(channel, cycle, outputs);
            }
        }
    }

    /// ICNC1: whether the noise canceller filters the input capture.
    pub(super) fn capture_filtered(&self) -> bool {
        self.b & 0x80 != 0
    }

    pub(super) fn capture_on_rising(&self) -> bool {
        self.b & 0x40 != 0
    }

    fn configure(&mut self, cycle: u64, outputs: &mut impl Outputs) {
        // Table 16-4; mode 13 is reserved and runs as normal mode.
        let (shape, top) = match self.a & 3 | self.b >> 1 & 0x0c {
            1 => (Shape::PhaseCorrect, Top::Fixed(0x00ff)),
            2 => (Shape::PhaseCorrect, Top::Fixed(0x01ff)),
            3 => (Shape::PhaseCorrect, Top::Fixed(0x03ff)),
            4 => (Shape::Plain, Top::OcrA),
            5 => (Shape::Fast, Top::Fixed(0x00ff)),
            6 => (Shape::Fast, Top::Fixed(0x01ff)),
            7 => (Shape::Fast, Top::Fixed(0x03ff)),
            8 => (Shape::PhaseFrequencyCorrect, Top::Icr),
            9 => (Shape::PhaseFrequencyCorrect, Top::OcrA),
            10 => (Shape::PhaseCorrect, Top::Icr),
            11 => (Shape::PhaseCorrect, Top::OcrA),
            12 => (Shape::Plain, Top::Icr),
            14 => (Shape::Fast, Top::Icr),
            15 => (Shape::Fast, Top::OcrA),
            _ => (Shape::Plain, Top::Fixed(0xffff)),
        };
        self.timer.set_mode(Mode { shape, top }, [self.a >> 6, self.a >> 4 & 3], cycle, outputs);
    }

    /// Reads a byte. Reading a low byte latches the high one in TEMP; OCR1A and OCR1B are read without TEMP (§16.3).
    pub(super) fn read(&mut self, register: Wide, high: bool) -> u8 {
        let value = match register {
            Wide::Counter => self.timer.value(),
            Wide::Capture => self.timer.icr,
            Wide::CompareA => return self.timer.compare_register(0).to_le_bytes()[usize::from(high)],
            Wide::CompareB => return self.timer.compare_register(1).to_le_bytes()[usize::from(high)],
        };
        if high {
            return self.temp;
        }
        let [low, above] = value.to_le_bytes();
        self.temp = above;
        low
    }

    /// Writes a byte. A high byte goes to TEMP; the low byte then writes both.
    pub(super) fn write(&mut self, register: Wide, high: bool, value: u8) {
        if high {
            self.temp = value;
            return;
        }
        let value = u16::from_le_bytes([value, self.temp]);
        match register {
            Wide::Counter => self.timer.write_value(value),
            Wide::CompareA => self.timer.write_compare(0, value),
            Wide::CompareB => self.timer.write_compare(1, value),
            // ICR1 can only be written in modes in which it is TOP (§16.6.3).
            Wide::Capture if self.timer.icr_is_top() => self.timer.icr = value,
            Wide::Capture => {}
        }
    }

    pub(super) fn clock(&self) -> Clock {
        self.timer.clock()
    }
}
