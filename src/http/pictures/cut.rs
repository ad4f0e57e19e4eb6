//! `GET /models/{id}/cut`: the intersection of a plane with the stored surface of a model, as JSON,
//! as a drawing, or as a stained or labelled picture.

use super::draw::turn;
use super::sections::{FORMAT_DESCRIPTION, Png, SVG, SectionFormat, representation};
use super::slides::{PARAMETERS, SlideSource, SlideStyle, Stain, respond};
use super::surfaces;
use crate::export::cut::CutDocument;
use crate::export::svg::cut_svg;
use crate::geometry::cut::Body;
use crate::http::AppState;
use crate::http::access::Caller;
use crate::http::models::files::{IMMUTABLE, find_model, permit};
use crate::http::wire::blocking::blocking;
use crate::http::wire::conditional::ETag;
use crate::http::wire::extract::{ModelId, Parameters};
use crate::http::wire::faults::{Faults, RequestFault};
use crate::http::wire::problem::{Kind, Problem};
use crate::http::wire::responses::{CutMissing, CutProblems, PictureUnavailable, Unacceptable};
use crate::http::wire::shares::Turn;
use crate::jobs::Job;
use crate::model::{Border, Plane};
use crate::spec::{Across, ModelSpec};
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, Method, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;
use uuid::Uuid;

/// A planar cut of a model's surface.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct CutAnswer {
    /// Id of the model.
    model: Uuid,
    /// Name of the file whose surface was cut.
    file: String,
    #[serde(flatten)]
    cut: CutDocument,
}

