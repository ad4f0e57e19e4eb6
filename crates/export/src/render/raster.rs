//! Rasterizer: finds the visible triangle of each sample of a picture with a depth buffer.
//! Horizontal bands are filled in parallel.
//!
//! Each sample is shaded once afterwards, so the cost of shading does not depend on hidden
//! triangles.

use super::view::{Camera, Projected, View};
use glam::DVec3;
use rayon::prelude::*;
use std::ops::Range;

/// Value of [`Sample::surface`] where nothing is visible.
pub(super) const NONE: u32 = u32::MAX;

/// Rows of samples per task.
const BAND: usize = 128;
/// Maximum width of triangles whose columns are all tested, in samples.
const NARROW: usize = 8;

/// The visible surface at a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sample {
    /// Distance along the line of sight; infinite if nothing is visible.
    pub depth: f32,
    /// Index of a triangle, [`NONE`], or [`face`] of a cut.
    pub surface: u32,
}

/// Value of [`Sample::surface`] for the flat face of cut `k`.
pub(super) const fn face(k: usize) -> u32 {
    NONE - 1 - k as u32
}

impl Sample {
    const EMPTY: Self = Self { depth: f32::INFINITY, surface: NONE };
}

/// Finds the nearest triangle of each sample that is not cut away there. If the back of a closed
/// surface is visible through a cut, the sample shows the face of the cut.
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
    // The removed part is convex, so it contains a triangle if it contains its corners.
    let visible = |t: &u32| triangles[*t as usize].map(|v| removed[v as usize]) != [true; 3];
    let mut candidates: Vec<CandidateTriangle> = (0..triangles.len() as u32)
        .into_par_iter()
        .filter(visible)
        .filter_map(|t| {
            let corners = corners_of(t);
            let rows = TriangleSetup::new(corners, [width, height])?.rows;
            let nearest = corners.iter().fold(f32::INFINITY, |nearest, corner| nearest.min(corner.depth));
            Some(CandidateTriangle { triangle: t, rows: rows.start as u32..rows.end as u32, nearest })
        })
        .collect();
    // From front to back, so that hidden triangles are rejected early.
    candidates.par_sort_unstable_by(|a, b| a.nearest.total_cmp(&b.nearest).then(a.triangle.cmp(&b.triangle)));
    let mut samples = vec![Sample::EMPTY; width * height];
    samples.par_chunks_mut(BAND * width).enumerate().for_each(|(band, samples)| {
        let band = band * BAND..band * BAND + samples.len() / width;
        for &CandidateTriangle { triangle: t, ref rows, nearest } in &candidates {
            if rows.end as usize <= band.start || rows.start as usize >= band.end {
                continue;
            }
            let Some(setup) = TriangleSetup::new(corners_of(t), [width, height]) else { continue };
            // A wedge can cut a triangle without containing any of its corners.
            let straddles = match view.cut.len() {
                0 => false,
                1 => triangles[t as usize].iter().any(|&v| removed[v as usize]),
                _ => true,
            };
            setup.visit(&band, |x, y| {
                let sample = &mut samples[(y - band.start) * width + x];
                if nearest >= sample.depth {
                    return;
                }
                let Some(depth) = setup.depth(x, y).filter(|&depth| depth < sample.depth) else { return };
                if straddles {
                    let point = camera.at(x as f64 + 0.5, y as f64 + 0.5) + camera.forward * f64::from(depth);
                    if view.is_cut(point) {
                        return;
                    }
                }
                *sample = Sample { depth, surface: t };
            });
        }
        if view.cut.is_empty() {
            return;
        }
        for (i, sample) in samples.iter_mut().enumerate().filter(|(_, sample)| sample.surface != NONE) {
            // The back is visible only from inside, after the line of sight entered the body
            // through a cut.
            let [a, b, c] = corners_of(sample.surface);
            let is_back = Edge::new(a, b).at(c.x, c.y) > 0.0;
            let face = || cut_before(view, camera, i % width, band.start + i / width, sample.depth);
            if let Some(face) = is_back.then(face).flatten() {
                *sample = face;
            }
        }
    });
    samples
}

/// Face of the cut through which the line of sight leaves the removed part, if it does so before
/// `depth`.
fn cut_before(view: &View, camera: &Camera, x: usize, y: usize, depth: f32) -> Option<Sample> {
    let from = camera.at(x as f64 + 0.5, y as f64 + 0.5);
    let (mut enters, mut leaves) = (f64::NEG_INFINITY, (f64::INFINITY, 0));
    for (k, plane) in view.cut.iter().enumerate() {
        let normal = DVec3::from(plane.normal);
        let along = normal.dot(camera.forward);
        let at = (plane.offset - normal.dot(from)) / along;
        if along > 0.0 {
            enters = at.max(enters);
        } else if along < 0.0 && at < leaves.0 {
            leaves = (at, k);
        }
    }
    let (at, k) = leaves;
    let before = enters < at && at <= f64::from(depth) + 1e-6 / camera.scale;
    before.then_some(Sample { depth: at as f32, surface: face(k) })
}

