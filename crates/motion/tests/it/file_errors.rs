//! Wrong motion files: each mistake gets an error that names the place, the limit and the remedy.
//!
//! `golden/messages.txt` is a table of mistakes with what is said of each. It begins with how to add one.

use std::collections::HashSet;
use std::fmt::Write as _;
use std::io;
use std::path::Path;
use std::sync::LazyLock;

use expect_test::expect_file;
use proptest::prelude::*;
use pulsetrain_motion::file::{self, FileError, Problem};
use pulsetrain_motion::law::Cursor;
use pulsetrain_motion::program::{BoardError, Program};
use pulsetrain_motion::{Time, boards, template};

static TABLE: LazyLock<String> = LazyLock::new(|| expect_file!["golden/messages.txt"].data());
/// The files in the table, with their names.
static FILES: LazyLock<Vec<(&str, String)>> = LazyLock::new(|| TABLE.split("\n\n").filter_map(file_in).collect());
static GOOD: LazyLock<&str> = LazyLock::new(|| good("wheel.toml"));
const SINE: &str = r#"law.sine = { amplitude = "2.5 rev", period = "1 s" }"#;

/// The name and the text of a paragraph that is a file.
fn file_in(paragraph: &str) -> Option<(&str, String)> {
    let (name, lines) = paragraph.strip_prefix("=== ")?.split_once('\n')?;
    let lines = lines.lines().map(|line| line.strip_prefix('|').expect("each line of a file begins so"));
    Some((name, lines.map(|line| format!("{}\n", line.strip_prefix(' ').unwrap_or(line))).collect()))
}

/// A file of the table, before anything is changed in it.
pub(super) fn good(name: &str) -> &'static str {
    let found = FILES.iter().find(|(other, _)| *other == name);
    found.map_or_else(|| panic!("the table has no {name}"), |(_, text)| text)
}

/// Motion files find the table's other files.
pub(super) fn loader(path: &Path) -> io::Result<String> {
    let found = FILES.iter().find(|(name, _)| Path::new(name) == path);
    found.map(|(_, text)| text.clone()).ok_or_else(|| io::ErrorKind::NotFound.into())
}

fn read(text: &str) -> Result<Program, FileError> {
    file::read(text, "x.toml", &loader)
}

/// The key that a line begins with.
fn key(line: &str) -> Option<&str> {
    let (key, _) = line.split_once([' ', '.'])?;
    (!key.is_empty() && key.chars().all(|c| c.is_ascii_lowercase() || c == '_')).then_some(key)
}

/// A good file with the changes of a case, as the table's head defines them.
fn changed(good: &str, changes: &[&str]) -> String {
    let mut lines: Vec<&str> = good.lines().collect();
    let (mut next, mut is_gap, mut ends) = (None, false, true);
    for change in changes {
        let line = change.get(2..).unwrap_or_default();
        if *change == "- *" {
            lines.clear();
            (next, is_gap) = (Some(0), true);
        } else if change.starts_with('-') {
            let at = lines.iter().position(|other| *other == line).unwrap_or_else(|| panic!("no line {line:?}"));
            lines.remove(at);
            (next, is_gap) = (Some(at), true);
        } else if change.starts_with('+') {
            let has_key = |other: &&str| !is_gap && key(line).is_some() && key(line) == key(other);
            let at = match lines.iter().position(has_key) {
                Some(at) => {
                    lines[at] = line;
                    at
                }
                None => {
                    let at = next.unwrap_or_else(|| panic!("where does {line:?} belong?"));
                    lines.insert(at, line);
                    at
                }
            };
            next = Some(at + 1);
        } else {
            ends = false;
        }
    }
    let mut text: String = lines.iter().map(|line| format!("{line}\n")).collect();
    if !ends {
        text.pop();
    }
    text
}

