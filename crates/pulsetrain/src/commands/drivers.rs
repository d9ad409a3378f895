//! `pulsetrain drivers`: the table of driver timings.

use pulsetrain_motion::drivers::{self, Driver, Input};
use schemars::JsonSchema;
use serde::Serialize;

use crate::arguments;
use crate::console::{Console, Exit};
use pulsetrain_motion::human::{self, Table};

#[derive(Serialize, JsonSchema)]
pub(crate) struct DriverTableRow {
    /// Its name in motion files.
    name: &'static str,
    /// What it is.
    about: &'static str,
    /// "step/dir" or "coils".
    input: &'static str,
    /// Shortest STEP HIGH, ns.
    pulse_high_ns: u32,
    /// Shortest STEP LOW, ns.
    pulse_low_ns: u32,
    /// Shortest time from DIR to STEP, ns.
    dir_setup_ns: u32,
    /// Shortest time from STEP to DIR, ns.
    dir_hold_ns: u32,
    /// Its microsteps, and how they are set.
    microsteps: Vec<Setting>,
    /// Largest supply voltage, V.
    max_voltage_v: f64,
    /// Largest current of a winding, A.
    max_current_a: f64,
    /// The data sheet.
    source: &'static str,
}

#[derive(Serialize, JsonSchema)]
pub(crate) struct Setting {
    /// Steps for each full step.
    microsteps: u32,
    /// How that is set.
    setting: &'static str,
}

impl From<&Driver> for DriverTableRow {
    fn from(driver: &Driver) -> DriverTableRow {
        let timing = driver.timing();
        DriverTableRow {
            name: driver.name,
            about: driver.about,
            input: match driver.input {
                Input::StepDir(_) => "step/dir",
                Input::Coils => "coils",
            },
            pulse_high_ns: timing.pulse_high_ns,
            pulse_low_ns: timing.pulse_low_ns,
            dir_setup_ns: timing.dir_setup_ns,
            dir_hold_ns: timing.dir_hold_ns,
            microsteps: driver
                .microsteps
                .iter()
                .map(|row| Setting { microsteps: row.count, setting: row.setting })
                .collect(),
            max_voltage_v: driver.max_voltage_v,
            max_current_a: driver.max_current_a,
            source: driver.source,
        }
    }
}

pub(crate) fn run(args: &arguments::Table, console: &mut Console<'_>) -> miette::Result<Exit> {
    let rows: Vec<DriverTableRow> = drivers::table().iter().map(DriverTableRow::from).collect();
    if args.json {
        console.print_json(&rows)?;
        return Ok(Exit::Success);
    }
    let mut table = Table::new(["driver", "pulse high", "low", "DIR setup", "hold", "supply", "current", "what it is"])
        .left(&[0, 7]);
    for row in &rows {
        let time = |ns: u32| if ns == 0 { "–".into() } else { human::seconds(f64::from(ns) * 1e-9) };
        table.row([
            row.name.to_owned(),
            time(row.pulse_high_ns),
            time(row.pulse_low_ns),
            time(row.dir_setup_ns),
            time(row.dir_hold_ns),
            format!("{} V", human::significant(row.max_voltage_v, 3)),
            format!("{} A", human::significant(row.max_current_a, 3)),
            row.about.to_owned(),
        ]);
    }
    console.print(&table)?;
    for row in &rows {
        let mut settings = Table::new(["microsteps", "set by"]).left(&[1]);
        for setting in &row.microsteps {
            settings.row([setting.microsteps.to_string(), setting.setting.to_owned()]);
        }
        console.print(format_args!("\n{}, {}\n{settings}  source: {}\n", row.name, row.input, row.source))?;
    }
    Ok(Exit::Success)
}
