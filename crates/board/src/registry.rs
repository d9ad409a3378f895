//! The boards that this project has a firmware for: what a program needs to know of each before it connects.
//!
//! Limits, pins and queues of all boards are rows of `pulsetrain_motion::boards`, under the same names. A new board needs a variant with its
//! `Facts` here, and a row there.

use crate::virtual_pico::{self, VirtualPico};
use crate::virtual_uno::{self, VirtualUno};
use crate::{Setup, VirtualBoard};
use pulsetrain_core::winch::AXES;
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::{Info, MotorSetup};

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
    /// By verbs: orders to single motors (docs/verbs.md).
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

/// What is known of a board before it is connected: all in one place.
struct Facts {
    name: &'static str,
    title: &'static str,
    full_name: &'static str,
    number: u8,
    usual_baud: Baud,
    emulation_speed: f64,
    is_rehearsed: bool,
    has_image_for_each_role: bool,
    resets_when_opened: bool,
    counts_missed_compares: bool,
    last_pin: u8,
    axes: AxisWiring,
}

/// Where a board has StepperWinch's axes x, y, z and a (docs/wiring.md), and its pulses, ticks.
struct AxisWiring {
    /// STEP and DIR of each.
    pins: [(u8, u8); AXES.len()],
    enable: u8,
    pulse_ticks: u16,
    setup_ticks: u16,
}

const UNO: Facts = Facts {
    name: "uno",
    title: "Uno",
    full_name: "an Arduino Uno",
    number: 1,
    usual_baud: Baud::B1M,
    emulation_speed: 12.0,
    is_rehearsed: true,
    has_image_for_each_role: true,
    resets_when_opened: true,
    counts_missed_compares: true,
    // A5.
    last_pin: 19,
    // Those of a CNC shield. 1.94 µs, 5 µs.
    axes: AxisWiring { pins: [(2, 5), (3, 6), (4, 7), (12, 13)], enable: 8, pulse_ticks: 31, setup_ticks: 80 },
};

const PICO: Facts = Facts {
    name: "pico",
    title: "Pico",
    full_name: "a Raspberry Pi Pico",
    number: 2,
    usual_baud: Baud::B2M,
    emulation_speed: 5.0,
    is_rehearsed: false,
    has_image_for_each_role: false,
    resets_when_opened: false,
    counts_missed_compares: false,
    last_pin: 28,
    // 2 µs, 5 µs.
    axes: AxisWiring { pins: [(2, 3), (4, 5), (6, 7), (8, 9)], enable: 22, pulse_ticks: 250, setup_ticks: 625 },
};

impl BoardKind {
    /// All of them.
    pub const ALL: [BoardKind; 2] = [BoardKind::Uno, BoardKind::Pico];
    /// Their names in motion files and commands.
    pub const NAMES: [&'static str; BoardKind::ALL.len()] = {
        let mut names = [""; BoardKind::ALL.len()];
        let mut index = 0;
        while index < names.len() {
            names[index] = BoardKind::ALL[index].name();
            index += 1;
        }
        names
    };
    /// The highest number of a pin of any board.
    pub const LAST_PIN: u8 = {
        let (mut last, mut index) = (0, 0);
        while index < BoardKind::ALL.len() {
            let pin = BoardKind::ALL[index].facts().last_pin;
            last = if pin > last { pin } else { last };
            index += 1;
        }
        last
    };

    const fn facts(self) -> &'static Facts {
        match self {
            BoardKind::Uno => &UNO,
            BoardKind::Pico => &PICO,
        }
    }

    /// The board of a name in motion files; `None` where there is no firmware for it.
    #[must_use]
    pub fn named(name: &str) -> Option<BoardKind> {
        BoardKind::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// The board of a [number](BoardKind::number) in Info; `None` for models, which are no boards.
    #[must_use]
    pub fn numbered(number: u8) -> Option<BoardKind> {
        BoardKind::ALL.into_iter().find(|kind| kind.number() == number)
    }

    /// Its name in motion files and commands.
    #[must_use]
    pub const fn name(self) -> &'static str {
        self.facts().name
    }

    /// Its name in sentences.
    #[must_use]
    pub const fn title(self) -> &'static str {
        self.facts().title
    }

    /// Its maker's name for it, with its article: "an Arduino Uno".
    #[must_use]
    pub const fn full_name(self) -> &'static str {
        self.facts().full_name
    }

    /// The board's number in Info (docs/protocol.md).
    #[must_use]
    pub const fn number(self) -> u8 {
        self.facts().number
    }

    /// The default rate of its line. An Uno's USB bridge makes 1 Mbaud exactly, and it is enough for all plans. A Pico's clock makes 2 Mbaud exactly.
    #[must_use]
    pub const fn usual_baud(self) -> Baud {
        self.facts().usual_baud
    }

    /// About how many times as fast as a real board the virtual one is on a PC. Obtained with `run` of sweep.toml and pico.toml.
    #[must_use]
    pub const fn emulation_speed(self) -> f64 {
        self.facts().emulation_speed
    }

    /// Whether a motion is rehearsed on the virtual board before a real one gets it. An Uno needs it: its processor does everything, and its queues
    /// are short.
    #[must_use]
    pub const fn is_rehearsed(self) -> bool {
        self.facts().is_rehearsed
    }

    /// Whether it has a firmware image for each [`Role`], as an Uno; else its one image has all.
    #[must_use]
    pub const fn has_image_for_each_role(self) -> bool {
        self.facts().has_image_for_each_role
    }

    /// Whether a program that opens its port resets it, as an Uno's USB bridge does.
    #[must_use]
    pub const fn resets_when_opened(self) -> bool {
        self.facts().resets_when_opened
    }

    /// Whether its firmware makes edges by comparing with a timer, and so counts those that it missed.
    #[must_use]
    pub const fn counts_missed_compares(self) -> bool {
        self.facts().counts_missed_compares
    }

    /// The set-up of StepperWinch's axes x, y, z and a (docs/wiring.md). Pulses and times are those of the slowest drivers. No pull-in speed is
    /// known, so each motor that is stopped between two steps counts as uncertain.
    #[must_use]
    pub fn axes(self) -> Setup {
        let AxisWiring { pins, enable, pulse_ticks, setup_ticks } = self.facts().axes;
        let motor = |(step_pin, dir_pin)| MotorSetup {
            step_pin,
            dir_pin,
            forward_high: true,
            pull_in_ticks: u32::MAX,
            ..MotorSetup::default()
        };
        Setup {
            pulse_ticks,
            setup_ticks,
            hold_ticks: pulse_ticks,
            enable: Some((enable, false)),
            motors: pins.into_iter().map(motor).collect(),
            ..Setup::default()
        }
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

/// The kind of board, by its Info, in words for messages.
#[must_use]
pub fn name_of(info: &Info) -> &'static str {
    BoardKind::numbered(info.board).map_or("a model, no chip", BoardKind::full_name)
}
