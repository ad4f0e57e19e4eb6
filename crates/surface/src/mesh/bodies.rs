//! The lumen as a separate body: lids close the inner wall at both ends.
//!
//! Lids use only vertices of the rims of the inner wall. The two bodies therefore conform: their
//! common wall has the same vertices and triangles in both.

use super::error::LoftError;
use crate::geometry::polygon::signed_area;
use crate::geometry::triangulate::disc;
use crate::model::{BodyKind, Mesh, Patch, PatchKind};
use std::collections::{HashMap, HashSet};

/// Returns both bodies in one mesh: the triangles of the tissue, then the lids as patches `inlet`
/// and `outlet`. The vertices are those of the tissue.
///
/// # Errors
/// Returns [`LoftError::Cap`] if a lid cannot be triangulated, and [`LoftError::Rim`] if a cap has
/// no rim at the inner wall.
pub fn regions(tissue: &Mesh) -> Result<Mesh, LoftError> {
    let mut is_inner = vec![false; tissue.positions.len()];
    for &v in tissue.patch(PatchKind::InnerWall).iter().flatten() {
        is_inner[v as usize] = true;
    }
    let mut regions = Mesh { body: BodyKind::Regions, ..tissue.clone() };
    for (cap, kind, end) in
        [(PatchKind::CapIsthmus, PatchKind::Inlet, "isthmus"), (PatchKind::CapAmpulla, PatchKind::Outlet, "ampulla")]
    {
        let rim = rim(tissue.patch(cap), &is_inner).ok_or(LoftError::Rim { end })?;
        let start = regions.triangles.len();
        regions.triangles.extend(lid(tissue, &rim, end)?);
        regions.patches.push(Patch { kind, triangles: start..regions.triangles.len() });
    }
    Ok(regions)
}

/// Returns the lumen alone, from the mesh of [`regions`]: the inner wall with reversed triangles,
/// and the lids. Its vertices keep their order.
#[must_use]
pub fn lumen(regions: &Mesh) -> Mesh {
    let parts = [
        (PatchKind::InnerWall, PatchKind::Wall),
        (PatchKind::Inlet, PatchKind::Inlet),
        (PatchKind::Outlet, PatchKind::Outlet),
    ];
    let mut is_used = vec![false; regions.positions.len()];
    for &v in parts.iter().flat_map(|&(kind, _)| regions.patch(kind)).flatten() {
        is_used[v as usize] = true;
    }
    let mut positions = Vec::new();
    let index: Vec<u32> = (is_used.iter().zip(&regions.positions))
        .map(|(&is_used, &p)| {
            let index = positions.len() as u32;
            if is_used {
                positions.push(p);
            }
            index
        })
        .collect();
    let (mut triangles, mut patches) = (Vec::new(), Vec::new());
    for (from, kind) in parts {
        let start = triangles.len();
        triangles.extend(regions.patch(from).iter().map(|t| {
            let [a, b, c] = t.map(|v| index[v as usize]);
            if kind == PatchKind::Wall { [a, c, b] } else { [a, b, c] }
        }));
        patches.push(Patch { kind, triangles: start..triangles.len() });
    }
    Mesh { body: BodyKind::Lumen, positions, triangles, patches }
}

/// Border of a cap at the inner wall, in the direction in which the triangles of the cap run along
/// it, from its smallest vertex. `None` if the border is not one closed loop.
fn rim(cap: &[[u32; 3]], is_inner: &[bool]) -> Option<Vec<u32>> {
    let mut next: HashMap<u32, u32> = HashMap::new();
    let edges = || cap.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]);
    let inside: HashSet<(u32, u32)> = edges().collect();
    for (a, b) in edges() {
        let is_rim = is_inner[a as usize] && is_inner[b as usize] && !inside.contains(&(b, a));
        if is_rim && next.insert(a, b).is_some() {
            return None;
        }
    }
    let first = *next.keys().min()?;
    let mut rim = vec![first];
    let mut at = *next.get(&first)?;
    while at != first {
        rim.push(at);
        if rim.len() > next.len() {
            return None;
        }
        at = *next.get(&at)?;
    }
    (rim.len() == next.len()).then_some(rim)
}

