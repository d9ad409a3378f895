//! The report of a plan: JSON for programs, tables for people.

use std::fmt::{self, Display};

use pulsetrain_motion::Time;
use pulsetrain_motion::file::{ColumnDistance, ColumnUse, Smoothing, TableColumns};
use pulsetrain_motion::human::{self, Table};
use pulsetrain_motion::law::{Class, Cursor, ParameterUse};
use pulsetrain_motion::program::{Motor, Program};
use pulsetrain_plan::Settings;
use pulsetrain_session::pause::Paused;
use pulsetrain_session::plans::Planned;
use pulsetrain_session::prepare::Prepared;
use schemars::JsonSchema;
use serde::Serialize;

use crate::recorded_steps::RecordedSteps;

/// The report of a plan.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct PlanReport {
    /// The motion file.
    pub file: String,
    /// The board whose limits hold.
    pub board: String,
    /// Ticks per second of the board.
    pub tick_hz: u64,
    /// The greatest |scheduled − exact| that the file allows, ticks.
    pub tolerance_ticks: f64,
    /// How long the motion is by the file, or by `--for`, s. `None`: it has no end.
    pub asked_s: Option<f64>,
    /// From time zero to the last step, stops included, s.
    pub duration_s: f64,
    /// When the motion was cut, s. The planned stop comes after that.
    pub cut_at_s: Option<f64>,
    /// When the motion would have ended, s. `None` if it was not cut, or is endless.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub uncut_s: Option<f64>,
    /// The pause that the user wants.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pause: Option<Paused>,
    /// How the columns of CSV files were read.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub tables: Vec<TableReport>,
    /// The motors, in the file's order.
    pub motors: Vec<MotorReport>,
    /// Warnings for the user, a line each.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
}

/// How the columns of a CSV file were read.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct TableReport {
    /// The file's name in the motion file.
    pub file: String,
    /// The columns that are used.
    pub columns: Vec<ColumnReport>,
    /// The other columns.
    pub unused: Vec<String>,
    /// How many rows were left out, since they have no position.
    #[serde(skip_serializing_if = "is_zero")]
    pub rows_left_out: usize,
    /// How many rows have the time of the row before. Their mean was taken.
    #[serde(skip_serializing_if = "is_zero")]
    pub rows_averaged: usize,
    /// How it was smoothed. `None` if it was not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub smoothing: Option<SmoothingReport>,
    /// The whole reading in words.
    pub summary: String,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde gives a reference")]
const fn is_zero(number: &usize) -> bool {
    *number == 0
}

/// How a recording was smoothed.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct SmoothingReport {
    /// The smoothing time of the motion file, s.
    pub over_s: f64,
    /// The frequency at which the gain is −3 dB, Hz.
    pub cut_off_hz: f64,
    /// How far the motion is from the recording, for each column of positions.
    pub distances: Vec<DistanceReport>,
}

/// How far a motion is from a column of a recording.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct DistanceReport {
    /// The kind of the column's values: "angle", "position", "x".
    pub is: String,
    /// The largest distance, in `unit`.
    pub largest: f64,
    /// The time of the largest distance, from the first row on, s.
    pub at_s: f64,
    /// The root of the mean square of all rows, in `unit`.
    pub rms: f64,
    /// The column's unit as in motion files.
    pub unit: String,
}

impl SmoothingReport {
    fn new(smoothing: &Smoothing) -> SmoothingReport {
        let distance = |distance: &ColumnDistance| DistanceReport {
            is: distance.what.clone(),
            largest: distance.largest,
            at_s: distance.at_s,
            rms: distance.rms,
            unit: distance.unit.clone(),
        };
        SmoothingReport {
            over_s: smoothing.over.seconds(),
            cut_off_hz: smoothing.cut_off_hz,
            distances: smoothing.distances.iter().map(distance).collect(),
        }
    }
}

/// How one column was read.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct ColumnReport {
    /// The kind of its values: "time", "angle", "position", "x".
    pub is: String,
    /// Its place and name: "column 2 `t`".
    pub column: String,
    /// Its unit as in motion files.
    pub unit: String,
}

