//! The connections of browsers: their limits, the page's files, and the WebSocket.

use std::cell::Cell;
use std::collections::VecDeque;
use std::io::{self, Read, Write};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, Shutdown, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use pulsetrain_motion::file::open_named;
use tungstenite::handshake::derive_accept_key;
use tungstenite::protocol::frame::coding::{CloseCode, Data, OpCode};
use tungstenite::protocol::frame::{CloseFrame, Frame};
use tungstenite::protocol::{Role, WebSocketConfig};
use tungstenite::{Message, WebSocket};

use super::history::History;
use super::http::{self, Admitted, LONGEST_HEAD, RefusedRequest, Wanted};
use super::{PageError, PageOptions};
use crate::control_socket::{Hub, HubLines, HubSender, LONG_LINE_TIME, Next};
use crate::live::{ClientKind, run_line::MAX_MOTION_LINE_BYTES};

/// Connections at a time that were let in. Pages are fewer: the hub has 16 places for them.
const MOST_CONNECTIONS: usize = 48;
/// Connections at a time that have not said yet what they want. A further one takes the place of the oldest of the computer that has most of them: whoever
/// says nothing keeps nobody out.
const MAX_STRANGERS: usize = 48;
/// How long the head of a request may take.
const HEAD_PATIENCE: Duration = Duration::from_secs(5);
/// How long a browser may take for what it gets.
const WRITE_PATIENCE: Duration = Duration::from_secs(2);
/// How long a browser may take to hang up after its answer, and how much of what it still sends is read meanwhile.
const LINGER: (Duration, usize) = (Duration::from_millis(200), 64 * 1024);
/// A page that hears nothing for so long is asked whether it is there.
const PING_AFTER: Duration = Duration::from_secs(15);
/// The longest message of a page, bytes. The page that has control may send a motion file of [`MAX_MOTION_LINE_BYTES`]; one client at a time does.
const LONGEST_MESSAGE: usize = 256 * 1024;
/// Why a page without control is disconnected that sends a longer one.
const TOO_LONG: &str = "a message has 256 KiB at most; only the page that has control may send a longer motion file";
/// Why a page is disconnected whose long message takes too long.
const TOO_SLOW: &str = "the motion file took more than 30 s";
const _: () = assert!(LONG_LINE_TIME.as_secs() == 30);
/// The head of a client's short frame, bytes.
const SHORT_HEAD: usize = 6;
/// Messages that a page may send at once, and each second after those.
const MESSAGES: (f64, f64) = (100.0, 50.0);

/// What a browser may do with the page: load its own files, talk to this server, and no more.
const HEADERS: &str = "Content-Security-Policy: default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; \
    connect-src 'self'; manifest-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'\r\n\
    X-Content-Type-Options: nosniff\r\nX-Frame-Options: DENY\r\nReferrer-Policy: no-referrer\r\n\
    Cross-Origin-Opener-Policy: same-origin\r\nCross-Origin-Resource-Policy: same-origin\r\n\
    Cache-Control: no-store\r\nConnection: close\r\n";

/// The page's files: path, type, contents.
const FILES: [(&str, &str, &str); 7] = [
    ("/", "text/html; charset=utf-8", include_str!("files/index.html")),
    ("/page.css", "text/css; charset=utf-8", include_str!("files/page.css")),
    ("/page.js", "text/javascript; charset=utf-8", include_str!("files/page.js")),
    ("/plots.js", "text/javascript; charset=utf-8", include_str!("files/plots.js")),
    ("/uplot.css", "text/css; charset=utf-8", include_str!("files/uPlot.min.css")),
    ("/uplot.js", "text/javascript; charset=utf-8", include_str!("files/uPlot.iife.min.js")),
    ("/icon.svg", "image/svg+xml", include_str!("files/icon.svg")),
];

/// A page that is served. It goes away with this value, and its browsers with the run.
#[derive(Debug)]
pub struct Page {
    address: SocketAddr,
    shared: Arc<PageState>,
}

