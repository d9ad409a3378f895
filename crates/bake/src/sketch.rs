//! An Arduino sketch that plays tables: plain C++ with its tables in flash, and no library.

use std::fmt::Write as _;

use pulsetrain_motion::program::{Program, Wiring};

use crate::error::BakeError;
use crate::parts::{LEAD, Parts, Plan, Size, Wires};
use crate::table::Row;

/// The part of the program that is the same for every motion: the types of its tables, and the player.
const TYPES: &str = include_str!("types.h");
const PLAYER: &str = include_str!("player.h");

/// Bytes of flash for tables: 32 256, less the program and the Arduino core.
const TABLE_BYTES: usize = 32_256 - 4_096;

/// The mark by which `bake` knows a sketch that it has made.
pub const MADE: &str = "Made by pulsetrain bake";

/// An Arduino sketch.
#[derive(Clone, Debug)]
pub struct Sketch {
    /// The text of the .ino file.
    pub text: String,
    /// The size of its tables.
    pub size: Size,
}

impl Sketch {
    /// Makes the sketch of a program for the Uno. `title` is its name in its comments.
    ///
    /// # Errors
    /// [`BakeError`]: a driver has no STEP and DIR, a pin is not one of 2 to 13, or the motion is too fast or too large.
    pub fn new(program: &Program, title: &str) -> Result<Sketch, BakeError> {
        let parts = Parts::of(program, TABLE_BYTES)?;
        let Size { rows, bytes, .. } = parts.size;
        let (pulse, lamp) = (parts.pulse_loops(), parts.lamp());
        let mut text = format!(
            "// {title}\n// {MADE}: an Arduino Uno plays this motion by itself, from power-up on.\n\
             // {rows} rows of tables, {bytes} bytes of flash.\n\n#include <Arduino.h>\n#include <avr/pgmspace.h>\n\
             #include <avr/sleep.h>\n#include <util/delay_basic.h>\n\n#define MOST {motors}\nconst uint8_t MOTORS = MOST;\n\
             const uint16_t PULSE = {pulse}; // loops of 4 cycles in which STEP is high\n\
             const uint32_t LEAD = {LEAD};  // ticks before the motion begins\n\
             const uint8_t LAMP = {lamp}; // on port B\n\n",
            title = in_comment(title),
            motors = program.motors.len()
        );
        text += TYPES;
        text += &rows_and_plans(&parts);
        text += PLAYER;
        let _ = write!(
            text,
            "\nvoid setup() {{\n  // The Arduino core's clock would delay steps: millis() and delay() stand still from here on.\n  \
             TIMSK0 = 0;\n{}  prepare();\n}}\n\nvoid loop() {{\n  play();\n}}\n",
            pins(program)
        );
        Ok(Sketch { text, size: parts.size })
    }
}

fn rows_and_plans(parts: &Parts) -> String {
    let mut text = String::from("const Row rows[] PROGMEM = {\n");
    let mut plans = String::from("const Plan plans[MOST] = {\n");
    for Row { count, backward, ticks, part, add, add2 } in parts.tables.iter().flat_map(|table| &table.rows) {
        let steps = count | if *backward { 0x8000 } else { 0 };
        let _ = writeln!(text, "  {{ {steps}u, {part}u, {ticks}UL, {}, {} }},", number(*add), number(*add2));
    }
    for plan in parts.plans() {
        let Plan { first, end, turn, base, period, rest, wires } = plan;
        let Wires { step, dir, forward_high, setup, hold, .. } = wires;
        let _ = writeln!(
            plans,
            "  {{ {first}, {end}, {turn}u, {}, {}, {rest}UL, {}, {}, {}, {}, {}, {setup}, {hold} }},",
            fixed(base),
            fixed(period),
            step.0,
            step.1,
            dir.0,
            dir.1,
            u8::from(*forward_high)
        );
    }
    text + "};\n\n" + &plans + "};\n\n"
}

/// Ticks · 2^-16 as the sketch's `Fixed`.
fn fixed(value: u64) -> String {
    format!("{{ {}u, {}UL }}", value & 0xffff, (value >> 16) & 0xffff_ffff)
}

/// The least number of 32 bits has no literal in C.
fn number(value: i32) -> String {
    if value == i32::MIN { "(-2147483647L - 1)".to_owned() } else { format!("{value}L") }
}

fn pins(program: &Program) -> String {
    let mut text = String::new();
    for motor in &program.motors {
        let Wiring::StepDir { step, dir, enable, .. } = motor.wiring else { continue };
        let _ = writeln!(text, "  pinMode({step}, OUTPUT); // {}", in_comment(&motor.name));
        let _ = writeln!(text, "  pinMode({dir}, OUTPUT);");
        if let Some((pin, level)) = enable {
            let _ = writeln!(text, "  digitalWrite({pin}, {});", if level { "HIGH" } else { "LOW" });
            let _ = writeln!(text, "  pinMode({pin}, OUTPUT);");
        }
    }
    text
}

/// A line's comment ends with the line, and a backslash at its end would make the next line part of the comment.
fn in_comment(text: &str) -> String {
    text.replace(|c: char| c.is_control() || c == '\\', " ")
}
