//! Laws that hardly move where a step is due: double and triple zeros, touches at a turn, and ends at rest on a level.
//!
//! θ is worked out a second time, in 192 bits, and each step is held against it.

use std::sync::LazyLock;

use crate::common::{Step, settings, steps};
use proptest::prelude::*;
use pulsetrain_motion::law::{Ease, SCurve};
use pulsetrain_motion::time::Rate;
use pulsetrain_motion::{Grid, Law, Time};
use pulsetrain_oracle::Real;
use pulsetrain_plan::Settings;

/// Significant bits.
const BITS: usize = 192;

fn real(x: f64) -> Real {
    Real::try_from(x).expect("a number").with_precision(BITS).value()
}

/// It is worked out once: θ is asked for at each step.
static PI: LazyLock<Real> = LazyLock::new(|| Real::pi(BITS));

/// θ in steps of the time in seconds, and when it may be flat, s.
struct Exact {
    theta: Box<dyn Fn(&Real) -> Real>,
    flat: Vec<Real>,
    end: Real,
}

/// A law as the planner gets it, and the same law in 192 bits.
struct Case {
    what: String,
    law: Law,
    exact: Exact,
}

/// Exact arithmetic leaves this, steps: at a double zero some 10^-20 s.
const LEFT: f64 = 1e-40;

/// A bound before each step θ has not reached its level, and a bound after it has: there, or where it was flat in between. All are made.
#[track_caller]
fn check(case: &Case, settings: &Settings) {
    let Case { what, law, exact } = case;
    let what = format!("{what} on {:?} at {} Hz", settings.grid, settings.tick_hz);
    let (steps, certificate) = steps(law, settings).unwrap_or_else(|error| panic!("{what}: {error}"));
    assert!(certificate.bound_ticks <= settings.tolerance_ticks, "{what}: {}", certificate.bound_ticks);
    let (bound, hz, left) = (real(certificate.bound_ticks), real(settings.tick_hz as f64), real(LEFT));
    let zero = real(0.0);
    let theta = |t: &Real| (exact.theta)(t.clamp(&zero, &exact.end));
    let start = theta(&zero);
    let mut position = 0;
    for &Step { tick, forward } in &steps {
        let level = if forward { settings.grid.up_level(position) } else { settings.grid.down_level(position) };
        let level = real(level) + &start;
        let tick_at = Real::from(tick).with_precision(BITS).value();
        let (before, after) = ((&tick_at - &bound) / &hz, (&tick_at + &bound) / &hz);
        let beyond = |t: &Real| if forward { theta(t) - &level } else { &level - theta(t) };
        assert!(beyond(&before) <= left, "{what}: the step at tick {tick} is late");
        let mut places = exact.flat.iter().filter(|t| before <= **t && **t <= after).chain([&after]);
        // A turn this close to a level touches it: that is the planner's, and no rounding.
        let touches = real(-1e-9);
        let reaches = places.any(|t| beyond(t) >= if t == &after { -left.clone() } else { touches.clone() });
        assert!(reaches, "{what}: the step at tick {tick} is early");
        position += if forward { 1 } else { -1 };
    }
    // No level is left out: at every place where it is flat, and at its end, the motor is where θ is.
    for place in exact.flat.iter().chain([&exact.end]) {
        let at = steps.iter().take_while(|step| Real::from(step.tick) <= place * &hz + &bound);
        let at: i64 = at.map(|step| if step.forward { 1 } else { -1 }).sum();
        let off = (theta(place) - &start - real(at as f64)).to_f64().value();
        let most = 0.5 + settings.grid.hysteresis + 1e-6;
        assert!(off.abs() <= most, "{what}: {off} steps from θ at {place}");
    }
}

/// Settings that tell times best and worst.
fn all_settings() -> impl Iterator<Item = Settings> {
    [(16_000_000, 16), (125_000_000, 32), (1_000_000_000, 32)]
        .into_iter()
        .flat_map(|clock| [Grid::REACH, Grid::NEAREST].map(|grid| Settings { grid, ..settings(clock) }))
}

fn formula(
    text: &str,
    parameters: &[(&str, f64)],
    end_s: f64,
    flat: Vec<Real>,
    theta: impl Fn(&Real) -> Real + 'static,
) -> Case {
    let named: Vec<(String, f64)> = parameters.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect();
    let law = Law::formula(text, &named, 1.0, Some(Time::from_seconds(end_s))).unwrap();
    Case {
        what: format!("{text} with {parameters:?}"),
        law,
        exact: Exact { theta: Box::new(theta), flat, end: real(end_s) },
    }
}

/// a·sin(2πft)^n for whole half swings.
fn power_of_sine(n: u32, a: f64, f: f64, half_swings: u32) -> Case {
    let quarters = (0..=2 * half_swings).map(|k| real(k.into()) / (real(4.0) * real(f)));
    let end_s = f64::from(half_swings) / (2.0 * f);
    formula(&format!("a*sin(2*pi*f*t)^{n}"), &[("a", a), ("f", f)], end_s, quarters.collect(), move |t| {
        let sine = (real(2.0) * &*PI * real(f) * t).sin();
        (0..n).fold(real(a), |product, _| product * &sine)
    })
}

