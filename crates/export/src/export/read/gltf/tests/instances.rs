//! Instances of a mesh by `EXT_mesh_gpu_instancing`.

use super::*;

const NAME: &str = "EXT_mesh_gpu_instancing";

/// A cube with instance attributes: name, type, component type, data, count.
fn instanced(attributes: &[(&str, &str, u32, Vec<u8>, usize)]) -> Model {
    let mut model = Model::cube();
    model.set("/nodes/0/extensions", json!({ NAME: { "attributes": {} } }));
    for (name, kind, component, data, count) in attributes {
        let accessor = model.add(kind, *component, data, *count);
        model.set(&format!("/nodes/0/extensions/{NAME}/attributes/{name}"), json!(accessor));
    }
    model
}

#[test]
fn instances_are_placed_below_the_transform_of_the_node() {
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let mut model = instanced(&[
        ("TRANSLATION", "VEC3", 5126, floats(&[0.0, 0.0, 0.0, 10.0, 0.0, 0.0, 0.0, 20.0, 0.0]), 3),
        ("ROTATION", "VEC4", 5126, floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, half, half, 0.0, 0.0, 0.0, 1.0]), 3),
        ("SCALE", "VEC3", 5126, floats(&[1.0, 1.0, 1.0, 2.0, 1.0, 1.0, -1.0, 1.0, 3.0]), 3),
        ("_ID", "SCALAR", 5123, shorts(&[1, 2, 3]), 3),
    ]);
    model.set("/nodes/0/scale", json!([2, 2, 2]));
    for list in ["extensionsUsed", "extensionsRequired"] {
        let surface = model.with(&format!("/{list}"), json!([NAME])).read();
        // Triangles of the mirrored instance are reversed.
        assert_volume(&surface, 36, 8.0 * (1.0 + 2.0 + 3.0));
        assert_eq!((surface.positions.len(), surface.groups.len()), (24, 1));
        assert_note(&surface, "nodes[0]: the instances of its mesh (EXT_mesh_gpu_instancing) were read");
        // A quarter turn about z: x becomes y.
        let [x, y, z] = surface.positions[8 + 1];
        assert!((x - 20.0).abs() < 1e-12 && (y - 4.0).abs() < 1e-12 && z == 0.0, "{x} {y} {z}");
        assert_eq!(surface.positions[16 + 6], [-2.0, 42.0, 6.0]);
    }
}

#[test]
fn rotations_of_instances_may_be_integers() {
    for (component, data) in [(5120, vec![0, 0, 127, 0]), (5122, shorts(&[0, 0, 32_767, 0]))] {
        for normalized in [true, false] {
            let mut model = instanced(&[("ROTATION", "VEC4", component, data.clone(), 1)]);
            model.set("/accessors/2/normalized", json!(normalized));
            let surface = model.read();
            assert_eq!(surface.positions[6], [-1.0, -1.0, 1.0]);
            assert_volume(&surface, 12, 1.0);
        }
    }
}

#[test]
fn instances_that_do_not_fit_are_refused_with_their_path() {
    let three = |count: usize| ("TRANSLATION", "VEC3", 5126, floats(&vec![0.0; 3 * count]), count);
    let differ = instanced(&[three(2), ("SCALE", "VEC3", 5126, floats(&[1.0; 9]), 3)]);
    assert!(differ.refusal().contains("instances, and another attribute has more or fewer"), "{}", differ.refusal());
    let mut infinite = three(1);
    infinite.3[..4].copy_from_slice(&f32::INFINITY.to_le_bytes());
    assert_eq!(instanced(&[infinite]).refusal(), "accessors[2]: the transform of instance 0 is not finite");
    let mut skinned = instanced(&[three(1)]);
    skinned.set("/skins", json!([{ "joints": [0] }]));
    skinned.set("/nodes/0/skin", json!(0));
    assert_eq!(skinned.refusal(), "nodes[0]: EXT_mesh_gpu_instancing of a mesh with a skin is not read");
    let kind = instanced(&[("TRANSLATION", "VEC4", 5126, floats(&[0.0; 4]), 1)]);
    assert!(kind.refusal().starts_with("accessors[2]: its type is VEC4"));
    // 60 MB of zeros that have no data.
    let many = instanced(&[three(1)])
        .with("/accessors/2/bufferView", json!(null))
        .with("/accessors/2/count", json!(5_000_000));
    assert!(many.refusal().contains("5000000 items without data"));
    let mut twice = many.with("/accessors/2/count", json!(4_000_000));
    let indices: Vec<u8> = shorts(&FACES.as_flattened().repeat(2));
    let accessor = twice.add("SCALAR", 5123, &indices, 72);
    twice.set("/meshes/0/primitives/0/indices", json!(accessor));
    assert!(twice.refusal().contains("there are 96000000 triangles"), "{}", twice.refusal());
}

#[test]
fn a_node_without_attributes_has_one_instance() {
    let one = instanced(&[]).read();
    assert_volume(&one, 12, 1.0);
    assert!(one.notes.is_empty(), "{:?}", one.notes);
    let three = instanced(&[("_ID", "SCALAR", 5123, shorts(&[1, 2, 3]), 3)]);
    assert_volume(&three.read(), 36, 3.0);
}
