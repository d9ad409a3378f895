//! The hub of a run: its clients of every kind, each with threads of its own. It knows no transport.
//!
//! [`HubState`] says who may do what. This is the same behind a lock: the run's thread never waits for a client, and a client's thread waits if it sends
//! faster than the run takes.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, sync_channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use pulsetrain_live::hub::{HubState, MAX_LINES, Outbox};
use pulsetrain_live::run_line::{ClientLine, MAX_LINE_BYTES};
use pulsetrain_session::control::Command;

use crate::live::{Batch, ClientKind, JoinError, RunCommand, RunEnded, RunEvent, RunInfo};

/// Characters of an error about a line that may be long.
const MAX_ERROR_CHARS: usize = 400;
/// How long the end of a run waits for its clients.
pub(super) const PATIENCE: Duration = Duration::from_secs(1);
/// How long a line with a motion file may take, however steadily it comes: the long lines of other clients wait for its end.
pub(crate) const LONG_LINE_TIME: Duration = Duration::from_secs(30);

/// A run's hub. Clones are the same hub.
#[derive(Clone, Debug)]
pub struct Hub {
    shared: Arc<Shared>,
}

#[derive(Debug)]
struct Shared {
    state: Mutex<HubState>,
    changed: Condvar,
    /// A moment of the time of day, and the motion's time then, s.
    clock: Mutex<Option<(Instant, f64)>>,
    /// Who holds it reads a line with a motion file.
    long_line: Mutex<()>,
}

/// A client's lines, for the thread that writes them.
struct LineChannel {
    lines: SyncSender<Arc<str>>,
    /// How many published lines it has not taken.
    waiting: Arc<AtomicUsize>,
}

impl Outbox for LineChannel {
    fn push(&mut self, line: &Arc<str>, is_published: bool) -> bool {
        self.waiting.fetch_add(usize::from(is_published), Ordering::Relaxed);
        self.lines.try_send(Arc::clone(line)).is_ok()
    }

    fn waiting(&self) -> usize {
        self.waiting.load(Ordering::Relaxed)
    }
}

impl Hub {
    /// The hub of a `run`, which takes the commands of a session.
    #[must_use]
    pub fn of_run(info: RunInfo, commands: Sender<Command>) -> Hub {
        // The receiver lives as long as the run.
        let deliver = move |batch: Batch| {
            let of_session = batch.commands.iter().filter_map(RunCommand::of_session);
            of_session.for_each(|command| {
                let _ = commands.send(command);
            });
        };
        Hub::new(HubState::new(info, Box::new(deliver)))
    }

    /// The hub of a live motion, which takes all commands.
    #[must_use]
    pub fn of_live(info: RunInfo, commands: Sender<Batch>) -> Hub {
        Hub::new(HubState::new(info, Box::new(move |batch| drop(commands.send(batch)))))
    }

    fn new(state: HubState) -> Hub {
        let (state, changed) = (Mutex::new(state), Condvar::new());
        Hub { shared: Arc::new(Shared { state, changed, clock: Mutex::new(None), long_line: Mutex::new(()) }) }
    }

    fn state(&self) -> MutexGuard<'_, HubState> {
        self.shared.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A new client. Its first line is the [`RunInfo`].
    ///
    /// # Errors
    /// If all places are taken, or the run is over.
    pub fn join(&self, kind: ClientKind) -> Result<HubClient, JoinError> {
        let (sender, lines) = sync_channel(MAX_LINES);
        let waiting = Arc::new(AtomicUsize::new(0));
        let outbox = LineChannel { lines: sender, waiting: Arc::clone(&waiting) };
        let number = self.state().join(kind, Box::new(outbox))?;
        let lines = HubLines { hub: self.clone(), number, lines, waiting };
        Ok(HubClient { sender: HubSender { hub: self.clone(), number }, lines })
    }

    /// Sends the clients an event. It never waits for them.
    pub fn publish(&self, event: &RunEvent) {
        self.state().publish(event);
        if matches!(event, RunEvent::Status(_)) {
            self.shared.changed.notify_all();
        }
    }

    /// Changes what is known of the run, such as its knobs and cues after a new motion file, and sends it to the clients.
    pub fn change_info(&self, change: impl FnOnce(&mut RunInfo)) {
        self.state().change_info(change);
    }

    /// What is known of the run.
    #[must_use]
    pub fn info(&self) -> RunInfo {
        self.state().info().clone()
    }

    /// The run has taken the commands that were sent to it: others may come. Each status that it publishes says the same.
    pub fn looked(&self) {
        self.state().looked();
        self.shared.changed.notify_all();
    }

    /// Notes the motion's time at a moment, s: what is asked for a time of day needs it.
    pub fn set_clock(&self, moment: Instant, at_s: f64) {
        *self.shared.clock.lock().unwrap_or_else(PoisonError::into_inner) = Some((moment, at_s));
    }

