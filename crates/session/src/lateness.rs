//! How late the STEP edges of a board are, each compared with the tick that was scheduled for it.
//!
//! Lateness is edge tick − scheduled tick − the board's constant. Scheduled ticks come from a native board that gets the same items as the board
//! (`WithReference`), edges from the board's pins. For each motor both come in order, but edges may come before or after their schedule.

use std::collections::{BTreeMap, VecDeque};

use pulsetrain_motion::boards::EdgeDelay;
use pulsetrain_motion::program::Program;
use pulsetrain_trace::verdict::Options;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Collects the lateness of every step.
///
/// ```
/// use pulsetrain_session::lateness::Meter;
/// let mut meter = Meter::new(1, 17);
/// for scheduled in [100, 300, 500] {
///     meter.scheduled(0, scheduled);
/// }
/// for edge in [117, 519] {
///     meter.edge(0, edge);
/// }
/// let lateness = meter.finish();
/// assert_eq!((lateness.edges, lateness.max_ticks, lateness.lost, lateness.extra), (2, 2, 1, 0));
/// ```
#[derive(Clone, Debug)]
pub struct Meter {
    constant_ticks: u64,
    motors: Vec<Pending>,
    /// By lateness in ticks: how many edges were that late.
    counts: BTreeMap<i64, u64>,
    lost: u64,
    extra: u64,
}

/// A motor's scheduled ticks and edges that are not matched yet.
#[derive(Clone, Debug, Default)]
struct Pending {
    scheduled: VecDeque<u64>,
    edges: VecDeque<u64>,
}

/// The lateness of a run.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Lateness {
    /// Edge tick − scheduled tick of an edge that is not late, ticks: the board's constant.
    pub constant_ticks: u64,
    /// STEP edges that were matched.
    pub edges: u64,
    /// Least lateness, ticks; negative for an early edge.
    pub min_ticks: i64,
    /// Median lateness, ticks.
    pub p50_ticks: i64,
    /// 99th percentile of the lateness, ticks.
    pub p99_ticks: i64,
    /// Greatest lateness, ticks.
    pub max_ticks: i64,
    /// Scheduled steps without an edge.
    pub lost: u64,
    /// Edges without a scheduled step.
    pub extra: u64,
}

impl Meter {
    /// A meter for so many motors, on a board whose edges come `constant_ticks` after their scheduled ticks.
    #[must_use]
    pub fn new(motors: usize, constant_ticks: u64) -> Meter {
        let motors = vec![Pending::default(); motors];
        Meter { constant_ticks, motors, counts: BTreeMap::new(), lost: 0, extra: 0 }
    }

    /// Notes that a step of a motor is scheduled for `tick`. The ticks of a motor must not descend. Motors that are not there are ignored.
    pub fn scheduled(&mut self, motor: usize, tick: u64) {
        if let Some(pending) = self.motors.get_mut(motor) {
            pending.scheduled.push_back(tick + self.constant_ticks);
            self.settle(motor, false);
        }
    }

    /// Notes that a motor's STEP rose at `tick`. The ticks of a motor must not descend. Motors that are not there are ignored.
    pub fn edge(&mut self, motor: usize, tick: u64) {
        if let Some(pending) = self.motors.get_mut(motor) {
            pending.edges.push_back(tick);
            self.settle(motor, false);
        }
    }

    /// Matches what is left, as no step and no edge comes any more.
    #[must_use]
    pub fn finish(mut self) -> Lateness {
        for motor in 0..self.motors.len() {
            self.settle(motor, true);
            self.lost += self.motors[motor].scheduled.len() as u64;
        }
        self.so_far()
    }

    /// The lateness of what was matched so far.
    #[must_use]
    pub fn so_far(&self) -> Lateness {
        let edges = self.counts.values().sum();
        Lateness {
            constant_ticks: self.constant_ticks,
            edges,
            min_ticks: self.counts.keys().next().copied().unwrap_or(0),
            p50_ticks: self.percentile(edges, 50),
            p99_ticks: self.percentile(edges, 99),
            max_ticks: self.counts.keys().next_back().copied().unwrap_or(0),
            lost: self.lost,
            extra: self.extra,
        }
    }

