//! Tests of specifications: resolving, faults, canonical form, presets, schema.

mod properties;
mod tube;

use super::parameters::leaves;
use super::*;
use serde_json::Map;
use serde_json::json;

fn pig() -> &'static Preset {
    preset(DEFAULT_PRESET).unwrap()
}

fn resolve(patch: &Value) -> Result<ModelSpec, Vec<Fault>> {
    ModelSpec::resolve(pig(), patch)
}

fn resolved(patch: &Value) -> ModelSpec {
    resolve(patch).unwrap_or_else(|faults| panic!("{patch}: {faults:?}"))
}

/// Pointers of the faults of a patch.
fn pointers(patch: &Value) -> Vec<String> {
    resolve(patch).map_or_else(|faults| faults.into_iter().map(|f| f.pointer).collect(), |_| Vec::new())
}

/// The only fault of a patch.
fn fault(patch: &Value) -> Fault {
    let faults = resolve(patch).expect_err(&patch.to_string());
    assert_eq!(faults.len(), 1, "{patch}: {faults:?}");
    faults.into_iter().next().unwrap()
}

#[test]
fn an_empty_patch_gives_the_preset() {
    for preset in presets() {
        for patch in [json!({}), json!(null), preset.spec.clone()] {
            let spec = ModelSpec::resolve(preset, &patch).unwrap();
            assert_eq!(ModelSpec::resolve(preset, &spec.to_json()).unwrap(), spec);
        }
    }
}

#[test]
fn presets_have_the_sizes_that_the_paper_gives() {
    let [paper, pig] = ["paper", "pig"].map(|name| ModelSpec::resolve(preset(name).unwrap(), &json!({})).unwrap());
    for spec in [&paper, &pig] {
        assert_eq!((spec.steps, spec.solver.record_every, spec.stations().count()), (2000, 10, 201));
    }
    assert_eq!((paper.particles.total.at(1.0), paper.particles.outer.at(0.0)), (8300.0, 110.0));
    let total = |step: f64| paper.particles.total.at(step / 2000.0);
    assert_eq!((total(0.0), total(425.0), paper.particles.outer.at(1.0)), (710.0, 1175.0, 300.0));
    assert_eq!((paper.z.at(0.2125), pig.z.at(0.15), pig.z.at(0.48)), (0.2125, 0.3, 0.4));
}

#[test]
fn every_value_of_a_preset_has_a_source() {
    for preset in presets() {
        for (pointer, field) in leaves() {
            let source = preset.sources.get(&pointer).unwrap_or_else(|| panic!("{} {pointer}: no source", preset.name));
            assert!(source.len() > 10, "{} {pointer}: {source}", preset.name);
            assert!(preset.spec.pointer(&pointer).is_some(), "{} {pointer}: no value", preset.name);
            assert!(!field.title.is_empty() && !field.doc.is_empty(), "{pointer}");
        }
        assert_eq!(preset.sources.len(), leaves().len(), "{}: sources of unknown fields", preset.name);
        let details = preset.details();
        let spacing = details.parameters.iter().find(|p| p.pointer == "/containment/spacing_um").unwrap();
        assert_eq!((spacing.unit, spacing.value), ("µm", &preset.spec["containment"]["spacing_um"]));
        assert_eq!(spacing.source.unwrap(), preset.sources["/containment/spacing_um"]);
    }
    assert_eq!(presets()[0].name, DEFAULT_PRESET);
    assert!(preset("dragon").is_none());
}

#[test]
fn a_shortened_preset_says_why() {
    let shortened: Vec<&str> = presets().iter().filter(|p| p.shortened.is_some()).map(|p| p.name.as_str()).collect();
    assert_eq!(shortened, ["pig", "pig-luteal", "paper"]);
    for preset in shortened.into_iter().filter_map(preset) {
        let (why, length) = (preset.shortened.as_deref().unwrap(), &preset.spec["length_mm"]);
        assert!(why.contains(&format!("{length} mm")) && why.contains("302 mm"), "{why}");
    }
}

