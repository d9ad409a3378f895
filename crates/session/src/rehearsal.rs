//! A motion's session with the virtual Uno, played before a real one is sent anything: each edge of its pins against the law, and what the
//! board and the session themselves say.
//!
//! The planner holds steps, segments and the line against limits (`pulsetrain_plan::line`). What an Uno's one core does beside its steps, for these
//! motors at these moments, no limit has: it is tried, as for what is baked.
//!
//! Only for an Uno, whose queues hold 400 bytes in all and whose one core does everything. A Pico has 32 kB of them, and its pins are timed by
//! state machines.

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

/// It is looked at so often, s: whether the lamp shines, and how far it is.
pub const STRIDE_S: f64 = 0.05;

/// What is played at most, if nobody says how much, s.
pub const MOST_S: f64 = 10.0;

/// A line as fast as that is not what is waited for.
const FAST_BAUD: u32 = Baud::B1M.rate();

/// How much of a motion is played.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Length {
    /// Of the laws' time, s.
    pub seconds: f64,
    /// What there is to see, s: all of it, or, where motors repeat, each of their phases to one another. `None`: there are ever new ones.
    pub all_s: Option<f64>,
    /// Some motor goes on for ever.
    pub endless: bool,
}

impl Length {
    /// What is played at most, if nobody says how much, s.
    pub const MOST_S: f64 = 60.0;

    /// As much as there is to see, or [`MOST_S`](Length::MOST_S).
    #[must_use]
    pub fn of(program: &Program) -> Length {
        let whole = Length::exactly(program, f64::INFINITY);
        Length { seconds: whole.all_s.unwrap_or(f64::INFINITY).min(Length::MOST_S), ..whole }
    }

    /// So much, or all of a motion that is over before.
    #[must_use]
    pub fn exactly(program: &Program, seconds: f64) -> Length {
        let laws = || program.motors.iter().map(|motor| &motor.law);
        let ends = laws().filter_map(|law| law.end()).fold(Time::ZERO, Time::max);
        let (from, periods): (Vec<Time>, Vec<Time>) = laws().filter_map(|law| law.cycle()).unzip();
        let Some(longest) = periods.iter().max() else {
            return Length { seconds: seconds.min(ends.seconds()), all_s: Some(ends.seconds()), endless: false };
        };
        // Once all repeat, each phase; and two turns more, since what comes between two of them is made apart.
        let once = from.into_iter().fold(ends, Time::max);
        let all = common_period(&periods).map(|common| once + common + longest.times(2));
        Length { seconds, all_s: all.map(Time::seconds), endless: true }
    }

    /// Whether it is all that there is to see.
    #[must_use]
    pub fn is_all(&self) -> bool {
        self.all_s.is_some_and(|all| all <= self.seconds)
    }

    /// The law's time up to which edges are looked for; `None`: to its end.
    #[must_use]
    pub fn until_s(&self) -> Option<f64> {
        (self.endless || !self.is_all()).then_some(self.seconds)
    }
}

/// A motion that was played as it should be.
#[derive(Clone, Debug)]
pub struct Rehearsed {
    /// How much of it.
    pub length: Length,
    /// What is promised of each edge, ticks.
    pub bound_ticks: f64,
    /// What the judge says of all.
    pub report: Report,
}

impl Rehearsed {
    /// The furthest that an edge was off, ticks, but for [those that were put off](Rehearsed::put_off) by more than is promised.
    #[must_use]
    pub fn max_error_ticks(&self) -> f64 {
        self.report.motors.iter().map(|motor| motor.max_error_ticks.abs()).fold(0.0, f64::max)
    }

    /// How many steps came later than that because motors share a DIR line, and how far behind the law at most, ticks.
    #[must_use]
    pub fn put_off(&self) -> (u64, f64) {
        let steps = self.report.motors.iter().map(|motor| motor.steps_put_off).sum();
        (steps, self.report.motors.iter().map(|motor| motor.longest_put_off_ticks).fold(0.0, f64::max))
    }
}

/// A session that did not go as it should.
#[derive(Debug, thiserror::Error)]
#[error("rehearsed on the virtual Uno, {what}")]
pub struct Failed {
    /// In which way.
    pub what: What,
    /// How fast each motor is then, by the law, steps/s.
    pub rates: Vec<(String, f64)>,
    /// Of the line.
    baud: Baud,
}

