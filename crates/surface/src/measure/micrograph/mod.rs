//! Images of sections: traces a mask or a label image into contours, which are measured like those
//! of models.
//!
//! The contours are simple and do not intersect each other. `docs/morphometry.md` ("Measuring an
//! image") describes the rules and the accuracy.
//!
//! | file | subject |
//! |---|---|
//! | `error` | reasons to refuse an image |
//! | `limits` | accepted images |
//! | `read` | files of several formats to values, within limits |
//! | `reading` | side of a pixel, and which values are tissue |
//! | `regions` | pixels of the outside, the tissue and the lumen |
//! | `contour` | border of a region, smoothed |
//! | `spacing` | points at equal distances |
//! | `picture` | the image in grey, to draw the contours over it |

mod contour;
mod error;
#[cfg(feature = "fuzzing")]
#[doc(hidden)]
pub mod fuzzing;
mod limits;
mod picture;
mod read;
mod reading;
mod regions;
mod spacing;

pub use error::{MicrographError, Setting};
pub use limits::{EXTENT_MM, LEAST_AREA_UM2, MAX_BYTES, MAX_SIDE, PIXEL_UM};
pub use picture::Picture;
pub use reading::{Reading, Tissue};

use super::morphometry::{Measures, Shape, measure};
use contour::{Loop, trace};
use limits::MAX_POINTS;
use regions::{PixelRegions, Region};
use spacing::spaced;

/// Contours of a section, traced in an image. Coordinates are micrometres from the centre of the
/// image, x to the right and y up.
#[derive(Clone, Debug, PartialEq)]
pub struct Micrograph {
    /// Outer contour of the tissue, counter-clockwise.
    outer: Vec<[f32; 2]>,
    /// Contours of the lumen: counter-clockwise ones, the largest first, then clockwise ones of
    /// islands.
    lumen: Vec<Vec<[f32; 2]>>,
    /// Side of a pixel of the file, µm.
    pixel_um: f64,
    /// Remarks on how the file was read.
    notes: Vec<String>,
}

impl Micrograph {
    /// Traces the section in an image: PNG, TIFF, BMP, JPEG or QuPath's GeoJSON.
    ///
    /// # Errors
    /// Returns [`MicrographError`] if the file is not an accepted mask or the mask does not show
    /// one whole section.
    pub fn read(file: &[u8], reading: &Reading) -> Result<Self, MicrographError> {
        Self::read_within(file, reading, MAX_SIDE)
    }

    /// Traces the section in an image of at most `side` pixels a side.
    fn read_within(file: &[u8], reading: &Reading, side: u32) -> Result<Self, MicrographError> {
        let mut image = read::read(file, side)?;
        let pixel_um = reading.side_um(&mut image)?;
        let pixel = pixel_um * image.step;
        let classes = reading.classes(&mut image)?;
        let mut field = PixelRegions::new(&image, &classes);
        let notes = image.notes;
        drop(image.values);
        field.keep_the_largest_piece()?;
        let mut room = MAX_POINTS;
        let least = LEAST_AREA_UM2 / (pixel * pixel);
        let outside = trace(&mut field, Region::Outside, 0.0, &mut room)?;
        field.find_the_lumen(least)?;
        let mut lumen = trace(&mut field, Region::Lumen, least, &mut room)?;
        // Larger contours first; islands have negative areas.
        lumen.sort_by_key(|border| std::cmp::Reverse(border.area));

        let middle = field.size().map(|side| side as f64 / 2.0);
        let place = |[x, y]: [f64; 2]| [(x - middle[0]) * pixel, (middle[1] - y) * pixel].map(|um| um as f32);
        let placed = |border: &Loop| -> Vec<[f32; 2]> { border.smooth().map(place).collect() };
        let mut outer = outside.first().map(placed).ok_or(MicrographError::NoTissue)?;
        // The outside lies to the left of its border.
        outer.reverse();
        let extent_mm = extent(&outer) / 1e3;
        if !EXTENT_MM.contains(&extent_mm) {
            return Err(MicrographError::Extent(extent_mm));
        }
        let mut contours: Vec<_> = std::iter::once(outer).chain(lumen.iter().map(placed)).collect();
        // Holes beyond the base ellipse of the largest hole are vessels or cracks in the wall.
        // Islands in them are removed with them.
        let is_lumen = Shape { outer: &contours[0], lumen: vec![&contours[1]] }.within_base();
        for (hole, contour) in lumen.iter().zip(&contours[1..]).skip(1) {
            if hole.area > 0 && !is_lumen(contour) {
                field.close(hole.start);
            }
        }
        let mut kept = std::iter::once(true).chain(lumen.iter().map(|border| field.is(Region::Lumen, border.start)));
        contours.retain(|_| kept.next().unwrap_or(false));
        let mut contours = spaced(contours, pixel).into_iter();
        Ok(Self { outer: contours.next().unwrap_or_default(), lumen: contours.collect(), pixel_um, notes })
    }

    /// Returns the contours as the measures need them.
    #[must_use]
    pub fn shape(&self) -> Shape<'_> {
        Shape { outer: &self.outer, lumen: self.lumen.iter().map(Vec::as_slice).collect() }
    }

    /// Returns the side of a pixel, µm, as given or as the file states it.
    #[must_use]
    pub fn pixel_um(&self) -> f64 {
        self.pixel_um
    }

    /// Returns remarks on how the file was read.
    #[must_use]
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Computes all measures, including the shape tree.
    #[must_use]
    pub fn measure(&self) -> Measures {
        measure(&self.shape(), true)
    }
}

/// Longer side of the bounding box of a contour.
fn extent(contour: &[[f32; 2]]) -> f64 {
    let side = |axis: usize| {
        let along = contour.iter().map(|point| point[axis]);
        along.clone().fold(f32::MIN, f32::max) - along.fold(f32::MAX, f32::min)
    };
    f64::from(side(0).max(side(1)))
}

#[cfg(test)]
mod tests;
