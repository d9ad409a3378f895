//! Packets to groups of requests; what happens to replies.

use std::collections::{BTreeMap, VecDeque};
use std::net::{IpAddr, SocketAddr};
use std::time::{Duration, Instant};

use pulsetrain_session::control::Status;
use rosc::{OscBundle, OscMessage, OscPacket, OscType};

use super::address::{self, Misunderstood, OscCommand};
use super::time_tag::{self, Due, FARTHEST_AHEAD};
use super::{Group, LONGEST_PACKET, Now, OscInfo, OwnAddress};
use crate::live::{KnobInfo, RunCommand, RunEvent};

/// A packet to send.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OscReply {
    /// To whom.
    pub to: SocketAddr,
    /// The bytes.
    pub packet: Vec<u8>,
}

/// What a packet turned out to be.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Translation {
    /// Groups of requests, in the order of the packet.
    pub groups: Vec<Group>,
    /// Answers to its sender.
    pub replies: Vec<OscReply>,
}

/// What the translator has counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Counted {
    pub(super) packets: u64,
    pub(super) malformed: u64,
    pub(super) refused: u64,
    pub(super) late: u64,
}

/// A client that hears what happens.
#[derive(Clone, Debug)]
struct OscClient {
    /// From where it sends.
    from: SocketAddr,
    /// Where it listens.
    to: SocketAddr,
    /// For each motor: whether it hears when that is busy.
    busy: Vec<bool>,
    /// For each motor: how often it hears the position, and when it last did.
    positions: Vec<Option<Report>>,
    position_list: Option<Report>,
    /// Whether it hears of errors.
    errors: bool,
}

/// A report that is repeated.
#[derive(Clone, Copy, Debug)]
struct Report {
    every: Duration,
    last: Option<Instant>,
}

impl Report {
    fn is_due(&mut self, now: Instant) -> bool {
        let is_due = self.last.is_none_or(|last| now.saturating_duration_since(last) >= self.every);
        if is_due {
            self.last = Some(now);
        }
        is_due
    }
}

/// The most clients that hear what happens. A further one takes the place of the one that sent nothing for the longest time.
const MOST_CLIENTS: usize = 16;
/// The most bundles in a packet, nested ones included.
const MOST_BUNDLES: usize = 16;
/// The most replies to a packet: a small packet makes no flood.
const MOST_REPLIES: usize = 64;
/// The most replies about errors and lateness in a second.
const MOST_ERRORS: u32 = 20;
/// Requests of which it is known who sent them, for their refusal.
const MOST_ASKED: usize = 64;
/// Times of the motion that differ by less are the same one, s: a tick of the board is in between.
const SAME_TIME_S: f64 = 1e-5;
/// Where clients hear the tempo, and the cue.
const TEMPO: &str = "/pulsetrain/tempo";
const CUE: &str = "/pulsetrain/cue";
/// A cue that comes back within this time comes from a program that sends back what it hears.
const ECHO_OF_A_CUE: Duration = Duration::from_millis(200);
/// What is answered and never asked. Two programs that answer each other's answers never end.
const ANSWERS: [&str; 8] = [
    "/destIp",
    "/error/command",
    "/position",
    "/positionList",
    "/busy",
    "/pulsetrain/ceiling",
    "/pulsetrain/late",
    "/pulsetrain/state",
];
/// What begins a bundle. Source: OSC 1.0, "OSC Bundles".
const BUNDLE: &[u8] = b"#bundle\0";

