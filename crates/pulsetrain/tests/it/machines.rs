//! The machines' figures in the examples: how far the steps are from the law.

use std::path::{Path, PathBuf};

use pulsetrain::cli;
use pulsetrain::console::Exit;
use pulsetrain_testkit::folder::Folder;

/// The greatest error of each motor by rounding to whole steps: half a step, the grid's hysteresis, and its movement in
/// a tick.
const OF_A_MOTOR: f64 = 0.5 + 1.0 / 64.0 + 0.02;

/// Runs a motion file with more arguments, which must succeed. Gives the report and the picture.
fn run(file: &Path, name: &str, more: &[&str]) -> (serde_json::Value, String) {
    let folder = Folder::new(&format!("machines-{name}"));
    let (mut out, mut err) = (Vec::new(), Vec::new());
    let (file, out_folder) = (file.display().to_string(), folder.name());
    let args = [&["pulsetrain", "run", &file, "--json", "--out", &out_folder], more].concat();
    let exit = cli::run(args, &mut out, &mut err);
    assert_eq!(exit, Exit::Success, "{}", String::from_utf8_lossy(&err));
    let svg = std::fs::read_to_string(folder.path("plot.svg")).expect("a picture");
    (serde_json::from_slice(&out).expect("JSON"), svg)
}

/// The report of a file's first figure on the native board: machine, motors, tip, distance from the figure.
fn figure(file: &Path, name: &str) -> (String, f64, f64, f64) {
    let (report, svg) = run(file, name, &["--native"]);
    let figure = &report["figures"][0];
    let number = |key: &str| figure[key].as_f64().expect("a number");
    let machine = figure["machine"].as_str().expect("a name").to_owned();
    assert!(svg.contains(&format!("Figure of {machine}, mm")), "the picture shows no figure");
    (machine, number("motor_steps"), number("tip"), number("off_figure"))
}

fn example(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples").join(name)
}

/// Steps of the 28BYJ-48 in a millimetre of the sketch.
const SKETCH: f64 = 32.0 * 2.0 * 63.683_95 / 40.0;

/// The largest radial error of the stepped circle, in steps. Each of two motors is off by half a step and 1/64.
#[test]
fn a_circle_is_round_to_three_quarters_of_a_step() {
    let text = std::fs::read_to_string(example("circle.toml")).expect("the example");
    let text: Vec<&str> = text.lines().filter(|line| !line.starts_with("backlash")).collect();
    let folder = Folder::new("circle");
    let file = folder.write("circle.toml", &text.join("\n"));
    let (machine, motors, tip, off) = figure(file.as_ref(), "circle");
    assert_eq!(machine, "sketch");
    assert!(motors <= OF_A_MOTOR, "{motors} steps");
    assert!(tip * SKETCH <= OF_A_MOTOR * 2_f64.sqrt(), "{} steps", tip * SKETCH);
    // Somewhere both motors are nearly half a step off, and across the circle.
    assert!((0.6..OF_A_MOTOR * 2_f64.sqrt()).contains(&(off * SKETCH)), "{} steps", off * SKETCH);
}

/// The motors reverse every other second. If using up the slack takes longer, a motor never finishes it.
#[test]
fn slack_that_is_not_taken_up_before_the_next_turn_is_refused() {
    let text = std::fs::read_to_string(example("circle.toml")).expect("the example");
    let folder = Folder::new("slack");
    for (over, exit) in [("1 s", Exit::Success), ("2.1 s", Exit::Refused)] {
        let file = folder.write("slack.toml", &text.replace("over = \"40 ms\"", &format!("over = \"{over}\"")));
        let (mut out, mut err) = (Vec::new(), Vec::new());
        assert_eq!(cli::run(["pulsetrain", "plan", &file], &mut out, &mut err), exit, "{over}");
        let said =
            String::from_utf8(err).expect("text").replace('│', "").split_whitespace().collect::<Vec<_>>().join(" ");
        let places = ["motor ", "it turns at t = ", "`over`, the time of its `backlash`, must be shorter"];
        assert_eq!(places.iter().all(|place| said.contains(place)), exit == Exit::Refused, "{said}");
    }
}

