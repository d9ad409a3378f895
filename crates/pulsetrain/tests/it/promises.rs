//! Pages that give boards' rates agree with the table of promises, with the committed images and with the table of
//! boards.

use crate::common::promises::{Motion, PROMISES, Promise};
use pulsetrain_bake::Image;
use pulsetrain_board::virtual_uno;
use pulsetrain_motion::boards;

fn page(name: &str) -> String {
    let path = format!("{}/../../{name}", env!("CARGO_MANIFEST_DIR"));
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{path}: {error}"))
}

#[track_caller]
fn says(name: &str, expected: &str) {
    assert!(page(name).contains(expected), "{name} should say: {expected}");
}

/// The page has the promises of the code, and was measured with the images that are committed.
#[test]
fn the_page_of_promises_is_of_the_committed_images() {
    let page = page("docs/benchmarks/promises.md");
    let rows = page.lines().filter(|line| line.starts_with("| uno |") || line.starts_with("| pico |"));
    let rows: Vec<Vec<&str>> = rows.map(|line| line.trim_matches('|').split('|').map(str::trim).collect()).collect();
    assert_eq!(rows.len(), PROMISES.len(), "run `cargo xtask bench promises`");
    for (row, promise) in rows.iter().zip(&PROMISES) {
        assert_eq!(row[..7], promise.fields(), "run `cargo xtask bench promises`");
        assert_eq!(row.last(), Some(&"holds"), "{row:?}");
    }
}

/// Rates of motions that stay fast, with 1, 2, … motors: the lowest of all pins, 1000 steps/s.
fn flat(board: &str, driver: &str, motors: &[usize]) -> Vec<String> {
    let of = |motors: &usize| {
        let is_one = |promise: &&Promise| {
            (promise.board, promise.driver, promise.motors) == (board, driver, *motors)
                && matches!(promise.motion, Motion::Flat(..))
        };
        PROMISES.iter().filter(is_one).map(|promise| promise.rate).fold(f64::INFINITY, f64::min).to_string()
    };
    motors.iter().map(of).collect()
}

#[test]
fn the_page_of_benchmarks_quotes_the_promises() {
    let check = |text: String| says("docs/benchmarks.md", &text);
    check(format!("{} k steps/s each", flat("uno", "A4988", &[1, 2, 3, 4]).join(", ")));
    check(format!("{} k steps/s each (TMC2209)", flat("pico", "TMC2209", &[1, 4, 8]).join(", ")));
}

/// The page of limits has the limits of the table of boards, rounded down.
#[test]
fn the_page_of_limits_quotes_the_table_of_boards() {
    let check = |text: String| says("docs/limits.md", &text);
    let rate = |board: &str, motors: usize, unit: f64| {
        let board = boards::find(board).expect("a board of the table").limits();
        board.tick_hz as f64 / f64::from(board.min_interval_ticks[motors - 1]) / unit
    };
    let down = |value: f64, digits: i32| (value * 10_f64.powi(digits)).floor() / 10_f64.powi(digits);
    let uno = |motors| down(rate("uno", motors, 1e3), 1);
    check(format!("{} k steps/s with one motor, {} k with four", uno(1), uno(4)));
    let pico = [down(rate("pico", 1, 1e6), 2), down(rate("pico", 8, 1e3), 0)];
    check(format!("{} M steps/s with one motor, {} k with eight", pico[0], pico[1]));
    let baked = boards::find("uno").and_then(|row| row.shortest_of_four_baked()).expect("an Uno's image");
    let baked = down(16e3 / f64::from(baked), 0);
    check(format!("four motors {baked} k steps/s each"));
    let room = Image::FLASH_BYTES - virtual_uno::baked_image().len();
    let room = format!("{} kB of plan", down(room as f64 / 1e3, 1));
    check(room.clone());
    says("docs/first-motion.md", &room);
    says(
        "docs/first-motion.md",
        &format!("four motors on a CNC shield make {baked} k steps/s each instead of {} k", uno(4).floor()),
    );
}
