//! Generations on separate threads: the common part of the CPU and GPU backends.

pub(super) mod cpu;
pub(super) mod gpu;

use super::generator::{GenerationInput, WorkError};
use super::progress::AttemptSink;
use super::verdict::{self, Verdict};
use crate::fit::FitSpec;
use crate::generate::{CancelToken, Cost, FileOutput, GenerateError, Outcome, Request, Seconds, UsedBackend};
use crate::jobs::scratch::AttemptDir;
use crate::jobs::{Job, JobKind};
use crate::spec::{self, Fault, ModelSpec};
use std::future::Future;
use std::path::PathBuf;
use std::pin::Pin;
use std::sync::Arc;

/// Input of a generation. Owned, because the thread may outlive the attempt that started it.
pub(super) struct Task {
    pub(super) job: Job,
    /// The spec of a model, read before the threads were free.
    pub(super) spec: Option<ModelSpec>,
    pub(super) dir: Arc<AttemptDir>,
    pub(super) sink: Arc<AttemptSink>,
    pub(super) cancel: CancelToken,
    pub(super) memory_limit_bytes: Option<u64>,
    pub(super) checkpoint: Option<PathBuf>,
}

/// Reason why a generation has no result.
pub(super) enum GenerateFailure {
    /// The attempt ends with this verdict.
    Verdict(Verdict),
    /// The GPU could not grow the model; a CPU may.
    Gpu(String),
}

impl From<WorkError> for GenerateFailure {
    fn from(error: WorkError) -> Self {
        match error {
            WorkError::Generate(GenerateError::Gpu(error)) => Self::Gpu(error.to_string()),
            error => Self::Verdict(verdict::of_error(&error)),
        }
    }
}

type Result<T> = std::result::Result<T, GenerateFailure>;

/// Result of a generation or a fit.
pub(super) struct GenerationOutput {
    /// The backend that computed it.
    pub(super) used: UsedBackend,
    /// Description of the device.
    pub(super) device: String,
    /// Files in the directory of the attempt.
    pub(super) files: Vec<FileOutput>,
    /// Summary for the record.
    pub(super) summary: serde_json::Value,
    /// Times of the stages of a model.
    pub(super) seconds: Option<Seconds>,
}

impl From<Outcome> for GenerationOutput {
    fn from(outcome: Outcome) -> Self {
        let summary = outcome.findings.figures();
        let Outcome { used, device, files, seconds, .. } = outcome;
        Self { used, device, files, summary, seconds: Some(seconds) }
    }
}

/// A running generation. Dropping this value tells it to stop; its thread ends by itself.
pub(super) struct Generation {
    result: Pin<Box<dyn Future<Output = Result<GenerationOutput>> + Send>>,
    cancel: CancelToken,
}

impl Generation {
    /// A generation whose `result` resolves when its threads have stopped, even after `cancel`.
    fn new(result: impl Future<Output = Result<GenerationOutput>> + Send + 'static, cancel: CancelToken) -> Self {
        Self { result: Box::pin(result), cancel }
    }

    /// A generation that a GPU could not begin.
    pub(super) fn refused(reason: String) -> Self {
        Self::new(async move { Err(GenerateFailure::Gpu(reason)) }, CancelToken::default())
    }

    /// Waits for the result. May be dropped and called again until it has resolved.
    pub(super) fn result(&mut self) -> impl Future<Output = Result<GenerationOutput>> + '_ {
        &mut self.result
    }

    /// Tells the generation to stop.
    pub(super) fn stop(&self) {
        self.cancel.cancel();
    }
}

impl Drop for Generation {
    fn drop(&mut self) {
        self.cancel.cancel();
    }
}

/// Predicted cost of a job.
pub(super) struct Prediction {
    /// Time on one core, seconds.
    pub(super) seconds: f64,
    /// Size of all files, bytes.
    pub(super) bytes: u64,
    /// The spec of a model.
    pub(super) spec: Option<ModelSpec>,
}

/// Predicts the cost of a job; `None` if its spec is not valid for this engine.
pub(super) fn predict(job: &Job) -> Option<Prediction> {
    if job.kind == JobKind::Fit {
        return fit_of(job).ok().map(|fit| Prediction { seconds: fit.predicted_seconds(), bytes: 0, spec: None });
    }
    let spec = resolve(job).ok()?;
    let cost = Cost::new(&spec, &job.outputs);
    let bytes = cost.bytes.values().fold(0_u64, |sum, bytes| sum.saturating_add(*bytes));
    Some(Prediction { seconds: cost.longest_seconds(), bytes, spec: Some(spec) })
}

/// The request of a fit.
fn fit_of(job: &Job) -> std::result::Result<FitSpec, WorkError> {
    FitSpec::read(&job.spec, Vec::new(), &[]).map_err(|faults| invalid(&faults))
}

fn resolve(job: &Job) -> std::result::Result<ModelSpec, WorkError> {
    // A canonical spec contains every parameter, so it resolves to the same spec on any preset.
    let preset = spec::preset(&job.preset).unwrap_or(&spec::presets()[0]);
    ModelSpec::resolve(preset, &job.spec).map_err(|faults| invalid(&faults))
}

fn invalid(faults: &[Fault]) -> WorkError {
    let faults: Vec<String> = faults.iter().map(ToString::to_string).collect();
    WorkError::Spec { detail: faults.join("; ") }
}

fn request(input: GenerationInput<'_>) -> std::result::Result<Request, WorkError> {
    let job = input.job;
    Ok(Request {
        preset: job.preset.clone(),
        spec: input.spec.map_or_else(|| resolve(job), |spec| Ok(spec.clone()))?,
        seed: job.seed,
        backend: input.backend.into(),
        outputs: job.outputs.clone(),
        dir: input.dir.to_owned(),
        memory_limit_bytes: input.memory_limit_bytes,
    })
}
