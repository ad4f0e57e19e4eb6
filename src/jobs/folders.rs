//! Creation of folders that outlive a crash of the machine.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

/// Creates a folder with its missing parents, and writes the entries of all new folders to disk.
/// Files below are durable only if the folder is. Returns the folders with new entries.
pub(in crate::jobs) fn create_durably(path: &Path) -> io::Result<Vec<PathBuf>> {
    // The parent of a relative path of one part is empty.
    let parent = |path: &Path| match path.parent() {
        Some(parent) if parent.as_os_str().is_empty() => Some(PathBuf::from(".")),
        parent => parent.map(Path::to_owned),
    };
    let missing = path.ancestors().take_while(|path| !path.as_os_str().is_empty() && !path.exists());
    let changed: Vec<PathBuf> = missing.filter_map(parent).collect();
    std::fs::create_dir_all(path)?;
    // Other systems cannot open folders as files.
    if cfg!(unix) {
        for folder in &changed {
            File::open(folder)?.sync_all()?;
        }
    }
    Ok(changed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_parents_of_new_folders_are_written_to_disk() {
        let dir = tempfile::tempdir().unwrap();
        let [a, b] = ["a", "a/b"].map(|path| dir.path().join(path));
        assert_eq!(create_durably(&b.join("c")).unwrap(), [b.clone(), a, dir.path().to_owned()]);
        assert!(b.join("c").is_dir());
        assert_eq!(create_durably(&b.join("d")).unwrap(), std::slice::from_ref(&b));
        assert_eq!(create_durably(&b).unwrap(), [""; 0].map(PathBuf::from));
        assert_eq!(create_durably(Path::new("")).unwrap_or_default(), [""; 0].map(PathBuf::from));
        // Relative to the current folder.
        assert_eq!(create_durably(Path::new("src")).unwrap(), [""; 0].map(PathBuf::from));
        std::fs::write(b.join("file"), "").unwrap();
        assert!(create_durably(&b.join("file/e")).is_err());
    }
}
