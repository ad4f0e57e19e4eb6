//! Reads TIFF and OME-TIFF: one image, grey, indexed or in colours that are all grey.

use super::super::error::MicrographError;
use super::pixels::{Gatherer, Image, Kind, Layout, check_size, unpacked};
use super::stated::{Stated, described};
use std::io::Cursor;
use tiff::decoder::ifd::Value;
use tiff::decoder::{ChunkType, Decoder, DecodingResult, Limits};
use tiff::tags::{ExtraSamples, Tag};
use tiff::{ColorType, TiffError, TiffResult, TiffUnsupportedError};

/// Maximum size of an unpacked strip or tile, bytes: one strip of the largest image with eight bits
/// for each of three colours.
const MAX_CHUNK: usize = 192 << 20;
/// Maximum size of the value of a tag, bytes.
const MAX_TAG: usize = 1 << 20;
/// Maximum number of images in a file that are looked at: smaller copies of the first one are
/// passed over.
const MOST_IMAGES: usize = 64;

type File<'a> = Decoder<Cursor<&'a [u8]>>;

pub(super) fn read(bytes: &[u8], side: u32) -> Result<Image, MicrographError> {
    let mut file = open(bytes).map_err(refused)?;
    let (width, height) = file.dimensions().map_err(refused)?;
    check_size([width, height], side)?;
    let tag = |file: &mut File<'_>, tag| file.find_tag_unsigned::<u16>(tag).map_err(refused);
    let photometric = tag(&mut file, Tag::PhotometricInterpretation)?.unwrap_or(1);
    let (stated, pages) = statements(&mut file).map_err(refused)?;
    if let Some(pages) = pages {
        return Err(MicrographError::Pages(pages));
    }
    let first = file.ifd_pointer().map_or(0, |pointer| pointer.0);
    single(&mut file)?;
    // The decoder reads neither indices nor masks, and inverts values where white is 0. Values are
    // read as stored: in masks of ImageJ and tifffile whose white is 0, the object is not 0.
    let changed = (photometric != 1).then(|| as_grey(bytes, first, photometric)).flatten();
    let mut file = open(changed.as_deref().unwrap_or(bytes)).map_err(refused)?;
    let mut image = pixels(&mut file, [width, height])?.finish(Kind::Exact, stated);
    if photometric == 0 {
        image.notes.push("the TIFF shows the value 0 as white: values are used as stored".into());
    }
    Ok(image)
}

fn open(bytes: &[u8]) -> TiffResult<File<'_>> {
    let mut limits = Limits::default();
    limits.decoding_buffer_size = MAX_CHUNK;
    limits.ifd_value_size = MAX_TAG;
    limits.intermediate_buffer_size = MAX_CHUNK;
    Ok(Decoder::new(Cursor::new(bytes))?.with_limits(limits))
}

/// Side of a pixel, and several images if the description says so.
fn statements(file: &mut File<'_>) -> TiffResult<(Stated, Option<String>)> {
    let mut resolution = |tag| -> TiffResult<Option<f64>> {
        Ok(match file.find_tag(tag)? {
            Some(Value::Rational(n, d)) => Some(f64::from(n) / f64::from(d)),
            Some(Value::Float(value)) => Some(value.into()),
            Some(Value::Double(value)) => Some(value),
            _ => None,
        })
    };
    let [x, y] = [resolution(Tag::XResolution)?, resolution(Tag::YResolution)?];
    let per_unit = x.or(y).map(|any| [x.unwrap_or(any), y.unwrap_or(any)]);
    let unit = file.find_tag_unsigned::<u16>(Tag::ResolutionUnit)?.unwrap_or(2);
    let found = described(&description(file)?, per_unit);
    let by_tags = || match (per_unit, unit) {
        (Some(per_unit), 2) => resolved(per_unit, 25_400.0, "inch"),
        (Some(per_unit), 3) => resolved(per_unit, 10_000.0, "centimetre"),
        _ => Stated::Nothing,
    };
    let stated = if found.stated == Stated::Nothing { by_tags() } else { found.stated };
    Ok((stated, found.pages))
}

fn resolved(per_unit: [f64; 2], unit_um: f64, name: &str) -> Stated {
    Stated::resolution(per_unit.map(|count| unit_um / count), &format!("{} pixels per {name}", per_unit[0]))
}

