//! The default pose of a mesh: morph targets with their weights, then the joints of a skin.

use super::accessor::{Accessors, Component};
use super::document::Document;
use super::json::Object;
use super::mesh::POSITIONS;
use super::placement::Placement;
use super::scene::Scene;
use crate::export::read::error::ReadError;
use glam::{DMat4, DVec3};

/// Adds the targets of a primitive to its points, each times its weight.
pub(super) fn morph(
    document: &Document<'_>,
    accessors: &Accessors<'_>,
    primitive: &Object<'_>,
    weights: &[f64],
    points: &mut [[f64; 3]],
) -> Result<(), ReadError> {
    if weights.iter().all(|&weight| weight == 0.0) {
        return Ok(());
    }
    let targets = primitive.array("targets")?;
    if weights.len() != targets.len() {
        let (weights, targets) = (weights.len(), targets.len());
        let detail = format!("the number of weights ({weights}) differs from the number of morph targets ({targets})");
        document.note(&primitive.path, detail);
    }
    let mut deltas: Vec<[f64; 3]> = Vec::new();
    for (i, weight) in weights.iter().enumerate().take(targets.len()).filter(|(_, weight)| **weight != 0.0) {
        let target = targets.get(i)?;
        let Some(accessor) = accessors.named(&target, "POSITION")? else { continue };
        accessor.expect("positions of morph targets", "VEC3", &POSITIONS)?;
        if accessor.count != points.len() {
            let detail = format!("it has {} positions, and the primitive has {}", accessor.count, points.len());
            return Err(target.wrong("POSITION", detail));
        }
        deltas.clear();
        accessor.read(&mut deltas)?;
        for (point, delta) in points.iter_mut().zip(&deltas) {
            *point = std::array::from_fn(|axis| point[axis] + weight * delta[axis]);
        }
        document.note(&target.path, "the morph target was applied with its default weight");
    }
    Ok(())
}

/// Joints of a skin in their default pose.
pub(super) struct Skin {
    /// Transform of points at each joint.
    joints: Vec<DMat4>,
    /// True if all joints reverse the orientation of triangles.
    pub(super) is_mirrored: bool,
}

impl Skin {
    pub(super) fn read(
        document: &Document<'_>,
        accessors: &Accessors<'_>,
        scene: &Scene,
        index: usize,
    ) -> Result<Self, ReadError> {
        let skin = document.skins.get(index)?;
        document.check(&skin, &[])?;
        let nodes = skin.refer_all("joints", &document.nodes)?;
        let mut inverse = Vec::new();
        if let Some(accessor) = accessors.named(&skin, "inverseBindMatrices")? {
            accessor.expect("inverse bind matrices", "MAT4", &[Component::F32])?;
            if accessor.count < nodes.len() {
                let detail = format!("it has {} matrices for {} joints", accessor.count, nodes.len());
                return Err(skin.wrong("inverseBindMatrices", detail));
            }
            if accessor.has_data() {
                accessor.read::<16>(&mut inverse)?;
            } else {
                inverse.resize(nodes.len(), [0.0; 16]);
            }
        } else {
            inverse.resize(nodes.len(), DMat4::IDENTITY.to_cols_array());
        }
        let joint = |(i, (node, inverse)): (usize, (&usize, &[f64; 16]))| {
            let placement = scene.joints.get(node).copied().unwrap_or_default();
            let matrix = placement.of_child(Placement::from(DMat4::from_cols_array(inverse)));
            let wrong = || skin.wrong(&format!("joints[{i}]"), "its transform is not finite");
            if matrix.is_finite() { Ok(matrix) } else { Err(wrong()) }
        };
        let joints = nodes.iter().zip(&inverse).enumerate().map(joint).collect::<Result<Vec<_>, _>>()?;
        let mirrored = joints.iter().filter(|joint| joint.reverses_orientation()).count();
        if mirrored > 0 && mirrored < joints.len() {
            document.note(&skin.path, "some joints are mirrored and others are not; no triangle was reversed");
        }
        Ok(Self {
            is_mirrored: mirrored > 0 && mirrored == joints.len(),
            joints: joints.into_iter().map(|joint| joint.0.unwrap_or(DMat4::IDENTITY)).collect(),
        })
    }

    /// Moves the points of a primitive to the scene. Returns false if the primitive has no joints.
    pub(super) fn apply(
        &self,
        document: &Document<'_>,
        accessors: &Accessors<'_>,
        primitive: &Object<'_>,
        points: &mut [[f64; 3]],
    ) -> Result<bool, ReadError> {
        let Some(attributes) = primitive.object("attributes")? else { return Ok(false) };
        // Sum of weights, and of moved points times weights.
        let mut sums = vec![(0.0, DVec3::ZERO); points.len()];
        let (mut joints, mut weights) = (Vec::<[f64; 4]>::new(), Vec::<[f64; 4]>::new());
        let mut sets = 0;
        while let Some(accessor) = accessors.named(&attributes, &format!("JOINTS_{sets}"))? {
            let name = format!("WEIGHTS_{sets}");
            accessor.expect("joints", "VEC4", &[Component::U8, Component::U16])?;
            if accessor.normalized {
                return Err(accessor.fault("its numbers are normalized, and joints are not"));
            }
            let other = accessors.named(&attributes, &name)?.ok_or_else(|| attributes.wrong(&name, "it is missing"))?;
            other.expect("weights of joints", "VEC4", &[Component::F32, Component::U8, Component::U16])?;
            if accessor.count != points.len() || other.count != points.len() {
                return Err(attributes.wrong(&name, "joints, weights and positions differ in number"));
            }
            joints.clear();
            weights.clear();
            accessor.read(&mut joints)?;
            other.read(&mut weights)?;
            for (vertex, (sum, point)) in sums.iter_mut().zip(points.iter()).enumerate() {
                for (&joint, &weight) in
                    joints[vertex].iter().zip(&weights[vertex]).filter(|(_, weight)| **weight != 0.0)
                {
                    let wrong = |detail: String| attributes.wrong(&name, format!("vertex {vertex}: {detail}"));
                    if !(weight > 0.0 && weight.is_finite()) {
                        return Err(wrong(format!("the weight {weight} is not a number from 0 to 1")));
                    }
                    let matrix = self.joints.get(joint as usize);
                    let matrix = matrix.ok_or_else(|| wrong(format!("the skin has no joint {joint}")))?;
                    let moved = if *matrix == DMat4::IDENTITY {
                        DVec3::from(*point)
                    } else {
                        matrix.transform_point3(DVec3::from(*point))
                    };
                    sum.0 += weight;
                    sum.1 += weight * moved;
                }
            }
            sets += 1;
        }
        if sets == 0 {
            return Ok(false);
        }
        for (vertex, (point, (sum, moved))) in points.iter_mut().zip(sums).enumerate() {
            if sum == 0.0 {
                return Err(attributes.wrong("WEIGHTS_0", format!("vertex {vertex} has no weight above 0")));
            }
            if (sum - 1.0_f64).abs() > 1e-3 {
                document.note(&attributes.path, "weights of joints whose sum is not 1 were divided by their sum");
            }
            *point = if sum == 1.0 { moved } else { moved / sum }.into();
        }
        document.note(&primitive.path, "the skin was applied in its default pose; the node's transform has no effect");
        Ok(true)
    }
}
