//! List filters, bulk operations, lists of batches, retries.

use super::*;
use oviduct::jobs::{BulkAction, NewBulk};

fn ids(jobs: &[Job]) -> Vec<JobId> {
    jobs.iter().map(|job| job.id).collect()
}

pub(super) fn batch(digests: &[&str], owner: Option<&str>) -> NewBatch {
    NewBatch {
        study: None,
        jobs: digests.iter().map(|digest| new_job(digest)).collect(),
        owner: owner.map(str::to_owned),
        quota: Default::default(),
        priority: Priority::default(),
        idempotency: None,
    }
}

pub async fn lists_are_narrowed_by_time_batch_and_ids(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let mut jobs = Vec::new();
    for n in 0..6 {
        jobs.push(bench.queue(&n.to_string()).await);
        // The last two jobs are created within one millisecond.
        bench.clock.advance(if n < 4 { Duration::from_secs(60) } else { Duration::from_micros(200) });
    }
    let of_batch = bench.store.submit_batch(batch(&["a", "b"], None)).await.unwrap().batch().clone();
    let find = async |filter: ListFilter| {
        let filter = ListFilter { limit: 100, ..filter };
        let mut found = ids(&bench.store.list(&filter).await.unwrap().jobs);
        assert_eq!(bench.store.ids(&filter).await.unwrap(), found);
        found.reverse();
        found
    };
    let all = find(ListFilter::default()).await;
    let at = |n: usize| Some(jobs[n].created_at);
    let between = |created_after, created_before| ListFilter { created_after, created_before, ..ListFilter::default() };
    // A time range includes its start and excludes its end.
    assert_eq!(find(between(at(2), None)).await, all[2..]);
    assert_eq!(find(between(None, at(2))).await, all[..2]);
    assert_eq!(find(between(at(1), at(4))).await, all[1..4]);
    assert_eq!(find(between(at(5), None)).await, all[5..]);
    assert_eq!(find(between(None, at(5))).await, all[..5]);
    assert_eq!(find(between(at(3), at(3))).await, []);
    assert_eq!(find(ListFilter { batch: Some(of_batch.id), ..ListFilter::default() }).await, of_batch.jobs);
    let chosen = vec![jobs[4].id, JobId(uuid::Uuid::nil()), jobs[1].id];
    let filter = ListFilter { ids: chosen, ..ListFilter::default() };
    assert_eq!(find(filter.clone()).await, [jobs[1].id, jobs[4].id]);
    assert_eq!(find(ListFilter { created_after: at(2), ..filter.clone() }).await, [jobs[4].id]);
    let newest = ListFilter { limit: 1, ..filter };
    let page = bench.store.list(&newest).await.unwrap();
    assert_eq!((ids(&page.jobs), page.next), (vec![jobs[4].id], Some(jobs[4].id)));
    assert_eq!(bench.store.ids(&newest).await.unwrap(), [jobs[4].id]);
}

pub(super) fn bulk(action: BulkAction, filter: ListFilter) -> NewBulk {
    NewBulk { action, filter, conditions: vec![("status".into(), "any".into())], owner: None }
}

/// Executes an operation to its end. Returns the numbers of changed jobs after each transaction,
/// and the keys for removal.
async fn execute(bench: &Bench, new: NewBulk) -> (Vec<u64>, Vec<String>) {
    let id = bench.store.create_operation(new).await.unwrap().id;
    let (mut changed, mut keys) = (Vec::new(), Vec::new());
    while let Some(step) = bench.store.step_operation(Some(id)).await.unwrap() {
        changed.push(step.operation.changed);
        keys.extend(step.keys);
        assert_eq!(bench.store.operation(id).await.unwrap(), Some(step.operation));
    }
    assert_eq!(bench.store.operation(id).await.unwrap().unwrap().status, Status::Succeeded);
    (changed, keys)
}

