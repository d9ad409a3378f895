//! The Lorenz law of tests and benches against another integrator: the classical Runge–Kutta method.

mod common;

use common::lorenz::lorenz;
use common::{replay, settings};

#[test]
fn the_orbit_makes_the_steps_of_another_integrator() {
    for (end_s, dt_s) in [(2.0, 1e-3), (20.0, 1e-4)] {
        let certificate = replay(&lorenz(500.0, end_s), &settings((16_000_000, 32)), |_| ()).expect("a plan");
        assert_eq!((certificate.steps, certificate.position), walk(end_s, dt_s), "{end_s} s");
    }
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
