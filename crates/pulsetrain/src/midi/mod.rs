//! MIDI: controllers turn knobs, keys and programs begin cues, and the clock sets the tempo of a live motion.
//!
//! # What is here, top down
//! - [`serve_midi`], [`ports`]: a port of the system, as a client of a motion's hub. They need the feature `midi`, since on Linux they stand on ALSA, a
//!   library of the system. Without it they say how to build it
//! - [`Interpreter`]: messages to requests, by `[live.midi]`; no port, no clock of its own
//! - [`ClockTempo`]: ticks of the MIDI clock to a tempo
//!
//! # What is not
//! It sends nothing: motorized faders do not follow. docs/midi.md is the page for users.

mod clock;
mod interpreter;
#[cfg(feature = "midi")]
mod port;

use miette::Diagnostic;

pub use clock::ClockTempo;
pub use interpreter::Interpreter;
#[cfg(feature = "midi")]
pub use port::{MidiConnection, ports, serve_midi};

/// Why there is no MIDI.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum MidiError {
    /// The program was built without it.
    #[error("this program was built without MIDI")]
    #[diagnostic(help(
        "in the repository, run `cargo install --path crates/pulsetrain --features midi`; Debian and Ubuntu need `apt install libasound2-dev` before"
    ))]
    NotBuilt,
    /// The motion file says nothing of MIDI.
    #[error("{file} has no [live.midi], so MIDI would do nothing")]
    #[diagnostic(help(
        "add it, for example: [live.midi] with knobs = {{ cc1 = \"speed\" }}; docs/midi.md describes it"
    ))]
    NoTable {
        /// The motion file.
        file: String,
    },
    /// The system has no MIDI.
    #[error("the system's MIDI cannot be used: {0}")]
    #[diagnostic(help("on Linux, look whether /dev/snd/seq is there and this user may open it"))]
    System(String),
    /// No port is called so, or several are.
    #[error("{} MIDI port has `{name}` in its name", if .several.is_empty() { "no" } else { "more than one" })]
    #[diagnostic(help("{}", if .known.is_empty() { "there is no MIDI port: is the device plugged in?".to_owned() } else { format!("there are: {}", .known.join("; ")) }))]
    Port {
        /// What was asked for.
        name: String,
        /// The ports that it could be.
        several: Vec<String>,
        /// All ports.
        known: Vec<String>,
    },
}

/// The only port of that name, or with that in its name.
///
/// # Errors
/// [`MidiError::Port`] if there is none, or several.
pub fn port_named(name: &str, known: &[String]) -> Result<usize, MidiError> {
    if let Some(exact) = known.iter().position(|port| port == name) {
        return Ok(exact);
    }
    let part = name.to_lowercase();
    let found: Vec<usize> = (0..known.len()).filter(|port| known[*port].to_lowercase().contains(&part)).collect();
    match found[..] {
        [only] => Ok(only),
        _ => Err(MidiError::Port {
            name: name.to_owned(),
            several: found.iter().map(|port| known[*port].clone()).collect(),
            known: known.to_vec(),
        }),
    }
}

/// The system's MIDI ports.
///
/// # Errors
/// [`MidiError::NotBuilt`].
#[cfg(not(feature = "midi"))]
pub fn ports() -> Result<Vec<String>, MidiError> {
    Err(MidiError::NotBuilt)
}

/// Lets a MIDI port steer a motion.
///
/// # Errors
/// [`MidiError::NotBuilt`].
#[cfg(not(feature = "midi"))]
pub fn serve_midi(_: &crate::control_socket::Hub, _: &str, _: pulsetrain_motion::file::Midi) -> Result<(), MidiError> {
    Err(MidiError::NotBuilt)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_is_found_by_a_part_of_its_name() {
        let known = ["Launch Control XL:0", "Midi Through:0", "Midi Through:1", "nanoKONTROL2"].map(str::to_owned);
        assert_eq!(port_named("nanokontrol", &known).unwrap(), 3);
        assert_eq!(port_named("Midi Through:1", &known).unwrap(), 2);
        let several = port_named("through", &known).unwrap_err();
        assert_eq!(several.to_string(), "more than one MIDI port has `through` in its name");
        let none = port_named("keystation", &known).unwrap_err();
        assert_eq!(none.to_string(), "no MIDI port has `keystation` in its name");
        let help = none.help().unwrap().to_string();
        assert!(help.starts_with("there are: Launch Control XL:0; "), "{help}");
    }
}
