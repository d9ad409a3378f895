//! The rows of the Uno's table, for `cargo xtask bench uno` and, in short, for a golden file.

use super::motion;
use super::uno::{COMPARE, MOST_CYCLES, P99_CYCLES, PORT_B, Pins, Run, SHIELD, Seen, TUTORIAL, pins_text, stream};
use pulsetrain::load;
use pulsetrain_motion::program::{DriverTiming, Limits, Motor, Program, Scale, Tolerance, Wiring};
use pulsetrain_motion::{Grid, Law as Motion, Time, boards};
use pulsetrain_session::lateness::Lateness;
use pulsetrain_session::prepare::Prepared;
use pulsetrain_testkit::TICK_HZ;
use pulsetrain_testkit::segments::Law;

/// One line of the table.
#[derive(Clone, Debug)]
pub(crate) struct Row {
    /// The number of the figure.
    pub(crate) figure: u8,
    pub(crate) law: String,
    pub(crate) pulse: String,
    pub(crate) pins: String,
    pub(crate) motors: usize,
    /// The step rate of each motor, steps/s.
    pub(crate) rate: String,
    /// The wanted step rate of the first motor, steps/s; 0 for motions.
    pub(crate) asked: f64,
    /// The wanted rate, or the bound in words.
    pub(crate) required: String,
    pub(crate) seen: Option<Seen>,
    /// The broken bounds. Empty if there are none.
    pub(crate) verdict: String,
    /// Whether the project promises it.
    pub(crate) is_required: bool,
}

/// The columns' titles.
pub(crate) const COLUMNS: [&str; 17] = [
    "figure",
    "law",
    "pulse",
    "pins",
    "motors",
    "steps/s each",
    "required",
    "lost",
    "constant",
    "p50",
    "p99",
    "max",
    "min",
    "awake",
    "busy",
    "horizon, ms",
    "verdict",
];

impl Row {
    pub(crate) fn fields(&self) -> [String; 17] {
        let seen = |text: &dyn Fn(&Seen) -> String| self.seen.as_ref().map_or("–".to_owned(), text);
        let late = |value: fn(&Lateness) -> i64| seen(&|seen| value(&seen.lateness).to_string());
        let percent = |share: f64| format!("{:.0} %", 100.0 * share);
        [
            self.figure.to_string(),
            self.law.clone(),
            self.pulse.clone(),
            self.pins.clone(),
            self.motors.to_string(),
            self.rate.clone(),
            self.required.clone(),
            late(|lateness| (lateness.lost + lateness.extra) as i64),
            late(|lateness| lateness.constant_ticks as i64),
            late(|lateness| lateness.p50_ticks),
            late(|lateness| lateness.p99_ticks),
            late(|lateness| lateness.max_ticks),
            late(|lateness| lateness.min_ticks),
            seen(&|seen| percent(seen.load.awake)),
            seen(&|seen| percent(seen.load.busy)),
            seen(&|seen| match seen.horizon_ticks {
                0 => "–".to_owned(),
                ticks => format!("{:.2}", ticks as f64 * 1000.0 / TICK_HZ as f64),
            }),
            if self.verdict.is_empty() { "holds".to_owned() } else { self.verdict.clone() },
        ]
    }
}

/// Ticks as µs.
pub(crate) fn us(ticks: u16) -> String {
    format!("{:.1} µs", f64::from(ticks) / 16.0)
}

/// 1000 steps/s.
pub(crate) fn kilo(rate: f64) -> String {
    format!("{:.1} k", rate / 1000.0)
}

/// Motors with laws of one shape, at rates in proportion.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Case {
    pub(crate) figure: u8,
    pub(crate) pins: Pins,
    pub(crate) motors: usize,
    pub(crate) swing: f64,
    /// One segment in this many reverses; 0: none.
    pub(crate) turns: u64,
    /// In phase at 0, staggered at 1.
    pub(crate) apart: f64,
    pub(crate) pulse_ticks: u16,
    /// Each motor is slower than the one before by this factor: 1, or 1 : ¼ : ⅛ : 1/16.
    pub(crate) ratios: [f64; 4],
    /// The seed of the random segments.
    pub(crate) seed: u64,
}

