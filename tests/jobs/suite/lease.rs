//! Leases: claims, heartbeats, fences, expiry, retries, concurrent claims.

use super::*;

pub async fn a_job_goes_from_the_queue_to_its_end(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let mut changes = bench.store.changes();
    let mut new = new_job("d");
    new.labels = BTreeMap::from([("study".into(), "A3".into()), ("x\"'".into(), "ü".into())]);
    let queued = bench.store.submit(new.clone()).await.unwrap().job().clone();
    assert_eq!(queued.status, Status::Queued);
    assert_eq!((queued.version, queued.queue_position, queued.attempts), (1, Some(0), 0));
    assert_eq!((&queued.labels, queued.seed, &queued.spec), (&new.labels, new.seed, &new.spec));
    assert!(queued.trace.is_some() && queued.trace == new.trace);
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
    let ended = bench.finish_with(claimed, done.clone()).await;
    assert_eq!((ended.status, ended.finished_at), (Status::Succeeded, Some(bench.clock.now())));
    assert_eq!((&ended.files, ended.summary.as_ref()), (&done.files, Some(&done.summary)));
    assert!(ended.version > seen.version && seen.version > running.version && running.version > queued.version);
    assert!(bench.uses(&done.files[0].key).await);
    assert!(!bench.uses("models/none").await);

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

pub async fn a_heartbeat_renews_and_notifies_only_of_progress(factory: Factory) {
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
    // Four attempts under the same worker name lose their leases. None of them may write during the
    // fifth attempt.
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
    fenced(bench.store.release(stale.next().unwrap(), None).await);
    assert_eq!(bench.get(id).await, before);
    assert!(!bench.uses(&done.files[0].key).await);
    assert_eq!(bench.finish(present).await.attempts, 5);
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
        bench.store.release(claimed, None).await.unwrap();
    }
    let claimed = bench.claim("w").await.unwrap();
    let job = bench.retry(claimed).await;
    assert_eq!((job.status, job.queue_position), (Status::Queued, Some(0)));
    assert!(bench.claim("w").await.is_none(), "claimed without waiting");
    bench.clock.advance(Duration::from_secs(1));
    let claimed = bench.claim("w").await.unwrap();
    let job = bench.retry(claimed).await;
    assert_eq!((job.status, job.attempts), (Status::Failed, 6));
    let problem = job.problem.unwrap();
    assert_eq!(problem.kind, "attempts-exhausted");
    assert!(problem.detail.contains("attempt 4 by w: released"), "{}", problem.detail);
    assert!(problem.detail.contains("(io: somewhere)"), "{}", problem.detail);
    let outcomes: Vec<_> = bench.store.attempts(id).await.unwrap().iter().map(|a| a.outcome.unwrap()).collect();
    use AttemptEnd::{Released, Retried};
    assert_eq!(outcomes, [Released, Released, Released, Released, Retried, Retried]);
}

pub async fn claims_keep_to_their_backend(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    for backend in [Backend::Gpu, Backend::CpuSingle, Backend::Auto, Backend::Cpu, Backend::Gpu] {
        bench.store.submit(NewJob { backend, reuse: false, ..new_job("d") }).await.unwrap();
    }
    let claim = async |scope, limit| {
        let claimed = bench.store.claim("w", scope, LEASE, limit).await.unwrap();
        claimed.iter().map(|claimed| claimed.job().backend.requested).collect::<Vec<_>>()
    };
    assert_eq!(claim(ClaimScope::Cpu, 2).await, [Backend::CpuSingle, Backend::Auto]);
    assert_eq!(claim(ClaimScope::CpuOnly, 9).await, [Backend::Cpu]);
    assert_eq!(claim(ClaimScope::Gpu, 9).await, [Backend::Gpu, Backend::Gpu]);
    assert_eq!(claim(ClaimScope::Cpu, 9).await, []);
}

pub async fn four_claimers_end_each_job_once(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let jobs = 200;
    for n in 0..jobs {
        bench.queue(&n.to_string()).await;
    }
    let claimers = (0..4).map(|n| {
        let store = bench.store.clone();
        tokio::spawn(async move {
            let mut mine = Vec::new();
            let worker = format!("w{n}");
            loop {
                let claimed = store.claim(&worker, ClaimScope::Cpu, LEASE, 1 + n % 3).await.unwrap();
                if claimed.is_empty() {
                    return mine;
                }
                for claimed in claimed {
                    let at = progress(0.5);
                    let told = store.heartbeat(&claimed, LEASE, &by_cpu(), Some(&at), None).await.unwrap();
                    assert_eq!(told, Directive::Continue);
                    let done = finished(&claimed);
                    mine.push(claimed.job().id);
                    store.finish(claimed, done).await.unwrap();
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
