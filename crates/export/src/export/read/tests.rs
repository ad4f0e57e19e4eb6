//! Tests of the readers with small files, damaged files and files above the limits.

pub(super) mod cases;
mod foreign;
mod written;

use super::*;
use proptest::prelude::*;
use serde_json::{Value, json};

const CORNERS: [[f32; 3]; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.5, 0.0], [0.1, 0.2, 1e-7]];
const FACES: [[u32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]];

fn wide() -> Vec<[f64; 3]> {
    CORNERS.iter().map(|p| p.map(f64::from)).collect()
}

fn flat(bytes: impl IntoIterator<Item = impl AsRef<[u8]>>) -> Vec<u8> {
    bytes.into_iter().flat_map(|b| b.as_ref().to_vec()).collect()
}

fn glb(document: &Value, data: &[u8]) -> Vec<u8> {
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut data = data.to_vec();
    data.resize(data.len().next_multiple_of(4), 0);
    let word = |n: usize| (n as u32).to_le_bytes();
    let length = 12 + 8 + text.len() + 8 + data.len();
    flat([&b"glTF"[..], &word(2), &word(length), &word(text.len()), b"JSON", &text, &word(data.len()), b"BIN\0", &data])
}

/// A glTF document of one mesh: positions, and indices of `size` bytes each.
fn document(mode: u32, count: usize, size: usize, node: Value) -> Value {
    let kind = [5121, 5123, 0, 5125][size - 1];
    let mut node = node;
    node["mesh"] = json!(0);
    json!({
        "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": [node],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1, "mode": mode }] }],
        "buffers": [{ "byteLength": 48 + count * size }],
        "bufferViews": [
            { "buffer": 0, "byteLength": 48 }, { "buffer": 0, "byteOffset": 48, "byteLength": count * size }],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 4, "min": [0, 0, 0], "max": [1, 1.5, 1] },
            { "bufferView": 1, "componentType": kind, "type": "SCALAR", "count": count }]
    })
}

fn data(indices: &[u32], size: usize) -> Vec<u8> {
    let mut data = flat(CORNERS.iter().flatten().map(|x| x.to_le_bytes()));
    data.extend(indices.iter().flat_map(|i| i.to_le_bytes()[..size].to_vec()));
    data
}

fn read(bytes: &[u8], format: Format) -> Surface {
    parse(bytes, format, None).unwrap()
}

fn refusal(bytes: &[u8], format: Format) -> String {
    parse(bytes, format, None).unwrap_err().to_string()
}

/// Asserts that indices are in range and that groups follow each other.
pub(super) fn assert_sound(surface: &Surface) {
    assert!(surface.triangles.iter().flatten().all(|&v| (v as usize) < surface.positions.len()));
    let mut end = 0;
    for group in &surface.groups {
        assert!(end <= group.triangles.start && group.triangles.start < group.triangles.end);
        end = group.triangles.end;
    }
    assert!(end <= surface.triangles.len());
}

#[test]
fn glb_with_indices_of_every_size() {
    for size in [1, 2, 4] {
        let bytes = glb(&document(4, 12, size, json!({ "name": "tissue" })), &data(FACES.as_flattened(), size));
        let surface = read(&bytes, Format::Gltf);
        assert_eq!((surface.positions, surface.triangles), (wide(), FACES.to_vec()));
        assert_eq!(surface.groups, [Group { name: "tissue".into(), triangles: 0..4 }]);
        assert_eq!(surface.unit, Unit::Stated(1.0));
    }
}

#[test]
fn strips_and_fans_keep_their_orientation() {
    // Two strips, joined by repeated vertices.
    let strip = [0, 1, 2, 3, 3, 0, 0, 1, 2];
    let surface = read(&glb(&document(5, 9, 1, json!({})), &data(&strip, 1)), Format::Gltf);
    assert_eq!(surface.triangles, [[0, 1, 2], [1, 3, 2], [0, 1, 2]]);
    let surface = read(&glb(&document(6, 4, 2, json!({})), &data(&[0, 1, 2, 3], 2)), Format::Gltf);
    assert_eq!(surface.triangles, [[1, 2, 0], [2, 3, 0]]);
}