#[test]
fn a_preset_that_is_not_complete_is_refused_with_what_is_missing() {
    let mut broken = pig().clone();
    broken.spec["spring"].as_object_mut().unwrap().remove("damping");
    broken.spec["steps"] = json!("many");
    let faults = ModelSpec::resolve(&broken, &json!({})).unwrap_err();
    let found: Vec<&str> = faults.iter().map(|f| f.pointer.as_str()).collect();
    assert_eq!(found, ["/spring/damping", "/steps"]);
}

#[test]
fn a_whole_specification_is_read_without_a_preset() {
    let spec = resolved(&json!({ "friction": 0.2 }));
    assert_eq!(ModelSpec::from_json(&spec.to_json()), Ok(spec.clone()));
    let mut part = spec.to_json();
    part.as_object_mut().unwrap().remove("wall");
    part["spring"]["damping"] = Value::Null;
    part["stepz"] = json!(1);
    let found: Vec<String> = ModelSpec::from_json(&part).unwrap_err().into_iter().map(|f| f.pointer).collect();
    assert_eq!(found, ["/spring/damping", "/stepz", "/wall"]);
    assert!(ModelSpec::from_json(&json!(null)).is_err());
}

#[test]
fn null_puts_back_the_value_of_the_preset() {
    let spec = resolved(&json!({
        "length_mm": null, "spring": null, "collision": { "gap_um": null, "barrier": 2.5 },
        "containment": { "wall_um": { "ease": null, "fluctuation": { "amplitude": 4, "period": 50 } } },
    }));
    let base = resolved(&json!({}));
    assert_eq!(
        (spec.length_mm, &spec.spring, &spec.collision.gap_um),
        (base.length_mm, &base.spring, &base.collision.gap_um)
    );
    assert_eq!(spec.collision.barrier, Schedule::constant(2.5));
    assert_eq!(
        (spec.containment.wall_um.ease, &spec.containment.wall_um.keys),
        (Ease::Smooth, &base.containment.wall_um.keys)
    );
}

#[test]
fn a_patch_of_a_schedule_replaces_it_or_changes_members() {
    // A number replaces the keys.
    let spec = resolved(&json!({ "collision": { "gap_um": 40 } }));
    assert_eq!(spec.collision.gap_um, Schedule::constant(40.0));
    // An object on keys replaces only its members.
    let spec = resolved(&json!({ "collision": { "gap_um": { "keys": [[0, 50], [1, 20]] } } }));
    assert_eq!((spec.collision.gap_um.at(0.25), spec.collision.gap_um.ease), (50.0 - 30.0 * 0.156_25, Ease::Smooth));
    // A number counts as two keys when an object is applied to it.
    let wave = Some(Fluctuation { amplitude: 0.1, period: 90.0 });
    let spec = resolved(&json!({ "friction": { "fluctuation": { "amplitude": 0.1, "period": 90 } } }));
    assert_eq!(spec.friction, Schedule { fluctuation: wave, ..Schedule::constant(0.3) });
    assert_eq!(
        spec.to_json()["friction"],
        json!({ "keys": [[0, 0.3], [1, 0.3]], "ease": "linear", "fluctuation": { "amplitude": 0.1, "period": 90 } })
    );
    // Members of a fluctuation are merged, too, and amplitude 0 removes it.
    let mut waving = pig().clone();
    waving.spec = spec.to_json();
    let longer = ModelSpec::resolve(&waving, &json!({ "friction": { "fluctuation": { "period": 70 } } })).unwrap();
    assert_eq!(longer.friction.fluctuation, Some(Fluctuation { amplitude: 0.1, period: 70.0 }));
    let none = ModelSpec::resolve(&waving, &json!({ "friction": { "fluctuation": { "amplitude": 0 } } })).unwrap();
    assert_eq!(none, resolved(&json!({})));
    assert_eq!(ModelSpec::resolve(&waving, &resolved(&json!({})).to_json()).unwrap(), none);
}

