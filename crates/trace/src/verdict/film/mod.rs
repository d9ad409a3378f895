//! A film against the law: angles at frame times, finer than a step.
//!
//! A camera sees an angle within one turn, from one side or the other, with a zero and a time zero of its own. So the law
//! says which turn it is, and [`align`] finds sense, start and zero. What is left is the error. Where it jumps and stays,
//! steps were lost ([`jumps`]).

mod align;
mod jumps;

use pulsetrain_motion::program::{Motor, Program, Wheel};
use schemars::JsonSchema;
use serde::Serialize;

pub use jumps::Jump;

use super::{Align, Alignment, Failure, Fault, JudgeError, MOST_FAULTS, Options};
use crate::camera::Track;
use align::Fit;

/// The verdict on a film.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct FilmReport {
    /// Whether every frame is within the limit, and no step was lost or added.
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
    /// Whether the film shows the wheel turn the other way round than the law, as from behind.
    pub reversed: bool,
    /// The law's angle 0 in the camera's angles, degrees of the wheel; 0 unless aligned.
    pub zero_deg: f64,
    /// The limit on |error|, steps.
    pub limit_steps: f64,
    /// The limit on |error|, degrees.
    pub limit_deg: f64,
    /// Steps in one degree of the wheel.
    pub steps_per_deg: f64,
    /// Largest error: how far the wheel is ahead of the law, steps.
    pub max_error_steps: f64,
    /// Largest error, degrees.
    pub max_error_deg: f64,
    /// Law time of the largest error, s.
    pub max_error_at_s: f64,
    /// Root of the mean square error, steps.
    pub rms_error_steps: f64,
    /// Root of the mean square error, degrees.
    pub rms_error_deg: f64,
    /// The middle one of the frames' standard deviations that the track states, degrees; `None` if it states none.
    pub sigma_deg: Option<f64>,
    /// Frames beyond the limit whose uncertainty, three standard deviations, reaches back to it. They are no failures.
    pub doubtful_frames: u64,
    /// Where the error jumps and stays: lost and added steps.
    pub jumps: Vec<Jump>,
    /// Frames beyond the limit.
    pub frames_beyond_limit: u64,
    /// The first failures.
    pub failures: Vec<Failure>,
    /// Every judged frame.
    #[serde(skip)]
    pub points: Vec<FilmPoint>,
    /// The law during the film, dense enough for a line: law time, s, and degrees of the wheel.
    #[serde(skip)]
    pub law_line: Vec<(f64, f64)>,
}

/// A frame beside the law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FilmPoint {
    /// Law time, s.
    pub at_s: f64,
    /// Angle in the film, in the law's sense and from the law's zero, degrees of the wheel.
    pub angle_deg: f64,
    /// Angle by the law, degrees of the wheel.
    pub law_deg: f64,
    /// Standard deviation of the angle, degrees; 0 if the track states none.
    pub sigma_deg: f64,
}

/// Fewest frames that show a motion.
const FEWEST_FRAMES: usize = 8;
/// Rounds in which alignment and jumps are found together, at most.
const ROUNDS: usize = 12;
/// An angle is uncertain by this many standard deviations.
const CERTAIN: f64 = 3.0;
/// If more than this share of the frames is doubtful, there is no verdict.
const MOST_DOUBTFUL: f64 = 0.1;

/// A frame in steps.
#[derive(Clone, Copy, Debug)]
struct SeenFrame {
    time_s: f64,
    angle: f64,
    sigma: f64,
}

