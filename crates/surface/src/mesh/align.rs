//! Matches the vertices of consecutive rings, and interpolates sections.
//!
//! Ids never disappear, and new ids appear only between two old neighbours. The later ring, rotated
//! to begin with the first id of the earlier ring, is therefore the earlier ring with runs of new
//! vertices in between.

use super::error::{LoftError, Wall};
use crate::model::{Ring, Section};

/// Correspondence of two consecutive rings.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Alignment {
    /// Index in the later ring of the vertex that continues the earlier ring's vertex 0.
    pub(super) turn: usize,
    /// Number of new vertices between each earlier vertex and its old neighbour.
    pub(super) new_after: Vec<u32>,
}

/// Aligns two rings by their ids. Returns [`LoftError::Continuation`] if an id is missing or out of
/// order.
pub(super) fn align(earlier: &[u32], later: &[u32], wall: Wall, step: f64) -> Result<Alignment, LoftError> {
    let lost = |id: u32| LoftError::Continuation { step, wall, id };
    let first = earlier[0];
    let turn = later.iter().position(|&id| id == first).ok_or_else(|| lost(first))?;
    let turned = later[turn..].iter().chain(&later[..turn]);
    let mut new_after = vec![0u32; earlier.len()];
    let mut old = 0;
    for &id in turned.skip(1) {
        if earlier.get(old + 1) == Some(&id) {
            old += 1;
        } else {
            new_after[old] += 1;
        }
    }
    match earlier.get(old + 1) {
        Some(&id) => Err(lost(id)),
        None => Ok(Alignment { turn, new_after }),
    }
}

/// Inserts the new vertices of a later ring into an earlier one. `m` new vertices divide an edge
/// into `m + 1` equal parts, so a single vertex is the midpoint, as in growth. Each coordinate is
/// rounded once.
pub(super) fn insert(points: &[[f32; 2]], new_after: &[u32]) -> Vec<[f32; 2]> {
    let n = points.len();
    let mut result = Vec::with_capacity(n + new_after.iter().sum::<u32>() as usize);
    for (i, &count) in new_after.iter().enumerate() {
        let (a, b) = (points[i], points[(i + 1) % n]);
        result.push(a);
        for k in 1..=count {
            let t = f64::from(k) / f64::from(count + 1);
            result.push(between(a, b, t));
        }
    }
    result
}

/// Section halfway between two sections, on the straight paths of the vertices. Vertices that are
/// new in the later section start on the edges of the earlier one.
pub(super) fn halfway(earlier: &Section, later: &Section) -> Result<Section, LoftError> {
    let step = 0.5 * (earlier.step + later.step);
    let ring = |a: &Ring, b: &Ring, wall| -> Result<Ring, LoftError> {
        let Alignment { turn, new_after } = align(&a.ids, &b.ids, wall, later.step)?;
        let turned = |i: usize| (i + turn) % b.len();
        let start = insert(&a.points, &new_after);
        let points = start.iter().enumerate().map(|(i, &p)| between(p, b.points[turned(i)], 0.5)).collect();
        let ids = (0..b.len()).map(|i| b.ids[turned(i)]).collect();
        Ok(Ring { ids, points })
    };
    Ok(Section {
        step,
        z_um: 0.5 * (earlier.z_um + later.z_um),
        added: true,
        inner: ring(&earlier.inner, &later.inner, Wall::Inner)?,
        outer: ring(&earlier.outer, &later.outer, Wall::Outer)?,
    })
}

fn between(a: [f32; 2], b: [f32; 2], t: f64) -> [f32; 2] {
    let at = |axis: usize| {
        let (a, b) = (f64::from(a[axis]), f64::from(b[axis]));
        ((1.0 - t) * a + t * b) as f32
    };
    [at(0), at(1)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_of_new_ids_are_counted_whatever_the_turn() {
        let later = [9, 3, 8, 7, 1, 2, 6];
        let found = align(&[1, 2, 3], &later, Wall::Inner, 5.0).unwrap();
        assert_eq!(found, Alignment { turn: 4, new_after: vec![0, 2, 2] });
    }

    #[test]
    fn lost_or_disordered_ids_are_named() {
        let align = |later: &[u32]| align(&[1, 2, 3], later, Wall::Outer, 5.0);
        let lost = |id| LoftError::Continuation { step: 5.0, wall: Wall::Outer, id };
        assert_eq!(align(&[2, 3]), Err(lost(1)));
        assert_eq!(align(&[1, 3, 4]), Err(lost(2)));
        assert_eq!(align(&[1, 3, 2]), Err(lost(3)));
    }

    #[test]
    fn inserted_vertices_divide_an_edge_evenly() {
        let points = [[0.0, 0.0], [3.0, 0.0], [0.0, 3.0]];
        let refined = insert(&points, &[2, 0, 1]);
        let expected = [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0], [0.0, 3.0], [0.0, 1.5]];
        assert_eq!(refined, expected);
    }
}
