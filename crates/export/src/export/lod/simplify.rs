//! Simplification by edge collapses in the order of the error that they cause (Garland and Heckbert
//! 1997; meshoptimizer).
//!
//! Each wall is simplified separately and keeps the vertices of its borders. The patches at the
//! ends have only border vertices and stay unchanged. Neighbouring patches of a level therefore
//! still share their borders.
//!
//! The simplifier needs several times the memory of the triangles. A large wall is therefore
//! simplified in pieces that keep their borders, in two passes. The pieces of the second pass are
//! cut elsewhere, so most borders of the first pass lie within them. A smaller wall is simplified
//! as a whole, which keeps the order of collapses exact.

use super::full::{FullSurface, PatchTriangles, number};
use super::mend::mend;
use meshopt::{SimplifyOptions, VertexDataAdapter, simplify};
use rayon::prelude::*;
use std::borrow::Cow;

/// Maximum number of triangles of a piece.
const PIECE: usize = if cfg!(test) { 1 << 12 } else { 1 << 16 };
/// Maximum number of triangles of a wall that is simplified as a whole.
pub(super) const AT_ONCE: usize = if cfg!(test) { 1 << 13 } else { 1 << 18 };
/// Fraction of the triangles of a piece at which each pass cuts it.
const CUTS: [f64; 2] = [0.5, 0.38];
/// Number of triangles from which the position of a cut is estimated.
const SAMPLE: usize = 1 << 12;

/// Simplifies a finer level to about `target` triangles, or copies it if it has no more.
///
/// The result has more triangles where collapses would tear the surface. It is the finer level if
/// the simplified surface cannot be mended (see [`mend`]).
pub(super) fn coarser<'a>(full: &FullSurface<'_>, finer: &PatchTriangles<'a>, target: usize) -> PatchTriangles<'a> {
    let is_wall = |part: usize| full.patches[part].kind.is_wall();
    let count = |walls: bool| -> usize {
        finer.iter().enumerate().filter(|(part, _)| is_wall(*part) == walls).map(|(_, t)| t.len()).sum()
    };
    let (walls, ends) = (count(true), count(false));
    // The walls keep at least half of the target, however many triangles the ends have.
    let share = target.saturating_sub(ends).max(target / 2) as f64 / walls as f64;
    if share >= 1.0 {
        return finer.clone();
    }
    let positions = &full.mesh.positions[..];
    let of_part = |part: usize| -> Cow<'a, [[u32; 3]]> {
        if is_wall(part) { collapse(positions, &finer[part], share).into() } else { finer[part].clone() }
    };
    let mut level: PatchTriangles<'a> = (0..finer.len()).map(of_part).collect();
    if mend(&mut level, full.mesh) {
        return level;
    }
    tracing::warn!(
        target,
        "simplification failed to produce a closed surface; this level of detail keeps the triangles of the finer level"
    );
    finer.clone()
}

/// Simplifies a wall to about `share` of its triangles.
fn collapse(positions: &[[f32; 3]], triangles: &[[u32; 3]], share: f64) -> Vec<[u32; 3]> {
    if triangles.len() <= AT_ONCE {
        return collapse_piece(positions, triangles, share);
    }
    let mut kept = Cow::Borrowed(triangles);
    for (cut, share) in CUTS.into_iter().zip([share.sqrt(), share]) {
        // The second pass also collapses what the first could not.
        let share = triangles.len() as f64 * share / kept.len() as f64;
        let of_piece = |piece: &[u32]| {
            let triangles: Vec<_> = piece.iter().map(|&i| kept[i as usize]).collect();
            collapse_piece(positions, &triangles, share)
        };
        let mut order: Vec<u32> = (0..kept.len() as u32).collect();
        let pieces: Vec<_> = pieces(positions, &kept, &mut order, cut).into_par_iter().map(of_piece).collect();
        kept = Cow::Owned(pieces.concat());
    }
    kept.into_owned()
}

/// Simplifies a piece of a wall to about `share` of its triangles.
pub(super) fn collapse_piece(positions: &[[f32; 3]], triangles: &[[u32; 3]], share: f64) -> Vec<[u32; 3]> {
    let mut indices = triangles.as_flattened().to_vec();
    let vertices = number(&mut indices);
    let points: Vec<[f32; 3]> = vertices.iter().map(|&v| positions[v as usize]).collect();
    let adapter = VertexDataAdapter::new(bytemuck::cast_slice(&points), size_of::<[f32; 3]>(), 0)
        .expect("positions are a whole number of items");
    let target = (triangles.len() as f64 * share) as usize * 3;
    // An error of 1 is the extent of the surface, so the error is not limited.
    let kept = simplify(&indices, &adapter, target, 1.0, SimplifyOptions::LockBorder, None);
    let (kept, _) = kept.as_chunks::<3>();
    kept.iter().map(|t| t.map(|local| vertices[local as usize])).collect()
}