/// Judges a film of `motor`, which may be left out if the program has only one. The limit is the wheel's, else 1 step or
/// 1 degree, whichever is more. Without a `wheel` angles are those of the motor's shaft.
///
/// With alignment the camera's sense and zero angle are found, too. Before its start and after its end a law rests.
///
/// # Errors
/// If the motor is not clear, there are too few frames, frames are too far apart in time, angles are too uncertain for
/// the limit, nothing moves, or the law breaks.
pub fn judge_film(
    track: &Track,
    program: &Program,
    motor: Option<&str>,
    wheel: Option<Wheel>,
    options: &Options,
) -> Result<FilmReport, JudgeError> {
    let motor = find_motor(program, motor)?;
    let turn = wheel.map_or(motor.scale.steps_per_rev, |wheel| wheel.units.steps_per_turn);
    let degrees = 360.0 / turn;
    let unit = track.unit.steps(turn);
    let until_s = options.until_s.unwrap_or(f64::INFINITY);
    let seen = |f: &crate::camera::Frame| SeenFrame {
        time_s: f.time_s,
        angle: f.angle * unit,
        sigma: f.sigma.unwrap_or(0.0) * unit,
    };
    let film: Vec<SeenFrame> = track.frames.iter().map(seen).collect();
    if film.len() < FEWEST_FRAMES {
        return Err(JudgeError::TooFewFrames { frames: film.len(), limit: FEWEST_FRAMES });
    }
    let law_error = |error| JudgeError::Law { motor: motor.name.clone(), error };
    let limit_steps = wheel.and_then(|wheel| wheel.limit_steps).unwrap_or(1.0_f64.max(1.0 / degrees));

    let mut fit = match options.align {
        Align::None => Fit::default(),
        align => align::find(&film, &motor.law, turn, align == Align::StartAndRate).map_err(law_error)?,
    };
    let rate = options.align == Align::StartAndRate;
    let aligned = fit;
    let (mut law, mut errors) = fit.errors(&film, &motor.law, turn).map_err(law_error)?;
    let mut breaks = jumps::find(&film, &errors);
    // A jump bends the fit, and a bent fit hides jumps: both are found together.
    for _ in 0..ROUNDS {
        let next = fit.improved(&film, &law, &errors, &breaks, rate).filter(|_| options.align != Align::None);
        let Some(next) = next else { break };
        let is_same = (next.shift_s - fit.shift_s).abs() < 1e-9 && (next.rate - fit.rate).abs() < 1e-9;
        fit = next;
        (law, errors) = fit.errors(&film, &motor.law, turn).map_err(law_error)?;
        breaks = jumps::find(&film, &errors);
        if is_same {
            break;
        }
    }
    if !breaks.explain(&errors) {
        // What is left is no lost steps, but another motion.
        breaks = jumps::Breaks::default();
        fit = aligned;
        (law, errors) = fit.errors(&film, &motor.law, turn).map_err(law_error)?;
    }
    check_spacing(&film, &law, &fit, turn, options)?;
    let zero = if options.align == Align::None { 0.0 } else { breaks.level_before(&film, &errors) };

    let mut report = FilmReport {
        ok: true,
        motor: motor.name.clone(),
        frames: 0,
        from_s: fit.law_time(film[0].time_s),
        to_s: 0.0,
        alignment: Alignment { shift_s: fit.shift_s, rate_ppm: fit.rate * 1e6 },
        reversed: fit.sense < 0.0,
        zero_deg: 0.0,
        limit_steps,
        limit_deg: limit_steps * degrees,
        steps_per_deg: 1.0 / degrees,
        max_error_steps: 0.0,
        max_error_deg: 0.0,
        max_error_at_s: 0.0,
        rms_error_steps: 0.0,
        rms_error_deg: 0.0,
        sigma_deg: None,
        doubtful_frames: 0,
        jumps: Vec::new(),
        frames_beyond_limit: 0,
        failures: Vec::new(),
        points: Vec::new(),
        law_line: Vec::new(),
    };
    if options.align != Align::None {
        // Where the law is at 0 the camera sees this angle.
        report.zero_deg = (fit.sense * zero * degrees).rem_euclid(360.0);
    }
    let mut squares = 0.0;
    let mut doubtful_limit = 0.0_f64;
    for ((seen, law), error) in film.iter().zip(&law).zip(&errors) {
        let at_s = fit.law_time(seen.time_s);
        if at_s > until_s {
            break;
        }
        let error = error - zero;
        report.frames += 1;
        report.to_s = at_s;
        squares += error * error;
        report.points.push(FilmPoint {
            at_s,
            angle_deg: (law.0 + error) * degrees,
            law_deg: law.0 * degrees,
            sigma_deg: seen.sigma * degrees,
        });
        if error.abs() > report.max_error_steps.abs() {
            (report.max_error_steps, report.max_error_at_s) = (error, at_s);
        }
        if error.abs() - CERTAIN * seen.sigma > limit_steps {
            report.ok = false;
            report.frames_beyond_limit += 1;
            if report.failures.len() < MOST_FAULTS {
                let fault = Fault::Angle { error_steps: error, limit_steps };
                report.failures.push(Failure { motor: motor.name.clone(), step: report.frames, at_s, fault });
            }
        } else if error.abs() > limit_steps || CERTAIN * seen.sigma > limit_steps {
            report.doubtful_frames += 1;
            doubtful_limit = doubtful_limit.max(CERTAIN * seen.sigma);
        }
    }
    let frames = report.frames;
    if frames < FEWEST_FRAMES as u64 {
        return Err(JudgeError::TooFewFrames { frames: frames as usize, limit: FEWEST_FRAMES });
    }
    check_motion(&report, options)?;
    report.law_line = align::line(&motor.law, (report.from_s, report.to_s), degrees).map_err(law_error)?;
    report.jumps = breaks.jumps(&film, &law, &errors, &|time_s| fit.law_time(time_s));
    report.jumps.retain(|jump| jump.from_s <= until_s);
    // Of frames that are too uncertain some are beyond the limit by chance.
    let share = |count: u64| count as f64 / frames as f64;
    let has_jumped = report.jumps.iter().any(Jump::is_certain);
    if !has_jumped && share(report.doubtful_frames) > MOST_DOUBTFUL && share(report.frames_beyond_limit) < MOST_DOUBTFUL
    {
        return Err(JudgeError::Uncertain {
            uncertain_deg: doubtful_limit * degrees,
            frames: report.doubtful_frames,
            of: frames,
            limit_deg: report.limit_deg,
        });
    }
    report.ok &= !has_jumped;
    if let Some(fault) = Fault::of_clock(fit.rate) {
        report.ok = false;
        report.failures.push(Failure { motor: motor.name.clone(), step: frames, at_s: report.to_s, fault });
    }
    let mut sigmas: Vec<f64> = report.points.iter().map(|point| point.sigma_deg).filter(|sigma| *sigma > 0.0).collect();
    report.sigma_deg = jumps::median(&mut sigmas);
    report.rms_error_steps = (squares / frames as f64).sqrt();
    report.max_error_deg = report.max_error_steps * degrees;
    report.rms_error_deg = report.rms_error_steps * degrees;
    Ok(report)
}

