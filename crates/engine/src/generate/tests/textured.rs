//! Tests of models with textures.

use super::*;
use crate::export::read::read_surface;

/// Grows a small model and returns its directory.
fn grown(patch: &serde_json::Value, outputs: &[Output]) -> (tempfile::TempDir, Outcome) {
    let dir = tempfile::tempdir().unwrap();
    let request = Request { outputs: outputs.to_vec().into(), ..request(small(patch), Backend::Cpu, dir.path()) };
    let outcome = generate(&request, &(), &CancelToken::default()).unwrap();
    (dir, outcome)
}

fn hashes(outcome: &Outcome) -> BTreeMap<&str, &str> {
    outcome.files.iter().map(|file| (file.name.as_str(), file.sha256.as_str())).collect()
}

#[test]
fn textures_leave_the_surface_as_it_is() {
    let outputs = [Output::Glb, Output::Gltf, Output::Stl, Output::Lod];
    for patch in [
        json!({}),
        json!({ "mesh": { "strips": true }, "length_mm": 20, "course": { "shape": "arc", "turn_deg": 90 } }),
    ] {
        let mut with = patch.clone();
        json_patch::merge(&mut with, &json!({ "mesh": { "textured": true } }));
        let (plain_dir, plain) = grown(&patch, &outputs);
        let (dir, textured) = grown(&with, &outputs);
        assert!(textured.findings.certificate.passed);
        assert_eq!(textured.findings.certificate, plain.findings.certificate);
        let surface = |dir: &tempfile::TempDir, name: &str| {
            let read = read_surface(&dir.path().join(name)).unwrap();
            assert!(read.notes.is_empty(), "{:?}", read.notes);
            (read.positions, read.triangles)
        };
        for name in ["model.glb", "model.gltf"] {
            assert_eq!(surface(&dir, name), surface(&plain_dir, name), "{name}");
        }
        let [a, b] = [hashes(&plain), hashes(&textured)];
        assert!(a["model.glb"] != b["model.glb"] && a["model.bin"] != b["model.bin"]);
        let size = |outcome: &Outcome, name: &str| outcome.files.iter().find(|f| f.name == name).unwrap().bytes;
        let added = size(&textured, "model.glb") - size(&plain, "model.glb");
        assert!((100_000..4_000_000).contains(&added), "{added}");
        // Other files contain only the digest of the model, which has as many characters.
        for name in ["model.stl", "model.lod0.glb"] {
            assert_eq!(size(&textured, name), size(&plain, name), "{name}");
        }
    }
}

#[test]
fn textured_files_do_not_depend_on_threads() {
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let (_dir, outcome) = pool.install(|| grown(&json!({ "mesh": { "textured": true } }), &[Output::Glb]));
        hashes(&outcome)["model.glb"].to_owned()
    };
    assert_eq!(on(1), on(3));
}
