//! The files of small models, and the files derived from them, have the recorded digests.
//!
//! `digests.json` contains the SHA-256 of every file of each model. After an intended change of the
//! engine, raise `version` in `Cargo.toml`. The version is part of a model's digest, so finished
//! models of the old engine are never reused. Then record the digests again: `OVIDUCT_BLESS=1 cargo
//! test --test whole golden::`.

mod derived;
mod models;

use models::{Model, models};
use oviduct::generate::{Backend, CancelToken, Request, generate};
use sha2::{Digest as _, Sha256};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Mutex;

/// Digests of the files of each model, by model name.
type Digests = BTreeMap<String, BTreeMap<String, String>>;

const PATH: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/whole/golden/digests.json");
/// Number of models that are grown at the same time.
const THREADS: usize = 2;

/// SHA-256 in hexadecimal.
fn hex(bytes: &[u8]) -> String {
    hex::encode(Sha256::digest(bytes))
}

/// Digests of a model's files, read back from the disk.
fn digests(model: &Model) -> BTreeMap<String, String> {
    let dir = tempfile::tempdir().expect("a folder");
    let request = Request {
        preset: model.preset.to_owned(),
        spec: model.spec(),
        seed: model.seed,
        backend: Backend::CpuSingle,
        outputs: model.outputs.clone(),
        dir: dir.path().to_owned(),
        memory_limit_bytes: None,
    };
    let outcome = generate(&request, &(), &CancelToken::default()).unwrap_or_else(|e| panic!("{}: {e}", model.name));
    let written = outcome.files.into_iter().map(|file| {
        let digest = hex(&std::fs::read(dir.path().join(&file.name)).expect("a file"));
        assert_eq!(digest, file.sha256, "{} of {}", file.name, model.name);
        (file.name, digest)
    });
    written.collect()
}

/// Digests of the files of all models.
fn grown() -> Digests {
    let (left, made) = (Mutex::new(models()), Mutex::new(Digests::new()));
    let next = || left.lock().expect("no thread has panicked").pop();
    std::thread::scope(|scope| {
        for _ in 0..THREADS {
            scope.spawn(|| {
                while let Some(model) = next() {
                    let files = digests(&model);
                    made.lock().expect("no thread has panicked").insert(model.name, files);
                }
            });
        }
    });
    made.into_inner().expect("no thread has panicked")
}

#[test]
fn files_have_the_recorded_digests() {
    let mut made = grown();
    let reports: BTreeSet<&String> = made.values().map(|files| &files["report.json"]).collect();
    assert_eq!(reports.len(), models().len(), "two models are the same");
    made.insert("made from models".to_owned(), derived::digests());
    if std::env::var_os("OVIDUCT_BLESS").is_some() {
        let text = serde_json::to_string_pretty(&made).expect("string keys only") + "\n";
        std::fs::write(PATH, text).expect("tests/whole/golden/digests.json can be written");
    }
    let text = std::fs::read_to_string(PATH).expect("tests/whole/golden/digests.json can be read");
    let kept: Digests = serde_json::from_str(&text).expect("digests by file by model");
    let [before, after] = [&kept, &made].map(|digests| {
        let of = |(model, files): (&String, &BTreeMap<String, String>)| {
            files.iter().map(|(file, digest)| (format!("{file} of {model}"), digest.clone())).collect::<Vec<_>>()
        };
        digests.iter().flat_map(of).collect::<BTreeSet<_>>()
    });
    let changed: BTreeSet<_> = before.symmetric_difference(&after).map(|(file, _)| file).collect();
    assert!(
        changed.is_empty(),
        "other bytes than before, or other files: {changed:#?}\nIf the engine changed on purpose: raise `version` in \
         Cargo.toml, then OVIDUCT_BLESS=1 cargo test --test whole golden::"
    );
}
