//! Stop tails, from any instant of any law within limits.

use proptest::prelude::*;
use pulsetrain_core::packing::{MAX_PACKED_LEN, Packing, State};
use pulsetrain_core::{Direction, Item};
use pulsetrain_motion::boards;
use pulsetrain_motion::law::Cursor;
use pulsetrain_motion::program::Limits;
use pulsetrain_motion::{Law, Time};
use pulsetrain_plan::tail::{Motion, Tail, Told, stop_tail};
use pulsetrain_plan::{Move, Planner, Settings};

const TICK_HZ: f64 = 16e6;

/// (tick, position after the step) of moves that begin at `accumulator` and `position`.
fn steps(accumulator: i64, moves: impl IntoIterator<Item = Move>, mut position: i64) -> Vec<(i128, i64)> {
    let mut accumulator = i128::from(accumulator);
    let mut steps = Vec::new();
    for next in moves {
        match next {
            Move::Dwell { ticks } => accumulator += i128::from(ticks) << 16,
            Move::Run { segment, direction } => {
                for k in 1..=segment.count {
                    position += i64::from(direction.sign());
                    steps.push(((accumulator + segment.span(k)) >> 16, position));
                }
                accumulator += segment.span(segment.count);
            }
        }
    }
    steps
}

/// What a board knows of a plan up to `tick`.
fn told(moves: &[Move], tick: i128, settings: &Settings) -> Told {
    let packing = Packing { fraction_bits: settings.fraction_bits, gain: settings.gain().unwrap() };
    let scale = settings.fraction_bits;
    let (mut state, mut accumulator) = (State::default(), 1_i128 << (scale - 1));
    for next in moves {
        match *next {
            Move::Dwell { ticks } => {
                let end = accumulator + (i128::from(ticks) << scale);
                if end >> scale >= tick {
                    break;
                }
                accumulator = end;
            }
            Move::Run { segment, direction } => {
                let before =
                    (1..=segment.count).take_while(|k| (accumulator + segment.span(*k)) >> scale < tick).count();
                let segment = segment.truncated(u32::try_from(before).unwrap());
                if before > 0 {
                    packing.pack(&mut state, &Item::Run { segment, direction }, &mut [0; MAX_PACKED_LEN]).unwrap();
                }
                accumulator += segment.span(segment.count);
            }
        }
    }
    Told { accumulator: i64::try_from(accumulator - (tick << scale)).unwrap(), state }
}

