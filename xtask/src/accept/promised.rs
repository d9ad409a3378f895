//! Motions that an Uno is to follow at 1 Mbaud: slower than 90 % of the rates that `cargo xtask bench uno --motions` asks for.

use super::Tried;
use super::motions::Motion;
use super::outcome::Outcome;

/// Up to so many Hz of turning, the rates of 1 to 4 motors, 1000 steps/s each.
const RATES: [(f64, [f64; 4]); 3] =
    [(5.0, [140.0, 70.0, 32.0, 20.0]), (15.0, [140.0, 65.0, 30.0, 12.0]), (35.0, [135.0, 50.0, 7.0, 2.0])];
/// Slower than this share of them.
const SHARE: f64 = 0.9;

/// Whether a motion is one of them. `promised_hz` is what the board promises for its pins and drivers, steps/s. A motion that turns at more than 35 Hz
/// is not one of them, nor is one whose turning is not known.
pub(super) fn is_promised(motion: &Motion, promised_hz: f64) -> bool {
    let row = motion.turns_hz.and_then(|hz| RATES.iter().find(|(to_hz, _)| hz <= *to_hz));
    let rate = row.and_then(|(_, rates)| rates.get(motion.motors - 1));
    rate.is_some_and(|rate| motion.rate < SHARE * promised_hz.min(1e3 * rate))
}

/// Of them so many may be refused: 2 %, or two, where few were tried.
const MOST_REFUSED: f64 = 0.02;
const FEW_REFUSED: usize = 2;

/// How many of them are refused, and whether that is too many. Limits of a motor that the file itself sets are no refusals of the board's.
pub(super) fn line(tried: &[Tried]) -> (String, bool) {
    let of: Vec<&Tried> = tried.iter().filter(|tried| tried.promised).collect();
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
        "\nuno, slower than 90 % of the rates of `bench uno --motions`: {} tried, {by_board} refused ({:.1} %), and {by_file} for limits of the file\n",
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
                is_promised(&motion(motors, rate, turns_hz), 25e3),
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
        // What the board promises is less.
        check(1, 22e3, Some(1.0), true);
        check(1, 23e3, Some(1.0), false);
    }
}