#[test]
fn nodes_move_and_mirror() {
    let mut document = document(4, 12, 1, json!({ "translation": [0, 0, 5], "scale": [2, 2, -2] }));
    let parent = json!({ "translation": [10, 0, 0], "children": [0] });
    document["nodes"].as_array_mut().unwrap().push(parent);
    document["scenes"][0]["nodes"] = json!([1]);
    let surface = read(&glb(&document, &data(FACES.as_flattened(), 1)), Format::Gltf);
    assert_eq!(surface.positions[1], [12.0, 0.0, 5.0]);
    assert_eq!(surface.positions[2], [10.0, 3.0, 5.0]);
    assert_eq!(surface.triangles[0], [0, 1, 2]);
}

#[test]
fn gltf_with_its_data_within_and_beside() {
    let data = data(FACES.as_flattened(), 1);
    let alphabet = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let text: String = data
        .chunks(3)
        .flat_map(|c| {
            let word = c.iter().fold(0u32, |w, &b| (w << 8) | u32::from(b)) << (8 * (3 - c.len()));
            (0..4).map(move |k| if k <= c.len() { alphabet[(word >> (18 - 6 * k)) as usize & 63] as char } else { '=' })
        })
        .collect();
    let mut document = document(4, 12, 1, json!({}));
    document["buffers"][0]["uri"] = json!(format!("data:application/octet-stream;base64,{text}"));
    let within = read(document.to_string().as_bytes(), Format::Gltf);
    assert_eq!(within.triangles, FACES);
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("the data.bin"), &data).unwrap();
    document["buffers"][0]["uri"] = json!("the%20data.bin");
    std::fs::write(folder.path().join("model.gltf"), document.to_string()).unwrap();
    assert_eq!(read_surface(&folder.path().join("model.gltf")).unwrap(), within);
    document["buffers"][0]["uri"] = json!("../secret.bin");
    assert!(refusal(document.to_string().as_bytes(), Format::Gltf).contains("beside the document"));
}

#[test]
fn broken_gltf_is_refused_with_the_part_named() {
    let sound = document(4, 12, 1, json!({}));
    let data = data(FACES.as_flattened(), 1);
    let broken = |pointer: &str, value: Value| {
        let mut document = sound.clone();
        *document.pointer_mut(pointer).unwrap() = value;
        refusal(&glb(&document, &data), Format::Gltf)
    };
    assert!(broken("/accessors/0/count", json!(5)).contains("accessors[0]"));
    assert!(broken("/accessors", json!([])).contains("attributes.POSITION: accessors[0] does not exist"));
    assert!(broken("/accessors/1/bufferView", json!(7)).contains("bufferView"));
    assert!(broken("/bufferViews/1/byteLength", json!(4_000_000_000u32)).contains("bufferViews[1]"));
    assert!(broken("/accessors/1/componentType", json!(5126)).contains("accessors[1]"));
    assert!(broken("/nodes/0", json!({ "mesh": 0, "children": [0] })).contains("nodes[0]"));
    let mut far = data.clone();
    far[48] = 9;
    assert_eq!(refusal(&glb(&sound, &far), Format::Gltf), "meshes[0].primitives[0]: there is no vertex 9");
    let whole = glb(&sound, &data);
    for length in 4..whole.len() {
        assert!(parse(&whole[..length], Format::Gltf, None).is_err(), "cut at {length}");
    }
}

