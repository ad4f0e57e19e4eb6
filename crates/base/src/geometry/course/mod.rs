//! The course of a tube: a centre line with a local frame at each place, and the map that bends a
//! straight tube along it.
//!
//! The centre line is a cubic spline, parameterized by arc length, through nodes at equal
//! distances. Its curvature is continuous. The local frames minimise rotation (double reflection;
//! Wang, Jüttler, Zheng and Liu, *Computation of rotation minimizing frames*, ACM TOG 27(1), 2008)
//! and are then turned by a uniform twist. The map is injective where [`Course::room`] finds room
//! for the tube.

mod integrate;
mod relax;
mod room;
mod shapes;
mod spline;
#[cfg(test)]
mod tests;

pub use relax::Relaxation;
pub use room::{Bend, Near, Room};
pub use shapes::{RandomCourse, Turn};

use crate::model::Plane;
use glam::{DQuat, DVec3};
use spline::Spline;

/// Minimum distance of [`Course::plane_across`] from the ends of the model. A cap is planar only up
/// to rounding, so a plane nearer to it could cut it into fragments.
const FROM_ENDS_UM: f64 = 0.05;

/// A centre line with local frames. All lengths are in one unit, which the caller chooses.
#[derive(Clone, Debug, PartialEq)]
pub struct Course {
    length: f64,
    /// Centre line by arc length. The knots are the nodes.
    line: Spline,
    /// First vector of the local frame at each node.
    untwisted_u: Vec<DVec3>,
    /// Turn of the last frame about the centre line, radians.
    twist: f64,
}

/// Local frame of a course at one place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Point of the centre line.
    pub origin: DVec3,
    /// Image of the x direction of the straight tube.
    pub u: DVec3,
    /// Image of the y direction.
    pub v: DVec3,
    /// Image of the z direction: the direction of the centre line.
    pub tangent: DVec3,
}

impl Frame {
    /// Image of the point (x, y) of the section at this place.
    #[must_use]
    pub fn place(&self, x: f64, y: f64) -> DVec3 {
        self.origin + self.u * x + self.v * y
    }
}

impl Course {
    /// Course through points, scaled about the first point to `length`. `None` if two consecutive
    /// points are equal, or if there are fewer than two.
    #[must_use]
    pub fn through(points: &[DVec3], length: f64, nodes: usize, twist: f64) -> Option<Self> {
        let is_curve = points.len() >= 2 && points.windows(2).all(|pair| pair[0].distance(pair[1]) > 0.0);
        if !is_curve {
            return None;
        }
        let curve = Spline::by_chords(points);
        let (found, own) = equidistant(&curve, nodes);
        let scale = length / own;
        Some(Self::through_nodes(found.iter().map(|p| points[0] + (*p - points[0]) * scale).collect(), length, twist))
    }

    /// Straight course along z from the origin.
    #[must_use]
    pub fn straight(length: f64) -> Self {
        Self::through_nodes(vec![DVec3::ZERO, DVec3::Z * length], length, 0.0)
    }

    /// Course from the origin with these unit tangents, turned so that it begins along z. The
    /// argument of `direction` is the fraction of the length.
    fn along(direction: impl Fn(f64) -> DVec3, length: f64, nodes: usize, twist: f64) -> Self {
        let begin = DQuat::from_rotation_arc(direction(0.0), DVec3::Z);
        let step = 1.0 / nodes as f64;
        let mut at = DVec3::ZERO;
        let rest = (0..nodes).map(|i| {
            let middle = (i as f64 + 0.5) * step;
            let sum: DVec3 = GAUSS.iter().map(|&[x, w]| direction(middle + 0.5 * step * x) * w).sum();
            at += begin * sum * (0.5 * step * length);
            at
        });
        let points = std::iter::once(DVec3::ZERO).chain(rest).collect();
        Self::through_nodes(points, length, twist)
    }

    /// Course through points at equal distances along the curve.
    fn through_nodes(points: Vec<DVec3>, length: f64, twist: f64) -> Self {
        let last = points.len() - 1;
        let line = Spline::new((0..=last).map(|i| length * i as f64 / last as f64).collect(), points);
        let mut untwisted_u = Vec::with_capacity(last + 1);
        let ahead = |i: usize| (line.points()[i], line.at(line.knots()[i]).first.normalize());
        let (mut at, mut tangent) = ahead(0);
        let mut u = turn_from_z(tangent) * DVec3::X;
        untwisted_u.push(u);
        for i in 1..=last {
            let (next_at, next_tangent) = ahead(i);
            let reflected = reflect(u, next_at - at);
            u = reflect(reflected, next_tangent - reflect(tangent, next_at - at));
            u = (u - next_tangent * u.dot(next_tangent)).normalize();
            untwisted_u.push(u);
            (at, tangent) = (next_at, next_tangent);
        }
        Self { length, line, untwisted_u, twist }
    }

