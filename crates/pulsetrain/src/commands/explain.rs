//! `pulsetrain explain`: why the planner refuses a motion, or how far the motion is from its limits.

use crate::arguments;
use crate::arguments::Motion;
use clap::Args;
use pulsetrain_core::wire::Baud;
use std::fmt::{self, Display};

use pulsetrain_motion::Time;
use pulsetrain_motion::file::{BrokenPath, FileError, PathPoint, Problem};
use pulsetrain_motion::law::Cursor;
use pulsetrain_motion::program::Motor;
use pulsetrain_plan::error::Limit;
use pulsetrain_plan::{PlanError, Settings};
use schemars::JsonSchema;
use serde::Serialize;

use super::plan;
use crate::console::{Console, Exit};
use crate::diagnostic::{WrongFile, advised};
use pulsetrain_motion::human::{self, Table};
use pulsetrain_report::plan_report::PlanReport;
use pulsetrain_session::estimate::Task;
use pulsetrain_session::fit;
use pulsetrain_session::plans::Planned;
use pulsetrain_session::prepare::{Prepared, Refusal};

#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  pulsetrain explain examples/tutorial-0.01s.toml
  pulsetrain explain examples/tutorial.toml --board uno")]
pub(crate) struct ExplainArgs {
    #[command(flatten)]
    pub(crate) motion: Motion,
    /// Rate of the line that is to bring the plan to the board [default: 1000000; a Pico's own USB, which has no rate]
    #[arg(long, value_name = "BAUD", value_parser = arguments::baud)]
    pub(crate) baud: Option<Baud>,
    /// Print the explanation as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

/// Rows of the table around the place.
const ROWS: u32 = 9;
/// Characters of the longest bar.
const BAR: f64 = 40.0;

#[derive(Serialize, JsonSchema)]
pub(crate) struct Explanation {
    /// The motion file.
    file: String,
    /// The board whose limits hold.
    board: String,
    /// Whether the motion fits.
    fits: bool,
    /// Why it does not fit. Null if it does.
    refusal: Option<Refused>,
    /// How much of each limit a motion takes that fits.
    margins: Vec<Margins>,
}

#[derive(Serialize, JsonSchema)]
pub(crate) struct Refused {
    /// The motor that meets a limit first.
    motor: String,
    /// Which limit.
    message: String,
    /// When, s.
    at_s: Option<f64>,
    /// The motion near that time.
    curve: Vec<Point>,
    /// So many times slower it fits.
    least_slowdown: Option<f64>,
    /// Boards on which it fits as it is.
    other_boards: Vec<String>,
    /// What else this motor breaks, and what each other motor breaks.
    also: Vec<Also>,
    #[serde(skip)]
    advice: String,
    #[serde(skip)]
    limit: Option<LimitLine>,
}

/// A broken limit other than the first one.
#[derive(Serialize, JsonSchema)]
pub(crate) struct Also {
    /// The motor's name.
    motor: String,
    /// Which limit.
    message: String,
    /// When, s.
    at_s: Option<f64>,
}

/// A point of the law near the place.
#[derive(Serialize, JsonSchema)]
pub(crate) struct Point {
    /// The time, s.
    at_s: f64,
    /// The position, steps.
    #[serde(rename = "position_steps")]
    position: f64,
    /// The speed, steps/s.
    #[serde(rename = "speed_steps_per_s")]
    speed: f64,
    /// The acceleration, steps/s².
    #[serde(rename = "acceleration_steps_per_s2")]
    acceleration: f64,
}

/// The quantity that the limit is for, and the limit.
#[derive(Clone, Copy)]
pub(crate) struct LimitLine {
    of: fn(&Point) -> f64,
    name: &'static str,
    unit: &'static str,
    value: f64,
}

/// The share of each limit that a motor's plan uses. `None` where there is no limit.
#[derive(Serialize, JsonSchema)]
pub(crate) struct Margins {
    /// The motor's name.
    motor: String,
    /// The shortest interval between two steps.
    #[serde(rename = "interval_ticks")]
    interval: Option<Use>,
    /// The speed, of max_speed.
    #[serde(rename = "speed_steps_per_s")]
    speed: Option<Use>,
    /// The acceleration, of max_acceleration.
    #[serde(rename = "acceleration_steps_per_s2")]
    acceleration: Option<Use>,
    /// The proven error.
    #[serde(rename = "error_ticks")]
    error: Option<Use>,
    /// The board's queue, its memory for what the motor does next: the time until more is there, and the time that there is for it.
    #[serde(rename = "queue_refill_s")]
    queue: Option<Use>,
    /// What the motor's plan takes of the line to the board, on average.
    #[serde(rename = "line_bytes_per_s")]
    line: Option<Use>,
}

#[derive(Serialize, JsonSchema)]
pub(crate) struct Use {
    /// What the motion takes, in the unit of the key.
    used: f64,
    /// The limit.
    limit: f64,
    /// used/limit, or limit/used for intervals: 1 means that the limit is reached.
    #[serde(rename = "share")]
    part: f64,
}

pub(crate) fn run(args: &ExplainArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    let mut prepared = match args.motion.prepare_any(Task::Plan, args.json, console) {
        Ok(prepared) => prepared,
        Err(report) => {
            let Some(explanation) =
                report.downcast_ref::<WrongFile>().and_then(|wrong| PathExplanations::new(wrong.error()))
            else {
                return Err(report);
            };
            if args.json {
                console.print_json(&explanation)?;
            } else {
                console.print(&explanation)?;
            }
            return Ok(Exit::Refused);
        }
    };
    plan::over_line(&mut prepared, args.baud)?;
    let bar = console.progress(prepared.end_s(), "the motion");
    bar.stage("planning");
    let planned = prepared.prove(|seconds| bar.set(seconds));
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
            Some(PlanReport::new(&prepared, &planned))
        }
        Err(Refusal::Plan { motor, error, advice, .. }) => {
            if let Some(motor) = program.motors.iter().find(|candidate| candidate.name == motor) {
                explanation.refusal = Some(refused(&prepared, motor, &error, advice));
            }
            None
        }
        Err(refusal) => return Err(advised(refusal)),
    };
    if args.json {
        console.print_json(&explanation)?;
    } else if let Some(refused) = &explanation.refusal {
        console.print(text_of(&explanation, refused))?;
    } else if let Some(report) = plan_report {
        console
            .print(format_args!("{report}\nIt fits. Of each limit it uses:\n\n{}", table_of(&explanation.margins)))?;
    }
    Ok(if explanation.fits { Exit::Success } else { Exit::Refused })
}

