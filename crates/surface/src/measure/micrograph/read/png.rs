//! Reads PNG: grey, a palette, or colours that are all grey, with 1 to 16 bits.

use super::super::error::MicrographError;
use super::pixels::{Gatherer, Image, Kind, Layout, check_size, unpacked};
use super::stated::Stated;
use png::{BitDepth, ColorType, Decoder, DecodingError, Info, Limits, Unit};
use std::io::Cursor;

/// Maximum memory of the decoder for chunks other than pixels, bytes.
const MAX_CHUNKS: usize = 8 << 20;
/// Maximum size of the unpacked pixels of an interlaced image, bytes.
const MAX_INTERLACED: usize = 192 << 20;

pub(super) fn read(bytes: &[u8], side: u32) -> Result<Image, MicrographError> {
    let mut decoder = Decoder::new_with_limits(Cursor::new(bytes), Limits { bytes: MAX_CHUNKS });
    // These chunks inflate without bound and do not affect pixels.
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    accepted(decoder.read_header_info().map_err(damaged)?, side)?;
    let mut reader = decoder.read_info().map_err(damaged)?;
    let info = reader.info();
    accepted(info, side)?;
    let (color, depth, stated) = (info.color_type, info.bit_depth, stated(info));
    let (size, interlaced) = ([info.width, info.height], info.interlaced);
    let clear = info.trns.as_deref().map(<[u8]>::to_vec);
    let bits = usize::from(depth as u8);
    let alpha = matches!(color, ColorType::GrayscaleAlpha | ColorType::Rgba);
    let opaque = if depth == BitDepth::Sixteen { u16::MAX } else { 255 };
    let mut pixels =
        Gatherer::new(Layout { samples: color.samples(), opaque: alpha.then_some(opaque), tolerance: 0 }, size);
    if interlaced {
        let length = reader.output_buffer_size().filter(|length| *length <= MAX_INTERLACED);
        let length = length.ok_or_else(|| MicrographError::Variant("the PNG is interlaced and too large".into()))?;
        let mut packed = vec![0; length];
        reader.next_frame(&mut packed).map_err(damaged)?;
        for (row, packed) in packed.chunks_exact(length / size[1] as usize).enumerate() {
            pixels.set([0, row], unpacked(packed, bits))?;
        }
    } else {
        for row in 0..size[1] as usize {
            let packed = reader.next_row().map_err(damaged)?;
            let packed = packed.ok_or_else(|| MicrographError::Damaged("PNG", "it is cut off".into()))?;
            pixels.set([0, row], unpacked(packed.data(), bits))?;
        }
    }
    // Reads up to the last chunk, so that a file truncated behind the pixels is refused, too.
    reader.finish().map_err(damaged)?;
    if let Some(clear) = clear {
        cleared(&mut pixels, color, &clear)?;
    }
    Ok(pixels.finish(Kind::Exact, stated))
}

/// Clears the pixels that chunk tRNS makes transparent.
fn cleared(pixels: &mut Gatherer, color: ColorType, clear: &[u8]) -> Result<(), MicrographError> {
    match (color, clear) {
        (ColorType::Indexed, alphas) => {
            if alphas.iter().any(|alpha| !matches!(alpha, 0 | 255)) {
                let text = "colours of the palette are partly transparent";
                return Err(MicrographError::Variant(text.into()));
            }
            pixels.clear(|value| alphas.get(usize::from(value)) == Some(&0));
        }
        (_, [value]) => pixels.clear(|own| own == u16::from(*value)),
        (_, [red, green, blue]) if red == green && green == blue => pixels.clear(|own| own == u16::from(*red)),
        (_, [high, low]) => pixels.clear(|own| own == u16::from_be_bytes([*high, *low])),
        (_, [r, s, g, h, b, c]) if [r, s] == [g, h] && [g, h] == [b, c] => {
            pixels.clear(|own| own == u16::from_be_bytes([*r, *s]));
        }
        // A colour that is not grey.
        _ => {}
    }
    Ok(())
}

/// Refuses images that are not masks, by the information read so far.
fn accepted(info: &Info<'_>, side: u32) -> Result<(), MicrographError> {
    check_size([info.width, info.height], side)?;
    if info.animation_control.is_some() {
        return Err(MicrographError::Pages("an animation".into()));
    }
    Ok(())
}

fn stated(info: &Info<'_>) -> Stated {
    match info.pixel_dims {
        Some(pixels) if pixels.unit == Unit::Meter && pixels.xppu > 0 && pixels.yppu > 0 => {
            let sides = [pixels.xppu, pixels.yppu].map(|per_metre| 1e6 / f64::from(per_metre));
            Stated::resolution(sides, &format!("{} pixels per metre", pixels.xppu))
        }
        _ => Stated::Nothing,
    }
}

fn damaged(error: DecodingError) -> MicrographError {
    MicrographError::Damaged(
        "PNG",
        match error {
            DecodingError::IoError(_) => "it is cut off".into(),
            DecodingError::LimitsExceeded => format!("a chunk takes more than {} MiB", MAX_CHUNKS >> 20),
            other => other.to_string(),
        },
    )
}
