//! Unusable scratch directories: no attempt counts.

use crate::scripted::Place;
use futures_util::future::join_all;
use oviduct::jobs::state::AttemptEnd;
use oviduct::jobs::{JobId, Status};
use oviduct::worker::PoolOptions;
use std::path::PathBuf;
use std::time::Duration;

/// Scratch directory of the only process.
fn scratch(place: &Place) -> PathBuf {
    let entries = std::fs::read_dir(place.dir.join("scratch")).unwrap().flatten();
    let mut folders: Vec<PathBuf> = entries.map(|entry| entry.path()).filter(|path| path.is_dir()).collect();
    assert_eq!(folders.len(), 1);
    folders.pop().unwrap()
}

fn quick(options: &mut PoolOptions) {
    options.poll = Duration::from_millis(100);
    options.workers = 2;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn without_its_scratch_directory_a_worker_claims_nothing() {
    let place = Place::fresh(|options| options.max_attempts = 1).await;
    let pool = place.start(quick);
    let folder = scratch(&place);
    let away = place.dir.join("away");
    std::fs::rename(&folder, &away).unwrap();
    std::fs::write(&folder, "a file instead of a directory").unwrap();
    let mut ids = Vec::new();
    for seed in 0..50 {
        ids.push(place.queue("ok", 10 + seed).await);
    }
    // Long enough for each job to use up its attempts if it were claimed.
    tokio::time::sleep(Duration::from_secs(2)).await;
    assert_eq!(place.store.counts().await.unwrap().queued, 50, "jobs were claimed without a scratch directory");
    std::fs::remove_file(&folder).unwrap();
    std::fs::rename(&away, &folder).unwrap();
    let mut attempts = 0;
    for job in join_all(ids.iter().map(|&id| place.ended(id))).await {
        assert_eq!(job.status, Status::Succeeded, "{:?}", job.problem);
        attempts += job.attempts;
    }
    // Each of the two workers may have checked the directory just before it was removed.
    assert!((50..=52).contains(&attempts), "{attempts}");
    pool.shutdown(Duration::from_secs(5)).await;
}

/// The check before the claim passes, but the directory of the first attempt cannot be created.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_attempt_whose_directory_cannot_be_created_does_not_count() {
    let place = Place::fresh(|options| options.max_attempts = 1).await;
    let pool = place.start(quick);
    let folder = scratch(&place);
    let busy: Vec<JobId> = vec![place.queue("wait", 1).await, place.queue("wait", 2).await];
    for &id in &busy {
        place.until(id, |job| job.progress.is_some()).await;
    }
    let id = place.queue("ok", 3).await;
    std::fs::write(folder.join(format!("{id}-1")), "in the way").unwrap();
    for &id in &busy {
        place.store.cancel(id).await.unwrap();
    }
    let job = place.ended(id).await;
    assert_eq!((job.status, job.attempts), (Status::Succeeded, 2), "{:?}", job.problem);
    let outcomes: Vec<_> = place.store.attempts(id).await.unwrap().iter().map(|a| a.outcome).collect();
    assert_eq!(outcomes, [Some(AttemptEnd::Released), Some(AttemptEnd::Succeeded)]);
    std::fs::remove_file(folder.join(format!("{id}-1"))).unwrap();
    pool.shutdown(Duration::from_secs(5)).await;
}
