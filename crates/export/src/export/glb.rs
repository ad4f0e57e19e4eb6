//! glTF 2.0, binary in one file or text with its data in a second file: metres, y up, z along the
//! tube.
//!
//! The body (`tissue`, `lumen`, `regions`) is a node without a mesh. Each patch is a child node
//! with a mesh and a material of the patch's name. Patches do not share vertices, because a cap and
//! a wall need different normals at their common edge. A reader that merges equal positions obtains
//! the closed surface.
//!
//! With a [`Skin`], vertices have texture coordinates and materials have textures. Positions,
//! normals and triangles stay the same.

mod part;
pub(super) mod scene;
mod skin;
mod tiles;

use super::shape::Shape;
use crate::model::LengthUnit;
use gltf_json as json;
use json::accessor::{ComponentType, Type};
use json::buffer::Target;
use json::mesh::Semantic;
use json::validation::Checked;
use part::PatchWriter;
use scene::{Layout, Scene, buffer, primitive, write_head};
use serde_json::Map;
pub use skin::{EndPicture, Skin};
use std::io::{self, Write};

/// Media type of binary glTF.
pub const MEDIA_TYPE: &str = "model/gltf-binary";
/// Media type of glTF as text.
pub const TEXT_MEDIA_TYPE: &str = "model/gltf+json";
/// Media type of the data of glTF as text.
pub const BUFFER_MEDIA_TYPE: &str = "application/gltf-buffer";

/// Options of the glTF writers.
#[derive(Clone, Copy, Debug, Default)]
pub struct GlbOptions<'a> {
    /// Writes one triangle strip per patch instead of a list of triangles, which takes fewer
    /// indices. The pieces of the strip are joined by triangles without area; some readers cannot
    /// drop these.
    pub strips: bool,
    /// Textures, if the surface has any. It must be the surface for which they were created.
    pub skin: Option<&'a Skin<'a>>,
}

/// Writes a surface as GLB.
///
/// # Errors
/// Returns any error of writing to `out`. Before anything is written, returns
/// [`io::ErrorKind::InvalidInput`] if the surface has no triangles, is not in metres, or the file
/// would exceed 4 GiB, the limit of GLB.
///
/// # Panics
/// If the indices or patch ranges of a shape are out of bounds.
pub fn write_glb(surface: &Shape<'_>, options: &GlbOptions<'_>, out: &mut impl Write) -> io::Result<()> {
    let parts = parts(surface, options)?;
    let (root, bin_len) = document(surface, &parts, options.skin)?;
    write_head(&root, bin_len, out)?;
    write_data(&parts, options.skin, out)
}

/// Writes a surface as glTF text that refers to its data by the relative URI `data`.
///
/// # Errors
/// As [`write_glb`], except for the limit of 4 GiB.
///
/// # Panics
/// As [`write_glb`].
pub fn write_gltf(surface: &Shape<'_>, options: &GlbOptions<'_>, data: &str, out: &mut impl Write) -> io::Result<()> {
    let (mut root, _) = document(surface, &parts(surface, options)?, options.skin)?;
    root.buffers[0].uri = Some(data.into());
    serde_json::to_writer_pretty(&mut *out, &root)?;
    out.write_all(b"\n")
}

/// Writes the data that the text of [`write_gltf`] refers to.
///
/// # Errors
/// As [`write_gltf`].
///
/// # Panics
/// As [`write_glb`].
pub fn write_gltf_data(surface: &Shape<'_>, options: &GlbOptions<'_>, out: &mut impl Write) -> io::Result<()> {
    write_data(&parts(surface, options)?, options.skin, out)
}

/// Writes pictures and arrays.
fn write_data(parts: &[PatchWriter<'_>], skin: Option<&Skin<'_>>, out: &mut impl Write) -> io::Result<()> {
    if let Some(skin) = skin {
        skin.write(out)?;
    }
    parts.iter().try_for_each(|part| part.write(out))
}

/// Patches of a surface that have triangles.
fn parts<'a>(surface: &'a Shape<'_>, options: &GlbOptions<'a>) -> io::Result<Vec<PatchWriter<'a>>> {
    let refused = |detail| Err(io::Error::new(io::ErrorKind::InvalidInput, detail));
    if surface.unit != LengthUnit::Metre {
        return refused("glTF is in metres");
    }
    if options.skin.is_some_and(|skin| skin.len() != surface.positions.len()) {
        return refused("the textures belong to another surface");
    }
    let parts: Vec<_> = (surface.patches.iter())
        .filter(|patch| !patch.triangles.is_empty())
        .map(|patch| PatchWriter::new(surface, patch, options.strips, options.skin))
        .collect();
    if parts.is_empty() {
        return refused("the mesh has no triangles");
    }
    Ok(parts)
}

/// Builds the JSON document, and returns it with the length of the binary data.
fn document(
    surface: &Shape<'_>,
    parts: &[PatchWriter<'_>],
    skin: Option<&Skin<'_>>,
) -> io::Result<(json::Root, usize)> {
    let mut scene = Scene::new(surface.name, surface.generator(), surface.meta, Map::new())?;
    let mut layout = Layout::new(&mut scene.root);
    if let Some(skin) = skin {
        skin.describe(&mut layout, &mut scene.root);
    }
    let [vertices, indices] = [Target::ArrayBuffer, Target::ElementArrayBuffer].map(Some);
    for part in parts {
        let root = &mut scene.root;
        let positions = json::Accessor {
            min: Some(serde_json::json!(part.bounds.0)),
            max: Some(serde_json::json!(part.bounds.1)),
            ..layout.append(root, Type::Vec3, ComponentType::F32, part.vertices, vertices)
        };
        let positions = root.push(positions);
        let normals = layout.append(root, Type::Vec3, ComponentType::F32, part.vertices, vertices);
        let normals = root.push(normals);
        let coordinates = skin.map(|_| {
            let coordinates = layout.append(root, Type::Vec2, ComponentType::F32, part.vertices, vertices);
            root.push(coordinates)
        });
        let indices = layout.append(root, Type::Scalar, part.index_type(), part.index_count(), indices);
        let indices = root.push(indices);
        let mode = if part.strip.is_some() { json::mesh::Mode::TriangleStrip } else { json::mesh::Mode::Triangles };
        let mut primitive = primitive(mode, positions, normals, indices);
        if let Some(coordinates) = coordinates {
            primitive.attributes.insert(Checked::Valid(Semantic::TexCoords(0)), coordinates);
        }
        let material = scene.add_patch(part.name, primitive)?;
        if let Some(skin) = skin {
            skin.dress(part.name, &mut scene.root.materials[material.value()]);
        }
    }
    scene.root.buffers[0] = buffer(layout.length);
    let root = scene.finish(surface.positions.len(), surface.triangles.len(), json::Node::default())?;
    Ok((root, layout.length))
}

#[cfg(test)]
mod tests;
