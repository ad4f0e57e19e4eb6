//! Orphans at the start of `serve`.

use super::{Server, folder, oviduct, until};
use std::fs::File;
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, SystemTime};

/// Writes a file of a model that was submitted in 2024. Returns its path.
fn model(at: &Path, age: Duration) -> std::path::PathBuf {
    let path = at.join("data/artifacts/models/018d0000-0000-7000-8000-000000000000/1/model.glb");
    std::fs::create_dir_all(path.parent().expect("a directory")).expect("created");
    #[expect(clippy::disallowed_methods, reason = "the time of a file")]
    let modified = SystemTime::now() - age;
    File::create(&path).expect("created").set_modified(modified).expect("set");
    path
}

/// A mistyped `--database`, or a volume that is not mounted.
#[test]
fn a_new_database_deletes_no_artifacts() {
    let at = folder();
    let old = model(at.path(), Duration::from_secs(365 * 86_400));
    let log = at.path().join("log");
    let mut child = oviduct(at.path())
        .args(["serve", "--addr", "127.0.0.1:0", "--database", "mistyped.db", "--log", "info"])
        .stderr(File::create(&log).expect("created"))
        .stdout(Stdio::null())
        .spawn()
        .expect("it starts");
    let text = || std::fs::read_to_string(&log).expect("read");
    until("it reports its first sweep", || text().contains("orphan"));
    let said = text();
    let _ = child.kill();
    let _ = child.wait();
    assert!(old.exists(), "{said}");
    for expected in ["WARN", "mistyped.db", "data/artifacts", "models/018d0000-", "--database", "--sweep-now"] {
        assert!(said.contains(expected), "{expected}: {said}");
    }
    drop(Server::start_with(at.path(), &["--database", "mistyped.db"]));
    assert!(old.exists());

    let _server = Server::start_with(at.path(), &["--database", "mistyped.db", "--sweep-now"]);
    until("the orphan is deleted", || !old.exists());
}

#[test]
fn orphans_are_kept_for_a_day_even_if_one_process_uses_the_stores() {
    let at = folder();
    let young = model(at.path(), Duration::from_secs(86_400 - 600));
    let old = young.with_file_name("other.glb");
    #[expect(clippy::disallowed_methods, reason = "the time of a file")]
    let modified = SystemTime::now() - Duration::from_secs(86_400 + 600);
    File::create(&old).expect("created").set_modified(modified).expect("set");
    let _server = Server::start_with(at.path(), &["--sweep-now"]);
    until("the old orphan is deleted", || !old.exists());
    assert!(young.exists());
}
