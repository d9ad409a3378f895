//! A film against the law: angles at frame times, finer than a step.

use pulsetrain_motion::law::Cursor;
use pulsetrain_motion::program::{Motor, Program};
use pulsetrain_motion::{Law, LawError, Time};
use schemars::JsonSchema;
use serde::Serialize;

use super::{Align, Alignment, Failure, Fault, JudgeError, MOST_FAULTS, Options};
use crate::camera::Track;

/// The verdict on a film.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct FilmReport {
    /// Whether every frame is within the limit.
    pub ok: bool,
    /// The name of the motor.
    pub motor: String,
    /// The number of frames.
    pub frames: u64,
    /// Law time of the first frame, s; before 0 the law rests.
    pub from_s: f64,
    /// Law time of the last frame, s.
    pub to_s: f64,
    /// The alignment of the film with the law.
    pub alignment: Alignment,
    /// The law's angle 0 in the camera's angles, degrees of the shaft; 0 unless aligned.
    pub zero_deg: f64,
    /// The limit on |error|, steps.
    pub limit_steps: f64,
    /// Largest error: how far the shaft is ahead of the law, steps.
    pub max_error_steps: f64,
    /// Largest error, degrees.
    pub max_error_deg: f64,
    /// Law time of the largest error, s.
    pub max_error_at_s: f64,
    /// Root of the mean square error, steps.
    pub rms_error_steps: f64,
    /// Root of the mean square error, degrees.
    pub rms_error_deg: f64,
    /// The first frames beyond the limit.
    pub failures: Vec<Failure>,
}

/// Fewest frames that show a motion.
const FEWEST_FRAMES: usize = 8;

/// Judges a film of `motor`, which may be left out if the program has only one. The limit is `bound_steps`, else 1 step
/// or 1 degree, whichever is more.
/// whichever is more.
///
/// With alignment the camera's zero angle is fitted too. Before its start and after its end a law rests.
///
/// # Errors
/// If the motor is not clear, there are too few frames, or the law breaks.
pub fn judge_film(
    track: &Track,
    program: &Program,
    motor: Option<&str>,
    options: &Options,
    bound_steps: Option<f64>,
) -> Result<FilmReport, JudgeError> {
    let names = || program.motors.iter().map(|m| m.name.as_str()).collect::<Vec<_>>().join(", ");
    let motor: &Motor = match (motor, program.motors.as_slice()) {
        (Some(name), motors) => {
            motors.iter().find(|m| m.name == name).ok_or_else(|| JudgeError::WhichMotor(names()))?
        }
        (None, [only]) => only,
        (None, _) => return Err(JudgeError::WhichMotor(names())),
    };
    let steps_per_rev = motor.scale.steps_per_rev;
    let unit = track.unit.steps(steps_per_rev);
    let until_s = options.until_s.unwrap_or(f64::INFINITY);
    let film: Vec<(f64, f64)> = track.frames.iter().map(|f| (f.time_s, f.angle * unit)).collect();
    let law_error = |error| JudgeError::Law { motor: motor.name.clone(), error };
    if film.len() < FEWEST_FRAMES {
        return Err(JudgeError::TooFewFrames { frames: film.len(), limit: FEWEST_FRAMES });
    }
    let fit = match options.align {
        Align::None => Fit::default(),
        align => Fit::of(&film, &motor.law, align == Align::StartAndRate).map_err(law_error)?,
    };
    let degrees = 360.0 / steps_per_rev;
    let limit_steps = bound_steps.unwrap_or(1.0_f64.max(1.0 / degrees));
    let mut report = FilmReport {
        ok: true,
        motor: motor.name.clone(),
        frames: 0,
        from_s: fit.law_time(film[0].0),
        to_s: 0.0,
        alignment: Alignment { shift_s: fit.shift_s, rate_ppm: fit.rate * 1e6 },
        zero_deg: fit.zero * degrees,
        limit_steps,
        max_error_steps: 0.0,
        max_error_deg: 0.0,
        max_error_at_s: 0.0,
        rms_error_steps: 0.0,
        rms_error_deg: 0.0,
        failures: Vec::new(),
    };
    let mut squares = 0.0;
    for (seen, law) in film.iter().zip(fit.law(&film, &motor.law).map_err(law_error)?) {
        let at_s = fit.law_time(seen.0);
        if at_s > until_s {
            break;
        }
        let error = seen.1 - fit.zero - law.0;
        report.frames += 1;
        report.to_s = at_s;
        squares += error * error;
        if error.abs() > report.max_error_steps.abs() {
            (report.max_error_steps, report.max_error_at_s) = (error, at_s);
        }
        if error.abs() > limit_steps {
            report.ok = false;
            if report.failures.len() < MOST_FAULTS {
                let fault = Fault::Angle { error_steps: error, limit_steps };
                report.failures.push(Failure { motor: motor.name.clone(), step: report.frames, at_s, fault });
            }
        }
    }
    if report.frames < FEWEST_FRAMES as u64 {
        return Err(JudgeError::TooFewFrames { frames: report.frames as usize, limit: FEWEST_FRAMES });
    }
    if let Some(fault) = Fault::of_clock(fit.rate) {
        report.ok = false;
        report.failures.push(Failure { motor: motor.name.clone(), step: report.frames, at_s: report.to_s, fault });
    }
    report.rms_error_steps = (squares / report.frames as f64).sqrt();
    report.max_error_deg = report.max_error_steps * degrees;
    report.rms_error_deg = report.rms_error_steps * degrees;
    Ok(report)
}

