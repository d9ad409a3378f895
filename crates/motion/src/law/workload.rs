//! A quick estimate of how many steps and pieces a law has, before it is planned.

use super::formula::Formula;
use super::{Law, Piece};
use crate::{Time, whole_power};
use std::sync::Arc;

/// An estimate of a law's steps and pieces. A law that repeats is looked at for one period, a formula for its first pieces and at places all
/// over its span, any other law for its first pieces only.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Workload {
    /// Steps in both directions.
    pub steps: f64,
    /// Pieces.
    pub pieces: f64,
    /// Times that it turns within pieces.
    pub turns: f64,
    /// Operations of formulas. A piece takes all operations of its formula, and so does each turn.
    pub operations: f64,
}

/// The most pieces of a law that are looked at. Of a list of pieces all are.
const MOST_PIECES: usize = 256;
/// The same for a winch's path, whose pieces last a millisecond, and whose commands come in its first seconds.
const MOST_PIECES_OF_A_WINCH: usize = 1 << 15;
/// Samples in each of them.
const LOOKS: u32 = 64;
/// The number of places where a formula is looked at after its first pieces.
const PLACES: u32 = 64;
/// Samples in each window of a formula: as many as its operations allow. A window may have any number of periods, so these are primes,
/// which do not meet equal phases again and again.
const LOOKS_IN_A_WINDOW: [u32; 5] = [251, 127, 61, 31, 13];
/// Operations of a formula in all samples of its places, and in those of its first pieces: some 10 ms of work.
const MOST_OPERATIONS: u32 = 1 << 19;

impl Law {
    /// An estimate up to `until`. It takes no longer for a longer law.
    ///
    /// ```
    /// use pulsetrain_motion::{Law, Time};
    /// // A hundred periods of 400 steps up and 400 down, over and over.
    /// let law = Law::sine(200.0, Time::SECOND, Some(100))?.repeated(Some(1 << 50))?;
    /// let workload = law.workload(law.end().unwrap());
    /// assert!((workload.steps / (80_000.0 * 2f64.powi(50)) - 1.0).abs() < 1e-9);
    /// assert!((workload.pieces / (200.0 * 2f64.powi(50)) - 1.0).abs() < 1e-9);
    /// # Ok::<(), pulsetrain_motion::LawError>(())
    /// ```
    #[must_use]
    pub fn workload(&self, until: Time) -> Workload {
        let until = self.end().map_or(until, |end| end.min(until));
        if until <= Time::ZERO {
            return Workload::default();
        }
        match self {
            Law::Sum(laws) => laws.iter().map(|law| law.workload(until)).fold(Workload::default(), Workload::and),
            Law::Then(laws) => {
                let mut left = until;
                let parts = laws.iter().map(|law| {
                    let part = law.workload(left);
                    left = left - law.end().unwrap_or(left);
                    part
                });
                parts.fold(Workload::default(), Workload::and)
            }
            Law::Changed(changed) => changed.workload(until),
            Law::Repeated(repeated) if until > repeated.period => {
                repeated.law.workload(repeated.period).times(until.seconds() / repeated.period.seconds())
            }
            Law::Repeated(repeated) => repeated.law.workload(until),
            Law::Blended(blended) => blended.law().workload(until),
            Law::Warped(warped) => warped.law().workload(until),
            Law::Faded(faded) => faded.new_law().workload(until),
            Law::Arm(arm) => match arm.law() {
                Some(law) => law.workload(until),
                None => self.first_pieces(until, MOST_PIECES),
            },
            Law::Backlash(backlash) => {
                // A piece has about one turn.
                let law = backlash.law().workload(until);
                Workload { pieces: 2.0 * law.pieces, ..law }
            }
            Law::Table(table) => table.workload(until),
            Law::Fixed(fixed) => {
                let (mut seen, at) = seen(fixed.pieces.iter().cloned(), until, Piece::way);
                // A long piece is divided into parts.
                seen.pieces += libm::floor(at.seconds() / super::LONGEST_PART_S);
                seen
            }
            Law::Sine(_) | Law::Steady(_) | Law::Circle(_) | Law::Lorenz(_) => self.first_pieces(until, MOST_PIECES),
            Law::Formula(formula) => self.pieces_all_over(formula, until),
            Law::Compensation(_) => self.first_pieces(until, MOST_PIECES),
            Law::Winch(_) => self.first_pieces(until, MOST_PIECES_OF_A_WINCH),
        }
    }

