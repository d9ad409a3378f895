//! The path in fixed point against the same recurrence in f64, and its steps against exact times.

use proptest::prelude::*;
use pulsetrain_core::Direction;
use pulsetrain_core::winch::path::{FASTEST, FASTEST_DRIFT, Gains, Limits, MAX_ACCELERATION, Path, Slice};
use pulsetrain_core::winch::spacing::{TICKS, TOLERANCE_TICKS};

const DT: f64 = 1e-3;

/// StepperWinch, Path.cpp, in f64, with the ramp of the later dialect.
#[derive(Clone, Debug)]
struct Exact {
    q: f64,
    speed: f64,
    reference: f64,
    target: f64,
    drift: f64,
    ramp: f64,
    k: f64,
    b: f64,
    vmax: f64,
    amax: f64,
}

#[derive(Clone, Copy, Debug)]
enum Command {
    Target(i32),
    Move(i32),
    Drift(i16),
    Impulse(i32),
    Ramp(u16),
    Gains(f64, f64),
    Limits(f64, f64),
}

impl Exact {
    fn new() -> Exact {
        let k = 4.0 * std::f64::consts::PI.powi(2);
        Exact {
            q: 0.0,
            speed: 0.0,
            reference: 0.0,
            target: 0.0,
            drift: 0.0,
            ramp: 0.0,
            k,
            b: 1.0,
            vmax: 3500.0,
            amax: 35_000.0,
        }
    }

    fn obey(&mut self, command: Command) {
        match command {
            Command::Target(steps) => self.target = steps.into(),
            Command::Move(steps) => self.target += f64::from(steps),
            Command::Drift(speed) => self.drift = speed.into(),
            Command::Impulse(steps) => {
                self.target += f64::from(steps);
                self.reference += f64::from(steps);
            }
            Command::Ramp(speed) => self.ramp = speed.into(),
            Command::Gains(frequency, ratio) => {
                let omega = std::f64::consts::TAU * frequency;
                (self.k, self.b) = (omega * omega, 2.0 * omega * ratio);
            }
            Command::Limits(vmax, amax) => {
                (self.vmax, self.amax) = (vmax.min(FASTEST.into()), amax.min(MAX_ACCELERATION.into()));
            }
        }
        if self.ramp == 0.0 {
            self.reference = self.target;
        }
    }

    fn tick(&mut self) {
        if self.ramp > 0.0 {
            let most = self.ramp * DT;
            self.reference += (self.target - self.reference).clamp(-most, most);
        }
        let acceleration = self.k * (self.reference - self.q) + self.b * (self.drift - self.speed);
        let change = acceleration.clamp(-self.amax, self.amax) * DT;
        self.q += self.speed * DT;
        let fastest = self.vmax.max(self.speed.abs() - self.amax * DT);
        self.speed = (self.speed + change).clamp(-fastest, fastest);
        self.reference += self.drift * DT;
        self.target += self.drift * DT;
    }
}

/// A number as a client would print it, with `places` decimals.
fn fixed(value: f64, places: i32) -> u32 {
    (value * 10_f64.powi(places)).round() as u32
}

fn gains_of(frequency: f64, ratio: f64) -> Gains {
    Gains::new(fixed(frequency, 6), fixed(ratio, 6)).expect("stable")
}

fn limits_of(vmax: f64, amax: f64) -> Limits {
    Limits::new(fixed(vmax, 3), fixed(amax, 3)).expect("accepted")
}

fn obey(path: &mut Path, command: Command) {
    match command {
        Command::Target(steps) => path.set_target(steps),
        Command::Move(steps) => path.move_target(steps),
        Command::Drift(speed) => path.set_drift(speed),
        Command::Impulse(steps) => path.push_reference(steps),
        Command::Ramp(speed) => path.set_ramp(speed),
        Command::Gains(frequency, ratio) => path.set_gains(&gains_of(frequency, ratio)),
        Command::Limits(vmax, amax) => path.set_limits(&limits_of(vmax, amax)),
    }
}

fn position(path: &Path) -> f64 {
    f64::from(path.made()) + f64::from(path.offset()) / 65_536_000.0
}

