//! `pulsetrain stop`: a board's motors stop at once, whoever told them.

use pulsetrain_board::{Port, Remote, RemoteError, Serial};
use serde::Serialize;

use super::info::{listed, motor_list};
use super::{drive_problem, port_problem};
use crate::cli::Stop;
use crate::console::{Console, Exit};
use crate::drive::session_number;
use crate::human;

/// How a board stopped, by its own word.
#[derive(Debug, Serialize)]
struct Stopped {
    /// Something moved, or was to.
    moved: bool,
    /// No step was begun after that, s of the board's clock.
    at_s: f64,
    /// Steps of each motor, forward minus backward.
    positions: Vec<i64>,
    /// Motors that may stand elsewhere: they were too fast for that.
    uncertain: Vec<usize>,
}

pub(crate) fn run(args: &Stop, console: &mut Console<'_>) -> miette::Result<Exit> {
    let port = Serial::open(&args.port, false).map_err(port_problem)?;
    let stopped = stop(port).map_err(|error| drive_problem(error.into()))?;
    if args.json {
        console.print_json(&stopped)?;
        return Ok(Exit::Success);
    }
    let Stopped { moved, at_s, positions, uncertain } = &stopped;
    let what = if *moved { "the motors were stopped at once" } else { "nothing moved" };
    let counted = if positions.is_empty() { "no motor is set up".to_owned() } else { listed(positions) };
    let at = human::seconds(*at_s);
    console.print(format_args!("{what}, {at} after the board began; steps counted: {counted}\n"))?;
    if !uncertain.is_empty() {
        console.print(format_args!(
            "too fast for that, so may stand elsewhere than counted: {}\n",
            motor_list(uncertain)
        ))?;
    }
    Ok(Exit::Success)
}

fn stop<P: Port>(port: P) -> Result<Stopped, RemoteError> {
    let mut board = Remote::open(port, session_number())?;
    let moved = !board.status()?.is_idle();
    let (stopped, positions) = board.stop_motors()?;
    let tick_hz = f64::from(board.info().tick_hz);
    board.close();
    let uncertain = (0..positions.len()).filter(|motor| stopped.uncertain >> motor & 1 == 1).collect();
    Ok(Stopped { moved, at_s: stopped.tick as f64 / tick_hz, positions, uncertain })
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
    use std::time::Duration;

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
