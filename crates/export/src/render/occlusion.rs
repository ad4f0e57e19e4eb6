//! Ambient occlusion from the depths of a picture: the share of light from all sides that hollows
//! block.
//!
//! A pixel is compared with its neighbours at several distances, from a pixel to a tenth of the
//! default picture. The occlusion at a distance is the mean over pairs of opposite directions. Each
//! direction contributes the sine of the angle at which the neighbour rises above the picture
//! plane. The occlusion is therefore 0 on any plane, positive in a hollow and negative on a ridge.
//!
//! Far neighbours are means over many pixels, so the result has no noise that would have to be
//! blurred.

use rayon::prelude::*;

/// Levels that provide neighbours; a texel of level k has 2ᵏ pixels per side.
const LEVELS: [u32; 4] = [0, 2, 4, 6];
/// Distance of neighbours, texels.
const REACH: f32 = 1.5;
/// Directions of half of the neighbours; the other half lies opposite.
const DIRECTIONS: [[f32; 2]; 4] = [[1.0, 0.0], [0.707_106_77, 0.707_106_77], [0.0, 1.0], [-0.707_106_77, 0.707_106_77]];
/// Factor on the sum of the occlusions at all distances.
const STRENGTH: f32 = 0.7;
/// Width of the empty border of a level, texels. With it, neighbours need no test of bounds.
const BORDER: usize = 3;

/// Share of the ambient light that reaches each pixel.
pub(super) struct AmbientLight {
    width: usize,
    depths: Vec<f32>,
    light: Vec<f32>,
}

impl AmbientLight {
    /// Computes the light from one depth per pixel, in pixels. A depth is infinite where nothing is
    /// visible; the light is 1 there.
    pub(super) fn new(depths: Vec<f32>, width: usize) -> Self {
        let levels = levels(&depths, width);
        let light = |i: usize| match depths[i] {
            depth if depth.is_finite() => light(&levels, (i % width) as f32 + 0.5, (i / width) as f32 + 0.5, depth),
            _ => 1.0,
        };
        Self { width, light: (0..depths.len()).into_par_iter().map(light).collect(), depths }
    }

    /// Light from 0 to 1 at a position of the picture and a depth. It is the light of the nearby
    /// pixel with the most similar depth, because a pixel at an edge contains more than one
    /// surface.
    pub(super) fn at(&self, x: f32, y: f32, depth: f32) -> f32 {
        let (width, height) = (self.width, self.depths.len() / self.width);
        let (column, row) = (x as usize, y as usize);
        let beside = |place: f32, end: usize| {
            let own = place as usize;
            if place.fract() < 0.5 { own.saturating_sub(1) } else { (own + 1).min(end - 1) }
        };
        let pixels = [(column, row), (beside(x, width), row), (column, beside(y, height))].map(|(x, y)| y * width + x);
        let nearest = pixels.into_iter().min_by(|a, b| {
            let off = |i: usize| (self.depths[i] - depth).abs();
            off(*a).total_cmp(&off(*b))
        });
        nearest.map_or(1.0, |i| self.light[i])
    }
}

/// Light at a position, in pixels, where the visible surface has the given depth.
fn light(levels: &[DepthLevel], x: f32, y: f32, depth: f32) -> f32 {
    let mut occlusion = 0.0;
    for (level, k) in levels.iter().zip(LEVELS) {
        let unit = (1 << k) as f32;
        let (x, y, per_distance) = (x / unit, y / unit, 1.0 / (REACH * unit));
        for [dx, dy] in DIRECTIONS {
            let rise = |[depths, visible]: [f32; 2]| {
                let slope = if visible > 0.0 { (depth - depths / visible) * per_distance } else { 0.0 };
                (slope / (1.0 + slope * slope).sqrt(), visible)
            };
            let (a, v) = rise(level.at(x + REACH * dx, y + REACH * dy));
            let (b, w) = rise(level.at(x - REACH * dx, y - REACH * dy));
            // Nothing beyond the outline of the model blocks light.
            occlusion += (a + b) * v * w;
        }
    }
    (1.0 - STRENGTH * occlusion / (2 * DIRECTIONS.len()) as f32).clamp(0.0, 1.0)
}

/// Computes the levels of [`LEVELS`].
fn levels(depths: &[f32], width: usize) -> Vec<DepthLevel> {
    let mut level = DepthLevel::empty(width, depths.len() / width);
    for (i, depth) in depths.iter().enumerate().filter(|(_, depth)| depth.is_finite()) {
        let at = level.index(i % width, i / width);
        level.texels[at] = [*depth, 1.0];
    }
    let mut levels = Vec::with_capacity(LEVELS.len());
    for k in 0..=LEVELS[LEVELS.len() - 1] {
        let next = level.halved();
        if LEVELS.contains(&k) {
            levels.push(level);
        }
        level = next;
    }
    levels
}

