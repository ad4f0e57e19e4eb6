//! Properties of resolving: it never panics, every fault has a pointer, and its result resolves to
//! itself.

use super::super::bounds::Range;
use super::super::table::Kind;
use super::*;
use proptest::prelude::*;

/// Any JSON value.
fn any_json() -> impl Strategy<Value = Value> {
    let leaf = prop_oneof![
        Just(Value::Null),
        any::<bool>().prop_map(Value::from),
        any::<f64>().prop_map(Value::from),
        any::<i64>().prop_map(Value::from),
        (-2.0..3.0).prop_map(Value::from),
        "[a-z/~]{0,6}".prop_map(Value::from),
        Just(json!("linear")),
    ];
    let name = prop_oneof![
        prop::sample::select(vec!["keys", "ease", "fluctuation", "amplitude", "period"]).prop_map(String::from),
        "[a-z/~]{0,5}"
    ];
    leaf.prop_recursive(4, 24, 4, move |inner| {
        prop_oneof![
            prop::collection::vec(inner.clone(), 0..4).prop_map(Value::from),
            prop::collection::vec((name.clone(), inner), 0..4).prop_map(|m| Value::Object(m.into_iter().collect())),
        ]
    })
}

/// A value within the bounds of a parameter, but not always consistent with other parameters.
fn within(kind: &Kind, draw: [f64; 4], form: u32) -> Value {
    let on = |range: &Range, x: f64| range.min + (range.max - range.min) * x;
    match kind {
        Kind::Schedule(range) => {
            let v: Vec<f64> = draw.iter().map(|x| on(range, *x)).collect();
            let ease = if form.is_multiple_of(2) { "smooth" } else { "linear" };
            let (low, high) = (v[0].min(v[1]), v[0].max(v[1]));
            let room = (low - range.min).min(range.max - high) * 0.99;
            match form % 4 {
                0 | 1 => json!(v[0]),
                2 => json!({ "keys": [[0, v[0]], [draw[3].clamp(0.01, 0.99), v[1]], [1, v[2]]], "ease": ease }),
                _ => json!({
                    "keys": [[0, v[0]], [1, v[1]]], "ease": ease,
                    "fluctuation": { "amplitude": room * draw[2], "period": 2.0 + 1e3 * draw[3] },
                }),
            }
        }
        Kind::Number(range) => json!(on(range, draw[0])),
        Kind::Integer(count) => {
            json!((f64::from(count.min) + f64::from(count.max - count.min) * draw[0] * draw[1]).round())
        }
        Kind::Choice(names) => json!(names[form as usize % names.len()].0),
        Kind::Bool => json!(form.is_multiple_of(2)),
        Kind::Points(coordinates, range) => json!(
            (0..form % 4)
                .map(|i| draw.map(|x| on(range, x)).map(|x| x / f64::from(i + 1))[..*coordinates].to_vec())
                .collect::<Vec<_>>()
        ),
        Kind::Grid(range) => {
            let side = [0, 2, 3][form as usize % 3];
            json!(draw[..side].iter().map(|x| vec![on(range, *x); side]).collect::<Vec<_>>())
        }
        Kind::Group(_) => json!({}),
    }
}

/// Sets the value at a pointer of a patch and creates the objects on the way.
fn put(patch: &mut Value, pointer: &str, value: Value) {
    let mut at = patch;
    for name in pointer.split('/').skip(1) {
        let members = at.as_object_mut().unwrap();
        at = members.entry(name).or_insert_with(|| Value::Object(Map::new()));
    }
    *at = value;
}

fn draws() -> impl Strategy<Value = Vec<(usize, [f64; 4], u32)>> {
    prop::collection::vec((0..leaves().len(), prop::array::uniform4(0.0..=1.0_f64), any::<u32>()), 0..6)
}

proptest! {
    #[test]
    fn any_patch_gives_a_spec_or_faults_that_name_a_place(
        whole in any_json(), parts in prop::collection::vec((0..leaves().len(), any_json()), 1..5),
    ) {
        let mut patch = json!({});
        for (i, value) in parts {
            put(&mut patch, &leaves()[i].0, value);
        }
        for patch in [whole, patch] {
            match resolve(&patch) {
                Ok(spec) => prop_assert_eq!(resolve(&spec.to_json()), Ok(spec)),
                Err(faults) => {
                    prop_assert!(!faults.is_empty());
                    for fault in faults {
                        prop_assert!(fault.pointer.is_empty() || fault.pointer.starts_with('/'), "{}", fault);
                        prop_assert!(!fault.detail.is_empty());
                    }
                }
            }
        }
    }

    #[test]
    fn a_canonical_spec_resolves_to_itself_on_any_preset(draws in draws()) {
        let mut patch = json!({});
        for (i, draw, form) in draws {
            let (pointer, field) = &leaves()[i];
            put(&mut patch, pointer, within(&field.kind, draw, form));
        }
        match resolve(&patch) {
            Ok(spec) => {
                let json = spec.to_json();
                for preset in presets() {
                    let again = ModelSpec::resolve(preset, &json).unwrap();
                    prop_assert_eq!(&again, &spec);
                    prop_assert_eq!(again.digest(1), spec.digest(1));
                    prop_assert_eq!(canonical_json(&again.to_json()), canonical_json(&json));
                }
                let text = serde_json::from_str::<Value>(&canonical_json(&json)).unwrap();
                prop_assert_eq!(resolve(&text), Ok(spec));
            }
            // Each value is within its bounds, so only rules between parameters can be violated.
            Err(faults) => {
                for fault in faults {
                    prop_assert!(!fault.detail.contains("allowed"), "{}", fault);
                }
            }
        }
    }
}
