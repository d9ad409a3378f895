//! Numbers of the Uno's firmware that its limits follow from, in ticks: a copy of some of firmware/uno/src/engine/tuning.rs, which a crate
//! for the host cannot import. xtask/tests/it/uno_tuning.rs compares the two.

/// Latency of an edge that an interrupt makes, at most.
pub(super) const LATENCY: u32 = 24;
/// The same where the merge moves it too, or another ring's interrupt may come first.
pub(super) const LATENCY_MERGED: u32 = 60;
/// Time between two groups, at least.
pub(super) const SPACING: u32 = 48;
/// The same on the shield's pins: with the short pulse, and with pulses of 1.9 µs.
pub(super) const SPACING_SHIELD: [u32; 2] = [60, 76];
/// The same with the compare hardware, or with two rings on port D.
pub(super) const SPACING_TWO_RINGS: u32 = 96;
/// The same with two motors of the compare hardware.
pub(super) const SPACING_TWO_COMPARE: u32 = 171;
/// Time from a group's tick to its second write.
pub(super) const END_DELAY: u32 = 16;
/// The longest pulse that one interrupt begins and ends. A longer one is ended by a match of its own.
pub(super) const MAX_PULSE: u32 = 31;
