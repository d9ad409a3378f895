//! `pulsetrain board`: a virtual board in real time.

use crate::arguments;
use crate::files::{inputs, outputs};
use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use std::io::ErrorKind;
use std::net::SocketAddr;
use std::path::Path;
use std::path::PathBuf;
use std::time::Duration;

use miette::miette;
use pulsetrain_board::bridge::Bridge;
use pulsetrain_board::hex::{self, HexError};
use pulsetrain_board::native_winch::NativeWinch;
use pulsetrain_board::profiles::{DeviceProfile, Emulation, Flashing, Role};
use pulsetrain_board::skewed::Skewed;
use pulsetrain_board::stk500;
use pulsetrain_board::{BoardKind, VirtualBoard};
use pulsetrain_motion::Time;

use super::flash::named;
use super::problems::virtual_board;
use crate::console::{Console, Exit};
use crate::interrupt;
use crate::serve::{self, Client, Nobody, Service, Socket};
use pulsetrain_motion::human;

#[derive(Args, Debug)]
#[command(after_help = "\
`uno` and `pico` run the firmware on an emulated chip, behind a model of the Uno's USB bridge or by the Pico's own \
USB. A client that opens the port resets an Uno, as with a real one. With --pty the line has the rate that the client \
sets; with --tcp it stays at 115200 baud. `pico` also understands StepperWinch's text; `uno` does with --image winch, \
in place of plans.

`winch` answers StepperWinch's text with this computer's own path generator, without a chip. It needs hardly any \
processor time.

Examples:
  pulsetrain board uno --pty /tmp/uno               then: pulsetrain run FILE --port /tmp/uno
  pulsetrain board pico --pty /tmp/pico             then: pulsetrain run FILE --board pico --port /tmp/pico
  pulsetrain board uno --tcp 127.0.0.1:4000 --trace pins.vcd
  pulsetrain board winch --pty /tmp/winch           then: pulsetrain winch --port /tmp/winch
  pulsetrain board uno --image sweep.hex --trace pins.vcd         a baked motion, or a sketch
  pulsetrain board pico --pty /tmp/pico --image motion.uf2 --trace pins.vcd
  pulsetrain board uno --pty /tmp/uno --bootloader optiboot.hex
                                                    then: pulsetrain flash uno --port /tmp/uno")]
pub(crate) struct BoardArgs {
    /// Which board
    #[arg(value_parser = board_or_winch())]
    pub(crate) board: ServedBoard,
    /// Make a pseudo-terminal and a link of this name to it; the link is removed at the end
    #[arg(long, value_name = "LINK", conflicts_with = "tcp")]
    pub(crate) pty: Option<PathBuf>,
    /// Listen at this address, for one client at a time
    #[arg(long, value_name = "ADDRESS")]
    pub(crate) tcp: Option<SocketAddr>,
    /// Write every edge of every pin there (VCD); its time is the chip's
    #[arg(long, value_name = "FILE")]
    pub(crate) trace: Option<PathBuf>,
    /// Only `uno`: a bootloader (Intel HEX) in an otherwise empty flash, as in an Uno that was just bought
    #[arg(long, value_name = "FILE")]
    pub(crate) bootloader: Option<PathBuf>,
    /// Any program instead of the firmware, such as a baked motion, for `uno` as Intel HEX, for `pico` as UF2; with --trace it needs neither
    /// --pty nor --tcp. `uno`: `winch`, the firmware that knows StepperWinch's text, or `verbs`, the one that obeys MOVE, SPEED and DIRECTION
    #[arg(long, value_name = "FILE")]
    pub(crate) image: Option<PathBuf>,
    /// Only `uno` and `winch`: the chip between its serial line and USB. It holds back what the board says for up to 5 ms (`16u2`, an Arduino's
    /// own), 1 ms (`ch340`, the default) or 17 ms (`ftdi`)
    #[arg(long, value_name = "CHIP", value_parser = bridge())]
    pub(crate) bridge: Option<Bridge>,
    /// End after this much of the board's time, as with Ctrl-C
    #[arg(long = "for", value_name = "TIME", value_parser = arguments::duration, allow_hyphen_values = true)]
    pub(crate) length: Option<Time>,
    /// How much faster than it should the board's clock runs, ppm; an Uno's resonator may be off by 5000 either way
    #[arg(long, value_name = "PPM", default_value_t = 0, allow_hyphen_values = true,
          value_parser = clap::value_parser!(i32).range(-100_000..=100_000))]
    pub(crate) clock_ppm: i32,
}

