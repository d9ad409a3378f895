//! The rows of the Pico's table, for `cargo xtask bench pico` and, in short, for a test.

use super::motion::{Followed, follow};
use super::pico::{COILS, Run, Seen, Timing, stream};
use pulsetrain::load;
use pulsetrain_board::virtual_pico::VirtualPico;
use pulsetrain_board::{Board, Edge, Lease, Leased, Remote, Setup, WithReference};
use pulsetrain_core::output::Sequence;
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::{Cause, coil_pins};
use pulsetrain_core::{Direction, Entry, Epoch, Item, Segment, Tick32};
use pulsetrain_motion::program::{CoilSequence, Limits, Motor, Program, Scale, Tolerance, Wiring};
use pulsetrain_motion::{Grid, Law as Motion, Time, boards};
use pulsetrain_session::drive::{Driven, connect_as};

/// A Pico, and the native board from which the scheduled tick of each step comes.
type Pico = WithReference<Remote<VirtualPico>>;
use pulsetrain_session::lateness::Lateness;
use pulsetrain_session::prepare::Prepared;
use pulsetrain_testkit::pico::{TICK_HZ, coils};
use pulsetrain_testkit::segments::{Chip, Law};

/// One line of the table.
#[derive(Clone, Debug)]
pub(crate) struct Row {
    /// The number of the figure; 5 is the load.
    pub(crate) figure: u8,
    pub(crate) law: String,
    /// Driver, pulse, set-up and hold.
    pub(crate) timing: String,
    pub(crate) pins: String,
    pub(crate) motors: usize,
    /// Step rate of each motor, steps/s.
    pub(crate) rate: String,
    /// The bound.
    pub(crate) required: String,
    /// STEP edges, or patterns of coils, of all motors.
    pub(crate) edges: u64,
    /// Steps without an edge, or edges without a step.
    pub(crate) lost: u64,
    /// Largest |edge − scheduled tick|, cycles.
    pub(crate) off: i64,
    /// Share of the cycles that the processor was awake.
    pub(crate) awake: Option<f64>,
    pub(crate) bytes_per_step: Option<f64>,
    pub(crate) horizon_ticks: u64,
    /// The broken bounds. Empty if there are none.
    pub(crate) verdict: String,
    /// Steps/s of the slowest motor.
    pub(crate) reached: f64,
}

/// The columns' titles.
pub(crate) const COLUMNS: [&str; 14] = [
    "figure",
    "law",
    "driver: pulse, set-up, hold",
    "pins",
    "motors",
    "steps/s each",
    "required",
    "edges",
    "lost",
    "largest |edge − due|, cycles",
    "awake",
    "bytes/step",
    "horizon, ms",
    "verdict",
];

impl Row {
    pub(crate) fn fields(&self) -> [String; 14] {
        let or_dash = |text: Option<String>| text.unwrap_or_else(|| "–".to_owned());
        [
            self.figure.to_string(),
            self.law.clone(),
            self.timing.clone(),
            self.pins.clone(),
            self.motors.to_string(),
            self.rate.clone(),
            self.required.clone(),
            self.edges.to_string(),
            self.lost.to_string(),
            self.off.to_string(),
            or_dash(self.awake.map(|share| format!("{:.1} %", 100.0 * share))),
            or_dash(self.bytes_per_step.map(|bytes| format!("{bytes:.3}"))),
            match self.horizon_ticks {
                0 => "–".to_owned(),
                ticks => format!("{:.2}", ticks as f64 * 1000.0 / TICK_HZ as f64),
            },
            if self.verdict.is_empty() { "holds".to_owned() } else { self.verdict.clone() },
        ]
    }

    pub(crate) fn holds(&self) -> bool {
        self.verdict.is_empty()
    }
}

/// 1000 steps/s.
pub(crate) fn kilo(rate: f64) -> String {
    format!("{:.1} k", rate / 1000.0)
}

fn timing_text(timing: Timing) -> String {
    let ns = timing.ns;
    if timing.driver == COILS {
        return format!("{COILS}, half steps");
    }
    format!("{}: {} ns, {} ns, {} ns", timing.driver, ns.pulse_high_ns, ns.dir_setup_ns, ns.dir_hold_ns)
}