impl TableReport {
    /// From the columns that were read.
    #[must_use]
    pub fn new(table: &TableColumns) -> TableReport {
        let column = |column: &ColumnUse| ColumnReport {
            is: column.what.clone(),
            column: column.column.clone(),
            unit: column.unit.clone(),
        };
        TableReport {
            file: table.file.clone(),
            columns: table.columns.iter().map(column).collect(),
            unused: table.unused.clone(),
            rows_left_out: table.rows_left_out,
            rows_averaged: table.rows_averaged,
            smoothing: table.smoothing.as_ref().map(SmoothingReport::new),
            summary: table.to_string(),
        }
    }
}

/// The last columns of a [`summary`].
pub enum Column {
    /// Each motor's worst error: as a distance, and in µs.
    Errors(Vec<(f64, f64)>),
    /// The same as the plan's bound.
    Proven(Vec<(f64, f64)>),
    /// Words of each motor, with their heading.
    Text(&'static str, Vec<String>),
}

/// Columns of a terminal.
const SCREEN: usize = 80;

/// A line for each motor: its range in its own unit, its top speed, that as a share of its highest speed, and `last`.
#[must_use]
pub fn summary(motors: &[MotorReport], last: Column) -> String {
    let mut all = Vec::new();
    let one = |of: fn(&MotorReport) -> String| motors.iter().map(of).collect::<Vec<String>>();
    all.push(("motor", one(|motor| motor.name.clone())));
    all.push(("low", one(|motor| position(motor.lowest))));
    all.push(("high", one(|motor| position(motor.highest))));
    all.push(("start", one(|motor| position(motor.start))));
    all.push(("end", one(|motor| position(motor.end))));
    all.push(("unit", one(|motor| human::unit(&motor.unit).to_owned())));
    all.push(("per s", one(|motor| human::significant(motor.top_speed_per_s, 3))));
    all.push(("rpm", one(|motor| human::significant(motor.top_speed_rpm, 3))));
    all.push((
        "of max",
        one(|motor| {
            motor
                .speed_share
                .map_or_else(|| "–".to_owned(), |share| format!("{} %", human::significant(share * 100.0, 2)))
        }),
    ));
    match last {
        Column::Text(heading, texts) => all.push((heading, texts)),
        Column::Errors(errors) => all.extend(error_columns(motors, errors, ["worst error", "µs"])),
        Column::Proven(errors) => all.extend(error_columns(motors, errors, ["error ≤", "µs ≤"])),
    }
    let text = columns_of(&all);
    // A start that all motors share needs no column.
    let start = &all[3].1;
    if text.lines().any(|line| line.chars().count() > SCREEN)
        && let Some(first) = start.first()
        && start.iter().all(|other| other == first)
    {
        let first = format!("  All start at {first}.\n");
        all.remove(3);
        return columns_of(&all) + &first;
    }
    text
}

fn columns_of(columns: &[(&str, Vec<String>)]) -> String {
    let mut table = Table::default().left(&[0]);
    table.row(columns.iter().map(|(heading, _)| (*heading).to_owned()));
    for row in 0..columns.first().map_or(0, |(_, cells)| cells.len()) {
        table.row(columns.iter().map(|(_, cells)| cells[row].clone()));
    }
    table.to_string()
}

fn error_columns(
    motors: &[MotorReport],
    errors: Vec<(f64, f64)>,
    [heading, us]: [&'static str; 2],
) -> [(&'static str, Vec<String>); 2] {
    let distance = |(motor, (distance, _)): (&MotorReport, &(f64, f64))| {
        let number = human::significant(*distance, 2);
        match motor.error_unit().0 {
            "deg" => format!("{number}°"),
            unit => format!("{number} {}", human::unit(unit)),
        }
    };
    let times = errors.iter().map(|(_, us)| human::significant(*us, 2)).collect();
    [(heading, motors.iter().zip(&errors).map(distance).collect()), (us, times)]
}

/// A position with four digits, or as a whole number.
fn position(value: f64) -> String {
    if value.abs() < 1e-9 {
        return "0".to_owned();
    }
    if value.abs() < 1000.0 { human::significant(value, 4) } else { human::count(value.round() as i128) }
}

/// The plan of one motor.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct MotorReport {
    /// The motor's name in the file.
    pub name: String,
    /// Steps in both directions.
    pub steps: u64,
    /// The position at the start by the law, in `unit`.
    pub start: f64,
    /// The lowest position, in `unit`.
    pub lowest: f64,
    /// The highest position, in `unit`.
    pub highest: f64,
    /// The position at the end, in `unit`.
    pub end: f64,
    /// The law's fastest speed, in `unit`/s.
    pub top_speed_per_s: f64,
    /// The same, in revolutions of the motor's shaft per minute.
    pub top_speed_rpm: f64,
    /// The top speed as a share of the highest speed that board, driver and motor allow: 1 means that it is reached. `None` if there is no step.
    pub speed_share: Option<f64>,
    /// The shortest interval that board and driver can make over the plan's shortest one: 1 means that the board's limit is reached.
    pub limit_share: Option<f64>,
    /// Steps forward minus steps backward.
    #[serde(rename = "final_position_steps")]
    pub final_position: i64,
    /// Segments.
    pub segments: u64,
    /// Payload of the packed segments, bytes.
    #[serde(rename = "payload_bytes")]
    pub bytes: u64,
    /// Payload bytes for each step.
    pub bytes_per_step: f64,
    /// The proven bound: no scheduled tick is farther from the exact time, ticks.
    pub bound_ticks: f64,
    /// The proven bound, s.
    pub bound_s: f64,
    /// What the proof compares with: "closed form", "enclosed", "relative to the interpolant".
    pub class: &'static str,
    /// Highest step rate: one over the shortest interval, steps/s.
    #[serde(rename = "peak_rate_steps_per_s")]
    pub peak_rate: Option<f64>,
    /// Shortest interval between two steps, ticks.
    pub shortest_interval_ticks: Option<u64>,
    /// The law's fastest speed, steps/s.
    #[serde(rename = "peak_speed_steps_per_s")]
    pub peak_speed: Peak,
    /// The law's largest acceleration, steps/s².
    #[serde(rename = "peak_acceleration_steps_per_s2")]
    pub peak_acceleration: Peak,
    /// The motor's limit of it, steps/s²; `None` if the file gives none.
    #[serde(rename = "max_acceleration_steps_per_s2")]
    pub max_acceleration: Option<f64>,
    /// Pairs of opposite steps that were dropped because they were too close to one another.
    pub pairs_dropped: u64,
    /// Largest |position − θ| because of dropped pairs, steps.
    #[serde(rename = "worst_position_error_steps")]
    pub worst_position_error: f64,
    /// Steps that a shared DIR line delays.
    pub steps_put_off: u64,
    /// Longest delay of a step by a shared DIR line, ticks.
    pub longest_put_off_ticks: u64,
    /// How far the motor stays behind motions that begin or end with `ramp-behind`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub behind: Vec<BehindReport>,
    /// The user's unit of position.
    pub unit: String,
    /// Steps in one unit.
    pub steps_per_unit: f64,
    /// The formulas that have parameters. Equal ones are listed once.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub formulas: Vec<FormulaReport>,
}

/// The parameters that a formula was read with.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct FormulaReport {
    /// Its parameters, in the file's order.
    pub parameters: Vec<ParameterReport>,
}

/// A parameter's value.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct ParameterReport {
    /// Its name.
    pub name: String,
    /// The value as the file has it.
    pub written: String,
    /// The value outside of sin, cos and tan. `None` if it is not used there.
    pub outside: Option<Amount>,
    /// The value in sin, cos and tan, rad. `None` if it is not used there.
    pub in_trig: Option<Amount>,
}

