//! Nesting of components. Only closed and oriented surfaces enclose a volume.
//!
//! A component of negative volume is a cavity if it lies in the material of another component;
//! otherwise it is inside out. A component of positive volume must not lie in the material of
//! another, because their common volume would count twice.

use super::surface::{Coordinate, Surface, few};
use super::topology::Topology;
use super::types::{FailureKind, Failures};
use crate::geometry::bvh::{Bounds, Bvh};
use crate::geometry::curve::sort_along_curve;
use crate::geometry::vector::{cross, dot, norm, sub};
use rayon::prelude::*;

/// Tests the volumes of the components. `apart` is true if no triangles intersect.
pub(super) fn examine<C: Coordinate>(
    surface: &Surface<'_, C>,
    topology: &Topology,
    volumes: &[f64],
    apart: bool,
    failures: &mut Failures,
) {
    if !topology.faults.has_volume() {
        return;
    }
    // A single component lies in no other.
    let windings =
        if volumes.len() < 2 { vec![0; volumes.len()] } else { Bodies::of(surface, topology).windings(surface) };
    let place = |body: &usize| surface.place_of_vertex(topology.connectivity.bodies[*body].vertex);
    let of = |wrong: &dyn Fn(f64, i64) -> bool| -> Vec<usize> {
        (0..volumes.len()).filter(|&body| wrong(volumes[body], windings[body])).collect()
    };
    let inverted = of(&|volume, winding| volume == 0.0 || (volume < 0.0 && winding < 1));
    let count = inverted.len() as u64;
    let detail = format!("{count} components enclose no volume or are inside out");
    failures.add(FailureKind::Volume, count, detail, few(&inverted, place));
    // If surfaces intersect, nesting is undefined, and the intersection is reported instead.
    let within = if apart { of(&|volume, winding| volume > 0.0 && winding > 0) } else { Vec::new() };
    let count = within.len() as u64;
    let detail = format!("{count} components lie within the material of others, whose volume so counts twice");
    failures.add(FailureKind::Overlap, count, detail, few(&within, place));
}

/// Components with their triangles and bounding boxes.
struct Bodies {
    /// Triangles of all components, component by component.
    triangles: Vec<[u32; 3]>,
    /// Start of each component in `triangles`, and the end.
    starts: Vec<usize>,
    boxes: Vec<[[f64; 3]; 2]>,
    /// Components along a space-filling curve, and the hierarchy of their boxes in this order.
    order: Vec<u32>,
    hierarchy: Bvh,
    /// One vertex of each component.
    vertices: Vec<u32>,
}

impl Bodies {
    fn of<C: Coordinate>(surface: &Surface<'_, C>, topology: &Topology) -> Self {
        let count = topology.connectivity.bodies.len();
        let vertices = topology.connectivity.bodies.iter().map(|body| body.vertex).collect();
        let body_of = |t: &[u32; 3]| topology.connectivity.body_of(*t);
        let mut triangles = surface.triangles.to_vec();
        triangles.par_sort_by_key(body_of);
        let starts = (0..=count).map(|body| triangles.partition_point(|t| body_of(t) < body)).collect();
        let mut boxes = vec![[[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]]; count];
        for t in surface.triangles {
            let [low, high] = &mut boxes[body_of(t)];
            for p in t.map(|v| surface.point(v)) {
                for axis in 0..3 {
                    low[axis] = low[axis].min(p[axis]);
                    high[axis] = high[axis].max(p[axis]);
                }
            }
        }
        let mut order: Vec<u32> = (0..count as u32).collect();
        sort_along_curve(&mut order, |body| {
            let [low, high] = boxes[body as usize];
            [0, 1, 2].map(|axis| low[axis] / 2.0 + high[axis] / 2.0)
        });
        let hierarchy = Bvh::build(count, |item| Bounds::of(boxes[order[item] as usize]));
        Self { triangles, starts, boxes, order, hierarchy, vertices }
    }

    fn windings<C: Coordinate>(&self, surface: &Surface<'_, C>) -> Vec<i64> {
        (0..self.vertices.len()).into_par_iter().map(|body| self.winding(surface, body)).collect()
    }

    /// Winding number of the other components around a vertex of `body`, from the solid angles of
    /// their triangles (van Oosterom and Strackee, 1983). The winding number outside of a
    /// component's box is 0.
    fn winding<C: Coordinate>(&self, surface: &Surface<'_, C>, body: usize) -> i64 {
        let eye = surface.point(self.vertices[body]);
        let mut angle = 0.0;
        self.hierarchy.overlapping(&Bounds::of([eye]), |item| {
            let other = self.order[item] as usize;
            let [low, high] = &self.boxes[other];
            if other != body && (0..3).all(|axis| low[axis] <= eye[axis] && eye[axis] <= high[axis]) {
                angle += self.angle(surface, other, eye);
            }
        });
        (angle / (4.0 * std::f64::consts::PI)).round() as i64
    }

    /// Solid angle of `body` seen from `eye`.
    fn angle<C: Coordinate>(&self, surface: &Surface<'_, C>, body: usize, eye: [f64; 3]) -> f64 {
        let of = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| sub(surface.point(v), eye));
            let (la, lb, lc) = (norm(a), norm(b), norm(c));
            2.0 * f64::atan2(dot(a, cross(b, c)), la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb)
        };
        self.triangles[self.starts[body]..self.starts[body + 1]].iter().map(of).sum()
    }
}