/// STEP and DIR of some motors as in tables, or IN1 to IN4.
fn pins_text(driver: &str, motors: usize) -> String {
    if driver == COILS {
        let pins = (0..motors as u8).map(|motor| coil_pins(2 + 4 * motor).map(|pin| pin.to_string()).join("/"));
        return pins.collect::<Vec<_>>().join(" ");
    }
    (0..motors).map(|motor| format!("{}/{}", 2 + 2 * motor, 3 + 2 * motor)).collect::<Vec<_>>().join(" ")
}

/// Steps of [`Case::turning`]: after a reversal segments begin this short.
pub(crate) const BETWEEN_TURNS: u32 = 8;

/// Average number of steps of a segment of [`Case::short`].
pub(crate) const IN_SHORT: u32 = 6;

/// Motors that follow random segments.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Case {
    pub(crate) figure: u8,
    pub(crate) motors: usize,
    pub(crate) driver: &'static str,
    /// From segment to segment the speed changes by up to this share of itself.
    pub(crate) swing: f64,
    /// Least number of steps of a segment; the greatest is twice that.
    pub(crate) steps: u32,
    /// One segment in this many reverses; 0: none.
    pub(crate) turns: u64,
    /// The shortest first interval after a reversal, ticks.
    pub(crate) turn_ticks: f64,
    /// In phase at 0, staggered at 1.
    pub(crate) apart: f64,
    /// The promised rate of each motor, steps/s.
    pub(crate) required: Option<f64>,
    pub(crate) seed: u64,
}

impl Case {
    /// At least as hard as planned motions at such rates: a sinusoid of 1 s with a peak of 622 k steps/s has 1160 steps
    /// in a segment, as [`sinusoids`] show.
    pub(crate) const fn changing(motors: usize, driver: &'static str) -> Case {
        Case {
            figure: 1,
            motors,
            driver,
            swing: 0.1,
            steps: 500,
            turns: 0,
            turn_ticks: 3000.0,
            apart: 1.0,
            required: None,
            seed: 1,
        }
    }

    /// Segments of 4 to 8 steps in one direction: the load depends on their number.
    pub(crate) const fn short(motors: usize, driver: &'static str) -> Case {
        Case { steps: 2 * IN_SHORT / 3, ..Case::changing(motors, driver) }
    }

    /// Forward and back with eight steps each: an eighth of the steps are reversals.
    pub(crate) const fn turning(motors: usize, driver: &'static str) -> Case {
        Case { swing: 0.0, steps: BETWEEN_TURNS, turns: 1, turn_ticks: 100.0, ..Case::changing(motors, driver) }
    }

    fn name(&self) -> String {
        let law =
            if self.swing == 0.0 { "constant".to_owned() } else { format!("changing ±{:.0} %", 100.0 * self.swing) };
        let turns = if self.turns > 0 { format!(", 1 segment in {} turns", self.turns) } else { String::new() };
        let phase = match (self.motors, self.apart == 0.0) {
            (1, _) => "",
            (_, true) => ", in phase",
            (_, false) => ", staggered",
        };
        if self.turns == 1 {
            return format!("{law}, a turn every {} steps{phase}", self.steps);
        }
        format!("{law}, segments of {} to {} steps{turns}{phase}", self.steps, 2 * self.steps)
    }

    fn run(&self, rate: f64, seconds: f64) -> Run {
        Run {
            motors: self.motors,
            timing: Timing::of(self.driver),
            chip: Chip { least_steps: self.steps, turn_ticks: self.turn_ticks, ..Chip::PICO },
            law: Law { rate, swing: self.swing, turns: self.turns },
            apart: self.apart,
            seconds,
            seed: self.seed,
        }
    }

