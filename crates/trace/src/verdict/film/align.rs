//! Alignment of a film with the law: sense, time zero, clock.

use std::f64::consts::TAU;

use pulsetrain_motion::law::Cursor;
use pulsetrain_motion::{Law, LawError, Time};

use super::SeenFrame;
use super::jumps::{Breaks, median};

/// The alignment of a film with the law: angle = sense·(zero + θ((time − shift)·(1 + rate))).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Fit {
    /// 1, or −1 if the film shows the other direction.
    pub(super) sense: f64,
    pub(super) shift_s: f64,
    pub(super) rate: f64,
}

impl Default for Fit {
    fn default() -> Fit {
        Fit { sense: 1.0, shift_s: 0.0, rate: 0.0 }
    }
}

/// For each frame θ and speed of the law, steps and steps/s, and the error, steps.
pub(super) type Compared = (Vec<(f64, f64)>, Vec<f64>);

/// Tries of the time shift, at most.
const MOST_SHIFTS: usize = 40_000;
/// Frames that take part in the search, at most.
const SEARCH_FRAMES: usize = 300;
/// How much of an endless law, or of one longer than the film by more than this, is searched, s.
const LONGEST_SEARCH_S: f64 = 1200.0;
/// Parts of the film whose agreement counts each by itself, so that a jump does not spoil it.
const WINDOWS: usize = 5;
/// Places that are tried further.
const CANDIDATES: usize = 6;
/// The rate of two clocks, before anything is seen: its standard deviation.
const USUAL_RATE: f64 = 3e-3;
/// A law that is searched is sampled this often at most.
const MOST_SAMPLES: usize = 400_000;

impl Fit {
    pub(super) fn law_time(&self, time_s: f64) -> f64 {
        (time_s - self.shift_s) * (1.0 + self.rate)
    }

    /// For each frame θ and speed, and seen − θ: the first as it is, the others of the same turn.
    pub(super) fn errors(&self, film: &[SeenFrame], law: &Law, turn: f64) -> Result<Compared, LawError> {
        let law = positions(law, film.iter().map(|seen| self.law_time(seen.time_s)))?;
        let mut last: Option<f64> = None;
        let errors = film.iter().zip(&law).map(|(seen, law)| {
            let error = self.sense * seen.angle - law.0;
            let error = error - last.map_or(0.0, |last| turn * ((error - last) / turn).round());
            last = Some(error);
            error
        });
        let errors = errors.collect();
        Ok((law, errors))
    }

    /// Least squares in shift, rate and the level of each part, from here. `None` where nothing would improve.
    pub(super) fn improved(
        self,
        film: &[SeenFrame],
        law: &[(f64, f64)],
        errors: &[f64],
        breaks: &Breaks,
        rate: bool,
    ) -> Option<Fit> {
        let parts = breaks.parts();
        let floor = median(&mut film.iter().map(|seen| seen.sigma).collect::<Vec<_>>()).unwrap_or(0.0).max(0.02);
        let about = self.shift_s;
        // Per part: weight and means of [by shift, by rate, error]; their removal frees the levels.
        let rows: Vec<(usize, f64, [f64; 3])> = (0..film.len())
            .filter_map(|k| {
                let part = breaks.part(k)?;
                let weight = 1.0 / (film[k].sigma * film[k].sigma + floor * floor);
                let speed = law[k].1;
                Some((part, weight, [-speed * (1.0 + self.rate), speed * (film[k].time_s - about), errors[k]]))
            })
            .collect();
        let mut means = vec![([0.0; 3], 0.0); parts];
        for (part, weight, row) in &rows {
            let (sums, all) = &mut means[*part];
            sums.iter_mut().zip(row).for_each(|(sum, value)| *sum += weight * value);
            *all += weight;
        }
        for (sums, all) in &mut means {
            sums.iter_mut().for_each(|sum| *sum /= all.max(f64::MIN_POSITIVE));
        }
        // Outliers count less.
        let away = |(part, _, row): &(usize, f64, [f64; 3])| row[2] - means[*part].0[2];
        let spread = median(&mut rows.iter().map(|row| away(row).abs()).collect::<Vec<_>>()).unwrap_or(0.0);
        let mut sums = [[0.0; 3]; 3];
        for row in &rows {
            let robust = (4.0 * spread.max(1e-9) / away(row).abs().max(1e-12)).min(1.0);
            let centred: [f64; 3] = std::array::from_fn(|k| row.2[k] - means[row.0].0[k]);
            for i in 0..3 {
                for j in 0..3 {
                    sums[i][j] += robust * row.1 * centred[i] * centred[j];
                }
            }
        }
        let (ss, sr, rr, sy, ry) = (sums[0][0], sums[0][1], sums[1][1], sums[0][2], sums[1][2]);
        // What is expected of clocks: the error's own scale makes it a weight.
        let error_scale = (sums[2][2] / rows.len().max(1) as f64).max(1.0);
        let rr = rr + error_scale / (USUAL_RATE * USUAL_RATE);
        let ry = ry - self.rate * error_scale / (USUAL_RATE * USUAL_RATE);
        let ss = ss + 1e-9 * ss + 1e-12;
        let (shift, faster) = if rate {
            let determinant = ss * rr - sr * sr;
            if determinant <= 1e-9 * ss * rr {
                (sy / ss, 0.0)
            } else {
                ((sy * rr - ry * sr) / determinant, (ry * ss - sy * sr) / determinant)
            }
        } else {
            (sy / ss, 0.0)
        };
        (shift.is_finite() && faster.is_finite()).then_some(Fit {
            shift_s: self.shift_s + shift,
            rate: self.rate + faster,
            ..self
        })
    }

