//! `GET /batches/{id}/table`: one row a model, as CSV or JSON.
//!
//! Everything comes from the records of the models; no file is read. No cell holds text of a client or of a worker, so
//! none can begin a formula of a spreadsheet.

use super::figures;
use super::models::each_model;
use super::study::StoredStudy;
use crate::http::AppState;
use crate::http::access::Caller;
use crate::http::wire::extract::{BatchId, Parameters, no_batch};
use crate::http::wire::faults::Fault;
use crate::http::wire::headers::accept;
use crate::http::wire::problem::{Kind, Problem, TYPE_PREFIX};
use crate::http::wire::responses::{BadParameters, BatchMissing, Inacceptable, ParameterValue, StoreAway};
use crate::jobs::Job;
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use utoipa::ToSchema;

const JSON: &str = "application/json";
const CSV: &str = "text/csv";
/// The first columns, before the varied parameters, and the column after those.
const FIRST: [&str; 3] = ["id", "status", "seed"];
const PROBLEM: &str = "problem";

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
    /// Names of the columns: `id`, `status`, `seed`, the JSON pointer of each varied parameter, `problem`, and the figures of
    /// the models by dotted names such as `summary.particles.end`.
    columns: Vec<String>,
    /// One row a model, in the order of the request; a value that a model does not have is null.
    #[schema(value_type = Vec<Vec<ParameterValue>>)]
    rows: Vec<Vec<Value>>,
}

/// Read the models of a batch as a table: varied values, seed, status and all figures.
///
/// Models that have not ended, or not succeeded, have no figures.
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
        BatchMissing, Inacceptable, BadParameters, StoreAway,
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
    let batch = caller.batch(state.store.batch(id).await?).ok_or_else(|| no_batch(id))?;
    let study = StoredStudy::of(&batch);
    let mut rows = Vec::with_capacity(batch.jobs.len());
    each_model(&state, &batch, |place, job| rows.push(Row::of(study.as_ref(), place, job))).await?;
    let table = Table::of(study.as_ref().map_or(&[], |study| &study.pointers), rows);
    let headers = [
        (header::CACHE_CONTROL, HeaderValue::from_static("no-cache")),
        (header::VARY, HeaderValue::from_static("accept")),
    ];
    if format == TableFormat::Json {
        return Ok((headers, Json(table)).into_response());
    }
    let name = HeaderValue::try_from(format!("attachment; filename=\"batch-{id}.csv\""));
    let name = name.unwrap_or(HeaderValue::from_static("attachment"));
    let own = [
        (header::CONTENT_TYPE, HeaderValue::from_static("text/csv; charset=utf-8; header=present")),
        (header::CONTENT_DISPOSITION, name),
    ];
    Ok((headers, own, table.csv()).into_response())
}

fn format(parameters: &Parameters, headers: &HeaderMap) -> Result<TableFormat, Problem> {
    let mut faults = parameters.faults(&["format"], &[]);
    let asked = parameters.0.iter().find(|(name, _)| name == "format").map(|(_, value)| value.as_str());
    let format = match asked {
        Some("json") => Some(TableFormat::Json),
        Some("csv") => Some(TableFormat::Csv),
        Some(_) => {
            faults.push(Fault::parameter("format", "must be json or csv"));
            None
        }
        None => {
            accept(headers, &[JSON, CSV]).map(|best| if best == CSV { TableFormat::Csv } else { TableFormat::Json })
        }
    };
    if !faults.is_empty() {
        return Err(Problem::invalid(faults));
    }
    format.ok_or_else(|| Problem::new(Kind::NotAcceptable, format!("The representations are {JSON} and {CSV}.")))
}

/// What a table shows of a model.
struct Row {
    first: [Value; FIRST.len()],
    varied: Vec<Value>,
    problem: Value,
    figures: BTreeMap<String, Value>,
}

impl Row {
    fn of(study: Option<&StoredStudy>, place: u32, job: &Job) -> Self {
        let mut figures = BTreeMap::new();
        if let Some(summary) = &job.summary {
            figures::add("summary", summary, &mut figures);
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
    fn of(pointers: &[String], rows: Vec<Row>) -> Self {
        let figures: BTreeSet<String> = rows.iter().flat_map(|row| row.figures.keys().cloned()).collect();
        let rows = rows.into_iter().map(|mut row| {
            let mut cells = Vec::with_capacity(FIRST.len() + pointers.len() + 1 + figures.len());
            cells.extend(row.first);
            cells.extend(row.varied);
            cells.resize(FIRST.len() + pointers.len(), Value::Null);
            cells.push(row.problem);
            cells.extend(figures.iter().map(|name| row.figures.remove(name).unwrap_or_default()));
            cells
        });
        let rows = rows.collect();
        let first = FIRST.into_iter().map(str::to_owned).chain(pointers.iter().cloned());
        Self { columns: first.chain([PROBLEM.to_owned()]).chain(figures).collect(), rows }
    }

    /// The table as CSV: null is an empty cell, a list or an object is its JSON.
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
