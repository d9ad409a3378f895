//! How fast a motor's winding lets it step: the calculator of the maximum-speed article, with its working.
//!
//! The current in a winding of inductance L on a supply V rises by I in L·I/V. A full step turns it from +I to −I, or
//! from full to none and back, which takes L·I·2/V; no step can be faster and still have its torque.

use std::ops::RangeInclusive;

/// The source of the formula, as printed with every figure.
pub const SOURCE: &str = "Daycounter stepper motor calculator, as quoted in the maximum-speed article: T = L·Imax·2/V";

/// A full step that takes less or more than this is no motor's, s: its data are in other units.
const FULL_STEP_S: RangeInclusive<f64> = 1e-9..=1e3;

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

/// The electrical data are no motor's.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "inductance, current and voltage make a full step of {full_step_s:e} s; {:e} to {:e} s is possible",
    FULL_STEP_S.start(),
    FULL_STEP_S.end()
)]
pub struct WindingError {
    /// What they come to, s.
    pub full_step_s: f64,
}

impl WindingError {
    /// What to do.
    pub const ADVICE: &str =
        "the motor's data sheet has them, as 3 mH and 1 A; the voltage is the driver's supply, as 24 V";
}

impl Winding {
    /// Returns the winding if its data are possible for a motor.
    ///
    /// # Errors
    /// [`WindingError`] if a full step takes less than 1 ns or more than 1000 s.
    pub fn checked(self) -> Result<Winding, WindingError> {
        let full_step_s = self.full_step_s();
        if FULL_STEP_S.contains(&full_step_s) { Ok(self) } else { Err(WindingError { full_step_s }) }
    }

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
                "µs",
            ),
            figure("fastest step rate", format!("1 / {} µs", number(step_us)), self.max_speed(), "steps/s"),
            figure(
                "shortest revolution",
                format!(
                    "step × steps per revolution = {} µs × {} × {}",
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

    /// The figures of a sketch that steps from an 8-bit timer, Timer2 at 16 MHz with the prescaler 128: the maximum-speed article's own working.
    ///
    /// The sketch cuts the step time to whole microseconds, rounds up to whole counts, and writes that number of counts
    /// to a compare register; but a timer that is cleared on compare match runs one count longer than the register says
    /// (ATmega328P DS40002061B, section 18.7.2: period = OCR + 1), and so its steps are slower than it announces. Where the
    /// counts are more than the register holds, the figures are those of the next prescaler with which they fit.
    ///
    /// # Errors
    /// [`SketchError`] if the sketch has no count for such steps.
    pub fn sketch_figures(&self) -> Result<Vec<Figure>, SketchError> {
        const SKETCH: &str = "the maximum-speed article, its StepperDriver sketch";
        const DATASHEET: &str = "ATmega328P DS40002061B, CTC mode: the counter runs 0..=OCR, OCR + 1 counts";
        let steps_per_rev = self.full_steps_per_rev * f64::from(self.microsteps);
        // A hair more than nothing, so that 140.0 computed as 139.999… does not lose a whole microsecond.
        let whole_us = (self.step_s() * 1e6 + 1e-9).floor();
        if whole_us == 0.0 {
            return Err(SketchError::NoCount { step_us: self.step_s() * 1e6 });
        }
        let counts_of = |prescaler: u32| (whole_us / tick_us(prescaler)).ceil();
        let [seeds, longer @ ..] = PRESCALERS;
        let fits = |prescaler: &u32| counts_of(*prescaler) <= MOST_COUNTS;
        let prescaler = std::iter::once(seeds).chain(longer).find(fits).ok_or(SketchError::TooSlow { whole_us })?;
        let (tick_us, counts) = (tick_us(prescaler), counts_of(prescaler));
        let announced_us = counts * tick_us;
        let real_us = (counts + 1.0) * tick_us;
        let rev_s = announced_us * steps_per_rev / 1e6;
        let real_rev_s = real_us * steps_per_rev / 1e6;
        let figure = |name, formula, value, unit, source| Figure { name, formula, value, unit, source };
        let count = |prescaler| format!("ceil({} µs / {} µs)", number(whole_us), number(self::tick_us(prescaler)));
        let mut figures = vec![figure(
            "step in whole microseconds",
            "the sketch cuts the fraction off".into(),
            whole_us,
            "µs",
            SKETCH,
        )];
        if prescaler != seeds {
            let formula = format!("{}: the 8-bit register holds {MOST_COUNTS} at most", count(seeds));
            figures.push(figure("counts that do not fit", formula, counts_of(seeds), "counts", SKETCH));
            let formula = format!("in place of {seeds}: a count is {} µs", number(tick_us));
            figures.push(figure("prescaler that fits", formula, f64::from(prescaler), "", TIMER2));
        }
        figures.extend([
            figure("timer counts", count(prescaler), counts, "counts", SKETCH),
            figure(
                "announced step",
                format!("{} × {} µs", number(counts), number(tick_us)),
                announced_us,
                "µs",
                SKETCH,
            ),
            figure(
                "announced revolution",
                format!("{} µs × {}", number(announced_us), number(steps_per_rev)),
                rev_s,
                "s",
                SKETCH,
            ),
            figure("announced speed", format!("1 / {} s", number(rev_s)), 1.0 / rev_s, "rev/s", SKETCH),
            figure(
                "what the sketch really makes",
                format!("({} + 1) × {} µs", number(counts), number(tick_us)),
                real_us,
                "µs",
                DATASHEET,
            ),
            figure("real speed", format!("1 / {} s", number(real_rev_s)), 1.0 / real_rev_s, "rev/s", DATASHEET),
        ]);
        Ok(figures)
    }
}

/// The chip that the sketch runs on, Hz.
const SKETCH_HZ: f64 = 16e6;
/// The sketch's prescaler, and those of Timer2 that count more slowly.
const PRESCALERS: [u32; 3] = [128, 256, 1024];
const TIMER2: &str = "ATmega328P DS40002061B, Timer2, clock select bits";
/// The compare register has 8 bits.
const MOST_COUNTS: f64 = 255.0;

/// A count of the timer, µs.
fn tick_us(prescaler: u32) -> f64 {
    f64::from(prescaler) * 1e6 / SKETCH_HZ
}

/// The sketch has no count for steps of this length.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SketchError {
    /// It cuts them to 0 µs.
    #[error("a step takes {} µs; the sketch counts whole microseconds, and cuts that to 0: it cannot make these steps", number(*.step_us))]
    NoCount {
        /// The step, µs.
        step_us: f64,
    },
    /// They are longer than its timer can count.
    #[error(
        "a step takes {} µs; Timer2 counts up to {} µs, with the prescaler 1024: the sketch cannot make these steps",
        number(*.whole_us),
        number(MOST_COUNTS * tick_us(1024))
    )]
    TooSlow {
        /// The step, whole µs.
        whole_us: f64,
    },
}

