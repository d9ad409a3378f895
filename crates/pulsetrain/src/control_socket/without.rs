//! Stands in where there are no Unix sockets: runs obey Ctrl-C alone.

use std::sync::mpsc::Receiver;

use pulsetrain_session::control::{Command, Event};

use super::{RunEnded, RunInfo, RunLine, SocketError};
use crate::console::Console;
use crate::interrupt;

/// The commands to a run: those of Ctrl-C.
#[derive(Debug)]
pub struct InterruptsAlone {
    commands: Receiver<Command>,
}

impl InterruptsAlone {
    /// Listens to Ctrl-C.
    pub fn open(_: &RunInfo, _: &mut Console<'_>) -> InterruptsAlone {
        InterruptsAlone { commands: interrupt::commands().1 }
    }

    /// The commands.
    #[must_use]
    pub fn commands(&self) -> &Receiver<Command> {
        &self.commands
    }

    /// No client has asked for a stop.
    #[must_use]
    pub fn wants_stop(&self) -> bool {
        false
    }

    /// There is no client to hear of it.
    pub fn tell(&self, _: &Event) {}

    /// There is no client to hear of it.
    pub fn end(self, _: &RunEnded) {}
}

/// A client's end of a run's control socket. There is none on this system.
#[derive(Debug)]
pub enum NoClient {}

impl NoClient {
    /// What the run said of itself.
    #[must_use]
    pub fn info(&self) -> &RunInfo {
        match *self {}
    }

    /// Sends a command.
    ///
    /// # Errors
    /// Never: there is no run.
    pub fn command(&mut self, _: Command) -> Result<(), SocketError> {
        match *self {}
    }

    /// Asks for statuses.
    ///
    /// # Errors
    /// Never: there is no run.
    pub fn follow(&mut self) -> Result<(), SocketError> {
        match *self {}
    }

    /// The next line of the run.
    ///
    /// # Errors
    /// Never: there is no run.
    pub fn next_line(&mut self) -> Result<RunLine, SocketError> {
        match *self {}
    }
}

/// The runs of this user.
///
/// # Errors
/// Always: this system has no control socket.
pub fn runs() -> Result<Vec<NoClient>, SocketError> {
    Err(SocketError::System)
}
