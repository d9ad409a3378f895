//! The clients of a run: clients of every kind join, send commands and get lines. It knows no transport and no thread.
//!
//! The run publishes what happens, and never waits for a client: each has a bounded [`Outbox`] of lines, and one that takes none of them is dropped. A
//! client waits if it sends faster than the run takes.

use std::collections::VecDeque;
use std::sync::Arc;

use serde::Serialize;

use crate::command::{Batch, RunCommand};
use crate::event::RunEvent;
use crate::run_info::RunInfo;
use crate::run_line::{ControlState, RunEnded, RunLine};

/// Clients of a kind at a time. Each kind has places of its own, so that `pulsetrain stop` finds one however many pages are open.
pub const MAX_CLIENTS: usize = 16;
/// Lines that wait for a client. One that takes none of them is dropped.
pub const MAX_LINES: usize = 256;
/// Lines that wait for a client when statuses are left out: the rest is for events, which it must not miss.
const MAX_STATUSES: usize = 128;
/// Commands of a client that wait for the run. Then the client waits.
const MAX_WAITING: usize = 16;
/// Commands that a live motion takes for each of its looks. A run takes one.
pub const LIVE_COMMANDS: u32 = 8;

/// Why a `run` does not take a command of live motions.
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

/// Where a client's lines go.
pub trait Outbox: Send {
    /// Takes a line. A published line counts in [`waiting`](Outbox::waiting) until the client has taken it; answers to a client do not. False if there is no
    /// room for it.
    fn push(&mut self, line: &Arc<str>, is_published: bool) -> bool;

    /// Published lines that the client has not taken.
    fn waiting(&self) -> usize;
}

/// Where the commands of clients go. Lists for a time go to live motions alone.
pub type Deliver = Box<dyn FnMut(Batch) + Send>;

/// The clients of a run.
pub struct HubState {
    info: RunInfo,
    deliver: Deliver,
    clients: Vec<JoinedClient>,
    joined: u64,
    /// Batches that the run takes before it looks again.
    allowed: u32,
    /// Batches that wait, and who sent them.
    waiting: VecDeque<(u64, Batch)>,
    stop_sent: bool,
    stop_now_sent: bool,
    /// The page that controls.
    controls: Option<u64>,
    is_over: bool,
}

impl std::fmt::Debug for HubState {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let numbers: Vec<u64> = self.clients.iter().map(|client| client.number).collect();
        f.debug_struct("HubState").field("clients", &numbers).field("is_over", &self.is_over).finish_non_exhaustive()
    }
}

struct JoinedClient {
    number: u64,
    kind: ClientKind,
    /// `None` after the last line.
    outbox: Option<Box<dyn Outbox>>,
    follows: bool,
    /// It sends nothing more. Such clients make room for new ones.
    is_silent: bool,
}

/// Why a client cannot join.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum JoinError {
    /// All places for clients of its kind are taken.
    #[error("this run has {MAX_CLIENTS} clients already")]
    Full,
    /// The run has ended.
    #[error("this run has ended")]
    Over,
}

impl HubState {
    /// The clients of a run; none have joined. A live motion takes all commands, a `run` those of a session.
    #[must_use]
    pub fn new(info: RunInfo, deliver: Deliver) -> HubState {
        HubState {
            info,
            deliver,
            clients: Vec::new(),
            joined: 0,
            allowed: 0,
            waiting: VecDeque::new(),
            stop_sent: false,
            stop_now_sent: false,
            controls: None,
            is_over: false,
        }
    }

    /// A new client. Its first line is the [`RunInfo`]. Gives its number.
    ///
    /// # Errors
    /// If all places are taken, or the run is over.
    pub fn join(&mut self, kind: ClientKind, outbox: Box<dyn Outbox>) -> Result<u64, JoinError> {
        if self.is_over {
            return Err(JoinError::Over);
        }
        let of_kind = |client: &JoinedClient| client.kind == kind;
        let is_full = self.clients.iter().filter(|client| of_kind(client)).count() >= MAX_CLIENTS;
        if kind != ClientKind::Recorder && is_full {
            let silent = self.clients.iter().position(|client| of_kind(client) && client.is_silent);
            // Its outbox ends, and with it the connection.
            self.clients.remove(silent.ok_or(JoinError::Full)?);
        }
        self.joined += 1;
        let number = self.joined;
        let mut client = JoinedClient { number, kind, outbox: Some(outbox), follows: false, is_silent: false };
        client.answer(&self.info);
        self.clients.push(client);
        if kind == ClientKind::Page {
            self.publish_control();
        }
        Ok(number)
    }

