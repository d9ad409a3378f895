//! Lines read as commands, and replies to lines.

use proptest::prelude::*;
use pulsetrain_core::winch::letters::InMemory;
use pulsetrain_core::winch::path::{Gains, Limits};
use pulsetrain_core::winch::reply::{LONGEST, LineReply};
use pulsetrain_core::winch::text::{Heard, LineCommand, LineError, LineFault, LineReader};

/// The reader's result for a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Command {
    Version,
    Ping,
    Enable(bool),
    Report(i32),
    Strict(bool),
    Deadman(i32),
    Axes { verb: LineCommand, axes: u8, values: [i32; 4] },
    Gains { axes: u8, gains: Gains },
    Limits { axes: u8, limits: Limits },
}

fn push(reader: &mut LineReader, byte: u8) -> Option<Result<Command, LineError>> {
    Some(Ok(match reader.push::<InMemory>(byte) {
        Heard::Nothing => return None,
        Heard::Refused(refusal) => return Some(Err(refusal)),
        Heard::Command(verb) => match verb {
            LineCommand::Version => Command::Version,
            LineCommand::Ping => Command::Ping,
            LineCommand::Enable => Command::Enable(reader.value() != 0),
            LineCommand::Report => Command::Report(reader.value()),
            LineCommand::Strict => Command::Strict(reader.value() != 0),
            LineCommand::Deadman => Command::Deadman(reader.value()),
            LineCommand::Gains => Command::Gains { axes: reader.axes(), gains: reader.gains().expect("in the region") },
            LineCommand::Limits => {
                Command::Limits { axes: reader.axes(), limits: reader.limits().expect("it can stop") }
            }
            LineCommand::Unknown => unreachable!("refused"),
            verb => Command::Axes { verb, axes: reader.axes(), values: *reader.values() },
        },
    }))
}

fn read(reader: &mut LineReader, text: &str) -> Vec<Result<Command, LineError>> {
    text.bytes().filter_map(|byte| push(reader, byte)).collect()
}

/// The results for one line, strict and not.
#[track_caller]
fn check(line: &str, command: Command) {
    for strict in [false, true] {
        let mut reader = LineReader::new();
        reader.set_strict(strict);
        assert_eq!(read(&mut reader, &format!("{line}\n")), [Ok(command)], "{line:?}, strict: {strict}");
    }
}

/// A line that the original accepts, and that is refused when strict.
#[track_caller]
fn check_lenient(line: &str, command: Command, what: LineFault, word: u8) {
    let mut reader = LineReader::new();
    assert_eq!(read(&mut reader, &format!("{line}\n")), [Ok(command)], "{line:?}");
    reader.set_strict(true);
    assert_eq!(read(&mut reader, &format!("{line}\n")), [Err(LineError { what, word })], "{line:?}, strict");
}

#[track_caller]
fn refuse(line: &str, what: LineFault, word: u8) {
    for strict in [false, true] {
        let mut reader = LineReader::new();
        reader.set_strict(strict);
        let expected = Err(LineError { what, word });
        assert_eq!(read(&mut reader, &format!("{line}\n")), [expected], "{line:?}, strict: {strict}");
        // The next line is read correctly.
        assert_eq!(read(&mut reader, "ping\n"), [Ok(Command::Ping)], "after {line:?}");
    }
}

fn axes(verb: LineCommand, axes: u8, values: [i32; 4]) -> Command {
    Command::Axes { verb, axes, values }
}

/// f and ζ in 10^-6.
fn gains(axes: u8, frequency: u32, ratio: u32) -> Command {
    Command::Gains { axes, gains: Gains::new(frequency, ratio).unwrap() }
}

/// vmax and amax in 10^-3.
fn limits(axes: u8, speed: u32, acceleration: u32) -> Command {
    Command::Limits { axes, limits: Limits::new(speed, acceleration).unwrap() }
}