/// Cuts a wall into pieces of at most [`PIECE`] triangles. A piece is cut at the fraction `cut` of
/// its triangles, across the axis along which the cut intersects the fewest triangles. `order`
/// initially contains all triangles; it is rearranged by pieces, and sorted within each piece.
fn pieces<'a>(positions: &[[f32; 3]], triangles: &[[u32; 3]], order: &'a mut [u32], cut: f64) -> Vec<&'a [u32]> {
    let (mut pieces, mut rest) = (Vec::new(), vec![order]);
    while let Some(piece) = rest.pop() {
        if piece.len() <= PIECE {
            piece.sort_unstable();
            pieces.push(&*piece);
            continue;
        }
        let place = |axis: usize, i: u32| triangles[i as usize].map(|v| positions[v as usize][axis]);
        let at = |axis: usize| {
            let middle = |&i: &u32| place(axis, i).iter().sum::<f32>() / 3.0;
            let mut sample: Vec<f32> = piece.iter().step_by(piece.len().div_ceil(SAMPLE)).map(middle).collect();
            let nth = (sample.len() as f64 * cut) as usize;
            *sample.select_nth_unstable_by(nth, f32::total_cmp).1
        };
        // Number of corners of a triangle below the cut.
        let below = |(axis, plane): (usize, f32), i: u32| place(axis, i).iter().filter(|&&x| x < plane).count();
        let met = |&plane: &(usize, f32)| piece.iter().filter(|&&i| below(plane, i) % 3 != 0).count();
        let best = [0, 1, 2].map(|axis| (axis, at(axis))).into_iter().min_by_key(met).expect("there are three");
        let mut first = 0;
        for k in 0..piece.len() {
            if below(best, piece[k]) >= 2 {
                piece.swap(first, k);
                first += 1;
            }
        }
        if first == 0 || first == piece.len() {
            first = piece.len() / 2;
        }
        let (lower, upper) = piece.split_at_mut(first);
        rest.extend([upper, lower]);
    }
    pieces
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(12))]

        #[test]
        fn pieces_are_small_and_have_each_triangle_once(
            positions in prop::collection::vec(prop::array::uniform3((-9i8..9).prop_map(f32::from)), 1..60),
            count in 1..5 * PIECE,
            seed in any::<u32>(),
            cut in 0.2..0.8,
        ) {
            let vertex = |i: usize| (i as u32).wrapping_mul(seed | 1) % positions.len() as u32;
            let triangles: Vec<[u32; 3]> = (0..count).map(|i| [i, i + 1, i + 7].map(vertex)).collect();
            let mut order: Vec<u32> = (0..count as u32).collect();
            let pieces = pieces(&positions, &triangles, &mut order, cut);
            prop_assert!(pieces.iter().all(|piece| piece.len() <= PIECE && piece.is_sorted()));
            prop_assert!(count <= PIECE || pieces.len() > 1);
            order.sort_unstable();
            prop_assert!(order.into_iter().eq(0..count as u32));
        }
    }

    #[test]
    fn a_tube_is_cut_lengthwise_where_that_meets_fewer_triangles() {
        // The tube has few rings with many vertices each.
        let mesh = crate::model::sample::tube(2000, 4, 0.0);
        let wall = &mesh.triangles[mesh.patches[0].triangles.clone()];
        let mut order: Vec<u32> = (0..wall.len() as u32).collect();
        let pieces = pieces(&mesh.positions, wall, &mut order, 0.5);
        let slabs = |piece: &&[u32]| {
            let slab = |&i: &u32| wall[i as usize].map(|v| mesh.positions[v as usize][2].to_bits()).into_iter().min();
            piece.iter().map(slab).collect::<std::collections::HashSet<_>>().len()
        };
        let slabs: Vec<usize> = pieces.iter().map(slabs).collect();
        assert!(slabs.len() >= 4 && slabs.iter().all(|&slabs| slabs == 4), "{slabs:?}");
    }
}
