//! Clients: submission, idempotency, reuse, limits, cancellation, deletion.

use super::*;

pub async fn cancel_is_idempotent_in_every_state(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let unknown = JobId(uuid::Uuid::now_v7());
    assert_eq!(bench.store.cancel(unknown).await.unwrap(), None);
    // A queued job ends immediately.
    let queued = bench.queue("1").await.id;
    let ended = bench.store.cancel(queued).await.unwrap().unwrap();
    assert_eq!((ended.status, ended.finished_at), (Status::Cancelled, Some(bench.clock.now())));
    assert_eq!(bench.store.cancel(queued).await.unwrap().unwrap(), ended);
    assert!(bench.claim("w").await.is_none());
    // The worker of a running job is asked to stop.
    let running = bench.queue("2").await.id;
    let claimed = bench.claim("w").await.unwrap();
    let asked = bench.store.cancel(running).await.unwrap().unwrap();
    assert_eq!((asked.status, asked.cancel_requested), (Status::Running, true));
    assert_eq!(bench.store.cancel(running).await.unwrap().unwrap(), asked);
    assert_eq!(bench.beat(&claimed).await, Directive::Cancel);
    assert_eq!(bench.store.cancelled(claimed).await.unwrap(), Status::Cancelled);
    // The worker finishes the job, or fails, before it learns of the cancellation.
    for digest in ["6", "7"] {
        let late = bench.queue(digest).await.id;
        let claimed = bench.claim("w").await.unwrap();
        bench.store.cancel(late).await.unwrap();
        let ended = if digest == "6" { bench.finish(claimed).await } else { bench.fail(claimed, "panic").await };
        let result = (ended.status, ended.files.len(), &ended.summary, &ended.problem);
        assert_eq!(result, (Status::Cancelled, 0, &None, &None));
        assert_eq!(bench.store.attempts(late).await.unwrap()[0].outcome, Some(AttemptEnd::Cancelled));
    }
    // A cancelled job whose worker vanishes is not retried.
    let vanished = bench.queue("3").await.id;
    bench.claim("w").await.unwrap();
    bench.store.cancel(vanished).await.unwrap();
    bench.clock.advance(LEASE);
    assert!(bench.claim("w").await.is_none());
    assert_eq!(bench.get(vanished).await.status, Status::Cancelled);
    // An ended job does not change.
    let succeeded = bench.succeed("4").await;
    assert_eq!(bench.store.cancel(succeeded.id).await.unwrap().unwrap(), succeeded);
    bench.queue("5").await;
    let failed = bench.fail(bench.claim("w").await.unwrap(), "panic").await;
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
    named.dedup();
    assert_eq!(keys, named);
    assert!(!bench.uses(&keys[0]).await);
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
    // A replay succeeds although the queue is full.
    let again = bench.store.submit(keyed("k", "body")).await.unwrap();
    assert_eq!(again, Submitted::Replayed(first.job().clone()));
    let other = bench.store.submit(keyed("k", "another")).await;
    assert!(matches!(other, Err(StoreError::IdempotencyConflict)), "{other:?}");
    // A replay returns the current state of the job. The idempotency key exists as long as the job.
    let claimed = bench.claim("w").await.unwrap();
    let ended = bench.finish(claimed).await;
    assert_eq!(bench.store.submit(keyed("k", "body")).await.unwrap(), Submitted::Replayed(ended.clone()));
    // `replayed` looks up an idempotency key without submitting a job.
    assert_eq!(bench.store.replayed(None, "k", "body").await.unwrap(), Some(ended));
    for (key, body) in [("k", "another"), ("j", "body"), ("", "")] {
        assert_eq!(bench.store.replayed(None, key, body).await.unwrap(), None, "{key} {body}");
    }
    assert_eq!(bench.store.replayed_batch(None, "k", "body").await.unwrap(), None, "keys of batches are separate");
    bench.store.delete(first.job().id).await.unwrap();
    assert_eq!(bench.store.replayed(None, "k", "body").await.unwrap(), None);
    let fresh = bench.store.submit(keyed("k", "another")).await.unwrap();
    assert!(matches!(fresh, Submitted::Queued(_)));
}

