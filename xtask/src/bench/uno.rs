//! The Uno's figures: cycles of the emulated chip, which are the same on every machine.

use super::table::Table;
use crate::command::{Done, Failure, root};
use crate::firmware;
use std::fs;

/// Titles of the figures, from 1 on.
const TITLES: [&str; 8] = [
    "The tutorial's sinusoid, every step and edge",
    "Sustained rates while following changing laws: the fastest that holds",
    "The same: constant rates, in phase, unequal rates, turns, longer pulses",
    "Four motors on one DIR line for an hour",
    "Load of the processor",
    "Motions that stay fast, by a session, in phase and staggered: the fastest up to which all hold",
    "The limits of the table of boards with other random segments: lateness and lost steps of all runs, load of the first, and how many hold",
    "Whole motions of about 1 s, in phase and staggered: 1000 steps/s of each motor that run / that `plan` accepts",
];

const PREFACE: &str = "Emulated: the committed images on the ATmega328P of `crates/emulator`, 16 MHz, streamed at 1 Mbaud; no \
board was connected. Lateness is edge − scheduled tick − the constant of the pins, in cycles (62.5 ns); a figure `lost` counts \
steps without an edge and edges without a step. `awake`: share of all cycles that the processor did not sleep; `busy`: the same \
less, for each round of the main loop, what the shortest round takes, which looks for work and finds none. `horizon`: the \
farthest that the rings were committed ahead. A rate holds if no step is lost, 99 % of the edges are at most 40 cycles late, all \
at most 60, and the board reports nothing; rates are tried 2.5 % apart. Random segments are of 40 to 80 steps; what changes by \
±10 % does so from segment to segment. That is harder than planned motions: only rows with a text in `required` are promises, and \
[promises.md](promises.md) has the promised rates.";

/// Figures 1, 2, 3 and 5.
pub(crate) fn run() -> Done {
    let size = firmware::measure_uno()?;
    let (table, limits) = measure("")?;
    write_limits(&limits)?;
    let mut text = format!("# The Uno, emulated\n\nWritten by `cargo xtask bench uno`. {PREFACE}\n");
    text.push_str(&table.markdown("Uno", &TITLES));
    text.push_str(&format!("\n## Flash and RAM\n\n```text\n{size}```\n"));
    table.finish("uno", &text)
}

/// Figure 4.
pub(crate) fn hour() -> Done {
    let (table, _) = measure("-- hour")?;
    let mut text = "# The Uno, emulated: an hour\n\nWritten by `cargo xtask bench uno --hour`.\n".to_owned();
    text.push_str(&table.markdown("Uno", &TITLES));
    table.finish("uno-hour", &text)
}

/// Prints figure 2 alone and writes nothing: how a change of the firmware affects sustained rates.
pub(crate) fn figure_2() -> Done {
    let (table, _) = measure("-- figure-2")?;
    print!("{}", table.markdown("Uno", &TITLES));
    Ok(())
}

/// Prints figure 8 alone and writes nothing: how fast whole motions run, with `seeds` random seeds.
pub(crate) fn motions(seeds: u64) -> Done {
    let (table, _) = measure(&format!("-- motions {seeds}"))?;
    print!("{}", table.markdown("Uno", &TITLES));
    Ok(())
}

/// Runs the bench. Gives its rows, and the limits for the table of boards.
fn measure(arguments: &str) -> Done<(Table, Vec<Limit>)> {
    let (table, limits) = Table::measured("uno", arguments)?;
    Ok((table, limits.iter().filter_map(|line| Limit::parse(line)).collect()))
}

/// How edges are made, as far as rates depend on it.
#[derive(Clone, Copy, PartialEq, Eq)]
enum By {
    /// By the compare hardware.
    Compare,
    /// By software, for two motors on port D with a ring each.
    Pair,
    /// By software, with one ring.
    Software,
}

/// The file with the limits, a part of the table of boards.
const TABLE: &str = "crates/motion/src/boards/uno/measured.rs";

/// The limits of one number of motors that go on for ever, ticks.
struct Limit {
    by: By,
    motors: usize,
    pulse: u32,
    interval: u32,
    late: u32,
    horizon: u32,
}

impl Limit {
    fn parse(line: &str) -> Option<Limit> {
        let mut fields = line.split('\t').skip(1);
        fields.next()?;
        let by = match fields.next()? {
            "compare" => By::Compare,
            "pair" => By::Pair,
            _ => By::Software,
        };
        let mut number = || fields.next()?.parse().ok();
        let motors = number()? as usize;
        Some(Limit { by, motors, pulse: number()?, interval: number()?, late: number()?, horizon: number()? })
    }
}

