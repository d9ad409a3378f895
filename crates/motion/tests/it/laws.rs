//! Laws and what is made of them: pieces without gaps, continuous, and where the law says.

use proptest::prelude::*;
use pulsetrain_motion::law::{
    Begin, Behind, Class, Cursor, Curve, Ease, End, Entry, Interpolation, Inverse, Orbit, Piece, SCurve, TimerRamp,
};
use pulsetrain_motion::law::{WinchCommand, WinchSettings};
use pulsetrain_motion::time::Rate;
use pulsetrain_motion::{Law, LawError, Time};

fn s(seconds: f64) -> Time {
    Time::from_seconds(seconds)
}

fn position(piece: &Piece, u: f64) -> f64 {
    piece.origin as f64 + piece.curve.value(u)
}

/// The first pieces follow each other without gaps and meet; returns how many there were.
#[track_caller]
fn contiguous(law: &Law, most: usize) -> usize {
    let (mut end, mut at, mut count) = (Time::ZERO, None::<f64>, 0);
    for piece in law.pieces().take(most) {
        let piece = piece.unwrap();
        assert_eq!(piece.start, end, "{piece:?}");
        assert!(piece.end > piece.start, "{piece:?}");
        let first = position(&piece, piece.first());
        if let Some(at) = at {
            assert!((first - at).abs() <= 1e-6 + 1e-12 * at.abs(), "{at} then {first} at {} s", end.seconds());
        }
        at = Some(position(&piece, piece.last()));
        end = piece.end;
        count += 1;
    }
    if count < most {
        assert_eq!(law.end(), Some(end));
    }
    count
}

#[track_caller]
fn at(law: &Law, seconds: f64, expected: f64) {
    let got = Cursor::new(law).at(s(seconds)).unwrap().position;
    assert!((got - expected).abs() <= 1e-9 * (1.0 + expected.abs()), "at {seconds} s: {got}, not {expected}");
}

fn sine() -> Law {
    Law::sine(100.0, s(2.0), Some(1)).unwrap()
}

#[test]
fn sweeps_go_from_the_bottom_over_odd_swings_too() {
    let law = Law::sweep(4.0, 25, s(0.1)).unwrap();
    at(&law, 0.05, 0.0);
    at(&law, 0.1 + 0.125, 25.0);
    at(&law, 0.1 + 0.0625, 12.5);
    at(&law, 0.1 + 1000.25, 0.0);
    assert_eq!((law.end(), law.class()), (None, Class::ClosedForm));
    assert!(Law::sweep(0.0, 25, Time::ZERO).is_err() && Law::sweep(1.0, 0, Time::ZERO).is_err());
    contiguous(&law, 100);
}

#[test]
fn constant_speed_loses_nothing_over_days() {
    // 1/3 in binary; after 2^30 s the product has 83 bits.
    let speed = 1e8 / 3.0;
    let law = Law::speed(speed, None).unwrap();
    let windows_in = |t: f64| (t / (law.pieces().next().unwrap().unwrap().end.seconds())) as usize;
    let piece = law.pieces().nth(windows_in(262_144.0)).unwrap().unwrap();
    assert_eq!(piece.start, s(262_144.0));
    // speed × 2^18 is exact in f64.
    assert_eq!(piece.origin as f64 + piece.curve.value(0.0), speed * 262_144.0);
    assert_eq!(piece.curve.value(0.0), (speed * 262_144.0) - (speed * 262_144.0).round());
    at(&Law::speed(-2.5, Some(s(7.0))).unwrap(), 100.0, -17.5);
    assert_eq!(contiguous(&Law::rest(s(3.0)).unwrap(), 10), 1);
}

