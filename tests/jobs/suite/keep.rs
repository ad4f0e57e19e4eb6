//! Checkpoints, retention, engine versions.

use super::*;

/// A checkpoint outlives its attempt until the job ends.
pub async fn a_checkpoint_passes_to_the_next_attempt(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let job = bench.queue("d").await;
    let first = bench.claim("a").await.unwrap();
    assert_eq!(first.job().checkpoint, None);
    let version = bench.get(job.id).await.version;
    assert_eq!(bench.store.set_checkpoint(&first, "k1").await.unwrap(), None);
    assert_eq!(bench.store.set_checkpoint(&first, "k2").await.unwrap(), Some("k1".into()));
    assert_eq!(bench.get(job.id).await.version, version, "subscribers need not know");
    for (key, named) in [("k1", false), ("k2", true)] {
        assert_eq!(bench.uses(key).await, named, "{key}");
    }
    bench.store.release(first, None).await.unwrap();
    let second = bench.claim("b").await.unwrap();
    assert_eq!(second.job().checkpoint.as_deref(), Some("k2"));
    bench.clock.advance(LEASE + Duration::from_secs(1));
    let third = bench.claim("c").await.unwrap();
    let fenced = bench.store.set_checkpoint(&second, "k3").await.unwrap_err();
    assert!(matches!(fenced, StoreError::Fenced), "{fenced}");
    assert_eq!(third.job().checkpoint.as_deref(), Some("k2"));
    assert_eq!(bench.finish(third).await.checkpoint, None);
    assert!(!bench.uses("k2").await);

    let job = bench.queue("e").await;
    let claimed = bench.claim("a").await.unwrap();
    bench.store.set_checkpoint(&claimed, "k4").await.unwrap();
    bench.store.release(claimed, None).await.unwrap();
    let cancelled = bench.store.cancel(job.id).await.unwrap().unwrap();
    assert_eq!(cancelled.checkpoint.as_deref(), Some("k4"), "to be removed");
    assert_eq!(bench.get(job.id).await.checkpoint, None);
    assert!(!bench.uses("k4").await, "a job that was cancelled needs no checkpoint");
    let job = bench.queue("f").await;
    let claimed = bench.claim("a").await.unwrap();
    bench.store.set_checkpoint(&claimed, "k5").await.unwrap();
    assert_eq!(bench.store.delete(job.id).await.unwrap(), Some(vec!["k5".into()]));
}

/// The queries that retention by age and by size uses.
pub async fn ended_jobs_are_listed_by_age_and_bytes(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let second = Duration::from_secs(1);
    let first = bench.succeed("a").await;
    bench.clock.advance(second);
    let shared = bench.store.submit(new_job("a")).await.unwrap().job().clone();
    bench.clock.advance(second);
    let queued = bench.queue("b").await;
    let other = bench.queue("c").await;
    bench.store.cancel(other.id).await.unwrap();
    assert_eq!(bench.store.stored_bytes().await.unwrap(), 15, "shared files count once");
    let ended = |age: Option<Duration>, limit| {
        let store = bench.store.clone();
        let before = age.map_or(Timestamp::MAX, |age| bench.clock.now() - age);
        async move { store.ended(before, limit).await.unwrap() }
    };
    bench.clock.advance(second);
    assert_eq!(ended(Some(second), 10).await, [first.id, shared.id], "a job that ended exactly then is not older");
    assert_eq!(ended(Some(Duration::from_micros(999_999)), 10).await, [first.id, shared.id, other.id]);
    assert_eq!(ended(None, 2).await, [first.id, shared.id]);
    assert_eq!(ended(Some(3 * second), 10).await, []);
    assert_eq!(ended(None, 10).await, [first.id, shared.id, other.id]);
    assert!(bench.store.get(queued.id).await.unwrap().is_some());
    bench.store.delete(first.id).await.unwrap();
    bench.store.delete(shared.id).await.unwrap();
    assert_eq!(bench.store.stored_bytes().await.unwrap(), 0);
}

/// A job of an older engine keeps its digest. If another engine version grows its model, the model
/// is not reused for that digest.
pub async fn another_engines_files_are_not_reused(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let old = NewJob { engine: "0.0.9".into(), ..new_job("d") };
    bench.store.submit(old.clone()).await.unwrap();
    let claimed = bench.claim("new").await.unwrap();
    assert_eq!((claimed.job().engine.as_str(), claimed.job().digest.as_str()), ("0.0.9", "d"));
    let done = finished(&claimed);
    bench.store.finish(claimed, done).await.unwrap();
    assert!(matches!(bench.store.submit(old.clone()).await.unwrap(), Submitted::Queued(_)));
    let claimed = bench.claim("old").await.unwrap();
    let done = Finished { engine: "0.0.9".into(), ..finished(&claimed) };
    bench.store.finish(claimed, done).await.unwrap();
    let reused = bench.store.submit(old).await.unwrap();
    assert!(matches!(reused, Submitted::Reused(_)), "{reused:?}");
}

