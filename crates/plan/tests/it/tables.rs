//! Tables of round numbers, and curves that hardly bend: all are planned, and every step is where exact arithmetic has it.

use crate::common::{Step, settings, steps};
use pulsetrain_motion::law::{Class, Curve, Entry, Fixed, Interpolation, Law, Piece};
use pulsetrain_motion::program::Limits;
use pulsetrain_motion::{Grid, Time};
use pulsetrain_oracle::{Rational, rational};
use pulsetrain_plan::Settings;
use pulsetrain_testkit::Random;

/// The number itself, whatever its size.
fn exact(x: f64) -> Rational {
    let bits = x.abs().to_bits();
    let (exponent, fraction) = ((bits >> 52) as i32, i128::from(bits & ((1 << 52) - 1)));
    let (mantissa, power) = if exponent == 0 { (fraction, -1074) } else { (fraction | 1 << 52, exponent - 1075) };
    let mut exact = rational(if x < 0.0 { -mantissa } else { mantissa }, 1);
    for _ in 0..power.abs() {
        exact *= if power < 0 { rational(1, 2) } else { rational(2, 1) };
    }
    exact
}

/// A piece of polynomials in rational numbers.
struct ExactRows {
    start: Rational,
    zero: Rational,
    c: Vec<Rational>,
}

impl ExactRows {
    fn new(piece: &Piece) -> ExactRows {
        let time = |time: Time| rational(time.raw(), 1 << 64);
        let mut c: Vec<Rational> = polynomial(piece).iter().map(|c| exact(*c)).collect();
        c[0] += rational(piece.origin.into(), 1);
        ExactRows { start: time(piece.start), zero: time(piece.zero), c }
    }

    fn at(&self, t: &Rational) -> Rational {
        let u = t - &self.zero;
        self.c.iter().rev().fold(rational(0, 1), |sum, c| sum * &u + c)
    }
}

fn polynomial(piece: &Piece) -> &[f64] {
    match &piece.curve {
        pulsetrain_motion::law::Curve::Polynomial(c) => c,
        other => panic!("{other:?}"),
    }
}

/// The exact law a bound before each step has not reached it, and a bound after it has.
#[track_caller]
fn check_steps(what: &str, law: &Law, settings: &Settings) {
    let (steps, certificate) = steps(law, settings).unwrap_or_else(|error| panic!("{what}: {error}"));
    assert!(certificate.bound_ticks <= settings.tolerance_ticks, "{what}: {}", certificate.bound_ticks);
    let pieces: Vec<Piece> = law.pieces().map(Result::unwrap).collect();
    let end = rational(pieces[pieces.len() - 1].end.raw(), 1 << 64);
    // Rows are decimal numbers to four units in the last place, and pieces meet to that.
    let ends = pieces.iter().flat_map(|piece| [piece.first(), piece.last()].map(|u| (piece, u)));
    let farthest = ends.map(|(piece, u)| (piece.origin as f64 + piece.curve.value(u)).abs()).fold(0.0, f64::max);
    let slack = rational(farthest as i128 + 1, 1 << 50);
    let pieces: Vec<ExactRows> = pieces.iter().map(ExactRows::new).collect();
    let theta = |t: Rational| {
        let t = if t < rational(0, 1) { rational(0, 1) } else { t };
        let t = if t > end { end.clone() } else { t };
        let index = pieces.partition_point(|piece| piece.start <= t).max(1) - 1;
        pieces[index].at(&t)
    };
    let start = theta(rational(0, 1));
    let bound = exact(certificate.bound_ticks);
    let hz = rational(settings.tick_hz.into(), 1);
    let mut position = 0;
    for Step { tick, forward } in steps {
        let level = if forward { settings.grid.up_level(position) } else { settings.grid.down_level(position) };
        let level = exact(level) + &start;
        let (before, after) = (rational(tick.into(), 1) - &bound, rational(tick.into(), 1) + &bound);
        let (before, after) = (before / &hz, after / &hz);
        let beyond = |t: Rational| if forward { theta(t) - &level } else { &level - theta(t) };
        assert!(beyond(before.clone()) <= slack, "{what}: the step at tick {tick} is late");
        // Where the law turns just at the level it has reached it there, and not a moment later.
        let turns = pieces.iter().map(|piece| &piece.start).filter(|t| **t >= before && **t <= after).cloned();
        let reaches = turns.chain([after.clone()]).any(|t| beyond(t) >= -slack.clone());
        assert!(reaches, "{what}: the step at tick {tick} is early");
        position += if forward { 1 } else { -1 };
    }
}

