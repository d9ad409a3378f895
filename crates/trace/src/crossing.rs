//! The times at which a law has its steps: the crossings of θ(t) with the levels of the grid, in order of time.
//!
//! The judge has its own method here, so that it shares nothing with the planner except θ. It cuts each piece into
//! windows on which a Taylor polynomial equals θ up to rounding, and each window into stretches on which that
//! polynomial is monotone (proven from its coefficients). On each stretch Newton's method within brackets finds the
//! crossings.

use pulsetrain_motion::law::{Jet, Piece, Pieces};
use pulsetrain_motion::{Grid, Law, LawError, TOUCH_DOUBT_STEPS, TOUCH_STEPS, Time, whole_power};

/// A time in ticks. Whole ticks and fraction are separate, so that days lose no precision.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Instant {
    /// Whole ticks.
    pub tick: i64,
    /// The fraction, ticks; small, but not always in 0..1.
    pub fraction: f64,
}

impl Instant {
    /// `self` − `other`, ticks.
    #[must_use]
    pub fn minus(self, other: Instant) -> f64 {
        self.tick.wrapping_sub(other.tick) as f64 + (self.fraction - other.fraction)
    }

    /// In ticks, as one number.
    #[must_use]
    pub fn ticks(self) -> f64 {
        self.tick as f64 + self.fraction
    }

    pub(crate) fn plus(self, ticks: f64) -> Instant {
        let whole = ticks.floor();
        Instant { tick: self.tick.saturating_add(whole as i64), fraction: self.fraction + (ticks - whole) }
    }
}

/// A step of the law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crossing {
    /// The time at which θ crosses the level.
    pub at: Instant,
    /// Whether the position counts up.
    pub forward: bool,
    /// Half the time within which f64 cannot place the crossing, ticks. It is tiny except near turning points.
    pub uncertainty_ticks: f64,
    /// Whether the step may be missing: a stretch of θ ends within [`TOUCH_STEPS`] before the level, or in doubt of it. See
    /// [`Crossings::settle`].
    pub optional: bool,
    /// |speed| at the crossing, steps/s.
    pub speed: f64,
    /// Largest distance of θ from the position since the step before, steps, signed.
    pub farthest: f64,
}

/// The crossings of one law, in order.
pub struct Crossings {
    pieces: Pieces,
    grid: Grid,
    tick_hz: u64,
    /// θ at the start: origin and value of the first piece's curve.
    start: Option<(i64, f64)>,
    position: i64,
    farthest: f64,
    piece: Option<Piece>,
    /// How far the present piece has been cut into windows, s of its own time.
    reached: f64,
    /// Width of the last window, s.
    width: f64,
    window: Window,
    /// Monotone stretches of the window that have not been searched, last first.
    stretches: Vec<Stretch>,
    /// The direction of an optional crossing that was returned and not settled.
    unsettled: Option<bool>,
}

/// θ as a polynomial about a centre.
#[derive(Default)]
struct Window {
    /// θ − origin against seconds from the centre.
    jet: Jet,
    centre: Instant,
    /// Bound on |polynomial − θ|, steps.
    noise: f64,
    origin: i64,
}

/// A part of a window on which the polynomial is monotone; seconds from the centre, steps.
#[derive(Clone, Copy, Debug)]
struct Stretch {
    from: f64,
    to: f64,
    from_value: f64,
    to_value: f64,
    /// Whether θ comes to rest at its end, as before a turning point.
    ends_slow: bool,
}

impl Crossings {
    /// From t = 0 s and position 0 on, in ticks of `tick_hz`.
    #[must_use]
    pub fn new(law: &Law, grid: Grid, tick_hz: u64) -> Crossings {
        Crossings {
            pieces: law.pieces(),
            grid,
            tick_hz,
            start: None,
            position: 0,
            farthest: 0.0,
            piece: None,
            reached: 0.0,
            width: f64::INFINITY,
            window: Window::default(),
            stretches: Vec::new(),
            unsettled: None,
        }
    }

    /// Steps forward minus steps backward so far.
    #[must_use]
    pub fn position(&self) -> i64 {
        self.position
    }

