//! `GET /models/{id}/manifest.json`: what the files of a model are, and where they come from.
//!
//! It is made from the record, as a reused model may have fewer files than the one that it reuses.

use super::files::{IMMUTABLE, find};
use crate::generate::{FileOutput, MANIFEST, Manifest, Origin};
use crate::http::AppState;
use crate::http::access::Caller;
use crate::http::wire::conditional::ETag;
use crate::http::wire::extract::ModelId;
use crate::http::wire::problem::Problem;
use crate::http::wire::responses::{FileMissing, StoreAway};
use crate::jobs::Job;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use sha2::{Digest, Sha256};

/// Read what the files of a model are.
///
/// Names, sizes, hashes, bodies, units and patches of its files, and its origin: spec, seed, digest, engine, licence, how to
/// cite. `oviduct generate` writes the same beside the files.
#[utoipa::path(
    get, path = "/models/{id}/manifest.json", operation_id = "get_manifest", tag = "files",
    params(
        ("id" = Uuid, Path, description = "Id of the model"),
        ("if-none-match" = Option<String>, Header, description = "Entity tags that the client has"),
    ),
    responses(
        (status = 200, description = "The manifest", body = Manifest, headers(
            ("etag" = String, description = "SHA-256 of the manifest"))),
        (status = 304, description = "The client has this manifest"),
        FileMissing, StoreAway,
    )
)]
pub(in crate::http) async fn manifest(
    State(state): State<AppState>,
    caller: Caller,
    ModelId(id): ModelId,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    // A model that has a report has all of its files.
    let (job, _) = find(&state, &caller, id, "report.json").await?;
    let body = serde_json::to_vec_pretty(&of(&job)).expect("a manifest has string keys only");
    let tag = ETag::strong(hex::encode(Sha256::digest(&body)));
    if tag.matches_none(&headers) {
        return tag.not_modified(IMMUTABLE);
    }
    let name = format!("inline; filename=\"{MANIFEST}\"");
    let headers = [
        (header::CONTENT_TYPE, HeaderValue::from_static("application/json")),
        (header::CONTENT_DISPOSITION, HeaderValue::try_from(name).unwrap_or(HeaderValue::from_static("inline"))),
        (header::ETAG, tag.header()?),
        (header::CACHE_CONTROL, IMMUTABLE),
    ];
    Ok((headers, body).into_response())
}

fn of(job: &Job) -> Manifest {
    let file = |file: &crate::jobs::File| FileOutput {
        name: file.name.clone(),
        media_type: file.media_type.clone(),
        bytes: file.bytes,
        sha256: file.sha256.clone(),
    };
    let origin = Origin {
        engine: &job.engine,
        preset: &job.preset,
        seed: job.seed,
        digest: &job.digest,
        spec: job.spec.clone(),
    };
    Manifest::new(origin, &job.outputs, &job.files.iter().map(file).collect::<Vec<_>>())
}
