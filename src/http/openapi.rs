//! The description of the service (OpenAPI 3.1), made from the routes and their types.
//!
//! The committed `openapi.yaml` is this, byte for byte; a test compares them. Write it anew with
//! `cargo run -- openapi > openapi.yaml`.

use super::dto::{DeletedEvent, ModelEvent};
use super::problem::{Fault, Kind, ProblemBody, TYPE_PREFIX};
use super::request::{BatchRequest as Batch, ModelRequest as Request};
use super::router::routes;
use crate::export::{glb, obj, sections_bin};
use crate::generate::{Backend, Output};
use axum::http::{HeaderValue, header};
use axum::response::{IntoResponse, Response};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::sync::LazyLock;
use utoipa::openapi::content::ContentBuilder;
use utoipa::openapi::{Ref, RefOr, Response as ResponseDoc, ResponseBuilder};
use utoipa::{IntoResponses, OpenApi, PartialSchema, ToSchema};

#[derive(OpenApi)]
#[openapi(
    components(schemas(ProblemBody, Fault, Backend, Output, super::sections::Format, ModelEvent, DeletedEvent)),
    tags(
        (name = "models", description = "Ask for models, find, stop and remove them"),
        (name = "batches", description = "Many models of one spec, in one request"),
        (name = "events", description = "Follow models as they grow"),
        (name = "files", description = "What a finished model consists of"),
        (name = "presets", description = "What can be grown"),
        (name = "service", description = "The service itself"),
    )
)]
struct Base;

/// Stands for the request in the descriptions of routes; its schema is that of [`Request`].
pub(super) struct ModelRequest;

impl PartialSchema for ModelRequest {
    fn schema() -> RefOr<utoipa::openapi::Schema> {
        // Replaced by `Request::schema` below, which says more than utoipa's types can.
        utoipa::openapi::Object::new().into()
    }
}

impl ToSchema for ModelRequest {}

/// Stands for the request for a batch; its schema is that of [`Batch`].
pub(super) struct BatchRequest;

impl PartialSchema for BatchRequest {
    fn schema() -> RefOr<utoipa::openapi::Schema> {
        utoipa::openapi::Object::new().into()
    }
}

impl ToSchema for BatchRequest {}

/// Stands for one event of a stream in the descriptions of routes.
pub(super) struct ServerSentEvent;

impl PartialSchema for ServerSentEvent {
    fn schema() -> RefOr<utoipa::openapi::Schema> {
        // Replaced by `server_sent_event` below: utoipa knows no `contentSchema`.
        utoipa::openapi::Object::new().into()
    }
}

impl ToSchema for ServerSentEvent {}

macro_rules! problems {
    ($($(#[$doc:meta])* $name:ident: $($kind:ident),+;)*) => {$(
        $(#[$doc])*
        pub(super) struct $name;

        impl IntoResponses for $name {
            fn responses() -> BTreeMap<String, RefOr<ResponseDoc>> {
                problem_responses(&[$(Kind::$kind),+])
            }
        }
    )*};
}

problems! {
    /// The address names no model.
    ModelMissing: ModelNotFound;
    /// The address names no batch.
    BatchMissing: BatchNotFound;
    /// The address names no model, or no file of it.
    FileMissing: ModelNotFound, FileNotFound;
    /// The address names no model, or no section of it.
    SectionMissing: ModelNotFound, FileNotFound, SectionNotFound;
    /// The address names no preset.
    PresetMissing: PresetNotFound;
    /// The range lies outside the file.
    RangeOutside: RangeNotSatisfiable;
    /// No representation fits `Accept`.
    Inacceptable: NotAcceptable;
    /// A query parameter is wrong.
    BadParameters: BadRequest, InvalidRequest;
    /// The body or a header is wrong.
    BodyProblems: BadRequest, InvalidJson, RequestTimeout, PayloadTooLarge, UnsupportedMediaType, InvalidRequest, CostLimit, GpuUnavailable, IdempotencyConflict;
    /// The queue is full.
    QueueFull: QueueFull;
    /// One of the stores is away.
    StoreAway: StoreUnavailable, StorageUnavailable;
    /// The store is away, or too many streams are open.
    StreamAway: StoreUnavailable, TooManyStreams;
}

/// One response for each status among `kinds`.
fn problem_responses(kinds: &[Kind]) -> BTreeMap<String, RefOr<ResponseDoc>> {
    let mut by_status: BTreeMap<String, Vec<Kind>> = BTreeMap::new();
    for kind in kinds {
        by_status.entry(kind.status().as_str().to_owned()).or_default().push(*kind);
    }
    let content = || ContentBuilder::new().schema(Some(Ref::from_schema_name("Problem"))).build();
    let document = |kinds: Vec<Kind>| {
        let lines: Vec<_> = kinds.iter().map(|kind| format!("{} (`{}`)", kind.title(), kind.slug())).collect();
        ResponseBuilder::new().description(lines.join("; ")).content("application/problem+json", content()).build()
    };
    by_status.into_iter().map(|(status, kinds)| (status, document(kinds).into())).collect()
}

/// Describe the service.
#[utoipa::path(
    get, path = "/openapi.yaml", operation_id = "get_openapi", tag = "service",
    responses((status = 200, description = "This description", content_type = "application/yaml", body = String))
)]
pub(super) async fn document() -> Response {
    static TEXT: LazyLock<String> = LazyLock::new(openapi_yaml);
    ([(header::CONTENT_TYPE, HeaderValue::from_static("application/yaml"))], TEXT.as_str()).into_response()
}