#[test]
fn combinations() {
    let forth = sine;
    at(&forth().scaled(-0.5).unwrap().shifted(7.0).unwrap().delayed(s(3.0)).unwrap(), 4.0, -93.0);
    at(&forth().shifted(7.0).unwrap().delayed(s(3.0)).unwrap(), 1.0, 7.0);
    let ramp = Law::speed(10.0, Some(s(3.0))).unwrap();
    at(&Law::sum(vec![forth(), ramp.clone()]).unwrap(), 1.0, 210.0);
    // Each stays where it ended.
    at(&Law::sum(vec![forth(), ramp.clone()]).unwrap(), 2.5, 25.0);
    let then = Law::then(vec![ramp.clone(), forth().shifted(99.0).unwrap(), ramp.clone()]).unwrap();
    at(&then, 4.0, 230.0);
    at(&then, 8.0, 60.0);
    contiguous(&then, 100);
    let endless = ramp.clone().repeated(None).unwrap();
    at(&endless, 3.0 * 20_000.0 + 1.5, 30.0 * 20_000.0 + 15.0);
    assert_eq!(endless.end(), None);
    assert_eq!(ramp.clone().repeated(Some(5)).unwrap().end(), Some(s(15.0)));
    assert_eq!(Law::sum(vec![forth(), endless.clone()]).unwrap().end(), None);
    for wrong in [
        Law::then(vec![endless.clone(), forth()]),
        endless.repeated(Some(2)),
        forth().repeated(Some(0)),
        // Every part of a motion that is repeated is looked at beforehand: not for ever.
        Law::sine(1.0, s(1.0), Some(u64::MAX)).and_then(|law| law.repeated(Some(2))),
        Law::sum(vec![]),
        forth().scaled(f64::NAN),
        forth().delayed(s(-1.0)),
    ] {
        assert!(matches!(wrong, Err(LawError::Parameter(_))), "{wrong:?}");
    }
}

#[test]
fn polynomials_must_meet() {
    let rise = (Time::SECOND, vec![0.0, 0.0, 5.0]);
    let on = |from: f64| (Time::SECOND, vec![from, 10.0]);
    assert!(Law::polynomials([rise.clone(), on(5.0)]).is_ok());
    let jump = Law::polynomials([rise, on(6.0)]).unwrap_err();
    assert_eq!(jump, LawError::Jump { at_s: 1.0, from: 5.0, to: 6.0 });
}

#[test]
fn a_delayed_beginning_waits_for_rest() {
    // Starts at full speed; at rest first at π/2.
    let law = Law::formula("100*sin(t)", &[], 1.0, None).unwrap().beginning(Begin::Delay).unwrap();
    at(&law, 1.0, 100.0);
    at(&law, 4.0, 100.0 * 4f64.sin());
    // At rest where the speed only touches zero.
    let law = Law::formula("100*(t + sin(t))", &[], 1.0, None).unwrap().beginning(Begin::Delay).unwrap();
    at(&law, 0.0, 100.0 * std::f64::consts::PI);
    contiguous(&law, 50);
    let never = Law::speed(10.0, Some(s(5.0))).unwrap().beginning(Begin::Delay).unwrap_err();
    assert!(never.to_string().contains("does not come to rest"), "{never}");
}

#[test]
fn ramps_stay_within_their_limits() {
    let law = Law::formula("1000*t + 300*sin(7*t)", &[], 1.0, Some(s(9.0))).unwrap();
    let (max_speed, max_acceleration) = (3500.0, 20_000.0);
    let law = law.beginning(Begin::Ramp { max_speed, max_acceleration }).unwrap();
    let law = law.ending(End::Ramp { max_speed, max_acceleration }).unwrap();
    contiguous(&law, 1000);
    assert_eq!((law.end(), law.class()), (Some(s(9.0)), Class::Enclosed));
    let mut cursor = Cursor::new(&law);
    let mut most = (0.0_f64, 0.0_f64);
    let mut before = cursor.at(Time::ZERO).unwrap();
    assert!(before.position.abs() < 1e-12 && before.speed == 0.0, "{before:?}");
    for k in 1..=90_000 {
        let now = cursor.at(Time::from_ratio(k, 10_000)).unwrap();
        assert!((now.speed - before.speed).abs() <= max_acceleration * 1.1e-4, "{now:?}");
        most = (most.0.max(now.speed.abs()), most.1.max(now.acceleration.abs()));
        before = now;
    }
    assert!(most.0 <= max_speed && most.1 <= max_acceleration, "{most:?}");
    assert!(before.speed.abs() < 1e-6 && (before.position - (9000.0 + 300.0 * 63f64.sin())).abs() < 1e-6, "{before:?}");

    let refused = Law::speed(1000.0, Some(s(1.0))).unwrap();
    let refused = refused.beginning(Begin::Ramp { max_speed: 900.0, max_acceleration: 1e9 }).unwrap_err().to_string();
    assert!(
        refused.contains("max_speed = 900.0 steps/s: the law runs at 1000.0 steps/s")
            && refused.contains("the way that it loses"),
        "{refused}"
    );
    // docs/motion-files.md: it is faster than the law meanwhile.
    let endless = |max_speed| Law::speed(1000.0, None)?.beginning(Begin::Ramp { max_speed, max_acceleration: 2000.0 });
    assert!(endless(1500.0).is_err() && endless(1520.0).is_ok());
    let refused = Law::speed(1000.0, Some(s(1.0))).unwrap();
    let refused = refused.ending(End::Ramp { max_speed: 9e9, max_acceleration: 10.0 }).unwrap_err().to_string();
    assert!(refused.contains("max_acceleration = 10.0 steps/s²"), "{refused}");
}