    /// Streams the case.
    pub(crate) fn row(&self, pico: &VirtualPico, rate: f64, seconds: f64) -> Row {
        let seen = stream(pico.clone(), &self.run(rate, seconds));
        let mut row = Row {
            figure: self.figure,
            law: self.name(),
            timing: timing_text(Timing::of(self.driver)),
            pins: pins_text(self.driver, self.motors),
            motors: self.motors,
            rate: "–".to_owned(),
            required: self.required.map_or(String::new(), kilo),
            edges: 0,
            lost: 0,
            off: 0,
            awake: None,
            bytes_per_step: None,
            horizon_ticks: 0,
            verdict: String::new(),
            reached: 0.0,
        };
        let seen: Seen = match seen {
            Ok(seen) => seen,
            Err(refused) => return Row { verdict: format!("FAILS: {refused}"), ..row },
        };
        let Lateness { edges, min_ticks, max_ticks, lost, extra, .. } = seen.lateness;
        (row.reached, row.rate) = (seen.rate, kilo(seen.rate));
        (row.edges, row.lost, row.off) = (edges, lost + extra, max_ticks.max(-min_ticks));
        (row.awake, row.bytes_per_step) = (Some(seen.awake).filter(|awake| *awake > 0.0), Some(seen.bytes_per_step));
        row.horizon_ticks = seen.horizon_ticks;
        if !seen.holds() {
            row.verdict = format!("FAILS: {}; {} steps lost, {extra} added", seen.trouble, lost);
        } else if self.required.is_some_and(|required| seen.rate < required) {
            row.verdict = format!("MISSED: {}", kilo(seen.rate));
        }
        if self.apart == 0.0 && seen.skew_ticks != 0 {
            row.verdict = format!("FAILS: the motors start {} cycles apart", seen.skew_ticks);
        }
        row
    }

    /// The fastest of `rates` that holds for `seconds`, by bisection, and then for `longer`, too. If none does, the
    /// result of the slowest.
    pub(crate) fn fastest(&self, pico: &VirtualPico, rates: &[f64], seconds: f64, longer: f64) -> Row {
        let (mut low, mut fails) = (0, rates.len());
        while low < fails {
            let middle = (low + fails) / 2;
            if self.row(pico, rates[middle], seconds).holds() {
                low = middle + 1;
            } else {
                fails = middle;
            }
        }
        let mut row = self.row(pico, rates[low.saturating_sub(1)], longer);
        while !row.holds() && low > 1 {
            low -= 1;
            row = self.row(pico, rates[low - 1], longer);
        }
        row
    }
}

/// Rates that are tried, steps/s: 2.5 % apart, up to the driver's limit.
pub(crate) fn rates(driver: &'static str) -> Vec<f64> {
    let ns = Timing::of(driver).ns;
    // The speed swings by 10 %. With coils the processor is the limit.
    let most = 1e9 / f64::from(ns.pulse_high_ns + ns.pulse_low_ns).max(200.0) / 1.1;
    let rates = std::iter::successors(Some(10_000.0), |rate: &f64| Some((rate * 1.025 / 100.0).ceil() * 100.0));
    rates.take_while(|rate| *rate <= most).collect()
}

/// A little more than promised, since the mean of random speeds is not exactly the wanted one.
pub(crate) const ABOVE: f64 = 1.02;

/// Figure 1: the promised rates.
pub(crate) fn promised() -> [Case; 2] {
    [
        Case { required: Some(625e3), ..Case::changing(8, "TMC2209") },
        Case { required: Some(250e3), ..Case::changing(8, "A4988") },
    ]
}

/// Eight motors that begin in one tick.
pub(crate) fn start() -> Case {
    Case { figure: 2, apart: 0.0, ..Case::changing(8, "TMC2209") }
}

/// A motor of a program for the Pico, its STEP on pin 2 + 2 · number.
fn motor(number: u8, law: Motion, timing: Timing) -> Motor {
    let (step, dir) = (2 + 2 * number, 3 + 2 * number);
    Motor {
        name: format!("motor{number}"),
        law,
        wiring: Wiring::StepDir { step, dir, forward_high: true, enable: None },
        timing: timing.ns,
        limits: Limits { max_speed: None, max_acceleration: None, pull_in: 1000.0 },
        scale: Scale { unit: "step".to_owned(), steps_per_unit: 1.0, steps_per_rev: 200.0 },
        winding: None,
        driver: None,
    }
}

