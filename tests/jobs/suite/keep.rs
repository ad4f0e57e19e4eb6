//! Checkpoints, retention, engine versions.

use super::*;

/// A checkpoint outlives its attempt, and goes when the job ends.
pub async fn a_checkpoint_passes_to_the_next_attempt(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let job = bench.queue("d").await;
    let first = bench.claim("a").await.unwrap();
    assert_eq!(first.job().checkpoint, None);
    let version = bench.get(job.id).await.version;
    assert_eq!(bench.store.set_checkpoint(&first, "k1").await.unwrap(), None);
    assert_eq!(bench.store.set_checkpoint(&first, "k2").await.unwrap(), Some("k1".into()));
    assert_eq!(bench.get(job.id).await.version, version, "nobody needs to be told");
    for (key, named) in [("k1", false), ("k2", true)] {
        assert_eq!(bench.store.names_key(key).await.unwrap(), named, "{key}");
    }
    bench.store.release(first).await.unwrap();
    let second = bench.claim("b").await.unwrap();
    assert_eq!(second.job().checkpoint.as_deref(), Some("k2"));
    bench.clock.advance(LEASE + Duration::from_secs(1));
    let third = bench.claim("c").await.unwrap();
    let fenced = bench.store.set_checkpoint(&second, "k3").await.unwrap_err();
    assert!(matches!(fenced, StoreError::Fenced), "{fenced}");
    assert_eq!(third.job().checkpoint.as_deref(), Some("k2"));
    let done = finished(&third);
    assert_eq!(bench.store.finish(third, done).await.unwrap().checkpoint, None);
    assert!(!bench.store.names_key("k2").await.unwrap());

    let job = bench.queue("e").await;
    let claimed = bench.claim("a").await.unwrap();
    bench.store.set_checkpoint(&claimed, "k4").await.unwrap();
    bench.store.release(claimed).await.unwrap();
    let cancelled = bench.store.cancel(job.id).await.unwrap().unwrap();
    assert_eq!(cancelled.checkpoint.as_deref(), Some("k4"), "to be removed");
    assert_eq!(bench.get(job.id).await.checkpoint, None);
    assert!(!bench.store.names_key("k4").await.unwrap(), "a job that was cancelled needs no checkpoint");
    let job = bench.queue("f").await;
    let claimed = bench.claim("a").await.unwrap();
    bench.store.set_checkpoint(&claimed, "k5").await.unwrap();
    assert_eq!(bench.store.delete(job.id).await.unwrap(), Some(vec!["k5".into()]));
}

/// What a sweep by age or by bytes asks.
pub async fn ended_jobs_are_told_by_age_and_bytes(factory: Factory) {
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
    let ended = |age: Duration, limit| {
        let store = bench.store.clone();
        async move { store.ended_before(age, limit).await.unwrap() }
    };
    bench.clock.advance(second);
    assert_eq!(ended(second, 10).await, [first.id, shared.id], "one that ended just so long ago is not older");
    assert_eq!(ended(Duration::from_micros(999_999), 10).await, [first.id, shared.id, other.id]);
    assert_eq!(ended(Duration::ZERO, 2).await, [first.id, shared.id]);
    assert_eq!(ended(3 * second, 10).await, []);
    assert_eq!(ended(Duration::ZERO, 10).await, [first.id, shared.id, other.id]);
    assert!(bench.store.get(queued.id).await.unwrap().is_some());
    bench.store.delete(first.id).await.unwrap();
    bench.store.delete(shared.id).await.unwrap();
    assert_eq!(bench.store.stored_bytes().await.unwrap(), 0);
}

/// A job of an older engine ends, keeps its digest, and is not taken for a model of that digest.
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
