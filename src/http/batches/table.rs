//! `GET /batches/{id}/table`: one row per model, as CSV or JSON.
//!
//! All cells come from the records of the models; no file is read. No cell contains text of a
//! client or worker, so none can start a formula in a spreadsheet.

use super::read::{each_model, find_batch};
use super::study::StoredStudy;
use crate::http::AppState;
use crate::http::access::Caller;
use crate::http::models::files::{body_with_permit, permit};
use crate::http::wire::blocking::blocking;
use crate::http::wire::extract::{BatchId, Parameters};
use crate::http::wire::faults::RequestFault;
use crate::http::wire::headers::accept;
use crate::http::wire::problem::{Kind, Problem, TYPE_PREFIX};
use crate::http::wire::responses::{BadParameters, BatchMissing, DownloadUnavailable, Unacceptable};
use crate::jobs::Job;
use crate::spec::openapi::ParameterValue;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use futures_util::stream;
use serde::Serialize;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::convert::Infallible;
use std::sync::Arc;
use utoipa::ToSchema;

const JSON: &str = "application/json";
const CSV: &str = "text/csv";
/// Columns before the varied parameters.
const FIRST_COLUMNS: [&str; 3] = ["id", "status", "seed"];
/// Size of a chunk of the body, in bytes. The permit is held until the last one is taken.
const CHUNK: usize = 64 << 10;
/// Column after the varied parameters.
const PROBLEM_COLUMN: &str = "problem";

/// Representations of a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ToSchema)]
#[schema(rename_all = "lowercase")]
pub(in crate::http) enum TableFormat {
    /// `application/json`.
    Json,
    /// `text/csv` (RFC 4180).
    Csv,
}

/// The models of a batch as a table.
#[derive(Debug, Serialize, ToSchema)]
pub(in crate::http) struct Table {
    /// Names of the columns: `id`, `status`, `seed`, the JSON pointer of each varied parameter,
    /// `problem`, and the figures of the models by dotted names such as `summary.particles.end`.
    columns: Vec<String>,
    /// One row per model, in the order of the request. A value that a model lacks is null.
    #[schema(value_type = Vec<Vec<ParameterValue>>)]
    rows: Vec<Vec<Value>>,
}

/// Read the models of a batch as a table: varied values, seed, status and all figures.
///
/// Models that have not succeeded have no figures.
#[utoipa::path(
    get, path = "/batches/{id}/table", operation_id = "get_batch_table", tag = "batches",
    params(
        ("id" = Uuid, Path, description = "Id of the batch"),
        ("format" = Option<TableFormat>, Query, description = "`json` or `csv`; takes precedence over `Accept`"),
    ),
    responses(
        (status = 200, description = "The table", content(
            (Table = "application/json"),
            (String = "text/csv"))),
        BatchMissing, Unacceptable, BadParameters, DownloadUnavailable,
    )
)]
pub(in crate::http) async fn table(
    State(state): State<AppState>,
    caller: Caller,
    BatchId(id): BatchId,
    parameters: Parameters,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let format = format(&parameters, &headers)?;
    let batch = find_batch(&state, &caller, id).await?;
    // A table is made whole in memory, so its number is limited until its client has read it.
    let permit = permit(&state, &caller)?;
    let study = StoredStudy::of(&batch);
    let mut rows = Vec::with_capacity(batch.jobs.len());
    each_model(&state, &batch, |place, job| rows.push(ModelRow::of(study.as_ref(), place, job))).await?;
    let text = blocking("Making the table", Arc::clone(&permit), move || {
        let table = Table::of(study.as_ref().map_or(&[], |study| &study.pointers), rows);
        match format {
            TableFormat::Json => serde_json::to_vec(&table).expect("a table has string keys only"),
            TableFormat::Csv => table.csv(),
        }
    });
    let text = Bytes::from(text.await?);
    let length = HeaderValue::from(text.len());
    let chunks = (0..text.len()).step_by(CHUNK).map(move |start| text.slice(start..text.len().min(start + CHUNK)));
    let body = body_with_permit(stream::iter(chunks.map(Ok::<_, Infallible>)), permit);
    let headers = [
        (header::CONTENT_LENGTH, length),
        (header::CACHE_CONTROL, HeaderValue::from_static("no-cache")),
        (header::VARY, HeaderValue::from_static("accept")),
    ];
    if format == TableFormat::Json {
        return Ok((headers, [(header::CONTENT_TYPE, HeaderValue::from_static(JSON))], body).into_response());
    }
    let name = HeaderValue::try_from(format!("attachment; filename=\"batch-{id}.csv\""));
    let name = name.unwrap_or(HeaderValue::from_static("attachment"));
    let own = [
        (header::CONTENT_TYPE, HeaderValue::from_static("text/csv; charset=utf-8; header=present")),
        (header::CONTENT_DISPOSITION, name),
    ];
    Ok((headers, own, body).into_response())
}

