//! Records of a later version, which this version reads as far as possible, so that a downgrade
//! works.

use crate::cluster::Cluster;
use crate::scripted::{Database, Place};
use crate::suite::{LEASE, finished, new_job};
use oviduct::clock::Clock;
use oviduct::generate::Output;
use oviduct::jobs::state::AttemptEnd;
use oviduct::jobs::{ClaimScope, Counts, ListFilter, Status, StoreOptions};
use std::time::Duration;

/// Executes SQL on a database as another program would.
pub async fn execute(database: Database, url: &str, sql: &str) {
    match database {
        Database::Sqlite => {
            let pool = sqlx::SqlitePool::connect(url).await.unwrap();
            sqlx::raw_sql(sqlx::AssertSqlSafe(sql.to_owned())).execute(&pool).await.unwrap();
            pool.close().await;
        }
        Database::Postgres => {
            let (url, sql) = (url.to_owned(), sql.to_owned());
            tokio::task::spawn_blocking(move || Cluster::shared().psql(&url, &sql)).await.unwrap();
        }
    }
}

async fn records_of_a_later_version_block_no_others(database: Database) {
    let dir = tempfile::tempdir().unwrap();
    let url = database.url(dir.path()).await;
    let clock = Clock::manual("2026-01-02T03:04:05Z".parse().unwrap());
    let options = StoreOptions { clock: clock.clone(), ..StoreOptions::default() };
    let place = Place::with(dir.path(), &url, options).await;
    let store = &place.store;
    let submit = async |digest: &str| store.submit(new_job(digest)).await.unwrap().job().id;
    let claim = async |limit| store.claim("w", ClaimScope::Cpu, LEASE, limit).await.unwrap();

    // The worker of the first job has vanished. This version cannot read the next three jobs, each
    // for a different reason.
    let expired = submit("expired").await;
    claim(1).await;
    let outputs = [submit("all new").await, submit("partly new").await];
    let spec = submit("no spec").await;
    let progress = submit("progress").await;
    let last = submit("last").await;
    let change = format!(
        "UPDATE jobs SET outputs = '[\"step\"]' WHERE id = '{}'; \
         UPDATE jobs SET outputs = '[\"glb\", \"step\"]' WHERE id = '{}'; \
         UPDATE jobs SET spec = CAST('as it likes' AS {}) WHERE id = '{spec}'; \
         UPDATE jobs SET progress = '{{\"stage\": \"polish\"}}', section = '[]', summary = 'x', problem = '7', \
         backend_used = 'tpu', rank = 0 WHERE id = '{progress}'; \
         INSERT INTO workers (id, host, backend, device, jobs_done, heartbeat_at) \
         VALUES ('far', 'far', 'tpu', 'a TPU', 0, {})",
        outputs[0],
        outputs[1],
        if database == Database::Sqlite { "BLOB" } else { "TEXT" },
        clock.now().as_microsecond(),
    );
    execute(database, &url, &change).await;
    clock.advance(LEASE);

    // Lists and reads show the parts of these records that this version understands.
    let page = store.list(&ListFilter { limit: 10, ..ListFilter::default() }).await.unwrap();
    assert_eq!(page.jobs.len(), 6);
    assert_eq!(store.get(outputs[0]).await.unwrap().unwrap().outputs.formats, []);
    assert_eq!(store.get(outputs[1]).await.unwrap().unwrap().outputs.formats, [Output::Glb]);
    let shown = store.get(progress).await.unwrap().unwrap();
    assert_eq!((shown.progress, shown.section, shown.problem, shown.backend.used), (None, None, None, None));
    assert_eq!(store.workers().await.unwrap(), []);

    // The job of the vanished worker comes first. A claim of several jobs skips the jobs that fail.
    let first = claim(1).await.pop().unwrap();
    assert_eq!((first.job().id, first.attempt()), (expired, 2));
    let mut claimed = claim(2).await;
    let ids: Vec<_> = claimed.iter().map(|claimed| claimed.job().id).collect();
    assert_eq!(ids, [progress, last]);
    for id in [outputs[0], outputs[1], spec] {
        let job = store.get(id).await.unwrap().unwrap();
        let problem = job.problem.unwrap();
        assert_eq!((job.status, problem.kind.as_str()), (Status::Failed, "spec"));
        let named = if id == spec { "spec: " } else { "outputs: unknown variant `step`" };
        assert!(problem.detail.contains(named), "{}", problem.detail);
        let attempts = store.attempts(id).await.unwrap();
        assert_eq!((attempts.len(), attempts[0].outcome), (1, Some(AttemptEnd::Failed)));
    }
    let done = claimed.pop().unwrap();
    let files = finished(&done);
    assert_eq!(store.finish(done, files).await.unwrap(), Status::Succeeded);
    let counts = store.counts().await.unwrap();
    assert_eq!(counts, Counts { running: 2, succeeded: 1, failed: 3, ..Counts::default() });

    // An unreadable job fails even if no other job is queued and the leases have expired.
    let alone = submit("alone").await;
    execute(database, &url, &format!("UPDATE jobs SET outputs = '[\"step\"]' WHERE id = '{alone}'")).await;
    clock.advance(LEASE + Duration::from_secs(1));
    let again = claim(9).await;
    assert_eq!(again.len(), 2, "jobs with expired leases are claimed");
    assert_eq!(store.get(alone).await.unwrap().unwrap().status, Status::Failed);
    store.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn records_of_a_later_version_block_no_others_on_sqlite() {
    records_of_a_later_version_block_no_others(Database::Sqlite).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn records_of_a_later_version_block_no_others_on_postgres() {
    records_of_a_later_version_block_no_others(Database::Postgres).await;
}