/// While the slack is used up the pen stands: in 40 ms the circle moves on by 0.6 step, in addition to the steps.
#[test]
fn slack_costs_what_the_figure_does_while_it_is_taken_up() {
    let (_, _, _, off) = figure(&example("circle.toml"), "slack");
    let fall = 3.0 * SKETCH * (1.0 - (std::f64::consts::TAU * 0.04 / 4.0).cos());
    assert!((0.5..0.75).contains(&fall));
    assert!((OF_A_MOTOR..OF_A_MOTOR * 2_f64.sqrt() + fall).contains(&(off * SKETCH)), "{} steps", off * SKETCH);
}

#[test]
fn the_butterfly_is_within_three_quarters_of_a_step() {
    let (machine, motors, tip, off) = figure(&example("lorenz.toml"), "lorenz");
    assert_eq!(machine, "table");
    assert!(motors <= OF_A_MOTOR, "{motors} steps");
    // 80 steps in a millimetre.
    assert!(tip <= OF_A_MOTOR * 2_f64.sqrt() / 80.0 && off <= tip, "{tip} and {off} mm");
    assert!(tip > 0.6 / 80.0, "{tip} mm");
}

/// A step of an arm is 0.11°, 0.14 mm at the end of 70 mm, and rounding leaves half of it. All three arms can be off by
/// that, and the effector then moves up to 2.4 times as far.
#[test]
fn the_delta_robot_is_within_half_a_step_of_each_arm() {
    let (machine, motors, tip, off) = figure(&example("delta.toml"), "delta");
    assert_eq!(machine, "robot");
    assert!(motors <= OF_A_MOTOR, "{motors} steps");
    let of_an_arm = OF_A_MOTOR * 70.0 * std::f64::consts::TAU / 3200.0;
    assert!((of_an_arm..2.4 * of_an_arm).contains(&tip) && off <= tip, "{tip} and {off} mm");
}

/// Runs a command on a motion file with this text. Gives its output and errors in one line.
fn says(command: &str, name: &str, text: &str, more: &[&str]) -> (Exit, String) {
    let folder = Folder::new(name);
    let path = folder.write("x.toml", text);
    let (mut out, mut err) = (Vec::new(), Vec::new());
    let exit = cli::run([&["pulsetrain", command, &path], more].concat(), &mut out, &mut err);
    let said = String::from_utf8([out, err].concat()).expect("text").replace(['│', '┊'], "").replace(&path, "x.toml");
    (exit, said.split_whitespace().collect::<Vec<_>>().join(" "))
}

/// 12 steps in 2 ms are 9000 steps/s, more than the motor's 1500. The advice fits, and the motion keeps its speed.
#[test]
fn slack_that_is_taken_up_too_fast_is_to_be_given_a_longer_time() {
    let text = std::fs::read_to_string(example("circle.toml")).expect("the example");
    let limited =
        text.replace("pull_in = ", "max_speed = \"1500 step/s\"\nmax_acceleration = \"100000 step/s^2\"\npull_in = ");
    let with = |over: &str| limited.replace("over = \"40 ms\"", &format!("over = \"{over}\""));
    let (exit, said) = says("plan", "slack-fast", &with("2 ms"), &[]);
    assert_eq!(exit, Exit::Refused, "{said}");
    let (_, over) = said.split_once("`backlash` takes up its slack too fast: over = \"").expect(&said);
    let (over, _) = over.split_once('"').expect(&said);
    assert!(!said.contains("times slower"), "{said}");
    let (_, explained) = says("explain", "slack-explained", &with("2 ms"), &["--json"]);
    assert!(explained.contains("\"least_slowdown\": null"), "{explained}");
    // 6·12 steps at 100 000 steps/s²: the square of 26.8 ms, and the circle's own acceleration on top of that.
    let ms: f64 = over.strip_suffix(" ms").and_then(|ms| ms.parse().ok()).expect(over);
    assert!((26.8..28.0).contains(&ms), "{over}");
    let (exit, said) = says("plan", "slack-longer", &with(over), &[]);
    assert_eq!(exit, Exit::Success, "{said}");
    // If it is too fast without any slack, the advice is a slower motion.
    let (exit, said) = says("plan", "slack-slower", &with("40 ms").replace("\"4 s\"", "\"0.4 s\""), &[]);
    assert_eq!(exit, Exit::Refused, "{said}");
    assert!(said.contains("times slower it fits, with over = \""), "{said}");
}

