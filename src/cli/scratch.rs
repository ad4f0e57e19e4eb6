//! Files that become visible whole or not at all.

use std::io;
use std::path::{Path, PathBuf};

/// A hidden folder beside the final place of the files in it; gone when dropped.
#[derive(Debug)]
pub(super) struct Scratch {
    dir: PathBuf,
    target: PathBuf,
}

impl Scratch {
    /// Makes `target` where it is missing, and a hidden folder in it.
    ///
    /// # Errors
    /// Where a folder cannot be made.
    pub(super) fn new(target: &Path) -> io::Result<Self> {
        std::fs::create_dir_all(target)?;
        let dir = target.join(format!(".oviduct-{}.part", uuid::Uuid::now_v7().simple()));
        std::fs::create_dir(&dir)?;
        Ok(Self { dir, target: target.to_owned() })
    }

    /// Where to write.
    pub(super) fn dir(&self) -> &Path {
        &self.dir
    }

    /// Moves a file to its place, over an older one.
    ///
    /// # Errors
    /// Where it cannot be moved.
    pub(super) fn publish(&self, name: &str) -> io::Result<PathBuf> {
        let to = self.target.join(name);
        std::fs::rename(self.dir.join(name), &to)?;
        Ok(to)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // What cannot be removed is hidden, and named as a part.
        let _ = std::fs::remove_dir_all(&self.dir);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_is_published_stays() {
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
