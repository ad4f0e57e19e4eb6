//! Lines with their arc length, and their distance from points.

use crate::geometry::vector::distance;
use crate::model::Border;

/// An edge of a contour.
#[derive(Clone, Copy, Debug)]
pub(super) struct Edge {
    pub(super) from: [f64; 2],
    pub(super) to: [f64; 2],
    /// Vector from start to end divided by the squared length; zero for an edge of length 0.
    per_square_length: [f64; 2],
    /// Arc length of the contour at the start of the edge.
    start: f64,
    length: f64,
}

impl Edge {
    /// Creates an edge whose start has the arc length `start`.
    pub(super) fn new(from: [f64; 2], to: [f64; 2], start: f64) -> Self {
        let along = [to[0] - from[0], to[1] - from[1]];
        let square = along[0] * along[0] + along[1] * along[1];
        let per_square_length = if square > 0.0 { along.map(|c| c / square) } else { [0.0; 2] };
        Self { from, to, per_square_length, start, length: square.sqrt() }
    }

    /// Squared distance of a point from the edge, and the arc length of the nearest point.
    pub(super) fn nearest(&self, p: [f64; 2]) -> (f64, f64) {
        let (dx, dy) = (p[0] - self.from[0], p[1] - self.from[1]);
        let t = (dx * self.per_square_length[0] + dy * self.per_square_length[1]).clamp(0.0, 1.0);
        let (rx, ry) = (dx - t * (self.to[0] - self.from[0]), dy - t * (self.to[1] - self.from[1]));
        (rx * rx + ry * ry, self.start + t * self.length)
    }

    /// Point of the edge that is nearest to a point.
    pub(super) fn nearest_point(&self, p: [f64; 2]) -> [f64; 2] {
        let (dx, dy) = (p[0] - self.from[0], p[1] - self.from[1]);
        let t = (dx * self.per_square_length[0] + dy * self.per_square_length[1]).clamp(0.0, 1.0);
        [0, 1].map(|axis| self.from[axis] + t * (self.to[axis] - self.from[axis]))
    }
}

const EDGES_PER_GROUP: usize = 16;

/// A circle that encloses a group of edges.
#[derive(Clone, Copy, Debug)]
struct Circle {
    middle: [f64; 2],
    radius: f64,
}

/// Lines of a border, without points that are not finite.
#[derive(Clone, Debug)]
pub struct Contour {
    pub(super) edges: Vec<Edge>,
    groups: Vec<Circle>,
    length: f64,
}

impl Contour {
    /// Copies the lines of a border. Arc lengths continue from each line to the next.
    #[must_use]
    pub fn new(border: &Border) -> Self {
        let (mut edges, mut length) = (Vec::new(), 0.0);
        for line in &border.lines {
            let finite: Vec<[f64; 2]> =
                line.points.iter().filter(|p| p.iter().all(|c| c.is_finite())).map(|p| p.map(f64::from)).collect();
            let count = if line.is_closed { finite.len() } else { finite.len().saturating_sub(1) };
            edges.extend((0..count).map(|i| {
                let edge = Edge::new(finite[i], finite[(i + 1) % finite.len()], length);
                length += edge.length;
                edge
            }));
        }
        let groups = edges.chunks(EDGES_PER_GROUP).map(enclosing_circle).collect();
        Self { edges, groups, length }
    }

