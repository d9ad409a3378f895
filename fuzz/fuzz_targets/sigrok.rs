//! PulseView's CSV of any content.
#![no_main]

use libfuzzer_sys::fuzz_target;
use pulsetrain_trace::sigrok;

fuzz_target!(|bytes: &[u8]| {
    // An error is as good an answer as a trace.
    let _ = sigrok::read(bytes);
});
