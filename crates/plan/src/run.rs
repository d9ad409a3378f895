//! Steps in one direction along one stretch, as segments.

use crate::expansion::{Expansion, Frame, ULP, exact_due};
use crate::fit::{Fit, Quantiser, SegmentStart, fit, single};
use crate::stretch::Stretch;
use pulsetrain_core::packing::unit_shift;
use pulsetrain_core::{Direction, Segment};
use pulsetrain_motion::whole_power;

/// Steps in one direction along one stretch: step j (1..=count) is due when s = j.
#[derive(Clone, Debug)]
pub(crate) struct Run {
    pub(crate) stretch: Stretch,
    pub(crate) frame: Frame,
    pub(crate) direction: Direction,
    pub(crate) count: u64,
    /// Whether the last level is beyond the stretch's end, by no more than a touch, but by a noticeable time at the
    /// speed there.
    pub(crate) touches: bool,
    /// The tick by which the last level is provably reached, if rounding errors leave open whether that is before the
    /// stretch's end.
    pub(crate) reached_by: Option<f64>,
    /// The tick at which the curve's own time is 0: whole, and fraction.
    pub(crate) origin: (i64, f64),
}

/// The time of a step: ticks of the curve's own time, and its largest error.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Due {
    pub(crate) tick: f64,
    pub(crate) error: f64,
}

impl Due {
    /// Between two ticks.
    fn between(earliest: f64, latest: f64) -> Due {
        Due { tick: 0.5 * (earliest + latest), error: 0.5 * (latest - earliest) + 4.0 * ULP * latest.abs() }
    }
}

/// Largest error of a step time that needs no improvement, ticks.
const CLOSE_TICKS: f64 = 1e-2;

/// A stretch whose end is this close to a level, steps, touches it there, however flat it is before. It is the
/// precision of 106 bits.
pub(crate) const EXACT_STEPS: f64 = 1e-24;

impl Run {
    /// The law near s, expanded where the curve's own time is about `tick`.
    fn expand(&self, s: f64, tick: f64) -> Option<Expansion> {
        match &self.stretch.inverse {
            Some(inverse) => Some(Expansion::from_inverse(&self.frame, inverse, s.clamp(0.0, self.count as f64 + 1.0))),
            None => {
                let u = (tick / self.frame.tick_hz).clamp(self.stretch.from, self.stretch.to);
                Expansion::from_jet(&self.frame, &self.stretch.curve, &self.stretch.bounds, u)
            }
        }
    }

    /// A tick in the curve's own time.
    pub(crate) fn own_tick(&self, tick: i64) -> f64 {
        (tick - self.origin.0) as f64 - self.origin.1
    }

    /// The window in which the stretch's bounds hold, ticks.
    pub(crate) fn window(&self) -> (f64, f64) {
        (self.stretch.from * self.frame.tick_hz, self.stretch.to * self.frame.tick_hz)
    }

    /// The time of step `j`, searched from `guess` (ticks of the curve's own time).
    ///
    /// Newton's method inside a bracket; where the law is too flat for its proof, the true time is enclosed
    /// between the places where the law is provably below and provably above.
    pub(crate) fn due(&self, j: u64, guess: f64) -> (Due, Option<Expansion>) {
        if let Some(reached_by) = self.reached_by.filter(|_| j == self.count) {
            return (Due::between(self.proven_before(j as f64).0 * self.frame.tick_hz, reached_by), None);
        }
        let (due, expansion) = self.due_anywhere(j, guess);
        // A touched last level is due at the stretch's end.
        if j == self.count && self.touches {
            (Due { tick: due.tick.min(self.window().1), ..due }, None)
        } else {
            (due, expansion)
        }
    }

