//! Runs virtual boards in real time, for a client at a pseudo-terminal or a socket, or for this program.
//!
//! [`Service::round`] knows no clock: its caller gives the board's time to reach. [`in_real_time`] gives it the time of
//! day. [`Paced`] makes a port of a virtual board that keeps pace with the time of day.

use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::thread;
use std::time::{Duration, Instant};

use pulsetrain_board::{Port, PortError, VirtualBoard};
use pulsetrain_core::wire::Baud;
use pulsetrain_trace::{Edge, Line, vcd_file};

/// A place where clients come and go: a pseudo-terminal or a socket.
pub trait Client {
    /// Receives the client's bytes, and says whether there is a client.
    ///
    /// # Errors
    /// If no client can come any more.
    fn poll(&mut self, into: &mut Vec<u8>) -> io::Result<bool>;

    /// Sends bytes to the client. If the client has gone away they are lost, which is no error.
    ///
    /// # Errors
    /// If no client can come any more.
    fn send(&mut self, bytes: &[u8]) -> io::Result<()>;

    /// The rate that the client has set, if it can set one.
    fn rate(&self) -> Option<u32>;
}

/// A virtual board with its client.
pub struct Service<B, C, W: Write> {
    board: B,
    client: C,
    trace: Option<vcd_file::EdgeWriter<W>>,
    present: bool,
    clients: u64,
    bytes: Vec<u8>,
    edges: Vec<pulsetrain_board::Edge>,
}

impl<B: VirtualBoard, C: Client, W: Write> Service<B, C, W> {
    /// Starts a board that has just been plugged in. Its edges are written to `trace`.
    ///
    /// # Errors
    /// If the trace cannot be written.
    pub fn new(board: B, client: C, trace: Option<W>) -> io::Result<Service<B, C, W>> {
        let lines: Vec<Line> = board.traced().map(|pin| Line::named(format!("pin{pin}"))).collect();
        let trace = trace
            .map(|out| vcd_file::EdgeWriter::new(out, board.cycles_per_s(), &lines))
            .transpose()
            .map_err(untraced)?;
        let (bytes, edges) = (Vec::new(), Vec::new());
        Ok(Service { board, client, trace, present: false, clients: 0, bytes, edges })
    }

    /// The board's time.
    #[must_use]
    pub fn now(&self) -> Duration {
        self.board.now()
    }

    /// Number of clients so far.
    #[must_use]
    pub const fn clients(&self) -> u64 {
        self.clients
    }

    /// Receives the client's bytes, lets the board run to `until`, and sends the board's bytes.
    ///
    /// # Errors
    /// If no client can come any more, or the trace cannot be written.
    pub fn round(&mut self, until: Duration) -> io::Result<()> {
        self.bytes.clear();
        let present = self.client.poll(&mut self.bytes)?;
        if present && !self.present {
            // Opening the port raises DTR, which resets the board.
            self.trace_edges()?;
            self.board.reset();
            self.clients += 1;
            // Bytes for the client before this one are dropped.
            self.board.set_baud(Baud::B115200).map_err(io::Error::other)?;
            self.begin()?;
        }
        self.present = present;
        if present {
            // A client changes its rate while no bytes are on their way, so the bytes of this round are at the new
            // rate.
            if let Some(rate) = self.client.rate() {
                self.board.set_client_rate(rate).map_err(io::Error::other)?;
            }
            self.board.send(&self.bytes).map_err(io::Error::other)?;
        }
        while self.board.now() < until {
            self.bytes.clear();
            self.board.receive(until, &mut self.bytes).map_err(io::Error::other)?;
            if self.present && !self.bytes.is_empty() {
                self.client.send(&self.bytes)?;
            }
        }
        self.trace_edges()
    }

    /// Lets the firmware start before it gets the client's first bytes: clients of StepperWinch do not wait for
    /// `awake`. A real Uno is deaf for a second or two longer, in its bootloader; so is a virtual one that has a
    /// bootloader.
    fn begin(&mut self) -> io::Result<()> {
        let listens = self.board.now() + UNTIL_IT_LISTENS;
        let mut said = Vec::new();
        while self.board.now() < listens {
            self.board.receive(listens, &mut said).map_err(io::Error::other)?;
        }
        if said.is_empty() { Ok(()) } else { self.client.send(&said) }
    }

