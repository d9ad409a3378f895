//! `pulsetrain bench`: a board measures itself while it steps.

use crate::arguments::At;
use clap::Args;
use miette::miette;
use pulsetrain_board::BoardKind;
use pulsetrain_board::profiles::Role;
use pulsetrain_board::remote::in_words;
use pulsetrain_board::{Board, Edge, Observer, Port, Remote, ScheduledStep, Serial, WithReference};
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::{Cause, Measures};
use pulsetrain_motion::boards::BoardProfile;
use pulsetrain_motion::program::{DriverTiming, Limits, Motor, Program, Scale, Tolerance, Wiring};
use pulsetrain_motion::{Grid, Law, Time, boards};
use schemars::JsonSchema;
use serde::Serialize;

use super::problems::{drive_problem, port_problem, virtual_board};
use crate::console::{Console, Exit};
use pulsetrain_motion::human::{self, Table};
use pulsetrain_session::drive::{DriveError, Driven, session_number};
use pulsetrain_session::lateness::Lateness;
use pulsetrain_session::prepare::Prepared;

#[derive(Args, Debug)]
#[command(after_help = "\
The board steps sinusoids of growing speed on pins 8 (STEP) and 9 (DIR). Disconnect the drivers of a real board first.

Examples:
  pulsetrain bench --board uno
  pulsetrain bench --board pico
  pulsetrain bench --port /dev/ttyACM0 --disconnected")]
pub(crate) struct BenchArgs {
    #[command(flatten)]
    pub(crate) at: At,
    /// Confirms that nothing on pins 8 and 9 can be harmed by a motion
    #[arg(long)]
    pub(crate) disconnected: bool,
}

/// Periods of the sinusoids, s.
const PERIODS_S: [f64; 4] = [2.0, 1.0, 0.5, 0.25];
const STEP_PIN: u8 = 8;
const DIR_PIN: u8 = 9;

/// The figures of one sinusoid.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct BenchRow {
    /// The sinusoid's period, s.
    period_s: f64,
    /// Its highest step rate, steps/s.
    peak_steps_per_s: f64,
    /// Its steps.
    steps: u64,
    /// Share of the time that the processor was awake.
    busy: f64,
    /// Processor cycles for each step; they include receiving.
    cycles_per_step: f64,
    /// Only of an Uno: a Pico's hardware has no compares to miss.
    compares_missed: Option<u16>,
    /// How late the latest of them was, ticks.
    latest_ticks: Option<u16>,
    /// How many times the step generator had nothing ready.
    starved: u16,
    /// How far ahead of its edges the step generator was at least, ticks.
    least_ahead_ticks: u16,
    /// The longest round of the firmware's loop, ticks.
    longest_round_ticks: u16,
    /// The most bytes that waited to be read.
    most_unread_bytes: u16,
    /// Least free memory of its stack, bytes.
    stack_left_bytes: u16,
    /// Events that the board reported by itself, in words, without the one that the motion is over.
    events: Vec<&'static str>,
    /// Seen on the pins: only of a virtual board.
    pins: Option<Lateness>,
}

impl BenchRow {
    /// The faults of this run, in words. A board that works has none.
    fn trouble(&self) -> Vec<String> {
        let counts = [
            (self.pins.as_ref().map_or(0, |pins| pins.lost), "steps without an edge"),
            (self.pins.as_ref().map_or(0, |pins| pins.extra), "edges without a step"),
            (self.compares_missed.map_or(0, u64::from), "compares missed"),
            (self.starved.into(), "times starved"),
        ];
        let counted = counts.into_iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}"));
        // A board without compares makes each edge exactly in its tick.
        let timed = self.pins.as_ref().filter(|_| self.compares_missed.is_none());
        let off = timed.map(|pins| pins.max_ticks.max(-pins.min_ticks)).filter(|ticks| *ticks > 0);
        let off = off.map(|ticks| format!("an edge {ticks} cycles off its tick"));
        counted.chain(off).chain(self.events.iter().map(|event| format!("it said: {event}"))).collect()
    }
}

/// A sinusoid's name in the output.
fn name(period_s: f64) -> String {
    format!("a sinusoid of {period_s} s")
}

/// The whole report.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Rows {
    /// A row for each sinusoid.
    measured: Vec<BenchRow>,
    /// The sinusoids that the board cannot play, and why.
    refused: Vec<String>,
    /// Steps lost, and the other faults of all runs.
    trouble: Vec<String>,
}

