//! What does not matter is no obstacle, and what matters is refused with its path.

use super::*;
use proptest::prelude::*;
use proptest::sample::Index;

#[test]
fn parts_that_do_not_matter_may_hold_anything() {
    let cube = Model::cube();
    for (pointer, value) in [
        ("/asset", json!(7)),
        ("/textures", json!([{ "sampler": "x" }, 3])),
        ("/images", json!({ "uri": 1 })),
        ("/animations", json!([{ "channels": [{ "target": { "path": "pointer", "node": -1 } }] }])),
        ("/cameras", json!("none")),
        ("/materials", json!(5)),
        ("/samplers", json!([null])),
        ("/skins", json!([{ "joints": "all" }])),
        ("/extras", json!([[[1]]])),
        ("/extensionsUsed", json!("KHR_materials_unlit")),
        ("/extensions", json!([])),
        ("/nodes/0/extensions", json!([])),
        ("/nodes/0/camera", json!(99)),
        ("/nodes/0/name", json!(["body"])),
        ("/nodes/0/extras", json!("x")),
        ("/nodes/0/matrix", json!(null)),
        ("/meshes/0/extras", json!({ "targetNames": 1 })),
        ("/meshes/0/primitives/0/material", json!("red")),
        ("/meshes/0/primitives/0/attributes/NORMAL", json!(77)),
        ("/meshes/0/primitives/0/attributes/TEXCOORD_0", json!("x")),
        ("/meshes/0/primitives/0/targets", json!([{ "POSITION": 99 }])),
        ("/bufferViews/0/target", json!(0)),
        ("/bufferViews/1/byteStride", json!(0)),
        ("/accessors/0/min", json!(["NaN"])),
        ("/buffers/0/byteLength", json!("many")),
    ] {
        let surface = cube.with(pointer, value).read();
        assert_volume(&surface, 12, 1.0);
        assert!(surface.notes.is_empty(), "{pointer}: {:?}", surface.notes);
    }
}

#[test]
fn unused_parts_of_the_geometry_may_be_damaged() {
    let mut model = Model::cube();
    for (list, value) in [
        ("accessors", json!({ "count": -1 })),
        ("bufferViews", json!(null)),
        ("buffers", json!({ "uri": "missing-texture.bin", "byteLength": 4 })),
        ("buffers", json!([])),
        ("meshes", json!({ "primitives": 8 })),
        ("nodes", json!({ "mesh": "x" })),
        ("skins", json!(1)),
    ] {
        if model.json.get(list).is_none() {
            model.set(&format!("/{list}"), json!([]));
        }
        model.json[list].as_array_mut().unwrap().push(value);
    }
    let surface = model.read();
    assert_volume(&surface, 12, 1.0);
    assert!(surface.notes.is_empty(), "{:?}", surface.notes);
}

#[test]
fn numbers_may_be_written_as_floats_and_absent_members_as_null() {
    let model = Model::cube()
        .with("/accessors/0/count", json!(8.0))
        .with("/scene", json!(0.0))
        .with("/nodes/0/children", json!(null))
        .with("/accessors/0/sparse", json!(null));
    let text = model.json.to_string().replace("\"count\":36", "\"count\":3.6e1");
    let surface = parse(&file(&[(b"JSON", text.as_bytes()), (b"BIN\0", &model.data)]), None).unwrap();
    assert_volume(&surface, 12, 1.0);
}

#[test]
fn the_last_of_several_members_counts_as_in_other_programs() {
    let model = Model::cube();
    let text =
        model.json.to_string().replacen("\"nodes\":[{", "\"nodes\":[{\"mesh\":4,\"scale\":[9,9,9],\"scale\":null,", 1);
    assert!(text.contains("\"mesh\":4"));
    let surface = parse(&file(&[(b"JSON", text.as_bytes()), (b"BIN\0", &model.data)]), None).unwrap();
    assert_volume(&surface, 12, 1.0);
}

