//! An image of an Uno's flash that plays a motion from power-up on: a player that was compiled beforehand, and tables behind it.

use std::fmt::Write as _;

use pulsetrain_board::{hex, stk500};
use pulsetrain_motion::program::{Program, Wiring};

use super::BakeError;
use super::parts::{LEAD, MOST, Parts, Plan, Size, place};

/// What `cargo xtask firmware uno` builds of `player.cpp`.
const PLAYER: &str = include_str!("player.hex");

/// Where tables begin, as `player.cpp` has it.
const TABLES: usize = 0x0c00;
/// Bytes of `player.cpp`'s Head, and of a Plan.
const HEAD: usize = 17;
const PLAN: usize = 31;
/// Bytes of flash that are left for rows, with as many motors as there can be.
const ROOM: usize = stk500::room(stk500::RATES[0]) - TABLES - HEAD - MOST * PLAN;

/// An image of an Uno's flash.
#[derive(Clone, Debug)]
pub struct Image {
    /// From address 0 on.
    pub flash: Vec<u8>,
    /// What its tables take.
    pub size: Size,
}

impl Image {
    /// The image of a program for the Uno.
    ///
    /// # Errors
    /// As [`Sketch::new`](super::Sketch::new).
    pub fn new(program: &Program) -> Result<Image, BakeError> {
        let parts = Parts::of(program, ROOM)?;
        let mut flash = hex::parse(PLAYER, TABLES).map_err(|error| BakeError::Player { what: error.to_string() })?;
        flash.resize(TABLES, 0xff);
        flash.extend(head(program, &parts));
        for plan in parts.plans() {
            flash.extend(bytes_of(&plan));
        }
        for row in parts.tables.iter().flat_map(|table| &table.rows) {
            let steps = row.count | if row.backward { 0x8000 } else { 0 };
            flash.extend(steps.to_le_bytes());
            flash.extend(row.part.to_le_bytes());
            flash.extend(row.ticks.to_le_bytes());
            flash.extend(row.add.to_le_bytes());
            flash.extend(row.add2.to_le_bytes());
        }
        Ok(Image { flash, size: parts.size })
    }

    /// As Intel HEX, which `pulsetrain flash` and avrdude take.
    #[must_use]
    pub fn hex(&self) -> String {
        let mut text = String::new();
        for (number, bytes) in self.flash.chunks(16).enumerate() {
            let [high, low] = ((16 * number) as u16).to_be_bytes();
            let record = [&[bytes.len() as u8, high, low, 0], bytes].concat();
            let sum = record.iter().fold(0u8, |sum, byte| sum.wrapping_sub(*byte));
            text.push(':');
            for byte in record.iter().chain([&sum]) {
                let _ = write!(text, "{byte:02X}");
            }
            text.push('\n');
        }
        text + ":00000001FF\n"
    }
}

/// `player.cpp`'s Head.
fn head(program: &Program, parts: &Parts) -> Vec<u8> {
    // DDRB, DDRC, DDRD; PORTB, PORTC, PORTD.
    let (mut ddr, mut port) = ([0u8; 3], [0u8; 3]);
    for motor in &program.motors {
        let Wiring::StepDir { step, dir, enable, .. } = motor.wiring else { continue };
        for (pin, high) in [(step, false), (dir, false)].into_iter().chain(enable) {
            let Some((row, bit)) = place(pin) else { continue };
            ddr[row] |= bit;
            port[row] |= if high { bit } else { 0 };
        }
    }
    let mut head = b"PT1".to_vec();
    head.push(program.motors.len() as u8);
    head.extend(parts.pulse_loops().to_le_bytes());
    head.extend(LEAD.to_le_bytes());
    head.extend(ddr);
    head.extend(port);
    head.push(parts.lamp());
    debug_assert_eq!(head.len(), HEAD);
    head
}

/// `types.h`'s Plan: no byte lies between its fields on an AVR.
fn bytes_of(plan: &Plan<'_>) -> Vec<u8> {
    let wires = plan.wires;
    // Its Fixed: 16 bits of part, 32 of ticks.
    let fixed = |value: u64| value.to_le_bytes()[..6].to_vec();
    let mut bytes = Vec::new();
    for row in [plan.first, plan.end, plan.turn] {
        bytes.extend(row.to_le_bytes());
    }
    bytes.extend(fixed(plan.base));
    bytes.extend(fixed(plan.period));
    bytes.extend(plan.rest.to_le_bytes());
    bytes.extend([wires.step.0, wires.step.1, wires.dir.0, wires.dir.1, u8::from(wires.forward_high)]);
    for ticks in [wires.setup, wires.hold] {
        bytes.extend((ticks as u16).to_le_bytes());
    }
    debug_assert_eq!(bytes.len(), PLAN);
    bytes
}
