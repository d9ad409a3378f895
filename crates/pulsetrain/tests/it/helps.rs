//! The advice of a refusal can be written into the file: it is TOML, the reader accepts it in its place, and then the
//! motion fits.

use pulsetrain::load;
use pulsetrain_motion::{Time, file};
use pulsetrain_plan::PlanError;
use pulsetrain_session::fit;
use pulsetrain_session::prepare::Refusal;
use pulsetrain_testkit::folder::Folder;

/// A motor, to which a motion is added.
const MOTOR: &str = "[motor.wheel]\nsteps_per_rev = 200\nmicrosteps = 16\npulse_high = \"2 us\"\n\
    pins = { step = 8, dir = 9 }\nforward = \"low\"\n";
const LIMITS: &str = "max_speed = \"10000 step/s\"\nmax_acceleration = \"40000 step/s^2\"\n";

/// The advice for a motion file. `None` if the motion fits and makes steps.
fn advice(name: &str, text: &str) -> Option<String> {
    advice_for(name, text, None)
}

/// The advice for its beginning.
fn advice_for(name: &str, text: &str, length: Option<Time>) -> Option<String> {
    let folder = Folder::new(&format!("helps-{name}"));
    let file = folder.write("x.toml", text);
    let mut prepared = load::load(file.as_ref(), None, length).unwrap_or_else(|error| panic!("{error:?}\n{text}"));
    match prepared.prove(|_| ()) {
        Ok(planned) => {
            assert!(planned.iter().all(|motor| motor.certificate.steps > 0), "{name} makes no step:\n{text}");
            None
        }
        Err(Refusal::Plan { advice, .. }) => Some(advice),
        Err(other) => panic!("{other}\n{text}"),
    }
}

/// Every `key = value` in an advice.
fn assignments(advice: &str) -> Vec<(&str, &str)> {
    let lines = advice.lines().flat_map(|line| line.match_indices(" = ").map(move |(at, _)| (line, at)));
    let found = lines.filter_map(|(line, at)| {
        let key = line[..at].rfind(|c: char| !c.is_ascii_lowercase() && c != '_').map_or(0, |before| before + 1);
        let value = &line[at + 3..];
        let end = match value.chars().next()? {
            '"' => value[1..].find('"')? + 2,
            '{' => value.find('}')? + 1,
            _ => panic!("no TOML: {line}"),
        };
        // Within another value.
        (!line[..at].contains('{')).then_some((&line[key..at], &value[..end]))
    });
    found.collect()
}

/// The file with an advice applied: in place of the same key, or else in the motions.
fn mended(text: &str, (key, value): (&str, &str)) -> String {
    let is_there = |line: &&str| line.starts_with(&format!("{key} = "));
    if let Some(line) = text.lines().find(is_there) {
        return text.replace(line, &format!("{key} = {value}"));
    }
    match key {
        "tolerance" | "grid" => format!("{key} = {value}\n{text}"),
        "over" => {
            let (before, after) = text.split_once("over = \"").unwrap();
            format!("{before}over = {value}{}", after.split_once('"').unwrap().1)
        }
        "ease" | "begin" | "end" => text.replace("[[motion]]\n", &format!("[[motion]]\n{key} = {value}\n")),
        other => panic!("where does {other} belong?"),
    }
}

/// The advice for a file has these keys in this order, and each of them alone makes the motion fit.
#[track_caller]
fn check(name: &str, text: &str, expected: &[&str]) -> String {
    let advice_on = advice(name, text).unwrap_or_else(|| panic!("{name} fits:\n{text}"));
    let found = assignments(&advice_on);
    let shown: Vec<String> = found.iter().map(|(key, value)| format!("{key} = {value}")).collect();
    assert_eq!(shown.len(), expected.len(), "{name}: {advice_on}");
    for (shown, expected) in shown.iter().zip(expected) {
        assert!(shown.starts_with(expected), "{name}: {shown}, not {expected}: {advice_on}");
    }
    for fix in found {
        assert_eq!(advice(name, &mended(text, fix)), None, "{name}: {fix:?} does not help");
    }
    advice_on
}

fn motion(limits: &str, law: &str) -> String {
    format!("board = \"uno\"\n{MOTOR}{limits}[[motion]]\nmotor = \"wheel\"\n{law}\n")
}

