//! Sections: each ring simple, the inner one strictly inside the outer one, and the least gap.
//!
//! The gap to edges close by on the same ring bounds how far to search for others. For these, the edges of both rings are in
//! one hierarchy, in their order, so that the time is nearly linear. Contours are examined as recorded, in micrometres.

use super::surface::Tally;
use super::types::{FailureKind, Failures, PLACES, Place};
use crate::geometry::blocks::{Blocks, Rect};
use crate::geometry::predicates::orient2d;
use crate::geometry::tri_tri::segments_meet;
use crate::model::Section;
use crate::vectorize::Vectors;
use rayon::prelude::*;

type P2 = [f64; 2];

/// Findings on sections, in their order.
#[derive(Default)]
pub(super) struct Contours {
    pub(super) gaps_um: Vec<Option<f64>>,
    broken: Tally,
    outside: Tally,
    crossing: Tally,
}

#[derive(Default)]
struct Found {
    broken: bool,
    outside: bool,
    crossings: u64,
    places: Vec<P2>,
    gap: Option<f64>,
}

impl Contours {
    pub(super) fn of(sections: &[Section]) -> Self {
        let mut contours = Self::default();
        let found: Vec<Found> = sections.par_iter().map(examine_section).collect();
        for (section, found) in sections.iter().zip(found) {
            let index = contours.gaps_um.len() as u32;
            let place = |at: P2| Place { section: Some(index), ..Place::at([at[0], at[1], section.z_um]) };
            let first_point = || vec![place(section.inner.points.first().map_or([0.0; 2], |p| p.map(f64::from)))];
            if found.broken {
                contours.broken.add(1, first_point());
            }
            if found.outside {
                contours.outside.add(1, first_point());
            }
            contours.crossing.add(found.crossings, found.places.into_iter().map(place).collect());
            contours.gaps_um.push(found.gap);
        }
        contours
    }

    /// Pairs of edges that meet, and rings in the wrong order.
    pub(super) fn crossings(&self) -> u64 {
        self.crossing.count + self.outside.count
    }

    pub(super) fn report(&self, failures: &mut Failures) {
        let what = "sections have a ring of fewer than three points or one that is not finite";
        self.broken.report(FailureKind::SectionRing, what, failures);
        self.outside.report(
            FailureKind::SectionNesting,
            "sections have their inner ring outside the outer one",
            failures,
        );
        self.crossing.report(FailureKind::SectionCrossing, "pairs of edges of a section cross or touch", failures);
    }
}

/// The edges of both rings: edge `i` goes from point `i` to point `next(i)`.
struct Edges {
    points: Vec<P2>,
    inner: usize,
}

impl Edges {
    #[inline]
    fn next(&self, i: usize) -> usize {
        if i + 1 == self.inner {
            0
        } else if i + 1 == self.points.len() {
            self.inner
        } else {
            i + 1
        }
    }

    fn segment(&self, i: usize) -> [P2; 2] {
        [self.points[i], self.points[self.next(i)]]
    }

    /// Whether there is at most one edge between two, so that [`gap_along`] has measured their gap.
    fn are_close(&self, i: usize, j: usize) -> bool {
        let close = |i: usize, j: usize| self.next(i) == j || self.next(self.next(i)) == j;
        close(i, j) || close(j, i)
    }
}

fn examine_section(section: &Section) -> Found {
    let mut found = Found::default();
    let rings = [&section.inner.points, &section.outer.points];
    found.broken = rings.iter().any(|r| r.len() < 3 || r.iter().flatten().any(|x| !x.is_finite()));
    if found.broken {
        return found;
    }
    let mut gap = rings.iter().map(|ring| gap_along(ring)).fold(f64::INFINITY, f64::min);
    let points = rings.into_iter().flatten().map(|p| p.map(f64::from)).collect();
    let edges = Edges { points, inner: section.inner.len() };
    let reach = (gap.sqrt() * 0.501) as f32;
    let rect = |i: usize| {
        let around = Rect::around(&edges.segment(i).map(|p| p.map(|x| x as f32)));
        // A margin compensates for the rounding of these sums.
        let margin = |x: f32| reach + x.abs() * 1e-6;
        Rect { min: around.min.map(|x| x - margin(x)), max: around.max.map(|x| x + margin(x)) }
    };
    Blocks::new(&(0..edges.points.len()).map(rect).collect::<Vec<_>>()).pairs(|i, j| {
        if cross(&edges, i, j) {
            found.crossings += 1;
            if found.places.len() < PLACES {
                found.places.push(edges.points[i]);
            }
        }
        if !edges.are_close(i, j) {
            gap = gap.min(gap_squared(&edges, i, j));
        }
    });
    found.gap = gap.is_finite().then(|| gap.sqrt());
    // If nothing crosses, one point decides for its whole ring.
    found.outside = !is_inside(edges.points[0], &edges.points[edges.inner..]);
    found
}

