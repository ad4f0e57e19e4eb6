//! glTF 2.0: all triangles of a scene as one surface, node transforms applied.
//!
//! The document is parsed and validated by the `gltf` crate; the container and the data are read here, so that no
//! length in the file is trusted. Strips, fans and lists of triangles are read; points and lines are left out. A node
//! that mirrors turns its triangles round, as the format demands. Not read: sparse accessors, skins, morph targets.

use super::accessor::{indices, positions};
use super::{Group, ReadError, Surface, Unit, read_bytes};
use ::gltf::buffer::Source;
use ::gltf::json::{Root, deserialize};
use ::gltf::mesh::Mode;
use ::gltf::{Document, Node, Primitive, scene::Transform};
use std::borrow::Cow;
use std::collections::HashMap;
use std::path::{Component, Path};

type Matrix = [[f64; 4]; 4];

pub(super) fn fault(path: impl Into<String>, detail: impl Into<String>) -> ReadError {
    ReadError::Document { path: path.into(), detail: detail.into() }
}

pub(super) fn parse(bytes: &[u8], folder: Option<&Path>) -> Result<Surface, ReadError> {
    let (json, blob) = if bytes.starts_with(b"glTF") { chunks(bytes)? } else { (bytes, None) };
    if json.trim_ascii_start().first() != Some(&b'{') {
        return Err(fault("document", "it is not a JSON object"));
    }
    let root: Root = deserialize::from_slice(json).map_err(|error| refused(error.into()))?;
    check_attributes(&root)?;
    let document = Document::from_json(root).map_err(refused)?;
    let buffers = document
        .buffers()
        .map(|buffer| match buffer.source() {
            Source::Bin => {
                blob.map(Cow::Borrowed).ok_or_else(|| fault(format!("buffers[{}]", buffer.index()), "it has no data"))
            }
            Source::Uri(uri) => fetch(buffer.index(), uri, folder).map(Cow::Owned),
        })
        .collect::<Result<Vec<_>, _>>()?;
    let mut reader = Reader {
        surface: Surface { unit: Unit::Stated(1.0), ..Surface::default() },
        buffers,
        seen: vec![false; document.nodes().count()],
    };
    let scene = document.default_scene().or_else(|| document.scenes().next());
    match scene {
        Some(scene) => reader.walk(scene.nodes().collect())?,
        None => reader.walk(roots(&document))?,
    }
    Ok(reader.surface)
}

/// Refuses attributes that name no accessor: the validation of the crate takes for granted that there is one.
fn check_attributes(root: &Root) -> Result<(), ReadError> {
    for (m, mesh) in root.meshes.iter().enumerate() {
        for (p, primitive) in mesh.primitives.iter().enumerate() {
            if let Some(index) = primitive.attributes.values().find(|i| i.value() >= root.accessors.len()) {
                let detail = format!("an attribute names accessor {}, which does not exist", index.value());
                return Err(fault(format!("meshes[{m}].primitives[{p}].attributes"), detail));
            }
        }
    }
    Ok(())
}

/// Splits a binary file into its document and its data.
fn chunks(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), ReadError> {
    let wrong = |byte: usize, detail: &str| ReadError::Byte { byte, detail: detail.to_owned() };
    let word = |byte: usize| {
        let word = bytes.get(byte..).and_then(|rest| rest.first_chunk::<4>());
        word.map(|b| u32::from_le_bytes(*b)).ok_or_else(|| wrong(byte, "the file ends within a header"))
    };
    if word(4)? != 2 {
        return Err(wrong(4, "the version is not 2"));
    }
    if word(8)? as usize > bytes.len() {
        return Err(wrong(8, "the file is shorter than it says"));
    }
    let chunk = |begin: usize, kind: &[u8; 4], what: &str| {
        let length = word(begin)? as usize;
        if bytes.get(begin + 4..begin + 8) != Some(kind) {
            return Err(wrong(begin + 4, &format!("this is not the {what} chunk")));
        }
        let rest = &bytes[begin + 8..];
        rest.get(..length).ok_or_else(|| wrong(begin, &format!("the {what} chunk is longer than the file")))
    };
    let json = chunk(12, b"JSON", "JSON")?;
    let next = 20 + json.len().next_multiple_of(4);
    let blob = if next + 8 <= bytes.len() { Some(chunk(next, b"BIN\0", "binary")?) } else { None };
    Ok((json, blob))
}

