//! Changes on virtual boards: firmware on an emulated chip.

use super::*;
use pulsetrain_board::{BoardKind, Edge, Observer, ScheduledStep};
use pulsetrain_motion::file;
use pulsetrain_session::control::{Command, Event};
use pulsetrain_session::drive::Driven;
use pulsetrain_session::prepare::Prepared;
use pulsetrain_testkit::limits;

/// Random numbers: Knuth's generator of 64 bits.
struct Random(u64);

impl Random {
    fn between(&mut self, least: f64, most: f64) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        least + (most - least) * (self.0 >> 40) as f64 / (1u64 << 24) as f64
    }

    fn below(&mut self, end: usize) -> usize {
        (self.between(0.0, end as f64) as usize).min(end - 1)
    }
}

/// Motors that swing, as a motion file has them: each with its swing in steps, and its frequency in Hz.
fn swings(board: &str, limits: Option<(f64, f64)>, values: &[(f64, f64)]) -> Prepared {
    let mut text = format!("board = \"{board}\"\ntolerance = \"2 us\"\n");
    for (motor, (steps, hz)) in values.iter().enumerate() {
        // The Uno's four motors are those of a CNC shield, the Pico's follow one another.
        let (step, dir) =
            if board == "pico" { (2 + 2 * motor, 3 + 2 * motor) } else { [(2, 5), (3, 6), (4, 7), (12, 13)][motor] };
        text += &format!(
            "[motor.m{motor}]\nsteps_per_rev = 200\nmicrosteps = 16\ndriver = \"A4988\"\nforward = \"high\"\n\
             pins = {{ step = {step}, dir = {dir} }}\n{}\
             [[motion]]\nmotor = \"m{motor}\"\nlaw.sweep = {{ frequency = \"{hz} Hz\", swing = \"{steps:.0} step\" }}\n",
            limits.map_or_else(String::new, |(speed, acceleration)| {
                format!("max_speed = \"{speed} step/s\"\nmax_acceleration = \"{acceleration} step/s^2\"\n")
            })
        );
    }
    let no_files = |_: &std::path::Path| Err(std::io::ErrorKind::NotFound.into());
    let contents = file::read_contents(&text, "swings.toml", &no_files).expect("it is a motion file");
    Prepared::new("swings.toml".to_owned(), contents, None).expect("it fits the board")
}

/// What a board has to do.
struct Load {
    board: &'static str,
    /// The most of each motor, steps/s and steps/s², if it has limits.
    limits: Option<(f64, f64)>,
    /// Each motor's largest swing, steps, and its frequency, Hz.
    peaks: Vec<(f64, f64)>,
}

impl Load {
    /// Motors that all swing with this speed in the middle.
    fn of_speed(board: &'static str, motors: usize, steps_per_s: f64, hz: f64) -> Load {
        let swing = steps_per_s / (std::f64::consts::PI * hz);
        let limits = (1.3 * steps_per_s, 1.5 * steps_per_s * 2.0 * std::f64::consts::PI * hz);
        Load { board, limits: Some(limits), peaks: vec![(swing, hz); motors] }
    }

    fn with(&self, values: &[(f64, f64)]) -> Prepared {
        swings(self.board, self.limits, values)
    }

    fn begin(&self) -> Driven<impl Leased> {
        let kind = BoardKind::named(self.board).unwrap();
        let mut first = self.with(&self.peaks);
        first.prove_first(|_| {}).unwrap();
        Driven::on_virtual(kind, &first, kind.usual_baud()).unwrap().staying().looking_often()
    }
}

/// Changes of one swing after another at any time: the board counts what the host replays, and each begins soon after it was asked for.
fn changes_begin_within(soon_s: f64, load: &Load, seed: u64) {
    let (made, latest_s) = changes(load, seed).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
    assert!(made > 5, "{made} changes");
    assert!(latest_s <= soon_s, "the first tick of a change came {latest_s} s after it was asked for");
}

