//! The figures of films: how exact an angle is, on rendered clips.

use super::report;
use crate::command::{Done, command, output, root};
use crate::python;

/// Measures, prints and writes. The script fails if a bound is broken.
pub(crate) fn run() -> Done {
    let mut figures = command(python::with_tracker()?);
    let text = output(figures.args(["-m", "tests.film_figures"]).current_dir(root().join("python")))?;
    let section =
        format!("# Films\n\nWritten by `cargo xtask bench film`. Rendered clips; no camera was used.\n\n{text}");
    print!("{section}");
    report::write("film", &section)
}
