//! An Arduino sketch that plays tables: plain C++, tables in flash, no library.

use std::fmt::Write as _;

use pulsetrain_motion::program::{Motor, Program, Wiring};

use super::table::{PERIOD_BITS, Row, Table, Turn};
use super::{BakeError, tables};

/// The program without what is a motion's own.
const PROGRAM: &str = include_str!("sketch.ino");

/// Bytes of flash that are left for tables: 32 256, less what the program and the Arduino core take.
const ROOM: usize = 32_256 - 4_096;

/// Steps a second that the sketch works out, of all motors together: measured on the emulated chip with Debian's avr-gcc
/// (`tests/sketch.rs`), and some to spare.
const MOST_STEPS_PER_S: f64 = 14_000.0;

/// Ticks from the start of the counter to the motion's time zero: the first events are worked out before.
const LEAD: u32 = 16_000;

/// DIR comes so many ticks before STEP where there is room.
const EARLY: u32 = 256;

/// Ticks from the match to the first edge, and how many it takes at least to leave the interrupt and enter it again.
/// Measured as above; another compiler moves edges of motors that step close together by some ticks.
const ENTRY: u32 = 40;
const RETURN: u32 = 80;

/// An Arduino sketch.
#[derive(Clone, Debug)]
pub struct Sketch {
    /// The text of the .ino file.
    pub text: String,
    /// Bytes of its tables.
    pub bytes: usize,
    /// Rows of its tables.
    pub rows: usize,
    /// Whether any motor goes on for ever.
    pub endless: bool,
}

impl Sketch {
    /// The sketch of a program for the Uno. `title`: what it is called in its comments.
    ///
    /// # Errors
    /// [`BakeError`]: what cannot be baked, other drivers than those with STEP and DIR, other pins than 2 to 13, too fast, too large.
    pub fn new(program: &Program, title: &str) -> Result<Sketch, BakeError> {
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
        if bytes > ROOM {
            return Err(BakeError::TooLarge { bytes, limit: ROOM });
        }
        let pulse = wires.iter().map(|wires| wires.pulse).max().unwrap_or(0);
        let mut text = format!(
            "// {title}\n// Made by pulsetrain bake: an Arduino Uno plays this motion by itself, from power-up on.\n\
             // {rows} rows of tables, {bytes} bytes of flash.\n\n#include <Arduino.h>\n#include <avr/pgmspace.h>\n\n\
             const uint8_t MOTORS = {};\n#define PULSE {pulse} // cycles that STEP is high, at least\n\
             const uint32_t LEAD = {LEAD};  // ticks before the motion begins\n\
             const uint32_t EARLY = {EARLY}; // ticks that DIR comes before STEP, where there is room\n\
             const int16_t ENTRY = {ENTRY}, RETURN = {RETURN}; // ticks from the match to the edge; to leave and come again\n\n",
            program.motors.len()
        );
        text += &PROGRAM.replace("@TABLES@\n", &rows_and_plans(&tables, &wires)).replace("@PINS@", &pins(program));
        let endless = tables.iter().any(|table| table.turn.is_some());
        Ok(Sketch { text, bytes, rows, endless })
    }
}

/// A motor's lines as masks of ports, and its times, ticks.
struct Wires {
    step: (u8, u8),
    dir: (u8, u8),
    forward_high: bool,
    pulse: u64,
    setup: u64,
    clear: u64,
}

impl Wires {
    fn of(motor: &Motor) -> Result<Wires, BakeError> {
        let refuse = |what: String| BakeError::Wiring { motor: motor.name.clone(), what };
        let Wiring::StepDir { step, dir, forward_high, .. } = motor.wiring else {
            return Err(refuse("coils are not for sketches yet".to_owned()));
        };
        let mask = |pin: u8| match pin {
            2..=7 => Ok((0, 1 << pin)),
            8..=13 => Ok((1 << (pin - 8), 0)),
            _ => Err(refuse(format!("pin {pin} is none that a sketch moves"))),
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

fn rows_and_plans(tables: &[Table], wires: &[Wires]) -> String {
    let mut text = String::from("const Row rows[] PROGMEM = {\n");
    let mut plans = String::from("const Plan plans[MOTORS] = {\n");
    let mut first = 0;
    for (table, wires) in tables.iter().zip(wires) {
        for Row { count, backward, ticks, part, add, add2 } in &table.rows {
            let steps = count | if *backward { 0x8000 } else { 0 };
            let _ = writeln!(text, "  {{ {steps}u, {part}u, {ticks}UL, {}, {} }},", number(*add), number(*add2));
        }
        let end = first + table.rows.len();
        let (turn, base, period, rest) = match table.turn {
            None => ("NEVER".to_owned(), fixed(0), fixed(0), 0),
            Some(Turn { from, base, period }) => {
                let below = PERIOD_BITS - 16;
                let rest = (period & ((1 << below) - 1)) as u32;
                // Times wrap with 32 bits of ticks: so may the period.
                (format!("{}", first + from), fixed(base), fixed((period >> below) as u64), rest)
            }
        };
        let Wires { step, dir, forward_high, setup, clear, .. } = wires;
        let _ = writeln!(
            plans,
            "  {{ {first}, {end}, {turn}, {base}, {period}, {rest}UL, {}, {}, {}, {}, {}, {setup}, {clear} }},",
            step.0,
            step.1,
            dir.0,
            dir.1,
            u8::from(*forward_high)
        );
        first = end;
    }
    text + "};\n\n" + &plans + "};\n\n"
}

/// Ticks · 2^-16 as the sketch's `Fixed`.
fn fixed(value: u64) -> String {
    format!("{{ {}u, {}UL }}", value & 0xffff, value >> 16 & 0xffff_ffff)
}

/// The least number of 32 bits has no literal in C.
fn number(value: i32) -> String {
    if value == i32::MIN { "(-2147483647L - 1)".to_owned() } else { format!("{value}L") }
}

fn pins(program: &Program) -> String {
    let mut text = String::new();
    for motor in &program.motors {
        let Wiring::StepDir { step, dir, enable, .. } = motor.wiring else { continue };
        let _ = writeln!(text, "  pinMode({step}, OUTPUT); // {}", motor.name.replace(|c: char| c.is_control(), " "));
        let _ = writeln!(text, "  pinMode({dir}, OUTPUT);");
        if let Some((pin, level)) = enable {
            let _ = writeln!(text, "  digitalWrite({pin}, {});", if level { "HIGH" } else { "LOW" });
            let _ = writeln!(text, "  pinMode({pin}, OUTPUT);");
        }
    }
    text
}
