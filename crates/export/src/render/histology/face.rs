//! Stained faces of cuts in pictures of a mesh: the picture of a slide, sampled at any point.

use super::Slide;
use super::dye::Colors;
use super::texture::Texture;
use crate::render::picture::decoded;
use crate::tissue::{Grid, Tissue, TissueMap, bands};
use glam::Vec3;
use rayon::prelude::*;
use std::sync::LazyLock;

/// Maximum number of pixels of a face.
const MAX_PIXELS: f64 = 0.9e6;
/// Maximum number of places in a pixel of the picture whose colours are averaged.
const MAX_PLACES: f64 = 12.0;

/// Linear light of each sRGB value.
static DECODED: LazyLock<[f32; 256]> = LazyLock::new(|| std::array::from_fn(|value| decoded(value as f32)));

/// A stained face, in the coordinates of its plane.
pub(in crate::render) struct StainedFace {
    grid: Grid,
    /// Red, green, blue of sRGB and 255 where there is tissue; zeros elsewhere.
    pixels: Vec<[u8; 4]>,
}

impl StainedFace {
    /// Stains the part of a slide between the corners `low` and `high`, µm. `finest_um` is the
    /// smallest useful size of a pixel. `is_along` is true if the face lies along the tube and its
    /// first coordinate is the place along the tube.
    pub(in crate::render) fn new(slide: &Slide, [low, high]: [[f64; 2]; 2], finest_um: f64, is_along: bool) -> Self {
        let extent = [high[0] - low[0], high[1] - low[1]].map(|side| side.max(finest_um));
        let side = finest_um.max((extent[0] * extent[1] / MAX_PIXELS).sqrt());
        // A margin, so that the pixels around each point of the part exist.
        let [width, height] = extent.map(|extent| (extent / side).ceil() as u32 + 4);
        let grid =
            Grid { width, height, um_per_pixel: side, left_um: low[0] - 2.0 * side, top_um: high[1] + 2.0 * side };
        let [mucosa, outside] = &slide.borders;
        let map = TissueMap::new(mucosa, outside, &slide.layers);
        let whole = Grid::around(&outside.points().collect::<Vec<_>>(), 1);
        let middle = [whole.x(0) as f32, whole.y(0) as f32];
        let texture = Texture::of_face(slide.seed, slide.index, &map, &grid, middle, is_along);
        let colors = Colors::new();
        let mut pixels = vec![[0; 4]; width as usize * height as usize];
        let bands: Vec<_> = bands(&grid).collect();
        let length = bands.first().map_or(1, ExactSizeIterator::len) * width as usize;
        pixels.par_chunks_mut(length).zip(bands).for_each(|(pixels, rows)| {
            for (i, (place, pixel)) in map.band(&grid, rows.clone()).iter().zip(pixels).enumerate() {
                if !matches!(place.tissue, Tissue::Outside | Tissue::Lumen) {
                    let column = (i % width as usize) as u32;
                    let (x, y) = (grid.x(column), grid.y(rows.start + (i / width as usize) as u32));
                    let [r, g, b] = colors.of(texture.tissue(place, [x as f32, y as f32]));
                    *pixel = [r, g, b, 255];
                }
            }
        });
        Self { grid, pixels }
    }

    /// Mean linear light around a point of the plane, µm, over a parallelogram with these sides.
    /// `None` if there is no tissue.
    pub(in crate::render) fn at(&self, p: [f64; 2], sides: [[f64; 2]; 2]) -> Option<Vec3> {
        let count = sides.map(|[u, v]| (u.hypot(v) / self.grid.um_per_pixel).ceil().clamp(1.0, MAX_PLACES) as u32);
        let (mut sum, mut weight) = (Vec3::ZERO, 0.0);
        for i in 0..count[0] {
            for j in 0..count[1] {
                let [s, t] = [(i, count[0]), (j, count[1])].map(|(k, n)| (f64::from(k) + 0.5) / f64::from(n) - 0.5);
                let at = [0, 1].map(|axis| p[axis] + s * sides[0][axis] + t * sides[1][axis]);
                self.add(at, &mut sum, &mut weight);
            }
        }
        (weight > 1e-3).then(|| sum / weight)
    }

    /// Adds the light of the four pixels around a point, as far as they show tissue.
    fn add(&self, p: [f64; 2], sum: &mut Vec3, weight: &mut f32) {
        let grid = &self.grid;
        let u = (p[0] - grid.left_um) / grid.um_per_pixel - 0.5;
        let v = (grid.top_um - p[1]) / grid.um_per_pixel - 0.5;
        let (column, row) = (u.floor(), v.floor());
        let (s, t) = ((u - column) as f32, (v - row) as f32);
        for (right, below, share) in
            [(0, 0, (1.0 - s) * (1.0 - t)), (1, 0, s * (1.0 - t)), (0, 1, (1.0 - s) * t), (1, 1, s * t)]
        {
            let (x, y) = (column as i64 + right, row as i64 + below);
            if (0..i64::from(grid.width)).contains(&x) && (0..i64::from(grid.height)).contains(&y) {
                let [r, g, b, alpha] = self.pixels[y as usize * grid.width as usize + x as usize];
                if alpha > 0 {
                    *sum += Vec3::new(DECODED[r as usize], DECODED[g as usize], DECODED[b as usize]) * share;
                    *weight += share;
                }
            }
        }
    }
}
