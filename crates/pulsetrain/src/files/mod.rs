//! Every file that a command reads or writes by a name that a user gave.
//!
//! - [`inputs`]: opened with a bound on their size; what is no file is refused
//! - [`outputs`]: never an input, never another output, and nothing that was there before is lost
//!
//! A command remembers which files it has read and which it writes, in a list that begins with it: [`begin`]. Clippy's disallowed methods
//! (clippy.toml) keep everybody else from opening files.

pub mod inputs;
pub mod outputs;

use std::cell::RefCell;
use std::fs;
use std::path::{Path, PathBuf};

thread_local! {
    /// The files of the command that this thread runs.
    static KNOWN: RefCell<NamedSoFar> = const { RefCell::new(NamedSoFar { inputs: Vec::new(), outputs: Vec::new() }) };
}

/// The files of a command.
#[derive(Debug)]
struct NamedSoFar {
    inputs: Vec<(PathBuf, Identity)>,
    outputs: Vec<(outputs::Destination, Identity)>,
}

/// Begins a command in this thread: it has read nothing yet, and writes to nothing but its own streams.
pub fn begin() {
    KNOWN.with_borrow_mut(|known| *known = NamedSoFar { inputs: Vec::new(), outputs: Vec::new() });
}

/// Which file it is, by whichever name.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Identity {
    /// Its path without links; if there is no such file, its folder's, and its name.
    path: PathBuf,
    /// Device and inode: a file may have several names.
    number: Option<(u64, u64)>,
}

impl Identity {
    fn of(path: &Path) -> Identity {
        let path = followed(path);
        let number = fs::metadata(&path).ok().as_ref().and_then(number);
        Identity { path, number }
    }

    fn is_same(&self, other: &Identity) -> bool {
        self.path == other.path || (self.number.is_some() && self.number == other.number)
    }
}

#[cfg(unix)]
fn number(about: &fs::Metadata) -> Option<(u64, u64)> {
    use std::os::unix::fs::MetadataExt;
    Some((about.dev(), about.ino()))
}

#[cfg(not(unix))]
fn number(_: &fs::Metadata) -> Option<(u64, u64)> {
    None
}

/// A longer chain of links is taken for a ring.
const MAX_LINKS: usize = 40;

/// A path without links. What is not there yet has its folder's path, and its name.
fn followed(path: &Path) -> PathBuf {
    let mut path = path.to_owned();
    for _ in 0..MAX_LINKS {
        if let Ok(found) = fs::canonicalize(&path) {
            return found;
        }
        // A link to a file that is not there is a name of that file.
        let Ok(to) = fs::read_link(&path) else { break };
        path = folder_of(&path).join(to);
    }
    let folder = nearest_folder(folder_of(&path));
    path.file_name().map_or(folder.clone(), |name| folder.join(name))
}

/// A folder's path without links, of which the last parts may not be there yet.
fn nearest_folder(folder: &Path) -> PathBuf {
    match (fs::canonicalize(folder), folder.parent(), folder.file_name()) {
        (Ok(found), ..) => found,
        (Err(_), Some(above), Some(name)) => {
            nearest_folder(if above == Path::new("") { Path::new(".") } else { above }).join(name)
        }
        _ => folder.to_owned(),
    }
}

/// The folder that a file is in.
fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    }
}
