//! Request for a fit as JSON: targets, varied parameters, and the effort of the search.

use super::target::{TOLERANCE, Target, refused};
use super::variable::Variable;
use crate::generate::{Cost, Outputs};
use crate::spec::{
    DEFAULT_PRESET, End, Fault, Integrator, JsonReader, Lever, ModelSpec, Preset, SEED_MAX, integer_in, preset, presets,
};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use sha2::{Digest, Sha256};
use std::fmt::Display;
use std::ops::RangeInclusive;

/// Members of a request that describe the fit.
pub const MEMBERS: [&str; 9] =
    ["preset", "spec", "targets", "targets_csv", "vary", "evaluations", "seeds", "models", "seed"];
/// Maximum number of targets.
pub const MOST_TARGETS: usize = 100;
/// Maximum number of variables.
pub const MOST_VARIABLES: usize = 20;
/// Maximum and default number of candidates.
pub const EVALUATIONS: [u32; 2] = [2000, 70];
/// Maximum and default number of seeds of the search.
pub const SEEDS: [u32; 2] = [16, 4];
/// Maximum and default number of models that are grown in full at the end.
pub const MODELS: [u32; 2] = [20, 4];
/// Number of candidates per candidate that is measured with the physics of the spec.
const REFINED: u32 = 6;
/// Factor on the number of seeds for measures that cost little.
pub(super) const EARLY_SEEDS: u32 = 4;
/// Maximum absolute number in a target; no measure comes near it.
const LARGEST: f64 = 1e12;
/// Maximum of `seed`. All seeds that are counted from it are valid.
const FIRST_SEED_MAX: u64 = SEED_MAX - (EARLY_SEEDS * SEEDS[0] + MODELS[0]) as u64;

/// Physics of the simulation of a candidate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Physics {
    /// Reduced physics, [`FitSpec::reduced`].
    Reduced,
    /// Physics of the spec.
    Whole,
}

/// Specification of a fit, valid by construction.
#[derive(Clone, Debug, PartialEq)]
pub struct FitSpec {
    pub(super) preset: &'static Preset,
    /// Spec from which the search starts.
    pub(super) start: ModelSpec,
    pub(super) targets: Vec<Target>,
    pub(super) variables: Vec<Variable>,
    /// Maximum number of candidates.
    pub(super) evaluations: u32,
    /// Number of seeds of each candidate.
    pub(super) seeds: u32,
    /// Number of models of the result that are grown in full.
    pub(super) models: u32,
    pub(super) seed: u64,
}

/// Value, low end and high end of a requested target.
type RequestedRange = [Option<f64>; 3];

impl FitSpec {
    /// Reads a request. `measured` contains targets from images, `others` the names of members that
    /// the caller reads.
    ///
    /// # Errors
    /// Returns all faults.
    pub fn read(body: &Value, measured: Vec<Target>, others: &[&str]) -> Result<Self, Vec<Fault>> {
        let mut reader = JsonReader::default();
        let fit = Self::read_members(&mut reader, body, measured, others);
        reader.finish(fit)
    }

    fn read_members(reader: &mut JsonReader, body: &Value, measured: Vec<Target>, others: &[&str]) -> Option<Self> {
        let members = reader.members("", body, &[&MEMBERS[..], others].concat())?;
        let preset = read_preset(reader, members);
        let start = preset.and_then(|preset| read_spec(reader, preset, members));
        let mut targets = measured;
        targets.extend(read_targets(reader, members));
        if let Some(text) = members.get("targets_csv") {
            targets.extend(read_csv(reader, text).into_iter().flatten());
        }
        if targets.is_empty() && reader.count() == 0 {
            reader.fault::<()>("/targets", "at least one target is needed");
        }
        if targets.len() > MOST_TARGETS {
            let detail = format!("there are {} targets; at most {MOST_TARGETS} are allowed", targets.len());
            reader.fault::<()>("/targets", detail);
        }
        let variables = start.as_ref().and_then(|start| read_variables(reader, members, &targets, start));
        let evaluations = read_integer(reader, members, "evaluations", 1..=EVALUATIONS[0], EVALUATIONS[1]);
        let seeds = read_integer(reader, members, "seeds", 1..=SEEDS[0], SEEDS[1]);
        let models = read_integer(reader, members, "models", 1..=MODELS[0], MODELS[1]);
        let seed = read_integer(reader, members, "seed", 0..=FIRST_SEED_MAX, 0);
        Some(Self {
            preset: preset?,
            start: start?,
            targets,
            variables: variables?,
            evaluations: evaluations?,
            seeds: seeds?,
            models: models?,
            seed: seed?,
        })
    }

