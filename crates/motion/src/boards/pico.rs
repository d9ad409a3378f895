//! What the Pico's firmware does on the emulated chip: written by `cargo xtask bench pico`, not by hand. In ticks.

/// Shortest interval that holds for good, of each of 1 to 8 motors.
pub(super) const SHORTEST: [u32; 8] = [28, 38, 55, 72, 90, 110, 124, 144];

/// The same of each of 1 to 6 motors on coils.
pub(super) const COILS: [u32; 6] = [35, 67, 99, 131, 164, 199];

/// Shortest time between turns that holds for good, of each of 1 to 8 motors.
pub(super) const SEGMENT: [u32; 8] = [4686, 9681, 13813, 16921, 21323, 25576, 29940, 35088];
