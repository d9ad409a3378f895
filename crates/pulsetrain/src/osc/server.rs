//! The UDP socket, in threads of its own.

use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use super::{Group, LONGEST_PACKET, Now, OscError, OscInfo, OscReply, OscSettings, OwnAddress, Translator};
use crate::live::RunEvent;

/// How long the receiving thread waits for a packet before it looks whether it is to end.
const WAIT: Duration = Duration::from_millis(200);
/// Packets are counted in spans of this length.
const SPAN: Duration = Duration::from_millis(100);
/// The most packets in a span: 5000 in a second. More are left out unread. A fader at 60 Hz needs 60 in a second.
const MOST_IN_A_SPAN: u32 = 500;
/// Events that wait to be sent to the clients. Further ones are left out.
const MOST_WAITING: usize = 256;
/// The receiving thread ends after this many errors of the socket in a row.
const MOST_FAILURES: u32 = 1000;

/// Counts of a server.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OscCounts {
    /// Packets that were read.
    pub packets: u64,
    /// Packets that were no OSC.
    pub malformed: u64,
    /// Packets, messages and commands that were refused, the malformed packets included.
    pub refused: u64,
    /// Bundles that came after their time.
    pub late: u64,
    /// Packets that were left out unread since too many came at a time.
    pub flooded: u64,
    /// Groups of requests that were left out since the motion had not taken those before.
    pub overrun: u64,
    /// Events of the motion that no client heard of since too many waited.
    pub untold: u64,
}

/// OSC over UDP for a live motion, until it is dropped.
///
/// It never waits for the motion: groups that the channel has no room for are left out, counted, and refused to their sender. The motion never
/// waits for it: [`tell`](OscServer::tell) hands an event over or leaves it out.
#[derive(Debug)]
pub struct OscServer {
    address: SocketAddr,
    shared: Arc<OscShared>,
    happened: Option<SyncSender<RunEvent>>,
    threads: Vec<JoinHandle<()>>,
}

#[derive(Debug)]
struct OscShared {
    socket: UdpSocket,
    own: OwnAddress,
    translator: Mutex<Translator>,
    is_over: AtomicBool,
    flooded: AtomicU64,
    overrun: AtomicU64,
    untold: AtomicU64,
}

/// Listens at an address.
///
/// # Errors
/// [`OscError::Listen`] if the system does not give the address or the port.
pub fn listen(address: SocketAddr) -> Result<UdpSocket, OscError> {
    let refused = |why| OscError::Listen { address, why };
    let socket = UdpSocket::bind(address).map_err(refused)?;
    socket.set_read_timeout(Some(WAIT)).map_err(refused)?;
    Ok(socket)
}

impl OscServer {
    /// Listens, and sends what clients ask for to `groups`, whose length bounds what can wait for the motion.
    ///
    /// # Errors
    /// [`OscError::Listen`] if the system does not give the address or the port, [`OscError::Thread`] if it starts no thread.
    pub fn open(settings: OscSettings, info: OscInfo, groups: SyncSender<Group>) -> Result<OscServer, OscError> {
        OscServer::on(listen(settings.address)?, settings.reply_port, info, groups)
    }

    /// As [`open`](OscServer::open), at a socket that [listens](listen) already.
    ///
    /// # Errors
    /// As [`open`](OscServer::open).
    pub fn on(
        socket: UdpSocket,
        reply_port: Option<u16>,
        info: OscInfo,
        groups: SyncSender<Group>,
    ) -> Result<OscServer, OscError> {
        let address = socket.local_addr().map_err(OscError::Thread)?;
        let own = OwnAddress(address);
        let shared = Arc::new(OscShared {
            socket,
            own,
            translator: Mutex::new(Translator::new(info, reply_port).at(own)),
            is_over: AtomicBool::new(false),
            flooded: AtomicU64::new(0),
            overrun: AtomicU64::new(0),
            untold: AtomicU64::new(0),
        });
        let (happened, events) = sync_channel(MOST_WAITING);
        // From here on, a failure ends the thread that was started: the server is dropped.
        let mut server = OscServer { address, shared, happened: Some(happened), threads: Vec::with_capacity(2) };
        let (hears, tells) = (Arc::clone(&server.shared), Arc::clone(&server.shared));
        server.start("OSC in", move || hears.hear(&groups))?;
        server.start("OSC out", move || tells.tell(&events))?;
        Ok(server)
    }

    fn start(&mut self, name: &str, run: impl FnOnce() + Send + 'static) -> Result<(), OscError> {
        let thread = thread::Builder::new().name(name.to_owned()).spawn(run).map_err(OscError::Thread)?;
        self.threads.push(thread);
        Ok(())
    }

    /// Where it listens: with the port that the system chose if that was 0.
    #[must_use]
    pub const fn address(&self) -> SocketAddr {
        self.address
    }

