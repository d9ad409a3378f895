//! A motion in the form that the sketch's player (`player.h`) reads: tables, lines and times.

use pulsetrain_motion::program::{Motor, Program, Wiring};

use crate::Target;
use crate::error::BakeError;
use crate::table::{Load, PERIOD_BITS, PutOff, Room, Row, Table, Turn, Work, tables};

/// Motors that the player drives at most.
pub(super) const MOST: usize = 4;

/// Ticks of an Uno in a second.
const HZ: u64 = 16_000_000;

/// Steps a second at most, of all motors together.
const MOST_STEPS_PER_S: f64 = 14_000.0;

/// Cycles that the player needs for a step, without its pulse (the player waits during the pulse), with one to four
/// motors. Measured on the emulated chip with Debian's avr-gcc (`tests/it/chips/sketches.rs`,
/// `the_greatest_rate_can_be_kept`): some 990, 1025, 1065, 1110.
const STEP_CYCLES: [f64; MOST] = [1_020.0, 1_060.0, 1_100.0, 1_145.0];

/// Cycles that the player needs for a row, and for a reversal of DIR without its setup and hold. Measured: 330 and some
/// 400.
const ROW_CYCLES: f64 = 360.0;
const TURN_CYCLES: f64 = 450.0;

/// Cycles from one edge to the next where edges follow one another as soon as the player can make them. The edge before
/// may be the second one of a pulse.
const NEXT_CYCLES: u64 = 110;

/// Longest pulse, setup or hold, ticks. The player waits during all of them, and compares times within 16 bits.
const LONGEST: u64 = 1_000;

/// Ticks from the start of the counter to the motion's time zero. The player works out the first events in this time.
pub(super) const LEAD: u32 = 16_000;

/// Marks a row index where there is no row.
const NEVER: u16 = 0xffff;

/// The size of a baked motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size {
    /// Rows of all tables.
    pub rows: usize,
    /// Bytes of them.
    pub bytes: usize,
    /// Whether any motor goes on for ever.
    pub endless: bool,
    /// The steps of all motors that a shared DIR line delays.
    pub put_off: PutOff,
}

/// A motion in the player's terms.
pub(super) struct Parts {
    pub(super) tables: Vec<Table>,
    pub(super) wires: Vec<Wires>,
    pub(super) size: Size,
}

/// A motor's lines as masks of ports B and D, and its times in ticks.
pub(super) struct Wires {
    pub(super) step: (u8, u8),
    pub(super) dir: (u8, u8),
    pub(super) forward_high: bool,
    pub(super) pulse: u64,
    pub(super) low: u64,
    pub(super) setup: u64,
    pub(super) hold: u64,
}

/// What `player.h` calls a Plan.
pub(super) struct Plan<'a> {
    /// Row indices, counted through all tables.
    pub(super) first: u16,
    pub(super) end: u16,
    pub(super) turn: u16,
    /// Ticks · 2^-16, 48 bits.
    pub(super) base: u64,
    pub(super) period: u64,
    /// The rest of the period, ticks · 2^-48.
    pub(super) rest: u32,
    pub(super) wires: &'a Wires,
}

impl Parts {
    /// `bytes`: the flash that is free for rows.
    pub(super) fn of(program: &Program, bytes: usize) -> Result<Parts, BakeError> {
        if Target::of(program) != Some(Target::Avr) {
            return Err(BakeError::Board { board: program.board.name.clone() });
        }
        if let Some(motor) = program.motors.get(MOST) {
            return Err(BakeError::Wiring {
                motor: motor.name.clone(),
                what: format!("there are more than {MOST} motors"),
            });
        }
        let wires: Vec<Wires> = program.motors.iter().map(Wires::of).collect::<Result<_, _>>()?;
        let pulse = 4 * u64::from(pulse_loops(&wires));
        let hz = HZ as f64;
        let step = (STEP_CYCLES[program.motors.len().saturating_sub(1)] + pulse as f64).max(hz / MOST_STEPS_PER_S);
        let tables = tables(program, Room { bytes, rate_hz: hz / step })?;
        let waits = wires.iter().map(|wires| wires.setup + wires.hold).max().unwrap_or(0);
        let work = Work { step, row: ROW_CYCLES, turn: TURN_CYCLES + waits as f64 };
        // In every stretch of time the player must work out the steps of all motors while it makes the steps before
        // them.
        let loads: Vec<Load> = tables.iter().map(|table| table.load(&work)).collect();
        let load: f64 = loads.iter().map(|load| load.busy).sum();
        if load > 1.0 {
            let rate_hz = loads.iter().map(|load| load.steps_per_tick * hz).sum();
            return Err(BakeError::TooFast { rate_hz, limit_hz: rate_hz / load });
        }
        for ((motor, table), least) in program.motors.iter().zip(&tables).zip(shortest_intervals(&wires)) {
            if table.shortest < least {
                let (rate_hz, limit_hz) = (hz / table.shortest as f64, hz / least as f64);
                return Err(BakeError::TooClose { motor: motor.name.clone(), rate_hz, limit_hz });
            }
        }
        let rows: usize = tables.iter().map(|table| table.rows.len()).sum();
        let endless = tables.iter().any(|table| table.turn.is_some());
        let put_off = tables.iter().map(|table| table.put_off).sum();
        Ok(Parts { tables, wires, size: Size { rows, bytes: rows * Row::BYTES, endless, put_off } })
    }

