//! A local folder as artifact store. Reads, writes and sweeps follow no symbolic link below the
//! root.
//!
//! The root itself may be a link. The check for links precedes each operation. It protects against
//! a folder that was linked elsewhere by mistake, but not against an attacker who can write to the
//! store.

use super::error::ArtifactError;
use crate::jobs::folders::create_durably;
use jiff::Timestamp;
use object_store::local::LocalFileSystem;
use std::fs::ReadDir;
use std::io;
use std::path::{Path, PathBuf};

/// A stored object.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::jobs) struct Object {
    /// Key.
    pub(in crate::jobs) key: String,
    /// Time of the last write by the clock of the store, microseconds since 1970 UTC.
    pub(in crate::jobs) modified_micros: i64,
}

/// Error of opening the root folder.
#[derive(Debug, thiserror::Error)]
#[error("{}", .path.display())]
struct RootError {
    path: PathBuf,
    source: io::Error,
}

/// The root folder.
#[derive(Clone, Debug)]
pub(super) struct Root(PathBuf);

impl Root {
    /// Opens the folder, and creates it if it does not exist.
    pub(super) fn open(root: &Path) -> Result<(LocalFileSystem, Self), ArtifactError> {
        let failed = |source| ArtifactError::store(RootError { path: root.to_owned(), source });
        // The store below writes the folders of models to disk.
        create_durably(root).map_err(failed)?;
        let root = root.canonicalize().map_err(failed)?;
        // Reports links at the start instead of with the first model.
        for entry in std::fs::read_dir(&root).map_err(failed)? {
            let entry = entry.map_err(failed)?;
            if entry.file_type().map_err(failed)?.is_symlink() {
                return Err(ArtifactError::Link { path: entry.path() });
            }
        }
        let store = LocalFileSystem::new_with_prefix(&root)?.with_fsync(true).with_automatic_cleanup(true);
        Ok((store, Self(root)))
    }

    /// Fails if the file of `key` is a symbolic link or lies below one.
    pub(super) fn refuse_links(&self, key: &str) -> Result<(), ArtifactError> {
        let mut path = self.0.clone();
        for part in key.split('/') {
            path.push(part);
            match path.symlink_metadata() {
                Ok(metadata) if metadata.is_symlink() => return Err(ArtifactError::Link { path }),
                Ok(_) => {}
                // Nothing lies below. The operation that follows reports other errors.
                Err(_) => return Ok(()),
            }
        }
        Ok(())
    }

    /// Removes files of a [`Walk`] and folders that become empty. Returns the number of removed
    /// files.
    pub(super) fn remove(&self, keys: &[String]) -> u64 {
        let mut removed = 0;
        for key in keys {
            let path = self.0.join(key);
            match std::fs::remove_file(&path) {
                Ok(()) => removed += 1,
                Err(error) => {
                    tracing::warn!(path = %path.display(), %error, "could not remove an orphan; a later sweep will try again");
                }
            }
            for folder in path.ancestors().skip(1).take_while(|folder| *folder != self.0) {
                if std::fs::remove_dir(folder).is_err() {
                    // Not empty.
                    break;
                }
            }
        }
        removed
    }

    /// Names of folders below `prefix` that sort after `after` and contain a file.
    pub(super) fn folders_after(&self, prefix: &str, after: &str) -> io::Result<Vec<String>> {
        let entries = match std::fs::read_dir(self.0.join(prefix)) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            entries => entries?,
        };
        let mut names = Vec::new();
        for entry in entries {
            let name = entry?.file_name().to_string_lossy().into_owned();
            if name.as_str() > after && self.walk(&format!("{prefix}/{name}")).next().is_some() {
                names.push(name);
            }
        }
        Ok(names)
    }

    pub(super) fn walk(&self, prefix: &str) -> Walk {
        let top = self.0.join(prefix);
        Walk {
            root: self.0.clone(),
            folders: std::fs::read_dir(&top).map(|entries| (top, entries)).into_iter().collect(),
        }
    }
}

/// Iterates over the files below a folder, including files that an upload is staging
/// (`name#number`), which object_store does not list. Removes empty folders it passes.
#[derive(Debug)]
pub(in crate::jobs) struct Walk {
    root: PathBuf,
    /// Path of folders from the top to the one being read.
    folders: Vec<(PathBuf, ReadDir)>,
}

impl Iterator for Walk {
    type Item = Object;

    fn next(&mut self) -> Option<Object> {
        loop {
            let is_top = self.folders.len() == 1;
            let (folder, entries) = self.folders.last_mut()?;
            let Some(entry) = entries.next() else {
                if !is_top {
                    // Fails if it is not empty.
                    let _ = std::fs::remove_dir(folder);
                }
                self.folders.pop();
                continue;
            };
            let Some((path, kind)) = entry.ok().and_then(|entry| Some((entry.path(), entry.file_type().ok()?))) else {
                continue;
            };
            if kind.is_symlink() {
                tracing::warn!(path = %path.display(), "skipped a symbolic link in the artifact store");
            } else if kind.is_dir() {
                self.folders.extend(std::fs::read_dir(&path).map(|entries| (path, entries)));
            } else if let (Some(key), Some(modified_micros)) = (key(&self.root, &path), modified_micros(&path)) {
                return Some(Object { key, modified_micros });
            }
        }
    }
}

fn key(root: &Path, path: &Path) -> Option<String> {
    path.strip_prefix(root).ok()?.to_str().map(str::to_owned)
}

fn modified_micros(path: &Path) -> Option<i64> {
    let modified = path.symlink_metadata().ok()?.modified().ok()?;
    Timestamp::try_from(modified).ok().map(Timestamp::as_microsecond)
}
