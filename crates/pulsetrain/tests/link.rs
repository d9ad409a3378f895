//! Sessions over the link: to a model board, by a line that has faults.

use pulsetrain::session::{Session, SessionError};
use pulsetrain_board::faulty::{Faulty, Rates};
use pulsetrain_board::model::ModelPort;
use pulsetrain_board::{Board, Edge, Remote, Setup, SwitchRefused};
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::MotorSetup;
use pulsetrain_motion::program::{self, DriverTiming, Limits, Motor, Program, Scale, Tolerance};
use pulsetrain_motion::{Grid, Law, Time};
use std::time::Duration;

const TICK_HZ: u64 = 16_000_000;
const TIMING: DriverTiming =
    DriverTiming { pulse_high_ns: 1000, pulse_low_ns: 1000, dir_setup_ns: 500, dir_hold_ns: 500 };

/// STEP of motor m is line m, DIR line 16 + m.
fn motor(index: u8, law: Law) -> Motor {
    Motor {
        name: format!("m{index}"),
        law,
        wiring: program::Wiring::StepDir { step: index, dir: 16 + index, forward_high: true, enable: None },
        timing: TIMING,
        limits: Limits { max_speed: None, max_acceleration: Some(100_000.0), pull_in: 100.0 },
        scale: Scale { unit: "rev".into(), steps_per_unit: 200.0, steps_per_rev: 200.0 },
        winding: None,
    }
}

/// Two motors for three seconds, up to 1900 steps/s.
fn two_sines() -> Program {
    let law = |amplitude, seconds, cycles| Law::sine(amplitude, Time::from_seconds(seconds), Some(cycles)).unwrap();
    let board = program::Board {
        name: "model".into(),
        tick_hz: TICK_HZ,
        fraction_bits: 16,
        max_motors: 4,
        min_interval_ticks: vec![160],
        hardware_timed: true,
        source: "test".into(),
    };
    let motors = vec![motor(0, law(300.0, 1.0, 3)), motor(1, law(-200.0, 1.5, 2))];
    Program { board, grid: Grid::NEAREST, tolerance: Tolerance::Ticks(1.0), motors }
}

fn setup(motors: u8) -> Setup {
    let motor = |index| MotorSetup {
        step_pin: index,
        dir_pin: 16 + index,
        forward_high: true,
        pull_in_ticks: 160_000,
        ..MotorSetup::default()
    };
    Setup { pulse_ticks: 16, setup_ticks: 8, motors: (0..motors).map(motor).collect(), ..Setup::default() }
}

type Line = Faulty<ModelPort>;

/// A model that is ready to move.
fn connect(baud: Baud, seed: u64) -> Remote<Line> {
    let mut remote = Remote::open(Faulty::new(ModelPort::new(), seed), 7).unwrap();
    assert_eq!(remote.set_baud(baud), Ok(baud));
    remote.configure(&setup(2)).unwrap();
    remote
}

/// All edges of a run, from the moment at which the faults begin.
struct Run {
    zero: u64,
    edges: Vec<Edge>,
    counted: Vec<i64>,
    replayed: Vec<i64>,
    failure: Option<SessionError>,
}

/// Runs the program; `trouble` may do to the line what it likes, every 0.1 s.
fn run(baud: Baud, seed: u64, mut trouble: impl FnMut(u32, &mut Line)) -> Run {
    let program = two_sines();
    let mut session = Session::new(connect(baud, seed), &program).unwrap();
    let mut edges = Vec::new();
    let mut observer = |edge: Edge| edges.push(edge);
    let mut failure = None;
    for round in 0..29 {
        trouble(round, session.board_mut().port_mut());
        let until = session.zero() + u64::from(round + 1) * TICK_HZ / 10;
        failure = failure.or(session.advance(until, &mut observer).err());
    }
    let report = session.run(&mut observer, |_| {});
    assert_eq!(session.board().port().inner().positions(), report.counted, "what the board says is what it counted");
    let (counted, replayed) = (report.counted, report.replayed);
    Run { zero: report.zero, edges, counted, replayed, failure: failure.or(report.failure) }
}

/// Pulses of each motor, by its DIR line.
fn pulses(edges: &[Edge]) -> Vec<i64> {
    let mut counts = vec![0; 2];
    let mut forward = [false; 2];
    for edge in edges {
        match edge.line {
            line @ 0..2 if edge.level => counts[usize::from(line)] += if forward[usize::from(line)] { 1 } else { -1 },
            line @ 16..18 => forward[usize::from(line - 16)] = edge.level,
            _ => {}
        }
    }
    counts
}

#[test]
fn at_every_rate_a_session_over_the_link_makes_the_same_edges() {
    let clean = run(Baud::B1M, 1, |_, _| {});
    assert_eq!(clean.failure, None);
    assert_eq!(clean.counted, [0, 0]);
    assert_eq!(clean.counted, clean.replayed);
    assert_eq!(pulses(&clean.edges), clean.counted);
    // Two edges a step, and those of DIR.
    assert!(clean.edges.len() > 2 * (3 * 1200 + 2 * 800), "{} edges", clean.edges.len());
    let from_zero = |run: &Run| -> Vec<_> { run.edges.iter().map(|e| (e.tick - run.zero, e.line, e.level)).collect() };
    for baud in Baud::ALL {
        let other = run(baud, 1, |_, _| {});
        assert_eq!(other.failure, None, "{baud:?}");
        assert!(from_zero(&other) == from_zero(&clean), "other edges at {baud:?}");
    }
}
