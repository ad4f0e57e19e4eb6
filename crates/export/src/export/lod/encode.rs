//! A level as bytes: vertices and triangles in the order that suits the codec, compressed, and the document around them.
//!
//! Vertices are numbered in the order of first use. Simplified triangles are sorted for the vertex cache, which makes their
//! indices three times smaller. Those of the full surface stay in the order of the loft: sorted, its file is a third larger
//! (measured on the default model, as is the above).

use super::full::{Full, Level, number};
use super::grid::Grid;
use crate::export::Metadata;
use crate::export::glb::scene::{Counts, Scene, accessor, buffer, buffer_view, primitive, write_head};
use crate::model::{self, BodyKind, PatchKind};
use gltf_json as json;
use json::accessor::{ComponentType, Type};
use json::buffer::{Stride, Target};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use std::io::{self, Write};

/// Name of the extension that compresses buffer views.
pub(in crate::export) const COMPRESSION: &str = "EXT_meshopt_compression";
const QUANTIZATION: &str = "KHR_mesh_quantization";

/// Bytes of a position and of a normal: three components of 16 bits, padded to a multiple of four.
pub(in crate::export) const VECTOR_BYTES: usize = 8;

/// Most vertices of a patch with 16-bit indices; glTF reserves 65,535 itself.
const MAX_SHORT_VERTICES: usize = 65_535;

/// How a buffer view is compressed: the extension's object in the document.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(in crate::export) struct Compression {
    pub(in crate::export) buffer: usize,
    #[serde(default)]
    pub(in crate::export) byte_offset: usize,
    pub(in crate::export) byte_length: usize,
    pub(in crate::export) byte_stride: usize,
    pub(in crate::export) count: usize,
    pub(in crate::export) mode: Mode,
}

/// What a compressed view holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub(in crate::export) enum Mode {
    /// Items of vertices.
    Attributes,
    /// Indices of triangles.
    Triangles,
}

/// A level in the form in which it is written.
pub(super) struct Encoded {
    body: BodyKind,
    grid: Grid,
    pub(super) vertices: usize,
    pub(super) triangles: usize,
    patches: Vec<Patch>,
}

struct Patch {
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
    pub(super) fn new(full: &Full<'_>, level: &Level<'_>) -> Self {
        let patches: Vec<Patch> =
            full.patches.iter().zip(level).map(|(patch, triangles)| Patch::new(full, patch, triangles)).collect();
        let triangles: usize = patches.iter().map(|patch| patch.triangles).sum();
        // A closed surface has half as many vertices as triangles, and as many more as its Euler number says.
        let vertices = (triangles as i64 / 2 + full.mesh.body.euler()) as usize;
        Self { body: full.mesh.body, grid: full.grid, vertices, triangles, patches }
    }

    /// Writes the file; `more` are further members of the asset's extras.
    pub(super) fn write(&self, meta: &Metadata, more: Map<String, Value>, out: &mut impl Write) -> io::Result<()> {
        let (root, bin_len) = self.document(meta, more)?;
        write_head(&root, bin_len, out)?;
        for data in self.patches.iter().flat_map(|patch| [&patch.positions, &patch.normals, &patch.indices]) {
            out.write_all(data)?;
            out.write_all(&[0; 4][..data.len().next_multiple_of(4) - data.len()])?;
        }
        Ok(())
    }

    /// The JSON part, and the length of the binary part.
    fn document(&self, meta: &Metadata, more: Map<String, Value>) -> io::Result<(json::Root, usize)> {
        let mut scene = Scene::new(self.body.name(), format!("oviduct {}", meta.engine), Some(meta), more)?;
        scene.root.extensions_used = vec![COMPRESSION.into(), QUANTIZATION.into()];
        scene.root.extensions_required = scene.root.extensions_used.clone();
        let data = scene.root.push(buffer(0));
        // Holds nothing: it is where the views would lie if they were not compressed.
        let plain = scene.root.push(buffer(0));
        let mut lengths = [0; 2];
        for patch in &self.patches {
            let root = &mut scene.root;
            let vertices = patch.vertices;
            let mut view = |root: &mut json::Root, bytes: &[u8], stride: usize, count: usize, mode: Mode| {
                let target = if mode == Mode::Triangles { Target::ElementArrayBuffer } else { Target::ArrayBuffer };
                let mut view = buffer_view(plain, lengths[1], stride * count, target);
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
            let component = if vertices <= MAX_SHORT_VERTICES { ComponentType::U16 } else { ComponentType::U32 };
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
        let counts = Counts { vertices: self.vertices, triangles: self.triangles };
        let node =
            json::Node { scale: Some(self.grid.step), translation: Some(self.grid.origin), ..json::Node::default() };
        Ok((scene.finish(&counts, node)?, lengths[0]))
    }
}

impl Patch {
    fn new(full: &Full<'_>, patch: &model::Patch, triangles: &[[u32; 3]]) -> Self {
        const FITS: &str = "the encoder is given the space it asks for";
        let mut indices = triangles.as_flattened().to_vec();
        let mut vertices = number(&mut indices);
        if triangles.len() < patch.triangles.len() {
            meshopt::optimize_vertex_cache_in_place(&mut indices, vertices.len());
            let order = number(&mut indices);
            vertices = order.into_iter().map(|local| vertices[local as usize]).collect();
        }
        // The encoders return buffers for the greatest size.
        let fit = |bytes: meshopt::Result<Vec<u8>>| bytes.expect(FITS).into_boxed_slice();
        let encoded = fit(meshopt::encode_index_buffer(&indices, vertices.len()));
        drop(indices);
        let (mut low, mut high) = ([u16::MAX; 3], [0; 3]);
        let cells = || vertices.iter().map(|&vertex| full.cells[vertex as usize]);
        for cell in cells() {
            low = std::array::from_fn(|axis| cell[axis].min(low[axis]));
            high = std::array::from_fn(|axis| cell[axis].max(high[axis]));
        }
        // Version 0 is the one of the extension; it has no levels of compression.
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

/// A vector in little-endian order.
fn padded(vector: [u16; 3]) -> [u8; VECTOR_BYTES] {
    let mut bytes = [0; VECTOR_BYTES];
    for (slot, x) in bytes.chunks_exact_mut(2).zip(vector) {
        slot.copy_from_slice(&x.to_le_bytes());
    }
    bytes
}
