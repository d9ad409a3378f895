//! The registers of Timer/Counter 0 and 2: 8 bits (DS40002061B §15.9, §18.11). The counters themselves are in `timer`.

use super::timer::{Clock, Mode, Outputs, Shape, Timer, Top};

#[derive(Clone)]
pub(super) struct Timer8 {
    pub(super) timer: Timer,
    pub(super) a: u8,
    pub(super) b: u8,
}

impl Timer8 {
    pub(super) fn new() -> Timer8 {
        Timer8 { timer: Timer::new(0xff), a: 0, b: 0 }
    }

    pub(super) fn reset(&mut self, cycle: u64) {
        self.timer.reset(cycle);
        (self.a, self.b) = (0, 0);
    }

    /// Writes TCCRnA.
    pub(super) fn write_a(&mut self, value: u8, cycle: u64, outputs: &mut impl Outputs) {
        self.a = value & 0xf3;
        self.configure(cycle, outputs);
    }

    /// Writes TCCRnB. Its strobes FOCnA and FOCnB read 0. The caller works out `clock`, because the two timers have
    /// different tables for it.
    pub(super) fn write_b(&mut self, value: u8, clock: Clock, cycle: u64, outputs: &mut impl Outputs) {
        self.b = value & 0x0f;
        self.configure(cycle, outputs);
        self.timer.set_clock(clock);
        for channel in 0..2 {
            if value << channel & 0x80 != 0 {
                self.timer.force(channel, cycle, outputs);
            }
        }
    }

    fn configure(&mut self, cycle: u64, outputs: &mut impl Outputs) {
        // Tables 15-8 and 18-8; modes 4 and 6 are reserved and run as normal mode.
        let (shape, top) = match self.a & 3 | self.b >> 1 & 4 {
            1 => (Shape::PhaseCorrect, Top::Fixed(0xff)),
            2 => (Shape::Plain, Top::OcrA),
            3 => (Shape::Fast, Top::Fixed(0xff)),
            5 => (Shape::PhaseCorrect, Top::OcrA),
            7 => (Shape::Fast, Top::OcrA),
            _ => (Shape::Plain, Top::Fixed(0xff)),
        };
        self.timer.set_mode(Mode { shape, top }, [self.a >> 6, self.a >> 4 & 3], cycle, outputs);
    }
}

/// The clock that CSn2:0 select for Timer/Counter 0 and 1 (tables 15-9, 16-5).
pub(super) fn shared_clock(bits: u8) -> Clock {
    match bits & 7 {
        0 => Clock::Stopped,
        1 => Clock::Prescaled(1),
        2 => Clock::Prescaled(8),
        3 => Clock::Prescaled(64),
        4 => Clock::Prescaled(256),
        5 => Clock::Prescaled(1024),
        6 => Clock::Pin { rising: false },
        _ => Clock::Pin { rising: true },
    }
}

/// The clock that CS22:0 select for Timer/Counter 2 (table 18-9), from the system clock.
pub(super) fn timer2_clock(bits: u8) -> Clock {
    match bits & 7 {
        0 => Clock::Stopped,
        1 => Clock::Prescaled(1),
        2 => Clock::Prescaled(8),
        3 => Clock::Prescaled(32),
        4 => Clock::Prescaled(64),
        5 => Clock::Prescaled(128),
        6 => Clock::Prescaled(256),
        _ => Clock::Prescaled(1024),
    }
}
