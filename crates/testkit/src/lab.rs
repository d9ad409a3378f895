//! The edges on a board's pins, compared with the steps that a native board scheduled from the same items.

use super::{TICK_HZ, native_config};
use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Board, Edge, Native, Observer, Remote, ScheduledStep, Setup, WithReference};
use pulsetrain_core::Direction;
use pulsetrain_core::verbs::MotorTiming;
use pulsetrain_core::wire::Baud;

/// The symbols of the Uno's image, with their addresses.
pub const SYMBOLS: &str = include_str!("../../../testdata/uno.sym");

/// The address of a symbol: a word address of a routine in flash, a byte address of a variable in RAM.
pub fn address(map: &str, name: &str) -> u16 {
    let line = map.lines().find(|line| line.split_whitespace().nth(2) == Some(name));
    let mut fields = line.unwrap_or_else(|| panic!("the map has no {name}")).split_whitespace();
    let (memory, at) = (fields.next().expect("a memory"), fields.next().expect("an address"));
    let at = u16::from_str_radix(at.trim_start_matches("0x"), 16).expect("a number");
    if memory == "flash" { at / 2 } else { at }
}

/// The virtual Uno, and a native board that gets the same items.
pub type UnoWithReference = WithReference<Remote<VirtualUno>>;

/// A virtual Uno at 1 Mbaud, configured for `setup`.
pub fn uno(setup: &Setup) -> UnoWithReference {
    uno_after(VirtualUno::new(), setup)
}

/// The timing that an Uno with verbs allows its motors, ticks (docs/verbs.md).
pub fn verb_limits(setup: &Setup) -> MotorTiming {
    let pulse = u32::from(setup.pulse_ticks);
    let shortest = if pulse <= 16 { 368 } else { 413 } * setup.motors.len() as u32;
    let turn = 640 + pulse + u32::from(setup.setup_ticks) + u32::from(setup.hold_ticks);
    MotorTiming { shortest, turn, period: shortest.max(16_000) }
}

/// As [`uno`], with a virtual Uno that has been running for a while.
pub fn uno_after(port: VirtualUno, setup: &Setup) -> UnoWithReference {
    let mut remote = Remote::open(port, 7).expect("it answers");
    assert_eq!(remote.set_baud(Baud::B1M), Ok(Baud::B1M));
    remote.configure(setup).expect("it takes the configuration");
    let mut native = Native::unbounded(&native_config(setup)).expect("the native board takes it too");
    native.advance(remote.now() - 1, &mut |_: Edge| {});
    WithReference::new(remote, native)
}

/// The counts that the board reports now.
pub fn said(board: &mut UnoWithReference) -> Vec<i64> {
    let status = board.board_mut().status().expect("it answers");
    status.motors.as_slice().iter().map(|motor| i64::from(motor.position)).collect()
}

/// Collects the edges of pins and the scheduled steps of motors.
#[derive(Clone, Debug, Default)]
pub struct Lab {
    pub edges: Vec<Edge>,
    pub steps: Vec<ScheduledStep>,
}

impl Observer for Lab {
    fn edge(&mut self, edge: Edge) {
        self.edges.push(edge);
    }
    fn step(&mut self, step: ScheduledStep) {
        self.steps.push(step);
    }
}

/// When the edges of pins come: `constant` after their scheduled ticks, and at most `early` before or `late` after that, ticks.
#[derive(Clone, Copy, Debug)]
pub struct Timing {
    pub constant: i64,
    pub early: i64,
    pub late: i64,
}

/// Pins that software switches: an interrupt may be delayed by another one, and two motors' steps that are close share one interrupt.
pub const SOFTWARE: Timing = Timing { constant: 17, early: 60, late: 60 };
/// Motors that share a DIR line: a step that is too close to one in the other direction waits for the next interrupt.
pub const SHARED: Timing = Timing { constant: 17, early: 60, late: 400 };
/// Pins that the timer's compare hardware switches.
pub const EXACT: Timing = Timing { constant: 1, early: 0, late: 0 };

/// A pulse, as the pins show it.
#[derive(Clone, Copy, Debug)]
struct Pulse {
    tick: u64,
    direction: Direction,
}

