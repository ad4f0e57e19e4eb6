//! glTF 2.0: all triangles of a scene as one surface, node transforms applied.
//!
//! The `gltf` crate parses and validates the document; the container and the data are read here, so that no length in
//! the file is trusted. Triangles in lists, strips and fans are read; points and lines are left out. The triangles of a
//! mirrored node are reversed, as the format requires. Not read: sparse accessors, skins, morph targets.
//!
//! A few bytes can place one mesh a million times, and many primitives can share one accessor. What all nodes together
//! place is therefore counted first, mesh by mesh, and refused if it is above the [`limits`]; only then is it read.

use super::accessor::{count, indices, positions};
use super::buffers::Buffers;
use super::document::{chunks, refused, root};
use super::error::ReadError;
use super::level;
use super::limits;
use super::placement::Placement;
use super::surface::{Group, Surface, Unit};
use ::gltf::json::Root;
use ::gltf::mesh::Mode;
use ::gltf::{Accessor, Document, Mesh, Node, Primitive};
use std::collections::{HashMap, HashSet};
use std::path::Path;
use std::sync::Arc;

pub(super) fn parse(bytes: &[u8], folder: Option<&Path>) -> Result<Surface, ReadError> {
    let (json, blob) = if bytes.starts_with(b"glTF") { chunks(bytes)? } else { (bytes, None) };
    let root = root(json)?;
    if level::is_level(&root) {
        return level::mesh(&root, blob.unwrap_or_default()).map(Surface::from);
    }
    check_attributes(&root)?;
    let document = Document::from_json(root).map_err(refused)?;
    let scene = document.default_scene().or_else(|| document.scenes().next());
    let roots = scene.map_or_else(|| roots(&document), |scene| scene.nodes().collect());
    let nodes = placed(&document, roots)?;
    let buffers = Buffers::load(&document, bytes.len() as u64, blob, folder)?;
    let materials: Vec<Option<Arc<str>>> =
        document.materials().map(|material| material.name().map(Arc::from)).collect();
    let parts = document.meshes().map(|mesh| Parts::of(&mesh, &materials, &buffers)).collect::<Result<Vec<_>, _>>()?;
    let (vertices, triangles) = total(&nodes, &parts)?;
    let mut surface = Surface { unit: Unit::Stated(1.0), ..Surface::default() };
    surface.positions.reserve_exact(vertices as usize);
    surface.triangles.reserve(triangles as usize);
    let mut reader = Reader { surface, buffers };
    for node in &nodes {
        reader.read(node, &parts[node.mesh])?;
    }
    Ok(reader.surface)
}

/// Refuses attributes that name no accessor: the validation of the crate takes for granted that there is one.
fn check_attributes(root: &Root) -> Result<(), ReadError> {
    for (m, mesh) in root.meshes.iter().enumerate() {
        for (p, primitive) in mesh.primitives.iter().enumerate() {
            if let Some(index) = primitive.attributes.values().find(|i| i.value() >= root.accessors.len()) {
                let detail = format!("an attribute names accessor {}, which does not exist", index.value());
                return Err(ReadError::document(format!("meshes[{m}].primitives[{p}].attributes"), detail));
            }
        }
    }
    Ok(())
}

/// Nodes that are no other node's children, for documents without a scene.
fn roots(document: &Document) -> Vec<Node<'_>> {
    let children: HashSet<usize> =
        document.nodes().flat_map(|node| node.children().map(|child| child.index()).collect::<Vec<_>>()).collect();
    document.nodes().filter(|node| !children.contains(&node.index())).collect()
}

/// A node that places a mesh.
struct Placed {
    name: Option<Arc<str>>,
    mesh: usize,
    placement: Placement,
}

/// The nodes below `roots` that place a mesh, in the order of the tree, however deep it is.
fn placed(document: &Document, roots: Vec<Node<'_>>) -> Result<Vec<Placed>, ReadError> {
    let mut seen = vec![false; document.nodes().len()];
    let mut found = Vec::new();
    let mut stack: Vec<(Node<'_>, Placement)> = roots.into_iter().rev().map(|node| (node, Placement::AS_IS)).collect();
    while let Some((node, above)) = stack.pop() {
        if std::mem::replace(&mut seen[node.index()], true) {
            return Err(ReadError::document(format!("nodes[{}]", node.index()), "it has more than one parent"));
        }
        let placement = above.of_child(node.transform());
        if let Some(mesh) = node.mesh() {
            found.push(Placed { name: node.name().map(Arc::from), mesh: mesh.index(), placement });
        }
        let first = stack.len();
        stack.extend(node.children().map(|child| (child, placement)));
        stack[first..].reverse();
    }
    Ok(found)
}

/// The primitives of a mesh that have triangles, and their total size.
struct Parts<'a> {
    /// Name of the mesh.
    name: Option<Arc<str>>,
    primitives: Vec<Part<'a>>,
    vertices: u64,
    /// Upper bound: includes those of repeated vertices, which only stitch strips together.
    triangles: u64,
}

