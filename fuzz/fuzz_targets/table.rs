//! A table of any content behind a sound motion file.
#![no_main]

use libfuzzer_sys::fuzz_target;
use pulsetrain_motion::file;

const MOTION: &str = include_str!("../../examples/table.toml");

fuzz_target!(|table: &str| {
    if let Ok(program) = file::read(MOTION, "table.toml", &|_| Ok(table.to_owned())) {
        for piece in program.motors[0].law.pieces().take(64).map_while(Result::ok) {
            assert!(piece.start < piece.end, "{piece:?}");
        }
    }
});
