//! Law × tick rate → steps, largest error, shortest interval: one table that a reviewer reads.
//!
//! `cargo xtask golden` writes it again.

use crate::common::laws::{constant_speed, sine, trapezoid, waves};
use crate::common::lorenz::lorenz;
use crate::common::{BOARDS, packed_bytes, settings, steps};
use expect_test::expect_file;
use pulsetrain_motion::{Grid, Law, Time};
use pulsetrain_oracle::{Crossing, Rational, Sine, Trapezoid, Wave, Waves, rational};
use pulsetrain_plan::Settings;
use std::fmt::Write as _;

struct Row {
    name: &'static str,
    law: Law,
    grid: Grid,
    /// When its steps are due; none where nobody knows better than the law itself.
    exact: Option<Vec<Crossing>>,
}

fn rows() -> Vec<Row> {
    let (nearest, reach) = (rational(1, 64), rational(1, 2));
    let tutorial = Sine::new(4000, &reach);
    let mut rows: Vec<_> =
        [("tutorial, T = 500 s", (500, 1)), ("tutorial, T = 1 s", (1, 1)), ("tutorial, T = 0.01 s", (1, 100))]
            .into_iter()
            .map(|(name, (numerator, denominator))| Row {
                name,
                law: sine(2000.0, Time::from_ratio(numerator, denominator), 1),
                grid: Grid::REACH,
                exact: Some(tutorial.crossings(&rational(numerator.into(), denominator.into()), 1).collect()),
            })
            .collect();
    let mut row = |name, law, exact| rows.push(Row { name, law, grid: Grid::NEAREST, exact });
    row(
        "odd swing, 25 steps at 4 Hz",
        sine(12.5, Time::from_ratio(1, 4), 4),
        Some(Sine::new(25, &nearest).crossings(&rational(1, 4), 4).collect()),
    );
    row(
        "trapezoid to 10 000 steps/s",
        trapezoid(5000.0, 10_000.0, 100_000.0),
        Some(Trapezoid::new(5000, 10_000.into(), 100_000.into(), 100_000.into()).crossings(&nearest).collect()),
    );
    row(
        "constant, 1234 steps/s",
        constant_speed(1234.0, (1000.0 + 0.25) / 1234.0),
        Some(Trapezoid::constant_speed(1234.into(), 1000).crossings(&nearest).collect()),
    );
    let wave = |amplitude: i64, omega: i64| Wave { amplitude: Rational::from(amplitude), omega: Rational::from(omega) };
    let two = Waves { speed: 1000.into(), waves: vec![wave(300, 7), wave(50, 31)] };
    row(
        "1000t + 300 sin 7t + 50 sin 31t, 2 s",
        waves(1000.0, &[(300.0, 7.0), (50.0, 31.0)], 2.0),
        Some(two.crossings(&nearest, 2, 200_000)),
    );
    row("Lorenz, 500·∫x dt, 2 s", lorenz(500.0, 2.0), None);
    rows
}

#[test]
fn laws_by_tick_rate() {
    let mut table = String::new();
    let _ = writeln!(
        table,
        "{:36} {:>9} {:>6} {:>8} {:>8} {:>6} {:>7} {:>7} {:>9}",
        "law", "tick_hz", "steps", "position", "segments", "bytes", "error", "bound", "shortest"
    );
    for Row { name, law, grid, exact } in rows() {
        for board in BOARDS {
            let settings = Settings { grid, ..settings(board) };
            let tick_hz = settings.tick_hz;
            let (steps, c) = steps(&law, &settings).unwrap_or_else(|error| panic!("{name} at {tick_hz} Hz: {error}"));
            let bytes = packed_bytes(&law, &settings).unwrap_or_else(|error| panic!("{name} at {tick_hz} Hz: {error}"));
            let shortest = steps.windows(2).map(|w| w[1].tick - w[0].tick).min().unwrap_or(0);
            let error = exact.as_ref().map_or("-".to_owned(), |exact| {
                let errors = exact.iter().zip(&steps).map(|(due, step)| due.error_ticks(tick_hz, step.tick));
                format!("{:.3}", errors.fold(0.0, f64::max))
            });
            let _ = writeln!(
                table,
                "{name:36} {tick_hz:9} {:6} {:8} {:8} {bytes:6} {error:>7} {:7.3} {shortest:9}",
                c.steps, c.position, c.segments, c.bound_ticks
            );
        }
    }
    expect_file!["golden/laws_by_tick_rate.txt"].assert_eq(&table);
}
