//! The committed description of the service is the one that the code makes.

/// Write it anew with `cargo run -- openapi > openapi.yaml`, or with `OVIDUCT_BLESS=1 cargo test --test openapi`.
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

#[test]
fn the_description_is_made_the_same_each_time() {
    assert_eq!(oviduct::http::openapi_yaml(), oviduct::http::openapi_yaml());
}

fn document() -> serde_json::Value {
    yaml_serde::from_str(&oviduct::http::openapi_yaml()).expect("it is YAML")
}

#[test]
fn every_reference_leads_somewhere() {
    fn references(value: &serde_json::Value, found: &mut Vec<String>) {
        match value {
            serde_json::Value::Object(members) => {
                found.extend(members.get("$ref").and_then(|r| r.as_str()).map(str::to_owned));
                members.values().for_each(|member| references(member, found));
            }
            serde_json::Value::Array(items) => items.iter().for_each(|item| references(item, found)),
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
    let mut operations = 0;
    for (path, item) in document["paths"].as_object().expect("there are paths") {
        for (method, operation) in item.as_object().expect("a path has operations") {
            operations += 1;
            assert!(operation["summary"].is_string(), "{method} {path}");
            assert!(operation["operationId"].is_string(), "{method} {path}");
            let responses = operation["responses"].as_object().expect("an operation has responses");
            assert!(responses.contains_key("500"), "{method} {path}");
            for (status, response) in responses.iter().filter(|(status, _)| status.as_str() >= "400") {
                assert!(response["content"]["application/problem+json"].is_object(), "{status} of {method} {path}");
            }
            assert!(!path.contains('{') || responses.contains_key("404"), "{method} {path}");
        }
    }
    assert_eq!(operations, 37);
}