/// What is said of a file, and what is underlined: a line or more for each problem.
fn said_of(text: &str, name: &str) -> String {
    let Err(error) = file::read(text, name, &loader) else { return "no problem\n".to_owned() };
    lies_in_its_file(&error);
    let (mut said, mut plain) = (String::new(), String::new());
    for problem in error.problems() {
        let (line, column) = problem.place();
        let message = format!("{}:{line}:{column}: {}\n", problem.file(), problem.message());
        let advice: String =
            problem.advice().iter().flat_map(|it| it.lines()).map(|it| format!("    {it}\n")).collect();
        plain += &format!("{message}{advice}");
        said += &message;
        for (span, label) in problem.labels() {
            let _ = writeln!(said, "  ^ {}: {label}", excerpt(&problem.source().text()[span]));
        }
        said += &advice;
        for text in [Some(problem.message()), problem.advice()].into_iter().flatten() {
            let is_internal = ["Some(", "None", "Err(", "Error", "::"].iter().any(|word| text.contains(word));
            assert!(!is_internal && !text.contains("..") && text.trim() == text && !text.is_empty(), "{text:?}");
        }
        assert!(!problem.message().ends_with('.') && !problem.message().contains('\n'), "{problem}");
        if error.problems().len() == 1 && problem.file() == name {
            follow(problem, text);
        } else if !text.contains("[machine") {
            problem.advice().into_iter().flat_map(assignments).for_each(|it| check_assignment(&it, text));
        }
    }
    assert_eq!(error.plain(), plain);
    said
}

/// Does what the advice on a file's only problem says, in each way that it offers. With another value the file is good.
fn follow(problem: &Problem, text: &str) {
    let advice = problem.advice().unwrap_or_default();
    for assignment in assignments(advice) {
        match in_place(text, problem.place().0, &assignment) {
            Some(mended) => is_good(&mended, &assignment),
            // Keys of machines have other places.
            None if text.contains("[machine") => {}
            None => check_assignment(&assignment, text),
        }
    }
    for meant in advice.strip_prefix("did you mean ").into_iter().flat_map(|it| it.trim_end_matches('?').split(", or "))
    {
        let (span, _) = problem.labels().next().expect("something is meant");
        let mended = format!("{}{}{}", &text[..span.start], meant.trim_matches('`'), &text[span.end..]);
        if meant.contains(' ') {
            is_good(&mended, meant);
        } else if let Err(other) = read(&mended) {
            // Behind another name other keys may be missing.
            assert!(!other.plain().contains(problem.message()), "with {meant}:\n{}", other.plain());
        }
    }
}

fn is_good(mended: &str, advice: &str) {
    assert!(read(mended).is_ok(), "with {advice}:\n{}", read(mended).unwrap_err().plain());
}

/// The file with another value of a key in a line, counted from 1. `None` if the line does not have the key.
fn in_place(text: &str, line: usize, assignment: &str) -> Option<String> {
    let (key, value) = assignment.split_once(" = ")?;
    let begin: usize = text.split_inclusive('\n').take(line - 1).map(str::len).sum();
    let from = begin + text[begin..].lines().next()?.rfind(&format!("{key} = "))? + key.len() + 3;
    let old = &text[from..];
    let length = match old.chars().next()? {
        '"' => old[1..].find('"')? + 2,
        '{' => old.find('}')? + 1,
        '[' => old.find(']')? + 1,
        _ => old.find([',', '}', '\n'])?,
    };
    Some(format!("{}{value}{}", &text[..from], &old[length..]))
}

/// The beginning of what is underlined.
fn excerpt(underlined: &str) -> String {
    const SHOWN: usize = 48;
    let line = underlined.lines().next().unwrap_or_default();
    let shown: String = line.chars().take(SHOWN).collect();
    if shown == underlined { shown } else { shown + "…" }
}

#[test]
fn each_mistake_gets_its_message() {
    let (mut good, mut cases) = (("", String::new()), HashSet::new());
    let answered = TABLE.trim_end().split("\n\n").map(|paragraph| {
        if let Some(file) = file_in(paragraph).filter(|(name, _)| name.ends_with(".toml")) {
            good = file;
        }
        let changes: Vec<&str> = paragraph.lines().filter(|line| line.starts_with(['+', '-', '\\'])).collect();
        if changes.is_empty() {
            return paragraph.to_owned();
        }
        let text = changed(&good.1, &changes);
        let case = format!("{}\n{}", changes.join("\n"), said_of(&text, good.0).trim_end());
        assert!(cases.insert(text), "this is there twice:\n{case}");
        case
    });
    let answered: Vec<String> = answered.collect();
    expect_file!["golden/messages.txt"].assert_eq(&(answered.join("\n\n") + "\n"));
}

