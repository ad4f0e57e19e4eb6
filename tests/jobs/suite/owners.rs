//! Owners: isolation from each other, quotas, API keys and tickets.

use super::*;
use oviduct::jobs::keys::{Key, KeyLimits, NewKey, NewTicket, Scope, Secret, TicketSecret};
use oviduct::jobs::{Quantity, Quota};

fn of(owner: &str, digest: &str) -> NewJob {
    NewJob { owner: Some(owner.into()), ..new_job(digest) }
}

pub async fn owners_share_nothing(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let keyed = |owner: Option<&str>, body: &str| NewJob {
        owner: owner.map(str::to_owned),
        idempotency: Some(("k".into(), body.into())),
        ..new_job("same")
    };
    // Each owner has a separate set of idempotency keys, and so has the absence of an owner.
    let mut ids = Vec::new();
    for (owner, body) in [(None, "1"), (Some("a"), "2"), (Some("b"), "3")] {
        let made = bench.store.submit(keyed(owner, body)).await.unwrap();
        assert!(matches!(made, Submitted::Queued(_)), "{owner:?}");
        assert_eq!(made.job().owner.as_deref(), owner);
        let again = bench.store.submit(keyed(owner, body)).await.unwrap();
        assert!(matches!(&again, Submitted::Replayed(job) if job.id == made.job().id), "{owner:?}");
        let known = bench.store.replayed(owner, "k", body).await.unwrap();
        assert_eq!(known.map(|job| job.id), Some(made.job().id));
        ids.push(made.job().id);
    }
    assert_eq!(bench.store.replayed(Some("a"), "k", "3").await.unwrap(), None);
    // Only the owner of a finished model can reuse it.
    while let Some(claimed) = bench.claim("w").await {
        let done = finished(&claimed);
        bench.store.finish(claimed, done).await.unwrap();
    }
    let again = bench.store.submit(of("a", "same")).await.unwrap();
    assert!(matches!(&again, Submitted::Reused(job) if job.reused_from == Some(ids[1])), "{again:?}");
    assert!(matches!(bench.store.submit(of("c", "same")).await.unwrap(), Submitted::Queued(_)));
    // A list for one owner contains only that owner's jobs, even in combination with other filters.
    let list = async |owner: &str, status| {
        let filter = ListFilter { owner: Some(owner.into()), status, limit: 10, ..ListFilter::default() };
        bench.store.list(&filter).await.unwrap().jobs.into_iter().map(|job| job.id).collect::<Vec<_>>()
    };
    assert_eq!(list("a", None).await, [again.job().id, ids[1]]);
    assert_eq!(list("b", Some(Status::Succeeded)).await, [ids[2]]);
    assert_eq!((list("b", Some(Status::Queued)).await, list("nobody", None).await), (vec![], vec![]));
    // The same isolation applies to batches.
    let batch = |owner: &str| NewBatch {
        jobs: vec![new_job("in a batch")],
        owner: Some(owner.into()),
        quota: Quota::default(),
        priority: Priority::default(),
        study: None,
        idempotency: Some(("k".into(), owner.into())),
    };
    for owner in ["a", "b"] {
        let made = bench.store.submit_batch(batch(owner)).await.unwrap();
        assert!(matches!(made, SubmittedBatch::Accepted(_)));
        let id = made.batch().id;
        assert_eq!(bench.store.batch(id).await.unwrap().unwrap().owner.as_deref(), Some(owner));
        assert_eq!(bench.store.replayed_batch(Some(owner), "k", owner).await.unwrap().map(|batch| batch.id), Some(id));
        let job = bench.store.get(made.batch().jobs[0]).await.unwrap().unwrap();
        assert_eq!((job.owner.as_deref(), job.batch), (Some(owner), Some(id)));
    }
}

