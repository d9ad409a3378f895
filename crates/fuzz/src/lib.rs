//! What the fuzz targets check, one function for each target.
//!
//! # What is here
//! - [`TARGETS`]: each target with its check and the folders of its seeds
//! - `text`: everything that a user writes or hands in: motion files, formulas, tables, traces
//! - `link`: everything that comes over a line: packed steps, frames, StepperWinch's text
//!
//! `fuzz/fuzz_targets` gives these functions to libFuzzer (`cargo xtask fuzz`). The test of this crate gives them the
//! seeds, and damaged copies of the seeds: that needs no fuzzer and no second build of the workspace.
//!
//! # What is not
//! libFuzzer itself, which needs a C++ compiler and its own build: see `fuzz`.
#![forbid(unsafe_code)]

mod link;
mod text;

/// A fuzz target: `fuzz/fuzz_targets` has a file of this name.
pub struct Target {
    /// The name of the target.
    pub name: &'static str,
    /// The folders of its seeds, below the repository's top folder.
    pub seeds: &'static [&'static str],
    /// Panics if the input breaks a promise.
    pub check: fn(&[u8]),
}

/// All targets.
pub const TARGETS: [Target; 12] = [
    Target { name: "motion_file", seeds: &["examples"], check: text::motion_file },
    Target { name: "formula", seeds: &["fuzz/seeds/formula"], check: text::formula },
    Target { name: "table", seeds: &["fuzz/seeds/table"], check: text::table },
    Target { name: "vcd", seeds: &["fuzz/seeds/vcd"], check: text::vcd },
    Target { name: "saleae", seeds: &["fuzz/seeds/saleae"], check: text::saleae },
    Target { name: "sigrok", seeds: &["fuzz/seeds/sigrok"], check: text::sigrok },
    Target { name: "steps", seeds: &["fuzz/seeds/steps"], check: text::steps },
    Target { name: "camera", seeds: &["fuzz/seeds/camera"], check: text::camera },
    Target { name: "packing", seeds: &["fuzz/seeds/packing"], check: link::packing },
    Target { name: "wire", seeds: &["fuzz/seeds/wire"], check: link::wire },
    Target { name: "winch", seeds: &["fuzz/seeds/winch"], check: link::winch },
    Target { name: "winch_uno", seeds: &["fuzz/seeds/winch"], check: link::winch_uno },
];

/// Gives `input` to the target of this name. Panics if there is none, or if a promise breaks.
pub fn check(target: &str, input: &[u8]) {
    let found = TARGETS.iter().find(|known| known.name == target);
    (found.expect("a target of TARGETS").check)(input);
}

/// The input as libFuzzer's `fuzz_target!` decodes it: all bytes, read by the type.
fn decoded<'a, T: arbitrary::Arbitrary<'a>>(input: &'a [u8]) -> Option<T> {
    T::arbitrary_take_rest(arbitrary::Unstructured::new(input)).ok()
}
