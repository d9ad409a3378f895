//! Stop tails, from any instant of any law within limits.

use proptest::prelude::*;
use pulsetrain_core::Item;
use pulsetrain_core::packing::{MAX_PACKED_LEN, Packing, State};
use pulsetrain_motion::law::Cursor;
use pulsetrain_motion::program::Limits;
use pulsetrain_motion::{Law, Time};
use pulsetrain_plan::tail::{Motion, stop_tail};
use pulsetrain_plan::{Move, Planner, Settings};

const TICK_HZ: f64 = 16e6;

/// (tick, position after the step) of moves that begin at tick 0 and `position`.
fn steps(moves: impl IntoIterator<Item = Move>, mut position: i64) -> Vec<(i128, i64)> {
    let mut accumulator = 1_i128 << 15;
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
    fn a_tail_stops_within_the_limits(law in any_law(), part in 0.0..1.0f64, pull_in in 0.0..200.0f64) {
        // Limits that the law just keeps.
        let mut settings = Settings::new(16_000_000, 16);
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
        let made = steps(moves, 0);
        let position = made.iter().take_while(|(t, _)| *t <= tick).last().map_or(0, |(_, position)| *position);
        let sample = Cursor::new(&law).at(Time::from_seconds(tick as f64 / TICK_HZ)).unwrap();
        let motion = Motion {
            position,
            theta: sample.position,
            speed: sample.speed,
            acceleration: certificate.peak_acceleration.0,
        };
        let tail = steps(stop_tail(&motion, &settings).unwrap(), position);
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
        prop_assert!(rest_s <= 2.5 * end_s + 2.0 / TICK_HZ, "steps until {rest_s} s; {end_s} s would do");
        // Nothing but the integers: the mean speed between steps only falls, and by no more than the limit.
        let quick: Vec<f64> = tail.windows(2).map(|pair| (pair[1].0 - pair[0].0) as f64).collect();
        for (pair, ticks) in quick.windows(2).zip(tail.windows(3)) {
            prop_assert!(pair[0] >= settings.min_interval_ticks as f64);
            let middle_s = (ticks[2].0 - ticks[0].0) as f64 / (2.0 * TICK_HZ);
            // Each interval may be off by two ticks of tolerance.
            let speed = |ticks: f64| TICK_HZ / ticks;
            let doubt = 2.0 * (speed(pair[0] - 2.0) - speed(pair[0]));
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

    /// Whatever an Uno can run, up to steps of 100 ticks, braked within 10 ms to 1 s.
    #[test]
    fn a_tail_is_short(
        log_speed in 2.0..5.2f64, stops_s in 0.01..1.0f64, theta in -0.49..0.49f64, back: bool, pull_in in 0.0..100.0f64,
        fine: bool, coarse: bool,
    ) {
        let speed = 10f64.powf(log_speed);
        let mut settings = Settings::new(16_000_000, if fine { 32 } else { 16 });
        settings.tolerance_ticks = if coarse { 16.0 } else { 1.0 };
        let braking = speed / stops_s;
        settings.limits = Limits { max_speed: None, max_acceleration: Some(braking), pull_in };
        let motion =
            Motion { position: 0, theta, speed: if back { -speed } else { speed }, acceleration: 0.0 };
        let moves = stop_tail(&motion, &settings).unwrap();
        let packing = Packing { fraction_bits: settings.fraction_bits, gain: settings.gain().unwrap() };
        let mut state = State::default();
        let mut bytes = 0;
        let mut len = |item: Item| packing.pack(&mut state, &item, &mut [0; MAX_PACKED_LEN]).unwrap();
        for next in &moves {
            match *next {
                Move::Dwell { ticks } => bytes += len(Item::Dwell { ticks: ticks.try_into().unwrap() }),
                Move::Run { segment, direction } => bytes += len(Item::Run { segment, direction }),
            }
        }
        // Boards with 32 fraction bits have wider registers, and room for them.
        prop_assert!(moves.len() <= 8, "{} segments", moves.len());
        prop_assert!(bytes <= if fine { 100 } else { 72 }, "{bytes} bytes");
    }
}
