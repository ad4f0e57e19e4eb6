//! Default poses: morph targets and skins.

use super::*;

/// Displacements of all corners of a cube.
fn deltas(of: impl Fn([f32; 3]) -> [f32; 3]) -> Vec<u8> {
    floats(CORNERS.map(of).as_flattened())
}

/// A cube with targets that make it 1 longer in x and 2 longer in z.
pub(super) fn morphed() -> Model {
    let mut model = Model::cube();
    let x = model.add("VEC3", 5126, &deltas(|p| [p[0], 0.0, 0.0]), 8);
    let z = model.add("VEC3", 5126, &deltas(|p| [0.0, 0.0, 2.0 * p[2]]), 8);
    model.set("/meshes/0/primitives/0/targets", json!([{ "POSITION": x }, { "POSITION": z, "NORMAL": 99 }]));
    model
}

#[test]
fn weights_of_the_mesh_or_of_the_node_are_applied() {
    let model = morphed();
    assert!(model.read().notes.is_empty());
    let of_mesh = model.with("/meshes/0/weights", json!([0.5, 1]));
    assert_volume(&of_mesh.read(), 12, 1.5 * 3.0);
    assert_note(&of_mesh.read(), "meshes[0].primitives[0].targets[0] and 1 more: the morph target was applied");
    let of_node = of_mesh.with("/nodes/0/weights", json!([0, -1]));
    // Inside out: the cube is 1 − 2 long in z.
    assert_volume(&of_node.read(), 12, -1.0);
    assert_volume(&of_mesh.with("/nodes/0/weights", json!([0, 0])).read(), 12, 1.0);
    let few = model.with("/meshes/0/weights", json!([1])).read();
    assert_volume(&few, 12, 2.0);
    assert_note(&few, "the number of weights (1) differs from the number of morph targets (2)");
    // The transform of the node comes after the targets.
    let scaled = of_mesh.with("/nodes/0/scale", json!([2, 1, 1]));
    assert_volume(&scaled.read(), 12, 9.0);
}

#[test]
fn targets_may_be_sparse_quantized_or_without_data() {
    let mut model = morphed().with("/meshes/0/weights", json!([1, 1]));
    let bytes: Vec<u8> = CORNERS.iter().flat_map(|p| [if p[0] > 0.0 { 127 } else { 0 }, 0, 0, 0]).collect();
    let x = model.add("VEC3", 5120, &bytes, 8);
    model.set(&format!("/bufferViews/{x}/byteStride"), json!(4));
    model.set(&format!("/accessors/{x}/normalized"), json!(true));
    model.set("/meshes/0/primitives/0/targets/0/POSITION", json!(x));
    assert_volume(&model.read(), 12, 2.0 * 3.0);
    let (at, values) = (model.add_view(&shorts(&[4, 5, 6, 7])), model.add_view(&floats(&[0.0, 0.0, 9.0].repeat(4))));
    model.set("/accessors/3/bufferView", json!(null));
    assert_volume(&model.read(), 12, 2.0);
    let sparse = json!({
        "count": 4, "indices": { "bufferView": at, "componentType": 5123 }, "values": { "bufferView": values }
    });
    model.set("/accessors/3/sparse", sparse);
    assert_volume(&model.read(), 12, 2.0 * 10.0);
    model.set("/accessors/3/count", json!(9));
    let refused = model.refusal();
    assert_eq!(refused, "meshes[0].primitives[0].targets[1].POSITION: it has 9 positions, and the primitive has 8");
}

#[test]
fn primitives_with_shared_positions_have_their_own_targets() {
    let mut model = morphed().with("/meshes/0/weights", json!([1, 0]));
    let plain = json!({ "attributes": { "POSITION": 0 }, "indices": 1 });
    model.json["meshes"][0]["primitives"].as_array_mut().unwrap().push(plain);
    let surface = model.read();
    assert_volume(&surface, 24, 2.0 + 1.0);
    assert_eq!(surface.positions.len(), 16);
}

/// A cube of node 0 whose lower corners belong to joint 1 and whose upper corners to joint 2.
pub(super) fn skinned(weights: [f32; 4]) -> Model {
    let mut model = Model::cube();
    let joints: Vec<u8> =
        CORNERS.iter().flat_map(|p| if p[2] == 0.0 { [0, 9, 0, 0] } else { [1, 200, 0, 0] }).collect();
    let joints = model.add("VEC4", 5121, &joints, 8);
    let weights = model.add("VEC4", 5126, &floats(&weights.repeat(8)), 8);
    model.set("/meshes/0/primitives/0/attributes/JOINTS_0", json!(joints));
    model.set("/meshes/0/primitives/0/attributes/WEIGHTS_0", json!(weights));
    model.set("/skins", json!([{ "joints": [1, 2] }]));
    model.set("/nodes", json!([{ "mesh": 0, "skin": 0 }, { "children": [2] }, { "translation": [0, 0, 4] }]));
    model.set("/scenes/0/nodes", json!([0, 1]));
    model
}

pub(super) const WHOLE: [f32; 4] = [1.0, 0.0, 0.0, 0.0];

#[test]
fn joints_move_the_vertices_and_the_node_does_not() {
    let model = skinned(WHOLE);
    assert_volume(&model.read(), 12, 5.0);
    assert_note(&model.read(), "meshes[0].primitives[0]: the skin was applied");
    let scaled = model.with("/nodes/0/scale", json!([10, 10, 10]));
    assert_volume(&scaled.read(), 12, 5.0);
    assert_volume(&model.with("/nodes/1/scale", json!([1, 2, 1])).read(), 12, 10.0);
    // Joints outside of the scene, below a parent of their own.
    let mut outside = model.with("/scenes/0/nodes", json!([0]));
    outside.json["nodes"].as_array_mut().unwrap().push(json!({ "scale": [1, 1, 2], "children": [1] }));
    assert_volume(&outside.read(), 12, 2.0 * 5.0);
}

