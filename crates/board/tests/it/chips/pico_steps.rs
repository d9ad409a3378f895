//! The Pico's firmware on the emulated chip: its first words with a host, and its first steps.

use pulsetrain_board::virtual_pico::VirtualPico;
use pulsetrain_board::{Board, Edge, Lease, Leased, Remote, Setup};
use pulsetrain_core::wire::message::MotorSetup;
use pulsetrain_core::{Direction, Entry, Epoch, Item, Segment, Tick32};

#[test]
fn steps_come_when_they_are_due() {
    let mut remote = Remote::open(VirtualPico::new(), 1).expect("it answers");
    let motor = |step_pin| MotorSetup { step_pin, dir_pin: step_pin + 1, forward_high: true, ..MotorSetup::default() };
    let setup = Setup { pulse_ticks: 125, setup_ticks: 25, motors: vec![motor(2), motor(10)], ..Setup::default() };
    remote.configure(&setup).expect("it is possible");
    let at = remote.now() + remote.round_trip() + 1_000_000;
    for motor in 0..2 {
        let segment = Segment { count: 100, interval: 1000 << 32, add: 0, add2: 0 };
        for item in [Item::Anchor { tick: Tick32::of(at) }, Item::Run { segment, direction: Direction::Forward }] {
            remote.push(motor, Entry { epoch: Epoch(1), item }).expect("room");
        }
    }
    remote.switch(Epoch(1), at, Lease::Last, &[]).expect("in time");
    let mut edges = Vec::new();
    remote.advance(at + 200_000, &mut |edge: Edge| edges.push(edge));
    let ticks = |line: u8, level: bool| edges.iter().filter(move |edge| (edge.line, edge.level) == (line, level));
    for step_pin in [2, 10] {
        // On their ticks, all 8 ns of them, and pulses as long as they are to be.
        let due = (1..=100).map(|step| at + 1000 * step);
        assert!(ticks(step_pin, true).map(|edge| edge.tick).eq(due.clone()), "STEP rises on pin {step_pin}");
        assert!(
            ticks(step_pin, false).map(|edge| edge.tick).eq(due.map(|tick| tick + 125)),
            "STEP falls on pin {step_pin}"
        );
    }
    remote.status().expect("it answers");
    assert_eq!(remote.positions(), [100, 100]);
}
