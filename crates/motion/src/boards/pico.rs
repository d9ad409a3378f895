//! What the Pico's firmware does on the emulated chip: written by `cargo xtask bench pico`, not by hand. In ticks.

/// Shortest interval that holds for good, of each of 1 to 8 motors.
pub(super) const SHORTEST: [u32; 8] = [28, 43, 59, 74, 92, 112, 133, 159];

/// The same of each of 1 to 6 motors on coils.
pub(super) const COILS: [u32; 6] = [37, 68, 101, 133, 166, 203];

/// Shortest time between segments that go the same way and are in the queues, of each of 1 to 8 motors.
pub(super) const ONWARD: [u32; 8] = [3027, 5800, 8045, 10127, 12737, 15246, 17821, 20895];

/// Shortest time between segments that turn and are in the queues, of each of 1 to 8 motors.
pub(super) const TURNING: [u32; 8] = [4686, 9681, 13813, 16921, 21323, 25576, 29940, 35088];

/// What more it is if they come from the host meanwhile, of each of 1 to 8 motors.
pub(super) const HEARD: [u32; 8] = [365, 1581, 3109, 6121, 7833, 10396, 13351, 15933];
