//! Accessors of all kinds of numbers, with strides, sparse items and without data.

use super::*;

/// A cube whose positions are these numbers for 0 and for 1.
fn quantized(component: u32, normalized: bool, low: &[u8], high: &[u8]) -> Model {
    let mut model = Model::cube();
    let size = low.len();
    let stride = (3 * size).next_multiple_of(4);
    let mut data = Vec::new();
    for corner in CORNERS {
        data.extend(corner.iter().flat_map(|&x| if x == 0.0 { low } else { high }));
        data.resize(data.len().next_multiple_of(stride), 0xee);
    }
    let accessor = model.add("VEC3", component, &data, 8);
    model.set(&format!("/bufferViews/{accessor}/byteStride"), json!(stride));
    model.set("/meshes/0/primitives/0/attributes/POSITION", json!(accessor));
    model.set(&format!("/accessors/{accessor}/normalized"), json!(normalized));
    model
}

#[test]
fn positions_of_every_type_are_read() {
    let (two, minus) = (32_767_i16.to_le_bytes(), (-32_768_i16).to_le_bytes());
    for (component, normalized, low, high, side) in [
        (5120, false, &[0x80][..], &[0x7f][..], 255.0),
        // −128 is −1, as −127 is.
        (5120, true, &[0x80], &[0x7f], 2.0),
        (5121, false, &[3], &[0xff], 252.0),
        (5121, true, &[0], &[0xff], 1.0),
        (5122, false, &minus, &two, 65_535.0),
        (5122, true, &minus, &two, 2.0),
        (5123, false, &[1, 0], &[0, 1], 255.0),
        (5123, true, &[0, 0], &[0xff, 0xff], 1.0),
    ] {
        let model = quantized(component, normalized, low, high);
        let surface = model.read();
        assert_volume(&surface, 12, f64::powi(side, 3));
        assert_note(&surface, "its positions are integers although KHR_mesh_quantization is not declared");
        let declared = model.with("/extensionsUsed", json!(["KHR_mesh_quantization"])).read();
        assert!(declared.notes.iter().all(|note| note.contains("min and max")), "{:?}", declared.notes);
    }
    assert_eq!(
        quantized(5125, false, &[0; 4], &[1, 0, 0, 0]).refusal(),
        "accessors[2]: its numbers are UNSIGNED_INT, and positions are FLOAT or BYTE or UNSIGNED_BYTE or SHORT or \
         UNSIGNED_SHORT"
    );
    let flat = Model::cube().with("/accessors/0/type", json!("VEC2"));
    assert_eq!(flat.refusal(), "accessors[0]: its type is VEC2, and positions are VEC3");
}

#[test]
fn interleaved_positions_are_read() {
    let mut model = Model::cube();
    let data: Vec<u8> = CORNERS.iter().flat_map(|p| [floats(&[7.0; 2]), floats(p), floats(&[9.0])].concat()).collect();
    // The last item ends the view.
    let accessor = model.add("VEC3", 5126, &data[..data.len() - 4], 8);
    model.set(&format!("/bufferViews/{accessor}/byteStride"), json!(24));
    model.set(&format!("/accessors/{accessor}/byteOffset"), json!(8));
    model.set("/meshes/0/primitives/0/attributes/POSITION", json!(accessor));
    assert_volume(&model.read(), 12, 1.0);
}

#[test]
fn indices_of_every_type_are_read() {
    let wide = |size: usize| -> Vec<u8> {
        FACES.as_flattened().iter().flat_map(|&v| u32::from(v).to_le_bytes()[..size].to_vec()).collect()
    };
    for (component, size) in [(5121, 1), (5123, 2), (5125, 4)] {
        let mut model = Model::cube();
        let accessor = model.add("SCALAR", component, &wide(size), 36);
        model.set("/meshes/0/primitives/0/indices", json!(accessor));
        assert_volume(&model.read(), 12, 1.0);
    }
    for (pointer, value) in [("/accessors/1/componentType", json!(5122)), ("/accessors/1/type", json!("VEC3"))] {
        assert!(Model::cube().with(pointer, value).refusal().starts_with("accessors[1]: its"));
    }
}

/// A cube with the sparse items `indices` of its positions, replaced by the values.
fn sparse(indices: &[u16], values: &[[f32; 3]], base: bool) -> Model {
    let mut model = Model::cube();
    let at = model.add_view(&shorts(indices));
    let items = model.add_view(&floats(values.as_flattened()));
    if !base {
        model.set("/accessors/0/bufferView", json!(null));
    }
    model.set(
        "/accessors/0/sparse",
        json!({
            "count": indices.len(), "indices": { "bufferView": at, "componentType": 5123 },
            "values": { "bufferView": items }
        }),
    );
    model
}

#[test]
fn sparse_items_replace_those_of_a_view_or_zeros() {
    let moved = sparse(&[4, 5, 6, 7], &[[0.0, 0.0, 3.0], [1.0, 0.0, 3.0], [1.0, 1.0, 3.0], [0.0, 1.0, 3.0]], true);
    assert_volume(&moved.read(), 12, 3.0);
    let all: Vec<u16> = (1..8).collect();
    assert_volume(&sparse(&all, &CORNERS[1..], false).read(), 12, 1.0);
    let far = sparse(&[8], &[[0.0; 3]], true);
    assert_eq!(far.refusal(), "accessors[0]: its sparse item 8 does not exist");
    let many = far.with("/accessors/0/sparse/count", json!(9));
    assert_eq!(many.refusal(), "accessors[0].sparse.count: 9 is more than the 8 items of the accessor");
    let none = far.with("/accessors/0/sparse/values", json!({}));
    assert_eq!(none.refusal(), "accessors[0].sparse.values.bufferView: it is missing");
}

#[test]
fn an_accessor_without_a_view_is_zeros_and_their_number_is_limited() {
    let model = Model::cube().with("/accessors/0/bufferView", json!(null));
    assert_eq!(model.read().positions, [[0.0; 3]; 8]);
    let many = model.with("/accessors/0/count", json!(4_194_305));
    assert_eq!(many.refusal(), "accessors[0]: there are 4194305 items without data, and at most 4194304 are read");
    let indices =
        Model::cube().with("/accessors/1/bufferView", json!(null)).with("/accessors/1/count", json!(4_000_000_000_u64));
    assert!(indices.refusal().contains("4000000000 items without data"));
}

#[test]
fn missing_bounds_of_positions_are_noted_once() {
    let mut model = Model::cube().with("/accessors/0/max", json!(null));
    let primitive = model.json["meshes"][0]["primitives"][0].clone();
    model.set("/meshes/0/primitives", json!([primitive, primitive]));
    assert_note(&model.read(), "accessors[0]: min and max of the positions are missing");
}
