//! Reads: jobs, lists, attempts and counts.

use super::codec::{Value, enum_from_sql, enum_to_sql, values};
use super::error::SqlError;
use super::order::set_positions;
use super::record::{Record, optional_enum, select_jobs, to_record};
use super::store::Store;
use super::tx::Tx;
use crate::generate::Backend;
use crate::jobs::{Attempt, Counts, Job, JobId, ListFilter, Page, StoreError};
use jiff::Timestamp;
use std::time::Duration;

/// Maximum number of jobs on a page.
const PAGE: u32 = 1000;
/// The backends that a request may ask for. Each has a lane of the queue.
const LANES: [Backend; 4] = [Backend::Auto, Backend::Gpu, Backend::Cpu, Backend::CpuSingle];

/// Calls that read jobs and counts.
impl Store {
    /// A job by id.
    pub async fn get(&self, id: JobId) -> Result<Option<Job>, StoreError> {
        Ok(job(&mut self.read("get").await?, id).await?)
    }

    /// A page of jobs, newest first.
    pub async fn list(&self, filter: &ListFilter) -> Result<Page, StoreError> {
        let tx = &mut self.read("list").await?;
        let limit = filter.limit.clamp(1, PAGE);
        let mut values = Vec::new();
        let matching = matching(tx, filter, &mut values);
        // One more than requested shows whether there is a next page.
        let sql = format!("{}{matching} LIMIT {}", select_jobs(tx), limit + 1);
        let rows = tx.all(sql, values).await?;
        let mut records = rows.iter().map(to_record).collect::<Result<Vec<_>, _>>()?;
        let more = records.len() > limit as usize;
        records.truncate(limit as usize);
        set_positions(tx, &mut records).await?;
        let jobs: Vec<Job> = records.into_iter().map(|record| record.job).collect();
        let next = if more { jobs.last().map(|job| job.id) } else { None };
        Ok(Page { jobs, next })
    }

    /// The attempts of a job, oldest first; empty if the job does not exist.
    pub async fn attempts(&self, id: JobId) -> Result<Vec<Attempt>, StoreError> {
        Ok(attempts(&mut self.read("attempts").await?, id).await?)
    }

    /// Jobs that ended before a time, in the order of their ends; at most `limit`.
    pub async fn ended(&self, before: Timestamp, limit: u32) -> Result<Vec<JobId>, StoreError> {
        let tx = &mut self.read("ended").await?;
        let sql = format!(
            "SELECT id FROM jobs{} WHERE finished_at < $1 ORDER BY finished_at, id LIMIT {limit}",
            tx.either(" INDEXED BY jobs_by_end", ""),
        );
        tx.all(sql, values![before]).await?.iter().map(|row| Ok(JobId(row.id("id")?))).collect()
    }

    /// Bytes of all files that jobs name; a file of several jobs counts once.
    pub async fn stored_bytes(&self) -> Result<u64, StoreError> {
        let tx = &mut self.read("stored_bytes").await?;
        let sql = format!(
            "SELECT CAST(COALESCE(SUM(bytes), 0) AS BIGINT) AS n \
             FROM (SELECT MAX(bytes) AS bytes FROM files{} GROUP BY key, start) AS kept",
            tx.either(" INDEXED BY files_by_key", ""),
        );
        Ok(tx.one(sql, values![]).await?.count("n")?)
    }

    /// Numbers of all jobs by status, in one query, so the result is consistent. The cost does not
    /// depend on the numbers.
    pub async fn counts(&self) -> Result<Counts, StoreError> {
        let tx = &mut self.read("counts").await?;
        // Triggers count queued and ended jobs; there are no more running jobs than workers.
        let sql = "SELECT 'queued' AS status, CAST(COALESCE(SUM(jobs), 0) AS BIGINT) AS n FROM queue_length \
                   UNION ALL SELECT 'running', COUNT(*) FROM jobs WHERE status = 'running' \
                   UNION ALL SELECT status, CAST(SUM(jobs) AS BIGINT) FROM ended_jobs GROUP BY status";
        let mut counts = Counts::default();
        for row in tx.all(sql, values![]).await? {
            *counts.of_mut(enum_from_sql(row.get("status")?)?) = row.count("n")?;
        }
        Ok(counts)
    }

