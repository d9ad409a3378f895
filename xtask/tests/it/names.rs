//! Checks that a type's name has one meaning in its crate, and that names are words that an engineer of another project
//! would know.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Words that only this project's first authors used. They are forbidden as names.
const HOUSE_WORDS: [&str; 27] = [
    "surely",
    "Sure",
    "gentle",
    "blind",
    "beside",
    "apiece",
    "give",
    "ROOM",
    "HURRY",
    "SOME",
    "LEAST",
    "Shadowed",
    "portion",
    "Fared",
    "fared",
    "Wish",
    "Word",
    "Said",
    "Told",
    "Whereabouts",
    "forsake",
    "disown",
    "anew",
    "Moment",
    "Course",
    "take_up",
    "narrow",
];

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
        names.into_iter().filter(|name| HOUSE_WORDS.contains(&name.as_str())).map(move |name| (file.clone(), name))
    });
    let found: Vec<String> = found.map(|(file, name)| format!("{name} in {}", file.display())).collect();
    assert!(found.is_empty(), "words that a stranger has to look up:\n{}", found.join("\n"));
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
        (!name.is_empty()).then_some(name)
    });
    names.collect()
}
