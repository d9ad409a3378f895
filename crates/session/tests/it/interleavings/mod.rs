//! Interleavings.

mod board;
mod host;
mod plan;
mod system;

use board::Mutation;
use plan::Plan;
use stateright::{Checker, Model};
use system::{Budget, System};

fn one_motor() -> System {
    System {
        plan: Plan::new(1, 2),
        queue: 24,
        quantum: 160,
        quanta: 8,
        most: Budget { lost: 1, repeats: 1, statuses: 1, ..Budget::default() },
        mutation: Mutation::None,
    }
}

#[test]
fn one_motor_and_a_line_that_loses() {
    let checker = one_motor().checker().threads(2).spawn_bfs().join();
    println!(
        "{} states, {} unique, depth {}",
        checker.state_count(),
        checker.unique_state_count(),
        checker.max_depth()
    );
    for (name, path) in checker.discoveries() {
        println!("{name}: {:?}", path.into_actions().len());
    }
    checker.assert_properties();
}