/// A chirp that swells from rest and dies away to it.
fn chirp(a: f64, f: f64, g: f64, end_s: f64) -> Case {
    let text = "a*sin(pi*t/T)^2*sin(2*pi*(f*t + (g - f)*t*t/(2*T)))";
    let parameters = [("a", a), ("f", f), ("g", g), ("T", end_s)];
    formula(text, &parameters, end_s, vec![real(0.0), real(end_s)], move |t| {
        let [a, f, g, end] = [a, f, g, end_s].map(real);
        let envelope = (&*PI * t / &end).sin();
        let phase = &f * t + (g - &f) * t * t / (real(2.0) * end);
        a * &envelope * &envelope * (real(2.0) * &*PI * phase).sin()
    })
}

/// From rest to rest, with n zero derivatives at both ends.
fn smooth_step(n: u32, a: f64, end_s: f64) -> Case {
    let text = if n == 1 { "a*((t/T)^2*(3 - 2*t/T))" } else { "a*(10*(t/T)^3 - 15*(t/T)^4 + 6*(t/T)^5)" };
    formula(text, &[("a", a), ("T", end_s)], end_s, vec![real(0.0), real(end_s)], move |t| {
        let s = t / real(end_s);
        let cube = &s * &s * &s;
        if n == 1 {
            real(a) * &s * &s * (real(3.0) - real(2.0) * s)
        } else {
            real(a) * (real(10.0) * &cube - real(15.0) * &cube * &s + real(6.0) * cube * &s * &s)
        }
    })
}

/// Whole swings that die away.
fn damped(a: f64, tau: f64, f: f64, half_swings: u32) -> Case {
    let flat = (0..=half_swings).map(|k| real(k.into()) / (real(2.0) * real(f)));
    let end_s = f64::from(half_swings) / (2.0 * f);
    formula("a*exp(-t/tau)*sin(2*pi*f*t)^2", &[("a", a), ("f", f), ("tau", tau)], end_s, flat.collect(), move |t| {
        let sine = (real(2.0) * &*PI * real(f) * t).sin();
        real(a) * (-(t / real(tau))).exp() * &sine * sine
    })
}

#[test]
fn laws_that_are_flat_at_a_level_are_planned_and_right() {
    let cases = [
        power_of_sine(2, 100.0, 0.001, 2),
        power_of_sine(3, 40.0, 1.5, 3),
        power_of_sine(3, 12.5, 0.01, 2),
        power_of_sine(4, 30.0, 0.01, 3),
        power_of_sine(6, 3.0, 0.05, 4),
        power_of_sine(5, 60.0, 2.0, 4),
        power_of_sine(7, 20.0, 0.3, 2),
        chirp(90.0, 0.7, 2.3, 2.76),
        chirp(25.3, 3.1, 0.4, 1.3),
        smooth_step(1, 200.0, 1.7),
        smooth_step(1, 50.0, 1000.0),
        smooth_step(2, 90.0, 0.8),
        smooth_step(2, 10.0, 3600.0),
        damped(120.0, 0.8, 1.25, 4),
    ];
    for case in &cases {
        for settings in all_settings() {
            check(case, &settings);
        }
    }
}