/// Translates packets of OSC to requests of a live motion, and what happens to it to packets of OSC.
///
/// It has no socket and no clock: packets come with their sender and the time. It never panics, whatever a packet has in it.
///
/// ```
/// use pulsetrain::live::RunCommand;
/// use pulsetrain::osc::{Now, OscInfo, Translator};
/// let mut translator = Translator::new(OscInfo::default(), None);
/// let now = Now::read();
/// let translation = translator.packet(b"/pause\0\0,\0\0\0", "127.0.0.1:5000".parse().unwrap(), now);
/// assert_eq!(translation.groups[0].requests, [RunCommand::Pause]);
/// assert_eq!(translation.groups[0].due, now.instant);
/// ```
#[derive(Debug)]
pub struct Translator {
    info: OscInfo,
    reply_port: Option<u16>,
    /// Where it listens: no answer goes there.
    own: Option<OwnAddress>,
    /// What all clients heard last of each knob, of the tempo and of the cues, by address, and when: another program may send it back. Nothing is
    /// there that an order has changed since.
    told: BTreeMap<String, (Vec<OscType>, Instant)>,
    /// The one that sent last is the last.
    clients: Vec<OscClient>,
    status: Option<Status>,
    /// Until when of the motion the motors are busy, s.
    busy_until_s: Option<f64>,
    asked: VecDeque<(RunCommand, SocketAddr)>,
    /// Who sent groups for a time of the motion, s.
    expected: VecDeque<(f64, SocketAddr)>,
    /// When the present second of replies about errors began, and how many it had.
    errors: Option<(Instant, u32)>,
    counted: Counted,
}

impl Translator {
    /// A translator for a motion.
    #[must_use]
    pub fn new(info: OscInfo, reply_port: Option<u16>) -> Translator {
        Translator {
            info,
            reply_port,
            own: None,
            told: BTreeMap::new(),
            clients: Vec::new(),
            status: None,
            busy_until_s: None,
            asked: VecDeque::new(),
            expected: VecDeque::new(),
            errors: None,
            counted: Counted::default(),
        }
    }

    /// A translator for a server that listens there.
    #[must_use]
    pub fn at(mut self, own: OwnAddress) -> Translator {
        self.own = Some(own);
        self
    }

    fn is_own(&self, address: SocketAddr) -> bool {
        self.own.is_some_and(|own| own.is(address))
    }

    /// Other motors or knobs: the motion file was changed.
    pub fn set_info(&mut self, info: OscInfo) {
        if info.motors.len() != self.info.motors.len() {
            self.clients.clear();
        }
        self.info = info;
    }

    /// Notes that a group of a sender was passed on for a time of the motion, s: it hears if the group acts later.
    pub fn expect(&mut self, at_s: f64, sender: SocketAddr) {
        if self.expected.len() == MOST_ASKED {
            self.expected.pop_front();
        }
        self.expected.push_back((at_s, sender));
    }

    pub(super) const fn counted(&self) -> Counted {
        self.counted
    }

    /// What a packet asks for.
    pub fn packet(&mut self, bytes: &[u8], from: SocketAddr, now: Now) -> Translation {
        self.counted.packets += 1;
        let mut translation = Translation::default();
        match decode(bytes) {
            Ok(OscPacket::Message(message)) => {
                let requests = self.message(&message, from, now, &mut translation).into_iter().collect();
                push_group(&mut translation, requests, now.instant, None);
            }
            Ok(OscPacket::Bundle(bundle)) => self.bundle(&bundle, None, from, now, &mut translation),
            Err(why) => {
                self.counted.malformed += 1;
                self.refuse(why.into(), from, now.instant, &mut translation.replies);
            }
        }
        for request in translation.groups.iter().flat_map(|group| &group.requests) {
            if self.asked.len() == MOST_ASKED {
                self.asked.pop_front();
            }
            self.asked.push_back((request.clone(), from));
        }
        translation
    }

    /// The reply to the sender of a group that could not be passed on.
    pub(super) fn overrun(&mut self, from: SocketAddr, now: Instant) -> Vec<OscReply> {
        let mut replies = Vec::new();
        let why = "too many commands at a time: this one was left out. Send fewer in a second".to_owned();
        self.refuse(why.into(), from, now, &mut replies);
        replies
    }

