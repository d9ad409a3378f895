//! Changes of the laws while the motors move: limits, counts, phases.

use crate::session::{Bench, Lab, TICK_HZ, check_acceleration, check_counts, motor, planned, program};
use proptest::prelude::*;
use pulsetrain_board::{Board, Leased};
use pulsetrain_motion::law::{Begin, WinchCommand, WinchSettings};
use pulsetrain_motion::machine::{Kinematics, Machine};
use pulsetrain_motion::program::{Limits, Program};
use pulsetrain_motion::time::Rate;
use pulsetrain_motion::{Law, Time};
use pulsetrain_plan::Line;
use pulsetrain_session::fade::{Begins, Change};
use pulsetrain_session::pause::{Limited, PauseError};
use pulsetrain_session::{Session, SessionError};
use pulsetrain_testkit::limits::check_speed;
use pulsetrain_testkit::seed::rounds;
use std::sync::Arc;

mod chips;
mod robot;

const LIMITS: Limits = Limits { max_speed: Some(6000.0), max_acceleration: Some(40_000.0), pull_in: 0.0 };

fn seconds(s: f64) -> Time {
    Time::from_seconds(s)
}

/// A sinusoid without an end, in the middle of its swing at 0.
fn sine(amplitude: f64, period_s: f64) -> Law {
    Law::sine(amplitude, seconds(period_s), None).unwrap()
}

/// A program of two motors, with these laws.
fn with_laws(laws: [Law; 2]) -> Program {
    program(16, laws.into_iter().enumerate().map(|(index, law)| motor(index, law, false, LIMITS)).collect())
}

/// Makes a change; one that must wait is tried again when it can be.
fn change<B: Leased>(session: &mut Session<B>, lab: &mut Lab, change: &Change) -> Result<u64, SessionError> {
    loop {
        match session.change_to(change) {
            Ok(transition) => return Ok(transition.until),
            Err(SessionError::Waiting { until, .. }) => session.advance(until, lab)?,
            Err(error) => return Err(error),
        }
    }
}

/// What is asked of a session.
#[derive(Clone, Debug)]
enum Wish {
    Laws(Arc<Program>, Option<f64>, Begins),
    Tempo(f64),
    Pause,
}

fn law() -> impl Strategy<Value = Law> {
    let swing = || (10.0..300.0f64, 0.4..2.0f64).prop_map(|(amplitude, period_s)| sine(amplitude, period_s));
    prop_oneof![
        4 => swing(),
        1 => (swing(), 0.0..1.0f64).prop_map(|(law, delay_s)| law.delayed(seconds(delay_s)).unwrap()),
        1 => (swing(), -2.0..2.0f64, -500.0..500.0f64).prop_map(|(law, by, up)| law.scaled(by).unwrap().shifted(up).unwrap()),
        1 => (-900.0..900.0f64).prop_map(|speed| Law::speed(speed, None).unwrap()),
        1 => (-500.0..500.0f64).prop_map(|place| Law::speed(0.0, None).unwrap().shifted(place).unwrap()),
        1 => (swing(), swing()).prop_map(|(a, b)| Law::sum(vec![a, b]).unwrap()),
    ]
}

fn two_motors() -> impl Strategy<Value = Program> {
    (law(), law()).prop_map(|(a, b)| with_laws([a, b]))
}

fn wish(programs: impl Strategy<Value = Program> + 'static) -> impl Strategy<Value = Wish> {
    let begins = prop_oneof![Just(Begins::WithTheMotion), Just(Begins::Now)];
    prop_oneof![
        5 => (programs, prop::option::of(0.0..1.5f64), begins).prop_map(|(program, over, begins)| Wish::Laws(Arc::new(program), over, begins)),
        1 => (0.2..1.5f64).prop_map(Wish::Tempo),
        1 => Just(Wish::Pause),
    ]
}

/// What is asked for at which time after the one before.
fn wishes(programs: impl Strategy<Value = Program> + 'static) -> impl Strategy<Value = Vec<(f64, Wish)>> {
    prop::collection::vec((0.0..0.7f64, wish(programs)), 1..12)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Whatever is asked for, and whenever: no step is lost, and no limit is broken.
    #[test]
    fn changes_keep_limits_and_counts(wishes in wishes(two_motors())) {
        keeps_limits_and_counts(&with_laws([sine(100.0, 1.0), sine(100.0, 0.8)]), wishes)?;
    }
}

