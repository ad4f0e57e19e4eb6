//! Tests of the GLB writer with the reader of the `gltf` crate, and of its bytes.

use super::*;
use crate::export::Shape;
use crate::export::tests::{meta, turned};
use crate::model::{BodyKind, Mesh, sample};
use crate::tissue::Grid;
use std::collections::BTreeMap;

fn glb(mesh: &Mesh, strips: bool) -> Vec<u8> {
    let mut file = Vec::new();
    write_glb(&Shape::of(mesh, &meta()), &GlbOptions { strips, skin: None }, &mut file).unwrap();
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

/// A skin for the sample tube, with blank pictures of the ends.
fn skin(mesh: &Mesh) -> Skin<'_> {
    let end = || {
        let grid = Grid { width: 40, height: 40, um_per_pixel: 60.0, left_um: -1200.0, top_um: 1200.0 };
        let mut png = Vec::new();
        let mut encoder = png::Encoder::new(&mut png, 40, 40);
        encoder.set_color(png::ColorType::Rgb);
        encoder.write_header().unwrap().write_image_data(&[200; 4800]).unwrap();
        EndPicture { grid, png }
    };
    Skin::new(oviduct_surface::mesh::unwrap(mesh).unwrap(), &mesh.positions, [end(), end()]).unwrap()
}

fn textured(mesh: &Mesh, strips: bool) -> Vec<u8> {
    let (skin, mut file) = (skin(mesh), Vec::new());
    write_glb(&Shape::of(mesh, &meta()), &GlbOptions { strips, skin: Some(&skin) }, &mut file).unwrap();
    file
}

#[test]
fn a_textured_file_is_the_same_surface_with_coordinates_and_pictures() {
    let mesh = sample::tube(48, 20, 0.3);
    for strips in [false, true] {
        let file = textured(&mesh, strips);
        assert_eq!(read(&file), expected(&mesh));
        assert_eq!(file, textured(&mesh, strips));
        // The reader of the gltf crate validates the document.
        let gltf = gltf::Gltf::from_slice(&file).unwrap();
        let blob = gltf.blob.as_deref().unwrap();
        let names: Vec<_> = gltf.images().map(|image| image.name().unwrap().to_owned()).collect();
        assert_eq!(names, ["mucosa", "mucosa_normals", "serosa", "serosa_normals", "cap_isthmus", "cap_ampulla"]);
        for image in gltf.images() {
            let gltf::image::Source::View { view, mime_type } = image.source() else { panic!("not embedded") };
            let bytes = &blob[view.offset()..view.offset() + view.length()];
            let decoded = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
            assert!(mime_type == "image/png" && [40, tiles::SIDE_PIXELS].contains(&decoded.info().width));
        }
        for part in gltf.meshes() {
            let primitive = part.primitives().next().unwrap();
            let (material, is_cap) = (primitive.material(), part.name().unwrap().starts_with("cap"));
            assert!(material.pbr_metallic_roughness().base_color_texture().is_some());
            assert_eq!(material.normal_texture().is_some(), !is_cap);
            let reader = primitive.reader(|_| Some(blob));
            let places: Vec<[f32; 2]> = reader.read_tex_coords(0).unwrap().into_f32().collect();
            let positions: Vec<[f32; 3]> = reader.read_positions().unwrap().collect();
            assert_eq!(places.len(), positions.len());
            let length = 4000.0 / if part.name() == Some("outer_wall") { 1024.0 } else { 256.0 };
            for (&[u, v], p) in places.iter().zip(&positions) {
                if is_cap {
                    // The pictures reach from −1.2 to 1.2 mm.
                    let [x, y] = [u * 2.4e-3 - 1.2e-3, 1.2e-3 - v * 2.4e-3];
                    assert!((x - p[0]).abs() < 1e-8 && (y - p[1]).abs() < 1e-8);
                } else {
                    let range = 0.0..=length * 1.000_01;
                    assert!(range.contains(&u) && range.contains(&v), "{u} {v}");
                }
            }
        }
    }
}

#[test]
fn a_file_without_textures_has_no_trace_of_them() {
    let mesh = sample::tube(48, 4, 0.3);
    let (plain, with) = (glb(&mesh, false), textured(&mesh, false));
    assert!(!plain.windows(8).any(|bytes| bytes == b"TEXCOORD"));
    assert!(with.len() > plain.len() + 8 * mesh.positions.len());
    let text = String::from_utf8_lossy(&plain[20..4000]).into_owned();
    assert!(!text.contains("image") && !text.contains("texture") && !text.contains("sampler"));
}

#[test]
fn textures_of_another_surface_are_refused() {
    let [mesh, other] = [4, 5].map(|slabs| sample::tube(24, slabs, 0.3));
    let skin = skin(&other);
    let options = GlbOptions { strips: false, skin: Some(&skin) };
    let error = write_glb(&Shape::of(&mesh, &meta()), &options, &mut Vec::new()).unwrap_err();
    assert_eq!(error.kind(), io::ErrorKind::InvalidInput);
}

#[test]
fn tiles_have_no_seam_and_normals_of_unit_length() {
    for tile in &tiles::TILES {
        let [colours, normals] = tile.pngs().unwrap().map(|png| {
            let mut reader = png::Decoder::new(std::io::Cursor::new(png)).read_info().unwrap();
            let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
            reader.next_frame(&mut pixels).unwrap();
            pixels
        });
        let side = tiles::SIDE_PIXELS as usize;
        // Mean difference between two columns.
        let step = |a: usize, b: usize| -> f64 {
            let difference = |row: usize| {
                let [p, q] = [a, b].map(|column| f64::from(colours[3 * (row * side + column) + 1]));
                (p - q).abs()
            };
            (0..side).map(difference).sum::<f64>() / side as f64
        };
        let inside = (0..side - 1).map(|k| step(k, k + 1)).fold(0.0, f64::max);
        assert!(step(side - 1, 0) <= inside, "{}: {} and {inside}", tile.name, step(side - 1, 0));
        assert!(step(0, side / 2) > 3.0, "{} is not blank", tile.name);
        for normal in normals.chunks_exact(3) {
            let [x, y, z] = [0, 1, 2].map(|k| f64::from(normal[k]) / 127.5 - 1.0);
            assert!((x * x + y * y + z * z - 1.0).abs() < 0.03 && z > 0.2);
        }
    }
}
