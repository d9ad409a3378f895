//! The Uno's figures: streams and motions on the virtual Uno, every edge compared with its scheduled tick.

use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Board, Edge, Observer, Remote, ScheduledStep};
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::Cause;
use pulsetrain_motion::boards::uno::PinKind;
use pulsetrain_motion::program;
use pulsetrain_session::lateness::{Lateness, Meter};
use pulsetrain_testkit::segments::{Law, Stream};
use pulsetrain_testkit::{TICK_HZ, uno_setup};

/// STEP and DIR of each motor.
pub(crate) type Pins = &'static [(u8, u8)];

/// The tutorial's pins.
pub(crate) const TUTORIAL: Pins = &[(8, 9)];
/// The CNC shield's X, Y and Z: port D; with A both ports.
pub(crate) const SHIELD: Pins = &[(2, 5), (3, 6), (4, 7), (12, 13)];
/// Three motors on port B.
pub(crate) const PORT_B: Pins = &[(8, 11), (9, 12), (10, 13)];
/// The compare hardware's pins.
pub(crate) const COMPARE: Pins = &[(9, 8), (10, 7)];

/// The kind of pins as the firmware classifies them.
pub(crate) fn kind_of(pins: &[(u8, u8)]) -> PinKind {
    let wirings: Vec<_> = pins
        .iter()
        .map(|&(step, dir)| program::Wiring::StepDir { step, dir, forward_high: true, enable: None })
        .collect();
    PinKind::of_wirings(wirings.iter().map(|wiring| ("motor", wiring))).expect("pins that work together")
}

/// Pins as tables have them.
pub(crate) fn pins_text(pins: &[(u8, u8)]) -> String {
    pins.iter().map(|(step, dir)| format!("{step}/{dir}")).collect::<Vec<_>>().join(" ")
}

/// A stream of random segments.
#[derive(Clone, Debug)]
pub(crate) struct Run {
    pub(crate) pins: &'static [(u8, u8)],
    /// One for each motor.
    pub(crate) laws: Vec<Law>,
    /// The distance of the motors' beginnings in intervals. 0: all step in the same ticks.
    pub(crate) apart: f64,
    pub(crate) pulse_ticks: u16,
    pub(crate) seconds: f64,
    pub(crate) seed: u64,
}

/// A board's figures of a run.
#[derive(Clone, Debug)]
pub(crate) struct Seen {
    pub(crate) lateness: Lateness,
    /// Steps per second of each motor, from its first edge to its last.
    pub(crate) rates: Vec<f64>,
    pub(crate) load: Load,
    /// How far ahead the board was committed, ticks: the largest report.
    pub(crate) horizon_ticks: u64,
    /// Bytes of all queues.
    pub(crate) queue_bytes: u16,
    /// Shortest pulse on the pins, ticks.
    pub(crate) shortest_pulse: u64,
    /// Bytes of stack that were never used.
    pub(crate) stack_left: u16,
    /// Longest time with interrupts off, cycles.
    pub(crate) masked_cycles: u64,
    /// Events of the board: faults, refusals. Empty if there are none.
    pub(crate) trouble: String,
}

/// The processor's time, as shares.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Load {
    /// Not asleep.
    pub(crate) awake: f64,
    /// Not asleep, without the idle part of each round of the main loop.
    pub(crate) busy: f64,
}

/// Cycles and rounds of the main loop so far.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Mark {
    cycle: u64,
    asleep: u64,
    rounds: u64,
}

impl Mark {
    /// The counts now. The board is not asked, since that would take its time: it feeds the watchdog once in each
    /// round.
    pub(crate) fn of(uno: &VirtualUno) -> Mark {
        let chip = uno.chip();
        Mark { cycle: chip.cycle(), asleep: chip.asleep_cycles(), rounds: chip.watchdog_feeds() }
    }

    /// Cycles awake, all cycles, and rounds since then.
    fn since(self, earlier: Mark) -> (f64, f64, f64) {
        let all = (self.cycle - earlier.cycle) as f64;
        let asleep = (self.asleep - earlier.asleep) as f64;
        (all - asleep, all, (self.rounds - earlier.rounds) as f64)
    }

    /// The load since `earlier`, if a round with nothing to do takes `idle_round` cycles.
    pub(crate) fn load(self, earlier: Mark, idle_round: u64) -> Load {
        let (awake, all, rounds) = self.since(earlier);
        Load { awake: awake / all, busy: (awake - rounds * idle_round as f64).max(0.0) / all }
    }
}

/// Cycles awake of the shortest round of the main loop in the next 50 ms: a round with nothing to do. A round begins
/// with feeding the watchdog. The measurement does not disturb the chip.
pub(crate) fn idle_round(uno: &VirtualUno) -> u64 {
    let mut chip = uno.chip().clone();
    let (end, mut began, mut shortest) = (chip.cycle() + TICK_HZ / 20, None, u64::MAX);
    while chip.cycle() < end {
        let rounds = chip.watchdog_feeds();
        chip.step(&mut ());
        if chip.watchdog_feeds() != rounds {
            let awake = chip.cycle() - chip.asleep_cycles();
            shortest = shortest.min(began.replace(awake).map_or(u64::MAX, |began: u64| awake - began));
        }
    }
    if shortest == u64::MAX { 0 } else { shortest }
}

