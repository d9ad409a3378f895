//! The commands as a user has them: output, files, exit codes. `UPDATE_EXPECT=1` rewrites the golden files.

use std::io::{self, Write};
use std::path::PathBuf;

use expect_test::{ExpectFile, expect_file};
use pulsetrain::cli;
use pulsetrain::console::Exit;

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

/// From the package's folder, where tests run: golden files must not depend on where the project is.
const EXAMPLES: &str = "../../examples";

fn example(name: &str) -> String {
    format!("{EXAMPLES}/{name}")
}

/// A directory of its own that is gone afterwards.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Folder {
        let path = std::env::temp_dir().join(format!("pulsetrain-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Folder(path)
    }

    fn path(&self, name: &str) -> String {
        self.0.join(name).display().to_string()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        drop(std::fs::remove_dir_all(&self.0));
    }
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

#[test]
fn plans() {
    check(&["plan", &example("tutorial.toml")], Exit::Success, expect_file!["golden/plan-tutorial.txt"]);
    check(&["plan", &example("tutorial-0.01s.toml")], Exit::Refused, expect_file!["golden/plan-too-fast.txt"]);
    let json = pulsetrain(&["plan", &example("sweep.toml"), "--for", "2 s", "--json"]).out;
    let report: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(report["cut_at_s"], 2.0);
    assert_eq!(report["motors"].as_array().unwrap().len(), 4);
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
    check(&["explain", &example("tutorial-0.01s.toml")], Exit::Success, expect_file!["golden/explain-too-fast.txt"]);
    check(&["explain", &example("s-curve.toml")], Exit::Success, expect_file!["golden/explain-s-curve.txt"]);
}

/// Two motors, three limits, one beyond the board's: the first is met, all are told.
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

/// A gear the wrong way round leaves nothing to do, which is no error; but it is told.
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

/// How long a motion without an end would last is nobody's business.
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

/// A disk that is full is told behind the verdict, not in its place.
#[cfg(target_os = "linux")]
#[test]
fn a_verdict_is_told_where_its_files_have_no_room() {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/winch-script.txt").to_owned();
    let commands =
        [(vec!["run".to_owned(), example("tutorial.toml")], "\nPASS: "), (vec!["winch".to_owned(), script], "\nok\n")];
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
            let said: serde_json::Value = serde_json::from_str(&outcome.out).expect("one value");
            assert!(said["message"].as_str().unwrap().contains("cannot write"), "{said}");
        }
    }
}

#[test]
fn several_problems_are_told_one_below_the_other() {
    let folder = Folder::new("several");
    let file = folder.path("empty.toml");
    std::fs::write(&file, "").unwrap();
    let outcome = pulsetrain(&["plan", &file]);
    assert_eq!(outcome.exit, Exit::Refused);
    let told: Vec<&str> = outcome.err.lines().filter(|line| line.contains('×')).collect();
    assert_eq!(told, ["board", "motor", "motion"].map(|key| format!("  × the motion file has no `{key}`")));
    assert!(!outcome.err.contains("Error:") && !outcome.err.contains("\n\n\n"), "{}", outcome.err);
}

/// What is said to fit does fit, and a little less slow does not.
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

/// Every example that fits runs, its files are there, and its own trace and steps pass the judge.
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

/// Files for the Uno run on the virtual one; its trace passes the judge as what it is, the pins.
#[test]
fn examples_for_the_uno_run_on_its_firmware() {
    let folder = Folder::new("firmware");
    let mut ran = 0;
    for entry in std::fs::read_dir(EXAMPLES).unwrap() {
        let path = entry.unwrap().path();
        let file = path.display().to_string();
        // What is too fast for an Uno is said by the planner.
        if path.extension().is_none_or(|ending| ending != "toml")
            || pulsetrain(&["plan", &file, "--for", "3 s"]).exit == Exit::Refused
        {
            continue;
        }
        let out = folder.path("run");
        let outcome = pulsetrain(&["run", &file, "--for", "3 s", "--out", &out]);
        assert_eq!(outcome.exit, Exit::Success, "{file}: {}{}", outcome.out, outcome.err);
        if !outcome.out.contains("Run on the virtual Uno, firmware") {
            continue;
        }
        let trace = format!("{out}/trace.vcd");
        let outcome = pulsetrain(&["verify", &trace, &file, "--for", "3 s", "--pins"]);
        assert_eq!(outcome.exit, Exit::Success, "{file}: {}{}", outcome.out, outcome.err);
        ran += 1;
    }
    assert!(ran >= 10, "{ran}");
}

