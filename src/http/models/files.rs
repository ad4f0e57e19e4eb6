//! Files of a model: `GET /models/{id}/files/{name}`, `GET /models/{id}/report` and
//! `GET /models/{id}/manifest.json`.
//!
//! A name is only compared with the names in the model's record; it never becomes part of a path.
//! Files never change, so their entity tag is their SHA-256, and clients may cache them forever.

use crate::generate::{FileOutput, MANIFEST, Manifest, Origin};
use crate::http::AppState;
use crate::http::access::Caller;
use crate::http::wire::conditional::ETag;
use crate::http::wire::extract::{ModelId, PathTexts, no_model};
use crate::http::wire::headers::refuses_redirect;
use crate::http::wire::problem::{Kind, Problem};
use crate::http::wire::range::{Selection, select};
use crate::http::wire::responses::{DownloadUnavailable, FileMissing, RangeOutside, StoresUnavailable};
use crate::http::wire::shares::Share;
use crate::jobs::artifacts::{ArtifactError, Chunks};
use crate::jobs::{BackendReport, File, Job, JobId};
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use futures_util::{Stream, StreamExt, TryStreamExt};
use serde_json::{Map, Value};
use sha2::{Digest, Sha256};
use std::ops::Range;
use std::sync::Arc;
use std::time::Duration;

/// `Cache-Control` of responses that never change.
pub(in crate::http) const IMMUTABLE: HeaderValue = HeaderValue::from_static("private, max-age=31536000, immutable");

/// Validity of a signed address.
const SIGNED_FOR: Duration = Duration::from_secs(300);

/// Download a file.
///
/// The `files` of the model contain the names and media types. Files never change, so a client can
/// resume a download with a range.
#[utoipa::path(
    get, path = "/models/{id}/files/{name}", operation_id = "download_file", tag = "files",
    params(
        ("id" = Uuid, Path, description = "Id of the model"),
        ("name" = String, Path, description = "Name of one of the model's files, such as `model.glb`"),
        ("range" = Option<String>, Header, description = "One range of bytes"),
        ("if-range" = Option<String>, Header, description = "Entity tag of the file of which the client has a part"),
        ("if-none-match" = Option<String>, Header, description = "Entity tags that the client has"),
        ("prefer" = Option<String>, Header,
            description = "`redirect=no`: send the file itself instead of a redirect to the artifact store"),
    ),
    responses(
        (status = 200, description = "The file", headers(
            ("etag" = String, description = "SHA-256 of the file"),
            ("accept-ranges" = String, description = "`bytes`"),
            ("content-disposition" = String, description = "File name under which a client can save the response"))),
        (status = 206, description = "The range", headers(
            ("content-range" = String, description = "The range, and the size of the file"))),
        (status = 304, description = "The client has this file"),
        (status = 307, description = "Redirect to a signed URL of the artifact store, valid for five minutes. Only \
            with `serve --redirect-downloads`", headers(
            ("location" = String, description = "Signed URL of the file"))),
        FileMissing, RangeOutside, DownloadUnavailable,
    )
)]
pub(in crate::http) async fn download(
    State(state): State<AppState>,
    caller: Caller,
    ModelId(id): ModelId,
    path: PathTexts,
    method: Method,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let (job, file) = find(&state, &caller, id, path.get("name")).await?;
    let name = format!("{}-{}-{}", job.preset, job.seed, file.name);
    if let Some(redirect) = redirect(&state, &file, &name, &method, &headers).await? {
        return Ok(redirect);
    }
    let mut response = send(&state, &caller, &file, &method, &headers).await?;
    if let Ok(value) = HeaderValue::try_from(format!("attachment; filename=\"{name}\"")) {
        response.headers_mut().insert(header::CONTENT_DISPOSITION, value);
    }
    Ok(response)
}