#[test]
fn obj_with_all_kinds_of_corners() {
    let text = "# grown by hand, units: mm\no body\nv 0 0 0\nv 1 0 0 1.0\nvt 0 0\nv 0 1.5 0\r\ng side \\\n one\n\
                f 1/1 3//2 2/1/1\nv 0.25 .5 1e-7 # tip\nf -4 -3 -1\ng rest\nf 1 2 3 4\n";
    let surface = read(text.as_bytes(), Format::Obj);
    assert_eq!(surface.positions[3], [0.25, 0.5, 1e-7]);
    // The fan around the first corner would leave the last face, so it is the other one.
    assert_eq!(surface.triangles, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [1, 3, 0]]);
    let groups: Vec<_> = surface.groups.iter().map(|g| (&*g.name, g.triangles.clone())).collect();
    assert_eq!(groups, [("side one", 0..2), ("rest", 2..4)]);
    assert_eq!(surface.unit, Unit::Stated(1e-3));
}

#[test]
fn broken_obj_is_refused_with_the_line_named() {
    for (text, message) in [
        ("v 0 0\n", "line 1: a coordinate is missing"),
        ("v 0 0 x\n", "line 1: \"x\" is not a number"),
        (&format!("v 0 0 {}\n", "x".repeat(99)), &format!("line 1: \"{}\"… is not a number", "x".repeat(40))),
        ("v 0 0 0,5\n", "line 1: \"0,5\" is not a number: it has a decimal comma; write a decimal point"),
        ("v 0 0 1.5D-03\n", "line 1: \"1.5D-03\" is not a number: it has a Fortran exponent; write E instead of D"),
        ("v 0 0 \u{1}\u{7f}\n", "line 1: a word that is not text in UTF-8 is not a number"),
        ("v 0 0 0\nf 1 1 2\nf 1 1 1\n", "line 2: there is no vertex 2; the file has 1"),
        ("v 0 0 0\nf 1 1 0\n", "line 2: there is no vertex 0"),
        ("v 0 0 0\nf 1 1 -2\n", "line 2: there is no vertex -2"),
        ("v 0 0 0\nf 1 1 a/1\n", "line 2: \"a/1\" is not a corner of a face"),
    ] {
        assert_eq!(refusal(text.as_bytes(), Format::Obj), message);
    }
}

fn binary_stl() -> Vec<u8> {
    let mut bytes = b"solid but binary".to_vec();
    bytes.resize(80, 0);
    bytes.extend(4u32.to_le_bytes());
    for face in FACES {
        bytes.extend([0; 12]);
        bytes.extend(face.iter().flat_map(|&v| CORNERS[v as usize]).flat_map(f32::to_le_bytes));
        bytes.extend([0; 2]);
    }
    bytes
}

fn text_stl() -> String {
    let mut text = "solid body\n".to_owned();
    for face in FACES {
        text += "facet normal 0 0 0\n outer loop\n";
        for [x, y, z] in face.map(|v| CORNERS[v as usize].map(f64::from)) {
            text += &format!("  vertex {x} {y} {z}\n");
        }
        text += " endloop\nendfacet\n";
    }
    text + "endsolid body\n"
}

#[test]
fn stl_in_both_forms() {
    let binary = read(&binary_stl(), Format::Stl);
    assert_eq!(binary.triangles.len(), 4);
    assert_eq!(binary.positions[1], wide()[2]);
    let text = read(text_stl().as_bytes(), Format::Stl);
    assert_eq!((&text.positions, &text.triangles), (&binary.positions, &binary.triangles));
    assert_eq!(text.groups, [Group { name: "body".into(), triangles: 0..4 }]);
    let bytes = binary_stl();
    let refused = refusal(&bytes[..bytes.len() - 1], Format::Stl);
    assert!(refused.starts_with("byte 80: this is not STL, or the file was cut off"), "{refused}");
    assert!(refused.ends_with("it states 4 triangles and has the bytes of 3"), "{refused}");
    assert_eq!(read(b"", Format::Stl), Surface::default());
    let facet = "facet normal 0 0 1 outer loop vertex 0 0 0 vertex 1 0 0 vertex";
    for (rest, message) in [
        (" 1 2", "line 2: the end is missing: the file stops within a vertex"),
        (" 1 2 x", "line 2: \"x\" is not a number"),
        (" 1 2 3 vertex", "line 2: the end is missing: the file stops within a vertex"),
        (" 1 2 3 facet", "line 2: \"facet\" instead of \"endloop\""),
        (" 1 2 3 endloop\n", "line 2: the end is missing: the file stops before \"endfacet\""),
        (" 1 2 3 endloop endfacet\n", "line 2: the end is missing: the file stops after facet 1, before `endsolid`"),
        (" 1 2 3 endloop endfacet\nvertex 1 2 3", "line 3: \"vertex\" instead of a facet or the end of the solid"),
    ] {
        assert_eq!(refusal(format!("solid\n{facet}{rest}").as_bytes(), Format::Stl), message);
    }
}

