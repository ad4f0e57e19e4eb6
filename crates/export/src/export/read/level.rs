//! Levels of detail written by oviduct (`model.lod0.glb` to `model.lod2.glb`): compressed and
//! quantized glTF with exactly the structure that [`lod`](crate::export::lod) writes.
//!
//! Positions are in metres, rounded to the level's grid. Vertices of equal position are merged, so
//! that patches share the vertices of their borders, as in the mesh that the level was computed
//! from.

use super::error::ReadError;
use super::limits;
use super::surface::{Group, Surface, Unit};
use crate::export::lod::{COMPRESSION, Compression, Grid, Mode, VECTOR_BYTES};
use crate::model::{BodyKind, Mesh, Patch, PatchKind};
use ::gltf::Semantic;
use ::gltf::json::accessor::{ComponentType, GenericComponentType};
use ::gltf::json::validation::Checked;
use ::gltf::json::{Accessor, Index, Node, Root};
use std::collections::HashMap;

/// Upper bound for the vertices or indices per byte of compressed data. The codecs reach 8 vertices
/// and 3 indices per byte.
const MAX_PER_BYTE: usize = 8;

/// Reads a level from the bytes of its file.
#[cfg(test)]
pub(crate) fn read_level(bytes: &[u8]) -> Result<Mesh, ReadError> {
    let (json, blob) = super::document::chunks(bytes)?;
    mesh(&super::document::root(json)?, blob.unwrap_or_default())
}

/// True if a document is compressed, so that only [`mesh`] can read it.
pub(super) fn is_level(root: &Root) -> bool {
    root.extensions_required.iter().any(|name| name == COMPRESSION)
}

/// Reads the mesh of a level from its document and its binary chunk. The memory needed is
/// proportional to their length.
///
/// # Errors
/// [`ReadError`] if they are not a complete level as this version of oviduct writes it.
pub(super) fn mesh(root: &Root, blob: &[u8]) -> Result<Mesh, ReadError> {
    let wrong = |path: &str, detail: &str| ReadError::document(path, format!("{detail} of a level written by oviduct"));
    let scene = root.scene.and_then(|scene| root.scenes.get(scene.value()));
    let body = scene.and_then(|scene| root.nodes.get(scene.nodes.first()?.value()));
    let body = body.ok_or_else(|| wrong("scene", "it has no node with the body"))?;
    let kind = body.name.as_deref().and_then(BodyKind::named).ok_or_else(|| wrong("nodes", "no body is named"))?;
    let grid = match (body.translation, body.scale) {
        (Some(origin), Some(step)) => Grid { origin, step },
        _ => return Err(wrong("nodes", "the body lacks the grid")),
    };
    let mut reader = LevelReader {
        root,
        blob,
        grid,
        vertices: HashMap::new(),
        mesh: Mesh { body: kind, positions: Vec::new(), triangles: Vec::new(), patches: Vec::new() },
    };
    for child in body.children.iter().flatten() {
        let node = root.nodes.get(child.value()).ok_or_else(|| wrong("nodes", "a child of the body is missing"))?;
        reader.add(node)?;
    }
    Ok(reader.mesh)
}

struct LevelReader<'a> {
    root: &'a Root,
    blob: &'a [u8],
    grid: Grid,
    /// Vertex in each cell of the grid.
    vertices: HashMap<[u16; 3], u32>,
    mesh: Mesh,
}

