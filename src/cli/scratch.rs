//! Files that become visible only once they are complete.

use anyhow::Context;
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

/// Writes a file that becomes visible only once it is complete, replacing an older one. Returns its
/// path.
///
/// # Errors
/// If `path` has no name, or if the file cannot be written.
pub(super) fn write(path: &Path, content: impl AsRef<[u8]>) -> anyhow::Result<PathBuf> {
    let write = || {
        let (dir, name) = split(path).context("it has no name")?;
        let scratch = Scratch::new(dir)?;
        std::fs::write(scratch.dir().join(name), content)?;
        anyhow::Ok(scratch.publish(name)?)
    };
    write().with_context(|| format!("writing {} failed", path.display()))
}

/// Returns the directory and the name of a file.
pub(super) fn split(path: &Path) -> Option<(&Path, &str)> {
    let dir = path.parent().filter(|dir| !dir.as_os_str().is_empty()).unwrap_or(Path::new("."));
    Some((dir, path.file_name()?.to_str()?))
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
