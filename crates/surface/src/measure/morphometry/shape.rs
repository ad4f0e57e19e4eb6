//! Contours of a section, and its base ellipse.

use crate::geometry::polygon::signed_area;
use crate::geometry::predicates::widen2;
use crate::geometry::vector::{cross2, distance, norm, sub};
use crate::model::Section;
use std::f64::consts::{PI, TAU};

type P2 = [f64; 2];

/// Contours of a section, µm: the tissue is inside `outer` and outside of the lumen.
///
/// All contours are simple and do not intersect. Contours of the lumen lie within `outer` and are
/// counter-clockwise. Contours of islands in the lumen are clockwise, so the lumen is always to the
/// left.
#[derive(Clone, Debug)]
pub struct Shape<'a> {
    /// Outer contour of the tissue, counter-clockwise.
    pub outer: &'a [[f32; 2]],
    /// Boundary of the lumen.
    pub lumen: Vec<&'a [[f32; 2]]>,
}

impl<'a> From<&'a Section> for Shape<'a> {
    fn from(section: &'a Section) -> Self {
        Self { outer: &section.outer.points, lumen: vec![&section.inner.points] }
    }
}

impl Shape<'_> {
    /// Area of the lumen, µm².
    pub(super) fn lumen_area(&self) -> f64 {
        self.lumen.iter().map(|ring| signed_area(ring)).sum()
    }

    /// Area within the outer contour, µm².
    pub(super) fn outer_area(&self) -> f64 {
        signed_area(self.outer)
    }

    pub(super) fn islands(&self) -> u32 {
        self.lumen.iter().filter(|ring| signed_area(ring) < 0.0).count() as u32
    }

    /// True if a point lies in the lumen.
    pub(super) fn has_in_lumen(&self, [x, y]: P2) -> bool {
        let crosses =
            |([ax, ay], [bx, by]): (P2, P2)| (ay > y) != (by > y) && x < ax + (y - ay) / (by - ay) * (bx - ax);
        self.lumen.iter().flat_map(|ring| edges(ring)).filter(|&edge| crosses(edge)).count() % 2 == 1
    }

    /// Length of the boundary of the lumen, µm.
    pub(super) fn perimeter(&self) -> f64 {
        let length = |ring: &&[[f32; 2]]| -> f64 { edges(ring).map(|(a, b)| distance(a, b)).sum() };
        self.lumen.iter().map(length).sum()
    }

    /// Returns a function that tells whether a contour lies within the base ellipse.
    pub(in crate::measure) fn within_base(&self) -> impl Fn(&[[f32; 2]]) -> bool + use<> {
        let base = self.base_ellipse();
        move |contour| contour.iter().all(|&p| base.radius(p) <= base.semi_major)
    }

    /// Smallest ellipse around the lumen with the centre, axes and axis ratio of the outer contour.
    pub(super) fn base_ellipse(&self) -> Ellipse {
        let unit = Ellipse::of_moments(self.outer);
        let radius = self.lumen.iter().copied().flatten().map(|&p| unit.radius(p)).fold(0.0, f64::max);
        Ellipse { semi_major: radius, ..unit }
    }
}

/// Edges of a closed contour.
pub(in crate::measure) fn edges(ring: &[[f32; 2]]) -> impl Iterator<Item = (P2, P2)> {
    let ends = ring.iter().cycle().skip(1);
    ring.iter().zip(ends).map(|(&a, &b)| (widen2(a), widen2(b)))
}

/// An ellipse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Ellipse {
    pub(super) centre: P2,
    /// Direction of the major axis.
    axis: P2,
    /// Ratio of the minor to the major axis.
    pub(super) ratio: f64,
    pub(super) semi_major: f64,
}

impl Ellipse {
    /// Ellipse with the second moments of the area within a contour and a semi-major axis of 1.
    fn of_moments(ring: &[[f32; 2]]) -> Self {
        let origin = ring.first().map_or([0.0; 2], |&p| widen2(p));
        let (mut area, mut first, mut second) = (0.0, [0.0; 2], [0.0; 3]);
        for (a, b) in edges(ring) {
            let [a, b] = [a, b].map(|p| sub(p, origin));
            let cross = cross2(a, b);
            area += cross / 2.0;
            for k in 0..2 {
                first[k] += cross * (a[k] + b[k]) / 6.0;
                second[k] += cross * (a[k] * a[k] + a[k] * b[k] + b[k] * b[k]) / 12.0;
            }
            second[2] += cross * (2.0 * a[0] * a[1] + a[0] * b[1] + b[0] * a[1] + 2.0 * b[0] * b[1]) / 24.0;
        }
        if area <= 0.0 {
            return Self { centre: origin, axis: [1.0, 0.0], ratio: 1.0, semi_major: 1.0 };
        }
        let mean = first.map(|m| m / area);
        let xx = second[0] / area - mean[0] * mean[0];
        let yy = second[1] / area - mean[1] * mean[1];
        let xy = second[2] / area - mean[0] * mean[1];
        let (middle, half) = ((xx + yy) / 2.0, ((xx - yy) / 2.0).hypot(xy));
        let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
        let ratio = ((middle - half) / (middle + half)).max(0.0).sqrt().max(1e-3);
        Self {
            centre: [origin[0] + mean[0], origin[1] + mean[1]],
            axis: [angle.cos(), angle.sin()],
            ratio,
            semi_major: 1.0,
        }
    }