    /// Mean absolute error about the median, steps.
    fn cost(&self, film: &[SeenFrame], law: &Law, turn: f64) -> Result<f64, LawError> {
        let (_, mut errors) = self.errors(film, law, turn)?;
        let middle = median(&mut errors.clone()).unwrap_or(0.0);
        errors.iter_mut().for_each(|error| *error = (*error - middle).abs());
        Ok(errors.iter().sum::<f64>() / errors.len().max(1) as f64)
    }
}

/// Finds sense, time zero and, if wanted, the clock's rate. It compares angles within a turn, so that it needs no count
/// of turns.
pub(super) fn find(film: &[SeenFrame], law: &Law, turn: f64, rate: bool) -> Result<Fit, LawError> {
    let every = film.len().div_ceil(SEARCH_FRAMES);
    let few: Vec<SeenFrame> = film.iter().step_by(every).copied().collect();
    let (first, last) = (film[0].time_s, film[film.len() - 1].time_s);
    let span = last - first;
    let length = law.end().map_or(LONGEST_SEARCH_S, Time::seconds).min(span + LONGEST_SEARCH_S);
    // The law begins at the last frame at the latest, and ends at the first frame at the earliest.
    let (from, to) = (first - length, last);
    let step = resolution(law, turn, span, (to - from) / MOST_SHIFTS as f64)?;
    let shifts = ((to - from) / step).ceil() as usize;
    // The law at multiples of the step, from the earliest law time on.
    let earliest = first - to;
    let samples = (((last - from) - earliest) / step).ceil() as usize + 2;
    if samples > MOST_SAMPLES {
        return Ok(Fit { shift_s: first, ..Fit::default() });
    }
    let table = positions(law, (0..samples).map(|k| earliest + k as f64 * step))?;
    let table: Vec<(f64, f64)> = table.iter().map(|(theta, _)| libm::sincos(theta / turn * TAU)).collect();
    let frames: Vec<(usize, f64, f64)> = few
        .iter()
        .map(|seen| {
            let (sin, cos) = libm::sincos(seen.angle / turn * TAU);
            (((seen.time_s - first) / step).round() as usize, sin, cos)
        })
        .collect();

    let window = few.len().div_ceil(WINDOWS);
    let mut scores: Vec<(f64, f64, usize)> = Vec::new();
    for k in 0..=shifts {
        // Shift = to − k·step, so that the first frame is at law time first − to + k·step: entry k of the table.
        let mut sums = [[0.0_f64; 4]; WINDOWS];
        for (n, &(at, sin, cos)) in frames.iter().enumerate() {
            let Some(&(law_sin, law_cos)) = table.get(k + at) else { continue };
            let sum = &mut sums[n / window];
            // seen·conj(law), and conj(seen)·conj(law).
            sum[0] += cos * law_cos + sin * law_sin;
            sum[1] += sin * law_cos - cos * law_sin;
            sum[2] += cos * law_cos - sin * law_sin;
            sum[3] += -sin * law_cos - cos * law_sin;
        }
        for (sense, part) in [(1.0, 0), (-1.0, 2)] {
            let parts: f64 = sums.iter().map(|sum| libm::hypot(sum[part], sum[part + 1])).sum();
            let all = sums.iter().fold((0.0, 0.0), |all, sum| (all.0 + sum[part], all.1 + sum[part + 1]));
            scores.push((parts + libm::hypot(all.0, all.1), sense, k));
        }
    }
    // The best places of each sense that are no neighbours.
    scores.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut places: Vec<(f64, usize)> = Vec::new();
    for &(_, sense, k) in &scores {
        if places.iter().all(|place| place.0 != sense || place.1.abs_diff(k) > 2) {
            places.push((sense, k));
            if places.len() == CANDIDATES {
                break;
            }
        }
    }
    let mut best: Option<(f64, Fit)> = None;
    for (sense, k) in places {
        let mut fit = Fit { sense, shift_s: to - k as f64 * step, rate: 0.0 };
        let mut cost = fit.cost(&few, law, turn)?;
        for _ in 0..15 {
            let (law_there, errors) = fit.errors(&few, law, turn)?;
            let Some(next) = fit.improved(&few, &law_there, &errors, &Breaks::default(), rate) else { break };
            let next_cost = next.cost(&few, law, turn)?;
            if next_cost >= cost {
                break;
            }
            (fit, cost) = (next, next_cost);
        }
        // Of equals the film that shows the start, in the law's own sense: a tenth worse counts as equal.
        let shows_start = (first..=last).contains(&fit.shift_s);
        let for_sense = if sense < 0.0 { 1.1 } else { 1.0 };
        let for_start = if shows_start { 1.0 } else { 1.05 };
        let cost = (cost + 1e-3) * for_sense * for_start;
        if best.is_none_or(|best| cost < best.0) {
            best = Some((cost, fit));
        }
    }
    Ok(best.map_or_else(Fit::default, |best| best.1))
}