#[derive(Debug)]
struct PageState {
    hub: Hub,
    history: Arc<Mutex<History>>,
    options: PageOptions,
    strangers: Mutex<Strangers>,
    /// Connections that were let in.
    connections: AtomicUsize,
    is_over: AtomicBool,
}

/// Connections that have not said yet what they want.
#[derive(Debug, Default)]
struct Strangers {
    /// The oldest first.
    waiting: VecDeque<Stranger>,
    next: u64,
}

#[derive(Debug)]
struct Stranger {
    number: u64,
    from: IpAddr,
    stream: TcpStream,
}

impl Strangers {
    /// Adds a connection. If there are too many, another one is hung up.
    fn push(&mut self, stream: TcpStream, from: IpAddr) -> u64 {
        let count = |from: IpAddr, all: &VecDeque<Stranger>| all.iter().filter(|other| other.from == from).count();
        if self.waiting.len() >= MAX_STRANGERS {
            let most = self.waiting.iter().map(|stranger| count(stranger.from, &self.waiting)).max().unwrap_or(0);
            let oldest = self.waiting.iter().position(|stranger| count(stranger.from, &self.waiting) == most);
            if let Some(stranger) = oldest.and_then(|place| self.waiting.remove(place)) {
                // Its thread wakes up, and ends.
                drop(stranger.stream.shutdown(Shutdown::Both));
            }
        }
        self.next += 1;
        self.waiting.push_back(Stranger { number: self.next, from, stream });
        self.next
    }
}

impl Page {
    pub(super) fn start(
        hub: &Hub,
        listener: TcpListener,
        address: SocketAddr,
        options: PageOptions,
    ) -> Result<Page, PageError> {
        let thread = |error: io::Error| PageError::Thread { error };
        let history = History::keep(hub).map_err(thread)?;
        let (connections, is_over) = (AtomicUsize::new(0), AtomicBool::new(false));
        let strangers = Mutex::default();
        let shared = Arc::new(PageState { hub: hub.clone(), history, options, strangers, connections, is_over });
        let accepting = Arc::clone(&shared);
        thread::Builder::new().name("page".into()).spawn(move || accept(&listener, &accepting)).map_err(thread)?;
        Ok(Page { address, shared })
    }

    /// The address where it listens.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// What to type into a browser, with the token if there is one. For a page at all addresses of this computer it is the one
    /// that leads to its network.
    #[must_use]
    pub fn url(&self) -> String {
        let ip = if self.address.ip().is_unspecified() { own_address(self.address) } else { self.address.ip() };
        let host = http::written(SocketAddr::new(ip, self.address.port()));
        let token = self.shared.options.token.as_ref().map(|token| format!("?token={}", token.text()));
        format!("http://{host}/{}", token.unwrap_or_default())
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        self.shared.is_over.store(true, Ordering::SeqCst);
        // The listening thread wakes up by a connection, and ends.
        let ip = match self.address.ip() {
            IpAddr::V4(ip) if ip.is_unspecified() => Ipv4Addr::LOCALHOST.into(),
            IpAddr::V6(ip) if ip.is_unspecified() => Ipv6Addr::LOCALHOST.into(),
            ip => ip,
        };
        drop(TcpStream::connect_timeout(&SocketAddr::new(ip, self.address.port()), WRITE_PATIENCE));
    }
}

/// This computer's address on its network. Nothing is sent to find it.
fn own_address(listening: SocketAddr) -> IpAddr {
    // An address for documents, which nobody has: it only chooses the way out.
    let found = UdpSocket::bind((listening.ip(), 0)).and_then(|socket| {
        socket.connect("192.0.2.1:9")?;
        socket.local_addr()
    });
    found.map_or(Ipv4Addr::LOCALHOST.into(), |address| address.ip())
}

fn accept(listener: &TcpListener, shared: &Arc<PageState>) {
    loop {
        let stream = listener.accept();
        if shared.is_over.load(Ordering::SeqCst) {
            return;
        }
        match stream {
            Ok((stream, _)) => begin(stream, shared),
            // The process has no more files for now, say.
            Err(_) => drop(shared.hub.is_over_within(WRITE_PATIENCE)),
        }
    }
}

