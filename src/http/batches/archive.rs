//! `GET /batches/{id}/archive`: a stream of the files of all models of a batch.
//!
//! The archive starts with `manifest.json`, which lists all models and the files that follow, from
//! the records at the time of the request. If a file is missing or the artifact store fails, the
//! service aborts the transfer. A body that ends without an error is therefore complete.

use super::pack::{ArchiveEntry, Packer};
use super::read::{each_model, find_batch};
use super::study::StoredStudy;
use crate::http::AppState;
use crate::http::access::Caller;
use crate::http::models::files::{DownloadPermit, body_with_permit, open, permit};
use crate::http::wire::extract::{BatchId, Parameters};
use crate::http::wire::faults::RequestFault;
use crate::http::wire::problem::Problem;
use crate::http::wire::responses::{BadParameters, BatchMissing, DownloadUnavailable};
use crate::jobs::artifacts::Chunks;
use crate::jobs::{Batch, File, Job};
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderValue, Method, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use futures_util::{StreamExt, TryStreamExt, stream};
use serde_json::{Map, Value, json};
use std::collections::BTreeSet;
use std::io;
use std::sync::Arc;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use utoipa::ToSchema;

/// Minimum size of a chunk of the body, in bytes, except for the last one.
const CHUNK: usize = 64 << 10;
/// Maximum number of chunks that wait for the client.
const MAX_WAITING_CHUNKS: usize = 2;
/// Name of the entry that lists all models and files.
const MANIFEST: &str = "manifest.json";
/// Files that every model has.
const COMMON_FILES: [&str; 2] = ["report.json", "sections.bin"];

/// Formats of archives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ToSchema)]
#[schema(rename_all = "lowercase")]
pub(in crate::http) enum ArchiveFormat {
    /// `application/zip`, without compression.
    Zip,
    /// `application/x-tar`.
    Tar,
}

/// Download files of all models of a batch as one archive.
///
/// The first entry, `manifest.json`, contains the id and the study of the batch. For each model, it
/// contains index, id, seed, status, spec, digest, varied values and problem, and path, size and
/// SHA-256 of each file. Models that have not succeeded have no files. If the service cannot read a
/// file, it aborts the transfer.
#[utoipa::path(
    get, path = "/batches/{id}/archive", operation_id = "get_batch_archive", tag = "batches",
    params(
        ("id" = Uuid, Path, description = "Id of the batch"),
        ("files" = Option<String>, Query, pattern = "^[^,]+(,[^,]+)*$",
            description = "Names of files, separated by commas, such as `report.json,model.glb`; all files by \
                default"),
        ("format" = Option<ArchiveFormat>, Query, description = "`zip` (the default) or `tar`"),
    ),
    responses(
        (status = 200, description = "The archive", headers(
            ("content-disposition" = String, description = "File name under which a client can save the response"))),
        BatchMissing, BadParameters, DownloadUnavailable,
    )
)]
pub(in crate::http) async fn archive(
    State(state): State<AppState>,
    caller: Caller,
    BatchId(id): BatchId,
    parameters: Parameters,
    method: Method,
) -> Result<Response, Problem> {
    let (names, format) = read_parameters(&parameters)?;
    let batch = find_batch(&state, &caller, id).await?;
    // The permit also bounds the number of manifests, which may take 32 MiB each.
    let permit = permit(&state, &caller)?;
    let contents = contents(&state, &batch, names.as_deref()).await?;
    let (media_type, extension) = match format {
        ArchiveFormat::Zip => ("application/zip", "zip"),
        ArchiveFormat::Tar => ("application/x-tar", "tar"),
    };
    let disposition = HeaderValue::try_from(format!("attachment; filename=\"batch-{id}.{extension}\""));
    let headers = [
        (header::CONTENT_TYPE, HeaderValue::from_static(media_type)),
        (header::CONTENT_DISPOSITION, disposition.unwrap_or(HeaderValue::from_static("attachment"))),
        (header::CACHE_CONTROL, HeaderValue::from_static("no-cache")),
    ];
    let body = if method == Method::HEAD { Body::empty() } else { body(&state, contents, format, permit).await? };
    Ok((headers, body).into_response())
}

