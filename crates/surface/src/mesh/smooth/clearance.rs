//! How far particles may move without a contact.
//!
//! If an end `p` of an edge moves and the other end `q` does not, a point between moves by its share, the less the nearer it is to `q`.
//! So each point stays within a part of its own distance from an edge `f` if `p` moves by less than that part of its distance from
//! the shadow of `f` in light from `q`. This also holds for edges that meet in `q`.

use super::vector::Point;
use crate::geometry::blocks::{Blocks, Rect};
use crate::model::Ring;

/// For each particle of both rings how far it is from the shadows of other edges in light from its two neighbours, at most `reach`.
/// Edges that meet in the particle itself do not count.
///
/// The edges before and after an edge that is the middle of a Z lie on different sides of it. If particles move `inward`, into their
/// corners, those at its ends move away from each other: then the distance of the outer ends from the line through it is added.
pub(super) fn clearances(inner: &Ring, outer: &Ring, reach: f64, inward: bool) -> [Vec<f64>; 2] {
    let first = inner.len();
    let points: Vec<[f32; 2]> = inner.points.iter().chain(&outer.points).copied().collect();
    let after = |i: usize| match i + 1 {
        j if j == first => 0,
        j if j == points.len() => first,
        j => j,
    };
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

/// Twice the lesser distance of the first and last point from the line through the others, if they lie on different sides of it;
/// else 0.
fn across([a, b, c, d]: [Point; 4]) -> f64 {
    let u = [c[0] - b[0], c[1] - b[1]];
    let side = |p: Point| u[0] * (p[1] - b[1]) - u[1] * (p[0] - b[0]);
    let (first, last) = (side(a), side(d));
    let square = u[0] * u[0] + u[1] * u[1];
    if first * last < 0.0 { 2.0 * first.abs().min(last.abs()) / square.sqrt() } else { 0.0 }
}

/// Square of the distance between two segments that do not cross.
fn between([a, b]: [Point; 2], [c, d]: [Point; 2]) -> f64 {
    let from = |p, a, b| beyond(p, a, b, 1.0);
    from(a, c, d).min(from(b, c, d)).min(from(c, a, b)).min(from(d, a, b))
}

/// Square of the distance of `p` from the segment from `c` to `d` and its shadow in light from `q`.
fn shadow(p: Point, q: Point, [c, d]: [Point; 2]) -> f64 {
    let ray = |a: Point| beyond(p, a, [2.0 * a[0] - q[0], 2.0 * a[1] - q[1]], f64::INFINITY);
    beyond(p, c, d, 1.0).min(ray(c)).min(ray(d))
}

/// Square of the distance of `p` from the part from `a` by `b` to `most` times as far.
fn beyond(p: Point, a: Point, b: Point, most: f64) -> f64 {
    let (ab, ap) = ([b[0] - a[0], b[1] - a[1]], [p[0] - a[0], p[1] - a[1]]);
    let square = ab[0] * ab[0] + ab[1] * ab[1];
    let t = if square > 0.0 { ((ap[0] * ab[0] + ap[1] * ab[1]) / square).clamp(0.0, most) } else { 0.0 };
    let v = [ap[0] - ab[0] * t, ap[1] - ab[1] * t];
    v[0] * v[0] + v[1] * v[1]
}
