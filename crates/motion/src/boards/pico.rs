//! What the Pico's firmware does on the emulated chip: written by `cargo xtask bench pico`, not by hand. In ticks.

/// Shortest interval that holds for good, of each of 1 to 8 motors.
pub(super) const SHORTEST: [u32; 8] = [28, 37, 54, 71, 88, 105, 123, 139];
/// The same of each of 1 to 6 motors on coils.
pub(super) const COILS: [u32; 6] = [50, 90, 130, 180, 220, 260];
/// Shortest time between turns that holds for good, of each of 1 to 8 motors.
pub(super) const SEGMENT: [u32; 8] = [5000, 8000, 11000, 14000, 17000, 20000, 23000, 26000];
