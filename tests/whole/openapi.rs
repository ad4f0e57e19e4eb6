//! The committed API description is the one that the code generates, and its examples match its
//! schemas.

use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

/// To regenerate the file, run `cargo run -- openapi > openapi.yaml` or `OVIDUCT_BLESS=1 cargo test
/// --test whole openapi::`.
#[test]
fn the_committed_description_is_up_to_date() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/openapi.yaml");
    let made = oviduct::http::openapi_yaml();
    if std::env::var_os("OVIDUCT_BLESS").is_some() {
        std::fs::write(path, &made).expect("openapi.yaml can be written");
    }
    let committed = std::fs::read_to_string(path).unwrap_or_default();
    assert!(made == committed, "openapi.yaml is not what the code makes: cargo run -- openapi > openapi.yaml");
}

/// `scripts/clients` regenerates the types and compares the whole file. This test compares only the
/// digest and needs no Node.
#[test]
fn the_types_of_the_typescript_client_are_of_the_committed_description() {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/");
    let description = std::fs::read(format!("{root}openapi.yaml")).expect("openapi.yaml can be read");
    let types = std::fs::read_to_string(format!("{root}clients/typescript/src/schema.ts")).expect("types can be read");
    let digest: String = Sha256::digest(&description).iter().map(|byte| format!("{byte:02x}")).collect();
    let line = format!("// openapi.yaml: sha256 {digest}");
    assert!(types.lines().any(|each| each == line), "run `npm run generate` in clients/typescript: no line {line}");
}

/// Each process seeds its hash maps differently; the order of members must not depend on that.
#[test]
fn every_process_generates_the_same_description() {
    let here = oviduct::http::openapi_yaml();
    for _ in 0..3 {
        let output = Command::new(env!("CARGO_BIN_EXE_oviduct")).arg("openapi").output().expect("the program runs");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        assert!(output.stdout == here.as_bytes(), "`oviduct openapi` prints another description");
    }
}

