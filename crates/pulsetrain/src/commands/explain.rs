//! `pulsetrain explain`: why a motion is refused, or how far it is from its limits.

use pulsetrain_motion::Time;
use pulsetrain_motion::law::Cursor;
use pulsetrain_motion::program::Motor;
use pulsetrain_plan::error::Limit;
use pulsetrain_plan::{PlanError, Settings};
use serde::Serialize;

use super::plan;
use crate::cli::Explain;
use crate::console::{Console, Exit};
use crate::fit;
use crate::human::{self, Table};
use crate::prepare::{Planned, Prepared, Refusal};

/// Rows of the table around the place.
const ROWS: u32 = 9;
/// Characters of the longest bar.
const BAR: f64 = 40.0;

#[derive(Serialize)]
struct Explanation {
    file: String,
    board: String,
    fits: bool,
    refusal: Option<Refused>,
    margins: Vec<Margins>,
}

#[derive(Serialize)]
struct Refused {
    motor: String,
    message: String,
    at_s: Option<f64>,
    curve: Vec<Point>,
    least_slowdown: Option<f64>,
    other_boards: Vec<String>,
    #[serde(skip)]
    advice: String,
    #[serde(skip)]
    limit: Option<LimitLine>,
}

/// A point of the law near the place.
#[derive(Serialize)]
struct Point {
    at_s: f64,
    position: f64,
    speed: f64,
    acceleration: f64,
}

/// What is compared with the limit, and the limit itself.
#[derive(Clone, Copy)]
struct LimitLine {
    of: fn(&Point) -> f64,
    name: &'static str,
    unit: &'static str,
    value: f64,
}

/// How much of each limit a motor's plan uses; `None` where there is no limit.
#[derive(Serialize)]
struct Margins {
    motor: String,
    interval: Option<Use>,
    speed: Option<Use>,
    acceleration: Option<Use>,
    error: Option<Use>,
}

#[derive(Serialize)]
struct Use {
    used: f64,
    limit: f64,
    /// used/limit, or limit/used for intervals: 1 is all of it.
    part: f64,
}

pub(crate) fn run(args: &Explain, console: &mut Console<'_>) -> miette::Result<Exit> {
    let prepared = args.motion.prepare()?;
    let bar = console.progress(prepared.end_s(), "the motion");
    bar.stage("planning");
    let planned = prepared.plan(|seconds| bar.set(seconds));
    drop(bar);
    let program = &prepared.program;
    let mut explanation = Explanation {
        file: prepared.file.clone(),
        board: program.board.name.clone(),
        fits: planned.is_ok(),
        refusal: None,
        margins: Vec::new(),
    };
    let plan_report = match planned {
        Ok(planned) => {
            explanation.margins = program
                .motors
                .iter()
                .zip(&planned)
                .map(|(motor, planned)| margins(&prepared, motor, planned))
                .collect();
            Some(plan::report(&prepared, &planned))
        }
        Err(Refusal::Plan { motor, error, advice, .. }) => {
            if let Some(motor) = program.motors.iter().find(|candidate| candidate.name == motor) {
                explanation.refusal = Some(refused(&prepared, motor, &error, advice));
            }
            None
        }
        Err(refusal) => return Err(refusal.into()),
    };
    if args.json {
        console.print_json(&explanation)?;
    } else if let Some(refused) = &explanation.refusal {
        console.print(text_of(&explanation, refused))?;
    } else if let Some(report) = plan_report {
        console.print(format_args!("{report}It fits. Of each limit it uses:\n\n{}", table_of(&explanation.margins)))?;
    }
    // The motion may be refused; explaining that was what was asked for.
    Ok(Exit::Success)
}

fn refused(prepared: &Prepared, motor: &Motor, error: &PlanError, advice: String) -> Refused {
    let limit = match *error {
        PlanError::TooFastForBoard { limit_hz, .. } => Some((speed as fn(&Point) -> f64, "speed", "steps/s", limit_hz)),
        PlanError::TooFast { limit, .. } => Some((speed as fn(&Point) -> f64, "speed", "steps/s", limit)),
        PlanError::TooMuchAcceleration { limit, .. } => {
            Some((acceleration as fn(&Point) -> f64, "acceleration", "steps/s²", limit))
        }
        _ => None,
    };
    let is_limit = error.limit().is_some();
    Refused {
        motor: motor.name.clone(),
        message: error.to_string(),
        at_s: error.at_s(),
        curve: error.at_s().map_or_else(Vec::new, |at_s| curve(motor, at_s)),
        least_slowdown: is_limit.then(|| fit::least_slowdown(prepared, motor)).flatten(),
        other_boards: if error.limit() == Some(Limit::Board) { fit::other_boards(prepared) } else { Vec::new() },
        advice,
        limit: limit.map(|(of, name, unit, value)| LimitLine { of, name, unit, value }),
    }
}

fn speed(point: &Point) -> f64 {
    point.speed.abs()
}