fn format(parameters: &Parameters, headers: &HeaderMap) -> Result<TableFormat, Problem> {
    let mut faults = parameters.faults(&["format"], &[]);
    let format = match parameters.get("format") {
        Some("json") => Some(TableFormat::Json),
        Some("csv") => Some(TableFormat::Csv),
        Some(_) => {
            faults.push(RequestFault::parameter("format", "must be json or csv"));
            None
        }
        None => {
            accept(headers, &[JSON, CSV]).map(|best| if best == CSV { TableFormat::Csv } else { TableFormat::Json })
        }
    };
    Problem::check(faults)?;
    format.ok_or_else(|| Problem::new(Kind::NotAcceptable, format!("The representations are {JSON} and {CSV}.")))
}

/// Cells of a model.
struct ModelRow {
    first: [Value; FIRST_COLUMNS.len()],
    varied: Vec<Value>,
    problem: Value,
    figures: BTreeMap<String, Value>,
}

impl ModelRow {
    fn of(study: Option<&StoredStudy>, place: u32, job: &Job) -> Self {
        let mut figures = BTreeMap::new();
        if let Some(summary) = &job.summary {
            add_figures("summary", summary, &mut figures);
        }
        Self {
            first: [json!(job.id), json!(job.status), json!(job.seed)],
            varied: study.map_or_else(Vec::new, |study| study.values(place).to_vec()),
            problem: job.problem.as_ref().map_or(Value::Null, |p| format!("{TYPE_PREFIX}{}", p.kind).into()),
            figures,
        }
    }
}

impl Table {
    fn of(pointers: &[String], rows: Vec<ModelRow>) -> Self {
        let figures: BTreeSet<String> = rows.iter().flat_map(|row| row.figures.keys().cloned()).collect();
        let rows = rows.into_iter().map(|mut row| {
            let mut cells = Vec::with_capacity(FIRST_COLUMNS.len() + pointers.len() + 1 + figures.len());
            cells.extend(row.first);
            cells.extend(row.varied);
            cells.resize(FIRST_COLUMNS.len() + pointers.len(), Value::Null);
            cells.push(row.problem);
            cells.extend(figures.iter().map(|name| row.figures.remove(name).unwrap_or_default()));
            cells
        });
        let rows = rows.collect();
        let first = FIRST_COLUMNS.into_iter().map(str::to_owned).chain(pointers.iter().cloned());
        Self { columns: first.chain([PROBLEM_COLUMN.to_owned()]).chain(figures).collect(), rows }
    }

    /// The table as CSV. Null becomes an empty cell, a list or an object its JSON.
    fn csv(&self) -> Vec<u8> {
        let mut out = csv::WriterBuilder::new().terminator(csv::Terminator::CRLF).from_writer(Vec::new());
        let cell = |value: &Value| match value {
            Value::Null => String::new(),
            Value::String(text) => text.clone(),
            other => other.to_string(),
        };
        let written = out
            .write_record(&self.columns)
            .and_then(|()| self.rows.iter().try_for_each(|row| out.write_record(row.iter().map(cell))));
        written.expect("all rows have as many cells, and a Vec takes all bytes");
        out.into_inner().expect("a Vec takes all bytes")
    }
}

/// Adds the figures of `value` as columns: a member of an object as `name.member`, an element of a
/// list as `name.0`, and a list of objects as its length.
fn add_figures(name: &str, value: &Value, figures: &mut BTreeMap<String, Value>) {
    match value {
        Value::Object(members) => {
            members.iter().for_each(|(member, value)| add_figures(&format!("{name}.{member}"), value, figures));
        }
        Value::Array(items) if items.is_empty() || items.iter().any(Value::is_object) => {
            figures.insert(name.to_owned(), items.len().into());
        }
        Value::Array(items) => {
            items.iter().enumerate().for_each(|(i, value)| add_figures(&format!("{name}.{i}"), value, figures));
        }
        scalar => {
            figures.insert(name.to_owned(), scalar.clone());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn names_are_dotted_and_lists_of_objects_are_counted() {
        let mut figures = BTreeMap::new();
        let summary = json!({ "vertices": 8, "gap": null, "particles": { "start": 1, "end": 2 }, "warnings": [],
            "certificate": { "passed": true, "bounds_um": [[0, 1.5], [2, 3]],
                "bodies": [{ "euler": 0 }, { "euler": 2 }] } });
        add_figures("summary", &summary, &mut figures);
        let found: Vec<String> = figures.iter().map(|(name, value)| format!("{name}={value}")).collect();
        assert_eq!(
            found,
            [
                "summary.certificate.bodies=2",
                "summary.certificate.bounds_um.0.0=0",
                "summary.certificate.bounds_um.0.1=1.5",
                "summary.certificate.bounds_um.1.0=2",
                "summary.certificate.bounds_um.1.1=3",
                "summary.certificate.passed=true",
                "summary.gap=null",
                "summary.particles.end=2",
                "summary.particles.start=1",
                "summary.vertices=8",
                "summary.warnings=0",
            ]
        );
    }
}
