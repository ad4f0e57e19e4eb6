//! Bodies of requests for batches: from JSON to a [`BatchRequest`], with all faults in one response.

use crate::http::models::request::{ModelRequest, SEED_MAX, describe, seed};
use crate::http::wire::faults::{Fault, Faults};
use crate::spec::study::Study;
use serde_json::{Value, json};

const MEMBERS: [&str; 12] = [
    "preset", "seeds", "count", "vary", "spec", "outputs", "bodies", "units", "backend", "labels", "priority", "reuse",
];

/// The seeds of a batch.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Seeds {
    /// These seeds.
    These(Vec<u64>),
    /// So many random seeds.
    Count(usize),
}

impl Seeds {
    /// How many there are.
    pub(super) fn len(&self) -> usize {
        match self {
            Self::These(seeds) => seeds.len(),
            Self::Count(count) => *count,
        }
    }
}

/// A request for a batch.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::http) struct BatchRequest {
    pub(super) seeds: Seeds,
    /// The study; its models differ in the parameters that it varies.
    pub(super) study: Option<Study>,
    /// The members that all models have in common.
    pub(super) each: ModelRequest,
}

impl BatchRequest {
    /// Reads a body like [`ModelRequest::read`]; `most` is the greatest number of models.
    pub(super) fn read(body: &Value, most: usize, faults: &mut Faults) -> Self {
        let each = ModelRequest::read_members(body, &MEMBERS, faults);
        let vary = body.get("vary");
        let seeds = match (body.get("seeds"), body.get("count")) {
            (Some(list), None) => seeds(list, most, faults),
            (None, Some(value)) => count(value, most, faults),
            (None, None) if vary.is_some() => Some(Seeds::Count(1)),
            (None, None) if !body.is_object() => None,
            (None, None) => {
                faults.push(Fault::at("", "must have seeds, count or vary"));
                None
            }
            (Some(_), Some(_)) => {
                faults.push(Fault::at("", "must have either seeds or count"));
                None
            }
        };
        let study = vary.and_then(|vary| study(vary, seeds.as_ref().map_or(1, Seeds::len), most, faults));
        Self { seeds: seeds.unwrap_or(Seeds::Count(0)), study, each }
    }

    /// JSON Schema of a request; `most` is the greatest number of models by default. One variant each for `seeds`, for
    /// `count`, and for `vary` without both.
    pub(in crate::http) fn schema(most: usize) -> Value {
        let seeds = json!({ "type": "array", "uniqueItems": true, "minItems": 1, "maxItems": most,
            "items": { "type": "integer", "format": "int64", "minimum": 0, "maximum": SEED_MAX },
            "description": "One model per seed, of each point of a study. The greatest number of models is a setting of the service." });
        let count = json!({ "type": "integer", "minimum": 1, "maximum": most,
            "description": "Number of models, of each point of a study. The service draws their seeds." });
        let variant = |title: &str, description: &str, own: Option<(&str, Value)>| {
            let mut schema = ModelRequest::schema();
            schema["title"] = json!(title);
            schema["description"] = json!(description);
            schema["required"] = json!([own.as_ref().map_or("vary", |(name, _)| name)]);
            if let Some(members) = schema["properties"].as_object_mut() {
                members.remove("seed");
                members.insert("vary".to_owned(), json!({ "$ref": "#/components/schemas/Vary" }));
                members.extend(own.map(|(name, schema)| (name.to_owned(), schema)));
            }
            schema
        };
        json!({
            "description": "Many models of one spec, or of the points of a study. The members other than `seeds`, `count` and \
                `vary` are those of a ModelRequest.",
            "oneOf": [
                { "$ref": "#/$defs/SeedsBatchRequest" },
                { "$ref": "#/$defs/CountBatchRequest" },
                { "$ref": "#/$defs/StudyBatchRequest" },
            ],
            "$defs": {
                "SeedsBatchRequest": variant("Given seeds", "One model per seed, of each point of a study.", Some(("seeds", seeds))),
                "CountBatchRequest": variant("Drawn seeds", "So many models, of each point of a study.", Some(("count", count))),
                "StudyBatchRequest": variant("Study", "One model of each point of a study.", None),
            },
        })
    }
}

