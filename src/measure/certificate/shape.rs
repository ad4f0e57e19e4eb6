//! Measures of the triangles: area, enclosed volume, least edge and angle; and which are degenerate, exactly.

use super::surface::{Coordinate, Corners, LANES, Surface, Tally, few};
use super::topology::Topology;
use super::types::{FailureKind, Failures, TriangleQuality};
use crate::geometry::tri_tri::Triangle;
use crate::vectorize::Vectors;
use rayon::prelude::*;
use std::ops::Range;

/// Triangles summed up as one part.
const RUN: usize = 4096;

/// Measures in metres and degrees.
pub(super) struct Shape {
    /// Numbers of the triangles without area, in order.
    pub(super) degenerate: Vec<u32>,
    pub(super) area: f64,
    /// Enclosed by each component, up to the last one of those met.
    pub(super) volumes: Vec<f64>,
    pub(super) min_edge: f64,
    pub(super) min_angle_deg: f64,
    pub(super) quality: TriangleQuality,
    pub(super) bounds: [[f64; 3]; 2],
}

struct Part {
    degenerate: Vec<u32>,
    area: f64,
    /// Six times the volume, by component in the order met.
    volumes: Vec<(usize, f64)>,
    quality: TriangleQuality,
    least: Least,
}

/// Extremes, by lane.
struct Least {
    edge_squared: [f64; LANES],
    /// Square of the tangent of the least angle.
    tan_squared: [f64; LANES],
    low: [[f64; LANES]; 3],
    high: [[f64; LANES]; 3],
}

impl Shape {
    /// The measures of no triangles.
    pub(super) fn new() -> Self {
        Self {
            degenerate: Vec::new(),
            area: 0.0,
            volumes: Vec::new(),
            min_edge: f64::INFINITY,
            min_angle_deg: f64::INFINITY,
            quality: TriangleQuality::default(),
            bounds: [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]],
        }
    }

    /// Adds the triangles of a surface; `body_of` tells the component of each. Volumes are measured from `origin`: relative to
    /// a vertex of the surface they lose no digits to its distance from the origin of the coordinates.
    pub(super) fn add<C: Coordinate>(
        &mut self,
        surface: &Surface<'_, C>,
        origin: [f64; 3],
        body_of: impl Fn([u32; 3]) -> usize + Sync,
    ) {
        let starts: Vec<usize> = (0..surface.triangles.len()).step_by(RUN).collect();
        let part = |&start: &usize| {
            Vectors::best().run(
                #[inline(always)]
                || part(surface, origin, &body_of, start..surface.triangles.len().min(start + RUN)),
            )
        };
        let parts: Vec<Part> = starts.par_iter().map(part).collect();
        for part in parts {
            self.area += part.area;
            for (body, volume) in part.volumes {
                if self.volumes.len() <= body {
                    self.volumes.resize(body + 1, 0.0);
                }
                self.volumes[body] += volume / 6.0;
            }
            let Least { edge_squared, tan_squared, low, high } = part.least;
            self.min_edge = self.min_edge.min(least(edge_squared).sqrt());
            self.min_angle_deg = self.min_angle_deg.min(least(tan_squared).sqrt().atan().to_degrees());
            self.quality.add(&part.quality);
            for axis in 0..3 {
                self.bounds[0][axis] = self.bounds[0][axis].min(least(low[axis]));
                self.bounds[1][axis] = self.bounds[1][axis].max(-least(high[axis].map(|x| -x)));
            }
            self.degenerate.extend(part.degenerate);
        }
    }
}

pub(super) fn examine<C: Coordinate>(surface: &Surface<'_, C>, topology: &Topology, failures: &mut Failures) -> Shape {
    let mut shape = Shape::new();
    shape.add(surface, surface.corners(0)[0], |t| topology.body_of(t));
    let mut degenerate = Tally::default();
    degenerate.add(shape.degenerate.len() as u64, few(&shape.degenerate, |&t| surface.place_of_triangles(&[t])));
    report(&degenerate, failures);
    shape
}

/// Reports degenerate triangles.
pub(super) fn report(degenerate: &Tally, failures: &mut Failures) {
    degenerate.report(FailureKind::DegenerateTriangles, "triangles have no area", failures);
}

#[inline(always)]
fn part<C: Coordinate>(
    surface: &Surface<'_, C>,
    origin: [f64; 3],
    body_of: impl Fn([u32; 3]) -> usize,
    run: Range<usize>,
) -> Part {
    let mut part = Part {
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
    for first in run.clone().step_by(LANES) {
        let triangles = first..run.end.min(first + LANES);
        let corners = surface.lanes(triangles.clone());
        let lanes = Lanes::of(&corners, origin);
        part.least.add(&corners, &lanes);
        part.quality.count(&lanes.tan_squared, &lanes.ratio_squared, triangles.len());
        for (lane, triangle) in triangles.enumerate() {
            if lanes.is_thin[lane] != 0 && Triangle::new(surface.corners(triangle)).is_degenerate() {
                part.degenerate.push(surface.number(triangle));
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
    /// Not 0 for those that may have no area.
    is_thin: [u64; LANES],
    area: [f64; LANES],
    /// Square of the shortest edge.
    shortest: [f64; LANES],
    /// Squares of the tangent of the least angle, and of the ratio of the longest edge to the shortest.
    tan_squared: [f64; LANES],
    ratio_squared: [f64; LANES],
    six_volumes: [f64; LANES],
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
        };
        for lane in 0..LANES {
            let [a, b, c] = corners.each_ref().map(|corner| corner.each_ref().map(|axis| axis[lane]));
            let (u, v, w) = (sub(b, a), sub(c, a), sub(c, b));
            let (uu, vv, ww) = (dot(u, u), dot(v, v), dot(w, w));
            let normal = cross(u, v);
            let nn = dot(normal, normal);
            // Twice the area against the longest edges: far from zero in all but slivers, which are tested exactly.
            lanes.is_thin[lane] = u64::from(nn <= 1e-20 * uu * vv);
            lanes.area[lane] = nn.sqrt() / 2.0;
            let (shortest, longest) = (lesser(lesser(uu, vv), ww), greater(greater(uu, vv), ww));
            lanes.shortest[lane] = shortest;
            // The least angle lies opposite to the shortest edge: between two edges whose product is this cosine part.
            let along = (uu + vv + ww) / 2.0 - shortest;
            let (tan_squared, ratio_squared) = (nn / (along * along), longest / shortest);
            // What is not a number, in lanes without a triangle, stays so.
            lanes.tan_squared[lane] = if along <= 0.0 { 0.0 } else { tan_squared };
            lanes.ratio_squared[lane] = if shortest <= 0.0 { f64::INFINITY } else { ratio_squared };
            lanes.six_volumes[lane] = dot(sub(a, origin), normal);
        }
        lanes
    }
}

fn least(lanes: [f64; LANES]) -> f64 {
    lanes.into_iter().fold(f64::INFINITY, lesser)
}

// `min` and `max` treat NaN apart, which finite coordinates do not give.
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
