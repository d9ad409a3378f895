//! Checks that documents point at existing things: every relative link, every line of code that a link names, every
//! path in back quotes.
//!
//! A link such as [`Channel::peek`](../crates/core/src/channel.rs#L149) says that this line contains the last
//! identifier of its text. With `UPDATE_EXPECT=1` this test writes the line of that identifier's definition into the
//! link. It also finds a file that has moved, if no other file has its name.

use std::fmt::Write as _;
use std::path::{Component, Path, PathBuf};

/// Endings of paths in back quotes. Other words in back quotes are commands, or files that programs write.
const ENDINGS: [&str; 16] =
    ["rs", "md", "toml", "txt", "s", "ld", "h", "py", "hex", "uf2", "sym", "svg", "png", "csv", "rules", "yml"];
/// Folders of the repository. A path in back quotes that begins with one of them must exist, whatever its ending.
const FOLDERS: [&str; 8] = ["crates", "docs", "examples", "firmware", "fuzz", "python", "testdata", "xtask"];
/// Folders that are no part of the repository.
const NOT_OURS: [&str; 5] = [".git", "target", "out", "corpus", "artifacts"];

#[test]
fn what_documents_point_at_exists() {
    let root = root();
    let files = all_files(&root);
    let update = std::env::var_os("UPDATE_EXPECT").is_some();
    let mut wrong = String::new();
    for document in documents(&files) {
        let text = std::fs::read_to_string(root.join(document)).expect("a document");
        let references = Checker { root: &root, files: &files, document }.check(&text);
        let mut updated = text.clone();
        // From the last to the first, so that earlier places stay valid.
        for reference in references.iter().rev() {
            match &reference.instead {
                Some(instead) if update => updated.replace_range(reference.from..reference.to, instead),
                _ => {
                    let line = text[..reference.from].lines().count().max(1);
                    let _ = writeln!(wrong, "{}:{line}: {}", document.display(), reference.problem);
                }
            }
        }
        if updated != text {
            std::fs::write(root.join(document), updated).expect("the document can be written");
        }
    }
    assert!(wrong.is_empty(), "UPDATE_EXPECT=1 mends lines and moved files:\n{wrong}");
}

/// Checks the check itself: what it must find, and what it must not.
#[test]
fn the_check_finds_what_it_should() {
    let root = root();
    let files = all_files(&root);
    let check = |text: &str| -> Vec<String> {
        let checker = Checker { root: &root, files: &files, document: Path::new("docs/tour.md") };
        checker.check(text).into_iter().map(|reference| reference.problem).collect()
    };
    let this = "../xtask/tests/it/tour.rs";
    let line = 1 + std::fs::read_to_string(root.join("xtask/tests/it/tour.rs"))
        .expect("this file")
        .lines()
        .position(|line| line.starts_with("fn documents("))
        .expect("it has that function");
    let none: Vec<String> = Vec::new();
    assert_eq!(
        check(&format!("[`documents`]({this}#L{line}), [a word]({this}) and `xtask/tests/it/tour.rs`, `it/tour.rs`")),
        none
    );
    assert_eq!(
        check("[other](https://example.org/a.rs#L1) `out/a/steps.csv` `cargo run -- crates/x.rs` `a/b.rs{1}`"),
        none
    );
    assert_eq!(check("```\n[a](b.rs)\n```\n\n    [a](b.rs)\n    [a](b.rs)\n"), none);
    assert_eq!(
        check(&format!("[`documents`]({this}#L1)")),
        [format!("{this}#L1 has no `documents`: it is in line {line}")]
    );
    let nobodys = ["nobody", "has", "this"].join("_");
    assert_eq!(check(&format!("[`{nobodys}`]({this}#L1)")), [format!("{this}#L1 has no `{nobodys}`")]);
    assert_eq!(check("[a](nowhere.md)"), ["nowhere.md is not there"]);
    assert_eq!(check("[a](../README.md#no-such-heading)"), ["../README.md has no heading #no-such-heading"]);
    assert_eq!(
        check("see `crates/nowhere.rs`, `docs/nothing`"),
        ["`crates/nowhere.rs` is not there", "`docs/nothing` is not there"]
    );
    assert_eq!(check("[a](../docs/it/tour.rs)"), ["../docs/it/tour.rs is not there: ../xtask/tests/it/tour.rs is"]);
}

