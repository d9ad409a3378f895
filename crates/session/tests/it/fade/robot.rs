//! Changes of a delta robot's path: the effector stays on the blend of both paths.

use super::*;
use pulsetrain_motion::Grid;
use pulsetrain_motion::law::{Cursor, Interpolation, Joint, fade_weight};
use pulsetrain_motion::machine::{Delta, Kinematics, Machine};
use pulsetrain_session::pause::{Ceiling, Limited};

const ROBOT: Delta = Delta { base_mm: 60.0, upper_arm_mm: 70.0, forearm_mm: 150.0, effector_mm: 25.0 };
const STEPS_PER_RAD: f64 = 3200.0 / std::f64::consts::TAU;

type Tip = [Law; 3];

/// The robot on a path, each arm's angle in `angles`, rad.
fn robot_of(laws: [Law; 3], angles: Option<(f64, f64)>) -> Program {
    let home = laws.iter().map(|law| Cursor::new(law).at(Time::ZERO).unwrap().position).collect();
    let mut robot =
        program(16, laws.into_iter().enumerate().map(|(arm, law)| motor(arm, law, false, LIMITS)).collect());
    robot.machines = vec![Machine {
        name: "robot".into(),
        motors: vec![0, 1, 2],
        kinematics: Kinematics::Delta { arms: ROBOT, steps_per_rad: [STEPS_PER_RAD; 3], angles },
        home,
        slack: vec![0.0; 3],
        tip_limits: [None; 2],
        unit: "mm".into(),
    }];
    robot
}

fn joint(arm: usize) -> Joint {
    Joint::new(ROBOT, arm, STEPS_PER_RAD)
}

fn robot(tip: &Tip) -> Program {
    robot_of([0, 1, 2].map(|arm| Law::arm(joint(arm), tip.clone())), None)
}

/// As a file's path is read.
fn robot_of_file(tip: &Tip) -> Program {
    robot_of([0, 1, 2].map(|arm| Law::delta_arm(&ROBOT, arm, tip, STEPS_PER_RAD).unwrap()), None)
}

fn at_rest(mm: f64) -> Law {
    Law::speed(0.0, None).unwrap().shifted(mm).unwrap()
}

fn swing(amplitude: f64, period_s: f64, middle: f64) -> Law {
    sine(amplitude, period_s).shifted(middle - amplitude).unwrap()
}

fn wide() -> Tip {
    [swing(35.0, 1.3, 0.0), swing(-30.0, 1.7, 5.0), swing(8.0, 0.9, -145.0)]
}

fn narrow() -> Tip {
    let formula = |text: &str| Law::formula(text, &[], 1.0, None).unwrap();
    [formula("14*cos(5*t)"), formula("9*cos(4*t)"), at_rest(-160.0)]
}

fn rows() -> Tip {
    let table = |values: [f64; 6]| {
        let rows: Vec<(f64, f64)> = [0.0, 0.2, 1.0, 2.5, 3.2, 6.0].into_iter().zip(values).collect();
        Law::table(&rows, Interpolation::Monotone).unwrap()
    };
    [
        table([-20.0, -20.0, 20.0, 25.0, 0.0, 0.0]),
        table([0.0, 0.0, 10.0, -25.0, -30.0, -30.0]),
        table([-150.0, -150.0, -140.0, -140.0, -155.0, -155.0]),
    ]
}

/// The effector and its speed at a time, s.
fn at(cursors: &mut [Cursor; 3], at_s: f64) -> [[f64; 2]; 3] {
    cursors.each_mut().map(|cursor| cursor.at(seconds(at_s)).map(|sample| [sample.position, sample.speed]).unwrap())
}

/// The fades of a run: from when, for how long, s, and to which path.
struct Faded<'a>(f64, f64, &'a Tip);

