//! The braking rule, in exact integers.

use dashu::integer::UBig;
use proptest::prelude::*;
use pulsetrain_core::braking::{BrakingPart, LARGEST_EXPONENT, Limit, RegisterLimits};

/// The intervals of a stop from `interval` on, and the number of its segments. It stops looking after 10^7 steps.
fn stop(limit: Limit, registers: &RegisterLimits, interval: i64) -> (Vec<i64>, u32) {
    let (mut intervals, mut interval, mut parts) = (Vec::new(), interval, 0);
    loop {
        let next = limit.next(interval, registers);
        let Some(segment) = next.segment(interval) else { return (intervals, parts) };
        parts += 1;
        intervals.extend((0..segment.count).map(|k| segment.after(k).interval));
        if next == BrakingPart::LastStep {
            return (intervals, parts);
        }
        interval = segment.after(segment.count).interval;
        assert!(intervals.len() < 10_000_000, "it does not end");
    }
}

/// R, ticks · 2^F, as a fraction of 2^7.
fn rest_interval_times_128(limit: Limit) -> UBig {
    UBig::from(limit.mantissa()) << usize::from(limit.exponent())
}

#[test]
fn levels_are_never_too_low() {
    // An interval of X · 2^13 is the shortest of its cell; a rest interval is M · 2^(E-7). The squares, both times 2^14:
    const LEADING: u8 = 20;
    let mut cells = 0;
    for (mantissa, upper) in (128..=255u8).flat_map(|m| (128..=255u64).map(move |x| (m, x))) {
        for exponent in 0..=45 {
            let limit = Limit::new(mantissa, exponent, 0).unwrap();
            let shortest = upper << (LEADING - 7);
            let level = limit.level(shortest);
            assert_eq!(limit.level(shortest | ((1 << (LEADING - 7)) - 1)), level, "a cell has one level");
            let (up, down) = (level.max(0).unsigned_abs(), level.min(0).unsigned_abs());
            let square = u128::from(shortest * shortest) << 14 << up;
            let rest = (u128::from(mantissa) * u128::from(mantissa)) << (2 * exponent) << down;
            assert!(square >= rest, "M {mantissa}, E {exponent}, X {upper}: level {level} is too low");
            assert!(square >> 2 < rest, "M {mantissa}, E {exponent}, X {upper}: level {level} is too high");
            cells += 1;
        }
    }
    assert_eq!(cells, 128 * 128 * 46);
}

#[test]
fn intervals_of_few_bits_have_levels_too() {
    for interval in 1..256u64 {
        for exponent in 0..20 {
            let limit = Limit::new(200, exponent, 0).unwrap();
            let rest = rest_interval_times_128(limit);
            let level = limit.level(interval);
            let square = (UBig::from(interval) * UBig::from(interval)) << 14;
            let (up, down) = (level.max(0) as usize, level.min(0).unsigned_abs() as usize);
            assert!(square << up >= (&rest * &rest) << down, "I {interval}, E {exponent}");
        }
    }
}

#[test]
fn what_is_no_limit_is_none() {
    assert_eq!(Limit::new(127, 20, 0), None);
    assert_eq!(Limit::new(128, LARGEST_EXPONENT + 1, 0), None);
    let limit = Limit::new(255, LARGEST_EXPONENT, 0).unwrap();
    assert_eq!(limit.next(0, &RegisterLimits::with_fraction_bits(32)), BrakingPart::Rest);
    assert_eq!(limit.next(-5, &RegisterLimits::with_fraction_bits(32)), BrakingPart::Rest);
    assert_eq!(Limit::WITHIN_A_STEP.next(1, &RegisterLimits::with_fraction_bits(16)), BrakingPart::LastStep);
    assert_eq!(
        Limit::WITHIN_A_STEP.next((1 << 39) - 1, &RegisterLimits::with_fraction_bits(16)),
        BrakingPart::LastStep
    );
}

