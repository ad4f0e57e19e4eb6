//! `oviduct cut`: planar cuts of files.

use super::{TINY, code, folder, json, run, said};
use serde_json::Value;

#[test]
fn a_model_is_cut_across_and_along_in_every_form() {
    let at = folder();
    let generate = ["generate", "--seed", "3", "--json", "--outputs", "glb,stl", "--out", "model"];
    json(&run(at.path(), &[&generate, &TINY[..]].concat()));
    let cut = |file: &str, place: &[&str], out: &[&str]| run(at.path(), &[&["cut", file], place, out].concat());
    let read = |name: &str| -> Value { serde_json::from_slice(&std::fs::read(at.path().join(name)).unwrap()).unwrap() };

    let across = ["--z-um", "30000"];
    let told = cut("model/model.glb", &across, &["--out", "cut.json"]);
    assert_eq!(code(&told), 0, "{}", said(&told));
    let line = String::from_utf8_lossy(&told.stdout).into_owned();
    assert!(line.starts_with("tissue ") && line.contains(" islands ") && line.ends_with("/cut.json\n"), "{line}");
    let found = read("cut.json");
    assert_eq!((&found["rings"][0]["kind"], &found["rings"][1]["kind"]), (&"tissue".into(), &"lumen".into()));
    // The same surface in another format and unit, without patch names.
    assert_eq!(code(&cut("model/model.stl", &across, &["--out", "stl.json"])), 0);
    let other = read("stl.json");
    let [a, b] = [&found, &other].map(|cut| cut["tissue_area_um2"].as_f64().unwrap());
    assert!((a / b - 1.0).abs() < 1e-5, "{a} and {b}");
    assert_eq!(found["rings"].as_array().unwrap().len(), other["rings"].as_array().unwrap().len());

    let told = cut("model/model.glb", &["--z", "3cm"], &["--out", "cm.json"]);
    assert_eq!(code(&told), 0, "{}", said(&told));
    assert_eq!(read("cm.json"), found);

    let along = ["--origin-um", "0,0,1", "--normal", "0,-1,0"];
    for (file, place, out) in [
        ("model/model.glb", &across[..], &["--out", "a.svg"][..]),
        ("model/model.glb", &across, &["--out", "a.png", "--size", "100", "--epithelium-um", "20"]),
        ("model/model.glb", &across, &["--out", "a20.png", "--size", "100", "--epithelium", "0.02mm"]),
        ("model/model.stl", &across, &["--out", "b.png", "--size", "100", "--labels"]),
        ("model/model.glb", &along, &["--out", "c.PNG", "--size", "100", "--labels"]),
        ("model/model.stl", &along, &[]),
        ("model/model.stl", &["--origin", "0,0,1um", "--normal", "0,-1,0"], &[]),
    ] {
        let told = cut(file, place, out);
        assert_eq!(code(&told), 0, "{file} {out:?}: {}", said(&told));
    }
    let bytes = |name: &str| std::fs::read(at.path().join(name)).unwrap();
    assert_eq!(bytes("a.png"), bytes("a20.png"));
    // Without the name of the inner wall, a cut along the tube cannot assign tissue layers.
    let told = cut("model/model.stl", &along, &["--out", "d.png"]);
    assert!(code(&told) == 1 && said(&told).contains("inner_wall"), "{}", said(&told));
    let missed = cut("model/model.glb", &["--z-um", "-5"], &[]);
    assert!(code(&missed) == 1 && said(&missed).contains("reaches from 0.0 to 60000.0 µm"), "{}", said(&missed));
}