    fn trace_edges(&mut self) -> io::Result<()> {
        self.edges.clear();
        self.board.edges(&mut self.edges);
        let (Some(trace), Some(zero)) = (&mut self.trace, self.board.zero()) else { return Ok(()) };
        let traced = self.board.traced();
        for edge in self.edges.iter().filter(|edge| traced.contains(&edge.line)) {
            let line = edge.line - traced.start();
            trace.push(Edge { tick: edge.tick + zero, line, level: edge.level }).map_err(untraced)?;
        }
        Ok(())
    }

    /// Ends the trace.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn finish(self) -> io::Result<()> {
        self.trace.map_or(Ok(()), vcd_file::EdgeWriter::finish).map_err(untraced)
    }
}

/// Names the trace in an error, since the full disk is the trace's and not the client's.
fn untraced(error: io::Error) -> io::Error {
    io::Error::new(error.kind(), format!("its trace cannot be written: {error}"))
}

/// A firmware reads its line this long after a reset, at the latest.
const UNTIL_IT_LISTENS: Duration = Duration::from_millis(10);

/// How long the thread sleeps between rounds: a frame of USB.
const ROUND: Duration = Duration::from_millis(1);

/// If the board is further behind, it does not catch up: its time goes on from there.
const FARTHEST_BEHIND: Duration = Duration::from_millis(100);

/// If the board is further ahead, its lead counts as a leap. A reset is a leap of 65 ms, and clients may come in quick
/// succession.
const FARTHEST_AHEAD: Duration = Duration::from_millis(100);

/// A virtual board as a port that keeps pace with the time of day.
#[derive(Debug)]
pub struct Paced<B> {
    board: B,
    /// The time of day at which the board's time was 0.
    began: Instant,
}

impl<B: Port> Paced<B> {
    /// Keeps pace from now on.
    pub fn new(board: B) -> Paced<B> {
        let began = Instant::now();
        Paced { began: began.checked_sub(board.now()).unwrap_or(began), board }
    }
}

impl<B: Port> Port for Paced<B> {
    fn now(&self) -> Duration {
        self.board.now()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
        self.board.send(bytes)
    }

    fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
        let had = into.len();
        while into.len() == had && self.board.now() < until {
            let due = self.began.elapsed();
            self.board.receive(due.min(until), into)?;
            let behind = due.saturating_sub(self.board.now()).min(until.saturating_sub(self.board.now()));
            if behind > FARTHEST_BEHIND {
                // The board does not catch up: its time goes on from here.
                self.began += behind;
            }
            if into.len() == had && behind < ROUND && self.board.now() < until {
                thread::sleep(ROUND);
            }
        }
        Ok(())
    }

    fn set_baud(&mut self, baud: Baud) -> Result<(), PortError> {
        self.board.set_baud(baud)
    }

    fn edges(&mut self, into: &mut Vec<pulsetrain_board::Edge>) {
        self.board.edges(into);
    }
}

/// A board's time beside the time of day, for a caller that waits by itself.
#[derive(Clone, Copy, Debug)]
pub struct RealTime {
    /// The time of day at which the board's time was 0.
    began: Instant,
}

impl RealTime {
    /// The board's time is `now`, now.
    #[must_use]
    pub fn from(now: Duration) -> RealTime {
        let began = Instant::now();
        RealTime { began: began.checked_sub(now).unwrap_or(began) }
    }

    /// When the board's time is `time`, if it keeps pace.
    #[must_use]
    pub fn moment(&self, time: Duration) -> Instant {
        self.began + time
    }

    /// How long to wait until the time of day is where the board's time is. A board that fell far behind does not catch up.
    pub fn ahead(&mut self, now: Duration) -> Duration {
        let due = self.began.elapsed();
        let behind = due.saturating_sub(now);
        if behind > FARTHEST_BEHIND {
            self.began += behind;
        }
        now.saturating_sub(due)
    }
}