/// A reference of a document that is wrong.
struct Wrong {
    /// The bytes of the reference in the document.
    from: usize,
    to: usize,
    problem: String,
    /// The right reference, if it is known.
    instead: Option<String>,
}

struct Checker<'a> {
    root: &'a Path,
    files: &'a [PathBuf],
    document: &'a Path,
}

impl Checker<'_> {
    fn check(&self, text: &str) -> Vec<Wrong> {
        let mut wrong = Vec::new();
        let (mut at, mut is_fenced, mut before_is_empty, mut was_indented) = (0, false, true, false);
        for line in text.split_inclusive('\n') {
            let is_fence = line.trim_start().starts_with("```");
            // Four blanks after an empty line begin code.
            let is_indented = line.starts_with("    ") && (before_is_empty || was_indented);
            if !is_fence && !is_fenced && !is_indented {
                wrong.extend(links(line).filter_map(|link| self.check_link(&link, at)));
                wrong.extend(quoted(line).filter_map(|(from, path)| self.check_path(path, at + from)));
            }
            is_fenced ^= is_fence;
            (before_is_empty, was_indented) = (line.trim().is_empty(), is_indented);
            at += line.len();
        }
        wrong.sort_by_key(|wrong| wrong.from);
        wrong
    }

    fn check_link(&self, link: &Link<'_>, at: usize) -> Option<Wrong> {
        let target = link.target;
        if target.contains("://") || target.starts_with("mailto:") {
            return None;
        }
        let (path, place) = target.split_once('#').map_or((target, None), |(path, place)| (path, Some(place)));
        let (from, to) = (at + link.from, at + link.from + target.len());
        let wrong = |problem, instead| Some(Wrong { from, to, problem, instead });
        let folder = self.document.parent().unwrap_or(Path::new(""));
        let line = place.and_then(|place| place.strip_prefix('L')).and_then(|number| number.parse::<usize>().ok());
        let ident = line.and_then(|_| last_identifier(link.text));
        let file = if path.is_empty() { self.document.to_path_buf() } else { normal(&folder.join(path)) };
        if !self.root.join(&file).exists() {
            let moved = self.moved(&file, ident);
            let instead = moved.as_ref().map(|moved| relative(folder, moved));
            let hint = instead.as_ref().map_or(String::new(), |path| format!(": {path} is"));
            let with_line = instead.map(|path| match (ident, moved) {
                (Some(ident), Some(moved)) => {
                    let line = self.defined(&moved, link.text, ident, line.unwrap_or(0)).unwrap_or(1);
                    format!("{path}#L{line}")
                }
                _ => place.map_or(path.clone(), |place| format!("{path}#{place}")),
            });
            return wrong(format!("{path} is not there{hint}"), with_line);
        }
        if let Some(line) = line {
            let Some(ident) = ident else { return wrong(format!("{target} says no name in its text"), None) };
            let source = std::fs::read_to_string(self.root.join(&file)).unwrap_or_default();
            if source.lines().nth(line - 1).is_some_and(|line| has_word(line, ident) && !only_mentions(line)) {
                return None;
            }
            return match self.defined(&file, link.text, ident, line) {
                Some(right) => {
                    wrong(format!("{target} has no `{ident}`: it is in line {right}"), Some(format!("{path}#L{right}")))
                }
                None => wrong(format!("{target} has no `{ident}`"), None),
            };
        }
        if let Some(heading) = place
            && file.extension().is_some_and(|ending| ending == "md")
        {
            let source = std::fs::read_to_string(self.root.join(&file)).unwrap_or_default();
            if !source.lines().filter(|line| line.starts_with('#')).any(|line| anchor(line) == heading) {
                return wrong(format!("{path} has no heading #{heading}"), None);
            }
        }
        None
    }

    fn check_path(&self, path: &str, from: usize) -> Option<Wrong> {
        let plain = path.trim_end_matches('/');
        let is_ours = path.contains('/')
            && path.chars().all(|c| c.is_ascii_alphanumeric() || "/._-".contains(c))
            && !path.starts_with(['/', '.'])
            && !plain.split('/').any(|part| NOT_OURS.contains(&part));
        let ending = plain.rsplit_once('.').map_or("", |(_, ending)| ending);
        let folder = plain.split('/').next().unwrap_or_default();
        if !is_ours || !(ENDINGS.contains(&ending) || FOLDERS.contains(&folder)) {
            return None;
        }
        let here = self.document.parent().unwrap_or(Path::new(""));
        let exists = self.root.join(plain).exists()
            || self.root.join(here).join(plain).exists()
            || self.files.iter().any(|file| file.ends_with(plain));
        if exists {
            return None;
        }
        let instead = self.moved(Path::new(plain), None).map(|moved| slashes(&moved));
        let hint = instead.as_ref().map_or(String::new(), |path| format!(": `{path}` is"));
        let problem = format!("`{path}` is not there{hint}");
        Some(Wrong { from, to: from + path.len(), problem, instead })
    }

    /// The only file of that name, or the only one most similar to `path`. With `ident`, only files that define it
    /// count.
    fn moved(&self, path: &Path, ident: Option<&str>) -> Option<PathBuf> {
        let name = path.file_name()?;
        let named = self.files.iter().filter(|file| file.file_name() == Some(name));
        let defines = |file: &&PathBuf| ident.is_none_or(|ident| self.defined(file, ident, ident, 0).is_some());
        let common =
            |file: &Path| path.components().filter(|part| file.components().any(|other| other == *part)).count();
        let candidates: Vec<&PathBuf> = named.filter(defines).collect();
        let most = candidates.iter().map(|file| common(file)).max()?;
        let mut best = candidates.iter().filter(|file| common(file) == most);
        match (best.next(), best.next()) {
            (Some(only), None) => Some((*only).clone()),
            _ => None,
        }
    }

    /// The line in which `file` defines `ident`. Of several, the one within what `text` names before it (`Channel` in
    /// `Channel::peek`), or the one nearest to `line`.
    fn defined(&self, file: &Path, text: &str, ident: &str, line: usize) -> Option<usize> {
        let source = std::fs::read_to_string(self.root.join(file)).ok()?;
        let owner = text.trim_matches('`').rsplit_once("::").and_then(|(owner, _)| last_identifier(owner));
        let mut implemented = "";
        let mut found = Vec::new();
        for (number, code) in source.lines().enumerate() {
            if code.starts_with("impl") || code.starts_with("pub trait") || code.starts_with("pub enum") {
                implemented = code;
            }
            if let Some(rank) = defines(code, ident) {
                let is_owners = owner.is_some_and(|owner| has_word(implemented, owner));
                found.push((!is_owners, rank, (number + 1).abs_diff(line), number + 1));
            }
        }
        found.into_iter().min().map(|(.., number)| number)
    }
}

