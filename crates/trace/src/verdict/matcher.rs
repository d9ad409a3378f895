//! Compares one motor's steps with the crossings of its law, both in order of time.

use std::collections::VecDeque;

use pulsetrain_motion::LawError;

use super::matches::Matches;
use super::report::{Fault, MotorReport};
use crate::crossing::{Crossing, Crossings, Instant};

/// Converts a trace's ticks to the law's: (tick − start)·(1 + rate).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Timebase {
    /// The tick of the trace at which the law's time is zero.
    pub(crate) start: Instant,
    /// How much faster the law's clock is than the trace's; 0 if they are the same clock.
    pub(crate) rate: f64,
}

impl Timebase {
    pub(crate) fn law(&self, tick: u64) -> Instant {
        let whole = (tick as i64).wrapping_sub(self.start.tick);
        Instant { tick: whole, fraction: whole as f64 * self.rate - self.start.fraction * (1.0 + self.rate) }
    }
}

/// How long after the last step crossings are searched for, s: an endless law may have none any more. A step that is
/// earlier than its crossing by more than that counts as extra.
pub(super) const HORIZON_S: f64 = 3600.0;

/// The largest errors of a step, in ticks of the trace.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    /// Largest error, early or late.
    pub(crate) bound: f64,
    /// Additional lateness of a step right after a change of a shared DIR line, or after another motor's step for which
    /// the board makes it wait.
    pub(crate) put_off: f64,
    /// Two opposite crossings that are closer than this may both have no step.
    pub(crate) pair: f64,
    /// How long after a change of DIR a step may be late for that reason.
    pub(crate) after_turn: u64,
    /// How long after another motor's step a step may be late, if the board makes the steps of motors one after the
    /// other.
    pub(crate) after_step: Option<u64>,
    /// Ticks of the board in one tick of the trace.
    pub(crate) scale: f64,
    /// Ticks of the trace per second.
    pub(crate) tick_hz: f64,
}

/// A step of the trace.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Made {
    pub(crate) tick: u64,
    pub(crate) at: Instant,
    pub(crate) forward: bool,
    /// Whether a change of DIR or another motor's step shortly before it may have delayed it.
    pub(crate) may_be_put_off: bool,
}

pub(crate) struct Matcher {
    crossings: Crossings,
    /// The next crossings. If the last one is optional, those after it are not known yet.
    wanted: VecDeque<Crossing>,
    made: VecDeque<Made>,
    limits: Limits,
    timebase: Timebase,
    last: Option<u64>,
    sums: Sums,
    error: Option<LawError>,
    /// Matched steps for a fit, if one is made.
    pub(crate) matches: Option<Matches>,
    /// Matched steps since the last call of [`Judge::errors`](super::Judge::errors), if they are kept: tick of the
    /// trace, lateness in ticks of the board.
    pub(crate) recent: Option<Vec<(u64, f64)>>,
    pub(crate) faults: Vec<(u64, f64, Fault)>,
    pub(crate) report: MotorReport,
}

/// Sums for the mean, deviation and slope of the errors; board ticks against trace ticks.
#[derive(Default)]
struct Sums {
    n: f64,
    mean_time: f64,
    mean_error: f64,
    time_squared: f64,
    time_error: f64,
    error_squared: f64,
    steps_squared: f64,
}

impl Sums {
    fn add(&mut self, time: f64, error: f64, steps: f64) {
        // Welford: no cancellation over 10^8 steps.
        self.n += 1.0;
        let off = time - self.mean_time;
        self.mean_time += off / self.n;
        self.mean_error += (error - self.mean_error) / self.n;
        self.time_squared += off * (time - self.mean_time);
        self.time_error += off * (error - self.mean_error);
        self.error_squared += error * error;
        self.steps_squared += steps * steps;
    }
}

impl Matcher {
    pub(crate) fn new(motor: &str, crossings: Crossings, limits: Limits, timebase: Timebase) -> Matcher {
        let report =
            MotorReport { motor: motor.to_owned(), bound_ticks: limits.bound * limits.scale, ..MotorReport::default() };
        Matcher {
            crossings,
            wanted: VecDeque::with_capacity(4),
            made: VecDeque::with_capacity(4),
            limits,
            timebase,
            last: None,
            sums: Sums::default(),
            error: None,
            matches: None,
            recent: None,
            faults: Vec::new(),
            report,
        }
    }

    /// Widens the bounds by the largest error of an alignment, ticks of the trace.
    pub(crate) fn widen(&mut self, slack: f64) {
        self.limits.bound += slack;
        self.report.bound_ticks = self.limits.bound * self.limits.scale;
    }

