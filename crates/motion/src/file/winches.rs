//! The winches of a file, and axes that their lists move and no motor is.

use super::problem::Problem;

/// The winches of a file, one for each list of lines. Motors with equal lists share one.
#[derive(Default)]
pub(super) struct Winches(Vec<List>);

/// A list of commands, and the axes that it is for.
struct List {
    lines: Vec<String>,
    /// Axes that motors are.
    driven: Vec<char>,
    moved: Moved,
}

/// Axes that a list moves, each with the problem at the first such place: it is one if no motor with that list is that axis.
pub(super) type Moved = Vec<(char, Problem)>;

impl Winches {
    pub(super) fn add(&mut self, lines: Vec<String>, axis: char, moved: Moved) {
        match self.0.iter_mut().find(|list| list.lines == lines) {
            Some(list) => list.driven.push(axis),
            None => self.0.push(List { lines, driven: vec![axis], moved }),
        }
    }

    /// The problems of axes that a list moves and no motor with that list is.
    pub(super) fn strays(self) -> impl Iterator<Item = Problem> {
        self.0.into_iter().flat_map(|List { driven, moved, .. }| {
            moved.into_iter().filter(move |(axis, _)| !driven.contains(axis)).map(|(_, problem)| problem)
        })
    }
}
