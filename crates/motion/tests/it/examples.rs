//! The example files say what the articles and sketches do that they are from, with those' own numbers.

use std::path::{Path, PathBuf};

use pulsetrain_motion::law::Cursor;
use pulsetrain_motion::program::{Program, Tolerance, Wiring};
use pulsetrain_motion::{Grid, Time, boards, file};

fn examples() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples")
}

#[track_caller]
fn load(name: &str) -> Program {
    file::load(&examples().join(name)).unwrap_or_else(|error| panic!("{}", error.plain()))
}

/// θ of a motor at a time, steps.
fn position(program: &Program, motor: usize, at_s: f64) -> f64 {
    Cursor::new(&program.motors[motor].law).at(Time::from_seconds(at_s)).unwrap().position
}

#[test]
fn every_example_is_read() {
    let mut count = 0;
    for entry in std::fs::read_dir(examples()).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "toml") {
            let text = std::fs::read_to_string(&path).unwrap();
            assert!(text.starts_with("# "), "{} does not open with a comment", path.display());
            for motor in load(path.file_name().unwrap().to_str().unwrap()).motors {
                // Endless ones for a while.
                let broken = motor.law.pieces().take(10_000).find_map(Result::err);
                assert_eq!(broken, None, "{}, motor {}", path.display(), motor.name);
            }
            count += 1;
        }
    }
    assert!(count >= 15, "{count} examples");
}

#[track_caller]
fn check_tutorial(name: &str, period: Time, cycles: u64, pulse_high_ns: u32, (step, dir): (u8, u8)) {
    let program = load(name);
    let motor = &program.motors[0];
    assert_eq!(
        (program.board.name.as_str(), program.grid, program.tolerance),
        ("uno", Grid::REACH, Tolerance::Ticks(1.0))
    );
    assert_eq!(motor.wiring, Wiring::StepDir { step, dir, forward_high: false, enable: None });
    assert_eq!(motor.timing.pulse_high_ns, pulse_high_ns);
    assert_eq!(motor.law.end(), Some(period.times(cycles)));
    assert_eq!(motor.scale.steps_per_rev, 800.0);
    assert_eq!((motor.scale.unit.as_str(), motor.scale.steps_per_unit), ("rev", 800.0));
    let half = period.seconds() / 2.0;
    assert!((position(&program, 0, half) - 4000.0).abs() < 1e-9);
}

#[test]
fn the_tutorial_and_its_variants() {
    check_tutorial("tutorial.toml", Time::SECOND, 1, 10_000, (8, 9));
    check_tutorial("tutorial-500s.toml", Time::from_ratio(500, 1), 1, 10_000, (8, 9));
    check_tutorial("tutorial-10s.toml", Time::from_ratio(10, 1), 1, 10_000, (8, 9));
    check_tutorial("tutorial-3s.toml", Time::from_ratio(3, 1), 1, 10_000, (8, 9));
    check_tutorial("tutorial-1.5s.toml", Time::from_ratio(3, 2), 10, 10_000, (8, 9));
    check_tutorial("tutorial-0.8s.toml", Time::from_ratio(4, 5), 1, 10_000, (8, 9));
    check_tutorial("tutorial-0.1s.toml", Time::from_ratio(1, 10), 1, 1_900, (9, 8));
    check_tutorial("tutorial-0.01s.toml", Time::from_ratio(1, 100), 1, 200, (8, 9));
}

#[test]
fn the_tutorial_runs_on_the_native_board_too() {
    let program = load("tutorial-0.01s.toml").with_board(boards::find("native").unwrap().limits()).unwrap();
    assert_eq!((program.board.tick_hz, program.tolerance), (125_000_000, Tolerance::Ticks(1.0)));
}

#[test]
fn the_sweep_shares_its_dir_line_and_starts_after_100_ms() {
    let program = load("sweep.toml");
    for (motor, (pin, swing, frequency)) in
        program.motors.iter().zip([(9, 200.0, 0.5), (10, 100.0, 1.0), (11, 50.0, 2.0), (12, 25.0, 4.0)])
    {
        assert_eq!(motor.wiring, Wiring::StepDir { step: pin, dir: 8, forward_high: false, enable: None });
        assert_eq!((motor.timing.pulse_high_ns, motor.law.end()), (2_000, None));
        let mut cursor = Cursor::new(&motor.law);
        let mut at = |seconds: f64| cursor.at(Time::from_seconds(seconds)).unwrap().position;
        assert!(at(0.1).abs() < 1e-9);
        assert!((at(0.1 + 0.5 / frequency) - swing).abs() < 1e-9);
        assert!(at(0.1 + 100.0 / frequency).abs() < 1e-6);
    }
}

