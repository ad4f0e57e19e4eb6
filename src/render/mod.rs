//! Pictures of models without a GPU: sections as in a histological slide, meshes lit and cut open.
//!
//! Everything is computed in a fixed order from the input alone: the same model gives the same picture.

mod mesh;
mod raster;
mod section;
mod view;

pub use mesh::mesh_png;
pub use section::{section_png, sheet_png};
pub use view::{Plane, View};

/// Media type of the pictures.
pub const MEDIA_TYPE: &str = "image/png";

/// Widest and highest picture, pixels.
pub const MAX_SIZE: u32 = 8192;

/// Why there is no picture.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// A side is 0 or over [`MAX_SIZE`].
    #[error("a picture of {width} × {height} pixels is out of bounds (1 to {MAX_SIZE} each)")]
    Size {
        /// Width asked for.
        width: u32,
        /// Height asked for.
        height: u32,
    },
    /// The view has an angle or a scale that no picture can be made with.
    #[error("the view is out of bounds: {0}")]
    View(&'static str),
    /// The picture could not be encoded.
    #[error("encoding the picture failed: {0}")]
    Encode(String),
}

/// A colour as in CSS: red, green, blue of sRGB.
type Rgb = [u8; 3];

/// Cut tissue.
const TISSUE: Rgb = [0xde, 0x95, 0xa9];
/// Boundary of the lumen.
const OUTLINE: Rgb = [0x7d, 0x3a, 0x78];
/// Inside of the lumen in a section.
const LUMEN: Rgb = [0xff, 0xfa, 0xf8];
const BACKGROUND: Rgb = [0xff, 0xff, 0xff];
/// Scale bars.
const INK: Rgb = [0x3b, 0x2a, 0x38];

/// A white picture of valid size.
fn pixmap(width: u32, height: u32) -> Result<tiny_skia::Pixmap, RenderError> {
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

fn encode(pixmap: &tiny_skia::Pixmap) -> Result<Vec<u8>, RenderError> {
    pixmap.encode_png().map_err(|error| RenderError::Encode(error.to_string()))
}
