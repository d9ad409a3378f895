//! Runs the tests that a contributor runs before sending a change.

use crate::command::{self, Done, Failure, cargo, command};
use crate::{arduino, boards, python, ruckig};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::thread;
use std::time::Instant;

/// How much a run of the tests covers. `CONTRIBUTING.md` has the table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Tier {
    /// Tests without firmware, for trying a change while it is written.
    Quick,
    /// All tests that guard a change. The gate runs the same.
    Change,
    /// Also the long tests, with another seed, and more cases of each property test.
    Soak { seed: u64 },
}

/// Tests that run firmware on an emulated chip have a module of this name in their path.
const CHIPS: &str = "chips";
/// Tests that only `cargo xtask soak` runs have a module of this name in their path.
const LONG: &str = "long";

impl Tier {
    fn takes(self, test: &str) -> bool {
        let is_in = |name| test.split("::").any(|module| module == name);
        match self {
            Tier::Quick => !is_in(CHIPS) && !is_in(LONG),
            Tier::Change => !is_in(LONG),
            Tier::Soak { .. } => true,
        }
    }

    /// The environment variables that the tests read.
    fn environment(self) -> Vec<(&'static str, String)> {
        let all = match self {
            Tier::Quick | Tier::Change => vec![],
            Tier::Soak { seed } => {
                vec![
                    ("PROPTEST_CASES", 1024),
                    ("PULSETRAIN_LONG", 1),
                    ("PULSETRAIN_ROUNDS", 4),
                    ("PROPTEST_RNG_SEED", seed),
                    ("PULSETRAIN_SEED", seed),
                ]
            }
        };
        all.into_iter().map(|(name, number)| (name, number.to_string())).collect()
    }
}

/// Runs all tests of the workspace and its documentation's examples. All but the quick tier also run those with
/// Debian's bootloaders and [`others`].
pub(crate) fn run(tier: Tier) -> Done {
    let quick = tier == Tier::Quick;
    let optiboot = if quick { None } else { arduino::prepare()? };
    let jobs = jobs(tier)?;
    let (count, begin) = (jobs.len(), Instant::now());
    let (waiting, computing): (Vec<_>, _) = jobs.into_iter().partition(Job::waits);
    let run = |job: Job| {
        let mut test = job.command();
        test.envs(tier.environment());
        test.envs(optiboot.as_ref().map(|image| ("PULSETRAIN_OPTIBOOT", image)));
        command::run_apart(&mut test, &job.text).map(|said| (seconds(&said), job.text))
    };
    let others_first = (!quick).then_some(None);
    let computing = others_first.into_iter().chain(computing.into_iter().map(Some));
    let tested = thread::scope(|scope| {
        let waiting = scope.spawn(|| waiting.into_iter().map(run).collect::<Vec<_>>());
        // Not more of these at a time than there are cores: some tests run boards in real time.
        let computed = command::side_by_side(computing, |job| {
            let begin = Instant::now();
            job.map_or_else(|| others(tier).map(|()| (begin.elapsed().as_secs_f64(), OTHERS.to_owned())), run)
        });
        computed.into_iter().chain(waiting.join().expect("a job gives its failure")).collect()
    });
    command::run(&mut cargo("test --workspace --doc --no-fail-fast"))?;
    print!("{}", longest(command::all(tested)?));
    let also = if quick { "no firmware ran" } else { OTHERS };
    let name = if quick { "test --quick" } else { "test" };
    println!(
        "xtask {name}: {count} modules of tests, documentation's examples, {also}: all passed, in {} s once built",
        begin.elapsed().as_secs()
    );
    Ok(())
}

/// What [`others`] tests.
const OTHERS: &str = "the Python client, the boards' core, S-curves against ruckig";

/// The tests of the Python client, core built for the boards' processors, and S-curves compared with ruckig's.
fn others(tier: Tier) -> Done {
    python::test_client(&tier.environment())?;
    boards::build_core()?;
    let worst = ruckig::compare()?;
    println!("s-curve durations of {} moves: at most {worst:.1e} (relative) from ruckig's", ruckig::MOVES);
    Ok(())
}

/// Number of the slowest modules that are printed.
const PRINTED: usize = 30;

/// A binary that `cargo test` would run.
#[derive(Clone, Debug, PartialEq)]
struct Binary {
    executable: PathBuf,
    package: String,
    /// The package's name.
    folder: PathBuf,
    /// Its name for cargo: `--test it`, `--lib`, `--bin pulsetrain`.
    flag: String,
}

