//! Schemas that utoipa cannot derive: of requests, whose checks are more than a type, of text in a
//! format, of tuples, and of members that only some problems have.

use crate::http::batches::request::BatchRequest;
use crate::http::models::request::ModelRequest;
use crate::http::wire::problem::{Kind, TYPE_PREFIX};
use crate::spec::openapi::{components, json_components};
use crate::spec::study::DEFAULT_MAX_POINTS;
use serde_json::{Value, json};

/// A JSON Schema: the body of `GET /schema`.
pub(in crate::http) struct JsonSchema;

/// Text of one event of a stream.
pub(in crate::http) struct ServerSentEvent;

json_components! {
    ModelRequest as "ModelRequest": components("ModelRequest", ModelRequest::schema());
    BatchRequest as "BatchRequest": components("BatchRequest", BatchRequest::schema(DEFAULT_MAX_POINTS));
    JsonSchema as "JsonSchema": components("JsonSchema", json_schema());
    ServerSentEvent as "ServerSentEvent": components("ServerSentEvent", server_sent_event());
}

/// Completes the components that utoipa has derived.
pub(super) fn complete(schemas: &mut Value) {
    tuples(schemas);
    problems(&mut schemas["Problem"]);
}

/// Describes points as arrays of fixed length. utoipa describes an array as a list of any length.
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
    for certificate in ["Certificate", "CertificateFigures"] {
        let bounds = &mut schemas[certificate]["properties"]["bounds_um"];
        *bounds = json!({ "description": described(bounds), "type": "array", "prefixItems": [position, position],
            "items": position, "minItems": 2, "maxItems": 2 });
    }
}

/// Schema of JSON Schema, limited to the keywords that `GET /schema` uses.
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
            "x-maximum-reason": { "type": "string", "description": "Reason for the maximum." },
            "x-enum-descriptions": { "type": "array", "items": text, "description": "The meaning of each choice." },
        },
    })
}

/// Schema of an event: its three fields, and the schema of the JSON in `data`.
fn server_sent_event() -> Value {
    json!({
        "type": "object",
        "description": "One event of the stream (WHATWG server-sent events).",
        "required": ["event", "id", "data"],
        "properties": {
            "event": {
                "type": "string",
                "enum": ["status", "progress", "section", "end"],
                "description": "Kind of the change. `end` is the last event of a model",
            },
            "id": { "type": "string", "description": "Value of `Last-Event-ID` when the client reconnects" },
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

/// Adds the types to the schema of a problem, and the members that only some types have.
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
        "description": "workers-stuck: a sentence about each worker" });
    schema["properties"]["prediction"] = json!({ "$ref": "#/components/schemas/Cost" });
    schema["properties"]["limit"] = json!({ "description": "The limit that was exceeded", "oneOf": [
        { "title": "Limit", "type": "integer", "description": "queue-full, quota-exceeded, payload-too-large" },
        { "title": "Limits", "type": "object", "additionalProperties": { "type": "number" },
            "description": "cost-limit: the limit of each quantity that exceeds its own" },
    ] });
}

/// Removes the formats `int32` and `int64`. utoipa also adds them to unsigned integers, whose
/// largest values they exclude.
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
