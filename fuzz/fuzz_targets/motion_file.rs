//! A motion file of any content: a program or an error with a place, never a panic; and a program's laws can be walked.
#![no_main]

use libfuzzer_sys::fuzz_target;
use pulsetrain_motion::file;
use std::io::ErrorKind::NotFound;

fuzz_target!(|text: &str| {
    if let Ok(program) = file::read(text, "fuzz.toml", &|_| Err(NotFound.into())) {
        for motor in &program.motors {
            for piece in motor.law.pieces().take(64).map_while(Result::ok) {
                assert!(piece.start < piece.end, "{piece:?}");
            }
        }
    }
});
