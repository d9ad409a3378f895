//! What users write and hand in: a value or an error with a place, never a panic.

use crate::decoded;
use pulsetrain_motion::{Law, Time, file};
use pulsetrain_trace::vcd_file;
use pulsetrain_trace::{camera as camera_file, saleae as saleae_file, sigrok as sigrok_file, steps as steps_file};
use std::io::ErrorKind::NotFound;

/// How many pieces of a law are looked at.
const PIECES: usize = 64;

/// A motion file of any content; the laws of what is read can be walked.
pub(crate) fn motion_file(input: &[u8]) {
    let Some(text) = decoded::<&str>(input) else { return };
    if let Ok(program) = file::read(text, "fuzz.toml", &|_| Err(NotFound.into())) {
        for motor in &program.motors {
            for piece in motor.law.pieces().take(PIECES).map_while(Result::ok) {
                assert!(piece.start < piece.end, "{piece:?}");
            }
        }
    }
}

/// A formula of any content; the pieces of its law follow one another, and an error's place is in the text.
pub(crate) fn formula(input: &[u8]) {
    let Some(text) = decoded::<&str>(input) else { return };
    match Law::formula(text, &[("a".to_owned(), 2.5)], 200.0, Some(Time::SECOND)) {
        Ok(law) => {
            let mut end = Time::ZERO;
            for piece in law.pieces().take(PIECES).map_while(Result::ok) {
                assert!(piece.start == end && piece.start < piece.end, "{piece:?}");
                end = piece.end;
            }
        }
        Err(error) => assert!(error.offset + error.length <= text.len(), "{error:?}"),
    }
}

/// A sound motion file with a table.
const MOTION: &str = include_str!("../../../examples/table.toml");
/// The keys of it that say what the columns are; without them the header says it.
const COLUMNS: &str = r#"columns = ["time", "angle"], time = "s", "#;

/// A table of any content behind a sound motion file.
pub(crate) fn table(input: &[u8]) {
    let Some(table) = decoded::<&str>(input) else { return };
    assert!(MOTION.contains(COLUMNS));
    for motion in [MOTION, &MOTION.replace(COLUMNS, "")] {
        if let Ok(program) = file::read(motion, "table.toml", &|_| Ok(table.to_owned())) {
            for piece in program.motors[0].law.pieces().take(PIECES).map_while(Result::ok) {
                assert!(piece.start < piece.end, "{piece:?}");
            }
        }
    }
}

// An error is a valid result of the readers below; only a panic is a failure.

/// A value change dump of any content.
pub(crate) fn vcd(input: &[u8]) {
    let _ = vcd_file::read(input);
}

/// A Saleae export of any content.
pub(crate) fn saleae(input: &[u8]) {
    let _ = saleae_file::read(input);
}

/// A sigrok export of any content.
pub(crate) fn sigrok(input: &[u8]) {
    let _ = sigrok_file::read(input);
}

/// A steps.csv of any content.
pub(crate) fn steps(input: &[u8]) {
    let _ = steps_file::read(input);
}

/// A camera's track of any content.
pub(crate) fn camera(input: &[u8]) {
    let _ = camera_file::read(input);
}
