//! Errors that several commands meet, with advice for the user.

use std::path::Path;

use miette::{Diagnostic, Report, miette};
use pulsetrain_board::profiles::Role;
use pulsetrain_board::{BoardKind, LinkError, PortError, RemoteError, VirtualBoard};

use crate::console;
use crate::control_socket::{RunClient, port_paths, runs};
use crate::diagnostic::advised;
use crate::files::outputs;
use crate::way_back::quoted;
use pulsetrain_motion::human;
use pulsetrain_report::run_report::StoppedReport;
use pulsetrain_session::SessionError;
use pulsetrain_session::drive::DriveError;
use pulsetrain_session::prepare::WORST_CLOCK_PPM;

/// The error for a port, with advice unless its own text has it.
pub(crate) fn port_problem(error: PortError) -> Report {
    let help = match &error {
        PortError::NotThere { .. } | PortError::Unusable { .. } => {
            "an Uno is usually /dev/ttyACM0, /dev/cu.usbmodem… or COM3; so is the adapter at a Pico's UART"
        }
        PortError::Busy { name } => return taken_by_run(name, "").unwrap_or_else(|| miette!("{error}")),
        PortError::Denied { .. } => return miette!("{error}"),
        PortError::Gone { .. } => "look at the cable; the motors brake within half a second",
    };
    miette!(help = help, "{error}")
}

/// The error for a port that a run on this computer is using; `None` if no run uses it. If that run is a live motion, the help begins with `instead`:
/// what the user can type there without ending it.
pub(crate) fn taken_by_run(port: &str, instead: &str) -> Option<Report> {
    let runs = runs().ok()?;
    let info = runs.iter().map(RunClient::info).find(|info| info.is_at(port, &port_paths(port)))?;
    let end = format!("`pulsetrain stop --port {}`", quoted(port));
    let help = match (info.is_live, instead) {
        (true, "") => format!("end it first: {end}"),
        (true, instead) => format!("{instead}; or end it first: {end}"),
        (false, _) => format!("wait for its end, or end it: {end}"),
    };
    let which = if info.is_live { "live motion" } else { "run" };
    Some(miette!(help = help, "{port} is in use: the {which} of {} has it", info.file))
}

/// How far a board's clock is off, in words, to `digits` digits. The figure is useless if this computer was too slow for the board.
pub(crate) fn clock_off((ppm, doubt): (f64, f64), digits: usize) -> String {
    let why = if ppm.abs() > WORST_CLOCK_PPM {
        ": more than any board's; this computer was too busy, or is too slow for a virtual board"
    } else {
        ""
    };
    let (ppm, doubt) = (human::significant(ppm, digits), human::significant(doubt, 2));
    format!("{ppm} ppm off this computer's, give or take {doubt}{why}")
}

/// A run that ended before the motion did. Its report is written. Exit code 3.
#[derive(Debug, thiserror::Error, Diagnostic)]
#[error("{}", .report.stopped.message)]
pub(crate) struct RunStopped {
    pub(crate) report: Box<StoppedReport>,
    #[help]
    help: String,
}

/// An Uno runs another of its images than a command needs.
#[derive(Clone, Copy, Debug, thiserror::Error)]
#[error("{}", RemoteError::OtherImage { is, wanted })]
pub(crate) struct OtherImage {
    /// The image that the board runs: [`image_name`](pulsetrain_board::remote::image_name).
    pub(crate) is: &'static str,
    /// The image that the command needs.
    pub(crate) wanted: &'static str,
}

impl Diagnostic for OtherImage {
    fn help<'a>(&'a self) -> Option<Box<dyn std::fmt::Display + 'a>> {
        Some(Box::new(format!("write it to the board: `{}`", self.command("PORT"))))
    }
}

impl OtherImage {
    /// The image's name for `flash --image`. The board's first image needs none.
    pub(super) fn image(&self) -> Option<&'static str> {
        Some(self.wanted).filter(|wanted| *wanted != "uno")
    }

    /// The command that writes the image to the board at `port`.
    pub(super) fn command(&self, port: &str) -> String {
        let image = self.image().map_or_else(String::new, |image| format!(" --image {image}"));
        format!("pulsetrain flash uno --port {port}{image}")
    }
}

/// The error for a run. If the motors had begun to move, its report is written to `folder` first.
pub(crate) fn run_problem(error: DriveError, report: Option<Box<StoppedReport>>, folder: &Path) -> Report {
    let problem = drive_problem(error);
    let Some(mut report) = report else { return problem };
    let help = problem.help().map_or_else(String::new, |help| help.to_string());
    report.stopped.help.clone_from(&help);
    let written = console::json(&report)
        .and_then(|text| Ok(outputs::write(&folder.join("report.json"), "--out", format!("{text}\n").as_bytes())?));
    // The stop matters more than the file.
    let help = match written {
        Ok(()) => help,
        Err(error) => format!("{help}\n{error}").trim_start().to_owned(),
    };
    RunStopped { report, help }.into()
}

