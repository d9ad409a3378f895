//! `pulsetrain verbs`: moves motors by verbs, sent in frames. Its lines are those that a Pico takes as text.

use crate::arguments;
use crate::files::inputs;
use clap::{ArgGroup, Args, ValueEnum};
use pulsetrain_board::BoardKind;
use pulsetrain_board::profiles::{Role, name_of};
use std::fmt::Display;
use std::io::{ErrorKind, IsTerminal, stdin, stdout};
use std::ops::Range;
use std::path::Path;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::channel;

use miette::{LabeledSpan, MietteDiagnostic, NamedSource, Report, miette};
use pulsetrain_board::remote::{image_name, in_words};
use pulsetrain_board::{Board, Edge, Port, Remote, RemoteError, Serial, Setup};
use pulsetrain_core::output::{HALF_STEPS, Sequence};
use pulsetrain_core::verbs::{Heading, Verb};
use pulsetrain_core::winch::AXES;
use pulsetrain_core::winch::verb_lines::{self as text, LONGEST, LineOrders, VerbLine, VerbReply};
use pulsetrain_core::wire::message::{Cause, MotorSetup, Reason, image};
use pulsetrain_core::wire::orders::Obeyed;
use pulsetrain_core::wire::{Baud, Refusal};
use pulsetrain_motion::program::PositionUnits;
use pulsetrain_motion::quantity::{Base, Quantity};
use pulsetrain_trace::winch::Status;

use super::on_port::waits_with_notice;
use super::problems::{drive_problem, port_problem, virtual_board};
use super::winch::typed;
use crate::console::{Console, Exit};
use crate::winch::console::{ConsoleError, ConsoleInput, Person, Plain};
use crate::winch::talk::{BoardLine, meaning};
use crate::winch::terminal::Terminal;
use crate::{interrupt, last_positions, load, serve};
use pulsetrain_motion::human;
use pulsetrain_session::drive::{session_number, set_up, setup};

/// A board whose motors get orders directly.
#[derive(Args, Debug)]
#[command(after_help = "\
A script has a line for each order, with its time: \"1.5 s: move x 100\". Without a script it is a console. In a \
terminal it shows the axes' positions and keeps a history; otherwise it reads lines from the standard input.

Each order is answered with the tick from which it holds, the axes' positions then, and the ticks to their next step. \
The line `done` comes at the end of each move. The program ends when no move is left; axes that still run are halted. On a virtual \
board the steps at its pins are counted. Ctrl-C stops all axes at once. docs/verbs.md has all orders.

The axes x, y, z and a have StepperWinch's pins (docs/wiring.md). On an Uno these are the CNC shield's, and the Uno \
needs its image `verbs`. With --coils the axes are ULN2003 boards of a Pico. With --motors they are the motors of a \
motion file, in its order.

Examples:
  pulsetrain verbs moves.txt --board uno
  pulsetrain verbs --port /dev/ttyACM0
  echo \"move xy 2000 100\" | pulsetrain verbs --board pico
  echo \"move x 2038\" | pulsetrain verbs --board pico --coils half
  echo \"speed x 30 rpm; move x 100\" | pulsetrain verbs --board pico --motors examples/first-pico.toml")]
#[command(group = ArgGroup::new("told").args(["port", "board"]).required(true))]
pub(crate) struct VerbsArgs {
    /// Script of timed lines; without one, lines are read as they are typed
    pub(crate) script: Option<PathBuf>,
    /// The board at this serial port; opening it resets an Uno
    #[arg(long, value_name = "PORT")]
    pub(crate) port: Option<String>,
    /// A virtual board; the `uno` has the image `verbs`
    #[arg(long, value_name = "BOARD", value_parser = arguments::board_kind())]
    pub(crate) board: Option<BoardKind>,
    /// Rate of the line, bits a second
    #[arg(long, value_name = "RATE", default_value = "1000000", value_parser = arguments::baud)]
    pub(crate) baud: Baud,
    /// The axes are four ULN2003 boards of a Pico, IN1 to IN4 on GP2 to GP5, GP6 to GP9, GP10 to GP13, GP14 to GP17, switched so
    #[arg(long, value_name = "SEQUENCE", value_enum, conflicts_with = "motors")]
    pub(crate) coils: Option<Coils>,
    /// The axes are the motors of this motion file, drivers or coils
    #[arg(long, value_name = "FILE")]
    pub(crate) motors: Option<PathBuf>,
    /// Steps in a turn of each axis, microsteps counted, for speeds in rpm, rev/s and deg/s [default: those of --motors]
    #[arg(long, value_name = "STEPS", value_parser = clap::value_parser!(u32).range(1..), conflicts_with = "motors")]
    pub(crate) steps_per_rev: Option<u32>,
}

/// How coils are switched.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Coils {
    /// One coil at a time
    Wave,
    /// Two coils at a time
    Full,
    /// One and two in turn
    Half,
}

/// The lines that the user may type.
const HELP: &str = "\
\x20 move <axes> <n>…            n steps, 0 to 2^32 - 1           run <axes>     steps without an end
  speed <axes> <speed>…       `500 steps/s`, `30 rpm`, or ticks from step to step
  dir <axes> <1, -1 or 0>…    forward, backward, stationary    halt <axes>    forget move and run; `halt`: all axes
  where                       where all axes are               help, quit     of this console
axes are letters of xyza, with a value for each or one for all: `move xy 100 200`; `;` parts two orders; docs/verbs.md has what they mean
";

