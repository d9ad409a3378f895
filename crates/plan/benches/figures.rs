//! The figures that docs/benchmarks.md shows: what `cargo xtask bench` collects.
//!
//! One figure a line, fields between tabs: number, law, tick_hz, tolerance in ticks, what, bound, value. A bound is an
//! upper one; an empty field says that there is none.
#![allow(clippy::disallowed_methods, reason = "what a bench measures may differ in the last digit")]

#[path = "../tests/it/common/mod.rs"]
mod common;

use common::laws::{TUTORIAL, sine, trapezoid};
use common::lorenz::lorenz;
use common::{BOARDS, drift, packed_bytes, settings, steps};
use pulsetrain_motion::{Grid, Law, Time};
use pulsetrain_oracle::{Sine, rational};
use pulsetrain_plan::{Certificate, Planner, Settings};
use std::hint::black_box;
use std::time::Instant;

/// Each measurement is the fastest of so many: others share the machine.
const REPEATS: u32 = 40;
const UNO_HZ: u64 = 16_000_000;
/// The sine makes 2 million segments: a byte kept of each would break it. Pages are counted in lots of some 100 kB.
const MOST_ADDED_KB: f64 = 256.0;

fn main() {
    exactness();
    speed();
    size();
    long_motions();
}

/// Figure 1: the tutorial against the oracle.
fn exactness() {
    let exact = Sine::new(4000, &rational(1, 2));
    for (numerator, denominator, cycles) in TUTORIAL {
        let period = rational(numerator.into(), denominator.into());
        let law = sine(2000.0, Time::from_ratio(numerator, denominator), cycles);
        for board in BOARDS {
            let settings = Settings { grid: Grid::REACH, ..settings(board) };
            let (steps, _) = steps(&law, &settings).expect("a plan");
            let due: Vec<_> = exact.crossings(&period, cycles).collect();
            let in_order = due.iter().zip(&steps).all(|(due, step)| due.forward == step.forward);
            assert!(in_order && due.len() == steps.len(), "T = {period} s: steps are missing or the wrong way");
            let errors = due.iter().zip(&steps).map(|(due, step)| due.error_ticks(settings.tick_hz, step.tick));
            let law = format!("tutorial, T = {period} s, {} steps", steps.len());
            row(1, &law, &settings, "largest error, ticks", Some(1.0), errors.fold(0.0, f64::max));
        }
    }
}

/// Figure 2: planning with its certificate, on one core.
fn speed() {
    let second = sine(2000.0, Time::SECOND, 1);
    let slow_formula = formula("1000*t + 300*sin(7*t) + 50*sin(31*t)", 20);
    let fast_formula = formula("80000*t + 60000*sin(0.7*t) + 5000*sin(3.1*t)", 20);
    // The bounds are 1.6 times what a machine with free cores takes: one that others shared took up to 1.3 times that.
    let measured: [(&str, Law, u32, f64); 6] = [
        ("sine, A = 2000, T = 1 s", second.clone(), 16, 0.7),
        ("sine, A = 2e6, T = 10 s", sine(2e6, Time::from_ratio(10, 1), 1), 24, 0.0072),
        ("trapezoid, 20 k steps/s, 180 000 steps", trapezoid(180_000.0, 20_000.0, 20_000.0), 24, 0.025),
        ("Lorenz, 500·∫x dt, 20 s", lorenz(500.0, 20.0), 24, 2.0),
        ("1000t + 300 sin 7t + 50 sin 31t, 20 s", slow_formula, 16, 8.0),
        ("80 000t + 60 000 sin 0.7t + 5000 sin 3.1t, 20 s", fast_formula, 24, 0.036),
    ];
    let mut fastest = [f64::INFINITY; 2];
    for (name, law, fraction_bits, bound) in measured {
        let settings = Settings { packed: false, ..settings((UNO_HZ, fraction_bits)) };
        let steps = plan(&law, &settings).steps;
        let [step_ns, yardstick_ns, acos_ns] = in_turn_ns(&law, &settings, steps);
        fastest = [fastest[0].min(yardstick_ns), fastest[1].min(acos_ns)];
        row(2, &format!("{name}: {steps} steps"), &settings, "ns/step", None, step_ns);
        row(2, name, &settings, "yardsticks/step", Some(bound), step_ns / yardstick_ns);
    }
    println!(
        "2\tthe yardstick: a polynomial of degree 7 and 8 steps of a cubic in integers\t\t\tns\t\t{:.2}",
        fastest[0]
    );
    println!("2\tone f64 acos and its tick, for comparison\t\t\tns\t\t{:.2}", fastest[1]);
    let settings = Settings { packed: false, ..settings((UNO_HZ, 16)) };
    let segments = plan(&second, &settings).segments as f64 / 2.0;
    row(2, "sine, A = 2000, T = 1 s", &settings, "segments/half period", Some(80.0), segments);
}

