//! Document and container of all binary glTF files that oviduct writes: a node for the body, and
//! for each patch a child with a mesh and a material.

use crate::export::colours::of_patch;
use crate::export::shape::AXES;
use crate::export::{CITATION, Metadata};
use crate::model::BodyKind;
use gltf_json as json;
use json::accessor::ComponentType;
use json::validation::{Checked, USize64};
use serde_json::value::RawValue;
use serde_json::{Map, Value};
use std::io::{self, Write};

/// A document under construction, to which patches are added.
pub(in crate::export) struct Scene {
    /// Document that receives accessors, views and buffers.
    pub(in crate::export) root: json::Root,
    /// Name of the body.
    body: String,
    children: Vec<json::Index<json::Node>>,
}

impl Scene {
    /// Creates an empty document. `more` are additional members of the asset's extras.
    pub(in crate::export) fn new(
        body: &str,
        generator: String,
        meta: Option<&Metadata>,
        more: Map<String, Value>,
    ) -> io::Result<Self> {
        let mut root = json::Root::default();
        root.asset.generator = Some(generator);
        let mut members = match meta {
            Some(meta) => serde_json::json!({
                "units": "m",
                "axes": AXES,
                "preset": meta.preset,
                "seed": meta.seed,
                "digest": meta.digest,
                "engine": meta.engine,
                "length_mm": meta.length_mm,
                "sections": meta.sections,
                "method": CITATION,
            }),
            None => serde_json::json!({ "units": "m" }),
        };
        if let Some(members) = members.as_object_mut() {
            members.extend(more);
        }
        root.asset.extras = extras(&members)?;
        Ok(Self { root, body: body.to_owned(), children: Vec::new() })
    }

    /// Adds a patch: a node, a mesh of one primitive and a material, all with the name of the
    /// patch. Returns the material.
    pub(in crate::export) fn add_patch(
        &mut self,
        name: &str,
        primitive: json::mesh::Primitive,
    ) -> io::Result<json::Index<json::Material>> {
        let material = self.root.push(material(name, &self.body));
        let mesh = self.root.push(json::Mesh {
            extensions: None,
            extras: None,
            name: Some(name.into()),
            primitives: vec![json::mesh::Primitive { material: Some(material), ..primitive }],
            weights: None,
        });
        self.children.push(self.root.push(json::Node {
            mesh: Some(mesh),
            name: Some(name.into()),
            extras: extras(&serde_json::json!({ "patch": name, "body": self.body }))?,
            ..json::Node::default()
        }));
        Ok(material)
    }

    /// Ends the document with the node of the body. `node` provides its other members, `vertices`
    /// and `triangles` are the size of its surface.
    pub(in crate::export) fn finish(
        mut self,
        vertices: usize,
        triangles: usize,
        node: json::Node,
    ) -> io::Result<json::Root> {
        let mut members = serde_json::json!({
            "body": self.body,
            "vertices": vertices,
            "triangles": triangles,
        });
        if let Some(body) = BodyKind::named(&self.body) {
            members["euler"] = body.euler().into();
        }
        let body = self.root.push(json::Node {
            children: Some(self.children),
            name: Some(self.body),
            extras: extras(&members)?,
            ..node
        });
        let scene = self.root.push(json::Scene {
            extensions: None,
            extras: None,
            name: Some("oviduct".into()),
            nodes: vec![body],
        });
        self.root.scene = Some(scene);
        Ok(self.root)
    }
}

/// Writes a file up to the contents of its binary chunk, which has `bin_len` bytes.
///
/// # Errors
/// Returns any error of writing to `out`, and [`io::ErrorKind::InvalidInput`] if the file would
/// exceed 4 GiB, the limit of GLB.
pub(in crate::export) fn write_head(root: &json::Root, bin_len: usize, out: &mut impl Write) -> io::Result<()> {
    let mut text = serde_json::to_vec(root)?;
    text.resize(text.len().next_multiple_of(4), b' ');
    let total = 12 + 8 + text.len() + 8 + bin_len;
    let total = u32::try_from(total)
        .map_err(|_| io::Error::new(io::ErrorKind::InvalidInput, "the model is too large for GLB (4 GiB)"))?;
    for word in [u32::from_le_bytes(*b"glTF"), 2, total, text.len() as u32, u32::from_le_bytes(*b"JSON")] {
        out.write_all(&word.to_le_bytes())?;
    }
    out.write_all(&text)?;
    for word in [bin_len as u32, u32::from_le_bytes(*b"BIN\0")] {
        out.write_all(&word.to_le_bytes())?;
    }
    Ok(())
}

