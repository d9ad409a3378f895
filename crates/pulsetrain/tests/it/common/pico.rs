//! The Pico's figures: streams on the virtual Pico over its USB, every edge compared with its scheduled tick.

use pulsetrain_board::virtual_pico::VirtualPico;
use pulsetrain_board::{Board, Edge, Observer, Remote, ScheduledStep, Setup};
use pulsetrain_core::output::Sequence;
use pulsetrain_core::wire::message::{Cause, MotorSetup};
use pulsetrain_motion::drivers;
use pulsetrain_motion::program::DriverTiming;
use pulsetrain_session::lateness::{Lateness, Meter};
use pulsetrain_testkit::pico::{TICK_HZ, coils, pins_of, step_dir};
use pulsetrain_testkit::segments::{Chip, Law, Stream};

/// A driver's times.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Timing {
    pub(crate) driver: &'static str,
    pub(crate) ns: DriverTiming,
}

impl Timing {
    /// The times of a driver in the table; of coils, which need none.
    pub(crate) fn of(driver: &'static str) -> Timing {
        if driver == COILS {
            let ns = DriverTiming { pulse_high_ns: 0, pulse_low_ns: 0, dir_setup_ns: 0, dir_hold_ns: 0 };
            return Timing { driver, ns };
        }
        Timing { driver, ns: drivers::find(driver).expect("the table has it").timing() }
    }
}

/// Stands for a driver: coils with half steps.
pub(crate) const COILS: &str = "ULN2003";

/// A stream of random segments.
#[derive(Clone, Debug)]
pub(crate) struct Run {
    pub(crate) motors: usize,
    pub(crate) timing: Timing,
    pub(crate) chip: Chip,
    /// The law of each motor.
    pub(crate) law: Law,
    /// The distance of the motors' beginnings in intervals. 0: all step in the same ticks.
    pub(crate) apart: f64,
    pub(crate) seconds: f64,
    pub(crate) seed: u64,
}

/// A board's figures of a run.
#[derive(Clone, Debug)]
pub(crate) struct Seen {
    /// Bytes of segments over USB, for each step.
    pub(crate) bytes_per_step: f64,
    pub(crate) lateness: Lateness,
    /// Steps per second of the slowest motor, from its first edge to its last.
    pub(crate) rate: f64,
    /// Share of all cycles that the processor did not sleep.
    pub(crate) awake: f64,
    /// The least look-ahead of a motor when it was filled, ticks. 65 535 stands for that or more.
    pub(crate) least_ahead: u16,
    /// How far ahead the board was committed, ticks: the largest report.
    pub(crate) horizon_ticks: u64,
    /// Time between the first edges of motors that should begin together, ticks.
    pub(crate) skew_ticks: u64,
    /// Events of the board: faults, refusals. Empty if there are none.
    pub(crate) trouble: String,
}

/// GPIO 2/3, 4/5, … 16/17; of coils 2/3/4/5, …
fn motors(driver: &str, count: usize) -> Vec<MotorSetup> {
    let motor = |motor| if driver == COILS { coils(2 + 4 * motor, Sequence::Half) } else { step_dir(2 + 2 * motor) };
    (0..count as u8).map(motor).collect()
}

fn ticks_of(ns: u32) -> u16 {
    (u64::from(ns) * TICK_HZ).div_ceil(1_000_000_000) as u16
}

/// Watches the STEP lines, or the coils' lines: a half step is one edge.
struct Pulses {
    /// The motors' lines, on which each edge is a step, or each rising one.
    lines: Vec<Vec<u8>>,
    both_ways: bool,
    meter: Meter,
    /// First and last rising edge of each motor, and their number.
    edges: Vec<(u64, u64, u64)>,
    shortest: u64,
}

impl Observer for Pulses {
    fn edge(&mut self, edge: Edge) {
        let Some(motor) = self.lines.iter().position(|lines| lines.contains(&edge.line)) else { return };
        let (first, last, count) = &mut self.edges[motor];
        if edge.level || self.both_ways {
            self.meter.edge(motor, edge.tick);
            *first = if *count == 0 { edge.tick } else { *first };
            (*last, *count) = (edge.tick, *count + 1);
        } else if *count > 0 {
            self.shortest = self.shortest.min(edge.tick - *last);
        }
    }
    fn step(&mut self, _step: ScheduledStep) {}
}

