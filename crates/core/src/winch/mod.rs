//! StepperWinch's dialect: text lines from the host, and a path that the board works out itself.
//!
//! # What is here, top down
//! - [`text`]: bytes of lines → commands
//! - [`reply`]: replies → bytes
//! - [`obey`]: a command, done to four paths
//! - [`spacing`]: a millisecond of a path → ticks of its steps
//! - [`path`]: the recurrence of one axis, at 1 kHz
//! - [`number`]: products and decimals without a floating point unit
//!
//! docs/winch.md has the commands and the equations.
//!
//! # What is not
//! Pins, clocks, queues, when to report: the firmware's. The same path as a law on the host is `pulsetrain-motion`'s
//! `law::winch`.

pub mod number;
pub mod path;
pub mod reply;
pub mod spacing;
pub mod text;

use path::{FASTEST_DRIFT, Path};
use text::{Command, Verb};

/// The axes, in the order of their bits, of positions in a status, and of [`obey`]'s paths.
pub const AXES: [u8; 4] = *b"xyza";

/// What `command` says to the axes, done; other commands do nothing to them, but for `enable 0`, which stops them all
/// within their limits. When they have stopped the drivers may be released.
///
/// ```
/// use pulsetrain_core::winch::path::Path;
/// use pulsetrain_core::winch::text::Reader;
/// let (mut reader, mut paths) = (Reader::new(), [const { Path::new() }; 4]);
/// for byte in *b"v y 1000\n" {
///     if let Some(Ok(command)) = reader.push(byte) {
///         pulsetrain_core::winch::obey(&mut paths, &command);
///     }
/// }
/// assert!(paths[0].is_at_rest() && !paths[1].is_at_rest());
/// ```
#[inline(never)]
pub fn obey(paths: &mut [Path; 4], command: &Command) {
    let mut bits = match *command {
        Command::Axes { axes, .. } | Command::Gains { axes, .. } | Command::Limits { axes, .. } => axes,
        Command::Enable(false) => 0b1111,
        _ => 0,
    };
    for (axis, path) in paths.iter_mut().enumerate() {
        if bits & 1 != 0 {
            match *command {
                Command::Axes { verb, values, .. } => {
                    let value = values.get(axis).copied().unwrap_or(0);
                    let [b0, b1, _, _] = value.to_le_bytes();
                    match verb {
                        Verb::Target => path.set_target(value),
                        Verb::Move => path.move_target(value),
                        Verb::Impulse => path.push_reference(value),
                        // The reader has bounded these two.
                        Verb::Drift => path.set_drift(i16::from_le_bytes([b0, b1])),
                        Verb::Ramp => path.set_ramp(u16::from_le_bytes([b0, b1])),
                    }
                }
                Command::Gains { gains, .. } => path.set_gains(gains),
                Command::Limits { limits, .. } => path.set_limits(limits),
                _ => path.stop(),
            }
        }
        bits >>= 1;
    }
}

// The reader's bound on drifts fits what `obey` hands on.
const _: () = assert!(FASTEST_DRIFT < 1 << 15);