/// Where a ramp cannot catch up, one that stays behind can do: it joins speed and acceleration, and is never faster than the law.
#[test]
fn a_ramp_may_stay_behind() {
    let limits = (1000.0, 2000.0);
    let begun = |law: &Law, (max_speed, max_acceleration)| {
        law.clone().beginning(Begin::RampBehind { max_speed, max_acceleration })
    };
    let law = Law::speed(1000.0, None).unwrap();
    let behind = begun(&law, limits).unwrap();
    contiguous(&behind, 50);
    // From rest to 1000 steps/s, at 1.5 times the mean acceleration: 0.75 s, in which 375 steps are made of 750.
    let [Behind { steps, ramp, ends: false }] = behind.behind()[..] else { panic!("{behind:?}") };
    assert!((steps - 375.0).abs() < 0.5 && (ramp.seconds() - 0.75).abs() < 1e-3, "{steps} {ramp:?}");
    assert_eq!(behind.cycle(), Some((ramp, Time::SECOND)));

    for (text, limits) in [("1000*t + 300*sin(7*t)", (3200.0, 20_000.0)), ("-500*t - 200*t^2", (2e3, 900.0))] {
        let law = Law::formula(text, &[], 1.0, Some(s(3.0))).unwrap();
        let behind = begun(&law, limits).unwrap();
        contiguous(&behind, 1000);
        let [Behind { steps, ramp, ends: false }] = behind.behind()[..] else { panic!("{behind:?}") };
        let (mut exact, mut cursor) = (Cursor::new(&law), Cursor::new(&behind));
        let first = cursor.at(Time::ZERO).unwrap();
        assert_eq!((first.speed, first.acceleration), (0.0, 0.0));
        for k in 1..=3000 {
            let t = Time::from_ratio(k, 1000);
            let (law, now) = (exact.at(t).unwrap(), cursor.at(t).unwrap());
            assert!(now.speed.abs() <= limits.0 && now.acceleration.abs() <= limits.1 * 1.001, "{now:?}");
            if t >= ramp {
                assert!((law.position - now.position - steps).abs() < 1e-6, "{law:?} {now:?} {steps}");
                assert!((law.speed - now.speed).abs() < 1e-6);
            }
        }
        // Just after the ramp's end both ways of going on meet.
        let (before, after) = (cursor.at(ramp).unwrap(), cursor.at(ramp + Time::from_ratio(1, 1_000_000_000)).unwrap());
        assert!((before.speed - after.speed).abs() < 1e-3 && (before.position - after.position).abs() < 1e-4);
        assert!((before.acceleration - after.acceleration).abs() < 0.1);
    }
    // No ramp is within a limit that the law itself breaks.
    let refused = begun(&law, (900.0, 2000.0)).unwrap_err().to_string();
    assert!(refused.contains("max_speed = 900.0 steps/s") && !refused.contains("loses"), "{refused}");
    assert_eq!(law.behind(), []);
}

