//! The primitives of a mesh that have triangles, found and counted before any of them is read.

use super::accessor::{Accessor, Accessors, Component};
use super::document::Document;
use super::extensions::{DRACO, QUANTIZATION};
use super::json::{Array, Object};
use crate::export::read::error::ReadError;
use crate::export::read::surface::strip_triangles;
use std::collections::HashSet;
use std::sync::Arc;

/// Types of positions: those of glTF, and those of `KHR_mesh_quantization`.
pub(super) const POSITIONS: [Component; 5] =
    [Component::F32, Component::I8, Component::U8, Component::I16, Component::U16];

/// A mesh with its triangles and their total size.
pub(super) struct TriangleMesh<'a> {
    pub(super) name: Option<Arc<str>>,
    pub(super) primitives: Vec<TrianglePrimitive<'a>>,
    /// Weights of morph targets.
    pub(super) weights: Vec<f64>,
    /// Vertices of all primitives.
    pub(super) vertices: u64,
    /// Upper bound of triangles, since it includes those of repeated vertices that join strips.
    pub(super) triangles: u64,
    /// Maximum number of sets of joints that a vertex has.
    pub(super) joint_sets: u64,
}

/// A primitive that has triangles.
pub(super) struct TrianglePrimitive<'a> {
    mode: Mode,
    /// Number of the accessor of positions, which primitives may share.
    pub(super) vertices: usize,
    pub(super) positions: &'a Accessor<'a>,
    indices: Option<&'a Accessor<'a>>,
    /// Name of its material, if the mesh has several primitives.
    pub(super) name: Option<Arc<str>>,
    pub(super) path: Arc<str>,
    /// The primitive itself if it has morph targets or joints.
    pub(super) pose: Option<Object<'a>>,
}

/// How indices form triangles.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Mode {
    List,
    Strip,
    Fan,
}

impl<'a> TriangleMesh<'a> {
    /// Finds the primitives of a mesh.
    pub(super) fn find(
        document: &Document<'a>,
        accessors: &'a Accessors<'_>,
        names: &mut MaterialNames<'_>,
        index: usize,
    ) -> Result<Self, ReadError> {
        let mesh = document.meshes.get(index)?;
        document.check(&mesh, &[])?;
        let primitives = mesh.array("primitives")?;
        let mut found = Self {
            name: mesh.text("name").map(Arc::from),
            primitives: Vec::new(),
            weights: mesh.numbers("weights")?.unwrap_or_default(),
            vertices: 0,
            triangles: 0,
            joint_sets: 0,
        };
        let mut known = HashSet::new();
        for i in 0..primitives.len() {
            let object = primitives.get(i)?;
            let Some(mode) = mode(document, &object)? else { continue };
            check_extensions(document, accessors, &object)?;
            let attributes = object.object("attributes")?.unwrap_or_else(|| Object::new("", Default::default()));
            let vertices = attributes.refer("POSITION", &document.accessors)?;
            let (Some(vertices), Some(positions)) = (vertices, accessors.owned(&attributes, "POSITION")?) else {
                document.note(&object.path, "it has no positions and was passed over");
                continue;
            };
            check_positions(document, positions)?;
            let indices = accessors.owned(&object, "indices")?;
            if let Some(indices) = indices {
                indices.expect("indices", "SCALAR", &[Component::U8, Component::U16, Component::U32])?;
            }
            let corners = indices.unwrap_or(positions).count as u64;
            if corners == 0 {
                continue;
            }
            found.triangles += if mode == Mode::List { corners.div_ceil(3) } else { corners };
            let sets = attributes.names().filter(|name| name.starts_with("JOINTS_")).count() as u64;
            let is_posed = sets > 0 || object.has("targets");
            // Posed primitives do not share their vertices.
            if known.insert(vertices) || is_posed {
                found.vertices += positions.count as u64;
            }
            found.joint_sets = found.joint_sets.max(sets);
            let material =
                object.refer("material", &document.materials).ok().flatten().filter(|_| primitives.len() > 1);
            found.primitives.push(TrianglePrimitive {
                mode,
                vertices,
                positions,
                indices,
                name: material.and_then(|material| names.get(material)),
                path: object.path.as_str().into(),
                pose: is_posed.then_some(object),
            });
        }
        Ok(found)
    }
}