    fn bundle(
        &mut self,
        bundle: &OscBundle,
        outer: Option<Instant>,
        from: SocketAddr,
        now: Now,
        translation: &mut Translation,
    ) {
        let mut has_time = false;
        let mut due = match time_tag::due(bundle.timetag, now) {
            Due::AtOnce => now.instant,
            Due::At(due) => {
                // The present time means at once.
                has_time = due > now.instant;
                due
            }
            Due::Late(by) => {
                self.counted.late += 1;
                self.tell_late(by.as_secs_f32(), from, now.instant, &mut translation.replies);
                now.instant
            }
            Due::TooFar(ahead) => {
                let why = format!(
                    "the bundle is for {:.1} s from now on this computer's clock; {} s are the most. Are both clocks right?",
                    ahead.as_secs_f64(),
                    FARTHEST_AHEAD.as_secs()
                );
                self.refuse(why.into(), from, now.instant, &mut translation.replies);
                return;
            }
        };
        // A bundle within another is never earlier than that. Source: OSC 1.0, "OSC Bundles".
        let own = due;
        due = outer.map_or(due, |outer| due.max(outer));
        let sender = (has_time || due > own).then_some(from);
        let mut requests = Vec::new();
        let mut inner = Vec::new();
        for packet in &bundle.content {
            match packet {
                OscPacket::Message(message) => requests.extend(self.message(message, from, now, translation)),
                OscPacket::Bundle(bundle) => inner.push(bundle),
            }
        }
        push_group(translation, requests, due, sender);
        for bundle in inner {
            self.bundle(bundle, Some(due), from, now, translation);
        }
    }

    /// The request of a message; replies if it is something else.
    fn message(
        &mut self,
        message: &OscMessage,
        from: SocketAddr,
        now: Now,
        translation: &mut Translation,
    ) -> Option<RunCommand> {
        if self.is_echo(message, from, now.instant) {
            return None;
        }
        let asked =
            address::read(message, &self.info).and_then(|asked| self.obey(asked, from, &mut translation.replies));
        if let Ok(Some(_)) = &asked {
            // What was told until now is changed by this order.
            self.told.clear();
        }
        asked.unwrap_or_else(|error| {
            // An answer to an answer would be answered.
            if ANSWERS.contains(&message.addr.as_str()) {
                self.counted.refused += 1;
                return None;
            }
            self.refuse(error, from, now.instant, &mut translation.replies);
            None
        })
    }

    fn obey(
        &mut self,
        asked: OscCommand,
        from: SocketAddr,
        replies: &mut Vec<OscReply>,
    ) -> Result<Option<RunCommand>, Misunderstood> {
        match asked {
            OscCommand::Nothing => {}
            OscCommand::Run(request) => return Ok(Some(request)),
            OscCommand::Move(steps) => {
                let status = self.known_status()?;
                if status.motors.iter().any(|motor| motor.speed != Some(0.0)) {
                    let why = "CommandIgnored: /move needs a motor at rest".to_owned();
                    return Err(Misunderstood { why, motor: 1 });
                }
                let position = self.positions(status).next().unwrap_or(0) as f64 + steps;
                return Ok(Some(RunCommand::Goto { position: format!("{position} steps") }));
            }
            OscCommand::Positions(motors) => {
                let positions: Vec<i64> = self.positions(self.known_status()?).collect();
                for motor in motors {
                    if let Some(position) = positions.get(motor) {
                        self.reply(from, "/position", vec![motor_number(motor), steps(*position)], replies);
                    }
                }
            }
            OscCommand::PositionList => {
                let positions = self.positions(self.known_status()?).map(steps).collect();
                self.reply(from, "/positionList", positions, replies);
            }
            OscCommand::Busy(motors) => {
                for motor in motors {
                    self.reply(from, "/busy", self.busy(motor), replies);
                }
            }
            OscCommand::Listen(port) => {
                let port = port.or(self.reply_port).unwrap_or(from.port());
                let to = SocketAddr::new(from.ip(), port);
                if self.is_own(to) {
                    let why =
                        format!("port {port} is the one at which Pulsetrain listens: name the one at which you do");
                    return Err(why.into());
                }
                let is_new = !self.clients.iter().any(|client| (client.from, client.to) == (from, to));
                self.client(from).to = to;
                let mut arguments = match to.ip().to_canonical() {
                    IpAddr::V4(ip) => ip.octets().map(|octet| OscType::Int(octet.into())).to_vec(),
                    ip @ IpAddr::V6(_) => vec![OscType::String(ip.to_string())],
                };
                arguments.push(OscType::Int(is_new.into()));
                self.reply(from, "/destIp", arguments, replies);
            }
            OscCommand::ReportBusy(motors, is_on) => {
                let busy = &mut self.client(from).busy;
                motors.iter().for_each(|motor| busy[*motor] = is_on);
            }
            OscCommand::ReportPositions(motors, every) => {
                let report = every.map(|every| Report { every, last: None });
                let reports = &mut self.client(from).positions;
                motors.iter().for_each(|motor| reports[*motor] = report);
            }
            OscCommand::ReportPositionList(every) => {
                self.client(from).position_list = every.map(|every| Report { every, last: None });
            }
            OscCommand::ReportErrors(is_on) => self.client(from).errors = is_on,
        }
        Ok(None)
    }

