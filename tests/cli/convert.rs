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
        (&["convert", "t.obj", "t.step"][..], 2, "known are .glb, .gltf, .obj, .stl, .ascii.stl, .ply, .vtp, .3mf"),
        (&["convert", "t.obj", ".ply"], 2, "has no name"),
        (&["convert", "t.obj", "t.glb", "--units", "mm"], 2, "always in m"),
        (&["convert", "t.obj", "t.ply", "--ascii"], 2, "only STL"),
        (&["convert", "t.obj", "t.ply", "--units", "inch"], 2, "inch"),
        (&["convert", "t.obj", "t.ply", "--scale", "0"], 2, "above 0"),
        (&["convert", "t.obj", "t.ply", "--scale", "inf"], 2, "above 0"),
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

/// A cuboid as OBJ, 1 by 2 by 0.5 units, with a second one 0.25 units above it.
const PLATES: &str = "\
v 0 0 0\nv 1 0 0\nv 0 2 0\nv 1 2 0\nv 0 0 .5\nv 1 0 .5\nv 0 2 .5\nv 1 2 .5
f 1 3 4\nf 1 4 2\nf 5 6 8\nf 5 8 7\nf 1 2 6\nf 1 6 5\nf 3 7 8\nf 3 8 4\nf 1 5 7\nf 1 7 3\nf 2 4 8\nf 2 8 6
v 0 0 .75\nv 1 0 .75\nv 0 2 .75\nv 1 2 .75\nv 0 0 1.75\nv 1 0 1.75\nv 0 2 1.75\nv 1 2 1.75
f 9 11 12\nf 9 12 10\nf 13 14 16\nf 13 16 15\nf 9 10 14\nf 9 14 13\nf 11 15 16\nf 11 16 12
f 9 13 15\nf 9 15 11\nf 10 12 16\nf 10 16 14
";

#[test]
fn a_scaled_surface_is_written_with_the_sizes_that_will_print() {
    let at = folder();
    std::fs::write(at.path().join("p.obj"), PLATES).unwrap();
    let line = ["convert", "p.obj", "p.3mf", "--from-units", "mm", "--scale", "20"];
    let done = run(at.path(), &line);
    assert_eq!(code(&done), 0, "{}", said(&done));
    let told = String::from_utf8_lossy(&done.stdout).into_owned();
    assert!(told.contains("p.3mf: 16 vertices, 24 triangles, in mm; patches surface"), "{told}");
    assert!(told.contains("size 20mm x 40mm x 35mm;"), "{told}");
    assert!(
        told.contains("walls: least 10mm, 5 % thinner than 10mm; gaps: least 5mm, 5 % narrower than 5mm"),
        "{told}"
    );
    assert!(told.contains("sampled at 20000 places"), "{told}");
    assert!(!said(&done).contains("closed"), "{}", said(&done));
    // Other formats print the sizes only with --scale.
    let scaled =
        run(at.path(), &["convert", "p.obj", "p.ply", "--from-units", "mm", "--units", "mm", "--scale", "0.1"]);
    assert!(String::from_utf8_lossy(&scaled.stdout).contains("size 100um x 200um x 175um"), "{}", said(&scaled));
    let found = json(&run(at.path(), &["check", "--json", "p.ply"]));
    let volume = found[0]["certificate"]["volume_mm3"].as_f64().unwrap();
    assert!((volume / 3e-3 - 1.0).abs() < 1e-5, "{volume}");
    let plain = run(at.path(), &["convert", "p.obj", "q.ply"]);
    assert!(!String::from_utf8_lossy(&plain.stdout).contains("walls"));
    // A coordinate beyond single precision, and an object that is not closed.
    let beyond = run(at.path(), &["convert", "p.obj", "r.stl", "--scale", "1e300"]);
    assert!(code(&beyond) == 1 && said(&beyond).contains("smaller --scale"), "{}", said(&beyond));
    let lost = run(at.path(), &["convert", "p.obj", "r.stl", "--scale", "1e-60"]);
    assert!(code(&lost) == 1 && said(&lost).contains("larger --scale"), "{}", said(&lost));
    let negative = run(at.path(), &["convert", "p.obj", "r.stl", "--scale", "-1"]);
    assert!(code(&negative) == 2 && said(&negative).contains("`-1` is not a number above 0"), "{}", said(&negative));
    let same = run(at.path(), &["convert", "p.obj", "p.obj", "--scale", "2"]);
    assert!(code(&same) == 2 && said(&same).contains("p.obj: is the file that is read"), "{}", said(&same));
    assert_eq!(std::fs::read_to_string(at.path().join("p.obj")).unwrap(), PLATES);
    let open = PLATES.replace("\nf 10 16 14", "");
    std::fs::write(at.path().join("open.obj"), open).unwrap();
    let open = run(at.path(), &["convert", "open.obj", "open.3mf"]);
    assert!(code(&open) == 0 && said(&open).contains("3MF requires"), "{}", said(&open));
}
