//! Rules for the claims of a process: the jobs that a CPU worker leaves to GPU workers, and pauses
//! while files cannot be stored.
//!
//! **GPU workers.** CPU workers leave `auto` jobs to GPU workers while one is live, not paused and
//! able to store files.
//! They claim `auto` jobs only when the queue is longer than the GPU workers can take with their
//! next two claims, and no GPU of this pool waits for surfaces, which need the same cores. A worker
//! is live while its last heartbeat is younger than [`ALIVE_HEARTBEATS`] of this pool's heartbeats.
//!
//! **Storage.** A failed upload, a failed checkpoint and a job released for storage begin an
//! outage: the artifact store refuses writes, or the scratch directory is full, read-only or
//! missing. All slots of the process then stop claiming. The outage ends when both pass a check, or
//! when an upload succeeds. A check can pass although large uploads fail, on a disk with little
//! space left. Therefore claims pause for longer after each further release until an upload
//! succeeds, so that the worker does not grow and discard models without end.

use super::options::{ALIVE_HEARTBEATS, PoolOptions};
use crate::jobs::artifacts::{ArtifactError, Artifacts};
use crate::jobs::scratch::Scratch;
use crate::jobs::{ClaimScope, Store, StoreError, WorkerKind};
use crate::metrics::Fallback;
use crate::status::{Condition, Status};
use std::error::Error;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{Mutex, RwLock, watch};
use tokio::time::{Instant, sleep_until};

/// Reason why a CPU worker runs jobs of `auto`, for the record and for the metrics.
pub(super) type CpuFallback = (String, Fallback);

/// Reason why a CPU worker may claim jobs of `auto` at present; `None` if it may not.
/// `surfaces_lag` is true if a GPU of this pool waits for surfaces.
pub(super) async fn cpu_fallback(
    store: &Store,
    options: &PoolOptions,
    surfaces_lag: bool,
) -> Result<Option<CpuFallback>, StoreError> {
    let live = store.count_claiming_workers(WorkerKind::Gpu, ALIVE_HEARTBEATS * options.heartbeat).await?;
    if live == 0 {
        let why = options.no_gpu.clone().unwrap_or_else(|| "no GPU worker is alive".to_owned());
        return Ok(Some((why, Fallback::NoGpu)));
    }
    let queued = store.count_claimable_jobs(ClaimScope::Gpu).await?;
    let next_claims = 2 * u64::from(options.batch) * live;
    let why = || format!("{queued} jobs were waiting for {live} GPU worker{}", if live == 1 { "" } else { "s" });
    Ok((queued > next_claims && !surfaces_lag).then(|| (why(), Fallback::Busy)))
}

/// Detail of [`Condition::Storage`].
const STORAGE_DETAIL: &str = "The artifact store or the scratch directory of this process refuses files. Until both \
    accept files again, the process starts no models and refuses new ones. Free space, or restore access to the \
    artifact store; the log has the cause.";
/// Maximum wait between two checks, in units.
const MAX_CHECK_WAIT: u32 = 15;
/// Maximum pause of claims after a release, in units.
const MAX_PAUSE: u32 = 60;

/// Availability of the storage of this process, as its workers know it.
#[derive(Debug)]
pub(super) struct Storage {
    state: watch::Sender<StorageState>,
    /// Held by the slot that checks; the others wait for its result.
    checking: Mutex<()>,
    /// Read by claims. A release takes it for writing: it waits for running claims and keeps out
    /// later ones, which could otherwise claim the released job again.
    claiming: RwLock<()>,
    unit: Duration,
    status: Status,
}

#[derive(Clone, Debug, Default)]
struct StorageState {
    outage: Option<Outage>,
    /// Number of releases since the last successful upload. Releases within one pause count once.
    releases: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Outage {
    /// Time of the next check.
    paused_until: Instant,
    /// Space required in the scratch directory, bytes; `None` if only the artifact store failed.
    scratch: Option<u64>,
}

impl Storage {
    /// `unit` scales all waits; see [`super::PoolOptions::storage_wait`].
    pub(super) fn new(unit: Duration, status: Status) -> Self {
        Self { state: watch::Sender::default(), checking: Mutex::default(), claiming: RwLock::default(), unit, status }
    }