    /// Adds a step at a tick of the trace, with the ticks since DIR changed and since the last step of another motor.
    pub(crate) fn push(&mut self, tick: u64, forward: bool, since_dir: Option<u64>, since_other: Option<u64>) {
        if let Some(last) = self.last.replace(tick) {
            let interval = (tick - last) as f64 * self.limits.scale;
            if self.report.shortest_interval_ticks.is_none_or(|shortest| interval < shortest) {
                self.report.shortest_interval_ticks = Some(interval);
                self.report.peak_rate_hz = Some(self.limits.tick_hz / (tick - last) as f64);
            }
        }
        self.report.steps_got += 1;
        self.report.position_got += if forward { 1 } else { -1 };
        let follows_turn = since_dir.is_some_and(|since| since <= self.limits.after_turn);
        let follows_step = since_other.zip(self.limits.after_step).is_some_and(|(since, limit)| since <= limit);
        let may_be_put_off = follows_turn || follows_step;
        self.made.push_back(Made { tick, at: self.timebase.law(tick), forward, may_be_put_off });
        if self.made.len() > 2 {
            self.decide();
        }
    }

    /// Decides about all remaining steps and crossings. Crossings beyond `until` (law time, ticks of the trace) are not
    /// required.
    pub(crate) fn finish(&mut self, until: Option<Instant>) -> Result<(), LawError> {
        while !self.made.is_empty() && self.error.is_none() {
            self.decide();
        }
        loop {
            self.look_ahead(until);
            let Some(crossing) = self.wanted.front().copied() else { break };
            let slack = self.limits.bound + self.limits.put_off + crossing.uncertainty_ticks;
            if until.is_some_and(|until| crossing.at.minus(until) > -slack) {
                break;
            }
            if crossing.optional {
                self.settle(false);
            } else if let Some(pair) = self.droppable() {
                self.drop_pair(pair);
            } else {
                self.missing();
            }
        }
        // The crossing that `until` cut off does not count.
        self.report.position_wanted = self.wanted_position();
        if let Some(error) = self.error.take() {
            return Err(error);
        }
        if self.report.position_got != self.report.position_wanted {
            let fault = Fault::Position { got: self.report.position_got, wanted: self.report.position_wanted };
            let at = self.last.map_or(0.0, |tick| self.timebase.law(tick).ticks());
            self.fault(at, fault);
        }
        let (sums, r, us) = (&self.sums, &mut self.report, 1e6 / (self.limits.tick_hz * self.limits.scale));
        if sums.n > 0.0 {
            r.rms_error_ticks = (sums.error_squared / sums.n).sqrt();
            r.rms_error_us = r.rms_error_ticks * us;
            r.rms_error_steps = (sums.steps_squared / sums.n).sqrt();
        }
        r.max_error_us = r.max_error_ticks * us;
        if sums.time_squared > 0.0 {
            // Ticks of the board per tick of the trace, to ticks per tick.
            let slope = sums.time_error / sums.time_squared / self.limits.scale;
            r.drift_ppm = slope * 1e6;
            r.drift_ticks_per_hour = slope * 3600.0 * self.limits.tick_hz * self.limits.scale;
        }
        Ok(())
    }

    /// The law's position after the crossings that have been decided.
    fn wanted_position(&self) -> i64 {
        let ahead: i64 = self.wanted.iter().filter(|c| !c.optional).map(|c| if c.forward { 1 } else { -1 }).sum();
        self.crossings.position() - ahead
    }

    /// Fills `wanted` with the next three crossings, or up to an optional one, or with those up to `until`.
    fn look_ahead(&mut self, until: Option<Instant>) {
        while self.error.is_none() && self.wanted.len() < 3 && self.wanted.back().is_none_or(|c| !c.optional) {
            let next = match until {
                Some(until) => self.crossings.advance_until(until),
                None => self.crossings.advance(),
            };
            match next {
                Ok(Some(crossing)) => self.wanted.push_back(crossing),
                Ok(None) => break,
                Err(error) => self.error = Some(error),
            }
        }
    }

    /// Lateness in ticks of the trace; 0 within the precision of f64.
    fn late(&self, made: Made, wanted: Crossing) -> f64 {
        let late = made.at.minus(wanted.at);
        late.signum() * (late.abs() - wanted.uncertainty_ticks).max(0.0)
    }

    /// How much later than the bound this step may be because of other motors.
    fn put_off(&self, made: Made) -> f64 {
        if made.may_be_put_off { self.limits.put_off } else { 0.0 }
    }

    fn in_time(&self, made: Made, wanted: Crossing) -> bool {
        // The slack covers the rounding of the bound itself.
        let late = self.late(made, wanted);
        -self.limits.bound - 1e-6 <= late && late <= self.limits.bound + self.put_off(made) + 1e-6
    }

