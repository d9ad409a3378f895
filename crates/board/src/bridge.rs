//! The timing of the chip between an Uno's serial line and USB: its baud rates, and when it hands bytes to the computer.

use std::collections::VecDeque;
use std::time::Duration;

/// Cycles per second of the Uno's chip; one tick of the firmware's clock is one cycle.
pub const CYCLES_PER_S: u64 = 16_000_000;

/// Cycles in a frame of full-speed USB, 1 ms (USB 2.0, 8.4.3): data cross USB once in each.
const USB_FRAME: u64 = CYCLES_PER_S / 1000;

/// The bridge has a 16 MHz clock too and divides it by 8 and a whole number (ATmega16U2, DS7799, 18.3.1).
const BRIDGE_DIVIDER: u64 = 8;

/// A chip between a serial line and USB.
///
/// It holds back what the board says until its timer is over or it has so many bytes; the bytes then wait for the next frame of USB. What the computer
/// says goes on with the frame after it.
///
/// ```
/// use pulsetrain_board::bridge::Bridge;
/// assert_eq!(Bridge::named("ftdi"), Some(Bridge::Ftdi));
/// // 4.1 ms, and 1 ms of USB.
/// assert_eq!(Bridge::Atmega16u2.longest_delay().as_micros(), 5096);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Bridge {
    /// The ATmega16U2 of an Arduino Uno and of a Due's programming port, with Arduino's program: its Timer0 overflows each 256 × 256 cycles, 4.1 ms,
    /// and whatever the buffer holds goes out, or as soon as there are more than 96 bytes (ArduinoCore-avr, firmwares/atmegaxxu2/arduino-usbserial).
    Atmega16u2,
    /// The CH340, which many Unos of other makers have. Its packets have 32 bytes at most. Linux's driver sets it so that it waits for no full packet,
    /// and sends what it has with each frame of USB (drivers/usb/serial/ch341.c).
    #[default]
    Ch340,
    /// An FT232R as its driver sets it: packets of 62 bytes, or what there is after 16 ms (FTDI AN232B-04, 2).
    Ftdi,
}

impl Bridge {
    /// All of them, with the names that users write.
    pub const ALL: [(&str, Bridge); 3] =
        [("16u2", Bridge::Atmega16u2), ("ch340", Bridge::Ch340), ("ftdi", Bridge::Ftdi)];

    /// The one that users call so.
    #[must_use]
    pub fn named(name: &str) -> Option<Bridge> {
        Bridge::ALL.into_iter().find_map(|(known, bridge)| (known == name).then_some(bridge))
    }

    /// Cycles after which it hands on what it has.
    const fn period(self) -> u64 {
        match self {
            Bridge::Atmega16u2 => 256 * 256,
            Bridge::Ch340 => USB_FRAME,
            Bridge::Ftdi => 16 * USB_FRAME,
        }
    }

    /// So many bytes are handed on at once.
    const fn full(self) -> usize {
        match self {
            Bridge::Atmega16u2 => 97,
            Bridge::Ch340 => 32,
            Bridge::Ftdi => 62,
        }
    }

    /// Whether a full packet restarts the timer. The timers of the others run on.
    const fn restarts(self) -> bool {
        matches!(self, Bridge::Ftdi)
    }

    /// The longest time from a byte's end on the line to its arrival at the computer.
    #[must_use]
    pub fn longest_delay(self) -> Duration {
        duration(self.period() + USB_FRAME)
    }
}

/// Bytes that a board has sent and that the computer has not received yet.
#[derive(Clone, Debug, Default)]
pub struct ToHost {
    bridge: Bridge,
    /// The cycle of each byte's end, and the byte; in order.
    bytes: VecDeque<(u64, u8)>,
    /// The cycle at which the timer is over.
    due: u64,
}

impl ToHost {
    /// An empty one behind a bridge.
    #[must_use]
    pub fn through(bridge: Bridge) -> ToHost {
        ToHost { bridge, bytes: VecDeque::new(), due: bridge.period() }
    }

    /// A byte that ends at a cycle of the line, not before those that were said before.
    pub fn say(&mut self, cycle: u64, byte: u8) {
        self.bytes.push_back((cycle, byte));
    }

    /// Forgets what was not handed on.
    pub fn clear(&mut self) {
        self.bytes.clear();
    }

