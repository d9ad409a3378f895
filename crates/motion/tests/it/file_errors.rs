//! Wrong motion files: each mistake gets an error that names the place, the limit and the remedy.

use std::io;
use std::path::Path;

use expect_test::{Expect, expect};
use proptest::prelude::*;
use pulsetrain_motion::file::{self, FileError, Problem};
use pulsetrain_motion::law::Cursor;
use pulsetrain_motion::program::{BoardError, Program};
use pulsetrain_motion::{Time, boards, template};

const GOOD: &str = r#"board = "uno"
grid = "reach"
tolerance = "1 tick"

[motor.wheel]
steps_per_rev = 200
microsteps = 4
driver = "DQ542MA"
pins = { step = 8, dir = 9 }
forward = "low"

[[motion]]
motor = "wheel"
law.sine = { amplitude = "2.5 rev", period = "1 s" }
"#;

/// The files that motion files may name here.
fn loader(path: &Path) -> io::Result<String> {
    match path.to_str() {
        Some("good.csv") => Ok("time,angle\n0,0\n1,10\n2,10\n".into()),
        Some("late.csv") => Ok("# one\ntime,angle\n0,0\n2,10\n1,20\n".into()),
        Some("word.csv") => Ok("0,0\n1,ten\n".into()),
        Some("short.csv") => Ok("0,0\n".into()),
        Some("thin.csv") => Ok("0\n1\n".into()),
        Some("semicolon.csv") => Ok("time;angle\n0;0\n1;ten\n".into()),
        Some("swapped.csv") => Ok("a,t\n0,0\n10,1\n0,2\n".into()),
        Some("counted.csv") => Ok("i,t,a\n0,0,0\n1,0.5,10\n2,1,20\n".into()),
        Some("frames.csv") => Ok("frame,angle\n0,0\n1,10\n".into()),
        Some("ms.csv") => Ok("Time [ms],angle [deg]\n0,0\n500,10\n".into()),
        Some("gon.csv") => Ok("t,angle [gon]\n0,0\n500,10\n".into()),
        Some("lost.csv") => Ok("t [deg],angle\n0,0\n500,10\n".into()),
        Some("two.csv") => Ok("t,left,right\n0,0,0\n1,10,20\n".into()),
        Some("times.csv") => Ok("t,time,a\n0,0,0\n1,10,20\n".into()),
        Some("bare.csv") => Ok("0,0,0\n1,10,20\n".into()),
        Some("unknown.csv") => Ok("foo,bar\n0,0\n10,1\n10,2\n".into()),
        Some("length.csv") => Ok("t,x [mm]\n0,0\n1,10\n".into()),
        Some("winch.txt") => Ok("# commands\n0 s: a x 100\n1 s: a x far\n".into()),
        _ => Err(io::ErrorKind::NotFound.into()),
    }
}

fn read(text: &str) -> Result<Program, FileError> {
    file::read(text, "x.toml", &loader)
}

/// What is said of the good file with `old` replaced by `new`.
#[track_caller]
fn check(old: &str, new: &str, expected: Expect) {
    assert!(old.is_empty() || GOOD.contains(old), "{old:?} is not in the good file");
    let text = if old.is_empty() { new.to_owned() } else { GOOD.replacen(old, new, 1) };
    let said = match read(&text) {
        Ok(_) => "no problem\n".to_owned(),
        Err(error) => {
            error
                .problems()
                .iter()
                .filter_map(Problem::advice)
                .flat_map(assignments)
                .for_each(|it| check_assignment(it, &text));
            error.plain()
        }
    };
    expected.assert_eq(&said);
}

