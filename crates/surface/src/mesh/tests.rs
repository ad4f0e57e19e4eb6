//! Lofts of synthetic tubes, checked exactly in independent ways.

use std::collections::HashMap;

use super::mend::settle;
use super::samples::{Dice, Folds, Jostle};
use super::slab::{Diagonal, Rim, Slab};
use super::*;
use crate::geometry::strips::{strips, triangles_of_strip};
use crate::geometry::tri_tri::{Triangle, meet_in_mesh};
use crate::model::{Mesh, PatchKind, Ring, Section};

/// Asserts that the surface is closed and oriented without T-junctions: every directed edge and its
/// reverse occur once. Also asserts χ = 0, that all positions are used, and that patches cover the
/// triangles in order.
fn check_topology(mesh: &Mesh) {
    let mut edges: HashMap<(u32, u32), u32> = HashMap::new();
    let mut used = vec![false; mesh.positions.len()];
    for t in &mesh.triangles {
        for k in 0..3 {
            used[t[k] as usize] = true;
            *edges.entry((t[k], t[(k + 1) % 3])).or_default() += 1;
        }
    }
    for (&(a, b), &count) in &edges {
        assert_eq!(count, 1, "edge {a}-{b}");
        assert!(edges.contains_key(&(b, a)), "edge {a}-{b} is open");
    }
    assert!(used.iter().all(|&u| u));
    let (v, e, f) = (mesh.positions.len(), edges.len() / 2, mesh.triangles.len());
    assert_eq!(v as i64 - e as i64 + f as i64, 0);
    let kinds: Vec<PatchKind> = mesh.patches.iter().map(|p| p.kind).collect();
    let expected = [PatchKind::InnerWall, PatchKind::OuterWall, PatchKind::CapIsthmus, PatchKind::CapAmpulla];
    assert_eq!(kinds, expected);
    let mut from = 0;
    for patch in &mesh.patches {
        assert_eq!(patch.triangles.start, from);
        from = patch.triangles.end;
    }
    assert_eq!(from, f);
}

/// Six times the volume.
fn volume(mesh: &Mesh) -> f64 {
    mesh.triangles
        .iter()
        .map(|t| {
            let [a, b, c] = t.map(|i| mesh.positions[i as usize].map(f64::from));
            a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0])
        })
        .sum()
}

/// Number of pairs of triangles that intersect outside shared vertices and edges, over all pairs,
/// in exported positions.
fn contacts(mesh: &Mesh) -> usize {
    let triangles: Vec<(Triangle, [u32; 3], [[f64; 2]; 3])> = mesh
        .triangles
        .iter()
        .map(|&t| {
            let corners = t.map(|i| mesh.positions[i as usize].map(f64::from));
            let span = [0, 1, 2].map(|k| {
                let values = corners.map(|p| p[k]);
                [values.into_iter().fold(f64::INFINITY, f64::min), values.into_iter().fold(f64::NEG_INFINITY, f64::max)]
            });
            (Triangle::new(corners), t, span)
        })
        .collect();
    let mut count = 0;
    for (i, (s, numbers_s, span_s)) in triangles.iter().enumerate() {
        for (t, numbers_t, span_t) in &triangles[i + 1..] {
            let boxes = (0..3).all(|k| span_s[k][0] <= span_t[k][1] && span_t[k][0] <= span_s[k][1]);
            count += usize::from(boxes && meet_in_mesh((s, *numbers_s), (t, *numbers_t)));
        }
    }
    count
}

fn folds(inner: usize, outer: usize, lobes: f64, grow: (usize, usize), slabs: usize) -> Vec<Section> {
    let mut folds = Folds::new(inner, outer, lobes, slabs as f64);
    let mut dice = Dice(7);
    let mut sections = vec![folds.section(0.0)];
    for step in 1..=slabs {
        folds.grow(grow.0, grow.1, &mut dice);
        sections.push(folds.section(step as f64));
    }
    sections
}

