//! `pulsetrain pause`, `resume` and `tempo`: change a run of this computer while it goes.

use clap::Args;
use miette::miette;
use pulsetrain_motion::human;
use pulsetrain_session::control::{Command, Event};

use super::stop::chosen;
use crate::console::{Console, Exit};
use crate::control_socket::{RunClient, RunLine, runs};
use crate::live::{KnobValue, LiveCommand, LiveEvent};

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
    change(&args.run, Command::Pause, "pause", console)
}

pub(crate) fn resume(args: &PauseArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    change(&args.run, Command::Resume, "resume", console)
}

pub(crate) fn tempo(args: &TempoArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    change(&args.run, Command::Tempo { rate: args.rate }, "tempo", console)
}

fn change(which: &WhichRun, command: Command, name: &str, console: &mut Console<'_>) -> miette::Result<Exit> {
    let mut chosen = chosen(runs()?, which.port.as_deref(), false, name)?;
    let Some(mut run) = chosen.pop() else {
        let port = which.port.as_deref().unwrap_or_default();
        return Err(miette!(help = "`pulsetrain status` lists the runs", "no run of this computer has {port}"));
    };
    run.command(command)?;
    let event = answer(&mut run, command)?;
    if which.json {
        console.print_json(&event)?;
    } else {
        console.print(format_args!("{} at {}: {}\n", run.info().file, run.info().place(), in_words(&event)))?;
    }
    Ok(Exit::Success)
}

/// Waits for the event that answers a command.
fn answer(run: &mut RunClient, command: Command) -> miette::Result<Event> {
    loop {
        let line = run.next_line()?;
        let info = run.info();
        match line {
            RunLine::Event(Event::Refused { command: refused, why })
                if std::mem::discriminant(&refused) == std::mem::discriminant(&command) =>
            {
                return Err(miette!("{} at {}: {why}; the motion goes on as it was", info.file, info.place()));
            }
            RunLine::Event(event @ (Event::Pausing { .. } | Event::Resuming { .. } | Event::Tempo { .. })) => {
                return Ok(event);
            }
            RunLine::Live(LiveEvent::AlreadyRuns) if command == Command::Resume => {
                return Err(miette!(
                    "{} at {}: the motion is not paused; it goes on as it was",
                    info.file,
                    info.place()
                ));
            }
            RunLine::Event(_) | RunLine::Live(_) | RunLine::Control { .. } | RunLine::Info(_) => {}
            RunLine::Error { error } => return Err(miette!("the run at {}: {error}", info.place())),
            RunLine::Ended(_) => return Err(miette!("{} at {} has ended", info.file, info.place())),
        }
    }
}

/// An event of a running motion, in words.
pub(super) fn in_words(event: &Event) -> String {
    let time = |at_s: f64| human::seconds_to(at_s, 4);
    match event {
        Event::Progress { at_s } => time(*at_s),
        Event::Status(status) => time(status.at_s),
        Event::Pausing { rests_s } => format!("a pause: the motors rest from {} on", time(*rests_s)),
        Event::Resuming { full_speed_s } => format!("it goes on, at full speed from {} on", time(*full_speed_s)),
        Event::Tempo { rate, from_s, ceiling } => {
            let why = ceiling.as_ref().map(|limit| format!(", the highest that the motors follow: {limit}"));
            let rate = human::significant(*rate, 4);
            format!("tempo {rate} from {} on{}", time(*from_s), why.unwrap_or_default())
        }
        Event::Stopping { at_s } => format!("the motors brake from {} on", time(*at_s)),
        Event::StoppedAtOnce { .. } => "the motors were stopped at once".to_owned(),
        Event::Ended(_) => "it ended".to_owned(),
        Event::Failed { why, .. } => format!("it failed: {why}"),
        Event::Refused { command, why } => format!("refused: {}: {why}", typed(*command)),
    }
}

/// A command as a user types it in a live motion.
fn typed(command: Command) -> String {
    match command {
        Command::Tempo { rate } => format!("tempo {rate}"),
        Command::Pause => "pause".to_owned(),
        Command::Resume => "resume".to_owned(),
        Command::Stop => "stop".to_owned(),
        Command::StopNow => "stop now".to_owned(),
    }
}

/// What a user can do if no earlier motion is left.
pub(crate) const NO_EARLIER_MOTION: &str = "No earlier motion keeps to the limits from here, so they rest where they stand: `begin` starts the motion \
                                            from its beginning, `resume` or a cue goes on";

