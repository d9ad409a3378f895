//! Braking in few bytes: steps whose exact ticks do not matter, but whose speed and deceleration do.
//!
//! Most of a tail are records of two bytes, each of which halves v² within 2^m steps ([`State::slow`]): the deceleration falls
//! to a third within a part, and the next part begins with nearly as much as the one before. As m is a whole number, the first
//! one may be too gentle by half; then a segment before it brings the motor to the speed at which it is not. Where no such
//! record will do (too fast for the largest m, or so slow that its registers would overflow), segments are designed.
//!
//! # Designed segments
//! Under a constant deceleration the time of a step is a square root, and no recurrence follows that for long. But a
//! tail need not brake evenly: it must not brake harder than it may. So each segment lets the deceleration rise to the
//! limit and fall again, as far as a cubic can; the next goes on from there. Fast motors lose most of the time at the
//! beginning, so that the first segments are kept close to the limit, and the later ones are longer.
//!
//! What a segment is to be comes from floats. What it is, is replayed in its integers, step by step: it ends before a
//! step that would break a limit.

use crate::Move;
use crate::planner::{LONGEST_WAIT_TICKS, LOOSEST_FIT_TICKS};
use crate::settings::Settings;
use pulsetrain_core::packing::{LONGEST_SLOW, MAX_PACKED_LEN, Packing, State};
use pulsetrain_core::{Direction, Item, Segment};

/// Of the limit, what a segment is designed for: the rest is for rounding, and for steps that are far apart.
const DESIGN: f64 = 0.97;
/// The first segment ends where the deceleration falls below this part of the limit, tried in this order; each
/// further one below [`SLACKENING`] of the part before.
const LEAST_PARTS: [f64; 4] = [0.5, 0.35, 0.25, 0.15];
const SLACKENING: f64 = 0.75;
/// What going on without a jump in interval and add is worth, as an exponent to how much slower a segment becomes: it
/// takes fewer bytes.
const FRESH: f64 = 0.8;
/// Few enough segments, the first step included.
const FEW: usize = 6;
/// A tail of more segments is no short one, unless it has no more steps than that.
const MOST: usize = 40;
/// Most steps in one segment.
const LONGEST: u32 = u16::MAX as u32;

/// Of the limit, what a record that slows down may begin with: the rest is for rounding.
const SLOWS: f64 = 0.995;
/// If it begins with less, a segment that leads to more is worth its bytes.
const GENTLE: f64 = 0.85;
/// And so many bytes at most, before the first such record.
const DEAR: usize = 9;
/// Intervals that differ by no more are the same.
const STEADY_TICKS: f64 = 1.0 / 16.0;
/// Of the limit, what the plan's own next step may ask for: where the limit is the most that the plan asked for, rounding may be beyond.
const EVEN: f64 = 1.0005;
/// Parts of so few steps need not brake hard.
const FEW_STEPS: u32 = 2;

/// What a board has been told before the tail.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Told {
    /// The accumulator after the last step or wait, ticks · 2^F from the beginning of the tail.
    pub accumulator: i64,
    /// What the packed stream predicts of the next segment.
    pub state: State,
}

/// How a motor is to be brought to rest. Ticks and steps.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Brake {
    /// When the first step is due, ticks from the tail's beginning.
    pub(crate) first: f64,
    /// The same if not braked before it.
    pub(crate) unbraked: (f64, f64),
    /// The speed at that step, steps/tick, in the direction of motion.
    pub(crate) speed: f64,
    /// Largest deceleration, steps/tick².
    pub(crate) limit: f64,
    /// At this speed and below the motor may stop at once, steps/tick.
    pub(crate) pull_in: f64,
    /// Bytes count for more than time.
    pub(crate) brief: bool,
    pub(crate) direction: Direction,
}

impl Brake {
    /// The moves to rest, the first after fraction ½; `None` if they do not fit few segments.
    pub(crate) fn moves(&self, settings: &Settings) -> Option<Vec<Move>> {
        let tries = LEAST_PARTS.iter().filter_map(|part| self.segments(*part, settings));
        let mut best: Option<Vec<Segment>> = None;
        for segments in tries {
            if best.as_ref().is_none_or(|best| segments.len() < best.len()) {
                best = Some(segments);
            }
            if best.as_ref().is_some_and(|best| best.len() <= FEW) {
                break;
            }
        }
        best.map(|segments| self.runs(segments))
    }

    /// Mean speed of the last interval: from there a motor comes to rest within a step, or at once.
    fn at_rest(&self) -> f64 {
        self.pull_in.max((2.0 * self.limit).sqrt())
    }