/// How well a line of code defines `ident`: 0 is best.
fn defines(code: &str, ident: &str) -> Option<u8> {
    let code = code.trim_start();
    if !has_word(code, ident) || only_mentions(code) {
        return None;
    }
    const KEYWORDS: [&str; 10] =
        ["fn", "struct", "enum", "trait", "const", "static", "mod", "type", "macro_rules!", ".macro"];
    let words: Vec<&str> = code.split([' ', '<', '(', ':', ';', '{', ',']).filter(|word| !word.is_empty()).collect();
    if words.windows(2).any(|pair| KEYWORDS.contains(&pair[0]) && pair[1] == ident) {
        // Rust only declares what assembly defines: the label is better.
        return Some(if code.contains("fn ") && code.ends_with(';') { 2 } else { 0 });
    }
    let rest = code.strip_prefix(ident);
    // A label, a field or a variant; or a line of a table of names.
    if rest.is_some_and(|rest| rest.starts_with([':', ',', '(', ' ']) && !rest.starts_with("::")) {
        return Some(1);
    }
    Some(3)
}

/// Whether a line of code defines nothing: a comment, or an assembler's directive about a name.
fn only_mentions(code: &str) -> bool {
    const MENTIONS: [&str; 5] = ["//", ".global", ".section", ".type", ".size"];
    MENTIONS.iter().any(|begin| code.trim_start().starts_with(begin))
}