/// A triangle that may be visible.
struct CandidateTriangle {
    triangle: u32,
    rows: Range<u32>,
    /// Minimum depth of the corners.
    nearest: f32,
}

/// A triangle in the picture, with its bounds and edge functions.
struct TriangleSetup {
    /// Depths of the corners.
    depths: [f32; 3],
    /// Edges opposite to the corners.
    edges: [Edge; 3],
    doubled_area: f64,
    columns: Range<usize>,
    rows: Range<usize>,
}

impl TriangleSetup {
    /// `None` if the triangle covers no centre of a sample or has no area.
    #[inline]
    fn new(corners: [Projected; 3], [width, height]: [usize; 2]) -> Option<Self> {
        let [a, b, c] = corners;
        let rows = centres(a.y.min(b.y).min(c.y), a.y.max(b.y).max(c.y), height);
        let columns = centres(a.x.min(b.x).min(c.x), a.x.max(b.x).max(c.x), width);
        if rows.is_empty() || columns.is_empty() {
            return None;
        }
        let edges = [Edge::new(b, c), Edge::new(c, a), Edge::new(a, b)];
        let doubled_area = edges[2].at(c.x, c.y);
        let has_area = doubled_area != 0.0 && doubled_area.is_finite();
        has_area.then_some(Self { depths: corners.map(|corner| corner.depth), edges, doubled_area, columns, rows })
    }

    /// Columns of a row that the triangle may cover; for a long thin triangle, a small part of its
    /// bounds.
    #[inline]
    fn span(&self, y: f32) -> Range<usize> {
        if self.columns.len() <= NARROW {
            return self.columns.clone();
        }
        let (mut low, mut high) = (self.columns.start as f64, self.columns.end as f64);
        for Edge { from, along } in &self.edges {
            // The crossing of the edge and the row, with a margin of a column for rounding.
            let x = from[0] + along[0] * (f64::from(y) - from[1]) / along[1];
            if along[1] * self.doubled_area > 0.0 {
                high = high.min((x + 1.5).ceil());
            } else if along[1] * self.doubled_area < 0.0 {
                low = low.max(x - 1.5);
            }
        }
        low as usize..high.max(0.0) as usize
    }

    /// Calls `visit` with the column and row of each sample in a band that the triangle may cover.
    #[inline]
    fn visit(&self, band: &Range<usize>, mut visit: impl FnMut(usize, usize)) {
        for row in self.rows.start.max(band.start)..self.rows.end.min(band.end) {
            for column in self.span(row as f32 + 0.5) {
                visit(column, row);
            }
        }
    }

    /// Depth at a sample, if the triangle covers it. Samples on the borders are covered.
    #[inline]
    fn depth(&self, column: usize, row: usize) -> Option<f32> {
        let [x, y] = [column, row].map(|i| i as f32 + 0.5);
        let values = [0, 1, 2].map(|k| self.edges[k].at(x, y));
        let inside = if self.doubled_area > 0.0 {
            values.iter().all(|&value| value >= 0.0)
        } else {
            values.iter().all(|&value| value <= 0.0)
        };
        inside.then(|| {
            let [u, v, w] = values.map(|value| (value / self.doubled_area) as f32);
            u * self.depths[0] + v * self.depths[1] + w * self.depths[2]
        })
    }
}

/// Indices i below `end` whose centres i + ½ lie between `low` and `high`.
fn centres(low: f32, high: f32, end: usize) -> Range<usize> {
    // Casts of floats saturate, and map NaN to 0.
    let first = (low - 0.5).ceil().max(0.0) as usize;
    let last = (high + 0.5).floor().max(0.0) as usize;
    first..last.min(end)
}

/// An edge of a triangle. Values are computed relative to the smaller end, so triangles with a
/// common edge leave no gap.
struct Edge {
    from: [f64; 2],
    along: [f64; 2],
}

impl Edge {
    #[inline]
    fn new(a: Projected, b: Projected) -> Self {
        let [p, q] = [a, b].map(|end| [f64::from(end.x), f64::from(end.y)]);
        let from = if (b.x, b.y) < (a.x, a.y) { q } else { p };
        Self { from, along: [q[0] - p[0], q[1] - p[1]] }
    }

