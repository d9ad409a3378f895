//! `pulsetrain formula`: what a formula comes to, without a motion file.

use std::cell::Cell;
use std::path::PathBuf;

use clap::Args;
use miette::miette;
use pulsetrain_core::Recurrence;
use pulsetrain_motion::human::{self, Table};
use pulsetrain_motion::law::{Begin, Cursor, End, formula_functions};
use pulsetrain_motion::quantity::Quantity;
use pulsetrain_motion::{Law, LawError, Time, file};
use pulsetrain_plan::{Ensemble, Move, PlanError};
use pulsetrain_session::drive::Driven;
use pulsetrain_session::prepare::{Prepared, Refusal};
use schemars::JsonSchema;
use serde::Serialize;

use super::run;
use crate::arguments;
use crate::console::{Console, Exit};
use crate::diagnostic::{WrongFile, advised};
use pulsetrain_report::plan_report::{ParameterReport, Peak};

#[derive(Args, Debug)]
#[command(after_help = "\
The language: docs/formulas.md.

Examples:
  pulsetrain formula \"90*sin(2*pi*0.5*t)^3\"
  pulsetrain formula \"a*sin(2*pi*f*t)^3\" --where \"a = 90, f = 0.5 Hz\" --at \"1.5 s\"
  pulsetrain formula \"10*t^2\" --unit mm --lead \"8 mm\" --duration \"2 s\" --plot parabola.svg
  pulsetrain formula \"-2*sin(t)^2\" --unit rev --duration \"4 s\" --board uno
  pulsetrain formula --list                  all functions, with an example each")]
pub(crate) struct FormulaArgs {
    /// The position: a formula of `t`, the time in s
    #[arg(value_name = "THETA", required_unless_present = "list", allow_hyphen_values = true)]
    pub(crate) theta: Option<String>,
    /// Unit of the position: deg, rad, rev, step, full-step, mm, cm, m or in
    #[arg(long, value_name = "UNIT", default_value = "deg")]
    pub(crate) unit: String,
    /// How long it lasts, with its unit
    #[arg(long, value_name = "TIME", default_value = "10 s", allow_hyphen_values = true)]
    pub(crate) duration: String,
    /// A parameter and its value: "a = 3", "f = 0.5 Hz"; several with commas between, or again
    #[arg(long = "where", value_name = "NAME = VALUE", allow_hyphen_values = true)]
    pub(crate) parameters: Vec<String>,
    /// A time at which to print it; again for more [default: 21, from beginning to end]
    #[arg(long, value_name = "TIME", value_parser = moment, allow_hyphen_values = true)]
    pub(crate) at: Vec<Time>,
    /// Full steps in one revolution of the motor
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = arguments::steps_per_rev)]
    pub(crate) steps_per_rev: u32,
    /// Steps that the driver makes of a full step
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=256))]
    pub(crate) microsteps: u32,
    /// Travel in one turn, for lengths
    #[arg(long, value_name = "LENGTH")]
    pub(crate) lead: Option<String>,
    /// The board that makes the steps
    #[arg(long, value_name = "BOARD", value_parser = arguments::board, default_value = "native")]
    pub(crate) board: String,
    /// How many of its steps to print
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u16).range(0..=10_000))]
    pub(crate) steps: u16,
    /// Draw it, .svg or .png
    #[arg(long, value_name = "FILE")]
    pub(crate) plot: Option<PathBuf>,
    /// List the functions that formulas have
    #[arg(long, exclusive = true)]
    pub(crate) list: bool,
    /// Print the figures as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

/// Points of each piece of a law in which its extremes are looked for, at least and at most, and of all of them together.
const POINTS: (usize, usize, usize) = (16, 2048, 20_000_000);
/// Windows of a formula that are cut, times its operations, at most: about a second.
const MAX_WINDOW_WORK: usize = 1_000_000;
/// Operations for the extremes of a formula, at most: about two seconds.
const MAX_WORK: u64 = 100_000_000;
/// Rows of the table, if no times are given.
const ROWS: u64 = 21;

