//! 10^8 steps end where they should: nothing adds up.

use crate::common::drift::{Drift, constant, sinusoid};

/// The bound of the first step holds for the last: an error of 10^-8 ticks a step would break it.
fn check(steps: u64, found: Drift) {
    assert_eq!(found.steps, steps);
    assert!(found.largest <= 1.0, "{found:?}");
}

#[test]
fn an_irrational_interval_does_not_drift() {
    check(100_000_000, constant(100_000_000));
}

#[test]
fn an_irrational_period_does_not_drift() {
    check(100_000_000, sinusoid(12_500));
}
