//! Reasons to refuse an image.

use super::limits::{EXTENT_MM, LEAST_AREA_UM2, MAX_POINTS, MAX_SIDE, PIXEL_UM};
use std::borrow::Cow;

/// Errors of tracing a section in an image.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MicrographError {
    /// The file has none of the formats that are read. The field names the format, if it is known.
    #[error("{0}; PNG, TIFF, OME-TIFF, BMP, JPEG and QuPath's GeoJSON are read")]
    Format(&'static str),
    /// The file is truncated or was changed. The fields are its format and what is wrong.
    #[error("the {0} is damaged: {reason}", reason = start_of(.1))]
    Damaged(&'static str, String),
    /// The format is read, but not this variant of it.
    #[error("{reason}; save the image as a grey PNG or TIFF of 8 or 16 bits", reason = start_of(.0))]
    Variant(String),
    /// Too many pixels.
    #[error("the image has {width} × {height} pixels; at most {MAX_SIDE} a side are read")]
    Size {
        /// Pixels in a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// The image is neither grey nor indexed.
    #[error(
        "the image is in colour: the pixel in column {column}, row {row} is {red}, {green}, {blue}; a mask is grey, \
        or has a palette whose indices are the labels; segment a stained photo first"
    )]
    Colour {
        /// Column of the first pixel in colour, from 0.
        column: usize,
        /// Row of that pixel, from 0.
        row: usize,
        /// Red of that pixel.
        red: u16,
        /// Green of that pixel.
        green: u16,
        /// Blue of that pixel.
        blue: u16,
    },
    /// A pixel is partly transparent.
    #[error(
        "the pixel in column {column}, row {row} is partly transparent; pixels must be opaque, or wholly transparent \
        outside of the section"
    )]
    Transparent {
        /// Column of the first such pixel, from 0.
        column: usize,
        /// Row of that pixel, from 0.
        row: usize,
    },
    /// Several images in one file.
    #[error("the file has {0}; one image is read: save the one with the section alone")]
    Pages(String),
    /// The pixels have several values, and nothing states which of them are tissue.
    #[error("the pixels have the values {0}, and nothing states which of them are tissue")]
    Values(String),
    /// Both values and a threshold select the tissue.
    #[error("values of tissue and a threshold exclude each other")]
    Exclusive,
    /// Values of tissue were given for an image whose values are blurred by its compression.
    #[error("JPEG blurs the values of pixels, so that single values select nothing; state a threshold")]
    Blurred,
    /// Values or a threshold were given for polygons.
    #[error("polygons have classes and no values: neither values of tissue nor a threshold apply to them")]
    Polygons,
    /// The side of a pixel is unknown.
    #[error("the side of a pixel is unknown: {0}")]
    NoPixelSize(String),
    /// The pixels are not square.
    #[error("the pixels are not square: the file states {0} × {1} µm")]
    NotSquare(f64, f64),
    /// The side of a pixel is out of range.
    #[error("a pixel of {0} µm; sides of {least} to {most} µm are accepted", least = PIXEL_UM.start(), most = PIXEL_UM.end())]
    PixelSize(f64),
    /// The section is too small or too large.
    #[error("the section is {0} mm long; {least} to {most} mm are accepted", least = EXTENT_MM.start(), most = EXTENT_MM.end())]
    Extent(f64),
    /// No pixel is tissue.
    #[error("no pixel is tissue: check the choice of tissue")]
    NoTissue,
    /// The section is cut off.
    #[error("the tissue touches the border of the image: if the section is not cut off, check the choice of tissue")]
    CutOff,
    /// The tissue has no hole.
    #[error("the tissue has no lumen, a hole of at least {LEAST_AREA_UM2} µm²: check the choice of tissue")]
    NoLumen,
    /// The borders are too long.
    #[error("the borders of the tissue pass more than {MAX_POINTS} sides of pixels: the mask is too rough")]
    Rough,
}

/// Start of a text. Messages of decoders may quote lists of the file that have any length.
fn start_of(text: &str) -> Cow<'_, str> {
    const MOST: usize = 300;
    match text.char_indices().nth(MOST) {
        Some((end, _)) => format!("{}…", &text[..end]).into(),
        None => text.into(),
    }
}

/// A setting that the caller can change to avoid an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Setting {
    /// The side of a pixel.
    PixelSize,
    /// The values of tissue, or a threshold.
    Tissue,
}

impl MicrographError {
    /// Returns the setting without which, or because of which, the image was refused.
    #[must_use]
    pub fn setting(&self) -> Option<Setting> {
        match self {
            Self::NoPixelSize(_) | Self::NotSquare(..) | Self::PixelSize(_) | Self::Extent(_) => {
                Some(Setting::PixelSize)
            }
            Self::Values(_) | Self::Exclusive | Self::Blurred | Self::Polygons => Some(Setting::Tissue),
            _ => None,
        }
    }
}