    /// Length of all lines, µm.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.length
    }

    /// Point at an arc length, modulo the total length.
    #[must_use]
    #[inline]
    pub fn at(&self, along: f64) -> [f64; 2] {
        if self.length <= 0.0 {
            return self.edges.first().map_or([0.0; 2], |edge| edge.from);
        }
        let along = along.rem_euclid(self.length);
        let after = self.edges.partition_point(|edge| edge.start <= along);
        let edge = &self.edges[after.saturating_sub(1)];
        let t = if edge.length > 0.0 { ((along - edge.start) / edge.length).clamp(0.0, 1.0) } else { 0.0 };
        [0, 1].map(|axis| edge.from[axis] + t * (edge.to[axis] - edge.from[axis]))
    }

    /// Mean of the middles of all edges, weighted by their length.
    pub(super) fn centre(&self) -> [f64; 2] {
        let sum = |axis: usize| -> f64 {
            self.edges.iter().map(|edge| edge.length * 0.5 * (edge.from[axis] + edge.to[axis])).sum()
        };
        let length = if self.length > 0.0 { self.length } else { 1.0 };
        [sum(0) / length, sum(1) / length]
    }

    /// Last point at which a ray meets the lines. `None` if it does not meet them.
    pub(super) fn farthest(&self, from: [f64; 2], along: [f64; 2]) -> Option<[f64; 2]> {
        let side = |p: [f64; 2]| along[0] * (p[1] - from[1]) - along[1] * (p[0] - from[0]);
        let far = |p: [f64; 2]| along[0] * (p[0] - from[0]) + along[1] * (p[1] - from[1]);
        let meet = |edge: &Edge| {
            let (a, b) = (side(edge.from), side(edge.to));
            let at = |t: f64| far(edge.from) + t * (far(edge.to) - far(edge.from));
            ((a < 0.0) != (b < 0.0)).then(|| at(a / (a - b))).filter(|far| *far > 0.0)
        };
        let far = self.edges.iter().filter_map(meet).fold(0.0, f64::max);
        (far > 0.0).then(|| [from[0] + far * along[0], from[1] + far * along[1]])
    }

    /// Distance of a point from the nearest line; infinite if there are no points.
    #[must_use]
    pub fn distance(&self, p: [f64; 2]) -> f64 {
        let middle = |circle: &Circle| distance(p, circle.middle);
        let mut best = f64::INFINITY;
        for circle in &self.groups {
            best = best.min(middle(circle) + circle.radius);
        }
        let mut square = f64::INFINITY;
        for (circle, edges) in self.groups.iter().zip(self.edges.chunks(EDGES_PER_GROUP)) {
            if middle(circle) - circle.radius <= best {
                square = edges.iter().fold(square, |least, edge| least.min(edge.nearest(p).0));
                best = best.min(square.sqrt());
            }
        }
        square.sqrt()
    }

    /// Distance of a point from the nearest line if it is greater than `least`. Fast if it is not.
    #[must_use]
    pub fn distance_beyond(&self, p: [f64; 2], least: f64) -> Option<f64> {
        let is_near = |(circle, edges): (&Circle, &[Edge])| {
            distance(p, circle.middle) - circle.radius <= least
                && edges.iter().any(|edge| edge.nearest(p).0 <= least * least)
        };
        let is_any_near = self.groups.iter().zip(self.edges.chunks(EDGES_PER_GROUP)).any(is_near);
        (!is_any_near).then(|| self.distance(p)).filter(|distance| *distance > least)
    }

    /// Writes into `found` all edges that can be nearest to any point of a circle.
    pub(super) fn near(&self, middle: [f64; 2], radius: f64, found: &mut Vec<Edge>) {
        let reach = self.distance(middle) + 2.0 * radius;
        found.clear();
        for (circle, edges) in self.groups.iter().zip(self.edges.chunks(EDGES_PER_GROUP)) {
            if distance(middle, circle.middle) - circle.radius <= reach {
                found.extend(edges.iter().filter(|edge| edge.nearest(middle).0 <= reach * reach));
            }
        }
    }
}

fn enclosing_circle(edges: &[Edge]) -> Circle {
    let count = (2 * edges.len()).max(1) as f64;
    let middle = [0, 1].map(|axis| edges.iter().map(|edge| edge.from[axis] + edge.to[axis]).sum::<f64>() / count);
    let reach = |edge: &Edge| distance(edge.from, middle).max(distance(edge.to, middle));
    let radius = edges.iter().map(reach).fold(0.0, f64::max);
    Circle { middle, radius }
}