/// Redirects a download to the artifact store, if the service is configured to and the store can
/// sign addresses. Ranges work as well, because a client repeats its headers there. The console
/// asks not to be redirected: its policy allows requests to this origin only.
async fn redirect(
    state: &AppState,
    file: &File,
    name: &str,
    method: &Method,
    headers: &HeaderMap,
) -> Result<Option<Response>, Problem> {
    let known = ETag::strong(&file.sha256).matches_none(headers);
    // A signed address is that of a whole object.
    let is_packed = file.start.is_some();
    if !state.limits.redirect_downloads || method != Method::GET || known || is_packed || refuses_redirect(headers) {
        return Ok(None);
    }
    let Some(url) = state.artifacts.signed_url(&file.key, name, &file.media_type, SIGNED_FOR).await? else {
        return Ok(None);
    };
    let location = HeaderValue::try_from(url).map_err(|error| {
        tracing::error!(%error, "a signed address is no valid header value");
        Problem::new(Kind::Internal, "The download could not be redirected.")
    })?;
    state.metrics.bytes_out(file.bytes);
    let headers = [(header::LOCATION, location), (header::CACHE_CONTROL, HeaderValue::from_static("no-store"))];
    Ok(Some((StatusCode::TEMPORARY_REDIRECT, headers).into_response()))
}

/// Report of a model: the content of `report.json`, and the backend that computed the model.
#[derive(serde::Serialize, utoipa::ToSchema)]
pub(super) struct Report {
    /// Backend that computed the model. Absent in the file, whose bytes are the same on any
    /// machine.
    backend: BackendReport,
    /// SHA-256 of the canonical spec (without `solver.search`), the seed and the engine version, as
    /// in the model.
    digest: String,
    /// Preset that the spec was resolved on.
    preset: String,
    /// Seed.
    #[schema(minimum = 0, maximum = 9007199254740991i64)]
    seed: u64,
    /// The members of `report.json`.
    #[serde(flatten)]
    #[schema(value_type = crate::generate::Report<'static>)]
    stored: Map<String, Value>,
}

/// Read the report of a model: its certificate, its summary and the backend that computed it.
///
/// The report has all members of `report.json`.
#[utoipa::path(
    get, path = "/models/{id}/report", operation_id = "get_report", tag = "files",
    params(
        ("id" = Uuid, Path, description = "Id of the model"),
        ("if-none-match" = Option<String>, Header, description = "Entity tags that the client has"),
    ),
    responses(
        (status = 200, description = "The report", body = Report, headers(
            ("etag" = String, description = "SHA-256 of the report"))),
        (status = 304, description = "The client has this file"),
        FileMissing, DownloadUnavailable,
    )
)]
pub(in crate::http) async fn report(
    State(state): State<AppState>,
    caller: Caller,
    ModelId(id): ModelId,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let (job, file) = find(&state, &caller, id, "report.json").await?;
    let _permit = permit(&state, &caller)?;
    let mut stored: Map<String, Value> = serde_json::from_slice(&whole(&state, &file).await?).map_err(|error| {
        tracing::error!(%error, "a stored report is damaged");
        Problem::new(Kind::Internal, "The stored report is damaged.")
    })?;
    for own in ["backend", "digest", "preset", "seed"] {
        stored.remove(own);
    }
    let report = Report { backend: job.backend, digest: job.digest, preset: job.preset, seed: job.seed, stored };
    immutable_json(&headers, serde_json::to_vec(&report).expect("a report has string keys only"))
}

/// A JSON document that never changes.
fn immutable_json(headers: &HeaderMap, body: Vec<u8>) -> Result<Response, Problem> {
    let tag = ETag::strong(hex::encode(Sha256::digest(&body)));
    if tag.matches_none(headers) {
        return tag.not_modified(IMMUTABLE);
    }
    let json = HeaderValue::from_static("application/json");
    let headers = [(header::CONTENT_TYPE, json), (header::ETAG, tag.header()?), (header::CACHE_CONTROL, IMMUTABLE)];
    Ok((headers, body).into_response())
}