/// Runs both for `ms` milliseconds; the largest difference of positions, steps. And that of a second exact path which
/// began 10^-4 step away: near ζ = πf·(1 ms), at its limits, the recurrence itself is chaotic.
#[track_caller]
fn compare(commands: &[(u32, Command)], ms: u32) -> (f64, f64) {
    let (mut path, mut exact) = (Path::new(), Exact::new());
    let mut twin = Exact { q: 1e-4, ..exact.clone() };
    let mut commands = commands.iter().peekable();
    let (mut worst, mut apart) = (0.0_f64, 0.0_f64);
    for now in 0..ms {
        while let Some((_, command)) = commands.next_if(|(at, _)| *at <= now) {
            obey(&mut path, *command);
            exact.obey(*command);
            twin.obey(*command);
        }
        let before = path.speed();
        let made = path.made();
        let slice = path.tick();
        check_slice(slice, before);
        let steps = i32::from(slice.count);
        assert_eq!(path.made().wrapping_sub(made), if slice.backward { -steps } else { steps });
        exact.tick();
        twin.tick();
        worst = worst.max((position(&path) - exact.q).abs());
        apart = apart.max((twin.q - exact.q).abs());
    }
    (worst, apart)
}

/// Checks that a slice's steps are as far apart as its speed requires, within the tolerance, in exact integers.
#[track_caller]
fn check_slice(slice: Slice, speed: i32) {
    assert_eq!((slice.speed, slice.backward), (speed.unsigned_abs(), speed < 0));
    let Some(train) = slice.train() else {
        assert_eq!(slice.count, 0);
        return;
    };
    assert_eq!((train.count, train.backward), (slice.count, slice.backward));
    for step in 0..u64::from(train.count) {
        // The distance to it, divided by the distance in a slice, times the ticks of a slice.
        let way = u64::from(slice.distance) + ((step * 1000) << 16);
        assert!(way <= u64::from(slice.speed), "{slice:?}: step {step} is not in it");
        let exact = u128::from(way) * (u128::from(TICKS) << 16) / u128::from(slice.speed);
        let at = u128::from(train.first) + u128::from(step) * u128::from(train.interval);
        assert!(at.abs_diff(exact) <= u128::from(TOLERANCE_TICKS) << 16, "{slice:?} {train:?} {step}: {exact}");
    }
    check_nearest(slice);
    let next = u64::from(slice.distance) + ((u64::from(train.count) * 1000) << 16);
    assert!(next > u64::from(slice.speed), "{slice:?}: one more is in it");
}

/// For clocks of 16 and 125 MHz each step is at the nearest tick, but for 2^-12 tick.
#[track_caller]
fn check_nearest(slice: Slice) {
    for ticks in [16_000, 125_000] {
        let steps = slice.steps(ticks).expect("there are some");
        assert_eq!((steps.count, steps.direction == Direction::Backward), (slice.count, slice.backward));
        assert_eq!(steps.ticks().count(), usize::from(slice.count));
        for (step, tick) in (0..).zip(steps.ticks()) {
            let way = u64::from(slice.distance) + ((step * 1000) << 16);
            // 2^-20 ticks.
            let exact = u128::from(way) * (u128::from(ticks) << 20) / u128::from(slice.speed);
            let at = u128::from(steps.first + step * steps.interval) << 4;
            assert!(exact >= at && exact - at < 1 << 8, "{slice:?} {steps:?} {step}: {exact}");
            assert!((u128::from(tick) << 20).abs_diff(exact) <= (1 << 19) + (1 << 8), "{slice:?}: {tick}, {exact}");
        }
    }
}

#[track_caller]
fn check(name: &str, commands: &[(u32, Command)], ms: u32) {
    let (worst, _) = compare(commands, ms);
    println!("{name}: {worst:.4} step in {ms} ms");
    assert!(worst < 0.1, "{name}: {worst} step");
}

