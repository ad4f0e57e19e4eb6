//! Values of the pixels of an image, gathered row by row.

use super::super::error::MicrographError;
use super::stated::Stated;

/// Kind of values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in super::super) enum Kind {
    /// Stored without loss.
    Exact,
    /// Changed by the compression.
    Blurred,
    /// Painted from polygons: 1 is tissue.
    Polygons,
}

/// Pixels of an image.
#[derive(Debug)]
pub(in super::super) struct Image {
    pub(in super::super) width: usize,
    /// Values row by row from the top: stored grey values, or indices of the palette.
    pub(in super::super) values: Vec<u16>,
    pub(in super::super) kind: Kind,
    /// Side of a value, in pixels of the file; not 1 for polygons only.
    pub(in super::super) step: f64,
    pub(in super::super) stated: Stated,
    /// Remarks on how the file was read.
    pub(in super::super) notes: Vec<String>,
}

/// Meaning of the samples of a pixel.
#[derive(Clone, Copy)]
pub(super) struct Layout {
    /// Samples of a pixel: 1 or 3, and one more with alpha.
    pub(super) samples: usize,
    /// Alpha of an opaque pixel, if the last sample is alpha.
    pub(super) opaque: Option<u16>,
    /// Maximum difference of the three colours of a grey pixel.
    pub(super) tolerance: u16,
}

/// Gathers the values of an image.
pub(super) struct Gatherer {
    layout: Layout,
    width: usize,
    values: Vec<u16>,
    /// Number of transparent pixels.
    transparent: usize,
}

impl Gatherer {
    pub(super) fn new(layout: Layout, [width, height]: [u32; 2]) -> Self {
        let (width, height) = (width as usize, height as usize);
        Self { layout, width, values: vec![0; width * height], transparent: 0 }
    }

    /// Sets pixels from a place on, given as column and row; those beyond the image are left out.
    pub(super) fn set(
        &mut self,
        [column, row]: [usize; 2],
        samples: impl Iterator<Item = u16>,
    ) -> Result<(), MicrographError> {
        let Layout { samples: count, opaque, tolerance } = self.layout;
        let start = row * self.width;
        let Some(out) = self.values.get_mut(start + column.min(self.width)..start + self.width) else { return Ok(()) };
        let (mut pixel, mut filled, mut at) = ([0; 4], 0, 0);
        for sample in samples {
            pixel[filled] = sample;
            filled += 1;
            if filled < count {
                continue;
            }
            filled = 0;
            let Some(value) = out.get_mut(at) else { break };
            at += 1;
            if let Some(opaque) = opaque {
                match pixel[count - 1] {
                    0 => {
                        self.transparent += 1;
                        continue;
                    }
                    alpha if alpha != opaque => {
                        return Err(MicrographError::Transparent { column: column + at - 1, row });
                    }
                    _ => {}
                }
            }
            if count >= 3 {
                let [red, green, blue, _] = pixel;
                let most = red.max(green).max(blue);
                if most - red.min(green).min(blue) > tolerance {
                    return Err(MicrographError::Colour { column: column + at - 1, row, red, green, blue });
                }
                *value = green;
            } else {
                *value = pixel[0];
            }
        }
        Ok(())
    }

    /// Clears the pixels of transparent values.
    pub(super) fn clear(&mut self, is_clear: impl Fn(u16) -> bool) {
        for value in &mut self.values {
            if is_clear(*value) {
                *value = 0;
                self.transparent += 1;
            }
        }
    }

    pub(super) fn finish(self, kind: Kind, stated: Stated) -> Image {
        let note = match self.transparent {
            0 => None,
            1 => Some("one transparent pixel counts as 0".to_owned()),
            count => Some(format!("{count} transparent pixels count as 0")),
        };
        let notes = note.into_iter().collect();
        Image { width: self.width, values: self.values, kind, step: 1.0, stated, notes }
    }
}

/// Samples of a packed row, of 1, 2, 4, 8 or 16 bits; those of 16 bits have the higher byte first.
pub(super) fn unpacked(row: &[u8], bits: usize) -> impl Iterator<Item = u16> {
    let count = row.len() * 8 / bits;
    let mask = u8::MAX >> (8 - bits.min(8));
    (0..count).map(move |i| {
        if bits == 16 {
            return u16::from_be_bytes([row[2 * i], row[2 * i + 1]]);
        }
        let at = i * bits;
        u16::from(row[at / 8] >> (8 - bits - at % 8) & mask)
    })
}

/// Refuses images that are too large.
pub(super) fn check_size([width, height]: [u32; 2], side: u32) -> Result<(), MicrographError> {
    if width > side || height > side { Err(MicrographError::Size { width, height }) } else { Ok(()) }
}
