//! Folders of models. A folder has the files of one model, which its `manifest.json` names.

use crate::cli::exit::Failure;
use crate::cli::term;
use crate::export::hashing::HashingWriter;
use crate::generate::{MANIFEST, is_model_file};
use anyhow::{Context, anyhow, bail};
use serde::Deserialize;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

/// Name of the page of a report.
pub(in crate::cli) const PAGE: &str = "report.html";

/// Maximum size of a manifest, bytes. That of a model has a few thousand.
const MOST_BYTES: u64 = 64 << 20;

/// Members of a manifest that commands read.
#[derive(Debug, Deserialize)]
pub(in crate::cli) struct Stored {
    preset: String,
    seed: u64,
    /// SHA-256 of spec, seed and engine version.
    pub(in crate::cli) digest: String,
    files: Vec<StoredFile>,
}

#[derive(Debug, Deserialize)]
struct StoredFile {
    name: String,
    sha256: String,
}

/// Folder that receives the files of a model.
#[derive(Debug)]
pub(in crate::cli) struct Folder {
    dir: PathBuf,
    /// Files that the manifest in the folder names.
    old: Vec<String>,
    /// True if the folder has files of another model, which `--force` replaces.
    replaces: bool,
}

impl Folder {
    /// Opens a folder for the model with this digest. The folder may be missing. With `force`, it
    /// may have files of another model.
    ///
    /// # Errors
    /// [`Failure::Usage`] if the files of the model would be mixed with others, or if the manifest
    /// in the folder names files outside of it.
    pub(in crate::cli) fn open(dir: &Path, digest: &str, force: bool) -> Result<Self, Failure> {
        let shown = dir.display();
        let folder = |old, replaces| Self { dir: dir.to_owned(), old, replaces };
        let refuse = |what: String, with: &str| {
            let line = format!(
                "{shown}: the folder has {what}, which would be mixed with this model; choose another folder, or \
                 give --force, which {with}"
            );
            Err(Failure::usage(line))
        };
        let stored = match stored(dir).with_context(|| dir.join(MANIFEST).display().to_string())? {
            Found::Manifest(stored) => stored,
            Found::Other if force => return Ok(folder(Vec::new(), true)),
            Found::Other => {
                let what = format!("a {MANIFEST} that is not the manifest of a model");
                return refuse(what, &format!("replaces {MANIFEST} and removes nothing else"));
            }
            Found::Nothing => {
                let found = model_files(dir)?;
                if force || found.is_empty() {
                    return Ok(folder(Vec::new(), force));
                }
                let what = format!("files of a model without a {MANIFEST} ({})", found.join(", "));
                return refuse(what, "replaces files of the same names and removes nothing else");
            }
        };
        if let Some(file) = stored.files.iter().find(|file| !is_plain(&file.name)) {
            return Err(Failure::usage(format!(
                "{shown}: {MANIFEST} names `{}`, which is not the name of a file in the folder; choose another folder",
                file.name
            )));
        }
        let replaces = stored.digest != digest;
        if replaces && !force {
            let short: String = stored.digest.chars().take(12).collect();
            let what =
                format!("the files of another model (preset {}, seed {}, digest {short}…)", stored.preset, stored.seed);
            return refuse(what, &format!("removes the {} files that its {MANIFEST} names", stored.files.len()));
        }
        Ok(folder(stored.files.into_iter().map(|file| file.name).collect(), replaces))
    }

    /// Removes the manifest in the folder and the files that it names, except those in `new`, and
    /// the report page of another model. Notes other files that look like those of a model.
    ///
    /// # Errors
    /// If a file cannot be removed.
    pub(in crate::cli) fn clear(self, new: &[&str]) -> anyhow::Result<()> {
        // The page of the report shows the other model, and no manifest names it.
        let page = (self.replaces && !self.old.is_empty()).then_some(PAGE);
        let stale = self.old.iter().map(String::as_str).chain(page).filter(|name| !new.contains(name));
        // Without a manifest, no command takes the remaining files for a whole model.
        for name in std::iter::once(MANIFEST).chain(stale) {
            match std::fs::remove_file(self.dir.join(name)) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => {
                    return Err(anyhow!(error).context(format!("removing {}", self.dir.join(name).display())));
                }
                _ => {}
            }
        }
        if self.replaces {
            let left = model_files(&self.dir)?;
            for name in left.iter().filter(|name| !new.contains(&name.as_str())) {
                let path = self.dir.join(name);
                term::note(&format!("warning: {} was not written with this model and remains", path.display()));
            }
        }
        Ok(())
    }
}

