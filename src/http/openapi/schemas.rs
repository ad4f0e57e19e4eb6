//! Schemas that utoipa cannot derive: those of requests, tuples, and members that only some problems have.

use super::spec;
use crate::http::Limits;
use crate::http::batches::request::BatchRequest;
use crate::http::models::request::ModelRequest;
use crate::http::wire::problem::{Kind, TYPE_PREFIX};
use serde_json::{Value, json};

/// Completes the components that utoipa has derived.
pub(super) fn complete(schemas: &mut Value) {
    let most = Limits::default().batch;
    schemas["ModelRequest"] = ModelRequest::schema();
    definitions(schemas, "BatchRequest", BatchRequest::schema(most));
    definitions(schemas, "Vary", crate::spec::study::schema(most));
    // After the study, whose schedules do not allow null.
    spec::add(schemas);
    schemas["JsonSchema"] = json_schema();
    schemas["ServerSentEvent"] = server_sent_event();
    tuples(schemas);
    // `fit` cannot name the types of requests.
    schemas["FitResult"]["properties"]["spec"]["$ref"] = json!("#/components/schemas/SpecPatch");
    schemas["CertificateFigures"] = certificate_figures(&schemas["Certificate"]);
    problems(&mut schemas["Problem"]);
}

/// Adds a schema and its definitions as components.
fn definitions(schemas: &mut Value, name: &str, mut schema: Value) {
    let parts = schema.as_object_mut().and_then(|members| members.remove("$defs")).unwrap_or_default();
    for (name, mut part) in parts.as_object().cloned().unwrap_or_default() {
        spec::move_references(&mut part);
        schemas[name] = part;
    }
    spec::move_references(&mut schema);
    schemas[name] = schema;
}

/// Points as arrays of fixed length. utoipa describes an array of Rust as one of any length.
fn tuples(schemas: &mut Value) {
    let tuple = |length: usize, description: &str| {
        let number = json!({ "type": "number" });
        json!({ "type": "array", "description": description, "prefixItems": vec![&number; length], "items": number,
            "minItems": length, "maxItems": length })
    };
    schemas["Point"] = tuple(2, "x and y, micrometres.");
    schemas["Position"] = tuple(3, "x, y and z, micrometres.");
    let point = json!({ "$ref": "#/components/schemas/Point" });
    for (schema, members) in [("RingAnswer", &["points"][..]), ("LiveSection", &["inner", "outer"])] {
        for member in members {
            schemas[schema]["properties"][member]["items"] = point.clone();
        }
    }
    let position = json!({ "$ref": "#/components/schemas/Position" });
    let described = |schema: &Value| schema["description"].clone();
    let place = &mut schemas["Place"]["properties"]["position_um"];
    *place = json!({ "description": described(place), "allOf": [position] });
    let bounds = &mut schemas["Certificate"]["properties"]["bounds_um"];
    *bounds = json!({ "description": described(bounds), "type": "array", "prefixItems": [position, position],
        "items": position, "minItems": 2, "maxItems": 2 });
}

/// A certificate without its lists, as the record of a model keeps it.
fn certificate_figures(certificate: &Value) -> Value {
    let lists = ["bodies", "failures"];
    let mut figures = certificate.clone();
    figures["description"] = json!("The figures of a certificate: all but its lists of components and failures.");
    if let Some(members) = figures["properties"].as_object_mut() {
        members.retain(|name, _| !lists.contains(&name.as_str()));
    }
    if let Some(required) = figures["required"].as_array_mut() {
        required.retain(|name| !lists.iter().any(|list| name == list));
    }
    figures
}

/// The part of JSON Schema that `GET /schema` uses.
fn json_schema() -> Value {
    let own = json!({ "$ref": "#/components/schemas/JsonSchema" });
    let text = json!({ "type": "string" });
    let list = |items: &Value| json!({ "type": "array", "items": items });
    let by_name = |each: &Value| json!({ "type": "object", "additionalProperties": each });
    json!({
        "type": "object",
        "description": "A JSON Schema (draft 2020-12) of a spec or of a part of it.",
        "additionalProperties": false,
        "properties": {
            "$schema": text, "$ref": text, "$defs": by_name(&own),
            "title": text, "description": text, "type": text, "enum": list(&text),
            "default": { "$ref": "#/components/schemas/ParameterValue" },
            "properties": by_name(&own), "additionalProperties": { "type": "boolean" },
            "oneOf": list(&own), "items": own, "prefixItems": list(&own),
            "minItems": { "type": "integer" }, "maxItems": { "type": "integer" },
            "minimum": { "type": "number" }, "maximum": { "type": "number" },
            "x-unit": { "type": "string", "description": "Unit of the value." },
            "x-maximum-reason": { "type": "string", "description": "Why there is a maximum." },
            "x-enum-descriptions": { "type": "array", "items": text, "description": "The meaning of each choice." },
        },
    })
}

/// One event of a stream: its three fields, and what the text of `data` holds.
fn server_sent_event() -> Value {
    json!({
        "type": "object",
        "description": "One event of the stream (WHATWG server-sent events).",
        "required": ["event", "id", "data"],
        "properties": {
            "event": {
                "type": "string",
                "enum": ["status", "progress", "section", "end"],
                "description": "What has changed; `end` is the last event of a model",
            },
            "id": { "type": "string", "description": "Value for `Last-Event-ID` when the client reconnects" },
            "data": {
                "type": "string",
                "contentMediaType": "application/json",
                "contentSchema": { "anyOf": [
                    { "$ref": "#/components/schemas/ModelEvent" },
                    { "$ref": "#/components/schemas/DeletedEvent" },
                ] },
                "description": "The whole state of the model, as JSON",
            },
        },
    })
}

/// Adds to the schema of a problem its types and the members that only some of them have.
fn problems(schema: &mut Value) {
    let types: Vec<_> = Kind::ALL.iter().map(|kind| format!("{TYPE_PREFIX}{}", kind.slug())).collect();
    schema["properties"]["type"]["enum"] = json!(types);
    schema["properties"]["line"] =
        json!({ "type": "integer", "description": "invalid-json: line of the body, from 1" });
    schema["properties"]["column"] =
        json!({ "type": "integer", "description": "invalid-json: column of the line, from 1" });
    schema["properties"]["errors_left_out"] =
        json!({ "type": "integer", "description": "invalid-request: number of faults that are not listed in errors" });
    schema["properties"]["condition"] = json!({ "type": "string",
        "description": "not-ready: the reason, such as `opening-devices` or `draining`" });
    schema["properties"]["workers"] = json!({ "type": "array", "items": { "type": "string" },
        "description": "workers-stuck: a sentence on each" });
    schema["properties"]["prediction"] = json!({ "$ref": "#/components/schemas/Cost" });
    schema["properties"]["limit"] = json!({ "description": "The limit that was exceeded", "oneOf": [
        { "title": "Limit", "type": "integer", "description": "queue-full, quota-exceeded, payload-too-large" },
        { "title": "Limits", "type": "object", "additionalProperties": { "type": "number" },
            "description": "cost-limit: the limit of each quantity that exceeds its own" },
    ] });
}

/// Removes the formats `int32` and `int64`, which utoipa gives to unsigned integers too.
pub(super) fn plain_integers(value: &mut Value) {
    match value {
        Value::Object(members) => {
            if matches!(members.get("format").and_then(Value::as_str), Some("int32" | "int64")) {
                members.remove("format");
            }
            members.values_mut().for_each(plain_integers);
        }
        Value::Array(items) => items.iter_mut().for_each(plain_integers),
        _ => {}
    }
}
