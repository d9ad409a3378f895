//! An axis, linear or logarithmic, with round ticks and labels in a unit that fits.

use std::ops::Range;

use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};

use pulsetrain_motion::{human, whole_power};

/// A range of numbers from `low` to `high`, which differ. Both are positive if `log`.
#[derive(Clone, Debug)]
pub(super) struct Axis {
    low: f64,
    high: f64,
    log: bool,
    labels: Labels,
}

/// How the labels of an axis are written.
#[derive(Clone, Copy, Debug)]
pub(super) enum Labels {
    /// The number, multiplied by this factor.
    Number(f64),
    /// Seconds with a unit that fits each label: "10 µs", "1 ms".
    Seconds,
}

impl Axis {
    /// A linear axis around `range`, with `margin` (a share of the range) at both ends.
    pub(super) fn linear(range: Option<(f64, f64)>, margin: f64, labels: Labels) -> Axis {
        let (low, high) = range.unwrap_or((0.0, 1.0));
        let span = if high - low > 1e-12 * high.abs().max(low.abs()) { high - low } else { high.abs().max(1.0) };
        Axis { low: low - margin * span, high: low.max(high) + margin * span, log: false, labels }
    }

    /// A logarithmic axis around `range`, which is positive.
    pub(super) fn logarithmic((low, high): (f64, f64), labels: Labels) -> Axis {
        let margin = libm::pow(high / low, 0.04).max(1.05);
        Axis { low: low / margin, high: high * margin, log: true, labels }
    }

    fn linear_ticks(&self, most: usize) -> Vec<f64> {
        let rough = (self.high - self.low) / most.max(1) as f64;
        let decade = libm::exp10(libm::log10(rough).floor());
        // A step of 1, 2, 5 or 10 decades: the last one is always large enough.
        let step = [1.0, 2.0, 5.0].iter().map(|m| m * decade).find(|step| *step >= rough).unwrap_or(10.0 * decade);
        let (first, last) = ((self.low / step).ceil() as i64, (self.high / step).floor() as i64);
        (first..=last).map(|k| k as f64 * step).collect()
    }

    fn log_ticks(&self, most: usize) -> Vec<f64> {
        let decades = libm::log10(self.low).floor() as i32..=libm::log10(self.high).ceil() as i32;
        let ticks = |mantissas: &[f64], every: usize| -> Vec<f64> {
            decades
                .clone()
                .step_by(every)
                .flat_map(|decade| mantissas.iter().map(move |m| m * whole_power(10.0, decade)))
                .filter(|tick| (self.low..=self.high).contains(tick))
                .collect()
        };
        [&[1.0, 2.0, 5.0][..], &[1.0, 3.0], &[1.0]]
            .iter()
            .map(|mantissas| ticks(mantissas, 1))
            .find(|ticks| ticks.len() <= most)
            .unwrap_or_else(|| ticks(&[1.0], 2))
    }
}

impl Ranged for Axis {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, (from, to): (i32, i32)) -> i32 {
        let part = if self.log {
            libm::log(value / self.low) / libm::log(self.high / self.low)
        } else {
            (value - self.low) / (self.high - self.low)
        };
        // What lies outside is drawn just outside, so that pixels fit an i32.
        from + (part.clamp(-1.0, 2.0) * f64::from(to - from)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        let most = hint.bold_points();
        if self.log { self.log_ticks(most) } else { self.linear_ticks(most) }
    }

    fn range(&self) -> Range<f64> {
        self.low..self.high
    }
}

impl ValueFormatter<f64> for Axis {
    fn format_ext(&self, value: &f64) -> String {
        match self.labels {
            Labels::Number(factor) => human::significant(value * factor, 6),
            Labels::Seconds => human::seconds(*value),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(axis: &Axis, most: usize, expected: &[&str]) {
        let labels: Vec<_> = axis.key_points(most).iter().map(|tick| axis.format_ext(tick)).collect();
        assert_eq!(labels, expected);
    }

    #[test]
    fn ticks_are_round() {
        check(&Axis::linear(Some((0.0, 1.0)), 0.0, Labels::Number(1.0)), 6, &["0", "0.2", "0.4", "0.6", "0.8", "1"]);
        check(&Axis::linear(Some((0.0, 0.012)), 0.0, Labels::Number(1e3)), 4, &["0", "5", "10"]);
        check(&Axis::linear(Some((5.0, 5.0)), 0.1, Labels::Number(1.0)), 4, &["4.5", "5", "5.5"]);
        check(&Axis::logarithmic((70e-6, 5e-3), Labels::Seconds), 5, &["100 µs", "300 µs", "1 ms", "3 ms"]);
        check(&Axis::logarithmic((1e-6, 10.0), Labels::Seconds), 5, &["10 µs", "1 ms", "100 ms", "10 s"]);
    }

    #[test]
    fn values_far_outside_still_map() {
        let axis = Axis::linear(Some((0.0, 1.0)), 0.0, Labels::Number(1.0));
        assert_eq!(axis.map(&f64::MAX, (0, 100)), 200);
        assert_eq!(axis.map(&0.5, (100, 0)), 50);
    }
}
