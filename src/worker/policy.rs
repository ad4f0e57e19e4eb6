//! Decides what the workers of a process claim: which jobs a CPU worker leaves to GPU workers, and when claims pause because
//! files cannot be stored.
//!
//! **Who takes what.** `auto` is left to GPU workers while one is alive, unless more jobs are queued than they take with their
//! next two claims and no GPU of this pool waits for surfaces, which need the same cores. A GPU worker is alive while its last
//! heartbeat is younger than [`ALIVE_HEARTBEATS`] of this pool's heartbeats, and it is not paused.
//!
//! **Storage.** A failed upload, a failed checkpoint and a job released for storage start an outage: the artifact store refuses
//! writes, or the scratch directory is full, read-only or gone. All slots of the process stop claiming. The outage ends when
//! both pass a check, or as soon as an upload succeeds. A check can pass although large uploads fail (a disk with a little room
//! left), so claims rest for longer after each further release until an upload succeeds: models are not grown and thrown away
//! without end.

use super::options::{ALIVE_HEARTBEATS, PoolOptions};
use crate::generate::Backend;
use crate::jobs::artifacts::Artifacts;
use crate::jobs::scratch::Scratch;
use crate::jobs::{Store, StoreError};
use crate::metrics::Fallback;
use crate::status::{Condition, Status};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{Mutex, RwLock, watch};
use tokio::time::{Instant, sleep_until};

/// What a CPU worker may take.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Share {
    /// Jobs that asked for a CPU.
    CpuOnly,
    /// `auto` too.
    Auto {
        /// Why, for the record.
        why: String,
        /// Why, for the metrics.
        cause: Fallback,
    },
}

impl Share {
    /// The backend to claim as.
    pub(super) fn backend(&self) -> Backend {
        match self {
            Self::CpuOnly => Backend::CpuSingle,
            Self::Auto { .. } => Backend::Cpu,
        }
    }
}

/// What a CPU worker may take now; `surfaces_lag`: whether a GPU of this pool waits for surfaces.
pub(super) async fn share(store: &dyn Store, options: &PoolOptions, surfaces_lag: bool) -> Result<Share, StoreError> {
    let alive = store.claimers(Backend::Gpu, ALIVE_HEARTBEATS * options.heartbeat).await?;
    if alive == 0 {
        let why = options.no_gpu.clone().unwrap_or_else(|| "no GPU worker is alive".to_owned());
        return Ok(Share::Auto { why, cause: Fallback::NoGpu });
    }
    let waiting = store.waiting(Backend::Gpu).await?;
    let taken = 2 * u64::from(options.batch) * alive;
    Ok(if waiting > taken && !surfaces_lag {
        let why = format!("{waiting} jobs were waiting for {alive} GPU worker{}", if alive == 1 { "" } else { "s" });
        Share::Auto { why, cause: Fallback::Busy }
    } else {
        Share::CpuOnly
    })
}

/// Longest wait between two checks, in units.
const LONGEST_CHECK_WAIT: u32 = 15;
/// Longest rest after a release, in units.
const LONGEST_REST: u32 = 60;

/// Whether the storage of this process takes files, as far as is known.
#[derive(Debug)]
pub(super) struct Storage {
    state: watch::Sender<State>,
    /// One slot checks at a time; the others wait for its result.
    checking: Mutex<()>,
    /// Read while jobs are claimed. A release waits for these claims and keeps out later ones, or else they might find the
    /// released job.
    claiming: RwLock<()>,
    unit: Duration,
    status: Status,
}

#[derive(Clone, Debug, Default)]
struct State {
    outage: Option<Outage>,
    /// Releases since the last successful upload. Those within one rest count once.
    releases: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Outage {
    /// No check before this time.
    rests_until: Instant,
    /// Bytes that must be free in the scratch directory; `None` if only the artifact store failed.
    scratch: Option<u64>,
}

impl Storage {
    /// `unit` scales all waits; see [`super::PoolOptions::storage_wait`].
    pub(super) fn new(unit: Duration, status: Status) -> Self {
        Self { state: watch::Sender::default(), checking: Mutex::default(), claiming: RwLock::default(), unit, status }
    }