    /// Tells whether the optional crossing that was returned last has a step. The crossings after it depend on that.
    ///
    /// Without this call it counts as having none.
    pub fn settle(&mut self, made: bool) {
        if let Some(forward) = self.unsettled.take() {
            if made {
                self.step(forward);
            } else {
                self.next_stretch();
            }
        }
    }

    /// The next crossing, `None` at the law's end.
    ///
    /// It does not return if an endless law has no crossing any more; see [`Crossings::advance_until`].
    ///
    /// # Errors
    /// Where the law is undefined.
    pub fn advance(&mut self) -> Result<Option<Crossing>, LawError> {
        self.search(None)
    }

    /// The next crossing; `None` if none was found up to `until`, or at the law's end. A crossing after `until` may be
    /// found, too. A later call goes on where this one ended.
    ///
    /// ```
    /// # use pulsetrain_motion::{Grid, Law, Time};
    /// # use pulsetrain_trace::crossing::{Crossings, Instant};
    /// let rest = Law::speed(0.0, None)?;
    /// let mut crossings = Crossings::new(&rest, Grid::REACH, 1_000_000);
    /// assert_eq!(crossings.advance_until(Instant { tick: 3_600_000_000, fraction: 0.0 })?, None);
    /// # Ok::<(), pulsetrain_motion::LawError>(())
    /// ```
    ///
    /// # Errors
    /// Where the law is undefined.
    pub fn advance_until(&mut self, until: Instant) -> Result<Option<Crossing>, LawError> {
        self.search(Some(until))
    }

    fn search(&mut self, until: Option<Instant>) -> Result<Option<Crossing>, LawError> {
        self.settle(false);
        loop {
            let Some(&stretch) = self.stretches.last() else {
                if self.refill(until)? {
                    continue;
                }
                return Ok(None);
            };
            let (origin, start) = self.start.expect("set by the first window");
            let relative = self.position - (self.window.origin - origin);
            let up = self.grid.up_level(relative) + start;
            let down = self.grid.down_level(relative) + start;
            let rising = stretch.to_value >= stretch.from_value;
            // θ is beyond a level at the start already: the law jumps, or the edge of a window was rounded.
            let found = if stretch.from_value >= up + TOUCH_STEPS {
                Some((true, stretch.from, None))
            } else if stretch.from_value <= down - TOUCH_STEPS {
                Some((false, stretch.from, None))
            } else {
                let (level, beyond) =
                    if rising { (up, stretch.to_value - up) } else { (down, down - stretch.to_value) };
                let noise = self.window.noise;
                // The stretch is so slow that f64 cannot place a crossing on it, as where a motion eases out.
                let is_flat = self.window.speed(stretch.to).abs() * (stretch.to - stretch.from) <= noise;
                if stretch.ends_slow && beyond.abs() <= noise {
                    // A touch counts as a crossing.
                    Some((rising, stretch.to, None))
                } else if beyond > noise || (beyond >= 0.0 && !is_flat) {
                    Some((rising, self.window.solve(level, stretch, self.tick_hz), None))
                } else if beyond >= -(TOUCH_STEPS + TOUCH_DOUBT_STEPS + noise) {
                    // A level that θ just misses in f64 may be touched, however slowly θ comes to rest. If θ goes on,
                    // the next stretch decides.
                    Some((rising, stretch.to, Some((beyond + TOUCH_STEPS).max(TOUCH_DOUBT_STEPS))))
                } else {
                    None
                }
            };
            let Some((forward, x, graze)) = found else {
                self.next_stretch();
                continue;
            };
            let optional = graze.is_some();
            let uncertainty_s = match graze {
                // The step may come at any time while θ is so near to the level.
                Some(graze) => self.window.ends_within(graze, stretch),
                None => self.window.uncertainty(x, stretch),
            };
            let crossing = Crossing {
                at: self.window.at(x, self.tick_hz),
                forward,
                uncertainty_ticks: uncertainty_s * self.tick_hz as f64,
                optional,
                speed: self.window.speed(x).abs(),
                farthest: self.farthest,
            };
            if let Some(stretch) = self.stretches.last_mut() {
                (stretch.from, stretch.from_value) = (x, self.window.value(x));
            }
            if optional {
                self.unsettled = Some(forward);
            } else {
                self.step(forward);
            }
            return Ok(Some(crossing));
        }
    }

