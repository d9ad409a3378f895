//! Reads scripts of timed lines: plain text, or a motion file with `law.winch`.

use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use miette::{LabeledSpan, MietteDiagnostic, Report};
use pulsetrain_motion::file::Source;
use pulsetrain_motion::quantity::{Base, Quantity};
use pulsetrain_motion::{Time, file};
use pulsetrain_trace::winch::Command;

use super::talk::with_checksum;
use crate::diagnostic::{Excerpt, WrongFile};
use crate::files::inputs::{self, MAX_SCRIPT_BYTES};
use pulsetrain_motion::human;

/// Lines for a board, with their times.
#[derive(Clone, Debug, PartialEq)]
pub struct Script {
    /// The lines in order of time.
    pub lines: Vec<ScriptLine>,
    /// When the script ends, s.
    pub end_s: f64,
}

/// A line and its time.
#[derive(Clone, Debug, PartialEq)]
pub struct ScriptLine {
    /// When it is sent, s from the script's beginning.
    pub at_s: f64,
    /// The text that is sent, without the line's end.
    pub text: String,
    /// The command in it.
    pub command: Command,
}

/// A script without a duration ends this long after its last line, s.
const AFTER_S: f64 = 4.0;

/// If a line and the deadman's time are closer than this, s, it is uncertain which comes first.
const NEAR_DEADMAN_S: f64 = 0.05;

/// Help below an error: the form of a line, and what may stand in it.
const HELP: &str = "a line is \"<time>: <command>\", such as \"1.5 s: a x 100\"; docs/winch.md has the commands";
const OF_COMMANDS: &str = "docs/winch.md has the commands and their limits; so has `help` in the console";

/// The ending of motion files. Any other file is plain text.
const MOTION: &str = "toml";

/// Reads a script. With `length` it ends after that time.
///
/// In plain text each line is `<time>: <command>`, and `#` begins a comment. In a motion file the lines are those of
/// `law.winch`.
///
/// # Errors
/// With the place in the file, if a strict board would refuse a line, or if times go back.
pub fn load(path: &Path, length: Option<Time>) -> miette::Result<Script> {
    let (lines, duration) = if path.extension().is_some_and(|ending| ending == MOTION) {
        let script = file::load_winch(path, &inputs::text).map_err(WrongFile::from)?;
        // The motion file's own checks have passed. What is wrong now is a line that a law allows and a board does not.
        let lines = script.lines.iter().map(String::as_str).zip(script.places);
        (read(lines, &script.source)?, script.duration)
    } else {
        let bytes = inputs::bytes(path, MAX_SCRIPT_BYTES).map_err(|error| miette::miette!(help = HELP, "{error}"))?;
        let text = String::from_utf8(bytes).map_err(|error| {
            let line = error.as_bytes()[..error.utf8_error().valid_up_to()].split(|byte| *byte == b'\n').count();
            miette::miette!(help = HELP, "{} is no text: line {line} is not UTF-8", path.display())
        })?;
        (parse(&text, &path.display().to_string())?, None)
    };
    if lines.is_empty() {
        return Err(miette::miette!(help = HELP, "{} has no line to send", path.display()));
    }
    let last = lines.last().map_or(0.0, |line| line.at_s);
    let end_s = length.or(duration).map_or(last + AFTER_S, Time::seconds);
    Ok(Script { lines, end_s })
}

/// Reads the plain text of a script called `name`.
///
/// ```
/// let lines = pulsetrain::winch::script::parse("# there\n0 s: a x 100\n1.5 s: d x -50  # back\n", "my.txt").unwrap();
/// assert_eq!((lines[1].at_s, lines[1].text.as_str()), (1.5, "d x -50"));
/// let error = pulsetrain::winch::script::parse("0 s: a x ten", "my.txt").unwrap_err();
/// assert_eq!(error.to_string(), "a whole number from -2147483648 to 2147483647 is wanted");
/// ```
///
/// # Errors
/// With the place in the text.
pub fn parse(text: &str, name: &str) -> miette::Result<Vec<ScriptLine>> {
    let source = Arc::new(Source::new(name, text));
    let lines = text.split_inclusive('\n').scan(0, |next, raw| {
        let start = *next;
        *next += raw.len();
        let line = raw.split('#').next().unwrap_or_default().trim_end();
        Some((line, start..start + line.len()))
    });
    read(lines, &source)
}