/// Some motors on coils.
pub(crate) fn on_coils(motors: usize) -> Vec<Motor> {
    let timing = Timing::of(COILS);
    let law = || Motion::sine(1.0, Time::SECOND, Some(1)).expect("a sinusoid");
    let wired = |number: u8| {
        let wiring = Wiring::Coils { pins: coil_pins(2 + 4 * number), sequence: CoilSequence::Half };
        Motor { wiring, ..motor(number, law(), timing) }
    };
    (0..motors as u8).map(wired).collect()
}

fn prepared(file: &str, motors: Vec<Motor>) -> Prepared {
    let board = boards::find("pico").expect("the table has the Pico").limits();
    let machines = Vec::new();
    let program = Program {
        board,
        grid: Grid::REACH,
        tolerance: Tolerance::Ticks(1.0),
        idle_ms: None,
        motors,
        machines,
        queue_parts: Vec::new(),
    };
    Prepared {
        file: file.to_owned(),
        program,
        cut: None,
        pause: None,
        line: None,
        tables: Vec::new(),
        recordings: Vec::new(),
    }
}

/// A motion that a session plans and streams over USB: a row for all edges, with the scheduled error.
fn motion_row(figure: u8, law: &str, prepared: &Prepared, timing: Timing) -> (Row, Option<Followed>) {
    let motors = prepared.program.motors.len();
    let mut row = Row {
        figure,
        law: law.to_owned(),
        timing: timing_text(timing),
        pins: pins_text(timing.driver, motors),
        motors,
        rate: "–".to_owned(),
        required: String::new(),
        edges: 0,
        lost: 0,
        off: 0,
        awake: None,
        bytes_per_step: None,
        horizon_ticks: 0,
        verdict: String::new(),
        reached: 0.0,
    };
    let mut driven = match Driven::with(prepared, |program| connect_as(VirtualPico::on_usb(), program, Baud::B2M, 1)) {
        Ok(driven) => driven,
        Err(refused) => return (Row { verdict: format!("FAILS: {refused}"), ..row }, None),
    };
    let mark = |driven: &mut Driven<Pico>| {
        let chip = driven.board_mut().port().chip();
        (chip.cycle(), chip.asleep_cycles())
    };
    let (cycle, asleep) = mark(&mut driven);
    let followed = match follow(prepared, &mut driven, 0, 0.0, |_| {}) {
        Ok(followed) => followed,
        Err(refused) => return (Row { verdict: format!("FAILS: {refused}"), ..row }, None),
    };
    let (now, slept) = mark(&mut driven);
    row.awake = Some(1.0 - (slept - asleep) as f64 / (now - cycle) as f64);
    let Lateness { edges, min_ticks, max_ticks, lost, extra, .. } = followed.lateness;
    row.law = format!("{law}; scheduled {:.2} of {:.2} ticks", followed.largest(), followed.certificate_ticks);
    (row.reached, row.rate) = (followed.peak_rate, format!("{} peak", kilo(followed.peak_rate)));
    (row.edges, row.lost, row.off) = (edges, lost + extra, max_ticks.max(-min_ticks));
    if !followed.trouble.is_empty() || (row.lost, row.off) != (0, 0) {
        row.verdict = format!("FAILS: {}", followed.trouble);
    }
    (row, Some(followed))
}

/// Figure 1: sinusoids of different periods with peaks of `rate` on each of eight motors, for `cycles` cycles of the
/// longest.
pub(crate) fn sinusoids(rate: f64, cycles: u64) -> Row {
    let timing = Timing::of("TMC2209");
    let motors = (0..8_u8).map(|number| {
        // 1000 ms to 1070 ms.
        let period = Time::from_ratio(1000 + 10 * i64::from(number), 1000);
        let amplitude = (rate * period.seconds() / std::f64::consts::TAU).floor();
        let law = Motion::sine(amplitude, period, Some(cycles)).expect("a sinusoid");
        motor(number, law, timing)
    });
    let prepared = prepared("sinusoids", motors.collect());
    let (mut row, _) =
        motion_row(1, "sinusoids of 1.00 to 1.07 s, planned and streamed by a session", &prepared, timing);
    row.required = format!("{} peak", kilo(rate));
    if row.holds() && row.reached < 0.999 * rate {
        row.verdict = format!("MISSED: {}", row.rate);
    }
    row
}

