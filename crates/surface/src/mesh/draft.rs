//! Drafts for pictures: lofts any selection of the sections of a model, without tests and mending.

use super::align::{Alignment, align};
use super::error::{LoftError, Wall};
use super::loft::{Front, ampulla_cap, assembled, check_form, exported, isthmus_cap, joined, metres, turned};
use crate::model::{Mesh, Section};

/// Lofts `sections`, in order along the tube, into a closed surface with the patches of
/// [`Lofter::finish`](super::Lofter::finish).
///
/// The vertices are the points of the sections. Where sections are far apart, walls may intersect,
/// because nothing is tested.
///
/// # Errors
/// - [`LoftError::NoSlab`]: fewer than two sections
/// - [`LoftError::Ids`], [`LoftError::Contour`]: a section is malformed
/// - [`LoftError::Order`], [`LoftError::Continuation`]: a section does not continue the previous
///   one
/// - [`LoftError::Cap`]: an end cannot be closed
pub fn draft(sections: &[Section]) -> Result<Mesh, LoftError> {
    let [first, rest @ ..] = sections else { return Err(LoftError::NoSlab) };
    check_form(first)?;
    let mut positions = Vec::with_capacity(sections.iter().map(Section::particles).sum());
    let isthmus = level(first, [0, 0], &mut positions);
    let mut walls = [Vec::new(), Vec::new()];
    let mut front: Option<Front> = None;
    let mut below_um = first.z_um;
    for section in rest {
        check_form(section)?;
        if !(section.z_um > below_um && section.z_um.is_finite()) {
            return Err(LoftError::Order { step: section.step, z_um: section.z_um });
        }
        below_um = section.z_um;
        let lower = front.as_ref().unwrap_or(&isthmus);
        let inner = align(&lower.ids[0], &section.inner.ids, Wall::Inner, section.step)?;
        let outer = align(&lower.ids[1], &section.outer.ids, Wall::Outer, section.step)?;
        let upper = level(section, [inner.turn, outer.turn], &mut positions);
        let [inner_wall, outer_wall] = &mut walls;
        // The triangles of the inner wall face the lumen.
        slab(lower, &upper, &inner, 0, &positions, |[a, b, c]| inner_wall.push([a, c, b]));
        slab(lower, &upper, &outer, 1, &positions, |triangle| outer_wall.push(triangle));
        front = Some(upper);
    }
    let front = front.ok_or(LoftError::NoSlab)?;
    let [inner_wall, outer_wall] = walls;
    let bottom = isthmus_cap(&isthmus.rim, &isthmus.vertices)?;
    let top = ampulla_cap(&front.rim, &front.vertices)?;
    Ok(assembled(positions, [inner_wall, outer_wall, bottom, top]))
}

/// Appends the points of a section, with its rings rotated by `turns`.
fn level(section: &Section, turns: [usize; 2], positions: &mut Vec<[f32; 3]>) -> Front {
    let rim = joined(&exported(&section.inner, turns[0]), &exported(&section.outer, turns[1]));
    let first = positions.len() as u32;
    let z = metres(section.z_um);
    positions.extend(rim.points.iter().map(|p| [p[0], p[1], z]));
    Front {
        rim,
        ids: [turned(&section.inner.ids, turns[0]), turned(&section.outer.ids, turns[1])],
        vertices: (first..positions.len() as u32).collect(),
        z,
    }
}

/// Emits the triangles of one wall between two sections, facing away from the axis.
///
/// Each lower edge is joined to the upper chain between the same two ids. The first half of the
/// chain fans from the start of the edge, the second half from its end, and a triangle on the lower
/// edge lies between them.
fn slab(
    lower: &Front,
    upper: &Front,
    alignment: &Alignment,
    wall: usize,
    positions: &[[f32; 3]],
    mut emit: impl FnMut([u32; 3]),
) {
    let (low, high) = (lower.ring(wall), upper.ring(wall));
    let squared = |a: u32, b: u32| {
        let [p, q] = [a, b].map(|v| positions[v as usize]);
        (p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2)
    };
    let mut start = 0;
    for (i, &new) in alignment.new_after.iter().enumerate() {
        let (a, b) = (low[i], low[(i + 1) % low.len()]);
        let edges = new as usize + 1;
        let chain = |k: usize| high[(start + k) % high.len()];
        let half = match edges {
            1 => usize::from(squared(a, chain(1)) <= squared(b, chain(0))),
            _ => edges / 2,
        };
        emit([a, b, chain(half)]);
        for k in 0..edges {
            emit([if k < half { a } else { b }, chain(k + 1), chain(k)]);
        }
        start += edges;
    }
}

#[cfg(test)]
mod tests {
    use super::super::Lofter;
    use super::super::samples::{Dice, Folds};
    use super::*;
    use std::collections::HashSet;

    fn sections(count: u32) -> Vec<Section> {
        let mut dice = Dice(5);
        let mut folds = Folds::new(60, 12, 5.0, 40.0);
        let mut sections = Vec::new();
        for step in 0..count {
            sections.push(folds.section(f64::from(step)));
            folds.grow(7, 2, &mut dice);
        }
        sections
    }

    #[test]
    fn any_selection_of_sections_gives_a_closed_surface_around_the_same_volume() {
        let sections = sections(13);
        let volume = |mesh: &Mesh| -> f64 {
            let of = |t: &[u32; 3]| {
                let [a, b, c] = t.map(|v| glam::Vec3::from(mesh.positions[v as usize]).as_dvec3());
                a.dot(b.cross(c)) / 6.0
            };
            mesh.triangles.iter().map(of).sum()
        };
        let mut lofter = Lofter::new(sections[0].clone()).unwrap();
        for section in &sections[1..] {
            lofter.advance(std::slice::from_ref(section)).unwrap();
        }
        let whole = volume(&lofter.finish().unwrap());
        for stride in [1, 3, 4] {
            let chosen: Vec<Section> = sections.iter().step_by(stride).cloned().collect();
            let mesh = draft(&chosen).unwrap();
            assert_eq!(mesh.positions.len(), chosen.iter().map(Section::particles).sum::<usize>());
            let edges: HashSet<_> =
                mesh.triangles.iter().flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])]).collect();
            assert_eq!(edges.len(), 3 * mesh.triangles.len());
            assert!(edges.iter().all(|&(a, b)| edges.contains(&(b, a))), "stride {stride}");
            let euler = mesh.positions.len() as i64 - edges.len() as i64 / 2 + mesh.triangles.len() as i64;
            assert_eq!(euler, mesh.body.euler());
            assert!((volume(&mesh) / whole - 1.0).abs() < 0.02, "stride {stride}: {} of {whole}", volume(&mesh));
            let covered: Vec<_> = mesh.patches.iter().flat_map(|patch| patch.triangles.clone()).collect();
            assert_eq!(covered, (0..mesh.triangles.len()).collect::<Vec<_>>());
        }
    }

    #[test]
    fn sections_that_do_not_follow_each_other_are_refused() {
        let sections = sections(3);
        assert_eq!(draft(&sections[..1]), Err(LoftError::NoSlab));
        let turned: Vec<Section> = sections.iter().rev().cloned().collect();
        assert!(matches!(draft(&turned), Err(LoftError::Order { .. })));
        let mut other = sections.clone();
        other[1].inner.ids[3] += 1000;
        assert!(matches!(draft(&other), Err(LoftError::Continuation { wall: Wall::Inner, .. })));
    }
}