    fn segments(&self, least_part: f64, settings: &Settings) -> Option<Vec<Segment>> {
        let scale = (1u64 << settings.fraction_bits) as f64;
        let longest = f64::from(LONGEST_WAIT_TICKS) - 1.0;
        if self.first >= longest {
            return None;
        }
        let mut segments = vec![Segment::single(((self.first * scale) as i64).max(1))];
        if self.is_slow() {
            return Some(segments);
        }
        let mut design = self.design(settings)?;
        // The interval after the first step, as if braked evenly.
        design.state.interval = (self.second() * scale).ceil() as i64;
        if (self.second() as u64) < settings.min_interval_ticks {
            return None;
        }
        let mut part = least_part;
        while design.goes_on() {
            if segments.len() == MOST {
                return None;
            }
            design.brake(&mut part, &mut segments)?;
        }
        Some(segments)
    }

    /// The moves to rest that go on from what the board was `told`: they begin where its accumulator is. `None` if they
    /// do not fit few segments.
    pub(crate) fn onward(&self, told: &Told, settings: &Settings) -> Option<Vec<Move>> {
        let scale = (1u64 << settings.fraction_bits) as f64;
        let mut design = self.design(settings)?;
        design.state = if told.state.direction == self.direction { told.state } else { State::new(self.direction) };
        let mut segments = Vec::new();

        // Where the plan was to go on as predicted, the motor does so for one step more.
        let (first, speed) = self.unbraked;
        let State { interval, add, add2, .. } = design.state;
        let before = interval - add + add2;
        let due = told.accumulator.checked_add(interval)? as f64;
        // The plan's own step comes within its tolerance of the law's.
        let latest = self.first + 1.0 + settings.tolerance_ticks.min(LOOSEST_FIT_TICKS);
        let on_time = (0.0..=latest * scale).contains(&due);
        // By the law, in whose tolerance the plan is; and by what was said, which need not have been one interval.
        let lawful = (scale / speed) as i64;
        if !on_time || !design.goes_evenly(before) || !(design.is_within(lawful, 1.0) || design.goes_evenly(lawful)) {
            // Not before the tail begins.
            let wanted = (first * scale - told.accumulator as f64).max(1.0 - told.accumulator as f64);
            segments.push(design.single(wanted)?);
        }
        let slow = Brake { speed, ..*self };
        if slow.is_slow() {
            if segments.is_empty() {
                segments.push(design.single(interval as f64)?);
            }
            return Some(self.runs(segments));
        }
        let enough = settings.min_interval_ticks as f64 * scale;
        if !segments.is_empty() {
            design.last = None;
            // Nor is it to go on speeding up: that step need not have come as early as the plan had it.
            let brakes = design.state.interval >= lawful && design.goes_evenly(lawful);
            if !(brakes || design.is_within(lawful, 1.0)) || (design.state.interval as f64) < enough {
                segments.push(design.single(slow.second() * scale)?);
            }
        } else if (interval as f64) < enough {
            return None;
        }
        let mut part = LEAST_PARTS[0];
        while design.goes_on() {
            if segments.len() == MOST {
                return None;
            }
            design.brake(&mut part, &mut segments)?;
        }
        Some(self.runs(segments))
    }

    fn runs(&self, segments: Vec<Segment>) -> Vec<Move> {
        let run = |segment| Move::Run { segment, direction: self.direction };
        segments.into_iter().map(run).collect()
    }

    /// Whether the motor is at rest one step after the first.
    fn is_slow(&self) -> bool {
        self.speed <= self.at_rest() || self.speed * self.speed <= 2.0 * self.limit
    }

    /// The interval after the first step if braked evenly, ticks.
    fn second(&self) -> f64 {
        let root = (self.speed * self.speed - 2.0 * self.limit).max(0.0).sqrt();
        2.0 / (self.speed + root)
    }

    /// Nothing predicted yet; `None` if rest is slower than the longest interval.
    fn design(&self, settings: &Settings) -> Option<Design> {
        let scale = (1u64 << settings.fraction_bits) as f64;
        let slowest = (1.0 / self.at_rest()).min(f64::from(LONGEST_WAIT_TICKS) - 1.0);
        if slowest * self.at_rest() < 0.99 && !self.is_slow() {
            return None;
        }
        Some(Design {
            limit: self.limit * scale.powi(-2),
            scale,
            last: None,
            slowest: (slowest * scale).ceil(),
            largest: if settings.fraction_bits <= 16 { f64::from(i32::MAX) } else { 1e17 },
            packing: settings.gain().map(|gain| Packing { fraction_bits: settings.fraction_bits, gain }),
            state: State { previous_count: u32::MAX, ..State::new(self.direction) },
            brief: self.brief,
            parts: 0,
        })
    }
}

