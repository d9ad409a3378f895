//! What a motor cannot do is refused, with the time and the value.

use pulsetrain_motion::law::{Begin, End, LawError};
use pulsetrain_motion::program::Limits;
use pulsetrain_motion::{Law, Time};
use pulsetrain_plan::{Certificate, Load, Move, PlanError, Planner, Settings};

const LIMITS: Limits = Limits { max_speed: Some(1000.0), max_acceleration: Some(5000.0), pull_in: 100.0 };

/// A motor that can do everything: what remains are the board's limits and the law's own faults.
const FREE: Limits = Limits { max_speed: None, max_acceleration: None, pull_in: f64::INFINITY };

/// Plans on a 16 MHz board that makes 1600 steps/s at most.
fn plan(law: &Law, limits: Limits) -> Result<Certificate, PlanError> {
    let settings = Settings { limits, min_interval_ticks: 10_000, ..Settings::new(16_000_000, 16) };
    let mut planner = Planner::new(law, &settings)?;
    while planner.next_move()?.is_some() {}
    Ok(planner.certificate().clone())
}

fn refusal(law: &Law) -> Option<PlanError> {
    plan(law, LIMITS).err()
}

fn formula(text: &str, end_s: f64) -> Law {
    Law::formula(text, &[], 1.0, Some(Time::from_seconds(end_s))).unwrap()
}

fn close(found: f64, expected: f64) -> bool {
    (found - expected).abs() <= 0.011 * expected.abs() + 1e-6
}

/// The refusal is a speed jump there.
fn check_jump(law: &Law, expected_at_s: f64, expected_from: f64, expected_to: f64) {
    match refusal(law) {
        Some(PlanError::SpeedJump { at_s, from, to, pull_in: 100.0 }) => assert!(
            close(at_s, expected_at_s) && close(from, expected_from) && close(to, expected_to),
            "{from} to {to} at {at_s} s, not {expected_from} to {expected_to} at {expected_at_s} s"
        ),
        other => panic!("{other:?}"),
    }
}

#[test]
fn speed_changes_by_the_pull_in_rate_at_most() {
    let second = Some(Time::SECOND);
    assert_eq!(refusal(&Law::speed(100.0, second).unwrap()), None);
    check_jump(&Law::speed(101.0, second).unwrap(), 0.0, 0.0, 101.0);
    check_jump(&Law::speed(-200.0, second).unwrap(), 0.0, 0.0, -200.0);
    // From rest, but not to rest.
    check_jump(&formula("200*t^2", 1.0), 1.0, 400.0, 0.0);
    // From one speed to another, and the other way round.
    let then = |speeds: &[f64]| Law::then(speeds.iter().map(|&v| Law::speed(v, second).unwrap()).collect()).unwrap();
    assert_eq!(refusal(&then(&[80.0, 170.0, 80.0])), None);
    check_jump(&then(&[80.0, 190.0]), 1.0, 80.0, 190.0);
    check_jump(&then(&[60.0, -60.0]), 1.0, 60.0, -60.0);
    // A corner of a formula.
    check_jump(&formula("50*t + 200*max(0, t - 0.5)", 1.0), 0.5, 50.0, 250.0);
    // Unless the file says so.
    let fast = Law::speed(300.0, second).unwrap();
    check_jump(&fast.clone().beginning(Begin::Jump).unwrap(), 1.0, 300.0, 0.0);
    assert_eq!(refusal(&fast.beginning(Begin::Jump).unwrap().ending(End::Jump).unwrap()), None);
}