fn find_motor<'a>(program: &'a Program, motor: Option<&str>) -> Result<&'a Motor, JudgeError> {
    let names = || program.motors.iter().map(|m| m.name.as_str()).collect::<Vec<_>>().join(", ");
    match (motor, program.motors.as_slice()) {
        (Some(name), motors) => motors.iter().find(|m| m.name == name).ok_or_else(|| JudgeError::WhichMotor(names())),
        (None, [only]) => Ok(only),
        (None, _) => Err(JudgeError::WhichMotor(names())),
    }
}

/// Whether frames are close enough in time to say how often the wheel turned. The law says which turn it is, as long as
/// it moves slowly enough somewhere in the film.
fn check_spacing(
    film: &[SeenFrame],
    law: &[(f64, f64)],
    fit: &Fit,
    turn: f64,
    options: &Options,
) -> Result<(), JudgeError> {
    let until_s = options.until_s.unwrap_or(f64::INFINITY);
    let moves = film.windows(2).zip(law.windows(2)).filter(|(film, _)| fit.law_time(film[1].time_s) <= until_s);
    let (mut followed, mut fastest) = (false, (0.0, 0.0, 0.0));
    for (film, law) in moves {
        let turned = (law[1].0 - law[0].0).abs() / turn;
        followed |= (0.002..0.5).contains(&turned);
        if turned > fastest.0 {
            fastest = (turned, fit.law_time(film[0].time_s), film[1].time_s - film[0].time_s);
        }
    }
    let (turned, at_s, interval_s) = fastest;
    if turned < 0.5 || followed {
        return Ok(());
    }
    Err(JudgeError::TooFast { at_s, turned, frames_hz: 1.0 / interval_s, needed_hz: 2.5 * turned / interval_s })
}

/// Whether the film shows the motion at all.
fn check_motion(report: &FilmReport, options: &Options) -> Result<(), JudgeError> {
    if options.align == Align::None {
        return Ok(());
    }
    let range = |of: &dyn Fn(&FilmPoint) -> f64| {
        let (low, high) = report.points.iter().map(of).fold((f64::MAX, f64::MIN), |(a, b), x| (a.min(x), b.max(x)));
        high - low
    };
    let seen_deg = range(&|point| point.angle_deg);
    // A wheel at rest agrees with the law before its start.
    if range(&|point| point.law_deg) < 1e-6 && report.ok {
        return Err(JudgeError::NoMotion { seen_deg });
    }
    Ok(())
}