/// Modules that wait at a virtual Uno's line and hardly compute. They run beside those that compute.
const WAITING: [&str; 1] = ["flash"];

/// The tests of one module of a binary.
#[derive(Clone, Debug, PartialEq)]
struct Job {
    binary: Binary,
    module: String,
    /// The tests' full names. A filter by a module's name would also match modules whose names end alike.
    tests: Vec<String>,
    /// The command that runs only them, for a person.
    text: String,
}

impl Binary {
    /// From cargo's message about it. `None` if it is not a test.
    fn from_message(message: &Value) -> Option<Binary> {
        message["profile"]["test"].as_bool()?.then_some(())?;
        let target = &message["target"];
        let flag = match (target["kind"][0].as_str()?, target["name"].as_str()?) {
            (kind @ ("test" | "bin" | "example" | "bench"), name) => format!("--{kind} {name}"),
            _ => "--lib".to_owned(),
        };
        // `path+file:///…/crates/core#pulsetrain-core@0.1.0`; the name is missing if the folder has the same name.
        let (path, version) = message["package_id"].as_str()?.rsplit_once('#')?;
        let package = version.split_once('@').map(|(name, _)| name).or_else(|| path.rsplit('/').next())?;
        Some(Binary {
            executable: message["executable"].as_str()?.into(),
            package: package.to_owned(),
            folder: Path::new(message["manifest_path"].as_str()?).parent()?.to_owned(),
            flag,
        })
    }

    /// Its command as cargo would run it, but with its tests one by one.
    fn command(&self) -> Command {
        let mut test = command(&self.executable);
        test.current_dir(&self.folder).env("CARGO_MANIFEST_DIR", &self.folder).env("RUST_TEST_THREADS", "1");
        test
    }

    /// Its tests that belong to `tier`, module by module. `listed` is its list of tests, a line each.
    fn jobs(&self, listed: &str, tier: Tier) -> Vec<Job> {
        let mut modules = BTreeMap::<_, Vec<String>>::new();
        let tests = listed.lines().filter_map(|line| line.strip_suffix(": test"));
        for test in tests.filter(|test| tier.takes(test)) {
            // `chips` itself is too large to be run in one piece.
            let inner = test.strip_prefix(CHIPS).and_then(|rest| rest.strip_prefix("::"));
            let past = test.len() - inner.unwrap_or(test).len();
            let module = inner.unwrap_or(test).find("::").map_or("", |end| &test[..past + end]);
            modules.entry(module).or_default().push(test.to_owned());
        }
        let job = |(module, tests): (&str, _)| {
            let environment: String =
                tier.environment().iter().map(|(name, value)| format!("{name}={value} ")).collect();
            let filter = if module.is_empty() { String::new() } else { format!(" {module}::") };
            let text = format!("{environment}cargo test -p {} {}{filter}", self.package, self.flag);
            Job { binary: self.clone(), module: module.to_owned(), tests, text }
        };
        modules.into_iter().map(job).collect()
    }
}

impl Job {
    fn command(&self) -> Command {
        let mut test = self.binary.command();
        test.arg("--exact").args(&self.tests);
        test
    }

    fn waits(&self) -> bool {
        WAITING.contains(&self.module.as_str())
    }

    /// The order of jobs; lower ones come first. Firmware takes longest, and no core should wait for the last of it.
    fn place(&self) -> (bool, &str) {
        (!self.module.starts_with(CHIPS), &self.binary.package)
    }
}

/// Builds all tests. Gives those of a tier in the order in which they start.
fn jobs(tier: Tier) -> Done<Vec<Job>> {
    let messages = command::output(&mut cargo("test --workspace --no-run --message-format json-render-diagnostics"))?;
    let mut jobs = Vec::new();
    for line in messages.lines() {
        let message = serde_json::from_str(line)
            .map_err(|why| Failure::Check(format!("cargo's answer is no JSON: {why}: {line}")))?;
        let Some(binary) = Binary::from_message(&message) else { continue };
        let listed = command::output(binary.command().args(["--list", "--format", "terse"]))?;
        jobs.extend(binary.jobs(&listed, tier));
    }
    jobs.sort_by(|a, b| a.place().cmp(&b.place()));
    Ok(jobs)
}

