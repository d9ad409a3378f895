//! What a contributor runs before sending a change.

use crate::command::{self, Done, cargo};
use crate::{boards, ruckig};

/// All tests of the workspace, core built for the boards' processors, S-curves against ruckig.
pub(crate) fn run() -> Done {
    command::run(&mut cargo("test --workspace --no-fail-fast"))?;
    boards::build_core()?;
    let worst = ruckig::compare()?;
    println!("s-curve durations of {} moves: at most {worst:.1e} (relative) from ruckig's", ruckig::MOVES);
    println!("xtask test: all passed");
    Ok(())
}
