//! Heartbeats of workers, the list of workers, and pauses of all workers and of single ones.
//!
//! A row of `claiming` is a pause. Claims look for one in their own statements, so a pause costs
//! them nothing and holds once it is committed.

use super::codec::{enum_from_sql, enum_to_sql, values};
use super::error::SqlError;
use super::operation::{Done, Uncertain};
use super::record::optional_enum;
use super::store::Store;
use super::tx::{Row, Tx};
use crate::jobs::{Instruction, JobId, Pause, StoreError, WorkerCounts, WorkerInfo, WorkerKind, Workforce};
use jiff::Timestamp;
use std::collections::BTreeMap;
use std::time::Duration;

/// Age of the last heartbeat up to which a worker is listed.
const LISTED_FOR: Duration = Duration::from_secs(5 * 60);
/// Scope of the pause of all workers. No worker has this name, because names begin with a host
/// name.
const ALL: &str = "*";
/// Age of the last heartbeat after which the row of a worker is deleted.
const KEPT_FOR: Duration = Duration::from_secs(24 * 60 * 60);

/// Calls for the list of workers and for pauses. `within` is the maximum age of the last heartbeat
/// of a worker, by the clock of the store.
impl Store {
    /// Records the heartbeat of a worker.
    pub async fn worker_seen(&self, worker: &WorkerInfo) -> Result<(), StoreError> {
        self.apply("worker_seen", worker.clone(), |worker, tx, _| Box::pin(record(worker, tx)), Uncertain::RunsAgain)
            .await
    }

    /// Removes a worker that has stopped from the list of workers. A pause of its name stays.
    pub async fn worker_stopped(&self, worker: &str) -> Result<(), StoreError> {
        self.apply("worker_stopped", worker.to_owned(), |id, tx, _| Box::pin(stop(id, tx)), Uncertain::RunsAgain).await
    }

    /// Workers with a heartbeat in the last five minutes, with the jobs that they hold, and their
    /// pauses.
    pub async fn workers(&self) -> Result<Vec<WorkerInfo>, StoreError> {
        self.workers_within(LISTED_FOR).await
    }

    /// Workers with a heartbeat `within` this time.
    pub async fn workers_within(&self, within: Duration) -> Result<Vec<WorkerInfo>, StoreError> {
        let tx = &mut self.read("workers_within").await?;
        let since = since(tx, within).await?;
        let sql = "SELECT w.*, c.drain, c.since, c.set_by FROM workers w LEFT JOIN claiming c ON c.scope = w.id \
                   WHERE w.heartbeat_at >= $1 AND NOT w.stopped ORDER BY w.id";
        let rows = tx.all(sql, values![since]).await?;
        let mut held: BTreeMap<String, Vec<JobId>> = BTreeMap::new();
        for row in tx.all("SELECT holder, id FROM jobs WHERE status = 'running' ORDER BY id", values![]).await? {
            held.entry(row.get("holder")?).or_default().push(JobId(row.id("id")?));
        }
        rows.iter()
            // A worker of a later version may be of a kind that this one does not know.
            .filter_map(|row| Some((row, enum_from_sql(row.get("backend").ok()?).ok()?)))
            .map(|(row, kind)| {
                Ok(WorkerInfo {
                    id: row.get("id")?,
                    host: row.get("host")?,
                    kind,
                    device: row.get("device")?,
                    jobs: held.remove(row.get::<&str>("id")?).unwrap_or_default(),
                    jobs_done: row.count("jobs_done")?,
                    heartbeat_at: row.time("heartbeat_at")?,
                    pause: to_pause(row)?,
                    condition: optional_enum(row, "condition")?,
                })
            })
            .collect()
    }

    /// Number of workers of this kind with a heartbeat `within` this time.
    pub async fn count_live_workers(&self, kind: WorkerKind, within: Duration) -> Result<u64, StoreError> {
        let tx = &mut self.read("count_live_workers").await?;
        let since = since(tx, within).await?;
        let sql = "SELECT COUNT(*) AS n FROM workers WHERE backend = $1 AND heartbeat_at >= $2 AND NOT stopped";
        Ok(tx.one(sql, values![enum_to_sql(kind), since]).await?.count("n")?)
    }

