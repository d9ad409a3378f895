//! Reads motion files from the disk and prepares them for planning.

use std::path::Path;

use pulsetrain_motion::program::Wheel;
use pulsetrain_motion::{Time, file};
use pulsetrain_session::prepare::Prepared;

use crate::diagnostic::{WrongFile, advised};

/// Reads a motion file, and puts it on `board` if that is given. Endless laws stay endless.
///
/// # Errors
/// When the file is wrong, or does not fit the board.
pub fn endless(path: &Path, board: Option<&str>) -> miette::Result<Prepared> {
    let contents = file::load_contents(path).map_err(WrongFile::from)?;
    Prepared::new(path.display().to_string(), contents, board).map_err(advised)
}

/// Reads a motion file as [`endless`] does, and what its motors turn, in their order.
///
/// # Errors
/// As [`endless`].
pub fn with_wheels(path: &Path, board: Option<&str>) -> miette::Result<(Prepared, Vec<Wheel>)> {
    let contents = file::load_contents(path).map_err(WrongFile::from)?;
    let wheels = contents.wheels.clone();
    let prepared = Prepared::new(path.display().to_string(), contents, board).map_err(advised)?;
    Ok((prepared, wheels))
}

/// Reads a motion file, and cuts its endless laws after `length`.
///
/// # Errors
/// As [`endless`], and if a law has no value before the cut.
pub fn load(path: &Path, board: Option<&str>, length: Option<Time>) -> miette::Result<Prepared> {
    endless(path, board)?.ending(length).map_err(advised)
}
