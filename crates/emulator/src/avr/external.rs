//! External and pin change interrupts (DS40002061B §13).
//!
//! Here are also the synchronisers in front of the other peripherals that react to pins (timer clocks, input capture).
//! A change reaches them three cycles after it happened (figure 13-1; §17.3 describes the edge detectors of the timers
//! alike). The input capture's noise canceller takes four cycles more (§16.6.2).

use super::ports::Change;
use crate::Port;

/// Cycles from a pin's change to the flag (figure 13-1).
pub(super) const SYNCHRONISER: u64 = 3;

#[derive(Clone, Default)]
pub(super) struct External {
    /// EICRA: two bits each for INT0 and INT1.
    pub(super) sense: u8,
    pub(super) mask: u8,
    pub(super) flags: u8,
    /// PCICR, PCIFR, and PCMSK0 to PCMSK2.
    pub(super) change_enable: u8,
    pub(super) change_flags: u8,
    pub(super) change_mask: [u8; 3],
    /// Pin changes on their way through the synchronisers, earliest first.
    queue: Vec<Change>,
}

impl External {
    fn sense_of(&self, number: u8) -> u8 {
        self.sense >> (2 * number) & 3
    }

    /// The bits of a port whose changes an interrupt here depends on.
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

    /// Handles the changes that are due in `cycle`. `clocked` is whether the I/O clock runs: INT0 and INT1 need it to
    /// see an edge (table 10-1).
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

    /// The pending interrupts of INT0 (bit 0) and INT1 (bit 1). `level` is the level of port D.
    pub(super) fn pending(&self, level: u8) -> u8 {
        let mut pending = 0;
        for number in 0..2 {
            // A low level keeps the interrupt pending as long as it lasts; the flag is 0 all the time (§13.2.3).
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
