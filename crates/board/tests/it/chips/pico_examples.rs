//! The library's examples, on the emulated chip, without a host: what they draw, what they take of the processor, and what they leave
//! to others.

use pulsetrain_testkit::examples::{Ran, dds_circle, delta, lorenz_attractor};

/// Of the processor, what an example may take.
const MOST_LOAD: f64 = 0.07;

fn look(name: &str, ran: &mut Ran) {
    println!("{name}: {} moments with steps, {:.2} off, load {:.2} %", ran.steps.len(), ran.error, 100.0 * ran.load);
    assert!(ran.load < MOST_LOAD, "{}", ran.load);
    // PIO block 1 is as after a reset: the program's own.
    const RESETS_DONE: u32 = 0x4000_c008;
    let done = ran.pico.chip_mut().read(RESETS_DONE, &mut ());
    assert_eq!(done >> 10 & 0b11, 0b01);
}

#[test]
fn a_circle_by_synthesis() {
    let mut ran = dds_circle(17);
    look("circle", &mut ran);
    // Twice round, and an eighth.
    assert!(ran.steps.len() > 6400, "{}", ran.steps.len());
    assert!(ran.error < 3.5, "{}", ran.error);
}

#[test]
fn the_lorenz_attractor() {
    // As long as a drift would need to show.
    let mut ran = lorenz_attractor(120);
    look("lorenz", &mut ran);
    assert!(ran.steps.len() > 12_000, "{}", ran.steps.len());
    assert!(ran.error < 3.0, "{}", ran.error);
}

#[test]
fn a_delta_robot_picks_and_places() {
    let (mut ran, visited) = delta(12);
    look("delta", &mut ran);
    assert!(visited >= 12, "{visited} of the points, twice round at least");
}
