//! Sessions on the virtual Uno: the committed firmware on an emulated chip.

use pulsetrain::session::Session;
use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Edge, Remote, Setup};
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::MotorSetup;
use pulsetrain_motion::program::{self, DriverTiming, Limits, Motor, Program, Scale, Tolerance};
use pulsetrain_motion::{Grid, Law, Time};

const TIMING: DriverTiming =
    DriverTiming { pulse_high_ns: 1000, pulse_low_ns: 1000, dir_setup_ns: 500, dir_hold_ns: 500 };

fn motor(step: u8, dir: u8, law: Law) -> Motor {
    Motor {
        name: format!("m{step}"),
        law,
        wiring: program::Wiring::StepDir { step, dir, forward_high: true, enable: None },
        timing: TIMING,
        limits: Limits { max_speed: None, max_acceleration: Some(100_000.0), pull_in: 100.0 },
        scale: Scale { unit: "rev".into(), steps_per_unit: 200.0, steps_per_rev: 200.0 },
        winding: None,
    }
}

fn program(motors: Vec<Motor>) -> Program {
    let board = pulsetrain_motion::boards::find("uno").unwrap().board;
    Program { board, grid: Grid::NEAREST, tolerance: Tolerance::Ticks(1.0), motors }
}

fn connect(program: &Program, baud: Baud) -> Remote<VirtualUno> {
    let mut remote = Remote::open(VirtualUno::new(), 7).unwrap();
    if baud != Baud::B115200 {
        assert_eq!(remote.set_baud(baud), Ok(baud));
    }
    let motors = program.motors.iter().map(|motor| {
        let program::Wiring::StepDir { step, dir, forward_high, .. } = motor.wiring else { unreachable!() };
        MotorSetup { step_pin: step, dir_pin: dir, forward_high, pull_in_ticks: 160_000, ..MotorSetup::default() }
    });
    let setup = Setup { pulse_ticks: 16, setup_ticks: 8, hold_ticks: 8, motors: motors.collect(), ..Setup::default() };
    remote.configure(&setup).unwrap();
    remote
}

#[test]
fn a_sine_on_pins_8_and_9() {
    let program = program(vec![motor(8, 9, Law::sine(100.0, Time::from_seconds(1.0), Some(1)).unwrap())]);
    let remote = connect(&program, Baud::B1M);
    eprintln!("{:?}", remote.info());
    let mut session = Session::new(remote, &program).unwrap();
    let mut edges = Vec::new();
    let report = session.run(&mut |edge: Edge| edges.push(edge), |_| {});
    eprintln!("{report:?}");
    let board = session.board_mut();
    let events = board.events();
    eprintln!("{:?} {events:?}", board.error());
    eprintln!("{:?}", board.measures(false));
    let rises: Vec<_> = edges.iter().filter(|e| e.line == 8 && e.level).collect();
    eprintln!("{} rises; first {:?}", rises.len(), &edges[..edges.len().min(12)]);
    assert_eq!(report.counted, [0]);
    assert_eq!(rises.len(), 400);
}
