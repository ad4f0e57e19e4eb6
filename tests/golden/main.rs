//! Small models of every preset have the recorded digests, so their bytes have not changed.
//!
//! `digests.json` holds the SHA-256 of every file of each model. When the engine changes on purpose, raise `version` in
//! `Cargo.toml` (it is part of a model's digest, so a finished model of the old engine is never reused for a new one) and
//! record them again: `OVIDUCT_BLESS=1 cargo test --test golden`.

use oviduct::generate::{Backend, CancelToken, Output, Request, generate};
use oviduct::spec::{ModelSpec, preset};
use rayon::prelude::*;
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// Digests of the files of each model, by name.
type Digests = BTreeMap<String, BTreeMap<String, String>>;

const PATH: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden/digests.json");

/// Models of some hundred particles with all forces, all stages and growth of both loops.
fn models() -> Vec<(String, &'static str, u64, Value)> {
    let small = json!({
        "steps": 100, "burn_in": 30,
        "particles": { "total": { "keys": [[0, 260], [1, 560]] }, "outer": { "keys": [[0, 60], [1, 90]] } },
    });
    let mut models = Vec::new();
    for preset in ["paper", "pig"] {
        for seed in [1, 7] {
            models.push((format!("{preset} {seed}"), preset, seed, small.clone()));
        }
    }
    for (name, change) in [
        ("paper 7, euler", json!({ "solver": { "integrator": "euler" } })),
        ("pig 7, strips", json!({ "mesh": { "strips": true } })),
        (
            "pig 7, outline",
            json!({
                "outline": { "kind": "superellipse" }, "scale": 2,
                "folds": { "depth": 0.3, "rows": 2, "period_mm": 150, "stagger": 0.5, "wall": 0.5 },
            }),
        ),
        ("pig 7, straight", json!({ "sway": { "strength": 0 }, "lean": { "strength_um": 0 } })),
    ] {
        let mut patch = small.clone();
        json_patch::merge(&mut patch, &change);
        models.push((name.to_owned(), name.split(' ').next().unwrap_or_default(), 7, patch));
    }
    models
}

fn digests(preset_name: &str, seed: u64, patch: &Value) -> BTreeMap<String, String> {
    let dir = tempfile::tempdir().expect("a folder");
    let spec = ModelSpec::resolve(preset(preset_name).expect("a preset"), patch).expect("a valid spec");
    let request = Request {
        preset: preset_name.to_owned(),
        spec,
        seed,
        backend: Backend::CpuSingle,
        outputs: vec![Output::Glb, Output::Obj].into(),
        dir: dir.path().to_owned(),
        memory_limit_bytes: None,
    };
    let outcome = generate(&request, &(), &CancelToken::default()).expect("a certified model");
    outcome.files.into_iter().map(|file| (file.name, file.sha256)).collect()
}

#[test]
fn models_are_what_they_were() {
    let made: Digests = models()
        .into_par_iter()
        .map(|(name, preset, seed, patch)| (name, digests(preset, seed, &patch)))
        .collect::<Vec<_>>()
        .into_iter()
        .collect();
    assert!(made.values().all(|files| files.len() == 4), "glb, obj, sections.bin, report.json: {made:?}");
    let mut seen: Vec<_> = made.values().flat_map(BTreeMap::values).collect();
    seen.sort_unstable();
    seen.dedup();
    // Every file contains the digest of the specification and seed, so no two files are equal.
    assert_eq!(seen.len(), 4 * made.len(), "two models share a file");
    if std::env::var_os("OVIDUCT_BLESS").is_some() {
        let text = serde_json::to_string_pretty(&made).expect("string keys only") + "\n";
        std::fs::write(PATH, text).expect("tests/golden/digests.json can be written");
    }
    let kept: Digests =
        std::fs::read_to_string(PATH).ok().and_then(|text| serde_json::from_str(&text).ok()).unwrap_or_default();
    let mut changed: Vec<String> = Vec::new();
    for (name, files) in &made {
        let before = kept.get(name);
        changed.extend(
            files
                .iter()
                .filter(|(file, digest)| before.and_then(|files| files.get(*file)) != Some(digest))
                .map(|(file, _)| format!("{file} of {name}")),
        );
    }
    assert!(
        changed.is_empty() && kept.len() == made.len(),
        "other bytes than before: {changed:?}\nIf the engine changed on purpose: raise `version` in Cargo.toml, then \
         OVIDUCT_BLESS=1 cargo test --test golden"
    );
}