/// Rows of round numbers: to and fro, one way, and with rests; times even and uneven; steps of several gears.
fn rows(random: &mut Random, count: usize) -> Vec<(f64, f64)> {
    let grids = [1.0, 10.0, 100.0, 1000.0];
    let (time_grid, grid) = (random.pick(&grids), random.pick(&grids));
    let steps = random.pick(&[1.0, 16.0, 200.0, 3200.0 / 360.0, 3200.0, 400.0 / std::f64::consts::TAU, 160.0]);
    let (way, even) = (random.below(3), random.below(2) == 0);
    let (widest, most) = (random.pick(&[1, 3, 10, 50]), random.pick(&[2, 10, 100, 1000]));
    let interval = 1 + random.below(widest);
    let (mut t, mut x) = (0, if random.below(2) == 0 { 0 } else { random.below(2001) as i64 - 1000 });
    let mut rows = Vec::with_capacity(count);
    for _ in 0..count {
        rows.push((t as f64 / time_grid, x as f64 / grid * steps));
        t += if even { interval } else { 1 + random.below(widest) };
        let to_and_fro = random.below(2 * most + 1) as i64 - most as i64;
        x += match way {
            0 => to_and_fro,
            1 => to_and_fro.abs(),
            _ => to_and_fro * i64::from(random.below(3) == 0),
        };
    }
    rows
}

/// Neither too fast for any board, nor so far that a test takes long.
fn is_modest(rows: &[(f64, f64)]) -> bool {
    let fastest = rows.windows(2).map(|p| ((p[1].1 - p[0].1) / (p[1].0 - p[0].0)).abs()).fold(0.0, f64::max);
    fastest <= 200e3 && rows.windows(2).map(|p| (p[1].1 - p[0].1).abs()).sum::<f64>() <= 1e6
}

/// On the old code 10.8 % of such tables were refused.
#[test]
fn tables_of_round_numbers_are_planned() {
    let mut random = Random::new(134);
    for case in 0..2000 {
        let count = if case % 200 == 199 { 2000 } else { random.pick(&[2, 3, 4, 5, 10, 30, 100]) };
        let rows = std::iter::repeat_with(|| rows(&mut random, count)).find(|rows| is_modest(rows)).unwrap();
        let clock = random.pick(&[(16_000_000, 16), (125_000_000, 32), (1_000_000_000, 32)]);
        let grid = random.pick(&[Grid::NEAREST, Grid::REACH]);
        let settings = Settings { grid, ..settings(clock) };
        let law = Law::table(&rows, Interpolation::Monotone).unwrap();
        let what = || format!("{grid:?} at {} Hz: {} rows, {:?}", clock.0, rows.len(), &rows[..rows.len().min(9)]);
        // Exact arithmetic takes its time: for some of the short ones.
        if case % 4 == 0 && count <= 5 && (rows[count - 1].1 - rows[0].1).abs() < 300.0 {
            check_steps(&what(), &law, &settings);
        } else if let Err(error) = crate::common::replay(&law, &settings, |_| {}) {
            panic!("{error}: {}", what());
        }
    }
}

#[test]
fn lines_and_coarse_curves_are_planned() {
    let line: Vec<(f64, f64)> = (0..4).map(|k| (f64::from(k), f64::from(10 * k) * 200.0 / 36.0)).collect();
    // A row just where a step is due, rests before and after it, and a fraction of a step to begin with.
    let rests: Vec<(f64, f64)> =
        [0.0, 44.0, 44.0, 3.0, 3.0, 18.0].iter().zip(0..).map(|(x, k)| (f64::from(k), x - 75.8)).collect();
    for clock in crate::common::BOARDS {
        for grid in [Grid::NEAREST, Grid::REACH] {
            let settings = Settings { grid, ..settings(clock) };
            for rows in [&line, &rests] {
                check_steps("rows", &Law::table(rows, Interpolation::Monotone).unwrap(), &settings);
            }
        }
    }
    // 0.3 Hz, 100 rows a second, two decimals of a degree.
    let sine = (0..=1000).map(|k| {
        let t = f64::from(k) / 100.0;
        (t, (4500.0 * (std::f64::consts::TAU * 0.3 * t).sin()).round() / 100.0 * 3200.0 / 360.0)
    });
    let sine = Law::table(&sine.collect::<Vec<_>>(), Interpolation::Monotone).unwrap();
    let bent = Law::formula("10*t + 1e-15*t^2", &[], 800.0, Some(Time::from_seconds(3.0))).unwrap();
    for law in [sine, bent] {
        for clock in crate::common::BOARDS {
            crate::common::replay(&law, &settings(clock), |_| {}).unwrap();
        }
    }
}

