//! Bodies of requests: from JSON to a [`ModelRequest`], with all faults in one response.
//!
//! The schema of a request is beside its checks; a test compares the two.

use crate::generate::{Backend, Output, Outputs};
use crate::http::wire::faults::{Fault, Faults};
use crate::jobs::Priority;
use crate::model::{BodyKind, LengthUnit};
use crate::spec::DEFAULT_PRESET;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;

/// Greatest seed: 2^53 − 1, the greatest integer that all JSON readers represent exactly.
pub const SEED_MAX: u64 = (1 << 53) - 1;
/// Most members of `outputs` and of `bodies`: more than there are formats, so that each invalid one of a short list is named.
const OUTPUTS_MAX: usize = 16;
/// Most labels of a model.
pub(super) const LABELS_MAX: usize = 16;
/// Longest key of a label, in characters.
pub(super) const LABEL_KEY_MAX: usize = 64;
/// Longest value of a label, in characters.
pub(super) const LABEL_VALUE_MAX: usize = 256;

const MEMBERS: [&str; 10] =
    ["preset", "seed", "spec", "outputs", "bodies", "units", "backend", "labels", "priority", "reuse"];

/// A request whose members are well formed. The spec is checked later, by resolving it on the preset.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::http) struct ModelRequest {
    pub(in crate::http) preset: String,
    pub(in crate::http) seed: Option<u64>,
    pub(in crate::http) spec: Value,
    pub(in crate::http) outputs: Outputs,
    pub(in crate::http) backend: Backend,
    pub(in crate::http) labels: BTreeMap<String, String>,
    pub(in crate::http) priority: Priority,
    pub(in crate::http) reuse: bool,
}

impl ModelRequest {
    /// Reads a body. Adds faults to `faults`, and replaces invalid members by their defaults.
    pub(in crate::http) fn read(body: &Value, faults: &mut Faults) -> Self {
        Self::read_members(body, &MEMBERS, faults)
    }

    /// Reads a body that may have the members in `known`.
    pub(in crate::http) fn read_members(body: &Value, known: &[&str], faults: &mut Faults) -> Self {
        let empty = Map::new();
        let members = body.as_object().unwrap_or_else(|| {
            faults.push(Fault::at("", format!("must be an object, not {}", describe(body))));
            &empty
        });
        for name in members.keys().filter(|name| !known.contains(&name.as_str())) {
            let detail = format!("is unknown; the members are {}", known.join(", "));
            faults.push(Fault::at(format!("/{}", escape(name)), detail));
        }
        Self {
            preset: members.get("preset").map_or_else(|| DEFAULT_PRESET.to_owned(), |v| text(v, "/preset", faults)),
            seed: members.get("seed").filter(|_| known.contains(&"seed")).and_then(|v| seed(v, "/seed", faults)),
            spec: members.get("spec").map_or_else(|| json!({}), |v| spec(v, faults)),
            outputs: outputs(members, faults),
            backend: members
                .get("backend")
                .map_or(Backend::Auto, |v| choice(v, "/backend", faults).unwrap_or_default()),
            labels: members.get("labels").map_or_else(BTreeMap::new, |v| labels(v, faults)),
            priority: members.get("priority").map_or_else(Priority::default, |v| priority(v, faults)),
            reuse: members.get("reuse").is_none_or(|v| flag(v, "/reuse", faults)),
        }
    }