    /// Whether a message is what its sender's computer was told last, sent back: it asks for what is so already. A cue may be wanted again, by a
    /// person, who takes longer.
    fn is_echo(&self, message: &OscMessage, from: SocketAddr, now: Instant) -> bool {
        self.clients.iter().any(|client| client.to.ip() == from.ip())
            && self.told.get(&message.addr).is_some_and(|(arguments, at)| {
                *arguments == message.args
                    && (message.addr != CUE || now.saturating_duration_since(*at) < ECHO_OF_A_CUE)
            })
    }

    fn note(&mut self, address: String, argument: OscType, now: Instant) {
        self.told.insert(address, (vec![argument], now));
    }

    /// What the clients are to hear of an event.
    pub fn happened(&mut self, event: &RunEvent, now: Instant) -> Vec<OscReply> {
        let mut replies = Vec::new();
        self.answer(event, now, &mut replies);
        match event {
            RunEvent::Tempo { rate, .. } => self.note(TEMPO.to_owned(), OscType::Float(*rate as f32), now),
            RunEvent::Set { knob, value, .. } => {
                self.note(address::knob_address(knob, &self.info), OscType::Float(*value as f32), now);
            }
            // Knobs may have other values now.
            RunEvent::Cue { name, .. } => {
                self.told.clear();
                self.note(CUE.to_owned(), OscType::String(name.clone()), now);
            }
            RunEvent::Refused { .. }
            | RunEvent::Late { .. }
            | RunEvent::Progress { .. }
            | RunEvent::Status(_)
            | RunEvent::Pausing { .. }
            | RunEvent::Resuming { .. }
            | RunEvent::Stopping { .. }
            | RunEvent::StoppedAtOnce { .. }
            | RunEvent::Ended(_)
            | RunEvent::Failed { .. } => {}
            _ => self.told.clear(),
        }
        replies
    }

