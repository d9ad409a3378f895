//! Reads motion files from the disk and prepares them for planning.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use miette::miette;
use pulsetrain_motion::Time;
use pulsetrain_motion::file::{self, Contents};
use pulsetrain_motion::program::Wheel;
use pulsetrain_session::prepare::Prepared;

use crate::diagnostic::{WrongFile, advised};
use crate::files::inputs;

/// Reads a motion file, and puts it on `board` if that is given. Endless laws stay endless.
///
/// # Errors
/// When the file is wrong, or does not fit the board.
pub fn endless(path: &Path, board: Option<&str>) -> miette::Result<Prepared> {
    let path = found(path);
    Prepared::new(path.display().to_string(), contents(&path)?, board).map_err(advised)
}

/// The file that is meant: for `crank` that is `crank.toml`, or `examples/crank.toml`, unless there is a file `crank`.
#[must_use]
pub fn found(path: &Path) -> Cow<'_, Path> {
    if path.exists() {
        return Cow::Borrowed(path);
    }
    let with_ending = path.with_added_extension("toml");
    let is_name = path.file_name() == Some(path.as_os_str()) && path.extension().is_none();
    let of_examples = is_name.then(|| Path::new(EXAMPLES).join(&with_ending));
    let found = [Some(with_ending), of_examples].into_iter().flatten().find(|file| file.is_file());
    found.map_or(Cow::Borrowed(path), Cow::Owned)
}

/// The folder of the examples, where this program was unpacked.
const EXAMPLES: &str = "examples";

/// Reads a motion file.
///
/// # Errors
/// When the file is wrong, or is not there.
pub fn contents(path: &Path) -> miette::Result<Contents> {
    let path = found(path);
    file::load_contents_by(&path, &inputs::text).map_err(|error| match example(&path) {
        Some(example) => {
            let help = format!("did you mean {}?", example.display());
            miette!(help = help, "{error}")
        }
        None => WrongFile::from(error).into(),
    })
}

/// The example of that name, for a file that is not there.
fn example(path: &Path) -> Option<PathBuf> {
    let names = [path.to_owned(), path.with_added_extension("toml")];
    let examples = names.iter().filter_map(|name| Some(Path::new(EXAMPLES).join(name.file_name()?)));
    examples.filter(|_| !path.exists()).find(|example| example.is_file())
}

/// Reads a motion file as [`endless`] does, and what its motors turn, in their order.
///
/// # Errors
/// As [`endless`].
pub fn with_wheels(path: &Path, board: Option<&str>) -> miette::Result<(Prepared, Vec<Wheel>)> {
    let path = found(path);
    let contents = contents(&path)?;
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
