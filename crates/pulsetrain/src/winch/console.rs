//! A board and a person: lines typed, replies and positions shown.

use std::io;
use std::sync::mpsc::{Receiver, TryRecvError};
use std::time::Duration;

use miette::Diagnostic;
use pulsetrain_board::{Port, PortError};
use pulsetrain_trace::winch::Status;

use super::talk::{Said, Talk};
use crate::interrupt;

/// What a person wants.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Wish {
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
    fn wishes(&mut self) -> io::Result<Vec<Wish>>;

    /// Shows what the board says.
    ///
    /// # Errors
    /// When it cannot be shown.
    fn show(&mut self, said: &Said) -> io::Result<()>;

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
    Person(#[from] io::Error),
}

/// `enable 0` with its checksum: a strict board that wants one on each line stops, too.
pub(super) const STOP: &str = "enable 0*11";

/// What can be typed.
pub const HELP: &str = "\
  a <axes> <steps>…           go to: `a xy 100 -50`     d <axes> <steps>…    go on by
  v <axes> <steps/s>…         drift on and on           r <axes> <steps>…    impulse
  s <axes> <steps/s>…         ramp of targets, 0: none
  g <axes> <Hz> <ratio>       how it follows: 0.01 to 20 Hz, damping ratio 0.07 to 5 (1: no overshoot)
  l <axes> <steps/s> <steps/s²>   limits, at most 10 000 and 250 000
  enable 0                    stop all axes, then drivers off     enable 1    drivers on
  srate <ms>    status lines          deadman <ms>    stop after so long a silence, 0: never
  strict 0|1    refuse irregular lines      version, ping
  on a Pico:  move <axes> <n>…  run <axes>  speed <axes> <ticks>…  dir <axes> <1, -1, 0>…  halt    told directly: docs/pico.md
  help, quit    of this console; quit leaves the board as it is
";

/// How often the board and the person are listened to.
const ROUND: Duration = Duration::from_millis(40);

/// Axes that have not moved for so long, by the board's clock, rest, µs.
const REST_US: u64 = 500_000;

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

/// Lets a person talk to a board until they end it.
///
/// # Errors
/// When either is gone.
pub fn converse<P: Port>(talk: &mut Talk<P>, person: &mut impl Person) -> Result<Ended, ConsoleError> {
    let mut rest = Rest::default();
    let mut refused = 0;
    let mut ended = None;
    loop {
        if ended.is_none() {
            for wish in person.wishes()? {
                match wish {
                    Wish::Line(line) => match line.trim() {
                        "" => {}
                        "help" | "?" => person.tell(HELP)?,
                        "quit" | "exit" => ended = Some(talk.now()),
                        line => {
                            rest = Rest::default();
                            talk.tell(line)?;
                        }
                    },
                    Wish::Stop => talk.tell(STOP)?,
                    Wish::End => ended = Some(talk.now()),
                }
            }
        }
        if let Some(ended) = ended {
            let waited = talk.now().saturating_sub(ended);
            if !person.waits_for_rest() || rest.is_reached {
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
        let mut shown = Ok(());
        talk.wait(talk.now() + ROUND, |_, said| {
            if let Said::Status(status) = &said {
                rest.see(*status);
            }
            refused += usize::from(said.is_refusal());
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
    is_reached: bool,
}

impl Rest {
    fn see(&mut self, status: Status) {
        match self.since {
            Some(since) if since.positions == status.positions => {
                self.is_reached = status.usec - since.usec >= REST_US;
            }
            _ => *self = Rest { since: Some(status), is_reached: false },
        }
    }
}

/// Someone without a terminal, a file or a program: lines come, and all that the board says is printed.
pub struct Plain<'a> {
    lines: Receiver<String>,
    out: &'a mut dyn io::Write,
}

impl<'a> Plain<'a> {
    /// Lines end when whoever sends them is gone.
    pub fn new(lines: Receiver<String>, out: &'a mut dyn io::Write) -> Plain<'a> {
        Plain { lines, out }
    }
}

impl Person for Plain<'_> {
    fn wishes(&mut self) -> io::Result<Vec<Wish>> {
        if interrupt::wanted() {
            return Ok(vec![Wish::Stop, Wish::End]);
        }
        let mut wishes = Vec::new();
        loop {
            match self.lines.try_recv() {
                Ok(line) => wishes.push(Wish::Line(line)),
                Err(TryRecvError::Empty) => return Ok(wishes),
                Err(TryRecvError::Disconnected) => {
                    wishes.push(Wish::End);
                    return Ok(wishes);
                }
            }
        }
    }

    fn show(&mut self, said: &Said) -> io::Result<()> {
        match said {
            Said::Status(Status { usec, positions: [x, y, z, a] }) => {
                writeln!(self.out, "txyza {usec} {x} {y} {z} {a}")
            }
            Said::Line(line) => writeln!(self.out, "{line}"),
        }
    }

    fn tell(&mut self, text: &str) -> io::Result<()> {
        write!(self.out, "{text}")
    }

    fn waits_for_rest(&self) -> bool {
        true
    }
}