#[test]
fn primitives_may_have_many_attributes() {
    let mut attributes: serde_json::Map<String, Value> = (0..9_999).map(|i| (format!("_A{i}"), json!(7))).collect();
    attributes.insert("POSITION".to_owned(), json!(0));
    let primitive = json!({ "attributes": attributes, "indices": 1 });
    let surface = Model::cube().with("/meshes/0/primitives", json!(vec![primitive; 40])).read();
    assert_volume(&surface, 480, 40.0);
    assert!(surface.notes.is_empty(), "{:?}", surface.notes);
}

#[test]
fn an_empty_uri_counts_as_absent() {
    let surface = Model::cube().with("/buffers/0/uri", json!("")).read();
    assert_volume(&surface, 12, 1.0);
    assert!(surface.notes.is_empty(), "{:?}", surface.notes);
}

#[test]
fn a_name_in_another_encoding_is_replaced() {
    let model = Model::cube().with("/nodes/0/name", json!("K?rper"));
    let mut text = model.json.to_string().into_bytes();
    let at = text.iter().position(|&byte| byte == b'?').unwrap();
    text[at] = 0xf6;
    let surface = parse(&file(&[(b"JSON", &text), (b"BIN\0", &model.data)]), None).unwrap();
    assert_eq!(&*surface.groups[0].name, "K\u{fffd}rper");
    assert_note(&surface, "not valid UTF-8");
}

#[test]
fn the_scene_is_the_stated_one_or_the_first_or_all_roots() {
    let mut model = Model::cube();
    model.set("/nodes", json!([{ "mesh": 0 }, { "mesh": 0, "scale": [2, 2, 2] }, { "children": [1] }]));
    for (scene, scenes, expected) in [
        (json!(null), json!([{ "nodes": [0] }]), 1.0),
        (json!(1), json!([{ "nodes": [0] }, { "nodes": [2] }]), 8.0),
        (json!(null), json!([{ "nodes": [2] }, {}, { "nodes": [0] }]), 8.0),
        (json!(null), json!(null), 9.0),
        (json!(null), json!([]), 9.0),
        (json!(0), json!([{ "nodes": [0, 0] }]), 1.0),
    ] {
        let others = scenes.as_array().map_or(0, |scenes| scenes.len().saturating_sub(1));
        let surface = model.with("/scene", scene).with("/scenes", scenes).read();
        assert_volume(&surface, 12 * surface.groups.len(), expected);
        match others {
            0 => assert!(surface.notes.is_empty()),
            _ => assert_note(&surface, &format!("the other scenes ({others}) were not")),
        }
    }
    let empty = model.with("/scenes/0/nodes", json!(null)).read();
    assert!(empty.triangles.is_empty());
    assert_eq!(empty.notes, ["scenes[0]: the scene has no mesh"]);
    let bare = model.with("/scenes", json!(null)).with("/scene", json!(null)).with("/nodes", json!([{}])).read();
    assert_eq!(bare.notes, ["nodes: no node places a mesh"]);
}

#[test]
fn points_lines_and_primitives_without_positions_are_passed_over() {
    let mut model = Model::cube();
    let of = |mode: u32| json!({ "attributes": { "POSITION": 0 }, "mode": mode });
    let primitives = model.json["meshes"][0]["primitives"].as_array_mut().unwrap();
    primitives.extend([of(0), of(1), of(2), of(3), json!({ "attributes": { "NORMAL": 0 } }), json!({})]);
    let surface = model.read();
    assert_volume(&surface, 12, 1.0);
    assert_note(&surface, "meshes[0].primitives[1] and 3 more: points or lines were passed over");
    assert_note(&surface, "meshes[0].primitives[5] and 1 more: it has no positions");
}

