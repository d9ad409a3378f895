//! One motor that takes orders directly: verbs → evenly spaced steps.
//!
//! Between two steps there is never less than the period that holds when the second one is made, and exactly that unless the
//! motor stood still, or had no steps to make, or had to turn. A verb counts from a tick on, `at`: the next step is then due a
//! (new) period after the last one, or at `at` if that is past. So a speed that was slow does not have to end first.

use crate::{Direction, Item, Segment, Tick32};

/// An order to a motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verb {
    /// So many steps, and then a done event, when the last one's period is over. Behind a move that is under way one more may
    /// wait; a motor that [runs](Verb::Run) makes so many more, and is done.
    Move {
        /// Any number; with 0 it is done when the last step's period is over, which may be that of a move before.
        steps: u32,
    },
    /// Steps without an end.
    Run,
    /// The period: exactly so many ticks from step to step.
    Speed {
        /// From the motor's shortest to [`LONGEST_PERIOD`].
        ticks: u64,
    },
    /// Which way.
    Heading(Heading),
    /// Forgets the move, or the run, and what waits behind it, without a done event.
    Halt,
}

/// Which way a motor goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Heading {
    /// It stands; a move waits.
    Stationary = 0,
    /// The position counts up.
    Forward = 1,
    /// It counts down.
    Backward = 2,
}

impl Heading {
    /// The direction; `None` if it stands.
    #[must_use]
    pub const fn direction(self) -> Option<Direction> {
        match self {
            Heading::Stationary => None,
            Heading::Forward => Some(Direction::Forward),
            Heading::Backward => Some(Direction::Backward),
        }
    }
}

/// What a motor's lines allow, ticks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MotorTiming {
    /// Shortest period, at least 1.
    pub shortest: u32,
    /// Fewest from a step to one the other way.
    pub turn: u32,
    /// The period until a [`Verb::Speed`] sets another, at least `shortest`.
    pub period: u32,
}

/// Why a verb is not obeyed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refused {
    /// The period is shorter than the motor's shortest, or longer than [`LONGEST_PERIOD`].
    Period {
        /// The shortest, ticks.
        shortest: u32,
    },
    /// A move waits behind the one that is under way, or [`MOST_UNTOLD`] moves would be done and not reported.
    Busy,
}

/// The longest period, ticks: a thousand years at 125 MHz.
pub const LONGEST_PERIOD: u64 = 1 << 62;

/// Items that [`Motor::work_out`] hands over at most: two moves, each an anchor, its first step, the others.
pub const MOST_ITEMS: usize = 6;

/// Moves that may be under way, waiting, or done and not [reported](Motor::take_done). No more are taken, so that the time
/// at which each was done is kept.
pub const MOST_UNTOLD: u32 = 4;

/// After this many ticks without a step an anchor sets the channel's accumulator, because the channel can only compare
/// ticks within 2^30.
const STALE: u64 = 1 << 29;

/// The order that is under way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum Job {
    Rest,
    /// The number of steps that are left. With 0, the period of the last one is left.
    Steps(u32),
    Endless,
}

impl Job {
    const fn is_move(self) -> bool {
        matches!(self, Job::Steps(_))
    }
}

/// One motor.
///
/// ```
/// use pulsetrain_core::verbs::{MotorTiming, Motor, Verb};
/// let mut motor = Motor::new(MotorTiming { shortest: 10, turn: 20, period: 1000 }, 0, 0);
/// motor.obey(Verb::Move { steps: 3 }, 50).unwrap();
/// assert_eq!(motor.next_step(), Some(50));
/// motor.work_out::<32>(5000, |_| {});
/// assert_eq!(motor.position(), 3);
/// assert_eq!(motor.take_done(3049), None, "the last step's period is not over");
/// assert_eq!(motor.take_done(3050), Some((3050, 1)));
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Motor {
    limits: MotorTiming,
    period: u64,
    heading: Heading,
    job: Job,
    waiting: Job,
    /// Nothing happens before it.
    open: u64,
    /// The last step.
    last: Option<(u64, Direction)>,
    /// Where the channel's accumulator is.
    reached: Option<u64>,
    position: i32,
    /// Moves done so far, as far as was worked out, wrapping.
    done: u32,
    /// Of `dones`, from the first on, these were not reported yet.
    untold: u8,
    /// Of the moves that are not reported, wait or are under way, the oldest so many are [never reported](Motor::mute_moves).
    muted: u8,
    /// The last moves that were done, the newest first.
    dones: [Done; MOST_UNTOLD as usize],
}

/// A move that is done: when, and how many then are, wrapping.
#[derive(Clone, Copy, Debug)]
struct Done {
    at: u64,
    number: u32,
}

impl Motor {
    /// Of no board.
    pub const NONE: Motor = Motor::new(MotorTiming { shortest: 1, turn: 1, period: 1 }, 0, 0);

