//! Encoding of a level: sorts and compresses vertices and triangles, and builds the document.
//!
//! Vertices are numbered in the order of first use. Triangles left over by edge collapses are sorted
//! for the vertex cache, which makes their compressed indices three times smaller. Those of the full
//! surface and of thinned rows stay in the order of the loft: sorting them makes the file of the
//! full surface a third larger, and that of thinned rows a sixth.

use super::full::{FullSurface, PatchTriangles, number};
use super::grid::Grid;
use crate::export::Metadata;
use crate::export::chunks::join;
use crate::export::glb::scene::{Scene, accessor, buffer, buffer_view, index_type, primitive, write_head};
use crate::model::{self, BodyKind, PatchKind};
use gltf_json as json;
use json::accessor::{ComponentType, Type};
use json::buffer::{Stride, Target};
use serde::Serialize;
use serde_json::{Map, Value, json};
use std::io::{self, Write};

/// Name of the extension that compresses buffer views.
const COMPRESSION: &str = "EXT_meshopt_compression";
const QUANTIZATION: &str = "KHR_mesh_quantization";

/// Bytes of a position or normal: three components of 16 bits, padded to a multiple of four.
const VECTOR_BYTES: usize = 8;

/// Object of the extension in a buffer view: location and form of the compressed data.
#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct Compression {
    buffer: usize,
    byte_offset: usize,
    byte_length: usize,
    byte_stride: usize,
    count: usize,
    mode: Mode,
}

/// Contents of a compressed view.
#[derive(Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "UPPERCASE")]
enum Mode {
    /// Attributes of vertices.
    Attributes,
    /// Indices of triangles.
    Triangles,
}

/// A compressed level, ready to be written.
pub(super) struct Encoded {
    body: BodyKind,
    grid: Grid,
    pub(super) vertices: usize,
    pub(super) triangles: usize,
    patches: Vec<EncodedPatch>,
}

struct EncodedPatch {
    kind: PatchKind,
    low: [u16; 3],
    high: [u16; 3],
    vertices: usize,
    triangles: usize,
    positions: Box<[u8]>,
    normals: Box<[u8]>,
    indices: Box<[u8]>,
}

impl Encoded {
    /// Encodes a level. Simplified triangles are sorted if they are not `in_rows`.
    pub(super) fn new(full: &FullSurface<'_>, level: &PatchTriangles<'_>, in_rows: bool) -> Self {
        let patches: Vec<EncodedPatch> = full
            .patches
            .iter()
            .zip(level)
            .map(|(patch, triangles)| {
                let is_sorted = !in_rows && triangles.len() < patch.triangles.len();
                EncodedPatch::new(full, patch, triangles, is_sorted)
            })
            .collect();
        let triangles: usize = patches.iter().map(|patch| patch.triangles).sum();
        // Euler's formula for a closed surface, which has 3/2 edges per triangle.
        let vertices = (triangles as i64 / 2 + full.mesh.body.euler()) as usize;
        Self { body: full.mesh.body, grid: full.grid, vertices, triangles, patches }
    }

    /// Writes the file. `more` are additional members of the asset's extras.
    pub(super) fn write(&self, meta: &Metadata, more: Map<String, Value>, out: &mut impl Write) -> io::Result<()> {
        let (root, bin_len) = self.document(meta, more)?;
        write_head(&root, bin_len, out)?;
        for data in self.patches.iter().flat_map(|patch| [&patch.positions, &patch.normals, &patch.indices]) {
            out.write_all(data)?;
            out.write_all(&[0; 4][..data.len().next_multiple_of(4) - data.len()])?;
        }
        Ok(())
    }

