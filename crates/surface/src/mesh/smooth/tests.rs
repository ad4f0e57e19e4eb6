//! Smoothing: maximum turn, distance moved, contours that stay apart, continuity.

use super::*;
use crate::geometry::polygon::{check_contour, check_nested};
use crate::geometry::vector::squared_distance_to_segment;
use crate::mesh::loft::exported;
use proptest::prelude::*;
use std::f64::consts::TAU;

/// A star with `n` points and alternating radii: sharp inside and outside.
fn star(n: u32, radius: f64, depth: f64) -> Ring {
    let at = |i: u32| {
        let angle = TAU * f64::from(i) / f64::from(n);
        let r = radius * if i.is_multiple_of(2) { 1.0 } else { 1.0 - depth };
        [(r * angle.cos()) as f32, (r * angle.sin()) as f32]
    };
    Ring { ids: (0..n).map(|i| 5 * i).collect(), points: (0..n).map(at).collect() }
}

fn section(inner: Ring, outer: Ring) -> Section {
    Section { step: 1.0, z_um: 1.0, added: false, inner, outer }
}

/// A ring of teeth that lean to one side, with the tip of each tooth at angle 0 and the root at
/// `lean` of the way to the next tip.
fn saw(teeth: u32, radius: f64, depth: f64, lean: f64) -> Ring {
    let at = |i: u32| {
        let (part, r) = if i.is_multiple_of(2) { (0.0, radius) } else { (lean, radius - depth) };
        let angle = TAU * (f64::from(i / 2) + part) / f64::from(teeth);
        [(r * angle.cos()) as f32, (r * angle.sin()) as f32]
    };
    Ring { ids: (0..2 * teeth).collect(), points: (0..2 * teeth).map(at).collect() }
}

/// A ring with a path of given turns (degrees) and edges, closed by a wide loop.
fn path(steps: &[(f64, f64)]) -> Ring {
    let (mut p, mut direction) = ([0.0f64, 0.0], 0.0f64);
    let mut points = vec![[-40.0, 0.0], [-20.0, 0.0], p];
    for &(turn, edge) in steps {
        direction += turn.to_radians();
        p = [p[0] + edge * direction.cos(), p[1] + edge * direction.sin()];
        points.push(p);
    }
    // Continues in the last direction, then goes counter-clockwise around everything.
    let last = [p[0] + 30.0 * direction.cos(), p[1] + 30.0 * direction.sin()];
    points.push(last);
    let end = last[1].atan2(last[0]);
    let way = (0.5 * TAU - end).rem_euclid(TAU);
    points.extend((1..24).map(|k| {
        let angle = end + way * f64::from(k) / 24.0;
        [120.0 * angle.cos(), 120.0 * angle.sin()]
    }));
    let points: Vec<[f32; 2]> = points.iter().map(|p| p.map(|x| x as f32)).collect();
    Ring { ids: (0..points.len() as u32).collect(), points }
}

/// Exported points, m.
fn metres(ring: &Ring) -> Vec<[f32; 2]> {
    exported(ring, 0)
}

fn greatest_turn(ring: &Ring) -> f64 {
    let points = metres(ring);
    let n = points.len();
    let edge = |i: usize| sub(points[(i + 1) % n].map(f64::from), points[i % n].map(f64::from));
    (0..n).map(|i| angle(edge(i), edge(i + 1)).abs().to_degrees()).fold(0.0, f64::max)
}

/// Asserts that old and new contours are at most 5 µm apart and the new contours are sound.
fn check(old: &Section, new: &Section) {
    for (a, b) in [(&old.inner, &new.inner), (&old.outer, &new.outer)] {
        let distance = apart(a, b).max(apart(b, a));
        assert!(distance <= 5.0, "{distance}");
        check_contour(&metres(b)).unwrap();
    }
    check_nested(&metres(&new.inner), &metres(&new.outer)).unwrap();
}

/// Maximum distance of the points of a ring, and of points between them, from another ring.
fn apart(a: &Ring, b: &Ring) -> f64 {
    let p = |ring: &Ring, i: usize| ring.points[i % ring.len()].map(f64::from);
    let from = |q: [f64; 2]| {
        let of = |j: usize| {
            let (c, d) = (p(b, j), p(b, j + 1));
            squared_distance_to_segment(q, c, d).sqrt()
        };
        (0..b.len()).map(of).fold(f64::INFINITY, f64::min)
    };
    let samples = (0..a.len()).flat_map(|i| [0.0, 0.25, 0.5, 0.75].map(|t| lerp(p(a, i), p(a, i + 1), t)));
    samples.map(from).fold(0.0, f64::max)
}

#[test]
fn corners_of_a_star_are_rounded() {
    let old = section(star(60, 70.0, 0.15), star(40, 200.0, 0.0));
    assert!(greatest_turn(&old.inner) > 100.0);
    let new = smooth(&old, 5.0);
    assert!(greatest_turn(&new.inner) <= 60.0, "{}", greatest_turn(&new.inner));
    assert!(apart(&old.inner, &new.inner) > 0.5);
    check(&old, &new);
}