pub(crate) const ALIKE: [f64; 4] = [1.0; 4];
pub(crate) const UNEQUAL: [f64; 4] = [1.0, 0.25, 0.125, 0.0625];
/// 1 µs.
pub(crate) const PULSE: u16 = 16;
/// Longer pulses: one that an interrupt makes by itself, and two that take two interrupts, whose steps the firmware
/// expands together, and one by one.
pub(crate) const LONGER_PULSES: [u16; 3] = [31, 80, 256];

impl Case {
    const fn changing(pins: Pins, motors: usize) -> Case {
        Case { figure: 2, pins, motors, swing: 0.1, turns: 0, apart: 1.0, pulse_ticks: PULSE, ratios: ALIKE, seed: 1 }
    }

    fn run(&self, rate: f64, seconds: f64) -> Run {
        let law = |ratio: &f64| Law { rate: rate * ratio, swing: self.swing, turns: self.turns };
        let laws = self.ratios[..self.motors].iter().map(law).collect();
        Run { pins: self.pins, laws, apart: self.apart, pulse_ticks: self.pulse_ticks, seconds, seed: self.seed }
    }

    /// Whether the table of boards takes its limits from it (from the slowest of its kind): one rate for all motors.
    pub(crate) fn is_limit(&self) -> bool {
        self.apart != 0.0 && self.ratios == ALIKE && self.turns == 0
    }

    /// Streams it at a rate of the first motor.
    pub(crate) fn row(&self, rate: f64, seconds: f64) -> Row {
        let run = self.run(rate, seconds);
        let (seen, verdict) = match stream(&run) {
            Ok(seen) => {
                let verdict = if seen.holds() { String::new() } else { said(&seen) };
                (Some(seen), verdict)
            }
            Err(refused) => (None, refused),
        };
        let least = |seen: &Seen| seen.rates.iter().copied().fold(f64::INFINITY, f64::min);
        let equal = self.ratios == ALIKE;
        let reached = seen.as_ref().map_or("–".to_owned(), |seen| {
            if equal {
                kilo(least(seen))
            } else {
                seen.rates.iter().map(|rate| kilo(*rate)).collect::<Vec<_>>().join(" ")
            }
        });
        Row {
            figure: self.figure,
            law: self.name(),
            pulse: us(self.pulse_ticks),
            pins: pins_text(&self.pins[..self.motors]),
            motors: self.motors,
            rate: reached,
            asked: rate,
            required: String::new(),
            seen,
            verdict,
            is_required: false,
        }
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
        let ratios = if self.ratios == ALIKE { "" } else { ", 1 : ¼ : ⅛ : 1/16" };
        format!("{law}{turns}{phase}{ratios}")
    }

    /// The highest rate of each motor that the table of boards allows on these pins, steps/s.
    pub(crate) fn limit_hz(&self) -> f64 {
        let motors: Vec<Motor> = self.pins[..self.motors].iter().map(|pins| self.motor(*pins)).collect();
        let row = boards::find("uno").expect("the table has the Uno");
        TICK_HZ as f64 / f64::from(row.shortest_intervals(&motors)[self.motors - 1])
    }

    /// A motor of a motion on such pins, with the case's pulses.
    pub(crate) fn motor(&self, (step, dir): (u8, u8)) -> Motor {
        let one = &tutorial(Time::SECOND, 1, self.pins[0], 1000).program.motors[0];
        Motor {
            wiring: Wiring::StepDir { step, dir, forward_high: true, enable: None },
            timing: DriverTiming { pulse_high_ns: u32::from(self.pulse_ticks) * 125 / 2, ..one.timing },
            ..one.clone()
        }
    }

    /// Runs the limit of the table of boards with other random segments, `seconds` each: the worst lateness, all lost
    /// steps, and how many hold. Rate, load and horizon are those of the first.
    pub(crate) fn others(&self, seeds: u64, seconds: f64) -> Row {
        let rate = self.limit_hz();
        let rows = (1..=seeds).map(|seed| Case { seed: self.seed + seed, ..*self }.row(rate, seconds));
        let (mut worst, mut hold): (Option<Row>, u64) = (None, 0);
        for row in rows {
            hold += u64::from(row.verdict.is_empty());
            let Some(worst) = &mut worst else {
                worst = Some(row);
                continue;
            };
            let Some((all, seen)) = worst.seen.as_mut().zip(row.seen) else { continue };
            let (all, seen) = (&mut all.lateness, seen.lateness);
            all.min_ticks = all.min_ticks.min(seen.min_ticks);
            all.p50_ticks = all.p50_ticks.max(seen.p50_ticks);
            all.p99_ticks = all.p99_ticks.max(seen.p99_ticks);
            all.max_ticks = all.max_ticks.max(seen.max_ticks);
            all.lost += seen.lost;
            all.extra += seen.extra;
        }
        let mut row = worst.expect("seeds");
        row.figure = 7;
        row.law = format!("{}, {seeds} times {seconds} s", row.law);
        row.verdict = if hold == seeds { String::new() } else { format!("{hold} of {seeds} hold") };
        row
    }