/// What a formula does.
#[derive(Serialize, JsonSchema)]
pub(crate) struct TriedFormula {
    /// The formula.
    formula: String,
    /// The unit of its value.
    unit: &'static str,
    /// How long it was tried for, s.
    duration_s: f64,
    /// The values of its parameters.
    parameters: Vec<ParameterReport>,
    /// Its value at some times.
    points: Vec<FormulaPoint>,
    /// The lowest value, in `unit`.
    lowest: Peak,
    /// The highest value, in `unit`.
    highest: Peak,
    /// The largest speed, in `unit` per second.
    peak_speed: Peak,
    /// The largest acceleration, in `unit` per second squared.
    peak_acceleration: Peak,
    /// `None` if the steps cannot be planned.
    steps: Option<FirstSteps>,
    /// What a motion of the formula alone breaks.
    refused: Option<FormulaRefusal>,
}

/// Why a motion of the formula alone would be refused.
#[derive(Serialize, JsonSchema)]
pub(crate) struct FormulaRefusal {
    /// What is wrong.
    message: String,
    /// What to write into its file.
    advice: String,
}

impl FormulaRefusal {
    fn new(refusal: &Refusal) -> FormulaRefusal {
        let message = match refusal {
            Refusal::Plan { error, .. } => error.to_string(),
            refusal => refusal.to_string(),
        };
        // Its last line names a command that wants a file.
        let lines = refusal.advice().unwrap_or_default().lines();
        let advice = lines.filter(|line| !line.contains("pulsetrain explain")).collect::<Vec<_>>().join("\n");
        FormulaRefusal { message, advice }
    }
}

/// The formula at a time, in its unit.
#[derive(Serialize, JsonSchema)]
pub(crate) struct FormulaPoint {
    /// The time, s.
    at_s: f64,
    /// The value, in `unit`.
    position: f64,
    /// In `unit` per second.
    speed: f64,
    /// In `unit` per second squared.
    acceleration: f64,
}

/// The steps of a formula.
#[derive(Serialize, JsonSchema)]
pub(crate) struct FirstSteps {
    /// The board that they are planned for.
    board: String,
    /// Full steps in a turn of the motor.
    steps_per_rev: u32,
    /// Steps in a full step.
    microsteps: u32,
    /// One tick of the board's timer, s.
    tick_s: f64,
    /// How many steps the whole formula takes.
    count: u64,
    /// How far a step may be from its exact time, ticks.
    proven_error_ticks: f64,
    /// The first steps.
    first: Vec<FirstStep>,
}

/// A step of a formula.
#[derive(Serialize, JsonSchema)]
pub(crate) struct FirstStep {
    /// Its number, from 1 on.
    n: usize,
    /// Its tick.
    tick: u64,
    /// Its time, s.
    at_s: f64,
    /// Steps from where the motor was.
    position: i64,
}

/// Largest and smallest value of something, with its times.
#[derive(Clone, Copy)]
struct Extremes {
    low: (f64, f64),
    high: (f64, f64),
}

impl Extremes {
    const NONE: Extremes = Extremes { low: (f64::INFINITY, 0.0), high: (f64::NEG_INFINITY, 0.0) };

    /// Takes a value into account. Of equal ones, up to rounding, the first stays.
    fn add(&mut self, value: f64, at_s: f64) {
        const SAME: f64 = 1e-9;
        if !self.low.0.is_finite() || value < self.low.0 - SAME * self.low.0.abs() {
            self.low = (value, at_s);
        }
        if !self.high.0.is_finite() || value > self.high.0 + SAME * self.high.0.abs() {
            self.high = (value, at_s);
        }
    }

    /// The one that is larger without its sign.
    fn peak(&self) -> (f64, f64) {
        let (low, high) = (self.low, self.high);
        let is_low =
            low.0.abs() > high.0.abs() * (1.0 + 1e-9) || low.0.abs() > high.0.abs() * (1.0 - 1e-9) && low.1 < high.1;
        if is_low { (low.0.abs(), low.1) } else { (high.0.abs(), high.1) }
    }
}

