//! The models whose files are pinned. Each has a few hundred particles; together they cover every
//! preset, format, body, unit and choice.

use oviduct::generate::{Output, Outputs};
use oviduct::model::{BodyKind, LengthUnit};
use oviduct::spec::{ModelSpec, preset, presets};
use serde_json::{Value, json};
use std::collections::BTreeSet;

/// A model and its outputs.
pub(super) struct Model {
    pub(super) name: String,
    pub(super) preset: &'static str,
    pub(super) seed: u64,
    pub(super) patch: Value,
    pub(super) outputs: Outputs,
}

impl Model {
    pub(super) fn spec(&self) -> ModelSpec {
        let preset = preset(self.preset).expect("a preset");
        ModelSpec::resolve(preset, &self.patch).unwrap_or_else(|faults| panic!("{}: {faults:?}", self.name))
    }

    fn writes(mut self, formats: &[Output], bodies: &[BodyKind], units: Option<LengthUnit>) -> Self {
        self.outputs = Outputs { formats: formats.to_vec(), bodies: bodies.to_vec(), units };
        self
    }
}

/// A small model with all forces, all stages, growth of both loops, and the changes in `change`.
fn model(preset: &'static str, name: &str, change: &Value) -> Model {
    let mut patch = json!({
        "steps": 100, "burn_in": 30,
        "particles": { "total": { "keys": [[0, 260], [1, 560]] }, "outer": { "keys": [[0, 60], [1, 90]] } },
    });
    json_patch::merge(&mut patch, change);
    let outputs = vec![Output::Glb, Output::Obj].into();
    Model { name: format!("{preset} 7{name}"), preset, seed: 7, patch, outputs }
}

/// Formats of one body that need only a portion of the surface at a time.
const STREAMED: [Output; 10] = [
    Output::Glb,
    Output::Gltf,
    Output::Obj,
    Output::Stl,
    Output::StlAscii,
    Output::Ply,
    Output::Vtp,
    Output::ThreeMf,
    Output::Centreline,
    Output::Lod,
];
/// Formats with a choice of units.
const IN_UNITS: [Output; 7] =
    [Output::Obj, Output::Stl, Output::StlAscii, Output::Ply, Output::Vtp, Output::ThreeMf, Output::Centreline];

pub(super) fn models() -> Vec<Model> {
    let mut models = vec![
        Model { seed: 1, name: "pig 1".to_owned(), ..model("pig", "", &json!({})) },
        Model { seed: 1, name: "paper 1".to_owned(), ..model("paper", "", &json!({})) },
    ];
    for preset in presets() {
        let change = match &*preset.name {
            // With so few steps, deeper folds would move too fast.
            "colon" | "small-intestine" => json!({ "folds": { "depth": 0.05, "period_mm": 900 } }),
            // The coil is tight, so sections farther apart would be divided into millions of
            // triangles.
            "mouse" => json!({ "solver": { "record_every": 2 }, "piece": { "to": 0.2 } }),
            _ => json!({}),
        };
        let model = model(&preset.name, "", &change);
        models.push(match model.preset {
            "paper" => model.writes(&STREAMED, &[BodyKind::Tissue], None),
            "pig" => model,
            _ => model.writes(&[Output::Glb, Output::Lod], &[BodyKind::Tissue], None),
        });
    }
    models.extend(forms());
    models.extend(shapes());
    models.extend(courses());
    models.extend(contractions());
    models
}

/// One surface in all formats, bodies and units.
fn forms() -> Vec<Model> {
    let coarse = json!({ "labels": { "voxel_um": 20, "slice_um": 1000 } });
    let of = |preset, name: &str| model(preset, name, &coarse);
    let mut models = vec![
        of("pig", ", all files").writes(&Output::ALL, &BodyKind::ALL, None),
        of("paper", ", all files").writes(&Output::ALL, &BodyKind::ALL, None),
        model("paper", ", no surface", &json!({ "solver": { "record_every": 5 } })).writes(
            &[Output::Centreline],
            &[BodyKind::Tissue],
            None,
        ),
        model(
            "pig",
            ", part of the labels",
            &json!({
                "piece": { "from": 0.2, "to": 0.7 },
                "labels": { "voxel_um": 15, "slice_um": 700, "from": 0.1, "to": 0.6 },
            }),
        )
        .writes(&[Output::Labels, Output::Vtp], &[BodyKind::Lumen], None),
    ];
    for unit in LengthUnit::ALL {
        let name = format!(", {}", unit.name());
        models.push(of("pig", &name).writes(&IN_UNITS, &BodyKind::ALL, Some(unit)));
        models.push(of("paper", &name).writes(&IN_UNITS, &[BodyKind::Tissue], Some(unit)));
    }
    models
}

