//! The motion file and the files that it names, which may change on the disk while the motion runs.
//!
//! They are read five times a second and compared with what was there before. That works on network folders and with editors that put a new
//! file in the old one's place, where notices of the system do not come; and a text that is only half written has changed again at the next look.
//! A large file is read only if its size or its time has changed, and every ten seconds.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fs::Metadata;
use std::path::{Path, PathBuf};

use pulsetrain_motion::file::{MOST_OF_A_NAMED_FILE, Sheet};

use crate::files::inputs;
use crate::live::FileTexts;
use crate::live::log::text_hash;

/// A file that is looked at again and again.
#[derive(Clone, Debug)]
pub(super) struct Watched {
    path: PathBuf,
    /// What was taken over, or refused, last: its text's hash.
    known: u64,
    /// A text that differs from it, and was there at the last look.
    fresh: Option<String>,
    /// What the system said of a large file when it was read last, and how many looks it was not read since.
    read: Option<(Metadata, u32)>,
}

/// How often the files are looked at, ms.
pub(super) const LOOK_MS: u64 = 200;

/// A file of more bytes is not read at each look.
const LARGE: u64 = 1 << 20;
/// A large file is read at every so many looks, whatever the system says of it.
const LOOKS: u32 = 50;

impl Watched {
    /// Watches a file with a known text.
    pub(super) fn new(path: &Path, known: &str) -> Watched {
        Watched { path: path.to_owned(), known: text_hash(known), fresh: None, read: None }
    }

    /// Looks at the file: its text, if that has changed and stayed the same since the look before. A file that is gone, empty or unreadable is no
    /// change.
    pub(super) fn look(&mut self) -> Option<String> {
        let Ok(said) = std::fs::metadata(&self.path) else { return self.see(None) };
        if let Some((before, looks)) = &mut self.read
            && *looks < LOOKS
            && before.len() == said.len()
            && before.modified().ok() == said.modified().ok()
        {
            *looks += 1;
            let fresh = self.fresh.clone();
            return if fresh.is_some() { self.see(fresh) } else { None };
        }
        self.read = (said.len() > LARGE).then_some((said, 0));
        let text = inputs::text(&self.path, MOST_OF_A_NAMED_FILE).ok();
        self.see(text)
    }

    fn see(&mut self, text: Option<String>) -> Option<String> {
        let text = text.filter(|text| !text.trim().is_empty() && text_hash(text) != self.known);
        let is_settled = text.is_some() && text == self.fresh;
        self.fresh = text;
        if !is_settled {
            return None;
        }
        let text = self.fresh.take()?;
        self.known = text_hash(&text);
        Some(text)
    }
}

/// A motion file with the files that it names.
#[derive(Clone, Debug)]
pub(super) struct WatchedFiles {
    folder: PathBuf,
    motion: Watched,
    /// The motion file's text, as it was seen whole last.
    text: String,
    named: BTreeMap<PathBuf, Watched>,
    /// Texts of named files that were seen whole and differ from those in force.
    changed: FileTexts,
}

impl WatchedFiles {
    /// Watches a motion file with a known text.
    pub(super) fn new(path: &Path, known: &str) -> WatchedFiles {
        let folder = path.parent().unwrap_or(Path::new("")).to_owned();
        let motion = Watched::new(path, known);
        WatchedFiles { folder, motion, text: known.to_owned(), named: BTreeMap::new(), changed: FileTexts::new() }
    }

    /// Reads the files that a changed text names, and that the motion does not have: it reads none by itself.
    fn read_named(&mut self, text: &str, in_force: &FileTexts) {
        let read: RefCell<FileTexts> = RefCell::default();
        let load = |named: &Path| {
            let known = in_force.get(named).map(|text| self.changed.get(named).unwrap_or(text).clone());
            if let Some(text) = known.or_else(|| read.borrow().get(named).cloned()) {
                return Ok(text);
            }
            let text = inputs::text(&self.folder.join(named), MOST_OF_A_NAMED_FILE)?;
            read.borrow_mut().insert(named.to_owned(), text.clone());
            Ok(text)
        };
        // What is wrong with it is said when the motion is asked for it.
        drop(Sheet::parse(text, "").and_then(|sheet| sheet.contents(&load)));
        self.changed.extend(read.into_inner());
    }

    /// Looks at all of them. `in_force` are the named files as the motion has them. If one has changed: the motion file's text, and the named files that
    /// differ from those in force.
    pub(super) fn look(&mut self, in_force: &FileTexts) -> Option<(String, FileTexts)> {
        let mut has_changed = false;
        if let Some(text) = self.motion.look() {
            self.read_named(&text, in_force);
            (self.text, has_changed) = (text, true);
        }
        // Those of a text that was refused, too: a change of one may mend it.
        let others: FileTexts = self
            .changed
            .iter()
            .filter(|(name, _)| !in_force.contains_key(*name))
            .map(|(name, text)| (name.clone(), text.clone()))
            .collect();
        for (name, text) in in_force.iter().chain(&others) {
            let path = self.folder.join(name);
            let watched = self.named.entry(name.clone()).or_insert_with(|| Watched::new(&path, text));
            if let Some(text) = watched.look() {
                self.changed.insert(name.clone(), text);
                has_changed = true;
            }
        }
        // What was taken over meanwhile differs no more.
        self.changed.retain(|name, text| in_force.get(name) != Some(text));
        has_changed.then(|| (self.text.clone(), self.changed.clone()))
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

    #[test]
    fn files_that_the_motion_file_names_are_looked_at_by_their_content() {
        let folder = pulsetrain_testkit::folder::Folder::new("watch-named");
        let write = |name: &str, text: &str| std::fs::write(folder.0.join(name), text).unwrap();
        let large = |first: &str| format!("{first}\n{}", "0,0\n".repeat(400_000));
        write("m.toml", "a");
        write("t.csv", "1,2");
        write("large.csv", &large("1"));
        let mut in_force: FileTexts = [("t.csv".into(), "1,2".to_owned()), ("large.csv".into(), large("1"))].into();
        let mut files = WatchedFiles::new(&folder.0.join("m.toml"), "a");
        let mut settled = |in_force: &FileTexts| (0..3).find_map(|_| files.look(in_force));
        assert_eq!(settled(&in_force), None);
        write("t.csv", "1,3");
        let changed = FileTexts::from([("t.csv".into(), "1,3".to_owned())]);
        assert_eq!(settled(&in_force), Some(("a".to_owned(), changed.clone())));
        // It was refused: a change of the motion file brings it again.
        write("m.toml", "b");
        assert_eq!(settled(&in_force), Some(("b".to_owned(), changed)));
        in_force.insert("t.csv".into(), "1,3".to_owned());
        std::fs::remove_file(folder.0.join("t.csv")).unwrap();
        assert_eq!(settled(&in_force), None, "gone");
        write("t.csv", "1,3");
        assert_eq!(settled(&in_force), None, "back again");
        write("large.csv", &large("22"));
        assert_eq!(
            settled(&in_force).map(|(_, files)| files.into_keys().collect()),
            Some(vec![PathBuf::from("large.csv")])
        );
    }
}