/// Such changes: how many there were, and after which time the latest one began.
fn changes(load: &Load, seed: u64) -> Result<(u32, f64), String> {
    let mut random = Random(seed);
    let mut values = load.peaks.clone();
    let mut driven = load.begin();
    let (mut due_s, mut at_s, mut made, mut latest_s) = (1.0, 0.0, 0, 0.0_f64);
    let (mut asked_s, mut ends): (Option<f64>, Vec<f64>) = (None, Vec::new());
    let ended = loop {
        let stop = (at_s > 5.0).then_some(Command::Stop);
        let step = driven.step(stop, &mut |_: Edge| {}, |event| {
            if let Event::Progress { at_s: now_s } = event {
                at_s = now_s;
            }
        });
        let failed = |error: &dyn std::fmt::Display| format!("after {made} changes at {at_s} s: {error}");
        if let Some(ended) = step.map_err(|error| failed(&error))? {
            break ended;
        }
        if at_s < due_s || stop.is_some() {
            continue;
        }
        // While two changes are under way a third one waits for the end of one of them.
        ends.retain(|end_s| *end_s > at_s);
        if asked_s.is_none() {
            let motor = random.below(values.len());
            values[motor].0 = load.peaks[motor].0 * random.between(0.3, 1.0);
        }
        let asked = *asked_s.get_or_insert(at_s);
        let change =
            Change { program: Arc::new(load.with(&values).program), over: None, begins: Begins::WithTheMotion };
        match driven.change_to(&change) {
            Ok((from_s, until_s)) => {
                (made, latest_s) = (made + 1, latest_s.max(from_s - asked));
                ends.push(until_s);
                (due_s, asked_s) = (at_s + random.between(0.0, 0.8), None);
            }
            Err(SessionError::Waiting { .. }) => asked_s = asked_s.filter(|_| ends.len() < 2),
            Err(error) => return Err(failed(&error)),
        }
    };
    assert!(ended.stopped);
    Ok((made, latest_s))
}

/// From the event to the first tick of its change.
const SOON_ON_UNO_S: f64 = 0.060;
const SOON_ON_PICO_S: f64 = 0.020;

/// Four motors whose queues last some 50 ms, and four that are nearly as fast as the board can.
#[test]
fn changes_on_a_busy_uno_begin_within_60_ms() {
    changes_begin_within(SOON_ON_UNO_S, &Load::of_speed("uno", 4, 5000.0, 5.0), 1);
    // All four turn at the same time. Their lists of steps end at the tick of a change, and it takes long to fill them. A longer trial:
    // `PULSETRAIN_SEEDS=300`. It may find a change after which the board's step generator does not keep up, once in 500 at most.
    let load = Load::of_speed("uno", 4, 20_000.0, 1.0);
    let Some(seeds) = std::env::var("PULSETRAIN_SEEDS").ok().and_then(|text| text.parse().ok()) else {
        return [2, 6, 16, 41, 107].into_iter().for_each(|seed| changes_begin_within(SOON_ON_UNO_S, &load, seed));
    };
    let trials: Vec<_> = (0..seeds).map(|seed| changes(&load, seed)).collect();
    let made: u32 = trials.iter().flatten().map(|(made, _)| made).sum();
    let failed: Vec<&String> = trials.iter().filter_map(|trial| trial.as_ref().err()).collect();
    println!(
        "{made} changes, the latest after {} s, {} trials failed: {failed:#?}",
        trials.iter().flatten().map(|(_, latest_s)| *latest_s).fold(0.0, f64::max),
        failed.len()
    );
    assert!(failed.len() * 500 <= made as usize);
}

#[test]
fn changes_of_a_fast_motor_on_an_uno_begin_within_60_ms() {
    changes_begin_within(SOON_ON_UNO_S, &Load::of_speed("uno", 1, 75_000.0, 2.0), 3);
}

