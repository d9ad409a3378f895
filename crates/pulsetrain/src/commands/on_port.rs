//! `pulsetrain run FILE --port …`: runs a motion on a real board. The board's own report is all that is known of the
//! run.

use pulsetrain_board::BoardKind;
use std::fmt::{self, Display};

use miette::miette;
use pulsetrain_board::remote::in_words;
use pulsetrain_board::{Board, Observer, ScheduledStep, Serial};
use pulsetrain_core::Direction;
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::Cause;
use pulsetrain_trace::steps;
use schemars::JsonSchema;
use serde::Serialize;

use super::problems::{clock_off, drive_problem, port_problem, run_problem};
use super::rehearsal::Rehearsal;
use super::run::{HowToRun, run_end, stopped_before_begin};
use crate::console::Access;
use crate::console::{self, Console, Exit};
use crate::control_socket::Control;
use crate::files::outputs::{self, OutputError};
use crate::live::RunEnded;
use crate::{interrupt, last_positions};
use pulsetrain_motion::human;
use pulsetrain_report::plan_report::{Column, PlanReport, summary};
use pulsetrain_report::positions::MotorPosition;
use pulsetrain_report::recorded_steps::RecordedSteps;
use pulsetrain_report::run_report::{StoppedReport, pass_or_fail};
use pulsetrain_session::Proof;
use pulsetrain_session::control::{Ended, Event};
use pulsetrain_session::drive::{Driven, connect_while};
use pulsetrain_session::prepare::Prepared;

/// The report of a run on a real board. Nobody but the board saw its pins.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct PortReport {
    #[serde(flatten)]
    plan: PlanReport,
    /// "board at PORT".
    runner: String,
    /// The firmware's version.
    firmware: String,
    /// Whether each step came when it was due, by the board's report.
    pass: bool,
    /// Whether all of the motion was made. False if the user stopped it.
    complete: bool,
    /// Steps that each motor made, in both directions.
    steps_made: Vec<u64>,
    /// Each motor's position by the board's count, in its `unit`.
    positions: Vec<f64>,
    /// Only of an Uno, and only if the user wants a rehearsal.
    #[serde(skip_serializing_if = "Option::is_none")]
    rehearsed: Option<Rehearsal>,
    /// The board's report.
    says: BoardReport,
    /// Where the motors are, if the motion was stopped on its way.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    stand: Vec<MotorPosition>,
    /// The command that brings them back to the motion's start.
    #[serde(skip_serializing_if = "Option::is_none")]
    way_back: Option<String>,
    /// The file that could not be written, and why.
    #[serde(skip_serializing_if = "Option::is_none")]
    unwritten: Option<String>,
}

