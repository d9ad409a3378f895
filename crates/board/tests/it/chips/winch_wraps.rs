//! Text and paths on the Uno while its clocks wrap: the ticks' 31 and 32 bits (134 and 268 s), and the 31 of the microseconds
//! that statuses have (35.8 min).

use pulsetrain_board::Port;
use pulsetrain_testkit::TICK_HZ;
use pulsetrain_testkit::winch::{SLICE, SentLine, Uno, follow};
use std::time::Duration;

/// A board whose clock has come to a second before `tick`, asleep nearly all the while.
fn before(tick: u64) -> Uno {
    let mut uno = Uno::new();
    // No status, nor a deadman, meanwhile.
    uno.send("srate 65535\n");
    let until = Duration::from_nanos((tick - TICK_HZ) * 125 / 2);
    let mut bytes = Vec::new();
    while uno.port.now() < until {
        bytes.clear();
        uno.port.receive(until, &mut bytes).expect("it is virtual");
    }
    uno.port.edges(&mut Vec::new());
    uno
}

/// Four axes set out before the wrap and are told otherwise after it; statuses and a deadman go on.
fn across(tick: u64) -> Uno {
    let mut uno = before(tick);
    let mut said: Vec<SentLine> = Vec::new();
    for (ms, line) in [
        (100, "srate 50"),
        (5, "l xyza 10000 100000"),
        (5, "g xyza 2 1"),
        (5, "v xyza 9000 -1234 450 -37"),
        (1200, "v xyz -300 3000 10"),
        (300, "a xyza 0 0 0 0"),
    ] {
        uno.run_ms(ms);
        let one = uno.say(line);
        if !line.starts_with("srate") {
            said.push(one);
        }
    }
    uno.run_ms(700);
    assert!(said[2].tick < tick - TICK_HZ / 2 && said[3].tick > tick + TICK_HZ / 10, "{said:?}");
    let (late, _) = follow(&uno, &said).unwrap_or_else(|why| panic!("across {tick}: {why}"));
    let (least, most) = (late.iter().flatten().min().unwrap(), late.iter().flatten().max().unwrap());
    assert!(late[0].len() > 5000 && *least >= -38 && *most <= 64, "{tick}: {least} to {most} ticks late");
    // A status each 50 ms, all of them right.
    uno.check_positions();
    let statuses = uno.statuses();
    assert!(statuses.len() > 40, "{}", statuses.len());
    for pair in statuses.windows(2) {
        let apart = pair[1].usec.wrapping_sub(pair[0].usec);
        assert!((47_000..53_000).contains(&apart), "across {tick}: {pair:?}");
    }
    uno
}

/// A deadman whose time is over after the wrap stops the axes then, not before.
fn deadman(tick: u64) {
    let mut uno = before(tick);
    uno.run_ms(700);
    let said = ["l x 1000 100000", "g x 2 1", "deadman 500", "v x 1000"].map(|line| uno.say(line).tick);
    uno.run_ms(900);
    let last = uno.steps(0).last().expect("it moves").tick;
    let after = last - said[3];
    assert!(said[3] < tick - 100 * SLICE && last > tick + 10 * SLICE, "{tick}: {said:?}, {last}");
    // It is looked for every 4 ms; the stop takes 10.
    assert!((498 * SLICE..525 * SLICE).contains(&after), "{tick}: {} us", after / 16);
}

#[test]
fn half_way_round_paths_go_on() {
    across(1 << 31);
    across(3 << 31);
}

#[test]
fn when_32_bits_of_ticks_wrap_paths_go_on() {
    across(1 << 32);
}

#[test]
fn a_deadman_knows_wraps() {
    deadman(1 << 31);
    deadman(1 << 32);
}

/// Half an hour of the board's time and more.
mod long {
    use super::*;

    #[test]
    fn microseconds_are_negative_after_half_an_hour() {
        let uno = across(1 << 35);
        let statuses = uno.statuses();
        let first = statuses.iter().position(|status| status.usec < 0).expect("they wrap");
        assert!(first > 5 && statuses[first - 1].usec > i32::MAX - 60_000 && statuses[first].usec < i32::MIN + 60_000);
    }
}
