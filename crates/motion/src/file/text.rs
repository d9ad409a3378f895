//! The text of a file: what is no text, or far too much of it, is refused before it is read.

use std::borrow::Cow;
use std::fs::{self, File};
use std::io::{self, ErrorKind, Read};
use std::path::Path;

use crate::columns::{ReadError, has_lone_returns, with_line_feeds};
use crate::human;

/// The largest motion file, bytes.
pub const MOST_OF_A_MOTION_FILE: u64 = 16_000_000;
/// The largest file that a motion file names, bytes.
pub const MOST_OF_A_NAMED_FILE: u64 = 64_000_000;

/// Why a file cannot be read, in words, without the system's number.
pub(super) fn why(error: &io::Error) -> String {
    match error.kind() {
        ErrorKind::NotFound => "there is no such file".to_owned(),
        ErrorKind::PermissionDenied => "you may not read it".to_owned(),
        _ => error.to_string().split(" (os error").next().unwrap_or_default().to_owned(),
    }
}

/// Reads a file of `most` bytes at most: UTF-8, UTF-16 with a byte order mark, or else Windows-1252.
///
/// # Errors
/// As [`open_named`]; and in words if it is no text.
pub fn read_named_text(path: &Path, most: u64) -> io::Result<String> {
    decoded(read_named(path, most)?).map_err(|why| io::Error::new(ErrorKind::InvalidData, why))
}

/// Reads the bytes of a file of `most` bytes at most.
///
/// # Errors
/// As [`open_named`].
pub fn read_named(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let (file, length) = open_named(path, most)?;
    let mut bytes = Vec::with_capacity(length as usize + 1);
    // It may have become longer since.
    file.take(most + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        return Err(too_large(bytes.len() as u64, most));
    }
    Ok(bytes)
}

/// Opens a file that a user names, and gives its length. All files that are named on the command line or in a motion file are opened here: what is
/// no file never opens, or never ends.
///
/// # Errors
/// The system's own; and in words what is no file, or has more than `most` bytes.
#[expect(clippy::disallowed_methods, reason = "the one place that opens a named file")]
pub fn open_named(path: &Path, most: u64) -> io::Result<(File, u64)> {
    let checked = |about: &fs::Metadata| {
        if about.is_dir() {
            return Err(io::Error::new(ErrorKind::IsADirectory, "this is a folder, not a file"));
        }
        if !about.is_file() {
            let why = "this is a device or a pipe, not a file: save what it gives, and name that file";
            return Err(io::Error::other(why));
        }
        if about.len() > most { Err(too_large(about.len(), most)) } else { Ok(about.len()) }
    };
    // Before it is opened: a pipe that nobody writes to would never open.
    checked(&fs::metadata(path)?)?;
    let file = File::open(path)?;
    let length = checked(&file.metadata()?)?;
    Ok((file, length))
}

fn too_large(bytes: u64, most: u64) -> io::Error {
    let [is, most] = [bytes, most].map(|bytes| human::bytes(bytes as f64));
    io::Error::new(ErrorKind::FileTooLarge, format!("it has {is}; {most} is the most that is read"))
}

