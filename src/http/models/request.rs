//! Body of a request for a model: from JSON to a [`ModelRequest`], with all faults in one response.
//!
//! The schema of a request is next to its checks; a test compares the two.

use crate::generate::{Backend, Output, Outputs};
use crate::http::wire::faults::escape;
use crate::jobs::Priority;
use crate::model::{BodyKind, LengthUnit};
use crate::spec::{DEFAULT_PRESET, JsonReader, SEED_MAX};
use serde::de::DeserializeOwned;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;

/// Maximum length of `outputs` and of `bodies`. There are fewer formats, so in a short list each
/// invalid member is named.
const MAX_CHOICES: usize = 16;
/// Maximum number of labels of a model.
pub(super) const MAX_LABELS: usize = 16;
/// Maximum length of the key of a label, in characters.
const MAX_LABEL_KEY_CHARS: usize = 64;
/// Maximum length of the value of a label, in characters.
const MAX_LABEL_VALUE_CHARS: usize = 256;

const MEMBERS: [&str; 10] =
    ["preset", "seed", "spec", "outputs", "bodies", "units", "backend", "labels", "priority", "reuse"];

/// A request whose members are well formed. Resolving the spec on the preset checks it later.
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
    /// Reads a body. Invalid members get their defaults, so that the other members are checked,
    /// too.
    pub(in crate::http) fn read(reader: &mut JsonReader, body: &Value) -> Self {
        Self::read_members(reader, body, &MEMBERS)
    }

    /// Reads a body that may have the members `known`.
    pub(in crate::http) fn read_members(reader: &mut JsonReader, body: &Value, known: &[&str]) -> Self {
        let empty = Map::new();
        let members = reader.object("", body).unwrap_or(&empty);
        for name in members.keys().filter(|name| !known.contains(&name.as_str())) {
            let detail = format!("is unknown; the members are {}", known.join(", "));
            reader.fault::<()>(format!("/{}", escape(name)), detail);
        }
        let member = |name: &str| members.get(name);
        let preset = member("preset").map_or(DEFAULT_PRESET, |v| reader.text("/preset", v).unwrap_or_default());
        let seed = member("seed").filter(|_| known.contains(&"seed"));
        Self {
            preset: preset.to_owned(),
            seed: seed.and_then(|v| reader.integer("/seed", v, 0..=SEED_MAX)),
            spec: member("spec").and_then(|v| reader.object("/spec", v)).cloned().unwrap_or_default().into(),
            outputs: read_outputs(reader, members),
            backend: member("backend")
                .map_or(Backend::Auto, |v| read_choice(reader, "/backend", v).unwrap_or_default()),
            labels: member("labels").map_or_else(BTreeMap::new, |v| read_labels(reader, v)),
            priority: member("priority").and_then(|v| read_priority(reader, v)).unwrap_or_default(),
            reuse: member("reuse").and_then(|v| reader.flag("/reuse", v)).unwrap_or(true),
        }
    }

    /// JSON Schema of a request; `spec` refers to the component `SpecPatch`.
    pub(in crate::http) fn schema() -> Value {
        json!({
            "type": "object",
            "description": "Request for a model. All members are optional: `{}` requests the default preset with a \
                random seed.",
            "additionalProperties": false,
            "properties": {
                "preset": { "type": "string", "default": DEFAULT_PRESET, "description": "Name of a preset; see `GET /presets`." },
                "seed": { "type": "integer", "format": "int64", "minimum": 0, "maximum": SEED_MAX,
                    "description": "Seed. The same seed and spec give the same model. If the seed is absent, the \
                        service draws one and reports it." },
                "spec": { "$ref": "#/components/schemas/SpecPatch" },
                "outputs": { "type": "array", "uniqueItems": true, "items": { "$ref": "#/components/schemas/Output" },
                    "default": Output::DEFAULT, "description": "File formats. `sections.bin` and `report.json` are always written." },
                "bodies": { "type": "array", "uniqueItems": true, "minItems": 1,
                    "items": { "$ref": "#/components/schemas/Body" }, "default": [BodyKind::Tissue],
                    "description": "Bodies whose surfaces are written in each surface format: `tissue` as `model.*`, \
                        `lumen` as `lumen.*`, `regions` (both, with their common wall once) as `regions.*`." },
                "units": { "anyOf": [{ "$ref": "#/components/schemas/LengthUnit" }, { "type": "null" }],
                    "description": "Unit of coordinates in `obj`, `stl`, `stl-ascii`, `ply`, `vtp`, `3mf` and \
                        `centreline`. By default `obj` is in metres and the others in millimetres. glTF is \
                        always in metres." },
                "backend": { "$ref": "#/components/schemas/Backend" },
                "labels": { "type": "object", "maxProperties": MAX_LABELS,
                    "description": "Labels by which clients can find the model: names and values.",
                    "propertyNames": { "minLength": 1, "maxLength": MAX_LABEL_KEY_CHARS, "pattern": "^[^:\\u0000]+$" },
                    "additionalProperties":
                        { "type": "string", "maxLength": MAX_LABEL_VALUE_CHARS, "pattern": "^[^\\u0000]*$" } },
                "priority": { "type": "integer", "minimum": Priority::MIN, "maximum": Priority::MAX, "default": 0,
                    "description": "Priority in the queue. Workers claim queued models of higher priority first." },
                "reuse": { "type": "boolean", "default": true,
                    "description": "True to reuse a model with the same digest instead of growing it again. A \
                        finished model is reused immediately, a queued or running model when it ends." }
            },
        })
    }
}

