//! Files that the program derives from models: cuts, drawings, pictures, pages, conversions.

use super::hex;
use oviduct::export::course::CourseDocument;
use oviduct::export::sections_bin::SectionsReader;
use oviduct::export::svg::section_svg;
use oviduct::spec::ModelSpec;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

/// Runs the program in `at`; returns its output.
fn run(at: &Path, line: &str) -> Vec<u8> {
    let arguments = line.split(' ');
    let output = Command::new(env!("CARGO_BIN_EXE_oviduct")).current_dir(at).env_clear().args(arguments).output();
    let output = output.expect("the program runs");
    assert!(output.status.success(), "{line}: {}", String::from_utf8_lossy(&output.stderr));
    output.stdout
}

/// Digests of all files derived from one straight and one bent model.
pub(super) fn digests() -> BTreeMap<String, String> {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    let patch = json!({
        "length_mm": 20, "steps": 100, "burn_in": 30, "lean": { "strength_um": 300 },
        "particles": { "total": { "keys": [[0, 260], [1, 560]] }, "outer": { "keys": [[0, 60], [1, 90]] } },
    });
    std::fs::write(at.join("spec.json"), patch.to_string()).expect("written");
    let mut digests = BTreeMap::new();
    for (model, course) in [("straight", ""), ("bent", " --set course.shape=arc --set course.turn_deg=120")] {
        let outputs = "--outputs glb,gltf,obj,stl,stl-ascii,ply,vtp,lod --bodies tissue,regions";
        run(at, &format!("generate --seed 7 --gpu off --spec spec.json --out {model} {outputs}{course}"));
        drawings(&at.join(model), &mut |name, bytes| {
            digests.insert(format!("{model}/{name}"), hex(bytes));
        });
        for made in made(at, model) {
            let bytes = std::fs::read(at.join(&made)).unwrap_or_else(|e| panic!("{made}: {e}"));
            digests.insert(made, hex(&bytes));
        }
    }
    digests
}

/// Drawings that the service creates without a file.
fn drawings(dir: &Path, found: &mut dyn FnMut(&str, &[u8])) {
    let file = std::fs::File::open(dir.join("sections.bin")).expect("sections");
    let mut sections = SectionsReader::open(file).expect("sections");
    for k in [0, sections.len() / 2, sections.len() - 1] {
        found(&format!("section {k} as SVG"), section_svg(&sections.section(k).expect("a section")).as_bytes());
    }
    let report: Value =
        serde_json::from_slice(&std::fs::read(dir.join("report.json")).expect("a report")).expect("JSON");
    let spec = ModelSpec::from_stored(&report["spec"]).expect("a spec");
    found("course", &serde_json::to_vec(&CourseDocument::of(&spec)).expect("JSON"));
}

/// Creates the derived files of a model; returns their paths.
fn made(at: &Path, model: &str) -> Vec<String> {
    let mut made = vec![format!("{model}/manifest.json"), format!("{model}/report.html")];
    run(at, &format!("report {model}"));
    let mut make = |line: String, out: &str| {
        let out = format!("{model}/{out}");
        run(at, &line.replace("OUT", &out));
        made.push(out);
    };
    for (of, place) in [("across", "--z-um 13000"), ("along", "--origin-um 0,0,1 --normal 0,-1,0.1")] {
        for (out, more) in [("json", ""), ("svg", ""), ("png", " --size 120"), ("labels.png", " --size 120 --labels")] {
            make(format!("cut {model}/model.glb {place} --out OUT{more}"), &format!("{of}.{out}"));
        }
    }
    for (out, more) in [("stained.png", ""), ("tissues.png", " --labels")] {
        make(format!("section {model}/sections.bin --index 5 --size 120 --out OUT{more}"), out);
    }
    for view in ["whole", "opened", "isthmus", "ampulla"] {
        for (of, file) in [("surface", "model.lod0.glb"), ("sections", "sections.bin")] {
            make(format!("render {model}/{file} --view {view} --size 120 --out OUT"), &format!("{view}-{of}.png"));
        }
    }
    for from in ["glb", "gltf", "obj", "stl", "ascii.stl", "ply", "vtp"] {
        for to in ["glb", "ascii.stl", "vtp"] {
            make(format!("convert {model}/model.{from} OUT --units m"), &format!("{from}-to.{to}"));
        }
    }
    for to in ["gltf", "bin", "obj", "stl", "ply"] {
        let file = to.replace("bin", "gltf");
        make(format!("convert {model}/regions.vtp {model}/regions-to.{file} --units m"), &format!("regions-to.{to}"));
    }
    made
}