#[test]
fn the_suite_of_commands() {
    use Command::{Drift, Gains, Impulse, Limits, Move, Ramp, Target};
    check("step, ringing", &[(0, Target(800))], 30_000);
    check("step, at the limits", &[(0, Target(20_000))], 60_000);
    check("long step", &[(0, Target(-100_000))], 120_000);
    check("long step, slow", &[(0, Gains(0.05, 0.08)), (0, Target(100_000))], 400_000);
    check("critical", &[(0, Gains(2.0, 1.0)), (0, Target(5000)), (2500, Target(-5000))], 6000);
    check("drift", &[(0, Drift(1234))], 60_000);
    check("drift and back", &[(0, Gains(1.0, 0.7)), (10, Drift(-3000)), (5000, Drift(0)), (5000, Target(0))], 20_000);
    check("faster than it may", &[(0, Drift(15_000)), (3000, Drift(0))], 60_000);
    check("retarget", &[(0, Gains(3.0, 0.5)), (0, Target(3000)), (150, Target(-1000)), (333, Move(5))], 8000);
    check("impulses", &[(0, Impulse(40)), (100, Impulse(40)), (200, Impulse(-1000)), (950, Impulse(3))], 30_000);
    check("ramp", &[(0, Ramp(400)), (0, Target(2000)), (2500, Target(0)), (4000, Impulse(50))], 30_000);
    check("ramp, then none", &[(0, Ramp(100)), (0, Move(700)), (1500, Ramp(0)), (1500, Drift(5))], 30_000);
    check("limits", &[(0, Limits(500.0, 900.0)), (0, Target(4000)), (6000, Limits(3500.0, 35e3))], 40_000);
    check("slower at once", &[(0, Target(9000)), (1000, Limits(200.5, 5000.0)), (9000, Limits(1e4, 1e6))], 60_000);
    check("fastest", &[(0, Limits(1e5, 1e7)), (0, Gains(20.0, 0.1)), (0, Target(8000)), (700, Target(0))], 5000);
    check("stiffest", &[(0, Gains(20.0, 5.0)), (0, Target(8000)), (2000, Target(7999))], 20_000);
    check("softest", &[(0, Gains(0.01, 0.07)), (0, Target(1000))], 2_000_000);
    check("slowest", &[(0, Gains(0.01, 5.0)), (0, Target(1000))], 2_000_000);
    check("decimals", &[(0, Gains(1.147198, 0.333333)), (0, Target(12_345))], 30_000);
}

#[test]
fn an_hour_does_not_creep() {
    use Command::{Drift, Gains, Target};
    const HOUR: u32 = 3_600_000;
    check("an hour of drift", &[(0, Gains(1.0, 0.7)), (0, Drift(1234))], HOUR);
    check("an hour of rest", &[(0, Target(777))], HOUR);
    let pushes: Vec<_> = (0..HOUR).step_by(7919).map(|ms| (ms, Target((ms / 7919 % 17) as i32 * 100 - 800))).collect();
    check("an hour of targets", &pushes, HOUR);
}

#[test]
fn a_speed_is_exact_over_time() {
    for speed in [1234, 1, -7, 3333, -9000] {
        let mut path = Path::new();
        path.set_limits(&limits_of(10_000.0, 100_000.0));
        path.set_gains(&gains_of(1.0, 1.0));
        path.set_drift(speed);
        for _ in 0..30_000 {
            path.tick();
        }
        let from = path.made();
        for _ in 0..1_000_000 {
            path.tick();
        }
        assert_eq!(path.made() - from, 1000 * i32::from(speed));
    }
}

#[test]
fn steps_of_a_constant_speed_are_even() {
    let mut path = Path::new();
    path.set_gains(&gains_of(2.0, 1.0));
    path.set_drift(1234);
    let (mut last, mut spread) = (None, (f64::MAX, 0.0_f64));
    for ms in 0..60_000_u64 {
        let Some(train) = path.tick().train() else { continue };
        for step in 0..u64::from(train.count) {
            let at = ms * (16_000 << 16) + u64::from(train.first) + step * u64::from(train.interval);
            if let Some(last) = last
                && ms > 30_000
            {
                let interval = (at - last) as f64 / 65_536.0;
                spread = (spread.0.min(interval), spread.1.max(interval));
            }
            last = Some(at);
        }
    }
    let exact = 16e6 / 1234.0;
    println!("intervals {spread:?}, exact {exact}");
    assert!(spread.0 > exact - 3.0 && spread.1 < exact + 3.0, "{spread:?}");
}

#[test]
fn it_stops_within_its_limit() {
    for (drift, amax) in [(3000, 35_000.0), (-9000, 10_000.0), (15_000, 250_000.0), (3, 1.0)] {
        let mut path = Path::new();
        path.set_limits(&limits_of(10_000.0, amax));
        path.set_drift(drift);
        for _ in 0..5000 {
            path.tick();
        }
        let speed = f64::from(path.speed()) / 65_536.0;
        path.stop();
        let time_ms = (speed.abs() / amax * 1000.0).ceil() as u32 + 1;
        for _ in 0..time_ms {
            let before = path.speed();
            path.tick();
            let change = path.speed().abs_diff(before);
            assert!(f64::from(change) <= amax * 65.536 + 1.0, "{change} at {amax}");
        }
        path.tick();
        assert!(path.is_at_rest() && path.speed().abs() < 16, "after {time_ms} ms: {path:?}");
        let made = path.made();
        for _ in 0..10_000 {
            path.tick();
        }
        assert_eq!(path.made(), made, "it stays");
        path.set_gains(&gains_of(1.0, 1.0));
        path.set_limits(&Limits::DEFAULT);
        path.set_target(-5);
        for _ in 0..60_000 {
            path.tick();
        }
        assert_eq!(path.made(), -5, "and goes on when told");
    }
}