#[test]
fn commands_of_the_original() {
    check("version", Command::Version);
    check("ping", Command::Ping);
    check("enable 1", Command::Enable(true));
    check("enable 0", Command::Enable(false));
    check("srate 50", Command::Report(50));
    check("a xyza 100 120 -200 -50", axes(LineCommand::Target, 15, [100, 120, -200, -50]));
    check("a ax 5 7", axes(LineCommand::Target, 9, [7, 0, 0, 5]));
    check("d x 50", axes(LineCommand::Move, 1, [50, 0, 0, 0]));
    check("v zy 10 -10", axes(LineCommand::Drift, 6, [0, -10, 10, 0]));
    check("r a -3", axes(LineCommand::Impulse, 8, [0, 0, 0, -3]));
    check("s xy 400 0", axes(LineCommand::Ramp, 3, [400, 0, 0, 0]));
    check("s x -1", axes(LineCommand::Ramp, 1, [0; 4]));
    check("g xyza 2.000000 1.000000", gains(15, 2_000_000, 1_000_000));
    check("l xyza 4000 40000", limits(15, 4_000_000, 40_000_000));
}

#[test]
fn beside_them() {
    check("strict 1", Command::Strict(true));
    check("deadman 2000", Command::Deadman(2000));
    check("deadman 0", Command::Deadman(0));
    refuse("deadman -1", LineFault::Range, 2);
}

#[test]
fn numbers() {
    check("a x -2147483648", axes(LineCommand::Target, 1, [i32::MIN, 0, 0, 0]));
    check("a x +2147483647", axes(LineCommand::Target, 1, [i32::MAX, 0, 0, 0]));
    check("a x 000000000000000000007", axes(LineCommand::Target, 1, [7, 0, 0, 0]));
    // atol stops at a point.
    check_lenient("a x 5.7", axes(LineCommand::Target, 1, [5, 0, 0, 0]), LineFault::Number, 3);
    check_lenient("a x -5.", axes(LineCommand::Target, 1, [-5, 0, 0, 0]), LineFault::Number, 3);
    for wrong in ["nan", "inf", "-", "+", "5x", "x5", "--5", "1e3", "0x10", ".", "1.2.3", "1-", "5,"] {
        refuse(&format!("a x {wrong}"), LineFault::Number, 3);
    }
    for far in ["2147483648", "-2147483649", "99999999999999999999", "429496729599"] {
        refuse(&format!("a x {far}"), LineFault::Range, 3);
    }
    check("g x 2 .5", gains(1, 2_000_000, 500_000));
    check("g x 2. 5e-1", gains(1, 2_000_000, 500_000));
    check("g x +20E-1 0.05e+1", gains(1, 2_000_000, 500_000));
    check("g x 1.0471975511965976 0.7071067811865476", gains(1, 1_047_198, 707_107));
    check("l x 0 1", limits(1, 0, 1_000));
    check("l x 1e4 25e4", limits(1, 10_000_000, 250_000_000));
    check_lenient("l x 1e5 1e6", limits(1, 10_000_000, 250_000_000), LineFault::Range, 3);
    check_lenient("l x 1e4 250000.001", limits(1, 10_000_000, 250_000_000), LineFault::Range, 4);
    check("l x 350000000e-5 35000.25", limits(1, 3_500_000, 35_000_250));
    for wrong in ["nan", "inf", "-inf", "infinity", "1e", "1e+", "1e+-1", "e3", ".", "1.5.", "2Hz", "1e1e1", "1e1.0"] {
        refuse(&format!("g x {wrong} 1"), LineFault::Number, 3);
        refuse(&format!("l x 100 {wrong}"), LineFault::Number, 4);
    }
    refuse("l x 1e-99e 100", LineFault::Number, 3);
    // A limit that is too high is cut, as long as atof's float holds it. Tiny numbers are 0.
    for far in ["10000.0005", "4294967.3", "5000000000", "1e10", "1e38", "4.29e38", "42900000000e28"] {
        check_lenient(&format!("l x {far} 5000"), limits(1, 10_000_000, 5_000_000), LineFault::Range, 3);
    }
    for far in ["4.3e38", "43000000000e28", "1e39", "1e99", "1e99999999999999999999999", &"9".repeat(60), "-1e999"] {
        refuse(&format!("l x {far} 5000"), LineFault::Range, 3);
        refuse(&format!("l x 5000 {far}"), LineFault::Range, 4);
        refuse(&format!("g x {far} 1"), LineFault::Frequency, 3);
        refuse(&format!("g x 1 {far}"), LineFault::Ratio, 4);
    }
    for tiny in ["0e99", "1e-99", "0.0004", &format!("0.{}1e50", "0".repeat(57)), "-0.0004"] {
        check(&format!("l x {tiny} 5000"), limits(1, 0, 5_000_000));
    }
    check("l x 12345678901234567890e-18 5000", limits(1, 12_346, 5_000_000));
    check("l x 0.0000000000005e13 5000", limits(1, 5000, 5_000_000));
    check("g x 0.0099995 .0699995", gains(1, 10_000, 70_000));
}