/// The description, which may have characters that are not ASCII.
fn description(file: &mut File<'_>) -> TiffResult<String> {
    let mut tags = file.image_ifd();
    let length = tags.find_entry(Tag::ImageDescription).map_or(0, |entry| entry.count());
    let mut text = vec![0; usize::try_from(length).unwrap_or(MAX_TAG).min(MAX_TAG)];
    let read = tags.find_tag_bytes(Tag::ImageDescription, &mut text, 0)?.unwrap_or(0);
    text.truncate(read.min(text.len()));
    Ok(String::from_utf8_lossy(&text).trim_end_matches('\0').to_owned())
}

/// Refuses files with several images, except smaller copies of the first one.
fn single(file: &mut File<'_>) -> Result<(), MicrographError> {
    let mut others = 0;
    for _ in 0..MOST_IMAGES {
        if !file.more_images() {
            break;
        }
        file.next_image().map_err(refused)?;
        let reduced = file.find_tag_unsigned::<u32>(Tag::NewSubfileType).map_err(refused)?.unwrap_or(0) & 1 == 1;
        others += usize::from(!reduced);
    }
    let more = file.more_images();
    if others > 0 || more {
        let least = if more { "at least " } else { "" };
        return Err(MicrographError::Pages(format!("{least}{} pages", others + 1)));
    }
    Ok(())
}

/// Copy of the file whose first directory says that its values are grey, 0 for black; `None` for
/// other kinds of pixels than inverted grey (0), indices (3) and masks (4).
fn as_grey(bytes: &[u8], directory: u64, photometric: u16) -> Option<Vec<u8>> {
    if !matches!(photometric, 0 | 3 | 4) {
        return None;
    }
    let (little, big_tiff) = (bytes.first() == Some(&b'I'), bytes.get(2..4)?.contains(&43));
    let number = |at: usize| {
        let pair: [u8; 2] = bytes.get(at..at + 2)?.try_into().ok()?;
        Some(if little { u16::from_le_bytes(pair) } else { u16::from_be_bytes(pair) })
    };
    let start = usize::try_from(directory).ok().filter(|start| *start < bytes.len())?;
    let (head, size, value) = if big_tiff { (8, 20, 12) } else { (2, 12, 8) };
    let entries = bytes.get(start + head..)?.len() / size;
    let entry = (0..entries).map(|i| start + head + i * size).find(|at| number(*at) == Some(262))?;
    let mut copy = bytes.to_vec();
    let one = if little { 1_u16.to_le_bytes() } else { 1_u16.to_be_bytes() };
    copy.get_mut(entry + value..entry + value + 2)?.copy_from_slice(&one);
    Some(copy)
}

fn pixels(file: &mut File<'_>, size: [u32; 2]) -> Result<Gatherer, MicrographError> {
    let color = file.colortype().map_err(refused)?;
    let bits = usize::from(color.bit_depth());
    let stored = file.find_tag_unsigned::<u16>(Tag::SamplesPerPixel).map_err(refused)?.unwrap_or(1);
    let samples = usize::from(color.num_samples());
    let alpha = match color {
        ColorType::Gray(_) | ColorType::RGB(_) => false,
        ColorType::RGBA(_) => true,
        ColorType::Multiband { num_samples: 2, .. } if is_alpha(file).map_err(refused)? => true,
        other => return Err(MicrographError::Variant(format!("the TIFF has pixels of the kind {other:?}"))),
    };
    if samples != usize::from(stored) || (samples > 1 && !matches!(bits, 8 | 16)) {
        let text = format!("the TIFF has {stored} samples of {bits} bits a pixel");
        return Err(MicrographError::Variant(text));
    }
    if !matches!(bits, 1 | 2 | 4 | 8 | 16 | 32 | 64) {
        return Err(MicrographError::Variant(format!("the TIFF has {bits} bits a pixel")));
    }
    let opaque = if bits == 16 { u16::MAX } else { 255 };
    let layout = Layout { samples, opaque: alpha.then_some(opaque), tolerance: 0 };
    let planar = file.find_tag_unsigned::<u16>(Tag::PlanarConfiguration).map_err(refused)? == Some(2);
    if planar && samples > 1 {
        return Err(MicrographError::Variant("the TIFF stores its colours in separate planes".into()));
    }
    let mut gatherer = Gatherer::new(layout, size);
    chunks(file, size, bits, samples, &mut gatherer)?;
    Ok(gatherer)
}

