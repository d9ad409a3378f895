//! Virtual boards in real time: for a client at the other end of a pseudo-terminal or a socket, or for this program.
//!
//! [`Service::round`] knows no clock: it is told how far to come. [`in_real_time`] tells it the time of day. [`Paced`] is a
//! virtual board for whoever looks at it as time goes by.

use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::thread;
use std::time::{Duration, Instant};

use pulsetrain_board::{Port, PortError, VirtualBoard};
use pulsetrain_core::wire::Baud;
use pulsetrain_trace::{Edge, Line, vcd_file};

/// Where a client comes and goes.
pub trait Client {
    /// Takes what the client sent, and says whether there is one.
    ///
    /// # Errors
    /// When no client can come any more.
    fn poll(&mut self, into: &mut Vec<u8>) -> io::Result<bool>;

    /// Hands bytes over to the client. One that has gone away does not get them: that is no error.
    ///
    /// # Errors
    /// When no client can come any more.
    fn send(&mut self, bytes: &[u8]) -> io::Result<()>;

    /// The rate that the client set, if it can.
    fn rate(&self) -> Option<u32>;
}

/// A virtual board and its client.
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
    /// A board that has just been plugged in; edges are written to `trace`.
    ///
    /// # Errors
    /// When the trace cannot be begun.
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

    /// Clients so far.
    #[must_use]
    pub const fn clients(&self) -> u64 {
        self.clients
    }

    /// Takes what the client sent, lets the board come to `until`, and hands over what it said meanwhile.
    ///
    /// # Errors
    /// When no client can come any more, or the trace cannot be written.
    pub fn round(&mut self, until: Duration) -> io::Result<()> {
        self.bytes.clear();
        let present = self.client.poll(&mut self.bytes)?;
        if present && !self.present {
            // DTR, as the port is opened.
            self.trace_edges()?;
            self.board.reset();
            self.clients += 1;
            // Whatever the client before it had.
            self.board.set_baud(Baud::B115200).map_err(io::Error::other)?;
            self.begin()?;
        }
        self.present = present;
        if present {
            // A client changes its rate when nothing is under way, so what has come since is at the new one.
            if let Some(rate) = self.client.rate() {
                self.board.follow(rate).map_err(io::Error::other)?;
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

    /// Lets the firmware begin before it gets what the client has sent already: clients of StepperWinch do not wait for
    /// `awake`. A real Uno is deaf for a second or two more, in its bootloader; so is a virtual one that has one.
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
    /// When it cannot be written.
    pub fn finish(self) -> io::Result<()> {
        self.trace.map_or(Ok(()), vcd_file::EdgeWriter::finish).map_err(untraced)
    }
}

/// What is full is the trace's disk, not the line to the client.
fn untraced(error: io::Error) -> io::Error {
    io::Error::new(error.kind(), format!("its trace cannot be written: {error}"))
}

/// A firmware listens within so long after its reset.
const UNTIL_IT_LISTENS: Duration = Duration::from_millis(10);

/// How long the host sleeps between rounds: a frame of USB.
const ROUND: Duration = Duration::from_millis(1);

/// A chip that is further behind is not caught up with: its time goes on from where it is.
const FARTHEST_BEHIND: Duration = Duration::from_millis(100);

/// One that is further ahead goes on at once: a reset is a leap of 65 ms, and clients may come in close succession.
const FARTHEST_AHEAD: Duration = Duration::from_millis(100);

/// A virtual board that keeps pace with the time of day, as a port.
#[derive(Debug)]
pub struct Paced<B> {
    board: B,
    /// When the board's time was 0.
    began: Instant,
}

impl<B: Port> Paced<B> {
    /// From now on.
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
                // Not caught up with: its time goes on from where it is.
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

/// Lets a virtual board keep pace with the time of day until `stop` says so of its own time. Gives the time that it fell behind.
///
/// # Errors
/// As [`Service::round`].
pub fn in_real_time<B: VirtualBoard, C: Client, W: Write>(
    service: &mut Service<B, C, W>,
    stop: impl Fn(Duration) -> bool,
) -> io::Result<Duration> {
    // Of the chip's time: what was let go, and what it leapt ahead in resets, one for each client.
    let (mut lost, mut leapt) = (Duration::ZERO, Duration::ZERO);
    let began = Instant::now();
    while !stop(service.now()) {
        let due = (began.elapsed() + leapt).saturating_sub(lost);
        // In short strides, so that a slow computer still hears its client and Ctrl-C.
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

/// No client, ever: for boards that have nothing to say.
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

/// One client at a time on a socket. Its rate is not known, so that the line stays at 115 200 baud.
#[derive(Debug)]
pub struct Socket {
    listener: TcpListener,
    stream: Option<TcpStream>,
}

impl Socket {
    /// Listens at an address.
    ///
    /// # Errors
    /// When somebody else does, or it is none of this computer's.
    pub fn listen(address: SocketAddr) -> io::Result<Socket> {
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        Ok(Socket { listener, stream: None })
    }

    /// Where it listens: the port that was found, if 0 was asked for.
    ///
    /// # Errors
    /// When the system does not say.
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
            // It said good-bye, or is gone without a word.
            Ok(_) | Err(_) => self.stream = None,
        }
        Ok(self.stream.is_some())
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        // A client that does not read loses what does not fit, as at a real port.
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

    /// Pseudo-terminals, with a link to the one that is free, which is gone in the end. Each client gets a new one: it finds no
    /// rate, no lock and no byte of the one before, and a client that closes is not mistaken for the next, however soon that opens.
    #[derive(Debug)]
    pub struct Pty {
        /// A client has it.
        served: Option<PtyEnd>,
        /// Where the link leads.
        free: PtyEnd,
        /// What the last client had: another may have followed the link just before it was changed, and is served all the same.
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
        /// Makes both.
        ///
        /// # Errors
        /// When there is a file of that name, or none can be made there.
        pub fn new(link: &Path) -> io::Result<Pty> {
            // One that leads nowhere was left by a run that was killed. The new terminal may have the old one's name.
            if link.is_symlink() && !link.exists() {
                std::fs::remove_file(link)?;
            }
            let free = PtyEnd::new()?;
            symlink(&free.name, link)?;
            Ok(Pty { served: None, free, before: None, link: link.to_owned() })
        }

        /// A client has the free one: the link leads to another, without a moment in which there is none.
        fn serve(&mut self) -> io::Result<()> {
            let mut name = self.link.clone().into_os_string();
            name.push(format!(".{}", std::process::id()));
            let (aside, fresh) = (PathBuf::from(name), PtyEnd::new()?);
            symlink(&fresh.name, &aside)?;
            std::fs::rename(&aside, &self.link).inspect_err(|_| drop(std::fs::remove_file(&aside)))?;
            self.served = Some(std::mem::replace(&mut self.free, fresh));
            Ok(())
        }
    }

    impl PtyEnd {
        /// The client's end is closed again: then the other end knows whether somebody has it open.
        fn new() -> io::Result<PtyEnd> {
            let (mut master, mut client) = TTYPort::pair()?;
            // For a client that sets no rate; it stays as the client's end is closed.
            client.set_baud_rate(Baud::B115200.rate())?;
            master.set_timeout(Duration::ZERO)?;
            let name = client.name().ok_or_else(|| io::Error::other("the pseudo-terminal has no name"))?;
            Ok(PtyEnd { master, name })
        }

        /// Takes what the client sent, and says whether one has it open.
        fn hear(&mut self, into: &mut Vec<u8>) -> bool {
            let mut buffer = [0; 1024];
            match self.master.read(&mut buffer) {
                Ok(len) => into.extend_from_slice(&buffer[..len]),
                // Somebody is there, and silent.
                Err(error) => return error.kind() == io::ErrorKind::TimedOut,
            }
            true
        }
    }

    impl Client for Pty {
        fn poll(&mut self, into: &mut Vec<u8>) -> io::Result<bool> {
            if let Some(mut served) = self.served.take() {
                if !served.hear(into) {
                    // The next one is served from the next look on, so that the board sees it come.
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
            // A client that does not read loses what does not fit, as at a real port.
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
            // If somebody else took it away, it is gone all the same; what they put there is theirs.
            if std::fs::read_link(&self.link).is_ok_and(|to| to == Path::new(&self.free.name)) {
                let _ = std::fs::remove_file(&self.link);
            }
        }
    }
}
