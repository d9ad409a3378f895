//! steps.csv: one row for each step, `motor,tick,dir,position`.
//!
//! ```text
//! # pulsetrain steps, tick_hz = 16000000
//! motor,tick,dir,position
//! wheel,80532,1,1
//! ```

use std::io::{self, Write};

use pulsetrain_motion::columns::{CsvTable, Stated, shown};
use pulsetrain_motion::quantity::Base;

use crate::ReadError;

const HEADER: [&str; 4] = ["motor", "tick", "dir", "position"];
const TICK_HZ: &str = "tick_hz =";

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
    motors: Vec<(String, i64)>,
}

impl<W: Write> StepWriter<W> {
    /// Writes the head of the file.
    ///
    /// # Errors
    /// Errors of `out`.
    pub fn new(mut out: W, tick_hz: u64, motors: &[String]) -> io::Result<StepWriter<W>> {
        writeln!(out, "# pulsetrain steps, {TICK_HZ} {tick_hz}\n{}", HEADER.join(","))?;
        Ok(StepWriter { out, motors: motors.iter().map(|name| (quoted(name), 0)).collect() })
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
        writeln!(self.out, "{name},{},{dir},{position}", step.tick)
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
    /// Bytes of three commas, a direction of one or two characters, and a line end.
    const MARKS: f64 = 5.5;
    /// Digits of a typical position: most motions stay within a few turns.
    const POSITION: f64 = 4.0;
    quoted(motor).len() as f64 + (at_s * tick_hz as f64).max(1.0).log10().ceil() + POSITION + MARKS
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

/// A name as a CSV field.
fn quoted(name: &str) -> String {
    if name.contains([',', '"', '\n', '\r', '#']) || name.trim() != name {
        format!("\"{}\"", name.replace('"', "\"\""))
    } else {
        name.to_owned()
    }
}

/// Reads steps.csv.
///
/// # Errors
/// If there is no tick rate, the columns are wrong, a motor's ticks go back, or a position does not follow from the one
/// before.
pub fn read(bytes: &[u8]) -> Result<StepTrace, ReadError> {
    let tick_hz = tick_hz(bytes)?;
    let mut table = CsvTable::new(bytes);
    let header = table.header()?;
    if !header.is_there() {
        return Err(header.error("the header `motor,tick,dir,position`", "none"));
    }
    let mut columns = [0; HEADER.len()];
    for (column, name) in columns.iter_mut().zip(HEADER) {
        *column = header.column(name)?;
        match &header.titles[*column].unit {
            Stated::Nothing => {}
            Stated::Unit(unit) if matches!(unit.base, Base::Tick | Base::Step) => {}
            _ => return Err(header.error_in(*column, format!("`{name}`: ticks and steps have no other unit"))),
        }
    }
    let [name, tick, dir, position] = columns;
    let mut trace = StepTrace { tick_hz, ..StepTrace::default() };
    let mut last: Vec<(u64, i64)> = Vec::new();
    while let Some(row) = table.next()? {
        let motor_name = row.text(name)?;
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
        let forward = match row.get(dir) {
            b"1" | b"+1" => true,
            b"-1" => false,
            _ => return Err(row.error(dir, "1 or -1")),
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
    Ok(trace)
}

/// The tick rate from the comment at the head.
fn tick_hz(bytes: &[u8]) -> Result<u64, ReadError> {
    let first = bytes.split(|b| *b == b'\n').next().unwrap_or_default();
    let text = String::from_utf8_lossy(first);
    text.starts_with('#')
        .then(|| text.split_once(TICK_HZ))
        .flatten()
        .and_then(|(_, number)| number.trim().parse().ok())
        .filter(|hz| *hz > 0)
        .ok_or_else(|| ReadError::new(1, 1, "`# pulsetrain steps, tick_hz = 16000000` (or another rate)", shown(first)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn what_is_wrong_is_said_with_its_place() {
        let check = |rows: &str, expected: &str| {
            let error = read(format!("# pulsetrain steps, tick_hz = 1000\n{rows}").as_bytes()).unwrap_err();
            assert_eq!(error.to_string(), expected);
        };
        check("", "line 1, column 1: expected the header `motor,tick,dir,position`, found none");
        check("motor,time\n", "line 2, column 1: expected a column `tick`, found `motor`, `time`");
        check(
            "motor,tick [ms],dir,position\n",
            "line 2, column 7: expected `tick`: ticks and steps have no other unit, found `tick [ms]`",
        );
        check(
            "dir,position,tick,tick,motor\n",
            "line 2, column 1: expected one column `tick`, found column 3 `tick` and column 4 `tick`",
        );
        let with = |row: &str| format!("motor,tick,dir,position\nw,5,1,1\n{row}");
        check(&with("w,x,1,2"), "line 4, column 3: expected a tick, a whole number, found `x`");
        check(&with("w,4,1,2"), "line 4, column 3: expected a tick not before 5, found `4`");
        check(&with("w,6,0,2"), "line 4, column 5: expected 1 or -1, found `0`");
        check(&with("w,6,1,3"), "line 4, column 7: expected the position after 1 and this step, found `3`");
        assert_eq!(
            read(b"motor,tick,dir,position\n").unwrap_err().to_string(),
            "line 1, column 1: expected `# pulsetrain steps, tick_hz = 16000000` (or another rate), \
             found `motor,tick,dir,position`"
        );
    }

    #[test]
    fn columns_go_by_their_names() {
        let plain = read(b"# pulsetrain steps, tick_hz = 9\nmotor,tick,dir,position\nw,5,1,1\nw,7,-1,0\n").unwrap();
        let other = b"# pulsetrain steps, tick_hz = 9\nn;Position;tick;Motor;dir\n0;1;5;w;1\n1;0;7;w;-1\n";
        assert_eq!(read(other).unwrap(), plain);
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(
            tick_hz in 1u64..,
            names in proptest::collection::hash_set("[a-z,\" #]{0,6}x", 1..4),
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
            let mut file = Vec::new();
            write(&trace, &mut file).unwrap();
            prop_assert_eq!(read(&file).unwrap(), trace);
        }

        #[test]
        fn any_bytes_are_read_or_refused(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            let _ = read(&bytes);
            let mut file = b"# pulsetrain steps, tick_hz = 7\nmotor,tick,dir,position\n".to_vec();
            file.extend(&bytes);
            let _ = read(&file);
        }
    }
}
