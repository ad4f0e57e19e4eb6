//! glTF 2.0, binary in one file or text with its data in another: metres, y up, z along the tube.
//!
//! The body (`tissue`, `lumen`, `regions`) is a node without a mesh; each patch is a child node with a mesh and a
//! material of the patch's name. Patches do not share vertices, since a cap and a wall that meet at an edge need
//! different normals; a reader that merges equal positions obtains the closed surface.
//! The binary data are written accessor by accessor from the surface, in little-endian order on every host.

pub(super) mod scene;

use super::shape::Shape;
use crate::geometry::patch::{PatchGeometry, part_geometry};
use crate::geometry::strips::{join_strips, strips};
use crate::model::LengthUnit;
use gltf_json as json;
use json::validation::USize64;
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

/// Most vertices of a patch with 16-bit indices; glTF reserves 65,535 itself.
const MAX_SHORT_VERTICES: usize = 65_535;
/// Size of the pieces in which data are written.
const CHUNK: usize = 1 << 16;

/// Writes a surface as GLB.
///
/// # Errors
/// Those of `out`; [`io::ErrorKind::InvalidInput`] if the surface has no triangles, is not in metres, or the file would exceed
/// 4 GiB, the limit of GLB.
///
/// # Panics
/// If its indices or patch ranges are out of bounds.
pub fn write_glb(shape: &Shape<'_>, options: &GlbOptions, out: &mut impl Write) -> io::Result<()> {
    let parts = parts(shape, options)?;
    let (root, bin_len) = document(shape, &parts)?;
    write_head(&root, bin_len, out)?;
    write_parts(shape, &parts, out)
}

/// Writes a surface as glTF text without its data, which it finds beside it under the name `data`.
///
/// # Errors
/// As [`write_glb`], but for the limit of 4 GiB.
///
/// # Panics
/// As [`write_glb`].
pub fn write_gltf(shape: &Shape<'_>, options: &GlbOptions, data: &str, out: &mut impl Write) -> io::Result<()> {
    let (mut root, _) = document(shape, &parts(shape, options)?)?;
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
pub fn write_gltf_data(shape: &Shape<'_>, options: &GlbOptions, out: &mut impl Write) -> io::Result<()> {
    write_parts(shape, &parts(shape, options)?, out)
}

/// The patches of a surface that have triangles.
fn parts<'a>(shape: &Shape<'a>, options: &GlbOptions) -> io::Result<Vec<Part<'a>>> {
    let refused = |detail| Err(io::Error::new(io::ErrorKind::InvalidInput, detail));
    if shape.unit != LengthUnit::Metre {
        return refused("glTF is in metres");
    }
    let parts: Vec<Part<'_>> = (shape.patches.iter())
        .filter(|patch| !patch.triangles.is_empty())
        .map(|patch| Part::new(patch.name, part_geometry(shape.positions, shape.triangles_of(patch)), options.strips))
        .collect();
    if parts.is_empty() {
        return refused("the mesh has no triangles");
    }
    Ok(parts)
}

fn write_parts(shape: &Shape<'_>, parts: &[Part<'_>], out: &mut impl Write) -> io::Result<()> {
    parts.iter().try_for_each(|part| part.write(shape.positions, out))
}

/// A patch in the form in which it is written.
struct Part<'a> {
    name: &'a str,
    geometry: PatchGeometry,
    /// One strip for the whole patch, if strips are wanted.
    strip: Option<Vec<u32>>,
}

impl<'a> Part<'a> {
    fn new(name: &'a str, mut geometry: PatchGeometry, as_strip: bool) -> Self {
        let strip = as_strip.then(|| join_strips(&strips(&std::mem::take(&mut geometry.triangles))));
        Self { name, geometry, strip }
    }

    fn index_count(&self) -> usize {
        self.strip.as_ref().map_or(self.geometry.triangles.len() * 3, Vec::len)
    }

