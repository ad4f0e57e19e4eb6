//! Models grown in this process without a service, as the baseline of a load test.

use super::errors::Lost;
use super::seeds::Seeds;
use crate::cli::exit::Failure;
use crate::clock::Stopwatch;
use crate::generate::{Backend, CancelToken, Outputs, Request, generate};
use crate::spec::ModelSpec;
use anyhow::Context;
use std::sync::Arc;
use tokio::task::JoinSet;

/// The models that [`direct`] grows.
#[derive(Clone, Debug)]
pub struct Model {
    /// Name of the preset that the spec changes.
    pub preset: String,
    /// The spec.
    pub spec: Arc<ModelSpec>,
    /// Backend that grows the models.
    pub backend: Backend,
    /// Files to write.
    pub outputs: Outputs,
}

/// A model that ended.
#[derive(Debug)]
pub struct Grown {
    /// Time of the generation.
    pub seconds: f64,
    /// True if the model was grown and certified.
    pub succeeded: bool,
    pub(super) bytes: u64,
}

/// Grows the models of these seeds in this process, `concurrency` at a time, each on `threads`
/// threads.
///
/// # Errors
/// If threads cannot be started, or a task panics.
pub async fn direct(
    model: &Model,
    seeds: Seeds,
    concurrency: u32,
    threads: usize,
) -> Result<Vec<Result<Grown, Lost>>, Failure> {
    let mut tasks: JoinSet<anyhow::Result<Vec<_>>> = JoinSet::new();
    for _ in 0..concurrency {
        let (model, seeds) = (model.clone(), seeds.clone());
        tasks.spawn_blocking(move || {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            let pool = pool.context("the threads could not be started")?;
            let one = |seed| pool.install(|| grow(&model, seed)).map_err(Lost::from);
            Ok(std::iter::from_fn(|| seeds.take()).map(one).collect())
        });
    }
    let mut all = Vec::new();
    while let Some(done) = tasks.join_next().await {
        all.extend(done.context("a task panicked")??);
    }
    Ok(all)
}

/// Grows one model in this process.
fn grow(model: &Model, seed: u64) -> Result<Grown, Failure> {
    let temp = std::env::temp_dir();
    let dir = tempfile::tempdir_in(&temp).with_context(|| temp.display().to_string())?;
    let request = Request {
        preset: model.preset.clone(),
        spec: ModelSpec::clone(&model.spec),
        seed,
        backend: model.backend,
        outputs: model.outputs.clone(),
        dir: dir.path().to_owned(),
        memory_limit_bytes: None,
    };
    let watch = Stopwatch::start();
    let outcome = generate(&request, &(), &CancelToken::default());
    let seconds = watch.seconds();
    let bytes = outcome.as_ref().map_or(0, |outcome| outcome.files.iter().map(|file| file.bytes).sum());
    Ok(Grown { seconds, succeeded: outcome.is_ok(), bytes })
}
