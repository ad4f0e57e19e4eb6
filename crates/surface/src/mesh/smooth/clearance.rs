//! Clearances: how far particles may move without a contact.
//!
//! If the end `p` of an edge moves and the other end `q` does not, a point between them moves by a
//! fraction that shrinks towards `q`. Each point therefore stays within a fraction of its own
//! distance from an edge `f` if `p` moves by less than that fraction of its distance from the
//! shadow of `f` in light from `q`. This also holds for edges that meet in `q`.

use crate::geometry::blocks::{Blocks, Rect};
use crate::geometry::polygon::next_on_rings;
use crate::geometry::vector::{cross2, dot, squared_distance_to_ray, squared_distance_to_segment, sub};
use crate::model::Ring;

pub(super) type Point = [f64; 2];

/// Distance of each particle of both rings from the shadows of other edges in light from its two
/// neighbours, at most `reach`. Edges that meet in the particle do not count.
///
/// The edges before and after the middle edge of a Z lie on different sides of it. If particles
/// move `inward`, into their corners, the ends of the middle edge move away from each other. The
/// distance of the outer ends from the line through the middle edge is then added.
pub(super) fn clearances(inner: &Ring, outer: &Ring, reach: f64, inward: bool) -> [Vec<f64>; 2] {
    let first = inner.len();
    let points: Vec<[f32; 2]> = inner.points.iter().chain(&outer.points).copied().collect();
    let after = |i: usize| next_on_rings(i, first, points.len());
    let point = |i: usize| points[i].map(f64::from);
    let by = 0.5 * reach as f32;
    let grown = |i: usize| {
        let rect = Rect::around(&[points[i], points[after(i)]]);
        Rect { min: rect.min.map(|x| x - by), max: rect.max.map(|x| x + by) }
    };
    let rects: Vec<Rect> = (0..points.len()).map(grown).collect();
    let mut squares = vec![reach * reach; points.len()];
    Blocks::new(&rects).pairs(|i, j| {
        let near = |a: usize, b: usize| b == after(a) || b == after(after(a));
        if !near(i, j) && !near(j, i) {
            let ends = [i, after(i), j, after(j)];
            let [a, b, c, d] = ends.map(point);
            let least = ends.iter().fold(0f64, |most, &end| most.max(squares[end]));
            if between([a, b], [c, d]) < least {
                let found = [shadow(a, b, [c, d]), shadow(b, a, [c, d]), shadow(c, d, [a, b]), shadow(d, c, [a, b])];
                for (end, square) in ends.into_iter().zip(found) {
                    squares[end] = squares[end].min(square);
                }
            }
        }
    });
    let mut distances = squares;
    distances.iter_mut().for_each(|x| *x = x.sqrt());
    for i in 0..points.len() {
        let ends = [i, after(i), after(after(i)), after(after(after(i)))];
        let [a, b, c, d] = ends.map(point);
        if ends[3] == i {
            continue;
        }
        let (first, last) = ([a, b], [c, d]);
        let extra = if inward { across([a, b, c, d]) } else { 0.0 };
        let found = [
            shadow(a, b, last).sqrt(),
            shadow(b, a, last).min(shadow(b, c, last)).sqrt() + extra,
            shadow(c, d, first).min(shadow(c, b, first)).sqrt() + extra,
            shadow(d, c, first).sqrt(),
        ];
        for (end, distance) in ends.into_iter().zip(found) {
            distances[end] = distances[end].min(distance);
        }
    }
    let second = distances.split_off(first);
    [distances, second]
}

/// Twice the smaller distance of the first and last point from the line through the other two, if
/// they lie on different sides of it; otherwise 0.
fn across([a, b, c, d]: [Point; 4]) -> f64 {
    let u = sub(c, b);
    let (first, last) = (cross2(u, sub(a, b)), cross2(u, sub(d, b)));
    if first * last < 0.0 { 2.0 * first.abs().min(last.abs()) / dot(u, u).sqrt() } else { 0.0 }
}

/// Squared distance between two segments that do not cross.
fn between([a, b]: [Point; 2], [c, d]: [Point; 2]) -> f64 {
    let from = squared_distance_to_segment::<2>;
    from(a, c, d).min(from(b, c, d)).min(from(c, a, b)).min(from(d, a, b))
}

/// Squared distance of `p` from the segment from `c` to `d` and its shadow in light from `q`.
fn shadow(p: Point, q: Point, [c, d]: [Point; 2]) -> f64 {
    let ray = |a: Point| squared_distance_to_ray(p, a, [0, 1].map(|k| 2.0 * a[k] - q[k]));
    squared_distance_to_segment(p, c, d).min(ray(c)).min(ray(d))
}
