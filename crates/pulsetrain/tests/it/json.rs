//! Outputs with `--json` are as docs/schema describes them, and docs/json.md works as it stands. `UPDATE_EXPECT=1` rewrites the schemas.

use std::path::{Path, PathBuf};
use std::process::Command;

use expect_test::expect_file;
use jsonschema::Validator;
use pulsetrain::console::Exit;
use pulsetrain::{cli, schema};
use pulsetrain_testkit::folder::Folder;
use serde_json::Value;

fn example(name: &str) -> String {
    format!("../../examples/{name}")
}

fn printed(args: &[&str]) -> (Exit, Value) {
    let (mut out, mut err) = (Vec::new(), Vec::new());
    let exit = cli::run([&["pulsetrain"], args, &["--json"]].concat(), &mut out, &mut err);
    let value = serde_json::from_slice(&out).unwrap_or_else(|error| {
        panic!("{args:?}: {error}\n{}\n{}", String::from_utf8_lossy(&out), String::from_utf8_lossy(&err))
    });
    (exit, value)
}

pub(crate) fn validator(name: &str) -> Validator {
    let found = schema::all().into_iter().find(|(known, _)| *known == name);
    let (_, schema) = found.unwrap_or_else(|| panic!("no schema {name}"));
    jsonschema::validator_for(&schema).unwrap_or_else(|error| panic!("{name}: {error}"))
}

/// Holds a value against the schema of a command.
#[track_caller]
pub(crate) fn conforms(name: &str, value: &Value) {
    let errors: Vec<String> =
        validator(name).iter_errors(value).map(|error| format!("{}: {error}", error.instance_path())).collect();
    assert!(errors.is_empty(), "{name}: {errors:#?}\n{value:#}");
}

/// Prints as JSON, ends so, and conforms to its schema.
#[track_caller]
fn check(name: &str, args: &[&str], expected: Exit) -> Value {
    let (exit, value) = printed(args);
    assert_eq!(exit, expected, "{args:?}: {value:#}");
    conforms(if exit == Exit::Refused && value["message"].is_string() { "error" } else { name }, &value);
    value
}

#[test]
fn schemas_are_those_of_docs() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/schema");
    let mut names: Vec<String> = Vec::new();
    for (name, schema) in schema::all() {
        let text = serde_json::to_string_pretty(&schema).unwrap() + "\n";
        expect_file![folder.join(format!("{name}.json"))].assert_eq(&text);
        // The schema itself is one.
        assert!(jsonschema::meta::is_valid(&schema), "{name}");
        names.push(format!("{name}.json"));
    }
    let mut there: Vec<String> =
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    there.sort();
    assert_eq!(there, names, "a schema that no command has");
    let page = include_str!("../../../../docs/json.md");
    for name in names {
        assert!(page.contains(&format!("(schema/{name})")), "docs/json.md does not name {name}");
    }
}

/// Each key of each output says what it is.
#[test]
fn every_key_is_described() {
    fn undescribed(schema: &Value, place: &str, found: &mut Vec<String>) {
        match schema {
            Value::Array(all) => all.iter().for_each(|schema| undescribed(schema, place, found)),
            Value::Object(object) => {
                for (name, key) in object.get("properties").and_then(Value::as_object).into_iter().flatten() {
                    // A tag has one value, which its variant describes.
                    if key["description"].as_str().is_none_or(str::is_empty) && key["const"].is_null() {
                        found.push(format!("{place}.{name}"));
                    }
                }
                object.iter().for_each(|(name, schema)| undescribed(schema, &format!("{place}.{name}"), found));
            }
            _ => {}
        }
    }
    let mut found = Vec::new();
    for (name, schema) in schema::all().iter().filter(|(name, _)| *name != "error") {
        undescribed(schema, name, &mut found);
    }
    assert!(found.is_empty(), "{found:#?}");
}