/// Why a file is refused of which only machines' paths are wrong.
#[derive(Serialize, JsonSchema)]
pub(crate) struct PathExplanations<'a> {
    /// The motion file.
    file: &'a str,
    /// False.
    fits: bool,
    /// Each path that is refused.
    refusals: Vec<PathExplanation<'a>>,
}

/// Why a machine's path is refused.
#[derive(Serialize, JsonSchema)]
pub(crate) struct PathExplanation<'a> {
    /// The machine's name.
    machine: &'a str,
    /// Its kind.
    is: &'a str,
    /// Which limit.
    message: &'a str,
    /// The line of the file.
    line: usize,
    /// When, s.
    at_s: f64,
    /// The limit.
    limit: Option<PathLimit<'a>>,
    /// The path near that time.
    points: Vec<PathRow<'a>>,
    /// So many times slower it fits.
    least_slowdown: Option<f64>,
    #[serde(skip)]
    advice: &'a str,
}

#[derive(Serialize, JsonSchema)]
pub(crate) struct PathLimit<'a> {
    /// The quantity.
    of: &'a str,
    /// Its unit.
    unit: &'static str,
    /// The limit.
    value: f64,
}

#[derive(Serialize, JsonSchema)]
pub(crate) struct PathRow<'a> {
    /// The time, s.
    at_s: f64,
    /// The tip's coordinates, mm.
    tip_mm: &'a [f64],
    /// The quantity that breaks the limit, in its unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    value: Option<f64>,
}

impl<'a> PathExplanations<'a> {
    /// `None` if anything else in the file is wrong, too, since that error comes first.
    fn new(error: &'a FileError) -> Option<PathExplanations<'a>> {
        let problems = error.problems();
        let refusals = problems.iter().map(|problem| Some(PathExplanation::new(problem, problem.path()?)));
        Some(PathExplanations {
            file: problems.first()?.file(),
            fits: false,
            refusals: refusals.collect::<Option<_>>()?,
        })
    }
}

impl Display for PathExplanations<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}: refused", self.file)?;
        self.refusals.iter().enumerate().try_for_each(|(k, refusal)| {
            let blank = if k > 0 { "\n" } else { "" };
            write!(f, "{blank}{refusal}")
        })
    }
}

impl<'a> PathExplanation<'a> {
    fn new(problem: &'a Problem, path: &'a BrokenPath) -> PathExplanation<'a> {
        let rows = path.points.iter();
        PathExplanation {
            machine: &path.machine,
            is: &path.is,
            message: problem.message(),
            line: problem.place().0,
            at_s: path.at_s,
            limit: path.limit.as_ref().map(|(of, unit, value)| PathLimit { of, unit, value: *value }),
            points: rows
                .map(|PathPoint { at_s, tip, value }| PathRow { at_s: *at_s, tip_mm: tip, value: *value })
                .collect(),
            least_slowdown: path.slower.map(fit::rounded_up),
            advice: problem.advice().unwrap_or_default(),
        }
    }
}

