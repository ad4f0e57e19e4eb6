//! The surface of a model for a picture, from its stored sections: as much of it as the picture can show.
//!
//! Every model has `sections.bin`, and its sections are exact; the surface between them is a [`draft`].

use crate::export::sections_bin::{SectionsError, SectionsReader};
use crate::mesh::{LoftError, draft};
use crate::model::{Mesh, Ring, Section};
use crate::render::NamedView;
use std::io::{Read, Seek};

/// Pixels of the longest side of a picture of the whole tube, for each section in it.
const PIXELS_PER_SECTION: u32 = 10;
/// Fewest sections in a picture of the whole tube, if the model has as many.
const FEWEST_SECTIONS: u32 = 40;
/// Length of tube that is lofted for a picture of an end, in widths of that end; the picture shows 0.8.
const END_WIDTHS: f32 = 1.0;

/// Why a model could not be drawn.
#[derive(Debug, thiserror::Error)]
pub enum PreviewError {
    /// The sections could not be read.
    #[error("the sections cannot be read")]
    Sections(#[from] SectionsError),
    /// The sections do not form a tube.
    #[error("the sections cannot be lofted")]
    Loft(#[from] LoftError),
}

/// Lofts those sections of a `sections.bin` that `view` shows, as densely as a picture of `size` pixels needs.
///
/// # Errors
/// [`PreviewError`] if the sections are damaged or not those of a tube.
pub fn surface(sections_bin: impl Read + Seek, view: NamedView, size: u32) -> Result<Mesh, PreviewError> {
    let mut reader = SectionsReader::open(sections_bin)?;
    let count = reader.len();
    let chosen: Vec<usize> = match view {
        NamedView::Whole | NamedView::Opened => {
            let most = (size / PIXELS_PER_SECTION).max(FEWEST_SECTIONS) as usize;
            evenly(count, most)
        }
        NamedView::Isthmus | NamedView::Ampulla => {
            let at_isthmus = view == NamedView::Isthmus;
            let end = reader.section(if at_isthmus { 0 } else { count.saturating_sub(1) })?;
            let reach = f64::from(END_WIDTHS * width(&end.outer));
            let entries = reader.entries();
            let is_near = |k: &usize| (entries[*k].z_um - end.z_um).abs() <= reach;
            let near = (0..count).filter(is_near).collect::<Vec<_>>();
            // With sections far apart, the nearest two.
            match near[..] {
                [0] => (0..count.min(2)).collect(),
                [last] => (last.saturating_sub(1)..count).collect(),
                _ => near,
            }
        }
    };
    let sections = chosen.into_iter().map(|k| reader.section(k)).collect::<Result<Vec<Section>, _>>()?;
    Ok(draft(&sections)?)
}

/// At most `most` of `count` indices, evenly spread, with the first and the last.
fn evenly(count: usize, most: usize) -> Vec<usize> {
    if count <= most {
        return (0..count).collect();
    }
    (0..most).map(|k| k * (count - 1) / (most - 1)).collect()
}

/// Greatest extent of a ring, micrometres.
fn width(ring: &Ring) -> f32 {
    let extent = |axis: usize| {
        let of = ring.points.iter().map(|p| p[axis]);
        of.clone().fold(f32::NEG_INFINITY, f32::max) - of.fold(f32::INFINITY, f32::min)
    };
    extent(0).max(extent(1))
}