/// Reads the names of the files, `None` for all, and the format.
fn read_parameters(parameters: &Parameters) -> Result<(Option<Vec<String>>, ArchiveFormat), Problem> {
    let mut faults = parameters.faults(&["files", "format"], &[]);
    let (mut files, mut format) = (None, ArchiveFormat::Zip);
    for (name, value) in &parameters.0 {
        match (name.as_str(), value.as_str()) {
            ("format", "zip") => format = ArchiveFormat::Zip,
            ("format", "tar") => format = ArchiveFormat::Tar,
            ("format", _) => faults.push(RequestFault::parameter("format", "must be zip or tar")),
            ("files", "") => faults.push(RequestFault::parameter("files", "must name at least one file")),
            ("files", names) => files = Some(names.split(',').map(str::to_owned).collect()),
            _ => {}
        }
    }
    Problem::check(faults)?;
    Ok((files, format))
}

/// Entries of an archive.
struct ArchiveContents {
    manifest: (ArchiveEntry, Vec<u8>),
    /// The other entries, each with its file.
    files: Vec<(ArchiveEntry, File)>,
}

/// The manifest and the files with these names, or all files.
async fn contents(state: &AppState, batch: &Batch, names: Option<&[String]>) -> Result<ArchiveContents, Problem> {
    let study = StoredStudy::of(batch);
    let mut files = Vec::new();
    let mut manifest = BatchManifest::begin(batch, study.as_ref());
    let mut known: BTreeSet<String> = COMMON_FILES.map(str::to_owned).into();
    each_model(state, batch, |place, job| {
        known.extend(job.outputs.files());
        known.extend(job.files.iter().map(|file| file.name.clone()));
        let chosen = |file: &&File| names.is_none_or(|names| names.contains(&file.name));
        let chosen: Vec<&File> = job.files.iter().filter(chosen).collect();
        files.extend(chosen.iter().map(|file| (entry(place, job, file), (*file).clone())));
        manifest.add(&manifest_model(study.as_ref(), place, job, &chosen));
    })
    .await?;
    if let Some(unknown) = names.into_iter().flatten().find(|name| !known.contains(*name)) {
        let known: Vec<&str> = known.iter().map(String::as_str).collect();
        let unknown: String = unknown.chars().take(100).collect();
        let detail = format!("`{unknown}`: no model of the batch has it; known are {}", known.join(", "));
        return Err(Problem::invalid([RequestFault::parameter("files", detail)]));
    }
    let manifest = manifest.end();
    let entry = ArchiveEntry { path: MANIFEST.to_owned(), bytes: manifest.len() as u64, modified: batch.created_at };
    Ok(ArchiveContents { manifest: (entry, manifest), files })
}

/// The manifest as JSON text, with a line per model. As values it would take ten times the memory.
struct BatchManifest {
    text: Vec<u8>,
    models: usize,
}

impl BatchManifest {
    fn begin(batch: &Batch, study: Option<&StoredStudy>) -> Self {
        let (id, at, vary) = (json!(batch.id), json!(batch.created_at), json!(study.map(|study| &study.vary)));
        let text = format!("{{\"batch\":{id},\"created_at\":{at},\"vary\":{vary},\"models\":[");
        Self { text: text.into_bytes(), models: 0 }
    }

    fn add(&mut self, model: &Value) {
        self.text.extend_from_slice(if self.models == 0 { b"\n" } else { b",\n" });
        serde_json::to_writer(&mut self.text, model).expect("a model has string keys only");
        self.models += 1;
    }

    fn end(mut self) -> Vec<u8> {
        self.text.extend_from_slice(b"\n]}\n");
        self.text
    }
}

