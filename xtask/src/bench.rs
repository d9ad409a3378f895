//! Figures: measured by the benches, compared with the bounds, written to docs/benchmarks.md.

use crate::command::{Done, cargo, output};

/// Measures, prints and writes.
pub(crate) fn run() -> Done {
    let rows = output(&mut cargo("bench --package pulsetrain-plan --bench figures"))?;
    print!("{rows}");
    Ok(())
}