#[test]
fn corners_as_sharp_as_models_have_are_rounded() {
    // Turns and edges of models of the presets cow, paper, and (the last two) pig and human.
    let found: [&[(f64, f64)]; 8] = [
        &[(-36.0, 13.0), (84.0, 14.5), (145.4, 8.5), (-113.0, 18.0), (-1.0, 13.0)],
        &[(24.0, 13.7), (144.0, 9.4), (-118.4, 8.1), (145.3, 13.8), (-5.0, 11.0), (-50.0, 14.0), (-40.0, 14.0)],
        &[
            (-60.0, 9.0),
            (-44.0, 9.0),
            (50.0, 7.4),
            (116.0, 12.8),
            (-102.0, 7.0),
            (143.6, 13.8),
            (25.7, 12.0),
            (-40.0, 15.0),
        ],
        &[
            (8.0, 14.5),
            (96.0, 10.7),
            (134.5, 8.3),
            (-113.0, 7.0),
            (80.0, 7.7),
            (-31.0, 8.4),
            (-60.0, 14.0),
            (-20.0, 14.0),
        ],
        &[(-14.6, 16.0), (22.7, 15.5), (151.0, 8.3), (-87.2, 9.0), (82.5, 7.8), (-51.1, 8.6), (4.2, 9.0)],
        &[(6.0, 9.0), (24.0, 7.5), (136.0, 6.8), (-25.0, 8.0), (-16.0, 9.0)],
        &[(11.8, 16.4), (-116.6, 7.8), (154.5, 10.2), (106.9, 9.7), (26.3, 13.4), (-30.6, 11.3), (-3.8, 8.0)],
        &[
            (17.0, 13.0),
            (-62.0, 11.6),
            (131.0, 19.5),
            (-113.0, 14.5),
            (135.0, 14.2),
            (69.0, 15.9),
            (22.0, 16.5),
            (-50.0, 18.0),
        ],
    ];
    for steps in found {
        for sign in [1.0, -1.0] {
            let steps: Vec<(f64, f64)> = steps.iter().map(|&(turn, edge)| (sign * turn, edge)).collect();
            let old = section(path(&steps), star(40, 200.0, 0.0));
            assert!(check_contour(&metres(&old.inner)).is_ok(), "{steps:?}");
            let new = smooth(&old, 5.0);
            assert!(greatest_turn(&new.inner) <= 57.0, "{} for {steps:?}", greatest_turn(&new.inner));
            check(&old, &new);
        }
    }
}

#[test]
fn rings_of_few_or_equal_points_do_no_harm() {
    for points in [vec![], vec![[1.0, 2.0]], vec![[1.0, 2.0]; 2], vec![[1.0, 2.0]; 5]] {
        let ring = Ring { ids: (0..points.len() as u32).collect(), points };
        let new = smooth(&section(ring.clone(), star(40, 200.0, 0.0)), 5.0);
        assert!(new.inner.points.iter().flatten().all(|x| x.is_finite()));
        assert_eq!(new.inner.len(), 2 * ring.len());
    }
}

#[test]
fn ids_are_kept_in_order_when_a_particle_is_inserted() {
    let outer = star(40, 200.0, 0.0);
    let before = section(star(60, 70.0, 0.1), outer.clone());
    let mut after = before.clone();
    let [a, b] = [after.inner.points[7], after.inner.points[8]];
    after.inner.points.insert(8, [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])]);
    after.inner.ids.insert(8, 777);
    let [before, after] = [before, after].map(|s| smooth(&s, 5.0).inner.ids);
    let mut unique = after.clone();
    unique.sort_unstable();
    unique.dedup();
    assert_eq!(unique.len(), after.len());
    let kept: Vec<u32> = after.iter().copied().filter(|id| before.contains(id)).collect();
    assert_eq!(kept, before);
    assert!(after.contains(&(2 * 777)) && after.contains(&(2 * 777 + 1)));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    /// Rings with random radii do not cross after smoothing, however close their walls are.
    #[test]
    fn rings_that_do_not_cross_still_do_not(radii in prop::collection::vec(20.0f64..60.0, 12..90)) {
        let n = radii.len();
        let points = radii.iter().enumerate().map(|(i, r)| {
            let angle = TAU * i as f64 / n as f64;
            [(r * angle.cos()) as f32, (r * angle.sin()) as f32]
        }).collect();
        let inner = Ring { ids: (0..n as u32).collect(), points };
        let old = section(inner, star(40, 80.0, 0.0));
        prop_assume!(check_contour(&old.inner.points).is_ok());
        let new = smooth(&old, 5.0);
        check(&old, &new);
    }

    /// Teeth with turns of up to 125 degrees and edges as long as in models.
    #[test]
    fn teeth_are_rounded(teeth in 40u32..56, depth in 2.0f64..8.0, lean in 0.25f64..0.75) {
        let old = section(saw(teeth, 70.0, depth, lean), star(40, 200.0, 0.0));
        prop_assume!(greatest_turn(&old.inner) <= 125.0);
        let new = smooth(&old, 5.0);
        prop_assert!(greatest_turn(&new.inner) <= 60.0, "{} was {}", greatest_turn(&new.inner), greatest_turn(&old.inner));
        check(&old, &new);
    }

    /// A small change of the section changes the result only a little.
    #[test]
    fn the_result_is_continuous(depth in 0.02f64..0.16, by in 1e-5f64..1e-3) {
        let smoothed = |depth: f64| smooth(&section(star(60, 70.0, depth), star(40, 200.0, 0.0)), 5.0).inner;
        let (a, b) = (smoothed(depth), smoothed(depth + by));
        for (p, q) in a.points.iter().zip(&b.points) {
            let moved = f64::from(p[0] - q[0]).hypot(f64::from(p[1] - q[1]));
            prop_assert!(moved <= 12.0 * 70.0 * by + 1e-3, "{moved} for {}", 70.0 * by);
        }
    }
}
