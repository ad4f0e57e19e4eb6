//! Transforms of nodes, visibility, and trees that are none.

use super::*;

/// A cube whose node has these members.
fn placed(node: &Value) -> Model {
    let mut model = Model::cube();
    for (name, value) in node.as_object().unwrap() {
        model.set(&format!("/nodes/0/{name}"), value.clone());
    }
    model
}

#[test]
fn transforms_are_applied_in_double_precision() {
    let turned =
        placed(&json!({ "translation": [1e-3, 0, 0], "rotation": [0, 0, 0.6, 0.8], "scale": [0.1, 0.2, 0.3] }));
    let surface = turned.read();
    assert_volume(&surface, 12, 0.1 * 0.2 * 0.3);
    // A rotation by 2·asin(0.6) about z: cos 0.28, sin 0.96.
    for (axis, expected) in [1e-3 + 0.28 * 0.1, 0.96 * 0.1, 0.0].into_iter().enumerate() {
        assert!((surface.positions[1][axis] - expected).abs() < 1e-15);
    }
    assert!(surface.notes.is_empty());
    let matrix = json!([0.1, 0, 0, 0, 0, 0.2, 0, 0, 0, 0, 0.3, 0, 5, 6, 7, 1]);
    assert_eq!(placed(&json!({ "matrix": matrix })).read().positions[6], [5.1, 6.2, 7.3]);
}

#[test]
fn an_identity_leaves_the_bits() {
    let mut model = placed(&json!({ "translation": [0, 0, 0], "rotation": [0, 0, 0, 1], "scale": [1, 1, 1] }));
    model.data[..4].copy_from_slice(&(-0.0_f32).to_le_bytes());
    assert_eq!(model.read().positions[0][0].to_bits(), (-0.0_f64).to_bits());
    model.set("/nodes/0", json!({ "mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1] }));
    assert_eq!(model.read().positions[0][0].to_bits(), (-0.0_f64).to_bits());
}

#[test]
fn a_matrix_wins_over_translation_rotation_and_scale() {
    let double = json!([2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 1]);
    let surface = placed(&json!({ "matrix": double, "scale": [9, 9, 9] })).read();
    assert_volume(&surface, 12, 8.0);
    assert_note(&surface, "nodes[0]: its matrix was read");
}

#[test]
fn mirrored_nodes_keep_triangles_outwards() {
    for scale in [[-1, 1, 1], [1, -2, 1], [-1, -1, -3]] {
        let expected = f64::from(scale.iter().product::<i32>()).abs();
        assert_volume(&placed(&json!({ "scale": scale })).read(), 12, expected);
    }
    let shear = json!([0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);
    assert_volume(&placed(&json!({ "matrix": shear })).read(), 12, 1.0);
}

#[test]
fn rotations_are_normalized() {
    let surface = placed(&json!({ "rotation": [0, 0, 3, 4] })).read();
    assert_volume(&surface, 12, 1.0);
    assert_note(&surface, "nodes[0]: its rotation is not a quaternion of length 1");
    assert_volume(&placed(&json!({ "rotation": [0, 0, 0, 0] })).read(), 12, 1.0);
    // Rounded to single precision.
    assert!(placed(&json!({ "rotation": [0, 0, 0.707_106_77, 0.707_106_77] })).read().notes.is_empty());
}

#[test]
fn transforms_that_are_none_are_refused_with_their_path() {
    let mut matrix = vec![json!(0); 16];
    for i in [0, 5, 10, 15] {
        matrix[i] = json!(1);
    }
    matrix[3] = json!(0.5);
    let projective = placed(&json!({ "matrix": matrix }));
    assert_eq!(projective.refusal(), "nodes[0].matrix: its last row is [0.5, 0.0, 0.0, 1.0] instead of [0, 0, 0, 1]");
    let model = placed(&json!({ "translation": [0, 0, 123_456] }));
    let text = model.json.to_string().replace("123456", "1e999");
    let refused = parse(&file(&[(b"JSON", text.as_bytes()), (b"BIN\0", &model.data)]), None).unwrap_err().to_string();
    assert_eq!(refused, "nodes[0].translation[2]: 1e999 is not a finite number");
    let mut deep = placed(&json!({ "scale": [1e200, 1, 1] }));
    deep.json["nodes"].as_array_mut().unwrap().push(json!({ "scale": [1e200, 1, 1], "children": [0] }));
    deep.set("/scenes/0/nodes", json!([1]));
    assert!(deep.refusal().starts_with("nodes[0]: its transform, with those of its parents"));
}

#[test]
fn cycles_and_two_parents_are_refused() {
    let mut model = Model::cube();
    model.set("/nodes", json!([{ "children": [1] }, { "mesh": 0, "children": [2] }, { "children": [1] }]));
    assert_eq!(model.refusal(), "nodes[1]: it has more than one parent");
    model.set("/nodes/2/children", json!([]));
    model.set("/scenes/0/nodes", json!([0, 1]));
    assert_eq!(model.refusal(), "nodes[1]: it has more than one parent");
    // A cycle outside of the scene.
    model.set("/nodes", json!([{ "mesh": 0 }, { "children": [2] }, { "children": [1] }]));
    model.set("/scenes/0/nodes", json!([0]));
    assert_volume(&model.read(), 12, 1.0);
}

#[test]
fn invisible_nodes_are_passed_over_with_all_below() {
    let mut model = Model::cube();
    let hidden = |visible: Value| json!({ "KHR_node_visibility": { "visible": visible } });
    model.set("/nodes", json!([{ "mesh": 0 }, { "children": [2] }, { "mesh": 0, "scale": [2, 2, 2] }]));
    model.set("/scenes/0/nodes", json!([0, 1]));
    model.set("/nodes/1/extensions", hidden(json!(false)));
    model.set("/extensionsRequired", json!(["KHR_node_visibility"]));
    let surface = model.read();
    assert_volume(&surface, 12, 1.0);
    assert_note(&surface, "nodes[2]: the node is invisible (KHR_node_visibility)");
    model.set("/nodes/1/extensions", hidden(json!(true)));
    model.set("/nodes/2/extensions", hidden(json!(null)));
    assert_volume(&model.read(), 24, 9.0);
    model.set("/nodes/1/extensions", hidden(json!("no")));
    assert!(model.refusal().starts_with("nodes[1].extensions.KHR_node_visibility.visible: \"no\""));
}

#[test]
fn groups_have_the_name_of_material_node_mesh_or_path() {
    let mut model = Model::cube();
    let primitive = model.json["meshes"][0]["primitives"][0].clone();
    model.set("/materials", json!([{ "name": "red" }, { "name": 4 }]));
    let [mut red, mut other] = [primitive.clone(), primitive];
    red["material"] = json!(0);
    other["material"] = json!(1);
    model.set("/meshes/0/primitives", json!([red, other]));
    let names = |model: &Model| model.read().groups.iter().map(|group| group.name.to_string()).collect::<Vec<_>>();
    assert_eq!(names(&model), ["red", "body"]);
    model.set("/meshes/0/name", json!("cube"));
    model.set("/nodes/0/name", json!(null));
    assert_eq!(names(&model), ["red", "cube"]);
    model.set("/meshes/0/name", json!(null));
    assert_eq!(names(&model), ["red", "meshes[0].primitives[1]"]);
}