/// Its twin at the end: it leaves speed and acceleration for rest, is never faster than the law, and stops before that does.
#[test]
fn a_ramp_may_stop_early() {
    let ended =
        |law: &Law, (max_speed, max_acceleration)| law.clone().ending(End::RampBehind { max_speed, max_acceleration });
    let law = Law::speed(1000.0, Some(s(2.0))).unwrap();
    let early = ended(&law, (1000.0, 2000.0)).unwrap();
    // 0.75 s, in which 375 steps are made of 750.
    let [Behind { steps, ramp, ends: true }] = early.behind()[..] else { panic!("{early:?}") };
    assert!((steps - 375.0).abs() < 0.5 && (ramp.seconds() - 0.75).abs() < 1e-3, "{steps} {ramp:?}");

    for (text, limits) in [("1000*t + 300*sin(7*t)", (3200.0, 20_000.0)), ("-500*t - 200*t^2", (2e3, 4e3))] {
        let law = Law::formula(text, &[], 1.0, Some(s(3.0))).unwrap();
        let early = ended(&law, limits).unwrap();
        contiguous(&early, 1000);
        assert_eq!(early.end(), law.end());
        let [Behind { steps, ramp, ends: true }] = early.behind()[..] else { panic!("{early:?}") };
        let (mut exact, mut cursor) = (Cursor::new(&law), Cursor::new(&early));
        for k in 1..=3000 {
            let t = Time::from_ratio(k, 1000);
            let (law, now) = (exact.at(t).unwrap(), cursor.at(t).unwrap());
            assert!(now.speed.abs() <= limits.0 && now.acceleration.abs() <= limits.1 * 1.001, "{now:?}");
            if t + ramp <= s(3.0) {
                assert!((law.position - now.position).abs() < 1e-9, "{law:?} {now:?}");
            }
        }
        let (law, last) = (exact.at(s(3.0)).unwrap(), cursor.at(s(3.0)).unwrap());
        assert!((last.speed, last.acceleration) == (0.0, 0.0), "{last:?}");
        assert!((law.position - last.position - steps).abs() < 1e-6, "{law:?} {last:?} {steps}");
        // Where it leaves the law both ways of coming there meet.
        let (leaves, just) = (s(3.0) - ramp, Time::from_ratio(1, 1_000_000_000));
        let (before, after) = (cursor.at(leaves - just).unwrap(), cursor.at(leaves + just).unwrap());
        assert!((before.speed - after.speed).abs() < 1e-3 && (before.position - after.position).abs() < 1e-4);
        assert!((before.acceleration - after.acceleration).abs() < 0.1);
    }
}

/// Just as long as the law is none that begins where the law has ended already, at rest: it would not move.
#[test]
fn a_ramp_is_no_longer_than_its_law() {
    let law = Law::speed(6400.0, Some(Time::from_ratio(1, 10))).unwrap();
    let limits = |max_acceleration| Begin::RampBehind { max_speed: 16_000.0, max_acceleration };
    assert!(law.clone().beginning(limits(96_000.0)).is_err());
    let begun = law.clone().beginning(limits(96_200.0)).unwrap();
    assert!((begun.behind()[0].steps - 320.0).abs() < 1.0, "{:?}", begun.behind());
    let end = End::Ramp { max_speed: 16_000.0, max_acceleration: 96_000.0 };
    let needed = law.ending(end).unwrap_err().to_string();
    assert!(needed.contains("the gentlest needs 2"), "{needed}");
}

#[test]
fn a_law_of_too_many_parts_has_no_other_end() {
    let law = Law::sine(100.0, Time::SECOND, Some(1_000_000_000_000)).unwrap();
    assert!(matches!(law.ending(End::Jump), Err(LawError::Parameter(_))));
}

#[test]
fn jumps_are_marked() {
    let law = Law::speed(1000.0, Some(s(1.0))).unwrap().beginning(Begin::Jump).unwrap().ending(End::Jump).unwrap();
    let pieces: Vec<Piece> = law.pieces().map(Result::unwrap).collect();
    assert_eq!(pieces[0].entry, Entry::SpeedJump);
    let last = pieces.last().unwrap();
    assert_eq!((last.entry, position(last, last.last())), (Entry::SpeedJump, 1000.0));
    contiguous(&law, 10);
}

/// The inverse gives back the time of every position on the stretch.
#[track_caller]
fn inverts(curve: &Curve, a: f64, b: f64) {
    let inverse = curve.inverse(a, b).unwrap();
    for k in 0..=10 {
        let u = a + (b - a) * f64::from(k) / 10.0;
        let x = curve.value(u);
        let got = match inverse {
            Inverse::Line { u0, x0, speed } => u0 + (x - x0) / speed,
            Inverse::Parabola { u0, x0, half_acceleration, later, .. } => {
                let way = ((x - x0) / half_acceleration).max(0.0).sqrt();
                if later { u0 + way } else { u0 - way }
            }
            Inverse::Arccosine { u0, x0, swing, omega, .. } => {
                u0 + (1.0 - 2.0 * (x - x0) / swing).clamp(-1.0, 1.0).acos() / omega
            }
            Inverse::Quadratic { x0, c } => c[0] + (x - x0) * (c[1] + (x - x0) * c[2]),
        };
        assert!((got - u).abs() <= 2e-7 * (b - a), "{inverse:?} at {u}: {got}");
    }
}