    /// Reports that a write to the artifact store failed. Claims stop until a check passes.
    pub(super) fn write_failed(&self, error: &ArtifactError) {
        self.begin(&error.to_string(), None, false);
    }

    /// Reports that a job will be released because a write failed. `scratch` is the space required
    /// in the scratch directory, bytes, if that write failed there. Claims pause, for longer with
    /// each release.
    pub(super) async fn job_released(&self, cause: &str, scratch: Option<u64>) {
        let _none_claims = self.claiming.write().await;
        self.begin(cause, scratch, true);
    }

    /// Runs a claim, unless storage has become unavailable in the meantime.
    pub(super) async fn claim<T>(&self, claim: impl Future<Output = T>) -> Option<T> {
        let _claims = self.claiming.read().await;
        match self.outage() {
            None => Some(claim.await),
            Some(_) => None,
        }
    }

    fn begin(&self, cause: &str, scratch: Option<u64>, release: bool) {
        let now = Instant::now();
        self.state.send_modify(|state| {
            if state.outage.is_none() {
                tracing::warn!(cause, "storage is unavailable; the workers claim no jobs until it is available again");
                // Without the cause, which may name hosts, paths and models: probes show the detail
                // to everyone.
                self.status.set(Condition::Storage, STORAGE_DETAIL);
            }
            let outage = state.outage.get_or_insert(Outage { paused_until: now, scratch });
            outage.scratch = outage.scratch.max(scratch);
            if release && outage.paused_until <= now {
                outage.paused_until = now + self.unit * pause_after(state.releases);
                state.releases += 1;
            }
        });
    }

    /// Reports a successful upload, which ends an outage of the artifact store.
    pub(super) fn upload_succeeded(&self) {
        self.state.send_if_modified(|state| {
            if state.outage.is_some_and(|outage| outage.scratch.is_some()) {
                return false;
            }
            state.releases = 0;
            self.end(state)
        });
    }

    /// Ends the outage. Returns false if there is none.
    fn end(&self, state: &mut StorageState) -> bool {
        let was_out = state.outage.take().is_some();
        if was_out {
            tracing::info!("storage is available again; the workers claim jobs");
            self.status.clear(Condition::Storage);
        }
        was_out
    }

    /// Waits until jobs may be claimed. May be dropped and called again.
    pub(super) async fn wait_until_available(&self, artifacts: &Artifacts, scratch: &Arc<Scratch>) {
        let _checking = self.checking.lock().await;
        if self.outage().is_none()
            && let Err(error) = scratch.probe()
        {
            self.begin(&format!("could not create a scratch directory: {error}"), Some(0), false);
        }
        let mut wait = 1;
        while let Some(outage) = self.outage() {
            self.unless_ended(outage.paused_until).await;
            match check(artifacts, scratch, outage.scratch.unwrap_or_default()).await {
                Ok(()) => self.passed(outage),
                Err(error) => {
                    tracing::debug!(%error, "storage is still unavailable");
                    self.unless_ended(Instant::now() + self.unit * wait).await;
                    wait = (wait * 2).min(MAX_CHECK_WAIT);
                }
            }
        }
    }

    /// Reports a passed check, which began in this state of the outage.
    fn passed(&self, checked: Outage) {
        self.state.send_if_modified(|state| state.outage == Some(checked) && self.end(state));
    }

    /// Waits until the outage has ended, at most until this time.
    async fn unless_ended(&self, until: Instant) {
        let mut state = self.state.subscribe();
        tokio::select! {
            _ = state.wait_for(|state| state.outage.is_none()) => {}
            () = sleep_until(until) => {}
        }
    }

    /// True if claims are paused until a check passes.
    pub(super) fn is_unavailable(&self) -> bool {
        self.outage().is_some()
    }