fn any_law() -> impl Strategy<Value = Law> {
    let sine = (20.0..2000.0f64, 0.5..5.0f64)
        .prop_map(|(amplitude, period_s)| Law::sine(amplitude, Time::from_seconds(period_s), Some(2)).unwrap());
    let trapezoid = (50.0..5000.0f64, 100.0..3000.0f64, 500.0..20_000.0f64, 500.0..20_000.0f64, any::<bool>())
        .prop_map(|(distance, speed, up, down, back)| {
            Law::trapezoid(if back { -distance } else { distance }, speed, up, down).unwrap()
        });
    prop_oneof![sine, trapezoid]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn a_tail_stops_within_the_limits(law in any_law(), part in 0.0..1.0f64, pull_in in 0.0..200.0f64, knows: bool, brief: bool, coarse: bool) {
        // Limits that the law just keeps.
        let mut settings = Settings::new(16_000_000, 16);
        settings.tolerance_ticks = if coarse { 16.0 } else { 1.0 };
        let mut planner = Planner::new(&law, &settings).unwrap();
        let mut moves = Vec::new();
        while let Some(next) = planner.next_move().unwrap() {
            moves.push(next);
        }
        let certificate = planner.certificate();
        let braking = certificate.peak_acceleration.0 * 1.02;
        settings.limits = Limits { max_speed: None, max_acceleration: Some(braking), pull_in };
        settings.min_interval_ticks = certificate.shortest_interval_ticks.unwrap_or(1) - 4;

        let tick = (part * law.end().unwrap().seconds() * TICK_HZ) as i128;
        let made = steps(1 << 15, moves.iter().copied(), 0);
        let position = made.iter().take_while(|(t, _)| *t < tick).last().map_or(0, |(_, position)| *position);
        let sample = Cursor::new(&law).at(Time::from_seconds(tick as f64 / TICK_HZ)).unwrap();
        let motion = Motion {
            position,
            theta: sample.position,
            speed: sample.speed,
            acceleration: certificate.peak_acceleration.0,
            told: knows.then(|| told(&moves, tick, &settings)),
            brief,
        };
        let tail = stop_tail(&motion, &settings).unwrap();
        let tail = steps(tail.start, tail.moves, position);
        let Some(&(first, _)) = tail.first() else {
            // Slow enough to stop at once, or less than the way to the next step.
            let way = motion.speed.powi(2) / (2.0 * braking);
            prop_assert!(motion.speed.abs() <= pull_in || way < 1.1, "{motion:?}");
            return Ok(());
        };
        prop_assert!(first >= 0, "a step before the tail");
        let forward = motion.speed > 0.0;
        let mut before = position;
        for &(_, after) in &tail {
            prop_assert_eq!(after - before, if forward { 1 } else { -1 });
            before = after;
        }
        // Braking evenly and as hard as it may takes so long.
        let (end_s, rest_s) = (motion.speed.abs() / braking, tail.last().map_or(0.0, |(tick, _)| *tick as f64 / TICK_HZ));
        let most = if brief { 3.5 } else { 2.5 };
        prop_assert!(rest_s <= most * end_s + 2.0 / TICK_HZ, "steps until {rest_s} s; {end_s} s would do");
        // Nothing but the integers: the mean speed between steps only falls, and by no more than the limit.
        let mut tail = tail;
        // From the plan's last step on, if that is known and went the same way.
        if let [.., before, last] = made.iter().filter(|(t, _)| *t < tick).collect::<Vec<_>>().as_slice()
            && knows
            && last.1 - before.1 == tail[0].1 - last.1
        {
            tail.insert(0, (last.0 - tick, last.1));
        }
        let quick: Vec<f64> = tail.windows(2).map(|pair| (pair[1].0 - pair[0].0) as f64).collect();
        for (pair, ticks) in quick.windows(2).zip(tail.windows(3)) {
            prop_assert!(pair[0] >= settings.min_interval_ticks as f64);
            let middle_s = (ticks[2].0 - ticks[0].0) as f64 / (2.0 * TICK_HZ);
            // Each interval may be off by the tolerance at either end.
            let speed = |ticks: f64| TICK_HZ / ticks;
            let doubt = 2.0 * (speed(pair[0] - 2.0 * settings.tolerance_ticks) - speed(pair[0]));
            let slower = speed(pair[0]) - speed(pair[1]);
            prop_assert!(slower >= -doubt, "faster by {} steps/s", -slower);
            prop_assert!(slower <= braking * middle_s + doubt, "slower by {slower} steps/s within {middle_s} s");
        }
        // It ends slow enough: within a step of rest, or at the pull-in rate.
        if let [.., before, last] = tail.as_slice() {
            let speed = TICK_HZ / ((last.0 - before.0) as f64 - 1.0);
            prop_assert!(speed <= pull_in.max((4.0 * braking).sqrt()), "stops from {speed} steps/s");
        }
    }

    #[test]
    fn a_tail_is_short(case in case()) {
        let (segments, bytes) = case.measured();
        prop_assert!(segments <= 24, "{segments} segments");
        prop_assert!(bytes <= case.most_bytes(), "{bytes} bytes");
    }
}

/// A plan that speeds up was 220 ticks ahead of the law: the step that waits for the law is not followed by one as early as the plan had it.
#[test]
fn what_waits_for_the_law_does_not_hurry_afterwards() {
    let mut settings = Settings::new(16_000_000, 16);
    settings.limits = Limits { max_speed: None, max_acceleration: Some(29_154.94), pull_in: 0.0 };
    let (speed, due_ticks, told_ticks) = (735.472, 2247.405, -19_937.0);
    let state = State { previous_count: 255, interval: 1_439_461_376, add: -91_226_112, add2: 0, ..State::default() };
    let motion = Motion {
        position: 0,
        theta: settings.grid.up_level(0) - speed * due_ticks / TICK_HZ,
        speed,
        acceleration: 0.0,
        told: Some(Told { accumulator: (told_ticks * 65_536.0) as i64, state }),
        brief: false,
    };
    let tail = stop_tail(&motion, &settings).unwrap();
    let ticks: Vec<f64> = steps(tail.start, tail.moves, 0).iter().map(|(tick, _)| *tick as f64).collect();
    let (first, second) = (ticks[0] - told_ticks, ticks[1] - ticks[0]);
    assert!(second >= first - 2.0 * settings.tolerance_ticks, "{second} ticks after {first}");
}

