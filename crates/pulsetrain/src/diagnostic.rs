//! Library errors as the command line prints them, with advice.

use std::error::Error;
use std::fmt;
use std::ops::Range;
use std::sync::Arc;

use miette::{
    Diagnostic, LabeledSpan, MietteError, MietteSpanContents, Report, Severity, SourceCode, SourceSpan, SpanContents,
};
use pulsetrain_motion::file::{FileError, Problem, Source};
use pulsetrain_report::error::{ByteSpan, ErrorReport, PlaceReport};
use pulsetrain_session::drive::DriveError;
use pulsetrain_session::prepare::Refusal;

use crate::consent::LongMotion;

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

/// An error as JSON has it. That of a long motion has its estimate, too.
#[must_use]
pub fn as_report(error: &Report) -> ErrorReport {
    match error.downcast_ref::<WrongFile>() {
        Some(wrong) => ErrorReport::from(wrong.error()),
        None => ErrorReport {
            estimate: error.downcast_ref::<LongMotion>().map(|long| *long.estimate()),
            ..report_of(error.as_ref(), None)
        },
    }
}

fn report_of(diagnostic: &dyn Diagnostic, source_of_all: Option<&dyn SourceCode>) -> ErrorReport {
    let source = diagnostic.source_code().or(source_of_all);
    let place = |label: LabeledSpan| {
        let text = |from: usize, length: usize| {
            let contents = source?.read_span(&(from, length).into(), 0, 0).ok()?;
            // Of an empty span at the beginning miette gives the first byte.
            let data = contents.data().get(..length)?;
            Some((contents.name().map(str::to_owned), String::from_utf8_lossy(data).into_owned()))
        };
        let (offset, length) = (label.offset(), label.len());
        let ((_, before), (name, marked)) = (text(0, offset)?, text(offset, length)?);
        let line = before.rsplit('\n').next().unwrap_or_default();
        let place = PlaceReport {
            label: label.label().map(str::to_owned),
            line: before.matches('\n').count() + 1,
            column: line.chars().count() + 1,
            length: marked.chars().count(),
            span: ByteSpan { offset, length },
        };
        Some((name, place))
    };
    let (names, places): (Vec<_>, Vec<_>) = diagnostic.labels().into_iter().flatten().filter_map(place).unzip();
    let causes = std::iter::successors(diagnostic.source(), |cause| (*cause).source());
    let report = ErrorReport {
        severity: match diagnostic.severity() {
            Some(Severity::Advice) => "advice",
            Some(Severity::Warning) => "warning",
            Some(Severity::Error) | None => "error",
        },
        causes: causes.map(ToString::to_string).collect(),
        help: diagnostic.help().map(|help| help.to_string()),
        related: diagnostic.related().into_iter().flatten().map(|other| report_of(other, source)).collect(),
        ..ErrorReport::new(diagnostic.to_string())
    };
    match names.into_iter().next().flatten() {
        Some(file) => report.at(&file, places),
        None => report,
    }
}

/// A text of which reports show lines. Of a very long line they show the part around the place.
#[derive(Clone, Debug)]
pub struct Excerpt {
    source: Arc<Source>,
    /// The text with marks where long lines are cut. They are as long as what they replace, so that all other bytes keep their places.
    /// `None` if no line is cut.
    marked: Option<String>,
}

/// A longer line is not shown whole, bytes.
const LONG_LINE: usize = 240;
/// Of a long line this much is shown on each side of a place, and of the place itself twice as much, bytes.
const AROUND: usize = 40;
/// Places of a long line are shown together if they are within this many bytes. Others are at least [`AROUND`] apart: no part cuts another's place.
const TOGETHER: usize = 5 * AROUND;