#[test]
fn inverses() {
    inverts(&Curve::Polynomial(vec![3.0, -2.0]), 0.0, 5.0);
    inverts(&Curve::Polynomial(vec![3.0, -4.0, 2.0]), 1.0, 5.0);
    inverts(&Curve::Polynomial(vec![3.0, -4.0, -2.0]), -7.0, -1.0);
    let cosine = Curve::Cosine { offset: 5.0, amplitude: -3.0, omega: 2.0, phase: 1.0 };
    let turn = |k: f64| (k * std::f64::consts::PI - 1.0) / 2.0;
    inverts(&cosine, turn(0.0), turn(1.0));
    inverts(&cosine, turn(1.2), turn(1.7));
    inverts(&cosine, turn(-3.0), turn(-2.0));
    inverts(&Curve::TimerRamp { u0: 0.5, x0: 3.0, factor: -1.0, linear: 1e-3, quadratic: -1e-6 }, 0.5, 0.6);
    // Over a turning point, at rest, and of higher degree there is none.
    assert_eq!(cosine.inverse(turn(0.5), turn(1.5)), None);
    assert_eq!(Curve::Polynomial(vec![3.0, -4.0, 2.0]).inverse(0.0, 5.0), None);
    assert_eq!(Curve::Polynomial(vec![3.0]).inverse(0.0, 5.0), None);
    assert_eq!(Curve::Polynomial(vec![0.0, 1.0, 0.0, 1.0]).inverse(0.0, 5.0), None);
}

#[test]
fn closed_forms_have_inverses() {
    let ramp = TimerRamp { steps: 90, tick_s: 8e-6, start_count: 255, cruise_count: 18, accelerate_during: 10 };
    let winch = [(Time::ZERO, WinchCommand::Target(300.0))];
    for law in [
        Law::sine(7.0, s(3.0), Some(2)),
        Law::trapezoid(-700.0, 100.0, 300.0, 200.0),
        Law::timer_ramp(ramp),
        Law::speed(-3.0, Some(s(2.0))),
        Law::winch(&winch, WinchSettings::default(), Some(s(1.0))),
        Law::then(vec![Law::rest(s(1.0)).unwrap(), sine().scaled(-2.0).unwrap()]),
    ] {
        let law = law.unwrap();
        assert_eq!(law.class(), Class::ClosedForm);
        for piece in law.pieces() {
            let piece = piece.unwrap();
            let (a, b) = (piece.first(), piece.last());
            // A parabola may turn within its piece: either side has its own.
            let turn = piece.curve.jet(a)[1] * piece.curve.jet(b)[1] < 0.0;
            let still = piece.curve.value(a) == piece.curve.value(b) && piece.curve.jet(a)[1] == 0.0;
            assert!(turn || still || piece.curve.inverse(a, b).is_some(), "{piece:?}");
        }
    }
}

