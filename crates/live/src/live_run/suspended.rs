//! A live motion without a board: its board is lost, or not found yet.

use pulsetrain_board::Leased;
use pulsetrain_motion::Time;
use pulsetrain_motion::program::Program;
use pulsetrain_session::control::Command;
use pulsetrain_session::drive::Driven;

use super::gather::with_file;
use super::state::{Joining, LawPoint, Parked, RunState};
use super::{LiveRun, Publish, refuse};
use crate::command::{Batch, RunCommand};
use crate::event::RunEvent;
use crate::setpoints::LiveSetpoints;

/// A motion without a board.
pub struct SuspendedRun {
    setpoints: LiveSetpoints,
    /// How the motion goes on.
    phase: SuspendedPhase,
    /// Where it goes on: where it was when the board was lost.
    point: LawPoint,
    tempo: f64,
    rejoins: bool,
    rejoined: u32,
    /// It has not begun yet.
    is_new: bool,
}

/// How a motion goes on once its board is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SuspendedPhase {
    /// The motors join it.
    Joins,
    /// They rest until a client asks for it, and join it then from where they rest.
    Rests,
    /// They rest until a client asks for it, and it goes on then where it was paused.
    Halts,
}

impl SuspendedRun {
    /// A motion that has not begun, and waits for its board. If `joins`, the motors join it from where they stand.
    #[must_use]
    pub fn new(setpoints: LiveSetpoints, rejoins: bool, joins: bool) -> SuspendedRun {
        SuspendedRun {
            setpoints,
            phase: if joins { SuspendedPhase::Joins } else { SuspendedPhase::Rests },
            point: LawPoint { at: Time::ZERO, shifts: Some(Vec::new()) },
            tempo: 1.0,
            rejoins,
            rejoined: 0,
            is_new: true,
        }
    }

    /// The motion as it is wanted.
    #[must_use]
    pub fn setpoints(&self) -> &LiveSetpoints {
        &self.setpoints
    }

    /// Notes what is asked meanwhile: a changed motion file, and what the schedule says. All else is refused.
    pub fn handle(&mut self, batch: impl Into<Batch>, publish: Publish<'_>) {
        let commands = batch.into().commands;
        commands.into_iter().for_each(|command| self.handle_one(command, publish));
    }

    fn handle_one(&mut self, command: RunCommand, publish: Publish<'_>) {
        const AWAY: &str = "the board cannot be reached, or the positions of the motors are not known";
        match command {
            RunCommand::Motion { text, files } => match with_file(&self.setpoints, &text, &files) {
                Ok(None) => {}
                Ok(Some(setpoints)) => {
                    self.setpoints = setpoints;
                    publish(RunEvent::Motion { from_s: 0.0, until_s: 0.0 });
                }
                Err(refused) => publish(refused),
            },
            RunCommand::Rest { in_place, until } => {
                self.phase = match (in_place, self.phase) {
                    (true, _) | (false, SuspendedPhase::Halts) => SuspendedPhase::Halts,
                    (false, SuspendedPhase::Joins | SuspendedPhase::Rests) => SuspendedPhase::Rests,
                };
                publish(RunEvent::Resting { until });
            }
            RunCommand::Begin => {
                self.setpoints = self.setpoints.restarted();
                self.phase = SuspendedPhase::Joins;
                self.point = LawPoint { at: Time::ZERO, shifts: Some(Vec::new()) };
            }
            RunCommand::Cue { ref name } => match self.setpoints.at_cue(name, self.point.at) {
                Ok((setpoints, _)) => self.setpoints = setpoints,
                Err(error) => refuse(command, &error, publish),
            },
            RunCommand::Resume => self.phase = SuspendedPhase::Joins,
            command => refuse(command, &AWAY, publish),
        }
    }

    /// The motion in a new session with the board. The motors rest there, at the positions of `program`. If they did not rest before the board was lost, they
    /// join the motion; `passed_s` is how long the board was away, s.
    #[must_use]
    pub fn rejoin_on<B: Leased>(mut self, driven: Driven<B>, program: &Program, passed_s: f64) -> LiveRun<B> {
        self.setpoints.set_up(program);
        let mut run = LiveRun::at_rest(driven, self.setpoints, self.rejoins);
        run.tempo = self.tempo;
        if self.tempo != 1.0 {
            run.held.hold_for_session(Command::Tempo { rate: self.tempo }, None);
        }
        run.rejoining.times = self.rejoined + u32::from(!self.is_new);
        let mut point = self.point;
        if self.phase == SuspendedPhase::Halts {
            run.state = RunState::Parked(Parked { rests_from_s: 0.0, is_paused: false, halted: Some(point.clone()) });
        } else {
            point.at = point.at + Time::from_seconds(self.tempo * passed_s);
        }
        let event = match self.is_new {
            true => RunEvent::Returned { from_s: 0.0, until_s: 0.0 },
            false => RunEvent::Rejoined { from_s: 0.0, until_s: 0.0, times: run.rejoining.times },
        };
        let answer = (self.phase == SuspendedPhase::Joins).then_some((RunCommand::Begin, event));
        run.state.join(Joining { point, answer });
        run
    }
}

impl<B: Leased> LiveRun<B> {
    /// Takes the motion off a board that is lost.
    #[must_use]
    pub fn suspend(self) -> (Driven<B>, SuspendedRun) {
        let halted = self.state.parked().and_then(|parked| parked.halted.clone());
        let phase = match &self.state {
            state if state.is_paused() || halted.is_some() => SuspendedPhase::Halts,
            // The board was lost again before the motors had joined the motion.
            RunState::Joining { joining, .. } if joining.answer.is_some() => SuspendedPhase::Joins,
            state if state.is_parked() => SuspendedPhase::Rests,
            _ => SuspendedPhase::Joins,
        };
        let point = halted.unwrap_or_else(|| match &self.state {
            // The board was lost again before its session had the laws' time.
            RunState::Joining { joining, .. } => joining.point.clone(),
            _ => LawPoint { at: self.driven.law_time(), shifts: self.driven.shifts() },
        });
        let suspended = SuspendedRun {
            setpoints: self.setpoints,
            phase,
            point,
            tempo: self.tempo,
            rejoins: self.rejoining.is_allowed,
            rejoined: self.rejoining.times,
            is_new: false,
        };
        (self.driven, suspended)
    }
}
