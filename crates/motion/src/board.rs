//! A board's limits. The boards that there are: [`boards`](crate::boards).

/// A board's limits: one row of the committed table.
#[derive(Clone, Debug, PartialEq)]
pub struct Board {
    /// "uno", "due", "pico", "native".
    pub name: String,
    /// Ticks per second.
    pub tick_hz: u64,
    /// Fraction bits of its recurrence.
    pub fraction_bits: u32,
    /// Motors at most.
    pub max_motors: usize,
    /// Shortest own interval of a motor, ticks, with 1, 2, … motors; the last entry serves for more.
    pub min_interval_ticks: Vec<u32>,
    /// Whether the edges are timed in hardware (then the default tolerance is 1 tick, else 1 µs).
    pub hardware_timed: bool,
    /// Whether it has one pulse length, DIR set-up and hold for all motors: the longest that a driver needs. See
    /// [`Program::timing`](crate::program::Program::timing).
    pub one_timing: bool,
    /// Time that a turn of DIR takes in addition to pulse, hold and set-up, from the step before it to the step after
    /// it, ticks.
    pub turn_ticks: u32,
    /// What it needs between steps of different motors; `None` where their pulses may overlap.
    pub shared_steps: Option<SharedSteps>,
    /// What segments take the processor, with 1, 2, … motors; the last entry serves for more. Empty if it is not known.
    pub segment_ticks: Vec<SegmentTicks>,
    /// Where the row's figures come from: "estimate" until a bench on the firmware has printed them.
    pub source: String,
}

/// How long after one another a motor's segments may come that are in its queue, ticks. What their steps take, each the shortest interval,
/// comes on top.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SegmentTicks {
    /// A segment in the direction of the one before it.
    pub onward: u32,
    /// A segment in the other direction.
    pub turning: u32,
    /// Additional time for receiving either kind from the host. This work can wait while the queue lasts.
    pub heard: u32,
}

/// How a board makes the steps of motors that share a DIR line, if one after the other: those of all its motors then.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SharedSteps {
    /// Steps within this many ticks are made together.
    pub together_ticks: u32,
    /// Shortest time from a step to one that is not made together with it, ticks.
    pub apart_ticks: u32,
}
