//! The immediate stop on the virtual Pico in cycle after cycle, at every instruction of both programs, in both PIO blocks: what it
//! counts is what the pins did.

mod common;

use common::pico::{TICK_HZ, as_line, coil_levels, coils, run, step_dir};
use pulsetrain_board::virtual_pico::VirtualPico;
use pulsetrain_board::{Board, Edge, Port, PortError, Remote, Setup, StopReport};
use pulsetrain_core::output::{HALF_STEPS, Sequence};
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::MotorSetup;
use pulsetrain_core::{Direction, Entry, Epoch, Item, Moment};
use pulsetrain_emulator::arm::Mode;
use std::collections::BTreeSet;
use std::time::Duration;

use Direction::{Backward, Forward};

/// Instructions in memory: step/dir from 0 on, coils behind them. Before the gate nothing is counted.
const STEP_DIR: [u32; 6] = [1, 2, 3, 4, 5, 6];
const COILS: [u32; 3] = [8, 9, 10];

/// A board whose main loop can be kept from doing anything up to a cycle, so that it does what was asked for at that one.
#[derive(Clone)]
struct Held {
    pico: VirtualPico,
    /// The cycle, and where the main loop goes on.
    until: Option<(Duration, u32)>,
}

impl Held {
    fn run(&mut self, until: Duration, into: &mut Vec<u8>) {
        let had = into.len();
        while self.pico.now() < until && into.len() == had {
            self.pico.receive(until, into).expect("it is there");
        }
    }

    /// Holds the main loop up from now on: in a loop at the end of RAM, where nothing is. It is 500 times `nop`
    /// and a branch back, so that it can be left in nearly every cycle.
    fn hold(&mut self, until: Duration) {
        const LOOP: u32 = 0x2003_c000;
        const NOPS: usize = 500;
        const NOP: u16 = 0xbf00;
        const BACK: u16 = 0xe000 | (-(NOPS as i16) - 2) as u16 & 0x7ff;
        let is_free = |pico: &VirtualPico| {
            let cpu = pico.chip().cpu();
            !cpu.is_asleep() && cpu.mode() == Mode::Thread && !cpu.primask()
        };
        while !is_free(&self.pico) {
            let soon = self.pico.now() + Duration::from_nanos(8);
            self.run(soon, &mut Vec::new());
        }
        let at = (LOOP - 0x2000_0000) as usize;
        let chip = self.pico.chip_mut();
        let code: Vec<u8> = [NOP; NOPS].iter().chain([&BACK]).flat_map(|code| code.to_le_bytes()).collect();
        chip.ram_mut()[at..at + code.len()].copy_from_slice(&code);
        self.until = Some((until, chip.cpu().register(15)));
        chip.cpu_mut().set_register(15, LOOP);
    }
}

impl Port for Held {
    fn now(&self) -> Duration {
        self.pico.now()
    }
    fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
        self.pico.send(bytes)
    }
    fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
        if let Some((free, pc)) = self.until.filter(|(free, _)| *free <= until) {
            self.run(free, into);
            while self.pico.chip().cpu().mode() != Mode::Thread {
                let soon = self.pico.now() + Duration::from_nanos(8);
                self.run(soon, into);
            }
            self.pico.chip_mut().cpu_mut().set_register(15, pc);
            self.until = None;
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
    let mut board = Remote::open(Held { pico: VirtualPico::new(), until: None }, 1).expect("it answers");
    assert_eq!(board.set_baud(Baud::B2M), Ok(Baud::B2M));
    board.configure(setup).unwrap_or_else(|error| panic!("{error}: {setup:?}"));
    let soon = board.now() + TICK_HZ / 1000;
    board.advance(soon, &mut |_: Edge| {});
    let from = board.now() + board.lead() + TICK_HZ / 50;
    for (motor, interval) in intervals.iter().enumerate() {
        let mut items = vec![Item::Anchor { tick: Moment::of(from) }];
        // A word for DIR in each turn; the others go straight on.
        for turn in 0..40 {
            let direction = if motor % 2 == 1 && turn % 2 == 1 { Backward } else { Forward };
            items.push(run((TICK_HZ as i64 / 400 / interval).max(1) as u32, *interval, direction));
        }
        for item in items {
            board.push(motor, Entry { epoch: Epoch(1), item }).expect("there is room");
        }
    }
    assert_eq!(board.switch(Epoch(1), from), Ok(()));
    let mut edges = Vec::new();
    board.advance(from + TICK_HZ / 50, &mut |edge: Edge| edges.extend(as_line(setup, edge)));
    (board, edges, from)
}