    /// Builds the JSON document, and returns it with the length of the binary data.
    fn document(&self, meta: &Metadata, more: Map<String, Value>) -> io::Result<(json::Root, usize)> {
        let mut scene = Scene::new(self.body.name(), format!("oviduct {}", meta.engine), Some(meta), more)?;
        scene.root.extensions_used = vec![COMPRESSION.into(), QUANTIZATION.into()];
        scene.root.extensions_required = scene.root.extensions_used.clone();
        let data = scene.root.push(buffer(0));
        // The extension requires a fallback buffer: it has no data, only the layout of the
        // decompressed views.
        let plain = scene.root.push(buffer(0));
        let mut lengths = [0; 2];
        for patch in &self.patches {
            let root = &mut scene.root;
            let vertices = patch.vertices;
            let mut view = |root: &mut json::Root, bytes: &[u8], stride: usize, count: usize, mode: Mode| {
                let target = if mode == Mode::Triangles { Target::ElementArrayBuffer } else { Target::ArrayBuffer };
                let mut view = buffer_view(plain, lengths[1], stride * count, Some(target));
                view.byte_stride = (mode == Mode::Attributes).then_some(Stride(stride));
                let compression = Compression {
                    buffer: data.value(),
                    byte_offset: lengths[0],
                    byte_length: bytes.len(),
                    byte_stride: stride,
                    count,
                    mode,
                };
                let others = Map::from_iter([(COMPRESSION.to_owned(), serde_json::to_value(compression)?)]);
                view.extensions = Some(json::extensions::buffer::View { others });
                lengths[0] += bytes.len().next_multiple_of(4);
                lengths[1] += (stride * count).next_multiple_of(4);
                Ok::<_, io::Error>(Some(root.push(view)))
            };
            let positions = json::Accessor {
                buffer_view: view(root, &patch.positions, VECTOR_BYTES, vertices, Mode::Attributes)?,
                min: Some(json!(patch.low)),
                max: Some(json!(patch.high)),
                ..accessor(Type::Vec3, ComponentType::U16, vertices)
            };
            let positions = root.push(positions);
            let normals = json::Accessor {
                buffer_view: view(root, &patch.normals, VECTOR_BYTES, vertices, Mode::Attributes)?,
                normalized: true,
                ..accessor(Type::Vec3, ComponentType::I16, vertices)
            };
            let normals = root.push(normals);
            let component = index_type(vertices);
            let count = patch.triangles * 3;
            let indices = json::Accessor {
                buffer_view: view(root, &patch.indices, component.size(), count, Mode::Triangles)?,
                ..accessor(Type::Scalar, component, count)
            };
            let indices = root.push(indices);
            scene.add_patch(patch.kind.name(), primitive(json::mesh::Mode::Triangles, positions, normals, indices))?;
        }
        scene.root.buffers[0] = buffer(lengths[0]);
        scene.root.buffers[1] = buffer(lengths[1]);
        let others = Map::from_iter([(COMPRESSION.to_owned(), json!({ "fallback": true }))]);
        scene.root.buffers[1].extensions = Some(json::extensions::buffer::Buffer { others });
        let node =
            json::Node { scale: Some(self.grid.step), translation: Some(self.grid.origin), ..json::Node::default() };
        Ok((scene.finish(self.vertices, self.triangles, node)?, lengths[0]))
    }
}

impl EncodedPatch {
    fn new(full: &FullSurface<'_>, patch: &model::Patch, triangles: &[[u32; 3]], is_sorted: bool) -> Self {
        let mut indices = triangles.as_flattened().to_vec();
        let mut vertices = number(&mut indices);
        if is_sorted {
            meshopt::optimize_vertex_cache_in_place(&mut indices, vertices.len());
            let order = number(&mut indices);
            vertices = order.into_iter().map(|local| vertices[local as usize]).collect();
        }
        // The encoders return vectors with the capacity of the worst case.
        let fit = |bytes: meshopt::Result<Vec<u8>>| {
            bytes.expect("the encoder is given the space it asks for").into_boxed_slice()
        };
        let encoded = fit(meshopt::encode_index_buffer(&indices, vertices.len()));
        drop(indices);
        let (mut low, mut high) = ([u16::MAX; 3], [0; 3]);
        let cells = || vertices.iter().map(|&vertex| full.cells[vertex as usize]);
        for cell in cells() {
            low = std::array::from_fn(|axis| cell[axis].min(low[axis]));
            high = std::array::from_fn(|axis| cell[axis].max(high[axis]));
        }
        // The extension defines version 0 of the codec, which has no compression levels.
        let encode = |vectors: Vec<[u8; VECTOR_BYTES]>| fit(meshopt::encode_vertex_buffer_level(&vectors, 0, Some(0)));
        let normals = full.normals(patch, &vertices);
        Self {
            kind: patch.kind,
            low,
            high,
            vertices: vertices.len(),
            triangles: triangles.len(),
            positions: encode(cells().map(padded).collect()),
            normals: encode(normals.into_iter().map(|normal| padded(normal.map(i16::cast_unsigned))).collect()),
            indices: encoded,
        }
    }
}

/// Vector in little-endian order, padded with zeros.
fn padded(vector: [u16; 3]) -> [u8; VECTOR_BYTES] {
    join(vector.map(u16::to_le_bytes))
}
