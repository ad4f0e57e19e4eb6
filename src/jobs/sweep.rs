//! Retention: deletes models by age and total size. Orphan sweep: removes orphans, files that the
//! database does not name.
//!
//! Retention deletes only jobs that have ended. It deletes the record before the files, so a reader
//! sees a whole model or none. A file whose removal fails becomes an orphan, and the next orphan
//! sweep removes it.
//!
//! Ages are by the clock of the store, without the time that did not pass while upkeep watched
//! ([`Jumps`](super::jumps::Jumps)), so a wrong clock deletes no model.
//!
//! No orphan is deleted while the job store seems to be the wrong one: it is new, or it was
//! restored from a backup that is older than the artifacts ([`Sweeper::observe`]).
//!
//! One process at a time sweeps, of all processes that share the stores: [`Sweeper`] holds a lock
//! in the job store.

use super::JobId;
use super::artifacts::{ArtifactError, Artifacts, MODELS, PROBES};
use super::error::StoreError;
use super::sql::{LastRound, Mismatch, Observation, Store, UpkeepRound, UpkeepState, UpkeepTask};
use crate::clock::Stopwatch;
use crate::lock::Mutex;
use futures_util::TryStreamExt;
use jiff::Timestamp;
use std::time::Duration;

/// Number of jobs that one query reads.
const PAGE: u32 = 100;
/// Duration of the lock on retention after each page and each round. Rounds are a minute apart, so
/// one process does them all until it ends.
const RETENTION_LOCK: Duration = Duration::from_secs(3 * 60);
/// Duration of the lock on the orphan sweep after each page.
const ORPHANS_LOCK: Duration = Duration::from_secs(10 * 60);
/// Minimum age of a file to remove that a check of the artifact store left.
const PROBE_AGE: Duration = Duration::from_secs(60 * 60);

/// Time without a round of upkeep after which the two stores are compared. Rounds are a minute
/// apart.
const COMPARED_AFTER: Duration = Duration::from_secs(3 * 60);
/// Minimum difference between clock and elapsed time that is a jump.
const SMALLEST_JUMP: Duration = Duration::from_secs(60);
/// Minimum difference that is a jump if there is no limit on the age of models yet.
const JUMP_WITHOUT_LIMIT: Duration = Duration::from_secs(24 * 60 * 60);

/// Limits of retention. `None` and zero mean no limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Retention {
    /// Maximum time for which a job is kept after its end.
    pub age: Option<Duration>,
    /// Maximum bytes of all files together. Above it, the models that ended first are deleted.
    pub bytes: Option<u64>,
}

impl Retention {
    /// Maximum difference between clock and elapsed time that is no jump. It deletes models early
    /// by at most a tenth of their time.
    fn tolerance(&self) -> Duration {
        self.age.map_or(JUMP_WITHOUT_LIMIT, |age| (age / 10).max(SMALLEST_JUMP))
    }
}

/// Result of a round of retention.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Swept {
    /// Number of deleted jobs.
    pub removed: u64,
    /// Bytes of the files of all remaining jobs, if [`Retention::bytes`] limits them.
    pub stored_bytes: Option<u64>,
}

/// Sweeps the stores of a service, unless another process does so.
pub struct Sweeper {
    store: Store,
    artifacts: Artifacts,
    /// Name of this process.
    owner: String,
    /// Runs since this sweeper was made.
    watch: Stopwatch,
    /// Reading of `watch` in the last round.
    read_at: Mutex<Option<Duration>>,
}

impl Sweeper {
    /// A sweeper of the process named `owner`.
    #[must_use]
    pub fn new(store: Store, artifacts: Artifacts, owner: impl Into<String>) -> Self {
        Self { store, artifacts, owner: owner.into(), watch: Stopwatch::start(), read_at: Mutex::default() }
    }

