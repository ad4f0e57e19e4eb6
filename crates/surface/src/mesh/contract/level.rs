//! A section of the lofted surface, and how far its mucosa can thicken into the lumen.
//!
//! A point of the inner contour moves along its normal, by less than the radius of the largest disc
//! in the lumen that touches the contour there. The paths from the points to the centres of their
//! discs do not cross, because they are the cuts to the medial axis of the contour. A contour whose
//! points move along a part of these paths therefore does not intersect itself.

use super::wave::Station;
use crate::geometry::blocks::{Blocks, Rect};
use crate::geometry::vector::{cross2, distance, dot, norm, sub};

pub(super) type Point = [f64; 2];

/// Maximum motion of a point as a fraction of the radius of its disc.
const SHARE: f64 = 0.8;
/// Maximum change of that motion along the contour, per length.
const SLOPE: f64 = 0.5;
/// Initial search radius for discs, µm, and its factor per step.
const REACH: [f64; 2] = [32.0, 4.0];
/// Maximum radius of discs, µm.
const MOST: f64 = 1e5;
/// Minimum fraction of the lumen that stays free in addition to what the discs need.
const SPARE: f64 = 0.02;
/// Number of halvings in a bisection.
const HALVINGS: u32 = 40;

/// A section.
pub(super) struct Level {
    /// Vertices of the inner contour, counter-clockwise, and their positions, µm.
    pub(super) inner: Vec<u32>,
    pub(super) points: Vec<Point>,
    /// Unit normals towards the lumen.
    normals: Vec<Point>,
    /// Maximum motion of each point, µm.
    pub(super) most: Vec<f64>,
    /// Vertices of the outer contour.
    pub(super) outer: Vec<u32>,
    pub(super) lumen_um2: f64,
    pub(super) whole_um2: f64,
}

/// Effect of a contraction on a section.
#[derive(Clone, Copy, Debug)]
pub(super) struct ContractedShape {
    /// Factor on the outer contour.
    pub(super) outer: f64,
    /// Factor on the inner contour. Before that, its points move by `depth`, µm.
    pub(super) inner: f64,
    pub(super) depth: f64,
    /// Length along the tube relative to the length at rest.
    pub(super) stretch: f64,
    /// Fraction of the lumen that is closed.
    pub(super) closed: f64,
}

impl Level {
    /// Creates a section from its contours, both counter-clockwise.
    pub(super) fn new(inner: Vec<u32>, outer: Vec<u32>, place: impl Fn(u32) -> Point) -> Self {
        let points: Vec<Point> = inner.iter().map(|&v| place(v)).collect();
        let normals = normals(&points);
        let most = room(&points, &normals);
        let lumen_um2 = area(points.iter().copied());
        let whole_um2 = area(outer.iter().map(|&v| place(v)));
        Self { inner, points, normals, most, outer, lumen_um2, whole_um2 }
    }

    /// Inner contour with its points moved by `depth` or as far as they may.
    pub(super) fn moved(&self, depth: f64) -> impl Iterator<Item = Point> {
        self.points.iter().zip(&self.normals).zip(&self.most).map(move |((p, n), &most)| {
            let by = most.min(depth);
            [p[0] + by * n[0], p[1] + by * n[1]]
        })
    }

    /// Shape of the section when a fraction of the lumen is closed and the tube is stretched. The
    /// area of the tissue is the area at rest divided by the stretch. The same holds for the tissue
    /// outside the base of the folds, which determines the factor on the inner contour. Moving the
    /// contour provides the rest of the closure.
    pub(super) fn shape(&self, station: &Station, closed: f64, stretch: f64) -> ContractedShape {
        let (inner, outer) = self.factors(station, closed, stretch);
        let target = (1.0 - closed) * self.lumen_um2 / (inner * inner);
        let deepest = self.most.iter().copied().fold(0.0, f64::max);
        let mut bounds = [0.0, deepest];
        if closed == 0.0 && stretch == 1.0 {
            bounds = [0.0; 2];
        }
        for _ in 0..HALVINGS {
            let middle = 0.5 * (bounds[0] + bounds[1]);
            bounds[usize::from(self.free(middle) <= target)] = middle;
        }
        ContractedShape { outer, inner, depth: bounds[1], stretch, closed }
    }

