//! `GET /models/{id}/sections/{k}`: a cross section, as JSON, as a drawing, or as a stained or
//! labelled picture.
//!
//! Only the trailer, the index and this section are read from the artifact store.

use super::slides::{PARAMETERS, SlideSource, SlideStyle, Stain, respond};
use crate::export::sections_bin::{SectionEntry, SectionsError, TRAILER_LEN, Trailer, read_section_from_bytes};
use crate::export::svg::section_svg;
use crate::http::AppState;
use crate::http::access::Caller;
use crate::http::models::files::{IMMUTABLE, find, permit};
use crate::http::wire::blocking::blocking;
use crate::http::wire::conditional::ETag;
use crate::http::wire::extract::{ModelId, Parameters, PathTexts};
use crate::http::wire::faults::{Faults, RequestFault};
use crate::http::wire::headers::accept;
use crate::http::wire::problem::{Kind, Problem};
use crate::http::wire::responses::{BadParameters, PictureUnavailable, SectionMissing, Unacceptable};
use crate::http::wire::shares::Turn;
use crate::jobs::File;
use crate::model::{Ring, Section};
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, Method, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use serde::Serialize;
use std::ops::Range;
use utoipa::ToSchema;
use uuid::Uuid;

/// Description of the parameter `format`.
pub(super) const FORMAT_DESCRIPTION: &str = "`json`, `svg` or `png`; takes precedence over `Accept`. `size`, `stain` \
    and `labels` request `png`";

const JSON: &str = "application/json";
pub(super) const SVG: &str = "image/svg+xml";
const PNG: &str = crate::render::MEDIA_TYPE;

/// Representations of a section.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ToSchema)]
#[schema(as = Format, rename_all = "lowercase")]
pub(in crate::http) enum SectionFormat {
    /// `application/json`.
    Json,
    /// `image/svg+xml`.
    Svg,
    /// `image/png`.
    Png,
}

/// A section of a model. Lengths are in micrometres.
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
    /// True if the section was added to mend a slab.
    added: bool,
    /// Boundary of the lumen.
    inner: RingAnswer,
    /// Boundary of the tissue.
    outer: RingAnswer,
}

/// A PNG picture.
#[derive(Debug, ToSchema)]
#[schema(value_type = String, format = Binary)]
#[expect(dead_code, reason = "for the description only")]
pub(super) struct Png(Vec<u8>);

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

