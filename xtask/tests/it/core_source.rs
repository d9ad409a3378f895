//! Checks the code that boards run: no float, no allocator, no `unsafe`, no division on the step path.
//!
//! The compiler forbids `unsafe` and `std` already; this reads the tokens, so that a float in a type, or a division
//! that a board would do in 3000 cycles, cannot come in unseen either.

use proc_macro2::{Delimiter, TokenStream, TokenTree};
use std::path::Path;

/// Functions that may divide, since no board calls them between two steps: (file, function).
const OFF_THE_STEP_PATH: [(&str, &str); 5] = [
    // Closed forms of the recurrence, for the host's replay and for a board's switch to a new epoch.
    ("segment.rs", "span"),
    ("segment.rs", "after"),
    // Shares of a pool: constants, which the compiler divides.
    ("bytes.rs", "share"),
    // Reads lines, not steps. On an AVR it is assembly (firmware/uno/src/bin/uno-winch/winch/text.s).
    ("text.rs", "number"),
    ("text.rs", "scaled"),
];

#[test]
fn core_has_no_float_alloc_unsafe_or_division() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../crates/core/src");
    let (mut found, mut folders) = (Vec::new(), vec![folder]);
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).expect("core has sources") {
            let path = entry.expect("a folder entry").path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let source = std::fs::read_to_string(&path).expect("a source file");
            let name = path.file_name().expect("a name").to_string_lossy().into_owned();
            found.extend(forbidden(&name, &source));
        }
    }
    assert!(found.is_empty(), "in crates/core/src:\n{}", found.join("\n"));
}

#[test]
fn core_is_no_std_and_forbids_unsafe() {
    let source = include_str!("../../../crates/core/src/lib.rs");
    assert!(source.contains("#![no_std]") && source.contains("#![forbid(unsafe_code)]"));
}

/// Checks the scan itself: what it must find, and what it must not.
#[test]
fn the_scan_finds_what_it_should() {
    fn check(source: &str, expected: &[&str]) {
        let found = forbidden("x.rs", source);
        assert_eq!(found, expected, "{source}");
    }
    check("fn f(x: f32) {}", &["x.rs: `f32` in f"]);
    check("fn f() { g(1.5) }", &["x.rs: `1.5` in f"]);
    check("fn f() { g(1e3) }", &["x.rs: `1e3` in f"]);
    check("fn f() -> u8 { 0x1e3; 1..3; t.0 }", &[]);
    check("impl S { fn f(a: u8) -> u8 { a / 3 } fn g(a: u8) -> u8 { a % 3 } }", &["x.rs: `/` in f", "x.rs: `%` in g"]);
    check("fn f(a: u8) -> u8 { a.div_ceil(3) }", &["x.rs: `div_ceil` in f"]);
    check("extern crate alloc; use std::vec;", &["x.rs: `alloc` in -", "x.rs: `std` in -"]);
    check("fn f() { unsafe { g() } }", &["x.rs: `unsafe` in f"]);
    check("/// 1.5 / 3 in prose\nfn f() {} // f64\n#[cfg(test)]\nmod tests { fn t() { 1.5 / 2.0; } }", &[]);
}

fn forbidden(file: &str, source: &str) -> Vec<String> {
    let tokens: TokenStream = source.parse().expect("a source file is tokens");
    let mut found = Vec::new();
    scan(file, "-", tokens, &mut found);
    found
}

fn scan(file: &str, outer: &str, tokens: TokenStream, found: &mut Vec<String>) {
    let mut function = outer.to_owned();
    let mut after_fn = false;
    let mut tests_only = false;
    for token in tokens {
        let text = token.to_string();
        match token {
            TokenTree::Group(group) => {
                let test_module = tests_only && group.delimiter() == Delimiter::Brace;
                if group.delimiter() == Delimiter::Bracket && text.replace(' ', "") == "[cfg(test)]" {
                    tests_only = true;
                } else if !test_module {
                    scan(file, &function, group.stream(), found);
                }
                if test_module {
                    tests_only = false;
                }
            }
            TokenTree::Ident(_) if after_fn => {
                function = text;
                after_fn = false;
            }
            TokenTree::Ident(_) if text == "fn" => after_fn = true,
            TokenTree::Ident(_) if is_forbidden(&text) => found.push(format!("{file}: `{text}` in {function}")),
            TokenTree::Ident(_) if divides(&text) => note_division(file, &function, &text, found),
            TokenTree::Punct(punct) if matches!(punct.as_char(), '/' | '%') => {
                note_division(file, &function, &text, found);
            }
            // `#[cfg(test)]` on an item without a body.
            TokenTree::Punct(punct) if punct.as_char() == ';' => tests_only = false,
            TokenTree::Literal(_) if is_float(&text) => found.push(format!("{file}: `{text}` in {function}")),
            TokenTree::Ident(_) | TokenTree::Punct(_) | TokenTree::Literal(_) => {}
        }
    }
}

fn note_division(file: &str, function: &str, text: &str, found: &mut Vec<String>) {
    if !OFF_THE_STEP_PATH.contains(&(file, function)) {
        found.push(format!("{file}: `{text}` in {function}"));
    }
}

fn is_forbidden(ident: &str) -> bool {
    matches!(ident, "f32" | "f64" | "std" | "alloc" | "unsafe")
}

fn divides(ident: &str) -> bool {
    ident.split('_').any(|word| matches!(word, "div" | "rem"))
}

fn is_float(literal: &str) -> bool {
    let decimal = literal.starts_with(|c: char| c.is_ascii_digit()) && !literal.starts_with("0x");
    decimal && (literal.contains(['.', 'e']) || literal.ends_with("f32") || literal.ends_with("f64"))
}
