//! Braking in few segments: steps whose exact ticks do not matter, but whose speed and deceleration do.
//!
//! Under a constant deceleration the time of a step is a square root, and no recurrence follows that for long. But a
//! tail need not brake evenly: it must not brake harder than it may. So each segment lets the deceleration rise to the
//! limit and fall again, as far as a cubic can; the next goes on from there. Fast motors lose most of the time at the
//! beginning, so that the first segments are kept close to the limit, and the later ones are longer.
//!
//! What a segment is to be comes from floats. What it is, is replayed in its integers, step by step: it ends before a
//! step that would break a limit.

use crate::Move;
use crate::planner::LONGEST_WAIT_TICKS;
use crate::settings::Settings;
use pulsetrain_core::packing::Packing;
use pulsetrain_core::{Direction, Segment};

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

/// How a motor is to be brought to rest. Ticks and steps.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Brake {
    /// When the first step is due, ticks from the tail's beginning.
    pub(crate) first: f64,
    /// The speed at that step, steps/tick, in the direction of motion.
    pub(crate) speed: f64,
    /// Largest deceleration, steps/tick².
    pub(crate) limit: f64,
    /// At this speed and below the motor may stop at once, steps/tick.
    pub(crate) pull_in: f64,
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
        let run = |segment| Move::Run { segment, direction: self.direction };
        best.map(|segments| segments.into_iter().map(run).collect())
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
        let root = self.speed * self.speed - 2.0 * self.limit;
        if self.speed <= self.at_rest() || root <= 0.0 {
            return Some(segments);
        }
        let slowest = (1.0 / self.at_rest()).min(longest);
        if slowest * self.at_rest() < 0.99 {
            return None;
        }
        // The interval after the first step, as if braked evenly.
        let second = 2.0 / (self.speed + root.sqrt());
        let mut design = Design {
            limit: self.limit * scale.powi(-2),
            scale,
            last: None,
            slowest: (slowest * scale).ceil(),
            largest: if settings.fraction_bits <= 16 { f64::from(i32::MAX) } else { 1e17 },
            packing: settings.gain().map(|gain| Packing { fraction_bits: settings.fraction_bits, gain }),
            predicted: Segment { interval: (second * scale).ceil() as i64, ..Segment::default() },
            count: u32::MAX,
        };
        if (second as u64) < settings.min_interval_ticks {
            return None;
        }
        let mut part = least_part;
        while design.last.is_none_or(|last| (last as f64) < design.slowest) {
            if segments.len() == MOST {
                return None;
            }
            let segment = design.next(part)?;
            segments.push(segment);
            part *= SLACKENING;
        }
        Some(segments)
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
    /// What the next segment goes on with for no bytes.
    predicted: Segment,
    /// Steps of the last segment.
    count: u32,
}

impl Design {
    /// The segment that gets furthest before the deceleration falls below `part` of the limit.
    fn next(&mut self, part: f64) -> Option<Segment> {
        let limit = self.limit * DESIGN;
        let mut best: Option<(f64, Segment)> = None;
        let levels = (0..=6).map(|k| part + (1.0 - part) * f64::from(k) / 6.0);
        let fresh = levels.map(|level| self.fresh(level * limit));
        let onward = self.last.map(|_| (self.predicted.interval as f64, self.predicted.add as f64));
        let from = self.last.unwrap_or(self.predicted.interval) as f64;
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
        self.last = Some(segment.after(segment.count - 1).interval);
        self.predicted = segment.after(segment.count);
        self.count = segment.count;
        Some(segment)
    }

    /// Interval and add at the beginning of a segment that brakes by `deceleration` there.
    fn fresh(&self, deceleration: f64) -> (f64, f64) {
        match self.last {
            None => {
                let interval = self.predicted.interval as f64;
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
            None => self.predicted.interval as f64,
            Some(last) => slower(last as f64, limit).min(self.slowest),
        };
        Segment { count: 1, interval: self.round(0, interval), ..self.predicted }
    }

    /// The nearest that the stream can say, from below for add and add2.
    fn round(&self, order: usize, value: f64) -> i64 {
        let predicted = [self.predicted.interval, self.predicted.add, self.predicted.add2][order];
        let unit = match &self.packing {
            Some(packing) if self.count < u32::MAX => packing.units(self.count)[order],
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