/// Does what is asked for, from the motion of `begun` on.
fn keeps_limits_and_counts(begun: &Program, wishes: Vec<(f64, Wish)>) -> Result<(), TestCaseError> {
    let mut lab = Lab::new(begun);
    let mut session = Session::new(Bench::new(begun, 256), begun.clone()).unwrap();
    let mut made = 0;
    for (after_s, wish) in wishes {
        let until = session.board().now() + (after_s * TICK_HZ as f64) as u64;
        prop_assert_eq!(session.advance(until, &mut lab), Ok(()));
        let done = match wish {
            Wish::Laws(program, over, begins) => {
                let change = Change { program, over: over.map(seconds), begins };
                match session.ceiling_of(&change) {
                    Ok(None) => session.change_to(&change).map(|transition| {
                        made += 1;
                        let least = over.map_or(0, |over| (over * TICK_HZ as f64) as u64);
                        assert!(transition.until - transition.from >= least);
                    }),
                    Ok(Some(_)) => Ok(()),
                    Err(error) => Err(error),
                }
            }
            Wish::Tempo(rate) => session.set_tempo(Rate::of(rate).unwrap()).map(drop),
            Wish::Pause if session.is_paused() => session.resume().map(drop),
            Wish::Pause => session.pause().map(drop),
        };
        match done {
            Ok(()) | Err(SessionError::Waiting { .. } | SessionError::Pause(_) | SessionError::Early { .. }) => {}
            Err(error) => return Err(TestCaseError::fail(error.to_string())),
        }
    }
    let until = session.board().now() + TICK_HZ;
    prop_assert_eq!(session.advance(until, &mut lab), Ok(()), "after {} changes", made);
    session.stop().unwrap();
    let report = session.run(&mut lab, |_| {});
    prop_assert_eq!(report.failure, None, "after {} changes", made);
    prop_assert_eq!(&report.counted, &report.replayed);
    check_counts(&session, &lab, begun)?;
    for steps in &lab.steps {
        check_acceleration(steps, LIMITS.max_acceleration.unwrap(), 1.5)?;
    }
    Ok(())
}

/// After the change each step of the new law comes when it would have come without one, to a tick: the common zero is kept.
#[test]
fn a_fade_ends_in_the_new_law_at_its_own_time() {
    let old = with_laws([sine(100.0, 1.0), sine(80.0, 0.7)]);
    // A new size, and another law altogether.
    let sum = Law::sum(vec![sine(60.0, 0.9), sine(-20.0, 0.5)]).unwrap();
    let new = with_laws([sine(160.0, 1.0), sum]);
    let mut lab = Lab::new(&old);
    let mut session = Session::new(Bench::new(&old, 256), old).unwrap();
    let zero = session.zero();
    session.advance(zero + 2 * TICK_HZ, &mut lab).unwrap();
    let wanted = Change { program: Arc::new(new.clone()), over: Some(seconds(0.5)), begins: Begins::WithTheMotion };
    let until = change(&mut session, &mut lab, &wanted).unwrap();
    session.advance(zero + 12 * TICK_HZ, &mut lab).unwrap();
    follow_from(until - zero, &lab, zero, &new, 12 * TICK_HZ);
}

/// From `since` ticks of the motion on to `until`, the motors step as those that have followed these laws from the start.
fn follow_from(since: u64, lab: &Lab, zero: u64, laws: &Program, until: u64) {
    let mut plain_lab = Lab::new(laws);
    let mut plain = Session::new(Bench::new(laws, 256), laws.clone()).unwrap();
    plain.advance(plain.zero() + until, &mut plain_lab).unwrap();
    for (steps, plain_steps) in lab.steps.iter().zip(&plain_lab.steps) {
        let after = |steps: &[(u64, i64)], zero: u64| -> Vec<(u64, i64)> {
            steps.iter().map(|(tick, way)| (tick - zero, *way)).filter(|(tick, _)| *tick > since + 100).collect()
        };
        let (steps, plain_steps) = (after(steps, zero), after(plain_steps, plain.zero()));
        assert!(steps.len() == plain_steps.len() && steps.len() > 500, "{} and {}", steps.len(), plain_steps.len());
        for ((tick, way), (plain, plain_way)) in steps.iter().zip(&plain_steps) {
            assert!(tick.abs_diff(*plain) <= 2 && way == plain_way, "{tick} and {plain}");
        }
    }
}

/// A new frequency keeps the phase: the swing stays as wide as before during the change, and back at the old frequency the motor is as far as the
/// time at the other one brought it.
#[test]
fn a_new_frequency_keeps_the_swing() {
    let old = with_laws([sine(100.0, 1.0), sine(100.0, 1.0)]);
    let new = with_laws([sine(100.0, 0.5), sine(100.0, 1.0)]);
    let mut lab = Lab::new(&old);
    let mut session = Session::new(Bench::new(&old, 256), old.clone()).unwrap();
    let zero = session.zero();
    session.advance(session.zero() + 2 * TICK_HZ, &mut lab).unwrap();
    for program in [&new, &old, &new, &old] {
        let wanted = Change { program: Arc::new(program.clone()), over: None, begins: Begins::WithTheMotion };
        let until = change(&mut session, &mut lab, &wanted).unwrap();
        session.advance(until + TICK_HZ, &mut lab).unwrap();
    }
    session.advance(session.board().now() + TICK_HZ, &mut lab).unwrap();
    let mut count = 0;
    let turns: Vec<i64> = lab.steps[0]
        .windows(2)
        .filter_map(|pair| {
            count += pair[0].1;
            (pair[0].1 != pair[1].1).then_some(count)
        })
        .collect();
    assert!(turns.len() > 12, "{turns:?}");
    // From 0 to 200 and back: a step more or less, since both laws' phases agree to the rate's 16 bits.
    assert!(turns.iter().all(|turn| *turn <= 1 || (199..=200).contains(turn)), "{turns:?}");
    // The other motor goes on as it is.
    let alone = motor(0, Law::sine(100.0, seconds(1.0), Some(20)).unwrap(), false, LIMITS);
    let plain = &planned(&program(16, vec![alone])).unwrap()[0];
    assert!(lab.steps[1].len() > 2000);
    for ((tick, way), (plain, plain_way)) in lab.steps[1].iter().zip(plain) {
        assert!((tick - zero).abs_diff(*plain) <= 2 && way == plain_way, "{tick} and {plain}");
    }
}