/// Two types with one name would share a schema, which describes only one of them.
#[test]
fn no_two_types_have_the_same_schema() {
    fn names(folder: &Path, found: &mut Vec<String>) {
        for path in std::fs::read_dir(folder).expect("there").map(|entry| entry.expect("there").path()) {
            if path.is_dir() {
                names(&path, found);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let text = std::fs::read_to_string(&path).expect("text");
                // Attributes may stand between the derive and the item.
                let items = text
                    .split("ToSchema)")
                    .skip(1)
                    .filter(|rest| !rest.starts_with(", schema(as = "))
                    .filter_map(|rest| {
                        let line = rest.lines().find(|line| line.trim_start().starts_with("pub"))?;
                        let mut words =
                            line.split(|c: char| !c.is_alphanumeric()).skip_while(|w| !["struct", "enum"].contains(w));
                        words.nth(1)
                    });
                found.extend(items.map(str::to_owned));
            }
        }
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut found = Vec::new();
    ["src", "crates"].iter().for_each(|folder| names(&root.join(folder), &mut found));
    assert!(found.len() > 100, "{}", found.len());
    found.sort_unstable();
    let twice: Vec<&String> = found.windows(2).filter(|pair| pair[0] == pair[1]).map(|pair| &pair[0]).collect();
    assert!(twice.is_empty(), "types with the same name: {twice:?}");
}

fn document() -> Value {
    yaml_serde::from_str(&oviduct::http::openapi_yaml()).expect("it is YAML")
}

#[test]
fn every_reference_has_a_target() {
    fn references(value: &Value, found: &mut Vec<String>) {
        match value {
            Value::Object(members) => {
                found.extend(members.get("$ref").and_then(|r| r.as_str()).map(str::to_owned));
                members.values().for_each(|member| references(member, found));
            }
            Value::Array(items) => items.iter().for_each(|item| references(item, found)),
            _ => {}
        }
    }
    let document = document();
    let mut found = Vec::new();
    references(&document, &mut found);
    assert!(found.len() > 20);
    for reference in found {
        let pointer = reference.strip_prefix('#').expect("references stay within the document");
        assert!(document.pointer(pointer).is_some(), "{reference} leads nowhere");
    }
}

#[test]
fn every_operation_has_a_summary_and_documents_its_faults() {
    let document = document();
    let (mut operations, mut ids) = (0, BTreeSet::new());
    for (path, item) in document["paths"].as_object().expect("there are paths") {
        for (method, operation) in item.as_object().expect("a path has operations") {
            operations += 1;
            assert!(operation["summary"].is_string(), "{method} {path}");
            assert!(operation["description"].is_string(), "{method} {path}");
            assert!(ids.insert(operation["operationId"].clone().to_string()), "{method} {path}");
            assert!(operation["operationId"].is_string(), "{method} {path}");
            let responses = operation["responses"].as_object().expect("an operation has responses");
            assert!(responses.contains_key("500"), "{method} {path}");
            for (status, response) in responses.iter().filter(|(status, _)| status.as_str() >= "400") {
                assert!(response["content"]["application/problem+json"].is_object(), "{status} of {method} {path}");
            }
            assert!(!path.contains('{') || responses.contains_key("404"), "{method} {path}");
        }
    }
    assert_eq!(operations, 53);
}

/// All schemas of a document by JSON pointer: the value of each `schema` and `schemas`, and the
/// schemas inside them.
fn schemas(place: &str, value: &Value, found: &mut Vec<(String, Value)>) {
    for (name, member) in value.as_object().into_iter().flatten() {
        let here = format!("{place}/{name}");
        match name.as_str() {
            // These members contain values, not schemas.
            "example" | "examples" | "default" | "x-default" | "enum" => {}
            "schema" | "items" | "additionalProperties" | "propertyNames" | "not" | "contentSchema" => {
                found.push((here.clone(), member.clone()));
                schemas(&here, member, found);
            }
            "schemas" | "properties" => {
                for (name, schema) in member.as_object().into_iter().flatten() {
                    let here = format!("{here}/{name}");
                    found.push((here.clone(), schema.clone()));
                    schemas(&here, schema, found);
                }
            }
            "oneOf" | "anyOf" | "allOf" | "prefixItems" => {
                for (i, schema) in member.as_array().into_iter().flatten().enumerate() {
                    let here = format!("{here}/{i}");
                    found.push((here.clone(), schema.clone()));
                    schemas(&here, schema, found);
                }
            }
            _ => schemas(&here, member, found),
        }
    }
}

#[test]
fn no_schema_is_empty() {
    let mut found = Vec::new();
    schemas("", &document(), &mut found);
    assert!(found.len() > 500, "{}", found.len());
    for (place, schema) in found {
        let closed = schema == false && place.ends_with("/additionalProperties");
        assert!(closed || schema.as_object().is_some_and(|members| !members.is_empty()), "{place} is {schema}");
        let free = schema["type"] == "object"
            && ["properties", "additionalProperties", "oneOf"].iter().all(|m| schema[m].is_null());
        assert!(!free, "{place} has no members");
        assert!(schema["type"] != "array" || schema["items"].is_object(), "{place} has no items");
    }
}

#[test]
fn every_media_type_has_a_schema_and_its_examples_fit_it() {
    let document = document();
    let mut used = BTreeSet::new();
    let mut check = |place: &str, content: &Value| {
        for (media_type, content) in content.as_object().into_iter().flatten() {
            assert!(content["schema"].is_object(), "{place}: {media_type}");
            let whole = json!({ "allOf": [content["schema"]], "components": document["components"] });
            let validator =
                jsonschema::draft202012::options().should_validate_formats(true).build(&whole).expect("a schema");
            for (name, example) in content["examples"].as_object().into_iter().flatten() {
                let pointer = example["$ref"].as_str().and_then(|r| r.strip_prefix('#')).expect("it is a component");
                let value = &document.pointer(pointer).expect("it exists")["value"];
                let errors: Vec<_> =
                    validator.iter_errors(value).map(|e| format!("{} {e}", e.instance_path())).collect();
                assert!(errors.is_empty(), "{name} of {place}: {errors:?}");
                used.insert(name.clone());
            }
        }
    };
    for (path, item) in document["paths"].as_object().expect("there are paths") {
        for (method, operation) in item.as_object().expect("a path has operations") {
            check(&format!("{method} {path}"), &operation["requestBody"]["content"]);
            for (status, response) in operation["responses"].as_object().expect("an operation has responses") {
                check(&format!("{method} {path} {status}"), &response["content"]);
            }
        }
    }
    let all: BTreeSet<_> =
        document["components"]["examples"].as_object().expect("there are some").keys().cloned().collect();
    assert_eq!(used, all, "each example is used");
    // The data of an event is JSON in a string. Validators do not apply the schema of such content.
    let event = json!({ "$ref": "#/components/schemas/ModelEvent", "components": document["components"] });
    let data = document["components"]["examples"]["Event"]["value"]["data"].as_str().expect("it is text");
    assert!(jsonschema::is_valid(&event, &serde_json::from_str(data).expect("it is JSON")));
}
