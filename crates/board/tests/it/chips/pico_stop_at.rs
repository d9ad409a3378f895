//! The immediate stop on the virtual Pico in cycle after cycle, at every instruction of both programs, in both PIO blocks: what it
//! counts is what the pins did.

use pulsetrain_board::virtual_pico::VirtualPico;
use pulsetrain_board::{Board, Edge, Lease, Leased, Port, PortError, Remote, Setup, StopReport};
use pulsetrain_core::output::{HALF_STEPS, Sequence};
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::MotorSetup;
use pulsetrain_core::{Direction, Entry, Epoch, Item, Tick32};
use pulsetrain_testkit::held::hold_up;
use pulsetrain_testkit::pico::{TICK_HZ, as_line, coil_levels, coils, run, step_dir, stopped_driver};
use std::collections::BTreeSet;
use std::time::Duration;

use Direction::{Backward, Forward};

/// Instructions in memory: step/dir from 0 on, coils behind them. Before the gate nothing is counted. Those of a pulse are not seen: the machine
/// ends it, and waits at the gate.
const STEP_DIR: [u32; 3] = [1, 2, 3];
const COILS: [u32; 3] = [8, 9, 10];

/// Where a motor's machine was halted.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
enum Place {
    /// At that instruction.
    At(u32),
    /// In a pulse that began so many ticks before.
    InPulse(u64),
}
use Place::{At, InPulse};

/// A board whose main loop can be kept from doing anything up to a cycle, so that it does what was asked for at that one.
#[derive(Clone)]
struct Held {
    pico: VirtualPico,
    /// From when to when.
    stretch: Option<[Duration; 2]>,
}

impl Port for Held {
    fn now(&self) -> Duration {
        self.pico.now()
    }
    fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
        self.pico.send(bytes)
    }
    fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
        if let Some([begin, end]) = self.stretch.take_if(|[begin, _]| *begin <= until) {
            while self.now() < begin {
                self.pico.receive(begin, into)?;
            }
            hold_up(&mut self.pico, end, into);
        }
        self.pico.receive(until, into)
    }
    fn set_baud(&mut self, baud: Baud) -> Result<(), PortError> {
        self.pico.set_baud(baud)
    }
    fn edges(&mut self, into: &mut Vec<Edge>) {
        self.pico.edges(into);
    }
}

/// All motors under way with `interval` ticks from one step to the next, turning at times; so long that the words are written.
fn under_way(setup: &Setup, intervals: &[i64]) -> (Remote<Held>, Vec<Edge>, u64) {
    let mut board = Remote::open(Held { pico: VirtualPico::new(), stretch: None }, 1).expect("it answers");
    assert_eq!(board.set_baud(Baud::B2M), Ok(Baud::B2M));
    board.configure(setup).unwrap_or_else(|error| panic!("{error}: {setup:?}"));
    let soon = board.now() + TICK_HZ / 1000;
    board.advance(soon, &mut |_: Edge| {});
    let from = board.now() + board.round_trip() + TICK_HZ / 50;
    for (motor, interval) in intervals.iter().enumerate() {
        let mut items = vec![Item::Anchor { tick: Tick32::of(from) }];
        // A word for DIR in each turn; the others go straight on.
        for turn in 0..40 {
            let direction = if motor % 2 == 1 && turn % 2 == 1 { Backward } else { Forward };
            items.push(run((TICK_HZ as i64 / 400 / interval).max(1) as u32, *interval, direction));
        }
        for item in items {
            board.push(motor, Entry { epoch: Epoch(1), item }).expect("there is room");
        }
    }
    assert_eq!(board.switch(Epoch(1), from, Lease::Last, &[]), Ok(()));
    let mut edges = Vec::new();
    board.advance(from + TICK_HZ / 50, &mut |edge: Edge| edges.extend(as_line(setup, edge)));
    (board, edges, from)
}

