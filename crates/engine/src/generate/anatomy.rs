//! Comparison of a model with published anatomy: values, and the statements of the checklist.

use super::types::Request;
use crate::measure::checklist::{Checklist, Judged, judge};
use crate::measure::comparison::{Comparison, compare};
use crate::measure::morphometry::Morphometry;
use crate::spec::{Preset, preset};
use serde_json::Value;
use std::collections::BTreeMap;

/// Compares the measures with anatomy of the organ and species of the preset; `None` if the preset
/// is not known.
pub(super) fn compared(request: &Request, morphometry: &Morphometry) -> Option<(Comparison, Option<Checklist>)> {
    let of = preset(&request.preset)?;
    let shortened = of.shortened.as_deref();
    let own = request.spec.to_json();
    let checklist = judge(&Judged {
        morphometry,
        organ: &of.organ,
        species: &of.species,
        preset: &of.name,
        length_mm: request.spec.length_mm,
        shortened,
        tube: &coil(&own),
        parameter: &|name, pointer| number(parameters(name, &own, of)?.pointer(pointer)?),
    });
    Some((compare(morphometry, &of.organ, &of.species, shortened), checklist))
}

/// Measures of a coil whose turns the specification lists, from the isthmus end. The first number of
/// a turn is its place as a part of the length.
fn coil(spec: &Value) -> BTreeMap<&'static str, f64> {
    let course = &spec["course"];
    let turns = course["turns"].as_array().filter(|turns| course["shape"] == "turns" && turns.len() > 2);
    let places: Vec<f64> = turns.into_iter().flatten().filter_map(|turn| turn[0].as_f64()).collect();
    let [from, to] = ["junction_from", "junction_to"].map(|name| spec["regions"][name].as_f64().unwrap_or(f64::NAN));
    if places.is_empty() {
        return BTreeMap::new();
    }
    // A turn in the junction is the border, so half of it belongs to the ampulla.
    let in_ampulla = |&at: &f64| if at > to { 1.0 } else { f64::from(u8::from(at >= from)) / 2.0 };
    let lengths: Vec<f64> = places.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let mean = lengths.iter().sum::<f64>() / lengths.len() as f64;
    let variance = lengths.iter().map(|length| (length - mean).powi(2)).sum::<f64>() / lengths.len() as f64;
    BTreeMap::from([
        ("coil_turns", places.len() as f64),
        ("ampulla_turns", places.iter().map(in_ampulla).sum()),
        ("coil_turn_cv", variance.sqrt() / mean),
    ])
}

/// Specification of a preset, or that of the model if it is based on this preset.
fn parameters<'a>(name: Option<&str>, own: &'a Value, of: &Preset) -> Option<&'a Value> {
    match name {
        Some(name) if name != of.name => preset(name).map(|other| &other.spec),
        _ => Some(own),
    }
}

