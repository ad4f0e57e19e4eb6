//! Reasons to refuse an image.

use super::limits::{EXTENT_MM, LEAST_AREA_UM2, MAX_POINTS, MAX_SIDE, PIXEL_UM};

/// Errors of tracing a section in an image.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MicrographError {
    /// The file has no PNG signature.
    #[error("not a PNG image")]
    NotPng,
    /// The file is truncated or was changed.
    #[error("the PNG is damaged: {0}")]
    Damaged(String),
    /// Too many pixels.
    #[error("the image has {width} × {height} pixels; at most {MAX_SIDE} a side are read")]
    Size {
        /// Pixels in a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// More than eight bits per pixel.
    #[error("the image has 16 bits a pixel; at most 8 are read")]
    Depth,
    /// The image is neither grey nor indexed.
    #[error("the image is in colour; a mask is grey, or has a palette whose indices are the labels")]
    Colour,
    /// Some pixels may be transparent.
    #[error("the image has transparency; save it without an alpha channel and without a transparent colour")]
    Transparent,
    /// An animation.
    #[error("the image is animated; one frame is read")]
    Animated,
    /// The side of a pixel is out of range.
    #[error("a pixel of {0} µm; sides of {least} to {most} µm are accepted", least = PIXEL_UM.start(), most = PIXEL_UM.end())]
    PixelSize(f64),
    /// The section is too small or too large.
    #[error("the section is {0} mm long; {least} to {most} mm are accepted", least = EXTENT_MM.start(), most = EXTENT_MM.end())]
    Extent(f64),
    /// No pixel is tissue.
    #[error("no pixel is tissue: check which values are tissue")]
    NoTissue,
    /// The section is cut off.
    #[error("the tissue touches the border of the image: the section is cut off, or the values of tissue are wrong")]
    CutOff,
    /// The tissue has no hole.
    #[error("the tissue has no lumen, a hole of at least {LEAST_AREA_UM2} µm²: check which values are tissue")]
    NoLumen,
    /// The borders are too long.
    #[error("the borders of the tissue pass more than {MAX_POINTS} sides of pixels: the mask is too rough")]
    Rough,
}
