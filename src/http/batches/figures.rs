//! Figures of models as columns: nested members by dotted names.

use serde_json::Value;
use std::collections::BTreeMap;

/// Adds the figures of `value`, whose name is `name`: members of objects as `name.member`, numbers of lists as `name.0`,
/// and of a list of objects their number.
pub(super) fn add(name: &str, value: &Value, figures: &mut BTreeMap<String, Value>) {
    match value {
        Value::Object(members) => {
            members.iter().for_each(|(member, value)| add(&format!("{name}.{member}"), value, figures));
        }
        Value::Array(items) if items.is_empty() || items.iter().any(Value::is_object) => {
            figures.insert(name.to_owned(), items.len().into());
        }
        Value::Array(items) => {
            items.iter().enumerate().for_each(|(i, value)| add(&format!("{name}.{i}"), value, figures));
        }
        scalar => {
            figures.insert(name.to_owned(), scalar.clone());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn names_are_dotted_and_lists_of_objects_are_counted() {
        let mut figures = BTreeMap::new();
        let summary = json!({ "vertices": 8, "gap": null, "particles": { "start": 1, "end": 2 }, "warnings": [],
            "certificate": { "passed": true, "bounds_um": [[0, 1.5], [2, 3]], "bodies": [{ "euler": 0 }, { "euler": 2 }] } });
        add("summary", &summary, &mut figures);
        let found: Vec<String> = figures.iter().map(|(name, value)| format!("{name}={value}")).collect();
        assert_eq!(
            found,
            [
                "summary.certificate.bodies=2",
                "summary.certificate.bounds_um.0.0=0",
                "summary.certificate.bounds_um.0.1=1.5",
                "summary.certificate.bounds_um.1.0=2",
                "summary.certificate.bounds_um.1.1=3",
                "summary.certificate.passed=true",
                "summary.gap=null",
                "summary.particles.end=2",
                "summary.particles.start=1",
                "summary.vertices=8",
                "summary.warnings=0",
            ]
        );
    }
}
