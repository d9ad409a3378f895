//! Ctrl-C: counted, so that what runs can come to a planned end, or to a sudden one.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};

static TIMES: AtomicU32 = AtomicU32::new(0);
static WATCHED: OnceLock<bool> = OnceLock::new();

/// From now on Ctrl-C (and a request to terminate) ends nothing by itself: [`times`] says how often it came.
pub(crate) fn watch() {
    // Where it cannot be watched the system's own way stays: the process ends at once.
    let count = || {
        TIMES.fetch_add(1, Ordering::Relaxed);
    };
    WATCHED.get_or_init(|| ctrlc::set_handler(count).is_ok());
}

/// How often the user wanted an end.
pub(crate) fn times() -> u32 {
    TIMES.load(Ordering::Relaxed)
}

/// Whether the user wants an end.
pub(crate) fn wanted() -> bool {
    times() > 0
}
