//! Presets: data files, each describing an organ of a species, with a source for every number.
//!
//! The files under `presets/` are compiled in. A test checks that each is complete and valid and has a source
//! for every parameter.

use super::parameters::leaves;
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::sync::LazyLock;

/// Name of the preset that is used if a request names none.
pub const DEFAULT_PRESET: &str = "pig";

/// The texts of the files, the default first.
const FILES: [&str; 13] = [
    include_str!("../../../../presets/pig.json"),
    include_str!("../../../../presets/human.json"),
    include_str!("../../../../presets/cow.json"),
    include_str!("../../../../presets/pig-luteal.json"),
    include_str!("../../../../presets/cow-luteal.json"),
    include_str!("../../../../presets/mouse.json"),
    include_str!("../../../../presets/utero-tubal-junction.json"),
    include_str!("../../../../presets/infundibulum.json"),
    include_str!("../../../../presets/ureter.json"),
    include_str!("../../../../presets/oesophagus.json"),
    include_str!("../../../../presets/small-intestine.json"),
    include_str!("../../../../presets/colon.json"),
    include_str!("../../../../presets/paper.json"),
];

/// A complete set of parameters for an organ of a species.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Preset {
    /// Name in requests.
    pub name: String,
    /// Name for people.
    pub title: String,
    /// Organ.
    pub organ: String,
    /// Species.
    pub species: String,
    /// Description.
    pub description: String,
    /// A value for every parameter.
    pub spec: Value,
    /// Source of each value, by the JSON pointer of the parameter.
    pub sources: BTreeMap<String, String>,
}

impl Preset {
    /// The whole preset as JSON: its summary, the plain `spec`, and `parameters` in the order of the table, each with its
    /// pointer, title, unit (empty if there is none), description, value and source.
    #[must_use]
    pub fn to_json(&self) -> Value {
        let parameters: Vec<Value> = leaves()
            .into_iter()
            .map(|(pointer, field)| {
                json!({
                    "title": field.title,
                    "unit": field.unit,
                    "description": field.doc,
                    "value": self.spec.pointer(&pointer),
                    "source": self.sources.get(&pointer),
                    "pointer": pointer,
                })
            })
            .collect();
        let mut whole = self.summary();
        whole["spec"] = self.spec.clone();
        whole["parameters"] = parameters.into();
        whole
    }

    /// The entry in a list of presets: name, title, organ, species, description, and whether it is the default.
    #[must_use]
    pub fn summary(&self) -> Value {
        json!({
            "name": self.name,
            "title": self.title,
            "organ": self.organ,
            "species": self.species,
            "description": self.description,
            "default": self.name == DEFAULT_PRESET,
        })
    }
}

/// All presets, the default first.
#[must_use]
pub fn presets() -> &'static [Preset] {
    static PRESETS: LazyLock<Vec<Preset>> = LazyLock::new(|| {
        FILES.iter().map(|text| serde_json::from_str(text).expect("preset files are tested to be valid")).collect()
    });
    &PRESETS
}

/// The preset of this name.
#[must_use]
pub fn preset(name: &str) -> Option<&'static Preset> {
    presets().iter().find(|preset| preset.name == name)
}