/// Every `key = value` of some advice, as far as that reads as TOML; also with a second value that it offers.
fn assignments(advice: &str) -> Vec<String> {
    let is_of_key = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '.';
    let places = advice.match_indices(" = ").filter_map(|(at, _)| {
        let key = advice[..at].rfind(|c| !is_of_key(c)).map_or(0, |before| before + 1);
        let line = advice[key..].lines().next()?;
        // What is within another one's value is read with that.
        let depth = |c: char| advice[..key].matches(c).count();
        (depth('{') == depth('}') && depth('[') == depth(']') || advice[..key].ends_with("[[motion]] with "))
            .then_some((&advice[key..at], line))
    });
    places
        .flat_map(|(key, line)| {
            let ends = (0..=line.len()).rev().filter(|end| line.is_char_boundary(*end));
            let longest =
                ends.map(|end| line[..end].trim_end()).find(|part| part.parse::<toml_edit::DocumentMut>().is_ok());
            let found = longest.filter(|part| part.len() > key.len());
            let found = found.unwrap_or_else(|| panic!("this does not parse: {line}"));
            let rest = line[found.len()..].trim_start_matches(',').strip_prefix(" or \"");
            let other = rest.and_then(|rest| rest.split_once('"')).map(|(value, _)| format!("{key} = \"{value}\""));
            [found.to_owned()].into_iter().chain(other)
        })
        .collect()
}

/// Where keys belong: a part of the good file, and the keys that go there.
const PLACES: &[(&str, &[&str])] = &[
    ("", &["board", "grid", "tolerance", "idle"]),
    (
        "motor.wheel",
        &[
            "steps_per_rev",
            "microsteps",
            "driver",
            "pins",
            "forward",
            "enabled",
            "sequence",
            "gear",
            "lead",
            "max_speed",
            "max_acceleration",
            "pull_in",
            "backlash",
            "film_limit",
            "pulse_high",
            "pulse_low",
            "dir_setup",
            "dir_hold",
            "inductance",
            "current",
            "voltage",
        ],
    ),
    ("motion", &["motor", "motors", "machine", "start", "repeat", "ease", "begin", "end"]),
    (
        "law",
        &[
            "sine",
            "formula",
            "table",
            "speed",
            "trapezoid",
            "s_curve",
            "sweep",
            "ramp",
            "winch",
            "rest",
            "sum",
            "then",
            "scale",
            "shift",
            "delay",
            "repeat",
        ],
    ),
    ("law.sine", &["amplitude", "period", "frequency", "cycles", "dds"]),
    ("law.formula", &["theta", "unit", "duration", "where"]),
    ("law.table", &["file", "time", "columns", "interpolation"]),
    ("law.speed", &["speed"]),
    ("law.trapezoid", &["distance", "acceleration", "deceleration"]),
    ("law.s_curve", &["jerk", "start_speed"]),
    ("law.sweep", &["swing", "phase"]),
    ("law.ramp", &["tick", "slowest", "fastest", "during"]),
    ("law.winch", &["axis", "commands"]),
    ("law.scale", &["by"]),
    ("law.repeat", &["times"]),
    ("grid", &["hysteresis"]),
    ("pins", &["step", "dir", "enable"]),
];