#[test]
fn unknown_fields_are_named_with_the_nearest() {
    let cases = [
        (json!({ "stepz": 5 }), "/stepz", "did you mean `steps`?"),
        (json!({ "collision": { "gap_mm": 5 } }), "/collision/gap_mm", "did you mean `gap_um`?"),
        (json!({ "gap_um": 5 }), "/gap_um", "did you mean `/collision/gap_um`?"),
        (
            json!({ "mesh": { "whatever it is": 5 } }),
            "/mesh/whatever it is",
            "known are resolution_um, tolerance_um, smooth_um, strips, textured",
        ),
        (json!({ "a/b": 5 }), "/a~1b", "unknown field `a/b`"),
        (json!({ "k0": 5 }), "/k0", "known are length_mm, scale, steps"),
        (json!({ "friction": { "key": [] } }), "/friction/key", "did you mean `keys`?"),
        (
            json!({ "friction": { "fluctuation": { "amplitude": 0, "phase": 1 } } }),
            "/friction/fluctuation/phase",
            "known are",
        ),
    ];
    for (patch, pointer, detail) in cases {
        let fault = fault(&patch);
        assert_eq!(fault.pointer, pointer);
        assert!(fault.detail.contains(detail), "{fault}");
    }
}

#[test]
fn a_flood_of_unknown_fields_draws_a_bounded_answer() {
    let many: Map<String, Value> = (0..100_000).map(|i| (format!("unknown{i}"), json!(i))).collect();
    let faults = resolve(&json!({ "collision": many })).unwrap_err();
    assert_eq!(faults.len(), 65);
    assert_eq!(faults[0], Fault::new("/collision", "has 99936 more unknown fields"));
}

#[test]
fn wrong_types_and_bounds_are_named_with_bound_and_unit() {
    let cases = [
        (json!([]), "", "must be an object, not an array"),
        (json!({ "spring": 3 }), "/spring", "must be an object, not the number 3"),
        (json!({ "length_mm": "long" }), "/length_mm", "must be a number, not the string \"long\""),
        (json!({ "length_mm": {} }), "/length_mm", "must be a number, not an object"),
        (json!({ "length_mm": -1 }), "/length_mm", "is -1, below the least allowed 0.1 mm"),
        (json!({ "length_mm": 1e300 }), "/length_mm", "above the greatest allowed 1000 mm"),
        (json!({ "steps": 62.5 }), "/steps", "must be an integer"),
        (json!({ "steps": -3 }), "/steps", "below the least allowed 1 steps"),
        (json!({ "steps": 1e12 }), "/steps", "above the greatest allowed 100000 steps"),
        (
            json!({ "particles": { "total": 1e9 } }),
            "/particles/total",
            "is 1000000000, above the greatest allowed 200000 particles",
        ),
        (json!({ "particles": { "total": "NaN" } }), "/particles/total", "must be a number or an object"),
        (json!({ "mesh": { "strips": 1 } }), "/mesh/strips", "must be true or false"),
        (json!({ "mesh": { "textured": "yes" } }), "/mesh/textured", "must be true or false"),
        (
            json!({ "mesh": { "textured": true, "resolution_um": 40 } }),
            "/mesh/textured",
            "an even surface has no texture coordinates",
        ),
        (json!({ "mesh": { "resolution_um": 3 } }), "/mesh/resolution_um", "is 3; use at least 5 µm, or 0"),
        (json!({ "mesh": { "tolerance_um": 0 } }), "/mesh/tolerance_um", "below the least allowed 1 µm"),
        (json!({ "piece": { "to": 1.5 } }), "/piece/to", "above the greatest allowed 1 of the length"),
        (json!({ "piece": { "from": 0.5, "to": 0.5 } }), "/piece/to", "is 0.5, not above /piece/from 0.5"),
        (json!({ "solver": { "search": "list" } }), "/solver/search", "did you mean \"lists\"?"),
        (json!({ "solver": { "integrator": 4 } }), "/solver/integrator", "must be one of \"rk4\", \"euler\""),
        (
            json!({ "spring": { "stiffness": 2.1 } }),
            "/spring/stiffness",
            "above the greatest allowed 2 1/step²: the integration is unstable",
        ),
        (json!({ "spring": { "damping": 0.8 } }), "/spring/damping", "0.7 1/step"),
        (json!({ "friction": 2.6 }), "/friction", "2.5 1/step"),
        (json!({ "collision": { "clearance_um": 0 } }), "/collision/clearance_um", "below the least allowed 0.01 µm"),
    ];
    for (patch, pointer, detail) in cases {
        let fault = fault(&patch);
        assert_eq!(fault.pointer, pointer, "{fault}");
        assert!(fault.detail.contains(detail), "{fault}");
    }
    assert_eq!(resolved(&json!({ "steps": 620.0 })).steps, 620);
}