/// A number and its unit. The unit of a plain number is empty.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Amount {
    /// The number.
    pub value: f64,
    /// Its unit.
    pub unit: String,
}

impl ParameterReport {
    /// From a parameter of a formula that was read.
    #[must_use]
    pub fn new(used: &ParameterUse) -> ParameterReport {
        let amount = |used: &Option<(f64, String)>| used.clone().map(|(value, unit)| Amount { value, unit });
        ParameterReport {
            name: used.name.clone(),
            written: used.written.clone(),
            outside: amount(&used.outside),
            in_trig: amount(&used.in_trig),
        }
    }
}

/// "phi = 90 deg (1.570796 rad in sin)".
impl Display for ParameterReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ParameterReport { name, written, outside, in_trig } = self;
        let plain = written.replace("^2", "²").replace("^3", "³");
        let is_written = |amount: &Amount| {
            let number = plain.strip_suffix(&amount.unit);
            number.is_some_and(|number| !number.ends_with(|c: char| c.is_alphabetic() || matches!(c, '/' | '-')))
        };
        let said = |amount: &Amount| format!("{} {}", human::significant(amount.value, 7), amount.unit);
        let mut notes: Vec<String> = outside.iter().filter(|amount| !is_written(amount)).map(said).collect();
        if let Some(amount) = in_trig.as_ref().filter(|amount| !is_written(amount) && outside.as_ref() != Some(*amount))
        {
            // Only angles have another value in sin than outside.
            let place = if amount.unit.starts_with("rad") { " in sin" } else { "" };
            notes.push(format!("{}{place}", said(amount)));
        }
        if outside.is_none() && in_trig.is_none() {
            notes.push("not used".to_owned());
        }
        write!(f, "{name} = {written}")?;
        if notes.is_empty() { Ok(()) } else { write!(f, " ({})", notes.join(", ")) }
    }
}

