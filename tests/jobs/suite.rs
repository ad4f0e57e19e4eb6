//! What every store must do. Each function takes a factory of empty stores; [`over`] makes the tests of one
//! store from all of them.

use futures_util::future::{BoxFuture, join_all};
use jiff::Timestamp;
use oviduct::clock::Clock;
use oviduct::generate::{Backend, Output, Progress, Stage};
use oviduct::jobs::state::AttemptEnd;
use oviduct::jobs::{
    BackendReport, Change, ClaimedJob, Directive, File, Finished, Job, JobId, ListFilter, LiveSection, NewJob, Problem,
    Status, Store, StoreError, StoreOptions, Submitted, WorkerInfo,
};
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;
use std::time::Duration;

/// Makes an empty store; the second value keeps alive what it stands on.
pub type Factory = fn(StoreOptions) -> BoxFuture<'static, (Arc<dyn Store>, Box<dyn Send>)>;

pub const LEASE: Duration = Duration::from_secs(8);

/// Makes a test of each function of the suite, over the stores that `$factory` makes.
macro_rules! over {
    ($factory:expr; $($test:ident)*) => {
        $(
            #[tokio::test(flavor = "multi_thread", worker_threads = 4)]
            async fn $test() {
                crate::suite::$test($factory).await;
            }
        )*
    };
    ($factory:expr) => {
        crate::suite::over! { $factory;
            a_job_goes_from_the_queue_to_its_end
            a_heartbeat_renews_and_tells_only_of_news
            a_stale_attempt_changes_nothing
            an_expired_lease_is_claimed_again_before_younger_jobs
            attempts_are_used_up_with_their_history
            retries_wait_and_count_and_releases_do_not
            cancel_is_idempotent_in_every_state
            delete_in_every_state
            an_idempotency_key_gives_one_job
            racing_idempotency_keys_give_one_job
            a_finished_digest_is_reused
            shared_files_go_with_the_last_job
            the_queue_has_a_limit
            lists_are_filtered_and_paged
            queue_positions_are_by_age
            claims_keep_to_their_backend
            workers_are_seen
            four_claimers_end_each_job_once
        }
    };
}
pub(crate) use over;

pub fn new_job(digest: &str) -> NewJob {
    NewJob {
        preset: "pig".into(),
        seed: (1 << 53) - 1,
        spec: serde_json::json!({ "length_mm": 60.0, "steps": 2000 }),
        outputs: vec![Output::Glb],
        backend: Backend::Auto,
        labels: BTreeMap::new(),
        digest: digest.into(),
        reuse: true,
        idempotency: None,
    }
}

pub fn problem(kind: &str) -> Problem {
    Problem { kind: kind.into(), title: "A fault".into(), detail: "somewhere".into() }
}

fn by_cpu() -> BackendReport {
    BackendReport {
        requested: Backend::Auto,
        used: Some(Backend::Cpu),
        device: Some("cpu, 2 threads".into()),
        fallback: None,
    }
}

fn progress(fraction: f64) -> Progress {
    Progress {
        stage: Stage::Simulate,
        fraction,
        step: 10,
        steps: 2000,
        particles: 710,
        sections: 2,
        eta_seconds: Some(3.5),
    }
}

fn file(claimed: &ClaimedJob, name: &str) -> File {
    File {
        name: name.into(),
        media_type: "application/octet-stream".into(),
        bytes: 5,
        sha256: "00".repeat(32),
        key: oviduct::jobs::artifacts::key(claimed.job().id, claimed.attempt(), name),
    }
}

fn finished(claimed: &ClaimedJob) -> Finished {
    let names = ["sections.bin", "report.json", "model.glb"];
    Finished {
        backend: by_cpu(),
        files: names.iter().map(|name| file(claimed, name)).collect(),
        summary: serde_json::json!({ "vertices": 790_211 }),
    }
}

struct Bench {
    store: Arc<dyn Store>,
    clock: Clock,
    _ground: Box<dyn Send>,
}

async fn bench(factory: Factory, change: impl FnOnce(&mut StoreOptions)) -> Bench {
    let clock = Clock::manual("2026-01-02T03:04:05.678901Z".parse().unwrap());
    let mut options = StoreOptions { clock: clock.clone(), ..StoreOptions::default() };
    change(&mut options);
    let (store, ground) = factory(options).await;
    Bench { store, clock, _ground: ground }
}

