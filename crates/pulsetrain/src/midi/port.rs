//! A MIDI port of the system, as a client of a motion's hub.

use std::time::Duration;

use midir::{Ignore, MidiInput, MidiInputConnection};
use pulsetrain_motion::file::Midi;

use super::{Interpreter, MidiError, port_named};
use crate::control_socket::Hub;
use crate::live::ClientKind;

/// What this program is called among the system's MIDI clients.
const NAME: &str = "pulsetrain";

/// A connected port, until it is dropped.
pub struct MidiConnection(#[expect(dead_code, reason = "it is held")] MidiInputConnection<()>);

fn input() -> Result<MidiInput, MidiError> {
    let mut input = MidiInput::new(NAME).map_err(|error| MidiError::System(error.to_string()))?;
    input.ignore(Ignore::SysexAndActiveSense);
    Ok(input)
}

/// The names of the system's MIDI ports that something comes from.
///
/// # Errors
/// [`MidiError::System`].
pub fn ports() -> Result<Vec<String>, MidiError> {
    let input = input()?;
    // A port that is unplugged meanwhile has no name.
    Ok(input.ports().iter().map(|port| input.port_name(port).unwrap_or_default()).collect())
}

/// Lets a MIDI port steer a motion.
///
/// # Errors
/// If there is no such port, or it cannot be used.
pub fn serve_midi(hub: &Hub, name: &str, midi: Midi) -> Result<MidiConnection, MidiError> {
    let system = |error: &dyn std::fmt::Display| MidiError::System(error.to_string());
    let input = input()?;
    let ports = input.ports();
    let names: Vec<String> = ports.iter().map(|port| input.port_name(port).unwrap_or_default()).collect();
    let port = &ports[port_named(name, &names)?];
    let client = hub.join(ClientKind::Midi).map_err(|error| system(&error))?;
    // It takes no lines.
    let (sender, lines) = client.split();
    drop(lines);
    let mut interpreter = Interpreter::new(midi);
    let hear = move |stamp_us: u64, bytes: &[u8], (): &mut ()| {
        let knobs = sender.hub().info().knobs;
        sender.send_together(interpreter.hear(bytes, Duration::from_micros(stamp_us), &knobs));
    };
    input.connect(port, NAME, hear, ()).map(MidiConnection).map_err(|error| system(&error))
}