/// An endless constant speed.
fn speed(steps_per_s: f64) -> Law {
    Law::speed(steps_per_s, None).unwrap()
}

/// How long a change of speed takes, ticks, after the first speed has gone on for some time. The speed goes from one to the other without passing
/// them, and then stays.
#[track_caller]
fn speed_change(before_s: u64, from: f64, to: f64) -> u64 {
    speed_change_of(speed, before_s, from, to)
}

/// As [`speed_change`], of laws that reach their speed as `speed` says.
#[track_caller]
fn speed_change_of(speed: impl Fn(f64) -> Law, before_s: u64, from: f64, to: f64) -> u64 {
    let rest = with_laws([speed(0.0), sine(10.0, 2.0)]);
    let mut lab = Lab::new(&rest);
    let mut session = Session::new(Bench::new(&rest, 256), rest).unwrap();
    let zero = session.zero();
    if from != 0.0 {
        let old = Arc::new(with_laws([speed(from), sine(10.0, 2.0)]));
        let first = Change { program: old, over: None, begins: Begins::WithTheMotion };
        change(&mut session, &mut lab, &first).unwrap();
    }
    for part in 1..=100 {
        session.advance(zero + before_s * TICK_HZ / 100 * part, &mut lab).unwrap();
        lab.steps.iter_mut().for_each(Vec::clear);
    }
    let new = with_laws([speed(to), sine(10.0, 2.0)]);
    let wanted = Change { program: Arc::new(new), over: None, begins: Begins::WithTheMotion };
    let transition = session.change_to(&wanted).unwrap();
    session.advance(transition.until + 2 * TICK_HZ, &mut lab).unwrap();
    let steps = &lab.steps[0];
    check_acceleration(steps, LIMITS.max_acceleration.unwrap(), 1.5).unwrap();
    check_speed(steps, TICK_HZ, from.abs().max(to.abs()), 1.0).unwrap();
    let turns = steps.windows(2).filter(|pair| pair[0].1 != pair[1].1).count();
    assert!(turns <= usize::from(from * to < 0.0), "{from} to {to}: {turns} turns");
    let after = steps.iter().filter(|(tick, _)| *tick > transition.until).map(|(_, way)| way).sum::<i64>();
    assert!((after as f64 - 2.0 * to).abs() <= 1.5, "{from} to {to}: {after} steps in 2 s");
    transition.until - transition.from
}

/// A constant speed changes as a frequency does: from where the motor is, whatever way it has gone.
#[test]
fn a_speed_changes_as_quickly_after_ten_hours() {
    for (from, to) in [(20.0, 900.0), (20.0, -900.0), (-30.0, 0.0), (20.0, 30.0)] {
        let [soon, late] = [1, 36_000].map(|before_s| speed_change(before_s, from, to));
        assert!(soon.abs_diff(late) <= 2, "{from} to {to}: {soon} ticks, later {late}");
        assert!(soon < TICK_HZ / 10, "{from} to {to}: {soon} ticks");
    }
    // From rest, too, and without an end of the acceleration.
    assert!(speed_change(1, 0.0, 5900.0) < TICK_HZ / 2);
    assert!(speed_change(1, 5900.0, -5900.0) < TICK_HZ);
}

/// A constant speed that begins with an easing or a ramp changes as one without: from where the motor is.
#[test]
fn a_speed_that_began_gently_changes_as_quickly() {
    let limits = (LIMITS.max_speed.unwrap(), LIMITS.max_acceleration.unwrap());
    let (max_speed, max_acceleration) = limits;
    let eased = |v: f64| speed(v).eased(seconds(0.7)).unwrap();
    let later = |v: f64| eased(v).delayed(seconds(0.1)).unwrap();
    let ramp = |v: f64| speed(v).beginning(Begin::Ramp { max_speed, max_acceleration }).unwrap();
    // The distance that this ramp loses depends on the speed.
    let behind = |v: f64| speed(v).beginning(Begin::RampBehind { max_speed, max_acceleration: 500.0 }).unwrap();
    let laws: [(&str, &dyn Fn(f64) -> Law); 4] =
        [("eased", &eased), ("later", &later), ("ramp", &ramp), ("behind", &behind)];
    for (from, to) in [(20.0, 900.0), (900.0, -20.0), (-30.0, 0.0), (20.0, 30.0)] {
        for (name, law) in laws {
            let [plain, soon, late] =
                [speed_change(5, from, to), speed_change_of(law, 5, from, to), speed_change_of(law, 1000, from, to)];
            assert!(soon.abs_diff(plain) <= 2, "{name}, {from} to {to}: {soon} ticks, a plain speed {plain}");
            assert!(late.abs_diff(plain) <= 2, "{name}, {from} to {to}: {late} ticks, a plain speed {plain}");
        }
    }
}

/// A line that brings a byte in so many ticks.
fn line_of(byte_ticks: f64) -> Line {
    Line {
        tick_hz: TICK_HZ,
        queue_bytes: vec![200; 2],
        longest_queue_bytes: 200,
        byte_ticks,
        delay_ticks: 0.01 * TICK_HZ as f64,
        delay_byte_ticks: 0.0,
        busy_ticks: TICK_HZ / 100,
        ahead_ticks: 0.5 * TICK_HZ as f64,
    }
}

