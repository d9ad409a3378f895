//! PulseView's CSV of any content.
#![no_main]

use libfuzzer_sys::fuzz_target;
use pulsetrain_trace::sigrok;

fuzz_target!(|bytes: &[u8]| {
    // An error is a valid result; only a panic is a failure.
    let _ = sigrok::read(bytes);
});
