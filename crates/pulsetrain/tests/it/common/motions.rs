//! How fast one to four motors of an Uno follow whole motions, with a session on the virtual Uno, every edge compared.
//! Also what `plan` accepts, which knows less about the board than the board does.

use super::motion;
use super::rigs;
use super::rows::kilo;
use super::uno::{MOST_CYCLES, P99_CYCLES, SHIELD};
use pulsetrain_core::wire::Baud;
use pulsetrain_motion::boards;
use pulsetrain_motion::{Law, Time};
use pulsetrain_plan::{Line, Way};
use pulsetrain_session::prepare::Prepared;
use pulsetrain_testkit::Random;
use std::f64::consts::TAU;

/// 99 of 100 edges of motors in phase may be this late, cycles: they wait for one another.
const P99_IN_PHASE: i64 = 45;
/// The planner's shortest interval here, ticks. It is shorter than any interval of an Uno, so that the board is the
/// limit.
const SHORTEST_TICKS: u32 = 90;

/// A motion of about a second.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Shape {
    /// 0.75 s at the rate, and ramps of an eighth of a second.
    Trapezoid,
    /// A sinusoid whose fastest speed is the rate, with a frequency from and to, Hz.
    Sine(f64, f64),
}

/// A row of the figure.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sort {
    pub(crate) shape: Shape,
    /// With 1 to 4 motors, 1000 steps/s, at 1 Mbaud: rates are tried from a third of the first to 1.3 times the second.
    pub(crate) tried: [(f64, f64); 4],
}

pub(crate) const SORTS: [Sort; 4] = [
    Sort { shape: Shape::Trapezoid, tried: [(140.0, 150.0), (70.0, 75.0), (32.0, 35.0), (21.0, 26.0)] },
    Sort { shape: Shape::Sine(1.0, 5.0), tried: [(148.0, 150.0), (72.0, 75.0), (32.0, 37.0), (20.0, 24.0)] },
    Sort { shape: Shape::Sine(15.0, 15.0), tried: [(140.0, 148.0), (65.0, 70.0), (30.0, 35.0), (12.0, 18.0)] },
    Sort { shape: Shape::Sine(35.0, 35.0), tried: [(135.0, 140.0), (50.0, 60.0), (7.0, 18.0), (2.0, 8.0)] },
];

impl Shape {
    fn name(self) -> String {
        match self {
            Shape::Trapezoid => "trapezoids, 0.75 s flat".to_owned(),
            Shape::Sine(from, to) if from == to => format!("sines of {from} Hz"),
            Shape::Sine(from, to) => format!("sines of {from} to {to} Hz"),
        }
    }

    fn law(self, rate: f64, random: &mut Random) -> Law {
        let law = match self {
            Shape::Trapezoid => {
                let up_s = 0.125 * (0.8 + 0.4 * random.fraction());
                Law::trapezoid(rate * (0.75 + up_s), rate, rate / up_s, rate / up_s)
            }
            Shape::Sine(from, to) => {
                let hertz = from + (to - from) * random.fraction();
                let period = Time::from_seconds(1.0 / hertz);
                Law::sine(rate / (TAU * hertz), period, Some(hertz.round() as u64))
            }
        };
        law.expect("numbers within the limits of laws")
    }

    /// In phase with an even seed. Else trapezoids begin evenly apart within a step, and each sinusoid has its own
    /// frequency and begins at its own part of half a period.
    fn motion(self, motors: usize, rate: f64, seed: u64) -> Prepared {
        let mut random = Random::new(seed);
        let together = self.law(rate, &mut random);
        let law = |motor: usize| {
            let (law, late_s) = match self {
                _ if is_in_phase(seed) => return together.clone(),
                Shape::Trapezoid => (together.clone(), motor as f64 / rate / motors as f64),
                Shape::Sine(from, _) => (self.law(rate, &mut random), 0.5 / from * random.fraction()),
            };
            law.delayed(Time::from_seconds(late_s)).expect("a delay")
        };
        let laws: Vec<Law> = (0..motors).map(law).collect();
        let motors = laws.into_iter().enumerate().map(|(index, law)| rigs::motor(index, SHIELD[index], law));
        rigs::prepared(boards::find("uno").expect("the table has the Uno"), motors.collect())
    }
}