    /// See [`pulse_loops`].
    pub(super) fn pulse_loops(&self) -> u16 {
        pulse_loops(&self.wires)
    }

    /// The Uno's lamp, pin 13, unless a motor has that pin.
    pub(super) fn lamp(&self) -> u8 {
        let lamp = 1 << 5;
        let used = self.wires.iter().any(|wires| (wires.step.0 | wires.dir.0) & lamp != 0);
        if used { 0 } else { lamp }
    }

    pub(super) fn plans(&self) -> Vec<Plan<'_>> {
        let mut first = 0;
        let plans = self.tables.iter().zip(&self.wires).map(|(table, wires)| {
            let (begin, end) = (first, first + table.rows.len());
            first = end;
            let (turn, base, period, rest) = match table.turn {
                None => (NEVER, 0, 0, 0),
                Some(Turn { from, base, period }) => {
                    let below = PERIOD_BITS - 16;
                    // The player's times wrap with 32 bits of ticks, so the period may wrap, too.
                    ((begin + from) as u16, base, (period >> below) as u64, period as u32)
                }
            };
            Plan { first: begin as u16, end: end as u16, turn, base, period, rest, wires }
        });
        plans.collect()
    }
}

/// For how many loops of 4 cycles STEP is high: as long as the slowest driver needs.
fn pulse_loops(wires: &[Wires]) -> u16 {
    let ticks = wires.iter().map(|wires| wires.pulse.min(LONGEST)).max().unwrap_or(0);
    ticks.div_ceil(4).max(1) as u16
}

/// The least distance of a motor's steps in the plan, ticks. The first of two steps may be late, by the steps and
/// reversals of all other motors, and the second may be in time. STEP must be low between them all the same.
fn shortest_intervals(wires: &[Wires]) -> impl Iterator<Item = u64> + '_ {
    let pulse = 4 * u64::from(pulse_loops(wires));
    let steps = (wires.len() as u64 - 1) * (pulse + NEXT_CYCLES);
    let turns: u64 = wires.iter().map(|wires| NEXT_CYCLES + wires.hold + wires.setup).sum();
    wires.iter().map(move |wires| steps + turns + pulse + NEXT_CYCLES.max(wires.low))
}

/// Where an Uno's pin is: its port B, C or D (0 to 2), and its bit there. `None` of a pin that cannot drive a motor.
pub(super) const fn place(pin: u8) -> Option<(usize, u8)> {
    match pin {
        2..=7 => Some((2, 1 << pin)),
        8..=13 => Some((0, 1 << (pin - 8))),
        14..=19 => Some((1, 1 << (pin - 14))),
        _ => None,
    }
}

impl Wires {
    fn of(motor: &Motor) -> Result<Wires, BakeError> {
        /// The lamp's pin, which bootloaders flash.
        const LAMP: u8 = 13;
        let refuse = |what: String| Err(BakeError::Wiring { motor: motor.name.clone(), what });
        let Wiring::StepDir { step, dir, forward_high, enable } = motor.wiring else {
            return refuse("its coils cannot be baked yet".to_owned());
        };
        if let Some((pin, _)) = enable.filter(|(pin, _)| place(*pin).is_none()) {
            return refuse(format!("an Uno has no pin {pin} for enable"));
        }
        if step == LAMP {
            return refuse(format!(
                "STEP is on pin {LAMP}, which the bootloader flashes at each power-up: steps that are not counted"
            ));
        }
        let timing = motor.timing.ticks(HZ);
        let (pulse, setup, hold) = (timing.pulse_high, timing.dir_setup, timing.dir_hold);
        for (what, ticks) in [("pulse_high", pulse), ("dir_setup", setup), ("dir_hold", hold)] {
            if ticks > LONGEST {
                let us = |ticks: u64| ticks as f64 / 16.0;
                return refuse(format!("{what} of {} us is too long: {} us at most", us(ticks), us(LONGEST)));
            }
        }
        // Masks of ports B and D.
        let mask = |pin: u8| match place(pin) {
            Some((0, bit)) => Some((bit, 0)),
            Some((2, bit)) => Some((0, bit)),
            _ => None,
        };
        let (Some(step), Some(dir)) = (mask(step), mask(dir)) else {
            return refuse(format!("STEP and DIR are on pins {step} and {dir}"));
        };
        Ok(Wires { step, dir, forward_high, pulse, low: timing.pulse_low, setup, hold })
    }
}
