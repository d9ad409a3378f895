//! `pulsetrain motor`: how fast a winding lets a motor step.

use crate::arguments;
use crate::files::inputs;
use clap::Args;
use miette::miette;
use pulsetrain_motion::electrical::{Figure, Winding, WindingError};
use pulsetrain_motion::file;
use schemars::JsonSchema;
use serde::Serialize;
use std::path::PathBuf;

use crate::console::{Console, Exit};
use crate::diagnostic::WrongFile;
use pulsetrain_motion::human::{self, Table};

#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  pulsetrain motor --inductance 50mH --current 0.135A --voltage 12V --steps-per-rev 200 --microsteps 8
  pulsetrain motor --file examples/max-speed.toml")]
pub(crate) struct MotorArgs {
    /// Take the motors of a motion file that have electrical data
    #[arg(long, value_name = "FILE", conflicts_with_all = ["inductance", "current", "voltage"])]
    pub(crate) file: Option<PathBuf>,
    /// Inductance of one winding, e.g. 50mH
    #[arg(long, value_name = "L", value_parser = arguments::inductance, required_unless_present = "file", allow_hyphen_values = true)]
    pub(crate) inductance: Option<f64>,
    /// Current of one winding as the driver is set, e.g. 0.135A
    #[arg(long, value_name = "I", value_parser = arguments::current, required_unless_present = "file", allow_hyphen_values = true)]
    pub(crate) current: Option<f64>,
    /// Supply of the driver, e.g. 12V
    #[arg(long, value_name = "V", value_parser = arguments::voltage, required_unless_present = "file", allow_hyphen_values = true)]
    pub(crate) voltage: Option<f64>,
    /// Full steps in one revolution
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = arguments::steps_per_rev)]
    pub(crate) steps_per_rev: u32,
    /// Steps that the driver makes of a full step
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=256))]
    pub(crate) microsteps: u32,
    /// Print the figures as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Serialize, JsonSchema)]
pub(crate) struct WindingReport {
    /// The motor's name.
    motor: String,
    /// What the winding allows.
    winding: Vec<MotorRow>,
    /// The same from an 8-bit timer, as the sketch has it.
    sketch: Vec<MotorRow>,
    /// Why the sketch has no figures.
    #[serde(skip_serializing_if = "Option::is_none")]
    sketch_cannot: Option<String>,
}

#[derive(Serialize, JsonSchema)]
pub(crate) struct MotorRow {
    /// What it is.
    name: &'static str,
    /// The figure, in `unit`.
    value: f64,
    /// Its unit; empty for a plain number.
    unit: &'static str,
    /// How it comes about.
    formula: String,
    /// Where the formula comes from.
    source: &'static str,
}

impl From<Figure> for MotorRow {
    fn from(figure: Figure) -> MotorRow {
        let Figure { name, formula, value, unit, source } = figure;
        MotorRow { name, value, unit, formula, source }
    }
}

pub(crate) fn run(args: &MotorArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    let motors = windings(args)?;
    let rows = |figures: Vec<Figure>| figures.into_iter().map(MotorRow::from).collect();
    let reports: Vec<WindingReport> = motors
        .into_iter()
        .map(|(motor, winding)| {
            let (sketch, sketch_cannot) = match winding.sketch_figures() {
                Ok(figures) => (figures, None),
                Err(error) => (Vec::new(), Some(error.to_string())),
            };
            WindingReport { motor, winding: rows(winding.figures()), sketch: rows(sketch), sketch_cannot }
        })
        .collect();
    if args.json {
        console.print_json(&reports)?;
        return Ok(Exit::Success);
    }
    for report in &reports {
        console.print(format_args!("{}: what the winding allows\n{}\n", report.motor, section(&report.winding)))?;
        console.print("The same from an 8-bit timer, as the sketch of the maximum-speed article has it\n")?;
        match &report.sketch_cannot {
            None => console.print(section(&report.sketch))?,
            Some(why) => console.print(format_args!("  {why}\n"))?,
        }
    }
    Ok(Exit::Success)
}

/// The rows, then each source once, with a number that the rows name.
fn section(rows: &[MotorRow]) -> String {
    let mut sources: Vec<&str> = Vec::new();
    let mut table = Table::new(["figure", "value", "formula", "source"]).left(&[0, 2, 3]);
    for row in rows {
        let number = sources.iter().position(|source| *source == row.source).unwrap_or_else(|| {
            sources.push(row.source);
            sources.len() - 1
        });
        table.row([
            row.name.to_owned(),
            format!("{} {}", human::significant(row.value, 6), row.unit).trim_end().to_owned(),
            row.formula.clone(),
            format!("[{}]", number + 1),
        ]);
    }
    let sources = sources.iter().enumerate().map(|(n, source)| format!("  [{}] {source}\n", n + 1));
    format!("{table}{}", sources.collect::<String>())
}

fn windings(args: &MotorArgs) -> miette::Result<Vec<(String, Winding)>> {
    let (Some(inductance_h), Some(current_a), Some(voltage_v)) = (args.inductance, args.current, args.voltage) else {
        return from_file(args);
    };
    let winding = Winding {
        inductance_h,
        current_a,
        voltage_v,
        full_steps_per_rev: f64::from(args.steps_per_rev),
        microsteps: args.microsteps,
    };
    let winding = winding.checked().map_err(|error| miette!(help = WindingError::ADVICE, "{error}"))?;
    Ok(vec![("motor".into(), winding)])
}

fn from_file(args: &MotorArgs) -> miette::Result<Vec<(String, Winding)>> {
    let Some(path) = &args.file else { return Ok(Vec::new()) };
    let program = file::load_contents_by(path, &inputs::text).map_err(WrongFile::from)?.program;
    let windings: Vec<_> = program.motors.into_iter().filter_map(|motor| Some((motor.name, motor.winding?))).collect();
    if windings.is_empty() {
        let help = "give a motor its electrical data: inductance, current, voltage";
        return Err(miette!(help = help, "{}: no motor has electrical data", path.display()));
    }
    Ok(windings)
}