/// The line that Ctrl-C stands for in a terminal.
const STOP: &str = "halt";

/// The help below an error in a script's line.
const OF_SCRIPTS: &str = "a line is \"<time>: <verb>\", such as \"1.5 s: move x 100\"; docs/verbs.md has the verbs";

/// How often a second lines and events are read.
const ROUNDS_PER_S: u64 = 100;
/// How often a terminal shows the positions, µs.
const SHOW_EVERY_US: u64 = 50_000;

/// A script's line: its time, s, and its orders, which are one.
#[derive(Clone, Debug)]
struct Timed {
    at_s: f64,
    orders: String,
}

pub(crate) fn run(args: &VerbsArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    interrupt::watch();
    // The motors and the whole script are read, and perhaps refused, before anything moves.
    let wiring = Wiring::read(args)?;
    let script = args.script.as_deref().map(|path| load_script(path, &wiring)).transpose()?;
    let virtual_board = || virtual_board(args.board.unwrap_or_default(), Role::Verbs);
    match (&args.port, script) {
        (Some(name), script) => {
            let port = Serial::open(name, true).map_err(port_problem)?;
            // The board counts from another position from here on.
            last_positions::forget(name);
            run_on(port, name, args.baud, &wiring, script, false, console)
        }
        (None, Some(script)) => run_on(virtual_board()?, "", args.baud, &wiring, Some(script), true, console),
        (None, None) => {
            let board = serve::Paced::new(virtual_board()?);
            run_on(board, "", args.baud, &wiring, None, true, console)
        }
    }
}

/// What the axes are.
#[derive(Clone, Debug, Default)]
struct Wiring {
    coils: Option<Coils>,
    /// A motion file whose motors they are.
    motors: Option<PathBuf>,
    /// By axis: in which units its speed may be told.
    units: Vec<PositionUnits>,
}

impl Wiring {
    fn read(args: &VerbsArgs) -> miette::Result<Wiring> {
        let units = match (&args.motors, args.steps_per_rev) {
            (Some(file), _) => load::contents(file)?.units(),
            (None, Some(steps)) => {
                let units =
                    PositionUnits { steps_per_turn: steps.into(), steps_per_mm: None, steps_per_full_step: 1.0 };
                vec![units; AXES.len()]
            }
            (None, None) => Vec::new(),
        };
        let wiring = Wiring { coils: args.coils, motors: args.motors.clone(), units };
        // At a port the board is not known yet.
        args.board.map_or(Ok(()), |kind| wiring.setup(kind).map(drop))?;
        Ok(wiring)
    }

    /// The axes on a board.
    fn setup(&self, kind: BoardKind) -> miette::Result<Setup> {
        if let Some(file) = &self.motors {
            let mut setup = setup(&load::endless(file, Some(kind.name()))?.program);
            if setup.motors.len() > AXES.len() {
                let (motors, most) = (setup.motors.len(), AXES.len());
                return Err(miette!(
                    "{}: {motors} motors are more than the axes x, y, z and a: {most}",
                    file.display()
                ));
            }
            setup.idle_ms = None;
            return Ok(setup);
        }
        let mut setup = kind.axes();
        if let Some(coils) = self.coils {
            let first = kind.profile().first_coil_pin.ok_or_else(|| {
                let able =
                    BoardKind::ALL.into_iter().map(BoardKind::profile).filter(|able| able.first_coil_pin.is_some());
                let able = able.map(|able| able.title_with_article).collect::<Vec<_>>().join(" or ");
                let this = kind.profile().title_with_article;
                let help = format!("leave --coils out, and use drivers with STEP and DIR; or {able}");
                miette!(help = help, "{this} cannot switch coils: only {able} can")
            })?;
            let sequence = match coils {
                Coils::Wave => Sequence::Wave,
                Coils::Full => Sequence::Full,
                Coils::Half => Sequence::Half,
            };
            setup.motors = (0..AXES.len() as u8).map(|axis| MotorSetup::coils_on(first + 4 * axis, sequence)).collect();
            setup.enable = None;
        }
        Ok(setup)
    }

    /// One of the orders of a line.
    fn read_part(&self, part: &str, tick_hz: f64) -> Result<LineOrders, NotRead> {
        let known = self.in_ticks(&in_small_letters(part), tick_hz).map_err(NotRead::Speed)?;
        match text::read(known.as_bytes()) {
            VerbLine::Orders(told) => Ok(told),
            VerbLine::Unknown => Err(NotRead::Unknown),
            VerbLine::Refused(what, word) => Err(NotRead::Line(written(&VerbReply::Unread(what, word)))),
        }
    }

    /// A line as boards have it: each speed with a unit in ticks from step to step.
    fn in_ticks(&self, line: &str, tick_hz: f64) -> Result<String, String> {
        let words: Vec<&str> = line.split_whitespace().collect();
        let [verb @ "speed", axes, values @ ..] = words.as_slice() else { return Ok(line.to_owned()) };
        if values.iter().all(|value| value.bytes().all(|byte| byte.is_ascii_digit())) {
            return Ok(line.to_owned());
        }
        let values = speeds(values);
        let named: Vec<Option<usize>> = axes.bytes().map(|axis| AXES.iter().position(|name| *name == axis)).collect();
        if values.len() != 1 && values.len() != named.len() {
            return Err(format!("{} speeds for {} axes: give one for each, or one for all", values.len(), named.len()));
        }
        let mut told = format!("{verb} {axes}");
        for (place, axis) in named.iter().enumerate() {
            let value = values.get(place).or(values.first()).map_or("", String::as_str);
            let units = axis.and_then(|axis| self.units.get(axis));
            told.push_str(&format!(" {}", period(value, units, tick_hz)?));
        }
        Ok(told)
    }
}

