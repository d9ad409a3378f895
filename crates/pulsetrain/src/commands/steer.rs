//! `pulsetrain pause`, `resume` and `tempo`: change a run of this computer while it goes.

use clap::Args;
use miette::miette;
use pulsetrain_motion::human;

use super::stop::chosen;
use crate::console::{Console, Exit};
use crate::control_socket::{RunClient, runs};
use crate::live::{KnobValue, RunCommand, RunEvent, RunLine};

#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  pulsetrain pause
  pulsetrain resume --port /dev/ttyACM0")]
pub(crate) struct PauseArgs {
    #[command(flatten)]
    run: WhichRun,
}

#[derive(Args, Debug)]
#[command(after_help = "\
The motors speed up or slow down within their limits. All of them keep their paths and phases. If a motor or the board \
cannot follow, the tempo is the highest that they can, and the answer names the limit. If the run is \
paused, it resumes with this tempo.

Examples:
  pulsetrain tempo 0.5        half as fast
  pulsetrain tempo 1          as the file has it")]
pub(crate) struct TempoArgs {
    /// How fast the motion goes: 1 is the file's own speed, 0.5 half of it; above 0, at most 10
    rate: f64,
    #[command(flatten)]
    run: WhichRun,
}

/// Which run is changed.
#[derive(Args, Debug)]
struct WhichRun {
    /// The run at this serial port, or of this name, as `pulsetrain status` lists it
    #[arg(long, value_name = "PORT")]
    port: Option<String>,
    /// Print the run's answer as JSON
    #[arg(long)]
    json: bool,
}

impl PauseArgs {
    pub(crate) fn wants_json(&self) -> bool {
        self.run.json
    }
}

impl TempoArgs {
    pub(crate) fn wants_json(&self) -> bool {
        self.run.json
    }
}

pub(crate) fn pause(args: &PauseArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    change(&args.run, RunCommand::Pause, "pause", console)
}

pub(crate) fn resume(args: &PauseArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    change(&args.run, RunCommand::Resume, "resume", console)
}

pub(crate) fn tempo(args: &TempoArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    change(&args.run, RunCommand::Tempo { rate: args.rate }, "tempo", console)
}

fn change(which: &WhichRun, command: RunCommand, name: &str, console: &mut Console<'_>) -> miette::Result<Exit> {
    let mut chosen = chosen(runs()?, which.port.as_deref(), false, name)?;
    let Some(mut run) = chosen.pop() else {
        let port = which.port.as_deref().unwrap_or_default();
        return Err(miette!(help = "`pulsetrain status` lists the runs", "no run of this computer has {port}"));
    };
    run.command(&command)?;
    let event = answer(&mut run, &command)?;
    if which.json {
        console.print_json(&event)?;
    } else {
        console.print(format_args!("{} at {}: {}\n", run.info().file, run.info().place(), in_words(&event)))?;
    }
    Ok(Exit::Success)
}

/// Waits for the event that answers a command.
fn answer(run: &mut RunClient, command: &RunCommand) -> miette::Result<RunEvent> {
    loop {
        let line = run.next_line()?;
        let info = run.info();
        match line {
            RunLine::Event(RunEvent::Refused { command: refused, why })
                if std::mem::discriminant(&refused) == std::mem::discriminant(command) =>
            {
                return Err(miette!("{} at {}: {why}; the motion goes on as it was", info.file, info.place()));
            }
            RunLine::Event(event @ (RunEvent::Pausing { .. } | RunEvent::Resuming { .. } | RunEvent::Tempo { .. })) => {
                return Ok(event);
            }
            RunLine::Event(RunEvent::AlreadyRuns) if *command == RunCommand::Resume => {
                return Err(miette!(
                    "{} at {}: the motion is not paused; it goes on as it was",
                    info.file,
                    info.place()
                ));
            }
            RunLine::Event(_) | RunLine::Control { .. } | RunLine::Info(_) => {}
            RunLine::Error { error } => return Err(miette!("the run at {}: {error}", info.place())),
            RunLine::Ended(_) => return Err(miette!("{} at {} has ended", info.file, info.place())),
        }
    }
}

/// A command as a user types it in a live motion, or what it is.
fn typed(command: &RunCommand) -> String {
    match command {
        RunCommand::Tempo { rate } => format!("tempo {rate}"),
        RunCommand::Pause => "pause".to_owned(),
        RunCommand::Resume => "resume".to_owned(),
        RunCommand::Stop => "stop".to_owned(),
        RunCommand::StopNow => "stop now".to_owned(),
        RunCommand::Set { knob, value: KnobValue::Number(value) } => format!("{knob} {value}"),
        RunCommand::Set { knob, value: KnobValue::Text(value) } => format!("{knob} {value}"),
        RunCommand::Go => "go".to_owned(),
        RunCommand::Back => "back".to_owned(),
        RunCommand::Cue { name } => format!("cue {name}"),
        RunCommand::Goto { position } => format!("goto {position}"),
        RunCommand::Begin => "begin".to_owned(),
        RunCommand::Rest { .. } => "to rest until it is time".to_owned(),
        RunCommand::Here { motor: Some(motor), position } => format!("here {motor} {position}"),
        RunCommand::Here { motor: None, position } => format!("here {position}"),
        RunCommand::Motion { .. } => "the changed motion file".to_owned(),
    }
}

