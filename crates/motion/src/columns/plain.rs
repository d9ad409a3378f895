//! Recordings as instruments, phones and spreadsheets write them, brought to the form that [`CsvTable`](super::CsvTable) reads.
//!
//! Nothing moves: every byte of the plain text stands for the byte of the file at the same place, so that errors point at the file.

use std::borrow::Cow;

use super::{MAX_COLUMNS, Stated, Title, has_decimal_comma, moment, names_columns};

/// Lines at the beginning of a file in which its first row of numbers is looked for.
const MOST_LINES: usize = 200;

/// What parts the fields of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Separator {
    /// One character.
    Byte(u8),
    /// Any number of spaces and tabs.
    Blanks,
}

/// In this order: what is found first parts the columns.
const SEPARATORS: [Separator; 5] =
    [Separator::Byte(b'\t'), Separator::Byte(b';'), Separator::Byte(b'|'), Separator::Byte(b','), Separator::Blanks];

/// Whether a carriage return ends a line alone.
fn is_lone(bytes: &[u8], k: usize) -> bool {
    bytes[k] == b'\r' && bytes.get(k + 1) != Some(&b'\n')
}

/// Whether a line ends with a carriage return alone.
pub(crate) fn has_lone_returns(text: &str) -> bool {
    (0..text.len()).any(|k| is_lone(text.as_bytes(), k))
}

/// A text with a line feed at the end of every line: old Macs wrote a carriage return alone.
#[must_use]
pub fn with_line_feeds(text: String) -> String {
    if !has_lone_returns(&text) {
        return text;
    }
    let mut bytes = text.into_bytes();
    for k in 0..bytes.len() {
        if is_lone(&bytes, k) {
            bytes[k] = b'\n';
        }
    }
    // ASCII in place of ASCII: it stays UTF-8.
    String::from_utf8(bytes).unwrap_or_default()
}

/// A text, of lines that end with line feeds, in the form that [`CsvTable`](super::CsvTable) reads:
///
/// - The first row whose fields are all numbers (or times of day, or dates), two of them at least, says what parts the columns: tabs, `;`,
///   `|`, `,` or spaces, the first of these that makes it such a row. A first line `sep=;` says it instead.
/// - Lines that begin with `%` are comments, as those that begin with `#`.
/// - The last line above that row is the header, or the last two, if the last one has units alone. What is above them is left out.
///
/// ```
/// use pulsetrain_motion::columns::{CsvTable, plain};
/// let plain = plain("Recorded on Monday, 3 pm\ntime   angle\n0,0    1,5\n");
/// let mut table = CsvTable::new(&plain);
/// assert_eq!(table.header()?.titles[1].text, "angle");
/// assert_eq!(table.next()?.unwrap().number(1, "an angle")?, 1.5);
/// # Ok::<(), pulsetrain_motion::columns::ReadError>(())
/// ```
#[must_use]
pub fn plain(text: &str) -> Cow<'_, [u8]> {
    let mut plain = Cow::Borrowed(text.as_bytes());
    let start = if text.starts_with('\u{feff}') { 3 } else { 0 };
    let mut separator = None;
    // Of the lines that are no comments and not empty: where they begin, and their text.
    let (mut above, mut row): (Vec<(usize, &str)>, Option<&str>) = (Vec::new(), None);
    let mut at = start;
    while at < text.len() {
        let begin = at;
        at = if row.is_none() { end_of_record(text, begin) } else { end_of_line(text, begin) };
        let line = text[begin..at].trim_end();
        if line.starts_with('%') {
            plain.to_mut()[begin] = b'#';
        } else if begin == start
            && let Some(sign) = stated_separator(line)
        {
            separator = Some(sign);
            comment_out(&mut plain, begin, line);
        } else if above.len() < MOST_LINES && row.is_none() && !line.trim_start().is_empty() && !line.starts_with('#') {
            let all = separator.map_or(SEPARATORS.to_vec(), |stated| vec![stated]);
            match all.into_iter().find(|separator| is_row(line, *separator)) {
                Some(found) => (separator, row) = (Some(found), Some(line)),
                None => above.push((begin, line)),
            }
        }
    }
    let Some(separator) = separator else { return plain };
    if row.is_some() {
        let is_units = |(_, line): &(usize, &str)| {
            // A table with as many columns is refused.
            if fields(line, separator).nth(MAX_COLUMNS).is_some() {
                return false;
            }
            let titles: Vec<Title> = fields(line, separator).map(|field| Title::parse(field, 0..0)).collect();
            is_units(&titles)
        };
        // A line of one field names no columns, unless it says that it does; nor does a rule of dashes.
        let is_header = |(_, line): &(usize, &str)| {
            let has_fields = fields(line, separator).count() > 1 && line.contains(char::is_alphabetic);
            has_fields || names_columns(line)
        };
        let header = above.iter().rposition(|line| is_header(line) && !is_units(line));
        let header = header.or_else(|| above.iter().rposition(is_header));
        for (k, line) in above.iter().enumerate() {
            let is_kept = header.is_some_and(|header| k == header || k == header + 1 && is_units(line));
            if !is_kept {
                comment_out(&mut plain, line.0, line.1);
            }
        }
    }
    if matches!(separator, Separator::Blanks | Separator::Byte(b'|')) {
        with_tabs(plain.to_mut(), separator);
    }
    plain
}