/// Why an order cannot be read.
#[derive(Clone, Debug)]
enum NotRead {
    /// Its speed cannot be made, in words.
    Speed(String),
    /// It has no verb.
    Unknown,
    /// As a board says it.
    Line(String),
}

/// The verb and the axes of an order in small letters, as boards have them: docs/verbs.md has them in capitals, too.
fn in_small_letters(order: &str) -> String {
    let mut words = order.split_whitespace();
    let verb = words.next().unwrap_or_default().to_ascii_lowercase();
    let verb = if verb == "direction" { "dir" } else { &verb };
    let axes = words.next().map(str::to_ascii_lowercase);
    let mut small = verb.to_owned();
    for word in axes.as_deref().into_iter().chain(words) {
        small.push(' ');
        small.push_str(word);
    }
    small
}

/// The values of a `speed` line: a number, and the unit behind it.
fn speeds(words: &[&str]) -> Vec<String> {
    let mut values: Vec<String> = Vec::new();
    for word in words {
        let is_number = word.starts_with(|letter: char| letter.is_ascii_digit() || matches!(letter, '+' | '-' | '.'));
        match values.last_mut() {
            Some(number) if !is_number => number.push_str(&format!(" {word}")),
            _ => values.push((*word).to_owned()),
        }
    }
    values
}

/// Ticks from step to step at a speed.
fn period(text: &str, units: Option<&PositionUnits>, tick_hz: f64) -> Result<u64, String> {
    if let Ok(ticks) = text.parse() {
        return Ok(ticks);
    }
    let speed = Quantity::parse(text).map_err(|error| format!("{error}; write it like `500 steps/s`"))?;
    if !speed.base.is_position() || speed.per_seconds != 1 {
        return Err(format!(
            "{text} is {}; a speed is `500 steps/s`, `30 rpm`, or ticks from step to step",
            speed.kind()
        ));
    }
    let steps = match (speed.base, units) {
        (Base::Step, _) => Some(1.0),
        (base, Some(units)) => units.steps(base),
        (_, None) => None,
    };
    let steps = steps.ok_or_else(|| match speed.base {
        Base::Length => format!("{text} needs a motor with a `lead`: add --motors with a motion file that has one"),
        _ => format!("{text} needs the steps of a turn: add --steps-per-rev 3200 with your number, or --motors with a motion file"),
    })?;
    let rate = speed.value * steps;
    if rate <= 0.0 {
        return Err(format!("{text}: a speed is more than 0; `dir x -1` goes backward, `dir x 0` rests"));
    }
    let ticks = (tick_hz / rate).round();
    if (1.0..=LONGEST_PERIOD).contains(&ticks) {
        Ok(ticks as u64)
    } else {
        Err(format!("{text} is beyond what a board can do"))
    }
}

/// Ticks, as boards take them.
const LONGEST_PERIOD: f64 = (1_u64 << 62) as f64;

/// A line without its comment.
fn without_comment(line: &str) -> &str {
    line.split('#').next().unwrap_or_default().trim_end()
}

/// Reads a script.
fn load_script(path: &Path, wiring: &Wiring) -> miette::Result<Vec<Timed>> {
    let bytes = inputs::bytes(path, inputs::MAX_SCRIPT_BYTES)?;
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
        if let Some(Timed { at_s: before, .. }) = lines.last().filter(|before| at_s < before.at_s) {
            let message = format!("times go back: the line before has the time {}", human::seconds(*before));
            return Err(wrong(0..when.len(), message));
        }
        let mut order_at = when.len() + 1;
        let mut has_orders = false;
        for part in told.split(';') {
            let at = order_at + part.len() - part.trim_start().len()..order_at + part.trim_end().len();
            order_at += part.len() + 1;
            if part.trim().is_empty() {
                continue;
            }
            // No board is asked yet, and the ticks do not matter.
            wiring.read_part(part.trim(), NOMINAL_HZ).map_err(|why| {
                let message = match &why {
                    NotRead::Speed(why) => why.clone(),
                    NotRead::Unknown => "no such verb".to_owned(),
                    NotRead::Line(refusal) => meaning(refusal).unwrap_or_else(|| refusal.clone()),
                };
                wrong(at, message)
            })?;
            has_orders = true;
        }
        if !has_orders {
            return Err(wrong(0..line.len(), "a line without an order".to_owned()));
        }
        lines.push(Timed { at_s, orders: told.trim().to_owned() });
    }
    if lines.is_empty() {
        return Err(miette!(help = OF_SCRIPTS, "{name} has no line to tell"));
    }
    Ok(lines)
}

/// Ticks of a board that is not known yet, 1/s.
const NOMINAL_HZ: f64 = 16e6;

/// A reply in the text that a board would write.
fn written(reply: &VerbReply) -> String {
    let mut line = [0; LONGEST];
    let len = reply.write(&mut line);
    String::from_utf8_lossy(&line[..len]).trim_end().to_owned()
}

/// Steps that were counted on a virtual board's pins.
#[derive(Clone, Debug, Default)]
struct Pins {
    forward: [bool; AXES.len()],
    coils: [CoilPins; AXES.len()],
    counts: [i64; AXES.len()],
}

