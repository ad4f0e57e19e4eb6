//! Tests of studies, from JSON to points.

use super::*;
use crate::spec::{ModelSpec, preset};
use serde_json::json;

fn places(vary: &Value) -> Vec<String> {
    Study::read(vary, 100).unwrap_err().into_iter().map(|fault| fault.pointer).collect()
}

fn points(vary: &Value) -> Vec<Vec<Value>> {
    let study = Study::read(vary, 100).unwrap_or_else(|faults| panic!("{faults:?}"));
    (0..study.points()).map(|point| study.values(point).cloned().collect()).collect()
}

#[test]
fn a_grid_has_every_combination() {
    let study = json!({ "design": "grid", "values": {
        "/solver/integrator": ["rk4", "euler"], "/collision/gap_um": { "from": 25, "to": 50, "count": 3 } } });
    let rows = points(&study);
    let expected = json!([[25, "rk4"], [25, "euler"], [37.5, "rk4"], [37.5, "euler"], [50, "rk4"], [50, "euler"]]);
    assert_eq!(json!(rows), expected);
    let study = Study::read(&study, 100).unwrap();
    assert_eq!(study.pointers(), ["/collision/gap_um", "/solver/integrator"]);
    assert_eq!(study.patch(3), json!({ "collision": { "gap_um": 37.5 }, "solver": { "integrator": "euler" } }));
    assert_eq!(study.describe(3), "point 3 (/collision/gap_um: 37.5, /solver/integrator: \"euler\")");
}

#[test]
fn a_range_ends_with_its_ends() {
    // 0.03 + (0.3 - 0.03) is more than 0.3.
    let rows =
        points(&json!({ "design": "grid", "values": { "/wall/lobing": { "from": 0.03, "to": 0.3, "count": 5 } } }));
    assert_eq!((rows.len(), &rows[0], &rows[4]), (5, &vec![json!(0.03)], &vec![json!(0.3)]));
}

#[test]
fn a_zip_takes_values_together() {
    let rows = points(&json!({ "design": "zip", "values": {
        "/steps": { "from": 100, "to": 200, "count": 4 },
        "/friction": [0.1, null, { "fluctuation": { "amplitude": 0.1, "period": 90 } }, 0.1] } }));
    let wave = json!({ "fluctuation": { "amplitude": 0.1, "period": 90 } });
    assert_eq!(json!(rows), json!([[0.1, 100], [null, 133], [wave, 167], [0.1, 200]]));
}

#[test]
fn a_hypercube_has_one_sample_in_each_part() {
    let rows = points(&json!({ "design": "lhs", "samples": 20, "seed": 4, "values": {
        "/collision/gap_um": { "from": 25, "to": 45 },
        "/friction": { "distribution": "log-uniform", "from": 0.1, "to": 1 },
        "/solver/integrator": ["rk4", "euler"],
        "/wall/lobes": { "from": 1, "to": 5 } } }));
    let column = |i: usize| rows.iter().map(|row| row[i].clone()).collect::<Vec<_>>();
    let mut parts: Vec<u64> = column(0).iter().map(|v| v.as_f64().unwrap() as u64 - 25).collect();
    parts.sort_unstable();
    assert_eq!(parts, (0..20).collect::<Vec<_>>());
    let mut parts: Vec<u64> = column(1).iter().map(|v| (20.0 * (v.as_f64().unwrap().log10() + 1.0)) as u64).collect();
    parts.sort_unstable();
    assert_eq!(parts, (0..20).collect::<Vec<_>>());
    assert_eq!(column(2).iter().filter(|v| **v == "rk4").count(), 10);
    for lobes in 1..=5 {
        assert_eq!(column(3).iter().filter(|v| **v == json!(lobes)).count(), 4, "each integer is as likely");
    }
}

#[test]
fn the_points_depend_on_the_study_alone() {
    let study = |seed: u64| {
        json!({ "design": "lhs", "samples": 9, "seed": seed, "values": {
            "/collision/gap_um": { "from": 25, "to": 50 }, "/friction": { "distribution": "normal", "mean": 0.3, "sd": 0.05 } } })
    };
    assert_eq!(points(&study(7)), points(&study(7)));
    assert_ne!(points(&study(7)), points(&study(8)));
    let mut unseeded = study(0);
    unseeded.as_object_mut().unwrap().remove("seed");
    assert_eq!(points(&unseeded), points(&study(0)));
}

#[test]
fn distributions_give_quantiles_in_a_grid() {
    let rows = points(&json!({ "design": "grid", "values": {
        "/wall/lobes": { "distribution": "triangular", "from": 1, "mode": 8, "to": 15, "count": 3 } } }));
    assert_eq!(json!(rows), json!([[5], [8], [11]]));
    let rows = points(&json!({ "design": "grid", "values": {
        "/length_mm": { "distribution": "log-normal", "median": 40, "sd_log": 0.5, "min": 10, "max": 160, "count": 3 } } }));
    let values: Vec<f64> = rows.iter().map(|row| row[0].as_f64().unwrap()).collect();
    assert!((values[1] - 40.0).abs() < 1e-6 && (values[0] * values[2] - 1600.0).abs() < 1e-6, "{values:?}");
}

