//! Schemas of bodies as tables.

use super::html::{items, joined, members, prose, table, text};
use maud::{Markup, html};
use serde_json::Value;

/// All schemas of the description.
pub(super) fn all(schemas: &Value) -> Markup {
    html! {
        section aria-labelledby="schemas" {
            h2 id="schemas" { "schemas" }
            @for (name, schema) in members(schemas) { (article(name, schema)) }
        }
    }
}

fn article(name: &str, schema: &Value) -> Markup {
    let mut rows = Vec::new();
    describe(schema, "", &mut rows);
    let description = text(schema, "description");
    html! {
        article id={ "schema-" (name) } {
            h3 { (link(name)) }
            @if !description.is_empty() { p { (prose(description)) } }
            @if rows.is_empty() { p { (kind(schema)) } }
            (table("Members", &["Name", "Type", "Meaning"], rows))
        }
    }
}

/// Adds a row for each member of an object and of its nested objects.
fn describe(schema: &Value, before: &str, rows: &mut Vec<Markup>) {
    for part in items(&schema["allOf"]) {
        match reference(part) {
            Some(name) => rows.push(html! { td colspan="3" { "all of " (link(name)) } }),
            None => describe(part, before, rows),
        }
    }
    for (name, member) in members(&schema["properties"]) {
        let is_required = items(&schema["required"]).any(|required| required == name);
        let full = format!("{before}{name}");
        let (title, description) = (text(member, "title"), text(member, "description"));
        let title = if description.starts_with(title) { "" } else { title };
        let meaning = [title, description].into_iter().filter(|text| !text.is_empty()).map(prose);
        rows.push(html! {
            th scope="row" { code { (full) } }
            td { (kind(member)) @if is_required { ", required" } }
            td { (joined(meaning, &html! { ": " })) }
        });
        if reference(member).is_none() {
            describe(member, &format!("{full}."), rows);
        }
    }
}

/// Name of the component that a schema refers to.
fn reference(schema: &Value) -> Option<&str> {
    schema["$ref"].as_str()?.strip_prefix("#/components/schemas/")
}

fn link(name: &str) -> Markup {
    html! { a href={ "#schema-" (name) } { (name) } }
}

/// The type of a value, in one line.
pub(super) fn kind(schema: &Value) -> Markup {
    if let Some(name) = reference(schema) {
        return link(name);
    }
    let alternatives: Vec<Markup> = ["oneOf", "anyOf"].into_iter().flat_map(|m| items(&schema[m])).map(kind).collect();
    let kind = if !alternatives.is_empty() {
        any_of(alternatives)
    } else if schema["enum"].is_array() {
        any_of(items(&schema["enum"]).map(value))
    } else if schema["allOf"].is_array() {
        html! { "object" }
    } else {
        match &schema["type"] {
            Value::String(name) => simple(schema, name),
            Value::Array(names) => any_of(names.iter().filter_map(Value::as_str).map(|name| simple(schema, name))),
            _ => html! { "any value" },
        }
    };
    html! { (kind) (constraints(schema)) }
}

fn any_of(kinds: impl IntoIterator<Item = Markup>) -> Markup {
    joined(kinds.into_iter(), &html! { " or " })
}

fn simple(schema: &Value, name: &str) -> Markup {
    match (name, schema.get("items"), schema.get("additionalProperties")) {
        ("array", Some(item), _) if item["prefixItems"].is_array() => html! { "array of pairs" },
        ("array", Some(item), _) => html! { "array of " (kind(item)) },
        ("object", _, Some(each)) if each.is_object() => html! { "object of " (kind(each)) },
        _ => html! { (name) },
    }
}

fn value(value: &Value) -> Markup {
    html! { code { (value.as_str().map_or_else(|| value.to_string(), str::to_owned)) } }
}

/// Bounds, unit, pattern and default, each after a comma.
fn constraints(schema: &Value) -> Markup {
    let mut parts = Vec::new();
    for (min, max, unit) in [
        ("minimum", "maximum", ""),
        ("minLength", "maxLength", " characters"),
        ("minItems", "maxItems", " items"),
        ("minProperties", "maxProperties", " members"),
    ] {
        match (schema.get(min), schema.get(max)) {
            (Some(min), Some(max)) => parts.push(html! { (min) " to " (max) (unit) }),
            (Some(min), None) => parts.push(html! { "at least " (min) (unit) }),
            (None, Some(max)) => parts.push(html! { "at most " (max) (unit) }),
            (None, None) => {}
        }
    }
    if let Some(unit) = schema["x-unit"].as_str().filter(|unit| !unit.is_empty()) {
        parts.push(html! { (unit) });
    }
    if let Some(pattern) = schema.get("pattern") {
        parts.push(html! { "matches " (value(pattern)) });
    }
    if let Some(default) = schema.get("default").or_else(|| schema.get("x-default")).filter(|of| !of.is_object()) {
        parts.push(html! { "default " (value(default)) });
    }
    html! { @for part in parts { ", " (part) } }
}
