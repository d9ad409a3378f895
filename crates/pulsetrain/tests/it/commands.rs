//! The commands as a user has them: output, files, exit codes. `UPDATE_EXPECT=1` rewrites the golden files.

use pulsetrain::load;
use std::io::{self, Write};

use expect_test::{ExpectFile, expect_file};
use pulsetrain::cli;
use pulsetrain::console::Exit;
use pulsetrain_motion::Time;
use pulsetrain_session::estimate::{Estimate, Task};
use pulsetrain_testkit::folder::Folder;

struct Outcome {
    exit: Exit,
    out: String,
    err: String,
}

fn pulsetrain(args: &[&str]) -> Outcome {
    let (mut out, mut err) = (Vec::new(), Vec::new());
    let exit = cli::run([&["pulsetrain"], args].concat(), &mut out, &mut err);
    Outcome { exit, out: String::from_utf8(out).unwrap(), err: String::from_utf8(err).unwrap() }
}

/// Tests run in the package's folder, so that golden files do not depend on the project's place.
const EXAMPLES: &str = "../../examples";

fn example(name: &str) -> String {
    format!("{EXAMPLES}/{name}")
}

fn check(args: &[&str], exit: Exit, golden: ExpectFile) {
    let outcome = pulsetrain(args);
    golden.assert_eq(&format!("{}{}", outcome.out, outcome.err));
    assert_eq!(outcome.exit, exit, "{args:?}");
}

#[test]
fn help() {
    check(&["--help"], Exit::Success, expect_file!["golden/help.txt"]);
    check(&["run", "--help"], Exit::Success, expect_file!["golden/help-run.txt"]);
    check(&["verify", "--help"], Exit::Success, expect_file!["golden/help-verify.txt"]);
    check(&["board", "--help"], Exit::Success, expect_file!["golden/help-board.txt"]);
    check(&["info", "--help"], Exit::Success, expect_file!["golden/help-info.txt"]);
    check(&["stop", "--help"], Exit::Success, expect_file!["golden/help-stop.txt"]);
    check(&["store", "--help"], Exit::Success, expect_file!["golden/help-store.txt"]);
    check(&["bench", "--help"], Exit::Success, expect_file!["golden/help-bench.txt"]);
    check(&["verbs", "--help"], Exit::Success, expect_file!["golden/help-verbs.txt"]);
    check(&["winch", "--help"], Exit::Success, expect_file!["golden/help-winch.txt"]);
    check(&["formula", "--help"], Exit::Success, expect_file!["golden/help-formula.txt"]);
}

#[test]
fn tables() {
    check(&["boards"], Exit::Success, expect_file!["golden/boards.txt"]);
    check(&["drivers"], Exit::Success, expect_file!["golden/drivers.txt"]);
}

#[test]
fn motor_of_seed_004() {
    let flags = ["motor", "--inductance", "50mH", "--current", "0.135A", "--voltage", "12V", "--microsteps", "8"];
    check(&flags, Exit::Success, expect_file!["golden/motor.txt"]);
    let from_file = pulsetrain(&["motor", "--file", &example("max-speed.toml")]);
    let flags = pulsetrain(&flags);
    assert_eq!(from_file.out.replace("stepper:", "motor:"), flags.out);
}

/// If the sketch's register cannot hold a count, the output says so. Data that no motor has are refused.
#[test]
fn a_motor_whose_counts_do_not_fit_or_that_is_none() {
    let motor = |inductance: &str, more: &[&str]| {
        let flags =
            ["motor", "--inductance", inductance, "--current", "1.35A", "--voltage", "12V", "--microsteps", "8"];
        pulsetrain(&[&flags[..], more].concat())
    };
    let said = motor("90mH", &[]).out.split_whitespace().collect::<Vec<_>>().join(" ");
    for row in [
        "not fit 317 counts ceil(2531 µs / 8 µs): the 8-bit register",
        "fits 256 in place of 128",
        "timer counts 159 counts",
    ] {
        assert!(said.contains(row), "{said}");
    }
    for (inductance, why) in [("1uH", "cuts that to 0"), ("6H", "Timer2 counts up to 16320 µs")] {
        let said = motor(inductance, &[]).out;
        assert!(said.contains(why) && !said.contains("inf"), "{said}");
        let said: serde_json::Value = serde_json::from_str(&motor(inductance, &["--json"]).out).unwrap();
        assert!(said[0]["sketch_cannot"].as_str().unwrap().contains(why), "{said}");
    }
    for inductance in ["0H", "0.0 mH", "-3 mH", "1e-300 H", "1e300 H"] {
        let outcome = motor(inductance, &[]);
        assert_eq!((outcome.exit, outcome.out.as_str()), (Exit::Refused, ""), "{inductance}");
        assert!(outcome.err.contains("50mH") || outcome.err.contains("as 3 mH"), "{}", outcome.err);
    }
    for (steps, said) in [("1.8", "write steps_per_rev = 200"), ("200.5", "whole number"), ("0", "20 to 10000")] {
        let outcome = motor("3mH", &["--steps-per-rev", steps]);
        assert_eq!(outcome.exit, Exit::Refused);
        assert!(outcome.err.contains(said), "{}", outcome.err);
    }
}

/// A motor on an Uno, and its motion.
fn one_motor(motion: &str) -> String {
    format!(
        "board = \"uno\"\n[motor.m]\nsteps_per_rev = 200\ndriver = \"A4988\"\npins = {{ step = 8, dir = 9 }}\nforward = \"high\"\n\
         pull_in = \"3000 step/s\"\n[[motion]]\nmotor = \"m\"\n{motion}\n"
    )
}

/// Two motors that draw a circle, over and over.
fn circles(repeat: &str) -> String {
    let motor = |name: &str, [step, dir]: [u8; 2]| {
        format!(
            "[motor.{name}]\nsteps_per_rev = 200\ndriver = \"A4988\"\npins = {{ step = {step}, dir = {dir} }}\nforward = \"high\"\n\
             lead = \"8 mm\"\nmax_speed = \"100 mm/s\"\nmax_acceleration = \"1000 mm/s^2\"\n"
        )
    };
    format!(
        "board = \"uno\"\n{}{}[machine.table]\nkind = \"xy\"\nmotors = [\"x\", \"y\"]\n[[motion]]\nmachine = \"table\"\n\
         ease = \"0.5 s\"\n{repeat}\npath.circle = {{ radius = \"1 mm\", period = \"1 s\" }}\n",
        motor("x", [8, 9]),
        motor("y", [10, 11])
    )
}

/// Each of these once ran for days without a message.
#[test]
fn long_motions_are_not_begun_without_a_word() {
    let folder = Folder::new("long");
    let file = folder.path("long.toml");
    let sine = "sine = { amplitude = \"1 rev\", period = \"1 s\", cycles = 1_000_000_000 }";
    let forever = "law.sine = { amplitude = \"1 rev\", period = \"1 s\", cycles = \"forever\" }";
    let motions: &[(String, &[&str])] = &[
        (one_motor("law.sine = { amplitude = \"1 rev\", period = \"1 s\", cycles = 1e18 }"), &[]),
        (one_motor("law.sine = { amplitude = \"1 rev\", period = \"1 s\", cycles = 1_000_000_000_000_000_000 }"), &[]),
        // It makes no step, since the first step is at half a step.
        (one_motor("law.sine = { amplitude = \"0.1 step\", period = \"1 s\", cycles = 1e9 }"), &[]),
        (one_motor(forever), &["--for", "1e9 s"]),
        (one_motor("repeat = 1e9\nlaw.sine = { amplitude = \"1 rev\", period = \"1 s\" }"), &[]),
        (
            one_motor(&format!("law.sum = [{{ {sine} }}, {{ sine = {{ amplitude = \"1 rev\", period = \"7 s\" }} }}]")),
            &[],
        ),
        (
            one_motor(
                "law.then = [{ rest = \"1 s\" }, { repeat = { times = 1e9, law.sine = { amplitude = \"1 rev\", period = \"1 s\" } } }]",
            ),
            &[],
        ),
        (one_motor("law.formula = { theta = \"sin(t)\", unit = \"rev\", duration = \"1e9 s\" }"), &[]),
        (
            one_motor(forever).replace("pull_in", "backlash = { slack = \"1 step\", over = \"10 ms\" }\npull_in"),
            &["--for", "1e9 s"],
        ),
        (circles("repeat = 1e9"), &[]),
        (circles("repeat = \"forever\""), &["--for", "1e9 s"]),
    ];
    let (image, capture, picture) = (folder.path("long.hex"), folder.path("steps.csv"), folder.path("long.svg"));
    std::fs::write(&capture, "time_s,motor,tick,direction,position_steps\n0.5,m,8000000,1,1\n").unwrap();
    let out = folder.path("out");
    let commands: [&[&str]; 7] = [
        &["plan", &file],
        &["run", &file, "--out", &out],
        &["run", &file, "--native", "--out", &out],
        &["plot", &file, "--out", &picture],
        &["verify", &capture, &file],
        &["explain", &file],
        &["bake", &file, "--output", &image],
    ];
    for (text, more) in motions {
        std::fs::write(&file, text).unwrap();
        for command in commands {
            let outcome = pulsetrain(&[command, more].concat());
            assert_eq!(
                (outcome.exit, outcome.out.as_str()),
                (Exit::Refused, ""),
                "{command:?} {text}\n{}",
                outcome.err
            );
            let said = outcome.err.split_whitespace().collect::<Vec<_>>().join(" ").replace(" │ ", " ");
            let all = ["long.toml: this motion is ", "about ", " steps in ", " years", " of planning", "--yes"];
            assert!(all.iter().all(|part| said.contains(part)), "{command:?} {text}\n{said}");
            assert_eq!(command[0] == "run", said.contains(" of files"), "{said}");
        }
        let said = pulsetrain(&[&["plan", &file, "--json"], *more].concat()).out;
        let said: serde_json::Value = serde_json::from_str(&said).unwrap();
        assert!(said["help"].as_str().unwrap().contains("--yes"), "{said}");
        assert!(said["estimate"]["motion_s"].as_f64().unwrap() >= 9e8, "{said}");
        assert!(said["estimate"]["planning_s"].as_f64().unwrap() > 60.0, "{said}");
        // Its beginning alone is a usual motion.
        if more.is_empty() {
            let outcome = pulsetrain(&["plan", &file, "--for", "2 s"]);
            assert_eq!(outcome.exit, Exit::Success, "{text}\n{}", outcome.err);
        }
    }
    assert!(!std::path::Path::new(&out).exists() && !std::path::Path::new(&image).exists());
}

