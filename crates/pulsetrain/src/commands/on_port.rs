//! `pulsetrain run FILE --port …`: runs a motion on a real board. The board's own report is all that is known of the
//! run.

use pulsetrain_board::BoardKind;

use miette::miette;
use pulsetrain_board::remote::in_words;
use pulsetrain_board::{Board, Observer, ScheduledStep, Serial};
use pulsetrain_core::Direction;
use pulsetrain_core::wire::Baud;
use pulsetrain_trace::steps;
use serde::Serialize;

use super::plan;
use super::problems::{clock_off, drive_problem, port_problem, run_problem};
use super::rehearsal::Rehearsal;
use super::run::{HowToRun, stopped_before_begin, told_end};
use crate::console::{self, Console, Exit, access};
use crate::control_socket::{Control, RunEnded};
use crate::report::PlanReport;
use crate::standing::{Standing, listed};
use crate::{interrupt, last_positions};
use pulsetrain_motion::human::{self, Table};
use pulsetrain_session::control::Ended;
use pulsetrain_session::drive::{Driven, connect_while};
use pulsetrain_session::plans::Planned;
use pulsetrain_session::prepare::Prepared;

/// The report of a run on a real board. Nobody but the board saw its pins.
#[derive(Debug, Serialize)]
struct PortReport {
    #[serde(flatten)]
    plan: PlanReport,
    /// "board at PORT".
    runner: String,
    firmware: String,
    /// Only of an Uno, and only if the user wants a rehearsal.
    #[serde(skip_serializing_if = "Option::is_none")]
    rehearsed: Option<Rehearsal>,
    /// The board's report.
    says: BoardReport,
    /// Where the motors are, if the motion was stopped on its way.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    stand: Vec<Standing>,
    /// The command that brings them back to the motion's start.
    #[serde(skip_serializing_if = "Option::is_none")]
    way_back: Option<String>,
}

/// The board's own report of a run.
#[derive(Debug, Serialize)]
struct BoardReport {
    /// Steps of each motor, forward minus backward.
    counted: Vec<i64>,
    /// Whether the user stopped the motion before its end.
    stopped: bool,
    /// If the user stopped the motors at once: which of them may stand elsewhere than their counts.
    #[serde(skip_serializing_if = "Option::is_none")]
    uncertain: Option<Vec<bool>>,
    /// How much faster than this computer's clock the board's runs, ppm, and how much that may be off.
    clock_ppm: Option<(f64, f64)>,
    compares_missed: u16,
    latest_ticks: u16,
    starved: u16,
    least_ahead_ticks: u16,
    longest_round_ticks: u16,
    most_unread_bytes: u16,
    lost_bytes: u16,
    damaged_frames: u16,
    /// Events that the board reported by itself, in words.
    events: Vec<String>,
    /// Frames that were sent more than once.
    frames_repeated: u64,
}

impl BoardReport {
    /// Whether every step came when it was due, by the board's report.
    const fn kept_up(&self) -> bool {
        self.compares_missed == 0 && self.starved == 0
    }
}

/// How the user wants a motion run on a real board.
#[derive(Clone, Copy, Debug)]
pub(super) struct PortRun<'a> {
    pub(super) port: &'a str,
    /// Rate of the line, once the board is found.
    pub(super) baud: Baud,
    pub(super) how: &'a HowToRun<'a>,
}

