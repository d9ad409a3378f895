//! Random laws: every scheduled tick within its certificate, every crossing made, every limit kept.

use proptest::prelude::*;
use pulsetrain_core::Recurrence;
use pulsetrain_motion::law::{Class, Curve, Entry, Fixed, Law, Piece};
use pulsetrain_motion::{Grid, Time};
use pulsetrain_plan::{Certificate, Move, PlanError, Planner, Settings};
use std::f64::consts::TAU;

/// What a board would make of a plan, from the integers alone.
struct Replay {
    /// (tick, position after the step)
    steps: Vec<(i64, i64)>,
    certificate: Certificate,
}

fn replay(law: &Law, settings: &Settings) -> Result<Replay, PlanError> {
    let mut planner = Planner::new(law, settings)?;
    let fraction_bits = settings.registers.fraction_bits;
    let mut registers = Recurrence { accumulator: 1 << (fraction_bits - 1), ..Recurrence::default() };
    let (mut position, mut steps) = (0, Vec::new());
    while let Some(next) = planner.next_move()? {
        match next {
            Move::Dwell { ticks } => registers.accumulator += ticks << fraction_bits,
            Move::Run { segment, direction } => {
                registers.load(&segment);
                for _ in 0..segment.count {
                    registers.advance();
                    position += i64::from(direction.sign());
                    steps.push(((registers.accumulator >> fraction_bits) as i64, position));
                }
            }
        }
    }
    Ok(Replay { steps, certificate: planner.certificate().clone() })
}

/// c·t + Σ a·cos(ωt + φ) over some seconds.
fn law(speed: f64, terms: &[(f64, f64, f64)], seconds: f64) -> Law {
    let mut curves = vec![Curve::Polynomial(vec![0.0, speed])];
    curves.extend(terms.iter().map(|&(amplitude, omega, phase)| Curve::Cosine {
        offset: 0.0,
        amplitude,
        omega,
        phase,
    }));
    let piece = Piece {
        zero: Time::ZERO,
        start: Time::ZERO,
        end: Time::from_seconds(seconds),
        origin: 0,
        curve: Curve::Sum(curves),
        entry: Entry::SpeedJump,
    };
    Law::Fixed(Fixed { pieces: vec![piece].into(), class: Class::Enclosed })
}

