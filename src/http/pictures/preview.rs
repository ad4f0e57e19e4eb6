//! `GET /models/{id}/preview.png`: a picture of a model, drawn on request.

use super::draw::{A_DAY, answer, picture, read_size};
use super::sections;
use crate::http::AppState;
use crate::http::access::Caller;
use crate::http::models::files::{find, permit};
use crate::http::wire::conditional::ETag;
use crate::http::wire::extract::{ModelId, Parameters};
use crate::http::wire::faults::RequestFault;
use crate::http::wire::problem::Problem;
use crate::http::wire::responses::{BadParameters, FileMissing, PictureUnavailable};
use crate::http::wire::shares::Turn;
use crate::jobs::File;
use crate::model::Section;
use crate::preview::{chosen, end, tube};
use crate::render::{Finish, NamedView, mesh_png};
use crate::spec::ModelSpec;
use axum::extract::State;
use axum::http::{HeaderMap, Method};
use axum::response::Response;

/// Draw a picture of a finished model.
///
/// The picture is a PNG with a transparent background. At 256 pixels or more, it has a scale bar,
/// which also names the factor by which a long tube is shortened. The same version of the service
/// always draws the same picture.
#[utoipa::path(
    get, path = "/models/{id}/preview.png", operation_id = "get_preview", tag = "files",
    params(
        ("id" = Uuid, Path, description = "Id of the model"),
        ("view" = Option<NamedView>, Query, description = "`opened` (the default): the whole tube with a quarter cut away along it, or half of it if it is bent; `whole`: the tube from outside; `isthmus`, `ampulla`: one end, in true proportions"),
        ("size" = Option<u32>, Query, minimum = 32, maximum = 2048, description = "Longest side, pixels; 1024 by default"),
        ("if-none-match" = Option<String>, Header, description = "Entity tags that the client has"),
    ),
    responses(
        (status = 200, description = "The picture", headers(
            ("etag" = String, description = "Entity tag of the picture"))),
        (status = 304, description = "The client has this picture"),
        FileMissing, BadParameters, PictureUnavailable,
    )
)]
pub(in crate::http) async fn preview(
    State(state): State<AppState>,
    caller: Caller,
    ModelId(id): ModelId,
    parameters: Parameters,
    method: Method,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let (view, size) = read_parameters(&parameters)?;
    let (job, file) = find(&state, &caller, id, "sections.bin").await?;
    let tag = ETag::strong(format_args!("{}-{}-{size}-{}", file.sha256, view.name(), env!("CARGO_PKG_VERSION")));
    if tag.matches_none(&headers) {
        return tag.not_modified(A_DAY);
    }
    let png = picture(
        &state,
        &caller,
        &tag,
        |turn| sections_in_view(&state, &caller, &file, view, size, turn),
        move |sections| {
            let mesh = tube(&sections, &job.spec)?;
            drop(sections);
            let spec = ModelSpec::from_stored(&job.spec);
            let finish = spec.as_ref().map(|spec| Finish { spec, seed: job.seed });
            Ok(mesh_png(&mesh, &view.of(&mesh, size), finish.as_ref())?)
        },
    )
    .await?;
    answer(&state, &method, &tag, png)
}

fn read_parameters(parameters: &Parameters) -> Result<(NamedView, u32), Problem> {
    let mut faults = parameters.faults(&["view", "size"], &[]);
    let view = parameters.get("view").map_or(Ok(NamedView::default()), str::parse).unwrap_or_else(|error| {
        faults.push(RequestFault::parameter("view", error.to_string()));
        NamedView::default()
    });
    let size = read_size(parameters, &mut faults);
    Problem::check(faults)?;
    Ok((view, size))
}

/// Reads the sections that a picture shows, and no others.
pub(super) async fn sections_in_view(
    state: &AppState,
    caller: &Caller,
    file: &File,
    view: NamedView,
    size: u32,
    turn: Turn,
) -> Result<Vec<Section>, Problem> {
    let _download = permit(state, caller)?;
    let entries = sections::read_index(state, file).await?;
    let end = match end(view, entries.len()) {
        Some(k) => sections::read_entries(state, file, vec![entries[k]], turn.clone()).await?.pop(),
        None => None,
    };
    let chosen = chosen(&entries, end.as_ref(), size).into_iter().map(|k| entries[k]).collect();
    sections::read_entries(state, file, chosen, turn).await
}