/// Puts what some advice says to write where it belongs: the reader takes it.
#[track_caller]
fn check_assignment(assignment: &str, file: &str) {
    let written: toml_edit::DocumentMut = assignment.parse().unwrap();
    let (key, item) = written.iter().next().unwrap();
    if key == "law" || key == "path" {
        let (inner, item) = item.as_table_like().unwrap().iter().next().unwrap();
        return if key == "law" {
            check_assignment(&format!("{inner} = {}", item.to_string().trim()), file)
        };
    }
    let places: Vec<&str> = PLACES.iter().filter(|(_, keys)| keys.contains(&key)).map(|(place, _)| *place).collect();
    assert!(!places.is_empty() || OF_MACHINES.contains(&key), "where does {assignment} belong?");
    // In the file that is complained of, if it has all that there is a place in.
    let has_all = |file: &toml_edit::DocumentMut| {
        let motion = file.get("motion").and_then(|motion| motion.as_array_of_tables());
        file.get("motor").is_some_and(|motor| motor.get("wheel").is_some()) && motion.is_some_and(|all| !all.is_empty())
    };
    let base = file.parse::<toml_edit::DocumentMut>().ok().filter(has_all).unwrap_or_else(|| GOOD.parse().unwrap());
    let before = read(&base.to_string()).map_or_else(|error| error.plain(), |_| String::new());
    let said = |place: &str| {
        let mut file = base.clone();
        let mut text = String::new();
        match place {
            "" => file[key] = item.clone(),
            "pins" => file["motor"]["wheel"]["pins"][key] = item.clone(),
            "grid" => file["grid"] = toml_edit::value(format!("{{ {assignment} }}")),
            "motor.wheel" => file["motor"]["wheel"][key] = item.clone(),
            _ => {
                let motion = file["motion"].as_array_of_tables_mut().unwrap().get_mut(0).unwrap();
                match place.strip_prefix("law.") {
                    None if place == "motion" => motion[key] = item.clone(),
                    within => {
                        motion.remove("law");
                        text = match within {
                            None => format!("law.{assignment}\n"),
                            Some(law) => format!("law.{law} = {{ {assignment} }}\n"),
                        };
                    }
                }
            }
        }
        let text = format!("{file}{text}").replace(&format!("'{{ {assignment} }}'"), &format!("{{ {assignment} }}"));
        let error = read(&text).err();
        // Other things may be missing there now; this one is not to be complained of.
        let about = |problem: &&Problem| {
            let message = problem.message();
            let is_new = !before.contains(message) && (message.contains("not TOML") || message.contains("unknown"));
            is_new || message.starts_with(&format!("`{key}`"))
        };
        error.and_then(|error| error.problems().iter().find(about).map(|problem| format!("{problem}: {text}")))
    };
    let refusals: Vec<String> = places.iter().filter_map(|place| said(place)).collect();
    assert!(places.is_empty() || refusals.len() < places.len(), "{assignment}: {refusals:?}");
}

/// Of machines and their paths: those parse, and the examples of docs/machines.md are read.
const OF_MACHINES: &[&str] = &[
    "kind",
    "radius",
    "points",
    "pause",
    "x",
    "y",
    "z",
    "angles",
    "axes",
    "base",
    "upper_arm",
    "forearm",
    "effector",
    "circle",
    "lorenz",
    "lines",
];

#[test]
fn what_is_no_toml_is_found_in_advice() {
    assert_eq!(
        assignments("write tolerance = \"1 tick\", or \"1 us\""),
        ["tolerance = \"1 tick\"", "tolerance = \"1 us\""]
    );
    assert_eq!(
        assignments("add grid = { hysteresis = \"0.1 step\" } there; or gear = 3 if"),
        ["grid = { hysteresis = \"0.1 step\" }", "gear = 3"]
    );
    let refused = |it: &'static str| std::panic::catch_unwind(|| check_assignment(it, &GOOD)).is_err();
    assert!(refused("tolerance = \"78 000 ticks\"") && refused("tolerance = 78"));
    assert!(refused("bord = \"uno\"") && !refused("tolerance = \"78000 ticks\""));
    assert!(std::panic::catch_unwind(|| assignments("sum = [{ sine = { … } }]")).is_err());
}

/// What is offered in place of a parameter's name that is taken can be used.
#[test]
fn other_names_of_parameters_can_be_used() {
    for name in ["pi", "t", "sin", "if", "and"] {
        let formula = "law.formula = { theta = \"2*t\", unit = \"rev\", duration = \"1 s\", where = { NAME = 3 } }";
        let with = |name: &str| read(&GOOD.replace(SINE, &formula.replace("NAME", name)));
        let error = with(name).unwrap_err().plain();
        let offered = error.split('`').nth(3).unwrap();
        assert!(with(offered).is_ok(), "{error}");
    }
}