impl Bench {
    async fn queue(&self, digest: &str) -> Job {
        let submitted = self.store.submit(new_job(digest)).await.unwrap();
        assert!(matches!(submitted, Submitted::Queued(_)), "{submitted:?}");
        submitted.job().clone()
    }

    async fn claim(&self, worker: &str) -> Option<ClaimedJob> {
        let mut claimed = self.store.claim(worker, Backend::Cpu, LEASE, 1).await.unwrap();
        assert!(claimed.len() <= 1);
        claimed.pop()
    }

    async fn get(&self, id: JobId) -> Job {
        self.store.get(id).await.unwrap().unwrap()
    }

    async fn beat(&self, claimed: &ClaimedJob) -> Directive {
        self.store.heartbeat(claimed, LEASE, &by_cpu(), None, None).await.unwrap()
    }

    async fn succeed(&self, digest: &str) -> Job {
        self.queue(digest).await;
        let claimed = self.claim("maker").await.unwrap();
        let done = finished(&claimed);
        self.store.finish(claimed, done).await.unwrap()
    }
}

pub async fn a_job_goes_from_the_queue_to_its_end(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let mut changes = bench.store.changes();
    let mut new = new_job("d");
    new.labels = BTreeMap::from([("study".into(), "A3".into()), ("x\"'".into(), "ü".into())]);
    let queued = bench.store.submit(new.clone()).await.unwrap().job().clone();
    assert_eq!(queued.status, Status::Queued);
    assert_eq!((queued.version, queued.queue_position, queued.attempts), (1, Some(0), 0));
    assert_eq!((&queued.labels, queued.seed, &queued.spec), (&new.labels, new.seed, &new.spec));
    assert_eq!((queued.created_at, queued.started_at), (bench.clock.now(), None));
    assert_eq!(bench.get(queued.id).await, queued);

    bench.clock.advance(Duration::from_millis(1500));
    let claimed = bench.claim("w1").await.unwrap();
    let running = bench.get(queued.id).await;
    assert_eq!(&running, claimed.job());
    assert_eq!((running.status, running.attempts, claimed.attempt()), (Status::Running, 1, 1));
    assert_eq!((running.queue_position, running.started_at), (None, Some(bench.clock.now())));
    assert!(bench.claim("w2").await.is_none(), "claimed twice");

    let live = LiveSection { index: 3, step: 40, z_um: 1.5, inner: vec![[0.25, 1.0]], outer: vec![[2.0, 3.5]] };
    let at = progress(0.25);
    let told = bench.store.heartbeat(&claimed, LEASE, &by_cpu(), Some(&at), Some(&live)).await.unwrap();
    assert_eq!(told, Directive::Continue);
    let seen = bench.get(queued.id).await;
    assert_eq!((seen.progress, &seen.section, &seen.backend), (Some(at), &Some(live), &by_cpu()));

    bench.clock.advance(Duration::from_secs(3));
    let done = finished(&claimed);
    let ended = bench.store.finish(claimed, done.clone()).await.unwrap();
    assert_eq!(ended, bench.get(queued.id).await);
    assert_eq!((ended.status, ended.finished_at), (Status::Succeeded, Some(bench.clock.now())));
    assert_eq!((&ended.files, ended.summary.as_ref()), (&done.files, Some(&done.summary)));
    assert!(ended.version > seen.version && seen.version > running.version && running.version > queued.version);
    assert!(bench.store.names_key(&done.files[0].key).await.unwrap());
    assert!(!bench.store.names_key("models/none").await.unwrap());

    let mut told = Vec::new();
    while let Ok(Change { id, version }) = changes.try_recv() {
        assert_eq!(id, queued.id);
        told.push(version.unwrap());
    }
    assert_eq!(told, [queued.version, running.version, seen.version, ended.version]);
    let attempts = bench.store.attempts(queued.id).await.unwrap();
    assert_eq!(attempts.len(), 1);
    assert_eq!((attempts[0].worker.as_str(), attempts[0].outcome), ("w1", Some(AttemptEnd::Succeeded)));
    bench.store.ready().await.unwrap();
}

