//! A formula of any content: a law or an error with a place in the text; and its windows follow one another.
#![no_main]

use libfuzzer_sys::fuzz_target;
use pulsetrain_motion::{Law, Time};

fuzz_target!(|text: &str| {
    match Law::formula(text, &[("a".to_owned(), 2.5)], 200.0, Some(Time::SECOND)) {
        Ok(law) => {
            let mut end = Time::ZERO;
            for piece in law.pieces().take(64).map_while(Result::ok) {
                assert!(piece.start == end && piece.start < piece.end, "{piece:?}");
                end = piece.end;
            }
        }
        Err(error) => assert!(error.offset + error.length <= text.len(), "{error:?}"),
    }
});
