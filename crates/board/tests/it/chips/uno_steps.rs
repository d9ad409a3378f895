//! The firmware's step path under load, on the emulated chip: long streams of random segments, every step and edge.
//!
//! How fast it can be at most is measured by `cargo xtask bench uno`; these are rates that it must do whatever changes.

use pulsetrain_board::{Board, Faults};
use pulsetrain_core::wire::message::Cause;
use pulsetrain_testkit::lab::{EXACT, Lab, SOFTWARE, Timing, said, uno};
use pulsetrain_testkit::segments::{Law, Stream};
use pulsetrain_testkit::{TICK_HZ, uno_setup};

/// Streams `law` to motors on `pins` for 0.2 s: every step is on the pins in its time, and no other; none is left out at the
/// end.
fn check(pins: &[(u8, u8)], law: Law, timing: Timing) {
    check_run(pins, law, timing, Run { apart: 1.0, pulse_ticks: 16, seed: 1, ticks: TICK_HZ / 5 });
}

/// A run that is not the usual one.
#[derive(Clone, Copy, Debug)]
struct Run {
    /// 0: in phase.
    apart: f64,
    pulse_ticks: u16,
    seed: u64,
    ticks: u64,
}

fn check_run(pins: &[(u8, u8)], law: Law, timing: Timing, run: Run) {
    let setup = uno_setup(pins, run.pulse_ticks);
    let mut board = uno(&setup);
    let mut lab = Lab::default();
    let mut stream = Stream::new(&board, &vec![law; pins.len()], run.apart, run.seed, run.ticks);
    let mut due = vec![Vec::new(); pins.len()];
    let played = stream.play(&mut board, &mut lab, |stream, board| {
        for (source, due) in stream.sources.iter_mut().zip(&mut due) {
            due.extend(source.due.drain(..));
        }
        let told = board.board_mut().events();
        match told.iter().find(|event| event.cause != Cause::Finished) {
            Some(event) => {
                Err(format!("{:?}, {} ticks after the begin", event, event.tick.saturating_sub(stream.begin)))
            }
            None => Ok(()),
        }
    });
    let what = format!("{pins:?}, {law:?}, {run:?}");
    assert_eq!(played, Ok(()), "{what}");
    assert_eq!(board.board().error(), None, "{what}");
    // The native board's steps are those that the segments mean, worked out here in wide integers.
    for (motor, due) in due.iter().enumerate() {
        let steps = lab.steps.iter().filter(|step| step.motor == motor).map(|step| step.tick);
        assert!(steps.eq(due.iter().copied()), "{what}: motor {motor}");
        assert_eq!(board.faults(motor), Faults::default(), "{what}");
    }
    assert_eq!(said(&mut board), lab.counts(&setup), "{what}");
    lab.check(&setup, timing, None);
    let least = 0.75 * law.rate * run.ticks as f64 / TICK_HZ as f64 * pins.len() as f64;
    assert!(lab.steps.len() as f64 > least, "{what}: {} steps", lab.steps.len());
}

#[test]
fn one_motor() {
    check(&[(2, 5)], Law::changing(2e3), SOFTWARE);
    check(&[(2, 5)], Law::changing(20e3), SOFTWARE);
    check(&[(8, 9)], Law { turns: 5, ..Law::changing(10e3) }, SOFTWARE);
}

#[test]
fn the_compare_hardware_is_never_late() {
    check(&[(9, 8)], Law::changing(20e3), EXACT);
    check(&[(9, 8), (10, 7)], Law::changing(20e3), EXACT);
    check(&[(10, 13)], Law { turns: 5, ..Law::changing(10e3) }, EXACT);
}

/// Groups of both are near one another throughout: a compare register that is written late makes steps that are lost, or upside down.
#[test]
fn two_of_the_compare_hardwares_in_phase() {
    let pins = &[(9, 8), (10, 7)];
    for seed in [1, 2, 3] {
        for (apart, pulse_ticks) in [(0.0, 40), (0.02, 40), (0.1, 40), (0.0, 80), (0.0, 125)] {
            let run = Run { apart, pulse_ticks, seed, ticks: 2 * TICK_HZ };
            check_run(pins, Law::changing(3.5e3), EXACT, run);
        }
        let run = Run { apart: 0.0, pulse_ticks: 16, seed, ticks: TICK_HZ };
        check_run(pins, Law { turns: 2, ..Law::changing(35e3) }, EXACT, run);
    }
}

#[test]
fn several_motors_in_one_ring() {
    check(&[(2, 5), (3, 6)], Law::changing(10e3), SOFTWARE);
    check(&[(8, 11), (9, 12), (10, 13)], Law { turns: 5, ..Law::changing(2e3) }, SOFTWARE);
    check(&[(2, 5), (3, 6), (4, 7), (12, 13)], Law::changing(5e3), SOFTWARE);
}