fn trees() -> impl Strategy<Value = Law> {
    let leaf = prop_oneof![
        (1.0_f64..1e4, 0.01_f64..3.0, 1_u64..4).prop_map(|(a, t, n)| Law::sine(a, s(t), Some(n))),
        (-1e4_f64..1e4, 0.01_f64..9.0).prop_map(|(v, t)| Law::speed(v, Some(s(t)))),
        (1.0_f64..1e4, 1.0_f64..1e4).prop_map(|(d, v)| Law::trapezoid(d, v, 3.0 * v, 2.0 * v)),
        (-1e4_f64..1e4, -2e3_f64..2e3).prop_map(|(distance, start_speed)| {
            let (max_speed, max_acceleration, max_jerk) = (1e3, 4e3, 5e4);
            Law::s_curve(SCurve { distance, max_speed, max_acceleration, max_jerk, start_speed })
        }),
        (1_i64..500, 2_u32..200).prop_map(|(steps, cruise_count)| {
            Law::timer_ramp(TimerRamp { steps, tick_s: 8e-6, start_count: 255, cruise_count, accelerate_during: 10 })
        }),
        prop::collection::vec((0.01_f64..1.0, -1e3_f64..1e3), 2..6).prop_map(|rows| {
            let mut t = 0.0;
            let rows: Vec<_> = rows
                .into_iter()
                .map(|(dt, x)| {
                    t += dt;
                    (t, x)
                })
                .collect();
            Law::table(&rows, Interpolation::Monotone)
        }),
        (1.0_f64..30.0).prop_map(|w| {
            let text = "abs(50*sin(w*t)) + 3*t*exp(-t)";
            Ok(Law::formula(text, &[("w".into(), w)], 2.0, Some(s(1.5))).unwrap())
        }),
        (-500.0_f64..500.0).prop_map(|x| {
            Law::winch(&[(s(0.01), WinchCommand::Target(x))], WinchSettings::default(), Some(s(0.05)))
        }),
    ]
    .prop_map(Result::unwrap);
    leaf.prop_recursive(3, 8, 3, |inner| {
        prop_oneof![
            prop::collection::vec(inner.clone(), 1..4).prop_map(|laws| Law::sum(laws).unwrap()),
            prop::collection::vec(inner.clone(), 1..4).prop_map(|laws| Law::then(laws).unwrap()),
            (inner.clone(), -3.0_f64..3.0).prop_map(|(law, k)| law.scaled(k).unwrap()),
            (inner.clone(), -1e3_f64..1e3).prop_map(|(law, x)| law.shifted(x).unwrap()),
            (inner.clone(), 0.001_f64..2.0).prop_map(|(law, d)| law.delayed(s(d)).unwrap()),
            (inner.clone(), 1_u64..4).prop_map(|(law, n)| law.repeated(Some(n)).unwrap()),
            (inner.clone(), inner, 0.0_f64..2.0, 0.01_f64..2.0)
                .prop_map(|(old, new, from, over)| old.faded(new, s(from), s(over)).unwrap()),
        ]
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    #[test]
    fn any_law_s_pieces_follow_and_meet(law in trees()) {
        contiguous(&law, 20_000);
    }

    /// A sum is what its terms are, wherever its pieces are cut and their zeros moved.
    #[test]
    fn sums_are_the_sum(a in trees(), b in trees(), part in 0.0_f64..1.2) {
        let sum = Law::sum(vec![a.clone(), b.clone()]).unwrap();
        let t = s(part * sum.end().unwrap().seconds());
        let [x, y, z] = [&a, &b, &sum].map(|law| Cursor::new(law).at(t).unwrap());
        prop_assert!((x.position + y.position - z.position).abs() < 1e-7 * (1.0 + x.position.abs() + y.position.abs()));
        prop_assert!((x.speed + y.speed - z.speed).abs() < 1e-6 * (1.0 + x.speed.abs() + y.speed.abs()), "{x:?} {y:?} {z:?}");
    }
}

/// Laws of all kinds, endless ones too.
fn any_laws() -> impl Strategy<Value = Law> {
    let rate = || (0_u32..5).prop_map(|k| Rate::of(0.7 * f64::from(k)).unwrap());
    let endless = prop_oneof![
        (1.0_f64..1e4, 0.01_f64..3.0).prop_map(|(a, t)| Law::sine(a, s(t), None)),
        (1.0_f64..1e4, 0.01_f64..3.0, 0_usize..2).prop_map(|(r, t, k)| Law::circle(r, s(t), None, k)),
        (-1e8_f64..1e8).prop_map(|v| Law::speed(v, None)),
        (0.1_f64..300.0)
            .prop_map(|w| { Ok(Law::formula("t + 5*sin(w*t)^2 + sin(t)", &[("w".into(), w)], 20.0, None).unwrap()) }),
        (0.1_f64..30.0)
            .prop_map(|w| { Ok(Law::formula("abs(sin(w*t)) + sqrt(t + 1)", &[("w".into(), w)], 20.0, None).unwrap()) }),
        (0.1_f64..3.0).prop_map(|speed| Law::lorenz(Orbit::CLASSIC, 0, 10.0, speed, None)),
        trees().prop_map(|law| law.repeated(None)),
    ];
    let finite = prop_oneof![
        (1.0_f64..1e4, 0.01_f64..3.0, 1_u64..30, 0_usize..2).prop_map(|(r, t, n, k)| Law::circle(r, s(t), Some(n), k)),
        (0.01_f64..2.0, prop::collection::vec((1.0_f64..2e5, -1e3_f64..1e3), 2..6)).prop_map(|(begin, rows)| {
            let mut t = begin;
            let row = |(dt, x): (f64, f64)| {
                t += dt;
                (t - dt, x)
            };
            Law::table(&rows.into_iter().map(row).collect::<Vec<_>>(), Interpolation::Linear)
        }),
        (1e5_f64..1e6, -9.0_f64..9.0)
            .prop_map(|(t, v)| Law::polynomials([(s(t), vec![0.0, v]), (s(2.0), vec![v * t])])),
        trees().prop_map(Ok),
    ];
    let laws = prop_oneof![endless.prop_map(Result::unwrap), finite.prop_map(Result::unwrap)].boxed();
    let changed =
        (laws.clone(), laws.clone(), laws.clone(), rate(), rate(), 0.0_f64..60.0, 0.0_f64..9.0, 0.01_f64..30.0)
            .prop_map(|(law, second, third, before, to, from, after, over)| {
                let ease = Ease { before, after: s(after), over: s(over), to };
                let limits = (1e6, 1e8);
                let Ok(retimed) = law.clone().retimed(s(from), ease) else { panic!("{ease:?}") };
                let mut all = vec![
                    Law::sum(vec![law.clone(), second.clone(), retimed.clone()]),
                    second.clone().delayed(s(over)),
                    law.clone().stopped(s(over), 1e4, 0.0),
                    law.clone().beginning(Begin::Jump),
                    law.clone().beginning(Begin::Ramp { max_speed: limits.0, max_acceleration: limits.1 }),
                    law.clone().with_backlash(3.0, s(1e-4)),
                    retimed.clone().eased_out(s(0.5 * from), s(after), s(over)),
                    law.clone().ending(End::Jump),
                    retimed.clone().faded(second.clone(), s(from), s(over)),
                ];
                if law.end().is_some() {
                    let two = vec![law.clone(), third.scaled(-0.5).unwrap()];
                    all.push(Law::then(two.clone()));
                    all.push(Law::then(two).and_then(|both| Law::sum(vec![both, second])));
                }
                let mut all: Vec<Law> = all.into_iter().filter_map(Result::ok).collect();
                all.extend([law, retimed]);
                all
            });
    changed.prop_flat_map(prop::sample::select)
}

/// The pieces from `at` on are those that a walk from 0 finds there, bit for bit.
fn same_from(law: &Law, at: Time) {
    let mut walk = law.pieces();
    let (mut wanted, mut last) = (Vec::new(), None);
    for piece in walk.by_ref() {
        match piece {
            Ok(piece) if piece.end <= at => last = Some(Ok(piece)),
            other => {
                wanted.push(other);
                break;
            }
        }
    }
    if wanted.is_empty() {
        wanted.extend(last);
    }
    wanted.extend(walk.take(4));
    let found: Vec<_> = law.pieces_from(at).take(wanted.len()).collect();
    assert_eq!(format!("{found:?}"), format!("{wanted:?}"), "at {at:?} of {law:?}");
}

proptest! {
    /// At any time, and at all times next to the ends of pieces.
    #[test]
    fn pieces_from_a_time_on_are_those_of_a_walk(law in any_laws(), part in -0.1_f64..1.2, place in 0_usize..300) {
        let span = law.end().unwrap_or(s(200.0)).min(s(1e6));
        same_from(&law, s(part * span.seconds()));
        if let Some(Ok(piece)) = law.pieces().take(place + 1).last() {
            for off in -1..=1 {
                same_from(&law, piece.end + Time::from_raw(off));
            }
        }
    }
}

/// Long after the easing, too: the law's time has no rounding that grows.
#[test]
fn a_retimed_law_keeps_its_path_at_another_rate() {
    let laws = [
        Law::sine(400.0, s(0.3), None).unwrap(),
        Law::formula("30*sin(3*t)^3 + 2*t", &[], 1.0, None).unwrap(),
        Law::speed(123.4, None).unwrap(),
    ];
    for (row, law) in laws.iter().enumerate() {
        for (r0, r1) in [(1.0, 0.5), (1.0, 2.0), (0.25, 3.7), (2.5, 0.1)] {
            let (before, to) = (Rate::of(r0).unwrap(), Rate::of(r1).unwrap());
            let (r0, r1) = (before.get(), to.get());
            let ease = Ease { before, after: s(0.5), over: s(0.25), to };
            let retimed = law.clone().retimed(s(7.0), ease).unwrap();
            contiguous(&retimed, 3000);
            let (mut own, mut got) = (Cursor::new(law), Cursor::new(&retimed));
            let early = (0..=100).map(|k| 0.01 * f64::from(k));
            for t in early.chain([1000.25, 86_400.125]) {
                let x = ((t - 0.5) / 0.25).clamp(0.0, 1.0);
                let eased = 0.25 * (r0 * x + (r1 - r0) * (x.powi(3) - 0.5 * x.powi(4)));
                let time = 7.0 + r0 * t.min(0.5) + eased + r1 * (t - 0.75).max(0.0);
                let rate = r0 + (r1 - r0) * (3.0 * x * x - 2.0 * x.powi(3));
                let (got, want) = (got.at(s(t)).unwrap(), own.at(s(time)).unwrap());
                // `time` is an f64: at a day it is off by 1e-11 s.
                let near = 1e-9 * (1.0 + want.position.abs()) + 3e-11 * want.speed.abs();
                assert!((got.position - want.position).abs() <= near, "{row} {r0} {r1} at {t} s: {got:?} {want:?}");
                let speed = rate * want.speed;
                assert!((got.speed - speed).abs() <= 1e-6 * (1.0 + speed.abs()), "{row} {r0} {r1} at {t} s");
            }
        }
    }
}

#[test]
fn an_eased_law_keeps_its_path_and_goes_on_where_it_halted() {
    let laws = [
        sine(),
        Law::sine(-40.0, s(0.3), None).unwrap(),
        Law::trapezoid(500.0, 300.0, 700.0, 700.0).unwrap(),
        Law::formula("30*sin(3*t)^3 + t^2", &[], 1.0, None).unwrap(),
        Law::winch(&[(Time::ZERO, WinchCommand::Target(300.0))], WinchSettings::default(), None).unwrap(),
    ];
    for (row, law) in laws.iter().enumerate() {
        let (from, after, over, back) = (s(0.1), s(0.55), s(0.4), s(0.25));
        let halt = from + after + over.divided_by(2);
        let out = law.clone().eased_out(from, after, over).unwrap();
        let again = law.clone().eased_in(halt, back).unwrap();
        assert_eq!((out.end(), out.class()), (Some(after + over), law.class().max(Class::Enclosed)), "{row}");
        contiguous(&out, 10_000);
        contiguous(&again, 3000);
        let (mut own, mut slowed) = (Cursor::new(law), Cursor::new(&out));
        for k in 0..=950 {
            let t = 0.001 * f64::from(k);
            let x = ((t - 0.55) / 0.4).max(0.0);
            let (time, rate) = if x > 0.0 {
                (0.65 + 0.4 * (x - x.powi(3) + 0.5 * x.powi(4)), 1.0 - 3.0 * x * x + 2.0 * x.powi(3))
            } else {
                (0.1 + t, 1.0)
            };
            let (got, want) = (slowed.at(s(t)).unwrap(), own.at(s(time)).unwrap());
            assert!((got.position - want.position).abs() <= 1e-9 * (1.0 + want.position.abs()), "{row} at {t} s");
            assert!((got.speed - rate * want.speed).abs() <= 1e-6 * (1.0 + want.speed.abs()), "{row} at {t} s");
        }
        assert!(slowed.at(s(0.95)).unwrap().speed.abs() < 1e-9, "{row}");
        // From the halt on, and half the easing late for good.
        let mut resumed = Cursor::new(&again);
        let first = resumed.at(Time::ZERO).unwrap();
        assert!((first.position - slowed.at(s(0.95)).unwrap().position).abs() < 1e-9 && first.speed == 0.0, "{row}");
        for k in 0..=100 {
            let t = back + s(0.0101 * f64::from(k));
            let (got, want) = (resumed.at(t).unwrap(), own.at(halt + t - back.divided_by(2)).unwrap());
            assert!((got.position - want.position).abs() <= 1e-9 * (1.0 + want.position.abs()), "{row} at {t:?}");
        }
    }
    // After its end a law stays where it is, eased or not.
    let law = Law::speed(10.0, Some(s(1.0))).unwrap();
    let out = law.clone().eased_out(s(0.5), s(2.0), s(1.0)).unwrap();
    at(&out, 0.25, 7.5);
    at(&out, 2.5, 10.0);
    assert_eq!(out.end(), Some(s(3.0)));
    assert_eq!(law.clone().eased_in(s(0.5), s(0.5)).unwrap().end(), Some(s(0.75)));
    let over = law.clone().eased_in(s(2.0), s(0.5)).unwrap();
    at(&over, 0.25, 10.0);
    assert_eq!(over.end(), Some(s(0.5)));
    assert!(law.clone().eased_out(s(-1.0), Time::ZERO, s(1.0)).is_err());
    assert!(law.eased_in(Time::ZERO, Time::ZERO).is_err());
}