/// What was the longest once, and what is the longest of those that [`bytes_of_tails`] measures.
#[test]
fn the_longest_tails_are_short() {
    let slow = Case {
        speed: 278.589,
        stops_s: 0.918_515_709,
        past: 0.484_375,
        back: false,
        pull_in: 0.0,
        fine: false,
        coarse: false,
        knows: None,
        brief: false,
    };
    let fast = Case { speed: 116_340.7, stops_s: 0.922_961, past: 0.759, back: true, pull_in: 65.3, ..slow };
    let told = Case { speed: 114_836.3, stops_s: 0.805_570, past: 0.225_6, knows: Some((58, 0.251_7)), ..fast };
    let fine = Case { speed: 157_292.0, stops_s: 0.978_639, past: 0.447_5, fine: true, ..fast };
    for case in [slow, fast, Case { coarse: true, ..told }, told, fine] {
        let (segments, bytes) = case.measured();
        assert!(segments <= 24 && bytes <= case.most_bytes(), "{segments} segments, {bytes} bytes: {case:?}");
    }
    // The tutorial's sine at T = 1 s where it is fastest: 12 566 steps/s, 78 957 steps/s².
    let tutorial = Case { speed: 12_566.0, stops_s: 0.159_2, knows: Some((60, 0.0)), ..slow };
    assert!(tutorial.measured().1 <= 30, "{:?}", tutorial.measured());
}

/// Whatever an Uno can run, up to steps of 100 ticks, braked within 10 ms to 1 s.
#[derive(Clone, Copy, Debug)]
struct Case {
    speed: f64,
    stops_s: f64,
    /// How much of an interval is past since the last step.
    past: f64,
    back: bool,
    pull_in: f64,
    fine: bool,
    coarse: bool,
    /// The count of the last segment, and what part of the braking its own acceleration was; unless nothing is known.
    knows: Option<(u32, f64)>,
    brief: bool,
}

fn case() -> impl Strategy<Value = Case> {
    let motion = (2.0..5.2f64, 0.01..1.0f64, 0.0..1.0f64, any::<bool>(), 0.0..100.0f64);
    let knows = prop::option::weighted(0.8, (3u32..80, -1.0..1.0f64));
    (motion, any::<bool>(), any::<bool>(), knows).prop_map(|(motion, fine, coarse, knows)| {
        let (log_speed, stops_s, past, back, pull_in) = motion;
        Case { speed: 10f64.powf(log_speed), stops_s, past, back, pull_in, fine, coarse, knows, brief: false }
    })
}

impl Case {
    fn settings(&self) -> Settings {
        let mut settings = Settings::new(16_000_000, if self.fine { 32 } else { 16 });
        settings.tolerance_ticks = if self.coarse { 16.0 } else { 1.0 };
        let max_acceleration = Some(self.speed / self.stops_s);
        settings.limits = Limits { max_speed: None, max_acceleration, pull_in: self.pull_in };
        settings
    }

    fn told(&self, settings: &Settings) -> Option<Told> {
        let (previous_count, accelerates) = self.knows?;
        let direction = if self.back { Direction::Backward } else { Direction::Forward };
        let interval = settings.tick_hz as f64 / self.speed * 2f64.powi(settings.fraction_bits as i32);
        // The interval changes by its part of v·a, each step: −a/v³ in seconds.
        let add = -accelerates * interval / (self.speed * self.stops_s);
        let state = State { previous_count, interval: interval as i64, add: add as i64, add2: 0, direction };
        Some(Told { accumulator: -(self.past * interval) as i64, state })
    }

    fn tail(&self, settings: &Settings) -> Tail {
        // 1 − past of a step before the next one.
        let (theta, sign) = (settings.grid.up_level(0) - (1.0 - self.past), if self.back { -1.0 } else { 1.0 });
        let motion = Motion {
            position: 0,
            theta: sign * theta,
            speed: sign * self.speed,
            acceleration: 0.0,
            told: self.told(settings),
            brief: self.brief,
        };
        stop_tail(&motion, settings).unwrap()
    }

