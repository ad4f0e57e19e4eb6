//! `oviduct convert`, and the bodies that `oviduct generate` writes.

use super::{TINY, code, folder, json, names, oviduct, run, said};
use serde_json::Value;
use std::path::Path;

fn grown(at: &Path, more: &[&str]) -> Value {
    let mut arguments = vec!["generate", "--out", "m", "--seed", "7", "--json"];
    arguments.extend(more);
    arguments.extend(TINY);
    json(&run(at, &arguments))
}

#[test]
fn bodies_are_written_checked_and_converted() {
    let at = folder();
    let told = grown(at.path(), &["--outputs", "vtp,centreline", "--bodies", "tissue,lumen,regions"]);
    let listed: Vec<_> = told["files"].as_array().unwrap().iter().map(|file| file["name"].as_str().unwrap()).collect();
    let expected = [
        "centreline.csv",
        "centreline.vtp",
        "lumen.vtp",
        "manifest.json",
        "model.vtp",
        "regions.vtp",
        "report.json",
        "sections.bin",
    ];
    assert_eq!(names(&at.path().join("m")), expected);
    assert_eq!(listed.len(), expected.len());
    let manifest: Value = serde_json::from_slice(&std::fs::read(at.path().join("m/manifest.json")).unwrap()).unwrap();
    assert_eq!((&manifest["digest"], &manifest["seed"]), (&told["digest"], &told["seed"]));
    assert_eq!(manifest["files"].as_array().unwrap().len() + 1, expected.len(), "all but itself");

    let line = ["convert", "m/regions.vtp", "n/both.gltf"];
    let done = run(at.path(), &line);
    assert_eq!(code(&done), 0, "{}", said(&done));
    assert_eq!(names(&at.path().join("n")), ["both.bin", "both.gltf"]);
    assert!(said(&done).contains("rounded"), "millimetres to metres: {}", said(&done));
    for (from, to, more) in [
        ("n/both.gltf", "n/both.obj", &[][..]),
        ("n/both.obj", "n/both.ply", &["--units", "m"]),
        ("n/both.ply", "n/both.ascii.stl", &["--units", "m"]),
        ("n/both.ascii.stl", "n/both.STL", &["--units", "m"]),
        ("n/both.ply", "n/text.stl", &["--units", "m", "--ascii"]),
        ("n/both.ply", "n/both.vtp", &["--units", "m"]),
        ("n/both.vtp", "n/back.glb", &[]),
    ] {
        let done = run(at.path(), &[&["convert", from, to], more].concat());
        let said = said(&done);
        assert_eq!(code(&done), 0, "{said}");
        assert!(!said.contains("rounded"), "{from} to {to}: {said}");
    }
    let text = |name: &str| std::fs::read_to_string(at.path().join(name)).unwrap();
    assert_eq!(text("n/both.ascii.stl"), text("n/text.stl"));
    let both = json(&run(at.path(), &["check", "--json", "m/regions.vtp", "n/both.gltf", "n/both.obj", "n/back.glb"]));
    for file in both.as_array().unwrap() {
        let bodies = &file["bodies"];
        assert_eq!(bodies["tissue"]["euler"], 0, "{file}");
        assert_eq!((&bodies["lumen"]["euler"], &bodies["regions"]["passed"]), (&2.into(), &true.into()));
        assert_eq!(bodies["tissue"]["triangles"], told["triangles"]);
    }
    // A binary STL file contains no names. The file is a single surface, in which the edges at the
    // rims belong to three triangles.
    let whole = run(at.path(), &["check", "n/both.STL"]);
    assert_eq!(code(&whole), 1);
    assert!(String::from_utf8_lossy(&whole.stdout).contains("more than two triangles"));
}

#[test]
fn units_are_assumed_stated_or_given() {
    let at = folder();
    let corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n";
    std::fs::write(at.path().join("t.obj"), corners).unwrap();
    let volume = |file: &str| {
        let found = json(&run(at.path(), &["check", "--json", file]));
        found[0]["certificate"]["volume_mm3"].as_f64().unwrap()
    };
    let convert = |more: &[&str]| {
        let done = run(at.path(), &[&["convert", "t.obj", "t.ply"], more].concat());
        assert_eq!(code(&done), 0, "{}", said(&done));
        (said(&done), volume("t.ply"))
    };
    let (said, cubic) = convert(&[]);
    assert!(said.contains("metres are assumed"), "{said}");
    assert!((cubic / (1e9 / 6.0) - 1.0).abs() < 1e-6);
    let (said, cubic) = convert(&["--from-units", "um", "--units", "um"]);
    assert!(said.is_empty(), "{said}");
    assert!((cubic / (1e-9 / 6.0) - 1.0).abs() < 1e-6);
}

#[test]
fn impossible_conversions_fail_before_a_file_is_written() {
    let at = folder();
    std::fs::write(at.path().join("t.obj"), "v 0 0 0\n").unwrap();
    for (line, expected, part) in [
        (&["convert", "t.obj", "t.step"][..], 2, "known are .glb, .gltf, .obj, .stl, .ascii.stl, .ply, .vtp"),
        (&["convert", "t.obj", ".ply"], 2, "has no name"),
        (&["convert", "t.obj", "t.glb", "--units", "mm"], 2, "always in m"),
        (&["convert", "t.obj", "t.ply", "--ascii"], 2, "only STL"),
        (&["convert", "t.obj", "t.ply", "--units", "inch"], 2, "inch"),
        (&["convert", "none.obj", "t.ply"], 1, "none.obj"),
        (&["convert", "t.obj", "t.glb"], 1, "no triangles"),
        (&["generate", "--out", "x", "--bodies", "air"], 2, "tissue"),
    ] {
        let done = oviduct(at.path()).args(line).output().unwrap();
        assert_eq!(code(&done), expected, "{line:?}: {}", said(&done));
        assert!(said(&done).contains(part), "{line:?}: {}", said(&done));
    }
    assert_eq!(names(at.path()), ["t.obj"]);
}