#[test]
fn a_growing_folded_tube_becomes_a_sound_surface() {
    let sections = folds(60, 24, 5.0, (12, 3), 10);
    let mut lofter = Lofter::new(sections[0].clone()).unwrap();
    for section in &sections[1..] {
        let accepted = lofter.advance(std::slice::from_ref(section)).unwrap();
        assert_eq!(accepted.sections, std::slice::from_ref(section));
    }
    let mesh = lofter.finish().unwrap();
    check_topology(&mesh);
    assert_eq!(contacts(&mesh), 0);
    assert!(volume(&mesh) > 0.0);
    // Each new vertex belongs to two sections: the one where it appears and, inserted, the previous
    // one.
    let recorded: usize = sections.iter().map(Section::particles).sum();
    let first = sections[0].particles();
    let last = sections[10].particles();
    assert_eq!(mesh.positions.len(), recorded + last - first);
}

#[test]
fn positions_are_metres_rounded_once() {
    let sections = folds(60, 24, 5.0, (0, 0), 1);
    let mut lofter = Lofter::new(sections[0].clone()).unwrap();
    lofter.advance(&sections[1..]).unwrap();
    let mesh = lofter.finish().unwrap();
    let points = sections.iter().flat_map(|s| s.inner.points.iter().chain(&s.outer.points).map(|p| (p, s.z_um)));
    for (position, (p, z_um)) in mesh.positions.iter().zip(points) {
        let metres = [f64::from(p[0]), f64::from(p[1]), z_um].map(|x| (x * 1e-6) as f32);
        assert_eq!(*position, metres);
    }
}

#[test]
fn rings_may_begin_anywhere() {
    let sections = folds(60, 24, 5.0, (12, 3), 4);
    let turned = |s: &Section, k: usize| {
        let mut s = s.clone();
        for ring in [&mut s.inner, &mut s.outer] {
            ring.ids.rotate_left(k);
            ring.points.rotate_left(k);
        }
        s
    };
    let mut lofter = Lofter::new(sections[0].clone()).unwrap();
    for (k, section) in sections[1..].iter().enumerate() {
        lofter.advance(&[turned(section, 5 * k + 3)]).unwrap();
    }
    let mesh = lofter.finish().unwrap();
    check_topology(&mesh);
    assert_eq!(contacts(&mesh), 0);
}

#[test]
fn strips_cover_the_walls() {
    let sections = folds(60, 24, 5.0, (12, 3), 6);
    let mut lofter = Lofter::new(sections[0].clone()).unwrap();
    for section in &sections[1..] {
        lofter.advance(std::slice::from_ref(section)).unwrap();
    }
    let mesh = lofter.finish().unwrap();
    for patch in &mesh.patches[..2] {
        let triangles = &mesh.triangles[patch.triangles.clone()];
        let strips = strips(triangles);
        let turned_least_first = |t: [u32; 3]| {
            let least = (0..3).min_by_key(|&k| t[k]).unwrap();
            [0, 1, 2].map(|k| t[(least + k) % 3])
        };
        let unrolled: Vec<[u32; 3]> =
            strips.iter().flat_map(|strip| triangles_of_strip(strip)).map(turned_least_first).collect();
        let mut expected: Vec<[u32; 3]> = triangles.iter().copied().map(turned_least_first).collect();
        let mut unrolled = unrolled;
        unrolled.sort_unstable();
        expected.sort_unstable();
        assert_eq!(unrolled, expected);
        assert!(3 * strips.len() < triangles.len(), "{} strips", strips.len());
    }
}

/// The moving edge turns by a right angle around (0, 0). Another edge passes on the inner side of
/// the turn, where the shorter diagonal would cut through it.
#[test]
fn a_diagonal_is_flipped_where_the_shorter_one_cuts() {
    let around = |x: f32, y: f32| [[x + 0.2, y], [x - 0.1, y + 0.1], [x - 0.1, y - 0.1]];
    let rim = |ring: [[f32; 2]; 3], other: [[f32; 2]; 3]| Rim { points: [ring, other].concat(), inner: 3 };
    let lower = rim([[0.0, 0.0], [10.0, 0.0], [-20.0, 20.0]], around(6.0, -2.0));
    let upper = rim([[0.5, 0.0], [0.0, 10.0], [-20.0, 20.0]], around(2.0, 4.0));
    let mut slab = Slab::new(lower, upper);
    let blocks = slab.blocks();
    assert_eq!(slab.diagonals[0], Diagonal::Backward);
    assert_eq!(settle(&mut slab, &blocks, None), Ok(1));
    assert_eq!(slab.diagonals[0], Diagonal::Forward);
    assert_eq!(settle(&mut slab, &blocks, None), Ok(0));
}

