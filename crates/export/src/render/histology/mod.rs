//! Sections as a pathologist sees them: stained with haematoxylin and eosin; and the same sections as label images.
//!
//! Both are drawn from one [`TissueMap`]: a pixel of the stained picture is coloured as the tissue that the label image gives
//! it. Height and place of the layers are those of the specification; cells, fibres and stain are texture, drawn at random from
//! the model's seed and the index of the section.
//!
//! | file | subject |
//! |---|---|
//! | `dye` | amounts of the two dyes, and the colours that they give |
//! | `noise` | smooth random fields |
//! | `cells` | nuclei: rows of the epithelium, and scattered ones |
//! | `texture` | the dyes of each tissue |

mod cells;
mod dye;
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
use rayon::prelude::*;
use std::io::Cursor;
use texture::Texture;
use tiny_skia::Pixmap;

/// A section, or a cut, to be drawn.
#[derive(Clone, Debug)]
pub struct Slide {
    /// The surface of the mucosa, and the outside of the wall.
    pub borders: [Border; 2],
    /// Heights of its layers.
    pub layers: Layers,
    /// Seed of the model.
    pub seed: u64,
    /// Index of the section in the model, or a number for the cut: the texture depends on it.
    pub index: u32,
}

impl Slide {
    /// The stained section, its longer side `size` pixels long, with a scale bar.
    ///
    /// # Errors
    /// [`RenderError::Size`] if `size` is 0 or over [`MAX_SIZE`].
    pub fn stained(&self, size: u32) -> Result<Vec<u8>, RenderError> {
        let (grid, mut pixmap) = self.paint(size, true)?;
        if let Some(bar) = Bar::new([grid.width, grid.height]) {
            bar.draw(&mut pixmap, 1e6 / grid.um_per_pixel, 1.0);
        }
        let rgb: Vec<u8> = pixmap.data().chunks_exact(4).flat_map(|pixel| [pixel[0], pixel[1], pixel[2]]).collect();
        encode(&grid, png::ColorType::Rgb, &rgb)
    }

    /// The stained section on a transparent background, its longer side `size` pixels long, without a bar.
    ///
    /// # Errors
    /// As [`stained`](Self::stained).
    pub fn drawing(&self, size: u32) -> Result<Drawing, RenderError> {
        let (grid, pixmap) = self.paint(size, false)?;
        Ok(Drawing { pixmap, scale: 1e6 / grid.um_per_pixel, axial_scale: 1.0 })
    }

    /// Paints all pixels, or only those within the tube.
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

    /// The tissue of every pixel as 8-bit grey values, those of [`Tissue`](crate::tissue::Tissue), on the same pixels as
    /// [`stained`](Self::stained).
    ///
    /// # Errors
    /// [`RenderError::Size`] if `size` is 0 or over [`MAX_SIZE`].
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

/// Encodes rows of pixels of eight bits a channel; the `pHYs` chunk has the pixels per metre.
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

/// Side of a pixel of an encoded picture, µm, from its `pHYs` chunk; `None` if it has none.
#[must_use]
pub fn um_per_pixel(png: &[u8]) -> Option<f64> {
    let reader = png::Decoder::new(Cursor::new(png)).read_info().ok()?;
    let dimensions = reader.info().pixel_dims?;
    (dimensions.xppu > 0).then(|| 1e6 / f64::from(dimensions.xppu))
}
