//! A table of any content behind a sound motion file.
#![no_main]

use libfuzzer_sys::fuzz_target;
use pulsetrain_motion::file;

const MOTION: &str = include_str!("../../examples/table.toml");

/// What the header is not asked for there.
const TOLD: &str = r#"columns = ["time", "angle"], time = "s", "#;

fuzz_target!(|table: &str| {
    assert!(MOTION.contains(TOLD));
    for motion in [MOTION, &MOTION.replace(TOLD, "")] {
        if let Ok(program) = file::read(motion, "table.toml", &|_| Ok(table.to_owned())) {
            for piece in program.motors[0].law.pieces().take(64).map_while(Result::ok) {
                assert!(piece.start < piece.end, "{piece:?}");
            }
        }
    }
});