pub async fn a_heartbeat_renews_and_tells_only_of_news(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let id = bench.queue("d").await.id;
    let claimed = bench.claim("w1").await.unwrap();
    assert_eq!(bench.beat(&claimed).await, Directive::Continue);
    let version = bench.get(id).await.version;
    let mut changes = bench.store.changes();
    for _ in 0..5 {
        bench.clock.advance(LEASE - Duration::from_secs(1));
        assert_eq!(bench.beat(&claimed).await, Directive::Continue);
        assert!(bench.claim("w2").await.is_none(), "a renewed lease was taken");
    }
    assert_eq!(bench.get(id).await.version, version);
    assert!(changes.try_recv().is_err());
    let at = progress(0.5);
    bench.store.heartbeat(&claimed, LEASE, &by_cpu(), Some(&at), None).await.unwrap();
    assert_eq!(changes.try_recv().unwrap(), Change { id, version: Some(version + 1) });
}

pub async fn a_stale_attempt_changes_nothing(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let id = bench.queue("d").await.id;
    // Five attempts of the same worker name let the lease go; each is held against the sixth.
    let mut stale = Vec::new();
    for _ in 0..4 {
        stale.push(bench.claim("w").await.unwrap());
        bench.clock.advance(LEASE);
    }
    let present = bench.claim("w").await.unwrap();
    let before = bench.get(id).await;
    for claimed in &stale {
        let at = progress(0.9);
        let told = bench.store.heartbeat(claimed, LEASE, &by_cpu(), Some(&at), None).await.unwrap();
        assert_eq!(told, Directive::Lost);
    }
    let mut stale = stale.into_iter();
    let fenced = |result: Result<(), StoreError>| assert!(matches!(result, Err(StoreError::Fenced)), "{result:?}");
    let one = stale.next().unwrap();
    let done = finished(&one);
    fenced(bench.store.finish(one, done.clone()).await.map(drop));
    fenced(bench.store.fail(stale.next().unwrap(), by_cpu(), problem("panic")).await.map(drop));
    fenced(bench.store.cancelled(stale.next().unwrap()).await.map(drop));
    fenced(bench.store.release(stale.next().unwrap()).await);
    assert_eq!(bench.get(id).await, before);
    assert!(!bench.store.names_key(&done.files[0].key).await.unwrap());
    let done = finished(&present);
    assert_eq!(bench.store.finish(present, done).await.unwrap().attempts, 5);
}

pub async fn an_expired_lease_is_claimed_again_before_younger_jobs(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let first = bench.queue("1").await.id;
    let lost = bench.claim("w1").await.unwrap();
    let at = progress(0.5);
    bench.store.heartbeat(&lost, LEASE, &by_cpu(), Some(&at), None).await.unwrap();
    let second = bench.queue("2").await.id;
    bench.clock.advance(LEASE - Duration::from_micros(1));
    assert_eq!(bench.claim("w2").await.unwrap().job().id, second);
    bench.clock.advance(Duration::from_micros(1));
    let again = bench.claim("w3").await.unwrap();
    assert_eq!((again.job().id, again.attempt(), again.job().progress), (first, 2, None));
    let attempts = bench.store.attempts(first).await.unwrap();
    assert_eq!(attempts[0].outcome, Some(AttemptEnd::Vanished));
    assert_eq!((attempts[1].worker.as_str(), attempts[1].outcome), ("w3", None));
}

pub async fn attempts_are_used_up_with_their_history(factory: Factory) {
    let bench = bench(factory, |options| options.max_attempts = 3).await;
    let id = bench.queue("d").await.id;
    for n in 1..=3 {
        assert_eq!(bench.claim(&format!("w{n}")).await.unwrap().attempt(), n);
        bench.clock.advance(LEASE);
    }
    assert!(bench.claim("w4").await.is_none());
    let job = bench.get(id).await;
    assert_eq!((job.status, job.attempts), (Status::Failed, 3));
    let problem = job.problem.unwrap();
    assert_eq!(problem.kind, "attempts-exhausted");
    for n in 1..=3 {
        assert!(problem.detail.contains(&format!("attempt {n} by w{n}: the worker vanished")), "{}", problem.detail);
    }
}

