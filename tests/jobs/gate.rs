//! Scripts that run until a test opens a gate, and a counter of concurrent generations.
//!
//! The gate is a file in the place's directory, so all processes that work there share it.

use crate::scripted::{Place, generate};
use oviduct::generate::{CancelToken, Outcome, Sink};
use oviduct::worker::{GenerationInput, Generator, WorkError};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

/// Path of the gate file of a place.
pub fn file(place: &Path) -> PathBuf {
    place.join("go")
}

/// Spec of a job whose script may wait for the gate of a place.
pub fn spec(place: &Path, script: &str) -> serde_json::Value {
    serde_json::json!({ "script": script, "gate": file(place) })
}

/// True if the gate in a job's spec is open, or if its directory is gone because the test failed.
pub fn is_open(spec: &serde_json::Value) -> bool {
    let gate = Path::new(spec["gate"].as_str().expect("a job that was queued at a place"));
    gate.exists() || !gate.parent().is_some_and(Path::exists)
}

impl Place {
    pub fn open_gate(&self) {
        std::fs::write(file(&self.dir), "").unwrap();
    }

    pub fn close_gate(&self) {
        std::fs::remove_file(file(&self.dir)).unwrap();
    }
}

/// Counts concurrent generations.
#[derive(Debug, Default)]
pub struct Busy {
    now: AtomicU32,
    most: AtomicU32,
}

impl Busy {
    /// The scripted generator, which this counter observes.
    pub fn generator(self: &Arc<Self>) -> Arc<Generator> {
        let busy = Arc::clone(self);
        Arc::new(
            move |input: GenerationInput<'_>, sink: &dyn Sink, cancel: &CancelToken| -> Result<Outcome, WorkError> {
                let one = RunningGeneration::more(&busy);
                let made = generate(input, sink, cancel);
                drop(one);
                made
            },
        )
    }

    /// Maximum number of concurrent generations.
    pub fn most(&self) -> u32 {
        self.most.load(Ordering::SeqCst)
    }
}

/// Marks one generation as running until it is dropped, even by a panic.
struct RunningGeneration<'a>(&'a Busy);

impl<'a> RunningGeneration<'a> {
    fn more(busy: &'a Busy) -> Self {
        busy.most.fetch_max(busy.now.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
        Self(busy)
    }
}

impl Drop for RunningGeneration<'_> {
    fn drop(&mut self) {
        self.0.now.fetch_sub(1, Ordering::SeqCst);
    }
}
