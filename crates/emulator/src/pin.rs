//! Pins as the world sees them: the same for every chip.

/// What a pin's voltage means.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Level {
    /// 0.
    Low,
    /// 1.
    High,
}

impl Level {
    /// Whether the level is [`High`](Level::High).
    pub const fn is_high(self) -> bool {
        matches!(self, Level::High)
    }
}

impl From<bool> for Level {
    fn from(high: bool) -> Level {
        if high { Level::High } else { Level::Low }
    }
}

/// A port of eight pins.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Port {
    /// Port B: the Uno's pins 8 to 13 are bits 0 to 5.
    B,
    /// Port C: the Uno's A0 to A5 are bits 0 to 5.
    C,
    /// Port D: the Uno's pins 0 to 7.
    D,
}

impl Port {
    /// Every port, in the order of [`Port::index`].
    pub const ALL: [Port; 3] = [Port::B, Port::C, Port::D];

    /// 0, 1, 2 for B, C, D.
    pub const fn index(self) -> usize {
        match self {
            Port::B => 0,
            Port::C => 1,
            Port::D => 2,
        }
    }
}

/// A pin took another level, and the chip was the cause.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PinEdge {
    /// The first cycle in which the pin has its new level.
    pub cycle: u64,
    /// Which port.
    pub port: Port,
    /// Which of its bits, 0 to 7.
    pub bit: u8,
    /// The new level.
    pub level: Level,
}

/// As [`PinEdge`], of a pin that has a number only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct GpioEdge {
    /// The first cycle in which the pin has its new level.
    pub cycle: u64,
    /// Its number: 0 to 29 on an RP2040.
    pub gpio: u8,
    /// The new level.
    pub level: Level,
}
