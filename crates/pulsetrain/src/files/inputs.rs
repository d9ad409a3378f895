//! Files that a user names to be read: each has a most that is read, and what is no file is refused before it is opened.

use std::fs::File;
use std::io::{self, Read as _};
use std::path::Path;

use pulsetrain_motion::file;

pub use crate::live::input_line::{InputLine, next_line};

use super::{Identity, KNOWN};
use crate::access::{Access, access};

/// The largest script of lines that have times, bytes.
pub const MAX_SCRIPT_BYTES: u64 = 16_000_000;
/// The largest image of a board's flash, bytes. A Pico's 2 MB are 4 MB in UF2, and 6 MB in Intel HEX.
pub const MAX_IMAGE_BYTES: u64 = 16_000_000;
/// The largest capture, bytes. In memory it takes some four times as much.
pub const MAX_CAPTURE_BYTES: u64 = 1_000_000_000;
/// The largest log of a live motion, bytes.
pub const MAX_LOG_BYTES: u64 = 1_000_000_000;
/// The longest line that is taken from standard input, bytes. The longest order has some hundred.
pub const MAX_TYPED_BYTES: u64 = 4096;

/// The bytes of a file.
///
/// # Errors
/// When it cannot be read, is no file, or has more than `most` bytes.
pub fn bytes(path: &Path, most: u64) -> Result<Vec<u8>, Access> {
    note(path);
    file::read_named(path, most).map_err(|error| access("read", path, error))
}

/// The text of a motion file, or of one that it names: what [`pulsetrain_motion::file`] reads it by.
///
/// # Errors
/// As [`file::read_named_text`].
pub fn text(path: &Path, most: u64) -> io::Result<String> {
    note(path);
    file::read_named_text(path, most)
}

/// Opens a file that is read bit by bit.
///
/// # Errors
/// As [`bytes`].
pub fn open(path: &Path, most: u64) -> Result<File, Access> {
    note(path);
    file::open_named(path, most).map(|(file, _)| file).map_err(|error| access("read", path, error))
}

/// A text that the system writes, such as a table in /proc; empty if it is not there. `path` is no user's.
#[must_use]
#[expect(clippy::disallowed_methods, reason = "its path is known, and it ends")]
pub fn of_system(path: &Path) -> String {
    const MOST: u64 = 1_000_000;
    let mut bytes = Vec::new();
    let read = File::open(path).and_then(|file| file.take(MOST).read_to_end(&mut bytes));
    read.map_or_else(|_| String::new(), |_| String::from_utf8_lossy(&bytes).into_owned())
}

/// Remembers that the command reads a file: no output goes there.
pub(super) fn note(path: &Path) {
    let identity = Identity::of(path);
    KNOWN.with_borrow_mut(|known| {
        if !known.inputs.iter().any(|(_, known)| *known == identity) {
            known.inputs.push((path.to_owned(), identity));
        }
    });
}
