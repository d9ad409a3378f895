//! Commands that a live motion holds back: until the session takes them, until their tick, or until the motors have joined the motion.

use std::collections::VecDeque;

use pulsetrain_session::control::Command;

use crate::command::RunCommand;

/// Changes that may wait for their tick.
pub(crate) const MAX_TIMED: usize = 1024;

/// A command that is held back, or several that act as one.
#[derive(Debug, PartialEq)]
enum Held {
    /// Until the session takes it, which takes one in a step.
    Session {
        command: Command,
        /// The tick at which it is to begin; `None`: as soon as it can.
        at: Option<u64>,
    },
    /// Until their tick is near.
    Tick(Timed),
    /// Until the motors have joined the motion.
    Join(RunCommand),
}

/// Commands for a tick.
#[derive(Debug, PartialEq)]
pub(crate) struct Timed {
    pub(crate) tick: u64,
    pub(crate) commands: Vec<RunCommand>,
    /// Whether they were held against the limits.
    pub(crate) is_checked: bool,
}

/// All commands that are held back. Those for ticks are in the order of their ticks, the others in that in which they came.
#[derive(Debug, Default)]
pub(crate) struct HeldCommands {
    held: VecDeque<Held>,
}

const fn is_stop(command: Command) -> bool {
    matches!(command, Command::Stop | Command::StopNow)
}

impl HeldCommands {
    /// Holds a command until the session takes it, at a tick or as soon as it can.
    pub(crate) fn hold_for_session(&mut self, command: Command, at: Option<u64>) {
        self.held.push_back(Held::Session { command, at });
    }

    /// Holds commands until their tick is near. False if too many wait.
    pub(crate) fn hold_for_tick(&mut self, tick: u64, commands: Vec<RunCommand>) -> bool {
        if self.timed().count() == MAX_TIMED {
            return false;
        }
        let is_later = |held: &Held| matches!(held, Held::Tick(timed) if timed.tick > tick);
        let place = self.held.iter().position(is_later).unwrap_or(self.held.len());
        self.held.insert(place, Held::Tick(Timed { tick, commands, is_checked: false }));
        true
    }

    /// Holds a command until the motors have joined the motion.
    pub(crate) fn hold_until_joined(&mut self, command: RunCommand) {
        self.held.push_back(Held::Join(command));
    }

    /// The next command for the session, and its tick. A stop comes first, but one for a tick after `soon` waits: the session has no stop for a tick, so it
    /// is given just before.
    pub(crate) fn take_for_session(&mut self, soon: u64) -> Option<(Command, Option<u64>)> {
        let due = |held: &Held| match held {
            Held::Session { command, at } if !is_stop(*command) || at.is_none_or(|at| at <= soon) => Some(*command),
            _ => None,
        };
        let first = |wanted: Command| self.held.iter().position(|held| due(held) == Some(wanted));
        let place = first(Command::StopNow).or_else(|| first(Command::Stop));
        let place = place.or_else(|| self.held.iter().position(|held| due(held).is_some()))?;
        match self.held.remove(place) {
            Some(Held::Session { command, at }) => Some((command, at)),
            _ => None,
        }
    }

    /// Whether commands wait for the session.
    pub(crate) fn has_for_session(&self) -> bool {
        self.held.iter().any(|held| matches!(held, Held::Session { .. }))
    }

    /// The commands with the first tick.
    pub(crate) fn first_timed(&mut self) -> Option<&mut Timed> {
        self.held.iter_mut().find_map(|held| match held {
            Held::Tick(timed) => Some(timed),
            _ => None,
        })
    }

    /// Takes the commands with the first tick.
    pub(crate) fn take_first_timed(&mut self) -> Option<Timed> {
        let place = self.held.iter().position(|held| matches!(held, Held::Tick(_)))?;
        match self.held.remove(place) {
            Some(Held::Tick(timed)) => Some(timed),
            _ => None,
        }
    }

    /// Takes the commands that waited until the motors have joined the motion.
    pub(crate) fn take_joined(&mut self) -> Vec<RunCommand> {
        let mut joined = Vec::new();
        for held in std::mem::take(&mut self.held) {
            match held {
                Held::Join(command) => joined.push(command),
                other => self.held.push_back(other),
            }
        }
        joined
    }

    /// Whether a stop is among them, for whatever tick.
    pub(crate) fn has_stop(&self) -> bool {
        self.held.iter().any(|held| match held {
            Held::Session { command, .. } => is_stop(*command),
            Held::Tick(timed) => timed.commands.iter().any(RunCommand::is_stop),
            Held::Join(_) => false,
        })
    }

    /// Whether a stop without a tick waits for the session.
    pub(crate) fn has_stop_for_now(&self) -> bool {
        self.held.iter().any(|held| matches!(held, Held::Session { command, at: None } if is_stop(*command)))
    }

    fn timed(&self) -> impl Iterator<Item = &Timed> {
        self.held.iter().filter_map(|held| match held {
            Held::Tick(timed) => Some(timed),
            _ => None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_session_gets_stops_first_and_those_for_a_tick_just_before_it() {
        let mut held = HeldCommands::default();
        held.hold_for_session(Command::Pause, None);
        held.hold_for_session(Command::Stop, Some(500));
        held.hold_for_session(Command::Tempo { rate: 0.5 }, Some(900));
        assert!(held.has_stop() && !held.has_stop_for_now());
        assert_eq!(held.take_for_session(499), Some((Command::Pause, None)));
        assert_eq!(held.take_for_session(500), Some((Command::Stop, Some(500))));
        held.hold_for_session(Command::Stop, None);
        held.hold_for_session(Command::StopNow, None);
        assert!(held.has_stop_for_now());
        assert_eq!(held.take_for_session(0), Some((Command::StopNow, None)));
        assert_eq!(held.take_for_session(0), Some((Command::Stop, None)));
        assert_eq!(held.take_for_session(0), Some((Command::Tempo { rate: 0.5 }, Some(900))));
        assert!(!held.has_for_session());
    }

    #[test]
    fn commands_for_ticks_come_in_their_order_and_those_of_a_tick_as_they_came() {
        let mut held = HeldCommands::default();
        let cue = |name: &str| RunCommand::Cue { name: name.to_owned() };
        held.hold_until_joined(RunCommand::Go);
        for (tick, name) in [(30, "c"), (10, "a"), (30, "d"), (20, "b")] {
            assert!(held.hold_for_tick(tick, vec![cue(name)]));
        }
        held.hold_for_session(Command::Pause, None);
        held.hold_until_joined(RunCommand::Back);
        assert_eq!(held.take_joined(), [RunCommand::Go, RunCommand::Back]);
        let order = std::iter::from_fn(|| held.take_first_timed()).map(|timed| (timed.tick, timed.commands));
        let expected = [(10, "a"), (20, "b"), (30, "c"), (30, "d")].map(|(tick, name)| (tick, vec![cue(name)]));
        assert_eq!(order.collect::<Vec<_>>(), expected);
        assert!(held.has_for_session());
        let fill = (0..).take_while(|tick| held.hold_for_tick(*tick, vec![RunCommand::Stop])).count();
        assert!(fill == MAX_TIMED && held.has_stop());
    }
}
