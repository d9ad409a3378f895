//! Text and paths while clocks wrap: the 31 and 32 bits of an Uno's ticks (134 and 268 s), and those of the microseconds that statuses
//! have (35.8 and 71.6 min). `winch_pico.rs` has the Pico's ticks. Really waited for, in virtual time, asleep nearly all the while.

use super::winch::{Winch, script};
use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_testkit::winch::{SLICE, Uno, WinchLab, follow};
use std::time::Duration;

/// Lets a board be until a second before a tick of its clock. Nobody asks for a status meanwhile.
fn wait<B: Winch>(lab: &mut WinchLab<B>, tick: u64) {
    lab.say("srate 65535");
    let mut bytes = Vec::new();
    while lab.now() < tick - B::CYCLES_PER_S {
        bytes.clear();
        let left = u128::from(tick - B::CYCLES_PER_S - lab.now()) * 1_000_000_000 / u128::from(B::CYCLES_PER_S);
        let until = lab.port.now() + Duration::from_nanos(left as u64 + 1);
        lab.port.receive(until, &mut bytes).expect("it is virtual");
    }
    lab.port.edges(&mut Vec::new());
    (lab.edges, lab.lines, lab.partial) = Default::default();
}

/// Four axes set out before the wrap and are told otherwise after it; statuses go on.
fn across<B: Winch>(lab: &mut WinchLab<B>, tick: u64) {
    let lines = [
        (100, "srate 50"),
        (5, "l xyza 10000 100000"),
        (5, "g xyza 2 1"),
        (5, "v xyza 9000 -1234 450 -37"),
        (1200, "v xyz -300 3000 10"),
        (300, "a xyza 0 0 0 0"),
    ];
    let said = script(lab, &lines);
    lab.run_ms(1500);
    assert!(said[3].tick < tick - B::CYCLES_PER_S * 2 / 5 && said[4].tick > tick, "{said:?}");
    let (late, _) = follow(lab, &said[1..]).unwrap_or_else(|why| panic!("across {tick}: {why}"));
    assert!(late[0].len() > 5000 && late.iter().flatten().all(|late| B::LATE.contains(late)), "across {tick}");
    let statuses = lab.statuses();
    assert!(statuses.len() > 40, "{}", statuses.len());
    for pair in statuses.windows(2) {
        let apart = pair[1].usec.wrapping_sub(pair[0].usec);
        assert!((47_000..53_000).contains(&apart), "across {tick}: {pair:?}");
    }
}

/// A deadman whose time is over after the wrap stops the axes then, not before.
fn deadman(mut uno: Uno, tick: u64) {
    uno.run_ms(700);
    let said = ["l x 1000 100000", "g x 2 1", "deadman 500", "v x 1000"].map(|line| uno.say(line).tick);
    uno.run_ms(900);
    let last = uno.steps(0).last().expect("it moves").tick;
    let after = last - said[3];
    assert!(said[3] < tick - 100 * SLICE && last > tick + 10 * SLICE, "{tick}: {said:?}, {last}");
    // It is looked for every 4 ms; the stop takes 10.
    assert!((498 * SLICE..525 * SLICE).contains(&after), "{tick}: {} us", after / 16);
}

/// Half-way round, all the way, and half-way again.
#[test]
fn paths_and_a_deadman_go_on_while_the_ticks_of_an_uno_wrap() {
    let mut asleep = Uno::new();
    for tick in [1 << 31, 1 << 32, 3 << 31] {
        wait(&mut asleep, tick);
        let mut uno = asleep.clone();
        across(&mut uno, tick);
        uno.check_positions();
        deadman(asleep.clone(), tick);
    }
}

/// Half an hour of an Uno's time, and an hour and a quarter of a Pico's.
mod long {
    use super::*;
    use pulsetrain_testkit::winch::Pico;

    /// The statuses around a wrap of their microseconds: whether each is negative changes once.
    fn sign_changes<B: Winch>(lab: &mut WinchLab<B>, tick: u64) {
        wait(lab, tick);
        across(lab, tick);
        let negative: Vec<_> = lab.statuses().iter().map(|status| status.usec < 0).collect();
        assert_ne!(negative[0], negative[negative.len() - 1], "across {tick}: {negative:?}");
        assert_eq!(negative.windows(2).filter(|pair| pair[0] != pair[1]).count(), 1);
    }

    #[test]
    fn microseconds_of_an_uno_are_negative_after_half_an_hour() {
        let mut uno = Uno::new();
        sign_changes::<VirtualUno>(&mut uno, 1 << 35);
        uno.check_positions();
        assert!(uno.statuses().last().expect("it tells").usec < 0);
    }

    #[test]
    fn statuses_of_a_pico_go_on_when_their_microseconds_wrap() {
        let mut pico = Pico::new();
        for bits in [31, 32] {
            sign_changes(&mut pico, 125 << bits);
            assert_eq!(pico.statuses().last().expect("it tells").usec < 0, bits == 31);
            // Else it goes on looking after the motors, which is slow. After verbs text begins anew, with all axes at 0.
            for line in ["enable 0", "halt", "enable 0"] {
                pico.say(line);
                pico.run_ms(1000);
            }
            assert!(pico.lines.iter().any(|line| line.text == "awake"));
        }
    }
}