/// Creates a buffer of `bytes` bytes.
pub(in crate::export) fn buffer(bytes: usize) -> json::Buffer {
    json::Buffer { byte_length: USize64::from(bytes), name: None, uri: None, extensions: None, extras: None }
}

/// Creates a view without a stride.
pub(in crate::export) fn buffer_view(
    buffer: json::Index<json::Buffer>,
    offset: usize,
    length: usize,
    target: Option<json::buffer::Target>,
) -> json::buffer::View {
    json::buffer::View {
        buffer,
        byte_length: USize64::from(length),
        byte_offset: Some(USize64::from(offset)),
        byte_stride: None,
        name: None,
        target: target.map(Checked::Valid),
        extensions: None,
        extras: None,
    }
}

/// Arrays of a binary chunk, one after another at multiples of four bytes.
pub(in crate::export) struct Layout {
    buffer: json::Index<json::Buffer>,
    /// Bytes of the arrays so far.
    pub(in crate::export) length: usize,
}

impl Layout {
    /// Begins with an empty buffer.
    pub(in crate::export) fn new(root: &mut json::Root) -> Self {
        Self { buffer: root.push(buffer(0)), length: 0 }
    }

    /// Appends an array with its own view, and returns the accessor that describes it.
    pub(in crate::export) fn append(
        &mut self,
        root: &mut json::Root,
        type_: json::accessor::Type,
        component: ComponentType,
        count: usize,
        target: Option<json::buffer::Target>,
    ) -> json::Accessor {
        let bytes = count * type_.multiplicity() * component.size();
        let view = root.push(buffer_view(self.buffer, self.length, bytes, target));
        self.length += bytes.next_multiple_of(4);
        json::Accessor { buffer_view: Some(view), ..accessor(type_, component, count) }
    }

    /// Appends bytes that are not an array, and returns their view.
    pub(in crate::export) fn append_bytes(
        &mut self,
        root: &mut json::Root,
        bytes: usize,
    ) -> json::Index<json::buffer::View> {
        let view = root.push(buffer_view(self.buffer, self.length, bytes, None));
        self.length += bytes.next_multiple_of(4);
        view
    }
}

/// Creates an accessor without a view, bounds and normalization.
pub(in crate::export) fn accessor(
    type_: json::accessor::Type,
    component: ComponentType,
    count: usize,
) -> json::Accessor {
    json::Accessor {
        buffer_view: None,
        byte_offset: None,
        count: USize64::from(count),
        component_type: Checked::Valid(json::accessor::GenericComponentType(component)),
        extensions: None,
        extras: None,
        type_: Checked::Valid(type_),
        min: None,
        max: None,
        name: None,
        normalized: false,
        sparse: None,
    }
}

/// Creates a primitive without a material.
pub(in crate::export) fn primitive(
    mode: json::mesh::Mode,
    positions: json::Index<json::Accessor>,
    normals: json::Index<json::Accessor>,
    indices: json::Index<json::Accessor>,
) -> json::mesh::Primitive {
    let semantics = [(json::mesh::Semantic::Positions, positions), (json::mesh::Semantic::Normals, normals)];
    json::mesh::Primitive {
        attributes: semantics.into_iter().map(|(s, a)| (Checked::Valid(s), a)).collect(),
        extensions: None,
        extras: None,
        indices: Some(indices),
        material: None,
        mode: Checked::Valid(mode),
        targets: None,
    }
}

/// Component type of the indices of a patch with this number of vertices. glTF reserves the index
/// 65,535.
pub(in crate::export) fn index_type(vertices: usize) -> ComponentType {
    if vertices <= usize::from(u16::MAX) { ComponentType::U16 } else { ComponentType::U32 }
}

fn extras(value: &Value) -> io::Result<json::Extras> {
    Ok(Some(RawValue::from_string(value.to_string())?))
}

/// Material of a patch. The inner wall of the tissue faces the lumen, so a
/// view from inside shows the tube without back faces. Other bodies face outwards and are therefore
/// double-sided.
fn material(patch: &str, body: &str) -> json::Material {
    let [r, g, b] = of_patch(patch);
    json::Material {
        name: Some(patch.into()),
        double_sided: body != BodyKind::Tissue.name(),
        pbr_metallic_roughness: json::material::PbrMetallicRoughness {
            base_color_factor: json::material::PbrBaseColorFactor([r, g, b, 1.0]),
            metallic_factor: json::material::StrengthFactor(0.0),
            roughness_factor: json::material::StrengthFactor(0.6),
            ..Default::default()
        },
        ..Default::default()
    }
}