/// What went wrong.
#[derive(Debug, thiserror::Error)]
pub enum What {
    /// The board, or the session, did not go on.
    #[error("{why}{}", place(.why, *.at_s, .first.as_ref()))]
    Session {
        /// Why.
        why: Box<DriveError>,
        /// When that was seen, s of the laws; `None`: it did not begin.
        at_s: Option<f64>,
        /// If the board stopped its motors at once: the first step that was not made.
        first: Option<Failure>,
    },
    /// A step is not as it should be, and the board says nothing of it.
    #[error("{0}")]
    Edge(Failure),
    /// The law breaks, or pins that cannot be judged.
    #[error(transparent)]
    Judge(#[from] JudgeError),
}

impl What {
    fn session(error: DriveError, seen_s: Option<f64>, first: Option<Failure>) -> What {
        // Where the virtual motors are is nobody's concern.
        let why = if let DriveError::Halted { why, .. } = error { why } else { Box::new(error) };
        let at_s = why.at_s().or(first.as_ref().map(|first| first.at_s)).or(seen_s);
        // Motors that come to rest as planned only seem to be late then.
        let first = first.filter(|_| matches!(*why, DriveError::Remote(_)));
        What::Session { why, at_s, first }
    }

    /// The laws' time.
    #[must_use]
    pub const fn at_s(&self) -> Option<f64> {
        match self {
            What::Session { at_s, .. } => *at_s,
            What::Edge(first) => Some(first.at_s),
            What::Judge(_) => None,
        }
    }
}

/// When it was, where that is not said yet.
fn place(why: &DriveError, at_s: Option<f64>, first: Option<&Failure>) -> String {
    match (why, first, at_s) {
        (DriveError::QueueTooShort { .. } | DriveError::TooLate { .. }, ..) | (_, None, None) => String::new(),
        (_, Some(first), _) => format!("; {first}"),
        (_, None, Some(at_s)) => format!(", at t = {at_s:.3} s"),
    }
}

impl Failed {
    fn new(program: &Program, baud: Baud, what: What) -> Failed {
        Failed { rates: what.at_s().map(|at_s| rates(program, at_s)).unwrap_or_default(), what, baud }
    }

    /// What would do.
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

/// What a board has less to do with, where its motors are as fast as that.
#[must_use]
pub fn slower(rates: &[(String, f64)]) -> String {
    let rates: Vec<String> =
        rates.iter().map(|(motor, rate)| format!("{motor} at {}", human::scaled(*rate, "steps/s"))).collect();
    let then = if rates.is_empty() { String::new() } else { format!(" (then {})", rates.join(", ")) };
    format!("slower motors{then}, or fewer that are fast at once")
}

/// Plays a motion as a run at `baud` tells it, as fast as the virtual Uno goes. `watch` hears how far it is, s.
///
/// # Errors
/// [`Failed`]: the first thing that went wrong; what comes behind it is not played.
pub fn rehearse(
    prepared: &Prepared,
    baud: Baud,
    length: Length,
    mut watch: impl FnMut(f64),
) -> Result<Rehearsed, Failed> {
    let program = &prepared.program;
    let failed = |what| Failed::new(program, baud, what);
    let begun = Driven::on_virtual(BoardKind::Uno, prepared, baud);
    let mut driven = begun.map_err(|error| failed(What::session(error, None, None)))?;
    let options = Edges::of(program).options(program, length.until_s());
    let judge = EdgeJudge::new(program.board.tick_hz, &driven.lines, program, &options);
    let (at_s, seen_s, broken) = (Cell::new(0.0), Cell::new(0.0), Cell::new(false));
    let mut looker = Looker { judge: judge.map_err(|error| failed(error.into()))?, broken: &broken, error: None };
    // A little longer than is looked at, so that an edge that is late is seen.
    let until_s = length.until_s().map_or(f64::INFINITY, |until_s| until_s + STRIDE_S);
    // What the board says of a stop comes later than its edges: it has one stretch for that. Then, or at the end of what is looked at, it
    // is stopped. Nothing is sent while motors come to rest after a failure.
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
                // The run holds the other end.
                let _ = orders.send(Command::StopNow);
            }
        }
        _ => {}
    };
    let ended = driven.run_with(&commands, &mut looker, events);
    let Looker { judge, error, .. } = looker;
    let report = error.map_or_else(|| judge.finish(), Err).map_err(|error| failed(error.into()))?;
    let first = report.failures.iter().min_by(|one, other| one.at_s.total_cmp(&other.at_s)).cloned();
    match (ended, first) {
        (Err(error), first) => Err(failed(What::session(error, Some(seen_s.get()), first))),
        (Ok(_), Some(first)) => Err(failed(What::Edge(first))),
        (Ok(_), None) => Ok(Rehearsed { length, bound_ticks: options.bound_ticks.unwrap_or_default(), report }),
    }
}

/// Holds the pins' edges against the law.
struct Looker<'a, 'b> {
    judge: EdgeJudge<'a>,
    /// There is something to tell: no need to go on.
    broken: &'b Cell<bool>,
    error: Option<JudgeError>,
}

impl Observer for Looker<'_, '_> {
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
    use crate::drive::{Knowledge, Positions};
    use pulsetrain_board::RemoteError;
    use pulsetrain_core::wire::message::Cause;
    use pulsetrain_trace::verdict::Fault;

    /// What is told of an error, where the first step that is not as it should be was due at 0.25 s.
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
        // They have their times already.
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
