//! A board and a person: lines typed, replies and positions shown.

use std::collections::VecDeque;
use std::io;
use std::sync::mpsc::{Receiver, TryRecvError};
use std::time::Duration;

use miette::Diagnostic;
use pulsetrain_board::{Port, PortError};
use pulsetrain_trace::winch::Status;

use super::mirror::Mirror;
use super::run::BYTE;
use super::talk::{BoardLine, Talk};
use crate::interrupt;

/// What a person wants.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ConsoleInput {
    /// To say a line, or to have `help`, or to `quit`.
    Line(String),
    /// All axes stopped.
    Stop,
    /// To end.
    End,
}

/// Whoever sits at the console.
pub trait Person {
    /// What they have wanted since the last look.
    ///
    /// # Errors
    /// When they cannot be heard any more.
    fn inputs(&mut self) -> io::Result<Vec<ConsoleInput>>;

    /// Shows what the board says.
    ///
    /// # Errors
    /// When it cannot be shown.
    fn show(&mut self, said: &BoardLine) -> io::Result<()>;

    /// Shows a text for people.
    ///
    /// # Errors
    /// When it cannot be shown.
    fn tell(&mut self, text: &str) -> io::Result<()>;

    /// Whether, having ended, they wait until the axes rest.
    fn waits_for_rest(&self) -> bool;
}

/// Why a console ended.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum ConsoleError {
    /// The port is gone.
    #[error(transparent)]
    Port(#[from] PortError),
    /// So is the person.
    #[error("the console cannot go on: {0}")]
    Person(io::Error),
}

// The message has all of it: as a source it would be told twice.
impl From<io::Error> for ConsoleError {
    fn from(error: io::Error) -> ConsoleError {
        ConsoleError::Person(error)
    }
}

/// Stops all axes; as the board wants it: [`Talk::as_wanted`].
pub(super) const STOP: &str = "enable 0";

/// What can be typed.
pub const HELP: &str = "\
\x20 a <axes> <steps>…           go to: `a xy 100 -50`     d <axes> <steps>…    go on by
  v <axes> <steps/s>…         drift on and on, ±15 000  r <axes> <steps>…    impulse
  s <axes> <steps/s>…         ramp of targets, up to 65 535; 0: none
  g <axes> <Hz> <ratio>       how it follows: 0.01 to 20 Hz, damping ratio 0.07 to 5 (1: no overshoot)
  l <axes> <steps/s> <steps/s²>   limits, 0 to 10 000 and 1 to 250 000
  enable 0                    stop all axes, then drivers off     enable 1    drivers on
  srate <ms>    status lines, 1 to 65 535     deadman <ms>    stop after so long a silence, up to 65 535; 0: never
  strict 0|1    refuse irregular lines      version, ping
  on a Pico:  move <axes> <n>…  run <axes>  speed <axes> <ticks>…  dir <axes> <1, -1, 0>…  halt    told directly: docs/pico.md
  help, quit    of this console; quit leaves the board as it is
";

/// How often the board and the person are listened to.
const ROUND: Duration = Duration::from_millis(40);

/// Axes that have not moved for so long, by the board's clock, rest, if no line has told them to go on, µs.
const REST_US: u64 = 500_000;

/// By more than so many steps the mirror leads only an axis that does not do as it does: what a line is late for comes to less
/// where the axis makes none in [`REST_US`].
const LEAD_STEPS: u64 = 3;

/// And so long it is waited for: with the gains at first a move rings for ten seconds and more.
const LONGEST_WAIT: Duration = Duration::from_secs(30);

/// How a console ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ended {
    /// Lines that the board has refused.
    pub refused: usize,
    /// Nobody was to wait for the axes to rest, or they do.
    pub is_settled: bool,
}

/// Bytes of lines that are sent at once: of so many each line has its answer, docs/winch.md. The next ones follow when the board
/// has been silent for a while.
const BURST: usize = 64;
const SILENCE: Duration = Duration::from_millis(20);