/// The coils of an axis.
#[derive(Clone, Copy, Debug, Default)]
struct CoilPins {
    /// Bit 0 is IN1.
    levels: u8,
    /// When they last changed. All that change for a step change at one tick.
    changed: u64,
    /// The half step at which they were last on. They are off before the first step.
    phase: Option<usize>,
}

impl Pins {
    fn see(&mut self, edge: Edge, setup: &Setup) {
        for (axis, motor) in setup.motors.iter().enumerate() {
            if let Some(sequence) = motor.coils() {
                let first = motor.step_pin;
                // GP26 follows GP22.
                let pins = (first..first + 4).map(|pin| if first <= 22 && pin > 22 { pin + 3 } else { pin });
                if let Some((number, _)) = pins.enumerate().find(|(_, pin)| *pin == edge.line) {
                    if self.coils[axis].changed != edge.tick {
                        self.counts[axis] += self.coils[axis].step(sequence);
                    }
                    let coils = &mut self.coils[axis];
                    coils.changed = edge.tick;
                    coils.levels = coils.levels & !(1 << number) | u8::from(edge.level) << number;
                }
            } else if edge.line == motor.dir_pin {
                self.forward[axis] = edge.level == motor.forward_high;
            } else if edge.line == motor.step_pin && edge.level {
                self.counts[axis] += if self.forward[axis] { 1 } else { -1 };
            }
        }
    }

    /// Takes the last steps of coils into the counts.
    fn finish(&mut self, setup: &Setup) {
        for (axis, motor) in setup.motors.iter().enumerate() {
            if let Some(sequence) = motor.coils() {
                self.counts[axis] += self.coils[axis].step(sequence);
            }
        }
    }
}

impl CoilPins {
    /// The step from the phase before to the levels: 1, −1, or 0.
    fn step(&mut self, sequence: Sequence) -> i64 {
        let Some(phase) = HALF_STEPS.iter().position(|pattern| *pattern == self.levels) else { return 0 };
        let first = if sequence == Sequence::Wave { 1 } else { 0 };
        let before = self.phase.replace(phase).unwrap_or(first);
        let half_steps = (phase + HALF_STEPS.len() - before) % HALF_STEPS.len();
        let own = if sequence == Sequence::Half { 1 } else { 2 };
        match half_steps {
            steps if steps == own => 1,
            steps if steps == HALF_STEPS.len() - own => -1,
            _ => 0,
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

/// A board that this command moves by verbs, and the person who moves it.
struct VerbSession<'a, P, T> {
    remote: Remote<P>,
    person: &'a mut T,
    wiring: &'a Wiring,
    setup: Setup,
    tick_hz: u64,
    axes: [Axis; AXES.len()],
    pins: Option<Pins>,
    refused: usize,
    /// When the person saw the positions last, µs.
    shown: Option<u64>,
    /// When the board was last asked whether all axes rest, while moves are waited for, and its answer.
    last_look: Option<(u64, bool)>,
}

/// Connects to the board at a port, sets it up, and reads its axes. While the board still moves motors for an earlier
/// host, `goes_on` decides whether to wait on. If the board refuses, the connection is closed with Bye.
fn connect<P: Port>(
    port: P,
    baud: Baud,
    wiring: &Wiring,
    goes_on: impl FnMut() -> bool,
) -> miette::Result<(Remote<P>, Setup, Obeyed)> {
    let problem = |error: RemoteError| drive_problem(error.into());
    let number = session_number();
    let remote = Remote::open(port, number).map_err(problem)?;
    let (kind, image) = (remote.kind(), remote.info().image);
    if !matches!(image, 0 | image::VERBS) {
        remote.close();
        return Err(problem(RemoteError::OtherImage { is: image_name(image), wanted: image_name(image::VERBS) }));
    }
    let setup =
        kind.ok_or_else(|| miette!("the board is {}", name_of(remote.info()))).and_then(|kind| wiring.setup(kind));
    let setup = match setup {
        Ok(setup) => setup,
        Err(error) => {
            remote.close();
            return Err(error);
        }
    };
    let mut remote = set_up(remote, &setup, baud, number, goes_on).map_err(problem)?;
    // A board without verbs refuses here, before anything else is sent.
    match remote.tell_motors(&[]) {
        Ok(first) => Ok((remote, setup, first)),
        Err(error) => {
            remote.close();
            Err(problem(error))
        }
    }
}

/// Runs the command on a board. `name` is the port's name, empty for a virtual board, whose pins are seen. Lines are read once the board
/// is connected.
fn run_on<P: Port>(
    port: P,
    name: &str,
    baud: Baud,
    wiring: &Wiring,
    script: Option<Vec<Timed>>,
    has_pins: bool,
    console: &mut Console<'_>,
) -> miette::Result<Exit> {
    let (remote, setup, first) = connect(port, baud, wiring, waits_with_notice(console, name))?;
    let (tick_hz, pins) = (u64::from(remote.info().tick_hz), has_pins.then(Pins::default));
    let begun = Begun { remote, wiring, setup, tick_hz, pins };
    if script.is_none() && stdin().is_terminal() && stdout().is_terminal() {
        console.print("`help` lists the commands, Ctrl-C halts all axes, `quit` ends\n")?;
        let mut terminal = Terminal::new(console.out.screen(), STOP).map_err(ConsoleError::from)?;
        return begun.session(&mut terminal).run(first, None);
    }
    // No line is read before, and none with a script.
    let lines = if script.is_none() { typed() } else { channel().1 };
    begun.session(&mut Plain::new(lines, &mut console.out)).run(first, script)
}

/// A board that is set up, before somebody moves it.
struct Begun<'a, P> {
    remote: Remote<P>,
    wiring: &'a Wiring,
    setup: Setup,
    tick_hz: u64,
    pins: Option<Pins>,
}

impl<'a, P: Port> Begun<'a, P> {
    fn session<T: Person>(self, person: &'a mut T) -> VerbSession<'a, P, T> {
        let Begun { remote, wiring, setup, tick_hz, pins } = self;
        let axes = Default::default();
        VerbSession { remote, person, wiring, setup, tick_hz, axes, pins, refused: 0, shown: None, last_look: None }
    }
}

/// A mask of all axes, as [`LineOrders::axes`] has it.
const ALL: u8 = 0b1111;

/// The letters of axes, one after the other.
fn names(is_one: impl Fn(usize) -> bool) -> String {
    let named = AXES.iter().enumerate().filter(|(axis, _)| is_one(*axis));
    named.map(|(_, name)| char::from(*name)).collect()
}

impl<'a, P: Port, T: Person> VerbSession<'a, P, T> {
    /// Tells the axes what a script or the person says, until all is done.
    fn run(mut self, first: Obeyed, script: Option<Vec<Timed>>) -> miette::Result<Exit> {
        let begin = self.remote.now();
        let ticks = human::count(self.tick_hz.into());
        self.say(format_args!(
            "{ticks} ticks a second; axes {}\n",
            written(&VerbReply::At { obeyed: first, axes: ALL })
        ))?;
        let is_typed = script.is_none();
        let mut script = script.unwrap_or_default().into_iter().peekable();
        let mut has_ended = false;
        while !has_ended || self.waits() {
            if interrupt::wanted() {
                return self.stop();
            }
            let mut until = self.remote.now() + self.tick_hz / ROUNDS_PER_S;
            if is_typed {
                for input in self.person.inputs().map_err(ConsoleError::from)? {
                    match input {
                        ConsoleInput::Stop => self.order(STOP)?,
                        ConsoleInput::End => has_ended = true,
                        ConsoleInput::Line(_) if has_ended => {}
                        ConsoleInput::Line(line) => has_ended = self.read(&line)?,
                    }
                }
            } else {
                has_ended = script.peek().is_none();
                let due = |next: &Timed| begin + (next.at_s * self.tick_hz as f64) as u64;
                if let Some(next) = script.next_if(|next| self.remote.now() >= due(next)) {
                    self.order(&next.orders)?;
                    continue;
                }
                until = script.peek().map_or(until, |next| until.min(due(next)));
            }
            self.go_on(until)?;
            if has_ended {
                self.look()?;
            }
        }
        self.finish()
    }

