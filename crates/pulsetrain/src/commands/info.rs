//! `pulsetrain info`: prints what a board reports of itself.

use pulsetrain_board::BoardKind;
use pulsetrain_board::profiles::{Role, name_of};
use pulsetrain_board::remote::{image_name, in_words};
use pulsetrain_board::{Board, Port, Remote, RemoteError, Serial};
use pulsetrain_core::wire::message::{Cause, flags, image};
use pulsetrain_core::wire::{Baud, Reason, Stored, VERSION};
use schemars::JsonSchema;
use serde::Serialize;

use super::problems::{clock_off, drive_problem, port_problem, virtual_board};
use super::store::{Kept, stored_in_words};
use crate::arguments::At;
use crate::console::{Console, Exit};
use pulsetrain_motion::human::{self, Table};
use pulsetrain_session::drive::{DriveError, session_number};

/// A board's report of itself. Nothing else confirms it.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct BoardInfo {
    /// What board it is.
    board: &'static str,
    /// The firmware's version.
    firmware: String,
    /// The version of the frames that it speaks.
    protocol: u8,
    /// Which of its images an Uno runs.
    image: Option<&'static str>,
    /// Whether the image plays plans that a host streams.
    plans: bool,
    /// Whether the image reads StepperWinch's text.
    text: bool,
    /// Whether the image obeys verbs.
    verbs: bool,
    /// Ticks per second.
    tick_hz: u32,
    /// Bits of a fraction of a tick.
    fraction_bits: u8,
    /// Motors at most.
    motors: u8,
    /// Bytes of all queues together.
    queue_bytes: u16,
    /// Bytes that may be on their way to it.
    window_bytes: u16,
    /// The rates of the line that it can do.
    bauds: Vec<u32>,
    /// The present rate of the line.
    baud: u32,
    /// Why it stopped last.
    last_stop: &'static str,
    /// Why it restarted last.
    last_reset: &'static str,
    /// Whether the board plays a motion from its flash.
    baked: bool,
    /// Whether motors move, or wait to move.
    pub(super) moves: bool,
    /// Steps of each motor, forward minus backward.
    pub(super) positions: Vec<i32>,
    /// Indices of motors that were stopped above their pull-in speed: they may stand elsewhere than their counts.
    pub(super) uncertain: Vec<usize>,
    /// How much faster than this computer's clock the board's runs, ppm, and how much that may be off.
    clock_ppm: Option<(f64, f64)>,
    /// Time since it restarted, s.
    clock_s: f64,
    /// Least free memory of its stack, bytes.
    stack_left_bytes: u16,
    /// The most bytes that waited to be read.
    most_unread_bytes: u16,
    /// The longest round of the firmware's loop, ticks.
    longest_round_ticks: u16,
    /// Bytes that were lost on the line.
    lost_bytes: u16,
    /// Frames that came damaged.
    damaged_frames: u16,
    /// Only of boards that compare each edge with a timer. A Pico has no such timer.
    compares_missed: Option<u16>,
    /// How late the latest of them was, ticks.
    latest_ticks: Option<u16>,
    /// How many times the step generator had nothing ready.
    starved: u16,
    /// The settings that the board keeps without power.
    keeps: Option<Kept>,
    /// Whether the stored settings are damaged.
    keeps_damaged: bool,
    /// Whether the board did not report its settings, because its motors are powered.
    keeps_untold: bool,
}

