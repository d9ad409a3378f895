//! The table of docs/faults.md.

use super::bench::{Moved, Seen};
use std::collections::BTreeSet;
use std::fmt::Write as _;

/// A fault on a board.
#[derive(Debug)]
pub(crate) struct Row {
    fault: String,
    board: &'static str,
    /// Where and when it is tried.
    places: String,
    /// How the motors moved, each time.
    moved: Moved,
    /// All messages of the host.
    said: BTreeSet<String>,
}

impl Row {
    pub(crate) fn new(fault: impl Into<String>, board: &'static str, places: impl Into<String>, moved: Moved) -> Row {
        Row { fault: fault.into(), board, places: places.into(), moved, said: BTreeSet::new() }
    }

    /// Adds the result of one try of `what`.
    pub(crate) fn add(&mut self, seen: &Seen, what: impl std::fmt::Debug) {
        self.add_as(seen, what, &seen.said());
    }

    /// The same fault with other messages of the host is merged here.
    pub(crate) fn add_as(&mut self, seen: &Seen, what: impl std::fmt::Debug, said: &str) {
        let Row { fault, board, moved, .. } = self;
        assert_eq!(seen.moved(*moved), *moved, "{fault}, {board}: {what:?}: {:?}", seen.error);
        self.said.insert(numberless(said));
    }

    /// Adds a message that does not fit into [`Seen`].
    pub(crate) fn say(&mut self, said: &str) {
        self.said.insert(numberless(said));
    }
}

/// The names of the motors, one of which is the first without a plan.
const MOTORS: [&str; 2] = ["a", "b"];

/// The message with N for every number and M for the motor that had no more plan, and without the part about a missing answer.
fn numberless(text: &str) -> String {
    let mut less = String::new();
    for line in text.lines() {
        let line = line.split(". If the last messages did not reach").next().unwrap_or(line);
        let line = MOTORS.iter().fold(line.to_owned(), |line, motor| {
            line.replace(&format!("plan for motor {motor},"), "plan for motor M,")
        });
        less.push_str(if less.is_empty() { "" } else { "\n" });
        for letter in line.chars() {
            match letter {
                '0'..='9' if less.ends_with('N') => {}
                '0'..='9' => {
                    if less.ends_with(" -") {
                        less.pop();
                    }
                    less.push('N');
                }
                letter => less.push(letter),
            }
        }
    }
    less
}

/// The table of the faults on an Uno and on a Pico, and below it the host's messages.
pub(crate) fn markdown([uno, pico]: &[Vec<Row>; 2]) -> String {
    let mut text = "| fault | board | tried | the motors | the host says |\n|---|---|---|---|---|\n".to_owned();
    let mut messages = Vec::new();
    let mut write = |row @ Row { fault, places, .. }: &Row, board: &str| {
        let (moved, said) = (row.moved.in_words(), numbers(&row.said, &mut messages));
        let _ = writeln!(text, "| {fault} | {board} | {places} | {moved} | {said} |");
    };
    assert_eq!(uno.len(), pico.len(), "the same faults");
    for (uno, pico) in uno.iter().zip(pico) {
        if (&uno.places, uno.moved, &uno.said) == (&pico.places, pico.moved, &pico.said) {
            write(uno, "Uno, Pico");
        } else {
            write(uno, "Uno");
            write(pico, "Pico");
        }
    }
    text.push_str("\nWhat the host says, with N for every number and M for a motor:\n");
    for (number, message) in (1..).zip(&messages) {
        let _ = write!(text, "\n{number}.\n```text\n{message}\n```\n");
    }
    text
}

/// The numbers of the messages. New ones are added at the end.
fn numbers(said: &BTreeSet<String>, messages: &mut Vec<String>) -> String {
    let number = |said: &String| {
        if said.is_empty() {
            return "–".to_owned();
        }
        let place = messages.iter().position(|message| message == said).unwrap_or_else(|| {
            messages.push(said.clone());
            messages.len() - 1
        });
        format!("{}", place + 1)
    };
    said.iter().map(number).collect::<Vec<_>>().join(" or ")
}
