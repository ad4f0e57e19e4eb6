//! Containers with chunks, padding and lengths that other programs write.

use super::*;
use crate::export::read::Format;

fn parts() -> (Vec<u8>, Vec<u8>) {
    let model = Model::cube();
    let mut text = model.json.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    (text, model.data)
}

fn cube_of(bytes: &[u8]) -> Surface {
    let surface = parse(bytes, None).unwrap();
    assert_volume(&surface, 12, 1.0);
    surface
}

#[test]
fn unknown_chunks_are_passed_over_anywhere() {
    let (text, data) = parts();
    let (json, bin): (Chunk<'_>, Chunk<'_>) = ((b"JSON", &text), (b"BIN\0", &data));
    let (other, empty): (Chunk<'_>, Chunk<'_>) = ((b"XTRA", b"abcd"), (b"\xff\0\0\0", b""));
    for chunks in [[other, json, bin], [json, other, bin], [json, empty, bin]] {
        assert_note(&cube_of(&file(&chunks)), "a chunk of unknown type");
    }
    assert!(cube_of(&file(&[json, bin, other])).notes.is_empty());
    assert_note(&cube_of(&file(&[other, json, other, empty, bin])), "byte 12 and 2 more: a chunk");
}

#[test]
fn bytes_after_the_document_do_not_matter() {
    let (mut text, data) = parts();
    text.extend_from_slice(&[0; 4]);
    assert!(cube_of(&file(&[(b"JSON", &text), (b"BIN\0", &data)])).notes.is_empty());
    text.extend_from_slice(b"\xff}{]");
    assert_note(&cube_of(&file(&[(b"JSON", &text), (b"BIN\0", &data)])), "after its end were passed over");
}

#[test]
fn chunks_without_padding_are_found() {
    let (mut text, data) = parts();
    text.truncate(text.trim_ascii_end().len());
    while text.len() % 4 != 3 {
        text.insert(1, b' ');
    }
    cube_of(&file(&[(b"JSON", &text), (b"BIN\0", &data)]));
}

#[test]
fn a_byte_order_mark_is_passed_over() {
    let mut model = Model::cube();
    let uri = "data:application/octet-stream;base64,".to_owned();
    model.set("/buffers/0/uri", json!(uri + &base64::Engine::encode(&crate::export::read::text::BASE64, &model.data)));
    let text = [b"\xef\xbb\xbf", model.json.to_string().as_bytes()].concat();
    assert!(cube_of(&text).notes.is_empty());
    let padded = [text, vec![b' '; 3]].concat();
    cube_of(&file(&[(b"JSON", &padded)]));
    assert_eq!(crate::export::read::parse(&padded, Format::Gltf, None).unwrap().triangles.len(), 12);
}

#[test]
fn a_header_may_state_fewer_bytes_but_not_more() {
    let whole = Model::cube().glb();
    let stated = |length: u32| [&whole[..8], &length.to_le_bytes(), &whole[12..]].concat();
    for length in [0, 20, whole.len() as u32 - 1] {
        assert_note(&cube_of(&stated(length)), &format!("the header states {length} bytes"));
    }
    assert_note(&cube_of(&[whole.clone(), vec![7; 9]].concat()), "all chunks were read");
    let refused = parse(&stated(whole.len() as u32 + 1), None).unwrap_err().to_string();
    assert!(refused.starts_with("byte 8:") && refused.ends_with("its end is missing"), "{refused}");
}

#[test]
fn other_versions_are_refused_by_name() {
    let whole = Model::cube().glb();
    let refused = parse(&[&whole[..4], &1u32.to_le_bytes(), &whole[8..]].concat(), None).unwrap_err().to_string();
    assert_eq!(refused, "byte 4: this is glTF 1.0, and only glTF 2.0 is read; convert the file first");
    for (member, value) in [("/asset/version", json!("1.0")), ("/meshes", json!({ "a": {} }))] {
        assert!(Model::cube().with(member, value).refusal().contains("glTF 1.0"));
    }
    assert!(Model::cube().with("/asset/version", json!("3.1")).refusal().contains("asset.version: this is glTF 3.1"));
    let least = |version: &str| Model::cube().with("/asset/minVersion", json!(version));
    let refused = least("2.1").refusal();
    assert_eq!(refused, "asset.minVersion: the document requires glTF 2.1, and only glTF 2.0 is read");
    assert!(least("3.0").refusal().starts_with("asset.minVersion:"));
    assert!(least("2.0").read().notes.is_empty());
    let unstated = Model::cube().with("/asset", json!(null)).read();
    assert_eq!(unstated.notes, ["asset: it is missing; glTF 2.0 is assumed"]);
    let none = parse(&file(&[(b"BIN\0", b"abcd")]), None).unwrap_err().to_string();
    assert_eq!(none, "byte 12: there is no JSON chunk");
}
