//! steps.csv: one row for each step, in plain CSV with one header line.
//!
//! ```text
//! time_s,motor,tick,direction,position_steps
//! 0.00503325,wheel,80532,1,1
//! ```
//!
//! `time_s` is the tick in seconds, as the nearest f64. So the reader knows the tick rate from any row. `direction` is 1 or −1, `position_steps`
//! counts from 0. Files of earlier versions, with the tick rate in a comment before their header, are read too.

use std::io::{self, Write};

use pulsetrain_motion::columns::{CsvTable, Stated};
use pulsetrain_motion::quantity::Base;

use crate::ReadError;

const HEADER: &str = "time_s,motor,tick,direction,position_steps";
/// How the comment of earlier versions gives the tick rate.
const TICK_HZ: &str = "tick_hz =";
/// The fastest clock whose rate a time in f64 gives exactly, Hz.
const FASTEST_HZ: f64 = 1e12;

/// One step of one motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// Index in the trace's `motors`.
    pub motor: u8,
    /// The time, in ticks of the trace.
    pub tick: u64,
    /// Whether the position counts up.
    pub forward: bool,
}

/// A trace of steps in order of time, without the edges that made them.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StepTrace {
    /// Ticks per second.
    pub tick_hz: u64,
    /// The names that [`Step::motor`] refers to, at most 256.
    pub motors: Vec<String>,
    /// The steps, in order of time for each motor.
    pub steps: Vec<Step>,
}

/// Writes steps.csv, one step after the other. Positions count from 0.
pub struct StepWriter<W: Write> {
    out: W,
    tick_hz: u64,
    motors: Vec<(String, i64)>,
}

impl<W: Write> StepWriter<W> {
    /// Writes the head of the file.
    ///
    /// # Errors
    /// Errors of `out`.
    pub fn new(mut out: W, tick_hz: u64, motors: &[String]) -> io::Result<StepWriter<W>> {
        writeln!(out, "{HEADER}")?;
        Ok(StepWriter { out, tick_hz, motors: motors.iter().map(|name| (quoted(name), 0)).collect() })
    }

    /// Writes the row of a step.
    ///
    /// # Errors
    /// Errors of `out`; [`io::ErrorKind::InvalidInput`] if there is no such motor.
    pub fn push(&mut self, step: Step) -> io::Result<()> {
        let Some((name, position)) = self.motors.get_mut(usize::from(step.motor)) else {
            return Err(io::Error::new(io::ErrorKind::InvalidInput, format!("no motor {}", step.motor)));
        };
        let dir = if step.forward { 1 } else { -1 };
        *position += dir;
        writeln!(self.out, "{},{name},{},{dir},{position}", time_s(step.tick, self.tick_hz), step.tick)
    }

    /// Flushes the file and returns `out`.
    ///
    /// # Errors
    /// Errors of `out`.
    pub fn finish(mut self) -> io::Result<W> {
        self.out.flush()?;
        Ok(self.out)
    }
}

/// Approximate size of a step's row, bytes, `at_s` seconds after the beginning. It is for estimates.
#[must_use]
pub fn row_bytes(motor: &str, tick_hz: u64, at_s: f64) -> f64 {
    /// Bytes of four commas, a direction of one or two characters, and a line end.
    const MARKS: f64 = 6.5;
    /// Digits of a typical position: most motions stay within a few turns.
    const POSITION: f64 = 4.0;
    let ticks = (at_s * tick_hz as f64).max(1.0);
    // An odd tick, whose time has as many decimals as any.
    let time = time_s(ticks as u64 | 1, tick_hz).to_string().len();
    quoted(motor).len() as f64 + time as f64 + libm::log10(ticks).ceil() + POSITION + MARKS
}

/// A tick's time, s.
fn time_s(tick: u64, tick_hz: u64) -> f64 {
    tick as f64 / tick_hz as f64
}

