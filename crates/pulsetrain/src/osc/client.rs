//! OSC as a client of a motion's hub.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::thread;
use std::time::Duration;

use super::{Agenda, Group, Now, OscError, OscInfo, OscServer, OscSettings};
use crate::control_socket::{ClientKind, Hub, HubSender, RunInfo, RunLine};
use crate::live::{Happened, Request};

/// Groups that may wait for the motion.
const MOST_WAITING: usize = 64;
/// A group goes to the motion this long before its time: its change is planned then, and begins at its tick.
const AHEAD: Duration = Duration::from_millis(400);
/// How often the end of the motion is looked for.
const LOOK: Duration = Duration::from_millis(100);

/// Lets OSC steer a motion, in threads of its own, until the motion ends.
///
/// # Errors
/// If the address cannot be used, or the system has no more threads.
pub fn serve_osc(hub: &Hub, settings: OscSettings) -> Result<(), OscError> {
    let client = hub.join(ClientKind::Osc).map_err(|error| OscError::Thread(std::io::Error::other(error)))?;
    client.follow(true);
    let (sender, groups) = sync_channel(MOST_WAITING);
    let server = Arc::new(OscServer::open(settings, info_of(&hub.info()), sender)?);
    let (requests, lines) = client.split();
    let (hub, told) = (hub.clone(), Arc::clone(&server));
    let spawn = |name: &str| thread::Builder::new().name(name.into());
    spawn("OSC answers")
        .spawn(move || {
            while let Some(line) = lines.next_line() {
                match serde_json::from_str(&line) {
                    Ok(RunLine::Event(event)) => told.tell(&Happened::Session(event)),
                    Ok(RunLine::Live(event)) => told.tell(&Happened::Live(event)),
                    Ok(RunLine::Info(info)) => told.set_info(info_of(&info)),
                    Ok(RunLine::Ended(_) | RunLine::Control { .. } | RunLine::Error { .. }) | Err(_) => {}
                }
            }
        })
        .map_err(OscError::Thread)?;
    spawn("OSC requests").spawn(move || pass_on(&hub, &requests, &groups, &server)).map(drop).map_err(OscError::Thread)
}

fn info_of(info: &RunInfo) -> OscInfo {
    OscInfo { motors: info.motors.clone(), knobs: info.knobs.clone() }
}

/// Passes groups on when they are due. `server` listens as long as this runs.
fn pass_on(hub: &Hub, requests: &HubSender, groups: &Receiver<Group>, server: &OscServer) {
    let mut agenda = Agenda::default();
    while !hub.is_over_within(Duration::ZERO) {
        let ahead = Now::read().instant + AHEAD;
        let wait = agenda.next_due().map_or(LOOK, |due| due.saturating_duration_since(ahead).min(LOOK));
        match groups.recv_timeout(wait) {
            // A full agenda drops what comes: nobody plans a thousand changes in earnest.
            Ok(group) => drop(agenda.push(group)),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
        let now = Now::read().instant;
        while let Some(Group { requests: group, due, sender }) = agenda.take_due(now + AHEAD) {
            // Before the motion's clock is known nothing moves: the group acts when it begins.
            let at_s = sender.and_then(|sender| {
                let at_s = hub.time_at(due)?;
                server.expect(at_s, sender);
                Some(at_s)
            });
            requests.send(Request::together(group, at_s));
        }
    }
}