    /// Elliptic radius of a point: semi-major axis of the ellipse through the point with this
    /// centre, axes and ratio.
    #[inline]
    pub(super) fn radius(&self, point: [f32; 2]) -> f64 {
        norm(self.flattened(point))
    }

    /// Image of a point in the plane in which the ellipse is a circle around the origin.
    #[inline]
    pub(super) fn flattened(&self, point: [f32; 2]) -> P2 {
        let [x, y] = sub(widen2(point), self.centre);
        let [c, s] = self.axis;
        [x * c + y * s, (y * c - x * s) / self.ratio]
    }

    /// Mean of both diameters.
    pub(super) fn mean_diameter(&self) -> f64 {
        self.semi_major * (1.0 + self.ratio)
    }

    /// Range of x in which the line of constant `y` has an elliptic radius of at most `reach`.
    pub(super) fn chord(&self, y: f64, reach: f64) -> Option<[f64; 2]> {
        let [c, s] = self.axis;
        // Squared elliptic radius of (centre.x + t, y) as a polynomial a·t² + 2·b·t + d.
        let (y, square) = (y - self.centre[1], self.ratio * self.ratio);
        let (a, b, d) = (c * c + s * s / square, y * s * c * (1.0 - 1.0 / square), y * y * (s * s + c * c / square));
        let root = (b * b - a * (d - reach * reach)).sqrt();
        (root >= 0.0).then(|| [-b - root, -b + root].map(|t| self.centre[0] + t / a))
    }

    pub(super) fn area(&self) -> f64 {
        PI * self.semi_major * self.semi_major * self.ratio
    }

    /// Circumference by the arithmetic–geometric mean, exact to rounding.
    pub(super) fn circumference(&self) -> f64 {
        let (mut a, mut b) = (1.0, self.ratio);
        let (mut sum, mut power) = (0.5 * (a * a + b * b), 0.5);
        for _ in 0..32 {
            let (mean, c) = ((a + b) / 2.0, (a - b) / 2.0);
            b = (a * b).sqrt();
            a = mean;
            power *= 2.0;
            sum -= power * c * c;
            if c < 1e-17 {
                break;
            }
        }
        TAU * self.semi_major * sum / a
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ellipse(a: f32, b: f32, turn: f32) -> Vec<[f32; 2]> {
        (0..720)
            .map(|i| {
                let t = std::f32::consts::TAU * i as f32 / 720.0;
                let (x, y) = (a * t.cos(), b * t.sin());
                [70.0 + x * turn.cos() - y * turn.sin(), -20.0 + x * turn.sin() + y * turn.cos()]
            })
            .collect()
    }

    #[test]
    fn an_ellipse_is_its_own() {
        let points = ellipse(900.0, 600.0, 0.4);
        let shape = Shape { outer: &points, lumen: vec![&points] };
        let base = shape.base_ellipse();
        assert!((base.semi_major - 900.0).abs() < 0.2, "{base:?}");
        assert!((base.ratio - 2.0 / 3.0).abs() < 1e-4, "{base:?}");
        assert!((base.centre[0] - 70.0).abs() < 1e-2 && (base.centre[1] + 20.0).abs() < 1e-2, "{base:?}");
        assert!((shape.perimeter() / base.circumference() - 1.0).abs() < 2e-4);
        assert!((shape.lumen_area() / base.area() - 1.0).abs() < 2e-4);
    }

    #[test]
    fn ends_of_chords_lie_on_the_ellipse() {
        let base = Ellipse { centre: [5.0, -3.0], axis: [0.8, 0.6], ratio: 0.5, semi_major: 1.0 };
        for y in [-4.0, -3.0, -1.5] {
            for x in base.chord(y, 3.0).unwrap() {
                assert!((base.radius([x, y].map(|c| c as f32)) - 3.0).abs() < 1e-5, "{x} {y}");
            }
        }
        assert_eq!(base.chord(1.0, 3.0), None);
    }

    #[test]
    fn circumferences() {
        let ellipse = |semi_major, ratio| Ellipse { centre: [0.0; 2], axis: [1.0, 0.0], ratio, semi_major };
        assert!((ellipse(2.0, 1.0).circumference() - 2.0 * TAU).abs() < 1e-12);
        // Complete elliptic integral of the second kind for k² = 3/4.
        assert!((ellipse(1.0, 0.5).circumference() - 4.0 * 1.211_056_027_568_459_5).abs() < 1e-12);
    }
}
