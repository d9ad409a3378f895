//! Golden files: tables that a reviewer reads and a test compares.

use crate::command::{self, Done, cargo, command};

/// Writes the golden files again, and prints which changed.
pub(crate) fn run() -> Done {
    command::run(cargo("test --package pulsetrain-motion --test it file_errors::").env("UPDATE_EXPECT", "1"))?;
    command::run(cargo("test --package pulsetrain-plan --test it golden::").env("UPDATE_EXPECT", "1"))?;
    command::run(cargo("test --package pulsetrain-core --test it winch_golden::").env("UPDATE_EXPECT", "1"))?;
    command::run(cargo("test --package pulsetrain --test it chips::faults::").env("UPDATE_EXPECT", "1"))?;
    command::run(cargo("test --package pulsetrain --test it commands::").env("UPDATE_EXPECT", "1"))?;
    command::run(command("git").args(["diff", "--stat", "--", "*/golden/*", "docs/faults.md"]))
}