pub(super) fn run(
    prepared: &Prepared,
    planned: &[Planned],
    PortRun { port: name, baud, how }: PortRun<'_>,
    control: &Control,
    console: &mut Console<'_>,
) -> miette::Result<(Exit, RunEnded)> {
    let HowToRun { rehearse, no_rehearsal, json, folder, .. } = *how;
    let program = &prepared.program;
    let Some(kind) = BoardKind::named(&program.board.name) else {
        let help = "add --board uno or --board pico, or write it in the file";
        return Err(miette!(help = help, "{} is planned for the board `{}`", prepared.file, program.board.name));
    };
    if rehearse.is_some() && !kind.is_rehearsed() {
        let help = "leave --rehearse out: a Pico's queues hold twenty times what an Uno's do, or more";
        return Err(miette!(help = help, "{}: only what an Uno is to run is rehearsed", prepared.file));
    }
    // The rehearsal comes before the port is opened, since opening resets an Uno. Ctrl-C ends the rehearsal at once:
    // nothing moves yet.
    let rehearsed = match no_rehearsal || !kind.is_rehearsed() {
        true => None,
        false => {
            let put_off = planned.iter().map(|planned| planned.certificate.longest_put_off_ticks).max();
            Some(Rehearsal::of_run(prepared, baud, rehearse, put_off.unwrap_or(0), console)?)
        }
    };
    stopped_before_begin(control)?;
    interrupt::watch();
    let port = Serial::open(name, false).map_err(port_problem)?;
    // From here on the board counts from another position.
    last_positions::forget(name);
    let mut driven = {
        let mut waits = waits_with_notice(console, name);
        let goes_on = || waits() && !control.wants_stop();
        Driven::with(prepared, |program| connect_while(port, program, baud, goes_on)).map_err(drive_problem)?
    };
    let firmware = human::version(driven.board_mut().info().firmware);
    let names: Vec<String> = program.motors.iter().map(|motor| motor.name.clone()).collect();
    let path = folder.join("steps.csv");
    let writer = steps::StepWriter::new(console::create(&path)?, program.board.tick_hz, &names)
        .map_err(|error| access("write", &path, error))?;
    let mut scheduled = Scheduled { writer, error: None };
    let bar = console.progress(prepared.end_s(), &human::seconds_to(prepared.end_s(), 6));
    bar.stage("running");
    let ended = driven.run_with(control.commands(), &mut scheduled, |event| {
        bar.follow(&event);
        control.tell(&event);
    });
    drop(bar);
    let asked = ended.and_then(|ended| {
        let board = driven.board_mut();
        let measures = board.measures(false)?;
        if ended.uncertain.is_none() && how.knows_all() {
            last_positions::keep(name, program, &ended.counted, board.now());
        }
        Ok((ended, measures, board.events(), board.clock().ppm(), board.link().counts().repeated))
    });
    driven.close();
    let Scheduled { writer, error } = scheduled;
    let written = error.map_or_else(|| writer.finish(), Err).map_err(|error| access("write", &path, error));
    let runner = format!("board at {name}");
    let asked = asked.map_err(|error| run_problem(error, plan::report(prepared, planned), runner.clone(), folder));
    let (ended, measures, events, clock_ppm, frames_repeated) = asked?;
    let told = told_end(prepared, &ended, how);
    let Ended { counted, stopped, uncertain, .. } = ended;

    let says = BoardReport {
        counted,
        stopped,
        uncertain,
        clock_ppm,
        compares_missed: measures.late,
        latest_ticks: measures.latest_ticks,
        starved: measures.starved,
        least_ahead_ticks: measures.least_ahead_ticks,
        longest_round_ticks: measures.longest_round_ticks,
        most_unread_bytes: measures.most_unread,
        lost_bytes: measures.lost_bytes,
        damaged_frames: measures.damaged_frames,
        events: events.iter().map(|event| in_words(event.cause).to_owned()).collect(),
        frames_repeated,
    };
    let plan = plan::report(prepared, planned);
    let stand = if stopped || says.uncertain.is_some() { told.motors.clone() } else { Vec::new() };
    let report = PortReport { plan, runner, firmware, rehearsed, says, stand, way_back: told.way_back.clone() };
    // The user sees what the motors did even if a file could not be written. A script reads one JSON value, which is
    // then the error.
    if !json {
        console.print(&report.plan)?;
        print(&report, planned, console)?;
    }
    written?;
    console::write(&folder.join("report.json"), format!("{}\n", console::json(&report)?).as_bytes())?;
    if json {
        console.print_json(&report)?;
    } else {
        console.print(format_args!("{}: report.json, steps.csv (as scheduled)\n", folder.display()))?;
    }
    Ok((if report.says.kept_up() { Exit::Success } else { Exit::BoundBroken }, told))
}