#[test]
fn malformed_members_that_matter_are_refused_with_their_path() {
    let cube = Model::cube();
    for (pointer, value, refusal) in [
        ("/nodes", json!("x"), "nodes: \"x\" is not a list"),
        ("/nodes/0", json!(7), "nodes[0]: 7 is not an object"),
        ("/scene", json!(4), "scene: scenes[4] does not exist, the document has 1"),
        ("/scene", json!("main"), "scene: \"main\" is not a whole number from 0"),
        ("/scenes/0/nodes/0", json!(-1), "scenes[0].nodes[0]: -1 is not a whole number from 0"),
        ("/nodes/0/mesh", json!(3), "nodes[0].mesh: meshes[3] does not exist, the document has 1"),
        ("/nodes/0/children", json!([0.5]), "nodes[0].children[0]: 0.5 is not a whole number from 0"),
        ("/nodes/0/scale", json!([1, 1]), "nodes[0].scale: it has 2 numbers instead of 3"),
        ("/nodes/0/scale", json!([1, "1", 1]), "nodes[0].scale[1]: \"1\" is not a finite number"),
        ("/meshes/0/primitives", json!({}), "meshes[0].primitives: {} is not a list"),
        ("/meshes/0/primitives/0/mode", json!(7), "meshes[0].primitives[0].mode: 7 is not a mode from 0 to 6"),
        ("/meshes/0/primitives/0/indices", json!("x"), "meshes[0].primitives[0].indices: \"x\" is not a whole"),
        ("/accessors", json!(null), "meshes[0].primitives[0].attributes.POSITION: accessors[0] does not exist"),
        ("/accessors", json!(3), "meshes[0].primitives[0].attributes.POSITION: accessors: 3 is not a list"),
        ("/accessors/0/count", json!(null), "accessors[0].count: it is missing"),
        ("/accessors/0/componentType", json!(5130), "accessors[0].componentType: 5130 is not a type of numbers"),
        ("/accessors/0/type", json!("vec3"), "accessors[0].type: it is not a type of items"),
        ("/accessors/0/normalized", json!("no"), "accessors[0].normalized: \"no\" is neither true nor false"),
        ("/accessors/0/byteOffset", json!(4), "accessors[0]: its 8 items reach to byte 100 of bufferViews[0], which"),
        ("/bufferViews/0/byteLength", json!("x"), "bufferViews[0].byteLength: \"x\" is not a whole number"),
        (
            "/bufferViews/0/byteStride",
            json!(8),
            "accessors[0]: its items of 12 bytes overlap in bufferViews[0] of stri",
        ),
        ("/bufferViews/0/buffer", json!(null), "bufferViews[0].buffer: it is missing"),
        ("/buffers/0/uri", json!("a.bin"), "buffers[0].uri: files beside a document in memory cannot be read"),
        ("/buffers/0/uri", json!(5), "buffers[0].uri: it is not a text"),
    ] {
        let refused = cube.with(pointer, value).refusal();
        assert!(refused.starts_with(refusal), "{pointer}: {refused}");
    }
}

/// Cubes with a morph target, a skin, a sparse accessor, instances and compressed views, as files.
fn traits() -> Vec<Vec<u8>> {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/cases");
    let folders = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let of_gltf = folders.filter(|path| path.file_name().unwrap().to_str().unwrap().starts_with("gl"));
    let files = of_gltf.flat_map(|path| std::fs::read_dir(path).unwrap()).map(|file| file.unwrap().path());
    let mut files: Vec<_> = files.collect();
    files.sort();
    let mut all: Vec<Vec<u8>> = files.iter().map(|file| std::fs::read(file).unwrap()).collect();
    all.extend([super::pose::skinned(super::pose::WHOLE), super::pose::morphed()].map(|model| model.glb()));
    all.push(super::meshopt::attributes::<4>("KHR_meshopt_compression", 1).glb());
    all
}

proptest! {
    #[test]
    fn spoilt_files_are_refused_or_sound(
        which in any::<Index>(),
        spoils in prop::collection::vec(
            (any::<Index>(), prop::sample::select(b"0123456789,.:-[]{}\"e\x00\xff".to_vec())),
            1..6,
        ),
        cut in prop::option::weighted(0.1, any::<Index>()),
    ) {
        let mut bytes = which.get(&traits()).clone();
        for (at, value) in spoils {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        match parse(&bytes, None) {
            Ok(surface) => {
                let count = surface.positions.len();
                prop_assert!(surface.triangles.as_flattened().iter().all(|&v| (v as usize) < count));
                prop_assert!(surface.groups.iter().all(|group| group.triangles.end <= surface.triangles.len()));
            }
            Err(error) => prop_assert!((1..=1000).contains(&error.to_string().chars().count()), "{error}"),
        }
    }
}
