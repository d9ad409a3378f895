//! The page: who gets in, and what a browser gets, by raw sockets. A test stands for the run. Nothing here depends on how long something takes.

use pulsetrain::control_socket::{Hub, run_info};
use pulsetrain::live::{Batch, KnobInfo, KnobValue, RunCommand, RunEnded, RunEvent, RunInfo};
use pulsetrain::motion::file;
use pulsetrain::page::{self, Page, PageError, PageOptions, Token};
use pulsetrain::session::control::{MotorStatus, Status};
use serde_json::Value;
use std::io::{self, Read, Write};
use std::net::{Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::mpsc::{Receiver, channel};

const MOTION: &str = "board = \"native\"\n[motor.wheel]\nsteps_per_rev = 200\npulse_high = \"2 us\"\npins = { step = 8, dir = 9 }\n\
    forward = \"high\"\nmax_acceleration = \"1 rev/s^2\"\n[[motion]]\nmotor = \"wheel\"\n\
    law.speed = { speed = \"0.1 rev/s\", duration = \"10 s\" }\n";

/// A live motion of the test's own, with its page.
struct Run {
    hub: Hub,
    batches: Receiver<Batch>,
    page: Page,
}

impl Run {
    fn new(token: Option<Token>) -> Run {
        let no_other_file = |_: &std::path::Path| Err(io::ErrorKind::NotFound.into());
        let program = file::read(MOTION, "wheel.toml", &no_other_file).unwrap();
        let knob = KnobInfo {
            name: "wheel.speed".into(),
            target: "wheel.speed".into(),
            unit: "rev/s".into(),
            least: Some(0.0),
            greatest: Some(1.0),
            value: 0.1,
        };
        let info = RunInfo { is_live: true, knobs: vec![knob], ..run_info("wheel.toml", &program, None, true) };
        let (sender, batches) = channel();
        let hub = Hub::of_live(info, sender);
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let options = PageOptions { token, ..PageOptions::default() };
        MOTION.clone_into(&mut options.motion.lock().unwrap());
        let page = page::serve(&hub, listener, options).unwrap();
        hub.looked();
        Run { hub, batches, page }
    }

    fn host(&self) -> String {
        self.page.address().to_string()
    }

    fn connect(&self) -> TcpStream {
        TcpStream::connect(self.page.address()).unwrap()
    }

    /// The answer to a request with these lines after its first, which asks for `path`.
    fn get(&self, path: &str, lines: &[&str]) -> String {
        self.ask(&format!("GET {path} HTTP/1.1"), lines)
    }

    fn ask(&self, first: &str, lines: &[&str]) -> String {
        let mut stream = self.connect();
        let head = [&[first], lines].concat().join("\r\n");
        stream.write_all(format!("{head}\r\n\r\n").as_bytes()).unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        String::from_utf8_lossy(&answer).into_owned()
    }

    fn own(&self) -> String {
        format!("Host: {}", self.host())
    }

    /// The lines that make a WebSocket.
    fn upgrade(&self, origin: &str) -> Vec<String> {
        let fixed = ["Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13"];
        let key = "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==";
        let mut lines: Vec<String> = fixed.iter().map(|line| (*line).to_owned()).collect();
        lines.extend([self.own(), key.to_owned(), format!("Origin: {origin}")]);
        lines
    }

    /// A WebSocket, or the answer if there is none.
    fn open(&self, lines: &[String]) -> Result<Socket, String> {
        let mut stream = self.connect();
        let head = format!("GET /socket HTTP/1.1\r\n{}\r\n\r\n", lines.join("\r\n"));
        stream.write_all(head.as_bytes()).unwrap();
        let mut answer = Vec::new();
        while !answer.ends_with(b"\r\n\r\n") {
            let mut byte = [0];
            if stream.read(&mut byte).unwrap() == 0 {
                break;
            }
            answer.push(byte[0]);
        }
        let answer = String::from_utf8(answer).unwrap();
        if answer.starts_with("HTTP/1.1 101 ") { Ok(Socket { stream }) } else { Err(answer) }
    }

    fn socket(&self) -> Socket {
        self.open(&self.upgrade(&format!("http://{}", self.host()))).unwrap()
    }
}

/// A browser's end of a WebSocket, by hand.
struct Socket {
    stream: TcpStream,
}

impl Socket {
    fn frame(&mut self, first: u8, payload: &[u8]) -> io::Result<()> {
        let mut frame = vec![first];
        match payload.len() {
            len @ 0..126 => frame.push(0x80 | len as u8),
            len @ 126..65536 => {
                frame.push(0x80 | 126);
                frame.extend((len as u16).to_be_bytes());
            }
            len => {
                frame.push(0x80 | 127);
                frame.extend((len as u64).to_be_bytes());
            }
        }
        let mask = [7, 11, 13, 17];
        frame.extend(mask);
        frame.extend(payload.iter().zip(mask.iter().cycle()).map(|(byte, mask)| byte ^ mask));
        self.stream.write_all(&frame)
    }

    fn send(&mut self, line: &str) {
        self.frame(0x81, line.as_bytes()).unwrap();
    }

    /// The next frame: its first byte and what is in it. `None` at the end.
    fn next(&mut self) -> Option<(u8, Vec<u8>)> {
        let mut head = [0; 2];
        self.stream.read_exact(&mut head).ok()?;
        let len = match head[1] {
            126 => {
                let mut len = [0; 2];
                self.stream.read_exact(&mut len).ok()?;
                usize::from(u16::from_be_bytes(len))
            }
            127 => {
                let mut len = [0; 8];
                self.stream.read_exact(&mut len).ok()?;
                u64::from_be_bytes(len) as usize
            }
            len => usize::from(len),
        };
        let mut payload = vec![0; len];
        self.stream.read_exact(&mut payload).ok()?;
        Some((head[0], payload))
    }

    /// The next line that is meant.
    fn until(&mut self, is_meant: impl Fn(&Value) -> bool) -> Value {
        loop {
            let (first, payload) = self.next().expect("a line");
            // A ping after 15 s without a line: a loaded computer takes that long for what comes before.
            if first == 0x89 {
                continue;
            }
            assert_eq!(first, 0x81, "a text");
            let line: Value = serde_json::from_slice(&payload).unwrap();
            if is_meant(&line) {
                return line;
            }
        }
    }

    /// The code and the reason with which the server closes.
    fn closed(&mut self) -> (u16, String) {
        loop {
            let (first, payload) = self.next().expect("a close");
            if first == 0x88 {
                let code = u16::from_be_bytes([payload[0], payload[1]]);
                return (code, String::from_utf8(payload[2..].to_vec()).unwrap());
            }
        }
    }
}

#[track_caller]
fn refused(answer: &str, status: u16, part: &str) {
    assert!(answer.starts_with(&format!("HTTP/1.1 {status} ")) && answer.contains(part), "{answer}");
    assert!(!answer.contains("<html") && answer.contains("Content-Security-Policy: default-src 'none'"), "{answer}");
}

#[test]
fn a_browser_gets_the_page_and_nothing_changes_by_a_request() {
    let run = Run::new(None);
    let own = run.own();
    let page = run.get("/", &[&own]);
    assert!(page.starts_with("HTTP/1.1 200 OK\r\n") && page.contains("<html lang=\"en\">"), "{page}");
    // All that the page wants is here, and no script or style is in it.
    for part in page.split("src=\"").skip(1).chain(page.split("href=\"").skip(1)) {
        let path = part.split('"').next().unwrap();
        let expected = if path == "log.jsonl" { "404" } else { "200" };
        assert!(run.get(&format!("/{path}"), &[&own]).starts_with(&format!("HTTP/1.1 {expected} ")), "{path}");
    }
    assert!(!page.contains("<style") && !page.contains(" style=") && !page.contains("onclick"));
    assert!(page.contains("script-src 'self';") && page.contains("X-Frame-Options: DENY"));
    assert!(run.get("/motion.toml", &[&own]).ends_with(MOTION));
    let head = run.ask("HEAD /motion.toml HTTP/1.1", &[&own]);
    assert!(head.starts_with("HTTP/1.1 200 ") && head.ends_with("\r\n\r\n"), "{head}");
    refused(&run.get("/../Cargo.toml", &[&own]), 404, "no such file");
    for method in ["POST", "PUT", "DELETE"] {
        let body = "{\"command\":\"stop\"}";
        let answer =
            run.ask(&format!("{method} / HTTP/1.1"), &[&own, &format!("Content-Length: {}", body.len()), "", body]);
        refused(&answer, 405, "commands come by the WebSocket");
    }
    run.get("/?command=stop", &[&own]);
    assert_eq!(run.batches.try_iter().count(), 0);
}

#[test]
fn other_sites_and_names_get_nothing() {
    let run = Run::new(None);
    let own = run.own();
    // A name of another site that was made to lead here.
    for host in [
        "Host: evil.example".to_owned(),
        format!("Host: evil.example:{}", run.page.address().port()),
        "X: y".to_owned(),
    ] {
        refused(&run.get("/", &[&host]), 421, "open it by that address");
    }
    refused(&run.get("/", &[&own, &own]), 400, "several headers Host");
    for path in ["/", "/page.js", "/motion.toml", "/log.jsonl"] {
        refused(&run.get(path, &[&own, "Origin: http://evil.example"]), 403, "another site");
        refused(&run.get(path, &[&own, "Origin: null"]), 403, "another site");
    }
    refused(&run.get("/motion.toml", &[&own, "Sec-Fetch-Site: cross-site"]), 403, "another site");
    // The WebSocket, which browsers let pages of all sites open.
    let mut wrong = run.upgrade("http://evil.example");
    refused(&run.open(&wrong).err().unwrap(), 403, "");
    wrong.pop();
    refused(&run.open(&wrong).err().unwrap(), 403, "");
    let named = format!("Host: localhost:{}", run.page.address().port());
    let mut lines = run.upgrade(&format!("http://localhost:{}", run.page.address().port()));
    refused(&run.open(&lines).err().unwrap(), 403, "");
    lines.iter_mut().filter(|line| line.starts_with("Host")).for_each(|line| line.clone_from(&named));
    run.open(&lines).unwrap();
    refused(&run.get("/socket", &[&own, &format!("Origin: http://{}", run.host())]), 426, "WebSocket");
}

#[test]
fn on_the_network_a_token_is_needed() {
    let token = Token::random().unwrap();
    let run = Run::new(Some(token.clone()));
    let own = run.own();
    assert_eq!(run.page.url(), format!("http://{}/?token={}", run.host(), token.text()));
    for path in ["/", "/page.js", "/socket", "/?token=", "/?token=0123456789abcdef0123456789abcdef"] {
        refused(&run.get(path, &[&own]), 401, "with its token");
    }
    refused(&run.open(&run.upgrade(&format!("http://{}", run.host()))).err().unwrap(), 401, "");
    let page = run.get(&format!("/?token={}", token.text()), &[&own]);
    let cookie = page.lines().find_map(|line| line.strip_prefix("Set-Cookie: ")).unwrap();
    assert!(cookie.ends_with("; Path=/; HttpOnly; SameSite=Strict"), "{cookie}");
    let cookie = format!("Cookie: {}", cookie.split(';').next().unwrap());
    assert!(run.get("/page.js", &[&own, &cookie]).starts_with("HTTP/1.1 200 "));
    let mut lines = run.upgrade(&format!("http://{}", run.host()));
    lines.push(cookie.clone());
    run.open(&lines).unwrap();
    // It is no help to another site.
    refused(&run.get("/page.js", &[&own, &cookie, "Origin: http://evil.example"]), 403, "another site");
    // Nobody listens on the network without a token.
    let everywhere = SocketAddr::from((Ipv4Addr::UNSPECIFIED, 0));
    let (listener, token) = page::listen(everywhere).unwrap();
    assert!(token.is_some());
    let served = page::serve(&run.hub, listener, PageOptions::default());
    assert!(matches!(served, Err(PageError::NoToken { .. })));
    let taken = page::listen(run.page.address()).unwrap_err();
    assert!(taken.to_string().contains("listens at"), "{taken}");
}

#[test]
fn many_connections_and_endless_heads_leave_it_as_it_was() {
    let run = Run::new(None);
    let own = run.own();
    let mut page = run.socket();
    page.until(|line| line.get("past").is_some());
    // A head without an end.
    let mut endless = run.connect();
    endless.write_all(format!("GET / HTTP/1.1\r\n{own}\r\n").as_bytes()).unwrap();
    while endless.write_all(b"X-More: and more and more and more and more\r\n").is_ok() {}
    // A line without an end, and more headers than there may be.
    let long = format!("X: {}", "y".repeat(8200));
    refused(&run.get("/", &[&own, &long]), 431, "8192 bytes");
    let many: Vec<String> = (0..100).map(|place| format!("X{place}: y")).collect();
    let lines: Vec<&str> = [own.as_str()].into_iter().chain(many.iter().map(String::as_str)).collect();
    refused(&run.get("/", &lines), 431, "64 headers");
    // No HTTP at all.
    let mut other = run.connect();
    other.write_all(b"\x16\x03\x01\x02\x00\x01\x00\r\n\r\n").unwrap();
    let mut answer = String::new();
    other.read_to_string(&mut answer).unwrap();
    refused(&answer, 400, "no request of HTTP");
    // 10^4 one after the other: some say nothing, some are cut, some are whole.
    for number in 0..10_000 {
        let mut stream = run.connect();
        match number % 4 {
            0 => {}
            1 => stream.write_all(b"GET / HT").unwrap(),
            2 => {
                stream.write_all(format!("GET /icon.svg HTTP/1.1\r\n{own}\r\n\r\n").as_bytes()).unwrap();
                stream.shutdown(Shutdown::Write).unwrap();
                let mut answer = String::new();
                stream.read_to_string(&mut answer).unwrap();
                // The threads of those before may not have ended yet.
                assert!(answer.starts_with("HTTP/1.1 200 ") || answer.starts_with("HTTP/1.1 503 "), "{answer}");
            }
            _ => stream.shutdown(Shutdown::Both).unwrap(),
        }
    }
    // So many at a time, and no more: the oldest is hung up. The page that is open is served all the while.
    let mut waiting = Vec::new();
    loop {
        let mut stream = run.connect();
        stream.set_nonblocking(true).unwrap();
        // One that is hung up already takes nothing.
        stream.write_all(b"GET").unwrap_or_default();
        waiting.push(stream);
        assert!(waiting.len() < 10_000, "it takes any number of connections");
        let is_hung_up = |stream: &mut TcpStream| match stream.read(&mut [0; 64]) {
            Ok(len) => len == 0,
            Err(error) => error.kind() != io::ErrorKind::WouldBlock,
        };
        if waiting.iter_mut().any(is_hung_up) {
            break;
        }
    }
    run.hub.publish(&RunEvent::Pausing { rests_s: 1.0 });
    assert_eq!(page.until(|line| line.get("event").is_some())["event"], "pausing");
    page.send("{\"command\":\"stop\"}");
    assert_eq!(run.batches.recv().unwrap(), RunCommand::Stop.into());
    drop(waiting);
    // The places are free again.
    while !run.get("/icon.svg", &[&own]).starts_with("HTTP/1.1 200 ") {}
}

#[test]
fn two_want_control_and_one_has_it() {
    let run = Run::new(None);
    let (mut one, mut other) = (run.socket(), run.socket());
    let first = one.until(|_| true);
    assert_eq!((&first["pulsetrain_control"], &first["knobs"][0]["name"]), (&1.into(), &"wheel.speed".into()));
    let is_control = |line: &Value| line.get("control").is_some();
    other.until(is_control);
    let set = |value: f64| format!("{{\"command\":\"set\",\"knob\":\"wheel.speed\",\"value\":{value}}}");
    one.send(&set(0.2));
    assert!(one.until(|line| line.get("error").is_some())["error"].as_str().unwrap().contains("take control first"));
    let has = |control: &Value| (control["control"]["yours"].clone(), control["control"]["taken"].clone());
    one.send("{\"control\":true}");
    one.until(|line| is_control(line) && has(line) == (true.into(), true.into()));
    other.until(|line| is_control(line) && has(line) == (false.into(), true.into()));
    other.send(&set(0.3));
    assert!(other.until(|line| line.get("error").is_some())["error"].as_str().unwrap().contains("another page"));
    one.send(&set(0.4));
    let expected = RunCommand::Set { knob: "wheel.speed".into(), value: KnobValue::Number(0.4) };
    assert_eq!(run.batches.recv().unwrap(), expected.clone().into());
    // Control changes hands when it is asked for, and the one who had it hears of that.
    other.send("{\"control\":true}");
    one.until(|line| is_control(line) && has(line) == (false.into(), true.into()));
    // Lines of one message act together.
    other.send(&format!("{}\n{{\"command\":\"go\"}}", set(0.5)));
    let expected = RunCommand::Set { knob: "wheel.speed".into(), value: KnobValue::Number(0.5) };
    let together = Batch::now(vec![expected, RunCommand::Go]);
    assert_eq!(run.batches.recv().unwrap(), together);
    // All may stop.
    one.send("{\"command\":\"stop_now\"}");
    assert_eq!(run.batches.recv().unwrap(), RunCommand::StopNow.into());
    // Who leaves gives it back.
    drop(other);
    one.until(|line| is_control(line) && has(line) == (false.into(), false.into()));
    assert_eq!(run.batches.try_iter().count(), 0);
}

#[test]
fn a_page_that_comes_later_sees_what_was() {
    let run = Run::new(None);
    let status = |at_s: f64| {
        let motor = MotorStatus { position: 7, target: Some(7.25), speed: Some(20.0), queue: (1, 2) };
        RunEvent::Status(Status { at_s, lease_s: None, motors: vec![motor], lateness: None })
    };
    // The history is written by a thread of its own: an early page shows that it has come so far.
    let mut early = run.socket();
    early.until(|line| line.get("past").is_some());
    run.hub.publish(&status(1.0));
    run.hub.publish(&RunEvent::Goto { position: "0".into(), from_s: 1.0, until_s: 2.0 });
    early.until(|line| line["event"] == "status");
    early.until(|line| line["event"] == "goto");
    let (history, past) = loop {
        let mut later = run.socket();
        let mut history = Value::Null;
        let past = later.until(|line| line.get("history").is_some() || line.get("past").is_some());
        let past = if past.get("history").is_some() {
            history = past;
            later.until(|line| line.get("past").is_some())
        } else {
            past
        };
        if past["past"][0].is_object() {
            break (history, past);
        }
    };
    assert_eq!(past["past"][0]["event"], "goto");
    let columns = &history["history"];
    assert_eq!((&columns["at_s"][0], &columns["position"][0][0]), (&1.0.into(), &7.0.into()), "{history}");
    assert_eq!((&columns["target"][0][0], &columns["speed"][0][0]), (&7.25.into(), &20.0.into()), "{history}");
    // The end comes last, and closes.
    run.hub.end(&RunEnded::failed("broken".to_owned()));
    assert_eq!(early.until(|line| line.get("ended").is_some())["why"], "broken");
    assert_eq!(early.closed(), (1000, "the run has ended".to_owned()));
}

const TOO_LONG: &str = "a message has 256 KiB at most; only the page that has control may send a longer motion file";

/// The page with control sends motion files as large as the control socket takes, and nothing else of that size.
#[test]
fn the_page_that_has_control_sends_large_motion_files() {
    let run = Run::new(None);
    let motion = |text: String| RunCommand::Motion { text, files: Default::default() };
    let text = "#".repeat(file::MOST_OF_A_MOTION_FILE as usize);
    let line = serde_json::to_string(&motion(text.clone())).unwrap();
    let mut page = run.socket();
    page.send("{\"control\":true}");
    page.send(&line);
    let received = run.batches.recv().unwrap();
    assert!(received == motion(text.clone()).into(), "the whole motion file");
    // The next one waits until this one was looked at.
    run.hub.looked();
    // Others cannot begin one.
    let mut watcher = run.socket();
    let _ = watcher.frame(0x81, line.as_bytes());
    assert_eq!(watcher.closed(), (1009, TOO_LONG.to_owned()));
    // Another one takes control in the middle of one.
    let (first, last) = line.as_bytes().split_at(1 << 20);
    page.frame(0x01, first).unwrap();
    let mut other = run.socket();
    other.send("{\"control\":true}");
    other.until(|line| line["control"]["yours"] == true);
    let _ = page.frame(0x80, last);
    assert_eq!(page.closed(), (1009, TOO_LONG.to_owned()));
    // Its turn is over: that of the other one comes.
    other.send(&serde_json::to_string(&motion("#".repeat(300_000))).unwrap());
    assert!(matches!(run.batches.recv().unwrap().single(), Some(RunCommand::Motion { .. })));
    other.send(&format!("{{\"command\":\"goto\",\"position\":\"{}\"}}", "0".repeat(300_000)));
    assert!(other.until(|line| line.get("error").is_some())["error"].as_str().unwrap().contains("4096 bytes at most"));
    assert_eq!(run.batches.try_iter().count(), 0);
}

#[test]
fn a_page_that_sends_too_much_is_closed() {
    let run = Run::new(None);
    let mut flood = run.socket();
    // It may be closed before all of them are sent.
    let _ = (0..100_000).try_for_each(|_| flood.frame(0x81, b"{\"follow\":true}"));
    while flood.next().is_some_and(|(first, _)| first != 0x88) {}
    assert_eq!(flood.next(), None);
    let mut long = run.socket();
    long.until(|line| line.get("past").is_some());
    // Only the length is sent: the rest is not read.
    long.stream.write_all(&[0x81, 0xff, 0, 0, 0, 0, 1, 0, 0, 0, 1, 2, 3, 4]).unwrap();
    assert_eq!(long.closed(), (1009, TOO_LONG.to_owned()));
    // A motion file of 200 kB is no such line.
    let mut page = run.socket();
    page.send("{\"control\":true}");
    let text = "#".repeat(200_000);
    page.send(&serde_json::to_string(&RunCommand::Motion { text: text.clone(), files: Default::default() }).unwrap());
    assert_eq!(run.batches.recv().unwrap(), RunCommand::Motion { text, files: Default::default() }.into());
    // What is no command is answered.
    page.send("stop");
    assert!(page.until(|line| line.get("error").is_some())["error"].as_str().unwrap().contains("no line of JSON"));
    let mut binary = run.socket();
    binary.frame(0x82, b"{}").unwrap();
    assert_eq!(binary.closed().0, 1003);
}

/// The run never waits for pages that take nothing.
#[test]
fn deaf_pages_do_not_hold_up_the_run() {
    let run = Run::new(None);
    let deaf: Vec<Socket> = (0..16).map(|_| run.socket()).collect();
    let full = run.open(&run.upgrade(&format!("http://{}", run.host())));
    refused(&full.err().unwrap(), 503, "");
    for place in 0..20_000 {
        let motors = vec![MotorStatus { position: place, target: None, speed: None, queue: (0, 0) }; 8];
        run.hub.publish(&RunEvent::Status(Status { at_s: place as f64, lease_s: None, motors, lateness: None }));
    }
    (0..1000).for_each(|_| run.hub.publish(&RunEvent::Pausing { rests_s: 1.0 }));
    drop(deaf);
    // Their places are free again.
    while run.open(&run.upgrade(&format!("http://{}", run.host()))).is_err() {}
}

/// Whoever has no token, or says nothing, keeps nobody out.
#[test]
fn connections_that_say_nothing_keep_nobody_out() {
    let run = Run::new(None);
    let silent: Vec<TcpStream> = (0..200).map(|_| run.connect()).collect();
    for _ in 0..3 {
        let answer = run.get("/", &[&run.own()]);
        assert!(answer.starts_with("HTTP/1.1 200 "), "{answer}");
    }
    drop(silent);
}