/// Read the manifest of a model: its files and their origin.
///
/// The manifest contains name, size, hash, body, unit and patches of each file, and the origin of
/// the model: spec, seed, digest, engine, licence and citation. `oviduct generate` writes the same
/// manifest next to the files.
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
        FileMissing, StoresUnavailable,
    )
)]
pub(in crate::http) async fn manifest(
    State(state): State<AppState>,
    caller: Caller,
    ModelId(id): ModelId,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    // A model with a report has all of its files.
    let (job, _) = find(&state, &caller, id, "report.json").await?;
    let body = serde_json::to_vec_pretty(&manifest_of(&job)).expect("a manifest has string keys only");
    let mut response = immutable_json(&headers, body)?;
    if response.status() == StatusCode::OK
        && let Ok(value) = HeaderValue::try_from(format!("inline; filename=\"{MANIFEST}\""))
    {
        response.headers_mut().insert(header::CONTENT_DISPOSITION, value);
    }
    Ok(response)
}

/// The manifest follows from the record: a reused model can have fewer files than the one that it
/// reuses.
fn manifest_of(job: &Job) -> Manifest {
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
        spec: job.spec.value().clone(),
    };
    Manifest::new(origin, &job.outputs, &job.files.iter().map(file).collect::<Vec<_>>())
}

/// Opens a file, or its bytes in `range`. A whole file is compared with its record while it is
/// read; if it is damaged, the stream ends with an error before the last bytes.
pub(in crate::http) async fn open(
    state: &AppState,
    file: &File,
    range: Option<Range<u64>>,
) -> Result<Chunks, ArtifactError> {
    let metrics = state.metrics.clone();
    let noted = move |error: &ArtifactError| {
        if matches!(error, ArtifactError::Damaged { .. }) {
            metrics.damaged_file();
            tracing::error!(
                %error,
                "a stored file differs from its record, so its response was refused or cut off; compare all files with \
                 `oviduct scrub`"
            );
        }
    };
    let chunks = state.artifacts.open(file, range).await.inspect_err(&noted)?;
    Ok(chunks.inspect_err(noted).boxed())
}

/// Reads a whole file and compares it with its record.
pub(in crate::http) async fn whole(state: &AppState, file: &File) -> Result<Bytes, Problem> {
    let chunks: Vec<Bytes> = open(state, file, None).await?.try_collect().await?;
    Ok(chunks.concat().into())
}

/// Permit for a download, until all clones are dropped.
pub(in crate::http) type DownloadPermit = Arc<Share>;

/// A permit for one more concurrent download.
pub(in crate::http) fn permit(state: &AppState, caller: &Caller) -> Result<DownloadPermit, Problem> {
    state.downloads.take(caller.owner(), 1).map(Arc::new).map_err(|exhausted| {
        let (limit, callers) = (exhausted.limit(), exhausted.callers());
        let detail = format!("{limit} downloads are running {callers}, which is the limit. Try again later.");
        Problem::new(Kind::TooManyDownloads, detail).with_header(header::RETRY_AFTER, 5)
    })
}

/// A body whose permit is held until the last byte is sent or the connection is closed.
pub(in crate::http) fn body_with_permit<E>(
    stream: impl Stream<Item = Result<Bytes, E>> + Send + 'static,
    permit: DownloadPermit,
) -> Body
where
    E: Into<axum::BoxError> + 'static,
{
    Body::from_stream(stream.inspect(move |_| {
        let _ = &permit;
    }))
}

/// A model that the caller may see.
pub(in crate::http) async fn find_model(state: &AppState, caller: &Caller, id: JobId) -> Result<Job, Problem> {
    caller.model(state.store.get(id).await?).ok_or_else(|| no_model(id))
}