/// Position and pins agree, and every pulse that was begun is long enough.
fn check(setup: &Setup, edges: &[Edge], report: &StopReport) {
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
            continue;
        }
        let (mut dir, mut count, mut high) = (false, 0, None::<u64>);
        for edge in edges {
            if edge.line == motor.dir_pin {
                assert_eq!(high, None, "DIR changes inside a pulse");
                dir = edge.level;
            } else if edge.line == motor.step_pin && edge.level {
                assert!(edge.tick <= report.tick, "a step after the stop");
                count += if dir == motor.forward_high { 1 } else { -1 };
                high = Some(edge.tick);
            } else if edge.line == motor.step_pin {
                let since = high.take().expect("a pulse begins before it ends");
                assert!(edge.tick - since >= u64::from(setup.pulse_ticks.max(3)), "a pulse of {}", edge.tick - since);
            }
        }
        assert_eq!((high, count), (None, *position), "{report:?} {motor:?}");
    }
}

/// Stops the same board in each of `cycles` cycles, the first of which is the latest that comes out at or before tick `first`; gives
/// at which instructions each motor's machine was halted.
fn stop_in_each(
    setup: &Setup,
    begun: &(Remote<Held>, Vec<Edge>, u64),
    first: Option<u64>,
    cycles: u64,
) -> Vec<BTreeSet<u32>> {
    // The frame crosses USB and the line in the meantime, and the state machines have words for longer.
    const HOLD: u64 = TICK_HZ * 13 / 10_000;
    let (board, edges, _) = begun;
    let stop = |board: &Remote<Held>, late: u64| {
        let (mut board, mut edges) = (board.clone(), edges.clone());
        let mut observer = |edge: Edge| edges.extend(as_line(setup, edge));
        let held = board.port_mut();
        let until = held.now() + Duration::from_nanos(8 * (HOLD + late));
        held.hold(until);
        let now = board.now();
        let report = board.stop_now(now, &mut observer);
        board.advance(report.tick + TICK_HZ / 1000, &mut observer);
        check(setup, &edges, &report);
        let mut chip = board.port().pico.chip().clone();
        // PIO's SMx_ADDR (RP2040 datasheet §3.7): nobody has moved the machine on.
        let at = |motor: u32| chip.read(0x5020_00d4 + 0x10_0000 * (motor / 4) + 0x18 * (motor % 4), &mut Unseen);
        let halted: Vec<u32> = (0..setup.motors.len() as u32).map(at).collect();
        (report.tick, halted)
    };
    let begin = match first {
        None => 0,
        Some(first) => first.checked_sub(stop(board, 0).0).expect("it can be stopped as soon as that"),
    };
    let mut seen = vec![BTreeSet::new(); setup.motors.len()];
    for late in begin..begin + cycles {
        for (seen, at) in seen.iter_mut().zip(stop(board, late).1) {
            seen.insert(at);
        }
    }
    seen
}

struct Unseen;
impl pulsetrain_emulator::Observer for Unseen {}

/// Eight drivers, in both blocks, with the shortest pulse, a usual one and a long one, STEP active high and low: in each cycle of a
/// two words and more.
#[test]
fn drivers_in_every_cycle_of_a_word() {
    for (pulse_ticks, interval) in [(3, 250_i64), (13, 260), (100, 400)] {
        let mut motors: Vec<MotorSetup> = (0..8).map(|motor| step_dir(2 + 2 * motor)).collect();
        motors.iter_mut().step_by(3).for_each(|motor| motor.step_low = true);
        let setup = Setup { pulse_ticks, setup_ticks: 20, hold_ticks: 5, motors, ..Setup::default() };
        // Each has another place in its word at any time.
        let intervals: Vec<i64> =
            (0..8).map(|motor| if motor % 4 == 1 { 2_000 } else { interval + 3 * motor }).collect();
        let begun = under_way(&setup, &intervals);
        let seen = stop_in_each(&setup, &begun, None, 2 * interval as u64);
        let mut all = BTreeSet::new();
        for (motor, seen) in seen.iter().enumerate().filter(|(motor, _)| motor % 4 != 1) {
            // With the shortest pulse the loop of it is one round: as all others, one cycle.
            assert_eq!(seen, &STEP_DIR.into(), "motor {motor}, pulse {pulse_ticks}");
            all.extend(seen);
        }
        assert_eq!(all, STEP_DIR.into());
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
    let from = begun.2;
    // Held up for as long as that, the state machines still have words.
    let now = begun.0.now() + TICK_HZ * 14 / 10_000;
    let change = from + (now - from).next_multiple_of(50_000);
    let seen = stop_in_each(&setup, &begun, Some(change - 40), 80);
    for (motor, seen) in seen.iter().enumerate() {
        assert_eq!(seen, &COILS.into(), "motor {motor}");
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
