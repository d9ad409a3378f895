//! Interleavings.

mod board;
mod host;
mod plan;
mod printed;
mod properties;
mod system;

use board::Mutation;
use plan::Plan;
use stateright::{Checker, Model};
use system::{Budget, System};

fn system(motors: usize, most: Budget) -> System {
    System { plan: Plan::new(motors, 1), queue: 24, quantum: 160, quanta: 7, most, mutation: Mutation::None }
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
fn a_queue_is_full() {
    check(System { queue: 14, ..system(1, Budget { guesses: 1, repeats: 2, ..Budget::default() }) });
}
