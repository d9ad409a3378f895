//! What a host needs to know of a board to connect to it, to flash it and to emulate it: a folder for each board.
//!
//! Limits, pins and queues of all boards are in `pulsetrain_motion::boards`, under the same names. docs/adding-a-board.md says what a new board
//! needs.

mod pico;
mod uno;

pub use pico::PICO;
pub use uno::UNO;

use crate::{Setup, VirtualBoard};
use pulsetrain_core::winch::AXES;
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::{Info, MotorSetup};
use std::error::Error;
use std::{fmt, ptr};

/// All that connecting to a board depends on: its line, how it is flashed, its virtual board, its names in messages.
pub struct DeviceProfile {
    /// Its name in motion files and commands.
    pub name: &'static str,
    /// Its name in sentences: "Uno".
    pub title: &'static str,
    /// The same with its article: "an Uno".
    pub title_with_article: &'static str,
    /// Its maker's name for it, with its article: "an Arduino Uno".
    pub full_name: &'static str,
    /// Its chip.
    pub chip: &'static str,
    /// What to say if another chip was found where its firmware was to be written.
    pub other_chip_help: &'static str,
    /// The board's number in Info (docs/protocol.md); 0 is no board's.
    pub number: u8,

    /// The default rate of its line.
    pub usual_baud: Baud,
    /// Whether a program that opens its port resets it, as an Uno's USB bridge does.
    pub resets_when_opened: bool,
    /// How much longer a board at full load takes for each byte of a plan, µs.
    pub hearing_byte_us: u64,

    /// How its flash is written.
    pub flashing: Flashing,
    /// Whether it has a firmware image for each [`Role`]; else its one image has all.
    pub has_image_for_each_role: bool,
    /// The committed firmware for a role, in the form that programs the board.
    pub image: fn(Role) -> Vec<u8>,
    /// Its emulated chip. `None`: the board can only be connected.
    pub emulation: Option<Emulation>,

    /// Whether a motion is rehearsed on the virtual board before a real one gets it.
    pub is_rehearsed: bool,
    /// Whether its firmware makes edges by comparing with a timer, and so counts those that it missed.
    pub counts_missed_compares: bool,
    /// Half strokes of the sinusoids of `pulsetrain bench`, steps: as fast as the board can well do.
    pub bench_steps: f64,
    /// Where text and verbs have the axes x, y, z and a.
    pub axes: AxisWiring,
    /// Pin of IN1 of axis x where axes are coils, four pins each; `None` if the board drives no coils.
    pub first_coil_pin: Option<u8>,
}

/// How a board's flash is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flashing {
    /// By a bootloader at its serial port ([`stk500`](crate::stk500)); images are Intel HEX.
    Stk500,
    /// By copying a UF2 file to a drive, as which the chip shows up.
    Uf2 {
        /// The chip's family number in UF2 files (github.com/microsoft/uf2, families).
        family: u32,
        /// What the drive calls itself in INFO_UF2.TXT (Board-ID).
        drive: &'static str,
    },
}

/// A board's emulated chip.
#[derive(Clone, Copy)]
pub struct Emulation {
    /// About how many times as fast as a real board it is on a PC.
    pub speed: f64,
    /// The virtual board with the committed firmware for a role, just plugged in and with its port open.
    pub board: fn(Role) -> Box<dyn VirtualBoard>,
    /// The virtual board with any program, as `pulsetrain flash` would write it: the flash from its beginning on, or a UF2 file.
    pub with_program: FromProgram,
    /// The virtual board with nothing in its flash but a bootloader; `None` if the bootloader is the chip's own.
    pub with_bootloader: Option<FromProgram>,
}

/// Makes a virtual board of the bytes of a program.
pub type FromProgram = fn(&[u8]) -> Result<Box<dyn VirtualBoard>, NoProgram>;

/// Why a virtual board cannot run a program.
pub type NoProgram = Box<dyn Error + Send + Sync>;

/// Where a board has StepperWinch's axes x, y, z and a (docs/wiring.md), and their pulses.
#[derive(Clone, Copy, Debug)]
pub struct AxisWiring {
    /// STEP and DIR of each.
    pub pins: [(u8, u8); AXES.len()],
    /// Their common enable line; low is on.
    pub enable: u8,
    /// Pulses, ticks.
    pub pulse_ticks: u16,
    /// DIR set-up, ticks.
    pub setup_ticks: u16,
    /// Edge tick − scheduled tick of a STEP edge on these pins that is not late.
    pub edge_delay_ticks: u32,
}

