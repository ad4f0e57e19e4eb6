//! The description of the service (OpenAPI 3.1), generated from the routes and their types.
//!
//! The committed `openapi.yaml` is this, byte for byte; a test compares them. Regenerate it with
//! `cargo run -- openapi > openapi.yaml`.

use super::batches::BatchRequest;
use super::dto::{DeletedEvent, ModelEvent};
use super::faults::Fault;
use super::problem::{Kind, ProblemBody, TYPE_PREFIX};
use super::request::ModelRequest;
use super::responses::problem_responses;
use crate::export::{glb, obj, sections_bin};
use crate::generate::{Backend, Output};
use axum::Extension;
use axum::http::{HeaderValue, header};
use axum::response::{IntoResponse, Response};
use serde_json::{Map, Value, json};
use std::sync::OnceLock;
use utoipa::OpenApi;

#[derive(OpenApi)]
#[openapi(
    components(schemas(super::detail::Detail, ProblemBody, Fault, Backend, Output, super::sections::Format, super::batches::table::TableFormat,
        super::batches::archive::ArchiveFormat, ModelEvent, DeletedEvent)),
    tags(
        (name = "models", description = "Request, find, cancel and delete models"),
        (name = "batches", description = "Many models of one spec in one request"),
        (name = "events", description = "Follow models while they grow"),
        (name = "files", description = "Files, sections and reports of finished models"),
        (name = "access", description = "Tickets for what cannot send a key"),
        (name = "presets", description = "Presets and the parameters of a spec"),
        (name = "service", description = "Health, metrics, workers and this description"),
    )
)]
struct Base;

/// Gives the description of all routes. Only the router knows them, so it provides this as an extension.
#[derive(Clone, Copy)]
pub(super) struct Description(pub(super) fn() -> &'static Value);

/// Read this description as YAML.
#[utoipa::path(
    get, path = "/openapi.yaml", operation_id = "get_openapi", tag = "service",
    responses((status = 200, description = "This description", content_type = "application/yaml", body = String))
)]
pub(super) async fn document(Extension(description): Extension<Description>) -> Response {
    static TEXT: OnceLock<String> = OnceLock::new();
    let text = TEXT.get_or_init(|| yaml(description.0())).as_str();
    ([(header::CONTENT_TYPE, HeaderValue::from_static("application/yaml"))], text).into_response()
}

/// A description as YAML: what `openapi.yaml` holds.
pub(super) fn yaml(description: &Value) -> String {
    let mut yaml = String::from("# Generated from the code: cargo run -- openapi > openapi.yaml\n");
    for part in ["openapi", "info", "tags", "paths", "components"] {
        let text = yaml_serde::to_string(&json!({ part: description[part] })).expect("JSON is YAML");
        yaml.push_str(&text);
    }
    yaml
}

/// The description of these routes.
pub(super) fn describe(routes: utoipa::openapi::OpenApi) -> Value {
    let mut api = Base::openapi();
    api.merge(routes);
    let mut document = serde_json::to_value(api).expect("a description has string keys only");
    document["info"] = info();
    let schemas = &mut document["components"]["schemas"];
    schemas["ModelRequest"] = ModelRequest::schema();
    schemas["BatchRequest"] = BatchRequest::schema(super::Limits::default().batch);
    schemas["Vary"] = crate::spec::study::schema(super::Limits::default().batch);
    schemas["Table"]["properties"]["rows"]["items"]["items"] = crate::spec::study::value_schema();
    spec_patch(schemas);
    schemas["ServerSentEvent"] = server_sent_event();
    describe_problems(&mut schemas["Problem"]);
    let paths = &mut document["paths"];
    describe_files(&mut paths["/models/{id}/files/{name}"]["get"]["responses"]);
    let archive = json!({ "application/zip": {}, "application/x-tar": {} });
    paths["/batches/{id}/archive"]["get"]["responses"]["200"]["content"] = archive;
    // Without a schema: a client that parses YAML finds an object where a schema of text says string.
    paths["/openapi.yaml"]["get"]["responses"]["200"]["content"] = json!({ "application/yaml": {} });
    for item in document["paths"].as_object_mut().into_iter().flat_map(Map::values_mut) {
        for operation in item.as_object_mut().into_iter().flat_map(Map::values_mut) {
            complete(operation);
        }
    }
    plain_integers(&mut document);
    document
}

fn info() -> Value {
    json!({
        "title": "oviduct",
        "version": crate::ENGINE_VERSION,
        "license": { "name": "MIT OR Apache-2.0", "identifier": "MIT OR Apache-2.0" },
        "description": "Grows 3D models of folded tubular organs. Request one with `POST /models`, follow its events, \
            download its files. Every error response is a problem (RFC 9457); every response has `x-request-id`.",
    })
}

