//! A job store that is new or older than the artifacts: orphans are kept until the operator says
//! that the stores belong together. Over both databases and both artifact stores.

use crate::bucket::Bucket;
use crate::scripted::{Database, Place};
use crate::suite::{LEASE, new_job};
use crate::unread::execute;
use bytes::Bytes;
use oviduct::clock::Clock;
use oviduct::jobs::artifacts::{Artifacts, key};
use oviduct::jobs::sweep::{Retention, Sweeper};
use oviduct::jobs::{ClaimScope, JobId, Mismatch, Store, StoreOptions};
use std::time::Duration;

const HOUR: Duration = Duration::from_secs(3600);

fn sweeper(place: &Place) -> Sweeper {
    Sweeper::new(place.store.clone(), place.artifacts.clone(), "the only process")
}

/// Sweeps orphans of any age. `None` if they are kept.
async fn sweep(sweeper: &Sweeper) -> Option<u64> {
    let later = Clock::System.now() + 48 * HOUR;
    sweeper.sweep_orphans(later, Duration::ZERO, Duration::ZERO).await.unwrap()
}

/// Submits a job and stores a file of its first attempt, which is not committed.
async fn make(store: &Store, artifacts: &Artifacts, digest: &str) -> JobId {
    let id = store.submit(new_job(digest)).await.unwrap().job().id;
    artifacts.put_bytes(&key(id, 1, "model.glb"), Bytes::from_static(b"model")).await.unwrap();
    id
}

async fn has(artifacts: &Artifacts, id: JobId) -> bool {
    artifacts.missing(&[key(id, 1, "model.glb")]).await.unwrap().is_empty()
}

async fn a_new_job_store_deletes_nothing(database: Database, bucket: Option<&Bucket>) {
    let mut first = Place::on(database, StoreOptions::default()).await;
    first.artifacts = bucket.map_or(first.artifacts, Bucket::artifacts);
    assert_eq!(
        sweeper(&first).observe(Retention::default(), false).await.unwrap().state.mismatch,
        None,
        "both stores are empty"
    );
    let model = make(&first.store, &first.artifacts, "a").await;
    assert_eq!(
        sweeper(&first).observe(Retention::default(), false).await.unwrap().state.mismatch,
        None,
        "its record is known"
    );

    // The same artifacts with a database that does not know them.
    let mut second = Place::on(database, StoreOptions::default()).await;
    second.artifacts = first.artifacts.clone();
    let expected = Some(Mismatch { is_new: true, example: format!("models/{model}") });
    assert_eq!(sweeper(&second).observe(Retention::default(), false).await.unwrap().state.mismatch, expected);
    make(&second.store, &second.artifacts, "b").await;
    for _ in 0..2 {
        // A restart does not forget it, although there are younger records by then.
        let restarted = sweeper(&second);
        assert_eq!(restarted.observe(Retention::default(), false).await.unwrap().state.mismatch, expected);
        assert_eq!(sweep(&restarted).await, None);
    }
    assert!(has(&second.artifacts, model).await);
    let trusting = sweeper(&second);
    assert_eq!(trusting.observe(Retention::default(), true).await.unwrap().state.mismatch, None);
    // The file of the second job goes too, because no attempt of the job runs.
    assert_eq!(sweep(&trusting).await, Some(2));
    assert!(!has(&second.artifacts, model).await);
    assert_eq!(sweeper(&second).observe(Retention::default(), false).await.unwrap().state.mismatch, None);
}

