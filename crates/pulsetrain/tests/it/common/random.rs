//! Random tests with cases that take long.

use proptest::prelude::*;
use proptest::test_runner::TestRunner;

/// Runs `test` on some random values. PROPTEST_CASES, which the macro would read, is for quick tests.
pub(crate) fn each<S: Strategy>(cases: u32, values: S, test: impl Fn(S::Value) -> Result<(), TestCaseError>) {
    let config = ProptestConfig { cases, ..ProptestConfig::default() };
    if let Err(error) = TestRunner::new(config).run(&values, test) {
        panic!("{error}");
    }
}
