//! Coordinates on the walls of a lofted surface: the distance around the ring of a section, and the
//! place along the tube.

use crate::geometry::vector::distance;
use crate::model::{Mesh, PatchKind};

/// No vertex.
const NONE: u32 = u32::MAX;

/// Computes the coordinates of each vertex of a straight tube that is lofted from sections, µm.
///
/// The first coordinate is the length of the shorter way along the ring of the section from a line
/// that runs along the wall. It is continuous everywhere, because both ways are equally long on the
/// opposite side. The second one is z. Vertices of no wall have zeros. `None` if the walls do not
/// consist of rings at constant z.
#[must_use]
pub fn unwrap(straight: &Mesh) -> Option<Vec<[f32; 2]>> {
    let mut found = vec![[0.0; 2]; straight.positions.len()];
    for kind in [PatchKind::InnerWall, PatchKind::OuterWall] {
        unwrap_wall(straight, kind, &mut found)?;
    }
    Some(found)
}

fn unwrap_wall(straight: &Mesh, kind: PatchKind, found: &mut [[f32; 2]]) -> Option<()> {
    let positions = &straight.positions;
    let z = |v: u32| positions[v as usize][2];
    let across = |a: u32, b: u32| {
        let [p, q] = [a, b].map(|v| positions[v as usize]);
        distance([p[0], p[1]].map(f64::from), [q[0], q[1]].map(f64::from))
    };
    // The next vertex of each ring, and the nearest vertex of the next ring.
    let (mut next, mut above) = (vec![NONE; positions.len()], vec![NONE; positions.len()]);
    let (mut count, mut lowest) = (0, NONE);
    for &[a, b, c] in straight.patch(kind) {
        for [a, b, c] in [[a, b, c], [b, c, a], [c, a, b]] {
            if lowest == NONE || (z(a), a) < (z(lowest), lowest) {
                lowest = a;
            }
            if z(a) == z(b) {
                // An edge has opposite directions in the triangles above and below it.
                let (from, to) = if z(c) > z(a) { (a, b) } else { (b, a) };
                count += usize::from(next[from as usize] == NONE);
                next[from as usize] = to;
            }
            for (low, high) in [(a, b), (b, a)] {
                let best = &mut above[low as usize];
                if z(low) < z(high) && (*best == NONE || across(low, high) < across(low, *best)) {
                    *best = high;
                }
            }
        }
    }
    let mut first = lowest;
    let mut ring: Vec<(u32, f64)> = Vec::new();
    while first != NONE {
        ring.clear();
        let (mut at, mut along) = (first, 0.0);
        loop {
            ring.push((at, along));
            let to = *next.get(at as usize).filter(|to| **to != NONE)?;
            along += across(at, to) * 1e6;
            at = to;
            if at == first {
                break;
            }
            if ring.len() > count {
                return None;
            }
        }
        for &(v, way) in &ring {
            found[v as usize] = [way.min(along - way) as f32, z(v) * 1e6];
        }
        count = count.checked_sub(ring.len())?;
        first = above[first as usize];
    }
    (count == 0 && lowest != NONE).then_some(())
}

#[cfg(test)]
mod tests {
    use super::super::draft;
    use super::*;
    use crate::model::sample;

    #[test]
    fn coordinates_measure_the_way_around_and_along() {
        let mesh = sample::tube(96, 4, 0.0);
        let found = unwrap(&mesh).unwrap();
        let circumference = 96.0 * 2.0 * (std::f64::consts::PI / 96.0).sin();
        for (kind, radius_um) in [(PatchKind::InnerWall, 500.0), (PatchKind::OuterWall, 1000.0)] {
            let used: Vec<usize> = mesh.patch(kind).iter().flatten().map(|&v| v as usize).collect();
            let farthest = used.iter().map(|&v| found[v][0]).fold(0.0, f32::max);
            assert!((f64::from(farthest) / (0.5 * circumference * radius_um) - 1.0).abs() < 1e-3, "{farthest}");
            assert!(used.iter().all(|&v| found[v][1] == mesh.positions[v][2] * 1e6));
            // Neighbours on a ring are as far apart as their coordinates say.
            for &[a, b, _] in mesh.patch(kind) {
                let [p, q] = [a, b].map(|v| mesh.positions[v as usize].map(f64::from));
                let off = distance([p[0], p[1]], [q[0], q[1]]) * 1e6;
                let around = f64::from((found[a as usize][0] - found[b as usize][0]).abs());
                assert!(p[2] != q[2] || (around - off).abs() < 0.1, "{around} and {off}");
            }
        }
    }

    #[test]
    fn no_triangle_spans_a_seam() {
        let sections: Vec<_> = (0..6).map(|k| sample::section(90, f64::from(k), 200.0 * f64::from(k))).collect();
        let mesh = draft(&sections).unwrap();
        let found = unwrap(&mesh).unwrap();
        for kind in [PatchKind::InnerWall, PatchKind::OuterWall] {
            for &[a, b, c] in mesh.patch(kind) {
                let around = [a, b, c].map(|v| found[v as usize][0]);
                let span = around.iter().fold(0.0, |span: f32, x| span.max((x - around[0]).abs()));
                assert!(span < 250.0, "{around:?}");
            }
        }
    }

    #[test]
    fn a_wall_without_rings_has_no_coordinates() {
        let mut mesh = sample::tube(24, 4, 0.2);
        for (k, p) in mesh.positions.iter_mut().enumerate() {
            p[2] += 1e-6 * (k % 3) as f32;
        }
        assert_eq!(unwrap(&mesh), None);
    }
}
