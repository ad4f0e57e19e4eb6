//! Scratch directories, which attempts write to before their files go to the artifact store:
//! `<root>/<process>/<job>-<attempt>`.
//!
//! Each process locks its directory while it runs. The next start removes directories that are not
//! locked, because their processes have ended.

use super::job::JobId;
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

const LOCK: &str = ".lock";

/// The scratch directory of this process. Dropping it removes the directory; in async code, drop it
/// by [`drop_blocking`].
#[derive(Debug)]
pub struct Scratch {
    folder: PathBuf,
    _lock: File,
}

/// The scratch directory of an attempt. Dropping it removes the directory; in async code, drop it
/// by [`drop_blocking`].
#[derive(Debug)]
pub struct AttemptDir(PathBuf);

impl Scratch {
    /// Creates a directory for this process under `root`, and removes the directories of processes
    /// that have ended.
    ///
    /// # Errors
    /// If `root` cannot be created or written to.
    pub fn open(root: &Path) -> io::Result<Self> {
        std::fs::create_dir_all(root)?;
        // One process at a time, so that none removes a directory that another has created but not
        // locked yet. On a file system without locks, directories of ended processes may stay.
        let root_lock = File::create(root.join(LOCK))?;
        let _ = root_lock.lock();
        for entry in std::fs::read_dir(root)?.flatten() {
            let folder = entry.path();
            let lock = File::open(folder.join(LOCK));
            // A directory without a lock file was removed partially.
            if folder.is_dir() && !matches!(&lock, Ok(file) if file.try_lock().is_err()) {
                remove(&folder);
            }
        }
        let folder = root.join(uuid::Uuid::now_v7().to_string());
        std::fs::create_dir(&folder)?;
        let lock = File::create(folder.join(LOCK))?;
        let _ = lock.try_lock();
        Ok(Self { folder, _lock: lock })
    }

    /// Creates the directory of an attempt.
    ///
    /// # Errors
    /// The error of creating it.
    pub fn attempt(&self, job: JobId, attempt: u32) -> io::Result<AttemptDir> {
        let folder = self.folder.join(format!("{job}-{attempt}"));
        std::fs::create_dir(&folder)?;
        Ok(AttemptDir(folder))
    }

    /// Checks that the directory of an attempt can be created.
    ///
    /// # Errors
    /// The error of creating a directory.
    pub fn probe(&self) -> io::Result<()> {
        let folder = self.folder.join(format!("probe-{}", uuid::Uuid::now_v7()));
        std::fs::create_dir(&folder)?;
        std::fs::remove_dir(&folder)
    }

    /// Checks that a file of one mebibyte can be written and synced, and that `space` bytes are
    /// free (if the system reports this). A disk that is smaller than `space` passes if nine tenths
    /// of it are free. Blocks.
    ///
    /// # Errors
    /// The error of the write, or [`io::ErrorKind::StorageFull`].
    pub fn check(&self, space: u64) -> io::Result<()> {
        let path = self.folder.join(format!("probe-{}", uuid::Uuid::now_v7()));
        let write = || {
            let mut file = File::create_new(&path)?;
            file.write_all(&vec![0x5a; PROBE])?;
            file.sync_all()
        };
        let written = write();
        let removed = std::fs::remove_file(&path);
        written.and(removed)?;
        match free_and_total(&self.folder) {
            Some((free, total)) if free < space.min(total / 10 * 9) => {
                let detail = format!("{free} bytes are free, {space} are needed");
                Err(io::Error::new(io::ErrorKind::StorageFull, detail))
            }
            _ => Ok(()),
        }
    }
}

/// Size of the file that [`Scratch::check`] writes, bytes.
const PROBE: usize = 1 << 20;

/// Bytes that this process may still write to the file system of `path`, and the size of the file
/// system, bytes.
#[cfg(unix)]
fn free_and_total(path: &Path) -> Option<(u64, u64)> {
    let system = rustix::fs::statvfs(path).ok()?;
    Some((system.f_bavail.saturating_mul(system.f_frsize), system.f_blocks.saturating_mul(system.f_frsize)))
}

#[cfg(not(unix))]
fn free_and_total(_: &Path) -> Option<(u64, u64)> {
    None
}

impl Drop for Scratch {
    fn drop(&mut self) {
        remove(&self.folder);
    }
}

/// Removes a directory, which another process may be removing too. Files that cannot be removed
/// stay until the next start.
fn remove(folder: &Path) {
    match std::fs::remove_dir_all(folder) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            tracing::warn!(folder = %folder.display(), %error, "could not remove scratch files; the next start will remove them");
        }
        _ => {}
    }
}

impl AttemptDir {
    /// Path of the directory.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for AttemptDir {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Drops a value that removes files, on a thread that may block.
pub async fn drop_blocking(value: impl Send + 'static) {
    // Fails if the runtime is shutting down, which drops the value too.
    let _ = tokio::task::spawn_blocking(move || drop(value)).await;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_start_removes_directories_of_ended_processes_only() {
        let root = tempfile::tempdir().unwrap();
        let dead = root.path().join("dead");
        std::fs::create_dir_all(dead.join("job-1")).unwrap();
        std::fs::write(dead.join(LOCK), "").unwrap();
        std::fs::write(dead.join("job-1/model.glb"), "half").unwrap();
        let living = Scratch::open(root.path()).unwrap();
        assert!(!dead.exists());
        let attempt = living.attempt(JobId(uuid::Uuid::nil()), 1).unwrap();
        let other = Scratch::open(root.path()).unwrap();
        assert!(attempt.path().is_dir());
        drop(attempt);
        drop(living);
        drop(other);
        assert_eq!(folders(root.path()), 0);
    }

    #[test]
    fn processes_start_and_end_concurrently() {
        let root = tempfile::tempdir().unwrap();
        std::thread::scope(|threads| {
            for n in 0..8 {
                let root = root.path();
                threads.spawn(move || {
                    for attempt in 0..50 {
                        let scratch = Scratch::open(root).unwrap();
                        let folder = scratch.attempt(JobId(uuid::Uuid::from_u128(n)), attempt).unwrap();
                        std::fs::write(folder.path().join("model.glb"), "whole").unwrap();
                    }
                });
            }
        });
        assert_eq!(folders(root.path()), 0);
    }

    fn folders(root: &Path) -> usize {
        std::fs::read_dir(root).unwrap().flatten().filter(|entry| entry.path().is_dir()).count()
    }
}