#[test]
fn sweep_phases_are_delays_modulo_the_period() {
    let program = load("sweep-phases.toml");
    let tops = [(200.0, 0.0, 2.0), (100.0, 0.25, 1.0), (50.0, 0.125, 0.5), (25.0, 0.05, 0.25)];
    for (motor, (swing, phase, period)) in tops.into_iter().enumerate() {
        assert!(position(&program, motor, 0.1 + phase).abs() < 1e-9);
        assert!((position(&program, motor, 0.1 + phase + period / 2.0) - swing).abs() < 1e-9);
    }
}

#[test]
fn the_fastest_motor_turns_once_waits_and_turns_back() {
    let program = load("max-speed.toml");
    let motor = &program.motors[0];
    assert_eq!(motor.wiring, Wiring::StepDir { step: 6, dir: 7, forward_high: true, enable: None });
    assert!((motor.limits.max_speed.unwrap() - 1.0 / 140.625e-6).abs() < 1e-6);
    assert!((motor.winding.unwrap().full_step_s() - 1.125e-3).abs() < 1e-15);
    // Up to what the winding allows, and down again, both at max_acceleration.
    let (speed, acceleration) = (1.0 / 140.625e-6, 50.0 * 1600.0);
    let takes_s = 1600.0 / speed + speed / acceleration;
    assert_eq!(position(&program, 0, 1.0), 0.0);
    assert!(position(&program, 0, 1.0 + 0.999 * takes_s) < 1600.0 - 1e-3);
    assert!((position(&program, 0, 1.0 + takes_s) - 1600.0).abs() < 1e-9);
    assert!(position(&program, 0, 2.0 * (1.0 + takes_s)).abs() < 1e-6);
    assert!(motor.law.end().is_none());
}

/// x against y, once it is at speed: a quarter of a period apart is a circle, twice the frequency would be a parabola.
#[test]
fn the_picos_two_coils_draw_a_circle() {
    let program = load("pico.toml");
    let end = program.motors[1].law.end().unwrap().seconds();
    assert_eq!((program.motors[2].law.end().unwrap().seconds(), end), (end, 8.5));
    for k in 0..=200 {
        let at_s = end * f64::from(k) / 200.0;
        let [x, y, _] = tip(&program, at_s);
        assert!((x.hypot(y) - 1.0).abs() < 1e-6, "({x}, {y}) mm at {at_s} s");
    }
    let mut cursors: Vec<Cursor> = program.motors[1..].iter().map(|motor| Cursor::new(&motor.law)).collect();
    let mut speeds = |at_s| -> Vec<f64> {
        cursors.iter_mut().map(|cursor| cursor.at(Time::from_seconds(at_s)).unwrap().speed.abs()).collect()
    };
    for at_s in [0.0, end - 1e-9] {
        assert!(speeds(at_s).iter().all(|speed| *speed < 1.0), "it rests at {at_s} s: {:?}", speeds(at_s));
    }
}

#[test]
fn the_winch_obeys_its_commands() {
    let program = load("winch.toml");
    assert_eq!(program.motors.len(), 4);
    let enable =
        |wiring: &Wiring| matches!(wiring, Wiring::StepDir { enable: Some((8, false)), forward_high: true, .. });
    assert!(program.motors.iter().all(|motor| enable(&motor.wiring)));
    // Critically damped at 2 Hz: within a step of the target after a second.
    for (motor, target) in [100.0, 120.0, -200.0, -50.0].into_iter().enumerate() {
        assert!((position(&program, motor, 1.0) - target).abs() < 1.0, "{motor}");
    }
}

#[test]
fn the_slide_goes_100_mm_and_back() {
    let program = load("s-curve.toml");
    assert_eq!((program.motors[0].scale.unit.as_str(), program.motors[0].scale.steps_per_unit), ("mm", 400.0));
    assert!((position(&program, 0, 3.9) - 40_000.0).abs() < 1e-6);
    assert!(position(&program, 0, 60.0).abs() < 1e-6);
}

