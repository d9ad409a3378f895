//! Laws and settings that nobody should ask for: each is planned within its certificate or refused, and soon.

use pulsetrain_motion::law::{Law, LawError};
use pulsetrain_motion::{Grid, Time};
use pulsetrain_plan::{Certificate, Move, PlanError, Planner, Settings};

/// Moves that are looked at: endless laws never end.
const MOVES: usize = 40;

/// Plans the beginning of `law`; every step must come at least the shortest interval after the one before.
fn plan(law: &Law, settings: &Settings) -> Result<Certificate, PlanError> {
    let mut planner = Planner::new(law, settings)?;
    let mut accumulator = 1_i128 << (settings.registers.fraction_bits - 1);
    let mut last: Option<i128> = None;
    let mut dwells = 0;
    for _ in 0..MOVES {
        match planner.next_move()? {
            None => break,
            Some(Move::Dwell { ticks }) => {
                accumulator += i128::from(ticks) << settings.registers.fraction_bits;
                dwells += 1;
                if dwells > 3 {
                    break;
                }
            }
            Some(Move::Run { segment, .. }) => {
                // The first thousand stand for the rest.
                for k in 1..=segment.count.min(1000) {
                    let tick = (accumulator + segment.span(k)) >> settings.registers.fraction_bits;
                    let apart = last.replace(tick).map_or(i128::MAX, |last| tick - last);
                    assert!(apart >= i128::from(settings.min_interval_ticks), "{apart} ticks apart");
                }
                accumulator += segment.span(segment.count);
                last = Some(accumulator >> settings.registers.fraction_bits);
            }
        }
    }
    let certificate = planner.certificate();
    assert!(certificate.bound_ticks <= settings.tolerance_ticks, "{certificate:?}");
    Ok(certificate.clone())
}

fn seconds(s: f64) -> Time {
    Time::from_seconds(s)
}

fn formula(text: &str, end_s: Option<f64>) -> Result<Law, LawError> {
    Law::formula(text, &[], 1.0, end_s.map(seconds)).map_err(|e| LawError::Parameter(e.message))
}

fn laws() -> Vec<Result<Law, LawError>> {
    let mut laws = Vec::new();
    for amplitude in [1e-300, 0.2, 0.5, 25.0, 1e9, 9.9e14] {
        for period in [1e-12, 1e-6, 1.0, 1e12] {
            laws.push(Law::sine(amplitude, seconds(period), Some(1)));
            let endless = Law::sine(amplitude, seconds(period), None);
            laws.push(endless.clone());
            laws.push(endless.clone().and_then(|law| law.delayed(seconds(1e12))));
            laws.push(endless.and_then(|law| Law::sum(vec![law, Law::speed(1000.0, None)?])));
        }
    }
    for speed in [1e-300, 1e-9, 1.0, 1e6, 1e12] {
        for end in [None, Some(seconds(1e-9)), Some(seconds(1e12))] {
            let law = Law::speed(speed, end);
            laws.push(law.clone());
            laws.push(law.and_then(|law| law.scaled(1e12)));
        }
    }
    for (distance, speed, up, down) in
        [(1.0, 1e12, 1e12, 1e-9), (1e15, 1e12, 1e-6, 1e12), (1e-9, 1.0, 1.0, 1.0), (1e12, 1.0, 1e12, 1e12)]
    {
        laws.push(Law::trapezoid(distance, speed, up, down));
    }
    for text in [
        "1e300*t",
        "1e15*sin(1e9*t)",
        "sin(1e50*t)",
        "exp(t)",
        "exp(exp(t))",
        "1/t",
        "1/(t - 1)",
        "sqrt(t)",
        "t^0.3",
        "abs(sin(1000*t))",
        "1000*floor(t)",
        "t^40",
        "1000*sin(t^3)",
        "1000*sin(1/(t + 1e-6))",
        "1e18*t - 1e18*t",
        "1e9*sin(t)*sin(1e3*t)*sin(1e6*t)",
        "tan(t)",
    ] {
        for end in [Some(1e-6), Some(3.0), None] {
            laws.push(formula(text, end));
        }
    }
    for c in [
        vec![0.0, f64::MAX],
        vec![0.0, 0.0, f64::MAX],
        vec![1e15, -1e15, 1e15, -1e15],
        vec![0.0, f64::MIN_POSITIVE],
        vec![1.0; 40],
        vec![],
    ] {
        for duration in [5e-20, 1e-9, 1.0, 1e9, 1e18, 1e30] {
            laws.push(Law::polynomials([(seconds(duration), c.clone())]));
        }
    }
    laws
}

fn all_settings() -> Vec<Settings> {
    let mut all = Vec::new();
    for (tick_hz, fraction_bits, min_interval_ticks) in [(16_000_000, 16, 160), (125_000_000, 32, 5), (1, 16, 1)] {
        for tolerance_ticks in [0.55, 16.0, f64::INFINITY] {
            for grid in [Grid::NEAREST, Grid::REACH] {
                for packed in [false, true] {
                    let mut settings = Settings::new(tick_hz, fraction_bits);
                    settings.limits.pull_in = f64::INFINITY;
                    all.push(Settings {
                        tolerance_ticks,
                        packed,
                        grid,
                        min_interval_ticks,
                        reversal_ticks: 300,
                        ..settings
                    });
                }
            }
        }
    }
    all
}

/// Every ninth of the settings for each law, another ninth for the next.
#[test]
fn wild_laws_are_planned_or_refused() {
    let settings = all_settings();
    let (mut planned, mut refused) = (0, 0);
    for (row, law) in laws().into_iter().enumerate() {
        let Ok(law) = law else { continue };
        for settings in settings.iter().skip(row % 9).step_by(9) {
            match plan(&law, settings) {
                Ok(_) => planned += 1,
                Err(_) => refused += 1,
            }
        }
    }
    assert!(planned > 100 && refused > 100, "{planned} planned, {refused} refused");
}