#[test]
fn a_speed_that_begins_at_once_is_eased_first() {
    let endless = |speed| format!("law.speed = {{ speed = \"{speed} step/s\" }}");
    let ways = ["ease = \"0.5", "begin = \"ramp\"", "begin = \"ramp-behind\"", "begin = \"jump\""];
    check("slow", &motion(LIMITS, &endless(5000)), &["ease = \"0.5 s\"", ways[1], ways[2], ways[3]]);
    // At the motor's own limit no ramp can catch up.
    let said = check("fast", &motion(LIMITS, &endless(10_000)), &["ease = \"0.5 s\"", ways[2], ways[3]]);
    assert!(said.contains("steps behind the law"), "{said}");
    check("unlimited", &motion("", &endless(5000)), &["ease = \"0.5 s\"", ways[3]]);
    // More acceleration than half a second allows.
    let soft = LIMITS.replace("40000", "9000");
    check("soft", &motion(&soft, &endless(5000)), &["ease = \"1 s\"", ways[1], ways[2], ways[3]]);
    let sine = "law.formula = { theta = \"20000*sin(0.2*t)\", unit = \"step\" }";
    check("sine", &motion(LIMITS, sine), &["ease = \"0.5 s\"", ways[1], ways[2], "begin = \"delay\"", ways[3]]);
    // The backlash comes on top. Another time for it is offered only with the slower motion.
    let text = motion("backlash = { slack = \"6 step\", over = \"20 ms\" }\n", &endless(5000));
    let said = advice("slack", &text).unwrap();
    let found = assignments(&said);
    assert_eq!(found[..2], [("ease", "\"0.5 s\""), ("begin", "\"jump\"")], "{said}");
    for fix in &found[..2] {
        assert_eq!(advice("slack", &mended(&text, *fix)), None, "{fix:?} does not help");
    }
}

#[test]
fn a_speed_that_ends_at_once_is_eased_first() {
    let law = "law.formula = { theta = \"1000*t^2\", unit = \"step\", duration = \"4 s\" }";
    let ways = ["ease = \"0.5 s\"", "end = \"ramp\"", "end = \"ramp-behind\"", "end = \"jump\""];
    check("end", &motion(LIMITS, law), &ways);
    // At the motor's own limit no ramp can make up for the distance.
    let law = "begin = \"jump\"\nlaw.speed = { speed = \"10000 step/s\", duration = \"2 s\" }";
    let said = check("end-fast", &motion(LIMITS, law), &[ways[0], ways[2], ways[3]]);
    assert!(said.contains("steps before the law does"), "{said}");
}

/// The advice for the beginning, and then the advice for the end, makes a motion that fits and moves.
#[test]
fn beginnings_and_ends_are_cured_one_after_the_other() {
    for (speed, duration, begins) in [
        ("5000", "2 s", 4),
        // Too short for ramps that catch up, and for all ramps.
        ("9000", "1 s", 3),
        ("5000", "0.2 s", 3),
        ("5000", "0.15 s", 1),
    ] {
        let law = format!("law.speed = {{ speed = \"{speed} step/s\", duration = \"{duration}\" }}");
        let text = motion(LIMITS, &law);
        let said = advice("begins", &text).unwrap();
        let found = assignments(&said);
        assert_eq!(found.len(), begins, "{speed} for {duration}: {said}");
        for fix in found {
            let begun = mended(&text, fix);
            let Some(said) = advice("ends", &begun) else { continue };
            let found = assignments(&said);
            assert!(!found.is_empty(), "{speed} for {duration}, {fix:?}: {said}");
            for fix in found {
                assert_eq!(advice("ended", &mended(&begun, fix)), None, "{fix:?} does not help:\n{begun}");
            }
        }
    }
}

/// For an endless motion only a short part is checked. The advice must hold where the motion has its own speed.
#[test]
fn an_easing_of_an_endless_motion_is_tried_at_full_speed() {
    let endless = |speed: u32| {
        motion(LIMITS, &format!("law.formula = {{ theta = \"{speed}*t + 178*sin(9*t)\", unit = \"step\" }}"))
    };
    let said = check("endless", &endless(8300), &["ease = \"0.5 s\"", "begin = \"ramp-behind\"", "begin = \"jump\""]);
    assert!(said.contains("its [[motion]] (tried for 10 s)."), "{said}");
    let eased = mended(&endless(8300), ("ease", "\"0.5 s\""));
    assert_eq!(advice_for("endless-long", &eased, Some(Time::from_seconds(60.0))), None);
    // It is too fast for ever.
    let said = check("too-fast", &endless(9900), &[]);
    assert!(said.starts_with("1") && said.contains(" times slower it fits"), "{said}");
}