fn is_alpha(file: &mut File<'_>) -> TiffResult<bool> {
    let extra = file.find_tag_unsigned_vec::<u16>(Tag::ExtraSamples)?.unwrap_or_default();
    let alphas = [ExtraSamples::AssociatedAlpha, ExtraSamples::UnassociatedAlpha].map(|kind| kind.to_u16());
    Ok(extra.first().is_some_and(|first| alphas.contains(first)))
}

/// Reads strips or tiles one by one.
fn chunks(
    file: &mut File<'_>,
    [width, height]: [u32; 2],
    bits: usize,
    samples: usize,
    pixels: &mut Gatherer,
) -> Result<(), MicrographError> {
    let (across, down) = file.chunk_dimensions();
    let tiled = file.get_chunk_type() == ChunkType::Tile;
    let most = 2 * super::super::limits::MAX_SIDE;
    if across == 0 || down == 0 || (tiled && (across > most || down > most)) {
        return Err(MicrographError::Damaged("TIFF", format!("a strip or tile has {across} × {down} pixels")));
    }
    let columns = width.div_ceil(across);
    for index in 0..columns * height.div_ceil(down) {
        let [left, top] = [index % columns * across, index / columns * down].map(|place| place as usize);
        let chunk = file.read_chunk(index).map_err(refused)?;
        let row = |i: usize| [left, top + i];
        let wide = (width as usize - left).min(across as usize) * samples;
        match chunk {
            DecodingResult::U8(bytes) => {
                for (i, bytes) in bytes.chunks((wide * bits).div_ceil(8)).enumerate() {
                    pixels.set(row(i), unpacked(bytes, bits.min(8)))?;
                }
            }
            DecodingResult::U16(values) => {
                for (i, values) in values.chunks(wide).enumerate() {
                    pixels.set(row(i), values.iter().copied())?;
                }
            }
            DecodingResult::U32(values) => numbers(&values, wide, row, pixels)?,
            DecodingResult::I8(values) => numbers(&values, wide, row, pixels)?,
            DecodingResult::I16(values) => numbers(&values, wide, row, pixels)?,
            DecodingResult::I32(values) => numbers(&values, wide, row, pixels)?,
            DecodingResult::F32(values) => numbers(&values, wide, row, pixels)?,
            DecodingResult::F64(values) => numbers(&values, wide, row, pixels)?,
            _ => return Err(MicrographError::Variant(format!("the TIFF has numbers of {bits} bits"))),
        }
    }
    Ok(())
}

/// Sets pixels to numbers that are whole and in range.
fn numbers<T: Copy + Into<f64>>(
    values: &[T],
    wide: usize,
    row: impl Fn(usize) -> [usize; 2],
    pixels: &mut Gatherer,
) -> Result<(), MicrographError> {
    let whole = |value: f64| value.trunc() == value && (0.0..=65535.0).contains(&value);
    if let Some(value) = values.iter().map(|value| (*value).into()).find(|value| !whole(*value)) {
        let text = format!("a pixel has the value {value}; whole numbers from 0 to 65535 are read");
        return Err(MicrographError::Variant(text));
    }
    for (i, values) in values.chunks(wide).enumerate() {
        pixels.set(row(i), values.iter().map(|value| (*value).into() as u16))?;
    }
    Ok(())
}

fn refused(error: TiffError) -> MicrographError {
    match error {
        TiffError::UnsupportedError(TiffUnsupportedError::UnsupportedCompressionMethod(method)) => {
            MicrographError::Variant(format!("the TIFF is compressed by {method:?}, which is not read"))
        }
        TiffError::UnsupportedError(error) => MicrographError::Variant(format!("this TIFF is not read: {error}")),
        TiffError::IoError(_) => MicrographError::Damaged("TIFF", "it is cut off".into()),
        TiffError::LimitsExceeded => {
            let text = format!("a strip or tile of the TIFF takes more than {} MiB", MAX_CHUNK >> 20);
            MicrographError::Variant(text)
        }
        other => MicrographError::Damaged("TIFF", other.to_string()),
    }
}
