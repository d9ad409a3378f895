//! Golden files: tables that a reviewer reads and a test compares.

use crate::command::{self, Done, cargo, command};

/// The tests that compare golden files: a package, and names that its tests begin with.
const COMPARED: [&str; 4] = [
    "pulsetrain-motion --test it -- file_errors::",
    "pulsetrain-plan --test it -- golden::",
    "pulsetrain-core --test it -- winch_golden::",
    "pulsetrain --test it -- commands:: formula:: chips::faults::",
];

/// Writes the golden files again, and prints which changed.
pub(crate) fn run() -> Done {
    for tests in COMPARED {
        command::run(cargo(&format!("test --package {tests}")).env("UPDATE_EXPECT", "1"))?;
    }
    command::run(command("git").args(["diff", "--stat", "--", "*/golden/*", "docs/faults.md"]))
}
