//! Programs in C: what they send, and the cycle of each output, in simavr and in ours.

use super::{Comparison, Tools};
use crate::command::{self, Done};

const PROGRAMS: [&str; 4] = ["crc_sort", "wide_integers", "floats", "recursion"];
/// Longest run of a program, cycles.
const MOST_CYCLES: &str = "50000000";

pub(super) fn compare(tools: &Tools) -> Done<Comparison> {
    let mut differences = Vec::new();
    let (mut outputs, mut cycles) = (0, 0);
    for name in PROGRAMS {
        let image = tools.compile(name)?;
        let run = |mut emulator: std::process::Command| {
            command::output(emulator.arg("program").arg(&image).arg(MOST_CYCLES)).map(Output::read)
        };
        let (theirs, ours) = (run(tools.simavr())?, run(tools.ours())?);
        outputs += theirs.timed.len() + theirs.sent.len();
        cycles += theirs.end.unwrap_or(0);
        if theirs.end.is_none() {
            differences.push(format!("{name} did not end in simavr"));
        }
        if let Some(at) = first_difference(&theirs.timed, &ours.timed) {
            let (theirs, ours) = (theirs.timed.get(at), ours.timed.get(at));
            differences.push(format!("{name}, output {at}: simavr {theirs:?}, ours {ours:?}"));
        }
        if let Some(at) = first_difference(&theirs.sent, &ours.sent) {
            differences.push(format!("{name}, byte {at} of the UART: the two are not the same"));
        }
    }
    let compared = format!(
        "{} programs, {outputs} outputs with their cycles or from the UART, {:.1} million cycles",
        PROGRAMS.len(),
        cycles as f64 / 1e6
    );
    Ok(Comparison { what: "programs, with simavr", compared, differences, exceptions: Vec::new() })
}

/// The output of a run.
struct Output {
    /// `CYCLE BYTE`, `CYCLE mark BYTE`, `CYCLE end`.
    timed: Vec<String>,
    /// The bytes that left the UART, without cycles, since simavr takes 11 bits for a byte.
    sent: Vec<String>,
    /// The cycle at which it ended.
    end: Option<u64>,
}

impl Output {
    fn read(text: String) -> Output {
        let (sent, timed): (Vec<_>, Vec<_>) =
            text.lines().map(str::to_owned).partition(|line| line.starts_with("sent"));
        let end = timed.last().and_then(|line| line.strip_suffix(" end")).and_then(|cycle| cycle.parse().ok());
        Output { timed, sent, end }
    }
}

fn first_difference(a: &[String], b: &[String]) -> Option<usize> {
    let at = a.iter().zip(b).take_while(|(a, b)| a == b).count();
    (at < a.len().max(b.len())).then_some(at)
}
