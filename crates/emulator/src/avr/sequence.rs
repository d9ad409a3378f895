//! The time limit of timed write sequences (DS40002061B §8.6.3, §9.12.2, §11.9.2, §12.4).
//!
//! Some registers can only change shortly after a first write has opened them, so that a program that has gone astray
//! does not change them by accident.

/// Cycles from the write that opens a timed sequence to the first cycle in which the second write comes too late. The
/// second write must take effect within four cycles of the first.
pub(super) const OPEN: u64 = 5;
