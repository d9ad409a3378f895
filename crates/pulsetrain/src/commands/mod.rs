//! The commands, one file each.

pub(crate) mod bake;
pub(crate) mod bench;
pub(crate) mod board;
pub(crate) mod boards;
pub(crate) mod calibrate;
pub(crate) mod drivers;
pub(crate) mod explain;
pub(crate) mod flash;
pub(crate) mod info;
pub(crate) mod motor;
pub(crate) mod new;
pub(crate) mod on_port;
pub(crate) mod plan;
pub(crate) mod plot;
pub(crate) mod ports;
pub(crate) mod run;
pub(crate) mod verify;
pub(crate) mod winch;

use miette::{Report, miette};
use pulsetrain_board::{LinkError, PortError, RemoteError, SwitchRefused};

use crate::drive::DriveError;
use crate::session::SessionError;

/// What is wrong with a port, with what to do where the error itself does not say.
pub(crate) fn port_problem(error: PortError) -> Report {
    let help = match &error {
        PortError::NotThere { .. } | PortError::Unusable { .. } => {
            "an Uno is usually /dev/ttyACM0, /dev/cu.usbmodem… or COM3; so is the adapter at a Pico's UART"
        }
        PortError::Busy { .. } | PortError::Denied { .. } => return miette!("{error}"),
        PortError::Gone { .. } => "look at the cable; the motors stop as planned, within half a second or so",
    };
    miette!(help = help, "{error}")
}

/// What is wrong with a run, with what to do.
pub(crate) fn drive_problem(error: DriveError) -> Report {
    let help = match &error {
        DriveError::Remote(RemoteError::Port(port)) => return port_problem(port.clone()),
        DriveError::Remote(RemoteError::Link(LinkError::Nobody | LinkError::Version { .. })) => {
            "write the firmware to the board: `pulsetrain flash uno --port PORT`; a Pico: hold BOOTSEL as you plug it in, then \
             `pulsetrain flash pico`"
        }
        DriveError::Remote(RemoteError::OtherBoard { .. }) => "say --board with the board that is there",
        DriveError::Remote(RemoteError::Link(LinkError::Taken)) => "end the other program, or wait 2 s",
        DriveError::Remote(RemoteError::Link(LinkError::Lost | LinkError::Forgotten)) => {
            "look at cable, supply and hub; a board that is reset on the way loses its positions"
        }
        DriveError::Remote(RemoteError::Refused { .. }) => "`pulsetrain info` tells the board's limits",
        DriveError::Session(SessionError::Switch(SwitchRefused::Late { .. })) => {
            "the next part came too late: a faster line (--baud), a computer that does less meanwhile, a slower motion"
        }
        DriveError::Remote(RemoteError::Stopped { .. }) => {
            "the motors came to rest as planned, or where they were; `pulsetrain info` tells how the board fared"
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
        _ => return Report::new(error),
    };
    miette!(help = help, "{error}")
}
