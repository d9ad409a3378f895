//! VCD files: IEEE 1364-2005 §18, as simulators, PulseView and GTKWave write and read them.
//!
//! # Time
//! A tick of 16 MHz is 62.5 ns. The file gets the coarsest timescale of 1, 10 or 100 units in which a tick is a whole
//! number (here 100 ps). If there is none down to 1 ps (42 MHz), times are rounded to the nearest 1 ps, and the tick
//! rate in the file's comment restores every tick exactly. For a file without that comment, the timescale is the tick.

use std::io::{self, Read, Write};

use vcd::{Command, IdCode, Parser, TimescaleUnit, Value};

use crate::{Edge, Line, ReadError, Trace};

const TICK_HZ: &str = "pulsetrain tick_hz =";

/// Timescales of VCD, coarse to fine: (multiple, unit, units per second).
const TIMESCALES: [(u32, TimescaleUnit, u64); 13] = {
    use TimescaleUnit::{MS, NS, PS, S, US};
    [
        (1, S, 1),
        (100, MS, 10),
        (10, MS, 100),
        (1, MS, 1_000),
        (100, US, 10_000),
        (10, US, 100_000),
        (1, US, 1_000_000),
        (100, NS, 10_000_000),
        (10, NS, 100_000_000),
        (1, NS, 1_000_000_000),
        (100, PS, 10_000_000_000),
        (10, PS, 100_000_000_000),
        (1, PS, 1_000_000_000_000),
    ]
};

/// Converts ticks of `from_hz` to the nearest ticks of `to_hz`; `None` if the result does not fit.
fn rescaled(ticks: u64, from_hz: u64, to_hz: u64) -> Option<u64> {
    let scaled = u128::from(ticks) * u128::from(to_hz);
    u64::try_from((scaled + u128::from(from_hz) / 2) / u128::from(from_hz)).ok()
}

/// Writes a VCD file, one edge after the other.
pub struct EdgeWriter<W: Write> {
    out: vcd::Writer<W>,
    ids: Vec<IdCode>,
    tick_hz: u64,
    units_hz: u64,
    last: Option<u64>,
}

/// The coarsest timescale in which ticks are whole numbers, or the finest if there is none.
fn timescale(tick_hz: u64) -> (u32, TimescaleUnit, u64) {
    let exact = TIMESCALES.iter().find(|(_, _, hz)| hz % tick_hz == 0);
    *exact.unwrap_or(&TIMESCALES[TIMESCALES.len() - 1])
}

/// Approximate size of an edge with a time of its own, bytes, `at_s` seconds after the beginning. It is for estimates.
#[must_use]
pub fn edge_bytes(tick_hz: u64, at_s: f64) -> f64 {
    // A "#", the time and a line end; then a level, the line's code and a line end.
    let (_, _, units_hz) = timescale(tick_hz.max(1));
    5.0 + libm::log10((at_s * units_hz as f64).max(1.0)).ceil()
}

impl<W: Write> EdgeWriter<W> {
    /// Writes the head: a scope for each motor, a signal for each name of each line (a shared DIR line has several
    /// names), and the levels before the first edge.
    ///
    /// # Errors
    /// Errors of `out`; [`io::ErrorKind::InvalidInput`] for a tick rate of 0 or beyond 10^12 Hz.
    pub fn new(out: W, tick_hz: u64, lines: &[Line]) -> io::Result<EdgeWriter<W>> {
        if tick_hz == 0 || tick_hz > 1_000_000_000_000 {
            return Err(invalid(format!("a tick rate of {tick_hz} Hz; 1 to 10^12 can be written")));
        }
        let (multiple, unit, units_hz) = timescale(tick_hz);
        let mut out = vcd::Writer::new(out);
        out.comment(&format!("{TICK_HZ} {tick_hz}"))?;
        out.timescale(multiple, unit)?;
        let ids: Vec<IdCode> = (0..lines.len() as u32).map(IdCode::from).collect();
        let mut scopes: Vec<(String, Vec<(IdCode, String)>)> = Vec::new();
        for (line, id) in lines.iter().zip(&ids) {
            for name in &line.names {
                let (scope, signal) = name.rsplit_once('.').unwrap_or(("pins", name));
                let scope = word(scope);
                let signals = match scopes.iter().position(|(known, _)| *known == scope) {
                    Some(i) => &mut scopes[i].1,
                    None => {
                        scopes.push((scope, Vec::new()));
                        &mut scopes.last_mut().expect("just pushed").1
                    }
                };
                signals.push((*id, word(signal)));
            }
        }
        for (scope, signals) in scopes {
            out.add_module(&scope)?;
            for (id, signal) in signals {
                out.var_def(vcd::VarType::Wire, 1, id, &signal, None)?;
            }
            out.upscope()?;
        }
        out.enddefinitions()?;
        out.begin(vcd::SimulationCommand::Dumpvars)?;
        for (line, id) in lines.iter().zip(&ids) {
            out.change_scalar(*id, line.initial)?;
        }
        out.end()?;
        Ok(EdgeWriter { out, ids, tick_hz, units_hz, last: None })
    }

