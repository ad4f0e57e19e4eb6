//! Specs from the options `--preset`, `--seed`, `--spec` and `--set`.

use super::args::SpecArgs;
use super::exit::Failure;
use crate::spec::{self, ModelSpec, Preset};
use serde_json::{Map, Value};
use std::io::Read;

/// Returns the merge patch on the preset from `--spec` and `--set`; an empty object if neither is
/// given.
///
/// # Errors
/// [`Failure::Usage`] if the file cannot be read or is not a JSON object, or an assignment has no
/// `=`.
pub(super) fn patch(args: &SpecArgs) -> Result<Value, Failure> {
    let mut patch = match &args.spec {
        None => Value::Object(Map::new()),
        Some(path) => {
            let shown = path.display();
            let text = if path.as_os_str() == "-" {
                let mut text = String::new();
                std::io::stdin().read_to_string(&mut text).map(|_| text)
            } else {
                std::fs::read_to_string(path)
            };
            let text = text.map_err(|error| Failure::usage(format!("--spec {shown}: {error}")))?;
            let value: Value =
                serde_json::from_str(&text).map_err(|error| Failure::usage(format!("--spec {shown}: {error}")))?;
            if !value.is_object() {
                return Err(Failure::usage(format!("--spec {shown}: must be a JSON object")));
            }
            value
        }
    };
    for assignment in &args.set {
        assign(&mut patch, assignment).map_err(|fault| Failure::usage(format!("--set {assignment}: {fault}")))?;
    }
    Ok(patch)
}

/// Sets `a.b` of `patch` to the value in `a.b=value`, read as JSON, or as a string if it is not
/// JSON.
fn assign(patch: &mut Value, assignment: &str) -> Result<(), String> {
    let (path, value) = assignment.split_once('=').ok_or("must be written as a.b=value")?;
    if path.split('.').any(str::is_empty) {
        return Err("the name has an empty part".to_owned());
    }
    let mut place = patch;
    for part in path.split('.') {
        if !place.is_object() {
            *place = Value::Object(Map::new());
        }
        place = &mut place[part];
    }
    *place = serde_json::from_str(value).unwrap_or_else(|_| Value::from(value));
    Ok(())
}

/// Returns the preset and the spec that the options describe.
///
/// # Errors
/// [`Failure::Usage`] with every fault, named by JSON pointer as over HTTP.
pub fn resolve(args: &SpecArgs) -> Result<(&'static Preset, ModelSpec), Failure> {
    let preset = spec::preset(&args.preset).ok_or_else(|| {
        let names: Vec<&str> = spec::presets().iter().map(|preset| preset.name.as_str()).collect();
        Failure::usage(format!("/preset: there is no preset `{}`; the presets are {}", args.preset, names.join(", ")))
    })?;
    let faults = match ModelSpec::resolve(preset, &patch(args)?) {
        Ok(spec) => return Ok((preset, spec)),
        Err(faults) => faults,
    };
    Err(Failure::Usage(faults.iter().map(|fault| format!("/spec{}: {}", fault.pointer, fault.detail)).collect()))
}

/// Returns the seed of the options, or a random seed.
#[must_use]
pub fn seed(args: &SpecArgs) -> u64 {
    args.seed.unwrap_or_else(crate::random::draw_seed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn assignments_set_nested_values() {
        let mut patch = json!({ "collision": { "gap_um": 20, "tissue_um": 90 }, "spring": 3 });
        for assignment in [
            "steps=200",
            "collision.gap_um=30.5",
            "solver.search=all_pairs",
            "particles.total=[[0,100],[1,200]]",
            "spring.stiffness={\"keys\":[[0,1]]}",
            "wall.lobing=null",
            "solver.integrator=\"euler\"",
        ] {
            assign(&mut patch, assignment).expect(assignment);
        }
        assert_eq!(
            patch,
            json!({
                "steps": 200,
                "collision": { "gap_um": 30.5, "tissue_um": 90 },
                "solver": { "search": "all_pairs", "integrator": "euler" },
                "particles": { "total": [[0, 100], [1, 200]] },
                "spring": { "stiffness": { "keys": [[0, 1]] } },
                "wall": { "lobing": null },
            })
        );
        for wrong in ["steps", "=4", "a..b=4", ".a=1", "a.=1"] {
            assert!(assign(&mut patch, wrong).is_err(), "{wrong}");
        }
    }
}
