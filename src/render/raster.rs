//! The visible triangle of each sample of a picture: a depth buffer, filled in horizontal bands in parallel.
//!
//! Shading follows once per sample, so that its cost does not depend on hidden triangles.

use super::view::{Camera, Projected, View};
use glam::DVec3;
use rayon::prelude::*;
use std::ops::Range;

/// No triangle.
pub(super) const NONE: u32 = u32::MAX;

/// Rows of samples per task.
const BAND: usize = 128;

/// The visible surface at a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sample {
    /// Triangle, or [`NONE`].
    pub triangle: u32,
    /// 1/depth.
    pub inverse_depth: f32,
}

/// Finds the nearest triangle of each sample that is not cut away there; at equal depth the first one.
pub(super) fn rasterize(
    view: &View,
    camera: &Camera,
    positions: &[DVec3],
    triangles: &[[u32; 3]],
    [width, height]: [usize; 2],
) -> Vec<Sample> {
    let projected: Vec<Projected> = positions.par_iter().map(|p| camera.project(*p)).collect();
    let removed: Vec<bool> = positions.par_iter().map(|p| view.is_cut(*p)).collect();
    let corners_of = |t: u32| triangles[t as usize].map(|v| projected[v as usize]);
    // The removed part is convex: it contains a triangle if it contains its corners.
    let visible = |t: &u32| triangles[*t as usize].map(|v| removed[v as usize]) != [true; 3];
    let candidates: Vec<(u32, Range<usize>)> = (0..triangles.len() as u32)
        .into_par_iter()
        .filter(visible)
        .filter_map(|t| Some((t, Setup::new(corners_of(t), [width, height])?.rows)))
        .collect();
    let mut samples = vec![Sample { triangle: NONE, inverse_depth: 0.0 }; width * height];
    samples.par_chunks_mut(BAND * width).enumerate().for_each(|(band, samples)| {
        let band = band * BAND..band * BAND + samples.len() / width;
        for (t, rows) in &candidates {
            if rows.end <= band.start || rows.start >= band.end {
                continue;
            }
            let Some(setup) = Setup::new(corners_of(*t), [width, height]) else { continue };
            // A wedge can cut a triangle without containing any of its corners.
            let straddles = match view.cut.len() {
                0 => false,
                1 => triangles[*t as usize].iter().any(|&v| removed[v as usize]),
                _ => true,
            };
            setup.visit(&band, |x, y, inverse_depth| {
                let sample = &mut samples[(y - band.start) * width + x];
                if inverse_depth <= sample.inverse_depth {
                    return;
                }
                if straddles {
                    let ray = camera.ray(x as f64 + 0.5, y as f64 + 0.5);
                    if view.is_cut(camera.eye + ray / f64::from(inverse_depth)) {
                        return;
                    }
                }
                *sample = Sample { triangle: *t, inverse_depth };
            });
        }
    });
    samples
}

/// A triangle in the picture: its bounds and its edge functions.
struct Setup {
    corners: [Projected; 3],
    doubled_area: f64,
    columns: Range<usize>,
    rows: Range<usize>,
}

impl Setup {
    /// None if it covers no centre of a sample, has no area or lies behind the camera.
    fn new(corners: [Projected; 3], [width, height]: [usize; 2]) -> Option<Self> {
        let [a, b, c] = corners;
        let rows = centres(a.y.min(b.y).min(c.y), a.y.max(b.y).max(c.y), height);
        let columns = centres(a.x.min(b.x).min(c.x), a.x.max(b.x).max(c.x), width);
        let doubled_area = edge(a, b, c.x, c.y);
        let before = corners.iter().all(|corner| corner.inverse_depth > 0.0);
        let covers = !rows.is_empty() && !columns.is_empty() && doubled_area != 0.0 && doubled_area.is_finite();
        (before && covers).then_some(Self { corners, doubled_area, columns, rows })
    }

    /// Calls `visit` with column, row and 1/depth of each covered sample in a band of rows, including those on borders.
    fn visit(&self, band: &Range<usize>, mut found: impl FnMut(usize, usize, f32)) {
        let [a, b, c] = self.corners;
        for row in self.rows.start.max(band.start)..self.rows.end.min(band.end) {
            let y = row as f32 + 0.5;
            for column in self.columns.clone() {
                let x = column as f32 + 0.5;
                let weights = [edge(b, c, x, y), edge(c, a, x, y), edge(a, b, x, y)].map(|e| e / self.doubled_area);
                if weights.iter().all(|&weight| weight >= 0.0) {
                    let [u, v, w] = weights.map(|weight| weight as f32);
                    found(column, row, u * a.inverse_depth + v * b.inverse_depth + w * c.inverse_depth);
                }
            }
        }
    }
}

