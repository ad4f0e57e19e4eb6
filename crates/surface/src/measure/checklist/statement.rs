//! Statements of the checklist, their sources and conditions.

use serde::{Deserialize, Serialize};
use std::sync::LazyLock;

/// Organ of a condition that names none.
pub(super) const ORGAN: &str = "oviduct";

/// Statement about an organ.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Statement {
    /// Number in the checklist, from 1.
    pub number: u32,
    /// The statement.
    pub statement: String,
    /// Sources of the statement.
    pub sources: Vec<StatedSource>,
    /// Conditions, all of which must hold.
    pub conditions: Vec<Condition>,
    /// Remark on the statement as a whole.
    pub note: Option<String>,
}

/// Source of a statement.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StatedSource {
    /// The publication or page.
    pub source: String,
    /// How its content was learnt.
    pub learnt: Learnt,
}

/// How the content of a source was learnt.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Learnt {
    /// Its abstract or a stored excerpt was read.
    Abstract,
    /// A secondary page was read.
    Secondary,
    /// Its full text was read.
    Full,
    /// From memory, without reading it.
    Memory,
}

impl Learnt {
    /// Words for readers.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Self::Abstract => "abstract or excerpt read",
            Self::Secondary => "secondary page read",
            Self::Full => "full text read",
            Self::Memory => "from memory",
        }
    }
}

/// Condition of a statement: a range for an expression of measures.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Condition {
    /// What is measured, for readers.
    pub title: String,
    /// Organ that the condition applies to; that of an oviduct if absent.
    pub organ: Option<String>,
    /// Species that the condition applies to.
    pub species: Vec<String>,
    /// Presets that the condition applies to; all of the organ and species if absent.
    pub presets: Option<Vec<String>>,
    /// Expression of measures; docs/morphometry.md describes the syntax.
    pub measure: String,
    /// Lower end of the range.
    pub low: Option<f64>,
    /// Upper end of the range.
    pub high: Option<f64>,
    /// Origin of the range.
    pub bound: BoundOrigin,
    /// Remark on the condition.
    pub note: Option<String>,
}

/// Origin of the range of a condition.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum BoundOrigin {
    /// The numbers are published for the species.
    Published,
    /// An order is published, without numbers. The ends of the range are not part of it.
    Order,
    /// The numbers are this project's choice.
    Proposal,
}

impl Condition {
    /// True if a model of this organ, species and preset is judged by the condition.
    pub(super) fn applies(&self, organ: &str, species: &str, preset: &str) -> bool {
        self.organ.as_deref().unwrap_or(ORGAN) == organ
            && self.species.iter().any(|own| own == species)
            && self.presets.as_ref().is_none_or(|presets| presets.iter().any(|own| own == preset))
    }

    /// True if the value is in the range.
    pub(super) fn contains(&self, value: f64) -> bool {
        match self.bound {
            BoundOrigin::Order => self.low.is_none_or(|low| value > low) && self.high.is_none_or(|high| value < high),
            BoundOrigin::Published | BoundOrigin::Proposal => {
                self.low.is_none_or(|low| value >= low) && self.high.is_none_or(|high| value <= high)
            }
        }
    }
}

const FILE: &str = include_str!("../../../../../references/checklist.json");

/// Returns all statements in the order of their numbers.
#[must_use]
pub fn statements() -> &'static [Statement] {
    static STATEMENTS: LazyLock<Vec<Statement>> =
        LazyLock::new(|| serde_json::from_str(FILE).expect("the file is tested to be valid"));
    &STATEMENTS
}