/// An Uno's clock ends after 2^62 ticks of 62.5 ns.
#[test]
fn what_no_board_counts_is_refused_whatever_is_said() {
    let folder = Folder::new("too-long");
    let file = folder.path("long.toml");
    std::fs::write(&file, one_motor("law.sine = { amplitude = \"1 rev\", period = \"1 s\", cycles = 1e18 }")).unwrap();
    for command in ["plan", "explain"] {
        let outcome = pulsetrain(&[command, &file, "--yes"]);
        assert_eq!(outcome.exit, Exit::Refused);
        let said = outcome.err.split_whitespace().collect::<Vec<_>>().join(" ").replace(" │ ", " ");
        let all = ["Board `uno` can count 9100 years (2.88e11 s) at most.", "(--yes does not help.)"];
        assert!(all.iter().all(|part| said.contains(part)), "{said}");
    }
}

/// The first seconds of a formula say nothing about its later hours.
#[test]
fn formulas_whose_rate_changes_are_estimated_over_their_whole_span() {
    let folder = Folder::new("changing");
    let file = folder.path("changing.toml");
    let of = |law: &str| {
        std::fs::write(&file, one_motor(&format!("law.formula = {{ {law} }}"))).unwrap();
        Estimate::of(&load::endless(file.as_ref(), None).unwrap(), None, Task::Plan)
    };
    let burst = of("theta = \"if(t < 3, 0.01*sin(2*pi*1000*t), 0)\", unit = \"rev\", duration = \"1 h\"");
    assert!(!burst.is_much() && burst.steps < 3e4, "{burst}");
    let faster = of("theta = \"0.01*sin(0.02*t^2)\", unit = \"rev\", duration = \"100000 s\"");
    assert!(faster.steps > 2e8, "{faster}");
    let planned = pulsetrain(&["plan", &file]);
    assert_eq!(planned.exit, Exit::Refused);
    assert!(planned.err.contains("--yes"), "{}", planned.err);
}

#[test]
fn a_long_motion_that_is_meant_is_begun() {
    let folder = Folder::new("meant");
    let file = folder.path("long.toml");
    // 65 million steps at one speed take no time to plan.
    std::fs::write(&file, one_motor("law.speed = { speed = \"3000 step/s\", duration = \"6 h\" }")).unwrap();
    assert_eq!(pulsetrain(&["plan", &file]).exit, Exit::Refused);
    let said: serde_json::Value = serde_json::from_str(&pulsetrain(&["plan", &file, "--yes", "--json"]).out).unwrap();
    assert_eq!(said["motors"][0]["steps"], 64_800_000);
}

/// Reversals take time, also where there are few steps. If it is more than 5 s, the command says so before it begins.
#[test]
fn waits_are_said_beforehand() {
    let folder = Folder::new("waits");
    let file = folder.path("trembles.toml");
    let trembles = |seconds: u32| {
        let law = format!("theta = \"0.5*sin(2*pi*1e4*t)\", unit = \"deg\", duration = \"{seconds} s\"");
        std::fs::write(&file, one_motor(&format!("law.formula = {{ {law} }}"))).unwrap();
        // Its beginning is too fast: nothing is planned.
        let outcome = pulsetrain(&["plan", &file]);
        assert_eq!(outcome.exit, Exit::Refused);
        outcome.err
    };
    let said = trembles(100);
    assert!(said.contains("trembles.toml: this takes a while: about 1 100 000 steps in 1.7 min, "), "{said}");
    assert!(said.contains("the speed goes from 0.0"), "{said}");
    assert!(!trembles(1).contains("this takes a while"));
    // The user is not asked about a longer one, since its beginning is refused.
    let said = trembles(1000);
    assert!(said.contains("the speed goes from 0.0") && !said.contains("this motion is long"), "{said}");
    let outcome = pulsetrain(&["explain", &file]);
    assert!(outcome.err.contains("this motion is long: "), "{}", outcome.err);
    // A native board looks at each second of the days between two steps.
    std::fs::write(folder.path("slow.csv"), "0,0\n1e6,1\n").unwrap();
    std::fs::write(&file, one_motor("law.table = { file = \"slow.csv\", unit = \"deg\" }")).unwrap();
    let slow = load::endless(file.as_ref(), None).unwrap();
    let estimate = Estimate::of(&slow, None, Task::Native { files: true });
    assert!(!estimate.is_much() && estimate.running_s.is_some_and(|s| (5.0..60.0).contains(&s)), "{estimate}");
    assert!(pulsetrain(&["plan", &example("tutorial.toml")]).err.is_empty());
}

#[test]
fn an_hour_is_begun_at_once_and_estimates_are_near() {
    let hour = Some(Time::from_ratio(3600, 1));
    let of =
        |name: &str, length, task| Estimate::of(&load::endless(example(name).as_ref(), None).unwrap(), length, task);
    for task in [Task::Plan, Task::Virtual, Task::Native { files: true }, Task::Port] {
        let estimate = of("sweep.toml", hour, task);
        assert!(!estimate.is_much(), "{estimate}");
        assert!((estimate.steps / 2_880_000.0 - 1.0).abs() < 0.01, "{estimate}");
    }
    for name in
        ["tutorial", "sweep-phases", "formula", "table", "circle", "lorenz", "winch", "delta", "pico", "max-speed"]
    {
        let estimate = of(&format!("{name}.toml"), None, Task::Plan);
        let said = pulsetrain(&["plan", &example(&format!("{name}.toml")), "--json"]).out;
        let said: serde_json::Value = serde_json::from_str(&said).unwrap();
        let steps: f64 = said["motors"].as_array().unwrap().iter().map(|motor| motor["steps"].as_f64().unwrap()).sum();
        assert!((0.8..1.25).contains(&(estimate.steps / steps)), "{name}: {estimate}, and {steps} steps");
    }
    let folder = Folder::new("estimated");
    for (name, length) in
        [("tutorial.toml", None), ("sweep.toml", Some(Time::from_ratio(20, 1))), ("circle.toml", None)]
    {
        let out = folder.path(name);
        let length_s = length.map_or_else(|| "1000 s".to_owned(), |length| format!("{} s", length.seconds()));
        let outcome = pulsetrain(&["run", &example(name), "--native", "--for", &length_s, "--out", &out]);
        assert_eq!(outcome.exit, Exit::Success, "{}", outcome.err);
        let size = |file: &str| std::fs::metadata(format!("{out}/{file}")).unwrap().len() as f64;
        let (is, estimate) = (size("steps.csv") + size("trace.vcd"), of(name, length, Task::Native { files: true }));
        let about = estimate.file_bytes.unwrap();
        assert!((0.75..1.35).contains(&(about / is)), "{name}: {about} B estimated, {is} B written");
    }
}

/// The planner keeps the limits in the file. The output says once what the file does not limit.
#[test]
fn motors_without_max_acceleration_are_named_in_one_line() {
    let lines = |outcome: &Outcome| -> Vec<String> {
        outcome
            .out
            .lines()
            .filter(|line| line.contains("max_acceleration"))
            .map(|line| line.trim().to_owned())
            .collect()
    };
    let one = "wheel has no max_acceleration: this motion asks for up to 98.7 rev/s². Can the motor follow?";
    assert_eq!(lines(&pulsetrain(&["plan", &example("tutorial.toml")])), [one]);
    let said: serde_json::Value =
        serde_json::from_str(&pulsetrain(&["plan", &example("tutorial.toml"), "--json"]).out).unwrap();
    assert_eq!(
        (&said["notes"][0], &said["motors"][0]["max_acceleration_steps_per_s2"]),
        (&one.into(), &serde_json::Value::Null)
    );
    let two = "left and right have no max_acceleration: this motion asks for up to 17.5 rev/s². Can the motors follow?";
    assert_eq!(lines(&pulsetrain(&["plan", &example("compare-pins.toml")])), [two]);
    let limited = pulsetrain(&["plan", &example("max-speed.toml"), "-v"]);
    assert_eq!(lines(&limited), [""; 0]);
    assert!(limited.out.contains("= 50 rev/s² at "), "{}", limited.out);
    let folder = Folder::new("unlimited");
    let run = pulsetrain(&["run", &example("tutorial.toml"), "--native", "--out", &folder.path("run")]);
    assert_eq!(lines(&run), [one]);
}

#[test]
fn plans() {
    check(&["plan", &example("tutorial.toml")], Exit::Success, expect_file!["golden/plan-tutorial.txt"]);
    check(&["plan", &example("tutorial-0.01s.toml")], Exit::Refused, expect_file!["golden/plan-too-fast.txt"]);
    let json = pulsetrain(&["plan", &example("sweep.toml"), "--for", "2 s", "--json"]).out;
    let report: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(report["cut_at_s"], 2.0);
    assert_eq!(report["motors"].as_array().unwrap().len(), 4);
}

/// Each parameter of a formula with its values: one inside sin, another one in the motion's unit.
#[test]
fn a_plan_says_what_a_formula_s_parameters_are() {
    let folder = Folder::new("parameters");
    let motor = |name: &str, pins: &str| {
        format!(
            "[motor.{name}]\nsteps_per_rev = 200\nmicrosteps = 4\ndriver = \"A4988\"\npins = {{ {pins} }}\nforward = \"high\"\n"
        )
    };
    let formula = "law.formula = { theta = \"A*(1 - sin(phi)) + A*sin(2*pi*f*t/T - phi)*sin(w*t)^2 + k*t\", unit = \"deg\", \
                   duration = \"2 s\", where = { A = \"0.25 rev\", phi = \"90 deg\", f = \"0.5 Hz\", T = \"2000 ms\", \
                   w = \"3.141592653589793 rad/s\", k = 3, b = \"1 deg/s^2\" } }";
    let motion = format!("[[motion]]\nmotors = [\"left\", \"right\"]\nease = \"0.5 s\"\n{formula}\n");
    let file = folder.path("parameters.toml");
    let text = format!(
        "board = \"native\"\n{}{}{motion}{motion}",
        motor("left", "step = 2, dir = 3"),
        motor("right", "step = 4, dir = 5")
    );
    std::fs::write(&file, text).unwrap();
    let outcome = pulsetrain(&["plan", &file, "-v"]);
    assert_eq!(outcome.exit, Exit::Success, "{}", outcome.err);
    let lines: Vec<&str> = outcome.out.lines().filter(|line| line.contains("parameters of")).collect();
    let wanted = "  parameters of left, right: A = 0.25 rev (90 deg), phi = 90 deg (1.570796 rad in sin), f = 0.5 Hz, \
                  T = 2000 ms (2 s), w = 3.141592653589793 rad/s, k = 3, b = 1 deg/s^2 (not used)";
    assert_eq!(lines, [wanted], "{}", outcome.out);
    let report: serde_json::Value = serde_json::from_str(&pulsetrain(&["plan", &file, "--json"]).out).unwrap();
    let formulas = report["motors"][1]["formulas"].as_array().unwrap();
    assert_eq!(formulas.len(), 1);
    let phi = &formulas[0]["parameters"][1];
    assert_eq!(phi["written"], "90 deg");
    assert_eq!(phi["outside"], serde_json::Value::Null);
    assert_eq!(phi["in_trig"]["unit"], "rad");
    assert!((phi["in_trig"]["value"].as_f64().unwrap() - std::f64::consts::FRAC_PI_2).abs() < 1e-15);
}