    /// Decides about the first step, or about the crossings that come before it.
    fn decide(&mut self) {
        let until = self.made.back().map(|made| made.at.plus(HORIZON_S * self.limits.tick_hz));
        loop {
            self.look_ahead(until);
            let Some(&made) = self.made.front() else { return };
            let Some(&wanted) = self.wanted.front() else {
                if self.error.is_none() {
                    self.extra(made);
                }
                self.made.pop_front();
                return;
            };
            let fits = |made: Option<&Made>, wanted: Option<&Crossing>| match (made, wanted) {
                (Some(made), Some(wanted)) => made.forward == wanted.forward && self.in_time(*made, *wanted),
                _ => false,
            };
            let nearer = |made: Option<&Made>, wanted: Option<&Crossing>, than: f64| match (made, wanted) {
                (Some(made), Some(wanted)) => {
                    made.forward == wanted.forward && made.at.minus(wanted.at).abs() < than.abs()
                }
                _ => false,
            };
            let late = made.at.minus(wanted.at);
            let next_wanted = self.wanted.get(1);
            let next_made = self.made.get(1);
            if fits(Some(&made), Some(&wanted)) {
                return self.matched(made, wanted);
            }
            if wanted.optional {
                self.settle(false);
            } else if let Some(pair) = self.droppable() {
                self.drop_pair(pair);
            } else if fits(Some(&made), next_wanted) {
                self.missing();
            } else if fits(next_made, Some(&wanted)) {
                self.extra(made);
                self.made.pop_front();
                return;
            } else if made.forward != wanted.forward && self.in_time(made, wanted) {
                self.wrong_direction(made);
                return;
            } else if made.forward != wanted.forward {
                if late < 0.0 {
                    self.extra(made);
                    self.made.pop_front();
                    return;
                }
                self.missing();
            } else if nearer(Some(&made), next_wanted, late) {
                self.missing();
            } else if nearer(next_made, Some(&wanted), late) {
                self.extra(made);
                self.made.pop_front();
                return;
            } else {
                return self.matched(made, wanted);
            }
        }
    }

    /// Decides whether the optional crossing in front has a step.
    fn settle(&mut self, made: bool) {
        self.wanted.pop_front();
        self.crossings.settle(made);
    }

    fn matched(&mut self, made: Made, wanted: Crossing) {
        self.made.pop_front();
        if wanted.optional {
            self.settle(true);
        } else {
            self.wanted.pop_front();
        }
        self.report.steps_wanted += 1;
        let late = self.late(made, wanted);
        let put_off = self.put_off(made) > 0.0;
        if let Some(matches) = &mut self.matches {
            let near = late.abs() <= 2.0 * self.limits.bound && !put_off;
            matches.push((made.tick, made.at.minus(wanted.at)), near);
        }
        if let Some(recent) = &mut self.recent {
            recent.push((made.tick, late * self.limits.scale));
        }
        if late > self.limits.bound && self.in_time(made, wanted) {
            self.report.steps_put_off += 1;
            let ticks = late * self.limits.scale;
            self.report.longest_put_off_ticks = self.report.longest_put_off_ticks.max(ticks);
            return;
        }
        let ticks = late * self.limits.scale;
        let steps = late / self.limits.tick_hz * wanted.speed;
        self.sums.add(wanted.at.ticks(), ticks, steps);
        if ticks.abs() > self.report.max_error_ticks.abs() {
            self.report.max_error_ticks = ticks;
            self.report.max_error_at_s = wanted.at.ticks() / self.limits.tick_hz;
        }
        if steps.abs() > self.report.max_error_steps.abs() {
            self.report.max_error_steps = steps;
        }
        if !self.in_time(made, wanted) {
            self.report.off_time += 1;
            self.fault(wanted.at.ticks(), Fault::OffTime { error_ticks: ticks, limit_ticks: self.report.bound_ticks });
        }
    }

    fn missing(&mut self) {
        let Some(wanted) = self.wanted.pop_front() else { return };
        self.report.steps_wanted += 1;
        self.report.missing += 1;
        self.fault(wanted.at.ticks(), Fault::Missing { forward: wanted.forward });
    }

    fn extra(&mut self, made: Made) {
        self.report.extra += 1;
        self.fault(made.at.ticks(), Fault::Extra { forward: made.forward });
    }

    fn wrong_direction(&mut self, made: Made) {
        self.made.pop_front();
        self.wanted.pop_front();
        self.report.steps_wanted += 1;
        self.report.wrong_direction += 1;
        self.fault(made.at.ticks(), Fault::WrongDirection { forward: made.forward });
    }

    /// The first two crossings, if a plan may drop both.
    fn droppable(&self) -> Option<[Crossing; 2]> {
        let (first, second) = (*self.wanted.front()?, *self.wanted.get(1)?);
        let close = second.at.minus(first.at) <= self.limits.pair + 2.0 * self.limits.bound;
        (first.forward != second.forward && !second.optional && close).then_some([first, second])
    }

    fn drop_pair(&mut self, [first, second]: [Crossing; 2]) {
        self.wanted.drain(..2);
        self.report.pairs_dropped += 1;
        let off = second.farthest + if first.forward { 1.0 } else { -1.0 };
        self.report.worst_position_error = self.report.worst_position_error.max(off.abs());
    }

    /// Adds a fault, with the number of its step and its time (law's ticks).
    pub(crate) fn fault(&mut self, at_ticks: f64, fault: Fault) {
        self.report.faults += 1;
        if self.faults.len() < super::MOST_FAULTS {
            let step = self.report.steps_wanted.max(1);
            self.faults.push((step, at_ticks / self.limits.tick_hz, fault));
        }
    }
}
