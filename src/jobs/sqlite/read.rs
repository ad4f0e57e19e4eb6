//! Reading records: rows to jobs, attempts and workers.

use super::{micros, timestamp};
use crate::jobs::job::{BackendReport, BatchId, Job, JobId, Status};
use crate::jobs::store::{Attempt, Counts, ListFilter, Page, StoreError, WorkerInfo};
use jiff::Timestamp;
use serde::de::DeserializeOwned;
use sqlx::sqlite::SqliteRow;
use sqlx::{QueryBuilder, Row, Sqlite, SqliteConnection};

/// Most jobs on a page.
const PAGE: u32 = 1000;

/// Everything of a job in one row; `j` is the job.
macro_rules! select_jobs {
    ($from:literal) => {
        concat!(
            "SELECT j.*, ",
            "(SELECT json_group_array(json_object('name', f.name, 'media_type', f.media_type, 'bytes', f.bytes, ",
            "'sha256', f.sha256, 'key', f.key)) FROM (SELECT * FROM files WHERE job_id = j.id ORDER BY ordinal) f) ",
            "AS files, ",
            "(SELECT json_group_object(l.name, l.value) FROM labels l WHERE l.job_id = j.id) AS labels ",
            $from
        )
    };
}

fn broken(error: &dyn std::error::Error) -> StoreError {
    StoreError::Database(format!("a broken record: {error}"))
}

pub(super) fn parse<T: DeserializeOwned>(text: &str) -> Result<T, StoreError> {
    serde_json::from_str(text).map_err(|error| broken(&error))
}

fn parse_column<T: DeserializeOwned>(row: &SqliteRow, column: &str) -> Result<T, StoreError> {
    parse(row.try_get::<&str, _>(column)?)
}

fn parse_optional<T: DeserializeOwned>(row: &SqliteRow, column: &str) -> Result<Option<T>, StoreError> {
    row.try_get::<Option<&str>, _>(column)?.map(parse).transpose()
}

/// A unit variant, stored as the string that serde names it by.
pub(super) fn variant<T: DeserializeOwned>(word: &str) -> Result<T, StoreError> {
    serde_json::from_value(serde_json::Value::String(word.to_owned())).map_err(|error| broken(&error))
}

fn optional_variant<T: DeserializeOwned>(row: &SqliteRow, column: &str) -> Result<Option<T>, StoreError> {
    row.try_get::<Option<&str>, _>(column)?.map(variant).transpose()
}

pub(super) fn id(text: &str) -> Result<JobId, StoreError> {
    text.parse().map(JobId).map_err(|error: uuid::Error| broken(&error))
}

pub(super) fn count(row: &SqliteRow, column: &str) -> Result<u64, StoreError> {
    u64::try_from(row.try_get::<i64, _>(column)?).map_err(|error| broken(&error))
}

fn time(row: &SqliteRow, column: &str) -> Result<Option<Timestamp>, StoreError> {
    row.try_get::<Option<i64>, _>(column)?.map(timestamp).transpose()
}

/// All of a job but its position in the queue.
fn to_job(row: &SqliteRow) -> Result<Job, StoreError> {
    Ok(Job {
        id: id(row.try_get("id")?)?,
        status: variant(row.try_get("status")?)?,
        version: count(row, "version")?,
        preset: row.try_get("preset")?,
        seed: count(row, "seed")?,
        spec: parse_column(row, "spec")?,
        outputs: parse_column(row, "outputs")?,
        labels: parse_column(row, "labels")?,
        backend: BackendReport {
            requested: variant(row.try_get("backend_requested")?)?,
            used: optional_variant(row, "backend_used")?,
            device: row.try_get("device")?,
            fallback: row.try_get("fallback")?,
        },
        queue_position: None,
        progress: parse_optional(row, "progress")?,
        section: parse_optional(row, "section")?,
        attempts: row.try_get("attempts")?,
        cancel_requested: row.try_get("cancel_requested")?,
        created_at: timestamp(row.try_get("created_at")?)?,
        started_at: time(row, "started_at")?,
        finished_at: time(row, "finished_at")?,
        files: parse_column(row, "files")?,
        summary: parse_optional(row, "summary")?,
        problem: parse_optional(row, "problem")?,
        digest: row.try_get("digest")?,
        engine: row.try_get("engine")?,
        batch: row.try_get::<Option<&str>, _>("batch")?.map(id).transpose()?.map(|JobId(id)| BatchId(id)),
        checkpoint: row.try_get("checkpoint")?,
        reused_from: row.try_get::<Option<&str>, _>("reused_from")?.map(id).transpose()?,
    })
}

