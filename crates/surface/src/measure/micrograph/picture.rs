//! The image in grey, smaller if it is large, to draw the contours over it.

use super::error::MicrographError;
use super::limits::MAX_SIDE;
use super::read;

/// Maximum width and height of a picture, pixels.
const MOST: usize = 4096;

/// An image in grey: its lowest value is black, its highest white.
#[derive(Clone, Debug)]
pub struct Picture {
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Grey values, row by row from the top.
    pub grey: Vec<u8>,
    /// Side of a pixel of this picture, in pixels of the file.
    pub side: f64,
    /// Centre of the image, in pixels of this picture from the upper left corner.
    pub centre: [f64; 2],
}

impl Picture {
    /// Reads the image in a file.
    ///
    /// # Errors
    /// [`MicrographError`] if the file is not read.
    pub fn read(file: &[u8]) -> Result<Self, MicrographError> {
        let image = read::read(file, MAX_SIDE)?;
        let (width, height) = (image.width, image.values.len() / image.width);
        let (least, most) = image.values.iter().fold((u16::MAX, 0), |(a, b), &value| (a.min(value), b.max(value)));
        let range = u32::from(most.saturating_sub(least).max(1));
        let factor = width.max(height).div_ceil(MOST).max(1);
        let [columns, rows] = [width, height].map(|side| side.div_ceil(factor));
        let mut grey = Vec::with_capacity(columns * rows);
        for band in image.values.chunks(factor * width) {
            for left in (0..width).step_by(factor) {
                let right = (left + factor).min(width);
                let cells = band.chunks(width).flat_map(|row| &row[left..right]);
                let (sum, count) = cells.fold((0, 0), |(sum, n), value| (sum + u32::from(value - least), n + 1));
                grey.push((u64::from(sum) * 255 / u64::from(range * count)) as u8);
            }
        }
        Ok(Self {
            size: [columns, rows].map(|side| side as u32),
            grey,
            side: image.step * factor as f64,
            centre: [width, height].map(|side| side as f64 / 2.0 / factor as f64),
        })
    }

    /// Returns the places of points of a contour in this picture. `pixel_um` is the side of a pixel
    /// of the file.
    #[must_use]
    pub fn place(&self, contour: &[[f32; 2]], pixel_um: f64) -> Vec<[f32; 2]> {
        let um = pixel_um * self.side;
        let [x, y] = self.centre;
        contour.iter().map(|p| [x + f64::from(p[0]) / um, y - f64::from(p[1]) / um].map(|at| at as f32)).collect()
    }
}
