//! Surfaces of models, read from the artifact store to cut them.

use super::queue::Surface;
use crate::export::convert::Converted;
use crate::export::read::{Format, ReadError, parse};
use crate::http::AppState;
use crate::http::access::Caller;
use crate::http::models::files::{permit, whole};
use crate::http::wire::blocking::blocking;
use crate::http::wire::problem::{Kind, Problem};
use crate::http::wire::shares::Turn;
use crate::jobs::{File, Job};
use std::sync::Arc;

/// Files that can be cut, those that are fastest to read first.
const FILES: [(&str, Format); 5] = [
    ("model.glb", Format::Gltf),
    ("model.ply", Format::Ply),
    ("model.vtp", Format::Vtp),
    ("model.obj", Format::Obj),
    ("model.stl", Format::Stl),
];
/// Maximum size of a file that is cut, in bytes.
const MAX_BYTES: u64 = 256 << 20;

/// The file of a model that is cut: the surface of the tissue.
pub(super) fn file(job: &Job) -> Result<(File, Format), Problem> {
    let of = |(name, format)| job.files.iter().find(|file| file.name == name).map(|file| (file.clone(), format));
    let found = FILES.into_iter().find_map(of).ok_or_else(|| {
        let detail = if job.status.is_ended() {
            let names = FILES.map(|(name, _)| name).join(", ");
            format!("The model has no surface of the tissue that can be cut: none of the files {names}.")
        } else {
            "The model has not ended. It can be cut after its end.".to_owned()
        };
        Problem::new(Kind::FileNotFound, detail)
    })?;
    if found.0.bytes > MAX_BYTES {
        let detail = format!(
            "{} has {} bytes; the service cuts surfaces of at most {MAX_BYTES}. Download it and use `oviduct cut`.",
            found.0.name, found.0.bytes
        );
        return Err(Problem::new(Kind::SurfaceTooLarge, detail));
    }
    Ok(found)
}

/// Reads the surface in a file, for a request with this turn.
pub(super) async fn read(
    state: &AppState,
    caller: &Caller,
    file: &File,
    format: Format,
    turn: &Turn,
) -> Result<Surface, Problem> {
    if let Some(body) = state.pictures.surface(&file.sha256) {
        return Ok(body);
    }
    let bytes = {
        let _download = permit(state, caller)?;
        whole(state, file).await?
    };
    let read = blocking("Reading the surface", turn.clone(), move || {
        let surface = parse(&bytes, format, None)?;
        drop(bytes);
        Ok::<_, ReadError>(Arc::new(Converted::in_its_unit(&surface).into_body()))
    });
    let body = read.await?.map_err(|error| {
        tracing::error!(%error, "a surface cannot be read");
        Problem::new(Kind::Internal, "The surface of the model cannot be read.")
    })?;
    state.pictures.keep_surface(&file.sha256, Arc::clone(&body));
    Ok(body)
}
