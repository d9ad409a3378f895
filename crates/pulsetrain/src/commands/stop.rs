//! `pulsetrain stop`: a board's motors stop at once, whoever told them.

use std::io;
use std::time::Duration;

use pulsetrain_board::{LinkError, Port, Remote, RemoteError, Serial};
use pulsetrain_trace::winch::{AXES, Status};
use serde::Serialize;

use super::info::{UNO, listed, motor_list};
use super::{drive_problem, port_problem};
use crate::cli::Stop;
use crate::console::{Console, Exit};
use crate::drive::session_number;
use crate::human;
use crate::winch::console::{ConsoleError, Person, Wish, converse};
use crate::winch::talk::{Said, Talk};

/// How a board stopped, by its own word.
#[derive(Debug, Serialize)]
struct Stopped {
    /// Something moved, or was to.
    moved: bool,
    /// Opening the port has reset the board, which stops it, too.
    reset: bool,
    /// Text had its axes: those with paths stopped within their limits, those told directly at once.
    text: bool,
    /// No step was begun after that, s of the board's clock; of text the last that it told.
    at_s: f64,
    /// Steps of each motor, or of text's axes x, y, z and a: forward minus backward.
    positions: Vec<i64>,
    /// Motors that may stand elsewhere: they were too fast for that.
    uncertain: Vec<usize>,
}

pub(crate) fn run(args: &Stop, console: &mut Console<'_>) -> miette::Result<Exit> {
    let open = || Serial::open(&args.port, false).map_err(port_problem);
    let stopped = match stop(open()?) {
        Err(RemoteError::Link(LinkError::Taken)) => {
            let stopped = stop_text(&mut Talk::new(open()?)).map_err(|error| match error {
                ConsoleError::Port(error) => port_problem(error),
                error => error.into(),
            })?;
            stopped.ok_or(RemoteError::Link(LinkError::Taken))
        }
        other => other,
    };
    let stopped = stopped.map_err(|error| drive_problem(error.into()))?;
    if args.json {
        console.print_json(&stopped)?;
    } else {
        console.print(format_args!("{}\n", stopped.told()))?;
    }
    Ok(Exit::Success)
}

impl Stopped {
    /// In words.
    fn told(&self) -> String {
        let Stopped { moved, at_s, positions, uncertain, .. } = self;
        let at = human::seconds(*at_s);
        if self.text {
            let axes: Vec<String> = AXES.iter().zip(positions).map(|(axis, steps)| format!("{axis} {steps}")).collect();
            let what = if *moved { "they have stopped" } else { "none was seen to move" };
            return format!(
                "text had the axes; told `enable 0`, {what}, and the drivers are off; {at} after the board began they counted {}",
                axes.join(", ")
            );
        }
        if self.reset {
            return "opening the port has reset the Uno: what moved has stopped at once, and nobody knows where it stands".to_owned();
        }
        let what = if *moved { "the motors were stopped at once" } else { "nothing moved" };
        let counted = if positions.is_empty() { "no motor is set up".to_owned() } else { listed(positions) };
        let mut told = format!("{what}, {at} after the board began; steps counted: {counted}");
        if !uncertain.is_empty() {
            let motors = motor_list(uncertain);
            told.push_str(&format!("\ntoo fast for that, so may stand elsewhere than counted: {motors}"));
        }
        told
    }
}

fn stop<P: Port>(port: P) -> Result<Stopped, RemoteError> {
    let mut board = Remote::open(port, session_number())?;
    let moved = !board.status()?.is_idle();
    let (stopped, positions) = board.stop_motors()?;
    let tick_hz = f64::from(board.info().tick_hz);
    // One that does not begin anew as its port is opened still has its motors.
    let reset = board.info().board == UNO && !moved && positions.is_empty();
    board.close();
    let uncertain = (0..positions.len()).filter(|motor| stopped.uncertain >> motor & 1 == 1).collect();
    Ok(Stopped { moved, reset, text: false, at_s: stopped.tick as f64 / tick_hz, positions, uncertain })
}

