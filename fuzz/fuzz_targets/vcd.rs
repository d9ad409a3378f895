//! A value change dump of any content.
#![no_main]

use libfuzzer_sys::fuzz_target;
use pulsetrain_trace::vcd_file;

fuzz_target!(|bytes: &[u8]| {
    // An error is a valid result; only a panic is a failure.
    let _ = vcd_file::read(bytes);
});
