//! A program that drives a board through the library: it proves a motion, lets it run on the board, turns a knob while it runs, and stops it. It knows no
//! command line.
//!
//! ```console
//! $ cargo run --release --example embed                    # the virtual Uno: the firmware's bytes on an emulated chip
//! $ cargo run --release --example embed -- /dev/ttyACM0    # a real one
//! ```

use std::collections::VecDeque;
use std::error::Error;
use std::sync::mpsc::{Sender, channel};
use std::time::Duration;

use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Edge, Leased, Port, Remote, Serial, WithReference};
use pulsetrain_core::wire::Baud;
use pulsetrain_live::{
    Batch, CommandSource, KnobValue, LiveBoard, LiveHost, LiveRun, LiveSetpoints, NamedFiles, Player, PlayerOptions,
    RunCommand, RunEvent,
};
use pulsetrain_report::positions::{MotorPosition, motor_positions};
use pulsetrain_report::run::{Progress, RunOptions, run};
use pulsetrain_session::control::{Command, Ended, Event};
use pulsetrain_session::drive::Driven;
use pulsetrain_session::prepare::Prepared;

/// The motion as a file, with a knob.
const MOTION: &str = r#"
board = "uno"
tolerance = "1 us"

[motor.pendulum]
steps_per_rev = 200
microsteps = 8
driver = "A4988"
pins = { step = 8, dir = 9 }
forward = "high"
max_acceleration = "20 rev/s^2"

[[motion]]
motor = "pendulum"
law.sine = { amplitude = "45 deg", frequency = "0.5 Hz", cycles = "forever" }

[live.knobs]
speed = { target = "pendulum.frequency", least = "0.1 Hz", greatest = "5 Hz" }
"#;

/// When the knob is turned, and when the motion is stopped, s.
const TURNED_S: f64 = 1.0;
const STOPPED_S: f64 = 3.0;

/// The result of the swing.
#[derive(Debug)]
pub(crate) struct Outcome {
    /// Whether the judge found each edge of the rehearsal in its bounds.
    pub(crate) rehearsal_passed: bool,
    /// What happened, but for the statuses.
    pub(crate) events: Vec<RunEvent>,
    /// Where the motor came to rest by the board's count.
    pub(crate) at_rest: MotorPosition,
    /// The board's count then, steps.
    pub(crate) counted: i64,
    /// Rising and falling edges of STEP. None are known of a real board.
    pub(crate) edges: u64,
}

/// Stops a rehearsal after a second of the motion.
struct StopsSoon(Sender<Command>);

impl Progress for StopsSoon {
    fn event(&mut self, event: &Event) {
        if matches!(event, Event::Progress { at_s } if *at_s > 1.0) {
            // The run reads it as long as it goes on.
            let _ = self.0.send(Command::Stop);
        }
    }
}

/// The commands of this program. A page, OSC or a knob of wood could send them.
#[derive(Default)]
struct Commands(VecDeque<Batch>);

impl CommandSource for Commands {
    fn next(&mut self, _wait: Duration) -> Option<Batch> {
        self.0.pop_front()
    }
}

/// What this program hears of the motion.
#[derive(Default)]
struct Heard {
    now_s: f64,
    events: Vec<RunEvent>,
}

impl LiveHost for Heard {
    fn publish(&mut self, event: &RunEvent) {
        match event {
            RunEvent::Progress { at_s } => self.now_s = *at_s,
            RunEvent::Status(_) => {}
            other => {
                println!("at {:.2} s: {other:?}", self.now_s);
                self.events.push(other.clone());
            }
        }
    }
}

/// A board that gets a good-bye in the end, so that the next program need not wait until it takes this one for lost.
struct SaysGoodbye;

impl<P: Port> LiveBoard<WithReference<Remote<P>>> for SaysGoodbye {
    fn close(&mut self, driven: Driven<WithReference<Remote<P>>>, _ended: Option<&Ended>) {
        driven.close();
    }
}

/// Rehearses a pendulum on the virtual Uno, lets it swing on the board at a port, turns its knob, and stops it within its limits.
///
/// # Errors
/// If the board is not there, refuses, or is lost. Each error says what to do.
pub(crate) fn swing<P: Port + 'static>(port: P) -> Result<Outcome, Box<dyn Error>>
where
    WithReference<Remote<P>>: Leased,
{
    let opened = LiveSetpoints::of(MOTION, "pendulum", None, NamedFiles::none());
    let (mut setpoints, contents) = opened.map_err(|error| error.plain())?;
    let mut prepared = Prepared::new("pendulum".to_owned(), contents, None)?;

    // Proven, run on the emulated chip, and judged by its edges: nothing real has moved yet.
    let (sender, commands) = channel();
    let options = RunOptions { commands: Some(&commands), ..RunOptions::default() };
    let no_file = |_| None::<std::io::Result<std::io::Sink>>;
    let rehearsed = run(&mut prepared, &options, no_file, &mut StopsSoon(sender))?;
    println!("{}", rehearsed.report);

    // From here on the motors move under a lease: if the cable is pulled, they brake within their limits from its end.
    let proof = prepared.prove_first(|_| {})?;
    // The motion is endless: what comes later is proven while it runs.
    let driven = Driven::at(&prepared, port, Baud::B1M)?.proving(&prepared, proof.until_s)?;
    let step_line = driven.lines.iter().position(|line| line.names.iter().any(|name| name == "pendulum.step"));
    setpoints.set_up(&prepared.program);
    let live = LiveRun::new(driven, setpoints, true);
    let mut player = Player::new(live, Box::new(SaysGoodbye), PlayerOptions::default());
    let (mut commands, mut heard, mut edges) = (Commands::default(), Heard::default(), 0);
    let mut on_pins = |edge: Edge| edges += u64::from(Some(usize::from(edge.line)) == step_line);
    let speed = RunCommand::Set { knob: "speed".to_owned(), value: KnobValue::Text("2 Hz".to_owned()) };
    let mut script = VecDeque::from([(TURNED_S, speed), (STOPPED_S, RunCommand::Stop)]);
    let ended = loop {
        while let Some((_, command)) = script.pop_front_if(|(at_s, _)| *at_s <= heard.now_s) {
            commands.0.push_back(command.into());
        }
        // A hundredth of a second of the board's time.
        if let Some(ended) = player.step(&mut commands, &mut heard, &mut on_pins) {
            break ended?.ok_or("it was stopped before it began")?;
        }
    };
    let at_rest = motor_positions(&prepared.program, &ended.counted, &[]).remove(0);
    let rehearsal_passed = rehearsed.report.pass;
    Ok(Outcome { rehearsal_passed, events: heard.events, at_rest, counted: ended.counted[0], edges })
}

fn main() -> Result<(), Box<dyn Error>> {
    let outcome = match std::env::args().nth(1) {
        Some(port) => swing(Serial::open(&port, false)?)?,
        None => swing(VirtualUno::new())?,
    };
    let Outcome { rehearsal_passed, events, at_rest, counted, edges } = outcome;
    let passed = if rehearsal_passed { "passed" } else { "failed" };
    println!(
        "the rehearsal {passed}; {} events, {edges} edges; {at_rest}, {counted} steps from the start",
        events.len()
    );
    Ok(())
}