/// Planning for advice may take a second for all easings and a second for all slower motions. What takes longer is not
/// offered, or the output says so.
#[test]
fn what_is_looked_for_takes_no_longer_than_a_second() {
    let soft = LIMITS.replace("40000", "9000");
    let law = |s: u32| motion(&soft, &format!("law.speed = {{ speed = \"5000 step/s\", duration = \"{s} s\" }}"));
    let said = advice("soon", &law(20)).unwrap();
    assert!(said.contains("add ease = \"1 s\" to its") && said.contains("times slower"), "{said}");
    // 30 million steps.
    let said = advice("later", &law(6000)).unwrap();
    assert!(
        said.contains("add ease = \"1 s\" (tried at both ends alone: planning all takes about ")
            && !said.contains("slower"),
        "{said}"
    );
}

/// The reader accepts the advice of its own errors.
#[test]
fn what_the_reader_says_to_write_is_read() {
    let formula = |theta: &str, parameters: &str| {
        format!(
            "law.formula = {{ theta = \"{theta}\", unit = \"deg\", duration = \"1 s\", where = {{ {parameters} }} }}"
        )
    };
    let fast = "law.speed = { speed = \"10000 step/s\", duration = \"2 s\" }\n";
    let jumps = format!("begin = \"jump\"\n{fast}");
    let none = |_: &std::path::Path| Err(std::io::ErrorKind::NotFound.into());
    for (limits, law, wrong, right) in [
        (LIMITS, format!("begin = \"ramp\"\n{fast}"), "begin = \"ramp\"", "begin = \"ramp-behind\""),
        (LIMITS, format!("end = \"ramp\"\n{jumps}"), "end = \"ramp\"", "end = \"ramp-behind\""),
        (LIMITS, format!("end = \"ramp\"\n{}", jumps.replace("2 s", "0.1 s")), "end = \"ramp\"", "end = \"jump\""),
        (LIMITS, format!("begin = \"ramp-behind\"\n{}", fast.replace("2 s", "0.1 s")), "\"ramp-behind\"", "\"jump\""),
        ("", formula("p*t", "p = \"40 %\""), "\"40 %\"", "0.4"),
        ("", formula("a*t^2", "a = \"10 rpm/s\""), "10 rpm/s", "0.166667 rev/s^2"),
        ("", formula("a*t^2", "a = \"10 rev/s2\""), "rev/s2", "rev/s^2"),
        ("", formula("sin(f*t)", "f = \"500 mhz\""), "mhz", "mHz"),
        ("", formula("w*t", "w = \"2 rps\""), "rps", "rev/s"),
        (
            "",
            formula("n*t/60", "n = \"1 rpm\""),
            "n*t/60\", unit = \"deg\", duration = \"1 s\", where = {",
            "n*t/gear\", unit = \"deg\", duration = \"1 s\", where = { gear = 60,",
        ),
        (
            "",
            formula("x/r*t", "x = \"5 mm\", r = \"20 mm\""),
            "x/r*t\", unit = \"deg\", duration = \"1 s\", where = {",
            "x/r*t*rad\", unit = \"deg\", duration = \"1 s\", where = { rad = \"1 rad\",",
        ),
    ] {
        let text = motion(limits, &law);
        let error = file::read(&text, "x.toml", &none).unwrap_err();
        let said: Vec<&str> = error.problems().iter().filter_map(|problem| problem.advice()).collect();
        // The value, or the name to which the advice gives it.
        let written = right.rsplit("where = { ").next().unwrap().trim_end_matches(',');
        assert!(said.len() == 1 && said[0].contains(written), "{wrong}: {said:?}");
        let mended = text.replace(wrong, right);
        assert!(mended != text, "{wrong}");
        let read = file::read(&mended, "x.toml", &none);
        assert!(read.is_ok(), "{right}: {}", read.unwrap_err().plain());
    }
}

/// Easing helps at both ends. A motion with another beginning still has its end.
#[test]
fn motions_one_after_the_other_are_eased_each() {
    let law = "law.speed = { speed = \"5000 step/s\", duration = \"2 s\" }";
    let second = "[[motion]]\nmotor = \"wheel\"\nlaw.speed = { speed = \"-4000 step/s\", duration = \"2 s\" }\n";
    let text = format!("{}{second}", motion(LIMITS, law));
    let said = advice("two", &text).unwrap();
    let found = assignments(&said);
    assert_eq!(found[0], ("ease", "\"0.5 s\""), "{said}");
    assert_eq!(advice("two-eased", &mended(&text, found[0])), None);
}