/// The board's own report of a run.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct BoardReport {
    /// Steps of each motor, forward minus backward.
    #[serde(rename = "counted_steps")]
    counted: Vec<i64>,
    /// Whether the user stopped the motion before its end.
    stopped: bool,
    /// When the motors began to brake, s of the motion, if the user stopped it.
    #[serde(skip_serializing_if = "Option::is_none")]
    stop_began_s: Option<f64>,
    /// If the user stopped the motors at once: which of them may stand elsewhere than their counts.
    #[serde(skip_serializing_if = "Option::is_none")]
    uncertain: Option<Vec<bool>>,
    /// How much faster than this computer's clock the board's runs, and how much that figure may be off, ppm.
    clock_ppm: Option<(f64, f64)>,
    /// Edges that the timer missed: they came late.
    compares_missed: u16,
    /// How late the latest of them was, ticks.
    latest_ticks: u16,
    /// How many times the step generator had nothing ready.
    starved: u16,
    /// How far ahead of its edges the step generator was at least, ticks.
    least_ahead_ticks: u16,
    /// The longest round of the firmware's loop, ticks.
    longest_round_ticks: u16,
    /// The most bytes that waited to be read.
    most_unread_bytes: u16,
    /// Bytes that were lost on the line.
    lost_bytes: u16,
    /// Frames that came damaged, and were repeated.
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
    proof: Proof,
    PortRun { port: name, baud, how }: PortRun<'_>,
    control: &Control,
    console: &mut Console<'_>,
) -> miette::Result<(Exit, RunEnded)> {
    let HowToRun { rehearse, no_rehearsal, json, verbose, folder, .. } = *how;
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
            let put_off = proof.planned.iter().map(|planned| planned.certificate.longest_put_off_ticks).max();
            Some(Rehearsal::of_run(prepared, baud, rehearse, put_off.unwrap_or(0), console)?)
        }
    };
    // A file that cannot be written is found before anything moves.
    let names: Vec<String> = program.motors.iter().map(|motor| motor.name.clone()).collect();
    let path = folder.join("steps.csv");
    let writer = how.steps.then(|| -> Result<_, OutputError> {
        let writer = steps::StepWriter::new(outputs::create(&path, "--out")?, program.board.tick_hz, &names);
        Ok(writer.map_err(|error| Access::write(&path, "--out", error))?)
    });
    let writer = writer.transpose()?;
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
    if !proof.is_whole {
        driven = driven.proving(prepared, proof.until_s).map_err(drive_problem)?;
    }
    let firmware = human::version(driven.board_mut().info().firmware);
    let mut scheduled = Scheduled { writer, made: vec![RecordedSteps::default(); names.len()], error: None };
    let bar = console.run_progress((!prepared.is_endless()).then(|| prepared.end_s()));
    bar.stage("running");
    let mut stop_began_s = None;
    let mut left_plan = false;
    let ended = driven.run_with(control.commands(), &mut scheduled, |event| {
        match event {
            Event::Stopping { at_s } => (stop_began_s, left_plan) = (Some(at_s), true),
            Event::StoppedAtOnce { .. } | Event::Pausing { .. } | Event::Tempo { .. } => left_plan = true,
            _ => {}
        }
        bar.follow(&event);
        control.publish(&event.into());
    });
    drop(bar);
    let planned = if proof.is_whole { proof.planned } else { driven.planned() };
    let asked = ended.and_then(|ended| {
        let board = driven.board_mut();
        let measures = board.measures(false)?;
        if ended.uncertain.is_none() && how.knows_all() {
            last_positions::keep(name, program, &ended.counted, board.now());
        }
        Ok((ended, measures, board.events(), board.clock().ppm(), board.link().counts().repeated))
    });
    driven.close();
    let Scheduled { writer, error, made } = scheduled;
    let written = error
        .map_or_else(|| writer.map_or(Ok(()), |writer| writer.finish().map(drop)), Err)
        .map_err(|error| Access::write(&path, "--out", error));
    let runner = format!("board at {name}");
    let asked = asked.map_err(|error| {
        let plan = PlanReport::made(prepared, &planned, &made);
        let report = StoppedReport::of(&error, plan, runner.clone());
        run_problem(error, report, folder)
    });
    let (ended, measures, events, clock_ppm, frames_repeated) = asked?;
    let end = run_end(prepared, &ended, how);
    let Ended { counted, stopped, uncertain, .. } = ended;

    let says = BoardReport {
        counted,
        stopped,
        stop_began_s,
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
        events: events.iter().map(|event| event_in_words(event.cause, stopped).to_owned()).collect(),
        frames_repeated,
    };
    let plan = match left_plan {
        false => PlanReport::new(prepared, &planned),
        true => PlanReport::made(prepared, &planned, &made),
    };
    let positions = plan.motors.iter().zip(&says.counted);
    let positions = positions.map(|(motor, steps)| motor.start + *steps as f64 / motor.steps_per_unit).collect();
    let (pass, complete) = (says.kept_up(), !says.stopped);
    let stand = if complete { Vec::new() } else { end.motors.clone() };
    let mut report = PortReport {
        plan,
        runner,
        firmware,
        pass,
        complete,
        steps_made: made.iter().map(|made| made.steps).collect(),
        positions,
        rehearsed,
        says,
        stand,
        way_back: end.way_back.clone(),
        unwritten: None,
    };
    // What the motors did is printed even if a file could not be written.
    if !json {
        console.print(PortText { report: &report, verbose })?;
    }
    let text = format!("{}\n", console::json(&report)?);
    let written = written
        .map_err(OutputError::from)
        .and_then(|()| outputs::write(&folder.join("report.json"), "--out", text.as_bytes()));
    report.unwritten = written.as_ref().err().map(ToString::to_string);
    if json {
        console.print_json(&report)?;
    } else {
        if written.is_ok() {
            let scheduled = if how.steps { " (as scheduled)" } else { "" };
            console.print(format_args!("\n  {}{scheduled}\n", how.files(&[])))?;
        }
        console.print(format_args!("{}\n", report.conclusion()))?;
    }
    if let Err(error) = written {
        let error = error.into();
        let exit = if json { console.complain(&error) } else { Err(error) };
        return exit.map(|exit| (exit, end));
    }
    Ok((if report.pass { Exit::Success } else { Exit::BoundBroken }, end))
}

/// An event of a board in words, for a run that the user may have stopped.
fn event_in_words(cause: Cause, stopped: bool) -> &'static str {
    match cause {
        // Every queue ends in a stop: the board made all that it still had, which was the way to rest.
        Cause::Finished if stopped => "the motors came to rest",
        cause => in_words(cause),
    }
}

/// A function that decides whether to wait on while the board still moves motors for an earlier host: until Ctrl-C. Its
/// first call prints that it waits.
pub(super) fn waits_with_notice(console: &mut Console<'_>, port: &str) -> impl FnMut() -> bool {
    let mut waits = false;
    move || {
        if !std::mem::replace(&mut waits, true) {
            console.tell(format_args!(
                "The board still moves motors for another program. This waits until they rest, half a minute at most. Ctrl-C ends the wait; \
                 then `pulsetrain stop --port {port}` stops them.\n"
            ));
        }
        !interrupt::wanted()
    }
}