    /// A motor at rest, facing forward; nothing happens before tick `open`.
    #[must_use]
    pub const fn new(limits: MotorTiming, position: i32, open: u64) -> Motor {
        Motor {
            limits,
            period: limits.period as u64,
            heading: Heading::Forward,
            job: Job::Rest,
            waiting: Job::Rest,
            open,
            last: None,
            reached: None,
            position,
            done: 0,
            untold: 0,
            muted: 0,
            dones: [Done { at: 0, number: 0 }; MOST_UNTOLD as usize],
        }
    }

    /// A [`new`](Motor::new) one in this one's place: moves count from 0, and those that were done and not reported yet are still reported first.
    #[must_use]
    pub const fn restarted(&self, limits: MotorTiming, position: i32, open: u64) -> Motor {
        let Motor { untold, muted, dones, .. } = *self;
        Motor { untold, muted, dones, ..Motor::new(limits, position, open) }
    }

    /// Does what a verb says from tick `at` on: not before what was [worked out](Motor::work_out).
    ///
    /// # Errors
    /// When it cannot be; nothing changes then.
    pub fn obey(&mut self, verb: Verb, at: u64) -> Result<(), Refused> {
        match verb {
            Verb::Move { steps } => self.begin(Job::Steps(steps))?,
            Verb::Run => self.begin(Job::Endless)?,
            Verb::Speed { ticks } if u64::from(self.limits.shortest) <= ticks && ticks <= LONGEST_PERIOD => {
                self.period = ticks;
            }
            Verb::Speed { .. } => return Err(Refused::Period { shortest: self.limits.shortest }),
            Verb::Heading(heading) => self.heading = heading,
            Verb::Halt => self.forget(),
        }
        self.open = self.open.max(at);
        Ok(())
    }

    fn begin(&mut self, job: Job) -> Result<(), Refused> {
        if job.is_move() && u32::from(self.untold) + u32::from(self.job.is_move()) >= MOST_UNTOLD {
            return Err(Refused::Busy);
        }
        match (self.job, self.waiting) {
            (Job::Rest | Job::Endless, _) => self.job = job,
            (Job::Steps(_), Job::Rest) => self.waiting = job,
            (Job::Steps(_), _) => return Err(Refused::Busy),
        }
        Ok(())
    }

    /// No order will come any more: it drops what would have no end, a run, and a move that waits for a way to go; what waits behind a move
    /// that has an end, or the move itself.
    pub fn drop_endless(&mut self) {
        let stands = self.heading == Heading::Stationary;
        let ends = |job| match job {
            Job::Rest => true,
            Job::Steps(left) => left == 0 || !stands,
            Job::Endless => false,
        };
        if !ends(self.job) {
            self.forget();
        } else if !ends(self.waiting) {
            self.waiting = Job::Rest;
            self.muted = self.muted.min(self.moves());
        }
    }

    /// The host that gave the orders is gone, and the next one does not know them: moves so far are never [reported](Motor::take_done). They
    /// count all the same.
    pub const fn mute_moves(&mut self) {
        self.muted = self.moves();
    }

    /// Moves that are under way, wait, or were not reported.
    const fn moves(&self) -> u8 {
        self.untold + self.job.is_move() as u8 + self.waiting.is_move() as u8
    }

    /// It has nothing to do any more.
    fn forget(&mut self) {
        (self.job, self.waiting) = (Job::Rest, Job::Rest);
        // Those that are left are the oldest.
        self.muted = self.muted.min(self.moves());
    }

    /// It was stopped at once, and no step was begun after tick `at`: it has nothing to do, and no move was done later. What comes of it
    /// is not worked out: [`position`](Motor::position) is no more where it stands.
    pub fn stop(&mut self, at: u64) {
        while self.untold > 0 && self.dones[0].at > at {
            self.dones.rotate_left(1);
            self.untold -= 1;
            self.done = self.done.wrapping_sub(1);
        }
        self.forget();
    }

    /// Works out what it does up to tick `until` (not included; less than 2^32 after the last call's), and hands it over as items
    /// for a channel of `F` fraction bits.
    pub fn work_out<const F: u32>(&mut self, until: u64, mut push: impl FnMut(Item)) {
        loop {
            match self.job {
                Job::Rest if self.waiting == Job::Rest => return,
                Job::Rest => (self.job, self.waiting) = (self.waiting, Job::Rest),
                Job::Steps(0) => {
                    let due = self.rested();
                    if due >= until {
                        return;
                    }
                    self.job = Job::Rest;
                    self.note_done(due);
                }
                Job::Steps(_) | Job::Endless => {
                    let Some((first, direction)) = self.due().filter(|(first, _)| *first < until) else { return };
                    let span = u32::try_from(until - 1 - first).unwrap_or(u32::MAX);
                    let mut count = times(span, self.period).saturating_add(1);
                    if let Job::Steps(left) = &mut self.job {
                        count = count.min(*left);
                        *left -= count;
                    }
                    self.make::<F>(first, count, direction, &mut push);
                }
            }
        }
    }