#[test]
fn tolerances_are_offered_as_far_as_they_are_tolerances() {
    let still = "law.sine = { amplitude = \"1 rev\", period = \"1 s\" }";
    check("tight", &format!("tolerance = \"10 ns\"\n{}", motion("", still)), &["tolerance = \"0.55 ticks\""]);
    // The reversal is exactly where a step is due, and formulas round: the proof has 106 bits there, and needs no other
    // tolerance or grid.
    for (rate, s) in [("0.01", "314"), ("1e-5", "3.14e5")] {
        let law = format!("law.formula = {{ theta = \"1e5*sin({rate}*t)^2\", unit = \"step\", duration = \"{s} s\" }}");
        let turning = format!("grid = \"reach\"\n{}", motion("pull_in = \"100 step/s\"\n", &law));
        assert_eq!(advice("turning", &turning), None, "{rate}");
    }
}

/// Each plan of 28 hours would take seconds. An easing is tried only around its ramp, other advice not at all, and the
/// output says so.
#[test]
fn what_takes_long_to_try_is_said_to_be_untried() {
    let law = "law.formula = { theta = \"20000*sin(0.2*t)\", unit = \"step\", duration = \"100000 s\" }";
    let folder = Folder::new("helps-long");
    let file = folder.write("x.toml", &motion(LIMITS, law));
    let prepared = load::load(file.as_ref(), None, None).unwrap();
    let said = |error: &PlanError| fit::advice(&prepared, &prepared.program.motors[0], error);
    let Err(Refusal::Plan { advice, error, .. }) = prepared.clone().prove(|_| ()) else { panic!("it begins at once") };
    assert!(matches!(error, PlanError::SpeedJump { .. }), "{error}");
    let begins = "Start and stop gently: add ease = \"0.5 s\" (tried at both ends alone: planning all takes about ";
    assert!(advice.starts_with(begins) && !advice.contains("slower it fits"), "{advice}");
    let not_provable = |bound_ticks: f64| PlanError::NotProvable { at_s: 2.1, bound_ticks, tolerance_ticks: 0.5 };
    let advice = said(&not_provable(0.6));
    assert!(advice.starts_with("tolerance = \"0.606 ticks\" may do (not tried: planning takes about "), "{advice}");
    let advice = said(&not_provable(1e9));
    let still =
        "At 2.1 s the motion almost stands still exactly at a step, so the time of that step cannot be computed.\n";
    let grid = "Steps are due elsewhere with grid = \"nearest\" (not tried: planning takes about ";
    assert!(advice.strip_prefix(still).is_some_and(|rest| rest.starts_with(grid)), "{advice}");
}

/// If a motion is too long to be tried, no easing is offered that breaks a limit at its beginning or end.
#[test]
fn easings_of_long_motions_are_tried_where_they_ease() {
    let limits = "max_speed = \"40000 step/s\"\nmax_acceleration = \"64000 step/s^2\"\n";
    let formula = |theta: &str, s: u32| {
        motion(limits, &format!("law.formula = {{ theta = \"{theta}\", unit = \"step\", duration = \"{s} s\" }}"))
    };
    // A ripple of 10 kHz that no easing removes: everywhere, or only at the end.
    let said = advice("ripple", &formula("178*sin(2*pi*0.001*t) + 0.09*sin(2*pi*1e4*t)", 1000)).unwrap();
    assert!(!said.contains("ease = "), "{said}");
    let late = "178*sin(0.2*t) + if(t < 99999, 2000*t, 2000*t + 0.09*sin(2*pi*1e4*(t - 99999)))";
    let said = advice("late-ripple", &formula(late, 100_000)).unwrap();
    assert!(!said.contains("ease = "), "{said}");
    let said = advice("no-ripple", &formula("178*sin(0.2*t) + 2000*t", 100_000)).unwrap();
    assert!(said.contains("add ease = \"0.5 s\" (tried at both ends alone: "), "{said}");
}

#[test]
fn slack_is_given_the_time_that_it_wants() {
    let limits = format!("{LIMITS}backlash = {{ slack = \"60 step\", over = \"2 ms\" }}\n");
    check("over", &motion(&limits, "law.sine = { amplitude = \"1 rev\", period = \"4 s\" }"), &["over = \""]);
}