impl Excerpt {
    /// Of a text in which nothing but these places is shown.
    pub fn new<'p>(source: &Arc<Source>, places: impl Iterator<Item = &'p Range<usize>>) -> Excerpt {
        let mut excerpt = Excerpt { source: Arc::clone(source), marked: None };
        let in_long_lines = places.filter(|place| excerpt.is_in_long_line(place)).map(|place| excerpt.shown_of(place));
        let mut in_long_lines: Vec<Range<usize>> = in_long_lines.collect();
        in_long_lines.sort_by_key(|place| place.start);
        // As the report puts them together.
        let mut shown: Vec<Range<usize>> = Vec::new();
        for place in in_long_lines {
            match shown.last_mut() {
                Some(last) if excerpt.is_shown_whole(&(last.start..place.end.max(last.end))) => {
                    last.end = place.end.max(last.end);
                }
                _ => shown.push(place),
            }
        }
        for place in &shown {
            let (line, part) = (excerpt.lines(&(place.start..place.start)), excerpt.part(place));
            let text = excerpt.marked.get_or_insert_with(|| source.text().to_owned());
            if part.len() > AROUND {
                let first = part.start..text.ceil_char_boundary(part.start + MARK.len());
                let last = text.floor_char_boundary(part.end - MARK.len())..part.end;
                for (is_cut, at) in [(part.start > line.start, first), (part.end < line.end, last)] {
                    // Not within another place's mark.
                    if is_cut && text.is_char_boundary(at.start) && text.is_char_boundary(at.end) {
                        text.replace_range(at.clone(), &(MARK.to_owned() + &" ".repeat(at.len() - MARK.len())));
                    }
                }
            }
        }
        excerpt
    }

    fn text(&self) -> &str {
        self.marked.as_deref().unwrap_or_else(|| self.source.text())
    }

    /// The bytes of the lines of `at`, without the last line's end.
    fn lines(&self, at: &Range<usize>) -> Range<usize> {
        let text = self.source.text().as_bytes();
        let (start, end) = (at.start.min(text.len()), at.end.min(text.len()));
        let from = text[..start].iter().rposition(|byte| *byte == b'\n').map_or(0, |before| before + 1);
        let length = text[end..].iter().position(|byte| *byte == b'\n').unwrap_or(text.len() - end);
        from..end + length
    }

    /// Whether one of the lines of `at` is too long to be shown.
    fn is_in_long_line(&self, at: &Range<usize>) -> bool {
        self.source.text().as_bytes()[self.lines(at)].split(|byte| *byte == b'\n').any(|line| line.len() > LONG_LINE)
    }

    /// The bytes of a long line that are shown for a place. They do not begin or end within a mark.
    fn part(&self, place: &Range<usize>) -> Range<usize> {
        let text = self.text();
        let line = self.lines(&(place.start..place.start));
        let from = text.floor_char_boundary(place.start.saturating_sub(AROUND)).max(line.start);
        from..text.ceil_char_boundary((place.end + AROUND).min(line.end)).min(line.end)
    }

    /// As much of a place as is shown of it in a long line.
    fn shown_of(&self, at: &Range<usize>) -> Range<usize> {
        let line = self.lines(&(at.start..at.start));
        at.start..at.end.min(at.start + 2 * AROUND).min(line.end.max(at.start))
    }

    /// Whether a place in a long line, or several from the first to the last, are shown as one part.
    fn is_shown_whole(&self, at: &Range<usize>) -> bool {
        at.len() <= TOGETHER && at.end <= self.lines(&(at.start..at.start)).end
    }
}

/// Replaces the parts of a long line that are not shown.
const MARK: &str = "…";