/// Indices below `end` whose centres (i + ½) lie from `low` to `high`.
fn centres(low: f32, high: f32, end: usize) -> Range<usize> {
    // Casts of floats saturate, and map NaN to 0.
    let first = (low - 0.5).ceil().max(0.0) as usize;
    let last = (high + 0.5).floor().max(0.0) as usize;
    first..last.min(end)
}

/// Twice the signed area of a, b and (x, y).
///
/// The result for b, a is exactly the negative, and precise enough that triangles with a common edge leave no gap.
fn edge(a: Projected, b: Projected, x: f32, y: f32) -> f64 {
    if (b.x, b.y) < (a.x, a.y) {
        return -edge(b, a, x, y);
    }
    let [ax, ay, bx, by, x, y] = [a.x, a.y, b.x, b.y, x, y].map(f64::from);
    (bx - ax) * (y - ay) - (by - ay) * (x - ax)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square_at(z: f64) -> [DVec3; 4] {
        [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| DVec3::new(x, y, z))
    }

    #[test]
    fn the_nearer_square_covers_the_farther_without_holes() {
        let positions = [square_at(0.0), square_at(0.5)].concat();
        let triangles = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]];
        let view = View { azimuth_deg: 0.0, elevation_deg: 0.0, ..View::whole(100, 150) };
        let camera = Camera::framing(&view, &positions, 100, 150);
        let samples = rasterize(&view, &camera, &positions, &triangles, [100, 150]);
        let shown: Vec<u32> = samples.iter().map(|s| s.triangle).filter(|&t| t != NONE).collect();
        assert!(shown.iter().all(|&t| t >= 2), "the farther square is hidden");
        assert!((92 * 92..=98 * 98).contains(&shown.len()), "{}", shown.len());
        assert_ne!(samples[75 * 100 + 50].triangle, NONE);
    }

    #[test]
    fn surfaces_behind_the_removed_part_are_visible() {
        let positions = [square_at(0.0), square_at(0.5)].concat();
        let triangles = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]];
        let cut = vec![
            super::super::Plane { normal: [0.0, 0.0, 1.0], offset: 0.25 },
            super::super::Plane { normal: [1.0, 0.0, 0.0], offset: 0.0 },
        ];
        let view = View { azimuth_deg: 0.0, elevation_deg: 0.0, cut, ..View::whole(100, 100) };
        let camera = Camera::framing(&view, &positions, 100, 100);
        let samples = rasterize(&view, &camera, &positions, &triangles, [100, 100]);
        assert!(samples[50 * 100 + 25].triangle >= 2);
        assert!(samples[50 * 100 + 75].triangle < 2);
    }

    #[test]
    fn no_sample_falls_between_the_triangles_of_a_closed_body() {
        let mesh = crate::model::sample::tube(90, 30, 0.4);
        let positions: Vec<DVec3> = mesh.positions.iter().map(|p| glam::Vec3::from(*p).as_dvec3()).collect();
        for turn in 0..6 {
            let view = View { azimuth_deg: 17.0 + 60.0 * f64::from(turn), ..View::whole(300, 200) };
            let camera = Camera::framing(&view, &positions, 300, 200);
            let samples = rasterize(&view, &camera, &positions, &mesh.triangles, [300, 200]);
            assert!(samples.iter().filter(|s| s.triangle != NONE).count() > 10_000);
            for (i, sample) in samples.iter().enumerate().filter(|(_, s)| s.triangle != NONE) {
                let [a, b, c] = mesh.triangles[sample.triangle as usize].map(|v| positions[v as usize]);
                let ray = camera.ray((i % 300) as f64 + 0.5, (i / 300) as f64 + 0.5);
                let cosine = (b - a).cross(c - a).normalize().dot(ray.normalize());
                // At a silhouette front and back have the same depth.
                assert!(cosine < 0.05, "the back shows through: turn {turn}, sample {i}, {cosine}");
            }
        }
    }
}
