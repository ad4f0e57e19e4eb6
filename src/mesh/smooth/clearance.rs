//! How far particles may move without a contact.

use crate::geometry::blocks::{Blocks, Rect};
use crate::model::Ring;

/// For each particle of both rings the least distance between one of its two edges and an edge that has no end in common
/// with that, at most `reach`.
pub(super) fn clearances(inner: &Ring, outer: &Ring, reach: f64) -> [Vec<f64>; 2] {
    let rings = [inner, outer];
    let edges: Vec<[[f64; 2]; 2]> = rings
        .iter()
        .flat_map(|ring| {
            (0..ring.len()).map(|i| [ring.points[i], ring.points[(i + 1) % ring.len()]].map(|p| p.map(f64::from)))
        })
        .collect();
    let grown = |edge: &[[f64; 2]; 2]| {
        let rect = Rect::around(&edge.map(|p| p.map(|x| x as f32)));
        let by = 0.5 * reach as f32;
        Rect { min: rect.min.map(|x| x - by), max: rect.max.map(|x| x + by) }
    };
    let rects: Vec<Rect> = edges.iter().map(grown).collect();
    let first = inner.len();
    let adjoin = |i: usize, j: usize| {
        let (n, from) = if i < first { (first, 0) } else { (outer.len(), first) };
        (i < first) == (j < first) && {
            let apart = (j - from + n - (i - from)) % n;
            apart == 1 || apart + 1 == n
        }
    };
    let mut of_edge = vec![reach; edges.len()];
    Blocks::new(&rects).pairs(|i, j| {
        if !adjoin(i, j) {
            let distance = between(edges[i], edges[j]);
            of_edge[i] = of_edge[i].min(distance);
            of_edge[j] = of_edge[j].min(distance);
        }
    });
    let of_ring =
        |from: usize, n: usize| (0..n).map(|i| of_edge[from + i].min(of_edge[from + (i + n - 1) % n])).collect();
    [of_ring(0, first), of_ring(first, outer.len())]
}

/// Distance between two segments that do not cross.
fn between([a, b]: [[f64; 2]; 2], [c, d]: [[f64; 2]; 2]) -> f64 {
    from(a, c, d).min(from(b, c, d)).min(from(c, a, b)).min(from(d, a, b))
}

/// Distance of `p` from the segment from `a` to `b`.
fn from(p: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    let (ab, ap) = ([b[0] - a[0], b[1] - a[1]], [p[0] - a[0], p[1] - a[1]]);
    let square = ab[0] * ab[0] + ab[1] * ab[1];
    let t = if square > 0.0 { ((ap[0] * ab[0] + ap[1] * ab[1]) / square).clamp(0.0, 1.0) } else { 0.0 };
    (ap[0] - ab[0] * t).hypot(ap[1] - ab[1] * t)
}