/// Answers a connection in a thread of its own.
fn begin(stream: TcpStream, shared: &Arc<PageState>) {
    // A connection whose limits cannot be set is not served.
    let limits = stream.set_write_timeout(Some(WRITE_PATIENCE)).and_then(|()| stream.set_nodelay(true));
    let known = limits.and_then(|()| Ok((stream.try_clone()?, stream.peer_addr()?.ip())));
    let Ok((own, from)) = known else { return };
    let number = shared.strangers().push(own, from);
    let slot = Slot { shared: Arc::clone(shared), number, is_let_in: Cell::new(false) };
    let answers = thread::Builder::new().name("page connection".into());
    // Without a thread the connection is closed.
    drop(answers.spawn(move || drop(answer(stream, &slot))));
}

impl PageState {
    fn strangers(&self) -> MutexGuard<'_, Strangers> {
        self.strangers.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A connection's slot among those at a time.
struct Slot {
    shared: Arc<PageState>,
    /// Its number among the strangers.
    number: u64,
    is_let_in: Cell<bool>,
}

impl Slot {
    /// Counts the connection among those that were let in: its request may have an answer. `false` if there are too many.
    fn let_in(&self) -> bool {
        let has_room = self.shared.connections.fetch_add(1, Ordering::SeqCst) < MOST_CONNECTIONS;
        if has_room {
            self.is_let_in.set(true);
            self.leave_strangers();
        } else {
            self.shared.connections.fetch_sub(1, Ordering::SeqCst);
        }
        has_room
    }

    fn leave_strangers(&self) {
        self.shared.strangers().waiting.retain(|stranger| stranger.number != self.number);
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        self.leave_strangers();
        if self.is_let_in.get() {
            self.shared.connections.fetch_sub(1, Ordering::SeqCst);
        }
    }
}

/// Reads a request, and answers it. Each connection has one.
fn answer(mut stream: TcpStream, slot: &Slot) -> io::Result<()> {
    let shared = &slot.shared;
    // The address that the browser has reached, also where this listens at several.
    let address = stream.local_addr()?;
    let deadline = Instant::now() + HEAD_PATIENCE;
    let mut bytes = Vec::new();
    let head_len = loop {
        if let Some(len) = http::head_len(&bytes) {
            break len;
        }
        let refused = |status: u16, why: &str| RefusedRequest { status, why: why.to_owned() };
        if bytes.len() >= LONGEST_HEAD {
            let why = format!("a request has {LONGEST_HEAD} bytes at most");
            return refuse(stream, &refused(431, &why));
        }
        let left = deadline.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return refuse(stream, &refused(408, "the request took too long"));
        }
        stream.set_read_timeout(Some(left))?;
        let mut part = [0; 1024];
        let room = part.len().min(LONGEST_HEAD - bytes.len());
        match stream.read(&mut part[..room]) {
            Ok(0) => return Ok(()),
            Ok(len) => bytes.extend_from_slice(&part[..len]),
            Err(error) if is_timeout(&error) => {}
            Err(error) => return Err(error),
        }
    };
    match http::admit(&bytes[..head_len], address, shared.options.token.as_ref()) {
        Err(refused) => refuse(stream, &refused),
        Ok(_) if !slot.let_in() => {
            let why = format!("{MOST_CONNECTIONS} connections are open: close a page");
            refuse(stream, &RefusedRequest { status: 503, why })
        }
        Ok(Admitted { wanted: Wanted::Socket { key }, .. }) => talk(stream, &key, bytes.split_off(head_len), shared),
        Ok(Admitted { wanted: Wanted::File(path), sets_cookie, head_only }) => {
            let token = shared.options.token.as_ref().filter(|_| sets_cookie);
            // The cookie is for this page alone, and not for its scripts.
            let cookie = token.map(|token| {
                let name = http::cookie_name(address);
                format!("Set-Cookie: {name}={}; Path=/; HttpOnly; SameSite=Strict\r\n", token.text())
            });
            file(stream, &path, &cookie.unwrap_or_default(), head_only, shared)
        }
    }
}

