//! Outages of the artifact store: no job fails, no attempt counts, and workers resume when the
//! artifact store is available again.

use crate::scripted::{Database, Place};
use async_trait::async_trait;
use futures_util::future::join_all;
use futures_util::stream::BoxStream;
use object_store::memory::InMemory;
use object_store::path::Path;
use object_store::{
    CopyOptions, Error, GetOptions, GetResult, ListResult, MultipartUpload, ObjectMeta, ObjectStore,
    PutMultipartOptions, PutOptions, PutPayload, PutResult, Result,
};
use oviduct::generate::Stage;
use oviduct::jobs::artifacts::Artifacts;
use oviduct::jobs::state::AttemptEnd;
use oviduct::jobs::{Attempt, JobId, JobProgress, Status, StoreOptions};
use oviduct::status::{self, Condition};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::sync::watch;

/// Response of a [`Switch`] to writes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mode {
    Up,
    /// Refuses all writes.
    Away,
    /// Refuses all writes with the error of expired credentials.
    Forbidden,
    /// Refuses multipart uploads, like a disk with little free space.
    Small,
    /// Delays writes of models' files until the mode changes.
    Slow,
}

/// An in-memory object store whose writes can be refused.
#[derive(Debug)]
pub struct Switch {
    store: InMemory,
    mode: watch::Sender<Mode>,
    /// Keys of all writes, in their order.
    written: Mutex<Vec<String>>,
}

impl std::fmt::Display for Switch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("switch")
    }
}

impl Switch {
    fn new() -> Arc<Self> {
        Arc::new(Self { store: InMemory::new(), mode: watch::Sender::new(Mode::Up), written: Mutex::default() })
    }

    /// The keys of the writes since the last call, in their order.
    pub fn written(&self) -> Vec<String> {
        std::mem::take(&mut self.written.lock().unwrap())
    }

    fn set(&self, mode: Mode) {
        self.mode.send_replace(mode);
    }

    async fn write(&self, location: &Path, is_small: bool) -> Result<()> {
        self.written.lock().unwrap().push(location.to_string());
        let is_model = location.as_ref().starts_with("models");
        let mut mode = self.mode.subscribe();
        let mode = *mode.wait_for(|mode| *mode != Mode::Slow || !is_model).await.unwrap();
        match mode {
            Mode::Away => Err(Error::Generic { store: "switch", source: "503 Slow Down".into() }),
            Mode::Forbidden => {
                let path = location.to_string();
                Err(Error::Unauthenticated { path, source: "switch: the token has expired".into() })
            }
            Mode::Small if !is_small => {
                Err(Error::Generic { store: "switch", source: "507 Insufficient Storage".into() })
            }
            _ => Ok(()),
        }
    }
}

#[async_trait]
impl ObjectStore for Switch {
    async fn put_opts(&self, location: &Path, payload: PutPayload, options: PutOptions) -> Result<PutResult> {
        self.write(location, true).await?;
        self.store.put_opts(location, payload, options).await
    }

    async fn put_multipart_opts(
        &self,
        location: &Path,
        options: PutMultipartOptions,
    ) -> Result<Box<dyn MultipartUpload>> {
        self.write(location, false).await?;
        self.store.put_multipart_opts(location, options).await
    }

    async fn get_opts(&self, location: &Path, options: GetOptions) -> Result<GetResult> {
        self.store.get_opts(location, options).await
    }

    fn delete_stream(&self, locations: BoxStream<'static, Result<Path>>) -> BoxStream<'static, Result<Path>> {
        self.store.delete_stream(locations)
    }

    fn list(&self, prefix: Option<&Path>) -> BoxStream<'static, Result<ObjectMeta>> {
        self.store.list(prefix)
    }

    async fn list_with_delimiter(&self, prefix: Option<&Path>) -> Result<ListResult> {
        self.store.list_with_delimiter(prefix).await
    }

    async fn copy_opts(&self, from: &Path, to: &Path, options: CopyOptions) -> Result<()> {
        self.store.copy_opts(from, to, options).await
    }
}

/// A place with an artifact store that can be switched off. Jobs may use only one counted attempt.
pub async fn place(database: Database) -> (Place, Arc<Switch>) {
    let mut place = Place::on(database, StoreOptions { max_attempts: 1, ..StoreOptions::default() }).await;
    let switch = Switch::new();
    place.artifacts = Artifacts::over(Arc::<Switch>::clone(&switch));
    (place, switch)
}

/// Asserts that the last attempt succeeded and that all others were released because of storage.
/// Returns the number of released attempts.
fn released(attempts: &[Attempt]) -> usize {
    let (last, others) = attempts.split_last().unwrap();
    assert_eq!(last.outcome, Some(AttemptEnd::Succeeded), "{attempts:?}");
    for attempt in others {
        assert_eq!(attempt.outcome, Some(AttemptEnd::Released), "{attempts:?}");
        let detail = attempt.detail.as_deref().unwrap_or_default();
        assert!(detail.starts_with("storage: ") && detail.contains("switch"), "{detail}");
    }
    others.len()
}

