//! Tests that runs interrupted at random steps produce the same bytes as uninterrupted ones.

use super::*;
use crate::generate::tests::{even, request, small};
use crate::generate::{Backend, CancelToken, GenerateError, Outcome, Progress, Sink, generate, resume};
use proptest::prelude::*;
use serde_json::json;
use std::collections::BTreeMap;
use std::io::Cursor;
use std::sync::Mutex;

/// Sink that requests a checkpoint at one step, and stops there.
struct StopAt {
    step: u32,
    seen: Mutex<u32>,
    taken: Mutex<Option<Vec<u8>>>,
    cancel: CancelToken,
}

impl StopAt {
    fn new(step: u32) -> Self {
        Self { step, seen: Mutex::new(0), taken: Mutex::new(None), cancel: CancelToken::default() }
    }
}

impl Sink for StopAt {
    fn progress(&self, progress: &Progress) {
        *self.seen.lock().unwrap() = progress.step;
    }

    fn section(&self, _: &Section) {}

    fn wants_checkpoint(&self) -> bool {
        *self.seen.lock().unwrap() >= self.step
    }

    fn checkpoint(&self, file: TempPath) {
        *self.taken.lock().unwrap() = Some(std::fs::read(&file).unwrap());
        self.cancel.cancel();
    }
}

fn hashes(outcome: Outcome) -> BTreeMap<String, String> {
    outcome.files.into_iter().map(|f| (f.name, f.sha256)).collect()
}

fn on<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(work)
}

fn opened(request: &Request, dir: &Path, bytes: &[u8]) -> Checkpoint {
    let path = dir.join("resumed.checkpoint");
    std::fs::write(&path, bytes).unwrap();
    Checkpoint::open(request, &path).unwrap()
}

/// Runs to a checkpoint at each of `stops`, each time from the previous one, then to the end.
fn interrupted(request: &Request, stops: &[(u32, usize)], threads: usize) -> BTreeMap<String, String> {
    let dir = tempfile::tempdir().unwrap();
    let request = Request { dir: dir.path().into(), ..request.clone() };
    let mut last: Option<Vec<u8>> = None;
    for &(step, threads) in stops {
        let sink = StopAt::new(step);
        let from = last.take();
        let result = on(threads, || match &from {
            Some(bytes) => resume(&request, opened(&request, dir.path(), bytes), &sink, &sink.cancel),
            None => generate(&request, &sink, &sink.cancel),
        });
        assert!(matches!(result, Err(GenerateError::Cancelled)), "{result:?}");
        last = Some(sink.taken.into_inner().unwrap().expect("a checkpoint was taken"));
    }
    let checkpoint = opened(&request, dir.path(), &last.unwrap());
    hashes(on(threads, || resume(&request, checkpoint, &(), &CancelToken::default())).unwrap())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4))]
    #[test]
    fn a_run_interrupted_anywhere_gives_the_bytes_of_an_uninterrupted_one(
        rk4: bool,
        mut steps in prop::collection::btree_set(1u32..119, 1..4),
        threads in prop::collection::vec(1usize..4, 4),
    ) {
        // Strips test the other export path; a step between two recorded ones has a history.
        let spec = json!({ "solver": { "integrator": if rk4 { "rk4" } else { "euler" } }, "mesh": { "strips": rk4 } });
        let dir = tempfile::tempdir().unwrap();
        let request = request(small(&spec), Backend::Cpu, dir.path());
        let whole = on(2, || generate(&request, &(), &CancelToken::default()));
        steps.insert(57);
        let stops: Vec<(u32, usize)> = steps.into_iter().zip(threads.iter().copied()).collect();
        prop_assert_eq!(hashes(whole.unwrap()), interrupted(&request, &stops, threads[3]));
    }
}

#[test]
fn even_and_smooth_surfaces_continue_from_a_checkpoint() {
    for spec in [even(&json!({ "piece": { "from": 0.3 } })), json!({ "mesh": { "smooth_um": 5 } })] {
        let dir = tempfile::tempdir().unwrap();
        let request = request(small(&spec), Backend::Cpu, dir.path());
        let whole = generate(&request, &(), &CancelToken::default()).unwrap();
        assert_eq!(hashes(whole), interrupted(&request, &[(50, 1), (95, 2)], 2));
    }
}

