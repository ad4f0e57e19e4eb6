//! Nuclei: in a row along the mucosa for the epithelium, scattered for other tissues.

use crate::random::{Stream, unit, words};
use crate::tissue::Contour;

/// Distance of neighbouring nuclei in the row of the epithelium, µm; about the width of a columnar
/// cell.
const SPACING_UM: f32 = 4.3;
/// Step along the mucosa in which nuclei are placed, µm.
const STEP_UM: f64 = 0.5;
/// Distance to either side over which the direction of the mucosa is measured, µm.
const SMOOTH_UM: f64 = 9.0;
/// Length of a bin of the mucosa, µm. Nuclei are looked up by bins.
const BIN_UM: f32 = 8.0;

/// A nucleus: an ellipse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Nucleus {
    middle: [f32; 2],
    /// Unit vector of the long axis.
    axis: [f32; 2],
    /// Half of the length and half of the width, µm.
    half: [f32; 2],
    /// Relative uptake of dye, about 1.
    pub(super) dark: f32,
}

impl Nucleus {
    /// Share of a pixel at `p` that the nucleus covers, from 0 to 1.
    pub(super) fn cover(&self, p: [f32; 2], um_per_pixel: f32) -> f32 {
        let (dx, dy) = (p[0] - self.middle[0], p[1] - self.middle[1]);
        cover([dx * self.axis[0] + dy * self.axis[1], dy * self.axis[0] - dx * self.axis[1]], self.half, um_per_pixel)
    }
}

/// Share of a pixel that an ellipse covers. `p` is the position of the pixel relative to the
/// middle. An ellipse that is smaller than a pixel covers it faintly.
fn cover(p: [f32; 2], half: [f32; 2], um_per_pixel: f32) -> f32 {
    let least = 0.6 * um_per_pixel;
    let wide = half.map(|h| h.max(least));
    let square = (p[0] / wide[0]).powi(2) + (p[1] / wide[1]).powi(2);
    if square > 6.0 {
        return 0.0;
    }
    let edge = (square.sqrt() - 1.0) * wide[0].min(wide[1]) / um_per_pixel;
    (0.5 - edge).clamp(0.0, 1.0) * (half[0] * half[1]) / (wide[0] * wide[1])
}

/// The nuclei of the epithelium, in the order of the mucosa.
pub(super) struct EpithelialNuclei {
    nuclei: Vec<Nucleus>,
    /// First nucleus of each bin, and the end of the last bin.
    starts: Vec<u32>,
}

impl EpithelialNuclei {
    /// No nuclei.
    pub(super) fn none() -> Self {
        Self { nuclei: Vec::new(), starts: vec![0] }
    }

    /// Places nuclei at about equal distances in the basal half of the epithelium, upright on the
    /// mucosa. `height_um` is the height of the epithelium.
    pub(super) fn new(seed: u64, index: u32, mucosa: &Contour, height_um: f32) -> Self {
        let bins = (mucosa.length() as f32 / BIN_UM).ceil() as usize;
        let mut row = Self { nuclei: Vec::new(), starts: vec![0] };
        let (mut last, mut due) = (None::<[f32; 2]>, 0.0);
        for step in 0..(mucosa.length() / STEP_UM) as u32 {
            let along = f64::from(step) * STEP_UM;
            let bin = (along as f32 / BIN_UM) as usize;
            while row.starts.len() <= bin {
                row.starts.push(row.nuclei.len() as u32);
            }
            let (at, before, after) = (mucosa.at(along), mucosa.at(along - SMOOTH_UM), mucosa.at(along + SMOOTH_UM));
            let (tx, ty) = (after[0] - before[0], after[1] - before[1]);
            let length = (tx * tx + ty * ty).sqrt().max(1e-9);
            // The contour is counter-clockwise, so the tissue lies to its right.
            let inward = [(ty / length) as f32, (-tx / length) as f32];
            let point = |depth: f32| [at[0] as f32 + inward[0] * depth, at[1] as f32 + inward[1] * depth];
            let middle = point(0.64 * height_um);
            let moved = last.map_or(due, |last: [f32; 2]| distance(middle, last));
            if moved < due {
                continue;
            }
            let random = words(seed, Stream::Histology, index, CELLS + step).map(unit);
            last = Some(middle);
            due = SPACING_UM * (0.75 + 0.5 * random[0]);
            // Secretory cells have slender, dark nuclei; ciliated cells have rounder ones.
            let slender = random[1] < 0.3;
            let lift = (random[2] - 0.5) * 0.26 * height_um;
            let half = if slender { [4.6, 1.35] } else { [3.9, 1.95] };
            let size = 0.85 + 0.3 * random[3];
            let lean = (random[1] - 0.5) * 0.3;
            let axis = [inward[0] - lean * inward[1], inward[1] + lean * inward[0]];
            let norm = distance(axis, [0.0; 2]);
            row.nuclei.push(Nucleus {
                middle: point(0.64 * height_um + lift),
                axis: axis.map(|c| c / norm),
                half: half.map(|h| h * size),
                dark: if slender { 1.2 } else { 0.8 + 0.3 * random[0] },
            });
        }
        while row.starts.len() <= bins + 1 {
            row.starts.push(row.nuclei.len() as u32);
        }
        row
    }

