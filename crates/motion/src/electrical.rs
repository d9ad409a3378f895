//! How fast a motor's winding lets it step: the calculator of seed 004, with its working.
//!
//! The current in a winding of inductance L on a supply V rises by I in L·I/V. A full step turns it from +I to −I, or
//! from full to none and back, which takes L·I·2/V; no step can be faster and still have its torque.

/// The source of the formula, as printed beside every figure.
pub const SOURCE: &str = "Daycounter stepper motor calculator, as quoted in seed 004: T = L·Imax·2/V";

/// The electrical data of a motor and its supply.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Winding {
    /// Inductance of one phase, H; positive.
    pub inductance_h: f64,
    /// Phase current as the driver is set, A; positive.
    pub current_a: f64,
    /// Supply of the driver, V; positive.
    pub voltage_v: f64,
    /// Full steps in one revolution of the motor; positive.
    pub full_steps_per_rev: f64,
    /// Microsteps in a full step, at least 1.
    pub microsteps: u32,
}

/// One figure of the calculation: what it is, how it comes about, what it comes to.
#[derive(Clone, Debug, PartialEq)]
pub struct Figure {
    /// What it is.
    pub name: &'static str,
    /// The formula with the numbers in it.
    pub formula: String,
    /// In `unit`.
    pub value: f64,
    /// Its unit.
    pub unit: &'static str,
    /// Where the formula comes from.
    pub source: &'static str,
}

impl Winding {
    /// Shortest time of a full step, s: L·I·2/V.
    #[must_use]
    pub fn full_step_s(&self) -> f64 {
        self.inductance_h * self.current_a * 2.0 / self.voltage_v
    }

    /// Shortest time of a step (microstep), s.
    #[must_use]
    pub fn step_s(&self) -> f64 {
        self.full_step_s() / f64::from(self.microsteps)
    }

    /// Highest step rate, steps/s.
    #[must_use]
    pub fn max_speed(&self) -> f64 {
        1.0 / self.step_s()
    }

    /// The figures from the winding alone: step time, speed in rev/s and rpm.
    #[must_use]
    pub fn figures(&self) -> Vec<Figure> {
        let steps_per_rev = self.full_steps_per_rev * f64::from(self.microsteps);
        let step_us = self.step_s() * 1e6;
        let rev_s = self.step_s() * steps_per_rev;
        let figure = |name, formula, value, unit| Figure { name, formula, value, unit, source: SOURCE };
        vec![
            figure(
                "shortest full step",
                format!(
                    "L·I·2/V = {} mH × {} A × 2 / {} V",
                    number(self.inductance_h * 1e3),
                    number(self.current_a),
                    number(self.voltage_v)
                ),
                self.full_step_s() * 1e3,
                "ms",
            ),
            figure(
                "shortest step",
                format!("full step / microsteps = {} ms / {}", number(self.full_step_s() * 1e3), self.microsteps),
                step_us,
                "us",
            ),
            figure("fastest step rate", format!("1 / {} us", number(step_us)), self.max_speed(), "step/s"),
            figure(
                "shortest revolution",
                format!(
                    "step × steps per revolution = {} us × {} × {}",
                    number(step_us),
                    number(self.full_steps_per_rev),
                    self.microsteps
                ),
                rev_s,
                "s",
            ),
            figure("fastest speed", format!("1 / {} s", number(rev_s)), 1.0 / rev_s, "rev/s"),
            figure("the same", format!("60 / {} s", number(rev_s)), 60.0 / rev_s, "rpm"),
        ]
    }