/// Each step comes where the inverse kinematics of the blend of the paths crosses its level, to the tolerance, and all of them come.
#[track_caller]
fn check_steps(lab: &Lab, zero: u64, until: u64, begun: &Tip, fades: &[Faded<'_>]) {
    let mut first = begun.each_ref().map(Cursor::new);
    let mut others: Vec<([Cursor; 3], f64, f64)> =
        fades.iter().map(|Faded(from, over, tip)| (tip.each_ref().map(Cursor::new), *from, *over)).collect();
    let mut tip = |at_s: f64| {
        let mut mixed = at(&mut first, at_s);
        for (cursors, from, over) in &mut others {
            let [w, slope, _] = fade_weight(((at_s - *from) / *over).clamp(0.0, 1.0));
            for ([position, speed], new) in mixed.iter_mut().zip(at(cursors, at_s)) {
                *speed += w * (new[1] - *speed) + slope / *over * (new[0] - *position);
                *position += w * (new[0] - *position);
            }
        }
        mixed
    };
    for (arm, steps) in lab.steps.iter().enumerate() {
        let mut theta = |tick: u64| {
            joint(arm).motion(tip((tick - zero) as f64 / TICK_HZ as f64).map(|[at, speed]| [at, speed, 0.0]))
        };
        let start = theta(zero)[0];
        let (mut count, mut seen) = (0, 0);
        for (tick, way) in steps.iter().filter(|(tick, _)| *tick <= until) {
            let level = start + (count as f64) + (0.5 + Grid::NEAREST.hysteresis) * *way as f64;
            let [position, speed, _] = theta(*tick);
            // A tick of tolerance; near a turning point the level is touched.
            let allowed = 2.0 / TICK_HZ as f64 * speed.abs() + 1e-5;
            assert!(
                (position - level).abs() <= allowed,
                "arm {arm} at tick {}: {} steps off",
                tick - zero,
                position - level
            );
            count += way;
            seen += 1;
        }
        assert!(seen > 200, "arm {arm}: {seen} steps");
        assert!((theta(until)[0] - start - count as f64).abs() < 0.53, "arm {arm}: steps are missing");
    }
}

const OVER_S: f64 = 0.7;

#[test]
fn the_effector_stays_on_the_blend_of_both_paths() {
    for (old, new) in [(wide(), narrow()), (rows(), wide()), (narrow(), rows())] {
        let begun = robot(&old);
        let mut lab = Lab::new(&begun);
        let mut session = Session::new(Bench::new(&begun, 256), begun).unwrap();
        let zero = session.zero();
        session.advance(zero + TICK_HZ, &mut lab).unwrap();
        let wanted =
            Change { program: Arc::new(robot(&new)), over: Some(seconds(OVER_S)), begins: Begins::WithTheMotion };
        let transition = session.change_to(&wanted).unwrap();
        assert!((transition.until - transition.from).abs_diff((OVER_S * TICK_HZ as f64) as u64) <= 1);
        let until = zero + 3 * TICK_HZ;
        session.advance(until, &mut lab).unwrap();
        let from_s = (transition.from - zero) as f64 / TICK_HZ as f64;
        check_steps(&lab, zero, until, &old, &[Faded(from_s, OVER_S, &new)]);
    }
}

/// The laws of a file, and a second change while the first one is under way.
#[test]
fn a_change_during_a_change_stays_on_the_blend_of_all_paths() {
    let tips = [rows(), wide(), narrow()];
    let begun = robot_of_file(&tips[0]);
    let mut lab = Lab::new(&begun);
    let mut session = Session::new(Bench::new(&begun, 256), begun).unwrap();
    let zero = session.zero();
    session.advance(zero + TICK_HZ, &mut lab).unwrap();
    let mut fades = Vec::new();
    for tip in &tips[1..] {
        let wanted =
            Change { program: Arc::new(robot(tip)), over: Some(seconds(OVER_S)), begins: Begins::WithTheMotion };
        let transition = session.change_to(&wanted).unwrap();
        assert!((transition.until - transition.from).abs_diff((OVER_S * TICK_HZ as f64) as u64) <= 1);
        fades.push(Faded((transition.from - zero) as f64 / TICK_HZ as f64, OVER_S, tip));
        session.advance(transition.from + TICK_HZ / 4, &mut lab).unwrap();
    }
    assert!(fades[1].0 < fades[0].0 + OVER_S);
    let until = zero + 4 * TICK_HZ;
    session.advance(until, &mut lab).unwrap();
    check_steps(&lab, zero, until, &tips[0], &fades);
    for steps in &lab.steps {
        check_acceleration(steps, LIMITS.max_acceleration.unwrap(), 1.5).unwrap();
    }
}

/// The shortest change of a robot keeps all motors to their limits, and is not much longer than it must be.
#[test]
fn a_quick_change_of_a_path_keeps_to_the_limits() {
    let begun = robot(&narrow());
    let mut lab = Lab::new(&begun);
    let mut session = Session::new(Bench::new(&begun, 256), begun).unwrap();
    session.advance(session.zero() + TICK_HZ, &mut lab).unwrap();
    let wanted = Change { program: Arc::new(robot(&wide())), over: None, begins: Begins::Now };
    let transition = session.change_to(&wanted).unwrap();
    session.advance(transition.until + TICK_HZ, &mut lab).unwrap();
    for steps in &lab.steps {
        check_acceleration(steps, LIMITS.max_acceleration.unwrap(), 1.5).unwrap();
    }
    let over_s = (transition.until - transition.from) as f64 / TICK_HZ as f64;
    assert!((0.02..0.5).contains(&over_s), "{over_s} s");
}

/// A robot that was stopped joins its path again: its effector goes on the blend of where it rests and the path.
#[test]
fn a_robot_that_rests_joins_its_path_on_the_blend() {
    let tip = wide();
    let begun = robot(&tip);
    let mut lab = Lab::new(&begun);
    let mut session = Session::new(Bench::new(&begun, 256), begun).unwrap();
    let zero = session.zero();
    session.advance(zero + TICK_HZ, &mut lab).unwrap();
    session.stop().unwrap();
    session.advance(zero + 2 * TICK_HZ, &mut lab).unwrap();
    let start = |arm: usize| joint(arm).motion(tip.each_ref().map(at_zero))[0];
    let count = |steps: &[(u64, i64)]| steps.iter().map(|(_, way)| way).sum::<i64>() as f64;
    let rests = [0, 1, 2].map(|arm| start(arm) + count(&lab.steps[arm]));
    let place = ROBOT.point(rests.map(|steps| steps / STEPS_PER_RAD)).unwrap();
    let stopped: Vec<usize> = lab.steps.iter().map(Vec::len).collect();
    let transition = session.rejoin().unwrap();
    session.advance(transition.until + TICK_HZ, &mut lab).unwrap();
    // The path's time went on.
    let time = |tick: u64| (tick - zero) as f64 / TICK_HZ as f64;
    let (from, over) = (time(transition.from), time(transition.until) - time(transition.from));
    let mut cursors = tip.each_ref().map(Cursor::new);
    for (arm, steps) in lab.steps.iter().enumerate() {
        let mut at_count = rests[arm];
        let mut seen = 0;
        for (tick, way) in &steps[stopped[arm]..] {
            let level = at_count + (0.5 + Grid::NEAREST.hysteresis) * *way as f64;
            let [w, ..] = fade_weight(((time(*tick) - from) / over).min(1.0));
            let path = at(&mut cursors, time(*tick));
            let blend = [0, 1, 2].map(|k| [place[k] + w * (path[k][0] - place[k]), 0.0, 0.0]);
            // The duration is known to a tick.
            let off = joint(arm).motion(blend)[0] - level;
            assert!(off.abs() < 0.01, "arm {arm} at {} s: {off} steps off", time(*tick));
            at_count += *way as f64;
            seen += 1;
        }
        assert!(seen > 100, "arm {arm}: {seen} steps");
    }
}

fn at_zero(law: &Law) -> [f64; 3] {
    [Cursor::new(law).at(Time::ZERO).unwrap().position, 0.0, 0.0]
}

/// Where the blend of two paths leaves the arms' angles, each arm fades separately, and stays between its own.
#[test]
fn arms_fade_by_themselves_where_the_blend_leaves_their_angles() {
    let place = |y: f64| [at_rest(60.0), at_rest(y), at_rest(-120.0)];
    let angle = |y: f64, arm: usize| ROBOT.angles([60.0, y, -120.0]).unwrap()[arm];
    let ends: Vec<f64> = (0..3).flat_map(|arm| [angle(-50.0, arm), angle(50.0, arm)]).collect();
    let limits = (ends.iter().copied().fold(f64::MAX, f64::min), ends.iter().copied().fold(f64::MIN, f64::max));
    // Half-way the first arm would be higher than any is on both paths.
    let dip = ((angle(0.0, 0) - angle(-50.0, 0)) * STEPS_PER_RAD).round() as i64;
    assert!(angle(0.0, 0) < limits.0 && dip < -10, "{dip}");
    let end_of = |limits| {
        let place = |y: f64| robot_of([0, 1, 2].map(|arm| Law::arm(joint(arm), place(y))), limits);
        let begun = place(-50.0);
        let mut lab = Lab::new(&begun);
        let mut session = Session::new(Bench::new(&begun, 256), begun).unwrap();
        session.advance(session.zero() + TICK_HZ, &mut lab).unwrap();
        let wanted = Change { program: Arc::new(place(50.0)), over: Some(seconds(0.5)), begins: Begins::WithTheMotion };
        let until = change(&mut session, &mut lab, &wanted).unwrap();
        session.advance(until + TICK_HZ, &mut lab).unwrap();
        let mut counts = [(0, 0); 3];
        for (steps, (count, lowest)) in lab.steps.iter().zip(&mut counts) {
            for (_, way) in steps {
                *count += way;
                *lowest = (*lowest).min(*count);
            }
        }
        counts
    };
    let moved = ((angle(50.0, 1) - angle(-50.0, 1)) * STEPS_PER_RAD).round() as i64;
    for (angles, lowest) in [(Some(limits), 0), (None, dip)] {
        let counts = end_of(angles);
        assert!(counts[0].0.abs() <= 1 && (counts[1].0 - moved).abs() <= 1, "{counts:?}, {moved}");
        assert!((counts[0].1 - lowest).abs() <= 1, "{counts:?}, {lowest}");
    }
}

/// If one arm has no path to blend, all arms of the robot fade separately.
#[test]
fn all_arms_fade_by_themselves_if_one_has_no_path() {
    let place = |y: f64| [at_rest(60.0), at_rest(y), at_rest(-120.0)];
    let angle = |y: f64, arm: usize| ROBOT.angles([60.0, y, -120.0]).unwrap()[arm] * STEPS_PER_RAD;
    let program = |y: f64| {
        let path = |arm: usize| Law::arm(joint(arm), place(y));
        robot_of([at_rest(angle(y, 0)), path(1), path(2)], None)
    };
    let begun = program(-50.0);
    let mut lab = Lab::new(&begun);
    let mut session = Session::new(Bench::new(&begun, 256), begun).unwrap();
    let wanted = Change { program: Arc::new(program(50.0)), over: Some(seconds(1.0)), begins: Begins::Now };
    let until = change(&mut session, &mut lab, &wanted).unwrap();
    session.advance(until + TICK_HZ, &mut lab).unwrap();
    let middle = until - TICK_HZ / 2;
    for arm in [1, 2] {
        let [from, to] = [-50.0, 50.0].map(|y| angle(y, arm));
        let made = lab.steps[arm].iter().filter(|(tick, _)| *tick <= middle).map(|(_, way)| way).sum::<i64>() as f64;
        let on_the_blend = angle(0.0, arm) - from;
        assert!((0.5 * (to - from) - on_the_blend).abs() > 5.0, "arm {arm}: both ways are alike");
        assert!((made - 0.5 * (to - from)).abs() < 1.5, "arm {arm}: {made} steps, the blend: {on_the_blend}");
    }
}

fn tip() -> impl Strategy<Value = Tip> {
    let coordinate = |middle: f64| {
        let swing = (-25.0..25.0f64, 0.8..2.0f64)
            .prop_filter("it swings", |(amplitude, _)| amplitude.abs() > 0.1)
            .prop_map(move |(amplitude, period_s)| swing(amplitude, period_s, middle));
        prop_oneof![
            4 => swing.clone(),
            1 => (-25.0..25.0f64).prop_map(move |at| at_rest(middle + at)),
            1 => (swing, 0.0..1.0f64).prop_map(|(law, delay_s)| law.delayed(seconds(delay_s)).unwrap()),
            1 => prop::collection::vec(-25.0..25.0f64, 6).prop_map(move |mut values| {
                // It begins and ends at rest.
                (values[1], values[5]) = (values[0], values[4]);
                let rows: Vec<(f64, f64)> = values.iter().enumerate().map(|(k, at)| (0.7 * k as f64, middle + at)).collect();
                Law::table(&rows, Interpolation::Monotone).unwrap()
            }),
        ]
    };
    (coordinate(0.0), coordinate(0.0), coordinate(-150.0)).prop_map(|(x, y, z)| [x, y, z])
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16 * rounds() as u32))]

    #[test]
    fn changes_of_a_path_keep_limits_and_counts(wishes in wishes(tip().prop_map(|tip| robot(&tip)))) {
        keeps_limits_and_counts(&robot(&narrow()), wishes)?;
    }
}

