//! The programs of the workspace that xtask's stages run: built once, as the tests are.

use crate::command::{self, Done, cargo, target_dir};
use std::path::PathBuf;

/// Builds `pulsetrain` and the examples with the profile of the tests, in which they are there already if the tests are.
///
/// The whole workspace is named, because cargo chooses the features of dependencies for all packages of a build together:
/// with one package named, it would build them again.
pub(crate) fn build() -> Done {
    command::run(&mut cargo("build --quiet --workspace --bin pulsetrain --examples"))
}

/// The path of the command line that [`build`] makes.
pub(crate) fn pulsetrain() -> PathBuf {
    target_dir().join("debug").join(format!("pulsetrain{}", std::env::consts::EXE_SUFFIX))
}

/// The path of an example that [`build`] makes.
pub(crate) fn example(name: &str) -> PathBuf {
    target_dir().join("debug/examples").join(format!("{name}{}", std::env::consts::EXE_SUFFIX))
}