/// A small triangle at `degrees` on a circle around the tip of a spike of the outer ring. The path
/// from 40 to −220 degrees leads around the tip, the straight path through the spike.
fn around_a_spike(step: f64, degrees: f64) -> Section {
    let (sin, cos) = degrees.to_radians().sin_cos();
    let corners = [[10.0, 0.0], [-5.0, 8.0], [-5.0, -8.0]];
    let inner = Ring {
        ids: vec![4, 2, 7],
        points: corners.map(|[x, y]| [(80.0 * cos + x) as f32, (80.0 * sin + y) as f32]).to_vec(),
    };
    let outer = Ring {
        ids: (0..7).collect(),
        points: vec![
            [200.0, -200.0],
            [200.0, 200.0],
            [5.0, 200.0],
            [0.0, 0.0],
            [-5.0, 200.0],
            [-200.0, 200.0],
            [-200.0, -200.0],
        ],
    };
    Section { step, z_um: 20.0 * step, added: false, inner, outer }
}

#[test]
fn sections_between_are_added_where_flips_do_not_help() {
    let history: Vec<Section> = (1..=10).map(|k| around_a_spike(f64::from(k), 40.0 - 26.0 * f64::from(k))).collect();
    let mut lofter = Lofter::new(around_a_spike(0.0, 40.0)).unwrap();
    let accepted = lofter.advance(&history).unwrap();
    let (last, added) = accepted.sections.split_last().unwrap();
    assert_eq!(*last, history[9]);
    assert!(!added.is_empty() && added.len() < 9);
    assert!(added.iter().all(|s| s.added));
    assert!(added.windows(2).all(|w| w[0].step < w[1].step));
    for section in added {
        let kept = &history[section.step as usize - 1];
        assert_eq!(section.inner, kept.inner);
    }
    let mesh = lofter.finish().unwrap();
    check_topology(&mesh);
    assert_eq!(contacts(&mesh), 0);
}

#[test]
fn a_slab_that_was_tried_in_vain_leaves_the_lofter_as_it_was() {
    let history: Vec<Section> = (1..=10).map(|k| around_a_spike(f64::from(k), 40.0 - 26.0 * f64::from(k))).collect();
    let mut lofter = Lofter::new(around_a_spike(0.0, 40.0)).unwrap();
    assert_eq!(lofter.try_advance(&history[9]).unwrap(), None);
    lofter.advance(&history).unwrap();
    let mut other = Lofter::new(around_a_spike(0.0, 40.0)).unwrap();
    other.advance(&history).unwrap();
    assert_eq!(lofter.finish().unwrap(), other.finish().unwrap());
}

#[test]
fn a_slab_that_is_sound_is_the_same_tried_or_not() {
    let first = around_a_spike(0.0, 40.0);
    let second = around_a_spike(1.0, 30.0);
    let (mut tried, mut advanced) = (Lofter::new(first.clone()).unwrap(), Lofter::new(first).unwrap());
    let accepted = advanced.advance(std::slice::from_ref(&second)).unwrap();
    assert_eq!(accepted.sections.len(), 1);
    assert_eq!(tried.try_advance(&second).unwrap(), Some(accepted));
    assert_eq!(tried.finish().unwrap(), advanced.finish().unwrap());
}

