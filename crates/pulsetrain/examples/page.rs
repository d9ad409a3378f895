//! The page in the browser for motors of another kind: it speaks commands and events, and whatever makes the events can stand behind it.
//!
//! Here nothing moves: two motors of a machine are worked out. `cargo run -p pulsetrain --example page` prints the address; a number
//! behind it is the port (0: a free one). The run ends by a stop in the page.
#![allow(clippy::disallowed_methods, reason = "pictures may differ in the last digit")]

use std::collections::VecDeque;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::Path;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

use pulsetrain::control_socket::{Hub, run_info};
use pulsetrain::live::{Ending, KnobInfo, KnobValue, RunCommand, RunEnded, RunEvent};
use pulsetrain::motion::file;
use pulsetrain::page::{self, PageOptions};
use pulsetrain::session::control::{MotorStatus, Status};

/// The file that the page shows. Its motors and its machine are those that are played.
const FILE: &str = r#"board = "uno"

[motor.x]
steps_per_rev = 200
microsteps = 16
lead = "40 mm"
pins = { step = 8, dir = 9 }
pulse_high = "2 us"
forward = "high"
max_speed = "200 mm/s"
max_acceleration = "2000 mm/s^2"

[motor.y]
steps_per_rev = 200
microsteps = 16
lead = "40 mm"
pins = { step = 10, dir = 11 }
pulse_high = "2 us"
forward = "high"
max_speed = "200 mm/s"
max_acceleration = "2000 mm/s^2"

[[motion]]
motor = "x"
law.sine = { amplitude = "30 mm", frequency = "0.5 Hz", cycles = "forever" }

[[motion]]
motor = "y"
law.sine = { amplitude = "30 mm", frequency = "0.75 Hz", cycles = "forever" }
"#;

/// Between two statuses.
const STEP_S: f64 = 0.05;
/// How long a change takes.
const EASE_S: f64 = 1.0;

