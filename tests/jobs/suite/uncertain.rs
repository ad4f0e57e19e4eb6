//! Responses to commits that are lost: every operation finds out what became of it.

use super::bulk::bulk;
use super::owners::new_key;
use super::*;
use oviduct::clock::Stopwatch;
use oviduct::jobs::keys::{NewTicket, Secret, TicketSecret};
use oviduct::jobs::{BulkAction, Hook, Observation};
use std::collections::BTreeSet;
use std::fmt::Debug;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use uuid::Uuid;

/// Loses the response to the first commit of a call.
struct LosesFirst {
    call: &'static str,
    is_lost: AtomicBool,
}

impl Hook for LosesFirst {
    fn loses_commit(&self, call: &'static str) -> bool {
        self.call == call && !self.is_lost.swap(true, Ordering::SeqCst)
    }
}

/// What a caller sees of an operation. `store` is the view of the bench's store under test; all
/// else uses the bench's store itself.
type Scenario = for<'a> fn(&'a Bench, &'a Store) -> BoxFuture<'a, String>;

/// The debug form of a result.
fn seen(result: impl Debug) -> String {
    format!("{result:?}")
}

/// A running job with a checkpoint, and one that is queued.
async fn two_jobs(bench: &Bench) -> (ClaimedJob, Vec<JobId>) {
    let ids = vec![bench.queue("a").await.id, bench.queue("b").await.id];
    let claimed = bench.claim("w").await.unwrap();
    bench.store.set_checkpoint(&claimed, "models/checkpoint/1").await.unwrap();
    (claimed, ids)
}

fn worker() -> WorkerInfo {
    WorkerInfo {
        id: "w".into(),
        host: "host".into(),
        kind: WorkerKind::Cpu,
        device: "cpu".into(),
        jobs: Vec::new(),
        jobs_done: 1,
        heartbeat_at: Timestamp::MIN,
        pause: None,
        condition: None,
    }
}

fn batch() -> NewBatch {
    let jobs = vec![new_job("a"), new_job("b")];
    let (owner, quota, priority) = (None, Default::default(), Priority::default());
    NewBatch { jobs, owner, quota, priority, study: None, idempotency: None }
}

