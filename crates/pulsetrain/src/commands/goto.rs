//! `pulsetrain goto`: moves motors from where they stand to a position.

use std::path::PathBuf;

use clap::Args;
use miette::{Report, miette};
use pulsetrain_board::{Board, Port, Remote, RemoteError, Serial};
use pulsetrain_core::wire::Baud;
use pulsetrain_motion::law::SCurve;
use pulsetrain_motion::program::{Limits, Motor, PositionUnits, Program};
use pulsetrain_motion::quantity::{Quantity, nearest};
use pulsetrain_motion::{Law, LawError, Time, human};
use pulsetrain_plan::Settings;
use pulsetrain_report::positions::{START, check_range, example_position, start, typed};
use pulsetrain_session::drive::{DriveError, session_number};
use pulsetrain_session::prepare::Prepared;

use super::problems::{drive_problem, port_problem, taken_by_run};
use super::run::{HowToRun, perform};
use crate::console::{Console, Exit};
use crate::diagnostic::advised;
use crate::way_back::quoted;
use crate::{arguments, last_positions, load};

#[derive(Args, Debug)]
#[command(after_help = "\
Each motor moves along an S-curve within its max_speed and max_acceleration. A motor without these limits moves \
slowly: 0.1 rev/s, 0.2 rev/s^2. Positions are those of the motion file. `start` is where its motion begins, mostly 0.

A board counts its steps as long as it has power and is not reset. `goto` uses that count if this computer made the \
last run or `goto` on the board. Otherwise the positions of the motors are not known. An Uno is reset whenever its port is \
opened. Then look where the motors are, and say it with --from.

Without --port, the motors of a virtual board move. They stand at `start`.

Examples:
  pulsetrain goto examples/tutorial.toml \"90 deg\"
  pulsetrain goto examples/sweep.toml \"1 rev\" --motor first --from \"0.5 rev\" --port /dev/ttyACM0
  pulsetrain goto examples/sweep.toml start --from \"first=12 deg\" --from \"second=-3 deg\" --motor first --motor second")]