    /// Number of workers of this kind with a heartbeat `within` this time that have no condition
    /// and are neither paused nor drained individually. Ignores a pause of all workers.
    pub async fn count_claiming_workers(&self, kind: WorkerKind, within: Duration) -> Result<u64, StoreError> {
        let tx = &mut self.read("count_claiming_workers").await?;
        let since = since(tx, within).await?;
        let sql = "SELECT COUNT(*) AS n FROM workers WHERE backend = $1 AND heartbeat_at >= $2 \
                   AND NOT stopped AND condition IS NULL AND id NOT IN (SELECT scope FROM claiming)";
        Ok(tx.one(sql, values![enum_to_sql(kind), since]).await?.count("n")?)
    }

    /// Numbers of workers with a heartbeat `within` this time.
    pub async fn workforce(&self, within: Duration) -> Result<Workforce, StoreError> {
        let tx = &mut self.read("workforce").await?;
        let since = since(tx, within).await?;
        let sql = format!(
            "SELECT backend, COUNT(*) AS live, COUNT(*) FILTER (WHERE NOT paused) AS unpaused, \
             COUNT(*) FILTER (WHERE NOT paused AND condition IS NULL) AS claiming FROM \
             (SELECT backend, condition, EXISTS (SELECT 1 FROM claiming c WHERE c.scope IN ('{ALL}', w.id)) AS paused \
             FROM workers w WHERE heartbeat_at >= $1 AND NOT stopped) AS listed GROUP BY backend"
        );
        let mut workforce = Workforce::default();
        for row in tx.all(sql, values![since]).await? {
            let counts = WorkerCounts {
                live: row.count("live")?,
                unpaused: row.count("unpaused")?,
                claiming: row.count("claiming")?,
            };
            // A worker of a later version may be of a kind that this one does not know.
            match enum_from_sql(row.get("backend")?) {
                Ok(WorkerKind::Cpu) => workforce.cpu = counts,
                Ok(WorkerKind::Gpu) => workforce.gpu = counts,
                Err(_) => {}
            }
        }
        Ok(workforce)
    }

    /// Pauses all workers, including workers that start later, or ends this pause; pauses of single
    /// workers stay. A pause holds for every claim that begins after this call returns. `by` is the
    /// person who requests it. No effect if the state is already the requested one.
    pub async fn set_paused(&self, paused: bool, by: Option<&str>) -> Result<(), StoreError> {
        let instruction = if paused { Instruction::Pause } else { Instruction::Resume };
        self.apply_instruction("set_paused", (None, instruction, by.map(str::to_owned))).await.map(drop)
    }

    /// The pause of all workers, if there is one.
    pub async fn paused(&self) -> Result<Option<Pause>, StoreError> {
        let tx = &mut self.read("paused").await?;
        let row = tx.optional("SELECT drain, since, set_by FROM claiming WHERE scope = $1", values![ALL]).await?;
        Ok(row.as_ref().map(to_pause).transpose()?.flatten())
    }

    /// Pauses, drains or resumes one worker, as [`Store::set_paused`] does all. A pause holds for
    /// the worker of this name until it is resumed, even after a restart under the same name.
    /// Returns false, and does nothing, if [`Store::workers`] does not list the worker.
    pub async fn instruct(&self, worker: &str, instruction: Instruction, by: Option<&str>) -> Result<bool, StoreError> {
        let worker = Some(worker.to_owned());
        self.apply_instruction("instruct", (worker, instruction, by.map(str::to_owned))).await
    }

    async fn apply_instruction(&self, call: &'static str, input: Instruct) -> Result<bool, StoreError> {
        self.apply(call, input, |input, tx, _| Box::pin(instruct(input, tx)), Uncertain::RunsAgain).await
    }
}