#[test]
fn a_speed_that_no_motor_has() {
    check_lenient("v x 15001", axes(LineCommand::Drift, 1, [15_000, 0, 0, 0]), LineFault::Range, 3);
    check_lenient("v xy 15000 -15001", axes(LineCommand::Drift, 3, [15_000, -15_000, 0, 0]), LineFault::Range, 4);
    check_lenient("v a -2147483647", axes(LineCommand::Drift, 8, [0, 0, 0, -15_000]), LineFault::Range, 3);
    refuse("v a -2147483648", LineFault::Range, 3);
}

/// With its checksum.
fn checked(line: &str) -> String {
    let sum = line.bytes().fold(0, |sum, byte| sum ^ byte);
    format!("{line}*{sum:02x}\n")
}

#[test]
fn strict_with_checksums_one_wrong_bit_moves_nothing() {
    for line in [
        "a xy 100 -7",
        "d za 4 40",
        "v x -15000",
        "r xyza 1 2 3 4",
        "s y 0",
        "g xy 1 2",
        "g xyza 2.000000 1.000000",
        "l x 100 500",
        "enable 0",
        "enable 1",
        "srate 200",
        "deadman 300",
        "strict 1",
        "strict 0",
        "version",
        "ping",
    ] {
        let whole = checked(line);
        let mut reader = LineReader::new();
        assert_eq!(read(&mut reader, &checked("strict 1")), [Ok(Command::Strict(true))]);
        reader.set_strict(true);
        let meant = read(&mut reader.clone(), &whole);
        assert!(meant.len() == 1 && meant[0].is_ok(), "{whole:?}: {meant:?}");
        let next = checked("a z 77");
        for at in 0..whole.len() {
            for bit in 0..8 {
                let mut bytes = whole.clone().into_bytes();
                bytes[at] ^= 1 << bit;
                bytes.extend(next.bytes());
                let mut reader = reader.clone();
                let heard: Vec<_> = bytes.iter().filter_map(|byte| push(&mut reader, *byte)).collect();
                // A digit of the checksum in upper case is the same digit. Without its end a line takes the next one with it.
                let is_harmless = |heard: &Result<Command, LineError>| {
                    heard.is_err() || *heard == meant[0] || *heard == Ok(axes(LineCommand::Target, 4, [0, 0, 77, 0]))
                };
                assert!(heard.iter().all(is_harmless), "{whole:?}, bit {bit} of byte {at}: {heard:?}");
                assert!(heard.len() >= 2 || at + 1 == whole.len(), "{whole:?}, bit {bit} of byte {at}: {heard:?}");
            }
        }
    }
}

#[test]
fn after_a_checksum_strict_wants_one_on_each_line() {
    let mut reader = LineReader::new();
    // When not strict, no checksum is needed.
    assert!(read(&mut reader, &format!("{}a x 1\n", checked("ping"))).iter().all(Result::is_ok));
    reader.set_strict(true);
    let refused = Err(LineError { what: LineFault::Checksum, word: 3 });
    assert_eq!(read(&mut reader, "a x 1\n"), [Ok(axes(LineCommand::Target, 1, [1, 0, 0, 0]))], "none yet since then");
    assert_eq!(read(&mut reader, &format!("{}a x 1\n", checked("ping"))), [Ok(Command::Ping), refused]);
    // Blank lines need none. A line that is too long gets that as its fault.
    assert_eq!(read(&mut reader, "\n \n"), []);
    let long = Err(LineError { what: LineFault::Long, word: 1 });
    assert_eq!(read(&mut reader, &format!("{}\n", "a".repeat(81))), [long]);
    // `strict 1` without a checksum starts as at first. With a checksum, every later line needs one.
    assert_eq!(read(&mut reader, "strict 1\n"), [Err(LineError { what: LineFault::Checksum, word: 2 })]);
    assert_eq!(read(&mut reader, &checked("strict 0")), [Ok(Command::Strict(false))]);
    reader.set_strict(false);
    assert_eq!(read(&mut reader, "strict 1\n"), [Ok(Command::Strict(true))]);
    reader.set_strict(true);
    assert_eq!(read(&mut reader, "ping\n"), [Ok(Command::Ping)]);
    assert_eq!(read(&mut reader, &checked("strict 1")), [Ok(Command::Strict(true))]);
    reader.set_strict(true);
    assert_eq!(read(&mut reader, "a x 1\n"), [refused]);
}

