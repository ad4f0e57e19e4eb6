//! Reads the values of a grey or palette PNG. [`MAX_SIDE`] bounds the memory, whatever the file
//! declares.

use super::error::MicrographError;
use super::limits::MAX_SIDE;
use png::{BitDepth, ColorType, Decoder, DecodingError, Info, Limits};
use std::io::Cursor;

/// Maximum memory of the decoder for chunks other than pixels, bytes.
const MAX_CHUNKS: usize = 8 << 20;

const SIGNATURE: &[u8] = b"\x89PNG\r\n\x1a\n";

/// Pixels of an image, row by row from the top.
pub(super) struct Image {
    pub(super) width: usize,
    /// Bits per pixel; rows begin at whole bytes.
    bits: usize,
    packed: Vec<u8>,
}

impl Image {
    /// Values of each row: stored grey values, or indices of the palette.
    pub(super) fn rows(&self) -> impl ExactSizeIterator<Item = impl Iterator<Item = u8>> {
        let (bits, width) = (self.bits, self.width);
        let mask = u8::MAX >> (8 - bits);
        self.packed.chunks_exact((width * bits).div_ceil(8)).map(move |row| {
            (0..width).map(move |column| {
                let at = column * bits;
                row[at / 8] >> (8 - bits - at % 8) & mask
            })
        })
    }
}

pub(super) fn read(png: &[u8]) -> Result<Image, MicrographError> {
    if !png.starts_with(SIGNATURE) {
        return Err(MicrographError::NotPng);
    }
    let mut decoder = Decoder::new_with_limits(Cursor::new(png), Limits { bytes: MAX_CHUNKS });
    // These chunks inflate without bound and do not affect pixels.
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    accepted(decoder.read_header_info().map_err(damaged)?)?;
    let mut reader = decoder.read_info().map_err(damaged)?;
    accepted(reader.info())?;
    let mut packed = vec![0; reader.output_buffer_size().ok_or_else(|| MicrographError::Damaged("its size".into()))?];
    reader.next_frame(&mut packed).map_err(damaged)?;
    // Reads up to the last chunk, so that a file truncated behind the pixels is refused, too.
    reader.finish().map_err(damaged)?;
    let info = reader.info();
    Ok(Image { width: info.width as usize, bits: usize::from(info.bit_depth as u8), packed })
}

/// Refuses images that are not masks, by the information read so far.
fn accepted(info: &Info<'_>) -> Result<(), MicrographError> {
    let (width, height) = (info.width, info.height);
    if width > MAX_SIDE || height > MAX_SIDE {
        return Err(MicrographError::Size { width, height });
    }
    if info.bit_depth == BitDepth::Sixteen {
        return Err(MicrographError::Depth);
    }
    if matches!(info.color_type, ColorType::GrayscaleAlpha | ColorType::Rgba) || info.trns.is_some() {
        return Err(MicrographError::Transparent);
    }
    if info.color_type == ColorType::Rgb {
        return Err(MicrographError::Colour);
    }
    if info.animation_control.is_some() {
        return Err(MicrographError::Animated);
    }
    Ok(())
}

fn damaged(error: DecodingError) -> MicrographError {
    MicrographError::Damaged(match error {
        DecodingError::IoError(_) => "it is cut off".into(),
        DecodingError::LimitsExceeded => format!("a chunk takes more than {} MiB", MAX_CHUNKS >> 20),
        other => other.to_string(),
    })
}