#[test]
fn faults_of_schedules_name_the_key() {
    let friction = |schedule: Value| json!({ "friction": schedule });
    let cases = [
        (json!({ "keys": [] }), "/keys", "has no keys"),
        (json!({ "keys": 3 }), "/keys", "must be an array"),
        (json!({ "keys": [[0.1, 1], [1, 1]] }), "/keys/0/0", "the first key must be at 0"),
        (json!({ "keys": [[0, 1], [0.9, 1]] }), "/keys/1/0", "the last key must be at 1"),
        (json!({ "keys": [[0, 1]] }), "/keys/0/0", "the last key must be at 1"),
        (json!({ "keys": [[0, 1], [0.6, 1], [0.5, 1], [1, 1]] }), "/keys/2/0", "not above 0.6"),
        (json!({ "keys": [[0, 1], [0, 1], [1, 1]] }), "/keys/1/0", "not above 0"),
        (json!({ "keys": [[0, 1], [1.5, 1], [1, 1]] }), "/keys/1/0", "above the greatest allowed 1 of the steps"),
        (json!({ "keys": [[0, 1], [1, 1, 1]] }), "/keys/1", "not an array of 3"),
        (json!({ "keys": [[0, 1], 7] }), "/keys/1", "must be a pair"),
        (json!({ "keys": [[0, 1], [1, "a"]] }), "/keys/1/1", "must be a number"),
        (json!({ "keys": [[0, 1], [1, 3]] }), "/keys/1/1", "above the greatest allowed 2.5 1/step"),
        (json!({ "ease": "slow" }), "/ease", "must be one of \"linear\", \"smooth\""),
        (json!({ "fluctuation": 3 }), "/fluctuation", "must be an object"),
        (json!({ "fluctuation": { "amplitude": 0.1 } }), "/fluctuation/period", "is missing"),
        (json!({ "fluctuation": { "period": 10 } }), "/fluctuation/amplitude", "is missing"),
        (
            json!({ "fluctuation": { "amplitude": 0.1, "period": 0 } }),
            "/fluctuation/period",
            "below the least allowed 2 steps",
        ),
        (
            json!({ "fluctuation": { "amplitude": -0.1, "period": 9 } }),
            "/fluctuation/amplitude",
            "below the least allowed 0",
        ),
        (
            json!({ "fluctuation": { "amplitude": 0.4, "period": 9 } }),
            "/fluctuation/amplitude",
            "below the least allowed 0",
        ),
        (
            json!({ "fluctuation": { "amplitude": 9, "period": 9 }, "keys": [[0, 0.1], [1, 2]] }),
            "/fluctuation/amplitude",
            "leave its bounds",
        ),
    ];
    for (schedule, pointer, detail) in cases {
        let fault = fault(&friction(schedule));
        assert_eq!(fault.pointer, format!("/friction{pointer}"), "{fault}");
        assert!(fault.detail.contains(detail), "{fault}");
    }
    let many: Vec<Value> = (0..=300).map(|i| json!([f64::from(i) / 300.0, 1])).collect();
    assert!(fault(&friction(json!({ "keys": many }))).detail.contains("at most 256"));
}

