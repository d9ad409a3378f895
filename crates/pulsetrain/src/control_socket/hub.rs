//! The hub of a run: clients of every kind join it, send it requests and take its lines. It knows no transport.
//!
//! The run's thread tells the hub what happens, and never waits for it: each client has a bounded queue of lines, and one
//! that takes none of them is dropped. A client's thread waits if it sends faster than the run takes.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, sync_channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use serde::Serialize;

use pulsetrain_session::control::{Command, Event};

use super::{ClientLine, ControlState, LONGEST_LINE, RunEnded, RunInfo, RunLine};
use super::{Happened, LiveCommand, LiveEvent, Request, Together};

/// Clients of a kind at a time. Each kind has places of its own, so that `pulsetrain stop` finds one however many pages are open.
pub(super) const MOST_CLIENTS: usize = 16;
/// Characters of an error about a line that may be long.
const MOST_OF_AN_ERROR: usize = 400;
/// Lines that wait for a client. One that takes none of them is dropped.
const MOST_LINES: usize = 256;
/// Lines that wait for a client when statuses are left out: the rest is for events, which it must not miss.
const MOST_STATUSES: usize = 128;
/// Requests of a client that wait for the run. Then the client's thread waits.
const MOST_REQUESTS: usize = 16;
/// Requests that a live motion takes for each of its looks. A run takes one.
const LIVE_REQUESTS: u32 = 8;
/// How long the end of a run waits for its clients.
pub(super) const PATIENCE: Duration = Duration::from_secs(1);
/// How long a line with a motion file may take, however steadily it comes: the long lines of other clients wait for its end.
pub(crate) const LONG_LINE_TIME: Duration = Duration::from_secs(30);

/// Why a `run` does not obey a [`LiveCommand`].
const NOT_LIVE: &str = "this is a `run`; `pulsetrain live` takes knobs and cues";

/// What a client is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClientKind {
    /// The terminal of the run itself.
    Terminal,
    /// A program of the same user, at the control socket.
    Socket,
    /// OSC.
    Osc,
    /// MIDI.
    Midi,
    /// A page in a browser. One page controls, all may stop.
    Page,
    /// It only listens, within this process.
    Recorder,
}

/// A run's hub. Clones are the same hub.
#[derive(Clone, Debug)]
pub struct Hub {
    shared: Arc<Shared>,
}

#[derive(Debug)]
struct Shared {
    state: Mutex<State>,
    changed: Condvar,
    /// Who holds it reads a line with a motion file.
    long_line: Mutex<()>,
}

/// Where the requests go.
#[derive(Debug)]
enum Sink {
    Run(Sender<Command>),
    Live(Sender<Request>),
}

#[derive(Debug)]
struct State {
    info: RunInfo,
    sink: Sink,
    clients: Vec<JoinedClient>,
    joined: u64,
    /// Requests that the run takes before it looks again.
    allowed: u32,
    /// Requests that wait, and who sent them.
    waiting: VecDeque<(u64, Request)>,
    stop_sent: bool,
    stop_now_sent: bool,
    /// The page that controls.
    controls: Option<u64>,
    /// A moment of the time of day, and the motion's time then, s.
    clock: Option<(Instant, f64)>,
    is_over: bool,
}

#[derive(Debug)]
struct JoinedClient {
    number: u64,
    kind: ClientKind,
    /// `None` after the last line.
    lines: Option<SyncSender<Arc<str>>>,
    /// How many lines it has not taken.
    waiting: Arc<AtomicUsize>,
    follows: bool,
    /// It sends nothing more. Such clients make room for new ones.
    is_silent: bool,
}

/// Why a client cannot join.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum JoinError {
    /// All places for clients of its kind are taken.
    #[error("this run has {MOST_CLIENTS} clients already")]
    Full,
    /// The run has ended.
    #[error("this run has ended")]
    Over,
}

impl Hub {
    /// The hub of a `run`, which takes commands, and with it their receiver's sender.
    #[must_use]
    pub fn of_run(info: RunInfo, commands: Sender<Command>) -> Hub {
        Hub::new(info, Sink::Run(commands))
    }

