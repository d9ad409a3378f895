//! Circles, one coordinate each, and the periods that a phase accumulator can make.

use super::{Curve, Entry, FARTHEST, Law, LawError, Piece, checked, halves_over};
use crate::Time;

/// One coordinate of a circle: θ = radius·cos(2πt/T), or radius·sin(2πt/T).
#[derive(Clone, Debug, PartialEq)]
pub struct Circle {
    /// Steps; may be negative, not 0.
    radius: f64,
    /// T.
    period: Time,
    /// Number of turns; `None`: endless.
    cycles: Option<u64>,
    /// Whether it is the sine.
    sine: bool,
}

/// Bits of the Pico plotter's phase accumulator. Source: its article, "DDS phase accumulation".
const ACCUMULATOR_BITS: u32 = 32;

/// The period nearest to `period` that direct digital synthesis makes: a phase accumulator of 32 bits to which a whole
/// number M is added once in `update`. T = 2^32·`update`/M. Source: the Pico plotter.
///
/// ```
/// use pulsetrain_motion::{Time, law::dds_period};
/// // 50 Hz, as the Pico plotter has it: 2^32/200 is no whole number, and 4 s come out 89 ns longer.
/// let update = Time::from_ratio(1, 50);
/// let period = dds_period(Time::from_seconds(4.0), update)?;
/// assert!(((period.seconds() - 4.0) * 1e9 - 89.4).abs() < 0.1);
/// // Less than two updates in a turn is no circle.
/// assert!(dds_period(Time::from_seconds(0.03), update).is_err());
/// # Ok::<(), pulsetrain_motion::LawError>(())
/// ```
///
/// # Errors
/// [`LawError::Parameter`] if the period is shorter than two updates, or so long that M would be 0.
pub fn dds_period(period: Time, update: Time) -> Result<Time, LawError> {
    let turn = update.times(1 << ACCUMULATOR_BITS);
    if update <= Time::ZERO || period < update.times(2) || period > turn.times(2) {
        return Err(LawError::Parameter(format!(
            "a period of {} s cannot be made from updates every {} s; it must be two of them at least, and 2^32 at most",
            period.seconds(),
            update.seconds()
        )));
    }
    let nearest = (turn + period.divided_by(2)).raw() / period.raw();
    // At most 2^31, by the check above.
    Ok(turn.divided_by(nearest.max(1) as u64))
}

impl Law {
    /// Coordinate 0 (cosine) or 1 (sine) of a circle about 0, which begins at (`radius`, 0) and at once at full speed.
    ///
    /// # Errors
    /// [`LawError::Parameter`] if the radius is 0 or not finite, the period not 1e-12 to 1e12 s, or there are no turns.
    pub fn circle(radius: f64, period: Time, cycles: Option<u64>, coordinate: usize) -> Result<Law, LawError> {
        checked("radius", radius, "steps", |r| r != 0.0 && r.abs() < FARTHEST)?;
        checked("period", period.seconds(), "s", |t| (1e-12..=1e12).contains(&t))?;
        if cycles == Some(0) {
            return Err(LawError::Parameter("cycles is 0; it must be at least 1".into()));
        }
        Ok(Law::Circle(Circle { radius, period, cycles, sine: coordinate == 1 }))
    }
}

impl Circle {
    /// The periods of two endless circles of the same coordinate.
    pub(super) fn periods(old: &Circle, new: &Circle) -> Option<(Time, Time)> {
        let are_alike = old.sine == new.sine && old.cycles.is_none() && new.cycles.is_none();
        are_alike.then_some((old.period, new.period))
    }

    pub(super) fn end(&self) -> Option<Time> {
        self.cycles.map(|n| self.period.times(n))
    }

    pub(super) fn cycle(&self) -> Option<(Time, Time)> {
        self.cycles.is_none().then_some((Time::ZERO, self.period))
    }

    /// Pieces from turning point to turning point: half periods, and a quarter at the beginning and at the end of a sine.
    pub(super) fn pieces_from(self, at: Time) -> impl Iterator<Item = Result<Piece, LawError>> {
        let end = self.end().unwrap_or(Time::MAX);
        let half = self.period.divided_by(2);
        let before = if self.sine { self.period.divided_by(4) } else { Time::ZERO };
        // k·T/2 = (k/2)·T + (k mod 2)·T/2: exact for even k, within 2^-64 s for odd k.
        let turn = move |k: u64| self.period.times(k / 2) + if k % 2 == 1 { half } else { Time::ZERO } - before;
        let first = halves_over(self.period, at.min(end.before()) + before);
        (first..).map(move |k| (k, turn(k).max(Time::ZERO))).take_while(move |&(_, start)| start < end).map(
            move |(k, start)| {
                // A sine begins a quarter period after its lowest point.
                let high = k.is_multiple_of(2) != self.sine;
                let curve = Curve::Cosine {
                    offset: 0.0,
                    amplitude: if high { self.radius } else { -self.radius },
                    omega: std::f64::consts::TAU / self.period.seconds(),
                    phase: 0.0,
                };
                let end = end.min(turn(k + 1));
                Ok(Piece { zero: turn(k), start, end, origin: 0, curve, entry: Entry::Continuous })
            },
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::law::Cursor;

    #[test]
    fn the_coordinates_are_a_cosine_and_a_sine() {
        let period = Time::from_seconds(0.7);
        for (coordinate, f) in [(0, libm::cos as fn(f64) -> f64), (1, libm::sin)] {
            for radius in [300.0, -20.5] {
                let law = Law::circle(radius, period, Some(3), coordinate).unwrap();
                assert_eq!(law.end(), Some(period.times(3)));
                let mut cursor = Cursor::new(&law);
                for k in 0..=2100 {
                    let t = f64::from(k) / 1000.0;
                    let wanted = radius * f(std::f64::consts::TAU * t / 0.7);
                    let sample = cursor.at(Time::from_seconds(t)).unwrap();
                    assert!((sample.position - wanted).abs() < 1e-10, "{coordinate} at {t} s");
                }
            }
        }
    }

    /// What the Pico plotter's interrupt does, in its own integers.
    #[test]
    fn the_phase_is_that_of_an_accumulator() {
        let update = Time::from_ratio(1, 50);
        let period = dds_period(Time::from_ratio(37, 10), update).unwrap();
        let add = ((1_u64 << 32) as f64 / (3.7 * 50.0)).round() as u32;
        let law = Law::circle(1000.0, period, None, 1).unwrap();
        let mut cursor = Cursor::new(&law);
        let mut accumulator = 0_u32;
        for n in 0..100_000_u64 {
            let phase = f64::from(accumulator) * std::f64::consts::TAU / 4_294_967_296.0;
            let position = cursor.at(update.times(n)).unwrap().position;
            assert!((position - 1000.0 * phase.sin()).abs() < 1e-8, "update {n}");
            accumulator = accumulator.wrapping_add(add);
        }
    }
}
