//! Wrong motion files: each mistake gets an error that names the place, the limit and the remedy.

use std::io;
use std::path::Path;

use expect_test::{Expect, expect};
use miette::Diagnostic;
use proptest::prelude::*;
use pulsetrain_motion::file::{self, FileError};
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
        Err(error) => error.plain(),
    };
    expected.assert_eq(&said);
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
        x.toml:14:12: law `sine` has no `amplitude`
            add, for example: amplitude = "2.5 rev"
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
        x.toml:1:1: the motion file has no `board`
            add, for example: board = "uno"
        x.toml:1:1: the motion file has no `motor`
            add, for example: [motor.wheel] with its steps_per_rev, driver and pins
        x.toml:1:1: the motion file has no `motion`
            add, for example: [[motion]] with motor = "wheel" and law.sine = { … }
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
            did you mean "rev"?
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
        x.toml:6:17: `steps_per_rev` must be more than 0
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
                known: uno, uno-stream, due, pico, native
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
        "DQ542",
        expect![[r#"
        x.toml:8:10: unknown driver "DQ542"
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
        x.toml:15:7: `end` must be one of "ramp", "jump"
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
            sum = [{ sine = { … } }, { speed = { … } }]
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
            x.toml:14:81: axis y is told to move, and no motor with these lines is that axis: add one, or take the axis out
            x.toml:14:98: axis z is told to move, and no motor with these lines is that axis: add one, or take the axis out
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
            x.toml:14:66: axis y is told to move, and no motor with these lines is that axis: add one, or take the axis out
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
        "#]],
    );
    check(
        SINE,
        &formula("'''\n2*t\n + frequncy*t'''", ""),
        expect![[r#"
            x.toml:16:4: formula: `frequncy` is unknown: the time is `t`, other names must be parameters
        "#]],
    );
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

#[test]
fn csv_files() {
    let table = |rest: &str| format!("law.table = {{ file = {rest}, unit = \"deg\" }}");
    check(
        SINE,
        &table("\"none.csv\""),
        expect![[r#"
        x.toml:14:22: cannot read "none.csv": entity not found
            paths are relative to the motion file
    "#]],
    );
    check(
        SINE,
        &table("\"late.csv\""),
        expect![[r#"
        late.csv:5:1: times must increase from line to line
    "#]],
    );
    check(
        SINE,
        &table("\"word.csv\""),
        expect![[r#"
            word.csv:2:3: "ten" is not a number
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
        thin.csv:1:1: this line has 1 columns, but column 2 is wanted
    "#]],
    );
    check(
        SINE,
        &table("\"semicolon.csv\""),
        expect![[r#"
            semicolon.csv:3:3: "ten" is not a number
        "#]],
    );
    check(
        SINE,
        &table("\"good.csv\", columns = [\"time\", \"angel\"]"),
        expect![[r#"
        good.csv:1:1: the header has no column "angel"
    "#]],
    );
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
    assert_eq!(error.related().map(Iterator::count), Some(2));
    let places: Vec<_> = error.problems().iter().map(file::Problem::place).collect();
    assert_eq!(places, [(2, 1), (9, 17), (14, 26)]);
    // Labels lie in the text.
    let label = error.labels().unwrap().next().unwrap();
    assert_eq!(&text[label.offset()..label.offset() + label.len()], "gird");
}

#[test]
fn boards_can_be_changed_if_the_pins_are_there() {
    let other = |name: &str| boards::find(name).unwrap().board;
    let program = read(GOOD).unwrap();
    assert_eq!(program.clone().with_board(other("native")).unwrap().board.name, "native");
    let on_pico = GOOD.replace("\"uno\"", "\"pico\"").replace("step = 8", "step = 28");
    let error = read(&on_pico).unwrap().with_board(other("uno")).unwrap_err();
    assert!(matches!(error, BoardError::Pin { .. }));
    assert_eq!(error.to_string(), "motor `wheel`: the board `uno` has no pin 28: its pins are 0 to 19");
    let narrow = pulsetrain_motion::program::Board { max_motors: 0, ..other("uno") };
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
            for label in problem.labels().into_iter().flatten() {
                let end = label.offset() + label.len();
                let contents = problem.source_code().unwrap().read_span(label.inner(), 0, 0);
                assert!(contents.is_ok(), "{}: {}..{end}", problem.message(), label.offset());
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
