//! Alignment of a trace with the law: the time zero of the law in the trace, and the rate of the trace's clock.

use pulsetrain_motion::program::Program;

use super::matcher::{HORIZON_S, Timebase};
use super::matches::{Match, Matches};
use super::{Align, Judge, JudgeError, Options, Report};
use crate::crossing::{Crossings, Instant};
use crate::decode::Event;

/// Steps for the first guess of the rate. The number then doubles until all steps are used.
const FIRST: u64 = 32;

/// Passes all events up to a tick of the trace to a judge.
pub(super) type Feed<'f> = dyn FnMut(&mut dyn Listener, Option<u64>) -> Result<(), JudgeError> + 'f;

/// Receives the events of a trace.
pub(super) trait Listener {
    fn event(&mut self, motor: usize, tick: u64, event: Event);
}

impl Listener for Judge<'_> {
    fn event(&mut self, motor: usize, tick: u64, event: Event) {
        Judge::event(self, motor, tick, event);
    }
}

/// The timebase that follows from the options alone.
pub(super) fn given(tick_hz: u64, program: &Program, options: &Options) -> Timebase {
    // The conversion is exact if both have the same clock.
    let (trace, board) = (i128::from(tick_hz), i128::from(program.board.tick_hz));
    let scaled = i128::from(options.constant_ticks) * trace;
    let (whole, rest) = (scaled.div_euclid(board.max(1)), scaled.rem_euclid(board.max(1)));
    Timebase { start: Instant { tick: whole as i64, fraction: rest as f64 / board.max(1) as f64 }, rate: 0.0 }
}

/// Fits the timebase as the options demand, then judges.
pub(super) fn judge(
    tick_hz: u64,
    program: &Program,
    options: &Options,
    feed: &mut Feed<'_>,
) -> Result<Report, JudgeError> {
    let mut timebase = given(tick_hz, program, options);
    let mut slack = 0.0;
    if options.align != Align::None {
        let mut first = First { steps: vec![Vec::new(); program.motors.len()], last: 0 };
        feed(&mut first, None)?;
        timebase = first.guess(tick_hz, program, timebase)?;
        let mut matched = |timebase, until| {
            let mut judge = Judge::new(tick_hz, program, options, timebase)?;
            judge.motors.iter_mut().for_each(|matcher| matcher.matches = Some(Matches::default()));
            feed(&mut judge, until)?;
            Ok::<Matches, JudgeError>(
                judge.motors.into_iter().filter_map(|m| m.matches).fold(Matches::default(), Matches::and),
            )
        };
        let rate = options.align == Align::StartAndRate;
        let begin = first.ticks().min().unwrap_or(0);
        let mut span = first.ticks().max().unwrap_or(0) - begin;
        loop {
            let limit = begin.saturating_add(span);
            timebase = refit(timebase, &matched(timebase, Some(limit))?.kept, rate);
            if limit >= first.last {
                break;
            }
            // A shift is known from the first steps. A rate must be so close that no step is mistaken for its
            // neighbour.
            span = if rate { (2 * span).max(1) } else { first.last };
        }
        // A plan may lean to one side within its bound, so that the middle of the errors is better than their mean.
        let (shift, doubt) = matched(timebase, None)?.middle();
        timebase.start = timebase.start.plus(shift / (1.0 + timebase.rate));
        slack = doubt;
    }
    let mut judge = Judge::new(tick_hz, program, options, timebase)?;
    judge.motors.iter_mut().for_each(|matcher| matcher.widen(slack));
    feed(&mut judge, None)?;
    judge.finish(&mut |_, _, _| {})
}

/// The first steps of each motor, and the end of the trace.
struct First {
    steps: Vec<Vec<u64>>,
    last: u64,
}

impl Listener for First {
    fn event(&mut self, motor: usize, tick: u64, event: Event) {
        self.last = self.last.max(tick);
        if let (Event::Step { .. }, steps) = (event, &mut self.steps[motor])
            && (steps.len() as u64) < FIRST
        {
            steps.push(tick);
        }
    }
}

impl First {
    fn ticks(&self) -> impl Iterator<Item = u64> {
        self.steps.iter().flatten().copied()
    }

    /// The shift that brings the first steps to the first crossings, one by one.
    fn guess(&self, tick_hz: u64, program: &Program, given: Timebase) -> Result<Timebase, JudgeError> {
        let mut late = Vec::new();
        let until = given.law(self.last).plus(HORIZON_S * tick_hz as f64);
        for (steps, motor) in self.steps.iter().zip(&program.motors) {
            let mut crossings = Crossings::new(&motor.law, program.grid, tick_hz.max(1));
            for &tick in steps {
                let crossing = crossings
                    .advance_until(until)
                    .map_err(|error| JudgeError::Law { motor: motor.name.clone(), error })?;
                let Some(crossing) = crossing else { break };
                crossings.settle(true);
                late.push(given.law(tick).minus(crossing.at));
            }
        }
        Ok(median(&mut late).map_or(given, |shift| Timebase { start: given.start.plus(shift), ..given }))
    }
}

fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// The timebase without the median error, or without the line through the errors that are no outliers.
fn refit(timebase: Timebase, matches: &[Match], rate: bool) -> Timebase {
    let mut late: Vec<f64> = matches.iter().map(|(_, late)| *late).collect();
    let Some(middle) = median(&mut late) else { return timebase };
    let (mut shift, mut slope, mut about) = (middle, 0.0, 0.0);
    if rate {
        late.iter_mut().for_each(|late| *late = (*late - middle).abs());
        // Twice as far as a straight line through 0 leads from its median, or some ticks of noise.
        let far = 4.0 * median(&mut late).unwrap_or(0.0) + 4.0;
        let near =
            || matches.iter().filter(|(_, late)| (late - middle).abs() <= far).map(|(t, late)| (*t as f64, *late));
        let n = near().count() as f64;
        about = near().map(|(t, _)| t).sum::<f64>() / n;
        shift = near().map(|(_, late)| late).sum::<f64>() / n;
        let square: f64 = near().map(|(t, _)| (t - about) * (t - about)).sum();
        if square > 0.0 {
            slope = near().map(|(t, late)| (t - about) * (late - shift)).sum::<f64>() / square;
        }
    }
    // law'(T) = law(T) − shift − slope·(T − about)
    let begin = timebase.start.ticks();
    let faster = 1.0 + timebase.rate - slope;
    let moved = if rate { (shift + slope * (begin - about)) / faster } else { shift / faster };
    Timebase { start: timebase.start.plus(moved), rate: timebase.rate - slope }
}