/// A ramp that loses distance and does not make up for it.
#[derive(Clone, Copy, Debug, Serialize, JsonSchema)]
pub struct BehindReport {
    /// The distance that it loses, steps; negative if the law goes backward there.
    pub steps: f64,
    /// The ramp's length, s. From its end on the motor is behind by that distance.
    pub ramp_s: f64,
    /// Whether the ramp ends the motion.
    pub ends: bool,
}

/// The largest value of a quantity, in the unit of its key, and when.
#[derive(Clone, Copy, Debug, Serialize, JsonSchema)]
pub struct Peak {
    /// The value.
    pub value: f64,
    /// When, s.
    pub at_s: f64,
}

impl From<(f64, f64)> for Peak {
    fn from((value, at_s): (f64, f64)) -> Peak {
        Peak { value, at_s }
    }
}

/// A line that names the motors without an acceleration limit, with the largest acceleration of the motion.
fn unlimited(motors: &[MotorReport]) -> Option<String> {
    let unlimited =
        motors.iter().filter(|motor| motor.max_acceleration.is_none() && motor.peak_acceleration.value > 0.0);
    let unlimited: Vec<&MotorReport> = unlimited.collect();
    let asked = |motor: &MotorReport| motor.in_own_unit(motor.peak_acceleration.value, "/s²");
    let (names, have, follow) = match unlimited.as_slice() {
        [] => return None,
        [motor] => (motor.name.clone(), "has", "motor"),
        [first @ .., last] => {
            let first: Vec<&str> = first.iter().map(|motor| motor.name.as_str()).collect();
            (format!("{} and {}", first.join(", "), last.name), "have", "motors")
        }
    };
    let mut each: Vec<String> = unlimited.iter().map(|motor| asked(motor)).collect();
    // Motors that are asked for the same are told it once.
    each.dedup();
    let each = each.join(", ");
    Some(format!("{names} {have} no max_acceleration: this motion asks for up to {each}. Can the {follow} follow?"))
}

/// The name of a proof's class in reports.
#[must_use]
pub fn class_name(class: Class) -> &'static str {
    match class {
        Class::ClosedForm => "closed form",
        Class::Enclosed => "enclosed",
        Class::Interpolant => "relative to the interpolant",
    }
}

/// The highest speed that the board, its driver and the motor allow, steps/s.
#[must_use]
pub fn max_speed(program: &Program, motor: &Motor) -> f64 {
    let rate = Settings::of(program, motor).highest_rate_hz();
    motor.limits.max_speed.map_or(rate, |speed| speed.min(rate))
}