#[test]
fn line_ends_do_not_matter_in_stl() {
    let text = text_stl();
    let (first, rest) = text.split_once('\n').unwrap();
    let joined = format!("{first}\n{}\nendsolid", rest.replace("endsolid body", "").replace('\n', " "));
    let rest = rest.replace("endsolid body", "endsolid");
    let broken = format!("{first}\r\n{}", rest.split_ascii_whitespace().collect::<Vec<_>>().join("\r\n"));
    let expected = read(text.as_bytes(), Format::Stl);
    for other in [joined, broken] {
        let found = read(other.as_bytes(), Format::Stl);
        assert_eq!((found.positions, found.triangles), (expected.positions.clone(), expected.triangles.clone()));
    }
}

fn ply(format: &str) -> Vec<u8> {
    let mut bytes = format!(
        "ply\nformat {format} 1.0\ncomment units: um\nelement vertex 4\nproperty float x\nproperty uchar tag\n\
         property float y\nproperty float z\nelement face 4\nproperty list uchar int vertex_indices\nend_header\n"
    )
    .into_bytes();
    let big = format.contains("big");
    let float = |x: f32| if big { x.to_be_bytes() } else { x.to_le_bytes() };
    let int = |x: u32| if big { x.to_be_bytes() } else { x.to_le_bytes() };
    if format == "ascii" {
        for [x, y, z] in wide() {
            bytes.extend(format!("{x} 7 {y} {z}\n").bytes());
        }
        for [a, b, c] in FACES {
            bytes.extend(format!("3 {a} {b} {c}\n").bytes());
        }
    } else {
        for [x, y, z] in CORNERS {
            bytes.extend(flat([&float(x)[..], &[7], &float(y), &float(z)]));
        }
        for [a, b, c] in FACES {
            bytes.extend(flat([&[3][..], &int(a), &int(b), &int(c)]));
        }
    }
    bytes
}

#[test]
fn ply_in_all_forms() {
    for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
        let bytes = ply(format);
        let surface = read(&bytes, Format::Ply);
        assert_eq!((surface.positions, surface.triangles), (wide(), FACES.to_vec()), "{format}");
        assert_eq!(surface.unit, Unit::Stated(1e-6));
        assert!(parse(&bytes[..bytes.len() - 2], Format::Ply, None).is_err());
    }
    let text = String::from_utf8(ply("ascii")).unwrap();
    assert_eq!(refusal(text.replace("3 0 2 1", "3 0 2 4").as_bytes(), Format::Ply), "line 16: there is no vertex 4");
    assert!(refusal(text.replace("property float z\n", "").as_bytes(), Format::Ply).contains("x, y or z"));
    assert!(refusal(b"ply\nformat ascii 1.0\nelement vertex many\n", Format::Ply).starts_with("line 3:"));
}

/// A glTF document of one mesh that `nodes` nodes place. The mesh has the primitive of [`document`]
/// `primitives` times.
fn instanced(nodes: usize, primitives: usize, indices: usize) -> (Value, Vec<u8>) {
    let list = [0, 1, 2].repeat(indices / 3);
    let mut document = document(4, list.len(), 1, json!({}));
    document["scenes"][0]["nodes"] = (0..nodes).collect();
    document["nodes"] = json!(vec![json!({ "mesh": 0, "translation": [1, 0, 0] }); nodes]);
    document["meshes"][0]["primitives"] = json!(vec![document["meshes"][0]["primitives"][0].clone(); primitives]);
    (document, data(&list, 1))
}