/// A model and its file `name`.
pub(in crate::http) async fn find(
    state: &AppState,
    caller: &Caller,
    id: JobId,
    name: &str,
) -> Result<(Job, File), Problem> {
    let job = find_model(state, caller, id).await?;
    let file = file_of(&job, name)?;
    Ok((job, file))
}

/// The file `name` of a model.
pub(in crate::http) fn file_of(job: &Job, name: &str) -> Result<File, Problem> {
    job.files.iter().find(|file| file.name == name).cloned().ok_or_else(|| {
        let detail = if job.status.is_ended() {
            let names: Vec<_> = job.files.iter().map(|file| file.name.as_str()).collect();
            format!("The model has the files [{}].", names.join(", "))
        } else {
            "The model has not ended. Its files are available after its end.".to_owned()
        };
        Problem::new(Kind::FileNotFound, detail)
    })
}

async fn send(
    state: &AppState,
    caller: &Caller,
    file: &File,
    method: &Method,
    headers: &HeaderMap,
) -> Result<Response, Problem> {
    let tag = ETag::strong(&file.sha256);
    if tag.matches_none(headers) {
        return tag.not_modified(IMMUTABLE);
    }
    // Ranges are defined for GET only (RFC 9110, section 14.2).
    let requested = headers.get(header::RANGE).and_then(|v| v.to_str().ok());
    let requested = requested.filter(|_| method == Method::GET && tag.matches_range(headers));
    let (status, range) = match select(requested, file.bytes) {
        Selection::Whole => (StatusCode::OK, 0..file.bytes),
        Selection::Part(range) => (StatusCode::PARTIAL_CONTENT, range),
        Selection::Outside => {
            let problem = Problem::new(Kind::RangeNotSatisfiable, format!("The file has {} bytes.", file.bytes));
            return Err(problem.with_header(header::CONTENT_RANGE, format!("bytes */{}", file.bytes)));
        }
    };
    let body = if method == Method::HEAD {
        Body::empty()
    } else {
        let part = (status == StatusCode::PARTIAL_CONTENT).then(|| range.clone());
        let permit = permit(state, caller)?;
        let stream = open(state, file, part).await?;
        state.metrics.bytes_out(range.end - range.start);
        body_with_permit(stream, permit)
    };
    let mut response = (status, body).into_response();
    let out = response.headers_mut();
    out.insert(header::CONTENT_TYPE, media_type(file));
    out.insert(header::CONTENT_LENGTH, HeaderValue::from(range.end - range.start));
    out.insert(header::ETAG, tag.header()?);
    out.insert(header::ACCEPT_RANGES, HeaderValue::from_static("bytes"));
    out.insert(header::CACHE_CONTROL, IMMUTABLE);
    if status == StatusCode::PARTIAL_CONTENT
        && let Ok(value) = HeaderValue::try_from(format!("bytes {}-{}/{}", range.start, range.end - 1, file.bytes))
    {
        out.insert(header::CONTENT_RANGE, value);
    }
    Ok(response)
}

fn media_type(file: &File) -> HeaderValue {
    HeaderValue::try_from(&file.media_type).unwrap_or(HeaderValue::from_static("application/octet-stream"))
}

/// A file that a record names is missing only if the model was deleted in the meantime.
impl From<ArtifactError> for Problem {
    fn from(error: ArtifactError) -> Self {
        match error {
            ArtifactError::NotFound { .. } => {
                tracing::warn!(%error, "a file is missing");
                Self::new(Kind::FileNotFound, "The file is missing. The model may have been deleted a moment ago.")
            }
            ArtifactError::Jobs(error) => error.into(),
            // Logged where the file was opened.
            ArtifactError::Damaged { .. } => Self::new(Kind::Internal, "The stored file is damaged."),
            other => {
                tracing::error!(error = %other, "the artifact store failed");
                Self::new(Kind::StorageUnavailable, "The artifact store is unavailable. Try again later.")
                    .with_header(header::RETRY_AFTER, 5)
            }
        }
    }
}
