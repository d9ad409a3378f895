//! Reports of plans and runs: JSON for programs, tables for people.

use std::fmt::{self, Display};

use pulsetrain_motion::Time;
use pulsetrain_motion::file::{ColumnDistance, ColumnUse, Smoothing, TableColumns};
use pulsetrain_motion::law::{Class, Cursor, ParameterUse};
use pulsetrain_motion::program::{Motor, Program};
use pulsetrain_plan::Settings;
use pulsetrain_trace::verdict;
use schemars::JsonSchema;
use serde::Serialize;

use crate::control_socket::{RunEnded, max_speed};
use crate::made::Made;
use crate::standing::listed;
use pulsetrain_motion::human::{self, Table};
use pulsetrain_plot::machine::FigureReport;
use pulsetrain_session::control::Ended;
use pulsetrain_session::drive::DriveError;
use pulsetrain_session::lateness::Lateness;
use pulsetrain_session::pause::Paused;
use pulsetrain_session::plans::Planned;

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

/// The report of a run.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct RunReport {
    /// What was planned and proven.
    #[serde(flatten)]
    pub plan: PlanReport,
    /// What made the edges: "native", or "virtual Uno" with its firmware's version.
    pub runner: String,
    /// Whether no bound broke and no step was lost or added.
    pub pass: bool,
    /// The largest error of each motor, in the file's order.
    pub errors: Vec<MotorError>,
    /// The judge's verdict on the edges.
    pub verdict: verdict::Report,
    /// Lateness of the edges against their scheduled ticks.
    pub lateness: Lateness,
    /// The errors of machines' figures.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub figures: Vec<FigureReport>,
    /// Why the run failed. `None` if no bound broke and no step was lost or added.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub failure: Option<String>,
    /// Up to when the edges were judged, s, if that is not the motion's end: somebody stopped or changed it then.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub judged_until_s: Option<f64>,
    /// Where the motors are, if somebody stopped the motion on its way.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stopped: Option<RunEnd>,
    /// The file that could not be written, and why.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unwritten: Option<String>,
}

impl RunReport {
    /// The report of a run.
    #[must_use]
    pub fn new(
        plan: PlanReport,
        runner: String,
        verdict: verdict::Report,
        lateness: Lateness,
        figures: Vec<FigureReport>,
    ) -> RunReport {
        let Lateness { lost, extra, .. } = lateness;
        let failure = match (verdict.ok, lost, extra) {
            (false, ..) => Some(broke(&verdict)),
            (true, 0, 0) => None,
            (true, ..) => Some(format!("steps lost {lost}, added {extra}, against what was scheduled")),
        };
        let seen = plan.motors.iter().zip(&verdict.motors);
        let errors = seen.map(|(motor, seen)| MotorError::new(motor, seen)).collect();
        RunReport {
            plan,
            runner,
            pass: failure.is_none(),
            errors,
            verdict,
            lateness,
            figures,
            failure,
            judged_until_s: None,
            stopped: None,
            unwritten: None,
        }
    }

    /// The verdict in one line. It is PASS exactly if the exit code is 0.
    #[must_use]
    pub fn conclusion(&self) -> String {
        let up_to = self.judged_until_s.map(|at_s| format!(" up to {}", human::seconds_to(at_s, 4)));
        match (&self.failure, &self.stopped) {
            (Some(_), _) => conclusion(self.failure.as_deref()),
            (None, stopped) => {
                let stopped = if stopped.is_some() { "stopped on your order; " } else { "" };
                format!("PASS: {stopped}no bound broke{}", up_to.unwrap_or_default())
            }
        }
    }

    /// The tables of all that is known of each motor: of its plan, then of its edges.
    #[must_use]
    pub fn details(&self) -> String {
        let RunReport { plan, runner, verdict, .. } = self;
        let by =
            if runner == "native" { "the native board".to_owned() } else { format!("the {runner} (emulated chip)") };
        format!("{}The edges of {by}, in virtual time:\n\n{}", plan.details(), side_by_side_verdict(verdict))
    }
}

/// The largest error of a motor's steps.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct MotorError {
    /// The motor's name in the file.
    pub motor: String,
    /// The largest |edge − exact time|, without the board's constant delay, µs.
    pub worst_us: f64,
    /// The largest of these errors as a distance, which is the error times the speed, in `unit`.
    pub worst: f64,
    /// "deg", "mm", or "step" for a motor whose file counts steps.
    pub unit: &'static str,
}

impl MotorError {
    fn new(motor: &MotorReport, seen: &verdict::MotorReport) -> MotorError {
        let (unit, steps) = motor.error_unit();
        MotorError {
            motor: motor.name.clone(),
            worst_us: seen.max_error_us.abs(),
            worst: seen.max_error_steps.abs() / steps,
            unit,
        }
    }
}