/// Cut a finished model with a plane.
///
/// The service cuts the stored surface of the tissue exactly, across the tube (`z_um` or `z_mm`) or
/// along any plane (`normal`, and `origin_um` or `origin_mm`). The rings of the cut are nested, and
/// each has a kind: `tissue`; `lumen`, its largest hole; `island`, tissue that is not connected to
/// the wall in this plane; `pocket`, lumen that is not connected to the rest in this plane. A plane
/// across a bent tube cuts only the part around the centre line at this place. In contrast, the
/// sections of `/models/{id}/sections/{k}` come from the simulation, before the surface leans, and
/// have no islands.
///
/// Pictures show the same tissues as pictures of sections. A longer picture of a plane along the
/// tube has larger pixels.
#[utoipa::path(
    get, path = "/models/{id}/cut", operation_id = "cut_model", tag = "files",
    params(
        ("id" = Uuid, Path, description = "Id of the model"),
        ("z_um" = Option<f64>, Query, minimum = -1e12, maximum = 1e12,
            description = "Place of a plane across the tube, µm along the tube or, if it is bent, along its centre \
                line; u and v are x and y of the section at this place"),
        ("z_mm" = Option<f64>, Query, minimum = -1e9, maximum = 1e9, description = "`z_um` in mm, instead of it"),
        ("origin_um" = Option<String>, Query, pattern = "^[-+0-9.eE ]+(,[-+0-9.eE ]+){2}$",
            description = "Point of the plane, µm: `x,y,z`; together with `normal`, instead of \
                `z_um`", example = "0,0,30000"),
        ("origin_mm" = Option<String>, Query, pattern = "^[-+0-9.eE ]+(,[-+0-9.eE ]+){2}$",
            description = "`origin_um` in mm, instead of it"),
        ("normal" = Option<String>, Query, pattern = "^[-+0-9.eE ]+(,[-+0-9.eE ]+){2}$", description = "Normal of the plane, of any length: `x,y,z`", example = "0,1,0"),
        ("format" = Option<SectionFormat>, Query, description = FORMAT_DESCRIPTION),
        ("size" = Option<u32>, Query, minimum = 32, maximum = 2048, description = "Longer side of a PNG picture, pixels; 1024 by default"),
        ("stain" = Option<Stain>, Query, description = "Stain of a PNG picture: `he`, haematoxylin and eosin, the default"),
        ("labels" = Option<bool>, Query, description = "`true`: the tissue of each pixel as an 8-bit grey value, without a scale bar, instead of a stain"),
        ("if-none-match" = Option<String>, Header, description = "Entity tags that the client has"),
    ),
    responses(
        (status = 200, description = "The cut", content(
            (CutAnswer = "application/json"),
            (String = "image/svg+xml"),
            (Png = "image/png")), headers(
            ("etag" = String, description = "Entity tag of this representation"),
            ("um-per-pixel" = f64, description = "Side of a pixel of a PNG picture, µm. The `pHYs` chunk of the \
                picture has the pixels per metre"))),
        (status = 304, description = "The client has this cut"),
        CutMissing, Unacceptable, CutProblems, PictureUnavailable,
    )
)]
pub(in crate::http) async fn cut(
    State(state): State<AppState>,
    caller: Caller,
    ModelId(id): ModelId,
    parameters: Parameters,
    method: Method,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let job = find_model(&state, &caller, id).await?;
    let (plane, format, style) = read_parameters(&parameters, &headers)?;
    let (file, kind) = surfaces::file(&job)?;
    let across = plane.z_um();
    let plane = plane.resolve(&state, &caller, &job).await?;
    let key = format!("{}-{:x}", file.sha256, plane.digest());
    let vary = (header::VARY, HeaderValue::from_static("accept"));
    if format == SectionFormat::Png {
        let source = SlideSource { job: &job, key: &key, index: plane.digest() as u32 };
        let read = |turn: Turn| {
            let (state, caller, file) = (&state, &caller, &file);
            async move {
                let body = surfaces::read(state, caller, file, kind, &turn).await?;
                blocking("Making the cut", turn, move || Ok((borders(&body, &plane)?, across))).await?
            }
        };
        let mut response = respond(&state, &caller, source, style, &method, &headers, read).await?;
        response.headers_mut().insert(vary.0, vary.1);
        return Ok(response);
    }
    let tag = ETag::strong(format_args!("{key}-{}", if format == SectionFormat::Svg { "svg" } else { "json" }));
    if tag.matches_none(&headers) {
        return Ok(([vary], tag.not_modified(IMMUTABLE)?).into_response());
    }
    let turn = turn(&state, &caller).await?;
    let body = surfaces::read(&state, &caller, &file, kind, &turn).await?;
    let made = blocking("Making the cut", turn, move || {
        let cut = body.cut(&plane);
        if cut.rings.is_empty() { Err(missed(&body, &plane)) } else { Ok(cut) }
    });
    let cut = made.await??;
    let headers = [(header::ETAG, tag.header()?), (header::CACHE_CONTROL, IMMUTABLE), vary];
    if format == SectionFormat::Svg {
        let kind = (header::CONTENT_TYPE, HeaderValue::from_static(SVG));
        return Ok((headers, [kind], cut_svg(&cut)).into_response());
    }
    Ok((headers, Json(CutAnswer { model: id.0, file: file.name, cut: cut.into() })).into_response())
}

/// The plane of a request.
#[derive(Clone, Copy)]
enum CutPlane {
    /// Across the tube, at a distance along it, µm.
    Across(f64),
    Through(Plane),
}

impl CutPlane {
    /// Place along the tube, µm. `None` if the plane is not across the tube.
    fn z_um(self) -> Option<f64> {
        match self {
            Self::Across(z_um) => Some(z_um),
            Self::Through(_) => None,
        }
    }

    /// The plane in the coordinates of a model, which may be bent.
    async fn resolve(self, state: &AppState, caller: &Caller, job: &Job) -> Result<Plane, Problem> {
        let z_um = match self {
            Self::Through(plane) => return Ok(plane),
            Self::Across(z_um) => z_um,
        };
        let spec = job.spec.clone();
        let made = blocking("Making the cut", permit(state, caller)?, move || {
            let Some(across) = ModelSpec::from_stored(&spec).map(|spec| Across::of(&spec)) else {
                return Ok(Plane::across(z_um));
            };
            across.at(z_um).ok_or_else(|| {
                let [first, last] = across.ends_um();
                let detail = format!(
                    "Along its centre line the model reaches from {first:.1} to {last:.1} µm; the plane is at {z_um:.1} µm."
                );
                Problem::new(Kind::CutNotFound, detail)
            })
        });
        made.await?
    }
}