/// The alignment of a film with the law: angle = zero + θ((time − shift)·(1 + rate)).
#[derive(Clone, Copy, Default)]
struct Fit {
    shift_s: f64,
    rate: f64,
    zero: f64,
}

impl Fit {
    fn law_time(&self, time_s: f64) -> f64 {
        (time_s - self.shift_s) * (1.0 + self.rate)
    }

    /// θ and speed at each frame.
    fn law(&self, film: &[(f64, f64)], law: &Law) -> Result<Vec<(f64, f64)>, LawError> {
        positions(law, film.iter().map(|(time, _)| self.law_time(*time)))
    }

    /// The best of many shifts, refined together with the other unknowns by least squares (Gauss–Newton).
    fn of(film: &[(f64, f64)], law: &Law, rate: bool) -> Result<Fit, LawError> {
        let first = film.first().map_or(0.0, |f| f.0);
        let span = film.last().map_or(0.0, |f| f.0) - first;
        const TRIES: i32 = 200;
        let mut best = (f64::INFINITY, Fit::default());
        for k in -TRIES..=TRIES {
            let fit = Fit { shift_s: first + span * f64::from(k) / f64::from(TRIES), ..Fit::default() };
            let (fit, squares) = fit.with_zero(film, law)?;
            if squares < best.0 {
                best = (squares, fit);
            }
        }
        for _ in 0..30 {
            let (_, fit) = best;
            let Some(next) = fit.improved(film, &fit.law(film, law)?, rate) else { break };
            let (next, squares) = next.with_zero(film, law)?;
            if squares >= best.0 {
                break;
            }
            best = (squares, next);
        }
        Ok(best.1)
    }

    /// The fit with the best zero angle for its shift and rate, and its sum of squares.
    fn with_zero(self, film: &[(f64, f64)], law: &Law) -> Result<(Fit, f64), LawError> {
        let law = self.law(film, law)?;
        let off = || film.iter().zip(&law).map(|(seen, law)| seen.1 - law.0);
        let zero = off().sum::<f64>() / film.len() as f64;
        Ok((Fit { zero, ..self }, off().map(|off| (off - zero).powi(2)).sum()))
    }

    /// One step of least squares in shift and rate; `None` where the film shows no motion.
    fn improved(self, film: &[(f64, f64)], law: &[(f64, f64)], rate: bool) -> Option<Fit> {
        let n = film.len() as f64;
        // The unknowns are shift and rate. Subtracting the means removes the zero angle.
        let rows: Vec<[f64; 3]> = film
            .iter()
            .zip(law)
            .map(|(&(time, angle), &(theta, speed))| {
                [-speed * (1.0 + self.rate), speed * (time - self.shift_s), angle - self.zero - theta]
            })
            .collect();
        let mean = |i: usize| rows.iter().map(|row| row[i]).sum::<f64>() / n;
        let means = [mean(0), mean(1), mean(2)];
        let product = |i: usize, j: usize| -> f64 { rows.iter().map(|r| (r[i] - means[i]) * (r[j] - means[j])).sum() };
        let (aa, ab, bb, ay, by) = (product(0, 0), product(0, 1), product(1, 1), product(0, 2), product(1, 2));
        let determinant = aa * bb - ab * ab;
        if rate && determinant > 1e-12 * aa * bb {
            let shift = (ay * bb - by * ab) / determinant;
            let rate = (by * aa - ay * ab) / determinant;
            Some(Fit { shift_s: self.shift_s + shift, rate: self.rate + rate, ..self })
        } else {
            (aa > 0.0).then(|| Fit { shift_s: self.shift_s + ay / aa, ..self })
        }
    }
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
