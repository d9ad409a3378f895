//! Seeds and lengths of random tests: the same in every run, unless the environment says otherwise.

/// `PULSETRAIN_SEED`, or the test's own; printed, so that what failed can be had again.
pub fn seed(own: u64) -> u64 {
    let seed = number("PULSETRAIN_SEED").unwrap_or(own);
    println!("PULSETRAIN_SEED={seed}");
    seed
}

/// How many times as long as usual: `PULSETRAIN_ROUNDS`, or once.
pub fn rounds() -> u64 {
    number("PULSETRAIN_ROUNDS").unwrap_or(1)
}

fn number(name: &str) -> Option<u64> {
    let text = std::env::var(name).ok()?;
    Some(text.parse().unwrap_or_else(|_| panic!("{name} is a number of 64 bits, not {text:?}")))
}