/// True if a name is that of a visible file directly in a folder.
pub(in crate::cli) fn is_plain(name: &str) -> bool {
    let is_last = Path::new(name).file_name() == Some(name.as_ref());
    is_last && !name.starts_with('.') && !name.contains(['/', '\\', '\0'])
}

/// Parses a manifest.
pub(in crate::cli) fn parse(bytes: &[u8]) -> serde_json::Result<Stored> {
    serde_json::from_slice(bytes)
}

/// Compares a file with the manifest next to it. A file that no manifest names passes. The data of
/// a glTF file as text are a second file, which is compared too.
///
/// # Errors
/// If the file differs from the manifest.
pub(in crate::cli) fn verify(file: &Path) -> anyhow::Result<()> {
    let dir = match file.parent() {
        Some(dir) if !dir.as_os_str().is_empty() => dir,
        _ => Path::new("."),
    };
    let found = stored(dir).with_context(|| dir.join(MANIFEST).display().to_string())?;
    let Found::Manifest(stored) = found else { return Ok(()) };
    let is_text = file.extension().is_some_and(|ending| ending == "gltf");
    let data = is_text.then(|| file.with_extension("bin")).filter(|data| data.is_file());
    for file in std::iter::once(file.to_owned()).chain(data) {
        let of_name = |entry: &&StoredFile| file.file_name() == Some(entry.name.as_ref());
        let Some(entry) = stored.files.iter().find(of_name) else { continue };
        let shown = || file.display().to_string();
        let mut hash = HashingWriter::new(io::sink());
        io::copy(&mut File::open(&file).with_context(shown)?, &mut hash).with_context(shown)?;
        if !hash.finish().1.sha256.eq_ignore_ascii_case(&entry.sha256) {
            bail!(
                "{} differs from {MANIFEST}: the folder mixes files of two models, or the file was changed",
                file.display()
            );
        }
    }
    Ok(())
}

/// True if the manifest in the folder of a file names the file.
pub(super) fn is_of_model(file: &Path) -> bool {
    let dir = file.parent().filter(|dir| !dir.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let Ok(Found::Manifest(stored)) = stored(dir) else { return false };
    stored.files.iter().any(|entry| file.file_name() == Some(entry.name.as_ref()))
}

/// What a folder has in place of a manifest.
enum Found {
    Nothing,
    /// A file that is not the manifest of a model.
    Other,
    Manifest(Stored),
}

fn stored(dir: &Path) -> io::Result<Found> {
    let path = dir.join(MANIFEST);
    match std::fs::metadata(&path) {
        Ok(found) if found.is_file() => {}
        Ok(_) => return Ok(Found::Other),
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Found::Nothing),
        Err(error) => return Err(error),
    }
    let mut bytes = Vec::new();
    File::open(&path)?.take(MOST_BYTES).read_to_end(&mut bytes)?;
    Ok(parse(&bytes).map_or(Found::Other, Found::Manifest))
}

