//! Sessions with queues as small as an Uno's: what can be streamed through them, and how much time is left.

use pulsetrain::load;
use pulsetrain_board::lease::{ExtendRefused, Lease, LeaseState, Leased, TrimRefused};
use pulsetrain_board::{
    Board, Edge, Faults, Observer, Port, PortError, Remote, RemoteError, Setup, Sizer, StopReport, SwitchRefused,
};
use pulsetrain_core::braking::Limit;
use pulsetrain_core::packing::{MAX_PACKED_LEN, Packing, State};
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::{Event, MotorSetup};
use pulsetrain_core::{Entry, Epoch, Item, RegisterWidths, Segment};
use pulsetrain_motion::program::{self, DriverTiming, Limits, Motor, Program, Scale, Tolerance};
use pulsetrain_motion::{Grid, Law, Time, boards};
use pulsetrain_session::{Session, SessionError};
use pulsetrain_testkit::model::ModelPort;
use std::time::Duration;

const TICK_HZ: u64 = 16_000_000;
/// Bytes that an Uno can hold unread.
const WINDOW: u16 = 127;
const TIMING: DriverTiming =
    DriverTiming { pulse_high_ns: 1000, pulse_low_ns: 1000, dir_setup_ns: 500, dir_hold_ns: 500 };

/// A line that counts the bytes to the board.
struct Counting {
    port: ModelPort,
    bytes: u64,
}

impl Port for Counting {
    fn now(&self) -> Duration {
        self.port.now()
    }
    fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
        self.bytes += bytes.len() as u64;
        self.port.send(bytes)
    }
    fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
        self.port.receive(until, into)
    }
    fn set_baud(&mut self, baud: Baud) -> Result<(), PortError> {
        self.port.set_baud(baud)
    }
    fn edges(&mut self, into: &mut Vec<Edge>) {
        self.port.edges(into);
    }
}

/// A board that records how far ahead its lease reaches, and the segments that it gets.
struct Watched<P> {
    board: Remote<P>,
    /// This many bytes of each motor's queue are reported as missing.
    missing: usize,
    extensions: usize,
    /// The least that is left of a lease, ticks, from its second extension on.
    least_ahead: u64,
    /// All segments of motor 0.
    told: Vec<Entry>,
}

impl<P: Port> Watched<P> {
    fn new(board: Remote<P>) -> Watched<P> {
        Watched { board, missing: 0, extensions: 0, least_ahead: u64::MAX, told: Vec::new() }
    }

    /// Records what is left of the lease.
    fn look(&mut self) {
        if self.extensions > 1
            && let LeaseState::Until(until) = self.board.lease()
        {
            self.least_ahead = self.least_ahead.min(until.saturating_sub(self.board.now()));
        }
    }
}

impl<P: Port> Board for Watched<P> {
    fn push(&mut self, motor: usize, entry: Entry) -> Result<(), Entry> {
        self.board.push(motor, entry)?;
        if motor == 0 {
            self.told.push(entry);
        }
        Ok(())
    }
    fn discard(&mut self, epoch: Epoch) {
        self.board.discard(epoch);
    }
    fn room(&self, motor: usize) -> usize {
        self.board.room(motor).saturating_sub(self.missing)
    }
    fn sizer(&self, motor: usize) -> Sizer {
        self.board.sizer(motor)
    }
    fn round_trip(&self) -> u64 {
        self.board.round_trip()
    }
    fn horizon(&self) -> u64 {
        self.board.horizon()
    }
    fn now(&self) -> u64 {
        self.board.now()
    }
    fn epoch(&self) -> Epoch {
        self.board.epoch()
    }
    fn advance(&mut self, until: u64, observer: &mut impl Observer) {
        self.board.advance(until, observer);
        self.look();
    }
    fn stop_now(&mut self, tick: u64, observer: &mut impl Observer) -> StopReport {
        self.board.stop_now(tick, observer)
    }
    fn positions(&self) -> Vec<i64> {
        self.board.positions()
    }
    fn is_idle(&self) -> bool {
        self.board.is_idle()
    }
    fn faults(&self, motor: usize) -> Faults {
        self.board.faults(motor)
    }
    fn events(&mut self) -> Vec<Event> {
        self.board.events()
    }
    fn lost(&self) -> Option<&RemoteError> {
        self.board.lost()
    }
}

