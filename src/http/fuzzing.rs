//! Fuzz targets: bodies of requests, headers, queries and ids.

use super::batches::request::{BatchRequest, BatchSeeds};
use super::models::request::ModelRequest;
use super::wire::conditional::ETag;
use super::wire::extract::{Parameters, parse_id};
use super::wire::faults::body_reader;
use super::wire::headers::{IDEMPOTENCY_KEY, PREFER, accept, idempotency_key, last_event_id, wait};
use super::wire::json::parse;
use super::wire::problem::Problem;
use super::wire::range::{Selection, select};
use crate::spec::{JsonReader, ModelSpec, canonical_json, preset};
use axum::extract::Query;
use axum::http::{HeaderMap, HeaderName, HeaderValue, Uri, header};
use serde_json::{Value, json};
use std::time::Duration;

/// Maximum length of the place and of the detail of a fault, in characters.
const MAX_CHARS: usize = 1000;
/// Maximum number of models of a batch.
const MAX_BATCH: usize = 1000;

/// The body of `POST /models`. Asserts that a valid request is read again from its members with the
/// same result and digest.
pub fn request(bytes: &[u8]) {
    let Some(body) = document(bytes) else { return };
    let mut reader = body_reader();
    let request = ModelRequest::read(&mut reader, &body);
    let Some(spec) = resolved(&request, reader) else { return };
    let seed = request.seed.unwrap_or_default();
    let mut again = members(&request);
    if let Some(seed) = request.seed {
        again["seed"] = json!(seed);
    }
    assert_eq!(read_again(&again), request);
    again["spec"] = spec.to_json();
    let again = read_again(&again);
    let resolved = resolved(&again, body_reader());
    assert_eq!(resolved.map(|spec| spec.digest(seed)), Some(spec.digest(seed)));
}

/// The body of `POST /batches`. Asserts that a valid request is read again from its members with
/// the same result, and that the patches of a study contain its values.
pub fn batch(bytes: &[u8]) {
    let Some(body) = document(bytes) else { return };
    let mut reader = body_reader();
    let batch = BatchRequest::read(&mut reader, &body, MAX_BATCH);
    if resolved(&batch.common, reader).is_none() {
        return;
    }
    let mut again = members(&batch.common);
    match &batch.seeds {
        BatchSeeds::Given(seeds) => again["seeds"] = json!(seeds),
        BatchSeeds::Drawn(count) => again["count"] = json!(count),
    }
    if let Some(study) = &batch.study {
        assert!((1..=MAX_BATCH).contains(&(study.points() * batch.seeds.len())));
        for point in 0..study.points() {
            let patch = study.patch(point);
            for (pointer, value) in study.pointers().iter().zip(study.values(point)) {
                assert_eq!(patch.pointer(pointer), Some(value), "{pointer} of point {point}");
            }
        }
        again["vary"] = body["vary"].clone();
    }
    let mut reader = body_reader();
    assert_eq!(BatchRequest::read(&mut reader, &again, MAX_BATCH), batch);
    assert_eq!(reader.count(), 0);
}

/// Parses a document. Asserts that its canonical text is canonical.
fn document(bytes: &[u8]) -> Option<Value> {
    match parse(bytes) {
        Ok(value) => {
            let text = canonical_json(&value);
            let again = parse(text.as_bytes()).map(|value| canonical_json(&value)).ok();
            assert_eq!(again.as_ref(), Some(&text), "the canonical text is not canonical");
            Some(value)
        }
        Err(problem) => {
            short(&problem);
            None
        }
    }
}

/// Resolves the spec of a request. Checks the faults if there are any.
fn resolved(request: &ModelRequest, mut reader: JsonReader) -> Option<ModelSpec> {
    let preset = preset(&request.preset)?;
    let spec = ModelSpec::resolve(preset, &request.spec).map_err(|faults| reader.extend("/spec", faults)).ok();
    if reader.count() > 0 {
        short(&Problem::invalid(reader));
        return None;
    }
    spec
}

/// Asserts that a problem has places and short details, whatever was sent.
fn short(problem: &Problem) {
    let body = problem.body("/models", "0");
    assert!((1..=MAX_CHARS).contains(&body.detail.chars().count()), "{}", body.detail);
    for fault in body.errors {
        let pointer = fault.pointer.as_deref().unwrap_or_default();
        assert!(pointer.is_empty() || pointer.starts_with('/'), "{pointer}");
        let place = fault.parameter.as_deref().unwrap_or(pointer);
        assert!(place.chars().count() <= MAX_CHARS, "{place}");
        assert!((1..=MAX_CHARS).contains(&fault.detail.chars().count()), "{}", fault.detail);
    }
}