impl MotorReport {
    /// From a motor's plan.
    #[must_use]
    pub fn new(program: &Program, motor: &Motor, planned: &Planned) -> MotorReport {
        let certificate = &planned.certificate;
        let tick_s = 1.0 / program.board.tick_hz as f64;
        let shortest = certificate.shortest_interval_ticks;
        let scale = &motor.scale;
        // Every law has a value at its beginning, else there were no plan.
        let start = Cursor::new(&motor.law).at(Time::ZERO).map_or(0.0, |start| start.position) / scale.steps_per_unit;
        let after = |steps: i64| start + steps as f64 / scale.steps_per_unit;
        let least = Settings::of(program, motor).min_interval_ticks as f64;
        MotorReport {
            name: motor.name.clone(),
            steps: certificate.steps,
            start,
            lowest: after(planned.range.0),
            highest: after(planned.range.1),
            end: after(certificate.position),
            top_speed_per_s: certificate.peak_speed.0 / scale.steps_per_unit,
            top_speed_rpm: 60.0 * certificate.peak_speed.0 / scale.steps_per_rev,
            speed_share: shortest.map(|_| certificate.peak_speed.0 / max_speed(program, motor)),
            limit_share: shortest.map(|ticks| least / ticks as f64),
            final_position: certificate.position,
            segments: certificate.segments,
            bytes: certificate.bytes,
            bytes_per_step: certificate.bytes as f64 / certificate.steps.max(1) as f64,
            bound_ticks: certificate.bound_ticks,
            bound_s: certificate.bound_ticks * tick_s,
            class: class_name(certificate.class),
            peak_rate: shortest.map(|ticks| 1.0 / (ticks as f64 * tick_s)),
            shortest_interval_ticks: shortest,
            peak_speed: certificate.peak_speed.into(),
            peak_acceleration: certificate.peak_acceleration.into(),
            max_acceleration: motor.limits.max_acceleration,
            pairs_dropped: certificate.pairs_dropped,
            worst_position_error: certificate.worst_position_error,
            steps_put_off: certificate.steps_put_off,
            longest_put_off_ticks: certificate.longest_put_off_ticks,
            behind: (motor.law.behind().iter())
                .map(|behind| BehindReport { steps: behind.steps, ramp_s: behind.ramp.seconds(), ends: behind.ends })
                .collect(),
            unit: scale.unit.clone(),
            steps_per_unit: scale.steps_per_unit,
            formulas: formulas(motor),
        }
    }

    /// Replaces what was planned by what was made.
    fn as_made(&mut self, made: &RecordedSteps, tick_hz: u64) {
        let after = |steps: i64| self.start + steps as f64 / self.steps_per_unit;
        (self.lowest, self.highest, self.end) = (after(made.range.0), after(made.range.1), after(made.position));
        (self.steps, self.final_position) = (made.steps, made.position);
        // An average over a step, so no more than the law's fastest speed.
        let rate = made.shortest_interval_ticks.map(|ticks| tick_hz as f64 / ticks as f64);
        let planned = self.shortest_interval_ticks;
        let share = made.shortest_interval_ticks.zip(planned).map(|(made, planned)| planned as f64 / made as f64);
        self.limit_share = self.limit_share.zip(share).map(|(limit, share)| limit * share);
        let [rpm, share] =
            [self.top_speed_rpm, self.speed_share.unwrap_or(0.0)].map(|planned| planned / self.top_speed_per_s);
        self.top_speed_per_s = rate.unwrap_or(0.0) / self.steps_per_unit;
        self.top_speed_rpm = if rpm.is_finite() { self.top_speed_per_s * rpm } else { 0.0 };
        self.speed_share = made.shortest_interval_ticks.map(|_| self.top_speed_per_s * share).filter(|x| x.is_finite());
        (self.shortest_interval_ticks, self.peak_rate) = (made.shortest_interval_ticks, rate);
    }

    /// A peak in steps (per s, per s²), also in the user's unit if that is another, and its time.
    fn in_units(&self, peak: Peak, per: &str) -> String {
        let steps = human::scaled(peak.value, &format!("steps{per}"));
        let at = human::seconds(peak.at_s);
        if self.counts_steps() {
            return format!("{steps} at {at}");
        }
        format!("{steps} = {} at {at}", self.in_own_unit(peak.value, per))
    }

