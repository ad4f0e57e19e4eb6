//! Files that become visible only once they are complete.

use std::io;
use std::path::{Path, PathBuf};

/// A hidden directory within the target directory of its files. Dropping it removes the directory.
#[derive(Debug)]
pub struct Scratch {
    dir: PathBuf,
    target: PathBuf,
}

impl Scratch {
    /// Creates `target` if it does not exist, and a hidden directory in it.
    ///
    /// # Errors
    /// If a directory cannot be created.
    pub fn new(target: &Path) -> io::Result<Self> {
        std::fs::create_dir_all(target)?;
        let dir = target.join(format!(".oviduct-{}.part", uuid::Uuid::now_v7().simple()));
        std::fs::create_dir(&dir)?;
        Ok(Self { dir, target: target.to_owned() })
    }

    /// Returns the directory to write to.
    #[must_use]
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// Moves a file to the target directory, replacing an older one.
    ///
    /// # Errors
    /// If the file cannot be moved.
    pub fn publish(&self, name: &str) -> io::Result<PathBuf> {
        let to = self.target.join(name);
        std::fs::rename(self.dir.join(name), &to)?;
        Ok(to)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // If the directory cannot be removed, its name shows that it is incomplete.
        let _ = std::fs::remove_dir_all(&self.dir);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_published_files_remain() {
        let root = tempfile::tempdir().expect("a folder");
        let target = root.path().join("a/b");
        {
            let scratch = Scratch::new(&target).expect("made");
            std::fs::write(scratch.dir().join("good"), "x").expect("written");
            std::fs::write(scratch.dir().join("half"), "y").expect("written");
            scratch.publish("good").expect("moved");
            assert!(scratch.publish("missing").is_err());
        }
        let left: Vec<_> = std::fs::read_dir(&target).expect("there").map(|e| e.expect("read").file_name()).collect();
        assert_eq!(left, ["good"]);
    }
}