    fn outage(&self) -> Option<Outage> {
        self.state.borrow().outage
    }
}

/// Checks that the artifact store and the scratch directory accept files, and that `space` bytes
/// are free in the latter.
async fn check(artifacts: &Artifacts, scratch: &Arc<Scratch>, space: u64) -> Result<(), Box<dyn Error + Send + Sync>> {
    artifacts.check().await?;
    let scratch = Arc::clone(scratch);
    Ok(tokio::task::spawn_blocking(move || scratch.check(space)).await??)
}

/// Pause of claims after a release, in units, by the number of earlier releases.
fn pause_after(releases: u32) -> u32 {
    (1 << releases.min(6)).min(MAX_PAUSE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn stores(dir: &Path) -> (Artifacts, Arc<Scratch>) {
        let artifacts = Artifacts::local(&dir.join("artifacts")).unwrap();
        (artifacts, Arc::new(Scratch::open(&dir.join("scratch")).unwrap()))
    }

    #[test]
    fn pauses_grow_to_their_limit() {
        let pauses: Vec<u32> = (0..8).map(pause_after).collect();
        assert_eq!(pauses, [1, 2, 4, 8, 16, 32, 60, 60]);
        assert_eq!(pause_after(u32::MAX), MAX_PAUSE);
    }

    #[tokio::test]
    async fn an_outage_lasts_until_a_check_passes_and_is_reported() {
        let dir = tempfile::tempdir().unwrap();
        let (artifacts, scratch) = stores(dir.path());
        let status = Status::default();
        let storage = Storage::new(Duration::from_millis(5), status.clone());
        storage.wait_until_available(&artifacts, &scratch).await;
        storage.write_failed(&ArtifactError::Store("refused".into()));
        let (condition, detail) = status.not_ready().unwrap();
        assert_eq!((condition, detail.as_str()), (Condition::Storage, STORAGE_DETAIL));
        std::fs::remove_dir_all(dir.path().join("artifacts")).unwrap();
        std::fs::write(dir.path().join("artifacts"), "a file instead of the directory").unwrap();
        let paused =
            tokio::time::timeout(Duration::from_millis(100), storage.wait_until_available(&artifacts, &scratch)).await;
        assert!(paused.is_err() && status.not_ready().is_some());
        std::fs::remove_file(dir.path().join("artifacts")).unwrap();
        std::fs::create_dir(dir.path().join("artifacts")).unwrap();
        storage.wait_until_available(&artifacts, &scratch).await;
        assert!(status.not_ready().is_none());
    }

    #[tokio::test]
    async fn releases_at_one_time_count_once_and_a_successful_upload_resets_them() {
        let dir = tempfile::tempdir().unwrap();
        let (artifacts, scratch) = stores(dir.path());
        let storage = Storage::new(Duration::from_millis(20), Status::default());
        let releases = || storage.state.borrow().releases;
        storage.job_released("refused", None).await;
        storage.job_released("refused", None).await;
        assert_eq!(releases(), 1);
        let until = storage.outage().unwrap().paused_until;
        storage.wait_until_available(&artifacts, &scratch).await;
        assert!(Instant::now() >= until, "claims were paused");
        storage.job_released("refused", None).await;
        assert_eq!(releases(), 2, "a check that passes does not reset them");
        storage.upload_succeeded();
        assert!(releases() == 0 && storage.outage().is_none());
        storage.job_released("full", Some(0)).await;
        storage.upload_succeeded();
        assert!(releases() == 1 && storage.outage().is_some(), "the scratch directory has not been checked");
    }

    #[tokio::test]
    async fn a_release_waits_for_claims_and_keeps_out_later_ones() {
        let storage = Storage::new(Duration::from_millis(20), Status::default());
        let (claimed, ends) = tokio::sync::oneshot::channel();
        let claim = storage.claim(ends);
        let release = storage.job_released("refused", None);
        tokio::pin!(claim, release);
        assert!(futures_util::poll!(&mut claim).is_pending() && futures_util::poll!(&mut release).is_pending());
        assert_eq!(storage.outage(), None, "the job may be released only after the claim");
        claimed.send(()).unwrap();
        assert_eq!(claim.await, Some(Ok(())));
        release.await;
        assert!(storage.outage().is_some());
        assert_eq!(storage.claim(std::future::pending::<()>()).await, None);
    }
}