/// An xy table, and the beginning of its motion.
const TABLE: &str = include_str!("../../../motion/tests/it/xy.toml");

/// Machines have no `begin` and no `end`. The advice is the key that they have, and it helps.
#[test]
fn a_path_that_ends_in_motion_is_to_be_eased() {
    let path = "path.formula = { x = \"20*t\", y = \"20*t\", unit = \"mm\", duration = \"2 s\" }\n";
    let (exit, said) = says("plan", "moving", &format!("{TABLE}{path}"), &[]);
    assert_eq!(exit, Exit::Refused, "{said}");
    assert!(said.contains("give the path an `ease`") && !said.contains("end =") && !said.contains("begin ="), "{said}");
    let (exit, said) = says("plan", "eased", &format!("{TABLE}ease = \"0.5 s\"\n{path}"), &[]);
    assert_eq!(exit, Exit::Success, "{said}");
    // With `repeat` it reverses at once: its ends are eased already.
    let there = "path.formula = { x = \"20*sin(t)\", y = \"20*t\", unit = \"mm\", duration = \"2 s\" }\nrepeat = 2\n";
    let (exit, said) = says("plan", "repeated", &format!("{TABLE}ease = \"0.5 s\"\n{there}"), &[]);
    assert_eq!(exit, Exit::Refused, "{said}");
    assert!(said.contains("has to end in the direction") && !said.contains("give the path an `ease`"), "{said}");
}

/// An endless circle that is cut after two turns and a bit stays round to its end, with slack and without, and also if
/// it is paused while slack is used up.
#[test]
fn a_path_that_is_cut_or_paused_keeps_to_its_figure() {
    let endless = "\"3 mm\", period = \"4 s\", cycles = \"forever\"";
    let text = std::fs::read_to_string(example("circle.toml")).expect("the example");
    let text = text.replace("\"3 mm\", period = \"4 s\", cycles = 2", endless);
    assert!(text.contains(endless));
    let plain: Vec<&str> = text.lines().filter(|line| !line.starts_with("backlash")).collect();
    let fall = 3.0 * SKETCH * (1.0 - (std::f64::consts::TAU * 0.04 / 4.0).cos());
    let round = OF_A_MOTOR * 2_f64.sqrt();
    for (name, text, more, bound) in [
        ("cut", plain.join("\n"), &["--for", "8.7 s"][..], round),
        ("cut-slack", text.clone(), &["--for", "8.7 s"], round + fall),
        // The slack of a reversal is being used up, which takes longer while time slows down.
        ("paused-slack", text, &["--for", "8.7 s", "--pause-at", "4.25 s", "--resume-at", "6 s"], round + fall),
    ] {
        let folder = Folder::new(name);
        let file = folder.write("sketch.toml", &text);
        let (report, svg) = run(file.as_ref(), name, &[&["--native"], more].concat());
        let off = report["figures"][0]["off_figure"].as_f64().expect("a figure") * SKETCH;
        assert!((0.5..bound).contains(&off), "{name}: {off} steps");
        assert!(svg.contains("Figure of sketch, mm"), "{name}");
    }
}

