//! Which triangle each sample of a picture shows: a depth buffer, filled in horizontal bands in parallel.
//!
//! Shading comes later, once a sample, so that its cost does not grow with the triangles behind.

use super::view::{Camera, Projected, View};
use glam::DVec3;
use rayon::prelude::*;

/// No triangle.
pub(super) const NONE: u32 = u32::MAX;

/// Rows of samples that one task fills.
const BAND: usize = 64;

/// What a sample shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sample {
    /// Triangle, or [`NONE`].
    pub triangle: u32,
    /// 1/depth of the place.
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
    let mut samples = vec![Sample { triangle: NONE, inverse_depth: 0.0 }; width * height];
    samples.par_chunks_mut(BAND * width).enumerate().for_each(|(band, rows)| {
        let first_row = band * BAND;
        for (t, corners) in triangles.iter().enumerate() {
            let [a, b, c] = corners.map(|v| projected[v as usize]);
            let parts = corners.map(|v| removed[v as usize]);
            // The part cut away is convex: three corners in it, and the triangle is.
            let gone = parts == [true; 3];
            let behind = !(a.inverse_depth > 0.0 && b.inverse_depth > 0.0 && c.inverse_depth > 0.0);
            if gone || behind {
                continue;
            }
            // A wedge can reach into a triangle without holding any of its corners.
            let straddles = match view.cut.len() {
                0 => false,
                1 => parts != [false; 3],
                _ => true,
            };
            let Some(setup) = Setup::new([a, b, c], width, first_row, first_row + rows.len() / width) else { continue };
            setup.visit(|x, y, inverse_depth| {
                let sample = &mut rows[(y - first_row) * width + x];
                if inverse_depth <= sample.inverse_depth {
                    return;
                }
                if straddles {
                    let ray = camera.ray(x as f64 + 0.5, y as f64 + 0.5);
                    if view.is_cut(camera.eye + ray / f64::from(inverse_depth)) {
                        return;
                    }
                }
                *sample = Sample { triangle: t as u32, inverse_depth };
            });
        }
    });
    samples
}

/// A triangle in the picture: where it may lie, and its edge functions.
struct Setup {
    corners: [Projected; 3],
    doubled_area: f32,
    columns: std::ops::Range<usize>,
    rows: std::ops::Range<usize>,
}

impl Setup {
    /// None where it covers no sample centre of the rows or has no area.
    fn new(corners: [Projected; 3], width: usize, first_row: usize, end_row: usize) -> Option<Self> {
        let [a, b, c] = corners;
        let rows = centres(a.y.min(b.y).min(c.y), a.y.max(b.y).max(c.y), first_row, end_row);
        if rows.is_empty() {
            return None;
        }
        let columns = centres(a.x.min(b.x).min(c.x), a.x.max(b.x).max(c.x), 0, width);
        let doubled_area = edge(a, b, c.x, c.y);
        let sound = !columns.is_empty() && doubled_area != 0.0 && doubled_area.is_finite();
        sound.then_some(Self { corners, doubled_area, columns, rows })
    }

    /// Calls with column, row and 1/depth of each sample covered, borders included.
    fn visit(&self, mut found: impl FnMut(usize, usize, f32)) {
        let [a, b, c] = self.corners;
        for row in self.rows.clone() {
            let y = row as f32 + 0.5;
            for column in self.columns.clone() {
                let x = column as f32 + 0.5;
                let u = edge(b, c, x, y) / self.doubled_area;
                let v = edge(c, a, x, y) / self.doubled_area;
                let w = edge(a, b, x, y) / self.doubled_area;
                if u >= 0.0 && v >= 0.0 && w >= 0.0 {
                    found(column, row, u * a.inverse_depth + v * b.inverse_depth + w * c.inverse_depth);
                }
            }
        }
    }
}

/// Indices whose centres (i + ½) lie from `low` to `high`, within `start..end`.
fn centres(low: f32, high: f32, start: usize, end: usize) -> std::ops::Range<usize> {
    // Casts of floats saturate, and take what is not a number to 0.
    let first = (low - 0.5).ceil().max(0.0) as usize;
    let last = (high + 0.5).floor().max(0.0) as usize;
    first.max(start)..last.min(end)
}

/// Twice the signed area of a, b and (x, y).
fn edge(a: Projected, b: Projected, x: f32, y: f32) -> f32 {
    (b.x - a.x) * (y - a.y) - (b.y - a.y) * (x - a.x)
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
    fn what_is_cut_away_shows_what_is_behind() {
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
}