/// Stops axes that text drives: frames are refused meanwhile. `None` if the board does not answer as text, or the axes did not come to
/// rest.
fn stop_text<P: Port>(talk: &mut Talk<P>) -> Result<Option<Stopped>, ConsoleError> {
    /// Statuses come each 0.2 s, if nobody has said otherwise.
    const STATUS: Duration = Duration::from_millis(500);
    // This learns, too, whether the board wants checksums.
    if talk.ask()?.is_none() {
        return Ok(None);
    }
    // Where axes are that are told directly, and whether they move, is lost as they stop.
    let mut seen = Seen::default();
    for _ in 0..2 {
        if let Some(status) = talk.status(STATUS)? {
            seen.show(&Said::Status(status))?;
        }
    }
    let ended = converse(talk, &mut seen)?;
    let Some(Status { usec, positions }) = seen.last.filter(|_| ended.is_settled && ended.refused == 0) else {
        return Ok(None);
    };
    Ok(Some(Stopped {
        moved: seen.moved,
        reset: false,
        text: true,
        at_s: usec as f64 * 1e-6,
        positions: positions.map(i64::from).to_vec(),
        uncertain: Vec::new(),
    }))
}

/// Whoever wants the axes stopped, and looks on.
#[derive(Debug, Default)]
struct Seen {
    has_told: bool,
    moved: bool,
    last: Option<Status>,
    /// The board said `awake`.
    is_awake: bool,
}

impl Person for Seen {
    fn wishes(&mut self) -> io::Result<Vec<Wish>> {
        let has_told = std::mem::replace(&mut self.has_told, true);
        Ok(if has_told { Vec::new() } else { vec![Wish::Stop, Wish::End] })
    }

    fn show(&mut self, said: &Said) -> io::Result<()> {
        match said {
            Said::Line(line) => self.is_awake |= line == "awake",
            // Behind verbs text begins anew, and counts from 0.
            Said::Status(status) if self.is_awake && self.last.is_some() && status.positions == [0; 4] => {}
            Said::Status(status) => {
                self.moved |= self.last.is_some_and(|last| last.positions != status.positions);
                self.last = Some(*status);
            }
        }
        Ok(())
    }

    fn tell(&mut self, _: &str) -> io::Result<()> {
        Ok(())
    }

    fn waits_for_rest(&self) -> bool {
        true
    }
}

#[cfg(test)]
mod tests {
    use super::super::info;
    use super::*;
    use pulsetrain_board::Setup;
    use pulsetrain_board::virtual_pico::VirtualPico;
    use pulsetrain_core::verbs::Verb;
    use pulsetrain_core::wire::Baud;
    use pulsetrain_core::wire::message::MotorSetup;

    /// A MOVE of a day that a host left behind: the next one is told, and may end it.
    #[test]
    fn what_a_host_left_behind_is_told_and_stopped() {
        let mut host = Remote::open(VirtualPico::on_usb(), 1).unwrap();
        let driver = MotorSetup { step_pin: 2, dir_pin: 3, pull_in_ticks: 1_250_000, ..MotorSetup::default() };
        host.configure(&Setup { pulse_ticks: 250, motors: vec![driver], ..Setup::default() }).unwrap();
        host.tell_motors(&[(0, Verb::Speed { ticks: 125_000 }), (0, Verb::Move { steps: 86_400_000 })]).unwrap();
        let mut lost = host.port().clone();
        let port = host.close();
        let said = info::ask(port.clone(), Baud::B1M).unwrap();
        assert_eq!(said.keeps(), "not told while motors are powered");
        assert!(said.moves && said.positions.len() == 1 && said.uncertain.is_empty(), "{said:?}");
        // It is stopped at 1000 steps/s, where 100 are sure.
        let Stopped { moved, positions, uncertain, .. } = stop(port).unwrap();
        assert!(moved && positions[0] > 0, "{positions:?}");
        assert_eq!(uncertain, [0]);
        // A host that falls silent leaves nothing that moves.
        let until = lost.now() + Duration::from_secs(3);
        while lost.now() < until {
            lost.receive(until, &mut Vec::new()).unwrap();
        }
        let said = info::ask(lost, Baud::B1M).unwrap();
        assert!(!said.moves, "{said:?}");
        assert_eq!(said.uncertain, [0]);
    }

    #[test]
    fn who_waits_for_rest_is_told_how_to_stop() {
        let waits = drive_problem(RemoteError::StillMoving.into());
        assert!(waits.help().is_some_and(|help| help.to_string().contains("pulsetrain stop --port PORT")));
    }
}