    fn index_type(&self) -> json::accessor::ComponentType {
        if self.geometry.vertices.len() <= MAX_SHORT_VERTICES {
            json::accessor::ComponentType::U16
        } else {
            json::accessor::ComponentType::U32
        }
    }

    /// Writes positions, normals and indices, each with the length stated by [`document`].
    fn write(&self, positions: &[[f32; 3]], out: &mut impl Write) -> io::Result<()> {
        let mut buffer = Vec::with_capacity(CHUNK);
        write_chunks(&self.geometry.vertices, 12, &mut buffer, out, |&v, bytes| {
            put_vec3(&positions[v as usize], bytes);
        })?;
        write_chunks(&self.geometry.normals, 12, &mut buffer, out, put_vec3)?;
        let indices: &[u32] = match &self.strip {
            Some(strip) => strip,
            None => bytemuck::cast_slice(&self.geometry.triangles),
        };
        if self.index_type() == json::accessor::ComponentType::U16 {
            write_chunks(indices, 2, &mut buffer, out, |&i, bytes| bytes.copy_from_slice(&(i as u16).to_le_bytes()))?;
            let padding = (indices.len() * 2).next_multiple_of(4) - indices.len() * 2;
            out.write_all(&[0; 4][..padding])
        } else {
            write_chunks(indices, 4, &mut buffer, out, |&i, bytes| bytes.copy_from_slice(&i.to_le_bytes()))
        }
    }
}

fn put_vec3(v: &[f32; 3], bytes: &mut [u8]) {
    for (slot, x) in bytes.chunks_exact_mut(4).zip(v) {
        slot.copy_from_slice(&x.to_le_bytes());
    }
}

/// Writes `items` of `size` bytes each through a buffer of one chunk.
fn write_chunks<T>(
    items: &[T],
    size: usize,
    buffer: &mut Vec<u8>,
    out: &mut impl Write,
    put: impl Fn(&T, &mut [u8]),
) -> io::Result<()> {
    for chunk in items.chunks(CHUNK / size) {
        buffer.resize(chunk.len() * size, 0);
        for (item, bytes) in chunk.iter().zip(buffer.chunks_exact_mut(size)) {
            put(item, bytes);
        }
        out.write_all(buffer)?;
    }
    Ok(())
}

/// The JSON part, and the length of the binary part.
fn document(shape: &Shape<'_>, parts: &[Part<'_>]) -> io::Result<(json::Root, usize)> {
    let mut scene = Scene::new(shape.name, shape.generator(), shape.meta, Map::new())?;
    let data = scene.root.push(buffer(0));
    let mut offset = 0;
    for part in parts {
        let root = &mut scene.root;
        let vertices = part.geometry.vertices.len();
        let mut vectors = accessor(json::accessor::Type::Vec3, json::accessor::ComponentType::F32, vertices);
        let mut view = |root: &mut json::Root, length: usize, target| {
            let view = root.push(buffer_view(data, offset, length, target));
            offset += length.next_multiple_of(4);
            Some(view)
        };
        vectors.buffer_view = view(root, vertices * 12, json::buffer::Target::ArrayBuffer);
        let (min, max) = bounds(shape.positions, &part.geometry.vertices);
        let positions = root.push(json::Accessor {
            min: Some(serde_json::json!(min)),
            max: Some(serde_json::json!(max)),
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
    let counts = Counts { vertices: shape.positions.len(), triangles: shape.triangles.len() };
    Ok((scene.finish(&counts, json::Node::default())?, offset))
}

/// Least and greatest coordinates, exactly.
fn bounds(positions: &[[f32; 3]], vertices: &[u32]) -> ([f32; 3], [f32; 3]) {
    vertices.iter().fold(([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]), |(mut min, mut max), &v| {
        let p = positions[v as usize];
        for axis in 0..3 {
            min[axis] = min[axis].min(p[axis]);
            max[axis] = max[axis].max(p[axis]);
        }
        (min, max)
    })
}

#[cfg(test)]
mod tests;
