//! Good traces pass; each mutant of one is caught.

use expect_test::{Expect, expect};
use proptest::prelude::*;
use pulsetrain_motion::law::{Class, Curve, Entry, Fixed, Piece, Sine, Steady};
use pulsetrain_motion::program::{
    BoardLimits, CoilSequence, DriverTiming, Limits, Motor, Program, Scale, SharedSteps, Tolerance, Wiring,
};
use pulsetrain_motion::{Grid, Law, Time, boards};
use std::sync::Arc;

use super::*;
use crate::camera::{AngleUnit, Frame, Track};
use crate::steps::Step;
use crate::{decode, lines, vcd_file};

const HZ: u64 = 16_000_000;
/// 10 µs, 5 µs, 5 µs in ticks of 16 MHz.
const PULSE: u64 = 160;
const SETUP: u64 = 80;
const HOLD: u64 = 80;

fn sine(amplitude: f64, period: Time, cycles: Option<u64>) -> Law {
    Law::Sine(Sine { amplitude, period, cycles })
}

fn motor(name: &str, law: Law, step: u8, dir: u8) -> Motor {
    Motor {
        name: name.into(),
        law,
        wiring: Wiring::StepDir { step, dir, forward_high: false, enable: None },
        timing: DriverTiming { pulse_high_ns: 10_000, pulse_low_ns: 10_000, dir_setup_ns: 5_000, dir_hold_ns: 5_000 },
        limits: Limits::default(),
        scale: Scale { unit: "rev".into(), steps_per_unit: 800.0, steps_per_rev: 800.0 },
        winding: None,
        driver: None,
    }
}

fn program(grid: Grid, motors: Vec<Motor>) -> Program {
    let board = BoardLimits {
        profile: &boards::UNO,
        name: "uno".into(),
        tick_hz: HZ,
        registers: boards::UNO.registers,
        max_motors: 4,
        min_interval_ticks: vec![320],
        hardware_timed: true,
        turn_ticks: 0,
        one_timing: false,
        shared_steps: None,
        segment_ticks: Vec::new(),
    };
    Program {
        board,
        grid,
        tolerance: Tolerance::Ticks(1.0),
        idle_ms: None,
        motors,
        machines: Vec::new(),
        queue_parts: Vec::new(),
    }
}

/// Steps of θ = A − A·cos(2πt/T) by its inverse, levels n − ½ + h: nothing of the judge's.
fn sine_steps(amplitude: u64, period_s: f64, cycles: u64, grid: Grid) -> Vec<(u64, bool)> {
    let h = grid.hysteresis;
    let a = amplitude as f64;
    let time = |level: f64| (1.0 - level / a).clamp(-1.0, 1.0).acos() / std::f64::consts::TAU * period_s;
    let mut steps = Vec::new();
    for cycle in 0..cycles {
        let begin = cycle as f64 * period_s;
        let tick = |t: f64| ((begin + t) * HZ as f64).round() as u64;
        steps.extend((1..=2 * amplitude).map(|n| (tick(time(n as f64 - 0.5 + h)), true)));
        steps.extend((0..2 * amplitude).rev().map(|n| (tick(period_s - time(n as f64 + 0.5 - h)), false)));
    }
    steps
}

/// Edges as an honest board makes them: DIR right before the step that needs it.
fn edges(steps: &[(u64, bool)], step_line: u8, dir_line: u8) -> Vec<Edge> {
    let mut dir = false;
    let mut edges = Vec::new();
    for &(tick, forward) in steps {
        // Forward is LOW.
        if dir == forward {
            dir = !forward;
            edges.push(Edge { tick: tick - SETUP, line: dir_line, level: dir });
        }
        edges.push(Edge { tick, line: step_line, level: true });
        edges.push(Edge { tick: tick + PULSE, line: step_line, level: false });
    }
    edges
}

fn tutorial() -> (Program, Trace) {
    let program = program(Grid::REACH, vec![motor("wheel", sine(2000.0, Time::from_seconds(3.0), Some(1)), 8, 9)]);
    let trace =
        Trace { tick_hz: HZ, lines: lines::of(&program), edges: edges(&sine_steps(2000, 3.0, 1, Grid::REACH), 0, 1) };
    (program, trace)
}

fn failures(report: &Report) -> String {
    report.failures.iter().map(|f| format!("{f}\n")).collect()
}

