//! JSON Schema (2020-12) of a specification, generated from the table.
//!
//! The schema describes a patch. No field is required, each `default` is the value of the default
//! preset, and `x-unit` is the unit. Rules between parameters ([`super::check`]) are not expressed.

use super::bounds::Range;
use super::canonical::number;
use super::fault::child;
use super::parameters::table;
use super::preset::{DEFAULT_PRESET, preset};
use super::read::{MAX_GRID, MAX_KEYS, MAX_POINTS, PERIOD};
use super::schedule::Ease;
use super::table::{Field, Kind};
use serde_json::{Map, Value, json};

/// Schema of the `spec` of a request. In addition, `null` is valid everywhere and restores the
/// value of the preset.
#[must_use]
pub fn schema() -> Value {
    let defaults = preset(DEFAULT_PRESET).map(|preset| &preset.spec);
    let mut schema = object(table(), "", &|pointer| defaults.and_then(|spec| spec.pointer(pointer)).cloned());
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema".into();
    schema["title"] = "Model specification".into();
    schema["description"] = format!(
        "Parameters of a model, as a merge patch (RFC 7396) on a preset; null restores the value of the preset. \
         Defaults are those of the preset \"{DEFAULT_PRESET}\"."
    )
    .into();
    schema["$defs"] = definitions();
    schema
}

/// Schema of a group. `default` returns the value at a pointer in the default preset.
fn object(fields: &[Field], at: &str, default: &dyn Fn(&str) -> Option<Value>) -> Value {
    let properties: Map<String, Value> = fields
        .iter()
        .map(|field| {
            let here = child(at, field.name);
            let mut schema = match &field.kind {
                Kind::Group(fields) => object(fields, &here, default),
                Kind::Schedule(range) => schedule(*range),
                Kind::Number(range) => bounded(*range),
                Kind::Integer(count) => json!({ "type": "integer", "minimum": count.min, "maximum": count.max }),
                Kind::Choice(names) => json!({
                    "type": "string",
                    "enum": names.iter().map(|(name, _)| *name).collect::<Vec<_>>(),
                    "x-enum-descriptions": names.iter().map(|(_, doc)| *doc).collect::<Vec<_>>(),
                }),
                Kind::Bool => json!({ "type": "boolean" }),
                Kind::Points(coordinates, range) => points(*coordinates, *range),
                Kind::Grid(range) => grid(*range),
            };
            schema["title"] = field.title.into();
            schema["description"] = field.doc.into();
            if !field.unit.is_empty() {
                schema["x-unit"] = field.unit.into();
            }
            if let (false, Some(value)) = (matches!(field.kind, Kind::Group(_)), default(&here)) {
                schema["default"] = value;
            }
            (field.name.to_owned(), schema)
        })
        .collect();
    json!({ "type": "object", "additionalProperties": false, "properties": properties })
}

/// Schema of a schedule: a number, or `$defs/Schedule` with the bounds of this parameter.
fn schedule(range: Range) -> Value {
    let mut constant = bounded(range);
    constant["title"] = "Constant".into();
    let amplitude = if range.steady { json!(0) } else { number((range.max - range.min) / 2.0) };
    json!({ "oneOf": [
        constant,
        {
            "title": "Along the tube",
            "$ref": "#/$defs/Schedule",
            "properties": {
                "keys": { "items": { "prefixItems": [fraction(), bounded(range)] } },
                "fluctuation": { "properties": { "amplitude": { "maximum": amplitude } } },
            },
        },
    ] })
}

/// Schema of the first number of a key.
fn fraction() -> Value {
    json!({ "type": "number", "minimum": 0, "maximum": 1 })
}

fn points(coordinates: usize, range: Range) -> Value {
    let coordinate = bounded(range);
    let point = json!({
        "type": "array",
        "prefixItems": vec![&coordinate; coordinates],
        "items": coordinate,
        "minItems": coordinates,
        "maxItems": coordinates,
    });
    json!({ "type": "array", "items": point, "maxItems": MAX_POINTS })
}

fn grid(range: Range) -> Value {
    let row = json!({ "type": "array", "items": bounded(range), "maxItems": MAX_GRID });
    json!({ "type": "array", "items": row, "maxItems": MAX_GRID })
}

fn bounded(range: Range) -> Value {
    let mut schema = json!({ "type": "number", "minimum": number(range.min), "maximum": number(range.max) });
    if let Some(reason) = range.because {
        schema["x-maximum-reason"] = reason.into();
    }
    schema
}

/// Definitions that all schedules share.
pub(super) fn definitions() -> Value {
    json!({
        "Schedule": {
            "type": "object",
            "description": "Value that changes along the tube: keys and an optional fluctuation.",
            "additionalProperties": false,
            "properties": {
                "keys": {
                    "title": "Keys",
                    "description": "At least two keys in ascending order, the first at 0 and the last at 1.",
                    "type": "array",
                    "minItems": 2,
                    "maxItems": MAX_KEYS,
                    "items": { "$ref": "#/$defs/ScheduleKey" },
                },
                "ease": {
                    "title": "Ease",
                    "description": "Interpolation between two keys.",
                    "type": "string",
                    "enum": Ease::NAMES.iter().map(|(name, _)| *name).collect::<Vec<_>>(),
                    "x-enum-descriptions": Ease::NAMES.iter().map(|(_, doc)| *doc).collect::<Vec<_>>(),
                    "default": Ease::default().name(),
                },
                "fluctuation": { "$ref": "#/$defs/Fluctuation" },
            },
        },
        "ScheduleKey": {
            "description": "A key of a schedule: a fraction of all steps, and the value at this step.",
            "type": "array",
            "prefixItems": [fraction(), { "type": "number" }],
            "items": { "type": "number" },
            "minItems": 2,
            "maxItems": 2,
        },
        "Fluctuation": {
            "title": "Fluctuation",
            "description": "Sine that is added to the value between the keys. Its phase depends on the seed. An \
                amplitude of 0 disables it.",
            "type": "object",
            "additionalProperties": false,
            "properties": {
                "amplitude": {
                    "title": "Amplitude",
                    "description": "In the unit of the parameter.",
                    "type": "number",
                    "minimum": 0,
                },
                "period": {
                    "title": "Period",
                    "type": "number",
                    "minimum": number(PERIOD.min),
                    "maximum": number(PERIOD.max),
                    "x-unit": "steps",
                },
            },
        },
    })
}
