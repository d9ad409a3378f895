//! Matched steps, for alignment.

/// A matched step, for alignment: its tick in the trace and how late it is, ticks of the trace.
pub(crate) type Match = (u64, f64);

/// Matched steps for a fit.
#[derive(Default)]
pub(super) struct Matches {
    /// All matches of a short trace, or an even selection from a long one.
    pub(super) kept: Vec<Match>,
    seen: u64,
    /// One in 2^`thinned` matches is kept.
    thinned: u32,
    /// Of all errors without outliers: lowest and highest, number, sum of squares; ticks of the trace.
    range: Option<(f64, f64)>,
    near: f64,
    squares: f64,
}

impl Matches {
    /// Adds a matched step. `near` is false for outliers and delayed steps.
    pub(super) fn push(&mut self, (tick, late): Match, near: bool) {
        const MOST: usize = 1 << 16;
        if self.seen.is_multiple_of(1 << self.thinned) {
            if self.kept.len() == MOST {
                let mut index = 0;
                self.kept.retain(|_| {
                    index += 1;
                    index % 2 == 1
                });
                self.thinned += 1;
            }
            self.kept.push((tick, late));
        }
        self.seen += 1;
        if near {
            let (low, high) = self.range.unwrap_or((late, late));
            self.range = Some((low.min(late), high.max(late)));
            self.near += 1.0;
            self.squares += late * late;
        }
    }

    pub(super) fn and(mut self, other: Matches) -> Matches {
        self.kept.extend(other.kept);
        self.range = match (self.range, other.range) {
            (Some(a), Some(b)) => Some((a.0.min(b.0), a.1.max(b.1))),
            (a, b) => a.or(b),
        };
        self.near += other.near;
        self.squares += other.squares;
        self
    }

    /// The middle of the errors, and the largest error of a fit at its ends (4σ), ticks.
    pub(super) fn middle(&self) -> (f64, f64) {
        // A fitted line is uncertain by 2σ/√n at its ends.
        self.range.map_or((0.0, 0.0), |(low, high)| (0.5 * (low + high), 8.0 * self.squares.sqrt() / self.near))
    }
}