fn any_settings() -> impl Strategy<Value = Settings> {
    let grid =
        prop_oneof![Just(Grid::NEAREST), Just(Grid::REACH), (0.001..0.5).prop_map(|hysteresis| Grid { hysteresis })];
    let clock =
        prop_oneof![Just((16_000_000, 16)), Just((16_000_000, 24)), Just((125_000_000, 32)), Just((42_000_000, 32))];
    (grid, clock, 0.55..20.0f64, any::<bool>()).prop_map(|(grid, (tick_hz, fraction_bits), tolerance_ticks, packed)| {
        let mut settings = Settings::new(tick_hz, fraction_bits);
        settings.limits.pull_in = 1e9;
        Settings { grid, tolerance_ticks, packed, ..settings }
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    /// The sign of θ − level a tolerance before and after each step says whether the crossing lies between.
    #[test]
    fn every_step_is_within_its_certificate(
        speed in -2000.0..2000.0f64,
        terms in prop::collection::vec((1.0..400.0f64, 0.3..60.0f64, 0.0..6.2f64), 1..4),
        settings in any_settings(),
    ) {
        let law = law(speed, &terms, 3.0);
        let theta = |t: f64| speed * t + terms.iter().map(|(a, w, p)| a * (w * t + p).cos()).sum::<f64>();
        let start = theta(0.0);
        let replay = replay(&law, &settings)?;
        prop_assert!(replay.certificate.bound_ticks <= settings.tolerance_ticks);
        let bound_s = replay.certificate.bound_ticks / settings.tick_hz as f64;
        let mut position = 0;
        let mut last = i64::MIN;
        for &(tick, after) in &replay.steps {
            prop_assert!(tick >= last, "time goes back at tick {tick}");
            last = tick;
            let t = tick as f64 / settings.tick_hz as f64;
            let (sign, level) = if after > position {
                (1.0, settings.grid.up_level(position))
            } else {
                (-1.0, settings.grid.down_level(position))
            };
            prop_assert_eq!((after - position).abs(), 1);
            // Rounding of θ in f64 is far below a billionth of a step here.
            let (late, early) = (theta((t + bound_s).min(3.0)) - start, theta((t - bound_s).max(0.0)) - start);
            prop_assert!((late - level) * sign >= -1e-8, "step to {after} at {t} s is early");
            prop_assert!((early - level) * sign <= 1e-8, "step to {after} at {t} s is late");
            position = after;
        }
        // No crossing was missed: sampled finely, θ never leaves the band of the motor's position by more than the
        // bound explains.
        let mut next = replay.steps.iter().peekable();
        let mut at = 0;
        let fastest = speed.abs() + terms.iter().map(|(a, w, _)| a * w).sum::<f64>();
        for k in 0..=30_000 {
            let t = 3.0 * f64::from(k) / 30_000.0;
            while let Some(&&(_, after)) = next.peek().filter(|(tick, _)| *tick as f64 / settings.tick_hz as f64 <= t) {
                at = after;
                next.next();
            }
            let theta = theta(t) - start;
            let slack = fastest * bound_s + 1e-6;
            prop_assert!(theta <= settings.grid.up_level(at) + slack, "a step up from {at} is missing at {t} s");
            prop_assert!(theta >= settings.grid.down_level(at) - slack, "a step down from {at} is missing at {t} s");
        }
        prop_assert_eq!(replay.certificate.steps, replay.steps.len() as u64);
        prop_assert_eq!(replay.certificate.position, replay.steps.last().map_or(0, |s| s.1));
    }

    /// With a reversal gap, opposite steps are never closer, and what is dropped is dropped in pairs.
    #[test]
    fn close_opposite_steps_are_dropped_in_pairs(
        terms in prop::collection::vec((0.2..30.0f64, 0.3..60.0f64, 0.0..6.2f64), 1..3),
        gap in 1_000u64..400_000,
    ) {
        let law = law(0.0, &terms, 3.0);
        let mut settings = Settings::new(16_000_000, 16);
        settings.grid = Grid { hysteresis: 0.001 };
        settings.limits.pull_in = 1e9;
        let full = replay(&law, &settings)?;
        settings.reversal_ticks = gap;
        let replay = replay(&law, &settings)?;
        let mut last: Option<(i64, i64)> = None;
        let mut position = 0;
        for &(tick, after) in &replay.steps {
            let delta = after - position;
            if let Some((before, previous)) = last {
                prop_assert!(delta == previous || tick - before >= gap as i64, "gap of {}", tick - before);
            }
            last = Some((tick, delta));
            position = after;
        }
        let dropped = full.steps.len() - replay.steps.len();
        prop_assert_eq!(dropped as u64, 2 * replay.certificate.pairs_dropped);
        prop_assert_eq!(full.certificate.position, replay.certificate.position);
    }
}

/// A law that dies away: no search for turns that only rounding makes.
#[test]
fn a_law_that_dies_away_is_planned() {
    let law = Law::formula("1000*exp(-t)*cos(3*t)", &[], 1.0, Some(Time::from_seconds(1000.0))).unwrap();
    let mut settings = Settings::new(16_000_000, 16);
    settings.limits.pull_in = 2000.0;
    let replay = replay(&law, &settings).unwrap();
    assert_eq!(replay.certificate.position, -1000);
}

/// One that swings faster at its beginning than ever after by far is planned in windows that tell both.
#[test]
fn a_law_that_slows_down_is_planned() {
    for (text, end_s, turns) in [("10*sin(1/(t + 0.01))", 10.0, 31), ("10*sin(1/(t + 1e-3))", 1.0, 318)] {
        let law = Law::formula(text, &[], 1.0, Some(Time::from_seconds(end_s))).unwrap();
        let mut settings = Settings::new(125_000_000, 32);
        settings.limits.pull_in = 1e9;
        settings.min_interval_ticks = 1;
        let steps = replay(&law, &settings).unwrap_or_else(|error| panic!("{text}: {error}")).certificate.steps;
        // 20 steps between two turns.
        assert!(steps.abs_diff(20 * turns) <= 40, "{text}: {steps} steps");
    }
}

/// Where steps come fast, segments are long enough for a board that has some 1000 cycles' work with each: an Uno's ring holds 64 steps.
#[test]
fn fast_steps_come_in_long_segments() {
    let fast = |law: Law, what: &str| {
        let mut settings = Settings::new(16_000_000, 16);
        settings.tolerance_ticks = 16.0;
        let mut planner = Planner::new(&law, &settings).unwrap();
        while let Some(next) = planner.next_move().unwrap() {
            let Move::Run { segment, .. } = next else { continue };
            assert!(segment.interval >> 16 > 130 || segment.count >= 12, "{what}: {segment:?}");
        }
    };
    for k in 0..60 {
        let (hertz, rate) = (20.0 + 0.37 * f64::from(k), 130_000.0 + 400.0 * f64::from(k));
        let period = Time::from_seconds(1.0 / hertz);
        fast(Law::sine(rate / (TAU * hertz), period, Some(8)).unwrap(), &format!("{hertz} Hz, {rate} steps/s"));
        // To a top of some 100 steps.
        let law = Law::trapezoid(rate * rate / 6.6e6 + 30.0 + 2.0 * f64::from(k), rate, 6.6e6, 6.6e6).unwrap();
        fast(law, &format!("trapezoid, {rate} steps/s"));
    }
}

/// What a plan was allowed before a corner is not made good in the few steps that are left: steps there would have to be looked at one by
/// one by a board that is short of time.
#[test]
fn a_plan_is_as_smooth_before_a_corner_as_elsewhere() {
    for rate in (1..15).map(|k| 10_300.0 * f64::from(k)) {
        let law = Law::trapezoid(1.25 * rate, rate, 2.0 * rate, 2.0 * rate).unwrap();
        let mut settings = Settings::new(16_000_000, 16);
        settings.tolerance_ticks = 16.0;
        let mut planner = Planner::new(&law, &settings).unwrap();
        while let Some(next) = planner.next_move().unwrap() {
            let Move::Run { segment, .. } = next else { continue };
            let ticks = |value: i64| value as f64 / f64::from(1 << 16);
            // Slow ones change by more, and have the time.
            if ticks(segment.interval) < 2048.0 {
                assert!(ticks(segment.add2).abs() < 0.25, "{rate} steps/s: {segment:?}");
            }
        }
    }
}
