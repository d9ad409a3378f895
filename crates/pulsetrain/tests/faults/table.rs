//! The table of docs/faults.md.

use crate::bench::{Moved, Seen};
use std::collections::BTreeSet;
use std::fmt::Write as _;

/// A fault on a board.
#[derive(Clone, Debug)]
pub(crate) struct Row {
    fault: String,
    board: &'static str,
    /// Where and when it is tried.
    places: String,
    /// How the motors move, each time.
    moved: Moved,
    /// All that the host said.
    said: BTreeSet<String>,
}

impl Row {
    pub(crate) fn new(fault: impl Into<String>, board: &'static str, places: impl Into<String>, moved: Moved) -> Row {
        Row { fault: fault.into(), board, places: places.into(), moved, said: BTreeSet::new() }
    }

    /// Adds what one try came to; `what` was tried.
    pub(crate) fn add(&mut self, seen: &Seen, what: impl std::fmt::Debug) {
        let Row { fault, board, moved, .. } = self;
        assert_eq!(seen.moved(*moved), *moved, "{fault}, {board}: {what:?}: {:?}", seen.error);
        self.said.insert(seen.said());
    }
}

/// The table, and below it what the host says.
pub(crate) fn markdown(rows: &[Row]) -> String {
    let mut text = "| fault | board | tried | the motors | the host says |\n|---|---|---|---|---|\n".to_owned();
    let mut messages: Vec<&str> = Vec::new();
    for Row { fault, board, places, moved, said } in rows {
        let numbers = said.iter().map(|said| {
            if said.is_empty() {
                return "nothing".to_owned();
            }
            let place = messages.iter().position(|message| message == said).unwrap_or_else(|| {
                messages.push(said);
                messages.len() - 1
            });
            format!("{}", place + 1)
        });
        let numbers = numbers.collect::<Vec<_>>().join(" or ");
        let _ = writeln!(text, "| {fault} | {board} | {places} | {} | {numbers} |", moved.in_words());
    }
    text.push_str("\nWhat the host says, N for every number:\n");
    for (number, message) in (1..).zip(&messages) {
        let _ = write!(text, "\n{number}. ```text\n");
        for line in message.lines() {
            let _ = writeln!(text, "   {line}");
        }
        text.push_str("   ```\n");
    }
    text
}
