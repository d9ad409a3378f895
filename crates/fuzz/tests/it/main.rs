//! Runs each fuzz target on its seeds and on damaged copies of them, as a plain test.
#![allow(clippy::disallowed_methods, reason = "tests open their own files")]

use pulsetrain_fuzz::TARGETS;
use pulsetrain_testkit::Random;
use pulsetrain_testkit::seed::{rounds, seed};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// The files in a folder of the repository, by name.
fn files(folder: &str) -> Vec<PathBuf> {
    let entries = fs::read_dir(root().join(folder)).expect("a folder of seeds");
    let mut files: Vec<_> =
        entries.map(|entry| entry.expect("an entry").path()).filter(|path| path.is_file()).collect();
    files.sort();
    files
}

/// Number of damaged copies of each seed in one round.
const DAMAGED: u64 = 16;

/// Gives a target its seeds, and copies with some bytes changed, left out, doubled, or cut at the end.
fn run(name: &str) {
    let target = TARGETS.iter().find(|target| target.name == name).expect("a target of TARGETS");
    let mut random = Random::new(seed(2026));
    let seeds: Vec<_> = target.seeds.iter().flat_map(|folder| files(folder)).collect();
    assert!(!seeds.is_empty(), "{name} has no seed");
    for path in seeds {
        let sound = fs::read(&path).expect("a seed");
        (target.check)(&sound);
        for _ in 0..rounds() * DAMAGED {
            let damaged = damaged(&sound, &mut random);
            // A panic in the check fails the test; the input is printed before, so that it can be repeated.
            println!("{}: {:?}", path.display(), String::from_utf8_lossy(&damaged));
            (target.check)(&damaged);
        }
    }
}

fn damaged(sound: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = sound.to_vec();
    for _ in 0..=random.below(4) {
        if bytes.is_empty() {
            break;
        }
        let at = random.below(bytes.len() as u64) as usize;
        match random.below(4) {
            0 => bytes[at] = random.below(256) as u8,
            1 => drop(bytes.remove(at)),
            2 => bytes.insert(at, bytes[at]),
            _ => bytes.truncate(at),
        }
    }
    bytes
}

#[test]
fn each_target_has_a_file_for_the_fuzzer() {
    let known: BTreeSet<_> = TARGETS.iter().map(|target| format!("{}.rs", target.name)).collect();
    let found = files("fuzz/fuzz_targets").into_iter();
    let found: BTreeSet<_> =
        found.map(|path| path.file_name().expect("a name").to_string_lossy().into_owned()).collect();
    assert_eq!(known, found);
}

#[test]
fn motion_file() {
    run("motion_file");
}

#[test]
fn formula() {
    run("formula");
}

#[test]
fn table() {
    run("table");
}

#[test]
fn traces() {
    ["vcd", "saleae", "sigrok", "steps", "camera"].into_iter().for_each(run);
}

#[test]
fn packing() {
    run("packing");
}

#[test]
fn wire() {
    run("wire");
}

#[test]
fn winch() {
    run("winch");
}

#[test]
fn winch_uno() {
    run("winch_uno");
}
