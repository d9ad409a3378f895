//! A folder of its own for a test.

use std::fs;
use std::path::PathBuf;

/// Gone with it, and all that is in it.
pub struct Folder(pub PathBuf);

impl Folder {
    /// An empty one; no other test of the process has its name.
    pub fn new(name: &str) -> Folder {
        let path = std::env::temp_dir().join(format!("pulsetrain-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&path);
        fs::create_dir_all(&path).unwrap();
        Folder(path)
    }

    /// A file in it.
    pub fn path(&self, name: &str) -> String {
        self.0.join(name).display().to_string()
    }

    /// A file in it, with this text.
    pub fn write(&self, name: &str, text: &str) -> String {
        let path = self.path(name);
        fs::write(&path, text).unwrap();
        path
    }

    pub fn name(&self) -> String {
        self.0.display().to_string()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}