    /// Segments, and bytes after what the board was told.
    fn measured(&self) -> (usize, usize) {
        let settings = self.settings();
        let packing = Packing { fraction_bits: settings.fraction_bits, gain: settings.gain().unwrap() };
        let mut state = self.told(&settings).map_or(State::default(), |told| told.state);
        let mut len = |item: Item| packing.pack(&mut state, &item, &mut [0; MAX_PACKED_LEN]).unwrap();
        let moves = self.tail(&settings).moves;
        let bytes = moves.iter().map(|next| match *next {
            Move::Dwell { ticks } => len(Item::Dwell { ticks: ticks.try_into().unwrap() }),
            Move::Run { segment, direction } => len(Item::Run { segment, direction }),
        });
        (moves.len(), bytes.sum())
    }

    const fn most_bytes(&self) -> usize {
        match (self.fine, self.knows) {
            // 16 parts of 2 bytes; before them, where not even the largest is gentle enough, a segment of 13, and one of 8
            // that leads to them; the last step or two, of 5.
            (false, Some(_)) => 32 + 13 + 8 + 5,
            // The first step, which may be one in full, and the next segment, which is.
            (false, None) => 32 + 10 + 15 + 8 + 5,
            // Registers that are twice as wide.
            (true, _) => 90,
        }
    }
}

/// What tails take, over many motions: `cargo test -p pulsetrain-plan --test it -- --nocapture tails::bytes` prints it.
#[test]
fn bytes_of_tails() {
    use proptest::strategy::ValueTree;
    let mut runner = proptest::test_runner::TestRunner::deterministic();
    let mut all: [Vec<(usize, Case)>; 3] = Default::default();
    let (mut sum, mut brief) = (0, 0);
    for _ in 0..2_000 {
        let case = case().new_tree(&mut runner).unwrap().current();
        let (_, bytes) = case.measured();
        sum += bytes;
        brief += Case { brief: true, ..case }.measured().1;
        all[if case.fine { 2 } else { usize::from(case.knows.is_none()) }].push((bytes, case));
    }
    println!("brief ones take {:.0} % of that", 100.0 * brief as f64 / sum as f64);
    assert!(brief * 10 < sum * 9, "{brief} bytes of {sum}");
    for (cases, what) in all.iter_mut().zip(["F = 16, told", "F = 16, not told", "F = 32"]) {
        cases.sort_by_key(|(bytes, _)| *bytes);
        let at = |part: f64| cases[((cases.len() - 1) as f64 * part) as usize].0;
        println!("{what}: median {} bytes, 90 % {}, 99 % {}, most {}", at(0.5), at(0.9), at(0.99), at(1.0));
        let (bytes, largest) = cases.last().unwrap();
        println!("  {largest:?}");
        assert!(*bytes <= largest.most_bytes(), "{bytes} bytes: {largest:?}");
    }
}

/// Eight motors of a Pico that stop together: what they ask of its processor (tails are in the queues) is half of what a plan may put off
/// at most, so that it gets through both.
#[test]
fn a_pico_gets_through_its_tails() {
    use proptest::strategy::ValueTree;
    let pico = boards::find("pico").unwrap().board;
    let (step, segment) = (i64::from(pico.min_interval_ticks[7]), pico.segment_ticks[7]);
    let mut runner = proptest::test_runner::TestRunner::deterministic();
    let mut most = 0;
    for _ in 0..2_000 {
        let case = case().new_tree(&mut runner).unwrap().current();
        // As fast as a Pico's eight motors can be, where an Uno's one is as fast as that can be.
        let case = Case { speed: case.speed * pico.tick_hz as f64 / step as f64 / 10f64.powf(5.2), ..case };
        let settings = Settings { tick_hz: pico.tick_hz, fraction_bits: 32, ..case.settings() };
        let tail = case.tail(&settings);
        let (mut accumulator, mut seen, mut put_off) = (i128::from(tail.start), 0, 0);
        for next in &tail.moves {
            match next {
                Move::Dwell { ticks } => accumulator += i128::from(*ticks) << 32,
                Move::Run { segment: run, .. } => {
                    accumulator += run.span(run.count);
                    let tick = (accumulator >> 32) as i64;
                    let spare = (tick - seen - step * i64::from(run.count)).max(0);
                    put_off = i64::max(put_off - spare, 0) + i64::from(segment.onward);
                    (seen, most) = (tick, most.max(put_off));
                }
            }
        }
    }
    assert!((1..=pico.tick_hz as i64 / 2000).contains(&most), "{most} ticks");
}
