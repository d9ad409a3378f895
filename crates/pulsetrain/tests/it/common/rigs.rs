//! Random motions within the limits of a board and of its motors.

use super::uno::{COMPARE, PORT_B, Pins, SHIELD, TUTORIAL};
use pulsetrain_board::Edge;
use pulsetrain_motion::boards::{self, BoardProfile};
use pulsetrain_motion::program::{DriverTiming, Limits, Motor, Program, Scale, Tolerance, Wiring};
use pulsetrain_motion::{Grid, Law, Time};
use pulsetrain_session::prepare::Prepared;
use pulsetrain_testkit::Random;
use pulsetrain_testkit::limits::{Step, check_acceleration, check_last_step};
use std::f64::consts::TAU;

/// Highest rate of these motors, steps/s: an emulated Pico takes long for each step.
const FASTEST: f64 = 60e3;
/// Motors' limits are larger than their laws need by this factor.
const SPARE: f64 = 1.1;

/// Random motors with random laws, on `board`, which `plan` accepts: 0.7 s to 1.5 s long.
pub(crate) fn motion(board: &str, random: &mut Random) -> Prepared {
    let row = boards::find(board).expect("a board of the table");
    loop {
        let pins = pins(board, random);
        let slowest = random.pick(&[0.05, 0.3, 0.7]);
        let motors = pins.iter().enumerate().map(|(index, pins)| motor(index, *pins, slow_law(random)));
        let mut motors: Vec<Motor> = motors.collect();
        let fastest = f64::from(row.shortest_intervals(&motors)[motors.len() - 1]);
        let fastest = (row.tick_hz as f64 / fastest).min(FASTEST);
        for motor in &mut motors {
            let peak = fastest * (slowest + (0.85 - slowest) * random.fraction());
            (motor.law, motor.limits) = law(peak, random);
        }
        let mut prepared = prepared(row, motors);
        prepared.over_line(None);
        if prepared.plan(|_| {}).is_ok() {
            return prepared;
        }
    }
}

/// STEP and DIR of some motors.
fn pins(board: &str, random: &mut Random) -> Vec<(u8, u8)> {
    if board == "pico" {
        let motors = random.between(1, 7) as u8;
        return (0..motors).map(|motor| (2 + 2 * motor, 3 + 2 * motor)).collect();
    }
    let all: Pins = random.pick(&[TUTORIAL, COMPARE, PORT_B, SHIELD, SHIELD]);
    all[..random.between(1, all.len() as u64 + 1) as usize].to_vec()
}

/// A law whose fastest speed is `peak` steps/s, and limits that it keeps.
fn law(peak: f64, random: &mut Random) -> (Law, Limits) {
    let sign = random.pick(&[1.0, -1.0]);
    let delay = Time::from_seconds(0.2 * random.fraction());
    let (law, hardest) = if random.one_in(2) {
        let period = 0.3 + 0.5 * random.fraction();
        let cycles = (0.9 / period).ceil() as u64;
        let amplitude = sign * peak * period / TAU;
        (Law::sine(amplitude, Time::from_seconds(period), Some(cycles)), peak * TAU / period)
    } else {
        let up_s = 0.05 + 0.3 * random.fraction();
        let acceleration = peak / up_s;
        let flat_s = 0.6 * random.fraction();
        let there = Law::trapezoid(sign * peak * (up_s + flat_s), peak, acceleration, acceleration);
        let back = Law::trapezoid(-sign * 0.7 * peak * up_s, peak, acceleration, acceleration);
        (there.and_then(|there| Law::then(vec![there, back?])), acceleration)
    };
    let law = law.and_then(|law| law.delayed(delay)).expect("numbers within the limits of laws");
    let pull_in = random.pick(&[0.0, 50.0, 200.0]);
    // Without a limit a motor brakes as hard as its law has accelerated so far: the host sends the board new limits as
    // it goes.
    let max_acceleration = random.pick(&[Some(SPARE * hardest), Some(SPARE * hardest), None]);
    (law, Limits { max_speed: None, max_acceleration, pull_in })
}

fn slow_law(random: &mut Random) -> Law {
    law(100.0, random).0
}

/// Pulses, setup and hold that all firmware makes at its highest rates.
pub(crate) fn motor(index: usize, (step, dir): (u8, u8), law: Law) -> Motor {
    Motor {
        name: format!("m{index}"),
        law,
        wiring: Wiring::StepDir { step, dir, forward_high: true, enable: None },
        timing: DriverTiming { pulse_high_ns: 1000, pulse_low_ns: 1000, dir_setup_ns: 1000, dir_hold_ns: 1000 },
        limits: Limits { max_speed: None, max_acceleration: None, pull_in: 1000.0 },
        scale: Scale { unit: "step".to_owned(), steps_per_unit: 1.0, steps_per_rev: 3200.0 },
        winding: None,
        driver: None,
    }
}

/// Motors on a board, with a tolerance of 1 µs.
pub(crate) fn prepared(row: &'static BoardProfile, motors: Vec<Motor>) -> Prepared {
    let mut board = row.limits();
    (board.min_interval_ticks, board.turn_ticks) = (row.shortest_intervals(&motors), row.turn_ticks(&motors));
    let program = Program {
        board,
        grid: Grid::NEAREST,
        tolerance: Tolerance::Seconds(1e-6),
        idle_ms: None,
        motors,
        machines: Vec::new(),
        queue_parts: Vec::new(),
    };
    Prepared {
        file: "a motion".to_owned(),
        program,
        cut: None,
        pause: None,
        line: None,
        tables: Vec::new(),
        recordings: Vec::new(),
    }
}

/// Each motor's steps, as its driver sees them.
pub(crate) fn steps(program: &Program, edges: &[Edge]) -> Vec<Vec<Step>> {
    let of = |motor: &Motor| {
        let Wiring::StepDir { step, dir, forward_high, .. } = motor.wiring else { return Vec::new() };
        let way = |level| if level == forward_high { 1 } else { -1 };
        let mut sign = way(false);
        let mut steps = Vec::new();
        for edge in edges {
            if edge.line == dir {
                sign = way(edge.level);
            } else if edge.line == step && edge.level {
                steps.push((edge.tick, sign));
            }
        }
        steps
    };
    program.motors.iter().map(of).collect()
}

/// Steps forward less steps backward.
pub(crate) fn counts(steps: &[Vec<Step>]) -> Vec<i64> {
    steps.iter().map(|steps| steps.iter().map(|(_, sign)| sign).sum()).collect()
}

/// Checks that all motors keep their limits and come to rest within them. Edges may be `late` ticks late.
///
/// # Errors
/// The first motor that does not, and how.
pub(crate) fn check_limits(program: &Program, steps: &[Vec<Step>], late: f64) -> Result<(), String> {
    for (motor, steps) in program.motors.iter().zip(steps) {
        let Limits { max_acceleration: Some(limit), pull_in, .. } = motor.limits else { continue };
        let hz = program.board.tick_hz;
        // The plan itself may be off by its tolerance.
        let doubt = late + 1e-6 * hz as f64;
        check_acceleration(steps, hz, limit, doubt)
            .and_then(|()| check_last_step(steps, hz, limit, pull_in))
            .map_err(|why| format!("{}: {why}", motor.name))?;
    }
    Ok(())
}
