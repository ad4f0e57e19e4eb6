//! One suite over both kinds of artifact stores: a local folder and an S3 bucket.

use crate::bucket::Bucket;
use crate::scripted::{OBJECTS, Place, scripted};
use bytes::Bytes;
use futures_util::TryStreamExt;
use oviduct::clock::{Clock, Stopwatch};
use oviduct::jobs::artifacts::{ArtifactError, Artifacts};
use oviduct::jobs::reuse::exclude_missing_files;
use oviduct::jobs::{NewBatch, NewJob, Priority, Status, Submitted};
use sha2::{Digest, Sha256};
use std::path::Path;
use std::time::Duration;

async fn files_come_back_whole_and_in_ranges(artifacts: &Artifacts, dir: &Path) {
    let key = "models/a/1/model.glb";
    for bytes in [0usize, 1000, 2 * (8 << 20) + 12_345] {
        let data: Vec<u8> = (0..bytes).map(|i| (i * 31 % 251) as u8).collect();
        let path = dir.join("scratch.bin");
        std::fs::write(&path, &data).unwrap();
        let stored = artifacts.put_file(key, &path).await.unwrap();
        assert_eq!((stored.bytes, stored.sha256), (bytes as u64, hex::encode(Sha256::digest(&data))));
        assert!(artifacts.read_all(key).await.unwrap() == data);
        if bytes == 0 {
            continue;
        }
        let part = artifacts.get_range(key, Some(100..900)).await.unwrap();
        assert_eq!((part.size, part.range.clone()), (bytes as u64, 100..900));
        let read: Vec<Bytes> = part.stream.try_collect().await.unwrap();
        assert!(read.concat() == data[100..900]);
        let tail = artifacts.get_range(key, Some(bytes as u64 - 5..u64::MAX)).await.unwrap();
        assert_eq!(tail.range, bytes as u64 - 5..bytes as u64);
        let outside = artifacts.get_range(key, Some(bytes as u64..bytes as u64 + 1)).await.unwrap_err();
        assert!(matches!(outside, ArtifactError::Range(_)), "{outside}");
    }
    artifacts.put_bytes("models/a/1/checkpoint-1", Bytes::from_static(b"state")).await.unwrap();
    assert_eq!(artifacts.read_all("models/a/1/checkpoint-1").await.unwrap(), "state");
    artifacts.check().await.unwrap();
    let keys = [key.to_owned(), "models/a/1/checkpoint-1".to_owned(), "models/a/1/never".to_owned()];
    for _ in 0..2 {
        artifacts.delete(&keys).await.unwrap();
    }
    for key in &keys {
        let gone = artifacts.read_all(key).await.unwrap_err();
        assert!(matches!(gone, ArtifactError::NotFound { .. }), "{gone}");
    }
}

