//! glTF 2.0, binary in one file or text with its data in another: metres, y up, z along the tube.
//!
//! The body (`tissue`, `lumen`, `regions`) is a node without a mesh; each patch is a child node with a mesh and a
//! material of the patch's name. Patches do not share vertices, since a cap and a wall that meet at an edge need
//! different normals; a reader that merges equal positions obtains the closed surface.
//! The binary data are written accessor by accessor from the surface, in little-endian order on every host.

mod part;
pub(super) mod scene;

use super::shape::Shape;
use crate::model::LengthUnit;
use gltf_json as json;
use json::validation::USize64;
use part::Part;
use scene::{Counts, Scene, accessor, buffer, buffer_view, primitive, write_head};
use serde_json::Map;
use std::io::{self, Write};

/// Media type of binary glTF.
pub const MEDIA_TYPE: &str = "model/gltf-binary";
/// Media type of glTF as text.
pub const TEXT_MEDIA_TYPE: &str = "model/gltf+json";
/// Media type of the data of glTF as text.
pub const BUFFER_MEDIA_TYPE: &str = "application/gltf-buffer";

/// Options of the writer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GlbOptions {
    /// Writes triangle strips instead of single triangles: one strip per patch, its pieces joined by triangles without area.
    /// This needs fewer indices; turn it off for readers that cannot drop triangles without area.
    pub strips: bool,
}

/// Writes a surface as GLB.
///
/// # Errors
/// Those of the surface and of `out`; [`io::ErrorKind::InvalidInput`], before anything is written, if the surface has no
/// triangles, is not in metres, or the file would exceed 4 GiB, the limit of GLB.
///
/// # Panics
/// If the indices or patch ranges of a shape are out of bounds.
pub fn write_glb(surface: &Shape<'_>, options: &GlbOptions, out: &mut impl Write) -> io::Result<()> {
    let parts = parts(surface, options)?;
    let (root, bin_len) = document(surface, &parts)?;
    write_head(&root, bin_len, out)?;
    parts.iter().try_for_each(|part| part.write(out))
}

/// Writes a surface as glTF text without its data, which it finds beside it under the name `data`.
///
/// # Errors
/// As [`write_glb`], but for the limit of 4 GiB.
///
/// # Panics
/// As [`write_glb`].
pub fn write_gltf(surface: &Shape<'_>, options: &GlbOptions, data: &str, out: &mut impl Write) -> io::Result<()> {
    let (mut root, _) = document(surface, &parts(surface, options)?)?;
    root.buffers[0].uri = Some(data.into());
    serde_json::to_writer_pretty(&mut *out, &root)?;
    out.write_all(b"\n")
}

/// Writes the data of [`write_gltf`].
///
/// # Errors
/// As [`write_gltf`].
///
/// # Panics
/// As [`write_glb`].
pub fn write_gltf_data(surface: &Shape<'_>, options: &GlbOptions, out: &mut impl Write) -> io::Result<()> {
    parts(surface, options)?.iter().try_for_each(|part| part.write(out))
}

/// The patches of a surface that have triangles.
fn parts<'a>(surface: &'a Shape<'_>, options: &GlbOptions) -> io::Result<Vec<Part<'a>>> {
    let refused = |detail| Err(io::Error::new(io::ErrorKind::InvalidInput, detail));
    if surface.unit != LengthUnit::Metre {
        return refused("glTF is in metres");
    }
    let parts: Vec<_> = (surface.patches.iter())
        .filter(|patch| !patch.triangles.is_empty())
        .map(|patch| Part::new(surface, patch, options.strips))
        .collect();
    if parts.is_empty() {
        return refused("the mesh has no triangles");
    }
    Ok(parts)
}

/// The JSON part, and the length of the binary part.
fn document(surface: &Shape<'_>, parts: &[Part<'_>]) -> io::Result<(json::Root, usize)> {
    let mut scene = Scene::new(surface.name, surface.generator(), surface.meta, Map::new())?;
    let data = scene.root.push(buffer(0));
    let mut offset = 0;
    for part in parts {
        let root = &mut scene.root;
        let vertices = part.vertices;
        let mut vectors = accessor(json::accessor::Type::Vec3, json::accessor::ComponentType::F32, vertices);
        let mut view = |root: &mut json::Root, length: usize, target| {
            let view = root.push(buffer_view(data, offset, length, target));
            offset += length.next_multiple_of(4);
            Some(view)
        };
        vectors.buffer_view = view(root, vertices * 12, json::buffer::Target::ArrayBuffer);
        let positions = root.push(json::Accessor {
            min: Some(serde_json::json!(part.bounds.0)),
            max: Some(serde_json::json!(part.bounds.1)),
            ..vectors.clone()
        });
        vectors.buffer_view = view(root, vertices * 12, json::buffer::Target::ArrayBuffer);
        let normals = root.push(vectors);
        let index_type = part.index_type();
        let mut indices = accessor(json::accessor::Type::Scalar, index_type, part.index_count());
        let index_bytes = part.index_count() * index_type.size();
        indices.buffer_view = view(root, index_bytes, json::buffer::Target::ElementArrayBuffer);
        let indices = root.push(indices);
        let mode = if part.strip.is_some() { json::mesh::Mode::TriangleStrip } else { json::mesh::Mode::Triangles };
        scene.add_patch(part.name, primitive(mode, positions, normals, indices))?;
    }
    scene.root.buffers[0].byte_length = USize64::from(offset);
    let counts = Counts { vertices: surface.positions.len(), triangles: surface.triangles.len() };
    Ok((scene.finish(&counts, json::Node::default())?, offset))
}

#[cfg(test)]
mod tests;
