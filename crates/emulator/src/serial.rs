//! Characters on a serial line.

use std::collections::VecDeque;

/// A character that a chip has sent. The observer gets it at the end of the last stop bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct UartByte {
    /// The number of the UART; 0 where the chip has one.
    pub uart: u8,
    /// The cycle in which its start bit begins.
    pub start_cycle: u64,
    /// The first cycle after its last stop bit.
    pub end_cycle: u64,
    /// 5 to 9 data bits, lowest first on the line.
    pub data: u16,
    /// Length of a bit, cycles.
    pub cycles_per_bit: u32,
}

impl UartByte {
    /// The lower eight data bits.
    pub const fn byte(&self) -> u8 {
        self.data.to_le_bytes()[0]
    }
}

/// A character on the line to a chip's receiver: a start bit, data bits and stop bits, at the sender's baud rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct LineByte {
    /// The cycle in which its start bit begins.
    pub start_cycle: u64,
    /// The data bits, lowest first. A parity bit, if there is one, counts as a data bit.
    pub data: u16,
    /// The number of data bits, 5 to 10.
    pub bits: u8,
    /// Length of a bit, 1/256 cycle.
    pub bit_time_256: u32,
}

impl LineByte {
    /// A character as a PC sends it: eight data bits, no parity, one stop bit or more. `bit_time_256` is in 1/256
    /// cycle.
    ///
    /// ```
    /// use pulsetrain_emulator::LineByte;
    /// // 115 200 baud at 16 MHz: 138.9 cycles a bit.
    /// let byte = LineByte::new(1000, b'A', 16_000_000 * 256 / 115_200);
    /// assert_eq!(byte.end_cycle(), 2389);
    /// ```
    pub const fn new(start_cycle: u64, byte: u8, bit_time_256: u32) -> LineByte {
        LineByte { start_cycle, data: byte as u16, bits: 8, bit_time_256 }
    }

    /// The first whole cycle after its first stop bit.
    pub const fn end_cycle(&self) -> u64 {
        (self.start_cycle * 256 + self.bit_time_256 as u64 * (self.bits as u64 + 2)).div_ceil(256)
    }
}

/// The level of a line at a time, in 1/256 cycle. A line at rest is high.
pub(crate) fn level_of(line: &VecDeque<LineByte>, at_256: u64) -> bool {
    for byte in line.iter().take(3).rev() {
        let start = byte.start_cycle << 8;
        if at_256 >= start {
            return match (at_256 - start) / u64::from(byte.bit_time_256.max(1)) {
                0 => false,
                bit if bit <= u64::from(byte.bits) => byte.data >> (bit - 1) & 1 != 0,
                _ => true,
            };
        }
    }
    true
}
