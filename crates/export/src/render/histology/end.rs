//! The stained picture of a section as a texture of the end of a tube.

use super::dye::Colors;
use super::texture::Texture;
use super::{Slide, encode};
use crate::render::picture::{MAX_SIZE, RenderError};
use crate::tissue::{Grid, Tissue, TissueMap, bands};
use rayon::prelude::*;

/// Number of pixels by which the tissue is continued beyond its borders, so that a filter that
/// mixes neighbouring pixels finds no other colour there.
const MARGIN_PIXELS: usize = 3;

impl Slide {
    /// Draws the stained tissue as PNG without a bar, and returns the pixels' places. `size` is the
    /// longer side, pixels. Pixels beyond the tissue have the colours of the tissue next to them.
    ///
    /// # Errors
    /// [`RenderError::Size`] if `size` is 0 or above [`MAX_SIZE`].
    pub fn end_picture(&self, size: u32) -> Result<(Grid, Vec<u8>), RenderError> {
        if !(1..=MAX_SIZE).contains(&size) {
            return Err(RenderError::Size { width: size, height: size });
        }
        let [mucosa, outside] = &self.borders;
        let grid = Grid::around(&outside.points().collect::<Vec<_>>(), size);
        let map = TissueMap::new(mucosa, outside, &self.layers);
        let texture = Texture::new(self.seed, self.index, &map, &grid);
        let colors = Colors::new();
        let width = grid.width as usize;
        let rows: Vec<Vec<Option<[u8; 3]>>> = bands(&grid)
            .collect::<Vec<_>>()
            .into_par_iter()
            .map(|rows| {
                let places = map.band(&grid, rows.clone());
                let color = |(i, place): (usize, &crate::tissue::Place)| {
                    let (x, y) = (grid.x((i % width) as u32), grid.y(rows.start + (i / width) as u32));
                    let is_tissue = !matches!(place.tissue, Tissue::Outside | Tissue::Lumen);
                    is_tissue.then(|| colors.of(texture.tissue(place, [x as f32, y as f32])))
                };
                places.iter().enumerate().map(color).collect()
            })
            .collect();
        let mut pixels = rows.concat();
        for _ in 0..MARGIN_PIXELS {
            pixels = widened(&pixels, width);
        }
        let rgb: Vec<u8> = pixels.into_iter().flat_map(Option::unwrap_or_default).collect();
        Ok((grid, encode(&grid, png::ColorType::Rgb, &rgb)?))
    }
}

/// Gives each empty pixel the mean colour of its neighbours that have one.
fn widened(pixels: &[Option<[u8; 3]>], width: usize) -> Vec<Option<[u8; 3]>> {
    let height = pixels.len() / width.max(1);
    let around = |i: usize| {
        let (x, y) = (i % width, i / width);
        let (mut sum, mut count) = ([0_u32; 3], 0);
        for row in y.saturating_sub(1)..(y + 2).min(height) {
            for color in pixels[row * width..][x.saturating_sub(1)..(x + 2).min(width)].iter().flatten() {
                sum = std::array::from_fn(|k| sum[k] + u32::from(color[k]));
                count += 1;
            }
        }
        (count > 0).then(|| sum.map(|value| (value / count) as u8))
    };
    (0..pixels.len()).map(|i| pixels[i].or_else(|| around(i))).collect()
}
