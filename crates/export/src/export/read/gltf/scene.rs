//! The nodes of a scene that place a mesh, with their transforms.

use super::document::Document;
use super::extensions::{INSTANCING, VISIBILITY};
use super::json::Object;
use super::placement::{Placement, of_node};
use crate::export::read::error::ReadError;
use std::collections::{HashMap, HashSet};
use std::sync::Arc;

/// A node that places a mesh.
pub(super) struct MeshNode {
    /// Number of the node.
    pub(super) index: usize,
    pub(super) name: Option<Arc<str>>,
    pub(super) mesh: usize,
    pub(super) placement: Placement,
    pub(super) skin: Option<usize>,
    /// Weights of morph targets that replace those of the mesh.
    pub(super) weights: Option<Vec<f64>>,
    pub(super) has_instances: bool,
}

/// The scene that is read.
pub(super) struct Scene {
    /// Nodes with meshes, depth first.
    pub(super) meshes: Vec<MeshNode>,
    /// Placement of each node that is a joint of a skin.
    pub(super) joints: HashMap<usize, Placement>,
}

/// Reads the default scene, else the first one, else all nodes without a parent.
pub(super) fn read(document: &Document<'_>) -> Result<Scene, ReadError> {
    let stated = document.root.refer("scene", &document.scenes)?;
    let others = document.scenes.len().saturating_sub(1);
    let chosen = stated.unwrap_or(0);
    if others > 0 {
        document.note("scenes", format!("scene {chosen} was read; the other scenes ({others}) were not"));
    }
    let mut roots = if document.scenes.len() == 0 {
        parentless(document)?
    } else {
        let scene = document.scenes.get(chosen)?;
        document.check(&scene, &[])?;
        scene.refer_all("nodes", &document.nodes)?
    };
    let mut known = HashSet::new();
    roots.retain(|root| known.insert(*root));
    let mut walk = Walk {
        document,
        seen: vec![false; document.nodes.len()],
        is_joint: joints(document),
        has_mesh: false,
        scene: Scene { meshes: Vec::new(), joints: HashMap::new() },
    };
    walk.descend(roots, true)?;
    if !walk.has_mesh {
        if document.scenes.len() == 0 {
            document.note("nodes", "no node places a mesh");
        } else {
            document.note(&format!("scenes[{chosen}]"), "the scene has no mesh");
        }
    }
    if walk.scene.meshes.iter().any(|node| node.skin.is_some()) && walk.scene.joints.len() < walk.is_joint.len() {
        // Joints outside of the scene.
        walk.descend(parentless(document)?, false)?;
    }
    Ok(walk.scene)
}

/// Nodes that have no parent.
fn parentless(document: &Document<'_>) -> Result<Vec<usize>, ReadError> {
    let mut is_child = vec![false; document.nodes.len()];
    for index in 0..document.nodes.len() {
        for child in document.nodes.get(index)?.refer_all("children", &document.nodes)? {
            is_child[child] = true;
        }
    }
    Ok((0..is_child.len()).filter(|&index| !is_child[index]).collect())
}

/// Nodes that are joints of a skin. Faults are found when a skin is used.
fn joints(document: &Document<'_>) -> HashSet<usize> {
    let skins = (0..document.skins.len()).filter_map(|index| document.skins.get(index).ok());
    skins.filter_map(|skin| skin.refer_all("joints", &document.nodes).ok()).flatten().collect()
}

struct Walk<'a> {
    document: &'a Document<'a>,
    seen: Vec<bool>,
    is_joint: HashSet<usize>,
    /// True if a node of the scene, visible or not, has a mesh.
    has_mesh: bool,
    scene: Scene,
}

/// What a node has from its parents.
#[derive(Clone, Copy)]
struct Inherited {
    placement: Placement,
    is_visible: bool,
}

impl Walk<'_> {
    /// Walks the trees below `roots`, of any depth. Outside of the scene only joints matter.
    fn descend(&mut self, roots: Vec<usize>, in_scene: bool) -> Result<(), ReadError> {
        let start = Inherited { placement: Placement(None), is_visible: true };
        let mut stack: Vec<(usize, Inherited)> = roots.into_iter().rev().map(|root| (root, start)).collect();
        while let Some((index, inherited)) = stack.pop() {
            let node = self.document.nodes.get(index)?;
            if std::mem::replace(&mut self.seen[index], true) {
                if in_scene {
                    return Err(node.fault("it has more than one parent"));
                }
                continue;
            }
            let own = self.visit(index, &node, inherited, in_scene)?;
            let first = stack.len();
            stack.extend(node.refer_all("children", &self.document.nodes)?.into_iter().map(|child| (child, own)));
            stack[first..].reverse();
        }
        Ok(())
    }

    fn visit(
        &mut self,
        index: usize,
        node: &Object<'_>,
        inherited: Inherited,
        in_scene: bool,
    ) -> Result<Inherited, ReadError> {
        let placement = inherited.placement.of_child(of_node(self.document, node)?);
        if !placement.is_finite() {
            return Err(node.fault("its transform, with those of its parents, is beyond the range of numbers"));
        }
        if self.is_joint.contains(&index) {
            self.scene.joints.insert(index, placement);
        }
        let own = Inherited { placement, is_visible: inherited.is_visible && is_visible(node)? };
        if !in_scene {
            return Ok(own);
        }
        let mesh = node.refer("mesh", &self.document.meshes)?;
        self.has_mesh |= mesh.is_some();
        if !own.is_visible {
            if mesh.is_some() {
                self.document.note(&node.path, format!("the node is invisible ({VISIBILITY}) and was passed over"));
            }
            return Ok(own);
        }
        self.document.check(node, &[INSTANCING, VISIBILITY])?;
        if let Some(mesh) = mesh {
            self.scene.meshes.push(MeshNode {
                index,
                name: node.text("name").map(Arc::from),
                mesh,
                placement,
                skin: node.refer("skin", &self.document.skins)?,
                weights: node.numbers("weights")?,
                has_instances: node.extension(INSTANCING)?.is_some(),
            });
        }
        Ok(own)
    }
}

fn is_visible(node: &Object<'_>) -> Result<bool, ReadError> {
    let Some(visibility) = node.extension(VISIBILITY)? else { return Ok(true) };
    Ok(!visibility.has("visible") || visibility.flag("visible")?)
}
