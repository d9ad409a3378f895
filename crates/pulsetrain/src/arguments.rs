//! Arguments that several commands share, and how their values are read.

use std::path::PathBuf;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{ArgGroup, Args, ValueEnum};
use miette::miette;
use pulsetrain_board::BoardKind;
use pulsetrain_core::wire::Baud;
use pulsetrain_motion::quantity::{Base, Quantity};
use pulsetrain_motion::{Time, boards, full_steps};
use pulsetrain_session::estimate::{Estimate, Task};
use pulsetrain_session::prepare::{FOREVER, Prepared, WORST_CLOCK_PPM};
use pulsetrain_trace::verdict::Align;

use crate::consent::{self, Consent};
use crate::console::Console;
use crate::diagnostic::advised;
use crate::load;

/// A motion file, and how much of it.
#[derive(Args, Debug)]
pub(crate) struct Motion {
    /// Motion file (TOML)
    pub(crate) file: PathBuf,
    /// Plan for this board instead of the file's
    #[arg(long, value_name = "BOARD", value_parser = board)]
    pub(crate) board: Option<String>,
    /// How much of an endless motion is made; then the motors brake. `run` also takes "forever" [default: "10 s"]
    #[arg(long = "for", value_name = "TIME", value_parser = length, allow_hyphen_values = true)]
    pub(crate) length: Option<Time>,
    /// Begin a long motion without a question. The question comes from 50 million steps, a minute of planning, an hour of
    /// running, or 1 GB of files on
    #[arg(long)]
    pub(crate) yes: bool,
}

impl Motion {
    /// Prepares the motion, cut to `self.length`. Asks the user first if planning or running it takes long, but not if
    /// the planner refuses the motion at once.
    pub(crate) fn prepare(&self, task: Task, json: bool, console: &mut Console<'_>) -> miette::Result<Prepared> {
        let prepared = load::endless(&self.file, self.board.as_deref())?;
        if self.length == Some(FOREVER) {
            if matches!(task, Task::Plan | Task::Native { files: false }) && prepared.is_endless() {
                let help = "take its beginning, --for \"60 s\"; `pulsetrain run FILE --for forever` runs it";
                return Err(miette!(help = help, "{}: a motion without an end has no whole plan", prepared.file));
            }
            console.tell(format_args!(
                "{}: until Ctrl-C or `pulsetrain stop`. Files grow all the time: --no-trace --no-steps leaves them out.\n",
                prepared.file
            ));
            return prepared.ending(self.length).map_err(advised);
        }
        if !self.yes && Estimate::of(&prepared, self.length, task).is_much() {
            prepared.prove_beginning().map_err(advised)?;
        }
        self.agreed(prepared, task, json, console)
    }

    /// Prepares the motion even if the planner refuses it, for commands that show why it is refused.
    pub(crate) fn prepare_any(&self, task: Task, json: bool, console: &mut Console<'_>) -> miette::Result<Prepared> {
        self.agreed(load::endless(&self.file, self.board.as_deref())?, task, json, console)
    }

    fn agreed(
        &self,
        prepared: Prepared,
        task: Task,
        json: bool,
        console: &mut Console<'_>,
    ) -> miette::Result<Prepared> {
        consent::agree(&prepared, Consent { length: self.length, task, yes: self.yes, json }, console)?;
        prepared.ending(self.length).map_err(advised)
    }
}