#[test]
fn far_targets_wait_their_turn() {
    let mut path = Path::new();
    path.set_target(i32::MAX);
    path.move_target(i32::MAX);
    for _ in 0..200 {
        path.set_drift(15_000);
        path.move_target(i32::MAX);
        path.tick();
    }
    let speed = path.speed();
    for _ in 0..1000 {
        path.tick();
        assert!(path.speed() >= speed, "a target far ahead stays ahead");
    }
    path.set_target(0);
    path.set_drift(0);
    path.set_gains(&gains_of(1.0, 1.0));
    for _ in 0..30_000 {
        path.tick();
    }
    assert!(path.made() == 0 && path.is_at_rest());
}

#[test]
fn a_target_is_never_approached_round_the_end_of_32_bits() {
    let (near, far) = (i32::MAX - 3, i32::MIN + 3);
    for (from, target) in [(100, i32::MIN), (-100, i32::MAX), (near, far), (far, near), (-1, i32::MAX), (0, i32::MIN)] {
        let mut path = Path::at(from);
        path.set_target(target);
        let up = target > from;
        for _ in 0..2000 {
            let slice = path.tick();
            assert!(slice.count == 0 || slice.backward != up, "from {from} to {target}");
        }
        assert!((path.made() > from) == up, "from {from} to {target}: {}", path.made());
    }
}

#[test]
fn beyond_32_bits_targets_count_from_the_position_shown() {
    // Three steps below the end of 32 bits, ten steps up: the position wraps, and the way back is counted from the wrapped position.
    let mut path = Path::at(i32::MAX - 3);
    path.set_gains(&gains_of(2.0, 1.0));
    path.move_target(10);
    (0..3000).for_each(|_| _ = path.tick());
    assert!(path.is_at_rest());
    assert_eq!(path.made(), i32::MIN + 6);
    path.set_target(i32::MIN);
    (0..3000).for_each(|_| _ = path.tick());
    assert_eq!(path.made(), i32::MIN);
}

fn gains() -> impl Strategy<Value = Command> {
    // Over the whole region, as a client prints them.
    (-2.0..1.30103_f64, -1.1549..0.69897_f64).prop_map(|(f, z)| {
        let round = |x: f64, low: f64, high: f64| (x.clamp(low, high) * 1e6).round() / 1e6;
        Command::Gains(round(10_f64.powf(f), 0.01, 20.0), round(10_f64.powf(z), 0.07, 5.0))
    })
}

/// Gains and limits in the range that docs/winch.md states: f·vmax ≤ amax, and ζ well above πf·(1 ms).
fn calm() -> impl Strategy<Value = [Command; 2]> {
    let log =
        |low: f64, high: f64| (low.ln()..=high.ln()).prop_map(move |x| (x.exp().clamp(low, high) * 1e6).round() / 1e6);
    let gains = prop_oneof![(log(0.01, 10.0), log(0.07, 5.0)), (log(10.0, 20.0), log(0.15, 5.0))];
    // Half of them at the edge.
    (gains, log(50.0, 10_000.0), prop_oneof![Just(0.0), 0.0..1.0]).prop_map(|((frequency, ratio), vmax, part)| {
        let least = (frequency * vmax).max(1.0);
        let amax = least * (f64::from(MAX_ACCELERATION) / least).powf(part);
        [Command::Gains(frequency, ratio), Command::Limits(vmax, (amax * 1e3).ceil() / 1e3)]
    })
}

fn wish() -> impl Strategy<Value = Command> {
    prop_oneof![
        (-20_000..20_000).prop_map(Command::Target),
        (-2000..2000).prop_map(Command::Move),
        (-4000..4000_i16).prop_map(Command::Drift),
        (-500..500).prop_map(Command::Impulse),
        prop_oneof![Just(0), 1..5000_u16].prop_map(Command::Ramp),
    ]
}

