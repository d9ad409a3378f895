//! One motor that obeys verbs: verbs → evenly spaced steps.
//!
//! Two steps are never closer than the period at the time of the second one. They are exactly that far apart, unless the motor stood
//! still, had no steps to make, or had to turn. An order acts from a tick `at` on: the next step then comes a (new) period after the
//! last one, or at `at` if that is later. So a new speed does not wait for the end of a long period.

use crate::{Direction, Item, Segment, Tick32};

/// An order to a motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verb {
    /// A number of steps. The move is finished, and reported, when the last step's period is over. While one move is under way, one more
    /// may wait. A motor that [runs](Verb::Run) makes this many steps more.
    Move {
        /// Any number. With 0 the move is finished when the period of the last step, of an earlier move, is over.
        steps: u32,
    },
    /// Steps without an end.
    Run,
    /// Sets the period: the ticks from one step to the next.
    Speed {
        /// From the motor's shortest to [`LONGEST_PERIOD`].
        ticks: u64,
    },
    /// Sets the direction.
    Heading(Heading),
    /// Drops the move or run, and a move that waits, without reports.
    Halt,
}

/// The direction in which a motor steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Heading {
    /// It stands still, and a move waits.
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

/// The limits of a motor's steps, ticks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MotorTiming {
    /// The shortest period, at least 1.
    pub shortest: u32,
    /// The shortest time from a step to a step in the other direction.
    pub turn: u32,
    /// The period until a [`Verb::Speed`] sets another, at least `shortest`.
    pub period: u32,
}

/// Why a verb is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refused {
    /// The period is shorter than the motor's shortest, or longer than [`LONGEST_PERIOD`].
    Period {
        /// The motor's shortest period, ticks.
        shortest: u32,
    },
    /// One move is under way and another waits; or [`MAX_UNREPORTED`] moves are unreported.
    Busy,
}

/// The longest period, ticks: a thousand years at 125 MHz. Two of them can still be added without overflow.
pub const LONGEST_PERIOD: u64 = 1 << 62;

/// The most items from one call of [`Motor::work_out`]: two moves, each an anchor, its first step, the other steps.
pub const MAX_ITEMS: usize = 6;

/// The most moves that are under way, waiting, or finished and not [reported](Motor::take_done). A further one is refused, because there is no
/// place to keep its time.
pub const MAX_UNREPORTED: u32 = 4;

/// After this many ticks without a step an anchor sets the channel's accumulator, because the channel can only compare
/// ticks within 2^30.
const STALE: u64 = 1 << 29;

/// What a motor is doing, or will do next.
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
    /// No step and no end of a move comes before this tick.
    open: u64,
    /// The last step.
    last: Option<(u64, Direction)>,
    /// The tick of the channel's accumulator.
    reached: Option<u64>,
    position: i32,
    /// Moves finished so far, as far as is worked out, wrapping.
    done: u32,
    /// How many of `dones`, from the first on, are not reported yet.
    unreported: u8,
    /// How many moves will [never be reported](Motor::mute_moves): the oldest of those that are unreported, under way or waiting.
    muted: u8,
    /// The last finished moves, newest first.
    dones: [Done; MAX_UNREPORTED as usize],
}

/// A finished move: its tick, and how many moves are finished with it, wrapping.
#[derive(Clone, Copy, Debug)]
struct Done {
    at: u64,
    number: u32,
}

impl Motor {
    /// A placeholder for a motor that a board does not have.
    pub const NONE: Motor = Motor::new(MotorTiming { shortest: 1, turn: 1, period: 1 }, 0, 0);

