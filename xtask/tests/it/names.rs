//! Checks that a type's name has one meaning in its crate, and that names are words that an engineer of another project
//! would know.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Words that only this project's first authors used. No name may be one of them or have one of them as a part, in whatever case.
const HOUSE_WORDS: [&str; 18] = [
    "surely",
    "sure",
    "gentle",
    "blind",
    "beside",
    "apiece",
    "give",
    "hurry",
    "shadowed",
    "portion",
    "fared",
    "wish",
    "told",
    "untold",
    "whereabouts",
    "forsake",
    "disown",
    "anew",
];

/// More of them, which are words of the field elsewhere: `has_room`, `least_squares`, the 32-bit words of a processor. They are forbidden as
/// a part of a name in this case only.
const HOUSE_PARTS: [&str; 6] = ["ROOM", "HURRY", "SOME", "LEAST", "Moment", "Course"];

/// And those that are forbidden as a whole name only.
const HOUSE_NAMES: [&str; 4] = ["Word", "Said", "take_up", "narrow"];

/// Keywords that a definition begins with.
const TYPES: [&str; 5] = ["struct", "enum", "trait", "type", "union"];
const OTHERS: [&str; 5] = ["fn", "mod", "const", "static", "let"];

#[test]
fn a_type_name_has_one_meaning_in_its_crate() {
    let mut twice = Vec::new();
    for folder in crates() {
        let mut known: BTreeMap<(String, String), PathBuf> = BTreeMap::new();
        for file in sources(&folder) {
            for name in definitions(&file, &TYPES) {
                if let Some(other) = known.insert((part(&folder, &file), name.clone()), file.clone()) {
                    twice.push(format!("{name}: {} and {}", other.display(), file.display()));
                }
            }
        }
    }
    assert!(twice.is_empty(), "one name, two meanings:\n{}", twice.join("\n"));
}

#[test]
fn no_name_is_a_house_word() {
    let keywords: Vec<&str> = TYPES.into_iter().chain(OTHERS).collect();
    let files: Vec<PathBuf> = crates().iter().flat_map(|folder| sources(folder)).collect();
    let found = files.into_iter().flat_map(|file| {
        let names = definitions(&file, &keywords);
        names.into_iter().filter(|name| is_house_word(name)).map(move |name| (file.clone(), name))
    });
    let found: Vec<String> = found.map(|(file, name)| format!("{name} in {}", file.display())).collect();
    assert!(found.is_empty(), "words that a stranger has to look up:\n{}", found.join("\n"));
}

#[test]
fn house_words_are_found_inside_longer_names() {
    for name in ["give", "MAX_UNTOLD", "FLASH_ROOM", "GentleStop", "is_told", "narrow", "LEASTHeard", "orders_to_give"]
    {
        assert!(is_house_word(name), "{name}");
    }
    for name in ["has_room", "PioWord", "least_squares", "given", "sometimes", "clock_moment", "RoomFor", "narrow_to"] {
        assert!(!is_house_word(name), "{name}");
    }
}

/// Whether a name is a house word, or has one as a part.
fn is_house_word(name: &str) -> bool {
    let is_one = |part: &str| HOUSE_PARTS.contains(&part) || HOUSE_WORDS.contains(&part.to_lowercase().as_str());
    HOUSE_NAMES.contains(&name) || parts(name).iter().any(|part| is_one(part))
}

/// The words of a name: it is split at `_`, and before a capital that begins a word.
fn parts(name: &str) -> Vec<String> {
    let mut found = vec![String::new()];
    let letters: Vec<char> = name.chars().collect();
    for (at, letter) in letters.iter().enumerate() {
        let follows_small = at > 0 && letters[at - 1].is_lowercase();
        let before_small = letters.get(at + 1).is_some_and(|next| next.is_lowercase());
        if *letter == '_' || (letter.is_uppercase() && (follows_small || before_small)) {
            found.push(String::new());
        }
        if *letter != '_' {
            found.last_mut().expect("it is never empty").push(*letter);
        }
    }
    found
}

/// A type's name has one meaning within such a part: a crate, a chip of the emulator, or a program of the Uno's
/// firmware.
fn part(folder: &Path, file: &Path) -> String {
    let inside = file.strip_prefix(folder.join("src")).unwrap_or(file);
    let parts: Vec<String> = inside.iter().map(|part| part.to_string_lossy().into_owned()).collect();
    match (folder.file_name().and_then(|name| name.to_str()), parts.as_slice()) {
        (Some("emulator"), [chip, ..]) => chip.clone(),
        (Some("uno"), [bin, program, ..]) if bin == "bin" => program.clone(),
        _ => String::new(),
    }
}

pub(crate) fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the repository").to_owned()
}

/// The folders of all crates of the repository.
fn crates() -> Vec<PathBuf> {
    let root = root();
    let inside =
        fs::read_dir(root.join("crates")).expect("there are crates").map(|entry| entry.expect("a folder").path());
    let mut all: Vec<PathBuf> = inside.collect();
    all.extend(["firmware/uno", "firmware/pico", "xtask"].map(|name| root.join(name)));
    all
}

/// All Rust files of a crate's source.
fn sources(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut open = vec![folder.join("src")];
    while let Some(next) = open.pop() {
        for entry in fs::read_dir(next).expect("a folder").map(|entry| entry.expect("an entry").path()) {
            if entry.is_dir() {
                open.push(entry);
            } else if entry.extension().is_some_and(|ending| ending == "rs") {
                found.push(entry);
            }
        }
    }
    found.sort();
    found
}

/// The names that a file defines with some keywords. Tests, associated types and the insides of functions are left out.
fn definitions(file: &Path, keywords: &[&str]) -> Vec<String> {
    let text = fs::read_to_string(file).expect("it is text");
    let before_tests = text.split("#[cfg(test)]\nmod tests").next().unwrap_or_default();
    let lines = before_tests.lines().filter(|line| !line.trim_start().starts_with("//"));
    let names = lines.filter_map(|line| {
        if line.starts_with("        ") || (line.starts_with("    ") && line.trim_start().starts_with("type ")) {
            return None;
        }
        let words: Vec<&str> = line.split_whitespace().filter(|word| *word != "mut" && *word != "unsafe").collect();
        let at = words.iter().take(4).position(|word| keywords.contains(word))?;
        let name: String = words.get(at + 1)?.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
        // `let Some(x)` is a pattern and defines no `Some`.
        let is_pattern = words[at] == "let" && name.starts_with(char::is_uppercase);
        (!name.is_empty() && !is_pattern).then_some(name)
    });
    names.collect()
}