/// Position and pins agree, and every pulse is as long as it should be; gives how long before the stop the pulse of each driver began that it
/// caught.
fn check(setup: &Setup, edges: &[Edge], report: &StopReport) -> Vec<Option<u64>> {
    let mut caught = Vec::new();
    for (motor, position) in setup.motors.iter().zip(&report.positions) {
        if let Some(sequence) = motor.coils() {
            let (first, half_steps) = match sequence {
                Sequence::Wave => (1, 2),
                Sequence::Full => (0, 2),
                Sequence::Half => (0, 1),
            };
            let levels = coil_levels(edges, motor);
            let pattern = HALF_STEPS[(first + half_steps * position).rem_euclid(8) as usize];
            assert_eq!(levels, pattern, "{report:?} {motor:?}");
            caught.push(None);
            continue;
        }
        let pins = stopped_driver(setup, motor, edges, report.tick);
        assert_eq!(pins.position, *position, "{report:?} {motor:?}");
        caught.push(pins.caught.map(|(since, _)| since));
    }
    caught
}

/// Stops the same board in each of `cycles` cycles, or nearly: what the main loop does in between varies. `around`: in the middle
/// of them is the first of these ticks that can be, from one on, each so long after the one before. Ends when it has seen enough;
/// gives where each motor's machine was halted.
fn stop_in_each(
    setup: &Setup,
    begun: &(Remote<Held>, Vec<Edge>, u64),
    around: Option<(u64, u64)>,
    cycles: u64,
    is_enough: impl Fn(&[BTreeSet<Place>]) -> bool,
) -> Vec<BTreeSet<Place>> {
    const HOLD: u64 = TICK_HZ / 10_000;
    /// The stop is asked for so much later: that there is time to hold it up before.
    const LATER: u64 = TICK_HZ / 1000;
    let (board, edges, _) = begun;
    let stop = |stretch: Option<[u64; 2]>| {
        let (mut board, mut edges) = (board.clone(), edges.clone());
        let mut observer = |edge: Edge| edges.extend(as_line(setup, edge));
        let now = board.now();
        let held = board.port_mut();
        held.stretch = stretch.map(|stretch| stretch.map(|ticks| held.now() + Duration::from_nanos(8 * ticks)));
        let report = board.stop_now(now + LATER, &mut observer);
        board.advance(report.tick + TICK_HZ / 1000, &mut observer);
        let caught = check(setup, &edges, &report);
        let chip = board.port_mut().pico.chip_mut();
        // PIO's SMx_ADDR (RP2040 datasheet §3.7): nobody has moved a machine on that was not in its pulse.
        let mut at = |motor: u32| chip.read(0x5020_00d4 + 0x10_0000 * (motor / 4) + 0x18 * (motor % 4), &mut Unseen);
        let halted = (0..).zip(caught).map(|(motor, caught)| match (at(motor), caught) {
            (0, Some(since)) => InPulse(since),
            (at, _) => At(at),
        });
        (report.tick, halted.collect::<Vec<_>>())
    };
    // Held up around the time at which it hears of the stop, and so that it does nothing but hear, and sleeps no more, afterwards.
    // By the chip's clock: the host's guess of it may be ahead of the time at which it hears.
    let now = (board.port().now().as_nanos() / 8) as u64;
    let heard = stop(None).0.checked_sub(now).expect("it is stopped later");
    let stretch = |early: u64, late: u64| Some([heard - early, heard + HOLD + late]);
    let early = (0..heard)
        .step_by(100)
        .find(|early| stop(stretch(*early, 0)).0 + 1 == stop(stretch(*early, 1)).0)
        .expect("the main loop hears at some time");
    let stop = |late| stop(stretch(early, late));
    let begin = around.map_or(0, |(from, every)| {
        let soonest = stop(0).0 + cycles;
        let first = from + (soonest - from).next_multiple_of(every) - cycles / 2;
        // The longer it was held up, the more there is to do before it hears.
        (0..4).fold(0, |late: u64, _| (late + first).saturating_sub(stop(late).0))
    });
    let mut seen = vec![BTreeSet::new(); setup.motors.len()];
    for late in begin..begin + cycles {
        if is_enough(&seen) {
            break;
        }
        for (seen, at) in seen.iter_mut().zip(stop(late).1) {
            seen.insert(at);
        }
    }
    seen
}

