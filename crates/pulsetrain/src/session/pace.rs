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
    hurried: bool,
    /// Shorter epochs are over before the next one is there.
    pub(super) shortest: u64,
    /// Most that one epoch brings.
    pub(super) chunk: u64,
    /// Enough to have in the queue.
    pub(super) ahead: u64,
    /// A switch is sent so long before its tick where the queue holds that: a silence, and all that it takes to make up for it.
    pub(super) margin: u64,
    /// How much later, at most, a change is asked for that was planned too late.
    pub(super) spare: u64,
}

/// A silence of the line or of the host that changes no step, where the queues hold enough, ms.
const SILENCE_MS: u64 = 100;

/// An epoch is at least one in so many of the margin of the one behind it: a switch costs a tail on the line.
const SHARE: u64 = 3;

impl Pace {
    /// For a board that needs `link` ticks to be told, and `hurry` at least.
    pub(super) fn of(program: &Program, link: u64, hurry: u64) -> Pace {
        let tick_hz = program.board.tick_hz;
        let reversals = program.motors.iter().map(|motor| program.timing(motor).ticks(tick_hz).reversal());
        // Boards tell ticks apart within 2^30.
        let within = |ticks: u64| ticks.clamp(1, 1 << 28);
        let lead = reversals.max().unwrap_or(0) + 1;
        Pace {
            tick_hz,
            fraction_bits: program.board.fraction_bits,
            lead,
            link,
            hurry,
            hurried: false,
            shortest: (8 * lead).max(2 * link),
            chunk: within(tick_hz / 4),
            ahead: within(tick_hz / 2),
            // What was lost is repeated within `link`, and is there as soon as if all went well.
            margin: within(tick_hz * SILENCE_MS / 1000) + link + hurry + lead,
            spare: within(tick_hz / 20),
        }
    }

    /// The least before a switch that leaves time for telling it.
    pub(super) const fn least_margin(&self) -> u64 {
        self.lead + self.link
    }

    /// The shortest epoch whose switch is sent `margin` ahead.
    pub(super) fn shortest_with(&self, margin: u64) -> u64 {
        if margin > self.least_margin() { self.shortest.max(margin / SHARE) } else { self.shortest }
    }

    /// For a queue that is too short: first it keeps nothing free, then it does not wait for what goes wrong on the way, at
    /// last it hardly waits at all. `false` if there is no more to win.
    pub(super) fn hurry(&mut self) -> bool {
        let least = self.hurry - self.hurry / 3;
        if !self.hurried {
            self.hurried = true;
        } else if self.link > self.hurry {
            self.link = self.hurry;
        } else if self.link > least {
            self.link = least;
        } else {
            return false;
        }
        self.shortest = (8 * self.lead).max(self.link.min(self.hurry));
        true
    }

    pub(super) const fn is_hurried(&self) -> bool {
        self.hurried
    }

    /// How often to look whether there is room.
    pub(super) fn look(&self) -> u64 {
        self.link.min(self.tick_hz / 640)
    }

    pub(super) fn is_unlike(&self, other: &Pace) -> bool {
        (self.tick_hz, self.fraction_bits) != (other.tick_hz, other.fraction_bits)
    }
}