/// The machine's own limits hold for the effector too.
#[test]
fn an_effector_keeps_to_its_limits_in_a_change() {
    const LIMITS: [f64; 2] = [130.0, 600.0];
    let peaks = |tip_limits: [Option<f64>; 2]| {
        let with_limits = |tip: &Tip| {
            let mut robot = robot(tip);
            robot.machines[0].tip_limits = tip_limits;
            robot
        };
        let begun = with_limits(&[swing(25.0, 2.0, 0.0), swing(20.0, 3.0, 5.0), at_rest(-145.0)]);
        let mut lab = Lab::new(&begun);
        let mut session = Session::new(Bench::new(&begun, 256), begun.clone()).unwrap();
        session.advance(session.zero() + 3 * TICK_HZ, &mut lab).unwrap();
        let other = with_limits(&[swing(8.0, 2.0, -20.0), swing(5.0, 3.0, -20.0), at_rest(-160.0)]);
        let wanted = Change { program: Arc::new(other), over: None, begins: Begins::WithTheMotion };
        let until = session.change_to(&wanted).unwrap().until;
        tip_peaks(&mut session, &mut lab, until, |steps: [f64; 3]| {
            ROBOT.point(steps.map(|steps| steps / STEPS_PER_RAD)).unwrap()
        })
    };
    let (quick, careful) = (peaks([None; 2]), peaks(LIMITS.map(Some)));
    assert!(quick[0] > LIMITS[0] && quick[1] > LIMITS[1], "{quick:?}");
    assert!(careful[0] <= LIMITS[0] && careful[1] <= LIMITS[1], "{careful:?}");
    assert!(careful[1] > 0.5 * LIMITS[1] || careful[0] > 0.5 * LIMITS[0], "{careful:?}");
}

