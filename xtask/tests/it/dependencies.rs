//! Checks which crate depends on which: the arrows of ARCHITECTURE.md, by `cargo metadata`.

use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

/// Each crate of ours, and the crates of ours that it may depend on. Tests and benches count, except [`IN_TESTS`].
const MAY_KNOW: [(&str, &[&str]); 16] = [
    ("pulsetrain-core", &[]),
    ("pulsetrain-motion", &["pulsetrain-core"]),
    ("pulsetrain-plan", &["pulsetrain-core", "pulsetrain-motion"]),
    // The judge is independent of what it judges: it depends on the law, never on the plan or the fixed point of a
    // board's path.
    ("pulsetrain-trace", &["pulsetrain-motion"]),
    ("pulsetrain-board", &["pulsetrain-core", "pulsetrain-emulator"]),
    (
        "pulsetrain-session",
        &["pulsetrain-board", "pulsetrain-core", "pulsetrain-motion", "pulsetrain-plan", "pulsetrain-trace"],
    ),
    (
        "pulsetrain-bake",
        &[
            "pulsetrain-board",
            "pulsetrain-core",
            "pulsetrain-motion",
            "pulsetrain-plan",
            "pulsetrain-session",
            "pulsetrain-trace",
        ],
    ),
    ("pulsetrain-plot", &["pulsetrain-motion"]),
    // What a page, Python and the command line share: it knows none of them.
    (
        "pulsetrain-report",
        &[
            "pulsetrain-board",
            "pulsetrain-core",
            "pulsetrain-motion",
            "pulsetrain-plan",
            "pulsetrain-plot",
            "pulsetrain-session",
            "pulsetrain-trace",
        ],
    ),
    // Doors such as the socket, OSC and the page are above it.
    ("pulsetrain-live", &["pulsetrain-board", "pulsetrain-motion", "pulsetrain-report", "pulsetrain-session"]),
    (
        "pulsetrain",
        &[
            "pulsetrain-bake",
            "pulsetrain-board",
            "pulsetrain-core",
            "pulsetrain-live",
            "pulsetrain-motion",
            "pulsetrain-plan",
            "pulsetrain-plot",
            "pulsetrain-report",
            "pulsetrain-session",
            "pulsetrain-trace",
        ],
    ),
    // Tests compare with the oracle's exact times, so it depends on none of our crates.
    ("pulsetrain-oracle", &[]),
    // What the emulator says of a firmware must be independent of the firmware's authors.
    ("pulsetrain-emulator", &[]),
    ("pulsetrain-testkit", &["pulsetrain-board", "pulsetrain-core", "pulsetrain-emulator"]),
    (
        "pulsetrain-fuzz",
        &[
            "pulsetrain-board",
            "pulsetrain-core",
            "pulsetrain-emulator",
            "pulsetrain-motion",
            "pulsetrain-testkit",
            "pulsetrain-trace",
        ],
    ),
    ("xtask", &[]),
];

/// What tests and benches may depend on in addition.
const IN_TESTS: [(&str, &str); 6] = [
    ("pulsetrain-plan", "pulsetrain-oracle"),
    ("pulsetrain-plan", "pulsetrain-testkit"),
    ("pulsetrain-board", "pulsetrain-testkit"),
    ("pulsetrain-session", "pulsetrain-testkit"),
    ("pulsetrain", "pulsetrain-testkit"),
    // Whether the motion files of `xtask accept` can be read.
    ("xtask", "pulsetrain-motion"),
];

#[test]
fn no_arrow_turns_round() {
    let known = known();
    let found: BTreeSet<_> = known.keys().map(String::as_str).collect();
    let listed: BTreeSet<_> = MAY_KNOW.iter().map(|(name, _)| *name).collect();
    assert_eq!(found, listed, "each crate of the workspace needs its row in MAY_KNOW");
    for (name, may_know) in MAY_KNOW {
        for other in &known[name] {
            let allowed = may_know.contains(&other.as_str()) || IN_TESTS.contains(&(name, other.as_str()));
            assert!(allowed, "{name} must not know {other}: see ARCHITECTURE.md");
        }
    }
}

/// Code for boards depends only on the language: no dependency may bring an allocator or floats.
#[test]
fn core_depends_on_nothing() {
    let metadata = metadata();
    let core = packages(&metadata).find(|package| package["name"] == "pulsetrain-core").expect("core is a member");
    let normal: Vec<_> = dependencies(core).filter(|d| d["kind"].is_null()).map(|d| &d["name"]).collect();
    assert!(normal.is_empty(), "pulsetrain-core depends on {normal:?}");
}

/// No program for users contains what tests share.
#[test]
fn only_tests_know_the_testkit() {
    let metadata = metadata();
    // A package that is not published is a test itself.
    for package in packages(&metadata).filter(|package| package["publish"].is_null()) {
        for known in dependencies(package).filter(|d| d["name"] == "pulsetrain-testkit") {
            assert_eq!(known["kind"], "dev", "{} needs pulsetrain-testkit for more than its tests", package["name"]);
        }
    }
}

/// For each crate of the workspace, the crates of the workspace in its manifest.
fn known() -> BTreeMap<String, Vec<String>> {
    let metadata = metadata();
    packages(&metadata)
        .map(|package| {
            // Our crates are those with a path.
            let ours = dependencies(package).filter(|d| d["source"].is_null());
            (text(&package["name"]), ours.map(|d| text(&d["name"])).collect())
        })
        .collect()
}

fn metadata() -> Value {
    let cargo = Command::new(env!("CARGO"))
        .args(["metadata", "--format-version=1", "--no-deps", "--offline"])
        .current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
        .output()
        .expect("cargo starts");
    serde_json::from_slice(&cargo.stdout).expect("cargo metadata answers in JSON")
}

fn packages(metadata: &Value) -> impl Iterator<Item = &Value> {
    metadata["packages"].as_array().expect("packages").iter()
}

fn dependencies(package: &Value) -> impl Iterator<Item = &Value> {
    package["dependencies"].as_array().expect("dependencies").iter()
}

fn text(value: &Value) -> String {
    value.as_str().expect("a string").to_owned()
}
