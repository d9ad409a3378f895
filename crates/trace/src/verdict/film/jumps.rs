//! Where the error of a film jumps and stays: lost and added steps.

use schemars::JsonSchema;
use serde::Serialize;

use super::{CERTAIN, SeenFrame};

/// A place where the wheel left the law by some steps, and stayed so.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Jump {
    /// Law time at which it begins, s.
    pub from_s: f64,
    /// Law time at which it ends, s. One interval of frames later, or more if steps were lost one after the other.
    pub to_s: f64,
    /// How far the wheel is ahead of the law after it, compared with before, steps.
    pub steps: f64,
    /// Standard deviation of `steps`.
    pub sigma_steps: f64,
    /// The whole number of steps, with the sign of `steps`; `None` if the film cannot tell it.
    pub whole: Option<i64>,
    /// Which way the law moves there: forward 1, backward -1, at rest 0.
    pub way: i8,
}

impl Jump {
    /// Whether at least a step was lost or added, beyond doubt.
    #[must_use]
    pub fn is_certain(&self) -> bool {
        self.steps.abs() - CERTAIN * self.sigma_steps > 0.5
    }

    /// Whether steps are missing in the direction of the law's motion.
    #[must_use]
    pub fn is_loss(&self) -> bool {
        self.steps * f64::from(self.way) < 0.0
    }
}

/// Where a film is cut into parts of constant error: each break is the index of the last frame before it and of the first
/// frame after it.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Breaks {
    places: Vec<(usize, usize)>,
    /// Typical difference of neighbouring parts of the film without a break, steps.
    scatter: f64,
}

/// Frames on each side whose medians are compared, at most.
const SIDE: usize = 10;
/// Fewest frames on each side.
const SHORTEST_SIDE: usize = 3;
/// A jump is this many times as large as the differences elsewhere.
const OUTSTANDING: f64 = 6.0;
/// More breaks than this are no lost steps but another motion.
const MOST_BREAKS: usize = 12;
/// Without breaks there is more difference than with them, by this factor at least.
const EXPLAINED: f64 = 0.35;

/// The middle value; `None` if there is none.
pub(super) fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

fn median_of(values: &[f64]) -> f64 {
    median(&mut values.to_vec()).unwrap_or(0.0)
}

