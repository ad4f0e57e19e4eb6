//! `oviduct check`: the surface read from an exported file equals the certified one. The command
//! refuses files that are not surfaces or are too large, in bounded time.

use oviduct::export::glb::{GlbOptions, write_glb};
use oviduct::export::obj::write_obj;
use oviduct::export::read::{Format, parse};
use oviduct::export::{Metadata, Shape};
use oviduct::measure::{Certificate, CheckOptions, certify, check_surface};
use oviduct::model::{BodyKind, Mesh, Patch, PatchKind};
use serde_json::{Value, json};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

#[path = "../../benches/common/tube.rs"]
mod tube;

fn model() -> Mesh {
    let tube = tube::tube(5, 300, 40, 7);
    let (inner, outer, all) = (2 * 4 * 300, 2 * 4 * 40, tube.triangles.len());
    let ends = (all - inner - outer) / 2;
    let bounds = [0, inner, inner + outer, inner + outer + ends, all];
    let kinds = [PatchKind::InnerWall, PatchKind::OuterWall, PatchKind::CapIsthmus, PatchKind::CapAmpulla];
    let patches = kinds.into_iter().zip(bounds.windows(2)).map(|(kind, w)| Patch { kind, triangles: w[0]..w[1] });
    Mesh { body: BodyKind::Tissue, positions: tube.positions, triangles: tube.triangles, patches: patches.collect() }
}

fn metadata() -> Metadata {
    Metadata {
        preset: "pig".to_owned(),
        seed: 7,
        digest: "0".repeat(64),
        engine: "test".to_owned(),
        length_mm: 1.2,
        sections: 5,
    }
}

fn same(mut read: Certificate, mut made: Certificate) {
    assert!(read.passed && made.passed, "{:?} {:?}", read.failures, made.failures);
    // The last digits of the sums depend on the order of the triangles.
    for (a, b) in [(&mut read.area_mm2, &mut made.area_mm2), (&mut read.volume_mm3, &mut made.volume_mm3)] {
        assert!((*a - *b).abs() < 1e-9 * b.abs());
        (*a, *b) = (0.0, 0.0);
    }
    for c in [&mut read, &mut made] {
        c.bodies.iter_mut().for_each(|body| body.volume_mm3 = 0.0);
        c.min_angle_deg = (c.min_angle_deg * 1e9).round();
    }
    assert_eq!(read, made);
}

#[test]
fn glb_and_obj_hold_the_certified_surface() {
    let mesh = model();
    let made = certify(&mesh, &[]);
    let options = CheckOptions { euler: Some(0), ..CheckOptions::default() };
    for strips in [false, true] {
        let mut bytes = Vec::new();
        write_glb(&Shape::of(&mesh, &metadata()), &GlbOptions { strips, skin: None }, &mut bytes).unwrap();
        let surface = parse(&bytes, Format::Gltf, None).unwrap();
        let names: Vec<_> = surface.groups.iter().map(|g| &*g.name).collect();
        assert_eq!(names, ["inner_wall", "outer_wall", "cap_isthmus", "cap_ampulla"]);
        same(check_surface(&surface.positions, &surface.triangles, &options), made.clone());
    }
    let mut bytes = Vec::new();
    write_obj(&Shape::of(&mesh, &metadata()), &mut bytes).unwrap();
    let surface = parse(&bytes, Format::Obj, None).unwrap();
    assert_eq!(surface.triangles, mesh.triangles);
    assert_eq!(surface.positions, mesh.positions.iter().map(|p| p.map(f64::from)).collect::<Vec<_>>());
    same(check_surface(&surface.positions, &surface.triangles, &options), made);
}

/// Result of the command for one file. The limit of two minutes holds even on a loaded machine.
fn check(file: &Path) -> Value {
    let mut command = Command::new(env!("CARGO_BIN_EXE_oviduct"));
    let mut child = command.args(["check", "--json"]).arg(file).stdout(Stdio::piped()).spawn().expect("it starts");
    for _ in 0..1_200 {
        if child.try_wait().expect("it can be waited for").is_some() {
            let output = child.wait_with_output().expect("its output can be read");
            let answer: Value = serde_json::from_slice(&output.stdout).expect("JSON");
            assert_eq!(output.status.success(), answer[0]["certificate"]["passed"] == true);
            return answer[0].clone();
        }
        std::thread::sleep(Duration::from_millis(100));
    }
    child.kill().expect("it can be ended");
    panic!("no answer for {}", file.display());
}

#[cfg(unix)]
#[test]
fn a_pipe_is_refused_without_waiting_for_its_other_end() {
    let dir = tempfile::tempdir().unwrap();
    let pipe = dir.path().join("pipe.stl");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let error = format!("{} is a pipe (FIFO), not a regular file", pipe.display());
    assert_eq!(check(&pipe)["error"], json!(error));
}

#[test]
fn random_bytes_are_not_recognised_and_the_formats_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("random.glb");
    std::fs::write(&file, (0..1_000u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect::<Vec<_>>())
        .unwrap();
    let answer = check(&file);
    let error = answer["error"].as_str().unwrap();
    assert!(error.starts_with("the format is not recognised. Known formats"), "{error}");
}

/// A glTF document with one triangle and `nodes` instances of it, at the translations `place`.
fn instances(nodes: u32, place: impl Fn(u32) -> Value) -> String {
    let data = "AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA";
    json!({
        "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": (0..nodes).collect::<Vec<_>>() }],
        "nodes": (0..nodes).map(|i| json!({ "mesh": 0, "translation": place(i) })).collect::<Vec<_>>(),
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
        "buffers": [{ "byteLength": 36, "uri": format!("data:application/octet-stream;base64,{data}") }],
        "bufferViews": [{ "buffer": 0, "byteLength": 36 }],
        "accessors": [{
            "bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 3, "min": [0, 0, 0], "max": [1, 1, 0]
        }],
    })
    .to_string()
}

#[test]
fn coincident_instances_are_counted_as_copies_in_bounded_time() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("copies.gltf");
    std::fs::write(&file, instances(200_000, |_| json!([0, 0, 0]))).unwrap();
    let certificate = &check(&file)["certificate"];
    assert_eq!(certificate["duplicate_triangles"], 200_000_u64 * 199_999 / 2);
    assert_eq!((&certificate["triangles"], &certificate["triangle_intersections"]), (&json!(200_000), &json!(0)));
    let failures = certificate["failures"].as_array().unwrap();
    let copies = failures.iter().find(|failure| failure["kind"] == "duplicate_triangles").unwrap();
    assert_eq!(copies["places"].as_array().unwrap().len(), 16);
}

#[test]
fn instances_beyond_the_limit_are_refused_by_the_command() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("many.gltf");
    let mut document: Value = serde_json::from_str(&instances(10_000, |i| json!([i, 0, 0]))).unwrap();
    let primitive = document["meshes"][0]["primitives"][0].clone();
    document["meshes"][0]["primitives"] = json!(vec![primitive; 10_000]);
    std::fs::write(&file, document.to_string()).unwrap();
    let error = "nodes (all instances of meshes placed): there are 100000000 triangles, and at most 64000000 are read";
    assert_eq!(check(&file)["error"], json!(error));
}