/// Figure 3: payload of the packed stream.
fn size() {
    let second = sine(2000.0, Time::SECOND, 1);
    let chaos = lorenz(500.0, 20.0);
    let trapezoid = trapezoid(180_000.0, 20_000.0, 20_000.0);
    let formula = formula("1000*t + 300*sin(7*t) + 50*sin(31*t)", 20);
    let measured = [
        ("sine, A = 2000, T = 1 s", &second, 16, 1.0, Some(0.095)),
        ("sine, A = 2000, T = 1 s", &second, 16, 3.5, Some(0.065)),
        ("sine, A = 2000, T = 1 s", &second, 16, 16.0, None),
        ("Lorenz, 500·∫x dt, 20 s", &chaos, 16, 1.0, Some(0.14)),
        ("trapezoid, 20 k steps/s, 180 000 steps", &trapezoid, 24, 1.0, None),
        ("1000t + 300 sin 7t + 50 sin 31t, 20 s", &formula, 16, 1.0, None),
    ];
    for (name, law, fraction_bits, tolerance_ticks, bound) in measured {
        let settings = Settings { tolerance_ticks, packed: true, ..settings((UNO_HZ, fraction_bits)) };
        let bytes = packed_bytes(law, &settings).expect("a plan") as f64;
        row(3, name, &settings, "bytes/step", bound, bytes / plan(law, &settings).steps as f64);
    }
}

/// Figure 4: 10^8 steps, against exact integers.
fn long_motions() {
    let settings = settings((UNO_HZ, 16));
    let measured = [
        ("10^8 steps, 100π ticks apart", drift::constant(100_000_000)),
        ("10^8 steps, sine, A = 2000, T = π/3 s", drift::sinusoid(12_500)),
    ];
    for (name, drift) in measured {
        row(4, name, &settings, "largest error, first 10^6 steps, ticks", Some(1.0), drift.first);
        row(4, name, &settings, "largest error, last 10^6 steps, ticks", Some(1.0), drift.last);
        if let [Some(early), Some(late)] = drift.memory_kb {
            row(4, name, &settings, "memory added after the first 10^6 steps, kB", Some(MOST_ADDED_KB), late - early);
        }
    }
}

/// As motion files say it, steps.
fn formula(theta: &str, duration_s: i64) -> Law {
    Law::formula(theta, &[], 1.0, Some(Time::from_ratio(duration_s, 1))).expect("a formula")
}

fn plan(law: &Law, settings: &Settings) -> Certificate {
    let mut planner = Planner::new(law, settings).expect("a tolerance that can be met");
    while let Some(next) = planner.next_move().expect("a plan") {
        black_box(next);
    }
    planner.certificate().clone()
}

/// ns that a step of a plan takes, a yardstick, and an arc cosine: the fastest of [`REPEATS`] each, in turn, so that what
/// slows the machine slows all.
fn in_turn_ns(law: &Law, settings: &Settings, steps: u64) -> [f64; 3] {
    let mut fastest = [f64::INFINITY; 3];
    for _ in 0..REPEATS {
        let planning = ns(|| {
            black_box(plan(black_box(law), settings));
        });
        let of = [
            planning / steps as f64,
            ns(yardsticks) / f64::from(YARDSTICKS),
            ns(half_period_of_acos) / f64::from(SWING),
        ];
        fastest = std::array::from_fn(|place| fastest[place].min(of[place]));
    }
    fastest
}

/// Yardsticks in one measurement.
const YARDSTICKS: u32 = 4000;
/// Of the yardstick's polynomial, which is below 2 between 0 and 1/2.
const COEFFICIENTS: [f64; 8] = [0.125, 0.14, 0.16, 0.2, 0.25, 0.33, 0.5, 1.0];

/// Work like the planner's, which calls no library: a polynomial in f64, and the steps of a cubic in integers. Each
/// yardstick needs the result of the one before it, as a proof needs the segment before.
fn yardsticks() {
    let (mut x, mut accumulator) = (black_box(0.3_f64), black_box(1_i64 << 40));
    for _ in 0..YARDSTICKS {
        let polynomial = COEFFICIENTS.iter().fold(0.0, |sum, coefficient| sum * x + coefficient);
        let (mut interval, mut add) = ((polynomial * 65_536.0) as i64, accumulator & 0xff);
        for _ in 0..8 {
            accumulator += interval;
            interval += add;
            add += 3;
        }
        x = 1.0 / (2.0 + (accumulator & 0xffff) as f64 / 65_536.0);
    }
    black_box((x, accumulator));
}

/// The tutorial's steps in half a period.
const SWING: u32 = 4000;

/// Every step worked out by itself: one f64 arc cosine, and its tick. Source: the tutorial, eq. 3.
fn half_period_of_acos() {
    let scale = UNO_HZ as f64 / std::f64::consts::TAU;
    let tick = |n: u32| ((1.0 - f64::from(n) * (2.0 / f64::from(SWING))).acos() * scale + 0.5) as u64;
    black_box((1..=black_box(SWING)).fold(0, |sum, n| sum ^ tick(n)));
}

fn ns(work: impl FnOnce()) -> f64 {
    let start = Instant::now();
    work();
    start.elapsed().as_nanos() as f64
}

fn row(figure: u32, law: &str, settings: &Settings, what: &str, bound: Option<f64>, value: f64) {
    let Settings { tick_hz, tolerance_ticks, .. } = settings;
    let bound = bound.map_or(String::new(), |bound| format!("{bound:.4}"));
    println!("{figure}\t{law}\t{tick_hz}\t{tolerance_ticks}\t{what}\t{bound}\t{value:.4}");
}
