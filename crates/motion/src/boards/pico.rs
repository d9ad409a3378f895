//! What the Pico's firmware does on the emulated chip: written by `cargo xtask bench pico`, not by hand. In ticks.

/// Shortest interval that holds for good, of each of 1 to 8 motors.
pub(super) const SHORTEST: [u32; 8] = [28, 37, 54, 71, 88, 105, 123, 139];
/// The same of each of 1 to 6 motors on coils.
pub(super) const COILS: [u32; 6] = [50, 92, 138, 184, 230, 276];
/// Shortest time between turns that holds for good, of each of 1 to 8 motors.
pub(super) const SEGMENT: [u32; 8] = [5100, 10400, 14900, 18300, 22900, 27500, 32100, 36700];
