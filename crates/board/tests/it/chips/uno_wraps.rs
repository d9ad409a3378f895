//! Counters that wrap: Timer1's 16 bits, the board's 32-bit ticks, sequence numbers, epochs; and a host that falls silent.

use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Board, Faults, Lease, Leased, Port};
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::Cause;
use pulsetrain_core::{Direction, Entry, Epoch, Item, Segment, Tick32};
use pulsetrain_testkit::lab::{EXACT, Lab, SOFTWARE, Timing, said, uno, uno_after};
use pulsetrain_testkit::{TICK_HZ, uno_setup};
use std::time::Duration;

fn run(count: u32, interval: i64, forward: bool) -> Item {
    let segment = Segment { count, interval: interval << 16, add: 0, add2: 0 };
    Item::Run { segment, direction: if forward { Direction::Forward } else { Direction::Backward } }
}

/// Lets a board sleep until its clock comes near `tick`.
fn sleep(port: &mut VirtualUno, tick: u64) {
    let until = Duration::from_millis(100) + Duration::from_nanos(tick * 125 / 2);
    let mut bytes = Vec::new();
    while port.now() < until {
        bytes.clear();
        port.receive(until, &mut bytes).expect("it is there");
    }
}

/// A motion across a wrap of the board's 32-bit clock, on software pins and by the compare hardware: started before it,
/// switched after it, at every other offset.
fn across(port: VirtualUno, wrap: u64, pins: &[(u8, u8)], timing: Timing) {
    let setup = uno_setup(pins, 16);
    let mut board = uno_after(port, &setup);
    let mut lab = Lab::default();
    let from = board.now() + board.round_trip() + TICK_HZ / 10;
    assert!(from < wrap && from > wrap - TICK_HZ, "{from} is not just before {wrap}");
    for (epoch, from, count) in [(1, from, 600), (2, wrap + TICK_HZ / 10, 300)] {
        for motor in 0..pins.len() {
            for item in
                [Item::Anchor { tick: Tick32::of(from) }, Item::Dwell { ticks: 2000 }, run(count, 4001, epoch == 1)]
            {
                board.push(motor, Entry { epoch: Epoch(epoch), item }).expect("room");
            }
            // The first one goes on beyond the wrap; the second waits for it.
            if epoch == 1 {
                let ticks = (wrap - from) as u32;
                board
                    .push(motor, Entry { epoch: Epoch(epoch), item: Item::Dwell { ticks: ticks - 600 * 4001 - 3000 } })
                    .expect("room");
                board.push(motor, Entry { epoch: Epoch(epoch), item: run(400, 5003, true) }).expect("room");
            }
        }
        board.switch(Epoch(epoch), from, Lease::Last, &[]).expect("in time");
        // One switch may wait.
        board.advance(from, &mut lab);
    }
    board.advance(wrap + TICK_HZ / 2, &mut lab);
    assert!(board.is_idle());
    assert_eq!(board.board().error(), None);
    for motor in 0..pins.len() {
        assert_eq!(board.faults(motor), Faults::default());
    }
    assert_eq!(said(&mut board), lab.counts(&setup));
    assert!(lab.steps.iter().any(|step| step.tick < wrap) && lab.steps.iter().any(|step| step.tick > wrap));
    lab.check(&setup, timing, None);
}

/// All of it, and half-way round: nothing is past that is to come.
fn wraps() {
    let (software, hardware) = ((&[(8, 9)][..], SOFTWARE), (&[(9, 8)][..], EXACT));
    let both = (&[(9, 8), (10, 7)][..], EXACT);
    let mut port = VirtualUno::new();
    for (wrap, kinds) in [(1 << 31, &[software][..]), (1 << 32, &[software, both]), (3 << 31, &[hardware])] {
        // A second before.
        sleep(&mut port, wrap - TICK_HZ);
        for (pins, timing) in kinds {
            println!("{pins:?}, {wrap} ticks");
            across(port.clone(), wrap, pins, *timing);
        }
    }
}

#[test]
fn the_boards_clock_of_32_bits_wraps() {
    wraps();
}

