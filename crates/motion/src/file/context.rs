//! Everything outside its own table that the meaning of a law depends on: the motor, the files that a motion file
//! names, units.

use std::io;
use std::path::Path;

use super::motor::Gearing;
use super::reader::{Node, Noted, Read, Reader};
use super::text;
use crate::law::LawError;
use crate::motor::Limits;
use crate::quantity::{Quantity, unit_meant};

/// Reads the text of a file that a motion file names, relative to it.
pub(super) type Loader<'a> = &'a dyn Fn(&Path) -> io::Result<String>;

/// Everything outside its own table that the meaning of a law depends on.
pub(super) struct Context<'a> {
    pub(super) reader: &'a Reader,
    pub(super) motor: &'a str,
    pub(super) gearing: &'a Gearing,
    pub(super) limits: &'a Limits,
    pub(super) load: Loader<'a>,
}

/// One of the unit of position that is named at `node`.
pub(super) fn position_unit(node: &Node) -> Read<Quantity> {
    let text = node.text("unit = \"rev\"")?;
    // Read as one of it, so that every unit of position is known here too.
    let one = Quantity::parse(&format!("1 {text}")).ok();
    one.filter(|one| one.base.is_position() && one.per_seconds == 0 && !text.trim().is_empty()).ok_or_else(|| {
        let is_position =
            |unit: &String| Quantity::parse(&format!("1 {unit}")).is_ok_and(|one| one.kind().is_position());
        let help = match unit_meant(text).filter(is_position) {
            Some(unit) => format!("write unit = \"{unit}\""),
            None => "one of: rev, deg, rad, mm, step, full-step".to_owned(),
        };
        node.note("not a unit of position", format!("`unit` must be a unit of position, but is \"{text}\""), help)
    })
}

/// Seconds in the unit of a table's times, which is named at `node`.
pub(super) fn time_unit(node: &Node) -> Read<f64> {
    node.word(&[("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("µs", 1e-6), ("ns", 1e-9), ("min", 60.0), ("h", 3600.0)])
}

/// What to do about a table that is too large.
pub(super) const TOO_LARGE: &str =
    "keep every tenth row, or cut it up: motions follow one another, each with a table of its own";

/// A file that a motion file names; what cannot be read is noted.
pub(super) fn load(file: &Node, load: Loader) -> Read<String> {
    let path = file.text("file = \"path.csv\"")?;
    load(Path::new(path)).map_err(|error| -> Noted {
        let help = match error.kind() {
            io::ErrorKind::FileTooLarge => TOO_LARGE,
            io::ErrorKind::NotFound => "paths are relative to the motion file",
            _ => "",
        };
        file.note("cannot be read", format!("cannot read \"{path}\": {}", text::why(&error)), help)
    })
}

/// A law at `node` that cannot be followed.
pub(super) fn refuse(node: &Node, error: &LawError) -> Noted {
    node.note("cannot be followed", error.to_string(), "")
}
