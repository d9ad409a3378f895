//! Random tests of which each case takes long.

use proptest::prelude::*;
use proptest::test_runner::TestRunner;

/// Has `test` pass on so many random values; PROPTEST_CASES, which the macro would take instead, is for quick tests.
pub(crate) fn each<S: Strategy>(cases: u32, values: S, test: impl Fn(S::Value) -> Result<(), TestCaseError>) {
    let config = ProptestConfig { cases, ..ProptestConfig::default() };
    if let Err(error) = TestRunner::new(config).run(&values, test) {
        panic!("{error}");
    }
}