#[test]
fn a_script_hears_of_a_refusal_too() {
    let outcome = pulsetrain(&["plan", &example("tutorial-0.01s.toml"), "--json"]);
    assert_eq!(outcome.exit, Exit::Refused);
    let said: serde_json::Value = serde_json::from_str(&outcome.out).unwrap();
    assert!(said["message"].as_str().unwrap().contains(" steps/s at most"), "{said}");
    assert!(outcome.err.contains(" steps/s at most"), "{}", outcome.err);
}

#[test]
fn explanations() {
    check(&["explain", &example("tutorial-0.01s.toml")], Exit::Refused, expect_file!["golden/explain-too-fast.txt"]);
    check(&["explain", &example("s-curve.toml")], Exit::Success, expect_file!["golden/explain-s-curve.txt"]);
}

/// Two motors, three limits, one of them the board's: the first one is met, and all are printed.
#[test]
fn all_that_a_motion_breaks_is_explained() {
    let folder = Folder::new("breaks");
    let file = folder.path("breaks.toml");
    let motor = |name: &str, [step, dir]: [u8; 2], limits: &str| {
        format!(
            "[motor.{name}]\nsteps_per_rev = 200\nmicrosteps = 16\ndriver = \"A4988\"\npins = {{ step = {step}, dir = {dir} }}\n\
             forward = \"high\"\n{limits}\n"
        )
    };
    let laws = "[[motion]]\nmotor = \"a\"\nlaw.sine = { amplitude = \"1 rev\", period = \"0.7 s\" }\n\
                [[motion]]\nmotor = \"b\"\nlaw.speed = { speed = \"30 rev/s\", duration = \"1 s\" }\n\
                [[motion]]\nmotor = \"c\"\nlaw.sine = { amplitude = \"0.1 rev\", period = \"2 s\" }\n";
    let text = format!(
        "board = \"uno\"\n{}{}{}{laws}",
        motor("a", [2, 5], "max_speed = \"3 rev/s\"\nmax_acceleration = \"20 rev/s^2\""),
        motor("b", [3, 6], "max_speed = \"40 rev/s\""),
        motor("c", [4, 7], "max_speed = \"3 rev/s\""),
    );
    std::fs::write(&file, text).unwrap();
    let outcome = pulsetrain(&["explain", &file]);
    let refused = outcome.out.split("\n\n").next().unwrap();
    let told = |motor: &str, what: &str| {
        refused.lines().any(|line| line.starts_with(&format!("  motor {motor}: ")) && line.contains(what))
    };
    let all = [("a", "the law runs at"), ("a", "accelerates"), ("b", "at once"), ("b", "the board makes")];
    assert!(all.iter().all(|(motor, what)| told(motor, what)), "{}", outcome.out);
    assert_eq!(refused.lines().count(), 1 + all.len(), "each once, and c breaks nothing: {refused}");
    let said: serde_json::Value = serde_json::from_str(&pulsetrain(&["explain", &file, "--json"]).out).unwrap();
    assert_eq!(said["refusal"]["also"].as_array().map(Vec::len), Some(all.len() - 1), "{said}");
}

/// With a gear the wrong way round nothing moves, which is no error; but the output says so.
#[test]
fn a_motor_whose_motion_makes_no_step_is_named() {
    let folder = Folder::new("still");
    let file = folder.path("still.toml");
    let plan = |gear: &str| {
        let text = format!(
            "board = \"pico\"\n[motor.pump]\nsteps_per_rev = 32\nmicrosteps = 2\ngear = \"{gear}\"\ndriver = \"ULN2003\"\n\
             pins = {{ in = [6, 7, 8, 9] }}\n[[motion]]\nmotor = \"pump\"\nlaw.sine = {{ amplitude = \"0.05 rev\", period = \"3 s\" }}\n"
        );
        std::fs::write(&file, text).unwrap();
        let outcome = pulsetrain(&["plan", &file]);
        assert_eq!(outcome.exit, Exit::Success, "{}", outcome.err);
        outcome.out
    };
    let note = "pump makes no step";
    assert!(plan("25792:405").contains(note), "{}", plan("25792:405"));
    assert!(!plan("405:25792").contains(note), "{}", plan("405:25792"));
}

/// The length of an endless motion is not printed.
#[test]
fn what_never_ends_is_told_no_other_length() {
    let folder = Folder::new("endless");
    let file = folder.path("endless.toml");
    let refused = |cycles: &str| {
        let text = format!(
            "board = \"uno\"\n[motor.m]\nsteps_per_rev = 200\ndriver = \"A4988\"\npins = {{ step = 2, dir = 5 }}\nforward = \"high\"\n\
             max_speed = \"1 rev/s\"\n[[motion]]\nmotor = \"m\"\nlaw.sine = {{ amplitude = \"1 rev\", period = \"1 s\", cycles = {cycles} }}\n"
        );
        std::fs::write(&file, text).unwrap();
        let outcome = pulsetrain(&["plan", &file]);
        assert_eq!(outcome.exit, Exit::Refused);
        outcome.err
    };
    assert!(refused("3").contains("times slower it fits: 18."), "{}", refused("3"));
    let said = refused("\"forever\"");
    assert!(said.contains("times slower it fits") && !said.contains("instead of"), "{said}");
}

/// If the disk is full, the error comes after the verdict, not in its place.
#[cfg(target_os = "linux")]
#[test]
fn a_verdict_is_told_where_its_files_have_no_room() {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/winch-script.txt").to_owned();
    let commands = [
        (vec!["run".to_owned(), example("tutorial.toml")], "\nPASS: "),
        (vec!["winch".to_owned(), script], "\nPASS\n"),
    ];
    for (command, verdict) in commands {
        for name in ["report.json", "plot.svg"] {
            let folder = Folder::new("verdict-full");
            std::os::unix::fs::symlink("/dev/full", folder.0.join(name)).unwrap();
            let out = folder.0.display().to_string();
            let args: Vec<&str> = command.iter().map(String::as_str).chain(["--native", "--out", &out]).collect();
            let outcome = pulsetrain(&args);
            assert_eq!(outcome.exit, Exit::Refused);
            assert!(outcome.out.contains(verdict) && !outcome.out.contains("report.json"), "{}", outcome.out);
            assert!(outcome.err.contains("cannot write") && outcome.err.contains(name), "{}", outcome.err);
            let outcome = pulsetrain(&[&args[..], &["--json"]].concat());
            assert_eq!(outcome.exit, Exit::Refused);
            let said: serde_json::Value = serde_json::from_str(&outcome.out).expect("one value");
            let pass = if command[0] == "run" { &said["pass"] } else { &said["verdict"]["ok"] };
            assert_eq!(*pass, true, "{said}");
            assert!(said["unwritten"].as_str().unwrap().contains(name), "{said}");
            assert!(outcome.err.contains("cannot write"), "{}", outcome.err);
            crate::json::conforms(&command[0], &said);
        }
    }
}

/// The files of every edge and step, and a folder that cannot be: the error names the file and the way out, after the verdict.
#[cfg(target_os = "linux")]
#[test]
fn every_file_that_cannot_be_written_is_named_after_the_verdict() {
    let check = |name: &str, place: &str, why: &str| {
        let folder = Folder::new("unwritten");
        let out = folder.path("out");
        std::fs::write(folder.0.join("file"), "").unwrap();
        std::fs::create_dir(&out).unwrap();
        match place {
            "full" => std::os::unix::fs::symlink("/dev/full", format!("{out}/{name}")).unwrap(),
            "folder" => std::fs::create_dir(format!("{out}/{name}")).unwrap(),
            _ => {}
        }
        let out = if place == "file" { folder.path("file/out") } else { out };
        let outcome = pulsetrain(&["run", &example("tutorial.toml"), "--native", "--out", &out]);
        assert_eq!(outcome.exit, Exit::Refused, "{}", outcome.out);
        assert!(outcome.out.starts_with("PASS") && outcome.out.ends_with("PASS: no bound broke\n"), "{}", outcome.out);
        let said = outcome.err.replace('│', " ").split_whitespace().collect::<Vec<_>>().join(" ");
        for part in [name, why, "--out"] {
            assert!(said.contains(part), "{place} {name}: {part} is not in {said}");
        }
        assert!(!said.contains("os error"), "{said}");
    };
    for name in ["trace.vcd", "steps.csv", "report.json", "plot.svg"] {
        check(name, "full", "the disk is full");
        check(name, "folder", "it is a folder");
    }
    check("out", "file", "a part of its path is a file, not a folder");
}

#[test]
fn several_problems_are_told_one_below_the_other() {
    let folder = Folder::new("several");
    let file = folder.path("empty.toml");
    std::fs::write(&file, "grid = \"nearest\"\n").unwrap();
    let outcome = pulsetrain(&["plan", &file]);
    assert_eq!(outcome.exit, Exit::Refused);
    let told: Vec<&str> = outcome.err.lines().filter(|line| line.contains('×')).collect();
    assert_eq!(told, ["board", "motor", "motion"].map(|key| format!("  × the motion file has no `{key}`")));
    assert!(!outcome.err.contains("Error:") && !outcome.err.contains("\n\n\n"), "{}", outcome.err);
}

