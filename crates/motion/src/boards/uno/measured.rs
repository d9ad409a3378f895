//! The Uno's limits, measured on the emulated chip: written by `cargo xtask bench uno`, not by hand. In ticks.

/// Measured pulses, a column each. With the last the firmware works out one step at a time, on all pins.
pub(super) const PULSES: [u32; 4] = [16, 31, 80, 256];
/// Shortest interval that holds for ever, of each of 1 to 4 motors on one or two ports.
pub(super) const BY_SOFTWARE: [[u32; 4]; 4] =
    [[102, 119, 220, 1764], [303, 335, 574, 1657], [432, 484, 1007, 2448], [586, 753, 1414, 3490]];
/// Shortest interval of two motors on pins 2-7, each with a DIR line of its own: they have a ring each.
pub(super) const PAIR: [u32; 4] = [210, 336, 440, 3656];
/// Shortest interval of one or two motors whose edges the compare hardware makes.
pub(super) const BY_COMPARE: [[u32; 4]; 2] = [[102, 102, 1976, 1976], [205, 209, 3905, 3905]];
/// Largest |edge − scheduled| beyond the constant.
pub(super) const LATENESS: u32 = 57;
/// How far ahead it commits itself at most.
pub(super) const HORIZON: u32 = 55093;
