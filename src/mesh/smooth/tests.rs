//! Tests of smoothing: greatest turn, distance moved, contours that stay apart.

use super::*;
use crate::geometry::polygon::{check_contour, check_nested};
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

fn greatest_turn(ring: &Ring) -> f64 {
    let n = ring.len();
    let p = |i: usize| ring.points[i % n].map(f64::from);
    (0..n).map(|i| turn(p(i), p(i + 1), p(i + 2)).abs().to_degrees()).fold(0.0, f64::max)
}

/// Distance of the points of a ring, and of points between, from another.
fn apart(a: &Ring, b: &Ring) -> f64 {
    let p = |ring: &Ring, i: usize| ring.points[i % ring.len()].map(f64::from);
    let from = |q: [f64; 2]| {
        let of = |j: usize| {
            let (c, d) = (p(b, j), p(b, j + 1));
            let t = ((q[0] - c[0]) * (d[0] - c[0]) + (q[1] - c[1]) * (d[1] - c[1])) / length(minus(d, c)).powi(2);
            length(minus(q, along(c, d, t.clamp(0.0, 1.0))))
        };
        (0..b.len()).map(of).fold(f64::INFINITY, f64::min)
    };
    let samples = (0..a.len()).flat_map(|i| [0.0, 0.25, 0.5, 0.75].map(|t| along(p(a, i), p(a, i + 1), t)));
    samples.map(from).fold(0.0, f64::max)
}

#[test]
fn corners_of_a_star_are_rounded() {
    let old = section(star(60, 70.0, 0.15), star(40, 200.0, 0.0));
    assert!(greatest_turn(&old.inner) > 100.0);
    let new = smooth(&old, &Smooth::default());
    assert!(greatest_turn(&new.inner) <= 60.0, "{}", greatest_turn(&new.inner));
    let distance = apart(&old.inner, &new.inner).max(apart(&new.inner, &old.inner));
    assert!(distance > 0.5 && distance <= 5.0, "{distance}");
    check_contour(&new.inner.points).unwrap();
    check_nested(&new.inner.points, &new.outer.points).unwrap();
}

#[test]
fn ids_are_kept_in_order_when_a_particle_is_inserted() {
    let outer = star(40, 200.0, 0.0);
    let before = section(star(60, 70.0, 0.1), outer.clone());
    let mut after = before.clone();
    let [a, b] = [after.inner.points[7], after.inner.points[8]];
    after.inner.points.insert(8, [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])]);
    after.inner.ids.insert(8, 777);
    let [before, after] = [before, after].map(|s| smooth(&s, &Smooth::default()).inner.ids);
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
    /// Rings with random radii do not cross after smoothing, however near their walls are.
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
        let new = smooth(&old, &Smooth::default());
        prop_assert!(check_contour(&new.inner.points).is_ok());
        prop_assert!(check_nested(&new.inner.points, &new.outer.points).is_ok());
        prop_assert!(apart(&old.inner, &new.inner).max(apart(&new.inner, &old.inner)) <= 5.0);
    }

    /// A small change of the section changes the result by little.
    #[test]
    fn the_result_is_continuous(depth in 0.02f64..0.16, by in 1e-5f64..1e-3) {
        let smoothed = |depth: f64| smooth(&section(star(60, 70.0, depth), star(40, 200.0, 0.0)), &Smooth::default()).inner;
        let (a, b) = (smoothed(depth), smoothed(depth + by));
        for (p, q) in a.points.iter().zip(&b.points) {
            let moved = f64::from(p[0] - q[0]).hypot(f64::from(p[1] - q[1]));
            prop_assert!(moved <= 12.0 * 70.0 * by + 1e-3, "{moved} for {}", 70.0 * by);
        }
    }
}