    /// A motor at rest, heading forward. No step comes before tick `open`.
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
            unreported: 0,
            muted: 0,
            dones: [Done { at: 0, number: 0 }; MAX_UNREPORTED as usize],
        }
    }

    /// A [`new`](Motor::new) motor in place of this one. Its moves count from 0. Unreported moves of this one are still reported first.
    #[must_use]
    pub const fn restarted(&self, limits: MotorTiming, position: i32, open: u64) -> Motor {
        let Motor { unreported, muted, dones, .. } = *self;
        Motor { unreported, muted, dones, ..Motor::new(limits, position, open) }
    }

    /// Obeys a verb from tick `at` on. `at` is not before the `until` of the last [`work_out`](Motor::work_out).
    ///
    /// # Errors
    /// Why the verb is refused. Then nothing changes.
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
        if job.is_move() && u32::from(self.unreported) + u32::from(self.job.is_move()) >= MAX_UNREPORTED {
            return Err(Refused::Busy);
        }
        match (self.job, self.waiting) {
            (Job::Rest | Job::Endless, _) => self.job = job,
            (Job::Steps(_), Job::Rest) => self.waiting = job,
            (Job::Steps(_), _) => return Err(Refused::Busy),
        }
        Ok(())
    }

    /// Drops all that would never end, for a motor that gets no more orders: a run, and a move of a motor whose heading is stationary.
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

    /// Never [reports](Motor::take_done) the moves so far, because the next host has not ordered them. They are still counted.
    pub const fn mute_moves(&mut self) {
        self.muted = self.moves();
    }

    /// How many moves are under way, waiting or unreported.
    const fn moves(&self) -> u8 {
        self.unreported + self.job.is_move() as u8 + self.waiting.is_move() as u8
    }

    /// Drops what the motor is doing and what waits.
    fn forget(&mut self) {
        (self.job, self.waiting) = (Job::Rest, Job::Rest);
        // The moves that are left are the oldest ones.
        self.muted = self.muted.min(self.moves());
    }

    /// Notes that the motor was stopped at once, and that no step began after tick `at`. It drops its orders, and moves that would have been
    /// finished later. Steps that were worked out may be missing, so that [`position`](Motor::position) is not valid any more.
    pub fn stop(&mut self, at: u64) {
        while self.unreported > 0 && self.dones[0].at > at {
            self.dones.rotate_left(1);
            self.unreported -= 1;
            self.done = self.done.wrapping_sub(1);
        }
        self.forget();
    }

    /// Works out the steps before tick `until`, which is less than 2^32 ticks after that of the last call. `push` gets them as items for a
    /// channel of `F` fraction bits.
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
            // It fits: steps that are 2^30 ticks apart or more have an anchor between them, or come with another call.
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

    /// The tick at which the last step's period is over.
    fn rested(&self) -> u64 {
        self.last.map_or(self.open, |(last, _)| self.open.max(last.saturating_add(self.period)))
    }

    /// Tick and direction of the next step; `None` while the heading is stationary.
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
        self.unreported += 1;
        self.dones.rotate_right(1);
        self.dones[0] = Done { at, number: self.done };
    }

    /// The oldest move that was finished by tick `now` and is neither reported nor [muted](Motor::mute_moves): its tick, and how many moves are
    /// finished with it, wrapping.
    pub fn take_done(&mut self, now: u64) -> Option<(u64, u32)> {
        loop {
            let Done { at, number } = self.oldest().filter(|done| done.at <= now)?;
            self.unreported -= 1;
            if self.muted == 0 {
                return Some((at, number));
            }
            self.muted -= 1;
        }
    }

    /// The tick at which the oldest unreported move is finished, as far as is worked out.
    #[must_use]
    pub fn next_done(&self) -> Option<u64> {
        self.oldest().map(|done| done.at)
    }

    fn oldest(&self) -> Option<Done> {
        self.dones.get(usize::from(self.unreported.checked_sub(1)?)).copied()
    }

    /// Whether all finished moves have been reported.
    #[must_use]
    pub const fn is_reported(&self) -> bool {
        self.unreported == 0
    }

    /// Steps forward minus steps backward that were worked out, wrapping.
    #[must_use]
    pub const fn position(&self) -> i32 {
        self.position
    }

    /// The tick of the next step, if no other order comes; `None` if there is none.
    #[must_use]
    pub fn next_step(&self) -> Option<u64> {
        let next = match (self.job, self.waiting) {
            (Job::Rest, _) | (Job::Steps(0), Job::Rest | Job::Steps(0)) => return None,
            _ => self.due(),
        };
        next.map(|(tick, _)| tick)
    }

    /// Whether nothing is left to work out: no step, no last period, no move that waits for a heading.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        self.job == Job::Rest && self.waiting == Job::Rest
    }

    /// Whether the motor [rests](Motor::is_at_rest) and its last move was finished by tick `now`.
    #[must_use]
    pub fn rests_at(&self, now: u64) -> bool {
        self.is_at_rest() && (self.is_reported() || self.dones[0].at <= now)
    }

    /// The interval from the last step to the next one, ticks, if no other order comes; `None` if one of them is missing.
    #[must_use]
    pub fn gap(&self) -> Option<u64> {
        Some(self.next_step()?.saturating_sub(self.last?.0))
    }
}

/// `whole` / `part`, rounded down, with `part` at least 1. It uses shifts, because boards have no division.
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