#[test]
fn walls_that_truly_meet_are_named() {
    let mut lofter = Lofter::new(around_a_spike(0.0, 40.0)).unwrap();
    let error = lofter.advance(&[around_a_spike(1.0, -220.0)]).unwrap_err();
    let LoftError::Unmendable { from_step, to_step, z_um, x_um, y_um } = error else {
        panic!("{error}");
    };
    assert!(from_step < 0.5 && 0.5 <= to_step, "{from_step} to {to_step}");
    assert!((z_um - 20.0 * to_step).abs() < 1e-9);
    assert!(x_um.abs() < 201.0 && y_um.abs() < 201.0);
}

#[test]
fn sections_are_not_added_without_end() {
    let history: Vec<Section> = (1..=10).map(|k| around_a_spike(f64::from(k), 40.0 - 26.0 * f64::from(k))).collect();
    let vertices = |most: u64| {
        let mut lofter = Lofter::new(around_a_spike(0.0, 40.0)).unwrap().with_most_vertices(most);
        lofter.advance(&history)?;
        Ok::<_, LoftError>(lofter.finish().unwrap().positions.len() as u64)
    };
    let needed = vertices(u64::MAX).unwrap();
    assert_eq!(vertices(needed), Ok(needed));
    assert_eq!(vertices(needed - 1), Err(LoftError::TooLarge { most: needed as usize - 1 }));
}

#[test]
fn places_that_single_precision_cannot_tell_apart_end_the_search() {
    let at = |step: f64, spike: f64| Section { z_um: 500_000.0 + 0.2 * step, ..around_a_spike(step, spike) };
    let mut lofter = Lofter::new(at(0.0, 40.0)).unwrap();
    assert!(matches!(lofter.advance(&[at(1.0, -220.0)]), Err(LoftError::Unmendable { .. })));
}

#[test]
fn unsound_sections_are_named() {
    let sound = around_a_spike(0.0, 40.0);
    let mut crossing = around_a_spike(1.0, 35.0);
    crossing.outer.points.swap(1, 4);
    assert!(matches!(Lofter::new(crossing.clone()), Err(LoftError::Contour { wall: Wall::Outer, .. })));
    let mut lofter = Lofter::new(sound.clone()).unwrap();
    assert!(matches!(lofter.advance(&[crossing]), Err(LoftError::Contour { step: 1.0, wall: Wall::Outer, .. })));
    let mut outside = around_a_spike(1.0, 35.0);
    outside.outer.points.iter_mut().flatten().for_each(|x| *x *= 0.3);
    assert!(matches!(Lofter::new(outside), Err(LoftError::Nesting { .. })));
    let mut lofter = Lofter::new(sound.clone()).unwrap();
    assert!(matches!(lofter.advance(&[around_a_spike(0.0, 39.0)]), Err(LoftError::Order { .. })));
    let mut wild = around_a_spike(1.0, 39.0);
    wild.inner.points[2][0] = f32::NAN;
    assert!(matches!(lofter.advance(&[wild]), Err(LoftError::Contour { .. })));
    assert_eq!(lofter.advance(&[]), Err(LoftError::NoSection));
    assert!(matches!(lofter.finish(), Err(LoftError::NoSlab)));
}

/// Random motions, as large in every step as the rule of the simulation allows. Slabs must be
/// mended, some by flips and others by sections, and no triangles of the surface may intersect.
#[test]
fn random_motions_free_of_contact_are_always_lofted() {
    let (mut flipped, mut added) = (0, 0);
    for seed in 0..16 {
        let mut jostle = Jostle::new(12, 8, seed);
        let mut lofter = Lofter::new(jostle.section()).unwrap();
        for every in [1, 2, 4, 8, 16, 16] {
            let history: Vec<Section> = (0..every).map(|_| jostle.step()).collect();
            let accepted = lofter.advance(&history).unwrap_or_else(|e| panic!("seed {seed}: {e}"));
            flipped += accepted.flipped;
            added += accepted.sections.len() - 1;
        }
        let mesh = lofter.finish().unwrap();
        check_topology(&mesh);
        assert_eq!(contacts(&mesh), 0, "seed {seed}");
    }
    assert!(flipped > 0 && added > 0, "{flipped} flips, {added} sections");
}

