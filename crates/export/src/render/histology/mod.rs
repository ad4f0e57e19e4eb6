//! Sections stained with haematoxylin and eosin, as a pathologist sees them, and as label images.
//!
//! Both pictures are drawn from one [`TissueMap`], so the stain of a pixel is that of the tissue in
//! the label image. The specification determines the layers. Cells, fibres and stain are random
//! texture, determined by the model's seed and the index of the section.
//!
//! | file | subject |
//! |---|---|
//! | `dye` | amounts of the two dyes, and the resulting colours |
//! | `noise` | smooth random fields |
//! | `cells` | nuclei: rows in the epithelium, and scattered nuclei |
//! | `texture` | the dyes of each tissue |
//! | `face` | stained faces of cuts in pictures of a mesh |
//! | `end` | pictures of the ends of a tube, for textures |

mod cells;
mod dye;
mod end;
mod face;
mod noise;
mod texture;

#[cfg(test)]
mod tests;

use super::bar::Bar;
use super::drawing::Drawing;
use super::picture::{MAX_SIZE, RenderError};
use crate::model::Border;
use crate::tissue::{Grid, Layers, Tissue, TissueMap, bands};
use dye::Colors;
pub(super) use face::StainedFace;
use rayon::prelude::*;
use std::io::Cursor;
use texture::Texture;
use tiny_skia::Pixmap;

/// A section or a cut to be drawn.
#[derive(Clone, Debug)]
pub struct Slide {
    /// Surface of the mucosa, and outside of the wall.
    pub borders: [Border; 2],
    /// Heights of the layers.
    pub layers: Layers,
    /// Seed of the model.
    pub seed: u64,
    /// Index of the section in the model, or any number for a cut. The texture depends on it.
    pub index: u32,
}

impl Slide {
    /// Draws the stained section as PNG with a scale bar. `size` is the longer side, pixels.
    ///
    /// # Errors
    /// [`RenderError::Size`] if `size` is 0 or above [`MAX_SIZE`].
    pub fn stained(&self, size: u32) -> Result<Vec<u8>, RenderError> {
        let (grid, mut pixmap) = self.paint(size, true)?;
        if let Some(bar) = Bar::new([grid.width, grid.height]) {
            bar.draw(&mut pixmap, 1e6 / grid.um_per_pixel, 1.0);
        }
        let rgb: Vec<u8> = pixmap.data().chunks_exact(4).flat_map(|pixel| [pixel[0], pixel[1], pixel[2]]).collect();
        encode(&grid, png::ColorType::Rgb, &rgb)
    }

    /// Draws the stained section on a transparent background without a bar. `size` is the longer
    /// side, pixels.
    ///
    /// # Errors
    /// As [`stained`](Self::stained).
    pub fn drawing(&self, size: u32) -> Result<Drawing, RenderError> {
        let (grid, pixmap) = self.paint(size, false)?;
        Ok(Drawing { pixmap, scale: 1e6 / grid.um_per_pixel, axial_scale: 1.0 })
    }

    /// Paints the pixels within the tube, and with `glass` all others too.
    fn paint(&self, size: u32, glass: bool) -> Result<(Grid, Pixmap), RenderError> {
        let (grid, map) = self.prepare(size)?;
        let texture = Texture::new(self.seed, self.index, &map, &grid);
        let colors = Colors::new();
        let width = grid.width as usize;
        let mut pixmap =
            Pixmap::new(grid.width, grid.height).ok_or(RenderError::Size { width: grid.width, height: grid.height })?;
        let bands: Vec<_> = bands(&grid).collect();
        let bytes = bands.first().map_or(1, |band| band.len() * width * 4);
        pixmap.data_mut().par_chunks_mut(bytes).zip(bands).for_each(|(pixels, rows)| {
            let places = map.band(&grid, rows.clone());
            for (i, (place, pixel)) in places.iter().zip(pixels.chunks_exact_mut(4)).enumerate() {
                if !glass && place.tissue == Tissue::Outside {
                    continue;
                }
                let (x, y) = (grid.x((i % width) as u32), grid.y(rows.start + (i / width) as u32));
                let [r, g, b] = colors.of(texture.dyes(place, [x as f32, y as f32]));
                pixel.copy_from_slice(&[r, g, b, 255]);
            }
        });
        Ok((grid, pixmap))
    }

    /// Draws the label image as PNG: the number of the [`Tissue`] of each pixel as an 8-bit grey
    /// value, on the pixels of [`stained`](Self::stained).
    ///
    /// # Errors
    /// [`RenderError::Size`] if `size` is 0 or above [`MAX_SIZE`].
    pub fn labels(&self, size: u32) -> Result<Vec<u8>, RenderError> {
        let (grid, map) = self.prepare(size)?;
        let rows: Vec<Vec<u8>> = bands(&grid)
            .collect::<Vec<_>>()
            .into_par_iter()
            .map(|rows| map.band(&grid, rows).iter().map(|place| place.tissue as u8).collect())
            .collect();
        encode(&grid, png::ColorType::Grayscale, &rows.concat())
    }

    fn prepare(&self, size: u32) -> Result<(Grid, TissueMap), RenderError> {
        if !(1..=MAX_SIZE).contains(&size) {
            return Err(RenderError::Size { width: size, height: size });
        }
        let [mucosa, outside] = &self.borders;
        let grid = Grid::around(&outside.points().collect::<Vec<_>>(), size);
        Ok((grid, TissueMap::new(mucosa, outside, &self.layers)))
    }
}

/// Encodes rows of pixels with eight bits per channel. The `pHYs` chunk states the pixels per
/// metre.
fn encode(grid: &Grid, color: png::ColorType, pixels: &[u8]) -> Result<Vec<u8>, RenderError> {
    let failed = |error: png::EncodingError| RenderError::Encode(error.to_string());
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, grid.width, grid.height);
    encoder.set_color(color);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    let per_metre = (1e6 / grid.um_per_pixel).round() as u32;
    let dimensions = png::PixelDimensions { xppu: per_metre, yppu: per_metre, unit: png::Unit::Meter };
    encoder.set_pixel_dims(Some(dimensions));
    let mut writer = encoder.write_header().map_err(failed)?;
    writer.write_image_data(pixels).map_err(failed)?;
    writer.finish().map_err(failed)?;
    Ok(file)
}

/// Side of a pixel of an encoded picture according to its `pHYs` chunk, µm; `None` if there is no
/// such chunk.
#[must_use]
pub fn um_per_pixel(png: &[u8]) -> Option<f64> {
    let reader = png::Decoder::new(Cursor::new(png)).read_info().ok()?;
    let dimensions = reader.info().pixel_dims?;
    (dimensions.xppu > 0).then(|| 1e6 / f64::from(dimensions.xppu))
}
