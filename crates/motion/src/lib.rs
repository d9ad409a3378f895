//! What the user says: motion files, quantities with units, laws, drivers, motors, boards' limits.
//!
//! ```
//! use pulsetrain_motion::file;
//!
//! let text = r#"
//!     board = "uno"
//!     [motor.wheel]
//!     steps_per_rev = 200
//!     microsteps = 4
//!     driver = "DQ542MA"
//!     pins = { step = 8, dir = 9 }
//!     forward = "high"
//!     [[motion]]
//!     motor = "wheel"
//!     law.sine = { amplitude = "2.5 rev", period = "10 s", cycles = 1 }
//! "#;
//! let no_other_files = |_: &std::path::Path| Err(std::io::ErrorKind::NotFound.into());
//! let program = file::read(text, "wheel.toml", &no_other_files)?;
//! assert_eq!((program.board.name.as_str(), program.motors[0].scale.steps_per_unit), ("uno", 800.0));
//!
//! let error = file::read(&text.replace("2.5 rev", "2.5 kg"), "wheel.toml", &no_other_files).unwrap_err();
//! assert!(error.plain().starts_with("wheel.toml:11:"));
//! # Ok::<(), file::FileError>(())
//! ```
//!
//! # What is here
//! - [`mod@file`]: motion files (TOML) with errors that point at the place; [`template`]: one to begin with
//! - [`program`]: what a file comes to, in steps, seconds and nanoseconds; [`Grid`]: θ to step times
//! - [`drivers`]: the table of drivers' needs; [`boards`]: a profile of each board; [`electrical`]: what a winding allows;
//!   [`full_steps`]: what a motor makes in a revolution
//! - [`columns`]: CSV files, with columns by their names and units
//! - [`law`]: θ(t) as a stream of analytic pieces; [`machine`]: several motors that draw one figure
//! - [`human`]: numbers as people read them
//! - [`quantity`]: numbers with units; [`time`]: law time, exact; [`whole_power`]: a power that is equal on all platforms
//!
//! # What is not
//! Step times and segments (`pulsetrain-plan`), edges (`pulsetrain-trace`, `pulsetrain-board`).
#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "what tests compute may differ in the last digit"))]
#![forbid(unsafe_code)]

pub mod boards;
pub mod columns;
pub mod drivers;
pub mod electrical;
pub mod file;
pub mod full_steps;
pub mod grid;
pub mod human;
pub mod law;
pub mod machine;
mod motor;
mod power;
pub mod program;
pub mod quantity;
pub mod template;
pub mod time;

pub use grid::{Grid, TOUCH_DOUBT_STEPS, TOUCH_STEPS};
pub use law::{Law, LawError};
pub use power::whole_power;
pub use time::Time;