    /// Writes an edge. Edges must come in order of time.
    ///
    /// # Errors
    /// Errors of `out`; [`io::ErrorKind::InvalidInput`] for an unknown line, a tick before the last one, or a time that
    /// does not fit into 64 bits.
    pub fn push(&mut self, edge: Edge) -> io::Result<()> {
        let Some(id) = self.ids.get(usize::from(edge.line)) else {
            return Err(invalid(format!("no line {}", edge.line)));
        };
        if self.last != Some(edge.tick) {
            if let Some(last) = self.last.filter(|last| edge.tick < *last) {
                return Err(invalid(format!("an edge at tick {} after tick {last}", edge.tick)));
            }
            self.last = Some(edge.tick);
            let time = rescaled(edge.tick, self.tick_hz, self.units_hz)
                .ok_or_else(|| invalid(format!("tick {} in a file of {} Hz", edge.tick, self.units_hz)))?;
            self.out.timestamp(time)?;
        }
        self.out.change_scalar(*id, edge.level)
    }

    /// Hands all edges until now on to the file.
    ///
    /// # Errors
    /// Errors of `out`.
    pub fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }

    /// Flushes the file.
    ///
    /// # Errors
    /// Errors of `out`.
    pub fn finish(mut self) -> io::Result<()> {
        self.out.flush()
    }
}

fn invalid(message: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, message)
}

/// A name as one VCD word.
fn word(name: &str) -> String {
    let word: String = name.chars().map(|c| if c.is_whitespace() || c == '$' { '_' } else { c }).collect();
    if word.is_empty() { "_".to_owned() } else { word }
}

/// Writes all of a trace.
///
/// # Errors
/// As [`EdgeWriter::push`].
pub fn write(trace: &Trace, out: impl Write) -> io::Result<()> {
    let mut writer = EdgeWriter::new(out, trace.tick_hz, &trace.lines)?;
    trace.edges.iter().try_for_each(|edge| writer.push(*edge))?;
    writer.finish()
}

