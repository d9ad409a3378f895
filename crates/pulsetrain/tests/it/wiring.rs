//! Compares docs/wiring.md with the table of boards and the motion files that it names.

use std::path::Path;

use pulsetrain_motion::boards;
use pulsetrain_motion::boards::uno::PinKind;
use pulsetrain_motion::file;
use pulsetrain_motion::program::{Motor, Wiring};

const WIRING: &str = include_str!("../../../../docs/wiring.md");

/// A set-up of the Uno: the part under one heading.
struct SetUp<'a> {
    heading: &'a str,
    drawing: &'a str,
    /// `{ step = 8, dir = 9 }`, as the table has them.
    pins: Vec<&'a str>,
    /// Names of the motion files that the table links to.
    files: Vec<&'a str>,
}

fn set_ups() -> Vec<SetUp<'static>> {
    let uno = WIRING.split("\n## A Raspberry Pi Pico").next().unwrap_or_default();
    let sections = uno.split("\n## ").skip(1).filter(|section| section.contains("| pins | file |"));
    sections
        .map(|section| {
            let between = |from: &str, to: &str| section.split_once(from).and_then(|(_, rest)| rest.split_once(to));
            let all = |from: &'static str, to: &'static str| {
                section.split(from).skip(1).filter_map(move |rest| rest.split_once(to)).map(|(inside, _)| inside)
            };
            SetUp {
                heading: section.lines().next().unwrap_or_default(),
                drawing: between("```text\n", "```").expect("a drawing").0,
                pins: all("| `{", "}` |").collect(),
                files: all("](../examples/", ")").collect(),
            }
        })
        .collect()
}

/// "step", "dir" or "enable" of a pin table.
fn pin(pins: &str, role: &str) -> Option<u8> {
    let entry = pins.split(',').find_map(|entry| entry.trim().strip_prefix(role)?.trim().strip_prefix('='));
    entry.map(|number| number.trim().parse().expect("a pin number"))
}

fn pins_of(motor: &Motor) -> (u8, u8, Option<u8>) {
    match motor.wiring {
        Wiring::StepDir { step, dir, enable, .. } => (step, dir, enable.map(|(pin, _)| pin)),
        Wiring::Coils { .. } => panic!("{} has coils", motor.name),
    }
}

#[test]
fn every_set_up_is_accepted_and_has_its_files() {
    let uno = boards::find("uno").unwrap();
    let set_ups = set_ups();
    assert_eq!(set_ups.len(), 5, "set-ups");
    let mut kinds = Vec::new();
    for SetUp { heading, drawing, pins, files } in set_ups {
        assert!(!pins.is_empty() && !files.is_empty(), "{heading}");
        let wanted: Vec<(u8, u8, Option<u8>)> = pins
            .iter()
            .map(|row| (pin(row, "step").expect("step"), pin(row, "dir").expect("dir"), pin(row, "enable")))
            .collect();
        let wirings: Vec<Wiring> = wanted
            .iter()
            .map(|&(step, dir, enable)| Wiring::StepDir {
                step,
                dir,
                forward_high: true,
                enable: enable.map(|pin| (pin, false)),
            })
            .collect();
        for pin in wirings.iter().flat_map(Wiring::pins) {
            assert_eq!(uno.pin(i64::from(pin)), Ok(pin), "{heading}");
            let number = pin.to_string();
            let drawn = drawing.split(|c: char| !c.is_ascii_digit()).any(|word| word == number);
            assert!(drawn, "{heading}: pin {pin} is not in the drawing");
        }
        kinds.push(PinKind::of_wirings(wirings.iter().map(|wiring| ("motor", wiring))).expect(heading));
        for name in files {
            let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples").join(name);
            let program = file::load(&path).unwrap_or_else(|error| panic!("{heading}: {}", error.plain()));
            assert_eq!(program.board.name, "uno", "{name}");
            assert_eq!(program.motors.iter().map(pins_of).collect::<Vec<_>>(), wanted, "{heading}: {name}");
        }
    }
    use PinKind::{Compare, PortB, PortD, Shield};
    assert_eq!(kinds, [PortB, Shield, PortB, PortD, Compare]);
}

/// The Pico's drawing has the pins of its file.
#[test]
fn the_picos_set_up_is_its_files() {
    let section =
        WIRING.split("\n## ").find(|section| section.starts_with("A Raspberry Pi Pico")).expect("its section");
    let drawing = section.split_once("```text\n").and_then(|(_, rest)| rest.split_once("```")).expect("a drawing").0;
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/pico.toml");
    let program = file::load(&path).unwrap_or_else(|error| panic!("{}", error.plain()));
    assert_eq!(program.board.name, "pico");
    let pins: Vec<u8> = program.motors.iter().flat_map(|motor| motor.wiring.pins()).collect();
    assert!(pins.len() >= 10, "{pins:?}");
    for pin in pins {
        let number = pin.to_string();
        let drawn = drawing.split(|c: char| !c.is_ascii_digit()).any(|word| word == number);
        assert!(drawn, "pin {pin} is not in the drawing");
    }
}

/// The commands on the page are about existing files. `readme.rs` runs the README's.
#[test]
fn the_files_of_the_commands_exist() {
    let mut found = 0;
    for command in WIRING.split("`pulsetrain run ").skip(1) {
        let name = command.split(['`', ' ']).next().unwrap_or_default();
        assert!(Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(name).is_file(), "{name}");
        found += 1;
    }
    assert_eq!(found, 6);
}

/// The page's table of pins agrees with the rule.
#[test]
fn pins_that_the_page_refuses_are_refused() {
    let kind = |pins: &[(u8, u8)]| {
        let wirings: Vec<Wiring> =
            pins.iter().map(|&(step, dir)| Wiring::StepDir { step, dir, forward_high: true, enable: None }).collect();
        PinKind::of_wirings(wirings.iter().map(|wiring| ("motor", wiring)))
    };
    for dir in 2..=19 {
        assert_eq!(kind(&[(9, dir)]).is_ok(), dir <= 13, "DIR on {dir}");
    }
    for analogue in 14..=19 {
        assert!(kind(&[(analogue, 8)]).is_err() && kind(&[(8, analogue)]).is_err(), "A{}", analogue - 14);
    }
    assert!(kind(&[(2, 3), (8, 9)]).is_err());
    assert!(kind(&[(2, 5), (3, 5), (4, 6), (7, 6)]).is_ok());
}
