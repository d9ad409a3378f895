//! All interleavings of a small host, a line and a board: what a session by lease promises holds in each of them.
//!
//! The model checker stateright goes through every order in which the host tells more, puts the lease off, takes items back,
//! orders a stop or asks how the board is; frames arrive, vanish or are damaged, also late; the link repeats itself; and time goes on at the board.
//! A host that stands still for ever, or a cable that is cut, is an order in which nothing of that comes any more.
//!
//! # What is here
//! - `plan`: what the motors are to do, and which steps that is
//! - `board`: the board's end, and the contract once more as a ledger of what was accepted
//! - `host`: the host's end
//! - `system`: both and the line, as a state machine; `properties`: what must hold
//! - `printed`: a state as text; two states are equal if their texts have the same hash
//!
//! # What is real
//! - The board: `Service`, and the test kit's model behind it, whose stepgen is `Native`: core's channel, axis, output, merge, lease and braking.
//!   A step is a pulse on its STEP line.
//! - The line's rules: `Service` there, `Link` here, every frame in its bytes.
//! - What the host replays: `Replay`.
//!
//! # What is a model
//! - The line: frames in order, each of which arrives whole or not at all.
//! - Time: the board's goes on by 160 ticks at once, the link's only when it is to repeat itself. So nobody is given up for lost.
//! - What `Remote` and `Session` do above `Link`: they wait for answers, which a step of a checker cannot. `host` says the same between two
//!   answers. Switches to another plan while motors move, and pauses, are not in it.
//! - The ledger, which says what the contract has a board accept, from frames and horizons alone.

mod board;
mod host;
mod plan;
mod printed;
mod properties;
mod system;

use board::Mutation;
use plan::Plan;
use stateright::{Checker, HasDiscoveries, Model, Path};
use system::{Budget, System};

/// Nothing is wrong. Two items and an end for each motor, and room for two items in its queue.
fn system(motors: usize, most: Budget) -> System {
    System {
        plan: Plan::new(motors, 1),
        queue: 24,
        quantum: 160,
        quanta: 6,
        on_their_way: 1,
        most,
        mutation: Mutation::None,
    }
}

fn check(system: System) {
    let checker = system.checker().threads(2).spawn_bfs().join();
    let (steps, states) = (checker.state_count(), checker.unique_state_count());
    println!("{states} states, {steps} steps from one to another, {} deep", checker.max_depth());
    checker.assert_properties();
}

#[test]
fn a_line_loses_a_frame() {
    check(system(1, Budget { lost: 1, repeats: 1, statuses: 1, ..Budget::default() }));
}

/// A second extension is sent before the answer to the first comes.
#[test]
fn extensions_overtake_answers() {
    check(System { on_their_way: 2, ..system(1, Budget { damaged: 1, statuses: 1, ..Budget::default() }) });
    check(System { on_their_way: 2, ..system(1, Budget { lost: 1, repeats: 1, ..Budget::default() }) });
}

#[test]
fn a_line_damages_a_frame() {
    check(system(1, Budget { damaged: 1, statuses: 1, ..Budget::default() }));
}

#[test]
fn the_host_takes_items_back() {
    check(system(1, Budget { lost: 1, repeats: 1, trims: 1, ..Budget::default() }));
}

#[test]
fn the_host_orders_a_stop() {
    check(system(1, Budget { lost: 1, repeats: 1, brakes: 1, ..Budget::default() }));
}

#[test]
fn two_motors() {
    check(system(2, Budget { statuses: 1, ..Budget::default() }));
}

#[test]
fn two_motors_are_stopped() {
    check(system(2, Budget { brakes: 1, ..Budget::default() }));
}

mod long {
    use super::*;

    #[test]
    fn two_motors_are_trimmed() {
        check(system(2, Budget { trims: 1, ..Budget::default() }));
    }
}

#[test]
fn a_queue_is_full() {
    check(System { queue: 14, ..system(1, Budget { guesses: 1, repeats: 2, ..Budget::default() }) });
}

/// The checker finds what is wrong with a host or a board that is wrong on purpose.
fn finds(name: &'static str, mutation: Mutation, most: Budget) {
    let system = System { mutation, ..system(1, most) };
    let first = HasDiscoveries::AnyOf([name].into());
    let checker = system.checker().finish_when(first).spawn_bfs().join();
    let path = checker.discovery(name).map(Path::into_actions);
    println!("{mutation:?}: {} states, {path:?}", checker.unique_state_count());
    assert!(path.is_some(), "{mutation:?} went unnoticed");
}

#[test]
fn mutations() {
    let loses = Budget { lost: 1, repeats: 1, ..Budget::default() };
    finds("what was accepted holds, and nothing else", Mutation::BoardForgetsLease, loses);
    finds("each step before the lease's end is made at its tick, once", Mutation::BoardDropsData, Budget::default());
    finds("a host never believes a wrong count", Mutation::HostBelievesExtension, loses);
    finds("what the host holds for sure was accepted", Mutation::HostBelievesExtension, Budget::default());
    finds(
        "the lease ends no later than what the board was told",
        Mutation::HostTrimsBelowLease,
        Budget { trims: 1, ..loses },
    );
    finds("nothing is at fault", Mutation::HostTrimsBelowLease, Budget { trims: 1, ..loses });
    finds("a host never believes a wrong count", Mutation::HostBelievesBrake, Budget { brakes: 1, ..loses });
    finds("the lease ends no later than what the board was told", Mutation::HostLeasesAhead, Budget::default());
    finds("a host never believes a wrong count", Mutation::HostLeasesAhead, Budget::default());
    finds("no motor stops dead", Mutation::HostTellsNoLimits, Budget::default());
    finds("after it each motor makes the stop that the host replays", Mutation::HostTellsNoLimits, Budget::default());
}