    fn answer(&mut self, event: &RunEvent, now: Instant, replies: &mut Vec<OscReply>) {
        match event {
            RunEvent::Status(status) => self.status(status, now, replies),
            RunEvent::Progress { .. } => {}
            RunEvent::Pausing { rests_s } => {
                self.state("pausing", replies);
                self.busy_until(*rests_s, replies);
            }
            RunEvent::Resuming { full_speed_s } => {
                self.state("running", replies);
                self.busy_until(*full_speed_s, replies);
            }
            RunEvent::Tempo { rate, from_s, ceiling } => {
                self.all(TEMPO, &[OscType::Float(*rate as f32)], replies);
                self.ceiling("tempo", ceiling.as_deref(), replies);
                self.busy_until(*from_s, replies);
            }
            RunEvent::Stopping { .. } => {
                self.state("stopping", replies);
                self.busy_until(f64::INFINITY, replies);
            }
            RunEvent::StoppedAtOnce { .. } => {
                self.state("stopped", replies);
                self.rests(replies);
            }
            RunEvent::Ended(ended) => {
                self.state(if ended.stopped { "stopped" } else { "finished" }, replies);
                self.rests(replies);
            }
            RunEvent::Failed { why, .. } => {
                self.state("failed", replies);
                self.rests(replies);
                self.tell_error(why, None, replies);
            }
            RunEvent::Late { wanted_s, by_s } => {
                let is_it = |(at_s, _): &(f64, SocketAddr)| (at_s - wanted_s).abs() < SAME_TIME_S;
                while let Some(place) = self.expected.iter().position(is_it)
                    && let Some((_, sender)) = self.expected.remove(place)
                {
                    self.counted.late += 1;
                    self.tell_late(*by_s as f32, sender, now, replies);
                }
            }
            RunEvent::Set { knob, value, ceiling, until_s, .. } => {
                let is_it = |known: &&mut KnobInfo| known.name == *knob;
                if let Some(known) = self.info.knobs.iter_mut().find(is_it) {
                    known.value = *value;
                }
                let address = address::knob_address(knob, &self.info);
                self.all(&address, &[OscType::Float(*value as f32)], replies);
                self.ceiling(knob, ceiling.as_deref(), replies);
                self.busy_until(*until_s, replies);
            }
            RunEvent::Cue { name, until_s, .. } => {
                self.all(CUE, &[OscType::String(name.clone())], replies);
                self.busy_until(*until_s, replies);
            }
            RunEvent::Goto { until_s, .. }
            | RunEvent::Returned { until_s, .. }
            | RunEvent::Motion { until_s, .. }
            | RunEvent::Rejoined { until_s, .. } => {
                self.busy_until(*until_s, replies);
            }
            RunEvent::Began { until_s, .. } => {
                self.state("running", replies);
                self.busy_until(*until_s, replies);
            }
            RunEvent::TakenBack { why, until_s, .. } => {
                self.tell_error(&format!("the last change is taken back: {why}"), None, replies);
                self.busy_until(*until_s, replies);
            }
            RunEvent::MotionRefused { error, line, .. } => {
                let place = line.map_or_else(String::new, |line| format!("line {line}: "));
                self.tell_error(&format!("the motion file was not taken over: {place}{error}"), None, replies);
            }
            RunEvent::Unplugged { why, .. } | RunEvent::Unplaced { why, .. } => self.tell_error(why, None, replies),
            RunEvent::AlreadyRuns => self.state("running", replies),
            RunEvent::MotionEnded { .. } => self.state("ended", replies),
            RunEvent::Resting { .. } | RunEvent::Placed { .. } => {}
            RunEvent::Refused { command, why } => self.tell_refusal(command, why, replies),
        }
    }

    fn status(&mut self, status: &Status, now: Instant, replies: &mut Vec<OscReply>) {
        if self.busy_until_s.is_some_and(|until_s| status.at_s >= until_s) {
            self.rests(replies);
        }
        let positions: Vec<i64> = self.positions(status).collect();
        for client in &mut self.clients {
            for (motor, report) in client.positions.iter_mut().enumerate() {
                if let (Some(report), Some(position)) = (report, positions.get(motor))
                    && report.is_due(now)
                {
                    replies.extend(encoded(client.to, "/position", vec![motor_number(motor), steps(*position)]));
                }
            }
            if client.position_list.as_mut().is_some_and(|report| report.is_due(now)) {
                let list = positions.iter().copied().map(steps).collect();
                replies.extend(encoded(client.to, "/positionList", list));
            }
        }
        self.status = Some(status.clone());
    }

    /// The client that sends from there. A new one hears errors and events.
    fn client(&mut self, from: SocketAddr) -> &mut OscClient {
        let count = self.info.motors.len();
        let known = self.clients.iter().position(|client| client.from == from);
        let client = match known {
            Some(index) => self.clients.remove(index),
            None => {
                if self.clients.len() == MOST_CLIENTS {
                    self.clients.remove(0);
                }
                let to = self.reply_to(from);
                OscClient {
                    from,
                    to,
                    busy: vec![false; count],
                    positions: vec![None; count],
                    position_list: None,
                    errors: true,
                }
            }
        };
        self.clients.push(client);
        let last = self.clients.len() - 1;
        &mut self.clients[last]
    }