/// The limit that a law of the first motor would break from 2 s of a motion on, with what the plan takes of the line.
fn limit_of(law: Law, byte_ticks: f64) -> Option<&'static str> {
    let rest = || with_laws([speed(0.0), speed(0.0)]);
    let mut session = Session::new(Bench::new(&rest(), 256), rest()).unwrap();
    session.hold_to_line(Some(line_of(byte_ticks)));
    session.advance(session.zero() + 2 * TICK_HZ, &mut Lab::new(&rest())).unwrap();
    let program = Arc::new(with_laws([law, speed(0.0)]));
    let wanted = Change { program, over: None, begins: Begins::WithTheMotion };
    session.ceiling_of(&wanted).unwrap().map(|ceiling| ceiling.limit)
}

/// A limit has its own name wherever in the plan it is found. The part of a law that is past limits nothing, and rest needs no line.
#[test]
fn limits_have_their_names() {
    let quick = 1600.0;
    assert_eq!(limit_of(speed(0.0), quick), None);
    let eased = |over_s: f64| speed(5000.0).eased(seconds(over_s)).unwrap();
    // 30 000 and 75 000 steps/s², up to 0.1 s; then an easing that still runs.
    assert_eq!(limit_of(eased(0.25), quick), None);
    assert_eq!(limit_of(eased(0.1), quick), None);
    assert_eq!(limit_of(eased(0.1).delayed(seconds(1.95)).unwrap(), quick), Some("max_acceleration"));
    assert_eq!(limit_of(speed(6001.0), quick), Some("max_speed"));
    // Far beyond what is sampled.
    let later = |law: Law| Law::then(vec![Law::rest(seconds(60.0)).unwrap(), law]).unwrap();
    assert_eq!(limit_of(later(speed(6001.0).beginning(Begin::Jump).unwrap()), quick), Some("max_speed"));
    assert_eq!(limit_of(later(eased(0.1)), quick), Some("max_acceleration"));
    assert_eq!(limit_of(later(speed(100.0)), quick), Some("pull_in"));
    assert_eq!(limit_of(sine(100.0, 0.4), quick), None);
    assert_eq!(limit_of(sine(100.0, 0.4), 1e6), Some("the line to the board"));
}

/// A session whose motors changed from rest to these laws at its beginning, and follow them.
fn turning(laws: &Program) -> (Lab, Session<Bench>) {
    let rest = with_laws([speed(0.0), speed(0.0)]);
    let mut lab = Lab::new(&rest);
    let mut session = Session::new(Bench::new(&rest, 256), rest).unwrap();
    let wanted = Change { program: Arc::new(laws.clone()), over: None, begins: Begins::WithTheMotion };
    let until = change(&mut session, &mut lab, &wanted).unwrap();
    session.advance(until, &mut lab).unwrap();
    (lab, session)
}

/// The first motor turns at `old` in one session. Later another session joins `new`. Gives its steps while it joins and a second after, with how many of them
/// `new` makes since the change.
fn rejoined_at_another_speed(old: f64, new: f64) -> (Vec<(u64, i64)>, f64) {
    let program = |v: f64| with_laws([speed(v), sine(10.0, 2.0)]);
    let (_, session) = turning(&program(old));
    let shifts = session.shifts().unwrap();
    // The motor is where the old speed brought it in ten hours.
    let away = seconds(36_000.0);
    let place = (old * away.seconds() + shifts[0].steps).round();
    let rest = with_laws([speed(0.0).shifted(place).unwrap(), speed(0.0)]);
    let mut lab = Lab::new(&rest);
    let mut session = Session::new(Bench::new(&rest, 256), rest).unwrap();
    while let Err(error) = session.set_law_time(away, Some(&shifts)) {
        let SessionError::Waiting { until, .. } = error else { panic!("{error}") };
        assert!(until < TICK_HZ, "the motors do not rest");
        session.advance(until, &mut lab).unwrap();
    }
    let begun = session.board().now();
    let wanted = Change { program: Arc::new(program(new)), over: None, begins: Begins::WithTheMotion };
    let until = change(&mut session, &mut lab, &wanted).unwrap();
    let until_s = (until - begun) as f64 / TICK_HZ as f64;
    assert!(until_s < 2.0, "it takes {until_s} s");
    session.advance(until + TICK_HZ, &mut lab).unwrap();
    (lab.steps[0].clone(), new * (until_s + 1.0))
}

/// A speed that is changed while the board is away goes on from where the old one would have brought the motor, not from where it would be at that speed
/// since the beginning.
#[test]
fn a_speed_that_changes_between_two_sessions_goes_on_from_the_way() {
    for (old, new) in [(20.0, 20.0), (20.0, 30.0), (20.0, -15.0)] {
        let (steps, wanted) = rejoined_at_another_speed(old, new);
        let made = steps.iter().map(|(_, way)| way).sum::<i64>() as f64;
        // At the old speed until the change, which comes soon.
        assert!((made - wanted).abs() < 3.0, "{old} to {new}: {made} steps, not {wanted}");
        check_acceleration(&steps, LIMITS.max_acceleration.unwrap(), 1.5).unwrap();
    }
}