pub async fn retries_wait_and_count_and_releases_do_not(factory: Factory) {
    let bench = bench(factory, |options| options.max_attempts = 2).await;
    let id = bench.queue("d").await.id;
    for _ in 0..4 {
        let claimed = bench.claim("w").await.unwrap();
        bench.store.release(claimed).await.unwrap();
    }
    let claimed = bench.claim("w").await.unwrap();
    let job = bench.store.retry(claimed, problem("io")).await.unwrap();
    assert_eq!((job.status, job.queue_position), (Status::Queued, Some(0)));
    assert!(bench.claim("w").await.is_none(), "claimed without waiting");
    bench.clock.advance(Duration::from_secs(1));
    let claimed = bench.claim("w").await.unwrap();
    let job = bench.store.retry(claimed, problem("io")).await.unwrap();
    assert_eq!((job.status, job.attempts), (Status::Failed, 6));
    let problem = job.problem.unwrap();
    assert_eq!(problem.kind, "attempts-exhausted");
    assert!(problem.detail.contains("attempt 4 by w: given back"), "{}", problem.detail);
    assert!(problem.detail.contains("(io: somewhere)"), "{}", problem.detail);
    let outcomes: Vec<_> = bench.store.attempts(id).await.unwrap().iter().map(|a| a.outcome.unwrap()).collect();
    use AttemptEnd::{Released, Retried};
    assert_eq!(outcomes, [Released, Released, Released, Released, Retried, Retried]);
}

pub async fn cancel_is_idempotent_in_every_state(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let unknown = JobId(uuid::Uuid::now_v7());
    assert_eq!(bench.store.cancel(unknown).await.unwrap(), None);
    // Queued: ends at once.
    let queued = bench.queue("1").await.id;
    let ended = bench.store.cancel(queued).await.unwrap().unwrap();
    assert_eq!((ended.status, ended.finished_at), (Status::Cancelled, Some(bench.clock.now())));
    assert_eq!(bench.store.cancel(queued).await.unwrap().unwrap(), ended);
    assert!(bench.claim("w").await.is_none());
    // Running: the worker is told.
    let running = bench.queue("2").await.id;
    let claimed = bench.claim("w").await.unwrap();
    let asked = bench.store.cancel(running).await.unwrap().unwrap();
    assert_eq!((asked.status, asked.cancel_requested), (Status::Running, true));
    assert_eq!(bench.store.cancel(running).await.unwrap().unwrap(), asked);
    assert_eq!(bench.beat(&claimed).await, Directive::Cancel);
    let ended = bench.store.cancelled(claimed).await.unwrap();
    assert_eq!(ended.status, Status::Cancelled);
    // Asked to stop, but the worker vanishes: not tried again.
    let vanished = bench.queue("3").await.id;
    bench.claim("w").await.unwrap();
    bench.store.cancel(vanished).await.unwrap();
    bench.clock.advance(LEASE);
    assert!(bench.claim("w").await.is_none());
    assert_eq!(bench.get(vanished).await.status, Status::Cancelled);
    // Ended: stays.
    let succeeded = bench.succeed("4").await;
    assert_eq!(bench.store.cancel(succeeded.id).await.unwrap().unwrap(), succeeded);
    bench.queue("5").await;
    let failed = bench.store.fail(bench.claim("w").await.unwrap(), by_cpu(), problem("panic")).await.unwrap();
    assert_eq!((failed.status, &failed.problem), (Status::Failed, &Some(problem("panic"))));
    assert_eq!(bench.store.cancel(failed.id).await.unwrap().unwrap(), failed);
}

pub async fn delete_in_every_state(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    assert_eq!(bench.store.delete(JobId(uuid::Uuid::now_v7())).await.unwrap(), None);
    let mut changes = bench.store.changes();
    let queued = bench.queue("1").await.id;
    assert_eq!(bench.store.delete(queued).await.unwrap(), Some(vec![]));
    assert!(bench.claim("w").await.is_none());
    let last = std::iter::from_fn(|| changes.try_recv().ok()).last().unwrap();
    assert_eq!(last, Change { id: queued, version: None });

    let running = bench.queue("2").await.id;
    let claimed = bench.claim("w").await.unwrap();
    assert_eq!(bench.store.delete(running).await.unwrap(), Some(vec![]));
    assert_eq!(bench.beat(&claimed).await, Directive::Lost);
    let done = finished(&claimed);
    assert!(matches!(bench.store.finish(claimed, done).await, Err(StoreError::Fenced)));

    let succeeded = bench.succeed("3").await;
    let mut keys = bench.store.delete(succeeded.id).await.unwrap().unwrap();
    keys.sort();
    let mut named: Vec<_> = succeeded.files.iter().map(|file| file.key.clone()).collect();
    named.sort();
    assert_eq!(keys, named);
    assert!(!bench.store.names_key(&keys[0]).await.unwrap());
    for id in [queued, running, succeeded.id] {
        assert_eq!(bench.store.get(id).await.unwrap(), None);
        assert_eq!(bench.store.delete(id).await.unwrap(), None);
        assert!(bench.store.attempts(id).await.unwrap().is_empty());
    }
}

