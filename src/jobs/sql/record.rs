//! Rows to jobs. A value that only a later version can read is left out; the rest of such a job is
//! still shown.

use super::codec::{self, enum_from_sql, parse};
use super::error::SqlError;
use super::tx::{Row, Tx};
use crate::generate::{Backend, Outputs};
use crate::jobs::{BackendReport, BatchId, Job, JobId, Priority};
use crate::model::BodyKind;
use crate::spec::SharedJson;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::io;

/// A job with columns that only the queue needs.
#[derive(Debug)]
pub(super) struct Record {
    pub(super) job: Job,
    /// Turn among the jobs of the same backend and priority.
    pub(super) turn: i64,
    /// Key of the jobs that a GPU may simulate together with this one; `None` if there are none.
    pub(super) batch_key: Option<String>,
    /// Reason why this version cannot run the job, usually a value that a later version wrote.
    pub(super) unread: Option<String>,
}

/// SELECT clause of a whole job in one row; `j` is the table of jobs.
pub(super) fn select_jobs(tx: &Tx<'_>) -> &'static str {
    tx.either(
        "SELECT j.*, \
         (SELECT t.worker FROM attempts t WHERE t.job_id = j.id ORDER BY t.attempt DESC LIMIT 1) AS worker, \
         (SELECT json_group_array(json_object('name', f.name, 'media_type', f.media_type, 'bytes', f.bytes, \
         'sha256', f.sha256, 'key', f.key, 'start', f.start)) \
         FROM (SELECT * FROM files WHERE job_id = j.id ORDER BY ordinal) f) \
         AS files, \
         (SELECT json_group_object(l.name, l.value) FROM labels l WHERE l.job_id = j.id) AS labels ",
        "SELECT j.*, \
         (SELECT t.worker FROM attempts t WHERE t.job_id = j.id ORDER BY t.attempt DESC LIMIT 1) AS worker, \
         (SELECT COALESCE(json_agg(json_build_object('name', f.name, 'media_type', f.media_type, 'bytes', f.bytes, \
         'sha256', f.sha256, 'key', f.key, 'start', f.start) ORDER BY f.ordinal), '[]')::text \
         FROM files f WHERE f.job_id = j.id) \
         AS files, \
         (SELECT COALESCE(json_object_agg(l.name, l.value), '{}')::text FROM labels l WHERE l.job_id = j.id) AS labels ",
    )
}

/// A JSON value; `None` if it is null or only a later version can read it.
pub(super) fn parse_optional<T: DeserializeOwned>(row: &Row, column: &str) -> Result<Option<T>, SqlError> {
    Ok(row.get::<Option<&str>>(column)?.and_then(|text| parse(text).ok()))
}

/// An enum; `None` if it is null or only a later version knows it.
pub(super) fn optional_enum<T: DeserializeOwned>(row: &Row, column: &str) -> Result<Option<T>, SqlError> {
    Ok(row.get::<Option<&str>>(column)?.and_then(|name| enum_from_sql(name).ok()))
}

/// Stored form of an owner; all jobs without an owner have the same submitter.
pub(super) fn submitter(owner: Option<&str>) -> String {
    owner.unwrap_or_default().to_owned()
}

/// The owner in a row of jobs or batches.
pub(super) fn owner(row: &Row) -> Result<Option<String>, SqlError> {
    Ok(Some(row.get("submitter")?).filter(|name: &String| !name.is_empty()))
}

/// A priority, clamped to the range of this version.
pub(super) fn priority(value: i64) -> Priority {
    Priority::try_from(value.clamp(Priority::MIN, Priority::MAX)).unwrap_or_default()
}

/// Stored form of outputs: the list of formats, or an object if they also name bodies other than
/// the tissue, or units. Versions without bodies wrote lists only.
pub(super) fn outputs_to_sql(outputs: &Outputs) -> String {
    if *outputs == Outputs::from(outputs.formats.clone()) {
        return codec::json(&outputs.formats);
    }
    json!({ "formats": outputs.formats, "bodies": outputs.bodies, "units": outputs.units }).to_string()
}

/// The requested outputs that this version knows, and the reason why some are missing.
pub(super) fn outputs_from_sql(text: &str) -> (Outputs, Option<String>) {
    let mut unread = None;
    let stored: Value = serde_json::from_str(text).unwrap_or_else(|error| {
        unread = Some(format!("outputs: {error}"));
        json!([])
    });
    let mut outputs = Outputs::from(known(stored.get("formats").unwrap_or(&stored), &mut unread));
    if let Some(bodies) = stored.get("bodies") {
        outputs.bodies = known::<BodyKind>(bodies, &mut unread);
    }
    if let Some(units) = stored.get("units") {
        match serde_json::from_value(units.clone()) {
            Ok(units) => outputs.units = units,
            Err(error) => unread = Some(format!("outputs: {error}")),
        }
    }
    (outputs, unread)
}

/// The members of a list that this version knows.
fn known<T: DeserializeOwned>(list: &Value, unread: &mut Option<String>) -> Vec<T> {
    let mut known = Vec::new();
    for name in list.as_array().into_iter().flatten() {
        match serde_json::from_value(name.clone()) {
            Ok(item) => known.push(item),
            Err(error) => *unread = Some(format!("outputs: {error}")),
        }
    }
    if !list.is_array() {
        *unread = Some("outputs: not a list".to_owned());
    }
    known
}

/// Converts a row of [`select_jobs`], without the position in the queue.
pub(super) fn to_record(row: &Row) -> Result<Record, SqlError> {
    let (outputs, mut unread) = outputs_from_sql(row.get("outputs")?);
    let parsed = row.spec()?.and_then(|text| text.parse().map_err(io::Error::from));
    let spec = parsed.unwrap_or_else(|error| {
        unread = Some(format!("spec: {error}"));
        SharedJson::from(Value::Null)
    });
    let kind = optional_enum(row, "kind")?;
    if kind.is_none() {
        unread = Some(format!("kind: {}", row.get::<&str>("kind")?));
    }
    let job = Job {
        id: JobId(row.id("id")?),
        kind: kind.unwrap_or_default(),
        owner: owner(row)?,
        status: enum_from_sql(row.get("status")?)?,
        version: row.count("version")?,
        preset: row.get("preset")?,
        seed: row.count("seed")?,
        spec,
        outputs,
        labels: parse(row.get("labels")?)?,
        priority: priority(row.get::<i64>("rank")?.saturating_neg()),
        trace: row.get("trace")?,
        backend: BackendReport {
            // Claims of this version never take a job of a backend that it does not know.
            requested: enum_from_sql(row.get("backend_requested")?).unwrap_or(Backend::Auto),
            used: optional_enum(row, "backend_used")?,
            device: row.get("device")?,
            fallback: row.get("fallback")?,
        },
        queue_position: None,
        waits_for_equal: row.get::<&str>("status")? == "queued" && row.get("shares")?,
        progress: parse_optional(row, "progress")?,
        section: parse_optional(row, "section")?,
        attempts: row.count("attempts")?,
        worker: row.get("worker")?,
        cancel_requested: row.get("cancel_requested")?,
        created_at: row.time("created_at")?,
        started_at: row.optional_time("started_at")?,
        finished_at: row.optional_time("finished_at")?,
        files: parse(row.get("files")?)?,
        summary: parse_optional(row, "summary")?,
        problem: parse_optional(row, "problem")?,
        digest: row.get("digest")?,
        engine: row.get("engine")?,
        batch: row.optional_id("batch")?.map(BatchId),
        checkpoint: row.get("checkpoint")?,
        reused_from: row.optional_id("reused_from")?.map(JobId),
        retry_of: row.optional_id("retry_of")?.map(JobId),
    };
    Ok(Record { job, turn: row.get("turn")?, batch_key: row.get("batch_key")?, unread })
}
