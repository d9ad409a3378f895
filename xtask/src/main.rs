//! Set-up, tests, benches: the one place that knows the toolchain.
fn main() {}