/// A number, or the mean of a schedule over the steps. Both kinds of ease are symmetric, so the
/// mean between two keys is that of their values.
fn number(value: &Value) -> Option<f64> {
    let Some(keys) = value.get("keys").and_then(Value::as_array) else { return value.as_f64() };
    let keys: Vec<[f64; 2]> =
        keys.iter().map(|key| Some([key[0].as_f64()?, key[1].as_f64()?])).collect::<Option<_>>()?;
    let means = keys.windows(2).map(|pair| (pair[1][0] - pair[0][0]) * (pair[0][1] + pair[1][1]) / 2.0);
    Some(means.sum())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::{Backend, Outputs};
    use crate::measure::checklist::Judgement;
    use crate::measure::comparison::Verdict;
    use crate::measure::morphometry::Tube;
    use crate::spec::ModelSpec;
    use serde_json::json;

    fn request(name: &str, patch: &Value) -> Request {
        Request {
            preset: name.into(),
            spec: ModelSpec::resolve(preset(name).unwrap(), patch).unwrap(),
            seed: 1,
            backend: Backend::Cpu,
            outputs: Outputs::default(),
            dir: std::path::PathBuf::new(),
            memory_limit_bytes: None,
        }
    }

    fn length(length_mm: f64) -> Morphometry {
        Morphometry { tube: Tube { length_mm, ..Tube::default() }, ..Morphometry::default() }
    }

    fn verdict(name: &str, patch: &Value, length_mm: f64, number: u32) -> Option<(Judgement, Option<String>)> {
        let (_, checklist) = compared(&request(name, patch), &length(length_mm)).unwrap();
        let found = checklist.unwrap().statements.into_iter().find(|one| one.number == number)?;
        let reason = found.conditions.iter().find_map(|one| one.reason.clone());
        Some((found.verdict, reason))
    }

    #[test]
    fn a_shortened_preset_is_no_deviation_but_fails_its_statement() {
        let (comparison, _) = compared(&request("pig", &json!({})), &length(60.0)).unwrap();
        let lengths: Vec<Verdict> =
            comparison.compared.iter().filter(|c| c.quantity == "length_mm").map(|c| c.verdict).collect();
        assert!(lengths.len() >= 3 && lengths.iter().all(|v| *v == Verdict::Shortened), "{lengths:?}");
        let (found, reason) = verdict("pig", &json!({}), 60.0, 28).unwrap();
        assert_eq!(found, Judgement::Fails);
        assert!(reason.unwrap().starts_with("Shortened by choice: The preset has 60 mm"));
        assert_eq!(verdict("pig", &json!({ "length_mm": 302 }), 302.0, 28), Some((Judgement::Holds, None)));
        assert_eq!(verdict("human", &json!({}), 40.0, 28), Some((Judgement::Fails, None)));
    }

    #[test]
    fn the_place_of_the_junction_is_that_of_the_specification() {
        assert_eq!(verdict("pig", &json!({}), 60.0, 21), Some((Judgement::Holds, None)));
        let late = json!({ "regions": { "junction_from": 0.5, "junction_to": 0.6 } });
        assert_eq!(verdict("pig", &late, 60.0, 21), Some((Judgement::Fails, None)));
        assert_eq!(verdict("mouse", &json!({}), 18.0, 21), None);
    }

    #[test]
    fn stages_of_the_cycle_are_compared_with_their_counterparts() {
        // The length of the model itself counts, whatever its preset has.
        let condition = |name: &str, patch: &Value| -> f64 {
            let (_, checklist) = compared(&request(name, patch), &Morphometry::default()).unwrap();
            let found = checklist.unwrap().statements.into_iter().find(|one| one.number == 30).unwrap();
            found.conditions[0].measured.unwrap()
        };
        let own = |name: &str| preset(name).unwrap().spec["length_mm"].as_f64().unwrap();
        assert_eq!(condition("cow-luteal", &json!({ "length_mm": 100 })), 100.0 / own("cow"));
        assert_eq!(condition("cow", &json!({ "length_mm": 100 })), own("cow-luteal") / 100.0);
        let (_, paper) = compared(&request("paper", &json!({})), &Morphometry::default()).unwrap();
        assert!(paper.unwrap().statements.iter().all(|one| one.number != 30), "no stage of the cycle");
    }

    #[test]
    fn a_coil_has_the_turns_of_its_specification() {
        let spec = |shape: &str| {
            let turns = [0.1, 0.3, 0.4, 0.65, 0.75, 0.95].map(|at| json!([at, 180, 0, 0.05]));
            json!({
                "course": { "shape": shape, "turns": turns },
                "regions": { "junction_from": 0.6, "junction_to": 0.7 },
            })
        };
        let found = coil(&spec("turns"));
        assert_eq!((found["coil_turns"], found["ampulla_turns"]), (6.0, 2.5));
        // Distances of 0.2, 0.1, 0.25, 0.1 and 0.2: mean 0.17, variance 0.0036.
        assert!((found["coil_turn_cv"] - 0.06 / 0.17).abs() < 1e-9, "{found:?}");
        assert!(coil(&spec("points")).is_empty());
        assert!(coil(&request("mouse", &json!({ "course": { "shape": "straight" } })).spec.to_json()).is_empty());
    }

    #[test]
    fn the_number_of_a_schedule_is_its_mean() {
        assert_eq!(number(&json!(3.5)), Some(3.5));
        assert_eq!(number(&json!({ "keys": [[0, 2], [0.5, 4], [1, 4]], "ease": "smooth" })), Some(3.5));
        assert_eq!(number(&json!("straight")), None);
        assert_eq!(number(&json!({ "keys": "none" })), None);
    }

    #[test]
    fn organs_without_statements_have_no_checklist() {
        let (_, none) = compared(&request("colon", &json!({})), &Morphometry::default()).unwrap();
        assert_eq!(none, None);
        let (_, end) = compared(&request("infundibulum", &json!({})), &Morphometry::default()).unwrap();
        let numbers: Vec<u32> = end.unwrap().statements.iter().map(|one| one.number).collect();
        assert_eq!(numbers, [4, 6]);
    }
}
