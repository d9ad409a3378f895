//! `pulsetrain ports`: what is plugged in.

use clap::Args;
use std::path::Path;

use pulsetrain_board::serial::{self, Listed, Usb};
use pulsetrain_board::{BoardKind, Remote, RemoteError, Serial};
use schemars::JsonSchema;
use serde::Serialize;

use super::flash;
use crate::console::{Console, Exit};
use crate::files::inputs;
use crate::midi;
use pulsetrain_motion::human::{self, Table};
use pulsetrain_session::drive::session_number;

#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  pulsetrain ports
  pulsetrain ports --ask")]
pub(crate) struct PortsArgs {
    /// Open each port, and ask whether Pulsetrain's firmware is there. That resets an Uno
    #[arg(long)]
    pub(crate) ask: bool,
    /// List the MIDI ports instead, for `pulsetrain live --midi`
    #[arg(long, conflicts_with_all = ["ask", "json"])]
    pub(crate) midi: bool,
    /// Print the list as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

/// What is at a port, by its USB device's numbers.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct PortEntry {
    /// The port, or a Pico's drive.
    port: String,
    /// What is there.
    what: String,
    /// The USB device's numbers, vendor:product.
    #[serde(skip_serializing_if = "Option::is_none")]
    usb: Option<String>,
    /// Its serial number.
    #[serde(skip_serializing_if = "Option::is_none")]
    serial: Option<String>,
    /// The board's answer if the user wants it, or what the user can do.
    #[serde(skip_serializing_if = "Option::is_none")]
    says: Option<String>,
}

pub(crate) fn run(args: &PortsArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    if args.midi {
        let names = midi::ports()?;
        let none = "no MIDI port was found: is the device plugged in?".to_owned();
        console.print(format_args!("{}\n", if names.is_empty() { none } else { names.join("\n") }))?;
        return Ok(Exit::Success);
    }
    let mut found: Vec<PortEntry> = serial::list().into_iter().map(|port| look(port, args.ask)).collect();
    for kind in BoardKind::ALL {
        found.extend(flash::drives(kind).iter().map(|drive| found_drive(kind, drive)));
    }
    if args.json {
        console.print_json(&found)?;
        return Ok(Exit::Success);
    }
    console.print(text(found))?;
    Ok(Exit::Success)
}

fn text(found: Vec<PortEntry>) -> String {
    if found.is_empty() {
        return NONE.to_owned();
    }
    let mut table = Table::new(["port", "what it is", "USB", "serial number", "says"]).left(&[0, 1, 2, 3, 4]);
    for PortEntry { port, what, usb, serial, says } in found {
        table.row([port, what, usb.unwrap_or_default(), serial.unwrap_or_default(), says.unwrap_or_default()]);
    }
    table.to_string()
}

const NONE: &str = "\
no serial port was found, and no Pico that waits for an image
  Is the board plugged in, by a cable that has data lines too? (Many that come with lamps and toys have none.)
  On Linux `dmesg | tail` tells what the system makes of it; in a container ports have to be let in (--device).
";

/// The drive as which a board shows up that waits for an image.
fn found_drive(kind: BoardKind, drive: &Path) -> PortEntry {
    let says = Some(format!("`pulsetrain flash {}` writes the firmware", kind.name()));
    let maker_name = kind.full_name().trim_start_matches("an ").trim_start_matches("a ");
    let (port, what) = (drive.display().to_string(), format!("{maker_name}, waiting for an image"));
    PortEntry { port, what, usb: None, serial: None, says }
}

fn look(port: Listed, ask: bool) -> PortEntry {
    let Listed { name, usb } = port;
    let what = usb.as_ref().map_or_else(|| "no USB device".to_owned(), what);
    let says = if !may_open(&name) {
        Some(no_permission(&name))
    } else if ask && usb.is_some() {
        Some(answer(&name))
    } else {
        None
    };
    let ids = usb.as_ref().map(|usb| format!("{:04x}:{:04x}", usb.vendor, usb.product));
    PortEntry { port: name, what, usb: ids, serial: usb.and_then(|usb| usb.serial), says }
}

/// Whether a port is the USB of a board with our firmware, and not an adapter or a bridge, as far as this computer
/// knows.
pub(super) fn is_own_usb(name: &str) -> bool {
    // A symbolic link to a port has another name.
    let path = |name: &str| std::fs::canonicalize(name).unwrap_or_else(|_| name.into());
    let is_own = |port: &Listed| port.usb.as_ref().is_some_and(|usb| (usb.vendor, usb.product) == OWN_USB);
    serial::list().iter().any(|port| is_own(port) && path(&port.name) == path(name))
}

