//! Standalone motions: plans that a board plays from power-up on, without a computer.
//!
//! ```
//! use pulsetrain_bake::{BakeError, Image, Sketch};
//! use pulsetrain_motion::file;
//!
//! let text = r#"
//!     board = "uno"
//!     tolerance = "1 us"
//!
//!     [motor.wheel]
//!     steps_per_rev = 200
//!     driver = "A4988"
//!     pins = { step = 8, dir = 9 }
//!     forward = "high"
//!     max_acceleration = "50 rev/s^2"
//!
//!     [[motion]]
//!     motor = "wheel"
//!     law.sine = { amplitude = "1 rev", period = "2 s", cycles = "forever" }
//! "#;
//! let no_files = |_: &std::path::Path| Err(std::io::ErrorKind::NotFound.into());
//! let mut program = file::read(text, "wheel.toml", &no_files)?;
//!
//! // The firmware with the motion behind it, for `pulsetrain flash` or avrdude.
//! let image = Image::new(&program)?;
//! assert!(image.endless && image.flash.len() <= Image::FLASH_BYTES);
//! assert!(image.hex().starts_with(':'));
//!
//! // The motion as an Arduino sketch, for the Arduino IDE.
//! let sketch = Sketch::new(&program, "wheel")?;
//! assert!(sketch.text.contains("void setup()"));
//!
//! // An Uno's image is refused for other boards.
//! program.board.name = "pico".to_owned();
//! assert!(matches!(Image::new(&program), Err(BakeError::Board { .. })));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # What is here, top down
//! - [`rehearsal`]: an Uno's image on the virtual Uno, before anybody writes it to a real one
//! - [`image`]: an image of an Uno's flash; [`pico`]: of a Pico's. The board's own firmware plays them
//! - `streams`: motors' plans as packed bytes, with a turn that repeats, for these images
//! - [`sketch`]: an Arduino sketch that plays tables; `parts`: the motion in the terms of its player (`player.h`)
//! - [`table`]: motors' plans as rows, with a turn that repeats
//! - `error`: why a motion cannot be baked
//!
//! # What is not
//! Writing an image to a board (the command line), motions that a computer feeds (`pulsetrain-session`).
#![forbid(unsafe_code)]

mod error;
pub mod image;
mod parts;
pub mod pico;
pub mod rehearsal;
pub mod sketch;
mod streams;
pub mod table;
mod target;

pub use error::BakeError;
pub use image::Image;
pub use parts::Size;
pub use pico::PicoImage;
pub use sketch::Sketch;
pub use table::{PutOff, Room, Row, Table, tables};
pub use target::Target;