/// Any one bad value is one problem.
#[test]
fn one_mistake_is_one_problem() {
    const LAWS: &[&str] = &[
        SINE,
        "law.trapezoid = { distance = \"5 rev\", speed = \"2 rev/s\", acceleration = \"10 rev/s^2\" }",
        "law.trapezoid = { distance = \"5 rev\", speed = \"2 rev/s\", acceleration = \"10 rev/s^2\", deceleration = \"5 rev/s^2\" }",
        "law.s_curve = { distance = \"5 rev\", speed = \"2 rev/s\", acceleration = \"10 rev/s^2\", jerk = \"100 rev/s^3\", start_speed = \"0 rev/s\" }",
        "law.ramp = { distance = \"1 rev\", tick = \"8 us\", slowest = 255, during = 10 }",
        "law.ramp = { distance = \"1 rev\", tick = \"8 us\", slowest = 255, fastest = 18, during = 10 }",
        "law.sweep = { frequency = \"0.5 Hz\", swing = \"200 step\", phase = \"90 deg\" }",
        "law.speed = { speed = \"2 rev/s\", duration = \"10 s\" }\nease = \"1 s\"\nstart = \"0 s\"",
        "law.formula = { theta = \"a*t\", unit = \"deg\", duration = \"10 s\", where = { a = \"3 deg/s\" } }",
        "law.then = [{ rest = \"1 s\" }, { delay = { by = \"1 s\", law = { rest = \"2 s\" } } }]",
        "law.shift = { by = \"90 deg\", law = { rest = \"2 s\" } }",
    ];
    let motor = "forward = \"low\"\nmax_speed = \"5 rev/s\"\nmax_acceleration = \"50 rev/s^2\"\npull_in = \"2 rev/s\"\nbacklash = { slack = \"6 step\", over = \"20 ms\" }\n\
        pulse_high = \"10 us\"\npulse_low = \"10 us\"\ndir_setup = \"1 us\"\ndir_hold = \"1 us\"\ninductance = \"3 mH\"\ncurrent = \"1 A\"\nvoltage = \"12 V\"";
    let mut tried = 0;
    for law in LAWS {
        let good = GOOD.replace("forward = \"low\"", motor).replace(SINE, law);
        let read_good = read(&good);
        assert!(read_good.is_ok(), "{law}: {}", read_good.unwrap_err().plain());
        // Every text in quotes, one after the other; and one of each kind of mistake.
        let quotes: Vec<usize> = good.match_indices('"').map(|(at, _)| at).collect();
        for pair in quotes.chunks(2) {
            let ([from, to], true) = (pair, good[..pair[0]].ends_with("= ")) else { continue };
            let value = &good[from + 1..*to];
            for wrong in ["", "5", "5 parsecs", "-5 s/s", "nonsense"]
                .into_iter()
                .chain(value.contains(' ').then_some("0,5 parsecs"))
            {
                let text = format!("{}{wrong}{}", &good[..=*from], &good[*to..]);
                if let Err(error) = read(&text) {
                    assert_eq!(error.problems().len(), 1, "\"{value}\" as \"{wrong}\": {}", error.plain());
                    tried += 1;
                }
            }
        }
    }
    assert!(tried > 500, "{tried} mistakes");
}

/// Phases are times, angles or parts of a turn, in the same places.
#[test]
fn phases_may_be_angles() {
    let at = |phase: &str, t: f64| {
        let law = format!("law.sweep = {{ frequency = \"0.5 Hz\", swing = \"200 step\", phase = \"{phase}\" }}");
        let law = read(&GOOD.replace(SINE, &law)).unwrap().motors.remove(0).law;
        Cursor::new(&law).at(Time::from_seconds(t)).unwrap().position
    };
    for (phase, same) in [
        ("0.25 turn", "500 ms"),
        ("90 deg", "500 ms"),
        ("90°", "500 ms"),
        ("0.25 rev", "500 ms"),
        ("1.25 turn", "500 ms"),
        ("-270 deg", "500 ms"),
        ("0 deg", "0 ms"),
        ("360 deg", "0 ms"),
        ("2500 ms", "500 ms"),
    ] {
        for t in [0.1, 0.7, 1.3, 2.9] {
            assert!((at(phase, t) - at(same, t)).abs() < 1e-9, "{phase} at {t}");
        }
    }
    assert!((at("3.14159265358979 rad", 1.5) - at("1 s", 1.5)).abs() < 1e-9);
}

#[test]
fn of_hundreds_of_problems_ten_are_named() {
    let motors: String = (0..500)
        .map(|k| format!("[motor.m{k}]\nsteps_per_rev = 200\ndriver = \"A9999\"\npins = {{ step = 8, dir = 9 }}\nforward = \"high\"\n"))
        .collect();
    let error =
        read(&format!("board = \"uno\"\n{motors}[[motion]]\nmotor = \"m0\"\nlaw.rest = \"1 s\"\n")).unwrap_err();
    let told = error.plain();
    assert!(told.starts_with("x.toml:1:9: the board `uno` drives 4 motors at most, but the file has 500\n"), "{told}");
    assert_eq!(told.matches("unknown driver").count(), 9, "{told}");
    assert!(told.ends_with("\nand 491 more\n"), "{told}");
    assert_eq!(error.problems().len(), 100, "no more are kept");
}

