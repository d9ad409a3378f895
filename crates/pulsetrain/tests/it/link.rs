//! Sessions with a model board, over a line with faults.

use pulsetrain_board::{Board, Edge, Port, Remote, RemoteError};
use pulsetrain_core::RegisterWidths;
use pulsetrain_core::wire::message::Cause;
use pulsetrain_core::wire::{Baud, Reason};
use pulsetrain_motion::program::{self, DriverTiming, Limits, Motor, Program, Scale, Tolerance};
use pulsetrain_motion::{Grid, Law, Time, boards};
use pulsetrain_session::drive::connect_as;
use pulsetrain_session::{Session, SessionError};
use pulsetrain_testkit::faulty::{Faulty, Rates};
use pulsetrain_testkit::model::ModelPort;
use pulsetrain_testkit::seed::rounds;
use pulsetrain_testkit::{TICK_HZ, model_setup};
use std::time::Duration;

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
        driver: None,
    }
}

/// Two motors for three seconds, up to 1900 steps/s.
fn two_sines() -> Program {
    let law = |amplitude, seconds, cycles| Law::sine(amplitude, Time::from_seconds(seconds), Some(cycles)).unwrap();
    let board = program::BoardLimits {
        profile: &boards::NATIVE,
        name: "model".into(),
        tick_hz: TICK_HZ,
        registers: RegisterWidths::NARROW,
        max_motors: 4,
        min_interval_ticks: vec![160],
        hardware_timed: true,
        turn_ticks: 0,
        one_timing: false,
        shared_steps: None,
        segment_ticks: Vec::new(),
    };
    let motors = vec![motor(0, law(300.0, 1.0, 3)), motor(1, law(-200.0, 1.5, 2))];
    Program {
        board,
        grid: Grid::NEAREST,
        tolerance: Tolerance::Ticks(1.0),
        idle_ms: None,
        motors,
        machines: Vec::new(),
        queue_parts: Vec::new(),
    }
}

type Line = Faulty<ModelPort>;

/// A model with its motors set up.
fn connect(baud: Baud, seed: u64) -> Remote<Line> {
    let mut remote = Remote::open(Faulty::new(ModelPort::new(), seed), 7).unwrap();
    assert_eq!(remote.set_baud(baud), Ok(baud));
    remote.configure(&model_setup(2)).unwrap();
    remote
}

/// All edges of a run, from the first fault on.
struct Run {
    zero: u64,
    edges: Vec<Edge>,
    counted: Vec<i64>,
    replayed: Vec<i64>,
    failure: Option<SessionError>,
}

impl Run {
    fn since_zero(&self) -> Vec<(u64, u8, bool)> {
        self.edges.iter().map(|edge| (edge.tick - self.zero, edge.line, edge.level)).collect()
    }
}

/// Runs the program. Calls `trouble` every 0.1 s, which may change the line in any way.
fn run(baud: Baud, seed: u64, mut trouble: impl FnMut(u32, &mut Line)) -> Run {
    let program = two_sines();
    let mut session = Session::new(connect(baud, seed), program.clone()).unwrap();
    let mut edges = Vec::new();
    let mut observer = |edge: Edge| edges.push(edge);
    let mut failure = None;
    for round in 0..29 {
        trouble(round, session.board_mut().port_mut());
        let until = session.zero() + u64::from(round + 1) * TICK_HZ / 10;
        failure = failure.or(session.advance(until, &mut observer).err());
    }
    let report = session.run(&mut observer, |_| {});
    let counted = session.board().port().inner().positions();
    if session.board().error().is_none() {
        assert_eq!(report.counted, counted, "the board says what it counted");
    }
    let replayed = report.replayed;
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
    // Two edges for each step, and those of DIR.
    assert!(clean.edges.len() > 2 * (3 * 1200 + 2 * 800), "{} edges", clean.edges.len());
    for baud in Baud::ALL {
        let other = run(baud, 1, |_, _| {});
        assert_eq!(other.failure, None, "{baud:?}");
        assert!(other.since_zero() == clean.since_zero(), "other edges at {baud:?}");
    }
}

