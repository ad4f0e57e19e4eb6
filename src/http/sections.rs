//! `GET /models/{id}/sections/{k}`: one cross section, as JSON or as a drawing.
//!
//! Reads only the trailer, the index and this section from the artifact store, never the whole file.

use super::AppState;
use super::access::Caller;
use super::conditional::ETag;
use super::extract::{ModelId, Parameters, PathTexts};
use super::faults::Fault;
use super::files::{IMMUTABLE, find, permit};
use super::headers::accept;
use super::problem::{Kind, Problem};
use super::responses::{BadParameters, DownloadAway, Inacceptable, SectionMissing};
use crate::export::sections_bin::{SectionEntry, SectionsError, TRAILER_LEN, Trailer, read_section_from_bytes};
use crate::export::svg::section_svg;
use crate::jobs::File;
use crate::model::{Ring, Section};
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use serde::Serialize;
use std::ops::Range;
use utoipa::ToSchema;
use uuid::Uuid;

const JSON: &str = "application/json";
const SVG: &str = "image/svg+xml";

/// Representations of a section.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ToSchema)]
#[schema(rename_all = "lowercase")]
pub(super) enum Format {
    /// `application/json`.
    Json,
    /// `image/svg+xml`.
    Svg,
}

/// A cross section; lengths in micrometres.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct SectionAnswer {
    /// Id of the model.
    model: Uuid,
    /// Index among the sections of the model, from 0 at the isthmus end.
    #[schema(minimum = 0)]
    index: u64,
    /// Number of sections of the model.
    #[schema(minimum = 0)]
    count: u64,
    /// Unit of lengths: `um`.
    units: String,
    /// Time step; fractional if the section was added to mend a slab.
    step: f64,
    /// Position along the tube.
    z_um: f64,
    /// Whether the section was added to mend a slab.
    added: bool,
    /// Boundary of the lumen.
    inner: RingAnswer,
    /// Boundary of the tissue.
    outer: RingAnswer,
}

/// A closed contour, counter-clockwise.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct RingAnswer {
    /// Ids of the particles, one per point. A particle has the same id in every section.
    ids: Vec<u32>,
    /// Points, micrometres.
    points: Vec<[f32; 2]>,
}

impl From<Ring> for RingAnswer {
    fn from(ring: Ring) -> Self {
        Self { ids: ring.ids, points: ring.points }
    }
}

/// Read a cross section of a finished model.
///
/// As points with the ids of particles, or as a drawing.
#[utoipa::path(
    get, path = "/models/{id}/sections/{k}", operation_id = "get_section", tag = "files",
    params(
        ("id" = Uuid, Path, description = "Id of the model"),
        ("k" = u32, Path, minimum = 0, description = "Index of the section, from 0 at the isthmus end"),
        ("format" = Option<Format>, Query, description = "`json` or `svg`; takes precedence over `Accept`"),
        ("if-none-match" = Option<String>, Header, description = "Entity tags that the client has"),
    ),
    responses(
        (status = 200, description = "The section", content(
            (SectionAnswer = "application/json"),
            (String = "image/svg+xml"))),
        (status = 304, description = "The client has this section"),
        SectionMissing, Inacceptable, BadParameters, DownloadAway,
    )
)]
pub(super) async fn section(
    State(state): State<AppState>,
    caller: Caller,
    ModelId(id): ModelId,
    path: PathTexts,
    parameters: Parameters,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let format = format(&parameters, &headers)?;
    let (_, file) = find(&state, &caller, id, "sections.bin").await?;
    let _permit = permit(&state)?;
    let k = path.get("k");
    let k = k.parse::<u64>().map_err(|_| no_section(&format!("`{k}` is not the index of a section.")))?;
    let tag = ETag::strong(format_args!("{}-{k}-{}", file.sha256, if format == Format::Svg { "svg" } else { "json" }));
    let (count, section) = read(&state, &file, k).await?;
    let vary = (header::VARY, HeaderValue::from_static("accept"));
    if tag.matches_none(&headers) {
        return Ok(([vary], tag.not_modified(IMMUTABLE)?).into_response());
    }
    let headers = [(header::ETAG, tag.header()?), (header::CACHE_CONTROL, IMMUTABLE), vary];
    if format == Format::Svg {
        let kind = (header::CONTENT_TYPE, HeaderValue::from_static(SVG));
        return Ok((headers, [kind], section_svg(&section)).into_response());
    }
    let answer = SectionAnswer {
        model: id.0,
        index: k,
        count,
        units: "um".into(),
        step: section.step,
        z_um: section.z_um,
        added: section.added,
        inner: section.inner.into(),
        outer: section.outer.into(),
    };
    Ok((headers, Json(answer)).into_response())
}