#[test]
fn the_tutorial_passes() {
    let (program, trace) = tutorial();
    let report = judge(&trace, &program, &Options::default()).unwrap();
    expect![[r#"
        wheel: 8000 of 8000 steps, at 0 (wanted 0); error max -0.500 ticks (-0.031 µs), rms 0.290, limit 1.00; drift +0.000 ppm; peak 4190 steps/s; HIGH 10.0 µs; LOW 228.7 µs; setup 5000 ns; hold 15.1 ms
        PASS"#]]
    .assert_eq(&report.to_string());
    let motor = &report.motors[0];
    assert!(report.ok);
    assert_eq!((motor.steps_wanted, motor.steps_got), (8000, 8000));
    // Steps are closest where it is fastest.
    assert!((motor.pulse_low.expect("there are pulses").at_s - 0.75).abs() < 0.02, "{:?}", motor.pulse_low);
    assert!(motor.max_error_ticks.abs() <= 0.5001);
    // Streaming gives the same.
    let mut streaming = EdgeJudge::new(HZ, &trace.lines, &program, &Options::default()).unwrap();
    trace.edges.iter().for_each(|edge| streaming.push(*edge).unwrap());
    assert_eq!(streaming.finish().unwrap(), report);
    // And so does the way over a VCD file.
    let mut file = Vec::new();
    vcd_file::write(&trace, &mut file).unwrap();
    assert_eq!(judge(&vcd_file::read(&file).unwrap(), &program, &Options::default()).unwrap(), report);
    // And, but for pulses and DIR, over steps.
    let steps = judge_steps(&decode::steps(&trace, &program).unwrap(), &program, &Options::default()).unwrap();
    assert_eq!(steps.motors[0].max_error_ticks, motor.max_error_ticks);
    assert!(steps.ok);
}

/// Index of the edge that is the rise of step n (from 1) in the tutorial's trace.
fn rise(trace: &Trace, n: usize) -> usize {
    trace.edges.iter().enumerate().filter(|(_, e)| e.line == 0 && e.level).nth(n - 1).unwrap().0
}

#[test]
fn mutants_are_caught() {
    let check = |mutate: &dyn Fn(&mut Trace), expected: Expect| {
        let (program, mut trace) = tutorial();
        mutate(&mut trace);
        trace.edges.sort_by_key(|e| e.tick);
        let report = judge(&trace, &program, &Options::default()).unwrap();
        assert!(!report.ok);
        expected.assert_eq(&failures(&report));
    };
    // A step dropped.
    check(
        &|trace| drop_step(trace, 1873),
        expect![[r#"
        motor wheel: step 1873 (forward) missing at t = 0.719661 s
        motor wheel: ends at -1 steps, wanted 0, at t = 3.000000 s
    "#]],
    );
    // The first, the last, and the one that touches the turning point.
    check(
        &|trace| {
            for n in [8000, 4000, 1] {
                drop_step(trace, n);
            }
        },
        expect![[r#"
            motor wheel: step 1 (forward) missing at t = 0.015099 s
            motor wheel: step 4000 (forward) missing at t = 1.500000 s
            motor wheel: step 8000 (backward) missing at t = 3.000000 s
            motor wheel: ends at -1 steps, wanted 0, at t = 2.984901 s
        "#]],
    );
    // A step added, half way.
    check(
        &|trace| {
            let tick = u64::midpoint(trace.edges[rise(trace, 100)].tick, trace.edges[rise(trace, 101)].tick);
            trace.edges.push(Edge { tick, line: 0, level: true });
            trace.edges.push(Edge { tick: tick + PULSE, line: 0, level: false });
        },
        expect![[r#"
            motor wheel: extra step (forward) after step 100 at t = 0.152005 s
            motor wheel: ends at 1 steps, wanted 0, at t = 3.000000 s
        "#]],
    );
    // Moved by the bound and one tick, late and early.
    check(
        &|trace| moved(trace, 500, 2),
        expect![[r#"
        motor wheel: step 500 is 2.05 ticks late, limit 1.00, at t = 0.345080 s
    "#]],
    );
    check(
        &|trace| moved(trace, 7000, -2),
        expect![[r#"
        motor wheel: step 7000 is 2.00 ticks early, limit 1.00, at t = 2.500000 s
    "#]],
    );
    // DIR late: after the step rose.
    check(
        &|trace| trace.edges.iter_mut().filter(|e| e.line == 1).for_each(|e| e.tick += SETUP + 1),
        expect![[r#"
            motor wheel: DIR hold 0.0 ns, needs 5000 ns, at t = 1.515099 s
            motor wheel: step 4001 goes forward at t = 1.515099 s
            motor wheel: ends at 2 steps, wanted 0, at t = 3.000000 s
        "#]],
    );
    // DIR setup one tick short; DIR hold short.
    check(
        &|trace| trace.edges.iter_mut().filter(|e| e.line == 1).for_each(|e| e.tick += 1),
        expect![[r#"
        motor wheel: DIR setup 4937.5 ns, needs 5000 ns, at t = 1.515099 s
    "#]],
    );
    check(
        &|trace| {
            let fall = trace.edges[rise(trace, 4000) + 1].tick;
            trace.edges.iter_mut().filter(|e| e.line == 1 && e.level).for_each(|e| e.tick = fall + HOLD - 1);
        },
        expect![[r#"
            motor wheel: DIR hold 4937.5 ns, needs 5000 ns, at t = 1.500015 s
        "#]],
    );
    // A pulse one tick short, HIGH; LOW.
    check(
        &|trace| {
            let fall = rise(trace, 3) + 1;
            trace.edges[fall].tick -= 1;
        },
        expect![[r#"
            motor wheel: STEP HIGH for 9937.5 ns, needs 10000 ns, at t = 0.026165 s
        "#]],
    );
    check(
        &|trace| {
            let fall = rise(trace, 2000) + 1;
            trace.edges[fall].tick = trace.edges[fall + 1].tick - PULSE + 1;
        },
        expect![[r#"
            motor wheel: STEP LOW for 9937.5 ns, needs 10000 ns, at t = 0.750239 s
        "#]],
    );
    // One step the wrong way.
    check(
        &|trace| {
            let tick = trace.edges[rise(trace, 1000)].tick;
            trace.edges.push(Edge { tick: tick - SETUP, line: 1, level: true });
            trace.edges.push(Edge { tick: tick + PULSE + HOLD, line: 1, level: false });
        },
        expect![[r#"
            motor wheel: step 1000 goes backward at t = 0.500000 s
            motor wheel: ends at -2 steps, wanted 0, at t = 3.000000 s
        "#]],
    );
}

fn drop_step(trace: &mut Trace, n: usize) {
    let rise = rise(trace, n);
    trace.edges.drain(rise..rise + 2);
}

fn moved(trace: &mut Trace, n: usize, ticks: i64) {
    let rise = rise(trace, n);
    for edge in &mut trace.edges[rise..rise + 2] {
        edge.tick = edge.tick.strict_add_signed(ticks);
    }
}

proptest! {
    /// Whatever step is dropped, doubled or moved beyond the bound, on either grid, the verdict is no.
    #[test]
    fn no_mutant_passes(
        amplitude in 2u64..300,
        nearest in any::<bool>(),
        cycles in 1u64..3,
        at in 0.0..1.0,
        mutant in 0..4,
        by in 2i64..1000,
    ) {
        let grid = if nearest { Grid::NEAREST } else { Grid::REACH };
        let law = sine(amplitude as f64, Time::SECOND, Some(cycles));
        let program = program(grid, vec![motor("wheel", law, 8, 9)]);
        let steps = sine_steps(amplitude, 1.0, cycles, grid);
        let made = |steps: &[(u64, bool)]| {
            let steps = steps.iter().map(|&(tick, forward)| Step { motor: 0, tick, forward }).collect();
            let trace = StepTrace { tick_hz: HZ, motors: vec!["wheel".into()], steps };
            judge_steps(&trace, &program, &Options::default()).unwrap()
        };
        let good = made(&steps);
        prop_assert!(good.ok, "{good}");
        let mut bad = steps.clone();
        let i = (at * steps.len() as f64) as usize;
        match mutant {
            0 => drop(bad.remove(i)),
            1 => bad.insert(i, bad[i]),
            2 => bad[i].1 = !bad[i].1,
            _ => {
                // Beyond what f64 leaves open right at a turning point, and in order.
                bad[i].0 += by as u64;
                bad.sort_by_key(|step| step.0);
            }
        }
        prop_assert!(!made(&bad).ok);
    }

    /// A capture that begins at any time, by a clock that is off, is laid over the law.
    #[test]
    fn alignment_finds_shift_and_rate(shift_s in 0.0..100.0f64, ppm in -5000.0..5000.0f64, dropped in 40usize..3000) {
        let (program, trace) = tutorial();
        let clock = 1.0 / (1.0 + ppm * 1e-6);
        let hz = 1_000_000_000u64;
        let mut steps = decode::steps(&trace, &program).unwrap();
        steps.tick_hz = hz;
        for step in &mut steps.steps {
            step.tick = ((step.tick as f64 / HZ as f64 * clock + shift_s) * hz as f64).round() as u64;
        }
        let options = Options { align: Align::StartAndRate, ..Options::default() };
        let report = judge_steps(&steps, &program, &options).unwrap();
        prop_assert!(report.ok, "{}", report);
        prop_assert!((report.alignment.shift_s - shift_s).abs() < 1e-7);
        prop_assert!((report.alignment.rate_ppm - ppm).abs() < 0.01, "{:?}", report.alignment);
        // One missing is still found where it is.
        steps.steps.remove(dropped);
        let report = judge_steps(&steps, &program, &options).unwrap();
        let missing = report.failures.iter().filter(|f| matches!(f.fault, Fault::Missing { .. })).map(|f| f.step);
        prop_assert_eq!(missing.collect::<Vec<_>>(), [dropped as u64 + 1]);
    }

    /// Any edges at all get a verdict or a reason.
    #[test]
    fn any_edges_are_judged(raw in proptest::collection::vec((0u64..50_000_000, 0u8..4, any::<bool>()), 0..200), align in 0..3) {
        let (program, mut trace) = tutorial();
        trace.edges = raw.into_iter().map(|(tick, line, level)| Edge { tick, line, level }).collect();
        let align = [Align::None, Align::Start, Align::StartAndRate][align as usize];
        let options = Options { align, ..Options::default() };
        prop_assert_eq!(judge(&trace, &program, &options).is_ok(), trace.edges.is_sorted_by_key(|e| e.tick));
        trace.edges.sort_by_key(|e| e.tick);
        prop_assert!(!judge(&trace, &program, &options).unwrap().ok);
    }
}

#[test]
fn swapped_motors_are_caught() {
    let motors = || {
        vec![motor("a", sine(50.0, Time::SECOND, Some(1)), 2, 3), motor("b", sine(40.0, Time::SECOND, Some(1)), 4, 5)]
    };
    let program = program(Grid::NEAREST, motors());
    let judged = |a: u8, b: u8| {
        let mut all = edges(&sine_steps(50, 1.0, 1, Grid::NEAREST), a, a + 1);
        all.extend(edges(&sine_steps(40, 1.0, 1, Grid::NEAREST), b, b + 1));
        all.sort_by_key(|e| e.tick);
        judge(&Trace { tick_hz: HZ, lines: lines::of(&program), edges: all }, &program, &Options::default()).unwrap()
    };
    assert!(judged(0, 2).ok);
    assert!(!judged(2, 0).ok);
}

#[test]
fn a_constant_is_taken_off() {
    let (program, mut trace) = tutorial();
    trace.edges.iter_mut().for_each(|edge| edge.tick += 37);
    let with = |constant_ticks| Options { constant_ticks, ..Options::default() };
    assert!(judge(&trace, &program, &with(37)).unwrap().ok);
    assert!(!judge(&trace, &program, &with(35)).unwrap().ok);
}

/// Errors that lean to one side of a bound that they keep, all but a few to the very edge.
#[test]
fn alignment_breaks_nothing_that_holds_without() {
    let (program, trace) = tutorial();
    let mut steps = decode::steps(&trace, &program).unwrap();
    steps.steps.iter_mut().step_by(100).for_each(|step| step.tick += 1);
    // If the rate is to be fitted, another clock took the times: they are known within one of its ticks.
    for (align, spare) in [(Align::None, 0.0), (Align::Start, 0.0), (Align::StartAndRate, 1.0)] {
        let options = Options { align, bound_ticks: Some(1.5), ..Options::default() };
        let report = judge_steps(&steps, &program, &options).unwrap();
        assert!(report.ok, "{report}");
        assert!((1.5..1.6).contains(&(report.motors[0].bound_ticks - spare)));
    }
}

#[test]
fn endless_laws_are_judged_as_far_as_the_trace_goes() {
    let mut program = program(Grid::NEAREST, vec![motor("wheel", sine(100.0, Time::SECOND, None), 8, 9)]);
    let steps = sine_steps(100, 1.0, 5, Grid::NEAREST);
    let trace = |n: usize| Trace { tick_hz: HZ, lines: lines::of(&program), edges: edges(&steps[..n], 0, 1) };
    let whole = judge(&trace(1234), &program, &Options::default()).unwrap();
    assert!(whole.ok, "{whole}");
    assert_eq!(whole.motors[0].steps_wanted, 1234);
    let until = Options { until_s: Some(2.5), ..Options::default() };
    let half = judge(&trace(1234), &program, &until).unwrap();
    assert!(half.ok, "{half}");
    assert_eq!((half.motors[0].steps_wanted, half.motors[0].steps_got, half.motors[0].position_got), (1000, 1000, 200));
    let short = trace(999);
    assert!(!judge(&short, &program, &until).unwrap().ok);
    // A finite law must be made to its end.
    program.motors[0].law = sine(100.0, Time::SECOND, Some(5));
    assert_eq!(judge(&short, &program, &Options::default()).unwrap().motors[0].missing, 1001);
}

/// Rises to `height` at 0.5 s and falls back to 0 at 1 s, a parabola.
fn bump(height: f64) -> Law {
    let curve = Curve::Polynomial(vec![0.0, 4.0 * height, -4.0 * height]);
    let piece =
        Piece { zero: Time::ZERO, start: Time::ZERO, end: Time::SECOND, origin: 0, curve, entry: Entry::SpeedJump };
    Law::Fixed(Fixed { pieces: Arc::new(vec![piece]), class: Class::ClosedForm })
}

#[test]
fn close_pairs_and_grazes_may_be_left_out() {
    let level = Grid::REACH.up_level(0);
    let check = |height: f64, steps: &[(u64, bool)], ok: bool, dropped: u64| {
        let program = program(Grid { hysteresis: 0.0 }, vec![motor("wheel", bump(height - 0.5), 8, 9)]);
        let steps = steps.iter().map(|&(tick, forward)| Step { motor: 0, tick, forward }).collect();
        let trace = StepTrace { tick_hz: HZ, motors: vec!["wheel".into()], steps };
        let report = judge_steps(&trace, &program, &Options::default()).unwrap();
        assert_eq!((report.ok, report.motors[0].pairs_dropped), (ok, dropped), "{height}: {report}");
    };
    let top = HZ / 2;
    // Far above: both steps are wanted. θ = ½ at t with 4t(1 − t) = ½.
    let first = ((0.5 - (0.125f64).sqrt()) * HZ as f64).round() as u64;
    check(level + 0.5, &[(first, true), (HZ - first, false)], true, 0);
    check(level + 0.5, &[], false, 0);
    // 1e-10 above: the crossings are 14 µs apart, closer than the driver can.
    check(level + 1e-10, &[], true, 1);
    check(level, &[(top, true), (top, false)], true, 0);
    check(level, &[(top, true)], false, 0);
    // 1e-10 below: within rounding.
    check(level - 1e-10, &[], true, 0);
    check(level - 1e-10, &[(top, true), (top, false)], true, 0);
    check(level - 1e-10, &[(top, true)], false, 0);
    // 2e-9 below there is none.
    check(level - 2e-9, &[], true, 0);
    check(level - 2e-9, &[(top, true), (top, false)], false, 0);
}

#[test]
fn dropped_pairs_are_counted() {
    let mut program = program(Grid { hysteresis: 0.0 }, vec![motor("wheel", bump(0.5 + 1e-6), 8, 9)]);
    let trace = StepTrace { tick_hz: HZ, motors: vec![], steps: vec![] };
    // Half a millisecond on each side of the top: wanted, unless the motor is slower than that.
    assert_eq!(judge_steps(&trace, &program, &Options::default()).unwrap().motors[0].missing, 2);
    program.motors[0].limits.max_speed = Some(100.0);
    let report = judge_steps(&trace, &program, &Options::default()).unwrap();
    assert!(report.ok);
    assert_eq!(report.motors[0].pairs_dropped, 1);
    assert!((report.motors[0].worst_position_error - 0.500_001).abs() < 1e-9, "{report}");
}

/// A law of one speed, for a second.
fn line(speed: f64) -> Law {
    let curve = Curve::Polynomial(vec![0.0, speed]);
    let piece =
        Piece { zero: Time::ZERO, start: Time::ZERO, end: Time::SECOND, origin: 0, curve, entry: Entry::SpeedJump };
    Law::Fixed(Fixed { pieces: Arc::new(vec![piece]), class: Class::ClosedForm })
}

/// A plan may make the step of a law that ends within rounding of its level, or not; no other step.
#[test]
fn a_touch_at_the_end_is_a_step_or_none() {
    let program = program(Grid::REACH, vec![motor("a", line(2.0 - 5e-10), 2, 3)]);
    let is_ok = |ticks: &[u64], forward: bool| {
        let steps = ticks.iter().map(|&tick| Step { motor: 0, tick, forward: forward || tick < HZ }).collect();
        let trace = StepTrace { tick_hz: HZ, motors: vec!["a".into()], steps };
        judge_steps(&trace, &program, &Options::default()).unwrap().ok
    };
    let half = HZ / 2;
    assert!(is_ok(&[half, HZ], true) && is_ok(&[half], true));
    for ticks in [&[HZ][..], &[half, half + half / 2], &[half, HZ, HZ + 400], &[half, HZ - 400], &[half, HZ + 400]] {
        assert!(!is_ok(ticks, true), "{ticks:?}");
    }
    assert!(!is_ok(&[half, HZ], false));
}

/// Where the board makes one step after the other, a step may wait for another motor's, and for nothing else.
#[test]
fn a_step_may_wait_for_that_of_another_motor() {
    const APART: u64 = 232;
    let mut program = program(Grid { hysteresis: 0.0 }, vec![motor("a", line(1.0), 2, 8), motor("b", line(1.0), 3, 8)]);
    let lines = lines::of(&program);
    let judged = |program: &Program, late: u64| {
        let edge = |tick, line, level| Edge { tick, line, level };
        let step = |tick, line| [edge(tick, line, true), edge(tick + PULSE, line, false)];
        let edges = [step(HZ / 2, 0), step(HZ / 2 + late, 2)].concat();
        judge(&Trace { tick_hz: HZ, lines: lines.clone(), edges }, program, &Options::default()).unwrap()
    };
    assert!(!judged(&program, APART).ok);
    program.board.shared_steps = Some(SharedSteps { together_ticks: 24, apart_ticks: APART as u32 });
    let report = judged(&program, APART);
    assert!(report.ok, "{report}");
    assert_eq!(report.motors[1].steps_put_off, 1);
    assert!(!judged(&program, 4 * APART).ok);
}

#[test]
fn a_shared_dir_line_may_put_steps_off() {
    // Two motors at once in opposite directions: b goes when a's pulse, hold and its own setup are over.
    let program = program(Grid { hysteresis: 0.0 }, vec![motor("a", line(1.0), 2, 8), motor("b", line(-1.0), 3, 8)]);
    let lines = lines::of(&program);
    assert_eq!(lines.len(), 3);
    let judged = |b: u64, turned: u64| {
        let half = HZ / 2;
        let edge = |tick, line, level| Edge { tick, line, level };
        let edges = vec![
            edge(half, 0, true),
            edge(half + PULSE, 0, false),
            edge(turned, 1, true),
            edge(b, 2, true),
            edge(b + PULSE, 2, false),
        ];
        judge(&Trace { tick_hz: HZ, lines: lines.clone(), edges }, &program, &Options::default()).unwrap()
    };
    let turned = HZ / 2 + PULSE + HOLD;
    let report = judged(turned + SETUP, turned);
    assert!(report.ok, "{report}");
    assert_eq!(report.motors[1].steps_put_off, 1);
    assert!((report.motors[1].longest_put_off_ticks - 320.0).abs() < 1e-3);
    assert!(!judged(turned + SETUP + 2, turned).ok);
}

#[test]
fn coils_count_and_jumps_are_caught() {
    for sequence in [CoilSequence::Wave, CoilSequence::Full, CoilSequence::Half] {
        let mut wheel = motor("wheel", sine(100.0, Time::SECOND, Some(1)), 8, 9);
        wheel.wiring = Wiring::Coils { pins: [4, 5, 6, 7], sequence };
        wheel.timing = DriverTiming::default();
        let program = program(Grid::NEAREST, vec![wheel]);
        let patterns: &[u8] = match sequence {
            CoilSequence::Wave => &[8, 4, 2, 1],
            CoilSequence::Full => &[9, 12, 6, 3],
            CoilSequence::Half => &[9, 8, 12, 4, 6, 2, 3, 1],
        };
        let judged = |skip: Option<usize>| {
            let mut edges: Vec<Edge> = Vec::new();
            let mut pattern = 0;
            let mut go = |tick: u64, to: u8| {
                for line in (0..4).filter(|line| (pattern ^ to) >> line & 1 == 1) {
                    edges.push(Edge { tick, line, level: to >> line & 1 == 1 });
                }
                pattern = to;
            };
            go(0, patterns[0]);
            let mut position = 0i64;
            for (i, (tick, forward)) in sine_steps(100, 1.0, 1, Grid::NEAREST).into_iter().enumerate() {
                position += if forward { 1 } else { -1 };
                if skip != Some(i) {
                    go(tick, patterns[position.rem_euclid(patterns.len() as i64) as usize]);
                }
            }
            judge(&Trace { tick_hz: HZ, lines: lines::of(&program), edges }, &program, &Options::default()).unwrap()
        };
        let good = judged(None);
        assert!(good.ok, "{sequence:?}: {good}");
        let bad = judged(Some(50));
        assert!(bad.failures.iter().any(|f| matches!(f.fault, Fault::CoilJump { .. })), "{sequence:?}: {bad}");
    }
}

/// Ten hours of 0.35 steps/s at most, with the touch at the top after five: ticks keep their meaning.
#[test]
fn slow_laws_are_judged_to_a_tick() {
    let program = program(Grid::REACH, vec![motor("wheel", sine(2000.0, Time::from_seconds(36_000.0), Some(1)), 8, 9)]);
    let steps = sine_steps(2000, 36_000.0, 1, Grid::REACH);
    let steps = steps.into_iter().map(|(tick, forward)| Step { motor: 0, tick, forward }).collect();
    let trace = StepTrace { tick_hz: HZ, motors: vec!["wheel".into()], steps };
    let report = judge_steps(&trace, &program, &Options::default()).unwrap();
    assert!(report.ok, "{report}");
    assert!(report.motors[0].max_error_ticks.abs() < 0.6, "{report}");
}

/// The tutorial's θ from its start, steps, and what a film of it shows: a frame's time in the film to steps.
fn tutorial_theta(t: f64) -> f64 {
    2000.0 * (1.0 - (std::f64::consts::TAU * t.clamp(0.0, 3.0) / 3.0).cos())
}

/// A film of the tutorial, which begins 0.37 s in, in frames of 1/`fps` s, seen as `seen` says: steps to degrees.
fn film_of(fps: f64, noise_deg: f64, off: &dyn Fn(f64) -> f64, seen: &dyn Fn(f64) -> f64) -> Track {
    let mut random = 1_u32;
    let frames = (0..(4.0 * fps) as u32).map(|i| {
        let time_s = f64::from(i) / fps;
        let t = (time_s - 0.37) * 1.0002;
        // A uniform random number, −1 to 1.
        random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let noise = f64::from(random >> 8) / f64::from(1 << 23) - 1.0;
        let angle = seen((tutorial_theta(t) + off(t)) * 0.45 + 12.0) + noise_deg * noise * 3.0_f64.sqrt();
        Frame { time_s, angle, sigma: (noise_deg > 0.0).then_some(noise_deg) }
    });
    Track { unit: AngleUnit::Degrees, frames: frames.collect() }
}

fn judged_film(track: &Track, align: Align) -> Result<FilmReport, JudgeError> {
    judge_film(track, &tutorial().0, None, None, &Options { align, ..Options::default() })
}

#[test]
fn a_film_is_laid_over_the_law() {
    let judged = |align, off: &dyn Fn(f64) -> f64| judged_film(&film_of(50.0, 0.0, off, &|a| a), align).unwrap();
    let report = judged(Align::StartAndRate, &|_| 0.0);
    assert!(report.ok, "{report}");
    assert!((report.alignment.shift_s - 0.37).abs() < 1e-6, "{:?}", report.alignment);
    assert!((report.alignment.rate_ppm - 200.0).abs() < 0.1, "{:?}", report.alignment);
    assert!((report.zero_deg - 12.0).abs() < 1e-3, "{report}");
    assert!(report.rms_error_steps < 1e-3, "{report}");
    assert!(!judged(Align::None, &|_| 0.0).ok);
    assert!(judged(Align::Start, &|_| 0.0).ok);
    // Four steps lost on the way.
    assert!(!judged(Align::StartAndRate, &|t| if t > 1.5 { -4.0 } else { 0.0 }).ok);
}

/// Angles as cameras give them: within ±180°, within 0 to 360°, from behind, and both.
#[test]
fn turns_sense_and_zero_are_found() {
    let within = |angle: f64| angle - 360.0 * (angle / 360.0).round();
    type Seen<'a> = (&'a str, &'a dyn Fn(f64) -> f64, bool);
    let seen: [Seen<'_>; 5] = [
        ("±180°", &within, false),
        ("0 to 360°", &|angle| angle.rem_euclid(360.0), false),
        ("from behind", &|angle| 77.0 - angle, true),
        ("from behind, ±180°", &|angle| within(77.0 - angle), true),
        ("many turns ahead", &|angle| angle + 36_000.0, false),
    ];
    for (name, seen, reversed) in seen {
        for noise_deg in [0.0, 0.05, 0.3] {
            let report = judged_film(&film_of(120.0, noise_deg, &|_| 0.0, seen), Align::StartAndRate).unwrap();
            assert!(report.ok && report.jumps.is_empty(), "{name}, {noise_deg}: {report}");
            assert_eq!(report.reversed, reversed, "{name}, {noise_deg}: {report}");
            assert!((report.alignment.shift_s - 0.37).abs() < 1e-3, "{name}, {noise_deg}: {report}");
        }
    }
}

#[test]
fn lost_and_added_steps_are_counted_where_they_are() {
    let check = |noise_deg: f64, events: &[(f64, f64)], expected: Expect| {
        let off = |t: f64| events.iter().filter(|event| t >= event.0).map(|event| event.1).sum();
        let within = |angle: f64| angle - 360.0 * (angle / 360.0).round();
        let found = match judged_film(&film_of(120.0, noise_deg, &off, &within), Align::StartAndRate) {
            Ok(report) => {
                assert_eq!(report.ok, report.jumps.is_empty(), "{report}");
                report.jumps.iter().map(|jump| format!("{jump}\n")).collect::<String>()
            }
            Err(error) => error.to_string(),
        };
        expected.assert_eq(&found);
    };
    // A step is 0.45°. Until 1.5 s the motor turns forward, then backward.
    check(0.02, &[], expect![[""]]);
    check(
        0.02,
        &[(0.75, -8.0)],
        expect![[r#"
        8 steps lost at 0.75 s
    "#]],
    );
    check(
        0.02,
        &[(0.75, -1.0)],
        expect![[r#"
        1 step lost at 0.75 s
    "#]],
    );
    check(
        0.1,
        &[(2.0, -16.0)],
        expect![[r#"
        16 steps added at 2.00 s
    "#]],
    );
    check(
        0.1,
        &[(0.5, -8.0), (2.2, 8.0)],
        expect![[r#"
        8 steps lost at 0.50 s
        8 steps lost at 2.20 s
    "#]],
    );
    check(
        0.02,
        &[(1.0, 300.0)],
        expect![[r#"
        300 steps added at 1.00 s
    "#]],
    );
    // Lost one after the other.
    let stall: Vec<(f64, f64)> = (0..12).map(|k| (0.9 + 0.01 * f64::from(k), -4.0)).collect();
    check(
        0.02,
        &stall,
        expect![[r#"
            48 steps lost from 0.91 s to 1.00 s
        "#]],
    );
    // Too much noise for a count.
    check(
        1.0,
        &[(0.75, -8.0)],
        expect![
            "the film cannot tell: the angle is uncertain by up to 3.00° (3 σ) in 471 of 480 frames, and the limit is 1.00°; film from nearer, with more light and a shorter exposure, or judge with a larger --limit"
        ],
    );
}

#[test]
fn another_motion_fails() {
    let seen = |theta: &dyn Fn(f64) -> f64| {
        let frames = (0..400).map(|i| f64::from(i) / 120.0);
        let frames = frames.map(|time_s| Frame {
            time_s,
            angle: 0.45 * theta((time_s - 0.2).clamp(0.0, 3.0)),
            sigma: Some(0.03),
        });
        judged_film(&Track { unit: AngleUnit::Degrees, frames: frames.collect() }, Align::StartAndRate).unwrap()
    };
    let check = |name: &str, theta: &dyn Fn(f64) -> f64| {
        let report = seen(theta);
        assert!(!report.ok && report.jumps.is_empty(), "{name}: {report}");
    };
    assert!(seen(&tutorial_theta).ok);
    check("2 % larger", &|t| 1.02 * tutorial_theta(t));
    check("a triangle", &|t| 4000.0 * (1.0 - (t / 1.5 - 1.0).abs()));
    check("two periods", &|t| 2000.0 * (1.0 - (2.0 * std::f64::consts::TAU * t / 3.0).cos()));
    check("steady", &|t| 1000.0 * t);
}

#[test]
fn what_a_film_cannot_tell_is_said() {
    let check = |judged: Result<FilmReport, JudgeError>, expected: Expect| {
        expected.assert_eq(&judged.map_or_else(|error| error.to_string(), |report| report.to_string()));
    };
    // Ten turns a second, always.
    let law = Law::Steady(Steady { speed: 8000.0, duration: Some(Time::from_seconds(3.0)) });
    let steady = program(Grid::REACH, vec![motor("wheel", law, 8, 9)]);
    let at_15_hz = (2..40).map(|i| f64::from(i) / 15.0);
    let frames = at_15_hz.map(|time_s| Frame { time_s, angle: 3600.0 * time_s, sigma: None }).collect();
    let fast = Track { unit: AngleUnit::Degrees, frames };
    let options = Options { align: Align::StartAndRate, ..Options::default() };
    check(
        judge_film(&fast, &steady, None, None, &options),
        expect![
            "frames are too far apart: at 1.789 s the motion makes 0.67 turns from one frame to the next (15 frames a second), and a film cannot tell a turn from none; film at 25 frames a second or more, or a slower motion"
        ],
    );
    let judged = |track: &Track| judged_film(track, Align::StartAndRate);
    check(
        judged(&film_of(50.0, 0.05, &|_| 0.0, &|_| 12.0)),
        expect![
            "the film shows no motion that fits the law: the wheel turns by 0.17°; was it filmed while the motion ran?"
        ],
    );
    check(
        judged(&film_of(120.0, 1.5, &|_| 0.0, &|a| a)),
        expect![
            "the film cannot tell: the angle is uncertain by up to 4.50° (3 σ) in 480 of 480 frames, and the limit is 1.00°; film from nearer, with more light and a shorter exposure, or judge with a larger --limit"
        ],
    );
}

/// A motion that is 2 % slow everywhere fits with another rate; that is no clock's.
#[test]
fn another_speed_is_no_clock() {
    let (program, trace) = tutorial();
    let options = Options { align: Align::StartAndRate, ..Options::default() };
    let check = |slower: f64, expected: &str| {
        let mut steps = decode::steps(&trace, &program).unwrap();
        for step in &mut steps.steps {
            step.tick = (step.tick as f64 * slower).round() as u64;
        }
        let report = judge_steps(&steps, &program, &options).unwrap();
        assert_eq!(failures(&report), expected);
        let law = |t: f64| 900.0 * (1.0 - (std::f64::consts::TAU * t / slower / 3.0).cos());
        let frames = (0..=150).map(|i| f64::from(i) / 50.0 * slower);
        let frames = frames.map(|time_s| Frame { time_s, angle: law(time_s), sigma: None }).collect();
        let film = judge_film(&Track { unit: AngleUnit::Degrees, frames }, &program, None, None, &options).unwrap();
        assert_eq!((film.ok, film.failures.len()), (report.ok, report.failures.len()), "{film}");
    };
    check(1.005, "");
    let at = "at t = 3.000000 s\n";
    check(1.02, &format!("motor wheel: fits only with a clock that is off by -19608 ppm, limit 10000, {at}"));
}

#[test]
fn a_few_frames_are_no_film() {
    let (program, _) = tutorial();
    let frames = |n: u32| (0..n).map(|i| Frame { time_s: f64::from(i) * 1e-4, angle: 0.0, sigma: None }).collect();
    let judged = |n, options: &Options| {
        judge_film(&Track { unit: AngleUnit::Steps, frames: frames(n) }, &program, None, None, options)
    };
    let too_few = |frames| Err(JudgeError::TooFewFrames { frames, limit: 8 });
    for align in [Align::None, Align::Start] {
        assert_eq!(judged(7, &Options { align, ..Options::default() }), too_few(7));
    }
    assert_eq!(judged(20, &Options { until_s: Some(-1.0), ..Options::default() }), too_few(0));
    assert!(judged(8, &Options::default()).unwrap().ok);
}

/// Such a law is endless and has no crossing any more: the verdict comes all the same, also for a step too many.
#[test]
fn an_endless_law_that_rests_is_judged() {
    let rest = Law::Steady(Steady { speed: 0.0, duration: None });
    let move_and_rest = Law::then(vec![Law::speed(800.0, Some(Time::SECOND)).unwrap(), rest.clone()]).unwrap();
    // It swings by less than a step.
    let swing = sine(0.2, Time::SECOND, None);
    for (law, steps) in [(rest, 0), (move_and_rest, 800), (swing, 0)] {
        let program = program(Grid::REACH, vec![motor("wheel", law, 8, 9)]);
        for (extra, align) in [(0, Align::None), (1, Align::None), (2, Align::Start)] {
            let step = |k: u64| Step { motor: 0, tick: k * 20_000, forward: true };
            let steps = (1..=steps + extra).map(step).collect();
            let trace = StepTrace { tick_hz: HZ, motors: vec!["wheel".into()], steps };
            let report = judge_steps(&trace, &program, &Options { align, ..Options::default() }).unwrap();
            assert_eq!((report.ok, report.motors[0].extra), (extra == 0, extra), "{:?}", report.failures);
        }
    }
}