/// What the advice offers fits, and a little faster than that does not.
#[test]
fn the_slowdown_that_explain_names_is_enough_and_needed() {
    let folder = Folder::new("slowdown");
    let text = std::fs::read_to_string(example("tutorial-0.01s.toml")).unwrap();
    let json = pulsetrain(&["explain", &example("tutorial-0.01s.toml"), "--json"]).out;
    let explanation: serde_json::Value = serde_json::from_str(&json).unwrap();
    let factor = explanation["refusal"]["least_slowdown"].as_f64().unwrap();
    let plan_of = |factor: f64| {
        let path = folder.path("slower.toml");
        let period = format!("period = \"{} ms\"", 10.0 * factor);
        assert!(text.contains("period = \"0.01 s\""));
        std::fs::write(&path, text.replace("period = \"0.01 s\"", &period)).unwrap();
        pulsetrain(&["plan", &path]).exit
    };
    assert_eq!(plan_of(factor), Exit::Success);
    assert_eq!(plan_of(factor * 0.98), Exit::Refused);
}

#[test]
fn the_fastest_variant_runs_on_the_native_board() {
    let folder = Folder::new("native");
    let file = example("tutorial-0.01s.toml");
    let outcome = pulsetrain(&["run", &file, "--board", "native", "--out", &folder.path("run")]);
    assert_eq!(outcome.exit, Exit::Success, "{}{}", outcome.out, outcome.err);
}

/// Every example that fits its board runs and writes its files, and the judge accepts its trace and its steps.
#[test]
fn examples_run_and_verify() {
    let folder = Folder::new("examples");
    let mut ran = 0;
    for entry in std::fs::read_dir(EXAMPLES).unwrap() {
        let path = entry.unwrap().path();
        let file = path.display().to_string();
        if path.extension().is_none_or(|ending| ending != "toml")
            || pulsetrain(&["plan", &file, "--for", "3 s"]).exit == Exit::Refused
        {
            continue;
        }
        let out = folder.0.join(path.file_stem().unwrap());
        let outcome = pulsetrain(&["run", &file, "--native", "--for", "3 s", "--out", &out.display().to_string()]);
        assert_eq!(outcome.exit, Exit::Success, "{file}: {}{}", outcome.out, outcome.err);
        for name in ["report.json", "plot.svg"] {
            assert!(out.join(name).metadata().unwrap().len() > 1000, "{file}: {name}");
        }
        for capture in ["trace.vcd", "steps.csv"] {
            let capture = out.join(capture).display().to_string();
            let outcome = pulsetrain(&["verify", &capture, &file, "--for", "3 s"]);
            assert_eq!(outcome.exit, Exit::Success, "{capture}: {}{}", outcome.out, outcome.err);
        }
        ran += 1;
    }
    assert!(ran >= 10);
}

/// A winch path that comes to rest ever more slowly near a step's level.
#[test]
fn a_path_that_comes_to_rest_at_a_level_passes() {
    let folder = Folder::new("level");
    let file = folder.path("winch.toml");
    let text = r#"
board = "native"
grid = "reach"
[motor.x]
steps_per_rev = 200
driver = "A4988"
pins = { step = 2, dir = 3 }
forward = "low"
[[motion]]
motor = "x"
law.winch = { duration = "2 s", commands = ["0 s: g x 8 1.0", "0 s: a x 71"] }
"#;
    std::fs::write(&file, text).unwrap();
    let outcome = pulsetrain(&["run", &file, "--native", "-v", "--out", &folder.path("run")]);
    assert_eq!(outcome.exit, Exit::Success, "{}{}", outcome.out, outcome.err);
    assert!(outcome.out.contains("71 of 71"), "{}", outcome.out);
}

#[test]
fn a_step_that_lacks_breaks_a_bound() {
    let folder = Folder::new("mutant");
    let file = example("tutorial.toml");
    pulsetrain(&["run", &file, "--native", "--out", &folder.path("run")]);
    let steps = std::fs::read_to_string(folder.0.join("run/trace.vcd")).unwrap();
    // Without the 1000th pulse, which is a rise and a fall of STEP.
    let mut edges = 0;
    let step_code =
        steps.lines().find(|line| line.starts_with("$var")).and_then(|line| line.split(' ').nth(3)).unwrap();
    let kept: Vec<&str> = steps
        .lines()
        .filter(|line| {
            let of_step = line.len() == 1 + step_code.len() && line.ends_with(step_code);
            edges += usize::from(of_step);
            !(of_step && (2001..=2002).contains(&edges))
        })
        .collect();
    let mutant = folder.path("mutant.vcd");
    std::fs::write(&mutant, kept.join("\n") + "\n").unwrap();
    let outcome = pulsetrain(&["verify", &mutant, &file]);
    assert_eq!(outcome.exit, Exit::BoundBroken, "{}{}", outcome.out, outcome.err);
    assert!(outcome.out.contains("FAIL"), "{}", outcome.out);
}

/// DIR goes through an inverter, or `forward` was changed in the file after the run.
#[test]
fn a_reversed_dir_is_named() {
    let folder = Folder::new("reversed");
    let text = std::fs::read_to_string(example("tutorial.toml")).unwrap();
    let [now, then] = if text.contains("forward = \"low\"") { ["low", "high"] } else { ["high", "low"] };
    let file = folder.path("reversed.toml");
    std::fs::write(&file, text.replace(&format!("forward = \"{now}\""), &format!("forward = \"{then}\""))).unwrap();
    let right = example("tutorial.toml");
    pulsetrain(&["run", &right, "--native", "--out", &folder.path("run")]);
    let capture = folder.path("run/trace.vcd");
    let outcome = pulsetrain(&["verify", &capture, &file]);
    assert_eq!(outcome.exit, Exit::BoundBroken, "{}{}", outcome.out, outcome.err);
    let hint =
        format!("DIR of wheel is reversed: the file says forward = \"{then}\", and each step is right with \"{now}\"");
    let advice = format!("Write forward = \"{now}\" in [motor.wheel]");
    assert!(outcome.out.contains(&hint) && outcome.out.contains(&advice), "{}", outcome.out);
    // What is wrong in another way is not called reversed.
    std::fs::write(&file, text.replace("2.5 rev", "2.6 rev")).unwrap();
    let outcome = pulsetrain(&["verify", &capture, &file]);
    assert!(outcome.exit == Exit::BoundBroken && !outcome.out.contains("reversed"), "{}", outcome.out);
}

/// An analyser's names for its channels have no meaning; the user gives it. The last line of a capture may lack a
/// newline.
#[test]
fn channels_are_what_the_user_says() {
    let folder = Folder::new("channels");
    let file = example("tutorial.toml");
    pulsetrain(&["run", &file, "--native", "--out", &folder.path("run")]);
    let trace = std::fs::read_to_string(folder.0.join("run/trace.vcd")).unwrap();
    let renamed = ["step", "dir", "pin8", "pin9"].iter().enumerate();
    let trace =
        renamed.fold(trace, |trace, (n, name)| trace.replace(&format!(" {name} $end"), &format!(" ch{n} $end")));
    let capture = folder.path("capture.vcd");
    std::fs::write(&capture, trace.trim_end()).unwrap();
    let check = |more: &[&str], exit: Exit, says: &str| {
        let outcome = pulsetrain(&[&["verify", &capture, &file], more].concat());
        assert_eq!(outcome.exit, exit, "{}{}", outcome.out, outcome.err);
        assert!((outcome.out + &outcome.err).contains(says), "{says}");
    };
    check(&[], Exit::Refused, "says which channel is which line");
    check(&["--line", "wheel.ch0=wheel.step", "--line", "wheel.ch1=wheel.dir"], Exit::Success, "PASS");
    check(&["--line", "wheel.ch0=wheel.dir", "--line", "wheel.ch1=wheel.step"], Exit::BoundBroken, "are swapped");
    check(&["--line", "ch7=wheel.step"], Exit::Refused, "no line called ch7");
    check(&["--line", "wheel.ch00=wheel.step"], Exit::Refused, "did you mean wheel.ch0?");
    check(&["--line", "wheel.ch0=wheel.stp"], Exit::Refused, "did you mean wheel.step?");
    check(&["--line", "wheel.ch0=weel.dir"], Exit::Refused, "did you mean wheel.dir?");
    check(&["--line", "wheel.ch0=motor"], Exit::Refused, "the lines are wheel.step");
    check(&["--line", "Wheel.step=wheel.ch0"], Exit::Refused, "write --line \"wheel.ch0=wheel.step\"");
    check(&["--line", "ch0"], Exit::Refused, "Channel 0=wheel.step");
    let steps = folder.path("run/steps.csv");
    let outcome = pulsetrain(&["verify", &steps, &file, "--line", "a=wheel.step"]);
    assert!(outcome.err.contains("has no lines"), "{}", outcome.err);
}

/// A capture of an endless motion ends during the motion, without the planned stop.
#[test]
fn a_capture_is_judged_as_far_as_the_user_says() {
    let folder = Folder::new("until");
    let file = example("sweep.toml");
    pulsetrain(&["run", &file, "--native", "--for", "3 s", "--out", &folder.path("run")]);
    let steps = std::fs::read_to_string(folder.0.join("run/steps.csv")).unwrap();
    let before = |line: &&str| {
        line.split(',').nth(2).and_then(|tick| tick.parse().ok()).is_none_or(|tick: u64| tick < 33_000_000)
    };
    let capture = folder.path("capture.csv");
    let cut: Vec<&str> = steps.lines().filter(before).collect();
    std::fs::write(&capture, cut.join("\n")).unwrap();
    let check = |more: &[&str], exit: Exit| {
        let outcome = pulsetrain(&[&["verify", &capture, &file], more].concat());
        assert_eq!(outcome.exit, exit, "{more:?}: {}{}", outcome.out, outcome.err);
    };
    check(&["--until", "2 s"], Exit::Success);
    check(&["--until", "2.1 s"], Exit::BoundBroken);
    check(&["--for", "2 s"], Exit::BoundBroken);
    check(&["--until", "2 s", "--for", "2 s"], Exit::Refused);
}