#[test]
fn what_would_do_harm() {
    refuse("g x 0.00999 1", LineFault::Frequency, 3);
    refuse("g x 20.001 1", LineFault::Frequency, 3);
    refuse("g x 0 1", LineFault::Frequency, 3);
    refuse("g x 1e-99 1", LineFault::Frequency, 3);
    refuse("g x -1 1", LineFault::Frequency, 3);
    refuse("g x 1 -1", LineFault::Ratio, 4);
    refuse("g x 1 0.0699", LineFault::Ratio, 4);
    refuse("g x 1 5.001", LineFault::Ratio, 4);
    refuse("l x -1 100", LineFault::Range, 3);
    refuse("l x 100 0", LineFault::Range, 4);
    refuse("l x 100 0.5", LineFault::Range, 4);
    refuse("v x 2147483648", LineFault::Range, 3);
    refuse("s x 65536", LineFault::Range, 3);
    for number in ["2", "-1", "256", "-2147483648"] {
        refuse(&format!("strict {number}"), LineFault::Range, 2);
    }
    refuse("srate 0", LineFault::Rate, 2);
    refuse("srate -5", LineFault::Rate, 2);
    refuse("srate 65536", LineFault::Range, 2);
    refuse("jump x 1", LineFault::Command, 1);
    refuse("A x 1", LineFault::Command, 1);
    refuse("versions", LineFault::Command, 1);
    refuse("pin", LineFault::Command, 1);
    refuse("enableenable 1", LineFault::Command, 1);
    refuse("a\u{7f} x 1", LineFault::Noise, 1);
    refuse("a x 1\u{0}", LineFault::Noise, 3);
    refuse("a x é", LineFault::Noise, 3);
    refuse("a", LineFault::Missing, 2);
    refuse("a x", LineFault::Missing, 3);
    refuse("enable", LineFault::Missing, 2);
    refuse("enable on", LineFault::Number, 2);
    refuse("srate", LineFault::Missing, 2);
    refuse("g x 1", LineFault::Missing, 4);
    // The axis is missing: the value is taken for axes, and nothing is done.
    for line in ["a 5", "d 5", "v -5", "r 1", "s 100", "g 2 1", "l 1000 1000", "a q 1", "d 1 2 3"] {
        refuse(line, LineFault::Flags, 2);
    }
    refuse("l xyza", LineFault::Missing, 3);
    // One pair of values is for all axes. With half a pair the original does nothing either.
    for line in ["l x 100", "l xyza 100", "g xyza 1"] {
        refuse(line, LineFault::Missing, 4);
    }
}

#[test]
fn what_the_original_lets_pass() {
    check_lenient("a xyza 1 2", axes(LineCommand::Target, 3, [1, 2, 0, 0]), LineFault::Missing, 5);
    check_lenient("a xqy 1 2", axes(LineCommand::Target, 3, [1, 2, 0, 0]), LineFault::Flags, 2);
    check_lenient("a x 1 2", axes(LineCommand::Target, 1, [1, 0, 0, 0]), LineFault::Extra, 4);
    check_lenient("a x 1 what", axes(LineCommand::Target, 1, [1, 0, 0, 0]), LineFault::Extra, 4);
    check_lenient("a xx 5 7", axes(LineCommand::Target, 1, [7, 0, 0, 0]), LineFault::Flags, 2);
    check_lenient("d xx 5 7", axes(LineCommand::Move, 1, [12, 0, 0, 0]), LineFault::Flags, 2);
    check_lenient("d xxxxxxxxx 1 1 1 1 1 1 1 1", axes(LineCommand::Move, 1, [8, 0, 0, 0]), LineFault::Flags, 2);
    for number in ["2", "-1", "256", "-2147483648"] {
        check_lenient(&format!("enable {number}"), Command::Enable(true), LineFault::Range, 2);
    }
    check_lenient("enable 1 2", Command::Enable(true), LineFault::Extra, 3);
    check_lenient("ping pong", Command::Ping, LineFault::Extra, 2);
    check_lenient("g xw 1 1 1", gains(1, 1_000_000, 1_000_000), LineFault::Flags, 2);
    refuse_lenient("d xx 2147483647 1", LineFault::Range, 4);
}