    /// The hub of a live motion, which takes all requests.
    #[must_use]
    pub fn of_live(info: RunInfo, requests: Sender<Request>) -> Hub {
        Hub::new(info, Sink::Live(requests))
    }

    fn new(info: RunInfo, sink: Sink) -> Hub {
        let state = State {
            info,
            sink,
            clients: Vec::new(),
            joined: 0,
            allowed: 0,
            waiting: VecDeque::new(),
            stop_sent: false,
            stop_now_sent: false,
            controls: None,
            clock: None,
            is_over: false,
        };
        Hub {
            shared: Arc::new(Shared { state: Mutex::new(state), changed: Condvar::new(), long_line: Mutex::new(()) }),
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.shared.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A new client. Its first line is the [`RunInfo`].
    ///
    /// # Errors
    /// If all places are taken, or the run is over.
    pub fn join(&self, kind: ClientKind) -> Result<HubClient, JoinError> {
        let mut state = self.state();
        if state.is_over {
            return Err(JoinError::Over);
        }
        let of_kind = |client: &JoinedClient| client.kind == kind;
        if kind != ClientKind::Recorder && state.clients.iter().filter(|client| of_kind(client)).count() >= MOST_CLIENTS
        {
            let silent = state.clients.iter().position(|client| of_kind(client) && client.is_silent);
            // Its queue ends, and with it the connection.
            state.clients.remove(silent.ok_or(JoinError::Full)?);
        }
        state.joined += 1;
        let number = state.joined;
        let (lines, taken) = sync_channel(MOST_LINES);
        let waiting = Arc::new(AtomicUsize::new(0));
        let client = JoinedClient {
            number,
            kind,
            lines: Some(lines),
            waiting: Arc::clone(&waiting),
            follows: false,
            is_silent: false,
        };
        client.answer(&state.info);
        state.clients.push(client);
        if kind == ClientKind::Page {
            state.tell_control();
        }
        let lines = HubLines { hub: self.clone(), number, lines: taken, waiting };
        Ok(HubClient { sender: HubSender { hub: self.clone(), number, kind }, lines })
    }

    /// Tells the clients of an event of the session. It never waits for them.
    pub fn tell(&self, event: &Event) {
        let mut state = self.state();
        let is_status = matches!(event, Event::Status(_));
        if is_status {
            state.looked();
            self.shared.changed.notify_all();
        }
        // The run's last line says more than the last event.
        if !matches!(event, Event::Progress { .. } | Event::Ended(_) | Event::Failed { .. }) {
            state.tell(event, is_status);
        }
    }

    /// Tells the clients what happened. It never waits for them.
    pub fn tell_happened(&self, happened: &Happened) {
        match happened {
            Happened::Session(event) => self.tell(event),
            Happened::Live(event) => self.tell_live(event),
        }
    }

    /// Tells the clients of an event of a live motion. It never waits for them.
    pub fn tell_live(&self, event: &LiveEvent) {
        let mut state = self.state();
        if let LiveEvent::Set { knob, value, .. } = event
            && let Some(known) = state.info.knobs.iter_mut().find(|known| known.name == *knob)
        {
            known.value = *value;
        }
        state.tell(event, false);
    }

    /// Changes what is known of the run, such as its knobs and cues after a new motion file, and tells the clients.
    pub fn change_info(&self, change: impl FnOnce(&mut RunInfo)) {
        let mut state = self.state();
        change(&mut state.info);
        let info = state.info.clone();
        state.tell(&info, false);
    }

    /// What is known of the run.
    #[must_use]
    pub fn info(&self) -> RunInfo {
        self.state().info.clone()
    }

    /// The run has taken the requests that were sent to it: others may come. Each status that it tells says the same.
    pub fn looked(&self) {
        self.state().looked();
        self.shared.changed.notify_all();
    }

    /// Notes the motion's time at a moment, s: what is asked for a time of day needs it.
    pub fn set_clock(&self, moment: Instant, at_s: f64) {
        self.state().clock = Some((moment, at_s));
    }

    /// The motion's time at a moment, s, 0 at least; `None` if it is not known.
    #[must_use]
    pub fn time_at(&self, moment: Instant) -> Option<f64> {
        let (known, at_s) = self.state().clock?;
        let since_s = match moment.checked_duration_since(known) {
            Some(after) => after.as_secs_f64(),
            None => -known.saturating_duration_since(moment).as_secs_f64(),
        };
        Some((at_s + since_s).max(0.0))
    }

    /// Whether it is that of a live motion, which takes all requests.
    #[must_use]
    pub fn is_live(&self) -> bool {
        matches!(self.state().sink, Sink::Live(_))
    }

    /// Waits until no other client reads a line with a motion file. So their memory is that of one.
    pub(crate) fn long_line(&self) -> MutexGuard<'_, ()> {
        self.shared.long_line.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether a client has asked for a stop. A run that has much to do may ask this first.
    #[must_use]
    pub fn wants_stop(&self) -> bool {
        let state = self.state();
        state.stop_sent || state.stop_now_sent
    }

    /// Waits that long, or until the run is over. Whether it is.
    #[must_use]
    pub fn is_over_within(&self, patience: Duration) -> bool {
        let waited = self.shared.changed.wait_timeout_while(self.state(), patience, |state| !state.is_over);
        waited.unwrap_or_else(PoisonError::into_inner).0.is_over
    }

    /// Tells the clients how the run ended, and waits a second at most until they have taken it.
    pub fn end(&self, ended: &RunEnded) {
        self.close(Some(ended));
        self.wait_for_clients();
    }

    /// Ends the clients' queues.
    pub(super) fn close(&self, ended: Option<&RunEnded>) {
        let mut state = self.state();
        state.is_over = true;
        state.waiting.clear();
        for client in &mut state.clients {
            if let Some(ended) = ended {
                client.answer(&RunLine::Ended(ended.clone()));
            }
            client.lines = None;
        }
        self.shared.changed.notify_all();
    }

    pub(super) fn wait_for_clients(&self) {
        let is_there = |state: &mut State| !state.clients.is_empty();
        drop(self.shared.changed.wait_timeout_while(self.state(), PATIENCE, is_there));
    }
}

/// A client of a hub.
#[derive(Debug)]
pub struct HubClient {
    sender: HubSender,
    lines: HubLines,
}

impl HubClient {
    /// Sends a request, as [`HubSender::send`] does.
    pub fn send(&self, request: Request) {
        self.sender.send(request);
    }

    /// Whether it gets each status.
    pub fn follow(&self, follows: bool) {
        self.sender.follow(follows);
    }

    /// Waits for the next line; `None` after the last.
    pub fn next_line(&self) -> Option<Arc<str>> {
        self.lines.next_line()
    }

    /// Its two ends, for a thread each.
    #[must_use]
    pub fn split(self) -> (HubSender, HubLines) {
        (self.sender, self.lines)
    }
}

/// The sending end of a client. A client that drops it still gets lines, but makes room for others.
#[derive(Debug)]
pub struct HubSender {
    hub: Hub,
    number: u64,
    kind: ClientKind,
}

impl HubSender {
    /// Sends a request. A stop goes at once, and only once. Others wait until the run has looked for requests again, so that
    /// they cannot pile up. If too many of this client wait, so does its thread.
    pub fn send(&self, request: Request) {
        let mut state = self.hub.state();
        match request {
            Request::Session(command @ (Command::Stop | Command::StopNow)) => state.stop(command),
            Request::Live(command) if matches!(state.sink, Sink::Run(_)) => {
                state.answer(self.number, &LiveEvent::Refused { command, why: NOT_LIVE.to_owned() });
            }
            Request::Together(Together { together, at_s }) if matches!(state.sink, Sink::Run(_)) => match at_s {
                Some(_) => state.answer(self.number, &RunLine::Error { error: NOT_LIVE.to_owned() }),
                None => {
                    drop(state);
                    together.into_iter().for_each(|request| self.send(request));
                }
            },
            // A stop that is for now does not wait for what comes with it.
            Request::Together(Together { together, at_s: None }) if together.iter().any(is_stop) => {
                drop(state);
                let (stops, others): (Vec<Request>, _) = together.into_iter().partition(is_stop);
                stops.into_iter().for_each(|stop| self.send(stop));
                self.send_together(others);
            }
            _ if self.kind == ClientKind::Page && state.controls != Some(self.number) => {
                let error = match state.controls {
                    Some(_) => "another page controls the motors: take control first",
                    None => "no page controls the motors: take control first",
                };
                state.answer(self.number, &RunLine::Error { error: error.to_owned() });
            }
            request => {
                let is_full = |state: &mut State| !state.is_over && !state.has_room(self.number, &request);
                let waited = self.hub.shared.changed.wait_while(state, is_full);
                waited.unwrap_or_else(PoisonError::into_inner).take(self.number, request);
            }
        }
    }

    /// Sends requests that came at the same time: they act as one.
    pub fn send_together(&self, requests: Vec<Request>) {
        if !requests.is_empty() {
            self.send(Request::together(requests, None));
        }
    }

    /// Does what lines of JSON say that came at the same time.
    pub fn lines<'a>(&self, lines: impl IntoIterator<Item = &'a [u8]>) {
        let mut requests = Vec::new();
        for line in lines {
            match ClientLine::read(line) {
                Ok(ClientLine::Request(request @ (Request::Session(_) | Request::Live(_)))) => requests.push(request),
                _ => {
                    self.send_together(std::mem::take(&mut requests));
                    self.line(line);
                }
            }
        }
        self.send_together(requests);
    }

    /// Does what a line of JSON says. If it says nothing, the client gets an error.
    pub fn line(&self, line: &[u8]) {
        match ClientLine::read(line) {
            Ok(ClientLine::Request(request)) => self.send(request),
            Ok(ClientLine::Follow(follows)) => self.follow(follows),
            Ok(ClientLine::Control(controls)) => self.control(controls),
            Err(error) => self.complain(error),
        }
    }

    /// Does what a line says that is too long for anything but a motion file.
    pub(crate) fn motion_line(&self, line: &[u8]) {
        match ClientLine::read(line) {
            Ok(ClientLine::Request(request)) if is_motion(&request) => self.send(request),
            Ok(_) => {
                self.complain(format!("a line has {LONGEST_LINE} bytes at most, except one with the command `motion`"))
            }
            // The error may have the line in it.
            Err(error) => self.complain(error.chars().take(MOST_OF_AN_ERROR).collect()),
        }
    }

    /// Whether the client gets each status.
    pub fn follow(&self, follows: bool) {
        if let Some(client) = self.hub.state().of(self.number) {
            client.follows = follows;
        }
    }

    /// Gives this page control, and takes it from the page that had it; or gives it up. Clients of other kinds control without it.
    pub fn control(&self, controls: bool) {
        if self.kind != ClientKind::Page {
            return self.complain("only pages take control: this client needs none".to_owned());
        }
        let mut state = self.hub.state();
        match controls {
            true => state.controls = Some(self.number),
            false if state.controls == Some(self.number) => state.controls = None,
            false => {}
        }
        state.tell_control();
    }

    /// Whether this client is the page that has control.
    pub(crate) fn has_control(&self) -> bool {
        self.hub.state().controls == Some(self.number)
    }

    /// Ends the client's lines: its writer does not wait for more.
    pub(crate) fn end_lines(&self) {
        if let Some(client) = self.hub.state().of(self.number) {
            client.lines = None;
        }
    }

    /// Sends the client an error.
    pub fn complain(&self, error: String) {
        self.hub.state().answer(self.number, &RunLine::Error { error });
    }

    /// The client's hub.
    #[must_use]
    pub fn hub(&self) -> &Hub {
        &self.hub
    }
}

fn is_motion(request: &Request) -> bool {
    matches!(request, Request::Live(LiveCommand::Motion { .. }))
}

fn is_stop(request: &Request) -> bool {
    matches!(request, Request::Session(Command::Stop | Command::StopNow))
}

impl Drop for HubSender {
    fn drop(&mut self) {
        let mut state = self.hub.state();
        if let Some(client) = state.of(self.number) {
            client.is_silent = true;
        }
        state.leave_control(self.number);
    }
}

/// The lines for a client. A client that drops it has left.
#[derive(Debug)]
pub struct HubLines {
    hub: Hub,
    number: u64,
    lines: Receiver<Arc<str>>,
    waiting: Arc<AtomicUsize>,
}

/// What came within a time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Next {
    /// A line, with its end.
    Line(Arc<str>),
    /// No line.
    Nothing,
    /// There are no more lines.
    End,
}

