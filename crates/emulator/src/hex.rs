//! Intel HEX, the text format in which images of program memory are kept in files.

use thiserror::Error;

/// Why a text is not a valid image. Lines count from 1.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum HexError {
    /// A line that does not begin with a colon.
    #[error("line {line}: a record begins with ':'")]
    NoColon {
        /// The line.
        line: usize,
    },
    /// Something that is not pairs of hexadecimal digits.
    #[error("line {line}: not pairs of hexadecimal digits")]
    NotHex {
        /// The line.
        line: usize,
    },
    /// A record whose length is not the one that its first byte announces.
    #[error("line {line}: {found} bytes where the record announces {announced}")]
    Length {
        /// The line.
        line: usize,
        /// Data bytes announced.
        announced: usize,
        /// Data bytes found.
        found: usize,
    },
    /// A checksum that does not add up.
    #[error("line {line}: the checksum is wrong by {sum:#04x}")]
    Checksum {
        /// The line.
        line: usize,
        /// The sum of all bytes, which should be 0.
        sum: u8,
    },
    /// A record of a type that is not 00 to 05.
    #[error("line {line}: record type {kind:#04x} is unknown")]
    Kind {
        /// The line.
        line: usize,
        /// The type found.
        kind: u8,
    },
    /// Data beyond the memory that the image is for.
    #[error("line {line}: address {address:#x} is beyond the memory of {limit} bytes")]
    Beyond {
        /// The line.
        line: usize,
        /// First address that does not fit.
        address: usize,
        /// Size of the memory, bytes.
        limit: usize,
    },
    /// The text ends without an end-of-file record: the file was cut off.
    #[error("no end-of-file record: the file was cut off")]
    NoEnd,
}

/// Reads Intel HEX into an image of at most `limit` bytes. Gaps are 0xff, as in erased flash; the image ends with the
/// last byte of the text.
///
/// # Errors
/// [`HexError`] names the line.
///
/// ```
/// use pulsetrain_emulator::hex::{HexError, parse};
/// assert_eq!(parse(":02000000CF93 9C\n:00000001FF".replace(' ', "").as_str(), 32768), Ok(vec![0xcf, 0x93]));
/// assert_eq!(parse(":0100000000FE\n:00000001FF", 32768), Err(HexError::Checksum { line: 1, sum: 0xff }));
/// ```
pub fn parse(text: &str, limit: usize) -> Result<Vec<u8>, HexError> {
    let mut image = Vec::new();
    let mut base = 0;
    for (index, text) in text.lines().enumerate() {
        let (line, text) = (index + 1, text.trim());
        if text.is_empty() {
            continue;
        }
        let record = bytes(text.strip_prefix(':').ok_or(HexError::NoColon { line })?, line)?;
        let &[announced, high, low, kind, ref rest @ ..] = record.as_slice() else {
            return Err(HexError::Length { line, announced: 0, found: 0 });
        };
        let (announced, found) = (usize::from(announced), rest.len().saturating_sub(1));
        if announced != found || rest.is_empty() {
            return Err(HexError::Length { line, announced, found });
        }
        let sum = record.iter().fold(0u8, |sum, byte| sum.wrapping_add(*byte));
        if sum != 0 {
            return Err(HexError::Checksum { line, sum });
        }
        let data = &rest[..found];
        match (kind, data) {
            (0, _) => {
                let start = base + usize::from(u16::from_be_bytes([high, low]));
                let end = start + data.len();
                if end > limit {
                    return Err(HexError::Beyond { line, address: start.max(limit), limit });
                }
                if image.len() < end {
                    image.resize(end, 0xff);
                }
                image[start..end].copy_from_slice(data);
            }
            (1, _) => return Ok(image),
            // Segment bases are in units of 16 bytes; linear bases are the upper half of the address.
            (2, &[high, low]) => base = usize::from(u16::from_be_bytes([high, low])) << 4,
            (4, &[high, low]) => base = usize::from(u16::from_be_bytes([high, low])) << 16,
            // Start addresses are ignored, because a chip starts at its reset vector.
            (3 | 5, _) => {}
            (2 | 4, _) => return Err(HexError::Length { line, announced, found: 2 }),
            _ => return Err(HexError::Kind { line, kind }),
        }
    }
    Err(HexError::NoEnd)
}

fn bytes(text: &str, line: usize) -> Result<Vec<u8>, HexError> {
    let pairs = text.as_bytes().chunks(2);
    pairs
        .map(|pair| {
            let digits = std::str::from_utf8(pair).ok().filter(|digits| digits.len() == 2 && !digits.contains('+'));
            digits.and_then(|digits| u8::from_str_radix(digits, 16).ok()).ok_or(HexError::NotHex { line })
        })
        .collect()
}
