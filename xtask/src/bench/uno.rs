//! The Uno's figures: on the emulated chip, in its cycles, which are the same on every machine.

use super::report;
use crate::command::{Done, Failure, cargo, output};
use crate::firmware;

/// Titles of the figures, by number.
const TITLES: [&str; 5] = [
    "The tutorial's sinusoid, every step and edge",
    "Sustained rates while following changing laws: the fastest that holds",
    "The same: constant rates, in phase, unequal rates, turns, longer pulses",
    "Four motors on one DIR line for an hour",
    "Load of the processor",
];

const PREFACE: &str = "Emulated: the committed image on the ATmega328P of `crates/emulator`, 16 MHz, streamed at 1 Mbaud; no \
board was connected. Lateness is edge − scheduled tick − the constant of the pins, in cycles (62.5 ns); a figure `lost` counts \
steps without an edge and edges without a step. `awake`: share of all cycles that the processor did not sleep; `busy`: the same \
less, for each round of the main loop, what the shortest round takes, which looks for work and finds none. `horizon`: the \
farthest that the rings were committed ahead. A rate holds if no step is lost, 99 % of the edges are at most 40 cycles late, all \
at most 60, and the board reports nothing; rates are tried 2.5 % apart. Random segments are of 40 to 80 steps; what changes by \
±10 % does so from segment to segment.";

/// One line of the bench's table.
struct Row {
    figure: usize,
    is_required: bool,
    /// From the law on.
    fields: Vec<String>,
}

impl Row {
    fn verdict(&self) -> &str {
        self.fields.last().map_or("", String::as_str)
    }

    fn holds(&self) -> bool {
        self.verdict() == "holds"
    }
}

/// Figures 1, 2, 3 and 5.
pub(crate) fn run() -> Done {
    let size = firmware::measure_uno()?;
    let (head, rows) = measure("")?;
    let mut text = format!("# The Uno, emulated\n\nWritten by `cargo xtask bench uno`. {PREFACE}\n");
    text.push_str(&tables(&head, &rows));
    text.push_str(&format!("\n## Flash and RAM\n\n```text\n{size}```\n"));
    finish("uno", &text, &rows)
}

/// Figure 4.
pub(crate) fn hour() -> Done {
    let (head, rows) = measure("-- hour")?;
    let mut text = "# The Uno, emulated: an hour\n\nWritten by `cargo xtask bench uno --hour`.\n".to_owned();
    text.push_str(&tables(&head, &rows));
    finish("uno-hour", &text, &rows)
}

fn finish(section: &str, text: &str, rows: &[Row]) -> Done {
    print!("{text}");
    report::write_section(section, text)?;
    let broken: Vec<_> = rows.iter().filter(|row| row.is_required && !row.holds()).collect();
    if broken.is_empty() {
        return Ok(());
    }
    let lines = broken.iter().map(|row| format!("\n  {}: {}", row.fields[..3].join(", "), row.verdict()));
    Err(Failure::Check(format!("{} of the promised figures do not hold:{}", broken.len(), lines.collect::<String>())))
}

/// Runs the bench.
fn measure(arguments: &str) -> Done<(Vec<String>, Vec<Row>)> {
    let text = output(&mut cargo(&format!("bench --package pulsetrain --bench uno {arguments}")))?;
    let mut lines = text.lines().filter(|line| line.contains('\t'));
    let head = lines.next().ok_or_else(|| Failure::Check("the bench printed no table".to_owned()))?;
    let head = head.split('\t').skip(2).map(str::to_owned).collect();
    Ok((head, lines.map(parse).collect::<Done<_>>()?))
}

fn parse(line: &str) -> Done<Row> {
    let bad = || Failure::Check(format!("not a row of the Uno's figures: {line}"));
    let mut fields = line.split('\t').map(str::to_owned);
    let is_required = fields.next().and_then(|text| text.parse().ok()).ok_or_else(bad)?;
    let figure = fields.next().and_then(|text| text.parse().ok()).ok_or_else(bad)?;
    Ok(Row { figure, is_required, fields: fields.collect() })
}

/// A table for each figure that there is.
fn tables(head: &[String], rows: &[Row]) -> String {
    let mut text = String::new();
    for (figure, title) in (1..).zip(TITLES) {
        let rows: Vec<_> = rows.iter().filter(|row| row.figure == figure).collect();
        if rows.is_empty() {
            continue;
        }
        text.push_str(&format!("\n## Uno, figure {figure}: {title}\n\n"));
        text.push_str(&format!("| {} |\n|{}\n", head.join(" | "), "---|".repeat(head.len())));
        for row in rows {
            text.push_str(&format!("| {} |\n", row.fields.join(" | ")));
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_is_read_as_it_was_written() {
        let row = parse("true\t2\tchanging ±10 %\t1.0 µs\t8/9\tholds").expect("a row");
        assert!(row.is_required && row.holds());
        assert_eq!((row.figure, row.fields[0].as_str()), (2, "changing ±10 %"));
        assert!(parse("maybe\t2\tx").is_err());
        let table = tables(&["law".to_owned()], &[row]);
        assert!(table.starts_with("\n## Uno, figure 2: Sustained"), "{table}");
    }
}