#[test]
fn speed_is_limited() {
    // 50·2π·3 = 942 and 50·2π·3.2 = 1005 steps/s, first a quarter period after the start.
    let sine = |hz: f64| Law::sine(50.0, Time::from_seconds(1.0 / hz), Some(2)).unwrap();
    let fast = Limits { max_acceleration: None, ..LIMITS };
    let (speed, at_s) = plan(&sine(3.0), fast).unwrap().peak_speed;
    assert!(close(speed, 942.5) && (at_s - 1.0 / 12.0).abs() < 0.01, "{speed} at {at_s} s");
    match plan(&sine(3.2), fast) {
        Err(PlanError::TooFast { at_s, speed, limit: 1000.0 }) => {
            assert!(speed > 1000.0 && close(speed, 1005.3) && (at_s - 0.25 / 3.2).abs() < 0.01, "{speed} at {at_s} s");
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn acceleration_is_limited() {
    // 2·2499 and 2·2501 steps/s²; constant, so that the limit is met to a millionth.
    assert_eq!(refusal(&formula("2499*t^2", 0.01)), None);
    match refusal(&formula("2501*t^2", 0.01)) {
        Some(PlanError::TooMuchAcceleration { at_s, acceleration, limit: 5000.0 }) => {
            assert!(close(acceleration, 5002.0) && (0.0..=0.01).contains(&at_s), "{acceleration} at {at_s} s");
        }
        other => panic!("{other:?}"),
    }
    // 50·(2π·2)² = 7896 steps/s², at the start.
    match refusal(&Law::sine(50.0, Time::from_ratio(1, 2), Some(1)).unwrap()) {
        Some(PlanError::TooMuchAcceleration { at_s, acceleration, .. }) => {
            assert!(close(acceleration, 7895.7) && at_s < 0.02, "{acceleration} at {at_s} s");
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn the_board_is_a_limit_too() {
    // 1600 steps/s fit 10 000 ticks of 16 MHz; a law passes that speed at 0.5 s.
    match plan(&formula("1600*t^2", 1.0), FREE) {
        Err(PlanError::TooFastForBoard { at_s, rate_hz, limit_hz: 1600.0 }) => {
            assert!((at_s - 0.5).abs() < 0.01 && rate_hz > 1600.0 && close(rate_hz, 1601.0), "{rate_hz} at {at_s} s");
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_law_that_breaks_is_refused_with_the_time() {
    let meets = |text| plan(&formula(text, 1.0), FREE).err();
    match meets("10*floor(t + 0.25)") {
        Some(PlanError::Law(LawError::Jump { at_s, from, to })) => {
            assert!((at_s - 0.75).abs() < 1e-9 && close(to - from, 10.0), "{from} to {to} at {at_s} s");
        }
        other => panic!("{other:?}"),
    }
    match meets("sqrt(0.5 - t)") {
        Some(PlanError::Law(LawError::Undefined { at_s, .. })) => assert!((at_s - 0.5).abs() < 1e-6, "{at_s}"),
        other => panic!("{other:?}"),
    }
}

/// Laws that would keep a planner for ever, or leave its integers.
#[test]
fn what_has_no_end_is_refused() {
    let check = |law: Law, expected: fn(&PlanError) -> bool| {
        let refused = plan(&law, FREE);
        assert!(refused.as_ref().is_err_and(expected), "{refused:?}");
    };
    let sine = |amplitude, period_s| Law::sine(amplitude, Time::from_seconds(period_s), None).unwrap();
    // Without steps, and with pairs that are all dropped: a million half periods within a tick.
    check(sine(0.2, 1e-12), |error| matches!(error, PlanError::TooFine { .. }));
    check(sine(0.6, 1e-12), |error| matches!(error, PlanError::TooFine { .. }));
    // More steps than can be dropped one by one.
    check(sine(1e14, 1e-9), |error| matches!(error, PlanError::TooFastForBoard { .. }));
    check(sine(100.0, 1.0).delayed(Time::from_seconds(1e12)).unwrap(), |error| {
        matches!(error, PlanError::TooLong { .. })
    });
    // At its beginning it swings faster than any board steps.
    let wild = Law::formula("1000*sin(1/(t + 1e-6))", &[], 1.0, Some(Time::SECOND)).unwrap();
    check(wild, |error| matches!(error, PlanError::TooFastForBoard { .. }));
}

/// An endless law without steps gives waits instead of keeping its caller waiting.
#[test]
fn an_endless_rest_is_a_stream_of_waits() {
    for law in [Law::speed(0.0, None).unwrap(), Law::sine(0.2, Time::from_ratio(1, 1000), None).unwrap()] {
        let settings = Settings::new(16_000_000, 16);
        let mut planner = Planner::new(&law, &settings).unwrap();
        for _ in 0..3 {
            let before = planner.tick();
            assert!(matches!(planner.next_move(), Ok(Some(Move::Dwell { .. }))));
            assert!(planner.tick() > before);
        }
    }
}

/// A motion that turns 2 · `hz` times a second, on a board whose processor does a segment in so many ticks.
fn turning(hz: f64, load: Option<Load>) -> Result<Certificate, PlanError> {
    let law = Law::sine(3.2, Time::from_seconds(1.0 / hz), Some(200)).unwrap();
    let settings = Settings { limits: FREE, load, ..Settings::new(125_000_000, 32) };
    let mut planner = Planner::new(&law, &settings)?;
    while planner.next_move()?.is_some() {}
    Ok(planner.certificate().clone())
}

/// Segments that all take the board as long.
fn load(segment_ticks: u64) -> Option<Load> {
    Some(Load {
        step_ticks: 139,
        onward_ticks: segment_ticks,
        turning_ticks: segment_ticks,
        heard_ticks: 0,
        burst_ticks: 125_000,
        heard_burst_ticks: 125_000,
    })
}

/// Hearing of segments may be put off for longer than doing them.
#[test]
fn what_the_board_is_to_hear_may_wait() {
    // Twice so many swings of a quarter of a millisecond, and 0.1 s of rest between.
    let burst = |cycles| {
        let swing = Law::sine(3.2, Time::from_ratio(1, 4000), Some(cycles)).unwrap();
        let rest = Law::rest(Time::from_ratio(1, 10)).unwrap();
        let law = Law::then(vec![swing.clone(), rest, swing]).unwrap();
        let heard = Load { heard_ticks: 20_000, heard_burst_ticks: 1_250_000, ..load(2_000).unwrap() };
        let settings = Settings { limits: FREE, load: Some(heard), ..Settings::new(125_000_000, 32) };
        let mut planner = Planner::new(&law, &settings)?;
        while planner.next_move()?.is_some() {}
        Ok::<_, PlanError>(())
    };
    assert!(burst(5).is_ok(), "{:?}", burst(5));
    match burst(100) {
        // The rest before a burst is no time for it.
        Err(PlanError::TooManySegments { rate_hz, limit_hz, .. }) => {
            assert!(rate_hz > limit_hz, "{rate_hz} of {limit_hz}")
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn segments_that_come_faster_than_the_board_takes_them_are_refused() {
    let segments = |hz| turning(hz, None).unwrap().segments as f64 / 200.0 * hz;
    let most = 125e6 / 26_000.0;
    // As slow as the board can do for good, and a burst is none of its business.
    let slow = 100.0;
    assert!(segments(slow) < 0.5 * most, "{}", segments(slow));
    assert!(turning(slow, load(26_000)).is_ok());
    let fast = 4000.0;
    assert!(segments(fast) > 2.0 * most, "{}", segments(fast));
    match turning(fast, load(26_000)) {
        Err(PlanError::TooManySegments { at_s, rate_hz, limit_hz }) => {
            let free = turning(fast, None).unwrap();
            let with_steps = 125e6 / (26_000.0 + 139.0 * free.steps as f64 / free.segments as f64);
            assert!(close(limit_hz, with_steps) && rate_hz > most, "{rate_hz} of {limit_hz}");
            // Some five segments may wait: the sixth or so is refused.
            assert!(at_s < 0.01, "{at_s}");
        }
        other => panic!("{other:?}"),
    }
    // Steps take their time too.
    let steps = Load { step_ticks: 12_000, ..load(2_600).unwrap() };
    assert!(turning(fast, load(2_600)).is_ok());
    assert!(turning(fast, Some(steps)).is_err());
}

/// What turns and what goes on are added up, each at its own cost: a little less than there is time for is taken, a little more is not.
#[test]
fn turns_and_other_segments_have_each_their_own_cost() {
    let (hz, cycles) = (500.0, 200);
    let law = Law::sine(320.0, Time::from_seconds(1.0 / hz), Some(cycles)).unwrap();
    let planned = |load| {
        let settings = Settings { limits: FREE, load, ..Settings::new(125_000_000, 32) };
        let mut planner = Planner::new(&law, &settings)?;
        while planner.next_move()?.is_some() {}
        Ok::<_, PlanError>(planner.certificate().clone())
    };
    let free = planned(None).unwrap();
    // The first begins from rest, and counts as a turn; so does each that begins at one.
    let turns = 2 * cycles + 1;
    let (step_ticks, all_ticks) = (20, 125e6 * cycles as f64 / hz);
    let onward = free.segments - turns;
    assert!(onward > 4 * turns, "{} segments", free.segments);
    let left = all_ticks - (step_ticks * free.steps) as f64;
    for share in [0.1, 0.5, 0.9] {
        let check = |of| {
            let ticks = |share: f64, count: u64| (of * share * left / count as f64) as u64;
            let (onward_ticks, turning_ticks) = (ticks(1.0 - share, onward), ticks(share, turns));
            planned(Some(Load { step_ticks, onward_ticks, turning_ticks, ..load(0).unwrap() }))
        };
        assert!(check(0.98).is_ok(), "{share}: {:?}", check(0.98));
        match check(1.02) {
            Err(PlanError::TooManySegments { rate_hz, limit_hz, .. }) => {
                assert!(rate_hz > limit_hz && rate_hz < 1.1 * limit_hz, "{rate_hz} of {limit_hz}");
            }
            other => panic!("{share}: {other:?}"),
        }
    }
}
