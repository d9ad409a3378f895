//! The command line: what can be said, and who does it.

use std::ffi::OsString;
use std::io::Write;
use std::net::SocketAddr;
use std::path::PathBuf;

use clap::{ArgGroup, Args, Parser, Subcommand, ValueEnum};
use miette::{GraphicalReportHandler, GraphicalTheme, JSONReportHandler};
use pulsetrain_core::wire::Baud;
use pulsetrain_motion::quantity::{Base, Quantity};
use pulsetrain_motion::{Time, boards, full_steps};

use crate::commands::{self, RunStopped};
use crate::consent::{self, Consent, LongMotion};
use crate::console::{Console, Exit};
use crate::diagnostic::advised;
use crate::load;
use pulsetrain_session::estimate::{Estimate, Task};
use pulsetrain_session::prepare::{Prepared, WORST_CLOCK_PPM};

const EXIT_CODES: &str = "\
Exit codes:
  0  all is well
  1  a bound broke: the verdict on a run or on a capture
  2  wrong usage, wrong input, a motion that is refused, or a file that cannot be written
     (explain tells of a refused motion, and ends with 0)
  3  the motors stopped before the motion's end, though nobody asked for it";

const EXAMPLES: &str = "\
Examples:
  pulsetrain new crank                       write crank.toml, a motion file with comments
  pulsetrain run crank.toml                  plan it, run it, judge it, draw it: out/crank
  pulsetrain plan crank.toml --board uno     what it needs on an Uno; nothing runs
  pulsetrain explain crank.toml              why it is refused, and what would fit
  pulsetrain verify capture.vcd crank.toml   judge a logic analyser's capture";

/// Drives stepper motors along any motion law, exactly
#[derive(Debug, Parser)]
#[command(name = "pulsetrain", version, term_width = 100, after_help = format!("{EXAMPLES}\n\n{EXIT_CODES}"))]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Plan a motion, run it in virtual time, judge every edge, and write report, steps, trace and plot
    #[command(after_help = "\
Motions for the boards `uno` and `pico` run on a virtual one, the real firmware on an emulated chip;
others on the native board, this computer's own stepgen.

What an Uno at a port is to run is rehearsed before: the virtual one plays it, several times as fast, with each edge held against the law. What it \
does not keep up with is refused, and nothing moves. A Pico's queues are far larger, and nothing is rehearsed for one.

Files written to DIR:
  report.json  what was planned, proven, run and judged
  steps.csv    motor,tick,dir,position
  trace.vcd    every edge of every line
  plot.svg     position, intervals, speed and errors

Examples:
  pulsetrain run examples/tutorial.toml
  pulsetrain run examples/sweep.toml --for \"60 s\" --out out/minute
  pulsetrain run examples/sweep.toml --pause-at \"2 s\" --resume-at \"3 s\"
  pulsetrain run examples/tutorial.toml --native
  pulsetrain run examples/formula.toml --port /dev/ttyACM0")]
    Run(Run),
    /// Plan a motion and prove it: steps, segments, bytes, certificate, peak rates; nothing runs
    #[command(after_help = "\
Examples:
  pulsetrain plan examples/tutorial.toml
  pulsetrain plan examples/tutorial.toml --board uno --json")]
    Plan(Plan),
    /// Draw a motion: position wanted and stepped, interval against step number, speed, error
    #[command(after_help = "\
Examples:
  pulsetrain plot examples/tutorial.toml
  pulsetrain plot examples/tutorial.toml --out tutorial.png")]
    Plot(Plot),
    /// Judge a capture against the motion: VCD, CSV of Saleae's or PulseView's, steps.csv, or a camera track (CSV of time and angle)
    #[command(after_help = "\
Examples:
  pulsetrain verify out/tutorial/trace.vcd examples/tutorial.toml --pins
  pulsetrain verify capture.csv examples/tutorial.toml --pins --align start+rate
  pulsetrain verify capture.csv examples/tutorial.toml --align start \\
      --line \"Channel 0=wheel.step\" --line \"Channel 1=wheel.dir\"")]
    Verify(Verify),
    /// Tell why a motion is refused: the limit, the place, the curve there, and what would fit
    #[command(after_help = "\
Examples:
  pulsetrain explain examples/tutorial-0.01s.toml
  pulsetrain explain examples/tutorial.toml --board uno")]
    Explain(Explain),
    /// Tell how fast a motor's winding lets it step, each figure with its formula and source
    #[command(after_help = "\
Examples:
  pulsetrain motor --inductance 50mH --current 0.135A --voltage 12V --steps-per-rev 200 --microsteps 8
  pulsetrain motor --file examples/max-speed.toml")]
    Motor(Motor),
    /// Be a virtual board in real time, for this program or any other serial client; Ctrl-C ends it
    #[command(after_help = "\
`uno`, `pico`: the firmware runs on an emulated chip behind a model of the Uno's USB bridge, or by the Pico's own USB. A client \
that opens the port resets an Uno, as a real one. Over --pty it follows the rate that the client sets; over --tcp the line stays \
at 115200 baud. Both speak StepperWinch's text too. `winch`: that text on this computer's own path \
generator, without a chip; it takes next to nothing.

