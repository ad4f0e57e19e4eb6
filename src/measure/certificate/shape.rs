//! Measures of the triangles: area, enclosed volume, least edge and angle; and which are degenerate, exactly.

use super::surface::{Coordinate, Surface, Tally, few};
use super::topology::Topology;
use super::types::{FailureKind, Failures, TriangleQuality};
use crate::geometry::tri_tri::Triangle;
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
    min_edge_squared: f64,
    /// Square of the tangent of the least angle.
    min_tan_squared: f64,
    quality: TriangleQuality,
    low: [f64; 3],
    high: [f64; 3],
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
        let part = |&start: &usize| part(surface, origin, &body_of, start..surface.triangles.len().min(start + RUN));
        let parts: Vec<Part> = starts.par_iter().map(part).collect();
        for part in parts {
            self.area += part.area;
            for (body, volume) in part.volumes {
                if self.volumes.len() <= body {
                    self.volumes.resize(body + 1, 0.0);
                }
                self.volumes[body] += volume / 6.0;
            }
            self.min_edge = self.min_edge.min(part.min_edge_squared.sqrt());
            self.min_angle_deg = self.min_angle_deg.min(part.min_tan_squared.sqrt().atan().to_degrees());
            self.quality.add(&part.quality);
            for axis in 0..3 {
                self.bounds[0][axis] = self.bounds[0][axis].min(part.low[axis]);
                self.bounds[1][axis] = self.bounds[1][axis].max(part.high[axis]);
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
        min_edge_squared: f64::INFINITY,
        min_tan_squared: f64::INFINITY,
        quality: TriangleQuality::default(),
        low: [f64::INFINITY; 3],
        high: [f64::NEG_INFINITY; 3],
    };
    for (triangle, t) in run.clone().zip(&surface.triangles[run]) {
        let [a, b, c] = t.map(|v| surface.point(v));
        for p in [a, b, c] {
            for (axis, x) in p.into_iter().enumerate() {
                part.low[axis] = lesser(x, part.low[axis]);
                part.high[axis] = greater(x, part.high[axis]);
            }
        }
        let (u, v, w) = (sub(b, a), sub(c, a), sub(c, b));
        let (uu, vv, ww) = (dot(u, u), dot(v, v), dot(w, w));
        let normal = cross(u, v);
        let nn = dot(normal, normal);
        // Twice the area against the longest edges: far from zero in all but slivers, which are tested exactly.
        if nn <= 1e-20 * uu * vv && Triangle::new([a, b, c]).is_degenerate() {
            part.degenerate.push(surface.number(triangle));
        }
        part.area += nn.sqrt() / 2.0;
        let (shortest, longest) = (lesser(lesser(uu, vv), ww), greater(greater(uu, vv), ww));
        part.min_edge_squared = lesser(shortest, part.min_edge_squared);
        // The least angle lies opposite to the shortest edge: between two edges whose product is this cosine part.
        let along = (uu + vv + ww) / 2.0 - shortest;
        let tan_squared = if along > 0.0 { nn / (along * along) } else { 0.0 };
        part.min_tan_squared = lesser(tan_squared, part.min_tan_squared);
        let ratio_squared = if shortest > 0.0 { longest / shortest } else { f64::INFINITY };
        part.quality.count(tan_squared, ratio_squared);
        let six_volumes = dot(sub(a, origin), normal);
        let body = body_of(*t);
        match part.volumes.last_mut() {
            Some((last, sum)) if *last == body => *sum += six_volumes,
            _ => part.volumes.push((body, six_volumes)),
        }
    }
    part
}

// `min` and `max` treat NaN apart, which finite coordinates do not give.
fn lesser(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

fn greater(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
