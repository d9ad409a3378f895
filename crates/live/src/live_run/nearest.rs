//! The search for the value nearest to a wanted one that motors and board can follow.

/// A bisection between a value that is allowed and one that is not. While the two differ by more than a factor of 2 it tries their geometric mean, then
/// their arithmetic mean. So it takes few tries, even from 1 to 1e300.
#[derive(Clone, Copy, Debug)]
pub(super) struct Nearest {
    /// The farthest value that is known to be allowed.
    holds: f64,
    /// The nearest value that is known not to be.
    breaks: f64,
    /// How far apart both were at first.
    width: f64,
    tries: u32,
}

/// The nearest value is found to such a part of itself, or of the way to the wanted one if that is less.
const PART: f64 = 1e-3;
/// Values that are tried, at most. Each takes a step of the board's time.
pub(super) const MAX_VALUES: u32 = 24;
/// What is smaller than this part of 1, or of the value that is not allowed, counts as 0.
const SMALL: f64 = 1e-3;

impl Nearest {
    /// Between a value that is allowed and one that is not.
    pub(super) fn new(holds: f64, breaks: f64) -> Nearest {
        Nearest { holds, breaks, width: (breaks - holds).abs(), tries: 0 }
    }

    /// The farthest value that is known to be allowed.
    pub(super) fn found(&self) -> f64 {
        self.holds
    }

    /// The value to try next; `None` when the nearest one is found.
    pub(super) fn next(&mut self) -> Option<f64> {
        let left = (self.breaks - self.holds).abs();
        let is_found = left <= PART * self.breaks.abs().min(self.width);
        if is_found || self.tries == MAX_VALUES {
            return None;
        }
        self.tries += 1;
        let middle = self.middle();
        let nearer = nice(middle, (middle - self.holds).abs().min((self.breaks - middle).abs()));
        Some(if self.is_between(nearer) { nearer } else { middle }).filter(|value| self.is_between(*value))
    }

    /// Notes whether the motors follow a value.
    pub(super) fn note(&mut self, value: f64, is_allowed: bool) {
        *(if is_allowed { &mut self.holds } else { &mut self.breaks }) = value;
    }

    /// A whole multiple of `unit` between the allowed value and the other one: the nearest to `value`, or else the nearest to the middle. `None` if
    /// neither lies between them.
    pub(super) fn whole(&self, value: f64, unit: f64) -> Option<f64> {
        let whole = |value: f64| (value / unit).round() * unit;
        [value, 0.5 * self.holds + 0.5 * self.breaks].map(whole).into_iter().find(|value| self.is_between(*value))
    }

    fn is_between(&self, value: f64) -> bool {
        let (low, high) = (self.holds.min(self.breaks), self.holds.max(self.breaks));
        low < value && value < high
    }

    fn middle(&self) -> f64 {
        let Nearest { holds, breaks, .. } = *self;
        if breaks != 0.0 && holds * breaks.signum() < 0.0 {
            return 0.0;
        }
        let small = SMALL * breaks.abs().max(holds.abs()).min(1.0);
        let sign = if breaks == 0.0 { holds.signum() } else { breaks.signum() };
        let [one, other] = [holds, breaks].map(|end| end.abs().max(if end == 0.0 { small } else { 0.0 }));
        if one.max(other) > 2.0 * one.min(other) {
            return sign * one.sqrt() * other.sqrt();
        }
        0.5 * holds + 0.5 * breaks
    }
}

/// A value to the digits that its distance from others deserves: people read it.
fn nice(value: f64, span: f64) -> f64 {
    let digits = (4.0 - libm::log10(span.abs().max(1e-12))).ceil().clamp(0.0, 15.0) as usize;
    format!("{value:.digits$}").parse().unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// What is found between `from` and `to` if values beyond `limit` are not allowed, and after how many tries.
    fn found(from: f64, to: f64, limit: f64) -> (f64, u32) {
        let mut nearest = Nearest::new(from, to);
        while let Some(value) = nearest.next() {
            nearest.note(value, if to > from { value <= limit } else { value >= limit });
        }
        (nearest.found(), nearest.tries)
    }

    #[test]
    fn a_limit_is_found_wherever_it_is() {
        for (from, to, limit, most) in [
            (1.0, 2.0, 1.7, 11),
            (200.0, 1e6, 318.3, 16),
            (200.0, 1e15, 318.3, 19),
            (200.0, 1e300, 200.5, 22),
            (0.0, 1e6, 5.0, 18),
            (0.0, -1e9, -0.2, 20),
            (-40.0, 1e9, 3.0, 20),
            (-40.0, 1e9, -3.0, 20),
            (1.0, 1e-9, 0.03, 18),
            (5.0, 0.0, 0.004, 20),
        ] {
            let (value, tries) = found(from, to, limit);
            assert!((value - limit).abs() <= 0.002 * limit.abs(), "{from} to {to}: {value}, not {limit}");
            assert!(tries <= most, "{from} to {to}: {tries} tries");
        }
    }

    #[test]
    fn whole_numbers_between_are_found() {
        let mut nearest = Nearest::new(3.0, 5.0);
        assert_eq!((nearest.whole(3.4, 1.0), nearest.whole(4.4, 2.0)), (Some(4.0), Some(4.0)));
        nearest.note(4.0, true);
        assert_eq!(nearest.whole(4.4, 1.0), None);
    }

    proptest! {
        /// Ends of any size and sign: what is found is allowed, and it is near the limit unless that is nearly 0.
        #[test]
        fn what_is_found_is_allowed(
            from in prop_oneof![Just(0.0), -1e3..1e3, 1e-6..1e12],
            decades in -9.0_f64..250.0,
            is_negative: bool,
            part in 0.0_f64..1.0,
        ) {
            let to = 10f64.powf(decades) * if is_negative { -1.0 } else { 1.0 };
            let bits = |value: f64| if value < 0.0 { -(value.abs().to_bits() as i128) } else { value.to_bits() as i128 };
            // Each size is as likely as any other.
            let at = bits(from) + ((bits(to) - bits(from)) as f64 * part) as i128;
            let limit = f64::from_bits(at.unsigned_abs() as u64) * if at < 0 { -1.0 } else { 1.0 };
            let (value, tries) = found(from, to, limit);
            prop_assert!(tries <= MAX_VALUES);
            let is_allowed = value == from || if to > from { value <= limit } else { value >= limit };
            prop_assert!(is_allowed, "{from} to {to}: {value} is beyond {limit}");
            if limit.abs() > 1e-3 {
                prop_assert!((value - limit).abs() <= 2e-3 * limit.abs(), "{from} to {to}: {value}, not {limit}");
            }
        }
    }
}