    /// Where the sender of a packet listens: where it said, where another sender at the same computer said, or from where it sends.
    fn reply_to(&self, from: SocketAddr) -> SocketAddr {
        let exactly = self.clients.iter().find(|client| client.from == from);
        let elsewhere = |client: &&OscClient| client.from.ip() == from.ip() && client.to.port() != client.from.port();
        let known = exactly.or_else(|| self.clients.iter().rev().find(elsewhere));
        let to = known
            .map_or_else(|| SocketAddr::new(from.ip(), self.reply_port.unwrap_or(from.port())), |client| client.to);
        // One that says our own port can still hear what is wrong.
        if self.is_own(to) { from } else { to }
    }

    fn known_status(&self) -> Result<&Status, Misunderstood> {
        self.status.as_ref().ok_or_else(|| "no position is known yet: the motion has not begun".to_owned().into())
    }

    /// Where the motors are by the file's zero, steps.
    fn positions<'a>(&'a self, status: &'a Status) -> impl Iterator<Item = i64> + 'a {
        let motors = self.info.motors.iter().zip(&status.motors);
        motors.map(|(motor, status)| (motor.start_steps + status.position as f64).round() as i64)
    }

    fn busy(&self, motor: usize) -> Vec<OscType> {
        vec![motor_number(motor), OscType::Int(self.busy_until_s.is_some().into())]
    }

    fn busy_until(&mut self, until_s: f64, replies: &mut Vec<OscReply>) {
        let was_busy = self.busy_until_s.is_some();
        self.busy_until_s = Some(self.busy_until_s.map_or(until_s, |before_s| before_s.max(until_s)));
        if !was_busy {
            self.tell_busy(replies);
        }
    }

    fn rests(&mut self, replies: &mut Vec<OscReply>) {
        if self.busy_until_s.take().is_some() {
            self.tell_busy(replies);
        }
    }

    fn tell_busy(&self, replies: &mut Vec<OscReply>) {
        for client in &self.clients {
            for motor in (0..client.busy.len()).filter(|motor| client.busy[*motor]) {
                replies.extend(encoded(client.to, "/busy", self.busy(motor)));
            }
        }
    }

    fn state(&self, state: &str, replies: &mut Vec<OscReply>) {
        self.all("/pulsetrain/state", &[OscType::String(state.to_owned())], replies);
    }

    fn ceiling(&self, of: &str, ceiling: Option<&str>, replies: &mut Vec<OscReply>) {
        if let Some(ceiling) = ceiling {
            self.all("/pulsetrain/ceiling", &[of, ceiling].map(|text| OscType::String(text.to_owned())), replies);
        }
    }

    fn all(&self, address: &str, arguments: &[OscType], replies: &mut Vec<OscReply>) {
        replies.extend(self.clients.iter().filter_map(|client| encoded(client.to, address, arguments.to_vec())));
    }

    /// Tells who asked for it, and all clients, that a request was refused.
    fn tell_refusal(&mut self, request: &RunCommand, why: &str, replies: &mut Vec<OscReply>) {
        self.counted.refused += 1;
        let asked = self.asked.iter().rposition(|(asked, _)| asked == request);
        let asked = asked.and_then(|index| self.asked.remove(index)).map(|(_, from)| self.reply_to(from));
        self.tell_error(why, asked, replies);
    }

    fn tell_error(&self, why: &str, first: Option<SocketAddr>, replies: &mut Vec<OscReply>) {
        let clients = self.clients.iter().filter(|client| client.errors).map(|client| client.to);
        let mut told: Vec<SocketAddr> = Vec::new();
        for to in first.into_iter().chain(clients) {
            if !told.contains(&to) {
                replies.extend(error(to, why, 0));
                told.push(to);
            }
        }
    }

