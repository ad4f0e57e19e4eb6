//! Ambient occlusion from the depths of a picture: how much of the light from all sides a hollow keeps off.
//!
//! At several distances, doubling from pixel to fold to tube, the neighbourhood of a pixel is compared with the pixel. The
//! occlusion at a distance is the mean, over pairs of opposite directions, of the sines of the angles under which the neighbours
//! rise above the picture plane: 0 on any plane, however inclined, positive in a hollow, negative on a ridge. Farther
//! neighbours are means over as many pixels, so that no noise arises that would have to be blurred.

use rayon::prelude::*;

/// Distances: 1.5 pixels, and each twice the last.
const SCALES: usize = 7;
/// Directions of half of the neighbours; the others are opposite.
const DIRECTIONS: [[f32; 2]; 4] = [[1.0, 0.0], [0.707_106_77, 0.707_106_77], [0.0, 1.0], [-0.707_106_77, 0.707_106_77]];
/// Factor on the sum of the occlusion at all distances, below which light is lost.
const STRENGTH: f32 = 0.42;

/// Light that reaches each pixel.
pub(super) struct AmbientLight {
    depths: Depths,
    light: Vec<f32>,
}

impl AmbientLight {
    /// `depths` has one depth a pixel, in pixels; it is infinite where nothing is visible, and the light there is 1.
    pub(super) fn new(depths: Vec<f32>, width: usize) -> Self {
        let depths = Depths { width, values: depths };
        Self { light: light(&depths), depths }
    }

    /// The light, from 0 to 1, at a place of the picture and a depth: that of the nearby pixel of the most similar depth, since
    /// a pixel at an edge holds more than one surface.
    pub(super) fn at(&self, x: f32, y: f32, depth: f32) -> f32 {
        let Depths { width, values } = &self.depths;
        let height = self.depths.height();
        let (column, row) = (x as usize, y as usize);
        let beside = |place: f32, end: usize| {
            let own = place as usize;
            if place.fract() < 0.5 { own.saturating_sub(1) } else { (own + 1).min(end - 1) }
        };
        let pixels = [(column, row), (beside(x, *width), row), (column, beside(y, height))].map(|(x, y)| y * width + x);
        let nearest = pixels.into_iter().min_by(|a, b| {
            let off = |i: usize| (values[i] - depth).abs();
            off(*a).total_cmp(&off(*b))
        });
        nearest.map_or(1.0, |i| self.light[i])
    }
}

fn light(depths: &Depths) -> Vec<f32> {
    let mut scales = vec![depths.halved()];
    while scales.len() < SCALES - 1 {
        scales.push(scales[scales.len() - 1].halved());
    }
    let (width, pixels) = (depths.width, &depths.values);
    let light = |i: usize| {
        let depth = pixels[i];
        if depth.is_infinite() {
            return 1.0;
        }
        let [x, y] = [(i % width) as f32 + 0.5, (i / width) as f32 + 0.5];
        let occlusion = |(k, depths): (usize, &Depths)| {
            let unit = (1 << k) as f32;
            let rises = DIRECTIONS.map(|[dx, dy]| {
                let rise = |side: f32| {
                    let reach = 1.5 * side;
                    let (neighbour, visible) = depths.at(x / unit + reach * dx, y / unit + reach * dy)?;
                    let slope = (depth - neighbour) / (1.5 * unit);
                    Some((slope / (1.0 + slope * slope).sqrt(), visible))
                };
                // An edge of the model is open.
                rise(1.0).zip(rise(-1.0)).map_or(0.0, |((a, v), (b, w))| (a + b) / 2.0 * v * w)
            });
            rises.iter().sum::<f32>() / rises.len() as f32
        };
        (1.0 - STRENGTH * std::iter::once(depths).chain(&scales).enumerate().map(occlusion).sum::<f32>())
            .clamp(0.0, 1.0)
    };
    (0..pixels.len()).into_par_iter().map(light).collect()
}

/// Depths of a picture, row by row; infinite where nothing is visible.
struct Depths {
    width: usize,
    values: Vec<f32>,
}

impl Depths {
    fn height(&self) -> usize {
        self.values.len() / self.width
    }

    /// The mean depth of what is visible in each square of 2 × 2.
    fn halved(&self) -> Self {
        let (width, height) = (self.width.div_ceil(2), self.height().div_ceil(2));
        let values = (0..width * height)
            .into_par_iter()
            .map(|i| {
                let (x, y) = (i % width * 2, i / width * 2);
                let (right, below) = ((x + 1).min(self.width - 1), (y + 1).min(self.height() - 1));
                let all =
                    [(x, y), (right, y), (x, below), (right, below)].map(|(x, y)| self.values[y * self.width + x]);
                let (sum, count) = all
                    .iter()
                    .filter(|depth| depth.is_finite())
                    .fold((0.0, 0.0), |(sum, count), depth| (sum + depth, count + 1.0));
                if count > 0.0 { sum / count } else { f32::INFINITY }
            })
            .collect();
        Self { width, values }
    }

    /// The depth of what is visible at a place, interpolated, and how much of the place it covers, from 0 to 1.
    fn at(&self, x: f32, y: f32) -> Option<(f32, f32)> {
        let (x, y) = (x - 0.5, y - 0.5);
        let (left, top) = (x.floor(), y.floor());
        let (u, v) = (x - left, y - top);
        let (mut sum, mut weights) = (0.0, 0.0);
        for (column, row, weight) in [
            (left, top, (1.0 - u) * (1.0 - v)),
            (left + 1.0, top, u * (1.0 - v)),
            (left, top + 1.0, (1.0 - u) * v),
            (left + 1.0, top + 1.0, u * v),
        ] {
            if column >= 0.0 && row >= 0.0 && (column as usize) < self.width && (row as usize) < self.height() {
                let depth = self.values[row as usize * self.width + column as usize];
                if depth.is_finite() {
                    sum += weight * depth;
                    weights += weight;
                }
            }
        }
        (weights > 0.0).then(|| (sum / weights, weights))
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
        // Away from the borders: the farthest neighbours are at 96 pixels, as means over 64.
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
