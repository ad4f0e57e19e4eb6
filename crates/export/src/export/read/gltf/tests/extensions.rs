//! Extensions that are passed over, noted or refused by name.

use super::*;

const PARTS: [&str; 7] =
    ["/scenes/0", "/nodes/0", "/meshes/0", "/meshes/0/primitives/0", "/accessors/1", "/bufferViews/0", "/buffers/0"];

fn path(part: &str) -> String {
    let names: Vec<String> = part[1..].split('/').map(str::to_owned).collect();
    let mut path = String::new();
    for name in names {
        match name.parse::<usize>() {
            Ok(index) => path += &format!("[{index}]"),
            Err(_) if path.is_empty() => path += &name,
            Err(_) => path += &format!(".{name}"),
        }
    }
    path
}

#[test]
fn unknown_extensions_of_the_geometry_are_refused_if_required_and_noted_if_not() {
    for part in PARTS {
        let model = Model::cube().with(&format!("{part}/extensions"), json!({ "ACME_bend": {} }));
        let used = model.with("/extensionsUsed", json!(["ACME_bend"])).read();
        assert_volume(&used, 12, 1.0);
        assert_note(&used, &format!("{}: the extension ACME_bend is not known and was passed over", path(part)));
        let required = model.with("/extensionsRequired", json!(["ACME_bend"]));
        let expected = format!("{}.extensions.ACME_bend: the extension is required", path(part));
        assert!(required.refusal().starts_with(&expected), "{}", required.refusal());
    }
}

#[test]
fn extensions_of_looks_are_no_obstacle() {
    for name in [
        "KHR_materials_unlit",
        "KHR_materials_variants",
        "KHR_texture_basisu",
        "KHR_texture_transform",
        "KHR_lights_punctual",
        "KHR_animation_pointer",
        "KHR_xmp_json_ld",
        "EXT_texture_webp",
        "EXT_lights_image_based",
        "EXT_mesh_primitive_edge_visibility",
        "BENTLEY_materials_line_style",
        "FB_ngon_encoding",
        "MOZ_hubs_components",
        "OMI_collider",
        "MSFT_lod",
        "VRMC_vrm",
    ] {
        let mut model = Model::cube();
        for part in PARTS {
            model.set(&format!("{part}/extensions"), json!({ name: { "any": 1 } }));
        }
        assert!(model.read().notes.is_empty(), "{name}");
        let required = model.with("/extensionsRequired", json!([name])).read();
        assert_volume(&required, 12, 1.0);
        assert_note(&required, &format!("extensionsRequired: {name} was passed over, because it concerns looks only"));
    }
}

#[test]
fn required_extensions_that_the_geometry_does_not_use_are_noted() {
    let mut model = Model::cube().with("/extensionsRequired", json!(["ACME_bend", "KHR_mesh_quantization", 7]));
    model.set("/animations", json!([{ "extensions": { "ACME_bend": {} } }]));
    // Another mesh, which no node of the scene places.
    model.json["meshes"].as_array_mut().unwrap().push(json!({ "extensions": { "ACME_bend": {} } }));
    let surface = model.read();
    assert_volume(&surface, 12, 1.0);
    assert_note(&surface, "extensionsRequired: ACME_bend was passed over, because no part that was read has it");
    assert_eq!(surface.notes.len(), 1);
}

#[test]
fn unknown_extensions_of_the_document_are_refused_if_required_and_noted_if_not() {
    let model = Model::cube().with("/extensions", json!({ "ACME_scale": { "s": 1000 }, "KHR_lights_punctual": {} }));
    let surface = model.read();
    assert_eq!(surface.notes, ["document: the extension ACME_scale is not known and was passed over"]);
    let refused = model.with("/extensionsRequired", json!(["ACME_scale"])).refusal();
    let why = "the extension is required and not known, so the geometry cannot be read";
    assert_eq!(refused, format!("extensions.ACME_scale: {why}"));
}

#[test]
fn any_number_of_extensions_gives_a_few_short_notes() {
    let names: Vec<String> = (0..500).map(|i| format!("{i:03}{}", "x".repeat(1000))).collect();
    let object: serde_json::Map<String, Value> = names.iter().map(|name| (name.clone(), json!({}))).collect();
    let model = Model::cube().with("/nodes/0/extensions", json!(object));
    let notes = model.read().notes;
    assert!(notes.len() == 40 && notes.iter().all(|note| note.len() < 200), "{}", notes.len());
}

#[test]
fn draco_is_refused_by_name_unless_a_plain_form_is_there() {
    let name = "KHR_draco_mesh_compression";
    let model = Model::cube().with("/meshes/0/primitives/0/extensions", json!({ name: { "bufferView": 9 } }));
    let plain = model.with("/extensionsUsed", json!([name])).read();
    assert_volume(&plain, 12, 1.0);
    assert_note(&plain, "meshes[0].primitives[0]: its form without KHR_draco_mesh_compression was read");
    for other in [
        model.with("/extensionsRequired", json!([name])),
        model.with("/accessors/0/bufferView", json!(null)),
        model.with("/accessors/1/bufferView", json!(null)),
    ] {
        let refused = other.refusal();
        assert!(refused.starts_with("meshes[0].primitives[0]: it is compressed with KHR_draco_mesh_comp"), "{refused}");
    }
    // Only another mesh is compressed.
    let mut other = Model::cube().with("/extensionsRequired", json!([name]));
    other.json["meshes"].as_array_mut().unwrap().push(model.json["meshes"][0].clone());
    assert_volume(&other.read(), 12, 1.0);
}
