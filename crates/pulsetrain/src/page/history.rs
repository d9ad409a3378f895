//! The last ten minutes of a run, for pages that come later.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};
use std::{io, thread};

use pulsetrain_session::control::Status;
use serde::Serialize;

use crate::control_socket::{Hub, HubLines, HubSender};
use crate::live::{ClientKind, RunEvent, RunLine};

/// How long a status is kept, s of the motion.
const KEPT_S: f64 = 600.0;
/// The most statuses that are kept: 20 a second.
const MOST_STATUSES: usize = 12_000;
/// The most events that are kept.
const MOST_EVENTS: usize = 200;
/// Statuses in a line.
const STATUSES_PER_LINE: usize = 600;

/// What was told in the last ten minutes.
#[derive(Debug, Default)]
pub(super) struct History {
    statuses: VecDeque<KeptStatus>,
    /// Events as they were told, and when.
    events: VecDeque<serde_json::Value>,
}

#[derive(Debug)]
struct KeptStatus {
    at_s: f64,
    lease_s: Option<f32>,
    motors: Box<[KeptMotor]>,
}

/// A motor as it was. NaN: not known.
#[derive(Clone, Copy, Debug)]
struct KeptMotor {
    position: f64,
    target: f64,
    speed: f32,
}

/// A line of the history: a column for each quantity, and in it one for each motor.
#[derive(Serialize)]
struct HistoryLine {
    history: Columns,
}

#[derive(Default, Serialize)]
struct Columns {
    at_s: Vec<f64>,
    lease_s: Vec<Option<f32>>,
    position: Vec<Vec<f64>>,
    target: Vec<Vec<Option<f64>>>,
    speed: Vec<Vec<Option<f32>>>,
}

#[derive(Serialize)]
struct PastEvents<'p> {
    past: Vec<&'p serde_json::Value>,
    /// Whether there is a log to download.
    log: bool,
}

impl History {
    /// Keeps what a hub tells from now on, in a thread of its own. It ends with the run.
    pub(super) fn keep(hub: &Hub) -> io::Result<Arc<Mutex<History>>> {
        let history = Arc::new(Mutex::default());
        // A run that is over has none.
        let Ok(client) = hub.join(ClientKind::Recorder) else { return Ok(history) };
        client.follow(true);
        let (sender, lines) = client.split();
        let kept = Arc::clone(&history);
        thread::Builder::new().name("page history".into()).spawn(move || listen(&sender, &lines, &kept))?;
        Ok(history)
    }

    fn status(&mut self, status: &Status) {
        let motor = |motor: &pulsetrain_session::control::MotorStatus| KeptMotor {
            position: motor.position as f64,
            target: motor.target.unwrap_or(f64::NAN),
            speed: motor.speed.unwrap_or(f64::NAN) as f32,
        };
        let motors = status.motors.iter().map(motor).collect();
        let lease_s = status.lease_s.map(|lease_s| lease_s as f32);
        self.statuses.push_back(KeptStatus { at_s: status.at_s, lease_s, motors });
        let is_old = |kept: &KeptStatus| kept.at_s < status.at_s - KEPT_S;
        while self.statuses.len() > MOST_STATUSES || self.statuses.front().is_some_and(is_old) {
            self.statuses.pop_front();
        }
    }

    fn event(&mut self, line: &str) {
        if self.events.len() >= MOST_EVENTS {
            self.events.pop_front();
        }
        let Ok(mut event) = serde_json::from_str::<serde_json::Value>(line) else { return };
        // Not all events say when they came.
        if let (Some(fields), Some(last)) = (event.as_object_mut(), self.statuses.back()) {
            fields.entry("at_s").or_insert_with(|| last.at_s.into());
        }
        self.events.push_back(event);
    }

    /// The history as lines of JSON. `log`: whether there is one to download.
    pub(super) fn lines(&self, log: bool) -> Vec<String> {
        let mut lines = Vec::new();
        let mut columns = Columns::default();
        let mut flush = |columns: &mut Columns| {
            if !columns.at_s.is_empty() {
                lines.extend(serde_json::to_string(&HistoryLine { history: std::mem::take(columns) }));
            }
        };
        for kept in &self.statuses {
            // A changed motion file may have other motors.
            if columns.at_s.len() >= STATUSES_PER_LINE || columns.position.len() != kept.motors.len() {
                flush(&mut columns);
                columns.position.resize(kept.motors.len(), Vec::new());
                columns.target.resize(kept.motors.len(), Vec::new());
                columns.speed.resize(kept.motors.len(), Vec::new());
            }
            columns.at_s.push(kept.at_s);
            columns.lease_s.push(kept.lease_s);
            for (place, motor) in kept.motors.iter().enumerate() {
                let known = |value: f64| value.is_finite().then(|| (value * 100.0).round() / 100.0);
                columns.position[place].push(motor.position);
                columns.target[place].push(known(motor.target));
                columns.speed[place].push(motor.speed.is_finite().then_some(motor.speed));
            }
        }
        flush(&mut columns);
        lines.extend(serde_json::to_string(&PastEvents { past: self.events.iter().collect(), log }));
        lines
    }
}

/// `sender` is kept, since a client without it makes room for others.
fn listen(sender: &HubSender, lines: &HubLines, history: &Mutex<History>) {
    while let Some(line) = lines.next_line() {
        let read = serde_json::from_str::<RunLine>(&line);
        let mut history = history.lock().unwrap_or_else(PoisonError::into_inner);
        match read {
            Ok(RunLine::Event(RunEvent::Status(status))) => history.status(&status),
            Ok(RunLine::Event(_) | RunLine::Ended(_)) => history.event(&line),
            Ok(RunLine::Info(_) | RunLine::Control { .. } | RunLine::Error { .. }) | Err(_) => {}
        }
    }
    sender.follow(false);
}

#[cfg(test)]
mod tests {
    use super::*;
    use pulsetrain_session::control::MotorStatus;

    fn status(at_s: f64) -> Status {
        let motor = MotorStatus { position: 3, target: Some(3.125), speed: None, queue: (1, 2) };
        Status { at_s, lease_s: Some(0.5), motors: vec![motor], lateness: None }
    }

    #[test]
    fn ten_minutes_are_kept() {
        let mut history = History::default();
        history.event("{\"event\":\"pausing\",\"rests_s\":1.0}\n");
        history.status(&status(0.0));
        let one = r#"{"history":{"at_s":[0.0],"lease_s":[0.5],"position":[[3.0]],"target":[[3.13]],"speed":[[null]]}}"#;
        assert_eq!(history.lines(false), [one, r#"{"past":[{"event":"pausing","rests_s":1.0}],"log":false}"#]);
        (1..20_000).for_each(|twentieth| history.status(&status(f64::from(twentieth) / 20.0)));
        let lines = history.lines(false);
        assert_eq!((history.statuses.len(), lines.len()), (MOST_STATUSES, 21));
        assert!(lines[0].starts_with(r#"{"history":{"at_s":[400.0,"#), "{}", &lines[0][..40]);
        // At another tempo there are fewer of them.
        (0..100).for_each(|second| history.status(&status(2000.0 + f64::from(second) * 10.0)));
        assert_eq!(history.statuses.len(), 61);
        (0..1000).for_each(|_| history.event("{}"));
        assert_eq!(history.events.len(), MOST_EVENTS);
    }
}