    /// Converts steps (per s, per s²) to the user's unit.
    fn in_own_unit(&self, steps: f64, per: &str) -> String {
        human::scaled(steps / self.steps_per_unit, &format!("{}{per}", human::unit(&self.unit)))
    }

    /// Whether the motor is to move, but by less than one step.
    fn stays(&self) -> bool {
        self.steps == 0 && (self.peak_speed.value > 0.0 || !self.behind.is_empty())
    }

    /// How far the motor stays behind its law, and because of which ramps.
    fn behind(&self, behind: &BehindReport) -> String {
        let (steps, ramp) = (human::significant(behind.steps.abs(), 4), human::seconds(behind.ramp_s));
        let own = human::significant(behind.steps.abs() / self.steps_per_unit, 4);
        let own = if self.counts_steps() { String::new() } else { format!(" = {own} {}", self.unit) };
        let when = if behind.ends { "by" } else { "after" };
        format!("{steps} steps{own}, {when} a ramp of {ramp}")
    }

    /// How far the motor stays behind because of all ramps that end motions, or that begin them.
    fn all_behind(&self, ends: bool) -> Option<String> {
        let said: Vec<String> =
            self.behind.iter().filter(|behind| behind.ends == ends).map(|behind| self.behind(behind)).collect();
        (!said.is_empty()).then(|| said.join("; "))
    }

    fn counts_steps(&self) -> bool {
        human::unit(&self.unit) == "steps"
    }

    /// The unit of small distances, and how many steps it has.
    pub(crate) fn error_unit(&self) -> (&'static str, f64) {
        match self.unit.as_str() {
            "rev" => ("deg", self.steps_per_unit / 360.0),
            "rad" => ("deg", self.steps_per_unit * std::f64::consts::TAU / 360.0),
            "deg" => ("deg", self.steps_per_unit),
            "mm" => ("mm", self.steps_per_unit),
            _ => ("step", 1.0),
        }
    }

    /// The proven bound as a distance at top speed, in the unit of small distances, and in µs.
    fn proven(&self) -> (f64, f64) {
        (self.bound_s * self.peak_speed.value / self.error_unit().1, self.bound_s * 1e6)
    }
}

/// The parameters of a motor's formulas. Motions with the same parameters list them once.
fn formulas(motor: &Motor) -> Vec<FormulaReport> {
    let mut formulas: Vec<FormulaReport> = Vec::new();
    for parameters in motor.law.formula_parameters() {
        let formula = FormulaReport { parameters: parameters.iter().map(ParameterReport::new).collect() };
        if !formula.parameters.is_empty() && !formulas.contains(&formula) {
            formulas.push(formula);
        }
    }
    formulas
}

/// A line for each formula. Motors with the same parameters share a line.
fn write_parameters(f: &mut fmt::Formatter<'_>, motors: &[MotorReport]) -> fmt::Result {
    let mut lines: Vec<(&FormulaReport, Vec<&str>)> = Vec::new();
    for motor in motors {
        for formula in &motor.formulas {
            match lines.iter_mut().find(|(known, _)| *known == formula) {
                Some((_, names)) => names.push(&motor.name),
                None => lines.push((formula, vec![&motor.name])),
            }
        }
    }
    for (formula, names) in &lines {
        let parameters: Vec<String> = formula.parameters.iter().map(ToString::to_string).collect();
        writeln!(f, "  parameters of {}: {}", names.join(", "), parameters.join(", "))?;
    }
    if lines.is_empty() { Ok(()) } else { writeln!(f) }
}