/// Reads a priority.
pub(in crate::http) fn read_priority(reader: &mut JsonReader, value: &Value) -> Option<Priority> {
    Priority::try_from(reader.integer("/priority", value, Priority::MIN..=Priority::MAX)?).ok()
}

fn read_choice<T: DeserializeOwned>(reader: &mut JsonReader, at: &str, value: &Value) -> Option<T> {
    // The message of serde quotes the name and lists the valid ones: "unknown variant `x`, expected
    // one of …". No valid name is longer than 40 characters.
    let name: String = reader.text(at, value)?.chars().take(41).collect();
    serde_json::from_value(name.into()).map_or_else(|error| reader.fault(at, error.to_string()), Some)
}

fn read_outputs(reader: &mut JsonReader, members: &Map<String, Value>) -> Outputs {
    let default = Outputs::default();
    let bodies = members.get("bodies").map_or(default.bodies, |value| {
        if value.as_array().is_some_and(Vec::is_empty) {
            reader.fault::<()>("/bodies", "must name at least one body");
        }
        read_choices::<BodyKind>(reader, "/bodies", value).unwrap_or_default()
    });
    let formats = members
        .get("outputs")
        .map_or(default.formats, |value| read_choices::<Output>(reader, "/outputs", value).unwrap_or_default());
    let units = members.get("units").filter(|value| !value.is_null());
    let units = units.and_then(|value| read_choice::<LengthUnit>(reader, "/units", value));
    Outputs { formats, bodies, units }
}

/// Reads a list of different names.
fn read_choices<T: DeserializeOwned + PartialEq>(reader: &mut JsonReader, at: &str, value: &Value) -> Option<Vec<T>> {
    let items = reader.array(at, value)?;
    if items.len() > MAX_CHOICES {
        return reader.fault(at, format!("may have at most {MAX_CHOICES} members, not {}", items.len()));
    }
    let mut choices = Vec::new();
    for (i, item) in items.iter().enumerate() {
        let at = format!("{at}/{i}");
        let Some(choice) = read_choice(reader, &at, item) else { continue };
        if choices.contains(&choice) {
            reader.fault::<()>(at, "is given more than once");
        } else {
            choices.push(choice);
        }
    }
    Some(choices)
}

/// Reads labels. Invalid ones are left out.
pub(in crate::http) fn read_labels(reader: &mut JsonReader, value: &Value) -> BTreeMap<String, String> {
    let mut labels = BTreeMap::new();
    let Some(members) = reader.object("/labels", value) else { return labels };
    if members.len() > MAX_LABELS {
        let detail = format!("may have at most {MAX_LABELS} members, not {}", members.len());
        reader.fault::<()>("/labels", detail);
    }
    for (key, value) in members {
        let at = format!("/labels/{}", escape(key));
        if !(1..=MAX_LABEL_KEY_CHARS).contains(&key.chars().count()) || key.contains([':', '\0']) {
            let detail =
                format!("the key must have 1 to {MAX_LABEL_KEY_CHARS} characters, none of them a colon or NUL");
            reader.fault::<()>(&at, detail);
        }
        let Some(text) = reader.text(&at, value) else { continue };
        if text.chars().count() <= MAX_LABEL_VALUE_CHARS && !text.contains('\0') {
            labels.insert(key.clone(), text.to_owned());
        } else {
            let detail = format!("may have at most {MAX_LABEL_VALUE_CHARS} characters, none of them NUL");
            reader.fault::<()>(at, detail);
        }
    }
    labels
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::http::wire::faults::body_reader;

    fn read(body: &Value) -> Result<ModelRequest, Vec<String>> {
        let mut reader = body_reader();
        let request = ModelRequest::read(&mut reader, body);
        reader.finish(Some(request)).map_err(|faults| faults.into_iter().map(|fault| fault.pointer).collect())
    }

    #[test]
    fn a_long_name_is_not_repeated_in_full() {
        let mut reader = body_reader();
        ModelRequest::read(&mut reader, &json!({ "backend": "b".repeat(100_000) }));
        let detail = &reader.faults()[0].detail;
        assert!(detail.contains("cpu-single") && detail.len() < 200, "{detail}");
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
