//! Gates of a row: straight lines across the lumen between two vertices of the mucosa.
//!
//! The gates are the edges of a triangulation of the lumen. Two gates of a triangle are neighbours.
//! Because columns continue from row to row, so do gates, even where the surface leans.

use crate::geometry::triangulate::{Linked, NO_NEIGHBOUR, TriangulateError, perforated};

/// A gate between two vertices of a row, by their indices in the row.
pub(super) type Gate = [u32; 2];

/// Gates of a row.
#[derive(Debug, Default)]
pub(super) struct Gates {
    pub(super) gates: Vec<Gate>,
    /// Gates in the same triangle, for each gate.
    pub(super) beside: Vec<Vec<u32>>,
    /// Gates at each vertex of the row.
    pub(super) at: Vec<Vec<u32>>,
}

impl Gates {
    /// Gates of the lumen in a contour.
    pub(super) fn of(contour: &[[f32; 2]]) -> Result<Self, TriangulateError> {
        let Linked { triangles, neighbours } = perforated(&[], contour)?;
        let mut found = Self { at: vec![Vec::new(); contour.len()], ..Self::default() };
        let mut of_triangle = vec![[None; 3]; triangles.len()];
        for (t, (triangle, others)) in triangles.iter().zip(&neighbours).enumerate() {
            for k in 0..3 {
                let other = others[k] as usize;
                if others[k] == NO_NEIGHBOUR || other < t {
                    continue;
                }
                let gate = [triangle[k], triangle[(k + 1) % 3]];
                let id = found.gates.len() as u32;
                found.gates.push(gate);
                gate.iter().for_each(|&vertex| found.at[vertex as usize].push(id));
                of_triangle[t][k] = Some(id);
                if let Some(side) = neighbours[other].iter().position(|&back| back as usize == t) {
                    of_triangle[other][side] = Some(id);
                }
            }
        }
        found.beside = vec![Vec::new(); found.gates.len()];
        for gates in of_triangle {
            for (a, b) in [(0, 1), (1, 2), (2, 0)] {
                if let (Some(a), Some(b)) = (gates[a], gates[b]) {
                    found.beside[a as usize].push(b);
                    found.beside[b as usize].push(a);
                }
            }
        }
        Ok(found)
    }
}