pub(crate) fn run(args: &BenchArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    let kind = match &args.at.port {
        Some(_) if !args.disconnected => {
            let help = "switch the drivers' supply off, or take the wires off, and say --disconnected";
            return Err(miette!(help = help, "this steps pin {STEP_PIN} and turns pin {DIR_PIN}"));
        }
        Some(name) => kind_of(Serial::open(name, false).map_err(port_problem)?)?,
        None => args.at.board.unwrap_or_default(),
    };
    let amplitude = kind.profile().bench_steps;
    let limits = boards::find(kind.name()).ok_or_else(|| miette!("the table of boards lacks the board"))?;
    let mut rows = Vec::new();
    // Which sinusoids the board cannot play, and why.
    let mut refused = Vec::new();
    for period_s in PERIODS_S {
        let prepared = prepared(limits, amplitude, period_s)?;
        let measured = match &args.at.port {
            Some(name) => {
                let port = Serial::open(name, false).map_err(port_problem)?;
                measure(&prepared, (amplitude, period_s), port, args.at.baud).map(|row| BenchRow { pins: None, ..row })
            }
            None => measure(&prepared, (amplitude, period_s), virtual_board(kind, Role::Plans)?, args.at.baud),
        };
        let counts = kind.counts_missed_compares();
        let measured = measured
            .map(|row| if counts { row } else { BenchRow { compares_missed: None, latest_ticks: None, ..row } });
        match measured {
            Ok(row) => rows.push(row),
            Err(
                error @ (DriveError::Session(_)
                | DriveError::Plan { .. }
                | DriveError::TooLate { .. }
                | DriveError::QueueTooShort { .. }),
            ) => {
                refused.push(format!("{}: {error}", prepared.file));
            }
            Err(error) => return Err(drive_problem(error)),
        }
    }
    let troubles = rows.iter().flat_map(|row| row.trouble().into_iter().map(|what| (row.period_s, what)));
    let trouble: Vec<String> = troubles.map(|(period_s, what)| format!("{}: {what}", name(period_s))).collect();
    let exit = if refused.is_empty() && trouble.is_empty() { Exit::Success } else { Exit::BoundBroken };
    if args.at.json {
        console.print_json(&Rows { measured: rows, refused, trouble })?;
        return Ok(exit);
    }
    let (title, baud) = (kind.title(), human::count(args.at.baud.rate().into()));
    let has_usb = limits.line.is_some_and(|line| line.usb_bytes_per_s.is_some());
    let way = match &args.at.port {
        Some(name) if has_usb => format!("streamed to the {title} at {name}"),
        None if has_usb => format!("streamed over USB to the virtual {title}"),
        Some(name) => format!("streamed at {baud} baud to the {title} at {name}"),
        None => format!("streamed at {baud} baud to the virtual {title}"),
    };
    console.print(format_args!(
        "Sinusoids of {amplitude} steps to either side, STEP on {STEP_PIN}, DIR on {DIR_PIN}, 1 µs pulses, {way}.\nThe board's own \
         word:\n\n",
    ))?;
    let mut table = Table::new([
        "fastest",
        "steps",
        "awake",
        "cycles/step",
        "missed",
        "latest",
        "starved",
        "least ahead",
        "longest round",
    ]);
    let tick_s = 1.0 / limits.tick_hz as f64;
    // A counter that is full only says that the time was at least this long.
    let ticks = |ticks: u16| {
        let time = human::seconds(f64::from(ticks) * tick_s);
        if ticks == u16::MAX { format!("≥ {time}") } else { time }
    };
    let or_dash = |text: Option<String>| text.unwrap_or_else(|| "–".to_owned());
    for row in &rows {
        table.row([
            human::scaled(row.peak_steps_per_s, "steps/s"),
            human::count(row.steps.into()),
            format!("{} %", human::significant(100.0 * row.busy, 2)),
            human::significant(row.cycles_per_step, 3),
            or_dash(row.compares_missed.map(|missed| missed.to_string())),
            or_dash(row.latest_ticks.map(ticks)),
            row.starved.to_string(),
            ticks(row.least_ahead_ticks),
            ticks(row.longest_round_ticks),
        ]);
    }
    console.print(&table)?;
    if args.at.port.is_none() {
        console.print("\nOn its pins, lateness beyond the board's constant, cycles:\n\n")?;
        let mut table = Table::new(["fastest", "half of them", "99 %", "all", "lost"]);
        for (row, pins) in rows.iter().filter_map(|row| Some((row, row.pins.as_ref()?))) {
            table.row([
                human::scaled(row.peak_steps_per_s, "steps/s"),
                format!("≤ {}", pins.p50_ticks),
                format!("≤ {}", pins.p99_ticks),
                format!("≤ {}", pins.max_ticks),
                pins.lost.to_string(),
            ]);
        }
        console.print(&table)?;
    }
    for why in refused {
        console.print(format_args!("\n  not made: {why}\n"))?;
    }
    for what in trouble {
        console.print(format_args!("\n  trouble: {what}\n"))?;
    }
    Ok(exit)
}