/// Intervals next to 2^16 ticks, and multiples of it: a compare that was set for the wrong turn would be 65 536 ticks off.
#[test]
fn timer_1_wraps_between_steps() {
    for interval in [65_535, 65_536, 65_537, 131_072, 32_768, 49_152, 200_003] {
        for (pins, timing) in [(&[(8, 9)][..], SOFTWARE), (&[(9, 8), (10, 7)], EXACT)] {
            println!("{pins:?}, {interval} ticks");
            let setup = uno_setup(pins, 16);
            let mut board = uno(&setup);
            let mut lab = Lab::default();
            // The first step just before, at and after a wrap.
            let from = (board.now() + board.round_trip() + TICK_HZ / 10).next_multiple_of(1 << 16);
            for motor in 0..pins.len() {
                let dwell = Item::Dwell { ticks: 65_536 - interval as u32 % 65_536 + motor as u32 * 3 };
                for item in [Item::Anchor { tick: Tick32::of(from - 1) }, dwell, run(12, interval, true)] {
                    board.push(motor, Entry { epoch: Epoch(1), item }).expect("room");
                }
            }
            board.switch(Epoch(1), from - 1, Lease::Last, &[]).expect("in time");
            board.advance(from + 14 * interval as u64 + TICK_HZ / 100, &mut lab);
            assert_eq!(lab.steps.len(), 12 * pins.len());
            lab.check(&setup, timing, None);
        }
    }
}

/// More epochs than numbers for them, and more frames than sequence numbers.
#[test]
fn epochs_and_sequence_numbers_wrap() {
    let setup = uno_setup(&[(8, 9)], 16);
    let mut board = uno(&setup);
    let mut lab = Lab::default();
    for number in 1..=300_u64 {
        let epoch = Epoch(number as u8);
        let from = board.now() + board.round_trip() + TICK_HZ / 100;
        for item in
            [Item::Anchor { tick: Tick32::of(from) }, Item::Dwell { ticks: 1000 }, run(5, 3000, number % 3 == 0)]
        {
            board.push(0, Entry { epoch, item }).expect("room");
        }
        assert_eq!(board.switch(epoch, from, Lease::Last, &[]), Ok(()), "epoch {number}");
        board.advance(from + 20_000, &mut lab);
    }
    // The last pulse ends a little later than its step if a frame is read meanwhile.
    board.advance(board.now() + TICK_HZ / 100, &mut lab);
    assert_eq!(said(&mut board), lab.counts(&setup));
    assert_eq!(lab.steps.len(), 1500);
    lab.check(&setup, SOFTWARE, None);
}

/// The queue ends in the middle of a motion: the motor stands where its last step was, and the count is right.
#[test]
fn a_queue_that_ends_is_a_motor_that_stands() {
    for pins in [&[(8, 9)][..], &[(9, 8)], &[(9, 8), (10, 7)]] {
        let setup = uno_setup(pins, 16);
        let mut board = uno(&setup);
        let mut lab = Lab::default();
        let from = board.now() + board.round_trip() + TICK_HZ / 10;
        for motor in 0..pins.len() {
            for item in [Item::Anchor { tick: Tick32::of(from) }, Item::Dwell { ticks: 1000 }, run(777, 800, true)] {
                board.push(motor, Entry { epoch: Epoch(1), item }).expect("room");
            }
        }
        board.switch(Epoch(1), from, Lease::Last, &[]).expect("in time");
        // The host says nothing for three seconds: it is given up meanwhile.
        let until = board.board().port().now() + Duration::from_secs(3);
        let mut bytes = Vec::new();
        while board.board().port().now() < until {
            board.board_mut().port_mut().receive(until, &mut bytes).expect("it is there");
        }
        let mut edges = Vec::new();
        board.board_mut().port_mut().edges(&mut edges);
        lab.edges.append(&mut edges);
        assert_eq!(lab.counts(&setup), vec![777; pins.len()], "{pins:?}");
        // The next host finds the board at rest, and its counts.
        let mut port = std::mem::take(board.board_mut().port_mut());
        // As a board that has lost its host does.
        port.set_baud(Baud::B115200).expect("it is there");
        let mut next = pulsetrain_board::Remote::open(port, 8).expect("it answers");
        let status = next.status().expect("it answers");
        assert!(status.is_idle());
        assert_eq!(next.info().last_stop, Cause::Finished, "{pins:?}: rest came before the host was missed");
        let said: Vec<_> = status.motors.as_slice().iter().map(|motor| i64::from(motor.position)).collect();
        assert_eq!(said, lab.counts(&setup), "{pins:?}");
    }
}
