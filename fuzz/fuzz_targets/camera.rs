//! A camera's track of any content.
#![no_main]

use libfuzzer_sys::fuzz_target;
use pulsetrain_trace::camera;

fuzz_target!(|bytes: &[u8]| {
    // An error is a valid result; only a panic is a failure.
    let _ = camera::read(bytes);
});
