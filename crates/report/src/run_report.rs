//! The report of a run and of a verdict: JSON for programs, tables for people.

use std::fmt::{self, Display};

use pulsetrain_motion::human::{self, Table};
use pulsetrain_plot::machine::FigureReport;
use pulsetrain_session::control::Ended;
use pulsetrain_session::drive::DriveError;
use pulsetrain_session::lateness::Lateness;
use pulsetrain_trace::verdict;
use schemars::JsonSchema;
use serde::Serialize;

use crate::plan_report::{ABREAST, Column, MotorReport, PlanReport, TableLine, side_by_side, summary, ticks};
use crate::positions::{MotorPosition, listed};

/// The first word of an output that has a verdict.
#[must_use]
pub const fn pass_or_fail(pass: bool) -> &'static str {
    if pass { "PASS" } else { "FAIL" }
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

impl StoppedReport {
    /// The report of a run that failed with `error`. `None` if the motors had not begun to move. It has no advice.
    #[must_use]
    pub fn of(error: &DriveError, plan: PlanReport, runner: String) -> Option<Box<StoppedReport>> {
        Some(Box::new(StoppedReport { plan, runner, stopped: RunEnd::of(error)? }))
    }
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
    /// The report of a run that a command stopped at `at_s`. It has no advice.
    #[must_use]
    pub fn by_command(ended: &Ended, at_s: f64, positions: &[MotorPosition]) -> RunEnd {
        let how = if ended.uncertain.is_some() { "at once" } else { "within the motors' limits" };
        let motors = positions.iter().map(|motor| StoppedMotor { name: motor.name.clone(), steps: motor.steps });
        RunEnd {
            message: format!("Stopped at {} {how}: {}", human::seconds_to(at_s, 4), listed(positions)),
            help: String::new(),
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

fn write_figures(f: &mut fmt::Formatter<'_>, figures: &[FigureReport]) -> fmt::Result {
    figures.iter().try_for_each(|figure| writeln!(f, "{figure}"))
}

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
