//! `pulsetrain verbs`: moves motors by verbs, sent in frames. Its lines are those that a Pico takes as text.

use crate::arguments;
use clap::{ArgGroup, Args};
use pulsetrain_board::BoardKind;
use pulsetrain_board::registry::Role;
use std::ops::Range;
use std::path::Path;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, TryRecvError};

use miette::{LabeledSpan, MietteDiagnostic, NamedSource, Report, miette};
use pulsetrain_board::remote::{image_name, in_words};
use pulsetrain_board::{Board, Edge, Port, Remote, RemoteError, Serial, Setup};
use pulsetrain_core::verbs::{Heading, Verb};
use pulsetrain_core::winch::AXES;
use pulsetrain_core::winch::verb_lines::{self as text, LONGEST, LineOrders, VerbLine, VerbReply};
use pulsetrain_core::wire::message::{Cause, MotorSetup, Reason, image};
use pulsetrain_core::wire::orders::Obeyed;
use pulsetrain_core::wire::{Baud, Refusal};
use pulsetrain_motion::quantity::{Base, Quantity};

use super::info::UNO;
use super::on_port::waits_with_notice;
use super::problems::{drive_problem, port_problem};
use super::winch::typed;
use crate::console::{self, Console, Exit};
use crate::winch::talk::meaning;
use crate::{interrupt, serve};
use pulsetrain_motion::human;
use pulsetrain_session::drive::{session_number, set_up};

/// A board whose motors are told directly.
#[derive(Args, Debug)]
#[command(after_help = "\
A script has a line for each order, with its time, \"1.5 s: move x 100\"; without one they are read from the standard input. Axes x, y, z and a \
are where text has them (docs/wiring.md): on an Uno the CNC shield's, which needs its image with verbs. Each order is answered by the tick \
from which it holds, where its axes are then, and how many ticks later they step; each move by `done`. When no move is left it ends; what \
runs on is halted, and of a virtual board the steps at its pins are counted. Ctrl-C stops all at once. docs/pico.md has the verbs.

Examples:
  pulsetrain verbs moves.txt --board uno
  pulsetrain verbs --port /dev/ttyACM0
  echo \"move xy 2000 100\" | pulsetrain verbs --board pico")]
#[command(group = ArgGroup::new("told").args(["port", "board"]).required(true))]
pub(crate) struct VerbsArgs {
    /// Script of timed lines; without one they are read as they come
    pub(crate) script: Option<PathBuf>,
    /// The board at this serial port; opening it resets an Uno
    #[arg(long, value_name = "PORT")]
    pub(crate) port: Option<String>,
    /// A virtual one; `uno` has the image with verbs
    #[arg(long, value_name = "BOARD", value_parser = arguments::board_kind())]
    pub(crate) board: Option<BoardKind>,
    /// Rate of the line, bits a second
    #[arg(long, value_name = "RATE", default_value = "1000000", value_parser = arguments::baud)]
    pub(crate) baud: Baud,
}

/// The lines that the user may type.
const HELP: &str = "\
\x20 move <axes> <n>…            n steps, 0 to 2^32 - 1           run <axes>     steps without an end
  speed <axes> <ticks>…       from step to step                halt <axes>    forget move and run; `halt`: all axes
  dir <axes> <1, -1 or 0>…    forward, backward, stationary    help, quit     of this console
axes are letters of xyza, with a value for each or one for all: `move xy 100 200`, `speed xy 125000`; docs/pico.md has what they mean
";

/// The help below an error in a script's line.
const OF_SCRIPTS: &str = "a line is \"<time>: <verb>\", such as \"1.5 s: move x 100\"; docs/pico.md has the verbs";

/// How often a second lines and events are read.
const ROUNDS_PER_S: u64 = 100;

/// A script's line: its time, s, and its orders.
type Timed = (f64, LineOrders);

