//! Removes models by age and total size, and files that no record names.
//!
//! Only ended jobs are ever removed. The record is deleted before the files, so a reader sees a whole model or
//! none; a file whose removal fails is an orphan, and the next sweep of orphans removes it.
//!
//! Of all processes that share the stores, one at a time sweeps: [`Sweeper`] holds a lock in the job store meanwhile.

use super::JobId;
use super::artifacts::{ArtifactError, Artifacts, MODELS, PROBES};
use super::store::{Store, StoreError, UpkeepTask};
use jiff::Timestamp;
use std::sync::Arc;
use std::time::Duration;

/// Jobs read at a time.
const PAGE: u32 = 100;
/// How long the lock on retention is kept after each page and each round. Rounds are a minute apart, so one process does
/// them all until it ends.
const RETENTION_LOCK: Duration = Duration::from_secs(3 * 60);
/// How long the lock on the sweep of orphans is kept after each page.
const ORPHANS_LOCK: Duration = Duration::from_secs(10 * 60);
/// Age from which a file left by a check of the artifact store is removed.
const PROBE_AGE: Duration = Duration::from_secs(60 * 60);

/// How much is kept. `None` and zero are no limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Retention {
    /// Time after its end that a job is kept.
    pub age: Option<Duration>,
    /// Bytes of all files together. Beyond it, the models that ended first are removed.
    pub bytes: Option<u64>,
}

/// The result of a sweep.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Swept {
    /// Jobs removed.
    pub removed: u64,
    /// Bytes of the files of all remaining jobs, if [`Retention::bytes`] limits them.
    pub stored_bytes: Option<u64>,
}

/// Sweeps the stores of a service, if no other process is doing so.
#[derive(Clone)]
pub struct Sweeper {
    store: Arc<dyn Store>,
    artifacts: Artifacts,
    /// Identifies this process.
    owner: String,
}

/// The lock of an upkeep task.
struct Lock<'s> {
    store: &'s dyn Store,
    task: UpkeepTask,
    owner: &'s str,
    lease: Duration,
}

impl Lock<'_> {
    /// Takes or renews the lock; `false` if another process has it.
    async fn hold(&self, lease: Duration) -> Result<bool, StoreError> {
        self.store.acquire_upkeep(self.task, self.owner, lease).await
    }
}

/// Whether a sweep may continue: always without a lock.
async fn may_continue(lock: Option<&Lock<'_>>) -> Result<bool, StoreError> {
    match lock {
        Some(lock) => lock.hold(lock.lease).await,
        None => Ok(true),
    }
}

impl Sweeper {
    /// A sweeper of this process.
    #[must_use]
    pub fn new(store: Arc<dyn Store>, artifacts: Artifacts) -> Self {
        Self { store, artifacts, owner: uuid::Uuid::now_v7().to_string() }
    }

    /// One round of retention, to be done every minute. `None` if another process does the rounds.
    ///
    /// # Errors
    /// As [`Retention::sweep`].
    pub async fn retain(&self, retention: Retention) -> Result<Option<Swept>, StoreError> {
        let store = &*self.store;
        let lock = Lock { store, task: UpkeepTask::Retention, owner: &self.owner, lease: RETENTION_LOCK };
        if !may_continue(Some(&lock)).await? {
            return Ok(None);
        }
        retention.sweep_while(store, &self.artifacts, Some(&lock)).await.map(Some)
    }

    /// Removes orphans, as [`Artifacts::sweep_orphans`] does; returns how many. `None` if another process is doing so, or did
    /// less than `every` ago: each process may call this every `every`, and one of them sweeps.
    ///
    /// # Errors
    /// As [`Artifacts::sweep_orphans`].
    pub async fn sweep_orphans(
        &self,
        now: Timestamp,
        age: Duration,
        every: Duration,
    ) -> Result<Option<u64>, ArtifactError> {
        let store = &*self.store;
        let lock = Lock { store, task: UpkeepTask::Orphans, owner: &self.owner, lease: ORPHANS_LOCK };
        if !may_continue(Some(&lock)).await? {
            return Ok(None);
        }
        let removed = orphans(store, &self.artifacts, now, age, Some(&lock)).await?;
        lock.hold(every).await?;
        Ok(Some(removed))
    }
}

impl Retention {
    /// Removes models that are too old by the store's clock, then models beyond the limit of bytes. No other process may
    /// sweep meanwhile: see [`Sweeper`].
    ///
    /// # Errors
    /// [`StoreError`]; models removed before it stay removed. Files that could not be removed are only logged.
    pub async fn sweep(&self, store: &dyn Store, artifacts: &Artifacts) -> Result<Swept, StoreError> {
        self.sweep_while(store, artifacts, None).await
    }

