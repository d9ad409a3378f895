//! What the motors of a live motion do: one state at a time.

use pulsetrain_motion::Time;
use pulsetrain_session::fade::Shift;

use crate::command::RunCommand;
use crate::event::RunEvent;

/// What the motors do. [`Running`](RunState::Running), [`Paused`](RunState::Paused) and [`Parked`](RunState::Parked) last until a client asks for something
/// else. The other states end by themselves, and know what was so before.
#[derive(Debug)]
pub(crate) enum RunState {
    /// They follow the motion, or change to it. After its end they rest there.
    Running,
    /// They halt on their paths until a client resumes.
    Paused {
        /// From when on they rest, s of the motion.
        rests_from_s: f64,
    },
    /// They were sent to a position, and rest there until a client asks for the motion again.
    Parked(Parked),
    /// They rest, or come to rest, and are to follow the motion from there.
    Joining {
        /// From where on they follow it.
        joining: Joining,
        /// What was so before.
        before: Box<RunState>,
    },
    /// The planner has refused a part of the motion long after a change, and they braked: they are to join an earlier motion.
    TakingBack {
        /// What was refused.
        why: String,
        /// What was so before.
        before: Box<RunState>,
    },
    /// The session has got the command to stop.
    Stopping {
        /// What was so before.
        before: Box<RunState>,
    },
}

/// Motors that were sent to a position.
#[derive(Clone, Debug)]
pub(crate) struct Parked {
    /// From when on they rest, s of the motion.
    pub(crate) rests_from_s: f64,
    /// A pause came before or meanwhile: the first `resume` ends the pause, and the next one brings the motors back to the motion.
    pub(crate) is_paused: bool,
    /// A pause from before the board was lost: the motion goes on from there.
    pub(crate) halted: Option<LawPoint>,
}

/// A point of the motion from which motors can go on.
#[derive(Clone, Debug)]
pub(crate) struct LawPoint {
    /// The laws' time.
    pub(crate) at: Time,
    /// What changed speeds have added to the motors' ways; `None`: a constant speed begins where they rest.
    pub(crate) shifts: Option<Vec<Shift>>,
}

/// Motors that rest are to follow the motion.
#[derive(Debug)]
pub(crate) struct Joining {
    pub(crate) point: LawPoint,
    /// The command and the event that answers it; `None`: they stay at rest.
    pub(crate) answer: Option<(RunCommand, RunEvent)>,
}

impl RunState {
    /// Motors that rest at a position at the beginning.
    pub(crate) const fn at_rest() -> RunState {
        RunState::Parked(Parked { rests_from_s: 0.0, is_paused: false, halted: None })
    }

    /// The state that lasts until a client asks for something else: this one, or the one before it.
    fn lasting(&self) -> &RunState {
        match self {
            RunState::Running | RunState::Paused { .. } | RunState::Parked(_) => self,
            RunState::Joining { before, .. } | RunState::TakingBack { before, .. } | RunState::Stopping { before } => {
                before.lasting()
            }
        }
    }

    fn lasting_mut(&mut self) -> &mut RunState {
        match self {
            RunState::Running | RunState::Paused { .. } | RunState::Parked(_) => self,
            RunState::Joining { before, .. } | RunState::TakingBack { before, .. } | RunState::Stopping { before } => {
                before.lasting_mut()
            }
        }
    }

    /// The lasting state. Nothing remains of one that ends by itself but what it was to do.
    fn into_lasting(self) -> (RunState, Option<Joining>) {
        match self {
            lasting @ (RunState::Running | RunState::Paused { .. } | RunState::Parked(_)) => (lasting, None),
            RunState::Joining { joining, before } => (before.into_lasting().0, Some(joining)),
            RunState::TakingBack { before, .. } | RunState::Stopping { before } => before.into_lasting(),
        }
    }

    fn take(&mut self) -> RunState {
        std::mem::replace(self, RunState::Running)
    }

    /// Motors that were sent to a position.
    pub(crate) fn parked(&self) -> Option<&Parked> {
        match self.lasting() {
            RunState::Parked(parked) => Some(parked),
            _ => None,
        }
    }

    /// Whether the motors were sent to a position, and stay there until a client asks for the motion.
    pub(crate) fn is_parked(&self) -> bool {
        self.parked().is_some()
    }

    /// Whether the session is paused.
    pub(crate) fn is_paused(&self) -> bool {
        match self.lasting() {
            RunState::Paused { .. } => true,
            RunState::Parked(parked) => parked.is_paused,
            _ => false,
        }
    }

    /// Whether the session has got the command to stop.
    pub(crate) const fn is_stopping(&self) -> bool {
        matches!(self, RunState::Stopping { .. })
    }

    /// Whether the motors are to follow the motion as soon as they rest.
    pub(crate) const fn is_joining(&self) -> bool {
        matches!(self, RunState::Joining { .. })
    }