/// A motor that was stopped joins another speed where the old one would have brought it by then. It does not turn back first.
#[test]
fn a_stopped_motor_joins_another_speed_without_turning_back() {
    let (mut lab, mut session) = turning(&with_laws([speed(100.0), sine(10.0, 2.0)]));
    let (zero, shift) = (session.zero(), session.shifts().unwrap()[0].steps);
    session.advance(zero + 2 * TICK_HZ, &mut lab).unwrap();
    session.stop().unwrap();
    session.advance(zero + 4 * TICK_HZ, &mut lab).unwrap();
    let slower = Arc::new(with_laws([speed(20.0), sine(10.0, 2.0)]));
    // Long, so that the steps of a speed that changes from 100 steps/s would show.
    let wanted = Change { program: slower, over: Some(seconds(3.0)), begins: Begins::WithTheMotion };
    let transition = session.change_to(&wanted).unwrap();
    session.advance(transition.until + TICK_HZ, &mut lab).unwrap();
    let steps = &lab.steps[0];
    assert!(steps.iter().all(|(_, way)| *way == 1), "{steps:?}");
    let time = |tick: u64| (tick - zero) as f64 / TICK_HZ as f64;
    let place = shift + 100.0 * time(transition.from) + 20.0 * (time(transition.until) + 1.0 - time(transition.from));
    assert!((steps.len() as f64 - place).abs() <= 1.5, "{} steps, not {place}", steps.len());
    check_acceleration(steps, LIMITS.max_acceleration.unwrap(), 1.5).unwrap();
}

/// A motor that was sent to a position has left its way: a constant speed begins there.
#[test]
fn a_speed_begins_where_the_motor_was_sent() {
    let rest = with_laws([speed(0.0), sine(10.0, 2.0)]);
    let mut lab = Lab::new(&rest);
    let mut session = Session::new(Bench::new(&rest, 256), rest).unwrap();
    let turning = Arc::new(with_laws([speed(400.0), sine(10.0, 2.0)]));
    let back = Change { program: turning, over: None, begins: Begins::WithTheMotion };
    change(&mut session, &mut lab, &back).unwrap();
    session.advance(session.zero() + 3 * TICK_HZ, &mut lab).unwrap();
    let there = with_laws([200.0, 5.0].map(|steps| speed(0.0).shifted(steps).unwrap()));
    let sent = Change { program: Arc::new(there), over: None, begins: Begins::Now };
    let until = change(&mut session, &mut lab, &sent).unwrap();
    session.advance(until + 60 * TICK_HZ, &mut lab).unwrap();
    assert_eq!(session.shifts(), None);
    assert_eq!(session.status().motors[0].position, 200);
    let transition = session.change_to(&back).unwrap();
    assert!(transition.until - transition.from < TICK_HZ, "{transition:?}");
    session.advance(transition.until + TICK_HZ, &mut lab).unwrap();
    let position = session.status().motors[0].position;
    assert!((600..800).contains(&position), "{position}");
    for steps in &lab.steps {
        check_acceleration(steps, LIMITS.max_acceleration.unwrap(), 1.5).unwrap();
    }
}

fn any_speed() -> impl Strategy<Value = f64> {
    prop_oneof![4 => -5700.0..5700.0f64, 1 => Just(0.0), 1 => -3.0..3.0f64]
}

/// A constant speed alone, or with a swing on it.
fn line() -> impl Strategy<Value = Law> {
    let swung = (-3000.0..3000.0f64, 10.0..100.0f64, 0.4..2.0f64)
        .prop_map(|(v, amplitude, period_s)| Law::sum(vec![speed(v), sine(amplitude, period_s)]).unwrap());
    prop_oneof![3 => any_speed().prop_map(speed), 1 => swung]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    /// Speeds of any size and sign, one after the other, early and late: no limit is broken, no step is lost, and no change takes longer than the
    /// speeds need.
    #[test]
    fn speeds_keep_limits_and_counts(
        before_s in prop_oneof![Just(1), Just(3000)],
        laws in prop::collection::vec((0.0..0.6f64, line(), line()), 1..8),
    ) {
        let begun = with_laws([speed(0.0), speed(0.0)]);
        let first = Change { program: Arc::new(with_laws([speed(20.0), speed(-15.0)])), over: None, begins: Begins::WithTheMotion };
        let mut lab = Lab::new(&begun);
        let mut session = Session::new(Bench::new(&begun, 256), begun.clone()).unwrap();
        change(&mut session, &mut lab, &first).unwrap();
        session.advance(session.zero() + before_s * TICK_HZ, &mut lab).unwrap();
        for (after_s, a, b) in laws {
            let until = session.board().now() + (after_s * TICK_HZ as f64) as u64;
            prop_assert_eq!(session.advance(until, &mut lab), Ok(()));
            let wanted = Change { program: Arc::new(with_laws([a, b])), over: None, begins: Begins::WithTheMotion };
            if session.ceiling_of(&wanted).unwrap().is_none() {
                let at = session.board().now();
                match change(&mut session, &mut lab, &wanted) {
                    // Up to 12 000 steps/s at half of the acceleration, after another change that takes as long.
                    Ok(until) => prop_assert!(until - at < 3 * TICK_HZ, "{} s", (until - at) as f64 / TICK_HZ as f64),
                    Err(SessionError::Pause(_)) => {}
                    Err(error) => return Err(TestCaseError::fail(error.to_string())),
                }
            }
        }
        let until = session.board().now() + 2 * TICK_HZ;
        prop_assert_eq!(session.advance(until, &mut lab), Ok(()));
        session.stop().unwrap();
        let report = session.run(&mut lab, |_| {});
        prop_assert_eq!(report.failure, None);
        prop_assert_eq!(&report.counted, &report.replayed);
        check_counts(&session, &lab, &begun)?;
        for steps in &lab.steps {
            check_acceleration(steps, LIMITS.max_acceleration.unwrap(), 1.5)?;
            check_speed(steps, TICK_HZ, LIMITS.max_speed.unwrap(), 1.0).map_err(TestCaseError::fail)?;
        }
    }
}