impl Lab {
    /// Checks a motor's pins against the setup: active levels, pulses, DIR setup and DIR hold. Returns its pulses.
    fn pulses(&self, setup: &Setup, index: usize) -> Vec<Pulse> {
        let motor = &setup.motors[index];
        let (mut dir_high, mut dir_tick, mut began, mut ended) = (false, None, None, None);
        let mut pulses = Vec::new();
        for edge in self.edges.iter().filter(|edge| edge.line == motor.dir_pin || edge.line == motor.step_pin) {
            let since = |tick: Option<u64>| tick.map_or(u64::MAX, |tick| edge.tick - tick);
            if edge.line == motor.dir_pin {
                assert_ne!(edge.level, dir_high, "motor {index}: DIR {edge:?}");
                assert!(began.is_none(), "motor {index}: DIR turns in mid-pulse at {}", edge.tick);
                let held = since(ended);
                assert!(
                    held >= u64::from(setup.hold_ticks),
                    "motor {index}: DIR held for {held} ticks at {}",
                    edge.tick
                );
                (dir_high, dir_tick) = (edge.level, Some(edge.tick));
            } else if edge.level != motor.step_low {
                assert!(began.is_none(), "motor {index}: two pulses in one at {}", edge.tick);
                let ready = since(dir_tick);
                assert!(ready >= u64::from(setup.setup_ticks), "motor {index}: DIR {ready} ticks before {}", edge.tick);
                let forward = dir_high == motor.forward_high;
                let direction = if forward { Direction::Forward } else { Direction::Backward };
                pulses.push(Pulse { tick: edge.tick, direction });
                began = Some(edge.tick);
            } else {
                let width = since(began.take());
                assert!(
                    width >= u64::from(setup.pulse_ticks),
                    "motor {index}: a pulse of {width} ticks at {}",
                    edge.tick
                );
                ended = Some(edge.tick);
            }
        }
        assert!(began.is_none(), "motor {index}: a pulse without an end");
        pulses
    }

    /// Steps forward minus backward of each motor, by its pins.
    pub fn counts(&self, setup: &Setup) -> Vec<i64> {
        let count = |pulses: Vec<Pulse>| pulses.iter().map(|pulse| i64::from(pulse.direction.sign())).sum();
        (0..setup.motors.len()).map(|index| count(self.pulses(setup, index))).collect()
    }

    /// All counts that a motor had between two ticks, by its pins.
    pub fn counts_between(&self, setup: &Setup, index: usize, from: u64, to: u64) -> Vec<i64> {
        let mut count = 0;
        let mut counts = Vec::new();
        for pulse in self.pulses(setup, index).iter().take_while(|pulse| pulse.tick <= to) {
            if pulse.tick >= from {
                counts.push(count);
            }
            count += i64::from(pulse.direction.sign());
        }
        counts.push(count);
        counts
    }

    /// Checks that the pins show every scheduled step, in its direction and in time, and no other step. If `stopped` is the tick of an immediate stop, steps
    /// after it may be missing.
    pub fn check(&self, setup: &Setup, timing: Timing, stopped: Option<u64>) {
        for index in 0..setup.motors.len() {
            let made = self.pulses(setup, index);
            let wanted: Vec<_> = self.steps.iter().filter(|step| step.motor == index).collect();
            for (number, (made, wanted)) in made.iter().zip(&wanted).enumerate() {
                let late = made.tick as i64 - wanted.tick as i64 - timing.constant;
                let what = format!("motor {index}, step {number}, due {}", wanted.tick);
                assert!((-timing.early..=timing.late).contains(&late), "{what}: {late} ticks late");
                assert_eq!(made.direction, wanted.direction, "{what}");
            }
            match stopped {
                None => assert_eq!(made.len(), wanted.len(), "motor {index}: steps made and scheduled"),
                Some(tick) => {
                    // Steps that were due before the stop were made, and steps that were made were due.
                    let before = wanted.iter().filter(|step| (step.tick as i64) < tick as i64 - 2 * SLACK).count();
                    let after = wanted.iter().filter(|step| (step.tick as i64) < tick as i64 + SLACK).count();
                    assert!(
                        (before..=after).contains(&made.len()),
                        "motor {index}: {} of {before}..={after}",
                        made.len()
                    );
                }
            }
        }
    }
}

/// The most that a board's program takes between the immediate stop and the reading of its tick, ticks: 200 µs.
const SLACK: i64 = TICK_HZ as i64 / 5000;
