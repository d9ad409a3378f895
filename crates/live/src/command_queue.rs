//! What clients ask of a live motion, in the order in which the motion does it.
//!
//! Commands that wait behind each other become one change. The motion of a delta robot takes long to read, so it is read aside, by another thread if there
//! is one, before the motion is asked for it: meanwhile the board gets its plan, and commands such as a stop are taken at once.

use std::collections::VecDeque;
use std::time::Duration;

use pulsetrain_motion::machine::Kinematics;

use crate::command::{Batch, RunCommand};
use crate::setpoints::LiveSetpoints;

/// Commands that become one change, at most.
pub const MAX_MERGED_COMMANDS: usize = 32;

/// Work that takes long, such as reading a robot's motion.
pub type Work = Box<dyn FnOnce() + Send>;

/// Where the commands of clients come from.
pub trait CommandSource {
    /// The next commands. If none have come it may wait for them, `wait` at most.
    fn next(&mut self, wait: Duration) -> Option<Batch>;

    /// Does work aside, in another thread say. Without threads it is done at once.
    fn start(&mut self, work: Work) {
        work();
    }

    /// Whether the work that was started last is done.
    fn is_done(&self) -> bool {
        true
    }
}

/// No client asks for anything.
impl CommandSource for () {
    fn next(&mut self, _wait: Duration) -> Option<Batch> {
        None
    }
}

/// The commands that the motion has not been asked for yet.
#[derive(Debug, Default)]
pub struct CommandQueue {
    /// What came first.
    waiting: VecDeque<Batch>,
    /// Knobs whose motion is read aside.
    reading: Option<Batch>,
}

impl CommandQueue {
    /// The next commands for the motion: those that came first, and those that wait behind them. If none have come the source may wait for them, `wait` at
    /// most.
    pub fn next(
        &mut self,
        source: &mut impl CommandSource,
        wait: Duration,
        setpoints: &LiveSetpoints,
    ) -> Option<Batch> {
        if self.reading.is_some() {
            if source.is_done() {
                return self.reading.take();
            }
            if let Some(stop) = self.take_stop() {
                return Some(stop);
            }
            let batch = source.next(wait)?;
            let is_of_session = |command: &RunCommand| command.of_session().is_some();
            if batch.single().is_some_and(is_of_session) || batch.has_stop() {
                return Some(batch);
            }
            self.waiting.push_back(batch);
            return None;
        }
        let first = self.waiting.pop_front().or_else(|| source.next(wait))?;
        let batch = self.with_waiting(first, source);
        if !takes_long(setpoints, &batch) {
            return Some(batch);
        }
        let (setpoints, to_read) = (setpoints.clone(), batch.clone());
        self.reading = Some(batch);
        source.start(Box::new(move || read(setpoints, to_read)));
        self.take_stop()
    }

    /// Takes the first commands with a stop out of those that wait.
    fn take_stop(&mut self) -> Option<Batch> {
        let place = self.waiting.iter().position(Batch::has_stop)?;
        self.waiting.remove(place)
    }

    /// Whether a stop for now is among the commands that have come.
    pub fn stop_waits(&mut self, source: &mut impl CommandSource) -> bool {
        self.waiting.extend(std::iter::from_fn(|| source.next(Duration::ZERO)));
        self.waiting.iter().any(Batch::has_stop)
    }

    /// The next commands while there is no board. The motion of a knob need not be read first.
    pub fn next_without_board(&mut self, source: &mut impl CommandSource, wait: Duration) -> Option<Batch> {
        self.reading.take().or_else(|| self.waiting.pop_front()).or_else(|| source.next(wait))
    }

    /// Commands, with those that wait behind them.
    fn with_waiting(&mut self, first: Batch, source: &mut impl CommandSource) -> Batch {
        if first.at_s.is_some() {
            return first;
        }
        let mut all = first.commands;
        while all.len() < MAX_MERGED_COMMANDS {
            let Some(next) = self.waiting.pop_front().or_else(|| source.next(Duration::ZERO)) else { break };
            if next.at_s.is_some() {
                self.waiting.push_front(next);
                break;
            }
            all.extend(next.commands);
        }
        Batch::now(all)
    }
}

/// Whether commands turn knobs, and nothing else, of a motion that takes long to read. Stops must not wait for it.
fn takes_long(setpoints: &LiveSetpoints, batch: &Batch) -> bool {
    let is_knob = |command: &RunCommand| matches!(command, RunCommand::Set { .. });
    let is_delta = |kinematics: &Kinematics| matches!(kinematics, Kinematics::Delta { .. });
    setpoints.setup().machines.iter().any(|machine| is_delta(&machine.kinematics)) && batch.commands.iter().all(is_knob)
}