/// Lines that strict mode refuses for another reason.
#[track_caller]
fn refuse_lenient(line: &str, what: LineFault, word: u8) {
    assert_eq!(read(&mut LineReader::new(), &format!("{line}\n")), [Err(LineError { what, word })], "{line:?}");
}

#[test]
fn lines() {
    let mut reader = LineReader::new();
    assert_eq!(read(&mut reader, "\n\r\n   \n\t\r\r\n"), [], "blank lines");
    let both = [Ok(Command::Ping), Ok(Command::Version)];
    for text in
        ["ping\nversion\n", "ping\r\nversion\r\n", "ping\rversion\r", " ping \n\tversion\t\n", "ping\n\r\nversion\r"]
    {
        assert_eq!(read(&mut reader, text), both, "{text:?}");
    }
    assert_eq!(read(&mut reader, "d\tx  \t 10 \n"), [Ok(axes(LineCommand::Move, 1, [10, 0, 0, 0]))]);
    // Eighty bytes fit.
    let spaces = " ".repeat(80 - 5);
    check(&format!("d x{spaces}10"), axes(LineCommand::Move, 1, [10, 0, 0, 0]));
    refuse(&format!("d x{spaces} 10"), LineFault::Long, 3);
    refuse(&"x".repeat(300), LineFault::Long, 1);
    refuse(&" ".repeat(300), LineFault::Long, 0);
    refuse(&format!("{}*", " ".repeat(300)), LineFault::Long, 0);
    // Ten words fit.
    check_lenient("a x 1 2 3 4 5 6 7 8", axes(LineCommand::Target, 1, [1, 0, 0, 0]), LineFault::Extra, 4);
    refuse_lenient("a x 1 2 3 4 5 6 7 8 9", LineFault::Words, 11);
    // The beginning of a line can be dropped.
    assert_eq!(read(&mut reader, "a x 1"), []);
    reader.restart();
    assert_eq!(read(&mut reader, "2\n"), [Err(LineError { what: LineFault::Command, word: 1 })]);
}

#[test]
fn checksums() {
    let sum = |text: &str| text.bytes().fold(0, |sum, byte| sum ^ byte);
    let command = axes(LineCommand::Target, 3, [100, -7, 0, 0]);
    for text in ["a xy 100 -7", "a xy 100 -7 "] {
        check(&format!("{text}*{:02x}", sum(text)), command);
        check(&format!("{text}*{:02X}", sum(text)), command);
        check(&format!("{text}*{:02x} \t ", sum(text)), command);
        for bit in 0..8 {
            refuse(&format!("{text}*{:02x}", sum(text) ^ 1 << bit), LineFault::Checksum, 4);
        }
    }
    for end in ["*", "*1", "*123", "*1g", "**", "*12 ", "* 12", "* ", "*1 2", "*12 3"] {
        refuse(&format!("ping{end}"), LineFault::Checksum, 1);
    }
    refuse("nonsense*00", LineFault::Checksum, 1);
    refuse("*01", LineFault::Checksum, 0);
    assert_eq!(read(&mut LineReader::new(), "*00\n*00 \n"), [], "a blank line with its checksum");
}

#[track_caller]
fn says(reply: LineReply, text: &str) {
    let mut line = [0; LONGEST];
    let len: usize = reply.write::<InMemory>(&mut line).into();
    assert_eq!(std::str::from_utf8(&line[..len]), Ok(format!("{text}\r\n").as_str()));
}