#[test]
fn what_must_hold_between_parameters_is_checked() {
    let cases = [
        (json!({ "spring": { "stiffness": 1.8 } }), "/spring/stiffness", "must stay below 2.83"),
        (
            json!({
                "bending": { "keys": [[0, 0.2], [1, 0.2]], "fluctuation": { "amplitude": 0.14, "period": 9 } },
                "spring": { "stiffness": 1 },
            }),
            "/spring/stiffness",
            "bending 0.34",
        ),
        (json!({ "spring": { "damping": 0.7 } }), "/spring/damping", "must stay below 2.79"),
        (
            json!({ "solver": { "integrator": "euler" }, "spring": { "stiffness": 0.9 } }),
            "/solver/integrator",
            "must stay below 4",
        ),
        (json!({ "solver": { "integrator": "euler" }, "bending": 0.22 }), "/solver/integrator", "16·bending"),
        (json!({ "z": 0.5 }), "/z", ""),
        (json!({ "z": { "keys": [[0, 0], [0.5, 0.6], [0.7, 0.6], [1, 1]] } }), "/z/keys/2/1", "must increase strictly"),
        (json!({ "z": { "keys": [[0, 0], [0.5, 0.6], [1, 0.9]] } }), "/z", "is 0.9 at 1 of the steps"),
        (json!({ "z": { "keys": [[0, 0.1], [1, 1]] } }), "/z/keys/0/1", "must be 0"),
        (json!({ "z": { "keys": [[0, 0], [0.5, 1e-9], [1, 1]] } }), "/z", "µm apart"),
        (
            json!({ "particles": { "total": { "keys": [[0, 900], [0.5, 2000], [1, 1900]] } } }),
            "/particles/total/keys/2/1",
            "never taken away",
        ),
        (
            json!({ "particles": { "total": { "fluctuation": { "amplitude": 5, "period": 50 } } } }),
            "/particles/total/fluctuation",
            "must not fluctuate",
        ),
        (
            json!({ "particles": { "outer": { "keys": [[0, 110], [1, 8000]] } } }),
            "/particles/outer",
            "inner loop would shrink",
        ),
        (
            json!({ "particles": { "outer": { "keys": [[0, 335], [1, 640]] } } }),
            "/particles/total",
            "leaves 10 particles",
        ),
        (json!({ "particles": { "every": 1000 } }), "/particles/every", "of its"),
        (
            json!({ "steps": 1 }),
            "/particles/every",
            "use more /steps, a smaller /particles/every or a flatter /particles/total",
        ),
        (
            json!({ "length_mm": 900, "steps": 100_000, "solver": { "record_every": 1 }, "particles": { "every": 1 },
                    "z": { "keys": [[0, 0], [0.5, 0.01], [1, 1]] } }),
            "/z",
            "single precision",
        ),
        (json!({ "spring": { "stiffness": 2, "damping": 0.45 }, "bending": 0 }), "/spring/stiffness", "multiplies"),
        (json!({ "collision": { "clearance_um": 0.2 } }), "/collision/clearance_um", "every split would be refused"),
        (json!({ "wall": { "lobing": 0.2 } }), "/wall/lobing", "would meet the inner one"),
    ];
    for (patch, pointer, detail) in cases {
        let faults = resolve(&patch).expect_err(&patch.to_string());
        assert!(faults.iter().any(|f| f.pointer == pointer && f.detail.contains(detail)), "{patch}: {faults:?}");
    }
    let patch = json!({ "containment": { "strength": 9, "ramp_um": 1 } });
    assert_eq!(fault(&patch).pointer, "/containment/strength");
    resolved(&json!({ "solver": { "integrator": "euler" } }));
    resolved(&json!({ "spring": { "stiffness": 2 }, "bending": 0 }));
}

#[test]
fn every_fault_comes_in_one_answer() {
    let found = pointers(&json!({
        "stepz": 1,
        "length_mm": "x",
        "spring": { "stiffness": 1.9, "damping": [] },
        "particles": { "total": { "keys": [[0.5, -1], [0.2, "b"]] }, "candidates": 1.5 },
        "z": { "keys": [[0, 0], [0.5, 0.7], [0.7, 0.6], [1, 1]] },
        "contortion": 5,
    }));
    assert_eq!(
        found,
        [
            "/contortion",
            "/length_mm",
            "/particles/candidates",
            "/particles/total/keys/0/0",
            "/particles/total/keys/0/1",
            "/particles/total/keys/1/0",
            "/particles/total/keys/1/0",
            "/particles/total/keys/1/1",
            "/spring/damping",
            "/spring/stiffness",
            "/stepz",
            "/z/keys/2/1",
        ]
    );
}

#[test]
fn values_that_could_not_be_read_cause_no_further_faults() {
    // The preset's bending would make this stiffness a fault, but the bending that the caller
    // wanted could not be read.
    assert_eq!(pointers(&json!({ "bending": "x", "spring": { "stiffness": 1.9 } })), ["/bending"]);
}