/// Lets a virtual board keep pace with the time of day until `stop`, which gets the board's time, is true. Gives the
/// time that the board fell behind.
///
/// # Errors
/// As [`Service::round`].
pub fn in_real_time<B: VirtualBoard, C: Client, W: Write>(
    service: &mut Service<B, C, W>,
    stop: impl Fn(Duration) -> bool,
) -> io::Result<Duration> {
    // The board's time that was given up, and its leaps ahead in resets, one for each client.
    let (mut lost, mut leapt) = (Duration::ZERO, Duration::ZERO);
    let began = Instant::now();
    while !stop(service.now()) {
        let due = (began.elapsed() + leapt).saturating_sub(lost);
        // The rounds are short, so that a slow computer still hears its client and Ctrl-C.
        service.round(due.min(service.now() + 10 * ROUND))?;
        let due = (began.elapsed() + leapt).saturating_sub(lost);
        let behind = due.saturating_sub(service.now());
        if behind > FARTHEST_BEHIND {
            lost += behind;
        }
        leapt += service.now().saturating_sub(due).saturating_sub(FARTHEST_AHEAD);
        if behind < ROUND {
            thread::sleep(ROUND);
        }
    }
    Ok(lost)
}

/// Stands for no client, for boards that need none.
#[derive(Clone, Copy, Debug)]
pub struct Nobody;

impl Client for Nobody {
    fn poll(&mut self, _into: &mut Vec<u8>) -> io::Result<bool> {
        Ok(false)
    }

    fn send(&mut self, _bytes: &[u8]) -> io::Result<()> {
        Ok(())
    }

    fn rate(&self) -> Option<u32> {
        None
    }
}

/// A socket with one client at a time. A socket has no rate, so the board's line stays at 115 200 baud.
#[derive(Debug)]
pub struct Socket {
    listener: TcpListener,
    stream: Option<TcpStream>,
}

impl Socket {
    /// Listens at an address.
    ///
    /// # Errors
    /// If another program listens there, or the address is not this computer's.
    pub fn listen(address: SocketAddr) -> io::Result<Socket> {
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        Ok(Socket { listener, stream: None })
    }

    /// The address, with the port that the system chose if 0 was given.
    ///
    /// # Errors
    /// If the system does not tell.
    pub fn address(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }
}

impl Client for Socket {
    fn poll(&mut self, into: &mut Vec<u8>) -> io::Result<bool> {
        if self.stream.is_none() {
            match self.listener.accept() {
                Ok((stream, _)) => {
                    stream.set_nonblocking(true)?;
                    stream.set_nodelay(true)?;
                    self.stream = Some(stream);
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(false),
                Err(error) => return Err(error),
            }
        }
        let Some(stream) = &mut self.stream else { return Ok(false) };
        let mut buffer = [0; 1024];
        match stream.read(&mut buffer) {
            Ok(len) if len > 0 => into.extend_from_slice(&buffer[..len]),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
            // The client has closed the connection, or it broke.
            Ok(_) | Err(_) => self.stream = None,
        }
        Ok(self.stream.is_some())
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        // If a client does not read, bytes that do not fit are lost, as at a real port.
        let gone = |error: io::Error| error.kind() != io::ErrorKind::WouldBlock;
        if self.stream.as_mut().is_some_and(|stream| stream.write_all(bytes).is_err_and(gone)) {
            self.stream = None;
        }
        Ok(())
    }

    fn rate(&self) -> Option<u32> {
        None
    }
}

#[cfg(unix)]
pub use pty::Pty;

#[cfg(unix)]
mod pty {
    use super::Client;
    use pulsetrain_board::link::TAKEN;
    use pulsetrain_core::wire::Baud;
    use serialport::{SerialPort, TTYPort};
    use std::io::{self, Read, Write};
    use std::os::unix::fs::symlink;
    use std::path::{Path, PathBuf};
    use std::time::Duration;

