//! What `report.json` says, as far as the page shows it, and what can go wrong.

use crate::measure::comparison::Comparison;
use crate::measure::morphometry::{Cuts, Morphometry};
use crate::render::RenderError;
use serde::Deserialize;
use serde_json::Value;

/// What `report.json` says, as far as the page shows it. Models of version 0.2 and earlier have no morphometry.
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
    pub(super) comparison: Option<Comparison>,
    pub(super) cuts: Option<Cuts>,
    pub(super) course: Option<Course>,
}

/// How the tube is bent.
#[derive(Debug, Deserialize)]
pub(super) struct Course {
    pub(super) tortuosity: f64,
    pub(super) end_distance_mm: f64,
    pub(super) curve_radius_mm: Option<f64>,
    pub(super) tightest_at_mm: f64,
    pub(super) relaxed: bool,
}

/// Why a page could not be made.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// The report is not one that this program writes.
    #[error("report.json cannot be read")]
    Json(#[from] serde_json::Error),
    /// A picture could not be drawn.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// A plot could not be drawn.
    #[error("a plot could not be drawn: {0}")]
    Plot(String),
}