async fn jobs_end_with_their_files_and_orphans_go(place: &Place) {
    let pool = place.start(|_| {});
    for seed in [1, 2] {
        let job = place.ended(place.queue("ok", seed).await).await;
        assert_eq!(job.status, Status::Succeeded, "{:?}", job.problem);
        place.check_files(&job).await;
    }
    place.artifacts.put_bytes("models/gone/1/model.glb", Bytes::from_static(b"orphan")).await.unwrap();
    let now = Clock::System.now() + Duration::from_secs(60);
    let sweep = async |age| place.sweep_orphans(now, age).await;
    assert_eq!(sweep(Duration::from_secs(3600)).await, 0);
    assert_eq!(sweep(Duration::ZERO).await, 1);
    assert_eq!(sweep(Duration::ZERO).await, 0);
    pool.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn artifacts_in_a_folder() {
    let place = Place::fresh(|_| {}).await;
    files_come_back_whole_and_in_ranges(&place.artifacts, &place.dir).await;
    jobs_end_with_their_files_and_orphans_go(&place).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn artifacts_in_a_bucket() {
    let bucket = Bucket::start().await;
    let mut place = Place::fresh(|_| {}).await;
    place.artifacts = bucket.artifacts();
    files_come_back_whole_and_in_ranges(&place.artifacts, &place.dir).await;
    jobs_end_with_their_files_and_orphans_go(&place).await;
}

/// Jobs that run when the bucket becomes unavailable end after it returns. The other operations
/// keep working during the outage.
async fn an_outage_of(time: Duration) {
    let bucket = Bucket::start().await;
    let mut place = Place::fresh(|_| {}).await;
    place.artifacts = bucket.artifacts();
    let before = place.start(|_| {});
    let made = place.ended(place.queue("ok", 100).await).await;
    before.shutdown(Duration::from_secs(5)).await;
    let mut ids = Vec::new();
    for seed in 0..6 {
        ids.push(place.queue("ok", seed).await);
    }
    bucket.set_up(false);
    let pool = place.start(|options| {
        options.workers = 2;
    });
    let watch = Stopwatch::start();
    let running = place.until(ids[0], |job| job.progress.is_some_and(|progress| progress.fraction() > 0.95)).await;
    assert_eq!(running.status, Status::Running);
    place.until(ids[1], |job| job.status == Status::Running).await;
    // Reading, cancelling and deleting models work during the outage.
    let waiting = *ids.last().unwrap();
    assert_eq!(place.store.cancel(waiting).await.unwrap().unwrap().status, Status::Cancelled);
    let keys = place.store.delete(made.id).await.unwrap().unwrap();
    assert_eq!(keys.len(), OBJECTS);
    tokio::time::sleep(time.saturating_sub(watch.elapsed())).await;
    for id in &ids[..2] {
        assert_eq!(place.store.get(*id).await.unwrap().unwrap().status, Status::Running, "it waits for the bucket");
    }
    bucket.set_up(true);
    for id in &ids[..5] {
        let job = place.ended(*id).await;
        assert_eq!((job.status, job.attempts), (Status::Succeeded, 1), "{:?}", job.problem);
        place.check_files(&job).await;
    }
    pool.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn jobs_wait_for_a_bucket_that_is_away_for_a_moment() {
    an_outage_of(Duration::from_secs(2)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn jobs_wait_for_a_bucket_that_is_away_for_half_a_minute() {
    an_outage_of(Duration::from_secs(30)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_bucket_that_stays_away_releases_the_job_until_it_is_back() {
    let bucket = Bucket::start().await;
    let mut place = Place::fresh(|options| options.max_attempts = 1).await;
    place.artifacts = bucket.artifacts();
    bucket.set_up(false);
    let pool = place.start(|options| options.storage_wait = Duration::from_millis(1));
    let id = place.queue("ok", 2).await;
    place.until(id, |job| job.attempts > 0 && job.status == Status::Queued).await;
    bucket.set_up(true);
    let job = place.ended(id).await;
    assert_eq!(job.status, Status::Succeeded, "{:?}", job.problem);
    place.check_files(&job).await;
    pool.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_model_whose_files_are_gone_is_grown_again() {
    let bucket = Bucket::start().await;
    let mut place = Place::fresh(|_| {}).await;
    place.artifacts = bucket.artifacts();
    let pool = place.start(|_| {});
    let wish = || NewJob { reuse: true, ..scripted("ok", 1) };
    let submit = async || {
        let mut new = wish();
        exclude_missing_files(&place.store, &place.artifacts, std::slice::from_mut(&mut new)).await.unwrap();
        place.store.submit(new).await.unwrap()
    };
    let first = place.ended(submit().await.job().id).await;
    let shared = submit().await;
    assert!(matches!(&shared, Submitted::Reused(job) if job.reused_from == Some(first.id)), "{shared:?}");

    // A file was removed without the job store. Neither its model nor the model that shares its
    // files is reused.
    place.artifacts.delete(&[first.files[1].key.clone()]).await.unwrap();
    let again = submit().await;
    assert!(matches!(again, Submitted::Queued(_)), "{again:?}");
    let whole = place.ended(again.job().id).await;
    place.check_files(&whole).await;
    let mut jobs = vec![wish(), scripted("ok", 1)];
    exclude_missing_files(&place.store, &place.artifacts, &mut jobs).await.unwrap();
    let batch = NewBatch {
        jobs,
        owner: None,
        quota: Default::default(),
        priority: Priority::default(),
        study: None,
        idempotency: None,
    };
    let batch = place.store.submit_batch(batch).await.unwrap().batch().clone();
    let sources = [place.ended(batch.jobs[0]).await.reused_from, place.ended(batch.jobs[1]).await.reused_from];
    assert_eq!(sources, [Some(whole.id), None]);
    pool.shutdown(Duration::from_secs(5)).await;

    // If the service cannot check whether the files exist, it reuses no model.
    bucket.set_up(false);
    let unknown = submit().await;
    assert!(matches!(unknown, Submitted::Queued(_)), "{unknown:?}");
}
