//! What is planned for boards with 16 fraction bits fits the narrow registers of an Uno.

use proptest::prelude::*;
use pulsetrain_core::packing::{MAX_PACKED_LEN, Packing, State};
use pulsetrain_core::{Item, Segment};
use pulsetrain_motion::{Law, Time};
use pulsetrain_plan::{Move, Planner, Settings};

const LONGEST_TICKS: i64 = 1 << 24;

/// Interval, add and add2 at every step of a segment.
fn check_segment(segment: &Segment) -> Result<(), TestCaseError> {
    prop_assert!((1..=65_535).contains(&segment.count));
    for done in 0..segment.count {
        let Segment { interval, add, add2, .. } = segment.after(done);
        prop_assert!((1..LONGEST_TICKS << 16).contains(&interval), "{segment:?} after {done} steps");
        if segment.count > 1 {
            prop_assert!(i32::try_from(add).is_ok() && i32::try_from(add2).is_ok(), "{segment:?} after {done} steps");
        }
    }
    Ok(())
}

/// And what the stream predicts from, as the board has it after every step.
fn check(moves: &[Move], settings: &Settings) -> Result<(), TestCaseError> {
    let packing = Packing { fraction_bits: 16, gain: settings.gain().unwrap() };
    let (mut here, mut there) = (State::default(), State::default());
    for next in moves {
        let Move::Run { segment, direction } = *next else { continue };
        check_segment(&segment)?;
        let mut bytes = [0; MAX_PACKED_LEN];
        let item = Item::Run { segment, direction };
        let len = packing.pack(&mut here, &item, &mut bytes).unwrap();
        let mut rest = &bytes[..len];
        let Some(Item::Run { segment: unpacked, .. }) = packing.unpack(&mut there, &mut rest).unwrap() else {
            return Err(TestCaseError::fail("no run"));
        };
        prop_assert_eq!(here, there);
        prop_assert_eq!((unpacked.count, unpacked.interval), (segment.count, segment.interval));
        for done in 0..unpacked.count {
            let Segment { add, add2, .. } = unpacked.after(done);
            prop_assert!(i32::try_from(add).is_ok() && i32::try_from(add2).is_ok(), "{unpacked:?} after {done} steps");
        }
    }
    Ok(())
}

fn plan(law: &Law, settings: &Settings) -> Vec<Move> {
    let mut planner = Planner::new(law, settings).unwrap();
    std::iter::from_fn(|| planner.next_move().unwrap()).collect()
}

/// The tutorial, at every period it names and slower than all of them.
#[test]
fn the_tutorial_fits() {
    for period_s in [0.1, 1.0, 10.0, 500.0, 86_400.0] {
        for tolerance_ticks in [1.0, 16.0] {
            let law = Law::sine(2000.0, Time::from_seconds(period_s), Some(1)).unwrap();
            let settings = Settings { tolerance_ticks, ..Settings::new(16_000_000, 16) };
            check(&plan(&law, &settings), &settings).unwrap();
        }
    }
}

proptest! {
    #[test]
    fn slow_laws_fit(
        amplitude in 0.6..300.0f64, log_period in -1.0..4.5f64, coarse: bool, part in 0.0..1.0f64, trapezoid: bool,
    ) {
        let period_s = 10f64.powf(log_period);
        let law = if trapezoid {
            let speed = 4.0 * amplitude / period_s;
            Law::trapezoid(amplitude, speed, speed / (0.1 + part), 3.0 * speed).unwrap()
        } else {
            Law::sine(amplitude, Time::from_seconds(period_s), Some(1)).unwrap()
        };
        let mut settings = Settings::new(16_000_000, 16);
        settings.tolerance_ticks = if coarse { 16.0 } else { 1.0 };
        check(&plan(&law, &settings), &settings)?;
    }
}