    fn step(&mut self, forward: bool) {
        self.position += if forward { 1 } else { -1 };
        self.farthest = 0.0;
    }

    fn next_stretch(&mut self) {
        if let (Some(stretch), Some((origin, start))) = (self.stretches.pop(), self.start) {
            let relative = self.position - (self.window.origin - origin);
            let off = stretch.to_value - start - relative as f64;
            if off.abs() > self.farthest.abs() {
                self.farthest = off;
            }
        }
    }

    /// Cuts the next window; `false` at the law's end, or if the window would begin after `until`.
    fn refill(&mut self, until: Option<Instant>) -> Result<bool, LawError> {
        let (piece, end) = loop {
            if let Some(piece) = self.piece.as_ref().filter(|piece| self.reached < piece.last()) {
                if let Some(until) = until {
                    let (tick, fraction) = (piece.zero + Time::from_seconds(self.reached)).ticks(self.tick_hz);
                    if (Instant { tick, fraction }).minus(until) > 0.0 {
                        return Ok(false);
                    }
                }
                break (piece, piece.last());
            }
            let Some(piece) = self.pieces.next().transpose()? else { return Ok(false) };
            self.reached = piece.first();
            self.width = piece.last() - piece.first();
            self.start.get_or_insert_with(|| (piece.origin, piece.curve.value(piece.first())));
            self.piece = Some(piece);
        };
        // A window shorter than this is treated as a point.
        let tiny = (1.0 / (64.0 * self.tick_hz as f64)).max(4.0 * f64::EPSILON * end.abs().max(self.reached.abs()));
        // Largest change of θ in a window, steps, so that distances from its centre keep their precision.
        const TRAVEL: f64 = 131_072.0;
        let mut width = (self.width * 2.0).min(end - self.reached);
        loop {
            let to = if width >= end - self.reached { end } else { self.reached + width };
            let half = 0.5 * (to - self.reached);
            let centre = self.reached + half;
            let jet = piece.curve.jet(centre);
            let bounds = piece.curve.bounds(self.reached, to);
            let tail = bounds.eighth * whole_power(half, 8);
            let travel = polynomial(&jet.map(f64::abs), half) - jet[0].abs();
            let good_tail = 2.0 * bounds.rounding[0] + 1e-13;
            if !(tail <= good_tail && travel <= TRAVEL) && width > tiny {
                let shrink = (good_tail / tail).sqrt().sqrt().sqrt();
                width *= if shrink.is_nan() { 0.5 } else { shrink.clamp(0.125, 0.75) };
                continue;
            }
            if jet.iter().any(|c| !c.is_finite()) {
                let at_s = (piece.zero + Time::from_seconds(centre)).seconds();
                return Err(LawError::Undefined { at_s, why: "θ or its derivatives are not finite".into() });
            }
            let (tick, fraction) = (piece.zero + Time::from_seconds(centre)).ticks(self.tick_hz);
            let noise = polynomial(&bounds.rounding, half) + tail.min(TOUCH_STEPS) + f64::EPSILON * jet[0].abs();
            self.window = Window { jet, centre: Instant { tick, fraction }, noise, origin: piece.origin };
            self.window.split(-half, half, 0, &mut self.stretches);
            self.stretches.reverse();
            self.reached = to;
            self.width = width;
            return Ok(true);
        }
    }
}

impl Window {
    fn value(&self, x: f64) -> f64 {
        polynomial(&self.jet, x)
    }

    fn speed(&self, x: f64) -> f64 {
        (1..8).rev().fold(0.0, |sum, k| sum * x + k as f64 * self.jet[k])
    }

    fn at(&self, x: f64, tick_hz: u64) -> Instant {
        self.centre.plus(x * tick_hz as f64)
    }