/// The report of a run that ended before the motion did.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct StoppedReport {
    /// What was planned and proven.
    #[serde(flatten)]
    pub plan: PlanReport,
    /// What made the edges.
    pub runner: String,
    /// Why and where it ended.
    pub stopped: RunEnd,
}

/// Why motors were stopped before the motion's end.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct RunEnd {
    /// The reason in words, with the motors' positions.
    pub message: String,
    /// Advice.
    pub help: String,
    /// The motor whose plan came too late, if that is the reason.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub motor: Option<String>,
    /// When the motors began to brake, or when it was seen that they had stopped, s of the laws' time.
    pub at_s: f64,
    /// How much later the next part of the plan came, s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub late_s: Option<f64>,
    /// The motors' positions.
    pub motors: Vec<StoppedMotor>,
}

/// The position of a motor after a stop.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct StoppedMotor {
    /// The motor's name in the file.
    pub name: String,
    /// Steps forward minus steps backward since the board was set up.
    pub steps: i64,
}

impl RunEnd {
    /// The report of a run that was stopped at `at_s`, as somebody asked for.
    #[must_use]
    pub fn wanted(ended: &Ended, at_s: f64, end: &RunEnded) -> RunEnd {
        let how = if ended.uncertain.is_some() { "at once" } else { "within the motors' limits" };
        let motors = end.motors.iter().map(|motor| StoppedMotor { name: motor.name.clone(), steps: motor.steps });
        RunEnd {
            message: format!("Stopped at {} {how}: {}", human::seconds_to(at_s, 4), listed(&end.motors)),
            help: end.way_back.clone().unwrap_or_default(),
            motor: None,
            at_s,
            late_s: None,
            motors: motors.collect(),
        }
    }

    /// The report of a run that failed with `error`. `None` if the motors had not begun to move.
    #[must_use]
    pub fn of(error: &DriveError) -> Option<RunEnd> {
        let DriveError::Halted { why, seen_s, positions, .. } = error else { return None };
        let (motor, late_s) = match &**why {
            DriveError::TooLate { motor, late_s, .. } => (Some(motor.clone()), Some(*late_s)),
            DriveError::QueueTooShort { motor, .. } => (Some(motor.clone()), None),
            _ => (None, None),
        };
        let place = |(name, steps): &(String, i64)| StoppedMotor { name: name.clone(), steps: *steps };
        Some(RunEnd {
            message: error.to_string(),
            help: String::new(),
            motor,
            at_s: error.at_s().unwrap_or(*seen_s),
            late_s,
            motors: positions.motors.iter().map(place).collect(),
        })
    }
}

/// The failure text of a verdict that is not ok.
fn broke(verdict: &verdict::Report) -> String {
    let motors: Vec<&str> =
        verdict.motors.iter().filter(|motor| motor.faults > 0).map(|motor| motor.motor.as_str()).collect();
    match motors.as_slice() {
        [] => "a bound broke".to_owned(),
        motors => format!("a bound broke: {}", motors.join(", ")),
    }
}

fn conclusion(failure: Option<&str>) -> String {
    match failure {
        None => "PASS: no bound broke".to_owned(),
        Some(why) => format!("FAIL: {why}"),
    }
}

/// The verdict first, then what the motors did, a line each. The last line of the output is [`RunReport::conclusion`].
impl Display for RunReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let RunReport { plan, runner, verdict, lateness, figures, pass, .. } = self;
        let on = if runner == "native" { "native board" } else { runner };
        writeln!(f, "{}  {} on the {on}: {}", pass_or_fail(*pass), plan.file, plan.durations("made"))?;
        plan.remarks(f)?;
        let errors = self.errors.iter().map(|error| (error.worst, error.worst_us)).collect();
        writeln!(f, "\n{}", summary(&plan.motors, Column::Errors(errors)))?;
        write_figures(f, figures)?;
        if runner != "native" {
            let Lateness { p50_ticks, p99_ticks, max_ticks, lost, extra, .. } = *lateness;
            let worst = human::seconds(max_ticks as f64 / verdict.tick_hz as f64);
            writeln!(
                f,
                "  Lateness: median {p50_ticks}, 99 % within {p99_ticks}, worst {max_ticks} ticks ({worst}). Steps lost {lost}, added {extra}."
            )?;
        }
        plan.write_notes(f)?;
        if let Some(RunEnd { message, help, .. }) = &self.stopped {
            writeln!(f, "  {message}")?;
            if !help.is_empty() {
                writeln!(f, "  back to the start: {help}")?;
            }
        }
        write_failures(f, verdict)
    }
}