pub async fn an_owner_has_a_quota(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let two = |owner: &str, digest: &str| NewJob {
        quota: Quota { unfinished: Some(2), bytes: Some(1000) },
        reuse: false,
        ..of(owner, digest)
    };
    bench.store.submit(two("a", "1")).await.unwrap();
    bench.store.submit(two("a", "2")).await.unwrap();
    let refused = bench.store.submit(two("a", "3")).await;
    let full = StoreError::QuotaExceeded { what: Quantity::Unfinished, used: 2, more: 1, limit: 2 };
    assert_eq!(refused.unwrap_err().to_string(), full.to_string());
    bench.store.submit(two("b", "3")).await.unwrap();
    // A running job counts towards the quota; an ended one does not.
    let claimed = bench.claim("w").await.unwrap();
    assert_eq!(claimed.job().owner.as_deref(), Some("a"));
    assert!(bench.store.submit(two("a", "4")).await.is_err());
    let done =
        Finished { files: vec![file("model.glb", 700, "one"), file("report.json", 300, "two")], ..finished(&claimed) };
    let ended = bench.finish_with(claimed, done).await;
    // The stored files of the ended job count: the limit is 1000 bytes.
    let refused = bench.store.submit(two("a", "4")).await;
    let full = StoreError::QuotaExceeded { what: Quantity::Bytes, used: 1000, more: 0, limit: 1000 };
    assert_eq!(refused.unwrap_err().to_string(), full.to_string());
    bench.store.delete(ended.id).await.unwrap();
    bench.store.submit(two("a", "4")).await.unwrap();
    // Concurrent submissions cannot exceed the quota together.
    let racing = (0..12).map(|n| {
        let (store, new) = (bench.store.clone(), two("racer", &format!("r{n}")));
        tokio::spawn(async move { store.submit(new).await.is_ok() })
    });
    let accepted = join_all(racing).await.into_iter().filter(|taken| *taken.as_ref().unwrap()).count();
    assert_eq!(accepted, 2);
    // A batch is accepted or refused as a whole.
    let batch = NewBatch {
        jobs: vec![new_job("5"), new_job("6"), new_job("7")],
        owner: Some("c".into()),
        quota: Quota { unfinished: Some(2), bytes: None },
        priority: Priority::default(),
        study: None,
        idempotency: None,
    };
    assert!(matches!(bench.store.submit_batch(batch.clone()).await, Err(StoreError::QuotaExceeded { used: 0, .. })));
    bench.store.submit_batch(NewBatch { jobs: batch.jobs[..2].to_vec(), ..batch }).await.unwrap();
}

fn file(name: &str, bytes: u64, key: &str) -> File {
    let sha256 = "0".repeat(64);
    File { name: name.into(), media_type: "text/plain".into(), bytes, sha256, key: key.into(), start: None }
}

pub(super) fn new_key(secret: &Secret, owner: &str, expires_at: Option<Timestamp>) -> NewKey {
    NewKey {
        prefix: secret.prefix().into(),
        hash: secret.hash(),
        owner: owner.parse().unwrap(),
        scopes: [Scope::Read, Scope::Submit].into_iter().collect(),
        limits: KeyLimits { rate: Some(2.5), quota: Quota { unfinished: Some(7), bytes: None } },
        expires_at,
    }
}

