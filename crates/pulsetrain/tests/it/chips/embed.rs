//! The example of embedding does what it says, on the virtual Uno.

#[path = "../../../examples/embed.rs"]
#[allow(dead_code, reason = "the example's main, and its errors for real ports")]
mod example;

use pulsetrain_board::virtual_uno::VirtualUno;

#[test]
fn the_example_swings_and_stops() {
    let outcome = example::swing(VirtualUno::new()).unwrap();
    // θ(1.3 s) = 200·(1 − cos(1.3 π)) steps. The stop then goes on downwards for some steps at most.
    assert_eq!(outcome.when_told, 318);
    assert!((280..318).contains(&outcome.at_rest), "{outcome:?}");
    // Up to the top, 400 steps, and down again.
    assert_eq!(outcome.pulses, 400 + (400 - outcome.at_rest) as u64);
}
