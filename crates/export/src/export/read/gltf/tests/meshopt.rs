//! Views compressed by meshoptimizer, as other programs write them.

use super::*;

/// Replaces the data of an accessor by compressed data.
fn compress(model: &mut Model, accessor: usize, name: &str, data: &[u8], object: Value) {
    let view = model.json["accessors"][accessor]["bufferView"].as_u64().unwrap() as usize;
    let own = model.add_view(data);
    let mut object = object;
    for member in ["buffer", "byteOffset", "byteLength"] {
        object[member] = model.json["bufferViews"][own][member].clone();
    }
    // The buffer of the view has no data.
    let length = model.json["bufferViews"][view]["byteLength"].clone();
    model.json["bufferViews"][view] = json!({ "buffer": 1, "byteLength": length, "extensions": { name: object } });
    model.json["buffers"] =
        json!([{ "byteLength": 0 }, { "byteLength": 0, "extensions": { name: { "fallback": true } } }]);
    model.set("/extensionsRequired", json!([name]));
}

fn positions<const N: usize>() -> Vec<[f32; N]> {
    CORNERS.iter().map(|p| std::array::from_fn(|k| p.get(k).copied().unwrap_or(7.0))).collect()
}

/// A cube whose positions have `N` words each.
pub(super) fn attributes<const N: usize>(name: &str, version: i32) -> Model {
    let mut model = Model::cube();
    let data = ::meshopt::encode_vertex_buffer_level(&positions::<N>(), 2, Some(version)).unwrap();
    compress(&mut model, 0, name, &data, json!({ "byteStride": 4 * N, "count": 8, "mode": "ATTRIBUTES" }));
    model
}

fn indices() -> Vec<u32> {
    FACES.as_flattened().iter().map(|&v| u32::from(v)).collect()
}

#[test]
fn attributes_of_every_stride_and_version_are_read() {
    for name in super::super::extensions::MESHOPT {
        for version in [0, 1] {
            for model in [
                attributes::<3>(name, version),
                attributes::<4>(name, version),
                attributes::<7>(name, version),
                attributes::<33>(name, version),
                attributes::<64>(name, version),
            ] {
                let surface = model.read();
                assert_volume(&surface, 12, 1.0);
                assert!(surface.notes.is_empty(), "{:?}", surface.notes);
            }
        }
    }
}

#[test]
fn quantized_and_filtered_positions_are_read() {
    let mut model = Model::cube();
    let cells: Vec<[u16; 4]> = CORNERS.iter().map(|p| [p[0], p[1], p[2], 0.0].map(|x| (x * 500.0) as u16)).collect();
    let data = ::meshopt::encode_vertex_buffer(&cells).unwrap();
    compress(
        &mut model,
        0,
        "EXT_meshopt_compression",
        &data,
        json!({ "byteStride": 8, "count": 8, "mode": "ATTRIBUTES" }),
    );
    model.set("/bufferViews/0/byteStride", json!(8));
    model.set("/accessors/0/componentType", json!(5123));
    model.set("/nodes/0/scale", json!([0.002, 0.002, 0.002]));
    assert_volume(&model.read(), 12, 1.0);
    model.set("/bufferViews/0/byteStride", json!(12));
    assert!(model.refusal().contains("byteStride: 8 is not the stride of the view"));
    let mut model = Model::cube();
    let words = ::meshopt::encode_filter_exp(&positions::<3>(), 15, ::meshopt::EncodeExpMode::SharedVector);
    let data = ::meshopt::encode_vertex_buffer(&words).unwrap();
    let object = json!({ "byteStride": 12, "count": 8, "mode": "ATTRIBUTES", "filter": "EXPONENTIAL" });
    compress(&mut model, 0, "EXT_meshopt_compression", &data, object);
    assert_volume(&model.read(), 12, 1.0);
}

#[test]
fn indices_of_both_modes_and_sizes_are_read() {
    let list = ::meshopt::encode_index_buffer(&indices(), 8).unwrap();
    let sequence = ::meshopt::encode_index_sequence(&indices(), 8).unwrap();
    for (mode, data) in [("TRIANGLES", list), ("INDICES", sequence)] {
        for (stride, component) in [(2, 5123), (4, 5125)] {
            let mut model = Model::cube();
            let object = json!({ "byteStride": stride, "count": 36, "mode": mode });
            compress(&mut model, 1, "KHR_meshopt_compression", &data, object);
            model.set("/accessors/1/componentType", json!(component));
            assert_volume(&model.read(), 12, 1.0);
        }
    }
}

