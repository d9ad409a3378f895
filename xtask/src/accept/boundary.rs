//! Finds the largest peak rate that runs, for sinusoids in phase at some frequencies.

use super::motions::in_phase;
use super::outcome::Outcome;
use super::{BOARDS, Folder, Program};
use crate::command::{self, Done};

/// Frequencies of the sinusoids, Hz.
const FREQUENCIES: [u32; 5] = [1, 3, 10, 30, 60];
/// Peak rates that are tried: the board's limit, and this many below it, each 5 % lower.
const RUNGS: u32 = 80;

/// A row of the table: a board with a number of motors.
#[derive(Clone, Copy)]
struct BoundaryRow {
    board: &'static str,
    motors: usize,
}

/// Prints the table for one board, or for all that have a firmware.
pub(super) fn run(program: &Program, board: Option<&str>) -> Done {
    let boards = BOARDS.into_iter().filter(|name| board.map_or(*name != "native", |board| board == *name));
    let rows: Vec<BoundaryRow> = boards.flat_map(|board| [2, 4].map(|motors| BoundaryRow { board, motors })).collect();
    let cells = rows.iter().flat_map(|row| FREQUENCIES.map(|frequency| (*row, frequency)));
    let peaks = command::side_by_side(cells, |(row, frequency)| peak(program, row, frequency));
    let peaks: Vec<(f64, Option<f64>)> = peaks.into_iter().collect::<Done<_>>()?;
    println!(
        "Sinusoids in phase, 2 s: largest peak that runs, k steps/s each. \"Runs\": `plan` accepts it, and no step is lost.\n"
    );
    let head = FREQUENCIES.map(|frequency| format!("{frequency} Hz")).join(" | ");
    println!("| board | motors | limit | {head} |\n|---|---|---|{}", "---|".repeat(FREQUENCIES.len()));
    for (row, peaks) in rows.iter().zip(peaks.chunks(FREQUENCIES.len())) {
        let cells: Vec<String> = peaks.iter().map(|(_, peak)| peak.map_or("–".to_owned(), thousands)).collect();
        println!("| {} | {} | {} | {} |", row.board, row.motors, thousands(peaks[0].0), cells.join(" | "));
    }
    Ok(())
}

fn thousands(hz: f64) -> String {
    let decimals = if hz < 9_950.0 { 1 } else { 0 };
    format!("{:.decimals$}", hz / 1000.0)
}

/// The limit of the peak rate, and the largest that runs, steps/s. If a rate runs, all lower ones are taken to run, too.
fn peak(program: &Program, row: BoundaryRow, frequency: u32) -> Done<(f64, Option<f64>)> {
    let BoundaryRow { board, motors } = row;
    let folder = Folder::new(format!("boundary-{board}-{motors}-{frequency}"))?;
    folder.write("too-fast.toml", in_phase(board, motors, 1e9, frequency).files[0].1.as_str())?;
    let limit_hz = program.limit_hz(&folder, "too-fast.toml")?;
    let at = |rung: u32| limit_hz * 0.95_f64.powf(f64::from(rung));
    // The first rate that runs lies behind `fails`, at `runs` at the latest.
    let (mut fails, mut runs) = (None, RUNGS);
    while fails.map_or(0, |rung| rung + 1) < runs {
        let rung = fails.map_or(0, |rung| (rung + runs) / 2);
        let motion = in_phase(board, motors, at(rung), frequency);
        if program.outcome(&folder, &motion, false)? == Outcome::Passed { runs = rung } else { fails = Some(rung) }
    }
    folder.remove()?;
    Ok((limit_hz, (runs < RUNGS).then(|| at(runs))))
}
