//! Tests of the glTF reader with cubes, and helpers that build their documents.

mod accessors;
mod cases;
mod container;
mod extensions;
mod instances;
mod meshopt;
mod nodes;
mod pose;
mod tolerance;

use super::*;
use crate::export::read::tests::cases::volume;
use serde_json::{Value, json};

/// Corners of a cube of side 1.
pub(super) const CORNERS: [[f32; 3]; 8] = [
    [0.0, 0.0, 0.0],
    [1.0, 0.0, 0.0],
    [1.0, 1.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, 0.0, 1.0],
    [1.0, 0.0, 1.0],
    [1.0, 1.0, 1.0],
    [0.0, 1.0, 1.0],
];
pub(super) const FACES: [[u16; 3]; 12] = [
    [0, 3, 2],
    [0, 2, 1],
    [4, 5, 6],
    [4, 6, 7],
    [0, 1, 5],
    [0, 5, 4],
    [1, 2, 6],
    [1, 6, 5],
    [2, 3, 7],
    [2, 7, 6],
    [3, 0, 4],
    [3, 4, 7],
];

/// A document with its binary chunk.
#[derive(Clone)]
pub(super) struct Model {
    pub(super) json: Value,
    pub(super) data: Vec<u8>,
}

impl Model {
    /// A cube of side 1: accessor 0 has its positions, accessor 1 its indices.
    pub(super) fn cube() -> Self {
        let mut model = Self {
            json: json!({
                "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [0] }],
                "nodes": [{ "name": "body", "mesh": 0 }],
                "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1 }] }],
                "accessors": [], "bufferViews": [], "buffers": [{ "byteLength": 0 }]
            }),
            data: Vec::new(),
        };
        model.add("VEC3", 5126, &floats(CORNERS.as_flattened()), 8);
        model.json["accessors"][0]["min"] = json!([0, 0, 0]);
        model.json["accessors"][0]["max"] = json!([1, 1, 1]);
        model.add("SCALAR", 5123, &shorts(FACES.as_flattened()), 36);
        model
    }

    /// Adds a view of the data, and returns its number.
    pub(super) fn add_view(&mut self, data: &[u8]) -> usize {
        let offset = self.data.len().next_multiple_of(4);
        self.data.resize(offset, 0);
        self.data.extend_from_slice(data);
        let views = self.json["bufferViews"].as_array_mut().unwrap();
        views.push(json!({ "buffer": 0, "byteOffset": offset, "byteLength": data.len() }));
        views.len() - 1
    }

    /// Adds an accessor with its own view, and returns its number.
    pub(super) fn add(&mut self, kind: &str, component: u32, data: &[u8], count: usize) -> usize {
        let view = self.add_view(data);
        let accessors = self.json["accessors"].as_array_mut().unwrap();
        accessors.push(json!({ "bufferView": view, "componentType": component, "type": kind, "count": count }));
        accessors.len() - 1
    }

    /// The same model with another member.
    pub(super) fn with(&self, pointer: &str, value: Value) -> Self {
        let mut model = self.clone();
        model.set(pointer, value);
        model
    }

    /// Sets a member, which its parent need not have.
    pub(super) fn set(&mut self, pointer: &str, value: Value) {
        let (parent, name) = pointer.rsplit_once('/').unwrap();
        let parent = self.json.pointer_mut(parent).unwrap();
        match name.parse::<usize>() {
            Ok(index) if parent.is_array() => parent[index] = value,
            _ => parent[name] = value,
        }
    }

    pub(super) fn glb(&self) -> Vec<u8> {
        let mut text = self.json.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut data = self.data.clone();
        data.resize(data.len().next_multiple_of(4), 0);
        file(&[(b"JSON", &text), (b"BIN\0", &data)])
    }

    pub(super) fn read(&self) -> Surface {
        parse(&self.glb(), None).unwrap()
    }

    pub(super) fn refusal(&self) -> String {
        parse(&self.glb(), None).unwrap_err().to_string()
    }
}

/// Type and data of a chunk.
pub(super) type Chunk<'a> = (&'a [u8; 4], &'a [u8]);

/// Binary glTF of these chunks.
pub(super) fn file(chunks: &[Chunk<'_>]) -> Vec<u8> {
    let length = 12 + chunks.iter().map(|(_, data)| 8 + data.len()).sum::<usize>();
    let mut bytes = [&b"glTF"[..], &2u32.to_le_bytes(), &(length as u32).to_le_bytes()].concat();
    for (kind, data) in chunks {
        bytes.extend_from_slice(&(data.len() as u32).to_le_bytes());
        bytes.extend_from_slice(*kind);
        bytes.extend_from_slice(data);
    }
    bytes
}

pub(super) fn floats(numbers: &[f32]) -> Vec<u8> {
    numbers.iter().flat_map(|x| x.to_le_bytes()).collect()
}

pub(super) fn shorts(numbers: &[u16]) -> Vec<u8> {
    numbers.iter().flat_map(|x| x.to_le_bytes()).collect()
}

/// Asserts the number of triangles and the volume.
#[track_caller]
pub(super) fn assert_volume(surface: &Surface, triangles: usize, expected: f64) {
    assert_eq!(surface.triangles.len(), triangles);
    let found = volume(surface);
    assert!((found - expected).abs() <= 1e-9 * expected.abs(), "{found} instead of {expected}");
}

/// Asserts that exactly one note contains the text.
#[track_caller]
pub(super) fn assert_note(surface: &Surface, text: &str) {
    assert_eq!(surface.notes.iter().filter(|note| note.contains(text)).count(), 1, "{text}: {:?}", surface.notes);
}

#[test]
fn a_plain_cube_is_read_without_notes() {
    let surface = Model::cube().read();
    assert_volume(&surface, 12, 1.0);
    assert_eq!(surface.positions, CORNERS.map(|p| p.map(f64::from)));
    assert_eq!((surface.notes.len(), surface.unit), (0, Unit::Stated(1.0)));
    assert_eq!(surface.groups, [Group { name: "body".into(), triangles: 0..12 }]);
}