    /// The request with all defaults, as JSON that [`FitSpec::read`] reads.
    #[must_use]
    pub fn to_json(&self) -> Value {
        let vary: Vec<_> = self.variables.iter().map(Variable::shown).collect();
        json!({
            "preset": self.preset.name, "spec": self.start.to_json(), "targets": self.targets, "vary": vary,
            "evaluations": self.evaluations, "seeds": self.seeds, "models": self.models, "seed": self.seed,
        })
    }

    /// SHA-256 of everything that the result depends on, in lower-case hex.
    #[must_use]
    pub fn digest(&self) -> String {
        let whole = json!({ "engine": crate::ENGINE_VERSION, "fit": self.to_json() });
        hex::encode(Sha256::digest(crate::spec::canonical_json(&whole)))
    }

    /// Preset of the spec.
    #[must_use]
    pub fn preset(&self) -> &'static Preset {
        self.preset
    }

    /// First seed.
    #[must_use]
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// Specs for the prediction of memory: the one from which the search starts and, if it is
    /// valid, the one with all variables at their upper bounds, which costs most for most
    /// variables.
    pub fn extremes(&self) -> impl Iterator<Item = ModelSpec> {
        std::iter::once(self.start.clone()).chain(self.at(&vec![1.0; self.variables.len()]))
    }

    /// Predicted seconds on one core for the maximum number of candidates, each like the start.
    #[must_use]
    pub fn predicted_seconds(&self) -> f64 {
        let seconds = |spec: &ModelSpec| Cost::new(spec, &Outputs::none()).longest_seconds();
        let [reduced, whole] = [self.explored() * self.seeds, self.refined() * self.seeds + self.models].map(f64::from);
        reduced * seconds(&self.reduced(self.start.clone())) + whole * seconds(&self.start)
    }

    /// Maximum number of candidates that are measured with the physics of the spec after the search
    /// on reduced models.
    pub(super) fn refined(&self) -> u32 {
        if self.start.solver.integrator == Integrator::Euler { 0 } else { self.evaluations.div_ceil(REFINED) }
    }

    /// Maximum number of candidates of the search on reduced models.
    pub(super) fn explored(&self) -> u32 {
        self.evaluations - self.refined()
    }

    /// The spec with Euler steps, if they are stable. They take a third of the time, and nearly all
    /// measures are equal on average.
    pub(super) fn reduced(&self, spec: ModelSpec) -> ModelSpec {
        let mut whole = spec.to_json();
        whole["solver"]["integrator"] = Integrator::Euler.name().into();
        ModelSpec::resolve(self.preset, &whole).unwrap_or(spec)
    }

    pub(super) fn search_seeds(&self) -> impl Iterator<Item = u64> {
        (0..u64::from(self.seeds)).map(|k| self.seed + k)
    }

    /// Seeds of the models of the result. The search does not use them.
    pub(super) fn model_seeds(&self) -> impl Iterator<Item = u64> {
        (0..u64::from(self.models)).map(|k| self.seed + u64::from(EARLY_SEEDS * self.seeds) + k)
    }

    /// Specification at places between the bounds, from 0 to 1.
    pub(super) fn at(&self, places: &[f64]) -> Result<ModelSpec, Vec<Fault>> {
        let settings: Vec<_> =
            self.variables.iter().zip(places).map(|(v, &place)| (&v.lever, v.end, v.at(place))).collect();
        self.start.with(self.preset, &settings)
    }
}

