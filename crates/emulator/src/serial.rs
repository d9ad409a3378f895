//! Characters on a serial line.

/// A character that the chip has sent, when its last stop bit is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct UartByte {
    /// Which UART of the chip; 0 where there is one.
    pub uart: u8,
    /// The cycle in which its start bit begins.
    pub start_cycle: u64,
    /// The first cycle after its stop bit, or bits.
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

/// A character that someone else puts on the line: a start bit, data bits and stop bits at the sender's own speed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct LineByte {
    /// The cycle in which its start bit begins.
    pub start_cycle: u64,
    /// Data bits, lowest first; a parity bit, if any, is one of them.
    pub data: u16,
    /// How many data bits, 5 to 10.
    pub bits: u8,
    /// Length of a bit, 1/256 cycle.
    pub bit_time_256: u32,
}

impl LineByte {
    /// Eight data bits, no parity, and at least one stop bit: what a PC sends. `bit_time_256` is in 1/256 cycle.
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