    /// Whether an earlier motion is looked for.
    pub(crate) const fn is_taking_back(&self) -> bool {
        matches!(self, RunState::TakingBack { .. })
    }

    /// Whether all motors rest at `now_s` of the motion until a client asks for it.
    pub(crate) fn is_resting(&self, now_s: f64) -> bool {
        match self.lasting() {
            RunState::Paused { rests_from_s } => now_s >= *rests_from_s,
            RunState::Parked(parked) => now_s >= parked.rests_from_s,
            _ => false,
        }
    }

    /// A pause begins.
    pub(crate) fn pause(&mut self, rests_s: f64) {
        match self.lasting_mut() {
            RunState::Parked(parked) => (parked.is_paused, parked.rests_from_s) = (true, rests_s),
            other => *other = RunState::Paused { rests_from_s: rests_s },
        }
    }

    /// A pause ends.
    pub(crate) fn resume(&mut self) {
        match self.lasting_mut() {
            RunState::Parked(parked) => parked.is_paused = false,
            other => *other = RunState::Running,
        }
    }

    /// The motors have changed to the motion, or to a position: they follow it, or rest there, from `until_s` on. A change that is taken back is taken back
    /// now.
    pub(crate) fn change(&mut self, is_parked: bool, until_s: f64) {
        if let RunState::TakingBack { before, .. } = self {
            *self = before.take();
        }
        let is_paused = self.is_paused();
        *self.lasting_mut() = match (is_parked, is_paused) {
            (true, _) => RunState::Parked(Parked { rests_from_s: until_s, is_paused, halted: None }),
            (false, true) => RunState::Paused { rests_from_s: until_s },
            (false, false) => RunState::Running,
        };
    }

    /// The motors are to follow the motion as soon as they rest.
    pub(crate) fn join(&mut self, joining: Joining) {
        let (before, _) = self.take().into_lasting();
        *self = RunState::Joining { joining, before: Box::new(before) };
    }

    /// The motors follow the motion from here on, or do not: what was to be done.
    pub(crate) fn end_joining(&mut self) -> Option<Joining> {
        if !self.is_joining() {
            return None;
        }
        let (before, joining) = self.take().into_lasting();
        *self = before;
        joining
    }

    /// The motion does not go on from a pause before the board was lost.
    pub(crate) fn forget_pause(&mut self) {
        if let RunState::Parked(parked) = self.lasting_mut() {
            parked.halted = None;
        }
    }

    /// An earlier motion is looked for. Gives what the motors were to join.
    pub(crate) fn take_back(&mut self, why: String) -> Option<Joining> {
        let (before, joining) = self.take().into_lasting();
        *self = RunState::TakingBack { why, before: Box::new(before) };
        joining
    }

    /// Why an earlier motion is looked for, once the motors follow it.
    pub(crate) fn why_taken_back(&self) -> Option<&str> {
        match self {
            RunState::TakingBack { why, .. } => Some(why),
            _ => None,
        }
    }

    /// The session gets the command to stop. Gives what the motors were to join.
    pub(crate) fn stop(&mut self) -> Option<Joining> {
        let (before, joining) = self.take().into_lasting();
        *self = RunState::Stopping { before: Box::new(before) };
        joining
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn joining() -> Joining {
        Joining { point: LawPoint { at: Time::ZERO, shifts: None }, answer: None }
    }

    #[test]
    fn a_pause_before_or_after_goto_ends_with_the_first_resume() {
        let mut state = RunState::Running;
        state.pause(2.0);
        assert!(state.is_paused() && !state.is_resting(1.9) && state.is_resting(2.0));
        state.change(true, 3.0);
        assert!(state.is_paused() && state.is_parked() && !state.is_resting(2.5));
        state.resume();
        assert!(!state.is_paused() && state.is_parked() && state.is_resting(3.0));
        state.change(false, 4.0);
        assert!(matches!(state, RunState::Running));
    }

    #[test]
    fn a_state_that_ends_by_itself_leaves_the_one_before_it() {
        let mut state = RunState::at_rest();
        state.join(joining());
        state.pause(1.0);
        assert!(state.is_joining() && state.is_parked() && state.is_paused());
        assert!(state.end_joining().is_some() && state.end_joining().is_none());
        assert!(!state.is_joining() && state.is_parked() && state.is_paused());
        state.join(joining());
        assert!(state.take_back("too fast".to_owned()).is_some());
        assert!(state.is_taking_back() && state.why_taken_back() == Some("too fast"));
        state.resume();
        state.change(false, 1.0);
        assert!(matches!(state, RunState::Running));
        state.join(joining());
        assert!(state.stop().is_some() && state.is_stopping());
        state.change(true, 2.0);
        assert!(state.is_stopping() && state.is_parked(), "a stop is not undone");
    }
}