    async fn sweep_while(
        &self,
        store: &dyn Store,
        artifacts: &Artifacts,
        lock: Option<&Lock<'_>>,
    ) -> Result<Swept, StoreError> {
        let mut swept = Swept::default();
        if let Some(age) = self.age.filter(|age| !age.is_zero()) {
            while may_continue(lock).await? {
                let old = store.ended(Some(age), PAGE).await?;
                for &id in &old {
                    swept.removed += u64::from(remove(store, artifacts, id).await?.is_some());
                }
                if old.len() < PAGE as usize {
                    break;
                }
            }
        }
        if let Some(most) = self.bytes.filter(|most| *most > 0) {
            while may_continue(lock).await? {
                // Read again for each page: clients delete models too, and workers add some.
                let mut stored = store.stored_bytes().await?;
                swept.stored_bytes = Some(stored);
                let oldest = if stored > most { store.ended(None, PAGE).await? } else { Vec::new() };
                if oldest.is_empty() {
                    break;
                }
                for id in oldest {
                    // Removed by someone else: the sum may or may not include its bytes.
                    let Some(freed) = remove(store, artifacts, id).await? else { break };
                    swept.removed += 1;
                    stored = stored.saturating_sub(freed);
                    if stored <= most {
                        break;
                    }
                }
            }
        }
        Ok(swept)
    }
}

/// Removes a model; gives the bytes of the files that no other model has, `None` if it had been removed already.
async fn remove(store: &dyn Store, artifacts: &Artifacts, id: JobId) -> Result<Option<u64>, StoreError> {
    // An ended job does not change.
    let files = store.get(id).await?.map(|job| job.files).unwrap_or_default();
    let Some(keys) = store.delete(id).await? else {
        return Ok(None);
    };
    if let Err(error) = artifacts.delete(&keys).await {
        tracing::warn!(%error, "files of a removed model are left to the sweep of orphans");
    }
    tracing::info!(job = %id, "a model was removed by age or size");
    Ok(Some(files.iter().filter(|file| keys.contains(&file.key)).map(|file| file.bytes).sum()))
}

impl Artifacts {
    /// Removes files older than `age` that no job names: left by attempts that lost their lease, or by a
    /// process that died between upload and commit. Files of running attempts stay whatever their times are, because these
    /// may be by another clock. Returns how many were removed. Files of checks go after an hour.
    ///
    /// # Errors
    /// [`ArtifactError::Store`], [`ArtifactError::Jobs`]; files removed before it stay removed.
    pub async fn sweep_orphans(&self, jobs: &dyn Store, now: Timestamp, age: Duration) -> Result<u64, ArtifactError> {
        orphans(jobs, self, now, age, None).await
    }
}