/// A board that this project has a firmware for, or one with a profile of a program's own ([`BoardKind::of`]).
///
/// ```
/// use pulsetrain_board::{BoardKind, profiles::Role};
/// let kind = BoardKind::named("pico").unwrap();
/// assert_eq!((kind.title(), kind.usual_baud().rate()), ("Pico", 2_000_000));
/// // The real firmware on an emulated chip.
/// assert!(kind.virtual_board(Role::Plans).unwrap().zero().is_some());
/// assert_eq!(BoardKind::named("due"), None);
/// ```
#[derive(Clone, Copy)]
pub struct BoardKind(&'static DeviceProfile);

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

impl BoardKind {
    /// This project's boards, the most common one first.
    pub const ALL: [BoardKind; 2] = [BoardKind::of(&UNO), BoardKind::of(&PICO)];

    /// The board with a profile.
    #[must_use]
    pub const fn of(profile: &'static DeviceProfile) -> BoardKind {
        BoardKind(profile)
    }

    /// Its profile.
    #[must_use]
    pub const fn profile(self) -> &'static DeviceProfile {
        self.0
    }

    /// The names of this project's boards in motion files and commands.
    pub fn names() -> impl Iterator<Item = &'static str> {
        BoardKind::ALL.into_iter().map(BoardKind::name)
    }

    /// The board of a name in motion files; `None` where there is no firmware for it.
    #[must_use]
    pub fn named(name: &str) -> Option<BoardKind> {
        BoardKind::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// As [`named`](BoardKind::named), if the board has an emulated chip.
    #[must_use]
    pub fn emulated(name: &str) -> Option<BoardKind> {
        BoardKind::named(name).filter(|kind| kind.profile().emulation.is_some())
    }

    /// The board of a [number](BoardKind::number) in Info; `None` for models, which are no boards.
    #[must_use]
    pub fn numbered(number: u8) -> Option<BoardKind> {
        BoardKind::ALL.into_iter().find(|kind| kind.number() == number)
    }

    /// Its name in motion files and commands.
    #[must_use]
    pub const fn name(self) -> &'static str {
        self.0.name
    }

    /// Its name in sentences.
    #[must_use]
    pub const fn title(self) -> &'static str {
        self.0.title
    }

    /// Its maker's name for it, with its article: "an Arduino Uno".
    #[must_use]
    pub const fn full_name(self) -> &'static str {
        self.0.full_name
    }

    /// The board's number in Info (docs/protocol.md).
    #[must_use]
    pub const fn number(self) -> u8 {
        self.0.number
    }

    /// The default rate of its line.
    #[must_use]
    pub const fn usual_baud(self) -> Baud {
        self.0.usual_baud
    }

    /// Whether a motion is rehearsed on the virtual board before a real one gets it.
    #[must_use]
    pub const fn is_rehearsed(self) -> bool {
        self.0.is_rehearsed
    }

    /// Whether it has a firmware image for each [`Role`], as an Uno; else its one image has all.
    #[must_use]
    pub const fn has_image_for_each_role(self) -> bool {
        self.0.has_image_for_each_role
    }

    /// Whether a program that opens its port resets it, as an Uno's USB bridge does.
    #[must_use]
    pub const fn resets_when_opened(self) -> bool {
        self.0.resets_when_opened
    }

    /// Whether its firmware makes edges by comparing with a timer, and so counts those that it missed.
    #[must_use]
    pub const fn counts_missed_compares(self) -> bool {
        self.0.counts_missed_compares
    }

    /// The set-up of StepperWinch's axes x, y, z and a (docs/wiring.md). Pulses and times are those of the slowest drivers. No pull-in speed is
    /// known, so each motor that is stopped between two steps counts as uncertain.
    #[must_use]
    pub fn axes(self) -> Setup {
        let AxisWiring { pins, enable, pulse_ticks, setup_ticks, .. } = self.0.axes;
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
        (self.0.image)(role)
    }

    /// The virtual board with the committed firmware for a role, just plugged in and with its port open. A Pico's port is its own USB, or its UART for
    /// [`Role::Winch`]. `None` if the board has no emulated chip.
    #[must_use]
    pub fn virtual_board(self, role: Role) -> Option<Box<dyn VirtualBoard>> {
        self.0.emulation.map(|emulation| (emulation.board)(role))
    }
}

/// The most common board.
impl Default for BoardKind {
    fn default() -> BoardKind {
        BoardKind::ALL[0]
    }
}

/// A profile stands for one board: its address tells it from others.
impl PartialEq for BoardKind {
    fn eq(&self, other: &BoardKind) -> bool {
        ptr::eq(self.0, other.0)
    }
}

impl Eq for BoardKind {}

impl fmt::Debug for BoardKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "BoardKind({:?})", self.0.name)
    }
}

/// The kind of board, by its Info, in words for messages.
#[must_use]
pub fn name_of(info: &Info) -> &'static str {
    BoardKind::numbered(info.board).map_or("a model, no chip", BoardKind::full_name)
}