/// The first word of an output that has a verdict.
pub(crate) const fn pass_or_fail(pass: bool) -> &'static str {
    if pass { "PASS" } else { "FAIL" }
}

/// The last columns of a [`summary`].
pub(crate) enum Column {
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
pub(crate) fn summary(motors: &[MotorReport], last: Column) -> String {
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

fn write_figures(f: &mut fmt::Formatter<'_>, figures: &[FigureReport]) -> fmt::Result {
    figures.iter().try_for_each(|figure| writeln!(f, "{figure}"))
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
    pub(crate) fn new(used: &ParameterUse) -> ParameterReport {
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
pub(crate) fn unlimited(motors: &[MotorReport]) -> Option<String> {
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
    fn as_made(&mut self, made: &Made, tick_hz: u64) {
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
    fn error_unit(&self) -> (&'static str, f64) {
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
type TableLine<M> = (&'static str, fn(&M, f64) -> Option<String>);

/// Prints a column for each motor, and leaves out lines without a value.
fn side_by_side<M>(motors: &[M], name: fn(&M) -> &String, lines: &[TableLine<M>], tick_s: f64) -> Table {
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

fn ticks(ticks: f64, tick_s: f64) -> String {
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
const ABREAST: usize = 3;

/// A verdict on a capture: the verdict, a line for each motor, the failures.
pub struct VerdictText<'a> {
    /// The judge's report.
    pub report: &'a verdict::Report,
    /// Tables of all that was measured, too.
    pub verbose: bool,
}

const SEEN: &[TableLine<verdict::MotorReport>] = &[
    ("steps made", |m, _| {
        Some(format!("{} of {}", human::count(m.steps_got.into()), human::count(m.steps_wanted.into())))
    }),
    ("ends at", |m, _| Some(format!("{} steps", human::count(m.position_got.into())))),
    ("worst error", |m, tick_s| {
        let late = if m.max_error_ticks < 0.0 { "early" } else { "late" };
        Some(format!("{} {late}", ticks(m.max_error_ticks.abs(), tick_s)))
    }),
    ("bound", |m, tick_s| Some(ticks(m.bound_ticks, tick_s))),
    ("rms error", |m, _| Some(format!("{} ticks", human::significant(m.rms_error_ticks, 3)))),
    ("drift", |m, _| Some(format!("{} ppm", human::significant(m.drift_ppm, 2)))),
    ("shortest interval", |m, tick_s| {
        let ticks = m.shortest_interval_ticks?;
        Some(format!("{} ticks = {}", human::significant(ticks, 6), human::seconds(ticks * tick_s)))
    }),
    ("shortest STEP high", |m, _| m.pulse_high.map(measured)),
    ("shortest STEP low", |m, _| m.pulse_low.map(measured)),
    ("shortest DIR set-up", |m, _| m.dir_setup.map(measured)),
    ("shortest DIR hold", |m, _| m.dir_hold.map(measured)),
    ("pairs dropped", |m, _| (m.pairs_dropped > 0).then(|| human::count(m.pairs_dropped.into()))),
    ("put off (shared DIR)", |m, tick_s| {
        let by = human::seconds(m.longest_put_off_ticks * tick_s);
        (m.steps_put_off > 0).then(|| format!("{} steps by up to {by}", human::count(m.steps_put_off.into())))
    }),
    ("faults", |m, _| Some(human::count(m.faults.into()))),
];

fn measured(time: verdict::Measured) -> String {
    let (seen, needed) = (human::seconds(time.seen_ns * 1e-9), human::seconds(f64::from(time.needed_ns) * 1e-9));
    format!("{seen}, the driver needs {needed}")
}

/// How many failures are printed. The report has all that the verdict kept.
const FAILURES_SHOWN: usize = 10;

impl Display for VerdictText<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let VerdictText { report, verbose } = self;
        let tick_s = 1.0 / report.tick_hz as f64;
        let mut table = Table::new(["motor", "steps made", "of", "ends at, steps", "worst error", "limit", "faults"]);
        for motor in &report.motors {
            let way = if motor.max_error_ticks < 0.0 { "early" } else { "late" };
            table.row([
                motor.motor.clone(),
                human::count(motor.steps_got.into()),
                human::count(motor.steps_wanted.into()),
                human::count(motor.position_got.into()),
                format!("{} {way}", human::seconds(motor.max_error_ticks.abs() * tick_s)),
                human::seconds(motor.bound_ticks * tick_s),
                human::count(motor.faults.into()),
            ]);
        }
        let broke = (!report.ok).then(|| broke(report));
        writeln!(f, "{}\n\n{table}", pass_or_fail(report.ok))?;
        if *verbose {
            f.write_str(&side_by_side_verdict(report))?;
        }
        let alignment = &report.alignment;
        if alignment.shift_s != 0.0 || alignment.rate_ppm != 0.0 {
            let shift = human::seconds_to(alignment.shift_s, 9);
            let rate = human::significant(alignment.rate_ppm.abs(), 4);
            let way = if alignment.rate_ppm < 0.0 { "slow" } else { "fast" };
            writeln!(f, "  time zero at {shift} of the capture; the board's clock is {rate} ppm {way}\n")?;
        }
        write_failures(f, report)?;
        writeln!(f, "{}", conclusion(broke.as_deref()))
    }
}

/// Writes the first failures of a verdict, and how many there are.
fn write_failures(f: &mut fmt::Formatter<'_>, report: &verdict::Report) -> fmt::Result {
    for failure in report.failures.iter().take(FAILURES_SHOWN) {
        writeln!(f, "  {failure}")?;
    }
    let faults: u64 = report.motors.iter().map(|motor| motor.faults).sum();
    if let Some(more) = faults.checked_sub(FAILURES_SHOWN as u64).filter(|more| *more > 0) {
        writeln!(f, "  and {} more", human::count(more.into()))?;
    }
    Ok(())
}

/// All that was measured, with a column for each motor.
fn side_by_side_verdict(report: &verdict::Report) -> String {
    let tick_s = 1.0 / report.tick_hz as f64;
    let tables = report.motors.chunks(ABREAST);
    tables.map(|motors| format!("{}\n", side_by_side(motors, |motor| &motor.motor, SEEN, tick_s))).collect()
}

impl PlanReport {
    /// Replaces what was planned by what was made, after a run that left its plan: steps, positions, speeds and the duration. What was
    /// proven stays.
    pub fn as_made(&mut self, made: &[Made]) {
        let last_tick = made.iter().filter_map(Made::last_tick).max().unwrap_or(0);
        self.duration_s = last_tick as f64 / self.tick_hz as f64;
        for (motor, made) in self.motors.iter_mut().zip(made) {
            motor.as_made(made, self.tick_hz);
        }
    }

    /// "1 s asked for, 1.002 s made", or "a motion without an end, 1.002 s made". `made` is the verb of the second one.
    pub(crate) fn durations(&self, made: &str) -> String {
        let planned = human::seconds_to(self.duration_s, 6);
        match self.asked_s {
            Some(asked_s) => format!("{} asked for, {planned} {made}", human::seconds_to(asked_s, 6)),
            None => format!("a motion without an end, {planned} {made}"),
        }
    }

    /// Where the motion was cut, its pause, and how tables were read.
    pub(crate) fn remarks(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
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
    pub(crate) fn write_notes(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
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

#[cfg(test)]
mod tests {
    use super::*;
    use pulsetrain_trace::verdict::Alignment;

    /// PASS and exit code 0 go together. A verdict that is ok may have additions, which are printed.
    #[test]
    fn a_run_that_lost_or_added_steps_says_so_and_does_not_pass() {
        let plan = PlanReport {
            file: "motion.toml".to_owned(),
            board: "pico".to_owned(),
            tick_hz: 125_000_000,
            tolerance_ticks: 1.0,
            asked_s: Some(1.0),
            duration_s: 1.0,
            cut_at_s: None,
            uncut_s: None,
            pause: None,
            tables: Vec::new(),
            notes: Vec::new(),
            motors: Vec::new(),
        };
        for (ok, [lost, extra], last) in [
            (true, [0, 0], "PASS: no bound broke"),
            (true, [0, 1175], "FAIL: steps lost 0, added 1175, against what was scheduled"),
            (true, [3, 0], "FAIL: steps lost 3, added 0, against what was scheduled"),
            (false, [0, 0], "FAIL: a bound broke"),
        ] {
            let alignment = Alignment { shift_s: 0.0, rate_ppm: 0.0 };
            let verdict =
                verdict::Report { ok, tick_hz: 125_000_000, alignment, motors: Vec::new(), failures: Vec::new() };
            let lateness = Lateness {
                constant_ticks: 0,
                edges: 0,
                min_ticks: 0,
                p50_ticks: 0,
                p99_ticks: 0,
                max_ticks: 0,
                lost,
                extra,
            };
            for runner in ["native", "virtual Pico"] {
                let report =
                    RunReport::new(plan.clone(), runner.to_owned(), verdict.clone(), lateness.clone(), Vec::new());
                let text = report.to_string();
                assert_eq!(report.conclusion(), last);
                assert_eq!(text.lines().next().map(|line| &line[..4]), Some(&last[..4]), "{text}");
                assert_eq!(report.pass, last.starts_with("PASS"));
            }
        }
    }
}