/// Two wandering rings of five points with short edges, starting at `drift`.
fn wandering(dice: &mut Dice, drift: f32) -> Rim {
    let mut at = [drift, 0.0f32];
    let points = (0..10).map(|_| {
        at = at.map(|x| x + (dice.below(7) as f32) - 2.5);
        at
    });
    Rim { points: points.collect(), inner: 5 }
}

/// A wildly folded slab between two such rims, with random diagonals.
fn wild_slab(dice: &mut Dice) -> Slab {
    let mut slab = Slab::new(wandering(dice, 0.0), wandering(dice, 4.0));
    for diagonal in &mut slab.diagonals {
        if dice.below(2) == 0 {
            *diagonal = diagonal.other();
        }
    }
    slab
}

/// True if triangles of two cells, or of one cell, intersect by the exact test.
fn cells_meet(slab: &Slab, i: usize, j: usize) -> bool {
    (0..=slab.edges(i)).any(|k| {
        let (first, corners) = slab.triangle_in_space(i, k);
        let meets = |(other, numbers): (Triangle, [u32; 3])| meet_in_mesh((&first, corners), (&other, numbers));
        (0..=slab.edges(j)).any(|l| (i, k) != (j, l) && meets(slab.triangle_in_space(j, l)))
    })
}

/// On wildly folded slabs, the exact test of all triangles must confirm every cell that the quick
/// tests clear.
#[test]
fn quick_tests_never_clear_a_contact() {
    let mut dice = Dice(11);
    let (mut cleared, mut met) = (0, 0);
    for _ in 0..300 {
        let slab = wild_slab(&mut dice);
        let parted = slab.parted_from_next();
        for (i, &parted) in parted.iter().enumerate() {
            for j in 0..slab.len() {
                let neighbours = slab.lower.next(i) == j;
                let clear = if neighbours { parted } else { slab.lower.next(j) != i && slab.apart(i, j) };
                if i == j || slab.degenerate(i) || slab.degenerate(j) {
                    assert!(!(clear && neighbours));
                    continue;
                }
                let meet = |i, j| cells_meet(&slab, i, j);
                if clear {
                    cleared += 1;
                    assert!(!meet(i, j), "{i} {j} {slab:?}");
                    assert!(!neighbours || (!meet(i, i) && !meet(j, j)), "{i} {j} {slab:?}");
                } else {
                    met += usize::from(meet(i, j));
                }
            }
        }
    }
    assert!(cleared > 1000 && met > 1000, "{cleared} {met}");
}

/// The same for neighbours in slabs with new vertices anywhere in the upper rim.
#[test]
fn the_quick_test_of_refined_cells_never_clears_a_contact() {
    let mut dice = Dice(12);
    let (mut cleared, mut met) = (0, 0);
    for _ in 0..2000 {
        let slab = wild_slab(&mut dice);
        let (mut upper, mut new_after) = (Rim::default(), Vec::new());
        for (i, &p) in slab.upper.points.iter().enumerate() {
            upper.points.push(p);
            new_after.push(dice.below(3) as u32);
            let end = slab.upper.points[slab.upper.next(i)];
            for k in 1..=*new_after.last().unwrap() {
                let along = k as f32 / (new_after[i] + 1) as f32;
                let off = dice.below(5) as f32 - 2.0;
                upper.points.push([0, 1].map(|axis| p[axis] + along * (end[axis] - p[axis]) + off));
            }
            if i < slab.upper.inner {
                upper.inner = upper.len();
            }
        }
        let (slab, _) = slab.refined(upper, &new_after);
        for i in 0..slab.len() {
            let next = slab.lower.next(i);
            let is_parted = slab.is_parted_from_next(i);
            if slab.degenerate(i) || slab.degenerate(next) {
                assert!(!is_parted, "{i} {slab:?}");
                continue;
            }
            let meet = [(i, next), (i, i), (next, next)].map(|(i, j)| cells_meet(&slab, i, j));
            if is_parted {
                cleared += 1;
                assert!(meet == [false; 3], "{i} {slab:?}");
            } else {
                met += usize::from(meet[0]);
            }
        }
    }
    assert!(cleared > 300 && met > 300, "{cleared} {met}");
}