fn is_timeout(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut | io::ErrorKind::Interrupted)
}

/// Sends a file of the page, the motion file or the log.
fn file(mut stream: TcpStream, path: &str, cookie: &str, head_only: bool, shared: &PageState) -> io::Result<()> {
    let mut send = |kind: &str, more: &str, body: &mut dyn Read, len: u64| -> io::Result<()> {
        let head =
            format!("HTTP/1.1 200 OK\r\nContent-Type: {kind}\r\nContent-Length: {len}\r\n{more}{cookie}{HEADERS}\r\n");
        stream.write_all(head.as_bytes())?;
        if !head_only {
            io::copy(&mut body.take(len), &mut stream)?;
        }
        Ok(())
    };
    let saved = |name: &str| format!("Content-Disposition: attachment; filename=\"{name}\"\r\n");
    if let Some((_, kind, text)) = FILES.iter().find(|(name, ..)| *name == path) {
        send(kind, "", &mut text.as_bytes(), text.len() as u64)?;
    } else if path == "/motion.toml" {
        let text = shared.options.motion.lock().unwrap_or_else(PoisonError::into_inner).clone();
        send("text/plain; charset=utf-8", &saved("motion.toml"), &mut text.as_bytes(), text.len() as u64)?;
    } else if path == "/log.jsonl"
        && let Some((mut log, _)) = shared.options.log.as_ref().and_then(|path| open_named(path, u64::MAX - 1).ok())
    {
        // It may become longer meanwhile.
        let len = log.metadata()?.len();
        send("application/jsonl; charset=utf-8", &saved("log.jsonl"), &mut log, len)?;
    } else {
        return refuse(stream, &RefusedRequest { status: 404, why: "there is no such file".to_owned() });
    }
    linger(stream)
}

fn refuse(mut stream: TcpStream, RefusedRequest { status, why }: &RefusedRequest) -> io::Result<()> {
    let name = match status {
        400 => "Bad Request",
        401 => "Unauthorized",
        403 => "Forbidden",
        404 => "Not Found",
        405 => "Method Not Allowed",
        408 => "Request Timeout",
        421 => "Misdirected Request",
        426 => "Upgrade Required",
        431 => "Request Header Fields Too Large",
        _ => "Service Unavailable",
    };
    let more = match status {
        405 => "Allow: GET, HEAD\r\n",
        426 => "Upgrade: websocket\r\n",
        _ => "",
    };
    let len = why.len() + 1;
    let text = format!(
        "HTTP/1.1 {status} {name}\r\nContent-Type: text/plain; charset=utf-8\r\nContent-Length: {len}\r\n{more}{HEADERS}\r\n{why}\n"
    );
    stream.write_all(text.as_bytes())?;
    linger(stream)
}

/// Lets the browser take its answer before the connection goes: one that is closed with unread bytes loses what it sent.
fn linger(mut stream: TcpStream) -> io::Result<()> {
    let (patience, most) = LINGER;
    stream.shutdown(Shutdown::Write)?;
    stream.set_read_timeout(Some(patience))?;
    let mut left = [0; 1024];
    let mut read = 0;
    while read < most {
        match stream.read(&mut left) {
            Ok(len) if len > 0 => read += len,
            _ => break,
        }
    }
    Ok(())
}

