//! Sections as PNG: stained, or as label images; see docs/histology.md.

use super::draw::{A_DAY, DrawError, SIZE, answer, picture, size};
use crate::http::AppState;
use crate::http::access::Caller;
use crate::http::wire::conditional::ETag;
use crate::http::wire::extract::Parameters;
use crate::http::wire::faults::{Fault, Faults};
use crate::http::wire::headers::UM_PER_PIXEL;
use crate::http::wire::problem::{Kind, Problem};
use crate::jobs::Job;
use crate::model::Border;
use crate::render::{Slide, um_per_pixel};
use crate::spec::{ModelSpec, preset, presets};
use crate::tissue::Layers;
use axum::http::{HeaderMap, HeaderValue, Method};
use axum::response::Response;
use serde_json::{Value, json};
use utoipa::ToSchema;

/// The parameters of pictures of sections.
pub(super) const PARAMETERS: [&str; 3] = ["size", "stain", "labels"];

/// Stains.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ToSchema)]
#[schema(rename_all = "lowercase")]
#[expect(dead_code, reason = "names the only stain in the description")]
pub(in crate::http) enum Stain {
    /// Haematoxylin and eosin.
    He,
}

/// What a picture shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::http) struct Style {
    size: u32,
    labels: bool,
}

impl Style {
    /// Reads the parameters of a picture.
    pub(in crate::http) fn read(parameters: &Parameters, faults: &mut Faults) -> Self {
        let labels = match parameters.get("labels") {
            Some("true") => true,
            None | Some("false") => false,
            Some(_) => {
                faults.push(Fault::parameter("labels", "must be true or false"));
                false
            }
        };
        match parameters.get("stain") {
            Some("he") if labels => faults.push(Fault::parameter("stain", "must be absent: labels are not stained")),
            None | Some("he") => {}
            Some(_) => faults.push(Fault::parameter("stain", "must be he")),
        }
        let size = size(parameters.get("size")).unwrap_or_else(|detail| {
            faults.push(Fault::parameter("size", detail));
            SIZE
        });
        Self { size, labels }
    }
}

/// A section or a cut of a model.
pub(in crate::http) struct Place<'a> {
    pub(in crate::http) job: &'a Job,
    /// Identifies the file and the place.
    pub(in crate::http) key: &'a str,
    /// Number that the texture depends on.
    pub(in crate::http) index: u32,
}

/// The picture of a section or cut, whose borders `read` reads.
pub(in crate::http) async fn respond(
    state: &AppState,
    caller: &Caller,
    place: Place<'_>,
    style: Style,
    method: &Method,
    headers: &HeaderMap,
    read: impl Future<Output = Result<[Border; 2], Problem>>,
) -> Result<Response, Problem> {
    let Place { job, key, index } = place;
    let Style { size, labels } = style;
    let what = if labels { "labels" } else { "he" };
    // Seed and layers are those of the record, which its digest covers.
    let version = env!("CARGO_PKG_VERSION");
    let tag = ETag::strong(format_args!("{}-{key}-{what}-{size}-{version}", job.digest));
    if tag.matches_none(headers) {
        return tag.not_modified(A_DAY);
    }
    let (layers, seed) = (layers(job)?, job.seed);
    let png = picture(state, caller, &tag, read, move |borders| {
        let slide = Slide { borders, layers, seed, index };
        let drawn = if labels { slide.labels(size) } else { slide.stained(size) };
        drawn.map_err(DrawError::from)
    })
    .await?;
    let scale = um_per_pixel(&png).and_then(|um| HeaderValue::try_from(format!("{um:.6}")).ok());
    let mut response = answer(state, method, &tag, png)?;
    if let Some(scale) = scale {
        response.headers_mut().insert(UM_PER_PIXEL, scale);
    }
    Ok(response)
}

/// The layers of a model. One that was requested before layers were parameters has those of its preset.
fn layers(job: &Job) -> Result<Layers, Problem> {
    let preset = preset(&job.preset).unwrap_or(&presets()[0]);
    let of = |patch: &Value| ModelSpec::resolve(preset, patch).ok().map(|spec| spec.histology.layers());
    let layers =
        of(&job.spec).or_else(|| of(&json!({ "histology": job.spec["histology"] }))).or_else(|| of(&json!({})));
    layers.ok_or_else(|| Problem::new(Kind::Internal, "The layers of the section are unknown."))
}
