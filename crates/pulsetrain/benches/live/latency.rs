//! From a client's event to the first tick of the motors' change, of `pulsetrain live` on boards in real time.
//!
//! The event's instant is this computer's clock just before it is sent. The log has the instant at which the motion heard of it, and the board's
//! time from there to the first tick of the change. A virtual board stands still while this computer plans: the first tick is no earlier than the
//! instant at which the plan was sent.

use super::load::{Free, Live, Socket};
use super::{Row, pins};
use pulsetrain::board::BoardKind;
use pulsetrain::live::log::{LogEntry, Replay};
use pulsetrain::live::{KnobValue, RunCommand, RunEvent};
use std::io::{BufReader, Write};
use std::net::{Ipv4Addr, UdpSocket};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Changes that are measured of each way and board.
const CHANGES: f64 = 100.0;
/// The bounds, s: from the event to the first tick.
const BOUNDS_S: [(&str, f64); 3] = [("native", 0.02), ("pico", 0.02), ("uno", 0.06)];

/// A way to ask for a change.
enum Way {
    Line,
    Osc(UdpSocket),
    Page(Box<Socket>),
}

impl Way {
    fn name(&self) -> &'static str {
        match self {
            Way::Line => "a line",
            Way::Osc(_) => "an OSC message",
            Way::Page(_) => "the page",
        }
    }

    fn send(&mut self, live: &mut Live, value: f64) {
        match self {
            Way::Line => writeln!(live.input(), "m0.frequency {value} Hz").expect("it takes lines"),
            Way::Osc(socket) => {
                let (addr, args) = ("/pulsetrain/m0/frequency".to_owned(), vec![rosc::OscType::Double(value)]);
                let packet = rosc::OscPacket::Message(rosc::OscMessage { addr, args });
                socket.send(&rosc::encoder::encode(&packet).expect("it is OSC")).expect("it listens");
            }
            Way::Page(socket) => {
                socket.say(&format!("{{\"command\":\"set\",\"knob\":\"m0.frequency\",\"value\":{value}}}"));
            }
        }
    }
}

/// Four sweeps near a board's limit.
fn text(board: &str) -> String {
    // Steps, at 1 Hz: an Uno turns four motors at some 20 000 steps/s each.
    let swing = if board == "uno" { 4000 } else { 6000 };
    let mut text = format!("board = \"{board}\"\ntolerance = \"2 us\"\n");
    for (motor, (step, dir)) in pins(board).into_iter().enumerate() {
        text += &format!(
            "[motor.m{motor}]\nsteps_per_rev = 200\nmicrosteps = 16\ndriver = \"A4988\"\npins = {{ step = {step}, dir = {dir} }}\n\
             forward = \"high\"\nmax_speed = \"10 rev/s\"\nmax_acceleration = \"200 rev/s^2\"\n\
             [[motion]]\nmotor = \"m{motor}\"\nlaw.sweep = {{ frequency = \"1 Hz\", swing = \"{swing} step\", phase = \"{} deg\" }}\n",
            90 * motor
        );
    }
    text
}

/// Each way to ask for a change on a board.
pub(crate) fn rows(board: &'static str, share: f64) -> Vec<Row> {
    (0..3).map(|way| row(board, way, (share * CHANGES).ceil().max(3.0) as u32)).collect()
}

fn row(board: &'static str, way: u8, changes: u32) -> Row {
    let folder = Free::folder();
    let (osc, page) = (Free::udp_port(), Free::tcp_port());
    let log = folder.join("log.jsonl");
    let mut options = vec!["--log".to_owned(), log.display().to_string()];
    if way == 1 {
        options.extend(["--osc".to_owned(), osc.to_string()]);
    }
    if way == 2 {
        options.extend(["--page".to_owned(), page.to_string()]);
    }
    let mut live = Live::start(&folder, &text(board), &options);
    let mut way = match way {
        0 => Way::Line,
        1 => {
            let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
            socket.connect((Ipv4Addr::LOCALHOST, osc)).expect("an address");
            Way::Osc(socket)
        }
        _ => {
            let mut socket = Socket::open(page);
            socket.say("{\"control\":true}");
            Way::Page(Box::new(socket))
        }
    };
    // The motion begins.
    std::thread::sleep(Duration::from_secs(2));
    let mut sent = Vec::new();
    for k in 0..changes {
        // Instants that have nothing to do with the steps' period.
        std::thread::sleep(Duration::from_millis(350 + u64::from(k * 61 % 97)));
        let value = if k % 2 == 0 { 0.9 } else { 1.0 } - 1e-4 * f64::from(k);
        let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64());
        way.send(&mut live, value);
        sent.push((value, now));
    }
    std::thread::sleep(Duration::from_secs(1));
    live.stop();
    let latencies = latencies(&log, &sent);
    let bound_s = BOUNDS_S.into_iter().find(|(name, _)| *name == board).map_or(f64::NAN, |(_, bound_s)| bound_s);
    let found = latencies.len();
    let _ = std::fs::remove_dir_all(&folder);
    let at =
        |share: f64| latencies.get(((found as f64 * share).ceil() as usize).max(1) - 1).copied().unwrap_or(f64::NAN);
    let ms = |s: f64| format!("{:.1}", 1e3 * s);
    Row {
        figure: 1,
        what: format!("from {} to the first tick of the change", way.name()),
        board,
        measured: format!("median {}, p99 {}, most {} ms", ms(at(0.5)), ms(at(0.99)), ms(at(1.0))),
        // What this computer's other programs do to it is no promise of ours: the median is.
        bound: format!("median {} ms", ms(bound_s)),
        more: format!(
            "{found} of {changes} changes, four motors of {} steps/s",
            if BoardKind::named(board).is_some_and(|kind| kind.is_rehearsed()) { "12 600" } else { "18 800" }
        ),
        holds: found == sent.len() && at(0.5) <= bound_s,
    }
}

/// From each event to its first tick, s, the least first.
fn latencies(log: &std::path::Path, sent: &[(f64, f64)]) -> Vec<f64> {
    let file = std::fs::File::open(log).expect("the log is there");
    let log = Replay::read(BufReader::new(file)).expect("it is a log");
    let mut latencies = Vec::new();
    for &(value, at_s) in sent {
        let asks = |command: &RunCommand| match command {
            RunCommand::Set { value: KnobValue::Number(asked), .. } => (asked - value).abs() < 1e-9,
            RunCommand::Set { value: KnobValue::Text(text), .. } => *text == format!("{value} Hz"),
            _ => false,
        };
        let asked = log
            .lines
            .iter()
            .find(|line| matches!(&line.entry, LogEntry::Asked(batch) if batch.single().is_some_and(asks)));
        let done = log.lines.iter().find_map(|line| match &line.entry {
            LogEntry::Done(RunEvent::Set { value: set, from_s, .. }) if (set - value).abs() < 1e-9 => {
                Some((line.unix_s, *from_s))
            }
            _ => None,
        });
        if let (Some(asked), Some((sent_s, from_s))) = (asked, done) {
            latencies.push((asked.unix_s + from_s - asked.at_s).max(sent_s) - at_s);
        }
    }
    latencies.sort_by(f64::total_cmp);
    latencies
}