/// The member of this name, if it is not null.
fn given<'a>(members: &'a Map<String, Value>, name: &str) -> Option<&'a Value> {
    members.get(name).filter(|value| !value.is_null())
}

fn read_preset(reader: &mut JsonReader, members: &Map<String, Value>) -> Option<&'static Preset> {
    let name = members.get("preset").map_or(Some(DEFAULT_PRESET), Value::as_str);
    name.and_then(preset).or_else(|| {
        let names: Vec<&str> = presets().iter().map(|preset| preset.name.as_str()).collect();
        reader.fault("/preset", format!("is unknown; the presets are {}", names.join(", ")))
    })
}

fn read_spec(reader: &mut JsonReader, preset: &'static Preset, members: &Map<String, Value>) -> Option<ModelSpec> {
    let none = json!({});
    let resolved = ModelSpec::resolve(preset, members.get("spec").unwrap_or(&none));
    if resolved.as_ref().is_ok_and(|spec| spec.recorded() != (0..=spec.steps)) {
        reader.fault::<()>(
            "/spec/piece",
            "must be the whole tube: from 0 to 1; models of a piece can be made of the result",
        );
    }
    resolved.map_err(|faults| reader.extend("/spec", faults)).ok()
}

fn read_targets(reader: &mut JsonReader, members: &Map<String, Value>) -> Vec<Target> {
    let Some(list) = members.get("targets") else { return Vec::new() };
    let Some(items) = list.as_array() else {
        reader.fault::<()>("/targets", "must be an array of objects");
        return Vec::new();
    };
    let items = items.iter().take(MOST_TARGETS + 1).enumerate();
    items.filter_map(|(i, item)| read_target(reader, item, &format!("/targets/{i}"))).collect()
}

fn read_target(reader: &mut JsonReader, item: &Value, at: &str) -> Option<Target> {
    let before = reader.count();
    let members = reader.members(at, item, &["region", "quantity", "value", "low", "high", "source"])?;
    let number = |name: &str| {
        let value = given(members, name)?;
        let number = value.as_f64().filter(|x| x.is_finite());
        number.or_else(|| reader.fault(format!("{at}/{name}"), "must be a number"))
    };
    let range = ["value", "low", "high"].map(number);
    let mut text = |name: &str| {
        let text = members.get(name).and_then(Value::as_str);
        text.or_else(|| reader.fault(format!("{at}/{name}"), "must be a string"))
    };
    let (region, quantity) = (text("region"), text("quantity"));
    let source = given(members, "source").and_then(|source| {
        let text = source.as_str().filter(|text| text.chars().count() <= 300).map(str::to_owned);
        text.or_else(|| reader.fault(format!("{at}/source"), "must be a string of at most 300 characters"))
    });
    if reader.count() > before {
        return None;
    }
    match target(region?, quantity?, range, source) {
        Ok(target) => Some(target),
        Err((member, detail)) => reader.fault(format!("{at}/{member}"), detail),
    }
}

fn target(
    region: &str,
    quantity: &str,
    [value, low, high]: RequestedRange,
    source: Option<String>,
) -> Result<Target, (&'static str, String)> {
    if let Some(refused) = refused(region, quantity) {
        return Err(refused);
    }
    let middle = low.zip(high).map(|(low, high)| 0.5 * (low + high));
    let Some(value) = value.or(middle) else {
        return Err(("value", "is needed, or both `low` and `high`".into()));
    };
    for (member, number) in [("value", Some(value)), ("low", low), ("high", high)] {
        if number.is_some_and(|number| number.abs() > LARGEST) {
            return Err((member, format!("must be from -{LARGEST:e} to {LARGEST:e}")));
        }
    }
    let around = TOLERANCE * value.abs();
    let [low, high] = [low.unwrap_or(value - around), high.unwrap_or(value + around)];
    if low > value {
        return Err(("low", format!("must not be greater than the value, {value}")));
    }
    if high < value {
        return Err(("high", format!("must not be less than the value, {value}")));
    }
    Ok(Target { region: region.into(), quantity: quantity.into(), value, low, high, source })
}

