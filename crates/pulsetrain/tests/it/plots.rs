//! Plots of the tutorial's motion, from its own equations.

use pulsetrain_motion::program::Scale;
use pulsetrain_motion::{Law, Time};
use pulsetrain_plot::{Errors, MotorPicture, Picture};
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
    let mut picture = Picture { title, tick_s: tick, motors: vec![motor], errors: Errors::Ticks, figures: Vec::new() };
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