Examples:
  pulsetrain board uno --pty /tmp/uno               then: pulsetrain run FILE --port /tmp/uno
  pulsetrain board pico --pty /tmp/pico             then: pulsetrain run FILE --board pico --port /tmp/pico
  pulsetrain board uno --tcp 127.0.0.1:4000 --trace pins.vcd
  pulsetrain board winch --pty /tmp/winch           then: pulsetrain winch --port /tmp/winch
  pulsetrain board uno --image sweep.hex --trace pins.vcd         a baked motion, or a sketch
  pulsetrain board pico --pty /tmp/pico --image motion.uf2 --trace pins.vcd
  pulsetrain board uno --pty /tmp/uno --bootloader optiboot.hex
                                                    then: pulsetrain flash uno --port /tmp/uno")]
    Board(Board),
    /// Write the firmware to a board, and to an Uno read it back; nothing else has to be installed
    #[command(after_help = "\
An Uno (or a Nano with its newer bootloader) is programmed through its bootloader, at 115200 baud, after a reset by DTR; the older \
bootloader of Nanos, at 57600 baud, is larger and leaves the firmware no room. A Pico is a drive as long as BOOTSEL is held while \
it is plugged in: the firmware is copied there, and that drive is found by itself, or named with --port.

Examples:
  pulsetrain ports                              which port it is
  pulsetrain flash uno --port /dev/ttyACM0
  pulsetrain flash pico
  pulsetrain flash pico --port /media/me/RPI-RP2")]
    Flash(Flash),
    /// List this computer's serial ports and waiting Picos, with what is there
    #[command(after_help = "\
Examples:
  pulsetrain ports
  pulsetrain ports --ask       open each, and ask whether Pulsetrain's firmware is there; that resets an Uno")]
    Ports(Ports),
    /// Put a motion onto a board for good: it runs at power-up, without this computer
    #[command(after_help = "\
For an Arduino Uno and a Raspberry Pi Pico. An image is the firmware itself, which plays the motion from its flash, as exact and as fast as what a host sends (on a Pico nearly \
so, on drivers and on coils). Endless motions that repeat keep their phase for ever: each turn begins at its own exact time, to 2^-48 of a tick on an Uno, 2^-64 on a Pico. A sketch is plain \
C++ with tables in flash, for the Arduino IDE, without a library: slower, and motors wait for one another. It takes the Uno's Timer1, and stops millis() and delay().

An Uno's image is rehearsed before it is written: the virtual Uno plays it, and each edge of its pins is held against the law. What the board does not keep up with is refused.

Examples:
  pulsetrain bake examples/sweep.toml --output sweep.hex          four motors, for ever
  pulsetrain flash uno --port /dev/ttyACM0 --image sweep.hex      onto the Uno; `flash uno` alone brings the firmware back
  pulsetrain bake examples/pico.toml --output motion.uf2          for a Pico
  pulsetrain flash pico --image motion.uf2
  pulsetrain bake examples/tutorial.toml --sketch tutorial        writes tutorial/tutorial.ino")]
    Bake(Bake),
    /// Compare a board's clock with this computer's; `run --clock-ppm` then corrects for it
    #[command(after_help = "\
An Uno has a ceramic resonator, off by up to 0.5 %, which moves with temperature; a Pico a crystal, off by 50 ppm or less.

Examples:
  pulsetrain calibrate --port /dev/ttyACM0
  pulsetrain calibrate --port /dev/ttyACM0 --for \"10 min\"
  pulsetrain run examples/tutorial.toml --port /dev/ttyACM0 --clock-ppm=-1250")]
    Calibrate(Calibrate),
    /// Talk to a board in StepperWinch's text: a console, or a script of timed lines that is judged
    #[command(after_help = "\
A script has a line for each command, with its time, \"1.5 s: a x 100\"; or it is a motion file with law.winch. On a \
virtual board every edge is judged against the path; of a real one its status lines are all that is known. Without a \
script it is a console: in a terminal with the axes' positions, else line by line. docs/winch.md has the commands.

Files written to DIR by a script:
  report.json   what was sent and judged
  plot.svg      position, intervals, speed, and how far steps are from the path
  statuses.csv  what the board said of its axes
  steps.csv, trace.vcd   every step and every edge, of virtual boards

Examples:
  pulsetrain winch examples/winch.toml --board uno
  pulsetrain winch examples/winch.toml --board pico
  pulsetrain winch script.txt --native --out out/script
  pulsetrain winch --port /dev/ttyACM0
  echo \"a x 200\" | pulsetrain winch --native
  echo \"move x 2000\" | pulsetrain winch --board pico     MOVE, SPEED, DIRECTION: docs/pico.md")]
    Winch(Winch),
    /// Tell motors directly, in frames: MOVE, RUN, SPEED, DIRECTION, HALT, from a script or by hand
    #[command(after_help = "\