/// Reads targets from CSV with a header: `region,quantity,value,low,high`, in any order; the last
/// three may be missing or empty.
fn read_csv(reader: &mut JsonReader, text: &Value) -> Option<Vec<Target>> {
    const NAMES: [&str; 5] = ["region", "quantity", "value", "low", "high"];
    let at = "/targets_csv";
    let Some(text) = text.as_str() else { return reader.fault(at, "must be a string") };
    let mut csv = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text.as_bytes());
    let header = match csv.headers() {
        Ok(header) => header.clone(),
        Err(error) => return reader.fault(at, format!("cannot be read: {error}")),
    };
    if let Some(name) = header.iter().find(|name| !NAMES.contains(name)) {
        let name: String = name.chars().take(40).collect();
        return reader.fault(at, format!("column `{name}` is unknown; the columns are {}", NAMES.join(", ")));
    }
    if let Some(name) = NAMES[..2].iter().find(|name| !header.iter().any(|column| column == **name)) {
        return reader.fault(at, format!("column `{name}` is missing; the first line names the columns"));
    }
    let mut targets = Vec::new();
    for (row, record) in (1..).zip(csv.records().take(MOST_TARGETS + 1)) {
        match record.map_err(|error| error.to_string()).and_then(|record| csv_target(&header, &record)) {
            Ok(target) => targets.push(target),
            Err(detail) => {
                reader.fault::<()>(at, format!("row {row}: {detail}"));
            }
        }
    }
    Some(targets)
}

fn csv_target(header: &csv::StringRecord, record: &csv::StringRecord) -> Result<Target, String> {
    let cell = |name: &str| header.iter().position(|column| column == name).and_then(|i| record.get(i)).unwrap_or("");
    let number = |name: &str| match cell(name) {
        "" => Ok(None),
        text => match text.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(Some(number)),
            _ => Err(format!("{name}: `{}` is no number", text.chars().take(40).collect::<String>())),
        },
    };
    let range = [number("value")?, number("low")?, number("high")?];
    target(cell("region"), cell("quantity"), range, None).map_err(|(member, detail)| format!("{member}: {detail}"))
}

fn read_variables(
    reader: &mut JsonReader,
    members: &Map<String, Value>,
    targets: &[Target],
    start: &ModelSpec,
) -> Option<Vec<Variable>> {
    let Some(list) = given(members, "vary") else {
        return Some(Variable::chosen(targets, start));
    };
    let Some(items) = list.as_array().filter(|items| (1..=MOST_VARIABLES).contains(&items.len())) else {
        return reader.fault("/vary", format!("must be an array of 1 to {MOST_VARIABLES} objects"));
    };
    let mut variables: Vec<Variable> = Vec::new();
    for (i, item) in items.iter().enumerate() {
        let at = format!("/vary/{i}");
        let Some(variable) = read_variable(reader, item, &at, start) else { continue };
        // A parameter may vary as a whole, or at each end.
        let overlaps = |other: &Variable| {
            other.lever.pointer == variable.lever.pointer
                && (other.end == variable.end || other.end.is_none() || variable.end.is_none())
        };
        if variables.iter().any(overlaps) {
            reader.fault::<()>(format!("{at}/parameter"), "is given more than once");
        }
        variables.push(variable);
    }
    Some(variables)
}