/// What is chosen of the next segment, ticks · 2^F throughout.
struct Design {
    /// Largest deceleration, steps/(ticks · 2^F)².
    limit: f64,
    scale: f64,
    /// The interval before the last step.
    last: Option<i64>,
    /// The interval that is rest.
    slowest: f64,
    /// Largest |add| and |add2|.
    largest: f64,
    packing: Option<Packing>,
    /// What the next segment goes on with for no bytes; a count of `u32::MAX` says that nothing is known of the units.
    state: State,
    /// Parts of two bytes so far.
    parts: u32,
    /// No segment leads to such a part if one will do without.
    brief: bool,
}

impl Design {
    /// Adds what comes next: a part of two bytes if there is one, or else the segment that gets furthest.
    fn brake(&mut self, least: &mut f64, segments: &mut Vec<Segment>) -> Option<()> {
        let next = match self.slow() {
            Some(segment) => segment,
            None => {
                let before = self.state;
                let next = self.next(*least).or_else(|| {
                    // In units that corrections do not have.
                    self.state.previous_count = u32::MAX;
                    self.next(*least)
                });
                if next.is_none() {
                    self.state = before;
                }
                *least *= SLACKENING;
                next?
            }
        };
        segments.push(next);
        Some(())
    }

    /// The segment that gets furthest before the deceleration falls below `part` of the limit.
    fn next(&mut self, part: f64) -> Option<Segment> {
        let limit = self.limit * DESIGN;
        let mut best: Option<(f64, Segment)> = None;
        let levels = (0..=6).map(|k| part + (1.0 - part) * f64::from(k) / 6.0);
        let fresh = levels.map(|level| self.fresh(level * limit));
        let onward = self.last.map(|_| (self.state.interval as f64, self.state.add as f64));
        // What was told before the tail need not have braked at all.
        let onward = onward.filter(|(interval, add)| add / interval.powi(3) >= 0.9 * part * limit);
        let from = self.last.unwrap_or(self.state.interval) as f64;
        let mut consider = |own: f64, segment: Option<Segment>| {
            let Some(segment) = segment.and_then(|segment| self.replayed(segment)) else { return };
            // Fewer bytes are worth a part of the way.
            let reached = (segment.after(segment.count - 1).interval as f64 / from).powf(own);
            if best.is_none_or(|(most, _)| reached > most) {
                best = Some((reached, segment));
            }
        };
        for (own, (interval, add)) in fresh.map(|pair| (FRESH, pair)).chain(onward.map(|pair| (1.0, pair))) {
            let steepest = Curve::steepest(interval, add, limit, self.largest);
            // Less bent, it may keep longer within its registers.
            for bend in [1.0, 0.25, 0.0] {
                let curve = Curve { add2: steepest.add2 * bend, ..steepest };
                let count = curve.falls_below(part * limit, self.slowest);
                consider(own, self.rounded(&curve, count));
            }
        }
        consider(FRESH, Some(self.one_step(limit)));
        let (_, segment) = best?;
        self.go_on(&segment);
        Some(segment)
    }

    /// Whether the motor is still too fast to rest.
    fn goes_on(&self) -> bool {
        self.last.is_none_or(|last| (last as f64) < self.slowest)
    }

    fn go_on(&mut self, segment: &Segment) {
        self.last = Some(segment.after(segment.count - 1).interval);
        let before = self.state;
        if let Some(packing) = self.packing.filter(|_| before.previous_count < u32::MAX) {
            let run = Item::Run { segment: *segment, direction: self.state.direction };
            // It has steps, and the buffer is long enough.
            let _ = packing.pack(&mut self.state, &run, &mut [0; MAX_PACKED_LEN]);
        } else {
            let Segment { interval, add, add2, .. } = segment.after(segment.count);
            self.state = State { previous_count: segment.count, interval, add, add2, ..before };
        }
    }

    /// Whether what is predicted is within the limit after an interval `before`, to either side, or nearly the same.
    fn goes_evenly(&self, before: i64) -> bool {
        let interval = self.state.interval;
        let is_even = || deceleration(before as f64, interval as f64).abs() <= EVEN * self.limit;
        before > 0 && interval > 0 && (self.is_within(before, STEADY_TICKS) || is_even())
    }

