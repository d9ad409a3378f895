//! Bytes of any content to the text reader and to four paths: nothing breaks, limits hold, and the next line is read.
#![no_main]

use libfuzzer_sys::fuzz_target;
use pulsetrain_core::winch::letters::InMemory;
use pulsetrain_core::winch::path::{FASTEST, Path};
use pulsetrain_core::winch::reply::{LONGEST, LineReply};
use pulsetrain_core::winch::spacing;
use pulsetrain_core::winch::text::{Heard, LineCommand, LineReader};

fuzz_target!(|input: (bool, Vec<u8>)| {
    let (strict, bytes) = input;
    let mut reader = LineReader::new();
    reader.set_strict(strict);
    let mut paths = [const { Path::new() }; 4];
    for byte in bytes.iter().take(2000) {
        match reader.push::<InMemory>(*byte) {
            Heard::Nothing => continue,
            Heard::Command(_) => reader.obey(&mut paths),
            Heard::Refused(refusal) => {
                let mut line = [0; LONGEST];
                let len = usize::from(LineReply::Refused(refusal).write::<InMemory>(&mut line));
                assert!(line[..len].ends_with(b"\r\n") && line[..len].is_ascii());
            }
        }
        for path in &mut paths {
            for _ in 0..20 {
                let made = path.made();
                let slice = path.tick();
                assert!(path.speed().unsigned_abs() <= u32::from(FASTEST) << 16);
                assert_eq!(path.made().wrapping_sub(made).unsigned_abs(), u32::from(slice.count));
                if let Some(train) = slice.train() {
                    let last = train.first + u32::from(train.count - 1) * train.interval;
                    assert!(last >> 16 <= u32::from(spacing::TICKS) + 1, "{slice:?} {train:?}");
                }
            }
        }
    }
    reader.push::<InMemory>(b'\n');
    // The line has a checksum, because a strict reader demands one from every line after the first that had one.
    let heard = b"ping*10\n".iter().map(|byte| reader.push::<InMemory>(*byte)).last();
    assert_eq!(heard, Some(Heard::Command(LineCommand::Ping)));
});