    /// A write to the artifact store failed: no more claims until a check passes.
    pub(super) fn write_failed(&self, cause: &str) {
        self.begin(cause, None, false);
    }

    /// A job is about to be released because a write failed, to the scratch directory if `scratch` is the bytes that must be
    /// free there. Claims rest, for longer with each release.
    pub(super) async fn job_released(&self, cause: &str, scratch: Option<u64>) {
        let _none_claims = self.claiming.write().await;
        self.begin(cause, scratch, true);
    }

    /// Claims jobs, unless storage has become unavailable meanwhile.
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
                tracing::warn!(cause, "storage is unavailable; no jobs are claimed until it answers again");
                // The cause may name hosts, paths and models, and probes show the detail to anyone.
                self.status.set(Condition::Storage, "storage is unavailable");
            }
            let outage = state.outage.get_or_insert(Outage { rests_until: now, scratch });
            outage.scratch = outage.scratch.max(scratch);
            if release && outage.rests_until <= now {
                outage.rests_until = now + self.unit * rest_after(state.releases);
                state.releases += 1;
            }
        });
    }

    /// An upload succeeded, which ends an outage of the artifact store.
    pub(super) fn upload_succeeded(&self) {
        self.state.send_if_modified(|state| {
            if state.outage.is_some_and(|outage| outage.scratch.is_some()) {
                return false;
            }
            state.releases = 0;
            self.end(state)
        });
    }

    /// Ends the outage, if there is one. Returns whether there was.
    fn end(&self, state: &mut State) -> bool {
        let was_out = state.outage.take().is_some();
        if was_out {
            tracing::info!("storage is available again; jobs are claimed");
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
            self.begin(&format!("no scratch directory can be created: {error}"), Some(0), false);
        }
        let mut wait = 1;
        while let Some(outage) = self.outage() {
            self.unless_ended(outage.rests_until).await;
            match check(artifacts, scratch, outage.scratch.unwrap_or_default()).await {
                Ok(()) => self.passed(outage),
                Err(cause) => {
                    tracing::debug!(cause, "storage is still unavailable");
                    self.unless_ended(Instant::now() + self.unit * wait).await;
                    wait = (wait * 2).min(LONGEST_CHECK_WAIT);
                }
            }
        }
    }

    /// A check passed that began in this state of the outage.
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

    fn outage(&self) -> Option<Outage> {
        self.state.borrow().outage
    }
}

/// Checks that both stores take files, and that the scratch directory has `space` bytes free.
async fn check(artifacts: &Artifacts, scratch: &Arc<Scratch>, space: u64) -> Result<(), String> {
    artifacts.check().await.map_err(|error| error.to_string())?;
    let scratch = Arc::clone(scratch);
    let checked = tokio::task::spawn_blocking(move || scratch.check(space)).await;
    checked.map_err(|panic| panic.to_string())?.map_err(|error| format!("the scratch directory: {error}"))
}

/// Units to rest after a release, by the number of those before it.
fn rest_after(releases: u32) -> u32 {
    (1 << releases.min(6)).min(LONGEST_REST)
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
    fn rests_grow_to_their_limit() {
        let rests: Vec<u32> = (0..8).map(rest_after).collect();
        assert_eq!(rests, [1, 2, 4, 8, 16, 32, 60, 60]);
        assert_eq!(rest_after(u32::MAX), LONGEST_REST);
    }

    #[tokio::test]
    async fn an_outage_lasts_until_a_check_passes_and_is_reported() {
        let dir = tempfile::tempdir().unwrap();
        let (artifacts, scratch) = stores(dir.path());
        let status = Status::default();
        let storage = Storage::new(Duration::from_millis(5), status.clone());
        storage.wait_until_available(&artifacts, &scratch).await;
        storage.write_failed("refused");
        let (condition, detail) = status.not_ready().unwrap();
        assert_eq!((condition, detail.as_str()), (Condition::Storage, "storage is unavailable"));
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
        let until = storage.outage().unwrap().rests_until;
        storage.wait_until_available(&artifacts, &scratch).await;
        assert!(Instant::now() >= until, "it rested");
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