#[test]
fn with_50_ms_queued_no_fault_changes_an_edge() {
    let clean = run(Baud::B1M, 1, |_, _| {}).since_zero();
    let rates = Rates { drop: 20, flip: 20, delay: 20, duplicate: 20 };
    for seed in 1..=12 {
        let other = run(Baud::B1M, seed, |round, line| {
            line.set(rates);
            // In addition the line is silent for 30 ms.
            if round % 3 == 2 {
                line.cut(Duration::from_millis(30));
            }
        });
        println!("seed {seed}: {:?}", other.failure);
        assert_eq!(other.failure, None, "seed {seed}");
        assert!(other.since_zero() == clean, "seed {seed}: other edges");
        assert_eq!(other.counted, other.replayed, "seed {seed}");
    }
}

#[test]
fn what_lasts_longer_ends_in_a_stop() {
    let clean = run(Baud::B1M, 1, |_, _| {}).since_zero();
    for (seed, ms) in [(1, 600), (2, 1200), (3, 10_000)] {
        let other = run(Baud::B1M, seed, |round, line| {
            if round == 9 {
                line.cut(Duration::from_millis(ms));
            }
        });
        match other.failure {
            Some(SessionError::Stopped { .. }) if ms < 1900 => {}
            Some(SessionError::Lost(RemoteError::Link(_))) if ms > 1900 => {}
            failure => panic!("{ms} ms: {failure:?}"),
        }
        let made = other.since_zero();
        // As planned up to a tick, then a stop of the board's own, and rest for ever.
        let same = made.iter().zip(&clean).take_while(|(a, b)| a == b).count();
        assert!(same > 2000 && made.len() > same, "{ms} ms: {same} of {} edges as planned", made.len());
        assert_eq!(pulses(&other.edges), other.counted, "{ms} ms");
        if ms < 1000 {
            // The host has found the board again, so the steps are those that the host has sent.
            assert_eq!(other.counted, other.replayed, "{ms} ms");
        }
        let steps: Vec<u64> = made.iter().filter(|edge| edge.1 == 0 && edge.2).map(|edge| edge.0).collect();
        let [.., before, last] = steps[..] else { panic!("steps") };
        assert!(
            last - before > TICK_HZ / 1000,
            "{ms} ms: the last step comes {} ticks after the one before",
            last - before
        );
    }
}

#[test]
fn a_host_that_vanishes_leaves_motors_to_brake_and_the_board_to_the_next() {
    let program = two_sines();
    let mut session = Session::new(connect(Baud::B2M, 1), program.clone()).unwrap();
    let mut edges = Vec::new();
    session.advance(session.zero() + TICK_HZ, &mut |edge: Edge| edges.push(edge)).unwrap();
    let mut remote = session.into_board();
    let mut line = std::mem::replace(remote.port_mut(), Faulty::new(ModelPort::new(), 0));
    let model = line.inner_mut();
    assert!(model.is_taken());
    model.run_alone(4 * TICK_HZ);
    assert!(!model.is_taken());
    assert_eq!(model.board_baud(), Baud::B115200);
    model.edges(&mut edges);
    assert_eq!(pulses(&edges), model.positions());
    let positions = model.positions();
    assert_ne!(positions, [0, 0], "stopped on the way");

    line.set_baud(Baud::B115200).unwrap();
    let mut next = Remote::open(line, 8).unwrap();
    let status = next.status().unwrap();
    assert!(status.is_idle());
    let said: Vec<i64> = status.motors.as_slice().iter().map(|motor| i64::from(motor.position)).collect();
    assert_eq!(said, positions);
}

#[test]
fn a_board_that_refuses_to_go_on_says_why() {
    let program = two_sines();
    let mut session = Session::new(connect(Baud::B1M, 1), program.clone()).unwrap();
    let half = session.zero() + TICK_HZ / 2;
    session.advance(half, &mut |_: Edge| {}).unwrap();
    // As if another host had stopped it: it is not armed any more.
    session.board_mut().stop_now(0, &mut |_: Edge| {});
    let failure = session.advance(half + TICK_HZ, &mut |_: Edge| {}).unwrap_err();
    // The board's answer to more of the plan; or why it stopped, if it had reported that before.
    let said = matches!(
        failure,
        SessionError::Lost(
            RemoteError::Refused { reason: Reason::NotArmed, .. } | RemoteError::Stopped { cause: Cause::StopNow }
        )
    );
    assert!(said, "{failure:?}");
}