    /// A pseudo-terminal for each client, with a link to the one that is free. The link is removed in the end. With a
    /// new terminal a client finds no rate, no lock and no byte of the client before, and one that closes is not
    /// mistaken for the next one, however soon that opens.
    #[derive(Debug)]
    pub struct Pty {
        /// Whether a client has it open.
        served: Option<PtyEnd>,
        /// Where the link points to.
        free: PtyEnd,
        /// The last client's terminal: another client may have followed the link just before it changed, and is served
        /// there all the same.
        before: Option<PtyEnd>,
        link: PathBuf,
    }

    /// The board's end.
    #[derive(Debug)]
    struct PtyEnd {
        master: TTYPort,
        /// The client's end.
        name: String,
    }

    impl Pty {
        /// Makes the terminal and the link.
        ///
        /// # Errors
        /// If a file of that name exists, or none can be made there.
        pub fn new(link: &Path) -> io::Result<Pty> {
            // A link that points nowhere was left by a run that was killed. The new terminal may have the old one's
            // name.
            if link.is_symlink() && !link.exists() {
                std::fs::remove_file(link)?;
            }
            let free = PtyEnd::new()?;
            symlink(&free.name, link)?;
            Ok(Pty { served: None, free, before: None, link: link.to_owned() })
        }

        /// A client has opened the free terminal: makes a new one and points the link to it in one step, so that there
        /// always is a link.
        fn serve(&mut self) -> io::Result<()> {
            let mut name = self.link.clone().into_os_string();
            name.push(format!(".{}", std::process::id()));
            let (aside, fresh) = (PathBuf::from(name), PtyEnd::new()?);
            symlink(&fresh.name, &aside)?;
            crate::files::outputs::rename_own(&aside, &self.link)
                .inspect_err(|_| drop(std::fs::remove_file(&aside)))?;
            self.served = Some(std::mem::replace(&mut self.free, fresh));
            Ok(())
        }
    }

    impl PtyEnd {
        /// Closes the client's end again, so that the board's end can tell whether a client has it open.
        fn new() -> io::Result<PtyEnd> {
            let (mut master, mut client) = TTYPort::pair()?;
            // The rate for a client that sets none. It stays when the client's end is closed.
            client.set_baud_rate(Baud::B115200.rate())?;
            master.set_timeout(Duration::ZERO)?;
            let name = client.name().ok_or_else(|| io::Error::other("the pseudo-terminal has no name"))?;
            Ok(PtyEnd { master, name })
        }

        /// Receives the client's bytes, and says whether a client has the terminal open.
        fn hear(&mut self, into: &mut Vec<u8>) -> bool {
            let mut buffer = [0; 1024];
            match self.master.read(&mut buffer) {
                Ok(len) => into.extend_from_slice(&buffer[..len]),
                // A client is there, and has sent nothing.
                Err(error) => return error.kind() == io::ErrorKind::TimedOut,
            }
            true
        }
    }

    impl Client for Pty {
        fn poll(&mut self, into: &mut Vec<u8>) -> io::Result<bool> {
            if let Some(mut served) = self.served.take() {
                if !served.hear(into) {
                    // The next client is served from the next round on, so that the board first sees that this one is
                    // gone.
                    self.before = Some(served);
                    return Ok(false);
                }
                self.served = Some(served);
                let mut dropped = Vec::new();
                if self.free.hear(&mut dropped) && !dropped.is_empty() {
                    let _ = self.free.master.write(TAKEN);
                }
                return Ok(true);
            }
            if self.free.hear(into) {
                self.serve()?;
            } else if self.before.as_mut().is_some_and(|before| before.hear(into)) {
                self.served = self.before.take();
            }
            Ok(self.served.is_some())
        }

        fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
            // If a client does not read, bytes that do not fit are lost, as at a real port.
            if let Some(served) = &mut self.served {
                let _ = served.master.write(bytes);
            }
            Ok(())
        }

        fn rate(&self) -> Option<u32> {
            self.served.as_ref()?.master.baud_rate().ok()
        }
    }

    impl Drop for Pty {
        fn drop(&mut self) {
            // If another program has removed the link, that is no error; and what it put there stays.
            if std::fs::read_link(&self.link).is_ok_and(|to| to == Path::new(&self.free.name)) {
                let _ = std::fs::remove_file(&self.link);
            }
        }
    }
}
