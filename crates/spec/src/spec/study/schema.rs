//! JSON Schema of a study.

use super::design::Design;
use super::source::DISTRIBUTIONS;
use crate::spec::reader::SEED_MAX;
use serde_json::{Map, Value, json};

/// Schema of a study of at most `max_points` points. Its discriminator names components of an
/// OpenAPI description.
#[must_use]
pub fn schema(max_points: usize) -> Value {
    json!({
        "type": "object",
        "description": "Parameter study: values of parameters, and the design that combines them into points. Each \
            point is grown with each seed.",
        "required": ["design", "values"],
        "additionalProperties": false,
        "properties": {
            "design": { "type": "string", "enum": Design::NAMES.map(|(name, _)| name),
                "description": "`grid`: every combination; the last pointer varies fastest. `zip`: the first values \
                    of all parameters, then the second values, and so on. `lhs`: a Latin hypercube." },
            "samples": { "type": "integer", "minimum": 1, "maximum": max_points, "description": "Number of points; design `lhs` only." },
            // No `default`: a generated client would send it, and other designs refuse it.
            "seed": { "type": "integer", "minimum": 0, "maximum": SEED_MAX,
                "description": "Seed of the design, 0 by default; design `lhs` only. The same seed gives the same \
                    points." },
            "values": { "type": "object", "minProperties": 1, "description": "Values of each parameter, by its JSON \
                pointer in the spec.",
                "additionalProperties": { "$ref": "#/$defs/VariedValues" } },
        },
        "$defs": definitions(max_points),
        "examples": [
            { "design": "lhs", "samples": 50, "seed": 4, "values": {
                "/collision/gap_um": { "from": 25, "to": 50 },
                "/friction": { "distribution": "normal", "mean": 0.3, "sd": 0.03, "min": 0.2, "max": 0.4 } } },
            { "design": "grid", "values": {
                "/collision/gap_um": { "from": 25, "to": 50, "count": 6 }, "/solver/integrator": ["rk4", "euler"] } },
        ],
    })
}

/// Schemas of the values of one parameter. Distributions precede the range, because some have the
/// same members: a reader that takes the first matching alternative then takes the right one.
fn definitions(max_points: usize) -> Value {
    let mut definitions = crate::spec::schema::definitions();
    let own = |name: &str| json!({ "$ref": format!("#/$defs/{name}") });
    let count = json!({ "type": "integer", "minimum": 1, "maximum": max_points,
        "description": "Number of values; required in the designs `grid` and `zip`, not allowed in `lhs`." });
    definitions["ParameterValue"] = json!({
        "description": "Value of a parameter or of a part of a schedule. Null keeps the value of `spec`.",
        "anyOf": [
            { "type": "null" }, { "type": "boolean" }, { "type": "number" }, { "type": "string" },
            { "title": "Keys", "type": "array", "items": own("ScheduleKey") }, own("Schedule"), own("Fluctuation"),
            { "title": "Points or rows", "description": "Points of a curve, or rows of a grid.", "type": "array",
                "items": { "type": "array", "items": { "type": "number" } } },
        ],
    });
    definitions["ValueList"] = json!({ "title": "List", "type": "array", "minItems": 1, "maxItems": max_points,
        "items": own("ParameterValue"), "description": "List of values. In a Latin hypercube, all values are equally \
            likely." });
    definitions["ValueRange"] = json!({ "title": "Range", "type": "object", "additionalProperties": false,
        "required": ["from", "to"],
        "properties": { "from": number("First value."), "to": number("Last value."), "count": count },
        "description": "Values in equal steps from one end to the other. In a Latin hypercube, a uniform \
            distribution." });
    let mut mapping = Map::new();
    for (name, members) in DISTRIBUTIONS {
        let mut properties = Map::new();
        properties.insert("distribution".to_owned(), json!({ "type": "string", "const": name }));
        properties.extend(members.iter().map(|member| ((*member).to_owned(), number(meaning(member)))));
        properties.insert("count".to_owned(), count.clone());
        let needed = members.iter().copied().filter(|member| !["min", "max"].contains(member));
        let required: Vec<&str> = ["distribution"].into_iter().chain(needed).collect();
        let component = component(name);
        mapping.insert(name.to_owned(), format!("#/components/schemas/{component}").into());
        definitions[component] = json!({
            "title": format!("Distribution {name}"), "type": "object", "additionalProperties": false,
            "description": "Distribution of values. The designs `grid` and `zip` use the quantiles in the middle of \
                intervals of equal probability.",
            "required": required,
            "properties": properties,
        });
    }
    let all = DISTRIBUTIONS.map(|(name, _)| own(&component(name)));
    definitions["Distribution"] = json!({ "description": "A distribution of values.", "type": "object", "oneOf": all,
        "discriminator": { "propertyName": "distribution", "mapping": mapping } });
    definitions["VariedValues"] = json!({ "description": "Values of one parameter.",
        "oneOf": [own("ValueList"), own("Distribution"), own("ValueRange")] });
    definitions
}

/// Component name of a distribution.
fn component(distribution: &str) -> String {
    distribution.split('-').map(|word| word[..1].to_uppercase() + &word[1..]).collect()
}

fn number(description: &str) -> Value {
    json!({ "type": "number", "description": description })
}

/// Description of a member of a distribution.
fn meaning(member: &str) -> &'static str {
    match member {
        "from" => "Minimum.",
        "to" => "Maximum.",
        "mode" => "Most likely value.",
        "mean" => "Mean before truncation.",
        "sd" => "Standard deviation before truncation.",
        "median" => "Median before truncation.",
        "sd_log" => "Standard deviation of the natural logarithm before truncation.",
        "min" => "Truncates the distribution from below.",
        _ => "Truncates the distribution from above.",
    }
}