    /// Nuclei that may cover a pixel whose nearest point of the mucosa is at the arc length
    /// `along_um`.
    pub(super) fn near(&self, along_um: f32) -> &[Nucleus] {
        let bin = (along_um / BIN_UM) as usize;
        let last = self.starts.len() - 1;
        let (from, to) = (self.starts[bin.saturating_sub(1).min(last)], self.starts[(bin + 2).min(last)]);
        &self.nuclei[from as usize..to as usize]
    }
}

fn distance(a: [f32; 2], b: [f32; 2]) -> f32 {
    ((a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)).sqrt()
}

/// First counter of the random numbers of cells. The lattice of [`Noise`](super::noise::Noise) uses
/// lower counters.
const CELLS: u32 = 1 << 24;

/// Nuclei scattered over the cells of a plane, at most one per cell.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scatter {
    /// Number that distinguishes the scatters of a section, from 1.
    pub(super) kind: u32,
    /// Sides of a cell, µm.
    pub(super) cell: [f32; 2],
    /// Share of the cells that contain a nucleus.
    pub(super) share: f32,
    /// Half of the length and half of the width of a nucleus, at most 0.55 of a cell, µm.
    pub(super) half: [f32; 2],
    /// True if nuclei have random directions; otherwise they lie along the first direction.
    pub(super) turned: bool,
    /// Number of cells after which the pattern repeats in the first direction; 0 if it does not
    /// repeat.
    pub(super) period: i32,
}

impl Scatter {
    /// Cover and uptake of dye of the nucleus at a point `p`, µm; zeros if there is none.
    pub(super) fn at(&self, seed: u64, index: u32, p: [f32; 2], um_per_pixel: f32) -> (f32, f32) {
        let (u, v) = (p[0] / self.cell[0], p[1] / self.cell[1]);
        let (i0, j0) = ((u - 0.5).floor(), (v - 0.5).floor());
        let mut best = (0.0, 0.0);
        for (i, j) in [(i0, j0), (i0 + 1.0, j0), (i0, j0 + 1.0), (i0 + 1.0, j0 + 1.0)] {
            let column = if self.period > 0 { (i as i32).rem_euclid(self.period) } else { i as i32 };
            let counter = (self.kind << 28) ^ ((column as u32 & 0x3fff) << 14) ^ (j as i32 as u32 & 0x3fff);
            let random = words(seed, Stream::Histology, index, counter);
            if unit(random[0]) >= self.share {
                continue;
            }
            let place = |word: u32| 0.12 + 0.76 * unit(word);
            let (dx, dy) = ((u - i - place(random[1])) * self.cell[0], (v - j - place(random[2])) * self.cell[1]);
            let size = 0.8 + 0.3 * unit(random[3]);
            let turn = unit(random[3].rotate_left(13)) - 0.5;
            let (sin, cos) = libm::sincosf(turn * if self.turned { 3.1 } else { 0.3 });
            let at = [dx * cos + dy * sin, dy * cos - dx * sin];
            let covered = cover(at, self.half.map(|h| h * size), um_per_pixel);
            if covered > best.0 {
                best = (covered, 0.75 + 0.4 * unit(random[3].rotate_left(7)));
            }
        }
        best
    }
}