#[test]
fn inverse_bind_matrices_are_applied_first() {
    let mut model = skinned(WHOLE);
    let mut matrices = glam::Mat4::from_scale(glam::Vec3::new(3.0, 1.0, 1.0)).to_cols_array().to_vec();
    matrices.extend(
        glam::Mat4::from_scale_rotation_translation(
            glam::Vec3::new(3.0, 1.0, 1.0),
            glam::Quat::IDENTITY,
            glam::Vec3::NEG_Z,
        )
        .to_cols_array(),
    );
    let accessor = model.add("MAT4", 5126, &floats(&matrices), 2);
    model.set("/skins/0/inverseBindMatrices", json!(accessor));
    assert_volume(&model.read(), 12, 3.0 * 4.0);
    model.set(&format!("/accessors/{accessor}/count"), json!(1));
    assert_eq!(model.refusal(), "skins[0].inverseBindMatrices: it has 1 matrices for 2 joints");
}

#[test]
fn several_joints_share_a_vertex_and_weights_are_divided_by_their_sum() {
    let mut model = skinned([0.5, 0.0, 0.0, 0.0]);
    assert_volume(&model.read(), 12, 5.0);
    assert_note(&model.read(), "weights of joints whose sum is not 1");
    // The second set gives every vertex to joint 2 by half.
    let joints = model.add("VEC4", 5123, &shorts(&[1, 0, 0, 0].repeat(8)), 8);
    let weights = model.add("VEC4", 5121, &[51, 51, 0, 0].repeat(8), 8);
    model.set(&format!("/accessors/{weights}/normalized"), json!(true));
    model.set("/meshes/0/primitives/0/attributes/JOINTS_1", json!(joints));
    model.set("/meshes/0/primitives/0/attributes/WEIGHTS_1", json!(weights));
    // Lower corners: (0.5·0 + 0.2·4 + 0.2·0) / 0.9; upper ones: 1 + (0.5·4 + 0.2·4) / 0.9.
    let surface = model.read();
    assert!((surface.positions[0][2] - 0.8 / 0.9).abs() < 1e-12, "{}", surface.positions[0][2]);
    assert_volume(&surface, 12, 1.0 + 2.0 / 0.9);
    let exact = skinned([0.75, 0.0, 0.25, 0.0]);
    assert_volume(&exact.read(), 12, 1.0 + 3.0);
}

#[test]
fn targets_move_vertices_before_joints() {
    let mut model = skinned(WHOLE);
    let delta = model.add("VEC3", 5126, &deltas(|p| [p[0], 0.0, 0.0]), 8);
    model.set("/meshes/0/primitives/0/targets", json!([{ "POSITION": delta }]));
    model.set("/meshes/0/weights", json!([1]));
    model.set("/nodes/1/scale", json!([3, 1, 1]));
    assert_volume(&model.read(), 12, 2.0 * 3.0 * 5.0);
}

#[test]
fn mirrored_skeletons_keep_triangles_outwards() {
    let model = skinned(WHOLE).with("/nodes/1/scale", json!([-1, 1, 1]));
    assert_volume(&model.read(), 12, 5.0);
}

#[test]
fn a_primitive_without_joints_keeps_the_transform_of_its_node() {
    let mut model = skinned(WHOLE).with("/nodes/0/scale", json!([2, 1, 1]));
    model.set("/meshes/0/primitives/0/attributes", json!({ "POSITION": 0 }));
    assert_volume(&model.read(), 12, 2.0);
}

#[test]
fn skins_that_do_not_fit_are_refused_with_their_path() {
    let at = "meshes[0].primitives[0].attributes";
    for (model, refusal) in [
        (skinned([0.5, 0.5, 0.0, 0.0]), format!("{at}.WEIGHTS_0: vertex 0: the skin has no joint 9")),
        (skinned([0.0; 4]), format!("{at}.WEIGHTS_0: vertex 0 has no weight above 0")),
        (
            skinned([2.0, 0.0, -1.0, 0.0]),
            format!("{at}.WEIGHTS_0: vertex 0: the weight -1 is not a number from 0 to 1"),
        ),
        (skinned([f32::NAN; 4]), format!("{at}.WEIGHTS_0: vertex 0: the weight NaN is not a number from 0 to 1")),
        (skinned(WHOLE).with("/skins/0/joints", json!([1, 9])), "skins[0].joints[1]: nodes[9] does not exist".into()),
        (skinned(WHOLE).with("/skins", json!([])), "nodes[0].skin: skins[0] does not exist".into()),
        (skinned(WHOLE).with("/accessors/2/count", json!(7)), format!("{at}.WEIGHTS_0: joints, weights and positions")),
        (
            skinned(WHOLE).with("/accessors/2/normalized", json!(true)),
            "accessors[2]: its numbers are normalized".into(),
        ),
    ] {
        assert!(model.refusal().starts_with(&refusal), "{}", model.refusal());
    }
}

#[test]
fn work_on_shared_targets_is_limited_before_it_begins() {
    let mut model = morphed();
    model.set("/meshes/0/primitives/0/targets", json!(vec![json!({ "POSITION": 2 }); 20_000]));
    model.set("/meshes/0/weights", json!(vec![0.25; 20_000]));
    model.set("/nodes", json!(vec![json!({ "mesh": 0 }); 2_000]));
    model.set("/scenes/0/nodes", json!((0..2_000).collect::<Vec<_>>()));
    assert!(
        model.refusal().contains("there are 320000000 vertices of morph targets and joints"),
        "{}",
        model.refusal()
    );
}