/// Steps of the time shift: so fine that the law turns little meanwhile.
fn resolution(law: &Law, turn: f64, span: f64, coarsest: f64) -> Result<f64, LawError> {
    const PROBES: u32 = 400;
    /// A part of a turn: a cosine is still 0.7 there.
    const PART: f64 = 0.06;
    let length = law.end().map_or(span, |end| end.seconds().min(span + LONGEST_SEARCH_S));
    let probes = positions(law, (0..=PROBES).map(|k| length * f64::from(k) / f64::from(PROBES)))?;
    let fastest = probes.iter().map(|(_, speed)| speed.abs()).fold(0.0, f64::max);
    let fine = if fastest > 0.0 { PART * turn / fastest } else { span };
    Ok(fine.min(span / 200.0).max(coarsest).max(1e-9))
}

/// Points of the law in a picture.
const LINE_POINTS: u32 = 2000;

/// The law between two law times as a line: time, s, and angle, steps times `scale`.
pub(super) fn line(law: &Law, (from, to): (f64, f64), scale: f64) -> Result<Vec<(f64, f64)>, LawError> {
    let times: Vec<f64> =
        (0..=LINE_POINTS).map(|k| from + (to - from) * f64::from(k) / f64::from(LINE_POINTS)).collect();
    let there = positions(law, times.iter().copied())?;
    Ok(times.into_iter().zip(there).map(|(time, (theta, _))| (time, theta * scale)).collect())
}

/// θ from its start on and the speed at each of the times (s, in order).
fn positions(law: &Law, times: impl Iterator<Item = f64>) -> Result<Vec<(f64, f64)>, LawError> {
    let mut cursor = Cursor::new(law);
    let start = cursor.at(Time::ZERO)?;
    let from_start = |t: f64| {
        let sample = cursor.at(Time::from_seconds(t))?;
        Ok(((sample.whole - start.whole) as f64 + (sample.fraction - start.fraction), sample.speed))
    };
    times.map(from_start).collect()
}