    /// Takes or renews the lock on a task; false if another process holds it.
    async fn lock(&self, task: UpkeepTask, lease: Duration) -> Result<bool, StoreError> {
        self.store.acquire_upkeep(task, &self.owner, lease).await
    }

    /// Records that upkeep has seen the records, to be called every minute and before any sweep.
    ///
    /// The first call, and each call after a time without rounds, compares the two stores: a model
    /// that the job store does not know, made after the last round, is a sign that the job store
    /// has lost records. The sign is recorded, and no orphan is deleted until a call with `trust`.
    ///
    /// Each call compares the time since the last round of any process by the clock of the store
    /// with the time that has passed for this sweeper since its last call, zero at its first call.
    /// A larger difference than a tenth of [`Retention::age`] is a jump, which is recorded and does
    /// not count for the ages of models until a call with `trust`.
    ///
    /// # Errors
    /// [`ArtifactError::Store`], [`ArtifactError::Jobs`]; then nothing is recorded.
    pub async fn observe(&self, retention: Retention, trust: bool) -> Result<UpkeepRound, ArtifactError> {
        let last = self.store.last_round().await?;
        let is_due = last.seen_at.is_none_or(|seen| last.now.duration_since(seen).unsigned_abs() > COMPARED_AFTER);
        let read_at = *self.read_at.lock();
        let compares = !trust && (is_due || read_at.is_none());
        let mismatch = if compares { self.compare(&last).await? } else { None };
        let (watch, tolerance) = (self.watch, retention.tolerance());
        let round = self.store.record_round(Observation { mismatch, watch, read_at, tolerance, trust }).await?;
        *self.read_at.lock() = Some(round.read_at);
        Ok(round)
    }

    /// Searches the artifact store for a model that was made after the last round and that the job
    /// store does not know. Ids of models begin with the time of their submission.
    async fn compare(&self, last: &LastRound) -> Result<Option<Mismatch>, ArtifactError> {
        let after = last.seen_at.map(|seen| JobId::least_after(seen).to_string()).unwrap_or_default();
        let mut folders = self.artifacts.models_after(&after).await?;
        let mut known = String::new();
        while let Some(folder) = folders.try_next().await? {
            if folder == known {
                continue;
            }
            let is_known = match folder.parse().map(JobId) {
                Ok(id) => self.store.get(id).await?.is_some(),
                // Not the folder of a model. It counts only if there should be nothing at all.
                Err(_) => last.seen_at.is_some(),
            };
            if !is_known {
                return Ok(Some(Mismatch { is_new: last.seen_at.is_none(), example: format!("{MODELS}/{folder}") }));
            }
            known = folder;
        }
        Ok(None)
    }

    /// Does one round of retention, to be called every minute: deletes models that were too old at
    /// the observation `state`, then models above the limit of bytes. `None` if another process
    /// does the rounds.
    ///
    /// # Errors
    /// [`StoreError`]; models deleted before the error stay deleted. Files that could not be
    /// removed are only logged.
    pub async fn retain(&self, retention: Retention, state: &UpkeepState) -> Result<Option<Swept>, StoreError> {
        if !self.lock(UpkeepTask::Retention, RETENTION_LOCK).await? {
            return Ok(None);
        }
        let mut swept = Swept::default();
        if let Some(age) = retention.age.filter(|age| !age.is_zero()) {
            self.remove_old(state.jumps.before(state.seen_at, age), &mut swept).await?;
        }
        if let Some(most) = retention.bytes.filter(|most| *most > 0) {
            self.remove_excess(most, &mut swept).await?;
        }
        Ok(Some(swept))
    }

    async fn remove_old(&self, before: Timestamp, swept: &mut Swept) -> Result<(), StoreError> {
        while self.lock(UpkeepTask::Retention, RETENTION_LOCK).await? {
            let old = self.store.ended(before, PAGE).await?;
            for &id in &old {
                swept.removed += u64::from(self.remove(id).await?.is_some());
            }
            if old.len() < PAGE as usize {
                break;
            }
        }
        Ok(())
    }