A script has a line for each order, with its time, \"1.5 s: move x 100\"; without one they are read from the standard input. Axes x, y, z and a \
are where text has them (docs/wiring.md): on an Uno the CNC shield's, which needs its image with verbs. Each order is answered by the tick \
from which it holds, where its axes are then, and how many ticks later they step; each move by `done`. When no move is left it ends; what \
runs on is halted, and of a virtual board the steps at its pins are counted. Ctrl-C stops all at once. docs/pico.md has the verbs.

Examples:
  pulsetrain verbs moves.txt --board uno
  pulsetrain verbs --port /dev/ttyACM0
  echo \"move xy 2000 100\" | pulsetrain verbs --board pico")]
    Verbs(Verbs),
    /// Tell what a board is: firmware, limits, clock, why it stopped last, how it fared
    #[command(after_help = "\
Examples:
  pulsetrain info --port /dev/ttyACM0
  pulsetrain info --board pico")]
    Info(At),
    /// Stop a board's motors at once, without ramps, whoever told them to move
    #[command(after_help = "\
For a board that still does what a host told it that has left, as a MOVE of hours or a baked motion. Axes that text has on paths brake \
within their limits; the drivers of text's axes are off then. Opening its port resets an Uno, which stops it, too. It tells where all \
motors are, and which were faster than they can stop, or may have been: those may stand elsewhere than they count.

Examples:
  pulsetrain stop --port /dev/ttyACM0")]
    Stop(Stop),
    /// Have a board keep settings without power, or tell those that it keeps
    #[command(after_help = "\
What is not said stays as it was. Settings hold where nobody says otherwise: those of text from its next start on, `silence` from the next configuration on.

Examples:
  pulsetrain store --port /dev/ttyACM0
  pulsetrain store --port /dev/ttyACM0 --deadman 500ms --limits 3000 20000
  pulsetrain store --port /dev/ttyACM0 --clear")]
    Store(Store),
    /// Let a board measure itself while it steps: cycles for a step, lateness, how far ahead it was
    #[command(after_help = "\
Sinusoids of growing speed on pins 8 (STEP) and 9 (DIR). On a real board disconnect the drivers first.

Examples:
  pulsetrain bench --board uno
  pulsetrain bench --board pico
  pulsetrain bench --port /dev/ttyACM0 --disconnected")]
    Bench(Bench),
    /// List the boards with their limits
    Boards(Table),
    /// List the drivers with their timings, microsteps and settings, from their datasheets
    Drivers(Table),
    /// Write a motion file with comments, to start from
    #[command(after_help = "Example:\n  pulsetrain new crank      writes crank.toml")]
    New(New),
}

impl Command {
    /// The port of those that need one of an Uno's images.
    fn port(&self) -> Option<&str> {
        match self {
            Command::Run(args) => args.port.as_deref(),
            Command::Bench(args) => args.at.port.as_deref(),
            Command::Winch(args) => args.at.port.as_deref(),
            Command::Verbs(args) => args.port.as_deref(),
            _ => None,
        }
    }

    fn wants_json(&self) -> bool {
        match self {
            Command::Run(args) => args.json,
            Command::Plan(args) => args.json,
            Command::Verify(args) => args.json,
            Command::Explain(args) => args.json,
            Command::Motor(args) => args.json,
            Command::Boards(args) | Command::Drivers(args) => args.json,
            Command::Info(args) => args.json,
            Command::Stop(args) => args.json,
            Command::Store(args) => args.json,
            Command::Bench(args) => args.at.json,
            Command::Winch(args) => args.json,
            Command::Flash(args) => args.json,
            Command::Ports(args) => args.json,
            Command::Calibrate(args) => args.json,
            Command::Bake(args) => args.json,
            Command::Plot(_) | Command::New(_) | Command::Board(_) | Command::Verbs(_) => false,
        }
    }
}

/// A motion file, and how much of it.
#[derive(Args, Debug)]
pub(crate) struct Motion {
    /// Motion file (TOML)
    pub(crate) file: PathBuf,
    /// Hold the motion against this board's limits instead of the file's
    #[arg(long, value_name = "BOARD", value_parser = board)]
    pub(crate) board: Option<String>,
    /// How much of an endless motion, with its unit; the planned stop comes after [default: "10 s"]
    #[arg(long = "for", value_name = "TIME", value_parser = duration, allow_hyphen_values = true)]
    pub(crate) length: Option<Time>,
    /// Go on with a motion that takes long to plan or to run, or makes large files, without being asked
    #[arg(long)]
    pub(crate) yes: bool,
}

impl Motion {
    /// The motion, `self.length` of it, if it is of usual length or meant to be long. Nobody is asked about one that is refused at once.
    pub(crate) fn prepare(&self, task: Task, json: bool, console: &mut Console<'_>) -> miette::Result<Prepared> {
        let prepared = load::endless(&self.file, self.board.as_deref())?;
        if !self.yes && Estimate::of(&prepared, self.length, task).is_much() {
            prepared.begins().map_err(advised)?;
        }
        self.agreed(prepared, task, json, console)
    }

