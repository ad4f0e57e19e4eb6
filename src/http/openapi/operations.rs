//! Parts of all operations (problems, headers, security), and media types of bodies other than
//! JSON.

use crate::http::access::{BEARER, TICKET};
use crate::http::wire::problem::Kind;
use crate::http::wire::responses::problem_responses;
use serde_json::{Map, Value, json};

/// Completes all operations.
pub(super) fn complete(paths: &mut Value) {
    bodies(paths);
    for item in paths.as_object_mut().into_iter().flat_map(Map::values_mut) {
        for operation in item.as_object_mut().into_iter().flat_map(Map::values_mut) {
            parameters(operation);
            security(operation);
            responses(operation);
        }
    }
}

/// The two ways to authenticate a request.
pub(super) fn security_schemes() -> Value {
    json!({
        BEARER: { "type": "http", "scheme": "bearer",
            "description": "API key, `oviduct_…`. Only a service without keys serves requests without one." },
        TICKET: { "type": "apiKey", "in": "query", "name": TICKET,
            "description": "Ticket from `POST /tickets` for one `GET` of one path, for clients that cannot send \
                headers." },
    })
}

/// Removes null from the types of parameters: a header or a query parameter may be absent, but
/// never null.
fn parameters(operation: &mut Value) {
    // Indexing would insert null if there is no such member.
    for parameter in operation.get_mut("parameters").and_then(Value::as_array_mut).into_iter().flatten() {
        if let Some(kinds) = parameter.pointer("/schema/type").and_then(Value::as_array).cloned() {
            parameter["schema"]["type"] = kinds.into_iter().find(|kind| kind != "null").unwrap_or_default();
        }
    }
}

/// Adds the required scope to the description of an operation. In OpenAPI only OAuth has scopes, so
/// the security requirements cannot name it.
fn security(operation: &mut Value) {
    let scope = operation.pointer(&format!("/security/0/{BEARER}/0")).and_then(Value::as_str).map(str::to_owned);
    let requirements = operation.get_mut("security").and_then(Value::as_array_mut).into_iter().flatten();
    let mut schemes: Vec<&mut Value> =
        requirements.filter_map(Value::as_object_mut).flat_map(Map::values_mut).collect();
    schemes.iter_mut().for_each(|scopes| **scopes = json!([]));
    let needed = match (&scope, schemes.is_empty()) {
        (Some(scope), _) => format!("Needs a key with the scope `{scope}`."),
        (None, false) => "Needs a key with any scope.".to_owned(),
        (None, true) => "Needs no key.".to_owned(),
    };
    if let Some(scope) = scope {
        operation["x-required-scope"] = json!(scope);
    }
    let own = operation["description"].as_str().unwrap_or_default();
    operation["description"] = json!(format!("{own}\n\n{needed}").trim());
}

fn responses(operation: &mut Value) {
    let Some(responses) = operation.get_mut("responses").and_then(Value::as_object_mut) else { return };
    for (status, response) in problem_responses(&[Kind::Internal]) {
        responses.entry(status).or_insert_with(|| serde_json::to_value(response).unwrap_or_default());
    }
    for (status, name, kind, text) in [
        ("401", "www-authenticate", "string", "`Bearer`, and the reason why the key was refused"),
        ("403", "www-authenticate", "string", "`Bearer` and the missing scope. Only if the key was refused"),
        ("416", "content-range", "string", "`bytes */` and the size of the file"),
        ("429", "ratelimit", "string", "Remaining part of the limit. Absent if the queue is full"),
        ("429", "ratelimit-policy", "string", "The limit. Absent if the queue is full"),
        ("429", "retry-after", "integer", "Seconds to wait before the next attempt"),
        ("503", "retry-after", "integer", "Seconds to wait before the next attempt"),
    ] {
        if let Some(response) = responses.get_mut(status) {
            response["headers"][name] = json!({ "description": text, "schema": { "type": kind } });
        }
    }
}

/// Describes bodies other than JSON. utoipa would describe each as a string.
fn bodies(paths: &mut Value) {
    let bytes = || json!({ "schema": { "type": "string", "format": "binary" } });
    let responses = &mut paths["/models/{id}/files/{name}"]["get"]["responses"];
    // Each file has its own media type, which the model names. A range of JSON is not JSON.
    responses["200"]["content"] =
        json!({ "*/*": bytes(), "application/json": { "schema": { "$ref": "#/components/schemas/StoredReport" } } });
    responses["206"]["content"] = json!({ "*/*": bytes() });
    paths["/models/{id}/preview.png"]["get"]["responses"]["200"]["content"] = json!({ "image/png": bytes() });
    paths["/batches/{id}/archive"]["get"]["responses"]["200"]["content"] =
        json!({ "application/x-tar": bytes(), "application/zip": bytes() });
}