async fn orphans(
    store: &dyn Store,
    artifacts: &Artifacts,
    now: Timestamp,
    age: Duration,
    lock: Option<&Lock<'_>>,
) -> Result<u64, ArtifactError> {
    let mut removed = 0;
    for (prefix, age) in [(MODELS, age), (PROBES, age.max(PROBE_AGE))] {
        let before = now.saturating_sub(age).unwrap_or(Timestamp::MIN).as_microsecond();
        let mut listing = artifacts.listing(prefix);
        loop {
            let page = listing.next().await?;
            if page.is_empty() {
                break;
            }
            if !may_continue(lock).await? {
                return Ok(removed);
            }
            let mut old: Vec<String> =
                page.into_iter().filter(|object| object.modified_micros < before).map(|object| object.key).collect();
            // Asked after the listing: what was committed meanwhile is named by now.
            let used = store.keys_in_use(&old).await?;
            old.retain(|key| !used.contains(key));
            removed += artifacts.remove_listed(old).await?;
        }
    }
    Ok(removed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::Clock;
    use crate::generate::{Backend, Output};
    use crate::jobs::sqlite::SqliteStore;
    use crate::jobs::{File, Finished, NewJob, Priority, StoreOptions};
    use bytes::Bytes;
    use std::collections::BTreeMap;

    async fn stores() -> (Arc<dyn Store>, Artifacts, Clock, tempfile::TempDir) {
        let dir = tempfile::tempdir().unwrap();
        let clock = Clock::manual("2026-01-02T03:04:05Z".parse().unwrap());
        let options = StoreOptions { clock: clock.clone(), ..StoreOptions::default() };
        let store = SqliteStore::open_in_memory(options).await.unwrap();
        (Arc::new(store), Artifacts::local(dir.path()).unwrap(), clock, dir)
    }

    #[tokio::test]
    async fn one_sweeper_at_a_time() {
        let (store, artifacts, clock, _dir) = stores().await;
        let sweeper = || Sweeper::new(Arc::clone(&store), artifacts.clone());
        let (one, other) = (sweeper(), sweeper());
        let keeps = Retention { age: Some(Duration::from_secs(1)), bytes: Some(1) };
        let swept = Some(Swept { removed: 0, stored_bytes: Some(0) });
        assert_eq!(one.retain(keeps).await.unwrap(), swept);
        clock.advance(Duration::from_secs(60));
        assert_eq!(other.retain(keeps).await.unwrap(), None, "the first one does the rounds");
        assert_eq!(one.retain(keeps).await.unwrap(), swept);
        clock.advance(RETENTION_LOCK);
        assert_eq!(other.retain(keeps).await.unwrap(), swept, "the first one has ended");

        let every = Duration::from_secs(6 * 3600);
        let orphans =
            async |sweeper: &Sweeper| sweeper.sweep_orphans(Clock::System.now(), Duration::ZERO, every).await.unwrap();
        assert_eq!(orphans(&other).await, Some(0), "the locks are separate");
        assert_eq!(orphans(&one).await, None);
        clock.advance(every);
        assert_eq!(orphans(&one).await, Some(0));
    }

    #[tokio::test]
    async fn orphans_are_removed_page_by_page_and_probes_after_an_hour() {
        let (store, artifacts, _, dir) = stores().await;
        let files = dir.path().join("models/gone/1");
        std::fs::create_dir_all(&files).unwrap();
        for n in 0..2500 {
            std::fs::write(files.join(format!("{n}")), "x").unwrap();
        }
        // An upload that was interrupted.
        std::fs::write(files.join("model.glb#12"), "x").unwrap();
        artifacts.put_bytes("probe/left", Bytes::from_static(b"x")).await.unwrap();
        let now = Clock::System.now() + Duration::from_secs(60);
        assert_eq!(artifacts.sweep_orphans(&*store, now, Duration::from_secs(3600)).await.unwrap(), 0);
        assert_eq!(artifacts.sweep_orphans(&*store, now, Duration::ZERO).await.unwrap(), 2501);
        assert!(!files.exists() && dir.path().join("probe/left").exists());
        let later = now + PROBE_AGE;
        assert_eq!(artifacts.sweep_orphans(&*store, later, Duration::ZERO).await.unwrap(), 1);
    }

    /// Queues and finishes models of one file of 100 bytes each.
    async fn make(store: &dyn Store, models: u64) {
        for seed in 0..models {
            let new = NewJob {
                preset: "pig".into(),
                seed,
                spec: serde_json::json!({}),
                outputs: vec![Output::Glb],
                backend: Backend::Auto,
                labels: BTreeMap::new(),
                priority: Priority::default(),
                digest: seed.to_string(),
                engine: crate::ENGINE_VERSION.into(),
                reuse: false,
                missing: Vec::new(),
                batch_key: None,
                idempotency: None,
                submitter: None,
                trace: None,
            };
            store.submit(new).await.unwrap();
            let claimed = store.claim("w", Backend::Cpu, Duration::from_secs(8), 1).await.unwrap().pop().unwrap();
            let file = File {
                name: "model.glb".into(),
                media_type: "model/gltf-binary".into(),
                bytes: 100,
                sha256: String::new(),
                key: crate::jobs::artifacts::key(claimed.job().id, 1, "model.glb"),
            };
            let finished = Finished {
                backend: claimed.job().backend.clone(),
                files: vec![file],
                summary: serde_json::json!({}),
                engine: crate::ENGINE_VERSION.into(),
            };
            store.finish(claimed, finished).await.unwrap();
        }
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 4)]
    async fn two_processes_that_sweep_at_once_remove_no_more_than_one() {
        let (store, artifacts, _, _dir) = stores().await;
        make(&*store, 40).await;
        let keeps = Retention { age: None, bytes: Some(1050) };
        let sweeps = (0..4).map(|_| {
            let sweeper = Sweeper::new(Arc::clone(&store), artifacts.clone());
            tokio::spawn(async move { sweeper.retain(keeps).await.unwrap() })
        });
        let swept = futures_util::future::join_all(sweeps).await;
        let swept: Vec<Swept> = swept.into_iter().filter_map(Result::unwrap).collect();
        assert_eq!(swept, [Swept { removed: 30, stored_bytes: Some(1000) }]);
        assert_eq!(store.stored_bytes().await.unwrap(), 1000);
    }

    #[tokio::test]
    async fn zero_is_no_limit() {
        let (store, artifacts, clock, _dir) = stores().await;
        make(&*store, 2).await;
        clock.advance(Duration::from_secs(1));
        for (age, bytes) in [(Some(Duration::ZERO), None), (None, Some(0)), (None, None)] {
            let swept = Retention { age, bytes }.sweep(&*store, &artifacts).await.unwrap();
            assert_eq!(swept, Swept::default());
        }
        assert_eq!(store.counts().await.unwrap().succeeded, 2);
    }
}
