//! Pauses of all workers and of single workers; the age of the queue.

use super::*;

fn worker(id: &str, kind: WorkerKind, at: Timestamp) -> WorkerInfo {
    WorkerInfo {
        id: id.into(),
        host: "host".into(),
        kind,
        device: "device".into(),
        jobs: Vec::new(),
        jobs_done: 0,
        heartbeat_at: at,
        pause: None,
        condition: None,
    }
}

pub async fn paused_workers_claim_nothing(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let store = &bench.store;
    for id in ["a", "b"] {
        store.worker_seen(&worker(id, WorkerKind::Cpu, bench.clock.now())).await.unwrap();
    }
    let ids = [bench.queue("1").await.id, bench.queue("2").await.id, bench.queue("3").await.id];
    let first = bench.claim("a").await.unwrap();
    assert!(store.instruct("a", Instruction::Pause, None).await.unwrap());
    assert!(bench.claim("a").await.is_none(), "it is paused");
    assert_eq!(bench.beat(&first).await, Directive::Continue, "what it runs goes on");
    let second = bench.claim("b").await.unwrap();
    assert_eq!(second.job().id, ids[1], "the others claim");
    store.set_paused(true, Some("operator")).await.unwrap();
    assert!(bench.claim("b").await.is_none());
    // The pause applies also to a worker that starts later.
    assert!(bench.claim("c").await.is_none());
    assert_eq!(bench.finish(first).await.status, Status::Succeeded);
    // Ending the pause of all workers keeps the pause of a single worker.
    store.set_paused(false, None).await.unwrap();
    assert!(bench.claim("a").await.is_none());
    assert!(store.instruct("a", Instruction::Resume, None).await.unwrap());
    assert_eq!(bench.claim("a").await.unwrap().job().id, ids[2]);
}

pub async fn a_paused_gpu_worker_claims_no_batch(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    bench.store.worker_seen(&worker("g", WorkerKind::Gpu, bench.clock.now())).await.unwrap();
    for n in 0..3 {
        bench.queue(&n.to_string()).await;
    }
    let claim = async || bench.store.claim("g", ClaimScope::Gpu, LEASE, 8).await.unwrap().len();
    let claimers = async || bench.store.count_claiming_workers(WorkerKind::Gpu, LEASE).await.unwrap();
    assert!(bench.store.instruct("g", Instruction::Drain, None).await.unwrap());
    assert_eq!(
        (claim().await, claimers().await, bench.store.count_live_workers(WorkerKind::Gpu, LEASE).await.unwrap()),
        (0, 0, 1)
    );
    assert!(bench.store.instruct("g", Instruction::Resume, None).await.unwrap());
    assert_eq!((claimers().await, claim().await), (1, 3));
}

pub async fn a_pause_does_not_keep_expired_leases(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let job = bench.queue("1").await;
    let held = bench.claim("dead").await.unwrap();
    bench.store.set_paused(true, None).await.unwrap();
    // With this call, the store begins to observe that the database is available. It needs a whole
    // lease of that before it expires leases.
    assert!(bench.claim("a").await.is_none());
    bench.clock.advance(2 * LEASE);
    assert!(bench.claim("a").await.is_none());
    let queued = bench.get(job.id).await;
    assert_eq!((queued.status, queued.attempts), (Status::Queued, 1), "it waits for the end of the pause");
    assert_eq!(bench.beat(&held).await, Directive::Lost);
    bench.store.set_paused(false, None).await.unwrap();
    assert_eq!(bench.claim("a").await.unwrap().attempt(), 2);
}

pub async fn a_drained_worker_says_so(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let store = &bench.store;
    assert!(!store.instruct("a", Instruction::Drain, None).await.unwrap(), "there is no such worker");
    store.worker_seen(&worker("a", WorkerKind::Cpu, bench.clock.now())).await.unwrap();
    let state = async || {
        let listed = store.workers().await.unwrap().remove(0);
        (listed.state(), listed.pause)
    };
    assert_eq!(state().await, (WorkerState::Active, None));
    bench.queue("1").await;
    let claimed = bench.claim("a").await.unwrap();
    let since = bench.clock.now();
    assert!(store.instruct("a", Instruction::Drain, Some("operator")).await.unwrap());
    let pause = Pause { drain: true, since, by: Some("operator".into()) };
    assert_eq!(state().await, (WorkerState::Draining, Some(pause.clone())));
    bench.clock.advance(Duration::from_secs(1));
    // Repeating an instruction changes nothing.
    assert!(store.instruct("a", Instruction::Drain, None).await.unwrap());
    let done = finished(&claimed);
    store.finish(claimed, done).await.unwrap();
    assert_eq!(state().await, (WorkerState::Drained, Some(pause)));
    assert!(store.instruct("a", Instruction::Pause, None).await.unwrap());
    assert_eq!(state().await, (WorkerState::Paused, Some(Pause { drain: false, since: bench.clock.now(), by: None })));
    // Heartbeats do not end a pause. A worker that is not live cannot be instructed.
    store.worker_seen(&worker("a", WorkerKind::Cpu, bench.clock.now())).await.unwrap();
    assert_eq!(state().await.0, WorkerState::Paused);
    bench.clock.advance(Duration::from_secs(3600));
    assert!(!store.instruct("a", Instruction::Resume, None).await.unwrap());
    // A worker without heartbeats for a day is forgotten together with its pause.
    bench.clock.advance(Duration::from_secs(24 * 3600));
    store.worker_seen(&worker("b", WorkerKind::Cpu, bench.clock.now())).await.unwrap();
    store.worker_seen(&worker("a", WorkerKind::Cpu, bench.clock.now())).await.unwrap();
    assert_eq!(state().await, (WorkerState::Active, None));
}