#[test]
fn what_is_cut_says_whether_it_would_have_ended() {
    let text = std::fs::read_to_string(example("circle.toml")).expect("the example");
    let (_, said) = says("plan", "ends", &text, &["--for", "2 s"]);
    assert!(said.contains("cut after 2 s, then the planned stop; without --for it takes 8.54 s"), "{said}");
    assert!(!said.contains("endless"), "{said}");
    let (_, said) = says("plan", "endless", &text.replace("cycles = 2", "cycles = \"forever\""), &["--for", "2 s"]);
    assert!(said.contains("endless: 2 s of it, then the planned stop; --for sets how much"), "{said}");
}

/// How much slower a path has to be, by `explain`.
fn slowdown(said: &str) -> f64 {
    let (before, _) = said.split_once(" times slower it keeps to the machine's limits").expect(said);
    before.rsplit(' ').next().and_then(|word| word.parse().ok()).expect(before)
}

/// A path that is a little too fast, and bends far too much: the advice is slow enough for both limits.
#[test]
fn a_machine_that_breaks_two_limits_is_told_what_both_want() {
    let limits = "max_speed = \"30 mm/s\"\nmax_acceleration = \"10 mm/s^2\"\nmotors = [";
    let path = |slower: f64| {
        let (table, period) = (TABLE.replace("motors = [", limits), 4.0 * slower);
        format!(
            "{table}ease = \"{slower} s\"\npath.circle = {{ radius = \"20 mm\", period = \"{period} s\", cycles = 2 }}\n"
        )
    };
    let (exit, said) = says("explain", "two-limits", &path(1.0), &[]);
    assert!(exit == Exit::Refused && said.contains("the tip's speed is 31.4 mm/s"), "{said}");
    // The root of 49.88 divided by 10 while the path begins, and 49.35 on the circle.
    let slower = slowdown(&said);
    assert!((2.23..2.25).contains(&slower), "{slower}");
    for (slower, exit) in [(slower, Exit::Success), (slower - 0.02, Exit::Refused)] {
        let (is, said) = says("plan", "two-limits-slower", &path(slower), &[]);
        assert_eq!(is, exit, "{slower}: {said}");
    }
}

/// The error names the machine, the limit and the time, and its advice fits.
#[test]
fn a_machine_that_is_refused_is_explained() {
    let limited = TABLE.replace("motors = [", "max_speed = \"20 mm/s\"\nmotors = [");
    let path = |seconds: f64| {
        format!(
            "path.formula = {{ x = \"20*sin(t*s)\", y = \"20 - 20*cos(t*s)^3\", unit = \"mm\", duration = \"{} s\", where = {{ s = {} }} }}\n",
            4.0 * seconds,
            1.0 / seconds
        )
    };
    let ease = |seconds: f64| format!("ease = \"{} ms\"\n", 500.0 * seconds);
    let (exit, said) = says("plan", "explained-plan", &format!("{limited}{}{}", ease(1.0), path(1.0)), &[]);
    assert_eq!(exit, Exit::Refused, "{said}");
    assert!(said.contains("the tip's speed is ") && said.contains(" at its highest, at "), "{said}");
    let (exit, said) = says("explain", "explained", &format!("{limited}{}{}", ease(1.0), path(1.0)), &[]);
    assert_eq!(exit, Exit::Refused, "{said}");
    let parts = [
        "x.toml: refused machine table, an xy machine, motors x, y:",
        "time x, mm y, mm the tip's speed, mm/s",
        "→",
        "is the limit: 20.0 mm/s",
        "slow the path down, or raise the machine's max_speed",
    ];
    parts.iter().for_each(|part| assert!(said.contains(part), "{part}: {said}"));
    let slower = slowdown(&said);
    assert!(slower > 1.0 && slower < 2.0, "{slower}");
    for (slower, exit) in [(slower, Exit::Success), (slower - 0.02, Exit::Refused)] {
        let text = format!("{limited}{}{}", ease(slower), path(slower));
        let (is, said) = says("plan", "explained-slower", &text, &[]);
        assert_eq!(is, exit, "{slower}: {said}");
    }
    // If the arms do not reach a point, no speed helps.
    let delta = std::fs::read_to_string(example("delta.toml")).expect("the example");
    let beyond = delta.replace("angles = [\"-40 deg\", \"80 deg\"]", "angles = [\"-30 deg\", \"20 deg\"]");
    assert!(beyond != delta);
    let (exit, said) = says("explain", "explained-arm", &beyond, &[]);
    assert_eq!(exit, Exit::Refused, "{said}");
    let parts = [
        "machine robot, a delta robot, motors",
        "arms from -30.0° to 20.0°",
        "is the limit: 20.0 °",
        "within what the arms reach",
    ];
    parts.iter().for_each(|part| assert!(said.contains(part), "{part}: {said}"));
    assert!(!said.contains("times slower"), "{said}");
    let (_, said) = says("explain", "explained-json", &beyond, &["--json"]);
    assert!(said.contains("\"fits\": false") && said.contains("\"tip_mm\""), "{said}");
}

