//! Reading records: rows to jobs and attempts. What a later version wrote is shown as far as this one knows it.

use super::order::set_positions;
use super::{Link, Row, SqlError, parse, values, variant, word};
use crate::generate::{Backend, Output};
use crate::jobs::job::{BackendReport, BatchId, Job, JobId, Priority};
use crate::jobs::store::{Attempt, Counts, ListFilter, Page, StoreError};
use jiff::Timestamp;
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::time::Duration;

/// Most jobs on a page.
const PAGE: u32 = 1000;

/// Everything of a job in one row; `j` is the job.
pub(super) fn select_jobs(link: &Link<'_>) -> &'static str {
    link.either(
        "SELECT j.*, \
         (SELECT json_group_array(json_object('name', f.name, 'media_type', f.media_type, 'bytes', f.bytes, \
         'sha256', f.sha256, 'key', f.key)) FROM (SELECT * FROM files WHERE job_id = j.id ORDER BY ordinal) f) \
         AS files, \
         (SELECT json_group_object(l.name, l.value) FROM labels l WHERE l.job_id = j.id) AS labels ",
        "SELECT j.*, \
         (SELECT COALESCE(json_agg(json_build_object('name', f.name, 'media_type', f.media_type, 'bytes', f.bytes, \
         'sha256', f.sha256, 'key', f.key) ORDER BY f.ordinal), '[]')::text FROM files f WHERE f.job_id = j.id) \
         AS files, \
         (SELECT COALESCE(json_object_agg(l.name, l.value), '{}')::text FROM labels l WHERE l.job_id = j.id) AS labels ",
    )
}

/// A value that may be missing; one that only a later version can read is, too.
fn parse_optional<T: DeserializeOwned>(row: &Row, column: &str) -> Result<Option<T>, SqlError> {
    Ok(row.optional_text(column)?.and_then(|text| parse(text).ok()))
}

fn optional_variant<T: DeserializeOwned>(row: &Row, column: &str) -> Result<Option<T>, SqlError> {
    Ok(row.optional_text(column)?.and_then(|word| variant(word).ok()))
}

fn owned(row: &Row, column: &str) -> Result<Option<String>, SqlError> {
    Ok(row.optional_text(column)?.map(str::to_owned))
}

/// A priority; one beyond what this version knows is the nearest.
pub(super) fn priority(value: i64) -> Priority {
    Priority::try_from(value.clamp(Priority::MIN, Priority::MAX)).unwrap_or_default()
}

/// A job with its turn among those of the same backend and priority.
#[derive(Debug)]
pub(super) struct Record {
    pub(super) job: Job,
    pub(super) turn: i64,
    /// Why this version cannot run it, where it cannot: a later one may have written what it does not know.
    pub(super) unread: Option<String>,
}

/// What this version knows of the outputs asked for, and why that is not all.
fn outputs(text: &str) -> (Vec<Output>, Option<String>) {
    let words: Vec<Value> = match serde_json::from_str(text) {
        Ok(words) => words,
        Err(error) => return (Vec::new(), Some(format!("outputs: {error}"))),
    };
    let (mut known, mut unread) = (Vec::new(), None);
    for word in words {
        match serde_json::from_value(word) {
            Ok(output) => known.push(output),
            Err(error) => unread = Some(format!("outputs: {error}")),
        }
    }
    (known, unread)
}

/// All of a job but its position in the queue.
pub(super) fn to_record(row: &Row) -> Result<Record, SqlError> {
    let (outputs, mut unread) = outputs(row.text("outputs")?);
    let spec = serde_json::from_str(row.text("spec")?).unwrap_or_else(|error| {
        unread = Some(format!("spec: {error}"));
        Value::Null
    });
    let job = Job {
        id: row.id("id")?,
        status: variant(row.text("status")?)?,
        version: row.count("version")?,
        preset: row.text("preset")?.to_owned(),
        seed: row.count("seed")?,
        spec,
        outputs,
        labels: parse(row.text("labels")?)?,
        priority: priority(row.int("rank")?.saturating_neg()),
        trace: owned(row, "trace")?,
        backend: BackendReport {
            // One that this version does not know has a lane that it never claims from.
            requested: variant(row.text("backend_requested")?).unwrap_or(Backend::Auto),
            used: optional_variant(row, "backend_used")?,
            device: owned(row, "device")?,
            fallback: owned(row, "fallback")?,
        },
        queue_position: None,
        progress: parse_optional(row, "progress")?,
        section: parse_optional(row, "section")?,
        attempts: row.count("attempts")?,
        cancel_requested: row.flag("cancel_requested")?,
        created_at: row.time("created_at")?,
        started_at: row.optional_time("started_at")?,
        finished_at: row.optional_time("finished_at")?,
        files: parse(row.text("files")?)?,
        summary: parse_optional(row, "summary")?,
        problem: parse_optional(row, "problem")?,
        digest: row.text("digest")?.to_owned(),
        engine: row.text("engine")?.to_owned(),
        batch: row.optional_id("batch")?.map(|JobId(id)| BatchId(id)),
        checkpoint: owned(row, "checkpoint")?,
        reused_from: row.optional_id("reused_from")?,
    };
    Ok(Record { job, turn: row.int("turn")?, unread })
}

async fn record(link: &mut Link<'_>, id: JobId) -> Result<Option<Record>, SqlError> {
    let sql = format!("{}FROM jobs j WHERE j.id = $1", select_jobs(link));
    let row = link.optional(sql, values![id]).await?;
    let mut record = row.as_ref().map(to_record).transpose()?;
    set_positions(link, record.as_mut_slice()).await?;
    Ok(record)
}

pub(super) async fn job(link: &mut Link<'_>, id: JobId) -> Result<Option<Job>, SqlError> {
    Ok(record(link, id).await?.map(|record| record.job))
}

/// A record that this transaction has just read or written.
pub(super) async fn known_record(link: &mut Link<'_>, id: JobId) -> Result<Record, SqlError> {
    let gone = || StoreError::Database(format!("job {id} is gone within a transaction"));
    Ok(record(link, id).await?.ok_or_else(gone)?)
}

/// A job that this transaction has just read or written.
pub(super) async fn known_job(link: &mut Link<'_>, id: JobId) -> Result<Job, SqlError> {
    Ok(known_record(link, id).await?.job)
}

pub(super) async fn list(link: &mut Link<'_>, filter: &ListFilter) -> Result<Page, SqlError> {
    let limit = filter.limit.clamp(1, PAGE);
    let mut sql = select_jobs(link).to_owned();
    let mut values = Vec::new();
    let mut next = |value: super::Value| {
        values.push(value);
        format!("${}", values.len())
    };
    // A label leads where there is one, in order of age (CROSS JOIN keeps SQLite to that); else the jobs themselves.
    match filter.labels.first() {
        None => sql += "FROM jobs j WHERE TRUE",
        Some((name, value)) => {
            sql += link.either(
                "FROM labels a CROSS JOIN jobs j ON j.id = a.job_id",
                "FROM labels a JOIN jobs j ON j.id = a.job_id",
            );
            sql += &format!(" WHERE a.name = {}", next(name.into()));
            sql += &format!(" AND a.value = {}", next(value.into()));
        }
    }
    let id = if filter.labels.is_empty() { "j.id" } else { "a.job_id" };
    if let Some(status) = filter.status {
        // In the text: how many there are of it decides which index is the right one.
        sql += &format!(" AND j.status = '{}'", word(status));
    }
    if let Some(preset) = &filter.preset {
        sql += &format!(" AND j.preset = {}", next(preset.into()));
    }
    for (name, value) in filter.labels.iter().skip(1) {
        sql += " AND EXISTS (SELECT 1 FROM labels l WHERE l.job_id = j.id";
        sql += &format!(" AND l.name = {}", next(name.into()));
        sql += &format!(" AND l.value = {})", next(value.into()));
    }
    if let Some(before) = filter.before {
        sql += &format!(" AND {id} < {}", next(before.into()));
    }
    // One more than asked for tells whether there is a next page.
    sql += &format!(" ORDER BY {id} DESC LIMIT {}", limit + 1);
    let rows = link.all(sql, values).await?;
    let mut records = rows.iter().map(to_record).collect::<Result<Vec<_>, _>>()?;
    let more = records.len() > limit as usize;
    records.truncate(limit as usize);
    set_positions(link, &mut records).await?;
    let jobs: Vec<Job> = records.into_iter().map(|record| record.job).collect();
    let next = if more { jobs.last().map(|job| job.id) } else { None };
    Ok(Page { jobs, next })
}

pub(super) async fn attempts(link: &mut Link<'_>, id: JobId) -> Result<Vec<Attempt>, SqlError> {
    let rows = link.all("SELECT * FROM attempts WHERE job_id = $1 ORDER BY attempt", values![id]).await?;
    rows.iter()
        .map(|row| {
            Ok(Attempt {
                attempt: row.count("attempt")?,
                worker: row.text("worker")?.to_owned(),
                started_at: row.time("started_at")?,
                ended_at: row.optional_time("ended_at")?,
                outcome: optional_variant(row, "outcome")?,
                detail: owned(row, "detail")?,
            })
        })
        .collect()
}

pub(super) async fn names_key(link: &mut Link<'_>, key: &str) -> Result<bool, SqlError> {
    let sql = "SELECT EXISTS (SELECT 1 FROM files WHERE key = $1) OR EXISTS (SELECT 1 FROM jobs WHERE checkpoint = $1) \
               AS named";
    link.one(sql, values![key]).await?.flag("named")
}

pub(super) async fn ended_before(link: &mut Link<'_>, age: Duration, limit: u32) -> Result<Vec<JobId>, SqlError> {
    let before =
        if age.is_zero() { Timestamp::MAX } else { link.now().await?.saturating_sub(age).unwrap_or(Timestamp::MIN) };
    let sql = format!(
        "SELECT id FROM jobs{} WHERE finished_at < $1 ORDER BY finished_at, id LIMIT {limit}",
        link.either(" INDEXED BY jobs_by_end", ""),
    );
    link.all(sql, values![before]).await?.iter().map(|row| row.id("id")).collect()
}

pub(super) async fn stored_bytes(link: &mut Link<'_>) -> Result<u64, SqlError> {
    let sql = format!(
        "SELECT CAST(COALESCE(SUM(bytes), 0) AS BIGINT) AS n \
         FROM (SELECT MAX(bytes) AS bytes FROM files{} GROUP BY key) AS kept",
        link.either(" INDEXED BY files_by_key", ""),
    );
    link.one(sql, values![]).await?.count("n")
}

pub(super) async fn counts(link: &mut Link<'_>) -> Result<Counts, SqlError> {
    // What waits and what has ended is counted by triggers; what runs is no more than there are workers for.
    let sql = "SELECT 'queued' AS status, CAST(COALESCE(SUM(jobs), 0) AS BIGINT) AS n FROM queue_length \
               UNION ALL SELECT 'running', COUNT(*) FROM jobs WHERE status = 'running' \
               UNION ALL SELECT status, CAST(SUM(jobs) AS BIGINT) FROM ended_jobs GROUP BY status";
    let mut counts = Counts::default();
    for row in link.all(sql, values![]).await? {
        *counts.of_mut(variant(row.text("status")?)?) = row.count("n")?;
    }
    Ok(counts)
}
