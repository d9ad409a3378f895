//! Random motions of an Uno that `plan` should accept at 1 Mbaud. Their rates are lower than those in
//! docs/benchmarks/promises.md: they have any pins, drivers and tolerances.

use super::Tried;
use super::motions::Motion;
use super::outcome::Outcome;

/// Rates of 1 to 4 motors in 1000 steps/s, for reversals at up to this many Hz.
const RATES: [(f64, [f64; 4]); 3] =
    [(5.0, [140.0, 70.0, 32.0, 20.0]), (15.0, [140.0, 65.0, 30.0, 12.0]), (35.0, [135.0, 50.0, 7.0, 2.0])];
/// An expected motion is slower than this share of these rates.
const SHARE: f64 = 0.9;

/// Whether `plan` should accept a motion. `limit_hz` is the board's limit for its pins and drivers, steps/s. Nothing is
/// expected if its reversals are faster than 35 Hz, or unknown.
pub(super) fn is_expected(motion: &Motion, limit_hz: f64) -> bool {
    let row = motion.turns_hz.and_then(|hz| RATES.iter().find(|(to_hz, _)| hz <= *to_hz));
    let rate = row.and_then(|(_, rates)| rates.get(motion.motors - 1));
    rate.is_some_and(|rate| motion.rate < SHARE * limit_hz.min(1e3 * rate))
}

/// Of the expected motions this many may be refused: 2 %, or two if few were tried.
const MOST_REFUSED: f64 = 0.02;
const FEW_REFUSED: usize = 2;

/// How many expected motions are refused, and whether that is too many. A refusal because of limits in the file itself
/// does not count.
pub(super) fn line(tried: &[Tried]) -> (String, bool) {
    let of: Vec<&Tried> = tried.iter().filter(|tried| tried.expected).collect();
    if of.is_empty() {
        return (String::new(), false);
    }
    let refused = |own: bool| {
        let is_own = |why: &str| why.contains("the motor's limit is");
        of.iter().filter(|tried| matches!(&tried.outcome, Outcome::Refused(why) if is_own(why) == own)).count()
    };
    let (by_board, by_file) = (refused(false), refused(true));
    let too_many = by_board > FEW_REFUSED && by_board as f64 > MOST_REFUSED * of.len() as f64;
    let line = format!(
        "\nuno, slower than 90 % of 140, 70, 32, 20 k steps/s (fewer for fast reversals): {} tried, {by_board} refused ({:.1} %), and {by_file} for limits of the file\n",
        of.len(),
        100.0 * by_board as f64 / of.len() as f64
    );
    (line, too_many)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_row_is_that_of_the_fastest_turns() {
        let motion = |motors, rate, turns_hz| Motion { files: Vec::new(), motors, endless: false, rate, turns_hz };
        let check = |motors, rate, turns_hz, expected| {
            assert_eq!(
                is_expected(&motion(motors, rate, turns_hz), 25e3),
                expected,
                "{motors} at {rate}, {turns_hz:?}"
            );
        };
        check(4, 17e3, Some(5.0), true);
        check(4, 17e3, Some(5.1), false);
        check(4, 10e3, Some(15.0), true);
        check(3, 6e3, Some(35.0), true);
        check(3, 6e3, Some(36.0), false);
        check(3, 6e3, None, false);
        // The board's limit is lower.
        check(1, 22e3, Some(1.0), true);
        check(1, 23e3, Some(1.0), false);
    }
}
