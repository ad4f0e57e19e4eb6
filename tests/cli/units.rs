//! Units of files: stated, given or assumed.

use super::{code, folder, json, run, said};
use serde_json::Value;
use std::path::Path;

/// A tube in millimetres in a format that states no unit: 90 mm³.
const TUBE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/cases/stl-no-unit-mm/tube-lumen-mm.stl");

/// Writes a cube with an edge of 2, with lines of text before it.
fn cube(path: &Path, comment: &str) {
    let corner = |i: usize| format!("v {} {} {}\n", 2 * (i & 1), i & 2, (i & 4) / 2);
    let corners: String = (0..8).map(corner).collect();
    let faces =
        ["1 3 4", "1 4 2", "5 6 8", "5 8 7", "1 2 6", "1 6 5", "3 7 8", "3 8 4", "1 5 7", "1 7 3", "2 4 8", "2 8 6"];
    let faces: String = faces.iter().map(|face| format!("f {face}\n")).collect();
    std::fs::write(path, format!("{comment}{corners}{faces}")).expect("written");
}

#[test]
fn check_says_in_which_unit_a_file_was_judged() {
    let at = folder();
    let checked = |arguments: &[&str]| json(&run(at.path(), &[&["check", "--json"], arguments].concat()))[0].clone();
    let near = |found: &Value, right: f64| (found.as_f64().unwrap() / right - 1.0).abs() < 1e-6;
    let found = checked(&[TUBE, "--from-units", "mm"]);
    assert!(near(&found["certificate"]["volume_mm3"], 90.0), "{found}");
    assert!(near(&found["certificate"]["bodies"][0]["volume_mm3"], 90.0), "{found}");
    assert_eq!((&found["unit_m"], &found["unit_assumed"]), (&0.001.into(), &false.into()));
    assert_eq!(found["notes"], serde_json::json!([]));
    let found = checked(&[TUBE]);
    assert!(near(&found["certificate"]["volume_mm3"], 90e9), "{found}");
    assert_eq!((&found["unit_m"], &found["unit_assumed"]), (&1.0.into(), &true.into()));
    assert!(found["notes"][0].as_str().unwrap().contains("metres are assumed"), "{found}");
    assert!(near(&checked(&[TUBE, "--from-units", "cm"])["certificate"]["volume_mm3"], 90e3));

    let text = |arguments: &[&str]| {
        let output = run(at.path(), &[&["check"], arguments].concat());
        assert_eq!((code(&output), said(&output).as_str()), (0, ""));
        String::from_utf8(output.stdout).unwrap()
    };
    let told = text(&[TUBE, "--from-units", "mm"]);
    assert!(told.ends_with(", volume 90 mm³\n"), "{told}");
    let told = text(&[TUBE]);
    assert!(told.contains(", volume 90 m³\n  note: the file does not state its unit, so metres are assumed"), "{told}");

    cube(&at.path().join("stated.obj"), "# units: mm\n");
    assert!(text(&["stated.obj"]).ends_with(", volume 8 mm³\n"));
    assert!(text(&["stated.obj", "--from-units", "mm"]).ends_with(", volume 8 mm³\n"));
    let told = text(&["stated.obj", "--from-units", "um"]);
    assert!(told.ends_with(", volume 8 µm³\n  note: the file states mm, but --from-units um applies\n"), "{told}");
    let output = run(at.path(), &["check", "stated.obj", "--from-units", "inch"]);
    assert!(code(&output) == 2 && said(&output).contains("um, mm, cm or m"), "{}", said(&output));
}

#[test]
fn cut_render_and_convert_note_the_unit_on_stderr() {
    let at = folder();
    cube(&at.path().join("c.obj"), "");
    for line in [
        &["cut", "c.obj", "--z", "1m"][..],
        &["render", "c.obj", "--size", "64", "--cut", "z=1m"],
        &["convert", "c.obj", "c.ply"],
    ] {
        let output = run(at.path(), line);
        assert_eq!(code(&output), 0, "{line:?}: {}", said(&output));
        let notes = said(&output);
        let of_unit: Vec<&str> = notes.lines().filter(|line| line.contains("metres are assumed")).collect();
        assert_eq!(of_unit.len(), 1, "{line:?}: {notes}");
        assert!(of_unit[0].starts_with("note: c.obj: "), "{notes}");
    }
    // The plane goes through the middle only if the file is in millimetres.
    for (line, out) in [
        (&["cut", "c.obj", "--from-units", "mm", "--z", "1mm"][..], "tissue 4.0000 mm²"),
        (&["render", "c.obj", "--from-units", "mm", "--size", "64", "--cut", "z=1mm"], "c.png"),
        (&["convert", "c.obj", "c.ply", "--from-units", "cm", "--units", "mm"], "c.ply"),
    ] {
        let output = run(at.path(), line);
        assert_eq!(code(&output), 0, "{line:?}: {}", said(&output));
        assert!(!said(&output).contains("assumed"), "{line:?}: {}", said(&output));
        assert!(String::from_utf8_lossy(&output.stdout).contains(out), "{line:?}");
    }
    let output = run(at.path(), &["check", "c.ply"]);
    assert!(String::from_utf8_lossy(&output.stdout).contains("volume 8000 mm³"), "two centimetres");
}