/// A study of which each point is grown with `seeds` seeds.
fn study(vary: &Value, seeds: usize, most: usize, faults: &mut Faults) -> Option<Study> {
    let study = match Study::read(vary, most) {
        Ok(study) => study,
        Err(wrong) => {
            faults.extend(wrong.into_iter().map(|fault| Fault::at(format!("/vary{}", fault.pointer), fault.detail)));
            return None;
        }
    };
    let models = study.points().saturating_mul(seeds);
    if models > most {
        let detail = format!(
            "gives {} points, each with {seeds} seeds: {models} models; at most {most} are allowed",
            study.points()
        );
        faults.push(Fault::at("/vary", detail));
        return None;
    }
    Some(study)
}

fn seeds(value: &Value, most: usize, faults: &mut Faults) -> Option<Seeds> {
    let Some(items) = value.as_array() else {
        faults.push(Fault::at("/seeds", format!("must be an array, not {}", describe(value))));
        return None;
    };
    if !(1..=most).contains(&items.len()) {
        faults.push(Fault::at("/seeds", format!("must have 1 to {most} members, not {}", items.len())));
        return None;
    }
    let mut seen = std::collections::BTreeSet::new();
    let mut list = Vec::with_capacity(items.len());
    for (i, item) in items.iter().enumerate() {
        let pointer = format!("/seeds/{i}");
        if let Some(seed) = seed(item, &pointer, faults) {
            if !seen.insert(seed) {
                faults.push(Fault::at(pointer, "is given more than once"));
            }
            list.push(seed);
        }
    }
    Some(Seeds::These(list))
}

fn count(value: &Value, most: usize, faults: &mut Faults) -> Option<Seeds> {
    let whole = value.as_u64().or_else(|| value.as_f64().filter(|x| x.fract() == 0.0 && *x >= 0.0).map(|x| x as u64));
    let count = whole.and_then(|n| usize::try_from(n).ok()).filter(|n| (1..=most).contains(n));
    if count.is_none() {
        faults.push(Fault::at("/count", format!("must be an integer from 1 to {most}, not {}", describe(value))));
    }
    count.map(Seeds::Count)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn a_batch_has_seeds_or_a_count_or_a_study() {
        let read = |body: Value| {
            let mut faults = Faults::default();
            let request = BatchRequest::read(&body, 3, &mut faults);
            if faults.is_empty() {
                Ok(request.seeds)
            } else {
                Err(faults.into_parts().0.into_iter().filter_map(|f| f.pointer).collect())
            }
        };
        assert_eq!(read(json!({"seeds": [7, 8.0]})), Ok(Seeds::These(vec![7, 8])));
        assert_eq!(read(json!({"count": 3, "preset": "pig"})), Ok(Seeds::Count(3)));
        let vary = json!({"design": "grid", "values": {"/steps": [100, 200, 300]}});
        assert_eq!(read(json!({"vary": vary})), Ok(Seeds::Count(1)), "one seed for all points");
        let faults: [(Value, Vec<&str>); 11] = [
            (json!({}), vec![""]),
            (json!({"seeds": [1], "count": 1}), vec![""]),
            (json!({"seeds": []}), vec!["/seeds"]),
            (json!({"seeds": [1, 2, 3, 4]}), vec!["/seeds"]),
            (json!({"seeds": [1, 1, -1]}), vec!["/seeds/1", "/seeds/2"]),
            (json!({"count": 4}), vec!["/count"]),
            (json!({"count": 0}), vec!["/count"]),
            (json!({"count": 2, "seed": 1}), vec!["/seed"]),
            (json!({"count": 2, "vary": {"design": "grid", "values": {"/steps": [1, 2]}}}), vec!["/vary"]),
            (json!({"seeds": [1], "count": 1, "vary": {"design": "grid"}}), vec!["", "/vary/values"]),
            (json!([]), vec![""]),
        ];
        for (body, pointers) in faults {
            assert_eq!(read(body.clone()), Err(pointers.into_iter().map(str::to_owned).collect::<Vec<_>>()), "{body}");
        }
    }

    #[test]
    fn the_schema_names_the_members_that_are_read() {
        let schema = BatchRequest::schema(9);
        let variants = schema["$defs"].as_object().unwrap().values();
        let named: BTreeSet<&str> = variants
            .flat_map(|variant| variant["properties"].as_object().unwrap().keys().map(String::as_str))
            .collect();
        assert_eq!(named, BTreeSet::from(MEMBERS));
    }
}