    /// The figures of a sketch that steps from a timer which counts every `tick_us` µs: seed 004's own working.
    ///
    /// The sketch cuts the step time to whole microseconds, rounds up to whole counts, and writes that number of counts
    /// to a compare register; but a timer that is cleared on compare match runs one count longer than the register says
    /// (ATmega328P DS40002061B, section 18.7.2: period = OCR + 1), and so its steps are slower than it announces.
    #[must_use]
    pub fn sketch_figures(&self, tick_us: f64) -> Vec<Figure> {
        const SEED: &str = "seed 004, StepperDriver sketch";
        const DATASHEET: &str = "ATmega328P DS40002061B, CTC mode: the counter runs 0..=OCR, OCR + 1 counts";
        let steps_per_rev = self.full_steps_per_rev * f64::from(self.microsteps);
        // A hair more than nothing, so that 140.0 computed as 139.999… does not lose a whole microsecond.
        let whole_us = (self.step_s() * 1e6 + 1e-9).floor();
        let counts = (whole_us / tick_us).ceil();
        let announced_us = counts * tick_us;
        let real_us = (counts + 1.0) * tick_us;
        let rev_s = announced_us * steps_per_rev / 1e6;
        let real_rev_s = real_us * steps_per_rev / 1e6;
        let figure = |name, formula, value, unit, source| Figure { name, formula, value, unit, source };
        vec![
            figure("step in whole microseconds", "the sketch cuts the fraction off".into(), whole_us, "us", SEED),
            figure(
                "timer counts",
                format!("ceil({} us / {} us)", number(whole_us), number(tick_us)),
                counts,
                "counts",
                SEED,
            ),
            figure("announced step", format!("{} × {} us", number(counts), number(tick_us)), announced_us, "us", SEED),
            figure(
                "announced revolution",
                format!("{} us × {}", number(announced_us), number(steps_per_rev)),
                rev_s,
                "s",
                SEED,
            ),
            figure("announced speed", format!("1 / {} s", number(rev_s)), 1.0 / rev_s, "rev/s", SEED),
            figure(
                "what the sketch really makes",
                format!("({} + 1) × {} us", number(counts), number(tick_us)),
                real_us,
                "us",
                DATASHEET,
            ),
            figure("real speed", format!("1 / {} s", number(real_rev_s)), 1.0 / real_rev_s, "rev/s", DATASHEET),
        ]
    }
}

/// At most six significant digits, without trailing zeros.
fn number(value: f64) -> String {
    let magnitude = if value == 0.0 { 0 } else { value.abs().log10().floor() as i32 };
    let places = usize::try_from(5 - magnitude).unwrap_or(0);
    let text = format!("{value:.places$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Seed 004's motor: 50 mH, 0.135 A, 12 V, 200 steps, eighth stepping.
    const SEED_004: Winding =
        Winding { inductance_h: 0.05, current_a: 0.135, voltage_v: 12.0, full_steps_per_rev: 200.0, microsteps: 8 };

    #[track_caller]
    fn check(figures: &[Figure], name: &str, value: f64, unit: &str, formula: &str) {
        let figure = figures.iter().find(|f| f.name == name).unwrap();
        assert!((figure.value - value).abs() < 1e-9 * value, "{name}: {} for {value}", figure.value);
        assert_eq!((figure.unit, figure.formula.as_str()), (unit, formula));
    }

    #[test]
    fn seed_004_from_the_winding() {
        let figures = SEED_004.figures();
        check(&figures, "shortest full step", 1.125, "ms", "L·I·2/V = 50 mH × 0.135 A × 2 / 12 V");
        check(&figures, "shortest step", 140.625, "us", "full step / microsteps = 1.125 ms / 8");
        check(&figures, "shortest revolution", 0.225, "s", "step × steps per revolution = 140.625 us × 200 × 8");
        check(&figures, "the same", 60.0 / 0.225, "rpm", "60 / 0.225 s");
    }

    #[test]
    fn seed_004_as_its_sketch_has_it() {
        let figures = SEED_004.sketch_figures(8.0);
        check(&figures, "step in whole microseconds", 140.0, "us", "the sketch cuts the fraction off");
        check(&figures, "timer counts", 18.0, "counts", "ceil(140 us / 8 us)");
        check(&figures, "announced step", 144.0, "us", "18 × 8 us");
        check(&figures, "announced revolution", 0.2304, "s", "144 us × 1600");
        check(&figures, "announced speed", 1.0 / 0.2304, "rev/s", "1 / 0.2304 s");
        check(&figures, "what the sketch really makes", 152.0, "us", "(18 + 1) × 8 us");
    }

    #[test]
    fn numbers_are_short() {
        assert_eq!(number(140.625), "140.625");
        assert_eq!(number(1_600_000.0), "1600000");
        assert_eq!(number(0.000_012_345_678), "0.0000123457");
        assert_eq!(number(0.0), "0");
    }
}