/// The bend is below what rounding tells, or below all that is normal: the certificate holds all the same.
#[test]
fn curves_that_hardly_bend_are_within_their_certificates() {
    let bends = [0.0, 1e-3, -1e-9, 1e-15, -1e-15, 1e-300, -5e-324];
    for speed in [0.0, 100.0, -7.25] {
        for square in bends {
            for cube in bends {
                let c = vec![0.25, speed, square, cube];
                let what = format!("{c:?}");
                let law = Law::polynomials([(Time::from_seconds(1.5), c)]).unwrap();
                check_steps(&what, &law, &settings((16_000_000, 16)));
                check_steps(&what, &law, &Settings { grid: Grid::REACH, ..settings((1_000_000_000, 32)) });
            }
        }
    }
    // Far from where the parabola turns, and near to it.
    for turn_s in [-1.0, -1e-3, 0.3, 1.5, 2.0, 1e3, 1e5, 1e9, 1e15] {
        let c = vec![0.0, 60.0, -30.0 / turn_s];
        let law = Law::polynomials([(Time::from_seconds(1.5), c)]).unwrap();
        check_steps(&format!("turns at {turn_s} s"), &law, &settings((125_000_000, 32)));
    }
}

/// Rows of a straight line are rounded: that is no acceleration. A parabola's is given.
#[test]
fn a_straight_line_in_a_table_has_no_acceleration() {
    for (rows, every_ms, per_row, from) in [(4, 1000, 10.0, 0.0), (2001, 10, 0.37, 0.0), (20_001, 1, 0.037, 1000.0)] {
        let table = |theta: &dyn Fn(f64) -> f64| {
            let rows: Vec<(f64, f64)> =
                (0..rows).map(|k| (f64::from(k * every_ms) / 1000.0, theta(f64::from(k)))).collect();
            Law::table(&rows, Interpolation::Monotone).unwrap()
        };
        let acceleration = |law: &Law| steps(law, &settings((16_000_000, 16))).unwrap().1.peak_acceleration.0;
        // Degrees of 3200 steps a turn, with the decimals of a file.
        let line = table(&|k| ((from + per_row * k) * 1000.0).round() / 1000.0 * (3200.0 / 360.0));
        assert_eq!(acceleration(&line), 0.0);
        let every_s = f64::from(every_ms) / 1000.0;
        let found = acceleration(&table(&|k| from + 0.5 * (every_s * k).powi(2)));
        assert!((0.5..3.0).contains(&found), "{found}");
    }
}

/// Pieces that meet just before a level, and go on slowly: the step comes when they reach it, and not when they meet.
#[test]
fn a_level_just_behind_a_joint_is_reached_behind_it() {
    let missing = 5e-10;
    for (before, after) in [(1.0, 1e-3), (1e-4, 1e-4), (2e-3, 0.5), (1.0, 1e-5)] {
        for sign in [1.0, -1.0] {
            let seconds = (1.0 - missing) / before;
            let way = sign * before * seconds;
            let onward = |c: Vec<f64>| {
                Law::polynomials([
                    (Time::from_seconds(seconds), vec![0.0, sign * before]),
                    (Time::from_seconds(0.5 / after), c),
                ])
                .unwrap()
            };
            // Straight on; bent; and the other way, or at rest: then it touches.
            let laws = [
                onward(vec![way, sign * after]),
                onward(vec![way, sign * after, 0.3 * sign * after * after, 1e-3 * sign * after * after * after]),
            ];
            for law in laws {
                for clock in crate::common::BOARDS {
                    let what = format!("{before} and {after} steps/s, {sign}");
                    check_steps(&what, &law, &Settings { grid: Grid::REACH, ..settings(clock) });
                }
            }
            for c in [vec![way, -sign * after], vec![way]] {
                let settings = Settings { grid: Grid::REACH, ..settings((16_000_000, 16)) };
                let (steps, _) = steps(&onward(c), &settings).unwrap();
                assert_eq!(steps[0].tick, (seconds * 16e6).round() as u64);
            }
        }
    }
}