impl TrianglePrimitive<'_> {
    /// Reads the triangles, each with the flag of [`strip_triangles`], which `add` receives.
    pub(super) fn triangles(&self, mut add: impl FnMut([u32; 3], bool)) -> Result<(), ReadError> {
        let count = self.positions.count;
        let list = match self.indices {
            Some(accessor) => accessor.indices()?,
            None => (0..count as u32).collect(),
        };
        let wrong = |detail: String| ReadError::document(&*self.path, detail);
        if let Some(bad) = list.iter().find(|&&v| v as usize >= count) {
            return Err(wrong(format!("there is no vertex {bad}")));
        }
        match self.mode {
            Mode::Strip => strip_triangles(&list).for_each(|(t, reversed)| add(t, reversed)),
            Mode::Fan => list.windows(2).skip(1).for_each(|w| add([w[0], w[1], list[0]], false)),
            Mode::List => {
                let (whole, rest) = list.as_chunks::<3>();
                if !rest.is_empty() {
                    return Err(wrong(format!(
                        "the number of its indices, {}, is not a multiple of three",
                        list.len()
                    )));
                }
                whole.iter().for_each(|t| add(*t, false));
            }
        }
        Ok(())
    }
}

/// Mode of a primitive; `None` if it has points or lines.
fn mode(document: &Document<'_>, primitive: &Object<'_>) -> Result<Option<Mode>, ReadError> {
    Ok(match primitive.integer("mode")?.unwrap_or(4) {
        4 => Some(Mode::List),
        5 => Some(Mode::Strip),
        6 => Some(Mode::Fan),
        0..4 => {
            document.note(&primitive.path, "points or lines were passed over");
            None
        }
        other => return Err(primitive.wrong("mode", format!("{other} is not a mode from 0 to 6"))),
    })
}

/// Refuses a primitive that is only there in compressed form.
fn check_extensions(
    document: &Document<'_>,
    accessors: &Accessors<'_>,
    primitive: &Object<'_>,
) -> Result<(), ReadError> {
    document.check(primitive, &[DRACO])?;
    if primitive.extension(DRACO)?.is_none() {
        return Ok(());
    }
    let attributes = primitive.object("attributes")?;
    let positions = attributes.map(|attributes| accessors.named(&attributes, "POSITION")).transpose()?.flatten();
    let indices = accessors.named(primitive, "indices")?;
    let is_there = positions.is_some_and(Accessor::has_data) && indices.is_none_or(Accessor::has_data);
    if document.extensions.requires(DRACO) || !is_there {
        return Err(
            primitive.fault(format!("it is compressed with {DRACO}, which is not read; save the file without it"))
        );
    }
    document.note(&primitive.path, format!("its form without {DRACO} was read"));
    Ok(())
}

fn check_positions(document: &Document<'_>, positions: &Accessor<'_>) -> Result<(), ReadError> {
    positions.expect("positions", "VEC3", &POSITIONS)?;
    if !positions.has_bounds {
        document.note(positions.path(), "min and max of the positions are missing");
    }
    if positions.component != Component::F32 && !document.declares(QUANTIZATION) {
        document.note(positions.path(), format!("its positions are integers although {QUANTIZATION} is not declared"));
    }
    Ok(())
}

/// Names of materials. Primitives with the same material share its name.
pub(super) struct MaterialNames<'a> {
    materials: &'a Array<'a>,
    known: Vec<Option<Option<Arc<str>>>>,
}

impl<'a> MaterialNames<'a> {
    pub(super) fn new(document: &'a Document<'a>) -> Self {
        Self { materials: &document.materials, known: vec![None; document.materials.len()] }
    }

    fn get(&mut self, index: usize) -> Option<Arc<str>> {
        let read = || self.materials.get(index).ok()?.text("name").map(Arc::from);
        self.known.get_mut(index)?.get_or_insert_with(read).clone()
    }
}