    /// Whether what is predicted is `interval`, to so many ticks.
    fn is_within(&self, interval: i64, ticks: f64) -> bool {
        (self.state.interval - interval).unsigned_abs() as f64 <= ticks * self.scale
    }

    /// One step after about `interval`, ticks · 2^F.
    fn single(&mut self, interval: f64) -> Option<Segment> {
        if interval >= (f64::from(LONGEST_WAIT_TICKS) - 1.0) * self.scale {
            return None;
        }
        let State { add, add2, .. } = self.state;
        let segment = Segment { count: 1, interval: self.round(0, interval), add, add2 };
        (segment.interval > 0).then(|| self.go_on(&segment))?;
        Some(segment)
    }

    /// The part of two bytes that comes next, or the segment that leads to one; `None` if there is none.
    fn slow(&mut self) -> Option<Segment> {
        let packing = self.packing.filter(|_| self.state.previous_count < u32::MAX)?;
        let State { interval, add, add2, .. } = self.state;
        let predicted = Segment { count: 1, interval, add, add2 };
        let brakes = |last: i64| {
            self.is_within(last, STEADY_TICKS)
                || (interval >= last && deceleration(last as f64, interval as f64) <= self.limit)
        };
        if interval <= 0 || self.last.is_some_and(|last| !brakes(last)) {
            return None;
        }
        if interval as f64 >= self.slowest {
            // Slow enough after one step more.
            self.go_on(&predicted);
            return Some(predicted);
        }
        let longest = f64::from(LONGEST_WAIT_TICKS) * self.scale;
        let parts = (0..=LONGEST_SLOW).filter_map(|m| self.state.slow(m, packing.fraction_bits));
        let begins = |part: &Segment| deceleration(part.interval as f64, (part.interval + part.add) as f64);
        let mut parts = parts.filter(|part| (part.after(part.count).interval as f64) < longest);
        let part = parts.find(|part| begins(part) <= SLOWS * self.limit)?;
        // One that is far too long, because the registers do not hold a shorter one, is none.
        if part.count > FEW_STEPS && begins(&part) < LEAST_PARTS[1] * self.limit {
            return None;
        }
        // What most of the time goes into is the beginning. Units are finer after the first part.
        let gentle = !self.brief && self.parts < 2 && part.count >= 8 && begins(&part) < GENTLE * self.limit;
        let dear = if self.parts == 0 { DEAR } else { usize::MAX };
        let lead = gentle.then(|| self.leading(&part, dear)).flatten();
        self.parts += if lead.is_some() { 2 } else { 1 };
        let segment = lead.unwrap_or(part);
        self.go_on(&segment);
        Some(segment)
    }

    /// The segment of at most `dear` bytes after which half of `part` is not too hard any more.
    fn leading(&self, part: &Segment, dear: usize) -> Option<Segment> {
        let State { interval, .. } = self.state;
        let (start, limit) = (interval as f64, DESIGN * self.limit);
        // Deceleration goes with v², and half a part brakes twice as hard.
        let peak = 2.0 * deceleration(start, (interval + part.add) as f64);
        let wanted = start * (peak / (SLOWS * self.limit)).sqrt();
        let packing = self.packing?;
        let candidates = [false, true].into_iter().filter_map(|keeps| {
            let add2 = if keeps { self.state.add2 } else { self.round(2, 0.0) };
            let add = self.round(1, limit * start.powi(3));
            let whole = self.replayed(Segment { count: LONGEST, interval, add, add2 })?;
            let until = (1..=whole.count).find(|k| whole.after(*k).interval as f64 >= wanted)?;
            let segment = Some(whole.truncated(until)).filter(|segment| segment.count > 2)?;
            Some((packing.packed_len(&self.state, &segment).ok()?, segment))
        });
        candidates.filter(|(len, _)| *len <= dear).min_by_key(|(len, _)| *len).map(|(_, segment)| segment)
    }

    /// Interval and add at the beginning of a segment that brakes by `deceleration` there.
    fn fresh(&self, deceleration: f64) -> (f64, f64) {
        match self.last {
            None => {
                let interval = self.state.interval as f64;
                (interval, deceleration * interval.powi(3))
            }
            Some(last) => {
                let last = last as f64;
                let interval = slower(last, deceleration).min(self.slowest);
                (interval, interval - last)
            }
        }
    }

    /// One interval longer than the last: the way out where no recurrence fits its registers.
    fn one_step(&self, limit: f64) -> Segment {
        let interval = match self.last {
            None => self.state.interval as f64,
            Some(last) => slower(last as f64, limit).min(self.slowest),
        };
        let State { add, add2, .. } = self.state;
        Segment { count: 1, interval: self.round(0, interval), add, add2 }
    }