    /// Hands over `count` steps, the first at tick `first`.
    fn make<const F: u32>(&mut self, first: u64, count: u32, direction: Direction, push: &mut impl FnMut(Item)) {
        let run = |count: u32, ticks: u64| {
            // Fewer than 2^30 ticks: what is further apart has an anchor, or comes with another call.
            let segment = Segment { count, interval: (ticks << F).cast_signed(), add: 0, add2: 0 };
            Item::Run { segment, direction }
        };
        let mut gap = self.reached.map_or(STALE, |reached| first - reached);
        if gap >= STALE {
            push(Item::Anchor { tick: Tick32::of(first).before(1) });
            gap = 1;
        }
        let last = first + u64::from(count - 1) * self.period;
        if gap == self.period || count == 1 {
            push(run(count, gap));
        } else {
            push(run(1, gap));
            push(run(count - 1, self.period));
        }
        (self.last, self.reached) = (Some((last, direction)), Some(last));
        let moved = count.cast_signed();
        self.position = match direction {
            Direction::Forward => self.position.wrapping_add(moved),
            Direction::Backward => self.position.wrapping_sub(moved),
        };
    }

    /// When the last step's period is over.
    fn rested(&self) -> u64 {
        self.last.map_or(self.open, |(last, _)| self.open.max(last.saturating_add(self.period)))
    }

    /// When the next step is due, and which way it goes; `None` while the motor stands.
    fn due(&self) -> Option<(u64, Direction)> {
        let direction = self.heading.direction()?;
        let turned = match self.last {
            Some((last, facing)) if facing != direction => last.saturating_add(u64::from(self.limits.turn)),
            _ => 0,
        };
        Some((self.rested().max(turned), direction))
    }

    fn note_done(&mut self, at: u64) {
        self.done = self.done.wrapping_add(1);
        self.untold += 1;
        self.dones.rotate_right(1);
        self.dones[0] = Done { at, number: self.done };
    }

    /// The oldest move that was done by tick `now` and was not reported yet, nor is [muted](Motor::mute_moves): when, and how many are done with
    /// it, wrapping.
    pub fn take_done(&mut self, now: u64) -> Option<(u64, u32)> {
        loop {
            let Done { at, number } = self.oldest().filter(|done| done.at <= now)?;
            self.untold -= 1;
            if self.muted == 0 {
                return Some((at, number));
            }
            self.muted -= 1;
        }
    }

    /// When the oldest move that was worked out, and not reported yet, is done.
    #[must_use]
    pub fn next_done(&self) -> Option<u64> {
        self.oldest().map(|done| done.at)
    }

    fn oldest(&self) -> Option<Done> {
        self.dones.get(usize::from(self.untold.checked_sub(1)?)).copied()
    }

    /// Whether all moves that were worked out have been reported as done.
    #[must_use]
    pub const fn is_told(&self) -> bool {
        self.untold == 0
    }

    /// Steps forward less steps backward that were worked out, wrapping.
    #[must_use]
    pub const fn position(&self) -> i32 {
        self.position
    }

    /// When the next step comes, if no other order comes; `None` if none does, now, or at all.
    #[must_use]
    pub fn next_step(&self) -> Option<u64> {
        let next = match (self.job, self.waiting) {
            (Job::Rest, _) | (Job::Steps(0), Job::Rest | Job::Steps(0)) => return None,
            _ => self.due(),
        };
        next.map(|(tick, _)| tick)
    }

    /// Whether nothing is left to work out, not even a last period, or a wait until it has a heading.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        self.job == Job::Rest && self.waiting == Job::Rest
    }

    /// The same by tick `now`: what it did last is done by then, too.
    #[must_use]
    pub fn rests_at(&self, now: u64) -> bool {
        self.is_at_rest() && (self.is_told() || self.dones[0].at <= now)
    }

    /// How long after its last step the next one comes, ticks, if no other order comes; `None` if none does, or there was none.
    #[must_use]
    pub fn gap(&self) -> Option<u64> {
        Some(self.next_step()?.saturating_sub(self.last?.0))
    }
}

/// How many times `part` (at least 1) goes into `whole`, by shifts: boards have no division.
fn times(whole: u32, part: u64) -> u32 {
    let Some(part) = u32::try_from(part).ok().filter(|part| *part <= whole) else { return 0 };
    let (mut rest, mut count) = (whole, 0);
    let mut shift = part.leading_zeros() - whole.leading_zeros();
    loop {
        if let Some(left) = rest.checked_sub(part << shift) {
            rest = left;
            count |= 1 << shift;
        }
        if shift == 0 {
            return count;
        }
        shift -= 1;
    }
}
