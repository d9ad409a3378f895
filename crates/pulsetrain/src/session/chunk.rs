//! Epochs: as much of the plan as fits, with a tail; pushed, and switched to.

use super::items::{Items, Timed};
use super::source::Standing;
use super::timeline::Placed;
use super::{Session, SessionError};
use pulsetrain_board::Board;
use pulsetrain_core::Entry;
use std::collections::VecDeque;

/// One in so many places of a queue is kept free for a stop or a change, where there are enough of them; the other, if that leaves more
/// time for a silence. Those that are too short for that are at their tail soon.
pub(super) const RESERVES: [usize; 2] = [4, 8];

/// What an item takes of the queue, and the tick at which it leaves it.
pub(super) type Taken = (u64, usize);

/// An epoch on its way to the board.
#[derive(Debug)]
pub(super) struct Chunk {
    pub(super) from: u64,
    /// Where its tail begins.
    until: u64,
    /// Whether the plan ends in it.
    is_last: bool,
    /// Steps of each motor, with the tail.
    steps: Vec<Vec<Placed>>,
    /// When the items are taken, and what they take until then.
    taken: Vec<Vec<Taken>>,
    /// Items that are still to be pushed.
    unsent: Vec<VecDeque<Timed>>,
}

impl<B: Board> Session<'_, B> {
    /// What comes after the tail's beginning: as much as fits by then, in time for a silence if the queues hold so much.
    pub(super) fn next_chunk(&mut self) -> Result<Chunk, SessionError> {
        // Not much more than the last one had: what does not fit was planned in vain.
        self.margin = self.pace.margin.min(self.margin + self.margin / 3);
        self.reserve = RESERVES[0];
        loop {
            let deadline = self.deadline(self.tail);
            let left = self.taken.iter().map(|taken| {
                let later = taken.iter().filter(|(tick, _)| *tick > deadline);
                later.map(|(_, size)| size).sum::<usize>()
            });
            let rooms: Vec<usize> = self
                .capacity
                .iter()
                .zip(left)
                .map(|(capacity, left)| capacity.saturating_sub(self.spare(*capacity) + left))
                .collect();
            match self.chunk_within(self.tail, &rooms, self.pace.shortest_with(self.margin)) {
                Err(SessionError::QueueTooShort { .. }) if self.hurry() => {}
                chunk => return chunk,
            }
        }
    }

    /// For a queue that is too short: less is kept free, then there is less time for a silence, at last for telling the board. `false` if
    /// there is no more to win.
    fn hurry(&mut self) -> bool {
        let [more, less] = RESERVES;
        let least = self.pace.least_margin();
        if self.reserve == more && !self.pace.is_hurried() {
            self.reserve = less;
        } else if self.margin > least {
            (self.reserve, self.margin) = (more, least.max(self.margin - self.margin / 8));
        } else if self.pace.hurry() {
            self.margin = self.pace.least_margin();
        } else {
            return false;
        }
        true
    }

    /// The longest chunk from tick `from` that fits, nearly: `shortest` at least.
    pub(super) fn chunk_within(&mut self, from: u64, rooms: &[usize], shortest: u64) -> Result<Chunk, SessionError> {
        let most = self.capacity.iter().min().map_or(1, |capacity| capacity / 2);
        // Not much longer than the last one, for the same reason.
        let limit = if self.length == 0 { self.pace.chunk } else { self.pace.chunk.min(2 * self.length) };
        let (until, is_last) = self.source.read_ahead(from, from + limit.max(shortest), most)?;
        let too_short = match self.fitting(from, until, is_last, rooms)? {
            Ok(chunk) => return Ok(chunk),
            Err(error) => error,
        };
        // Between the longest that is known to fit and the shortest that does not.
        let (mut fits, mut too_long) = (from + shortest, until);
        if fits >= too_long {
            return Err(too_short);
        }
        let mut longest = self.fitting(from, fits, false, rooms)??;
        while too_long - fits > (fits - from) / 8 {
            let middle = fits + (too_long - fits) / 2;
            match self.fitting(from, middle, false, rooms)? {
                Ok(chunk) => (fits, longest) = (middle, chunk),
                Err(_) => too_long = middle,
            }
        }
        Ok(longest)
    }

    /// The epoch from `from` on, whose tail begins at `until`, if the rooms hold it.
    fn fitting(
        &mut self,
        from: u64,
        until: u64,
        is_last: bool,
        rooms: &[usize],
    ) -> Result<Result<Chunk, SessionError>, SessionError> {
        let chunk = self.chunk(from, until, is_last)?;
        let needs = chunk.unsent.iter().map(size_of).zip(rooms).enumerate();
        let short = needs.filter(|(_, (needed, room))| needed > room).max_by_key(|(_, (needed, _))| *needed);
        Ok(match short {
            Some((motor, (needed, &room))) => Err(self.too_short(motor, needed, room, from, until)),
            None => Ok(chunk),
        })
    }

    /// The epoch from `from` on, whose tail begins at `until`.
    pub(super) fn chunk(&mut self, from: u64, until: u64, is_last: bool) -> Result<Chunk, SessionError> {
        let motors = self.timelines.len();
        let mut steps: Vec<Vec<Placed>> = (0..motors).map(|motor| self.source.steps_before(motor, until)).collect();
        let mut items: Vec<Items> = (0..motors)
            .map(|motor| {
                let mut items = Items::new(from, self.pace.fraction_bits, self.board.sizer(motor));
                steps[motor].iter().for_each(|placed| items.add(placed));
                items
            })
            .collect();
        if !is_last {
            let standing: Vec<Standing> = (0..motors)
                .map(|motor| {
                    let mut timeline = self.timelines[motor].clone();
                    timeline.replace(from, &steps[motor]);
                    Standing {
                        count: timeline.count_before(until).unwrap_or(0),
                        last_step: timeline.last_before(until),
                        told: items[motor].told(until),
                    }
                })
                .collect();
            for ((steps, items), tail) in
                steps.iter_mut().zip(&mut items).zip(self.source.tails(until, &standing, self.pace.is_hurried())?)
            {
                tail.iter().for_each(|placed| items.add(placed));
                steps.extend(tail);
            }
        }
        let unsent: Vec<VecDeque<Timed>> = items.into_iter().map(|items| items.finish().into()).collect();
        let taken = unsent.iter().map(|items| items.iter().map(|timed| (timed.taken, timed.size)).collect()).collect();
        Ok(Chunk { from, until, is_last, steps, taken, unsent })
    }

    /// What is to stay free of an empty queue.
    fn spare(&self, capacity: usize) -> usize {
        if self.pace.is_hurried() { 0 } else { (capacity / self.reserve).max(1) }
    }

    /// Pushes what there is room for, but for what is to stay free if it `keeps` that; `true` when nothing of the chunk is
    /// left.
    pub(super) fn push(&mut self, chunk: &mut Chunk, keeps: bool) -> bool {
        let epoch = self.epoch.next();
        for (motor, unsent) in chunk.unsent.iter_mut().enumerate() {
            let kept = if keeps { self.spare(self.capacity[motor]) } else { 0 };
            while let Some(timed) = unsent.front().filter(|timed| self.board.room(motor) >= kept + timed.size) {
                if self.board.push(motor, Entry { epoch, item: timed.item }).is_err() {
                    break;
                }
                unsent.pop_front();
            }
        }
        chunk.unsent.iter().all(VecDeque::is_empty)
    }

    /// Sends a chunk that must be in the queue at once.
    pub(super) fn send(&mut self, mut chunk: Chunk) -> Result<(), SessionError> {
        if self.push(&mut chunk, false) {
            return self.switch(chunk);
        }
        self.board.discard(self.epoch.next());
        let (from, until) = (chunk.from, chunk.until);
        let needed = chunk.taken.iter().map(|taken| taken.iter().map(|(_, size)| size).sum::<usize>());
        let unsent = needed.zip(chunk.unsent.iter().map(size_of)).enumerate();
        let short = unsent.max_by_key(|(_, (_, unsent))| *unsent);
        let (motor, (needed, unsent)) = short.unwrap_or_default();
        Err(self.too_short(motor, needed, needed - unsent, from, until))
    }

    fn too_short(&self, motor: usize, needed: usize, room: usize, from: u64, until: u64) -> SessionError {
        let seconds = |ticks: u64| ticks as f64 / self.pace.tick_hz as f64;
        SessionError::QueueTooShort {
            motor,
            at_s: seconds(from.saturating_sub(self.source.zero())),
            span_s: seconds(until.saturating_sub(from)),
            capacity: self.capacity.get(motor).copied().unwrap_or(0),
            needed,
            room,
        }
    }

    /// Has the board go over to a chunk that is in its queue.
    pub(super) fn switch(&mut self, chunk: Chunk) -> Result<(), SessionError> {
        let epoch = self.epoch.next();
        if let Err(refused) = self.board.switch(epoch, chunk.from) {
            let Some(why) = self.board.lost().cloned() else { return Err(SessionError::Switch(refused)) };
            // It may have been accepted all the same.
            let counts = self.timelines.iter().zip(&chunk.steps).map(|(timeline, steps)| {
                let mut timeline = timeline.clone();
                timeline.replace(chunk.from, steps);
                timeline.count_before(u64::MAX).unwrap_or(0)
            });
            self.unanswered = Some(counts.collect());
            return Err(SessionError::Lost(why));
        }
        let now = self.board.now();
        for (timeline, steps) in self.timelines.iter_mut().zip(&chunk.steps) {
            timeline.replace(chunk.from, steps);
            timeline.forget(now.saturating_sub(self.pace.chunk));
        }
        self.source.drop_before(chunk.until);
        self.waiting.retain(|begins| *begins > now && *begins < chunk.from);
        self.waiting.push_back(chunk.from);
        (self.epoch, self.tail) = (epoch, chunk.until);
        self.length = chunk.until - chunk.from;
        for (taken, next) in self.taken.iter_mut().zip(chunk.taken) {
            taken.retain(|(tick, _)| *tick > now);
            // What is left of the epochs before goes then.
            taken.iter_mut().for_each(|(tick, _)| *tick = chunk.from.min(*tick));
            taken.extend(next);
        }
        self.complete = chunk.is_last;
        Ok(())
    }
}

/// What items take of a queue.
fn size_of(items: &VecDeque<Timed>) -> usize {
    items.iter().map(|timed| timed.size).sum()
}