/// Makes the connection a WebSocket, and passes lines between it and the hub.
fn talk(mut stream: TcpStream, key: &str, early: Vec<u8>, shared: &PageState) -> io::Result<()> {
    let client = match shared.hub.join(ClientKind::Page) {
        Ok(client) => client,
        Err(error) => return refuse(stream, &RefusedRequest { status: 503, why: error.to_string() }),
    };
    let accept = derive_accept_key(key.as_bytes());
    let switch = format!(
        "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Accept: {accept}\r\n\r\n"
    );
    stream.write_all(switch.as_bytes())?;
    stream.set_read_timeout(None)?;
    let (sender, lines) = client.split();
    // Followed before the history is read, so that nothing is between them.
    sender.follow(true);
    let output = Output(Arc::new(Mutex::new(stream.try_clone()?)));
    let (writing, history, has_log) = (output.clone(), Arc::clone(&shared.history), shared.options.log.is_some());
    thread::Builder::new().name("page client".into()).spawn(move || {
        // A browser that takes nothing in time is gone.
        drop(write(&writing, &lines, &history, has_log));
        writing.hang_up();
    })?;
    let input = MessageInput { stream, sender: &sender, len: 0, long: None, refused: None };
    let both = Both { input, output: output.clone() };
    let config = WebSocketConfig::default().read_buffer_size(16 * 1024);
    let mut socket = WebSocket::from_partially_read(both, early, Role::Server, Some(config));
    let end = hear(&mut socket, &sender);
    drop(output.send(Frame::close(end)));
    output.hang_up();
    // A browser in the middle of a long message notices it when both ends of the connection are closed here.
    sender.end_lines();
    Ok(())
}

/// Writes the run's first line, the history, and then the lines as they come.
fn write(output: &Output, lines: &HubLines, history: &Mutex<History>, has_log: bool) -> io::Result<()> {
    if let Some(first) = lines.next_line() {
        output.line(&first)?;
    }
    let past = history.lock().unwrap_or_else(PoisonError::into_inner).lines(has_log);
    past.iter().try_for_each(|line| output.line(line))?;
    loop {
        match lines.next_within(PING_AFTER) {
            Next::Line(line) => output.line(&line)?,
            Next::Nothing => output.send(Frame::ping(Vec::new()))?,
            Next::End => {
                let reason = "the run has ended".into();
                return output.send(Frame::close(Some(CloseFrame { code: CloseCode::Normal, reason })));
            }
        }
    }
}

/// Reads a page's lines until it has no more, or sends too much: then it says why.
fn hear(socket: &mut WebSocket<Both<'_>>, sender: &HubSender) -> Option<CloseFrame> {
    let close = |code: CloseCode, reason: &'static str| Some(CloseFrame { code, reason: reason.into() });
    let mut rate = Rate::new(Instant::now());
    loop {
        // The buffer for a frame is allocated as soon as its length is read, so the limit is set before.
        let longest = Some(if sender.has_control() { MAX_MOTION_LINE_BYTES } else { LONGEST_MESSAGE });
        socket.set_config(|config| (config.max_message_size, config.max_frame_size) = (longest, longest));
        let message = socket.read();
        // The turn for a long message is kept until the message is read.
        let _turn = socket.get_mut().input.took(message.as_ref().ok());
        if !rate.takes(Instant::now()) {
            return close(CloseCode::Policy, "too many messages");
        }
        match message {
            Ok(Message::Text(text)) if text.len() > LONGEST_MESSAGE => sender.motion_line(text.as_bytes()),
            // JSON may have line ends in it. Else lines of one message act together.
            Ok(Message::Text(text)) => match serde_json::from_str::<serde::de::IgnoredAny>(&text) {
                Ok(_) => sender.line(text.as_bytes()),
                Err(_) => sender.lines(text.trim_end().split('\n').map(str::as_bytes)),
            },
            Ok(Message::Ping(_) | Message::Pong(_)) => {}
            Ok(Message::Binary(_)) => return close(CloseCode::Unsupported, "lines of JSON are text"),
            Err(tungstenite::Error::Capacity(_)) if sender.has_control() => {
                return close(CloseCode::Size, "a motion file has 16 MB at most");
            }
            Err(tungstenite::Error::Capacity(_)) => return close(CloseCode::Size, TOO_LONG),
            Ok(Message::Close(_) | Message::Frame(_)) | Err(_) => {
                let code = |why| if why == TOO_SLOW { CloseCode::Policy } else { CloseCode::Size };
                return socket.get_ref().input.refused.and_then(|why| close(code(why), why));
            }
        }
    }
}