/// A limit, and an interval that is shorter than the rest interval by up to a factor of 2^13, but within the rule's range.
fn stops() -> impl Strategy<Value = (u32, Limit, i64)> {
    let limits = prop_oneof![Just(8u32), Just(16), Just(24), Just(32)]
        .prop_flat_map(|f| (Just(f), 128..=255u8, (f + 6).min(59) as u8..=(f + 28).min(59) as u8, 0..=12u8));
    (limits, 0..=13u8, any::<u64>()).prop_filter_map("the rule holds", |((f, m, e, l), shorter, bits)| {
        let limit = Limit::new(m, e, l)?;
        let leading = e.checked_sub(shorter)?;
        let interval = i64::try_from(1u64 << leading | bits & ((1 << leading) - 1)).ok()?;
        let level = limit.level(interval.cast_unsigned()).max(0).cast_unsigned();
        (interval >> (level + 1) >= 1 && level <= 20).then_some((f, limit, interval))
    })
}

proptest! {
    #[test]
    fn between_any_two_steps_the_deceleration_is_within_the_limit((f, limit, interval) in stops()) {
        let registers = RegisterLimits::with_fraction_bits(f);
        let (intervals, _) = stop(limit, &registers, interval);
        let rest = rest_interval_times_128(limit);
        let square = &rest * &rest;
        for pair in intervals.windows(2) {
            prop_assert!(pair[0] < pair[1] && pair[1] < registers.longest() / 4 * 5, "{pair:?}");
            // 2(B - A)/(A·B·(A + B)) ≤ 1/(2R²), R² being `square` / 2^14.
            let [a, b] = [UBig::from(pair[0].cast_unsigned()), UBig::from(pair[1].cast_unsigned())];
            let change = ((&b - &a) * &square) << 2;
            prop_assert!(change <= (&a * &b * (&a + &b)) << 14, "{pair:?}");
        }
        // It rests at the rest interval or beyond, or where a step would take too long.
        if let Some(&last) = intervals.last() {
            let next = limit.next(last, &registers);
            prop_assert!(next == BrakingPart::LastStep || last >= registers.longest() / 5 * 3, "{last}");
        }
    }

    #[test]
    fn it_ends_whatever_the_limit_and_the_interval(
        f in 8u32..=32, m in 128..=255u8, e in 0..=LARGEST_EXPONENT, l: u8, interval: i64,
    ) {
        let registers = RegisterLimits::with_fraction_bits(f);
        let limit = Limit::new(m, e, l).unwrap();
        let mut interval = interval;
        // An add of 1 makes many segments, but the interval always grows, and stays within 63 bits.
        for _ in 0..1000 {
            let Some(segment) = limit.next(interval, &registers).segment(interval) else { break };
            prop_assert!(segment.count >= 1 && segment.add >= 0 && segment.add <= registers.most_add());
            if limit.next(interval, &registers) == BrakingPart::LastStep {
                break;
            }
            let after = i128::from(interval) + i128::from(segment.count) * i128::from(segment.add);
            prop_assert!(after > i128::from(interval));
            prop_assert_eq!(i128::from(segment.after(segment.count).interval), after);
            interval = segment.after(segment.count).interval;
        }
    }
}

/// Compares the number of steps of a stop with that of an ideal one, v²/2a, which is (R/I)².
#[test]
fn a_stop_takes_less_than_twice_the_steps_of_an_ideal_one() {
    let registers = RegisterLimits::with_fraction_bits(32);
    let (mut least, mut most, mut sum, mut stops, mut parts_most) = (f64::INFINITY, 0.0f64, 0.0, 0u32, 0);
    for (mantissa, shorter, upper) in (128..=255u8)
        .step_by(5)
        .flat_map(|m| (1..=7u32).flat_map(move |d| (0..256i64).step_by(7).map(move |x| (m, d, x))))
    {
        let limit = Limit::new(mantissa, 50, 0).unwrap();
        let rest = f64::from(mantissa) * 2f64.powi(50 - 7);
        let interval = (256 + upper) << (50 - shorter - 8);
        let ideal = (rest / interval as f64).powi(2);
        if ideal < 4.0 {
            continue;
        }
        let (intervals, parts) = stop(limit, &registers, interval);
        let ratio = intervals.len() as f64 / ideal;
        (least, most, sum, stops) = (least.min(ratio), most.max(ratio), sum + ratio, stops + 1);
        parts_most = parts_most.max(parts);
    }
    let mean = sum / f64::from(stops);
    println!("{stops} stops: {least:.2} to {most:.2} times v²/2a steps, mean {mean:.2}; {parts_most} parts at most");
    assert!(least >= 1.385 && most <= 2.005, "{least:.3} to {most:.3} times v²/2a steps");
}