impl HubLines {
    /// Waits for the next line; `None` after the last.
    pub fn next_line(&self) -> Option<Arc<str>> {
        self.lines.recv().ok().inspect(|_| self.took())
    }

    /// Waits that long for the next line.
    pub fn next_within(&self, patience: Duration) -> Next {
        match self.lines.recv_timeout(patience) {
            Ok(line) => {
                self.took();
                Next::Line(line)
            }
            Err(RecvTimeoutError::Timeout) => Next::Nothing,
            Err(RecvTimeoutError::Disconnected) => Next::End,
        }
    }

    fn took(&self) {
        // Answers and the last line are not counted.
        let less = |waiting: usize| Some(waiting.saturating_sub(1));
        let _ = self.waiting.fetch_update(Ordering::Relaxed, Ordering::Relaxed, less);
    }
}

impl Drop for HubLines {
    fn drop(&mut self) {
        let mut state = self.hub.state();
        state.clients.retain(|client| client.number != self.number);
        state.leave_control(self.number);
        // The end of the run waits for this, and so may a request of this client.
        self.hub.shared.changed.notify_all();
    }
}

impl State {
    fn of(&mut self, number: u64) -> Option<&mut JoinedClient> {
        self.clients.iter_mut().find(|client| client.number == number)
    }

