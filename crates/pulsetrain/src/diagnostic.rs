//! Library errors as the command line prints them, with advice.

use std::error::Error;
use std::fmt;
use std::sync::Arc;

use miette::{Diagnostic, LabeledSpan, MietteError, MietteSpanContents, Report, SourceCode, SourceSpan, SpanContents};
use pulsetrain_motion::file::{FileError, Problem, Source};
use pulsetrain_session::drive::DriveError;
use pulsetrain_session::prepare::Refusal;

/// A library error that may have advice.
pub trait Advice: Error + Send + Sync + 'static {
    /// What the user can do, if that is known.
    fn advice(&self) -> Option<&str>;
}

impl Advice for Refusal {
    fn advice(&self) -> Option<&str> {
        Refusal::advice(self)
    }
}

impl Advice for DriveError {
    fn advice(&self) -> Option<&str> {
        DriveError::advice(self)
    }
}

/// An error with its advice as the help below it.
pub fn advised(error: impl Advice) -> Report {
    Report::new(Advised(error))
}

#[derive(Debug)]
struct Advised<E>(E);

impl<E: fmt::Display> fmt::Display for Advised<E> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl<E: Error> Error for Advised<E> {
    fn source(&self) -> Option<&(dyn Error + 'static)> {
        self.0.source()
    }
}

impl<E: Advice> Diagnostic for Advised<E> {
    fn help<'a>(&'a self) -> Option<Box<dyn fmt::Display + 'a>> {
        self.0.advice().map(|advice| Box::new(advice) as Box<dyn fmt::Display>)
    }
}

/// A text of which reports show lines.
#[derive(Clone, Debug)]
pub struct Excerpt(pub Arc<Source>);

impl SourceCode for Excerpt {
    fn read_span<'a>(
        &'a self,
        span: &SourceSpan,
        lines_before: usize,
        lines_after: usize,
    ) -> Result<Box<dyn SpanContents<'a> + 'a>, MietteError> {
        let lines = self.0.text().read_span(span, lines_before, lines_after)?;
        let name = self.0.name().to_owned();
        let (line, column, count) = (lines.line(), lines.column(), lines.line_count());
        Ok(Box::new(MietteSpanContents::new_named(name, lines.data(), *lines.span(), line, column, count)))
    }
}

/// The error for a motion file: its first problem, with the other problems related to it.
#[derive(Debug)]
pub struct WrongFile {
    error: FileError,
    problems: Vec<WrongPlace>,
    more: Option<More>,
}

/// How many problems are not shown.
#[derive(Debug, thiserror::Error, Diagnostic)]
#[error("{0}")]
#[diagnostic(severity(Advice))]
struct More(String);

#[derive(Debug)]
struct WrongPlace {
    problem: Problem,
    source: Excerpt,
}

impl WrongFile {
    /// The reader's error.
    #[must_use]
    pub fn error(&self) -> &FileError {
        &self.error
    }
}

impl From<FileError> for WrongFile {
    fn from(error: FileError) -> WrongFile {
        let places = error.first().iter();
        let problems = places
            .map(|problem| WrongPlace { problem: problem.clone(), source: Excerpt(Arc::clone(problem.source())) });
        WrongFile { problems: problems.collect(), more: error.more().map(More), error }
    }
}

impl fmt::Display for WrongFile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.error.fmt(f)
    }
}

impl Error for WrongFile {}

impl Diagnostic for WrongFile {
    fn help<'a>(&'a self) -> Option<Box<dyn fmt::Display + 'a>> {
        self.problems.first()?.help()
    }

    fn source_code(&self) -> Option<&dyn SourceCode> {
        self.problems.first()?.source_code()
    }

    fn labels(&self) -> Option<Box<dyn Iterator<Item = LabeledSpan> + '_>> {
        self.problems.first()?.labels()
    }

    fn related<'a>(&'a self) -> Option<Box<dyn Iterator<Item = &'a dyn Diagnostic> + 'a>> {
        let others = self.problems.iter().skip(1).map(|problem| problem as &dyn Diagnostic);
        Some(Box::new(others.chain(self.more.iter().map(|more| more as &dyn Diagnostic))))
    }
}

impl fmt::Display for WrongPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.problem.fmt(f)
    }
}

impl Error for WrongPlace {}

impl Diagnostic for WrongPlace {
    fn help<'a>(&'a self) -> Option<Box<dyn fmt::Display + 'a>> {
        self.problem.advice().map(|advice| Box::new(advice) as Box<dyn fmt::Display>)
    }

    fn source_code(&self) -> Option<&dyn SourceCode> {
        Some(&self.source)
    }

    fn labels(&self) -> Option<Box<dyn Iterator<Item = LabeledSpan> + '_>> {
        Some(Box::new(
            self.problem.labels().map(|(at, label)| LabeledSpan::new(Some(label.to_owned()), at.start, at.len())),
        ))
    }
}