#[test]
fn a_file_for_the_highest_rates_runs_on_the_image_for_them() {
    let folder = Folder::new("stream");
    for name in ["tutorial.toml", "sweep.toml"] {
        let (file, out) = (example(name), folder.path("run"));
        let on = ["--board", "uno-stream", "--for", "3 s"];
        let outcome = pulsetrain(&[&["run", &file, "--out", &out], &on[..]].concat());
        assert_eq!(outcome.exit, Exit::Success, "{file}: {}{}", outcome.out, outcome.err);
        assert!(outcome.out.contains("Run on the virtual Uno with the image for the highest rates"), "{}", outcome.out);
        let outcome = pulsetrain(&[&["verify", &format!("{out}/trace.vcd"), &file, "--pins"], &on[..]].concat());
        assert_eq!(outcome.exit, Exit::Success, "{file}: {}{}", outcome.out, outcome.err);
    }
}

/// Turns often: the session goes over to new epochs faster than it looks at its board, and the stepgen beside it is told as many.
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
    assert!(outcome.out.contains("steps lost 0, added 0"), "{}{}", outcome.out, outcome.err);
    assert_eq!(outcome.exit, Exit::Success, "{}{}", outcome.out, outcome.err);
}

#[test]
fn the_unos_other_images_are_named() {
    let folder = Folder::new("named");
    for image in ["verbs", "stream"] {
        let trace = folder.path(image);
        let outcome = pulsetrain(&["board", "uno", "--image", image, "--trace", &trace, "--for", "50 ms"]);
        assert_eq!(outcome.exit, Exit::Success, "{image}: {}{}", outcome.out, outcome.err);
        // Taken from the program itself: only the port is missing.
        let outcome = pulsetrain(&["flash", "uno", "--port", "/dev/ttyNOT-THERE", "--image", image]);
        assert!(outcome.err.contains("there is no port /dev/ttyNOT-THERE"), "{image}: {}", outcome.err);
    }
}

#[test]
fn a_pause_is_planned_run_and_judged() {
    let folder = Folder::new("pause");
    for (name, on) in [("tutorial.toml", "--board=uno"), ("winch.toml", "--native"), ("s-curve.toml", "--native")] {
        let pause = ["--pause-at", "0.4 s", "--resume-at", "0.9 s"];
        let outcome = pulsetrain(&[&["run", &example(name), on, "--out", &folder.path("run")], &pause[..]].concat());
        assert_eq!(outcome.exit, Exit::Success, "{name}: {}{}", outcome.out, outcome.err);
        assert!(outcome.out.contains("pause: slows down from 400 ms on, rests from"), "{}", outcome.out);
        assert!(outcome.out.contains("; goes on at 900 ms, at speed from"), "{}", outcome.out);
    }
    // Without the one there is no other.
    let (file, out) = (example("tutorial.toml"), folder.path("run"));
    let outcome = pulsetrain(&["run", &file, "--native", "--pause-at", "0.4 s", "--json", "--out", &out]);
    assert_eq!(outcome.exit, Exit::Success, "{}", outcome.err);
    let report: serde_json::Value = serde_json::from_str(&outcome.out).unwrap();
    assert!(report["pause"]["goes_on_s"].is_null() && report["pause"]["rests_at_s"].as_f64().unwrap() < 0.7);
    assert!(report["motors"][0]["final_position"].as_i64().unwrap() > 2000);
}

#[test]
fn a_step_that_lacks_breaks_a_bound() {
    let folder = Folder::new("mutant");
    let file = example("tutorial.toml");
    pulsetrain(&["run", &file, "--native", "--out", &folder.path("run")]);
    let steps = std::fs::read_to_string(folder.0.join("run/trace.vcd")).unwrap();
    // Without the 1000th pulse: a rise and a fall of STEP.
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

/// An analyser's own names for its channels say nothing; the user does. Its last line may lack a newline.
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
    check(&["--line", "wheel.ch0=wheel.dir", "--line", "wheel.ch1=wheel.step"], Exit::BoundBroken, "FAIL");
    check(&["--line", "ch7=wheel.step"], Exit::Refused, "no line for a line called ch7");
    check(&["--line", "ch0"], Exit::Refused, "Channel 0=wheel.step");
    let steps = folder.path("run/steps.csv");
    let outcome = pulsetrain(&["verify", &steps, &file, "--line", "a=b"]);
    assert!(outcome.err.contains("has no lines"), "{}", outcome.err);
}