/// Closes a rim with triangles that face the same way as the cap around it.
fn lid(tissue: &Mesh, rim: &[u32], end: &'static str) -> Result<Vec<[u32; 3]>, LoftError> {
    let at = |v: u32| [tissue.positions[v as usize][0], tissue.positions[v as usize][1]];
    // The lid runs along the rim against the direction of the cap.
    let mut rim: Vec<u32> = rim.iter().rev().copied().collect();
    let mut contour: Vec<[f32; 2]> = rim.iter().map(|&v| at(v)).collect();
    // Seen from above, a lid that faces down the tube is clockwise.
    let is_turned = signed_area(&contour) < 0.0;
    if is_turned {
        rim.reverse();
        contour.reverse();
    }
    let triangles = disc(&contour).map_err(|source| LoftError::Cap { end, source })?;
    let turn = |[a, b, c]: [u32; 3]| if is_turned { [a, c, b] } else { [a, b, c] };
    Ok(triangles.into_iter().map(|t| turn(t.map(|i| rim[i as usize]))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::sample;

    fn edges(triangles: &[[u32; 3]]) -> HashSet<(u32, u32)> {
        triangles.iter().flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])]).collect()
    }

    fn volume(mesh: &Mesh) -> f64 {
        let corner = |v: u32| glam::Vec3::from(mesh.positions[v as usize]).as_dvec3();
        mesh.triangles.iter().map(|t| corner(t[0]).dot(corner(t[1]).cross(corner(t[2]))) / 6.0).sum()
    }

    #[test]
    fn the_lumen_is_closed_and_conforms_to_the_tissue() {
        let tissue = sample::tube(36, 5, 0.4);
        let regions = regions(&tissue).unwrap();
        assert_eq!(regions.positions, tissue.positions);
        assert_eq!(regions.triangles[..tissue.triangles.len()], tissue.triangles[..]);
        let names: Vec<_> = regions.patches.iter().map(|p| p.kind.name()).collect();
        assert_eq!(names, ["inner_wall", "outer_wall", "cap_isthmus", "cap_ampulla", "inlet", "outlet"]);

        let lumen = lumen(&regions);
        let borders = edges(&lumen.triangles);
        assert_eq!(borders.len(), 3 * lumen.triangles.len());
        assert!(borders.iter().all(|&(a, b)| borders.contains(&(b, a))));
        let euler = lumen.positions.len() as i64 - borders.len() as i64 / 2 + lumen.triangles.len() as i64;
        assert_eq!(euler, lumen.body.euler());
        assert!(volume(&lumen) > 0.0);

        let corners = |mesh: &Mesh, kind| -> Vec<[[f32; 3]; 3]> {
            mesh.patch(kind).iter().map(|t| t.map(|v| mesh.positions[v as usize])).collect()
        };
        let turned: Vec<_> = corners(&lumen, PatchKind::Wall).into_iter().map(|[a, b, c]| [a, c, b]).collect();
        assert_eq!(turned, corners(&tissue, PatchKind::InnerWall));
    }

    #[test]
    fn the_outside_of_both_encloses_the_volume_of_both() {
        let tissue = sample::tube(36, 5, 0.4);
        let regions = regions(&tissue).unwrap();
        let mut outside = regions.clone();
        let inner = regions.patches[0].triangles.clone();
        outside.triangles.drain(inner);
        let borders = edges(&outside.triangles);
        assert!(borders.iter().all(|&(a, b)| borders.contains(&(b, a))));
        let sum = volume(&tissue) + volume(&lumen(&regions));
        assert!((volume(&outside) / sum - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_surface_without_rims_is_refused() {
        let mut tissue = sample::tube(12, 2, 0.0);
        tissue.patches.retain(|patch| patch.kind != PatchKind::CapAmpulla);
        assert_eq!(regions(&tissue), Err(LoftError::Rim { end: "ampulla" }));
    }
}