    fn due_anywhere(&self, j: u64, guess: f64) -> (Due, Option<Expansion>) {
        let s = j as f64;
        if let Some(inverse) = &self.stretch.inverse {
            if let Some((tick, error)) = exact_due(&self.frame, inverse, s) {
                let expansion = Expansion::from_inverse(&self.frame, inverse, s);
                let due = Due { tick, error };
                // Where rounding hides the place of a turning point, the curve's more accurate form may show it.
                let sharper = (error > CLOSE_TICKS && self.stretch.curve.is_accurate()).then(|| self.enclosed(s));
                return (sharper.filter(|sharper| sharper.error < error).unwrap_or(due), Some(expansion));
            }
            let expansion = Expansion::from_inverse(&self.frame, inverse, s);
            let offset = expansion.offset(s);
            let error = expansion.remainder((s - expansion.center).abs(), offset, offset, self.window());
            if error.is_finite() {
                return (Due { tick: expansion.tick + offset, error }, Some(expansion));
            }
        }
        let hz = self.frame.tick_hz;
        let (mut low, mut high) = (self.stretch.from, self.stretch.to);
        let mut u = guess / hz;
        for _ in 0..200 {
            if !(u > low && u < high) {
                u = 0.5 * (low + high);
            }
            let expansion = Expansion::from_jet(&self.frame, &self.stretch.curve, &self.stretch.bounds, u);
            let miss = match &expansion {
                Some(expansion) => {
                    let miss = expansion.center - s;
                    if miss.abs() < 0.03 {
                        let offset = expansion.offset(s);
                        let error = expansion.remainder(miss.abs(), offset, offset, self.window());
                        if error < CLOSE_TICKS {
                            return (Due { tick: expansion.tick + offset, error }, Some(*expansion));
                        }
                    }
                    miss
                }
                None => (self.stretch.curve.value(u) - self.frame.zero) * self.frame.sign - s,
            };
            if miss > 0.0 {
                high = u
            } else {
                low = u
            }
            if (high - low) * hz < 1e-3 {
                break;
            }
            u = expansion.map_or(0.5 * (low + high), |e| u - miss * e.q[1] / hz);
        }
        (self.enclosed(s), None)
    }

    /// How far the law is beyond s at u, and the largest rounding error of that, steps.
    pub(crate) fn beyond(&self, u: f64, s: f64) -> (f64, f64) {
        let curve = &self.stretch.curve;
        if let Some((x0, moved, rounding)) = curve.moved_from_rest(u) {
            let (turn, lost) = self.frame.turn(x0);
            let missing = (s - turn) - lost;
            let doubt = rounding + 2.0 * ULP * (moved.abs() + missing.abs()) + 4.0 * ULP * lost.abs();
            return (moved * self.frame.sign - missing, doubt);
        }
        let Frame { sign, zero, zero_low, .. } = self.frame;
        match curve.beyond(u, [zero, zero_low, sign * s]) {
            Some((beyond, doubt)) => (beyond * sign, doubt + 2.0 * ULP * zero_low.abs()),
            None => {
                let rounding = self.stretch.bounds.rounding[0]
                    + zero_low.abs()
                    + 4.0 * ULP * (zero.abs() + self.stretch.value_to.abs());
                ((curve.value(u) - zero) * sign - s, rounding)
            }
        }
    }

    /// Whether its last step is a segment of its own.
    fn ends_apart(&self) -> bool {
        self.touches || self.reached_by.is_some()
    }

    /// The times around the last place where the law is provably below s, s.
    fn proven_before(&self, s: f64) -> (f64, f64) {
        self.bisected(|u| {
            let (beyond, doubt) = self.beyond(u, s);
            beyond + doubt < 0.0
        })
    }

    /// The times around the first place where the law is provably above s, s.
    pub(crate) fn proven_after(&self, s: f64) -> (f64, f64) {
        self.bisected(|u| {
            let (beyond, doubt) = self.beyond(u, s);
            beyond - doubt <= 0.0
        })
    }

    fn bisected(&self, is_low: impl Fn(f64) -> bool) -> (f64, f64) {
        let (mut low, mut high) = (self.stretch.from, self.stretch.to);
        while (high - low) * self.frame.tick_hz > 1e-3 {
            let u = 0.5 * (low + high);
            if u <= low || u >= high {
                break;
            }
            if is_low(u) { low = u } else { high = u }
        }
        (low, high)
    }

    /// Encloses the time of s between the last place where the law is provably below it and the first where it is
    /// provably above.
    ///
    /// A level beyond the stretch's end by no more than a touch is due at its end.
    fn enclosed(&self, s: f64) -> Due {
        let (mut earliest, mut latest) = (self.proven_before(s).0, self.proven_after(s).1);
        let hz = self.frame.tick_hz;
        if latest >= self.stretch.to {
            let (at_end, doubt) = self.beyond(self.stretch.to, s);
            if at_end.abs() <= doubt && doubt < EXACT_STEPS {
                earliest = self.stretch.to;
            }
            let end = self.stretch.end(hz);
            (earliest, latest) = (earliest.min(end.0), end.1);
        }
        Due::between(earliest * hz, latest * hz)
    }

