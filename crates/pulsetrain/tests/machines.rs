//! The figures that machines draw: how far the stepped ones are from the wanted ones, of the examples as they are.

use std::path::{Path, PathBuf};

use pulsetrain::cli;
use pulsetrain::console::Exit;

/// What rounding to whole steps leaves of each motor: half a step, the grid's hysteresis, and what it moves in a tick.
const OF_A_MOTOR: f64 = 0.5 + 1.0 / 64.0 + 0.02;

/// Runs a motion file with more arguments, which must go well: the report, and the picture.
fn run(file: &Path, name: &str, more: &[&str]) -> (serde_json::Value, String) {
    let folder: PathBuf = std::env::temp_dir().join(format!("pulsetrain-machines-{name}-{}", std::process::id()));
    let (mut out, mut err) = (Vec::new(), Vec::new());
    let (file, out_folder) = (file.display().to_string(), folder.display().to_string());
    let args = [&["pulsetrain", "run", &file, "--json", "--out", &out_folder], more].concat();
    let exit = cli::run(args, &mut out, &mut err);
    assert_eq!(exit, Exit::Success, "{}", String::from_utf8_lossy(&err));
    let svg = std::fs::read_to_string(folder.join("plot.svg")).expect("a picture");
    std::fs::remove_dir_all(folder).expect("the folder can go");
    (serde_json::from_slice(&out).expect("JSON"), svg)
}

/// What is said of a file's first figure, on the native board: machine, motors, tip, off the figure.
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

/// The figure: the largest radial error of the stepped circle, in steps. Two motors, each half a step and 1/64 off.
#[test]
fn a_circle_is_round_to_three_quarters_of_a_step() {
    let text = std::fs::read_to_string(example("circle.toml")).expect("the example");
    let text: Vec<&str> = text.lines().filter(|line| !line.starts_with("backlash")).collect();
    let file = std::env::temp_dir().join(format!("pulsetrain-circle-{}.toml", std::process::id()));
    std::fs::write(&file, text.join("\n")).expect("a file to write");
    let (machine, motors, tip, off) = figure(&file, "circle");
    std::fs::remove_file(file).expect("the file can go");
    assert_eq!(machine, "sketch");
    assert!(motors <= OF_A_MOTOR, "{motors} steps");
    assert!(tip * SKETCH <= OF_A_MOTOR * 2_f64.sqrt(), "{} steps", tip * SKETCH);
    // Somewhere both are nearly half a step off, and across the circle.
    assert!((0.6..OF_A_MOTOR * 2_f64.sqrt()).contains(&(off * SKETCH)), "{} steps", off * SKETCH);
}

/// The motors turn every other second: who takes longer to take up the slack never has.
#[test]
fn slack_that_is_not_taken_up_before_the_next_turn_is_refused() {
    let text = std::fs::read_to_string(example("circle.toml")).expect("the example");
    let file = std::env::temp_dir().join(format!("pulsetrain-slack-{}.toml", std::process::id()));
    for (over, exit) in [("1 s", Exit::Success), ("2.1 s", Exit::Refused)] {
        std::fs::write(&file, text.replace("over = \"40 ms\"", &format!("over = \"{over}\"")))
            .expect("a file to write");
        let (mut out, mut err) = (Vec::new(), Vec::new());
        assert_eq!(cli::run(["pulsetrain", "plan", &file.display().to_string()], &mut out, &mut err), exit, "{over}");
        let said =
            String::from_utf8(err).expect("text").replace('│', "").split_whitespace().collect::<Vec<_>>().join(" ");
        let places = ["motor ", "it turns at t = ", "`over`, the time of its `backlash`, must be shorter"];
        assert_eq!(places.iter().all(|place| said.contains(place)), exit == Exit::Refused, "{said}");
    }
    std::fs::remove_file(file).expect("the file can go");
}

/// While slack is taken up the pen stands: on top of the steps that is what the circle falls in 40 ms, 0.6 step.
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

/// A step of an arm is 0.11°, 0.14 mm at the end of 70 mm, and half of it what rounding leaves. All three can be off by that, and
/// the effector then goes up to 2.4 times as far.
#[test]
fn the_delta_robot_is_within_half_a_step_of_each_arm() {
    let (machine, motors, tip, off) = figure(&example("delta.toml"), "delta");
    assert_eq!(machine, "robot");
    assert!(motors <= OF_A_MOTOR, "{motors} steps");
    let of_an_arm = OF_A_MOTOR * 70.0 * std::f64::consts::TAU / 3200.0;
    assert!((of_an_arm..2.4 * of_an_arm).contains(&tip) && off <= tip, "{tip} and {off} mm");
}

/// The beginning of each example on the board that it is for: the firmware on the emulated chip, every edge judged.
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