/// If files of a model are missing, neither the model nor the models that share its files are
/// reused. A new model with the same digest is reused.
pub async fn a_model_without_its_files_is_not_reused(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let made = bench.succeed("d").await;
    let shared = bench.store.submit(new_job("d")).await.unwrap().job().clone();
    assert_eq!(shared.reused_from, Some(made.id));
    assert_eq!(bench.store.reusable(&new_job("d")).await.unwrap(), Some(made.clone()));
    let without = NewJob { missing: vec!["models/other".into(), made.files[1].key.clone()], ..new_job("d") };
    assert_eq!(bench.store.reusable(&without).await.unwrap(), None);
    let again = bench.store.submit(without.clone()).await.unwrap();
    assert!(matches!(again, Submitted::Queued(_)), "{again:?}");
    let claimed = bench.claim("w").await.unwrap();
    let whole = bench.finish(claimed).await;
    let reused = bench.store.submit(without).await.unwrap();
    assert_eq!(reused.job().reused_from, Some(whole.id));
    assert_eq!(bench.store.reusable(&NewJob { reuse: false, ..new_job("d") }).await.unwrap(), None);
}

/// An orphan sweep must keep the files with these artifact keys.
pub async fn keys_of_records_and_of_running_attempts_are_in_use(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let made = bench.succeed("a").await;
    let running = bench.queue("b").await.id;
    let claimed = bench.claim("w").await.unwrap();
    bench.store.set_checkpoint(&claimed, "models/elsewhere/1/checkpoint").await.unwrap();
    let key = |job, attempt, name| oviduct::jobs::artifacts::key(job, attempt, name);
    let used = [
        made.files[0].key.clone(),
        key(running, 1, "model.glb"),
        key(running, 1, "model.glb#1"),
        "models/elsewhere/1/checkpoint".to_owned(),
    ];
    let unused = [
        key(made.id, 1, "other"),
        key(made.id, 2, "model.glb"),
        key(running, 2, "model.glb"),
        key(running, 11, "model.glb"),
        "models/none".to_owned(),
        String::new(),
    ];
    let keys: Vec<String> = used.iter().chain(&unused).cloned().collect();
    let found = bench.store.keys_in_use(&keys).await.unwrap();
    assert_eq!(found.into_iter().collect::<Vec<_>>(), {
        let mut used = used.to_vec();
        used.sort();
        used
    });
    assert!(bench.store.keys_in_use(&[]).await.unwrap().is_empty());
    bench.store.release(claimed, None).await.unwrap();
    assert!(!bench.uses(&key(running, 1, "model.glb")).await);
}

/// The owner of an upkeep lock can renew it; another owner can acquire it after it has expired.
pub async fn one_owner_at_a_time_holds_an_upkeep_task(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let acquire = async |task, owner: &str| bench.store.acquire_upkeep(task, owner, LEASE).await.unwrap();
    use UpkeepTask::{Orphans, Retention};
    assert!(acquire(Orphans, "a").await);
    assert!(!acquire(Orphans, "b").await && acquire(Retention, "b").await, "each task has a lock of its own");
    bench.clock.advance(LEASE / 2);
    assert!(acquire(Orphans, "a").await, "renewed");
    bench.clock.advance(LEASE / 2);
    assert!(!acquire(Orphans, "b").await);
    bench.clock.advance(LEASE / 2);
    assert!(acquire(Orphans, "b").await && !acquire(Orphans, "a").await);
    let racers = (0..8).map(|n| {
        let store = bench.store.clone();
        tokio::spawn(async move { store.acquire_upkeep(Retention, &format!("r{n}"), LEASE).await.unwrap() })
    });
    let won = join_all(racers).await.into_iter().filter(|won| *won.as_ref().unwrap()).count();
    assert_eq!(won, 1);
}

/// Every kind of transition updates the counts of queued jobs per lane.
pub async fn queued_jobs_are_counted_by_backend(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let counts = async || bench.store.queued_by_backend().await.unwrap().map(|(backend, jobs)| (backend.name(), jobs));
    assert_eq!(counts().await, [("auto", 0), ("gpu", 0), ("cpu", 0), ("cpu-single", 0)]);
    let mut ids = Vec::new();
    for backend in [Backend::Auto, Backend::Auto, Backend::Gpu, Backend::Gpu, Backend::Gpu, Backend::Cpu] {
        let new = NewJob { backend, reuse: false, ..new_job("d") };
        ids.push(bench.store.submit(new).await.unwrap().job().id);
    }
    assert_eq!(counts().await, [("auto", 2), ("gpu", 3), ("cpu", 1), ("cpu-single", 0)]);
    bench.store.cancel(ids[2]).await.unwrap();
    bench.store.delete(ids[3]).await.unwrap();
    let claimed = bench.claim("w").await.unwrap();
    assert_eq!(counts().await, [("auto", 1), ("gpu", 1), ("cpu", 1), ("cpu-single", 0)]);
    bench.store.release(claimed, None).await.unwrap();
    assert_eq!(counts().await, [("auto", 2), ("gpu", 1), ("cpu", 1), ("cpu-single", 0)]);
    assert_eq!(bench.store.counts().await.unwrap().queued, 4);
}