/// Read a section of a finished model.
///
/// Sections come from the simulation, before the surface leans; `/models/{id}/cut` cuts the surface
/// itself.
///
/// A section is available as points with the ids of particles, as a drawing, or as a picture. A
/// picture is either stained with haematoxylin and eosin, or has the tissue of each pixel as its
/// value: 0 outside, 1 lumen, 2 epithelium, 3 lamina propria, 4 circular muscle, 5 longitudinal
/// muscle, 6 serosa, 7 subserosa, 8 inner longitudinal muscle, 9 vessel. Both pictures have the
/// same pixels. `histology` in the spec defines the layers.
#[utoipa::path(
    get, path = "/models/{id}/sections/{k}", operation_id = "get_section", tag = "files",
    params(
        ("id" = Uuid, Path, description = "Id of the model"),
        ("k" = u32, Path, minimum = 0, description = "Index of the section, from 0 at the isthmus end"),
        ("format" = Option<SectionFormat>, Query, description = FORMAT_DESCRIPTION),
        ("size" = Option<u32>, Query, minimum = 32, maximum = 2048, description = "Longer side of a PNG picture, pixels; 1024 by default"),
        ("stain" = Option<Stain>, Query, description = "Stain of a PNG picture: `he`, haematoxylin and eosin, the default"),
        ("labels" = Option<bool>, Query, description = "`true`: the tissue of each pixel as an 8-bit grey value, without a scale bar, instead of a stain"),
        ("if-none-match" = Option<String>, Header, description = "Entity tags that the client has"),
    ),
    responses(
        (status = 200, description = "The section", content(
            (SectionAnswer = "application/json"),
            (String = "image/svg+xml"),
            (Png = "image/png")), headers(
            ("etag" = String, description = "Entity tag of this representation"),
            ("um-per-pixel" = f64, description = "Side of a pixel of a PNG picture, µm. The `pHYs` chunk of the \
                picture has the pixels per metre"))),
        (status = 304, description = "The client has this section"),
        SectionMissing, Unacceptable, BadParameters, PictureUnavailable,
    )
)]
pub(in crate::http) async fn section(
    State(state): State<AppState>,
    caller: Caller,
    ModelId(id): ModelId,
    path: PathTexts,
    parameters: Parameters,
    method: Method,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let [size, stain, labels] = PARAMETERS;
    let faults = parameters.faults(&["format", size, stain, labels], &[]);
    let (format, style) = representation(&parameters, &headers, faults)?;
    let (job, file) = find(&state, &caller, id, "sections.bin").await?;
    let k = path.get("k");
    let k = k.parse::<u64>().map_err(|_| no_section(&format!("`{k}` is not the index of a section.")))?;
    if format == SectionFormat::Png {
        let key = format!("{}-{k}", file.sha256);
        let source = SlideSource { job: &job, key: &key, index: u32::try_from(k).unwrap_or(u32::MAX) };
        let read = |turn: Turn| {
            let (state, caller, file) = (&state, &caller, &file);
            async move {
                let _permit = permit(state, caller)?;
                let section = read(state, file, k, turn).await?.1;
                Ok((section.borders(), Some(section.z_um)))
            }
        };
        let mut response = respond(&state, &caller, source, style, &method, &headers, read).await?;
        response.headers_mut().insert(header::VARY, HeaderValue::from_static("accept"));
        return Ok(response);
    }
    let permit = permit(&state, &caller)?;
    let tag =
        ETag::strong(format_args!("{}-{k}-{}", file.sha256, if format == SectionFormat::Svg { "svg" } else { "json" }));
    let (count, section) = read(&state, &file, k, permit).await?;
    let vary = (header::VARY, HeaderValue::from_static("accept"));
    if tag.matches_none(&headers) {
        return Ok(([vary], tag.not_modified(IMMUTABLE)?).into_response());
    }
    let headers = [(header::ETAG, tag.header()?), (header::CACHE_CONTROL, IMMUTABLE), vary];
    if format == SectionFormat::Svg {
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

/// Reads the representation, and the style of a picture. Fails if there are `faults`, including
/// earlier ones.
pub(super) fn representation(
    parameters: &Parameters,
    headers: &HeaderMap,
    mut faults: Faults,
) -> Result<(SectionFormat, SlideStyle), Problem> {
    let picture_parameter = PARAMETERS.into_iter().find(|name| parameters.get(name).is_some());
    let offers: &[&str] = if picture_parameter.is_some() { &[PNG] } else { &[JSON, SVG, PNG] };
    let format = match parameters.get("format") {
        Some("json") => Some(SectionFormat::Json),
        Some("svg") => Some(SectionFormat::Svg),
        Some("png") => Some(SectionFormat::Png),
        Some(_) => {
            faults.push(RequestFault::parameter("format", "must be json, svg or png"));
            None
        }
        None => accept(headers, offers).map(|best| match best {
            SVG => SectionFormat::Svg,
            PNG => SectionFormat::Png,
            _ => SectionFormat::Json,
        }),
    };
    if let (Some(name), Some(SectionFormat::Json | SectionFormat::Svg)) = (picture_parameter, format) {
        faults.push(RequestFault::parameter(name, "is for pictures only (format=png)"));
    }
    let style = SlideStyle::read(parameters, &mut faults);
    Problem::check(faults)?;
    let offers = offers.join(", ");
    let format = format.ok_or_else(|| Problem::new(Kind::NotAcceptable, format!("It is served as {offers}.")))?;
    Ok((format, style))
}

fn no_section(detail: &str) -> Problem {
    Problem::new(Kind::SectionNotFound, detail)
}

/// Reads the section with the index `k`, and drops `held` after that. Returns the number of
/// sections, too.
async fn read(state: &AppState, file: &File, k: u64, held: impl Send + 'static) -> Result<(u64, Section), Problem> {
    let entries = read_index(state, file).await?;
    let entry = usize::try_from(k).ok().and_then(|k| entries.get(k).copied());
    let entry =
        entry.ok_or_else(|| no_section(&format!("The model has {} sections; indices start at 0.", entries.len())))?;
    let mut sections = read_entries(state, file, vec![entry], held).await?;
    let section = sections.pop().ok_or_else(|| damaged(&SectionsError::Corrupt("a section")))?;
    Ok((entries.len() as u64, section))
}

/// Reads the index of a `sections.bin`.
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

/// Reads the sections of a `sections.bin` that have these entries in its index, and drops `held`
/// after that.
pub(super) async fn read_entries(
    state: &AppState,
    file: &File,
    entries: Vec<SectionEntry>,
    held: impl Send + 'static,
) -> Result<Vec<Section>, Problem> {
    let range = |entry: &SectionEntry| entry.offset..entry.offset + u64::from(entry.length);
    let ranges: Vec<Range<u64>> = entries.iter().map(range).collect();
    let parts = state.artifacts.get_ranges(file, &ranges).await?;
    let read = move || entries.iter().zip(parts).map(|(entry, bytes)| read_section_from_bytes(entry, &bytes)).collect();
    let sections: Result<Vec<Section>, SectionsError> = blocking("Reading the sections", held, read).await?;
    sections.map_err(|error| damaged(&error))
}

async fn part(state: &AppState, file: &File, range: Range<u64>) -> Result<Bytes, Problem> {
    let parts = state.artifacts.get_ranges(file, &[range]).await?;
    parts.into_iter().next().ok_or_else(|| damaged(&SectionsError::NotSections))
}

fn damaged(error: &SectionsError) -> Problem {
    tracing::error!(%error, "a stored sections.bin is damaged");
    Problem::new(Kind::Internal, "The stored sections are damaged.")
}