pub(crate) fn run(args: &At, console: &mut Console<'_>) -> miette::Result<Exit> {
    let said = match &args.port {
        Some(name) => ask(Serial::open(name, false).map_err(port_problem)?, args.baud),
        None => ask(virtual_board(args.board.unwrap_or_default(), Role::Plans)?, args.baud),
    };
    let said = said.map_err(drive_problem)?;
    if args.json {
        console.print_json(&said)?;
        return Ok(Exit::Success);
    }
    let tick_s = 1.0 / f64::from(said.tick_hz);
    let ticks = |ticks: u16| format!("{ticks} ticks = {}", human::seconds(f64::from(ticks) * tick_s));
    let bauds: Vec<String> = said.bauds.iter().map(|baud| human::count((*baud).into())).collect();
    let clock = match said.clock_ppm {
        Some(off) => clock_off(off, 2),
        None => "not compared".to_owned(),
    };
    let mut table = Table::default().left(&[0, 1]);
    let mut row = |what: &str, value: String| table.row([what.to_owned(), value]);
    row("board", said.board.to_owned());
    let image = said.image.map_or_else(String::new, |image| format!(", image `{image}`"));
    row("firmware", format!("{}{image}, protocol {}", said.firmware, said.protocol));
    let understands = [("plans", said.plans), ("text", said.text), ("verbs", said.verbs)];
    let understands: Vec<_> = understands.into_iter().filter(|(_, does)| *does).map(|(what, _)| what).collect();
    row("understands", understands.join(", "));
    row("tick", format!("{}, {} fraction bits", human::seconds(tick_s), said.fraction_bits));
    row("motors", format!("{} at most", said.motors));
    row("queues", format!("{} B in all; {} B may be under way to it", said.queue_bytes, said.window_bytes));
    row("line", format!("{} baud, of {}", human::count(said.baud.into()), bauds.join(", ")));
    row("began", format!("{} ago: {}", human::seconds(said.clock_s), said.last_reset));
    row("last stop", stopped(said.last_stop, said.last_reset));
    if said.baked {
        row("baked", "a motion in its flash runs".to_owned());
    } else if said.moves {
        row("moves", "for a program that has ended; `pulsetrain stop --port PORT` stops it".to_owned());
    }
    if !said.positions.is_empty() {
        row("counts", format!("{} steps", listed(&said.positions)));
    }
    if !said.uncertain.is_empty() {
        let motors = motor_list(&said.uncertain);
        row("uncertain", format!("{motors}: stopped too fast, may stand elsewhere than counted"));
    }
    row("clock", clock);
    row("longest round", ticks(said.longest_round_ticks));
    row("most unread", format!("{} B", said.most_unread_bytes));
    row("stack left", format!("{} B at least", said.stack_left_bytes));
    if let (Some(missed), Some(latest)) = (said.compares_missed, said.latest_ticks) {
        row("compares missed", format!("{missed}, the latest by {}", ticks(latest)));
    }
    row("keeps", said.keeps());
    row("starved", format!("{} times", said.starved));
    row("line faults", format!("{} bytes lost, {} frames damaged", said.lost_bytes, said.damaged_frames));
    console.print(&table)?;
    Ok(Exit::Success)
}

impl BoardInfo {
    /// The stored settings, in words.
    pub(super) fn keeps(&self) -> String {
        if self.keeps_untold {
            return "not reported while motors are powered".to_owned();
        }
        stored_in_words(self.keeps.as_ref(), self.keeps_damaged)
    }
}

/// Why a board stopped last. Every queue ends in a stop, so the board cannot tell a finished motion from one whose host
/// was killed.
fn stopped(why: &str, last_reset: &str) -> String {
    // Opening an Uno's port restarts it, and it forgets what was before.
    if why == in_words(Cause::None) && last_reset == in_words(Cause::ResetLine) {
        return "not known: opening the port has restarted the board".to_owned();
    }
    if why == in_words(Cause::Finished) {
        return format!("{why} that was queued: to the motion's end, or to the stop that was planned for a lost host");
    }
    why.to_owned()
}

/// Numbers in order, separated by commas.
pub(super) fn listed<N: ToString>(positions: &[N]) -> String {
    positions.iter().map(N::to_string).collect::<Vec<_>>().join(", ")
}

/// Motors by their indices in the board's set-up, from 0.
pub(super) fn motor_list(motors: &[usize]) -> String {
    format!("motor {}", listed(motors))
}