/// Eight motors with one sinusoid of some cycles a second for some time, s: they bend and reverse together.
pub(crate) fn alike(amplitude: f64, hz: f64, seconds: f64) -> Prepared {
    let law = Motion::sine(amplitude, Time::from_seconds(1.0 / hz), Some((seconds * hz).ceil() as u64));
    let law = law.expect("a sinusoid");
    prepared("alike", (0..8).map(|number| motor(number, law.clone(), Timing::of("TMC2209"))).collect())
}

/// A motion in the form of [`motion_row`].
pub(crate) fn made(prepared: &Prepared) -> Row {
    motion_row(1, &prepared.file, prepared, Timing::of("TMC2209")).0
}

/// Figure 4: the sweep article's four motors twice, each with a DIR line of its own, for some seconds and the planned
/// stop. A row for all edges, and one for each motor with its phase error at the end.
pub(crate) fn sweep(seconds: i64) -> Vec<Row> {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/sweep.toml");
    let length = Some(Time::from_ratio(seconds, 1));
    let original = load::load(std::path::Path::new(file), None, length).expect("an example");
    let timing = Timing::of("A4988");
    let laws = original.program.motors.iter().map(|motor| motor.law.clone());
    let motors = (0_u8..).zip(laws.clone().chain(laws)).map(|(number, law)| motor(number, law, timing)).collect();
    let prepared = Prepared { cut: original.cut, ..prepared("the sweep article's motion", motors) };
    let law = format!("the sweep article's four motors twice, {seconds} s");
    let (all, followed) = motion_row(4, &law, &prepared, timing);
    let mut rows = vec![all.clone()];
    let schedules = followed.iter().flat_map(|followed| &followed.schedules);
    for (motor, schedule) in prepared.program.motors.iter().zip(schedules) {
        let phase = schedule.phase();
        rows.push(Row {
            law: format!(
                "{law}: `{}`, phase error {phase:.3} ticks over the last 500 of {} steps",
                motor.name, schedule.steps
            ),
            required: "phase < 1 tick".to_owned(),
            motors: 1,
            edges: schedule.steps,
            awake: None,
            verdict: if phase.abs() < 1.0 { all.verdict.clone() } else { "MISSED".to_owned() },
            ..all.clone()
        });
    }
    rows
}

/// The Pico plotter's table, half steps 1 to 8 in forward order, as its `out pins, 4` writes it to IN1 (bit 0) to IN4.
const HALF: [u8; 8] = [0x9, 0x8, 0xc, 0x4, 0x6, 0x2, 0x3, 0x1];

/// The pattern at a position: full steps have two coils on, wave steps one.
fn pattern(sequence: Sequence, position: i64) -> u8 {
    HALF[match sequence {
        Sequence::Half => position.rem_euclid(8),
        Sequence::Full => 2 * position.rem_euclid(4),
        Sequence::Wave => 2 * position.rem_euclid(4) + 1,
    } as usize]
}

