//! Periodic maintenance by `serve`: deletes models past their retention and files that no record
//! names, queues jobs that wait for nothing, and reports the size of all files. Processes of
//! `worker` do none of it. Of several `serve` processes with one store, one sweeps at a time.

use crate::clock::Clock;
use crate::jobs::artifacts::Artifacts;
use crate::jobs::jumps::Jump;
use crate::jobs::sweep::{Retention, Sweeper};
use crate::jobs::{Mismatch, Store, UpkeepRound};
use crate::metrics::Metrics;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio::task::JoinSet;

/// Interval between rounds: observation and sweep by retention.
const ROUNDS_EVERY: Duration = Duration::from_secs(60);
/// Interval between measurements of the size of all files, which is only a metric.
const BYTES_EVERY: Duration = Duration::from_secs(15 * 60);
/// Interval between searches for jobs that wait for an equal job that has ended.
const STRANDED_EVERY: Duration = Duration::from_secs(60);
/// Interval between sweeps of orphans.
const ORPHANS_EVERY: Duration = Duration::from_secs(6 * 60 * 60);
/// Minimum age of a deleted orphan: longer than an upload and its commit take, and time for an
/// operator to notice that files lost their records.
const ORPHAN_AGE: Duration = Duration::from_secs(24 * 60 * 60);

/// The stores to maintain and the metrics to report to.
#[derive(Clone)]
pub(super) struct UpkeepContext {
    pub(super) store: Store,
    pub(super) artifacts: Artifacts,
    pub(super) metrics: Metrics,
    /// Locations of both stores, for messages.
    pub(super) locations: Locations,
}

/// Locations of the stores, for messages, without credentials.
#[derive(Clone, Debug)]
pub(super) struct Locations {
    pub(super) jobs: String,
    pub(super) artifacts: String,
}

/// Starts the maintenance tasks. The first round compares the two stores, and the clock with the
/// time of the last round, unless `trust` is true; orphans are swept after it. Dropping the result
/// stops the tasks.
pub(super) fn start(context: UpkeepContext, retention: Retention, trust: bool) -> JoinSet<()> {
    let mut tasks = JoinSet::new();
    let owner = uuid::Uuid::now_v7().to_string();
    let sweeper = Arc::new(Sweeper::new(context.store.clone(), context.artifacts.clone(), owner));
    let (observed, mut observations) = watch::channel(None);
    let (orphans, locations) = (Arc::clone(&sweeper), context.locations.clone());
    tasks.spawn(async move {
        // Fails if the other task has stopped, which happens only together with this one.
        while let Ok(Some(found)) = observations.wait_for(Option::is_some).await.map(|found| found.clone()) {
            sweep_orphans(&orphans, found, &locations).await;
            tokio::time::sleep(ORPHANS_EVERY).await;
        }
    });
    let store = context.store.clone();
    tasks.spawn(async move {
        loop {
            match store.queue_stranded().await {
                Ok(jobs) if jobs.is_empty() => {}
                Ok(jobs) => tracing::info!(?jobs, "jobs waited for an equal job that had ended; they are queued"),
                Err(error) => tracing::warn!(%error, "jobs that wait for nothing could not be looked for"),
            }
            tokio::time::sleep(STRANDED_EVERY).await;
        }
    });
    let expired = context.clone();
    tasks.spawn(async move {
        let mut trust = trust;
        loop {
            match sweeper.observe(retention, trust).await {
                Ok(round) => {
                    trust = false;
                    observed.send_replace(Some(round.state.mismatch.clone()));
                    expired.sweep_expired(&sweeper, retention, &round).await;
                }
                Err(error) => tracing::warn!(%error, "a round of upkeep failed; the next one is in a minute"),
            }
            tokio::time::sleep(ROUNDS_EVERY).await;
        }
    });
    tasks.spawn(async move {
        // With a limit on bytes, the sweep by retention reports the size, and more often.
        while retention.bytes.is_none() {
            context.report_bytes().await;
            tokio::time::sleep(BYTES_EVERY).await;
        }
    });
    tasks
}

impl UpkeepContext {
    async fn sweep_expired(&self, sweeper: &Sweeper, retention: Retention, round: &UpkeepRound) {
        // Without a limit on age, a jump is only recorded.
        if let (Some(Jump { by, .. }), Some(_)) = (round.jump, retention.age) {
            self.metrics.clock_jumped();
            let (now, by) = (round.state.seen_at, jiff::SignedDuration::try_from(by).unwrap_or_default());
            tracing::warn!(
                %now, by = format!("{by:#}"),
                "the clock of the job store advanced by more time than passed while this service watched: the clock was \
                 set, or no service ran. This round of retention was skipped, and this time does not count for --keep. \
                 If the clock is wrong, correct it. To count the time, start once with --sweep-now"
            );
            return;
        }
        if retention == Retention::default() {
            return;
        }
        match sweeper.retain(retention, &round.state).await {
            Ok(Some(swept)) => {
                self.metrics.removed(swept.removed);
                if let Some(bytes) = swept.stored_bytes {
                    self.metrics.set_stored_bytes(bytes);
                }
            }
            // Another process sweeps.
            Ok(None) if retention.bytes.is_some() => self.report_bytes().await,
            Ok(None) => {}
            Err(error) => tracing::warn!(%error, "models past their retention could not be deleted"),
        }
    }

    async fn report_bytes(&self) {
        match self.store.stored_bytes().await {
            Ok(bytes) => self.metrics.set_stored_bytes(bytes),
            Err(error) => tracing::warn!(%error, "the size of all files could not be summed"),
        }
    }
}

async fn sweep_orphans(sweeper: &Sweeper, mismatch: Option<Mismatch>, locations: &Locations) {
    if let Some(Mismatch { is_new, example }) = mismatch {
        let reason = if is_new {
            "the job store is new, but the artifact store already has files"
        } else {
            "the artifact store has models that were made after the newest record of the job store"
        };
        tracing::warn!(
            job_store = locations.jobs,
            artifact_store = locations.artifacts,
            example,
            "{reason}; no orphans will be deleted. If --database or --artifacts is wrong, stop this process, correct \
             it and start again. If both are right and the unknown files may be deleted, start once with --sweep-now. \
             See docs/operations.md, \"Files without records\""
        );
        return;
    }
    match sweeper.sweep_orphans(Clock::System.now(), ORPHAN_AGE, ORPHANS_EVERY).await {
        Ok(None | Some(0)) => {}
        Ok(Some(files)) => tracing::info!(files, "orphaned files were deleted"),
        Err(error) => tracing::warn!(%error, "orphaned files could not be deleted"),
    }
}
