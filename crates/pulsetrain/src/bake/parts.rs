//! What the player on an Uno (`player.h`) is told of a motion: tables, lines, times.

use pulsetrain_motion::program::{Motor, Program, Wiring};

use super::table::{PERIOD_BITS, Row, Table, Turn};
use super::{BakeError, tables};

/// Steps a second that the player works out, of all motors together: measured on the emulated chip with Debian's avr-gcc
/// (`tests/baked.rs` has the tutorial's 12 600), and some to spare.
const MOST_STEPS_PER_S: f64 = 14_000.0;

/// Ticks from the start of the counter to the motion's time zero: the first events are worked out before.
pub(super) const LEAD: u32 = 16_000;

/// What stands for a row that there is none of.
const NEVER: u16 = 0xffff;

/// What a baked motion takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size {
    /// Rows of all tables.
    pub rows: usize,
    /// Bytes of them.
    pub bytes: usize,
    /// Whether any motor goes on for ever.
    pub endless: bool,
}

/// A motion as the player takes it.
pub(super) struct Parts {
    pub(super) tables: Vec<Table>,
    pub(super) wires: Vec<Wires>,
    pub(super) size: Size,
}

/// A motor's lines as masks of ports B and D, and its times, ticks.
pub(super) struct Wires {
    pub(super) step: (u8, u8),
    pub(super) dir: (u8, u8),
    pub(super) forward_high: bool,
    pub(super) pulse: u64,
    pub(super) setup: u64,
    pub(super) clear: u64,
}

/// What `player.h` calls a Plan.
pub(super) struct Plan<'a> {
    /// Rows, counted through all tables.
    pub(super) first: u16,
    pub(super) end: u16,
    pub(super) turn: u16,
    /// Ticks · 2^-16, 48 bits.
    pub(super) base: u64,
    pub(super) period: u64,
    /// Of the period, ticks · 2^-48.
    pub(super) rest: u32,
    pub(super) wires: &'a Wires,
}

impl Parts {
    /// `room`: bytes for rows.
    pub(super) fn of(program: &Program, room: usize) -> Result<Parts, BakeError> {
        if program.board.name != "uno" {
            return Err(BakeError::Board { board: program.board.name.clone() });
        }
        let wires: Vec<Wires> = program.motors.iter().map(Wires::of).collect::<Result<_, _>>()?;
        let tables = tables(program)?;
        let hz = program.board.tick_hz as f64;
        let rate_hz = tables.iter().map(|table| hz / table.shortest as f64).sum::<f64>();
        if rate_hz > MOST_STEPS_PER_S {
            return Err(BakeError::TooFast { rate_hz, limit_hz: MOST_STEPS_PER_S });
        }
        let rows: usize = tables.iter().map(|table| table.rows.len()).sum();
        let bytes = rows * Row::BYTES;
        if bytes > room {
            return Err(BakeError::TooLarge { bytes, limit: room });
        }
        let endless = tables.iter().any(|table| table.turn.is_some());
        Ok(Parts { tables, wires, size: Size { rows, bytes, endless } })
    }

    /// STEP is high for so many loops of 4 cycles, as long as the slowest driver needs.
    pub(super) fn pulse_loops(&self) -> u16 {
        let ticks = self.wires.iter().map(|wires| wires.pulse).max().unwrap_or(0);
        u16::try_from(ticks.div_ceil(4).max(1)).unwrap_or(u16::MAX)
    }

    /// The Uno's lamp, pin 13, unless a motor has it.
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
                    // Times wrap with 32 bits of ticks: so may the period.
                    ((begin + from) as u16, base, (period >> below) as u64, period as u32)
                }
            };
            Plan { first: begin as u16, end: end as u16, turn, base, period, rest, wires }
        });
        plans.collect()
    }
}

impl Wires {
    fn of(motor: &Motor) -> Result<Wires, BakeError> {
        let refuse = |what: String| BakeError::Wiring { motor: motor.name.clone(), what };
        let Wiring::StepDir { step, dir, forward_high, enable } = motor.wiring else {
            return Err(refuse("its coils cannot be baked yet".to_owned()));
        };
        if let Some((pin, _)) = enable.filter(|(pin, _)| !(2..=19).contains(pin)) {
            return Err(refuse(format!("an Uno has no pin {pin} for enable")));
        }
        let mask = |pin: u8| match pin {
            2..=7 => Ok((0, 1 << pin)),
            8..=13 => Ok((1 << (pin - 8), 0)),
            _ => Err(refuse(format!("STEP and DIR cannot be on pin {pin}"))),
        };
        let timing = motor.timing.ticks(16_000_000);
        Ok(Wires {
            step: mask(step)?,
            dir: mask(dir)?,
            forward_high,
            pulse: timing.pulse_high,
            setup: timing.dir_setup,
            clear: timing.pulse_high + timing.dir_hold,
        })
    }
}
