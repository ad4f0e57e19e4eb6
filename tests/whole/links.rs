//! Links in the Markdown documents lead to existing files and headings.
#![expect(clippy::unwrap_used, reason = "a test fails by panic")]

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// All Markdown files in the root folder and in `docs/`.
fn documents() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let files = [root.to_owned(), root.join("docs")].map(|folder| std::fs::read_dir(folder).unwrap());
    let paths = files.into_iter().flatten().map(|entry| entry.unwrap().path());
    paths.filter(|path| path.extension().is_some_and(|extension| extension == "md")).collect()
}

/// Anchors of a document's headings, as GitHub and GitLab generate them.
fn anchors(text: &str) -> BTreeSet<String> {
    let headings = text
        .lines()
        .filter_map(|line| line.trim_start_matches('#').strip_prefix(' ').filter(|_| line.starts_with('#')));
    let kept = |c: &char| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_');
    headings.map(|heading| heading.to_lowercase().chars().filter(kept).collect::<String>().replace(' ', "-")).collect()
}

/// Targets of a document's links, except links to other sites.
fn targets(text: &str) -> impl Iterator<Item = &str> {
    let targets = text.split("](").skip(1).filter_map(|rest| rest.split_once(')')).map(|(target, _)| target);
    targets.filter(|target| !target.contains("://"))
}

/// Targets of the broken links in the document at `path`.
fn broken(path: &Path, text: &str) -> Vec<String> {
    let leads = |target: &str| {
        let (file, anchor) = target.split_once('#').unwrap_or((target, ""));
        let file = if file.is_empty() { path.to_owned() } else { path.with_file_name(file) };
        file.exists() && (anchor.is_empty() || anchors(&std::fs::read_to_string(file).unwrap()).contains(anchor))
    };
    targets(text).filter(|target| !leads(target)).map(str::to_owned).collect()
}

#[test]
fn every_link_has_a_target() {
    let documents = documents();
    assert!(documents.len() > 5, "{documents:?}");
    for path in documents {
        let text = std::fs::read_to_string(&path).unwrap();
        assert_eq!(broken(&path, &text), Vec::<String>::new(), "{}", path.display());
    }
}

#[test]
fn a_broken_link_is_found() {
    let readme = Path::new(env!("CARGO_MANIFEST_DIR")).join("README.md");
    let text =
        "[a](README.md) [b](docs/queue.md#claim-order) [c](#try-it) [d](no.md) [e](docs/queue.md#no) [f](https://no)";
    assert_eq!(broken(&readme, text), ["no.md", "docs/queue.md#no"]);
}
