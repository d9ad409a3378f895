//! A logic analyser's CSV of any content.
#![no_main]

use libfuzzer_sys::fuzz_target;
use pulsetrain_trace::saleae;

fuzz_target!(|bytes: &[u8]| {
    // An error is a valid result; only a panic is a failure.
    let _ = saleae::read(bytes);
});