    /// Sends a client a line, if it is still there.
    fn answer(&mut self, number: u64, line: &impl Serialize) {
        if let Some(client) = self.of(number) {
            client.answer(line);
        }
    }

    fn tell(&mut self, line: &impl Serialize, is_status: bool) {
        if !self.clients.iter().any(|client| client.follows || !is_status) {
            return;
        }
        let Some(line) = line_of(line) else { return };
        self.clients.retain(|client| {
            let is_busy = client.waiting.load(Ordering::Relaxed) >= MOST_STATUSES;
            if is_status && (!client.follows || is_busy) {
                return true;
            }
            client.waiting.fetch_add(1, Ordering::Relaxed);
            // Without this line the client would take the run for another than it is: if it has no room, its queue ends.
            client.lines.as_ref().is_none_or(|lines| lines.try_send(Arc::clone(&line)).is_ok())
        });
    }

    fn stop(&mut self, command: Command) {
        let sent = if command == Command::Stop { &mut self.stop_sent } else { &mut self.stop_now_sent };
        if !std::mem::replace(sent, true) {
            self.pass_on(Request::Session(command));
        }
    }

    fn pass_on(&self, request: Request) {
        // The receivers live as long as the run.
        let _ = match (&self.sink, request) {
            (Sink::Run(commands), Request::Session(command)) => commands.send(command).is_ok(),
            (Sink::Live(requests), request) => requests.send(request).is_ok(),
            (Sink::Run(_), Request::Live(_) | Request::Together(_)) => false,
        };
    }