/// A tube whose slabs must be mended: sections are added, and diagonals flipped.
#[test]
fn mended_slabs_are_mended_again_in_the_same_way() {
    let spec = json!({ "steps": 200, "solver": { "record_every": 40 }, "length_mm": 0.6,
        "particles": { "total": { "keys": [[0, 260], [1, 1500]] }, "outer": { "keys": [[0, 60], [1, 90]] } } });
    let dir = tempfile::tempdir().unwrap();
    let request = request(small(&spec), Backend::Cpu, dir.path());
    let whole = generate(&request, &(), &CancelToken::default()).unwrap();
    let summary = &whole.findings.summary;
    assert!(
        summary.sections_added + summary.diagonals_flipped > 0,
        "the test needs a model that is mended: {summary:?}"
    );
    assert_eq!(hashes(whole), interrupted(&request, &[(90, 1), (165, 2), (199, 1)], 2));
}

#[test]
fn a_checkpoint_of_another_model_or_a_damaged_one_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let own = request(small(&json!({})), Backend::Cpu, dir.path());
    let sink = StopAt::new(20);
    generate(&own, &sink, &sink.cancel).unwrap_err();
    let bytes = sink.taken.into_inner().unwrap().unwrap();
    let read = Checkpoint::read(&own, Cursor::new(&bytes)).unwrap();
    assert_eq!((read.accepted.len(), read.recorded), (3, 3), "steps 0, 10 and 20");
    let other = Request { seed: 8, ..own.clone() };
    assert!(matches!(Checkpoint::read(&other, Cursor::new(&bytes)), Err(CheckpointError::Foreign)));
    for at in [0, 9, 100, bytes.len() / 2, bytes.len() - 1] {
        let mut broken = bytes.clone();
        broken[at] ^= 1;
        assert!(matches!(Checkpoint::read(&own, Cursor::new(&broken)), Err(CheckpointError::Damaged(_))), "{at}");
        assert!(Checkpoint::read(&own, Cursor::new(&bytes[..at])).is_err(), "{at}");
    }
}

/// Checkpoints that are complete and of this model, but from which the simulation or the loft
/// cannot continue.
#[test]
fn a_checkpoint_that_does_not_restore_costs_time_only() {
    let spec = json!({});
    let dir = tempfile::tempdir().unwrap();
    let request = request(small(&spec), Backend::Cpu, dir.path());
    let sink = StopAt::new(20);
    let broken = on(2, || generate(&request, &sink, &sink.cancel)).unwrap_err();
    assert!(matches!(broken, GenerateError::Cancelled), "{broken}");
    let bytes = sink.taken.lock().unwrap().take().unwrap();
    let whole = hashes(on(2, || generate(&request, &(), &CancelToken::default())).unwrap());
    let parts = |simulation: Option<Vec<u8>>, spoil: fn(&mut Section)| {
        let mut checkpoint = Checkpoint::read(&request, Cursor::new(&bytes)).unwrap();
        let mut accepted: Vec<Section> = checkpoint.accepted().map(Result::unwrap).collect();
        accepted.iter_mut().for_each(spoil);
        let parts = CheckpointParts {
            simulation: simulation.as_ref().unwrap_or(&checkpoint.simulation),
            accepted: &mut |mut out| write_sections(&accepted, &request.metadata(0), &mut out),
            history: &checkpoint.history,
            flipped: 0,
            recorded: checkpoint.recorded,
        };
        parts.write(&request, Vec::new()).unwrap()
    };
    let no_state = parts(Some(vec![7; 40]), |_| ());
    let no_surface = parts(None, |section| section.inner = section.outer.clone());
    for damaged in [no_state, no_surface] {
        let again = on(2, || resume(&request, opened(&request, dir.path(), &damaged), &(), &CancelToken::default()));
        assert_eq!(hashes(again.unwrap()), whole);
    }
}