/// A key that no schema has, and one that lacks, are found: the checks here can fail.
#[test]
fn a_schema_refuses_what_it_does_not_describe() {
    let plan = check("plan", &["plan", &example("tutorial.toml")], Exit::Success);
    let is_valid = |change: &dyn Fn(&mut Value)| {
        let mut other = plan.clone();
        change(&mut other);
        validator("plan").is_valid(&other)
    };
    assert!(is_valid(&|_| {}));
    assert!(!is_valid(&|plan| plan["motors"][0]["house_word"] = 1.into()));
    assert!(!is_valid(&|plan| plan["another"] = 1.into()));
    assert!(!is_valid(&|plan| plan["duration_s"] = "1 s".into()));
    assert!(!is_valid(&|plan| drop(plan["motors"][0].as_object_mut().unwrap().remove("unit"))));
}

#[test]
fn plans_and_tables_conform() {
    for name in ["tutorial", "sweep", "formula", "table", "s-curve", "winch", "delta", "circle", "pico"] {
        check("plan", &["plan", &example(&format!("{name}.toml")), "--for", "1 s"], Exit::Success);
    }
    check("boards", &["boards"], Exit::Success);
    check("drivers", &["drivers"], Exit::Success);
    check("motor", &["motor", "--file", &example("max-speed.toml")], Exit::Success);
    check("motor", &["motor", "--inductance", "1uH", "--current", "1A", "--voltage", "12V"], Exit::Success);
    check("ports", &["ports"], Exit::Success);
    check("explain", &["explain", &example("s-curve.toml")], Exit::Success);
    check("explain", &["explain", &example("tutorial-0.01s.toml")], Exit::Refused);
    let folder = Folder::new("json-bake");
    check("bake", &["bake", &example("sweep.toml"), "--sketch", &folder.path("sketch")], Exit::Success);
}

/// What is refused prints an error, whatever the command.
#[test]
fn refusals_conform() {
    let folder = Folder::new("json-refused");
    let empty = folder.write("empty.toml", "");
    let long = folder.write(
        "long.toml",
        "board = \"native\"\n[motor.m]\nsteps_per_rev = 200\ndriver = \"A4988\"\npins = { step = 8, dir = 9 }\nforward = \"high\"\n\
         [[motion]]\nmotor = \"m\"\nlaw.sine = { amplitude = \"1 rev\", period = \"1 s\", cycles = 1e9 }\n",
    );
    for args in [
        &["plan", "missing.toml"][..],
        &["plan", empty.as_str()],
        &["plan", &example("tutorial-0.01s.toml")],
        &["verify", "missing.vcd", &example("tutorial.toml")],
        &["info", "--port", "/dev/ttyNOT-THERE"],
        &["stop", "--port", "/dev/ttyNOT-THERE"],
    ] {
        let value = check("error", args, Exit::Refused);
        assert!(value["message"].is_string(), "{value}");
    }
    let nearly_empty = folder.path("nearly-empty.toml");
    std::fs::write(&nearly_empty, "grid = \"nearest\"\n").unwrap();
    let several = check("error", &["plan", &nearly_empty], Exit::Refused);
    assert_eq!(several["related"].as_array().map(Vec::len), Some(2), "{several}");
    let asked = check("error", &["plan", &long], Exit::Refused);
    assert!(asked["estimate"]["motion_s"].as_f64().is_some_and(|s| s > 9e8), "{asked}");
}