pub async fn many_jobs_are_cancelled(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let done = bench.succeed("done").await;
    let running = bench.queue("running").await;
    let claimed = bench.claim("w").await.unwrap();
    bench.store.set_checkpoint(&claimed, "kept").await.unwrap();
    let waiting = bench.queue("waiting").await;
    let again = bench.queue("again").await;
    let attempt = bench.claim("v").await.unwrap();
    assert_eq!(attempt.job().id, waiting.id);
    bench.store.set_checkpoint(&attempt, "left").await.unwrap();
    bench.store.release(attempt, None).await.unwrap();
    let mut changes = bench.store.changes();
    let all = || bulk(BulkAction::Cancel, ListFilter::default());
    assert_eq!(bench.store.count_affected(BulkAction::Cancel, &ListFilter::default()).await.unwrap(), 3);
    let (changed, keys) = execute(&bench, all()).await;
    // The running job is only asked to stop, so its record keeps its checkpoint. The second search
    // finds nothing more.
    assert_eq!((changed, keys), (vec![2, 3, 3, 3], vec!["left".to_owned()]));
    let told: Vec<_> = (0..3).map(|_| changes.try_recv().unwrap().id).collect();
    assert_eq!(told, [waiting.id, again.id, running.id]);
    assert_eq!(execute(&bench, all()).await, (vec![0, 0], vec![]));
    assert_eq!(bench.get(waiting.id).await.status, Status::Cancelled);
    assert_eq!(bench.get(done.id).await, done);
    assert_eq!(bench.beat(&claimed).await, Directive::Cancel);
    let ended = ListFilter { status: Some(Status::Succeeded), ..ListFilter::default() };
    assert_eq!(execute(&bench, bulk(BulkAction::Cancel, ended)).await, (vec![0], vec![]));
}

pub async fn many_jobs_are_removed(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let done = bench.succeed("done").await;
    bench.clock.advance(Duration::from_secs(60));
    let shared = bench.store.submit(new_job("done")).await.unwrap().job().clone();
    bench.clock.advance(Duration::from_secs(60));
    let waiting = bench.queue("waiting").await;
    let mut changes = bench.store.changes();
    let some = |ids: &[&Job]| ListFilter { ids: ids.iter().map(|job| job.id).collect(), ..ListFilter::default() };
    let (changed, keys) = execute(&bench, bulk(BulkAction::Delete, some(&[&done, &waiting]))).await;
    assert_eq!((changed, keys), (vec![2], vec![]), "the other job still names the files");
    let told: Vec<_> = (0..2).map(|_| changes.try_recv().unwrap()).collect();
    assert_eq!(told, [done.id, waiting.id].map(|id| Change { id, version: None }));
    let running = ListFilter { status: Some(Status::Running), ..some(&[&shared]) };
    assert_eq!(execute(&bench, bulk(BulkAction::Delete, running)).await.0, [0]);
    let (changed, keys) = execute(&bench, bulk(BulkAction::Delete, some(&[&shared]))).await;
    assert_eq!((changed, keys.len()), (vec![1], objects(&done.files)));
    assert_eq!(bench.store.counts().await.unwrap(), Counts::default());
}

pub async fn an_operation_changes_all_jobs_that_matched_and_no_later_ones(factory: Factory) {
    let bench = bench(factory, |options| options.queue_limit = 1000).await;
    let digests: Vec<String> = (0..250).map(|n| n.to_string()).collect();
    let all: Vec<&str> = digests.iter().map(String::as_str).collect();
    bench.store.submit_batch(batch(&all, None)).await.unwrap();
    let operation = bench.store.create_operation(bulk(BulkAction::Delete, ListFilter::default())).await.unwrap();
    assert_eq!((operation.status, operation.total, operation.changed), (Status::Queued, 250, 0));
    bench.clock.advance(Duration::from_secs(1));
    let later = bench.queue("later").await;
    let first = bench.store.step_operation(None).await.unwrap().unwrap().operation;
    assert_eq!((first.status, first.changed), (Status::Running, 100));
    let mut last = first;
    while let Some(step) = bench.store.step_operation(None).await.unwrap() {
        last = step.operation;
    }
    assert_eq!((last.status, last.changed, last.finished_at.is_some()), (Status::Succeeded, 250, true));
    let left = bench.store.list(&ListFilter { limit: 10, ..ListFilter::default() }).await.unwrap();
    assert_eq!(ids(&left.jobs), [later.id]);
    // A cancelled operation changes no more jobs.
    let stopped = bench.store.create_operation(bulk(BulkAction::Delete, ListFilter::default())).await.unwrap();
    let stopped = bench.store.cancel_operation(stopped.id).await.unwrap().unwrap();
    assert_eq!(stopped.status, Status::Cancelled);
    assert_eq!(bench.store.step_operation(Some(stopped.id)).await.unwrap(), None);
    assert_eq!(bench.store.cancel_operation(stopped.id).await.unwrap(), Some(stopped));
    assert_eq!(bench.get(later.id).await.status, Status::Queued);
}

