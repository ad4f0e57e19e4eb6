//! Heartbeats of workers.

use super::codec::{enum_from_sql, enum_to_sql, values};
use super::error::SqlError;
use super::operation::{Done, Operation};
use super::tx::Tx;
use crate::generate::Backend;
use crate::jobs::job::JobId;
use crate::jobs::store::{StoreOptions, WorkerInfo};
use jiff::Timestamp;
use std::collections::BTreeMap;
use std::time::Duration;

/// Workers seen within this time are listed.
const SEEN: Duration = Duration::from_secs(5 * 60);
/// Rows of workers not seen for this long are deleted.
const FORGET: Duration = Duration::from_secs(24 * 60 * 60);

/// Records a worker as seen now, by the store's clock.
#[derive(Debug)]
pub(super) struct WorkerSeen(pub(super) WorkerInfo);

impl Operation for WorkerSeen {
    type Output = ();

    async fn run(&self, tx: &mut Tx<'_>, _: &StoreOptions) -> Result<Done<()>, SqlError> {
        let now = tx.now().await?;
        let worker = &self.0;
        tx.execute(
            "INSERT INTO workers (id, host, backend, device, jobs_done, heartbeat_at) VALUES ($1, $2, $3, $4, $5, $6) \
             ON CONFLICT (id) DO UPDATE SET host = $2, backend = $3, device = $4, jobs_done = $5, heartbeat_at = $6",
            values![&worker.id, &worker.host, enum_to_sql(worker.backend), &worker.device, worker.jobs_done, now,],
        )
        .await?;
        let old = now.saturating_sub(FORGET).unwrap_or(Timestamp::MIN);
        tx.execute("DELETE FROM workers WHERE heartbeat_at < $1", values![old]).await?;
        Ok(Done::quiet(()))
    }
}

/// Workers seen within [`SEEN`], with the jobs whose leases they hold.
pub(super) async fn workers(tx: &mut Tx<'_>) -> Result<Vec<WorkerInfo>, SqlError> {
    let since = tx.now().await?.saturating_sub(SEEN).unwrap_or(Timestamp::MIN);
    let rows = tx.all("SELECT * FROM workers WHERE heartbeat_at >= $1 ORDER BY id", values![since]).await?;
    let mut held: BTreeMap<String, Vec<JobId>> = BTreeMap::new();
    for row in tx.all("SELECT holder, id FROM jobs WHERE status = 'running' ORDER BY id", values![]).await? {
        held.entry(row.text("holder")?.to_owned()).or_default().push(row.id("id")?);
    }
    rows.iter()
        // A worker of a later version may have a backend that this one does not know.
        .filter_map(|row| row.text("backend").map(enum_from_sql).ok()?.ok().map(|backend| (row, backend)))
        .map(|(row, backend)| {
            Ok(WorkerInfo {
                id: row.text("id")?.to_owned(),
                host: row.text("host")?.to_owned(),
                backend,
                device: row.text("device")?.to_owned(),
                jobs: held.remove(row.text("id")?).unwrap_or_default(),
                jobs_done: row.count("jobs_done")?,
                heartbeat_at: row.time("heartbeat_at")?,
            })
        })
        .collect()
}

/// How many workers that compute with `backend` were seen within this time.
pub(super) async fn alive(tx: &mut Tx<'_>, backend: Backend, within: Duration) -> Result<u64, SqlError> {
    let since = tx.now().await?.saturating_sub(within).unwrap_or(Timestamp::MIN);
    let sql = "SELECT COUNT(*) AS n FROM workers WHERE backend = $1 AND heartbeat_at >= $2";
    tx.one(sql, values![enum_to_sql(backend), since]).await?.count("n")
}