pub(super) fn ask<P: Port>(port: P, baud: Baud) -> Result<BoardInfo, DriveError> {
    /// The clock is looked at again after this time, up to `LOOKS` times. The first look is most often enough for an
    /// estimate.
    const LOOK_S: f64 = 1.0;
    const LOOKS: usize = 4;
    let mut remote = Remote::open(port, session_number())?;
    let measures = remote.measures(false)?;
    let baud = remote.set_baud(baud)?;
    let info = *remote.info();
    let status = remote.status()?;
    let motors = status.motors.as_slice();
    for _ in 0..LOOKS {
        if remote.clock().ppm().is_none() {
            let until = remote.now() + (LOOK_S * f64::from(info.tick_hz)) as u64;
            remote.advance(until, &mut |_| {});
        }
    }
    if let Some(error) = remote.error() {
        return Err(error.clone().into());
    }
    let (stored, keeps_untold) = match remote.stored() {
        Ok(stored) => (stored, false),
        Err(RemoteError::Refused { reason: Reason::Moving | Reason::Baked, .. }) => (Stored::default(), true),
        // This board knows no settings.
        Err(RemoteError::Refused { .. }) => (Stored::default(), false),
        Err(error) => return Err(error.into()),
    };
    let verbs = remote.obeys()?;
    let kind = remote.kind();
    let compares = kind.is_some_and(BoardKind::counts_missed_compares);
    let said = BoardInfo {
        board: name_of(&info).trim_start_matches("an ").trim_start_matches("a "),
        firmware: human::version(info.firmware),
        protocol: VERSION,
        image: (info.image != 0).then(|| image_name(info.image)),
        plans: !matches!(info.image, image::WINCH | image::VERBS),
        text: kind.is_some_and(|kind| !kind.has_image_for_each_role()) || info.image == image::WINCH,
        verbs,
        tick_hz: info.tick_hz,
        fraction_bits: info.fraction_bits,
        motors: info.max_motors,
        queue_bytes: info.pool,
        window_bytes: info.window,
        bauds: Baud::ALL.into_iter().filter(|baud| info.bauds >> *baud as u8 & 1 == 1).map(Baud::rate).collect(),
        baud: baud.rate(),
        last_stop: in_words(info.last_stop),
        last_reset: in_words(info.last_reset),
        baked: status.head.flags & flags::BAKED != 0,
        moves: !status.is_idle(),
        positions: motors.iter().map(|motor| motor.position).collect(),
        uncertain: (0..)
            .zip(motors)
            .filter(|(_, motor)| motor.faults & flags::UNCERTAIN != 0)
            .map(|(number, _)| number)
            .collect(),
        clock_ppm: remote.clock().ppm(),
        clock_s: remote.now() as f64 / f64::from(info.tick_hz),
        stack_left_bytes: measures.stack_left,
        most_unread_bytes: measures.most_unread,
        longest_round_ticks: measures.longest_round_ticks,
        lost_bytes: measures.lost_bytes,
        damaged_frames: measures.damaged_frames,
        compares_missed: compares.then_some(measures.late),
        latest_ticks: compares.then_some(measures.latest_ticks),
        starved: measures.starved,
        keeps: stored.settings.map(Kept::of),
        keeps_damaged: stored.is_damaged,
        keeps_untold,
    };
    remote.close();
    Ok(said)
}

#[cfg(test)]
mod tests {
    use super::*;
    use pulsetrain_board::virtual_uno::VirtualUno;

    /// If a host is killed, its motors run to the stop at the end of their queues. The board reports that as it reports
    /// a motion's end.
    #[test]
    fn an_end_may_be_a_lost_host_s() {
        assert!(stopped(in_words(Cause::Finished), "").contains("lost host"));
        assert_eq!(stopped(in_words(Cause::StopNow), ""), "the host asked for an immediate stop");
        // Opening the port restarts an Uno, which then knows of no stop.
        assert!(stopped(in_words(Cause::None), in_words(Cause::ResetLine)).starts_with("not known: opening the port"));
        assert_eq!(stopped(in_words(Cause::None), in_words(Cause::PowerOn)), "none yet");
    }

    /// Tests that run firmware on an emulated chip.
    mod chips {
        use super::*;

        #[test]
        fn images_tell_what_they_understand() {
            for (uno, expected) in [
                (VirtualUno::new(), ("uno", true, false, false)),
                (VirtualUno::with_winch(), ("winch", false, true, false)),
                (VirtualUno::with_verbs(), ("verbs", false, false, true)),
            ] {
                let said = ask(uno, Baud::B1M).unwrap();
                assert_eq!((said.image.unwrap(), said.plans, said.text, said.verbs), expected);
            }
        }
    }
}
