//! Ticks that wrap: 2^24 (SysTick, 0.13 s), 2^31 and 2^32 (17 s and 34 s), while the Pico waits, is configured, moves.

use pulsetrain_board::virtual_pico::VirtualPico;
use pulsetrain_board::{Board, Port, Setup};
use pulsetrain_core::output::Sequence;
use pulsetrain_core::{Direction, Item, Segment, Tick32};
use pulsetrain_testkit::pico::{Pair, TICK_HZ, coils, run, step_dir};

fn setup() -> Setup {
    Setup { pulse_ticks: 125, motors: vec![step_dir(2), coils(22, Sequence::Half)], ..Setup::default() }
}

/// Lets a Pico be, to which nobody speaks, up to a tick.
fn wait(pico: &mut VirtualPico, tick: u64) {
    let until = std::time::Duration::from_nanos(8 * tick);
    while pico.now() < until {
        pico.receive(until, &mut Vec::new()).expect("it is there");
    }
}

/// Plans both motors for `seconds` from 30 ms on, and compares all edges.
fn play(pair: &mut Pair, epoch: u8, seconds: u64) {
    let from = pair.pico.now() + pair.pico.round_trip() + TICK_HZ * 3 / 100;
    // Interval and acceleration both ways; whole phases of the coils.
    for (motor, period) in [(0, 30_011), (1, 1_250_003)] {
        let count = u32::try_from(seconds * TICK_HZ / period / 8 * 8).expect("a few seconds");
        let add = 1 << 20;
        let back = Segment {
            count,
            interval: (i64::from(2) << 32) + period as i64 * (1 << 32) + add * i64::from(count),
            add: -add,
            add2: 3,
        };
        let there = Segment { count, interval: (period as i64) << 32, add, add2: 0 };
        let items = [
            Item::Anchor { tick: Tick32::of(from) },
            Item::Run { segment: there, direction: Direction::Forward },
            Item::Dwell { ticks: 3_000_000 },
            Item::Run { segment: back, direction: Direction::Backward },
        ];
        pair.push(motor, epoch, &items);
    }
    assert_eq!(pair.switch(epoch, from), Ok(()), "at {from}");
    while !pair.pico.is_idle() {
        pair.advance(pair.pico.now() + TICK_HZ / 20);
        assert!(pair.pico.now() < from + (3 * seconds + 1) * TICK_HZ, "{:?}", pair.pico.events());
    }
    pair.advance(pair.pico.now() + TICK_HZ / 100);
    let until = pair.native.now();
    pair.compare(until);
    assert_eq!(pair.pico.positions(), pair.native.positions());
}

/// A board may have been on for any time when it is configured.
#[test]
fn it_can_be_configured_at_any_time() {
    let (mut pico, mut last) = (VirtualPico::new(), 0);
    for half in 1..=3_u64 {
        // On both sides of every 2^31 ticks.
        for tick in [(half << 31) - 30_000_000, (half << 31) + 1000] {
            wait(&mut pico, tick);
            let mut pair = Pair::over(pico.clone(), &setup());
            assert!(pair.pico.horizon() < tick + TICK_HZ, "horizon {} at {tick}", pair.pico.horizon());
            play(&mut pair, 1, 1);
            assert!(pair.edges.len() > 10_000);
            last = pair.edges.last().expect("it moved").tick;
        }
    }
    assert!(last > 3 << 31);
}

/// Steps further apart than SysTick goes, and than 2^31 ticks.
#[test]
fn long_waits_between_steps() {
    let mut pair = Pair::over(VirtualPico::new(), &setup());
    let from = pair.pico.now() + pair.pico.round_trip() + TICK_HZ / 50;
    let step = run(1, 1_000_000, Direction::Forward);
    // The longest wait that an item can be, and two of them.
    let long = Item::Dwell { ticks: (1 << 31) - 1 };
    let short = Item::Dwell { ticks: 20_000_000 };
    pair.push(0, 1, &[Item::Anchor { tick: Tick32::of(from) }, step, long, step, short, step]);
    pair.push(1, 1, &[Item::Anchor { tick: Tick32::of(from) }, step, long, long, step, short, step]);
    assert_eq!(pair.switch(1, from), Ok(()));
    let end = from + (2 << 31) + TICK_HZ;
    while pair.pico.now() < end {
        pair.advance(pair.pico.now() + TICK_HZ);
    }
    pair.compare(end);
    assert_eq!(pair.pico.positions(), [3, 3]);
}

/// 70 seconds of a Pico's time.
mod long {
    use super::*;

    /// A motion over the wrap of 2^32 ticks; rest of more than that while motors are armed, and again.
    #[test]
    fn motion_and_rest_go_over_the_wraps() {
        let mut pico = VirtualPico::new();
        wait(&mut pico, (1 << 32) - 2 * TICK_HZ);
        let mut pair = Pair::over(pico, &setup());
        play(&mut pair, 1, 3);
        for (epoch, seconds) in [(2, 16), (3, 18), (4, 35)] {
            pair.advance(pair.pico.now() + seconds * TICK_HZ);
            play(&mut pair, epoch, 1);
        }
        assert!(pair.pico.now() > 1 << 33);
        let steps = pair.counts()[0];
        assert_eq!(steps, Some(0));
    }
}