/// A window of the formula ends 8e-12 steps before a level, and θ goes on: no touch.
#[test]
fn a_level_that_is_just_missed_where_windows_meet_is_reached_later() {
    let f = 0.4997948139256659;
    for case in [power_of_sine(4, 3.0, f, 3), power_of_sine(7, 29.590292187444362, f, 6)] {
        for settings in all_settings() {
            check(&case, &settings);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn random_ones_too(a in 3.0..60.0f64, f in 0.05..4.0f64, g in 0.3..4.0f64, end_s in 0.3..3.0f64, n in 1u32..8, setting in 0usize..6) {
        let settings = all_settings().nth(setting).unwrap();
        for case in [
            power_of_sine(n + 1, a, f, n),
            chirp(a, f, g, end_s),
            smooth_step(1 + n % 2, a.round(), end_s),
            damped(a, end_s, f, n),
        ] {
            check(&case, &settings);
        }
    }
}

/// A constant speed, eased.
fn eased_speed(speed: f64, duration_s: f64, over_s: f64) -> Case {
    let law = Law::speed(speed, Some(Time::from_seconds(duration_s))).unwrap();
    let law = law.eased(Time::from_seconds(over_s)).unwrap();
    let end = real(duration_s + over_s);
    let last = end.clone();
    let theta = move |t: &Real| {
        let over = real(over_s);
        let rising = |t: Real| {
            let x = &t / &over;
            let cube = &x * &x * &x;
            &over * (&cube - &cube * x / real(2.0))
        };
        let own = if *t < over {
            rising(t.clone())
        } else if *t > &last - &over {
            real(duration_s) - rising(&last - t)
        } else {
            t - &over / real(2.0)
        };
        real(speed) * own
    };
    let exact = Exact { theta: Box::new(theta), flat: vec![real(0.0), end.clone()], end };
    Case { what: format!("{speed} steps/s for {duration_s} s, eased over {over_s} s"), law, exact }
}

/// Motions that are eased out, to rest just where a step is due: three times flat, or six times at the top of a circle.
#[test]
fn eased_motions_that_end_on_a_level_are_planned() {
    for case in [eased_speed(-1000.0, 2.0, 0.375), eased_speed(0.25, 400.0, 8.5), eased_speed(160.0, 5.0, 5.0)] {
        for settings in all_settings() {
            check(&case, &settings);
        }
    }
    let seconds = Time::from_seconds;
    let (sine, circle) =
        (Law::sine(50.0, seconds(0.4), Some(4)), |axis| Law::circle(100.0, seconds(0.4), Some(4), axis));
    for law in [sine, circle(0), circle(1)] {
        let law = law.unwrap().eased(seconds(0.375)).unwrap();
        for settings in all_settings() {
            steps(&law, &settings).unwrap_or_else(|error| panic!("{law:?}: {error}"));
        }
    }
}

/// A sum that ends where one of its parts comes to rest while the others are at rest, just where a step is due.
#[test]
fn sums_that_end_at_rest_on_a_level_are_planned() {
    let curve =
        SCurve { distance: 400.0, max_speed: 700.0, max_acceleration: 4000.0, max_jerk: 50_000.0, start_speed: 0.0 };
    let second = |ms: i64| Time::from_ratio(ms, 1000);
    for (swings, delay_ms) in [(1, 137), (3, 250), (8, 1)] {
        for swing in [37.0, 12.25] {
            let sine = Law::sine(swing, second(333), Some(swings)).unwrap();
            let s_curve = Law::s_curve(curve).unwrap().delayed(second(delay_ms)).unwrap();
            let law = Law::sum(vec![s_curve.clone(), sine]).unwrap();
            for settings in all_settings() {
                let (_, certificate) =
                    steps(&law, &settings).unwrap_or_else(|error| panic!("{swings} swings: {error}"));
                assert_eq!(certificate.position, 400);
            }
        }
    }
}

/// A sinusoid that fades into rest on a level, at a rate of its time.
fn faded_into_rest(amplitude: f64, period_s: f64, level: f64, from_s: f64, over_s: f64, rate: f64) -> Case {
    let seconds = Time::from_seconds;
    let sine = Law::sine(amplitude, seconds(period_s), None).unwrap();
    let rest = Law::speed(0.0, Some(seconds(from_s + over_s + 0.5))).unwrap().shifted(level).unwrap();
    let law = sine.faded(rest, seconds(from_s), seconds(over_s)).unwrap();
    let law = law.retimed(Time::ZERO, Ease::steady(Rate::of(rate).unwrap())).unwrap();
    let end = real(from_s + over_s) / real(rate);
    let theta = move |t: &Real| {
        let t = t * real(rate);
        let x = ((&t - real(from_s)) / real(over_s)).clamp(real(0.0), real(1.0));
        let cube = &x * &x * &x;
        let weight = real(10.0) * &cube - real(15.0) * &cube * &x + real(6.0) * cube * &x * &x;
        let old = real(amplitude) * (real(1.0) - (real(2.0) * &*PI * t / real(period_s)).cos());
        &old + weight * (real(level) - &old)
    };
    // The sinusoid turns at a level, too: twice in a period.
    let half_s = 0.5 * period_s / rate;
    let turns = (0..).map(|k| f64::from(k) * half_s).take_while(|at_s| *at_s * rate < from_s + over_s);
    let flat = turns.map(real).chain([end.clone()]).collect();
    let what =
        format!("{amplitude} steps in {period_s} s fade into {level} from {from_s} s within {over_s} s at {rate}");
    Case { what, law, exact: Exact { theta: Box::new(theta), flat, end } }
}

/// A swing: steps, its period in s, the level of rest. A fade: from and over, s, and the rate of time.
const SWINGS: [(f64, f64, f64); 4] = [(50.0, 1.0, 0.0), (100.0, 2.0, 0.0), (25.0, 0.5, 40.0), (12.5, 0.25, 3.0)];
const FADES: [(f64, f64, f64); 4] = [(0.3, 1.3, 1.0), (2.5, 2.5, 0.5), (1.0, 0.37, 3.0), (0.6, 30.0, 1.0)];

fn fade_into_rest(swing: (f64, f64, f64), fade: (f64, f64, f64)) {
    let ((amplitude, period_s, level), (from_s, over_s, rate)) = (swing, fade);
    let case = faded_into_rest(amplitude, period_s, level, from_s, over_s, rate);
    for settings in all_settings() {
        check(&case, &settings);
    }
}

/// `goto 0` of a live motion whose grid is `reach`.
#[test]
fn fades_into_rest_on_a_level_are_planned_and_right() {
    SWINGS.into_iter().zip(FADES).for_each(|(swing, fade)| fade_into_rest(swing, fade));
}

mod long {
    use super::*;

    #[test]
    fn all_fades_into_rest_on_a_level_are_planned_and_right() {
        SWINGS.into_iter().for_each(|swing| FADES.into_iter().for_each(|fade| fade_into_rest(swing, fade)));
    }
}