    /// Tells the person something. A reader that has gone away (`| head`) is no error.
    fn say(&mut self, text: impl Display) -> miette::Result<()> {
        match self.person.tell(&text.to_string()) {
            Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
            done => Ok(done.map_err(ConsoleError::from)?),
        }
    }

    /// Whether a move is still to be done. A stationary axis would never finish its move.
    fn waits(&self) -> bool {
        self.axes.iter().any(|axis| axis.moves > 0 && !axis.is_stationary)
    }

    /// Reads a typed line. Whether it ends the console.
    fn read(&mut self, line: &str) -> miette::Result<bool> {
        if line.len() as u64 > inputs::MAX_TYPED_BYTES {
            self.refused += 1;
            self.say(format_args!("err long: a line has at most {} bytes\n", inputs::MAX_TYPED_BYTES))?;
            return Ok(false);
        }
        let parts = || without_comment(line).split(';').map(str::trim).filter(|part| !part.is_empty());
        let of_console = |part: &str| {
            let word = part.to_ascii_lowercase();
            matches!(word.as_str(), "help" | "?" | "quit" | "exit" | "where").then_some(word)
        };
        // All orders of a line are one, wherever words of the console stand between them.
        let mut orders: Vec<&str> = parts().filter(|part| of_console(part).is_none()).collect();
        for part in parts() {
            match of_console(part).as_deref() {
                Some("help" | "?") => self.say(HELP)?,
                Some("where") => {
                    let obeyed = self.remote.tell_motors(&[]).map_err(|error| drive_problem(error.into()))?;
                    self.say(format_args!("{}\n", written(&VerbReply::At { obeyed, axes: ALL })))?;
                }
                Some(_) => return Ok(true),
                None if orders.is_empty() => {}
                None => self.order(&std::mem::take(&mut orders).join(";"))?,
            }
        }
        Ok(false)
    }

    /// Sends the orders of a line, all of them at one tick; or none, if one of them cannot be read.
    fn order(&mut self, line: &str) -> miette::Result<()> {
        let parts: Vec<&str> = line.split(';').map(str::trim).filter(|part| !part.is_empty()).collect();
        let mut told = Vec::with_capacity(parts.len());
        for part in &parts {
            // A line of one order needs no word about which.
            let which =
                if parts.len() == 1 { String::new() } else { format!("; nothing was done: `{part}` is of a line") };
            match self.wiring.read_part(part, self.tick_hz as f64) {
                Ok(orders) if orders.axes() != ALL && orders.axes() >> self.setup.motors.len() != 0 => {
                    let there = names(|axis| axis < self.setup.motors.len());
                    self.refused += 1;
                    return self.say(format_args!("err flags 2: the axes are {there}{which}\n"));
                }
                Ok(orders) => told.push(orders),
                Err(NotRead::Speed(why)) => {
                    self.refused += 1;
                    return self.say(format_args!("err speed: {why}{which}\n"));
                }
                Err(NotRead::Unknown) => return self.refuse("err command 1", &which),
                Err(NotRead::Line(refusal)) => return self.refuse(&refusal, &which),
            }
        }
        self.tell(&told)
    }