fn keyed(key: &str, body: &str) -> NewJob {
    NewJob { idempotency: Some((key.into(), body.into())), reuse: false, ..new_job("d") }
}

pub async fn an_idempotency_key_gives_one_job(factory: Factory) {
    let bench = bench(factory, |options| options.queue_limit = 1).await;
    let first = bench.store.submit(keyed("k", "body")).await.unwrap();
    assert!(matches!(first, Submitted::Queued(_)));
    // A replay is answered although the queue is full.
    let again = bench.store.submit(keyed("k", "body")).await.unwrap();
    assert_eq!(again, Submitted::Replayed(first.job().clone()));
    let other = bench.store.submit(keyed("k", "another")).await;
    assert!(matches!(other, Err(StoreError::IdempotencyConflict)), "{other:?}");
    // It answers with the job as it is now, and lives as long as the job.
    let claimed = bench.claim("w").await.unwrap();
    let done = finished(&claimed);
    let ended = bench.store.finish(claimed, done).await.unwrap();
    assert_eq!(bench.store.submit(keyed("k", "body")).await.unwrap(), Submitted::Replayed(ended));
    bench.store.delete(first.job().id).await.unwrap();
    let fresh = bench.store.submit(keyed("k", "another")).await.unwrap();
    assert!(matches!(fresh, Submitted::Queued(_)));
}

pub async fn racing_idempotency_keys_give_one_job(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let racers = (0..48).map(|n| {
        let store = Arc::clone(&bench.store);
        tokio::spawn(async move { store.submit(keyed(&format!("k{}", n % 3), &format!("b{}", n % 6))).await })
    });
    let mut made: HashMap<usize, Vec<JobId>> = HashMap::new();
    let (mut queued, mut conflicts) = (0, 0);
    for (n, result) in join_all(racers).await.into_iter().enumerate() {
        match result.unwrap() {
            Ok(submitted) => {
                queued += u32::from(matches!(submitted, Submitted::Queued(_)));
                made.entry(n % 3).or_default().push(submitted.job().id);
            }
            Err(StoreError::IdempotencyConflict) => conflicts += 1,
            Err(error) => panic!("{error}"),
        }
    }
    assert_eq!((queued, conflicts), (3, 24));
    for ids in made.values() {
        assert!(ids.iter().all(|id| id == &ids[0]));
    }
}

pub async fn a_finished_digest_is_reused(factory: Factory) {
    let bench = bench(factory, |options| options.queue_limit = 2).await;
    let made = bench.succeed("d").await;
    bench.clock.advance(Duration::from_secs(9));
    let reused = bench.store.submit(new_job("d")).await.unwrap();
    let Submitted::Reused(job) = &reused else { panic!("{reused:?}") };
    assert_ne!(job.id, made.id);
    assert_eq!((job.status, job.reused_from), (Status::Succeeded, Some(made.id)));
    assert_eq!((&job.files, &job.summary, job.attempts), (&made.files, &made.summary, 0));
    assert_eq!((job.backend.used, job.finished_at), (Some(Backend::Cpu), Some(bench.clock.now())));
    let mut single = new_job("d");
    single.backend = Backend::CpuSingle;
    let reused = bench.store.submit(single).await.unwrap();
    assert_eq!(reused.job().backend.requested, Backend::CpuSingle);
    assert!(matches!(reused, Submitted::Reused(_)));
    // Another backend, another format, another digest, or no wish for it: made anew.
    let refused: [fn(&mut NewJob); 4] = [
        |new| new.backend = Backend::Gpu,
        |new| new.outputs = vec![Output::Glb, Output::Obj],
        |new| new.digest = "e".into(),
        |new| new.reuse = false,
    ];
    for (n, change) in refused.into_iter().enumerate() {
        let mut new = new_job("d");
        change(&mut new);
        match bench.store.submit(new).await {
            Ok(Submitted::Queued(_)) if n < 2 => {}
            Err(StoreError::QueueFull { limit: 2 }) if n >= 2 => {}
            other => panic!("{n}: {other:?}"),
        }
    }
    // A full queue does not hinder reuse.
    assert!(matches!(bench.store.submit(new_job("d")).await.unwrap(), Submitted::Reused(_)));
}