pub(crate) struct GotoArgs {
    /// Motion file (TOML): its motors are moved, not along its motions
    pub(crate) file: PathBuf,
    /// Where to: a position such as "90 deg", or `start`
    #[arg(value_name = "POSITION", allow_hyphen_values = true)]
    pub(crate) target: String,
    /// Move this motor alone; may be repeated [default: all]
    #[arg(long, value_name = "MOTOR")]
    pub(crate) motor: Vec<String>,
    /// Where the motors stand: a position for all, or MOTOR=POSITION; may be repeated
    #[arg(long, value_name = "POSITION", allow_hyphen_values = true)]
    pub(crate) from: Vec<String>,
    /// The motors of the board at this serial port
    #[arg(long, value_name = "PORT")]
    pub(crate) port: Option<String>,
    /// Rate of the line to the board [default: 1000000; 2000000 for a Pico]
    #[arg(long, value_name = "BAUD", value_parser = arguments::baud, conflicts_with = "native")]
    pub(crate) baud: Option<Baud>,
    /// This board instead of the file's
    #[arg(long, value_name = "BOARD", value_parser = arguments::board)]
    pub(crate) board: Option<String>,
    /// Use this computer's own step generator, not an emulated board
    #[arg(long, conflicts_with = "port")]
    pub(crate) native: bool,
    /// Where the files go [default: out/ and the file's name with -goto]
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
    /// Print the report as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

/// The speed of a motor without max_speed, rev/s, and the acceleration of one without max_acceleration, rev/s².
const SLOW: (f64, f64) = (0.1, 0.2);
/// How much of its limits a motor uses: what rounding adds must not break one.
const SHARE: f64 = 0.9;
/// How much of the board's highest step rate a motor uses.
const BOARD_SHARE: f64 = 0.5;
/// The acceleration builds up within this time, s.
const BUILD_UP_S: f64 = 0.1;

pub(crate) fn run(args: &GotoArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    let file = load::found(&args.file);
    let contents = load::contents(&file)?;
    let units = contents.units();
    let name = file.display().to_string();
    let mut prepared = Prepared::new(name, contents, args.board.as_deref()).map_err(advised)?;
    let instead = "type `goto` with a position there, such as `goto 0`";
    if let Some(taken) = args.port.as_deref().and_then(|port| taken_by_run(port, instead)) {
        return Err(taken);
    }
    let motors = Motors { program: &prepared.program, units: &units, moved: moved(&prepared.program, &args.motor)? };
    let program = &prepared.program;
    let targets = motors.targets(&args.target)?;
    let held = |targets: &[Option<f64>]| {
        check_range(program, targets).map_err(|error| miette!(help = error.advice(), "{error}"))
    };
    // The port is not opened for a position that is refused anyway.
    held(&motors.goals(&targets, &vec![None; targets.len()]))?;
    let from = motors.positions(args, console)?;
    held(&motors.goals(&targets, &from))?;
    let distances = targets.iter().zip(&from).zip(&motors.moved);
    let distances: Vec<i64> =
        distances.map(|((to, from), moved)| from.filter(|_| *moved).map_or(0, |from| whole_steps(*to, from))).collect();
    let is_known = from.iter().map(Option::is_some).collect();
    if distances.iter().all(|steps| *steps == 0) {
        return console.print("the motors are there already: nothing moves\n").map(|()| Exit::Success);
    }
    let wrong = |error: LawError| miette!("{}: {error}", file.display());
    let from: Vec<f64> = from.into_iter().map(Option::unwrap_or_default).collect();
    let laws = laws(program, &from, &distances).map_err(wrong)?;
    for (motor, law) in prepared.program.motors.iter_mut().zip(laws) {
        motor.law = law;
    }
    // Each motor goes its own way.
    prepared.program.machines.clear();
    let stem = file.file_stem().unwrap_or(file.as_os_str()).to_string_lossy().into_owned();
    let folder = args.out.clone().unwrap_or_else(|| PathBuf::from("out").join(format!("{stem}-goto")));
    let how = HowToRun {
        native: args.native,
        port: args.port.as_deref(),
        baud: args.baud,
        rehearse: None,
        no_rehearsal: false,
        trace: true,
        steps: true,
        json: args.json,
        verbose: false,
        folder: &folder,
        goto_options: goto_options(args),
        is_known,
    };
    perform(prepared, &how, console)
}

/// The options of another `goto` on the same board.
fn goto_options(args: &GotoArgs) -> String {
    let board = args.board.as_ref().map(|board| format!(" --board {board}"));
    let port = args.port.as_deref().map(|port| format!(" --port {}", quoted(port)));
    board.into_iter().chain(port).chain(args.native.then(|| " --native".to_owned())).collect()
}

/// By motor: whether it is to be moved.
fn moved(program: &Program, names: &[String]) -> miette::Result<Vec<bool>> {
    for name in names {
        number_of(program, name)?;
    }
    let is_named = |motor: &Motor| names.is_empty() || names.contains(&motor.name);
    Ok(program.motors.iter().map(is_named).collect())
}

fn number_of(program: &Program, name: &str) -> miette::Result<usize> {
    let names = || program.motors.iter().map(|motor| motor.name.as_str());
    names().position(|known| known == name).ok_or_else(|| {
        let help = match nearest(name, names()) {
            Some(near) => format!("did you mean {near}?"),
            None => format!("there are {}", names().collect::<Vec<_>>().join(", ")),
        };
        miette!(help = help, "the file has no motor {name}")
    })
}

/// The motors of a file, and which of them are moved.
struct Motors<'a> {
    program: &'a Program,
    units: &'a [PositionUnits],
    moved: Vec<bool>,
}

/// The longest way, steps: counts of every board have 32 bits.
const FARTHEST: f64 = 2_147_483_647.0;

