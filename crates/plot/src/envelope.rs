//! A curve of any length in bounded memory, which hides no extreme value.

/// Points with growing x. While they are few each one is kept; then the first, lowest, highest and last point of each
/// column.
///
/// Two neighbouring columns become one as the curve grows, so that the range need not be known beforehand.
#[derive(Clone, Debug, Default)]
pub struct Envelope {
    points: Vec<(f64, f64)>,
    columns: Vec<Column>,
    column_width: f64,
    start: f64,
    last: (f64, f64),
    range: Option<(f64, f64)>,
}

/// Columns at most; after a merge there are half as many. They are as fine as the lines are thick.
const COLUMNS: usize = 1024;
/// Up to this number each point is kept.
const POINTS: usize = 3000;

#[derive(Clone, Copy, Debug)]
struct Column {
    number: usize,
    first: (f64, f64),
    lowest: (f64, f64),
    highest: (f64, f64),
    last: (f64, f64),
}

impl Column {
    fn of(number: usize, point: (f64, f64)) -> Column {
        Column { number, first: point, lowest: point, highest: point, last: point }
    }

    fn add(&mut self, other: Column) {
        if other.lowest.1 < self.lowest.1 {
            self.lowest = other.lowest;
        }
        if other.highest.1 > self.highest.1 {
            self.highest = other.highest;
        }
        self.last = other.last;
    }
}

impl Envelope {
    /// Adds a point. Its x must not be below the x of the point before. A point with NaN or an infinity is ignored.
    pub fn push(&mut self, x: f64, y: f64) {
        if !x.is_finite() || !y.is_finite() {
            return;
        }
        let (low, high) = self.range.unwrap_or((y, y));
        self.range = Some((low.min(y), high.max(y)));
        self.last = (x, y);
        if self.columns.is_empty() {
            if self.points.is_empty() {
                self.start = x;
            }
            self.points.push((x, y));
            if self.points.len() > POINTS {
                self.fold();
            }
        } else {
            self.insert((x, y));
        }
    }

    /// Sorts the single points into columns.
    fn fold(&mut self) {
        let points = std::mem::take(&mut self.points);
        let span = self.last.0 - self.start;
        self.column_width = if span > 0.0 { span / (COLUMNS / 2) as f64 } else { f64::MIN_POSITIVE };
        for point in points {
            self.insert(point);
        }
    }

    fn insert(&mut self, point: (f64, f64)) {
        let mut number = (point.0 - self.start) / self.column_width;
        while number >= COLUMNS as f64 {
            self.column_width *= 2.0;
            number /= 2.0;
            let columns = std::mem::take(&mut self.columns);
            for column in columns {
                self.merge(Column { number: column.number / 2, ..column });
            }
        }
        self.merge(Column::of(number as usize, point));
    }

    fn merge(&mut self, column: Column) {
        match self.columns.last_mut() {
            Some(last) if last.number == column.number => last.add(column),
            _ => self.columns.push(column),
        }
    }

    /// The points to draw in order of x: each point, or up to four for each column.
    #[must_use]
    pub fn points(&self) -> Vec<(f64, f64)> {
        if self.columns.is_empty() {
            return self.points.clone();
        }
        let mut points = Vec::with_capacity(4 * self.columns.len());
        for column in &self.columns {
            let (a, b) = (column.lowest, column.highest);
            let (a, b) = if a.0 <= b.0 { (a, b) } else { (b, a) };
            points.extend([column.first, a, b, column.last]);
        }
        points.dedup();
        points
    }

    /// For each column its x, and its lowest and highest y. Empty while each point is kept.
    pub fn bars(&self) -> impl Iterator<Item = (f64, f64, f64)> {
        self.columns.iter().map(|column| (column.lowest.0, column.lowest.1, column.highest.1))
    }

    /// Whether each point is still kept.
    #[must_use]
    pub fn is_exact(&self) -> bool {
        self.columns.is_empty()
    }

    /// Lowest and highest y.
    #[must_use]
    pub fn range(&self) -> Option<(f64, f64)> {
        self.range
    }

    /// First and last x.
    #[must_use]
    pub fn span(&self) -> Option<(f64, f64)> {
        self.range.map(|_| (self.start, self.last.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn envelope(ys: impl IntoIterator<Item = f64>) -> Envelope {
        let mut envelope = Envelope::default();
        for (i, y) in ys.into_iter().enumerate() {
            envelope.push(i as f64, y);
        }
        envelope
    }

    #[test]
    fn a_single_outlier_among_a_million_points_is_drawn() {
        let envelope = envelope((0..1_000_000).map(|i| if i == 123_456 { 9.0 } else { (f64::from(i) * 0.01).sin() }));
        let points = envelope.points();
        assert!(points.contains(&(123_456.0, 9.0)));
        assert!(points.len() <= 4 * COLUMNS, "{}", points.len());
        assert_eq!(envelope.span(), Some((0.0, 999_999.0)));
    }

    #[test]
    fn few_points_stay_as_they_are() {
        let envelope = envelope([3.0, 1.0, f64::NAN, 2.0]);
        assert_eq!(envelope.points(), [(0.0, 3.0), (1.0, 1.0), (3.0, 2.0)]);
        assert!(envelope.is_exact());
    }

    proptest! {
        #[test]
        fn extremes_and_order_survive(ys in prop::collection::vec(-1e3..1e3f64, 1..20_000)) {
            let envelope = envelope(ys.iter().copied());
            let points = envelope.points();
            prop_assert!(points.is_sorted_by(|a, b| a.0 <= b.0));
            let highest = ys.iter().copied().fold(f64::MIN, f64::max);
            let lowest = ys.iter().copied().fold(f64::MAX, f64::min);
            prop_assert_eq!(points.iter().map(|p| p.1).fold(f64::MIN, f64::max), highest);
            prop_assert_eq!(points.iter().map(|p| p.1).fold(f64::MAX, f64::min), lowest);
            prop_assert_eq!(envelope.range(), Some((lowest, highest)));
        }
    }
}
