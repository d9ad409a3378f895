//! What `pulsetrain live` takes of a computer, with a board at a port and the page open; and what the latencies' processes need.

use super::{Row, pins};
use std::io::{BufRead, BufReader, ErrorKind, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream, UdpSocket};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};
use tungstenite::{Message, WebSocket};

/// How long the load is measured, s.
const SECONDS: f64 = 60.0;
/// The most that is promised: of one core, and of memory, MB.
const MOST_CORE: f64 = 0.1;
const MOST_MB: f64 = 60.0;

/// A folder and ports that no other program uses.
pub(crate) struct Free;

impl Free {
    pub(crate) fn folder() -> PathBuf {
        let folder = std::env::temp_dir().join(format!("pulsetrain-bench-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder for temporary files");
        folder
    }

    pub(crate) fn udp_port() -> u16 {
        let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
        socket.local_addr().expect("it has one").port()
    }

    pub(crate) fn tcp_port() -> u16 {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
        listener.local_addr().expect("it has one").port()
    }
}

/// A running `pulsetrain live`.
pub(crate) struct Live {
    process: Child,
    input: ChildStdin,
}

impl Live {
    pub(crate) fn start(folder: &Path, text: &str, options: &[String]) -> Live {
        let file = folder.join("live.toml");
        std::fs::write(&file, text).expect("a file");
        let mut command = Command::new(env!("CARGO_BIN_EXE_pulsetrain"));
        command.arg("live").arg(&file).args(["--quiet", "--no-watch"]).args(options);
        let mut process = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().expect("it starts");
        let input = process.stdin.take().expect("its input");
        let mut output = BufReader::new(process.stdout.take().expect("its output"));
        // It has begun when it says that it runs.
        let mut line = String::new();
        while !line.contains(" runs;") {
            line.clear();
            assert!(output.read_line(&mut line).expect("it prints lines") > 0, "it ended at once");
        }
        thread::spawn(move || output.lines().for_each(drop));
        Live { process, input }
    }

    pub(crate) fn input(&mut self) -> &mut ChildStdin {
        &mut self.input
    }

    pub(crate) fn stop(mut self) {
        writeln!(self.input, "stop").expect("it takes lines");
        let status = self.process.wait().expect("it ends");
        assert!(status.success(), "{status}");
    }
}

/// The page's connection.
pub(crate) struct Socket(WebSocket<TcpStream>);

impl Socket {
    pub(crate) fn open(port: u16) -> Socket {
        let stream = TcpStream::connect((Ipv4Addr::LOCALHOST, port)).expect("the page is there");
        let at = format!("127.0.0.1:{port}");
        let request = tungstenite::http::Request::builder()
            .uri(format!("ws://{at}/socket"))
            .header("Host", &at)
            .header("Origin", format!("http://{at}"))
            .header("Connection", "Upgrade")
            .header("Upgrade", "websocket")
            .header("Sec-WebSocket-Version", "13")
            .header("Sec-WebSocket-Key", tungstenite::handshake::client::generate_key())
            .body(())
            .expect("a request");
        let (socket, _) = tungstenite::client(request, stream).expect("it is a WebSocket");
        socket.get_ref().set_nonblocking(true).expect("a socket");
        Socket(socket)
    }

    pub(crate) fn say(&mut self, line: &str) {
        self.take();
        self.0.send(Message::text(line)).expect("it takes messages");
    }

