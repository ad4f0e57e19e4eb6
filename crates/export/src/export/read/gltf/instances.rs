//! Instances of the mesh of a node (`EXT_mesh_gpu_instancing`).

use super::accessor::{Accessor, Accessors, Component};
use super::document::Document;
use super::extensions::INSTANCING;
use super::placement::{Placement, compose};
use super::scene::MeshNode;
use crate::export::read::error::ReadError;

/// Attributes of the instances of a node.
pub(super) struct Instances<'a> {
    pub(super) count: usize,
    translation: Option<&'a Accessor<'a>>,
    rotation: Option<&'a Accessor<'a>>,
    scale: Option<&'a Accessor<'a>>,
}

impl<'a> Instances<'a> {
    /// Finds the attributes of the instances without reading them. A node without the extension
    /// has one instance.
    pub(super) fn find(
        document: &Document<'_>,
        accessors: &'a Accessors<'_>,
        node: &MeshNode,
    ) -> Result<Self, ReadError> {
        let mut found = Self { count: 1, translation: None, rotation: None, scale: None };
        if !node.has_instances {
            return Ok(found);
        }
        let object = document.nodes.get(node.index)?;
        let Some(attributes) = object.extension(INSTANCING)?.map(|extension| extension.object("attributes")) else {
            return Ok(found);
        };
        let Some(attributes) = attributes? else { return Ok(found) };
        if node.skin.is_some() {
            return Err(object.fault(format!("{INSTANCING} of a mesh with a skin is not read")));
        }
        let mut count = None;
        for name in attributes.names() {
            let Some(accessor) = accessors.owned(&attributes, name)? else { continue };
            match name {
                "TRANSLATION" => found.translation = Some(vectors(accessor)?),
                "SCALE" => found.scale = Some(vectors(accessor)?),
                "ROTATION" => {
                    let allowed = [Component::F32, Component::I8, Component::I16];
                    accessor.expect("rotations of instances", "VEC4", &allowed)?;
                    found.rotation = Some(accessor);
                }
                _ => {}
            }
            if count.is_some_and(|count| count != accessor.count) {
                let detail = format!("it has {} instances, and another attribute has more or fewer", accessor.count);
                return Err(attributes.wrong(name, detail));
            }
            count = Some(accessor.count);
        }
        if let Some(count) = count {
            found.count = count;
            document.note(&object.path, format!("the instances of its mesh ({INSTANCING}) were read"));
        }
        Ok(found)
    }

    /// Placements of all instances on a node.
    pub(super) fn placements(&self, node: Placement) -> Result<Vec<Placement>, ReadError> {
        if self.translation.is_none() && self.rotation.is_none() && self.scale.is_none() {
            return Ok(vec![node; self.count]);
        }
        let all = |accessor: Option<&Accessor<'_>>, default: f64| -> Result<_, ReadError> {
            let mut list = Vec::new();
            match accessor {
                Some(accessor) => accessor.read(&mut list)?,
                None => list.resize(self.count, [default; 3]),
            }
            Ok(list)
        };
        let (translations, scales) = (all(self.translation, 0.0)?, all(self.scale, 1.0)?);
        let mut rotations = Vec::new();
        match self.rotation {
            Some(accessor) => accessor.read(&mut rotations)?,
            None => rotations.resize(self.count, [0.0, 0.0, 0.0, 1.0]),
        }
        let placements = translations.into_iter().zip(rotations).zip(scales).enumerate();
        placements
            .map(|(i, ((translation, rotation), scale))| {
                let placement = node.of_child(compose(translation, rotation, scale));
                let finite = translation.iter().chain(&rotation).chain(&scale).all(|x| x.is_finite());
                let accessor = self.translation.or(self.rotation).or(self.scale);
                match accessor {
                    Some(accessor) if !finite || !placement.is_finite() => {
                        Err(accessor.fault(format!("the transform of instance {i} is not finite")))
                    }
                    _ => Ok(placement),
                }
            })
            .collect()
    }
}

fn vectors<'a>(accessor: &'a Accessor<'a>) -> Result<&'a Accessor<'a>, ReadError> {
    accessor.expect("translations and scales of instances", "VEC3", &[Component::F32])?;
    Ok(accessor)
}