/// Tests that run firmware on an emulated chip.
mod chips {
    use super::*;

    /// The beginning of each example on its board: the firmware on the emulated chip, every edge judged.
    #[test]
    fn the_examples_begin_on_their_boards() {
        for (file, length, runner) in
            [("circle.toml", "0.7 s", "Pico"), ("lorenz.toml", "2 s", "Uno"), ("delta.toml", "2 s", "Uno")]
        {
            let (report, _) = run(&example(file), &format!("board-{file}"), &["--for", length]);
            assert_eq!(report["verdict"]["ok"], true, "{file}");
            assert!(report["runner"].as_str().is_some_and(|name| name.contains(runner)), "{file}");
        }
    }
}

#[test]
fn goto_does_not_send_arms_beyond_their_angles() {
    let goto = |arguments: &[&str]| {
        let folder = Folder::new("machines-goto");
        let (mut out, mut err) = (Vec::new(), Vec::new());
        let (file, out_folder) = (example("delta.toml").display().to_string(), folder.name());
        let args = [&["pulsetrain", "goto", &file, "--native", "--out", &out_folder], arguments].concat();
        let exit = cli::run(args, &mut out, &mut err);
        // Words of a message may be on two lines.
        let said = String::from_utf8_lossy(&err).replace("\u{2502}", " ");
        (exit, said.split_whitespace().collect::<Vec<_>>().join(" "))
    };
    let refused = |arguments: &[&str], parts: &[&str]| {
        let (exit, said) = goto(arguments);
        assert!(exit != Exit::Success && parts.iter().all(|part| said.contains(part)), "{arguments:?}: {said}");
        assert!(!said.contains("on a virtual board"), "nothing is looked at before: {said}");
    };
    let angles = "`angles` of machine robot allow -40 deg to 80 deg";
    refused(&["90 rev"], &["motor a cannot go to 32400 deg", angles, "write a position from -40 deg to 80 deg"]);
    refused(&["-41 deg", "--motor", "b"], &["motor b cannot go to -41 deg", angles]);
    refused(&["10 mm"], &["has no `lead`", "write it like \"20 deg\""]);
    for arguments in [&["80 deg"][..], &["start", "--from", "85 deg"]] {
        let (exit, said) = goto(arguments);
        assert_eq!(exit, Exit::Success, "{arguments:?}: {said}");
    }
    // Level elbows are 105 mm from the axis: forearms of 100 mm do not meet.
    let folder = Folder::new("machines-apart");
    let text = std::fs::read_to_string(example("delta.toml")).expect("the example");
    let short = text.replace("80 deg", "90 deg");
    let short =
        short.replace("forearm = \"150 mm\"", "forearm = \"100 mm\"").replace("-160", "-130").replace("-140", "-120");
    let file = folder.write("short.toml", &short);
    let (mut out, mut err) = (Vec::new(), Vec::new());
    let out_folder = folder.name();
    let exit = cli::run(["pulsetrain", "goto", &file, "0 deg", "--native", "--out", &out_folder], &mut out, &mut err);
    let said = String::from_utf8_lossy(&err);
    assert!(exit != Exit::Success && said.contains("do not meet at these angles"), "{said}");
}