struct Part<'a> {
    primitive: Primitive<'a>,
    positions: Accessor<'a>,
    /// Name of its material, if the mesh has several primitives.
    name: Option<Arc<str>>,
    path: Arc<str>,
}

impl<'a> Parts<'a> {
    fn of(mesh: &Mesh<'a>, materials: &[Option<Arc<str>>], buffers: &Buffers<'_>) -> Result<Self, ReadError> {
        let name = mesh.name().map(Arc::from);
        let mut parts = Self { name, primitives: Vec::new(), vertices: 0, triangles: 0 };
        let several = mesh.primitives().len() > 1;
        let mut known = HashSet::new();
        for primitive in mesh.primitives() {
            if matches!(primitive.mode(), Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip) {
                continue;
            }
            let path = format!("meshes[{}].primitives[{}]", mesh.index(), primitive.index());
            let positions = primitive
                .get(&::gltf::Semantic::Positions)
                .ok_or_else(|| ReadError::document(path.as_str(), "it has no positions"))?;
            let vertices = count(&positions, buffers)?;
            let corners = primitive.indices().map_or(Ok(vertices), |accessor| count(&accessor, buffers))?;
            let triangles = if primitive.mode() == Mode::Triangles { corners.div_ceil(3) } else { corners };
            if triangles == 0 {
                continue;
            }
            parts.triangles += triangles;
            if known.insert(positions.index()) {
                parts.vertices += vertices;
            }
            let material = primitive.material().index().filter(|_| several);
            let name = material.and_then(|index| materials[index].clone());
            parts.primitives.push(Part { primitive, positions, name, path: path.into() });
        }
        Ok(parts)
    }
}

/// The number of vertices and, at most, of triangles that all nodes place.
fn total(nodes: &[Placed], parts: &[Parts<'_>]) -> Result<(u64, u64), ReadError> {
    let (mut vertices, mut triangles) = (0u64, 0u64);
    for node in nodes {
        let parts = &parts[node.mesh];
        vertices = vertices.saturating_add(parts.vertices);
        triangles = triangles.saturating_add(parts.triangles);
    }
    let path = "nodes (all instances of meshes placed)";
    limits::triangles(path, triangles)?;
    limits::vertices(path, vertices)?;
    Ok((vertices, triangles))
}

struct Reader<'a> {
    surface: Surface,
    buffers: Buffers<'a>,
}

impl Reader<'_> {
    fn read(&mut self, node: &Placed, parts: &Parts<'_>) -> Result<(), ReadError> {
        // Primitives of a mesh often share their vertices.
        let mut bases = HashMap::new();
        for part in &parts.primitives {
            let (base, count) = match bases.get(&part.positions.index()) {
                Some(&known) => known,
                None => {
                    let base = self.surface.positions.len();
                    let points = positions(&part.positions, &self.buffers)?;
                    let added = (base as u32, points.len());
                    self.surface.positions.extend(points.map(|p| node.placement.apply(p)));
                    bases.insert(part.positions.index(), added);
                    added
                }
            };
            let begin = self.surface.triangles.len();
            self.read_triangles(part, base, count, node.placement.mirrors())?;
            let name = part.name.as_ref().or(node.name.as_ref()).or(parts.name.as_ref()).unwrap_or(&part.path);
            let triangles = begin..self.surface.triangles.len();
            self.surface.groups.push(Group { name: Arc::clone(name), triangles });
        }
        Ok(())
    }

    fn read_triangles(&mut self, part: &Part<'_>, base: u32, count: usize, mirrored: bool) -> Result<(), ReadError> {
        let list = match part.primitive.indices() {
            Some(accessor) => indices(&accessor, &self.buffers)?,
            None => (0..count as u32).collect(),
        };
        if let Some(bad) = list.iter().find(|&&v| v as usize >= count) {
            return Err(ReadError::document(&*part.path, format!("there is no vertex {bad}")));
        }
        let triangles = &mut self.surface.triangles;
        let mut add = |[a, b, c]: [u32; 3]| {
            let t = if mirrored { [a, c, b] } else { [a, b, c] };
            triangles.push(t.map(|v| v + base));
        };
        match part.primitive.mode() {
            Mode::TriangleStrip => {
                for (i, w) in list.windows(3).enumerate() {
                    // Repeated vertices only stitch strips together.
                    if w[0] != w[1] && w[1] != w[2] && w[2] != w[0] {
                        add(if i % 2 == 0 { [w[0], w[1], w[2]] } else { [w[0], w[2], w[1]] });
                    }
                }
            }
            Mode::TriangleFan => list.windows(2).skip(1).for_each(|w| add([w[0], w[1], list[0]])),
            _ => {
                let (whole, rest) = list.as_chunks::<3>();
                if !rest.is_empty() {
                    return Err(ReadError::document(
                        &*part.path,
                        "the number of its indices is not a multiple of three",
                    ));
                }
                whole.iter().for_each(|t| add(*t));
            }
        }
        Ok(())
    }
}