    /// Numbers of queued jobs by requested backend. The cost does not depend on the numbers.
    pub async fn queued_by_backend(&self) -> Result<[(Backend, u64); 4], StoreError> {
        let tx = &mut self.read("queued_by_backend").await?;
        let sql = "SELECT backend, CAST(SUM(jobs) AS BIGINT) AS n FROM queue_length GROUP BY backend";
        let mut queued = LANES.map(|backend| (backend, 0));
        for row in tx.all(sql, values![]).await? {
            let name: &str = row.get("backend")?;
            // A later version may know further backends.
            if let Some((_, jobs)) = queued.iter_mut().find(|(backend, _)| backend.name() == name) {
                *jobs = row.count("n")?;
            }
        }
        Ok(queued)
    }

    /// Age of the oldest claimable job by requested backend; zero if there is none.
    ///
    /// The jobs of a submitter have turns in the order of their age, except fits that made room for
    /// others. The query steps through the first jobs of all submitters, so its cost does not depend
    /// on the number of jobs.
    pub async fn queue_ages(&self) -> Result<[(Backend, Duration); 4], StoreError> {
        let tx = &mut self.read("queue_ages").await?;
        let now = tx.now().await?;
        let index = tx.either(" INDEXED BY jobs_queue_by_submitter", "");
        let first = |condition: &str, order: &str| {
            format!(
                "(SELECT n.id FROM jobs n{index} WHERE n.status = 'queued' AND NOT n.shares{condition} \
                 ORDER BY {order}n.turn LIMIT 1)"
            )
        };
        let sql = format!(
            "WITH RECURSIVE heads (id) AS (SELECT {} UNION ALL SELECT COALESCE({}, {}, {}) \
             FROM heads JOIN jobs h ON h.id = heads.id) \
             SELECT backend_requested AS backend, MIN(created_at) AS since FROM heads JOIN jobs ON jobs.id = heads.id \
             GROUP BY backend_requested",
            first("", "n.lane, n.rank, n.submitter, "),
            first(" AND n.lane = h.lane AND n.rank = h.rank AND n.submitter > h.submitter", "n.submitter, "),
            first(" AND n.lane = h.lane AND n.rank > h.rank", "n.rank, n.submitter, "),
            first(" AND n.lane > h.lane", "n.lane, n.rank, n.submitter, "),
        );
        let mut ages = LANES.map(|backend| (backend, Duration::ZERO));
        for row in tx.all(sql, values![]).await? {
            let name: &str = row.get("backend")?;
            // A later version may know further backends.
            if let Some((_, age)) = ages.iter_mut().find(|(backend, _)| backend.name() == name) {
                let since = row.optional_time("since")?.unwrap_or(now);
                // Zero if the clock was set back after the submission.
                *age = Duration::try_from(now.duration_since(since)).unwrap_or_default();
            }
        }
        Ok(ages)
    }
}

async fn record(tx: &mut Tx<'_>, id: JobId) -> Result<Option<Record>, SqlError> {
    let sql = format!("{}FROM jobs j WHERE j.id = $1", select_jobs(tx));
    let row = tx.optional(sql, values![id]).await?;
    let mut record = row.as_ref().map(to_record).transpose()?;
    set_positions(tx, record.as_mut_slice()).await?;
    Ok(record)
}

pub(super) async fn job(tx: &mut Tx<'_>, id: JobId) -> Result<Option<Job>, SqlError> {
    Ok(record(tx, id).await?.map(|record| record.job))
}

/// The record of a job that this transaction has read or written.
pub(super) async fn known_record(tx: &mut Tx<'_>, id: JobId) -> Result<Record, SqlError> {
    record(tx, id).await?.ok_or_else(|| SqlError::Inconsistent(format!("job {id}")))
}

