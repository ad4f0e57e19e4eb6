//! Images of points and edges under the bending map, and the edges that are too far from theirs.

use crate::geometry::course::Course;
use crate::model::{Mesh, PatchKind};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// Maximum distance of an edge from its image as a fraction of the local radius of the outer wall.
pub const PART_OF_RADIUS: f64 = 0.01;
/// Angle of the course along an edge above which the edge is split without measuring: the midpoint
/// of such an edge may lie on its image although the rest does not. Radians.
const TURN: f64 = 0.5;
/// Minimum tolerance, µm: a few units in the last place of positions.
const FINE_UM: f64 = 0.02;
/// Number of places at which the radius of the outer wall is stored.
const PLACES: usize = 256;

/// Images of points, metres.
pub(super) fn bent(positions: &[[f32; 3]], course: &Course) -> Vec<[f32; 3]> {
    positions.par_iter().map(|p| place(course, p.map(f64::from)).map(|x| x as f32)).collect()
}

/// Image of a point, metres.
pub(super) fn place(course: &Course, p: [f64; 3]) -> [f64; 3] {
    (course.place(p.map(|x| x * 1e6)) * 1e-6).into()
}

/// Maximum distance of quarter points of an edge from their images, µm, given the images of its
/// ends. Zero across the tube, where the map is rigid.
pub(super) fn off(mesh: &Mesh, course: &Course, (v, w): (u32, u32), image: impl Fn(u32) -> DVec3) -> f64 {
    let [p, q] = [v, w].map(|v| mesh.positions[v as usize].map(f64::from));
    if p[2] == q[2] {
        return 0.0;
    }
    let [from, to] = [image(v), image(w)];
    let at = |part: f64| DVec3::from(place(course, between(p, q, part))).distance(from.lerp(to, part));
    1e6 * [0.5, 0.25, 0.75].map(at).into_iter().fold(0.0, f64::max)
}

pub(super) fn middle(p: [f64; 3], q: [f64; 3]) -> [f64; 3] {
    between(p, q, 0.5)
}

fn between(p: [f64; 3], q: [f64; 3], part: f64) -> [f64; 3] {
    [0, 1, 2].map(|axis| (1.0 - part) * p[axis] + part * q[axis])
}

/// Maximum distances of edges from their images.
pub(super) struct Tolerance {
    /// z of the first place and distance of places, µm.
    from: f64,
    width: f64,
    /// Maximum radius of the outer wall from each place to the next, µm.
    radii: Vec<f64>,
    /// Angle by which the course turns up to each node, and the distance of nodes.
    turned: Vec<f64>,
    node_um: f64,
}

impl Tolerance {
    /// Tolerance for a straight surface, which may lean.
    pub(super) fn of(mesh: &Mesh, course: &Course) -> Self {
        let wall = mesh.patches.iter().filter(|patch| patch.kind == PatchKind::OuterWall);
        let corners = wall.flat_map(|patch| mesh.triangles[patch.triangles.clone()].as_flattened());
        let points: Vec<[f64; 3]> = corners.map(|&v| mesh.positions[v as usize].map(|x| 1e6 * f64::from(x))).collect();
        let end = |pick: fn(f64, f64) -> f64, start: f64| points.iter().map(|p| p[2]).fold(start, pick);
        let [from, to] = [end(f64::min, f64::INFINITY), end(f64::max, f64::NEG_INFINITY)];
        let width = ((to - from) / PLACES as f64).max(f64::MIN_POSITIVE);
        let mut found = Self {
            from,
            width,
            radii: vec![0.0; PLACES],
            turned: course.turned(),
            node_um: course.places()[1] - course.places()[0],
        };
        for [x, y, z] in points {
            let radius = (x * x + y * y).sqrt();
            let at = found.index(z);
            found.radii[at] = radius.max(found.radii[at]);
        }
        fill(&mut found.radii);
        found
    }

    fn index(&self, z_um: f64) -> usize {
        (((z_um - self.from) / self.width) as usize).min(PLACES - 1)
    }

    /// Maximum distance of an edge at this place from its image, µm.
    pub(super) fn at(&self, z_um: f64) -> f64 {
        (PART_OF_RADIUS * self.radii[self.index(z_um)]).max(FINE_UM)
    }

    /// Angle by which the local frames turn from the beginning to a place.
    fn turned(&self, z_um: f64) -> f64 {
        let last = self.turned.len() - 1;
        let at = (z_um / self.node_um).clamp(0.0, last as f64);
        let node = (at as usize).min(last - 1);
        self.turned[node] + (at - node as f64) * (self.turned[node + 1] - self.turned[node])
    }

    /// Edges farther from their image than the tolerance, of all triangles or of the marked ones.
    /// Each edge belongs to two triangles, in which its directions differ.
    pub(super) fn far_edges(
        &self,
        mesh: &Mesh,
        bent: &Mesh,
        course: &Course,
        is_marked: Option<&[bool]>,
    ) -> Vec<(u32, u32)> {
        let triangles = mesh.triangles.par_iter().enumerate();
        let marked = triangles.filter(|(t, _)| is_marked.is_none_or(|is_marked| is_marked[*t]));
        let edges = marked.flat_map_iter(|(_, &[a, b, c])| [(a, b), (b, c), (c, a)]);
        edges.filter(|&(v, w)| v < w && self.is_far(mesh, bent, course, (v, w))).collect()
    }

    fn is_far(&self, mesh: &Mesh, bent: &Mesh, course: &Course, (v, w): (u32, u32)) -> bool {
        let [p, q] = [v, w].map(|v| mesh.positions[v as usize].map(|x| 1e6 * f64::from(x)));
        if p[2] == q[2] {
            return false;
        }
        let turn = (self.turned(p[2]) - self.turned(q[2])).abs();
        let tolerance = self.at(0.5 * (p[2] + q[2]));
        let reach = [p, q].map(|[x, y, _]| (x * x + y * y).sqrt()).into_iter().fold(0.0, f64::max);
        // While the frame turns by an angle, no point of the edge moves farther from a rigid image
        // than the angle times its distance from the end.
        if turn * ((p[2] - q[2]).abs() + 1.5 * reach) <= tolerance {
            return false;
        }
        let image = |v: u32| Vec3::from(bent.positions[v as usize]).as_dvec3();
        turn > TURN || off(mesh, course, (v, w), image) > tolerance
    }
}

/// Gives places without a vertex the smaller one of the radii on both sides.
fn fill(radii: &mut [f64]) {
    let carry = |radii: &mut dyn Iterator<Item = f64>| {
        let mut last = f64::INFINITY;
        let carried = radii.map(|radius| {
            last = if radius > 0.0 { radius } else { last };
            last
        });
        carried.collect::<Vec<f64>>()
    };
    let before = carry(&mut radii.iter().copied());
    let after = carry(&mut radii.iter().rev().copied());
    let both = before.iter().zip(after.iter().rev());
    radii.iter_mut().zip(both).for_each(|(radius, (before, after))| *radius = before.min(*after));
}
