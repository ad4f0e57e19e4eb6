//! From the start of a generation to its outcome: the lease is kept, checkpoints are stored, the time that it may take
//! is watched, and what a GPU could not do goes on on the CPU.

use super::attempt::{Context, Prepared};
use super::generation::{Generation, Threads, Unmade, generate};
use super::keeper::{Interrupt, Keeper};
use super::live::Live;
use super::saver::Saver;
use super::turn::{Patience, Turn, Turns};
use super::verdict::{self, Verdict};
use crate::clock::Stopwatch;
use crate::generate::{Backend, CancelToken, Outcome};
use crate::jobs::{BackendReport, ClaimedJob};
use crate::metrics::Fallback;
use bytes::Bytes;
use rayon::ThreadPool;
use std::future::Future;
use std::sync::Arc;
use std::time::Duration;

/// How long the record of an attempt that was broken off waits for its thread.
const STOP_WAIT: Duration = Duration::from_millis(300);
/// How long an attempt that is given back waits for its last checkpoint to be taken and stored.
const SAVE_WAIT: Duration = Duration::from_secs(6);

/// Where the generation of an attempt comes from.
pub(super) enum Start {
    /// It is to be begun on these threads of the CPU, once it is its turn.
    Cpu(Arc<ThreadPool>),
    /// It has begun, as a member of a batch.
    Made(Generation),
}

/// The CPU of a worker: where a job runs, or goes on that a GPU could not do. One at a time.
pub(super) struct Cpu<'a> {
    pub(super) threads: &'a Threads,
    pub(super) turns: &'a Arc<Turns>,
}

/// Why there is no outcome.
pub(super) enum Broken {
    /// It was broken off.
    Interrupted(Interrupt),
    /// It failed.
    Failed(Verdict),
}

/// What an attempt leaves behind.
#[derive(Default)]
pub(super) struct Leavings {
    /// A generation that was broken off and has not stopped yet.
    pub(super) generation: Option<Generation>,
    /// The checkpoint that the record named last.
    pub(super) checkpoint: Option<String>,
}

/// Follows the generation of one attempt.
pub(super) struct Follower<'a> {
    context: &'a Context,
    claimed: &'a ClaimedJob,
    prepared: &'a Prepared,
    keeper: Keeper<'a>,
    saver: Saver<'a>,
    watch: Stopwatch,
    /// Time of `watch` that it only waited for its turn.
    waited: Duration,
    leavings: Leavings,
}

impl<'a> Follower<'a> {
    pub(super) fn new(
        context: &'a Context,
        claimed: &'a ClaimedJob,
        prepared: &'a Prepared,
        report: &BackendReport,
    ) -> Self {
        Self {
            context,
            claimed,
            prepared,
            keeper: Keeper::new(context, claimed, report.clone(), &prepared.live),
            saver: Saver::new(context, claimed, &prepared.live),
            watch: Stopwatch::start(),
            waited: Duration::ZERO,
            leavings: Leavings::default(),
        }
    }

    /// Drives `work` while keeping the lease.
    pub(super) async fn keep<T>(&mut self, work: impl Future<Output = T>) -> Result<T, Interrupt> {
        self.keeper.keep(work).await
    }

    /// What is to be cleared away after the attempt.
    pub(super) fn leavings(self) -> Leavings {
        self.leavings
    }

    /// The outcome of the generation; its threads are free again by then, unless it was broken off and has not stopped
    /// yet. `report` says what computed it.
    pub(super) async fn outcome(
        &mut self,
        start: Start,
        report: &mut BackendReport,
        cpu: &Cpu<'_>,
    ) -> Result<Outcome, Broken> {
        let result = self.follow(start, report, cpu).await;
        match self.prepared.live.injected() {
            Some(injected) if !matches!(result, Err(Broken::Interrupted(_))) => {
                Err(Broken::Failed(verdict::of_injected(injected)))
            }
            _ => result,
        }
    }

