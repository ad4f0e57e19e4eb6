//! Small surfaces for tests.

use crate::model::{BodyKind, Mesh, Ring, Section};

#[path = "../../../../../benches/common/tube.rs"]
mod tube;

/// Positions and triangles.
pub(super) type Soup = (Vec<[f64; 3]>, Vec<[u32; 3]>);

pub(super) fn tetrahedron(size: f64, at: [f64; 3]) -> Soup {
    let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    (moved(&corners, size, at), vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
}

pub(super) fn cube(size: f64, at: [f64; 3]) -> Soup {
    let corners: Vec<[f64; 3]> = (0..8).map(|i| [0, 1, 2].map(|axis| f64::from((i >> axis) & 1))).collect();
    let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = faces.iter().flat_map(|f| [[f[0], f[1], f[2]], [f[0], f[2], f[3]]]).collect();
    (moved(&corners, size, at), triangles)
}

pub(super) fn torus(n: u32, m: u32) -> Soup {
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    for i in 0..n {
        for j in 0..m {
            let (u, v) = (
                std::f64::consts::TAU * f64::from(i) / f64::from(n),
                std::f64::consts::TAU * f64::from(j) / f64::from(m),
            );
            let r = 3.0 + v.cos();
            positions.push([r * u.cos(), r * u.sin(), v.sin()]);
            let at = |i: u32, j: u32| (i % n) * m + j % m;
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    (positions, triangles)
}

fn moved(points: &[[f64; 3]], size: f64, at: [f64; 3]) -> Vec<[f64; 3]> {
    points.iter().map(|p| [0, 1, 2].map(|axis| p[axis] * size + at[axis])).collect()
}

/// Several surfaces as one.
pub(super) fn together(parts: impl IntoIterator<Item = Soup>) -> Soup {
    let mut all = Soup::default();
    for (positions, triangles) in parts {
        let base = all.0.len() as u32;
        all.0.extend(positions);
        all.1.extend(triangles.into_iter().map(|t| t.map(|v| v + base)));
    }
    all
}

pub(super) fn flipped((positions, triangles): Soup) -> Soup {
    (positions, triangles.into_iter().map(|[a, b, c]| [a, c, b]).collect())
}

/// A folded tube and its sections.
pub(super) fn folded_tube(sections: usize, inner: usize, outer: usize, folds: usize) -> (Mesh, Vec<Section>) {
    let tube = tube::tube(sections, inner, outer, folds);
    let ring = |points: Vec<[f32; 2]>| Ring { ids: (0..points.len() as u32).collect(), points };
    let sections = tube
        .sections
        .into_iter()
        .map(|(z_um, inner, outer)| Section { z_um, inner: ring(inner), outer: ring(outer), ..Section::default() })
        .collect();
    let mesh =
        Mesh { body: BodyKind::Tissue, positions: tube.positions, triangles: tube.triangles, patches: Vec::new() };
    (mesh, sections)
}