    /// Passes a request on, or lets it wait.
    fn take(&mut self, number: u64, request: Request) {
        if self.is_over {
            return;
        }
        if self.allowed > 0 && self.waiting.is_empty() {
            self.allowed = if is_motion(&request) { 0 } else { self.allowed - 1 };
            return self.pass_on(request);
        }
        match self.same_knob(number, &request) {
            Some(place) => self.waiting[place].1 = request,
            None => self.waiting.push_back((number, request)),
        }
    }

    /// Where a request waits for the same knob, of the same client, after which nothing but knobs comes: its value is out of date.
    fn same_knob(&self, number: u64, request: &Request) -> Option<usize> {
        let knob = |request: &Request| match request {
            Request::Live(LiveCommand::Set { knob, .. }) => Some(knob.clone()),
            _ => None,
        };
        let wanted = knob(request)?;
        let knobs = self.waiting.iter().enumerate().rev().map_while(|(place, (by, request))| {
            let knob = knob(request)?;
            Some((place, *by, knob))
        });
        let mut same = knobs.filter(|(_, _, knob)| *knob == wanted);
        // A later value of another client must not be overtaken.
        same.next().filter(|(_, by, _)| *by == number).map(|(place, ..)| place)
    }

    fn has_room(&self, number: u64, request: &Request) -> bool {
        // Of motion files one waits, since they may be large.
        if is_motion(request) && self.waiting.iter().any(|(_, request)| is_motion(request)) {
            return false;
        }
        self.waiting.iter().filter(|(by, _)| *by == number).count() < MOST_REQUESTS
            || self.same_knob(number, request).is_some()
    }

