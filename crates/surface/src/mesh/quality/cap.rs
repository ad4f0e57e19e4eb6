//! The ends of the tissue and of the lumen: plane regions between the rims of the walls.

use crate::geometry::triangulate::{TriangulateError, refined};

/// Fills the annulus between two rims; adds the vertices needed to `positions`. The triangles face up the tube.
pub(super) fn annulus(
    positions: &mut Vec<[f32; 3]>,
    inner: &[u32],
    outer: &[u32],
    resolution_um: f64,
) -> Result<Vec<[u32; 3]>, TriangulateError> {
    fill(positions, &[inner], outer, resolution_um)
}

/// Fills the disc within a rim, like [`annulus`].
pub(super) fn disc(
    positions: &mut Vec<[f32; 3]>,
    rim: &[u32],
    resolution_um: f64,
) -> Result<Vec<[u32; 3]>, TriangulateError> {
    fill(positions, &[], rim, resolution_um)
}

fn fill(
    positions: &mut Vec<[f32; 3]>,
    holes: &[&[u32]],
    outer: &[u32],
    resolution_um: f64,
) -> Result<Vec<[u32; 3]>, TriangulateError> {
    let flat = |rim: &[u32]| -> Vec<[f32; 2]> {
        rim.iter().map(|&v| [positions[v as usize][0], positions[v as usize][1]]).collect()
    };
    let rims: Vec<Vec<[f32; 2]>> = holes.iter().copied().map(flat).collect();
    let z = positions[outer[0] as usize][2];
    let edge = resolution_um * 1e-6;
    // The area of an equilateral triangle, and some more, since it is the greatest that is allowed.
    let region = refined(&rims.iter().map(Vec::as_slice).collect::<Vec<_>>(), &flat(outer), 0.6 * edge * edge)?;
    let mut vertices: Vec<u32> = holes.iter().copied().chain([outer]).flatten().copied().collect();
    for [x, y] in region.added {
        vertices.push(positions.len() as u32);
        positions.push([x, y, z]);
    }
    Ok(region.triangles.into_iter().map(|t| t.map(|i| vertices[i as usize])).collect())
}