/// 0.01 turns/s: a step comes after half a second or later.
fn slow(board: &'static str) -> Load {
    Load { board, limits: Some((32_000.0, 192_000.0)), peaks: vec![(32.0, 0.1), (1600.0, 0.5), (2.0, 0.2)] }
}

#[test]
fn slow_motors_delay_no_change() {
    changes_begin_within(SOON_ON_UNO_S, &slow("uno"), 4);
    changes_begin_within(SOON_ON_PICO_S, &slow("pico"), 5);
}

#[test]
fn changes_on_a_busy_pico_begin_within_20_ms() {
    changes_begin_within(SOON_ON_PICO_S, &Load::of_speed("pico", 8, 50_000.0, 5.0), 7);
}

mod long {
    use super::*;

    #[test]
    fn changes_on_a_busier_pico_begin_within_20_ms() {
        changes_begin_within(SOON_ON_PICO_S, &Load::of_speed("pico", 4, 200_000.0, 2.0), 6);
    }
}

/// The steps as they were scheduled, and how many pulses the pins had.
#[derive(Default)]
struct Seen {
    steps: Vec<Vec<(u64, i64)>>,
    rising: Vec<u64>,
}

impl Observer for Seen {
    fn edge(&mut self, edge: Edge) {
        let line = usize::from(edge.line);
        self.rising.resize(self.rising.len().max(line + 1), 0);
        self.rising[line] += u64::from(edge.level);
    }

    fn step(&mut self, step: ScheduledStep) {
        self.steps.resize_with(self.steps.len().max(step.motor + 1), Vec::new);
        self.steps[step.motor].push((step.tick, i64::from(step.direction.sign())));
    }
}

/// Seconds of random changes; a longer trial: `PULSETRAIN_CHANGES_S=600`.
fn changes_s() -> f64 {
    std::env::var("PULSETRAIN_CHANGES_S").ok().and_then(|text| text.parse().ok()).unwrap_or(6.0 * rounds() as f64)
}