impl<P: Port> Leased for Watched<P> {
    fn switch(&mut self, epoch: Epoch, tick: u64, lease: Lease, limits: &[Limit]) -> Result<(), SwitchRefused> {
        self.board.switch(epoch, tick, lease, limits)
    }
    fn extend(&mut self, lease: Lease, limits: &[Limit]) -> Result<(), ExtendRefused> {
        self.extensions += 1;
        self.board.extend(lease, limits)
    }
    fn trim(&mut self, until: u64, items: &[usize]) -> Result<(), TrimRefused> {
        self.board.trim(until, items)
    }
    fn brake(&mut self) -> Option<u64> {
        self.board.brake()
    }
    fn lease(&self) -> LeaseState {
        self.board.lease()
    }
    fn extended(&mut self) -> Option<bool> {
        self.board.extended()
    }
}

fn program(laws: Vec<Law>, acceleration: f64) -> Program {
    let board = program::BoardLimits {
        profile: &boards::NATIVE,
        name: "model".into(),
        tick_hz: TICK_HZ,
        registers: RegisterWidths::NARROW,
        max_motors: 4,
        min_interval_ticks: vec![80],
        hardware_timed: true,
        turn_ticks: 0,
        one_timing: false,
        shared_steps: None,
        segment_ticks: Vec::new(),
    };
    let motor = |(index, law)| Motor {
        name: format!("m{index}"),
        law,
        wiring: program::Wiring::StepDir { step: index, dir: 16 + index, forward_high: true, enable: None },
        timing: DriverTiming { pulse_high_ns: 1000, pulse_low_ns: 1000, ..TIMING },
        limits: Limits { max_speed: None, max_acceleration: Some(acceleration), pull_in: 200.0 },
        scale: Scale { unit: "rev".into(), steps_per_unit: 200.0, steps_per_rev: 200.0 },
        winding: None,
        driver: None,
    };
    let motors = (0..).zip(laws).map(motor).collect();
    Program {
        board,
        grid: Grid::NEAREST,
        tolerance: Tolerance::Ticks(1.0),
        idle_ms: None,
        motors,
        machines: Vec::new(),
        queue_parts: Vec::new(),
    }
}

/// The result of a run.
#[derive(Debug)]
struct Figures {
    seconds: f64,
    steps: u64,
    extensions: usize,
    refused: Option<SessionError>,
    /// The least that was left of the lease, s.
    ahead_s: f64,
    bytes_per_s: f64,
    /// Bytes of the plan of motor 0.
    steps_per_segment: f64,
    bytes_per_step: f64,
}

/// Streams for `seconds`, or to the end, through `queue` bytes for each motor at 1 Mbaud.
fn stream(program: &Program, queue: u16, seconds: f64) -> Figures {
    let motors = program.motors.len() as u8;
    let port = Counting { port: ModelPort::with_memory(queue * u16::from(motors), WINDOW), bytes: 0 };
    let mut remote = Remote::open(port, 7).unwrap();
    assert_eq!(remote.set_baud(Baud::B1M), Ok(Baud::B1M));
    let motor = |index| MotorSetup {
        step_pin: index,
        dir_pin: 16 + index,
        forward_high: true,
        pull_in_ticks: 80_000,
        ..MotorSetup::default()
    };
    let motors = (0..motors).map(motor).collect();
    remote.configure(&Setup { pulse_ticks: 16, setup_ticks: 8, motors, ..Setup::default() }).unwrap();
    let before = remote.port().bytes;
    let board = Watched::new(remote);
    let mut steps = 0;
    let mut observer = |edge: Edge| steps += u64::from(edge.level && edge.line < 16);
    let mut session = match Session::new(board, program.clone()) {
        Ok(session) => session,
        Err(error) => panic!("{error}"),
    };
    let until = session.zero() + (seconds * TICK_HZ as f64) as u64;
    let mut refused = session.advance(until, &mut observer).err();
    if !session.is_complete() {
        refused = refused.or(session.stop().err());
    }
    let ran = session.board().now() - session.zero();
    let bytes = session.board().board.port().bytes - before;
    let report = session.run(&mut observer, |_| {});
    assert_eq!(report.counted, report.replayed);
    assert!(report.faults.iter().all(|faults| *faults == Faults::default()), "{:?}", report.faults);
    check_narrow(&session.board().told);
    let certificate = session.certificate(0);
    let board = session.board();
    let seconds = ran.min(report.last_step - report.zero) as f64 / TICK_HZ as f64;
    Figures {
        seconds,
        steps,
        extensions: board.extensions,
        refused: refused.or(report.failure),
        ahead_s: board.least_ahead as f64 / TICK_HZ as f64,
        bytes_per_s: bytes as f64 / seconds,
        steps_per_segment: certificate.steps as f64 / certificate.segments as f64,
        bytes_per_step: certificate.bytes as f64 / certificate.steps as f64,
    }
}

