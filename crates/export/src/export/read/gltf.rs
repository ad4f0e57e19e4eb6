//! glTF 2.0: reads all triangles of a scene as one surface, with the transforms of nodes applied.
//!
//! The `gltf` crate parses and validates the document. The container and the data are read here, so
//! that no length in the file is trusted. Triangle lists, strips and fans are read; points and
//! lines are skipped. Triangles of a mirrored node are reversed, as the format requires. Sparse
//! accessors, skins and morph targets are not read.
//!
//! A few bytes can place one mesh a million times, and many primitives can share one accessor. All
//! vertices and triangles that the nodes place are therefore counted first, mesh by mesh. A
//! document above the [`limits`] is refused before any of them is read.

use super::accessor::{count, indices, positions};
use super::buffers::Buffers;
use super::document::{chunks, refused, root};
use super::error::ReadError;
use super::level;
use super::limits;
use super::surface::{Group, Surface, Unit, strip_triangles};
use ::gltf::json::Root;
use ::gltf::mesh::Mode;
use ::gltf::scene::Transform;
use ::gltf::{Accessor, Document, Mesh, Node, Primitive};
use glam::{DMat3, DMat4, DVec3, Mat4};
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
    let nodes = mesh_nodes(&document, roots)?;
    let buffers = Buffers::load(&document, bytes.len() as u64, blob, folder)?;
    let materials: Vec<Option<Arc<str>>> =
        document.materials().map(|material| material.name().map(Arc::from)).collect();
    let mesh = |mesh| TriangleMesh::new(&mesh, &materials, &buffers);
    let meshes = document.meshes().map(mesh).collect::<Result<Vec<_>, _>>()?;
    let (vertices, triangles) = total(&nodes, &meshes)?;
    let mut surface = Surface { unit: Unit::Stated(1.0), ..Surface::default() };
    surface.positions.reserve_exact(vertices as usize);
    surface.triangles.reserve(triangles as usize);
    let mut reader = SceneReader { surface, buffers };
    for node in &nodes {
        reader.read(node, &meshes[node.mesh])?;
    }
    Ok(reader.surface)
}

/// Refuses attributes that name a missing accessor; the validation of the crate would panic on
/// them.
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

/// Nodes that have no parent, for documents without a scene.
fn roots(document: &Document) -> Vec<Node<'_>> {
    let children: HashSet<usize> =
        document.nodes().flat_map(|node| node.children().map(|child| child.index()).collect::<Vec<_>>()).collect();
    document.nodes().filter(|node| !children.contains(&node.index())).collect()
}

/// A node that places a mesh.
struct MeshNode {
    name: Option<Arc<str>>,
    mesh: usize,
    placement: Placement,
}

/// Collects the nodes below `roots` that place a mesh, in depth-first order, for trees of any
/// depth.
fn mesh_nodes(document: &Document, roots: Vec<Node<'_>>) -> Result<Vec<MeshNode>, ReadError> {
    let mut seen = vec![false; document.nodes().len()];
    let mut found = Vec::new();
    let mut stack: Vec<(Node<'_>, Placement)> = roots.into_iter().rev().map(|node| (node, Placement(None))).collect();
    while let Some((node, parent)) = stack.pop() {
        if std::mem::replace(&mut seen[node.index()], true) {
            return Err(ReadError::document(format!("nodes[{}]", node.index()), "it has more than one parent"));
        }
        let placement = parent.of_child(node.transform());
        if let Some(mesh) = node.mesh() {
            found.push(MeshNode { name: node.name().map(Arc::from), mesh: mesh.index(), placement });
        }
        let first = stack.len();
        stack.extend(node.children().map(|child| (child, placement)));
        stack[first..].reverse();
    }
    Ok(found)
}

/// Affine transform of a node in f64. `None` is the identity, which leaves the bits of coordinates
/// unchanged.
#[derive(Clone, Copy)]
struct Placement(Option<DMat4>);

impl Placement {
    /// Placement of a child whose transform relative to this node is `transform`.
    fn of_child(self, transform: Transform) -> Self {
        let own = Mat4::from_cols_array_2d(&transform.matrix()).as_dmat4();
        if own == DMat4::IDENTITY { self } else { Self(Some(self.0.map_or(own, |parent| parent * own))) }
    }

    fn apply(self, point: [f64; 3]) -> [f64; 3] {
        self.0.map_or(point, |matrix| matrix.transform_point3(DVec3::from(point)).into())
    }

    fn reverses_orientation(self) -> bool {
        self.0.is_some_and(|matrix| DMat3::from_mat4(matrix).determinant() < 0.0)
    }
}

/// The primitives of a mesh that have triangles, and their total size.
struct TriangleMesh<'a> {
    name: Option<Arc<str>>,
    primitives: Vec<TrianglePrimitive<'a>>,
    vertices: u64,
    /// Upper bound, since it includes the triangles of repeated vertices that join strips.
    triangles: u64,
}