/// What is served.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ServedBoard {
    /// A board's firmware, or another program, on an emulated chip.
    Chip(BoardKind),
    /// This computer's own path generator.
    Winch,
}

/// What the board without a chip is called.
const WINCH: &str = "winch";

fn board_or_winch() -> impl TypedValueParser<Value = ServedBoard> {
    let names = BoardKind::names().chain([WINCH]);
    PossibleValuesParser::new(names).map(|name| BoardKind::named(&name).map_or(ServedBoard::Winch, ServedBoard::Chip))
}

fn bridge() -> impl TypedValueParser<Value = Bridge> {
    let names = Bridge::ALL.map(|(name, _)| name);
    PossibleValuesParser::new(names).map(|name| Bridge::named(&name).unwrap_or_default())
}

pub(crate) fn run(args: &BoardArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    let takes_bootloader =
        |kind: BoardKind| kind.profile().emulation.is_some_and(|emulation| emulation.with_bootloader.is_some());
    if args.bootloader.is_some() && !matches!(args.board, ServedBoard::Chip(kind) if takes_bootloader(kind)) {
        let able = BoardKind::ALL.into_iter().filter(|kind| takes_bootloader(*kind));
        let able = able.map(|kind| format!("`{}`", kind.name())).collect::<Vec<_>>().join(" or ");
        return Err(miette!(help = "leave --bootloader out", "only {able} has a bootloader that can be given"));
    }
    if args.image.is_some() && args.board == ServedBoard::Winch {
        return Err(miette!(help = "leave --image out", "`winch` is no chip: it has no program that could be given"));
    }
    if args.image.is_some() && args.bootloader.is_some() {
        return Err(miette!(
            help = "leave one of them out",
            "a bootloader alone, and an image: one excludes the other"
        ));
    }
    interrupt::watch();
    match (&args.pty, args.tcp) {
        (Some(link), _) => on_pty(link, args, console),
        (None, Some(address)) => {
            let help = "choose another port number, or end the program that listens there";
            let socket =
                Socket::listen(address).map_err(|error| miette!(help = help, "cannot listen at {address}: {error}"))?;
            let address = socket.address().map_err(|error| miette!("{address}: {error}"))?;
            serve(socket, &format!("at {address}, 115 200 baud"), args, console)
        }
        (None, None) if args.image.is_some() && args.trace.is_some() => serve(Nobody, "by itself", args, console),
        (None, None) => {
            let help = "say --pty <LINK> or --tcp <ADDRESS>; a program (--image) that needs no host runs with --trace <FILE> alone";
            Err(miette!(help = help, "no way to reach the board was given"))
        }
    }
}

#[cfg(unix)]
fn on_pty(link: &Path, args: &BoardArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    let pty = serve::Pty::new(link).map_err(|error| match error.kind() {
        ErrorKind::AlreadyExists => {
            let help = "choose a name that is free; or remove it, if no virtual board is served there any more";
            miette!(help = help, "{} is there already", link.display())
        }
        _ => {
            let help = "LINK is a name that is free, in a folder where you may write";
            miette!(help = help, "cannot make the link {}: {error}", link.display())
        }
    })?;
    serve(pty, &format!("at {}", link.display()), args, console)
}

#[cfg(not(unix))]
fn on_pty(_: &Path, _: &BoardArgs, _: &mut Console<'_>) -> miette::Result<Exit> {
    Err(miette!(help = "use --tcp ADDRESS", "this system has no pseudo-terminals"))
}

fn serve<C: Client>(client: C, place: &str, args: &BoardArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    let kind = match args.board {
        ServedBoard::Winch => return serve_board(NativeWinch::new(), WINCH, client, place, args, console),
        ServedBoard::Chip(kind) => kind,
    };
    let board = match (&args.image, &args.bootloader) {
        (_, Some(bootloader)) => just_bought(kind, bootloader)?,
        (Some(file), None) => programmed(kind, file)?,
        (None, None) => virtual_board(kind, Role::Plans)?,
    };
    serve_board(board, kind.title(), client, place, args, console)
}

