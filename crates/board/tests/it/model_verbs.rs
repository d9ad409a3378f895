//! Motors of the model board that are told directly: what a host is told, and in which order. The Pico's are in pico_verbs.rs.

use pulsetrain_board::{Board, Edge, Lease, Leased, Port, Remote, RemoteError};
use pulsetrain_core::Epoch;
use pulsetrain_core::verbs::{Heading, Verb};
use pulsetrain_core::wire::message::{Cause, Reason, flags};
use pulsetrain_testkit::model::ModelPort;
use pulsetrain_testkit::{TICK_HZ, model_setup, run, tell};
use std::time::Duration;

fn connect(motors: u8) -> Remote<ModelPort> {
    let mut remote = Remote::open(ModelPort::new(), 7).expect("it answers");
    remote.configure(&model_setup(motors)).expect("it can");
    remote
}

/// Bit by motor: stopped faster than it can.
fn uncertain(remote: &mut Remote<ModelPort>) -> u8 {
    let status = remote.status().expect("it answers");
    let flagged = status.motors.as_slice().iter().map(|motor| u8::from(motor.faults & flags::UNCERTAIN != 0));
    (0..).zip(flagged).fold(0, |all, (motor, flag)| all | flag << motor)
}

#[test]
fn rest_comes_after_the_last_period() {
    let mut remote = connect(1);
    let orders = [(0, Verb::Speed { ticks: 160_000 }), (0, Verb::Move { steps: 2 })];
    let done = remote.tell_motors(&orders).expect("it can").tick + 2 * 160_000;
    let status = loop {
        let status = remote.status().expect("it answers");
        if status.is_idle() {
            break status;
        }
    };
    assert!(status.head.tick >= done);
    remote.release().expect("it rests");
    remote.advance(remote.now() + TICK_HZ / 100, &mut |_: Edge| {});
    let events: Vec<_> = remote.events().into_iter().map(|event| event.cause).collect();
    assert_eq!(events, [Cause::MoveDone, Cause::Finished]);
}

/// After Bye, and after the silence of a host: what goes on, and who may stand elsewhere. Below 100 steps/s all can stop.
#[test]
fn who_is_left_alone_stops() {
    let orders = [
        (0, Verb::Speed { ticks: 16_000 }),
        (0, Verb::Move { steps: 3000 }),
        (0, Verb::Run),
        (1, Verb::Speed { ticks: 16_000 }),
        (1, Verb::Run),
        (2, Verb::Speed { ticks: 320_000 }),
        (2, Verb::Run),
        (3, Verb::Heading(Heading::Stationary)),
    ];
    for says_bye in [true, false] {
        let mut remote = connect(4);
        remote.tell_motors(&orders).expect("it can");
        remote.tell_motors(&[(3, Verb::Move { steps: 5 })]).expect("it can");
        remote.advance(remote.now() + TICK_HZ / 10, &mut |_: Edge| {});
        let silent = |mut port: ModelPort| {
            let until = port.now() + Duration::from_secs(5);
            while port.now() < until {
                port.receive(until, &mut Vec::new()).expect("a model");
            }
            port
        };
        let port = if says_bye { silent(remote.close()) } else { silent(std::mem::take(remote.port_mut())) };
        let positions = port.positions();
        let mut next = Remote::open(port, 8).expect("nobody has it");
        assert_eq!(uncertain(&mut next), if says_bye { 0b0010 } else { 0b0011 });
        assert_eq!((positions[0] == 3000, positions[3]), (says_bye, 0), "{positions:?}");
        assert!(positions[1] < if says_bye { 150 } else { 2300 }, "{positions:?}");
        next.configure(&model_setup(4)).expect("it rests");
        assert_eq!(uncertain(&mut next), 0);
    }
}

#[test]
fn a_first_order_that_does_nothing_changes_nothing() {
    let mut remote = connect(1);
    let refused = remote.tell_motors(&[(0, Verb::Speed { ticks: 3 })]).expect_err("too short");
    assert!(matches!(refused, RemoteError::Refused { reason: Reason::Period, .. }), "{refused}");
    assert_eq!(remote.tell_motors(&[]).expect("a question").motors()[0].position, 0);
    let from = remote.now() + TICK_HZ / 10;
    tell(&mut remote, 1, from, &[run(40, 16_000)]);
    remote.switch(Epoch(1), from, Lease::Last, &[]).expect("in time");
    remote.advance(from + TICK_HZ / 10, &mut |_: Edge| {});
    assert_eq!((remote.positions(), remote.error()), (vec![40], None));
}