    /// The same of one that may be refused: what is wrong is what is to be shown.
    pub(crate) fn prepare_any(&self, task: Task, json: bool, console: &mut Console<'_>) -> miette::Result<Prepared> {
        self.agreed(load::endless(&self.file, self.board.as_deref())?, task, json, console)
    }

    fn agreed(
        &self,
        prepared: Prepared,
        task: Task,
        json: bool,
        console: &mut Console<'_>,
    ) -> miette::Result<Prepared> {
        consent::agree(&prepared, Consent { length: self.length, task, yes: self.yes, json }, console)?;
        prepared.ending(self.length).map_err(advised)
    }
}

#[derive(Args, Debug)]
pub(crate) struct Run {
    #[command(flatten)]
    pub(crate) motion: Motion,
    /// Where the files go [default: out/ and the file's name without .toml]
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
    /// Run it on this computer's own stepgen even if its board has a firmware, which would run it on an emulated chip
    #[arg(long, conflicts_with = "port")]
    pub(crate) native: bool,
    /// Let the board at this serial port run it, in real time; Ctrl-C stops the motors as planned, twice at once
    #[arg(long, value_name = "PORT")]
    pub(crate) port: Option<String>,
    /// Rate of the line to the board, once it is found [default: 1000000; 2000000 for a Pico, whose own USB has no rate]
    #[arg(long, value_name = "BAUD", value_parser = baud, conflicts_with = "native")]
    pub(crate) baud: Option<Baud>,
    /// How much faster than it should the board's clock runs, ppm, as `pulsetrain calibrate` tells: it is corrected for
    #[arg(long, value_name = "PPM", value_parser = clock_ppm, requires = "port", allow_hyphen_values = true)]
    pub(crate) clock_ppm: Option<f64>,
    /// Bring all motors to a halt on their paths from this time on, as soon as their limits allow
    #[arg(long, value_name = "TIME", value_parser = duration, allow_hyphen_values = true)]
    pub(crate) pause_at: Option<Time>,
    /// Go on from the halt at this time of the run, or as soon as the motors rest
    #[arg(long, value_name = "TIME", value_parser = duration, allow_hyphen_values = true, requires = "pause_at")]
    pub(crate) resume_at: Option<Time>,
    /// How much of it the virtual Uno plays before an Uno at the port is sent anything [default: all, 10 s at most]
    #[arg(long, value_name = "TIME", value_parser = duration, allow_hyphen_values = true, requires = "port")]
    pub(crate) rehearse: Option<Time>,
    /// Begin at once, without that
    #[arg(long, conflicts_with = "rehearse", requires = "port")]
    pub(crate) no_rehearsal: bool,
    /// Print the report as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Args, Debug)]
pub(crate) struct Board {
    /// Which board
    #[arg(value_parser = ["uno", "pico", "winch"])]
    pub(crate) board: String,
    /// Make a pseudo-terminal, and a link of this name to it, which is gone in the end
    #[arg(long, value_name = "LINK", conflicts_with = "tcp")]
    pub(crate) pty: Option<PathBuf>,
    /// Listen at this address, for one client at a time
    #[arg(long, value_name = "ADDRESS")]
    pub(crate) tcp: Option<SocketAddr>,
    /// Write every edge of every pin there (VCD); its time is the chip's
    #[arg(long, value_name = "FILE")]
    pub(crate) trace: Option<PathBuf>,
    /// Only `uno`: a bootloader (Intel HEX), and a flash that is empty but for it, as of an Uno that was just bought
    #[arg(long, value_name = "FILE")]
    pub(crate) bootloader: Option<PathBuf>,
    /// Any program instead of the firmware, such as a baked motion, for `uno` as Intel HEX, for `pico` as UF2; with --trace it needs neither
    /// --pty nor --tcp. `uno`: `winch`, the firmware that knows StepperWinch's text, or `verbs`, that whose motors are told directly
    #[arg(long, value_name = "FILE")]
    pub(crate) image: Option<PathBuf>,
    /// End after so much of the board's time, with its unit, as Ctrl-C would
    #[arg(long = "for", value_name = "TIME", value_parser = duration, allow_hyphen_values = true)]
    pub(crate) length: Option<Time>,
    /// How much faster than it should the board's clock runs, ppm; an Uno's resonator may be off by 5000 either way
    #[arg(long, value_name = "PPM", default_value_t = 0, allow_hyphen_values = true,
          value_parser = clap::value_parser!(i32).range(-100_000..=100_000))]
    pub(crate) clock_ppm: i32,
}

