//! Body of a request for a batch: from JSON to a [`BatchRequest`], with all faults in one response.

use crate::http::models::request::ModelRequest;
use crate::spec::study::Study;
use crate::spec::{JsonReader, SEED_MAX};
use serde_json::{Value, json};
use std::collections::BTreeSet;

const MEMBERS: [&str; 12] = [
    "preset", "seeds", "count", "vary", "spec", "outputs", "bodies", "units", "backend", "labels", "priority", "reuse",
];

/// Seeds of a batch, or of each point of its study.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::http) enum BatchSeeds {
    /// Seeds that the request gives.
    Given(Vec<u64>),
    /// Number of seeds that the service draws.
    Drawn(usize),
}

impl BatchSeeds {
    pub(in crate::http) fn len(&self) -> usize {
        match self {
            Self::Given(seeds) => seeds.len(),
            Self::Drawn(count) => *count,
        }
    }
}

/// A request for a batch.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::http) struct BatchRequest {
    pub(in crate::http) seeds: BatchSeeds,
    /// The study; its models differ in the parameters that it varies.
    pub(in crate::http) study: Option<Study>,
    /// Members that all models have in common.
    pub(in crate::http) common: ModelRequest,
}

impl BatchRequest {
    /// Reads a body for at most `max_models` models, as [`ModelRequest::read`] does.
    pub(in crate::http) fn read(reader: &mut JsonReader, body: &Value, max_models: usize) -> Self {
        let common = ModelRequest::read_members(reader, body, &MEMBERS);
        let vary = body.get("vary");
        let seeds = match (body.get("seeds"), body.get("count")) {
            (Some(list), None) => read_seeds(reader, list, max_models),
            (None, Some(count)) => reader.integer("/count", count, 1..=max_models).map(BatchSeeds::Drawn),
            (None, None) if vary.is_some() => Some(BatchSeeds::Drawn(1)),
            (None, None) if !body.is_object() => None,
            (None, None) => reader.fault("", "must have seeds, count or vary"),
            (Some(_), Some(_)) => reader.fault("", "must have either seeds or count"),
        };
        let seeds_per_point = seeds.as_ref().map_or(1, BatchSeeds::len);
        let study = vary.and_then(|vary| read_study(reader, vary, seeds_per_point, max_models));
        Self { seeds: seeds.unwrap_or(BatchSeeds::Drawn(0)), study, common }
    }

    /// JSON Schema of a request for at most `max_models` models. It has a variant for `seeds`, one
    /// for `count`, and one for `vary` without both.
    pub(in crate::http) fn schema(max_models: usize) -> Value {
        let seeds = json!({ "type": "array", "uniqueItems": true, "minItems": 1, "maxItems": max_models,
            "items": { "type": "integer", "format": "int64", "minimum": 0, "maximum": SEED_MAX },
            "description": "Seeds of the models, or of the models of each point of a study. The maximum number of \
                models is a setting of the service." });
        let count = json!({ "type": "integer", "minimum": 1, "maximum": max_models,
            "description": "Number of models; in a study, number of models per point. The service draws the seeds." });
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
                "SeedsBatchRequest": variant("Given seeds", "One model per seed; in a study, one model per point and \
                    seed.", Some(("seeds", seeds))),
                "CountBatchRequest": variant("Drawn seeds", "A number of models, or of models per point of a study, \
                    with seeds that the service draws.", Some(("count", count))),
                "StudyBatchRequest": variant("Study", "One model per point of a study. The service draws one seed \
                    for all points.", None),
            },
        })
    }
}

fn read_study(reader: &mut JsonReader, vary: &Value, seeds_per_point: usize, max_models: usize) -> Option<Study> {
    let study = Study::read(vary, max_models).map_err(|faults| reader.extend("/vary", faults)).ok()?;
    let points = study.points();
    let models = points.saturating_mul(seeds_per_point);
    if models > max_models {
        let detail = format!(
            "gives {points} points, each with {seeds_per_point} seeds: {models} models; at most {max_models} are \
                allowed"
        );
        return reader.fault("/vary", detail);
    }
    Some(study)
}

fn read_seeds(reader: &mut JsonReader, value: &Value, max_models: usize) -> Option<BatchSeeds> {
    let items = reader.array("/seeds", value)?;
    if !(1..=max_models).contains(&items.len()) {
        return reader.fault("/seeds", format!("must have 1 to {max_models} members, not {}", items.len()));
    }
    let mut seen = BTreeSet::new();
    let mut seeds = Vec::with_capacity(items.len());
    for (i, item) in items.iter().enumerate() {
        let at = format!("/seeds/{i}");
        let Some(seed) = reader.integer(&at, item, 0..=SEED_MAX) else { continue };
        if !seen.insert(seed) {
            reader.fault::<()>(at, "is given more than once");
        }
        seeds.push(seed);
    }
    Some(BatchSeeds::Given(seeds))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::http::wire::faults::body_reader;
    use crate::spec::Fault;

    #[test]
    fn a_batch_has_seeds_or_a_count_or_a_study() {
        let read = |body: Value| {
            let mut reader = body_reader();
            let request = BatchRequest::read(&mut reader, &body, 3);
            let faults = |faults: Vec<Fault>| faults.into_iter().map(|fault| fault.pointer).collect();
            reader.finish(Some(request.seeds)).map_err(faults)
        };
        assert_eq!(read(json!({"seeds": [7, 8.0]})), Ok(BatchSeeds::Given(vec![7, 8])));
        assert_eq!(read(json!({"count": 3, "preset": "pig"})), Ok(BatchSeeds::Drawn(3)));
        let vary = json!({"design": "grid", "values": {"/steps": [100, 200, 300]}});
        assert_eq!(read(json!({"vary": vary})), Ok(BatchSeeds::Drawn(1)), "one seed for all points");
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