struct Link<'a> {
    text: &'a str,
    target: &'a str,
    /// Where the target begins in its line.
    from: usize,
}

/// `[text](target)` in one line.
fn links(line: &str) -> impl Iterator<Item = Link<'_>> {
    line.match_indices("](").filter_map(move |(middle, _)| {
        let from = middle + 2;
        let to = from + line[from..].find(')')?;
        // The bracket that opened the text: a text may have brackets of its own in back quotes.
        let mut depth = 0;
        let begin = line[..middle].char_indices().rev().find(|(_, c)| {
            depth += match c {
                ']' => 1,
                '[' => -1,
                _ => 0,
            };
            depth < 0
        });
        let (begin, _) = begin?;
        Some(Link { text: &line[begin + 1..middle], target: &line[from..to], from })
    })
}

/// The texts in single back quotes in one line, with their places.
fn quoted(line: &str) -> impl Iterator<Item = (usize, &str)> {
    let quotes: Vec<usize> = line.match_indices('`').map(|(at, _)| at).collect();
    let pairs: Vec<(usize, usize)> = quotes.chunks_exact(2).map(|pair| (pair[0] + 1, pair[1])).collect();
    pairs.into_iter().map(move |(from, to)| (from, &line[from..to]))
}

fn last_identifier(text: &str) -> Option<&str> {
    text.rsplit(|c: char| !c.is_ascii_alphanumeric() && c != '_').find(|word| !word.is_empty())
}

fn has_word(line: &str, word: &str) -> bool {
    let is_part = |c: Option<char>| c.is_some_and(|c| c.is_ascii_alphanumeric() || c == '_');
    line.match_indices(word)
        .any(|(at, _)| !is_part(line[..at].chars().next_back()) && !is_part(line[at + word.len()..].chars().next()))
}

/// The anchor that GitHub gives a heading.
fn anchor(heading: &str) -> String {
    let text = heading.trim_start_matches('#').trim().to_lowercase();
    let kept = text.chars().filter(|c| c.is_alphanumeric() || " -_".contains(*c));
    kept.map(|c| if c == ' ' { '-' } else { c }).collect()
}

/// `path` without `..`.
fn normal(path: &Path) -> PathBuf {
    path.components().fold(PathBuf::new(), |mut normal, part| {
        if part == Component::ParentDir {
            normal.pop();
        } else {
            normal.push(part);
        }
        normal
    })
}

/// The relative path from a folder to a file, both in the repository.
fn relative(folder: &Path, file: &Path) -> String {
    let common = folder.components().zip(file.components()).take_while(|(one, other)| one == other).count();
    let up = "../".repeat(folder.components().count() - common);
    let down: PathBuf = file.components().skip(common).collect();
    up + &slashes(&down)
}

fn slashes(path: &Path) -> String {
    path.to_string_lossy().replace('\\', "/")
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// The documents: those of the root, and all in `docs`.
fn documents(files: &[PathBuf]) -> impl Iterator<Item = &Path> {
    let is_document = |file: &&PathBuf| {
        file.extension().is_some_and(|ending| ending == "md")
            && (file.starts_with("docs") || file.components().count() == 1)
    };
    files.iter().filter(is_document).map(PathBuf::as_path)
}

/// All files of the repository, from its root.
fn all_files(root: &Path) -> Vec<PathBuf> {
    let (mut files, mut folders) = (Vec::new(), vec![PathBuf::new()]);
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(root.join(&folder)).expect("a folder of the repository") {
            let name = entry.expect("a folder entry").file_name();
            let path = folder.join(&name);
            if NOT_OURS.iter().any(|other| name == *other) {
                continue;
            }
            if root.join(&path).is_dir() {
                folders.push(path);
            } else {
                files.push(path);
            }
        }
    }
    files.sort();
    files
}
