//! What takes hours: new seeds, longer random tests, more motions, fuzzing, and mutants. Run by hand, never by CI.

use crate::command::{self, Done, Failure, cargo, command, root, target_dir};
use crate::test::{self, Tier};
use crate::{accept, fuzz};
use std::path::PathBuf;

/// The release of cargo-mutants that is installed.
const MUTANTS: &str = "27.1.0";
/// A mutant whose tests take longer hangs, s.
const MUTANT_HANGS_S: u32 = 300;
/// Crates whose mutants are tried, each by its own tests: what is not on a chip and decides about steps.
const MUTATED: [&str; 3] = ["pulsetrain-core", "pulsetrain-plan", "pulsetrain-trace"];

/// What is tried.
#[derive(clap::Args)]
pub(crate) struct Options {
    /// Random tests are so many times as long as in `cargo xtask test`
    #[arg(long, default_value_t = 10, value_name = "N")]
    rounds: u64,
    /// Seed of all random tests and motions
    #[arg(long, default_value_t = 1, value_name = "S")]
    seed: u64,
    /// Random motions
    #[arg(long, default_value_t = 2000, value_name = "N")]
    motions: u64,
    /// Seconds for each fuzz target
    #[arg(long, default_value_t = 600, value_name = "N")]
    fuzz_seconds: u64,
    /// Instead: change one thing at a time in this crate's code, and list the changes that none of its tests notices
    #[arg(long, value_name = "CRATE", value_parser = MUTATED, conflicts_with_all = ["rounds", "seed", "motions", "fuzz_seconds"])]
    mutants: Option<String>,
    /// Of the mutants each n-th alone, beginning with the k-th
    #[arg(long, value_name = "k/n", requires = "mutants")]
    shard: Option<String>,
}

pub(crate) fn run(options: &Options) -> Done {
    if let Some(package) = &options.mutants {
        return mutants(package, options.shard.as_deref());
    }
    // One that fails does not keep the others from being tried.
    let done = vec![
        test::run(Tier::Soak { rounds: options.rounds, seed: options.seed }),
        accept::run(&accept::Options::random(options.motions, options.seed)),
        fuzz::run(options.fuzz_seconds, None),
    ];
    command::all(done)?;
    println!("xtask soak: all passed");
    Ok(())
}

/// Tries the mutants of a crate. Those that no test notices are printed, and in target/mutants/mutants.out/missed.txt.
fn mutants(package: &str, shard: Option<&str>) -> Done {
    let program = installed()?;
    let mut mutants = command(program);
    mutants.args(["mutants", "--package", package, "--output"]).arg(target_dir().join("mutants"));
    mutants.args(["--timeout", &MUTANT_HANGS_S.to_string(), "--no-shuffle", "--colors", "never"]);
    if let Some(shard) = shard {
        mutants.args(["--shard", shard, "--sharding", "round-robin"]);
    }
    match command::run(&mut mutants) {
        // Survivors are a result to look at.
        Err(Failure::Status { status, .. }) if status.code() == Some(2) => Ok(()),
        done => done,
    }
}

/// cargo-mutants, in a folder of its own: what users have installed stays as it is.
fn installed() -> Done<PathBuf> {
    let folder = target_dir().join("tools");
    command::run(
        cargo(&format!("install cargo-mutants --version {MUTANTS} --locked --root")).arg(root().join(&folder)),
    )?;
    Ok(folder.join("bin/cargo-mutants"))
}
