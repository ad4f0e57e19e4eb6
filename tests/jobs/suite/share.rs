//! Shared growth of equal requests.

use super::bulk::bulk;
use super::*;
use oviduct::jobs::BulkAction;

impl Bench {
    /// Claims all jobs that a worker may claim; returns their ids.
    async fn claimable(&self) -> Vec<JobId> {
        let claimed = self.store.claim("w", ClaimScope::Cpu, LEASE, 100).await.unwrap();
        claimed.iter().map(|claimed| claimed.job().id).collect()
    }
}

pub async fn equal_jobs_share_one_growth(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let outputs = |outputs: &[Output]| NewJob { outputs: outputs.to_vec().into(), ..new_job("d") };
    let first = bench.submit(outputs(&[Output::Glb, Output::Obj])).await.id;
    let mut others = Vec::new();
    for n in 0..50 {
        others.push(bench.submit(if n % 2 == 0 { new_job("d") } else { outputs(&[]) }).await.id);
    }
    assert_eq!(bench.get(others[7]).await.queue_position, Some(1), "behind the one that is claimed first");
    let claimed = bench.claim("w").await.unwrap();
    assert_eq!(claimed.job().id, first);
    others.push(bench.submit(new_job("d")).await.id);
    assert!(bench.claim("w").await.is_none());
    assert_eq!(bench.store.counts().await.unwrap(), Counts { queued: 51, running: 1, ..Counts::default() });

    // Released and expired attempts leave the waiting jobs unchanged.
    bench.store.release(claimed, None).await.unwrap();
    bench.claim("w").await.unwrap();
    bench.clock.advance(LEASE);
    let claimed = bench.claim("w").await.unwrap();
    assert_eq!(claimed.job().id, first);

    let mut changes = bench.store.changes();
    let made = bench.finish(claimed).await;
    let told: Vec<Change> = std::iter::from_fn(|| changes.try_recv().ok()).collect();
    assert_eq!(told.len(), 52);
    for &id in &others {
        let job = bench.get(id).await;
        assert!(told.contains(&Change { id, version: Some(job.version) }));
        assert_eq!((job.status, job.reused_from, job.attempts), (Status::Succeeded, Some(first), 0));
        assert_eq!((&job.summary, &job.backend), (&made.summary, &made.backend));
        assert_eq!(job.finished_at, made.finished_at);
        let expected = made.files.iter().filter(|file| !job.outputs.formats.is_empty() || file.name != "model.glb");
        assert!(job.files.iter().eq(expected), "{:?}", job.files);
    }
    // The files exist until the last job that shares them is deleted.
    assert_eq!(bench.store.delete(first).await.unwrap(), Some(vec![]));
    assert!(matches!(bench.store.submit(new_job("d")).await.unwrap(), Submitted::Reused(_)));
}

pub async fn jobs_that_differ_share_nothing(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let first = bench.submit(NewJob { owner: Some("ann".into()), ..new_job("d") }).await.id;
    let change: [fn(&mut NewJob); 7] = [
        |new| new.owner = None,
        |new| new.digest = "e".into(),
        |new| new.preset = "paper".into(),
        |new| new.backend = Backend::Cpu,
        |new| new.outputs = vec![Output::Glb, Output::Obj].into(),
        |new| new.reuse = false,
        |new| new.priority = 1.try_into().unwrap(),
    ];
    let mut claimable = vec![first];
    for change in change {
        let mut new = NewJob { owner: Some("ann".into()), ..new_job("d") };
        change(&mut new);
        claimable.push(bench.submit(new).await.id);
    }
    let less_urgent = NewJob { owner: Some("ann".into()), priority: (-1).try_into().unwrap(), ..new_job("d") };
    bench.submit(less_urgent).await;
    claimable.sort_unstable();
    let mut claimed = bench.claimable().await;
    claimed.sort_unstable();
    assert_eq!(claimed, claimable, "all but the last");
}

pub async fn the_next_equal_job_grows_if_the_first_is_cancelled_or_deleted(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let mut jobs = Vec::new();
    for priority in [0, -1, 0, 0, 0, 0, 0] {
        jobs.push(bench.submit(NewJob { priority: priority.try_into().unwrap(), ..new_job("d") }).await.id);
    }
    let mut changes = bench.store.changes();
    bench.store.cancel(jobs[0]).await.unwrap();
    let told: Vec<JobId> = std::iter::from_fn(|| changes.try_recv().ok()).map(|change| change.id).collect();
    assert_eq!(told, [jobs[0], jobs[2]], "the most urgent that waits, then the oldest");
    // Cancelling or deleting a waiting job affects no other job.
    bench.store.cancel(jobs[3]).await.unwrap();
    bench.store.delete(jobs[4]).await.unwrap();
    bench.store.delete(jobs[2]).await.unwrap();
    let running = bench.claim("w").await.unwrap();
    assert_eq!(running.job().id, jobs[5]);
    // A running job is cancelled. No job waits for it any more, and the next equal job is claimed
    // after it has stopped.
    bench.store.cancel(jobs[5]).await.unwrap();
    let late = bench.submit(new_job("d")).await.id;
    assert_eq!(bench.claimable().await, [late]);
    bench.store.cancelled(running).await.unwrap();
    let next = bench.claim("w").await.unwrap();
    assert_eq!(next.job().id, jobs[6]);
    bench.store.delete(jobs[6]).await.unwrap();
    let last = bench.claim("w").await.unwrap();
    assert_eq!(last.job().id, jobs[1]);
    bench.finish(last).await;
    assert_eq!(bench.store.counts().await.unwrap().queued, 0);
}