    /// Maximum fraction of a crest, up to `most`, for which the section has room.
    pub(super) fn limit(&self, station: &Station, most: f64) -> f64 {
        let floor = self.free(f64::INFINITY) + SPARE * self.lumen_um2;
        let has_room = |part: f64| {
            let (closed, stretch) = (part * station.closure, 1.0 - part * station.shortening);
            let (inner, _) = self.factors(station, closed, stretch);
            (1.0 - closed) * self.lumen_um2 / (inner * inner) >= floor
        };
        if has_room(most) {
            return most;
        }
        let mut bounds = [0.0, most];
        for _ in 0..HALVINGS {
            let middle = 0.5 * (bounds[0] + bounds[1]);
            bounds[usize::from(!has_room(middle))] = middle;
        }
        bounds[0]
    }

    /// Factors on the inner and the outer contour.
    fn factors(&self, station: &Station, closed: f64, stretch: f64) -> (f64, f64) {
        if closed == 0.0 && stretch == 1.0 {
            return (1.0, 1.0);
        }
        let base = station.base_um2.clamp(self.lumen_um2, self.whole_um2);
        let free = (1.0 - closed) * self.lumen_um2;
        let of = |area: f64| (((area - self.lumen_um2) / stretch + free) / area).sqrt();
        (of(base), of(self.whole_um2))
    }

    /// Area of the lumen after its contour has moved.
    fn free(&self, depth: f64) -> f64 {
        area(self.moved(depth))
    }
}

/// Signed area within a contour, positive if it is counter-clockwise.
pub(super) fn area(mut points: impl Iterator<Item = Point>) -> f64 {
    let Some(first) = points.next() else { return 0.0 };
    let (mut last, mut sum) = (first, 0.0);
    for p in points.chain([first]) {
        sum += cross2(last, p);
        last = p;
    }
    0.5 * sum
}

/// Unit normals towards the inside, perpendicular to the line between the neighbours; zero if that
/// line has no direction.
fn normals(points: &[Point]) -> Vec<Point> {
    let n = points.len();
    let of = |i: usize| {
        let (a, b) = (points[(i + n - 1) % n], points[(i + 1) % n]);
        let d = sub(b, a);
        let length = norm(d);
        if length > 0.0 { [-d[1] / length, d[0] / length] } else { [0.0; 2] }
    };
    (0..n).map(of).collect()
}

/// Maximum motion of each point.
fn room(points: &[Point], normals: &[Point]) -> Vec<f64> {
    let n = points.len();
    let next = |i: usize| if i + 1 == n { 0 } else { i + 1 };
    let rects: Vec<Rect> =
        (0..n).map(|i| Rect::around(&[points[i], points[next(i)]].map(|p| p.map(|x| x as f32)))).collect();
    let blocks = Blocks::new(&rects);
    let mut most: Vec<f64> = (0..n)
        .map(|i| {
            if normals[i] == [0.0; 2] {
                return 0.0;
            }
            let mut reach = REACH[0];
            loop {
                let centre = [0, 1].map(|axis| points[i][axis] + reach * normals[i][axis]);
                // A margin, because the boxes have single precision.
                let by = reach + 1.0;
                let rect = Rect { min: centre.map(|x| (x - by) as f32), max: centre.map(|x| (x + by) as f32) };
                let mut least = MOST;
                blocks.query(&rect, |j| {
                    if j != i && next(j) != i {
                        least = least.min(radius(points[i], normals[i], [points[j], points[next(j)]]));
                    }
                });
                if least <= reach || reach > MOST {
                    return SHARE * least;
                }
                reach *= REACH[1];
            }
        })
        .collect();
    // Neighbours move by nearly the same distance.
    let length = |i: usize| distance(points[i], points[next(i)]);
    for i in (0..2 * n).map(|i| i % n) {
        most[next(i)] = most[next(i)].min(most[i] + SLOPE * length(i));
    }
    for i in (0..2 * n).rev().map(|i| i % n) {
        most[i] = most[i].min(most[next(i)] + SLOPE * length(i));
    }
    most
}