    /// The fastest of `rates` that holds for `seconds`, by bisection, and then for `longer`, too. If none does, the
    /// result of the slowest.
    pub(crate) fn fastest(&self, rates: &[f64], seconds: f64, longer: f64) -> Row {
        let (mut low, mut fails) = (0, rates.len());
        while low < fails {
            let middle = (low + fails) / 2;
            if self.row(rates[middle], seconds).verdict.is_empty() {
                low = middle + 1;
            } else {
                fails = middle;
            }
        }
        let mut row = self.row(rates[low.saturating_sub(1)], longer);
        while !row.verdict.is_empty() && low > 1 {
            low -= 1;
            row = self.row(rates[low - 1], longer);
        }
        row
    }
}

/// Motions that stay fast: half a second of acceleration, 0.75 s at a rate, half a second of braking. Each motor is a
/// part of a step behind the one before.
fn plateaus(pins: &[(u8, u8)], rate: f64, apart: f64) -> Prepared {
    let Prepared { program, .. } = tutorial(Time::from_ratio(1, 1), 1, pins[0], 1000);
    let law = Motion::trapezoid(1.25 * rate, rate, 2.0 * rate, 2.0 * rate).expect("a trapezoid");
    let motors = (0..).zip(pins).map(|(index, (step, dir))| Motor {
        name: format!("m{index}"),
        law: law
            .clone()
            .delayed(Time::from_seconds(apart * f64::from(index) / rate / pins.len() as f64))
            .expect("a law"),
        wiring: Wiring::StepDir { step: *step, dir: *dir, forward_high: true, enable: None },
        ..program.motors[0].clone()
    });
    let motors: Vec<Motor> = motors.collect();
    // The limits of a motion file.
    let row = boards::find("uno").expect("the table has the Uno");
    let mut program = Program { board: row.limits(), motors, tolerance: Tolerance::Seconds(1e-6), ..program };
    program.board.min_interval_ticks = row.shortest_intervals(&program.motors);
    program.board.turn_ticks = row.turn_ticks(&program.motors);
    Prepared {
        file: "plateaus".to_owned(),
        program,
        cut: None,
        pause: None,
        line: None,
        tables: Vec::new(),
        recordings: Vec::new(),
    }
}

/// The fastest of `rates` at which motors on these pins stay for a while, with a session, in phase and staggered. All
/// slower rates must hold, too, from a fifth of the table's limit on; every second rate is tried.
pub(crate) fn fastest_plateau(case: &Case, rates: &[f64]) -> Row {
    let pins = &case.pins[..case.motors];
    let row = |rate: f64| {
        let of = |apart: f64| {
            let law = format!("{} k for 0.75 s, by a session", rate / 1000.0);
            motion_row(6, law, &plateaus(pins, rate, apart), MOST_CYCLES, false)
        };
        let staggered = of(1.0);
        if case.motors == 1 || !staggered.verdict.is_empty() { staggered } else { of(0.0) }
    };
    let slowest = case.limit_hz() / 5.0;
    let mut best = None;
    for rate in rates.iter().filter(|rate| **rate >= slowest).step_by(2) {
        let tried = row(*rate);
        if !tried.verdict.is_empty() {
            return best.unwrap_or(tried);
        }
        best = Some(tried);
    }
    best.expect("some rate")
}

/// The broken bounds.
fn said(seen: &Seen) -> String {
    let Lateness { min_ticks, p99_ticks, max_ticks, lost, extra, .. } = seen.lateness;
    let mut said = Vec::new();
    if !seen.trouble.is_empty() {
        said.push(seen.trouble.clone());
    }
    if lost + extra > 0 {
        said.push(format!("{lost} steps lost, {extra} added"));
    }
    if p99_ticks > P99_CYCLES || max_ticks > MOST_CYCLES || min_ticks < -MOST_CYCLES {
        said.push("too late".to_owned());
    }
    format!("FAILS: {}", said.join("; "))
}