    /// A first guess for the time of step `j`: as if the acceleration were constant.
    pub(crate) fn guess(&self, j: u64) -> f64 {
        let c = self.stretch.curve.jet(self.stretch.from);
        let gone = (c[0] - self.frame.zero) * self.frame.sign;
        let missing = (j as f64 - gone).max(0.0);
        let (speed, bend) = ((c[1] * self.frame.sign).max(0.0), c[2] * self.frame.sign);
        let root = (speed * speed + 4.0 * bend.max(0.0) * missing).sqrt();
        let wait = if speed + root > 0.0 { 2.0 * missing / (speed + root) } else { 0.0 };
        (self.stretch.from + wait).min(self.stretch.to) * self.frame.tick_hz
    }
}

/// A copy of the registers that the board has after the last segment. From them the packing on the wire predicts the
/// next segment.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Registers {
    /// Tick of the accumulator.
    pub(crate) tick: i64,
    /// The accumulator's fraction, ticks · 2^F.
    pub(crate) fraction: i64,
    /// The differences that the packing predicts for the next segment, ticks · 2^F.
    pub(crate) predicted: Segment,
    /// Count of the last segment, 4 after a reset.
    pub(crate) count: u32,
}

impl Registers {
    /// Updates the registers by `segment`.
    pub(crate) fn advance(&mut self, segment: &Segment, fraction_bits: u32) {
        let accumulator = i128::from(self.fraction) + segment.span(segment.count);
        self.tick += (accumulator >> fraction_bits) as i64;
        self.fraction = (accumulator & ((1 << fraction_bits) - 1)) as i64;
        self.predicted = segment.after(segment.count);
        self.count = segment.count;
    }

    /// Clears the differences, as a board does at a change of direction.
    pub(crate) fn reset(&mut self) {
        self.predicted = Segment::default();
        self.count = 4;
    }
}

/// The rules by which segments are chosen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Rules {
    pub(crate) fraction_bits: u32,
    /// Bound on |scheduled − exact|, ticks.
    pub(crate) tolerance: f64,
    /// Gain of the packed stream; `None`: every segment in full resolution and of any length.
    pub(crate) gain: Option<i8>,
    /// Largest |add| and |add2|, ticks · 2^F.
    pub(crate) largest_add: i64,
    /// Waits of this length and above become dwells, ticks.
    pub(crate) longest_wait: f64,
    /// Largest number of steps in one segment.
    pub(crate) longest: u32,
    /// Shortest interval between two steps, ticks.
    pub(crate) min_interval: i64,
}

impl Rules {
    fn quantiser(&self, registers: &Registers) -> Quantiser {
        let unit = |order| match self.gain {
            None => 1.0,
            Some(gain) => {
                (1u64 << (self.fraction_bits - unit_shift(order, registers.count, gain, self.fraction_bits))) as f64
            }
        };
        Quantiser { predicted: registers.predicted, units: [unit(1), unit(2), unit(3)], scale: self.scale() }
    }

    /// 2^F.
    fn scale(&self) -> f64 {
        (1u64 << self.fraction_bits) as f64
    }

    fn permits(&self, segment: &Segment) -> bool {
        let fits = |add: i64| add.abs() <= self.largest_add;
        (longest_interval(segment) as f64) < self.longest_wait * self.scale()
            // add changes linearly: if it fits at both ends, it fits between them.
            && fits(segment.add)
            && fits(segment.after(segment.count).add)
            && fits(segment.add2)
            && (segment.count == 1 || shortest_interval(segment).0 >> self.fraction_bits >= self.min_interval)
    }
}

/// The longest interval of a segment, ticks · 2^F.
fn longest_interval(segment: &Segment) -> i64 {
    let last = segment.after(segment.count - 1);
    let ends = segment.interval.max(last.interval);
    if segment.add <= 0 || last.add >= 0 {
        return ends;
    }
    // The interval rises first and falls later: the longest is near the place where add passes 0.
    let near = (segment.add / -segment.add2).clamp(0, i64::from(segment.count) - 2) as u32;
    ends.max(segment.after(near).interval).max(segment.after(near + 1).interval)
}