fn end_of_line(text: &str, begin: usize) -> usize {
    text[begin..].find('\n').map_or(text.len(), |end| begin + end + 1)
}

/// Where the lines end that belong together since a quote goes on from one to the next.
fn end_of_record(text: &str, begin: usize) -> usize {
    /// A quote that goes on for longer is none.
    const MOST: usize = 8;
    let first = end_of_line(text, begin);
    if text[begin..].starts_with(['#', '%']) {
        return first;
    }
    let ends = std::iter::successors(Some(first), |end| (*end < text.len()).then(|| end_of_line(text, *end)));
    let is_whole = |end: &usize| text[begin..*end].matches('"').count().is_multiple_of(2);
    ends.take(MOST).find(is_whole).unwrap_or(first)
}

/// Makes the lines of a record comments.
fn comment_out(plain: &mut Cow<'_, [u8]>, begin: usize, record: &str) {
    let mut at = begin;
    for line in record.split_inclusive('\n') {
        let first = line.chars().next().map_or(0, char::len_utf8);
        let sign = &mut plain.to_mut()[at..at + first];
        sign.fill(b' ');
        sign[0] = b'#';
        at += line.len();
    }
}

/// `sep=;`, as Excel writes and reads it.
fn stated_separator(line: &str) -> Option<Separator> {
    let line = line.trim_matches('"');
    let sign = line.get(..4).filter(|start| start.eq_ignore_ascii_case("sep=")).map(|_| &line.as_bytes()[4..])?;
    match sign {
        [b' '] => Some(Separator::Blanks),
        [sign @ (b';' | b',' | b'|' | b'\t')] => Some(Separator::Byte(*sign)),
        // The tab at its end was trimmed.
        [] => Some(Separator::Byte(b'\t')),
        _ => None,
    }
}

/// The fields of a line, without quotes.
fn fields(line: &str, separator: Separator) -> impl Iterator<Item = &str> {
    let (mut rest, mut ended) = (line.trim(), false);
    std::iter::from_fn(move || {
        if ended {
            return None;
        }
        let mut quoted = false;
        let parts = |c: char| match separator {
            Separator::Byte(sign) => c == char::from(sign),
            Separator::Blanks => c == ' ' || c == '\t',
        };
        let end = rest.char_indices().find(|(_, c)| {
            quoted ^= *c == '"';
            !quoted && parts(*c)
        });
        let field = match end {
            Some((end, sign)) => {
                let field = &rest[..end];
                rest = &rest[end + sign.len_utf8()..];
                if separator == Separator::Blanks {
                    rest = rest.trim_start();
                }
                field
            }
            None => {
                ended = true;
                rest
            }
        };
        Some(field.trim().trim_matches('"').trim())
    })
}

/// Whether all fields of a line are numbers or times, and two at least.
fn is_row(line: &str, separator: Separator) -> bool {
    let mut filled = 0;
    let all = fields(line, separator).all(|field| {
        filled += usize::from(!field.is_empty());
        field.is_empty() || field.parse::<f64>().is_ok() || has_decimal_comma(field) || moment(field).is_some()
    });
    all && filled > 1
}

/// Whether titles are units alone: the second line of a header.
pub(super) fn is_units(titles: &[Title]) -> bool {
    let filled = || titles.iter().filter(|title| !title.text.is_empty());
    filled().count() > 0 && filled().all(|title| title.name.is_empty() && title.unit != Stated::Nothing)
}

/// Puts tabs in the place of what parts the fields, but not in quotes, nor between a name and its unit in brackets.
fn with_tabs(bytes: &mut [u8], separator: Separator) {
    let mut quoted = false;
    let mut begun = false;
    for k in 0..bytes.len() {
        match bytes[k] {
            b'\n' => (quoted, begun) = (false, false),
            b'"' => (quoted, begun) = (!quoted, true),
            sign if Separator::Byte(sign) == separator && !quoted => bytes[k] = b'\t',
            b' ' | b'\t' if separator == Separator::Blanks && !quoted => {
                let is_first = begun && !matches!(bytes[k - 1], b'\t' | b' ');
                let rest = bytes[k..].iter().find(|byte| !matches!(byte, b' ' | b'\t'));
                let is_between = !matches!(rest, None | Some(b'\n' | b'\r' | b'[' | b'('));
                bytes[k] = if is_first && is_between { b'\t' } else { b' ' };
            }
            // What follows the sign of a comment is not parted from it.
            b'#' if !begun => {}
            _ => begun = true,
        }
    }
}
