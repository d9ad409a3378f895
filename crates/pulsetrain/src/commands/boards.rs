//! `pulsetrain boards`: the table of limits.

use pulsetrain_motion::boards::{self, BoardProfile};
use schemars::JsonSchema;
use serde::Serialize;

use crate::arguments;
use crate::console::{Console, Exit};
use pulsetrain_motion::human::{self, Table};

#[derive(Serialize, JsonSchema)]
pub(crate) struct BoardTableRow {
    /// Its name in motion files.
    name: &'static str,
    /// What it is.
    about: &'static str,
    /// Ticks per second.
    tick_hz: u64,
    /// Motors at most.
    max_motors: usize,
    /// Limits with 1, 2, … motors. The last one holds for more motors.
    min_interval_ticks: &'static [u32],
    /// Whether edges come on their ticks, by hardware.
    hardware_timed: bool,
    /// How much later than its tick an edge may come, ticks.
    lateness_ticks: u32,
    /// How far ahead the board schedules edges, ticks.
    horizon_ticks: u32,
    /// Its RAM, bytes.
    ram_bytes: Option<u32>,
    /// Its flash, bytes.
    flash_bytes: Option<u32>,
    /// Each motor's limit with 1, 2, … motors. The last one holds for more motors; if there are none, there is no
    /// limit.
    queue_bytes: &'static [u32],
    /// Where the figures come from.
    source: &'static str,
    /// What to know about it.
    note: &'static str,
}

impl From<&BoardProfile> for BoardTableRow {
    fn from(board: &BoardProfile) -> BoardTableRow {
        BoardTableRow {
            name: board.name,
            about: board.about,
            tick_hz: board.tick_hz,
            max_motors: board.max_motors,
            min_interval_ticks: board.min_interval_ticks,
            hardware_timed: board.hardware_timed,
            lateness_ticks: board.lateness_ticks,
            horizon_ticks: board.horizon_ticks,
            ram_bytes: board.ram_bytes,
            flash_bytes: board.flash_bytes,
            queue_bytes: board.queue_bytes,
            source: board.source,
            note: board.note,
        }
    }
}

pub(crate) fn run(args: &arguments::Table, console: &mut Console<'_>) -> miette::Result<Exit> {
    let rows: Vec<BoardTableRow> = boards::BUILT_IN.iter().copied().map(BoardTableRow::from).collect();
    if args.json {
        console.print_json(&rows)?;
        return Ok(Exit::Success);
    }
    let mut table = Table::new(["board", "tick", "motors", "fastest, 1 motor", "fastest, all", "edges", "what it is"])
        .left(&[0, 5, 6]);
    for row in &rows {
        let tick_s = 1.0 / row.tick_hz as f64;
        let rate = |ticks: Option<&u32>| {
            ticks.map_or_else(|| "–".into(), |ticks| human::scaled(1.0 / (f64::from(*ticks) * tick_s), "steps/s"))
        };
        let edges = if row.lateness_ticks == 0 {
            "on the tick".to_owned()
        } else {
            format!("up to {} late", human::seconds(f64::from(row.lateness_ticks) * tick_s))
        };
        table.row([
            row.name.to_owned(),
            human::seconds(tick_s),
            row.max_motors.to_string(),
            rate(row.min_interval_ticks.first()),
            rate(row.min_interval_ticks.last()),
            edges,
            row.about.to_owned(),
        ]);
    }
    console.print(&table)?;
    console.print("\n")?;
    for row in &rows {
        console.print(format_args!("  {}: {}\n    figures: {}\n", row.name, row.note, row.source))?;
    }
    Ok(Exit::Success)
}
