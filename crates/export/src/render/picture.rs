//! Size, colours, encoding and errors of pictures.

use glam::Vec3;
use std::sync::LazyLock;

/// Maximum width and height of a picture, pixels.
pub const MAX_SIZE: u32 = 8192;

/// Reason why a picture could not be drawn.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// A side is 0 or above [`MAX_SIZE`].
    #[error("a picture of {width} × {height} pixels is out of bounds (1 to {MAX_SIZE} each)")]
    Size {
        /// Requested width.
        width: u32,
        /// Requested height.
        height: u32,
    },
    /// An angle or a scale of the view is out of bounds.
    #[error("the view is out of bounds: {0}")]
    View(&'static str),
    /// The picture could not be encoded.
    #[error("encoding the picture failed: {0}")]
    Encode(String),
}

/// A colour: red, green and blue of sRGB.
pub(super) type Rgb = [u8; 3];

/// Colour of cut tissue.
pub(super) const TISSUE: Rgb = [0xe6, 0xa6, 0xb4];
/// Colour of the boundary of the lumen.
pub(super) const OUTLINE: Rgb = [0x7d, 0x3a, 0x78];
/// Colour of the lumen in a section.
pub(super) const LUMEN: Rgb = [0xff, 0xfa, 0xf8];
pub(super) const BACKGROUND: Rgb = [0xff, 0xff, 0xff];
/// Colour of text, and of the scale bars of sections.
pub(super) const INK: Rgb = [0x3b, 0x2a, 0x38];

/// Linear light of an sRGB colour.
pub(super) fn linear(color: Rgb) -> Vec3 {
    Vec3::from(color.map(|value| decoded(f32::from(value))))
}

/// Linear light of an sRGB value from 0 to 255.
pub(super) fn decoded(value: f32) -> f32 {
    let c = value / 255.0;
    if c <= 0.040_45 { c / 12.92 } else { libm::powf((c + 0.055) / 1.055, 2.4) }
}

/// sRGB of linear light.
pub(super) fn srgb(color: Vec3) -> Rgb {
    /// Linear light halfway between each sRGB value and the next.
    static BETWEEN: LazyLock<[f32; 255]> = LazyLock::new(|| std::array::from_fn(|value| decoded(value as f32 + 0.5)));
    color.to_array().map(|light| BETWEEN.partition_point(|&between| between < light) as u8)
}

/// Creates a white picture.
///
/// # Errors
/// [`RenderError::Size`] unless each side is from 1 to [`MAX_SIZE`].
pub(super) fn pixmap(width: u32, height: u32) -> Result<tiny_skia::Pixmap, RenderError> {
    let sides = 1..=MAX_SIZE;
    let valid = sides.contains(&width) && sides.contains(&height);
    let mut pixmap =
        valid.then(|| tiny_skia::Pixmap::new(width, height)).flatten().ok_or(RenderError::Size { width, height })?;
    pixmap.fill(color(BACKGROUND));
    Ok(pixmap)
}

fn color([r, g, b]: Rgb) -> tiny_skia::Color {
    tiny_skia::Color::from_rgba8(r, g, b, 255)
}

/// Paint of one colour with smooth edges.
pub(super) fn paint(rgb: Rgb) -> tiny_skia::Paint<'static> {
    let mut paint = tiny_skia::Paint { anti_alias: true, ..tiny_skia::Paint::default() };
    paint.set_color(color(rgb));
    paint
}

pub(super) fn encode(pixmap: &tiny_skia::Pixmap) -> Result<Vec<u8>, RenderError> {
    pixmap.encode_png().map_err(|error| RenderError::Encode(error.to_string()))
}
