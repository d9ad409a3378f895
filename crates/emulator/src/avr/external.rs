//! External and pin change interrupts (DS40002061B §13), and the synchronisers that other peripherals watch pins
//! through.
//!
//! Whoever watches a pin hears of a change three cycles after it (figure 13-1; the edge detectors of the timers, §17.3,
//! are described alike); the input capture's noise canceller takes four more (§16.6.2).

use super::ports::Change;
use crate::Port;

/// Cycles from a pin's change to a flag.
pub(super) const SYNCHRONISER: u64 = 3;

#[derive(Clone, Default)]
pub(super) struct External {
    /// EICRA: two bits each.
    pub(super) sense: u8,
    pub(super) mask: u8,
    pub(super) flags: u8,
    /// PCICR, PCIFR, PCMSK0 to 2.
    pub(super) change_enable: u8,
    pub(super) change_flags: u8,
    pub(super) change_mask: [u8; 3],
    /// Changes on their way through the synchronisers, in order.
    queue: Vec<Change>,
}

impl External {
    fn sense_of(&self, number: u8) -> u8 {
        self.sense >> (2 * number) & 3
    }

    /// Bits of a port whose changes matter here.
    pub(super) fn watched(&self, port: Port) -> u8 {
        let asked = |number: u8| u8::from(self.sense_of(number) != 0 || self.mask >> number & 1 != 0) << (2 + number);
        self.change_mask[port.index()] | if port == Port::D { asked(0) | asked(1) } else { 0 }
    }

    pub(super) fn note(&mut self, change: Change) {
        self.queue.push(change);
    }

    pub(super) fn next_event(&self) -> u64 {
        self.queue.first().map_or(u64::MAX, |change| change.cycle + SYNCHRONISER)
    }

    /// `clocked` is whether the I/O clock runs: without it edges of INT0 and INT1 are not seen (table 10-1).
    pub(super) fn event(&mut self, cycle: u64, clocked: bool) {
        while self.queue.first().is_some_and(|change| change.cycle + SYNCHRONISER <= cycle) {
            let change = self.queue.remove(0);
            let port = change.port.index();
            if change.bits & self.change_mask[port] != 0 {
                self.change_flags |= 1 << port;
            }
            if change.port == Port::D && clocked {
                for number in 0..2 {
                    let pin = 1 << (2 + number);
                    let high = change.level & pin != 0;
                    let seen = match self.sense_of(number) {
                        0 => false,
                        1 => true,
                        2 => !high,
                        _ => high,
                    };
                    if change.bits & pin != 0 && seen {
                        self.flags |= 1 << number;
                    }
                }
            }
        }
    }

    /// Which of INT0 and INT1 wait, as bits; `level` is port D's.
    pub(super) fn pending(&self, level: u8) -> u8 {
        let mut pending = 0;
        for number in 0..2 {
            // A low level asks as long as it lasts; its flag is always 0 (§13.2.3).
            let asks =
                if self.sense_of(number) == 0 { level >> (2 + number) & 1 == 0 } else { self.flags >> number & 1 != 0 };
            pending |= u8::from(asks) << number;
        }
        pending & self.mask
    }

    pub(super) fn change_pending(&self) -> u8 {
        self.change_flags & self.change_enable
    }
}
