//! What clients hear of a motion that runs: one type for the terminal, the control socket, OSC and the page.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use pulsetrain_session::control::{Ended, Event, Positions, Status};

use crate::command::RunCommand;

/// An event of a motion that runs. Those of its session come first, and those of a live motion follow. Times are seconds from the begin of the motion.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum RunEvent {
    /// Time has passed.
    Progress {
        /// Time of the motion, s.
        at_s: f64,
    },
    /// The state of all motors, of the lease and of the lateness.
    Status(Status),
    /// A pause begins.
    Pausing {
        /// When all motors rest, s.
        rests_s: f64,
    },
    /// The motion goes on after a pause.
    Resuming {
        /// When it has its full speed, s.
        full_speed_s: f64,
    },
    /// The tempo changes. While the motion is paused, this is the tempo at which it will go on.
    Tempo {
        /// The new rate of the motion's time. If motors or board cannot follow the wanted one, the highest that they can.
        rate: f64,
        /// When the motion has it, s.
        from_s: f64,
        /// The motor or the machine, and its limit that a higher rate would break, if that is why the rate is not the wanted one.
        ceiling: Option<String>,
    },
    /// All motors come to rest within their limits.
    Stopping {
        /// When they begin to brake, s.
        at_s: f64,
    },
    /// No further step is made.
    StoppedAtOnce {
        /// Steps of each motor, as the board counted them.
        positions: Vec<i64>,
        /// For each motor: whether it was too fast to stop at once, and may stand elsewhere than it counted.
        uncertain: Vec<bool>,
    },
    /// The motion has come to its end, or was stopped. This is the last event.
    Ended(Ended),
    /// The motors stopped before the motion's end, without an order. This is the last event.
    Failed {
        /// The reason, for the user.
        why: String,
        /// When the motors began to brake, s, if that is known.
        at_s: Option<f64>,
        /// Where the motors are, if they moved.
        positions: Option<Positions>,
        /// What the user can do, if something is known to help.
        advice: Option<String>,
    },
    /// A knob was turned.
    Set {
        /// Its name.
        knob: String,
        /// Its new value, in its unit.
        value: f64,
        /// Its unit.
        unit: String,
        /// The limit that a value nearer to the wanted one would break, if that is why it is not the wanted one.
        ceiling: Option<String>,
        /// When the motors begin to change, and when they follow the new motion, s.
        from_s: f64,
        /// See `from_s`.
        until_s: f64,
    },
    /// A cue began.
    Cue {
        /// Its name.
        name: String,
        /// When the motors begin to change, and when they follow the cue, s.
        from_s: f64,
        /// See `from_s`.
        until_s: f64,
    },
    /// The motors go to a position, and rest there.
    Goto {
        /// The position, as it was asked for.
        position: String,
        /// When they begin to change, and when they rest, s.
        from_s: f64,
        /// See `from_s`.
        until_s: f64,
    },
    /// The motors leave the position to which they were sent, and follow the motion again.
    Returned {
        /// When they begin to change, and when they follow the motion, s.
        from_s: f64,
        /// See `from_s`.
        until_s: f64,
    },
    /// The motion begins, from its beginning.
    Began {
        /// When the motors begin to move, and when they follow the motion, s.
        from_s: f64,
        /// See `from_s`.
        until_s: f64,
    },
    /// The answer to `begin` or `resume` while the motion runs: it goes on as it is.
    AlreadyRuns,
    /// All motors have come to the end of the motion, and rest there. The motion can begin again, or be changed.
    MotionEnded {
        /// When that was seen, s.
        at_s: f64,
    },
    /// It is not time for the motion: the motors rest, or come to rest.
    Resting {
        /// When the motion begins, in words; empty if no time is set.
        until: String,
    },
    /// The board cannot be reached any more: its cable was pulled, say. The motors brake within their limits, and the run waits for the board.
    Unplugged {
        /// What failed.
        why: String,
        /// The port for which the run waits.
        port: String,
    },
    /// The positions of motors are unknown. The run waits for [`RunCommand::Here`].
    Unplaced {
        /// Why not.
        why: String,
        /// The motors.
        motors: Vec<String>,
        /// Where they stood when they were known last, if they rested there.
        last: Vec<String>,
    },
    /// Somebody said where motors stand.
    Placed {
        /// The motors.
        motors: Vec<String>,
        /// The position, as it was said.
        position: String,
    },
    /// A changed motion file was taken over.
    Motion {
        /// When the motors begin to change, and when they follow the new motion, s.
        from_s: f64,
        /// See `from_s`.
        until_s: f64,
    },
    /// A changed motion file was not taken over. The motion goes on as it was.
    MotionRefused {
        /// What is wrong.
        error: String,
        /// Where, if that is known: the line from 1, and the column from 1.
        line: Option<u32>,
        /// See `line`.
        column: Option<u32>,
    },
    /// The planner refused a part of the motion, long after a change that it had allowed. The motors braked; now they join the motion before that change, or
    /// an earlier one.
    TakenBack {
        /// What was refused.
        why: String,
        /// No earlier motion keeps to the limits: the motors rest where they stand.
        #[serde(default)]
        rests: bool,
        /// When they begin to, s.
        from_s: f64,
        /// When they follow it, s.
        until_s: f64,
    },
    /// A change for a time of the motion began later than that, since it was asked for too late, or another change was under way.
    Late {
        /// The time for which it was, s of the motion.
        wanted_s: f64,
        /// How much later it began, s.
        by_s: f64,
    },
    /// The motors had braked since the host or the line was too slow, or the cable was pulled. They join the motion again.
    Rejoined {
        /// When they begin to, s.
        from_s: f64,
        /// When they follow the motion, s.
        until_s: f64,
        /// How many times that has happened.
        times: u32,
    },
    /// A command was not obeyed, and the motion goes on as it was.
    Refused {
        /// The refused command.
        command: RunCommand,
        /// Why it was refused.
        why: String,
    },
}