#[test]
fn all_faults_come_at_once() {
    assert_eq!(places(&json!(3)), [""]);
    assert_eq!(places(&json!({})), ["/design", "/values"]);
    let vary = json!({ "design": "lhs", "samples": 1000, "seed": -1, "valuse": 1, "values": {
        "/collision": [1], "/collision/gap_um": { "from": 5000, "to": "x" }, "/friction": { "from": 2, "to": 1, "count": 3 },
        "/friction/ease": { "from": 1, "to": 2 }, "/length_mm": [], "/solver/integrator": 4,
        "/spring/damping": { "distribution": "normal", "mean": 0.1, "sd": 0, "min": 9 },
        "/steps": { "distribution": "gauss" }, "/wall/lobes": { "from": 1.5, "to": 3 } } });
    let lhs = [
        "/valuse",
        "/samples",
        "/seed",
        "/values/~1collision",
        "/values/~1collision~1gap_um/from",
        "/values/~1collision~1gap_um/to",
        "/values/~1friction/to",
        "/values/~1friction/count",
        "/values/~1friction~1ease",
        "/values/~1friction~1ease",
        "/values/~1length_mm",
        "/values/~1solver~1integrator",
        "/values/~1spring~1damping/sd",
        "/values/~1spring~1damping/min",
        "/values/~1steps/distribution",
        "/values/~1wall~1lobes/from",
    ];
    assert_eq!(places(&vary), lhs);
    let vary = json!({ "design": "grid", "samples": 3, "values": {
        "/friction": { "from": 0.1, "to": 0.2 }, "/length_mm": { "from": 1, "to": 2, "count": 1 } } });
    assert_eq!(places(&vary), ["/samples", "/values/~1friction/count", "/values/~1length_mm/count"]);
    let unlikely = json!({ "design": "lhs", "samples": 3, "values": {
        "/friction": { "distribution": "normal", "mean": 0.1, "sd": 0.01, "min": 1 } } });
    assert_eq!(places(&unlikely), ["/values/~1friction/min"]);
}

/// JSON has no infinity, and null would leave the parameter unchanged.
#[test]
fn quantiles_that_overflow_are_numbers() {
    for distribution in [
        json!({ "distribution": "normal", "mean": 0, "sd": 1e308 }),
        json!({ "distribution": "log-normal", "median": 1e300, "sd_log": 1e300 }),
    ] {
        for row in points(&json!({ "design": "lhs", "samples": 9, "values": { "/length_mm": distribution } })) {
            assert!(row[0].as_f64().unwrap().is_finite());
        }
    }
}

#[test]
fn a_design_that_does_not_fit_together_is_refused() {
    let ten: Vec<usize> = (1..=11).collect();
    assert_eq!(places(&json!({ "design": "grid", "values": { "/steps": ten, "/wall/lobes": ten } })), ["/values"]);
    let wide: serde_json::Map<_, _> = crate::spec::parameters::leaves()
        .into_iter()
        .map(|(pointer, _)| (pointer, json!((0..100).collect::<Vec<_>>())))
        .collect();
    assert_eq!(places(&json!({ "design": "grid", "values": wide })), ["/values"], "the product is beyond 64 bits");
    let uneven = json!({ "design": "zip", "values": { "/friction": [0.1, 0.2], "/steps": [100], "/z": [1, 2, 3] } });
    assert_eq!(places(&uneven), ["/values/~1steps", "/values/~1z"]);
}

#[test]
fn faults_of_points_lead_back_to_their_values() {
    let vary = json!({ "design": "grid", "values": {
        "/collision/gap_um": [30, -3], "/friction": { "from": 0.1, "to": 0.2, "count": 2 } } });
    let study = Study::read(&vary, 100).unwrap();
    let faults = ModelSpec::resolve_all(preset("pig").unwrap(), &[&json!({}), &study.patch(2)]).unwrap_err();
    assert_eq!(faults[0].pointer, "/collision/gap_um");
    assert_eq!(study.place(2, &faults[0].pointer).as_deref(), Some("/values/~1collision~1gap_um/1"));
    assert_eq!(study.place(2, "/friction/keys/0").as_deref(), Some("/values/~1friction"));
    assert_eq!(study.place(2, "/frictions"), None);
}

#[test]
fn a_point_is_applied_after_the_common_spec() {
    let vary = json!({ "design": "grid", "values": { "/friction/fluctuation/amplitude": [0.1, null] } });
    let study = Study::read(&vary, 100).unwrap();
    let common =
        json!({ "friction": { "keys": [[0, 0.5], [1, 0.6]], "fluctuation": { "amplitude": 0.01, "period": 100 } } });
    let amplitude = |point: usize| {
        let spec = ModelSpec::resolve_all(preset("pig").unwrap(), &[&common, &study.patch(point)]).unwrap();
        spec.friction.fluctuation.unwrap().amplitude
    };
    assert_eq!((amplitude(0), amplitude(1)), (0.1, 0.01));
}

#[test]
fn the_schema_names_the_members_that_are_read() {
    let schema = schema(100);
    let mut named: Vec<&str> = schema["properties"].as_object().unwrap().keys().map(String::as_str).collect();
    named.sort_unstable();
    assert_eq!(named, MEMBERS);
    for example in schema["examples"].as_array().unwrap() {
        assert!(jsonschema::is_valid(&schema, example));
        let study = Study::read(example, 100).unwrap();
        for point in 0..study.points() {
            ModelSpec::resolve_all(preset("pig").unwrap(), &[&study.patch(point)]).unwrap();
        }
    }
    let wrong = json!({ "design": "grid", "values": { "/steps": { "from": 1 } } });
    assert!(!jsonschema::is_valid(&schema, &wrong));
}