    /// The workload of its first pieces, scaled to the whole law. The planner will report errors of the law.
    fn first_pieces(&self, until: Time, most: usize) -> Workload {
        let (seen, at) = self.in_first_pieces(until, most, Piece::way);
        if at <= Time::ZERO { seen } else { seen.times(until.seconds() / at.seconds()) }
    }

    /// The workload of its first pieces, and their end.
    fn in_first_pieces(&self, until: Time, most: usize, way: impl Fn(&Piece, Time) -> Way) -> (Workload, Time) {
        seen(self.pieces().take(most).map_while(Result::ok), until, way)
    }

    /// The workload of a formula: its first pieces, then one window in each of several spans, scaled to the span.
    fn pieces_all_over(&self, formula: &Arc<Formula>, until: Time) -> Workload {
        let most = MOST_OPERATIONS / formula.operations().max(1);
        let [.., fewest] = LOOKS_IN_A_WINDOW;
        let looks = LOOKS_IN_A_WINDOW.into_iter().find(|looks| looks * PLACES <= most).unwrap_or(fewest);
        let places = (most / looks).clamp(4, PLACES);
        let pieces = if places < PLACES { places as usize } else { MOST_PIECES };
        let (mut seen, first) = self.in_first_pieces(until, pieces, |piece, until| piece.way_by_speed(until, looks));
        let left_s = (until - first).seconds();
        // The first spans are the shortest: what begins a motion is often soon over. Ends at round times would meet its branches and periods.
        let at = |k: f64| first + Time::from_seconds(left_s * whole_power(k / f64::from(places), 2));
        for k in (0..places).map(f64::from) {
            let (from, place, to) = (at(k), at(k + 0.48), at(k + 1.0).min(until));
            let Some(Ok(piece)) = formula.windows_at(place).next().filter(|_| place < to) else { continue };
            let share = |end: Time| (to - from).seconds() / (end - place).seconds();
            let way = piece.way_by_speed(to, looks);
            seen.steps += way.steps * share(piece.end.min(to));
            seen.turns += way.turns * share(piece.end.min(to));
            seen.pieces += share(piece.end);
        }
        Workload { operations: (seen.pieces + seen.turns) * f64::from(formula.operations()), ..seen }
    }
}

/// The workload of pieces up to `until`, and their end.
fn seen(pieces: impl Iterator<Item = Piece>, until: Time, way: impl Fn(&Piece, Time) -> Way) -> (Workload, Time) {
    let (mut seen, mut at) = (Workload::default(), Time::ZERO);
    for piece in pieces.take_while(|piece| piece.start < until) {
        let Way { steps, turns } = way(&piece, until);
        seen = seen.and(Workload { steps, pieces: 1.0, turns, operations: 0.0 });
        at = piece.end.min(until);
    }
    (seen, at)
}

impl Workload {
    /// The sum of two workloads.
    #[must_use]
    pub fn and(self, other: Workload) -> Workload {
        Workload {
            steps: self.steps + other.steps,
            pieces: self.pieces + other.pieces,
            turns: self.turns + other.turns,
            operations: self.operations + other.operations,
        }
    }

    fn times(self, factor: f64) -> Workload {
        Workload {
            steps: self.steps * factor,
            pieces: self.pieces * factor,
            turns: self.turns * factor,
            operations: self.operations * factor,
        }
    }
}

/// How far a piece goes, and how often it turns.
#[derive(Clone, Copy, Debug, Default)]
struct Way {
    steps: f64,
    turns: f64,
}