    /// Reads all that has come; gives its number of messages.
    pub(crate) fn take(&mut self) -> u64 {
        let mut messages = 0;
        loop {
            match self.0.read() {
                Ok(_) => messages += 1,
                Err(tungstenite::Error::Io(error)) if error.kind() == ErrorKind::WouldBlock => return messages,
                Err(error) => panic!("the page's connection is lost: {error}"),
            }
        }
    }
}

/// Four motors at 10 000 steps/s each on a virtual Uno at a port of another process.
#[cfg(target_os = "linux")]
pub(crate) fn rows(share: f64) -> Vec<Row> {
    let folder = Free::folder();
    let (port, page) = (folder.join("board"), Free::tcp_port());
    let mut board = Command::new(env!("CARGO_BIN_EXE_pulsetrain"))
        .args(["board", "uno", "--pty"])
        .arg(&port)
        .stdout(Stdio::null())
        .spawn()
        .expect("it starts");
    while !port.exists() {
        thread::sleep(Duration::from_millis(10));
    }
    let mut text = "board = \"uno\"\n".to_owned();
    for (motor, (step, dir)) in pins("uno").into_iter().enumerate() {
        // A sweep goes both ways in each period.
        let hz = 1.0 + 0.1 * motor as f64;
        text += &format!(
            "[motor.m{motor}]\nsteps_per_rev = 200\nmicrosteps = 16\ndriver = \"A4988\"\npins = {{ step = {step}, dir = {dir} }}\n\
             forward = \"high\"\nmax_speed = \"10 rev/s\"\nmax_acceleration = \"200 rev/s^2\"\n\
             [[motion]]\nmotor = \"m{motor}\"\nlaw.sweep = {{ frequency = \"{hz} Hz\", swing = \"{:.0} step\" }}\n",
            5000.0 / hz
        );
    }
    let options =
        ["--port", &port.display().to_string(), "--no-rehearsal", "--page", &page.to_string()].map(str::to_owned);
    let live = Live::start(&folder, &text, &options);
    let mut socket = Socket::open(page);
    thread::sleep(Duration::from_secs(3));
    let (begin, before_s) = (Instant::now(), processor_s(live.process.id()));
    let mut messages = 0;
    while begin.elapsed().as_secs_f64() < share * SECONDS {
        messages += socket.take();
        thread::sleep(Duration::from_millis(20));
    }
    let seconds = begin.elapsed().as_secs_f64();
    let core = (processor_s(live.process.id()) - before_s) / seconds;
    let most_mb = most_mb(live.process.id());
    live.stop();
    let _ = board.kill();
    let _ = board.wait();
    let _ = std::fs::remove_dir_all(&folder);
    let what = "four motors of 10 000 steps/s at a port, the page open".to_owned();
    let more = format!("{seconds:.0} s, {messages} messages to the page");
    vec![
        Row {
            figure: 3,
            what: what.clone(),
            board: "uno",
            measured: format!("{:.1} % of a core", 100.0 * core),
            bound: format!("{:.0} %", 100.0 * MOST_CORE),
            more: more.clone(),
            holds: core <= MOST_CORE && messages > 0,
        },
        Row {
            figure: 3,
            what,
            board: "uno",
            measured: format!("{most_mb:.1} MB at most"),
            bound: format!("{MOST_MB:.0} MB"),
            more,
            holds: most_mb <= MOST_MB,
        },
    ]
}

/// Only Linux says what a process takes in files.
#[cfg(not(target_os = "linux"))]
pub(crate) fn rows(_: f64) -> Vec<Row> {
    Vec::new()
}

/// The processor time that a process has taken, s.
#[cfg(target_os = "linux")]
fn processor_s(process: u32) -> f64 {
    /// Of `/proc`'s times, on all of Linux's processors.
    const TICKS_PER_S: f64 = 100.0;
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).expect("it runs");
    // proc_pid_stat(5): utime and stime are fields 14 and 15; the name in brackets may have spaces.
    let after = stat.rsplit_once(')').map_or("", |(_, after)| after);
    let ticks = after.split_whitespace().skip(11).take(2).filter_map(|field| field.parse::<f64>().ok());
    ticks.sum::<f64>() / TICKS_PER_S
}

/// The most memory that a process has had, MB.
#[cfg(target_os = "linux")]
fn most_mb(process: u32) -> f64 {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).expect("it runs");
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap_or_default();
    line.split_whitespace().next().and_then(|kb| kb.parse::<f64>().ok()).unwrap_or(f64::NAN) * 1024.0 / 1e6
}
