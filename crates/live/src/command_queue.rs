//! What clients ask of a live motion, in the order in which the motion does it.
//!
//! Commands that wait behind each other become one change. A changed file and the motion of a delta robot take long to read, so they are read aside, by
//! another thread if there is one, before the motion is asked for it: meanwhile the board gets its plan, and commands such as a stop are taken at once.

use std::collections::VecDeque;
use std::time::Duration;

use pulsetrain_motion::file::MOST_OF_A_MOTION_FILE;
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

/// Whether commands have a changed file, or turn knobs, and nothing else, of a motion that takes long to read. Stops must not wait for it, and the
/// board gets its plan meanwhile.
fn takes_long(setpoints: &LiveSetpoints, batch: &Batch) -> bool {
    if batch.commands.iter().any(|command| matches!(command, RunCommand::Motion { .. })) {
        return true;
    }
    let is_knob = |command: &RunCommand| matches!(command, RunCommand::Set { .. });
    let is_delta = |kinematics: &Kinematics| matches!(kinematics, Kinematics::Delta { .. });
    setpoints.setup().machines.iter().any(|machine| is_delta(&machine.kinematics)) && batch.commands.iter().all(is_knob)
}

/// Reads the motion that is asked for. The setpoints keep it for [`LiveSetpoints::program`] and [`LiveSetpoints::with_file`].
fn read(mut setpoints: LiveSetpoints, batch: Batch) {
    for command in batch.commands {
        match command {
            RunCommand::Set { knob, value } => {
                if let Ok(knob_move) = setpoints.knob_move(&knob, &value) {
                    setpoints = setpoints.with_knob(&knob_move, knob_move.to);
                }
            }
            RunCommand::Motion { text, files } if text.len() as u64 <= MOST_OF_A_MOTION_FILE => {
                if let Some(changed) = setpoints.read_ahead(&text, &files) {
                    setpoints = changed;
                }
            }
            _ => {}
        }
    }
    // What is wrong with it is said when the motion is asked for it.
    let _ = setpoints.program();
}