/// Models with other solvers, outlines and surfaces.
fn shapes() -> Vec<Model> {
    let lattice: Vec<Vec<f64>> = (0..9)
        .map(|row| {
            (0..9).map(|column| f64::hypot(f64::from(column) - 4.0, f64::from(row) - 4.0) * 0.375 - 1.0).collect()
        })
        .collect();
    let bodies = [BodyKind::Tissue, BodyKind::Lumen, BodyKind::Regions];
    let mended = json!({
        "particles": { "total": { "keys": [[0, 260], [1, 900]] } },
        "contortion": { "magnitude": 8, "fraction": 0.4 }, "solver": { "record_every": 20 },
    });
    let mut models = vec![
        model("paper", ", euler", &json!({ "solver": { "integrator": "euler" } })),
        model("pig", ", grid search", &json!({ "solver": { "search": "grid" } })),
        model("pig", ", all pairs", &json!({ "solver": { "search": "all_pairs", "record_every": 7 } })),
        model(
            "pig",
            ", outline",
            &json!({
                "outline": { "kind": "superellipse" }, "scale": 2,
                "folds": { "depth": 0.3, "rows": 2, "period_mm": 150, "stagger": 0.5, "wall": 0.5 },
            }),
        ),
        model("pig", ", outline of a grid", &json!({ "outline": { "kind": "grid", "grid": lattice } })),
        // First slabs with inserted sections and flipped diagonals, then growth with warnings.
        model("pig", ", mended", &mended),
        model("paper", ", mended", &mended),
        model("pig", ", crowded", &json!({ "steps": 60, "particles": { "total": { "keys": [[0, 300], [1, 2000]] } } })),
        model("pig", ", straight", &json!({ "sway": { "strength": 0 }, "lean": { "strength_um": 0 } })),
        model("pig", ", strips", &json!({ "mesh": { "strips": true } })),
        model("pig", ", strips of all bodies", &json!({ "mesh": { "strips": true } })).writes(
            &[Output::Glb, Output::Gltf],
            &bodies,
            None,
        ),
    ];
    for (name, mesh) in [
        (", even", json!({ "resolution_um": 80 })),
        (", smooth", json!({ "smooth_um": 5 })),
        (", even and smooth", json!({ "resolution_um": 120, "tolerance_um": 8, "smooth_um": 5 })),
    ] {
        for (preset, formats) in [("pig", &[Output::Glb, Output::Vtp][..]), ("paper", &[Output::Ply, Output::Lod])] {
            let change = json!({ "length_mm": 5, "mesh": mesh, "lean": { "ends_mm": 1 } });
            models.push(model(preset, name, &change).writes(formats, &bodies, None));
        }
    }
    models
}

/// Models of bent tubes.
fn courses() -> Vec<Model> {
    let bodies = [BodyKind::Tissue, BodyKind::Lumen];
    let bent = |name: &str, change: &Value| {
        let mut patch = json!({
            "length_mm": 20, "lean": { "strength_um": 300 }, "labels": { "voxel_um": 25, "slice_um": 1000 },
            // Sections farther apart would be divided into many triangles.
            "solver": { "record_every": 2 },
        });
        json_patch::merge(&mut patch, change);
        model("pig", name, &patch).writes(&[Output::Ply, Output::Centreline], &bodies, None)
    };
    vec![
        bent(", arc", &json!({ "course": { "shape": "arc", "turn_deg": 90 } })).writes(&Output::ALL, &bodies, None),
        bent(
            ", arc of a piece",
            &json!({
                "course": { "shape": "arc", "turn_deg": 60 }, "piece": { "from": 0.25, "to": 0.75 },
            }),
        ),
        bent(", coil", &json!({ "length_mm": 30, "course": { "shape": "coil", "windings": 1, "pitch_mm": 15 } })),
        bent(", random", &json!({ "length_mm": 30, "course": { "shape": "random", "tortuosity": 1.1, "seed": 2 } })),
        bent(
            ", textured along points",
            &json!({
                "mesh": { "textured": true },
                "course": { "shape": "points", "points_mm": [[0, 0, 0], [0, 4, 30], [0, 0, 60]] },
            }),
        ),
        bent(", relaxed", &json!({ "course": { "shape": "arc", "turn_deg": 500, "relax": true } })),
        bent(
            ", even sigmoid",
            &json!({
                "length_mm": 5, "lean": { "strength_um": 0 }, "mesh": { "resolution_um": 80 },
                "course": { "shape": "sigmoid", "turn_deg": 20, "twist_deg": 90 },
            }),
        ),
        bent(
            ", strips of an arc",
            &json!({ "mesh": { "strips": true }, "course": { "shape": "arc", "turn_deg": 90 } }),
        )
        .writes(&[Output::Glb, Output::Lod], &bodies, None),
    ]
}

