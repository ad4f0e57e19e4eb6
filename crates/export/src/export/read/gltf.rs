//! glTF 2.0: reads all triangles of a scene as one surface, in its default pose.
//!
//! Only scenes, nodes, meshes, skins, accessors, views and buffers matter, and of these only what
//! the scene uses. Other parts are passed over unread, and extensions are read, passed over with a
//! note, or refused by name (`extensions`). Triangle lists, strips and fans are read. Triangles of
//! a mirrored node are reversed, as the format requires.
//!
//! A few bytes can place one mesh a million times, and many primitives can share one accessor. All
//! vertices and triangles that the nodes place are therefore counted first, mesh by mesh. A
//! document above the [`limits`] is refused before any of them is read.

mod accessor;
mod buffers;
mod container;
mod document;
mod extensions;
mod instances;
mod json;
mod mesh;
mod meshopt;
mod notes;
mod placement;
mod pose;
mod scene;
mod views;

use super::error::ReadError;
use super::limits;
use super::surface::{Group, Surface, Unit};
use accessor::Accessors;
use buffers::Buffers;
use document::Document;
use instances::Instances;
use mesh::{MaterialNames, TriangleMesh, TrianglePrimitive};
use notes::Notes;
use placement::Placement;
use pose::{Skin, morph};
use scene::{MeshNode, Scene};
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::path::Path;
use std::sync::Arc;
use views::Views;

pub(super) fn parse(bytes: &[u8], folder: Option<&Path>) -> Result<Surface, ReadError> {
    let mut notes = Notes::default();
    let (json, blob) = container::chunks(bytes, &mut notes)?;
    let text = document::text(json, &mut notes)?;
    let document = Document::parse(&text, notes)?;
    document.check(&document.root, &extensions::KNOWN)?;
    let mut surface = {
        let buffers = Buffers::new(&document, bytes.len() as u64, blob, folder);
        let views = Views::new(&document, &buffers);
        read(&document, &Accessors::new(&document, &views))?
    };
    for note in document.into_notes() {
        surface.note(note);
    }
    Ok(surface)
}

fn read<'a>(document: &'a Document<'a>, accessors: &'a Accessors<'_>) -> Result<Surface, ReadError> {
    let scene = scene::read(document)?;
    let mut names = MaterialNames::new(document);
    let mut meshes = HashMap::new();
    for node in &scene.meshes {
        if let Entry::Vacant(new) = meshes.entry(node.mesh) {
            new.insert(TriangleMesh::find(document, accessors, &mut names, node.mesh)?);
        }
    }
    let placed: Vec<Placed<'_>> = (scene.meshes.iter())
        .map(|node| {
            Ok(Placed { node, mesh: &meshes[&node.mesh], instances: Instances::find(document, accessors, node)? })
        })
        .collect::<Result<_, ReadError>>()?;
    let (vertices, triangles) = total(&placed)?;
    let mut surface = Surface { unit: Unit::Stated(1.0), ..Surface::default() };
    surface.positions.reserve_exact(vertices as usize);
    surface.triangles.reserve(triangles as usize);
    let mut reader = SceneReader { document, accessors, scene: &scene, skins: HashMap::new(), surface };
    for placed in &placed {
        reader.read(placed)?;
    }
    Ok(reader.surface)
}

/// A mesh that a node places, once or several times.
struct Placed<'a> {
    node: &'a MeshNode,
    mesh: &'a TriangleMesh<'a>,
    instances: Instances<'a>,
}

impl Placed<'_> {
    /// Weights of morph targets.
    fn weights(&self) -> &[f64] {
        self.node.weights.as_ref().unwrap_or(&self.mesh.weights)
    }
}

