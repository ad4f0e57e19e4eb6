//! `GET /models/{id}/report.html`: the report of a model as a page, created on request like a
//! picture.

use super::draw::{A_DAY, DrawError, picture};
use super::preview::sections_in_view;
use super::{sections, surfaces};
use crate::http::AppState;
use crate::http::access::Caller;
use crate::http::models::files::{file_of, find, permit, whole};
use crate::http::wire::blocking::blocking;
use crate::http::wire::conditional::ETag;
use crate::http::wire::extract::ModelId;
use crate::http::wire::problem::Problem;
use crate::http::wire::responses::{FileMissing, PictureUnavailable};
use crate::http::wire::shares::Turn;
use crate::jobs::{File, Job};
use crate::model::Section;
use crate::preview::tube as tube_of;
use crate::report::{self, Strip};
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, Method, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;

/// The page contains its style and pictures. It loads nothing else and runs no scripts.
const POLICY: HeaderValue =
    HeaderValue::from_static("default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'");

/// Read the report of a model as a page for display or printing.
///
/// The page is a single HTML file that loads no other files. It contains the cut-open tube, a strip
/// of sections (cuts of the surface if it leans), measures next to published anatomy and along the
/// tube, the certificate, all parameters with their sources, and the citation of the model. The
/// service creates it from `report.json`, `sections.bin` and, if the surface leans, the surface.
/// The same version of the service always creates the same page.
#[utoipa::path(
    get, path = "/models/{id}/report.html", operation_id = "get_report_page", tag = "files",
    params(
        ("id" = Uuid, Path, description = "Id of the model"),
        ("if-none-match" = Option<String>, Header, description = "Entity tags that the client has"),
    ),
    responses(
        (status = 200, description = "The page", content_type = "text/html", body = String, headers(
            ("etag" = String, description = "Entity tag of the page"))),
        (status = 304, description = "The client has this page"),
        FileMissing, PictureUnavailable,
    )
)]
pub(in crate::http) async fn page(
    State(state): State<AppState>,
    caller: Caller,
    ModelId(id): ModelId,
    method: Method,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let (job, stored) = find(&state, &caller, id, "report.json").await?;
    let sections = file_of(&job, "sections.bin")?;
    let tag = ETag::strong(format_args!("{}-{}-page-{}", stored.sha256, sections.sha256, env!("CARGO_PKG_VERSION")));
    if tag.matches_none(&headers) {
        return tag.not_modified(A_DAY);
    }
    let spec = job.spec.clone();
    let html = picture(
        &state,
        &caller,
        &tag,
        |turn| read(&state, &caller, &job, &stored, &sections, turn),
        move |(stored, strip, tube)| {
            let tube = tube_of(&tube, &spec)?;
            Ok(report::html(&stored, &strip, &tube).map_err(DrawError::Page)?.into_bytes())
        },
    )
    .await?;
    if method == Method::GET {
        state.metrics.bytes_out(html.len() as u64);
    }
    let kind = HeaderValue::from_static(report::MEDIA_TYPE);
    let name = format!("inline; filename=\"{}-{}-report.html\"", job.preset, job.seed);
    let headers = [
        (header::CONTENT_TYPE, kind),
        (header::CONTENT_DISPOSITION, HeaderValue::try_from(name).unwrap_or(HeaderValue::from_static("inline"))),
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::ETAG, tag.header()?),
        (header::CACHE_CONTROL, A_DAY),
    ];
    Ok((headers, html).into_response())
}

/// Reads the stored report, the strip of sections, and the sections for the picture of the tube. If
/// the surface leans and can be cut, the strip shows cuts.
async fn read(
    state: &AppState,
    caller: &Caller,
    job: &Job,
    stored: &File,
    sections_bin: &File,
    turn: Turn,
) -> Result<(Bytes, Strip, Vec<Section>), Problem> {
    let tube = sections_in_view(state, caller, sections_bin, report::VIEW, report::PICTURE, turn.clone()).await?;
    let (stored, chosen) = {
        let _download = permit(state, caller)?;
        let entries = sections::read_index(state, sections_bin).await?;
        let z: Vec<f64> = entries.iter().map(|entry| entry.z_um).collect();
        let chosen = report::strip(&z).into_iter().map(|k| entries[k]).collect::<Vec<_>>();
        (whole(state, stored).await?, chosen)
    };
    if report::leans(&stored)
        && let Ok((file, format)) = surfaces::file(job)
    {
        let body = surfaces::read(state, caller, &file, format, &turn).await?;
        let z: Vec<f64> = chosen.iter().map(|entry| entry.z_um).collect();
        let spec = job.spec.clone();
        if let Some(strip) = blocking("Making the page", turn.clone(), move || Strip::of_cuts(&body, &z, &spec)).await?
        {
            return Ok((stored, strip, tube));
        }
    }
    let _download = permit(state, caller)?;
    let strip = sections::read_entries(state, sections_bin, chosen, turn).await?;
    Ok((stored, Strip::of_sections(&strip), tube))
}
