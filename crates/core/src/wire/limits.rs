//! What all of the protocol builds on: its version, the number of motors, the rates of the line, its clock.

/// The protocol's version. A host that meets a board with another one reports that and ends the session.
pub const VERSION: u8 = 3;

/// Motors that messages have room for: flags of motors have a bit each in a byte.
pub const MAX_MOTORS: usize = 8;
const _: () = assert!(MAX_MOTORS == crate::verbs::MAX_MOTORS, "orders name as many");

/// How fast the line is. Both ends begin at [`Baud::B115200`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Baud {
    /// 115 200 baud: the first, and the one to fall back to.
    #[default]
    B115200 = 0,
    /// 250 000 baud.
    B250k = 1,
    /// 500 000 baud.
    B500k = 2,
    /// 1 000 000 baud.
    B1M = 3,
    /// 2 000 000 baud.
    B2M = 4,
}

impl Baud {
    /// All of them, by code.
    pub const ALL: [Baud; 5] = [Baud::B115200, Baud::B250k, Baud::B500k, Baud::B1M, Baud::B2M];

    /// Bits a second.
    #[must_use]
    pub const fn rate(self) -> u32 {
        match self {
            Baud::B115200 => 115_200,
            Baud::B250k => 250_000,
            Baud::B500k => 500_000,
            Baud::B1M => 1_000_000,
            Baud::B2M => 2_000_000,
        }
    }

    /// Stop bits that a host puts behind each of its bytes; one is enough for every board. The second is a rest for a board that
    /// receives much at a high rate, and takes each byte by an interrupt. At 115 200 baud, where text is sent too, there is one.
    ///
    /// ```
    /// use pulsetrain_core::wire::Baud;
    /// assert_eq!((Baud::B115200.stop_bits(), Baud::B1M.stop_bits()), (1, 2));
    /// ```
    #[must_use]
    pub const fn stop_bits(self) -> u8 {
        match self {
            Baud::B115200 => 1,
            Baud::B250k | Baud::B500k | Baud::B1M | Baud::B2M => 2,
        }
    }

    /// The rate that `code` stands for.
    ///
    /// ```
    /// use pulsetrain_core::wire::Baud;
    /// assert_eq!(Baud::from_code(3), Some(Baud::B1M));
    /// assert_eq!(Baud::from_code(5), None);
    /// ```
    #[must_use]
    pub const fn from_code(code: u8) -> Option<Baud> {
        // A table would lie in a small board's RAM.
        match code {
            0 => Some(Baud::B115200),
            1 => Some(Baud::B250k),
            2 => Some(Baud::B500k),
            3 => Some(Baud::B1M),
            4 => Some(Baud::B2M),
            _ => None,
        }
    }
}

/// About a millisecond each, wrapping after a minute: the clock of the link's own limits.
///
/// The Uno takes ticks / 2^14 (1.024 ms): no limit is that precise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(transparent)]
pub struct Millis(pub u16);

impl Millis {
    /// Milliseconds from `earlier` to `self`, less than 65 536.
    #[must_use]
    pub const fn since(self, earlier: Millis) -> u16 {
        self.0.wrapping_sub(earlier.0)
    }
}