/// A table's line: its name, and its value for a motor, if that has one. The last argument of the function is the
/// length of a tick, s.
pub(crate) type TableLine<M> = (&'static str, fn(&M, f64) -> Option<String>);

/// Prints a column for each motor, and leaves out lines without a value.
pub(crate) fn side_by_side<M>(motors: &[M], name: fn(&M) -> &String, lines: &[TableLine<M>], tick_s: f64) -> Table {
    let mut table = Table::default().left(&[0]);
    table.row([String::new()].into_iter().chain(motors.iter().map(|motor| name(motor).clone())));
    for (what, value) in lines {
        let values: Vec<_> = motors.iter().map(|motor| value(motor, tick_s)).collect();
        if values.iter().any(Option::is_some) {
            let values = values.into_iter().map(|value| value.unwrap_or_else(|| "–".into()));
            table.row([(*what).to_owned()].into_iter().chain(values));
        }
    }
    table
}

pub(crate) fn ticks(ticks: f64, tick_s: f64) -> String {
    format!("{} ticks = {}", human::significant(ticks, 3), human::seconds(ticks * tick_s))
}

fn whole_ticks(ticks: u64, tick_s: f64) -> String {
    format!("{} ticks = {}", human::count(ticks.into()), human::seconds(ticks as f64 * tick_s))
}

const PLANNED: &[TableLine<MotorReport>] = &[
    ("steps", |m, _| Some(human::count(m.steps.into()))),
    ("final position", |m, _| {
        let steps = format!("{} steps", human::count(m.final_position.into()));
        if m.final_position == 0 || m.counts_steps() {
            return Some(steps);
        }
        Some(format!("{steps} = {} {}", human::significant(m.final_position as f64 / m.steps_per_unit, 6), m.unit))
    }),
    ("segments", |m, _| Some(human::count(m.segments.into()))),
    ("payload", |m, _| {
        Some(format!("{} B, {} B/step", human::count(m.bytes.into()), human::significant(m.bytes_per_step, 3)))
    }),
    ("proven error", |m, tick_s| Some(format!("≤ {}", ticks(m.bound_ticks, tick_s)))),
    ("proof", |m, _| Some(m.class.to_owned())),
    ("shortest interval", |m, tick_s| Some(whole_ticks(m.shortest_interval_ticks?, tick_s))),
    ("highest rate", |m, _| Some(human::scaled(m.peak_rate?, "steps/s"))),
    ("fastest", |m, _| Some(m.in_units(m.peak_speed, "/s"))),
    ("acceleration", |m, _| Some(m.in_units(m.peak_acceleration, "/s²"))),
    ("pairs dropped", |m, _| {
        let off = human::significant(m.worst_position_error, 3);
        (m.pairs_dropped > 0).then(|| format!("{}, off by up to {off} steps", human::count(m.pairs_dropped.into())))
    }),
    ("put off (shared DIR)", |m, tick_s| {
        let by = human::seconds(m.longest_put_off_ticks as f64 * tick_s);
        (m.steps_put_off > 0).then(|| format!("{} steps by up to {by}", human::count(m.steps_put_off.into())))
    }),
    ("behind the law", |m, _| m.all_behind(false)),
    ("stops before it", |m, _| m.all_behind(true)),
];

/// Motors side by side in a table.
pub(crate) const ABREAST: usize = 3;

impl PlanReport {
    /// The report of a motion that was planned.
    #[must_use]
    pub fn new(prepared: &Prepared, planned: &[Planned]) -> PlanReport {
        let program = &prepared.program;
        let board = &program.board;
        let last_tick = planned.iter().map(|planned| planned.last_tick).max().unwrap_or(0);
        let motors = program.motors.iter().zip(planned);
        let motors: Vec<MotorReport> =
            motors.map(|(motor, planned)| MotorReport::new(program, motor, planned)).collect();
        let still =
            motors.iter().all(|motor| motor.steps == 0).then(|| "This motion makes no step: nothing moves.".to_owned());
        PlanReport {
            file: prepared.file.clone(),
            board: board.name.clone(),
            tick_hz: board.tick_hz,
            tolerance_ticks: program.tolerance.ticks(board.tick_hz),
            asked_s: match prepared.cut {
                Some(cut) => Some(cut.at.seconds()),
                None => (!prepared.is_endless()).then(|| prepared.end_s()),
            },
            duration_s: last_tick as f64 / board.tick_hz as f64,
            cut_at_s: prepared.cut.map(|cut| cut.at.seconds()),
            uncut_s: prepared.cut.and_then(|cut| cut.end).map(Time::seconds),
            pause: prepared.pause,
            tables: prepared.tables.iter().map(TableReport::new).collect(),
            notes: still.into_iter().chain(unlimited(&motors)).collect(),
            motors,
        }
    }

    /// The report of a run that left its plan: what was made, not what was planned.
    #[must_use]
    pub fn made(prepared: &Prepared, planned: &[Planned], made: &[RecordedSteps]) -> PlanReport {
        let mut report = PlanReport::new(prepared, planned);
        report.as_made(made);
        report
    }

    /// Replaces what was planned by what was made, after a run that left its plan: steps, positions, speeds and the duration. What was
    /// proven stays.
    fn as_made(&mut self, made: &[RecordedSteps]) {
        let last_tick = made.iter().filter_map(RecordedSteps::last_tick).max().unwrap_or(0);
        self.duration_s = last_tick as f64 / self.tick_hz as f64;
        for (motor, made) in self.motors.iter_mut().zip(made) {
            motor.as_made(made, self.tick_hz);
        }
    }

    /// "1 s asked for, 1.002 s made", or "a motion without an end, 1.002 s made". `made` is the verb of the second one.
    #[must_use]
    pub fn durations(&self, made: &str) -> String {
        let planned = human::seconds_to(self.duration_s, 6);
        match self.asked_s {
            Some(asked_s) => format!("{} asked for, {planned} {made}", human::seconds_to(asked_s, 6)),
            None => format!("a motion without an end, {planned} {made}"),
        }
    }

    /// Where the motion was cut, its pause, and how tables were read.
    ///
    /// # Errors
    /// Those of the formatter.
    pub fn remarks(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(cut) = self.cut_at_s {
            let cut = human::seconds_to(cut, 6);
            match self.uncut_s.map(|end| human::seconds_to(end, 6)) {
                None => writeln!(f, "  endless: {cut} of it, then the planned stop; --for sets how much")?,
                Some(end) => writeln!(f, "  cut after {cut}, then the planned stop; without --for it takes {end}")?,
            }
        }
        if let Some(Paused { slows_at_s, rests_at_s, goes_on_s }) = self.pause {
            let time = |at_s| human::seconds_to(at_s, 6);
            write!(f, "  pause: slows down from {} on, rests from {} on", time(slows_at_s), time(rests_at_s))?;
            match goes_on_s {
                Some((from_s, to_s)) => writeln!(f, "; goes on at {}, at speed from {} on", time(from_s), time(to_s))?,
                None => writeln!(f, ", and stays there")?,
            }
        }
        self.tables.iter().try_for_each(|table| writeln!(f, "  table {}", table.summary))
    }

    /// Warnings, a line each.
    ///
    /// # Errors
    /// Those of the formatter.
    pub fn write_notes(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.motors.iter().filter(|motor| motor.stays()).try_for_each(|motor| {
            writeln!(
                f,
                "  {} makes no step: its motion stays within the first one; are `gear`, `lead` and the law's unit right?",
                motor.name
            )
        })?;
        self.notes.iter().try_for_each(|note| writeln!(f, "  {note}"))
    }

    /// The tables of each motor's plan, and the parameters of formulas.
    #[must_use]
    pub fn details(&self) -> String {
        Details(self).to_string()
    }
}

struct Details<'a>(&'a PlanReport);

impl Display for Details<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Details(PlanReport { motors, tick_hz, .. }) = self;
        let tick_s = 1.0 / *tick_hz as f64;
        writeln!(f, "The plan (tick {}):\n", human::seconds(tick_s))?;
        for motors in motors.chunks(ABREAST) {
            writeln!(f, "{}", side_by_side(motors, |motor| &motor.name, PLANNED, tick_s))?;
        }
        write_parameters(f, motors)
    }
}

/// What the motors will do, a line each. Nothing ran, so there is no verdict.
impl Display for PlanReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{} fits {}: {}", self.file, self.board, self.durations("planned"))?;
        self.remarks(f)?;
        let proven = self.motors.iter().map(MotorReport::proven).collect();
        writeln!(f, "\n{}", summary(&self.motors, Column::Proven(proven)))?;
        self.write_notes(f)
    }
}
