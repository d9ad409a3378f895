//! The lines of a trace: their names, and the edges on them.

use pulsetrain_motion::program::{Program, Wiring};

/// A change of a line's level.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Edge {
    /// The time, in ticks of the trace.
    pub tick: u64,
    /// The line, as an index in the trace's `lines`.
    pub line: u8,
    /// The new level.
    pub level: bool,
}

/// A line: one wire.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Line {
    /// All of its names: "wheel.step", "pin8", or the name in a capture.
    pub names: Vec<String>,
    /// Its level before its first edge.
    pub initial: bool,
}

impl Line {
    /// A line with one name that starts LOW.
    #[must_use]
    pub fn named(name: impl Into<String>) -> Line {
        Line { names: vec![name.into()], initial: false }
    }
}

/// Edges in order of time.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Trace {
    /// Ticks per second.
    pub tick_hz: u64,
    /// The lines that [`Edge::line`] refers to, at most 256.
    pub lines: Vec<Line>,
    /// The edges in order of time. Edges of one tick are in any order.
    pub edges: Vec<Edge>,
}

impl Trace {
    /// Gives the line called `from` a second name, `to`. So users say what an analyser's channel is connected to.
    ///
    /// # Errors
    /// If no line is called `from`.
    pub fn alias(&mut self, from: &str, to: &str) -> Result<(), NoSuchLine> {
        let Some(line) = self.lines.iter_mut().find(|line| line.names.iter().any(|n| n.eq_ignore_ascii_case(from)))
        else {
            return Err(NoSuchLine { wanted: format!("called {from}"), found: list(&self.lines) });
        };
        line.names.push(to.to_owned());
        Ok(())
    }
}

/// A trace lacks a line.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the trace has no line {wanted}; it has {found}")]
pub struct NoSuchLine {
    /// The line that was looked for.
    pub wanted: String,
    /// The lines of the trace.
    pub found: String,
}

fn list(lines: &[Line]) -> String {
    let names: Vec<_> = lines.iter().filter_map(|line| line.names.first()).map(String::as_str).collect();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

/// The lines of a program, in the order of its motors: step and dir, or in1 to in4.
///
/// A DIR pin that motors share is one line with a name for each of them.
#[must_use]
pub fn of(program: &Program) -> Vec<Line> {
    let mut lines: Vec<(u8, Line)> = Vec::new();
    for motor in &program.motors {
        for (pin, role) in roles(&motor.wiring) {
            let name = format!("{}.{role}", motor.name);
            match lines.iter_mut().find(|(known, _)| *known == pin) {
                Some((_, line)) => line.names.insert(line.names.len() - 1, name),
                None => lines.push((pin, Line { names: vec![name, format!("pin{pin}")], initial: false })),
            }
        }
    }
    lines.into_iter().map(|(_, line)| line).collect()
}

/// Pins and roles ("step", "dir", "in1"…) that a motor's steps are read from.
pub(crate) fn roles(wiring: &Wiring) -> Vec<(u8, &'static str)> {
    match wiring {
        Wiring::StepDir { step, dir, .. } => vec![(*step, "step"), (*dir, "dir")],
        Wiring::Coils { pins, .. } => pins.iter().copied().zip(["in1", "in2", "in3", "in4"]).collect(),
    }
}

/// The index of the line that is `motor`'s `role` ("step", "dir", "in1" to "in4"): by name ("wheel.step", also as the end of a longer path), else by pin.
///
/// # Errors
/// If there is no such line.
pub fn find(lines: &[Line], motor: &str, role: &str, pin: u8) -> Result<usize, NoSuchLine> {
    let wanted = format!("{motor}.{role}").to_lowercase();
    let named = |name: &str| {
        let name = name.to_lowercase();
        name.strip_suffix(&wanted).is_some_and(|path| path.is_empty() || path.ends_with('.'))
    };
    let position = |is: &dyn Fn(&str) -> bool| lines.iter().position(|line| line.names.iter().any(|name| is(name)));
    position(&named)
        .or_else(|| position(&|name| pin_of(name) == Some(pin)))
        .ok_or_else(|| NoSuchLine { wanted: format!("for {motor}.{role} or pin {pin}"), found: list(lines) })
}

/// The pin that a name means: "8", "D8", "pin8", "pin 8", "GPIO8", "GP8", also at the end of a path.
fn pin_of(name: &str) -> Option<u8> {
    let last = name.rsplit('.').next()?.to_ascii_lowercase();
    let digits = ["gpio", "pin", "gp", "d"].iter().find_map(|prefix| last.strip_prefix(prefix)).unwrap_or(&last);
    let digits = digits.trim_start_matches([' ', '_']);
    digits.bytes().all(|b| b.is_ascii_digit()).then(|| digits.parse().ok())?
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pins_go_by_many_names() {
        let check = |name: &str, expected: Option<u8>| assert_eq!(pin_of(name), expected, "{name}");
        check("8", Some(8));
        check("D13", Some(13));
        check("libsigrok.D8", Some(8));
        check("pin 8", Some(8));
        check("pin_25", Some(25));
        check("GPIO2", Some(2));
        check("gp3", Some(3));
        check("300", None);
        check("dir", None);
        check("Channel 8", None);
        check("", None);
        check("d", None);
    }

    #[test]
    fn names_go_before_pins() {
        let lines = [Line::named("D8"), Line::named("top.Wheel.step")];
        assert_eq!(find(&lines, "wheel", "step", 8), Ok(1));
        assert_eq!(find(&lines, "heel", "step", 8), Ok(0));
        assert_eq!(
            find(&lines, "wheel", "dir", 9).unwrap_err().to_string(),
            "the trace has no line for wheel.dir or pin 9; it has D8, top.Wheel.step"
        );
    }

    #[test]
    fn an_alias_needs_its_line() {
        let mut trace = Trace { tick_hz: 1, lines: vec![Line::named("Channel 0")], edges: Vec::new() };
        assert_eq!(trace.alias("channel 0", "wheel.step"), Ok(()));
        assert_eq!(find(&trace.lines, "wheel", "step", 8), Ok(0));
        assert!(trace.alias("Channel 1", "wheel.dir").is_err());
    }
}
