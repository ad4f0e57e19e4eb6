//! Affine transforms of nodes, in f64.

use super::document::Document;
use super::json::Object;
use crate::export::read::error::ReadError;
use glam::{DMat3, DMat4, DQuat, DVec3, DVec4};

/// Affine transform of a node. `None` is the identity, which leaves the bits of coordinates
/// unchanged.
#[derive(Clone, Copy, Default)]
pub(super) struct Placement(pub(super) Option<DMat4>);

impl Placement {
    /// Placement of what has the transform `own` relative to this node.
    pub(super) fn of_child(self, own: Self) -> Self {
        match (self.0, own.0) {
            (Some(parent), Some(own)) => Self(Some(parent * own)),
            (parent, own) => Self(own.or(parent)),
        }
    }

    pub(super) fn apply(self, point: [f64; 3]) -> [f64; 3] {
        self.0.map_or(point, |matrix| matrix.transform_point3(DVec3::from(point)).into())
    }

    pub(super) fn is_finite(self) -> bool {
        self.0.is_none_or(|matrix| matrix.is_finite())
    }

    pub(super) fn reverses_orientation(self) -> bool {
        self.0.is_some_and(|matrix| DMat3::from_mat4(matrix).determinant() < 0.0)
    }
}

impl From<DMat4> for Placement {
    fn from(matrix: DMat4) -> Self {
        Self((matrix != DMat4::IDENTITY).then_some(matrix))
    }
}

/// Composes a transform. The rotation may have any length except zero, which stands for none.
pub(super) fn compose(translation: [f64; 3], rotation: [f64; 4], scale: [f64; 3]) -> Placement {
    let rotation = DVec4::from(rotation).try_normalize().map_or(DQuat::IDENTITY, DQuat::from_vec4);
    DMat4::from_scale_rotation_translation(scale.into(), rotation, translation.into()).into()
}

/// Transform of a node relative to its parent.
pub(super) fn of_node(document: &Document<'_>, node: &Object<'_>) -> Result<Placement, ReadError> {
    let matrix = node.vector::<16>("matrix")?;
    let is_composed = ["translation", "rotation", "scale"].iter().any(|name| node.has(name));
    if let Some(matrix) = matrix {
        if is_composed {
            document.note(&node.path, "its matrix was read, and its translation, rotation and scale were passed over");
        }
        let [.., w] = DMat4::from_cols_array(&matrix).transpose().to_cols_array_2d();
        if (DVec4::from(w) - DVec4::W).abs().max_element() > 1e-6 {
            return Err(node.wrong("matrix", format!("its last row is {w:?} instead of [0, 0, 0, 1]")));
        }
        return Ok(DMat4::from_cols_array(&matrix).into());
    }
    if !is_composed {
        return Ok(Placement(None));
    }
    let rotation = node.vector("rotation")?.unwrap_or([0.0, 0.0, 0.0, 1.0]);
    if (DVec4::from(rotation).length() - 1.0).abs() > 1e-2 {
        document.note(&node.path, "its rotation is not a quaternion of length 1 and was normalized");
    }
    let translation = node.vector("translation")?.unwrap_or_default();
    Ok(compose(translation, rotation, node.vector("scale")?.unwrap_or([1.0; 3])))
}