impl Way {
    /// Adds up the distances between samples, with their signs.
    fn of(ways: impl Iterator<Item = f64>) -> Way {
        let mut sum = Way::default();
        let mut before = 0.0;
        for way in ways.filter(|way| *way != 0.0) {
            sum.steps += way.abs();
            if before * way < 0.0 {
                sum.turns += 1.0;
            }
            before = way;
        }
        sum
    }
}

impl Piece {
    /// Its way before `until`, forward and backward.
    fn way(&self, until: Time) -> Way {
        let (from, to) = (self.first(), (self.end.min(until) - self.zero).seconds());
        let at = |k: u32| self.curve.value(from + (to - from) * f64::from(k) / f64::from(LOOKS));
        Way::of((0..LOOKS).map(|k| at(k + 1) - at(k)))
    }

    /// The same, computed from samples of the speed, for a piece that may turn between two samples.
    fn way_by_speed(&self, until: Time, looks: u32) -> Way {
        let (from, to) = (self.first(), (self.end.min(until) - self.zero).seconds());
        let each = (to - from) / f64::from(looks);
        Way::of((0..looks).map(|k| each * self.curve.jet(from + each * (f64::from(k) + 0.5))[1]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn check(law: &Law, until_s: f64, steps: f64, pieces: f64) {
        let workload = law.workload(Time::from_seconds(until_s));
        let near = |is: f64, wanted: f64| (is - wanted).abs() <= 0.01 * wanted;
        assert!(near(workload.steps, steps) && near(workload.pieces, pieces), "{workload:?}");
    }

    #[test]
    fn laws_of_any_kind_are_looked_at_as_far_as_they_are_wanted() {
        let second = |n: i64| Time::from_ratio(n, 1);
        let sine = |cycles| Law::sine(200.0, Time::SECOND, cycles).unwrap();
        check(&sine(Some(3)), 10.0, 2400.0, 6.0);
        check(&sine(None), 1e9, 8e11, 2e9);
        check(&sine(Some(1_000_000_000_000_000_000)), 1e18, 8e20, 2e18);
        check(&Law::speed(-50.0, None).unwrap(), 1e6, 5e7, 245.0);
        check(&Law::formula("sin(2*pi*t)", &[], 200.0, Some(second(1_000_000))).unwrap(), 1e9, 8e8, 1.25e5);
        // Faster and faster: 16 steps for each of the 2e8 rad / 2π.
        let near = |text: &str, until_s: i64, steps: f64| {
            let law = Law::formula(text, &[], 400.0, Some(second(until_s))).unwrap();
            let workload = law.workload(second(until_s));
            assert!((workload.steps / steps - 1.0).abs() < 0.05, "{text}: {workload:?}");
        };
        near("0.01*sin(0.02*t^2)", 100_000, 16.0 * 2e8 / std::f64::consts::TAU);
        // Rests before or behind what it does.
        near("if(t < 3, 0.01*sin(2*pi*1000*t), 0)", 3600, 48_000.0);
        near("if(t < 1800, 0, 0.01*sin(2*pi*1000*t))", 3600, 16_000.0 * 1800.0);
        // A rest, three periods of the double, and the beginning of the last law; what comes after is not looked at.
        let then = vec![Law::rest(second(5)).unwrap(), sine(Some(3)).scaled(2.0).unwrap(), sine(None)];
        check(&Law::then(then).unwrap().delayed(second(2)).unwrap(), 20.0, 4800.0 + 8000.0, 2.0 + 6.0 + 20.0);
        // A day at rest, and a line of years.
        let rows = [(0.0, 5.0), (86_400.0, 5.0), (1e8, 2005.0)];
        let line = Law::table(&rows, crate::law::Interpolation::Linear).unwrap();
        check(&line, 1e9, 2000.0, 3053.0);
        let both = Law::sum(vec![sine(Some(1_000_000_000)), sine(Some(2))]).unwrap();
        check(&both, 1e10, 8e11, 2e9);
        check(&sine(Some(2)).repeated(Some(1_000_000_000)).unwrap().eased(Time::SECOND).unwrap(), 1e10, 1.6e12, 4e9);
    }
}
