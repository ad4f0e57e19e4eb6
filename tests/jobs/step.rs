//! Wrong clocks: set back, ahead of the database, or behind the times of files.

use crate::scripted::{Database, Place, scripted};
use crate::suite::{LEASE, finished, new_job, problem};
use crate::unread::execute;
use oviduct::clock::Clock;
use oviduct::jobs::sweep::{Retention, Sweeper};
use oviduct::jobs::{
    ClaimScope, ClaimedJob, Directive, JobId, NewBatch, Priority, Status, Store, StoreOptions, SubmittedBatch,
    WorkerKind,
};
use std::time::Duration;

const HOUR: Duration = Duration::from_secs(3600);

fn set_back(clock: &Clock, by: Duration) {
    clock.set(clock.now().saturating_sub(by).unwrap());
}

async fn claim(store: &Store) -> Option<ClaimedJob> {
    store.claim("w", ClaimScope::Cpu, LEASE, 1).await.unwrap().pop()
}

async fn a_clock_that_is_set_back_delays_no_job(database: Database) {
    let clock = Clock::manual("2026-01-02T03:04:05Z".parse().unwrap());
    let options = StoreOptions { clock: clock.clone(), ..StoreOptions::default() };
    let place = Place::on(database, options).await;
    let submit = async |digest: &str| place.store.submit(new_job(digest)).await.unwrap().job().id;
    let (released, retried, queued) = (submit("a").await, submit("b").await, submit("c").await);
    let claimed = claim(&place.store).await.unwrap();
    assert_eq!(claimed.job().id, released);
    place.store.release(claimed, None).await.unwrap();
    let first = claim(&place.store).await.unwrap();
    let claimed = claim(&place.store).await.unwrap();
    assert_eq!((first.job().id, claimed.job().id), (released, retried));
    place.store.retry(claimed, problem("io")).await.unwrap();
    place.store.release(first, None).await.unwrap();
    set_back(&clock, HOUR);
    let mut order: Vec<JobId> = Vec::new();
    while let Some(claimed) = claim(&place.store).await {
        order.push(claimed.job().id);
        let done = finished(&claimed);
        place.store.finish(claimed, done).await.unwrap();
    }
    assert_eq!(order, [released, retried, queued]);
    place.store.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_clock_that_is_set_back_delays_no_job_on_sqlite() {
    a_clock_that_is_set_back_delays_no_job(Database::Sqlite).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_clock_that_is_set_back_delays_no_job_on_postgres() {
    a_clock_that_is_set_back_delays_no_job(Database::Postgres).await;
}

/// The clock of a server is set back by hours. Workers that are alive keep their jobs; the job of a
/// worker that has vanished is claimed again, although its lease seems to last for hours.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_lease_from_before_the_clock_was_set_back_expires() {
    let clock = Clock::manual("2026-01-02T03:04:05Z".parse().unwrap());
    let options = StoreOptions { clock: clock.clone(), ..StoreOptions::default() };
    let place = Place::on(Database::Postgres, options).await;
    let store = &place.store;
    let (vanished, alive) = (store.submit(new_job("a")).await.unwrap(), store.submit(new_job("b")).await.unwrap());
    let taken = claim(store).await.unwrap();
    assert_eq!(taken.job().id, vanished.job().id);
    let held = claim(store).await.unwrap();
    assert_eq!(held.job().id, alive.job().id);
    let beat = async || {
        let beat = store.heartbeat(&held, LEASE, &held.job().backend, None, None).await.unwrap();
        assert_eq!(beat, Directive::Continue);
    };
    // The process has seen the database for a whole lease.
    clock.advance(LEASE / 2);
    beat().await;
    assert!(claim(store).await.is_none());
    clock.advance(LEASE / 2 - Duration::from_secs(1));
    beat().await;
    assert!(claim(store).await.is_none());

    set_back(&clock, 3 * HOUR);
    // The holder has not renewed its lease yet since the clock was set.
    assert!(claim(store).await.is_none(), "no lease expires at the step");
    clock.advance(LEASE / 2);
    beat().await;
    assert!(claim(store).await.is_none(), "holders have a whole lease to renew");
    clock.advance(LEASE / 2);
    beat().await;
    let again = claim(store).await.expect("the lease has expired");
    assert_eq!((again.job().id, again.attempt()), (vanished.job().id, 2));
    beat().await;
    place.store.close().await;
}

/// The store's clock, years behind the clock of this process, determines ages.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn retention_and_live_workers_are_by_the_clock_of_the_store() {
    let clock = Clock::manual("2020-01-02T03:04:05Z".parse().unwrap());
    let place = Place::fresh(|options| options.clock = clock.clone()).await;
    let pool = place.start(|_| {});
    let job = place.ended(place.queue("ok", 1).await).await;
    assert_eq!(job.status, Status::Succeeded);
    let keeps = Retention { age: Some(HOUR), bytes: None };
    let sweep = async || place.retain(keeps).await.removed;
    assert_eq!(sweep().await, 0, "it ended just now");
    assert_eq!(place.store.count_live_workers(WorkerKind::Cpu, HOUR).await.unwrap(), 1);
    assert_eq!(place.store.count_live_workers(WorkerKind::Gpu, HOUR).await.unwrap(), 0);
    pool.shutdown(Duration::from_secs(5)).await;
    clock.advance(HOUR + Duration::from_secs(1));
    assert_eq!(place.store.count_live_workers(WorkerKind::Cpu, HOUR).await.unwrap(), 0);
    assert_eq!(sweep().await, 1);
}