pub(crate) fn run(args: &VerbsArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    interrupt::watch();
    // The whole script is read, and perhaps refused, before anything moves.
    let script = args.script.as_deref().map(load).transpose()?;
    let virtual_board = || args.board.unwrap_or(BoardKind::Pico).virtual_board(Role::Verbs);
    match (&args.port, script) {
        (Some(name), script) => {
            let port = Serial::open(name, true).map_err(port_problem)?;
            run_on(port, name, args.baud, || lines(script), None, console)
        }
        (None, Some(script)) => {
            run_on(virtual_board(), "", args.baud, || lines(Some(script)), Some(Pins::default()), console)
        }
        (None, None) => {
            let board = serve::Paced::new(virtual_board());
            run_on(board, "", args.baud, || lines(None), Some(Pins::default()), console)
        }
    }
}

/// The source of the lines.
enum Lines {
    /// The rest of a script.
    Script(std::vec::IntoIter<Timed>),
    /// Lines from standard input: a user's or a program's.
    Typed(Receiver<String>),
}

fn lines(script: Option<Vec<Timed>>) -> Lines {
    script.map_or_else(|| Lines::Typed(typed()), |script| Lines::Script(script.into_iter()))
}

/// A line without its comment.
fn without_comment(line: &str) -> &str {
    line.split('#').next().unwrap_or_default().trim_end()
}

/// Reads a script.
fn load(path: &Path) -> miette::Result<Vec<Timed>> {
    let bytes = console::read(path)?;
    let name = path.display().to_string();
    let text = String::from_utf8(bytes).map_err(|_| miette!(help = OF_SCRIPTS, "{name} is no text"))?;
    let source = Arc::new(NamedSource::new(&name, text.clone()));
    let (mut lines, mut start) = (Vec::<Timed>::new(), 0);
    for raw in text.split_inclusive('\n') {
        let from = start;
        start += raw.len();
        let line = without_comment(raw);
        if line.is_empty() {
            continue;
        }
        let wrong = |at: Range<usize>, message: String| {
            let label = LabeledSpan::at(from + at.start..from + at.end, "here");
            let diagnostic = MietteDiagnostic::new(message).with_help(OF_SCRIPTS).with_label(label);
            Report::new(diagnostic).with_source_code(Arc::clone(&source))
        };
        let Some((when, told)) = line.split_once(':') else {
            return Err(wrong(0..line.len(), "a line without its time".to_owned()));
        };
        let time = Quantity::parse(when).ok().filter(|when| (when.base, when.per_seconds) == (Base::Time, 0));
        let Some(at_s) = time.map(|when| when.value).filter(|at| (0.0..1e6).contains(at)) else {
            return Err(wrong(0..when.len(), "not a time of 0 s to 10^6 s, with its unit".to_owned()));
        };
        if let Some((before, _)) = lines.last().filter(|(before, _)| at_s < *before) {
            let message = format!("times go back: the line before is told at {}", human::seconds(*before));
            return Err(wrong(0..when.len(), message));
        }
        let told_at = line.len() - told.trim_start().len();
        match text::read(told.trim().as_bytes()) {
            VerbLine::Orders(told) => lines.push((at_s, told)),
            VerbLine::Unknown => return Err(wrong(told_at..line.len(), "no such verb".to_owned())),
            VerbLine::Refused(what, word) => {
                let refusal = written(&VerbReply::Unread(what, word));
                let message = meaning(&refusal).unwrap_or(refusal);
                return Err(wrong(told_at..line.len(), message));
            }
        }
    }
    if lines.is_empty() {
        return Err(miette!(help = OF_SCRIPTS, "{name} has no line to tell"));
    }
    Ok(lines)
}

/// A reply in the text that a board would write.
fn written(reply: &VerbReply) -> String {
    let mut line = [0; LONGEST];
    let len = reply.write(&mut line);
    String::from_utf8_lossy(&line[..len]).trim_end().to_owned()
}