pub async fn keys_are_stored_revoked_and_listed(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let (one, other) = (Secret::generate(), Secret::generate());
    let (now, none) = bench.store.keys().await.unwrap();
    assert!(none.is_empty());
    let end = now + Duration::from_secs(3600);
    let made = bench.store.add_key(new_key(&one, "lab", Some(end))).await.unwrap();
    let stored = (made.prefix.as_str(), made.owner.name(), made.scopes.to_string(), made.expires_at, made.revoked_at);
    assert_eq!(stored, (one.prefix(), "lab", "read,submit".to_owned(), Some(end), None));
    assert_eq!(made.limits, KeyLimits { rate: Some(2.5), quota: Quota { unfinished: Some(7), bytes: None } });
    assert!(one.matches(&made.hash) && !other.matches(&made.hash));
    // A second API key with the same prefix is refused, and the secret of the first key keeps
    // working.
    let clash = NewKey { hash: other.hash(), ..new_key(&one, "thief", None) };
    assert!(bench.store.add_key(clash).await.is_err());
    let second = bench.store.add_key(new_key(&other, "lab", None)).await.unwrap();
    let prefixes = |keys: &[Key]| keys.iter().map(|key| key.prefix.clone()).collect::<Vec<_>>();
    let (_, keys) = bench.store.keys().await.unwrap();
    assert_eq!((keys.len(), keys.contains(&made), keys.contains(&second)), (2, true, true), "{:?}", prefixes(&keys));
    // A later revocation does not postpone an earlier one.
    let revoked = bench.store.revoke_key(one.prefix(), Duration::from_secs(60)).await.unwrap().unwrap();
    let at = revoked.revoked_at.unwrap();
    assert!(revoked.works_at(now) && !revoked.works_at(at) && at >= now + Duration::from_secs(60));
    let again = bench.store.revoke_key(one.prefix(), Duration::from_secs(9999)).await.unwrap().unwrap();
    assert_eq!(again.revoked_at, Some(at));
    let sooner = bench.store.revoke_key(one.prefix(), Duration::ZERO).await.unwrap().unwrap();
    assert!(sooner.revoked_at.unwrap() < at);
    assert_eq!(bench.store.revoke_key("00000000", Duration::ZERO).await.unwrap(), None);
}

pub async fn only_one_first_key_is_made(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let racers = (0..8).map(|_| {
        let store = bench.store.clone();
        tokio::spawn(async move { store.add_first_key(new_key(&Secret::generate(), "admin", None)).await.unwrap() })
    });
    let made: Vec<Key> = join_all(racers).await.into_iter().filter_map(Result::unwrap).collect();
    assert_eq!(made.len(), 1);
    bench.store.revoke_key(&made[0].prefix, Duration::ZERO).await.unwrap();
    // A first API key is created only in a store that has never had a key.
    assert_eq!(bench.store.add_first_key(new_key(&Secret::generate(), "admin", None)).await.unwrap(), None);
}

pub async fn a_ticket_is_good_once_for_its_path_and_a_minute(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let life = Duration::from_secs(60);
    let ticket = |secret: &TicketSecret, life| NewTicket {
        hash: secret.hash(),
        key: "12345678".into(),
        path: "/models/1/events".into(),
        life,
    };
    let secret = TicketSecret::generate();
    let (now, _) = bench.store.keys().await.unwrap();
    let end = bench.store.add_ticket(ticket(&secret, life)).await.unwrap();
    assert!(end >= now + life);
    assert_eq!(bench.store.use_ticket(&secret.hash(), "/models/2/events").await.unwrap(), None);
    assert_eq!(bench.store.use_ticket(&TicketSecret::generate().hash(), "/models/1/events").await.unwrap(), None);
    assert_eq!(bench.store.ticket(&secret.hash(), "/models/2/events").await.unwrap(), None);
    assert_eq!(bench.store.ticket(&secret.hash(), "/models/1/events").await.unwrap().as_deref(), Some("12345678"));
    // Of several concurrent requests with one ticket, exactly one succeeds.
    let racers = (0..8).map(|_| {
        let (store, hash) = (bench.store.clone(), secret.hash());
        tokio::spawn(async move { store.use_ticket(&hash, "/models/1/events").await.unwrap() })
    });
    let used: Vec<String> = join_all(racers).await.into_iter().filter_map(Result::unwrap).collect();
    assert_eq!(used, ["12345678"]);
    assert_eq!(bench.store.ticket(&secret.hash(), "/models/1/events").await.unwrap(), None);
    let late = TicketSecret::generate();
    bench.store.add_ticket(ticket(&late, Duration::ZERO)).await.unwrap();
    assert_eq!(bench.store.ticket(&late.hash(), "/models/1/events").await.unwrap(), None);
    assert_eq!(bench.store.use_ticket(&late.hash(), "/models/1/events").await.unwrap(), None);
}