pub async fn racing_idempotency_keys_give_one_job(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let racers = (0..48).map(|n| {
        let store = bench.store.clone();
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
    assert_eq!((job.backend.used, job.finished_at), (Some(UsedBackend::Cpu), Some(bench.clock.now())));
    let mut single = new_job("d");
    single.backend = Backend::CpuSingle;
    let reused = bench.store.submit(single).await.unwrap();
    assert_eq!(reused.job().backend.requested, Backend::CpuSingle);
    assert!(matches!(reused, Submitted::Reused(_)));
    // Another backend, format or digest, or a request without reuse, grows a new model.
    let refused: [fn(&mut NewJob); 4] = [
        |new| new.backend = Backend::Gpu,
        |new| new.outputs = vec![Output::Glb, Output::Obj].into(),
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
    // Reuse needs no room in the queue.
    assert!(matches!(bench.store.submit(new_job("d")).await.unwrap(), Submitted::Reused(_)));
}

pub async fn bodies_and_units_are_kept_and_decide_what_is_reused(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let with = |formats: &[Output], bodies: &[BodyKind], units| NewJob {
        outputs: Outputs { formats: formats.to_vec(), bodies: bodies.to_vec(), units },
        ..new_job("b")
    };
    let (tissue, lumen) = (BodyKind::Tissue, BodyKind::Lumen);
    let made = with(&[Output::Glb, Output::Stl], &[tissue, lumen], Some(LengthUnit::Micrometre));
    let id = bench.submit(made.clone()).await.id;
    assert_eq!(bench.get(id).await.outputs, made.outputs);
    let claimed = bench.claim("w").await.unwrap();
    let files = ["model.glb", "lumen.glb", "model.stl", "lumen.stl", "report.json"]
        .map(|name| file(&claimed, name, name, None));
    let finished = Finished { files: files.to_vec(), ..finished(&claimed) };
    bench.store.finish(claimed, finished).await.unwrap();
    let names = |job: &Job| job.files.iter().map(|file| file.name.clone()).collect::<Vec<_>>();
    // glTF has a fixed unit of length, so the requested unit does not matter.
    let reused = bench.store.submit(with(&[Output::Glb], &[lumen], None)).await.unwrap();
    assert!(matches!(reused, Submitted::Reused(_)), "{reused:?}");
    assert_eq!(names(reused.job()), ["lumen.glb", "report.json"]);
    let other_unit = bench.store.submit(with(&[Output::Stl], &[lumen], None)).await.unwrap();
    assert!(matches!(other_unit, Submitted::Queued(_)), "{other_unit:?}");
    let other_body = bench.store.submit(with(&[Output::Glb], &[BodyKind::Regions], None)).await.unwrap();
    assert!(matches!(other_body, Submitted::Queued(_)), "{other_body:?}");
}

pub async fn shared_files_go_with_the_last_job(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let made = bench.succeed("d").await;
    let second = bench.store.submit(new_job("d")).await.unwrap().job().clone();
    assert_eq!(bench.store.delete(made.id).await.unwrap(), Some(vec![]));
    assert_eq!(bench.get(second.id).await, second);
    // The first model is deleted, so a third request reuses the second.
    let third = bench.store.submit(new_job("d")).await.unwrap().job().clone();
    assert_eq!(third.reused_from, Some(second.id));
    assert_eq!(bench.store.delete(third.id).await.unwrap(), Some(vec![]));
    assert_eq!(bench.store.delete(second.id).await.unwrap().unwrap().len(), objects(&made.files));
    assert!(matches!(bench.store.submit(new_job("d")).await.unwrap(), Submitted::Queued(_)));
}

pub async fn the_queue_has_a_limit(factory: Factory) {
    let bench = bench(factory, |options| options.queue_limit = 2).await;
    let first = bench.queue("1").await.id;
    bench.queue("2").await;
    let full = bench.store.submit(new_job("3")).await;
    assert!(matches!(full, Err(StoreError::QueueFull { limit: 2 })), "{full:?}");
    // Cancelling and claiming jobs make room in the queue.
    bench.store.cancel(first).await.unwrap();
    bench.queue("3").await;
    bench.claim("w").await.unwrap();
    bench.queue("4").await;
    assert!(bench.store.submit(new_job("5")).await.is_err());
}

pub async fn a_submission_returns_the_record(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let labels = BTreeMap::from([("lab".to_owned(), "3".to_owned()), ("run".to_owned(), "a".to_owned())]);
    let made = bench.succeed("made").await;
    bench.queue("first").await;
    let outputs = oviduct::generate::Outputs {
        bodies: vec![BodyKind::Lumen],
        units: Some(LengthUnit::Micrometre),
        ..vec![Output::Glb, Output::Lod].into()
    };
    let requests = [
        new_job("plain"),
        NewJob { labels, owner: Some("lab".into()), trace: None, batch_key: None, ..new_job("labelled") },
        NewJob { backend: Backend::CpuSingle, outputs, priority: 7.try_into().unwrap(), ..new_job("other") },
        NewJob { idempotency: Some(("key".into(), "hash".into())), ..new_job("keyed") },
        NewJob { kind: JobKind::Fit, spec: serde_json::json!({ "evaluations": 3 }).into(), ..new_job("fit") },
        // Reuses files, and waits for an equal job.
        new_job(&made.digest),
        new_job("first"),
        NewJob { retry_of: Some(made.id), ..new_job("again") },
    ];
    for (place, request) in requests.into_iter().enumerate() {
        let submitted = bench.store.submit(request).await.unwrap();
        let job = submitted.job();
        assert_eq!(*job, bench.get(job.id).await, "request {place}");
        assert_eq!(matches!(submitted, Submitted::Reused(_)), place == 5);
    }
}

/// Changes that share a transaction: those that are refused do not affect the others.
pub async fn submissions_at_once_share_transactions_and_are_refused_alone(factory: Factory) {
    let bench = bench(factory, |options| options.queue_limit = 40).await;
    let conflict = NewJob { idempotency: Some(("key".into(), "body".into())), ..new_job("keyed") };
    bench.store.submit(conflict.clone()).await.unwrap();
    let requests = (0..60).map(|n| match n % 6 {
        0 => NewJob { idempotency: Some(("key".into(), "other body".into())), ..new_job("keyed") },
        _ => new_job(&format!("{n}")),
    });
    let ended = join_all(requests.map(|request| bench.store.submit(request))).await;
    let mut ids = Vec::new();
    let (mut conflicts, mut full) = (0, 0);
    for result in ended {
        match result {
            Ok(Submitted::Queued(job)) => ids.push(job.id),
            Err(StoreError::IdempotencyConflict) => conflicts += 1,
            Err(StoreError::QueueFull { limit: 40 }) => full += 1,
            other => panic!("{other:?}"),
        }
    }
    assert_eq!((ids.len(), conflicts, full), (39, 10, 11));
    for id in &ids {
        assert_eq!(bench.get(*id).await.status, Status::Queued);
    }
    assert_eq!(bench.store.counts().await.unwrap().queued, 40);
}