/// Records a heartbeat at the present time of the store.
async fn record(worker: &WorkerInfo, tx: &mut Tx<'_>) -> Result<Done<()>, SqlError> {
    let now = tx.now().await?;
    let sql = "INSERT INTO workers (id, host, backend, device, jobs_done, heartbeat_at, condition) \
               VALUES ($1, $2, $3, $4, $5, $6, $7) ON CONFLICT (id) DO UPDATE SET host = $2, \
               backend = $3, device = $4, jobs_done = $5, heartbeat_at = $6, condition = $7, stopped = FALSE";
    let WorkerInfo { id, host, kind, device, jobs_done, condition, .. } = worker;
    let condition = condition.map(enum_to_sql);
    tx.execute(sql, values![id, host, enum_to_sql(kind), device, *jobs_done, now, condition]).await?;
    let old = now.saturating_sub(KEPT_FOR).unwrap_or(Timestamp::MIN);
    if tx.execute("DELETE FROM workers WHERE heartbeat_at < $1", values![old]).await? > 0 {
        let sql = "DELETE FROM claiming WHERE scope <> $1 AND scope NOT IN (SELECT id FROM workers)";
        tx.execute(sql, values![ALL]).await?;
    }
    Ok(Done::quiet(()))
}

/// Marks a worker as stopped. Its row stays for as long as that of a killed worker, because a pause
/// of a name without a row is deleted.
async fn stop(id: &String, tx: &mut Tx<'_>) -> Result<Done<()>, SqlError> {
    tx.execute("UPDATE workers SET stopped = TRUE WHERE id = $1", values![id]).await?;
    Ok(Done::quiet(()))
}

/// The earliest time of a heartbeat `within` this time.
async fn since(tx: &mut Tx<'_>, within: Duration) -> Result<Timestamp, SqlError> {
    Ok(tx.now().await?.saturating_sub(within).unwrap_or(Timestamp::MIN))
}

/// The pause in the columns of a row of `claiming`; `None` if they are null.
fn to_pause(row: &Row) -> Result<Option<Pause>, SqlError> {
    let Some(since) = row.optional_time("since")? else { return Ok(None) };
    Ok(Some(Pause { drain: row.get("drain")?, since, by: row.get("set_by")? }))
}

/// True if [`Store::workers`] lists the worker of this name.
async fn is_listed(tx: &mut Tx<'_>, worker: &str) -> Result<bool, SqlError> {
    let since = since(tx, LISTED_FOR).await?;
    let sql = "SELECT id FROM workers WHERE id = $1 AND heartbeat_at >= $2 AND NOT stopped";
    Ok(tx.optional(sql, values![worker, since]).await?.is_some())
}

/// The worker, or `None` for all workers; the instruction; the person who gives it.
type Instruct = (Option<String>, Instruction, Option<String>);

/// SQL condition: neither all workers nor the worker named by this parameter are paused.
pub(super) fn unpaused(worker: &str) -> String {
    format!("(SELECT scope FROM claiming WHERE scope IN ('{ALL}', {worker}) LIMIT 1) IS NULL")
}

/// The same for all workers of an array, on PostgreSQL.
pub(super) fn all_unpaused(workers: &str) -> String {
    format!("(SELECT scope FROM claiming WHERE scope = '{ALL}' OR scope = ANY ({workers}) LIMIT 1) IS NULL")
}

/// Pauses, drains or resumes a worker, or all workers. Returns false if the worker is not listed.
async fn instruct((worker, instruction, by): &Instruct, tx: &mut Tx<'_>) -> Result<Done<bool>, SqlError> {
    if let Some(worker) = worker
        && !is_listed(tx, worker).await?
    {
        return Ok(Done::quiet(false));
    }
    let scope = worker.as_deref().unwrap_or(ALL);
    if *instruction == Instruction::Resume {
        tx.execute("DELETE FROM claiming WHERE scope = $1", values![scope]).await?;
    } else {
        let (drain, now) = (*instruction == Instruction::Drain, tx.now().await?);
        let sql = "INSERT INTO claiming (scope, drain, since, set_by) VALUES ($1, $2, $3, $4) \
                   ON CONFLICT (scope) DO UPDATE SET drain = $2, since = $3, set_by = $4 WHERE claiming.drain <> $2";
        tx.execute(sql, values![scope, drain, now, by]).await?;
    }
    Ok(Done::quiet(true))
}