fn missed(body: &Body<'_>, plane: &Plane) -> Problem {
    let [low, high] = body.extent_um(plane);
    let detail = format!(
        "Along the normal of the plane the model reaches from {low:.1} to {high:.1} µm; the plane is at {:.1} µm.",
        plane.height_um()
    );
    Problem::new(Kind::CutNotFound, detail)
}

/// Intersections of the plane with the mucosa and with the outer wall.
fn borders(body: &Body<'_>, plane: &Plane) -> Result<[Border; 2], Problem> {
    let found = body.borders(plane).ok_or_else(|| {
        tracing::error!("a stored surface has no patches");
        Problem::new(Kind::Internal, "The surface of the model has no named patches.")
    })?;
    if found.iter().all(|border| border.lines.is_empty()) { Err(missed(body, plane)) } else { Ok(found) }
}

/// Reads the plane, the representation, and the style of a picture.
fn read_parameters(
    parameters: &Parameters,
    headers: &HeaderMap,
) -> Result<(CutPlane, SectionFormat, SlideStyle), Problem> {
    const KNOWN: [&str; 9] = {
        let [size, stain, labels] = PARAMETERS;
        ["z_um", "z_mm", "origin_um", "origin_mm", "normal", "format", size, stain, labels]
    };
    let mut faults = parameters.faults(&KNOWN, &[]);
    let plane = read_plane(parameters, &mut faults);
    let (format, style) = representation(parameters, headers, faults)?;
    Ok((plane, format, style))
}

fn read_plane(parameters: &Parameters, faults: &mut Faults) -> CutPlane {
    let across = length(parameters, ["z_um", "z_mm"], faults);
    let origin = length(parameters, ["origin_um", "origin_mm"], faults);
    let mut fault = |name: &str, detail: &str| {
        faults.push(RequestFault::parameter(name, detail));
        CutPlane::Across(0.0)
    };
    match (across, origin, parameters.get("normal")) {
        (Some(z), None, None) => match number(z.text, z.um) {
            Some(z) => CutPlane::Across(z),
            None => fault(z.name, &format!("must be a number of {}", z.unit)),
        },
        (None, Some(origin), Some(normal)) => match (vector(origin.text, origin.um), vector(normal, 1.0)) {
            (None, _) => fault(origin.name, &format!("must be three numbers of {}, x,y,z", origin.unit)),
            (_, None) => fault("normal", "must be three numbers, x,y,z"),
            (Some(origin), Some(normal)) => {
                Plane::through(origin, normal).map_or_else(|| fault("normal", "must not be zero"), CutPlane::Through)
            }
        },
        (None, None, None) => fault("z_um", "is required, or z_mm, or normal with origin_um or origin_mm"),
        (None, Some(origin), None) => fault("normal", &format!("is required with {}", origin.name)),
        (None, None, Some(_)) => fault("origin_um", "is required with normal, or origin_mm"),
        (Some(z), _, _) => fault(z.name, "must be absent if an origin or normal is given"),
    }
}

/// A parameter that has a name for each unit.
struct Length<'a> {
    name: &'static str,
    text: &'a str,
    unit: &'static str,
    /// Micrometres per unit.
    um: f64,
}

/// Finds a parameter by its names in micrometres and in millimetres.
fn length<'a>(
    parameters: &'a Parameters,
    [in_um, in_mm]: [&'static str; 2],
    faults: &mut Faults,
) -> Option<Length<'a>> {
    let um = parameters.get(in_um).map(|text| Length { name: in_um, text, unit: "micrometres", um: 1.0 });
    let mm = parameters.get(in_mm).map(|text| Length { name: in_mm, text, unit: "millimetres", um: 1e3 });
    if um.is_some() && mm.is_some() {
        faults.push(RequestFault::parameter(in_mm, format!("must be absent if {in_um} is given")));
    }
    um.or(mm)
}

/// Parses a coordinate in units of `um` micrometres. The bound prevents overflows of squares.
fn number(text: &str, um: f64) -> Option<f64> {
    text.trim().parse().ok().map(|x: f64| x * um).filter(|x| x.abs() <= 1e12)
}

fn vector(text: &str, um: f64) -> Option<[f64; 3]> {
    let parts = text.split(',').map(|part| number(part, um)).collect::<Option<Vec<f64>>>()?;
    parts.try_into().ok()
}