/// Frequencies that are one to the rate's 16 bits speed no time up: a change between them keeps no earlier change from being forgotten.
#[test]
fn a_third_change_waits_for_the_first_alone() {
    let laws = |period_s: f64, size: f64| Arc::new(with_laws([sine(size, period_s), sine(50.0, 0.7)]));
    let begun = laws(1.0, 40.0);
    let mut lab = Lab::new(&begun);
    let mut session = Session::new(Bench::new(&begun, 256), Arc::clone(&begun)).unwrap();
    session.advance(session.zero() + TICK_HZ, &mut lab).unwrap();
    let over = Some(seconds(1.0));
    let to = |program| Change { program, over, begins: Begins::WithTheMotion };
    let first = change(&mut session, &mut lab, &to(laws(1.0, 60.0))).unwrap();
    session.advance(session.board().now() + TICK_HZ / 2, &mut lab).unwrap();
    // A period of a microsecond more.
    let second = session.change_to(&to(laws(1.000_001, 50.0))).unwrap().until;
    session.advance(session.board().now() + TICK_HZ / 10, &mut lab).unwrap();
    let waiting = session.change_to(&to(laws(1.0, 30.0))).unwrap_err();
    let SessionError::Waiting { until, .. } = waiting else { panic!("{waiting}") };
    assert!(until.abs_diff(first) < TICK_HZ / 20 && until + TICK_HZ / 4 < second, "{until}: {first}, {second}");
    let third = change(&mut session, &mut lab, &to(laws(1.0, 30.0))).unwrap();
    session.advance(third + TICK_HZ, &mut lab).unwrap();
    for steps in &lab.steps {
        check_acceleration(steps, LIMITS.max_acceleration.unwrap(), 1.5).unwrap();
    }
}

/// A short change that follows a long one: once it is over, the next one waits for neither. The motors of the long one follow the law that replaced it, or
/// go on with their change if it was of other motors.
#[test]
fn no_change_waits_for_one_that_was_replaced() {
    let laws = |first: f64, second: f64| Arc::new(with_laws([sine(first, 1.0), sine(second, 0.7)]));
    for (long, short, last) in [
        (laws(60.0, 50.0), laws(30.0, 50.0), laws(50.0, 50.0)),
        (laws(40.0, 80.0), laws(60.0, 80.0), laws(30.0, 80.0)),
        (laws(60.0, 80.0), laws(30.0, 80.0), laws(50.0, 70.0)),
    ] {
        let begun = laws(40.0, 50.0);
        let mut lab = Lab::new(&begun);
        let mut session = Session::new(Bench::new(&begun, 256), Arc::clone(&begun)).unwrap();
        let (zero, ends) = (session.zero(), 12 * TICK_HZ);
        session.advance(zero + TICK_HZ, &mut lab).unwrap();
        let to = |program: &Arc<Program>, s: f64| Change {
            program: Arc::clone(program),
            over: Some(seconds(s)),
            begins: Begins::WithTheMotion,
        };
        let long = session.change_to(&to(&long, 4.0)).unwrap().until;
        session.advance(session.board().now() + TICK_HZ / 4, &mut lab).unwrap();
        let short = session.change_to(&to(&short, 0.5)).unwrap().until;
        session.advance(short + TICK_HZ / 10, &mut lab).unwrap();
        let third = session.change_to(&to(&last, 0.5)).unwrap();
        assert!(third.from + TICK_HZ < long, "{third:?}, {long}");
        session.advance(zero + ends, &mut lab).unwrap();
        for steps in &lab.steps {
            check_acceleration(steps, LIMITS.max_acceleration.unwrap(), 1.5).unwrap();
        }
        follow_from(long.max(third.until) - zero, &lab, zero, &last, ends);
    }
}

