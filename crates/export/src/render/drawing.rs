//! A picture with its scale, for placement on a page.

use super::picture::{RenderError, encode};
use tiny_skia::Pixmap;

/// A picture without a scale bar.
#[derive(Clone, Debug)]
pub struct Drawing {
    pub(super) pixmap: Pixmap,
    /// Pixels per metre across the tube.
    pub(super) scale: f64,
    /// Factor on lengths along the tube.
    pub(super) axial_scale: f64,
}

impl Drawing {
    /// Width and height, pixels.
    #[must_use]
    pub fn size(&self) -> [u32; 2] {
        [self.pixmap.width(), self.pixmap.height()]
    }

    /// Micrometres per pixel across the tube.
    #[must_use]
    pub fn um_per_pixel(&self) -> f64 {
        1e6 / self.scale
    }

    /// Part of `size` pixels around the pixel at `middle`, cropped at the borders of the drawing.
    #[must_use]
    pub fn around(&self, middle: [f64; 2], size: [u32; 2]) -> Self {
        let all = self.size();
        let range = |axis: usize| {
            let start =
                (middle[axis] - f64::from(size[axis]) / 2.0).round().clamp(0.0, f64::from(all[axis] - 1)) as u32;
            (start, size[axis].clamp(1, all[axis] - start))
        };
        let ((left, width), (top, height)) = (range(0), range(1));
        let part = tiny_skia::IntRect::from_xywh(left as i32, top as i32, width, height);
        let pixmap = part.and_then(|part| self.pixmap.clone_rect(part)).unwrap_or_else(|| self.pixmap.clone());
        Self { pixmap, ..*self }
    }

    /// Encodes the picture as PNG.
    ///
    /// # Errors
    /// [`RenderError::Encode`] if encoding fails.
    pub fn png(&self) -> Result<Vec<u8>, RenderError> {
        encode(&self.pixmap)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_keeps_its_scale() {
        let mut pixmap = Pixmap::new(10, 6).unwrap();
        pixmap.data_mut()[4 * (2 * 10 + 4) + 3] = 255;
        let drawing = Drawing { pixmap, scale: 1e6, axial_scale: 1.0 };
        let part = drawing.around([5.0, 3.0], [2, 4]);
        assert_eq!((part.size(), part.um_per_pixel()), ([2, 4], 1.0));
        assert_eq!(part.pixmap.pixel(0, 1).map(tiny_skia::PremultipliedColorU8::alpha), Some(255));
        assert_eq!(drawing.around([5.0, 3.0], [99, 99]).size(), [10, 6]);
        assert_eq!(Pixmap::decode_png(&part.png().unwrap()).unwrap().width(), 2);
    }
}