/// Laws, tempo, pauses and resumptions at any time, also several at once: no step is lost, no limit is broken, and the last law is followed as if there
/// had been no other.
fn anything_at_any_time_on(board: &'static str, seed: u64) {
    /// The tolerance of the motion file.
    const TOLERANCE_S: f64 = 2e-6;
    const LIMITS: (f64, f64) = (6000.0, 60_000.0);
    let load = Load { board, limits: Some(LIMITS), peaks: vec![(800.0, 0.5), (400.0, 1.0), (160.0, 2.0)] };
    let mut random = Random(seed);
    let mut driven = load.begin();
    let hz = load.with(&load.peaks).program.board.tick_hz as f64;
    let (mut seen, mut due_s, mut at_s, mut made) = (Seen::default(), 0.5, 0.0, 0);
    let busy_until_s = changes_s();
    // The last change: from when, until when.
    let mut last: Option<(f64, f64)> = None;
    let last_values = [(500.0, 0.7), (300.0, 1.1), (150.0, 1.5)];
    let (mut paused, mut is_calm) = (false, false);
    let mut command = None;
    let ended = loop {
        assert!(at_s < busy_until_s + 30.0, "seed {seed}: {made} changes, and no end");
        if last.is_some_and(|(_, until_s)| at_s > until_s + 1.5) {
            command = Some(Command::Stop);
        }
        let step = driven.step(command.take(), &mut seen, |event| match event {
            Event::Progress { at_s: now_s } => at_s = now_s,
            Event::Pausing { .. } => paused = true,
            Event::Resuming { .. } => paused = false,
            _ => {}
        });
        if let Some(ended) = step.unwrap_or_else(|error| panic!("seed {seed}, {made} changes, at {at_s} s: {error}")) {
            break ended;
        }
        if at_s < due_s || last.is_some() {
            continue;
        }
        due_s = at_s + random.between(0.0, 0.6);
        if at_s > busy_until_s {
            // At full speed again, before the last change.
            if paused {
                (command, due_s) = (Some(Command::Resume), at_s + 1.5);
                continue;
            }
            if !std::mem::replace(&mut is_calm, true) {
                (command, due_s) = (Some(Command::Tempo { rate: 1.0 }), at_s + 3.0);
                continue;
            }
            let program = Arc::new(load.with(&last_values).program);
            match driven.change_to(&Change { program, over: None, begins: Begins::Now }) {
                Ok(done) => last = Some(done),
                Err(SessionError::Waiting { .. }) => {}
                Err(error) => panic!("seed {seed}, the last change at {at_s} s: {error}"),
            }
            continue;
        }
        match random.below(8) {
            0 => command = Some(if paused { Command::Resume } else { Command::Pause }),
            1 => command = Some(Command::Tempo { rate: random.between(0.3, 1.2) }),
            kind => {
                // Several at once, the last of which may have to wait.
                for _ in 0..random.below(3) + 1 {
                    let mut program = load
                        .with(
                            &load
                                .peaks
                                .iter()
                                .map(|(swing, hz)| (swing * random.between(0.1, 0.9), hz * random.between(0.5, 1.2)))
                                .collect::<Vec<_>>(),
                        )
                        .program;
                    if kind < 4 {
                        // One motor goes to a place, and stays there.
                        let place = Law::speed(0.0, None).unwrap().shifted(random.between(-300.0, 300.0)).unwrap();
                        program.motors[random.below(3)].law = place;
                    }
                    let begins = if kind == 7 { Begins::Now } else { Begins::WithTheMotion };
                    let over = (kind == 6).then(|| seconds(random.between(0.0, 1.0)));
                    let change = Change { program: Arc::new(program), over, begins };
                    match driven.change_to(&change) {
                        Ok(_) => made += 1,
                        Err(SessionError::Waiting { .. } | SessionError::Pause(_) | SessionError::Early { .. }) => {}
                        Err(error) => panic!("seed {seed}, {made} changes, at {at_s} s: {error}"),
                    }
                }
            }
        }
    };
    assert!(ended.stopped && made > 5, "{made} changes");
    // A pulse for each step, and each of them counted.
    let counts: Vec<i64> = seen.steps.iter().map(|steps| steps.iter().map(|(_, way)| way).sum()).collect();
    assert_eq!(ended.counted, counts, "seed {seed}");
    for steps in &seen.steps {
        assert!(seen.rising.contains(&(steps.len() as u64)), "seed {seed}: {} steps, {:?}", steps.len(), seen.rising);
        check_limits(steps, hz, LIMITS).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
    }
    // Each step of the last law is as far from it as its tolerance says: twice that from another plan of it.
    let (from_s, until_s) = last.expect("there is a last change");
    let mut plain = Seen::default();
    let mut alone = Driven::native(&load.with(&last_values)).unwrap();
    while plain.steps.first().and_then(|steps| steps.last()).is_none_or(|(tick, _)| *tick as f64 / hz < at_s - from_s) {
        assert!(alone.step(None, &mut plain, |_| {}).unwrap().is_none());
    }
    let from = (from_s * hz).round() as u64;
    let (begin, end) = ((until_s * hz) as u64 - from + 1000, ((until_s + 1.4) * hz) as u64 - from);
    for (motor, (steps, plain)) in seen.steps.iter().zip(&plain.steps).enumerate() {
        let within = |steps: &[(u64, i64)], zero: u64| -> Vec<(u64, i64)> {
            let steps = steps.iter().filter(|(tick, _)| *tick >= zero).map(|(tick, way)| (tick - zero, *way));
            steps.filter(|(tick, _)| (begin..end).contains(tick)).collect()
        };
        let (steps, plain) = (within(steps, from), within(plain, 0));
        assert!(steps.len() > 100 && steps.len().abs_diff(plain.len()) <= 1, "{} and {}", steps.len(), plain.len());
        let skipped = usize::from(steps[0].0.abs_diff(plain[0].0) as f64 > 2.0 * TOLERANCE_S * hz + 2.0);
        let pairs: Vec<_> = if steps[0].0 < plain[0].0 {
            steps[skipped..].iter().zip(&plain[..]).collect()
        } else {
            steps.iter().zip(&plain[skipped..]).collect()
        };
        for ((tick, way), (other, other_way)) in pairs {
            let is_near = tick.abs_diff(*other) as f64 <= 2.0 * TOLERANCE_S * hz + 2.0;
            assert!(is_near && way == other_way, "seed {seed}, motor {motor}: {tick} and {other}");
        }
    }
}