/// Radius of the disc that touches the contour at `p`, has its centre along the normal `n` and
/// touches a segment.
fn radius(p: Point, n: Point, [a, b]: [Point; 2]) -> f64 {
    let at = |q: Point| {
        let d = sub(q, p);
        let height = dot(n, d);
        if height > 0.0 { dot(d, d) / (2.0 * height) } else { f64::INFINITY }
    };
    let ends = at(a).min(at(b));
    let d = sub(b, a);
    let square = dot(d, d);
    if square == 0.0 {
        return ends;
    }
    let length = square.sqrt();
    let side = cross2(d, sub(p, a)) / length;
    let m = if side < 0.0 { [d[1] / length, -d[0] / length] } else { [-d[1] / length, d[0] / length] };
    let along = side.abs() / (1.0 - m[0] * n[0] - m[1] * n[1]);
    if !along.is_finite() {
        return ends;
    }
    let centre = [p[0] + along * n[0], p[1] + along * n[1]];
    let t = dot(sub(centre, a), d) / square;
    if (0.0..=1.0).contains(&t) { along.min(ends) } else { ends }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    fn circle(n: u32, radius: f64) -> Vec<Point> {
        let at = |i: u32| 2.0 * PI * f64::from(i) / f64::from(n);
        (0..n).map(|i| [radius * libm::cos(at(i)), radius * libm::sin(at(i))]).collect()
    }

    #[test]
    fn discs_fill_a_circle_and_the_gap_of_a_slot() {
        let points = circle(256, 100.0);
        let found = room(&points, &normals(&points));
        // Chords of a circle lie within it, so discs that touch them are a little smaller.
        assert!(found.iter().all(|most| (0.85..=1.0).contains(&(most / (SHARE * 100.0)))), "{found:?}");
        // Two walls 10 µm apart, 400 µm long.
        let mut slot: Vec<Point> = (0..50).map(|i| [8.0 * f64::from(i), 0.0]).collect();
        slot.extend((0..50).rev().map(|i| [8.0 * f64::from(i), 10.0]));
        let found = room(&slot, &normals(&slot));
        assert!(found[10..40].iter().all(|most| (most - SHARE * 5.0).abs() < 1e-9), "{found:?}");
    }

    #[test]
    fn a_section_keeps_its_tissue() {
        let (inner, outer) = (circle(200, 100.0), circle(60, 300.0));
        let place = |v: u32| if v < 200 { inner[v as usize] } else { outer[v as usize - 200] };
        let level = Level::new((0..200).collect(), (200..260).collect(), place);
        let station =
            Station { z_um: 0.0, base_um2: 2.0 * level.lumen_um2, closure: 0.9, shortening: 0.2, wavelength_um: 1e4 };
        for (closed, stretch) in [(0.5, 0.8), (0.3, 1.0), (0.0, 0.9)] {
            let shape = level.shape(&station, closed, stretch);
            let lumen = shape.inner * shape.inner * area(level.moved(shape.depth));
            assert!((lumen / level.lumen_um2 - (1.0 - closed)).abs() < 1e-9);
            let tissue = shape.outer * shape.outer * level.whole_um2 - lumen;
            assert!((tissue * stretch / (level.whole_um2 - level.lumen_um2) - 1.0).abs() < 1e-9);
            assert!(shape.depth > 0.0 && shape.inner <= shape.outer);
        }
        let still = level.shape(&station, 0.0, 1.0);
        assert_eq!((still.inner, still.outer, still.depth), (1.0, 1.0, 0.0));
        let limit = level.limit(&station, 1.0);
        assert!(limit > 0.5 && limit <= 1.0);
    }
}