struct TrianglePrimitive<'a> {
    primitive: Primitive<'a>,
    positions: Accessor<'a>,
    /// Name of its material, if the mesh has several primitives.
    name: Option<Arc<str>>,
    path: Arc<str>,
}

impl<'a> TriangleMesh<'a> {
    fn new(mesh: &Mesh<'a>, materials: &[Option<Arc<str>>], buffers: &Buffers<'_>) -> Result<Self, ReadError> {
        let mut found = Self { name: mesh.name().map(Arc::from), primitives: Vec::new(), vertices: 0, triangles: 0 };
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
            found.triangles += triangles;
            if known.insert(positions.index()) {
                found.vertices += vertices;
            }
            let material = primitive.material().index().filter(|_| several);
            let name = material.and_then(|index| materials[index].clone());
            found.primitives.push(TrianglePrimitive { primitive, positions, name, path: path.into() });
        }
        Ok(found)
    }
}

/// Counts the vertices and, as an upper bound, the triangles that all nodes place.
fn total(nodes: &[MeshNode], meshes: &[TriangleMesh<'_>]) -> Result<(u64, u64), ReadError> {
    let (mut vertices, mut triangles) = (0u64, 0u64);
    for node in nodes {
        let mesh = &meshes[node.mesh];
        vertices = vertices.saturating_add(mesh.vertices);
        triangles = triangles.saturating_add(mesh.triangles);
    }
    let path = "nodes (all instances of meshes placed)";
    limits::triangles(path, triangles)?;
    limits::vertices(path, vertices)?;
    Ok((vertices, triangles))
}

struct SceneReader<'a> {
    surface: Surface,
    buffers: Buffers<'a>,
}

impl SceneReader<'_> {
    fn read(&mut self, node: &MeshNode, mesh: &TriangleMesh<'_>) -> Result<(), ReadError> {
        // First vertex and number of vertices by accessor: primitives of a mesh often share theirs.
        let mut known = HashMap::new();
        for part in &mesh.primitives {
            let (base, count) = match known.get(&part.positions.index()) {
                Some(&vertices) => vertices,
                None => {
                    let base = self.surface.positions.len();
                    let points = positions(&part.positions, &self.buffers)?;
                    let vertices = (base as u32, points.len());
                    self.surface.positions.extend(points.map(|p| node.placement.apply(p)));
                    known.insert(part.positions.index(), vertices);
                    vertices
                }
            };
            let begin = self.surface.triangles.len();
            self.read_triangles(part, base, count, node.placement.reverses_orientation())?;
            let name = part.name.as_ref().or(node.name.as_ref()).or(mesh.name.as_ref()).unwrap_or(&part.path);
            let triangles = begin..self.surface.triangles.len();
            self.surface.groups.push(Group { name: Arc::clone(name), triangles });
        }
        Ok(())
    }

    fn read_triangles(
        &mut self,
        part: &TrianglePrimitive<'_>,
        base: u32,
        count: usize,
        mirrored: bool,
    ) -> Result<(), ReadError> {
        let list = match part.primitive.indices() {
            Some(accessor) => indices(&accessor, &self.buffers)?,
            None => (0..count as u32).collect(),
        };
        if let Some(bad) = list.iter().find(|&&v| v as usize >= count) {
            return Err(ReadError::document(&*part.path, format!("there is no vertex {bad}")));
        }
        let triangles = &mut self.surface.triangles;
        let mut add = |[a, b, c]: [u32; 3], reversed: bool| {
            let t = if reversed == mirrored { [a, b, c] } else { [a, c, b] };
            triangles.push(t.map(|v| v + base));
        };
        match part.primitive.mode() {
            Mode::TriangleStrip => strip_triangles(&list).for_each(|(t, reversed)| add(t, reversed)),
            Mode::TriangleFan => list.windows(2).skip(1).for_each(|w| add([w[0], w[1], list[0]], false)),
            _ => {
                let (whole, rest) = list.as_chunks::<3>();
                if !rest.is_empty() {
                    let detail = "the number of its indices is not a multiple of three";
                    return Err(ReadError::document(&*part.path, detail));
                }
                whole.iter().for_each(|t| add(*t, false));
            }
        }
        Ok(())
    }
}
