//! Targets of the fuzzers: bodies of requests, headers, queries and ids.

use super::models::request::ModelRequest;
use super::wire::conditional::ETag;
use super::wire::extract::{Parameters, parse_id};
use super::wire::faults::Faults;
use super::wire::headers::{IDEMPOTENCY_KEY, PREFER, accept, idempotency_key, last_event_id, wait};
use super::wire::json::{canonical, parse};
use super::wire::problem::Problem;
use super::wire::range::{Selection, select};
use crate::spec::{ModelSpec, preset};
use axum::extract::Query;
use axum::http::{HeaderMap, HeaderName, HeaderValue, Uri, header};
use serde_json::{Value, json};
use std::time::Duration;

/// Longest place and longest detail of a fault, in characters.
const WORDS_MAX: usize = 1000;

/// The body of `POST /models`: what is accepted is accepted again as it was understood, with the same digest.
pub fn request(bytes: &[u8]) {
    let Some(body) = document(bytes) else { return };
    let mut faults = Faults::default();
    let request = ModelRequest::read(&body, &mut faults);
    let Some(spec) = resolved(&request, faults) else { return };
    let seed = request.seed.unwrap_or_default();
    let mut again = members(&request);
    if let Some(seed) = request.seed {
        again["seed"] = json!(seed);
    }
    assert_eq!(read_again(&again), request);
    again["spec"] = spec.to_json();
    let again = read_again(&again);
    let resolved = resolved(&again, Faults::default());
    assert_eq!(resolved.map(|spec| spec.digest(seed)), Some(spec.digest(seed)));
}

/// A document and its canonical text are the same document; a refusal says why.
pub(super) fn document(bytes: &[u8]) -> Option<Value> {
    match parse(bytes) {
        Ok(value) => {
            let text = canonical(&value);
            let again = parse(text.as_bytes()).map(|value| canonical(&value)).ok();
            assert_eq!(again.as_ref(), Some(&text), "the canonical text is not canonical");
            Some(value)
        }
        Err(problem) => {
            short(&problem);
            None
        }
    }
}

/// The specification of a request without faults; otherwise checks the faults.
pub(super) fn resolved(request: &ModelRequest, mut faults: Faults) -> Option<ModelSpec> {
    let spec = preset(&request.preset)?;
    let spec = ModelSpec::resolve(spec, &request.spec);
    if let Err(wrong) = &spec {
        faults.extend(wrong.iter().map(|f| super::wire::faults::Fault::at(format!("/spec{}", f.pointer), &f.detail)));
    }
    if faults.is_empty() {
        return spec.ok();
    }
    short(&Problem::invalid(faults));
    None
}

/// A problem names its places and says what is wrong in few words, whatever was sent.
fn short(problem: &Problem) {
    let body = problem.body("/models", "0");
    assert!((1..=WORDS_MAX).contains(&body.detail.chars().count()), "{}", body.detail);
    for fault in body.errors {
        let pointer = fault.pointer.as_deref().unwrap_or_default();
        assert!(pointer.is_empty() || pointer.starts_with('/'), "{pointer}");
        let place = fault.parameter.as_deref().unwrap_or(pointer);
        assert!(place.chars().count() <= WORDS_MAX, "{place}");
        assert!((1..=WORDS_MAX).contains(&fault.detail.chars().count()), "{}", fault.detail);
    }
}

/// The members of a request as they were understood.
pub(super) fn members(request: &ModelRequest) -> Value {
    json!({
        "preset": request.preset, "spec": request.spec, "outputs": request.outputs.formats, "bodies": request.outputs.bodies,
        "units": request.outputs.units, "backend": request.backend,
        "labels": request.labels, "priority": request.priority.get(), "reuse": request.reuse,
    })
}

fn read_again(body: &Value) -> ModelRequest {
    let mut faults = Faults::default();
    let request = ModelRequest::read(body, &mut faults);
    assert_eq!(faults, Faults::default());
    request
}

/// Lines `name: value`. Besides headers, `length` is that of the requested file, `query` a query string, `id` an id.
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

/// A part lies within the file and is what its own `Content-Range` selects.
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

/// A list in several header lines means the same as in one (RFC 9110, section 5.2).
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
