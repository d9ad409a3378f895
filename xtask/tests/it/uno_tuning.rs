//! Checks that the host's copy of the Uno's tuning numbers is what the firmware has.

use crate::names::root;
use std::collections::BTreeMap;
use std::fs;

const COPY: &str = "crates/motion/src/boards/uno_tuning.rs";
const FIRMWARE: &str = "firmware/uno/src/engine/tuning.rs";

#[test]
fn the_host_plans_with_the_numbers_of_the_firmware() {
    let [copy, firmware] = [COPY, FIRMWARE].map(|path| fs::read_to_string(root().join(path)).expect("a source file"));
    let (copy, firmware) = (constants(&copy), constants(&firmware));
    assert!(copy.len() >= 8, "{COPY} is read wrongly: {copy:?}");
    let different: Vec<String> = copy
        .iter()
        .filter(|(name, values)| firmware.get(*name) != Some(values))
        .map(|(name, values)| format!("{name}: {values:?}, but {:?}", firmware.get(name)))
        .collect();
    assert!(different.is_empty(), "{COPY} and {FIRMWARE} differ:\n{}", different.join("\n"));
}

/// The constants of a source, each with the text of its values: several where several modules have one of that name.
fn constants(source: &str) -> BTreeMap<String, Vec<String>> {
    let mut found: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for line in source.lines() {
        let Some((_, definition)) = line.split_once(" const ") else { continue };
        let (Some((name, rest)), false) = (definition.split_once(':'), definition.starts_with('_')) else { continue };
        let Some((_, value)) = rest.split_once(" = ") else { continue };
        found.entry(name.to_owned()).or_default().push(value.replace(['_', ';'], ""));
    }
    found
}

#[test]
fn constants_are_read_with_their_values() {
    let found = constants(
        "    pub(crate) const A: [u8; 2] = [60, 1_076];\n    const _: () = assert!(1 == 1);\n/// A const B.\n",
    );
    assert_eq!(found, BTreeMap::from([("A".to_owned(), vec!["[60, 1076]".to_owned()])]));
}