#[derive(Args, Debug)]
#[command(group(clap::ArgGroup::new("to").required(true).args(["sketch", "output"])))]
pub(crate) struct Bake {
    /// Motion file (TOML)
    pub(crate) file: PathBuf,
    /// Write an Arduino sketch into this folder, which gives it its name
    #[arg(long, value_name = "DIR")]
    pub(crate) sketch: Option<PathBuf>,
    /// Write an image of the board's flash there: Intel HEX of an Uno's, UF2 of a Pico's
    #[arg(long, short, value_name = "FILE")]
    pub(crate) output: Option<PathBuf>,
    /// Hold the motion against this board's limits instead of the file's
    #[arg(long, value_name = "BOARD", value_parser = board)]
    pub(crate) board: Option<String>,
    /// How much of an endless motion, with its unit; the planned stop comes after [default: it never ends]
    #[arg(long = "for", value_name = "TIME", value_parser = duration, allow_hyphen_values = true)]
    pub(crate) length: Option<Time>,
    /// Go on with a motion that takes long to plan or to run, or makes large files, without being asked
    #[arg(long)]
    pub(crate) yes: bool,
    /// How much faster than it should the board's clock runs, ppm, as `pulsetrain calibrate` tells: it is corrected for
    #[arg(long, value_name = "PPM", value_parser = clock_ppm, allow_hyphen_values = true)]
    pub(crate) clock_ppm: Option<f64>,
    /// How much of it the virtual Uno plays before its image is written [default: all, 60 s at most; where motors repeat, until each
    /// phase that they have to one another was seen]
    #[arg(long, value_name = "TIME", value_parser = duration, allow_hyphen_values = true, conflicts_with = "sketch")]
    pub(crate) rehearse: Option<Time>,
    /// Write an Uno's image without that
    #[arg(long, conflicts_with_all = ["rehearse", "sketch"])]
    pub(crate) no_rehearsal: bool,
    /// Print what it comes to as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Args, Debug)]
pub(crate) struct Calibrate {
    /// The board at this serial port
    #[arg(long, value_name = "PORT")]
    pub(crate) port: String,
    /// How long its clock is watched: twice as long, twice as sure
    #[arg(long = "for", value_name = "TIME", value_parser = duration, allow_hyphen_values = true, default_value = "60 s")]
    pub(crate) length: Time,
    /// Print what was found as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Args, Debug)]
pub(crate) struct Flash {
    /// Which board
    #[arg(value_parser = ["uno", "pico"])]
    pub(crate) board: String,
    /// The Uno's serial port; the folder where the Pico's drive is [default for a Pico: the one that is found]
    #[arg(long, value_name = "PORT")]
    pub(crate) port: Option<String>,
    /// Write this image instead of the firmware: Intel HEX for an Uno, UF2 for a Pico; for an Uno `winch`: the firmware that knows
    /// StepperWinch's text, or `verbs`: that whose motors are told directly; both in place of plans
    #[arg(long, value_name = "FILE")]
    pub(crate) image: Option<PathBuf>,
    /// Print what was done as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Args, Debug)]
pub(crate) struct Ports {
    /// Open each port, and ask whether Pulsetrain's firmware is there. That resets an Uno
    #[arg(long)]
    pub(crate) ask: bool,
    /// Print the list as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

/// Which board is asked.
#[derive(Args, Debug)]
#[command(group = ArgGroup::new("asked").args(["port", "board"]).required(true))]
pub(crate) struct At {
    /// The board at this serial port
    #[arg(long, value_name = "PORT")]
    pub(crate) port: Option<String>,
    /// A virtual one
    #[arg(long, value_name = "BOARD", value_parser = ["uno", "pico"])]
    pub(crate) board: Option<String>,
    /// Rate of the line, once the board is found
    #[arg(long, value_name = "BAUD", value_parser = baud, default_value = "1000000")]
    pub(crate) baud: Baud,
    /// Print what it says as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

/// A board to be stopped.
#[derive(Args, Debug)]
pub(crate) struct Stop {
    /// The board at this serial port
    #[arg(long, value_name = "PORT")]
    pub(crate) port: String,
    /// Print what it says as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

/// What a board keeps.
#[derive(Args, Debug)]
#[command(group = ArgGroup::new("keeper").args(["port", "board"]).required(true))]
pub(crate) struct Store {
    /// The board at this serial port
    #[arg(long, value_name = "PORT")]
    pub(crate) port: Option<String>,
    /// A virtual one, which forgets it again
    #[arg(long, value_name = "BOARD", value_parser = ["uno", "pico"])]
    pub(crate) board: Option<String>,
    /// Text's axes stop when no command was obeyed for so long, or "off"
    #[arg(long, value_name = "TIME", value_parser = kept_time)]
    pub(crate) deadman: Option<u16>,
    /// Text releases the drivers when all axes have rested for so long, or "off"
    #[arg(long, value_name = "TIME", value_parser = kept_time)]
    pub(crate) idle: Option<u16>,
    /// A host that does not say otherwise is lost after so long a silence, or "off" for 2 s
    #[arg(long, value_name = "TIME", value_parser = kept_time)]
    pub(crate) silence: Option<u16>,
    /// Greatest speed, steps/s, and acceleration, steps/s², of text's axes at its start; 0 0: the board's own
    #[arg(long, value_names = ["SPEED", "ACCELERATION"], num_args = 2, allow_negative_numbers = true)]
    pub(crate) limits: Option<Vec<f64>>,
    /// Forget all that was kept before
    #[arg(long)]
    pub(crate) clear: bool,
    /// Print what it keeps as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Args, Debug)]
pub(crate) struct Bench {
    #[command(flatten)]
    pub(crate) at: At,
    /// Nothing is connected to pins 8 and 9 that may not move
    #[arg(long)]
    pub(crate) disconnected: bool,
}

#[derive(Args, Debug)]
pub(crate) struct Winch {
    /// Script of timed lines, or motion file (.toml) with law.winch; without one it is a console
    pub(crate) script: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) at: WinchAt,
    /// How long the script lasts [default: the motion's duration, or 4 s after its last line]
    #[arg(long = "for", value_name = "TIME", value_parser = duration, requires = "script", allow_hyphen_values = true)]
    pub(crate) length: Option<Time>,
    /// Where the files go [default: out/ and the script's name without its ending]
    #[arg(long, value_name = "DIR", requires = "script")]
    pub(crate) out: Option<PathBuf>,
    /// Print the report as JSON
    #[arg(long, requires = "script")]
    pub(crate) json: bool,
}

/// A board whose motors are told directly.
#[derive(Args, Debug)]
#[command(group = ArgGroup::new("told").args(["port", "board"]).required(true))]
pub(crate) struct Verbs {
    /// Script of timed lines; without one they are read as they come
    pub(crate) script: Option<PathBuf>,
    /// The board at this serial port; opening it resets an Uno
    #[arg(long, value_name = "PORT")]
    pub(crate) port: Option<String>,
    /// A virtual one; `uno` has the image with verbs
    #[arg(long, value_name = "BOARD", value_parser = ["uno", "pico"])]
    pub(crate) board: Option<String>,
    /// Rate of the line, bits a second
    #[arg(long, value_name = "RATE", default_value = "1000000", value_parser = baud)]
    pub(crate) baud: Baud,
}

/// Which board is talked to.
#[derive(Args, Debug)]
#[group(required = true, multiple = false)]
pub(crate) struct WinchAt {
    /// The board at this serial port; opening it resets an Uno
    #[arg(long, value_name = "PORT")]
    pub(crate) port: Option<String>,
    /// A virtual one
    #[arg(long, value_name = "BOARD", value_parser = ["uno", "pico"])]
    pub(crate) board: Option<String>,
    /// This computer's own path generator, without a chip
    #[arg(long)]
    pub(crate) native: bool,
}

#[derive(Args, Debug)]
pub(crate) struct Plan {
    #[command(flatten)]
    pub(crate) motion: Motion,
    /// Rate of the line that is to bring the plan to the board [default: 1000000; a Pico's own USB, which has no rate]
    #[arg(long, value_name = "BAUD", value_parser = baud)]
    pub(crate) baud: Option<Baud>,
    /// Print the report as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Args, Debug)]
pub(crate) struct Plot {
    #[command(flatten)]
    pub(crate) motion: Motion,
    /// Picture to write, .svg or .png [default: the file's name with .svg]
    #[arg(long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,
}

#[derive(Args, Debug)]
pub(crate) struct Verify {
    /// What was captured
    pub(crate) capture: PathBuf,
    #[command(flatten)]
    pub(crate) motion: Motion,
    /// The capture shows an Uno's pins: its constant and its lateness are allowed for
    #[arg(long)]
    pub(crate) pins: bool,
    /// What is fitted before judging
    #[arg(long, value_enum, default_value_t = Alignment::None)]
    pub(crate) align: Alignment,
    /// Judge up to this time of the motion alone: for captures that end before the motion does
    #[arg(long, value_name = "TIME", value_parser = duration, allow_hyphen_values = true, conflicts_with = "length")]
    pub(crate) until: Option<Time>,
    /// How often the analyser looked, e.g. "25 MHz": steps may be seen one sample late
    #[arg(long, value_name = "RATE", value_parser = frequency)]
    pub(crate) sample_rate: Option<f64>,
    /// Which line a channel of the capture is, e.g. "Channel 0=wheel.step"; once for each channel
    #[arg(long, value_name = "CHANNEL=LINE", value_parser = channel)]
    pub(crate) line: Vec<(String, String)>,
    /// Whose film it is, if the motion file has several motors
    #[arg(long, value_name = "MOTOR")]
    pub(crate) motor: Option<String>,
    /// Print the verdict as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Alignment {
    /// The capture's time zero is the motion's
    None,
    /// The capture began some time before
    Start,
    /// The same, and its clock runs at another rate, which is told in ppm
    #[value(name = "start+rate")]
    StartAndRate,
}

#[derive(Args, Debug)]
pub(crate) struct Explain {
    #[command(flatten)]
    pub(crate) motion: Motion,
    /// Rate of the line that is to bring the plan to the board [default: 1000000; a Pico's own USB, which has no rate]
    #[arg(long, value_name = "BAUD", value_parser = baud)]
    pub(crate) baud: Option<Baud>,
    /// Print the explanation as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Args, Debug)]
pub(crate) struct Motor {
    /// Take the motors of a motion file that have electrical data
    #[arg(long, value_name = "FILE", conflicts_with_all = ["inductance", "current", "voltage"])]
    pub(crate) file: Option<PathBuf>,
    /// Inductance of one winding, e.g. 50mH
    #[arg(long, value_name = "L", value_parser = inductance, required_unless_present = "file", allow_hyphen_values = true)]
    pub(crate) inductance: Option<f64>,
    /// Current of one winding as the driver is set, e.g. 0.135A
    #[arg(long, value_name = "I", value_parser = current, required_unless_present = "file", allow_hyphen_values = true)]
    pub(crate) current: Option<f64>,
    /// Supply of the driver, e.g. 12V
    #[arg(long, value_name = "V", value_parser = voltage, required_unless_present = "file", allow_hyphen_values = true)]
    pub(crate) voltage: Option<f64>,
    /// Full steps in one revolution
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = steps_per_rev)]
    pub(crate) steps_per_rev: u32,
    /// Steps that the driver makes of a full step
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=256))]
    pub(crate) microsteps: u32,
    /// Print the figures as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Args, Debug)]
pub(crate) struct Table {
    /// Print the table as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Args, Debug)]
pub(crate) struct New {
    /// Name of the motion; NAME.toml is written
    pub(crate) name: PathBuf,
}

fn board(name: &str) -> Result<String, String> {
    let names = boards::table().into_iter().map(|row| row.board.name);
    match (boards::find(name), boards::renamed(name)) {
        (Some(row), _) => Ok(row.board.name),
        (None, Some(board)) => Err(format!("say {board}: its firmware has these rates now")),
        (None, None) => Err(format!("no such board; there are {}", names.collect::<Vec<_>>().join(", "))),
    }
}

/// What a capture calls a line, and what it is: "Channel 0=wheel.step".
fn channel(text: &str) -> Result<(String, String), String> {
    match text.rsplit_once('=') {
        Some((from, to)) if !from.is_empty() && !to.is_empty() => Ok((from.to_owned(), to.to_owned())),
        _ => Err("write it like \"Channel 0=wheel.step\"".into()),
    }
}

/// A positive quantity of one kind.
fn positive(text: &str, base: Base, example: &str) -> Result<Quantity, String> {
    measured(text, (base, 0), example)
}

fn measured(text: &str, kind: (Base, u8), example: &str) -> Result<Quantity, String> {
    let quantity = Quantity::parse(text).map_err(|error| format!("{error}; write it like \"{example}\""))?;
    if (quantity.base, quantity.per_seconds) != kind {
        return Err(format!("this is {}; write it like \"{example}\"", quantity.kind()));
    }
    if quantity.value > 0.0 {
        Ok(quantity)
    } else {
        let what = if kind == (Base::Time, 0) { "a time above 0" } else { "more than 0" };
        Err(format!("it must be {what}; write it like \"{example}\""))
    }
}

/// Full steps in a revolution.
fn steps_per_rev(text: &str) -> Result<u32, String> {
    let number = text.parse::<f64>().map_err(|_| "write a whole number, like 200".to_owned())?;
    full_steps::checked(number).map_err(|error| format!("{error}; {}", error.advice()))
}

fn baud(text: &str) -> Result<Baud, String> {
    let rates = Baud::ALL.map(|baud| baud.rate().to_string());
    let found = Baud::ALL.into_iter().zip(&rates).find(|(_, rate)| *rate == text);
    found.map(|(baud, _)| baud).ok_or_else(|| format!("the rates are {}", rates.join(", ")))
}

fn clock_ppm(text: &str) -> Result<f64, String> {
    let ppm = text.parse::<f64>().map_err(|_| "write a number, like -1250".to_owned())?;
    if ppm.abs() <= WORST_CLOCK_PPM {
        Ok(ppm)
    } else {
        Err(format!("no board's clock is off by more than {WORST_CLOCK_PPM} ppm"))
    }
}

fn duration(text: &str) -> Result<Time, String> {
    let quantity = positive(text, Base::Time, "60 s")?;
    quantity.time().ok_or_else(|| "this is not a time".into())
}

/// A time that a board keeps, ms; 0 is off.
fn kept_time(text: &str) -> Result<u16, String> {
    if text == "off" {
        return Ok(0);
    }
    let ms = (duration(text)?.seconds() * 1000.0).round();
    if (1.0..=65_535.0).contains(&ms) { Ok(ms as u16) } else { Err("a board keeps 1 ms to 65.535 s, or off".into()) }
}

fn frequency(text: &str) -> Result<f64, String> {
    measured(text, (Base::Cycle, 1), "25 MHz").map(|quantity| quantity.value)
}

fn inductance(text: &str) -> Result<f64, String> {
    positive(text, Base::Inductance, "50mH").map(|quantity| quantity.value)
}

fn current(text: &str) -> Result<f64, String> {
    positive(text, Base::Current, "0.135A").map(|quantity| quantity.value)
}

fn voltage(text: &str) -> Result<f64, String> {
    positive(text, Base::Voltage, "12V").map(|quantity| quantity.value)
}

/// Runs a command as the process does, with its output going elsewhere: for tests and for other programs.
///
/// The first of `args` is the program's name.
///
/// ```
/// let (mut out, mut err) = (Vec::new(), Vec::new());
/// let exit = pulsetrain::cli::run(["pulsetrain", "boards"], &mut out, &mut err);
/// assert_eq!(exit, pulsetrain::console::Exit::Success);
/// assert!(String::from_utf8(out).unwrap().contains("Arduino Uno"));
/// ```
pub fn run<A: Into<OsString> + Clone>(
    args: impl IntoIterator<Item = A>,
    out: &mut dyn Write,
    err: &mut dyn Write,
) -> Exit {
    run_on(args, &mut Console { out, err, err_is_terminal: false })
}

/// The same on a console that may be a terminal.
pub fn run_on<A: Into<OsString> + Clone>(args: impl IntoIterator<Item = A>, console: &mut Console<'_>) -> Exit {
    let cli = match Cli::try_parse_from(args) {
        Ok(cli) => cli,
        Err(message) if message.use_stderr() => {
            complain(console, &message.render());
            return Exit::Refused;
        }
        Err(help) => {
            let printed = console.print(format_args!("{}\n", help.to_string().trim_end()));
            return finish(printed.map(|()| Exit::Success), false, console);
        }
    };
    let as_json = cli.command.wants_json();
    let mut outcome = obey(&cli.command, console);
    if let Err(refused) = &outcome
        && let Some(written) = commands::offered(refused, cli.command.port(), console)
    {
        outcome = written.and_then(|()| obey(&cli.command, console));
    }
    finish(outcome, as_json, console)
}

fn obey(command: &Command, console: &mut Console<'_>) -> miette::Result<Exit> {
    match command {
        Command::Run(args) => commands::run::run(args, console),
        Command::Plan(args) => commands::plan::run(args, console),
        Command::Plot(args) => commands::plot::run(args, console),
        Command::Verify(args) => commands::verify::run(args, console),
        Command::Explain(args) => commands::explain::run(args, console),
        Command::Motor(args) => commands::motor::run(args, console),
        Command::Board(args) => commands::board::run(args, console),
        Command::Info(args) => commands::info::run(args, console),
        Command::Stop(args) => commands::stop::run(args, console),
        Command::Store(args) => commands::store::run(args, console),
        Command::Bench(args) => commands::bench::run(args, console),
        Command::Winch(args) => commands::winch::run(args, console),
        Command::Verbs(args) => commands::verbs::run(args, console),
        Command::Flash(args) => commands::flash::run(args, console),
        Command::Ports(args) => commands::ports::run(args, console),
        Command::Calibrate(args) => commands::calibrate::run(args, console),
        Command::Bake(args) => commands::bake::run(args, console),
        Command::Boards(args) => commands::boards::run(args, console),
        Command::Drivers(args) => commands::drivers::run(args, console),
        Command::New(args) => commands::new::run(args, console),
    }
}

fn finish(outcome: miette::Result<Exit>, as_json: bool, console: &mut Console<'_>) -> Exit {
    outcome.unwrap_or_else(|report| {
        let mut text = String::new();
        let stopped = report.downcast_ref::<RunStopped>();
        // A script reads standard output; who broke the pipe does not want to hear of it.
        if let (true, Some(RunStopped { report, .. })) = (as_json, stopped) {
            let _ = console.print_json(report);
        } else if as_json && JSONReportHandler::new().render_report(&mut text, report.as_ref()).is_ok() {
            let _ = console.print(format_args!("{}\n", with_estimate(text, &report)));
        }
        let theme = if console.err_is_terminal { GraphicalTheme::unicode() } else { GraphicalTheme::unicode_nocolor() };
        let mut text = String::new();
        let handler = GraphicalReportHandler::new_themed(theme).with_width(100).with_links(false);
        if handler.render_report(&mut text, report.as_ref()).is_err() {
            text = format!("{report}\n");
        }
        // So it heads each problem behind the first: all are errors. No line of a file begins without a margin.
        complain(console, &text.replace("\nError: \n", "\n"));
        if stopped.is_some() { Exit::Stopped } else { Exit::Refused }
    })
}

/// A report in JSON; one of a long motion has its estimate in figures, too.
fn with_estimate(text: String, report: &miette::Report) -> String {
    let estimate = report.downcast_ref::<LongMotion>().and_then(|long| serde_json::to_value(long.estimate()).ok());
    match (serde_json::from_str::<serde_json::Value>(&text), estimate) {
        (Ok(serde_json::Value::Object(mut said)), Some(estimate)) => {
            said.insert("estimate".to_owned(), estimate);
            serde_json::Value::Object(said).to_string()
        }
        _ => text,
    }
}

/// When the errors' own stream is closed, only the exit code is left to say it.
fn complain(console: &mut Console<'_>, message: &dyn std::fmt::Display) {
    drop(write!(console.err, "{message}"));
}
