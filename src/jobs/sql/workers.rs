//! Heartbeats of workers, and the list of workers.

use super::codec::{enum_from_sql, enum_to_sql, values};
use super::error::SqlError;
use super::operation::{Done, Operation};
use super::store::Store;
use super::tx::{Row, Tx};
use crate::jobs::{JobId, Pause, StoreError, StoreOptions, WorkerInfo, WorkerKind};
use jiff::Timestamp;
use std::collections::BTreeMap;
use std::time::Duration;

/// Age of the last heartbeat up to which a worker is listed.
const LISTED_FOR: Duration = Duration::from_secs(5 * 60);
/// Scope of the pause of all workers. No worker has this name, because names begin with a host
/// name.
pub(super) const ALL: &str = "*";
/// Age of the last heartbeat after which the row of a worker is deleted.
const KEPT_FOR: Duration = Duration::from_secs(24 * 60 * 60);

/// Calls for the list of workers. `within` is the maximum age of their last heartbeat, by the clock
/// of the store.
impl Store {
    /// Records the heartbeat of a worker.
    pub async fn worker_seen(&self, worker: &WorkerInfo) -> Result<(), StoreError> {
        self.change("worker_seen", WorkerSeen(worker.clone())).await
    }

    /// Workers with a heartbeat in the last five minutes, with the jobs that they hold, and their
    /// pauses.
    pub async fn workers(&self) -> Result<Vec<WorkerInfo>, StoreError> {
        self.workers_within(LISTED_FOR).await
    }

    /// Workers with a heartbeat `within` this time.
    pub async fn workers_within(&self, within: Duration) -> Result<Vec<WorkerInfo>, StoreError> {
        Ok(workers(&mut self.read("workers_within").await?, within).await?)
    }

    /// Number of workers of this kind with a heartbeat `within` this time.
    pub async fn count_live_workers(&self, kind: WorkerKind, within: Duration) -> Result<u64, StoreError> {
        let tx = &mut self.read("count_live_workers").await?;
        let since = since(tx, within).await?;
        let sql = "SELECT COUNT(*) AS n FROM workers WHERE backend = $1 AND heartbeat_at >= $2";
        Ok(tx.one(sql, values![enum_to_sql(kind), since]).await?.count("n")?)
    }

    /// Number of workers of this kind with a heartbeat `within` this time that are neither paused
    /// nor drained individually. Ignores a pause of all workers.
    pub async fn count_unpaused_workers(&self, kind: WorkerKind, within: Duration) -> Result<u64, StoreError> {
        let tx = &mut self.read("count_unpaused_workers").await?;
        let since = since(tx, within).await?;
        let sql = "SELECT COUNT(*) AS n FROM workers WHERE backend = $1 AND heartbeat_at >= $2 \
                   AND id NOT IN (SELECT scope FROM claiming)";
        Ok(tx.one(sql, values![enum_to_sql(kind), since]).await?.count("n")?)
    }
}

/// Records a heartbeat at the present time of the store.
struct WorkerSeen(WorkerInfo);

impl Operation for WorkerSeen {
    type Output = ();

    async fn run(&self, tx: &mut Tx<'_>, _: &StoreOptions) -> Result<Done<()>, SqlError> {
        let now = tx.now().await?;
        let worker = &self.0;
        tx.execute(
            "INSERT INTO workers (id, host, backend, device, jobs_done, heartbeat_at) VALUES ($1, $2, $3, $4, $5, $6) \
             ON CONFLICT (id) DO UPDATE SET host = $2, backend = $3, device = $4, jobs_done = $5, heartbeat_at = $6",
            values![&worker.id, &worker.host, enum_to_sql(worker.kind), &worker.device, worker.jobs_done, now,],
        )
        .await?;
        let old = now.saturating_sub(KEPT_FOR).unwrap_or(Timestamp::MIN);
        if tx.execute("DELETE FROM workers WHERE heartbeat_at < $1", values![old]).await? > 0 {
            let sql = "DELETE FROM claiming WHERE scope <> $1 AND scope NOT IN (SELECT id FROM workers)";
            tx.execute(sql, values![ALL]).await?;
        }
        Ok(Done::quiet(()))
    }
}

/// The earliest time of a heartbeat `within` this time.
async fn since(tx: &mut Tx<'_>, within: Duration) -> Result<Timestamp, SqlError> {
    Ok(tx.now().await?.saturating_sub(within).unwrap_or(Timestamp::MIN))
}

async fn workers(tx: &mut Tx<'_>, within: Duration) -> Result<Vec<WorkerInfo>, SqlError> {
    let since = since(tx, within).await?;
    let sql = "SELECT w.*, c.drain, c.since, c.set_by FROM workers w LEFT JOIN claiming c ON c.scope = w.id \
               WHERE w.heartbeat_at >= $1 ORDER BY w.id";
    let rows = tx.all(sql, values![since]).await?;
    let mut held: BTreeMap<String, Vec<JobId>> = BTreeMap::new();
    for row in tx.all("SELECT holder, id FROM jobs WHERE status = 'running' ORDER BY id", values![]).await? {
        held.entry(row.text("holder")?.to_owned()).or_default().push(row.id("id")?);
    }
    rows.iter()
        // A worker of a later version may be of a kind that this one does not know.
        .filter_map(|row| row.text("backend").map(enum_from_sql).ok()?.ok().map(|kind| (row, kind)))
        .map(|(row, kind)| {
            Ok(WorkerInfo {
                id: row.text("id")?.to_owned(),
                host: row.text("host")?.to_owned(),
                kind,
                device: row.text("device")?.to_owned(),
                jobs: held.remove(row.text("id")?).unwrap_or_default(),
                jobs_done: row.count("jobs_done")?,
                heartbeat_at: row.time("heartbeat_at")?,
                pause: to_pause(row)?,
            })
        })
        .collect()
}

/// The pause in the columns of a row of `claiming`; `None` if they are null.
pub(super) fn to_pause(row: &Row) -> Result<Option<Pause>, SqlError> {
    let Some(since) = row.optional_time("since")? else { return Ok(None) };
    let by = row.optional_text("set_by")?.map(str::to_owned);
    Ok(Some(Pause { drain: row.flag("drain")?, since, by }))
}

/// True if [`Store::workers`] lists the worker of this name.
pub(super) async fn is_listed(tx: &mut Tx<'_>, worker: &str) -> Result<bool, SqlError> {
    let since = since(tx, LISTED_FOR).await?;
    let sql = "SELECT id FROM workers WHERE id = $1 AND heartbeat_at >= $2";
    Ok(tx.optional(sql, values![worker, since]).await?.is_some())
}