impl SourceCode for Excerpt {
    fn read_span<'a>(
        &'a self,
        span: &SourceSpan,
        lines_before: usize,
        lines_after: usize,
    ) -> Result<Box<dyn SpanContents<'a> + 'a>, MietteError> {
        let lines = self.text().read_span(span, lines_before, lines_after)?;
        let name = self.source.name().to_owned();
        let around = lines.span().offset()..lines.span().offset() + lines.span().len();
        if lines_before + lines_after > 0 && self.is_in_long_line(&around) {
            let at = span.offset()..span.offset() + span.len();
            // The report asks for several places at once, and shows them one by one then.
            if self.is_in_long_line(&at) && !self.is_shown_whole(&at) {
                return Err(MietteError::OutOfBounds);
            }
            let part = self.part(&at);
            let before = &self.source.text().as_bytes()[..part.start];
            let line = before.iter().filter(|byte| **byte == b'\n').count();
            // The bytes with which characters of the line begin.
            let begins = |byte: &&u8| **byte & 0xc0 != 0x80;
            let column = before.rsplit(|byte| *byte == b'\n').next().unwrap_or_default().iter().filter(begins).count();
            let data = &self.text().as_bytes()[part.clone()];
            let span = (part.start, part.len()).into();
            return Ok(Box::new(MietteSpanContents::new_named(name, data, span, line, column, 1)));
        }
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
        let problems = places.map(|problem| {
            let labels: Vec<Range<usize>> = problem.labels().map(|(at, _)| at).collect();
            WrongPlace { problem: problem.clone(), source: Excerpt::new(problem.source(), labels.iter()) }
        });
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
        Some(Box::new(self.problem.labels().map(|(at, label)| {
            // What is not shown of a line cannot be marked.
            let at = if self.source.is_in_long_line(&at) { self.source.shown_of(&at) } else { at };
            LabeledSpan::new(Some(label.to_owned()), at.start, at.len())
        })))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pulsetrain_motion::file;
    use std::fmt::Write as _;

    /// The report of a motion file with this formula, in 80 columns.
    fn report(theta: &str) -> String {
        report_of_law(&format!("law.formula = {{ theta = \"{theta}\", unit = \"deg\", duration = \"2 s\" }}"))
    }

    /// The report of a motion file with this line for its law.
    fn report_of_law(law: &str) -> String {
        let text = format!(
            "board = \"native\"\n[motor.a]\nsteps_per_rev = 200\ndriver = \"A4988\"\npins = {{ step = 8, dir = 9 }}\n\
             forward = \"high\"\n[[motion]]\nmotor = \"a\"\n{law}\n"
        );
        let error = file::read(&text, "long.toml", &|_: &std::path::Path| Err(std::io::ErrorKind::NotFound.into()))
            .unwrap_err();
        let mut report = String::new();
        let handler =
            miette::GraphicalReportHandler::new_themed(miette::GraphicalTheme::unicode_nocolor()).with_width(80);
        handler.render_report(&mut report, &WrongFile::from(error)).unwrap();
        report
    }

    #[test]
    fn a_wrong_file_has_the_same_json_by_both_ways() {
        let text = "board = \"unö\"\nkey = 1\n";
        let error = file::read(text, "my.toml", &|_: &std::path::Path| Err(std::io::ErrorKind::NotFound.into()));
        let error = Report::from(WrongFile::from(error.unwrap_err()));
        let [own, general] = [as_report(&error), report_of(error.as_ref(), None)].map(|report| format!("{report:#?}"));
        assert_eq!(own, general);
        assert!(own.contains("my.toml"), "{own}");
    }

    #[test]
    fn of_a_long_line_the_part_around_the_place_is_shown() {
        let terms = |from: u32| {
            (from..from + 2500).fold(String::new(), |mut sum, k| {
                let _ = write!(sum, "0.1*sin({k}.5*t) + ");
                sum
            })
        };
        for (theta, shown, marks) in [
            // In the middle, near the beginning, near the end, and a place that is itself long.
            (format!("{}foo(t) + {}0", terms(1), terms(3000)), "foo(t)", 2),
            (format!("foo(t) + {}0", terms(1)), "law.formula = { theta = \"foo(t)", 1),
            (format!("{}foo(t)", terms(1)), "foo(t)\", unit = \"deg\", duration = \"2 s\" }", 1),
            (
                format!("{}\u{3c0}\u{3c0}\u{3c0}*foo(t)*\u{3c0}\u{3c0}\u{3c0} + {}0", terms(1), terms(3000)),
                "\u{3c0}*foo",
                2,
            ),
            (format!("sin({}0, 2)", terms(1)), "theta = \"sin(0.1*sin(1.5*t)", 1),
        ] {
            let said = report(&theta);
            assert!(said.contains(shown) && said.matches('…').count() == marks, "{said}");
            assert!(said.lines().count() < 12 && said.lines().all(|line| line.chars().count() < 200), "{said}");
        }
    }

    /// Both are seen: in one part of the line if they are near, else in two.
    #[test]
    fn two_places_of_a_long_line_are_shown() {
        let long = "0.1*sin(t) + ".repeat(100);
        let sine = |unit: &str| format!("sine = {{ amplitude = \"1 {unit}\", period = \"1 s\" }}");
        let formula = |theta: &str| format!("formula = {{ theta = \"{theta}0\", unit = \"deg\", duration = \"2 s\" }}");
        for (law, parts, marks) in [
            // The line goes on, far apart; near each other, with the rest of the line before and behind; and in two lines.
            (format!("law = {{ {}, {} }}", formula(&long), sine("rev")), 2, 3),
            (format!("law = {{ {}, {} }}", sine("rev"), formula(&long)), 1, 1),
            (format!("law.{} # {long}\nlaw.{}", sine("rev"), formula("t + ")), 2, 1),
        ] {
            let said = report_of_law(&law);
            assert_eq!(said.matches("long.toml").count(), parts, "{said}");
            assert!(said.matches('…').count() == marks, "{said}");
            for shown in ["sine = {", "formula = {"] {
                assert!(said.contains(shown), "{shown}: {said}");
            }
            assert!(said.lines().all(|line| line.chars().count() < 300), "{said}");
        }
    }
}