/// What a user can do if no earlier motion is left.
pub(crate) const NO_EARLIER_MOTION: &str = "No earlier motion keeps to the limits from here, so they rest where they stand: `begin` starts the motion \
                                            from its beginning, `resume` or a cue goes on";

/// An event of a running motion, in words.
pub(super) fn in_words(event: &RunEvent) -> String {
    let time = |at_s: f64| human::seconds_to(at_s, 4);
    let change = |from_s: f64, until_s: f64| format!("from {} on, done at {}", time(from_s), time(until_s));
    match event {
        RunEvent::Progress { at_s } => time(*at_s),
        RunEvent::Status(status) => time(status.at_s),
        RunEvent::Pausing { rests_s } => format!("a pause: the motors rest from {} on", time(*rests_s)),
        RunEvent::Resuming { full_speed_s } => format!("it goes on, at full speed from {} on", time(*full_speed_s)),
        RunEvent::Tempo { rate, from_s, ceiling } => {
            let why = ceiling.as_ref().map(|limit| format!(", the highest that the motors follow: {limit}"));
            let rate = human::significant(*rate, 4);
            format!("tempo {rate} from {} on{}", time(*from_s), why.unwrap_or_default())
        }
        RunEvent::Stopping { at_s } => format!("the motors brake from {} on", time(*at_s)),
        RunEvent::StoppedAtOnce { .. } => "the motors were stopped at once".to_owned(),
        RunEvent::Ended(_) => "it ended".to_owned(),
        RunEvent::Failed { why, .. } => format!("it failed: {why}"),
        RunEvent::Set { knob, value, unit, ceiling, from_s, until_s } => {
            let why = ceiling.as_ref().map(|limit| format!(", the nearest value that the motors follow: {limit}"));
            let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
            let value = human::significant(*value, 4);
            format!("{knob} is {value}{unit} {}{}", change(*from_s, *until_s), why.unwrap_or_default())
        }
        RunEvent::Cue { name, from_s, until_s } => format!("cue {name} {}", change(*from_s, *until_s)),
        RunEvent::Goto { position, from_s, until_s } => format!("goto {position} {}", change(*from_s, *until_s)),
        RunEvent::Motion { from_s, until_s } => format!("the changed motion file {}", change(*from_s, *until_s)),
        RunEvent::MotionRefused { error, line, column } => {
            let place = match (line, column) {
                (Some(line), Some(column)) => format!(" at line {line}, column {column}"),
                (Some(line), None) => format!(" at line {line}"),
                _ => String::new(),
            };
            format!("the changed motion file was refused{place}: {error}; the motion goes on as it was")
        }
        RunEvent::Rejoined { from_s, until_s, times } => {
            format!("the motors had braked and join the motion again {} ({times} so far)", change(*from_s, *until_s))
        }
        RunEvent::TakenBack { why, rests: false, from_s, until_s } => format!(
            "the last change is taken back: {why}. The motors had braked, and join the motion before that change {}",
            change(*from_s, *until_s)
        ),
        RunEvent::TakenBack { why, rests: true, .. } => {
            format!("the last change is taken back: {why}. The motors had braked. {NO_EARLIER_MOTION}")
        }
        RunEvent::Began { from_s, until_s } => format!("the motion begins {}", change(*from_s, *until_s)),
        RunEvent::AlreadyRuns => {
            "the motion runs already, and goes on; `goto 0` and then `begin` begin it again".to_owned()
        }
        RunEvent::MotionEnded { at_s } => format!(
            "the motion has ended at {}, and the motors rest: `begin` begins it again, a knob, a cue or the file changes it, `stop` ends the session",
            time(*at_s)
        ),
        RunEvent::Resting { until } if until.is_empty() => "the motors rest".to_owned(),
        RunEvent::Resting { until } => format!("it is not time: the motors rest; the motion begins on {until}"),
        RunEvent::Unplugged { why, port } => {
            format!("the board cannot be reached: {why}. The motors brake. This waits for {port}; `stop` ends it")
        }
        RunEvent::Unplaced { why, motors, last } => {
            let last = match last.as_slice() {
                [] => String::new(),
                last => format!(" They stood at {}: if they do still, write `here last`.", last.join(", ")),
            };
            format!(
                "{why}: the position of {} is not known. No motor moves until you write it, such as `here 0 deg`, or `here {} 90 deg` for one motor.{last}",
                motors.join(", "),
                motors.first().map_or("MOTOR", String::as_str)
            )
        }
        RunEvent::Late { wanted_s, by_s } => {
            format!("a change for {} began {} later: send it sooner", time(*wanted_s), human::seconds(*by_s))
        }
        RunEvent::Placed { motors, position } => format!("{} at {position}: noted", motors.join(", ")),
        RunEvent::Returned { from_s, until_s } => {
            format!("the motors join the motion again {}", change(*from_s, *until_s))
        }
        RunEvent::Refused { command, why } => format!("refused: {}: {why}", typed(command)),
    }
}