pub async fn equal_jobs_fail_together(factory: Factory) {
    let bench = bench(factory, |options| options.max_attempts = 1).await;
    for exhausted in [false, true] {
        let first = bench.submit(new_job("d")).await.id;
        let second = bench.submit(new_job("d")).await.id;
        let claimed = bench.claim("w").await.unwrap();
        if exhausted {
            bench.clock.advance(LEASE);
            assert!(bench.claim("w").await.is_none());
        } else {
            bench.store.fail(claimed, by_cpu(), problem("certificate")).await.unwrap();
        }
        let (first, second) = (bench.get(first).await, bench.get(second).await);
        assert_eq!((second.status, &second.problem), (Status::Failed, &first.problem));
        assert_eq!((second.finished_at, second.attempts), (first.finished_at, 0));
    }
    assert!(matches!(bench.store.submit(new_job("d")).await.unwrap(), Submitted::Queued(_)));
    assert!(bench.claim("w").await.is_some(), "a failed job is not waited for");
}

/// Waiting jobs do not accept files from another engine version or files that lack an output.
pub async fn unsuitable_files_are_not_shared(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    bench.submit(new_job("d")).await;
    let second = bench.submit(new_job("d")).await.id;
    let claimed = bench.claim("w").await.unwrap();
    let done = Finished { engine: "0.0.9".into(), ..finished(&claimed) };
    bench.store.finish(claimed, done).await.unwrap();
    assert_eq!(bench.claimable().await, [second]);

    let both = || NewJob { outputs: vec![Output::Glb, Output::Obj].into(), ..new_job("e") };
    let first = bench.submit(new_job("e")).await.id;
    let larger = bench.submit(both()).await.id;
    let waits = bench.submit(both()).await.id;
    let claimed = bench.claim("w").await.unwrap();
    assert_eq!(claimed.job().id, first);
    bench.finish(claimed).await;
    assert_eq!(bench.get(waits).await.status, Status::Queued);
    let claimed = bench.store.claim("w", ClaimScope::Cpu, LEASE, 100).await.unwrap();
    let ids: Vec<JobId> = claimed.iter().map(|claimed| claimed.job().id).collect();
    assert_eq!(ids, [larger, waits], "the end of one grows the next, because the other has not ended yet");
}

pub async fn equal_points_of_batches_share_growths(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let mut batches = Vec::new();
    for _ in 0..2 {
        let submitted = bench.store.submit_batch(batch(&["a", "b", "a"], None)).await.unwrap();
        batches.push(submitted.batch().clone());
    }
    let first = bench.store.claim("w", ClaimScope::Cpu, LEASE, 100).await.unwrap();
    assert_eq!(first.len(), 2);
    // Deleting the claimed jobs queues one job of each kind again.
    bench.store.delete_batch(batches[0].id).await.unwrap();
    let again = bench.store.claim("w", ClaimScope::Cpu, LEASE, 100).await.unwrap();
    assert_eq!(again.len(), 2);
    for claimed in again {
        bench.finish(claimed).await;
    }
    let counts = bench.store.counts().await.unwrap();
    assert_eq!(counts, Counts { succeeded: 3, ..Counts::default() });
    // Cancelling many equal jobs at once ends all of them.
    for n in 0..300 {
        bench.submit(NewJob { digest: format!("{}", n % 2), ..new_job("") }).await;
    }
    bench.store.create_operation(bulk(BulkAction::Cancel, ListFilter::default())).await.unwrap();
    while bench.store.step_operation(None).await.unwrap().is_some() {}
    assert_eq!(bench.store.counts().await.unwrap().cancelled, 300);
}

pub async fn racing_equal_submissions_share_one_growth(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let submissions = (0..40).map(|_| bench.store.submit(new_job("d")));
    for submitted in join_all(submissions).await {
        assert!(matches!(submitted.unwrap(), Submitted::Queued(_)));
    }
    let claimed = bench.store.claim("w", ClaimScope::Cpu, LEASE, 100).await.unwrap();
    assert_eq!(claimed.len(), 1);
    // Submissions that race with the end of the growth neither wait forever nor cause a second
    // growth.
    let racing = join_all((0..40).map(|_| bench.store.submit(new_job("d"))));
    let done = finished(&claimed[0]);
    let (racing, ended) = tokio::join!(racing, bench.store.finish(claimed.into_iter().next().unwrap(), done));
    ended.unwrap();
    assert!(racing.iter().all(Result::is_ok));
    assert_eq!(bench.store.counts().await.unwrap(), Counts { succeeded: 80, ..Counts::default() });
}

/// If a released job would run later than a job that waits for it, the waiting job is queued
/// itself.
pub async fn a_job_does_not_wait_for_one_that_is_queued_again_behind_it(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let with_priority = |priority: i64| NewJob { priority: priority.try_into().unwrap(), ..new_job("d") };
    let low = bench.submit(with_priority(-9)).await.id;
    let claimed = bench.claim("w").await.unwrap();
    let high = bench.submit(with_priority(9)).await.id;
    let middle = bench.submit(with_priority(0)).await.id;
    assert!(bench.claim("w").await.is_none());
    bench.store.release(claimed, None).await.unwrap();
    let next = bench.claim("w").await.unwrap();
    assert_eq!(next.job().id, high);
    bench.finish(next).await;
    assert_eq!(bench.get(middle).await.reused_from, Some(high));
    assert_eq!(bench.claim("w").await.unwrap().job().id, low);
}
