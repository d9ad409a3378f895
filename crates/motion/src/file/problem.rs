//! What is wrong with a motion file, and where.

use std::fmt::{self, Write as _};
use std::ops::Range;
use std::sync::Arc;

use super::source::Source;

/// Everything that is wrong with a motion file; at least one [`Problem`].
///
/// As an error it is the first problem; [`problems`](FileError::problems) has those that are kept, [`first`](FileError::first) those that people read.
#[derive(Clone, Debug)]
pub struct FileError {
    problems: Vec<Problem>,
    /// How many were found beyond them.
    others: usize,
}

/// One thing that is wrong: what, where, and what to do.
#[derive(Clone, Debug)]
pub struct Problem {
    message: String,
    labels: Vec<(Range<usize>, String)>,
    help: Option<String>,
    path: Option<Box<BrokenPath>>,
    source: Arc<Source>,
}

/// A machine's path that breaks a limit somewhere: the path around that place.
#[derive(Clone, Debug, PartialEq)]
pub struct BrokenPath {
    /// As the file calls the machine.
    pub machine: String,
    /// What it is, in words.
    pub is: String,
    /// When the path is at the place, s of its own time.
    pub at_s: f64,
    /// Of what there is too much, its unit, and the limit that it meets; `None` where arms do not reach.
    pub limit: Option<(String, &'static str, f64)>,
    /// The factor by which the path must be slower to keep all of the machine's limits on speed and acceleration;
    /// `None` if slowing down does not help.
    pub slower: Option<f64>,
    /// The path, in the order of time; the place is among them.
    pub points: Vec<PathPoint>,
}

/// A point of a [`BrokenPath`].
#[derive(Clone, Debug, PartialEq)]
pub struct PathPoint {
    /// s.
    pub at_s: f64,
    /// Where the tip is then, mm: x, y, and z if it has one.
    pub tip: Vec<f64>,
    /// What the limit is of.
    pub value: Option<f64>,
}

/// Problems that are shown: what people read.
const MOST_SHOWN: usize = 10;
/// Problems that are kept. Those beyond are counted.
pub(super) const MAX_PROBLEMS: usize = 100;

impl FileError {
    /// `None` if there is no problem.
    pub(super) fn of(problems: Vec<Problem>, others: usize) -> Option<FileError> {
        (!problems.is_empty()).then_some(FileError { problems, others })
    }

    /// A problem with the file as a whole.
    pub(super) fn whole(source: &Arc<Source>, message: String, help: Option<String>) -> FileError {
        FileError { problems: vec![Problem::new(source, message, Vec::new(), help)], others: 0 }
    }

    /// The first problems, in the order in which they were found: at most 100.
    #[must_use]
    pub fn problems(&self) -> &[Problem] {
        &self.problems
    }

    /// The first problems, as many as people read; all but the first few of hundreds have one cause.
    #[must_use]
    pub fn first(&self) -> &[Problem] {
        &self.problems[..self.problems.len().min(MOST_SHOWN)]
    }

    /// How many there are beyond the [`first`](FileError::first), in words.
    #[must_use]
    pub fn more(&self) -> Option<String> {
        let more = self.problems.len().saturating_sub(MOST_SHOWN) + self.others;
        (more > 0).then(|| format!("and {more} more"))
    }

    /// The first problems as plain text: `file:line:column: message`, then the advice, indented; and how many more there are.
    #[must_use]
    pub fn plain(&self) -> String {
        let shown = self.first().iter().fold(String::new(), |mut text, problem| {
            let (line, column) = problem.place();
            let _ = writeln!(text, "{}:{line}:{column}: {}", problem.source.name(), problem.message);
            for line in problem.help.iter().flat_map(|help| help.lines()) {
                let _ = writeln!(text, "    {line}");
            }
            text
        });
        shown + &self.more().map_or(String::new(), |more| more + "\n")
    }
}

impl Problem {
    pub(super) fn new(
        source: &Arc<Source>,
        message: String,
        labels: Vec<(Range<usize>, String)>,
        help: Option<String>,
    ) -> Problem {
        Problem { message, labels, help, path: None, source: Arc::clone(source) }
    }

    /// With the path that it is about.
    pub(super) fn of_path(mut self, path: BrokenPath) -> Problem {
        self.path = Some(Box::new(path));
        self
    }

    /// Moves labels from the first places to the second ones. If none moves, the first label is the `cause`.
    pub(super) fn point_at(&mut self, moved: &[(Range<usize>, Range<usize>)], cause: Option<Range<usize>>) {
        let mut is_moved = false;
        for (at, _) in &mut self.labels {
            if let Some((_, to)) = moved.iter().find(|(from, _)| from == at) {
                (*at, is_moved) = (to.clone(), true);
            }
        }
        if let Some(cause) = cause.filter(|_| !is_moved) {
            self.labels.insert(0, (cause, "with this value".to_owned()));
        }
    }

    /// The machine's path that it is about, if that is known from end to end.
    #[must_use]
    pub fn path(&self) -> Option<&BrokenPath> {
        self.path.as_deref()
    }

    /// What is wrong.
    #[must_use]
    pub fn message(&self) -> &str {
        &self.message
    }

    /// What to do about it, if that is more than the message says.
    #[must_use]
    pub fn advice(&self) -> Option<&str> {
        self.help.as_deref()
    }

    /// The file that it is in.
    #[must_use]
    pub fn file(&self) -> &str {
        self.source.name()
    }

    /// Line and column (characters), from 1, of its first label.
    #[must_use]
    pub fn place(&self) -> (usize, usize) {
        self.source.place(self.labels.first().map_or(0, |(span, _)| span.start))
    }

    /// The text that it is in.
    #[must_use]
    pub fn source(&self) -> &Arc<Source> {
        &self.source
    }

    /// The places that it is about, bytes of its [`source`](Problem::source), each with what is there.
    pub fn labels(&self) -> impl Iterator<Item = (Range<usize>, &str)> {
        let length = self.source.text().len();
        self.labels.iter().map(move |(span, label)| {
            let start = span.start.min(length);
            (start..span.end.clamp(start, length), label.as_str())
        })
    }

    /// Whether another problem has the same message at the same place.
    pub(super) fn repeats(&self, other: &Problem) -> bool {
        self.message == other.message && self.labels == other.labels && self.file() == other.file()
    }
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for Problem {}

impl fmt::Display for FileError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.problems[0].fmt(f)
    }
}

impl std::error::Error for FileError {}