    fn refuse(&mut self, said: &str, which: &str) -> miette::Result<()> {
        self.refused += 1;
        let means = meaning(said).map_or_else(String::new, |means| format!(": {means}"));
        self.say(format_args!("{said}{means}{which}\n"))
    }

    fn tell(&mut self, told: &[LineOrders]) -> miette::Result<()> {
        let axes = told.iter().fold(0, |axes, told| axes | told.axes());
        let orders = told.iter().filter_map(LineOrders::orders).flat_map(|orders| orders.iter().collect::<Vec<_>>());
        // `halt` alone is of all axes that are there.
        let orders: Vec<(u8, Verb)> = orders.filter(|(axis, _)| usize::from(*axis) < self.setup.motors.len()).collect();
        match self.remote.tell_motors(&orders) {
            Ok(obeyed) => {
                // An answer that got lost is sent again. Its orders may be done, and their `done` received, before it
                // comes.
                for (axis, verb) in orders {
                    self.axes[usize::from(axis)].hear(verb, obeyed.tick);
                }
                self.events()?;
                self.say(format_args!("{}\n", written(&VerbReply::At { obeyed, axes })))
            }
            Err(RemoteError::Refused { reason: reason @ (Reason::Period | Reason::Busy), detail, .. }) => {
                let which = if told.len() > 1 { "; no part of the line was done" } else { "" };
                self.refuse(&written(&VerbReply::Refused(Refusal { reason, detail })), which)
            }
            Err(error @ RemoteError::TooManyOrders { .. }) => {
                self.refused += 1;
                self.say(format_args!("err orders: {error}; no part of the line was done\n"))
            }
            Err(error) => Err(drive_problem(error.into())),
        }
    }

    /// Lets time pass, and tells what the board reports.
    fn go_on(&mut self, until: u64) -> miette::Result<()> {
        let VerbSession { remote, setup, pins, .. } = self;
        remote.advance(until, &mut |edge: Edge| {
            if let Some(pins) = pins {
                pins.see(edge, setup);
            }
        });
        if let Some(error) = remote.error() {
            return Err(drive_problem(error.clone().into()));
        }
        self.events()?;
        if self.person.shows_positions() {
            let usec = (self.remote.now() as f64 * 1e6 / self.tick_hz as f64) as u64;
            let mut positions = [0; AXES.len()];
            // Counts of boards have 32 bits.
            positions.iter_mut().zip(self.remote.positions()).for_each(|(to, from)| *to = from as i32);
            if self.shown.is_none_or(|shown| usec >= shown + SHOW_EVERY_US) {
                self.shown = Some(usec);
                self.person.show(&BoardLine::Status(Status { usec, positions })).map_err(ConsoleError::from)?;
            }
        }
        Ok(())
    }

    /// A `done` may get lost, so the board is asked once a second whether all axes rest. After two answers that they
    /// do, no move is left.
    fn look(&mut self) -> miette::Result<()> {
        let now = self.remote.now();
        let (at, rested) = *self.last_look.get_or_insert((now, false));
        if !self.waits() || now < at + self.tick_hz {
            return Ok(());
        }
        let rests = self.remote.status().map_err(|error| drive_problem(error.into()))?.is_idle();
        self.events()?;
        self.last_look = Some((now, rests));
        if rests && rested && self.waits() {
            let unheard = names(|axis| self.axes[axis].moves > 0);
            self.say(format_args!("all rest; a `done` got lost on the way, of {unheard}\n"))?;
            self.axes.iter_mut().for_each(|axis| axis.moves = 0);
        }
        Ok(())
    }

