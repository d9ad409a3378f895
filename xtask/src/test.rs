//! What a contributor runs before sending a change.

use crate::command::{self, Done, cargo};
use crate::{arduino, boards, python, ruckig};

/// All tests of the workspace, with Debian's Arduino core, and of the Python client, core built for the boards' processors, S-curves against ruckig.
///
/// `property_cases`: of each property test that does not set its own; else proptest's 256.
pub(crate) fn run(property_cases: Option<u32>) -> Done {
    let mut tests = cargo("test --workspace --no-fail-fast");
    tests.envs(property_cases.map(|cases| ("PROPTEST_CASES", cases.to_string())));
    tests.envs(arduino::prepare()?.map(|image| ("PULSETRAIN_OPTIBOOT", image)));
    command::run(&mut tests)?;
    python::test_client()?;
    boards::build_core()?;
    let worst = ruckig::compare()?;
    println!("s-curve durations of {} moves: at most {worst:.1e} (relative) from ruckig's", ruckig::MOVES);
    println!("xtask test: all passed");
    Ok(())
}