fn read_variable(reader: &mut JsonReader, item: &Value, at: &str, start: &ModelSpec) -> Option<Variable> {
    let before = reader.count();
    let members = reader.members(at, item, &["parameter", "end", "from", "to"])?;
    let lever = match members.get("parameter").and_then(Value::as_str).map(Lever::at) {
        Some(Ok(lever)) => Some(lever),
        Some(Err(detail)) => reader.fault(format!("{at}/parameter"), detail),
        None => reader.fault(format!("{at}/parameter"), "must be the JSON pointer of a parameter"),
    };
    let end: Option<End> = given(members, "end").and_then(|value| {
        let end = serde_json::from_value(value.clone()).ok();
        end.or_else(|| reader.fault(format!("{at}/end"), "must be isthmus or ampulla"))
    });
    let bounds = ["from", "to"].map(|name| {
        let value = given(members, name)?;
        value.as_f64().or_else(|| reader.fault(format!("{at}/{name}"), "must be a number"))
    });
    if reader.count() > before {
        return None;
    }
    match Variable::new(lever?, end, start, bounds) {
        Ok(variable) => Some(variable),
        Err((member, detail)) => reader.fault(format!("{at}/{member}"), detail),
    }
}

/// Reads an integer; `default` if it is absent or null.
fn read_integer<T: TryFrom<i64> + PartialOrd + Display>(
    reader: &mut JsonReader,
    members: &Map<String, Value>,
    name: &str,
    range: RangeInclusive<T>,
    default: T,
) -> Option<T> {
    let Some(value) = given(members, name) else { return Some(default) };
    integer_in(value, &range).or_else(|| {
        let detail = format!("must be an integer from {} to {}", range.start(), range.end());
        reader.fault(format!("/{name}"), detail)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(body: &Value) -> Result<FitSpec, Vec<String>> {
        FitSpec::read(body, Vec::new(), &[]).map_err(|faults| faults.into_iter().map(|fault| fault.pointer).collect())
    }

    #[test]
    fn a_short_request_takes_defaults_and_round_trips() {
        let body = json!({ "targets": [{ "region": "ampulla", "quantity": "folds_on_ring", "value": 30 }] });
        let fit = read(&body).unwrap();
        assert_eq!((fit.preset.name.as_str(), fit.seeds, fit.models, fit.seed), ("pig", 4, 4, 0));
        assert_eq!((fit.targets[0].low, fit.targets[0].high), (28.5, 31.5));
        assert_eq!(fit.variables.len(), 3);
        assert_eq!(read(&fit.to_json()).unwrap(), fit);
        assert_eq!(fit.digest(), read(&fit.to_json()).unwrap().digest());
        assert_ne!(fit.digest(), read(&json!({ "seed": 1, "targets": body["targets"] })).unwrap().digest());
        let seeds: Vec<u64> = fit.search_seeds().chain(fit.model_seeds()).collect();
        assert_eq!(seeds, [0, 1, 2, 3, 16, 17, 18, 19]);
    }

    #[test]
    fn targets_come_as_csv_too() {
        let csv = "region,quantity,value,low,high\nampulla,folds_on_ring,30,28,\n whole , fill ,,0.6,0.8\n";
        let fit = read(&json!({ "targets_csv": csv })).unwrap();
        let numbers: Vec<[f64; 3]> = fit.targets.iter().map(|t| [t.low, t.value, t.high]).collect();
        assert_eq!(numbers, [[28.0, 30.0, 31.5], [0.6, 0.7, 0.8]]);
        for (csv, hint) in [
            ("", "column `region` is missing"),
            ("region,value\nampulla,1", "column `quantity` is missing"),
            ("region,quantity,vaule\n", "column `vaule` is unknown"),
            ("region,quantity,value\nampulla,fill,x", "row 1: value: `x` is no number"),
            ("region,quantity,value\nampulla,fill,inf", "is no number"),
            ("region,quantity,value\nampulla,fill", "row 1: CSV error"),
            ("region,quantity,value\nampulla,fill,0.7\nampulla,fil,0.7", "row 2: quantity: `fil` is unknown"),
            ("region,quantity\nampulla,fill", "row 1: value: is needed"),
        ] {
            let faults = FitSpec::read(&json!({ "targets_csv": csv }), Vec::new(), &[]).unwrap_err();
            assert!(faults[0].detail.contains(hint), "{csv:?}: {faults:?}");
        }
    }

    #[test]
    fn every_fault_names_its_member() {
        let good = json!({ "region": "ampulla", "quantity": "fill", "value": 0.7 });
        let with = |name: &str, value: Value| {
            let mut body = json!({ "targets": [good.clone()] });
            body[name] = value;
            body
        };
        for (body, pointer) in [
            (json!([]), ""),
            (json!({}), "/targets"),
            (json!({ "targets": [] }), "/targets"),
            (json!({ "targets": 3 }), "/targets"),
            (json!({ "targets": [3] }), "/targets/0"),
            (json!({ "targets": [{ "region": "ampulla", "quantity": "fill" }] }), "/targets/0/value"),
            (json!({ "targets": [{ "region": "ampulla", "value": 1 }] }), "/targets/0/quantity"),
            (json!({ "targets": [{ "region": "x", "quantity": "fill", "value": 1 }] }), "/targets/0/region"),
            (json!({ "targets": [{ "region": "ampulla", "quantity": "fill", "value": "1" }] }), "/targets/0/value"),
            (
                json!({ "targets": [{ "region": "ampulla", "quantity": "fill", "value": 1, "low": 2 }] }),
                "/targets/0/low",
            ),
            (
                json!({ "targets": [{ "region": "ampulla", "quantity": "fill", "value": 1, "high": 0 }] }),
                "/targets/0/high",
            ),
            (json!({ "targets": [{ "region": "ampulla", "quantity": "fill", "value": 1, "lo": 0 }] }), "/targets/0/lo"),
            (json!({ "targets": vec![good.clone(); 101] }), "/targets"),
            (json!({ "targets": [{ "region": "ampulla", "quantity": "fill", "value": 1e300 }] }), "/targets/0/value"),
            (with("sede", json!(1)), "/sede"),
            (with("preset", json!("dog")), "/preset"),
            (with("preset", json!(1)), "/preset"),
            (with("spec", json!({ "steps": -1 })), "/spec/steps"),
            (with("spec", json!({ "piece": { "from": 0.5 } })), "/spec/piece"),
            (with("seed", json!(-1)), "/seed"),
            (with("evaluations", json!(0)), "/evaluations"),
            (with("evaluations", json!(2001)), "/evaluations"),
            (with("seeds", json!(1.5)), "/seeds"),
            (with("models", json!("4")), "/models"),
            (with("vary", json!([])), "/vary"),
            (with("vary", json!([1])), "/vary/0"),
            (with("vary", json!([{ "parameter": "/collision" }])), "/vary/0/parameter"),
            (with("vary", json!([{ "parameter": "/friction", "end": "middle" }])), "/vary/0/end"),
            (with("vary", json!([{ "parameter": "/length_mm", "end": "ampulla" }])), "/vary/0/end"),
            (with("vary", json!([{ "parameter": "/friction", "from": "0" }])), "/vary/0/from"),
            (with("vary", json!([{ "parameter": "/friction", "from": 0.2, "to": 0.1 }])), "/vary/0/to"),
            (
                with("vary", json!([{ "parameter": "/friction" }, { "parameter": "/friction", "end": "ampulla" }])),
                "/vary/1/parameter",
            ),
            (with("vary", json!([{ "parameter": "/friction", "form": 1 }])), "/vary/0/form"),
        ] {
            assert_eq!(read(&body).unwrap_err().first().map(String::as_str), Some(pointer), "{body}");
        }
        assert!(read(&with("seed", json!(7.0))).is_ok_and(|fit| fit.seed == 7));
    }

    #[test]
    fn unknown_members_come_with_a_hint() {
        let body = json!({ "sede": 1, "labels": {}, "lebals": {}, "targets": [{ "vaule": 1 }] });
        let faults = FitSpec::read(&body, Vec::new(), &["labels"]).unwrap_err();
        for (pointer, hint) in [("/sede", "`seed`"), ("/lebals", "`labels`"), ("/targets/0/vaule", "`value`")] {
            let fault = faults.iter().find(|fault| fault.pointer == pointer).expect("it is unknown");
            assert!(fault.detail.contains(&format!("did you mean {hint}?")), "{fault:?}");
        }
    }
}