/// Lines and curves that last days to years, also slow ones. Each step is within a tick of its time by the rows.
#[test]
fn tables_of_years_are_planned() {
    for (end_s, way) in [(1e5, 3.0), (1e6, -90.0), (3.3e6, 8.9), (1e7, 80.0 / 9.0), (1e8, 100.0), (1e9, 500.0)] {
        for grid in [Grid::NEAREST, Grid::REACH] {
            for clock in [(16_000_000, 16), (125_000_000, 32)] {
                let settings = Settings { grid, ..settings(clock) };
                for interpolation in [Interpolation::Monotone, Interpolation::Linear] {
                    let law = Law::table(&[(0.0, 0.0), (end_s, way)], interpolation).unwrap();
                    let what = format!("{way} steps in {end_s} s");
                    let (steps, certificate) = steps(&law, &settings).unwrap_or_else(|error| panic!("{what}: {error}"));
                    for (n, step) in (1..).zip(&steps) {
                        let level = f64::from(n) - 0.5 + settings.grid.hysteresis;
                        let due = exact(level) * exact(end_s) / exact(way.abs()) * rational(clock.0.into(), 1);
                        let off = (rational(step.tick.into(), 1) - &due).to_f64().value().abs();
                        // The slope is the nearest f64.
                        let slope = due.to_f64().value() * f64::EPSILON;
                        assert!(off <= certificate.bound_ticks + slope, "{what}: step {n} is {off} ticks off");
                    }
                    let made = steps.len() as f64;
                    assert!(made < way.abs() + 0.5 && made > way.abs() - 1.6, "{what}: {made} steps");
                }
            }
        }
    }
    let rests = [(0.0, 0.0), (4e6, 20.0), (8e6, 20.0), (8.5e6, -300.0), (1.6e7, -300.5)];
    check_steps(
        "years with rests",
        &Law::table(&rests, Interpolation::Monotone).unwrap(),
        &settings((125_000_000, 32)),
    );
}

/// Times are told apart as the board does it, also late in a long table.
#[test]
fn late_rows_meet() {
    let rows: Vec<(f64, f64)> = (0..40).map(|k| (1e7 + 0.1 * f64::from(k), 20_000.0 * f64::from(k * k % 7))).collect();
    let law = Law::table(&rows, Interpolation::Monotone).unwrap();
    crate::common::replay(&law, &settings((16_000_000, 16)), |_| {}).unwrap();
}

/// A law that is known to 53 bits creeps over a level where two of its pieces meet, 10 000 steps from where it began: a little before that, or behind it.
#[test]
fn a_slow_law_passes_a_level_where_pieces_meet() {
    const FAR: i64 = 10_000;
    let two = |power: i32| 2f64.powi(power);
    let piece = |start: i128, origin: i64, c: [f64; 4]| {
        let [start, end] = [start, start + 1].map(|s| Time::from_raw(s << 64));
        let (curve, entry) = (Curve::Polynomial(c.to_vec()), Entry::SpeedJump);
        Piece { zero: start, start, end, origin, curve, entry }
    };
    let beyond =
        [-36, -38, -39, -41, -43, -44, -46, -48].map(two).into_iter().flat_map(|beyond| [-beyond, 0.0, beyond]);
    let cases =
        [-12, -16, -18, -20, -22, -24].map(two).into_iter().flat_map(|speed| beyond.clone().map(move |b| (speed, b)));
    for (speed, beyond) in cases {
        // The third piece may be as coarse as the second.
        for origin in [FAR, 0] {
            let from = (FAR - origin) as f64 + beyond;
            if from - (FAR - origin) as f64 != beyond {
                continue;
            }
            // Sums of few powers of two: the second piece ends exactly where the third begins, which is `beyond` the level.
            let (way, far) = (0.75 - speed + beyond, FAR as f64 - 0.75);
            let pieces = vec![
                piece(0, 0, [0.0, far, 0.0, 0.0]),
                piece(1, 0, [far, speed + 3.0 * way, -3.0 * way, way]),
                piece(2, origin, [from, speed, 0.0, 0.25]),
            ];
            let exact_pieces: Vec<ExactRows> = pieces.iter().map(ExactRows::new).collect();
            let joint = rational(2, 1);
            assert_eq!(exact_pieces[1].at(&joint), exact_pieces[2].at(&joint));
            let law = Law::Fixed(Fixed { pieces: pieces.into(), class: Class::ClosedForm });
            let limits = Limits { pull_in: f64::INFINITY, ..Limits::default() };
            let settings =
                Settings { limits, grid: Grid::REACH, tolerance_ticks: 1e6, ..Settings::new(16_000_000, 16) };
            let (steps, certificate) = steps(&law, &settings).unwrap();
            assert_eq!(steps.len() as i64, FAR);
            let bound = exact(certificate.bound_ticks);
            let reached = |ticks: Rational| {
                let t = ticks / rational(16_000_000, 1);
                exact_pieces[if t < joint { 1 } else { 2 }].at(&t) >= rational(FAR.into(), 1)
            };
            let tick = rational(steps[steps.len() - 1].tick.into(), 1);
            let is_between = !reached(&tick - &bound) && reached(tick + &bound);
            assert!(
                is_between,
                "{speed} steps/s, {beyond} steps beyond the level where the pieces meet: {bound} ticks"
            );
        }
    }
}
