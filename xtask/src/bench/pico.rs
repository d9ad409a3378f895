//! The Pico's figures: cycles of the emulated chip, which are the same on every machine.

use super::table::Table;
use crate::command::{Done, Failure, root};
use std::fs;

/// Titles of the figures, from 1 on.
const TITLES: [&str; 5] = [
    "Laws with changing speed, streamed over USB: what is promised, and the fastest that holds",
    "Eight motors that start in one cycle",
    "Motors on ULN2003",
    "The sweep article's four motors, twice",
    "Load of the processor",
];

const PREFACE: &str = "Emulated: the committed image on the RP2040 of `crates/emulator`, 125 MHz, streamed over its USB (full speed, \
frames of 1 ms) unless a row says otherwise; no board was connected. A cycle is 8 ns. Every STEP edge is held against its scheduled \
tick, the board's constant being 0; a figure `lost` counts steps without an edge and edges without a step. `awake`: share of all \
cycles that the processor did not sleep. `bytes/step`: of the segments, without frames. A rate holds if no step is lost, no edge \
is a cycle off its tick, and the board reports nothing; rates are tried 2.5 % apart, and where the driver allows no more (A4988: \
454 k, as speeds swing by 10 %) the search ends. What changes by ±10 % does so from segment to segment. The chip's buses are not \
modelled where DMA and processor want the same bank of RAM at once.";

/// Figures 1, 2, 3 and 5, and a short figure 4.
pub(crate) fn run() -> Done {
    let (table, limits) = Table::measured("pico", "")?;
    write_limits(&limits)?;
    let text = format!(
        "# The Pico, emulated\n\nWritten by `cargo xtask bench pico`. {PREFACE}\n{}",
        table.markdown("Pico", &TITLES)
    );
    table.finish("pico", &text)
}

/// Figure 4.
pub(crate) fn hour() -> Done {
    let (table, _) = Table::measured("pico", "-- hour")?;
    let text = format!(
        "# The Pico, emulated: an hour\n\nWritten by `cargo xtask bench pico --hour`.\n{}",
        table.markdown("Pico", &TITLES)
    );
    table.finish("pico-hour", &text)
}

/// The Pico's limits in the table of boards: their names, the largest number of motors, and their docs.
const LIMITS: [(&str, usize, &str); 5] = [
    ("SHORTEST", 8, "Shortest interval that holds for ever, of each of 1 to 8 motors."),
    ("COILS", 6, "Shortest interval that holds for ever, of each of 1 to 6 motors on coils."),
    ("ONWARD", 8, "Shortest time between queued segments of one direction, of each of 1 to 8 motors."),
    ("TURNING", 8, "Shortest time between queued segments that reverse, of each of 1 to 8 motors."),
    ("HEARD", 8, "Additional time for each segment that comes from the host meanwhile, of each of 1 to 8 motors."),
];

/// Writes the Pico's limits into the table of boards.
fn write_limits(limits: &[String]) -> Done {
    let path = root().join("crates/motion/src/boards/pico/measured.rs");
    fs::write(&path, limits_source(limits)?).map_err(|why| Failure::File { path, why })
}

fn limits_source(limits: &[String]) -> Done<String> {
    let mut source =
        "//! The Pico's limits, measured on the emulated chip: written by `cargo xtask bench pico`, not by hand. In \
                      ticks.\n"
            .to_owned();
    for (name, motors, what) in LIMITS {
        let mut shortest = vec![None; motors];
        for line in limits {
            let mut fields = line.split('\t').skip(1);
            if fields.next() != Some(name) {
                continue;
            }
            let mut numbers = fields.map(|field| field.parse::<usize>().ok());
            if let (Some(Some(motors)), Some(Some(interval))) = (numbers.next(), numbers.next())
                && let Some(place) = shortest.get_mut(motors.wrapping_sub(1))
            {
                *place = Some(interval);
            }
        }
        let missing = || Failure::Check(format!("{name}: a number of motors has no rate that holds: {limits:?}"));
        let mut intervals: Vec<usize> = shortest.into_iter().collect::<Option<_>>().ok_or_else(missing)?;
        // What holds for more motors also holds for fewer.
        for place in (1..intervals.len()).rev() {
            intervals[place - 1] = intervals[place - 1].min(intervals[place]);
        }
        let intervals: Vec<_> = intervals.iter().map(usize::to_string).collect();
        source += &format!("\n/// {what}\npub(super) const {name}: [u32; {motors}] = [{}];\n", intervals.join(", "));
    }
    Ok(source)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_are_those_of_each_number_of_motors() {
        let intervals = [40, 60, 90, 85, 120, 140, 160, 180];
        let of = |(name, motors, _): (&'static str, usize, &str)| {
            (1..=motors).zip(intervals).map(move |(motors, ticks)| format!("limit\t{name}\t{motors}\t{ticks}"))
        };
        let lines: Vec<_> = LIMITS.into_iter().flat_map(of).collect();
        let source = limits_source(&lines).expect("all there");
        assert!(source.contains("SHORTEST: [u32; 8] = [40, 60, 85, 85, 120, 140, 160, 180];"), "{source}");
        assert!(source.contains("COILS: [u32; 6] = [40, 60, 85, 85, 120, 140];"), "{source}");
        assert!(limits_source(&lines[1..]).is_err());
    }
}