/// Reads a VCD file. Signals of one bit become lines, named by their path ("top.D8"); other signals are ignored.
///
/// A value before or at the first time in the file is the initial level of its line. The values x and z change nothing.
///
/// # Errors
/// If it is not VCD, has no timescale, more than 256 lines, or time that goes back.
pub fn read(bytes: &[u8]) -> Result<Trace, ReadError> {
    // The parser needs white space after every word, but some writers do not end the file with a newline.
    let mut parser = Parser::new(bytes.chain(&b" "[..]));
    let mut units_hz = None;
    let mut tick_hz = None;
    let mut scopes: Vec<String> = Vec::new();
    // Signals with the same code are one wire.
    let mut lines: Vec<(IdCode, Line, Option<bool>)> = Vec::new();
    // `Parser::parse_header` recurses for each scope. A file with many scopes must not overflow the stack.
    loop {
        let command = parser.next().transpose().map_err(|e| read_error(&parser, &e))?;
        let line = parser.line();
        match command {
            Some(Command::Enddefinitions) => break,
            Some(Command::Comment(text)) => {
                if let Some(number) = text.strip_prefix(TICK_HZ) {
                    let hz: Option<u64> = number.trim().parse().ok().filter(|hz| (1..=1_000_000_000_000).contains(hz));
                    tick_hz =
                        Some(hz.ok_or_else(|| ReadError::new(line, 1, "a tick rate of 1 to 10^12 Hz", number.trim()))?);
                }
            }
            Some(Command::Timescale(multiple, unit)) => {
                let whole = unit.divisor().checked_div(u64::from(multiple)).filter(|hz| *hz > 0);
                let one_of = [1, 10, 100].contains(&multiple);
                units_hz = Some(whole.filter(|_| one_of).ok_or_else(|| {
                    ReadError::new(
                        line,
                        1,
                        "a timescale of 1, 10 or 100 units, at most 1 s",
                        format!("{multiple} {unit}"),
                    )
                })?);
            }
            Some(Command::ScopeDef(_, name)) => scopes.push(name),
            Some(Command::Upscope) => {
                scopes.pop();
            }
            Some(Command::VarDef(_, 1, code, name, index)) => {
                let mut path = scopes.join(".");
                if !path.is_empty() {
                    path.push('.');
                }
                path.push_str(&name);
                if let Some(index) = index {
                    path.push_str(&index.to_string());
                }
                match lines.iter().position(|(known, ..)| *known == code) {
                    Some(known) => lines[known].1.names.push(path),
                    None if lines.len() == 256 => {
                        return Err(ReadError::new(line, 1, "no more than 256 signals", path));
                    }
                    None => lines.push((code, Line::named(path), None)),
                }
            }
            Some(_) => {}
            None => return Err(ReadError::new(line, 1, "$enddefinitions", "the end of the file")),
        }
    }
    let Some(units_hz) = units_hz else {
        return Err(ReadError::new(parser.line(), 1, "a $timescale in the head", "none"));
    };
    let tick_hz = tick_hz.unwrap_or(units_hz);

    let mut edges = Vec::new();
    let mut time: Option<u64> = None;
    let mut tick = 0;
    let mut moved = false;
    while let Some(command) = parser.next() {
        let (code, value) = match command.map_err(|e| read_error(&parser, &e))? {
            Command::Timestamp(next) => {
                if let Some(last) = time.filter(|last| next < *last) {
                    return Err(ReadError::new(
                        parser.line(),
                        1,
                        format!("a time not before {last}"),
                        next.to_string(),
                    ));
                }
                moved = time.is_some_and(|last| moved || next > last);
                time = Some(next);
                tick = rescaled(next, units_hz, tick_hz)
                    .ok_or_else(|| ReadError::new(parser.line(), 1, "a time within 2^64 ticks", next.to_string()))?;
                continue;
            }
            Command::ChangeScalar(code, value) => (code, value),
            Command::ChangeVector(code, vector) => match vector.get(0) {
                Some(value) if vector.len() == 1 => (code, value),
                _ => continue,
            },
            _ => continue,
        };
        let level = match value {
            Value::V0 => false,
            Value::V1 => true,
            Value::X | Value::Z => continue,
        };
        let Some(line) = lines.iter().position(|(known, ..)| *known == code) else { continue };
        let (_, description, known) = &mut lines[line];
        match known.replace(level) {
            None if !moved => description.initial = level,
            Some(before) if before == level => {}
            // At most 256 lines, checked above.
            _ => edges.push(Edge { tick, line: line as u8, level }),
        }
    }
    Ok(Trace { tick_hz, lines: lines.into_iter().map(|(_, line, _)| line).collect(), edges })
}