#[test]
fn instances_are_read_once_each() {
    let (document, data) = instanced(3, 2, 6);
    let surface = read(&glb(&document, &data), Format::Gltf);
    // Primitives of one mesh share their vertices.
    assert_eq!((surface.positions.len(), surface.triangles.len(), surface.groups.len()), (3 * 4, 3 * 2 * 2, 3 * 2));
    assert_eq!(surface.positions[1], [2.0, 0.0, 0.0]);
    assert_eq!(surface.triangles[11], [8, 9, 10]);
}

#[test]
fn instances_beyond_the_limit_are_refused_before_they_are_placed() {
    // 65 million triangles from 400 kB, by repeated nodes and by repeated primitives with shared
    // accessors.
    for (nodes, primitives, indices) in [(5_000, 1, 39_000), (1, 5_000, 39_000), (70, 70, 39_900)] {
        let (document, data) = instanced(nodes, primitives, indices);
        let refused = refusal(&glb(&document, &data), Format::Gltf);
        let triangles = nodes * primitives * indices / 3;
        let expected = format!(
            "nodes (all instances of meshes placed): there are {triangles} triangles, and at most 64000000 are read"
        );
        assert_eq!(refused, expected);
    }
}

#[test]
fn vertices_that_no_triangle_uses_are_counted_too() {
    let (mut document, _) = instanced(20_000, 1, 3);
    let count = 10_000;
    document["accessors"][0]["count"] = json!(count);
    document["bufferViews"][0]["byteLength"] = json!(12 * count);
    document["bufferViews"][1]["byteOffset"] = json!(12 * count);
    document["buffers"][0]["byteLength"] = json!(12 * count + 3);
    let mut data = vec![0; 12 * count];
    data.extend([0, 1, 2]);
    let refused = refusal(&glb(&document, &data), Format::Gltf);
    assert!(refused.ends_with("there are 200000000 vertices, and at most 192000000 are read"), "{refused}");
}

#[test]
fn strips_of_repeated_vertices_are_counted_by_their_indices() {
    // Such a strip has no triangle, but reading its indices takes time.
    let (mut document, data) = instanced(5_000, 1, 39_000);
    document["meshes"][0]["primitives"][0]["mode"] = json!(5);
    let refused = refusal(&glb(&document, &data), Format::Gltf);
    assert!(refused.contains("195000000 triangles"), "{refused}");
}

#[test]
fn a_count_without_data_is_refused_however_large() {
    let (mut document, data) = instanced(2, 1, 6);
    document["accessors"][1]["count"] = json!(4_000_000_000u32);
    let refused = refusal(&glb(&document, &data), Format::Gltf);
    assert_eq!(refused, "accessors[1]: its 4000000000 items reach to byte 4000000000 of bufferViews[1], which has 6");
}

#[test]
fn overlapping_buffer_views_are_counted_each() {
    // A thousand accessors over a thousand views of the same bytes.
    let (mut document, data) = instanced(100, 1_000, 39_000);
    for k in 0..1_000 {
        let view = document["bufferViews"][1].clone();
        document["bufferViews"].as_array_mut().unwrap().push(view);
        let mut accessor = document["accessors"][1].clone();
        accessor["bufferView"] = json!(k + 2);
        document["accessors"].as_array_mut().unwrap().push(accessor);
        document["meshes"][0]["primitives"][k]["indices"] = json!(k + 2);
    }
    let refused = refusal(&glb(&document, &data), Format::Gltf);
    assert!(refused.contains("there are 1300000000 triangles"), "{refused}");
}

#[test]
fn a_long_name_is_kept_once_for_all_instances() {
    let (mut document, data) = instanced(20_000, 1, 3);
    document["meshes"][0]["name"] = json!("x".repeat(1 << 20));
    let shared = |document: &Value| {
        let surface = read(&glb(document, &data), Format::Gltf);
        assert_eq!((surface.groups.len(), surface.groups[0].name.len()), (20_000, 1 << 20));
        assert!(surface.groups.iter().all(|group| std::sync::Arc::ptr_eq(&group.name, &surface.groups[0].name)));
    };
    shared(&document);
    let mut document = instanced(1, 20_000, 3).0;
    document["materials"] = json!([{ "name": "x".repeat(1 << 20) }]);
    for primitive in document["meshes"][0]["primitives"].as_array_mut().unwrap() {
        primitive["material"] = json!(0);
    }
    shared(&document);
}