/// A change each second for hours: the motors are where the common zero has them, to a tick, and the session remembers no more than after ten changes.
#[test]
fn thousands_of_changes_lose_no_phase() {
    let laws = |size: f64| [sine(size, 1.0), sine(0.8 * size, 0.7)];
    let [old, new] = [10.0, 16.0].map(|size| Arc::new(with_laws(laws(size))));
    let mut lab = Lab::new(&old);
    let mut session = Session::new(Bench::new(&old, 256), Arc::clone(&old)).unwrap();
    let zero = session.zero();
    let (mut until, mut after_ten, mut most) = (0, 0, 0);
    for k in 0..10_000 {
        session.advance(zero + k * TICK_HZ, &mut lab).unwrap();
        let program = Arc::clone(if k % 2 == 0 { &new } else { &old });
        let wanted = Change { program, over: None, begins: Begins::WithTheMotion };
        until = change(&mut session, &mut lab, &wanted).unwrap();
        lab.steps.iter_mut().for_each(Vec::clear);
        let remembered = if k < 10 { &mut after_ten } else { &mut most };
        *remembered = session.remembered().max(*remembered);
    }
    // The laws' text has more digits as the times grow.
    assert!(most <= after_ten + after_ten / 4, "{after_ten}, later {most}");
    session.advance(until + 5 * TICK_HZ, &mut lab).unwrap();
    // One period of each without any change.
    let mut plain = Lab::new(&old);
    let mut alone = Session::new(Bench::new(&old, 256), Arc::clone(&old)).unwrap();
    alone.advance(alone.zero() + 2 * TICK_HZ, &mut plain).unwrap();
    for (motor, period) in [TICK_HZ, TICK_HZ / 10 * 7].into_iter().enumerate() {
        let phase = |tick: u64, zero: u64| (tick - zero) % period;
        let plain: Vec<u64> = plain.steps[motor].iter().map(|(tick, _)| phase(*tick, alone.zero())).collect();
        let after: Vec<u64> =
            lab.steps[motor].iter().map(|(tick, _)| *tick).filter(|tick| *tick > until + 100).collect();
        assert!(after.len() > 100);
        for tick in after {
            let off = plain.iter().map(|plain| plain.abs_diff(phase(tick, zero))).min();
            assert!(off.is_some_and(|off| off <= 2), "motor {motor} at {tick}: {off:?}");
        }
    }
}

/// A winch whose `duration` ends while the motor still moves is refused at once. Else the change would be made, and taken back when the end comes.
#[test]
fn a_law_that_ends_in_motion_is_refused_at_once() {
    let commands = [(Time::ZERO, WinchCommand::Target(800.0)), (seconds(2.0), WinchCommand::Target(0.0))];
    let winch = |end_s: Option<f64>| Law::winch(&commands, WinchSettings::default(), end_s.map(seconds)).unwrap();
    let limited = |law: Law, pull_in: f64| of_one(law, Limits { pull_in, ..LIMITS });
    let begun = limited(winch(None), 50.0);
    let mut lab = Lab::new(&begun);
    let mut session = Session::new(Bench::new(&begun, 256), begun).unwrap();
    session.advance(session.zero() + TICK_HZ, &mut lab).unwrap();
    let refused = |law: Law, pull_in: f64| {
        let program = Arc::new(limited(law, pull_in));
        let change = Change { program, over: None, begins: Begins::WithTheMotion };
        session.ceiling_of(&change).unwrap().map(|ceiling| (ceiling.of, ceiling.limit))
    };
    let pull_in = Some((Limited::Motor(0), "pull_in"));
    assert_eq!(refused(winch(Some(2.3)), 50.0), pull_in);
    assert_eq!(refused(winch(Some(2.3)), 5000.0), None);
    // It rests by then; it has ended before; it has no end; it ends at rest, however hard it brakes.
    assert_eq!(refused(winch(Some(22.0)), 50.0), None);
    assert_eq!(refused(winch(Some(0.3)), 50.0), None);
    assert_eq!(refused(winch(None), 50.0), None);
    assert_eq!(refused(Law::sine(300.0, seconds(0.6), Some(4)).unwrap(), 0.0), None);
    assert_eq!(refused(Law::trapezoid(20_000.0, 5000.0, 39_000.0, 39_000.0).unwrap(), 0.0), None);
    assert_eq!(refused(Law::speed(100.0, Some(seconds(3.0))).unwrap(), 50.0), pull_in);
    // The motor's speed at the end is the law's, times the tempo.
    let at_tempo = |tempo: f64| {
        let program = Arc::new(limited(Law::speed(100.0, Some(seconds(3.0))).unwrap(), 150.0));
        let change = Change { program, over: None, begins: Begins::WithTheMotion };
        session.ceiling_at(&change, Rate::of(tempo).unwrap()).unwrap().map(|ceiling| (ceiling.of, ceiling.limit))
    };
    assert_eq!((at_tempo(1.0), at_tempo(1.4), at_tempo(1.6)), (None, None, pull_in));
}

/// A program of one motor.
fn of_one(law: Law, limits: Limits) -> Program {
    program(16, vec![motor(0, law, false, limits)])
}

/// A formula's speed changes the whole way since the beginning: where the limits leave no room for that, the refusal says what to write.
#[test]
fn laws_that_part_are_refused_plainly() {
    let turns = |speed: f64| of_one(Law::formula(&format!("{speed}*t"), &[], 1.0, None).unwrap(), LIMITS);
    let turns = |speed: f64| {
        let mut program = turns(speed);
        program.motors[0].law = program.motors[0].law.clone().beginning(Begin::Jump).unwrap();
        program
    };
    let begun = turns(3000.0);
    let mut lab = Lab::new(&begun);
    let mut session = Session::new(Bench::new(&begun, 256), begun).unwrap();
    session.advance(session.zero() + TICK_HZ, &mut lab).unwrap();
    let mut refused = |program: Program| {
        let change = Change { program: Arc::new(program), over: None, begins: Begins::WithTheMotion };
        session.change_to(&change).unwrap_err()
    };
    let error = refused(turns(5500.0));
    assert_eq!(error, SessionError::Pause(PauseError::Parting { within_s: 600.0 }));
    assert!(error.to_string().contains("write `law.speed`"), "{error}");
    // One that only takes too much does not part.
    let full = of_one(Law::formula("3000*t + 400*sin(10*t)", &[], 1.0, None).unwrap(), LIMITS);
    let error = refused(full);
    assert!(matches!(error, SessionError::Pause(PauseError::NoRoom { .. })), "{error}");
}