/// Whether two edges meet other than at the end they share.
fn cross(edges: &Edges, i: usize, j: usize) -> bool {
    let ([a, b], [c, d]) = (edges.segment(i), edges.segment(j));
    let folded = |far: P2, middle: P2, near: P2| {
        let same = |axis: usize| (far[axis] - middle[axis]) * (near[axis] - middle[axis]) > 0.0;
        far == middle || near == middle || ((same(0) || same(1)) && orient2d(far, middle, near) == 0.0)
    };
    if edges.next(i) == j {
        folded(a, b, d)
    } else if edges.next(j) == i {
        folded(b, a, c)
    } else {
        segments_meet(a, b, c, d)
    }
}

/// Square of the least distance between an edge of a ring and an end of the next or the next but one, to either side, that is
/// not its own.
fn gap_along(ring: &[[f32; 2]]) -> f64 {
    const LANES: usize = 8;
    // Points from two before the first on, some again after the last, so that all lanes have an edge.
    let count = ring.len().next_multiple_of(LANES) + 5;
    let points = || ring.iter().cycle().skip(2 * ring.len() - 2).take(count);
    let (x, y): (Vec<f64>, Vec<f64>) = points().map(|p| (f64::from(p[0]), f64::from(p[1]))).unzip();
    // Of a triangle, the points two away are ends of the edge.
    let ends: &[usize] = if ring.len() > 3 { &[0, 1, 4, 5] } else { &[1, 4] };
    let mut least = [f64::INFINITY; LANES];
    Vectors::best().run(
        #[inline(always)]
        || {
            for first in (0..count - 5).step_by(LANES) {
                for &end in ends {
                    let (x, y) = (&x[first..first + LANES + 5], &y[first..first + LANES + 5]);
                    for lane in 0..LANES {
                        let at = |k: usize| [x[lane + k], y[lane + k]];
                        let squared = distance_squared(at(end), at(2), at(3));
                        least[lane] = if squared < least[lane] { squared } else { least[lane] };
                    }
                }
            }
        },
    );
    least.into_iter().fold(f64::INFINITY, f64::min)
}

/// Square of the least distance between an end of one edge and the other edge, unless the edges share this end.
fn gap_squared(edges: &Edges, i: usize, j: usize) -> f64 {
    let ([a, b], [c, d]) = (edges.segment(i), edges.segment(j));
    let (i_next, j_next) = (edges.next(i), edges.next(j));
    let mut least = f64::INFINITY;
    for (vertex, point, ends, from, to) in [
        (i, a, [j, j_next], c, d),
        (i_next, b, [j, j_next], c, d),
        (j, c, [i, i_next], a, b),
        (j_next, d, [i, i_next], a, b),
    ] {
        if !ends.contains(&vertex) {
            least = least.min(distance_squared(point, from, to));
        }
    }
    least
}

#[inline(always)]
fn distance_squared(p: P2, a: P2, b: P2) -> f64 {
    let (u, v) = ([b[0] - a[0], b[1] - a[1]], [p[0] - a[0], p[1] - a[1]]);
    let length = u[0] * u[0] + u[1] * u[1];
    let along = if length > 0.0 { ((u[0] * v[0] + u[1] * v[1]) / length).clamp(0.0, 1.0) } else { 0.0 };
    let off = [v[0] - along * u[0], v[1] - along * u[1]];
    off[0] * off[0] + off[1] * off[1]
}

/// Whether a point lies strictly inside a simple polygon that does not pass through it, exactly.
fn is_inside(p: P2, polygon: &[P2]) -> bool {
    let mut inside = false;
    let mut a = polygon[polygon.len() - 1];
    for &b in polygon {
        if (a[1] > p[1]) != (b[1] > p[1]) {
            let side = orient2d(a, b, p);
            // The edge crosses the height of the point: to its right if the point is left of an upward edge.
            if (b[1] > a[1] && side > 0.0) || (b[1] < a[1] && side < 0.0) {
                inside = !inside;
            }
        }
        a = b;
    }
    inside
}