/// A service with a limit on the age of models, and its rounds of upkeep.
struct Rounds {
    place: Place,
    clock: Clock,
    sweeper: Sweeper,
}

const KEEP: Duration = Duration::from_secs(30 * 86_400);
const DAY: Duration = Duration::from_secs(86_400);
const YEAR: Duration = Duration::from_secs(365 * 86_400);

impl Rounds {
    /// A service whose one model has just ended.
    async fn begin(database: Database) -> Self {
        let clock = Clock::manual("2026-01-02T03:04:05Z".parse().unwrap());
        let options = StoreOptions { clock: clock.clone(), ..StoreOptions::default() };
        let place = Place::on(database, options).await;
        let sweeper = Sweeper::new(place.store.clone(), place.artifacts.clone(), "first");
        let rounds = Self { place, clock, sweeper };
        rounds.end_model("a").await;
        rounds
    }

    async fn end_model(&self, digest: &str) {
        self.place.store.submit(new_job(digest)).await.unwrap();
        let claimed = claim(&self.place.store).await.unwrap();
        let done = finished(&claimed);
        self.place.store.finish(claimed, done).await.unwrap();
    }

    fn restart(&mut self) {
        self.sweeper = Sweeper::new(self.place.store.clone(), self.place.artifacts.clone(), "next");
    }

    /// Sets the clock ahead without letting time pass.
    fn jump(&self, by: Duration) {
        self.clock.set(self.clock.now() + by);
    }

    /// Does a round a minute later. Returns the jump of the clock and the number of deleted models.
    async fn round(&self, trust: bool) -> (Option<Duration>, u64) {
        self.clock.advance(Duration::from_secs(60));
        let keeps = Retention { age: Some(KEEP), bytes: None };
        let round = self.sweeper.observe(keeps, trust).await.unwrap();
        // The process skips a round with a jump; this test does not, so that it sees more.
        let swept = self.sweeper.retain(keeps, &round.state).await.unwrap();
        (round.jump.map(|jump| jump.by), swept.map_or(0, |swept| swept.removed))
    }
}

async fn a_clock_that_jumps_ahead_deletes_no_model(database: Database) {
    let mut rounds = Rounds::begin(database).await;
    assert_eq!(rounds.round(false).await, (None, 0));
    rounds.jump(YEAR);
    assert_eq!(rounds.round(false).await, (Some(YEAR), 0));
    assert_eq!(rounds.round(false).await, (None, 0));
    rounds.restart();
    assert_eq!(rounds.round(false).await, (None, 0), "a restart remembers the jump");
    rounds.end_model("b").await;

    // If the clock stays so, each model is deleted after its whole time.
    rounds.clock.advance(KEEP - DAY);
    assert_eq!(rounds.round(false).await, (None, 0));
    rounds.clock.advance(DAY);
    assert_eq!(rounds.round(false).await, (None, 2));

    // The operator says that the clock is right.
    rounds.end_model("c").await;
    rounds.jump(YEAR);
    assert_eq!(rounds.round(false).await, (Some(YEAR), 0));
    rounds.restart();
    assert_eq!(rounds.round(true).await, (None, 1));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_clock_that_jumps_ahead_deletes_no_model_on_sqlite() {
    a_clock_that_jumps_ahead_deletes_no_model(Database::Sqlite).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_clock_that_jumps_ahead_deletes_no_model_on_postgres() {
    a_clock_that_jumps_ahead_deletes_no_model(Database::Postgres).await;
}

/// A stopped process cannot tell a wrong clock from a long stop.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn time_without_a_service_does_not_make_models_older() {
    let mut rounds = Rounds::begin(Database::Sqlite).await;
    // Before the first round, the youngest record is the last trace of time.
    rounds.jump(YEAR);
    assert_eq!(rounds.round(false).await, (Some(YEAR + Duration::from_secs(60)), 0));
    rounds.jump(2 * DAY);
    rounds.restart();
    assert_eq!(rounds.round(false).await, (None, 0), "a short stop counts");
    rounds.jump(YEAR);
    rounds.restart();
    assert_eq!(rounds.round(false).await, (Some(YEAR + Duration::from_secs(60)), 0));
    // The clock was wrong at the start and is set right.
    set_back(&rounds.clock, YEAR);
    assert_eq!(rounds.round(false).await, (None, 0));
    rounds.clock.advance(KEEP - 2 * DAY);
    assert_eq!(rounds.round(false).await, (None, 1), "the jump and the short stop are all that was not seen");
}

/// Files that several models share count once. After each removal, the size is the sum that the
/// store would compute.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn removed_models_reduce_the_stored_size() {
    let place = Place::fresh(|_| {}).await;
    let pool = place.start(|_| {});
    let mut made = Vec::new();
    for seed in 10..15 {
        made.push(place.ended(place.queue("ok", seed).await).await);
    }
    pool.shutdown(Duration::from_secs(5)).await;
    let shared = oviduct::jobs::NewJob { reuse: true, ..scripted("ok", 10) };
    let shared = place.store.submit(shared).await.unwrap().job().id;
    // Each model has two files of 1000 bytes. Retention removes the first model without its files,
    // because another model names them.
    let keeps = Retention { age: None, bytes: Some(7999) };
    let swept = place.retain(keeps).await;
    assert_eq!((swept.removed, swept.stored_bytes), (3, Some(6000)));
    assert_eq!(place.store.stored_bytes().await.unwrap(), 6000);
    assert!(place.store.get(shared).await.unwrap().is_some());
    assert!(place.store.get(made[3].id).await.unwrap().is_some());
}