#[test]
fn a_deep_tree_of_nodes_is_walked() {
    let depth = 200_000;
    let mut document = document(4, 12, 1, json!({}));
    let chain = (0..depth).map(|i| json!({ "children": [i + 1], "translation": [1, 0, 0] }));
    document["nodes"] = chain.chain([json!({ "mesh": 0 })]).collect();
    let surface = read(&glb(&document, &data(FACES.as_flattened(), 1)), Format::Gltf);
    assert_eq!(surface.positions[0], [f64::from(depth), 0.0, 0.0]);
}

#[test]
fn a_document_of_too_many_objects_is_refused_before_it_is_parsed() {
    let text = format!("{{\"asset\":{{\"version\":\"2.0\"}},\"nodes\":[{}{{}}]}}", "{},".repeat(2_000_000));
    let refused = refusal(text.as_bytes(), Format::Gltf);
    assert_eq!(refused, "document: there are 2000003 JSON objects, and at most 2000000 are read");
}

#[test]
fn a_file_that_many_buffers_name_is_read_once() {
    let folder = tempfile::tempdir().unwrap();
    // Read once per buffer, 10,000 buffers would take 160 GB.
    let part = folder.path().join("data.bin");
    std::fs::File::create(&part).unwrap().set_len(16 << 20).unwrap();
    let (mut document, _) = instanced(1, 1, 6);
    let names = ["data.bin", "./data.bin", "././data.bin", "dat%61.bin"];
    let buffer = |i: usize| json!({ "uri": names[i % names.len()], "byteLength": 16 << 20 });
    document["buffers"] = (0..10_000).map(buffer).collect();
    let path = folder.path().join("model.gltf");
    std::fs::write(&path, document.to_string()).unwrap();
    let surface = read_surface(&path).unwrap();
    assert_eq!(surface.triangles.len(), 2);
}

#[test]
fn files_beyond_the_limit_are_refused_by_their_size() {
    let folder = tempfile::tempdir().unwrap();
    let large = |name: &str, bytes: u64| {
        let path = folder.path().join(name);
        std::fs::File::create(&path).unwrap().set_len(bytes).unwrap();
        path
    };
    let refused = read_surface(&large("large.stl", (4 << 30) + 1)).unwrap_err();
    assert!(matches!(refused, ReadError::TooLarge { most: 4_294_967_296, .. }), "{refused}");
    // The buffer alone is just below the limit; together with the document it is above.
    large("large.bin", (4 << 30) - 100);
    let (mut document, _) = instanced(1, 1, 6);
    document["buffers"][0]["uri"] = json!("large.bin");
    let path = folder.path().join("model.gltf");
    std::fs::write(&path, document.to_string()).unwrap();
    let refused = read_surface(&path).unwrap_err().to_string();
    assert!(refused.contains("large.bin: the file, with those it refers to, has more bytes"), "{refused}");
}

#[cfg(unix)]
#[test]
fn what_is_no_regular_file_is_refused_without_waiting() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("pipe.stl");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let _socket = std::os::unix::net::UnixListener::bind(folder.path().join("socket.stl")).unwrap();
    for (path, kind) in [
        (pipe.as_path(), "a pipe (FIFO)"),
        (folder.path(), "a directory"),
        (Path::new("/dev/zero"), "a device"),
        (&folder.path().join("socket.stl"), "a socket"),
    ] {
        let refused = read_surface(path).unwrap_err().to_string();
        assert_eq!(refused, format!("{} is {kind}, not a regular file", path.display()));
    }
    // The same file as a buffer of a document.
    let (mut document, _) = instanced(1, 1, 6);
    document["buffers"][0]["uri"] = json!("pipe.stl");
    let path = folder.path().join("model.gltf");
    std::fs::write(&path, document.to_string()).unwrap();
    assert!(matches!(read_surface(&path), Err(ReadError::NotAFile { kind: "a pipe (FIFO)", .. })));
}