    /// Matches each edge with the nearest step, as far as the next ones are known; `all` matches the rest too.
    fn settle(&mut self, motor: usize, all: bool) {
        let Pending { scheduled, edges } = &mut self.motors[motor];
        while let Some(&edge) = edges.front() {
            // The nearest step is known once the next edge and a later step have come.
            if !all && (edges.len() < 2 || scheduled.back().is_none_or(|last| *last <= edge)) {
                return;
            }
            edges.pop_front();
            while let [Some(this), Some(next)] = [scheduled.front(), scheduled.get(1)]
                && next.abs_diff(edge) < this.abs_diff(edge)
            {
                scheduled.pop_front();
                self.lost += 1;
            }
            // If the next edge is nearer to this step, this edge has no step.
            let Some(&due) = scheduled.front() else {
                self.extra += 1;
                continue;
            };
            if edges.front().is_some_and(|next| next.abs_diff(due) < edge.abs_diff(due)) {
                self.extra += 1;
                continue;
            }
            scheduled.pop_front();
            *self.counts.entry(edge as i64 - due as i64).or_default() += 1;
        }
    }

    /// The lateness that `percent` of the edges do not exceed.
    fn percentile(&self, edges: u64, percent: u64) -> i64 {
        let rank = (edges * percent).div_ceil(100);
        let mut seen = 0;
        let found = self.counts.iter().find(|(_, count)| {
            seen += **count;
            seen >= rank
        });
        found.map_or(0, |(late, _)| *late)
    }
}

/// How long after its scheduled tick a STEP edge may come.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Edges {
    /// The board's constant, ticks.
    pub constant_ticks: u32,
    /// How much later they may be, ticks.
    pub late_ticks: u32,
}

impl Edges {
    /// The values of a program's board, for the pins that the program uses.
    #[must_use]
    pub fn of(program: &Program) -> Edges {
        let EdgeDelay { constant_ticks, late_ticks } = program.board.profile.edge_delay(&program.motors);
        Edges { constant_ticks, late_ticks }
    }

    /// How the edges of a run are judged, with ticks from the laws' time 0: up to `until_s` of the laws, or to their end.
    #[must_use]
    pub fn options(&self, program: &Program, until_s: Option<f64>) -> Options {
        Options {
            constant_ticks: i64::from(self.constant_ticks),
            bound_ticks: Some(program.tolerance.ticks(program.board.tick_hz) + f64::from(self.late_ticks)),
            until_s,
            ..Options::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One motor: all edges first and then the schedule, and the other way round, must give the same.
    fn check(scheduled: &[u64], edges: &[u64], expected: (u64, i64, i64, u64, u64)) {
        for edges_first in [false, true] {
            let mut meter = Meter::new(1, 10);
            let mut say = |as_edges: bool| {
                let ticks = if as_edges { edges } else { scheduled };
                ticks.iter().for_each(|tick| if as_edges { meter.edge(0, *tick) } else { meter.scheduled(0, *tick) });
            };
            say(edges_first);
            say(!edges_first);
            let got = meter.finish();
            assert_eq!((got.edges, got.min_ticks, got.max_ticks, got.lost, got.extra), expected, "{edges_first}");
        }
    }

    #[test]
    fn each_edge_goes_with_its_step() {
        check(&[100, 200, 300], &[110, 215, 310], (3, 0, 5, 0, 0));
        check(&[100, 200, 300], &[110, 310], (2, 0, 0, 1, 0));
        check(&[100, 200, 300], &[], (0, 0, 0, 3, 0));
        check(&[], &[110], (0, 0, 0, 0, 1));
        check(&[100, 200], &[110, 160, 210], (2, 0, 0, 0, 1));
        check(&[100, 200], &[105, 210], (2, -5, 0, 0, 0));
    }

    #[test]
    fn percentiles_are_those_of_all_edges() {
        let mut meter = Meter::new(2, 0);
        for k in 0..100 {
            meter.scheduled(k % 2, 1000 * k as u64);
            meter.edge(k % 2, 1000 * k as u64 + k as u64);
        }
        let lateness = meter.finish();
        assert_eq!((lateness.p50_ticks, lateness.p99_ticks, lateness.max_ticks, lateness.lost), (49, 98, 99, 0));
    }
}