    /// Twice the signed area of the edge and a point, positive if they are clockwise in the
    /// picture. The value of the reversed edge is exactly the negative.
    #[inline]
    fn at(&self, x: f32, y: f32) -> f64 {
        let [x, y] = [f64::from(x) - self.from[0], f64::from(y) - self.from[1]];
        self.along[0] * y - self.along[1] * x
    }
}

#[cfg(test)]
mod tests {
    use super::super::view::plain;
    use super::*;

    fn square_at(z: f64) -> [DVec3; 4] {
        [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| DVec3::new(x, y, z))
    }

    #[test]
    fn the_nearer_square_covers_the_farther_without_holes() {
        let positions = [square_at(0.0), square_at(0.5)].concat();
        let triangles = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]];
        let view = View { azimuth_deg: 0.0, elevation_deg: 0.0, ..plain(100, 150) };
        let camera = Camera::framing(&view, &positions, [100, 150], 0.0);
        let samples = rasterize(&view, &camera, &positions, &triangles, [100, 150]);
        let shown: Vec<u32> = samples.iter().map(|s| s.surface).filter(|&t| t != NONE).collect();
        assert!(shown.iter().all(|&t| t >= 2), "the farther square is hidden");
        assert!((88 * 88..=91 * 91).contains(&shown.len()), "{}", shown.len());
        assert_ne!(samples[75 * 100 + 50].surface, NONE);
    }

    #[test]
    fn surfaces_behind_the_removed_part_are_visible() {
        let positions = [square_at(0.0), square_at(0.5)].concat();
        let triangles = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]];
        let cut = vec![
            super::super::Plane { normal: [0.0, 0.0, 1.0], offset: 0.25 },
            super::super::Plane { normal: [1.0, 0.0, 0.0], offset: 0.0 },
        ];
        let view = View { azimuth_deg: 0.0, elevation_deg: 0.0, cut, ..plain(100, 100) };
        let camera = Camera::framing(&view, &positions, [100, 100], 0.0);
        let samples = rasterize(&view, &camera, &positions, &triangles, [100, 100]);
        assert!(samples[50 * 100 + 25].surface >= 2);
        assert!(samples[50 * 100 + 75].surface < 2);
    }

    #[test]
    fn long_thin_triangles_cover_what_a_test_of_all_samples_finds() {
        let corner = |x, y| Projected { x, y, depth: 0.0 };
        for (a, b, c) in [
            (corner(2.25, 3.0), corner(97.0, 60.5), corner(96.0, 62.25)),
            (corner(90.0, 1.5), corner(3.0, 70.0), corner(1.5, 68.0)),
            (corner(1.0, 20.5), corner(99.0, 20.5), corner(50.0, 21.75)),
            (corner(-40.0, -30.0), corner(150.0, 90.0), corner(120.0, 95.0)),
        ] {
            for corners in [[a, b, c], [a, c, b]] {
                let setup = TriangleSetup::new(corners, [100, 80]).unwrap();
                let mut found = Vec::new();
                setup.visit(&(0..80), |x, y| found.extend(setup.depth(x, y).map(|_| (x, y))));
                let sign = setup.doubled_area.signum();
                let covers = |x: usize, y: usize| {
                    setup.edges.iter().all(|edge| sign * edge.at(x as f32 + 0.5, y as f32 + 0.5) >= 0.0)
                };
                let all: Vec<_> = (0..80).flat_map(|y| (0..100).map(move |x| (x, y))).collect();
                let expected: Vec<_> = all.into_iter().filter(|&(x, y)| covers(x, y)).collect();
                assert!(expected.len() > 20);
                assert_eq!(found, expected);
            }
        }
    }

    #[test]
    fn no_sample_falls_between_the_triangles_of_a_closed_body() {
        let mesh = crate::model::sample::tube(90, 30, 0.4);
        let positions: Vec<DVec3> = mesh.positions.iter().map(|p| glam::Vec3::from(*p).as_dvec3()).collect();
        for turn in 0..6 {
            let view = View { azimuth_deg: 17.0 + 60.0 * f64::from(turn), ..plain(310, 200) };
            let camera = Camera::framing(&view, &positions, [310, 200], 0.0);
            let samples = rasterize(&view, &camera, &positions, &mesh.triangles, [310, 200]);
            assert!(samples.iter().filter(|s| s.surface != NONE).count() > 10_000);
            for (i, sample) in samples.iter().enumerate().filter(|(_, s)| s.surface != NONE) {
                let [a, b, c] = mesh.triangles[sample.surface as usize].map(|v| positions[v as usize]);
                let cosine = (b - a).cross(c - a).normalize().dot(camera.forward);
                // At a silhouette, front and back have the same depth.
                assert!(cosine < 0.05, "the back shows through: turn {turn}, sample {i}, {cosine}");
            }
        }
    }
}
