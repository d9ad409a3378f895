//! Ctrl-C: noted once, so that what runs can come to a planned end.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};

static WANTED: AtomicBool = AtomicBool::new(false);
static WATCHED: OnceLock<bool> = OnceLock::new();

/// From now on Ctrl-C (and a request to terminate) ends nothing by itself: [`wanted`] says that it came.
pub(crate) fn watch() {
    // Where it cannot be watched the system's own way stays: the process ends at once.
    WATCHED.get_or_init(|| ctrlc::set_handler(|| WANTED.store(true, Ordering::Relaxed)).is_ok());
}

/// Whether the user wants an end.
pub(crate) fn wanted() -> bool {
    WANTED.load(Ordering::Relaxed)
}
