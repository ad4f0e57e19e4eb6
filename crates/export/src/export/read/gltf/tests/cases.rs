//! The glTF files of `tests/cases`: cubes of side 2 mm, each with a trait of another program.

use super::{assert_note, assert_volume};
use crate::export::read::{ReadError, Surface, read_surface};
use std::path::Path;

fn case(name: &str) -> Result<Surface, ReadError> {
    read_surface(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/cases").join(name))
}

/// Volume of a cube whose side is 2 mm in single precision.
fn cube() -> f64 {
    f64::from(0.002_f32).powi(3)
}

#[test]
fn every_case_has_its_volume_and_its_note() {
    let cube = cube();
    for (name, triangles, volume, note) in [
        ("glb-nul-padding/cube.glb", 12, cube, ""),
        ("glb-unknown-chunk/second.glb", 12, cube, "a chunk of unknown type was passed over"),
        ("gltf-animation-pointer/cube.gltf", 12, cube, ""),
        ("gltf-gpu-instancing/used.gltf", 24, 2.0 * cube, "EXT_mesh_gpu_instancing"),
        ("gltf-morph-weights/cube.gltf", 12, -cube, "was applied with its default weight"),
        ("gltf-no-minmax/cube.gltf", 12, cube, "min and max of the positions are missing"),
        // Its scale is written in decimals.
        ("gltf-quantized/cube.glb", 12, 8e-9, ""),
        ("gltf-required-appearance/KHR_materials_unlit.gltf", 12, cube, "KHR_materials_unlit"),
        ("gltf-skin-node-scale/cube.gltf", 12, cube, "the skin was applied"),
        ("gltf-sparse/cube.gltf", 12, cube, ""),
        ("gltf-target-without-view/cube.gltf", 12, cube, ""),
        ("gltf-texture-without-source/used.gltf", 12, cube, ""),
    ] {
        let surface = case(name).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_volume(&surface, triangles, volume);
        if note.is_empty() {
            assert!(surface.notes.is_empty(), "{name}: {:?}", surface.notes);
        } else {
            assert_note(&surface, note);
        }
    }
}

#[test]
fn a_file_that_is_not_what_its_extension_says_is_refused_by_name() {
    // The views declare compression, and hold the plain data.
    let refused = case("gltf-meshopt-foreign/cube.glb").unwrap_err().to_string();
    assert!(refused.starts_with("bufferViews[0].extensions.EXT_meshopt_compression: its 96 bytes"), "{refused}");
}