/// Which board is at a port, by its clock, as its firmware says.
fn kind_of(port: impl Port) -> miette::Result<BoardKind> {
    let remote = Remote::open(port, session_number()).map_err(|error| drive_problem(error.into()))?;
    let tick_hz = u64::from(remote.info().tick_hz);
    remote.close();
    let has_clock = |kind: &BoardKind| boards::find(kind.name()).is_some_and(|limits| limits.tick_hz == tick_hz);
    BoardKind::ALL.into_iter().find(has_clock).ok_or_else(|| {
        let names = BoardKind::ALL.map(|kind| kind.profile().title_with_article).join(" nor ");
        miette!("the board has a clock of {tick_hz} Hz: it is neither {names}")
    })
}

/// One sinusoid's motion for the board.
fn prepared(board: &'static BoardProfile, amplitude: f64, period_s: f64) -> miette::Result<Prepared> {
    let board = board.limits();
    let law = Law::sine(amplitude, Time::from_seconds(period_s), Some(1)).map_err(|error| miette!("{error}"))?;
    let motor = Motor {
        name: "bench".to_owned(),
        law,
        wiring: Wiring::StepDir { step: STEP_PIN, dir: DIR_PIN, forward_high: true, enable: None },
        timing: DriverTiming { pulse_high_ns: 1000, pulse_low_ns: 1000, dir_setup_ns: 500, dir_hold_ns: 500 },
        limits: Limits { max_speed: None, max_acceleration: None, pull_in: 1000.0 },
        scale: Scale { unit: "step".to_owned(), steps_per_unit: 1.0, steps_per_rev: 200.0 },
        winding: None,
        driver: None,
    };
    let program = Program {
        board,
        grid: Grid::REACH,
        tolerance: Tolerance::Seconds(1e-6),
        idle_ms: None,
        motors: vec![motor],
        machines: Vec::new(),
        queue_parts: Vec::new(),
    };
    Ok(Prepared {
        file: name(period_s),
        program,
        cut: None,
        pause: None,
        line: None,
        tables: Vec::new(),
        recordings: Vec::new(),
    })
}

fn measure<P: Port>(
    prepared: &Prepared,
    (amplitude, period_s): (f64, f64),
    port: P,
    baud: Baud,
) -> Result<BenchRow, DriveError> {
    let mut driven = Driven::at(prepared, port, baud)?;
    let row = measured(&mut driven, amplitude, period_s);
    driven.close();
    row
}

fn measured<P: Port>(
    driven: &mut Driven<WithReference<Remote<P>>>,
    amplitude: f64,
    period_s: f64,
) -> Result<BenchRow, DriveError> {
    driven.board_mut().measures(true)?;
    let began = driven.board_mut().now();
    let mut steps = Steps(0);
    driven.run(&mut steps, |_| {})?;
    let (steps, pins) = (steps.0, driven.lateness());
    let board = driven.board_mut();
    let span = (board.now() - began) as f64;
    let said: Measures = board.measures(false)?;
    let events = board.events().into_iter().filter(|event| event.cause != Cause::Finished);
    let events = events.map(|event| in_words(event.cause)).collect();
    let awake = (span - said.idle_ticks as f64).max(0.0);
    Ok(BenchRow {
        period_s,
        peak_steps_per_s: std::f64::consts::TAU * amplitude / period_s,
        steps,
        busy: awake / span,
        cycles_per_step: awake / steps.max(1) as f64,
        compares_missed: Some(said.late),
        latest_ticks: Some(said.latest_ticks),
        starved: said.starved,
        least_ahead_ticks: said.least_ahead_ticks,
        longest_round_ticks: said.longest_round_ticks,
        most_unread_bytes: said.most_unread,
        stack_left_bytes: said.stack_left,
        events,
        pins,
    })
}