#[test]
fn a_bent_model_is_cut_across_its_centre_line() {
    let at = folder();
    let grow = |out: &str, course: &[&str]| {
        let generate = ["generate", "--seed", "3", "--json", "--outputs", "glb", "--out", out];
        json(&run(at.path(), &[&generate, course, &TINY[..]].concat()));
    };
    grow("straight", &[]);
    grow("bent", &["--set", "course.shape=arc", "--set", "course.turn_deg=120"]);
    let cut = |model: &str, z: &str| -> Value {
        let file = format!("{model}/model.glb");
        let told = run(at.path(), &["cut", &file, "--z-um", z, "--out", "cut.json"]);
        assert_eq!(code(&told), 0, "{}", said(&told));
        serde_json::from_slice(&std::fs::read(at.path().join("cut.json")).unwrap()).unwrap()
    };
    for z in ["0", "20000", "59000"] {
        let [straight, bent] = ["straight", "bent"].map(|model| cut(model, z));
        for name in ["tissue_area_um2", "lumen_area_um2"] {
            let [a, b] = [&straight, &bent].map(|cut| cut[name].as_f64().unwrap());
            assert!((a / b - 1.0).abs() < 2e-3, "{name} at {z}: {a} and {b}");
        }
        assert_eq!(straight["islands"], bent["islands"]);
        assert!(bent["plane"]["reach_um"].is_number() && straight["plane"]["reach_um"].is_null());
    }
    let beyond = run(at.path(), &["cut", "bent/model.glb", "--z-um", "60001"]);
    assert!(code(&beyond) == 2 && said(&beyond).contains("from 0.0 to 60000.0 µm"), "{}", said(&beyond));
    // `--report` names a report in another folder. Without a report, `--z-um` means a plane across
    // the z axis.
    std::fs::rename(at.path().join("bent/report.json"), at.path().join("r.json")).unwrap();
    let named = run(at.path(), &["cut", "bent/model.glb", "--z-um", "30000", "--report", "r.json"]);
    assert_eq!(code(&named), 0, "{}", said(&named));
    assert_eq!(code(&run(at.path(), &["cut", "bent/model.glb", "--z-um", "59000"])), 1);
    let bad = run(at.path(), &["cut", "bent/model.glb", "--z-um", "1", "--report", "bent/model.glb"]);
    assert!(code(&bad) == 2 && said(&bad).contains("--report"), "{}", said(&bad));
}

#[test]
fn invalid_planes_and_options_are_named() {
    let at = folder();
    for (options, word) in [
        (&[][..], "--z"),
        (&["--z", "42"], "--z"),
        (&["--z", "42 apples"], "um, mm, cm or m"),
        (&["--z", "1mm", "--z-um", "1"], "--z-um"),
        (&["--z", "1mm", "--origin", "0,0,1mm", "--normal", "0,0,1"], "--origin"),
        (&["--origin", "0,0,0", "--origin-um", "0,0,0", "--normal", "0,0,1"], "--origin-um"),
        (&["--origin", "0,0,1", "--normal", "0,0,1"], "has no unit of length"),
        (&["--normal", "0,0,1"], "--origin"),
        (&["--z", "1mm", "--serosa", "2um", "--serosa-um", "2"], "--serosa-um"),
        (&["--z", "1mm", "--from-units", "inch"], "--from-units"),
        (&["--z-um", "high"], "--z-um"),
        (&["--z-um", "NaN"], "--z-um"),
        (&["--z-um", "1", "--normal", "0,0,1"], "--normal"),
        (&["--origin-um", "0,0,0"], "--normal"),
        (&["--origin-um", "0,0", "--normal", "0,0,1"], "--origin-um"),
        (&["--origin-um", "0,0,0", "--normal", "0,0,0"], "--normal"),
        (&["--z-um", "1", "--out", "cut.gif"], "--out"),
        (&["--z-um", "1", "--labels"], "--labels"),
        (&["--z-um", "1", "--preset", "whale"], "--preset"),
    ] {
        let told = run(at.path(), &[&["cut", "model.glb"], options].concat());
        assert_eq!(code(&told), 2, "{options:?}: {}", said(&told));
        assert!(said(&told).contains(word), "{options:?}: {}", said(&told));
    }
    let told = run(at.path(), &["cut", "model.glb", "--z-um", "1"]);
    assert!(code(&told) == 1 && said(&told).contains("model.glb"), "{}", said(&told));
}

/// Volume of the surface in a file, which must pass the check.
fn checked(at: &std::path::Path, file: &str) -> f64 {
    let found = json(&run(at, &["check", "--json", file]));
    assert_eq!(found[0]["certificate"]["passed"], true, "{found}");
    found[0]["certificate"]["volume_mm3"].as_f64().expect("a volume")
}