pub(crate) fn run(args: &FormulaArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    let Some(theta) = args.theta.as_deref().filter(|_| !args.list) else {
        console.print(functions())?;
        return Ok(Exit::Success);
    };
    let text = motion_file(args, theta)?;
    let contents = file::read_contents(&text, "formula", &|_| Err(std::io::ErrorKind::NotFound.into()));
    let contents = contents.map_err(WrongFile::from)?;
    let mut prepared = Prepared::new("formula".to_owned(), contents, None).map_err(advised)?;
    let motor = &prepared.program.motors[0];
    let (law, scale) = (motor.law.clone(), motor.scale.clone());
    let duration = law.end().unwrap_or(Time::SECOND);
    let broken = |error: LawError| miette!("{error}");
    let one = Quantity::parse(&format!("1 {}", args.unit.trim())).map_err(|error| miette!("{error}"))?;
    // The scale is the file's choice of unit; the user's may be another name of it, or another length.
    let per_unit = scale.steps_per_unit * one.value / own_value(&scale.unit);

    let times: Vec<Time> = if args.at.is_empty() {
        (0..ROWS).map(|k| Time::from_raw(duration.raw() / i128::from(ROWS - 1) * i128::from(k))).collect()
    } else {
        args.at.clone()
    };
    if let Some(late) = times.iter().find(|time| **time > duration) {
        let help = "give a longer --duration";
        return Err(miette!(
            help = help,
            "{} s is after the formula's end at {} s",
            late.seconds(),
            duration.seconds()
        ));
    }
    let operations = theta.matches(|c: char| "+-*/^(".contains(c)).count() + 1;
    let [position, speed, acceleration] = extremes(&law, operations).map_err(|error| match error {
        NoExtremes::Law(error) => broken(error),
        NoExtremes::TooMany(_) => miette!(help = "give a shorter --duration", "{error}"),
    })?;
    let mut cursor = Cursor::new(&law);
    let mut points = Vec::new();
    for time in times {
        let sample = cursor.at(time).map_err(broken)?;
        // What is but rounding is 0.
        let in_unit = |value: f64, extremes: &Extremes| {
            if value.abs() < 1e-12 * extremes.peak().0 { 0.0 } else { value / per_unit }
        };
        points.push(FormulaPoint {
            at_s: time.seconds(),
            position: in_unit(sample.position, &position),
            speed: in_unit(sample.speed, &speed),
            acceleration: in_unit(sample.acceleration, &acceleration),
        });
    }
    let peak = |(steps, at_s): (f64, f64)| Peak { value: steps / per_unit, at_s };
    let parameters = law.formula_parameters().into_iter().flatten().map(ParameterReport::new).collect();
    let mut report = TriedFormula {
        formula: theta.to_owned(),
        unit: one.unit,
        duration_s: duration.seconds(),
        parameters,
        points,
        lowest: peak(position.low),
        highest: peak(position.high),
        peak_speed: peak(speed.peak()),
        peak_acceleration: peak(acceleration.peak()),
        steps: None,
        refused: None,
    };

    // A formula that turns often may take as long to plan as an ordinary one of a whole day.
    let bar = console.progress(duration.seconds(), "the formula");
    bar.stage("planning");
    let mut planned = prepared.prove(|at_s| bar.set(at_s));
    if let Err(refusal) = &planned
        && let Some(jumping) = without_ramps(&law)
    {
        report.refused = Some(FormulaRefusal::new(refusal));
        prepared.program.motors[0].law = jumping;
        planned = prepared.prove(|at_s| bar.set(at_s));
    }
    drop(bar);
    if let Ok(planned) = &planned {
        let certificate = &planned[0].certificate;
        report.steps = Some(FirstSteps {
            board: prepared.program.board.name.clone(),
            steps_per_rev: args.steps_per_rev,
            microsteps: args.microsteps,
            tick_s: 1.0 / prepared.program.board.tick_hz as f64,
            count: certificate.steps,
            proven_error_ticks: certificate.bound_ticks,
            first: first_steps(&prepared, usize::from(args.steps)).map_err(|error| miette!("{error}"))?,
        });
    }
    if args.json && planned.is_ok() {
        console.print_json(&report)?;
    } else if !args.json {
        console.print(report.text(per_unit))?;
    }
    let planned = planned.map_err(advised)?;
    if let Some(path) = &args.plot {
        let driven = Driven::native(&prepared).map_err(advised)?;
        run::draw(&run::recorded(&prepared, planned, driven, console)?.picture, path, "--plot")?;
        if !args.json {
            console.print(format_args!("{}\n", path.display()))?;
        }
    }
    Ok(Exit::Success)
}

