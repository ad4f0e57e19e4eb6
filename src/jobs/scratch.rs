//! Folders that attempts write to before their files go to the artifact store.
//!
//! `<root>/<process>/<job>-<attempt>`: each process locks its folder, so that the next start can tell the
//! leavings of a dead process, which it removes, from the work of a live one.

use super::job::JobId;
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

const LOCK: &str = ".lock";

/// The scratch folder of this process; removed when dropped.
#[derive(Debug)]
pub struct Scratch {
    folder: PathBuf,
    _lock: File,
}

/// The scratch folder of an attempt; removed when dropped.
#[derive(Debug)]
pub struct AttemptDir(PathBuf);

impl Scratch {
    /// Makes a folder for this process under `root`, and removes those of processes that are gone.
    ///
    /// # Errors
    /// Where `root` cannot be made or written to.
    pub fn open(root: &Path) -> io::Result<Self> {
        std::fs::create_dir_all(root)?;
        // One process at a time looks around and makes its folder: a folder is never seen before it is locked. Where
        // the file system knows no locks, folders stay single all the same, only leavings may be missed.
        let door = File::create(root.join(LOCK))?;
        let _ = door.lock();
        for entry in std::fs::read_dir(root)?.flatten() {
            let folder = entry.path();
            let lock = File::open(folder.join(LOCK));
            // A folder without a lock file was left half removed.
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

    /// A new, empty folder for an attempt.
    ///
    /// # Errors
    /// Where it cannot be made.
    pub fn attempt(&self, job: JobId, attempt: u32) -> io::Result<AttemptDir> {
        let folder = self.folder.join(format!("{job}-{attempt}"));
        std::fs::create_dir(&folder)?;
        Ok(AttemptDir(folder))
    }

    /// Fails where no folder for an attempt could be made just now.
    ///
    /// # Errors
    /// Why not.
    pub fn probe(&self) -> io::Result<()> {
        let folder = self.folder.join(format!("probe-{}", uuid::Uuid::now_v7()));
        std::fs::create_dir(&folder)?;
        std::fs::remove_dir(&folder)
    }

    /// Fails if a file of a megabyte cannot be written and synced, or if less than `space` bytes are free (where the system
    /// reports that). A disk that is smaller than `space` passes when nine tenths of it are free. Blocks.
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

/// Bytes of the file that [`Scratch::check`] writes.
const PROBE: usize = 1 << 20;

/// Bytes that this process may still write to the file system of `path`, and its size.
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

/// Removes a folder, which somebody else may be removing too. What stays is removed by the next start.
fn remove(folder: &Path) {
    match std::fs::remove_dir_all(folder) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            tracing::warn!(folder = %folder.display(), %error, "scratch files stay until the next start");
        }
        _ => {}
    }
}

impl AttemptDir {
    /// Where it is.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_start_removes_what_dead_processes_left_and_spares_the_living() {
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
    fn processes_come_and_go_at_the_same_time() {
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