/// A sweep keeps files of a running attempt however old they seem, and removes them after the
/// attempt has ended.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_sweep_leaves_the_files_of_a_running_attempt() {
    let place = Place::fresh(|_| {}).await;
    let id = place.queue("ok", 1).await;
    let claimed = claim(&place.store).await.unwrap();
    let file = place.dir.join("model.glb");
    std::fs::write(&file, "just made").unwrap();
    let key = |attempt| oviduct::jobs::artifacts::key(id, attempt, "model.glb");
    for attempt in [1, 2] {
        place.artifacts.put_file(&key(attempt), &file).await.unwrap();
    }
    let staged = place.dir.join(format!("artifacts/{}#1", key(1)));
    std::fs::write(&staged, "half").unwrap();
    // The clock of the files is behind, so the files seem older than the process.
    let now = Clock::System.now() + Duration::from_secs(60);
    let sweep = async || place.sweep_orphans(now, Duration::ZERO).await;
    assert_eq!(sweep().await, 1, "there is no second attempt yet");
    assert!(place.artifacts.read_all(&key(1)).await.is_ok() && staged.exists());
    place.store.release(claimed, None).await.unwrap();
    assert_eq!(sweep().await, 2);
    assert!(place.visible().is_empty() && !staged.exists());
}

/// A batch and its idempotency key are removed with the batch's last model.
async fn a_key_does_not_outlive_its_batch(database: Database) {
    let dir = tempfile::tempdir().unwrap();
    let url = database.url(dir.path()).await;
    let place = Place::with(dir.path(), &url, StoreOptions::default()).await;
    let batch = NewBatch {
        owner: None,
        quota: Default::default(),
        jobs: vec![new_job("a"), new_job("b"), new_job("c")],
        priority: Priority::default(),
        study: None,
        idempotency: Some(("nightly".into(), "body".into())),
    };
    let mut before = None;
    for _ in 0..3 {
        let submitted = place.store.submit_batch(batch.clone()).await.unwrap();
        let SubmittedBatch::Accepted(taken) = submitted else { panic!("a batch without models: {submitted:?}") };
        assert!(before.replace(taken.id) != Some(taken.id));
        let again = place.store.submit_batch(batch.clone()).await.unwrap();
        assert_eq!(again, SubmittedBatch::Replayed(taken.clone()));
        place.store.delete(taken.jobs[0]).await.unwrap().unwrap();
        assert_eq!(place.store.batch(taken.id).await.unwrap().unwrap().jobs.len(), 2);
        let (b, c) = tokio::join!(place.store.delete(taken.jobs[1]), place.store.delete(taken.jobs[2]));
        assert!(b.unwrap().is_some() && c.unwrap().is_some());
        assert_eq!(place.store.batch(taken.id).await.unwrap(), None);
    }
    // A batch without models, as an older version left it.
    let left = "INSERT INTO batches (id, created_at, idempotency_key, idempotency_body) \
                VALUES ('01900000-0000-7000-8000-000000000000', 0, 'weekly', 'body')";
    execute(database, &url, left).await;
    let weekly = NewBatch { idempotency: Some(("weekly".into(), "body".into())), ..batch };
    let submitted = place.store.submit_batch(weekly).await.unwrap();
    assert!(matches!(submitted, SubmittedBatch::Accepted(_)), "{submitted:?}");
    place.store.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_key_does_not_outlive_its_batch_on_sqlite() {
    a_key_does_not_outlive_its_batch(Database::Sqlite).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_key_does_not_outlive_its_batch_on_postgres() {
    a_key_does_not_outlive_its_batch(Database::Postgres).await;
}
