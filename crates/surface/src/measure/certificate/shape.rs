//! Measures of triangles: area, enclosed volume, minimum edge and angle; and an exact test for
//! degenerate triangles.

use super::surface::{Coordinate, Corners, LANES, Surface, few};
use super::types::{FailureKind, Failures, TriangleQuality};
use crate::geometry::bvh::no_points;
use crate::geometry::tri_tri::Triangle;
use crate::vectorize::Vectors;
use rayon::prelude::*;

/// Number of triangles that are summed as one run.
pub(super) const RUN: usize = 4096;

/// Measures of all triangles, in units of the positions and degrees.
pub(super) struct TriangleMeasures {
    /// Triangles without area, in order.
    pub(super) degenerate: Vec<u32>,
    pub(super) area: f64,
    /// Volume enclosed by each component.
    pub(super) volumes: Vec<f64>,
    pub(super) min_edge: f64,
    pub(super) min_angle_deg: f64,
    pub(super) quality: TriangleQuality,
    pub(super) bounds: [[f64; 3]; 2],
}

pub(super) struct RunMeasures {
    degenerate: Vec<u32>,
    pub(super) area: f64,
    /// Six times the volume by component, in the order of the triangles.
    pub(super) volumes: Vec<(usize, f64)>,
    quality: TriangleQuality,
    least: Least,
}

/// Orientation of a triangle seen along each axis. Bit `a` is set if the triangle turns left seen
/// along axis `a`, bit `3 + a` if it turns right. Neither bit is set if rounding may have decided.
#[derive(Clone, Copy)]
pub(super) struct Turns(u8);

impl Turns {
    /// Orientation of an empty set of triangles.
    pub(super) const ANY: Self = Self(0b11_1111);

    pub(super) fn and(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }

    /// True if all triangles turn the same way, seen along an axis.
    pub(super) fn agree(self, axis: usize) -> bool {
        self.0 & (0b1001 << axis) != 0
    }

    /// Bits of a triangle whose edges from one corner are `u` and `v`.
    #[inline(always)]
    fn bits(u: [f64; 3], v: [f64; 3]) -> u64 {
        // Error of the difference of two products of rounded differences, relative to the sum of
        // their magnitudes: Shewchuk's bound for orient2d.
        const ERROR: f64 = 3.330_669_073_875_471_6e-16;
        let mut turns = 0;
        for axis in 0..3 {
            let (x, y) = ((axis + 1) % 3, (axis + 2) % 3);
            let (p, q) = (u[x] * v[y], u[y] * v[x]);
            let (turn, error) = (p - q, ERROR * (p.abs() + q.abs()));
            turns |= u64::from(turn > error) << axis | u64::from(turn < -error) << (3 + axis);
        }
        turns
    }
}

/// Extremes per lane.
struct Least {
    edge_squared: [f64; LANES],
    /// Squared tangent of the smallest angle.
    tan_squared: [f64; LANES],
    low: [[f64; LANES]; 3],
    high: [[f64; LANES]; 3],
}

impl TriangleMeasures {
    /// Measures a surface. `body_of` returns the component of a triangle. `turns` receives the
    /// orientation of each triangle.
    ///
    /// Volumes are measured from `origin`. If that is a vertex of the surface, they lose no digits
    /// to the distance of the surface from the origin of the coordinates.
    pub(super) fn of<C: Coordinate>(
        surface: &Surface<'_, C>,
        origin: [f64; 3],
        body_of: impl Fn([u32; 3]) -> usize + Sync,
        turns: &mut [Turns],
    ) -> Self {
        let mut shape = Self {
            degenerate: Vec::new(),
            area: 0.0,
            volumes: Vec::new(),
            min_edge: f64::INFINITY,
            min_angle_deg: f64::INFINITY,
            quality: TriangleQuality::default(),
            bounds: [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]],
        };
        let part = |(run, turns): (usize, &mut [Turns])| {
            Vectors::best().run(
                #[inline(always)]
                || part(surface, origin, &body_of, run * RUN, turns),
            )
        };
        let parts: Vec<RunMeasures> = turns.par_chunks_mut(RUN).enumerate().map(part).collect();
        for part in parts {
            shape.area += part.area;
            for (body, volume) in part.volumes {
                if shape.volumes.len() <= body {
                    shape.volumes.resize(body + 1, 0.0);
                }
                shape.volumes[body] += volume / 6.0;
            }
            let Least { edge_squared, tan_squared, low, high } = part.least;
            shape.min_edge = shape.min_edge.min(least(edge_squared).sqrt());
            shape.min_angle_deg = shape.min_angle_deg.min(least(tan_squared).sqrt().atan().to_degrees());
            shape.quality.add(&part.quality);
            for axis in 0..3 {
                shape.bounds[0][axis] = shape.bounds[0][axis].min(least(low[axis]));
                shape.bounds[1][axis] = shape.bounds[1][axis].max(-least(high[axis].map(|x| -x)));
            }
            shape.degenerate.extend(part.degenerate);
        }
        shape
    }

    /// Adds a failure for degenerate triangles.
    pub(super) fn report<C: Coordinate>(&self, surface: &Surface<'_, C>, failures: &mut Failures) {
        let count = self.degenerate.len() as u64;
        let places = few(&self.degenerate, |&t| surface.place_of_triangles(&[t]));
        failures.add(FailureKind::DegenerateTriangles, count, format!("{count} triangles have no area"), places);
    }
}