/// Depths of a picture. A texel contains the sum of the visible depths and the visible area, both
/// divided by its area.
struct DepthLevel {
    width: usize,
    height: usize,
    texels: Vec<[f32; 2]>,
}

impl DepthLevel {
    fn empty(width: usize, height: usize) -> Self {
        Self { width, height, texels: vec![[0.0; 2]; (width + 2 * BORDER) * (height + 2 * BORDER)] }
    }

    /// Index of a texel whose coordinates exclude the border.
    fn index(&self, x: usize, y: usize) -> usize {
        (y + BORDER) * (self.width + 2 * BORDER) + x + BORDER
    }

    /// Next level: means over squares of 2 × 2 texels.
    fn halved(&self) -> Self {
        let mut half = Self::empty(self.width.div_ceil(2), self.height.div_ceil(2));
        for y in 0..half.height {
            for x in 0..half.width {
                let [top, below] = [self.index(2 * x, 2 * y), self.index(2 * x, 2 * y + 1)];
                let four = [top, top + 1, below, below + 1].map(|i| self.texels[i]);
                let at = half.index(x, y);
                half.texels[at] = [0, 1].map(|c| (four[0][c] + four[1][c] + four[2][c] + four[3][c]) / 4.0);
            }
        }
        half
    }

    /// Value interpolated between the centres of texels, at most [`REACH`] outside the picture.
    #[inline]
    fn at(&self, x: f32, y: f32) -> [f32; 2] {
        let (x, y) = (x + (BORDER as f32 - 0.5), y + (BORDER as f32 - 0.5));
        // Both are positive, so the cast rounds down.
        let (column, row) = (x as u32, y as u32);
        let (u, v) = (x - column as f32, y - row as f32);
        let stride = self.width + 2 * BORDER;
        let top = row as usize * stride + column as usize;
        let [a, b] = [self.texels[top], self.texels[top + 1]];
        let [c, d] = [self.texels[top + stride], self.texels[top + stride + 1]];
        [0, 1].map(|k| (1.0 - v) * ((1.0 - u) * a[k] + u * b[k]) + v * ((1.0 - u) * c[k] + u * d[k]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 64;

    fn light(depth: impl Fn(f32, f32) -> f32) -> Vec<f32> {
        let depths = (0..SIDE * SIDE).map(|i| depth((i % SIDE) as f32, (i / SIDE) as f32)).collect();
        AmbientLight::new(depths, SIDE).light
    }

    #[test]
    fn a_plane_keeps_its_light_however_inclined() {
        // Far from the borders: the farthest neighbours are 96 pixels away and are means over 64
        // pixels.
        let side = 512;
        for slope in [0.0, 0.7, 3.0] {
            let depths = (0..side * side).map(|i| slope * (i % side) as f32 - 0.3 * (i / side) as f32).collect();
            let light = AmbientLight::new(depths, side).light;
            let middle = (200..312).flat_map(|y| (200..312).map(move |x| y * side + x));
            assert!(middle.into_iter().all(|i| light[i] > 0.999), "slope {slope}");
        }
    }

    #[test]
    fn a_crease_loses_light_and_a_ridge_does_not() {
        let at = |light: &[f32], x: usize| light[SIDE / 2 * SIDE + x];
        let crease = light(|x, _| -(x - 32.0).abs());
        assert!(at(&crease, 32) < 0.6, "{}", at(&crease, 32));
        assert!(at(&crease, 32) < at(&crease, 40) && at(&crease, 40) < at(&crease, 50));
        let ridge = light(|x, _| (x - 32.0).abs());
        assert_eq!(at(&ridge, 32), 1.0);
    }

    #[test]
    fn a_deep_narrow_slit_is_darker_than_a_wide_one() {
        let slit =
            |width: f32| light(move |x, _| if (x - 32.0).abs() < width { 40.0 } else { 0.0 })[SIDE / 2 * SIDE + 32];
        assert!(slit(2.0) < 0.3 && slit(2.0) < slit(14.0) - 0.1, "{} and {}", slit(2.0), slit(14.0));
    }

    #[test]
    fn at_an_edge_each_surface_has_its_own_light() {
        let depths: Vec<f32> = (0..SIDE * SIDE).map(|i| if i % SIDE < 32 { 0.0 } else { 40.0 }).collect();
        let light = AmbientLight::new(depths, SIDE);
        let (face, hollow) = (light.at(31.75, 30.0, 0.0), light.at(31.75, 30.0, 40.0));
        assert_eq!((face, hollow), (light.at(31.25, 30.0, 0.0), light.at(32.25, 30.0, 40.0)));
        assert!(hollow < face - 0.1);
    }

    #[test]
    fn where_nothing_is_seen_light_is_full() {
        let light = light(|x, _| if x < 32.0 { f32::INFINITY } else { 0.0 });
        assert!(light.iter().all(|l| (l - 1.0).abs() < 1e-5));
    }
}
