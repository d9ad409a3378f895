//! Lines of an input, which may be longer than what anybody wants to keep.

use std::io::{self, BufRead, Read as _};

/// A line of an input, as [`next_line`] reads it.
#[derive(Debug, PartialEq, Eq)]
pub enum InputLine {
    /// It is in the buffer, with its end, if it has one.
    Whole,
    /// It is longer than what is taken of a line, and was read to its end. The buffer has its beginning.
    TooLong,
    /// The input has ended.
    Over,
}

/// Reads the next line of an input into `line`, and keeps no more than `most` bytes of it.
///
/// # Errors
/// Errors of `input`.
pub fn next_line(input: &mut (impl BufRead + ?Sized), line: &mut Vec<u8>, most: u64) -> io::Result<InputLine> {
    line.clear();
    (&mut *input).take(most + 1).read_until(b'\n', line)?;
    if line.is_empty() {
        return Ok(InputLine::Over);
    }
    if line.len() as u64 <= most || line.ends_with(b"\n") {
        return Ok(InputLine::Whole);
    }
    let mut ended = false;
    while !ended {
        let buffer = input.fill_buf()?;
        let end = buffer.iter().position(|byte| *byte == b'\n');
        ended = end.is_some() || buffer.is_empty();
        let used = end.map_or(buffer.len(), |end| end + 1);
        input.consume(used);
    }
    Ok(InputLine::TooLong)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::BufReader;

    #[test]
    fn a_line_without_an_end_is_not_kept() {
        let mut input = BufReader::new(&b"12345\n123456\n1234567890123\nx"[..]);
        let (mut line, mut seen) = (Vec::new(), Vec::new());
        loop {
            let found = next_line(&mut input, &mut line, 6).unwrap();
            if found == InputLine::Over {
                break;
            }
            seen.push((found == InputLine::Whole, String::from_utf8(line.clone()).unwrap()));
        }
        let expected = [(true, "12345\n"), (true, "123456\n"), (false, "1234567"), (true, "x")];
        assert_eq!(seen, expected.map(|(whole, text)| (whole, text.to_owned())));
        // An endless line takes no memory, and its end is still found.
        let long = io::repeat(b'a').take(100_000_000).chain(&b"\nb\n"[..]);
        let mut input = BufReader::new(long);
        assert_eq!(next_line(&mut input, &mut line, 10).unwrap(), InputLine::TooLong);
        assert!(line.capacity() < 1000);
        assert_eq!((next_line(&mut input, &mut line, 10).unwrap(), &line[..]), (InputLine::Whole, &b"b\n"[..]));
    }
}
