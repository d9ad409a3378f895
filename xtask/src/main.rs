//! Set-up, tests, benches, golden files: the one place that knows the toolchain.
//!
//! # What is here
//! - [`ci`], [`test`](mod@test): what must hold, each a list of commands
//! - [`soak`]: the same with new seeds, for hours, and mutants
//! - [`bench`](mod@bench), [`golden`], [`fuzz`]: what is measured, reviewed, tried
//! - [`accept`]: whether motions that `plan` accepts run
//! - [`pictures`]: what documents show
//! - [`arduino`]: what Debian has for the Uno, and tests use: bootloaders, compiler, avrdude
//! - [`installs`]: what Debian, PyPI and npm have for the tests; [`programs`]: what the workspace has
//! - [`usage`]: processor time, and a calibration loop
//! - [`python`]: the tests of the client in Python, and of films
//! - [`page`]: the page of a run, in Chromium
//! - [`ruckig`]: S-curve durations against an independent library
//! - [`cross_check`]: the emulator against simavr, avr8js, rp2040js and Unicorn
//! - [`firmware`](mod@firmware): the boards' firmware: built, measured, committed as images
//! - [`boards`]: core built for the boards' processors
//! - [`command`]: running a command, and saying which
//!
//! # What is not
//! The tests themselves: they are in each crate's `tests/`, and those of the whole repository in `xtask/tests/`.
#![allow(
    clippy::disallowed_methods,
    reason = "what it draws at random and rounds for people may differ in the last digit"
)]
#![forbid(unsafe_code)]

mod accept;
mod arduino;
mod bench;
mod boards;
mod ci;
mod command;
mod cross_check;
mod firmware;
mod fuzz;
mod golden;
mod installs;
mod map;
mod page;
mod pictures;
mod programs;
mod python;
mod random;
mod ruckig;
mod soak;
mod test;
mod usage;

use clap::{Parser, Subcommand};
use command::Done;
use std::process::ExitCode;

/// Development tasks of Pulsetrain; each installs what it needs.
#[derive(Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask", after_help = AFTER_HELP)]
struct Arguments {
    #[command(subcommand)]
    task: Task,
}

const AFTER_HELP: &str = "Examples:
  cargo xtask test --quick         while you write a change
  cargo xtask test                 before you send it
  cargo xtask ci                   what .ci/run runs
  cargo xtask soak --rounds 20 --seed 7      new seeds, and longer
  cargo xtask soak --stops 500     cables cut, and hosts that stop, at random instants of random motions
  cargo xtask soak --mutants pulsetrain-core --shard 0/50   which changes of the code no test notices
  cargo xtask bench promises       whether the boards reach the promised rates by `pulsetrain run`
  cargo xtask bench uno --hour     an hour on the virtual Uno
  cargo xtask bench uno --motions  how fast whole motions run on the virtual Uno
  cargo xtask accept --count 1000 --seed 7   random motions; `accept --seed 7 --only 42` is one of them
  cargo xtask fuzz --seconds 600   longer than CI does
  cargo xtask firmware --check     whether the committed image is what the source builds
  cargo xtask firmware --sizes 9df931b   what each image takes, lines by module, beside those of that commit";

#[derive(Subcommand)]
enum Task {
    /// All tests but the long ones, also the Python client's, core built for the boards' processors, S-curves against ruckig
    Test {
        /// Only tests that run no firmware on an emulated chip: a minute once they are built
        #[arg(long)]
        quick: bool,
    },
    /// `test`, and: format, lints, documentation, wasm32, what the packages contain, the firmware's images built anew and compared, the page
    /// in Chromium, other emulators, random motions
    ///
    /// At its end it prints what each stage took beside its budget. It fails if one took more than twice its budget of processor time.
    Ci {
        /// Only this stage, by its name in that table
        #[arg(long, value_name = "NAME")]
        stage: Option<String>,
    },
    /// Tests with new seeds and longer, random motions, fuzzing, mutants: for hours, by hand
    ///
    /// As it is by default, on 2 cores, once all is built: about 10 minutes for each of 10 rounds, 25 minutes for 2000 motions (some 80 a
    /// minute), an hour for 12 fuzz targets of 10 minutes, two at a time: some three hours.
    Soak(soak::SoakOptions),
    /// Plan and run random realistic motions with the program itself, on all boards, and say how many that `plan` accepts break
    Accept(accept::Options),
    /// Give random and damaged input to everything that reads some
    Fuzz {
        /// How long each target runs
        #[arg(long, default_value_t = 60, value_name = "N")]
        seconds: u64,
        /// Only this target, as in fuzz/fuzz_targets
        #[arg(long)]
        target: Option<String>,
    },
    /// Compare the AVR emulator with simavr (instructions, programs) and avr8js (timers)
    CrossCheck,
    /// Build the boards' firmware, print what it takes, and write the images that are committed
    Firmware {
        /// Which board; all, if none is said
        board: Option<Firmware>,
        /// Write nothing: fail when a committed image is not what the source builds
        #[arg(long)]
        check: bool,
        /// Write no image: build the Uno's, and print what they take and leave, and the lines of each module; beside a commit's lines, if one is
        /// said
        #[arg(long, value_name = "COMMIT", num_args = 0..=1, conflicts_with_all = ["check", "board"])]
        sizes: Option<Option<String>>,
    },
    /// Make a UF2 file, which a Pico takes, of a program that was linked with the Pico's library: beside it, with `.uf2`
    Uf2 {
        /// The linker's file, such as target/thumbv6m-none-eabi/release/myfw
        elf: std::path::PathBuf,
    },
    /// Measure figures, print them, and write docs/benchmarks/: without a section, the host's and the first run's
    Bench {
        /// Only these: a section of the report
        only: Option<Figures>,
        /// Of the Uno: the simulated hour of four motors on one DIR line; of the Pico: of eight; a section of its own
        #[arg(long, requires = "only")]
        hour: bool,
        /// Of the Uno: figure 2 alone, sustained rates while laws change; printed, not written
        #[arg(long, requires = "only", conflicts_with = "hour")]
        rates: bool,
        /// Of the Uno: figure 8 alone, how fast whole motions run; with so many seeds; printed, not written
        #[arg(long, requires = "only", conflicts_with_all = ["hour", "rates"], value_name = "SEEDS", num_args = 0..=1, default_missing_value = "4")]
        motions: Option<u64>,
    },
    /// Test the page of a run in Debian's Chromium
    Page {
        /// Leave screenshots: desktop and phone, dark and light
        #[arg(long)]
        pictures: bool,
    },
    /// Draw the crates, into ARCHITECTURE.md, and print the modules of each crate and what they import, as Mermaid text
    Map,
    /// Write the golden files anew; read the difference before you commit it
    Golden,
    /// Draw the documents' comparisons of the winch with the sketch; look at each before you commit it
    Pictures,
}