impl PortReport {
    fn conclusion(&self) -> String {
        let PortReport { says, .. } = self;
        match (self.pass, self.complete, says.stop_began_s) {
            (false, ..) => "FAIL: the board did not keep up; steps came late".to_owned(),
            (true, true, _) => "PASS: by the board's own report, every step came when it was due".to_owned(),
            (true, false, Some(at_s)) => {
                format!("PASS: stopped on your order: braking began at {}", human::seconds_to(at_s, 4))
            }
            (true, false, None) => "PASS: stopped on your order".to_owned(),
        }
    }

    /// How the user's stop ended.
    fn stop_in_words(&self) -> Option<String> {
        let PortReport { plan, says, .. } = self;
        let named = |is: &dyn Fn(usize) -> bool| {
            let motors = plan.motors.iter().enumerate().filter(|(index, _)| is(*index));
            motors.map(|(_, motor)| motor.name.as_str()).collect::<Vec<_>>().join(", ")
        };
        if let Some(uncertain) = &says.uncertain {
            let names = named(&|index| uncertain.get(index) == Some(&true));
            return Some(if names.is_empty() {
                "Stopped at once. No motor was too fast for that.".to_owned()
            } else {
                format!(
                    "Stopped at once. Too fast for that, so may stand elsewhere than counted: {names}. Before the next run move \
                     all motors to their start by hand."
                )
            });
        }
        if !says.stopped {
            return None;
        }
        let unlimited = named(&|index| plan.motors[index].max_acceleration.is_none());
        Some(if unlimited.is_empty() {
            "Stopped on the way, within the motors' limits.".to_owned()
        } else {
            format!(
                "Stopped on the way. The file gives no max_acceleration for {unlimited}: the board chose how hard to brake."
            )
        })
    }
}

/// A run's report for people. Its last line is [`PortReport::conclusion`].
struct PortText<'a> {
    report: &'a PortReport,
    verbose: bool,
}

impl Display for PortText<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let PortReport { plan, runner, firmware, rehearsed, says, pass, steps_made, positions, .. } = self.report;
        writeln!(f, "{}  {} on the {runner}: {}", pass_or_fail(*pass), plan.file, plan.durations("made"))?;
        plan.remarks(f)?;
        let steps = plan.motors.iter().zip(steps_made);
        let steps = steps.map(|(motor, made)| {
            let [made, planned] = [*made, motor.steps].map(|steps| human::count(steps.into()));
            if made == planned { made } else { format!("{made} of {planned}") }
        });
        writeln!(f, "\n{}", summary(&plan.motors, Column::Text("steps made", steps.collect())))?;
        for ((motor, position), counted) in plan.motors.iter().zip(positions).zip(&says.counted) {
            let unit = human::unit(&motor.unit);
            let position = human::significant(*position, 6);
            writeln!(
                f,
                "  {} is at {position} {unit}, {} steps from its start",
                motor.name,
                human::count((*counted).into())
            )?;
        }
        if let Some(stopped) = self.report.stop_in_words() {
            writeln!(f, "  {stopped}")?;
        }
        if let Some(way_back) = &self.report.way_back {
            writeln!(f, "  back to the start: {way_back}")?;
        }
        let tick_s = 1.0 / plan.tick_hz as f64;
        let ticks = |ticks: u16| human::seconds(f64::from(ticks) * tick_s);
        writeln!(
            f,
            "  Lateness: {} edges late, the latest by {}. This is the board's own report; its pins were not measured.",
            says.compares_missed,
            ticks(says.latest_ticks)
        )?;
        plan.write_notes(f)?;
        if let Some(Rehearsal { says, .. }) = rehearsed {
            writeln!(f, "  Rehearsed {says}.")?;
        }
        if !self.verbose {
            return Ok(());
        }
        writeln!(f, "\n{}The board, firmware {firmware}:\n", plan.details())?;
        if let Some(off) = says.clock_ppm {
            writeln!(f, "  its clock is {}", clock_off(off, 3))?;
        }
        writeln!(f, "  starved {} times; longest round {}", says.starved, ticks(says.longest_round_ticks))?;
        writeln!(
            f,
            "  on the line: {} bytes lost, {} frames damaged, {} sent again; {} bytes unread at most",
            says.lost_bytes, says.damaged_frames, says.frames_repeated, says.most_unread_bytes,
        )?;
        says.events.iter().try_for_each(|event| writeln!(f, "  it reported: {event}"))
    }
}

/// Writes the scheduled steps to a file.
struct Scheduled<W: std::io::Write> {
    /// `None`: no file is wanted.
    writer: Option<steps::StepWriter<W>>,
    made: Vec<RecordedSteps>,
    error: Option<std::io::Error>,
}

impl<W: std::io::Write> Observer for Scheduled<W> {
    fn edge(&mut self, _: pulsetrain_board::Edge) {}

    fn step(&mut self, step: ScheduledStep) {
        // An Uno has 4 motors.
        let forward = step.direction == Direction::Forward;
        self.made[step.motor].step(step);
        if let (Some(writer), None) = (&mut self.writer, &self.error) {
            self.error = writer.push(steps::Step { motor: step.motor as u8, tick: step.tick, forward }).err();
        }
    }
}