    async fn follow(&mut self, start: Start, report: &mut BackendReport, cpu: &Cpu<'_>) -> Result<Outcome, Broken> {
        let Self { context, claimed, prepared, .. } = *self;
        let mut generation = match start {
            Start::Made(generation) => generation,
            Start::Cpu(pool) => {
                let (turn, from) = self.turn(cpu, Patience::Short).await?;
                self.watch = Stopwatch::start();
                generate(context, pool, turn, claimed, from, prepared, report.used.unwrap_or_default())
            }
        };
        loop {
            let made = self.keep_in_time(&mut generation).await;
            self.leavings.checkpoint = self.saver.named();
            let reason = match made {
                Ok(Ok(outcome)) => return Ok(outcome),
                Ok(Err(Unmade::Verdict(verdict))) => return Err(Broken::Failed(verdict)),
                Ok(Err(Unmade::Gpu(reason))) => reason,
                Err(broken) => {
                    // A GPU takes no checkpoints that another attempt could go on from.
                    let saves = report.used != Some(Backend::Gpu);
                    self.stop(generation, saves && matches!(broken, Broken::Interrupted(Interrupt::Shutdown))).await;
                    return Err(broken);
                }
            };
            if (report.requested, report.used) != (Backend::Auto, Some(Backend::Gpu)) {
                return Err(Broken::Failed(Verdict::Fail(verdict::of_gpu(reason))));
            }
            tracing::warn!(reason, "the job goes on on the CPU");
            context.options.metrics.fallback(Fallback::Device);
            let since = Stopwatch::start();
            let (turn, from) = self.turn(cpu, Patience::Long).await?;
            self.waited += since.elapsed();
            let (pool, now) = cpu.threads.choose(Backend::Cpu);
            *report = BackendReport { requested: report.requested, fallback: Some(reason), ..now };
            self.keeper.report(report.clone());
            // The old generation takes its token with it.
            let cancel = CancelToken::default();
            prepared.live.restart(cancel.clone());
            let again = Prepared { cancel, dir: Arc::clone(&prepared.dir), live: Arc::clone(&prepared.live) };
            generation = generate(context, pool, turn, claimed, from, &again, Backend::Cpu);
        }
    }

    /// Its turn on the CPU, and the checkpoint that an earlier attempt left. Where the turn does not come, the job goes back.
    async fn turn(&mut self, cpu: &Cpu<'_>, patience: Patience) -> Result<(Turn, Option<Bytes>), Broken> {
        let ready = async {
            let turn = cpu.turns.take(patience).await?;
            Some((turn, self.saver.load().await))
        };
        let ready = self.keeper.keep(ready).await.map_err(Broken::Interrupted)?;
        ready.ok_or_else(|| Broken::Failed(verdict::of_waiting()))
    }

    /// Drives a generation while keeping the lease and storing checkpoints, within the time that a job may take.
    async fn keep_in_time(&mut self, generation: &mut Generation) -> Result<Result<Outcome, Unmade>, Broken> {
        let (limit, spent) = (self.context.options.job_timeout, self.watch.elapsed().saturating_sub(self.waited));
        let late = async {
            match limit {
                Some(limit) => {
                    tokio::time::sleep(limit.saturating_sub(spent)).await;
                    limit
                }
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            kept = self.keeper.keep(generation.made()) => kept.map_err(Broken::Interrupted),
            limit = late => Err(Broken::Failed(verdict::of_timeout(limit))),
            never = self.saver.run() => match never {},
        }
    }

    /// Breaks a generation off, after a last checkpoint if it `saves`.
    async fn stop(&mut self, mut generation: Generation, saves: bool) {
        let mut running = true;
        if saves {
            running = last_checkpoint(self.context, &self.prepared.live, &mut self.saver, generation.made()).await;
            self.leavings.checkpoint = self.saver.named();
        }
        generation.stop();
        // Most stop within milliseconds: then the record says so once it is true.
        if running && tokio::time::timeout(STOP_WAIT, generation.made()).await.is_err() {
            self.leavings.generation = Some(generation);
        }
    }
}

/// Waits a little for a last checkpoint. Returns whether the thread is still at work.
async fn last_checkpoint<T>(
    context: &Context,
    live: &Live,
    saver: &mut Saver<'_>,
    made: impl Future<Output = T>,
) -> bool {
    live.ask_for_checkpoint();
    if !live.takes_checkpoints() {
        return true;
    }
    // Nobody renews the lease meanwhile.
    let left = context.options.lease.saturating_sub(context.options.heartbeat).mul_f32(0.75);
    tokio::select! {
        () = saver.save_next() => true,
        () = tokio::time::sleep(left.min(SAVE_WAIT)) => true,
        _ = made => false,
    }
}