    /// The motion's time at a moment, s, 0 at least; `None` if it is not known.
    #[must_use]
    pub fn time_at(&self, moment: Instant) -> Option<f64> {
        let (known, at_s) = (*self.shared.clock.lock().unwrap_or_else(PoisonError::into_inner))?;
        let since_s = match moment.checked_duration_since(known) {
            Some(after) => after.as_secs_f64(),
            None => -known.saturating_duration_since(moment).as_secs_f64(),
        };
        Some((at_s + since_s).max(0.0))
    }

    /// Whether it is that of a live motion, which takes all commands.
    #[must_use]
    pub fn is_live(&self) -> bool {
        self.state().is_live()
    }

    /// Waits until no other client reads a line with a motion file. So their memory is that of one.
    pub(crate) fn long_line(&self) -> MutexGuard<'_, ()> {
        self.shared.long_line.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether a client has asked for a stop. A run that has much to do may ask this first.
    #[must_use]
    pub fn wants_stop(&self) -> bool {
        self.state().wants_stop()
    }

    /// Waits that long, or until the run is over. Whether it is.
    #[must_use]
    pub fn is_over_within(&self, patience: Duration) -> bool {
        let waited = self.shared.changed.wait_timeout_while(self.state(), patience, |state| !state.is_over());
        waited.unwrap_or_else(PoisonError::into_inner).0.is_over()
    }

    /// Sends the clients how the run ended, and waits a second at most until they have taken it.
    pub fn end(&self, ended: &RunEnded) {
        self.close(Some(ended));
        self.wait_for_clients();
    }

    /// Ends the clients' lines.
    pub(super) fn close(&self, ended: Option<&RunEnded>) {
        self.state().close(ended);
        self.shared.changed.notify_all();
    }