/// Measures as many triangles as `turns` has entries, from `first` on, and stores their
/// orientations in `turns`.
#[inline(always)]
pub(super) fn part<C: Coordinate>(
    surface: &Surface<'_, C>,
    origin: [f64; 3],
    body_of: impl Fn([u32; 3]) -> usize,
    first: usize,
    turns: &mut [Turns],
) -> RunMeasures {
    let mut part = RunMeasures {
        degenerate: Vec::new(),
        area: 0.0,
        volumes: Vec::new(),
        quality: TriangleQuality::default(),
        least: Least {
            edge_squared: [f64::INFINITY; LANES],
            tan_squared: [f64::INFINITY; LANES],
            low: [[f64::INFINITY; LANES]; 3],
            high: [[f64::NEG_INFINITY; LANES]; 3],
        },
    };
    let mut corners = no_points();
    for (turns, first) in turns.chunks_mut(LANES).zip((first..).step_by(LANES)) {
        let triangles = first..first + turns.len();
        surface.lanes(triangles.clone(), &mut corners);
        let lanes = Lanes::of(&corners, origin);
        turns.copy_from_slice(&lanes.turns.map(|bits| Turns(bits as u8))[..turns.len()]);
        part.least.add(&corners, &lanes);
        part.quality.count(&lanes.tan_squared, &lanes.ratio_squared, triangles.len());
        for (lane, triangle) in triangles.enumerate() {
            if lanes.is_thin[lane] != 0 && Triangle::new(surface.corners(triangle)).is_degenerate() {
                part.degenerate.push(triangle as u32);
            }
            part.area += lanes.area[lane];
            let body = body_of(surface.triangles[triangle]);
            match part.volumes.last_mut() {
                Some((last, sum)) if *last == body => *sum += lanes.six_volumes[lane],
                _ => part.volumes.push((body, lanes.six_volumes[lane])),
            }
        }
    }
    part
}

impl Least {
    #[inline(always)]
    fn add(&mut self, corners: &Corners, lanes: &Lanes) {
        for lane in 0..LANES {
            self.edge_squared[lane] = lesser(lanes.shortest[lane], self.edge_squared[lane]);
            self.tan_squared[lane] = lesser(lanes.tan_squared[lane], self.tan_squared[lane]);
        }
        for corner in corners {
            for ((low, high), x) in self.low.iter_mut().zip(&mut self.high).zip(corner) {
                for lane in 0..LANES {
                    low[lane] = lesser(x[lane], low[lane]);
                    high[lane] = greater(x[lane], high[lane]);
                }
            }
        }
    }
}

/// Measures of eight triangles.
struct Lanes {
    /// Not 0 for triangles that may have no area.
    is_thin: [u64; LANES],
    area: [f64; LANES],
    /// Squared length of the shortest edge.
    shortest: [f64; LANES],
    /// Squared tangent of the smallest angle, and squared ratio of the longest to the shortest
    /// edge.
    tan_squared: [f64; LANES],
    ratio_squared: [f64; LANES],
    six_volumes: [f64; LANES],
    /// Bits of [`Turns`].
    turns: [u64; LANES],
}

impl Lanes {
    #[inline(always)]
    fn of(corners: &Corners, origin: [f64; 3]) -> Self {
        let zero = [0.0; LANES];
        let mut lanes = Self {
            is_thin: [0; LANES],
            area: zero,
            shortest: zero,
            tan_squared: zero,
            ratio_squared: zero,
            six_volumes: zero,
            turns: [0; LANES],
        };
        for lane in 0..LANES {
            let [a, b, c] = corners.each_ref().map(|corner| corner.each_ref().map(|axis| axis[lane]));
            let (u, v, w) = (sub(b, a), sub(c, a), sub(c, b));
            let (uu, vv, ww) = (dot(u, u), dot(v, v), dot(w, w));
            let normal = cross(u, v);
            let nn = dot(normal, normal);
            // Compares the double area with the longest edges. Only slivers are near zero; these
            // are tested exactly.
            lanes.is_thin[lane] = u64::from(nn <= 1e-20 * uu * vv);
            lanes.area[lane] = nn.sqrt() / 2.0;
            let (shortest, longest) = (lesser(lesser(uu, vv), ww), greater(greater(uu, vv), ww));
            lanes.shortest[lane] = shortest;
            // The smallest angle is opposite to the shortest edge. `along` is the scalar product of
            // the other two edges.
            let along = (uu + vv + ww) / 2.0 - shortest;
            let (tan_squared, ratio_squared) = (nn / (along * along), longest / shortest);
            // NaN, in lanes without a triangle, stays NaN.
            lanes.tan_squared[lane] = if along <= 0.0 { 0.0 } else { tan_squared };
            lanes.ratio_squared[lane] = if shortest <= 0.0 { f64::INFINITY } else { ratio_squared };
            lanes.six_volumes[lane] = dot(sub(a, origin), normal);
            lanes.turns[lane] = Turns::bits(u, v);
        }
        lanes
    }
}

fn least(lanes: [f64; LANES]) -> f64 {
    lanes.into_iter().fold(f64::INFINITY, lesser)
}

// `min` and `max` handle NaN, which costs instructions and does not occur in finite coordinates.
#[inline(always)]
fn lesser(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

#[inline(always)]
fn greater(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

#[inline(always)]
fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