/// One of a unit of positions, in that of its base.
fn own_value(unit: &str) -> f64 {
    Quantity::parse(&format!("1 {unit}")).map_or(1.0, |one| one.value)
}

/// A law that begins and ends at once, whatever its speed.
fn without_ramps(law: &Law) -> Option<Law> {
    law.clone().beginning(Begin::Jump).and_then(|law| law.ending(End::Jump)).ok()
}

/// A motion file of the formula alone. What the user gave stands first, a line each, for messages.
fn motion_file(args: &FormulaArgs, theta: &str) -> miette::Result<String> {
    let mut text = format!("board = {}\n[motion.law.formula]\ntheta = {}\n", quoted(&args.board), quoted(theta));
    text += &format!("unit = {}\nduration = {}\n", quoted(args.unit.trim()), quoted(args.duration.trim()));
    let parameters: Vec<(String, String)> =
        args.parameters.iter().map(|list| assignments(list)).collect::<miette::Result<Vec<_>>>()?.concat();
    if !parameters.is_empty() {
        text += "[motion.law.formula.where]\n";
    }
    for (name, value) in parameters {
        text += &format!(
            "{} = {}\n",
            key(&name),
            if value.parse::<f64>().is_ok_and(f64::is_finite) { number(&value) } else { quoted(&value) }
        );
    }
    text += "[motion]\nmotor = \"motor\"\n[motor.motor]\n";
    text += &format!("steps_per_rev = {}\nmicrosteps = {}\n", args.steps_per_rev, args.microsteps);
    let is_length = Quantity::parse(&format!("1 {}", args.unit.trim()))
        .is_ok_and(|one| one.base == pulsetrain_motion::quantity::Base::Length);
    match &args.lead {
        Some(lead) => text += &format!("lead = {}\n", quoted(lead)),
        None if is_length => {
            return Err(miette!(
                help = "add, for example: --lead \"8 mm\"",
                "a motor turns: for `{}` its travel in one turn is needed",
                args.unit
            ));
        }
        None => {}
    }
    text += "pulse_high = \"100 ns\"\npins = { step = 2, dir = 3 }\nforward = \"high\"\n";
    Ok(text)
}

/// A text as TOML has it.
fn quoted(text: &str) -> String {
    if text.contains('\'') || text.chars().any(char::is_control) {
        // JSON's escapes are TOML's, too.
        return serde_json::Value::from(text).to_string();
    }
    format!("'{text}'")
}

fn key(name: &str) -> String {
    if !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_') {
        name.to_owned()
    } else {
        quoted(name)
    }
}

/// A number as TOML has it: .5 and 3. are none there.
fn number(text: &str) -> String {
    text.parse::<f64>().map_or_else(|_| text.to_owned(), |number| format!("{number:?}"))
}