    /// Sends the clients an event. A status says that the run has taken the commands that were sent to it, as [`HubState::looked`] does.
    pub fn publish(&mut self, event: &RunEvent) {
        let is_status = matches!(event, RunEvent::Status(_));
        if is_status {
            self.looked();
        }
        if let RunEvent::Set { knob, value, .. } = event
            && let Some(known) = self.info.knobs.iter_mut().find(|known| known.name == *knob)
        {
            known.value = *value;
        }
        // The run's last line says more than the last event.
        if !matches!(event, RunEvent::Progress { .. } | RunEvent::Ended(_) | RunEvent::Failed { .. }) {
            self.publish_line(event, is_status);
        }
    }

    /// Changes what is known of the run, such as its knobs and cues after a new motion file, and sends it to the clients.
    pub fn change_info(&mut self, change: impl FnOnce(&mut RunInfo)) {
        change(&mut self.info);
        let info = self.info.clone();
        self.publish_line(&info, false);
    }

    /// What is known of the run.
    #[must_use]
    pub fn info(&self) -> &RunInfo {
        &self.info
    }

    /// The run has taken the commands that were sent to it: others may come.
    pub fn looked(&mut self) {
        self.allowed = if self.info.is_live { LIVE_COMMANDS } else { 1 };
        while self.allowed > 0
            && let Some((_, batch)) = self.waiting.pop_front()
        {
            self.allowed = if is_motion(&batch) { 0 } else { self.allowed - 1 };
            (self.deliver)(batch);
        }
    }

    /// Whether it is that of a live motion, which takes all commands.
    #[must_use]
    pub fn is_live(&self) -> bool {
        self.info.is_live
    }

    /// Whether a client has asked for a stop.
    #[must_use]
    pub fn wants_stop(&self) -> bool {
        self.stop_sent || self.stop_now_sent
    }