    /// Pushes the monotone stretches of `from..=to`.
    fn split(&self, from: f64, to: f64, depth: u32, out: &mut Vec<Stretch>) {
        let half = 0.5 * (to - from);
        let about = shifted(&self.jet, 0.5 * (from + to));
        let spread = |order: usize| -> f64 {
            (order + 1..8).map(|k| falling(k, order) * about[k].abs() * whole_power(half, (k - order) as i32)).sum()
        };
        if about[1].abs() > spread(1) || spread(0) <= self.noise || depth > 40 {
            out.push(self.stretch(from, to));
        } else if 2.0 * about[2].abs() > spread(2) {
            // The speed is monotone: one turning point or none.
            let (mut lo, mut hi) = (from, to);
            let rising = self.speed(lo) >= 0.0;
            if (self.speed(hi) >= 0.0) == rising {
                out.push(self.stretch(from, to));
                return;
            }
            while 0.5 * (lo + hi) > lo && 0.5 * (lo + hi) < hi {
                let middle = 0.5 * (lo + hi);
                if (self.speed(middle) >= 0.0) == rising { lo = middle } else { hi = middle }
            }
            out.push(Stretch { ends_slow: true, ..self.stretch(from, lo) });
            out.push(self.stretch(lo, to));
        } else {
            let middle = from + half;
            self.split(from, middle, depth + 1, out);
            self.split(middle, to, depth + 1, out);
        }
    }

    fn stretch(&self, from: f64, to: f64) -> Stretch {
        let fastest = self.speed(from).abs().max(self.speed(0.5 * (from + to)).abs());
        Stretch {
            from,
            to,
            from_value: self.value(from),
            to_value: self.value(to),
            ends_slow: self.speed(to).abs() <= 1e-4 * fastest,
        }
    }

    /// The time at which the polynomial reaches `level` on a stretch that contains it, to a thousandth of a tick.
    fn solve(&self, level: f64, stretch: Stretch, tick_hz: u64) -> f64 {
        let close = 1e-3 / tick_hz as f64;
        let rising = stretch.to_value >= stretch.from_value;
        let (mut lo, mut hi) = (stretch.from, stretch.to);
        let mut x = lo;
        // 64 halvings would exhaust any f64 bracket; Newton takes two or three steps.
        for _ in 0..64 {
            let off = self.value(x) - level;
            let newton = x - off / self.speed(x);
            if off == 0.0 {
                return x;
            }
            if (newton - x).abs() <= close {
                return newton.clamp(lo, hi);
            }
            if (off < 0.0) == rising {
                lo = x
            } else {
                hi = x
            }
            x = if newton > lo && newton < hi { newton } else { 0.5 * (lo + hi) };
        }
        x
    }

    /// How far from `x` (s) the true crossing may be, because θ is only known to `noise`.
    fn uncertainty(&self, x: f64, stretch: Stretch) -> f64 {
        if x < stretch.to || !stretch.ends_slow {
            return (self.noise / self.speed(x).abs()).min(stretch.to - stretch.from);
        }
        self.ends_within(2.0 * self.noise, stretch)
    }

    /// How long a stretch stays within `steps` of its end value, s.
    fn ends_within(&self, steps: f64, stretch: Stretch) -> f64 {
        let sign = if stretch.to_value >= stretch.from_value { 1.0 } else { -1.0 };
        let (mut lo, mut hi) = (stretch.from, stretch.to);
        for _ in 0..60 {
            let middle = 0.5 * (lo + hi);
            if (stretch.to_value - self.value(middle)) * sign > steps { lo = middle } else { hi = middle }
        }
        stretch.to - lo
    }
}

/// Σ c_k x^k.
fn polynomial(c: &Jet, x: f64) -> f64 {
    c.iter().rev().fold(0.0, |sum, &c| sum * x + c)
}

/// The coefficients about `x`.
fn shifted(c: &Jet, x: f64) -> Jet {
    let mut c = *c;
    for k in 0..7 {
        for i in (k..7).rev() {
            c[i] += x * c[i + 1];
        }
    }
    c
}

