//! Drawings of the crates and of each crate's modules, with what they import, as Mermaid text, which GitHub draws.

use crate::command::{Done, Failure};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// The modules at the top of a crate, and those of the same crate that each imports.
pub(crate) type Modules = BTreeMap<String, BTreeSet<String>>;

/// Our crates, and those of ours that each imports.
type Crates = BTreeMap<String, BTreeSet<String>>;

/// The document that has the drawing of the crates, and the lines around the drawing.
const DOCUMENT: &str = "ARCHITECTURE.md";
const BEGIN: &str = "<!-- The drawing is written by `cargo xtask map`. -->\n";
const END: &str = "<!-- The drawing ends. -->\n";

/// Writes the drawing of the crates into ARCHITECTURE.md, and prints it, and a drawing of each crate's modules.
///
/// # Errors
/// A message, if the document cannot be read or written, or has no place for the drawing.
pub(crate) fn run(root: &Path) -> Done {
    let path = root.join(DOCUMENT);
    let text = fs::read_to_string(&path).map_err(|why| Failure::File { path: path.clone(), why })?;
    let renewed = with_drawing(&text, &draw_crates(root)).map_err(Failure::Check)?;
    if renewed != text {
        fs::write(&path, renewed).map_err(|why| Failure::File { path, why })?;
    }
    print(root);
    Ok(())
}

/// The document with this drawing in place of its own.
fn with_drawing(text: &str, drawing: &str) -> Result<String, String> {
    let (before, rest) = text.split_once(BEGIN).ok_or(format!("{DOCUMENT} has no line {BEGIN}"))?;
    let (_, after) = rest.split_once(END).ok_or(format!("{DOCUMENT} has no line {END}"))?;
    Ok(format!("{before}{BEGIN}{drawing}{END}{after}"))
}

/// A drawing of the crates. An arrow means that a crate imports another one; it is left out if a longer way of arrows leads there. A dotted
/// arrow is for tests and benches alone.
fn draw_crates(root: &Path) -> String {
    let (imports, in_tests) = imports(root);
    let mut drawing = "```mermaid\nflowchart TD\n".to_owned();
    for (name, known) in &imports {
        // Mermaid's names have no slash.
        let node = name.replace('/', "_");
        drawing.push_str(&format!("    {node}[\"{name}\"]\n"));
        let direct = known.iter().filter(|other| !known.iter().any(|via| reaches(&imports, via, other)));
        direct.for_each(|other| drawing.push_str(&format!("    {node} --> {other}\n")));
        let of_tests = in_tests.get(name).into_iter().flatten().filter(|other| !reaches(&imports, name, other));
        of_tests.for_each(|other| drawing.push_str(&format!("    {node} -.-> {other}\n")));
    }
    drawing.push_str("```\n");
    drawing
}

/// Whether a way of imports leads from one crate to another.
fn reaches(imports: &Crates, from: &str, to: &str) -> bool {
    imports.get(from).into_iter().flatten().any(|next| next == to || reaches(imports, next, to))
}

/// What the crates of the repository import of one another, by their manifests: for themselves, and for tests alone.
fn imports(root: &Path) -> (Crates, Crates) {
    let mut folders: Vec<PathBuf> =
        fs::read_dir(root.join("crates")).into_iter().flatten().flatten().map(|entry| entry.path()).collect();
    folders.extend(["firmware/uno", "firmware/pico"].map(|name| root.join(name)));
    let (mut normal, mut in_tests) = (Crates::new(), Crates::new());
    for folder in folders.into_iter().filter(|folder| folder.join("Cargo.toml").is_file()) {
        let name = folder.strip_prefix(root.join("crates")).or(folder.strip_prefix(root)).unwrap_or(&folder);
        let name = name.display().to_string();
        let manifest = fs::read_to_string(folder.join("Cargo.toml")).unwrap_or_default();
        let mut section = "";
        normal.entry(name.clone()).or_default();
        for line in manifest.lines() {
            let kind = match line.strip_prefix('[') {
                Some(heading) => {
                    section = heading.trim_end_matches(']');
                    continue;
                }
                None if section == "dependencies" => &mut normal,
                None if section == "dev-dependencies" => &mut in_tests,
                None => continue,
            };
            if let Some(other) = line.strip_prefix("pulsetrain-") {
                let other = other.chars().take_while(|c| c.is_alphanumeric()).collect();
                kind.entry(name.clone()).or_default().insert(other);
            }
        }
    }
    (normal, in_tests)
}

/// Prints a drawing of each crate's modules.
fn print(root: &Path) {
    for folder in crates(root) {
        let name = folder.strip_prefix(root).unwrap_or(&folder).display().to_string();
        println!("## {name}\n\n```mermaid\nflowchart TD");
        for (module, imports) in modules(&folder) {
            println!("    {module}");
            imports.iter().for_each(|import| println!("    {module} --> {import}"));
        }
        println!("```\n");
    }
}

/// The folders of all crates that have modules of their own.
pub(crate) fn crates(root: &Path) -> Vec<PathBuf> {
    let inside = fs::read_dir(root.join("crates")).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut all: Vec<PathBuf> = inside.filter(|path| path.join("src").is_dir()).collect();
    all.sort();
    all.extend(["firmware/pico", "xtask"].map(|name| root.join(name)));
    all
}

