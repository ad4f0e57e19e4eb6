//! Surface of a model for a picture, lofted from as many of its stored sections as the picture can
//! show.
//!
//! Every model has `sections.bin`, whose sections are exact. The surface between them is a
//! [`draft`].

use crate::export::sections_bin::{SectionEntry, SectionsError, SectionsReader};
use crate::mesh::bend::bend;
use crate::mesh::{LoftError, draft};
use crate::model::{Mesh, Ring, Section};
use crate::render::{END_WIDTHS, NamedView};
use crate::spec::ModelSpec;
use serde_json::Value;
use std::io::{Read, Seek};

/// Number of pixels of the longest side of a picture per section: for the whole tube, and for an
/// end, which is seen along the tube. Neighbouring sections are then about ten pixels apart.
const PIXELS_PER_SECTION: [u32; 2] = [10, 25];
/// Minimum number of sections in a picture, if the model has as many and they have at most
/// [`MAX_POINTS`] points.
const MIN_SECTIONS: usize = 40;
/// Maximum number of points of all sections in a picture with more than two sections. Bounds the
/// memory and the time of a picture.
const MAX_POINTS: usize = 500_000;

/// Reason why a model could not be drawn.
#[derive(Debug, thiserror::Error)]
pub enum PreviewError {
    /// The sections could not be read.
    #[error("the sections cannot be read")]
    Sections(#[from] SectionsError),
    /// The sections do not form a tube.
    #[error("the sections cannot be lofted")]
    Loft(#[from] LoftError),
}

/// Lofts the sections of a `sections.bin` that `view` shows, as densely as a picture of `size`
/// pixels needs.
///
/// # Errors
/// [`PreviewError`] if the sections are damaged or do not form a tube.
pub fn surface(sections_bin: impl Read + Seek, view: NamedView, size: u32) -> Result<Mesh, PreviewError> {
    let mut reader = SectionsReader::open(sections_bin)?;
    let end = end(view, reader.len()).map(|k| reader.section(k)).transpose()?;
    let chosen = chosen(reader.entries(), end.as_ref(), size);
    let sections = chosen.into_iter().map(|k| reader.section(k)).collect::<Result<Vec<Section>, _>>()?;
    Ok(draft(&sections)?)
}

/// Lofts sections, and bends the tube if its stored specification says so.
///
/// # Errors
/// As [`draft`].
pub fn tube(sections: &[Section], spec: &Value) -> Result<Mesh, LoftError> {
    Ok(bent(draft(sections)?, spec))
}

/// Bends a straight tube if its stored specification says so.
#[must_use]
pub fn bent(straight: Mesh, spec: &Value) -> Mesh {
    match ModelSpec::from_stored(spec).and_then(|spec| spec.centre_line()) {
        Some(course) => bend(&straight, &course),
        None => straight,
    }
}

/// Index of the section, of `count`, at the end that `view` shows; `None` if it shows both ends.
#[must_use]
pub fn end(view: NamedView, count: usize) -> Option<usize> {
    match view {
        NamedView::Whole | NamedView::Opened => None,
        NamedView::Isthmus => (count > 0).then_some(0),
        NamedView::Ampulla => count.checked_sub(1),
    }
}

/// Indices of the sections in a picture of `size` pixels, in order: of the whole tube, or of the
/// piece at `end` up to the first section beyond it.
#[must_use]
pub fn chosen(entries: &[SectionEntry], end: Option<&Section>, size: u32) -> Vec<usize> {
    let shown = match end {
        None => 0..entries.len(),
        Some(end) => {
            let reach = END_WIDTHS * f64::from(width(&end.outer));
            let is_in_piece = |entry: &&SectionEntry| (entry.z_um - end.z_um).abs() <= reach;
            // A surface needs at least two sections.
            let count = |inside: usize| (inside + 1).clamp(2.min(entries.len()), entries.len());
            if entries.first().is_some_and(|first| first.z_um == end.z_um) {
                0..count(entries.iter().take_while(is_in_piece).count())
            } else {
                entries.len() - count(entries.iter().rev().take_while(is_in_piece).count())..entries.len()
            }
        }
    };
    let points = entries[shown.clone()].iter().map(|entry| entry.inner as usize + entry.outer as usize).max();
    let affordable = (MAX_POINTS / points.unwrap_or(0).max(1)).max(2);
    let most = ((size / PIXELS_PER_SECTION[usize::from(end.is_some())]) as usize).max(MIN_SECTIONS).min(affordable);
    evenly(shown.len(), most).into_iter().map(|k| shown.start + k).collect()
}

/// At most `most` of `count` indices, evenly spread, including the first and the last.
fn evenly(count: usize, most: usize) -> Vec<usize> {
    if count <= most {
        return (0..count).collect();
    }
    (0..most).map(|k| k * (count - 1) / (most - 1)).collect()
}

/// Maximum extent of a ring, µm.
fn width(ring: &Ring) -> f32 {
    let extent = |axis: usize| {
        let of = ring.points.iter().map(|p| p[axis]);
        of.clone().fold(f32::NEG_INFINITY, f32::max) - of.fold(f32::INFINITY, f32::min)
    };
    extent(0).max(extent(1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::Metadata;
    use crate::export::sections_bin::write_sections;
    use proptest::prelude::*;

    /// Entries of sections `spacing_um` apart with this number of points each.
    fn entries(count: usize, spacing_um: f64, points: u32) -> Vec<SectionEntry> {
        let entry = |k: usize| SectionEntry {
            offset: 0,
            length: 0,
            inner: points / 2,
            outer: points - points / 2,
            added: false,
            step: k as f64,
            z_um: k as f64 * spacing_um,
            checksum: [0; 8],
        };
        (0..count).map(entry).collect()
    }

    fn meta() -> Metadata {
        let (preset, digest, engine) = ("pig".into(), "0f3a".repeat(16), "0.1.0".into());
        Metadata { preset, seed: 7, digest, engine, length_mm: 4.0, sections: 2 }
    }

    /// A section 1000 µm wide.
    fn section(z_um: f64) -> Section {
        let ring = |radius: f32| Ring {
            ids: (0..24).collect(),
            points: (0..24)
                .map(|k| {
                    let (sin, cos) = (k as f32 * std::f32::consts::TAU / 24.0).sin_cos();
                    [radius * cos, radius * sin]
                })
                .collect(),
        };
        Section { step: z_um, z_um, added: false, inner: ring(300.0), outer: ring(500.0) }
    }

    #[test]
    fn the_whole_tube_is_drawn_from_as_many_sections_as_its_size_needs() {
        let all = entries(400, 50.0, 2000);
        for (size, count) in [(1024, 102), (2048, 204), (32, 40), (8192, 250)] {
            let chosen = chosen(&all, None, size);
            assert_eq!((chosen.len(), chosen[0], chosen[count - 1]), (count, 0, 399), "{size}");
        }
        assert_eq!(chosen(&entries(3, 50.0, 2000), None, 1024), [0, 1, 2]);
    }

    #[test]
    fn an_end_is_drawn_from_its_piece_and_one_section_beyond() {
        for (spacing, isthmus) in [(300.0, 0..4), (600.0, 0..3), (5000.0, 0..2)] {
            let all = entries(20, spacing, 100);
            let mirrored: Vec<usize> = isthmus.clone().map(|k| 19 - k).rev().collect();
            assert_eq!(chosen(&all, Some(&section(0.0)), 1024), isthmus.collect::<Vec<_>>(), "{spacing}");
            assert_eq!(chosen(&all, Some(&section(19.0 * spacing)), 1024), mirrored, "{spacing}");
        }
        let dense = chosen(&entries(4000, 1.0, 100), Some(&section(0.0)), 2048);
        assert_eq!((dense.len(), dense[0], dense[80]), (81, 0, 801));
    }

    proptest! {
        #[test]
        fn no_picture_has_more_points_than_it_may(
            count in 2_usize..3000, spacing in 0.1_f64..1e4, points in 6_u32..3_000_000, size in 32_u32..8192,
            which in 0..3,
        ) {
            let all = entries(count, spacing, points);
            let end = [None, Some(0), Some(count - 1)][which as usize].map(|k| section(all[k].z_um));
            let chosen = chosen(&all, end.as_ref(), size);
            prop_assert!(chosen.len() == 2 || chosen.len() * points as usize <= MAX_POINTS);
            prop_assert!(chosen.len() >= 2 && chosen.is_sorted_by(|a, b| a < b) && chosen[chosen.len() - 1] < count);
        }
    }

    #[test]
    fn the_surface_of_a_view_reaches_as_far_as_its_sections() {
        let sections: Vec<Section> = (0..10).map(|k| section(400.0 * f64::from(k))).collect();
        let mut file = Vec::new();
        write_sections(&sections, &meta(), &mut file).unwrap();
        for (view, ends) in [
            (NamedView::Opened, [0.0, 3600.0]),
            (NamedView::Isthmus, [0.0, 1200.0]),
            (NamedView::Ampulla, [2400.0, 3600.0]),
        ] {
            let mesh = surface(std::io::Cursor::new(&file), view, 256).unwrap();
            let along = mesh.positions.iter().map(|p| f64::from(p[2]) * 1e6);
            let found = [along.clone().fold(f64::INFINITY, f64::min), along.fold(f64::NEG_INFINITY, f64::max)];
            assert!((found[0] - ends[0]).abs() < 0.01 && (found[1] - ends[1]).abs() < 0.01, "{view:?}: {found:?}");
        }
    }

    #[test]
    fn the_picture_of_an_end_does_not_depend_on_the_spacing_of_sections() {
        let bounds = |spacing: f64, view: NamedView| {
            let sections: Vec<Section> = (0..12).map(|k| section(spacing * f64::from(k))).collect();
            let mut file = Vec::new();
            write_sections(&sections, &meta(), &mut file).unwrap();
            let mesh = surface(std::io::Cursor::new(&file), view, 200).unwrap();
            let png = crate::render::mesh_png(&mesh, &view.of(&mesh, 200), None).unwrap();
            let picture = tiny_skia::Pixmap::decode_png(&png).unwrap();
            let visible = |(_, p): &(usize, &tiny_skia::PremultipliedColorU8)| p.alpha() > 0;
            let places: Vec<_> =
                picture.pixels().iter().enumerate().filter(visible).map(|(i, _)| (i % 200, i / 200)).collect();
            let along = |of: fn(&(usize, usize)) -> usize| places.iter().map(of);
            [along(|p| p.0).min(), along(|p| p.0).max(), along(|p| p.1).min(), along(|p| p.1).max()].map(Option::unwrap)
        };
        for view in [NamedView::Isthmus, NamedView::Ampulla] {
            let dense = bounds(100.0, view);
            assert!(dense[1] - dense[0] > 180 || dense[3] - dense[2] > 180, "{dense:?}");
            for spacing in [300.0, 600.0, 5000.0] {
                let found = bounds(spacing, view);
                let off = (0..4).map(|k| found[k].abs_diff(dense[k])).max();
                assert!(off <= Some(1), "{view:?} at {spacing}: {found:?}, {dense:?}");
            }
        }
    }

    #[test]
    fn a_model_without_a_tube_is_refused() {
        for count in [0, 1] {
            let mut file = Vec::new();
            let sections: Vec<Section> = (0..count).map(|k| section(f64::from(k))).collect();
            write_sections(&sections, &meta(), &mut file).unwrap();
            for view in NamedView::ALL {
                let error = surface(std::io::Cursor::new(&file), view, 64).unwrap_err();
                assert!(matches!(error, PreviewError::Loft(LoftError::NoSlab)), "{view:?}: {error}");
            }
        }
    }
}
