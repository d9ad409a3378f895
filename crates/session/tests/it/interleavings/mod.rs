//! Interleavings.

mod board;
mod host;
mod plan;
mod printed;
mod properties;
mod system;

use board::Mutation;
use plan::Plan;
use stateright::{Checker, HasDiscoveries, Model};
use system::{Budget, System};

fn system(motors: usize, most: Budget) -> System {
    System { plan: Plan::new(motors, 1), queue: 24, quantum: 160, quanta: 6, most, mutation: Mutation::None }
}

fn check(system: System) {
    let checker = system.checker().threads(2).spawn_bfs().join();
    println!(
        "{} transitions, {} states, at most {} steps",
        checker.state_count(),
        checker.unique_state_count(),
        checker.max_depth()
    );
    for (name, path) in checker.discoveries() {
        println!("{name}: {}", path.into_actions().len());
    }
    checker.assert_properties();
}

#[test]
fn a_line_loses_a_frame() {
    check(system(1, Budget { lost: 1, repeats: 1, statuses: 1, ..Budget::default() }));
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

#[test]
fn two_motors_are_trimmed() {
    check(system(2, Budget { trims: 1, ..Budget::default() }));
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
    let path = checker.discovery(name).map(stateright::Path::into_actions);
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
