//! Pauses and stops on the virtual Uno: the committed firmware on an emulated chip.

use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Board, Edge, Faults};
use pulsetrain_core::wire::Baud;
use pulsetrain_motion::program::{self, DriverTiming, Limits, Motor, Program, Scale, Tolerance};
use pulsetrain_motion::{Grid, Law, Time, boards};
use pulsetrain_session::Session;
use pulsetrain_session::drive::connect;

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
        driver: None,
    }
}

fn program(motors: Vec<Motor>) -> Program {
    let board = boards::find("uno").unwrap().limits();
    Program {
        board,
        grid: Grid::NEAREST,
        tolerance: Tolerance::Seconds(1e-6),
        idle_ms: None,
        motors,
        machines: Vec::new(),
        queue_parts: Vec::new(),
    }
}

#[test]
fn a_pause_on_the_chip_keeps_count_and_phase() {
    // On pins 9 and 10, which the compare hardware times.
    let sine = |a, period| Law::sine(a, Time::from_seconds(period), Some((3.0 / period) as u64)).unwrap();
    let program = program(vec![motor(9, 8, sine(150.0, 1.5)), motor(10, 7, sine(-100.0, 0.75))]);
    let run = |pauses: bool| {
        let mut edges = Vec::new();
        let mut observer = |edge: Edge| edges.push(edge);
        let mut session =
            Session::new(connect(VirtualUno::new(), &program, Baud::B1M).unwrap(), program.clone()).unwrap();
        let zero = session.zero();
        let mut at_speed = 0;
        if pauses {
            session.advance(zero + 12_000_000, &mut observer).unwrap();
            let rests = session.pause().unwrap();
            session.advance(rests + 8_000_000, &mut observer).unwrap();
            let counts: Vec<_> = (0..2).map(|motor| session.count_at(motor, rests).unwrap()).collect();
            assert_eq!(session.board().positions(), counts);
            at_speed = session.resume().unwrap();
        }
        let report = session.run(&mut observer, |_| {});
        assert_eq!((report.failure, &report.counted), (None, &report.replayed));
        assert_eq!(report.counted, [0, 0]);
        let steps = |pin: u8| {
            let rises = edges.iter().filter(move |edge| edge.line == pin && edge.level);
            rises.map(|edge| edge.tick.wrapping_sub(zero).cast_signed()).collect::<Vec<_>>()
        };
        (steps(9), steps(10), at_speed.wrapping_sub(zero).cast_signed())
    };
    let (first, second, _) = run(false);
    let (first_paused, second_paused, at_speed) = run(true);
    assert_eq!((first_paused.len(), second_paused.len()), (first.len(), second.len()));
    let late = first_paused[first.len() - 1] - first[first.len() - 1];
    assert!(late > 8_000_000, "{late}");
    let pairs = first.iter().zip(&first_paused).chain(second.iter().zip(&second_paused));
    for (before, after) in pairs.filter(|(_, after)| **after > at_speed) {
        // Both are within a certificate of 16 ticks, and these pins are never late.
        assert!((after - before - late).abs() <= 36, "{} and not {late} late", after - before);
    }
}

/// Tails have records that nothing else has, which slow a motor down. Most runs never play them.
#[test]
fn a_stop_on_the_chip_is_the_tail_that_was_planned() {
    let law = Law::sine(2000.0, Time::from_seconds(10.0), Some(1)).unwrap();
    let mut program = program(vec![motor(8, 9, law)]);
    program.motors[0].limits.max_acceleration = Some(1000.0);
    for tenths in [4, 10, 17, 24] {
        let mut pulses = 0;
        let mut observer = |edge: Edge| pulses += i64::from(edge.line == 8 && edge.level);
        let board = connect(VirtualUno::new(), &program, Baud::B1M).unwrap();
        let mut session = Session::new(board, program.clone()).unwrap();
        session.advance(session.zero() + tenths * 1_600_000, &mut observer).unwrap();
        session.stop().unwrap();
        let report = session.run(&mut observer, |_| {});
        assert_eq!((report.failure, &report.counted), (None, &report.replayed), "{tenths}");
        assert_eq!(report.faults, [Faults::default()], "{tenths}");
        assert_eq!(report.counted, [pulses], "{tenths}");
        assert!(pulses > 20, "{pulses}");
    }
}