/// The description as YAML: what `openapi.yaml` holds.
#[must_use]
pub fn openapi_yaml() -> String {
    let document = description();
    let mut yaml = String::from("# Made from the code: cargo run -- openapi > openapi.yaml\n");
    for part in ["openapi", "info", "tags", "paths", "components"] {
        let text = yaml_serde::to_string(&json!({ part: document[part] })).expect("JSON is YAML");
        yaml.push_str(&text);
    }
    yaml
}

/// The description.
pub(super) fn description() -> Value {
    let mut api = Base::openapi();
    api.merge(routes().into_openapi());
    let mut document = serde_json::to_value(api).expect("a description has string keys only");
    document["info"] = info();
    let schemas = &mut document["components"]["schemas"];
    schemas["ModelRequest"] = Request::schema();
    schemas["BatchRequest"] = Batch::schema(super::Limits::default().batch);
    spec_patch(schemas);
    schemas["ServerSentEvent"] = server_sent_event();
    describe_problems(&mut schemas["Problem"]);
    let paths = &mut document["paths"];
    describe_files(&mut paths["/models/{id}/files/{name}"]["get"]["responses"]);
    // Text: a reader that parses YAML would find an object where a schema of it says string.
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
        "description": "Grows 3D models of folded tubular organs. Ask for one with `POST /models`, follow it by its events, \
            download its files. Every error answer is a problem (RFC 9457); every answer carries `x-request-id`.",
    })
}

/// What every operation may answer besides.
fn complete(operation: &mut Value) {
    // By `get_mut`: an index would put in null where nothing is.
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
    for (status, text) in [("429", "Seconds after which to try again"), ("503", "Seconds after which to try again")] {
        if let Some(response) = responses.get_mut(status) {
            response["headers"]["retry-after"] = json!({ "description": text, "schema": { "type": "integer" } });
        }
    }
    if let Some(response) = responses.get_mut("416") {
        response["headers"]["content-range"] =
            json!({ "description": "`bytes */` and the size of the file", "schema": { "type": "string" } });
    }
}

/// The media types of files. What they hold is not for JSON Schema to say; half a file of JSON is not even JSON.
fn describe_files(responses: &mut Value) {
    let types = [glb::MEDIA_TYPE, obj::MEDIA_TYPE, sections_bin::MEDIA_TYPE, "application/json"];
    let content: Map<String, Value> = types.map(|media_type| (media_type.to_owned(), json!({}))).into_iter().collect();
    for status in ["200", "206"] {
        responses[status]["content"] = Value::Object(content.clone());
    }
}

/// One event of a stream: its three fields as they arrive, and what is in the text of `data`.
fn server_sent_event() -> Value {
    json!({
        "type": "object",
        "description": "One event of the stream (WHATWG server-sent events).",
        "required": ["event", "id", "data"],
        "properties": {
            "event": {
                "type": "string",
                "enum": ["status", "progress", "section", "end"],
                "description": "What it tells of; `end` is the last of its model",
            },
            "id": { "type": "string", "description": "To be sent back as `Last-Event-ID`" },
            "data": {
                "type": "string",
                "contentMediaType": "application/json",
                "contentSchema": { "anyOf": [
                    { "$ref": "#/components/schemas/ModelEvent" },
                    { "$ref": "#/components/schemas/DeletedEvent" },
                ] },
                "description": "The state, as JSON",
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

/// Lists the kinds of problems in the schema of one.
fn describe_problems(schema: &mut Value) {
    let types: Vec<_> = Kind::ALL.iter().map(|kind| format!("{TYPE_PREFIX}{}", kind.slug())).collect();
    schema["properties"]["type"]["enum"] = json!(types);
    schema["properties"]["line"] = json!({ "type": "integer", "description": "invalid-json: where in the body" });
    schema["properties"]["column"] = json!({ "type": "integer", "description": "invalid-json: where in the line" });
    schema["properties"]["errors_left_out"] = json!({ "type": "integer", "description": "invalid-request: how many faults there are besides those in errors" });
    schema["properties"]["prediction"] = json!({ "$ref": "#/components/schemas/Cost" });
    schema["properties"]["limit"] = json!({ "description": "cost-limit, queue-full, payload-too-large: the limit" });
}

/// The schema of the spec as components: `null` is taken everywhere (it puts a value back to the preset's), and the
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
            // Members that only narrow a definition, which already takes null.
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
