//! Fuzz target: merge patches on each preset, compared with RFC 7396 as the crate `json-patch`
//! implements it.

use super::{Fault, ModelSpec, canonical_json, presets};
use serde_json::{Value, json};

/// Asserts that a patch results in faults, or in the specification of RFC 7396 with the two
/// differences of `merge.rs`, and passes each specification to `accepted`.
pub fn patch(bytes: &[u8], accepted: impl Fn(&ModelSpec)) {
    let Ok(patch) = serde_json::from_slice::<Value>(bytes) else { return };
    for preset in presets() {
        let (mut whole, mut without_nulls) = (preset.spec.clone(), patch.clone());
        if !patch.is_null() {
            adapt(&mut whole, &mut without_nulls);
            json_patch::merge(&mut whole, &without_nulls);
        }
        let expected = ModelSpec::from_json(&whole);
        match ModelSpec::resolve(preset, &patch) {
            Ok(spec) => {
                assert_eq!(expected.as_ref(), Ok(&spec), "RFC 7396 gives another result");
                settled(&spec);
                accepted(&spec);
            }
            Err(faults) => {
                named(&faults);
                // A null for an unknown member is a fault here, but RFC 7396 ignores it.
                assert!(expected.is_err() || patch != without_nulls, "RFC 7396 gives a valid result: {faults:?}");
            }
        }
    }
}

/// Applies the two differences of `merge.rs` in advance: removes nulls from the patch, and replaces
/// each number of the base for which the patch has an object by a schedule.
fn adapt(base: &mut Value, patch: &mut Value) {
    let Value::Object(members) = patch else { return };
    members.retain(|_, value| !value.is_null());
    if base.is_number() {
        *base = json!({ "keys": [[0, base], [1, base]] });
    }
    let mut none = Value::Null;
    for (name, value) in members {
        adapt(base.get_mut(name).unwrap_or(&mut none), value);
    }
}

/// Asserts that a specification resolves to itself on every preset, with the same digest.
fn settled(spec: &ModelSpec) {
    let json = spec.to_json();
    for preset in presets() {
        let again = ModelSpec::resolve(preset, &json);
        assert_eq!(again.as_ref(), Ok(spec), "a resolved specification does not resolve to itself");
        assert_eq!(again.map(|again| again.digest(1)), Ok(spec.digest(1)));
    }
    let text = canonical_json(&json);
    assert_eq!(serde_json::from_str::<Value>(&text).map(|value| canonical_json(&value)).ok(), Some(text));
}

/// Asserts that each fault has a pointer and a short detail.
fn named(faults: &[Fault]) {
    assert!(!faults.is_empty());
    for Fault { pointer, detail } in faults {
        assert!(pointer.is_empty() || pointer.starts_with('/'), "{pointer}");
        assert!((1..=1000).contains(&detail.chars().count()), "{detail}");
    }
}