/// Counts the vertices and, as an upper bound, the triangles that all nodes place.
fn total(placed: &[Placed<'_>]) -> Result<(u64, u64), ReadError> {
    let (mut vertices, mut triangles, mut moved) = (0u64, 0u64, 0u64);
    for place in placed {
        let (mesh, count) = (place.mesh, place.instances.count as u64);
        // An instance takes memory even if its mesh is empty.
        vertices = vertices.saturating_add(mesh.vertices.max(1).saturating_mul(count));
        triangles = triangles.saturating_add(mesh.triangles.saturating_mul(count));
        let targets = place.weights().iter().filter(|&&weight| weight != 0.0).count() as u64;
        let joints = if place.node.skin.is_some() { mesh.joint_sets } else { 0 };
        moved = moved.saturating_add(mesh.vertices.saturating_mul(targets + joints));
    }
    let path = "nodes (all instances of meshes placed)";
    limits::triangles(path, triangles)?;
    limits::vertices(path, vertices)?;
    limits::limited(path, moved, "vertices of morph targets and joints", limits::VERTICES)?;
    Ok((vertices, triangles))
}

struct SceneReader<'a, 'v> {
    document: &'a Document<'a>,
    accessors: &'a Accessors<'v>,
    scene: &'a Scene,
    skins: HashMap<usize, Skin>,
    surface: Surface,
}

impl SceneReader<'_, '_> {
    fn read(&mut self, placed: &Placed<'_>) -> Result<(), ReadError> {
        // Primitives of a mesh often share their vertices.
        let mut known = HashMap::new();
        for part in &placed.mesh.primitives {
            let key = (part.vertices, part.pose.as_ref().map(|pose| pose.path.as_str()));
            let vertices = match known.entry(key) {
                Entry::Occupied(known) => known.into_mut(),
                Entry::Vacant(new) => new.insert(self.read_vertices(part, placed)?),
            };
            self.read_triangles(part, placed, vertices)?;
        }
        Ok(())
    }

    /// Reads the vertices of all instances of a primitive.
    fn read_vertices(&mut self, part: &TrianglePrimitive<'_>, placed: &Placed<'_>) -> Result<Vertices, ReadError> {
        let positions = &mut self.surface.positions;
        let base = positions.len();
        part.positions.read(positions)?;
        let points = &mut positions[base..];
        let mut own = placed.node.placement;
        let mut is_mirrored = None;
        if let Some(primitive) = &part.pose {
            morph(self.document, self.accessors, primitive, placed.weights(), points)?;
            if let Some(index) = placed.node.skin {
                let skin = match self.skins.entry(index) {
                    Entry::Occupied(known) => known.into_mut(),
                    Entry::Vacant(new) => new.insert(Skin::read(self.document, self.accessors, self.scene, index)?),
                };
                if skin.apply(self.document, self.accessors, primitive, points)? {
                    own = Placement(None);
                    is_mirrored = Some(skin.is_mirrored);
                }
            }
        }
        let instances = placed.instances.placements(own)?;
        let mirrored = |placement: &Placement| is_mirrored.unwrap_or_else(|| placement.reverses_orientation());
        let bases = (0..instances.len()).map(|i| (base + i * part.positions.count) as u32);
        let found = Vertices { instances: bases.zip(instances.iter().map(mirrored)).collect() };
        if let [only] = instances[..] {
            points.iter_mut().for_each(|point| *point = only.apply(*point));
        } else {
            let points = positions.split_off(base);
            for placement in &instances {
                positions.extend(points.iter().map(|point| placement.apply(*point)));
            }
        }
        Ok(found)
    }

    /// Reads the triangles of all instances of a primitive.
    fn read_triangles(
        &mut self,
        part: &TrianglePrimitive<'_>,
        placed: &Placed<'_>,
        vertices: &Vertices,
    ) -> Result<(), ReadError> {
        let triangles = &mut self.surface.triangles;
        let begin = triangles.len();
        if let [(base, mirrored)] = vertices.instances[..] {
            part.triangles(|[a, b, c], reversed| {
                let t = if reversed == mirrored { [a, b, c] } else { [a, c, b] };
                triangles.push(t.map(|v| v + base));
            })?;
        } else {
            let mut list = Vec::new();
            part.triangles(|triangle, reversed| list.push((triangle, reversed)))?;
            for &(base, mirrored) in &vertices.instances {
                triangles.extend(list.iter().map(|&([a, b, c], reversed)| {
                    let t = if reversed == mirrored { [a, b, c] } else { [a, c, b] };
                    t.map(|v| v + base)
                }));
            }
        }
        let names = [&part.name, &placed.node.name, &placed.mesh.name];
        let name = names.into_iter().flatten().next().unwrap_or(&part.path);
        let triangles = begin..triangles.len();
        self.surface.groups.push(Group { name: Arc::clone(name), triangles });
        Ok(())
    }
}

/// Vertices of a primitive in the surface.
struct Vertices {
    /// First vertex of each instance, and true if the instance is mirrored.
    instances: Vec<(u32, bool)>,
}

#[cfg(test)]
mod tests;