/// The shortest interval between two steps of a segment of two or more, ticks · 2^F, and the number of the step
/// after it.
pub(crate) fn shortest_interval(segment: &Segment) -> (i64, u32) {
    // The interval before step k (2..=count) is I + (k−1)a + C(k−1,2)b, a parabola in k. It is smallest at an end, or
    // near its vertex if it falls first and rises later.
    let (second, last) = (segment.after(1), segment.after(segment.count - 1));
    let ends = (second.interval, 2).min((last.interval, segment.count));
    if second.add >= 0 || last.add <= 0 {
        return ends;
    }
    let vertex = 1.5 - segment.add as f64 / segment.add2 as f64;
    let near = vertex.clamp(2.0, f64::from(segment.count)) as u32;
    let near = [near, (near + 1).min(segment.count)].map(|k| (segment.after(k - 1).interval, k));
    ends.min(near[0]).min(near[1])
}

/// How often an expansion is moved to the middle of its segment.
const CENTERINGS: u32 = 4;

/// Plans a run from its first step to its last.
#[derive(Clone, Debug)]
pub(crate) struct RunPlanner {
    pub(crate) run: Run,
    done: u64,
    /// Expected length of the next segment.
    guess: f64,
    /// The expansion that the last segment was fitted to.
    last: Option<Expansion>,
}

/// Counts that the packed stream encodes without a byte of their own, longest first.
fn coded_counts(previous: u32) -> [u32; 7] {
    let n = previous;
    [n + n / 2, n + n / 4, n + n / 8, n, n - n / 8, n - n / 4, n - n / 2]
}

/// Smallest length of a run's last segment, steps. Rather than leave fewer, the planner halves what is left.
const MIN_LEFT: u32 = 16;

impl RunPlanner {
    /// `before` is the run from which this one may continue.
    pub(crate) fn new(run: Run, before: Option<&RunPlanner>) -> RunPlanner {
        let guess = before.filter(|b| b.run.direction == run.direction).map_or(2.0, |b| b.guess);
        RunPlanner { run, done: 0, guess, last: None }
    }

    pub(crate) fn is_done(&self) -> bool {
        self.done >= self.run.count
    }

    /// The next segment, with the largest |scheduled − exact| that is proven for it. It may exceed the tolerance if it
    /// is a single step and the law cannot be known better.
    pub(crate) fn next(&mut self, registers: &Registers, rules: &Rules) -> Fit {
        let left = self.run.count - self.done;
        let most = left.saturating_sub(self.run.ends_apart().into()).clamp(1, u64::from(rules.longest)) as u32;
        let quantiser = rules.quantiser(registers);
        let offset = (registers.fraction as f64) / quantiser.scale - 0.5;
        let start = SegmentStart {
            done: self.done as f64,
            tick: self.run.own_tick(registers.tick) + offset,
            fraction: registers.fraction,
            fraction_bits: rules.fraction_bits,
        };
        let fit = self.longest_fit(&start, &quantiser, most, registers, rules);
        self.done += u64::from(fit.segment.count);
        self.guess = f64::from(fit.segment.count) * 1.05 + 1.0;
        fit
    }