    fn looked(&mut self) {
        self.allowed = if matches!(self.sink, Sink::Run(_)) { 1 } else { LIVE_REQUESTS };
        while self.allowed > 0
            && let Some((_, request)) = self.waiting.pop_front()
        {
            self.allowed = if is_motion(&request) { 0 } else { self.allowed - 1 };
            self.pass_on(request);
        }
    }

    fn leave_control(&mut self, number: u64) {
        if self.controls == Some(number) {
            self.controls = None;
            self.tell_control();
        }
    }

    /// Tells the pages who controls.
    fn tell_control(&mut self) {
        let is_page = |client: &&JoinedClient| client.kind == ClientKind::Page;
        let pages = self.clients.iter().filter(is_page).count();
        let mut gone = Vec::new();
        for client in self.clients.iter().filter(is_page) {
            let yours = self.controls == Some(client.number);
            let control = ControlState { yours, taken: self.controls.is_some(), pages };
            if !client.answer(&RunLine::Control { control }) {
                gone.push(client.number);
            }
        }
        self.clients.retain(|client| !gone.contains(&client.number));
    }
}

impl JoinedClient {
    /// Sends it a line. False if it has no room for it.
    fn answer(&self, line: &impl Serialize) -> bool {
        let lines = self.lines.as_ref();
        lines.zip(line_of(line)).is_none_or(|(lines, line)| lines.try_send(line).is_ok())
    }
}