fn refused(error: ::gltf::Error) -> ReadError {
    match error {
        ::gltf::Error::Validation(faults) => match faults.first() {
            Some((path, error)) => fault(path.as_str(), format!("{error} ({} such faults in all)", faults.len())),
            None => fault("document", "it is not valid"),
        },
        other => fault("document", other.to_string()),
    }
}

/// Loads a buffer that is named by a URI: data within it, or a file beside the document.
fn fetch(index: usize, uri: &str, folder: Option<&Path>) -> Result<Vec<u8>, ReadError> {
    let wrong = |detail: &str| fault(format!("buffers[{index}].uri"), detail);
    if let Some(data) = uri.strip_prefix("data:") {
        let (_, data) = data.split_once(";base64,").ok_or_else(|| wrong("its data are not in base64"))?;
        return base64(data.as_bytes()).ok_or_else(|| wrong("its data are not valid base64"));
    }
    let name = percent_decoded(uri).ok_or_else(|| wrong("it is not a valid relative reference"))?;
    let path = Path::new(&name);
    if uri.contains(':') || !path.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir)) {
        return Err(wrong("only files beside the document are read"));
    }
    let folder = folder.ok_or_else(|| wrong("the document stands alone, so files beside it cannot be read"))?;
    read_bytes(&folder.join(path))
}

fn base64(text: &[u8]) -> Option<Vec<u8>> {
    let text = text.strip_suffix(b"==").or_else(|| text.strip_suffix(b"=")).unwrap_or(text);
    let mut bytes = Vec::with_capacity(text.len() / 4 * 3 + 3);
    for group in text.chunks(4) {
        let mut word = 0u32;
        for &symbol in group {
            let value = match symbol {
                b'A'..=b'Z' => symbol - b'A',
                b'a'..=b'z' => symbol - b'a' + 26,
                b'0'..=b'9' => symbol - b'0' + 52,
                b'+' | b'-' => 62,
                b'/' | b'_' => 63,
                _ => return None,
            };
            word = (word << 6) | u32::from(value);
        }
        word <<= 6 * (4 - group.len());
        let whole = match group.len() {
            4 => 3,
            3 => 2,
            2 => 1,
            _ => return None,
        };
        bytes.extend(&word.to_be_bytes()[1..=whole]);
    }
    Some(bytes)
}

fn percent_decoded(uri: &str) -> Option<String> {
    let (mut bytes, mut rest) = (Vec::new(), uri.as_bytes());
    while let Some((&first, after)) = rest.split_first() {
        if first == b'%' {
            let digits = std::str::from_utf8(after.get(..2)?).ok()?;
            bytes.push(u8::from_str_radix(digits, 16).ok()?);
            rest = &after[2..];
        } else {
            bytes.push(first);
            rest = after;
        }
    }
    String::from_utf8(bytes).ok()
}

/// Nodes that are no other node's children, for documents without a scene.
fn roots(document: &Document) -> Vec<Node<'_>> {
    let children: std::collections::HashSet<usize> =
        document.nodes().flat_map(|node| node.children().map(|child| child.index()).collect::<Vec<_>>()).collect();
    document.nodes().filter(|node| !children.contains(&node.index())).collect()
}

struct Reader<'a> {
    surface: Surface,
    buffers: Vec<Cow<'a, [u8]>>,
    /// Nodes that were met.
    seen: Vec<bool>,
}