fn read_error<R: io::BufRead>(parser: &Parser<R>, error: &io::Error) -> ReadError {
    ReadError::new(parser.line(), 1, "a VCD command", error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use expect_test::{Expect, expect};
    use proptest::prelude::*;

    fn trace(tick_hz: u64, edges: &[(u64, u8, bool)]) -> Trace {
        let shared = Line { names: vec!["a.dir".into(), "b.dir".into(), "pins.pin8".into()], initial: true };
        let lines = vec![Line::named("a.step"), shared, Line::named("b.step")];
        let edges = edges.iter().map(|&(tick, line, level)| Edge { tick, line, level }).collect();
        Trace { tick_hz, lines, edges }
    }

    #[test]
    fn a_shared_line_is_one_wire_with_many_names() {
        let check = |trace: &Trace, expected: Expect| {
            let mut file = Vec::new();
            write(trace, &mut file).unwrap();
            expected.assert_eq(std::str::from_utf8(&file).unwrap());
            assert_eq!(read(&file).unwrap(), *trace);
        };
        check(
            &trace(16_000_000, &[(0, 0, true), (3, 0, false), (3, 1, false), (7, 2, true)]),
            expect![[r#"
                $comment
                    pulsetrain tick_hz = 16000000
                $end
                $timescale 100 ps $end
                $scope module a $end
                $var wire 1 ! step $end
                $var wire 1 " dir $end
                $upscope $end
                $scope module b $end
                $var wire 1 " dir $end
                $var wire 1 # step $end
                $upscope $end
                $scope module pins $end
                $var wire 1 " pin8 $end
                $upscope $end
                $enddefinitions $end
                $dumpvars
                0!
                1"
                0#
                $end
                #0
                1!
                #1875
                0!
                0"
                #4375
                1#
            "#]],
        );
    }

    #[test]
    fn foreign_files() {
        let check = |file: &str, tick_hz: u64, initial: &[bool], edges: &[(u64, u8, bool)]| {
            let got = read(file.as_bytes()).unwrap();
            assert_eq!(got.tick_hz, tick_hz);
            assert_eq!(got.lines.iter().map(|l| l.initial).collect::<Vec<_>>(), initial);
            assert_eq!(got.edges, trace(1, edges).edges);
        };
        // PulseView gives the first levels at the first time.
        let head = "$timescale 1 us $end $scope module libsigrok $end $var wire 1 ! D8 $end $var wire 8 # bus $end \
                    $var wire 1 \" D9 $end $upscope $end $enddefinitions $end\n";
        check(
            &format!("{head}#5 1! 0\" b0101 #\n#7 0!\n#9 x! b1 \"\n"),
            1_000_000,
            &[true, false],
            &[(7, 0, false), (9, 1, true)],
        );
        // A line that first appears later has an edge there, from LOW; the file need not end with a newline.
        check(&format!("{head}#0 0!\n#4 1\"\n"), 1_000_000, &[false, false], &[(4, 1, true)]);
        check(&format!("{head}#0 0!\n#4 1\""), 1_000_000, &[false, false], &[(4, 1, true)]);
    }

    #[test]
    fn what_is_wrong_is_said_with_its_line() {
        let check = |file: &str, expected: &str| assert_eq!(read(file.as_bytes()).unwrap_err().to_string(), expected);
        check("", "line 1, column 1: expected $enddefinitions, found the end of the file");
        check("$enddefinitions $end\n", "line 1, column 1: expected a $timescale in the head, found none");
        check(
            "$timescale 3 ns $end\n",
            "line 1, column 1: expected a timescale of 1, 10 or 100 units, at most 1 s, found 3 ns",
        );
        check(
            "$timescale 1 ns $end\n$enddefinitions $end\n#5\n#4\n",
            "line 4, column 1: expected a time not before 5, found 4",
        );
        assert!(read(b"t,x\n1,2\n").is_err());
    }

    proptest! {
        /// 42 MHz has no exact timescale; its ticks come back all the same.
        #[test]
        fn what_is_written_is_read(
            tick_hz in prop_oneof![Just(16_000_000), Just(42_000_000), Just(125_000_000), 1u64..200_000_000],
            mut ticks in proptest::collection::vec(0u64..1 << 40, 0..60),
        ) {
            ticks.sort_unstable();
            // Every line changes level each time it is named.
            let edges: Vec<_> = ticks.iter().enumerate().map(|(i, &tick)| {
                let line = (i % 3) as u8;
                (tick, line, (i / 3 % 2 == 0) != (line == 1))
            }).collect();
            let trace = trace(tick_hz, &edges);
            let mut file = Vec::new();
            write(&trace, &mut file).unwrap();
            prop_assert_eq!(read(&file).unwrap(), trace);
        }

        #[test]
        fn any_bytes_are_read_or_refused(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            let _ = read(&bytes);
            let mut file = b"$timescale 1 fs $end $var wire 1 ! a $end $enddefinitions $end\n".to_vec();
            file.extend(&bytes);
            let _ = read(&file);
        }
    }
}
