//! The patch of a spec as components: one for the whole, one for each group of parameters, and those of schedules.
//!
//! `null` is allowed for every member: it resets a value to that of the preset.

use serde_json::{Map, Value, json};

/// Adds the components.
pub(super) fn add(schemas: &mut Value) {
    let mut whole = crate::spec::schema();
    let mut definitions = Value::Null;
    if let Some(members) = whole.as_object_mut() {
        members.remove("$schema");
        definitions = members.remove("$defs").unwrap_or_default();
    }
    let mut parts = Map::new();
    for (name, mut definition) in definitions.as_object().cloned().unwrap_or_default() {
        allow_null(&mut definition, &mut parts);
        parts.insert(name, definition);
    }
    allow_null(&mut whole, &mut parts);
    parts.insert("SpecPatch".to_owned(), whole);
    for (name, mut part) in parts {
        hide_defaults(&mut part);
        move_references(&mut part);
        schemas[name] = part;
    }
}

/// Lets every member of an object be null, and makes its groups components of their own.
fn allow_null(object: &mut Value, parts: &mut Map<String, Value>) {
    // By `get_mut`: indexing inserts null if there is no such member.
    for (name, member) in object.get_mut("properties").and_then(Value::as_object_mut).into_iter().flatten() {
        if member.get("properties").is_some() {
            let component = component(name);
            let mut group = std::mem::take(member);
            allow_null(&mut group, parts);
            *member = json!({ "$ref": format!("#/components/schemas/{component}") });
            parts.insert(component, group);
        }
        nullable(member);
    }
}

/// Name of the component of a group.
fn component(group: &str) -> String {
    let words = group.split('_').map(|word| word[..1].to_uppercase() + &word[1..]);
    words.chain(["Patch".to_owned()]).collect()
}

fn nullable(schema: &mut Value) {
    let Some(members) = schema.as_object_mut() else { return };
    if let Some(reference) = members.remove("$ref") {
        members.insert("oneOf".to_owned(), json!([{ "$ref": reference }]));
    }
    if let Some(alternatives) = schema.get_mut("oneOf").and_then(Value::as_array_mut) {
        alternatives.push(json!({ "type": "null" }));
    }
    if let Some(Value::String(kind)) = schema.get("type").cloned() {
        schema["type"] = json!([kind, "null"]);
    }
    if let Some(choices) = schema.get_mut("enum").and_then(Value::as_array_mut) {
        choices.push(Value::Null);
    }
}

/// Renames `default`: a generated client would send it, and replace the value of another preset.
fn hide_defaults(schema: &mut Value) {
    if let Some(default) = schema.as_object_mut().and_then(|members| members.remove("default")) {
        schema["x-default"] = default;
    }
    for member in schema.get_mut("properties").and_then(Value::as_object_mut).into_iter().flat_map(Map::values_mut) {
        hide_defaults(member);
    }
}

/// Makes references to definitions references to components.
pub(super) fn move_references(schema: &mut Value) {
    match schema {
        Value::Object(members) => {
            if let Some(Value::String(target)) = members.get_mut("$ref")
                && let Some(name) = target.strip_prefix("#/$defs/")
            {
                *target = format!("#/components/schemas/{name}");
            }
            members.values_mut().for_each(move_references);
        }
        Value::Array(items) => items.iter_mut().for_each(move_references),
        _ => {}
    }
}
