//! Bytes of any content to the Uno's reader of lines, in assembly on the emulated chip, and to core's: both must read
//! the same commands.
//!
//! The fuzzer is guided by the coverage of core and the emulator.
#![no_main]

#[allow(dead_code, unused_imports, reason = "the rest is for the tests")]
#[path = "../../crates/board/tests/it/chips/winch_avr.rs"]
mod winch_avr;

use libfuzzer_sys::fuzz_target;
use winch_avr::Readers;

fuzz_target!(|input: (bool, &[u8])| {
    let (strict, bytes) = input;
    let mut readers = Readers::new(strict);
    // Zeros belong to binary frames; a line of text has none.
    let bytes: Vec<u8> = bytes.iter().copied().filter(|byte| *byte != 0).take(600).collect();
    for line in bytes.split_inclusive(|byte| *byte == b'\n') {
        readers.push(line);
    }
});