/// k·(k−1)·…, `order` factors.
fn falling(k: usize, order: usize) -> f64 {
    (0..order).map(|i| (k - i) as f64).product()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use pulsetrain_motion::law::{Class, Curve, Entry, Fixed};
    use std::sync::Arc;

    const HZ: u64 = 16_000_000;

    fn law(curves: Vec<Curve>) -> Law {
        let piece = |(i, curve)| {
            let start = Time::SECOND.times(i as u64);
            Piece { zero: start, start, end: start + Time::SECOND, origin: 0, curve, entry: Entry::SpeedJump }
        };
        let pieces = curves.into_iter().enumerate().map(piece).collect();
        Law::Fixed(Fixed { pieces: Arc::new(pieces), class: Class::Enclosed })
    }

    /// Ticks and directions; optional crossings are not made.
    fn crossings(law: &Law, grid: Grid) -> Vec<(f64, bool)> {
        let mut crossings = Crossings::new(law, grid, HZ);
        let mut found = Vec::new();
        while let Some(crossing) = crossings.advance().unwrap() {
            if !crossing.optional {
                found.push((crossing.at.ticks(), crossing.forward));
            }
        }
        found
    }

    /// The same by a walk in small strides and halving: slow, and it misses what happens within a stride.
    fn walked(theta: impl Fn(f64) -> f64, end_s: f64, grid: Grid, strides: u32) -> Vec<(f64, bool)> {
        let start = theta(0.0);
        let (mut position, mut found) = (0, Vec::new());
        for i in 0..strides {
            let stride = |i: u32| end_s * f64::from(i) / f64::from(strides);
            let (from, to) = (stride(i), stride(i + 1));
            loop {
                let beyond = |t: f64, forward: bool| {
                    let off = theta(t) - start;
                    if forward { off >= grid.up_level(position) } else { off <= grid.down_level(position) }
                };
                let Some(forward) = [true, false].into_iter().find(|&forward| beyond(to, forward)) else { break };
                let (mut lo, mut hi) = (from, to);
                for _ in 0..60 {
                    let middle = 0.5 * (lo + hi);
                    if beyond(middle, forward) { hi = middle } else { lo = middle }
                }
                found.push((hi * HZ as f64, forward));
                position += if forward { 1 } else { -1 };
            }
        }
        found
    }

    fn wave(amplitude: f64, omega: f64, phase: f64) -> Curve {
        Curve::Cosine { offset: 0.0, amplitude, omega, phase }
    }

    proptest! {
        /// Sums of sinusoids and a drift: every crossing that a walk finds, and none besides.
        #[test]
        fn no_crossing_is_missed_or_made_up(
            waves in proptest::collection::vec((-40.0..40.0f64, 0.5..60.0f64, 0.0..6.0f64), 1..4),
            speed in -100.0..100.0f64,
            h in 0.01..0.5f64,
        ) {
            let mut curves = vec![Curve::Polynomial(vec![0.3, speed])];
            curves.extend(waves.iter().map(|&(amplitude, omega, phase)| wave(amplitude, omega, phase)));
            let curve = Curve::Sum(curves);
            let grid = Grid { hysteresis: h };
            let found = crossings(&law(vec![curve.clone()]), grid);
            let walked = walked(|t| curve.value(t), 1.0, grid, 100_000);
            prop_assert_eq!(found.len(), walked.len());
            for (found, walked) in found.iter().zip(walked) {
                prop_assert_eq!(found.1, walked.1);
                // Near turning points both know times less well.
                prop_assert!((found.0 - walked.0).abs() < 1e-2, "{:?} {:?}", found, walked);
            }
        }
    }

    #[test]
    fn pieces_rests_and_the_start_of_a_law() {
        let check = |curves: Vec<Vec<f64>>, expected: &[(f64, bool)]| {
            let law = law(curves.into_iter().map(Curve::Polynomial).collect());
            let found = crossings(&law, Grid::REACH);
            assert_eq!(found.iter().map(|c| c.1).collect::<Vec<_>>(), expected.iter().map(|c| c.1).collect::<Vec<_>>());
            for (found, expected) in found.iter().zip(expected) {
                assert!((found.0 - expected.0 * HZ as f64).abs() < 1e-6, "{found:?} {expected:?}");
            }
        };
        check(vec![vec![7.5]], &[]);
        // Steps count from θ(0); the end of a piece touches.
        check(
            vec![vec![7.5, 2.0], vec![9.5], vec![9.5, -2.0]],
            &[(0.5, true), (1.0, true), (2.5, false), (3.0, false)],
        );
        // A law that jumps steps at once.
        check(vec![vec![0.0], vec![-2.5]], &[(1.0, false), (1.0, false)]);
        // θ = 4u².
        check(vec![vec![0.0, 0.0, 4.0]], &[(0.5, true), (0.5_f64.sqrt(), true), (0.75_f64.sqrt(), true), (1.0, true)]);
    }

    /// A law that is cut off, or slows down for good, just below a level: it has no turning point there.
    #[test]
    fn a_law_that_ends_just_below_a_level_may_touch_it() {
        let rest = 2.0 - 5e-10;
        let law = law(vec![Curve::Polynomial(vec![0.0, rest]), Curve::Polynomial(vec![rest])]);
        for made in [true, false] {
            let mut crossings = Crossings::new(&law, Grid::REACH, HZ);
            let first = crossings.advance().unwrap().unwrap();
            assert!(!first.optional && first.forward);
            let touch = crossings.advance().unwrap().unwrap();
            assert!(touch.optional && touch.forward);
            assert_eq!(touch.at.ticks(), HZ as f64);
            // From 1e-9 steps before the level on, at 2 steps/s.
            assert!((touch.uncertainty_ticks - 2.5e-10 * HZ as f64).abs() < 1e-6, "{touch:?}");
            crossings.settle(made);
            let later = crossings.advance().unwrap();
            assert_eq!(later.is_none(), made);
            assert!(later.is_none_or(|later| later.optional && later.forward));
            assert_eq!(crossings.position(), 1 + i64::from(made));
        }
    }

    #[test]
    fn a_law_that_breaks_is_named() {
        let law = law(vec![Curve::Polynomial(vec![0.0, f64::NAN])]);
        assert!(matches!(Crossings::new(&law, Grid::REACH, HZ).advance(), Err(LawError::Undefined { .. })));
    }

    /// It comes to rest on a level, ever more slowly: for a fifth of a millisecond f64 cannot tell whether it is there.
    #[test]
    fn a_motion_that_eases_out_makes_its_last_step_at_its_end() {
        let motor = |name, step, dir| {
            format!(
                "[motor.{name}]\nsteps_per_rev = 400\nmicrosteps = 4\ndriver = \"A4988\"\npins = {{ step = {step}, dir = {dir} }}\nforward = \"high\"\ngear = 3\n\
                 lead = \"8 mm\"\npull_in = \"300 step/s\"\n"
            )
        };
        let text = format!(
            "board = \"uno\"\ngrid = \"reach\"\n{}{}[machine.table]\nkind = \"xy\"\nmotors = [\"x\", \"y\"]\n[[motion]]\nmachine = \"table\"\n\
             ease = \"0.5312 s\"\npath.circle = {{ radius = \"0.003181 mm\", frequency = \"39.51 Hz\", cycles = 79 }}\n",
            motor("x", 2, 5),
            motor("y", 3, 6)
        );
        let no_files = |_: &std::path::Path| Err(std::io::ErrorKind::NotFound.into());
        let program = pulsetrain_motion::file::read(&text, "eased.toml", &no_files).unwrap();
        let law = &program.motors[0].law;
        let mut crossings = Crossings::new(law, program.grid, HZ);
        let mut last = None;
        while let Some(crossing) = crossings.advance().unwrap() {
            last = Some(crossing);
        }
        let (last, (tick, fraction)) = (last.unwrap(), law.end().unwrap().ticks(HZ));
        assert!(!last.optional && last.at.minus(Instant { tick, fraction }).abs() < 1.0, "{last:?}");
    }
}
