//! A run from the text of a motion file to its report, without a disk and without a command line.
#![allow(clippy::disallowed_methods, reason = "tests open their own files")]

use std::io::{ErrorKind, Sink};
use std::path::Path;
use std::sync::mpsc::channel;

use expect_test::{ExpectFile, expect_file};
use pulsetrain_motion::file;
use pulsetrain_report::error::ErrorReport;
use pulsetrain_report::json;
use pulsetrain_report::record::OutputFile;
use pulsetrain_report::run::{Progress, Run, RunError, RunOptions, run};
use pulsetrain_session::control::{Command, Event};
use pulsetrain_session::prepare::Prepared;

const TUTORIAL: &str = include_str!("../../../../examples/tutorial.toml");
const FORMULA: &str = include_str!("../../../../examples/formula.toml");

fn prepared(name: &str, text: &str) -> Prepared {
    let no_other_file = |_: &Path| Err(ErrorKind::NotFound.into());
    let contents = file::read_contents(text, name, &no_other_file).unwrap_or_else(|error| panic!("{}", error.plain()));
    Prepared::new(name.to_owned(), contents, None).unwrap()
}

fn run_native(prepared: &mut Prepared, progress: &mut impl Progress) -> Result<Run, RunError> {
    let options = RunOptions { native: true, ..RunOptions::default() };
    run(prepared, &options, |_| None::<std::io::Result<Sink>>, progress)
}

/// What a plan, a verdict and a picture are made of is the same on every platform: every function is of `libm`.
#[test]
fn a_report_is_the_same_to_the_last_digit_on_all_platforms() {
    let check = |name: &str, text: &str, expected: ExpectFile| {
        let run = run_native(&mut prepared(name, text), &mut ()).unwrap();
        assert!(run.report.pass, "{}", run.report);
        expected.assert_eq(&(json(&run.report).unwrap() + "\n"));
    };
    check("tutorial.toml", TUTORIAL, expect_file!["golden/tutorial.json"]);
    check("formula.toml", FORMULA, expect_file!["golden/formula.json"]);
}

#[test]
fn files_come_as_bytes_and_progress_comes_in_order() {
    #[derive(Default)]
    struct Seen(Vec<&'static str>);
    impl Seen {
        fn note(&mut self, what: &'static str) {
            if self.0.last() != Some(&what) {
                self.0.push(what);
            }
        }
    }
    impl Progress for Seen {
        fn planning(&mut self, _: f64) {
            self.note("planning");
        }
        fn may_begin(&mut self) -> bool {
            self.note("begins");
            true
        }
        fn event(&mut self, event: &Event) {
            self.note(if matches!(event, Event::Ended(_)) { "ended" } else { "runs" });
        }
    }
    let (mut trace, mut steps) = (Vec::new(), Vec::new());
    let mut files = [Some(&mut trace), Some(&mut steps)];
    let open = |file| Some(Ok(files[usize::from(file == OutputFile::Steps)].take().unwrap()));
    let mut seen = Seen::default();
    let run = run(&mut prepared("tutorial.toml", TUTORIAL), &RunOptions::default(), open, &mut seen).unwrap();
    assert!(run.report.runner.starts_with("virtual Uno, firmware "), "{}", run.report.runner);
    // So short a motion is planned before anybody looks.
    assert_eq!(seen.0, ["begins", "runs", "ended"]);
    assert_eq!(run.positions[0].steps, 0);
    assert_eq!(String::from_utf8(steps).unwrap().lines().count(), 8001);
    assert!(String::from_utf8(trace).unwrap().contains("$timescale"));
    assert!(run.picture.svg().unwrap().starts_with("<svg"));
}

#[test]
fn a_run_that_may_not_begin_moves_nothing() {
    struct No;
    impl Progress for No {
        fn may_begin(&mut self) -> bool {
            false
        }
        fn event(&mut self, event: &Event) {
            panic!("{event:?}");
        }
    }
    let error = run_native(&mut prepared("tutorial.toml", TUTORIAL), &mut No).unwrap_err();
    assert!(matches!(error, RunError::NotBegun));
    assert_eq!(ErrorReport::from(&error).message, "stopped before it began: no motor has moved");
}

#[test]
fn a_command_stops_the_run_and_its_report_says_where_the_motors_are() {
    let (commands, receiver) = channel();
    commands.send(Command::Stop).unwrap();
    let options = RunOptions { native: true, commands: Some(&receiver), ..RunOptions::default() };
    let mut prepared = prepared("tutorial.toml", TUTORIAL);
    let run = run(&mut prepared, &options, |_| None::<std::io::Result<Sink>>, &mut ()).unwrap();
    let stopped = run.report.stopped.as_ref().expect("it was stopped");
    assert!(run.report.pass && run.ended.stopped && stopped.message.contains("within the motors' limits"));
    assert_eq!((stopped.motors[0].steps, stopped.help.as_str()), (run.positions[0].steps, ""));
}

#[test]
fn a_motion_that_breaks_a_limit_is_refused_with_advice() {
    let text = TUTORIAL.replace("period = \"1 s\"", "period = \"0.01 s\"");
    let error = run_native(&mut prepared("fast.toml", &text), &mut ()).unwrap_err();
    let ErrorReport { message, help, file, .. } = ErrorReport::from(&error);
    assert!(matches!(error, RunError::Refused(_)) && message.starts_with("fast.toml: motor wheel: "), "{message}");
    assert!(help.is_some() && file.is_none(), "{help:?}");
}
