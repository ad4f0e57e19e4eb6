//! Contents of `report.json` that the page shows, and errors of pages.

use crate::measure::checklist::Checklist;
use crate::measure::comparison::Comparison;
use crate::measure::morphometry::{Cuts, Morphometry};
use crate::render::RenderError;
use serde::Deserialize;
use serde_json::Value;

/// Contents of `report.json` that the page shows. Models of version 0.2 and earlier have no
/// morphometry.
#[derive(Debug, Deserialize)]
pub(super) struct Stored {
    pub(super) digest: String,
    pub(super) preset: String,
    pub(super) seed: u64,
    pub(super) engine: String,
    pub(super) spec: Value,
    pub(super) summary: Value,
    pub(super) certificate: Value,
    pub(super) morphometry: Option<Morphometry>,
    pub(super) simulated: Option<Morphometry>,
    pub(super) comparison: Option<Comparison>,
    /// Absent in models of version 0.3 and earlier.
    pub(super) checklist: Option<Checklist>,
    pub(super) cuts: Option<Cuts>,
    pub(super) course: Option<Course>,
}

/// Course of a bent tube.
#[derive(Debug, Deserialize)]
pub(super) struct Course {
    pub(super) tortuosity: f64,
    pub(super) end_distance_mm: f64,
    pub(super) curve_radius_mm: Option<f64>,
    pub(super) tightest_at_mm: f64,
    pub(super) relaxed: bool,
}

/// Reason why a page could not be created.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// This program has not written the report.
    #[error("report.json cannot be read")]
    Json(#[from] serde_json::Error),
    /// A picture could not be drawn.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// A plot could not be drawn.
    #[error("a plot could not be drawn: {0}")]
    Plot(String),
}