/// A board with a firmware.
#[derive(Clone, Copy, clap::ValueEnum)]
enum Firmware {
    /// The Arduino Uno: crates/board/images/uno*.hex
    Uno,
    /// The Raspberry Pi Pico: crates/board/images/pico.uf2
    Pico,
}

fn firmware(board: Option<Firmware>, check: bool) -> Done {
    if board.is_none_or(|board| matches!(board, Firmware::Uno)) {
        if check { firmware::check_uno()? } else { firmware::uno()? }
    }
    if board.is_none_or(|board| matches!(board, Firmware::Pico)) {
        if check { firmware::pico::check()? } else { firmware::pico::build()? }
    }
    Ok(())
}

/// Figures that are measured by themselves.
#[derive(Clone, Copy, clap::ValueEnum)]
enum Figures {
    /// Planning on this computer
    Host,
    /// The README's first command, in a clean clone with empty caches
    FirstRun,
    /// What the boards reach by `pulsetrain run`: the promised rates
    Promises,
    /// The Arduino Uno's firmware
    Uno,
    /// StepperWinch's text on it
    Winch,
    /// The Raspberry Pi Pico's firmware
    Pico,
    /// MOVE, SPEED and DIRECTION on it
    Verbs,
    /// The angle of a wheel in films
    Film,
    /// Motions that are changed while they run: latencies, hours of changes, the host's load
    Live,
}

fn main() -> ExitCode {
    if let Some(code) = firmware::pico::as_rustc() {
        return code;
    }
    let done = match Arguments::parse().task {
        Task::Test { quick } => test::run(if quick { test::Tier::Quick } else { test::Tier::Change }),
        Task::Ci { stage } => ci::run(stage.as_deref()),
        Task::Soak(options) => soak::run(&options),
        Task::Accept(options) => accept::run(&options),
        Task::Fuzz { seconds, target } => fuzz::run(seconds, target.as_deref()),
        Task::CrossCheck => cross_check::run(),
        Task::Firmware { sizes: Some(before), .. } => firmware::sizes(before.as_deref()),
        Task::Firmware { board, check, .. } => firmware(board, check),
        Task::Uf2 { elf } => firmware::pico::convert(&elf),
        Task::Bench { only: None, .. } => bench::host().and_then(|()| bench::first_run::run()),
        Task::Bench { only: Some(Figures::Host), .. } => bench::host(),
        Task::Bench { only: Some(Figures::FirstRun), .. } => bench::first_run::run(),
        Task::Bench { only: Some(Figures::Uno), rates: true, .. } => bench::uno::figure_2(),
        Task::Bench { only: Some(Figures::Uno), motions: Some(seeds), .. } => bench::uno::motions(seeds),
        Task::Bench { only: Some(Figures::Uno), hour: false, .. } => bench::uno::run(),
        Task::Bench { only: Some(Figures::Uno), hour: true, .. } => bench::uno::hour(),
        Task::Bench { only: Some(Figures::Promises), .. } => bench::promises::run(),
        Task::Bench { only: Some(Figures::Live), .. } => bench::live::run(),
        Task::Bench { only: Some(Figures::Winch), .. } => bench::winch::run(),
        Task::Bench { only: Some(Figures::Verbs), .. } => bench::verbs::run(),
        Task::Bench { only: Some(Figures::Film), .. } => bench::film::run(),
        Task::Bench { only: Some(Figures::Pico), hour: false, .. } => bench::pico::run(),
        Task::Bench { only: Some(Figures::Pico), hour: true, .. } => bench::pico::hour(),
        Task::Page { pictures } => page::test(pictures),
        Task::Map => map::run(&command::root()),
        Task::Golden => golden::run(),
        Task::Pictures => pictures::run(),
    };
    usage::write();
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("xtask: {failure}");
            ExitCode::FAILURE
        }
    }
}
