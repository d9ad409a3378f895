//! The promised rates, run by `pulsetrain run` on the virtual boards. `cargo xtask bench promises` writes the page.
//!
//! Prints a table with tabs between the fields. The first field says that the row is promised.
#![allow(clippy::disallowed_methods, reason = "benches open their own files")]

#[path = "../tests/it/common/mod.rs"]
mod common;

use common::promises::{COLUMNS, PROMISES};
use std::path::Path;

fn main() {
    println!("promised\t{}", COLUMNS.join("\t"));
    for promise in PROMISES {
        let run = promise.run(Path::new(env!("CARGO_BIN_EXE_pulsetrain")));
        let verdict = if run.fault.is_empty() { "holds" } else { &run.fault };
        println!("true\t1\t{}\t{}\t{:.2}\t{verdict}", promise.fields().join("\t"), run.steps, run.late_us);
    }
}
