//! The report of a model for people: one HTML page that needs no other file and prints well.
//!
//! | file | subject |
//! |---|---|
//! | `page` | the page |
//! | `plots` | measures along the tube, with the published ranges |
//! | `style.css` | its style, on screens and on paper |

mod page;
mod plots;

use crate::measure::comparison::Comparison;
use crate::measure::morphometry::Morphometry;
use crate::model::{Mesh, Section};
use crate::render::{NamedView, RenderError, mesh_png, sheet_png};
use serde::Deserialize;
use serde_json::Value;

/// Media type of the page.
pub const MEDIA_TYPE: &str = "text/html; charset=utf-8";
/// Longest side of the picture of the tube, pixels.
pub const PICTURE: u32 = 1200;
/// View of the picture of the tube.
pub const VIEW: NamedView = NamedView::Opened;
/// Sections in the strip.
const STRIP: usize = 8;
/// Side of each, pixels.
const CELL: u32 = 300;

/// What `report.json` says, as far as the page shows it. Models of version 0.2 and earlier have no morphometry.
#[derive(Debug, Deserialize)]
struct Stored {
    digest: String,
    preset: String,
    seed: u64,
    engine: String,
    spec: Value,
    summary: Value,
    certificate: Value,
    morphometry: Option<Morphometry>,
    comparison: Option<Comparison>,
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

/// The sections, of those at the places `z`, that the strip of a report shows: evenly spread from end to end.
#[must_use]
pub fn strip(z: &[f64]) -> Vec<usize> {
    let (Some(&first), Some(&last)) = (z.first(), z.last()) else { return Vec::new() };
    let place = |k: usize| first + (last - first) * k as f64 / (STRIP - 1) as f64;
    let nearest = |at: f64| (0..z.len()).min_by(|&a, &b| (z[a] - at).abs().total_cmp(&(z[b] - at).abs()));
    let mut chosen: Vec<usize> = (0..STRIP).filter_map(|k| nearest(place(k))).collect();
    chosen.dedup();
    chosen
}

/// The page of a model: `report` is its `report.json`, `sections` are those that [`strip`] chose, and `tube` is its surface, as
/// dense as [`VIEW`] needs it at [`PICTURE`] pixels.
///
/// # Errors
/// [`ReportError`]
pub fn html(report: &[u8], sections: &[Section], tube: &Mesh) -> Result<String, ReportError> {
    let stored: Stored = serde_json::from_slice(report)?;
    let chosen: Vec<&Section> = sections.iter().collect();
    let pictures = page::Pictures {
        tube: mesh_png(tube, &VIEW.of(tube, PICTURE))?,
        strip: sheet_png(&chosen, STRIP / 2, CELL)?,
        places_mm: sections.iter().map(|section| section.z_um / 1e3).collect(),
    };
    let plots = stored.morphometry.as_ref().map(|m| plots::plots(m, stored.comparison.as_ref())).transpose()?;
    Ok(page::page(&stored, &pictures, &plots.unwrap_or_default()).into_string())
}
