//! Motion files from the disk, ready to be planned.

use std::path::Path;

use pulsetrain_motion::{Time, file};
use pulsetrain_session::prepare::Prepared;

use crate::diagnostic::advised;

/// Reads a motion file and puts it on `board` if that is given; endless laws stay so.
///
/// # Errors
/// When the file is wrong, or does not fit the board.
pub fn endless(path: &Path, board: Option<&str>) -> miette::Result<Prepared> {
    let contents = file::load_contents(path)?;
    Prepared::new(path.display().to_string(), contents, board).map_err(advised)
}

/// The same, and cuts endless laws after `length`.
///
/// # Errors
/// As [`endless`], and when a law breaks before it can be cut.
pub fn load(path: &Path, board: Option<&str>, length: Option<Time>) -> miette::Result<Prepared> {
    endless(path, board)?.ending(length).map_err(advised)
}
