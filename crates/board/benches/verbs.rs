//! Figures of MOVE, SPEED and DIRECTION on the emulated Pico and Uno. `cargo xtask bench verbs` collects them.
//!
//! A table, fields between tabs: what, at what, the figure; a last field says `FAILS` where it is not what was asked for.

use pulsetrain_board::bridge::Bridge;
use pulsetrain_testkit::delays::{delay, uno_held_ticks};
use pulsetrain_testkit::examples::{Ran, dds_circle, delta, lorenz_attractor};

/// The example's rate of arithmetic, Hz.
const LORENZ_HZ: f64 = 50.0;

fn main() {
    for rate in [100, 1000, 10_000, 100_000] {
        for (turns, verb) in [(false, "SPEED"), (true, "DIRECTION")] {
            let times = if rate == 100 { 40 } else { 200 };
            let delay = delay(rate, turns, times);
            let figure = format!("{} steps, {:.0} µs; holds after {:.0} µs", delay.steps, delay.us, delay.held_us);
            row(
                &format!("from {verb} to the first step that shows it, at most"),
                &format!("{rate} steps/s"),
                &figure,
                delay.is_kept(),
            );
        }
    }
    let circle = dds_circle(33);
    let figure = format!("{:.1} half steps", circle.error);
    row("radial error, at most", "dds_circle, radius 400 half steps, four times round", &figure, true);
    load("dds_circle", &circle);
    let lorenz = lorenz_attractor(30);
    let figure = format!("{:.1} half steps", lorenz.error);
    row("distance from its sums, at most", "lorenz, 30 s", &figure, true);
    load("lorenz", &lorenz);
    let cycles = lorenz.load * 125e6 / LORENZ_HZ;
    row("cycles in 1/50 s, all of them", "lorenz", &format!("{cycles:.0}"), true);
    let (robot, points) = delta(20);
    row("points that it came to, all three arms at once, to the half step", "delta, 20 s", &points.to_string(), true);
    load("delta", &robot);
    uno();
}

/// On an Uno, from a host's call to the tick from which an order to all motors holds.
fn uno() {
    let shield = [(2, 5), (3, 6), (4, 7), (12, 13)];
    for (name, bridge) in Bridge::ALL {
        for motors in 1..=4 {
            let ticks = [1, 4].map(|slower| uno_held_ticks(&shield[..motors], slower, bridge));
            let figure = format!("{:.1} ms", ticks.into_iter().max().unwrap_or(0) as f64 / 16_000.0);
            row(
                "Uno: from the host's call to the tick from which an order holds, at most",
                &format!("{motors} motors that run, behind a {name}"),
                &figure,
                true,
            );
        }
    }
}

fn load(name: &str, ran: &Ran) {
    row("share of the processor's time", name, &format!("{:.2} %", 100.0 * ran.load), true);
}

fn row(what: &str, at: &str, figure: &str, holds: bool) {
    println!("{what}\t{at}\t{figure}\t{}", if holds { "" } else { "FAILS" });
}