/// Every `key = value` of some advice, as far as that reads as TOML.
fn assignments(advice: &str) -> Vec<&str> {
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
        .map(|(key, line)| {
            let ends = (0..=line.len()).rev().filter(|end| line.is_char_boundary(*end));
            let longest =
                ends.map(|end| line[..end].trim_end()).find(|part| part.parse::<toml_edit::DocumentMut>().is_ok());
            let found = longest.filter(|part| part.len() > key.len());
            found.unwrap_or_else(|| panic!("this does not parse: {line}"))
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
    assert_eq!(assignments("write tolerance = \"1 tick\", or \"1 us\""), ["tolerance = \"1 tick\""]);
    assert_eq!(
        assignments("add grid = { hysteresis = \"0.1 step\" } there; or gear = 3 if"),
        ["grid = { hysteresis = \"0.1 step\" }", "gear = 3"]
    );
    let refused = |it: &'static str| std::panic::catch_unwind(|| check_assignment(it, GOOD)).is_err();
    assert!(refused("tolerance = \"78 000 ticks\"") && refused("tolerance = 78"));
    assert!(refused("bord = \"uno\"") && !refused("tolerance = \"78000 ticks\""));
    assert!(std::panic::catch_unwind(|| assignments("sum = [{ sine = { … } }]")).is_err());
}

const SINE: &str = r#"law.sine = { amplitude = "2.5 rev", period = "1 s" }"#;

#[test]
fn the_good_file_is_good() {
    check(
        "uno",
        "uno",
        expect![[r#"
        no problem
    "#]],
    );
}

#[test]
fn keys() {
    check(
        "grid",
        "gird",
        expect![[r#"
        x.toml:2:1: unknown key `gird` in the motion file
            did you mean `grid`?
    "#]],
    );
    check(
        "microsteps",
        "micro_steps",
        expect![[r#"
        x.toml:7:1: unknown key `micro_steps` in motor `wheel`
            did you mean `microsteps`?
        x.toml:5:1: motor `wheel` has no `microsteps`, and the DQ542MA cannot make full steps
            the DQ542MA has 2, 4, 5, 8, 10, 16, 20, 25, 32, 40, 50, 64, 100, 125, 128
    "#]],
    );
    check(
        "amplitude",
        "amplitud",
        expect![[r#"
            x.toml:14:14: unknown key `amplitud` in law `sine`
                did you mean `amplitude`?
        "#]],
    );
    check(
        "forward = \"low\"",
        "",
        expect![[r#"
        x.toml:5:1: motor `wheel` has no `forward`
            add, for example: forward = "high" (the level of DIR that is forward; if it turns the wrong way, "low")
    "#]],
    );
    check(
        "[motor.wheel]",
        "[motor]",
        expect![[r#"
            x.toml:6:1: `steps_per_rev` stands in [motor], but a motor needs a name
                write [motor.wheel] above it
        "#]],
    );
    check(
        "",
        "",
        expect![[r#"
            x.toml:1:1: x.toml is empty
                `pulsetrain new NAME` writes a motion file to begin with
        "#]],
    );
    check(
        "board = \"uno\"",
        "board = ",
        expect![[r#"
        x.toml:1:9: not TOML: string values must be quoted, expected literal string
    "#]],
    );
    check(
        "board = \"uno\"",
        "board = \"uno\"\nboard = \"due\"",
        expect![[r#"
        x.toml:2:1: not TOML: duplicate key
    "#]],
    );
}

#[test]
fn units() {
    check(
        "\"2.5 rev\"",
        "2.5",
        expect![[r#"
        x.toml:14:26: `amplitude` is a bare number; it needs a unit
            write, for example: amplitude = "2.5 rev"
    "#]],
    );
    check(
        "\"2.5 rev\"",
        "\"2.5\"",
        expect![[r#"
            x.toml:14:26: `amplitude` is a bare number; it needs a unit
                write, for example: amplitude = "2.5 rev"
        "#]],
    );
    check(
        "\"2.5 rev\"",
        "\"2.5 s\"",
        expect![[r#"
        x.toml:14:26: `amplitude` must be an angle, but this is a time
            write, for example: amplitude = "2.5 rev"
    "#]],
    );
    check(
        "\"2.5 rev\"",
        "\"2.5 rve\"",
        expect![[r#"
            x.toml:14:31: `amplitude`: unknown unit "rve"
                write amplitude = "2.5 rev"
        "#]],
    );
    check(
        "\"2.5 rev\"",
        "\"20 mm\"",
        expect![[r#"
        x.toml:14:26: motor `wheel` turns: it has no `lead` that would make mm of its turns
            add to the motor, for example: lead = "8 mm"; or give an angle
    "#]],
    );
    check(
        "\"2.5 rev\"",
        "\"fast\"",
        expect![[r#"
        x.toml:14:26: `amplitude`: "fast" does not begin with a number
            write, for example: amplitude = "2.5 rev"
    "#]],
    );
    check(
        "\"1 s\"",
        "\"1 Hz\"",
        expect![[r#"
        x.toml:14:46: `period` must be a time, but this is a frequency
            write, for example: period = "1 s"
    "#]],
    );
    check(
        "\"1 s\"",
        "\"-1 s\"",
        expect![[r#"
        x.toml:14:46: `period` must not be negative
    "#]],
    );
    check(
        "\"1 s\"",
        "\"1e12 h\"",
        expect![[r#"
        x.toml:14:46: `period` is more than 2000 years
    "#]],
    );
    check(
        "\"1 s\"",
        "[1, 2]",
        expect![[r#"
        x.toml:14:46: `period` must be a number with its unit, in quotes, but is a list
            write, for example: period = "1 s"
    "#]],
    );
}

#[test]
fn ranges() {
    check(
        "microsteps = 4",
        "microsteps = 4\ninductance = \"5 mH\"\ncurrent = \"6 A\"\nvoltage = \"24 V\"",
        expect![[r#"
        x.toml:9:11: 6 A is too much for the DQ542MA: 4.2 A at most
    "#]],
    );
    check(
        "microsteps = 4",
        "microsteps = 4\ncurrent = \"2 A\"",
        expect![[r#"
        x.toml:5:1: motor `wheel` has no `inductance`
            add, for example: inductance = "50 mH"
        x.toml:5:1: motor `wheel` has no `voltage`
            add, for example: voltage = "12 V"
    "#]],
    );
    check(
        "microsteps = 4",
        "microsteps = 4\nlead = \"8 mm\"\nmax_speed = \"2 s\"",
        expect![[r#"
        x.toml:9:13: `max_speed` must be a speed, but this is a time
            write, for example: max_speed = "5 mm/s"
    "#]],
    );
    check(
        "\"1 tick\"",
        "\"0.5 tick\"",
        expect![[r#"
        x.toml:3:13: `tolerance` must be 0.55 ticks at least: ticks are whole, which costs half of one
            write tolerance = "1 tick"
    "#]],
    );
    check(
        "\"1 tick\"",
        "\"1 rev\"",
        expect![[r#"
        x.toml:3:13: `tolerance` must be a time or a number of ticks, but this is an angle
            write tolerance = "1 tick", or "1 us"
    "#]],
    );
    for (idle, said) in [("0", "0"), ("8.1", "8.1"), ("-1", "-1")] {
        let error = read(&GOOD.replacen("tolerance", &format!("idle = \"{idle} s\"\ntolerance"), 1)).unwrap_err();
        assert_eq!(
            error.plain(),
            format!(
                "x.toml:3:8: `idle` must be from 1 ms to 8 s, but this is {said} s\n    write idle = \"hold\" for motors that are \
                 never switched off\n"
            )
        );
    }
    check(
        "tolerance = \"1 tick\"",
        "idle = \"5 rev\"",
        expect![[r#"
            x.toml:3:8: `idle` must be a time, but this is an angle
                write, for example: idle = "2 s"
        "#]],
    );
    check(
        "\"reach\"",
        "{ hysteresis = \"0.7 step\" }",
        expect![[r#"
        x.toml:2:23: `hysteresis` must be from 0 to 0.5 step
    "#]],
    );
    check(
        "\"reach\"",
        "\"reaches\"",
        expect![[r#"
        x.toml:2:8: `grid` must be one of "nearest", "reach"
            did you mean "reach"?
    "#]],
    );
    check(
        "200",
        "-200",
        expect![[r#"
        x.toml:6:17: `steps_per_rev` is -200: a motor has 20 to 10000 full steps in a revolution
            most motors have 200 (1.8°): steps_per_rev = 200. For one that has fewer, write twice as many and gear = 0.5
    "#]],
    );
    check(
        "microsteps = 4",
        "microsteps = 4\ngear = \"3:1\"",
        expect![[r#"
        x.toml:8:8: `gear` in quotes counts teeth, motor:driven, at least 6 each, but is "3:1"
            write gear = "16:60" for teeth, or gear = 3 if the motor turns three times for one turn
    "#]],
    );
    check(
        "microsteps = 4",
        "microsteps = 4\nlead = \"0 mm\"",
        expect![[r#"
        x.toml:8:8: `lead` must be more than 0
    "#]],
    );
    check(
        "microsteps = 4",
        "microsteps = 4\nmax_speed = \"0 rev/s\"",
        expect![[r#"
        x.toml:8:13: `max_speed` must be more than 0
    "#]],
    );
    check(
        "\"2.5 rev\"",
        "\"0 rev\"",
        expect![[r#"
        x.toml:14:12: law `sine`: amplitude is 0 steps: out of range
    "#]],
    );
}

#[test]
fn tables() {
    check(
        "\"uno\"",
        "\"nano\"",
        expect![[r#"
            x.toml:1:9: unknown board "nano"
                known: uno, due, pico, native
        "#]],
    );
    check(
        "\"uno\"",
        "\"uno-stream\"",
        expect![[r#"
        x.toml:1:9: unknown board "uno-stream"
            write `board = "uno"`: its firmware has these rates now
    "#]],
    );
    check(
        "\"uno\"",
        "\"unu\"",
        expect![[r#"
        x.toml:1:9: unknown board "unu"
            did you mean "uno"?
    "#]],
    );
    check(
        "DQ542MA",
        "DQ524MA",
        expect![[r#"
            x.toml:8:10: unknown driver "DQ524MA"
                did you mean "DQ542MA"?
        "#]],
    );
    check(
        "DQ542MA",
        "A4899",
        expect![[r#"
        x.toml:8:10: unknown driver "A4899"
            did you mean "A4988"?
    "#]],
    );
    check(
        "microsteps = 4",
        "microsteps = 3",
        expect![[r#"
        x.toml:7:14: the DQ542MA cannot make 3 microsteps
            the DQ542MA has 2, 4, 5, 8, 10, 16, 20, 25, 32, 40, 50, 64, 100, 125, 128
    "#]],
    );
    check(
        "microsteps = 4",
        "",
        expect![[r#"
        x.toml:5:1: motor `wheel` has no `microsteps`, and the DQ542MA cannot make full steps
            the DQ542MA has 2, 4, 5, 8, 10, 16, 20, 25, 32, 40, 50, 64, 100, 125, 128
    "#]],
    );
    check(
        "driver = \"DQ542MA\"",
        "",
        expect![[r#"
        x.toml:5:1: motor `wheel` says neither its driver nor how long its pulses must be
            add, for example: driver = "A4988"; or pulse_high = "2 us" (and pulse_low, dir_setup, dir_hold)
    "#]],
    );
    check(
        "driver = \"DQ542MA\"",
        "driver = \"ULN2003\"",
        expect![[r#"
            x.toml:7:14: the ULN2003 cannot make 4 microsteps
                the ULN2003 has 1, 2
            x.toml:9:8: the ULN2003 has four coil lines, not STEP and DIR
                write, for example: pins = { in = [2, 3, 4, 5] }
        "#]],
    );
}

#[test]
fn pins() {
    check(
        "step = 8",
        "step = 9",
        expect![[r#"
        x.toml:9:26: pin 9 is used twice
            only DIR lines may be shared, and ENABLE lines of one level
    "#]],
    );
    check(
        "step = 8",
        "step = 1",
        expect![[r#"
        x.toml:9:17: pin 1 of the board `uno` is taken: D0 and D1 are the serial line to the computer
    "#]],
    );
    check(
        "step = 8",
        "step = 20",
        expect![[r#"
        x.toml:9:17: the board `uno` has no pin 20: its pins are 0 to 19
    "#]],
    );
    check(
        "microsteps = 4\ndriver = \"DQ542MA\"\npins = { step = 8, dir = 9 }\nforward = \"low\"",
        "microsteps = 2\ndriver = \"ULN2003\"\npins = { in = [2, 3, 4, 5] }\nsequence = \"wave\"",
        expect![[r#"
            x.toml:10:1: half steps have one sequence alone; `sequence` is for full steps
                leave it out, or write: microsteps = 1
        "#]],
    );
    check(
        "step = 8",
        "in = [2, 3, 4]",
        expect![[r#"
            x.toml:9:26: a motor on four coil lines has no `dir` pin
            x.toml:10:1: four coil lines have no `forward`
                leave it out; to turn the other way, write the pins in the other order, or for a Pico wire them so
            x.toml:9:15: the DQ542MA takes STEP and DIR, not coil lines
                write, for example: pins = { step = 8, dir = 9 }
        "#]],
    );
    check(
        "dir = 9 }",
        "dir = 9 }\nenabled = \"low\"\nsequence = \"wave\"",
        expect![[r#"
        x.toml:11:1: STEP and DIR lines have no `sequence`
            leave it out
        x.toml:10:1: without an `enable` pin there is no `enabled`
            add to the pins: enable = 7
    "#]],
    );
    check(
        "step = 8, ",
        "",
        expect![[r#"
            x.toml:9:8: the pin table of motor `wheel` has no `step`
                add, for example: pins = { step = 8, dir = 9 }
        "#]],
    );
    let second = r#"
[motor.other]
steps_per_rev = 200
pulse_high = "2 us"
pins = { step = 8, dir = 9 }
forward = "low"
[[motion]]
motor = "other"
law.rest = "1 s"
"#;
    check(
        "forward = \"low\"\n",
        &format!("forward = \"low\"\n{second}"),
        expect![[r#"
        x.toml:15:17: pin 8 is used twice
            only DIR lines may be shared, and ENABLE lines of one level
    "#]],
    );
}

#[test]
fn motors_and_motions() {
    check(
        "motor = \"wheel\"",
        "motor = \"weel\"",
        expect![[r#"
            x.toml:13:9: unknown motor "weel"
                did you mean "wheel"?
        "#]],
    );
    check(
        "motor = \"wheel\"",
        "motors = [\"wheel\", \"wheel\"]",
        expect![[r#"
            x.toml:13:20: the motion names motor "wheel" twice
        "#]],
    );
    check(
        "motor = \"wheel\"",
        "motor = \"wheel\"\nmotors = []",
        expect![[r#"
            x.toml:14:10: a motion has either `motor` or `motors`
                leave one of them out
        "#]],
    );
    check(
        "motor = \"wheel\"",
        "motors = []",
        expect![[r#"
            x.toml:13:1: the motion has no motors
        "#]],
    );
    check(
        "[[motion]]",
        "[motor.lazy]\nsteps_per_rev = 200\npulse_high = \"1 us\"\npins = { step = 2, dir = 3 }\nforward = \"low\"\n[[motion]]",
        expect![[r#"
        x.toml:12:1: motor `lazy` has no motion
            add [[motion]] with motor = "lazy", or take the motor out
    "#]],
    );
    let then = |first: &str, start: &str| {
        format!("law.{first}\n\n[[motion]]\nmotor = \"wheel\"\nstart = \"{start}\"\nlaw.rest = \"1 s\"")
    };
    check(
        SINE,
        &then("rest = \"3 s\"", "2 s"),
        expect![[r#"
        x.toml:18:9: the motor's motion before this one ends later, at 3 s
            motions of one motor follow one another
    "#]],
    );
    check(
        SINE,
        &then("speed = { speed = \"1 rev/s\" }", "2 s"),
        expect![[r#"
        x.toml:16:1: the motor's motion before this one never ends
            give the motion before a duration, cycles or repeat that ends; or use law.sum for both at once
    "#]],
    );
    check(
        SINE,
        &format!("{SINE}\nrepeat = 0"),
        expect![[r#"
            x.toml:15:10: `repeat` must be at least 1, but is 0
        "#]],
    );
    check(
        SINE,
        &format!("{SINE}\nbegin = \"ramp\""),
        expect![[r#"
        x.toml:15:9: a ramp needs limits, but motor `wheel` has not both
            give the motor max_speed and max_acceleration
    "#]],
    );
    check(
        SINE,
        &format!("{SINE}\nend = \"delay\""),
        expect![[r#"
            x.toml:15:7: `end` must be one of "ramp", "ramp-behind", "jump"
        "#]],
    );
}

#[test]
fn laws() {
    check(
        SINE,
        "law.sin = {}",
        expect![[r#"
        x.toml:14:5: unknown law `sin`
            did you mean `sine`?
    "#]],
    );
    check(
        SINE,
        "law = {}",
        expect![[r#"
            x.toml:14:7: a motion has exactly one law
                for several at once use `sum`, for one after the other `then`; known: sine, formula, table, speed, trapezoid, s_curve, sweep, ramp, winch, rest, sum, then, scale, shift, delay, repeat
        "#]],
    );
    check(
        SINE,
        "law.sine = { amplitude = \"1 rev\", period = \"1 s\" }\nlaw.rest = \"1 s\"",
        expect![[r#"
            x.toml:14:5: a motion has exactly one law
                for several at once use `sum`, for one after the other `then`; known: sine, formula, table, speed, trapezoid, s_curve, sweep, ramp, winch, rest, sum, then, scale, shift, delay, repeat
        "#]],
    );
    check(
        SINE,
        "law.trapezoid = { distance = \"1 rev\", acceleration = \"1 rev/s^2\" }",
        expect![[r#"
        x.toml:14:17: law `trapezoid` has no `speed`
            add, for example: speed = "2 rev/s"
    "#]],
    );
    check(
        SINE,
        "law.sweep = { frequency = \"1 Hz\", swing = \"0.1234 rev\" }",
        expect![[r#"
        x.toml:14:43: `swing` must be whole steps, but comes to 98.72
    "#]],
    );
    check(
        SINE,
        "law.sum = []",
        expect![[r#"
            x.toml:14:11: `sum` has no laws in it
                sum = [{ sine = { amplitude = "1 rev", period = "1 s" } }, { speed = { speed = "2 rev/s", duration = "1 s" } }]
        "#]],
    );
    check(
        SINE,
        "law.then = [{ rest = \"1 s\" }, { rest = \"0 s\" }]",
        expect![[r#"
        x.toml:14:40: `rest` must be more than 0 s
    "#]],
    );
    check(
        SINE,
        "law.scale = { by = \"2\", law = { rest = \"1 s\" } }",
        expect![[r#"
        x.toml:14:20: `by` must be a number, but is a text
            write, for example: by = 0.5
    "#]],
    );
    check(
        SINE,
        "law.winch = { axis = \"x\", commands = [\"0 s: a x ten\"] }",
        expect![[r#"
        x.toml:14:49: not a whole number of 32 bits
    "#]],
    );
    check(
        SINE,
        "law.winch = { axis = \"x\", commands = [\"1 s: a x 1\", \"0 s: a x 2\"] }",
        expect![[r#"
        x.toml:14:54: commands must stand in order of their times
    "#]],
    );
    check(
        SINE,
        "law.winch = { axis = \"x\", file = \"winch.txt\" }",
        expect![[r#"
        winch.txt:3:10: not a whole number of 32 bits
    "#]],
    );
    check(
        SINE,
        "law.winch = { axis = \"x\", commands = [\"0 s: g xyza 2 1\", \"0 s: s y 9\", \"1 s: d xy 1 2\", \"2 s: a yz 3 4\"] }",
        expect![[r#"
            x.toml:14:81: a line moves axis y, but no motor with these lines is that axis: add one, or take the axis out
            x.toml:14:98: a line moves axis z, but no motor with these lines is that axis: add one, or take the axis out
        "#]],
    );
    // A motor that is the axis has to hear of it.
    let two = |second: &str| {
        let motor = "[motor.y]\nsteps_per_rev = 200\nmicrosteps = 4\ndriver = \"DQ542MA\"\npins = { step = 10, dir = 7 }\nforward = \"low\"";
        format!(
            "law.winch = {{ axis = \"x\", duration = \"1 s\", commands = [\"0 s: a xy 1 2\"] }}\n{motor}\n\
             [[motion]]\nmotor = \"y\"\nlaw.winch = {{ duration = \"1 s\", commands = [\"{second}\"] }}"
        )
    };
    check(
        SINE,
        &two("0 s: a y 2"),
        expect![[r#"
            x.toml:14:66: a line moves axis y, but no motor with these lines is that axis: add one, or take the axis out
        "#]],
    );
    check(SINE, &two("0 s: a xy 1 2"), expect!["no problem\n"]);
    check(
        SINE,
        "law.winch = { commands = [\"0 s: a x 1\"] }",
        expect![[r#"
        x.toml:14:13: law `winch` has no `axis`
            add, for example: axis = "x" (or name the motor x, y, z or a)
    "#]],
    );
}

#[test]
fn formulas() {
    let formula = |theta: &str, rest: &str| {
        format!("law.formula = {{ theta = {theta}, unit = \"rev\", duration = \"1 s\"{rest} }}")
    };
    check(
        SINE,
        &formula("\"sin(2*pi*t\"", ""),
        expect![[r#"
            x.toml:14:29: formula: this bracket is never closed
        "#]],
    );
    check(
        SINE,
        &formula("\"3*frequncy*t\"", ""),
        expect![[r#"
            x.toml:14:28: formula: `frequncy` is unknown: the time is `t`, other names must be parameters
                give it a value: where = { frequncy = 2 }
        "#]],
    );
    check(
        SINE,
        &formula("'''\n2*t\n + frequncy*t'''", ""),
        expect![[r#"
            x.toml:16:4: formula: `frequncy` is unknown: the time is `t`, other names must be parameters
                give it a value: where = { frequncy = 2 }
        "#]],
    );
    check(
        SINE,
        &formula("\"3*Frequncy*t\"", ", where = { a = 3, frequency = \"1 Hz\" }"),
        expect![[r#"
        x.toml:14:28: formula: `Frequncy` is unknown; did you mean `frequency`?
            parameters here: `a`, `frequency`
    "#]],
    );
    check(
        SINE,
        &formula("\"Sin(t)\"", ""),
        expect![[r#"
            x.toml:14:26: formula: `Sin` is unknown; did you mean `sin`?
                all functions: docs/formulas.md, or `pulsetrain formula --list`
        "#]],
    );
    check(
        SINE,
        &formula("\"PI*t\"", ""),
        expect![[r#"
            no problem
        "#]],
    );
    check(
        SINE,
        &formula("\"π*t\"", ""),
        expect![[r#"
            no problem
        "#]],
    );
    check(
        SINE,
        &formula("\"2pi*t\"", ""),
        expect![[r#"
        x.toml:14:27: formula: a `*` is missing here: write `2*pi`
    "#]],
    );
    check(
        SINE,
        &formula("\"30sin(2*pi*t)\"", ""),
        expect![[r#"
        x.toml:14:28: formula: a `*` is missing here: write `30*sin(…)`
    "#]],
    );
    check(
        SINE,
        &formula("\"sin(2π*t)\"", ""),
        expect![[r#"
        x.toml:14:31: formula: a `*` is missing here: write `2*pi`
    "#]],
    );
    check(
        SINE,
        &formula("\"2*(t+1)(t+2)\"", ""),
        expect![[r#"
        x.toml:14:33: formula: a `*` is missing here: write `(t+1)*(…)`
    "#]],
    );
    check(
        SINE,
        &formula("\"clamp(t^2 t, 0, 1)\"", ""),
        expect![[r#"
        x.toml:14:36: formula: a `*` is missing here: write `t^2*t`
    "#]],
    );
    check(
        SINE,
        &formula("\"sin(2*pi*0,5*t)\"", ""),
        expect![[r#"
            x.toml:14:26: formula: `sin` takes 1 argument; here are 2
                decimals are written with a point: 0.5
        "#]],
    );
    check(
        SINE,
        &formula("\"(0,5)*t\"", ""),
        expect![[r#"
        x.toml:14:28: formula: an operator or `)` is expected here
            decimals are written with a point: 0.5
    "#]],
    );
    check(
        SINE,
        &formula("\"0,5*t\"", ""),
        expect![[r#"
        x.toml:14:27: formula: an operator or the end is expected here
            decimals are written with a point: 0.5
    "#]],
    );
    check(
        SINE,
        &formula("\"(1 2)*t\"", ""),
        expect![[r#"
        x.toml:14:29: formula: an operator or `)` is expected here
    "#]],
    );
    for name in ["pi", "t", "sin", "if", "and"] {
        let text = GOOD.replace(SINE, &formula("\"2*t\"", &format!(", where = {{ a = 1, {name} = 3 }}")));
        let error = read(&text).unwrap_err().plain();
        let at = text.lines().nth(13).unwrap().find(&format!("{name} = 3")).unwrap() + 1;
        let begins = format!("x.toml:14:{at}: `{name}` is ");
        assert!(error.starts_with(&begins) && error.contains("no parameter can have this name"), "{error}");
        // The other name that is offered works.
        let offered = error.split('`').nth(3).unwrap();
        read(&text.replace(&format!("{name} = 3"), &format!("{offered} = 3"))).unwrap();
    }
    check(
        SINE,
        &formula("\"a*t\"", ", where = { a = \"5 V\" }"),
        expect![[r#"
        x.toml:14:78: a formula has no use for a voltage
            parameters are numbers, positions, speeds, times or frequencies
    "#]],
    );
    check(
        SINE,
        &formula("\"t\"", "").replace("\"rev\"", "\"s\""),
        expect![[r#"
        x.toml:14:37: `unit` must be a unit of position, but is "s"
            one of: rev, deg, rad, mm, step, full-step
    "#]],
    );
}

/// A bracket or quote is shown where it was opened, not where reading ended.
#[test]
fn what_is_never_closed_is_shown_where_it_was_opened() {
    let formula = "law.formula = { theta = \"90*sin(t)\", unit = \"deg\", duration = \"10 s\", where = { a = 3 } }";
    let good = GOOD.replace(SINE, formula);
    assert!(read(&good).is_ok());
    for (old, new, place, message) in [
        ("dir = 9 }", "dir = 9", "{ step", "this `{` is never closed"),
        ("a = 3 } }", "a = 3 }", "{ theta", "this `{` is never closed"),
        ("a = 3 } }", "a = 3", "{ a = 3", "this `{` is never closed"),
        ("a = 3 } }\n", "a = 3 }", "{ theta", "this `{` is never closed"),
        ("dir = 9 }", "dir = [9 }", "[9", "this `[` is never closed"),
        ("\"low\"", "\"low", "\"low", "this quote is never closed"),
        ("\"10 s\"", "\"10 s", "\"10 s", "this quote is never closed"),
        ("\"90*sin(t)\"", "\"90*sin(t)", "\"90*sin(t)", "this quote is never closed"),
        ("\"90*sin(t)\"", "'90*sin(t)", "'90*sin(t)", "this quote is never closed"),
        ("\"10 s\"", "10 s", "10 s", "a quantity with its unit stands in quotes; write duration = \"10 s\""),
        ("\"1 tick\"", "1 tick", "1 tick", "a quantity with its unit stands in quotes; write tolerance = \"1 tick\""),
        ("90*sin(t)", "90*sin(t", "(t", "this bracket is never closed"),
        ("90*sin(t)", "90*sin(t + cos(t)", "(t + cos", "this bracket is never closed"),
    ] {
        assert!(good.contains(old), "{old}");
        let text = good.replacen(old, new, 1);
        let error = read(&text).unwrap_err();
        let [problem] = error.problems() else { panic!("{new}: {}", error.plain()) };
        let (span, _) = problem.labels().next().unwrap();
        let told = format!("{}; {}", problem.message(), problem.advice().unwrap_or_default());
        assert!(text[span.start..].starts_with(place), "{new}: at {:?}: {told}", &text[span]);
        assert!(told.contains(message), "{new}: {told}");
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

/// Units that others write: what the error says to write, which is then read.
#[test]
fn units_of_others_are_refused_with_what_to_write() {
    let speed = "law.speed = { speed = \"VALUE\", duration = \"1 s\" }";
    let acceleration = "law.trapezoid = { distance = \"5 rev\", speed = \"2 rev/s\", acceleration = \"VALUE\" }";
    let sine = "law.sine = { amplitude = \"VALUE\", period = \"1 s\" }";
    let rest = "law.rest = \"VALUE\"";
    let frequency = "law.sine = { amplitude = \"1 rev\", frequency = \"VALUE\" }";
    for (law, wrong, right) in [
        (acceleration, "10 rpm/s", "0.166667 rev/s^2"),
        (acceleration, "10 rev/s/s", "10 rev/s^2"),
        (acceleration, "10 rev/s2", "10 rev/s^2"),
        (frequency, "500 mhz", "500 mHz"),
        (frequency, "30 rpm", "0.5 Hz"),
        (frequency, "2 Hertz", "2 Hz"),
        (sine, "90 degrees", "90 deg"),
        (sine, "90 DEG", "90 deg"),
        (sine, "2 radians", "2 rad"),
        (sine, "0,5 rev", "0.5 rev"),
        (sine, "½ rev", ""),
        (sine, "1/2 rev", "0.5 rev"),
        (rest, "10 seconds", "10 s"),
        (rest, "2 hours", "2 h"),
        (rest, "2 H", "2 h"),
        (rest, "5 minutes", "5 min"),
        (rest, "5 m", "5 min\", or \"5 ms"),
        (rest, "0,5 s", "0.5 s"),
        (rest, "10 S", "10 s"),
        (speed, "4 k steps/s", "4000 step/s"),
        (speed, "30 RPM", "30 rpm"),
        (speed, "1,000 step/s", "1000 step/s\" or \"1.000 step/s"),
        (speed, "2", "2 rev/s"),
    ] {
        let with = |value: &str| {
            GOOD.replace(SINE, &law.replace("VALUE", value)).replacen("forward", "pull_in = \"9 rev/s\"\nforward", 1)
        };
        let error = read(&with(wrong)).unwrap_err();
        let [problem] = error.problems() else { panic!("{wrong}: {}", error.plain()) };
        let told = problem.advice().unwrap_or_default();
        assert!(told.contains(&format!("\"{right}")), "{wrong}: {told}");
        for one in right.split(['"', ',']).filter(|one| one.starts_with(|c: char| c.is_ascii_digit())) {
            assert!(read(&with(one)).is_ok(), "{wrong} as {one}");
        }
    }
    for (law, accepted) in [
        (frequency, "500 mHz"),
        (sine, "2 turns"),
        (sine, "2 revs"),
        (sine, "90°"),
        (sine, "−90 deg"),
        (speed, "60 rev/min"),
        (rest, "10 us"),
        (rest, "10 µs"),
        (rest, "10 μs"),
    ] {
        let text = GOOD.replace(SINE, &law.replace("VALUE", accepted)).replacen(
            "forward",
            "pull_in = \"9 rev/s\"\nforward",
            1,
        );
        assert!(read(&text).is_ok(), "{accepted}: {}", read(&text).unwrap_err().plain());
    }
}

/// Phases are times, angles or parts of a turn, in the same places.
#[test]
fn phases_may_be_angles() {
    let sweep = |phase: &str| {
        let law = format!("law.sweep = {{ frequency = \"0.5 Hz\", swing = \"200 step\", phase = \"{phase}\" }}");
        read(&GOOD.replace(SINE, &law)).map(|mut program| program.motors.remove(0).law)
    };
    let at = |phase: &str, t: f64| {
        let law = sweep(phase).unwrap_or_else(|error| panic!("{}", error.plain()));
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
    for (wrong, right) in
        [("2 mm", "90 deg"), ("2 Hz", "90 deg"), ("0.25", "\"0.25 turn\""), ("-1 s", "must not be negative")]
    {
        let told = sweep(wrong).unwrap_err().plain();
        assert!(told.contains(right), "{wrong}: {told}");
    }
}

#[test]
fn hundreds_of_problems_are_the_limit_and_five() {
    let motors: String = (0..500)
        .map(|k| format!("[motor.m{k}]\nsteps_per_rev = 200\ndriver = \"A9999\"\npins = {{ step = 8, dir = 9 }}\nforward = \"high\"\n"))
        .collect();
    let error =
        read(&format!("board = \"uno\"\n{motors}[[motion]]\nmotor = \"m0\"\nlaw.rest = \"1 s\"\n")).unwrap_err();
    let told = error.plain();
    assert!(told.starts_with("x.toml:1:9: the board `uno` drives 4 motors at most, but the file has 500\n"), "{told}");
    assert_eq!(told.matches("unknown driver").count(), 5, "{told}");
    assert!(told.ends_with("\nand 495 more\n"), "{told}");
    assert_eq!(error.problems().len(), 501);
}

#[test]
fn an_empty_file_says_how_to_begin() {
    for text in ["", "\n\n", "# a comment\n", "\u{feff}"] {
        let error = read(text).unwrap_err().plain();
        assert_eq!(
            error,
            "x.toml:1:1: x.toml is empty\n    `pulsetrain new NAME` writes a motion file to begin with\n"
        );
    }
}

/// What is said of formulas, one after the other, each with the text that it points at.
fn of_formulas(cases: &[(&str, &str, &str, &str)]) -> String {
    let mut all = String::new();
    for (motor, unit, theta, parameters) in cases {
        let law = format!(
            "law.formula = {{ theta = \"{theta}\", unit = \"{unit}\", duration = \"1 s\", where = {{ {parameters} }} }}"
        );
        let text = GOOD.replacen(SINE, &law, 1).replacen("forward", &format!("{motor}\nforward"), 1);
        all += format!("{theta}   in {unit}; {parameters}").trim_end_matches("; ");
        all += "\n";
        match read(&text) {
            Ok(_) => all += "    no problem\n",
            Err(error) => {
                for problem in error.problems() {
                    let (span, _) = problem.labels().next().unwrap();
                    let place = &text[span];
                    all += &format!("    at {place}: {}\n    {}\n", problem.message(), problem.advice().unwrap_or("–"));
                }
            }
        }
    }
    all
}

#[test]
fn dimensions_of_formulas() {
    const LEAD: &str = "lead = \"8 mm\"";
    const ANGLE: &str = "phi = \"90 deg\"";
    const BOTH: &str = "phi = \"90 deg\", x = \"5 mm\"";
    // Sums, comparisons and choices of what does not go together.
    let mixed = [
        ("", "deg", "phi + t*x", BOTH),
        (LEAD, "mm", "10*t - 2*x - phi", BOTH),
        ("", "deg", "if(phi < x, 1, 2)*t", BOTH),
        ("", "deg", "piecewise(t < 1, phi, t < 2, 5, x)*t", BOTH),
        ("", "deg", "max(phi, x)", BOTH),
        ("", "deg", "clamp(t, phi, x)", BOTH),
        ("", "deg", "hypot(x, phi)", BOTH),
        ("", "deg", "atan2(x, phi)", BOTH),
        ("", "deg", "mod(phi, x)", BOTH),
        ("", "deg", "phi + phi^2", BOTH),
        (LEAD, "step", "phi*t + x", BOTH),
        ("", "deg", "phi + 0*t - 0", BOTH),
    ];
    // Results that do not fit the unit.
    let misfits = [
        (LEAD, "mm", "phi*sin(2*pi*t)", ANGLE),
        ("", "deg", "x*sin(2*pi*t)", BOTH),
        ("", "deg", "phi*phi*t", ANGLE),
        ("", "deg", "t/phi", ANGLE),
        ("", "deg", "sqrt(phi)*t*x", BOTH),
        ("", "deg", "2*phi/pi*asin(sin(t))", ANGLE),
        (LEAD, "mm", "x*phi*t", BOTH),
    ];
    // Arguments.
    let arguments = [
        ("", "deg", "90*sin(x)", BOTH),
        ("", "deg", "90*cos(2*phi^2)", ANGLE),
        (LEAD, "step", "90*tan(a)", "a = \"3 step\""),
        ("", "deg", "90*exp(-phi)", ANGLE),
        ("", "deg", "2^phi", ANGLE),
        ("", "deg", "phi^t", ANGLE),
        ("", "deg", "asin(phi)", ANGLE),
        ("", "deg", "90*exp(-atan(t))", ""),
        ("", "deg", "90*sin(floor(phi*t))", ANGLE),
        ("", "deg", "90*sin(x/x + sign(phi)*ln(phi/phi*2))", BOTH),
    ];
    // Numbers without a unit where the place has none.
    let bare = [
        ("", "deg", "if(x > 3, 1, 2)*t", BOTH),
        (LEAD, "mm", "if(phi > 90, 1, 2)*t", BOTH),
        (LEAD, "mm", "x*sin(phi + 3)", BOTH),
        ("", "deg", "phi + pi/2*t", ANGLE),
        ("", "deg", "phi*t + max(pi/2, 0)*t", ANGLE),
        ("", "deg", "phi*t + (pi/2*t + 0.1*t)", ANGLE),
        ("", "deg", "phi*t + abs(-pi)*mod(t, 1)", ANGLE),
        ("", "deg", "phi*t + 180/pi*max(pi/2, 0)*t", ANGLE),
        (LEAD, "mm", "x*(phi + pi/2 + asin(0.5))*t", BOTH),
        (LEAD, "mm", "x*(phi + 180/pi*0.5*t)", BOTH),
        (LEAD, "mm", "x*(phi + (180/pi)*asin(0.5)*t)", BOTH),
        (LEAD, "mm", "x*(phi + (pi + 180/pi*t))", BOTH),
    ];
    // Conversions by hand.
    let by_hand = [
        ("", "deg", "180/pi*asin(t)", ""),
        ("", "deg", "57.3*asin(t) + 5", ""),
        ("", "rev", "asin(t)/(2*pi)", ""),
        ("", "rev", "atan2(t, 1)*0.1592", ""),
        ("", "step", "asin(t)*800/2/pi", ""),
        ("", "deg", "90*2/pi*asin(sin(t))", ""),
        ("", "deg", "90*sin(2*pi*f*t)", "f = \"0.5 rev/s\""),
        ("", "deg", "90*sin(6.28*f*t - 1)", "f = \"30 rpm\""),
        ("", "deg", "90*sin(2*pi*n/60*t)", "n = \"30 rpm\""),
        ("", "deg", "90*cos(phi*pi/180)", ANGLE),
        ("", "deg", "w*180/pi*t", "w = \"1 rad/s\""),
        ("", "deg", "360*f*t", "f = \"0.5 rev/s\""),
        ("", "rad", "2*pi*f*t", "f = \"0.5 rev/s\""),
        (LEAD, "mm", "2*pi*r*f*t", "r = \"20 mm\", f = \"0.5 rev/s\""),
        ("", "rad", "2*pi*n/60*t", "n = \"30 rpm\""),
        ("", "rev", "phi/360*t", ANGLE),
        ("", "deg", "phi*360", ANGLE),
        ("", "rev", "w*t/(2*pi)", "w = \"1 rad/s\""),
        ("", "deg", "2*pi*n*t", "n = \"30 rpm\""),
        ("", "deg", "20*sin(2*pi*(t/2 - phi))", "phi = \"90 deg\""),
        ("", "rev", "0.159*w*(t - 1)", "w = \"1 rad/s\""),
        ("", "deg", "abs(57.3*asin(t))", ""),
        ("", "deg", "v/(2*pi)*sin(2*pi*t) + v/(2*pi*f)*t*sin(2*pi*f*t)", "v = \"90 deg/s\", f = \"1 Hz\""),
        ("", "deg", "90*sin(pi/4*w*t)", "w = \"1 rad/s\""),
        (LEAD, "mm", "pi/2*r*phi*t", "r = \"20 mm\", phi = \"90 deg\""),
        ("", "deg", "90*sin(2*pi*f*t - phi) + 2*pi*f*phi*t", "f = \"0.5 Hz\", phi = \"3 deg\""),
    ];
    const N: &str = "n = \"30 rpm\"";
    const TURNS: &str = "n = \"0.5 rev/s\"";
    const RADIUS: &str = "r = \"20 mm\", n = \"0.5 rev/s\"";
    // The same in other words: in parts, among other factors, rounded, in another unit of time or length.
    let disguised = [
        ("", "deg", "n*360/60*t", N),
        ("", "deg", "20*sin(n/60*360*t)", N),
        ("", "deg", "20*sin(n/60*2*pi*t)", N),
        ("", "deg", "n/60*t", N),
        ("", "rev", "3*t*n/60", N),
        ("", "rev", "w*t/3600", "w = \"15 deg/h\""),
        (LEAD, "mm", "v/60*t", "v = \"600 mm/min\""),
        ("", "deg", "20*sin(0.1047*n*t)", N),
        ("", "deg", "20*sin(3*2*pi*n*t)", TURNS),
        ("", "deg", "20*sin(pi*n*t)^2", TURNS),
        ("", "deg", "4*pi*n*t", TURNS),
        (LEAD, "mm", "pi*2*r*n*t", RADIUS),
        (LEAD, "mm", "pi*d*n*t", "d = \"40 mm\", n = \"0.5 rev/s\""),
        ("", "deg", "3*57.3*w*t", "w = \"1 rad/s\""),
        ("", "deg", "20*sin(3.1416/180*phi*t)", ANGLE),
        ("", "deg", "20*sin(k*phi*t)", "phi = \"90 deg\", k = 0.0174533"),
        ("", "step", "800*n*t", TURNS),
        ("", "step", "w*t*800/(2*pi)", "w = \"1 rad/s\""),
        ("", "step", "phi*800/360*t", ANGLE),
        (LEAD, "mm", "25.4*x*t", "x = \"2 in\""),
        (LEAD, "step", "100*x*t", "x = \"2 mm\""),
        ("", "deg", "20*exp(-t*1000/T)", "T = \"500 ms\""),
        ("", "deg", "20*t/(T/1000)", "T = \"500 ms\""),
        ("", "deg", "20*sin(2*pi*t/(60*T))", "T = \"2 min\""),
        ("", "deg", "20*sin(2*pi*1000*f*t)", "f = \"0.002 kHz\""),
        ("", "deg", "if(t < T/1000, 0, t - 1/2)", "T = \"500 ms\""),
        ("", "rad", "180/pi*asin(t)", ""),
        ("", "deg", "20*sin(180/pi*asin(t))", ""),
        ("", "deg", "phi + 3.1416*t", ANGLE),
        (LEAD, "mm", "x*(phi + (pi + (180/pi)*asin(t)))", BOTH),
        (LEAD, "mm", "x*(phi + 57.3*asin(t))", BOTH),
        ("", "deg", "phi*p", "phi = \"90 deg\", p = \"40 %\""),
        ("", "deg", "n/0.16667*t", N),
        ("", "step", "4*s*t", "s = \"25 full-step\""),
        ("", "deg", "20*sin(360*f*t + 90)", "f = \"0.5 Hz\""),
        (LEAD, "mm", "screw*n*t", "screw = \"8 mm\", n = \"0.5 rev/s\""),
        ("", "deg", "v/r*t", "v = \"50 mm/s\", r = \"20 mm\""),
        ("", "deg", "phi + v/(2*r)*t", "v = \"50 mm/s\", r = \"20 mm\", phi = \"90 deg\""),
        ("", "rev", "v/w*sin(w*t)", "v = \"90 deg/s\", w = \"1 rad/s\""),
    ];
    // What looks like one, and is none.
    let gears = [
        ("", "deg", "6*n*t", N),
        ("", "deg", "n*12/2*t", N),
        ("", "rev", "n/gear*t", "n = \"1 rpm\", gear = 60"),
        ("", "deg", "phi*t/T", "phi = \"1 rev\", T = \"360 s\""),
        ("", "step", "1000*t/T", "T = \"500 ms\""),
        ("", "rev", "60*t/T", "T = \"2 min\""),
        ("", "deg", "360*t/T", "T = \"2 min\""),
        ("", "deg", "20*sin(2*pi*60*t/T)", "T = \"2 min\""),
        ("", "deg", "360*phi/rev*t", "phi = \"90 deg\", rev = \"1 rev\""),
        ("", "rev", "phi/deg/360*t", "phi = \"90 deg\", deg = \"1 deg\""),
        ("", "deg", "20*exp(-t*1000/(T/ms))", "T = \"500 ms\", ms = \"1 ms\""),
        ("", "deg", "20*sin(2*pi*f*t - phi)", "f = \"0.5 Hz\", phi = \"0.25 rev\""),
        ("", "deg", "v/(2*pi*f)*sin(2*pi*f*t)", "f = \"0.5 Hz\", v = \"1 rad/s\""),
        (LEAD, "mm", "x*(180/pi*asin(t)/90)", BOTH),
        (LEAD, "mm", "10*x*t", "x = \"2 cm\""),
        (LEAD, "mm", "r*n*t", RADIUS),
        (LEAD, "mm", "x*(phi + (pi + asin(t)))", BOTH),
        (LEAD, "mm", "screw*n/turn*t", "screw = \"8 mm\", n = \"0.5 rev/s\", turn = \"1 rev\""),
        (LEAD, "mm", "v/w*sin(w*t)", "v = \"50 mm/s\", w = \"10 rad/s\""),
        ("", "deg", "v/r*rad*t", "v = \"50 mm/s\", r = \"20 mm\", rad = \"1 rad\""),
        ("", "deg", "40*x/r*t", "x = \"5 mm\", r = \"20 mm\""),
        ("", "deg", "phi/deg*t", "phi = \"90 deg\", deg = \"1 deg\""),
        ("", "rev", "v/c*t", "v = \"50 mm/s\", c = \"125 mm\""),
        ("", "rad", "v/r*t", "v = \"50 mm/s\", r = \"20 mm\""),
        ("", "deg", "20*sin(v/r*t)", "v = \"50 mm/s\", r = \"20 mm\""),
        ("", "deg", "20*sin(w*t)", "w = 360"),
        ("", "deg", "20*sin((360*f*t + 90)*pi/180)", "f = \"0.5 Hz\""),
    ];
    expect![[r#"
        phi + t*x   in deg; phi = "90 deg", x = "5 mm"
            at t*x: formula: `phi` is an angle, but `t*x` is a length: they cannot be added
            To get a plain number, divide by a unit: write `phi/rad` or `x/mm`, with where = { rad = "1 rad", mm = "1 mm" }
        10*t - 2*x - phi   in mm; phi = "90 deg", x = "5 mm"
            at phi: formula: `10*t - 2*x` is a length, but `phi` is an angle: they cannot be subtracted
            To get a plain number, divide by a unit: write `phi/rad` or `x/mm`, with where = { rad = "1 rad", mm = "1 mm" }
        if(phi < x, 1, 2)*t   in deg; phi = "90 deg", x = "5 mm"
            at x: formula: `phi` is an angle, but `x` is a length: they cannot be compared
            To get a plain number, divide by a unit: write `phi/rad` or `x/mm`, with where = { rad = "1 rad", mm = "1 mm" }
        piecewise(t < 1, phi, t < 2, 5, x)*t   in deg; phi = "90 deg", x = "5 mm"
            at x: formula: `phi` is an angle, but `x` is a length: `piecewise` gives values of one kind
            To get a plain number, divide by a unit: write `phi/rad` or `x/mm`, with where = { rad = "1 rad", mm = "1 mm" }
        max(phi, x)   in deg; phi = "90 deg", x = "5 mm"
            at x: formula: `phi` is an angle, but `x` is a length: `max` takes values of one kind
            To get a plain number, divide by a unit: write `phi/rad` or `x/mm`, with where = { rad = "1 rad", mm = "1 mm" }
        clamp(t, phi, x)   in deg; phi = "90 deg", x = "5 mm"
            at x: formula: `phi` is an angle, but `x` is a length: `clamp` takes values of one kind
            To get a plain number, divide by a unit: write `phi/rad` or `x/mm`, with where = { rad = "1 rad", mm = "1 mm" }
        hypot(x, phi)   in deg; phi = "90 deg", x = "5 mm"
            at phi: formula: `x` is a length, but `phi` is an angle: `hypot` takes values of one kind
            To get a plain number, divide by a unit: write `phi/rad` or `x/mm`, with where = { rad = "1 rad", mm = "1 mm" }
        atan2(x, phi)   in deg; phi = "90 deg", x = "5 mm"
            at phi: formula: `x` is a length, but `phi` is an angle: `atan2` takes two of one kind
            To get a plain number, divide by a unit: write `phi/rad` or `x/mm`, with where = { rad = "1 rad", mm = "1 mm" }
        mod(phi, x)   in deg; phi = "90 deg", x = "5 mm"
            at x: formula: `phi` is an angle, but `x` is a length: `mod` takes values of one kind
            To get a plain number, divide by a unit: write `phi/rad` or `x/mm`, with where = { rad = "1 rad", mm = "1 mm" }
        phi + phi^2   in deg; phi = "90 deg", x = "5 mm"
            at phi^2: formula: `phi` is an angle, but `phi^2` is an angle squared: they cannot be added
            To get a plain number, divide by a unit: write `phi/rad` or `x/mm`, with where = { rad = "1 rad", mm = "1 mm" }
        phi*t + x   in step; phi = "90 deg", x = "5 mm"
            at x: formula: `phi*t` is an angle, but `x` is a length: they cannot be added
            To get a plain number, divide by a unit: write `phi/rad` or `x/mm`, with where = { rad = "1 rad", mm = "1 mm" }
        phi + 0*t - 0   in deg; phi = "90 deg", x = "5 mm"
            no problem
    "#]]
    .assert_eq(&of_formulas(&mixed));
    expect![[r#"
        phi*sin(2*pi*t)   in mm; phi = "90 deg"
            at phi*sin(2*pi*t): formula: it comes to an angle, but `unit` is "mm", which is a length
            give amplitudes as lengths, or multiply by a radius: an angle times a length is an arc
        x*sin(2*pi*t)   in deg; phi = "90 deg", x = "5 mm"
            at x*sin(2*pi*t): formula: it comes to a length, but `unit` is "deg", which is an angle
            give amplitudes as angles, or say unit = "mm" for a motor with a `lead`
        phi*phi*t   in deg; phi = "90 deg"
            at phi*phi*t: formula: it comes to an angle squared, but `unit` is "deg", which is an angle
            A product may hold one angle or one length. All other factors must be plain numbers.
        t/phi   in deg; phi = "90 deg"
            at t/phi: formula: it comes to one over an angle, but `unit` is "deg", which is an angle
            A product may hold one angle or one length. All other factors must be plain numbers.
        sqrt(phi)*t*x   in deg; phi = "90 deg", x = "5 mm"
            at sqrt(phi)*t*x: formula: it comes to angle^0.5·length^1, but `unit` is "deg", which is an angle
            A product may hold one angle or one length. All other factors must be plain numbers.
        2*phi/pi*asin(sin(t))   in deg; phi = "90 deg"
            at 2*phi/pi*asin(sin(t)): formula: it comes to an angle squared, but `unit` is "deg", which is an angle
            asin, acos, atan and atan2 return an angle. For a plain number of radians write `asin(x)/rad`, with where = { rad = "1 rad" }
        x*phi*t   in mm; phi = "90 deg", x = "5 mm"
            no problem
    "#]]
    .assert_eq(&of_formulas(&misfits));
    expect![[r#"
        90*sin(x)   in deg; phi = "90 deg", x = "5 mm"
            at x: formula: `sin` takes an angle, or a plain number in rad, but `x` is a length
            divide the length by a length, such as the radius
        90*cos(2*phi^2)   in deg; phi = "90 deg"
            at 2*phi^2: formula: `cos` takes an angle, or a plain number in rad, but `2*phi^2` is an angle squared
            A product may hold one angle or one length. All other factors must be plain numbers.
        90*tan(a)   in step; a = "3 step"
            at a: formula: `tan` takes an angle, or a plain number in rad, but `a` is a number of steps
            give an angle in rev, deg or rad: of this motor a step is both an angle and a length
        90*exp(-phi)   in deg; phi = "90 deg"
            at -phi: formula: the argument of `exp` is to be a plain number, but `-phi` is an angle
            To get a plain number, divide by a unit: write `phi/rad` or `x/mm`, with where = { rad = "1 rad", mm = "1 mm" }
        2^phi   in deg; phi = "90 deg"
            at phi: formula: an exponent is to be a plain number, but `phi` is an angle
            To get a plain number, divide by a unit: write `phi/rad` or `x/mm`, with where = { rad = "1 rad", mm = "1 mm" }
        phi^t   in deg; phi = "90 deg"
            at t: formula: `phi` is an angle: its power must be a number, but `t` changes
            To get a plain number, divide by a unit: write `phi/rad` or `x/mm`, with where = { rad = "1 rad", mm = "1 mm" }
        asin(phi)   in deg; phi = "90 deg"
            at phi: formula: the argument of `asin` is to be a plain number, but `phi` is an angle
            To get a plain number, divide by a unit: write `phi/rad` or `x/mm`, with where = { rad = "1 rad", mm = "1 mm" }
        90*exp(-atan(t))   in deg
            at -atan(t): formula: the argument of `exp` is to be a plain number, but `-atan(t)` is an angle
            asin, acos, atan and atan2 return an angle. For a plain number of radians write `asin(x)/rad`, with where = { rad = "1 rad" }
        90*sin(floor(phi*t))   in deg; phi = "90 deg"
            at phi*t: formula: `floor` takes a plain number here, but `phi*t` is an angle
            divide by what is to be counted, such as a parameter of "1 rev"
        90*sin(x/x + sign(phi)*ln(phi/phi*2))   in deg; phi = "90 deg", x = "5 mm"
            no problem
    "#]]
    .assert_eq(&of_formulas(&arguments));
    expect![[r#"
        if(x > 3, 1, 2)*t   in deg; phi = "90 deg", x = "5 mm"
            at 3: formula: `3` has no unit, but `x` is a length: `unit` is "deg", and so does not say which
            give it as a parameter with its unit, such as where = { x = "5 mm", phi = "90 deg" }
        if(phi > 90, 1, 2)*t   in mm; phi = "90 deg", x = "5 mm"
            at 90: formula: `90` has no unit, but `phi` is an angle: `unit` is "mm", and so does not say which
            give it as a parameter with its unit, such as where = { x = "5 mm", phi = "90 deg" }
        x*sin(phi + 3)   in mm; phi = "90 deg", x = "5 mm"
            no problem
        phi + pi/2*t   in deg; phi = "90 deg"
            at pi/2*t: formula: `pi/2*t` has no unit: next to the angle `phi` it counts as deg, the `unit`
            write it in deg, or as a parameter with its own unit, such as "90 deg"
        phi*t + max(pi/2, 0)*t   in deg; phi = "90 deg"
            at max(pi/2, 0)*t: formula: `max(pi/2, 0)*t` has no unit: next to the angle `phi*t` it counts as deg, the `unit`
            write it in deg, or as a parameter with its own unit, such as "90 deg"
        phi*t + (pi/2*t + 0.1*t)   in deg; phi = "90 deg"
            at (pi/2*t + 0.1*t): formula: `(pi/2*t + 0.1*t)` has no unit: next to the angle `phi*t` it counts as deg, the `unit`
            write it in deg, or as a parameter with its own unit, such as "90 deg"
        phi*t + abs(-pi)*mod(t, 1)   in deg; phi = "90 deg"
            at abs(-pi)*mod(t, 1): formula: `abs(-pi)*mod(t, 1)` has no unit: next to the angle `phi*t` it counts as deg, the `unit`
            write it in deg, or as a parameter with its own unit, such as "90 deg"
        phi*t + 180/pi*max(pi/2, 0)*t   in deg; phi = "90 deg"
            no problem
        x*(phi + pi/2 + asin(0.5))*t   in mm; phi = "90 deg", x = "5 mm"
            no problem
        x*(phi + 180/pi*0.5*t)   in mm; phi = "90 deg", x = "5 mm"
            at 180/pi*0.5*t: formula: `180/pi*0.5*t` has no unit, but `phi` is an angle: `unit` is "mm", and so does not say which
            give it as a parameter with its unit, such as where = { x = "5 mm", phi = "90 deg" }
        x*(phi + (180/pi)*asin(0.5)*t)   in mm; phi = "90 deg", x = "5 mm"
            at (180/pi)*asin(0.5)*t: formula: `(180/pi)*asin(0.5)*t` has no unit, but `phi` is an angle: `unit` is "mm", and so does not say which
            give it as a parameter with its unit, such as where = { x = "5 mm", phi = "90 deg" }
        x*(phi + (pi + 180/pi*t))   in mm; phi = "90 deg", x = "5 mm"
            at (pi + 180/pi*t): formula: `(pi + 180/pi*t)` has no unit, but `phi` is an angle: `unit` is "mm", and so does not say which
            give it as a parameter with its unit, such as where = { x = "5 mm", phi = "90 deg" }
    "#]]
    .assert_eq(&of_formulas(&bare));
    expect![[r#"
        180/pi*asin(t)   in deg
            at 180/pi*asin(t): formula: `180/pi*asin(t)` converts by hand: what asin, acos, atan and atan2 give is in deg here already
            leave the factor out; for the number of rad divide by an angle, where = { rad = "1 rad" }
        57.3*asin(t) + 5   in deg
            at 57.3*asin(t): formula: `57.3*asin(t)` converts by hand: what asin, acos, atan and atan2 give is in deg here already
            leave the factor out; for the number of rad divide by an angle, where = { rad = "1 rad" }
        asin(t)/(2*pi)   in rev
            at asin(t)/(2*pi): formula: `asin(t)/(2*pi)` converts by hand: what asin, acos, atan and atan2 give is in rev here already
            leave the factor out; for the number of rad divide by an angle, where = { rad = "1 rad" }
        atan2(t, 1)*0.1592   in rev
            at atan2(t, 1)*0.1592: formula: `atan2(t, 1)*0.1592` converts by hand: what asin, acos, atan and atan2 give is in rev here already
            leave the factor out; for the number of rad divide by an angle, where = { rad = "1 rad" }
        asin(t)*800/2/pi   in step
            at asin(t)*800/2/pi: formula: `asin(t)*800/2/pi` converts by hand: what asin, acos, atan and atan2 give is in step here already
            leave the factor out; for the number of rad divide by an angle, where = { rad = "1 rad" }
        90*2/pi*asin(sin(t))   in deg
            at 90*2/pi*asin(sin(t)): formula: `90*2/pi*asin(sin(t))` converts by hand: what asin, acos, atan and atan2 give is in deg here already
            leave the factor out; for the number of rad divide by an angle, where = { rad = "1 rad" }
        90*sin(2*pi*f*t)   in deg; f = "0.5 rev/s"
            at 2*pi*f*t: formula: `2*pi*f*t` converts by hand: `f` = 0.5 rev/s is 3.14 rad/s here already
            leave the factor out, or give `f` in Hz
        90*sin(6.28*f*t - 1)   in deg; f = "30 rpm"
            at 6.28*f*t: formula: `6.28*f*t` converts by hand: `f` = 30 rpm is 3.14 rad/s here already
            leave the factor out, or give `f` in Hz
        90*sin(2*pi*n/60*t)   in deg; n = "30 rpm"
            at 2*pi*n/60*t: formula: `2*pi*n/60*t` converts by hand: `n` = 30 rpm is 3.14 rad/s here already
            leave the factor out
        90*cos(phi*pi/180)   in deg; phi = "90 deg"
            at phi*pi/180: formula: `phi*pi/180` converts by hand: `phi` = 90 deg is 1.57 rad here already
            leave the factor out
        w*180/pi*t   in deg; w = "1 rad/s"
            at w*180/pi*t: formula: `w*180/pi*t` converts by hand: `w` = 1 rad/s is 57.3 deg/s here already
            leave the factor out
        360*f*t   in deg; f = "0.5 rev/s"
            at 360*f*t: formula: `360*f*t` converts by hand: `f` = 0.5 rev/s is 180 deg/s here already
            leave the factor out, or give `f` in Hz; one that is meant needs a name, as in where = { gear = 60 }
        2*pi*f*t   in rad; f = "0.5 rev/s"
            at 2*pi*f*t: formula: `2*pi*f*t` converts by hand: `f` = 0.5 rev/s is 3.14 rad/s here already
            leave the factor out, or give `f` in Hz
        2*pi*r*f*t   in mm; r = "20 mm", f = "0.5 rev/s"
            at 2*pi*r*f*t: formula: `2*pi*r*f*t` converts by hand: `f` = 0.5 rev/s is 3.14 rad/s here already
            leave the factor out, or give `f` in Hz
        2*pi*n/60*t   in rad; n = "30 rpm"
            at 2*pi*n/60*t: formula: `2*pi*n/60*t` converts by hand: `n` = 30 rpm is 3.14 rad/s here already
            leave the factor out
        phi/360*t   in rev; phi = "90 deg"
            at phi/360*t: formula: `phi/360*t` converts by hand: `phi` = 90 deg is 0.25 rev here already
            leave the factor out; one that is meant needs a name, as in where = { gear = 60 }
        phi*360   in deg; phi = "90 deg"
            at phi*360: formula: `phi*360` converts by hand: `phi` = 90 deg is 90 deg here already
            leave the factor out; one that is meant needs a name, as in where = { gear = 60 }
        w*t/(2*pi)   in rev; w = "1 rad/s"
            at w*t/(2*pi): formula: `w*t/(2*pi)` converts by hand: `w` = 1 rad/s is 0.159 rev/s here already
            leave the factor out
        2*pi*n*t   in deg; n = "30 rpm"
            at 2*pi*n*t: formula: `2*pi*n*t` converts by hand: `n` = 30 rpm is 180 deg/s here already
            leave the factor out, or give `n` in Hz
        20*sin(2*pi*(t/2 - phi))   in deg; phi = "90 deg"
            at 2*pi*(t/2 - phi): formula: `2*pi*(t/2 - phi)` converts by hand: `phi` = 90 deg is 1.57 rad here already
            of the sum multiply the plain numbers alone, as in 2*pi*t/T - phi
        0.159*w*(t - 1)   in rev; w = "1 rad/s"
            at 0.159*w*(t - 1): formula: `0.159*w*(t - 1)` converts by hand: `w` = 1 rad/s is 0.159 rev/s here already
            leave the factor out; one that is meant needs a name, as in where = { gear = 60 }
        abs(57.3*asin(t))   in deg
            at abs(57.3*asin(t)): formula: `abs(57.3*asin(t))` converts by hand: what asin, acos, atan and atan2 give is in deg here already
            leave the factor out; for the number of rad divide by an angle, where = { rad = "1 rad" }
        v/(2*pi)*sin(2*pi*t) + v/(2*pi*f)*t*sin(2*pi*f*t)   in deg; v = "90 deg/s", f = "1 Hz"
            no problem
        90*sin(pi/4*w*t)   in deg; w = "1 rad/s"
            no problem
        pi/2*r*phi*t   in mm; r = "20 mm", phi = "90 deg"
            no problem
        90*sin(2*pi*f*t - phi) + 2*pi*f*phi*t   in deg; f = "0.5 Hz", phi = "3 deg"
            no problem
    "#]].assert_eq(&of_formulas(&by_hand));
    expect![[r#"
        n*360/60*t   in deg; n = "30 rpm"
            at n*360/60*t: formula: `n*360/60*t` converts by hand: `n` = 30 rpm is 180 deg/s here already
            leave the factor out; one that is meant needs a name, as in where = { gear = 60 }
        20*sin(n/60*360*t)   in deg; n = "30 rpm"
            at n/60*360*t: formula: `n/60*360*t` converts by hand: `n` = 30 rpm is 3.14 rad/s here already
            leave the factor out; one that is meant needs a name, as in where = { gear = 60 }
        20*sin(n/60*2*pi*t)   in deg; n = "30 rpm"
            at n/60*2*pi*t: formula: `n/60*2*pi*t` converts by hand: `n` = 30 rpm is 3.14 rad/s here already
            leave the factor out
        n/60*t   in deg; n = "30 rpm"
            at n/60*t: formula: `n/60*t` converts by hand: `n` = 30 rpm is 180 deg/s here already
            leave the factor out; one that is meant needs a name, as in where = { gear = 60 }
        3*t*n/60   in rev; n = "30 rpm"
            at 3*t*n/60: formula: `3*t*n/60` converts by hand: `n` = 30 rpm is 0.5 rev/s here already
            leave the factor out; one that is meant needs a name, as in where = { gear = 60 }
        w*t/3600   in rev; w = "15 deg/h"
            at w*t/3600: formula: `w*t/3600` converts by hand: `w` = 15 deg/h is 0.0000116 rev/s here already
            leave the factor out; one that is meant needs a name, as in where = { gear = 60 }
        v/60*t   in mm; v = "600 mm/min"
            at v/60*t: formula: `v/60*t` converts by hand: `v` = 600 mm/min is 10 mm/s here already
            leave the factor out; one that is meant needs a name, as in where = { gear = 60 }
        20*sin(0.1047*n*t)   in deg; n = "30 rpm"
            at 0.1047*n*t: formula: `0.1047*n*t` converts by hand: `n` = 30 rpm is 3.14 rad/s here already
            leave the factor out; one that is meant needs a name, as in where = { gear = 60 }
        20*sin(3*2*pi*n*t)   in deg; n = "0.5 rev/s"
            at 3*2*pi*n*t: formula: `3*2*pi*n*t` converts by hand: `n` = 0.5 rev/s is 3.14 rad/s here already
            leave the factor out
        20*sin(pi*n*t)^2   in deg; n = "0.5 rev/s"
            at pi*n*t: formula: `pi*n*t` converts by hand: `n` = 0.5 rev/s is 3.14 rad/s here already
            leave the factor out
        4*pi*n*t   in deg; n = "0.5 rev/s"
            at 4*pi*n*t: formula: `4*pi*n*t` converts by hand: `n` = 0.5 rev/s is 180 deg/s here already
            leave the factor out
        pi*2*r*n*t   in mm; r = "20 mm", n = "0.5 rev/s"
            at pi*2*r*n*t: formula: `pi*2*r*n*t` converts by hand: `n` = 0.5 rev/s is 3.14 rad/s here already
            leave the factor out, or give `n` in Hz
        pi*d*n*t   in mm; d = "40 mm", n = "0.5 rev/s"
            at pi*d*n*t: formula: `pi*d*n*t` converts by hand: `n` = 0.5 rev/s is 3.14 rad/s here already
            leave the factor out
        3*57.3*w*t   in deg; w = "1 rad/s"
            at 3*57.3*w*t: formula: `3*57.3*w*t` converts by hand: `w` = 1 rad/s is 57.3 deg/s here already
            leave the factor out
        20*sin(3.1416/180*phi*t)   in deg; phi = "90 deg"
            at 3.1416/180*phi*t: formula: `3.1416/180*phi*t` converts by hand: `phi` = 90 deg is 1.57 rad here already
            leave the factor out
        20*sin(k*phi*t)   in deg; phi = "90 deg", k = 0.0174533
            at k*phi*t: formula: `k*phi*t` converts by hand: `phi` = 90 deg is 1.57 rad here already
            leave the factor out
        800*n*t   in step; n = "0.5 rev/s"
            at 800*n*t: formula: `800*n*t` converts by hand: `n` = 0.5 rev/s is 400 step/s here already
            leave the factor out; one that is meant needs a name, as in where = { gear = 60 }
        w*t*800/(2*pi)   in step; w = "1 rad/s"
            at w*t*800/(2*pi): formula: `w*t*800/(2*pi)` converts by hand: `w` = 1 rad/s is 127 step/s here already
            leave the factor out
        phi*800/360*t   in step; phi = "90 deg"
            at phi*800/360*t: formula: `phi*800/360*t` converts by hand: `phi` = 90 deg is 200 step here already
            leave the factor out; one that is meant needs a name, as in where = { gear = 60 }
        25.4*x*t   in mm; x = "2 in"
            at 25.4*x*t: formula: `25.4*x*t` converts by hand: `x` = 2 in is 50.8 mm here already
            leave the factor out; one that is meant needs a name, as in where = { gear = 60 }
        100*x*t   in step; x = "2 mm"
            at 100*x*t: formula: `100*x*t` converts by hand: `x` = 2 mm is 200 step here already
            leave the factor out; one that is meant needs a name, as in where = { gear = 60 }
        20*exp(-t*1000/T)   in deg; T = "500 ms"
            at -t*1000/T: formula: `-t*1000/T` converts by hand: `T` = 500 ms is 0.5 s here already
            leave the factor out; one that is meant needs a name, as in where = { gear = 60 }
        20*t/(T/1000)   in deg; T = "500 ms"
            at T/1000: formula: `T/1000` converts by hand: `T` = 500 ms is 0.5 s here already
            leave the factor out; one that is meant needs a name, as in where = { gear = 60 }
        20*sin(2*pi*t/(60*T))   in deg; T = "2 min"
            at 60*T: formula: `60*T` converts by hand: `T` = 2 min is 120 s here already
            leave the factor out; one that is meant needs a name, as in where = { gear = 60 }
        20*sin(2*pi*1000*f*t)   in deg; f = "0.002 kHz"
            at 2*pi*1000*f*t: formula: `2*pi*1000*f*t` converts by hand: `f` = 0.002 kHz is 2 Hz here already
            leave the factor out
        if(t < T/1000, 0, t - 1/2)   in deg; T = "500 ms"
            at T/1000: formula: `T/1000` converts by hand: `T` = 500 ms is 0.5 s here already
            leave the factor out; one that is meant needs a name, as in where = { gear = 60 }
        180/pi*asin(t)   in rad
            at 180/pi*asin(t): formula: `180/pi*asin(t)` converts by hand: what asin, acos, atan and atan2 give is in rad here already
            leave the factor out; for the number of rad divide by an angle, where = { rad = "1 rad" }
        20*sin(180/pi*asin(t))   in deg
            at 180/pi*asin(t): formula: `180/pi*asin(t)` converts by hand: what asin, acos, atan and atan2 give is in rad here already
            leave the factor out; for the number of rad divide by an angle, where = { rad = "1 rad" }
        phi + 3.1416*t   in deg; phi = "90 deg"
            at 3.1416*t: formula: `3.1416*t` has no unit: next to the angle `phi` it counts as deg, the `unit`
            write it in deg, or as a parameter with its own unit, such as "90 deg"
        x*(phi + (pi + (180/pi)*asin(t)))   in mm; phi = "90 deg", x = "5 mm"
            at (pi + (180/pi)*asin(t)): formula: `(pi + (180/pi)*asin(t))` has no unit, but `phi` is an angle: `unit` is "mm", and so does not say which
            give it as a parameter with its unit, such as where = { x = "5 mm", phi = "90 deg" }
        x*(phi + 57.3*asin(t))   in mm; phi = "90 deg", x = "5 mm"
            at 57.3*asin(t): formula: `57.3*asin(t)` has no unit, but `phi` is an angle: `unit` is "mm", and so does not say which
            give it as a parameter with its unit, such as where = { x = "5 mm", phi = "90 deg" }
        phi*p   in deg; phi = "90 deg", p = "40 %"
            at "40 %": `p`: a formula takes numbers, not percents
            write p = 0.4
        n/0.16667*t   in deg; n = "30 rpm"
            at n/0.16667*t: formula: `n/0.16667*t` converts by hand: `n` = 30 rpm is 180 deg/s here already
            leave the factor out; one that is meant needs a name, as in where = { gear = 60 }
        4*s*t   in step; s = "25 full-step"
            at 4*s*t: formula: `4*s*t` converts by hand: `s` = 25 full-step is 100 step here already
            leave the factor out; one that is meant needs a name, as in where = { gear = 60 }
        20*sin(360*f*t + 90)   in deg; f = "0.5 Hz"
            at 360*f*t + 90: formula: `360*f*t + 90` is in degrees, but sin, cos and tan take rad
            write 2*pi in place of 360; a number of rad that is meant needs a name, as in where = { w = 360 }
        screw*n*t   in mm; screw = "8 mm", n = "0.5 rev/s"
            at screw*n*t: formula: `screw*n*t` is an arc: the angle is in rad, and the motor's `lead` its radius
            divide by a turn, with where = { turn = "1 rev" }; or take the position from an angle alone, with unit = "rev"
        v/r*t   in deg; v = "50 mm/s", r = "20 mm"
            at v/r*t: formula: `v/r*t` is one over another of a kind, an angle in rad, but `unit` is "deg"
            multiply by an angle, such as rad, with where = { rad = "1 rad" }
        phi + v/(2*r)*t   in deg; v = "50 mm/s", r = "20 mm", phi = "90 deg"
            at v/(2*r)*t: formula: `v/(2*r)*t` is one over another of a kind, an angle in rad, but `unit` is "deg"
            multiply by an angle, such as rad, with where = { rad = "1 rad" }
        v/w*sin(w*t)   in rev; v = "90 deg/s", w = "1 rad/s"
            at v/w*sin(w*t): formula: `v/w*sin(w*t)` is one over another of a kind, an angle in rad, but `unit` is "rev"
            multiply by an angle, such as rad, with where = { rad = "1 rad" }
    "#]].assert_eq(&of_formulas(&disguised));
    assert_eq!(of_formulas(&gears).matches("    no problem").count(), gears.len(), "{}", of_formulas(&gears));
}

#[test]
fn csv_files() {
    let table = |rest: &str| format!("law.table = {{ file = {rest}, unit = \"deg\" }}");
    check(
        SINE,
        &table("\"none.csv\""),
        expect![[r#"
        x.toml:14:22: cannot read "none.csv": there is no such file
            paths are relative to the motion file
    "#]],
    );
    check(
        SINE,
        &table("\"late.csv\""),
        expect![[r#"
            late.csv:5:1: times must increase from line to line, but column 1 `time` has 1 after 2
                sort the lines by time, or take out one of the two
        "#]],
    );
    check(
        SINE,
        &table("\"word.csv\""),
        expect![[r#"
            word.csv:2:3: expected a number, found `ten` in column 2
        "#]],
    );
    check(
        SINE,
        &table("\"short.csv\""),
        expect![[r#"
        short.csv:1:1: a table needs two points at least, but has 1
    "#]],
    );
    check(
        SINE,
        &table("\"thin.csv\""),
        expect![[r#"
            thin.csv:1:1: expected 2 columns (time, position) or a header, found 1 column and no header
                columns are separated by tabs, `;` or `,`
        "#]],
    );
    check(
        SINE,
        &table("\"semicolon.csv\""),
        expect![[r#"
            semicolon.csv:3:3: expected a number, found `ten` in column 2 `angle`
        "#]],
    );
    check(
        SINE,
        &table("\"good.csv\", columns = [\"time\", \"angel\"]"),
        expect![[r#"
            good.csv:1:1: expected a column `angel`, found `time`, `angle`
                did you mean "angle"?
        "#]],
    );
}

/// What the header and the motion file say must not differ, and what neither says is not guessed.
#[test]
fn columns_of_csv_files() {
    let table = |rest: &str| format!("law.table = {{ file = {rest} }}");
    check(
        SINE,
        &table("\"ms.csv\", time = \"s\", unit = \"deg\""),
        expect![[r#"
        ms.csv:1:1: column 1 `Time [ms]` is in ms, but x.toml:14:39 says time = "s"
            if the header is right, write: time = "ms"
    "#]],
    );
    check(
        SINE,
        &table("\"ms.csv\", unit = \"rad\""),
        expect![[r#"
        ms.csv:1:11: column 2 `angle [deg]` is in deg, but x.toml:14:39 says unit = "rad"
            if the header is right, write: unit = "deg"
    "#]],
    );
    check(
        SINE,
        &table("\"gon.csv\", unit = \"deg\""),
        expect![[r#"
            gon.csv:1:3: expected a unit of position (rev, deg, rad, mm, cm, m, in, step, full-step), found `angle [gon]`
                if column 1 `t` is the time in s and column 2 `angle [gon]` is the position in deg, write: columns = [1, 2], time = "s"
        "#]],
    );
    check(
        SINE,
        &table("\"gon.csv\""),
        expect![[r#"
            gon.csv:1:3: expected a unit of position (rev, deg, rad, mm, cm, m, in, step, full-step), found `angle [gon]`
                if column 1 `t` is the time in s and column 2 `angle [gon]` is the position in deg, write: columns = [1, 2], time = "s", unit = "deg"
        "#]],
    );
    check(
        SINE,
        &table("\"lost.csv\", unit = \"deg\""),
        expect![[r#"
            lost.csv:1:1: expected a unit of time (ns, us, ms, s, min, h), found `t [deg]`
                if they are there under other names, call them so in the header: time [s],angle [deg]
        "#]],
    );
    check(
        SINE,
        &table("\"lost.csv\", unit = \"deg\", columns = [1, 2]"),
        expect![[r#"
            lost.csv:1:1: expected a unit of time (ns, us, ms, s, min, h), found `t [deg]`
        "#]],
    );
    check(
        SINE,
        &table("\"frames.csv\", unit = \"deg\""),
        expect![[r#"
            frames.csv:1:1: expected a column `time [s]`, found `frame`, `angle`
                if they are there under other names, call them so in the header: time [s],angle [deg]
        "#]],
    );
    check(
        SINE,
        &table("\"two.csv\", unit = \"deg\""),
        expect![[r#"
            two.csv:1:1: expected a column `angle [deg]`, found `t`, `left`, `right`
                if column 1 `t` is the time in s and column 2 `left` is the position in deg, write: columns = [1, 2], time = "s"
                if column 1 `t` is the time in s and column 3 `right` is the position in deg, write: columns = [1, 3], time = "s"
        "#]],
    );
    check(
        SINE,
        &table("\"times.csv\", unit = \"deg\""),
        expect![[r#"
            times.csv:1:1: expected one column for the time, found column 1 `t` and column 2 `time`
                if column 1 `t` is the time in s and column 3 `a` is the position in deg, write: columns = [1, 3], time = "s"
                if column 2 `time` is the time in s and column 3 `a` is the position in deg, write: columns = [2, 3], time = "s"
        "#]],
    );
    check(
        SINE,
        &table("\"bare.csv\", unit = \"deg\""),
        expect![[r#"
            bare.csv:1:1: expected 2 columns (time, position) or a header, found 3 columns and no header
                if column 1 is the time in s and column 2 is the position in deg, write: columns = [1, 2], time = "s"
                if column 1 is the time in s and column 3 is the position in deg, write: columns = [1, 3], time = "s"
        "#]],
    );
    check(
        SINE,
        &table("\"unknown.csv\", unit = \"deg\", columns = [2, 1], time = \"moons\""),
        expect![[r#"
        x.toml:14:76: `time` must be one of "s", "ms", "us", "µs", "ns", "min", "h"
    "#]],
    );
    check(
        SINE,
        &table("\"late.csv\", unit = \"deg\""),
        expect![[r#"
            late.csv:5:1: times must increase from line to line, but column 1 `time` has 1 after 2
                sort the lines by time, or take out one of the two
        "#]],
    );
    check(
        SINE,
        &table("\"unknown.csv\", unit = \"deg\""),
        expect![[r#"
            unknown.csv:1:1: expected a column `time [s]`, found `foo`, `bar`
                if column 2 `bar` is the time in s and column 1 `foo` is the position in deg, write: columns = [2, 1], time = "s"
        "#]],
    );
    check(
        SINE,
        &table("\"swapped.csv\", unit = \"deg\", columns = [1, 2]"),
        expect![[r#"
            swapped.csv:1:3: `columns` (x.toml:14:61) makes `a` the time, but the header says that `t` is the time
                if column 2 `t` is the time in s and column 1 `a` is the position in deg, write: columns = [2, 1], time = "s"
        "#]],
    );
    check(
        SINE,
        &table("\"counted.csv\", unit = \"deg\", columns = [1, 2]"),
        expect![[r#"
            counted.csv:1:3: `columns` (x.toml:14:61) makes `i` the time, but the header says that `t` is the time
                if column 2 `t` is the time in s and column 3 `a` is the position in deg, write: columns = [2, 3], time = "s"
        "#]],
    );
    check(
        SINE,
        &table("\"good.csv\""),
        expect![[r#"
        x.toml:14:13: law `table` has no `unit`
            add, for example: unit = "deg"
    "#]],
    );
    check(
        SINE,
        &table("\"length.csv\""),
        expect![[r#"
        x.toml:14:22: motor `wheel` turns: it has no `lead` that would make mm of its turns
            add to the motor, for example: lead = "8 mm"; or give an angle
    "#]],
    );
    check(
        SINE,
        &table("\"thin.csv\", unit = \"deg\", columns = [1, 2]"),
        expect![[r#"
            thin.csv:1:2: expected a number, found nothing in column 2
        "#]],
    );
    // What these are offered reads.
    for (file, offers) in [("frames", 0), ("two", 2), ("times", 2), ("bare", 2), ("unknown", 1), ("gon", 1)] {
        let motion =
            |rest: &str| read(&GOOD.replacen(SINE, &table(&format!("\"{file}.csv\", unit = \"deg\"{rest}")), 1));
        let said = motion("").unwrap_err().plain();
        let fixes: Vec<&str> = said.lines().filter_map(|line| Some(line.split_once(", write: ")?.1)).collect();
        assert_eq!(fixes.len(), offers, "{said}");
        for fix in fixes {
            assert!(motion(&format!(", {fix}")).is_ok(), "{said}");
        }
    }
    // Columns that the header does not name as times and positions are.
    for rest in [
        "\"swapped.csv\", unit = \"deg\"",
        "\"swapped.csv\", unit = \"deg\", columns = [\"t\", \"a\"]",
        "\"counted.csv\", unit = \"deg\"",
        "\"ms.csv\"",
        "\"ms.csv\", time = \"ms\", unit = \"deg\"",
        "\"gon.csv\", unit = \"deg\", columns = [\"t\", \"angle\"]",
    ] {
        assert!(read(&GOOD.replacen(SINE, &table(rest), 1)).is_ok(), "{rest}");
    }
}

/// Motions of another length would pass, and nobody would be told.
#[test]
fn a_step_angle_is_no_number_of_steps() {
    for (angle, steps) in [("1.8", 200), ("0.9", 400), ("7.5", 48), ("15", 24), ("\"1.8 deg\"", 200), ("\"0.9°\"", 400)]
    {
        let said = read(&GOOD.replacen("200", angle, 1)).unwrap_err().plain();
        let degrees = angle.trim_matches('"').trim_end_matches([' ', 'd', 'e', 'g', '°']);
        let wanted = format!(
            "x.toml:6:17: `steps_per_rev` is {degrees}: that is a step angle in degrees, not the full steps in a revolution\n    \
             write steps_per_rev = {steps}: 360° / step angle\n"
        );
        assert_eq!(said, wanted);
    }
    check(
        "200",
        "2037.8864",
        expect![[r#"
        x.toml:6:17: `steps_per_rev` is 2037.8864: a motor has a whole number of full steps in a revolution
            what turns behind a gearbox: give the motor's own steps, steps_per_rev = 200, and the gear, gear = 3.7
    "#]],
    );
    check(
        "200",
        "51200",
        expect![[r#"
        x.toml:6:17: `steps_per_rev` is 51200: a motor has 20 to 10000 full steps in a revolution
            give full steps, without microsteps: steps_per_rev = 200, microsteps = 16
    "#]],
    );
    let same = read(&GOOD.replacen("200", "2e2", 1)).unwrap();
    assert_eq!(same.motors[0].scale.steps_per_rev, 800.0);
}

#[test]
fn whole_numbers_may_have_an_exponent() {
    let text = GOOD.replacen(SINE, "law.sine = { amplitude = \"2.5 rev\", period = \"1 s\", cycles = 1e9 }", 1);
    assert_eq!(read(&text).unwrap().motors[0].law.end(), Some(Time::SECOND.times(1_000_000_000)));
}

#[test]
fn numbers_that_are_none_of_the_right_kind() {
    check(
        "microsteps = 4",
        "microsteps = 4.5",
        expect![[r#"
        x.toml:7:14: `microsteps` must be a whole number, but is 4.5
            write, for example: microsteps = 4
    "#]],
    );
    check(
        SINE,
        "law.sine = { amplitude = nan, period = \"1 s\" }",
        expect![[r#"
        x.toml:14:26: `amplitude` must be a number with its unit, in quotes, but is not finite
            write, for example: amplitude = "2.5 rev"
    "#]],
    );
    check(
        "driver = \"DQ542MA\"",
        "driver = \"DQ542MA\"\npulse_high = \"0 us\"",
        expect![[r#"
        x.toml:9:14: `pulse_high` must be more than 0
    "#]],
    );
}

#[test]
fn ends_that_cannot_be_changed() {
    let endless = "end = \"jump\"\nlaw.speed = { speed = \"1 rev/s\" }";
    check(
        SINE,
        endless,
        expect![[r#"
        x.toml:14:7: the motion is endless: it has no end to change
    "#]],
    );
}

#[test]
fn several_at_once() {
    let text = GOOD.replace("grid", "gird").replace("\"2.5 rev\"", "2.5").replace("step = 8", "step = 0");
    let error = read(&text).unwrap_err();
    assert_eq!(error.problems().len(), 3);
    let places: Vec<_> = error.problems().iter().map(file::Problem::place).collect();
    assert_eq!(places, [(2, 1), (9, 17), (14, 26)]);
    // Labels lie in the text.
    let (span, _) = error.problems()[0].labels().next().unwrap();
    assert_eq!(&text[span], "gird");
}

#[test]
fn boards_can_be_changed_if_the_pins_are_there() {
    let other = |name: &str| boards::find(name).unwrap().limits();
    let program = read(GOOD).unwrap();
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
    let bases = prop::sample::select(vec![GOOD.to_owned(), template::motion_file("base")]);
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

fn survive(text: &str) {
    if let Err(error) = read(text) {
        assert!(!error.problems().is_empty() && !error.plain().is_empty());
        for problem in error.problems() {
            for (span, _) in problem.labels() {
                let bytes = problem.source().text().as_bytes();
                assert!(bytes.get(span.clone()).is_some(), "{}: {span:?}", problem.message());
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1024))]

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

#[test]
fn a_ramp_that_cannot_catch_up_is_told_so() {
    let limits = "forward = \"low\"\nmax_speed = \"2 rev/s\"\nmax_acceleration = \"4 rev/s^2\"\n";
    let law = "law.speed = { speed = \"2 rev/s\" }\nbegin = \"ramp\"";
    let text = GOOD.replace("forward = \"low\"\n", limits).replace(SINE, law);
    check(
        "",
        &text,
        expect![[r#"
        x.toml:17:9: no ramp stays within max_speed = 1600.0 steps/s: the law runs at 1600.0 steps/s where the ramp would meet it, and the slowest ramp at 2421.6 steps/s: a ramp makes up for the way that it loses, and is faster than the law for a while
            write begin = "ramp-behind": that does not catch up, and stays 0.751 rev behind the law
    "#]],
    );
    let program = read(&text.replace("\"ramp\"", "\"ramp-behind\"")).unwrap();
    assert_eq!(program.motors[0].law.behind().len(), 1);
    let text = text.replace("2 rev/s\" }\nbegin", "2 rev/s\", duration = \"3 s\" }\nbegin = \"jump\"\nend");
    check(
        "",
        &text,
        expect![[r#"
        x.toml:18:7: no ramp stays within max_speed = 1600.0 steps/s: the law runs at 1600.0 steps/s where the ramp would meet it, and the slowest ramp at 2421.6 steps/s: a ramp makes up for the way that it loses, and is faster than the law for a while
            write end = "ramp-behind": that makes up for nothing, and ends 0.751 rev before the law does
    "#]],
    );
    let program = read(&text.replace("\"ramp\"", "\"ramp-behind\"")).unwrap();
    assert!(program.motors[0].law.behind()[0].ends);
    // There is room for neither.
    let short = text.replace("3 s", "0.3 s");
    check(
        "",
        &short,
        expect![[r#"
        x.toml:18:7: no ramp of up to 0.3 s stays within max_acceleration = 3200.0 steps/s²; the gentlest needs 21035.5
            make the motion slower or longer, or write end = "jump" if the motor can do it at once
    "#]],
    );
    check(
        "",
        &short.replace("\"ramp\"", "\"ramp-behind\""),
        expect![[r#"
        x.toml:18:7: no ramp of up to 0.3 s stays within max_acceleration = 3200.0 steps/s²; the gentlest needs 8008.0
            make the motion slower or longer, or write end = "jump" if the motor can do it at once
    "#]],
    );
}
