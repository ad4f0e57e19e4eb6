//! Tests of the GLB writer with the reader of the `gltf` crate, and of its bytes.

use super::*;
use crate::export::Shape;
use crate::export::tests::{meta, turned};
use crate::model::{BodyKind, Mesh, sample};
use std::collections::BTreeMap;

fn glb(mesh: &Mesh, strips: bool) -> Vec<u8> {
    let mut file = Vec::new();
    write_glb(&Shape::of(mesh, &meta()), &GlbOptions { strips }, &mut file).unwrap();
    file
}

/// Sorted triangles of each patch as bits of positions, rotated to a canonical start.
type Shapes = BTreeMap<String, Vec<[[u32; 3]; 3]>>;

fn expected(mesh: &Mesh) -> Shapes {
    let of_patch = |patch: &crate::model::Patch| {
        let mut all: Vec<_> = mesh.triangles[patch.triangles.clone()]
            .iter()
            .map(|t| turned(t.map(|v| mesh.positions[v as usize].map(f32::to_bits))))
            .collect();
        all.sort_unstable();
        (patch.kind.name().to_owned(), all)
    };
    mesh.patches.iter().map(of_patch).collect()
}

/// Reads a file with the `gltf` crate and checks names, normals and bounds.
fn read(file: &[u8]) -> Shapes {
    let gltf = gltf::Gltf::from_slice(file).unwrap();
    let blob = gltf.blob.as_deref().unwrap();
    let scene = gltf.default_scene().unwrap();
    let body = scene.nodes().next().unwrap();
    assert_eq!(body.name(), Some("tissue"));
    let mut shapes = Shapes::new();
    for node in body.children() {
        let name = node.name().unwrap().to_owned();
        assert_eq!(node.mesh().unwrap().name(), Some(name.as_str()));
        for primitive in node.mesh().unwrap().primitives() {
            assert_eq!(primitive.material().name(), Some(name.as_str()));
            let reader = primitive.reader(|_| Some(blob));
            let positions: Vec<[f32; 3]> = reader.read_positions().unwrap().collect();
            let normals: Vec<[f32; 3]> = reader.read_normals().unwrap().collect();
            let indices: Vec<u32> = reader.read_indices().unwrap().into_u32().collect();
            let bounds = primitive.bounding_box();
            for axis in 0..3 {
                let values = || positions.iter().map(|p| p[axis]);
                assert_eq!(bounds.min[axis], values().reduce(f32::min).unwrap());
                assert_eq!(bounds.max[axis], values().reduce(f32::max).unwrap());
            }
            let triangles: Vec<[u32; 3]> = match primitive.mode() {
                gltf::mesh::Mode::Triangles => indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
                gltf::mesh::Mode::TriangleStrip => crate::geometry::strips::triangles_of_strip(&indices).collect(),
                other => panic!("{other:?}"),
            };
            for t in &triangles {
                let [a, b, c] = t.map(|v| glam::Vec3::from(positions[v as usize]));
                for &v in t {
                    let normal = glam::Vec3::from(normals[v as usize]);
                    assert!((normal.length() - 1.0).abs() < 1e-5);
                    assert!(normal.dot((b - a).cross(c - a)) > 0.0);
                }
            }
            let mut shape: Vec<_> =
                triangles.iter().map(|t| turned(t.map(|v| positions[v as usize].map(f32::to_bits)))).collect();
            shape.sort_unstable();
            shapes.insert(name.clone(), shape);
        }
    }
    shapes
}

#[test]
fn a_file_read_back_is_the_same_surface() {
    let mesh = sample::tube(24, 5, 0.3);
    for strips in [false, true] {
        assert_eq!(read(&glb(&mesh, strips)), expected(&mesh));
    }
}

#[test]
fn many_vertices_get_wide_indices() {
    let mesh = sample::tube(700, 100, 0.3);
    let file = glb(&mesh, true);
    let types: Vec<_> = gltf::Gltf::from_slice(&file)
        .unwrap()
        .meshes()
        .map(|m| m.primitives().next().unwrap().indices().unwrap().data_type())
        .collect();
    use gltf::accessor::DataType::{U16, U32};
    assert_eq!(types, [U32, U32, U16, U16]);
    assert_eq!(read(&file), expected(&mesh));
    assert!(file.len() < glb(&mesh, false).len());
}

#[test]
fn the_json_part_is_as_agreed() {
    let file = glb(&sample::tube(4, 1, 0.0), false);
    assert_eq!(file.len(), u32::from_le_bytes(file[8..12].try_into().unwrap()) as usize);
    let json_len = u32::from_le_bytes(file[12..16].try_into().unwrap()) as usize;
    assert_eq!(json_len % 4, 0);
    let json: serde_json::Value = serde_json::from_slice(&file[20..20 + json_len]).unwrap();
    insta::assert_json_snapshot!(json);
}

#[test]
fn an_empty_mesh_is_refused() {
    let mesh = Mesh { body: BodyKind::Tissue, positions: vec![], triangles: vec![], patches: vec![] };
    let error = write_glb(&Shape::of(&mesh, &meta()), &GlbOptions::default(), &mut Vec::new()).unwrap_err();
    assert_eq!(error.kind(), io::ErrorKind::InvalidInput);
}

#[test]
fn more_than_the_format_holds_is_refused_before_anything_is_written() {
    let mut out = Vec::new();
    let error = write_head(&json::Root::default(), 1 << 32, &mut out).unwrap_err();
    assert_eq!((error.kind(), out.len()), (io::ErrorKind::InvalidInput, 0));
    assert!(error.to_string().contains("4 GiB"), "{error}");
}

#[test]
fn a_lumen_shows_both_sides() {
    let mesh = Mesh { body: BodyKind::Lumen, ..sample::tube(4, 1, 0.0) };
    let file = glb(&mesh, false);
    assert!(gltf::Gltf::from_slice(&file).unwrap().materials().all(|m| m.double_sided()));
}
