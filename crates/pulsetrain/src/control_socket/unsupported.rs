//! Stands in where there are no Unix sockets: runs obey Ctrl-C and their page.

use super::SocketError;
use super::hub::Hub;
use crate::live::{RunCommand, RunInfo, RunLine};

/// No socket.
#[derive(Debug)]
pub(super) struct NoSocket;

impl NoSocket {
    /// Does nothing.
    pub(super) fn listen(_: &str, _: &Hub) -> Result<NoSocket, SocketError> {
        Ok(NoSocket)
    }
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
    pub fn command(&mut self, _: &RunCommand) -> Result<(), SocketError> {
        match *self {}
    }

    /// Asks for statuses.
    ///
    /// # Errors
    /// Never: there is no run.
    pub fn follow(&mut self) -> Result<(), SocketError> {
        match *self {}
    }

    /// The next line of the run, if it comes within that time.
    ///
    /// # Errors
    /// Never: there is no run.
    pub fn next_line_within(&mut self, _: std::time::Duration) -> Result<Option<RunLine>, SocketError> {
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
