//! Traced outlines, drawn over the image in which they were traced.

use super::picture::{RenderError, Rgb, encode, paint, pixmap};
use tiny_skia::{LineJoin, PathBuilder, PremultipliedColorU8, Stroke, Transform};

/// What an outline bounds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outline {
    /// The section, outside.
    Outer,
    /// The lumen.
    Lumen,
    /// A piece of tissue in the lumen.
    Island,
}

impl Outline {
    /// Colours that people with colour blindness tell apart (Okabe and Ito 2008).
    fn colour(self) -> Rgb {
        match self {
            Self::Outer => [0x00, 0x72, 0xb2],
            Self::Lumen => [0xd5, 0x5e, 0x00],
            Self::Island => [0x00, 0x9e, 0x73],
        }
    }
}

/// Black in the faded image.
const DARKEST: u8 = 150;

/// Draws outlines over a faded grey image as PNG. Points are in pixels from the upper left corner.
///
/// # Errors
/// [`RenderError::Size`] unless each side is from 1 to [`MAX_SIZE`](super::MAX_SIZE) and the image
/// has as many values; [`RenderError::Encode`] if encoding fails.
pub fn outlines_png(
    [width, height]: [u32; 2],
    grey: &[u8],
    outlines: &[(Outline, Vec<[f32; 2]>)],
) -> Result<Vec<u8>, RenderError> {
    let mut pixmap = pixmap(width, height)?;
    if grey.len() != pixmap.pixels().len() {
        return Err(RenderError::Size { width, height });
    }
    for (pixel, grey) in pixmap.pixels_mut().iter_mut().zip(grey) {
        let faded = DARKEST + (u16::from(*grey) * u16::from(u8::MAX - DARKEST) / 255) as u8;
        if let Some(colour) = PremultipliedColorU8::from_rgba(faded, faded, faded, u8::MAX) {
            *pixel = colour;
        }
    }
    let stroke =
        Stroke { width: (width.max(height) as f32 / 800.0).max(1.0), line_join: LineJoin::Round, ..Stroke::default() };
    for (kind, points) in outlines {
        let mut path = PathBuilder::new();
        for (i, [x, y]) in points.iter().enumerate() {
            if i == 0 { path.move_to(*x, *y) } else { path.line_to(*x, *y) }
        }
        path.close();
        if let Some(path) = path.finish() {
            pixmap.stroke_path(&path, &paint(kind.colour()), &stroke, Transform::identity(), None);
        }
    }
    encode(&pixmap)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outlines_are_drawn_over_the_faded_image() {
        let grey: Vec<u8> = (0..100).map(|i| if i % 10 < 5 { 0 } else { 255 }).collect();
        let square = vec![[2.5, 2.5], [7.5, 2.5], [7.5, 7.5], [2.5, 7.5]];
        let png = outlines_png([10, 10], &grey, &[(Outline::Lumen, square)]).unwrap();
        let drawn = tiny_skia::Pixmap::decode_png(&png).unwrap();
        let at = |x, y| drawn.pixel(x, y).map(|pixel| [pixel.red(), pixel.green(), pixel.blue()]).unwrap();
        assert_eq!((at(0, 0), at(9, 9)), ([150; 3], [255; 3]));
        assert_eq!(at(5, 2), [0xd5, 0x5e, 0x00]);
        assert!(outlines_png([10, 11], &grey, &[]).is_err() && outlines_png([0, 10], &[], &[]).is_err());
    }
}