    async fn remove_excess(&self, most: u64, swept: &mut Swept) -> Result<(), StoreError> {
        while self.lock(UpkeepTask::Retention, RETENTION_LOCK).await? {
            // Read again for each page, because clients delete models and workers add some.
            let mut stored = self.store.stored_bytes().await?;
            swept.stored_bytes = Some(stored);
            let oldest = if stored > most { self.store.ended(Timestamp::MAX, PAGE).await? } else { Vec::new() };
            if oldest.is_empty() {
                break;
            }
            for id in oldest {
                // Another caller deleted the model, and the sum may or may not include its bytes.
                let Some(freed) = self.remove(id).await? else { break };
                swept.removed += 1;
                stored = stored.saturating_sub(freed);
                if stored <= most {
                    break;
                }
            }
        }
        Ok(())
    }

    /// Deletes a model. Returns the bytes of the files that no other model has; `None` if the model
    /// was deleted already.
    async fn remove(&self, id: JobId) -> Result<Option<u64>, StoreError> {
        // A job that has ended does not change.
        let files = self.store.get(id).await?.map(|job| job.files).unwrap_or_default();
        let Some(keys) = self.store.delete(id).await? else {
            return Ok(None);
        };
        if let Err(error) = self.artifacts.delete(&keys).await {
            tracing::warn!(%error, "could not remove files of a deleted model; the orphan sweep will remove them");
        }
        tracing::info!(job = %id, "deleted a model by age or size");
        Ok(Some(files.iter().filter(|file| keys.contains(&file.key)).map(|file| file.bytes).sum()))
    }

