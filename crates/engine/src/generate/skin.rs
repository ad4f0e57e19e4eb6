//! Textures of the tissue for glTF files.

use super::outputs::Output;
use super::types::{GenerateError, Request};
use crate::export::glb::{EndPicture, Skin};
use crate::mesh::unwrap;
use crate::model::{Mesh, Section};
use crate::render::Slide;
use std::io;

/// Longer side of the picture of an end, pixels.
const END_PIXELS: u32 = 768;
/// Name of the file that the textures are for.
const FILE: &str = "model.glb";

/// Coordinates of the walls of a lofted surface that does not lean yet, if textures are requested.
pub(super) fn coordinates(request: &Request, straight: &Mesh) -> Result<Option<Vec<[f32; 2]>>, GenerateError> {
    let is_written = [Output::Glb, Output::Gltf].into_iter().any(|output| request.outputs.has(output));
    if !(request.spec.mesh.textured && is_written) {
        return Ok(None);
    }
    let missing = || GenerateError::Format {
        name: FILE.into(),
        detail: "the walls do not consist of rings, so they have no texture coordinates; use /mesh/textured false"
            .into(),
    };
    unwrap(straight).map(Some).ok_or_else(missing)
}

/// Creates the textures. `split` are the edges whose midpoints are the vertices without
/// coordinates, in order; `ends` are the first and the last section.
pub(super) fn skin<'a>(
    request: &Request,
    mut coordinates: Vec<[f32; 2]>,
    split: &[(u32, u32)],
    straight: &'a Mesh,
    ends: [&Section; 2],
) -> Result<Skin<'a>, GenerateError> {
    for &(a, b) in split {
        let [p, q] = [a, b].map(|v| coordinates[v as usize]);
        coordinates.push([0, 1].map(|k| 0.5 * (p[k] + q[k])));
    }
    let failed = |source: io::Error| GenerateError::Io { name: FILE.into(), source };
    let picture = |index: u32, section: &Section| {
        let layers = request.spec.layers_at_um(section.z_um, request.seed);
        let slide = Slide { borders: section.borders(), layers, seed: request.seed, index };
        let (grid, png) = slide.end_picture(END_PIXELS).map_err(io::Error::other)?;
        Ok(EndPicture { grid, png })
    };
    let ends = [picture(0, ends[0]).map_err(failed)?, picture(1, ends[1]).map_err(failed)?];
    Skin::new(coordinates, &straight.positions, ends).map_err(failed)
}