/// A function that decides whether to wait on while the board still moves motors for an earlier host: until Ctrl-C. Its
/// first call prints that it waits.
pub(super) fn waits_with_notice(console: &mut Console<'_>, port: &str) -> impl FnMut() -> bool {
    let mut waits = false;
    move || {
        if !std::mem::replace(&mut waits, true) {
            // If standard error is closed nobody reads it.
            drop(writeln!(
                console.err,
                "The board still moves motors for a host before this one: this waits for them, half a minute at most. Ctrl-C ends the wait; \
                 then `pulsetrain stop --port {port}` stops them at once."
            ));
        }
        !interrupt::wanted()
    }
}

fn print(report: &PortReport, planned: &[Planned], console: &mut Console<'_>) -> miette::Result<()> {
    let PortReport { plan, runner, firmware, rehearsed, says, stand, way_back } = report;
    let tick_s = 1.0 / plan.tick_hz as f64;
    let ticks = |ticks: u16| human::seconds(f64::from(ticks) * tick_s);
    if let Some(Rehearsal { says, .. }) = rehearsed {
        console.print(format_args!("Rehearsed {says}.\n"))?;
    }
    console.print(format_args!(
        "Run on the {runner}, firmware {firmware}. This is the board's own word: nobody looked at its pins.\n\n"
    ))?;
    let mut table = Table::new(["motor", "counted", "planned"]);
    for ((motor, counted), planned) in plan.motors.iter().zip(&says.counted).zip(planned) {
        let steps = |steps: i64| format!("{} steps", human::count(steps.into()));
        table.row([motor.name.clone(), steps(*counted), steps(planned.certificate.position)]);
    }
    console.print(format_args!("{table}\n"))?;
    if let Some(uncertain) = &says.uncertain {
        let motors = plan.motors.iter().zip(uncertain).filter(|(_, uncertain)| **uncertain);
        let names: Vec<&str> = motors.map(|(motor, _)| motor.name.as_str()).collect();
        match names.as_slice() {
            [] => console.print("  stopped at once; no motor was too fast for that\n")?,
            names => console.print(format_args!(
                "  stopped at once; too fast for that, so may stand elsewhere than counted: {}\n",
                names.join(", ")
            ))?,
        }
    } else if says.stopped {
        console.print("  stopped on the way, within the motors' limits\n")?;
    }
    if !stand.is_empty() {
        console.print(format_args!("  the motors stand: {}\n", listed(stand)))?;
    }
    if let Some(way_back) = way_back {
        console.print(format_args!("  back to the start: {way_back}\n"))?;
    }
    if let Some(off) = says.clock_ppm {
        console.print(format_args!("  its clock is {}\n", clock_off(off, 3)))?;
    }
    console.print(format_args!(
        "  compares missed {}, the latest by {}; starved {} times; longest round {}\n",
        says.compares_missed,
        ticks(says.latest_ticks),
        says.starved,
        ticks(says.longest_round_ticks),
    ))?;
    console.print(format_args!(
        "  on the line: {} bytes lost, {} frames damaged, {} sent again; {} bytes unread at most\n",
        says.lost_bytes, says.damaged_frames, says.frames_repeated, says.most_unread_bytes,
    ))?;
    for event in &says.events {
        console.print(format_args!("  it said: {event}\n"))?;
    }
    if !says.kept_up() {
        console.print("FAIL: the board did not keep up; steps came late\n")?;
    }
    console.print("\n")
}

/// Writes the scheduled steps to a file.
struct Scheduled<W: std::io::Write> {
    writer: steps::StepWriter<W>,
    error: Option<std::io::Error>,
}

impl<W: std::io::Write> Observer for Scheduled<W> {
    fn edge(&mut self, _: pulsetrain_board::Edge) {}

    fn step(&mut self, step: ScheduledStep) {
        // An Uno has 4 motors.
        let forward = step.direction == Direction::Forward;
        if self.error.is_none() {
            self.error = self.writer.push(steps::Step { motor: step.motor as u8, tick: step.tick, forward }).err();
        }
    }
}
