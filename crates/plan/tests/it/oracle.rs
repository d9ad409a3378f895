//! Every scheduled tick against the exact time of its step, from `pulsetrain-oracle`: never against the planner's own
//! numbers.

use crate::common::laws::{self, TUTORIAL};
use crate::common::{BOARDS, Step, settings, steps};
use pulsetrain_motion::{Grid, Law, Time};
use pulsetrain_oracle::{Crossing, Rational, Sine, Trapezoid, Wave, Waves, rational};
use pulsetrain_plan::Settings;

/// Every step must be there, in order, in its direction, and within the tolerance and the certificate.
fn check(what: &str, law: &Law, settings: &Settings, exact: impl IntoIterator<Item = Crossing>) {
    let what = format!("{what} at {} Hz", settings.tick_hz);
    let (steps, certificate) = steps(law, settings).unwrap_or_else(|error| panic!("{what}: {error}"));
    assert!(certificate.bound_ticks <= settings.tolerance_ticks, "{what}: {}", certificate.bound_ticks);
    let mut scheduled = steps.iter();
    let mut due = 0_usize;
    for (number, crossing) in (1..).zip(exact) {
        let &Step { tick, forward } = scheduled.next().unwrap_or_else(|| panic!("{what}: step {number} is missing"));
        assert_eq!(forward, crossing.forward, "{what}: direction of step {number}");
        let error = crossing.error_ticks(settings.tick_hz, tick);
        assert!(error <= certificate.bound_ticks, "{what}: step {number} is {error} ticks off, at {tick}");
        due += 1;
    }
    assert_eq!(steps.len(), due, "{what}: steps scheduled, steps due");
    assert_eq!(certificate.steps, due as u64, "{what}: steps counted");
}

#[test]
fn every_step_of_the_tutorial() {
    let exact = Sine::new(4000, &rational(1, 2));
    for (numerator, denominator, cycles) in TUTORIAL {
        let law = laws::sine(2000.0, Time::from_ratio(numerator, denominator), cycles);
        let period = rational(numerator.into(), denominator.into());
        for board in BOARDS {
            let settings = Settings { grid: Grid::REACH, ..settings(board) };
            check(&format!("T = {period} s"), &law, &settings, exact.crossings(&period, cycles));
        }
    }
}

/// The sweep article's odd swings, on the default grid.
#[test]
fn every_step_of_odd_swings() {
    for (swing, period) in [(25_u32, (1, 4)), (1, (2, 1))] {
        let exact = Sine::new(swing, &rational(1, 64));
        let law = laws::sine(f64::from(swing) / 2.0, Time::from_ratio(period.0, period.1), 10);
        let period = rational(period.0.into(), period.1.into());
        for board in BOARDS {
            check(&format!("swing of {swing}"), &law, &settings(board), exact.crossings(&period, 10));
        }
    }
}

#[test]
fn every_step_of_a_trapezoid() {
    let law = laws::trapezoid(5000.0, 10_000.0, 100_000.0);
    let exact = Trapezoid::new(5000, 10_000.into(), 100_000.into(), 100_000.into());
    for board in BOARDS {
        check("trapezoid", &law, &settings(board), exact.crossings(&rational(1, 64)));
    }
}

#[test]
fn every_step_at_a_constant_speed() {
    // Ends between two steps, so that the last step is not the law's end.
    let law = laws::constant_speed(1234.0, (10_000.0 + 0.25) / 1234.0);
    let exact = Trapezoid::constant_speed(1234.into(), 10_000);
    for board in BOARDS {
        let settings = Settings { tolerance_ticks: 0.75, ..settings(board) };
        check("1234 steps/s", &law, &settings, exact.crossings(&rational(1, 64)));
    }
}

/// Many turning points, and no closed step times.
#[test]
fn every_step_of_a_sum_of_sines() {
    let law = laws::waves(1000.0, &[(300.0, 7.0), (50.0, 31.0)], 2.0);
    let wave = |amplitude: i64, omega: i64| Wave { amplitude: Rational::from(amplitude), omega: Rational::from(omega) };
    let exact = Waves { speed: 1000.into(), waves: vec![wave(300, 7), wave(50, 31)] };
    let exact = exact.crossings(&rational(1, 64), 2, 200_000);
    for board in BOARDS {
        for tolerance_ticks in [0.75, 1.0, 3.5, 16.0] {
            let settings = Settings { tolerance_ticks, ..settings(board) };
            check(&format!("±{tolerance_ticks} ticks"), &law, &settings, exact.iter().cloned());
        }
    }
}