/// How long it took, by its last line.
fn seconds(said: &str) -> f64 {
    let last = said.rsplit_once("finished in ").and_then(|(_, rest)| rest.split_once('s'));
    last.and_then(|(number, _)| number.parse().ok()).unwrap_or(0.0)
}

/// The times of the slowest modules.
fn longest(mut took: Vec<(f64, String)>) -> String {
    took.sort_by(|(a, _), (b, _)| b.total_cmp(a));
    let all: f64 = took.iter().map(|(seconds, _)| seconds).sum();
    let rows = took.iter().take(PRINTED).map(|(seconds, text)| format!("{seconds:7.1} s  {text}\n"));
    rows.collect::<String>() + &format!("{all:7.1} s  all\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn binary() -> Binary {
        let message = serde_json::json!({
            "profile": { "test": true },
            "target": { "kind": ["test"], "name": "it" },
            "package_id": "path+file:///r/crates/board#pulsetrain-board@0.1.0",
            "executable": "/t/it-1",
            "manifest_path": "/r/crates/board/Cargo.toml",
        });
        Binary::from_message(&message).expect("a test")
    }

    const LISTED: &str = "\
link::a: test
uno_link::a: test
link::b::c: test
chips::uno::a: test
chips::uno::b: test
link::chips::d: test
chips::uno::long::e: test
alone: test
speed: benchmark
";

    fn tests_of(tier: Tier) -> Vec<(String, String)> {
        binary().jobs(LISTED, tier).into_iter().map(|job| (job.module, job.tests.join(" "))).collect()
    }

    fn pairs<const N: usize>(pairs: [(&str, &str); N]) -> Vec<(String, String)> {
        pairs.map(|(module, tests)| (module.to_owned(), tests.to_owned())).to_vec()
    }

    #[test]
    fn each_module_is_a_job_of_its_own() {
        let all = [
            ("", "alone"),
            ("chips::uno", "chips::uno::a chips::uno::b"),
            ("link", "link::a link::b::c link::chips::d"),
            ("uno_link", "uno_link::a"),
        ];
        assert_eq!(tests_of(Tier::Change), pairs(all));
        assert_eq!(binary().jobs(LISTED, Tier::Change)[2].text, "cargo test -p pulsetrain-board --test it link::");
    }

    #[test]
    fn the_quick_tier_runs_no_chip() {
        let quick = [("", "alone"), ("link", "link::a link::b::c"), ("uno_link", "uno_link::a")];
        assert_eq!(tests_of(Tier::Quick), pairs(quick));
    }

    #[test]
    fn long_tests_are_for_the_soak() {
        let of = |tier| tests_of(tier).into_iter().find(|(module, _)| module == "chips::uno").map(|(_, tests)| tests);
        assert_eq!(of(Tier::Change).as_deref(), Some("chips::uno::a chips::uno::b"));
        assert_eq!(of(Tier::Soak { seed: 7 }).as_deref(), Some("chips::uno::a chips::uno::b chips::uno::long::e"));
    }

    #[test]
    fn a_job_runs_no_test_of_another() {
        let jobs = binary().jobs("link::a: test\nuno_link::a: test\n", Tier::Change);
        let arguments = jobs[0].command().get_args().map(ToOwned::to_owned).collect::<Vec<_>>();
        assert_eq!(arguments, ["--exact", "link::a"]);
    }

    #[test]
    fn firmware_comes_first() {
        let jobs = binary().jobs(LISTED, Tier::Change);
        let first = jobs.iter().min_by(|a, b| a.place().cmp(&b.place())).expect("there are some");
        assert_eq!(first.module, "chips::uno");
    }

    #[test]
    fn what_is_printed_repeats_a_run() {
        let job = &binary().jobs("link::a: test\n", Tier::Soak { seed: 7 })[0];
        assert_eq!(
            job.text,
            "PROPTEST_CASES=1024 PULSETRAIN_LONG=1 PULSETRAIN_ROUNDS=4 PROPTEST_RNG_SEED=7 PULSETRAIN_SEED=7 cargo test -p \
             pulsetrain-board --test it link::"
        );
    }

    #[test]
    fn what_a_module_took_is_read() {
        assert_eq!(seconds("test result: ok. 3 passed; finished in 12.25s\n\n"), 12.25);
        assert_eq!(seconds("it died\n"), 0.0);
        let table = longest(vec![(1.0, "short".to_owned()), (2.5, "long".to_owned())]);
        assert_eq!(table, "    2.5 s  long\n    1.0 s  short\n    3.5 s  all\n");
    }
}