pub(super) async fn job(connection: &mut SqliteConnection, id: JobId) -> Result<Option<Job>, StoreError> {
    let row = sqlx::query(select_jobs!("FROM jobs j WHERE j.id = ?"))
        .bind(id.to_string())
        .fetch_optional(&mut *connection)
        .await?;
    let mut job = row.as_ref().map(to_job).transpose()?;
    set_positions(connection, job.as_mut_slice()).await?;
    Ok(job)
}

/// Sets the position in the queue of those that wait: each is counted on from the next older one, so a page costs
/// one pass over the index of the queue.
async fn set_positions(connection: &mut SqliteConnection, jobs: &mut [Job]) -> Result<(), StoreError> {
    let mut queued: Vec<&mut Job> = jobs.iter_mut().filter(|job| job.status == Status::Queued).collect();
    queued.sort_unstable_by_key(|job| job.id);
    let (mut before, mut from) = (0, String::new());
    for job in queued {
        let id = job.id.to_string();
        let row = sqlx::query(
            "SELECT COUNT(*) AS n FROM jobs INDEXED BY jobs_position WHERE status = 'queued' AND id >= ? AND id < ?",
        )
        .bind(from)
        .bind(&id)
        .fetch_one(&mut *connection)
        .await?;
        before += count(&row, "n")?;
        job.queue_position = Some(before);
        from = id;
    }
    Ok(())
}

/// A job that this transaction has just read or written.
pub(super) async fn known_job(connection: &mut SqliteConnection, id: JobId) -> Result<Job, StoreError> {
    job(connection, id).await?.ok_or_else(|| StoreError::Database(format!("job {id} is gone within a transaction")))
}

pub(super) async fn list(connection: &mut SqliteConnection, filter: &ListFilter) -> Result<Page, StoreError> {
    let limit = filter.limit.clamp(1, PAGE);
    // A label leads where there is one, in order of age (CROSS JOIN keeps SQLite to that); else the jobs themselves.
    let mut query = match filter.labels.first() {
        None => QueryBuilder::<Sqlite>::new(select_jobs!("FROM jobs j WHERE TRUE")),
        Some((name, value)) => {
            let mut query =
                QueryBuilder::new(select_jobs!("FROM labels a CROSS JOIN jobs j ON j.id = a.job_id WHERE a.name = "));
            query.push_bind(name.clone()).push(" AND a.value = ").push_bind(value.clone());
            query
        }
    };
    let id = if filter.labels.is_empty() { "j.id" } else { "a.job_id" };
    if let Some(status) = filter.status {
        query.push(" AND j.status = ").push_bind(super::word(status));
    }
    if let Some(preset) = &filter.preset {
        query.push(" AND j.preset = ").push_bind(preset.clone());
    }
    for (name, value) in filter.labels.iter().skip(1) {
        query.push(" AND EXISTS (SELECT 1 FROM labels l WHERE l.job_id = j.id AND l.name = ");
        query.push_bind(name.clone()).push(" AND l.value = ").push_bind(value.clone()).push(")");
    }
    if let Some(before) = filter.before {
        query.push(" AND ").push(id).push(" < ").push_bind(before.to_string());
    }
    // One more than asked for tells whether there is a next page.
    query.push(" ORDER BY ").push(id).push(" DESC LIMIT ").push_bind(i64::from(limit) + 1);
    let rows = query.build().fetch_all(&mut *connection).await?;
    let mut jobs = rows.iter().map(to_job).collect::<Result<Vec<_>, _>>()?;
    let more = jobs.len() > limit as usize;
    jobs.truncate(limit as usize);
    set_positions(connection, &mut jobs).await?;
    let next = if more { jobs.last().map(|job| job.id) } else { None };
    Ok(Page { jobs, next })
}