/// Each epoch fits the registers of an 8-bit board ([`pulsetrain_core::avr`]).
fn check_narrow(told: &[Entry]) {
    for epoch in told.chunk_by(|_, next| !matches!(next.item, Item::Anchor { .. })) {
        let packing = Packing { fraction_bits: 16, gain: 0 };
        let (mut state, mut board) = (State::default(), State::default());
        for Entry { item, .. } in epoch {
            let mut bytes = [0; MAX_PACKED_LEN];
            let len = packing.pack(&mut state, item, &mut bytes).unwrap();
            let Some(Item::Run { segment, .. }) = packing.unpack(&mut board, &mut &bytes[..len]).unwrap() else {
                continue;
            };
            assert!(segment.count <= u16::MAX.into(), "{segment:?}");
            for done in 0..segment.count {
                let Segment { interval, add, add2, .. } = segment.after(done);
                let fits = i32::try_from(add).is_ok() && i32::try_from(add2).is_ok();
                assert!(fits && (1..1 << 40).contains(&interval), "{segment:?} after {done} steps: {epoch:?}");
            }
        }
    }
}

/// The registers for motors without known limits.
fn unlimited(mut program: Program) -> Program {
    program.motors.iter_mut().for_each(|motor| motor.limits = Limits { pull_in: 1000.0, ..Limits::default() });
    Program { grid: Grid::REACH, ..program }
}

/// The tutorial's sine.
fn tutorial(seconds: f64, cycles: u64) -> Program {
    let omega = std::f64::consts::TAU / seconds;
    program(vec![Law::sine(2000.0, Time::from_seconds(seconds), Some(cycles)).unwrap()], 2000.0 * omega * omega)
}

/// Motors at about `rate` steps/s that change their speed all the time, each with its own period.
fn changing(motors: u8, rate: f64, omega: f64) -> Program {
    let law = |index: u8| {
        let (swing, omega) = (0.05 * rate, omega + 7.0 * f64::from(index));
        // From rest to its speed within some 0.3 s, then up and down by a twentieth.
        let text =
            format!("{}*(t - (1 - exp(-8*t))/8) + {}*(1 - exp(-8*t))*(1 - cos({omega}*t))", 0.95 * rate, swing / omega);
        Law::formula(&text, &[], 1.0, None).unwrap()
    };
    program((0..motors).map(law).collect(), (8.0 + 0.06 * omega) * rate)
}