struct Unseen;
impl pulsetrain_emulator::Observer for Unseen {}

/// Eight drivers, in both blocks, with the shortest pulse, a usual one and a long one, STEP active high and low: in cycle after
/// cycle, until such as are alike were halted at all instructions: in the first cycle of a pulse, in its last, and between them.
#[test]
fn drivers_at_every_instruction() {
    /// Quick motors of one block, with STEP active low or high.
    const ALIKE: [&[usize]; 4] = [&[0, 3], &[2], &[4, 7], &[6]];
    for (pulse_ticks, interval) in [(3, 250_i64), (13, 260), (100, 400)] {
        let mut motors: Vec<MotorSetup> = (0..8).map(|motor| step_dir(2 + 2 * motor)).collect();
        motors.iter_mut().step_by(3).for_each(|motor| motor.step_low = true);
        let setup = Setup { pulse_ticks, setup_ticks: 20, hold_ticks: 5, motors, ..Setup::default() };
        // Each has another place in its word at any time.
        let intervals: Vec<i64> =
            (0..8).map(|motor| if motor % 4 == 1 { 2_000 } else { interval + 3 * motor }).collect();
        let begun = under_way(&setup, &intervals);
        let is_enough = |seen: &[BTreeSet<Place>]| {
            ALIKE.iter().all(|alike| {
                let seen: BTreeSet<Place> = alike.iter().flat_map(|motor| &seen[*motor]).copied().collect();
                let pulse = seen.iter().filter_map(|place| if let InPulse(since) = place { Some(since) } else { None });
                let cycles = pulse.clone().max().zip(pulse.clone().min()).map_or(0, |(last, first)| last - first + 1);
                let others = STEP_DIR.into_iter().all(|at| seen.contains(&At(at)));
                others && cycles == u64::from(pulse_ticks) && pulse.count() > 2
            })
        };
        let seen = stop_in_each(&setup, &begun, None, 4000, is_enough);
        assert!(is_enough(&seen), "pulse {pulse_ticks}: {seen:?}");
    }
}

/// Coils in all three sequences and in both blocks, one motor across the GPIOs that the header has not: around the change of
/// lines of each.
#[test]
fn coils_around_each_change_of_lines() {
    let sequences = [Sequence::Wave, Sequence::Full, Sequence::Half];
    let motors: Vec<MotorSetup> = (0..6).map(|motor| coils(2 + 4 * motor, sequences[motor as usize % 3])).collect();
    let setup = Setup { motors, ..Setup::default() };
    // All change in the same tick, every 0.4 ms.
    let begun = under_way(&setup, &[50_000; 6]);
    let seen = stop_in_each(&setup, &begun, Some((begun.2, 50_000)), 400, |_| false);
    for (motor, seen) in seen.iter().enumerate() {
        assert_eq!(seen, &COILS.map(At).into(), "motor {motor}");
    }
}

/// Before the first word has changed the lines: nothing was done, and nothing is counted.
#[test]
fn in_the_first_wait() {
    let setup = Setup { pulse_ticks: 13, motors: vec![step_dir(2), coils(22, Sequence::Half)], ..Setup::default() };
    let mut board = Remote::open(VirtualPico::new(), 1).expect("it answers");
    assert_eq!(board.set_baud(Baud::B2M), Ok(Baud::B2M));
    board.configure(&setup).expect("it takes it");
    for _ in 0..4 {
        let mut edges = Vec::new();
        let now = board.now();
        let report =
            board.stop_now(now, &mut |edge: Edge| edges.extend(as_line(&setup, edge).filter(|edge| edge.line > 1)));
        assert_eq!((report.positions, edges), (vec![0, 0], vec![]));
        board.arm().expect("at rest");
    }
}
