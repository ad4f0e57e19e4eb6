//! Which component lies within which. A component of negative volume is a cavity if it lies within the material of another
//! body, else it is inside out; one of positive volume must not lie within the material of another, as the common volume
//! would be counted twice. Only surfaces that are closed and oriented enclose a volume.

use super::surface::{Coordinate, Surface, few};
use super::topology::Topology;
use super::types::{FailureKind, Failures};
use crate::geometry::bvh::{Bounds, Bvh, morton};
use rayon::prelude::*;

/// Examines the volumes of the components; `apart` states that no triangles meet.
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
    let bodies = Bodies::of(surface, topology);
    let windings: Vec<i64> = (0..volumes.len()).into_par_iter().map(|body| bodies.winding(surface, body)).collect();
    let place = |body: &usize| surface.place_of_vertex(topology.connectivity.bodies[*body].vertex);
    let of = |wrong: &dyn Fn(f64, i64) -> bool| -> Vec<usize> {
        (0..volumes.len()).filter(|&body| wrong(volumes[body], windings[body])).collect()
    };
    let inverted = of(&|volume, winding| volume == 0.0 || (volume < 0.0 && winding < 1));
    let count = inverted.len() as u64;
    let detail = format!("{count} components enclose no volume or are inside out");
    failures.add(FailureKind::Volume, count, detail, few(&inverted, place));
    // If surfaces cross, nesting is undefined, and the crossing is reported instead.
    let within = if apart { of(&|volume, winding| volume > 0.0 && winding > 0) } else { Vec::new() };
    let count = within.len() as u64;
    let detail = format!("{count} components lie within the material of others, whose volume so counts twice");
    failures.add(FailureKind::Overlap, count, detail, few(&within, place));
}

/// The components with their triangles and boxes.
struct Bodies {
    /// Triangles of all components, one after the other.
    triangles: Vec<[u32; 3]>,
    /// Where those of each component begin; one more entry than components.
    starts: Vec<usize>,
    boxes: Vec<[[f64; 3]; 2]>,
    /// Components along a space-filling curve, and the hierarchy of their boxes in this order; none for a single one.
    order: Vec<usize>,
    hierarchy: Option<Bvh>,
    /// A vertex of each.
    vertices: Vec<u32>,
}

impl Bodies {
    fn of<C: Coordinate>(surface: &Surface<'_, C>, topology: &Topology) -> Self {
        let count = topology.connectivity.bodies.len();
        let vertices = topology.connectivity.bodies.iter().map(|body| body.vertex).collect();
        let mut bodies = Self {
            triangles: Vec::new(),
            starts: Vec::new(),
            boxes: Vec::new(),
            order: (0..count).collect(),
            hierarchy: None,
            vertices,
        };
        // A single component lies within no other.
        if count < 2 {
            return bodies;
        }
        bodies.starts = vec![0; count + 1];
        for &t in surface.triangles {
            bodies.starts[topology.connectivity.body_of(t) + 1] += 1;
        }
        for body in 0..count {
            bodies.starts[body + 1] += bodies.starts[body];
        }
        bodies.triangles = vec![[0; 3]; surface.triangles.len()];
        bodies.boxes = vec![[[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]]; count];
        let mut next = bodies.starts.clone();
        for &t in surface.triangles {
            let body = topology.connectivity.body_of(t);
            bodies.triangles[next[body]] = t;
            next[body] += 1;
            let [low, high] = &mut bodies.boxes[body];
            for p in t.map(|v| surface.point(v)) {
                for axis in 0..3 {
                    low[axis] = low[axis].min(p[axis]);
                    high[axis] = high[axis].max(p[axis]);
                }
            }
        }
        bodies.arrange();
        bodies
    }

    /// Builds the hierarchy of the boxes.
    fn arrange(&mut self) {
        let boxes = &self.boxes;
        let mut whole = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
        for [low, high] in boxes {
            for axis in 0..3 {
                whole[0][axis] = whole[0][axis].min(low[axis]);
                whole[1][axis] = whole[1][axis].max(high[axis]);
            }
        }
        let size = (0..3).map(|axis| whole[1][axis] - whole[0][axis]).fold(f64::MIN_POSITIVE, f64::max);
        let [corner, _] = whole;
        self.order.par_sort_by_cached_key(|&body| {
            let [low, high] = boxes[body];
            let fraction = |axis: usize| ((low[axis] / 2.0 + high[axis] / 2.0 - corner[axis]) / size) as f32;
            (morton([0, 1, 2].map(fraction)), body)
        });
        self.hierarchy = Some(Bvh::build(self.order.len(), |item| Bounds::of(boxes[self.order[item]])));
    }

    /// How often the others wind around a vertex of `body`, from the solid angles of their triangles (van Oosterom and
    /// Strackee, 1983). A component does not wind around a point outside of its box.
    fn winding<C: Coordinate>(&self, surface: &Surface<'_, C>, body: usize) -> i64 {
        let Some(hierarchy) = &self.hierarchy else { return 0 };
        let eye = surface.point(self.vertices[body]);
        let mut angle = 0.0;
        hierarchy.overlapping(&Bounds::of([eye]), |item| {
            let other = self.order[item];
            let [low, high] = &self.boxes[other];
            if other != body && (0..3).all(|axis| low[axis] <= eye[axis] && eye[axis] <= high[axis]) {
                angle += self.angle(surface, other, eye);
            }
        });
        (angle / (4.0 * std::f64::consts::PI)).round() as i64
    }

    /// The solid angle of `body` seen from `eye`.
    fn angle<C: Coordinate>(&self, surface: &Surface<'_, C>, body: usize, eye: [f64; 3]) -> f64 {
        let of = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| {
                let p = surface.point(v);
                [p[0] - eye[0], p[1] - eye[1], p[2] - eye[2]]
            });
            let dot = |p: [f64; 3], q: [f64; 3]| p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
            let volume = a[0] * (b[1] * c[2] - b[2] * c[1])
                + a[1] * (b[2] * c[0] - b[0] * c[2])
                + a[2] * (b[0] * c[1] - b[1] * c[0]);
            let (la, lb, lc) = (dot(a, a).sqrt(), dot(b, b).sqrt(), dot(c, c).sqrt());
            2.0 * f64::atan2(volume, la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb)
        };
        self.triangles[self.starts[body]..self.starts[body + 1]].iter().map(of).sum()
    }
}
