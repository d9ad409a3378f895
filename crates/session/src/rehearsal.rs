//! The rehearsal: before a real Uno gets a motion, a virtual Uno plays it. Each edge of its pins is compared with the law, and errors of the board
//! and of the session are reported as on a real one.
//!
//! The planner checks steps, segments and the line against limits (`pulsetrain_plan::line`). But no limit covers everything that an Uno's
//! processor has to do besides the steps, for these motors at these times: so it is tried, as it is for baked motions.
//!
//! Only an Uno needs it: its queues hold 376 bytes in all, and its one core does everything. A Pico's queues hold 32 kB, and state machines
//! time its pins.

use std::cell::Cell;
use std::sync::mpsc::channel;

use pulsetrain_board::{BoardKind, Edge, Observer};
use pulsetrain_core::wire::Baud;
use pulsetrain_motion::law::Cursor;
use pulsetrain_motion::program::Program;
use pulsetrain_motion::time::common_period;
use pulsetrain_motion::{Time, human};
use pulsetrain_trace::verdict::{EdgeJudge, Failure, JudgeError, Report};

use crate::control::{Command, Event};
use crate::drive::{DriveError, Driven};
use crate::lateness::Edges;
use crate::prepare::Prepared;

/// Seconds of board time between two reports of progress, and so between two looks whether an edge was wrong.
pub const STRIDE_S: f64 = 0.05;

/// Seconds of a motion that a run rehearses if the user gives no length: about a second of waiting.
pub const MOST_S: f64 = 10.0;

/// Bits a second. At this rate or more a faster line is no advice: the line is not what was too slow.
const FAST_BAUD: u32 = Baud::B1M.rate();

/// How much of a motion is played.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Length {
    /// How much of the laws' time is played, s.
    pub seconds: f64,
    /// The time after which nothing new comes, s: the whole motion, or, where laws repeat, every phase of theirs to one another. `None` if new
    /// phases never end.
    pub all_s: Option<f64>,
    /// Whether some motor's law never ends.
    pub endless: bool,
}

impl Length {
    /// Seconds that [`Length::of`] gives at most.
    pub const MOST_S: f64 = 60.0;

    /// Up to where nothing new comes, but not more than [`MOST_S`](Length::MOST_S).
    #[must_use]
    pub fn of(program: &Program) -> Length {
        let whole = Length::exactly(program, f64::INFINITY);
        Length { seconds: whole.all_s.unwrap_or(f64::INFINITY).min(Length::MOST_S), ..whole }
    }

    /// So many seconds, or the whole of a shorter motion.
    #[must_use]
    pub fn exactly(program: &Program, seconds: f64) -> Length {
        let laws = || program.motors.iter().map(|motor| &motor.law);
        let ends = laws().filter_map(|law| law.end()).fold(Time::ZERO, Time::max);
        let endless = laws().any(|law| law.end().is_none());
        let (from, periods): (Vec<Time>, Vec<Time>) = laws().filter_map(|law| law.cycle()).unzip();
        // Of a law without an end or a period, something new may always come.
        if laws().any(|law| law.end().is_none() && law.cycle().is_none()) {
            return Length { seconds, all_s: None, endless };
        }
        let Some(longest) = periods.iter().max() else {
            return Length { seconds: seconds.min(ends.seconds()), all_s: Some(ends.seconds()), endless: false };
        };
        // All phases, from where all laws repeat. Two more periods, as the transition from one to the next is planned separately.
        let once = from.into_iter().fold(ends, Time::max);
        let all = common_period(&periods).map(|common| once + common + longest.times(2));
        Length { seconds, all_s: all.map(Time::seconds), endless }
    }

    /// Whether nothing new would come after it.
    #[must_use]
    pub fn is_all(&self) -> bool {
        self.all_s.is_some_and(|all| all <= self.seconds)
    }

    /// The law's time up to which edges are judged, s; `None` to judge to its end.
    #[must_use]
    pub fn until_s(&self) -> Option<f64> {
        (self.endless || !self.is_all()).then_some(self.seconds)
    }
}

/// The result of a rehearsal in which every edge was right.
#[derive(Clone, Debug)]
pub struct Rehearsed {
    /// How much of the motion was played.
    pub length: Length,
    /// The promised bound on the error of each edge, ticks.
    pub bound_ticks: f64,
    /// The judge's figures for all edges.
    pub report: Report,
}

impl Rehearsed {
    /// The largest error of an edge, ticks, without [those that were put off](Rehearsed::put_off) by more than the bound.
    #[must_use]
    pub fn max_error_ticks(&self) -> f64 {
        self.report.motors.iter().map(|motor| motor.max_error_ticks.abs()).fold(0.0, f64::max)
    }

    /// How many steps came later than the bound because motors share a DIR line, and how much later than the law at most, ticks.
    #[must_use]
    pub fn put_off(&self) -> (u64, f64) {
        let steps = self.report.motors.iter().map(|motor| motor.steps_put_off).sum();
        (steps, self.report.motors.iter().map(|motor| motor.longest_put_off_ticks).fold(0.0, f64::max))
    }
}