pub(super) async fn attempts(connection: &mut SqliteConnection, id: JobId) -> Result<Vec<Attempt>, StoreError> {
    let rows = sqlx::query("SELECT * FROM attempts WHERE job_id = ? ORDER BY attempt")
        .bind(id.to_string())
        .fetch_all(connection)
        .await?;
    rows.iter()
        .map(|row| {
            Ok(Attempt {
                attempt: row.try_get("attempt")?,
                worker: row.try_get("worker")?,
                started_at: timestamp(row.try_get("started_at")?)?,
                ended_at: time(row, "ended_at")?,
                outcome: optional_variant(row, "outcome")?,
                detail: row.try_get("detail")?,
            })
        })
        .collect()
}

pub(super) async fn workers(
    connection: &mut SqliteConnection,
    since: Timestamp,
) -> Result<Vec<WorkerInfo>, StoreError> {
    let rows = sqlx::query("SELECT * FROM workers WHERE heartbeat_at >= ? ORDER BY id")
        .bind(micros(since))
        .fetch_all(connection)
        .await?;
    rows.iter()
        .map(|row| {
            Ok(WorkerInfo {
                id: row.try_get("id")?,
                host: row.try_get("host")?,
                backend: variant(row.try_get("backend")?)?,
                device: row.try_get("device")?,
                job: row.try_get::<Option<&str>, _>("job")?.map(id).transpose()?,
                jobs_done: count(row, "jobs_done")?,
                heartbeat_at: timestamp(row.try_get("heartbeat_at")?)?,
            })
        })
        .collect()
}

pub(super) async fn names_key(connection: &mut SqliteConnection, key: &str) -> Result<bool, StoreError> {
    Ok(sqlx::query_scalar(
        "SELECT EXISTS (SELECT 1 FROM files WHERE key = ?1) OR EXISTS (SELECT 1 FROM jobs WHERE checkpoint = ?1)",
    )
    .bind(key)
    .fetch_one(connection)
    .await?)
}

pub(super) async fn ended_before(
    connection: &mut SqliteConnection,
    before: Timestamp,
    limit: u32,
) -> Result<Vec<JobId>, StoreError> {
    let ids: Vec<String> = sqlx::query_scalar(
        "SELECT id FROM jobs INDEXED BY jobs_by_end WHERE finished_at < ? ORDER BY finished_at, id LIMIT ?",
    )
    .bind(micros(before))
    .bind(limit)
    .fetch_all(connection)
    .await?;
    ids.iter().map(|text| id(text)).collect()
}

pub(super) async fn stored_bytes(connection: &mut SqliteConnection) -> Result<u64, StoreError> {
    let row = sqlx::query(
        "SELECT COALESCE(SUM(bytes), 0) AS n FROM (SELECT MAX(bytes) AS bytes FROM files INDEXED BY files_by_key GROUP BY key)",
    )
    .fetch_one(connection)
    .await?;
    count(&row, "n")
}

pub(super) async fn counts(connection: &mut SqliteConnection) -> Result<Counts, StoreError> {
    let rows = sqlx::query("SELECT status, COUNT(*) AS n FROM jobs INDEXED BY jobs_by_status GROUP BY status")
        .fetch_all(connection)
        .await?;
    let mut counts = Counts::default();
    for row in &rows {
        *counts.of_mut(variant(row.try_get("status")?)?) = count(row, "n")?;
    }
    Ok(counts)
}