/// Finds breaks in the errors of the frames.
pub(super) fn find(film: &[SeenFrame], errors: &[f64]) -> Breaks {
    let n = errors.len();
    let side = SIDE.min(n / 4).max(SHORTEST_SIDE);
    if n < 2 * SHORTEST_SIDE + 2 {
        return Breaks::default();
    }
    let sides = |k: usize| (&errors[k.saturating_sub(side)..k], &errors[k..(k + side).min(n)]);
    let places: Vec<usize> = (SHORTEST_SIDE..=n - SHORTEST_SIDE).collect();
    let noise = noise(errors);
    let sigma = median(&mut film.iter().map(|seen| seen.sigma).collect::<Vec<_>>()).unwrap_or(0.0);
    // Medians have less noise; lines see a jump also while the error drifts, as it does until the fit is right.
    let detectors: [(&dyn Fn(usize) -> f64, f64); 2] = [
        (&|k| median_of(sides(k).1) - median_of(sides(k).0), (2.0 / side as f64).sqrt()),
        (&|k| end_of_line(sides(k).1.iter()) - end_of_line(sides(k).0.iter().rev()), (8.0 / side as f64).sqrt()),
    ];
    let mut steps = vec![0.0; places.len()];
    let mut clearness = vec![0.0; places.len()];
    let mut scatter = f64::INFINITY;
    for (difference, spread) in detectors {
        let found: Vec<f64> = places.iter().map(|k| difference(*k)).collect();
        let usual = 1.4826 * median(&mut found.iter().map(|step| step.abs()).collect::<Vec<_>>()).unwrap_or(0.0);
        // Less than half a step is no step.
        let least = (OUTSTANDING * usual).max(OUTSTANDING * noise.max(sigma) * spread).max(0.5);
        scatter = scatter.min(usual);
        for (k, step) in found.into_iter().enumerate().filter(|(_, step)| step.abs() > least) {
            if step.abs() / least > clearness[k] {
                (steps[k], clearness[k]) = (step, step.abs() / least);
            }
        }
    }

    // From the clearest difference on, one for each stretch of frames.
    let mut order: Vec<usize> = (0..places.len()).filter(|k| clearness[*k] > 1.0).collect();
    order.sort_by(|a, b| clearness[*b].total_cmp(&clearness[*a]));
    let mut chosen: Vec<usize> = Vec::new();
    // Beside a jump lines bend: what is smaller, and so near that a jump is in its windows, is no jump of its own.
    let is_echo = |k: usize, jump: usize| {
        let share = steps[k] / steps[jump];
        let distance = places[k].abs_diff(places[jump]);
        distance <= side || (distance <= 2 * side && (-0.7..0.4).contains(&share))
    };
    for k in order {
        if !chosen.iter().any(|jump| is_echo(k, *jump)) {
            chosen.push(k);
        }
    }
    chosen.sort_unstable();
    // Of equal differences around a sharp jump the steepest pair of frames is the place.
    let sharp = |k: usize| {
        let from = places[k].saturating_sub(side / 2).max(1);
        let to = (places[k] + side / 2).min(n - 1);
        let steepest = |at: &usize| steps[k].signum() * (errors[*at] - errors[at - 1]);
        (from..=to).max_by(|a, b| steepest(a).total_cmp(&steepest(b))).unwrap_or(places[k])
    };
    let mut breaks: Vec<(usize, usize)> = Vec::new();
    for k in chosen {
        let at = sharp(k);
        let width = transition(errors, at, steps[k], side);
        match breaks.last_mut() {
            // Steps that are lost one after the other are one event.
            Some(last) if width.0 <= last.1 + side => last.1 = last.1.max(width.1),
            _ => breaks.push(width),
        }
    }
    Breaks { places: breaks, scatter: scatter.max(noise) }
}

/// Where a straight line through values is half a place before the first of them.
fn end_of_line<'a>(values: impl ExactSizeIterator<Item = &'a f64>) -> f64 {
    let n = values.len() as f64;
    let (mut sum, mut moment) = (0.0, 0.0);
    for (k, value) in values.enumerate() {
        sum += value;
        moment += value * (k as f64 - 0.5 * (n - 1.0));
    }
    let slope = moment / (n * (n * n - 1.0) / 12.0).max(f64::MIN_POSITIVE);
    sum / n - slope * 0.5 * n
}

/// Standard deviation of the errors from frame to frame, by their second differences.
fn noise(errors: &[f64]) -> f64 {
    let mut seconds: Vec<f64> = errors.windows(3).map(|e| (e[0] - 2.0 * e[1] + e[2]).abs()).collect();
    1.4826 * median(&mut seconds).unwrap_or(0.0) / 6.0_f64.sqrt()
}

/// Last frame at the level before and first frame at the level after.
fn transition(errors: &[f64], at: usize, step: f64, side: usize) -> (usize, usize) {
    let (mut before, mut after) = (at - 1, at);
    let low = median_of(&errors[at.saturating_sub(2 * side)..at.saturating_sub(side / 2).max(1)]);
    let high = median_of(&errors[(at + side / 2).min(errors.len() - 1)..(at + 2 * side).min(errors.len())]);
    let is_before = |e: f64| (e - low).abs() < 0.25 * step.abs();
    let is_after = |e: f64| (e - high).abs() < 0.25 * step.abs();
    while before > 0 && at - before < side && !is_before(errors[before]) {
        before -= 1;
    }
    while after + 1 < errors.len() && after - at < side && !is_after(errors[after]) {
        after += 1;
    }
    (before, after)
}

impl Breaks {
    /// The part of the film to which a frame belongs: 0 before the first break. `None` within a break.
    pub(super) fn part(&self, frame: usize) -> Option<usize> {
        let passed = self.places.iter().take_while(|(_, after)| *after <= frame).count();
        let is_inside = self.places.get(passed).is_some_and(|(before, _)| frame > *before);
        (!is_inside).then_some(passed)
    }