/// Streams a run to a virtual Pico whose USB serial port is open.
///
/// # Errors
/// If the board refuses the set-up, before anything moves.
pub(crate) fn stream(pico: VirtualPico, run: &Run) -> Result<Seen, String> {
    let text = |error: pulsetrain_board::RemoteError| error.to_string();
    let setup = Setup {
        pulse_ticks: ticks_of(run.timing.ns.pulse_high_ns),
        setup_ticks: ticks_of(run.timing.ns.dir_setup_ns),
        hold_ticks: ticks_of(run.timing.ns.dir_hold_ns),
        motors: motors(run.timing.driver, run.motors),
        ..Setup::default()
    };
    let mut board = Remote::open(pico, 7).map_err(text)?;
    board.configure(&setup).map_err(text)?;
    let ticks = (run.seconds * TICK_HZ as f64) as u64;
    let mut stream = Stream::on(run.chip, &board, &vec![run.law; run.motors], run.apart, run.seed, ticks);
    let has_coils = run.timing.driver == COILS;
    let mut pulses = Pulses {
        lines: setup.motors.iter().map(|motor| if has_coils { pins_of(motor) } else { vec![motor.step_pin] }).collect(),
        both_ways: has_coils,
        meter: Meter::new(run.motors, 0),
        edges: vec![(0, 0, 0); run.motors],
        shortest: u64::MAX,
    };
    // The load is measured within the run.
    let (from, to) = (stream.begin + TICK_HZ / 50, stream.begin + ticks - TICK_HZ / 50);
    let (mut began, mut ended, mut horizon_ticks, mut least_ahead) = (None, None, 0, 0);
    let mark = |board: &Remote<VirtualPico>| {
        let chip = board.port().chip();
        (chip.cycle(), chip.asleep_cycles())
    };
    let trouble = stream.play(&mut board, &mut pulses, |stream, board| {
        if let Some(event) = board.events().iter().find(|event| event.cause != Cause::Finished) {
            let at = event.tick.saturating_sub(stream.begin) as f64 / TICK_HZ as f64;
            return Err(format!("{:?} ({}) after {at:.4} s", event.cause, event.detail));
        }
        if let Some(error) = board.error() {
            return Err(error.to_string());
        }
        if (from..to).contains(&board.now()) {
            horizon_ticks = horizon_ticks.max(board.horizon() - board.now());
            if began.is_none() {
                board.measures(true).map_err(|error| error.to_string())?;
                began = Some(mark(board));
            }
        }
        if board.now() >= to && ended.is_none() {
            ended = Some(mark(board));
            least_ahead = board.measures(false).map_err(|error| error.to_string())?.least_ahead_ticks;
        }
        Ok(())
    });
    let packed: usize = stream.sources.iter().map(|source| source.packed).sum();
    for (motor, source) in stream.sources.iter_mut().enumerate() {
        source.due.drain(..).for_each(|tick| pulses.meter.scheduled(motor, tick));
    }
    let mut trouble = trouble.err().unwrap_or_default();
    if trouble.is_empty() && pulses.shortest < u64::from(setup.pulse_ticks) {
        trouble = format!("a pulse of {} ticks", pulses.shortest);
    }
    let awake = match (began, ended) {
        (Some((cycle, asleep)), Some((now, slept))) => 1.0 - (slept - asleep) as f64 / (now - cycle) as f64,
        _ => 0.0,
    };
    let rate = |&(first, last, count): &(u64, u64, u64)| {
        if count < 2 { 0.0 } else { (count - 1) as f64 * TICK_HZ as f64 / (last - first) as f64 }
    };
    let firsts = || pulses.edges.iter().map(|(first, ..)| *first);
    let lateness = pulses.meter.finish();
    Ok(Seen {
        bytes_per_step: packed as f64 / lateness.edges.max(1) as f64,
        rate: pulses.edges.iter().map(rate).fold(f64::INFINITY, f64::min),
        skew_ticks: firsts().max().unwrap_or(0) - firsts().min().unwrap_or(0),
        lateness,
        awake,
        least_ahead,
        horizon_ticks,
        trouble,
    })
}

impl Seen {
    /// No step lost, none added, each on its tick, nothing reported.
    pub(crate) fn holds(&self) -> bool {
        let Lateness { min_ticks, max_ticks, lost, extra, .. } = self.lateness;
        self.trouble.is_empty() && (lost, extra, min_ticks, max_ticks) == (0, 0, 0, 0)
    }
}
