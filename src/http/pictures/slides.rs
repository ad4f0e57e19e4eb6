//! Sections and cuts as PNG: stained, or with tissue labels; see docs/histology.md.

use super::draw::{A_DAY, DrawError, answer, picture, read_size};
use crate::http::AppState;
use crate::http::access::Caller;
use crate::http::models::select::flag;
use crate::http::wire::conditional::ETag;
use crate::http::wire::extract::Parameters;
use crate::http::wire::faults::{Faults, RequestFault};
use crate::http::wire::headers::UM_PER_PIXEL;
use crate::http::wire::problem::{Kind, Problem};
use crate::http::wire::shares::Turn;
use crate::jobs::Job;
use crate::model::Border;
use crate::render::{Slide, um_per_pixel};
use crate::spec::{ModelSpec, preset, presets};
use axum::http::{HeaderMap, HeaderValue, Method};
use axum::response::Response;
use serde_json::{Value, json};
use utoipa::ToSchema;

/// Parameters of pictures of sections.
pub(super) const PARAMETERS: [&str; 3] = ["size", "stain", "labels"];

/// Stains.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ToSchema)]
#[schema(rename_all = "lowercase")]
#[expect(dead_code, reason = "names the only stain in the description")]
pub(in crate::http) enum Stain {
    /// Haematoxylin and eosin.
    He,
}

/// Size and content of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct SlideStyle {
    size: u32,
    labels: bool,
}

impl SlideStyle {
    /// Reads the parameters [`PARAMETERS`].
    pub(super) fn read(parameters: &Parameters, faults: &mut Faults) -> Self {
        let labels = flag(parameters, "labels", faults);
        match parameters.get("stain") {
            Some("he") if labels => {
                faults.push(RequestFault::parameter("stain", "must be absent: labels are not stained"));
            }
            None | Some("he") => {}
            Some(_) => faults.push(RequestFault::parameter("stain", "must be he")),
        }
        Self { size: read_size(parameters, faults), labels }
    }
}

/// A section or a cut of a model.
pub(super) struct SlideSource<'a> {
    pub(super) job: &'a Job,
    /// Part of the entity tag: identifies the file and the section or cut.
    pub(super) key: &'a str,
    /// Number that varies the texture.
    pub(super) index: u32,
}

/// Borders of a section or cut, and its place along the tube, µm. `None` if it is not across the
/// tube.
pub(super) type Borders = ([Border; 2], Option<f64>);

/// The picture of a section or cut; `read` reads its borders.
pub(super) async fn respond<F: Future<Output = Result<Borders, Problem>>>(
    state: &AppState,
    caller: &Caller,
    source: SlideSource<'_>,
    style: SlideStyle,
    method: &Method,
    headers: &HeaderMap,
    read: impl FnOnce(Turn) -> F,
) -> Result<Response, Problem> {
    let SlideSource { job, key, index } = source;
    let SlideStyle { size, labels } = style;
    let what = if labels { "labels" } else { "he" };
    // The digest covers the seed and the layers.
    let version = env!("CARGO_PKG_VERSION");
    let tag = ETag::strong(format_args!("{}-{key}-{what}-{size}-{version}", job.digest));
    if tag.matches_none(headers) {
        return tag.not_modified(A_DAY);
    }
    let (spec, seed) = (spec(job)?, job.seed);
    let png = picture(state, caller, &tag, read, move |(borders, z_um)| {
        let z_um = z_um.unwrap_or_else(|| spec.middle_um());
        let slide = Slide { borders, layers: spec.layers_at_um(z_um, seed), seed, index };
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

/// Specification whose layers a model has. Models of versions without these parameters have the
/// layers of their preset.
fn spec(job: &Job) -> Result<ModelSpec, Problem> {
    let preset = preset(&job.preset).unwrap_or(&presets()[0]);
    let of = |patch: &Value| ModelSpec::resolve(preset, patch).ok();
    let spec = of(&job.spec).or_else(|| of(&json!({ "histology": job.spec["histology"] }))).or_else(|| of(&json!({})));
    spec.ok_or_else(|| Problem::new(Kind::Internal, "The layers of the section are unknown."))
}
