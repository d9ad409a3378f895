//! Short versions of the Pico's figures, which `cargo xtask bench pico` measures for longer, with their bounds.

use crate::common::pico::COILS;
use crate::common::pico_rows::{
    ABOVE, BETWEEN_TURNS, Case, IN_SHORT, Row, ULN_MOTORS, alike, made, on_coils, promised, sinusoids, start, sweep,
    uln2003,
};
use pulsetrain_board::virtual_pico::VirtualPico;
use pulsetrain_core::output::Sequence;
use pulsetrain_motion::boards;
use pulsetrain_plan::PlanError;
use pulsetrain_session::prepare::Refusal;
use pulsetrain_testkit::seed::rounds;

/// Rates are tried 2.5 % apart, and the mean of random speeds is not exactly the wanted one.
const BELOW: f64 = 0.95;

fn held(row: &Row) {
    assert_eq!(row.verdict, "", "{row:?}");
    assert_eq!((row.lost, row.off), (0, 0), "{row:?}");
}

/// Eight motors at 625 k steps/s each with a TMC2209's times, at 250 k with an A4988's, every edge in its cycle.
#[test]
fn eight_motors_follow_laws_with_changing_speed() {
    let pico = VirtualPico::on_usb();
    for (case, most_awake) in promised().into_iter().zip([0.95, 0.65]) {
        let rate = case.required.expect("it is promised");
        let row = case.row(&pico, ABOVE * rate, 0.1);
        held(&row);
        assert!(row.reached >= rate, "{row:?}");
        assert!(row.edges as f64 > 0.09 * 8.0 * rate, "{row:?}");
        assert!(row.awake.is_some_and(|awake| awake < most_awake), "{row:?}");
    }
}

/// The rates of sinusoids that a session plans and streams. They are within the table's limits, whatever the bench has
/// measured for those.
#[test]
fn eight_sinusoids_are_taken_and_made() {
    let row = sinusoids(624e3, 1);
    held(&row);
    assert!(row.edges > 3_200_000, "{row:?}");
}

/// Eight motors that go forward and back together 30 times a second, with 200 k steps/s in between. Segments are as
/// short as a tick allows: 67 000 a second at the reversals.
#[test]
fn eight_motors_bend_together_30_times_a_second() {
    const HZ: f64 = 30.0;
    let row = made(&alike(200e3 / (std::f64::consts::TAU * HZ), HZ, 0.5));
    held(&row);
    assert!(row.reached > 199e3 && row.edges > 500_000, "{row:?}");
}

#[test]
fn eight_motors_start_in_one_cycle() {
    held(&start().row(&VirtualPico::on_usb(), 100e3, 0.1));
}

/// Each pattern of the Pico plotter's table comes at its tick, in both directions from each phase.
#[test]
fn coils_turn_at_every_phase() {
    let pico = VirtualPico::on_usb();
    for sequence in [Sequence::Wave, Sequence::Full, Sequence::Half] {
        for rate in [2000, 50_000] {
            let row = uln2003(&pico, sequence, rate);
            held(&row);
            assert!(row.edges > 6 * 500, "{row:?}");
        }
    }
}

/// The limits of steps, coils and queued segments in the table of boards: at these limits, or a little below, there is
/// no underrun.
#[test]
fn limits_of_the_table_hold() {
    let pico = VirtualPico::on_usb();
    let row = boards::find("pico").expect("the table has it");
    let rate = |ticks: u32| row.tick_hz as f64 / f64::from(ticks);
    let numbers: &[usize] = if rounds() == 1 { &[1, 4, 8] } else { &[1, 2, 3, 4, 5, 6, 7, 8] };
    for &motors in numbers {
        let place = motors - 1;
        let (step, segment) = (row.min_interval_ticks[place], row.segment_ticks[place]);
        let changing = Case::changing(motors, "TMC2209");
        let mut cases = vec![
            (changing, rate(step)),
            (Case::short(motors, "TMC2209"), f64::from(IN_SHORT) * rate(segment.onward)),
            (Case::turning(motors, "TMC2209"), f64::from(BETWEEN_TURNS) * rate(segment.turning)),
            // As the planner counts them, with 90 steps in a segment.
            (Case { steps: 60, ..changing }, rate(step + segment.onward / 90)),
            (Case { steps: 60, turns: 5, turn_ticks: 300.0, ..changing }, rate(step + segment.turning / 60)),
        ];
        if motors <= usize::from(ULN_MOTORS) {
            let intervals = row.shortest_intervals(&on_coils(motors));
            cases.push((Case::changing(motors, COILS), rate(intervals[place])));
        }
        for (case, limit) in cases {
            for seed in 1..=rounds() {
                let row = Case { seed, ..case }.row(&pico, BELOW * limit, 0.06);
                held(&row);
                assert!(row.edges as f64 > 0.04 * BELOW * limit * motors as f64, "{row:?}");
            }
        }
    }
}

/// Segments that come from the host at its highest lasting rate. The run is longer than the queues last, which are full
/// at first, and there is no underrun.
#[test]
fn limits_on_what_is_heard_hold() {
    let pico = VirtualPico::on_usb();
    let board = boards::find("pico").expect("the table has it").limits();
    for motors in [2, 8] {
        let segment = board.segment_ticks[motors - 1];
        for (case, steps, ticks) in [
            (Case::short(motors, "TMC2209"), IN_SHORT, segment.onward),
            (Case::turning(motors, "TMC2209"), BETWEEN_TURNS, segment.turning),
        ] {
            let limit = f64::from(steps) * board.tick_hz as f64 / f64::from(ticks + segment.heard);
            held(&case.row(&pico, BELOW * limit, 0.4));
        }
    }
}

/// Eight motors that bend and reverse together as fast as the planner allows: the board makes every step at its tick.
/// One percent faster is refused.
#[test]
fn what_the_planner_takes_at_its_limit_the_board_does() {
    const SECONDS: f64 = 0.3;
    for amplitude in [3.2, 30.0, 300.0] {
        let refused = |hz| alike(amplitude, hz, SECONDS).prove(|_| {}).err();
        let (mut taken, mut beyond) = (10.0, 100_000.0);
        assert!(refused(taken).is_none());
        while beyond > 1.01 * taken {
            let hz = f64::sqrt(taken * beyond);
            *(if refused(hz).is_some() { &mut beyond } else { &mut taken }) = hz;
        }
        match refused(beyond) {
            Some(Refusal::Plan { error: PlanError::TooManySegments { rate_hz, limit_hz, .. }, .. }) => {
                assert!(rate_hz > limit_hz, "{rate_hz} of {limit_hz}");
            }
            other => panic!("{amplitude} steps at {beyond} Hz: {other:?}"),
        }
        let row = made(&alike(amplitude, taken, SECONDS));
        held(&row);
        assert!(row.edges as f64 > 8.0 * 3.9 * amplitude.floor() * taken * SECONDS, "{row:?}");
    }
}

/// The sweep article's four motors, twice, as `cargo xtask bench pico --hour` has them for an hour.
#[test]
fn eight_motors_keep_their_phase() {
    let rows = sweep(5);
    assert_eq!(rows.len(), 9);
    rows.iter().for_each(held);
}