    fn events(&mut self) -> miette::Result<()> {
        for event in self.remote.events() {
            match event.cause {
                Cause::MoveDone => {
                    if let Some(axis) = self.axes.get_mut(usize::from(event.motor)) {
                        axis.done(event.tick);
                    }
                    let done = VerbReply::Done { axis: event.motor, tick: event.tick, number: event.detail };
                    self.say(format_args!("{}\n", written(&done)))?;
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
    fn stop(mut self) -> miette::Result<Exit> {
        let (stopped, positions) = self.remote.stop_motors().map_err(|error| drive_problem(error.into()))?;
        let counts: Vec<String> =
            AXES.iter().zip(&positions).map(|(axis, at)| format!("{} {at}", char::from(*axis))).collect();
        self.say(format_args!("stopped at once: {}\n", counts.join(", ")))?;
        if stopped.uncertain != 0 {
            let uncertain = names(|axis| stopped.uncertain >> axis & 1 == 1);
            self.say(format_args!("uncertain {uncertain}: they were stepping, and may stand elsewhere\n"))?;
        }
        self.remote.close();
        Ok(Exit::BoundBroken)
    }

    /// Ends the run: tells the positions, and for a virtual board whether its pins agree with them.
    fn finish(mut self) -> miette::Result<Exit> {
        let runs = names(|axis| self.axes[axis].runs);
        let waits = names(|axis| self.axes[axis].moves > 0);
        if !runs.is_empty() {
            // Bye would also stop them. A halt first makes their positions known.
            let orders: Vec<(u8, Verb)> =
                (0..).zip(&self.axes).filter(|(_, axis)| axis.runs).map(|(axis, _)| (axis, Verb::Halt)).collect();
            self.remote.tell_motors(&orders).map_err(|error| drive_problem(error.into()))?;
            self.say(format_args!("halted at the end, as they had none: {runs}\n"))?;
        }
        if !waits.is_empty() {
            self.say(format_args!("moves of stationary axes are forgotten: {waits}\n"))?;
        }
        // Wait for the last period of a halted axis, and for the end of pulses.
        self.go_on(self.remote.now() + self.tick_hz / ROUNDS_PER_S)?;
        let obeyed = self.remote.tell_motors(&[]).map_err(|error| drive_problem(error.into()))?;
        self.say(format_args!("{}\n", written(&VerbReply::At { obeyed, axes: ALL })))?;
        self.go_on(obeyed.tick)?;
        let verdict = self.pins.take().map(|mut pins| {
            pins.finish(&self.setup);
            let there = obeyed.motors().len();
            let off = names(|axis| {
                axis < there && obeyed.motors().get(axis).map(|next| next.position.into()) != Some(pins.counts[axis])
            });
            let counted = AXES.iter().zip(pins.counts).take(there);
            let counted: Vec<String> = counted.map(|(axis, count)| format!("{} {count}", char::from(*axis))).collect();
            (off, counted.join(", "))
        });
        let refused = self.refused;
        let Some((off, counted)) = verdict else {
            self.remote.close();
            return Ok(if refused == 0 { Exit::Success } else { Exit::BoundBroken });
        };
        let verdict = match off.as_str() {
            "" if refused == 0 => "PASS: as the board counts".to_owned(),
            "" => format!("FAIL: lines refused: {refused}; the pins are as the board counts"),
            off => format!("FAIL: the board counts others of {off}"),
        };
        self.say(format_args!("steps at the pins: {counted}\n{verdict}\n"))?;
        self.remote.close();
        Ok(if refused == 0 && off.is_empty() { Exit::Success } else { Exit::BoundBroken })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pulsetrain_board::profiles;

    const UNO: BoardKind = BoardKind::of(&profiles::UNO);
    const PICO: BoardKind = BoardKind::of(&profiles::PICO);
    use pulsetrain_board::PortError;
    use pulsetrain_board::shared::Shared;
    use pulsetrain_board::virtual_pico::VirtualPico;
    use std::sync::mpsc::Receiver;
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

    /// Runs a script, or lines that are typed, on a board. Gives how that ended, and what was printed.
    fn held<P: Port>(
        port: P,
        wiring: &Wiring,
        script: Option<Vec<Timed>>,
        lines: Receiver<String>,
        pins: Option<Pins>,
    ) -> (miette::Result<Exit>, String) {
        let mut out = Vec::new();
        let exit = connect(port, Baud::B1M, wiring, || true).and_then(|(remote, setup, first)| {
            let tick_hz = u64::from(remote.info().tick_hz);
            let begun = Begun { remote, wiring, setup, tick_hz, pins };
            begun.session(&mut Plain::new(lines, &mut out)).run(first, script)
        });
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
        let error = load_script(Path::new("no such script.txt"), &Wiring::default()).unwrap_err();
        assert!(error.to_string().starts_with("cannot read no such script.txt: "), "{error}");
        assert!(error.help().is_none_or(|help| !help.to_string().contains("line")));
    }

    /// The line in ticks of a board with 16 MHz, or a part of the refusal.
    #[track_caller]
    fn check_speed(wiring: &Wiring, line: &str, expected: Result<&str, &str>) {
        match (wiring.in_ticks(line, 16e6), expected) {
            (Ok(line), Ok(expected)) => assert_eq!(line, expected),
            (Err(why), Err(part)) => assert!(why.contains(part), "{line}: {why}"),
            (told, expected) => panic!("{line}: {told:?}, not {expected:?}"),
        }
    }

    #[test]
    fn speeds_may_have_units() {
        let plain = Wiring::default();
        check_speed(&plain, "speed xy 32000 16000", Ok("speed xy 32000 16000"));
        check_speed(&plain, "speed xy 500 steps/s", Ok("speed xy 32000 32000"));
        check_speed(&plain, "speed xy 500 steps/s 1000steps/s", Ok("speed xy 32000 16000"));
        check_speed(&plain, "speed xy 0.5 steps/s 16000", Ok("speed xy 32000000 16000"));
        check_speed(&plain, "move x 5", Ok("move x 5"));
        check_speed(&plain, "speed x", Ok("speed x"));
        check_speed(&plain, "speed x 30 rpm", Err("--steps-per-rev"));
        check_speed(&plain, "speed x -5 steps/s", Err("more than 0"));
        check_speed(&plain, "speed x 0 steps/s", Err("more than 0"));
        check_speed(&plain, "speed x 5 steps", Err("a speed is"));
        check_speed(&plain, "speed x 1e30 steps/s", Err("beyond"));
        check_speed(&plain, "speed x 5 stps/s", Err("unknown unit"));
        check_speed(&plain, "speed xyz 5 steps/s 6 steps/s", Err("2 speeds for 3 axes"));
        let turn = PositionUnits { steps_per_turn: 3200.0, steps_per_mm: None, steps_per_full_step: 16.0 };
        let turning =
            Wiring { units: vec![turn, PositionUnits { steps_per_turn: 400.0, ..turn }], ..Wiring::default() };
        check_speed(&turning, "speed xy 30 rpm", Ok("speed xy 10000 80000"));
        check_speed(&turning, "speed x 180 deg/s", Ok("speed x 10000"));
        check_speed(&turning, "speed x 10 mm/s", Err("needs a motor with a `lead`"));
        check_speed(&turning, "speed z 30 rpm", Err("needs the steps of a turn"));
    }

    /// If the pins miss an edge, the counts differ.
    #[test]
    fn pins_count_each_rise_of_step_the_way_that_dir_has() {
        let setup = UNO.axes();
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
            first.configure(&PICO.axes()).unwrap();
            first.tell_motors(&[(0, Verb::Move { steps: 100_000 })]).unwrap();
            first.close();
            let refused = connect(port.clone(), Baud::B1M, &Wiring::default(), || false).err().unwrap();
            assert_eq!(refused.to_string(), RemoteError::StillMoving.to_string());
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
            for begin in (334_000..350_000).step_by(1000) {
                let begin = Duration::from_micros(begin);
                let port = Deaf::new(begin..begin + Duration::from_millis(6), Duration::from_secs(4));
                let script = vec![Timed { at_s: 0.1, orders: "move x 0".to_owned() }];
                let (exit, said) = held(port, &Wiring::default(), Some(script), channel().1, None);
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
            let (typed, lines) = channel();
            for line in ["# a note", "  speed x 125000 # a kilohertz", "move x 3#and no more", "quit # it is done"] {
                typed.send(line.to_owned()).unwrap();
            }
            let port = Deaf::new(Duration::ZERO..Duration::ZERO, Duration::from_secs(4));
            let (exit, said) = held(port, &Wiring::default(), None, lines, None);
            assert!(matches!(exit, Ok(Exit::Success)), "{exit:?} {said}");
            assert!(said.contains("\ndone x ") && said.trim_end().ends_with(" x 3 - y 0 - z 0 - a 0 -"), "{said}");
        }

        /// Runs lines on a virtual Pico whose pins are seen.
        fn typed_on_pico(wiring: &Wiring, lines: &[&str]) -> (miette::Result<Exit>, String) {
            let (typed, receiver) = channel();
            for line in lines {
                typed.send((*line).to_owned()).unwrap();
            }
            drop(typed);
            held(VirtualPico::on_usb(), wiring, None, receiver, Some(Pins::default()))
        }

        /// Both ways, through all phases, and with a turn: a coil that is switched at the wrong time makes another count.
        #[test]
        fn coils_step_as_they_are_told() {
            for coils in [Coils::Wave, Coils::Full, Coils::Half] {
                let wiring = Wiring { coils: Some(coils), ..Wiring::default() };
                let script =
                    [(0.1, "speed xa 500 steps/s"), (0.1, "move xa 21 3"), (0.3, "dir x -1"), (0.3, "move x 4")];
                let script = script.map(|(at_s, orders)| Timed { at_s, orders: orders.to_owned() }).to_vec();
                let pins = Some(Pins::default());
                let (exit, said) = held(VirtualPico::on_usb(), &wiring, Some(script), channel().1, pins);
                assert!(matches!(exit, Ok(Exit::Success)), "{coils:?}: {exit:?} {said}");
                assert!(
                    said.ends_with("steps at the pins: x 17, y 0, z 0, a 3\nPASS: as the board counts\n"),
                    "{coils:?}: {said}"
                );
            }
            let uno = Wiring { coils: Some(Coils::Half), ..Wiring::default() }.setup(UNO).unwrap_err();
            assert!(uno.to_string().contains("only a Pico"), "{uno}");
        }

        /// All of a line begins at one tick, or nothing of it does; in capitals, as docs/verbs.md has the verbs, too.
        #[test]
        fn a_line_is_one_order() {
            let lines = [
                "DIRECTION X -1; MOVE x 30",
                "speed y 0 steps/s; move y 5",
                "move z 7; fly z",
                "move a 1; move b 2",
                "move a 1; move a 1; move a 1; move a 1",
                "speed xyza 500 steps/s; dir xyza 1; move xyza 5",
                "dir z -1; where; move z 3",
            ];
            let (exit, said) = typed_on_pico(&Wiring::default(), &lines);
            assert!(matches!(exit, Ok(Exit::BoundBroken)), "{exit:?} {said}");
            assert!(said.contains("steps at the pins: x -30, y 0, z -3, a 0\nFAIL: lines refused: 5;"), "{said}");
            assert!(said.contains("err orders: 12 orders are more than the board takes at once: 8"), "{said}");
            // One answer for each line that is obeyed, for `where`, and for the end.
            assert_eq!(said.matches("\nat ").count(), 4, "{said}");
        }

        #[test]
        fn an_axis_that_is_not_there_is_refused() {
            let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/first-pico.toml");
            let units = crate::load::contents(Path::new(file)).unwrap().units();
            let wiring = Wiring { motors: Some(file.into()), units, ..Wiring::default() };
            let (exit, said) = typed_on_pico(&wiring, &["speed x 5 rpm", "move x 10", "move y 1", "halt"]);
            assert!(matches!(exit, Ok(Exit::BoundBroken)), "{exit:?} {said}");
            assert!(said.contains("err flags 2: the axes are x\n"), "{said}");
            assert!(said.contains("FAIL: lines refused: 1; the pins are as the board counts"), "{said}");
        }
    }
}
