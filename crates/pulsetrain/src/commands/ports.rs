//! `pulsetrain ports`: what is plugged in.

use pulsetrain_board::serial::{self, Listed, Usb};
use pulsetrain_board::{Remote, RemoteError, Serial};
use serde::Serialize;

use super::flash;
use crate::cli::Ports;
use crate::console::{Console, Exit};
use crate::drive::session_number;
use crate::human::{self, Table};

/// What is at a port, as its USB device says.
#[derive(Debug, Serialize)]
struct Found {
    /// Port, or a Pico's drive.
    port: String,
    what: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    usb: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    serial: Option<String>,
    /// The answer, if it was asked; or what is to be done.
    #[serde(skip_serializing_if = "Option::is_none")]
    says: Option<String>,
}

pub(crate) fn run(args: &Ports, console: &mut Console<'_>) -> miette::Result<Exit> {
    let mut found: Vec<Found> = serial::list().into_iter().map(|port| look(port, args.ask)).collect();
    for drive in flash::drives() {
        let says = Some("`pulsetrain flash pico` writes the firmware".to_owned());
        let (port, what) = (drive.display().to_string(), "Raspberry Pi Pico, waiting for an image".to_owned());
        found.push(Found { port, what, usb: None, serial: None, says });
    }
    if args.json {
        console.print_json(&found)?;
        return Ok(Exit::Success);
    }
    if found.is_empty() {
        console.print(NONE)?;
        return Ok(Exit::Success);
    }
    let mut table = Table::new(["port", "what it is", "USB", "serial number", "says"]).left(&[0, 1, 2, 3, 4]);
    for Found { port, what, usb, serial, says } in found {
        table.row([port, what, usb.unwrap_or_default(), serial.unwrap_or_default(), says.unwrap_or_default()]);
    }
    console.print(table)?;
    Ok(Exit::Success)
}

const NONE: &str = "\
no serial port was found, and no Pico that waits for an image
  Is the board plugged in, by a cable that has data lines too? (Many that come with lamps and toys have none.)
  On Linux `dmesg | tail` tells what the system makes of it; in a container ports have to be let in (--device).
";

fn look(port: Listed, ask: bool) -> Found {
    let Listed { name, usb } = port;
    let what = usb.as_ref().map_or_else(|| "no USB device".to_owned(), what);
    let says = if !may_open(&name) {
        Some("no permission: sudo usermod -aG dialout $USER, then log in again".to_owned())
    } else if ask && usb.is_some() {
        Some(answer(&name))
    } else {
        None
    };
    let ids = usb.as_ref().map(|usb| format!("{:04x}:{:04x}", usb.vendor, usb.product));
    Found { port: name, what, usb: ids, serial: usb.and_then(|usb| usb.serial), says }
}

/// Boards and adapters by their USB numbers. Sources: the udev and boards.txt files of the Arduino cores (arduino,
/// 2341 and 2a03), usb.ids for adapters, raspberrypi/usb-pid for 2e8a, firmware/pico/src/usb.rs for 1209:0001.
const KNOWN: [(u16, u16, &str); 14] = [
    (0x2341, 0x0043, "Arduino Uno"),
    (0x2341, 0x0001, "Arduino Uno"),
    (0x2341, 0x0243, "Arduino Uno"),
    (0x2a03, 0x0043, "Arduino Uno"),
    (0x2341, 0x006a, "Arduino Uno Mini"),
    (0x2341, 0x0010, "Arduino Mega 2560: no board of Pulsetrain's"),
    (0x2341, 0x0042, "Arduino Mega 2560: no board of Pulsetrain's"),
    (0x2341, 0x8036, "Arduino Leonardo: no board of Pulsetrain's"),
    (0x1a86, 0x7523, "CH340: an Uno's or Nano's clone, often"),
    (0x0403, 0x6001, "FT232: a Nano, or an adapter"),
    (0x10c4, 0xea60, "CP210x: an adapter"),
    (0x2e8a, 0x000a, "Raspberry Pi Pico with another firmware"),
    (0x2e8a, 0x000c, "Raspberry Pi Debug Probe: an adapter"),
    (0x1209, 0x0001, "Raspberry Pi Pico with Pulsetrain"),
];

