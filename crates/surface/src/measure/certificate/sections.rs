//! Tests of sections: each ring must be simple and the inner ring strictly inside the outer one.
//! Also measures the minimum gap.
//!
//! The gap to nearby edges of the same ring bounds the distance at which other edges are searched.
//! This search uses one hierarchy of the edges of both rings, in their order, so the time is nearly
//! linear. Contours are tested as recorded, in micrometres.

use super::surface::Tally;
use super::types::{FailureKind, Failures, PLACES, Place};
use crate::geometry::blocks::{Blocks, Rect};
use crate::geometry::polygon::next_on_rings;
use crate::geometry::predicates::orient2d;
use crate::geometry::segment::segments_meet;
use crate::geometry::vector::squared_distance_to_segment;
use crate::model::Section;
use crate::vectorize::Vectors;
use rayon::prelude::*;

type P2 = [f64; 2];

/// Findings of all sections, in order.
#[derive(Default)]
pub(super) struct Contours {
    pub(super) gaps_um: Vec<Option<f64>>,
    broken: Tally,
    outside: Tally,
    crossing: Tally,
}

#[derive(Default)]
struct SectionFindings {
    broken: bool,
    outside: bool,
    crossings: u64,
    places: Vec<P2>,
    gap: Option<f64>,
}

impl Contours {
    pub(super) fn of(sections: &[Section]) -> Self {
        let mut contours = Self::default();
        let found: Vec<SectionFindings> = sections.par_iter().map(examine_section).collect();
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

    /// Number of pairs of edges that intersect, and of rings in the wrong order.
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

/// Edges of both rings. Edge `i` goes from point `i` to point `next(i)`.
struct Edges {
    points: Vec<P2>,
    inner: usize,
}

impl Edges {
    #[inline]
    fn next(&self, i: usize) -> usize {
        next_on_rings(i, self.inner, self.points.len())
    }

    fn segment(&self, i: usize) -> [P2; 2] {
        [self.points[i], self.points[self.next(i)]]
    }

    /// True if at most one edge lies between two edges, so that [`gap_along`] has measured their
    /// gap.
    fn are_close(&self, i: usize, j: usize) -> bool {
        let close = |i: usize, j: usize| self.next(i) == j || self.next(self.next(i)) == j;
        close(i, j) || close(j, i)
    }
}

fn examine_section(section: &Section) -> SectionFindings {
    let mut found = SectionFindings::default();
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
    // If no edges intersect, one point decides for its whole ring.
    found.outside = !is_inside(edges.points[0], &edges.points[edges.inner..]);
    found
}

/// True if two edges have a common point other than a shared end.
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

/// Squared minimum distance between an edge of a ring and the ends of the next two edges to either
/// side, except its own ends.
fn gap_along(ring: &[[f32; 2]]) -> f64 {
    const LANES: usize = 8;
    // Starts two points before the first one and repeats some points after the last, so that all
    // lanes have an edge.
    let count = ring.len().next_multiple_of(LANES) + 5;
    let points = || ring.iter().cycle().skip(2 * ring.len() - 2).take(count);
    let (x, y): (Vec<f64>, Vec<f64>) = points().map(|p| (f64::from(p[0]), f64::from(p[1]))).unzip();
    // In a ring of three points, the points two away are ends of the edge.
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
                        let squared = squared_distance_to_segment(at(end), at(2), at(3));
                        least[lane] = if squared < least[lane] { squared } else { least[lane] };
                    }
                }
            }
        },
    );
    least.into_iter().fold(f64::INFINITY, f64::min)
}

/// Squared minimum distance between the ends of each edge and the other edge, except for a shared
/// end.
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
            least = least.min(squared_distance_to_segment(point, from, to));
        }
    }
    least
}

/// True if a point lies strictly inside a simple polygon that does not pass through it. Exact.
fn is_inside(p: P2, polygon: &[P2]) -> bool {
    let mut inside = false;
    let mut a = polygon[polygon.len() - 1];
    for &b in polygon {
        if (a[1] > p[1]) != (b[1] > p[1]) {
            let side = orient2d(a, b, p);
            // The edge crosses the height of the point, to its right if the point is left of an
            // upward edge.
            if (b[1] > a[1] && side > 0.0) || (b[1] < a[1] && side < 0.0) {
                inside = !inside;
            }
        }
        a = b;
    }
    inside
}