/// Figure 2: speeds that change from segment to segment. Nothing is promised: `super::promises` has what is.
pub(crate) const CHANGING: [Case; 7] = [
    Case::changing(TUTORIAL, 1),
    Case::changing(COMPARE, 1),
    Case::changing(SHIELD, 2),
    Case::changing(COMPARE, 2),
    Case::changing(SHIELD, 3),
    Case::changing(PORT_B, 3),
    Case::changing(SHIELD, 4),
];

/// Figure 3: variations of figure 2.
pub(crate) fn variations() -> Vec<Case> {
    let mut cases = Vec::new();
    for changing in CHANGING {
        let case = Case { figure: 3, ..changing };
        let constant = Case { swing: 0.0, ..case };
        cases.push(constant);
        if case.motors > 1 {
            cases.push(Case { apart: 0.0, ..constant });
            cases.push(Case { apart: 0.0, ..case });
            cases.push(Case { ratios: UNEQUAL, ..case });
        }
        cases.push(Case { turns: 5, ..case });
        for pulse_ticks in LONGER_PULSES {
            cases.push(Case { pulse_ticks, ..case });
            cases.push(Case { pulse_ticks, ..constant });
        }
    }
    // Two motors with one ring, as on the shield with its pins 12 and 13.
    for pulse_ticks in [PULSE].into_iter().chain(LONGER_PULSES) {
        let case = Case { figure: 3, pulse_ticks, ..Case::changing(PORT_B, 2) };
        cases.extend([case, Case { swing: 0.0, ..case }]);
    }
    cases
}

/// Rates that are tried, steps/s of the first motor: 2.5 % apart.
pub(crate) fn rates() -> Vec<f64> {
    let rates = std::iter::successors(Some(2_000.0), |rate: &f64| Some((rate * 1.025 / 100.0).round() * 100.0));
    rates.take_while(|rate| *rate <= 300_000.0).collect()
}

/// A motor of the tutorial: 5 revolutions to either side of a sinusoid.
pub(crate) fn tutorial(period: Time, cycles: u64, (step, dir): (u8, u8), pulse_ns: u32) -> Prepared {
    let board = boards::find("uno").expect("the table has the Uno").limits();
    let law = Motion::sine(2000.0, period, Some(cycles)).expect("a sinusoid");
    let motor = Motor {
        name: "wheel".to_owned(),
        law,
        wiring: Wiring::StepDir { step, dir, forward_high: false, enable: None },
        timing: DriverTiming { pulse_high_ns: pulse_ns, pulse_low_ns: 1000, dir_setup_ns: 1000, dir_hold_ns: 1000 },
        limits: Limits { max_speed: None, max_acceleration: None, pull_in: 1000.0 },
        scale: Scale { unit: "step".to_owned(), steps_per_unit: 1.0, steps_per_rev: 800.0 },
        winding: None,
        driver: None,
    };
    let program = Program {
        board,
        grid: Grid::REACH,
        tolerance: Tolerance::Ticks(1.0),
        idle_ms: None,
        motors: vec![motor],
        machines: Vec::new(),
        queue_parts: Vec::new(),
    };
    Prepared {
        file: format!("the tutorial, T = {} s", period.seconds()),
        program,
        cut: None,
        pause: None,
        line: None,
        tables: Vec::new(),
        recordings: Vec::new(),
    }
}

/// Period (s, as a fraction), STEP and DIR: the sweep article's periods, the fastest by the compare hardware.
pub(crate) const TUTORIALS: [((i64, u64), (u8, u8)); 7] = [
    ((500, 1), (8, 9)),
    ((10, 1), (8, 9)),
    ((3, 1), (8, 9)),
    ((3, 2), (8, 9)),
    ((1, 1), (8, 9)),
    ((4, 5), (8, 9)),
    ((1, 10), (9, 8)),
];

/// Figure 1: greatest lateness of edges by software, cycles (1 µs). The compare hardware has none.
const LATE_CYCLES: i64 = 16;

/// A period of the tutorial, streamed by a session.
pub(crate) fn tutorial_row((period, pins): ((i64, u64), (u8, u8)), pulse_ns: u32, is_required: bool) -> Row {
    let prepared = tutorial(Time::from_ratio(period.0, period.1), 1, pins, pulse_ns);
    let limit = if pins.0 == 9 { 0 } else { LATE_CYCLES };
    let law = format!("tutorial, A = 2000, T = {} s", period.0 as f64 / period.1 as f64);
    motion_row(1, law, &prepared, limit, is_required)
}

