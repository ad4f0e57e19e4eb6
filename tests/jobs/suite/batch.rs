//! Batches: queued, read and removed as a whole.

use super::*;

fn batch_of(digests: &[&str]) -> NewBatch {
    let jobs = digests.iter().map(|digest| new_job(digest)).collect();
    NewBatch {
        jobs,
        owner: None,
        quota: Default::default(),
        priority: Priority::default(),
        study: None,
        idempotency: None,
    }
}

/// Jobs of a batch end one by one; the counts of the batch follow.
pub async fn a_batch_counts_its_jobs(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let made = bench.succeed("a").await;
    let submitted = bench.store.submit_batch(batch_of(&["a", "b", "c", "d"])).await.unwrap();
    let SubmittedBatch::Accepted(batch) = submitted else { panic!("{submitted:?}") };
    assert_eq!(batch.jobs.len(), 4);
    assert!(batch.jobs.is_sorted());
    assert_eq!(batch.counts, Counts { queued: 3, succeeded: 1, ..Counts::default() });
    assert_eq!(bench.get(batch.jobs[0]).await.reused_from, Some(made.id));
    for (job, digest) in batch.jobs.iter().zip(["a", "b", "c", "d"]) {
        let job = bench.get(*job).await;
        assert_eq!((job.batch, job.digest.as_str()), (Some(batch.id), digest));
    }
    assert_eq!(bench.get(made.id).await.batch, None);
    bench.claim("w").await.unwrap();
    let failing = bench.claim("w").await.unwrap();
    bench.store.fail(failing, by_cpu(), problem("certificate")).await.unwrap();
    bench.store.cancel(batch.jobs[3]).await.unwrap();
    let now = bench.store.batch(batch.id).await.unwrap().unwrap();
    assert_eq!(now.counts, Counts { running: 1, succeeded: 1, failed: 1, cancelled: 1, ..Counts::default() });
    assert_eq!((now.counts.total(), &now.jobs, now.created_at), (4, &batch.jobs, batch.created_at));
    bench.store.delete(batch.jobs[1]).await.unwrap();
    let now = bench.store.batch(batch.id).await.unwrap().unwrap();
    assert_eq!(now.jobs, [batch.jobs[0], batch.jobs[2], batch.jobs[3]]);
    let all = bench.store.counts().await.unwrap();
    assert_eq!(all, Counts { succeeded: 2, failed: 1, cancelled: 1, ..Counts::default() });
}

/// If the queue has no room for all of its jobs, a batch is refused as a whole. Reused models need
/// no room.
pub async fn a_batch_is_taken_whole_or_not_at_all(factory: Factory) {
    let bench = bench(factory, |options| options.queue_limit = 3).await;
    bench.succeed("a").await;
    bench.queue("q").await;
    let mut changes = bench.store.changes();
    let refused = bench.store.submit_batch(batch_of(&["a", "b", "c", "d"])).await.unwrap_err();
    assert!(matches!(refused, StoreError::QueueFull { limit: 3 }), "{refused}");
    assert_eq!(bench.store.counts().await.unwrap().total(), 2);
    assert!(changes.try_recv().is_err(), "nothing happened");
    let taken = bench.store.submit_batch(batch_of(&["a", "b", "c"])).await.unwrap();
    let told: Vec<JobId> = (0..3).map(|_| changes.try_recv().unwrap().id).collect();
    assert_eq!(told, taken.batch().jobs);
    assert_eq!(bench.store.counts().await.unwrap(), Counts { queued: 3, succeeded: 2, ..Counts::default() });
}

