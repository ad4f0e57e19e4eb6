//! Random specifications: every accepted one must end with a certificate, and moderate changes must
//! be accepted.

use super::*;
use crate::random::{self, Stream};
use crate::spec::{Fault, schema};
use rayon::prelude::*;
use serde_json::Value;

/// A number of the specification and its schema.
struct Leaf {
    pointer: String,
    bounds: [f64; 2],
    schedule: bool,
    integer: bool,
}

/// All numbers except `/z`, which must run from 0 to 1.
fn leaves() -> Vec<Leaf> {
    fn collect(schema: &Value, at: &str, found: &mut Vec<Leaf>) {
        for (name, described) in schema["properties"].as_object().unwrap() {
            let pointer = format!("{at}/{name}");
            let schedule = described["oneOf"].is_array();
            let number = if schedule { &described["oneOf"][0] } else { described };
            match number["type"].as_str() {
                Some("object") => collect(described, &pointer, found),
                Some(kind @ ("number" | "integer")) if pointer != "/z" => found.push(Leaf {
                    bounds: ["minimum", "maximum"].map(|bound| number[bound].as_f64().unwrap()),
                    integer: kind == "integer",
                    pointer,
                    schedule,
                }),
                _ => {}
            }
        }
    }
    let mut found = Vec::new();
    collect(&schema(), "", &mut found);
    found
}

/// Multiplies every number of a value by `factor` and clamps it to the bounds.
fn scaled(leaf: &Leaf, value: &Value, factor: f64) -> Value {
    let number = |value: &Value| {
        let number = (value.as_f64().unwrap() * factor).clamp(leaf.bounds[0], leaf.bounds[1]);
        if leaf.integer { number.round() } else { number }
    };
    let Some(members) = value.as_object() else { return json!(number(value)) };
    let keys: Vec<Value> =
        members["keys"].as_array().unwrap().iter().map(|key| json!([key[0], number(&key[1])])).collect();
    let mut schedule = members.clone();
    schedule.insert("keys".into(), keys.into());
    schedule.into()
}

fn put(patch: &mut Value, pointer: &str, value: Value) {
    let mut at = patch;
    for name in pointer.split('/').skip(1) {
        at = at.as_object_mut().unwrap().entry(name).or_insert_with(|| json!({}));
    }
    *at = value;
}

/// Random numbers in [0, 1) that depend only on `seed`.
fn numbers(seed: u64) -> impl FnMut() -> f64 {
    let mut index = 0;
    move || {
        index += 1;
        f64::from(random::unit(random::word(seed, Stream::Start, index, 0)))
    }
}

fn base(number: f64) -> &'static crate::spec::Preset {
    preset(if number < 0.5 { "pig" } else { "paper" }).unwrap()
}

/// A specification with each schedule of a preset scaled by 0.2–5 (log-uniform), values clamped to
/// the schema, at most 2,000 particles and 300 steps. Most are refused, because their values do not
/// fit together.
fn wild(seed: u64) -> Result<ModelSpec, Vec<Fault>> {
    let mut next = numbers(seed);
    let base = base(next());
    let mut patch = json!({});
    for leaf in leaves().iter().filter(|leaf| leaf.schedule) {
        let factor = 0.2 * 25f64.powf(next());
        let value = match leaf.pointer.as_str() {
            "/particles/total" => {
                let start = 100.0 + 900.0 * next();
                json!({ "keys": [[0, start.round()], [1, (start + (2000.0 - start) * next()).round()]], "ease": "linear" })
            }
            "/particles/outer" => scaled(leaf, &json!({ "keys": [[0, 60], [1, 90]] }), factor),
            pointer => scaled(leaf, base.spec.pointer(pointer).unwrap(), factor),
        };
        put(&mut patch, &leaf.pointer, value);
    }
    put(&mut patch, "/steps", json!((10.0 + 290.0 * next()).round()));
    put(&mut patch, "/burn_in", json!((100.0 * next()).round()));
    put(&mut patch, "/wall/lobes", json!((1.0 + 15.0 * next()).round()));
    put(&mut patch, "/solver/integrator", json!(if next() < 0.2 { "euler" } else { "rk4" }));
    if next() < 0.5 {
        put(&mut patch, "/outline/kind", json!("polygon"));
        put(&mut patch, "/outline/points", corners(&mut next));
        put(&mut patch, "/folds/depth", json!(0.7 * next()));
        put(&mut patch, "/folds/period_mm", json!(1000.0 * next()));
        put(&mut patch, "/folds/rows", json!((1.0 + 7.0 * next()).round()));
        put(&mut patch, "/folds/wall", json!(next()));
    }
    ModelSpec::resolve(base, &patch)
}

/// Corners around the axis, at 0.4 to 1.9 R_in from it.
fn corners(next: &mut impl FnMut() -> f64) -> Value {
    let count = (5.0 + 20.0 * next()).round();
    let mut corner = |i: u32| {
        let angle = std::f64::consts::TAU * (f64::from(i) + 0.8 * next()) / count;
        let radius = 0.4 + 1.5 * next();
        json!([radius * angle.cos(), radius * angle.sin()])
    };
    (0..count as u32).map(&mut corner).collect()
}

/// Generates all specifications with their seeds; none may fail.
fn all_certify(accepted: &[(u64, ModelSpec)]) {
    let failed: Vec<String> = accepted
        .par_iter()
        .filter_map(|(seed, spec)| {
            let dir = tempfile::tempdir().unwrap();
            let mut request = request(spec.clone(), Backend::Cpu, dir.path());
            (request.seed, request.outputs) = (*seed, Vec::new().into());
            generate(&request, &(), &CancelToken::default()).err().map(|error| format!("{seed}: {error}"))
        })
        .collect();
    assert!(failed.is_empty(), "{failed:#?}");
}

/// `OVIDUCT_TEST_SPECS=1000 cargo test --release --lib random_specifications` tests 1,000
/// specifications in two minutes on two cores.
#[test]
fn random_specifications_that_are_accepted_certify() {
    let wanted = std::env::var("OVIDUCT_TEST_SPECS").map_or(50, |count| count.parse().unwrap());
    let drawn = 8 * wanted as u64;
    let accepted: Vec<_> = (0..drawn).filter_map(|seed| Some((seed, wild(seed).ok()?))).take(wanted).collect();
    assert_eq!(accepted.len(), wanted, "so many of {drawn} are accepted");
    let shaped = accepted.iter().filter(|(_, spec)| !spec.is_elliptic()).count();
    assert!(4 * shaped > wanted, "{shaped} of {wanted} have another outline");
    all_certify(&accepted);
}

#[test]
fn moderate_changes_of_one_or_two_parameters_are_accepted() {
    let leaves = leaves();
    let refused: Vec<String> = (0..1000)
        .filter_map(|seed| {
            let mut next = numbers(seed);
            let base = base(next());
            let mut patch = json!({});
            for _ in 0..if next() < 0.5 { 1 } else { 2 } {
                let leaf = &leaves[(next() * leaves.len() as f64) as usize];
                let value = scaled(leaf, base.spec.pointer(&leaf.pointer).unwrap(), 0.5 * 4f64.powf(next()));
                put(&mut patch, &leaf.pointer, value);
            }
            ModelSpec::resolve(base, &patch).err().map(|faults| format!("{patch}: {}", faults[0]))
        })
        .collect();
    assert!(refused.len() <= 100, "{} of 1,000 are refused: {refused:#?}", refused.len());
}