/// Axes x, y, z and a, on the same pins as StepperWinch's text (docs/wiring.md). Pulses and times are those of the
/// slowest drivers.
fn wiring(is_uno: bool) -> Setup {
    let (pins, enable) =
        if is_uno { ([(2, 5), (3, 6), (4, 7), (12, 13)], 8) } else { ([(2, 3), (4, 5), (6, 7), (8, 9)], 22) };
    // Pulse 1.94 µs on an Uno and 2 µs on a Pico; setup 5 µs.
    let (pulse_ticks, setup_ticks) = if is_uno { (31, 80) } else { (250, 625) };
    let motor = |(step_pin, dir_pin)| MotorSetup {
        step_pin,
        dir_pin,
        forward_high: true,
        // No pull-in speed is known, so each motor that is stopped between two steps counts as uncertain.
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

/// Steps that were counted on a virtual board's pins.
#[derive(Clone, Debug, Default)]
struct Pins {
    forward: [bool; AXES.len()],
    counts: [i64; AXES.len()],
}

impl Pins {
    fn see(&mut self, edge: Edge, setup: &Setup) {
        for (axis, motor) in setup.motors.iter().enumerate() {
            if edge.line == motor.dir_pin {
                self.forward[axis] = edge.level;
            } else if edge.line == motor.step_pin && edge.level {
                self.counts[axis] += if self.forward[axis] { 1 } else { -1 };
            }
        }
    }
}

/// The orders of an axis that are not done.
#[derive(Clone, Copy, Debug, Default)]
struct Axis {
    /// Number of moves that are not done.
    moves: u32,
    runs: bool,
    is_stationary: bool,
    /// Tick of the last halt. A `done` from before it is of a move that the halt has removed already.
    halted: u64,
}

impl Axis {
    /// The axis gets a verb, which holds from a tick on.
    fn hear(&mut self, verb: Verb, from: u64) {
        match verb {
            Verb::Move { .. } => (self.moves, self.runs) = (self.moves + 1, false),
            Verb::Run => self.runs = true,
            Verb::Halt => (self.moves, self.runs, self.halted) = (0, false, from),
            Verb::Heading(course) => self.is_stationary = course == Heading::Stationary,
            Verb::Speed { .. } => {}
        }
    }

    /// The board reports that a move was done at that tick.
    fn done(&mut self, tick: u64) {
        if tick >= self.halted {
            self.moves = self.moves.saturating_sub(1);
        }
    }
}

/// A board that this command moves by verbs.
struct VerbSession<P> {
    remote: Remote<P>,
    setup: Setup,
    axes: [Axis; AXES.len()],
    pins: Option<Pins>,
    refused: usize,
    /// When the board was last asked whether all axes rest, while moves are waited for, and its answer.
    last_look: Option<(u64, bool)>,
}

/// Connects to the board at a port, sets it up, and reads its axes. While the board still moves motors for an earlier
/// host, `goes_on` decides whether to wait on. If the board refuses, the connection is closed with Bye.
fn connect<P: Port>(
    port: P,
    baud: Baud,
    goes_on: impl FnMut() -> bool,
) -> Result<(Remote<P>, Setup, Obeyed), RemoteError> {
    let number = session_number();
    let remote = Remote::open(port, number)?;
    let (is_uno, image) = (remote.info().board == UNO, remote.info().image);
    if is_uno && image != image::VERBS {
        remote.close();
        return Err(RemoteError::OtherImage { is: image_name(image), wanted: image_name(image::VERBS) });
    }
    let setup = wiring(is_uno);
    let mut remote = set_up(remote, &setup, baud, number, goes_on)?;
    // A board without verbs refuses here, before anything else is sent.
    match remote.tell_motors(&[]) {
        Ok(first) => Ok((remote, setup, first)),
        Err(error) => {
            remote.close();
            Err(error)
        }
    }
}

/// Runs the command on a board. `name` is the port's name, empty for a virtual board. `lines` is called once the board
/// is connected, so that no line is read before.
fn run_on<P: Port>(
    port: P,
    name: &str,
    baud: Baud,
    lines: impl FnOnce() -> Lines,
    pins: Option<Pins>,
    console: &mut Console<'_>,
) -> miette::Result<Exit> {
    let (remote, setup, first) =
        connect(port, baud, waits_with_notice(console, name)).map_err(|error| drive_problem(error.into()))?;
    let mut lines = lines();
    let mut session = VerbSession { remote, setup, axes: Default::default(), pins, refused: 0, last_look: None };
    let tick_hz = u64::from(session.remote.info().tick_hz);
    let begin = session.remote.now();
    console.print(format_args!(
        "{} ticks a second; axes {}\n",
        human::count(tick_hz.into()),
        written(&VerbReply::At { obeyed: first, axes: ALL })
    ))?;
    let mut next: Option<Timed> = None;
    let mut has_ended = false;
    while !has_ended || session.waits() {
        if interrupt::wanted() {
            return session.stop(console);
        }
        let mut until = session.remote.now() + tick_hz / ROUNDS_PER_S;
        match &mut lines {
            Lines::Script(script) => {
                next = next.or_else(|| script.next());
                has_ended = next.is_none();
                if let Some((at_s, told)) = next {
                    let due = begin + (at_s * tick_hz as f64) as u64;
                    if session.remote.now() >= due {
                        next = None;
                        session.tell(&told, console)?;
                        continue;
                    }
                    until = until.min(due);
                }
            }
            Lines::Typed(typed) => match typed.try_recv() {
                Ok(_) if has_ended => {}
                Ok(line) => match without_comment(&line).trim_start() {
                    "" => {}
                    "help" | "?" => console.print(HELP)?,
                    "quit" | "exit" => has_ended = true,
                    line => {
                        session.read(line, console)?;
                        continue;
                    }
                },
                Err(TryRecvError::Empty) => {}
                Err(TryRecvError::Disconnected) => has_ended = true,
            },
        }
        session.go_on(until, console)?;
        if has_ended {
            session.look(console)?;
        }
    }
    session.finish(console)
}

/// A mask of all axes, as [`LineOrders::axes`] has it.
const ALL: u8 = 0b1111;

/// The letters of axes, one after the other.
fn names(is_one: impl Fn(usize) -> bool) -> String {
    let named = AXES.iter().enumerate().filter(|(axis, _)| is_one(*axis));
    named.map(|(_, name)| char::from(*name)).collect()
}

impl<P: Port> VerbSession<P> {
    /// Whether a move is still to be done. A stationary axis would never finish its move.
    fn waits(&self) -> bool {
        self.axes.iter().any(|axis| axis.moves > 0 && !axis.is_stationary)
    }

    /// Reads a line, and sends its orders.
    fn read(&mut self, line: &str, console: &mut Console<'_>) -> miette::Result<()> {
        match text::read(line.as_bytes()) {
            VerbLine::Orders(told) => self.tell(&told, console),
            VerbLine::Unknown => self.refuse("err command 1", console),
            VerbLine::Refused(what, word) => self.refuse(&written(&VerbReply::Unread(what, word)), console),
        }
    }

    fn refuse(&mut self, said: &str, console: &mut Console<'_>) -> miette::Result<()> {
        self.refused += 1;
        let means = meaning(said).map_or_else(String::new, |means| format!(": {means}"));
        console.print(format_args!("{said}{means}\n"))
    }

    fn tell(&mut self, told: &LineOrders, console: &mut Console<'_>) -> miette::Result<()> {
        let orders: Vec<(u8, Verb)> = told.orders().map(|orders| orders.iter().collect()).unwrap_or_default();
        match self.remote.tell_motors(&orders) {
            Ok(obeyed) => {
                // An answer that got lost is sent again. Its orders may be done, and their `done` received, before it
                // comes.
                for (axis, verb) in orders {
                    self.axes[usize::from(axis)].hear(verb, obeyed.tick);
                }
                self.events(console)?;
                console.print(format_args!("{}\n", written(&VerbReply::At { obeyed, axes: told.axes() })))
            }
            Err(RemoteError::Refused { reason: reason @ (Reason::Period | Reason::Busy), detail, .. }) => {
                self.refuse(&written(&VerbReply::Refused(Refusal { reason, detail })), console)
            }
            Err(error) => Err(drive_problem(error.into())),
        }
    }

    /// Lets time pass, and prints what the board reports.
    fn go_on(&mut self, until: u64, console: &mut Console<'_>) -> miette::Result<()> {
        let VerbSession { remote, setup, pins, .. } = self;
        remote.advance(until, &mut |edge: Edge| {
            if let Some(pins) = pins {
                pins.see(edge, setup);
            }
        });
        if let Some(error) = remote.error() {
            return Err(drive_problem(error.clone().into()));
        }
        self.events(console)
    }

    /// A `done` may get lost, so the board is asked once a second whether all axes rest. After two answers that they
    /// do, no move is left.
    fn look(&mut self, console: &mut Console<'_>) -> miette::Result<()> {
        let (now, tick_hz) = (self.remote.now(), u64::from(self.remote.info().tick_hz));
        let (at, rested) = *self.last_look.get_or_insert((now, false));
        if !self.waits() || now < at + tick_hz {
            return Ok(());
        }
        let rests = self.remote.status().map_err(|error| drive_problem(error.into()))?.is_idle();
        self.events(console)?;
        self.last_look = Some((now, rests));
        if rests && rested && self.waits() {
            let unheard = names(|axis| self.axes[axis].moves > 0);
            console.print(format_args!("all rest; a `done` got lost on the way, of {unheard}\n"))?;
            self.axes.iter_mut().for_each(|axis| axis.moves = 0);
        }
        Ok(())
    }

    fn events(&mut self, console: &mut Console<'_>) -> miette::Result<()> {
        for event in self.remote.events() {
            match event.cause {
                Cause::MoveDone => {
                    if let Some(axis) = self.axes.get_mut(usize::from(event.motor)) {
                        axis.done(event.tick);
                    }
                    let done = VerbReply::Done { axis: event.motor, tick: event.tick, number: event.detail };
                    console.print(format_args!("{}\n", written(&done)))?;
                }
                Cause::Finished => {}
                cause => {
                    let help = "`pulsetrain info --port PORT` tells where its motors are, and whose place is uncertain";
                    return Err(miette!(help = help, "the board stopped: {}", in_words(cause)));
                }
            }
        }
        Ok(())
    }

    /// Stops at once, for Ctrl-C: no further step is begun.
    fn stop(mut self, console: &mut Console<'_>) -> miette::Result<Exit> {
        let (stopped, positions) = self.remote.stop_motors().map_err(|error| drive_problem(error.into()))?;
        let counts: Vec<String> =
            AXES.iter().zip(&positions).map(|(axis, at)| format!("{} {at}", char::from(*axis))).collect();
        console.print(format_args!("stopped at once: {}\n", counts.join(", ")))?;
        if stopped.uncertain != 0 {
            let uncertain = names(|axis| stopped.uncertain >> axis & 1 == 1);
            console.print(format_args!("uncertain {uncertain}: they were stepping, and may stand elsewhere\n"))?;
        }
        self.remote.close();
        Ok(Exit::BoundBroken)
    }

    /// Ends the run: prints the positions, and for a virtual board whether its pins agree with them.
    fn finish(mut self, console: &mut Console<'_>) -> miette::Result<Exit> {
        let runs = names(|axis| self.axes[axis].runs);
        let waits = names(|axis| self.axes[axis].moves > 0);
        if !runs.is_empty() {
            // Bye would also stop them. A halt first makes their positions known.
            let orders: Vec<(u8, Verb)> =
                (0..).zip(&self.axes).filter(|(_, axis)| axis.runs).map(|(axis, _)| (axis, Verb::Halt)).collect();
            self.remote.tell_motors(&orders).map_err(|error| drive_problem(error.into()))?;
            console.print(format_args!("halted at the end, as they had none: {runs}\n"))?;
        }
        if !waits.is_empty() {
            console.print(format_args!("moves of stationary axes are forgotten: {waits}\n"))?;
        }
        // Wait for the last period of a halted axis, and for the end of pulses.
        let tick_hz = u64::from(self.remote.info().tick_hz);
        self.go_on(self.remote.now() + tick_hz / ROUNDS_PER_S, console)?;
        let obeyed = self.remote.tell_motors(&[]).map_err(|error| drive_problem(error.into()))?;
        console.print(format_args!("{}\n", written(&VerbReply::At { obeyed, axes: ALL })))?;
        self.go_on(obeyed.tick, console)?;
        let VerbSession { remote, pins, refused, .. } = self;
        remote.close();
        let Some(Pins { counts, .. }) = pins else {
            return Ok(if refused == 0 { Exit::Success } else { Exit::BoundBroken });
        };
        let off = names(|axis| counts.get(axis).copied() != obeyed.motors().get(axis).map(|next| next.position.into()));
        let counted: Vec<String> =
            AXES.iter().zip(counts).map(|(axis, count)| format!("{} {count}", char::from(*axis))).collect();
        let verdict = match off.as_str() {
            "" if refused == 0 => "PASS: as the board counts".to_owned(),
            "" => format!("FAIL: lines refused: {refused}; the pins are as the board counts"),
            off => format!("FAIL: the board counts others of {off}"),
        };
        console.print(format_args!("steps at the pins: {}\n{verdict}\n", counted.join(", ")))?;
        Ok(if refused == 0 && off.is_empty() { Exit::Success } else { Exit::BoundBroken })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pulsetrain_board::PortError;
    use pulsetrain_board::shared::Shared;
    use pulsetrain_board::virtual_pico::VirtualPico;
    use std::time::Duration;

    /// A board for several hosts in turn, whose answers are lost for a while. Its port is gone in the end.
    #[derive(Clone)]
    struct Deaf {
        board: Shared<VirtualPico>,
        hears_not: Range<Duration>,
        gone: Duration,
    }

    impl Deaf {
        fn new(hears_not: Range<Duration>, gone: Duration) -> Deaf {
            Deaf { board: Shared::new(VirtualPico::on_usb()), hears_not, gone }
        }
    }

    /// Runs lines on a board. Gives how that ended, and what was printed.
    fn held(port: Deaf, lines: Lines) -> (miette::Result<Exit>, String) {
        let (mut out, mut err) = (Vec::new(), Vec::new());
        let mut console = Console { out: &mut out, err: &mut err, err_is_terminal: false };
        let exit = run_on(port, "", Baud::B1M, || lines, None, &mut console);
        (exit, String::from_utf8(out).unwrap())
    }

    impl Port for Deaf {
        fn now(&self) -> Duration {
            self.board.now()
        }

        fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
            self.board.send(bytes)
        }

        fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
            if self.now() > self.gone {
                return Err(PortError::Gone { name: "the port".to_owned(), why: "it takes for ever".to_owned() });
            }
            let had = into.len();
            self.board.receive(until, into)?;
            if self.hears_not.contains(&self.now()) {
                into.truncate(had);
            }
            Ok(())
        }

        fn set_baud(&mut self, baud: Baud) -> Result<(), PortError> {
            self.board.set_baud(baud)
        }
    }

    /// If the script's file is missing, the help must not be about its lines.
    #[test]
    fn who_names_no_file_is_not_told_of_lines() {
        let error = load(Path::new("no such script.txt")).unwrap_err();
        assert!(error.to_string().starts_with("cannot read no such script.txt: "), "{error}");
        assert!(error.help().is_none_or(|help| !help.to_string().contains("line")));
    }

    /// If the pins miss an edge, the counts differ.
    #[test]
    fn pins_count_each_rise_of_step_the_way_that_dir_has() {
        let setup = wiring(true);
        let mut pins = Pins::default();
        let edge = |line, level| Edge { tick: 0, line, level };
        for (line, level) in
            [(5, true), (2, true), (2, false), (2, true), (2, false), (5, false), (2, true), (13, true), (12, true)]
        {
            pins.see(edge(line, level), &setup);
        }
        assert_eq!(pins.counts, [1, 0, 0, 1]);
    }

    #[test]
    fn what_an_axis_still_does_is_known() {
        let mut axis = Axis::default();
        for verb in [Verb::Move { steps: 1 }, Verb::Run] {
            axis.hear(verb, 10);
        }
        assert!(axis.moves == 1 && axis.runs);
        axis.hear(Verb::Move { steps: 5 }, 20);
        assert!(axis.moves == 2 && !axis.runs, "a move ends a run");
        axis.done(25);
        assert_eq!(axis.moves, 1);
        axis.hear(Verb::Heading(Heading::Stationary), 30);
        axis.hear(Verb::Halt, 30);
        assert!(axis.moves == 0 && axis.is_stationary);
        axis.hear(Verb::Move { steps: 5 }, 40);
        axis.done(29);
        assert_eq!(axis.moves, 1, "the one that was done is an earlier one, told late");
    }

    /// Tests that run firmware on an emulated chip.
    mod chips {
        use super::*;

        /// An earlier host's move goes on if the next host gives up waiting for it.
        #[test]
        fn a_board_that_still_moves_is_left_moving() {
            let port = Deaf::new(Duration::ZERO..Duration::ZERO, Duration::from_secs(9));
            let mut first = Remote::open(port.clone(), 1).unwrap();
            first.configure(&wiring(false)).unwrap();
            first.tell_motors(&[(0, Verb::Move { steps: 100_000 })]).unwrap();
            first.close();
            assert_eq!(connect(port.clone(), Baud::B1M, || false).err(), Some(RemoteError::StillMoving));
            // Longer than the silence after which a host counts as lost.
            let (mut idle, until) = (port.clone(), port.now() + Duration::from_secs(3));
            while idle.now() < until {
                idle.receive(until, &mut Vec::new()).unwrap();
            }
            assert!(!Remote::open(port, 3).unwrap().status().unwrap().is_idle());
        }

        /// Of a move that is done at once, either the answer is lost, so that it comes after the `done`, or the `done`
        /// is lost, which is sent only once. In both cases no move may be left to wait for.
        #[test]
        fn a_move_ends_whatever_gets_lost() {
            let mut seen = [0, 0];
            let VerbLine::Orders(told) = text::read(b"move x 0") else { panic!("a line") };
            for begin in (334_000..350_000).step_by(1000) {
                let begin = Duration::from_micros(begin);
                let port = Deaf::new(begin..begin + Duration::from_millis(6), Duration::from_secs(4));
                let (exit, said) = held(port, lines(Some(vec![(0.1, told)])));
                assert!(matches!(exit, Ok(Exit::Success)), "{begin:?}: {exit:?} {said}");
                let (at, done) = (said.rfind("\nat ").unwrap(), said.find("\ndone x "));
                assert_eq!(done.is_none(), said.contains("got lost on the way, of x\n"), "{begin:?}: {said}");
                let before = said[..at].rfind("\nat ");
                seen[0] += u32::from(done.zip(before).is_some_and(|(done, before)| done < before));
                seen[1] += u32::from(done.is_none());
            }
            assert!(seen.iter().all(|times| *times > 0), "{seen:?}");
        }

        #[test]
        fn typed_lines_may_have_comments_as_those_of_files() {
            let (typed, lines) = std::sync::mpsc::channel();
            for line in ["# a note", "  speed x 125000 # a kilohertz", "move x 3#and no more", "quit # it is done"] {
                typed.send(line.to_owned()).unwrap();
            }
            let port = Deaf::new(Duration::ZERO..Duration::ZERO, Duration::from_secs(4));
            let (exit, said) = held(port, Lines::Typed(lines));
            assert!(matches!(exit, Ok(Exit::Success)), "{exit:?} {said}");
            assert!(said.contains("\ndone x ") && said.trim_end().ends_with(" x 3 - y 0 - z 0 - a 0 -"), "{said}");
        }
    }
}
