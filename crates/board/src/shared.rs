//! A port that several hosts use, one after the other or at the same time, as programs on one computer may.

use crate::{Port, PortError};
use pulsetrain_core::wire::Baud;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// A port with a clone for each host. Edges of the board's pins stay with the port itself, so that no host takes them from another.
///
/// ```
/// use pulsetrain_board::{Remote, RemoteError, LinkError, shared::Shared};
/// use pulsetrain_testkit::model::ModelPort;
///
/// let line = Shared::new(ModelPort::new());
/// let first = Remote::open(line.clone(), 1)?;
/// assert!(line.port().is_taken());
/// assert_eq!(Remote::open_if_free(line.clone(), 2).err(), Some(RemoteError::Link(LinkError::Taken)));
/// first.close();
/// assert!(Remote::open_if_free(line, 3).is_ok());
/// # Ok::<(), RemoteError>(())
/// ```
#[derive(Debug)]
pub struct Shared<P>(Arc<Mutex<P>>);

impl<P> Shared<P> {
    /// A port that no host uses yet.
    pub fn new(port: P) -> Shared<P> {
        Shared(Arc::new(Mutex::new(port)))
    }

    /// The port itself. Hosts wait until the guard is dropped.
    pub fn port(&self) -> MutexGuard<'_, P> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

// Not derived: `P` need not be `Clone`.
impl<P> Clone for Shared<P> {
    fn clone(&self) -> Shared<P> {
        Shared(Arc::clone(&self.0))
    }
}

impl<P: Port> Port for Shared<P> {
    fn now(&self) -> Duration {
        self.port().now()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
        self.port().send(bytes)
    }

    fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
        self.port().receive(until, into)
    }

    fn set_baud(&mut self, baud: Baud) -> Result<(), PortError> {
        self.port().set_baud(baud)
    }
}
