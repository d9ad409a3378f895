//! Errors as JSON: what is wrong, what to do, and the place in a motion file.

use pulsetrain_motion::file::{FileError, Problem};
use pulsetrain_session::estimate::Estimate;
use pulsetrain_session::prepare::Refusal;
use schemars::JsonSchema;
use serde::Serialize;

/// An error as JSON.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct ErrorReport {
    /// What is wrong.
    pub message: String,
    /// "error"; "advice" of a remark, such as how many more mistakes the file has.
    pub severity: &'static str,
    /// The errors that led to it.
    pub causes: Vec<String>,
    /// What to do.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub help: Option<String>,
    /// The file with the mistake. `None` if it is in no file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
    /// The same as `file`, as it was called first.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub filename: Option<String>,
    /// The line of its first place, from 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub line: Option<usize>,
    /// The column of its first place in characters, from 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub column: Option<usize>,
    /// How many characters its first place has.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub length: Option<usize>,
    /// All its places.
    pub labels: Vec<PlaceReport>,
    /// More mistakes of the same file.
    pub related: Vec<ErrorReport>,
    /// How long a motion is that was not begun, since nobody said that its length is meant.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub estimate: Option<Estimate>,
}

/// A place in a file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, JsonSchema)]
pub struct PlaceReport {
    /// What is there.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub label: Option<String>,
    /// Its line, from 1.
    pub line: usize,
    /// Its column in characters, from 1.
    pub column: usize,
    /// How many characters it has.
    pub length: usize,
    /// The same in bytes, from the file's beginning.
    pub span: ByteSpan,
}

/// Bytes of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, JsonSchema)]
pub struct ByteSpan {
    /// The bytes before it.
    pub offset: usize,
    /// Its bytes.
    pub length: usize,
}

impl ErrorReport {
    /// An error that is in no file.
    #[must_use]
    pub fn new(message: String) -> ErrorReport {
        ErrorReport {
            message,
            severity: "error",
            causes: Vec::new(),
            help: None,
            file: None,
            filename: None,
            line: None,
            column: None,
            length: None,
            labels: Vec::new(),
            related: Vec::new(),
            estimate: None,
        }
    }

    /// The error at these places of a file.
    #[must_use]
    pub fn at(mut self, file: &str, places: Vec<PlaceReport>) -> ErrorReport {
        (self.file, self.filename) = (Some(file.to_owned()), Some(file.to_owned()));
        if let Some(PlaceReport { line, column, length, .. }) = places.first() {
            (self.line, self.column, self.length) = (Some(*line), Some(*column), Some(*length));
        }
        self.labels = places;
        self
    }
}

impl From<&Problem> for ErrorReport {
    fn from(problem: &Problem) -> ErrorReport {
        let source = problem.source();
        let place = |(bytes, label): (std::ops::Range<usize>, &str)| {
            let (line, column) = source.place(bytes.start);
            PlaceReport {
                label: Some(label.to_owned()),
                line,
                column,
                length: source.text().get(bytes.clone()).map_or(0, |text| text.chars().count()),
                span: ByteSpan { offset: bytes.start, length: bytes.len() },
            }
        };
        let report = ErrorReport::new(problem.message().to_owned());
        let report = report.at(problem.file(), problem.labels().map(place).collect());
        ErrorReport { help: problem.advice().map(str::to_owned), ..report }
    }
}

impl From<&FileError> for ErrorReport {
    fn from(error: &FileError) -> ErrorReport {
        let mut problems = error.first().iter().map(ErrorReport::from);
        let Some(first) = problems.next() else { return ErrorReport::new(error.to_string()) };
        let more = error.more().map(|more| ErrorReport { severity: "advice", ..ErrorReport::new(more) });
        ErrorReport { related: problems.chain(more).collect(), ..first }
    }
}

impl From<&Refusal> for ErrorReport {
    fn from(refusal: &Refusal) -> ErrorReport {
        ErrorReport { help: refusal.advice().map(str::to_owned), ..ErrorReport::new(refusal.to_string()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pulsetrain_motion::file;

    fn report(text: &str) -> ErrorReport {
        let no_other_file = |_: &std::path::Path| Err(std::io::ErrorKind::NotFound.into());
        ErrorReport::from(&file::read(text, "my.toml", &no_other_file).unwrap_err())
    }

    #[test]
    fn the_place_of_a_mistake_is_in_characters_and_in_bytes() {
        let text = "# π is no board\nboard = \"unö\"\n[motor.m]\nsteps_per_rev = 200\ndriver = \"A4988\"\n\
                    pins = { step = 8, dir = 9 }\nforward = \"high\"\n[[motion]]\nmotor = \"m\"\n\
                    law.sine = { amplitude = \"45 deg\", period = \"2 s\", cycles = 1 }\n";
        let ErrorReport { message, file, filename, line, column, length, labels, .. } = report(text);
        assert!(message.contains("unö"), "{message}");
        assert_eq!((file.as_deref(), filename.as_deref()), (Some("my.toml"), Some("my.toml")));
        assert_eq!((line, column, length), (Some(2), Some(9), Some(5)));
        let ByteSpan { offset, length } = labels[0].span;
        assert_eq!(&text[offset..offset + length], "\"unö\"");
    }

    #[test]
    fn more_mistakes_follow_the_first() {
        let few = report("grid = \"nearest\"\n");
        assert!(few.related.iter().all(|other| other.severity == "error") && !few.related.is_empty(), "{few:?}");
        let many: String = (0..20).map(|k| format!("key{k} = 1\n")).collect();
        let many = report(&many);
        let last = many.related.last().expect("more");
        assert_eq!((last.severity, last.message.starts_with("and ")), ("advice", true), "{last:?}");
    }
}