#[test]
fn the_pendulum_dies_away() {
    let program = load("formula.toml");
    let wanted = |t: f64| 1600.0 * (-t / 4.0).exp() * (std::f64::consts::PI * t).sin().powi(2);
    for t in [0.0, 0.25, 0.5, 3.7, 9.5, 10.0] {
        assert!((position(&program, 0, t) - wanted(t)).abs() < 1e-6, "{t} s");
    }
    assert_eq!(program.motors[0].scale.unit, "deg");
}

#[test]
fn the_table_goes_through_its_points_five_times() {
    let program = load("table.toml");
    // 80 deg at 1.5 s: 80/360 of 3200 × 60/16 steps.
    let top = 80.0 / 360.0 * 12_000.0;
    for breath in 0..5 {
        assert!((position(&program, 0, f64::from(breath) * 5.0 + 1.5) - top).abs() < 1e-6);
    }
    assert_eq!(program.motors[0].law.end(), Some(Time::from_ratio(25, 1)));
}

#[test]
fn the_recording_is_smoothed_and_ends_where_it_ended() {
    let contents = file::load_contents(&examples().join("recording.toml")).unwrap();
    let smoothing = contents.tables[0].smoothing.as_ref().unwrap();
    assert_eq!((smoothing.over, smoothing.cut_off_hz), (Time::from_ratio(1, 20), 10.0));
    // A step of the converter is 0.26°.
    let distance = &smoothing.distances[0];
    assert!(distance.rms < 0.27 && distance.largest < 1.0, "{distance}");
    let law = &contents.program.motors[0].law;
    let csv = std::fs::read_to_string(examples().join("recording.csv")).unwrap();
    let last: f64 = csv.trim_end().rsplit(',').next().unwrap().parse().unwrap();
    let sample = Cursor::new(law).at(law.end().unwrap()).unwrap();
    assert!((sample.position - last / 360.0 * 3200.0).abs() < 1e-6 && sample.speed.abs() < 1e-6, "{sample:?}");
}

#[test]
fn the_manuals_examples_are_motion_files() {
    for manual in ["motion-files.md", "machines.md"] {
        let manual = std::fs::read_to_string(examples().join("../docs").join(manual)).unwrap();
        let blocks: Vec<&str> = manual.split("```toml\n").skip(1).filter_map(|rest| rest.split("```").next()).collect();
        assert!(!blocks.is_empty());
        for block in blocks {
            let named = |path: &Path| std::fs::read_to_string(examples().join(path));
            file::read(block, "manual.toml", &named).unwrap_or_else(|error| panic!("{}", error.plain()));
        }
    }
}

/// Where the first machine's tip is wanted.
fn tip(program: &Program, at_s: f64) -> [f64; 3] {
    let machine = &program.machines[0];
    let moved = |motor: &usize| position(program, *motor, at_s) - position(program, *motor, 0.0);
    machine.tip(&machine.motors.iter().map(moved).collect::<Vec<f64>>()).unwrap()
}

#[test]
fn the_sketch_draws_a_circle_twice_with_the_accumulators_period() {
    let program = load("circle.toml");
    let add = (4_294_967_296.0_f64 / (4.0 * 50.0)).round();
    let period = 4_294_967_296.0 / (add * 50.0);
    // Eased in and out, half a second each; then slack is given its time.
    let end = program.motors[0].law.end().unwrap().seconds();
    assert!((end - (2.0 * period + 0.5 + 0.04)).abs() < 1e-12, "{end} s");
    // Half a turn later: before x has turned round no slack is in it.
    let [x, _, _] = tip(&program, 0.25 + period / 2.0);
    assert!((x + 3.0).abs() < 1e-9, "{x} mm");
}

#[test]
fn the_robot_picks_places_and_comes_back() {
    let program = load("delta.toml");
    let end = program.motors[0].law.end().unwrap().seconds();
    for at_s in [0.0, end - 6.0, end] {
        let [x, y, z] = tip(&program, at_s);
        assert!(x.abs() < 1e-6 && y.abs() < 1e-6 && (z + 140.0).abs() < 1e-6, "({x}, {y}, {z}) at {at_s} s");
    }
    let [x, y, z] = tip(&program, end - 3.0);
    // The spiral is widest after 2 turns of its 4.
    assert!((x.hypot(y) - 40.0).abs() < 1e-6 && (z + 155.0).abs() < 1e-6, "({x}, {y}, {z})");
}