fn what(usb: &Usb) -> String {
    let known = KNOWN.iter().find(|(vendor, product, _)| (*vendor, *product) == (usb.vendor, usb.product));
    match (known, &usb.name) {
        (Some((_, _, what)), _) => (*what).to_owned(),
        (None, Some(name)) => name.clone(),
        (None, None) => "unknown".to_owned(),
    }
}

/// What answers at a port.
fn answer(name: &str) -> String {
    let port = match Serial::open(name, false) {
        Ok(port) => port,
        Err(error) => return error.to_string(),
    };
    match Remote::open(port, session_number()) {
        Ok(board) => {
            let firmware = human::version(board.info().firmware);
            board.close();
            format!("Pulsetrain {firmware}")
        }
        Err(RemoteError::Port(error)) => error.to_string(),
        Err(error) => format!("not ready: {error}"),
    }
}

/// Whether the user may read and write a device, as far as its owner, group and mode say; it is not opened, which would reset an
/// Uno.
#[cfg(target_os = "linux")]
fn may_open(name: &str) -> bool {
    use std::os::unix::fs::MetadataExt;
    let (Ok(device), Ok(status)) = (std::fs::metadata(name), std::fs::read_to_string("/proc/self/status")) else {
        return true;
    };
    permits(device.mode(), device.uid(), device.gid(), &status)
}

#[cfg(not(target_os = "linux"))]
fn may_open(_: &str) -> bool {
    true
}

/// The same from the device's mode, owner and group, and the text of /proc/self/status (proc(5)).
#[cfg(target_os = "linux")]
fn permits(mode: u32, owner: u32, group: u32, status: &str) -> bool {
    let numbers = |field: &str| -> Vec<u32> {
        let line = status.lines().find_map(|line| line.strip_prefix(field)).unwrap_or_default();
        line.split_whitespace().filter_map(|number| number.parse().ok()).collect()
    };
    // Real, effective, saved and file system's: the second decides.
    let (user, own) = (numbers("Uid:").get(1).copied(), numbers("Gid:").get(1).copied());
    let Some(user) = user else { return true };
    let class = if user == owner {
        6
    } else if own == Some(group) || numbers("Groups:").contains(&group) {
        3
    } else {
        0
    };
    user == 0 || mode >> class & 0o6 == 0o6
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boards_are_known_by_their_numbers() {
        let usb =
            |vendor, product, name: Option<&str>| Usb { vendor, product, name: name.map(str::to_owned), serial: None };
        assert_eq!(what(&usb(0x2341, 0x43, Some("Communication Device"))), "Arduino Uno");
        assert_eq!(what(&usb(0x1209, 1, None)), "Raspberry Pi Pico with Pulsetrain");
        assert_eq!(what(&usb(1, 2, Some("Teapot"))), "Teapot");
        assert_eq!(what(&usb(1, 2, None)), "unknown");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn permissions_are_those_of_owner_group_and_others() {
        let status = "Name:\tx\nUid:\t1000\t1000\t1000\t1000\nGid:\t1000\t1000\t1000\t1000\nGroups:\t4 20 1000\n";
        for (mode, owner, group, may) in [
            (0o660, 0, 20, true),
            (0o660, 0, 30, false),
            (0o666, 0, 30, true),
            (0o600, 0, 20, false),
            (0o600, 1000, 20, true),
            (0o440, 1000, 20, false),
        ] {
            assert_eq!(permits(mode, owner, group, status), may, "{mode:o} {owner} {group}");
        }
        assert!(permits(0o000, 5, 5, "Uid:\t0\t0\t0\t0\n"), "root");
    }
}