pub async fn operations_of_owners_take_turns(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let mut made = Vec::new();
    for (owner, jobs) in [("a", 250), ("b", 250)] {
        let digests: Vec<String> = (0..jobs).map(|n| format!("{owner}{n}")).collect();
        let all: Vec<&str> = digests.iter().map(String::as_str).collect();
        bench.store.submit_batch(batch(&all, Some(owner))).await.unwrap();
    }
    for (owner, action) in [("a", BulkAction::Cancel), ("a", BulkAction::Delete), ("b", BulkAction::Delete)] {
        bench.clock.advance(Duration::from_secs(1));
        let filter = ListFilter { owner: Some(owner.into()), ..ListFilter::default() };
        let new = NewBulk { owner: Some(owner.into()), ..bulk(action, filter) };
        made.push(bench.store.create_operation(new).await.unwrap());
    }
    let mut order = Vec::new();
    for _ in 0..6 {
        bench.clock.advance(Duration::from_secs(1));
        let step = bench.store.step_operation(None).await.unwrap().unwrap();
        order.push(made.iter().position(|operation| operation.id == step.operation.id).unwrap());
    }
    assert_eq!(order, [0, 2, 1, 2, 0, 2]);
    let page = bench.store.operations(Some("a"), None, 1).await.unwrap();
    assert_eq!((page.operations[0].id, page.next), (made[1].id, Some(made[1].id)));
    let page = bench.store.operations(Some("a"), page.next, 1).await.unwrap();
    assert_eq!((page.operations[0].id, page.next), (made[0].id, None));
    assert_eq!(bench.store.operations(None, None, 10).await.unwrap().operations.len(), 3);
    // The operation of b has ended: after a week it is deleted.
    bench.clock.advance(Duration::from_secs(8 * 24 * 3600));
    bench.store.create_operation(bulk(BulkAction::Cancel, ListFilter::default())).await.unwrap();
    assert_eq!(bench.store.operation(made[2].id).await.unwrap(), None);
    assert!(bench.store.operation(made[0].id).await.unwrap().is_some(), "it has not ended");
}

pub async fn batches_are_listed(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let mut made = Vec::new();
    for n in 0..5 {
        let digests = [format!("{n}a"), format!("{n}b")];
        let owner = Some(if n % 2 == 0 { "even" } else { "odd" });
        let new = batch(&digests.each_ref().map(String::as_str), owner);
        made.push(bench.store.submit_batch(new).await.unwrap().batch().clone());
        bench.clock.advance(Duration::from_secs(60));
    }
    bench.store.cancel(made[1].jobs[0]).await.unwrap();
    let list = async |filter: BatchFilter| bench.store.batches(&filter).await.unwrap();
    let mut seen = Vec::new();
    let mut filter = BatchFilter { limit: 2, ..BatchFilter::default() };
    loop {
        let page = list(filter.clone()).await;
        seen.extend(page.batches);
        let Some(next) = page.next else { break };
        filter.before = Some(next);
    }
    seen.reverse();
    for (n, (seen, made)) in seen.iter().zip(&made).enumerate() {
        let cancelled = u64::from(n == 1);
        assert_eq!(seen.counts, Counts { queued: 2 - cancelled, cancelled, ..Counts::default() });
        let batch = bench.store.batch(made.id).await.unwrap().unwrap();
        assert_eq!(*seen, oviduct::jobs::Batch { jobs: vec![], places: vec![], ..batch });
    }
    assert_eq!(seen.len(), made.len());
    let found = |page: oviduct::jobs::BatchPage| page.batches.iter().map(|batch| batch.id).collect::<Vec<_>>();
    let all = BatchFilter { limit: 100, ..BatchFilter::default() };
    let odd = list(BatchFilter { owner: Some("odd".into()), ..all.clone() }).await;
    assert_eq!(found(odd), [made[3].id, made[1].id]);
    let (after, before) = (Some(made[1].created_at), Some(made[3].created_at));
    let middle = list(BatchFilter { created_after: after, created_before: before, ..all.clone() }).await;
    assert_eq!(found(middle), [made[2].id, made[1].id]);
}

pub async fn a_retry_goes_into_the_batch_of_the_failed_job(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let made = bench.store.submit_batch(batch(&["a"], None)).await.unwrap().batch().clone();
    let claimed = bench.claim("first").await.unwrap();
    assert_eq!(bench.get(made.jobs[0]).await.worker.as_deref(), Some("first"));
    let failed = bench.fail(claimed, "certificate").await;
    assert_eq!(failed.worker.as_deref(), Some("first"));
    let again = || NewJob { retry_of: Some(failed.id), ..new_job("a") };
    let job = bench.store.submit(again()).await.unwrap().job().clone();
    assert_eq!((job.retry_of, job.batch, job.worker), (Some(failed.id), Some(made.id), None));
    let now = bench.store.batch(made.id).await.unwrap().unwrap();
    assert_eq!((now.jobs, now.counts.queued, now.counts.failed), (vec![failed.id, job.id], 1, 1));
    bench.store.delete_batch(made.id).await.unwrap();
    let alone = bench.store.submit(again()).await.unwrap().job().clone();
    assert_eq!((alone.retry_of, alone.batch), (Some(failed.id), None), "the batch is gone");
}