/// The USB name of a Pico with our firmware.
const OWN_USB: (u16, u16) = (0x1209, 0x0001);

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
    (OWN_USB.0, OWN_USB.1, "Raspberry Pi Pico with Pulsetrain"),
];

fn what(usb: &Usb) -> String {
    let known = KNOWN.iter().find(|(vendor, product, _)| (*vendor, *product) == (usb.vendor, usb.product));
    match (known, &usb.name) {
        (Some((_, _, what)), _) => (*what).to_owned(),
        (None, Some(name)) => name.clone(),
        (None, None) => "unknown".to_owned(),
    }
}

/// Asks the board at a port for its report.
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

/// Whether the user may read and write a device, access lists included (access(2)). The device is not opened, since
/// that would reset an Uno.
#[cfg(target_os = "linux")]
fn may_open(name: &str) -> bool {
    use rustix::fs::{Access, access};
    access(name, Access::READ_OK | Access::WRITE_OK) != Err(rustix::io::Errno::ACCESS)
}

#[cfg(not(target_os = "linux"))]
fn may_open(_: &str) -> bool {
    true
}

/// What the user can do about a device that they may not open.
#[cfg(target_os = "linux")]
fn no_permission(name: &str) -> String {
    use std::os::unix::fs::MetadataExt;
    let group = std::fs::metadata(name).map_or(0, |device| device.gid());
    how_to_join(group, &inputs::of_system(Path::new("/etc/group")))
}

#[cfg(not(target_os = "linux"))]
fn no_permission(_: &str) -> String {
    String::new()
}

/// The advice for a device whose group has the number `gid`; `groups` is the text of /etc/group (group(5)).
#[cfg(target_os = "linux")]
fn how_to_join(group: u32, groups: &str) -> String {
    let fields = groups.lines().map(|line| line.split(':').collect::<Vec<_>>());
    let name =
        fields.filter(|fields| fields.get(2) == Some(&group.to_string().as_str())).map(|fields| fields[0]).next();
    match name.filter(|_| group != 0) {
        Some(name) => {
            format!("no permission: sudo usermod -aG {name} $USER, then log in again; or the rules of docs/udev")
        }
        None => "no permission: the rules of docs/udev give it".to_owned(),
    }
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
    fn who_may_not_open_a_port_is_told_of_its_group() {
        let groups = "root:x:0:\ndialout:x:20:me\nuucp:x:986:\n";
        assert!(how_to_join(986, groups).contains("usermod -aG uucp $USER"));
        assert!(how_to_join(20, groups).contains("usermod -aG dialout $USER"));
        for none in [0, 21] {
            assert!(!how_to_join(none, groups).contains("usermod"), "{none}");
        }
    }

    #[test]
    fn a_port_is_told_by_its_device() {
        let usb = Usb { vendor: 0x2341, product: 0x43, name: None, serial: Some("7593".into()) };
        let name = std::env::temp_dir().display().to_string();
        let found = look(Listed { name: name.clone(), usb: Some(usb) }, false);
        assert_eq!((found.port, found.what.as_str()), (name.clone(), "Arduino Uno"));
        assert_eq!((found.usb.as_deref(), found.serial.as_deref()), (Some("2341:0043"), Some("7593")));
        assert_eq!(found.says, None, "it was not asked");
        // A port without a USB device is never opened.
        let plain = look(Listed { name, usb: None }, true);
        assert_eq!((plain.what.as_str(), plain.says), ("no USB device", None));
    }

    /// Each USB number is in the table once.
    #[test]
    fn known_numbers_are_there_once() {
        for (vendor, product, name) in KNOWN {
            let usb = Usb { vendor, product, name: None, serial: None };
            assert_eq!(what(&usb), name);
        }
    }

    #[test]
    fn what_is_found_is_a_table_and_nothing_is_told_as_such() {
        assert_eq!(text(Vec::new()), NONE);
        let drive = found_drive(BoardKind::of(&pulsetrain_board::profiles::PICO), Path::new("/media/me/RPI-RP2"));
        let text = text(vec![drive]);
        assert!(text.contains("/media/me/RPI-RP2") && text.contains("waiting for an image"), "{text}");
        assert!(!text.contains("no serial port was found"), "{text}");
    }
}