#[test]
fn runs_and_verdicts_conform() {
    let folder = Folder::new("json-runs");
    let file = example("tutorial.toml");
    let out = folder.path("run");
    for name in ["tutorial", "circle", "pico"] {
        let run = check(
            "run",
            &["run", &example(&format!("{name}.toml")), "--native", "--for", "1 s", "--out", &out],
            Exit::Success,
        );
        let written: Value = serde_json::from_slice(&std::fs::read(folder.0.join("run/report.json")).unwrap()).unwrap();
        assert_eq!(run, written);
    }
    check(
        "run",
        &["run", &file, "--native", "--pause-at", "0.3 s", "--resume-at", "0.5 s", "--out", &out],
        Exit::Success,
    );
    check("run", &["run", &file, "--native", "--out", &out], Exit::Success);
    let [steps, trace] = ["steps.csv", "trace.vcd"].map(|name| format!("{out}/{name}"));
    check("verify", &["verify", &trace, &file], Exit::Success);
    // Steps lack, one is late, one goes the wrong way: each kind of fault has keys of its own.
    let text = std::fs::read_to_string(&steps).unwrap();
    let cut: String = text.lines().take(3000).map(|line| format!("{line}\n")).collect();
    std::fs::write(&steps, cut).unwrap();
    let verdict = check("verify", &["verify", &steps, &file], Exit::BoundBroken);
    assert_eq!((&verdict["pass"], &verdict["failures"][0]["fault"]), (&false.into(), &"missing".into()));
    let film = folder.write("film.csv", &film());
    check("verify", &["verify", &film, &file], Exit::Success);
}

/// A film of the tutorial's wheel: five revolutions there and back in a second.
fn film() -> String {
    let frame = |k: u32| {
        let t = f64::from(k) / 240.0;
        let turns = 2.5 * (1.0 - (std::f64::consts::TAU * t).cos());
        format!("{t},{}\n", 360.0 * turns)
    };
    format!("time [s],angle [deg]\n{}", (0..=240).map(frame).collect::<String>())
}

/// The document's own example: a notebook's two cells, with what they print.
#[test]
fn a_notebook_reads_the_numbers() {
    let page = include_str!("../../../../docs/json.md");
    let folder = Folder::new("notebook");
    let blocks = |kind: &str| -> Vec<String> {
        let begin = format!("```{kind}\n");
        let parts = page.split(&begin).skip(1);
        parts.filter_map(|rest| rest.split("```").next()).map(str::to_owned).collect()
    };
    let (cells, shown) = (blocks("python"), blocks("text"));
    assert_eq!((cells.len(), shown.len()), (2, 2));
    let script = folder.write("notebook.py", &cells.concat());
    std::os::unix::fs::symlink(std::fs::canonicalize("../../examples").unwrap(), folder.0.join("examples")).unwrap();
    // The command is found as after `cargo install`: on the path.
    let program = PathBuf::from(env!("CARGO_BIN_EXE_pulsetrain"));
    let path = format!("{}:{}", program.parent().unwrap().display(), std::env::var("PATH").unwrap_or_default());
    let script = std::fs::canonicalize(script).unwrap();
    let ran =
        Command::new("python3").arg(script).current_dir(&folder.0).env("PATH", path).output().expect("python3 runs");
    assert_eq!(String::from_utf8_lossy(&ran.stdout), shown.concat(), "{}", String::from_utf8_lossy(&ran.stderr));
}

/// Tests that run firmware on an emulated chip.
mod chips {
    use super::*;

    #[test]
    fn boards_and_their_runs_conform() {
        let folder = Folder::new("json-boards");
        let out = folder.path("run");
        let run = check("run", &["run", &example("tutorial.toml"), "--out", &out], Exit::Success);
        assert!(run["lateness"]["max_ticks"].is_i64(), "{run}");
        check("info", &["info", "--board", "uno"], Exit::Success);
        check("info", &["info", "--board", "pico"], Exit::Success);
        check("store", &["store", "--board", "uno"], Exit::Success);
        check("store", &["store", "--board", "uno", "--deadman", "500ms"], Exit::Success);
        check("bench", &["bench", "--board", "uno"], Exit::Success);
        let image = folder.path("sweep.hex");
        check("bake", &["bake", &example("sweep.toml"), "--output", &image], Exit::Success);
        let script = example("winch-script.txt");
        check("winch", &["winch", &script, "--native", "--out", &folder.path("winch")], Exit::Success);
    }
}