/// A motion of a session. Edges are at most `limit` cycles late.
pub(crate) fn motion_row(figure: u8, law: String, prepared: &Prepared, limit: i64, is_required: bool) -> Row {
    motion_row_and_phases(figure, law, prepared, limit, is_required).0
}

fn motion_row_and_phases(
    figure: u8,
    law: String,
    prepared: &Prepared,
    limit: i64,
    is_required: bool,
) -> (Row, Vec<Phase>) {
    let mut phases = Vec::new();
    let motors = &prepared.program.motors;
    let pins: Vec<_> = motors
        .iter()
        .filter_map(|motor| match motor.wiring {
            Wiring::StepDir { step, dir, .. } => Some((step, dir)),
            Wiring::Coils { .. } => None,
        })
        .collect();
    let pulse_ns = motors.iter().map(|motor| motor.timing.pulse_high_ns).max().unwrap_or(0);
    let mut row = Row {
        figure,
        law,
        pulse: format!("{:.1} µs", f64::from(pulse_ns) / 1000.0),
        pins: pins_text(&pins),
        motors: motors.len(),
        rate: String::new(),
        asked: 0.0,
        required: format!("max ≤ {limit}"),
        seen: None,
        verdict: String::new(),
        is_required,
    };
    match motion::make(prepared, limit as f64, |_| {}) {
        Ok(made) => {
            row.rate = format!("{} peak", kilo(made.peak_rate));
            row.law = format!("{}; scheduled {:.2} of {:.2} ticks", row.law, made.largest(), made.certificate_ticks);
            let Lateness { min_ticks, max_ticks, lost, extra, .. } = made.seen.lateness;
            let mut said = Vec::new();
            if !made.seen.trouble.is_empty() {
                said.push(made.seen.trouble.clone());
            }
            if lost + extra > 0 {
                said.push(format!("{lost} steps lost, {extra} added"));
            }
            if max_ticks > limit || min_ticks < -limit {
                said.push("too late".to_owned());
            }
            if !said.is_empty() {
                row.verdict = format!("FAILS: {}", said.join("; "));
            }
            phases.extend(made.schedules.iter().map(|schedule| Phase {
                steps: schedule.steps,
                last: schedule.phase(),
                put_off: schedule.put_off,
                longest_put_off: schedule.longest_put_off,
            }));
            row.seen = Some(made.seen);
        }
        Err(refused) => row.verdict = format!("FAILS: {refused}"),
    }
    (row, phases)
}

/// Figure 4: the sweep article's four motors on their shared DIR line, for some seconds and the planned stop. A row for
/// all edges, and one for each motor with its phase error at the end.
pub(crate) fn hour(seconds: i64) -> Vec<Row> {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/sweep.toml");
    let length = Some(Time::from_ratio(seconds, 1));
    let prepared = load::load(std::path::Path::new(file), None, length).expect("an example");
    let law = format!("the sweep article's four motors, {seconds} s");
    // Steps of several motors at one time wait for one another.
    let (mut all, phases) = motion_row_and_phases(4, law.clone(), &prepared, SHARED_CYCLES, true);
    all.required = format!("max ≤ {SHARED_CYCLES}");
    let mut rows = vec![all.clone()];
    for (motor, phase) in prepared.program.motors.iter().zip(phases) {
        let Phase { steps, last, put_off, longest_put_off } = phase;
        rows.push(Row {
            law: format!(
                "{law}: `{}`, phase error {last:.2} ticks over the last 500 of {steps} steps; {put_off} put off for the line's sake, by \
                 {longest_put_off:.0} ticks at most",
                motor.name
            ),
            pins: String::new(),
            rate: String::new(),
            required: "phase < 1 tick".to_owned(),
            seen: None,
            verdict: if last.abs() < 1.0 { all.verdict.clone() } else { "MISSED".to_owned() },
            ..all.clone()
        });
    }
    rows
}

/// A motor's phase error after a motion.
#[derive(Clone, Copy, Debug)]
struct Phase {
    steps: u64,
    last: f64,
    put_off: u64,
    longest_put_off: f64,
}

/// Greatest lateness on a shared DIR line, cycles: three steps of other motors and a reversal of DIR may come before.
const SHARED_CYCLES: i64 = 300;