    pub(super) fn parts(&self) -> usize {
        self.places.len() + 1
    }

    fn level(&self, errors: &[f64], part: usize) -> f64 {
        let mut own: Vec<f64> = (0..errors.len()).filter(|k| self.part(*k) == Some(part)).map(|k| errors[k]).collect();
        let middle = median(&mut own).unwrap_or(0.0);
        // A mean has less noise; outliers are left out.
        let spread = 3.0 * self.scatter.max(1e-9);
        let near: Vec<f64> = own.into_iter().filter(|error| (error - middle).abs() <= spread).collect();
        if near.is_empty() { middle } else { near.iter().sum::<f64>() / near.len() as f64 }
    }

    /// The level of the error before the first break: the camera's zero.
    pub(super) fn level_before(&self, film: &[SeenFrame], errors: &[f64]) -> f64 {
        if self.places.is_empty() {
            let weight = |seen: &SeenFrame| 1.0 / (seen.sigma * seen.sigma).max(1e-12);
            let all = film.iter().map(weight).sum::<f64>();
            return film.iter().zip(errors).map(|(seen, error)| weight(seen) * error).sum::<f64>() / all;
        }
        self.level(errors, 0)
    }

    /// Whether the errors are about constant between the breaks.
    pub(super) fn explain(&self, errors: &[f64]) -> bool {
        if self.places.is_empty() || self.places.len() > MOST_BREAKS {
            return self.places.is_empty();
        }
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        let whole: f64 = errors.iter().map(|error| (error - mean) * (error - mean)).sum();
        let levels: Vec<f64> = (0..self.parts()).map(|part| self.level(errors, part)).collect();
        let rest = (0..errors.len()).filter_map(|k| {
            let off = errors[k] - levels[self.part(k)?];
            Some(off * off)
        });
        (rest.sum::<f64>() / whole).sqrt() < EXPLAINED
    }

    /// The jumps, with the steps that were lost or added.
    pub(super) fn jumps(
        &self,
        film: &[SeenFrame],
        law: &[(f64, f64)],
        errors: &[f64],
        law_time: &dyn Fn(f64) -> f64,
    ) -> Vec<Jump> {
        let jump = |(part, &(before, after)): (usize, &(usize, usize))| {
            // Near the break, so that what drifts does not count: up to thirty frames on each side.
            const NEAR: usize = 30;
            let begin =
                part.checked_sub(1).map_or(0, |last| self.places[last].1).max((before + 1).saturating_sub(NEAR));
            let end = self.places.get(part + 1).map_or(errors.len(), |next| next.0 + 1).min(after + NEAR);
            let (left, right) = (&errors[begin..=before], &errors[after..end]);
            let steps = median_of(right) - median_of(left);
            let spread = |part: &[f64]| {
                let middle = median_of(part);
                let deviation = median(&mut part.iter().map(|e| (e - middle).abs()).collect::<Vec<_>>());
                1.4826 * deviation.unwrap_or(0.0) / (part.len() as f64).sqrt()
            };
            let stated = film[before].sigma.max(film[after.min(film.len() - 1)].sigma);
            let few = left.len().min(right.len()).max(1) as f64;
            let sigma_steps =
                1.25 * libm::hypot(spread(left), spread(right)).max(stated / few.sqrt()).max(0.5 * self.scatter);
            let is_whole = 3.0 * sigma_steps < 0.5 && (steps - steps.round()).abs() < (3.0 * sigma_steps).max(0.15);
            let speed: f64 = law[before..=after].iter().map(|(_, speed)| speed).sum();
            Jump {
                from_s: law_time(film[before].time_s),
                to_s: law_time(film[after].time_s),
                steps,
                sigma_steps,
                whole: is_whole.then_some(steps.round() as i64),
                way: if speed.abs() < 1e-3 { 0 } else { speed.signum() as i8 },
            }
        };
        self.places.iter().enumerate().map(jump).filter(|jump| jump.steps.abs() >= 0.5).collect()
    }
}