#[test]
fn digests_differ_exactly_if_models_differ() {
    let digest = |patch: Value| resolved(&patch).digest(7);
    let base = digest(json!({}));
    assert_eq!(base.len(), 64);
    for same in [
        json!({ "length_mm": 60.0, "burn_in": 300.0 }),
        json!({ "solver": { "search": "all_pairs" } }),
        json!({ "friction": { "keys": [[0, 0.3], [0.4, 0.3], [1, 0.3]], "ease": "smooth" } }),
        json!({ "collision": { "gap_um": { "fluctuation": { "amplitude": 0, "period": 9 } } } }),
    ] {
        assert_eq!(digest(same.clone()), base, "{same}");
    }
    for other in [
        json!({ "length_mm": 61 }),
        json!({ "solver": { "integrator": "euler" } }),
        json!({ "collision": { "gap_um": { "ease": "linear" } } }),
        json!({ "mesh": { "strips": true } }),
        json!({ "mesh": { "textured": true } }),
        json!({ "mesh": { "resolution_um": 40 } }),
        json!({ "mesh": { "smooth_um": 5 } }),
        json!({ "piece": { "from": 0.5 } }),
    ] {
        assert_ne!(digest(other.clone()), base, "{other}");
    }
    assert_ne!(resolved(&json!({})).digest(8), base);
    assert_ne!(ModelSpec::resolve(preset("paper").unwrap(), &json!({})).unwrap().digest(7), base);
    assert_eq!(digest(json!({ "variation": { "drift": -0.0 } })), digest(json!({ "variation": { "drift": 0 } })));
}

#[test]
fn presets_and_resolved_specs_fit_the_schema() {
    let schema = schema();
    let validator = jsonschema::draft202012::new(&schema).unwrap();
    for preset in presets() {
        let whole = ModelSpec::resolve(preset, &json!({})).unwrap().to_json();
        for value in [&preset.spec, &whole] {
            let errors: Vec<String> =
                validator.iter_errors(value).map(|e| format!("{} {e}", e.instance_path())).collect();
            assert!(errors.is_empty(), "{}: {errors:?}", preset.name);
        }
    }
    let fits = [json!({}), json!({ "friction": { "fluctuation": { "amplitude": 0.1, "period": 9 } } })];
    assert!(fits.iter().all(|value| validator.is_valid(value)));
    for wrong in [
        json!({ "stepz": 1 }),
        json!({ "steps": 1.5 }),
        json!({ "steps": 0 }),
        json!({ "friction": 3 }),
        json!({ "friction": { "keys": [[0, 1], [1, 3]] } }),
        json!({ "friction": { "keys": [[0, 1], [1, 1, 1]] } }),
        json!({ "friction": { "keys": [[0, 1]] } }),
        json!({ "friction": { "key": [] } }),
        json!({ "friction": { "ease": "slow" } }),
        json!({ "friction": { "fluctuation": { "amplitude": 0.1, "period": 0 } } }),
        json!({ "solver": { "search": "list" } }),
    ] {
        assert!(!validator.is_valid(&wrong), "{wrong}");
        assert!(resolve(&wrong).is_err(), "{wrong}");
    }
    for (pointer, field) in leaves() {
        let place = pointer.split('/').skip(1).fold(String::new(), |at, name| format!("{at}/properties/{name}"));
        let described = schema.pointer(&place).unwrap_or_else(|| panic!("{pointer} is not in the schema"));
        assert_eq!(described["title"], field.title);
        assert!(!described["default"].is_null(), "{pointer} has no default");
    }
}

#[test]
fn the_schema_without_defaults_is_as_published() {
    fn without_defaults(value: &mut Value) {
        if let Some(members) = value.as_object_mut() {
            members.remove("default");
            members.values_mut().for_each(without_defaults);
        } else if let Some(items) = value.as_array_mut() {
            items.iter_mut().for_each(without_defaults);
        }
    }
    let mut schema = schema();
    without_defaults(&mut schema);
    insta::assert_json_snapshot!("schema", schema);
}
