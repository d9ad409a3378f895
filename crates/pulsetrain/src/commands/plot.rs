//! `pulsetrain plot`: a picture of a motion, run on the native board.

use super::problems::drive_problem;
use super::{plan, run};
use crate::arguments::Motion;
use crate::console::{Console, Exit};
use crate::diagnostic::advised;
use crate::files::inputs;
use crate::files::outputs::{self, Destination};
use crate::load;
use crate::way_back::quoted;
use clap::Args;
use miette::miette;
use pulsetrain_board::{Edge, Native, Observer, ScheduledStep};
use pulsetrain_motion::file::MOST_OF_A_MOTION_FILE;
use pulsetrain_motion::{Time, file};
use pulsetrain_plot::moving::{MOST_STEPS, Moving};
use pulsetrain_session::drive::Driven;
use pulsetrain_session::estimate::Task;
use pulsetrain_session::prepare::Prepared;
use std::path::{Path, PathBuf};

#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  pulsetrain plot examples/tutorial.toml
  pulsetrain plot examples/tutorial.toml --out tutorial.png
  pulsetrain plot examples/first-uno.toml --moving --out moving.svg")]
pub(crate) struct PlotArgs {
    #[command(flatten)]
    pub(crate) motion: Motion,
    /// Picture to write, .svg or .png [default: the file's name with .svg]
    #[arg(long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,
    /// A picture that moves: the law, the STEP line and the wheel of one motor, as SVG
    #[arg(long)]
    pub(crate) moving: bool,
    /// The motor of a picture that moves [default: the first]
    #[arg(long, value_name = "NAME", requires = "moving")]
    pub(crate) motor: Option<String>,
}

pub(crate) fn run(args: &PlotArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    let path = args.out.clone().unwrap_or_else(|| args.motion.file.with_extension("svg"));
    if args.moving && !path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("svg")) {
        let help = format!("write --out {}", quoted(&path.with_extension("svg").display().to_string()));
        return Err(miette!(
            help = help,
            "a moving picture is an SVG file, and {} does not end in .svg",
            path.display()
        ));
    }
    let mut prepared = args.motion.prepare(Task::Native { files: false }, false, console)?;
    outputs::claim(&Destination::new(&path, "--out"))?;
    let planned = plan::plan(&mut prepared, console)?;
    let driven = Driven::native(&prepared).map_err(advised)?;
    if args.moving {
        return moving(args, &prepared, driven, &path, console);
    }
    let recorded = run::recorded(&prepared, planned, driven, console)?;
    run::draw(&recorded.picture, &path, "--out")?;
    console.print(format_args!("{}\n", path.display()))?;
    Ok(if recorded.verdict.ok { Exit::Success } else { Exit::BoundBroken })
}

/// Writes a picture that moves.
fn moving(
    args: &PlotArgs,
    prepared: &Prepared,
    mut driven: Driven<Native>,
    path: &Path,
    console: &mut Console<'_>,
) -> miette::Result<Exit> {
    let motors = &prepared.program.motors;
    let names = || motors.iter().map(|motor| motor.name.as_str()).collect::<Vec<_>>().join(", ");
    let index = match &args.motor {
        None => 0,
        Some(name) => motors
            .iter()
            .position(|motor| motor.name == *name)
            .ok_or_else(|| miette!("there is no motor {name}; the motors are {}", names()))?,
    };
    let motor = &motors[index];
    let tick_s = 1.0 / prepared.program.board.tick_hz as f64;
    let (mut steps, mut position) = (Vec::new(), 0_i64);
    driven
        .run(
            &mut StepObserver(|step: ScheduledStep| {
                if step.motor == index && steps.len() <= MOST_STEPS {
                    position += i64::from(step.direction.sign());
                    steps.push((step.tick as f64 * tick_s, position));
                }
            }),
            |_| {},
        )
        .map_err(drive_problem)?;
    if steps.len() > MOST_STEPS {
        let help = "take a shorter part, --for \"2 s\", or fewer microsteps";
        return Err(miette!(
            help = help,
            "{} makes more than {MOST_STEPS} steps: no picture that moves has as many",
            motor.name
        ));
    }
    let text = inputs::bytes(&load::found(&args.motion.file), MOST_OF_A_MOTION_FILE)?;
    let text = String::from_utf8_lossy(&text);
    let law = file::first_law(&text, &motor.name).unwrap_or_else(|| prepared.file.clone());
    let title = if motors.len() == 1 { law } else { format!("{}: {law}", motor.name) };
    let scale = &motor.scale;
    let moving = Moving {
        title: &title,
        law: &motor.law,
        unit: (&scale.unit, scale.steps_per_unit),
        steps_per_turn: scale.steps_per_rev,
        steps: &steps,
        duration_s: motor.law.end().map_or(prepared.end_s(), Time::seconds),
    };
    let svg = moving.svg().map_err(|error| miette!("motor {}: {error}", motor.name))?;
    outputs::write(path, "--out", svg.as_bytes())?;
    console.print(format_args!("{}\n", path.display()))?;
    Ok(Exit::Success)
}

/// Takes the steps of a run, and no edges.
struct StepObserver<F>(F);

impl<F: FnMut(ScheduledStep)> Observer for StepObserver<F> {
    fn edge(&mut self, _: Edge) {}

    fn step(&mut self, step: ScheduledStep) {
        (self.0)(step);
    }
}
