//! Seeds and lengths of random tests: equal in every run, unless an environment variable has another number.

/// The number in `PULSETRAIN_SEED`, or else the test's own seed. It is printed, so that a failure can be repeated.
pub fn seed(own: u64) -> u64 {
    let seed = number("PULSETRAIN_SEED").unwrap_or(own);
    println!("PULSETRAIN_SEED={seed}");
    seed
}

/// How many times as long as usual a random test runs: the number in `PULSETRAIN_ROUNDS`, or else 1.
pub fn rounds() -> u64 {
    number("PULSETRAIN_ROUNDS").unwrap_or(1)
}

/// The seeds of a random test: so many from [`seed`] on, and [`rounds`] times as many in a longer run.
pub fn seeds(own: u64, count: u64) -> impl Iterator<Item = u64> {
    let first = seed(own);
    (0..count * rounds()).map(move |more| first.wrapping_add(more))
}

fn number(name: &str) -> Option<u64> {
    let text = std::env::var(name).ok()?;
    Some(text.parse().unwrap_or_else(|_| panic!("{name} is a number of 64 bits, not {text:?}")))
}