/// At most six significant digits, without trailing zeros.
fn number(value: f64) -> String {
    let magnitude = if value == 0.0 { 0 } else { libm::log10(value.abs()).floor() as i32 };
    let places = usize::try_from(5 - magnitude).unwrap_or(0);
    let text = format!("{value:.places$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The maximum-speed article's motor: 50 mH, 0.135 A, 12 V, 200 steps, eighth stepping.
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
        check(&figures, "shortest step", 140.625, "µs", "full step / microsteps = 1.125 ms / 8");
        check(&figures, "shortest revolution", 0.225, "s", "step × steps per revolution = 140.625 µs × 200 × 8");
        check(&figures, "the same", 60.0 / 0.225, "rpm", "60 / 0.225 s");
    }

    #[test]
    fn seed_004_as_its_sketch_has_it() {
        let figures = SEED_004.sketch_figures().unwrap();
        check(&figures, "step in whole microseconds", 140.0, "µs", "the sketch cuts the fraction off");
        check(&figures, "timer counts", 18.0, "counts", "ceil(140 µs / 8 µs)");
        check(&figures, "announced step", 144.0, "µs", "18 × 8 µs");
        check(&figures, "announced revolution", 0.2304, "s", "144 µs × 1600");
        check(&figures, "announced speed", 1.0 / 0.2304, "rev/s", "1 / 0.2304 s");
        check(&figures, "what the sketch really makes", 152.0, "µs", "(18 + 1) × 8 µs");
    }

    #[test]
    fn counts_that_do_not_fit_eight_bits_get_a_prescaler_that_fits() {
        // 20.3 ms for a full step: 317 counts of 8 µs.
        let slow = Winding { inductance_h: 0.09, current_a: 1.35, ..SEED_004 };
        let figures = slow.sketch_figures().unwrap();
        check(
            &figures,
            "counts that do not fit",
            317.0,
            "counts",
            "ceil(2531 µs / 8 µs): the 8-bit register holds 255 at most",
        );
        check(&figures, "prescaler that fits", 256.0, "", "in place of 128: a count is 16 µs");
        check(&figures, "timer counts", 159.0, "counts", "ceil(2531 µs / 16 µs)");
        check(&figures, "announced step", 2544.0, "µs", "159 × 16 µs");
        // 255 counts fit: 2040 µs.
        let figures = Winding { inductance_h: 2040e-6 * 12.0 / 0.27 * 8.0, ..SEED_004 }.sketch_figures().unwrap();
        check(&figures, "timer counts", 255.0, "counts", "ceil(2040 µs / 8 µs)");
        assert!(!figures.iter().any(|figure| figure.name.contains("prescaler")));
    }

    #[test]
    fn steps_that_the_sketch_cannot_count_have_no_figures() {
        let fast = Winding { inductance_h: 1e-6, current_a: 0.1, ..SEED_004 };
        let error = fast.sketch_figures().unwrap_err();
        assert!(error.to_string().contains("cuts that to 0"), "{error}");
        let slow = Winding { inductance_h: 6.0, ..SEED_004 };
        let error = slow.sketch_figures().unwrap_err();
        assert!(error.to_string().contains("counts up to 16320 µs"), "{error}");
    }

    #[test]
    fn data_that_are_no_motors_are_refused() {
        assert_eq!(SEED_004.checked(), Ok(SEED_004));
        for (inductance_h, voltage_v) in
            [(0.0, 12.0), (1e-320, 12.0), (0.05, 0.0), (0.05, 1e-30), (f64::INFINITY, 12.0)]
        {
            let error = Winding { inductance_h, voltage_v, ..SEED_004 }.checked().unwrap_err();
            assert!(error.to_string().contains("1e-9 to 1e3 s is possible"), "{error}");
        }
    }

    #[test]
    fn numbers_are_short() {
        assert_eq!(number(140.625), "140.625");
        assert_eq!(number(1_600_000.0), "1600000");
        assert_eq!(number(0.000_012_345_678), "0.0000123457");
        assert_eq!(number(0.0), "0");
    }
}