fn entry(place: u32, job: &Job, file: &File) -> ArchiveEntry {
    let modified = job.finished_at.unwrap_or(job.created_at);
    ArchiveEntry { path: path(place, job, file), bytes: file.bytes, modified }
}

fn path(place: u32, job: &Job, file: &File) -> String {
    format!("{place:04}-{}/{}", job.id, file.name)
}

/// A model in the manifest.
fn manifest_model(study: Option<&StoredStudy>, place: u32, job: &Job, files: &[&File]) -> Value {
    let file = |file: &&File| {
        json!({
            "path": path(place, job, file), "name": file.name, "media_type": file.media_type, "bytes": file.bytes,
            "sha256": file.sha256,
        })
    };
    json!({
        "index": place,
        "id": job.id,
        "status": job.status,
        "preset": job.preset,
        "seed": job.seed,
        "values": study.map_or_else(Map::new, |study| study.named(place)),
        "spec": job.spec,
        "digest": job.digest,
        "engine": job.engine,
        "problem": job.problem,
        "files": files.iter().map(file).collect::<Vec<_>>(),
    })
}

/// The archive as a body. Opens the first file in advance, so that an unavailable artifact store
/// results in a problem.
async fn body(
    state: &AppState,
    contents: ArchiveContents,
    format: ArchiveFormat,
    permit: DownloadPermit,
) -> Result<Body, Problem> {
    let first = match contents.files.first() {
        Some((_, file)) => Some(open(state, file, None).await?),
        None => None,
    };
    state.metrics.bytes_out(contents.files.iter().fold(contents.manifest.0.bytes, |sum, (entry, _)| sum + entry.bytes));
    let (sender, receiver) = mpsc::channel(MAX_WAITING_CHUNKS);
    let packer = match format {
        ArchiveFormat::Zip => Packer::zip(),
        ArchiveFormat::Tar => Packer::tar(),
    };
    let client = sender.clone();
    let packing = pack(state.clone(), packer, contents, first, sender, Arc::clone(&permit));
    let packing = tokio::spawn(async move {
        // A client that disconnects gives its permit back, even while the artifact store hangs.
        tokio::select! {
            packed = packing => packed,
            () = client.closed() => Ok(()),
        }
    });
    // The channel closes even if packing fails or panics. The body must then end with an error.
    let end = stream::once(async move {
        match packing.await {
            Ok(Ok(())) => Ok(Bytes::new()),
            Ok(Err(error)) => Err(error),
            Err(error) => Err(io::Error::other(error)),
        }
        .inspect_err(|error| tracing::error!(%error, "an archive was broken off"))
    });
    Ok(body_with_permit(ReceiverStream::new(receiver).map(Ok).chain(end), permit))
}

/// Sends an archive in chunks. Ends without an error if the client disconnects.
async fn pack(
    state: AppState,
    mut packer: Packer,
    ArchiveContents { manifest: (entry, manifest), files }: ArchiveContents,
    mut first: Option<Chunks>,
    sender: mpsc::Sender<Bytes>,
    _permit: DownloadPermit,
) -> io::Result<()> {
    packer.begin(&entry)?;
    for chunk in manifest.chunks(CHUNK) {
        packer.write(chunk)?;
        if packer.ready() >= CHUNK && sender.send(packer.take()).await.is_err() {
            return Ok(());
        }
    }
    drop(manifest);
    for (entry, file) in files {
        packer.begin(&entry)?;
        let mut chunks = match first.take() {
            Some(chunks) => chunks,
            None => open(&state, &file, None).await.map_err(io::Error::other)?,
        };
        while let Some(chunk) = chunks.try_next().await.map_err(io::Error::other)? {
            packer.write(&chunk)?;
            if packer.ready() >= CHUNK && sender.send(packer.take()).await.is_err() {
                return Ok(());
            }
        }
    }
    let last = packer.finish()?;
    // Fails only if the client has disconnected.
    let _ = sender.send(last).await;
    Ok(())
}
