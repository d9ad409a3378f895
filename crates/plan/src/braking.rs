//! A motor's limits in the numbers of the stop that a board makes by itself: see [`pulsetrain_core::braking`].

use crate::certificate::Certificate;
use crate::error::PlanError;
use pulsetrain_core::braking::{LARGEST_EXPONENT, Limit};
use pulsetrain_motion::program::{BoardLimits, Limits};
use pulsetrain_motion::whole_power;

/// Without a limit for braking, a motor brakes so hard that it stops within this time, s.
pub const SOFTEST_STOP_S: f64 = 1.0;

/// Relative rounding error allowed on the way to the rest interval. The few operations make far less.
const ROUNDING: f64 = 1e-14;

/// The braking limit to send to a board of `tick_hz` with `fraction_bits`, for a motor that brakes with at most
/// `acceleration` (steps/s², positive) and may stop at once from `pull_in` steps/s and below. `None` if the board's
/// numbers cannot hold it: braking so soft or so hard that coming to rest within a step takes more than 2^62 or less
/// than one 2^-F of a tick.
///
/// ```
/// let limit = pulsetrain_plan::braking_limit(10_000.0, 300.0, 16_000_000, 16).unwrap();
/// assert_eq!((limit.mantissa(), limit.exponent(), limit.rest_level()), (221, 32, 2));
/// assert_eq!(pulsetrain_plan::braking_limit(0.0, 200.0, 16_000_000, 16), None);
/// ```
#[must_use]
pub fn braking_limit(acceleration: f64, pull_in: f64, tick_hz: u64, fraction_bits: u32) -> Option<Limit> {
    let second = tick_hz as f64 * (1u64 << fraction_bits) as f64;
    let rest = second / (2.0 * acceleration).sqrt() * (1.0 + ROUNDING);
    if !(1.0..libm::exp2(f64::from(LARGEST_EXPONENT) + 1.0)).contains(&rest) {
        return None;
    }
    let exponent = libm::ilogb(rest);
    let mantissa = (rest / libm::scalbn(1.0, exponent - 7)).ceil();
    let (mantissa, exponent) = if mantissa >= 256.0 { (128.0, exponent + 1) } else { (mantissa, exponent) };
    let level = 2.0 * libm::log2(rest * pull_in / second * (1.0 - ROUNDING));
    Limit::new(mantissa as u8, u8::try_from(exponent).ok()?, level.floor().clamp(0.0, 255.0) as u8)
}

/// The softest limit with which a board's own stop still slows down from `rate` steps/s, steps/s². Below it, the change
/// is less than one unit of the board's fraction. See [`pulsetrain_core::braking`].
#[must_use]
pub fn softest_braking(rate: f64, tick_hz: u64, fraction_bits: u32) -> f64 {
    whole_power(rate, 3) / (tick_hz as f64 * (1u64 << fraction_bits) as f64)
}

/// How a board brings a motor to rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stopping {
    /// The limit that is sent to the board.
    pub limit: Limit,
    /// The motor may stop at once from this speed and below, steps/s.
    pub slow: f64,
}

/// How a motor brakes on a board, by its limits. Without limits it brakes as hard as its law has accelerated so far, or
/// up to a sixth less.
///
/// # Errors
/// [`PlanError::BrakesTooHard`] if the board cannot brake so softly.
pub fn stopping(peaks: &Certificate, limits: &Limits, board: &BoardLimits) -> Result<Stopping, PlanError> {
    let (speed, pull_in) = (peaks.peak_speed.0, limits.pull_in);
    let least = softest_braking(speed, board.tick_hz, board.registers.fraction_bits);
    let acceleration = match limits.max_acceleration {
        Some(limit) if limit < least && speed > pull_in => {
            return Err(PlanError::BrakesTooHard { speed, limit, least });
        }
        Some(limit) => limit,
        None => rounded_down(peaks.peak_acceleration.0.max(speed / SOFTEST_STOP_S)).max(least),
    };
    // If the board's numbers cannot hold it, the motor hardly moves.
    let limit = braking_limit(acceleration, pull_in, board.tick_hz, board.registers.fraction_bits)
        .unwrap_or(Limit::WITHIN_A_STEP);
    Ok(Stopping { limit, slow: pull_in.max((2.0 * acceleration).sqrt()) })
}

/// Rounds down to a quarter of an octave. At the beginning of a motion the peaks grow with each step, and every new
/// limit costs a message to the board.
fn rounded_down(acceleration: f64) -> f64 {
    if acceleration > 0.0 { libm::exp2(0.25 * (4.0 * libm::log2(acceleration)).floor()) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dashu::rational::RBig;
    use proptest::prelude::*;
    use pulsetrain_core::braking::{BrakingPart, RegisterLimits};

    proptest! {
        #[test]
        fn a_limit_is_never_looser_than_what_it_is_made_of(
            exponent in 0.0f64..8.0, pull_in in 0.0f64..5000.0, hz in 1_000_000u64..200_000_000, f in 8u32..=32,
        ) {
            let acceleration = 10f64.powf(exponent);
            let Some(limit) = braking_limit(acceleration, pull_in, hz, f) else {
                // No limit at all, or 2^62 units and more to rest.
                prop_assert!(acceleration < 10.0);
                return Ok(());
            };
            let exact = |x: f64| RBig::try_from(x).unwrap();
            let second = RBig::from(hz) * RBig::from(1u64 << f);
            let rest = RBig::from(limit.mantissa()) * RBig::from(1u128 << limit.exponent()) / RBig::from(128);
            // R² ≥ hz²·2^2F / 2a, and not more by one in 128.
            let wanted = &second * &second / (RBig::from(2) * exact(acceleration));
            prop_assert!(&rest * &rest >= wanted);
            prop_assert!(&rest * &rest * RBig::from(128 * 128) <= wanted * RBig::from(129 * 129 + 1));
            // An interval at the rest level is pull-in or slower: 2^m·I² ≥ R² with m = L.
            let level = limit.rest_level();
            prop_assert!(level < 128);
            if level > 0 {
                let slow = &rest * &rest / RBig::from(1u128 << level);
                let pull_in = exact(pull_in);
                prop_assert!(slow * &pull_in * &pull_in >= &second * &second);
            }
        }
    }

    #[test]
    fn at_the_gentlest_limit_an_add_of_one_is_all() {
        let (hz, f, rate) = (16_000_000, 16, 160_000.0);
        let softest = softest_braking(rate, hz, f);
        assert_eq!(softest.round(), 3906.0);
        let interval = (100 << 16) + 1;
        let add = |acceleration| {
            let limit = braking_limit(acceleration, 0.0, hz, f).unwrap();
            match limit.next(interval, &RegisterLimits::with_fraction_bits(f)) {
                BrakingPart::Steps { add, .. } => add,
                next => panic!("{next:?}"),
            }
        };
        assert_eq!(add(softest), 1);
        assert!(add(8.0 * softest) >= 2);
    }
}