impl From<Event> for RunEvent {
    fn from(event: Event) -> RunEvent {
        match event {
            Event::Progress { at_s } => RunEvent::Progress { at_s },
            Event::Status(status) => RunEvent::Status(status),
            Event::Pausing { rests_s } => RunEvent::Pausing { rests_s },
            Event::Resuming { full_speed_s } => RunEvent::Resuming { full_speed_s },
            Event::Tempo { rate, from_s, ceiling } => RunEvent::Tempo { rate, from_s, ceiling },
            Event::Stopping { at_s } => RunEvent::Stopping { at_s },
            Event::StoppedAtOnce { positions, uncertain } => RunEvent::StoppedAtOnce { positions, uncertain },
            Event::Ended(ended) => RunEvent::Ended(ended),
            Event::Failed { why, at_s, positions, advice } => RunEvent::Failed { why, at_s, positions, advice },
            Event::Refused { command, why } => RunEvent::Refused { command: command.into(), why },
        }
    }
}

impl RunEvent {
    /// Whether every run has such events, and not a live motion alone.
    #[must_use]
    pub const fn is_of_session(&self) -> bool {
        match self {
            RunEvent::Progress { .. }
            | RunEvent::Status(_)
            | RunEvent::Pausing { .. }
            | RunEvent::Resuming { .. }
            | RunEvent::Tempo { .. }
            | RunEvent::Stopping { .. }
            | RunEvent::StoppedAtOnce { .. }
            | RunEvent::Ended(_)
            | RunEvent::Failed { .. } => true,
            RunEvent::Refused { command, .. } => command.of_session().is_some(),
            _ => false,
        }
    }

    /// When the motors begin to change to other laws, s; `None` if they do not.
    #[must_use]
    pub const fn changes_from_s(&self) -> Option<f64> {
        match self {
            RunEvent::Set { from_s, .. }
            | RunEvent::Cue { from_s, .. }
            | RunEvent::Goto { from_s, .. }
            | RunEvent::Returned { from_s, .. }
            | RunEvent::Began { from_s, .. }
            | RunEvent::Motion { from_s, .. }
            | RunEvent::TakenBack { from_s, .. }
            | RunEvent::Rejoined { from_s, .. } => Some(*from_s),
            _ => None,
        }
    }

    /// Sets when the motors begin to change to other laws, and when they follow them, s.
    pub(crate) fn set_times(&mut self, (from, until): (f64, f64)) {
        match self {
            RunEvent::Set { from_s, until_s, .. }
            | RunEvent::Cue { from_s, until_s, .. }
            | RunEvent::Goto { from_s, until_s, .. }
            | RunEvent::Returned { from_s, until_s }
            | RunEvent::Began { from_s, until_s }
            | RunEvent::Motion { from_s, until_s }
            | RunEvent::TakenBack { from_s, until_s, .. }
            | RunEvent::Rejoined { from_s, until_s, .. } => (*from_s, *until_s) = (from, until),
            _ => {}
        }
    }
}
