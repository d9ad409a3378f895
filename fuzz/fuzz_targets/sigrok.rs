#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| pulsetrain_fuzz::check("sigrok", input));