#[test]
fn an_immediate_stop_counts_right_and_must_be_armed_again() {
    let program = two_sines();
    let mut edges = Vec::new();
    let mut session = Session::new(connect(Baud::B1M, 1), program.clone()).unwrap();
    session.advance(session.zero() + TICK_HZ * 2 / 3, &mut |edge: Edge| edges.push(edge)).unwrap();
    let mut remote = session.into_board();
    remote.port_mut().set(Rates { drop: 300, flip: 100, delay: 100, duplicate: 300 });
    let report = remote.stop_now(0, &mut |edge: Edge| edges.push(edge));
    assert_eq!(remote.error(), None);
    assert_eq!(report.positions, pulses(&edges));
    assert_eq!(report.positions, remote.port().inner().positions());
    assert_eq!(report.uncertain, [true, true]);
    remote.port_mut().set(Rates::default());
    assert!(edges.iter().filter(|edge| edge.level && edge.line < 16).all(|edge| edge.tick <= report.tick));

    remote.arm().unwrap();
    assert!(remote.is_idle());
    let mut session = Session::new(remote, program.clone()).unwrap();
    let report = session.run(&mut |edge: Edge| edges.push(edge), |_| {});
    assert_eq!(report.failure, None);
    assert_eq!(report.counted, pulses(&edges));
}

/// Two motors that reverse and come to rest, on an Uno, for 1.3 s.
const THERE_AND_BACK: &str = r#"
board = "uno"

[motor.a]
steps_per_rev = 200
driver = "A4988"
pins = { step = 9, dir = 8 }
forward = "high"
max_acceleration = "10000 step/s^2"
pull_in = "100 step/s"
[motor.b]
steps_per_rev = 200
driver = "A4988"
pins = { step = 10, dir = 7 }
forward = "high"
max_acceleration = "10000 step/s^2"
pull_in = "100 step/s"

[[motion]]
motor = "a"
law.trapezoid = { distance = "500 step", speed = "800 step/s", acceleration = "9000 step/s^2" }
[[motion]]
motor = "a"
law.trapezoid = { distance = "-400 step", speed = "800 step/s", acceleration = "9000 step/s^2" }
[[motion]]
motor = "b"
start = "0.1 s"
law.trapezoid = { distance = "-600 step", speed = "600 step/s", acceleration = "5000 step/s^2" }
"#;

/// Runs it with queues of `pool` bytes in all. At a time after the session's beginning the line is silent for a time.
fn run_with_silence(program: &Program, pool: u16, from: Duration, lasts: Duration) -> Run {
    /// Bytes that an Uno can hold unread.
    const WINDOW: u16 = 127;
    let port = Faulty::new(ModelPort::with_memory(pool, WINDOW), 1);
    let mut session = Session::new(connect_as(port, program, Baud::B1M, 7).unwrap(), program.clone()).unwrap();
    let mut edges = Vec::new();
    let mut observer = |edge: Edge| edges.push(edge);
    let begins = session.board().now() + (from.as_secs_f64() * TICK_HZ as f64) as u64;
    let failure = session.advance(begins, &mut observer).err();
    session.board_mut().port_mut().cut(lasts);
    let report = session.run(&mut observer, |_| {});
    let counted = session.board().port().inner().positions();
    Run { zero: report.zero, edges, counted, replayed: report.replayed, failure: failure.or(report.failure) }
}

/// docs/faults.md has how long a silence may be with which queues.
#[test]
fn a_silence_of_100_ms_at_any_moment_changes_no_edge() {
    let no_files = |_: &std::path::Path| Err(std::io::ErrorKind::NotFound.into());
    let program = pulsetrain_motion::file::read(THERE_AND_BACK, "there and back", &no_files).unwrap();
    // An Uno's queues, and queues larger than the motion.
    for pool in [396, 8000] {
        let clean = run_with_silence(&program, pool, Duration::ZERO, Duration::ZERO);
        assert_eq!(clean.failure, None);
        assert_eq!(clean.counted, [100, -600]);
        let clean = clean.since_zero();
        // Soak, with four rounds, tries each moment.
        for ms in (0..1400).step_by((7 / rounds().min(7)) as usize) {
            let other = run_with_silence(&program, pool, Duration::from_millis(ms), Duration::from_millis(100));
            assert_eq!(other.failure, None, "{pool} bytes, {ms} ms");
            assert!(other.since_zero() == clean, "{pool} bytes, {ms} ms: other edges");
        }
    }
}