/// A rehearsal that failed: the first error, and how fast the motors were then.
#[derive(Debug, thiserror::Error)]
#[error("rehearsed on the virtual {}, {what}", .kind.title())]
pub struct Failed {
    /// What went wrong.
    pub what: What,
    /// Each motor that turns at that time, and its speed by the law, steps/s.
    pub rates: Box<[(String, f64)]>,
    kind: BoardKind,
    /// The rate of the rehearsed line.
    baud: Baud,
}

/// What went wrong in a rehearsal.
#[derive(Debug, thiserror::Error)]
pub enum What {
    /// The board, or the session, did not go on.
    #[error("{why}{}", place(.why, *.at_s, .first.as_ref()))]
    Session {
        /// The error.
        why: Box<DriveError>,
        /// When it was noticed, s of the laws; `None` if the motion did not begin.
        at_s: Option<f64>,
        /// The first missing step, if the board stopped its motors at once.
        first: Option<Failure>,
    },
    /// A step is wrong, and the board reported no error.
    #[error("{0}")]
    Edge(Failure),
    /// The law cannot be evaluated, or the pins cannot be judged.
    #[error(transparent)]
    Judge(#[from] JudgeError),
}

impl What {
    fn session(error: DriveError, seen_s: Option<f64>, first: Option<Failure>) -> What {
        // The positions of virtual motors help nobody.
        let why = if let DriveError::Halted { why, .. } = error { why } else { Box::new(error) };
        let at_s = why.at_s().or(first.as_ref().map(|first| first.at_s)).or(seen_s);
        // Motors that brake leave their law: the judge then finds steps missing that are not the cause.
        let first = first.filter(|_| matches!(*why, DriveError::Remote(_)));
        What::Session { why, at_s, first }
    }

    /// When it went wrong, s of the laws.
    #[must_use]
    pub const fn at_s(&self) -> Option<f64> {
        match self {
            What::Session { at_s, .. } => *at_s,
            What::Edge(first) => Some(first.at_s),
            What::Judge(_) => None,
        }
    }
}

/// When it went wrong, for messages that do not have it yet.
fn place(why: &DriveError, at_s: Option<f64>, first: Option<&Failure>) -> String {
    match (why, first, at_s) {
        (DriveError::QueueTooShort { .. } | DriveError::TooLate { .. }, ..) | (_, None, None) => String::new(),
        (_, Some(first), _) => format!("; {first}"),
        (_, None, Some(at_s)) => format!(", at t = {at_s:.3} s"),
    }
}

/// The board that a program is for; the most common one if it has no firmware.
fn kind_of(program: &Program) -> BoardKind {
    BoardKind::named(&program.board.name).unwrap_or_default()
}

impl Failed {
    fn new(program: &Program, baud: Baud, what: What) -> Failed {
        Failed {
            rates: what.at_s().map(|at_s| rates(program, at_s).into()).unwrap_or_default(),
            what,
            kind: kind_of(program),
            baud,
        }
    }

