//! Plots of the tutorial's motion, from its own equations.

use pulsetrain_motion::program::Scale;
use pulsetrain_motion::{Law, Time};
use pulsetrain_plot::{Errors, FilmFrame, FilmPicture, MotorPicture, Picture};
use pulsetrain_testkit::folder::Folder;

/// The tutorial's equation 3, on the Uno's ticks.
fn tutorial(period: f64) -> Picture {
    let (amplitude, omega, tick) = (2000.0, std::f64::consts::TAU / period, 62.5e-9);
    let scale = Scale { unit: "rev".into(), steps_per_unit: 800.0, steps_per_rev: 800.0 };
    let mut motor = MotorPicture::new("crank".into(), scale, 0.93);
    let law = Law::sine(amplitude, Time::from_seconds(period), Some(1)).unwrap();
    motor.want_law(&law, Time::MAX).unwrap();
    for n in 1..=8000i64 {
        let reach = if n <= 4000 { n } else { 8000 - n };
        let forward = (1.0 - reach as f64 / amplitude).acos() / omega;
        let exact = if n <= 4000 { forward } else { period - forward };
        let scheduled = (exact / tick).round() * tick;
        motor.step(scheduled, reach);
        motor.error(scheduled, (scheduled - exact) / tick);
    }
    let title = format!("tutorial, T = {period} s");
    let mut picture = Picture {
        title,
        tick_s: tick,
        motors: vec![motor],
        errors: Errors::Ticks,
        figures: Vec::new(),
        changes: Vec::new(),
    };
    let window = picture.close_view().unwrap();
    picture.motors[0].want_closely(&law, window).unwrap();
    picture
}

#[test]
fn svg_names_axes_with_their_units_and_stays_small() {
    let svg = tutorial(1.0).svg().unwrap();
    for text in
        ["Position, rev", "Interval", "step number", "Speed, rev/s", "time, s", "Error of crank, ticks", "tick 62.5 ns"]
    {
        assert!(svg.contains(text), "{text}");
    }
    assert!(svg.len() < 700_000, "{} bytes", svg.len());
}

/// The bound of the plan is not that of a board whose edges may be late: the panel names both.
#[test]
fn the_error_panel_names_the_boards_lateness() {
    let mut picture = tutorial(1.0);
    assert!(picture.svg().unwrap().contains("Error of crank, ticks; proven: at most 0.93"));
    picture.motors[0].late_ticks = 56.0;
    let svg = picture.svg().unwrap();
    assert!(svg.contains("Error of crank at its pin, ticks; plan ±0.93, board +56"), "{svg}");
}

#[test]
fn png_is_written() {
    let folder = Folder::new("plot");
    let path = folder.path("plot.png");
    std::fs::write(&path, tutorial(500.0).png().unwrap()).unwrap();
    assert!(std::fs::read(&path).unwrap().starts_with(b"\x89PNG"));
}

/// Where steps were lost stands above the lines of the limit.
#[test]
fn notes_of_a_film_cover_no_line() {
    let frame = |k: u32| {
        let at_s = f64::from(k) / 100.0;
        FilmFrame { at_s, angle_deg: 90.0 * at_s, law_deg: 90.0 * at_s, sigma_deg: 0.02 }
    };
    let notes = [0.2, 0.25, 0.9].map(|at_s| (at_s, "8 steps lost".to_owned()));
    let picture = FilmPicture {
        title: "film".into(),
        frames: (0..100).map(frame).collect(),
        law: vec![(0.0, 0.0), (1.0, 90.0)],
        limit_deg: 1.0,
        notes: notes.to_vec(),
    };
    let svg = picture.svg().unwrap();
    let number = |line: &str, key: &str| -> f64 {
        line.split(&format!(" {key}=\"")).nth(1).and_then(|rest| rest.split('"').next()).unwrap().parse().unwrap()
    };
    // The text's own line follows its tag.
    let lines: Vec<&str> = svg.lines().collect();
    let labels: Vec<(f64, f64)> = lines
        .windows(2)
        .filter(|pair| pair[1].contains("8 steps lost"))
        .map(|pair| (number(pair[0], "x"), number(pair[0], "y")))
        .collect();
    assert_eq!(labels.len(), 3, "{svg}");
    // The upper limit is the highest dash in the lower panel.
    let dashes = lines.iter().filter(|line| line.starts_with("<polyline") && line.matches(',').count() == 2);
    let heights =
        dashes.filter_map(|line| line.split("points=\"").nth(1)?.split([',', ' ']).nth(1)?.parse::<f64>().ok());
    let limit = heights.filter(|y| *y > labels[0].1).fold(f64::INFINITY, f64::min);
    assert!(limit.is_finite() && labels.iter().all(|label| label.1 + 13.0 < limit), "{labels:?} {limit}");
    assert!((labels[0].1 - labels[1].1).abs() > 13.0, "{labels:?}");
}