/// A board with that program, or with the firmware's image of that name.
fn programmed(kind: BoardKind, file: &Path) -> miette::Result<Box<dyn VirtualBoard>> {
    if let Some(role) = named(kind, file) {
        return virtual_board(kind, role);
    }
    let (program, help) = match kind.profile().flashing {
        Flashing::Uf2 { .. } => {
            let help = format!(
                "it takes what `cargo xtask uf2` and `pulsetrain bake` write for {}: docs/pico.md",
                kind.profile().title_with_article
            );
            (inputs::bytes(file, inputs::MAX_IMAGE_BYTES)?, help)
        }
        Flashing::Stk500 => {
            let help = format!(
                "it takes what {}'s flash holds, as Intel HEX: what `pulsetrain bake --output` writes, or the Arduino IDE's Export \
                 Compiled Binary; `winch` is the firmware that knows StepperWinch's text, `verbs` the one that obeys MOVE, SPEED and DIRECTION",
                kind.profile().title_with_article
            );
            let image = read_hex(kind, file, &help)?;
            if image.is_empty() {
                return Err(miette!(help = help, "{} holds no program: there is no byte in it", file.display()));
            }
            (image, help)
        }
    };
    let emulation = emulation(kind)?;
    (emulation.with_program)(&program).map_err(|error| miette!(help = help, "{}: {error}", file.display()))
}

/// Reads the contents of a board's flash from a file.
fn read_hex(kind: BoardKind, file: &Path, help: &str) -> miette::Result<Vec<u8>> {
    let text = String::from_utf8_lossy(&inputs::bytes(file, inputs::MAX_IMAGE_BYTES)?).into_owned();
    let DeviceProfile { chip, title_with_article, .. } = kind.profile();
    hex::parse(&text, stk500::FLASH_BYTES).map_err(|error| match error {
        HexError::Beyond { .. } => {
            miette!(help = help, "{} does not fit {title_with_article}: {error}", file.display())
        }
        error => miette!(help = help, "{} is no Intel HEX of an {chip}: {error}", file.display()),
    })
}

/// A board that has only a bootloader.
fn just_bought(kind: BoardKind, file: &Path) -> miette::Result<Box<dyn VirtualBoard>> {
    let help = "a bootloader of an Uno is at the end of its flash: Optiboot's 512 bytes from 0x7e00 on";
    let image = read_hex(kind, file, help)?;
    let with_bootloader = emulation(kind)?.with_bootloader;
    let board = with_bootloader.ok_or_else(|| miette!("the {} has its own bootloader", kind.title()))?(&image);
    board.map_err(|error| miette!(help = help, "{}: {error}", file.display()))
}

fn emulation(kind: BoardKind) -> miette::Result<Emulation> {
    kind.profile().emulation.ok_or_else(|| miette!("there is no virtual {}", kind.title()))
}

fn serve_board<B: VirtualBoard, C: Client>(
    mut board: B,
    name: &str,
    client: C,
    place: &str,
    args: &BoardArgs,
    console: &mut Console<'_>,
) -> miette::Result<Exit> {
    if args.bridge.is_some_and(|bridge| !board.set_bridge(bridge)) {
        return Err(miette!(help = "leave --bridge out", "the {name} has USB of its own: there is no chip between"));
    }
    let trace = args.trace.as_deref().map(|path| outputs::create_log(path, "--trace")).transpose()?;
    let broken = |error: std::io::Error| miette!("the virtual {name} cannot go on: {error}");
    let mut service = Service::new(Skewed::new(board, args.clock_ppm), client, trace).map_err(broken)?;
    console.print(format_args!("a virtual {name} is {place}; Ctrl-C ends it\n"))?;
    let most = args.length.map_or(f64::INFINITY, Time::seconds);
    let stop = |now: Duration| interrupt::wanted() || now.as_secs_f64() >= most;
    let lost = serve::in_real_time(&mut service, stop).map_err(broken)?;
    let (ran, clients) = (service.now().as_secs_f64(), service.clients());
    service.finish().map_err(broken)?;
    console.print(format_args!("{} on its clock; clients: {clients}\n", human::seconds(ran)))?;
    if !lost.is_zero() {
        console.print(format_args!("this computer was {} too slow for it\n", human::seconds(lost.as_secs_f64())))?;
    }
    Ok(Exit::Success)
}
