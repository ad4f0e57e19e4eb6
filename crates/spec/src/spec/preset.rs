//! Presets: data files that describe an organ of a species, with a source for every number.
//!
//! The files in `presets/` are compiled into the program. A test checks that each is complete and
//! valid.

use serde::Deserialize;
use serde_json::Value;
use std::collections::BTreeMap;
use std::sync::LazyLock;

/// Preset of requests that name none.
pub const DEFAULT_PRESET: &str = "pig";

/// Contents of the files, the default preset first.
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
    /// Name for display.
    pub title: String,
    /// Organ.
    pub organ: String,
    /// Species.
    pub species: String,
    /// Description of the preset.
    pub description: String,
    /// Reason why the tube is shorter than that of the organ; absent if it is not.
    #[serde(default)]
    pub shortened: Option<String>,
    /// Values of all parameters.
    pub spec: Value,
    /// Source of each value, by the JSON pointer of the parameter.
    pub sources: BTreeMap<String, String>,
}

/// All presets, the default first.
#[must_use]
pub fn presets() -> &'static [Preset] {
    static PRESETS: LazyLock<Vec<Preset>> = LazyLock::new(|| {
        FILES.iter().map(|text| serde_json::from_str(text).expect("preset files are tested to be valid")).collect()
    });
    &PRESETS
}

/// Finds the preset with this name.
#[must_use]
pub fn preset(name: &str) -> Option<&'static Preset> {
    presets().iter().find(|preset| preset.name == name)
}