/// Names and values: "a = 3, f = 0.5 Hz". A comma within a value is the value's.
fn assignments(list: &str) -> miette::Result<Vec<(String, String)>> {
    let mut found: Vec<(String, String)> = Vec::new();
    for part in list.split([',', ';']) {
        match (part.split_once('='), found.last_mut()) {
            (Some((name, value)), _) => {
                let value = value.trim().trim_matches(['"', '\'']);
                found.push((name.trim().to_owned(), value.to_owned()));
            }
            (None, Some((_, value))) => *value += &format!(",{part}"),
            (None, None) => {}
        }
    }
    let is_name = |name: &str| !name.is_empty() && name.chars().all(|c| c.is_alphanumeric() || c == '_');
    let is_good = !found.is_empty() && found.iter().all(|(name, value)| is_name(name) && !value.is_empty());
    if is_good {
        return Ok(found);
    }
    Err(miette!(
        help = "write it like --where \"a = 3\", or --where \"f = 0.5 Hz\"",
        "`{list}` gives no parameter a value"
    ))
}

/// Reads a time of at least 0 s.
fn moment(text: &str) -> Result<Time, String> {
    let is_zero = Quantity::parse(text).is_ok_and(|quantity| quantity.time() == Some(Time::ZERO));
    if is_zero || text.trim() == "0" {
        return Ok(Time::ZERO);
    }
    arguments::duration(text)
}