    /// Removes orphans older than `age` and returns their number. Attempts that lost their lease
    /// leave orphans, and so do processes that end between upload and commit.
    ///
    /// Files of running attempts stay whatever their times are, because these may be by another
    /// clock. Files of checks are removed after an hour. Returns `None` if the state of upkeep has
    /// a [`Mismatch`], or if another process sweeps or did so less than `every` ago: each process
    /// may call this every `every`, and one of them sweeps.
    ///
    /// # Errors
    /// [`ArtifactError::Store`], [`ArtifactError::Jobs`]; files removed before the error stay
    /// removed.
    pub async fn sweep_orphans(
        &self,
        now: Timestamp,
        age: Duration,
        every: Duration,
    ) -> Result<Option<u64>, ArtifactError> {
        let is_held = self.store.upkeep_state().await?.is_some_and(|state| state.mismatch.is_some());
        if is_held || !self.lock(UpkeepTask::Orphans, ORPHANS_LOCK).await? {
            return Ok(None);
        }
        let mut removed = 0;
        for (prefix, age) in [(MODELS, age), (PROBES, age.max(PROBE_AGE))] {
            let before = now.saturating_sub(age).unwrap_or(Timestamp::MIN).as_microsecond();
            let mut listing = self.artifacts.listing(prefix);
            loop {
                let page = listing.next().await?;
                if page.is_empty() {
                    break;
                }
                if !self.lock(UpkeepTask::Orphans, ORPHANS_LOCK).await? {
                    return Ok(Some(removed));
                }
                let mut old: Vec<String> = page
                    .into_iter()
                    .filter(|object| object.modified_micros < before)
                    .map(|object| object.key)
                    .collect();
                // Asked after the listing, so a record names every file that was committed before.
                let used = self.store.keys_in_use(&old).await?;
                old.retain(|key| !used.contains(key));
                removed += self.artifacts.remove_listed(old).await?;
            }
        }
        self.lock(UpkeepTask::Orphans, every).await?;
        Ok(Some(removed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::Clock;
    use crate::jobs::{ClaimScope, File, Finished, NewJob, StoreOptions};
    use bytes::Bytes;

    async fn stores() -> (Store, Artifacts, Clock, tempfile::TempDir) {
        let dir = tempfile::tempdir().unwrap();
        let clock = Clock::manual("2026-01-02T03:04:05Z".parse().unwrap());
        let options = StoreOptions { clock: clock.clone(), ..StoreOptions::default() };
        let store = Store::open_in_memory(options).await.unwrap();
        (store, Artifacts::local(dir.path()).unwrap(), clock, dir)
    }

    async fn retain(sweeper: &Sweeper, retention: Retention) -> Option<Swept> {
        let round = sweeper.observe(retention, false).await.unwrap();
        sweeper.retain(retention, &round.state).await.unwrap()
    }

    #[tokio::test]
    async fn one_sweeper_at_a_time() {
        let (store, artifacts, clock, _dir) = stores().await;
        let sweeper = |owner| Sweeper::new(store.clone(), artifacts.clone(), owner);
        let (one, other) = (sweeper("one"), sweeper("other"));
        let keeps = Retention { age: Some(Duration::from_secs(1)), bytes: Some(1) };
        let swept = Some(Swept { removed: 0, stored_bytes: Some(0) });
        assert_eq!(retain(&one, keeps).await, swept);
        clock.advance(Duration::from_secs(60));
        assert_eq!(retain(&other, keeps).await, None, "the first one does the rounds");
        assert_eq!(retain(&one, keeps).await, swept);
        clock.advance(RETENTION_LOCK);
        assert_eq!(retain(&other, keeps).await, swept, "the first one has ended");

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
        let sweeper = Sweeper::new(store, artifacts, "one");
        let sweep = async |now, age| sweeper.sweep_orphans(now, age, Duration::ZERO).await.unwrap();
        assert_eq!(sweep(now, Duration::from_secs(3600)).await, Some(0));
        assert_eq!(sweep(now, Duration::ZERO).await, Some(2501));
        assert!(!files.exists() && dir.path().join("probe/left").exists());
        assert_eq!(sweep(now + PROBE_AGE, Duration::ZERO).await, Some(1));
    }

    /// Queues and finishes models of one file of 100 bytes each.
    async fn make(store: &Store, models: u64) {
        for seed in 0..models {
            store.submit(NewJob::sample(seed)).await.unwrap();
            let claimed = store.claim("w", ClaimScope::Cpu, Duration::from_secs(8), 1).await.unwrap().pop().unwrap();
            let file = File {
                name: "model.glb".into(),
                media_type: "model/gltf-binary".into(),
                bytes: 100,
                sha256: String::new(),
                key: crate::jobs::artifacts::key(claimed.job().id, 1, "model.glb"),
                start: None,
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
        make(&store, 40).await;
        let keeps = Retention { age: None, bytes: Some(1050) };
        let sweeps = (0..4).map(|process| {
            let sweeper = Sweeper::new(store.clone(), artifacts.clone(), process.to_string());
            tokio::spawn(async move { retain(&sweeper, keeps).await })
        });
        let swept = futures_util::future::join_all(sweeps).await;
        let swept: Vec<Swept> = swept.into_iter().filter_map(Result::unwrap).collect();
        assert_eq!(swept, [Swept { removed: 30, stored_bytes: Some(1000) }]);
        assert_eq!(store.stored_bytes().await.unwrap(), 1000);
    }

    #[tokio::test]
    async fn zero_is_no_limit() {
        let (store, artifacts, clock, _dir) = stores().await;
        make(&store, 2).await;
        clock.advance(Duration::from_secs(1));
        let sweeper = Sweeper::new(store.clone(), artifacts, "one");
        for (age, bytes) in [(Some(Duration::ZERO), None), (None, Some(0)), (None, None)] {
            let swept = retain(&sweeper, Retention { age, bytes }).await;
            assert_eq!(swept, Some(Swept::default()));
        }
        assert_eq!(store.counts().await.unwrap().succeeded, 2);
    }
}
