//! The example of embedding does what it says, on the virtual Uno.

#[path = "../../../examples/embed.rs"]
#[allow(dead_code, reason = "the example's main, and its errors for real ports")]
mod example;

use pulsetrain::live::RunEvent;
use pulsetrain_board::virtual_uno::VirtualUno;

#[test]
fn the_example_swings_faster_when_its_knob_is_turned_and_stops() {
    let outcome = example::swing(VirtualUno::new()).unwrap();
    assert!(outcome.rehearsal_passed);
    let [RunEvent::Set { value, unit, ceiling, from_s, .. }, RunEvent::Stopping { at_s }, RunEvent::Ended(ended)] =
        &outcome.events[..]
    else {
        panic!("{:?}", outcome.events);
    };
    assert_eq!((*value, unit.as_str(), ceiling), (2.0, "Hz", &None));
    assert!((1.0..1.1).contains(from_s) && (3.0..3.1).contains(at_s), "{from_s} s, {at_s} s");
    // The board counted what it made, and every edge of its pins was seen: half a swing of 400 steps at 0.5 Hz, and then four there and back at 2 Hz. It
    // brakes on beyond the swing for some steps at most.
    assert_eq!(ended.counted, [outcome.counted]);
    assert!((6400..8000).contains(&outcome.edges) && outcome.edges.is_multiple_of(2), "{} edges", outcome.edges);
    assert!((-30..=430).contains(&outcome.counted), "{outcome:?}");
}