#[test]
fn a_plan_says_how_tables_were_read() {
    let folder = Folder::new("columns");
    let text = std::fs::read_to_string(example("table.toml")).unwrap();
    let (law, _) = text.split_once("law.table").unwrap();
    let file = folder.path("table.toml");
    std::fs::write(&file, format!("{law}law.table = {{ file = \"a.csv\", unit = \"deg\" }}\n")).unwrap();
    std::fs::write(folder.0.join("a.csv"), "i,t_ms,a\n0,0,0\n1,100,0\n2,1000,20\n3,1900,0\n4,2000,0\n").unwrap();
    let said = "a.csv: time = column 2 `t_ms`, ms; angle = column 3 `a`, deg; column 1 `i` is not used";
    let plan = pulsetrain(&["plan", &file]).out;
    assert!(plan.contains(&format!("\n  table {said}\n")), "{plan}");
    let run = pulsetrain(&["run", &file, "--native", "--out", &folder.path("run")]).out;
    assert!(run.contains(&format!("\n  table {said}\n")), "{run}");
    let json: serde_json::Value = serde_json::from_str(&pulsetrain(&["plan", &file, "--json"]).out).unwrap();
    let table = &json["tables"][0];
    assert_eq!((table["file"].as_str(), table["summary"].as_str()), (Some("a.csv"), Some(said)));
    assert_eq!((table["columns"][0]["is"].as_str(), table["columns"][0]["unit"].as_str()), (Some("time"), Some("ms")));
    assert_eq!(table["unused"][0].as_str(), Some("column 1 `i`"));
    // The whole file is refused: nothing is planned.
    std::fs::write(folder.0.join("a.csv"), "i,a [rad]\n0,0\n1,20\n").unwrap();
    let outcome = pulsetrain(&["plan", &file]);
    assert_eq!((outcome.exit, outcome.out.as_str()), (Exit::Refused, ""));
    assert!(outcome.err.contains("expected a column `time [s]`, found `i`, `a [rad]`"), "{}", outcome.err);
}

#[test]
fn new_files_can_be_planned_and_are_not_overwritten() {
    let folder = Folder::new("new");
    let name = folder.path("crank");
    assert_eq!(pulsetrain(&["new", &name]).exit, Exit::Success);
    assert_eq!(pulsetrain(&["plan", &folder.path("crank.toml")]).exit, Exit::Success);
    let again = pulsetrain(&["new", &name]);
    assert_eq!(again.exit, Exit::Refused);
    assert!(again.err.contains("it exists already") && again.err.contains("another name"), "{}", again.err);
}

/// Pins that the firmware cannot use together are refused before the planning, with advice.
#[test]
fn pins_apart_are_refused_with_what_fits() {
    let folder = Folder::new("pins");
    let path = folder.path("apart.toml");
    let text = std::fs::read_to_string(example("tutorial.toml")).unwrap();
    std::fs::write(&path, text.replace("dir = 9", "dir = 5")).unwrap();
    let outcome = pulsetrain(&["plan", &path]);
    assert_eq!(outcome.exit, Exit::Refused);
    let said = outcome.err.split(['│', '\n']).map(str::trim).collect::<Vec<_>>().join(" ");
    assert!(said.contains("an Uno cannot drive these pins together"), "{said}");
    for kind in pulsetrain_motion::boards::uno::PinKind::ALL {
        assert!(said.contains(&kind.to_string()), "{kind}: {said}");
    }
    assert_eq!(pulsetrain(&["plan", &path, "--board", "native"]).exit, Exit::Success);
}

fn keeps_settings(board: &str) {
    let said = |args: &[&str]| {
        let outcome = pulsetrain(&[&["store", "--board", board], args].concat());
        assert_eq!(outcome.exit, Exit::Success, "{}{}", outcome.out, outcome.err);
        outcome.out
    };
    assert_eq!(said(&[]), "the board keeps: nothing\n");
    assert_eq!(said(&["--clear"]), "the board keeps: nothing that is not its own way\n");
    let all = ["--deadman", "500ms", "--idle", "60 s", "--silence", "1.5 s", "--limits", "2500.5", "30000"];
    let told = "the board keeps: text's deadman 500 ms; text releases after 60 s of rest; a host is lost after 1.5 s; \
                axes of text at most 2500.5 steps/s and 30 000 steps/s²\n";
    assert_eq!(said(&all), told);
    let json: serde_json::Value =
        serde_json::from_str(&said(&["--deadman", "off", "--idle", "3 s", "--json"])).unwrap();
    assert_eq!((&json["deadman_ms"], &json["idle_ms"]), (&0.into(), &3000.into()));
}

/// A reader of the output that goes away, as `head` does.
struct Gone;