impl Motors<'_> {
    /// A position of a motor, steps.
    fn position(&self, number: usize, text: &str) -> miette::Result<f64> {
        let (motor, units) = (&self.program.motors[number], &self.units[number]);
        if text == START {
            return Ok(start(motor));
        }
        let name = &motor.name;
        let example = example_position(self.program, number);
        let help = format!("write it like \"{example}\", or `{START}`, where the motion begins");
        let no_position = |why: String| miette!(help = help.clone(), "{text:?} is no position of motor {name}: {why}");
        let quantity = Quantity::parse(text).map_err(|error| no_position(error.to_string()))?;
        if !quantity.base.is_position() || quantity.per_seconds != 0 {
            return Err(no_position(format!("it is {}", quantity.kind())));
        }
        let steps = units.steps(quantity.base).ok_or_else(|| no_position("it has no `lead`".to_owned()))?;
        let steps = quantity.value * steps;
        if steps.abs() < FARTHEST {
            return Ok(steps);
        }
        Err(no_position(format!("it is {} steps away", human::significant(steps, 3))))
    }

    /// Where the motors are to go, steps; 0 for those that are not moved.
    fn targets(&self, text: &str) -> miette::Result<Vec<f64>> {
        let motors = self.moved.iter().enumerate();
        motors.map(|(number, moved)| if *moved { self.position(number, text) } else { Ok(0.0) }).collect()
    }

    /// Where the motors are in the end, steps: at their targets, or where they stand if they are not moved.
    fn goals(&self, targets: &[f64], from: &[Option<f64>]) -> Vec<Option<f64>> {
        let each = self.moved.iter().zip(targets).zip(from);
        each.map(|((moved, target), from)| if *moved { Some(*target) } else { *from }).collect()
    }

    /// Where the motors stand, steps; `None` for those that are not moved and of which it is not known.
    fn positions(&self, args: &GotoArgs, console: &mut Console<'_>) -> miette::Result<Vec<Option<f64>>> {
        let Motors { program, moved, .. } = self;
        let mut known: Vec<Option<f64>> = vec![None; moved.len()];
        for text in &args.from {
            match text.split_once('=') {
                Some((name, text)) => {
                    let number = number_of(program, name.trim())?;
                    known[number] = Some(self.position(number, text.trim())?);
                }
                None => {
                    for number in (0..moved.len()).filter(|number| moved[*number]) {
                        known[number] = Some(self.position(number, text)?);
                    }
                }
            }
        }
        let is_known = |known: &[Option<f64>]| known.iter().zip(moved).all(|(known, moved)| known.is_some() || !moved);
        if !is_known(&known)
            && let Some(found) = match &args.port {
                Some(port) => counted(port, program)?,
                None => Some(program.motors.iter().map(start).collect()),
            }
        {
            let each = program.motors.iter().zip(&found);
            let each = each.map(|(motor, steps)| format!("{} at {}", motor.name, typed(*steps, &motor.scale)));
            let each: Vec<String> = each.collect();
            let by = if args.port.is_some() {
                "by the board's count"
            } else {
                "on a virtual board, where the motion begins"
            };
            console.tell(format_args!("{by}: {}\n", each.join(", ")));
            known.iter_mut().zip(found).for_each(|(known, found)| *known = known.or(Some(found)));
        }
        if is_known(&known) {
            return Ok(known);
        }
        Err(unknown(program, &known, moved))
    }
}

/// The error for motors of which nobody knows where they are.
fn unknown(program: &Program, known: &[Option<f64>], moved: &[bool]) -> Report {
    let motors = program.motors.iter().zip(known).zip(moved).filter(|((_, known), moved)| known.is_none() && **moved);
    let motors: Vec<&Motor> = motors.map(|((motor, _), _)| motor).collect();
    let names: Vec<&str> = motors.iter().map(|motor| motor.name.as_str()).collect();
    let example = match motors.as_slice() {
        [motor] if program.motors.len() == 1 => format!("--from \"0 {}\"", motor.scale.unit),
        motors => {
            let each = motors.iter().map(|motor| format!("--from \"{}=0 {}\"", motor.name, motor.scale.unit));
            each.collect::<Vec<_>>().join(" ")
        }
    };
    let help = format!("look where they are, and say it: {example} for a motor that stands at 0");
    miette!(
        help = help,
        "the position of {} is not known: the board was reset, or set up by another program, since a run of this computer knew it",
        names.join(", ")
    )
}

/// The positions by the count of the board at a port, steps, if it still has the count of the last run.
fn counted(port: &str, program: &Program) -> miette::Result<Option<Vec<f64>>> {
    let serial = Serial::open(port, false).map_err(port_problem)?;
    let counts = counts(serial).map_err(|error| drive_problem(DriveError::Remote(error)))?;
    Ok(counts.and_then(|(counts, clock)| last_positions::recall(port, program, &counts, clock)))
}

/// The counts of a board whose motors rest, and its clock; `None` while they move.
fn counts<P: Port>(port: P) -> Result<Option<(Vec<i64>, u64)>, RemoteError> {
    let mut board = Remote::open(port, session_number())?;
    let status = board.status();
    let clock = board.now();
    drop(board.close());
    let status = status?;
    let counts = status.motors.as_slice().iter().map(|motor| motor.position.into()).collect();
    Ok(status.is_idle().then_some((counts, clock)))
}

/// The steps from a position to another, to the nearest.
fn whole_steps(to: f64, from: f64) -> i64 {
    (to - from).round() as i64
}

