//! The motion file, which may change on the disk while the motion runs.
//!
//! The file is read five times a second and compared with what was there before. That works on network folders and with editors that put a new
//! file in the old one's place, where notices of the system do not come; and a text that is only half written has changed again at the next look.

use std::path::{Path, PathBuf};

/// A file that is looked at again and again.
#[derive(Clone, Debug)]
pub struct Watched {
    path: PathBuf,
    /// What was taken over, or refused, last.
    known: String,
    /// A text that differs from it, and was there at the last look.
    fresh: Option<String>,
}

/// How often the file is looked at, ms.
pub const LOOK_MS: u64 = 200;

impl Watched {
    /// Watches a file with a known text.
    #[must_use]
    pub fn new(path: &Path, known: &str) -> Watched {
        Watched { path: path.to_owned(), known: known.to_owned(), fresh: None }
    }

    /// Looks at the file: its text, if that has changed and stayed the same since the look before. A file that is gone, empty or unreadable is no
    /// change.
    pub fn look(&mut self) -> Option<String> {
        let text = pulsetrain_motion::file::named_text(&self.path).ok();
        self.see(text)
    }

    fn see(&mut self, text: Option<String>) -> Option<String> {
        let text = text.filter(|text| !text.trim().is_empty() && *text != self.known);
        let is_settled = text.is_some() && text == self.fresh;
        self.fresh = text;
        if !is_settled {
            return None;
        }
        let text = self.fresh.take()?;
        self.known.clone_from(&text);
        Some(text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_whole_new_text_is_a_change() {
        let mut file = Watched::new(Path::new("m.toml"), "a = 1");
        let mut looks = Vec::new();
        let seen = [
            Some("a = 1"),
            Some("a"),
            Some("a = 2"),
            None,
            Some("a = 2"),
            Some(""),
            Some("a = 2"),
            Some("a = 2"),
            Some("a = 2"),
            Some("a = 1"),
            Some("a = 1"),
        ];
        for text in seen {
            looks.push(file.see(text.map(str::to_owned)));
        }
        let changes: Vec<(usize, &str)> =
            looks.iter().enumerate().filter_map(|(look, text)| Some((look, text.as_deref()?))).collect();
        assert_eq!(changes, [(7, "a = 2"), (10, "a = 1")]);
    }
}
