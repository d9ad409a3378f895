//! A temporary folder for a test.

use std::fs;
use std::path::PathBuf;

/// A folder that is removed with all its files when this value is dropped.
pub struct Folder(pub PathBuf);

impl Folder {
    /// An empty folder. No other test of the process may use the same name.
    pub fn new(name: &str) -> Folder {
        let path = std::env::temp_dir().join(format!("pulsetrain-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&path);
        fs::create_dir_all(&path).unwrap();
        Folder(path)
    }

    /// The path of a file in it.
    pub fn path(&self, name: &str) -> String {
        self.0.join(name).display().to_string()
    }

    /// Writes a file in it, and returns its path.
    pub fn write(&self, name: &str, text: &str) -> String {
        let path = self.path(name);
        fs::write(&path, text).unwrap();
        path
    }

    /// The path of the folder.
    pub fn name(&self) -> String {
        self.0.display().to_string()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}
