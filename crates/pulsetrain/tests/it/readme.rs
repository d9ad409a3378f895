//! Runs every command of README.md and docs/commands.md, and compares its output with the page.
//!
//! In fenced blocks, lines that begin with `$ ` are commands and the lines after them their output: `[..]` stands for
//! any text within a line, `...` for any lines, and `? 2` says that the command exits with 2 instead of 0. A command
//! without lines after it must only succeed. All run in one folder, in order, with the examples in it.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

const README: &str = include_str!("../../../../README.md");
const COMMANDS: &str = include_str!("../../../../docs/commands.md");
/// Beginnings of this program's commands. Others (git, rustup, xtask) are not run here.
const OURS: [&str; 2] = ["pulsetrain ", "cargo run --release -- "];

#[derive(Debug, Default)]
struct Shown<'a> {
    /// The command without the `$ `.
    command: &'a str,
    exit_code: i32,
    output: Vec<&'a str>,
}

/// The motion files that the README shows can be planned.
#[test]
fn the_readme_shows_motion_files_that_work() {
    let folder = folder_with_examples("readme-files");
    let blocks: Vec<_> = README.split("```toml\n").skip(1).filter_map(|rest| rest.split("```").next()).collect();
    assert!(!blocks.is_empty(), "the README shows no motion file");
    for text in blocks {
        let file = folder.join("shown.toml");
        fs::write(&file, text).expect("a file to write");
        let ran = Command::new(env!("CARGO_BIN_EXE_pulsetrain")).arg("plan").arg(&file).output().expect("it runs");
        assert!(ran.status.success(), "{text}\n{}", String::from_utf8_lossy(&ran.stderr));
    }
    fs::remove_dir_all(folder).expect("the folder can go");
}

/// The commands of all fenced blocks.
fn commands(text: &str) -> Vec<Shown<'_>> {
    let mut commands: Vec<Shown> = Vec::new();
    let (mut in_block, mut in_output) = (false, false);
    for line in text.lines() {
        if line.starts_with("```") {
            (in_block, in_output) = (!in_block, false);
        } else if let (true, Some(command)) = (in_block, line.strip_prefix("$ ")) {
            commands.push(Shown { command, ..Shown::default() });
            in_output = true;
        } else if let (true, Some(last)) = (in_output, commands.last_mut()) {
            match line.strip_prefix("? ").map(str::parse) {
                Some(Ok(exit_code)) => last.exit_code = exit_code,
                _ => last.output.push(line.trim_end()),
            }
        }
    }
    commands
}

fn lines_match(shown: &[&str], printed: &[&str]) -> bool {
    match (shown, printed) {
        ([], []) => true,
        (["...", shown @ ..], _) => (0..=printed.len()).any(|skipped| lines_match(shown, &printed[skipped..])),
        ([line, shown @ ..], [found, printed @ ..]) => line_matches(line, found) && lines_match(shown, printed),
        _ => false,
    }
}

fn line_matches(shown: &str, printed: &str) -> bool {
    match shown.split_once("[..]") {
        None => shown == printed,
        Some((start, rest)) => printed.strip_prefix(start).is_some_and(|printed| {
            let mut ends = printed.char_indices().map(|(at, _)| at).chain([printed.len()]);
            ends.any(|at| line_matches(rest, &printed[at..]))
        }),
    }
}

/// Splits a command into words as a shell does. Of the quotes only `"` is known.
pub(super) fn words(arguments: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    for (index, part) in arguments.split('"').enumerate() {
        let quoted = index % 2 == 1;
        for (index, word) in part.split(|c: char| c == ' ' && !quoted).enumerate() {
            if index > 0 {
                words.push(String::new());
            }
            words.last_mut().expect("one word at least").push_str(word);
        }
    }
    words.retain(|word| !word.is_empty());
    words
}

/// A folder of its own, with `examples/` in it.
pub(super) fn folder_with_examples(name: &str) -> PathBuf {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
    // A run before may have left files.
    let _ = fs::remove_dir_all(&folder);
    let examples = folder.join("examples");
    fs::create_dir_all(&examples).expect("a folder for the examples");
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples");
    for entry in fs::read_dir(source).expect("the repository has examples") {
        let file = entry.expect("a folder entry").path();
        let name = file.file_name().expect("a name");
        fs::copy(&file, examples.join(name)).expect("a copy");
    }
    folder
}

#[test]
fn commands_are_found_with_their_output() {
    let text = "$ not this\n```console\n$ a b\none\n$ c\n? 2\n```\ntext\n```sh\n$ d\n```\n";
    let found: Vec<_> = commands(text).into_iter().map(|s| (s.command, s.exit_code, s.output)).collect();
    assert_eq!(found, [("a b", 0, vec!["one"]), ("c", 2, vec![]), ("d", 0, vec![])]);
}

#[test]
fn output_is_compared_line_by_line() {
    fn check(shown: &[&str], printed: &[&str], expected: bool) {
        assert_eq!(lines_match(shown, printed), expected, "{shown:?} {printed:?}");
    }
    check(&["a", "b"], &["a", "b"], true);
    check(&["a", "b"], &["a"], false);
    check(&["a"], &["a", "b"], false);
    check(&["a", "...", "d"], &["a", "b", "c", "d"], true);
    check(&["a", "...", "d"], &["a", "b", "c"], false);
    check(&["took [..] ms, 8 steps"], &["took 3.5 ms, 8 steps"], true);
    check(&["took [..] ms, 8 steps"], &["took 3.5 ms, 9 steps"], false);
}

#[test]
fn words_keep_what_is_quoted() {
    assert_eq!(words(r#"run a.toml --for "60 s" --out x"#), ["run", "a.toml", "--for", "60 s", "--out", "x"]);
}

/// Tests that run firmware on an emulated chip.
mod chips {
    use super::*;

    #[test]
    fn the_readme_shows_what_happens() {
        check("readme-commands", README);
    }

    #[test]
    fn the_page_of_commands_shows_what_happens() {
        check("page-commands", COMMANDS);
    }

    fn check(name: &str, page: &str) {
        let folder = folder_with_examples(name);
        let shown = commands(page);
        assert!(!shown.is_empty(), "{name}: the page shows no command");
        for Shown { command, exit_code, output } in shown {
            let Some(arguments) = OURS.iter().find_map(|ours| command.strip_prefix(ours)) else { continue };
            let ran = Command::new(env!("CARGO_BIN_EXE_pulsetrain"))
                .args(words(arguments))
                .current_dir(&folder)
                .output()
                .unwrap_or_else(|error| panic!("{command}: {error}"));
            let printed = String::from_utf8_lossy(&ran.stdout) + String::from_utf8_lossy(&ran.stderr);
            assert_eq!(ran.status.code(), Some(exit_code), "`{command}` prints:\n{printed}");
            let lines: Vec<_> = printed.lines().map(str::trim_end).collect();
            assert!(
                output.is_empty() || lines_match(&output, &lines),
                "`{command}` prints, other than the page shows:\n{printed}"
            );
        }
        fs::remove_dir_all(folder).expect("the folder can go");
    }
}
