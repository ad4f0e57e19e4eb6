//! What a service does on the side, as long as it runs: removes models that are not kept any longer, and files that no
//! model names.

use crate::clock::Clock;
use crate::jobs::Store;
use crate::jobs::artifacts::Artifacts;
use crate::jobs::sweep::Retention;
use crate::metrics::Metrics;
use std::sync::Arc;
use std::time::Duration;
use tokio::task::JoinSet;

/// Time between looks at what is kept.
const RETENTION_EVERY: Duration = Duration::from_secs(60);
/// Time between sums of the bytes of all files, which are for the eyes of operators alone.
const BYTES_EVERY: Duration = Duration::from_secs(15 * 60);
/// Time between sweeps of files that no model names.
const ORPHANS_EVERY: Duration = Duration::from_secs(6 * 60 * 60);
/// Age from which a file that no model names is nobody's, where uploads may be under way: longer than one takes with
/// its commit.
pub(super) const ORPHAN_AGE: Duration = Duration::from_secs(24 * 60 * 60);

/// Tasks that end when this is dropped.
pub(super) struct Upkeep {
    _tasks: JoinSet<()>,
}

/// What they work on.
#[derive(Clone)]
pub(super) struct Ground {
    pub(super) store: Arc<dyn Store>,
    pub(super) artifacts: Artifacts,
    pub(super) clock: Clock,
    pub(super) metrics: Metrics,
}

impl Upkeep {
    /// Starts. At first, files older than `left` that no model names go: none of them can be in the making where this
    /// process has the stores to itself, so it may be zero then. Later, those older than [`ORPHAN_AGE`].
    pub(super) fn start(ground: Ground, retention: Retention, left: Duration) -> Self {
        let mut tasks = JoinSet::new();
        // Before any worker begins: what is younger than this is not left from before.
        let start = ground.clock.now();
        let orphans = ground.clone();
        tasks.spawn(async move {
            orphans.sweep_orphans(start, left).await;
            loop {
                tokio::time::sleep(ORPHANS_EVERY).await;
                orphans.sweep_orphans(orphans.clock.now(), ORPHAN_AGE).await;
            }
        });
        let kept = ground.clone();
        tasks.spawn(async move {
            while retention != Retention::default() {
                kept.retain(retention).await;
                tokio::time::sleep(RETENTION_EVERY).await;
            }
        });
        tasks.spawn(async move {
            // The sweep of what there is no room for tells it too, and more often.
            while retention.bytes.is_none() {
                ground.tell_bytes().await;
                tokio::time::sleep(BYTES_EVERY).await;
            }
        });
        Self { _tasks: tasks }
    }
}

impl Ground {
    async fn sweep_orphans(&self, now: jiff::Timestamp, age: Duration) {
        match self.artifacts.sweep_orphans(self.store.as_ref(), now, age).await {
            Ok(0) => {}
            Ok(files) => tracing::info!(files, "files that no model names were removed"),
            Err(error) => tracing::warn!(%error, "files that no model names could not be removed"),
        }
    }

    async fn retain(&self, retention: Retention) {
        match retention.sweep(self.store.as_ref(), &self.artifacts).await {
            Ok(swept) => {
                self.metrics.removed(swept.removed);
                if let Some(bytes) = swept.stored_bytes {
                    self.metrics.set_stored_bytes(bytes);
                }
            }
            Err(error) => tracing::warn!(%error, "models that are not kept any longer could not be removed"),
        }
    }

    async fn tell_bytes(&self) {
        match self.store.stored_bytes().await {
            Ok(bytes) => self.metrics.set_stored_bytes(bytes),
            Err(error) => tracing::warn!(%error, "the bytes of all files could not be summed"),
        }
    }
}