    /// The nearest that the stream can say, from below for add and add2.
    fn round(&self, order: usize, value: f64) -> i64 {
        let predicted = [self.state.interval, self.state.add, self.state.add2][order];
        let unit = match &self.packing {
            Some(packing) if self.state.previous_count < u32::MAX => packing.units(self.state.previous_count)[order],
            _ => 1,
        };
        let correction = (value - predicted as f64) / unit as f64;
        let correction = if order == 0 { correction.ceil() } else { correction.floor() };
        predicted + correction as i64 * unit
    }

    fn rounded(&self, curve: &Curve, count: u32) -> Option<Segment> {
        let segment = Segment {
            count,
            interval: self.round(0, curve.interval),
            add: self.round(1, curve.add),
            add2: self.round(2, curve.add2),
        };
        (count > 1).then_some(segment)
    }

    /// As many of a segment's steps as keep the limits, up to the first that is slow enough.
    fn replayed(&self, segment: Segment) -> Option<Segment> {
        let Segment { count, mut interval, mut add, add2 } = segment;
        let mut last = self.last;
        let mut good = 0;
        let fits = |register: i64| (register as f64).abs() <= self.largest;
        while good < count {
            let slows =
                last.is_none_or(|last| interval >= last && deceleration(last as f64, interval as f64) <= self.limit);
            let narrow = count == 1 || (fits(add) && fits(add2));
            if !slows || !narrow || interval <= 0 || interval as f64 >= f64::from(LONGEST_WAIT_TICKS) * self.scale {
                break;
            }
            good += 1;
            if interval as f64 >= self.slowest {
                break;
            }
            last = Some(interval);
            interval += add;
            add += add2;
        }
        (good > 0).then(|| segment.truncated(good))
    }
}

/// How much slower two intervals are than each other, by the time between their middles.
fn deceleration(before: f64, after: f64) -> f64 {
    2.0 * (after - before) / (before * after * (before + after))
}

/// The interval after `last` for which [`deceleration`] is `wanted`.
fn slower(last: f64, wanted: f64) -> f64 {
    // wanted · last · (last + x)(2 last + x) = 2x
    let k = wanted * last;
    let half = 2.0 - 3.0 * k * last;
    let root = half * half - 8.0 * k * k * last * last;
    if half <= 0.0 || root < 0.0 {
        return f64::INFINITY;
    }
    last + 4.0 * k * last * last / (half + root.sqrt())
}

/// An interval that grows as interval + add·x + add2·x²/2.
struct Curve {
    interval: f64,
    add: f64,
    add2: f64,
}

impl Curve {
    /// With the largest add2 for which the deceleration stays within `limit`.
    fn steepest(interval: f64, add: f64, limit: f64, largest: f64) -> Curve {
        // From add = 0 the deceleration rises to (2/5 · add2 · interval)^½ / (6/5 · interval)³.
        let (mut low, mut high) = (0.0, (8.0 * limit * limit * interval.powi(5)).min(largest));
        for _ in 0..48 {
            let add2 = 0.5 * (low + high);
            let curve = Curve { interval, add, add2 };
            if curve.deceleration(curve.peak()) <= limit { low = add2 } else { high = add2 }
        }
        Curve { interval, add, add2: low }
    }

    fn deceleration(&self, x: f64) -> f64 {
        let Curve { interval, add, add2 } = *self;
        (add + add2 * x) / (interval + (add + 0.5 * add2 * x) * x).powi(3)
    }

    /// Where the deceleration is largest, x ≥ 0.
    fn peak(&self) -> f64 {
        let Curve { interval, add, add2 } = *self;
        let root = 10.0 * add2 * interval - 5.0 * add * add;
        if add2 <= 0.0 || root <= 0.0 {
            return 0.0;
        }
        ((root.sqrt() - 5.0 * add) / (5.0 * add2)).max(0.0)
    }

    /// The steps until the deceleration falls below `least` for good, or the interval is `slowest`.
    fn falls_below(&self, least: f64, slowest: f64) -> u32 {
        let (mut low, mut high) = (self.peak(), f64::from(LONGEST));
        for _ in 0..48 {
            let x = 0.5 * (low + high);
            let interval = self.interval + (self.add + 0.5 * self.add2 * x) * x;
            if self.deceleration(x) >= least && interval < slowest { low = x } else { high = x }
        }
        (low.ceil() as u32 + 1).min(LONGEST)
    }
}