    /// What the user can do.
    #[must_use]
    pub fn advice(&self) -> String {
        let moved = "this was a rehearsal: nothing was sent to the board at the port, and nothing has moved";
        if self.what.at_s().is_none() {
            return format!("{moved}. --no-rehearsal tries it on the board all the same");
        }
        let why = if let What::Session { why, .. } = &self.what { Some(&**why) } else { None };
        let is_short = matches!(why, Some(DriveError::QueueTooShort { .. }));
        let is_late = matches!(why, Some(DriveError::TooLate { .. }));
        let tolerance = if is_short { ", or another tolerance" } else { "" };
        let line = (is_short || is_late) && self.baud.rate() < FAST_BAUD;
        let line = if line { ", or a faster line (--baud)" } else { "" };
        format!("{moved}. What may do: {}{tolerance}{line}. --no-rehearsal begins all the same", slower(&self.rates))
    }
}

/// How fast each motor that turns is at a time of the laws, steps/s.
#[must_use]
pub fn rates(program: &Program, at_s: f64) -> Vec<(String, f64)> {
    let at = Time::from_seconds(at_s.max(0.0));
    let motors = program.motors.iter();
    let rates = motors.filter_map(move |motor| {
        let speed = Cursor::new(&motor.law).at(at).ok()?.speed.abs();
        (speed >= 1.0).then(|| (motor.name.clone(), speed))
    });
    rates.collect()
}

/// Advice for a board that has too much to do: slower motors, with their speeds then.
#[must_use]
pub fn slower(rates: &[(String, f64)]) -> String {
    let rates: Vec<String> =
        rates.iter().map(|(motor, rate)| format!("{motor} at {}", human::scaled(*rate, "steps/s"))).collect();
    let then = if rates.is_empty() { String::new() } else { format!(" (then {})", rates.join(", ")) };
    format!("slower motors{then}, or fewer that are fast at once")
}

/// Plays a motion on the virtual Uno as a run at `baud` would, as fast as this computer emulates it. `watch` gets the time that was reached, s.
///
/// # Errors
/// [`Failed`]: the first error. Nothing after it is played.
pub fn rehearse(
    prepared: &Prepared,
    baud: Baud,
    length: Length,
    mut watch: impl FnMut(f64),
) -> Result<Rehearsed, Failed> {
    let program = &prepared.program;
    let failed = |what| Failed::new(program, baud, what);
    let begun = Driven::on_virtual(kind_of(program), prepared, baud);
    let mut driven = begun.map_err(|error| failed(What::session(error, None, None)))?;
    let options = Edges::of(program).options(program, length.until_s());
    let judge = EdgeJudge::new(program.board.tick_hz, &driven.lines, program, &options);
    let (at_s, seen_s, broken) = (Cell::new(0.0), Cell::new(0.0), Cell::new(false));
    let mut observer =
        JudgingObserver { judge: judge.map_err(|error| failed(error.into()))?, broken: &broken, error: None };
    // A little longer than what is judged, so that a late edge is seen too.
    let until_s = length.until_s().map_or(f64::INFINITY, |until_s| until_s + STRIDE_S);
    // A board's report of a stop comes later than its edges. So after a wrong edge it gets one more stride before it is stopped. It is also stopped
    // at the end of what is judged. No command is sent while motors brake after a failure.
    let (orders, commands) = channel();
    let mut was_broken = false;
    let events = |event: Event| match event {
        Event::Progress { at_s: seconds } => {
            at_s.set(seconds);
            watch(seconds.min(length.seconds));
        }
        Event::Status(_) => {
            seen_s.set(at_s.get());
            if std::mem::replace(&mut was_broken, broken.get()) || at_s.get() > until_s {
                // This cannot fail: the run keeps the receiver.
                let _ = orders.send(Command::StopNow);
            }
        }
        _ => {}
    };
    let ended = driven.run_with(&commands, &mut observer, events);
    let JudgingObserver { judge, error, .. } = observer;
    let report = error.map_or_else(|| judge.finish(), Err).map_err(|error| failed(error.into()))?;
    let first = report.failures.iter().min_by(|one, other| one.at_s.total_cmp(&other.at_s)).cloned();
    match (ended, first) {
        (Err(error), first) => Err(failed(What::session(error, Some(seen_s.get()), first))),
        (Ok(_), Some(first)) => Err(failed(What::Edge(first))),
        (Ok(_), None) => Ok(Rehearsed { length, bound_ticks: options.bound_ticks.unwrap_or_default(), report }),
    }
}

/// Passes the pins' edges to the judge.
struct JudgingObserver<'a, 'b> {
    judge: EdgeJudge<'a>,
    /// Set once an edge was wrong or could not be judged: the run need not go on.
    broken: &'b Cell<bool>,
    error: Option<JudgeError>,
}

impl Observer for JudgingObserver<'_, '_> {
    fn edge(&mut self, edge: Edge) {
        if self.error.is_none() {
            let edge = pulsetrain_trace::Edge { tick: edge.tick, line: edge.line, level: edge.level };
            self.error = self.judge.push(edge).map_err(JudgeError::from).err();
        }
        self.broken.set(self.error.is_some() || self.judge.has_failed());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::{Knowledge, Positions};
    use pulsetrain_board::RemoteError;
    use pulsetrain_core::wire::message::Cause;
    use pulsetrain_trace::verdict::Fault;

    /// The time and the text for an error, where the first wrong step was due at 0.25 s.
    fn told(why: DriveError) -> (Option<f64>, String) {
        let halted = why.halted(0.3, Positions { motors: Vec::new(), by: Knowledge::Counted });
        let first = Failure { motor: "a".to_owned(), step: 7, at_s: 0.25, fault: Fault::Missing { forward: true } };
        let what = What::session(halted, Some(0.3), Some(first));
        (what.at_s(), what.to_string())
    }

    #[test]
    fn a_step_is_named_only_where_the_board_stopped_at_once() {
        let (at_s, said) = told(RemoteError::Stopped { cause: Cause::Starved }.into());
        let starved = "the board stopped: its step generator did not keep up; motor a: step 7 (forward) missing at t = 0.250000 s";
        assert_eq!((at_s, said.as_str()), (Some(0.25), starved));
        // These messages have their times already.
        let (at_s, said) = told(DriveError::TooLate { motor: "a".to_owned(), at_s: 0.24, late_s: 0.01 });
        assert!(at_s == Some(0.24) && said.contains("at 0.240 s") && !said.contains("t ="), "{said}");
        let short =
            DriveError::QueueTooShort { motor: "b".to_owned(), at_s: 0.5, capacity: 99, queue_bytes: Vec::new() };
        let (at_s, said) = told(short);
        assert!(
            at_s == Some(0.5) && said.contains("at 0.500 s") && said.contains("motor b") && !said.contains("t ="),
            "{said}"
        );
    }
}