/// Pulses that limits are measured for, ticks. With the last one the firmware works out each step by itself on all
/// pins.
const PULSES: [u32; 4] = [16, 31, 80, 256];

/// Writes the Uno's limits into the table of boards.
fn write_limits(limits: &[Limit]) -> Done {
    let path = root().join(TABLE);
    fs::write(&path, limits_source(limits)?).map_err(|why| Failure::File { path, why })
}

fn limits_source(limits: &[Limit]) -> Done<String> {
    let shortest = |by: By, motors: usize, pulse: u32| {
        let of = limits.iter().filter(|l| l.by == by && (l.motors, l.pulse) == (motors, pulse));
        // If several kinds of pins were measured, the limit holds for all of them.
        let missing = || Failure::Check(format!("no rate holds for {motors} motors with pulses of {pulse} ticks"));
        let interval = of.map(|limit| limit.interval).max().ok_or_else(missing)?;
        // Two rings get one rate less than they reach when the motors are staggered: if the motors come to step
        // together, their rings run empty sooner.
        Ok(if by == By::Pair { interval + interval.div_ceil(40) } else { interval })
    };
    let row = |by: By, motors: usize| -> Done<String> {
        let row = PULSES.iter().map(|pulse| Ok(shortest(by, motors, *pulse)?.to_string()));
        Ok(format!("[{}]", row.collect::<Done<Vec<_>>>()?.join(", ")))
    };
    let rows = |by: By, most: usize| -> Done<String> {
        (1..=most).map(|motors| Ok(format!("    {},\n", row(by, motors)?))).collect()
    };
    let software = limits.iter().filter(|limit| limit.by != By::Compare);
    let late = software.map(|limit| limit.late).max().unwrap_or(0);
    let horizon = limits.iter().map(|limit| limit.horizon).max().unwrap_or(0);
    Ok(format!(
        "//! The Uno's limits, measured on the emulated chip: written by `cargo xtask bench uno`, not by hand. In ticks.\n\n\
         /// Measured pulses, a column each. With the last the firmware works out one step at a time, on all pins.\n\
         pub(super) const PULSES: [u32; {}] = [{}];\n\
         /// Shortest interval that holds for ever, of each of 1 to 4 motors on one or two ports.\n\
         pub(super) const BY_SOFTWARE: [[u32; {0}]; 4] = [\n{}];\n\
         /// Shortest interval of two motors on pins 2-7, each with a DIR line of its own: they have a ring each.\n\
         pub(super) const PAIR: [u32; {0}] = {};\n\
         /// Shortest interval of one or two motors whose edges the compare hardware makes.\n\
         pub(super) const BY_COMPARE: [[u32; {0}]; 2] = [\n{}];\n\
         /// Largest |edge − scheduled| beyond the constant.\n\
         pub(super) const LATENESS: u32 = {late};\n\
         /// How far ahead it commits itself at most.\n\
         pub(super) const HORIZON: u32 = {horizon};\n",
        PULSES.len(),
        PULSES.map(|pulse| pulse.to_string()).join(", "),
        rows(By::Software, 4)?,
        row(By::Pair, 2)?,
        rows(By::Compare, 2)?,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_are_those_that_all_pins_keep() {
        let mut limits = Vec::new();
        for pulse in PULSES {
            for motors in 1..=4 {
                limits.push(format!("limit\tuno\tsoftware\t{motors}\t{pulse}\t{}\t30\t5000\t370", 100 * motors));
            }
            limits.push(format!("limit\tuno\tsoftware\t3\t{pulse}\t333\t31\t5000\t370"));
            limits.push(format!("limit\tuno\tpair\t2\t{pulse}\t144\t31\t5000\t370"));
            limits.extend([1, 2].map(|motors| format!("limit\tuno\tcompare\t{motors}\t{pulse}\t90\t0\t6000\t370")));
        }
        let limits: Vec<_> = limits.iter().filter_map(|line| Limit::parse(line)).collect();
        let source = limits_source(&limits).expect("all there");
        for line in [
            "//! The Uno's limits, measured on",
            "[200, 200, 200, 200],",
            "[333, 333, 333, 333],",
            "= [148, 148, 148, 148];",
            "[90, 90, 90, 90],",
            "LATENESS: u32 = 31;",
            "HORIZON: u32 = 6000;",
        ] {
            assert!(source.contains(line), "{source}");
        }
        assert!(limits_source(&limits[1..]).is_err());
    }
}
