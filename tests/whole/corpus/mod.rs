//! Runs every fuzz target over its corpus and over random mutations of it, without libFuzzer.
//! `scripts/fuzz` continues with libFuzzer.

mod mutations;
mod seeds;

use mutations::Mutations;
use oviduct::fuzzing::TARGETS;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// The files in a folder.
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    entries.map(|entry| entry.expect("the folder can be read").path()).collect()
}

#[test]
fn every_corpus_input_passes() {
    for target in TARGETS {
        let inputs = files(&Path::new("fuzz/corpus").join(target.name));
        assert!(inputs.len() > 1, "{} has {} inputs only", target.name, inputs.len());
        for path in inputs {
            let bytes = std::fs::read(&path).expect("the input can be read");
            let run = std::panic::catch_unwind(|| (target.run)(&bytes));
            assert!(run.is_ok(), "{}: see the panic above", path.display());
        }
    }
}

/// Each target gets 300 mutations by default. To run more: `OVIDUCT_TEST_MUTATIONS=100000 cargo
/// test --release --test whole corpus::`.
#[test]
fn random_mutations_of_the_corpora_pass() {
    let count = std::env::var("OVIDUCT_TEST_MUTATIONS").map_or(300, |count| count.parse().unwrap());
    for target in TARGETS {
        let mut paths = files(&Path::new("fuzz/corpus").join(target.name));
        paths.sort();
        let inputs: Vec<_> = paths.iter().map(|path| std::fs::read(path).expect("the input can be read")).collect();
        for (number, bytes) in Mutations::new(&inputs, 7).take(count).enumerate() {
            if std::panic::catch_unwind(|| (target.run)(&bytes)).is_err() {
                let kept = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{}-{number}", target.name));
                std::fs::write(&kept, &bytes).expect("the input can be kept");
                panic!("see the panic above; repeat it with: scripts/fuzz {} {}", kept.display(), target.name);
            }
        }
    }
}

/// `scripts/test` does not build the programs of the fuzz targets, so this test compares their text
/// with the expected text.
#[test]
fn every_target_has_a_program() {
    let paths = files(Path::new("fuzz/fuzz_targets"));
    let programs: BTreeSet<_> = paths.iter().filter_map(|path| path.file_stem()?.to_str()).collect();
    assert_eq!(programs, TARGETS.iter().map(|target| target.name).collect());
    for path in &paths {
        let target = path.file_stem().unwrap().to_str().unwrap().to_uppercase();
        let run = format!("oviduct_fuzz::run(&oviduct::fuzzing::{target}, bytes)");
        assert_eq!(
            std::fs::read_to_string(path).unwrap(),
            format!("#![no_main]\n\nlibfuzzer_sys::fuzz_target!(|bytes: &[u8]| {run});\n"),
            "{}",
            path.display()
        );
    }
}

#[test]
fn the_corpora_are_small() {
    let bytes: u64 = TARGETS
        .iter()
        .flat_map(|target| files(&Path::new("fuzz/corpus").join(target.name)))
        .map(|path| path.metadata().expect("the input exists").len())
        .sum();
    assert!(bytes < 2 << 20, "the corpora have {bytes} bytes");
}