    /// JSON Schema of a request; `spec` refers to the component `SpecPatch`.
    pub(in crate::http) fn schema() -> Value {
        json!({
            "type": "object",
            "description": "What to grow. All members are optional: `{}` requests the default preset with a random seed.",
            "additionalProperties": false,
            "properties": {
                "preset": { "type": "string", "default": DEFAULT_PRESET, "description": "Name of a preset; see `GET /presets`." },
                "seed": { "type": "integer", "format": "int64", "minimum": 0, "maximum": SEED_MAX,
                    "description": "The same seed and spec give the same model. If it is absent, the service draws one and reports it." },
                "spec": { "$ref": "#/components/schemas/SpecPatch" },
                "outputs": { "type": "array", "uniqueItems": true, "items": { "$ref": "#/components/schemas/Output" },
                    "default": Output::DEFAULT, "description": "File formats. `sections.bin` and `report.json` are always written." },
                "bodies": { "type": "array", "uniqueItems": true, "minItems": 1,
                    "items": { "$ref": "#/components/schemas/Body" }, "default": [BodyKind::Tissue],
                    "description": "The bodies whose surfaces are written in each format that holds one: `tissue` as `model.*`, `lumen` as `lumen.*`, `regions` (both, with their common wall once) as `regions.*`." },
                "units": { "anyOf": [{ "$ref": "#/components/schemas/LengthUnit" }, { "type": "null" }],
                    "description": "Unit of coordinates in `obj`, `stl`, `stl-ascii`, `ply`, `vtp` and `centreline`. By default `obj` is in metres and the others in millimetres. glTF is always in metres." },
                "backend": { "$ref": "#/components/schemas/Backend" },
                "labels": { "type": "object", "maxProperties": LABELS_MAX,
                    "description": "Names and values of the client's own, to find models by.",
                    "propertyNames": { "minLength": 1, "maxLength": LABEL_KEY_MAX, "pattern": "^[^:\\u0000]+$" },
                    "additionalProperties": { "type": "string", "maxLength": LABEL_VALUE_MAX, "pattern": "^[^\\u0000]*$" } },
                "priority": { "type": "integer", "minimum": Priority::MIN, "maximum": Priority::MAX, "default": 0,
                    "description": "Of the queued models, those of higher priority are started first." },
                "reuse": { "type": "boolean", "default": true,
                    "description": "Whether a model with the same digest may be reused instead of growing it again: a finished one at once, one that is queued or running when it ends." }
            },
        })
    }
}

fn text(value: &Value, pointer: &str, faults: &mut Faults) -> String {
    value.as_str().map_or_else(
        || {
            faults.push(Fault::at(pointer, format!("must be a string, not {}", describe(value))));
            String::new()
        },
        str::to_owned,
    )
}

fn flag(value: &Value, pointer: &str, faults: &mut Faults) -> bool {
    value.as_bool().unwrap_or_else(|| {
        faults.push(Fault::at(pointer, format!("must be true or false, not {}", describe(value))));
        true
    })
}

pub(in crate::http) fn seed(value: &Value, pointer: &str, faults: &mut Faults) -> Option<u64> {
    let whole = value.as_u64().or_else(|| {
        // 62.0 is an integer in JSON.
        value.as_f64().filter(|x| x.fract() == 0.0 && (0.0..=SEED_MAX as f64).contains(x)).map(|x| x as u64)
    });
    let seed = whole.filter(|&s| s <= SEED_MAX);
    if seed.is_none() {
        faults.push(Fault::at(pointer, format!("must be an integer from 0 to {SEED_MAX}, not {}", describe(value))));
    }
    seed
}

pub(in crate::http) fn priority(value: &Value, faults: &mut Faults) -> Priority {
    #[expect(clippy::cast_possible_truncation, reason = "saturating, and then out of range")]
    let whole = value.as_i64().or_else(|| value.as_f64().filter(|x| x.fract() == 0.0).map(|x| x as i64));
    whole.and_then(|n| Priority::try_from(n).ok()).unwrap_or_else(|| {
        let (min, max) = (Priority::MIN, Priority::MAX);
        faults.push(Fault::at("/priority", format!("must be an integer from {min} to {max}, not {}", describe(value))));
        Priority::default()
    })
}

fn spec(value: &Value, faults: &mut Faults) -> Value {
    if value.is_object() {
        return value.clone();
    }
    faults.push(Fault::at("/spec", format!("must be an object, not {}", describe(value))));
    json!({})
}

fn choice<T: DeserializeOwned>(value: &Value, pointer: &str, faults: &mut Faults) -> Option<T> {
    let Some(name) = value.as_str() else {
        faults.push(Fault::at(pointer, format!("must be a string, not {}", describe(value))));
        return None;
    };
    // The message of serde lists the valid ones: "unknown variant `x`, expected one of …". No name is longer than 40.
    let name: String = name.chars().take(41).collect();
    serde_json::from_value(name.into()).map_err(|e| faults.push(Fault::at(pointer, e.to_string()))).ok()
}

fn outputs(members: &Map<String, Value>, faults: &mut Faults) -> Outputs {
    let default = Outputs::default();
    let bodies = members.get("bodies").map_or(default.bodies, |value| {
        if value.as_array().is_some_and(Vec::is_empty) {
            faults.push(Fault::at("/bodies", "must name at least one body"));
        }
        distinct::<BodyKind>(value, "/bodies", faults)
    });
    Outputs {
        formats: members.get("outputs").map_or(default.formats, |value| distinct::<Output>(value, "/outputs", faults)),
        bodies,
        units: (members.get("units").filter(|value| !value.is_null()))
            .and_then(|value| choice::<LengthUnit>(value, "/units", faults)),
    }
}

