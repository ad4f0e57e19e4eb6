//! Distances between points and triangles, and the maximum distance of many points from a surface.

use super::bvh::{Bounds, Bvh, NearestSearch, WIDTH};
use super::vector::{cross, dot, sub};
use crate::vectorize::Vectors;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

const ITEMS_PER_TASK: usize = 1024;
/// Squared sine of an angle of a triangle up to which its edges stand for the triangle.
const SLIVER: f64 = 1e-20;

/// Triangles with a hierarchy. `corners(i)` returns the corners of triangle `i`. Consecutive
/// triangles should be close to each other.
pub struct Triangles<F> {
    corners: F,
    len: usize,
    /// Hierarchy of blocks of eight triangles. One of single triangles would take more memory than
    /// the triangles.
    block_bvh: Bvh,
    vectors: Vectors,
}

/// Triangles of a block, by corner, axis and index in the block.
type BlockTriangles = [[[f64; WIDTH]; 3]; 3];

impl<F: Fn(usize) -> [[f64; 3]; 3] + Sync> Triangles<F> {
    /// Builds the hierarchy of `len` triangles.
    pub fn new(len: usize, corners: F) -> Self {
        let of_block = |block: usize| {
            let own = block * WIDTH..len.min((block + 1) * WIDTH);
            own.fold(Bounds::EMPTY, |all, i| all.with(&Bounds::of(corners(i))))
        };
        let block_bvh = Bvh::build(len.div_ceil(WIDTH), of_block);
        Self { corners, len, block_bvh, vectors: Vectors::best() }
    }

    /// Squared distance of a point from the triangles of a block.
    fn squared_distance(&self, point: [f64; 3], block: usize) -> f64 {
        let mut triangles = BlockTriangles::default();
        for lane in 0..WIDTH {
            // The last triangle fills the last block.
            let corners = (self.corners)((block * WIDTH + lane).min(self.len - 1));
            for (block, corner) in triangles.iter_mut().zip(corners) {
                for axis in 0..3 {
                    block[axis][lane] = corner[axis];
                }
            }
        }
        self.vectors.run(
            #[inline(always)]
            || nearest(point, &triangles),
        )
    }

    /// Distance of a point from the nearest triangle; infinite if there are no triangles. `hint` is
    /// `None` or what another search left in it, best one for a point nearby.
    pub fn distance(&self, point: [f64; 3], hint: &mut Option<usize>) -> f64 {
        let squared_distance = |block| self.squared_distance(point, block);
        let mut search = NearestSearch { squared_distance, good_enough: 0.0, best: f64::INFINITY, item: None };
        self.block_bvh.nearest(point, *hint, &mut search);
        *hint = search.item;
        search.best.sqrt()
    }

    /// Maximum of `least` and of the distances of samples from their nearest triangles; infinite if
    /// there are no triangles. `samples(i, visit)` calls `visit` with the samples of item `i`, for
    /// `items` items.
    ///
    /// The result is exact and independent of the number of threads. Only a sample beyond the
    /// current maximum matters, so the search for a sample stops at the first triangle within the
    /// maximum. It starts at the triangles of the previous sample; consecutive samples should
    /// therefore be close to each other.
    pub fn farthest(&self, least: f64, items: usize, samples: impl Fn(usize, &mut dyn FnMut([f64; 3])) + Sync) -> f64 {
        // The bits of positive numbers are ordered like the numbers.
        let largest = AtomicU64::new((least * least).to_bits());
        (0..items.div_ceil(ITEMS_PER_TASK)).into_par_iter().for_each(|chunk| {
            let mut hint = None;
            for item in chunk * ITEMS_PER_TASK..items.min((chunk + 1) * ITEMS_PER_TASK) {
                samples(item, &mut |point| {
                    let squared_distance = |block| self.squared_distance(point, block);
                    let good_enough = f64::from_bits(largest.load(Ordering::Relaxed));
                    if hint.is_some_and(|block| squared_distance(block) <= good_enough) {
                        return;
                    }
                    let mut search = NearestSearch { squared_distance, good_enough, best: good_enough, item: None };
                    self.block_bvh.nearest(point, hint, &mut search);
                    if search.item.is_none() {
                        search.best = f64::INFINITY;
                        self.block_bvh.nearest(point, None, &mut search);
                        largest.fetch_max(search.best.to_bits(), Ordering::Relaxed);
                    }
                    hint = search.item;
                });
            }
        });
        f64::from_bits(largest.into_inner()).sqrt().max(least)
    }
}

