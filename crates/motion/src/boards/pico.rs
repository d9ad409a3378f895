//! What the Pico's firmware does on the emulated chip: written by `cargo xtask bench pico`, not by hand. In ticks.

/// Shortest interval that holds for good, of each of 1 to 8 motors.
pub(super) const SHORTEST: [u32; 8] = [28, 37, 54, 71, 88, 105, 123, 139];