/// Reads lines, each with its place in the source. Blank lines are ignored.
fn read<'a>(
    texts: impl Iterator<Item = (&'a str, Range<usize>)>,
    source: &Arc<Source>,
) -> miette::Result<Vec<ScriptLine>> {
    let mut lines: Vec<ScriptLine> = Vec::new();
    let mut board = Board::default();
    for (line, place) in texts.filter(|(line, _)| !line.is_empty()) {
        let wrong = |at: Range<usize>, help: &str, message: String| {
            // A string with escapes does not match its source place by place, so the error points at the whole string.
            let is_verbatim = place.len() == line.len();
            let at = if is_verbatim { place.start + at.start..place.start + at.end } else { place.clone() };
            let excerpt = Excerpt::new(source, std::iter::once(&at));
            let diagnostic = MietteDiagnostic::new(message).with_help(help).with_label(LabeledSpan::at(at, "here"));
            Report::new(diagnostic).with_source_code(excerpt)
        };
        let whole = 0..line.len();
        let Some((when, told)) = line.split_once(':') else {
            return Err(wrong(whole, HELP, "a line without its time".to_owned()));
        };
        let time = Quantity::parse(when).ok().filter(|when| (when.base, when.per_seconds) == (Base::Time, 0));
        let at_s = time.map(|when| when.value).filter(|at| (0.0..1e6).contains(at));
        let Some(at_s) = at_s else {
            return Err(wrong(0..when.len(), HELP, "not a time of 0 s to 10^6 s, with its unit".to_owned()));
        };
        if let Some(before) = lines.last().filter(|before| at_s < before.at_s) {
            let message = format!("times go back: the line before is sent at {}", human::seconds(before.at_s));
            return Err(wrong(0..when.len(), "put the lines in order of their times", message));
        }
        // Take the text as it is sent, since a checksum is of exactly that.
        let text = told.trim();
        let told_at = when.len() + 1 + (told.len() - told.trim_start().len());
        let command = Command::parse(text)
            .map_err(|error| wrong(told_at + error.at.start..told_at + error.at.end, OF_COMMANDS, error.message))?;
        let line = ScriptLine { at_s, text: text.to_owned(), command };
        board.hear(&line).map_err(|message| wrong(whole, OF_COMMANDS, message))?;
        lines.push(line);
    }
    Ok(lines)
}

/// What earlier lines require of the next one.
#[derive(Default)]
struct Board {
    strict: bool,
    /// Whether a line had a checksum since strictness was last set.
    is_checked: bool,
    /// The time of the last line, s, and the longest silence that the deadman allows, s.
    last_s: f64,
    deadman_ms: u16,
}