/// Writes all of a trace.
///
/// # Errors
/// As [`StepWriter::push`].
pub fn write(trace: &StepTrace, out: impl Write) -> io::Result<()> {
    let mut writer = StepWriter::new(out, trace.tick_hz, &trace.motors)?;
    trace.steps.iter().try_for_each(|step| writer.push(*step))?;
    writer.finish().map(drop)
}

/// A name as a CSV field. One that a spreadsheet would take for a formula gets an apostrophe before it, as spreadsheets mark text.
fn quoted(name: &str) -> String {
    if is_formula(name) {
        format!("\"'{}\"", name.replace('"', "\"\""))
    } else if name.contains([',', ';', '"', '\n', '\r', '\t', '#']) || name.trim() != name {
        format!("\"{}\"", name.replace('"', "\"\""))
    } else {
        name.to_owned()
    }
}

/// Whether a spreadsheet would work a text out, or would if an apostrophe before it were gone. Source: OWASP, "CSV Injection".
fn is_formula(name: &str) -> bool {
    // Of full width, as some keyboards have them, too.
    name.trim_start_matches('\'').trim_start().starts_with(['=', '+', '-', '@', '＝', '＋', '－', '＠'])
        || name.trim_start_matches('\'').starts_with(['\t', '\r', '\n'])
}

/// The name that [`quoted`] wrote.
fn unquoted(field: &str) -> &str {
    field.strip_prefix('\'').filter(|name| is_formula(name)).unwrap_or(field)
}

/// Reads steps.csv.
///
/// # Errors
/// If the columns are wrong, a time does not belong to its tick, a motor's ticks go back, or a position does not follow from the one before.
pub fn read(bytes: &[u8]) -> Result<StepTrace, ReadError> {
    let mut table = CsvTable::new(bytes);
    let header = table.header()?;
    if !header.is_there() {
        return Err(header.error(format!("the header `{HEADER}`"), "none"));
    }
    let has = |name: &str| header.titles.iter().any(|title| title.is_called(name));
    let column = |name: &str, base: Base| {
        let column = header.column(name)?;
        match &header.titles[column].unit {
            Stated::Nothing => Ok(column),
            Stated::Unit(unit) if unit.base == base => Ok(column),
            _ => Err(header.error_in(column, format!("`{name}`: ticks and steps have no other unit"))),
        }
    };
    let name = header.column("motor")?;
    let tick = column("tick", Base::Tick)?;
    let direction = column(if has("direction") { "direction" } else { "dir" }, Base::Step)?;
    let position = column("position", Base::Step)?;
    let mut rate = match commented_tick_hz(bytes) {
        Some(tick_hz) => Rate::Known(tick_hz),
        None => Rate::ByTime { column: header.column("time_s")?, last: None },
    };
    let mut trace = StepTrace::default();
    let mut last: Vec<(u64, i64)> = Vec::new();
    while let Some(row) = table.next()? {
        let motor_name = unquoted(row.text(name)?);
        let motor = match trace.motors.iter().position(|known| known == motor_name) {
            Some(motor) => motor,
            None if motor_name.is_empty() => return Err(row.error(name, "a motor's name")),
            None if trace.motors.len() == 256 => return Err(row.error(name, "no more than 256 motors")),
            None => {
                trace.motors.push(motor_name.to_owned());
                last.push((0, 0));
                last.len() - 1
            }
        };
        let (last_tick, last_position) = last[motor];
        let at: u64 = row.parse(tick, "a tick, a whole number")?;
        if at < last_tick {
            return Err(row.error(tick, format!("a tick not before {last_tick}")));
        }
        if let Rate::ByTime { column, last } = &mut rate {
            let time_s: f64 = row.parse(*column, "a time in seconds")?;
            let fits = last.is_none_or(|known: TickTime| known.fits(at, time_s));
            if !fits || !time_s.is_finite() || (at == 0) != (time_s == 0.0) || time_s < 0.0 {
                return Err(row.error(*column, format!("the time of tick {at}, at the tick rate of the rows before")));
            }
            // The longest time gives the rate best.
            if last.is_none_or(|known| at > known.tick) {
                *last = Some(TickTime { tick: at, time_s });
            }
        }
        let forward = match row.get(direction) {
            b"1" | b"+1" => true,
            b"-1" => false,
            _ => return Err(row.error(direction, "1 or -1")),
        };
        let now: i64 = row.parse(position, "a position, a whole number")?;
        let wanted = if forward { last_position.checked_add(1) } else { last_position.checked_sub(1) };
        if Some(now) != wanted {
            return Err(row.error(position, format!("the position after {last_position} and this step")));
        }
        last[motor] = (at, now);
        // At most 256 motors, checked above.
        trace.steps.push(Step { motor: motor as u8, tick: at, forward });
    }
    trace.tick_hz = match rate {
        Rate::Known(tick_hz) => tick_hz,
        Rate::ByTime { last: Some(known), .. } if known.tick > 0 => {
            known.tick_hz().ok_or_else(|| header.error("a tick rate from 1 Hz to 1e12 Hz", "times that give none"))?
        }
        // Without steps any rate says the same.
        Rate::ByTime { .. } => 1,
    };
    Ok(trace)
}

