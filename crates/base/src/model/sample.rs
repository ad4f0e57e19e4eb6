//! Small valid models for tests.

use super::{BodyKind, Mesh, Patch, PatchKind, Ring, Section};
use std::f32::consts::TAU;

/// Tissue between two tubes of `n` corners: a closed surface of 4 patches and 4·n·(slabs + 1)
/// triangles, oriented outwards.
///
/// Outer radius 1 mm, inner radius 0.5 mm · (1 + fold · cos 6θ), length 4 mm.
pub fn tube(n: u32, slabs: u32, fold: f32) -> Mesh {
    let rings = slabs + 1;
    let mut positions = Vec::new();
    for wall in 0..2 {
        for k in 0..rings {
            for i in 0..n {
                let angle = TAU * (i as f32 + 0.5) / n as f32;
                let radius = if wall == 0 { 5e-4 * (1.0 + fold * (6.0 * angle).cos()) } else { 1e-3 };
                // Rounded, because the last bits of a cosine differ between machines and some tests
                // use snapshots.
                let round = |x: f32| (x * 1e6).round() / 1e6;
                positions.push([
                    round(radius * angle.cos()),
                    round(radius * angle.sin()),
                    4e-3 * k as f32 / slabs as f32,
                ]);
            }
        }
    }
    let at = |wall: u32, k: u32, i: u32| (wall * rings + k) * n + i % n;
    let mut triangles: Vec<[u32; 3]> = Vec::new();
    let mut patches = Vec::new();
    for (wall, kind) in [(0, PatchKind::InnerWall), (1, PatchKind::OuterWall)] {
        let start = triangles.len();
        for k in 0..slabs {
            for i in 0..n {
                let corners = [at(wall, k, i), at(wall, k, i + 1), at(wall, k + 1, i + 1), at(wall, k + 1, i)];
                quad(&mut triangles, corners, wall == 0);
            }
        }
        patches.push(Patch { kind, triangles: start..triangles.len() });
    }
    for (k, kind) in [(0, PatchKind::CapIsthmus), (slabs, PatchKind::CapAmpulla)] {
        let start = triangles.len();
        for i in 0..n {
            quad(&mut triangles, [at(0, k, i), at(1, k, i), at(1, k, i + 1), at(0, k, i + 1)], k == 0);
        }
        patches.push(Patch { kind, triangles: start..triangles.len() });
    }
    Mesh { body: BodyKind::Tissue, positions, triangles, patches }
}

fn quad(triangles: &mut Vec<[u32; 3]>, [a, b, c, d]: [u32; 4], turned: bool) {
    triangles.extend(if turned { [[a, c, b], [a, d, c]] } else { [[a, b, c], [a, c, d]] });
}

/// A section with `n` points per ring: a folded lumen in a round tube of radius 1 mm.
pub fn section(n: u32, step: f64, z_um: f64) -> Section {
    let ring = |radius: f32, fold: f32| Ring {
        ids: (0..n).map(|i| (i * 7) % n.max(1)).collect(),
        points: (0..n)
            .map(|i| {
                let angle = TAU * i as f32 / n as f32;
                let r = radius * (1.0 + fold * (9.0 * angle).cos());
                [r * angle.cos(), r * angle.sin()]
            })
            .collect(),
    };
    Section { step, z_um, added: step.fract() != 0.0, inner: ring(550.0, 0.4), outer: ring(1000.0, 0.0) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn the_tube_is_closed_and_oriented_outwards() {
        let mesh = tube(12, 3, 0.3);
        let edges: HashSet<_> =
            mesh.triangles.iter().flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])]).collect();
        assert_eq!(edges.len(), 3 * mesh.triangles.len());
        assert!(edges.iter().all(|&(a, b)| edges.contains(&(b, a))));
        let euler = mesh.positions.len() as i64 - edges.len() as i64 / 2 + mesh.triangles.len() as i64;
        assert_eq!(euler, mesh.body.euler());
        let volume: f64 = mesh
            .triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|v| glam::Vec3::from(mesh.positions[v as usize]).as_dvec3());
                a.dot(b.cross(c)) / 6.0
            })
            .sum();
        assert!(volume > 0.0);
    }
}
