//! Reads BMP and JPEG.

use super::super::error::MicrographError;
use super::pixels::{Gatherer, Image, Kind, Layout, check_size, unpacked};
use super::stated::Stated;
use image::codecs::bmp::BmpDecoder;
use image::codecs::jpeg::JpegDecoder;
use image::{ColorType, ImageDecoder, ImageError};
use std::io::Cursor;

/// Maximum number of pixels of a JPEG: its decoder keeps all coefficients of a progressive one.
const MAX_PIXELS: u64 = 25_000_000;
/// Maximum number of pixels times scans of a JPEG, which bounds the time.
const MAX_WORK: u64 = 1 << 29;
/// Maximum difference of the colours of a grey pixel in a JPEG that was saved in colour.
const GREY: u16 = 8;

pub(super) fn bmp(bytes: &[u8], side: u32) -> Result<Image, MicrographError> {
    let failed = |error| refused("BMP", &error);
    let decoder = BmpDecoder::new(Cursor::new(bytes)).map_err(failed)?;
    pixels(decoder, "BMP", side, Kind::Exact)
}

pub(super) fn jpeg(bytes: &[u8], side: u32) -> Result<Image, MicrographError> {
    // The decoder fills the missing part of a truncated file.
    let end = bytes.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
    if !bytes[..end].ends_with(&[0xff, 0xd9]) {
        return Err(MicrographError::Damaged("JPEG", "it is cut off: its end marker is missing".into()));
    }
    let decoder = JpegDecoder::new(Cursor::new(bytes)).map_err(|error| refused("JPEG", &error))?;
    let (width, height) = decoder.dimensions();
    check_size([width, height], side)?;
    let count = u64::from(width) * u64::from(height);
    let scans = bytes.windows(2).filter(|pair| *pair == [0xff, 0xda]).count() as u64;
    if count > MAX_PIXELS || count * scans > MAX_WORK {
        let text = format!(
            "a JPEG of {width} × {height} pixels in {scans} scans; at most {MAX_PIXELS} pixels, and {MAX_WORK} pixels \
            times scans, are read"
        );
        return Err(MicrographError::Variant(text));
    }
    pixels(decoder, "JPEG", side, Kind::Blurred)
}

fn pixels(decoder: impl ImageDecoder, format: &'static str, side: u32, kind: Kind) -> Result<Image, MicrographError> {
    let (width, height) = decoder.dimensions();
    check_size([width, height], side)?;
    if width == 0 || height == 0 {
        return Err(MicrographError::Damaged(format, "it has no pixels".into()));
    }
    let color = decoder.color_type();
    let (samples, alpha) = match color {
        ColorType::L8 => (1, false),
        ColorType::La8 => (2, true),
        ColorType::Rgb8 => (3, false),
        ColorType::Rgba8 => (4, true),
        other => return Err(MicrographError::Variant(format!("the {format} has pixels of the kind {other:?}"))),
    };
    let mut packed = vec![0; width as usize * height as usize * samples];
    decoder.read_image(&mut packed).map_err(|error| refused(format, &error))?;
    let tolerance = if kind == Kind::Blurred { GREY } else { 0 };
    let layout = Layout { samples, opaque: alpha.then_some(255), tolerance };
    let mut pixels = Gatherer::new(layout, [width, height]);
    for (row, packed) in packed.chunks_exact(width as usize * samples).enumerate() {
        pixels.set([0, row], unpacked(packed, 8))?;
    }
    drop(packed);
    Ok(pixels.finish(kind, Stated::Nothing))
}

fn refused(format: &'static str, error: &ImageError) -> MicrographError {
    match error {
        ImageError::Unsupported(_) => MicrographError::Variant(format!("this {format} is not read ({error})")),
        _ => MicrographError::Damaged(format, error.to_string()),
    }
}