pub async fn shared_files_go_with_the_last_job(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let made = bench.succeed("d").await;
    let second = bench.store.submit(new_job("d")).await.unwrap().job().clone();
    assert_eq!(bench.store.delete(made.id).await.unwrap(), Some(vec![]));
    assert_eq!(bench.get(second.id).await, second);
    // The first is gone; the second one's files serve a third.
    let third = bench.store.submit(new_job("d")).await.unwrap().job().clone();
    assert_eq!(third.reused_from, Some(second.id));
    assert_eq!(bench.store.delete(third.id).await.unwrap(), Some(vec![]));
    assert_eq!(bench.store.delete(second.id).await.unwrap().unwrap().len(), made.files.len());
    assert!(matches!(bench.store.submit(new_job("d")).await.unwrap(), Submitted::Queued(_)));
}

pub async fn the_queue_has_a_limit(factory: Factory) {
    let bench = bench(factory, |options| options.queue_limit = 2).await;
    let first = bench.queue("1").await.id;
    bench.queue("2").await;
    let full = bench.store.submit(new_job("3")).await;
    assert!(matches!(full, Err(StoreError::QueueFull { limit: 2 })), "{full:?}");
    // Reading, cancelling and deleting work; they make room.
    bench.store.cancel(first).await.unwrap();
    bench.queue("3").await;
    bench.claim("w").await.unwrap();
    bench.queue("4").await;
    assert!(bench.store.submit(new_job("5")).await.is_err());
}

pub async fn lists_are_filtered_and_paged(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let mut ids = Vec::new();
    for n in 0..23 {
        let mut new = new_job(&n.to_string());
        new.preset = if n % 2 == 0 { "pig" } else { "paper" }.into();
        new.labels = BTreeMap::from([("n".into(), (n % 3).to_string()), ("all".into(), "yes".into())]);
        ids.push(bench.store.submit(new).await.unwrap().job().id);
    }
    bench.store.cancel(ids[4]).await.unwrap();
    assert!(ids.is_sorted(), "ids are in order of age");
    let all = ListFilter { limit: 10, ..ListFilter::default() };
    let mut seen = Vec::new();
    let mut filter = all.clone();
    loop {
        let page = bench.store.list(&filter).await.unwrap();
        assert!(page.jobs.len() <= 10);
        seen.extend(page.jobs.iter().map(|job| job.id));
        let Some(next) = page.next else { break };
        filter.before = Some(next);
        // Jobs that arrive meanwhile do not shift the pages.
        bench.queue(&format!("late {next}")).await;
    }
    ids.reverse();
    assert_eq!(seen, ids);
    ids.reverse();

    let select = |filter: ListFilter| {
        let store = Arc::clone(&bench.store);
        async move {
            let page = store.list(&ListFilter { limit: 100, ..filter }).await.unwrap();
            assert_eq!(page.next, None);
            let mut found: Vec<JobId> = page.jobs.iter().map(|job| job.id).collect();
            found.reverse();
            found
        }
    };
    let label = |n: &str| vec![("n".to_owned(), n.to_owned()), ("all".to_owned(), "yes".to_owned())];
    let expect = |keep: &dyn Fn(usize) -> bool| -> Vec<JobId> {
        ids.iter().enumerate().filter(|(n, _)| keep(*n)).map(|(_, id)| *id).collect()
    };
    let found = select(ListFilter { labels: label("1"), ..ListFilter::default() }).await;
    assert_eq!(found, expect(&|n| n % 3 == 1));
    let found = select(ListFilter { labels: label("1"), preset: Some("paper".into()), ..ListFilter::default() }).await;
    assert_eq!(found, expect(&|n| n % 3 == 1 && n % 2 == 1));
    let found = select(ListFilter { status: Some(Status::Cancelled), ..ListFilter::default() }).await;
    assert_eq!(found, [ids[4]]);
    let found = select(ListFilter { labels: label("7"), ..ListFilter::default() }).await;
    assert!(found.is_empty());
}