async fn an_older_job_store_deletes_nothing(database: Database, bucket: Option<&Bucket>) {
    let own = tempfile::tempdir().unwrap();
    let url = database.url(own.path()).await;
    let clock = Clock::manual("2026-01-02T03:04:05Z".parse().unwrap());
    let options = StoreOptions { clock: clock.clone(), ..StoreOptions::default() };
    let mut place = Place::with(own.path(), &url, options).await;
    place.artifacts = bucket.map_or(place.artifacts, Bucket::artifacts);
    let deleted = make(&place.store, &place.artifacts, "a").await;
    execute(database, &url, "DELETE FROM jobs").await;
    let kept = make(&place.store, &place.artifacts, "b").await;
    clock.advance(HOUR);
    let running = sweeper(&place);
    assert_eq!(
        running.observe(Retention::default(), false).await.unwrap().state.mismatch,
        None,
        "its record was deleted before the last round"
    );

    // Restoring a backup takes the records back to the last round.
    clock.advance(HOUR);
    let lost = make(&place.store, &place.artifacts, "c").await;
    clock.advance(HOUR);
    execute(database, &url, &format!("DELETE FROM jobs WHERE id = '{lost}'")).await;
    let restored = sweeper(&place);
    let expected = Some(Mismatch { is_new: false, example: format!("models/{lost}") });
    assert_eq!(restored.observe(Retention::default(), false).await.unwrap().state.mismatch, expected);
    // The process that has run all the time notices it too.
    assert_eq!(running.observe(Retention::default(), false).await.unwrap().state.mismatch, expected);
    clock.advance(HOUR);
    make(&place.store, &place.artifacts, "d").await;
    assert_eq!(sweeper(&place).observe(Retention::default(), false).await.unwrap().state.mismatch, expected);
    assert_eq!(sweep(&restored).await, None);
    assert!(has(&place.artifacts, deleted).await && has(&place.artifacts, lost).await);

    place.store.claim("w", ClaimScope::Cpu, LEASE, 1).await.unwrap();
    assert_eq!(restored.observe(Retention::default(), true).await.unwrap().state.mismatch, None);
    assert_eq!(sweep(&restored).await, Some(3));
    assert!(has(&place.artifacts, kept).await, "its attempt runs");
    assert!(!has(&place.artifacts, lost).await);
}

/// Each database with each artifact store.
macro_rules! everywhere {
    ($module:ident: $database:expr, $bucket:expr) => {
        mod $module {
            use super::*;

            #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
            async fn a_new_job_store_deletes_nothing() {
                super::a_new_job_store_deletes_nothing($database, $bucket.as_ref()).await;
            }

            #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
            async fn an_older_job_store_deletes_nothing() {
                super::an_older_job_store_deletes_nothing($database, $bucket.as_ref()).await;
            }
        }
    };
}

everywhere!(sqlite_with_a_folder: Database::Sqlite, None::<Bucket>);
everywhere!(sqlite_with_a_bucket: Database::Sqlite, Some(Bucket::start().await));
everywhere!(postgres_with_a_folder: Database::Postgres, None::<Bucket>);
everywhere!(postgres_with_a_bucket: Database::Postgres, Some(Bucket::start().await));

/// The first start of this version on records of an older one.
#[tokio::test]
async fn records_without_rounds_are_as_young_as_the_youngest_job() {
    let clock = Clock::manual("2026-01-02T03:04:05Z".parse().unwrap());
    let place = Place::fresh(|options| options.clock = clock.clone()).await;
    make(&place.store, &place.artifacts, "a").await;
    let old = Store::open_in_memory(StoreOptions { clock: clock.clone(), ..StoreOptions::default() }).await.unwrap();
    old.submit(new_job("b")).await.unwrap();
    let observe = async || {
        Sweeper::new(old.clone(), place.artifacts.clone(), "a")
            .observe(Retention::default(), false)
            .await
            .unwrap()
            .state
            .mismatch
    };
    assert_eq!(observe().await, None, "made before the youngest job");
    clock.advance(HOUR);
    assert_eq!(observe().await, None);
    clock.advance(HOUR);
    let younger = make(&place.store, &place.artifacts, "c").await;
    assert_eq!(observe().await, Some(Mismatch { is_new: false, example: format!("models/{younger}") }));
}
