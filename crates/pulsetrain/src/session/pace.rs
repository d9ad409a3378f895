//! How far ahead a session works.

use pulsetrain_motion::program::Program;

/// How far ahead things are done, ticks.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pace {
    pub(super) tick_hz: u64,
    pub(super) fraction_bits: u32,
    /// How long before a step a board must know of it: DIR setup, and the pulse and hold before.
    pub(super) lead: u64,
    /// How long telling the board takes.
    pub(super) link: u64,
    /// And at least, if all goes well: what a queue makes do with in which no more has room.
    pub(super) hurry: u64,
    /// Shorter epochs are over before the next one is there.
    pub(super) shortest: u64,
    /// Most that one epoch brings.
    pub(super) chunk: u64,
    /// Enough to have in the queue.
    pub(super) ahead: u64,
    /// A switch is sent at least so long before its tick, if the epoch before is long enough.
    pub(super) margin: u64,
}

impl Pace {
    /// For a board that needs `link` ticks to be told, and `hurry` at least.
    pub(super) fn of(program: &Program, link: u64, hurry: u64) -> Pace {
        let tick_hz = program.board.tick_hz;
        let reversals = program.motors.iter().map(|motor| motor.timing.ticks(tick_hz).reversal());
        // Boards tell ticks apart within 2^30.
        let within = |ticks: u64| ticks.clamp(1, 1 << 28);
        let lead = reversals.max().unwrap_or(0) + 1;
        Pace {
            tick_hz,
            fraction_bits: program.board.fraction_bits,
            lead,
            link,
            hurry,
            shortest: (8 * lead).max(2 * link),
            chunk: within(tick_hz / 4),
            ahead: within(tick_hz / 2),
            margin: within(tick_hz / 20),
        }
    }

    /// For a queue that is too short to wait for what goes wrong on the way. `false` if it is so already.
    pub(super) fn hurry(&mut self) -> bool {
        let before = self.link;
        self.link = self.hurry.min(self.link);
        self.shortest = (8 * self.lead).max(self.link);
        self.link < before
    }

    /// How often to look whether there is room.
    pub(super) fn look(&self) -> u64 {
        self.link.min(self.tick_hz / 640)
    }

    pub(super) fn is_unlike(&self, other: &Pace) -> bool {
        (self.tick_hz, self.fraction_bits) != (other.tick_hz, other.fraction_bits)
    }
}
