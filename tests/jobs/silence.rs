//! A server that accepts connections and statements and never answers: nothing waits for longer
//! than the deadline, and no change is lost or made twice.

use crate::cluster::Cluster;
use crate::relay::{Line, Way};
use crate::scripted::Database;
use crate::suite::{finished, new_job, objects};
use oviduct::clock::Stopwatch;
use oviduct::jobs::artifacts::Artifacts;
use oviduct::jobs::state::AttemptEnd;
use oviduct::jobs::{ClaimScope, File, NewJob, Status, Store, StoreOptions, Submitted};
use std::sync::Arc;
use std::time::Duration;
use tokio::io::AsyncReadExt;
use tokio::net::TcpListener;

/// Deadline of the stores in these tests.
const ANSWER: Duration = Duration::from_millis(800);
const LEASE: Duration = Duration::from_secs(600);

async fn store_over(way: &Way) -> Store {
    let options = StoreOptions { answer_within: ANSWER, ..StoreOptions::default() };
    Store::open_postgres(&way.url, options).await.unwrap()
}

/// Asserts that this takes at most `limit` and a second, for a busy machine.
async fn within<T>(limit: Duration, what: &str, future: impl Future<Output = T>) -> T {
    let since = Stopwatch::start();
    let done = tokio::time::timeout(Duration::from_secs(120), future).await;
    let elapsed = since.elapsed();
    assert!(elapsed < limit + Duration::from_secs(1), "{what} took {elapsed:?}");
    done.unwrap()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_silent_server_fails_every_use_after_the_deadline() {
    let way = Way::open(&Database::Postgres.url("".as_ref()).await).await;
    let store = store_over(&way).await;
    let id = store.submit(new_job("a")).await.unwrap().job().id;
    let claimed = store.claim("w", ClaimScope::Cpu, LEASE, 1).await.unwrap().pop().unwrap();
    for line in [Line::Deaf, Line::Dead] {
        way.set(line);
        let error = within(ANSWER, "a read", store.get(id)).await.unwrap_err();
        assert!(error.to_string().contains("did not answer within 800ms"), "{error}");
        // The next connection does not open at all: the server does not answer the handshake.
        let opening = Duration::from_secs(5);
        within(opening, "a second read", store.get(id)).await.unwrap_err();
        let backend = &claimed.job().backend;
        let beat = store.heartbeat(&claimed, LEASE, backend, None, None);
        within(2 * opening, "a heartbeat", beat).await.unwrap_err();
        // More callers than connections.
        let readers = (0..40).map(|_| store.get(id));
        let failed = within(2 * opening, "40 reads", futures_util::future::join_all(readers)).await;
        assert!(failed.iter().all(Result::is_err));
        way.set(Line::Open);
        // The pool has not lost a connection.
        let readers = (0..40).map(|_| store.get(id));
        let read = within(opening, "reads after the silence", futures_util::future::join_all(readers)).await;
        assert!(read.iter().all(Result::is_ok), "{read:?}");
    }
    way.set(Line::Dead);
    within(Duration::from_secs(20), "closing", store.close()).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_commit_without_an_answer_takes_effect_once() {
    let way = Way::open(&Database::Postgres.url("".as_ref()).await).await;
    let store = store_over(&way).await;
    // Ends the silence some time after the commit.
    let lose = || {
        way.set(Line::DeafAtCommit);
        let line = Arc::clone(&way.line);
        tokio::spawn(async move {
            line.subscribe().wait_for(|line| *line == Line::Deaf).await.unwrap();
            tokio::time::sleep(ANSWER).await;
            line.send_replace(Line::Open);
        })
    };
    let limit = Duration::from_secs(8);
    let silence = lose();
    let id = within(limit, "a submission", store.submit(new_job("a"))).await.unwrap().job().id;
    silence.await.unwrap();
    let silence = lose();
    let claim = store.claim("w", ClaimScope::Cpu, LEASE, 1);
    let claimed = within(limit, "a claim", claim).await.unwrap().pop().expect("the claim was lost");
    silence.await.unwrap();
    assert_eq!((claimed.job().id, claimed.attempt()), (id, 1));
    let silence = lose();
    let done = finished(&claimed);
    let files = objects(&done.files);
    let status = within(limit, "the end", store.finish(claimed, done)).await.unwrap();
    silence.await.unwrap();
    assert_eq!(status, Status::Succeeded);
    let ends: Vec<_> = store.attempts(id).await.unwrap().into_iter().map(|attempt| attempt.outcome).collect();
    assert_eq!(ends, [Some(AttemptEnd::Succeeded)]);
    let silence = lose();
    let keys = within(limit, "a deletion", store.delete(id)).await.unwrap();
    silence.await.unwrap();
    assert_eq!(keys.map(|keys| keys.len()), Some(files));
    assert_eq!(store.counts().await.unwrap().total(), 0);
    store.close().await;
}

/// Waits until the server has received a commit that was held, and has answered.
async fn after_the_held_commit(way: &Way) {
    way.set(Line::Open);
    tokio::time::sleep(Duration::from_secs(1)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_submission_that_arrives_late_creates_no_second_model() {
    let way = Way::open(&Database::Postgres.url("".as_ref()).await).await;
    let store = store_over(&way).await;
    // The store has to know the time of the database to submit in one statement.
    let id = store.submit(new_job("first")).await.unwrap().job().id;
    store.delete(id).await.unwrap().expect("the model exists");

    // The model of the retry is deleted before the first statement arrives.
    way.set(Line::HeldAtCommit);
    let id = store.submit(new_job("a")).await.unwrap().job().id;
    assert_eq!(*way.line.borrow(), Line::Held);
    store.delete(id).await.unwrap().expect("the model exists");
    after_the_held_commit(&way).await;
    assert_eq!(store.counts().await.unwrap().total(), 0);

    // The retry finds another model with its key, which is then deleted.
    let with_key = || NewJob { idempotency: Some(("key".into(), "body".into())), ..new_job("b") };
    let other = store.submit(with_key()).await.unwrap().job().id;
    way.set(Line::HeldAtCommit);
    let submitted = store.submit(with_key()).await.unwrap();
    assert_eq!(*way.line.borrow(), Line::Held);
    assert!(matches!(&submitted, Submitted::Replayed(job) if job.id == other), "{submitted:?}");
    store.delete(other).await.unwrap().expect("the model exists");
    after_the_held_commit(&way).await;
    assert_eq!(store.counts().await.unwrap().total(), 0);
    store.close().await;
}

/// A store over a way, and one that reaches the same database without it.
async fn a_store_over_a_way_and_another() -> (Way, Store, Store) {
    let url = Database::Postgres.url("".as_ref()).await;
    let way = Way::open(&url).await;
    let open = async |url: &str| Store::open_postgres(url, StoreOptions::default()).await.unwrap();
    let (store, other) = (open(&way.url).await, open(&url).await);
    (way, store, other)
}

/// Gives another store time to wait for the locks of a held commit, and cuts all connections.
async fn roll_back_the_held_commit(way: &Way) {
    tokio::time::sleep(Duration::from_millis(500)).await;
    way.set(Line::Cut);
    tokio::time::sleep(Duration::from_millis(100)).await;
    way.set(Line::Open);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_cancellation_that_is_rolled_back_is_not_acknowledged_for_an_ended_model() {
    let (way, store, other) = a_store_over_a_way_and_another().await;
    let id = other.submit(new_job("a")).await.unwrap().job().id;
    let claimed = other.claim("w", ClaimScope::Cpu, LEASE, 1).await.unwrap().pop().unwrap();
    way.set(Line::HeldAtCommit);
    let cancelling = store.clone();
    let cancelled = tokio::spawn(async move { cancelling.cancel(id).await.unwrap().unwrap() });
    way.line.subscribe().wait_for(|line| *line == Line::Held).await.unwrap();
    let (ending, done) = (other.clone(), finished(&claimed));
    let ended = tokio::spawn(async move { ending.finish(claimed, done).await.unwrap() });
    roll_back_the_held_commit(&way).await;
    let (cancelled, ended) = (cancelled.await.unwrap().status, ended.await.unwrap());
    let expected = if ended == Status::Cancelled { Status::Running } else { Status::Succeeded };
    assert_eq!(cancelled, expected, "the model ended as {ended:?}");
    store.close().await;
    other.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn one_of_two_deletions_succeeds_if_the_commit_of_the_first_is_rolled_back() {
    let (way, store, other) = a_store_over_a_way_and_another().await;
    let id = store.submit(new_job("a")).await.unwrap().job().id;
    way.set(Line::HeldAtCommit);
    let (first, second) = (store.clone(), other.clone());
    let first = tokio::spawn(async move { first.delete(id).await.unwrap() });
    way.line.subscribe().wait_for(|line| *line == Line::Held).await.unwrap();
    let second = tokio::spawn(async move { second.delete(id).await.unwrap() });
    roll_back_the_held_commit(&way).await;
    let deleted = [first.await.unwrap(), second.await.unwrap()];
    assert_eq!(deleted.iter().flatten().count(), 1, "{deleted:?}");
    store.close().await;
    other.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn readiness_ends_within_a_second_of_a_silence_and_at_once_if_connections_are_refused() {
    let way = Way::open(&Database::Postgres.url("".as_ref()).await).await;
    let store = store_over(&way).await;
    let answered = Duration::from_millis(500);
    store.ready().await.unwrap();
    way.set(Line::Dead);
    tokio::time::sleep(answered).await;
    let checked = tokio::time::timeout(store.ready_within(), store.ready()).await;
    assert!(!matches!(checked, Ok(Ok(()))), "{checked:?}");
    way.set(Line::Open);
    store.ready().await.unwrap();

    let cluster = tokio::task::spawn_blocking(Cluster::start).await.unwrap();
    let url = cluster.database();
    let store = Store::open_postgres(&url, StoreOptions::default()).await.unwrap();
    store.ready().await.unwrap();
    tokio::task::spawn_blocking(move || drop(cluster)).await.unwrap();
    let refused = async {
        while store.ready().await.is_ok() {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    within(Duration::from_secs(3), "noticing that the server is gone", refused).await;
    within(Duration::ZERO, "a read without a server", store.counts()).await.unwrap_err();
}

/// An object store that accepts requests and never answers them.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_silent_object_store_fails_every_request() {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let endpoint = format!("http://{}", listener.local_addr().unwrap());
    tokio::spawn(async move {
        let mut open = Vec::new();
        while let Ok((mut client, _)) = listener.accept().await {
            open.push(tokio::spawn(async move {
                let mut bytes = vec![0; 1 << 16];
                while client.read(&mut bytes).await.is_ok_and(|length| length > 0) {}
            }));
        }
    });
    let settings = [
        ("AWS_ACCESS_KEY_ID", "a".to_owned()),
        ("AWS_SECRET_ACCESS_KEY", "b".to_owned()),
        ("AWS_ENDPOINT_URL", endpoint),
    ];
    let artifacts = Artifacts::s3("s3://bucket", settings.map(|(name, value)| (name.to_owned(), value))).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("model.glb");
    // Larger than a part, so that it is uploaded in several requests.
    std::fs::write(&path, vec![0; 9_000_000]).unwrap();
    let keys = ["models/a/1/model.glb".to_owned()];
    let (key, ranges) = (keys[0].as_str(), [0..10, 20..30]);
    let file = File {
        name: "model.glb".into(),
        media_type: "model/gltf-binary".into(),
        bytes: 9_000_000,
        sha256: String::new(),
        key: key.into(),
        start: None,
    };
    // One request is not answered; it may have been retried once.
    let limit = Duration::from_secs(22);
    let (read, part, put, bytes, missing, deleted, checked) = within(limit, "all requests", async {
        tokio::join!(
            artifacts.read_all(key),
            artifacts.get_ranges(&file, &ranges),
            artifacts.put_file(key, &path),
            artifacts.put_bytes(key, "x".into()),
            artifacts.missing(&keys),
            artifacts.delete(&keys),
            artifacts.check(),
        )
    })
    .await;
    let outcomes = [
        read.is_err(),
        part.is_err(),
        put.is_err(),
        bytes.is_err(),
        missing.is_err(),
        deleted.is_err(),
        checked.is_err(),
    ];
    assert_eq!(outcomes, [true; 7]);
    assert!(artifacts.outage().is_some());
}
