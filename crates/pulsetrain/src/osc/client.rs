//! OSC as a client of a motion's hub.

use std::net::{SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use pulsetrain_session::control::Ended;

use super::{Agenda, Group, Now, OscError, OscInfo, OscServer, OscSettings, listen};
use crate::control_socket::{Hub, HubLines, HubSender};
use crate::live::{Batch, ClientKind, Ending, RunEnded, RunEvent, RunInfo, RunLine};

/// Groups that may wait for the motion.
const MOST_WAITING: usize = 64;
/// A group goes to the motion this long before its time: its change is planned then, and begins at its tick.
const AHEAD: Duration = Duration::from_millis(400);
/// How often the end of the motion is looked for.
const LOOK: Duration = Duration::from_millis(100);

/// Lets OSC steer a motion, in threads of its own, until the motion ends. Gives the address at which it listens.
///
/// # Errors
/// If the address cannot be used, or the system has no more threads.
pub fn serve_osc(hub: &Hub, settings: OscSettings) -> Result<SocketAddr, OscError> {
    serve_osc_on(hub, listen(settings.address)?, settings.reply_port)
}

/// As [`serve_osc`], at a socket that [listens](listen) already: the port was free before anything moved.
///
/// # Errors
/// If the system has no more threads.
pub fn serve_osc_on(hub: &Hub, socket: UdpSocket, reply_port: Option<u16>) -> Result<SocketAddr, OscError> {
    let client = hub.join(ClientKind::Osc).map_err(|error| OscError::Thread(std::io::Error::other(error)))?;
    client.follow(true);
    let (sender, groups) = sync_channel(MOST_WAITING);
    let server = Arc::new(OscServer::on(socket, reply_port, info_of(&hub.info()), sender)?);
    let (requests, lines) = client.split();
    let (hub, passing) = (hub.clone(), Arc::clone(&server));
    let spawn = |name: &str| thread::Builder::new().name(name.into());
    let passing = spawn("OSC requests").spawn(move || pass_on(&hub, &requests, &groups, &passing));
    let passing = passing.map_err(OscError::Thread)?;
    let address = server.address();
    let answering = spawn("OSC answers").spawn(move || answer(&lines, server, passing));
    answering.map(|_| address).map_err(OscError::Thread)
}

/// Tells the clients what happens until the motion ends. `passing` is the other thread that has the server.
fn answer(lines: &HubLines, server: Arc<OscServer>, passing: JoinHandle<()>) {
    while let Some(line) = lines.next_line() {
        match serde_json::from_str(&line) {
            Ok(RunLine::Event(event)) => server.tell(&event),
            Ok(RunLine::Info(info)) => server.set_info(info_of(&info)),
            Ok(RunLine::Ended(ended)) => server.tell(&last_event(ended)),
            Ok(RunLine::Control { .. } | RunLine::Error { .. }) | Err(_) => {}
        }
    }
    // The run waits for this client, and the server has sent all answers when it is dropped: only then does the program end.
    drop(passing.join());
    drop(server);
}

/// The event that the run's last line stands for.
fn last_event(RunEnded { ended, why, .. }: RunEnded) -> RunEvent {
    let of = |stopped: bool| RunEvent::Ended(Ended { counted: Vec::new(), stopped, uncertain: None });
    match ended {
        Ending::Stopped => of(true),
        Ending::Finished => of(false),
        Ending::Failed => RunEvent::Failed { why: why.unwrap_or_default(), at_s: None, positions: None, advice: None },
    }
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
            // Before the motion's clock is known nothing moves: the group acts when it begins. One whose time is past acts at once, and its sender hears
            // how late.
            let at_s = sender.and_then(|sender| {
                let at_s = hub.time_at(due)?;
                server.expect(at_s, sender);
                Some(at_s)
            });
            requests.send(Batch { commands: group, at_s });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::live::RunCommand;
    use rosc::{OscPacket, OscType};
    use std::sync::mpsc::channel;

    /// A client hears that the motors brake, and how the motion ends.
    #[test]
    fn a_stop_is_answered_until_the_motors_rest() {
        let failed = RunEnded::failed("no board".to_owned());
        let stopped = RunEnded { ended: Ending::Stopped, why: None, ..failed.clone() };
        let finished = RunEnded { ended: Ending::Finished, ..stopped.clone() };
        for (ended, state) in [(stopped, "stopped"), (finished, "finished"), (failed, "failed")] {
            let (sender, requests) = channel();
            let hub = Hub::of_live(RunInfo { is_live: true, ..RunInfo::nothing() }, sender);
            let settings = OscSettings { address: SocketAddr::from(([127, 0, 0, 1], 0)), reply_port: None };
            let address = serve_osc(&hub, settings).unwrap();
            let client = UdpSocket::bind(("127.0.0.1", 0)).unwrap();
            client.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
            let hears = || {
                let mut heard = [0; 256];
                let length = client.recv(&mut heard).unwrap();
                match rosc::decoder::decode_udp(&heard[..length]).unwrap().1 {
                    OscPacket::Message(message) => message,
                    OscPacket::Bundle(bundle) => panic!("{bundle:?}"),
                }
            };
            client.send_to(b"/setDestIp\0\0,\0\0\0", address).unwrap();
            assert_eq!(hears().addr, "/destIp");
            client.send_to(b"/stop\0\0\0,\0\0\0", address).unwrap();
            assert_eq!(requests.recv().unwrap(), RunCommand::Stop.into());
            hub.publish(&RunEvent::Stopping { at_s: 1.0 });
            hub.end(&ended);
            for state in ["stopping", state] {
                let heard = hears();
                assert_eq!(
                    (heard.addr.as_str(), &heard.args[..]),
                    ("/pulsetrain/state", &[OscType::String(state.into())][..])
                );
            }
        }
    }

    /// The motion has stepped since the group's time.
    #[test]
    fn the_sender_of_a_group_whose_time_is_past_hears_how_late_it_acts() {
        let (sender, requests) = channel();
        let hub = Hub::of_live(RunInfo { is_live: true, ..RunInfo::nothing() }, sender);
        hub.looked();
        let settings = OscSettings { address: SocketAddr::from(([127, 0, 0, 1], 0)), reply_port: None };
        let server = OscServer::open(settings, OscInfo::default(), sync_channel(1).0).unwrap();
        let client = UdpSocket::bind(("127.0.0.1", 0)).unwrap();
        // Only a broken server makes it wait to the end.
        client.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        let now = Now::read().instant;
        hub.set_clock(now + Duration::from_millis(250), 5.0);
        let (group, groups) = sync_channel(1);
        let pause = RunCommand::Pause;
        let sender = Some(client.local_addr().unwrap());
        group.send(Group { requests: vec![pause.clone()], due: now, sender }).unwrap();
        drop(group);
        let (motion, _lines) = hub.join(ClientKind::Osc).unwrap().split();
        pass_on(&hub, &motion, &groups, &server);
        assert_eq!(requests.try_recv(), Ok(Batch { commands: vec![pause], at_s: Some(4.75) }));
        server.tell(&RunEvent::Late { wanted_s: 4.75, by_s: 0.5 });
        let mut heard = [0; 64];
        let length = client.recv(&mut heard).unwrap();
        assert!(heard[..length].starts_with(b"/pulsetrain/late\0\0\0\0,f\0\0"), "{heard:?}");
    }
}