/// The virtual board, if there is one of that kind.
pub(super) fn virtual_board(kind: BoardKind, role: Role) -> miette::Result<Box<dyn VirtualBoard>> {
    kind.virtual_board(role).ok_or_else(|| drive_problem(DriveError::NoVirtualBoard { board: kind.title() }))
}

/// The error for a run, with advice.
pub(crate) fn drive_problem(error: DriveError) -> Report {
    let help = match &error {
        DriveError::Remote(RemoteError::Port(port)) => return port_problem(port.clone()),
        DriveError::Remote(RemoteError::Link(LinkError::Nobody | LinkError::Version { .. })) => {
            "write the firmware to the board, also over a motion that was baked for an Uno, which does not answer: \
             `pulsetrain flash uno --port PORT`; a Pico: hold BOOTSEL as you plug it in, then \
             `pulsetrain flash pico`. A board that speaks text alone, as the StepperWinch sketch and `board winch`: \
             `pulsetrain winch --port PORT`"
        }
        DriveError::NoVirtualBoard { .. } => "say --port with the port of a real one",
        DriveError::Remote(RemoteError::OtherBoard { .. }) => "say --board with the board that is there",
        DriveError::Remote(RemoteError::OtherImage { is, wanted }) => return OtherImage { is, wanted }.into(),
        DriveError::Remote(RemoteError::Link(LinkError::Taken)) => {
            "end the other program, or wait 2 s. If text has switched its drivers on (`pulsetrain winch`, a StepperWinch client), it \
             has it until the line `enable 0` comes: echo \"enable 0\" | pulsetrain winch --port PORT"
        }
        DriveError::Remote(RemoteError::Link(LinkError::Lost | LinkError::Forgotten)) => {
            "look at cable, supply and hub; a board that is reset on the way loses its positions"
        }
        DriveError::Remote(RemoteError::Link(LinkError::Unanswered)) => {
            "reset the board (its button, or pull its plug) and run again; if that does not help, write the firmware again: `pulsetrain flash`"
        }
        DriveError::Remote(RemoteError::StillMoving) => {
            "wait until they rest, or stop them at once, wherever they are: `pulsetrain stop --port PORT`"
        }
        DriveError::Remote(RemoteError::Refused { .. }) => "`pulsetrain info --port PORT` shows the board's limits",
        DriveError::Session(SessionError::NotBegun) => {
            "close other programs, or plug the board in without a hub, and run again"
        }
        DriveError::TooLate { .. } => "a faster line (--baud), a computer that does less meanwhile, a slower motion",
        DriveError::Remote(RemoteError::Stopped { .. }) => {
            "the motors braked, or stopped where they were; `pulsetrain info --port PORT` shows the board's counters"
        }
        DriveError::QueueTooShort { queue_bytes, .. } => {
            let each: Vec<String> = queue_bytes.iter().map(u32::to_string).collect();
            let each = if each.is_empty() {
                String::new()
            } else {
                format!(" (each has {} bytes with 1, 2, … of them)", each.join(", "))
            };
            let help = format!(
                "what fits: fewer motors{each}, a wider tolerance, or a slower motion; --native runs it \
                 without a board"
            );
            return miette!(help = help, "{error}");
        }
        _ => return advised(error),
    };
    miette!(help = help, "{error}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_that_no_board_has_is_told_as_the_computers() {
        assert_eq!(clock_off((-1234.5, 70.0), 3), "−1230 ppm off this computer's, give or take 70");
        assert!(clock_off((-386_000.0, 94.0), 3).contains("give or take 94: more than any board's; this computer"));
    }

    #[test]
    fn an_uno_with_another_image_tells_how_it_gets_the_right_one() {
        for (is, wanted, image) in [("winch", "uno", "PORT`"), ("uno", "verbs", "PORT --image verbs`")] {
            let other = drive_problem(DriveError::Remote(RemoteError::OtherImage { is, wanted }));
            assert!(other.to_string().contains(&format!("the image `{is}`")), "{other}");
            assert!(other.help().is_some_and(|help| help.to_string().contains(&format!("flash uno --port {image}"))));
        }
    }

    #[test]
    fn a_board_that_text_has_tells_how_it_gets_free() {
        let taken = drive_problem(DriveError::Remote(RemoteError::Link(LinkError::Taken)));
        assert!(taken.to_string().contains("`enable 0`"), "{taken}");
        assert!(taken.help().is_some_and(|help| help.to_string().contains("pulsetrain winch --port PORT")));
    }
}