/// An outage of ten minutes. The workers' waits are shortened to 10 ms per second.
async fn ten_minutes_without_an_artifact_store(database: Database) {
    const SECOND: Duration = Duration::from_millis(10);
    const WORKERS: u32 = 3;
    let (place, switch) = place(database).await;
    let status = status::Status::default();
    let pool = place.start(|options| {
        options.workers = WORKERS;
        options.threads = 1;
        options.storage_wait = SECOND;
        options.status = status.clone();
        options.poll = Duration::from_millis(50);
    });
    let mut ids: Vec<JobId> = Vec::new();
    for seed in 100..105 {
        ids.push(place.queue("ok", seed).await);
    }
    join_all(ids.iter().map(|&id| place.ended(id))).await;
    assert!(status.not_ready().is_none() && place.artifacts.outage().is_none());

    // Load continues during the outage: one submission every ten seconds for ten minutes.
    switch.set(Mode::Away);
    for seed in 200..260 {
        ids.push(place.queue("ok", seed).await);
        tokio::time::sleep(10 * SECOND).await;
    }
    let counts = place.store.counts().await.unwrap();
    assert_eq!((counts.succeeded, counts.failed, counts.queued + counts.running), (5, 0, 60));
    assert_eq!(status.not_ready().unwrap().0, Condition::Storage);
    let outage = place.artifacts.outage().expect("it is not reported");
    assert!(outage.contains("503 Slow Down"), "{outage}");

    switch.set(Mode::Up);
    let mut releases = 0;
    for job in join_all(ids.iter().map(|&id| place.ended(id))).await {
        assert_eq!(job.status, Status::Succeeded, "{:?}", job.problem);
        place.check_files(&job).await;
        releases += released(&place.store.attempts(job.id).await.unwrap());
    }
    // Only the jobs that were claimed before the first upload failed were grown in vain.
    assert!((1..=2 * WORKERS as usize).contains(&releases), "{releases} models were grown for nothing");
    assert!(status.not_ready().is_none() && place.artifacts.outage().is_none());
    pool.shutdown(Duration::from_secs(5)).await;
    assert!(place.scratch().is_empty());
    place.store.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn ten_minutes_without_an_artifact_store_cost_no_attempt_on_sqlite() {
    ten_minutes_without_an_artifact_store(Database::Sqlite).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn ten_minutes_without_an_artifact_store_cost_no_attempt_on_postgres() {
    ten_minutes_without_an_artifact_store(Database::Postgres).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn expired_credentials_cost_no_attempt() {
    let (place, switch) = place(Database::Sqlite).await;
    switch.set(Mode::Forbidden);
    let pool = place.start(|options| options.storage_wait = Duration::from_millis(5));
    let id = place.queue("ok", 1).await;
    place.until(id, |job| job.status == Status::Queued && job.attempts > 0).await;
    switch.set(Mode::Up);
    let job = place.ended(id).await;
    assert_eq!(job.status, Status::Succeeded, "{:?}", job.problem);
    assert!(released(&place.store.attempts(id).await.unwrap()) > 0);
    pool.shutdown(Duration::from_secs(5)).await;
    place.store.close().await;
}

/// The health check of the artifact store passes, but uploads of large files fail.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn claims_pause_longer_after_each_release_until_an_upload_succeeds() {
    const UNIT: Duration = Duration::from_millis(20);
    let (place, switch) = place(Database::Sqlite).await;
    switch.set(Mode::Small);
    let pool = place.start(|options| {
        options.storage_wait = UNIT;
        options.poll = Duration::from_millis(10);
    });
    // Seed 2 has a large file.
    let id = place.queue("ok", 2).await;
    place.until(id, |job| job.attempts == 5).await;
    switch.set(Mode::Up);
    let job = place.ended(id).await;
    assert_eq!(job.status, Status::Succeeded, "{:?}", job.problem);
    let attempts = place.store.attempts(id).await.unwrap();
    assert!(released(&attempts) >= 4);
    // A claim under way at the beginning of a pause may still succeed. Therefore at least every
    // other attempt begins after a pause.
    let gaps = attempts.windows(2).take(4).map(|pair| {
        let gap = pair[1].started_at.duration_since(pair[0].ended_at.unwrap());
        Duration::try_from(gap).unwrap()
    });
    let rests: Vec<Duration> = gaps.filter(|gap| *gap > UNIT / 2).collect();
    assert!(rests.len() >= 2, "{rests:?}");
    assert!(rests.last().unwrap() > &UNIT, "they do not grow: {rests:?}");
    pool.shutdown(Duration::from_secs(5)).await;
    place.store.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_next_model_grows_while_files_are_being_stored_and_no_more_than_that() {
    let (place, switch) = place(Database::Sqlite).await;
    switch.set(Mode::Slow);
    let pool = place.start(|_| {});
    let mut ids = Vec::new();
    for seed in 1..=3 {
        ids.push(place.queue("ok", seed).await);
    }
    // With one worker, the second model grows while the files of the first are stored. The third
    // job is not claimed.
    for id in &ids[..2] {
        place
            .until(*id, |job| {
                job.progress.and_then(JobProgress::model).is_some_and(|progress| progress.stage == Stage::Store)
            })
            .await;
    }
    tokio::time::sleep(Duration::from_millis(300)).await;
    assert_eq!(place.store.get(ids[2]).await.unwrap().unwrap().status, Status::Queued);
    switch.set(Mode::Up);
    for id in ids {
        let job = place.ended(id).await;
        assert_eq!((job.status, job.attempts), (Status::Succeeded, 1), "{:?}", job.problem);
        place.check_files(&job).await;
    }
    pool.shutdown(Duration::from_secs(5)).await;
    place.store.close().await;
}