/// Motions and an Uno's queues, bytes for each motor, and how long to run, s.
fn motions() -> [(&'static str, Program, u16, f64); 7] {
    [
        ("tutorial, T = 10 s", unlimited(tutorial(10.0, 1)), 692, 12.0),
        ("tutorial, T = 1 s", tutorial(1.0, 2), 800, 3.0),
        ("tutorial, T = 0.8 s", tutorial(0.8, 2), 800, 3.0),
        ("tutorial, T = 0.1 s", tutorial(0.1, 10), 800, 3.0),
        ("2 at 80 k", changing(2, 80e3, 900.0), 280, 1.0),
        ("3 at 38 k", changing(3, 38e3, 500.0), 190, 1.0),
        ("4 at 28 k", changing(4, 28e3, 350.0), 140, 1.0),
    ]
}

/// `cargo test -p pulsetrain --test it small_queues:: -- --nocapture` prints the figures.
#[test]
fn what_an_uno_is_to_do_streams_through_its_queues() {
    for (what, program, queue, seconds) in motions() {
        let figures = stream(&program, queue, seconds);
        let per_second = |count: f64| count / figures.seconds;
        println!(
            "{what}, {queue} bytes a motor: {:.0} steps/s, {:.0} steps a segment, {:.3} bytes a step; {:.1} extensions/s, \
             {:.1} ms to spare, {:.0} bytes/s on the line",
            per_second(figures.steps as f64),
            figures.steps_per_segment,
            figures.bytes_per_step,
            per_second(figures.extensions as f64),
            figures.ahead_s * 1e3,
            figures.bytes_per_s,
        );
        assert_eq!(figures.refused, None, "{what}");
        // The lease reaches this far ahead: a real board may be slower than the model by less.
        assert!(figures.ahead_s > 3e-3, "{what}: {figures:?}");
        // Of the 100 000 bytes that the line can carry.
        assert!(figures.bytes_per_s < 50_000.0, "{what}: {figures:?}");
    }
}

/// The bytes that each of four motors of an Uno has. Where a ramp ends, its last segments and the next ones need the
/// most.
#[test]
fn ramps_of_four_motors_fit_their_queues() {
    let queue = pulsetrain_motion::boards::find("uno").expect("the table has the Uno").queue_bytes[3] as u16;
    for rate in [5.6e3, 8e3, 10e3, 12e3, 13.5e3, 15e3, 16.5e3, 18e3, 20e3] {
        for apart in [0.0, 0.25] {
            let law = Law::trapezoid(0.8 * rate, rate, 2.0 * rate, 2.0 * rate).unwrap();
            // Each motor is a part of a step behind the one before.
            let law = |motor| law.clone().delayed(Time::from_seconds(apart * f64::from(motor) / rate)).unwrap();
            let program = unlimited(program((0..4).map(law).collect(), 0.0));
            let figures = stream(&Program { tolerance: Tolerance::Seconds(1e-6), ..program }, queue, 2.0);
            assert_eq!(figures.refused, None, "{rate} steps/s, {apart} of a step apart");
        }
    }
}

/// Examples on the virtual Uno.
mod chips {
    use super::*;
    use crate::common::rigs;
    use pulsetrain_board::virtual_uno::VirtualUno;
    use pulsetrain_core::Direction;
    use pulsetrain_motion::boards::uno::PinKind;
    use pulsetrain_plan::{Ensemble, Move};
    use pulsetrain_session::drive::connect_as;
    use std::path::Path;

    /// Least distance of steps of four motors on one DIR line, ticks.
    const LATE: u64 = 300;

    /// All steps of a plan, ticks from the laws' beginning on.
    fn planned(program: &Program) -> Vec<Vec<(u64, i64)>> {
        let fraction_bits = program.board.registers.fraction_bits;
        let mut ensemble = Ensemble::new(program).unwrap();
        let mut of = |motor| {
            let mut accumulator = 1_i128 << (fraction_bits - 1);
            let mut steps = Vec::new();
            while let Some(next) = ensemble.next_move(motor).unwrap() {
                match next {
                    Move::Dwell { ticks } => accumulator += i128::from(ticks) << fraction_bits,
                    Move::Run { segment, direction } => {
                        let sign = if direction == Direction::Forward { 1 } else { -1 };
                        let tick = |k| ((accumulator + segment.span(k)) >> fraction_bits) as u64;
                        steps.extend((1..=segment.count).map(|k| (tick(k), sign)));
                        accumulator += segment.span(segment.count);
                    }
                }
            }
            steps
        };
        (0..program.motors.len()).map(&mut of).collect()
    }

    /// Runs an example for `seconds` at most through half of each queue. Each step must be the plan's.
    fn run_with_half(file: &str, seconds: i64) {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples").join(file);
        let prepared = load::load(&path, None, Some(Time::from_ratio(seconds, 1))).unwrap();
        let program = &prepared.program;
        let mut board = Watched::new(connect_as(VirtualUno::new(), program, Baud::B1M, 1).unwrap());
        board.missing = board.room(0).div_ceil(2);
        let room = board.room(0);
        let mut edges = Vec::new();
        let mut session = Session::new(board, program.clone()).unwrap_or_else(|error| panic!("{file}: {error}"));
        let report = session.run(&mut |edge: Edge| edges.push(edge), |_| {});
        let least_ms = 1e3 * session.board().least_ahead as f64 / TICK_HZ as f64;
        println!("{file}, {room} bytes a motor: {} edges, {least_ms:.1} ms to spare", edges.len());
        assert_eq!(report.failure, None, "{file}, {room} bytes a motor");
        assert_eq!(report.counted, report.replayed, "{file}");
        assert!(report.faults.iter().all(|faults| *faults == Faults::default()), "{file}: {:?}", report.faults);
        let constant = u64::from(PinKind::of(&program.motors).unwrap().constant_ticks());
        for ((steps, planned), motor) in rigs::steps(program, &edges).iter().zip(planned(program)).zip(&program.motors)
        {
            assert_eq!(steps.len(), planned.len(), "{file}, {}", motor.name);
            for ((tick, sign), (due, way)) in steps.iter().zip(planned) {
                let due = report.zero + due + constant;
                let is_there = *sign == way && due.abs_diff(*tick) <= LATE;
                assert!(is_there, "{file}, {}: due at {due} ({way}), seen at {tick} ({sign})", motor.name);
            }
        }
    }

    #[test]
    fn examples_run_with_half_of_an_unos_queues() {
        for (file, seconds) in [("winch.toml", 8), ("sweep.toml", 5), ("sweep-phases.toml", 5), ("cnc-shield.toml", 5)]
        {
            run_with_half(file, seconds);
        }
    }
}
