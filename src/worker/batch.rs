//! The attempts of a batch side by side: one generation of all of them, each with its own lease, cancel and end.

use super::attempt::{self, Context, Next, Prepared};
use super::follow::{Cpu, Start};
use super::generation::{Generation, Unmade};
use super::generator::{BatchGenerator, BatchWork, Work, WorkError};
use super::verdict;
use crate::generate::{Backend, GenerateError, Outcome};
use crate::jobs::{BackendReport, ClaimedJob, Job};
use futures_util::future::join_all;
use rayon::ThreadPool;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, PoisonError};
use tokio::sync::oneshot;
use tokio::task::JoinHandle;

type Answer = oneshot::Sender<Result<Outcome, WorkError>>;

/// What a GPU worker has.
pub(super) struct Gpu {
    pub(super) generator: Arc<dyn BatchGenerator>,
    /// One thread more than the worker has: it drives the device.
    pub(super) pool: Arc<ThreadPool>,
}

/// Runs what of `claimed` fits together, gives back the rest, and ends each; keeps the right to claim the `next` batch until
/// the device is free, which is before the files of this one are stored. Returns how many jobs ended.
pub(super) async fn run(context: &Context, gpu: &Gpu, cpu: &Cpu<'_>, claimed: Vec<ClaimedJob>, next: Next) -> u64 {
    let jobs: Vec<Job> = claimed.iter().map(|claimed| claimed.job().clone()).collect();
    let generator = Arc::clone(&gpu.generator);
    let admitted = tokio::task::spawn_blocking(move || generator.admit(&jobs.iter().collect::<Vec<_>>())).await;
    let admitted = admitted.unwrap_or_else(|panic| Err(format!("the GPU worker panicked: {panic}")));
    let admits = |place: usize| admitted.as_ref().map_or(place == 0, |admitted| admitted[place]);

    let (mut members, mut prepared) = (Vec::new(), Vec::new());
    let mut ended = 0;
    for (place, claimed) in claimed.into_iter().enumerate() {
        if !admits(place) {
            give_back(context, claimed).await;
            continue;
        }
        match attempt::prepare(context, &claimed).await {
            Ok(ready) => {
                prepared.push(ready);
                members.push(claimed);
            }
            Err(refusal) => ended += u64::from(attempt::refuse(context, claimed, report(gpu, &[]), refusal).await),
        }
    }
    tracing::info!(device = gpu.generator.device(), jobs = members.len(), "batch begins");
    let (generations, thread) = match &admitted {
        Ok(_) => generate(context, gpu, &members, &prepared),
        Err(reason) => (prepared.iter().map(|ready| unmade(ready, reason)).collect(), None),
    };
    let attempts = members.into_iter().zip(prepared).zip(generations).map(|((claimed, ready), generation)| {
        let report = BackendReport { requested: claimed.job().backend.requested, ..report(gpu, &[&claimed]) };
        attempt::run(context, claimed, report, ready, Start::Made(generation), cpu)
    });
    let device = async {
        if let Some(thread) = thread {
            // The memory of the device is free only now. What went wrong was told to the members.
            let _ = thread.await;
        }
        drop(next);
    };
    let (ends, ()) = tokio::join!(join_all(attempts), device);
    ended + ends.into_iter().map(u64::from).sum::<u64>()
}

fn report(gpu: &Gpu, claimed: &[&ClaimedJob]) -> BackendReport {
    BackendReport {
        requested: claimed.first().map_or(Backend::Gpu, |claimed| claimed.job().backend.requested),
        used: Some(Backend::Gpu),
        device: Some(gpu.generator.device()),
        fallback: None,
    }
}

async fn give_back(context: &Context, claimed: ClaimedJob) {
    let id = claimed.job().id;
    if let Err(error) = context.store.release(claimed).await {
        tracing::warn!(job = %id, %error, "a job that does not fit the batch was not given back");
    }
}

/// A generation that the device never began.
fn unmade(ready: &Prepared, reason: &str) -> Generation {
    let reason = reason.to_owned();
    Generation::new(Box::pin(async move { Err(Unmade::Gpu(reason)) }), ready.cancel.clone())
}

/// Starts the generation of all members on a thread that may block; each gets its own end of it.
fn generate(
    context: &Context,
    gpu: &Gpu,
    members: &[ClaimedJob],
    prepared: &[Prepared],
) -> (Vec<Generation>, Option<JoinHandle<()>>) {
    let memory_limit_bytes = context.options.memory_limit_bytes;
    let mut answers: Vec<Mutex<Option<Answer>>> = Vec::new();
    let mut generations = Vec::new();
    for ready in prepared {
        let (answer, result) = oneshot::channel();
        answers.push(Mutex::new(Some(answer)));
        let made = async move {
            match result.await {
                Ok(Ok(outcome)) => Ok(outcome),
                Ok(Err(WorkError::Generate(GenerateError::Gpu(error)))) => Err(Unmade::Gpu(error.to_string())),
                Ok(Err(error)) => Err(Unmade::Verdict(verdict::of_error(&error))),
                Err(_) => Err(Unmade::Verdict(verdict::of_silence())),
            }
        };
        generations.push(Generation::new(Box::pin(made), ready.cancel.clone()));
    }
    if generations.is_empty() {
        return (generations, None);
    }
    let jobs: Vec<Job> = members.iter().map(|claimed| claimed.job().clone()).collect();
    let parts: Vec<_> = prepared.iter().map(|p| (Arc::clone(&p.dir), Arc::clone(&p.live), p.cancel.clone())).collect();
    let (generator, pool) = (Arc::clone(&gpu.generator), Arc::clone(&gpu.pool));
    let thread = tokio::task::spawn_blocking(move || {
        let works: Vec<BatchWork<'_>> = jobs
            .iter()
            .zip(&parts)
            .map(|(job, (dir, live, cancel))| {
                let work = Work { job, backend: Backend::Gpu, dir: dir.path(), memory_limit_bytes, checkpoint: None };
                BatchWork { work, sink: &**live, cancel }
            })
            .collect();
        let tell = |place: usize, result| {
            let answer = answers[place].lock().unwrap_or_else(PoisonError::into_inner).take();
            // Whoever is gone was cancelled or lost its lease.
            answer.map(|answer| answer.send(result).is_ok());
        };
        let caught = catch_unwind(AssertUnwindSafe(|| pool.install(|| generator.generate(&works, &|i, r| tell(i, r)))));
        if let Err(panic) = caught {
            let detail = verdict::message(panic.as_ref());
            for place in 0..works.len() {
                tell(place, Err(GenerateError::Panic { detail: detail.clone() }.into()));
            }
        }
    });
    (generations, Some(thread))
}
