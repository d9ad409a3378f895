//! Reads motion files from the disk and prepares them for planning.

use std::path::Path;

use miette::{Report, miette};
use pulsetrain_motion::Time;
use pulsetrain_motion::file::{self, Contents};
use pulsetrain_session::prepare::Prepared;

use crate::diagnostic::{WrongFile, advised};

/// Reads a motion file, and puts it on `board` if that is given. Endless laws stay endless.
///
/// # Errors
/// When the file is wrong, or does not fit the board.
pub fn endless(path: &Path, board: Option<&str>) -> miette::Result<Prepared> {
    let contents = contents(path)?;
    Prepared::new(path.display().to_string(), contents, board).map_err(advised)
}

/// Reads a motion file.
///
/// # Errors
/// When the file is wrong, or is not there: then it says which file of that name there is.
pub fn contents(path: &Path) -> miette::Result<Contents> {
    file::load_contents(path).map_err(|error| not_found(path).unwrap_or_else(|| WrongFile::from(error).into()))
}

/// The error for a file that is not there, if another one is probably meant: `NAME.toml`, or one of `examples/`.
fn not_found(path: &Path) -> Option<Report> {
    if path.try_exists().is_ok_and(|exists| exists) {
        return None;
    }
    let with_ending = path.with_added_extension("toml");
    let names = [path.to_owned(), with_ending];
    let examples = names.iter().filter_map(|name| Some(Path::new("examples").join(name.file_name()?)));
    let found = names.iter().cloned().chain(examples).find(|name| name.is_file())?;
    let help = format!("did you mean {}?", found.display());
    Some(miette!(help = help, "there is no file {}", path.display()))
}

/// Reads a motion file, and cuts its endless laws after `length`.
///
/// # Errors
/// As [`endless`], and if a law has no value before the cut.
pub fn load(path: &Path, board: Option<&str>, length: Option<Time>) -> miette::Result<Prepared> {
    endless(path, board)?.ending(length).map_err(advised)
}