/// Squared distance of a point from the triangles of a block. Has no branches, so that the compiler
/// computes several triangles at once.
#[inline(always)]
fn nearest(p: [f64; 3], triangles: &BlockTriangles) -> f64 {
    let [a, b, c] = triangles;
    let mut squares = [0.0; WIDTH];
    for l in 0..WIDTH {
        let (a, b, c) = ([a[0][l], a[1][l], a[2][l]], [b[0][l], b[1][l], b[2][l]], [c[0][l], c[1][l], c[2][l]]);
        let (ab, bc, ca) = (sub(b, a), sub(c, b), sub(a, c));
        let (ap, bp, cp) = (sub(p, a), sub(p, b), sub(p, c));
        let normal = cross(ca, ab);
        let square = dot(normal, normal);
        let above = dot(normal, ap);
        let outside = [(ab, ap), (bc, bp), (ca, cp)].map(|(edge, from)| dot(cross(edge, normal), from));
        let has_normal = square > SLIVER * (dot(ab, ab) * dot(ca, ca));
        let is_inside = (outside[0] <= 0.0) & (outside[1] <= 0.0) & (outside[2] <= 0.0) & has_normal;
        let of_edges = least(to_edge(ab, ap), least(to_edge(bc, bp), to_edge(ca, cp)));
        squares[l] = if is_inside { above * above / square } else { of_edges };
    }
    squares.into_iter().fold(f64::INFINITY, least)
}

/// Squared distance of a point, relative to the start of an edge, from the edge.
#[inline(always)]
fn to_edge(edge: [f64; 3], from: [f64; 3]) -> f64 {
    let along = dot(edge, from) / dot(edge, edge);
    // Not a number if the edge has no length.
    let along = if along > 0.0 { least(along, 1.0) } else { 0.0 };
    let rest = [from[0] - edge[0] * along, from[1] - edge[1] * along, from[2] - edge[2] * along];
    dot(rest, rest)
}

#[inline(always)]
fn least(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

/// Squared distance between a point and a triangle, which may be degenerate (Ericson, *Real-Time
/// Collision Detection*, 5.1.5).
#[must_use]
#[inline]
pub fn squared_distance(p: [f64; 3], [a, b, c]: [[f64; 3]; 3]) -> f64 {
    let (ab, ac, ap) = (sub(b, a), sub(c, a), sub(p, a));
    let (d1, d2) = (dot(ab, ap), dot(ac, ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return dot(ap, ap);
    }
    let bp = sub(p, b);
    let (d3, d4) = (dot(ab, bp), dot(ac, bp));
    if d3 >= 0.0 && d4 <= d3 {
        return dot(bp, bp);
    }
    let cp = sub(p, c);
    let (d5, d6) = (dot(ab, cp), dot(ac, cp));
    if d6 >= 0.0 && d5 <= d6 {
        return dot(cp, cp);
    }
    let from = |start: [f64; 3], along: [f64; 3], by: f64| {
        let rest = [start[0] - along[0] * by, start[1] - along[1] * by, start[2] - along[2] * by];
        dot(rest, rest)
    };
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return from(ap, ab, d1 / (d1 - d3));
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return from(ap, ac, d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        return from(bp, sub(c, b), (d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    let (v, w) = (vb / (va + vb + vc), vc / (va + vb + vc));
    from([ap[0] - ab[0] * v, ap[1] - ab[1] * v, ap[2] - ab[2] * v], ac, w)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    type Triangle = [[f64; 3]; 3];

    /// Minimum squared distance from a raster of barycentric coordinates: an upper bound.
    fn sampled(p: [f64; 3], [a, b, c]: Triangle) -> f64 {
        const N: u32 = 40;
        let mut least = f64::INFINITY;
        for i in 0..=N {
            for j in 0..=N - i {
                let (v, w) = (f64::from(i) / f64::from(N), f64::from(j) / f64::from(N));
                let q: [f64; 3] = std::array::from_fn(|k| a[k] + (b[k] - a[k]) * v + (c[k] - a[k]) * w);
                least = least.min(dot(sub(p, q), sub(p, q)));
            }
        }
        least
    }

    fn coordinates() -> impl Strategy<Value = [f64; 3]> {
        prop::array::uniform3((-20i8..20).prop_map(|x| f64::from(x) * 0.3))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]

        #[test]
        fn the_distance_is_that_of_the_nearest_point(p in coordinates(), t in prop::array::uniform3(coordinates())) {
            let (found, bound) = (squared_distance(p, t).sqrt(), sampled(p, t).sqrt());
            // No point of the triangle is farther than this from the raster.
            let pitch = (0..3).map(|k| sub(t[k], t[(k + 1) % 3])).map(|e| dot(e, e).sqrt()).fold(0.0, f64::max) / 40.0;
            prop_assert!(found <= bound + 1e-9 && found >= bound - pitch - 1e-9, "{found} {bound} {pitch}");
        }

        #[test]
        fn the_largest_distance_is_that_of_brute_force(
            triangles in prop::collection::vec(prop::array::uniform3(coordinates()), 1..300),
            points in prop::collection::vec(coordinates(), 1..1200),
        ) {
            let surface = Triangles::new(triangles.len(), |i| triangles[i]);
            let found = surface.farthest(0.0, points.len().div_ceil(2), |i, visit| {
                points[2 * i..points.len().min(2 * i + 2)].iter().for_each(|p| visit(*p));
            });
            let nearest = |p: &[f64; 3]| triangles.iter().map(|t| squared_distance(*p, *t)).fold(f64::INFINITY, f64::min);
            let expected = points.iter().map(nearest).fold(0.0, f64::max).sqrt();
            prop_assert!((found - expected).abs() <= 1e-12 * expected, "{found} {expected}");
        }
    }
}
