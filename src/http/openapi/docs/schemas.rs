//! Schemas of bodies as tables.

use super::html::{escape, items, members, prose, table, text};
use serde_json::Value;

const REFERENCE: &str = "#/components/schemas/";

/// All schemas of the description.
pub(super) fn all(schemas: &Value) -> String {
    let each: String = members(schemas).map(|(name, schema)| one(name, schema)).collect();
    format!("<section aria-labelledby=\"schemas\">\n<h2 id=\"schemas\">schemas</h2>\n{each}</section>\n")
}

fn one(name: &str, schema: &Value) -> String {
    let mut rows = Vec::new();
    describe(schema, "", &mut rows);
    let what = match rows.is_empty() {
        true => format!("<p>{}</p>\n", kind(schema)),
        false => String::new(),
    };
    let description = match text(schema, "description") {
        "" => String::new(),
        description => format!("<p>{}</p>\n", prose(description)),
    };
    format!(
        "<article id=\"schema-{name}\">\n<h3><a href=\"#schema-{name}\">{name}</a></h3>\n{description}{what}{}</article>\n",
        table("Members", &["Name", "Type", "Meaning"], &rows),
        name = escape(name),
    )
}

/// A row for each member of an object and of its nested objects.
fn describe(schema: &Value, before: &str, rows: &mut Vec<String>) {
    for part in items(&schema["allOf"]) {
        match reference(part) {
            Some(_) => rows.push(format!("<td colspan=\"3\">all of {}</td>", kind(part))),
            None => describe(part, before, rows),
        }
    }
    for (name, member) in members(&schema["properties"]) {
        let required = if items(&schema["required"]).any(|r| r == name) { ", required" } else { "" };
        let full = format!("{before}{name}");
        let (title, description) = (text(member, "title"), text(member, "description"));
        let title = if description.starts_with(title) { "" } else { title };
        let meaning: Vec<String> = [title, description].into_iter().filter(|t| !t.is_empty()).map(prose).collect();
        rows.push(format!(
            "<th scope=\"row\"><code>{}</code></th><td>{}{required}</td><td>{}</td>",
            escape(&full),
            kind(member),
            meaning.join(": "),
        ));
        if reference(member).is_none() {
            describe(member, &format!("{full}."), rows);
        }
    }
}

fn reference(schema: &Value) -> Option<&str> {
    schema["$ref"].as_str()?.strip_prefix(REFERENCE)
}

/// The type of a value, in one line.
pub(super) fn kind(schema: &Value) -> String {
    if let Some(name) = reference(schema) {
        return format!("<a href=\"#schema-{0}\">{0}</a>", escape(name));
    }
    let alternatives: Vec<String> = ["oneOf", "anyOf"].into_iter().flat_map(|m| items(&schema[m])).map(kind).collect();
    let what = if !alternatives.is_empty() {
        alternatives.join(" or ")
    } else if schema["enum"].is_array() {
        items(&schema["enum"]).map(value).collect::<Vec<_>>().join(" or ")
    } else if schema["allOf"].is_array() {
        "object".to_owned()
    } else {
        match &schema["type"] {
            Value::String(name) => simple(schema, name),
            Value::Array(names) => {
                names.iter().filter_map(Value::as_str).map(|name| simple(schema, name)).collect::<Vec<_>>().join(" or ")
            }
            _ => "any value".to_owned(),
        }
    };
    format!("{what}{}", bounds(schema))
}

fn simple(schema: &Value, name: &str) -> String {
    match (name, schema.get("items"), schema.get("additionalProperties")) {
        ("array", Some(item), _) if item["prefixItems"].is_array() => "array of pairs".to_owned(),
        ("array", Some(item), _) => format!("array of {}", kind(item)),
        ("object", _, Some(each)) if each.is_object() => format!("object of {}", kind(each)),
        _ => escape(name),
    }
}

fn value(value: &Value) -> String {
    format!("<code>{}</code>", escape(&value.as_str().map_or_else(|| value.to_string(), str::to_owned)))
}

/// Bounds, unit and default, each after a comma.
fn bounds(schema: &Value) -> String {
    let mut parts = Vec::new();
    for (least, most, of) in [
        ("minimum", "maximum", ""),
        ("minLength", "maxLength", " characters"),
        ("minItems", "maxItems", " items"),
        ("minProperties", "maxProperties", " members"),
    ] {
        match (schema.get(least), schema.get(most)) {
            (Some(least), Some(most)) => parts.push(format!("{least} to {most}{of}")),
            (Some(least), None) => parts.push(format!("at least {least}{of}")),
            (None, Some(most)) => parts.push(format!("at most {most}{of}")),
            (None, None) => {}
        }
    }
    if let Some(unit) = schema["x-unit"].as_str().filter(|unit| !unit.is_empty()) {
        parts.push(escape(unit));
    }
    if let Some(pattern) = schema.get("pattern") {
        parts.push(format!("matches {}", value(pattern)));
    }
    if let Some(default) =
        schema.get("default").or_else(|| schema.get("x-default")).filter(|default| !default.is_object())
    {
        parts.push(format!("default {}", value(default)));
    }
    parts.into_iter().fold(String::new(), |all, part| format!("{all}, {part}"))
}