fn knob(name: &str, unit: &str, least: f64, greatest: f64, value: f64) -> KnobInfo {
    let (name, unit) = (name.to_owned(), unit.to_owned());
    KnobInfo { target: name.clone(), name, unit, least: Some(least), greatest: Some(greatest), value }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let port: u16 = std::env::args().nth(1).map_or(Ok(page::USUAL_PORT), |port| port.parse())?;
    let no_other_file = |_: &Path| Err(std::io::ErrorKind::NotFound.into());
    let program = file::read(FILE, "figure.toml", &no_other_file).map_err(|error| error.plain())?;
    let mut info = run_info("figure.toml", &program, None, false);
    info.is_live = true;
    info.cues = ["dawn", "noon", "dusk"].map(str::to_owned).into();
    info.knobs = vec![
        knob("x.amplitude", "mm", 0.0, 60.0, 30.0),
        knob("y.amplitude", "mm", 0.0, 60.0, 30.0),
        knob("x.frequency", "Hz", 0.05, 1.0, 0.5),
        knob("y.frequency", "Hz", 0.05, 1.0, 0.75),
    ];
    let max_speed: Vec<f64> = info.motors.iter().filter_map(|motor| motor.max_speed).collect();
    let steps_per_unit: Vec<f64> = info.motors.iter().map(|motor| motor.steps_per_unit).collect();
    let (sender, batches) = channel();
    let hub = Hub::of_live(info, sender);
    let (listener, token) = page::listen(SocketAddr::from((Ipv4Addr::LOCALHOST, port)))?;
    let options = PageOptions { token, ..PageOptions::default() };
    let text = options.motion.clone();
    FILE.clone_into(&mut text.lock().expect("no other thread has failed"));
    let page = page::serve(&hub, listener, options)?;
    println!("{}", page.url());

    let (mut at_s, mut phase) = (0.0, [0.0; 2]);
    // Wanted values, and those that the motors have reached.
    let (mut rate, mut rate_now) = (1.0, 1.0);
    let mut now: Vec<f64> = hub.info().knobs.iter().map(|knob| knob.value).collect();
    let (mut paused, mut cue) = (false, 0);
    let mut braking = None;
    let mut waiting = VecDeque::new();
    loop {
        let (from_s, until_s) = (at_s, at_s + EASE_S);
        if waiting.is_empty() {
            match batches.recv_timeout(Duration::from_millis(50)) {
                Ok(batch) => waiting.extend(batch.commands),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
        }
        match waiting.pop_front() {
            Some(command) => match command {
                RunCommand::Pause => {
                    paused = true;
                    hub.publish(&RunEvent::Pausing { rests_s: until_s });
                }
                RunCommand::Resume if paused => {
                    paused = false;
                    hub.publish(&RunEvent::Resuming { full_speed_s: until_s });
                }
                RunCommand::Resume => {
                    hub.publish(&RunEvent::Refused { command, why: "it is not paused".to_owned() });
                }
                RunCommand::Tempo { rate: wanted } => {
                    rate = wanted.clamp(0.01, 2.0);
                    let ceiling = (rate < wanted).then(|| "x: max_speed 200 mm/s".to_owned());
                    hub.publish(&RunEvent::Tempo { rate, from_s: until_s, ceiling });
                }
                RunCommand::Stop => {
                    braking = Some(until_s);
                    rate = 0.0;
                    hub.publish(&RunEvent::Stopping { at_s });
                }
                RunCommand::StopNow => {
                    hub.publish(&RunEvent::StoppedAtOnce { positions: vec![0; 2], uncertain: vec![true; 2] });
                    break;
                }
                RunCommand::Set { knob, value } => set(&hub, knob, value, (from_s, until_s)),
                RunCommand::Go | RunCommand::Back | RunCommand::Cue { .. } => {
                    let names = hub.info().cues;
                    cue = match &command {
                        RunCommand::Go => (cue + 1) % names.len(),
                        RunCommand::Back => (cue + names.len() - 1) % names.len(),
                        _ => names
                            .iter()
                            .position(|name| command == RunCommand::Cue { name: name.clone() })
                            .unwrap_or(cue),
                    };
                    hub.publish(&RunEvent::Cue { name: names[cue].clone(), from_s, until_s });
                }
                RunCommand::Goto { position } => hub.publish(&RunEvent::Goto { position, from_s, until_s }),
                RunCommand::Motion { text: changed, .. } => match file::read(&changed, "figure.toml", &no_other_file) {
                    Ok(_) => {
                        *text.lock().expect("no other thread has failed") = changed;
                        hub.publish(&RunEvent::Motion { from_s, until_s });
                    }
                    Err(error) => {
                        let at = error.problems().first().map(|problem| problem.place());
                        let number = |at: Option<usize>| at.and_then(|at| u32::try_from(at).ok());
                        let (line, column) = (number(at.map(|at| at.0)), number(at.map(|at| at.1)));
                        let error = error.problems().first().map_or("", |problem| problem.message()).to_owned();
                        hub.publish(&RunEvent::MotionRefused { error, line, column });
                    }
                },
                command @ (RunCommand::Begin | RunCommand::Rest { .. } | RunCommand::Here { .. }) => {
                    hub.publish(&RunEvent::Refused {
                        command,
                        why: "this example has no schedule and no board".to_owned(),
                    });
                }
            },
            None => {
                let ease = |now: &mut f64, wanted: f64| *now += (wanted - *now) * STEP_S * 4.0 / EASE_S;
                ease(&mut rate_now, if paused { 0.0 } else { rate });
                now.iter_mut().zip(&hub.info().knobs).for_each(|(now, knob)| ease(now, knob.value));
                at_s += STEP_S;
                let motors = [0, 1].map(|motor| {
                    let omega = now[motor + 2] * rate_now * std::f64::consts::TAU;
                    phase[motor] += omega * STEP_S;
                    let amplitude = now[motor] * steps_per_unit[motor];
                    let target = amplitude * phase[motor].sin();
                    let speed = (amplitude * phase[motor].cos() * omega).clamp(-max_speed[motor], max_speed[motor]);
                    let queue = (20 + (at_s * 7.0) as usize % 30, 128);
                    let (target_now, speed) =
                        if braking.is_some() { (None, None) } else { (Some(target), Some(speed)) };
                    MotorStatus { position: target.round() as i64, target: target_now, speed, queue }
                });
                let lease_s = Some(0.4 + 0.05 * (at_s * 3.0).sin());
                hub.publish(&RunEvent::Status(Status { at_s, lease_s, motors: motors.into(), lateness: None }));
                if braking.is_some_and(|until_s| at_s > until_s) {
                    break;
                }
            }
        }
    }
    hub.end(&RunEnded { ended: Ending::Stopped, why: None, motors: Vec::new(), way_back: None, moved: true });
    Ok(())
}

fn set(hub: &Hub, name: String, value: KnobValue, (from_s, until_s): (f64, f64)) {
    let command = RunCommand::Set { knob: name.clone(), value: value.clone() };
    let Some(knob) = hub.info().knobs.into_iter().find(|knob| knob.name == name) else {
        return hub.publish(&RunEvent::Refused { command, why: format!("there is no knob {name}") });
    };
    let KnobValue::Number(wanted) = value else {
        return hub.publish(&RunEvent::Refused { command, why: "this example knows bare numbers alone".to_owned() });
    };
    // As a limit of a motor would be.
    let value = wanted.clamp(knob.least.unwrap_or(f64::MIN), 0.9 * knob.greatest.unwrap_or(f64::MAX));
    let ceiling =
        (value < wanted).then(|| format!("{}: max_speed 200 mm/s", name.split('.').next().unwrap_or_default()));
    hub.publish(&RunEvent::Set { knob: name, value, unit: knob.unit, ceiling, from_s, until_s });
}