    /// Arc length of the centre line.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.length
    }

    /// Turn of the last frame about the centre line, radians.
    #[must_use]
    pub fn twist(&self) -> f64 {
        self.twist
    }

    /// Places of the nodes. The curvature is approximately linear between nodes, so its maximum is
    /// at a node.
    #[must_use]
    pub fn places(&self) -> &[f64] {
        self.line.knots()
    }

    /// Local frame at a place. Beyond the ends, the first and the last span of the spline are
    /// extrapolated.
    #[must_use]
    pub fn at(&self, place: f64) -> Frame {
        let (tangent, u) = self.untwisted(place);
        let v = tangent.cross(u);
        let (sin, cos) = libm::sincos(self.twist * place / self.length);
        Frame { origin: self.line.at(place).position, u: u * cos + v * sin, v: v * cos - u * sin, tangent }
    }

    /// Tangent and first vector of the rotation-minimising frame, before the twist.
    fn untwisted(&self, place: f64) -> (DVec3, DVec3) {
        let tangent = self.line.at(place).first.normalize();
        let (i, t) = self.line.span(place);
        let u = self.untwisted_u[i] * (1.0 - t) + self.untwisted_u[i + 1] * t;
        (tangent, (u - tangent * u.dot(tangent)).normalize())
    }

    /// Image of a point of the straight tube.
    #[must_use]
    pub fn place(&self, [x, y, z]: [f64; 3]) -> DVec3 {
        self.at(z).place(x, y)
    }

    /// Plane across a tube that follows this course, all lengths in µm. The coordinates u and v of
    /// the plane are x and y of the section. `ends_um` are the places of both ends of the model,
    /// `reach_um` bounds the distance of the outer wall from the course. `None` if `place_um` is
    /// outside `ends_um`.
    #[must_use]
    pub fn plane_across(&self, place_um: f64, ends_um: [f64; 2], reach_um: f64) -> Option<Plane> {
        let [first, last] = ends_um;
        let place = place_um.clamp(first + FROM_ENDS_UM, last - FROM_ENDS_UM);
        let Frame { origin, u, v, tangent } = self.at(place);
        (first..=last).contains(&place_um).then(|| Plane {
            origin_um: origin.into(),
            normal: tangent.into(),
            u: u.into(),
            v: v.into(),
            reach_um: Some(reach_um),
        })
    }

    /// Curvature at a place.
    #[must_use]
    pub fn curvature(&self, place: f64) -> f64 {
        let jet = self.line.at(place);
        jet.first.cross(jet.second).length() / jet.first.length().powi(3)
    }

    /// Angle by which the local frames turn from the beginning up to each node, radians: the
    /// integral of the curvature and of the twist.
    #[must_use]
    pub fn turned(&self) -> Vec<f64> {
        let places = self.places();
        let twist = self.twist.abs() / self.length;
        let rates: Vec<f64> = places.iter().map(|&at| self.curvature(at) + twist).collect();
        let mut sum = 0.0;
        let rest = places.windows(2).zip(rates.windows(2)).map(|(place, rate)| {
            sum += 0.5 * (rate[0] + rate[1]) * (place[1] - place[0]);
            sum
        });
        std::iter::once(0.0).chain(rest).collect()
    }

    /// Distance between the two ends.
    #[must_use]
    pub fn end_distance(&self) -> f64 {
        let points = self.line.points();
        points[0].distance(points[points.len() - 1])
    }

    /// Length divided by the distance between the ends.
    #[must_use]
    pub fn tortuosity(&self) -> f64 {
        self.length / self.end_distance()
    }

    /// Maximum absolute coordinate of the centre line.
    #[must_use]
    pub fn extent(&self) -> f64 {
        self.line.points().iter().map(|p| p.abs().max_element()).fold(0.0, f64::max)
    }
}

/// Abscissas and weights of a Gauss quadrature that is exact for polynomials of degree 5.
const GAUSS: [[f64; 2]; 3] =
    [[-0.774_596_669_241_483_4, 5.0 / 9.0], [0.0, 8.0 / 9.0], [0.774_596_669_241_483_4, 5.0 / 9.0]];

/// Spans of the arc length table per node.
const PIECES_PER_NODE: usize = 4;

/// Points of a curve at equal arc lengths, and the length of the curve.
fn equidistant(curve: &Spline, nodes: usize) -> (Vec<DVec3>, f64) {
    let knots = curve.knots();
    let pieces = (PIECES_PER_NODE * nodes).div_ceil(knots.len() - 1);
    let cuts: Vec<f64> = knots
        .windows(2)
        .flat_map(|pair| (0..pieces).map(move |k| pair[0] + (pair[1] - pair[0]) * k as f64 / pieces as f64))
        .chain(knots.last().copied())
        .collect();
    let length = |from: f64, to: f64| -> f64 {
        let half = 0.5 * (to - from);
        GAUSS.iter().map(|&[x, w]| half * w * curve.at(from + half * (1.0 + x)).first.length()).sum()
    };
    let mut sums = vec![0.0];
    for pair in cuts.windows(2) {
        sums.push(sums[sums.len() - 1] + length(pair[0], pair[1]));
    }
    let whole = sums[sums.len() - 1];
    let at = |node: usize| {
        if node == nodes {
            return curve.points()[curve.points().len() - 1];
        }
        let wanted = whole * node as f64 / nodes as f64;
        let k = sums.partition_point(|&sum| sum <= wanted).clamp(1, cuts.len() - 1) - 1;
        let mut t = cuts[k] + (cuts[k + 1] - cuts[k]) * (wanted - sums[k]) / (sums[k + 1] - sums[k]);
        for _ in 0..3 {
            t -= (sums[k] + length(cuts[k], t) - wanted) / curve.at(t).first.length().max(f64::MIN_POSITIVE);
            t = t.clamp(cuts[k], cuts[k + 1]);
        }
        curve.at(t).position
    };
    ((0..=nodes).map(at).collect(), whole)
}

/// Shortest rotation from the z axis to a unit vector.
fn turn_from_z(to: DVec3) -> DQuat {
    DQuat::from_rotation_arc(DVec3::Z, to)
}

/// Reflects a vector in the plane perpendicular to `normal`, which may have any length.
fn reflect(v: DVec3, normal: DVec3) -> DVec3 {
    let square = normal.length_squared();
    if square > 0.0 { v - normal * (2.0 * normal.dot(v) / square) } else { v }
}
