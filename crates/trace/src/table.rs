//! What the CSV readers share: fields with their place, numbers, and the one error of all readers.

use csv::{ByteRecord, Reader, ReaderBuilder, Trim};

/// Why a file cannot be read, and where.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}, column {column}: expected {expected}, found {found}")]
pub struct ReadError {
    /// From 1.
    pub line: u64,
    /// Byte in the line, from 1.
    pub column: u64,
    /// What would have been right.
    pub expected: String,
    /// What was there, shortened.
    pub found: String,
}

impl ReadError {
    pub(crate) fn new(line: u64, column: u64, expected: impl Into<String>, found: impl Into<String>) -> ReadError {
        ReadError { line, column, expected: expected.into(), found: found.into() }
    }
}

/// The bytes as short text for a message.
pub(crate) fn shown(bytes: &[u8]) -> String {
    const MOST: usize = 40;
    if bytes.is_empty() {
        return "nothing".to_owned();
    }
    let text = String::from_utf8_lossy(&bytes[..bytes.len().min(MOST)]);
    format!("`{}`{}", text.escape_debug(), if bytes.len() > MOST { "…" } else { "" })
}

/// The rows of a CSV file; lines that begin with `#` and empty ones are left out.
pub(crate) struct Table<'a> {
    bytes: &'a [u8],
    reader: Reader<&'a [u8]>,
    row: ByteRecord,
}

impl<'a> Table<'a> {
    /// The delimiter is whichever of tab, `;` and `,` the first line that is no comment holds, in this order.
    pub(crate) fn new(bytes: &'a [u8]) -> Table<'a> {
        let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
        let header = bytes.split(|b| *b == b'\n').find(|line| !line.starts_with(b"#")).unwrap_or_default();
        let delimiter = [b'\t', b';'].into_iter().find(|d| header.contains(d)).unwrap_or(b',');
        let reader = ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .trim(Trim::All)
            .comment(Some(b'#'))
            .delimiter(delimiter)
            .from_reader(bytes);
        Table { bytes, reader, row: ByteRecord::new() }
    }

    /// The next row, or `None` at the end.
    pub(crate) fn next(&mut self) -> Result<Option<Row<'_>>, ReadError> {
        match self.reader.read_byte_record(&mut self.row) {
            Ok(true) => Ok(Some(Row { bytes: self.bytes, fields: &self.row })),
            Ok(false) => Ok(None),
            Err(error) => {
                let line = error.position().map_or(0, csv::Position::line);
                Err(ReadError::new(line, 1, "a row of fields", error.to_string()))
            }
        }
    }
}

/// One row of a table.
pub(crate) struct Row<'a> {
    /// Of the whole file.
    bytes: &'a [u8],
    fields: &'a ByteRecord,
}

impl<'a> Row<'a> {
    pub(crate) fn len(&self) -> usize {
        self.fields.len()
    }

    /// The field, empty if the row is too short.
    pub(crate) fn get(&self, index: usize) -> &'a [u8] {
        self.fields.get(index).unwrap_or_default()
    }

    /// The field as text.
    pub(crate) fn text(&self, index: usize) -> Result<&'a str, ReadError> {
        std::str::from_utf8(self.get(index)).map_err(|_| self.error(index, "text in UTF-8"))
    }

    /// The field as whatever its text parses to.
    pub(crate) fn parse<T: std::str::FromStr>(&self, index: usize, expected: &str) -> Result<T, ReadError> {
        std::str::from_utf8(self.get(index))
            .ok()
            .and_then(|text| text.parse().ok())
            .ok_or_else(|| self.error(index, expected))
    }

    /// The field as a finite number.
    pub(crate) fn number(&self, index: usize, expected: &str) -> Result<f64, ReadError> {
        let number: f64 = self.parse(index, expected)?;
        if number.is_finite() { Ok(number) } else { Err(self.error(index, expected)) }
    }

    /// The line that the row begins on, from 1.
    pub(crate) fn line(&self) -> u64 {
        // The reader's own position is before the comments and empty lines that it left out.
        let begin = self.fields.position().map_or(0, |position| position.byte() as usize).min(self.bytes.len());
        let before = self.bytes[..begin].iter().filter(|b| **b == b'\n').count();
        let left_out = |line: &&[u8]| line.starts_with(b"#") || line.trim_ascii().is_empty();
        let skipped = self.bytes[begin..].split(|b| *b == b'\n').take_while(left_out).count();
        (before + skipped) as u64 + 1
    }

    /// That this field is not what was expected.
    pub(crate) fn error(&self, index: usize, expected: impl Into<String>) -> ReadError {
        let column: usize = (0..index.min(self.len())).map(|i| self.get(i).len() + 1).sum();
        ReadError::new(self.line(), column as u64 + 1, expected, shown(self.get(index)))
    }
}