/// Figure 3: ULN2003 motors, each pattern at its tick, with reversals at every phase, in both directions.
pub(crate) fn uln2003(pico: &VirtualPico, sequence: Sequence, rate: u64) -> Row {
    let bases: Vec<u8> = (0..ULN_MOTORS).map(|motor| 2 + 4 * motor).collect();
    let motors: Vec<_> = bases.iter().map(|base| coils(*base, sequence)).collect();
    let pins = bases.iter().map(|base| coil_pins(*base).map(|pin| pin.to_string()).join("/"));
    let mut row = Row {
        figure: 3,
        law: format!("{sequence:?} steps, reversals at each of the 8 phases, both ways"),
        timing: "ULN2003".to_owned(),
        pins: pins.collect::<Vec<_>>().join(" "),
        motors: motors.len(),
        rate: kilo(rate as f64),
        required: "every pattern and interval".to_owned(),
        edges: 0,
        lost: 0,
        off: 0,
        awake: None,
        bytes_per_step: None,
        horizon_ticks: 0,
        verdict: String::new(),
        reached: rate as f64,
    };
    let setup = Setup { motors, ..Setup::default() };
    let mut board = Remote::open(pico.clone(), 7).expect("it answers");
    board.configure(&setup).expect("six groups of four pins");
    let begin = board.now() + board.round_trip() + TICK_HZ / 10;
    let mut wanted = Vec::new();
    let mut last = 0;
    for motor in 0..setup.motors.len() {
        let (items, steps) = reversals(begin + TICK_HZ / 1000, (TICK_HZ / rate) as u32 + 7 * motor as u32);
        for item in items {
            board.push(motor, Entry { epoch: Epoch(1), item }).expect("room");
        }
        last = steps.last().map_or(last, |(tick, _)| last.max(*tick));
        wanted.push(steps.iter().map(|(tick, at)| (*tick, pattern(sequence, *at))).collect::<Vec<_>>());
    }
    board.switch(Epoch(1), begin, Lease::Last, &[]).expect("in time");
    let mut edges: Vec<Edge> = Vec::new();
    board.advance(last + TICK_HZ / 1000, &mut |edge: Edge| edges.push(edge));
    edges.sort_by_key(|edge| edge.tick);
    for (base, wanted) in bases.iter().zip(&wanted) {
        let seen = patterns(&edges, coil_pins(*base));
        row.edges += seen.len() as u64;
        let wrong = (0..seen.len().max(wanted.len())).filter(|&at| seen.get(at) != wanted.get(at)).count();
        row.lost += wrong as u64;
    }
    if row.lost > 0 {
        row.verdict = format!("FAILS: {} patterns are others, or at another tick", row.lost);
    }
    if let Some(event) = board.events().iter().find(|event| event.cause != Cause::Finished) {
        row.verdict = format!("FAILS: {:?} ({})", event.cause, event.detail);
    }
    row
}

/// Motors with coils.
pub(crate) const ULN_MOTORS: u8 = 6;

/// Items of a motor that goes forward and back so that it reverses at every phase, and the ticks and positions of its
/// steps.
fn reversals(start: u64, interval: u32) -> (Vec<Item>, Vec<(u64, i64)>) {
    let (mut items, mut steps) = (vec![Item::Anchor { tick: Tick32::of(start) }], Vec::new());
    let (mut tick, mut position, mut direction) = (start, 0_i64, Direction::Forward);
    let mut turned = [[false; 8]; 2];
    for phase in 0..8 {
        // Up to a phase, and down to another.
        for target in [24 + phase, 3 * phase % 8 - 16] {
            let count = (target - position).unsigned_abs() as u32;
            let segment = Segment { count, interval: i64::from(interval) << 32, add: 0, add2: 0 };
            items.push(Item::Run { segment, direction });
            for _ in 0..count {
                tick += u64::from(interval);
                position += i64::from(direction.sign());
                steps.push((tick, position));
            }
            turned[usize::from(direction == Direction::Forward)][position.rem_euclid(8) as usize] = true;
            direction = direction.reversed();
        }
    }
    assert_eq!(turned, [[true; 8]; 2]);
    (items, steps)
}

/// The patterns on four lines, each with the time from which it holds.
fn patterns(edges: &[Edge], pins: [u8; 4]) -> Vec<(u64, u8)> {
    let (mut all, mut now) = (Vec::<(u64, u8)>::new(), 0);
    for edge in edges {
        let Some(input) = pins.iter().position(|pin| *pin == edge.line) else { continue };
        let bit = 1 << input;
        now = if edge.level { now | bit } else { now & !bit };
        match all.last_mut().filter(|(tick, _)| *tick == edge.tick) {
            Some((_, pattern)) => *pattern = now,
            None => all.push((edge.tick, now)),
        }
    }
    all
}