/// A list of different names.
fn distinct<T: DeserializeOwned + PartialEq>(value: &Value, pointer: &str, faults: &mut Faults) -> Vec<T> {
    let Some(items) = value.as_array() else {
        faults.push(Fault::at(pointer, format!("must be an array, not {}", describe(value))));
        return Vec::new();
    };
    if items.len() > OUTPUTS_MAX {
        faults.push(Fault::at(pointer, format!("may have at most {OUTPUTS_MAX} members, not {}", items.len())));
        return Vec::new();
    }
    let mut found = Vec::new();
    for (i, item) in items.iter().enumerate() {
        let pointer = format!("{pointer}/{i}");
        match choice(item, &pointer, faults) {
            Some(item) if found.contains(&item) => faults.push(Fault::at(pointer, "is given more than once")),
            Some(item) => found.push(item),
            None => {}
        }
    }
    found
}

pub(in crate::http) fn labels(value: &Value, faults: &mut Faults) -> BTreeMap<String, String> {
    let Some(members) = value.as_object() else {
        faults.push(Fault::at("/labels", format!("must be an object, not {}", describe(value))));
        return BTreeMap::new();
    };
    if members.len() > LABELS_MAX {
        faults.push(Fault::at("/labels", format!("may have at most {LABELS_MAX} members, not {}", members.len())));
    }
    let mut labels = BTreeMap::new();
    for (key, value) in members {
        let pointer = format!("/labels/{}", escape(key));
        let length = key.chars().count();
        if !(1..=LABEL_KEY_MAX).contains(&length) || key.contains([':', '\0']) {
            let detail = format!("the key must have 1 to {LABEL_KEY_MAX} characters, none of them a colon or NUL");
            faults.push(Fault::at(&pointer, detail));
        }
        match value.as_str() {
            Some(text) if text.chars().count() <= LABEL_VALUE_MAX && !text.contains('\0') => {
                labels.insert(key.clone(), text.to_owned());
            }
            Some(_) => {
                let detail = format!("may have at most {LABEL_VALUE_MAX} characters, none of them NUL");
                faults.push(Fault::at(pointer, detail));
            }
            None => faults.push(Fault::at(pointer, format!("must be a string, not {}", describe(value)))),
        }
    }
    labels
}

/// A member name as part of a JSON pointer, cut after 100 characters.
pub(in crate::http) fn escape(name: &str) -> String {
    let name: String = name.chars().take(100).collect();
    name.replace('~', "~0").replace('/', "~1")
}

