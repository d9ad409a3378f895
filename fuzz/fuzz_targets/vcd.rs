//! A value change dump of any content.
#![no_main]

use libfuzzer_sys::fuzz_target;
use pulsetrain_trace::vcd_file;

fuzz_target!(|bytes: &[u8]| {
    // An error is as good an answer as a trace.
    let _ = vcd_file::read(bytes);
});
