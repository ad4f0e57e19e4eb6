//! Measures of the triangles: area, enclosed volume, least edge and angle; and which are degenerate, exactly.

use super::surface::{Coordinate, Surface, few};
use super::topology::Topology;
use super::types::{FailureKind, Failures, TriangleQuality};
use crate::geometry::tri_tri::Triangle;
use rayon::prelude::*;

/// Measures in metres and degrees.
pub(super) struct Shape {
    /// Triangles without area, in order.
    pub(super) degenerate: Vec<u32>,
    pub(super) area: f64,
    /// Enclosed by each component.
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

pub(super) fn examine<C: Coordinate>(surface: &Surface<'_, C>, topology: &Topology, failures: &mut Failures) -> Shape {
    // Relative to a vertex of the surface the volume loses no digits to its distance from the origin.
    let origin = surface.corners(0)[0];
    let parts: Vec<Part> = surface
        .triangles
        .par_chunks(4096)
        .enumerate()
        .map(|(chunk, triangles)| part(surface, topology, origin, chunk * 4096, triangles))
        .collect();
    let mut shape = Shape {
        degenerate: Vec::new(),
        area: 0.0,
        volumes: vec![0.0; topology.bodies.len()],
        min_edge: f64::INFINITY,
        min_angle_deg: f64::INFINITY,
        quality: TriangleQuality::default(),
        bounds: [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]],
    };
    for part in parts {
        shape.area += part.area;
        for (body, volume) in part.volumes {
            shape.volumes[body] += volume / 6.0;
        }
        shape.min_edge = shape.min_edge.min(part.min_edge_squared.sqrt());
        shape.min_angle_deg = shape.min_angle_deg.min(part.min_tan_squared.sqrt().atan().to_degrees());
        shape.quality.add(&part.quality);
        for axis in 0..3 {
            shape.bounds[0][axis] = shape.bounds[0][axis].min(part.low[axis]);
            shape.bounds[1][axis] = shape.bounds[1][axis].max(part.high[axis]);
        }
        shape.degenerate.extend(part.degenerate);
    }
    shape.quality = shape.quality.shared();
    let count = shape.degenerate.len() as u64;
    let places = few(&shape.degenerate, |&t| surface.place_of_triangles(&[t]));
    failures.add(FailureKind::DegenerateTriangles, count, format!("{count} triangles have no area"), places);
    shape
}

fn part<C: Coordinate>(
    surface: &Surface<'_, C>,
    topology: &Topology,
    origin: [f64; 3],
    first: usize,
    triangles: &[[u32; 3]],
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
    for (i, t) in triangles.iter().enumerate() {
        let [a, b, c] = t.map(|v| surface.point(v));
        for p in [a, b, c] {
            for (axis, x) in p.into_iter().enumerate() {
                part.low[axis] = part.low[axis].min(x);
                part.high[axis] = part.high[axis].max(x);
            }
        }
        let (u, v, w) = (sub(b, a), sub(c, a), sub(c, b));
        let (uu, vv, ww) = (dot(u, u), dot(v, v), dot(w, w));
        let normal = cross(u, v);
        let nn = dot(normal, normal);
        // Twice the area against the longest edges: far from zero in all but slivers, which are tested exactly.
        if nn <= 1e-20 * uu * vv && Triangle::new([a, b, c]).is_degenerate() {
            part.degenerate.push((first + i) as u32);
        }
        part.area += nn.sqrt() / 2.0;
        let shortest = uu.min(vv).min(ww);
        part.min_edge_squared = part.min_edge_squared.min(shortest);
        // The least angle lies opposite to the shortest edge: between two edges whose product is this cosine part.
        let along = (uu + vv + ww) / 2.0 - shortest;
        let tan_squared = if along > 0.0 { nn / (along * along) } else { 0.0 };
        part.min_tan_squared = part.min_tan_squared.min(tan_squared);
        let ratio_squared = if shortest > 0.0 { uu.max(vv).max(ww) / shortest } else { f64::INFINITY };
        part.quality.count(tan_squared, ratio_squared);
        let six_volumes = dot(sub(a, origin), normal);
        let body = topology.body_of(*t);
        match part.volumes.last_mut() {
            Some((last, sum)) if *last == body => *sum += six_volumes,
            _ => part.volumes.push((body, six_volumes)),
        }
    }
    part
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