/// A short description of a value.
pub(in crate::http) fn describe(value: &Value) -> String {
    match value {
        Value::Null => "null".into(),
        Value::Bool(b) => b.to_string(),
        Value::Number(n) => n.to_string(),
        Value::String(s) if s.chars().count() <= 40 => Value::from(s.as_str()).to_string(),
        Value::String(_) => "a long string".into(),
        Value::Array(_) => "an array".into(),
        Value::Object(_) => "an object".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(body: &Value) -> Result<ModelRequest, Vec<String>> {
        let mut faults = Faults::default();
        let request = ModelRequest::read(body, &mut faults);
        if faults.is_empty() {
            Ok(request)
        } else {
            Err(faults.into_parts().0.into_iter().filter_map(|f| f.pointer).collect())
        }
    }

    #[test]
    fn a_long_name_is_not_repeated_in_full() {
        let mut faults = Faults::default();
        ModelRequest::read(&json!({ "backend": "b".repeat(100_000) }), &mut faults);
        let (kept, _) = faults.into_parts();
        assert!(kept[0].detail.contains("cpu-single") && kept[0].detail.len() < 200, "{}", kept[0].detail);
    }

    #[test]
    fn an_empty_request_takes_the_defaults() {
        let request = read(&json!({})).unwrap();
        assert_eq!(request.preset, DEFAULT_PRESET);
        assert_eq!(
            (request.seed, request.outputs, request.backend, request.reuse),
            (None, Outputs::default(), Backend::Auto, true)
        );
    }

    #[test]
    fn whole_numbers_are_integers() {
        for (value, seed) in [
            (json!(62.0), 62),
            (json!(0), 0),
            (json!(SEED_MAX), SEED_MAX),
            (json!(-0.0), 0),
            (json!(1e15), 1_000_000_000_000_000),
        ] {
            assert_eq!(read(&json!({"seed": value})).unwrap().seed, Some(seed));
        }
        for value in
            [json!(SEED_MAX + 1), json!(-1), json!(1.5), json!("7"), json!(null), json!(1e300), json!(true), json!([7])]
        {
            assert_eq!(read(&json!({"seed": value})).unwrap_err(), ["/seed"]);
        }
    }

    #[test]
    fn a_priority_is_a_small_integer() {
        assert_eq!(read(&json!({})).unwrap().priority.get(), 0);
        for (value, priority) in
            [(json!(-100), -100), (json!(100), 100), (json!(7.0), 7), (json!(-0.0), 0), (json!(-3e0), -3)]
        {
            assert_eq!(read(&json!({"priority": value})).unwrap().priority.get(), priority);
        }
        for value in [json!(101), json!(-101), json!(0.5), json!("7"), json!(null), json!(1e300), json!(u64::MAX)] {
            assert_eq!(read(&json!({"priority": value})).unwrap_err(), ["/priority"]);
        }
    }

    #[test]
    fn all_faults_come_at_once() {
        let body = json!({
            "preset": 1, "seed": -1, "spec": [], "outputs": ["glb", "glb", "fbx", 3], "backend": "tpu",
            "labels": {"a": 1, "": "x", "b:c": "x", "d": "x".repeat(257)}, "priority": 1.5, "reuse": "no", "sede": 1, "a/b": 1
        });
        assert_eq!(
            read(&body).unwrap_err(),
            [
                "/a~1b",
                "/sede",
                "/preset",
                "/seed",
                "/spec",
                "/outputs/1",
                "/outputs/2",
                "/outputs/3",
                "/backend",
                "/labels/",
                "/labels/a",
                "/labels/b:c",
                "/labels/d",
                "/priority",
                "/reuse"
            ]
        );
        for body in [json!(null), json!([]), json!("x"), json!(3)] {
            assert_eq!(read(&body).unwrap_err(), [""]);
        }
    }

    #[test]
    fn too_many_labels_are_refused() {
        let labels = |n: usize| json!({"labels": (0..n).map(|i| (i.to_string(), json!("x"))).collect::<Map<_, _>>()});
        assert_eq!(read(&labels(16)).unwrap().labels.len(), 16);
        assert_eq!(read(&labels(17)).unwrap_err(), ["/labels"]);
    }

    #[test]
    fn bodies_and_units_are_read_and_faults_named() {
        let outputs =
            read(&json!({ "outputs": ["stl"], "bodies": ["lumen", "tissue"], "units": "um" })).unwrap().outputs;
        let bodies = vec![BodyKind::Lumen, BodyKind::Tissue];
        assert_eq!(outputs, Outputs { formats: vec![Output::Stl], bodies, units: Some(LengthUnit::Micrometre) });
        assert_eq!(read(&json!({ "units": null })).unwrap().outputs, Outputs::default());
        let wrong = json!({ "bodies": ["lumen", "lumen", "air", 3], "units": "inch" });
        assert_eq!(read(&wrong).unwrap_err(), ["/bodies/1", "/bodies/2", "/bodies/3", "/units"]);
        for (bodies, places) in [(json!([]), ["/bodies"]), (json!("lumen"), ["/bodies"])] {
            assert_eq!(read(&json!({ "bodies": bodies })).unwrap_err(), places);
        }
        assert_eq!(read(&json!({ "units": 3 })).unwrap_err(), ["/units"]);
    }

    #[test]
    fn too_many_outputs_are_refused_as_one() {
        assert_eq!(read(&json!({"outputs": vec![1; 16]})).unwrap_err().len(), 16);
        assert_eq!(read(&json!({"outputs": vec![1; 17]})).unwrap_err(), ["/outputs"]);
    }

    #[test]
    fn the_schema_names_the_members_that_are_read() {
        let mut named: Vec<_> = ModelRequest::schema()["properties"].as_object().unwrap().keys().cloned().collect();
        let mut members = MEMBERS;
        named.sort();
        members.sort_unstable();
        assert_eq!(named, members);
    }
}