/// The modules of a crate and their imports, but for those of tests. A folder is one module: what its files import of one another is not drawn.
pub(crate) fn modules(folder: &Path) -> Modules {
    let source = folder.join("src");
    let mut files: Vec<PathBuf> = Vec::new();
    let mut open = vec![source.clone()];
    while let Some(next) = open.pop() {
        for path in fs::read_dir(next).into_iter().flatten().flatten().map(|entry| entry.path()) {
            if path.is_dir() {
                open.push(path);
            } else if path.extension().is_some_and(|ending| ending == "rs") {
                files.push(path);
            }
        }
    }
    let module_of = |file: &Path| {
        let inside = file.strip_prefix(&source).ok()?;
        let first = inside.iter().next()?.to_str()?.trim_end_matches(".rs").to_owned();
        (!matches!(first.as_str(), "lib" | "main" | "bin")).then_some(first)
    };
    let known: BTreeSet<String> = files.iter().filter_map(|file| module_of(file)).collect();
    let mut found: Modules = known.iter().map(|module| (module.clone(), BTreeSet::new())).collect();
    for file in &files {
        let Some(module) = module_of(file) else { continue };
        let text = fs::read_to_string(file).unwrap_or_default();
        let depth = file.strip_prefix(&source).map_or(0, |inside| inside.iter().count());
        // In a file of the first level, and in a folder's mod.rs, `super` is the crate.
        let is_top = depth == 1 || (depth == 2 && file.ends_with("mod.rs"));
        let imports = found.entry(module.clone()).or_default();
        for line in text.split("#[cfg(test)]\nmod tests").next().unwrap_or_default().lines() {
            let code = line.split("//").next().unwrap_or_default();
            let paths = code.match_indices("crate::").map(|(at, path)| &code[at + path.len()..]);
            let above = code.match_indices("super::").filter(|_| is_top).map(|(at, path)| &code[at + path.len()..]);
            for path in paths.chain(above) {
                imports.extend(first_names(path).filter(|name| known.contains(name) && *name != module));
            }
        }
    }
    found
}

/// The modules that a path begins with: one, or each in braces.
fn first_names(path: &str) -> impl Iterator<Item = String> + '_ {
    let inside = path.strip_prefix('{').map_or(path, |rest| rest.split('}').next().unwrap_or(rest));
    let is_list = path.starts_with('{');
    let parts = inside.split(',').take(if is_list { usize::MAX } else { 1 });
    parts.map(|part| part.trim().chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_circle_between_modules_of_a_crate() {
        // On the Pico the board configures the axes of its text, and a port forwards text to them: each knows the other.
        const KNOWN: [(&str, &str); 2] = [("board", "winch"), ("port_io", "winch")];
        let mut circles = Vec::new();
        for folder in crates(&crate::command::root()) {
            let mut modules = modules(&folder);
            for (from, to) in KNOWN {
                modules.entry(from.to_owned()).or_default().remove(to);
            }
            circles.extend(circle(&modules).map(|circle| format!("{}: {}", folder.display(), circle.join(" → "))));
        }
        assert!(circles.is_empty(), "modules that import one another in a circle:\n{}", circles.join("\n"));
    }

    #[test]
    fn the_drawing_of_the_crates_is_up_to_date() {
        let root = crate::command::root();
        let text = fs::read_to_string(root.join(DOCUMENT)).expect("a document");
        let drawing = draw_crates(&root);
        assert!(drawing.contains("    session --> plan\n") && !drawing.contains("session --> core"), "{drawing}");
        assert!(
            with_drawing(&text, &drawing).as_ref() == Ok(&text),
            "`cargo xtask map` draws {DOCUMENT}'s picture again"
        );
    }

    #[test]
    fn a_circle_is_found() {
        let arrow = |from: &str, to: &str| (from.to_owned(), BTreeSet::from([to.to_owned()]));
        let two = BTreeMap::from([arrow("a", "b"), arrow("b", "c"), arrow("c", "b")]);
        assert_eq!(circle(&two), Some(vec!["b".to_owned(), "c".to_owned(), "b".to_owned()]));
        assert_eq!(circle(&BTreeMap::from([arrow("a", "b"), arrow("b", "c")])), None);
    }

    /// The first circle that is found, from a module back to itself.
    fn circle(modules: &Modules) -> Option<Vec<String>> {
        fn walk(modules: &Modules, path: &mut Vec<String>, done: &mut BTreeSet<String>) -> Option<Vec<String>> {
            let last = path.last().cloned()?;
            for next in modules.get(&last).into_iter().flatten() {
                if let Some(at) = path.iter().position(|module| module == next) {
                    return Some(path[at..].iter().chain([next]).cloned().collect());
                }
                if !done.contains(next) {
                    path.push(next.clone());
                    if let Some(found) = walk(modules, path, done) {
                        return Some(found);
                    }
                    path.pop();
                }
            }
            done.insert(last);
            None
        }
        let mut done = BTreeSet::new();
        modules.keys().find_map(|module| walk(modules, &mut vec![module.clone()], &mut done))
    }
}
