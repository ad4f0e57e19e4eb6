//! Runs every target of the fuzzers once over its corpus, without libFuzzer. `scripts/fuzz` goes on from there.

mod seeds;

use oviduct::fuzzing::TARGETS;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// The files of a folder.
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    entries.map(|entry| entry.expect("the folder can be read").path()).collect()
}

#[test]
fn every_input_of_the_corpora_holds() {
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

#[test]
fn every_target_has_a_program() {
    let programs = files(Path::new("fuzz/fuzz_targets"));
    let programs: BTreeSet<_> = programs.iter().filter_map(|path| path.file_stem()?.to_str()).collect();
    assert_eq!(programs, TARGETS.iter().map(|target| target.name).collect());
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