#[test]
fn a_byte_order_mark_is_no_content() {
    assert_eq!(read("\u{feff}").unwrap_err().plain(), read("").unwrap_err().plain());
}

/// The columns that an error offers are read.
#[test]
fn columns_that_are_offered_are_read() {
    for (file, offers) in [("frames", 0), ("two", 2), ("times", 2), ("bare", 2), ("unknown", 1), ("gon", 1)] {
        let motion = |rest: &str| {
            read(&GOOD.replacen(SINE, &format!("law.table = {{ file = \"{file}.csv\", unit = \"deg\"{rest} }}"), 1))
        };
        let said = motion("").unwrap_err().plain();
        let fixes: Vec<&str> = said.lines().filter_map(|line| Some(line.split_once(", write: ")?.1)).collect();
        assert_eq!(fixes.len(), offers, "{said}");
        for fix in fixes {
            assert!(motion(&format!(", {fix}")).is_ok(), "{said}");
        }
    }
}

#[test]
fn whole_numbers_may_have_an_exponent() {
    let text = GOOD.replacen(SINE, "law.sine = { amplitude = \"2.5 rev\", period = \"1 s\", cycles = 1e9 }", 1);
    assert_eq!(read(&text).unwrap().motors[0].law.end(), Some(Time::SECOND.times(1_000_000_000)));
    let same = read(&GOOD.replacen("200", "2e2", 1)).unwrap();
    assert_eq!(same.motors[0].scale.steps_per_rev, 800.0);
}

#[test]
fn boards_can_be_changed_if_the_pins_are_there() {
    let other = |name: &str| boards::find(name).unwrap().limits();
    let program = read(&GOOD).unwrap();
    assert_eq!(program.clone().with_board(other("native")).unwrap().board.name, "native");
    let on_pico = GOOD.replace("\"uno\"", "\"pico\"").replace("step = 8", "step = 28");
    let error = read(&on_pico).unwrap().with_board(other("uno")).unwrap_err();
    assert!(matches!(error, BoardError::Pin { .. }));
    assert_eq!(error.to_string(), "motor `wheel`: the board `uno` has no pin 28: its pins are 0 to 19");
    let narrow = pulsetrain_motion::boards::BoardLimits { max_motors: 0, ..other("uno") };
    assert!(matches!(program.with_board(narrow), Err(BoardError::TooManyMotors { motors: 1, limit: 0, .. })));
}

#[test]
fn idle_is_hold_or_a_time() {
    let idle = |text: &str| read(&GOOD.replacen("tolerance", &format!("{text}\ntolerance"), 1)).unwrap().idle_ms;
    assert_eq!(idle(""), None);
    assert_eq!(idle("idle = \"hold\""), None);
    assert_eq!(idle("idle = \"1 ms\""), Some(1));
    assert_eq!(idle("idle = \"2.5 s\""), Some(2500));
    assert_eq!(idle("idle = \"8 s\""), Some(8000));
}

#[test]
fn units_come_to_steps() {
    let end = |text: &str| read(text).unwrap().motors[0].law.end().unwrap();
    assert_eq!(end(&GOOD.replace("period = \"1 s\"", "frequency = \"4 Hz\"")), Time::from_ratio(1, 4));
    assert_eq!(end(&GOOD.replace("\"1 s\" }", "\"100 ms\", cycles = 3 }")), Time::from_ratio(1, 10).times(3));
    let geared =
        GOOD.replace("microsteps = 4", "microsteps = 4\ngear = \"20:60\"\nlead = \"8 mm\"\nmax_speed = \"16 mm/s\"");
    let motor = &read(&geared).unwrap().motors[0];
    // 2 revolutions of the driven shaft a second: 2 × 3 × 800 steps/s.
    assert!((motor.limits.max_speed.unwrap() - 4800.0).abs() < 1e-9);
    assert_eq!((motor.scale.steps_per_rev, motor.scale.steps_per_unit), (800.0, 2400.0));
    let coils = GOOD.replace("microsteps = 4", "microsteps = 2").replace("DQ542MA", "ULN2003");
    let coils = coils.replace("step = 8, dir = 9", "in = [2, 3, 4, 5]").replace("forward = \"low\"", "");
    let motor = &read(&coils).unwrap().motors[0];
    assert_eq!(motor.wiring.pins(), [2, 3, 4, 5]);
    assert_eq!(motor.timing, Default::default());
}