/// A tempo keeps to them as well, and the answer says which of them keeps it lower. While the arms change separately to another path, the tip's way is not
/// known: the tempo waits.
#[test]
fn a_tempo_keeps_to_the_limits_of_the_effector() {
    // 2π·25 mm / 2 s = 78.5 mm/s, and 246.7 mm/s².
    let there_and_back = || [swing(25.0, 2.0, 0.0), at_rest(5.0), at_rest(-145.0)];
    for (tip_limits, highest, limit) in [
        ([Some(130.0), Some(2000.0)], 0.97 * 130.0 / 78.54, "max_speed"),
        ([None, Some(400.0)], (0.97_f64 * 400.0 / 246.74).sqrt(), "max_acceleration"),
    ] {
        let with_limits = |tip: &Tip| {
            let mut robot = robot(tip);
            robot.machines[0].tip_limits = tip_limits;
            robot
        };
        let begun = with_limits(&there_and_back());
        let mut lab = Lab::new(&begun);
        let mut session = Session::new(Bench::new(&begun, 256), begun).unwrap();
        session.advance(session.zero() + TICK_HZ, &mut lab).unwrap();
        let wanted = Rate::of(2.0).unwrap();
        let tempo = session.set_tempo(wanted).unwrap();
        assert!((tempo.rate.get() - highest).abs() < 1e-3, "{tempo:?}");
        assert_eq!(tempo.ceiling, Some(Ceiling { of: Limited::Tip(0), limit }));
        session.advance(tempo.from + TICK_HZ / 2, &mut lab).unwrap();
        session.set_tempo(Rate::ONE).unwrap();
        session.advance(session.board().now() + TICK_HZ, &mut lab).unwrap();
        // The arms change separately, since a length of the first one changes.
        let path = [swing(25.0, 1.9, 0.0), at_rest(5.0), at_rest(-145.0)];
        let mut apart = with_limits(&path);
        apart.motors[0].law = Law::arm(Joint::new(Delta { forearm_mm: 151.0, ..ROBOT }, 0, STEPS_PER_RAD), path);
        let change = Change { program: Arc::new(apart), over: Some(seconds(1.0)), begins: Begins::WithTheMotion };
        let transition = session.change_to(&change).unwrap();
        session.advance(transition.from + TICK_HZ / 10, &mut lab).unwrap();
        let Err(SessionError::Waiting { until, .. }) = session.set_tempo(wanted) else { panic!("it does not wait") };
        assert!(until > transition.until - TICK_HZ / 10, "{until}, {transition:?}");
        session.advance(until, &mut lab).unwrap();
        let tempo = session.set_tempo(wanted).unwrap();
        assert!(tempo.rate < wanted && tempo.ceiling.is_some_and(|it| it.of == Limited::Tip(0)), "{tempo:?}");
    }
}
