//! The Lorenz law against the oracle; and that of tests and benches, an integral of it, against the classical Runge–Kutta
//! method.

use crate::common::lorenz::lorenz;
use crate::common::{replay, settings, steps};
use pulsetrain_motion::law::{Cursor, Orbit};
use pulsetrain_motion::{Grid, Law, Time};
use pulsetrain_oracle::{Lorenz, rational};
use pulsetrain_plan::Settings;

#[test]
fn the_orbit_makes_the_steps_of_another_integrator() {
    for (end_s, dt_s) in [(2.0, 1e-3), (20.0, 1e-4)] {
        let certificate = replay(&lorenz(500.0, end_s), &settings((16_000_000, 32)), |_| ()).expect("a plan");
        assert_eq!((certificate.steps, certificate.position), walk(end_s, dt_s), "{end_s} s");
    }
}

/// Lorenz's own parameters, to the bit as the law has them: 8/3 is no f64.
fn exact() -> Lorenz {
    let beta = 8.0_f64 / 3.0;
    let beta = rational((beta * 2_f64.powi(51)) as i128, 1 << 51);
    let start = [rational(1, 1), rational(1, 1), rational(25, 1)];
    Lorenz { sigma: rational(10, 1), rho: rational(28, 1), beta, start }
}

/// The law against 192 bits and another method. Two orbits part like e^(0.9 t): what rounding leaves has grown by 10^4 at 10
/// time units, and by 10^8 at 20.
#[test]
fn the_law_is_the_orbit() {
    const SPEED: f64 = 0.5;
    let laws = [0, 1, 2].map(|k| Law::lorenz(Orbit::CLASSIC, k, 1.0, SPEED, None).expect("a law"));
    let mut cursors = laws.each_ref().map(Cursor::new);
    let mut largest = [0.0_f64; 2];
    for (n, state) in exact().states().take(20 * 64 + 1).enumerate() {
        let at = Time::from_ratio(n as i64, 32);
        for (cursor, exact) in cursors.iter_mut().zip(state) {
            let off = (cursor.at(at).expect("a position").position - exact).abs();
            let late = usize::from(n > 10 * 64);
            largest[late] = largest[late].max(off);
        }
    }
    assert!(largest[0] < 1e-10, "{} units off in the first 10 time units", largest[0]);
    assert!(largest[1] < 1e-6, "{} units off in the first 20 time units", largest[1]);
    // An error that is 0 would mean that nothing was compared.
    assert!(largest[1] > 1e-14);
}

/// Every scheduled step against the interpolant that the certificate is relative to: its polynomials, evaluated here, cross
/// the step's level within the certificate of its tick.
#[test]
fn every_step_is_within_its_certificate_of_the_interpolant() {
    const TICK_HZ: u64 = 16_000_000;
    let law = Law::lorenz(Orbit::CLASSIC, 2, 80.0, 0.5, Some(Time::from_seconds(4.0))).expect("a law");
    let settings = Settings { grid: Grid::NEAREST, ..settings((TICK_HZ, 16)) };
    let (steps, certificate) = steps(&law, &settings).expect("a plan");
    let pieces: Vec<_> = law.pieces().map(|piece| piece.expect("a piece")).collect();
    let theta = |ticks: f64| -> f64 {
        let at = Time::from_seconds(ticks / TICK_HZ as f64);
        let piece = pieces.iter().find(|piece| at <= piece.end).expect("a time within the law");
        piece.curve.value((at - piece.zero).seconds())
    };
    let start = theta(0.0);
    let (mut position, bound) = (0_i64, certificate.bound_ticks + 1e-6);
    for step in &steps {
        let way = if step.forward { 1.0 } else { -1.0 };
        let level = position as f64 + way * (0.5 + 1.0 / 64.0);
        let [before, after] = [-bound, bound].map(|by| way * (theta(step.tick as f64 + by) - start - level));
        assert!(before <= 1e-9 && after >= -1e-9, "{before} and {after} at tick {}", step.tick);
        position += if step.forward { 1 } else { -1 };
    }
    assert!(steps.len() > 5000, "{} steps", steps.len());
}

/// Steps and last position of the default grid, by Runge–Kutta steps of `dt_s`.
fn walk(end_s: f64, dt_s: f64) -> (u64, i64) {
    let (mut state, mut steps, mut position) = ([1.0, 1.0, 25.0, 0.0], 0, 0_i64);
    for _ in 0..(end_s / dt_s).round() as u64 {
        state = runge_kutta(state, dt_s);
        while (state[3] - position as f64).abs() >= 0.5 + 1.0 / 64.0 {
            position += if state[3] > position as f64 { 1 } else { -1 };
            steps += 1;
        }
    }
    (steps, position)
}

/// x, y, z, and 500·∫x dt.
fn runge_kutta(s: [f64; 4], h: f64) -> [f64; 4] {
    let slope = |[x, y, z, _]: [f64; 4]| [10.0 * (y - x), x * (28.0 - z) - y, x * y - 8.0 / 3.0 * z, 500.0 * x];
    let ahead = |k: [f64; 4], h: f64| std::array::from_fn(|i| s[i] + h * k[i]);
    let k1 = slope(s);
    let k2 = slope(ahead(k1, h / 2.0));
    let k3 = slope(ahead(k2, h / 2.0));
    let k4 = slope(ahead(k3, h));
    std::array::from_fn(|i| s[i] + h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]))
}
