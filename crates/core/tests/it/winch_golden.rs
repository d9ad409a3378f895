//! What lines make of a path: a table that a reviewer reads, to the last bit of the fixed point.
//!
//! `cargo xtask golden` writes it again. tests/it/winch_path.rs tests that the path is within 0.1 step of the
//! recurrence in f64. crates/board/tests/it/chips/winch_avr.rs tests that the Uno's assembly gives the same bits. This table shows
//! when either changes.

use expect_test::expect_file;
use pulsetrain_core::winch::letters::InMemory;
use pulsetrain_core::winch::path::Path;
use pulsetrain_core::winch::text::{Heard, LineReader};
use std::fmt::Write as _;

/// A motion of x: its lines with their milliseconds, and how long it is looked at, ms.
struct Motion {
    name: &'static str,
    lines: &'static [(u32, &'static str)],
    ms: u32,
}

const MOTIONS: [Motion; 9] = [
    Motion { name: "a step, with the gains of the start: it rings", lines: &[(0, "a x 800")], ms: 6000 },
    Motion { name: "a step, critically damped", lines: &[(0, "g x 2 1"), (0, "a x -5000")], ms: 2400 },
    Motion {
        name: "1234 steps/s, and back",
        lines: &[(0, "g x 1 0.7"), (0, "v x 1234"), (3000, "v x 0"), (3000, "a x 0")],
        ms: 6000,
    },
    Motion {
        name: "a new target in mid-move",
        lines: &[(0, "g x 3 0.5"), (0, "a x 3000"), (150, "a x -1000"), (333, "d x 5")],
        ms: 1200,
    },
    Motion {
        name: "impulses",
        lines: &[(0, "g x 2 0.4"), (0, "r x 40"), (100, "r x 40"), (200, "r x -1000")],
        ms: 1600,
    },
    Motion {
        name: "a ramp",
        lines: &[(0, "g x 5 1"), (0, "s x 400"), (0, "a x 500"), (1500, "s x 0"), (1500, "a x 450")],
        ms: 2400,
    },
    Motion {
        name: "faster than it may: it stays within its limits",
        lines: &[(0, "l x 2000 8000"), (0, "g x 4 1"), (0, "a x 4000")],
        ms: 3000,
    },
    Motion {
        name: "limits that come down in mid-move: within the new acceleration",
        lines: &[(0, "l x 10000 250000"), (0, "g x 4 1"), (0, "v x 9000"), (1000, "l x 500 5000")],
        ms: 3000,
    },
    Motion { name: "a stop", lines: &[(0, "g x 4 1"), (0, "v x 3000"), (1000, "enable 0")], ms: 1200 },
];

/// Rows of each motion, besides the first.
const ROWS: u32 = 12;

fn write(table: &mut String, motion: &Motion) {
    let Motion { name, lines, ms } = motion;
    let _ = writeln!(table, "\n{name}");
    for (at, line) in *lines {
        let _ = writeln!(table, "    {at} ms: {line}");
    }
    let _ = writeln!(table, "{:>8} {:>8} {:>10} {:>10} {:>12}", "ms", "steps", "+ offset", "steps/s", "fastest");
    let (mut reader, mut paths) = (LineReader::new(), [const { Path::new() }; 4]);
    let mut lines = lines.iter().peekable();
    let mut fastest = 0;
    for now in 0..=*ms {
        if now.is_multiple_of(ms / ROWS) {
            let path = &paths[0];
            let per_s = |speed: i32| f64::from(speed) / 65_536.0;
            let (made, offset, speed) = (path.made(), path.offset(), per_s(path.speed()));
            let _ = writeln!(table, "{now:>8} {made:>8} {offset:>10} {speed:>10.3} {:>12.3}", per_s(fastest));
            fastest = 0;
        }
        while let Some((_, line)) = lines.next_if(|(at, _)| *at == now) {
            for byte in format!("{line}\n").bytes() {
                match reader.push::<InMemory>(byte) {
                    Heard::Nothing => {}
                    Heard::Command(_) => reader.obey(&mut paths),
                    Heard::Refused(refusal) => panic!("{line:?}: {refusal:?}"),
                }
            }
        }
        let _ = paths[0].tick();
        if paths[0].speed().abs() > fastest.abs() {
            fastest = paths[0].speed();
        }
    }
    assert!(lines.next().is_none(), "{name}: a line is later than its end");
}

#[test]
fn trajectories() {
    let mut table = "Steps of x at times; the offset from there, 1/65 536 millistep; its speed, and the fastest since the row before.\n".to_owned();
    for motion in &MOTIONS {
        write(&mut table, motion);
    }
    expect_file!["golden/winch_paths.txt"].assert_eq(&table);
}