pub async fn the_pause_of_all_is_kept(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let store = &bench.store;
    assert_eq!(store.paused().await.unwrap(), None);
    let since = bench.clock.now();
    store.set_paused(true, Some("operator")).await.unwrap();
    bench.clock.advance(Duration::from_secs(2 * 24 * 3600));
    store.set_paused(true, Some("another")).await.unwrap();
    // Heartbeats remove the pauses of workers that are gone, but not the pause of all workers.
    store.worker_seen(&worker("a", WorkerKind::Cpu, bench.clock.now())).await.unwrap();
    bench.clock.advance(Duration::from_secs(2 * 24 * 3600));
    store.worker_seen(&worker("b", WorkerKind::Cpu, bench.clock.now())).await.unwrap();
    let pause = Pause { drain: false, since, by: Some("operator".into()) };
    assert_eq!(store.paused().await.unwrap(), Some(pause));
    store.set_paused(false, None).await.unwrap();
    assert_eq!(store.paused().await.unwrap(), None);
}

pub async fn the_queue_has_an_age(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let ages = async || bench.store.queue_ages().await.unwrap().map(|(backend, age)| (backend.name(), age.as_secs()));
    assert_eq!(ages().await, [("auto", 0), ("gpu", 0), ("cpu", 0), ("cpu-single", 0)]);
    let of = |backend, digest: &str| NewJob { backend, ..new_job(digest) };
    bench.store.submit(of(Backend::Gpu, "1")).await.unwrap();
    bench.clock.advance(Duration::from_secs(5));
    bench.store.submit(of(Backend::Auto, "2")).await.unwrap();
    // The first job to be claimed has a higher priority, but it is not the oldest.
    let urgent = NewJob { priority: 1.try_into().unwrap(), ..of(Backend::Gpu, "3") };
    bench.store.submit(urgent).await.unwrap();
    bench.clock.advance(Duration::from_secs(60));
    assert_eq!(ages().await, [("auto", 60), ("gpu", 65), ("cpu", 0), ("cpu-single", 0)]);
    // Running jobs do not count as queued.
    let running = bench.claim("a").await.unwrap();
    assert_eq!(ages().await[0], ("auto", 0));
    bench.store.release(running, None).await.unwrap();
    assert_eq!(ages().await[0], ("auto", 60));
}

pub async fn workers_are_counted_by_what_they_can_do(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let store = &bench.store;
    let full = |id: &str| WorkerInfo {
        condition: Some(WorkerCondition::Storage),
        ..worker(id, WorkerKind::Cpu, bench.clock.now())
    };
    let counts = |live, unpaused, claiming| WorkerCounts { live, unpaused, claiming };
    let expect = async |cpu: WorkerCounts, gpu: WorkerCounts| {
        assert_eq!(store.workforce(LEASE).await.unwrap(), Workforce { cpu, gpu });
    };
    expect(counts(0, 0, 0), counts(0, 0, 0)).await;
    for id in ["a", "b", "c"] {
        store.worker_seen(&full(id)).await.unwrap();
    }
    store.worker_seen(&worker("a", WorkerKind::Cpu, bench.clock.now())).await.unwrap();
    store.worker_seen(&WorkerInfo { kind: WorkerKind::Gpu, ..full("g") }).await.unwrap();
    expect(counts(3, 3, 1), counts(1, 1, 0)).await;
    // CPU workers do not leave jobs to a GPU worker that cannot store files.
    assert_eq!(store.count_claiming_workers(WorkerKind::Gpu, LEASE).await.unwrap(), 0);
    let condition = store.workers().await.unwrap().into_iter().map(|worker| worker.condition);
    assert_eq!(condition.collect::<Vec<_>>()[..2], [None, Some(WorkerCondition::Storage)]);
    store.instruct("a", Instruction::Pause, None).await.unwrap();
    store.instruct("b", Instruction::Drain, None).await.unwrap();
    expect(counts(3, 1, 0), counts(1, 1, 0)).await;
    store.set_paused(true, None).await.unwrap();
    expect(counts(3, 0, 0), counts(1, 0, 0)).await;
    bench.clock.advance(2 * LEASE);
    expect(counts(0, 0, 0), counts(0, 0, 0)).await;
}