/// The messages that a page may send now.
struct Rate {
    left: f64,
    at: Instant,
}

impl Rate {
    fn new(now: Instant) -> Rate {
        Rate { left: MESSAGES.0, at: now }
    }

    fn takes(&mut self, now: Instant) -> bool {
        let passed = now.saturating_duration_since(std::mem::replace(&mut self.at, now));
        self.left = (self.left + passed.as_secs_f64() * MESSAGES.1).min(MESSAGES.0) - 1.0;
        self.left >= 0.0
    }
}

/// What two threads write to: each write is a number of whole frames.
#[derive(Clone)]
struct Output(Arc<Mutex<TcpStream>>);

impl Output {
    fn bytes(&self, bytes: &[u8]) -> io::Result<()> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).write_all(bytes)
    }

    fn send(&self, frame: Frame) -> io::Result<()> {
        let mut bytes = Vec::new();
        frame.format(&mut bytes).map_err(io::Error::other)?;
        self.bytes(&bytes)
    }

    fn line(&self, line: &str) -> io::Result<()> {
        self.send(Frame::message(line.trim_end().as_bytes().to_vec(), OpCode::Data(Data::Text), true))
    }

    fn hang_up(&self) {
        drop(self.0.lock().unwrap_or_else(PoisonError::into_inner).shutdown(Shutdown::Both));
    }
}

/// What a page sends. A long message is taken from the page that has control, while no other client sends a long one, and for a limited time.
struct MessageInput<'s> {
    stream: TcpStream,
    sender: &'s HubSender,
    /// Bytes since the last message.
    len: usize,
    /// The turn for a long message, and when it is over.
    long: Option<(MutexGuard<'s, ()>, Instant)>,
    refused: Option<&'static str>,
}

impl<'s> MessageInput<'s> {
    /// Notes that a message was read. Returns the turn that it had, if it was long.
    fn took(&mut self, message: Option<&Message>) -> Option<MutexGuard<'s, ()>> {
        // They may come within another message.
        if let Some(Message::Ping(data) | Message::Pong(data)) = message {
            self.len = self.len.saturating_sub(data.len() + SHORT_HEAD);
            return None;
        }
        self.len = 0;
        self.long.take().map(|(turn, _)| turn)
    }

    /// How long the next bytes may take; `None`: any time. Or why no more are taken.
    fn patience(&mut self) -> Result<Option<Duration>, &'static str> {
        if self.len <= LONGEST_MESSAGE {
            return Ok(None);
        }
        if !self.sender.has_control() {
            return Err(TOO_LONG);
        }
        let begin = || (self.sender.hub().long_line(), Instant::now() + LONG_LINE_TIME);
        let turn = self.long.get_or_insert_with(begin);
        let left = turn.1.saturating_duration_since(Instant::now());
        if left.is_zero() { Err(TOO_SLOW) } else { Ok(Some(left)) }
    }
}

impl Read for MessageInput<'_> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let patience = self.patience().map_err(|why| {
            self.refused = Some(why);
            io::Error::other(why)
        })?;
        self.stream.set_read_timeout(patience)?;
        let read = self.stream.read(into);
        if read.as_ref().is_err_and(is_timeout) {
            self.refused = Some(TOO_SLOW);
        }
        self.len += *read.as_ref().unwrap_or(&0);
        read
    }
}

/// The stream that the WebSocket reads; it answers pings by the same output.
struct Both<'s> {
    input: MessageInput<'s>,
    output: Output,
}

impl Read for Both<'_> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        self.input.read(into)
    }
}

impl Write for Both<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.output.bytes(bytes).map(|()| bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_may_send_so_much_and_no_more() {
        let begin = Instant::now();
        let mut rate = Rate::new(begin);
        assert!((0..100).all(|_| rate.takes(begin)) && !rate.takes(begin));
        let mut rate = Rate::new(begin);
        let each = |n: u32| begin + Duration::from_millis(20) * n;
        assert!((0..10_000).all(|n| rate.takes(each(n))), "50 a second for ever");
    }
}
