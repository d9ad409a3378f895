//! Constants of the whole protocol: its version, the number of motors, the rates of the line, and the clock of its timeouts.

/// The protocol's version. A host that meets a board with another one reports that and ends the session.
pub const VERSION: u8 = 3;

/// The most motors in a message. A motor has one bit in bytes such as [`Stopped::uncertain`](super::Stopped::uncertain).
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

    /// The number of stop bits that a host sends after each byte. Every board is content with one. The second gives a board that takes
    /// each byte by an interrupt more time at high rates. At 115 200 baud there is one, because text is sent at that rate, too.
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
        // This is no table, because an AVR would keep a table in its RAM.
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

/// A time in units of about a millisecond, which wraps after a minute: the clock of the link's timeouts.
///
/// The Uno uses ticks / 2^14 (1.024 ms), which needs no division. No timeout has to be more precise.
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