    /// Whether the run is over.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.is_over
    }

    /// Whether no client is left.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.clients.is_empty()
    }

    /// The run is over: sends the clients how it ended, and ends their lines.
    pub fn close(&mut self, ended: Option<&RunEnded>) {
        self.is_over = true;
        self.waiting.clear();
        for client in &mut self.clients {
            if let Some(ended) = ended {
                client.answer(&RunLine::Ended(ended.clone()));
            }
            client.outbox = None;
        }
    }

    /// Takes a client's commands. A stop goes to the run at once, and only once. Others wait until the run has looked for commands again, so that they cannot
    /// pile up.
    ///
    /// # Errors
    /// What the client has to send again after the next look: too many of its commands wait.
    pub fn send(&mut self, number: u64, batch: Batch) -> Result<(), Batch> {
        if let Some(stop) = batch.single().filter(|command| command.is_stop()) {
            self.stop(stop.clone());
            return Ok(());
        }
        if !self.is_live() {
            return self.send_to_run(number, batch);
        }
        let mut batch = batch;
        // A stop that is for now does not wait for what comes with it.
        if batch.has_stop() {
            let (stops, others): (Vec<_>, Vec<_>) = batch.commands.into_iter().partition(RunCommand::is_stop);
            stops.into_iter().for_each(|stop| self.stop(stop));
            batch = Batch::now(others);
        }
        if batch.commands.is_empty() {
            return Ok(());
        }
        self.queue(number, batch)
    }

    /// Takes commands for a `run`, one by one and none for a time.
    fn send_to_run(&mut self, number: u64, batch: Batch) -> Result<(), Batch> {
        if batch.at_s.is_some() {
            self.answer(number, &RunLine::Error { error: NOT_LIVE.to_owned() });
            return Ok(());
        }
        let mut commands = VecDeque::from(batch.commands);
        while let Some(command) = commands.pop_front() {
            if command.is_stop() {
                self.stop(command);
            } else if command.of_session().is_none() {
                self.answer(number, &RunEvent::Refused { command, why: NOT_LIVE.to_owned() });
            } else if let Err(full) = self.queue(number, command.into()) {
                return Err(Batch::now(full.commands.into_iter().chain(commands).collect()));
            }
        }
        Ok(())
    }

    /// Takes commands that have no stop for now, if their client may send them.
    fn queue(&mut self, number: u64, batch: Batch) -> Result<(), Batch> {
        let is_page = self.clients.iter().any(|client| client.number == number && client.kind == ClientKind::Page);
        if is_page && self.controls != Some(number) {
            let error = match self.controls {
                Some(_) => "another page controls the motors: take control first",
                None => "no page controls the motors: take control first",
            };
            self.answer(number, &RunLine::Error { error: error.to_owned() });
            return Ok(());
        }
        if !self.is_over && !self.has_room(number, &batch) {
            return Err(batch);
        }
        self.take(number, batch);
        Ok(())
    }

    /// Whether a client gets each status.
    pub fn follow(&mut self, number: u64, follows: bool) {
        if let Some(client) = self.client(number) {
            client.follows = follows;
        }
    }

    /// Gives a page control, and takes it from the page that had it; or gives it up. Clients of other kinds control without it.
    pub fn control(&mut self, number: u64, controls: bool) {
        match self.client(number).map(|client| client.kind) {
            Some(ClientKind::Page) => {}
            Some(_) => return self.complain(number, "only pages take control: this client needs none".to_owned()),
            None => return,
        }
        match controls {
            true => self.controls = Some(number),
            false if self.controls == Some(number) => self.controls = None,
            false => {}
        }
        self.publish_control();
    }

    /// Whether a client is the page that has control.
    #[must_use]
    pub fn has_control(&self, number: u64) -> bool {
        self.controls == Some(number)
    }

    /// Sends a client an error.
    pub fn complain(&mut self, number: u64, error: String) {
        self.answer(number, &RunLine::Error { error });
    }

    /// Ends a client's lines: its writer does not wait for more.
    pub fn end_lines(&mut self, number: u64) {
        if let Some(client) = self.client(number) {
            client.outbox = None;
        }
    }

    /// A client sends nothing more. It still gets lines, but makes room for others.
    pub fn silence(&mut self, number: u64) {
        if let Some(client) = self.client(number) {
            client.is_silent = true;
        }
        self.leave_control(number);
    }

    /// A client takes no more lines: it has left.
    pub fn leave(&mut self, number: u64) {
        self.clients.retain(|client| client.number != number);
        self.leave_control(number);
    }

    fn client(&mut self, number: u64) -> Option<&mut JoinedClient> {
        self.clients.iter_mut().find(|client| client.number == number)
    }

    /// Sends a client a line, if it is still there.
    fn answer(&mut self, number: u64, line: &impl Serialize) {
        if let Some(client) = self.client(number) {
            client.answer(line);
        }
    }

    fn publish_line(&mut self, line: &impl Serialize, is_status: bool) {
        if !self.clients.iter().any(|client| client.follows || !is_status) {
            return;
        }
        let Some(line) = line_of(line) else { return };
        self.clients.retain_mut(|client| {
            let Some(outbox) = &mut client.outbox else { return true };
            let is_busy = outbox.waiting() >= MAX_STATUSES;
            if is_status && (!client.follows || is_busy) {
                return true;
            }
            // Without this line the client would take the run for another than it is: if it has no room, its lines end.
            outbox.push(&line, true)
        });
    }

    fn stop(&mut self, stop: RunCommand) {
        let sent = if stop == RunCommand::Stop { &mut self.stop_sent } else { &mut self.stop_now_sent };
        if !std::mem::replace(sent, true) {
            (self.deliver)(stop.into());
        }
    }

    /// Passes commands on, or lets them wait.
    fn take(&mut self, number: u64, batch: Batch) {
        if self.is_over {
            return;
        }
        if self.allowed > 0 && self.waiting.is_empty() {
            self.allowed = if is_motion(&batch) { 0 } else { self.allowed - 1 };
            return (self.deliver)(batch);
        }
        match self.same_knob(number, &batch) {
            Some(place) => self.waiting[place].1 = batch,
            None => self.waiting.push_back((number, batch)),
        }
    }

    /// Where the same knob waits, of the same client, after which nothing but knobs comes: its value is out of date.
    fn same_knob(&self, number: u64, batch: &Batch) -> Option<usize> {
        let knob = |batch: &Batch| match batch.single() {
            Some(RunCommand::Set { knob, .. }) => Some(knob.clone()),
            _ => None,
        };
        let wanted = knob(batch)?;
        let knobs = self.waiting.iter().enumerate().rev().map_while(|(place, (by, batch))| {
            let knob = knob(batch)?;
            Some((place, *by, knob))
        });
        let mut same = knobs.filter(|(_, _, knob)| *knob == wanted);
        // A later value of another client must not be overtaken.
        same.next().filter(|(_, by, _)| *by == number).map(|(place, ..)| place)
    }

    fn has_room(&self, number: u64, batch: &Batch) -> bool {
        // Of motion files one waits, since they may be large.
        if is_motion(batch) && self.waiting.iter().any(|(_, batch)| is_motion(batch)) {
            return false;
        }
        self.waiting.iter().filter(|(by, _)| *by == number).count() < MAX_WAITING
            || self.same_knob(number, batch).is_some()
    }

    fn leave_control(&mut self, number: u64) {
        if self.controls == Some(number) {
            self.controls = None;
            self.publish_control();
        }
    }

    /// Sends the pages who controls.
    fn publish_control(&mut self) {
        let is_page = |client: &JoinedClient| client.kind == ClientKind::Page;
        let pages = self.clients.iter().filter(|client| is_page(client)).count();
        let (controls, taken) = (self.controls, self.controls.is_some());
        self.clients.retain_mut(|client| {
            let control = ControlState { yours: controls == Some(client.number), taken, pages };
            !is_page(client) || client.answer(&RunLine::Control { control })
        });
    }
}

