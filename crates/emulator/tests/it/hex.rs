//! Intel HEX: good files, and each kind of bad one.

use pulsetrain_emulator::hex::{HexError, parse};

const END: &str = ":00000001FF";

#[test]
fn an_image() {
    let text = format!(":0400000001020304F2\r\n:020006000506ED\r\n\r\n{END}\r\n:garbage after the end");
    assert_eq!(parse(&text, 32), Ok(vec![1, 2, 3, 4, 0xff, 0xff, 5, 6]));
}

#[test]
fn bases() {
    assert_eq!(parse(&format!(":020000020001FB\n:0100000007F8\n{END}"), 32).map(|i| i.len()), Ok(17));
    assert_eq!(
        parse(&format!(":020000040001F9\n:0100000007F8\n{END}"), 32768),
        Err(HexError::Beyond { line: 2, address: 0x10000, limit: 32768 })
    );
}

#[test]
fn errors_name_the_line() {
    let check =
        |line: &str, expected| assert_eq!(parse(&format!(":0100000007F8\n{line}\n{END}"), 32768), Err(expected));
    check("00000001FF", HexError::NoColon { line: 2 });
    check(":0000000G00", HexError::NotHex { line: 2 });
    check(":000", HexError::NotHex { line: 2 });
    check(":+1000000", HexError::NotHex { line: 2 });
    check(":äöü", HexError::NotHex { line: 2 });
    check(":0200000007F7", HexError::Length { line: 2, announced: 2, found: 1 });
    check(":00", HexError::Length { line: 2, announced: 0, found: 0 });
    check(":00000000", HexError::Length { line: 2, announced: 0, found: 0 });
    check(":0100000007F9", HexError::Checksum { line: 2, sum: 1 });
    check(":00000009F7", HexError::Kind { line: 2, kind: 9 });
    assert_eq!(parse(":0100000007F8", 32768), Err(HexError::NoEnd));
}