/// Adds what all operations have in common.
fn complete(operation: &mut Value) {
    // By `get_mut`: indexing inserts null if there is no such member.
    for parameter in operation.get_mut("parameters").and_then(Value::as_array_mut).into_iter().flatten() {
        // A header or a parameter may be absent, never null.
        if let Some(kinds) = parameter.pointer("/schema/type").and_then(Value::as_array).cloned() {
            parameter["schema"]["type"] = kinds.into_iter().find(|kind| kind != "null").unwrap_or_default();
        }
    }
    let Some(responses) = operation.get_mut("responses").and_then(Value::as_object_mut) else { return };
    for (status, response) in problem_responses(&[Kind::Internal]) {
        responses.entry(status).or_insert_with(|| serde_json::to_value(response).unwrap_or_default());
    }
    for (status, text) in
        [("429", "Seconds to wait before the next attempt"), ("503", "Seconds to wait before the next attempt")]
    {
        if let Some(response) = responses.get_mut(status) {
            response["headers"]["retry-after"] = json!({ "description": text, "schema": { "type": "integer" } });
        }
    }
    if let Some(response) = responses.get_mut("416") {
        response["headers"]["content-range"] =
            json!({ "description": "`bytes */` and the size of the file", "schema": { "type": "string" } });
    }
}

/// The media types of files, without schemas: most files are not JSON, and a range of JSON is not JSON either.
fn describe_files(responses: &mut Value) {
    let types = [glb::MEDIA_TYPE, obj::MEDIA_TYPE, sections_bin::MEDIA_TYPE, "application/json"];
    let content: Map<String, Value> = types.map(|media_type| (media_type.to_owned(), json!({}))).into_iter().collect();
    for status in ["200", "206"] {
        responses[status]["content"] = Value::Object(content.clone());
    }
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

/// Removes the formats `int32` and `int64`, which utoipa gives to unsigned integers too.
fn plain_integers(value: &mut Value) {
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

/// Adds to the schema of a problem its types and the members that only some of them have.
fn describe_problems(schema: &mut Value) {
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
    schema["properties"]["limit"] = json!({ "description": "cost-limit, queue-full, payload-too-large: the limit" });
}

/// The schema of the spec as components. `null` is allowed everywhere (it resets a value to the preset's), and the
/// definitions become components of their own.
fn spec_patch(schemas: &mut Value) {
    let mut schema = crate::spec::schema();
    if let Some(members) = schema.as_object_mut() {
        members.remove("$schema");
        let definitions = members.remove("$defs").unwrap_or_default();
        for (name, mut definition) in definitions.as_object().cloned().unwrap_or_default() {
            nullable_members(&mut definition);
            move_references(&mut definition);
            schemas[component(&name)] = definition;
        }
    }
    nullable_members(&mut schema);
    move_references(&mut schema);
    schemas["SpecPatch"] = schema;
}

fn component(definition: &str) -> String {
    format!("Spec.{definition}")
}

fn move_references(schema: &mut Value) {
    match schema {
        Value::Object(members) => {
            if let Some(Value::String(target)) = members.get_mut("$ref")
                && let Some(name) = target.strip_prefix("#/$defs/")
            {
                *target = format!("#/components/schemas/{}", component(name));
            }
            members.values_mut().for_each(move_references);
        }
        Value::Array(items) => items.iter_mut().for_each(move_references),
        _ => {}
    }
}

/// Lets every member of an object be null.
fn nullable_members(schema: &mut Value) {
    for member in schema["properties"].as_object_mut().into_iter().flat_map(Map::values_mut) {
        nullable(member);
    }
}

fn nullable(schema: &mut Value) {
    if schema.get("properties").is_some() {
        nullable_members(schema);
    }
    if let Some(alternatives) = schema.get_mut("oneOf").and_then(Value::as_array_mut) {
        for alternative in alternatives.iter_mut().filter(|a| a.get("properties").is_some()) {
            // Members that only narrow a definition, which already allows null.
            for member in alternative["properties"].as_object_mut().into_iter().flat_map(Map::values_mut) {
                if member.get("properties").is_some() {
                    nullable_members(member);
                }
            }
        }
        alternatives.push(json!({ "type": "null" }));
    }
    if let Some(Value::String(kind)) = schema.get("type").cloned() {
        schema["type"] = json!([kind, "null"]);
    }
    if let Some(choices) = schema.get_mut("enum").and_then(Value::as_array_mut) {
        choices.push(Value::Null);
    }
}
