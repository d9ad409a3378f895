//! The promised rates of the boards, by `pulsetrain run`; and, in short streams, every row of the Uno's second figure,
//! 3 % below the limit of the table of boards and lower.
//!
//! `cargo xtask bench uno` measures how far the board goes beyond.

use crate::common::motion::make;
use crate::common::promises::PROMISES;
use crate::common::rigs;
use crate::common::rows::{CHANGING, Case, Row, fastest_plateau, tutorial_row};
use crate::common::uno::{MOST_CYCLES, SHIELD};
use pulsetrain_motion::{Law, Time, boards};
use pulsetrain_session::prepare::Prepared;
use std::f64::consts::TAU;
use std::path::Path;

/// Length of a stream for each kind of pins, s.
const SHORT_S: f64 = 0.1;
/// Bytes of the stack that no test may have reached.
const STACK_LEFT: usize = 32;

/// No step is lost, 99 % of the edges are at most 40 cycles late, all at most 60, and the board reports no event.
#[track_caller]
fn holds(row: &Row) {
    let seen = row.seen.as_ref().expect("it ran");
    let late = &seen.lateness;
    println!(
        "{} {} {}: {} edges, p99 {}, at most {} cycles late; {} bytes of stack left",
        row.law, row.pins, row.rate, late.edges, late.p99_ticks, late.max_ticks, seen.stack_left
    );
    assert_eq!(row.verdict, "", "{} on {} at {}", row.law, row.pins, row.rate);
    assert!(usize::from(seen.stack_left) >= STACK_LEFT, "{}: {} bytes of stack left", row.pins, seen.stack_left);
}

#[test]
fn the_tutorials_sweeps_hold() {
    for period in [((10, 1), (8, 9)), ((4, 5), (8, 9)), ((1, 10), (9, 8))] {
        holds(&tutorial_row(period, 1000, true));
    }
}

/// Runs the promises for a board as `cargo xtask bench promises` does.
#[track_caller]
fn are_kept(board: &str) {
    let program = Path::new(env!("CARGO_BIN_EXE_pulsetrain"));
    let promises = PROMISES.iter().filter(|promise| promise.board == board);
    let faults = promises.map(|promise| (promise.fields().join(", "), promise.run(program).fault));
    let broken: Vec<_> = faults.filter(|(_, fault)| !fault.is_empty()).collect();
    assert!(broken.is_empty(), "{broken:#?}");
}

#[test]
fn promised_rates_are_kept() {
    are_kept("uno");
}

/// Half a minute: a Pico's rates are thirty times an Uno's.
mod long {
    #[test]
    fn promised_rates_of_a_pico_are_kept() {
        super::are_kept("pico");
    }
}

#[test]
fn streams_below_the_limits_hold() {
    for case in CHANGING {
        for (share, turns) in [(0.25, 0), (0.1, 5), (0.97, 0)] {
            holds(&Case { turns, ..case }.row(share * case.limit_hz(), SHORT_S));
        }
    }
}

/// Four motors that switch to new epochs while they are fast: their lists are full, or nearly so, when a switch waits.
#[test]
fn four_motors_stay_fast_on_the_shield() {
    let case = CHANGING[6];
    for rate in [11e3, 12.5e3, 13e3, 15e3] {
        let row = fastest_plateau(&case, &[rate]);
        assert_eq!(row.verdict, "", "{rate} steps/s");
    }
}

/// Near the top of a sinusoid segments have few steps, and each segment takes the interrupt some 1000 cycles. Meanwhile
/// the other motor's ring must not run empty, nor where both motors go to their next segments at once.
#[test]
fn two_motors_on_sinusoids_do_not_starve() {
    for (hertz, rate, second) in
        [(36.68, 73e3, 1.03), (39.0, 70.1e3, 1.03), (31.43, 75.7e3, 1.03), (23.98, 72.1e3, 1.03), (27.33, 75.7e3, 1.0)]
    {
        let motors = [hertz, hertz * second].into_iter().enumerate().map(|(index, hertz)| {
            let law = Law::sine(rate / (TAU * hertz), Time::from_seconds(1.0 / hertz), Some(hertz.round() as u64));
            rigs::motor(index, SHIELD[index], law.expect("a sinusoid"))
        });
        let mut prepared = rigs::prepared(boards::find("uno").expect("the Uno's row"), motors.collect());
        prepared.over_line(None);
        prepared.prove(|_| {}).expect("`plan` accepts it");
        let made = make(&prepared, MOST_CYCLES as f64, |_| {}).expect("it begins");
        assert_eq!(made.seen.trouble, "", "{hertz} Hz, {rate} steps/s");
    }
}

/// The table of boards has to the tick the pulse from which on the firmware plans each step by itself, on all pins, and
/// the rates there.
#[test]
fn rates_with_long_pulses_hold() {
    let two_on_port_b = Case { motors: 2, ..CHANGING[5] };
    for case in [CHANGING[0], CHANGING[2], two_on_port_b, CHANGING[4], CHANGING[5], CHANGING[6]] {
        let rate = |pulse_ticks| Case { pulse_ticks, ..case }.limit_hz();
        let longest = (81..=255).find(|ticks| 2.0 * rate(ticks + 1) < rate(*ticks)).expect("where it goes over");
        let run = |pulse_ticks, swing, rate: f64| Case { pulse_ticks, swing, ..case }.row(0.95 * rate, SHORT_S);
        holds(&run(longest, 0.0, rate(longest)));
        assert_ne!(run(longest + 1, 0.0, rate(longest)).verdict, "", "{} pins, {longest} ticks", case.motors);
        holds(&run(longest + 1, case.swing, rate(longest + 1)));
    }
}

/// One motor reverses often, next to three that hardly move. With equal shares of the queues `plan` refuses it earlier
/// than with shares by need, and what it accepts by need runs.
#[test]
fn queues_by_need_let_one_motor_turn_more_often() {
    let sine = |rate: f64, hertz: f64| {
        Law::sine(rate / (TAU * hertz), Time::from_seconds(1.0 / hertz), Some((0.4 * hertz).ceil() as u64))
            .expect("a sine")
    };
    let motion = |hertz: f64| {
        let laws = [sine(4_000.0, hertz), sine(1_000.0, 2.5), sine(900.0, 2.5), sine(800.0, 2.5)];
        let motors = laws.into_iter().enumerate().map(|(index, law)| rigs::motor(index, SHIELD[index], law));
        let mut prepared = rigs::prepared(boards::find("uno").expect("the Uno's row"), motors.collect());
        prepared.over_line(None);
        prepared
    };
    let fastest = |is_accepted: fn(&mut Prepared) -> bool| {
        let rungs = (2..=40).map(|fives| 5.0 * f64::from(fives));
        rungs.take_while(|hertz| is_accepted(&mut motion(*hertz))).last().expect("10 Hz fits")
    };
    let equal = fastest(|prepared| prepared.plan(|_| {}).is_ok());
    let by_need = fastest(|prepared| prepared.prove(|_| {}).is_ok());
    println!("{equal} Hz with equal parts, {by_need} Hz by need");
    assert!(by_need >= 1.3 * equal, "{by_need} Hz, {equal} Hz with equal parts");
    let mut prepared = motion(by_need);
    prepared.prove(|_| {}).expect("it was accepted");
    let seen = make(&prepared, f64::from(MOST_CYCLES as u32), |_| {}).expect("it begins").seen;
    assert_eq!((seen.trouble.as_str(), seen.lateness.lost, seen.lateness.extra), ("", 0, 0));
}