/// No two steps are closer than the speed allows, and no stretch of them is sharper than the acceleration.
fn check_limits(steps: &[(u64, i64)], hz: f64, (speed, acceleration): (f64, f64)) -> Result<(), String> {
    // A step may be the tolerance off, and its tick is a whole one.
    let doubt = 2e-6 * hz + 1.0;
    for pair in steps.windows(2).filter(|pair| pair[0].1 == pair[1].1) {
        let interval = (pair[1].0 - pair[0].0) as f64;
        if interval + 2.0 * doubt < hz / speed {
            return Err(format!("{pair:?} are closer than {speed} steps/s"));
        }
    }
    limits::check_acceleration(steps, hz as u64, acceleration, doubt)
}

#[test]
fn anything_at_any_time_on_an_uno() {
    anything_at_any_time_on("uno", 11);
    anything_at_any_time_on("uno", 12);
}

#[test]
fn anything_at_any_time_on_a_pico() {
    anything_at_any_time_on("pico", 13);
}

/// A stop that reaches the board before a change's tick, or just after it: the board counts what the host replays.
fn stops_beside_changes_on(board: &'static str, load: &Load, seed: u64) {
    let mut random = Random(seed);
    for trial in 0..6 * rounds() {
        let mut driven = load.begin();
        let values: Vec<_> = load.peaks.iter().map(|(swing, hz)| (swing * random.between(0.3, 1.0), *hz)).collect();
        let change =
            Change { program: Arc::new(load.with(&values).program), over: None, begins: Begins::WithTheMotion };
        let (mut at_s, due_s) = (0.0, random.between(0.3, 1.0));
        let mut changed = None;
        // Steps of a hundredth of a second between the change and the stop.
        let mut left = trial % 3;
        let ended = loop {
            if changed.is_none() && at_s >= due_s {
                match driven.change_to(&change) {
                    Ok(times) => changed = Some(times),
                    Err(SessionError::Waiting { .. }) => {}
                    Err(error) => panic!("{board}, seed {seed}, {trial}: {error}"),
                }
            }
            let stops = changed.is_some() && left == 0;
            left -= u64::from(changed.is_some() && left > 0);
            let step = driven.step(stops.then_some(Command::Stop), &mut |_: Edge| {}, |event| {
                if let Event::Progress { at_s: now_s } = event {
                    at_s = now_s;
                }
            });
            match step {
                Ok(None) => {}
                Ok(Some(ended)) => break ended,
                Err(error) => panic!("{board}, seed {seed}, {trial}: changed at {changed:?}: {error}"),
            }
        };
        assert!(ended.stopped);
    }
}

#[test]
fn a_stop_just_after_a_change_loses_no_step() {
    // Without limits of their own motors brake as hard as their plan speeds up, and each plan has other limits.
    let unlimited = |board| Load { board, limits: None, peaks: vec![(1600.0, 0.5), (800.0, 0.3)] };
    for load in [unlimited("uno"), slow("uno"), Load::of_speed("uno", 4, 5000.0, 5.0), unlimited("pico")] {
        stops_beside_changes_on(load.board, &load, 21);
    }
}