#[test]
fn a_part_of_a_model_is_a_closed_solid() {
    let at = folder();
    let generate = ["generate", "--seed", "3", "--json", "--outputs", "glb,vtp", "--out", "model"];
    json(&run(at.path(), &[&generate, &TINY[..]].concat()));
    let whole = checked(at.path(), "model/model.glb");
    let solid = |line: &[&str]| {
        let told = run(at.path(), &[&["cut", "model/model.glb"], line].concat());
        assert_eq!(code(&told), 0, "{line:?}: {}", said(&told));
        String::from_utf8_lossy(&told.stdout).into_owned()
    };
    let along = ["--origin-um", "0,0,0", "--normal", "0,1,0"];
    let across = ["--z-um", "30000"];
    let tilted = ["--origin-um", "0,0,20000", "--normal", "0.2,1,0.1"];
    for place in [&across[..], &along, &tilted] {
        let told = solid(&[place, &["--solid", "front.glb"]].concat());
        assert!(told.contains("inner_wall") && told.contains(", cut\n") && told.contains("passed: closed"), "{told}");
        solid(&[place, &["--solid", "back.glb", "--side", "back"]].concat());
        let [front, back] = ["front.glb", "back.glb"].map(|file| checked(at.path(), file));
        assert!(front > 0.0 && back > 0.0);
        assert!(((front + back) / whole - 1.0).abs() < 1e-6, "{place:?}: {front} + {back}, not {whole}");
    }
    // A slab, in every format that is read.
    let mut volumes = Vec::new();
    for file in ["slab.stl", "slab.obj", "slab.ply", "slab.vtp", "slab.glb"] {
        let told = solid(&[&across[..], &["--thick", "1.5mm", "--solid", file]].concat());
        assert!(told.contains(", cut_back"), "{told}");
        volumes.push(checked(at.path(), file));
    }
    let behind = solid(&[&across[..], &["--side", "back", "--thick", "1500um", "--solid", "slab.3mf"]].concat());
    assert!(behind.contains("slab.3mf") && behind.contains(", in mm; patches inner_wall"), "{behind}");
    // The tube is 60 mm long and its section varies little: 1.5 mm of it are about a fortieth.
    assert!(volumes.iter().all(|v| (v / volumes[0] - 1.0).abs() < 1e-5), "{volumes:?}");
    assert!((0.5..2.0).contains(&(volumes[0] / (whole / 40.0))), "{volumes:?} of {whole}");
    // A cut part can be cut again; both faces keep names of their own.
    let again =
        run(at.path(), &["cut", "slab.vtp", "--origin-um", "0,0,0", "--normal", "1,0,0", "--solid", "again.vtp"]);
    assert!(code(&again) == 0 && String::from_utf8_lossy(&again.stdout).contains("cut_2"), "{}", said(&again));
    checked(at.path(), "again.vtp");

    for (line, status, part) in [
        (&["--z-um", "70000", "--solid", "x.stl"][..], 1, "reaches from 0.0 to 60000.0 µm"),
        (&["--z-um", "-1", "--solid", "x.stl"], 1, "has everything in front of it"),
        (&["--z-um", "70000", "--solid", "x.stl"], 1, "has nothing in front of it"),
        (&["--z-um", "1", "--solid", "model/model.glb"], 2, "the file that is read"),
        (&["--z-um", "1", "--solid", "x.step"], 2, "known are"),
        (&["--z-um", "1", "--solid", "x.stl", "--thick", "5"], 2, "has no unit of length"),
        (&["--z-um", "1", "--solid", "x.stl", "--thick", "0"], 2, "more than 0"),
        (&["--z-um", "1", "--thick", "5mm"], 2, "--solid"),
    ] {
        let told = run(at.path(), &[&["cut", "model/model.glb"], line].concat());
        assert!(code(&told) == status && said(&told).contains(part), "{line:?}: {}", said(&told));
    }
    assert!(!at.path().join("x.stl").exists());
}

#[test]
fn solids_of_other_programs_files_are_cut_through_faces_and_corners() {
    let at = folder();
    let cases = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/cases");
    // Cubes of side 2 m from 0 to 2.
    for case in ["obj-mixed/cube.obj", "ply-big-endian-extras/cube.ply", "vtp-modelfaceid/cube.vtp"] {
        let file = format!("{cases}/{case}");
        for (origin, normal, expected) in [
            ("0,0,0", "0,0,1", 8.0),
            ("0,0,500000", "0,0,1", 6.0),
            ("1000000,1000000,0", "1,1,0", 4.0),
            ("1000000,1000000,1000000", "1,1,1", 4.0),
        ] {
            let line = ["cut", &file, "--origin-um", origin, "--normal", normal, "--solid", "part.glb"];
            let told = run(at.path(), &line);
            assert_eq!(code(&told), 0, "{line:?}: {}", said(&told));
            let volume = checked(at.path(), "part.glb") / 1e9;
            assert!((volume / expected - 1.0).abs() < 1e-5, "{line:?}: {volume}, not {expected}");
        }
        let missed = run(at.path(), &["cut", &file, "--z-um", "2000000", "--solid", "part.glb"]);
        assert!(code(&missed) == 1 && said(&missed).contains("from 0.0 to 2000000.0"), "{}", said(&missed));
    }
    // What is no closed surface has no closed part.
    std::fs::write(at.path().join("open.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\n")
        .unwrap();
    let open = run(at.path(), &["cut", "open.obj", "--z-um", "500000", "--solid", "part.stl"]);
    assert!(code(&open) == 1 && said(&open).contains("the surface is not closed and sound"), "{}", said(&open));
}
