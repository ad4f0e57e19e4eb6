//! JSON Schema of a study.

use super::design::{Design, SEED_MAX};
use super::source::DISTRIBUTIONS;
use serde_json::{Map, Value, json};

/// The schema of a study of at most `most` points.
#[must_use]
pub fn schema(most: usize) -> Value {
    json!({
        "type": "object",
        "description": "A parameter study: values of parameters, and how they are combined to points. Each point is grown with each seed.",
        "required": ["design", "values"],
        "additionalProperties": false,
        "properties": {
            "design": { "type": "string", "enum": Design::NAMES.map(|(name, _)| name),
                "description": "`grid`: every combination, the last pointer varying fastest. `zip`: the first values of all, the second of all, and so on. `lhs`: a Latin hypercube." },
            "samples": { "type": "integer", "minimum": 1, "maximum": most, "description": "Number of points; design `lhs` only." },
            "seed": { "type": "integer", "minimum": 0, "maximum": SEED_MAX, "default": 0,
                "description": "The same seed gives the same points; design `lhs` only." },
            "values": { "type": "object", "minProperties": 1, "description": "The values of each parameter by its JSON pointer in the spec.",
                "additionalProperties": values(most) },
        },
        "examples": [
            { "design": "lhs", "samples": 50, "seed": 4, "values": {
                "/collision/gap_um": { "from": 25, "to": 50 },
                "/friction": { "distribution": "normal", "mean": 0.3, "sd": 0.03, "min": 0.2, "max": 0.4 } } },
            { "design": "grid", "values": {
                "/collision/gap_um": { "from": 25, "to": 50, "count": 6 }, "/solver/integrator": ["rk4", "euler"] } },
        ],
    })
}

/// The schema of any value of a parameter: a number, a name, a schedule or one of its parts; null if there is none.
#[must_use]
pub fn value_schema() -> Value {
    json!({
        "type": ["null", "boolean", "number", "string", "object", "array"],
        "items": { "type": "array", "items": { "type": "number" } },
    })
}

/// The values of one parameter.
fn values(most: usize) -> Value {
    let count = json!({ "type": "integer", "minimum": 1, "maximum": most,
        "description": "Number of values; required in the designs `grid` and `zip`, not allowed in `lhs`." });
    let mut item = value_schema();
    item["description"] = json!("Any value of the parameter; null leaves that of `spec`.");
    let mut forms = vec![
        json!({ "title": "List", "type": "array", "minItems": 1, "maxItems": most, "items": item,
            "description": "These values; in a Latin hypercube all are equally likely." }),
        json!({ "title": "Range", "type": "object", "additionalProperties": false, "required": ["from", "to"],
            "properties": { "from": number("First value."), "to": number("Last value."), "count": count },
            "description": "Equal steps from one end to the other; in a Latin hypercube a uniform distribution." }),
    ];
    for (name, members) in DISTRIBUTIONS {
        let mut properties = Map::new();
        properties.insert("distribution".to_owned(), json!({ "type": "string", "const": name }));
        properties.extend(members.iter().map(|member| ((*member).to_owned(), number(meaning(member)))));
        properties.insert("count".to_owned(), count.clone());
        let needed = members.iter().copied().filter(|member| !["min", "max"].contains(member));
        let required: Vec<&str> = ["distribution"].into_iter().chain(needed).collect();
        forms.push(json!({
            "title": name, "type": "object", "additionalProperties": false,
            "required": required,
            "properties": properties,
        }));
    }
    json!({ "oneOf": forms })
}

fn number(description: &str) -> Value {
    json!({ "type": "number", "description": description })
}

/// The meaning of a member of a distribution.
fn meaning(member: &str) -> &'static str {
    match member {
        "from" => "Least value.",
        "to" => "Greatest value.",
        "mode" => "Most likely value.",
        "mean" => "Mean before truncation.",
        "sd" => "Standard deviation before truncation.",
        "median" => "Median before truncation.",
        "sd_log" => "Standard deviation of the natural logarithm before truncation.",
        "min" => "Truncates the distribution from below.",
        _ => "Truncates the distribution from above.",
    }
}
