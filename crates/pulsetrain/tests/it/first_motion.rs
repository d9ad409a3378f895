//! docs/first-motion.md: the program accepts what the page tells a beginner to type, and its drawings have the files'
//! pins.

use pulsetrain::load;
use std::fs;
use std::path::{Path, PathBuf};

use pulsetrain::cli;
use pulsetrain::console::Exit;
use pulsetrain_motion::program::Wiring;

const PAGE: &str = include_str!("../../../../docs/first-motion.md");

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// Commands of this program, as words. Behind two blanks there is a remark.
fn commands() -> Vec<Vec<&'static str>> {
    let lines = PAGE.split("```text\n").skip(1).filter_map(|rest| rest.split("```").next()).flat_map(str::lines);
    let ours = lines.filter_map(|line| line.split_once("pulsetrain ").map(|(_, rest)| rest));
    let commands = ours.filter_map(|rest| rest.split("  ").next()).map(|text| text.split(' ').collect::<Vec<_>>());
    commands.filter(|words: &Vec<&str>| words.iter().all(|word| !word.is_empty())).collect()
}

#[test]
fn every_command_is_understood() {
    let commands = commands();
    for wanted in ["run", "ports", "flash", "info", "new", "bake"] {
        assert!(commands.iter().any(|words| words[0] == wanted), "no command `{wanted}` was found in the page");
    }
    for words in commands {
        // Nothing runs: with `--help` a command prints its help only if everything before it is right.
        let args = std::iter::once("pulsetrain").chain(words.iter().copied().filter(|word| !word.contains('"')));
        // Words in quotes are left out, and so are the options that want one.
        let args: Vec<&str> =
            args.filter(|word| !matches!(*word, "s" | "rev" | "--for" | "--from")).chain(["--help"]).collect();
        let (mut out, mut err) = (Vec::new(), Vec::new());
        assert_eq!(
            cli::run(args.clone(), &mut out, &mut err),
            Exit::Success,
            "{args:?}: {}",
            String::from_utf8_lossy(&err)
        );
        for file in words.iter().filter(|word| word.starts_with("examples/")) {
            assert!(root().join(file).exists(), "{file}");
        }
    }
}

#[test]
fn drawings_have_the_pins_of_the_files() {
    let pins = |path: &Path| match load::endless(path, None).unwrap().program.motors[0].wiring {
        Wiring::StepDir { step, dir, .. } => vec![step, dir],
        Wiring::Coils { pins, .. } => pins.to_vec(),
    };
    assert_eq!(pins(&root().join("examples/first-uno.toml")), [8, 9]);
    assert_eq!(pins(&root().join("examples/first-easydriver.toml")), [6, 7]);
    assert_eq!(pins(&root().join("examples/first-pico.toml")), [6, 7, 8, 9]);
    assert_eq!(pins(&root().join("examples/tutorial.toml")), [8, 9]);
    assert_eq!(pins(&root().join("examples/tutorial-10s.toml")), [8, 9]);
    assert_eq!(pins(&root().join("examples/max-speed.toml")), [6, 7]);
    for row in [
        "│         8 ├────────────────►│ PUL+",
        "│         9 ├────────────────►│ DIR+",
        "│         6 ├──────────────►│ STEP",
        "│         7 ├──────────────►│ DIR",
    ] {
        assert!(PAGE.contains(row), "{row}");
    }

    let text = PAGE.split("```toml\n").nth(1).and_then(|rest| rest.split("```").next()).expect("a motion file");
    let file = fs::read_to_string(root().join("examples/first-uno.toml")).unwrap();
    assert!(file.ends_with(text), "the page's file is the example's");
    for gpio in [6, 7, 8, 9] {
        assert!(PAGE.contains(&format!("│  GP{gpio}")), "GP{gpio}");
    }
}

/// The acceleration that a motor on the desk follows with a small load, rev/s².
const FOLLOWED: f64 = 200.0;

#[test]
fn motors_follow_what_the_page_has_them_do() {
    let mut found = 0;
    for words in commands().into_iter().filter(|words| words[0] == "run" && words.contains(&"--port")) {
        let prepared = load::load(&root().join(words[1]), None, None).unwrap();
        for (motor, planned) in prepared.program.motors.iter().zip(prepared.plan(|_| ()).unwrap()) {
            let (acceleration, _) = planned.certificate.peak_acceleration;
            // With a gear behind the motor, this is the rotor's own acceleration.
            let asked = acceleration / motor.scale.steps_per_rev;
            assert!(asked <= FOLLOWED, "{}: {asked} rev/s²", words[1]);
            if words[1].contains("first-") {
                assert!(motor.limits.max_acceleration.is_some() && motor.limits.max_speed.is_some(), "{}", words[1]);
                assert!(asked <= 0.1 * FOLLOWED, "{}: {asked} rev/s² is not gentle", words[1]);
            }
        }
        found += 1;
    }
    assert!(found >= 7, "{found} commands");
}