/// Watches the STEP lines.
struct Pulses<'a> {
    pins: &'a [(u8, u8)],
    meter: Meter,
    /// First and last rising edge of each motor, and their number.
    edges: Vec<(u64, u64, u64)>,
    shortest: u64,
}

impl Observer for Pulses<'_> {
    fn edge(&mut self, edge: Edge) {
        let Some(motor) = self.pins.iter().position(|(step, _)| *step == edge.line) else { return };
        let (first, last, count) = &mut self.edges[motor];
        if edge.level {
            self.meter.edge(motor, edge.tick);
            *first = if *count == 0 { edge.tick } else { *first };
            (*last, *count) = (edge.tick, *count + 1);
        } else if *count > 0 {
            self.shortest = self.shortest.min(edge.tick - *last);
        }
    }
    fn step(&mut self, _step: ScheduledStep) {}
}

/// An Uno at 1 Mbaud with motors on `pins`, and the length of an idle round of its main loop, cycles.
pub(crate) fn connect(pins: &[(u8, u8)], pulse_ticks: u16) -> Result<(Remote<VirtualUno>, u64), String> {
    let text = |error: pulsetrain_board::RemoteError| error.to_string();
    let mut board = Remote::open(VirtualUno::new(), 7).map_err(text)?;
    board.set_baud(Baud::B1M).map_err(text)?;
    board.configure(&uno_setup(pins, pulse_ticks)).map_err(text)?;
    let idle_round = idle_round(board.port());
    Ok((board, idle_round))
}

/// Streams a run to a virtual Uno.
///
/// # Errors
/// If the board refuses the set-up, before anything moves.
pub(crate) fn stream(run: &Run) -> Result<Seen, String> {
    let pins = &run.pins[..run.laws.len()];
    let (mut board, idle_round) = connect(pins, run.pulse_ticks)?;
    let mut stream = Stream::new(&board, &run.laws, run.apart, run.seed, (run.seconds * TICK_HZ as f64) as u64);
    let mut pulses = Pulses {
        pins,
        meter: Meter::new(pins.len(), kind_of(pins).constant_ticks().into()),
        edges: vec![(0, 0, 0); pins.len()],
        shortest: u64::MAX,
    };
    let (mut began, mut ended, mut horizon_ticks) = (None, None, 0);
    // The load is measured within the run.
    let from = stream.begin + TICK_HZ / 50;
    let to = stream.begin + (run.seconds * TICK_HZ as f64) as u64 - TICK_HZ / 50;
    board.port_mut().chip_mut().forget_masked();
    let mut scheduled = vec![Vec::new(); pins.len()];
    let trouble = stream.play(&mut board, &mut pulses, |stream, board| {
        for (source, scheduled) in stream.sources.iter_mut().zip(&mut scheduled) {
            scheduled.extend(source.due.drain(..));
        }
        if let Some(event) = board.events().iter().find(|event| event.cause != Cause::Finished) {
            let at = event.tick.saturating_sub(stream.begin) as f64 / TICK_HZ as f64;
            return Err(format!("{:?} ({}) after {at:.3} s", event.cause, event.detail));
        }
        if let Some(error) = board.error() {
            return Err(error.to_string());
        }
        if (from..to).contains(&board.now()) {
            horizon_ticks = horizon_ticks.max(board.horizon() - board.now());
            if began.is_none() {
                began = Some(Mark::of(board.port()));
            }
        }
        if board.now() >= to && ended.is_none() {
            ended = Some(Mark::of(board.port()));
        }
        Ok(())
    });
    for (motor, ticks) in scheduled.iter().enumerate() {
        ticks.iter().for_each(|tick| pulses.meter.scheduled(motor, *tick));
    }
    let mut trouble = trouble.err().unwrap_or_default();
    if trouble.is_empty() && pulses.shortest < u64::from(run.pulse_ticks) {
        trouble = format!("a pulse of {} ticks", pulses.shortest);
    }
    let load = match (began, ended) {
        (Some(began), Some(ended)) => ended.load(began, idle_round),
        _ => Load::default(),
    };
    let rate = |&(first, last, count): &(u64, u64, u64)| {
        if count < 2 { 0.0 } else { (count - 1) as f64 * TICK_HZ as f64 / (last - first) as f64 }
    };
    let stack_left = board.measures(false).map_or(0, |measures| measures.stack_left);
    let masked_cycles = board.port().chip().longest_masked().cycles;
    let rates = pulses.edges.iter().map(rate).collect();
    let (lateness, shortest_pulse) = (pulses.meter.finish(), pulses.shortest);
    let queue_bytes = board.info().pool;
    Ok(Seen { queue_bytes, lateness, rates, load, horizon_ticks, shortest_pulse, stack_left, masked_cycles, trouble })
}

/// 99 of 100 edges may be this late, cycles.
pub(crate) const P99_CYCLES: i64 = 40;
/// No edge may be later than this, cycles.
pub(crate) const MOST_CYCLES: i64 = 60;

impl Seen {
    /// Whether no bound broke: no step is lost or added, no edge too late or early, and the board reports no event.
    pub(crate) fn holds(&self) -> bool {
        let Lateness { min_ticks, p99_ticks, max_ticks, lost, extra, .. } = self.lateness;
        self.trouble.is_empty()
            && (lost, extra) == (0, 0)
            && p99_ticks <= P99_CYCLES
            && max_ticks <= MOST_CYCLES
            && min_ticks >= -MOST_CYCLES
    }
}
