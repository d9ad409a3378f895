//! Files and outputs that cannot be read or written: what is wrong, and the cure.

use std::fmt::Display;
use std::io;
use std::path::Path;

use miette::Diagnostic;

/// A file, or the output, cannot be read or written.
#[derive(Debug, thiserror::Error)]
#[error("cannot {action} {what}: {}", in_words(.error))]
pub struct Access {
    action: &'static str,
    what: String,
    /// What on the command line says where a file goes.
    option: Option<&'static str>,
    // Its text is in the message, so it is no source: else it would be printed twice.
    error: io::Error,
}

impl Diagnostic for Access {
    fn help<'a>(&'a self) -> Option<Box<dyn Display + 'a>> {
        let advice = match (self.action, self.option, self.error.kind()) {
            ("read", _, io::ErrorKind::NotFound) => {
                "look at the path; it counts from the folder in which you are".to_owned()
            }
            ("read", ..) => return None,
            (_, Some(option), io::ErrorKind::PermissionDenied) => {
                format!("{}, or change its permissions", elsewhere(option))
            }
            (_, Some(option), io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded) => {
                format!("make room, or {}", elsewhere(option))
            }
            (_, Some(option), io::ErrorKind::AlreadyExists) => {
                format!("{}, or delete it first", elsewhere(option))
            }
            (_, Some(option), _) => elsewhere(option),
            (_, None, io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded) => "make room".to_owned(),
            _ => return None,
        };
        Some(Box::new(advice))
    }
}

impl Access {
    /// The error for an output, whose place `option` chooses.
    #[must_use]
    pub fn write(path: &Path, option: &'static str, error: io::Error) -> Access {
        Access { action: "write", what: path.display().to_string(), option: Some(option), error }
    }
}

/// The cure for an output that cannot be where it was to go: an option, or what stands in its place.
pub(crate) fn elsewhere(option: &str) -> String {
    if option.starts_with('-') { format!("take another place with {option}") } else { format!("take another {option}") }
}

/// A system's error in words, without its number.
pub(crate) fn in_words(error: &io::Error) -> String {
    match error.kind() {
        io::ErrorKind::NotFound => "there is no such file or folder".to_owned(),
        io::ErrorKind::PermissionDenied => "you may not".to_owned(),
        io::ErrorKind::StorageFull => "the disk is full".to_owned(),
        io::ErrorKind::QuotaExceeded => "your share of the disk is full".to_owned(),
        io::ErrorKind::ReadOnlyFilesystem => "the disk is read-only".to_owned(),
        io::ErrorKind::AlreadyExists => "it exists already".to_owned(),
        io::ErrorKind::IsADirectory => "it is a folder".to_owned(),
        io::ErrorKind::NotADirectory => "a part of its path is a file, not a folder".to_owned(),
        _ => {
            let text = error.to_string();
            text.split(" (os error").next().unwrap_or_default().to_owned()
        }
    }
}

/// An [`Access`] error of the command's own output.
pub(crate) fn unprinted(error: io::Error) -> Access {
    Access { action: "write to", what: "the output".into(), option: None, error }
}

/// An [`Access`] error of a file.
#[must_use]
pub fn access(action: &'static str, path: &Path, error: io::Error) -> Access {
    Access { action, what: path.display().to_string(), option: None, error }
}