/// How the reader knows the tick rate.
enum Rate {
    Known(u64),
    ByTime { column: usize, last: Option<TickTime> },
}

/// A tick and its time.
#[derive(Clone, Copy)]
struct TickTime {
    tick: u64,
    time_s: f64,
}

impl TickTime {
    /// Whether another tick's time has the same rate, within half a tick. Times near 0 say nothing about the rate.
    fn fits(self, tick: u64, time_s: f64) -> bool {
        if self.tick == 0 || tick == 0 {
            return true;
        }
        let (long, short) = if self.tick > tick {
            ((self.tick, self.time_s), (tick, time_s))
        } else {
            ((tick, time_s), (self.tick, self.time_s))
        };
        (short.1 * (long.0 as f64 / long.1) - short.0 as f64).abs() < 0.5
    }

    fn tick_hz(self) -> Option<u64> {
        let hz = (self.tick as f64 / self.time_s).round();
        (1.0..=FASTEST_HZ).contains(&hz).then_some(hz as u64)
    }
}

/// The tick rate from the comment at the head of earlier versions' files.
fn commented_tick_hz(bytes: &[u8]) -> Option<u64> {
    let first = bytes.split(|b| *b == b'\n').next().unwrap_or_default();
    let text = String::from_utf8_lossy(first);
    let (_, number) = text.starts_with('#').then(|| text.split_once(TICK_HZ)).flatten()?;
    number.trim().parse().ok().filter(|hz| *hz > 0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn errors_name_the_place() {
        let check = |rows: &str, expected: &str| {
            let error = read(rows.as_bytes()).unwrap_err();
            assert_eq!(error.to_string(), expected);
        };
        check("", "line 1, column 1: expected the header `time_s,motor,tick,direction,position_steps`, found none");
        check("motor,time\n", "line 1, column 1: expected a column `tick`, found `motor`, `time`");
        check(
            "motor,tick,dir,position\n",
            "line 1, column 1: expected a column `time_s`, found `motor`, `tick`, `dir`, `position`",
        );
        check(
            "time_s,motor,tick [ms],dir,position\n",
            "line 1, column 14: expected `tick`: ticks and steps have no other unit, found `tick [ms]`",
        );
        check(
            "dir,position,tick,tick,motor\n",
            "line 1, column 1: expected one column `tick`, found column 3 `tick` and column 4 `tick`",
        );
        let with = |row: &str| format!("{HEADER}\n0.5,w,5,1,1\n{row}");
        check(&with("0.5,w,x,1,2"), "line 3, column 7: expected a tick, a whole number, found `x`");
        check(&with("0.4,w,4,1,2"), "line 3, column 7: expected a tick not before 5, found `4`");
        check(&with("0.6,w,6,0,2"), "line 3, column 9: expected 1 or -1, found `0`");
        check(&with("0.6,w,6,1,3"), "line 3, column 11: expected the position after 1 and this step, found `3`");
        for time in ["0.8", "-0.6", "inf", "0"] {
            check(
                &with(&format!("{time},w,6,1,2")),
                &format!(
                    "line 3, column 1: expected the time of tick 6, at the tick rate of the rows before, found `{time}`"
                ),
            );
        }
        check(&with("soon,w,6,1,2"), "line 3, column 1: expected a time in seconds, found `soon`");
        check(
            &format!("{HEADER}\n1e9,w,5,1,1\n"),
            "line 1, column 1: expected a tick rate from 1 Hz to 1e12 Hz, found times that give none",
        );
    }

    #[test]
    fn columns_go_by_their_names() {
        let plain = read(format!("{HEADER}\n0.5,w,5,1,1\n0.7,w,7,-1,0\n").as_bytes()).unwrap();
        assert_eq!((plain.tick_hz, plain.steps.len()), (10, 2));
        let other = b"n;Position;tick;Motor;Direction;time_s\n0;1;5;w;1;0.5\n1;0;7;w;-1;0.7\n";
        assert_eq!(read(other).unwrap(), plain);
        let earlier = b"# pulsetrain steps, tick_hz = 10\nmotor,tick,dir,position\nw,5,1,1\nw,7,-1,0\n";
        assert_eq!(read(earlier).unwrap(), plain);
    }

    /// Boards with clocks that are off, and ticks whose times have no short decimal.
    #[test]
    fn every_rate_is_known_from_a_single_row() {
        for tick_hz in [1, 16_000_000, 15_987_431, 42_000_000, 125_000_000, 999_999_999_999] {
            for tick in [1, 3, 80_532, 3_600 * tick_hz + 1] {
                let trace = StepTrace {
                    tick_hz,
                    motors: vec!["w".into()],
                    steps: vec![Step { motor: 0, tick, forward: true }],
                };
                let mut file = Vec::new();
                write(&trace, &mut file).unwrap();
                assert_eq!(read(&file).unwrap(), trace, "{tick_hz} {tick}");
            }
        }
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(
            tick_hz in 1u64..1_000_000_000_000,
            names in proptest::collection::hash_set("[a-z,;\" #'=+@\t-]{0,6}x", 1..4),
            moves in proptest::collection::vec((0u8..4, any::<u32>(), any::<bool>()), 0..50),
        ) {
            let names: Vec<String> = names.into_iter().map(|n| n.trim().to_owned()).collect();
            let mut trace = StepTrace { tick_hz, ..StepTrace::default() };
            let mut tick = 0;
            for (motor, wait, forward) in moves {
                // Motors are numbered in the order in which they first appear, as a reader must.
                let name = &names[usize::from(motor) % names.len()];
                let motor = trace.motors.iter().position(|n| n == name).unwrap_or_else(|| {
                    trace.motors.push(name.clone());
                    trace.motors.len() - 1
                }) as u8;
                tick += u64::from(wait);
                trace.steps.push(Step { motor, tick, forward });
            }
            if tick == 0 {
                trace.tick_hz = 1;
            }
            let mut file = Vec::new();
            write(&trace, &mut file).unwrap();
            prop_assert_eq!(read(&file).unwrap(), trace);
        }

        #[test]
        fn any_bytes_are_read_or_refused(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            let _ = read(&bytes);
            for head in ["# pulsetrain steps, tick_hz = 7\nmotor,tick,dir,position\n", "time_s,motor,tick,direction,position_steps\n"] {
                let _ = read(&[head.as_bytes(), &bytes].concat());
            }
        }
    }
}
