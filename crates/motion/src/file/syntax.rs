//! Texts that are no TOML: where the mistake was made, which is not always where reading ends.

use std::ops::Range;

use super::reader::{Noted, Reader};
use crate::quantity::Quantity;

/// Notes what is wrong with a text that is no TOML.
pub(super) fn note(reader: &Reader, text: &str, error: &toml_edit::TomlError) -> Noted {
    let at = error.span().unwrap_or(0..0);
    let unclosed = Unclosed::of(text, at.start);
    if let Some(quote) = unclosed.quote.filter(|quote| *quote <= at.end) {
        let help = format!("add {} where the text ends", &text[quote..quote + 1]);
        return reader.note(quote..quote + 1, "opened here", "not TOML: this quote is never closed", help);
    }
    if let Some((open, bracket)) = unclosed.bracket {
        let close = if bracket == '{' { '}' } else { ']' };
        let help = format!("add `{close}` where the value ends");
        return reader.note(open..open + 1, "opened here", format!("not TOML: this `{bracket}` is never closed"), help);
    }
    if let Some((span, key, value)) = value_at(text, at.start)
        && Quantity::parse(value).is_ok()
    {
        let help = format!("write {key} = \"{value}\"");
        return reader.note(span, "no quotes", "not TOML: a quantity with its unit stands in quotes", help);
    }
    reader.note(at, "here", format!("not TOML: {}", error.message().trim_end()), "")
}

/// What a text opens and never closes.
struct Unclosed {
    /// The first quote, and where it was probably opened.
    quote: Option<usize>,
    /// The last bracket before the mistake, and which one.
    bracket: Option<(usize, char)>,
}

impl Unclosed {
    /// Of a text with a mistake at `error`.
    fn of(text: &str, error: usize) -> Unclosed {
        let mut open: Vec<(usize, char)> = Vec::new();
        let mut quote = None;
        // A string with a `=` in it, on this line: one without its second quote swallows the next key.
        let mut suspect = None;
        let mut is_value = false;
        let mut rest = text;
        while let Some(c) = rest.chars().next() {
            let at = text.len() - rest.len();
            let mut length = c.len_utf8();
            match c {
                '#' => length = rest.find('\n').unwrap_or(rest.len()),
                '"' | '\'' => {
                    let is_closed;
                    (length, is_closed) = string_length(rest, c);
                    if !is_closed {
                        quote = quote.or(suspect).or(Some(at));
                    } else if rest[..length].contains(" = ") {
                        suspect = suspect.or(Some(at));
                    }
                }
                '=' => is_value = true,
                '\n' => {
                    suspect = None;
                    is_value &= !open.is_empty();
                }
                '{' | '[' if is_value => open.push((at, c)),
                '}' | ']' if is_value => {
                    let opening = if c == '}' { '{' } else { '[' };
                    if open.last().is_some_and(|(_, last)| *last == opening) {
                        open.pop();
                    }
                }
                _ => {}
            }
            rest = &rest[length..];
        }
        let bracket = open.into_iter().rev().find(|(at, _)| *at < error || error == text.len());
        Unclosed { quote, bracket }
    }
}

/// Bytes of the string at the beginning of a text, and whether it is closed. If not it ends with its line, or with the text if it may have several lines.
fn string_length(text: &str, quote: char) -> (usize, bool) {
    let three: String = [quote; 3].iter().collect();
    let (quotes, is_long) = if text.starts_with(&three) { (three.as_str(), true) } else { (&three[..1], false) };
    let mut at = quotes.len();
    while let Some(c) = text[at..].chars().next() {
        if text[at..].starts_with(quotes) {
            return (at + quotes.len(), true);
        }
        if c == '\n' && !is_long {
            return (at, false);
        }
        at += c.len_utf8();
        if c == '\\' && quote == '"' {
            at += text[at..].chars().next().map_or(0, char::len_utf8);
        }
    }
    (text.len(), false)
}

/// The value that a mistake at `error` is in, as far as its line or list goes: its place, its key and its text.
fn value_at(text: &str, error: usize) -> Option<(Range<usize>, &str, &str)> {
    let error = text.floor_char_boundary(error.min(text.len()));
    let line_start = text[..error].trim_end_matches('\n').rfind('\n').map_or(0, |at| at + 1);
    let line_end = text[line_start..].find('\n').map_or(text.len(), |at| line_start + at);
    let line = &text[line_start..line_end];
    let before = (error - line_start).min(line.len());
    let equals = line[..line.ceil_char_boundary(before)].rfind('=')?;
    let is_of_key = |c: char| c.is_alphanumeric() || matches!(c, '_' | '.' | '-');
    let key = line[..equals].trim_end();
    let key =
        &key[key.rfind(|c| !is_of_key(c)).map_or(0, |at| key[at..].chars().next().map_or(1, char::len_utf8) + at)..];
    let value = &line[equals + 1..];
    let end = if value.trim_start().starts_with(['"', '\'']) {
        value.len()
    } else {
        value.find([',', '}', ']', '#']).unwrap_or(value.len())
    };
    let from = line_start + equals + 1 + (value.len() - value.trim_start().len());
    let value = value[..end].trim();
    (!key.is_empty() && !value.is_empty()).then_some((from..from + value.len(), key, value))
}