#[test]
fn replies() {
    says(LineReply::Awake, "awake");
    says(LineReply::Id, "id StepperWinch Nov 21 2026");
    says(LineReply::Status { usec: 0, positions: [0, -1, 10, i32::MAX] }, "txyza 0 0 -1 10 2147483647");
    let longest = LineReply::Status { usec: i32::MIN, positions: [i32::MIN; 4] };
    says(longest, &format!("txyza{}", " -2147483648".repeat(5)));
    assert_eq!(usize::from(longest.write::<InMemory>(&mut [0; LONGEST])), LONGEST);
    assert_eq!(longest.write::<InMemory>(&mut [0; 9]), 9, "what does not fit is lost");
    let refused = |what, word, text| says(LineReply::Refused(LineError { what, word }), text);
    refused(LineFault::Command, 1, "err command 1");
    refused(LineFault::Flags, 2, "err flags 2");
    refused(LineFault::Number, 3, "err number 3");
    refused(LineFault::Range, 10, "err range 10");
    refused(LineFault::Frequency, 3, "err range 3 0.01..20 Hz");
    refused(LineFault::Ratio, 4, "err range 4 0.07..5");
    refused(LineFault::Missing, 2, "err missing 2");
    refused(LineFault::Extra, 3, "err extra 3");
    refused(LineFault::Long, 3, "err long 3");
    refused(LineFault::Noise, 1, "err noise 1");
    refused(LineFault::Checksum, 2, "err checksum 2");
    refused(LineFault::Rate, 2, "dbg invalid srate value");
    refused(LineFault::Words, 11, "dbg excessive input error");
    says(LineReply::Taken, "err taken");
}

/// strtol's whole numbers, by Rust's own reading.
fn whole(text: &str) -> Option<i32> {
    text.strip_prefix('+').filter(|rest| !rest.starts_with(['+', '-'])).unwrap_or(text).parse().ok()
}

proptest! {
    #[test]
    fn whole_numbers_are_rusts(text in "[+-]{0,2}[0-9]{1,12}") {
        let heard = read(&mut LineReader::new(), &format!("a z {text}\n"));
        match whole(&text) {
            Some(value) => prop_assert_eq!(&heard[..], &[Ok(axes(LineCommand::Target, 4, [0, 0, value, 0]))]),
            None => {
                let refused = matches!(heard[..], [Err(LineError { what: LineFault::Number | LineFault::Range, word: 3 })]);
                prop_assert!(refused);
            }
        }
    }

    #[test]
    fn decimals_are_rusts(text in "[+-]?[0-9]{0,5}[.]?[0-9]{0,9}(e[+-]?[0-9]{1,2})?") {
        // An empty text is no word.
        prop_assume!(!text.is_empty());
        // atof's, but for what only Rust takes.
        let exact = text.parse::<f64>().ok();
        let heard = read(&mut LineReader::new(), &format!("l x {text} 1\n"));
        match (exact, &heard[..]) {
            (None, [Err(refusal)]) => prop_assert_eq!(refusal.what, LineFault::Number),
            (Some(value), [Err(refusal)]) => {
                prop_assert_eq!(refusal.what, LineFault::Range);
                prop_assert!(!(-0.0005..=4.29e38).contains(&value), "{value}");
            }
            (Some(value), [Ok(Command::Limits { axes: 1, limits })]) => {
                // By thousandths: what the number was, to the nearest.
                let nearest = (value.abs() * 1000.0).round().min(1e7) as u32;
                let near = [nearest.saturating_sub(1), nearest, nearest + 1].map(|speed| Limits::new(speed, 1000));
                prop_assert!(near.contains(&Some(*limits)), "{} {:?}", value, limits);
            }
            _ => prop_assert!(false, "{:?}", heard),
        }
    }

    #[test]
    fn any_bytes_are_taken(bytes in prop::collection::vec(any::<u8>(), 0..400), strict: bool) {
        let mut reader = LineReader::new();
        reader.set_strict(strict);
        let mut line = 0;
        for byte in bytes {
            let heard = push(&mut reader, byte);
            let ends = byte == b'\n' || byte == b'\r';
            prop_assert!(ends || heard.is_none(), "only at its end");
            line = if ends { 0 } else { line + 1 };
        }
        push(&mut reader, b'\n');
        let heard: Vec<_> = b"a y 77\n".iter().filter_map(|byte| push(&mut reader, *byte)).collect();
        prop_assert_eq!(heard, [Ok(axes(LineCommand::Target, 2, [0, 77, 0, 0]))]);
    }

    #[test]
    fn numbers_are_written_as_rust_does(usec: i32, positions: [i32; 4], shift in 0..31_u32) {
        let positions = positions.map(|position| position >> shift);
        let [x, y, z, a] = positions;
        let mut line = [0; LONGEST];
        let len: usize = LineReply::Status { usec, positions }.write::<InMemory>(&mut line).into();
        let text = format!("txyza {usec} {x} {y} {z} {a}\r\n");
        prop_assert_eq!(std::str::from_utf8(&line[..len]).unwrap(), text);
    }
}
