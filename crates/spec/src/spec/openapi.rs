//! Specifications, studies and values of parameters as components of an OpenAPI description.
//!
//! The component `SpecPatch` describes a patch: `null` is allowed for every member and restores the
//! value of the preset. Each group of parameters is a component too.

use super::study::{self, DEFAULT_MAX_POINTS, Study};
use super::{ModelSpec, schema};
use serde_json::{Map, Value, json};
use utoipa::openapi::schema::SchemaType;
use utoipa::openapi::{ObjectBuilder, RefOr, Schema};

/// Any value of a parameter. The values themselves are [`Value`]s; this type names their schema.
pub struct ParameterValue;

/// Describes types by JSON Schemas: each type with the name of its component, and an expression for
/// all components that belong to it.
#[macro_export]
macro_rules! json_components {
    ($($type:ty as $name:literal: $components:expr;)*) => {$(
        impl utoipa::PartialSchema for $type {
            fn schema() -> utoipa::openapi::RefOr<utoipa::openapi::Schema> {
                $components.remove($name).map($crate::spec::openapi::keywords).unwrap_or_default()
            }
        }

        impl utoipa::ToSchema for $type {
            fn name() -> std::borrow::Cow<'static, str> {
                $name.into()
            }

            fn schemas(all: &mut Vec<(String, utoipa::openapi::RefOr<utoipa::openapi::Schema>)>) {
                let keywords = $crate::spec::openapi::keywords;
                all.extend($components.into_iter().map(|(name, schema)| (name, keywords(schema))));
            }
        }
    )*};
}
pub use json_components;

json_components! {
    ModelSpec as "SpecPatch": spec_components();
    Study as "Vary": study_components();
    ParameterValue as "ParameterValue": study_components();
}

/// A JSON Schema as a schema of utoipa.
///
/// utoipa has no field for some keywords, such as `const`. It writes extensions under their names
/// even without the prefix `x-`, so every keyword becomes an extension.
#[must_use]
pub fn keywords(schema: Value) -> RefOr<Schema> {
    let Value::Object(keywords) = schema else { return RefOr::default() };
    let object = ObjectBuilder::new().schema_type(SchemaType::AnyValue);
    Schema::Object(object.extensions(Some(keywords.into_iter().collect())).build()).into()
}

/// Components of a JSON Schema: the schema as `name`, and its definitions.
#[must_use]
pub fn components(name: &str, mut schema: Value) -> Map<String, Value> {
    let definitions = schema.as_object_mut().and_then(|members| members.remove("$defs"));
    let mut components = match definitions {
        Some(Value::Object(definitions)) => definitions,
        _ => Map::new(),
    };
    components.insert(name.to_owned(), schema);
    components.values_mut().for_each(move_references);
    components
}

/// Turns references to definitions into references to components.
fn move_references(schema: &mut Value) {
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

fn study_components() -> Map<String, Value> {
    let mut all = components("Vary", study::schema(DEFAULT_MAX_POINTS));
    // Replaces the schedules of the study, which do not allow null.
    all.extend(spec_components());
    all
}

fn spec_components() -> Map<String, Value> {
    let mut whole = schema();
    whole.as_object_mut().and_then(|members| members.remove("$schema"));
    let mut groups = Map::new();
    let mut all = components("SpecPatch", whole);
    for schema in all.values_mut() {
        allow_null(schema, &mut groups);
    }
    all.extend(groups);
    all.values_mut().for_each(hide_defaults);
    all
}

/// Allows null for every member of an object, and moves its groups to components.
fn allow_null(object: &mut Value, groups: &mut Map<String, Value>) {
    // Indexing would insert null if there is no such member.
    for (name, member) in object.get_mut("properties").and_then(Value::as_object_mut).into_iter().flatten() {
        if member.get("properties").is_some() {
            let component = group_component(name);
            let mut group = member.take();
            allow_null(&mut group, groups);
            *member = json!({ "$ref": format!("#/components/schemas/{component}") });
            groups.insert(component, group);
        }
        nullable(member);
    }
}

/// Name of the component of a group: `particles` becomes `ParticlesPatch`.
fn group_component(group: &str) -> String {
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

/// Renames `default` to `x-default`. A generated client would send a `default` and thereby replace
/// the value of another preset.
fn hide_defaults(schema: &mut Value) {
    if let Some(default) = schema.as_object_mut().and_then(|members| members.remove("default")) {
        schema["x-default"] = default;
    }
    for member in schema.get_mut("properties").and_then(Value::as_object_mut).into_iter().flat_map(Map::values_mut) {
        hide_defaults(member);
    }
}
