//! Which crate may know which: the arrows of ARCHITECTURE.md, read from `cargo metadata`.

use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

/// Each crate of ours, and those of ours that it may know; tests and benches included, but for [`IN_TESTS`].
const MAY_KNOW: [(&str, &[&str]); 13] = [
    ("pulsetrain-core", &[]),
    ("pulsetrain-motion", &["pulsetrain-core"]),
    ("pulsetrain-plan", &["pulsetrain-core", "pulsetrain-motion"]),
    // The judge is independent of what it judges: it knows the law, never the plan, nor the fixed point of a board's path.
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
    (
        "pulsetrain",
        &[
            "pulsetrain-bake",
            "pulsetrain-board",
            "pulsetrain-core",
            "pulsetrain-motion",
            "pulsetrain-plan",
            "pulsetrain-plot",
            "pulsetrain-session",
            "pulsetrain-trace",
        ],
    ),
    // The truth that tests compare with: it knows nothing of ours.
    ("pulsetrain-oracle", &[]),
    // What it says of a firmware must be independent of who wrote it.
    ("pulsetrain-emulator", &[]),
    ("pulsetrain-testkit", &["pulsetrain-board", "pulsetrain-core", "pulsetrain-emulator"]),
    ("xtask", &[]),
];

/// What tests and benches may know besides.
const IN_TESTS: [(&str, &str); 6] = [
    ("pulsetrain-plan", "pulsetrain-oracle"),
    ("pulsetrain-plan", "pulsetrain-testkit"),
    ("pulsetrain-board", "pulsetrain-testkit"),
    ("pulsetrain-session", "pulsetrain-testkit"),
    ("pulsetrain", "pulsetrain-testkit"),
    // Whether the motion files that `xtask accept` makes are any.
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

/// What runs on boards needs nothing but the language: no dependency that could bring an allocator or floats.
#[test]
fn core_depends_on_nothing() {
    let metadata = metadata();
    let core = packages(&metadata).find(|package| package["name"] == "pulsetrain-core").expect("core is a member");
    let normal: Vec<_> = dependencies(core).filter(|d| d["kind"].is_null()).map(|d| &d["name"]).collect();
    assert!(normal.is_empty(), "pulsetrain-core depends on {normal:?}");
}

/// No program of users has what tests share.
#[test]
fn only_tests_know_the_testkit() {
    let metadata = metadata();
    for package in packages(&metadata) {
        for known in dependencies(package).filter(|d| d["name"] == "pulsetrain-testkit") {
            assert_eq!(known["kind"], "dev", "{} needs pulsetrain-testkit for more than its tests", package["name"]);
        }
    }
}

/// For each crate of the workspace, those of the workspace that it names in its manifest.
fn known() -> BTreeMap<String, Vec<String>> {
    let metadata = metadata();
    packages(&metadata)
        .map(|package| {
            // Ours are those that come from a path.
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