/// Files with names that files of a model have, in alphabetical order.
fn model_files(dir: &Path) -> anyhow::Result<Vec<String>> {
    let entries = match std::fs::read_dir(dir) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.with_context(|| dir.display().to_string())?,
    };
    let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    let mut names: Vec<String> = names.filter(|name| is_model_file(name)).collect();
    names.sort_unstable();
    Ok(names)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    const ABC: &str = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";

    fn with(manifest: Option<&str>, files: &[&str]) -> tempfile::TempDir {
        let dir = tempfile::tempdir().unwrap();
        for name in files {
            std::fs::write(dir.path().join(name), "abc").unwrap();
        }
        if let Some(text) = manifest {
            std::fs::write(dir.path().join(MANIFEST), text).unwrap();
        }
        dir
    }

    fn manifest(names: &[&str]) -> String {
        let files: Vec<_> = names.iter().map(|name| json!({ "name": name, "sha256": ABC })).collect();
        json!({ "preset": "pig", "seed": 7, "digest": "a".repeat(64), "files": files }).to_string()
    }

    fn names(dir: &Path) -> Vec<String> {
        let mut names: Vec<_> =
            std::fs::read_dir(dir).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    fn refusal(dir: &Path, digest: &str, force: bool) -> String {
        Folder::open(dir, digest, force).expect_err("it is refused").report().1.concat()
    }

    #[test]
    fn another_model_is_replaced_only_by_force() {
        let dir = with(
            Some(&manifest(&["model.glb", "report.json"])),
            &["model.glb", "report.json", "report.html", "notes.txt", "model.stl"],
        );
        let told = refusal(dir.path(), "b", false);
        for part in ["preset pig", "seed 7", "--force", "2 files", dir.path().to_str().unwrap()] {
            assert!(told.contains(part), "{part}: {told}");
        }
        Folder::open(dir.path(), "b", true).unwrap().clear(&["report.json"]).unwrap();
        assert_eq!(names(dir.path()), ["model.stl", "notes.txt", "report.json"]);
    }

    #[test]
    fn the_same_model_loses_only_stale_files() {
        let dir =
            with(Some(&manifest(&["model.glb", "model.obj", "gone.ply"])), &["model.glb", "model.obj", "mine.obj"]);
        Folder::open(dir.path(), &"a".repeat(64), false).unwrap().clear(&["model.glb", "model.ply"]).unwrap();
        assert_eq!(names(dir.path()), ["mine.obj", "model.glb"]);
    }

    #[test]
    fn files_without_a_manifest_are_kept() {
        let dir = with(None, &["model.glb", "other.txt"]);
        assert!(refusal(dir.path(), "b", false).contains("model.glb"));
        Folder::open(dir.path(), "b", true).unwrap().clear(&[]).unwrap();
        assert_eq!(names(dir.path()), ["model.glb", "other.txt"]);
        let dir = with(Some("{\"name\": \"an app\"}"), &[]);
        assert!(refusal(dir.path(), "b", false).contains("not the manifest of a model"));
        Folder::open(dir.path(), "b", true).unwrap().clear(&[]).unwrap();
        assert_eq!(names(dir.path()), [""; 0]);
        for dir in [with(None, &["other.txt"]).path(), Path::new("no/such/folder")] {
            assert!(Folder::open(dir, "b", false).is_ok());
        }
    }

    #[test]
    fn no_manifest_names_files_outside_its_folder() {
        for name in ["../model.glb", "/etc/passwd", "a/b", "a\\b", "..", ".", "", ".hidden", "x\0y"] {
            let dir = with(Some(&manifest(&["model.glb", name])), &["model.glb"]);
            for digest in ["b", &"a".repeat(64)] {
                assert!(refusal(dir.path(), digest, true).contains("not the name of a file"), "{name:?}");
            }
            assert_eq!(names(dir.path()), [MANIFEST, "model.glb"]);
        }
    }

    #[test]
    fn files_are_compared_with_the_manifest() {
        let dir = with(Some(&manifest(&["model.gltf", "model.bin"])), &["model.gltf", "model.bin", "other.obj"]);
        let file = |name: &str| dir.path().join(name);
        assert!(verify(&file("model.gltf")).is_ok() && verify(&file("other.obj")).is_ok());
        std::fs::write(file("model.bin"), "abd").unwrap();
        let told = verify(&file("model.gltf")).unwrap_err().to_string();
        assert!(told.contains("model.bin differs from manifest.json"), "{told}");
        std::fs::write(file(MANIFEST), "{}").unwrap();
        assert!(verify(&file("model.gltf")).is_ok(), "not a manifest");
    }
}