fn format(parameters: &Parameters, headers: &HeaderMap) -> Result<Format, Problem> {
    let mut faults = parameters.faults(&["format"], &[]);
    let format = match parameters.get("format") {
        Some("json") => Some(Format::Json),
        Some("svg") => Some(Format::Svg),
        Some(_) => {
            faults.push(Fault::parameter("format", "must be json or svg"));
            None
        }
        None => accept(headers, &[JSON, SVG]).map(|best| if best == SVG { Format::Svg } else { Format::Json }),
    };
    if !faults.is_empty() {
        return Err(Problem::invalid(faults));
    }
    format.ok_or_else(|| Problem::new(Kind::NotAcceptable, format!("The representations are {JSON} and {SVG}.")))
}

fn no_section(detail: &str) -> Problem {
    Problem::new(Kind::SectionNotFound, detail)
}

/// The number of sections in `file`, and the one of index `k`.
async fn read(state: &AppState, file: &File, k: u64) -> Result<(u64, Section), Problem> {
    let entries = read_index(state, file).await?;
    let entry = usize::try_from(k).ok().and_then(|k| entries.get(k).copied());
    let entry =
        entry.ok_or_else(|| no_section(&format!("The model has {} sections; indices start at 0.", entries.len())))?;
    let mut sections = read_entries(state, file, vec![entry]).await?;
    let section = sections.pop().ok_or_else(|| damaged(&SectionsError::Corrupt("a section")))?;
    Ok((entries.len() as u64, section))
}

/// The index of a `sections.bin`; its sections are not read.
pub(super) async fn read_index(state: &AppState, file: &File) -> Result<Vec<SectionEntry>, Problem> {
    let end = file.bytes.checked_sub(TRAILER_LEN as u64).ok_or_else(|| damaged(&SectionsError::NotSections))?;
    let tail = part(state, file, end..file.bytes).await?;
    let tail = tail[..].try_into().map_err(|_| damaged(&SectionsError::NotSections))?;
    let trailer = Trailer::parse(tail, file.bytes).map_err(|error| damaged(&error))?;
    if trailer.count == 0 {
        return Ok(Vec::new());
    }
    let index = part(state, file, trailer.index_offset..end).await?;
    trailer.parse_index(&index).map_err(|error| damaged(&error))
}

/// Sections of a `sections.bin` by their entries in its index; no others are read.
pub(super) async fn read_entries(
    state: &AppState,
    file: &File,
    entries: Vec<SectionEntry>,
) -> Result<Vec<Section>, Problem> {
    let range = |entry: &SectionEntry| entry.offset..entry.offset + u64::from(entry.length);
    let ranges: Vec<Range<u64>> = entries.iter().map(range).collect();
    let parts = state.artifacts.get_ranges(&file.key, &ranges).await?;
    let read = tokio::task::spawn_blocking(move || {
        entries.iter().zip(parts).map(|(entry, bytes)| read_section_from_bytes(entry, &bytes)).collect()
    });
    let sections: Result<Vec<Section>, SectionsError> = read.await.map_err(|error| {
        tracing::error!(%error, "sections could not be read");
        Problem::new(Kind::Internal, "The sections could not be read.")
    })?;
    sections.map_err(|error| damaged(&error))
}

async fn part(state: &AppState, file: &File, range: Range<u64>) -> Result<Bytes, Problem> {
    let parts = state.artifacts.get_ranges(&file.key, &[range]).await?;
    parts.into_iter().next().ok_or_else(|| damaged(&SectionsError::NotSections))
}

fn damaged(error: &SectionsError) -> Problem {
    tracing::error!(%error, "a stored sections.bin is damaged");
    Problem::new(Kind::Internal, "The stored sections are damaged.")
}
