//! Runs what takes hours: all tests with new seeds, random motions, fuzzing, and mutants. People start it; CI never
//! does.

use crate::command::{self, Done, Failure, cargo, command, target_dir};
use crate::test::{self, Tier};
use crate::{accept, ci, fuzz};
use std::fs;
use std::path::PathBuf;
use std::time::{SystemTime, UNIX_EPOCH};

/// The release of cargo-mutants that is installed.
const MUTANTS: &str = "27.1.0";
/// If a mutant's tests take longer than this, s, they hang.
const MUTANT_HANGS_S: u32 = 300;
/// Crates whose mutants are tried, each with its own tests: the crates that decide about steps and need no chip.
const MUTATED: [&str; 3] = ["pulsetrain-core", "pulsetrain-plan", "pulsetrain-trace"];
/// Exit codes of cargo-mutants: no test noticed a mutant, and tests hung.
const SURVIVED: i32 = 2;
const HUNG: i32 = 3;

/// Number of cuts that `crates/pulsetrain/tests/it/chips/stops.rs` tries on each board in a round.
const CUTS: u64 = 4;

/// What is tried.
#[derive(clap::Args)]
pub(crate) struct SoakOptions {
    /// How many times all tests run, each time with the next seed
    #[arg(long, default_value_t = 10, value_name = "N")]
    rounds: u64,
    /// The first seed, of tests and motions; of the time of day if none is given
    #[arg(long, value_name = "S")]
    seed: Option<u64>,
    /// Random motions
    #[arg(long, default_value_t = 2000, value_name = "N")]
    motions: u64,
    /// Seconds for each fuzz target
    #[arg(long, default_value_t = 600, value_name = "N")]
    fuzz_seconds: u64,
    /// Instead: change one thing at a time in this crate's code, and list the changes that none of its tests notices
    #[arg(long, value_name = "CRATE", value_parser = MUTATED, conflicts_with_all = ["rounds", "seed", "motions", "fuzz_seconds"])]
    mutants: Option<String>,
    /// Instead: cut the cable at an instant of so many random motions on each board, and have the host stop as many and a half
    #[arg(long, value_name = "N", conflicts_with_all = ["rounds", "motions", "fuzz_seconds", "mutants"])]
    stops: Option<u64>,
    /// Of the mutants each n-th alone, beginning with the k-th
    #[arg(long, value_name = "k/n", requires = "mutants")]
    shard: Option<String>,
}

pub(crate) fn run(options: &SoakOptions) -> Done {
    if let Some(package) = &options.mutants {
        return mutants(package, options.shard.as_deref());
    }
    if let Some(cuts) = options.stops {
        return stops(cuts, options.seed);
    }
    let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
    let seed = options.seed.unwrap_or(now);
    println!("xtask soak: --seed {seed}");
    // If one fails, the others are tried all the same.
    let seeds = (0..options.rounds).map(|round| seed.wrapping_add(round));
    let mut done: Vec<_> = vec![ci::build_packages(), first_command()];
    done.extend(seeds.map(|seed| test::run(Tier::Soak { seed })));
    done.push(accept::run(&accept::Options::random(options.motions, seed)));
    done.push(fuzz::run(options.fuzz_seconds, None));
    command::all(done)?;
    println!("xtask soak: all passed, from --seed {seed} on");
    Ok(())
}

/// Size of the command line as users build it, bytes.
const MAX_BINARY: u64 = 15_000_000;

/// Runs the README's first command, word for word, and looks at the size of what it built.
fn first_command() -> Done {
    command::run(&mut cargo("run --release -- run examples/tutorial.toml"))?;
    let path = target_dir().join(format!("release/pulsetrain{}", std::env::consts::EXE_SUFFIX));
    let bytes = fs::metadata(&path).map_err(|why| Failure::File { path, why })?.len();
    println!("xtask soak: the released command line has {:.1} MB", bytes as f64 / 1e6);
    if bytes <= MAX_BINARY { Ok(()) } else { Err(Failure::Check(format!("{bytes} bytes are more than {MAX_BINARY}"))) }
}

/// Stops random motions on all boards, beginning with `seed`, or with the test's own seed. Prints the test's results.
fn stops(cuts: u64, seed: Option<u64>) -> Done {
    let mut test = cargo("test --package pulsetrain --test it stops:: -- --nocapture");
    test.env("PULSETRAIN_ROUNDS", cuts.div_ceil(CUTS).to_string());
    test.envs(seed.map(|seed| ("PULSETRAIN_SEED", seed.to_string())));
    let said = command::output(&mut test)?;
    said.lines().filter(|line| line.contains(" on ")).for_each(|line| println!("{line}"));
    println!(
        "xtask soak: {} cuts on uno, native, pico: all stopped within limits, counts as replayed",
        CUTS * cuts.div_ceil(CUTS)
    );
    Ok(())
}

/// Tries the mutants of a crate. Prints their number, and which no test noticed.
fn mutants(package: &str, shard: Option<&str>) -> Done {
    let (program, folder) = (installed()?, target_dir().join("mutants"));
    let mut mutants = command(program);
    mutants.args(["mutants", "--package", package, "--output"]).arg(&folder);
    mutants.args(["--timeout", &MUTANT_HANGS_S.to_string(), "--no-shuffle", "--colors", "never"]);
    if let Some(shard) = shard {
        mutants.args(["--shard", shard, "--sharding", "round-robin"]);
    }
    match command::run(&mut mutants) {
        Err(Failure::Status { status, .. }) if [Some(SURVIVED), Some(HUNG)].contains(&status.code()) => {}
        done => done?,
    }
    for (name, what) in
        [("caught", "caught"), ("missed", "missed by all tests"), ("timeout", "hung"), ("unviable", "no program")]
    {
        let path = folder.join("mutants.out").join(format!("{name}.txt"));
        let list = fs::read_to_string(&path).map_err(|why| Failure::File { path, why })?;
        println!("xtask soak: {package}: {} mutants {what}", list.lines().count());
        if name == "missed" {
            print!("{list}");
        }
    }
    Ok(())
}

/// cargo-mutants in a folder of its own, so that a user's installation does not change.
fn installed() -> Done<PathBuf> {
    let folder = target_dir().join("tools");
    command::run(cargo(&format!("install cargo-mutants --version {MUTANTS} --locked --root")).arg(&folder))?;
    Ok(folder.join("bin/cargo-mutants"))
}