/// A capture of an endless motion ends somewhere on the way, without the planned stop.
#[test]
fn a_capture_is_judged_as_far_as_the_user_says() {
    let folder = Folder::new("until");
    let file = example("sweep.toml");
    pulsetrain(&["run", &file, "--native", "--for", "3 s", "--out", &folder.path("run")]);
    let steps = std::fs::read_to_string(folder.0.join("run/steps.csv")).unwrap();
    let before = |line: &&str| {
        line.split(',').nth(1).and_then(|tick| tick.parse().ok()).is_none_or(|tick: u64| tick < 33_000_000)
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
fn new_files_can_be_planned_and_are_not_overwritten() {
    let folder = Folder::new("new");
    let name = folder.path("crank");
    assert_eq!(pulsetrain(&["new", &name]).exit, Exit::Success);
    assert_eq!(pulsetrain(&["plan", &folder.path("crank.toml")]).exit, Exit::Success);
    let again = pulsetrain(&["new", &name]);
    assert_eq!(again.exit, Exit::Refused);
    assert!(again.err.contains("cannot write"), "{}", again.err);
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
    check(&["plan", &tutorial, "--board", "mega"], "there are uno, uno-stream, due, pico, native");
    check(&["plan", &tutorial, "--for", "10"], "10 of what?");
    check(&["plan", &tutorial, "--for", "3 mm"], "this is a distance");
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
    for [speed, acceleration] in [["10001", "5"], ["1", "0"], ["-1", "5"], ["nan", "5"], ["1", "0.5"], ["1", "250001"]]
    {
        check(&["store", "--board", "uno", "--limits", speed, acceleration], "up to 10 000 steps/s");
    }
    check(&["board", "uno"], "--pty <LINK>");
    check(&["board", "due", "--tcp", "127.0.0.1:0"], "possible values: uno");
    check(&["verify", &plain_file, &tutorial], "captures are VCD");
}

/// Pins that the firmware cannot move together are refused before anything is planned, with what fits.
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
    for kind in pulsetrain_motion::pins::PinKind::ALL {
        assert!(said.contains(&kind.to_string()), "{kind}: {said}");
    }
    assert_eq!(pulsetrain(&["plan", &path, "--board", "native"]).exit, Exit::Success);
}

/// What a virtual board says of itself, and how it measures itself: emulated cycles, the same every time.
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

#[test]
fn a_board_keeps_settings() {
    ["uno", "pico"].into_iter().for_each(keeps_settings);
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

/// A reader that goes away, as `head` does.
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

/// Orders in frames: of each board done lines come, and its pins have what it counts. On an Uno 800 steps/s for 0.1 s are 80.
#[test]
fn verbs_are_told_in_frames() {
    let folder = std::env::temp_dir().join(format!("pulsetrain-verbs-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let script = folder.join("moves.txt").display().to_string();
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
        assert!(out.contains("done y ") && out.contains("halted at the end, as they had none: x\n"), "{board}: {out}");
        let pins = out.lines().find_map(|line| line.strip_prefix("steps at the pins: x ")).expect("a count");
        let (count, rest) = pins.split_once(", ").expect("more axes");
        assert!(count.parse::<i64>().is_ok_and(|count| (x - 3..=x + 3).contains(&count)), "{board}: {out}");
        assert_eq!(rest, "y -50, z 0, a 0", "{board}");
        assert!(out.ends_with("PASS: as the board counts\n"), "{board}: {out}");
    }
    // What a board refuses is printed, and told by the exit code.
    let (exit, out, _) = told("pico", "0 s: move x 100\n0 s: move x 1\n0 s: move x 1\n0 s: speed x 3\n");
    assert_eq!(exit, Exit::BoundBroken, "{out}");
    assert!(out.contains("err busy x: a move waits already") && out.contains("err period 500: "), "{out}");
    assert!(out.contains("steps at the pins: x 101, "), "{out}");
    // What cannot be read moves nothing.
    for (text, place) in [
        ("0 s: move x 1\n1 s: move x many\n", "word 3: not a number"),
        ("1 s: move x 1\n0 s: halt\n", "times go back: the line before is told at 1 s"),
        ("0 s: a x 1\n", "no such verb"),
        ("soon: run x\n", "not a time of 0 s to 10^6 s"),
        ("run x\n", "a line without its time"),
        ("# nothing\n", "has no line to tell"),
    ] {
        let (exit, out, err) = told("uno", text);
        assert_eq!((exit, out.as_str()), (Exit::Refused, ""), "{text}: {err}");
        assert!(err.contains(place), "{text}: {err}");
    }
    std::fs::remove_dir_all(folder).expect("the folder can go");
}