/// Counts scheduled steps.
struct Steps(u64);

impl Observer for Steps {
    fn edge(&mut self, _: Edge) {}

    fn step(&mut self, _: ScheduledStep) {
        self.0 += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pulsetrain_board::profiles::{PICO, UNO};
    use pulsetrain_board::virtual_pico::VirtualPico;
    use pulsetrain_board::virtual_uno::VirtualUno;
    use pulsetrain_board::{PortError, Setup};
    use pulsetrain_core::verbs::Verb;
    use pulsetrain_core::wire::message::MotorSetup;
    use std::time::Duration;

    /// A Pico of which one edge is not seen.
    struct Blink {
        pico: VirtualPico,
        /// Edges of STEP before the missing one.
        edges: usize,
    }

    impl Port for Blink {
        fn now(&self) -> Duration {
            self.pico.now()
        }
        fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
            self.pico.send(bytes)
        }
        fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
            self.pico.receive(until, into)
        }
        fn set_baud(&mut self, baud: Baud) -> Result<(), PortError> {
            self.pico.set_baud(baud)
        }
        fn edges(&mut self, into: &mut Vec<Edge>) {
            self.pico.edges(into);
            into.retain(|edge| {
                let rises = edge.line == STEP_PIN && edge.level;
                let seen = !rises || self.edges != 0;
                self.edges = self.edges.wrapping_sub(usize::from(rises));
                seen
            });
        }
    }

    /// Tests that run firmware on an emulated chip.
    mod chips {
        use super::*;

        #[test]
        fn a_board_at_a_port_says_what_it_is() {
            assert_eq!(kind_of(VirtualPico::on_usb()).unwrap(), BoardKind::of(&PICO));
            assert_eq!(kind_of(VirtualUno::new()).unwrap(), BoardKind::of(&UNO));
        }

        #[test]
        fn a_step_that_is_lost_is_trouble() {
            let (steps, period_s) = (100.0, 0.5);
            let prepared = prepared(&boards::PICO, steps, period_s).unwrap();
            let troubles = |edges| {
                let port = Blink { pico: VirtualPico::on_usb(), edges };
                measure(&prepared, (steps, period_s), port, Baud::B2M).unwrap().trouble()
            };
            assert_eq!(troubles(usize::MAX), Vec::<String>::new());
            assert_eq!(troubles(42), ["1 steps without an edge"]);
        }

        #[test]
        fn what_a_board_reports_is_trouble() {
            let prepared = prepared(&boards::UNO, 100.0, 0.5).unwrap();
            let row = measure(&prepared, (100.0, 0.5), VirtualUno::new(), Baud::B1M).unwrap();
            assert_eq!(row.trouble(), Vec::<String>::new());
            let events = vec![in_words(Cause::EdgeLate)];
            let row = BenchRow { compares_missed: Some(2), starved: 1, events, pins: None, ..row };
            assert_eq!(row.trouble(), ["2 compares missed", "1 times starved", "it said: an edge was late"]);
        }

        /// The board reports the end of an earlier host's move when this host connects.
        #[test]
        fn what_was_told_before_is_no_trouble() {
            let driver = MotorSetup { step_pin: 2, dir_pin: 3, ..MotorSetup::default() };
            let setup = Setup { pulse_ticks: 250, motors: vec![driver], ..Setup::default() };
            let mut host = Remote::open(VirtualPico::on_usb(), 1).unwrap();
            host.configure(&setup).unwrap();
            let period = u64::from(host.info().tick_hz) / 1000;
            host.tell_motors(&[(0, Verb::Speed { ticks: period }), (0, Verb::Move { steps: 3 })]).unwrap();
            let mut port = host.close();
            let until = port.now() + Duration::from_millis(100);
            while port.now() < until {
                port.receive(until, &mut Vec::new()).unwrap();
            }
            let row = measure(&prepared(&boards::PICO, 100.0, 0.5).unwrap(), (100.0, 0.5), port, Baud::B2M).unwrap();
            assert_eq!(row.trouble(), Vec::<String>::new());
        }
    }
}