/// Whether it is a motion file, which may be large.
pub(crate) fn is_motion(batch: &Batch) -> bool {
    matches!(batch.single(), Some(RunCommand::Motion { .. }))
}

impl JoinedClient {
    /// Sends it a line. False if it has no room for it.
    fn answer(&mut self, line: &impl Serialize) -> bool {
        let outbox = self.outbox.as_mut();
        outbox.zip(line_of(line)).is_none_or(|(outbox, line)| outbox.push(&line, false))
    }
}

fn line_of(line: &impl Serialize) -> Option<Arc<str>> {
    serde_json::to_string(line).ok().map(|line| (line + "\n").into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::KnobValue;
    use std::sync::Mutex;

    /// The lines of a client that takes them when the test says so, with room for a few.
    #[derive(Clone, Default)]
    struct Kept(Arc<Mutex<Vec<Arc<str>>>>);

    impl Outbox for Kept {
        fn push(&mut self, line: &Arc<str>, _is_published: bool) -> bool {
            let mut lines = self.0.lock().unwrap();
            lines.push(Arc::clone(line));
            lines.len() <= MAX_LINES
        }

        fn waiting(&self) -> usize {
            self.0.lock().unwrap().len()
        }
    }

    fn hub(is_live: bool) -> (HubState, Arc<Mutex<Vec<Batch>>>) {
        let delivered = Arc::new(Mutex::new(Vec::new()));
        let to = Arc::clone(&delivered);
        let info = RunInfo { is_live, ..RunInfo::nothing() };
        (HubState::new(info, Box::new(move |batch| to.lock().unwrap().push(batch))), delivered)
    }

    fn set(value: f64) -> Batch {
        RunCommand::Set { knob: "speed".into(), value: KnobValue::Number(value) }.into()
    }

    #[test]
    fn a_client_whose_commands_wait_sends_them_again_after_the_next_look() {
        let (mut hub, delivered) = hub(true);
        let one = hub.join(ClientKind::Socket, Box::new(Kept::default())).unwrap();
        let go = || Batch::from(RunCommand::Go);
        let taken = (0..).take_while(|_| hub.send(one, go()).is_ok()).count();
        assert_eq!(taken, MAX_WAITING);
        assert_eq!(hub.send(one, go()), Err(go()));
        assert_eq!(hub.send(one, RunCommand::Stop.into()), Ok(()), "a stop does not wait");
        hub.looked();
        assert_eq!(delivered.lock().unwrap().len(), 1 + LIVE_COMMANDS as usize);
        assert_eq!(hub.send(one, go()), Ok(()));
        // Of a `run` each look takes one command, whatever came together.
        let (mut run, delivered) = self::hub(false);
        let one = run.join(ClientKind::Socket, Box::new(Kept::default())).unwrap();
        let pauses = Batch::now(vec![RunCommand::Pause; MAX_WAITING + 2]);
        assert_eq!(run.send(one, pauses), Err(Batch::now(vec![RunCommand::Pause; 2])));
        run.looked();
        assert_eq!(*delivered.lock().unwrap(), [RunCommand::Pause.into()]);
    }

    #[test]
    fn a_client_without_room_for_an_event_is_dropped_and_statuses_are_left_out_before() {
        let (mut hub, _) = hub(true);
        let lines = Kept::default();
        let one = hub.join(ClientKind::Socket, Box::new(lines.clone())).unwrap();
        hub.follow(one, true);
        let status = RunEvent::Status(pulsetrain_session::control::Status {
            at_s: 0.5,
            lease_s: None,
            motors: Vec::new(),
            lateness: None,
        });
        (0..1000).for_each(|_| hub.publish(&status));
        assert_eq!((lines.waiting(), hub.is_empty()), (MAX_STATUSES, false));
        (0..MAX_LINES).for_each(|_| hub.publish(&RunEvent::AlreadyRuns));
        assert!(hub.is_empty());
        assert_eq!(hub.send(one, set(1.0)), Ok(()), "its last commands still count");
    }
}