/// One scenario for each operation.
const SCENARIOS: &[(&str, Scenario)] = &[
    ("submit", |_, store| Box::pin(async move { seen(store.submit(new_job("a")).await) })),
    ("submit_batch", |_, store| Box::pin(async move { seen(store.submit_batch(batch()).await) })),
    ("claim", |bench, store| {
        Box::pin(async move {
            two_jobs(bench).await;
            seen(store.claim("v", ClaimScope::Cpu, LEASE, 2).await)
        })
    }),
    ("heartbeat", |bench, store| {
        Box::pin(async move {
            let (claimed, _) = two_jobs(bench).await;
            seen(store.heartbeat(&claimed, LEASE, &by_cpu(), Some(&progress(0.5)), None).await)
        })
    }),
    ("set_checkpoint", |bench, store| {
        Box::pin(async move {
            let (claimed, _) = two_jobs(bench).await;
            seen(store.set_checkpoint(&claimed, "models/checkpoint/2").await)
        })
    }),
    ("finish", |bench, store| {
        Box::pin(async move {
            let (claimed, _) = two_jobs(bench).await;
            let done = finished(&claimed);
            seen(store.finish(claimed, done).await)
        })
    }),
    ("fail", |bench, store| {
        Box::pin(async move {
            let (claimed, _) = two_jobs(bench).await;
            seen(store.fail(claimed, by_cpu(), problem("memory")).await)
        })
    }),
    ("cancelled", |bench, store| {
        Box::pin(async move {
            let (claimed, ids) = two_jobs(bench).await;
            bench.store.cancel(ids[0]).await.unwrap();
            seen(store.cancelled(claimed).await)
        })
    }),
    ("release", |bench, store| Box::pin(async move { seen(store.release(two_jobs(bench).await.0, None).await) })),
    ("yield_turn", |bench, store| Box::pin(async move { seen(store.yield_turn(two_jobs(bench).await.0).await) })),
    ("retry", |bench, store| Box::pin(async move { seen(store.retry(two_jobs(bench).await.0, problem("io")).await) })),
    ("cancel", |bench, store| {
        Box::pin(async move {
            // A queued job with a checkpoint, whose key the caller needs.
            let (claimed, ids) = two_jobs(bench).await;
            bench.store.release(claimed, None).await.unwrap();
            seen(store.cancel(ids[0]).await)
        })
    }),
    ("create_operation", |bench, store| {
        Box::pin(async move {
            two_jobs(bench).await;
            seen(store.create_operation(bulk(BulkAction::Cancel, ListFilter::default())).await)
        })
    }),
    ("step_operation", |bench, store| {
        Box::pin(async move {
            bench.succeed("a").await;
            bench.queue("b").await;
            let new = bulk(BulkAction::Delete, ListFilter::default());
            let id = bench.store.create_operation(new).await.unwrap().id;
            seen((store.step_operation(None).await, store.step_operation(Some(id)).await))
        })
    }),
    ("cancel_operation", |bench, store| {
        Box::pin(async move {
            let new = bulk(BulkAction::Delete, ListFilter::default());
            let id = bench.store.create_operation(new).await.unwrap().id;
            seen(store.cancel_operation(id).await)
        })
    }),
    ("delete", |bench, store| {
        Box::pin(async move {
            let id = bench.succeed("a").await.id;
            seen(store.delete(id).await)
        })
    }),
    ("delete_batch", |bench, store| {
        Box::pin(async move {
            let submitted = bench.store.submit_batch(batch()).await.unwrap();
            seen(store.delete_batch(submitted.batch().id).await)
        })
    }),
    ("expire", |bench, store| {
        Box::pin(async move {
            two_jobs(bench).await;
            bench.store.claim("v", ClaimScope::Gpu, LEASE, 1).await.unwrap();
            bench.clock.advance(2 * LEASE);
            seen(store.claim("v", ClaimScope::Cpu, LEASE, 1).await)
        })
    }),
    ("recover", |bench, store| {
        Box::pin(async move {
            two_jobs(bench).await;
            seen(store.recover().await)
        })
    }),
    ("queue_stranded", |_, store| Box::pin(async move { seen(store.queue_stranded().await) })),
    ("worker_seen", |_, store| Box::pin(async move { seen(store.worker_seen(&worker()).await) })),
    ("worker_stopped", |bench, store| {
        Box::pin(async move {
            bench.store.worker_seen(&worker()).await.unwrap();
            seen(store.worker_stopped("w").await)
        })
    }),
    ("set_paused", |_, store| Box::pin(async move { seen(store.set_paused(true, Some("me")).await) })),
    ("instruct", |bench, store| {
        Box::pin(async move {
            bench.store.worker_seen(&worker()).await.unwrap();
            seen(store.instruct("w", Instruction::Drain, None).await)
        })
    }),
    ("acquire_upkeep", |_, store| {
        Box::pin(async move { seen(store.acquire_upkeep(UpkeepTask::Orphans, "me", LEASE).await) })
    }),
    ("record_round", |bench, store| {
        Box::pin(async move {
            let watch = Stopwatch::start();
            let tolerance = Duration::from_secs(60);
            let round = |read_at| Observation { mismatch: None, watch, read_at, tolerance, trust: false };
            bench.queue("a").await;
            let first = bench.store.record_round(round(None)).await.unwrap();
            // The clock jumps ahead, which the round reports.
            bench.clock.set(bench.clock.now() + Duration::from_secs(86_400));
            let jump = store.record_round(round(Some(first.read_at))).await.unwrap().jump;
            assert!(jump.is_some());
            seen(jump)
        })
    }),
    ("add_key", |_, store| {
        Box::pin(async move { seen(store.add_key(new_key(&Secret::generate(), "lab", None)).await.is_ok()) })
    }),
    ("add_first_key", |_, store| {
        Box::pin(async move {
            let first = store.add_first_key(new_key(&Secret::generate(), "lab", None)).await;
            seen(first.map(|key| key.is_some()))
        })
    }),
    ("revoke_key", |bench, store| {
        Box::pin(async move {
            let key = bench.store.add_key(new_key(&Secret::generate(), "lab", None)).await.unwrap();
            let revoked = store.revoke_key(&key.prefix, LEASE).await;
            seen(revoked.map(|key| key.map(|key| key.revoked_at)))
        })
    }),
    ("add_ticket", |_, store| {
        Box::pin(async move {
            let (hash, key, path) = (TicketSecret::generate().hash(), "12345678".into(), "/events".into());
            seen(store.add_ticket(NewTicket { hash, key, path, life: LEASE }).await)
        })
    }),
    ("use_ticket", |bench, store| {
        Box::pin(async move {
            let (hash, key, path) = (TicketSecret::generate().hash(), "12345678".into(), "/events".into());
            bench.store.add_ticket(NewTicket { hash: String::clone(&hash), key, path, life: LEASE }).await.unwrap();
            seen(store.use_ticket(&hash, "/events").await)
        })
    }),
];

/// The text with every id replaced by the order of its first appearance.
fn without_ids(text: &str) -> String {
    let mut ids: Vec<&str> = Vec::new();
    let mut rest = text;
    while !rest.is_empty() {
        let step = match rest.get(..36).filter(|word| Uuid::try_parse(word).is_ok()) {
            Some(id) => {
                if !ids.contains(&id) {
                    ids.push(id);
                }
                36
            }
            None => rest.chars().next().map_or(1, char::len_utf8),
        };
        rest = &rest[step..];
    }
    ids.iter().enumerate().fold(text.to_owned(), |text, (n, id)| text.replace(id, &format!("#{n}")))
}

