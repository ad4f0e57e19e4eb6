//! Periodic maintenance by `serve`: deletes models past their retention and files that no record
//! names, queues jobs that wait for nothing, and reports the size of all files. Processes of
//! `worker` do none of it. Of several `serve` processes with one store, one sweeps at a time.

use crate::clock::Clock;
use crate::jobs::Store;
use crate::jobs::artifacts::Artifacts;
use crate::jobs::sweep::{Retention, Sweeper};
use crate::metrics::Metrics;
use std::sync::Arc;
use std::time::Duration;
use tokio::task::JoinSet;

/// Interval between sweeps by retention.
const RETENTION_EVERY: Duration = Duration::from_secs(60);
/// Interval between measurements of the size of all files, which is only a metric.
const BYTES_EVERY: Duration = Duration::from_secs(15 * 60);
/// Interval between searches for jobs that wait for an equal job that has ended.
const STRANDED_EVERY: Duration = Duration::from_secs(60);
/// Interval between sweeps of orphans.
const ORPHANS_EVERY: Duration = Duration::from_secs(6 * 60 * 60);
/// Minimum age of a deleted orphan if other processes may be uploading; longer than an upload and
/// its commit take.
const ORPHAN_AGE: Duration = Duration::from_secs(24 * 60 * 60);

/// The stores to maintain and the metrics to report to.
#[derive(Clone)]
pub(super) struct UpkeepContext {
    pub(super) store: Store,
    pub(super) artifacts: Artifacts,
    pub(super) metrics: Metrics,
    /// Whether other processes may use the same stores.
    pub(super) shared: bool,
}

/// Starts the maintenance tasks. The first sweep deletes orphans older than [`ORPHAN_AGE`], or all
/// orphans older than this call if only this process uses the stores. Call it before any worker
/// starts. Dropping the result stops the tasks.
pub(super) fn start(context: UpkeepContext, retention: Retention) -> JoinSet<()> {
    let mut tasks = JoinSet::new();
    let owner = uuid::Uuid::now_v7().to_string();
    let sweeper = Arc::new(Sweeper::new(context.store.clone(), context.artifacts.clone(), owner));
    let start = Clock::System.now();
    let first_age = if context.shared { ORPHAN_AGE } else { Duration::ZERO };
    let orphans = Arc::clone(&sweeper);
    tasks.spawn(async move {
        sweep_orphans(&orphans, start, first_age).await;
        loop {
            tokio::time::sleep(ORPHANS_EVERY).await;
            sweep_orphans(&orphans, Clock::System.now(), ORPHAN_AGE).await;
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
        while retention != Retention::default() {
            expired.sweep_expired(&sweeper, retention).await;
            tokio::time::sleep(RETENTION_EVERY).await;
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
    async fn sweep_expired(&self, sweeper: &Sweeper, retention: Retention) {
        match sweeper.retain(retention).await {
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

async fn sweep_orphans(sweeper: &Sweeper, now: jiff::Timestamp, age: Duration) {
    match sweeper.sweep_orphans(now, age, ORPHANS_EVERY).await {
        Ok(None | Some(0)) => {}
        Ok(Some(files)) => tracing::info!(files, "orphaned files were deleted"),
        Err(error) => tracing::warn!(%error, "orphaned files could not be deleted"),
    }
}
