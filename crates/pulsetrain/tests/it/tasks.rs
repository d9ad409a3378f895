//! Tasks of users, done with the commands that the README, the docs and the program's own messages print, in at most three tries.
//!
//! Three more are elsewhere: a noisy recording in `recordings.rs`, a notebook in `json.rs` (`a_notebook_reads_the_numbers`), and a film in
//! `python/tests/test_film.py` (`test_the_page_about_films_holds`).

use std::fs;
use std::path::PathBuf;
use std::process::Command;

use super::readme::{folder_with_examples, words};

const COMMANDS: &str = include_str!("../../../../docs/commands.md");

/// A user's folder, with the examples in it.
struct Desk(PathBuf);

/// What a command printed, and whether it succeeded.
struct Printed {
    is_success: bool,
    text: String,
}

impl Desk {
    fn new(name: &str) -> Desk {
        Desk(folder_with_examples(name))
    }

    /// Types a command, with `pulsetrain` before it.
    fn types(&self, command: &str) -> Printed {
        let arguments = command.strip_prefix("pulsetrain ").expect("a command of this program");
        let mut program = Command::new(env!("CARGO_BIN_EXE_pulsetrain"));
        let ran = program.args(words(arguments)).current_dir(&self.0).output().expect("it runs");
        let text = String::from_utf8_lossy(&ran.stdout) + String::from_utf8_lossy(&ran.stderr);
        Printed { is_success: ran.status.success(), text: text.into_owned() }
    }

    fn write(&self, name: &str, text: &str) {
        fs::write(self.0.join(name), text).expect("a file to write");
    }

    fn read(&self, name: &str) -> String {
        fs::read_to_string(self.0.join(name)).expect("a file to read")
    }
}

impl Drop for Desk {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// The line of docs/commands.md that begins so, without the remark behind it.
fn of_page(start: &str) -> &'static str {
    let mut lines = COMMANDS.lines().map(|line| line.strip_prefix("$ ").unwrap_or(line));
    let line = lines.find(|line| line.starts_with(start)).expect("a line of the page");
    line.split_once("  ").map_or(line, |(command, _)| command)
}

/// What stands between two texts.
fn between<'a>(text: &'a str, before: &str, after: &str) -> &'a str {
    let rest = text.split_once(before).unwrap_or_else(|| panic!("`{before}` is not in:\n{text}")).1;
    rest.split_once(after).unwrap_or_else(|| panic!("`{after}` is not in:\n{rest}")).0
}

/// The user writes as one writes on paper, and too fast for the motor.
#[test]
fn a_formula_of_ones_own() {
    let desk = Desk::new("task-formula");
    let new = desk.types(of_page("pulsetrain new crank"));
    let run = between(&new.text, "now: ", "\n").to_owned();
    // The new file has a formula in comments. It becomes the motion, with what the user wants.
    let file = desk.read("crank.toml");
    let (head, motions) = file.split_once("[[motion]]").expect("motions");
    let formula = motions.split_once("# [[motion]]").expect("a motion in comments").1.replace("\n# ", "\n");
    let formula = formula.replace("a*sin(2*pi*f*t)^3", "2000 sin(2*pi*f*t)^3");
    desk.write("crank.toml", &format!("{head}[[motion]]{formula}"));

    let first = desk.types(&run);
    assert!(!first.is_success && first.text.contains("crank.toml:"), "{}", first.text);
    let advice = between(&first.text, "write `", "`").to_owned();
    let (is, should) = (advice.replace("(…)", "(").replace('*', " "), advice.replace("(…)", "("));
    desk.write("crank.toml", &desk.read("crank.toml").replace(&is, &should));

    let second = desk.types(&run);
    let said = second.text.replace('│', " ").split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(!second.is_success && said.contains("the motor's limit is 8000.0 steps/s"), "{said}");
    let slower: f64 = between(&said, "help: ", " times slower it fits").parse().expect("a number");
    let f = format!("f = \"{} Hz\"", 0.5 / slower);
    let lasts = between(&said, "it fits: ", " instead of 10 s");
    let slow = desk.read("crank.toml").replace("f = \"0.5 Hz\"", &f);
    desk.write("crank.toml", &slow.replace("duration = \"10 s\"", &format!("duration = \"{lasts}\"")));

    let third = desk.types(&run);
    assert!(third.is_success && third.text.ends_with("PASS: no bound broke\n"), "{}", third.text);
    assert!(desk.0.join("out/crank").join(between(&third.text, "out/crank: ", ",")).exists());
}

#[test]
fn four_motors_for_an_hour() {
    let desk = Desk::new("task-hour");
    let command = of_page("pulsetrain run examples/sweep.toml --for \"1 h\" --native");
    let ran = desk.types(command);
    assert!(ran.is_success && ran.text.contains("PASS: no bound broke"), "{}", ran.text);
    for motor in ["first", "second", "third", "fourth"] {
        assert!(ran.text.lines().any(|line| line.trim_start().starts_with(motor)), "{}", ran.text);
    }
    let written = between(&ran.text, "out/sweep: ", "\n");
    assert_eq!(written, "report.json, plot.svg", "the large files are left out");
    let report: serde_json::Value = serde_json::from_str(&desk.read("out/sweep/report.json")).expect("JSON");
    assert_eq!(report["pass"], true);
    // Each motor makes 2 · swing · frequency steps a second.
    let steps = |motor: &serde_json::Value| motor["steps"].as_u64().expect("a count");
    let counts: Vec<u64> = report["motors"].as_array().expect("motors").iter().map(steps).collect();
    assert!(counts.len() == 4 && counts.iter().all(|count| count.abs_diff(720_000) < 200), "{counts:?}");
}

/// The user knows which probe is where, and no option. The analyser's clock is 40 ppm off, and it was started first.
#[test]
fn a_capture_of_a_logic_analyser() {
    let desk = Desk::new("task-capture");
    assert!(desk.types("pulsetrain run examples/tutorial.toml --native").is_success);
    let mut capture = "Time [s],Channel 0,Channel 1\n0,0,0\n".to_owned();
    let mut level = 0;
    for row in desk.read("out/tutorial/steps.csv").lines().skip(1) {
        let fields: Vec<&str> = row.split(',').collect();
        let at_s = 0.25 + fields[2].parse::<f64>().expect("a tick") / 16e6 * (1.0 + 40e-6);
        // The tutorial's DIR is low for forward.
        let dir = u8::from(fields[3] != "1");
        if dir != level {
            capture += &format!("{:.9},0,{dir}\n", at_s - 20e-6);
            level = dir;
        }
        capture += &format!("{at_s:.9},1,{dir}\n{:.9},0,{dir}\n", at_s + 10e-6);
    }
    desk.write("capture.csv", &capture);

    let shortest = of_page("pulsetrain verify capture.csv").split(" --pins").next().expect("a command").to_owned();
    let first = desk.types(&shortest);
    let line = between(&first.text, "help: ", " says which channel").to_owned();
    assert!(!first.is_success && line.starts_with("--line"), "{}", first.text);
    // What is said of the one probe, the user says of the other, too.
    let other = line.replace("Channel 0", "Channel 1").replace("step", "dir");
    let second = desk.types(&format!("{shortest} {line} {other}"));
    let align = between(&second.text, "With ", " it passes").to_owned();
    let third = desk.types(&format!("{shortest} {line} {other} {align}"));
    assert!(third.is_success && third.text.contains("PASS: no bound broke"), "{}", third.text);
    assert!(third.text.contains("the board's clock is 40 ppm slow"), "{}", third.text);
}
