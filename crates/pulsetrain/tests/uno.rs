//! Motions on the virtual Uno, whole: planned, streamed by a session, and held against the law, step by step, edge by edge.

mod common;

use common::motion::make;
use common::rows::tutorial;
use pulsetrain::prepare::Prepared;
use pulsetrain_motion::Time;
use pulsetrain_motion::pins::PinKind;

/// A period of 500 ms of ±200 steps, on one motor's pins.
fn swing((step, dir): (u8, u8)) -> Prepared {
    let mut prepared = tutorial(Time::from_ratio(4, 1), 1, (step, dir), 1000);
    prepared.program.motors[0].law =
        pulsetrain_motion::Law::sine(200.0, Time::from_ratio(1, 1), Some(1)).expect("a sinusoid");
    prepared
}

/// Software pins may be so late, cycles.
const LATE: i64 = 60;

/// Each kind's constant is what its edges come after their ticks if nothing keeps them waiting.
#[test]
fn constants_are_what_is_measured() {
    for (pins, kind) in [
        ((9, 8), PinKind::Compare),
        ((10, 13), PinKind::Compare),
        ((2, 5), PinKind::PortD),
        ((6, 7), PinKind::PortD),
        ((8, 9), PinKind::PortB),
        ((12, 13), PinKind::PortB),
    ] {
        let prepared = swing(pins);
        assert_eq!(PinKind::of(&prepared.program.motors), Ok(kind));
        let made = make(&prepared, LATE as f64, |_| {}).expect("it begins");
        let seen = made.seen;
        assert_eq!(seen.trouble, "", "{pins:?}");
        let lateness = seen.lateness;
        assert_eq!((lateness.edges, lateness.lost, lateness.extra), (800, 0, 0), "{pins:?}");
        assert_eq!(lateness.constant_ticks, u64::from(kind.constant_ticks()));
        if kind == PinKind::Compare {
            assert_eq!((lateness.min_ticks, lateness.max_ticks), (0, 0), "{pins:?}");
        } else {
            // A processor that sleeps takes 4 cycles more; nothing is earlier than an instruction's end.
            assert!(lateness.min_ticks >= -1 && lateness.p50_ticks.abs() <= 4, "{pins:?}: {lateness:?}");
        }
    }
}

/// The shield's: both ports.
#[test]
fn the_shields_constant_too() {
    let mut prepared = swing((2, 5));
    let mut other = prepared.program.motors[0].clone();
    other.name = "other".to_owned();
    other.wiring = pulsetrain_motion::program::Wiring::StepDir { step: 12, dir: 13, forward_high: true, enable: None };
    prepared.program.motors.push(other);
    assert_eq!(PinKind::of(&prepared.program.motors), Ok(PinKind::Shield));
    let made = make(&prepared, LATE as f64, |_| {}).expect("it begins");
    assert_eq!(made.seen.trouble, "");
    let lateness = made.seen.lateness;
    assert_eq!((lateness.edges, lateness.lost, lateness.extra), (1600, 0, 0));
    assert!(lateness.min_ticks >= -1 && lateness.p50_ticks.abs() <= 4, "{lateness:?}");
}

/// No step is scheduled further from its time than was proven.
#[test]
fn scheduled_within_the_certificate() {
    let prepared = tutorial(Time::from_ratio(10, 1), 1, (8, 9), 1000);
    let made = make(&prepared, LATE as f64, |_| {}).expect("it begins");
    assert_eq!(made.seen.trouble, "");
    assert_eq!(made.schedules[0].steps, 8000);
    let largest = made.largest();
    assert!(largest <= made.certificate_ticks && largest > 0.5, "{largest} of {}", made.certificate_ticks);
}