impl Write for Gone {
    fn write(&mut self, _: &[u8]) -> io::Result<usize> {
        Err(io::ErrorKind::BrokenPipe.into())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_broken_pipe_changes_no_exit_code() {
    let mut err = Vec::new();
    let exit = cli::run(["pulsetrain", "drivers"], &mut Gone, &mut err);
    assert_eq!((exit, err.len()), (Exit::Success, 0));
    assert_eq!(cli::run(["pulsetrain", "plan", "missing.toml"], &mut Gone, &mut Gone), Exit::Refused);
}

/// A motor of a Pico with its motion.
fn pico_motor(name: &str, step: u8, motion: &str) -> String {
    format!(
        "[motor.{name}]\nsteps_per_rev = 200\nmicrosteps = 16\ndriver = \"A4988\"\npins = {{ step = {step}, dir = {} }}\nforward = \"high\"\n\
         max_acceleration = \"20000 deg/s^2\"\n[[motion]]\nmotor = \"{name}\"\n{motion}\n",
        step + 1
    )
}

/// The verdict is at both ends of the output, and all that matters fits on a terminal of 80 × 24.
#[test]
fn eight_motors_fit_on_a_screen() {
    let folder = Folder::new("eight");
    let file = folder.path("eight.toml");
    let motors = (1..=8u8).map(|k| {
        let law = format!("law.sine = {{ amplitude = \"{}.375 deg\", period = \"{k} s\" }}", 117 * i32::from(k));
        pico_motor(&format!("motor{k}"), 2 * k, &law)
    });
    std::fs::write(&file, format!("board = \"pico\"\n{}", motors.collect::<String>())).unwrap();
    let check = |args: &[&str], first: &str| {
        let outcome = pulsetrain(args);
        assert_eq!(outcome.exit, Exit::Success, "{}{}", outcome.out, outcome.err);
        let lines: Vec<&str> = outcome.out.lines().collect();
        // The folder's name is the test's.
        let wide = |line: &&&str| line.chars().count() > 80 && !line.contains("eight");
        assert!(lines.len() <= 24 && lines.iter().find(wide).is_none(), "{}", outcome.out);
        assert!(lines[0].starts_with(first), "{}", outcome.out);
        for k in 1..=8 {
            assert_eq!(lines.iter().filter(|line| line.contains(&format!("motor{k}"))).count(), 1, "{}", outcome.out);
        }
        lines.last().map(|line| (*line).to_owned())
    };
    let out = folder.path("out");
    let last = check(&["run", &file, "--native", "--for", "8 s", "--out", &out], "PASS  ");
    assert_eq!(last.as_deref(), Some("PASS: no bound broke"));
    check(&["verify", &format!("{out}/steps.csv"), &file, "--for", "8 s"], "PASS");
    check(&["plan", &file, "--for", "8 s"], &file);
    // The rest is there for those who ask.
    let all = pulsetrain(&["run", &file, "--native", "--for", "8 s", "--out", &out, "--verbose"]).out;
    for row in ["payload", "proven error", "acceleration", "steps made", "shortest DIR hold", "drift"] {
        assert!(all.contains(row), "{row}: {all}");
    }
}

/// Positions are in the file's unit and count from where the law begins; errors are angles or lengths.
#[test]
fn ranges_and_errors_are_in_the_files_unit() {
    let folder = Folder::new("ranges");
    let report = |motor: &str, motion: &str| -> serde_json::Value {
        let file = folder.write("range.toml", &format!(
            "board = \"native\"\n[motor.m]\nsteps_per_rev = 200\nmicrosteps = 8\ndriver = \"A4988\"\npins = {{ step = 8, dir = 9 }}\n\
             forward = \"high\"\n{motor}\n[[motion]]\nmotor = \"m\"\n{motion}\n"
        ));
        let outcome = pulsetrain(&["run", &file, "--json", "--out", &folder.path("out")]);
        assert_eq!(outcome.exit, Exit::Success, "{}{}", outcome.out, outcome.err);
        serde_json::from_str(&outcome.out).unwrap()
    };
    let check = |report: &serde_json::Value, expected: [f64; 6], units: [&str; 2]| {
        let motor = &report["motors"][0];
        let keys = ["start", "lowest", "highest", "end", "top_speed_per_s", "top_speed_rpm"];
        for (key, expected) in keys.into_iter().zip(expected) {
            let found = motor[key].as_f64().unwrap();
            assert!((found - expected).abs() < 1e-3 * expected.abs().max(1.0), "{key}: {found}, not {expected}");
        }
        assert_eq!([motor["unit"].as_str(), report["errors"][0]["unit"].as_str()], units.map(Some));
        // Half a tick of 1 ns at top speed is the distance that goes with the time.
        let error = &report["errors"][0];
        let (us, distance) = (error["worst_us"].as_f64().unwrap(), error["worst"].as_f64().unwrap());
        let per_s = expected[4] * if units[0] == "rev" { 360.0 } else { 1.0 };
        assert!(us > 0.0 && distance <= 1.001 * us * 1e-6 * per_s, "{us} µs, {distance}");
    };
    let turns = report(
        "",
        "law.formula = { theta = \"90 + 45*sin(2*pi*t)\", unit = \"deg\", duration = \"1 s\" }\nbegin = \"jump\"\nend = \"jump\"",
    );
    check(&turns, [90.0, 45.0, 135.0, 90.0, 282.74, 47.12], ["deg", "deg"]);
    let slides = report(
        "lead = \"8 mm\"",
        "law.trapezoid = { distance = \"-20 mm\", speed = \"40 mm/s\", acceleration = \"400 mm/s^2\" }",
    );
    check(&slides, [0.0, -20.0, 0.0, -20.0, 40.0, 300.0], ["mm", "mm"]);
    let revs = report("", "law.sine = { amplitude = \"1 rev\", period = \"2 s\", cycles = 1 }");
    check(&revs, [0.0, 0.0, 2.0, 0.0, std::f64::consts::PI, 188.5], ["rev", "deg"]);
}

/// A capture that is right, but begins elsewhere or ends early, fails with the option that makes it pass; and with that it passes.
#[test]
fn verify_says_what_would_make_a_capture_pass() {
    let folder = Folder::new("hints");
    let file = example("tutorial.toml");
    pulsetrain(&["run", &file, "--native", "--out", &folder.path("run")]);
    let steps = std::fs::read_to_string(folder.0.join("run/steps.csv")).unwrap();
    let changed = |name: &str, change: &dyn Fn(u64) -> Option<u64>| {
        let mut lines = steps.lines();
        let mut text = format!("{}\n", lines.next().unwrap());
        for line in lines {
            let fields: Vec<&str> = line.split(',').collect();
            let Some(tick) = change(fields[2].parse().unwrap()) else { continue };
            text.push_str(&format!("{},{},{tick},{},{}\n", tick as f64 / 16e6, fields[1], fields[3], fields[4]));
        }
        folder.write(name, &text)
    };
    let check = |capture: &str, hint: &str, flags: &[&str]| {
        let outcome = pulsetrain(&["verify", capture, &file]);
        assert_eq!(outcome.exit, Exit::BoundBroken, "{}", outcome.out);
        assert!(outcome.out.contains(hint), "{hint}: {}", outcome.out);
        let outcome = pulsetrain(&[&["verify", capture, &file], flags].concat());
        assert_eq!(outcome.exit, Exit::Success, "{}", outcome.out);
    };
    let late = changed("late.csv", &|tick| Some(tick + 4_000_000));
    check(&late, "With --align start+rate it passes: the motion begins at 250 ms", &["--align", "start+rate"]);
    let stopped = changed("stopped.csv", &|tick| (tick < 6_000_000).then_some(tick));
    check(&stopped, "Up to 0.375 s every step is right.", &["--until", "0.375 s"]);
    // A capture that is wrong in its middle is not made right by anything.
    let wrong =
        changed("wrong.csv", &|tick| Some(if tick > 6_000_000 && tick < 7_000_000 { tick + 400 } else { tick }));
    let outcome = pulsetrain(&["verify", &wrong, &file]);
    assert_eq!(outcome.exit, Exit::BoundBroken);
    assert!(outcome.out.ends_with("FAIL: a bound broke: wheel\n"), "{}", outcome.out);
}

#[test]
fn a_rate_for_a_board_without_a_line_is_refused() {
    let folder = Folder::new("no-line");
    for command in ["plan", "explain", "run"] {
        for board in ["native", "due"] {
            let args = [command, &example("tutorial.toml"), "--board", board, "--baud", "1000000"];
            let out = folder.path("out");
            let more: &[&str] = if command == "run" { &["--out", &out] } else { &[] };
            let outcome = pulsetrain(&[&args[..], more].concat());
            assert_eq!((outcome.exit, outcome.out.as_str()), (Exit::Refused, ""), "{args:?}");
            assert!(outcome.err.contains("leave --baud out"), "{}", outcome.err);
        }
    }
}

#[test]
fn a_motion_without_a_step_says_so() {
    let folder = Folder::new("no-step");
    let file =
        folder.write("still.toml", &one_motor("law.sine = { amplitude = \"0.1 step\", period = \"1 s\", cycles = 1 }"));
    for command in [&["plan", &file][..], &["run", &file, "--native", "--out", &folder.path("out")]] {
        let outcome = pulsetrain(command);
        assert_eq!(outcome.exit, Exit::Success, "{}", outcome.err);
        assert!(outcome.out.contains("This motion makes no step: nothing moves."), "{}", outcome.out);
    }
}

/// The other boards that are named can drive the pins that the file has.
#[test]
fn boards_whose_pins_do_not_fit_are_not_offered() {
    let folder = Folder::new("offered");
    let said = |pins: &str| {
        let text = std::fs::read_to_string(example("tutorial-0.01s.toml")).unwrap();
        assert!(text.contains("step = 8, dir = 9"));
        let file = folder.write("fast.toml", &text.replace("step = 8, dir = 9", pins));
        let said: serde_json::Value = serde_json::from_str(&pulsetrain(&["explain", &file, "--json"]).out).unwrap();
        said["refusal"]["other_boards"].to_string()
    };
    assert!(said("step = 8, dir = 9").contains("pico"));
    // A Pico wants DIR next to STEP.
    assert!(!said("step = 8, dir = 11").contains("pico"), "{}", said("step = 8, dir = 11"));
}

/// An SVG in a file that is called PNG opens nowhere.
#[test]
fn a_moving_picture_is_an_svg_with_the_law_of_its_motor() {
    let folder = Folder::new("moving");
    let png = folder.path("moving.png");
    let outcome = pulsetrain(&["plot", &example("first-uno.toml"), "--moving", "--out", &png]);
    let said = outcome.err.replace('│', " ").split_whitespace().collect::<Vec<_>>().join(" ");
    assert_eq!(outcome.exit, Exit::Refused, "{said}");
    assert!(said.contains("a moving picture is an SVG file") && said.contains("moving.svg"), "{said}");
    assert!(!std::path::Path::new(&png).exists());

    // The second motor's law is in the last line; a law in a comment is none.
    let one = pico_motor(
        "one",
        2,
        "# law.rest = { duration = \"9 s\" }\nlaw.sine = { amplitude = \"10 deg\", period = \"1 s\" }",
    );
    let two = pico_motor("two", 4, "law.sine = { amplitude = \"20 deg\", period = \"1 s\" }");
    let file = folder.write("two.toml", &format!("board = \"pico\"\n{one}{two}"));
    for (motor, amplitude) in [("one", 10), ("two", 20)] {
        let svg = folder.path("moving.svg");
        let outcome = pulsetrain(&["plot", &file, "--moving", "--motor", motor, "--out", &svg]);
        assert_eq!(outcome.exit, Exit::Success, "{}", outcome.err);
        let title = format!(">{motor}: law.sine = {{ amplitude = \"{amplitude} deg\", period = \"1 s\" }}<");
        let drawn = std::fs::read_to_string(&svg).unwrap().replace("&quot;", "\"");
        assert!(drawn.contains(&title), "{title}");
    }
}

/// The system's word for that is "Not a typewriter".
#[cfg(unix)]
#[test]
fn a_file_that_is_no_port_is_called_that() {
    let folder = Folder::new("no-port");
    let file = folder.write("port", "");
    let outcome = pulsetrain(&["info", "--port", &file]);
    let said = outcome.err.replace('│', " ").split_whitespace().collect::<Vec<_>>().join(" ");
    assert_eq!(outcome.exit, Exit::Refused);
    assert!(said.contains("a file or a device of another kind") && !said.contains("os error"), "{said}");
}

/// Ctrl-C during a long planning ends it with a word and an exit code of its own.
#[cfg(unix)]
#[test]
fn a_planning_that_is_interrupted_says_that_nothing_moved() {
    use std::io::{BufRead, BufReader, Read};
    use std::process::{Command, Stdio};
    let folder = Folder::new("interrupted");
    let law = "law.sine = { amplitude = \"1 rev\", period = \"1 s\", cycles = 1e7 }";
    let file = folder.write("long.toml", &one_motor(law));
    let mut planning = Command::new(env!("CARGO_BIN_EXE_pulsetrain"))
        .args(["plan", &file, "--yes"])
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut said = BufReader::new(planning.stderr.take().unwrap());
    // Its estimate comes before the planning.
    let mut line = String::new();
    said.read_line(&mut line).unwrap();
    assert!(line.contains("this takes a while"), "{line}");
    let id = planning.id().to_string();
    assert!(Command::new("kill").args(["-INT", &id]).status().unwrap().success());
    let mut rest = String::new();
    said.read_to_string(&mut rest).unwrap();
    assert_eq!(planning.wait().unwrap().code(), Some(130), "{rest}");
    assert!(rest.contains("Interrupted"), "{rest}");
}

/// Tests that run firmware on an emulated chip.
mod chips {
    use super::*;

    #[test]
    fn a_board_keeps_settings() {
        ["uno", "pico"].into_iter().for_each(keeps_settings);
    }

    /// One motor just below the highest rate, with few steps in a segment: there is an underrun, at different stages of
    /// the session. That is no fault of the planner.
    #[test]
    fn what_does_not_reach_the_board_in_time_is_refused() {
        let folder = Folder::new("dry");
        let file = folder.path("dry.toml");
        for duration in ["20 ms", "50 ms", "200 ms"] {
            let law = format!(
                "law.formula = {{ theta = \"140000*t + 6000*sin(9000*t)/9000\", unit = \"step\", duration = \"{duration}\" }}"
            );
            let text = one_motor(&law).replace("3000 step/s", "200000 step/s");
            std::fs::write(&file, format!("tolerance = \"100 ns\"\n{text}")).unwrap();
            for command in [&["plan", &file][..], &["run", &file, "--out", &folder.path("out")], &["explain", &file]] {
                let outcome = pulsetrain(command);
                let said =
                    (outcome.err + &outcome.out).split_whitespace().collect::<Vec<_>>().join(" ").replace(" │ ", " ");
                assert!(
                    said.contains("s the motion bends or turns so often that the board's queue holds "),
                    "{duration}: {said}"
                );
                assert!(said.contains("as it is, it fits: "), "{duration}: {said}");
                assert_eq!(outcome.exit, Exit::Refused, "{duration}: {said}");
            }
        }
    }

    #[test]
    fn a_slow_line_refuses_what_a_fast_one_brings() {
        let folder = Folder::new("slow-line");
        let file = folder.path("four.toml");
        let mut motion = "board = \"uno\"\n".to_owned();
        for (name, step, dir) in [("a", 2, 5), ("b", 3, 6), ("c", 4, 7), ("d", 12, 13)] {
            motion.push_str(&format!(
                "[motor.{name}]\nsteps_per_rev = 200\npins = {{ step = {step}, dir = {dir} }}\nforward = \"high\"\ndriver = \"A4988\"\n\
                 [[motion]]\nmotor = \"{name}\"\nlaw.sine = {{ amplitude = \"110 step\", frequency = \"10 Hz\", cycles = 10 }}\n"
            ));
        }
        std::fs::write(&file, motion).unwrap();
        assert_eq!(pulsetrain(&["plan", &file]).exit, Exit::Success);
        let slow = pulsetrain(&["plan", &file, "--baud", "115200"]);
        assert_eq!(slow.exit, Exit::Refused, "{}", slow.out);
        assert!(slow.err.contains("with a, b, c alone it fits; give d another board"), "{}", slow.err);
    }

    #[test]
    fn a_pause_is_planned_run_and_judged() {
        let folder = Folder::new("pause");
        for (name, on) in [("tutorial.toml", "--board=uno"), ("winch.toml", "--native"), ("s-curve.toml", "--native")] {
            let pause = ["--pause-at", "0.4 s", "--resume-at", "0.9 s"];
            let outcome =
                pulsetrain(&[&["run", &example(name), on, "--out", &folder.path("run")], &pause[..]].concat());
            assert_eq!(outcome.exit, Exit::Success, "{name}: {}{}", outcome.out, outcome.err);
            assert!(outcome.out.contains("pause: slows down from 400 ms on, rests from"), "{}", outcome.out);
            assert!(outcome.out.contains("; goes on at 900 ms, at speed from"), "{}", outcome.out);
        }
        // Without the first there is no second.
        let (file, out) = (example("tutorial.toml"), folder.path("run"));
        let outcome = pulsetrain(&["run", &file, "--native", "--pause-at", "0.4 s", "--json", "--out", &out]);
        assert_eq!(outcome.exit, Exit::Success, "{}", outcome.err);
        let report: serde_json::Value = serde_json::from_str(&outcome.out).unwrap();
        assert!(report["pause"]["goes_on_s"].is_null() && report["pause"]["rests_at_s"].as_f64().unwrap() < 0.7);
        assert!(report["motors"][0]["final_position_steps"].as_i64().unwrap() > 2000);
    }

    /// A virtual board's report, and its measurements of itself: emulated cycles, equal on every run.
    #[test]
    fn a_virtual_uno_tells_of_itself() {
        let json = |args: &[&str]| -> serde_json::Value {
            let outcome = pulsetrain(args);
            assert_eq!(outcome.exit, Exit::Success, "{}{}", outcome.out, outcome.err);
            serde_json::from_str(&outcome.out).unwrap()
        };
        let info = json(&["info", "--board", "uno", "--json"]);
        assert_eq!((&info["board"], &info["tick_hz"]), (&"Arduino Uno".into(), &16_000_000.into()));
        assert_eq!((&info["motors"], &info["baud"]), (&4.into(), &1_000_000.into()));
        let [ppm, doubt] = [0, 1].map(|index| info["clock_ppm"][index].as_f64().unwrap());
        assert!(ppm.abs() <= doubt, "{ppm} {doubt}");
        assert!(pulsetrain(&["info", "--board", "uno"]).out.contains("power came on"));
        assert!(info["keeps"].is_null());
    }

    /// Files for the Uno run on the virtual one, and the judge accepts the trace as one of its pins.
    #[test]
    fn examples_for_the_uno_run_on_its_firmware() {
        let folder = Folder::new("firmware");
        let mut ran = 0;
        for entry in std::fs::read_dir(EXAMPLES).unwrap() {
            let path = entry.unwrap().path();
            let file = path.display().to_string();
            // The planner refuses what is too fast for an Uno.
            if path.extension().is_none_or(|ending| ending != "toml")
                || pulsetrain(&["plan", &file, "--for", "3 s"]).exit == Exit::Refused
            {
                continue;
            }
            let out = folder.path("run");
            let outcome = pulsetrain(&["run", &file, "--for", "3 s", "--out", &out]);
            assert_eq!(outcome.exit, Exit::Success, "{file}: {}{}", outcome.out, outcome.err);
            if !outcome.out.contains("on the virtual Uno, firmware") {
                continue;
            }
            let trace = format!("{out}/trace.vcd");
            let outcome = pulsetrain(&["verify", &trace, &file, "--for", "3 s", "--pins"]);
            assert_eq!(outcome.exit, Exit::Success, "{file}: {}{}", outcome.out, outcome.err);
            ran += 1;
        }
        assert!(ran >= 10, "{ran}");
    }

    /// TB6600: pulses of 10 µs. On a shared DIR line the Uno makes them one after the other.
    #[test]
    fn long_pulses_on_one_dir_line_wait_for_each_other() {
        let folder = Folder::new("long-pulses");
        let motor = |name: &str, step: u8, dir: u8| {
            format!(
                "[motor.{name}]\nsteps_per_rev = 200\ndriver = \"TB6600\"\npins = {{ step = {step}, dir = {dir} }}\nforward = \"high\"\n"
            )
        };
        let trapezoid =
            r#"law.trapezoid = { distance = "100 step", speed = "500 step/s", acceleration = "2000 step/s^2" }"#;
        let two = format!(
            "{}{}[[motion]]\nmotor = \"x\"\n{trapezoid}\n[[motion]]\nmotor = \"y\"\nstart = \"5 us\"\n{trapezoid}\n",
            motor("x", 9, 8),
            motor("y", 10, 8)
        );
        // A third motor has a DIR line of its own, and reverses: all edges come from one ring.
        let three = format!(
            "{two}{}[[motion]]\nmotor = \"z\"\nlaw.sine = {{ amplitude = \"30 step\", period = \"100 ms\", cycles = 3 }}\n",
            motor("z", 11, 12)
        );
        for (name, motors) in [("two", two), ("three", three)] {
            let file = folder.path(&format!("{name}.toml"));
            std::fs::write(&file, format!("board = \"uno\"\n{motors}")).unwrap();
            let outcome = pulsetrain(&["run", &file, "--json", "--out", &folder.path(name)]);
            assert_eq!(outcome.exit, Exit::Success, "{name}: {}{}", outcome.out, outcome.err);
            let report: serde_json::Value = serde_json::from_str(&outcome.out).unwrap();
            assert!(report["motors"][1]["steps_put_off"].as_u64().unwrap() > 50, "{}", outcome.out);
        }
    }

    /// A little below the limit the board keeps up. Above it nothing begins, and the advice fits.
    #[test]
    fn rates_with_long_pulses_are_what_an_uno_does() {
        let folder = Folder::new("rates-of-long-pulses");
        let file = folder.path("motion.toml");
        let write = |pulse: &str, pins: &[(u8, u8)], rate: u32| {
            let motors = pins.iter().map(|(step, dir)| {
                format!(
                    "[motor.m{step}]\nsteps_per_rev = 200\npulse_high = \"{pulse}\"\npulse_low = \"2 us\"\ndir_setup = \"1 us\"\n\
                     dir_hold = \"1 us\"\npins = {{ step = {step}, dir = {dir} }}\nforward = \"high\"\n[[motion]]\nmotor = \"m{step}\"\n\
                     law.trapezoid = {{ distance = \"{rate} step\", speed = \"{rate} step/s\", acceleration = \"30000 step/s^2\" }}\n"
                )
            });
            let text = format!("board = \"uno\"\ntolerance = \"1 us\"\n{}", motors.collect::<String>());
            std::fs::write(&file, text).unwrap();
        };
        const B: [(u8, u8); 3] = [(8, 11), (9, 12), (10, 13)];
        const SHIELD: [(u8, u8); 4] = [(2, 5), (3, 6), (4, 7), (12, 13)];
        for (pulse, pins, holds, refused, together) in [
            ("15 us", &B[..1], 8_800, 9_200, "14.4 µs"),
            ("50 us", &B[..1], 8_800, 9_200, "14.4 µs"),
            ("15 us", &SHIELD[..2], 4_250, 4_450, "12.1 µs"),
            ("10 us", &B[..2], 9_350, 9_800, "9.1 µs"),
            ("10 us", &B[..3], 6_350, 6_650, "9.1 µs"),
            ("10 us", &SHIELD[..], 4_450, 4_700, "8.4 µs"),
        ] {
            write(pulse, pins, holds);
            let outcome = pulsetrain(&["run", &file, "--out", &folder.path("out")]);
            assert_eq!(outcome.exit, Exit::Success, "{pulse} {pins:?}: {}{}", outcome.out, outcome.err);
            write(pulse, pins, refused);
            let outcome = pulsetrain(&["run", &file, "--out", &folder.path("out")]);
            assert_eq!(outcome.exit, Exit::Refused, "{pulse} {pins:?}: {}", outcome.out);
            let said = outcome.err.split_whitespace().collect::<Vec<_>>().join(" ");
            let why = format!(
                "the limit is the pulse: on these pins uno works out each step by itself if pulses are longer than {together}, and the driver \
                 of m{} needs {} HIGH. With {together} HIGH",
                pins[0].0,
                pulse.replace('u', "µ")
            );
            assert!(said.contains(&why), "{pulse} {pins:?}: {said}");
            write(&together.replace('µ', "u"), pins, refused);
            let outcome = pulsetrain(&["plan", &file]);
            assert_eq!(outcome.exit, Exit::Success, "{together} {pins:?}: {}", outcome.err);
        }
    }

    /// Frequent reversals: the session switches epochs faster than it reads the board, and the reference board gets as
    /// many.
    #[test]
    fn schedules_are_the_boards_where_epochs_are_short() {
        let folder = Folder::new("often");
        let file = folder.path("often.toml");
        let motor = |name: &str, step: u8, dir: u8| {
            format!(
                "[motor.{name}]\nsteps_per_rev = 200\nmicrosteps = 16\ndriver = \"A4988\"\npins = {{ step = {step}, dir = {dir} }}\nforward = \"high\"\n"
            )
        };
        let motion = |name: &str, frequency: &str, cycles: u32| {
            format!(
                "[[motion]]\nmotor = \"{name}\"\nlaw.sine = {{ amplitude = \"9 deg\", frequency = \"{frequency}\", cycles = {cycles} }}\n"
            )
        };
        let [left, right] = [motor("l", 9, 8), motor("r", 10, 7)];
        let [first, second] = [motion("l", "30 Hz", 60), motion("r", "32.1 Hz", 64)];
        std::fs::write(&file, format!("board = \"uno\"\ntolerance = \"1 us\"\n{left}{right}{first}{second}")).unwrap();
        let outcome = pulsetrain(&["run", &file, "--out", &folder.path("out")]);
        assert!(outcome.out.contains("Steps lost 0, added 0"), "{}{}", outcome.out, outcome.err);
        assert_eq!(outcome.exit, Exit::Success, "{}{}", outcome.out, outcome.err);
    }

    #[test]
    fn the_unos_other_images_are_named() {
        let folder = Folder::new("named");
        for image in ["winch", "verbs"] {
            let trace = folder.path(image);
            let outcome = pulsetrain(&["board", "uno", "--image", image, "--trace", &trace, "--for", "50 ms"]);
            assert_eq!(outcome.exit, Exit::Success, "{image}: {}{}", outcome.out, outcome.err);
            // The program prints it itself: only the port is missing.
            let outcome = pulsetrain(&["flash", "uno", "--port", "/dev/ttyNOT-THERE", "--image", image]);
            assert!(outcome.err.contains("there is no port /dev/ttyNOT-THERE"), "{image}: {}", outcome.err);
        }
    }

    /// Verbs in frames: each board reports `done`, and its counts agree with its pins. On an Uno 800 steps/s for 0.1 s
    /// are 80 steps.
    #[test]
    fn verbs_are_told_in_frames() {
        let folder = Folder::new("verbs");
        let script = folder.path("moves.txt");
        let told = |board: &str, text: &str| {
            std::fs::write(&script, text).expect("a file to write");
            let Outcome { exit, out, err } = pulsetrain(&["verbs", &script, "--board", board]);
            (exit, out, err.split_whitespace().collect::<Vec<_>>().join(" "))
        };
        let moves = "# there\n0 s: speed xy 20000 12000\n0 s: move xy 100 250\n1 s: dir y -1\n1 s: move y 300  # and back\n\
                     1.5 s: run x\n1.6 s: dir x 0\n";
        for (board, x) in [("uno", 180), ("pico", 725)] {
            let (exit, out, err) = told(board, moves);
            assert_eq!(exit, Exit::Success, "{board}: {out}{err}");
            assert_eq!(out.lines().filter(|line| line.starts_with("done ")).count(), 3, "{board}: {out}");
            assert!(
                out.contains("done y ") && out.contains("halted at the end, as they had none: x\n"),
                "{board}: {out}"
            );
            let pins = out.lines().find_map(|line| line.strip_prefix("steps at the pins: x ")).expect("a count");
            let (count, rest) = pins.split_once(", ").expect("more axes");
            assert!(count.parse::<i64>().is_ok_and(|count| (x - 3..=x + 3).contains(&count)), "{board}: {out}");
            assert_eq!(rest, "y -50, z 0, a 0", "{board}");
            assert!(out.ends_with("PASS: as the board counts\n"), "{board}: {out}");
        }
        // A refusal of the board is printed, and changes the exit code.
        let (exit, out, _) = told("pico", "0 s: move x 100\n0 s: move x 1\n0 s: move x 1\n0 s: speed x 3\n");
        assert_eq!(exit, Exit::BoundBroken, "{out}");
        assert!(out.contains("err busy x: a move waits already") && out.contains("err period 500: "), "{out}");
        assert!(out.contains("steps at the pins: x 101, "), "{out}");
        assert!(out.ends_with("FAIL: lines refused: 2; the pins are as the board counts\n"), "{out}");
        // A script that cannot be read moves nothing.
        for (text, place) in [
            ("0 s: move x 1\n1 s: move x many\n", "word 3: not a number"),
            ("1 s: move x 1\n0 s: halt\n", "times go back: the line before has the time 1 s"),
            ("0 s: a x 1\n", "no such verb"),
            ("soon: run x\n", "not a time of 0 s to 10^6 s"),
            ("run x\n", "a line without its time"),
            ("# nothing\n", "has no line to tell"),
        ] {
            let (exit, out, err) = told("uno", text);
            assert_eq!((exit, out.as_str()), (Exit::Refused, ""), "{text}: {err}");
            assert!(err.contains(place), "{text}: {err}");
        }
    }

    #[test]
    fn what_cannot_be_done_is_said() {
        let folder = Folder::new("wrong");
        let plain_file = folder.path("file");
        std::fs::write(&plain_file, "").unwrap();
        let tutorial = example("tutorial.toml");
        let check = |args: &[&str], says: &str| {
            let outcome = pulsetrain(args);
            assert_eq!(outcome.exit, Exit::Refused, "{args:?}");
            assert!(outcome.err.contains(says), "{args:?}: {}", outcome.err);
        };
        check(&[], "Usage");
        check(&["plan", "missing.toml"], "cannot read missing.toml");
        check(&["plan", &tutorial, "--board", "mega"], "there are uno, due, pico, native");
        check(&["plan", &tutorial, "--board", "uno-stream"], "say uno: its firmware has these rates now");
        check(&["plan", &tutorial, "--for", "10"], "10 of what?");
        check(&["plan", &tutorial, "--for", "3 mm"], "this is a distance");
        check(&["plan", &tutorial, "--for", "-1 s"], "it must be a time above 0; write it like \"60 s\"");
        check(&["run", &tutorial, "--pause-at", "-1 s"], "it must be a time above 0; write it like \"60 s\"");
        check(&["bake", &tutorial], "<--sketch <DIR>|--output <FILE>>");
        check(&["bake", &tutorial, "--sketch", "a", "--output", "b.hex"], "cannot be used with");
        check(&["motor", "--inductance", "50mH"], "--current");
        check(&["run", &tutorial, "--out", &format!("{plain_file}/out")], "cannot write");
        check(&["plot", &tutorial, "--out", &folder.path("plot.gif")], "name it .svg or .png");
        check(&["plot", &tutorial, "--out", &format!("{plain_file}/plot.png")], "cannot write");
        check(&["verify", "missing.vcd", &tutorial], "cannot read missing.vcd");
        check(&["run", &tutorial, "--port", "/dev/ttyNOT-THERE"], "there is no port /dev/ttyNOT-THERE");
        check(&["run", &tutorial, "--port", "x", "--board", "due"], "is planned for the board `due`");
        check(&["run", &tutorial, "--port", "x", "--baud", "9600"], "the rates are 115200, 250000");
        check(&["run", &tutorial, "--port", "x", "--native"], "cannot be used with");
        check(&["run", &tutorial, "--no-rehearsal"], "--port <PORT>");
        check(&["run", &tutorial, "--port", "x", "--rehearse", "1 s", "--no-rehearsal"], "cannot be used with");
        check(
            &["run", &tutorial, "--port", "x", "--board", "pico", "--rehearse", "1 s"],
            "only what an Uno is to run is rehearsed",
        );
        check(&["run", &tutorial, "--pause-at", "9 s"], "the motion ends at 1 s");
        check(&["run", &tutorial, "--resume-at", "9 s"], "--pause-at <TIME>");
        for command in ["info", "store", "verbs"] {
            check(&[command], "<--port <PORT>|--board <BOARD>>");
        }
        check(&["info", "--port", "/dev/ttyNOT-THERE"], "an Uno is usually /dev/ttyACM0");
        check(&["bench", "--port", "/dev/ttyNOT-THERE"], "say --disconnected");
        check(&["store", "--port", "/dev/ttyNOT-THERE"], "an Uno is usually /dev/ttyACM0");
        check(&["store", "--board", "uno", "--deadman", "66 s"], "1 ms to 65.535 s, or off");
        check(&["store", "--board", "uno", "--deadman", "5"], "--deadman <TIME>");
        for [speed, acceleration] in
            [["10001", "5"], ["1", "0"], ["-1", "5"], ["nan", "5"], ["1", "0.5"], ["1", "250001"]]
        {
            check(&["store", "--board", "uno", "--limits", speed, acceleration], "up to 10 000 steps/s");
        }
        check(&["board", "uno"], "--pty <LINK>");
        check(&["board", "due", "--tcp", "127.0.0.1:0"], "possible values: uno");
        check(&["verify", &plain_file, &tutorial], "captures are VCD");
    }
}

/// The planner and the judge decide by one constant, each with a computation of its own.
#[test]
fn an_extreme_just_beside_a_level_is_judged_as_it_is_planned() {
    let folder = Folder::new("touch");
    for turns in [
        "50*(1-cos(2*pi*t)) + 1e-9*t",
        "50*(cos(2*pi*t)-1) - 1e-9*t",
        "5*(1-cos(2*pi*t)) + 0.5e-9*t",
        "1000*(1-cos(2*pi*t)) + 1e-9*t",
    ] {
        let text = format!(
            "board = \"uno\"\ngrid = \"reach\"\n[motor.a]\nsteps_per_rev = 200\npulse_high = \"2 us\"\npins = {{ step = 8, dir = 9 }}\n\
             forward = \"high\"\n[[motion]]\nmotor = \"a\"\nbegin = \"jump\"\nend = \"jump\"\n\
             law.formula = {{ theta = \"{turns}\", unit = \"step\", duration = \"3 s\" }}\n"
        );
        let file = folder.write("touch.toml", &text);
        let outcome = pulsetrain(&["run", &file, "--native", "--out", &folder.path("out")]);
        assert_eq!(outcome.exit, Exit::Success, "{turns}: {}{}", outcome.out, outcome.err);
    }
}

/// What the firmware does not drive is refused before anything is planned, by the same table.
#[test]
fn a_step_and_a_dir_of_two_ports_are_refused_by_plan() {
    let folder = Folder::new("split");
    let text = |step: u8, dir: u8| {
        let motor = |name, step, dir| {
            format!(
                "[motor.{name}]\nsteps_per_rev = 200\npulse_high = \"2 us\"\npins = {{ step = {step}, dir = {dir} }}\nforward = \"high\"\n\
             [[motion]]\nmotor = \"{name}\"\nlaw.trapezoid = {{ distance = \"10 step\", speed = \"100 step/s\", acceleration = \"1000 step/s^2\" }}\n"
            )
        };
        format!("board = \"uno\"\n{}{}", motor("a", 2, 3), motor("b", step, dir))
    };
    for (step, dir, fits) in
        [(12, 13, true), (4, 5, true), (12, 5, false), (5, 12, false), (13, 12, false), (5, 13, false)]
    {
        let file = folder.write("split.toml", &text(step, dir));
        for command in [&["plan", file.as_str(), "--board", "uno"][..], &["run", &file, "--out", &folder.path("out")]] {
            let outcome = pulsetrain(command);
            assert_eq!(outcome.exit == Exit::Success, fits, "{step} {dir}: {}{}", outcome.out, outcome.err);
            assert!(fits || outcome.err.contains("an Uno cannot drive these pins together"), "{}", outcome.err);
        }
    }
}