/// Files in which something has been cut out, put in or doubled.
fn mutated() -> impl Strategy<Value = String> {
    let bases = prop::sample::select(vec![GOOD.to_string(), template::motion_file("base")]);
    let insert =
        prop_oneof!["\\PC{0,8}", "[\\[\\]{}=\".,:0-9 \\n-]{0,6}", Just("1e999".to_owned()), Just("law".to_owned())];
    (bases, any::<prop::sample::Index>(), any::<prop::sample::Index>(), insert).prop_map(|(base, a, b, insert)| {
        let cuts: Vec<usize> = base.char_indices().map(|(at, _)| at).collect();
        let (mut a, mut b) = (*a.get(&cuts), *b.get(&cuts));
        if a > b {
            std::mem::swap(&mut a, &mut b);
        }
        // Short cuts leave most of the file readable.
        let b = if b - a > 12 { base.ceil_char_boundary(a + (b % 5)) } else { b };
        format!("{}{insert}{}", &base[..a], &base[b..])
    })
}

/// Every problem has a place in the text that it is about.
pub(super) fn lies_in_its_file(error: &FileError) {
    assert!(!error.problems().is_empty() && !error.plain().is_empty());
    for problem in error.problems() {
        let text = problem.source().text();
        assert!(problem.place().0 <= text.lines().count().max(1) + 1, "{problem}: line {}", problem.place().0);
        for (span, _) in problem.labels() {
            assert!(text.as_bytes().get(span.clone()).is_some(), "{problem}: {span:?}");
        }
    }
}

fn survive(text: &str) {
    if let Err(error) = read(text) {
        lies_in_its_file(&error);
    }
}

proptest! {
    #[test]
    fn any_text_gives_an_error_with_a_place(text in "\\PC{0,200}") {
        survive(&text);
    }

    #[test]
    fn mutated_files_never_panic(text in mutated()) {
        survive(&text);
    }

    #[test]
    fn any_value_anywhere(key in prop::sample::select(vec![
        "board", "grid", "tolerance", "idle", "steps_per_rev", "microsteps", "driver", "pins", "forward", "gear", "lead",
        "max_speed", "pull_in", "inductance", "enabled", "sequence", "pulse_high", "amplitude", "period", "cycles",
        "motor", "start", "repeat", "begin", "law.sine", "law.table", "law.formula", "law.winch", "law.sum",
    ]), value in prop::sample::select(vec![
        "1", "-1", "0", "1.5", "inf", "nan", "true", "1979-05-27", "[]", "{}", "[1, 2]", "[{}]", "\"\"", "\"1\"",
        "\"1 rev\"", "\"1e300 rev\"", "\"-1 s\"", "\"1e300 s\"", "\"1e-300 s\"", "\"forever\"", "\"low\"",
        "{ in = [2, 3, 4, 5] }", "{ file = \"good.csv\", unit = \"deg\" }", "9223372036854775807", "\"1e300 rev/s\"",
        "\"\\u00e9\\t rev\"", "'''\n1 rev'''", "[{ rest = \"1 s\" }]", "{ theta = \"t\", unit = \"é\" }",
    ])) {
        for line in GOOD.lines().filter(|line| !line.is_empty()) {
            survive(&GOOD.replacen(line, &format!("{key} = {value}"), 1));
            survive(&GOOD.replacen(line, &format!("{line}\n{key} = {value}"), 1));
        }
    }
}

/// The table has what is said of ramps that cannot catch up. The ramp that it offers is made.
#[test]
fn a_ramp_that_cannot_catch_up_can_stay_behind() {
    let limits = "forward = \"low\"\nmax_speed = \"2 rev/s\"\nmax_acceleration = \"4 rev/s^2\"\n";
    let text = GOOD.replace("forward = \"low\"\n", limits);
    let behind = |motion: &str| read(&text.replace(SINE, motion)).unwrap().motors[0].law.behind();
    assert_eq!(behind("law.speed = { speed = \"2 rev/s\" }\nbegin = \"ramp-behind\"").len(), 1);
    let ends = "law.speed = { speed = \"2 rev/s\", duration = \"3 s\" }\nbegin = \"jump\"\nend = \"ramp-behind\"";
    assert!(behind(ends)[0].ends);
}