    /// What reaches the computer with the frame of USB that begins at this cycle.
    pub fn hand_over(&mut self, frame: u64, into: &mut Vec<u8>) {
        let (period, full) = (self.bridge.period(), self.bridge.full());
        loop {
            let full_at = self.bytes.get(full - 1).map(|(cycle, _)| *cycle).filter(|cycle| *cycle < self.due);
            let at = full_at.unwrap_or(self.due);
            if at > frame {
                return;
            }
            while let Some((_, byte)) = self.bytes.pop_front_if(|(cycle, _)| *cycle <= at) {
                into.push(byte);
            }
            if full_at.is_none() || self.bridge.restarts() {
                self.due = at + period;
            }
        }
    }
}

/// What is received of a byte that was sent at another rate: any wrong byte will do.
pub(crate) const fn garbled(byte: u8) -> u8 {
    byte.rotate_left(3) ^ 0x5a
}

/// The cycle at which the next USB frame after `cycle` begins.
#[must_use]
pub const fn next_frame(cycle: u64) -> u64 {
    (cycle / USB_FRAME + 1) * USB_FRAME
}

/// Cycles of a bit at the rate that the bridge makes when it is set to `rate`, bits a second (1200 or more).
pub(crate) fn bit_cycles(rate: u32) -> u64 {
    let rate = u64::from(rate) * BRIDGE_DIVIDER;
    (CYCLES_PER_S + rate / 2) / rate.max(1) * BRIDGE_DIVIDER
}

/// Cycles as a time, rounded down to nanoseconds.
pub(crate) fn duration(cycle: u64) -> Duration {
    // 62.5 ns each; 2^63 ns are 292 years.
    Duration::from_nanos((u128::from(cycle) * 125 / 2) as u64)
}

/// A time in cycles, rounded up.
pub(crate) fn cycles(time: Duration) -> u64 {
    u64::try_from((time.as_nanos() * 2).div_ceil(125)).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The frame with which each byte comes that ends at one of these cycles.
    fn frames(bridge: Bridge, cycles: &[u64]) -> Vec<u64> {
        let (mut line, mut frames) = (ToHost::through(bridge), Vec::new());
        cycles.iter().for_each(|cycle| line.say(*cycle, 0));
        let mut frame = 0;
        while frames.len() < cycles.len() {
            frame = next_frame(frame);
            let mut got = Vec::new();
            line.hand_over(frame, &mut got);
            frames.extend(got.iter().map(|_| frame / USB_FRAME));
        }
        frames
    }

    #[test]
    fn a_few_bytes_wait_for_the_timer() {
        // The timer is over at 4.096 and 8.192 ms; the frame after that is the fifth or the ninth.
        assert_eq!(frames(Bridge::Atmega16u2, &[10, 65_536, 65_537, 131_072]), [5, 5, 9, 9]);
        assert_eq!(frames(Bridge::Ch340, &[10, 16_000, 16_001]), [1, 1, 2]);
        assert_eq!(frames(Bridge::Ftdi, &[10, 256_000, 256_001]), [16, 16, 32]);
    }

    #[test]
    fn many_bytes_go_at_once() {
        let each_40_cycles = |count: u64| (1..=count).map(|byte| byte * 40).collect::<Vec<_>>();
        // The 97th byte ends at cycle 3880, in the first frame; one more waits for the timer.
        let mut frames_of_98 = vec![1; 97];
        frames_of_98.push(5);
        assert_eq!(frames(Bridge::Atmega16u2, &each_40_cycles(98)), frames_of_98);
        // The 62nd byte ends at cycle 2480 and restarts the timer. The 63rd byte comes 16 ms later.
        let mut frames_of_63 = vec![1; 62];
        frames_of_63.push(17);
        assert_eq!(frames(Bridge::Ftdi, &each_40_cycles(63)), frames_of_63);
    }

    #[test]
    fn no_byte_takes_longer_than_it_is_said() {
        for (name, bridge) in Bridge::ALL {
            for cycle in (1..600_000).step_by(997) {
                let frame = frames(bridge, &[cycle])[0];
                assert!(duration(frame * USB_FRAME - cycle) <= bridge.longest_delay(), "{name}: {cycle}");
            }
        }
    }
}