impl LevelReader<'_> {
    /// Adds the patch of a node.
    fn add(&mut self, node: &Node) -> Result<(), ReadError> {
        let name = node.name.as_deref().unwrap_or_default();
        let wrong = |detail: &str| ReadError::document(format!("node {name}"), detail);
        let kind =
            PatchKind::named(name).ok_or_else(|| ReadError::document("nodes", "a node is not named like a patch"))?;
        if self.mesh.patches.iter().any(|patch| patch.kind == kind) {
            return Err(wrong("the body has this patch twice"));
        }
        let mesh = node.mesh.and_then(|mesh| self.root.meshes.get(mesh.value()));
        let primitive = mesh.and_then(|mesh| mesh.primitives.first()).ok_or_else(|| wrong("it has no primitive"))?;
        let positions = primitive.attributes.get(&Checked::Valid(Semantic::Positions));
        let positions = self.accessor(positions.copied()).ok_or_else(|| wrong("it has no positions"))?;
        let indices = self.accessor(primitive.indices).ok_or_else(|| wrong("it has no indices"))?;
        let (data, view) = self.view(positions, Mode::Attributes)?;
        let is_u16 = matches!(positions.component_type, Checked::Valid(GenericComponentType(ComponentType::U16)));
        if view.byte_stride != VECTOR_BYTES || !is_u16 {
            return Err(wrong("its positions are not of 16 bits"));
        }
        let cells: Vec<[u8; VECTOR_BYTES]> =
            meshopt::decode_vertex_buffer(data, view.count).map_err(|_| wrong("its positions are damaged"))?;
        let (data, view) = self.view(indices, Mode::Triangles)?;
        if view.count % 3 != 0 {
            return Err(wrong("the number of its indices is not a multiple of three"));
        }
        let indices: Vec<u32> =
            meshopt::decode_index_buffer(data, view.count).map_err(|_| wrong("its indices are damaged"))?;
        limits::vertices(name, (self.mesh.positions.len() + cells.len()) as u64)?;
        limits::triangles(name, (self.mesh.triangles.len() + indices.len() / 3) as u64)?;
        let (vertices, mesh) = (&mut self.vertices, &mut self.mesh);
        let merged: Vec<u32> = cells
            .iter()
            .map(|&[a, b, c, d, e, f, ..]| {
                let cell = [[a, b], [c, d], [e, f]].map(u16::from_le_bytes);
                *vertices.entry(cell).or_insert_with(|| {
                    mesh.positions.push(self.grid.position(cell));
                    mesh.positions.len() as u32 - 1
                })
            })
            .collect();
        let begin = mesh.triangles.len();
        let (triangles, _) = indices.as_chunks::<3>();
        for t in triangles {
            let [Some(a), Some(b), Some(c)] = t.map(|v| merged.get(v as usize).copied()) else {
                return Err(wrong("an index is out of range"));
            };
            mesh.triangles.push([a, b, c]);
        }
        mesh.patches.push(Patch { kind, triangles: begin..mesh.triangles.len() });
        Ok(())
    }

    fn accessor(&self, index: Option<Index<Accessor>>) -> Option<&Accessor> {
        self.root.accessors.get(index?.value())
    }

    /// Compressed data of an accessor that covers a whole view. The count is one that the data can
    /// have.
    fn view(&self, accessor: &Accessor, mode: Mode) -> Result<(&[u8], Compression), ReadError> {
        let wrong = |detail: &str| ReadError::document("bufferViews", detail);
        let view = accessor.buffer_view.and_then(|view| self.root.buffer_views.get(view.value()));
        let view = view.ok_or_else(|| wrong("one is missing"))?;
        let object = view.extensions.as_ref().and_then(|extensions| extensions.others.get(COMPRESSION));
        let object = object.ok_or_else(|| wrong("one is not compressed"))?;
        let view: Compression =
            serde_json::from_value(object.clone()).map_err(|_| wrong("the compression of one is not known"))?;
        let end = view.byte_offset.checked_add(view.byte_length);
        let data = end.and_then(|end| self.blob.get(view.byte_offset..end)).filter(|_| view.buffer == 0);
        let data = data.ok_or_else(|| wrong("one reaches beyond the data"))?;
        let fits = view.count as u64 == accessor.count.0 && view.count / MAX_PER_BYTE <= data.len();
        if view.mode != mode || !fits {
            return Err(wrong("one does not hold what its accessor says"));
        }
        Ok((data, view))
    }
}

impl From<Mesh> for Surface {
    fn from(mesh: Mesh) -> Self {
        let group = |patch: Patch| Group { name: patch.kind.name().into(), triangles: patch.triangles };
        Self {
            positions: mesh.positions.iter().map(|p| p.map(f64::from)).collect(),
            triangles: mesh.triangles,
            groups: mesh.patches.into_iter().map(group).collect(),
            unit: Unit::Stated(1.0),
            notes: Vec::new(),
        }
    }
}
