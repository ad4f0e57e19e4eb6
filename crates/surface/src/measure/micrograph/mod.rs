//! Images of sections: a mask or a label image is traced into contours, which are measured as those of models are.
//!
//! The contours are simple and do not meet. `docs/morphometry.md` ("Measuring an image") has the rules and the accuracy.
//!
//! | file | subject |
//! |---|---|
//! | `error` | why an image is refused |
//! | `limits` | what is accepted |
//! | `read` | PNG to values, within limits |
//! | `regions` | which pixels are the outside, the tissue and the lumen |
//! | `contour` | the border of a region, without stairs |
//! | `spacing` | points at even distances |

mod contour;
mod error;
#[cfg(feature = "fuzzing")]
#[doc(hidden)]
pub mod fuzzing;
mod limits;
mod read;
mod regions;
mod spacing;

pub use error::MicrographError;
pub use limits::{EXTENT_MM, LEAST_AREA_UM2, MAX_BYTES, MAX_SIDE, PIXEL_UM};

use super::morphometry::{Measures, Shape, measure};
use contour::{Loop, trace};
use limits::MAX_POINTS;
use regions::{Field, Region};
use spacing::spaced;

/// How to read an image of a section.
#[derive(Clone, Debug, PartialEq)]
pub struct Reading {
    /// Side of a pixel, µm.
    pub pixel_um: f64,
    /// Values that are tissue; without them, all but 0.
    pub tissue: Option<Vec<u8>>,
}

/// The contours of a section that were traced in an image, in micrometres: x to the right, y up, from the middle of the image.
#[derive(Clone, Debug, PartialEq)]
pub struct Micrograph {
    /// Outside of the tissue, counter-clockwise.
    outer: Vec<[f32; 2]>,
    /// Counter-clockwise contours of the lumen, the largest first; then clockwise ones of islands in it.
    lumen: Vec<Vec<[f32; 2]>>,
}

impl Micrograph {
    /// Traces the section in a PNG image.
    ///
    /// # Errors
    /// [`MicrographError`].
    pub fn read(png: &[u8], reading: &Reading) -> Result<Self, MicrographError> {
        let pixel = reading.pixel_um;
        if !PIXEL_UM.contains(&pixel) {
            return Err(MicrographError::PixelSize(pixel));
        }
        let is_tissue: [bool; 256] = std::array::from_fn(|value| match &reading.tissue {
            Some(values) => values.iter().any(|&tissue| usize::from(tissue) == value),
            None => value != 0,
        });
        let mut field = Field::new(&read::read(png)?, &is_tissue);
        field.keep_the_largest_piece()?;
        let mut room = MAX_POINTS;
        let least = LEAST_AREA_UM2 / (pixel * pixel);
        let outside = trace(&mut field, Region::Outside, 0.0, &mut room)?;
        field.find_the_lumen(least)?;
        let mut lumen = trace(&mut field, Region::Lumen, least, &mut room)?;
        // Larger ones first; islands have negative areas.
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
        // Holes beyond the base ellipse of the largest are in the wall: vessels and cracks. Islands in them go with them.
        let is_lumen = Shape { outer: &contours[0], lumen: vec![&contours[1]] }.within_base();
        for (hole, contour) in lumen.iter().zip(&contours[1..]).skip(1) {
            if hole.area > 0 && !is_lumen(contour) {
                field.close(hole.start);
            }
        }
        let mut kept = std::iter::once(true).chain(lumen.iter().map(|border| field.is(Region::Lumen, border.start)));
        contours.retain(|_| kept.next().unwrap_or(false));
        let mut contours = spaced(contours, pixel).into_iter();
        Ok(Self { outer: contours.next().unwrap_or_default(), lumen: contours.collect() })
    }

    /// The section as the measures see it.
    #[must_use]
    pub fn shape(&self) -> Shape<'_> {
        Shape { outer: &self.outer, lumen: self.lumen.iter().map(Vec::as_slice).collect() }
    }

    /// All measures, the shape tree included.
    #[must_use]
    pub fn measure(&self) -> Measures {
        measure(&self.shape(), true)
    }
}

/// The longer side of a contour.
fn extent(contour: &[[f32; 2]]) -> f64 {
    let side = |axis: usize| {
        let along = contour.iter().map(|point| point[axis]);
        along.clone().fold(f32::MIN, f32::max) - along.fold(f32::MAX, f32::min)
    };
    f64::from(side(0).max(side(1)))
}

#[cfg(test)]
mod tests;