impl Board {
    /// Checks a line. Gives the error, if there is one.
    fn hear(&mut self, line: &ScriptLine) -> Result<(), String> {
        let ScriptLine { at_s, text, command } = line;
        if self.strict && self.is_checked && !command.is_checked {
            return Err(format!("the board wants a checksum on each line by now: {}", with_checksum(text)));
        }
        let strikes_s = self.last_s + f64::from(self.deadman_ms) * 1e-3;
        if self.deadman_ms != 0 && (at_s - strikes_s).abs() < NEAR_DEADMAN_S {
            // With a deadman shorter than that a line before it would come before the last line, so the advice leaves
            // that out.
            let before = if f64::from(self.deadman_ms) * 1e-3 < NEAR_DEADMAN_S { "" } else { " before that or" };
            return Err(format!(
                "it comes as the deadman strikes, at {}: which is first is not known; send it {}{before} after it",
                human::seconds(strikes_s),
                human::seconds(NEAR_DEADMAN_S)
            ));
        }
        if let Some(strict) = command.strict {
            (self.strict, self.is_checked) = (strict, command.is_checked);
        }
        self.is_checked |= command.is_checked;
        self.deadman_ms = command.deadman_ms.unwrap_or(self.deadman_ms);
        self.last_s = *at_s;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[track_caller]
    fn refuse(text: &str, place: &str, message: &str) {
        let error = parse(text, "script.txt").unwrap_err();
        let label = error.labels().unwrap().next().unwrap();
        let at = label.offset()..label.offset() + label.len();
        assert_eq!((&text[at], error.to_string().as_str()), (place, message));
    }

    #[test]
    fn refusals_point_at_the_place() {
        refuse("0 s: ping\na x 1", "a x 1", "a line without its time");
        refuse("1 step: ping", "1 step", "not a time of 0 s to 10^6 s, with its unit");
        refuse("0 s: ping\r\n-1 s: ping", "-1 s", "not a time of 0 s to 10^6 s, with its unit");
        refuse("2 s: ping\n1 s: ping", "1 s", "times go back: the line before is sent at 2 s");
        refuse("# é\n2 s: a w 1", "w", "axes are letters of xyza, each once");
        refuse("0 s: ping*11", "*11", "not the checksum of the line, which is *10");
        let wanted = "the board wants a checksum on each line by now: a x 1*28";
        refuse("0 s: strict 1*1a\n1 s: a x 1", "1 s: a x 1", wanted);
        refuse("0 s: strict 1\n1 s: ping*10\n1 s: a x 1", "1 s: a x 1", wanted);
    }

    #[test]
    fn checksums_are_sent_as_they_stand() {
        let lines = parse("0 s: ping\n0 s: ping*10\n1 s: a x 1  # not strict\n", "script.txt").unwrap();
        assert_eq!((lines[1].text.as_str(), lines[2].text.as_str()), ("ping*10", "a x 1"));
        assert!(parse("0 s: strict 1*1a\n1 s: a x 1*28\n2 s: strict 0*1b\n3 s: ping\n", "script.txt").is_ok());
    }

    #[test]
    fn no_line_comes_as_a_deadman_strikes() {
        let script = |at: &str| format!("0 s: deadman 500\n1 s: a x 9\n{at}: ping");
        for at in ["1.45 s", "1.55 s", "3 s"] {
            assert!(parse(&script(at), "script.txt").is_ok(), "{at}");
        }
        let at = "1.52 s: ping";
        refuse(
            &script("1.52 s"),
            at,
            "it comes as the deadman strikes, at 1.5 s: which is first is not known; send it 50 ms before that or after it",
        );
        let wanted = "it comes as the deadman strikes, at 30 ms: which is first is not known; send it 50 ms after it";
        refuse("0 s: deadman 30\n0 s: ping", "0 s: ping", wanted);
    }

    proptest! {
        /// Any text is either read or refused, and each refusal can be printed.
        #[test]
        fn any_text(text in prop::collection::vec(prop_oneof![
            3 => prop::sample::select(vec!["0 s: ", "1 ms:", "a ", "x ", "xyza", " 5", "-1", "g x 1 1", "#", "\n", "\r\n", ":", "é"]).prop_map(String::from),
            1 => ".{0,4}",
        ], 0..30)) {
            let text = text.concat();
            match parse(&text, "script.txt") {
                Ok(lines) => prop_assert!(lines.is_sorted_by(|a, b| a.at_s <= b.at_s)),
                Err(error) => {
                    let label = error.labels().and_then(|mut labels| labels.next()).unwrap();
                    prop_assert!(text.get(label.offset()..label.offset() + label.len()).is_some());
                    let shown = format!("{error:?}");
                    prop_assert!(!shown.is_empty());
                }
            }
        }
    }

    #[test]
    fn files_that_are_no_scripts() {
        let path = std::env::temp_dir().join(format!("pulsetrain-script-{}.txt", std::process::id()));
        let load = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            let error = load(&path, None).unwrap_err();
            assert!(error.help().is_some(), "{error:?}");
            error.to_string()
        };
        assert!(load(b"0 s: ping\n\xff\n").ends_with(" is no text: line 2 is not UTF-8"));
        for nothing in ["", "\n\n", "# later\n"] {
            assert!(load(nothing.as_bytes()).ends_with(" has no line to send"));
        }
        std::fs::remove_file(&path).unwrap();
        let error = super::load(&path, None).unwrap_err();
        assert!(error.to_string().starts_with("cannot read ") && error.help().is_some());
    }

    #[test]
    fn a_refusal_points_into_the_motion_file() {
        let folder = std::env::temp_dir().join(format!("pulsetrain-script-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join("my.toml");
        let example = include_str!("../../../../examples/winch.toml");
        let begin = example.find("commands = [").unwrap();
        let end = begin + example[begin..].find(']').unwrap();
        let refused = |law: &str, named: &str| {
            std::fs::write(&path, format!("{}{law}{}", &example[..begin], &example[end + 1..])).unwrap();
            let error = load(&path, None).unwrap_err();
            let label = error.labels().unwrap().next().unwrap();
            let source = std::fs::read_to_string(folder.join(named)).unwrap();
            let shown = format!("{error:?}");
            assert!(shown.contains(named), "{shown}");
            (source[label.offset()..label.offset() + label.len()].to_owned(), error.to_string())
        };
        let message = "a whole number from -15000 to 15000 is wanted".to_owned();
        let law = "commands = [\n  \"0 s: g x 1 1\",\n  \"1 s: v x 16000\",\n]";
        assert_eq!(refused(law, "my.toml"), ("16000".to_owned(), message.clone()));
        // The error points at the whole of a string with escapes.
        let law = "commands = [\"1 s: v x\\u002016000\"]";
        assert_eq!(refused(law, "my.toml"), ("\"1 s: v x\\u002016000\"".to_owned(), message.clone()));
        std::fs::write(folder.join("lines.txt"), "# é\n0 s: g x 1 1\n1 s: v x 16000\n").unwrap();
        assert_eq!(refused("file = \"lines.txt\"", "lines.txt"), ("16000".to_owned(), message));
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn the_example_is_a_script() {
        let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/winch.toml"));
        let script = load(path, None).unwrap();
        assert_eq!((script.lines.len(), script.end_s), (8, 8.0));
        assert_eq!(script.lines[7].text, "a xyza 0 0 0 0");
        let script = load(path, Some(Time::SECOND)).unwrap();
        assert_eq!(script.end_s, 1.0);
    }
}
