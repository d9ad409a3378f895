//! A run's end: what its clients and Ctrl-C ask for, and what they hear.

use std::sync::mpsc::{Receiver, channel};

use pulsetrain_session::control::Command;

use super::ControlSocket;
use super::hub::Hub;
use crate::console::Console;
use crate::interrupt;
use crate::live::{Batch, RunCommand, RunEnded, RunEvent, RunInfo};

/// A run's hub with its control socket, and the commands of its clients and of Ctrl-C.
#[derive(Debug)]
pub struct Control {
    hub: Hub,
    commands: Receiver<Command>,
    batches: Receiver<Batch>,
    /// `None` if the socket could not be made.
    socket: Option<ControlSocket>,
}

impl Control {
    /// Listens to Ctrl-C and at a socket for a run. If there can be no socket, it prints why, and the run goes on without.
    pub fn open(info: &RunInfo, console: &mut Console<'_>) -> Control {
        let (to_commands, commands) = channel();
        let (to_batches, batches) = channel();
        // After the end of a run the channel is closed, and a command is dropped.
        let hub = if info.is_live {
            let pressed = to_batches.clone();
            interrupt::send_to(move |command| {
                let _ = pressed.send(RunCommand::from(command).into());
            });
            Hub::of_live(info.clone(), to_batches)
        } else {
            let pressed = to_commands.clone();
            interrupt::send_to(move |command| {
                let _ = pressed.send(command);
            });
            Hub::of_run(info.clone(), to_commands)
        };
        let socket = ControlSocket::listen(&info.name, &hub).map_err(|error| {
            console.tell(format_args!("`pulsetrain stop` cannot reach this run, only Ctrl-C can: {error}\n"));
        });
        Control { hub, commands, batches, socket: socket.ok() }
    }

    /// The hub, which other transports join.
    #[must_use]
    pub fn hub(&self) -> &Hub {
        &self.hub
    }

    /// The commands to a `run`, as they come.
    #[must_use]
    pub fn commands(&self) -> &Receiver<Command> {
        &self.commands
    }

    /// The commands to a live motion, as they come. A `run` has none.
    #[must_use]
    pub fn batches(&self) -> &Receiver<Batch> {
        &self.batches
    }

    /// Whether a client has asked for a stop.
    #[must_use]
    pub fn wants_stop(&self) -> bool {
        self.hub.wants_stop()
    }

    /// Sends the clients an event. It never waits for them.
    pub fn publish(&self, event: &RunEvent) {
        self.hub.publish(event);
    }

    /// Sends the clients how the run ended, and closes the socket.
    pub fn end(mut self, ended: &RunEnded) {
        self.close(Some(ended));
    }

    fn close(&mut self, ended: Option<&RunEnded>) {
        self.hub.close(ended);
        // No client comes any more.
        drop(self.socket.take());
        self.hub.wait_for_clients();
    }
}

impl Drop for Control {
    fn drop(&mut self) {
        self.close(None);
    }
}