    fn longest_fit(
        &mut self,
        start: &SegmentStart,
        quantiser: &Quantiser,
        most: u32,
        registers: &Registers,
        rules: &Rules,
    ) -> Fit {
        let previous = registers.count;
        let window = self.run.window();
        let allowance = rules.tolerance - 0.5;
        let left = f64::from(most);
        let mut middle = self.guess.min(left) * 0.5;
        let mut expansion = self.expand(start.done + middle);
        let mut length = 1.0;
        for _ in 0..CENTERINGS {
            let Some(e) = &expansion else { break };
            length = estimated_length(e, start, quantiser, 2.0 * middle, allowance).min(left);
            // An expansion whose center is far from the middle of its segment proves less.
            if (start.done + length * 0.5 - 0.5 - e.center).abs() <= 0.15 * length || length <= 2.0 {
                break;
            }
            // An expansion proves little about places far beyond its own segment.
            length = length.min(middle * 5.0);
            middle = length * 0.5;
            match self.expand_from(start.done + middle, e) {
                Some(again) => expansion = Some(again),
                None => break,
            }
        }
        let mut best: Option<Fit> = None;
        if let Some(e) = &mut expansion {
            // A short last segment would leave the next run coarse units to start with: halve what is left instead.
            let half = (0.5 * left).ceil();
            if rules.gain.is_some() && length < left && left < 1.3 * length {
                length = half;
            }
            let mut count = self.permitted(length as u32, previous, rules);
            let mut before: Option<(f64, f64)> = None;
            while count > 1 {
                let fitted = fit(e, start, quantiser, count, window);
                let close = fitted.filter(|f| f.misfit <= allowance);
                let kept = close.filter(|f| rules.permits(&f.segment));
                // A segment that fits but is not allowed is shortened without an estimate.
                let misfit = fitted.filter(|_| close.is_none()).map_or(f64::INFINITY, |f| f.misfit);
                if let Some(f) = kept {
                    let better = best.is_none_or(|b| f.segment.count > b.segment.count);
                    if better {
                        best = Some(f);
                    }
                    // There is room left: try once to grow, by the fourth root of what the misfit allows.
                    if before.is_none() && f.misfit < 0.5 * allowance && count < most {
                        let factor = (allowance * 0.93 / (f.misfit + 1e-9)).sqrt().sqrt().min(1.5);
                        let grown = self.permitted(((f64::from(count) * factor) as u32).min(most), previous, rules);
                        if grown > count {
                            before = Some((0.0, f64::from(count)));
                            count = grown;
                            continue;
                        }
                    }
                    break;
                }
                if best.is_some() {
                    break;
                }
                let shrunk = f64::from(count) * shrinkage(misfit, count, allowance, before);
                before = Some((misfit, f64::from(count)));
                count = self.permitted((shrunk as u32).min(count - 1).max(1), previous, rules).min(count - 1);
                // A proof far from the middle of an expansion is as loose for a shorter segment.
                let middle = start.done + 0.5 * f64::from(count);
                if (middle - 0.5 - e.center).abs() > 0.15 * f64::from(count)
                    && let Some(again) = self.expand_from(middle, e)
                {
                    *e = again;
                }
            }
            // A very short last segment would make up at once for the error that all before it were allowed, which is
            // too sudden for a board that computes each step. Taking all that is left costs a byte for the count.
            // Halving it again and again would also end in such short segments.
            if rules.gain.is_some() && best.is_some_and(|fit| (1..MIN_LEFT).contains(&(most - fit.segment.count))) {
                let fits = |count| {
                    let fitted = fit(e, start, quantiser, count, window);
                    fitted.filter(|f| count > 1 && f.misfit <= allowance && rules.permits(&f.segment))
                };
                let halved = || fits(self.permitted(half as u32, previous, rules));
                best = fits(most).or_else(halved).or(best);
            }
        }
        match best {
            Some(fit) => {
                self.last = expansion;
                fit
            }
            None => self.single(start, quantiser, registers, rules),
        }
    }

    /// A segment of one step, at the time with the smallest proven error.
    fn single(&mut self, start: &SegmentStart, quantiser: &Quantiser, registers: &Registers, rules: &Rules) -> Fit {
        let j = self.done + 1;
        let s = j as f64;
        let guess = self.last.map_or_else(|| self.run.guess(j), |last| last.tick + last.offset(s));
        let (due, expansion) = self.run.due(j, guess);
        if expansion.is_some() {
            self.last = expansion;
        }
        // The wait is too long for an interval: most of it becomes a dwell of whole ticks.
        let wait = due.tick - start.tick;
        // Rounding may add up to one tick.
        let dwell = if wait >= rules.longest_wait - 2.0 { (wait - 0.5 * rules.longest_wait).floor() } else { 0.0 };
        let offset = start.fraction as f64 / quantiser.scale - 0.5;
        // A sum of whole ticks, because after a long dwell the rounding error of a far tick is gone.
        let start = SegmentStart { tick: self.run.own_tick(registers.tick + dwell as i64) + offset, ..*start };
        let wanted = (due.tick - start.tick) * quantiser.scale;
        let unit = quantiser.units[0] as i64;
        let mut interval = quantiser.round(0, wanted).unwrap_or(quantiser.predicted.interval);
        if interval <= 0 {
            // The step is due at once, or a rounding error earlier: use the shortest interval that a segment can have.
            interval = (quantiser.predicted.interval - 1).rem_euclid(unit) + 1;
        }
        let accumulator = i128::from(start.fraction) + i128::from(interval);
        let scheduled = (accumulator >> start.fraction_bits) as i64 as f64 - offset;
        let misfit = (scheduled - (due.tick - start.tick)).abs() - 0.5;
        let proven = due.error + 64.0 * ULP * (due.tick - start.tick).abs();
        let segment = single(interval, quantiser);
        Fit { segment, dwell: dwell as u64, bound: 0.5 + misfit + proven, misfit: misfit + proven }
    }