/// Which board is asked.
#[derive(Args, Debug)]
#[command(group = ArgGroup::new("asked").args(["port", "board"]).required(true))]
pub(crate) struct At {
    /// The board at this serial port
    #[arg(long, value_name = "PORT")]
    pub(crate) port: Option<String>,
    /// A virtual board
    #[arg(long, value_name = "BOARD", value_parser = board_kind())]
    pub(crate) board: Option<BoardKind>,
    /// Rate of the line, once the board is found
    #[arg(long, value_name = "BAUD", value_parser = baud, default_value = "1000000")]
    pub(crate) baud: Baud,
    /// Print the answer as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

/// Which board is talked to.
#[derive(Args, Debug)]
#[group(required = true, multiple = false)]
pub(crate) struct WinchAt {
    /// The board at this serial port; opening it resets an Uno
    #[arg(long, value_name = "PORT")]
    pub(crate) port: Option<String>,
    /// A virtual board
    #[arg(long, value_name = "BOARD", value_parser = board_kind())]
    pub(crate) board: Option<BoardKind>,
    /// This computer's own path generator, without a chip
    #[arg(long)]
    pub(crate) native: bool,
}

#[derive(Args, Debug)]
pub(crate) struct Table {
    /// Print the table as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Alignment {
    /// The capture's time zero is the motion's
    None,
    /// The capture began some time before
    Start,
    /// The same, and its clock may run at another rate; the report gives the difference in ppm
    #[value(name = "start+rate")]
    StartAndRate,
}

impl From<Alignment> for Align {
    fn from(alignment: Alignment) -> Align {
        match alignment {
            Alignment::None => Align::None,
            Alignment::Start => Align::Start,
            Alignment::StartAndRate => Align::StartAndRate,
        }
    }
}

/// Reads the name of a board that has a firmware.
pub(crate) fn board_kind() -> impl TypedValueParser<Value = BoardKind> {
    PossibleValuesParser::new(BoardKind::names()).try_map(|name| BoardKind::named(&name).ok_or("no such board"))
}

pub(crate) fn board(name: &str) -> Result<String, String> {
    let names = boards::BUILT_IN.iter().map(|board| board.name);
    match (boards::find(name), boards::renamed(name)) {
        (Some(board), _) => Ok(board.name.to_owned()),
        (None, Some(board)) => Err(format!("say {board}: its firmware has these rates now")),
        (None, None) => Err(format!("no such board; there are {}", names.collect::<Vec<_>>().join(", "))),
    }
}

/// Reads what a capture calls a line, and which line that is: "Channel 0=wheel.step".
pub(crate) fn channel(text: &str) -> Result<(String, String), String> {
    match text.rsplit_once('=') {
        Some((from, to)) if !from.is_empty() && !to.is_empty() => Ok((from.to_owned(), to.to_owned())),
        _ => Err("write it like \"Channel 0=wheel.step\"".into()),
    }
}

/// Reads a positive quantity of one kind.
pub(crate) fn positive(text: &str, base: Base, example: &str) -> Result<Quantity, String> {
    measured(text, (base, 0), example)
}

pub(crate) fn measured(text: &str, kind: (Base, u8), example: &str) -> Result<Quantity, String> {
    let quantity = Quantity::parse(text).map_err(|error| match error.meant() {
        Some(meant) => format!("{error}; write \"{meant}\""),
        None => format!("{error}; write it like \"{example}\""),
    })?;
    if (quantity.base, quantity.per_seconds) != kind {
        return Err(format!("this is {}; write it like \"{example}\"", quantity.kind()));
    }
    if quantity.value > 0.0 {
        Ok(quantity)
    } else {
        let what = if kind == (Base::Time, 0) { "a time above 0" } else { "more than 0" };
        Err(format!("it must be {what}; write it like \"{example}\""))
    }
}

/// Reads a motor's full steps in a revolution.
pub(crate) fn steps_per_rev(text: &str) -> Result<u32, String> {
    let number = text.parse::<f64>().map_err(|_| "write a whole number, like 200".to_owned())?;
    full_steps::checked(number).map_err(|error| format!("{error}; {}", error.advice()))
}

pub(crate) fn baud(text: &str) -> Result<Baud, String> {
    let rates = Baud::ALL.map(|baud| baud.rate().to_string());
    let found = Baud::ALL.into_iter().zip(&rates).find(|(_, rate)| *rate == text);
    found.map(|(baud, _)| baud).ok_or_else(|| format!("the rates are {}", rates.join(", ")))
}

pub(crate) fn clock_ppm(text: &str) -> Result<f64, String> {
    let ppm = text.parse::<f64>().map_err(|_| "write a number, like -1250".to_owned())?;
    if ppm.abs() <= WORST_CLOCK_PPM {
        Ok(ppm)
    } else {
        Err(format!("no board's clock is off by more than {WORST_CLOCK_PPM} ppm"))
    }
}

pub(crate) fn duration(text: &str) -> Result<Time, String> {
    let quantity = positive(text, Base::Time, "60 s")?;
    quantity.time().ok_or_else(|| "this is not a time".into())
}

/// Reads a time that a board stores, ms; 0 means off.
pub(crate) fn kept_time(text: &str) -> Result<u16, String> {
    if text == "off" {
        return Ok(0);
    }
    let ms = (duration(text)?.seconds() * 1000.0).round();
    if (1.0..=65_535.0).contains(&ms) { Ok(ms as u16) } else { Err("a board keeps 1 ms to 65.535 s, or off".into()) }
}

/// Reads an exposure: a time, or a part of a second as cameras show it: 1/500.
pub(crate) fn exposure(text: &str) -> Result<f64, String> {
    let example = "write it like \"2 ms\" or 1/500";
    if let Some((over, under)) = text.trim_end_matches('s').trim().split_once('/') {
        let parts = (over.trim().parse::<f64>(), under.trim().parse::<f64>());
        let (Ok(over), Ok(under)) = parts else { return Err(example.into()) };
        let seconds = over / under;
        return if seconds > 0.0 && seconds < 10.0 { Ok(seconds) } else { Err(example.into()) };
    }
    duration(text).map(Time::seconds).map_err(|error| format!("{error}; {example}"))
}

/// Reads a shutter's read-out time: a time, or 0.
pub(crate) fn readout(text: &str) -> Result<f64, String> {
    let quantity =
        Quantity::parse(text).ok().filter(|quantity| (quantity.base, quantity.per_seconds) == (Base::Time, 0));
    let seconds = quantity.map(|quantity| quantity.value).or_else(|| (text.trim() == "0").then_some(0.0));
    seconds.filter(|seconds| (-1.0..=1.0).contains(seconds)).ok_or_else(|| "write it like \"8 ms\", or 0".into())
}

/// Reads an angle, in steps too.
pub(crate) fn angle(text: &str) -> Result<Quantity, String> {
    let quantity = Quantity::parse(text).map_err(|error| format!("{error}; write it like \"2 deg\""))?;
    let is_angle = matches!(quantity.base, Base::Turn | Base::Step) && quantity.per_seconds == 0;
    match (is_angle, quantity.value > 0.0) {
        (true, true) => Ok(quantity),
        (true, false) => Err("it must be more than 0; write it like \"2 deg\"".into()),
        (false, _) => Err(format!("this is {}; write it like \"2 deg\"", quantity.kind())),
    }
}

/// Reads how much of a motion is meant: a time, or "forever".
fn length(text: &str) -> Result<Time, String> {
    if text.trim().eq_ignore_ascii_case("forever") { Ok(FOREVER) } else { duration(text) }
}

pub(crate) fn frequency(text: &str) -> Result<f64, String> {
    measured(text, (Base::Cycle, 1), "25 MHz").map(|quantity| quantity.value)
}

pub(crate) fn inductance(text: &str) -> Result<f64, String> {
    positive(text, Base::Inductance, "50mH").map(|quantity| quantity.value)
}

pub(crate) fn current(text: &str) -> Result<f64, String> {
    positive(text, Base::Current, "0.135A").map(|quantity| quantity.value)
}

pub(crate) fn voltage(text: &str) -> Result<f64, String> {
    positive(text, Base::Voltage, "12V").map(|quantity| quantity.value)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The profiles for connections and those for plans are joined by the name.
    #[test]
    fn every_board_with_a_firmware_has_limits() {
        for kind in BoardKind::ALL {
            assert!(boards::find(kind.name()).is_some(), "{kind:?}");
            assert_eq!(BoardKind::named(kind.name()), Some(kind));
            assert_eq!(BoardKind::numbered(kind.number()), Some(kind));
        }
    }
}