#[test]
fn bytes_of_no_format_are_called_so_and_the_formats_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let bytes: Vec<u8> = (0..5_000u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    for name in ["random.glb", "random.gltf", "random.obj", "random", "random.bin"] {
        let path = folder.path().join(name);
        std::fs::write(&path, &bytes).unwrap();
        let refused = read_surface(&path).unwrap_err().to_string();
        assert!(refused.starts_with("the format is not recognised"), "{name}: {refused}");
        assert!(["glTF", "PLY", "STL", "OBJ", ".glb"].iter().all(|known| refused.contains(known)), "{refused}");
    }
    for (name, start) in [("random.stl", "byte 80: this is not STL"), ("random.ply", "line 1: the file does not begin")]
    {
        let path = folder.path().join(name);
        std::fs::write(&path, &bytes).unwrap();
        let refused = read_surface(&path).unwrap_err().to_string();
        assert!(refused.starts_with(start), "{name}: {refused}");
    }
}

#[test]
fn a_format_is_known_by_content_or_name() {
    let of = |name: &str, bytes: &[u8]| format_of(Path::new(name), bytes);
    assert_eq!(of("a.bin", b"glTF"), Some(Format::Gltf));
    assert_eq!(of("a", b"ply\n"), Some(Format::Ply));
    assert_eq!(of("A.OBJ", b""), Some(Format::Obj));
    assert_eq!(of("a.txt", b"v 0 0 0"), None);
    assert!(matches!(read_surface(Path::new("/nowhere/a.obj")), Err(ReadError::Io { .. })));
}

fn sane(surface: &Surface) -> bool {
    surface.triangles.iter().flatten().all(|&v| (v as usize) < surface.positions.len())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn random_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        for format in [Format::Gltf, Format::Obj, Format::Stl, Format::Ply] {
            let _ = parse(&bytes, format, None);
        }
    }

    #[test]
    fn spoilt_files_never_panic(which in 0usize..7, spoils in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6)) {
        let (mut bytes, format) = match which {
            0 => (glb(&document(4, 12, 2, json!({ "scale": [1, 2, 3] })), &data(FACES.as_flattened(), 2)), Format::Gltf),
            1 => (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf -1/2 -2//3 -3\n".to_vec(), Format::Obj),
            2 => (binary_stl(), Format::Stl),
            3 => (text_stl().into_bytes(), Format::Stl),
            4 => (ply("ascii"), Format::Ply),
            5 => (ply("binary_little_endian"), Format::Ply),
            _ => (document(5, 12, 1, json!({})).to_string().into_bytes(), Format::Gltf),
        };
        for (at, value) in spoils {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if let Ok(surface) = parse(&bytes, format, None) {
            prop_assert!(sane(&surface));
        }
    }

    #[test]
    fn words_of_the_formats_never_panic(words in prop::collection::vec(prop::sample::select(vec![
        "v", "f", "g", "1", "-1", "0", "2/1", "1e400", "nan", "\\", "\n", "\n", "#", "units: mm", "solid", "vertex",
        "endloop", "facet", "ply\n", "format ascii 1.0\n", "element vertex 2\n", "element face 1\n", "property float x\n",
        "property float y\n", "property float z\n", "property list uchar int vertex_index\n", "end_header\n", "99999999999",
    ]), 0..40)) {
        let text = words.join(" ");
        for format in [Format::Obj, Format::Stl, Format::Ply] {
            if let Ok(surface) = parse(text.as_bytes(), format, None) {
                prop_assert!(sane(&surface));
            }
            let _ = parse(format!("ply\n{text}").replace("\n ", "\n").as_bytes(), Format::Ply, None);
        }
    }
}
