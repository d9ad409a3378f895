//! Which module of the Uno's firmware takes how many bytes of an image's flash, by the image's symbols.

use std::collections::BTreeMap;

/// Bytes by module.
pub(super) type Bytes = BTreeMap<String, u64>;

/// Bytes of each module, from what `avr-nm -n` says of an image. `sources`: the modules of assembly with their texts. A symbol reaches to the next one.
pub(super) fn by_module(said: &str, sources: &[(String, String)]) -> Bytes {
    let symbols: Vec<(u64, &str)> = said.lines().filter_map(symbol).collect();
    let (mut bytes, mut last) = (Bytes::new(), "start-up".to_owned());
    for pair in symbols.windows(2) {
        let [(from, name), (to, _)] = pair else { continue };
        if let Some(module) = rust_module(name).or_else(|| assembly_module(name, sources)) {
            last = module;
        }
        *bytes.entry(last.clone()).or_default() += to - from;
    }
    bytes
}

/// Address and name of a symbol in the flash, or of the end of the program.
fn symbol(line: &str) -> Option<(u64, &str)> {
    let mut fields = line.split_whitespace();
    let (address, kind, name) = (fields.next()?, fields.next()?, fields.next()?);
    let address = u64::from_str_radix(address, 16).ok()?;
    let is_code = matches!(kind, "t" | "T" | "W") || name == "__data_load_start";
    (is_code && address < 0x8000).then_some((address, name))
}

/// The module of a function of Rust: its name has those of its modules, each after its length (RFC 2603).
fn rust_module(name: &str) -> Option<String> {
    let name = name.strip_prefix("_R")?;
    let (mut words, mut rest) = (Vec::new(), name);
    while let Some(at) = rest.find(|letter: char| letter.is_ascii_digit()) {
        let digits = rest[at..].len() - rest[at..].trim_start_matches(|letter: char| letter.is_ascii_digit()).len();
        let tail = rest[at + digits..].trim_start_matches('_');
        let word = rest[at..at + digits].parse().ok().and_then(|len: usize| tail.get(..len));
        match word.filter(|word| word.starts_with(|letter: char| letter.is_ascii_lowercase()) && is_word(word)) {
            Some(word) => {
                words.push(word);
                rest = &tail[word.len()..];
            }
            None => rest = &rest[at + digits..],
        }
    }
    let at =
        words.iter().position(|word| *word == "engine" || *word == "pulsetrain_core" || word.starts_with("uno"))?;
    let is_core = words[at] == "pulsetrain_core";
    let path: Vec<_> = words[at..].iter().skip(1).filter(|word| **word != "engine").collect();
    // At most two words: what follows are functions.
    let depth = path.len().min(if is_core || path.first() == Some(&&"steps") { 2 } else { 1 });
    let path: Vec<_> = path[..depth].iter().map(|word| **word).collect();
    Some(format!("{}{}, Rust", if is_core { "core " } else { "" }, path.join("/")))
}

fn is_word(text: &str) -> bool {
    text.chars().all(|letter| letter.is_ascii_alphanumeric() || letter == '_')
}

/// The module that has the label, or that makes it by a macro: its name is the macro's first argument.
fn assembly_module(name: &str, sources: &[(String, String)]) -> Option<String> {
    let has = |text: &str, is_it: &dyn Fn(&str) -> bool| text.lines().any(|line| is_it(line.trim()));
    let label = format!("{name}:");
    let is_label = |line: &str| line.starts_with(&label);
    let is_argument = |line: &str| {
        let mut words = line.split_whitespace();
        let (first, second) = (words.next().unwrap_or(""), words.next().unwrap_or(""));
        // Instructions have no underscore, and calls go to other modules.
        second.trim_end_matches(',') == name && (first.contains('_') || first == "expander")
    };
    let find = |is_it: &dyn Fn(&str) -> bool| sources.iter().find(|(_, text)| has(text, is_it));
    find(&is_label).or_else(|| find(&is_argument)).map(|(module, _)| module.clone())
}

/// A table of images, side by side.
pub(super) fn table(images: &[(&str, Bytes)]) -> String {
    let mut text = format!("{:32}", "bytes of");
    for (name, _) in images {
        text.push_str(&format!(" {name:>10}"));
    }
    text.push('\n');
    let modules: std::collections::BTreeSet<_> = images.iter().flat_map(|(_, bytes)| bytes.keys()).collect();
    let total = "all".to_owned();
    for module in modules.into_iter().chain([&total]) {
        text.push_str(&format!("{module:32}"));
        for (_, bytes) in images {
            let taken = if *module == total { bytes.values().sum() } else { bytes.get(module).copied().unwrap_or(0) };
            text.push_str(&format!(" {taken:>10}"));
        }
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_symbols_bytes_are_its_modules() {
        let said = "00000000 T __vectors\n00000010 t _RNvMs_NtNtNtCs1a_3uno6engine5steps4ringNtB4_4Ring5clear\n\
                    00000030 t _RNvNtNtCs1b_15pulsetrain_core4wire5frame5check\n00000034 T ring_b\n00000036 t ring_c\n\
                    0000003a t made_by\n00000040 W __data_load_start\n00800100 B steps_times\n";
        let sources = [
            ("steps/ring.rs", "    call made_by\nring_b:\n  ret\nring_c: ret\n"),
            ("steps/made.rs", "    expander made_by, 1\n"),
        ];
        let sources = sources.map(|(module, text)| (module.to_owned(), text.to_owned()));
        let bytes = by_module(said, &sources);
        let expected = [
            ("core wire/frame, Rust", 4),
            ("start-up", 16),
            ("steps/made.rs", 6),
            ("steps/ring, Rust", 32),
            ("steps/ring.rs", 6),
        ];
        assert_eq!(bytes, expected.map(|(module, bytes)| (module.to_owned(), bytes)).into());
        let table = table(&[("uno", bytes)]);
        assert!(table.ends_with("all                                      64\n"), "{table}");
    }
}