/// Models of tubes that contract.
fn contractions() -> Vec<Model> {
    let of = |name: &str, change: &Value| {
        let mut patch = json!({
            "length_mm": 20, "steps": 240, "lean": { "strength_um": 300 },
            "contraction": { "frames": 3, "wavelength_mm": 6, "shortening": 0.01 },
        });
        json_patch::merge(&mut patch, change);
        model("pig", name, &patch).writes(&[Output::Vtp], &[BodyKind::Tissue], None)
    };
    vec![
        of(", contraction", &json!({})),
        of(
            ", contraction of an arc",
            &json!({
                "course": { "shape": "arc", "turn_deg": 60 },
                "contraction": { "toward": "ovary", "phase": 0.25, "period_s": 7 },
            }),
        ),
        of(", contraction of a smooth surface", &json!({ "mesh": { "smooth_um": 5 } })),
    ]
}

/// Collects the choices in a spec: name and value of each member that is a string or a boolean.
fn chosen(value: &Value, found: &mut BTreeSet<(String, String)>) {
    match value {
        Value::Object(members) => {
            for (name, value) in members {
                if value.is_string() || value.is_boolean() {
                    found.insert((name.clone(), value.to_string()));
                }
                chosen(value, found);
            }
        }
        Value::Array(items) => items.iter().for_each(|item| chosen(item, found)),
        _ => {}
    }
}

/// Collects the choices that a schema offers.
fn offered(schema: &Value, found: &mut BTreeSet<(String, String)>) {
    let Some(members) = schema.as_object() else { return };
    for (name, schema) in ["properties", "$defs"].into_iter().filter_map(|of| members.get(of)?.as_object()).flatten() {
        let values: Vec<Value> = match (&schema["enum"], schema["type"].as_str()) {
            (Value::Array(values), _) => values.clone(),
            (_, Some("boolean")) => vec![false.into(), true.into()],
            _ => Vec::new(),
        };
        found.extend(values.into_iter().map(|value| (name.clone(), value.to_string())));
        offered(schema, found);
    }
}

#[test]
fn every_preset_format_body_unit_and_choice_occurs() {
    let models = models();
    let names: BTreeSet<&str> = models.iter().map(|model| &*model.name).collect();
    assert_eq!(names.len(), models.len(), "a name for each");
    for preset in presets() {
        assert!(models.iter().any(|model| model.preset == preset.name), "{}", preset.name);
    }
    let written: BTreeSet<String> = models.iter().flat_map(|model| model.outputs.files()).collect();
    let all = Outputs { formats: Output::ALL.to_vec(), bodies: BodyKind::ALL.to_vec(), units: None };
    assert_eq!(written, all.files().into_iter().collect());
    for unit in LengthUnit::ALL.map(Some).into_iter().chain([None]) {
        for format in Output::ALL.into_iter().filter(|format| unit.is_none() || format.unit(unit) == unit) {
            let is_written =
                |model: &Model| model.outputs.has(format) && format.unit(model.outputs.units) == format.unit(unit);
            assert!(models.iter().any(is_written), "{format:?} in {unit:?}");
        }
    }
    let (mut theirs, mut all) = (BTreeSet::new(), BTreeSet::new());
    models.iter().for_each(|model| chosen(&model.spec().to_json(), &mut theirs));
    offered(&oviduct::spec::schema(), &mut all);
    for known in [("shape", "coil"), ("integrator", "euler"), ("ease", "smooth")] {
        assert!(all.contains(&(known.0.to_owned(), format!("\"{}\"", known.1))), "{known:?} is not found in {all:?}");
    }
    let missing: Vec<_> = all.difference(&theirs).collect();
    assert!(missing.is_empty(), "{missing:?}");
}