impl Reader<'_> {
    fn walk(&mut self, roots: Vec<Node<'_>>) -> Result<(), ReadError> {
        let mut stack: Vec<(Node<'_>, Option<Matrix>)> = roots.into_iter().rev().map(|node| (node, None)).collect();
        while let Some((node, above)) = stack.pop() {
            if std::mem::replace(&mut self.seen[node.index()], true) {
                return Err(fault(format!("nodes[{}]", node.index()), "it has more than one parent"));
            }
            let placed = combined(above, node.transform());
            self.read_mesh(&node, placed)?;
            stack.extend(node.children().collect::<Vec<_>>().into_iter().rev().map(|child| (child, placed)));
        }
        Ok(())
    }

    fn read_mesh(&mut self, node: &Node<'_>, placed: Option<Matrix>) -> Result<(), ReadError> {
        let Some(mesh) = node.mesh() else { return Ok(()) };
        // Primitives of a mesh often share their vertices.
        let mut bases = HashMap::new();
        let several = mesh.primitives().len() > 1;
        for primitive in mesh.primitives() {
            if matches!(primitive.mode(), Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip) {
                continue;
            }
            let path = format!("meshes[{}].primitives[{}]", mesh.index(), primitive.index());
            let accessor = primitive
                .get(&::gltf::Semantic::Positions)
                .ok_or_else(|| fault(path.as_str(), "it has no positions"))?;
            let (base, count) = match bases.get(&accessor.index()) {
                Some(&known) => known,
                None => {
                    let base = self.surface.positions.len();
                    let points = positions(&accessor, &self.buffers)?;
                    let added = (base, points.len());
                    self.surface.positions.extend(points.into_iter().map(|p| moved(placed, p)));
                    if self.surface.positions.len() > u32::MAX as usize {
                        return Err(fault(path, "there are more vertices than 32 bits can count"));
                    }
                    bases.insert(accessor.index(), added);
                    added
                }
            };
            let begin = self.surface.triangles.len();
            self.read_triangles(&primitive, &path, base as u32, count, placed)?;
            let material = primitive.material();
            let own = if several { material.name() } else { None };
            let name = own.or(node.name()).or(mesh.name()).map_or_else(|| path.clone(), str::to_owned);
            self.surface.groups.push(Group { name, triangles: begin..self.surface.triangles.len() });
        }
        Ok(())
    }

    fn read_triangles(
        &mut self,
        primitive: &Primitive<'_>,
        path: &str,
        base: u32,
        count: usize,
        placed: Option<Matrix>,
    ) -> Result<(), ReadError> {
        let list = match primitive.indices() {
            Some(accessor) => indices(&accessor, &self.buffers)?,
            None => (0..count as u32).collect(),
        };
        if let Some(bad) = list.iter().find(|&&v| v as usize >= count) {
            return Err(fault(path, format!("there is no vertex {bad}")));
        }
        let mirrored = placed.is_some_and(|m| determinant(&m) < 0.0);
        let triangles = &mut self.surface.triangles;
        let mut add = |[a, b, c]: [u32; 3]| {
            let t = if mirrored { [a, c, b] } else { [a, b, c] };
            triangles.push(t.map(|v| v + base));
        };
        match primitive.mode() {
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
                    return Err(fault(path, "the number of its indices is not a multiple of three"));
                }
                whole.iter().for_each(|t| add(*t));
            }
        }
        Ok(())
    }
}

/// The transform of a node within the whole; none where nothing moves, so that coordinates stay exactly as they are.
fn combined(above: Option<Matrix>, transform: Transform) -> Option<Matrix> {
    let own = transform.matrix().map(|column| column.map(f64::from));
    let identity: Matrix = std::array::from_fn(|i| std::array::from_fn(|j| if i == j { 1.0 } else { 0.0 }));
    match above {
        _ if own == identity => above,
        None => Some(own),
        // Columns first, as in the format.
        Some(m) => Some(own.map(|column| std::array::from_fn(|row| (0..4).map(|k| m[k][row] * column[k]).sum()))),
    }
}

fn moved(placed: Option<Matrix>, p: [f64; 3]) -> [f64; 3] {
    let Some(m) = placed else { return p };
    std::array::from_fn(|row| m[0][row] * p[0] + m[1][row] * p[1] + m[2][row] * p[2] + m[3][row])
}

fn determinant(m: &Matrix) -> f64 {
    m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[1][0] * (m[0][1] * m[2][2] - m[0][2] * m[2][1])
        + m[2][0] * (m[0][1] * m[1][2] - m[0][2] * m[1][1])
}
