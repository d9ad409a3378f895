//! The boards that this project has a firmware for: what a program needs to know of each before it connects.
//!
//! Limits, pins and queues of all boards are rows of `pulsetrain_motion::boards`, under the same names. A new board needs a variant here and a row
//! there.

use crate::VirtualBoard;
use crate::virtual_pico::{self, VirtualPico};
use crate::virtual_uno::{self, VirtualUno};
use pulsetrain_core::wire::Baud;

/// A board that this project has a firmware for.
///
/// ```
/// use pulsetrain_board::{BoardKind, registry::Role};
/// let kind = BoardKind::named("pico").unwrap();
/// assert_eq!((kind.title(), kind.usual_baud().rate()), ("Pico", 2_000_000));
/// // The real firmware on an emulated chip.
/// assert!(kind.virtual_board(Role::Plans).zero().is_some());
/// assert_eq!(BoardKind::named("due"), None);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BoardKind {
    /// An Arduino Uno: ATmega328P.
    Uno,
    /// A Raspberry Pi Pico: RP2040.
    Pico,
}

/// How a host controls a board. An Uno has a firmware image for each way; a Pico's one image has all.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// By plans, in frames (docs/protocol.md).
    Plans,
    /// By StepperWinch's text (docs/winch.md).
    Winch,
    /// By verbs: orders to single motors (docs/pico.md).
    Verbs,
}

impl Role {
    /// All of them.
    pub const ALL: [Role; 3] = [Role::Plans, Role::Winch, Role::Verbs];

    /// What `pulsetrain flash uno --image` calls an Uno's image.
    #[must_use]
    pub const fn image_name(self) -> &'static str {
        match self {
            Role::Plans => "uno",
            Role::Winch => "winch",
            Role::Verbs => "verbs",
        }
    }
}

impl BoardKind {
    /// All of them.
    pub const ALL: [BoardKind; 2] = [BoardKind::Uno, BoardKind::Pico];
    /// Their names in motion files and commands.
    pub const NAMES: [&'static str; 2] = [BoardKind::Uno.name(), BoardKind::Pico.name()];

    /// The board of a name in motion files; `None` where there is no firmware for it.
    #[must_use]
    pub fn named(name: &str) -> Option<BoardKind> {
        BoardKind::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// Its name in motion files and commands.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            BoardKind::Uno => "uno",
            BoardKind::Pico => "pico",
        }
    }

    /// Its name in sentences.
    #[must_use]
    pub const fn title(self) -> &'static str {
        match self {
            BoardKind::Uno => "Uno",
            BoardKind::Pico => "Pico",
        }
    }

    /// The board's number in Info (docs/protocol.md).
    #[must_use]
    pub const fn number(self) -> u8 {
        match self {
            BoardKind::Uno => 1,
            BoardKind::Pico => 2,
        }
    }

    /// The default rate of its line. An Uno's USB bridge makes 1 Mbaud exactly, and it is enough for all plans. A Pico's clock makes 2 Mbaud exactly.
    #[must_use]
    pub const fn usual_baud(self) -> Baud {
        match self {
            BoardKind::Uno => Baud::B1M,
            BoardKind::Pico => Baud::B2M,
        }
    }

    /// About how many times as fast as a real board the virtual one is on a PC. Obtained with `run` of sweep.toml and pico.toml.
    #[must_use]
    pub const fn emulation_speed(self) -> f64 {
        match self {
            BoardKind::Uno => 12.0,
            BoardKind::Pico => 5.0,
        }
    }

    /// Whether a motion is rehearsed on the virtual board before a real one gets it. An Uno needs it: its processor does everything, and its queues
    /// are short.
    #[must_use]
    pub const fn is_rehearsed(self) -> bool {
        matches!(self, BoardKind::Uno)
    }

    /// The committed firmware for a role, in the form that programs the board: an Uno's flash from address 0, a Pico's UF2 file.
    #[must_use]
    pub fn image(self, role: Role) -> Vec<u8> {
        match (self, role) {
            (BoardKind::Uno, Role::Plans) => virtual_uno::image(),
            (BoardKind::Uno, Role::Winch) => virtual_uno::winch_image(),
            (BoardKind::Uno, Role::Verbs) => virtual_uno::verbs_image(),
            (BoardKind::Pico, _) => virtual_pico::IMAGE.to_vec(),
        }
    }

    /// The virtual board with the committed firmware for a role, just plugged in and with its port open. A Pico's port is its own USB, or its UART for
    /// [`Role::Winch`].
    #[must_use]
    pub fn virtual_board(self, role: Role) -> Box<dyn VirtualBoard> {
        match (self, role) {
            (BoardKind::Uno, Role::Plans) => Box::new(VirtualUno::new()),
            (BoardKind::Uno, Role::Winch) => Box::new(VirtualUno::with_winch()),
            (BoardKind::Uno, Role::Verbs) => Box::new(VirtualUno::with_verbs()),
            // The firmware takes text on its UART, as an Uno does.
            (BoardKind::Pico, Role::Winch) => Box::new(VirtualPico::new()),
            (BoardKind::Pico, Role::Plans | Role::Verbs) => Box::new(VirtualPico::on_usb()),
        }
    }
}