/// All jobs of a store, without their versions, which a second run may raise once more.
async fn jobs(store: &Store) -> String {
    let mut jobs = store.list(&ListFilter { limit: 100, ..ListFilter::default() }).await.unwrap().jobs;
    for job in &mut jobs {
        job.version = 0;
    }
    seen(jobs)
}

pub async fn a_lost_response_to_a_commit_changes_no_result(factory: Factory) {
    for (call, scenario) in SCENARIOS {
        let undisturbed = bench(factory, |_| {}).await;
        let expected = scenario(&undisturbed, &undisturbed.store).await;
        let disturbed = bench(factory, |_| {}).await;
        let hook = Arc::new(LosesFirst { call, is_lost: AtomicBool::new(false) });
        let found = scenario(&disturbed, &disturbed.store.with_hook(Arc::<LosesFirst>::clone(&hook))).await;
        assert!(hook.is_lost.load(Ordering::SeqCst), "{call}: no commit");
        if *call == "use_ticket" {
            // A ticket that may have been used is used.
            assert_eq!((expected.as_str(), found.as_str()), ("Ok(Some(\"12345678\"))", "Ok(None)"));
        } else {
            assert_eq!(without_ids(&found), without_ids(&expected), "{call}: result");
        }
        let (left, expected) = (jobs(&disturbed.store).await, jobs(&undisturbed.store).await);
        assert_eq!(without_ids(&left), without_ids(&expected), "{call}: jobs");
    }
}

/// Loses the responses to all commits of the calls that submit, while this is so.
struct LosesSubmissions(AtomicBool);

impl Hook for LosesSubmissions {
    fn loses_commit(&self, call: &'static str) -> bool {
        call.starts_with("submit") && self.0.load(Ordering::SeqCst)
    }
}

/// Runs `submit` without responses to its commits, deletes what it submitted by `delete`, and
/// returns the result of `submit` once responses arrive again.
async fn delete_before_the_response<T: Send + 'static>(
    bench: &Bench,
    submit: impl FnOnce(Store) -> BoxFuture<'static, T>,
    delete: impl AsyncFnOnce(JobId),
) -> T {
    let hook = Arc::new(LosesSubmissions(AtomicBool::new(true)));
    let submitting = tokio::spawn(submit(bench.store.with_hook(Arc::<LosesSubmissions>::clone(&hook))));
    let id = loop {
        let page = bench.store.list(&ListFilter { limit: 1, ..ListFilter::default() }).await.unwrap();
        if let Some(job) = page.jobs.first() {
            break job.id;
        }
        tokio::time::sleep(Duration::from_millis(1)).await;
    };
    delete(id).await;
    hook.0.store(false, Ordering::SeqCst);
    submitting.await.unwrap()
}

pub async fn a_retried_submission_creates_no_deleted_model_again(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let submit = |store: Store| -> BoxFuture<'static, _> { Box::pin(async move { store.submit(new_job("a")).await }) };
    let delete = async |id| assert!(bench.store.delete(id).await.unwrap().is_some());
    let submitted = delete_before_the_response(&bench, submit, delete).await.unwrap();
    assert!(matches!(submitted, Submitted::Queued(_)), "{submitted:?}");
    assert!(bench.store.get(submitted.job().id).await.unwrap().is_none());

    let submit = |store: Store| -> BoxFuture<'static, _> { Box::pin(async move { store.submit_batch(batch()).await }) };
    let delete = async |id| {
        let batch = bench.store.get(id).await.unwrap().unwrap().batch.unwrap();
        assert!(bench.store.delete_batch(batch).await.unwrap().is_some());
    };
    let submitted = delete_before_the_response(&bench, submit, delete).await.unwrap();
    assert!(matches!(submitted, SubmittedBatch::Accepted(_)), "{submitted:?}");
    assert!(bench.store.batch(submitted.batch().id).await.unwrap().is_none());
    assert_eq!(jobs(&bench.store).await, "[]");
}

/// Names of the operations in the source of the job store.
fn operations() -> BTreeSet<String> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/jobs/sql");
    let mut names = BTreeSet::new();
    for file in std::fs::read_dir(folder).unwrap() {
        let source = std::fs::read_to_string(file.unwrap().path()).unwrap();
        for call in [".apply(", ".change(", ".transact(", ".end(", ".apply_instruction("] {
            for (at, _) in source.match_indices(call) {
                let argument = source[at + call.len()..].trim_start();
                if let Some(name) = argument.strip_prefix('"').and_then(|rest| rest.split('"').next()) {
                    names.insert(name.to_owned());
                }
            }
        }
    }
    names
}

#[test]
fn every_operation_has_a_scenario() {
    let scenarios: BTreeSet<String> = SCENARIOS.iter().map(|(call, _)| (*call).to_owned()).collect();
    assert_eq!(scenarios, operations());
}