    fn expand(&self, s: f64) -> Option<Expansion> {
        match &self.last {
            Some(last) => self.expand_from(s, last),
            None => self.run.expand(s, self.run.guess(s.max(1.0) as u64)),
        }
    }

    fn expand_from(&self, s: f64, near: &Expansion) -> Option<Expansion> {
        self.run.expand(s, near.tick + near.offset(s))
    }

    /// The largest count up to `wanted` that is worth its bytes.
    fn permitted(&self, wanted: u32, previous: u32, rules: &Rules) -> u32 {
        let wanted = wanted.max(1);
        if rules.gain.is_none() {
            return wanted;
        }
        let coded = coded_counts(previous).into_iter().find(|&n| n <= wanted).unwrap_or(0);
        // A count of its own costs one byte, in about five.
        if f64::from(wanted) > 1.25 * f64::from(coded) { wanted } else { coded }
    }
}

/// The factor by which to shorten a segment that misses its bound: by the fourth root where the fit is the limit, by
/// the slope of the last two tries where rounding is.
fn shrinkage(misfit: f64, count: u32, allowance: f64, before: Option<(f64, f64)>) -> f64 {
    if !misfit.is_finite() {
        return 0.6;
    }
    let excess = misfit / (allowance * 0.98);
    let exponent = match before {
        Some((m, n)) if m.is_finite() && m > misfit => {
            (libm::log(m / misfit) / libm::log(n / f64::from(count))).clamp(1.0, 5.0)
        }
        _ => 4.0,
    };
    (libm::pow(excess, -1.0 / exponent) * 0.99).clamp(0.4, 0.97)
}

/// An estimate of the steps that one segment can take, from the quartic and quintic terms that a cubic cannot follow
/// and from the rounding of its differences.
fn estimated_length(e: &Expansion, start: &SegmentStart, quantiser: &Quantiser, from: f64, allowance: f64) -> f64 {
    let q = e.q.map(f64::abs);
    let mut half = (from * 0.5).max(0.5);
    for _ in 0..3 {
        let misfit = (q[4] * 0.125 + (q[5] * 0.0625 + (q[6] * 0.03125 + q[7] * half * 0.0156) * half) * half)
            * whole_power(half, 4);
        let ratio = (allowance * 0.95 / (misfit + 1e-30)).min(256.0);
        half *= ratio.sqrt().sqrt();
    }
    let mut count = (2.0 * half).min(4e9);
    if count <= 20.0 {
        return count;
    }
    let [_, add_unit, add2_unit] = quantiser.units;
    for _ in 0..4 {
        let y = start.done - 0.5 - e.center + count * 0.5;
        let add2 = 6.0 * (e.q[3] + (4.0 * e.q[4] + 10.0 * e.q[5] * y) * y) * quantiser.scale;
        let off = (add2 - quantiser.predicted.add2 as f64) / add2_unit;
        let add2_error = (off - off.round()).abs() * add2_unit / quantiser.scale;
        let add_error = if e.q[2] == 0.0 && e.q[3] == 0.0 { 0.0 } else { 0.25 * add_unit / quantiser.scale };
        let h = count * 0.5;
        let misfit = (q[4] * 0.125 + q[5] * h * 0.0625) * whole_power(h, 4)
            + add2_error * whole_power(count, 3) / 104.0
            + add_error * count * count * 0.10
            + 0.3 * count * quantiser.units[0] / quantiser.scale;
        let ratio = allowance * 0.93 / misfit;
        if ratio > 0.97 {
            break;
        }
        // To the power 3/8.
        count *= (ratio.sqrt() * ratio.sqrt().sqrt()).sqrt();
    }
    count.floor().max(4.0)
}
