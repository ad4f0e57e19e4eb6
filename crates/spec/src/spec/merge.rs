//! Merge patches (RFC 7396) on the values of a preset, with two differences from the RFC.
//!
//! - `null` restores the value of the preset, because a parameter cannot be absent.
//! - If the patch has an object for a schedule that is a number, the number becomes the keys `[[0,
//!   v], [1, v]]`. A fluctuation can therefore be added to any parameter.
//!
//! As in the RFC, a number replaces a whole schedule, an object replaces the members that it names,
//! and the array `keys` is replaced as a whole.

use super::fault::{child, nearest};
use super::parameters::table;
use super::reader::JsonReader;
use super::table::{Field, Kind};
use serde_json::{Map, Value, json};

/// Applies `patch`, whose pointer is `at`, to `base`, the values of `fields`. Unknown members are
/// dropped and recorded as faults; other values are copied unchecked.
pub(super) fn merge(fields: &[Field], base: &Value, patch: &Value, at: &str, reader: &mut JsonReader) -> Value {
    let mut merged = base.as_object().cloned().unwrap_or_default();
    let members = if patch.is_null() { None } else { reader.object(at, patch) };
    let Some(members) = members else { return Value::Object(merged) };
    let known = |name: &str| fields.iter().any(|field| field.name == name);
    reader.unknown(at, members.keys().filter(|name| !known(name)), |name| hint(fields, name));
    for (name, value) in members {
        let here = child(at, name);
        let Some(field) = fields.iter().find(|field| field.name == name) else {
            continue;
        };
        let old = merged.get(name).cloned().unwrap_or_default();
        let new = match (&field.kind, value) {
            (_, Value::Null) => continue,
            (Kind::Group(fields), _) => merge(fields, &old, value, &here, reader),
            (Kind::Schedule(_), Value::Object(members)) => schedule(&old, members),
            _ => value.clone(),
        };
        merged.insert(name.clone(), new);
    }
    Value::Object(merged)
}

/// Applies an object to a schedule.
fn schedule(base: &Value, patch: &Map<String, Value>) -> Value {
    let base = match base {
        Value::Object(members) => members.clone(),
        Value::Number(v) => Map::from_iter([("keys".to_owned(), json!([[0, v], [1, v]]))]),
        _ => Map::new(),
    };
    let mut merged = overlaid(&base, patch);
    if let Some(Value::Object(wave)) = patch.get("fluctuation") {
        let old = base.get("fluctuation").and_then(Value::as_object).cloned().unwrap_or_default();
        merged.insert("fluctuation".to_owned(), Value::Object(overlaid(&old, wave)));
    }
    Value::Object(merged)
}

/// Members of `base`, replaced by the members of `patch` that are not null.
fn overlaid(base: &Map<String, Value>, patch: &Map<String, Value>) -> Map<String, Value> {
    let mut merged = base.clone();
    merged.extend(patch.iter().filter(|(_, v)| !v.is_null()).map(|(k, v)| (k.clone(), v.clone())));
    merged
}

/// Hint for a message: the parameter that was probably meant by an unknown name, or the known
/// names.
pub(super) fn hint(fields: &[Field], name: &str) -> String {
    if let Some(near) = nearest(name, fields.iter().map(|field| field.name)) {
        return format!("; did you mean `{near}`?");
    }
    if let Some(pointer) = elsewhere(table(), name, "") {
        return format!("; did you mean `{pointer}`?");
    }
    let known: Vec<&str> = fields.iter().map(|field| field.name).collect();
    format!("; known are {}", known.join(", "))
}

/// Pointer of a parameter with this name anywhere in the table.
fn elsewhere(fields: &[Field], name: &str, at: &str) -> Option<String> {
    fields.iter().find_map(|field| {
        let here = child(at, field.name);
        match &field.kind {
            _ if field.name == name => Some(here),
            Kind::Group(fields) => elsewhere(fields, name, &here),
            _ => None,
        }
    })
}
