//! The Pico's limits, measured on the emulated chip: written by `cargo xtask bench pico`, not by hand. In ticks.

/// Shortest interval that holds for ever, of each of 1 to 8 motors.
pub(super) const SHORTEST: [u32; 8] = [28, 44, 62, 77, 97, 115, 137, 166];

/// Shortest interval that holds for ever, of each of 1 to 6 motors on coils.
pub(super) const COILS: [u32; 6] = [38, 70, 101, 137, 171, 208];

/// Shortest time between queued segments of one direction, of each of 1 to 8 motors.
pub(super) const ONWARD: [u32; 8] = [1754, 3516, 4989, 6422, 8258, 10127, 12108, 13762];

/// Shortest time between queued segments that reverse, of each of 1 to 8 motors.
pub(super) const TURNING: [u32; 8] = [4459, 9443, 13124, 16502, 20244, 24938, 29155, 33223];

/// Additional time for each segment that comes from the host meanwhile, of each of 1 to 8 motors.
pub(super) const HEARD: [u32; 8] = [228, 1264, 3379, 5380, 8166, 10150, 13040, 15087];