fn acceleration(point: &Point) -> f64 {
    point.acceleration.abs()
}

/// The law around the place: twice as long after it as before, since a limit is met on the way up.
fn curve(motor: &Motor, at_s: f64) -> Vec<Point> {
    let end_s = motor.law.end().map_or(at_s * 2.0, Time::seconds);
    let span = (0.1 * end_s).min(at_s.max(0.01 * end_s));
    let (from, to) = ((at_s - span).max(0.0), (at_s + 2.0 * span).min(end_s));
    let mut cursor = Cursor::new(&motor.law);
    // The place itself is among the points.
    let times = (0..ROWS).map(|k| from + (to - from) * f64::from(k) / f64::from(ROWS - 1));
    let mut times: Vec<f64> = times.chain([at_s]).collect();
    times.sort_by(f64::total_cmp);
    times.dedup();
    let points = times.into_iter().map_while(|at_s| {
        let sample = cursor.at(Time::from_seconds(at_s)).ok()?;
        Some(Point { at_s, position: sample.position, speed: sample.speed, acceleration: sample.acceleration })
    });
    points.collect()
}

fn text_of(explanation: &Explanation, refused: &Refused) -> String {
    let Explanation { file, board, .. } = explanation;
    let mut text = format!("{file} on {board}: refused\n  motor {}: {}\n", refused.motor, refused.message);
    if !refused.curve.is_empty() {
        text.push_str(&format!("\nThe motion near the place\n{}", curve_table(refused)));
    }
    let advice: Vec<&str> = refused.advice.lines().filter(|line| !line.contains("pulsetrain explain")).collect();
    if !advice.is_empty() {
        text.push_str(&format!("\nWhat would fit\n  {}\n", advice.join("\n  ")));
    }
    text
}

/// The points, with a bar for what breaks the limit: `│` is the limit.
fn curve_table(refused: &Refused) -> Table {
    let mut table = match refused.limit {
        Some(_) => Table::new(["", "time", "position, steps", "speed, steps/s", "acceleration, steps/s²", ""]),
        None => Table::new(["", "time", "position, steps", "speed, steps/s", "acceleration, steps/s²"]),
    }
    .left(&[0, 5]);
    let most = refused.limit.map_or(1.0, |limit| refused.curve.iter().map(limit.of).fold(limit.value, f64::max));
    for point in &refused.curve {
        let here = if refused.at_s == Some(point.at_s) { "→" } else { "" };
        let mut row = vec![
            here.to_owned(),
            human::seconds_to(point.at_s, 4),
            human::significant(point.position, 6),
            human::significant(point.speed, 4),
            human::significant(point.acceleration, 3),
        ];
        row.extend(refused.limit.map(|limit| bar((limit.of)(point), limit.value, most)));
        table.row(row);
    }
    if let Some(limit) = refused.limit {
        let limit_is = format!("│ is the limit: {} {} {}", human::significant(limit.value, 4), limit.unit, limit.name);
        table.row([String::new(), String::new(), String::new(), String::new(), String::new(), limit_is]);
    }
    table
}

fn bar(value: f64, limit: f64, most: f64) -> String {
    let place = |value: f64| (BAR * value / most).round() as usize;
    let (end, mark) = (place(value), place(limit));
    (0..=end.max(mark))
        .map(|i| {
            if i == mark {
                '│'
            } else if i < end {
                '━'
            } else {
                ' '
            }
        })
        .collect()
}

fn margins(prepared: &Prepared, motor: &Motor, planned: &Planned) -> Margins {
    let settings = Settings::of(&prepared.program, motor);
    let certificate = &planned.certificate;
    let of = |used: f64, limit: f64| Use { used, limit, part: used / limit };
    Margins {
        motor: motor.name.clone(),
        interval: certificate.shortest_interval_ticks.map(|ticks| {
            let (used, limit) = (ticks as f64, settings.min_interval_ticks as f64);
            Use { used, limit, part: limit / used }
        }),
        speed: settings.limits.max_speed.map(|limit| of(certificate.peak_speed.0, limit)),
        acceleration: settings.limits.max_acceleration.map(|limit| of(certificate.peak_acceleration.0, limit)),
        error: Some(of(certificate.bound_ticks, settings.tolerance_ticks)),
    }
}

fn table_of(margins: &[Margins]) -> Table {
    let mut table = Table::new(["motor", "limit", "used", "of", ""]).left(&[0, 1]);
    for motor in margins {
        let lines = [
            ("shortest interval, ticks", &motor.interval),
            ("speed, steps/s", &motor.speed),
            ("acceleration, steps/s²", &motor.acceleration),
            ("error, ticks", &motor.error),
        ];
        for (name, line) in lines {
            let Some(line) = line else { continue };
            table.row([
                motor.motor.clone(),
                name.to_owned(),
                human::significant(line.used, 5),
                human::significant(line.limit, 5),
                format!("{} %", human::significant(line.part * 100.0, 3)),
            ]);
        }
    }
    table
}
