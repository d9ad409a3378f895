//! Whole motions on the virtual Uno: planned, streamed by a session, and compared with the law, step by step and edge
//! by edge.

use crate::common::motion::make;
use crate::common::rows::{hour, tutorial};
use pulsetrain::load;
use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Board, Edge, Remote, RemoteError, Setup};
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::MotorSetup;
use pulsetrain_motion::boards::uno::PinKind;
use pulsetrain_motion::{Time, boards};
use pulsetrain_session::drive::{DriveError, Driven};
use pulsetrain_session::prepare::Prepared;

/// A period of 500 ms of ±200 steps, on one motor's pins.
fn swing((step, dir): (u8, u8)) -> Prepared {
    let mut prepared = tutorial(Time::from_ratio(4, 1), 1, (step, dir), 1000);
    prepared.program.motors[0].law =
        pulsetrain_motion::Law::sine(200.0, Time::from_ratio(1, 1), Some(1)).expect("a sinusoid");
    prepared
}

/// The greatest delay of edges by software, cycles.
const LATE: i64 = 60;

/// The table's queues are those of the firmware.
#[test]
fn queues_are_as_long_as_the_table_says() {
    let row = boards::find("uno").expect("the Uno's row");
    for (motors, bytes) in (1..).zip(row.queue_bytes) {
        let pins = [(2, 5), (3, 6), (4, 7), (12, 13)];
        let motor = |&(step_pin, dir_pin): &(u8, u8)| MotorSetup { step_pin, dir_pin, ..MotorSetup::default() };
        let motors: Vec<MotorSetup> = pins.iter().take(motors).map(motor).collect();
        let setup = Setup { pulse_ticks: 16, setup_ticks: 16, hold_ticks: 16, motors, ..Setup::default() };
        let mut uno = Remote::open(VirtualUno::new(), 1).expect("it answers");
        uno.configure(&setup).expect("it takes the configuration");
        for motor in 0..setup.motors.len() {
            assert_eq!(uno.room(motor), *bytes as usize, "motor {motor} of {}", setup.motors.len());
        }
    }
}

/// Motors on one DIR line need the most stack in an interrupt, and frames and answers the most in the main loop. The
/// two together must fit. (Once they did not, and after 49 s of the sweep bytes below the stack were overwritten.)
#[test]
fn motors_on_one_dir_line_leave_some_of_the_stack() {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/sweep.toml");
    let length = Some(Time::from_ratio(10, 1));
    let prepared = load::load(std::path::Path::new(file), Some("uno"), length).expect("an example");
    let mut driven = Driven::at(&prepared, VirtualUno::new(), Baud::B1M).expect("it begins");
    driven.run(&mut |_: Edge| {}, |_| {}).expect("it comes to its end");
    let left = driven.board_mut().measures(false).expect("it answers").stack_left;
    assert!(left >= 40, "{left} bytes are left");
}

/// Plans go only to the image that plays them.
#[test]
fn a_motion_wants_the_image_that_takes_plans() {
    for (uno, has) in [(VirtualUno::with_winch(), "winch"), (VirtualUno::with_verbs(), "verbs")] {
        let refused = Driven::at(&swing((8, 9)), uno, Baud::B1M).err();
        let refused = match refused {
            Some(DriveError::Remote(RemoteError::OtherImage { is, wanted })) => (is, wanted),
            other => panic!("{other:?}"),
        };
        assert_eq!(refused, (has, "uno"));
    }
}

/// The constant of each kind of pins is the delay of its edges if nothing keeps them waiting.
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
        let mut prepared = swing(pins);
        prepared.program.board = boards::find("uno").expect("the Uno's row").limits();
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
            // A sleeping processor takes 4 cycles more. No edge comes before an instruction's end.
            assert!(lateness.min_ticks >= -1 && lateness.p50_ticks.abs() <= 4, "{pins:?}: {lateness:?}");
        }
    }
}

/// The shield's pins, on both ports.
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
    // Two motors: steps that lie close together share a group, or wait for it.
    assert!(lateness.min_ticks >= -LATE && lateness.max_ticks <= LATE, "{lateness:?}");
}

/// No step is scheduled farther from its time than was proven.
#[test]
fn scheduled_within_the_certificate() {
    let prepared = tutorial(Time::from_ratio(10, 1), 1, (8, 9), 1000);
    let made = make(&prepared, LATE as f64, |_| {}).expect("it begins");
    assert_eq!(made.seen.trouble, "");
    assert_eq!(made.schedules[0].steps, 8000);
    let largest = made.largest();
    assert!(largest <= made.certificate_ticks && largest > 0.5, "{largest} of {}", made.certificate_ticks);
}

/// The sweep article's motors, as `cargo xtask bench uno --hour` has them for an hour.
#[test]
fn four_motors_on_one_dir_line_keep_their_phase() {
    let rows = hour(10);
    assert_eq!(rows.len(), 5);
    for row in rows {
        assert_eq!(row.verdict, "", "{}", row.law);
    }
}