const fn is_in_phase(seed: u64) -> bool {
    seed.is_multiple_of(2)
}

/// Runs it on the board. The error is the first broken bound.
fn runs(shape: Shape, motors: usize, rate: f64, seed: u64, baud: Baud) -> Result<(), String> {
    let mut prepared = shape.motion(motors, rate, seed);
    prepared.program.board.min_interval_ticks = vec![SHORTEST_TICKS; motors];
    let seen = motion::make_at(&prepared, baud, MOST_CYCLES as f64, |_| {})?.seen;
    let p99 = if is_in_phase(seed) && motors > 1 { P99_IN_PHASE } else { P99_CYCLES };
    let late = seen.lateness;
    if !seen.trouble.is_empty() {
        return Err(seen.trouble);
    }
    if (late.lost, late.extra) != (0, 0) {
        return Err(format!("{} steps lost, {} added", late.lost, late.extra));
    }
    if late.p99_ticks > p99 || late.max_ticks > MOST_CYCLES || late.min_ticks < -MOST_CYCLES {
        return Err(format!("p99 {} cycles, {} to {}", late.p99_ticks, late.min_ticks, late.max_ticks));
    }
    Ok(())
}

/// Whether `plan` accepts it.
fn is_accepted(shape: Shape, motors: usize, rate: f64, seed: u64, baud: Baud) -> bool {
    let mut prepared = shape.motion(motors, rate, seed);
    prepared.line = Line::of(&prepared.program, Way::Uart(baud.rate()));
    prepared.plan(|_| {}).is_ok()
}

/// The fastest rung up to which all hold; 0 if none does. Rungs beyond the first failure hold only by chance.
fn fastest(rungs: &[f64], mut holds: impl FnMut(f64) -> bool) -> f64 {
    rungs.iter().copied().take_while(|rate| holds(*rate)).last().unwrap_or(0.0)
}

/// The rates that motors reach.
#[derive(Clone, Debug)]
pub(crate) struct Cell {
    /// Rate of each motor, steps/s, that the board makes with all seeds, and that `plan` accepts.
    pub(crate) runs: f64,
    pub(crate) accepted: f64,
    /// The broken bound at the next rate.
    pub(crate) why: String,
}

impl Sort {
    /// `Cell` of some motors, with some seeds. Neighbouring rates differ by the share `rung`.
    pub(crate) fn cell(&self, motors: usize, baud: Baud, seeds: u64, rung: f64) -> Cell {
        let (from, to) = self.tried[motors - 1];
        // A slow line carries the plans of a fraction of the rate.
        let slowest = 1e3 * from / if baud == Baud::B1M { 3.0 } else { 30.0 };
        let up = |rate: &f64| Some(rate * (1.0 + rung));
        let rungs = std::iter::successors(Some(slowest), up).take_while(|rate| *rate < 1.3e3 * to);
        let rungs: Vec<f64> = rungs.collect();
        let mut why = String::new();
        let of = self.shape;
        let runs = fastest(&rungs, |rate| {
            let failed = (0..seeds).find_map(|seed| Some((seed, runs(of, motors, rate, seed, baud).err()?)));
            if let Some((seed, error)) = &failed {
                why = format!("{}, seed {seed}: {}", kilo(rate), error.lines().next().unwrap_or_default());
            }
            failed.is_none()
        });
        let accepted = fastest(&rungs, |rate| (0..seeds).all(|seed| is_accepted(of, motors, rate, seed, baud)));
        Cell { runs, accepted, why }
    }

    pub(crate) fn name(&self) -> String {
        self.shape.name()
    }
}