/// The laws that move the motors so many steps from where they stand. All begin together.
fn laws(program: &Program, from: &[f64], distances: &[i64]) -> Result<Vec<Law>, LawError> {
    let moves = program.motors.iter().zip(distances).map(|(motor, steps)| {
        if *steps == 0 { Ok(None) } else { Law::s_curve(limits(program, motor, *steps)).map(Some) }
    });
    let moves: Vec<Option<Law>> = moves.collect::<Result<_, LawError>>()?;
    let longest = moves.iter().flatten().filter_map(Law::end).fold(Time::ZERO, Time::max);
    let each = moves.into_iter().zip(from);
    each.map(|(law, from)| law.map_or_else(|| Law::rest(longest), Ok)?.shifted(*from)).collect()
}

/// A motor's move. It ends half a step behind the place at which its last step is due, so that the step's time is certain.
fn limits(program: &Program, motor: &Motor, steps: i64) -> SCurve {
    let Limits { max_speed, max_acceleration, .. } = motor.limits;
    let interval = Settings::of(program, motor).min_interval_ticks;
    let fastest = BOARD_SHARE * program.board.tick_hz as f64 / interval.max(1) as f64;
    let max_speed = max_speed.map_or(SLOW.0 * motor.scale.steps_per_rev, |speed| SHARE * speed).min(fastest);
    let max_acceleration = max_acceleration.map_or(SLOW.1 * motor.scale.steps_per_rev, |limit| SHARE * limit);
    let distance = steps.signum() as f64 * (steps.unsigned_abs() as f64 + program.grid.hysteresis);
    SCurve { distance, max_speed, max_acceleration, max_jerk: max_acceleration / BUILD_UP_S, start_speed: 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pulsetrain_board::Edge;
    use pulsetrain_board::shared::Shared;
    use pulsetrain_board::virtual_pico::VirtualPico;
    use pulsetrain_motion::file;
    use pulsetrain_session::drive::Driven;

    /// Tests that run firmware on an emulated chip.
    mod chips {
        use super::*;

        /// A Pico goes on counting. Its count says nothing once it was reset, or set up again.
        #[test]
        fn a_count_is_believed_as_long_as_it_is_that_of_the_last_run() {
            let text = "board = \"pico\"\n[motor.m]\nsteps_per_rev = 200\npulse_high = \"2 us\"\npins = { step = 2, dir = 3 }\n\
                        forward = \"high\"\n[[motion]]\nmotor = \"m\"\nlaw.formula = { theta = \"90 + 18*t\", unit = \"deg\", \
                        duration = \"1 s\" }\n[[motion]]\nmotor = \"m\"\nlaw.speed = { speed = \"0 rev/s\", duration = \"0.1 s\" }\n";
            let no_file = |_: &std::path::Path| Err(std::io::ErrorKind::NotFound.into());
            let contents = file::read_contents(text, "m.toml", &no_file).map_err(|error| error.plain()).unwrap();
            let prepared = Prepared::new("m.toml".to_owned(), contents, None).unwrap();
            let program = &prepared.program;
            let pico = Shared::new(VirtualPico::on_usb());
            let mut driven = Driven::at(&prepared, pico.clone(), Baud::B2M).unwrap();
            let ended = driven.run(&mut |_: Edge| {}, |_| {}).unwrap();
            assert_eq!(ended.counted, [10]);
            let kept = last_positions::written(program, &ended.counted, driven.board_mut().now()).unwrap();
            drop(driven.close());
            let recall = |(counts, clock): (Vec<i64>, u64)| last_positions::read(&kept, program, &counts, clock);
            let found = counts(pico.clone()).unwrap().unwrap();
            assert_eq!(found.0, [10]);
            assert_eq!(recall(found.clone()), Some(vec![60.0]), "18 deg from 90 deg on");
            assert_eq!(recall((found.0, 0)), None, "a clock that goes back is that of a board that was reset");
            let mut other = program.clone();
            other.motors[0].name = "n".to_owned();
            assert_eq!(last_positions::read(&kept, &other, &[10], u64::MAX), None, "another file's motors");
            // Another program sets the board up, and counts from 0.
            drop(Driven::at(&prepared, pico.clone(), Baud::B2M).unwrap().close());
            let elsewhere = counts(pico).unwrap().map(|(counts, _)| counts);
            assert!(elsewhere.is_none_or(|counts| last_positions::read(&kept, program, &counts, u64::MAX).is_none()));
            let (counts, clock) = counts(VirtualPico::on_usb()).unwrap().unwrap();
            assert_eq!((counts.len(), recall((counts, clock))), (0, None), "it was switched on just now");
        }
    }
}