/// Lets a person talk to a board until they end it.
///
/// # Errors
/// When either is gone.
pub fn converse<P: Port>(talk: &mut Talk<P>, person: &mut impl Person) -> Result<Ended, ConsoleError> {
    let mut rest = Rest::default();
    let mut mirror = Mirror::new(talk.now());
    let mut waiting = VecDeque::new();
    // When the next lines may be sent.
    let mut free = talk.now();
    let (mut refused, mut is_ending, mut ended) = (0, false, None);
    loop {
        for input in person.inputs()? {
            match input {
                ConsoleInput::Stop => {
                    waiting.clear();
                    waiting.push_back(talk.as_wanted(STOP));
                    free = talk.now();
                }
                ConsoleInput::End => is_ending = true,
                ConsoleInput::Line(_) if is_ending => {}
                ConsoleInput::Line(line) => match line.trim() {
                    "" => {}
                    "help" | "?" => person.tell(HELP)?,
                    "quit" | "exit" => is_ending = true,
                    line => waiting.push_back(line.to_owned()),
                },
            }
        }
        let now = talk.now();
        mirror.go_on(now);
        let mut sent = 0;
        while free <= now
            && let Some(line) = waiting.pop_front_if(|line| sent == 0 || sent + line.len() < BURST)
        {
            rest = Rest::default();
            talk.tell(&line)?;
            mirror.tell(&line, now);
            sent += line.len() + 1;
        }
        if sent > 0 {
            free = now + BYTE * sent as u32 + SILENCE;
        }
        if is_ending && waiting.is_empty() {
            let waited = now.saturating_sub(*ended.get_or_insert(now));
            if !person.waits_for_rest() || rest.is_complete(&mirror) {
                return Ok(Ended { refused, is_settled: true });
            }
            if waited > LONGEST_WAIT {
                let what = match rest.since {
                    Some(_) => "the axes still move",
                    None => "no status tells whether the axes rest",
                };
                person.tell(&format!("{what}; the board goes on with what it was told\n"))?;
                return Ok(Ended { refused, is_settled: false });
            }
        }
        let until = if waiting.is_empty() { now + ROUND } else { free.min(now + ROUND) };
        let mut shown = Ok(());
        talk.wait(until, |at, said| {
            if let BoardLine::Status(status) = &said {
                rest.see(*status, mirror.made());
            }
            refused += usize::from(said.is_refusal());
            if said.is_answer() {
                free = free.max(at + SILENCE);
            }
            if shown.is_ok() {
                shown = person.show(&said);
            }
        })?;
        shown?;
    }
}

/// Whether axes rest.
#[derive(Clone, Copy, Debug, Default)]
struct Rest {
    since: Option<Status>,
    /// Where the mirror's axes were then.
    mirrored: [i64; 4],
    is_reached: bool,
}

impl Rest {
    fn see(&mut self, status: Status, mirrored: [i64; 4]) {
        match self.since {
            Some(since) if since.positions == status.positions => {
                self.is_reached = status.usec - since.usec >= REST_US;
            }
            _ => *self = Rest { since: Some(status), mirrored, is_reached: false },
        }
    }

    /// Whether the board's axes rest, and are not only slow: so the mirror says, or it has gone on without them. Then the board
    /// does not do what the mirror took it to: it has refused a line, or a deadman that it keeps has stopped it.
    fn is_complete(&self, mirror: &Mirror) -> bool {
        let leads = mirror.made().iter().zip(self.mirrored).any(|(now, then)| now.abs_diff(then) > LEAD_STEPS);
        self.is_reached && (leads || mirror.is_at_rest())
    }
}

/// Someone without a terminal, a file or a program: lines come, and all that the board says is printed.
pub struct Plain<'a> {
    lines: Receiver<String>,
    out: &'a mut dyn io::Write,
    has_stopped: bool,
}

impl<'a> Plain<'a> {
    /// Lines end when whoever sends them is gone.
    pub fn new(lines: Receiver<String>, out: &'a mut dyn io::Write) -> Plain<'a> {
        Plain { lines, out, has_stopped: false }
    }
}

impl Person for Plain<'_> {
    fn inputs(&mut self) -> io::Result<Vec<ConsoleInput>> {
        if interrupt::wanted() {
            let is_first = !std::mem::replace(&mut self.has_stopped, true);
            return Ok(if is_first { vec![ConsoleInput::Stop, ConsoleInput::End] } else { vec![ConsoleInput::End] });
        }
        let mut inputs = Vec::new();
        loop {
            match self.lines.try_recv() {
                Ok(line) => inputs.push(ConsoleInput::Line(line)),
                Err(TryRecvError::Empty) => return Ok(inputs),
                Err(TryRecvError::Disconnected) => {
                    inputs.push(ConsoleInput::End);
                    return Ok(inputs);
                }
            }
        }
    }

    fn show(&mut self, said: &BoardLine) -> io::Result<()> {
        match said {
            BoardLine::Status(Status { usec, positions: [x, y, z, a] }) => {
                writeln!(self.out, "txyza {usec} {x} {y} {z} {a}")
            }
            BoardLine::Line(line) => writeln!(self.out, "{line}"),
        }
    }

    fn tell(&mut self, text: &str) -> io::Result<()> {
        write!(self.out, "{text}")
    }

    fn waits_for_rest(&self) -> bool {
        true
    }
}
