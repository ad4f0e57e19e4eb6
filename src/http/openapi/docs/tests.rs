//! The page is complete and well formed, its links lead somewhere, it loads nothing, and text
//! cannot become markup.

use super::*;
use crate::http::router::description;
use std::collections::BTreeSet;

fn page() -> String {
    write(description())
}

/// The values of an attribute.
fn attributes<'p>(page: &'p str, name: &str) -> Vec<&'p str> {
    page.split(&format!(" {name}=\"")).skip(1).filter_map(|rest| rest.split('"').next()).collect()
}

#[test]
fn everything_that_is_described_is_shown() {
    let (page, document) = (page(), description());
    let ids: BTreeSet<_> = attributes(&page, "id").into_iter().collect();
    let mut operations = 0;
    for (path, item) in members(&document["paths"]) {
        for (method, operation) in members(item) {
            assert!(ids.contains(text(operation, "operationId")), "{method} {path}");
            assert!(page.contains(&format!("<code>{} {path}</code>", method.to_uppercase())), "{method} {path}");
            for parameter in items(&operation["parameters"]) {
                assert!(page.contains(&format!("<code>{}</code>", text(parameter, "name"))));
            }
            operations += 1;
        }
    }
    assert!(operations > 20, "{operations}");
    for (name, _) in members(&document["components"]["schemas"]) {
        assert!(ids.contains(format!("schema-{name}").as_str()), "{name}");
    }
    for kind in Kind::ALL {
        assert!(page.contains(&format!("<code>{}</code></th><td>{}</td>", kind.slug(), kind.status().as_u16())));
    }
    assert!(page.contains("<a href=\"#schema-CollisionPatch\">"), "groups of a spec");
    assert!(page.contains("<code>gap_um</code>"), "members of groups");
}

/// Number of references to schemas that the page shows: all except those of pairs, of the JSON in
/// events, and of discriminators.
fn references(value: &Value) -> usize {
    match value {
        Value::Object(all) => {
            let is_hidden = |name: &str, value: &Value| match name {
                "prefixItems" => value.is_array(),
                _ => ["contentSchema", "discriminator"].contains(&name),
            };
            all.iter().filter(|(name, value)| !is_hidden(name, value)).map(|(_, value)| references(value)).sum()
        }
        Value::Array(items) => items.iter().map(references).sum(),
        Value::String(target) => usize::from(target.starts_with("#/components/schemas/")),
        _ => 0,
    }
}

#[test]
fn links_lead_somewhere_and_nothing_is_loaded() {
    let page = page();
    let ids = attributes(&page, "id");
    let distinct: BTreeSet<_> = ids.iter().copied().collect();
    assert_eq!(ids.len(), distinct.len(), "an id is used twice");
    let links = attributes(&page, "href");
    for link in &links {
        assert!(*link == "openapi.yaml" || link.strip_prefix('#').is_some_and(|id| distinct.contains(id)), "{link}");
    }
    let document = description();
    let operations: usize = members(&document["paths"]).map(|(_, item)| members(item).count()).sum();
    let schemas = &document["components"]["schemas"];
    let navigation = 1 + items(&document["tags"]).count() + 2;
    let headings = operations + members(schemas).count();
    assert_eq!(links.len(), navigation + headings + references(&document["paths"]) + references(schemas));
    for loading in ["<script", "<link", "<img", " src=", "@import", "url(", "http-equiv", " style="] {
        assert!(!page.contains(loading), "{loading}");
    }
}

/// Each element that is opened is closed, in order.
#[test]
fn it_is_well_formed() {
    let page = page();
    let mut open = Vec::new();
    for tag in page.split('<').skip(1) {
        let (tag, _) = tag.split_once('>').expect("a tag ends");
        let name = tag.split([' ', '\n']).next().unwrap();
        match name.strip_prefix('/') {
            Some(name) => assert_eq!(open.pop(), Some(name), "…{tag}"),
            None if ["!DOCTYPE", "meta", "br"].contains(&name) => {}
            None => open.push(name),
        }
    }
    assert!(open.is_empty(), "{open:?}");
    assert!(page.len() < 512 << 10, "{} bytes", page.len());
}

#[test]
fn text_cannot_become_markup() {
    assert_eq!(prose("a `<b>` c\n\nd").into_string(), "a <code>&lt;b&gt;</code> c<br>d");
    let document = serde_json::json!({ "tags": [{ "name": "<x>", "description": "<x>" }],
        "paths": { "/<x>": { "get": { "tags": ["<x>"], "operationId": "<x>", "parameters": [{ "name": "<x>", "in": "<x>",
            "schema": { "enum": ["<x>"], "pattern": "<x>" } }], "responses": { "200": { "description": "<x>" } } } } },
        "components": { "schemas": { "<x>": { "description": "<x>", "properties": { "<x>": { "$ref": "#/components/schemas/<x>" } } } } } });
    assert!(!write(&document).contains("<x>"));
}
