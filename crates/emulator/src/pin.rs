//! Pins, ports and edges, as seen from outside the chip.

/// A digital level.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Level {
    /// Near 0 V.
    Low,
    /// Near the supply voltage.
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

/// A port of eight pins of an ATmega328P.
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

    /// The number of the port: 0, 1, 2 for B, C, D.
    pub const fn index(self) -> usize {
        match self {
            Port::B => 0,
            Port::C => 1,
            Port::D => 2,
        }
    }
}

/// A change of a pin's level that the chip caused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PinEdge {
    /// The first cycle with the new level.
    pub cycle: u64,
    /// The port of the pin.
    pub port: Port,
    /// The bit of the pin in its port, 0 to 7.
    pub bit: u8,
    /// The new level.
    pub level: Level,
}

/// A change of a pin's level that the chip caused, where pins have numbers only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct GpioEdge {
    /// The first cycle with the new level.
    pub cycle: u64,
    /// The number of the pin: 0 to 29 on an RP2040; on a SAM3X8E 0 to 127, 32 for each port.
    pub gpio: u8,
    /// The new level.
    pub level: Level,
}