#[test]
fn filters_of_rotations_are_applied() {
    // Instances are turned by 90° about z.
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let mut model = Model::cube();
    let rotation = model.add("VEC4", 5122, &shorts(&[0; 4]), 1);
    model.set(&format!("/accessors/{rotation}/normalized"), json!(true));
    model.set("/nodes/0/extensions", json!({ "EXT_mesh_gpu_instancing": { "attributes": { "ROTATION": rotation } } }));
    let data = ::meshopt::encode_vertex_buffer(&::meshopt::encode_filter_quat(&[[0.0, 0.0, half, half]], 16)).unwrap();
    let object = json!({ "byteStride": 8, "count": 1, "mode": "ATTRIBUTES", "filter": "QUATERNION" });
    compress(&mut model, rotation, "EXT_meshopt_compression", &data, object);
    let surface = model.read();
    let [x, y, _] = surface.positions[1];
    assert!(x.abs() < 1e-4 && (y - 1.0).abs() < 1e-4, "{x} {y}");
    assert_volume(&surface, 12, 1.0);
}

#[test]
fn every_filter_keeps_the_length_of_its_data() {
    for (filter, stride) in [("OCTAHEDRAL", 4), ("OCTAHEDRAL", 8), ("COLOR", 4), ("COLOR", 8), ("QUATERNION", 8)] {
        let mut model = Model::cube();
        let data = match stride {
            4 => ::meshopt::encode_vertex_buffer(&[[100_u8, 50, 127, 0]; 8]),
            _ => ::meshopt::encode_vertex_buffer(&[[100_u16, 50, 32_767, 0]; 8]),
        };
        let object = json!({ "byteStride": stride, "count": 8, "mode": "ATTRIBUTES", "filter": filter });
        compress(&mut model, 0, "KHR_meshopt_compression", &data.unwrap(), object);
        model.set("/accessors/0/componentType", json!(if stride == 4 { 5121 } else { 5123 }));
        assert_eq!(model.read().positions.len(), 8, "{filter} {stride}");
    }
}

#[test]
fn damaged_or_impossible_data_are_refused_with_the_extension() {
    let model = attributes::<3>("EXT_meshopt_compression", 0);
    let at = "bufferViews[0].extensions.EXT_meshopt_compression";
    for (member, value, refusal) in [
        ("count", json!(4_000_000_000_u64), ".count: 4000000000 items cannot come from"),
        ("count", json!(7_000), ": its"),
        ("count", json!(7), "accessors[0]: its 8 items reach to byte 96 of bufferViews[0], which has 84"),
        ("byteStride", json!(14), ".byteStride: 14 is no stride"),
        ("byteStride", json!(260), ".byteStride: 260 is no stride"),
        ("byteStride", json!(0), ".byteStride: 0 is no stride"),
        ("mode", json!("POINTS"), ".mode: it is not ATTRIBUTES, TRIANGLES or INDICES"),
        ("mode", json!("TRIANGLES"), ".byteStride: 12 is no stride"),
        ("filter", json!("QUATERNION"), ".byteStride: 12 is no stride"),
        ("filter", json!("WAVELET"), ".filter: WAVELET is not known"),
        ("byteLength", json!(1_000_000), ": it reaches to byte"),
        ("buffer", json!(1), "buffers[1]: it has no data"),
    ] {
        let refused =
            model.with(&format!("/bufferViews/0/extensions/EXT_meshopt_compression/{member}"), value).refusal();
        let path = if refusal.starts_with(['a', 'b']) { "" } else { at };
        assert!(refused.starts_with(&format!("{path}{refusal}")), "{member}: {refused}");
    }
}

#[test]
fn a_small_file_of_huge_views_is_refused() {
    // Zeros shrink a thousand times; ninety views would be 90 MB.
    let mut model = Model::cube();
    let data = ::meshopt::encode_vertex_buffer_level(&vec![[0_u32; 4]; 65_536], 2, Some(1)).unwrap();
    assert!(data.len() < 2_000, "{}", data.len());
    let mut primitives = Vec::new();
    for _ in 0..90 {
        let accessor = model.add("VEC3", 5126, &[0; 12], 65_536);
        let object = json!({ "byteStride": 16, "count": 65_536, "mode": "ATTRIBUTES" });
        compress(&mut model, accessor, "EXT_meshopt_compression", &data, object);
        primitives.push(json!({ "attributes": { "POSITION": accessor }, "indices": 1 }));
    }
    model.set("/meshes/0/primitives", json!(primitives));
    assert!(model.refusal().contains("so many items from so few bytes"), "{}", model.refusal());
}

#[test]
fn damaged_data_never_panic() {
    let model = attributes::<4>("EXT_meshopt_compression", 1);
    let whole = model.glb();
    let begin = whole.len() - model.data.len().next_multiple_of(4);
    for at in begin..whole.len() {
        for change in [0x01, 0x55, 0x80, 0xff] {
            let mut damaged = whole.clone();
            damaged[at] ^= change;
            let _ = parse(&damaged, None);
        }
    }
}
