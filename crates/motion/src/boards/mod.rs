//! The boards that plans can be made for: a folder for each, with all that motion files and plans need to know of it.
//!
//! docs/adding-a-board.md says what a new one needs. The source of a board's figures says `estimate` until a bench on the emulated firmware has
//! measured them.

pub mod due;
pub mod native;
pub mod pico;
pub mod pins;
pub mod profile;
pub mod uno;

pub use due::DUE;
pub use native::NATIVE;
pub use pico::PICO;
pub use pins::{AnyPins, PinError, PinRules, PinsError};
pub use profile::{BoardLimits, BoardProfile, EdgeDelay, LineTiming, SegmentTicks, SharedSteps};
pub use uno::UNO;

/// This project's boards, the most common one first.
pub const BUILT_IN: &[&BoardProfile] = &[&UNO, &DUE, &PICO, &NATIVE];

/// The board of that name among [this project's](BUILT_IN), whatever its case.
#[must_use]
pub fn find(name: &str) -> Option<&'static BoardProfile> {
    find_in(BUILT_IN, name)
}

/// The board of that name in a list, whatever its case.
#[must_use]
pub fn find_in(boards: &[&'static BoardProfile], name: &str) -> Option<&'static BoardProfile> {
    boards.iter().copied().find(|board| board.name.eq_ignore_ascii_case(name))
}

/// The new name of a board that has been renamed.
#[must_use]
pub fn renamed(name: &str) -> Option<&'static str> {
    let was = |former: &&str| former.eq_ignore_ascii_case(name);
    BUILT_IN.iter().find(|board| board.former_names.iter().any(was)).map(|board| board.name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shortest_intervals_are_those_of_the_rates() {
        assert_eq!(find("due").unwrap().min_interval_ticks, [33, 86, 129, 172, 215, 258, 300, 345]);
        // Issue 5's 625 k steps/s on each of eight motors.
        assert!(find("pico").unwrap().min_interval_ticks[7] <= 200);
        // The tutorial at T = 0.1 s: A·ω = 2000·2π/0.1 = 125 664 steps/s passes on pin 9; at 0.01 s it does not.
        let peak_hz = |period: f64| 2000.0 * std::f64::consts::TAU / period;
        let limit_hz = |ticks: u32| 16e6 / f64::from(ticks);
        let by_compare = limit_hz(102);
        assert!(peak_hz(0.1) < by_compare && by_compare < peak_hz(0.01), "{by_compare}");
    }

    #[test]
    fn what_no_bench_has_printed_is_an_estimate() {
        for board in BUILT_IN {
            let is_measured = matches!(board.name, "native" | "uno" | "pico");
            assert_eq!(board.source.starts_with("estimate"), !is_measured, "{}", board.name);
            assert!(board.min_interval_ticks.is_sorted(), "{}", board.name);
        }
    }

    #[test]
    fn pins_by_number_and_by_name() {
        let uno = find("uno").unwrap();
        assert_eq!(uno.pin(8), Ok(8));
        assert_eq!(uno.pin_named("A5"), Ok(19));
        assert_eq!(uno.pin_named("d13"), Ok(13));
        assert!(matches!(uno.pin(1), Err(PinError::Reserved { pin: 1, .. })));
        assert!(matches!(uno.pin(20), Err(PinError::None { last: 19, .. })));
        assert!(matches!(uno.pin_named("A6"), Err(PinError::None { .. })));
        assert!(matches!(uno.pin(-1), Err(PinError::None { .. })));
        assert!(matches!(uno.pin(1 << 40), Err(PinError::None { .. })));
        assert_eq!(find("due").unwrap().pin_named("D26"), Ok(26));
        assert_eq!(find("pico").unwrap().pin_named("GP15"), Ok(15));
        assert!(find("pico").unwrap().pin(24).is_err());
    }
}