fn command() -> impl Strategy<Value = Command> {
    prop_oneof![
        5 => wish(),
        1 => gains(),
        1 => (50..12_000, 200..300_000).prop_map(|(v, a): (i32, i32)| Command::Limits(v.into(), a.into())),
    ]
}

/// Commands, each with the time after the one before, ms; and the length of the whole.
fn timed(first: &[Command], commands: Vec<(u32, Command)>) -> (Vec<(u32, Command)>, u32) {
    let mut at = 0;
    let mut timed: Vec<_> = first.iter().map(|command| (0, *command)).collect();
    for (wait, command) in commands {
        at += wait;
        timed.push((at, command));
    }
    (timed, at + 5000)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, ..ProptestConfig::default() })]

    #[test]
    fn it_follows_the_recurrence(first in gains(), commands in prop::collection::vec((1..1500_u32, command()), 1..12)) {
        let (commands, ms) = timed(&[first], commands);
        let (worst, apart) = compare(&commands, ms);
        prop_assume!(apart < 1e-2);
        prop_assert!(worst < 0.1, "{} step", worst);
    }

    #[test]
    fn any_motion_is_followed_where_it_is_calm(
        first in calm(),
        commands in prop::collection::vec((1..2500_u32, wish()), 1..12),
    ) {
        let (commands, ms) = timed(&first, commands);
        let (worst, _) = compare(&commands, ms);
        prop_assert!(worst < 0.1, "{} step", worst);
    }

    #[test]
    fn it_keeps_its_limits(commands in prop::collection::vec((1..400_u32, command()), 1..20)) {
        let mut path = Path::new();
        let (mut vmax, mut amax) = (3500.0, 35_000.0);
        for (wait, command) in commands {
            obey(&mut path, command);
            if let Command::Limits(v, a) = command {
                (vmax, amax) = (f64::from(FASTEST).min(v), f64::from(MAX_ACCELERATION).min(a));
            }
            for _ in 0..wait {
                let before = f64::from(path.speed()) / 65_536.0;
                path.tick();
                let after = f64::from(path.speed()) / 65_536.0;
                prop_assert!((after - before).abs() <= amax * 1e-3 + 1e-4);
                prop_assert!(after.abs() <= vmax + 1e-4 || after.abs() < before.abs());
            }
        }
    }

    #[test]
    fn it_ends_at_rest_on_its_target(commands in prop::collection::vec((1..400_u32, command()), 1..10), end in -3000..3000) {
        let mut path = Path::new();
        for (wait, command) in commands {
            obey(&mut path, command);
            for _ in 0..wait {
                path.tick();
            }
        }
        let last = [Command::Gains(1.0, 0.8), Command::Limits(5000.0, 50e3), Command::Ramp(0), Command::Drift(0)];
        for command in last {
            obey(&mut path, command);
        }
        path.set_target(end);
        for _ in 0..40_000 {
            path.tick();
        }
        prop_assert_eq!(path.made(), end);
        prop_assert!(path.is_at_rest());
    }

    #[test]
    fn steps_keep_apart(commands in prop::collection::vec((1..300_u32, command()), 1..20)) {
        // Neither from slice to slice nor in a reversal: two thresholds lie 1/32 step apart, and speeds of two slices that
        // differ in sign are at most amax·(1 ms) = 250 steps/s.
        let mut path = Path::new();
        let mut last: Option<(u64, bool)> = None;
        let mut now = 0_u64;
        for (wait, command) in commands {
            obey(&mut path, command);
            for _ in 0..wait {
                if let Some(train) = path.tick().train() {
                    for step in 0..u64::from(train.count) {
                        let at = now + u64::from(train.first) + step * u64::from(train.interval);
                        if let Some((before, backward)) = last {
                            let least = if backward == train.backward { 1600 - 3 } else { 2000 - 3 };
                            prop_assert!(at >= before + (least << 16), "{} after {}", at >> 16, before >> 16);
                        }
                        last = Some((at, train.backward));
                    }
                }
                now += 16_000 << 16;
            }
        }
    }

    #[test]
    fn any_slice_is_spaced(speed in 1..=655_360_000_i32, part in 0.0..1.0_f64) {
        // A path at any place, at that speed.
        let distance = (part * 1031.25 * 65_536.0) as u32;
        let speed = speed.unsigned_abs();
        let count = if distance > speed { 0 } else { 1 + (speed - distance) / (1000 << 16) };
        check_slice(Slice { count: count as u8, backward: false, distance, speed }, speed.cast_signed());
    }
}

const _: () = assert!(FASTEST_DRIFT == 15_000);