impl Display for PathExplanation<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let PathExplanation { machine, is, message, line, points, limit, .. } = self;
        writeln!(f, "  machine {machine}, {is}:\n  line {line}: {message}\n\nThe path near the place")?;
        let mut headings = vec![String::new(), "time".to_owned()];
        let coordinates = points.first().map_or(0, |point| point.tip_mm.len());
        headings.extend(["x, mm", "y, mm", "z, mm"].into_iter().take(coordinates).map(str::to_owned));
        if let Some(PathLimit { of, unit, .. }) = limit {
            headings.extend([format!("{of}, {unit}"), String::new()]);
        }
        let last = headings.len() - 1;
        let left = if limit.is_some() { vec![0, last] } else { vec![0] };
        let mut table = Table::default().left(&left);
        table.row(headings);
        let most = points.iter().filter_map(|point| point.value).chain(limit.as_ref().map(|limit| limit.value));
        let most = most.map(f64::abs).fold(0.0, f64::max);
        for point in points {
            let here = if point.at_s == self.at_s { "→" } else { "" };
            let mut row = vec![here.to_owned(), human::seconds_to(point.at_s, 4)];
            row.extend(point.tip_mm.iter().map(|mm| format!("{mm:.3}")));
            if let (Some(limit), Some(value)) = (limit, point.value) {
                // An angle may be beyond a limit below 0.
                let way = if limit.value < 0.0 { -1.0 } else { 1.0 };
                row.extend([format!("{value:.1}"), bar((way * value).max(0.0), way * limit.value, most)]);
            }
            table.row(row);
        }
        if let Some(PathLimit { unit, value, .. }) = limit {
            let mut row = vec![String::new(); last];
            row.push(format!("│ is the limit: {value:.1} {unit}"));
            table.row(row);
        }
        writeln!(f, "{table}\nWhat would fit\n  {}", self.advice)?;
        match self.least_slowdown {
            Some(factor) => {
                let times = human::significant(factor, 4);
                writeln!(f, "  {times} times slower it keeps to the machine's limits, its `ease` included")
            }
            None => Ok(()),
        }
    }
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
    // If the user slows the motion down, using up its slack takes as long as before. So the advice says how long that
    // has to take.
    let is_limit = error.limit().is_some_and(|limit| limit != Limit::Line) && motor.law.backlash_over().is_none();
    Refused {
        motor: motor.name.clone(),
        message: error.to_string(),
        at_s: error.at_s(),
        curve: error.at_s().map_or_else(Vec::new, |at_s| curve(motor, at_s)),
        least_slowdown: is_limit.then(|| fit::least_slowdown(prepared, motor)).flatten(),
        also: also(prepared, motor, error),
        other_boards: match error.limit() {
            Some(Limit::Board | Limit::Line) => fit::other_boards(prepared),
            _ => Vec::new(),
        },
        advice,
        limit: limit.map(|(of, name, unit, value)| LimitLine { of, name, unit, value }),
    }
}

/// All broken limits except the one that is met first.
fn also(prepared: &Prepared, first: &Motor, met: &PlanError) -> Vec<Also> {
    let motors = prepared.program.motors.iter().flat_map(|motor| {
        let is_first = motor.name == first.name;
        let broken = fit::broken(&motor.law, &Settings::of(&prepared.program, motor)).into_iter();
        broken.filter(move |error| !is_first || error.limit() != met.limit()).map(|error| Also {
            motor: motor.name.clone(),
            message: error.to_string(),
            at_s: error.at_s(),
        })
    });
    motors.collect()
}

fn speed(point: &Point) -> f64 {
    point.speed.abs()
}

fn acceleration(point: &Point) -> f64 {
    point.acceleration.abs()
}

/// Points of the law around the place. The range is twice as long after it as before, since a motion meets a limit on
/// its way up.
fn curve(motor: &Motor, at_s: f64) -> Vec<Point> {
    let end_s = motor.law.end().map_or(at_s * 2.0, Time::seconds);
    let span = (0.1 * end_s).min(at_s.max(0.01 * end_s));
    let (from, to) = ((at_s - span).max(0.0), (at_s + 2.0 * span).min(end_s));
    let mut cursor = Cursor::new(&motor.law);
    // The place itself is one of the points.
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
    for Also { motor, message, .. } in &refused.also {
        text.push_str(&format!("  motor {motor}: {message}\n"));
    }
    if !refused.curve.is_empty() {
        let near = if refused.also.is_empty() { "the place" } else { "the first of these places" };
        text.push_str(&format!("\nThe motion near {near}\n{}", curve_table(refused)));
    }
    let advice: Vec<&str> = refused.advice.lines().filter(|line| !line.contains("pulsetrain explain")).collect();
    if !advice.is_empty() {
        text.push_str(&format!("\nWhat would fit\n  {}\n", advice.join("\n  ")));
    }
    text
}

/// The points, with a bar for the quantity that breaks the limit. `│` is the limit.
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
        queue: planned.tightest.map(|refill| of(refill.needed_s, refill.available_s)),
        line: prepared.line.as_ref().filter(|_| planned.last_tick > 0).map(|line| {
            let duration_s = planned.last_tick as f64 / line.tick_hz as f64;
            of(certificate.bytes as f64 / duration_s, line.tick_hz as f64 / line.byte_ticks)
        }),
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
            ("queue refill, s", &motor.queue),
            ("line, bytes/s", &motor.line),
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