/// Removing a batch removes its jobs and returns the artifact keys that no other job names.
pub async fn a_batch_is_removed_with_all_its_jobs(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let made = bench.succeed("a").await;
    let batch = bench.store.submit_batch(batch_of(&["a", "b", "c"])).await.unwrap().batch().clone();
    let ended = bench.claim("w").await.unwrap();
    let done = finished(&ended);
    let mut keys: Vec<String> = done.files.iter().map(|file| file.key.clone()).collect();
    bench.store.finish(ended, done).await.unwrap();
    let running = bench.claim("w").await.unwrap();
    bench.store.set_checkpoint(&running, "models/c/1/checkpoint").await.unwrap();
    keys.push("models/c/1/checkpoint".into());
    let mut removed = bench.store.delete_batch(batch.id).await.unwrap().unwrap();
    removed.sort();
    keys.sort();
    keys.dedup();
    assert_eq!(removed, keys, "the reused model still names its files");
    assert_eq!(bench.beat(&running).await, Directive::Lost);
    assert_eq!(bench.store.batch(batch.id).await.unwrap(), None);
    assert_eq!(bench.store.delete_batch(batch.id).await.unwrap(), None);
    for job in batch.jobs {
        assert_eq!(bench.store.get(job).await.unwrap(), None);
    }
    assert!(bench.store.get(made.id).await.unwrap().is_some());
}

/// Requests with the same idempotency key return the same batch, even if they are concurrent.
/// Batches and jobs have separate idempotency keys.
pub async fn an_idempotency_key_gives_one_batch(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let keyed = |body: &str| NewBatch { idempotency: Some(("k".into(), body.into())), ..batch_of(&["a", "b"]) };
    let racing = join_all((0..8).map(|_| bench.store.submit_batch(keyed("body")))).await;
    let accepted = racing.iter().filter(|s| matches!(s, Ok(SubmittedBatch::Accepted(_)))).count();
    assert_eq!(accepted, 1, "{racing:?}");
    let ids: Vec<_> = racing.iter().map(|s| s.as_ref().unwrap().batch().id).collect();
    assert!(ids.iter().all(|id| *id == ids[0]));
    let conflict = bench.store.submit_batch(keyed("other")).await.unwrap_err();
    assert!(matches!(conflict, StoreError::IdempotencyConflict));
    let replayed = bench.store.replayed_batch(None, "k", "body").await.unwrap();
    assert_eq!(replayed.map(|batch| batch.id), Some(ids[0]));
    assert_eq!(bench.store.replayed_batch(None, "k", "other").await.unwrap(), None);
    assert_eq!(bench.store.replayed(None, "k", "body").await.unwrap(), None, "keys of models are separate");
    let job = NewJob { idempotency: Some(("k".into(), "job".into())), ..new_job("a") };
    assert!(matches!(bench.store.submit(job).await.unwrap(), Submitted::Queued(_)));
    bench.store.delete_batch(ids[0]).await.unwrap().unwrap();
    let again = bench.store.submit_batch(keyed("other")).await.unwrap();
    assert!(matches!(again, SubmittedBatch::Accepted(_)), "the key was deleted with the batch");
}

/// A batch keeps its study and the points of its jobs, and returns the jobs in pages.
pub async fn a_batch_keeps_its_study(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let study = serde_json::json!({ "vary": { "design": "grid" }, "points": [[25, null], [30.5, "ü"]] });
    let new = NewBatch { study: Some(study.clone()), ..batch_of(&["a", "b", "c", "d"]) };
    let taken = bench.store.submit_batch(new).await.unwrap().batch().clone();
    assert_eq!((&taken.study, taken.places.as_slice()), (&Some(study), [0, 1, 2, 3].as_slice()));
    bench.queue("other").await;
    bench.store.delete(taken.jobs[1]).await.unwrap().unwrap();
    let now = bench.store.batch(taken.id).await.unwrap().unwrap();
    assert_eq!((&now.study, now.places.as_slice()), (&taken.study, [0, 2, 3].as_slice()));
    assert_eq!(bench.store.submit_batch(batch_of(&["e"])).await.unwrap().batch().study, None);

    let first = bench.store.batch_jobs(taken.id, None, 2).await.unwrap();
    let rest = bench.store.batch_jobs(taken.id, Some(first[1].id), 2).await.unwrap();
    let digests: Vec<&str> = first.iter().chain(&rest).map(|job| job.digest.as_str()).collect();
    assert_eq!(digests, ["a", "c", "d"]);
    assert_eq!(bench.store.batch_jobs(taken.id, Some(taken.jobs[3]), 2).await.unwrap(), []);
}