/// Why a formula is not looked at to its end.
#[derive(Debug, thiserror::Error)]
enum NoExtremes {
    #[error("{0}")]
    Law(#[from] LawError),
    /// Until when it was, s.
    #[error("the formula turns too often to be looked at to its end: up to {} s it took as long as one may", human::significant(*.0, 9))]
    TooMany(f64),
}

/// Of position, speed and acceleration, in steps: the extremes over the whole law. `operations` are those of its formula.
fn extremes(law: &Law, operations: usize) -> Result<[Extremes; 3], NoExtremes> {
    let mut count = 0;
    for piece in law.pieces() {
        let piece = piece?;
        count += 1;
        if count * operations.max(1) > MAX_WINDOW_WORK {
            return Err(NoExtremes::TooMany(piece.start.seconds()));
        }
    }
    let (least, most, all) = POINTS;
    let points = (all / (count.max(1) * operations.max(1))).clamp(least, most);
    let mut found = [Extremes::NONE; 3];
    let work = Cell::new(0_u64);
    for piece in law.pieces() {
        let piece = piece?;
        let (first, last) = (piece.first(), piece.last());
        // Position, speed, acceleration, jerk.
        let of = |u: f64| {
            work.set(work.get() + operations as u64);
            let jet = piece.curve.jet(u);
            [piece.origin as f64 + jet[0], jet[1], 2.0 * jet[2], 6.0 * jet[3]]
        };
        let zero = piece.zero.seconds();
        let mut before = (first, of(first));
        for k in 0..=points {
            let u = first + (last - first) * k as f64 / points as f64;
            let here = of(u);
            for (order, extremes) in found.iter_mut().enumerate() {
                extremes.add(here[order], zero + u);
                // Between two points the extreme is where its rate is 0.
                if before.1[order + 1] * here[order + 1] < 0.0 {
                    let at = root(before.0, u, |u| of(u)[order + 1]);
                    extremes.add(of(at)[order], zero + at);
                }
            }
            before = (u, here);
            if work.get() > MAX_WORK {
                return Err(NoExtremes::TooMany(zero + u));
            }
        }
    }
    Ok(found)
}

/// Where a function changes its sign between two places.
fn root(mut from: f64, mut to: f64, of: impl Fn(f64) -> f64) -> f64 {
    let first = of(from);
    for _ in 0..60 {
        let middle = 0.5 * (from + to);
        if of(middle) * first > 0.0 { from = middle } else { to = middle }
    }
    0.5 * (from + to)
}

/// The first steps of the only motor.
fn first_steps(prepared: &Prepared, count: usize) -> Result<Vec<FirstStep>, PlanError> {
    let board = &prepared.program.board;
    let mut ensemble = Ensemble::new(&prepared.program).map_err(|refused| refused.error)?;
    let mut registers = Recurrence { accumulator: 1 << (board.registers.fraction_bits - 1), ..Recurrence::default() };
    let (mut position, mut steps) = (0, Vec::new());
    while steps.len() < count {
        match ensemble.next_move(0).map_err(|refused| refused.error)? {
            None => break,
            Some(Move::Dwell { ticks }) => registers.accumulator += ticks << board.registers.fraction_bits,
            Some(Move::Run { segment, direction }) => {
                registers.load(&segment);
                for _ in 0..segment.count.min(u32::try_from(count - steps.len()).unwrap_or(u32::MAX)) {
                    registers.advance();
                    position += i64::from(direction.sign());
                    let tick = registers.accumulator >> board.registers.fraction_bits;
                    steps.push(FirstStep {
                        n: steps.len() + 1,
                        tick,
                        at_s: tick as f64 / board.tick_hz as f64,
                        position,
                    });
                }
            }
        }
    }
    Ok(steps)
}

impl TriedFormula {
    fn text(&self, steps_per_unit: f64) -> String {
        let unit = human::unit(self.unit);
        let six = |value: f64| human::significant(value, 6);
        let time = |seconds: f64| if seconds == 0.0 { "0 s".to_owned() } else { format!("{} s", six(seconds)) };
        let mut text = format!("θ(t) = {}, in {unit}, for {}\n", self.formula, time(self.duration_s));
        for parameter in &self.parameters {
            text += &format!("  {parameter}\n");
        }
        let mut table = Table::new(["time", "position", "speed", "acceleration"]);
        table.row([String::new(), unit.to_owned(), format!("{unit}/s"), format!("{unit}/s²")]);
        for point in &self.points {
            table.row([time(point.at_s), six(point.position), six(point.speed), six(point.acceleration)]);
        }
        text += &format!("\n{table}\n");
        let mut figures = Table::new(["", "", ""]).left(&[0, 2]);
        let mut row = |name: &str, peak: Peak, per: &str| {
            figures.row([
                name.to_owned(),
                format!("{} {unit}{per}", six(peak.value)),
                format!("at {}", time(peak.at_s)),
            ]);
        };
        row("lowest", self.lowest, "");
        row("highest", self.highest, "");
        row("fastest", self.peak_speed, "/s");
        row("acceleration", self.peak_acceleration, "/s²");
        text += figures.to_string().split_once('\n').map_or("", |(_, rows)| rows);
        let Some(steps) = &self.steps else { return text };
        let FirstSteps { board, steps_per_rev, microsteps, tick_s, count, proven_error_ticks, first } = steps;
        text += &format!(
            "\n{} steps, {steps_per_rev} × {microsteps} in a turn of the motor, on {board} (tick {}), each within {} ticks of its time\n",
            human::count(i128::from(*count)),
            human::seconds(*tick_s),
            human::significant(*proven_error_ticks, 3)
        );
        let mut table = Table::new(["n", "t_n", "after", "position"]);
        let mut before = 0.0;
        for step in first {
            let position = step.position as f64 / steps_per_unit;
            let after = human::seconds_to(step.at_s - before, 4);
            table.row([step.n.to_string(), format!("{:.9} s", step.at_s), after, format!("{} {unit}", six(position))]);
            before = step.at_s;
        }
        if !first.is_empty() {
            text += &format!("\n{table}");
        }
        if let Some(FormulaRefusal { message, advice }) = &self.refused {
            text += "\nThese steps begin and end at the formula's own speed. A motion file of it alone is refused:\n";
            for line in [message.as_str()].into_iter().chain(advice.lines()) {
                text += &format!("  {}\n", line.trim());
            }
        }
        text
    }
}

/// All functions, with their arguments, domain and an example.
fn functions() -> Table {
    let mut table = Table::new(["function", "gives", "for", "example"]).left(&[0, 1, 2, 3]);
    for row in formula_functions() {
        let (call, value) = row.example;
        table.row([
            format!("{}({})", row.name, row.arguments),
            row.about.to_owned(),
            row.domain.to_owned(),
            format!("{call} = {value}"),
        ]);
    }
    table
}