    pub(super) fn wait_for_clients(&self) {
        let is_there = |state: &mut HubState| !state.is_empty();
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
    /// Sends commands, as [`HubSender::send`] does.
    pub fn send(&self, batch: impl Into<Batch>) {
        self.sender.send(batch);
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
}

impl HubSender {
    /// Sends commands that act as one. A stop goes at once, and only once. Others wait until the run has looked for commands again, so that they cannot pile
    /// up. If too many of this client wait, so does its thread.
    pub fn send(&self, batch: impl Into<Batch>) {
        let mut state = self.hub.state();
        let mut left = state.send(self.number, batch.into());
        while let Err(batch) = left {
            state = self.hub.shared.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
            left = state.send(self.number, batch);
        }
    }

    /// Sends commands that came at the same time: they act as one.
    pub fn send_together(&self, commands: Vec<RunCommand>) {
        if !commands.is_empty() {
            self.send(Batch::now(commands));
        }
    }

    /// Does what lines of JSON say that came at the same time.
    pub fn lines<'a>(&self, lines: impl IntoIterator<Item = &'a [u8]>) {
        let mut commands = Vec::new();
        for line in lines {
            match ClientLine::read(line) {
                Ok(ClientLine::Batch(batch)) if batch.single().is_some() => commands.extend(batch.commands),
                _ => {
                    self.send_together(std::mem::take(&mut commands));
                    self.line(line);
                }
            }
        }
        self.send_together(commands);
    }

    /// Does what a line of JSON says. If it says nothing, the client gets an error.
    pub fn line(&self, line: &[u8]) {
        match ClientLine::read(line) {
            Ok(ClientLine::Batch(batch)) => self.send(batch),
            Ok(ClientLine::Follow(follows)) => self.follow(follows),
            Ok(ClientLine::Control(controls)) => self.control(controls),
            Err(error) => self.complain(error),
        }
    }

    /// Does what a line says that is too long for anything but a motion file.
    pub(crate) fn motion_line(&self, line: &[u8]) {
        match ClientLine::read(line) {
            Ok(ClientLine::Batch(batch)) if matches!(batch.single(), Some(RunCommand::Motion { .. })) => {
                self.send(batch);
            }
            Ok(_) => self
                .complain(format!("a line has {MAX_LINE_BYTES} bytes at most, except one with the command `motion`")),
            // The error may have the line in it.
            Err(error) => self.complain(error.chars().take(MAX_ERROR_CHARS).collect()),
        }
    }

    /// Whether the client gets each status.
    pub fn follow(&self, follows: bool) {
        self.hub.state().follow(self.number, follows);
    }

    /// Gives this page control, and takes it from the page that had it; or gives it up. Clients of other kinds control without it.
    pub fn control(&self, controls: bool) {
        self.hub.state().control(self.number, controls);
    }

    /// Whether this client is the page that has control.
    pub(crate) fn has_control(&self) -> bool {
        self.hub.state().has_control(self.number)
    }

    /// Ends the client's lines: its writer does not wait for more.
    pub(crate) fn end_lines(&self) {
        self.hub.state().end_lines(self.number);
    }

    /// Sends the client an error.
    pub fn complain(&self, error: String) {
        self.hub.state().complain(self.number, error);
    }

    /// The client's hub.
    #[must_use]
    pub fn hub(&self) -> &Hub {
        &self.hub
    }
}

impl Drop for HubSender {
    fn drop(&mut self) {
        self.hub.state().silence(self.number);
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
        self.hub.state().leave(self.number);
        // The end of the run waits for this, and so may a command of this client.
        self.hub.shared.changed.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;
    use crate::live::{KnobInfo, KnobValue};
    use pulsetrain_live::hub::{LIVE_COMMANDS, MAX_CLIENTS};
    use pulsetrain_session::control::Status;

    fn info(is_live: bool) -> RunInfo {
        let (name, target, unit) = ("speed".into(), "wheel.frequency".into(), "Hz".into());
        let knob = KnobInfo { name, target, unit, least: Some(0.0), greatest: Some(2.0), value: 1.0 };
        RunInfo { knobs: vec![knob], is_live, ..RunInfo::nothing() }
    }

    fn status() -> RunEvent {
        RunEvent::Status(Status { at_s: 0.5, lease_s: None, motors: Vec::new(), lateness: None })
    }

    fn set(value: f64) -> RunCommand {
        RunCommand::Set { knob: "speed".into(), value: KnobValue::Number(value) }
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
        client.send(RunCommand::Pause);
        client.send(RunCommand::Resume);
        assert_eq!(commands.try_iter().count(), 0);
        client.send(RunCommand::Stop);
        client.send(RunCommand::Stop);
        assert_eq!(commands.try_iter().collect::<Vec<_>>(), [Command::Stop]);
        assert!(hub.wants_stop());
        for expected in [Command::Pause, Command::Resume] {
            hub.publish(&status());
            assert_eq!(commands.try_iter().collect::<Vec<_>>(), [expected]);
        }
        client.send(RunCommand::Go);
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
        let motion = |text: &str| RunCommand::Motion { text: text.into(), files: std::collections::BTreeMap::new() };
        clients[0].0.send(motion("first"));
        let number = clients[1].0.number;
        assert_eq!(hub.state().send(number, motion("second").into()), Err(motion("second").into()));
        hub.looked();
        clients[1].0.send(motion("second"));
        assert_eq!(requests.try_iter().collect::<Vec<_>>(), [motion("first")].map(Batch::from), "one in a look");
        hub.looked();
        assert_eq!(requests.try_iter().collect::<Vec<_>>(), [motion("second")].map(Batch::from));
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
        assert_eq!(requests.try_iter().collect::<Vec<_>>(), [RunCommand::Stop].map(Batch::from));
        assert!(all(&lines).last().unwrap().contains("no line of JSON"));
        hub.looked();
        let together = Batch::now(vec![set(1.0), RunCommand::Tempo { rate: 0.5 }]);
        assert_eq!(requests.try_iter().collect::<Vec<_>>(), [together, RunCommand::Go.into()]);

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
        (0..LIVE_COMMANDS).for_each(|value| client.send(set(f64::from(value))));
        assert_eq!(requests.try_iter().count(), LIVE_COMMANDS as usize);
        // However many there are, the client's thread does not wait.
        (0..1000).for_each(|value| client.send(set(f64::from(value))));
        client.send(RunCommand::Go);
        client.send(set(5.0));
        hub.looked();
        let go = RunCommand::Go;
        assert_eq!(requests.try_iter().collect::<Vec<_>>(), [set(999.0), go, set(5.0)].map(Batch::from));
        hub.publish(&RunEvent::Set {
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
        other.send(RunCommand::Stop);
        let stop = RunCommand::Stop;
        assert_eq!(requests.try_iter().collect::<Vec<_>>(), [set(1.0), stop].map(Batch::from));
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
        assert_eq!(
            requests.try_iter().collect::<Vec<_>>(),
            [set(4.0)].map(Batch::from),
            "a program of the same user needs no control"
        );
    }

    #[test]
    fn a_client_that_takes_no_lines_loses_statuses_and_then_its_place() {
        let (sender, _commands) = channel();
        let hub = Hub::of_run(info(false), sender);
        let client = hub.join(ClientKind::Socket).unwrap();
        client.follow(true);
        (0..1000).for_each(|_| hub.publish(&status()));
        assert!(!hub.state().is_empty());
        (0..MAX_LINES).for_each(|_| hub.publish(&RunEvent::Pausing { rests_s: 1.0 }));
        assert!(hub.state().is_empty(), "it is dropped");
        let (_, lines) = client.split();
        assert_eq!(all(&lines).len(), MAX_LINES);
        assert_eq!(lines.next_within(Duration::ZERO), Next::End);
    }

    #[test]
    fn each_kind_has_its_places_and_the_end_comes_last() {
        let (sender, _commands) = channel();
        let hub = Hub::of_run(info(false), sender);
        let mut pages: Vec<HubClient> = (0..MAX_CLIENTS).map(|_| hub.join(ClientKind::Page).unwrap()).collect();
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
