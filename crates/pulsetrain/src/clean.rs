//! Text for terminals. Names come from files, from arguments, from a board's own description and over networks: in them a terminal finds no
//! orders, and nothing that turns the order of letters round.

use std::io::{self, Write};

/// Whether a terminal, or what shows text, may take a character for an order: control characters other than the line feed and the tab; marks, embeddings, overrides
/// and isolates of bidirectional text; separators of lines. Source: Unicode 16, chapter 23.1 and 23.2, and UAX #9, table 4.
#[must_use]
pub const fn is_order(c: char) -> bool {
    match c {
        '\n' | '\t' => false,
        '\0'..='\u{1f}' | '\u{7f}'..='\u{9f}' => true,
        '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{206f}' => true,
        _ => false,
    }
}

/// What is shown in the place of such a character: its picture, if it has one (U+2400 and on), else the replacement character.
const fn shown(c: char) -> char {
    match c {
        '\0'..='\u{1f}' => match char::from_u32(0x2400 + c as u32) {
            Some(picture) => picture,
            None => char::REPLACEMENT_CHARACTER,
        },
        '\u{7f}' => '\u{2421}',
        _ => char::REPLACEMENT_CHARACTER,
    }
}

/// A text without orders for terminals.
///
/// ```
/// use pulsetrain::clean::clean;
/// assert_eq!(clean("wheel\u{1b}[2J\u{202e}\n"), "wheel␛[2J\u{fffd}\n");
/// ```
#[must_use]
pub fn clean(text: &str) -> String {
    text.chars().map(|c| if is_order(c) { shown(c) } else { c }).collect()
}

/// JSON in which such characters are escaped: its value stays the same.
///
/// ```
/// use pulsetrain::clean::escaped_json;
/// assert_eq!(escaped_json("{\n  \"a\u{202e}\": 1\n}"), "{\n  \"a\\u202e\": 1\n}");
/// ```
#[must_use]
pub fn escaped_json(json: &str) -> String {
    if !json.contains(is_order) {
        return json.to_owned();
    }
    let mut escaped = String::with_capacity(json.len());
    for c in json.chars() {
        if is_order(c) {
            // All of them have 16 bits.
            escaped += &format!("\\u{:04x}", u32::from(c));
        } else {
            escaped.push(c);
        }
    }
    escaped
}

/// The one writer to the streams of a command: what passes it is [clean].
pub struct Cleaned<'a> {
    out: &'a mut dyn Write,
    /// The beginning of a character whose other bytes have not come.
    begun: Vec<u8>,
}

impl<'a> Cleaned<'a> {
    /// What is written here goes to `out`.
    pub fn new(out: &'a mut dyn Write) -> Cleaned<'a> {
        Cleaned { out, begun: Vec::new() }
    }

    /// The stream itself, for what draws at a terminal, and cleans all text that it draws.
    pub(crate) fn screen(&mut self) -> &mut dyn Write {
        self.out
    }
}

impl Write for Cleaned<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let is_plain = |byte: &u8| matches!(byte, b' '..=b'~' | b'\n' | b'\t');
        if self.begun.is_empty() && bytes.iter().all(is_plain) {
            self.out.write_all(bytes)?;
            return Ok(bytes.len());
        }
        let mut all = std::mem::take(&mut self.begun);
        all.extend_from_slice(bytes);
        let mut text = String::with_capacity(all.len());
        let mut chunks = all.utf8_chunks().peekable();
        while let Some(chunk) = chunks.next() {
            text += chunk.valid();
            let broken = chunk.invalid();
            let is_last = chunks.peek().is_none();
            // An error of no length is a character that is not whole.
            let is_begun = is_last && std::str::from_utf8(broken).is_err_and(|error| error.error_len().is_none());
            if is_begun {
                self.begun = broken.to_vec();
            } else if !broken.is_empty() {
                text.push(char::REPLACEMENT_CHARACTER);
            }
        }
        self.out.write_all(clean(&text).as_bytes())?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        if !std::mem::take(&mut self.begun).is_empty() {
            self.out.write_all("\u{fffd}".as_bytes())?;
        }
        self.out.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn cleaned(parts: &[&[u8]]) -> Vec<u8> {
        let mut out = Vec::new();
        let mut writer = Cleaned::new(&mut out);
        parts.iter().for_each(|part| writer.write_all(part).unwrap());
        writer.flush().unwrap();
        out
    }

    #[test]
    fn orders_become_pictures() {
        for (part, seen) in [
            ("\u{1b}]0;title\u{7}", "␛]0;title␇"),
            ("a\rb\u{8}\u{7f}", "a␍b␈␡"),
            ("\u{9b}31m", "\u{fffd}31m"),
            ("\u{202e}lmth\u{2066}\u{200f}", "\u{fffd}lmth\u{fffd}\u{fffd}"),
            ("µ 10 °\t×\n", "µ 10 °\t×\n"),
        ] {
            assert_eq!(String::from_utf8(cleaned(&[part.as_bytes()])).unwrap(), seen, "{part:?}");
        }
        // A character of one byte by an older encoding is no text.
        assert_eq!(cleaned(&[b"\x9b31m"]), "\u{fffd}31m".as_bytes());
    }

    proptest! {
        #[test]
        fn no_order_passes_however_it_is_cut(bytes in proptest::collection::vec(any::<u8>(), 0..40), text in "\\PC*[\u{80}-\u{9f}\u{202a}-\u{202e}]?", at in 0usize..60) {
            let all = [&bytes[..], text.as_bytes()].concat();
            let (first, second) = all.split_at(at.min(all.len()));
            let whole = cleaned(&[&all]);
            prop_assert_eq!(&cleaned(&[first, second]), &whole);
            prop_assert!(!String::from_utf8(whole).unwrap().contains(is_order));
        }
    }
}
