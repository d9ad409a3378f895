//! What clients ask of a motion that runs, in the order in which it is obeyed.
//!
//! Requests that wait behind each other become one change. The motion of a delta robot takes long to read, so another thread reads it before the
//! motion is asked for it: meanwhile the board gets its plan, and orders such as a stop are obeyed at once.

use super::{Desk, LiveCommand, Request, Together};
use pulsetrain_motion::file::MOST_OF_A_MOTION_FILE;
use pulsetrain_motion::machine::Kinematics;
use pulsetrain_session::control::Command;
use std::collections::VecDeque;
use std::sync::mpsc::{Receiver, TryRecvError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// Requests that become one change, at most.
pub(crate) const MOST_REQUESTS: u32 = 32;

/// The requests that the motion has not been asked for yet.
#[derive(Debug, Default)]
pub(crate) struct Incoming {
    /// What came first.
    waiting: VecDeque<Request>,
    /// Knobs whose motion another thread reads.
    reading: Option<(Request, JoinHandle<()>)>,
}

impl Incoming {
    /// The next request for the motion, waiting for one as long as that. It comes with those that wait behind it.
    pub(crate) fn next(&mut self, requests: &Receiver<Request>, wait: Duration, desk: &Desk) -> Option<Request> {
        if let Some((request, _)) = self.reading.take_if(|(_, thread)| thread.is_finished()) {
            return Some(request);
        }
        if self.reading.is_some() {
            if let Some(stop) = self.waiting_stop() {
                return Some(stop);
            }
            let request = next_request(requests, wait)?;
            if matches!(request, Request::Session(_)) || has_stop(&request) {
                return Some(request);
            }
            self.waiting.push_back(request);
            return None;
        }
        let first = self.waiting.pop_front().or_else(|| next_request(requests, wait))?;
        let request = self.with_waiting(first, requests);
        if !takes_long(desk, &request) {
            return Some(request);
        }
        let (desk, to_read) = (desk.clone(), request.clone());
        self.reading = Some((request, thread::spawn(move || read(desk, to_read))));
        self.waiting_stop()
    }

    /// Takes the first request with a stop out of those that wait.
    fn waiting_stop(&mut self) -> Option<Request> {
        let place = self.waiting.iter().position(has_stop)?;
        self.waiting.remove(place)
    }

    /// Whether a stop that is to be obeyed at once is among the requests that have come.
    pub(crate) fn stop_waits(&mut self, requests: &Receiver<Request>) -> bool {
        self.waiting.extend(requests.try_iter());
        self.waiting.iter().any(has_stop)
    }

    /// The next request while there is no board. The motion of a knob need not be read first.
    pub(crate) fn next_without_board(&mut self, requests: &Receiver<Request>, wait: Duration) -> Option<Request> {
        let read = self.reading.take().map(|(request, _)| request);
        read.or_else(|| self.waiting.pop_front()).or_else(|| next_request(requests, wait))
    }

    /// A request, with those that wait behind it.
    fn with_waiting(&mut self, request: Request, requests: &Receiver<Request>) -> Request {
        let is_one = |request: &Request| !matches!(request, Request::Together(Together { at_s: Some(_), .. }));
        if !is_one(&request) {
            return request;
        }
        let mut all = request.each();
        while all.len() < MOST_REQUESTS as usize {
            let Some(next) = self.waiting.pop_front().or_else(|| requests.try_recv().ok()) else { break };
            if !is_one(&next) {
                self.waiting.push_front(next);
                break;
            }
            all.extend(next.each());
        }
        Request::together(all, None)
    }
}

/// The next request, waiting for one as long as that.
fn next_request(requests: &Receiver<Request>, wait: Duration) -> Option<Request> {
    match requests.try_recv() {
        Ok(request) => return Some(request),
        Err(TryRecvError::Empty) if !wait.is_zero() => {}
        Err(_) => return None,
    }
    requests.recv_timeout(wait).ok()
}

/// Whether a stop that is to be obeyed at once is among what a request asks for.
pub(crate) fn has_stop(request: &Request) -> bool {
    let is_timed = matches!(request, Request::Together(Together { at_s: Some(_), .. }));
    let is_stop = |request: Request| matches!(request, Request::Session(Command::Stop | Command::StopNow));
    !is_timed && request.clone().each().into_iter().any(is_stop)
}

/// Whether a request has a changed file, or turns knobs, and nothing else, of a motion that takes long to read. Stops must not wait for it, and the
/// board gets its plan meanwhile.
fn takes_long(desk: &Desk, request: &Request) -> bool {
    let is_file = |request: &Request| matches!(request, Request::Live(LiveCommand::Motion { .. }));
    if request.clone().each().iter().any(is_file) {
        return true;
    }
    let is_knob = |request: &Request| matches!(request, Request::Live(LiveCommand::Set { .. }));
    desk.setup().machines.iter().any(|machine| matches!(machine.kinematics, Kinematics::Delta { .. }))
        && request.clone().each().iter().all(is_knob)
}

/// Reads the motion that is asked for. The desk keeps it for [`Desk::program`] and [`Desk::with_file`].
fn read(mut desk: Desk, request: Request) {
    for request in request.each() {
        match request {
            Request::Live(LiveCommand::Set { knob, value }) => {
                if let Ok(turn) = desk.turn(&knob, &value) {
                    desk = desk.turned(&turn, turn.to);
                }
            }
            Request::Live(LiveCommand::Motion { text, files }) if text.len() as u64 <= MOST_OF_A_MOTION_FILE => {
                if let Some(changed) = desk.read_ahead(&text, &files) {
                    desk = changed;
                }
            }
            _ => {}
        }
    }
    // What is wrong with it is said when the motion is asked for it.
    let _ = desk.program();
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::live::KnobValue;
    use pulsetrain_session::prepare::Prepared;
    use std::path::PathBuf;
    use std::sync::mpsc::channel;

    const DELTA: &str = include_str!("../../../../examples/delta.toml");

    fn desk(text: &str) -> Desk {
        let (mut desk, contents) = Desk::of(text, "m.toml", PathBuf::new(), None, Some(Default::default())).unwrap();
        desk.set_up(&Prepared::new("m.toml".to_owned(), contents, None).unwrap().program);
        desk
    }

    fn set(value: f64) -> Request {
        Request::Live(LiveCommand::Set { knob: "robot.r".to_owned(), value: KnobValue::Number(value) })
    }

    /// The next request, as soon as what is read is there.
    fn next(incoming: &mut Incoming, requests: &Receiver<Request>, desk: &Desk) -> Request {
        loop {
            if let Some(request) = incoming.next(requests, Duration::ZERO, desk) {
                return request;
            }
            thread::yield_now();
        }
    }

    #[test]
    fn a_stop_does_not_wait_until_a_robots_motion_is_read() {
        let (sender, requests) = channel();
        let (mut incoming, desk) = (Incoming::default(), desk(DELTA));
        sender.send(set(30.0)).unwrap();
        assert_eq!(incoming.next(&requests, Duration::ZERO, &desk), None);
        // It is being read until it was asked for again.
        let (request, thread) = incoming.reading.take().unwrap();
        thread.join().unwrap();
        let (end, wait) = channel::<()>();
        incoming.reading = Some((request, thread::spawn(move || assert!(wait.recv().is_err()))));
        sender.send(set(31.0)).unwrap();
        sender.send(Request::Session(Command::Stop)).unwrap();
        assert_eq!(incoming.next(&requests, Duration::ZERO, &desk), None);
        assert_eq!(incoming.next(&requests, Duration::ZERO, &desk), Some(Request::Session(Command::Stop)));
        let with_knob = Request::together(vec![set(29.0), Request::Session(Command::Stop)], None);
        sender.send(with_knob.clone()).unwrap();
        assert_eq!(incoming.next(&requests, Duration::ZERO, &desk), Some(with_knob));
        // A stop for a later time waits, but not if the board is lost.
        let timed = Request::together(vec![Request::Session(Command::Stop)], Some(9.0));
        sender.send(timed.clone()).unwrap();
        assert_eq!(incoming.next(&requests, Duration::ZERO, &desk), None);
        // Nor one that came while the nearest value of another knob was searched.
        assert!(!incoming.stop_waits(&requests));
        sender.send(Request::Session(Command::StopNow)).unwrap();
        assert!(incoming.stop_waits(&requests) && requests.try_recv().is_err());
        assert_eq!(incoming.next(&requests, Duration::ZERO, &desk), Some(Request::Session(Command::StopNow)));
        assert!(!incoming.stop_waits(&requests));
        // Behind a knob that takes long to read and a request for a later time, neither of which it may be joined with.
        let mut behind = Incoming::default();
        let all = [set(33.0), timed.clone(), Request::Session(Command::Stop)];
        all.into_iter().for_each(|request| sender.send(request).unwrap());
        assert!(behind.stop_waits(&requests));
        assert_eq!(behind.next(&requests, Duration::ZERO, &desk), Some(Request::Session(Command::Stop)));
        let mut away = Incoming { waiting: incoming.waiting.clone(), reading: None };
        assert_eq!(away.next_without_board(&requests, Duration::ZERO), Some(set(31.0)));
        assert_eq!(away.next_without_board(&requests, Duration::ZERO), Some(timed));
        incoming.waiting.pop_back();
        drop(end);
        assert_eq!(next(&mut incoming, &requests, &desk), set(30.0));
        // What came behind is one change.
        sender.send(set(32.0)).unwrap();
        assert_eq!(next(&mut incoming, &requests, &desk), Request::together(vec![set(31.0), set(32.0)], None));
        // What was read is there.
        let turn = desk.turn("robot.r", &KnobValue::Number(32.0)).unwrap();
        let turned = desk.turned(&turn, turn.to);
        assert!(std::sync::Arc::ptr_eq(&turned.program().unwrap(), &turned.program().unwrap()));
    }

    #[test]
    fn what_is_quick_to_read_is_asked_at_once() {
        let (sender, requests) = channel();
        let (mut incoming, desk) = (Incoming::default(), desk(include_str!("../../../../examples/live.toml")));
        sender.send(set(1.0)).unwrap();
        sender.send(set(2.0)).unwrap();
        let both = Request::together(vec![set(1.0), set(2.0)], None);
        assert_eq!(incoming.next(&requests, Duration::ZERO, &desk), Some(both));
        assert_eq!(incoming.next(&requests, Duration::ZERO, &desk), None);
    }
}
