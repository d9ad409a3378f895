//! What all firmware shares, without a board: the enable line, and the events that wait.

use pulsetrain_core::firmware::{EnableLine, EventQueue};
use pulsetrain_core::wire::Millis;
use pulsetrain_core::wire::message::{ALL_MOTORS, Cause, Configuration, Event};

/// Drivers are enabled by motion, and stay so for the time of the configuration; a pause shorter than that releases nothing.
#[test]
fn drivers_are_released_after_their_rest_and_not_before() {
    for high in [false, true] {
        let mut configuration = Configuration::new(&[]).expect("no motors");
        (configuration.enable_high, configuration.idle_ms) = (high, Some(100));
        let mut line = EnableLine::of(&configuration);
        assert_eq!(line.level(), !high, "released at first");
        assert!(!line.update(Millis(0), true) && line.level() != high);
        line.set(true);
        assert_eq!(line.level(), high);
        // At rest since the first look after it was enabled, here just before the count wraps.
        assert!(!line.update(Millis(0xfff0), true));
        assert!(!line.update(Millis(0xfff0_u16.wrapping_add(99)), true));
        // Motion, and a rest that is cut short.
        assert!(!line.update(Millis(200), false));
        assert!(!line.update(Millis(299), true));
        assert!(!line.update(Millis(299), false));
        assert!(!line.update(Millis(398), true) && line.level() == high);
        assert!(line.update(Millis(399), true) && line.level() != high);
        assert!(!line.update(Millis(400), true), "the level changes once");
        assert!(line.update(Millis(401), false) && line.level() == high);
    }
}

#[test]
fn drivers_without_a_time_stay_enabled() {
    let mut line = EnableLine::of(&Configuration::new(&[]).expect("no motors"));
    line.set(true);
    assert!((0..1000).all(|ms| !line.update(Millis(ms * 60), true)));
}

#[test]
fn events_come_in_order_and_what_does_not_fit_is_dropped() {
    let event = |tick| Event { cause: Cause::Finished, motor: ALL_MOTORS, tick, detail: 0 };
    let mut events = EventQueue::<2>::EMPTY;
    assert!(events.is_empty() && events.pop().is_none());
    (1..=3).for_each(|tick| events.push(event(tick)));
    assert_eq!(events.pop(), Some(event(1)));
    events.push(event(4));
    assert!(!events.is_empty());
    assert_eq!([(); 3].map(|()| events.pop()), [Some(event(2)), Some(event(4)), None]);
}
