//! StepperWinch's text, strict and with checksums, with one damaged byte.

use super::bench::{Chip, Moved};
use super::table::Row;
use super::{Tried, some};
use pulsetrain_testkit::winch::{WinchLab, Wired};

/// Each axis has a target of its own, so that the end positions show which lines were obeyed.
const TARGETS: [i32; 4] = [37, 21, 50, 44];

fn script() -> Vec<String> {
    let axes = ["x", "y", "z", "a"].iter().zip(TARGETS).map(|(axis, target)| format!("a {axis} {target}"));
    let (first, last) = ("strict 1".to_owned(), "version".to_owned());
    std::iter::once(first).chain(axes).chain([last]).map(with_checksum).collect()
}

/// `*`, and the exclusive or of all bytes before it.
fn with_checksum(line: String) -> String {
    let sum = line.bytes().fold(0, |sum, byte| sum ^ byte);
    format!("{line}*{sum:02x}\n")
}

/// Each byte of a script to the board. Neighbours that change places keep their exclusive or, but no line makes that
/// fault.
pub(crate) fn rows<P: Chip + Wired>(fresh: &P, tried: Tried) -> Vec<Row> {
    const FEW: u64 = 6;
    let script = script();
    let bytes = script.concat().into_bytes();
    ["lost", "with a bit changed", "doubled"]
        .map(|what| {
            let fault = format!("text with checksums, a byte to the board {what}");
            let places = some(&fault, bytes.len() as u64, FEW, tried);
            let mut row = Row::new(fault, <P as Chip>::NAME, format!("{} bytes", bytes.len()), Moved::ByWholeLines);
            for at in places {
                let at = at as usize;
                let mut sent = bytes.clone();
                match what {
                    "lost" => {
                        sent.remove(at);
                    }
                    "doubled" => sent.insert(at, bytes[at]),
                    _ => sent[at] ^= 1 << ((tried.seed as usize + 3 * at) % 8),
                }
                let mut lab = WinchLab::around(fresh.clone());
                lab.run_ms(80);
                // Gains that come to rest quickly.
                lab.send("g xyza 8 1\n");
                lab.run_ms(20);
                let first = lab.lines.len();
                lab.send(&sent);
                lab.run_ms(600);
                let counted = lab.counted(u64::MAX);
                // The byte's line, and where lines meet, the next one, too.
                let struck = bytes[..at].iter().filter(|byte| **byte == b'\n').count();
                for (axis, (count, target)) in counted.into_iter().zip(TARGETS).enumerate() {
                    let may_miss = (struck..=struck + usize::from(bytes[at] == b'\n')).contains(&(axis + 1));
                    assert!(count == target || (count == 0 && may_miss), "{what} {at}: {counted:?}");
                }
                let said = lab.lines[first..].iter().find(|line| line.text.starts_with("err"));
                // A zero begins a frame, and mutes the text until the next whole line.
                let is_told = said.is_some() || sent.contains(&0);
                assert!(is_told || counted == TARGETS, "{what} {at}: a line is missing, and nobody said so");
                lab.check_positions();
                assert_eq!(lab.statuses().last().map(|status| status.positions), Some(counted), "{what} {at}");
                row.say("");
            }
            row
        })
        .into()
}