/// An event of a live motion, in words.
pub(super) fn live_in_words(event: &LiveEvent) -> String {
    let change = |from_s: f64, until_s: f64| {
        format!("from {} on, done at {}", human::seconds_to(from_s, 4), human::seconds_to(until_s, 4))
    };
    match event {
        LiveEvent::Set { knob, value, unit, ceiling, from_s, until_s } => {
            let why = ceiling.as_ref().map(|limit| format!(", the nearest value that the motors follow: {limit}"));
            let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
            let value = human::significant(*value, 4);
            format!("{knob} is {value}{unit} {}{}", change(*from_s, *until_s), why.unwrap_or_default())
        }
        LiveEvent::Cue { name, from_s, until_s } => format!("cue {name} {}", change(*from_s, *until_s)),
        LiveEvent::Goto { position, from_s, until_s } => format!("goto {position} {}", change(*from_s, *until_s)),
        LiveEvent::Motion { from_s, until_s } => format!("the changed motion file {}", change(*from_s, *until_s)),
        LiveEvent::MotionRefused { error, line, column } => {
            let place = match (line, column) {
                (Some(line), Some(column)) => format!(" at line {line}, column {column}"),
                (Some(line), None) => format!(" at line {line}"),
                _ => String::new(),
            };
            format!("the changed motion file was refused{place}: {error}; the motion goes on as it was")
        }
        LiveEvent::Rejoined { from_s, until_s, times } => {
            format!("the motors had braked and join the motion again {} ({times} so far)", change(*from_s, *until_s))
        }
        LiveEvent::TakenBack { why, rests: false, from_s, until_s } => format!(
            "the last change is taken back: {why}. The motors had braked, and join the motion before that change {}",
            change(*from_s, *until_s)
        ),
        LiveEvent::TakenBack { why, rests: true, .. } => {
            format!("the last change is taken back: {why}. The motors had braked. {NO_EARLIER_MOTION}")
        }
        LiveEvent::Began { from_s, until_s } => format!("the motion begins {}", change(*from_s, *until_s)),
        LiveEvent::AlreadyRuns => {
            "the motion runs already, and goes on; `goto 0` and then `begin` begin it again".to_owned()
        }
        LiveEvent::MotionEnded { at_s } => format!(
            "the motion has ended at {}, and the motors rest: `begin` begins it again, a knob, a cue or the file changes it, `stop` ends the session",
            human::seconds_to(*at_s, 4)
        ),
        LiveEvent::Resting { until } if until.is_empty() => "the motors rest".to_owned(),
        LiveEvent::Resting { until } => format!("it is not time: the motors rest; the motion begins on {until}"),
        LiveEvent::Unplugged { why, port } => {
            format!("the board cannot be reached: {why}. The motors brake. This waits for {port}; `stop` ends it")
        }
        LiveEvent::Unplaced { why, motors, last } => {
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
        LiveEvent::Late { wanted_s, by_s } => format!(
            "a change for {} began {} later: send it sooner",
            human::seconds_to(*wanted_s, 4),
            human::seconds(*by_s)
        ),
        LiveEvent::Placed { motors, position } => format!("{} at {position}: noted", motors.join(", ")),
        LiveEvent::Returned { from_s, until_s } => {
            format!("the motors join the motion again {}", change(*from_s, *until_s))
        }
        LiveEvent::Refused { command, why } => {
            let command = match command {
                LiveCommand::Set { knob, value: KnobValue::Number(value) } => format!("{knob} {value}"),
                LiveCommand::Set { knob, value: KnobValue::Text(value) } => format!("{knob} {value}"),
                LiveCommand::Go => "go".to_owned(),
                LiveCommand::Back => "back".to_owned(),
                LiveCommand::Cue { name } => format!("cue {name}"),
                LiveCommand::Goto { position } => format!("goto {position}"),
                LiveCommand::Begin => "begin".to_owned(),
                LiveCommand::Rest { .. } => "to rest until it is time".to_owned(),
                LiveCommand::Here { motor: Some(motor), position } => format!("here {motor} {position}"),
                LiveCommand::Here { motor: None, position } => format!("here {position}"),
                LiveCommand::Motion { .. } => "the changed motion file".to_owned(),
            };
            format!("refused: {command}: {why}")
        }
    }
}
