//! Presets as clients see them: each value with its title, unit and source.

use super::parameters::leaves;
use super::preset::{DEFAULT_PRESET, Preset};
use super::table::Field;
use serde::Serialize;
use serde_json::Value;

impl Preset {
    /// Entry of the preset in a list.
    #[must_use]
    pub fn summary(&self) -> PresetSummary<'_> {
        PresetSummary {
            name: &self.name,
            title: &self.title,
            organ: &self.organ,
            species: &self.species,
            description: &self.description,
            default: self.name == DEFAULT_PRESET,
        }
    }

    /// The preset with its parameters in the order of the table.
    #[must_use]
    pub fn details(&self) -> PresetDetails<'_> {
        let parameter = |(pointer, field): (String, &'static Field)| PresetParameter {
            title: field.title,
            unit: field.unit,
            description: field.doc,
            value: self.spec.pointer(&pointer).unwrap_or(&Value::Null),
            source: self.sources.get(&pointer).map(String::as_str),
            pointer,
        };
        PresetDetails {
            summary: self.summary(),
            spec: &self.spec,
            parameters: leaves().into_iter().map(parameter).collect(),
        }
    }
}

/// A preset in a list.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct PresetSummary<'a> {
    /// Name.
    pub name: &'a str,
    /// Title.
    pub title: &'a str,
    /// Organ.
    pub organ: &'a str,
    /// Species.
    pub species: &'a str,
    /// Description of the preset.
    pub description: &'a str,
    /// True if requests without `preset` use this preset.
    pub default: bool,
}

/// A preset.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema), schema(as = Preset))]
pub struct PresetDetails<'a> {
    /// Entry of the preset in a list.
    #[serde(flatten)]
    pub summary: PresetSummary<'a>,
    /// The complete spec of the preset.
    #[cfg_attr(feature = "schema", schema(value_type = super::ModelSpec))]
    pub spec: &'a Value,
    /// All parameters, with units and sources.
    pub parameters: Vec<PresetParameter<'a>>,
}

/// A parameter of a preset.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct PresetParameter<'a> {
    /// Title.
    pub title: &'a str,
    /// Unit; empty if it has none.
    pub unit: &'a str,
    /// Meaning.
    pub description: &'a str,
    /// Value.
    #[cfg_attr(feature = "schema", schema(value_type = super::openapi::ParameterValue))]
    pub value: &'a Value,
    /// Source of the value.
    pub source: Option<&'a str>,
    /// JSON pointer into the spec.
    pub pointer: String,
}