/// A job that this transaction has read or written.
pub(super) async fn known_job(tx: &mut Tx<'_>, id: JobId) -> Result<Job, SqlError> {
    Ok(known_record(tx, id).await?.job)
}

/// The clauses from FROM to ORDER BY that select the jobs `j` of a filter, newest first. Adds their
/// values to `values`.
pub(super) fn matching(tx: &Tx<'_>, filter: &ListFilter, values: &mut Vec<Value>) -> String {
    let mut sql = String::new();
    let mut next = |value: Value| {
        values.push(value);
        format!("${}", values.len())
    };
    // With a label, the query follows the index of labels in order of age (CROSS JOIN forces SQLite
    // to); otherwise the table of jobs.
    match filter.labels.first() {
        None => sql += "FROM jobs j WHERE TRUE",
        Some((name, value)) => {
            sql += tx.either(
                "FROM labels a CROSS JOIN jobs j ON j.id = a.job_id",
                "FROM labels a JOIN jobs j ON j.id = a.job_id",
            );
            sql += &format!(" WHERE a.name = {}", next(name.into()));
            sql += &format!(" AND a.value = {}", next(value.into()));
        }
    }
    let id = if filter.labels.is_empty() { "j.id" } else { "a.job_id" };
    // In the text, so that the partial index of fits applies.
    sql += &format!(" AND j.kind = '{}'", enum_to_sql(filter.kind));
    if let Some(owner) = &filter.owner {
        // The second condition makes the partial indexes apply.
        sql += &format!(" AND j.submitter = {} AND j.submitter <> ''", next(owner.into()));
    }
    if let Some(status) = filter.status {
        // In the text instead of a parameter, because the best index depends on the number of jobs
        // with this status.
        sql += &format!(" AND j.status = '{}'", enum_to_sql(status));
    }
    if let Some(preset) = &filter.preset {
        sql += &format!(" AND j.preset = {}", next(preset.into()));
    }
    for (name, value) in filter.labels.iter().skip(1) {
        sql += " AND EXISTS (SELECT 1 FROM labels l WHERE l.job_id = j.id";
        sql += &format!(" AND l.name = {}", next(name.into()));
        sql += &format!(" AND l.value = {})", next(value.into()));
    }
    if !filter.ids.is_empty() {
        let ids = next(Value::Texts(filter.ids.iter().map(ToString::to_string).collect()));
        sql += &format!(" AND {id} {}{ids}))", tx.either("IN (SELECT value FROM json_each(", "= ANY (("));
    }
    if let Some(batch) = filter.batch {
        sql += &format!(" AND j.batch = {}", next(batch.to_string().into()));
    }
    // Ids are in order of time, so their index leads to the first possible match.
    if let Some(after) = filter.created_after {
        sql += &format!(" AND {id} >= {}", next(JobId::least_at(after).into()));
        sql += &format!(" AND j.created_at >= {}", next(after.into()));
    }
    if let Some(before) = filter.created_before {
        sql += &format!(" AND {id} < {}", next(JobId::least_after(before).into()));
        sql += &format!(" AND j.created_at < {}", next(before.into()));
    }
    if let Some(before) = filter.before {
        sql += &format!(" AND {id} < {}", next(before.into()));
    }
    sql += &format!(" ORDER BY {id} DESC");
    sql
}

pub(super) async fn attempts(tx: &mut Tx<'_>, id: JobId) -> Result<Vec<Attempt>, SqlError> {
    let rows = tx.all("SELECT * FROM attempts WHERE job_id = $1 ORDER BY attempt", values![id]).await?;
    rows.iter()
        .map(|row| {
            Ok(Attempt {
                attempt: row.count("attempt")?,
                worker: row.get("worker")?,
                started_at: row.time("started_at")?,
                ended_at: row.optional_time("ended_at")?,
                outcome: optional_enum(row, "outcome")?,
                detail: row.get("detail")?,
            })
        })
        .collect()
}