fn line_of(line: &impl Serialize) -> Option<Arc<str>> {
    serde_json::to_string(line).ok().map(|line| (line + "\n").into())
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;
    use crate::control_socket::{KnobInfo, KnobValue};
    use pulsetrain_session::control::Status;

    fn info(is_live: bool) -> RunInfo {
        let (name, target, unit) = ("speed".into(), "wheel.frequency".into(), "Hz".into());
        let knob = KnobInfo { name, target, unit, least: Some(0.0), greatest: Some(2.0), value: 1.0 };
        RunInfo { knobs: vec![knob], is_live, ..RunInfo::nothing() }
    }

    fn status() -> Event {
        Event::Status(Status { at_s: 0.5, lease_s: None, motors: Vec::new(), lateness: None })
    }

    fn set(value: f64) -> Request {
        Request::Live(LiveCommand::Set { knob: "speed".into(), value: KnobValue::Number(value) })
    }

    fn all(lines: &HubLines) -> Vec<String> {
        let now = std::iter::from_fn(|| match lines.next_within(Duration::ZERO) {
            Next::Line(line) => Some(line.trim_end().to_owned()),
            Next::Nothing | Next::End => None,
        });
        now.collect()
    }

    #[test]
    fn a_run_takes_a_command_for_each_look_and_a_stop_at_once() {
        let (sender, commands) = channel();
        let hub = Hub::of_run(info(false), sender);
        let client = hub.join(ClientKind::Socket).unwrap();
        client.send(Request::Session(Command::Pause));
        client.send(Request::Session(Command::Resume));
        assert_eq!(commands.try_iter().count(), 0);
        client.send(Request::Session(Command::Stop));
        client.send(Request::Session(Command::Stop));
        assert_eq!(commands.try_iter().collect::<Vec<_>>(), [Command::Stop]);
        assert!(hub.wants_stop());
        for expected in [Command::Pause, Command::Resume] {
            hub.tell(&status());
            assert_eq!(commands.try_iter().collect::<Vec<_>>(), [expected]);
        }
        client.send(Request::Live(LiveCommand::Go));
        let (_, lines) = client.split();
        let lines = all(&lines);
        assert!(lines.len() == 2 && lines[0].starts_with(r#"{"pulsetrain_control":1,"#), "{lines:?}");
        assert!(lines[1].starts_with(r#"{"event":"refused","command":{"command":"go"},"why":"this is a `run`;"#));
        assert_eq!(commands.try_iter().count(), 0);
    }

    /// Motion files may be large: of all clients' one waits, and the run takes one at a look.
    #[test]
    fn motion_files_are_taken_one_by_one() {
        let (sender, requests) = channel();
        let hub = Hub::of_live(info(true), sender);
        let clients = [(); 2].map(|()| hub.join(ClientKind::Socket).unwrap().split());
        let motion = |text: &str| {
            Request::Live(LiveCommand::Motion { text: text.into(), files: std::collections::BTreeMap::new() })
        };
        clients[0].0.send(motion("first"));
        assert!(!hub.state().has_room(clients[1].0.number, &motion("second")));
        assert!(hub.state().has_room(clients[1].0.number, &set(1.0)));
        hub.looked();
        assert!(hub.state().has_room(clients[1].0.number, &motion("second")));
        clients[1].0.send(motion("second"));
        assert_eq!(requests.try_iter().collect::<Vec<_>>(), [motion("first")], "one in a look");
        hub.looked();
        assert_eq!(requests.try_iter().collect::<Vec<_>>(), [motion("second")]);
    }

    #[test]
    fn lines_of_one_write_are_one_request_and_stops_go_at_once() {
        let (sender, requests) = channel();
        let hub = Hub::of_live(info(true), sender);
        let (client, lines) = hub.join(ClientKind::Socket).unwrap().split();
        let write: [&[u8]; 5] = [
            br#"{"command":"set","knob":"speed","value":1.0}"#,
            br#"{"command":"tempo","rate":0.5}"#,
            br#"{"command":"stop"}"#,
            b"nonsense",
            br#"{"command":"go"}"#,
        ];
        client.lines(write);
        assert_eq!(requests.try_iter().collect::<Vec<_>>(), [Request::Session(Command::Stop)]);
        assert!(all(&lines).last().unwrap().contains("no line of JSON"));
        hub.looked();
        let together = Request::together(vec![set(1.0), Request::Session(Command::Tempo { rate: 0.5 })], None);
        assert_eq!(requests.try_iter().collect::<Vec<_>>(), [together, Request::Live(LiveCommand::Go)]);

        // A `run` takes them one by one, and none for a time.
        let (sender, commands) = channel();
        let run = Hub::of_run(info(false), sender);
        let (client, lines) = run.join(ClientKind::Socket).unwrap().split();
        client.lines([&br#"{"command":"pause"}"#[..], br#"{"command":"resume"}"#]);
        client.line(br#"{"together":[{"command":"pause"}],"at_s":3.0}"#);
        assert!(all(&lines).last().unwrap().contains("this is a `run`"));
        run.looked();
        assert_eq!(commands.try_iter().collect::<Vec<_>>(), [Command::Pause]);
        run.looked();
        assert_eq!(commands.try_iter().collect::<Vec<_>>(), [Command::Resume]);
    }

    #[test]
    fn of_a_knob_that_waits_the_last_value_counts() {
        let (sender, requests) = channel();
        let hub = Hub::of_live(info(true), sender);
        let client = hub.join(ClientKind::Osc).unwrap();
        hub.looked();
        (0..LIVE_REQUESTS).for_each(|value| client.send(set(f64::from(value))));
        assert_eq!(requests.try_iter().count(), LIVE_REQUESTS as usize);
        // However many there are, the client's thread does not wait.
        (0..1000).for_each(|value| client.send(set(f64::from(value))));
        client.send(Request::Live(LiveCommand::Go));
        client.send(set(5.0));
        hub.looked();
        let go = Request::Live(LiveCommand::Go);
        assert_eq!(requests.try_iter().collect::<Vec<_>>(), [set(999.0), go, set(5.0)]);
        hub.tell_live(&LiveEvent::Set {
            knob: "speed".into(),
            value: 1.5,
            unit: "Hz".into(),
            ceiling: None,
            from_s: 1.0,
            until_s: 2.0,
        });
        assert_eq!(hub.info().knobs[0].value, 1.5, "later clients know it");
    }

    #[test]
    fn one_page_controls_and_all_may_stop() {
        let (sender, requests) = channel();
        let hub = Hub::of_live(info(true), sender);
        hub.looked();
        let (one, one_lines) = hub.join(ClientKind::Page).unwrap().split();
        let (other, other_lines) = hub.join(ClientKind::Page).unwrap().split();
        one.send(set(1.0));
        assert!(all(&one_lines).last().unwrap().contains("no page controls the motors"));
        one.line(br#"{"control":true}"#);
        assert_eq!(all(&one_lines), [r#"{"control":{"yours":true,"taken":true,"pages":2}}"#]);
        assert!(all(&other_lines).contains(&r#"{"control":{"yours":false,"taken":true,"pages":2}}"#.to_owned()));
        one.send(set(1.0));
        other.send(set(2.0));
        assert!(all(&other_lines)[0].contains("another page controls"));
        other.send(Request::Session(Command::Stop));
        let stop = Request::Session(Command::Stop);
        assert_eq!(requests.try_iter().collect::<Vec<_>>(), [set(1.0), stop]);
        // It is asked for, and so it changes hands.
        other.control(true);
        assert_eq!(all(&one_lines), [r#"{"control":{"yours":false,"taken":true,"pages":2}}"#]);
        one.send(set(3.0));
        assert_eq!(requests.try_iter().count(), 0);
        drop((other, other_lines));
        let free = r#"{"control":{"yours":false,"taken":false,"pages":2}}"#;
        assert!(all(&one_lines).contains(&free.to_owned()), "control is free again");
        let program = hub.join(ClientKind::Socket).unwrap();
        program.send(set(4.0));
        assert_eq!(requests.try_iter().collect::<Vec<_>>(), [set(4.0)], "a program of the same user needs no control");
    }

    #[test]
    fn a_client_that_takes_no_lines_loses_statuses_and_then_its_place() {
        let (sender, _commands) = channel();
        let hub = Hub::of_run(info(false), sender);
        let client = hub.join(ClientKind::Socket).unwrap();
        client.follow(true);
        (0..1000).for_each(|_| hub.tell(&status()));
        assert_eq!(hub.state().clients.len(), 1);
        (0..MOST_LINES).for_each(|_| hub.tell(&Event::Pausing { rests_s: 1.0 }));
        assert_eq!(hub.state().clients.len(), 0, "it is dropped");
        let (_, lines) = client.split();
        assert_eq!(all(&lines).len(), MOST_LINES);
        assert_eq!(lines.next_within(Duration::ZERO), Next::End);
    }

    #[test]
    fn each_kind_has_its_places_and_the_end_comes_last() {
        let (sender, _commands) = channel();
        let hub = Hub::of_run(info(false), sender);
        let mut pages: Vec<HubClient> = (0..MOST_CLIENTS).map(|_| hub.join(ClientKind::Page).unwrap()).collect();
        assert_eq!(hub.join(ClientKind::Page).unwrap_err(), JoinError::Full);
        hub.join(ClientKind::Socket).unwrap();
        // One that sends nothing more makes room.
        let (sender, lines) = pages.remove(0).split();
        drop(sender);
        pages.push(hub.join(ClientKind::Page).unwrap());
        let last = std::iter::from_fn(|| lines.next_line()).last().unwrap();
        assert!(last.contains("\"pages\""), "its queue has ended: {last}");
        let page = pages.pop().unwrap();
        drop((pages, lines));
        hub.close(Some(&RunEnded::failed("broken".to_owned())));
        assert_eq!(hub.join(ClientKind::Socket).unwrap_err(), JoinError::Over);
        let last = std::iter::from_fn(|| page.next_line()).last().unwrap();
        assert!(last.starts_with(r#"{"ended":"failed","why":"broken""#), "{last}");
        drop(page);
        hub.wait_for_clients();
        assert!(hub.is_over_within(Duration::ZERO));
    }
}