/// Reads the motion that knobs ask for. The setpoints keep it for [`LiveSetpoints::program`].
fn read(mut setpoints: LiveSetpoints, batch: Batch) {
    for command in batch.commands {
        if let RunCommand::Set { knob, value } = command
            && let Ok(knob_move) = setpoints.knob_move(&knob, &value)
        {
            setpoints = setpoints.with_knob(&knob_move, knob_move.to);
        }
    }
    // What is wrong with it is said when the motion is asked for it.
    let _ = setpoints.program();
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{KnobValue, NamedFiles};
    use pulsetrain_session::prepare::Prepared;

    const DELTA: &str = include_str!("../../../examples/delta.toml");

    /// Commands that have come, and work that is done when the test says so.
    #[derive(Default)]
    struct Scripted {
        batches: VecDeque<Batch>,
        work: Option<Work>,
    }

    impl Scripted {
        fn send(&mut self, batch: impl Into<Batch>) {
            self.batches.push_back(batch.into());
        }

        fn finish_work(&mut self) {
            self.work.take().expect("there is work")();
        }
    }

    impl CommandSource for Scripted {
        fn next(&mut self, _: Duration) -> Option<Batch> {
            self.batches.pop_front()
        }

        fn start(&mut self, work: Work) {
            assert!(self.work.replace(work).is_none(), "one at a time");
        }

        fn is_done(&self) -> bool {
            self.work.is_none()
        }
    }

    fn setpoints(text: &str) -> LiveSetpoints {
        let (mut setpoints, contents) = LiveSetpoints::of(text, "m.toml", None, NamedFiles::none()).unwrap();
        setpoints.set_up(&Prepared::new("m.toml".to_owned(), contents, None).unwrap().program);
        setpoints
    }

    fn set(value: f64) -> RunCommand {
        RunCommand::Set { knob: "robot.r".to_owned(), value: KnobValue::Number(value) }
    }

    #[test]
    fn a_stop_does_not_wait_until_a_robots_motion_is_read() {
        let (mut source, mut queue, setpoints) = (Scripted::default(), CommandQueue::default(), setpoints(DELTA));
        let next = |queue: &mut CommandQueue, source: &mut Scripted| queue.next(source, Duration::ZERO, &setpoints);
        source.send(set(30.0));
        assert_eq!(next(&mut queue, &mut source), None, "it is being read");
        source.send(set(31.0));
        source.send(RunCommand::Stop);
        assert_eq!(next(&mut queue, &mut source), None);
        assert_eq!(next(&mut queue, &mut source), Some(RunCommand::Stop.into()));
        let with_knob = Batch::now(vec![set(29.0), RunCommand::Stop]);
        source.send(with_knob.clone());
        assert_eq!(next(&mut queue, &mut source), Some(with_knob));
        // A stop for a later time waits, but not if the board is lost.
        let timed = Batch { commands: vec![RunCommand::Stop], at_s: Some(9.0) };
        source.send(timed.clone());
        assert_eq!(next(&mut queue, &mut source), None);
        // Nor one that came while the nearest value of another knob was searched.
        assert!(!queue.stop_waits(&mut source));
        source.send(RunCommand::StopNow);
        assert!(queue.stop_waits(&mut source) && source.batches.is_empty());
        assert_eq!(next(&mut queue, &mut source), Some(RunCommand::StopNow.into()));
        assert!(!queue.stop_waits(&mut source));
        let mut away = CommandQueue { waiting: queue.waiting.clone(), reading: None };
        assert_eq!(away.next_without_board(&mut source, Duration::ZERO), Some(set(31.0).into()));
        assert_eq!(away.next_without_board(&mut source, Duration::ZERO), Some(timed));
        queue.waiting.pop_back();
        source.finish_work();
        assert_eq!(next(&mut queue, &mut source), Some(set(30.0).into()));
        // What came behind is one change.
        source.send(set(32.0));
        assert_eq!(next(&mut queue, &mut source), None);
        source.finish_work();
        assert_eq!(next(&mut queue, &mut source), Some(Batch::now(vec![set(31.0), set(32.0)])));
        // What was read is there.
        let knob_move = setpoints.knob_move("robot.r", &KnobValue::Number(32.0)).unwrap();
        let turned = setpoints.with_knob(&knob_move, knob_move.to);
        assert!(std::sync::Arc::ptr_eq(&turned.program().unwrap(), &turned.program().unwrap()));
    }

    /// It may not be joined with a knob that takes long to read, nor with commands for a later time.
    #[test]
    fn a_stop_comes_first_behind_a_knob_and_commands_for_a_later_time() {
        let (mut source, mut queue, setpoints) = (Scripted::default(), CommandQueue::default(), setpoints(DELTA));
        source.send(set(33.0));
        source.send(Batch { commands: vec![RunCommand::Stop], at_s: Some(9.0) });
        source.send(RunCommand::Stop);
        assert!(queue.stop_waits(&mut source));
        assert_eq!(queue.next(&mut source, Duration::ZERO, &setpoints), Some(RunCommand::Stop.into()));
    }

    #[test]
    fn what_is_quick_to_read_is_asked_at_once() {
        let (mut source, mut queue) = (Scripted::default(), CommandQueue::default());
        let setpoints = setpoints(include_str!("../../../examples/live.toml"));
        source.send(set(1.0));
        source.send(set(2.0));
        let both = Batch::now(vec![set(1.0), set(2.0)]);
        assert_eq!(queue.next(&mut source, Duration::ZERO, &setpoints), Some(both));
        assert_eq!(queue.next(&mut source, Duration::ZERO, &setpoints), None);
    }

    /// Where nobody works aside, a robot's motion is read within the call.
    #[test]
    fn without_threads_a_motion_is_read_at_once() {
        struct Alone(Option<Batch>);
        impl CommandSource for Alone {
            fn next(&mut self, _: Duration) -> Option<Batch> {
                self.0.take()
            }
        }
        let (mut source, mut queue, setpoints) =
            (Alone(Some(set(30.0).into())), CommandQueue::default(), setpoints(DELTA));
        assert_eq!(queue.next(&mut source, Duration::ZERO, &setpoints), None);
        assert_eq!(queue.next(&mut source, Duration::ZERO, &setpoints), Some(set(30.0).into()));
    }
}