/// Members of a request.
fn members(request: &ModelRequest) -> Value {
    json!({
        "preset": request.preset, "spec": request.spec, "outputs": request.outputs.formats, "bodies": request.outputs.bodies,
        "units": request.outputs.units, "backend": request.backend,
        "labels": request.labels, "priority": request.priority.get(), "reuse": request.reuse,
    })
}

fn read_again(body: &Value) -> ModelRequest {
    let mut reader = body_reader();
    let request = ModelRequest::read(&mut reader, body);
    assert_eq!(reader.count(), 0);
    request
}

/// Lines of the form `name: value`: headers, and `length` (of the requested file), `query` (a query
/// string) and `id`.
pub fn headers(bytes: &[u8]) {
    let mut headers = HeaderMap::new();
    let mut length = 300;
    for line in bytes.split(|&b| b == b'\n') {
        let Some(colon) = line.iter().position(|&b| b == b':') else { continue };
        let (name, value) = (&line[..colon], line[colon + 1..].trim_ascii());
        match name {
            b"length" => length = std::str::from_utf8(value).ok().and_then(|v| v.parse().ok()).unwrap_or(length),
            b"query" => query(value),
            b"id" => id(value),
            _ => {
                if let (Ok(name), Ok(value)) = (HeaderName::from_bytes(name), HeaderValue::from_bytes(value)) {
                    headers.append(name, value);
                }
            }
        }
    }
    for value in headers.get_all(header::RANGE).iter().filter_map(|value| value.to_str().ok()) {
        range(value, length);
    }
    preferences(&headers);
    lists(&headers);
}

/// Asserts that a range lies within the file, and that it selects itself.
fn range(value: &str, length: u64) {
    for length in [length, 0, 1, u64::MAX] {
        if let Selection::Part(part) = select(Some(value), length) {
            assert!(part.start < part.end && part.end <= length, "{part:?} of {length}");
            let again = format!("bytes={}-{}", part.start, part.end - 1);
            assert_eq!(select(Some(&again), length), Selection::Part(part));
        }
    }
}

fn preferences(headers: &HeaderMap) {
    if let Some(time) = wait(headers) {
        assert!((Duration::from_secs(1)..=Duration::from_secs(60)).contains(&time));
    }
    if let Ok(Some(key)) = idempotency_key(headers) {
        assert!((1..=255).contains(&key.len()) && key.bytes().all(|b| b.is_ascii_graphic()));
        let quoted = HeaderValue::try_from(format!("\"{key}\"")).expect("graphic characters are valid in a header");
        let again = HeaderMap::from_iter([(IDEMPOTENCY_KEY, quoted)]);
        assert_eq!(idempotency_key(&again).ok().flatten(), Some(key));
    }
    assert!(last_event_id(headers).is_none_or(|text| !text.is_empty() && text.trim() == text));
}

/// Asserts that a list in several header lines equals the list in one line (RFC 9110, section 5.2).
fn lists(headers: &HeaderMap) {
    let joined = |name: &HeaderName| {
        let values: Option<Vec<_>> = headers.get_all(name).iter().map(|value| value.to_str().ok()).collect();
        let value = HeaderValue::try_from(values?.join(", ")).ok()?;
        Some(HeaderMap::from_iter([(name.clone(), value)]))
    };
    let offers = ["application/json", "image/svg+xml"];
    if let Some(one) = joined(&header::ACCEPT) {
        assert_eq!(accept(headers, &offers), accept(&one, &offers));
    }
    if let Some(one) = joined(&PREFER) {
        assert_eq!(wait(headers), wait(&one));
    }
    let tag = ETag::strong("0f-1");
    if let Some(one) = joined(&header::IF_NONE_MATCH) {
        assert_eq!(tag.matches_none(headers), tag.matches_none(&one));
    }
    let mut more = headers.clone();
    more.append(header::IF_NONE_MATCH, HeaderValue::from_static("W/\"0f-1\""));
    assert!(tag.matches_none(&more));
    if tag.matches_range(headers) {
        assert!(headers.get(header::IF_RANGE).is_none_or(|value| value == "\"0f-1\""));
    }
}

fn query(value: &[u8]) {
    let Ok(uri) = Uri::try_from([b"/models?", value].concat()) else { return };
    if let Ok(Query(pairs)) = Query::<Vec<(String, String)>>::try_from_uri(&uri) {
        let faults = Parameters(pairs).faults(&["format", "label"], &["label"]);
        if !faults.is_empty() {
            short(&Problem::invalid(faults));
        }
    }
}

fn id(value: &[u8]) {
    let Ok(text) = std::str::from_utf8(value) else { return };
    if let Some(id) = parse_id(text) {
        assert_eq!(id.to_string(), text.to_ascii_lowercase());
    }
}