/// The text of bytes: UTF-8, with or without its byte order mark; UTF-16 with one; else Windows-1252, if it has no bytes that text has not.
///
/// # Errors
/// In words, if it is no text.
///
/// ```
/// use pulsetrain_motion::file::decoded;
/// assert_eq!(decoded(b"\xff\xfet\0,\0a\0".to_vec()).as_deref(), Ok("t,a"));
/// assert_eq!(decoded(b"Winkel [\xb0]".to_vec()).as_deref(), Ok("Winkel [°]"));
/// assert!(decoded(vec![0; 10]).is_err());
/// ```
pub fn decoded(bytes: Vec<u8>) -> Result<String, &'static str> {
    const HALF: &str = "it is UTF-16, but not whole";
    let wide = |bytes: &[u8], unit: fn([u8; 2]) -> u16| {
        let (pairs, rest) = bytes.as_chunks::<2>();
        let text = String::from_utf16(&pairs.iter().map(|pair| unit(*pair)).collect::<Vec<u16>>());
        text.ok().filter(|_| rest.is_empty()).ok_or(HALF)
    };
    let text = match bytes.as_slice() {
        [0xff, 0xfe, rest @ ..] => wide(rest, u16::from_le_bytes)?,
        [0xfe, 0xff, rest @ ..] => wide(rest, u16::from_be_bytes)?,
        _ => match String::from_utf8(bytes) {
            Ok(text) => text,
            Err(error) => error.into_bytes().into_iter().map(of_windows).collect(),
        },
    };
    if text.chars().all(is_of_text) {
        Ok(text)
    } else {
        Err("this is no text: it has bytes that text in UTF-8 does not have")
    }
}

/// The text of a file's bytes in any encoding that [`decoded`] knows, with a line feed at the end of every line.
///
/// # Errors
/// If it is no text.
///
/// ```
/// use pulsetrain_motion::file::csv_text;
/// assert_eq!(csv_text(b"\xff\xfet\0,\0a\0\r\0").as_deref(), Ok("t,a\n"));
/// assert!(csv_text(&[0; 10]).is_err());
/// ```
pub fn csv_text(bytes: &[u8]) -> Result<Cow<'_, str>, ReadError> {
    match std::str::from_utf8(bytes) {
        Ok(text) if !has_lone_returns(text) && text.chars().all(is_of_text) => Ok(Cow::Borrowed(text)),
        _ => match decoded(bytes.to_vec()) {
            Ok(text) => Ok(Cow::Owned(with_line_feeds(text))),
            Err(why) => Err(ReadError::new(1, 1, "text", why.trim_start_matches("this is no text: it has "))),
        },
    }
}

/// Whether files of text have such a character.
fn is_of_text(c: char) -> bool {
    !c.is_control() || matches!(c, '\t' | '\n' | '\r' | '\u{b}' | '\u{c}' | '\u{1a}')
}

/// A character of Windows-1252, which spreadsheets write in Europe; what has none there is left to be refused.
fn of_windows(byte: u8) -> char {
    #[rustfmt::skip]
    const FROM_80: [char; 32] = [
        '€', '\u{81}', '‚', 'ƒ', '„', '…', '†', '‡', 'ˆ', '‰', 'Š', '‹', 'Œ', '\u{8d}', 'Ž', '\u{8f}',
        '\u{90}', '‘', '’', '“', '”', '•', '–', '—', '˜', '™', 'š', '›', 'œ', '\u{9d}', 'ž', 'Ÿ',
    ];
    match byte {
        0x80..=0x9f => FROM_80[usize::from(byte - 0x80)],
        byte => char::from(byte),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spreadsheets_and_instruments_write_text_in_several_ways() {
        let text = "Zeit;Winkel [°]\r\n0;1,5\r\n";
        let wide = |mark: u16, bytes: fn(u16) -> [u8; 2]| -> Vec<u8> {
            [mark].into_iter().chain(text.encode_utf16()).flat_map(bytes).collect()
        };
        for bytes in [wide(0xfeff, u16::to_le_bytes), wide(0xfeff, u16::to_be_bytes), text.as_bytes().to_vec()] {
            assert_eq!(decoded(bytes).as_deref(), Ok(text));
        }
        let windows: Vec<u8> = text.chars().map(|c| u8::try_from(c).unwrap()).collect();
        assert_eq!(decoded(windows).as_deref(), Ok(text));
        assert_eq!(decoded(b"\x80 \x99".to_vec()).as_deref(), Ok("€ ™"));
        assert!(decoded(wide(0xfeff, u16::to_le_bytes)[1..].to_vec()).is_err());
        assert!(decoded(wide(0xfeff, u16::to_le_bytes)[..9].to_vec()).is_err());
    }
}