    /// Tells the sender of a packet what is wrong with it.
    fn refuse(&mut self, wrong: Misunderstood, from: SocketAddr, now: Instant, replies: &mut Vec<OscReply>) {
        self.counted.refused += 1;
        let is_wanted = self.clients.iter().find(|client| client.from == from).is_none_or(|client| client.errors);
        if self.may_complain(now) && is_wanted && replies.len() < MOST_REPLIES {
            replies.extend(error(self.reply_to(from), &wrong.why, wrong.motor));
        }
    }

    /// Tells a sender that its bundle acts late, by so many seconds.
    fn tell_late(&mut self, by_s: f32, sender: SocketAddr, now: Instant, replies: &mut Vec<OscReply>) {
        if self.may_complain(now) {
            self.reply(sender, "/pulsetrain/late", vec![OscType::Float(by_s)], replies);
        }
    }

    /// Whether there may be one more reply about an error in this second.
    fn may_complain(&mut self, now: Instant) -> bool {
        let is_now = |(began, _): &(Instant, u32)| now.saturating_duration_since(*began).as_secs() == 0;
        let (began, told) = self.errors.filter(is_now).unwrap_or((now, 0));
        self.errors = Some((began, told + 1));
        told < MOST_ERRORS
    }

    fn reply(&self, from: SocketAddr, address: &str, arguments: Vec<OscType>, replies: &mut Vec<OscReply>) {
        if replies.len() < MOST_REPLIES {
            replies.extend(encoded(self.reply_to(from), address, arguments));
        }
    }
}

/// Adds requests that are due at a time. Those that are due with the group before are part of it.
fn push_group(translation: &mut Translation, requests: Vec<RunCommand>, due: Instant, sender: Option<SocketAddr>) {
    if requests.is_empty() {
        return;
    }
    match translation.groups.last_mut().filter(|group| group.due == due) {
        Some(group) => {
            group.requests.extend(requests);
            group.sender = group.sender.or(sender);
        }
        None => translation.groups.push(Group { requests, due, sender }),
    }
}

fn decode(bytes: &[u8]) -> Result<OscPacket, String> {
    if bytes.len() > LONGEST_PACKET {
        return Err(format!("the packet has more than {LONGEST_PACKET} bytes: send several"));
    }
    // The decoder calls itself for each bundle in a bundle.
    if bytes.windows(BUNDLE.len()).filter(|part| *part == BUNDLE).count() > MOST_BUNDLES {
        return Err(format!("the packet has more than {MOST_BUNDLES} bundles: send several packets"));
    }
    match rosc::decoder::decode_udp(bytes) {
        // It leaves out the rest of a bundle when a part of it is broken.
        Ok(([], packet)) => Ok(packet),
        Ok(_) => Err("the packet is no OSC: it has more bytes than its messages".to_owned()),
        Err(_) => Err("the packet is no OSC: it is neither a message nor a bundle".to_owned()),
    }
}

fn motor_number(motor: usize) -> OscType {
    OscType::Int(i32::try_from(motor + 1).unwrap_or(i32::MAX))
}

/// A position has 32 bits, as the STEP400's, unless it needs more.
fn steps(position: i64) -> OscType {
    i32::try_from(position).map_or(OscType::Long(position), OscType::Int)
}

/// The form is the STEP400's: what is wrong, and the number of the motor.
fn error(to: SocketAddr, why: &str, motor: i32) -> Option<OscReply> {
    encoded(to, "/error/command", vec![OscType::String(why.to_owned()), OscType::Int(motor)])
}

/// A message. `None` if it cannot be encoded, which no address of this file is.
fn encoded(to: SocketAddr, address: &str, arguments: Vec<OscType>) -> Option<OscReply> {
    // A text of OSC ends at its first 0.
    let clean = |argument| match argument {
        OscType::String(text) => OscType::String(text.replace('\0', "")),
        other => other,
    };
    let args = arguments.into_iter().map(clean).collect();
    let message = OscMessage { addr: address.to_owned(), args };
    rosc::encoder::encode(&OscPacket::Message(message)).ok().map(|packet| OscReply { to, packet })
}

#[cfg(test)]
mod tests;