    /// Tells the clients of what happened. It never waits.
    pub fn tell(&self, happened: &RunEvent) {
        if matches!(happened, RunEvent::Progress { .. }) {
            return;
        }
        if let Some(events) = &self.happened
            && let Err(TrySendError::Full(_)) = events.try_send(happened.clone())
        {
            self.shared.untold.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Notes for which time of the motion, s, a sender's group was passed on: it hears if the group acts later.
    pub fn expect(&self, at_s: f64, sender: SocketAddr) {
        self.shared.translator().expect(at_s, sender);
    }

    /// Other motors or knobs: the motion file was changed.
    pub fn set_info(&self, info: OscInfo) {
        self.shared.translator().set_info(info);
    }

    /// What came so far.
    #[must_use]
    pub fn counts(&self) -> OscCounts {
        let counted = self.shared.translator().counted();
        let of = |count: &AtomicU64| count.load(Ordering::Relaxed);
        OscCounts {
            packets: counted.packets,
            malformed: counted.malformed,
            refused: counted.refused,
            late: counted.late,
            flooded: of(&self.shared.flooded),
            overrun: of(&self.shared.overrun),
            untold: of(&self.shared.untold),
        }
    }
}

impl Drop for OscServer {
    fn drop(&mut self) {
        self.shared.is_over.store(true, Ordering::Relaxed);
        self.happened = None;
        for thread in self.threads.drain(..) {
            drop(thread.join());
        }
    }
}

impl OscShared {
    fn translator(&self) -> MutexGuard<'_, Translator> {
        self.translator.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Reads packets until the server is dropped, or nobody takes the groups.
    fn hear(&self, groups: &SyncSender<Group>) {
        // A byte more than allowed shows that a packet is too long.
        let mut buffer = vec![0; LONGEST_PACKET + 1];
        let mut budget = Budget { began: Instant::now(), left: MOST_IN_A_SPAN };
        let mut failures = 0;
        while !self.is_over.load(Ordering::Relaxed) && failures < MOST_FAILURES {
            let (length, from) = match self.socket.recv_from(&mut buffer) {
                Ok(received) => received,
                Err(error) => {
                    // On Windows a client that does not listen is an error here.
                    let is_usual = matches!(
                        error.kind(),
                        io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut | io::ErrorKind::Interrupted
                    );
                    failures = if is_usual { 0 } else { failures + 1 };
                    continue;
                }
            };
            failures = 0;
            // What it sent itself is no order.
            if self.own.is(from) {
                continue;
            }
            let now = Now::read();
            if !budget.has_room(now.instant) {
                self.flooded.fetch_add(1, Ordering::Relaxed);
                continue;
            }
            let mut translator = self.translator();
            let translation = translator.packet(&buffer[..length], from, now);
            let mut replies = translation.replies;
            for group in translation.groups {
                match groups.try_send(group) {
                    Ok(()) => {}
                    Err(TrySendError::Full(_)) => {
                        self.overrun.fetch_add(1, Ordering::Relaxed);
                        replies.extend(translator.overrun(from, now.instant));
                    }
                    // The motion is over.
                    Err(TrySendError::Disconnected(_)) => return,
                }
            }
            drop(translator);
            self.send(&replies);
        }
    }

    /// Sends what happens to the clients until the server is dropped.
    fn tell(&self, events: &Receiver<RunEvent>) {
        for event in events {
            let replies = self.translator().happened(&event, Instant::now());
            self.send(&replies);
        }
    }

    fn send(&self, replies: &[OscReply]) {
        for OscReply { to, packet } in replies {
            if self.own.is(*to) {
                continue;
            }
            // UDP promises nothing: a client that is gone hears nothing.
            drop(self.socket.send_to(packet, to));
        }
    }
}

/// How many packets may still be read in this span.
struct Budget {
    began: Instant,
    left: u32,
}

impl Budget {
    fn has_room(&mut self, now: Instant) -> bool {
        if now.saturating_duration_since(self.began) >= SPAN {
            *self = Budget { began: now, left: MOST_IN_A_SPAN };
        }
        let has_room = self.left > 0;
        self.left -= u32::from(has_room);
        has_room
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::live::RunCommand;
    use pulsetrain_session::control::{MotorStatus, Status};

    /// A client that waits for its answers; only a broken server makes it wait to the end.
    struct Client(UdpSocket);

    impl Client {
        fn of(server: &OscServer) -> Client {
            let socket = UdpSocket::bind(("127.0.0.1", 0)).unwrap();
            socket.connect(server.address()).unwrap();
            socket.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
            Client(socket)
        }

        /// Sends text of OSC, padded.
        fn send(&self, address: &str, arguments: &[u8]) {
            let mut packet = address.as_bytes().to_vec();
            packet.resize((packet.len() + 1).next_multiple_of(4), 0);
            packet.extend(arguments);
            self.0.send(&packet).unwrap();
        }

        fn hears(&self, beginning: &str) {
            let mut buffer = [0; 2048];
            let length = self.0.recv(&mut buffer).unwrap();
            let heard = String::from_utf8_lossy(&buffer[..length]);
            assert!(heard.starts_with(beginning), "{heard:?}");
        }
    }

    fn open(groups: SyncSender<Group>) -> OscServer {
        let settings = OscSettings { address: SocketAddr::from(([127, 0, 0, 1], 0)), reply_port: None };
        let motor = |name: &str| crate::live::MotorInfo {
            name: name.to_owned(),
            unit: "deg".to_owned(),
            steps_per_unit: 1.0,
            start_steps: 0.0,
            max_speed: None,
        };
        OscServer::open(settings, OscInfo { motors: vec![motor("x")], knobs: Vec::new() }, groups).unwrap()
    }

    #[test]
    fn packets_become_groups_and_events_become_packets() {
        let (sender, groups) = sync_channel(1);
        let server = open(sender);
        assert!(server.address().ip().is_loopback() && server.address().port() > 0);
        let client = Client::of(&server);
        client.send("/pause", b",\0\0\0");
        let group = groups.recv().unwrap();
        assert_eq!(group.requests, [RunCommand::Pause]);
        client.send("rubbish", b"");
        client.hears("/error/command\0\0,si\0the packet is no OSC");
        client.send("/setDestIp", b",\0\0\0");
        client.hears("/destIp\0,iiiii\0\0\0\0\0\x7f");
        client.send("/setPositionListReportInterval", b",i\0\0\0\0\0\x01");
        // Its answer shows that the packet before it was read, too.
        client.send("/getBusy", b",i\0\0\0\0\0\x01");
        client.hears("/busy\0\0\0,ii\0\0\0\0\x01\0\0\0\0");
        let motors = vec![MotorStatus { position: 77, target: None, speed: None, queue: (0, 0) }];
        let status = Status { at_s: 1.0, lease_s: None, motors, lateness: None };
        server.tell(&RunEvent::Status(status));
        client.hears("/positionList\0\0\0,i\0\0\0\0\0M");

        // The motion takes nothing: the first command waits in the channel, the second is refused.
        client.send("/resume", b",\0\0\0");
        client.send("/pause", b",\0\0\0");
        client.hears("/error/command\0\0,si\0too many commands at a time");
        assert_eq!(groups.recv().unwrap().requests, [RunCommand::Resume]);
        let counts = OscCounts { packets: 7, malformed: 1, refused: 2, overrun: 1, ..OscCounts::default() };
        assert_eq!(server.counts(), counts);
        // Its threads end with it.
        drop(server);
        assert!(groups.recv().is_err());
    }

    /// Whoever is told to answer at the own port would be answered by itself, for ever.
    #[test]
    fn nothing_is_sent_to_the_own_port_and_nothing_from_it_is_obeyed() {
        for listens_at in ["127.0.0.1:0", "0.0.0.0:0", "[::]:0"] {
            let socket = listen(listens_at.parse().unwrap()).unwrap();
            let port = socket.local_addr().unwrap().port();
            let (sender, groups) = sync_channel(4);
            let server = OscServer::on(socket, Some(port), OscInfo::default(), sender).unwrap();
            let client = UdpSocket::bind(("127.0.0.1", 0)).unwrap();
            client.connect(("127.0.0.1", port)).unwrap();
            client.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
            let client = Client(client);
            client.send("/setDestIp", b",\0\0\0");
            client.hears("/error/command\0\0,si\0port ");
            client.send("/setDestIp", &[&b",i\0\0\0\0"[..], &port.to_be_bytes()].concat());
            client.hears("/error/command\0\0,si\0port ");
            client.send("/pause", b",\0\0\0");
            assert_eq!(groups.recv().unwrap().requests, [RunCommand::Pause]);
            server.tell(&RunEvent::Stopping { at_s: 1.0 });
            // What the server sent to itself would have come before this.
            server.shared.socket.send_to(b"/stop\0\0\0,\0\0\0", ("127.0.0.1", port)).unwrap();
            client.send("/resume", b",\0\0\0");
            assert_eq!(groups.recv().unwrap().requests, [RunCommand::Resume]);
            assert_eq!(server.counts().packets, 4, "{listens_at}");
        }
    }

    #[test]
    fn a_port_that_is_taken_is_told() {
        let server = open(sync_channel(1).0);
        let settings = OscSettings { address: server.address(), reply_port: None };
        let error = OscServer::open(settings, OscInfo::default(), sync_channel(1).0).unwrap_err();
        assert!(error.to_string().starts_with(&format!("OSC cannot listen at {}: ", server.address())), "{error}");
    }

    #[test]
    fn a_flood_is_left_out_until_the_next_span() {
        let began = Instant::now();
        let mut budget = Budget { began, left: MOST_IN_A_SPAN };
        let mut read = |ms: u64| budget.has_room(began + Duration::from_millis(ms));
        assert_eq!((0..10_000).filter(|_| read(1)).count(), 500);
        assert_eq!((0..10_000).filter(|_| read(99)).count(), 0);
        assert_eq!((0..10_000).filter(|_| read(100)).count(), 500);
        // A clock that seems to go back gives no more.
        assert_eq!((0..10_000).filter(|_| read(50)).count(), 0);
    }
}