/// A motor's constant speed that changes is no law to rewrite, if another motor's law takes too much.
#[test]
fn a_constant_speed_is_not_blamed_for_another_motors_law() {
    let at_speed = |law: Law| law.beginning(Begin::Jump).unwrap();
    let speed = |steps_per_s: f64| at_speed(Law::speed(steps_per_s, None).unwrap());
    let swing = |text: &str| at_speed(Law::formula(text, &[], 1.0, None).unwrap());
    let begun = with_laws([speed(1000.0), swing("400*sin(5*t)")]);
    let mut lab = Lab::new(&begun);
    let mut session = Session::new(Bench::new(&begun, 256), begun).unwrap();
    session.advance(session.zero() + TICK_HZ, &mut lab).unwrap();
    let program = Arc::new(with_laws([speed(1500.0), swing("700*sin(10*t)")]));
    let change = Change { program, over: None, begins: Begins::WithTheMotion };
    let error = session.change_to(&change).unwrap_err();
    assert!(matches!(error, SessionError::Pause(PauseError::NoRoom { .. })), "{error}");
}

/// The most that a tip makes from now to a tick, mm/s and mm/s². `tip` is where it is, from the motors' positions.
fn tip_peaks<const N: usize>(
    session: &mut Session<Bench>,
    lab: &mut Lab,
    until: u64,
    tip: impl Fn([f64; N]) -> [f64; 3],
) -> [f64; 2] {
    let step = TICK_HZ / 1000;
    let norm = |way: [f64; 3]| way.iter().map(|x| x * x).sum::<f64>().sqrt();
    let (mut peaks, mut seen) = ([0.0_f64; 2], Vec::new());
    while session.board().now() < until {
        let now = session.board().now();
        session.advance(now + step - 1, lab).unwrap();
        seen.push(tip(std::array::from_fn(|motor| session.state(motor, now + step).unwrap().theta)));
        if let [.., a, b, c] = seen[..] {
            let rate = TICK_HZ as f64 / step as f64;
            peaks[0] = peaks[0].max(norm([0, 1, 2].map(|axis| c[axis] - b[axis])) * rate);
            let bend = norm([0, 1, 2].map(|axis| c[axis] - 2.0 * b[axis] + a[axis]));
            peaks[1] = peaks[1].max(bend * rate * rate);
        }
    }
    peaks
}

/// A machine's own limits hold for its tip while it changes from one circle to another, which the motors alone could do sooner.
#[test]
fn a_tip_keeps_to_its_limits_in_a_change() {
    let circle = |mm: f64, hz: f64| -> [Law; 2] {
        let axis = || sine(10.0 * mm, 1.0 / hz);
        [axis(), axis().delayed(seconds(0.25 / hz)).unwrap()]
    };
    let with_limits = |laws: [Law; 2], tip_limits: [Option<f64>; 2]| {
        let mut program = with_laws(laws);
        program.machines = vec![Machine {
            name: "plotter".into(),
            motors: vec![0, 1],
            kinematics: Kinematics::Xy { steps_per_unit: [10.0; 2] },
            home: vec![0.0; 2],
            slack: vec![0.0; 2],
            unit: "mm".into(),
            tip_limits,
        }];
        program
    };
    // 40 mm at 0.5 Hz: 126 mm/s, 395 mm/s². The motors may do 600 mm/s, 4000 mm/s².
    let limits = [150.0, 600.0];
    let takes_s = |tip_limits: [Option<f64>; 2]| {
        let begun = with_limits(circle(40.0, 0.5), tip_limits);
        let mut lab = Lab::new(&begun);
        let mut session = Session::new(Bench::new(&begun, 256), begun.clone()).unwrap();
        session.advance(session.zero() + 3 * TICK_HZ, &mut lab).unwrap();
        let other = with_limits(circle(15.0, 0.5).map(|law| law.shifted(200.0).unwrap()), tip_limits);
        let wanted = Change { program: Arc::new(other), over: None, begins: Begins::WithTheMotion };
        let transition = session.change_to(&wanted).unwrap();
        let peaks = tip_peaks(&mut session, &mut lab, transition.until + TICK_HZ / 10, |[x, y]: [f64; 2]| {
            [x / 10.0, y / 10.0, 0.0]
        });
        ((transition.until - transition.from) as f64 / TICK_HZ as f64, peaks)
    };
    let (quick_s, quick) = takes_s([None; 2]);
    let (careful_s, careful) = takes_s(limits.map(Some));
    assert!(quick[0] > limits[0] && quick[1] > limits[1], "{quick:?} in {quick_s} s");
    assert!(careful[0] <= limits[0] && careful[1] <= limits[1], "{careful:?}");
    // A path that runs at its limits all the time can change too, with a little more.
    let full = [126.0, 396.0];
    let (full_s, most) = takes_s(full.map(Some));
    assert!(most[0] <= 1.25 * full[0] && most[1] <= 1.25 * full[1] && full_s < 5.0, "{most:?} in {full_s} s");
    // Not by going slowly: most of the limits is used.
    assert!(careful[1] > 0.8 * limits[1] || careful[0] > 0.8 * limits[0], "{careful:?} in {careful_s} s");
}