pub async fn queue_positions_are_by_age(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let mut ids = Vec::new();
    for n in 0..4 {
        let job = bench.queue(&n.to_string()).await;
        assert_eq!(job.queue_position, Some(n));
        ids.push(job.id);
    }
    bench.store.cancel(ids[1]).await.unwrap();
    let claimed = bench.claim("w").await.unwrap();
    assert_eq!(claimed.job().id, ids[0]);
    let positions = async || {
        let page = bench.store.list(&ListFilter { limit: 10, ..ListFilter::default() }).await.unwrap();
        page.jobs.iter().rev().map(|job| job.queue_position).collect::<Vec<_>>()
    };
    assert_eq!(positions().await, [None, None, Some(0), Some(1)]);
    // Given back: at its old place.
    bench.store.release(claimed).await.unwrap();
    assert_eq!(positions().await, [Some(0), None, Some(1), Some(2)]);
}

pub async fn claims_keep_to_their_backend(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    for backend in [Backend::Gpu, Backend::CpuSingle, Backend::Auto, Backend::Cpu, Backend::Gpu] {
        bench.store.submit(NewJob { backend, ..new_job("d") }).await.unwrap();
    }
    let claim = async |backend, limit| {
        let claimed = bench.store.claim("w", backend, LEASE, limit).await.unwrap();
        claimed.iter().map(|claimed| claimed.job().backend.requested).collect::<Vec<_>>()
    };
    assert_eq!(claim(Backend::Cpu, 2).await, [Backend::CpuSingle, Backend::Auto]);
    assert_eq!(claim(Backend::CpuSingle, 9).await, []);
    assert_eq!(claim(Backend::Gpu, 9).await, [Backend::Gpu, Backend::Gpu]);
    assert_eq!(claim(Backend::Auto, 9).await, [Backend::Cpu]);
}

pub async fn workers_are_seen(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let seen = |id: &str, jobs_done, heartbeat_at: Timestamp| WorkerInfo {
        id: id.into(),
        host: "host".into(),
        backend: Backend::Cpu,
        device: "cpu, 2 threads".into(),
        job: (jobs_done == 0).then(|| JobId(uuid::Uuid::nil())),
        jobs_done,
        heartbeat_at,
    };
    bench.store.worker_seen(&seen("b", 0, bench.clock.now())).await.unwrap();
    bench.clock.advance(Duration::from_secs(200));
    let (first, last) = (seen("a", 0, bench.clock.now()), seen("a", 3, bench.clock.now()));
    bench.store.worker_seen(&first).await.unwrap();
    assert_eq!(bench.store.workers().await.unwrap().len(), 2);
    bench.store.worker_seen(&last).await.unwrap();
    bench.clock.advance(Duration::from_secs(200));
    assert_eq!(bench.store.workers().await.unwrap(), [last]);
}

pub async fn four_claimers_end_each_job_once(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let jobs = 200;
    for n in 0..jobs {
        bench.queue(&n.to_string()).await;
    }
    let claimers = (0..4).map(|n| {
        let store = Arc::clone(&bench.store);
        tokio::spawn(async move {
            let mut mine = Vec::new();
            let worker = format!("w{n}");
            loop {
                let claimed = store.claim(&worker, Backend::Cpu, LEASE, 1 + n % 3).await.unwrap();
                if claimed.is_empty() {
                    return mine;
                }
                for claimed in claimed {
                    let at = progress(0.5);
                    let told = store.heartbeat(&claimed, LEASE, &by_cpu(), Some(&at), None).await.unwrap();
                    assert_eq!(told, Directive::Continue);
                    let done = finished(&claimed);
                    mine.push(store.finish(claimed, done).await.unwrap().id);
                }
            }
        })
    });
    let mut ended: Vec<JobId> = join_all(claimers).await.into_iter().flat_map(Result::unwrap).collect();
    ended.sort_unstable();
    ended.dedup();
    assert_eq!(ended.len(), jobs);
    for id in ended {
        let job = bench.get(id).await;
        assert_eq!((job.status, job.attempts), (Status::Succeeded, 1));
    }
}
