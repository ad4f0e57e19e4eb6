//! Tests of whole simulations: growth, bytes that do not depend on threads or search, and guards.

use super::*;
use crate::geometry::polygon::{check_contour, check_nested};
use crate::spec::{ModelSpec, preset};
use serde_json::{Value, json};

/// A small tube of the preset `paper` with growth at fold tips, thickness field, variety and sway.
fn simulation(patch: &Value, seed: u64, threads: usize) -> CpuSimulation {
    let mut whole = json!({
        "steps": 150, "burn_in": 60, "bending": 0.2,
        "particles": {
            "total": { "keys": [[0, 260], [1, 900]] }, "outer": { "keys": [[0, 60], [1, 90]] },
            "tip_weight": 0.5, "candidates": 6,
        },
        "containment": { "wall_um": { "keys": [[0, 900], [0.125, 900], [0.45, 680], [1, 680]] } },
        "collision": { "gap_um": { "keys": [[0, 60], [0.125, 60], [0.45, 42], [1, 42]] }, "barrier_um": 7 },
        "variation": { "amplitude": 0.35 },
        "variety": { "asymmetry": 0.15, "height": 0.3, "thickness": 0.08, "shift": 0.05 },
        "sway": { "strength": { "keys": [[0, 0], [0.1825, 0], [0.27, 2.5], [1, 2.5]] } },
    });
    json_patch::merge(&mut whole, patch);
    let spec = ModelSpec::resolve(preset("paper").unwrap(), &whole).unwrap();
    CpuSimulation::new(Plan::new(&spec, seed), threads)
}

fn run(simulation: &mut CpuSimulation, mut each: impl FnMut(&CpuSimulation)) {
    while simulation.time() < i64::from(simulation.plan.steps) {
        simulation.step().unwrap();
        each(simulation);
    }
}

fn assert_sound(section: &Section) {
    let (inner, outer) = (&section.inner.points, &section.outer.points);
    check_contour(inner).unwrap_or_else(|e| panic!("inner loop at step {}: {e}", section.step));
    check_contour(outer).unwrap_or_else(|e| panic!("outer loop at step {}: {e}", section.step));
    check_nested(inner, outer).unwrap_or_else(|e| panic!("step {}: {e}", section.step));
}

#[test]
fn walls_never_cross_at_any_step() {
    for (seed, patch) in [
        (1, json!({})),
        (2, json!({ "contortion": { "magnitude": 10, "fraction": 0.3 } })),
        (3, json!({ "solver": { "integrator": "euler" } })),
        (4, json!({ "variation": { "amplitude": 1.0 } })),
        (
            5,
            json!({ "variety": { "asymmetry": 1, "height": 1, "thickness": 0.5, "shift": 0.5, "waves": 64, "drift": 0.5 } }),
        ),
    ] {
        let mut sim = simulation(&patch, seed, 1);
        run(&mut sim, |s| assert_sound(&s.section()));
    }
}

#[test]
fn without_barrier_and_with_a_weak_force_the_guard_alone_keeps_walls_apart() {
    let patch =
        json!({ "collision": { "strength": 0.02, "barrier": 0 }, "contortion": { "magnitude": 6, "fraction": 0.3 } });
    let mut sim = simulation(&patch, 5, 1);
    run(&mut sim, |s| assert_sound(&s.section()));
    assert!(sim.statistics().moves_shortened > 0, "the guard had nothing to do: the test shows nothing");
}

/// Values that are stable only with Runge–Kutta must not make the outer loop oscillate, which is
/// always integrated by Euler steps.
#[test]
fn the_wall_comes_to_rest_where_only_runge_kutta_is_stable() {
    for patch in [
        json!({}),
        json!({ "spring": { "stiffness": 1.9 }, "bending": 0 }),
        json!({ "spring": { "damping": 0.5 } }),
        json!({ "friction": 2 }),
    ] {
        let mut whole = json!({
            "particles": { "total": 600, "outer": 60 }, "wall": { "drift": 0 },
            "containment": { "wall_um": 300, "spacing_um": 80, "squash": 0.88 },
        });
        json_patch::merge(&mut whole, &patch);
        let mut sim = simulation(&whole, 6, 1);
        run(&mut sim, |_| ());
        let fastest = sim.outer.v.iter().fold(0.0f32, |most, v| most.max(v[0].hypot(v[1])));
        assert!(fastest < 0.1, "{patch}: {fastest} µm a step");
    }
}

#[test]
fn a_coarse_wall_holds_the_first_section_too() {
    let patch = json!({
        "burn_in": 0, "containment": { "wall_um": 20 }, "wall": { "lobing": 0 },
        "particles": { "total": { "keys": [[0, 1100], [1, 1500]] }, "outer": 12 },
    });
    let mut sim = simulation(&patch, 1, 1);
    assert_sound(&sim.section());
    run(&mut sim, |s| assert_sound(&s.section()));
}

/// Particles of the wall start close together at the tips of a flat ellipse, where their edges push
/// against each other. Lobes, springs that do not resist, and an ellipse that swings from flat to
/// high increase the effect.
#[test]
fn the_outer_wall_never_crosses_itself_or_the_inner_loop() {
    let flat = json!({
        "steps": 100, "burn_in": 50, "containment": { "squash": 0.3 },
        "particles": { "total": { "keys": [[0, 400], [1, 600]] }, "outer": { "keys": [[0, 110], [1, 300]] } },
    });
    for (seed, patch) in [
        (1, json!({ "wall": { "lobes": 16 } })),
        (2, json!({ "wall": { "lobes": 16 } })),
        (4, json!({})),
        (
            5,
            json!({ "containment": { "squash": 1.5, "wall_um": 5000 }, "wall": { "lobes": 16, "lobing": 0.3, "drift": 0.5 } }),
        ),
        (
            6,
            json!({ "spring": { "stiffness": 0, "damping": 0 }, "friction": 0, "containment": {
            "wall_um": { "keys": [[0, 3000], [0.5, 20], [1, 3000]] }, "strength": 20 }, "wall": { "lobing": 0.003 } }),
        ),
        (
            7,
            json!({ "containment": {
            "squash": { "keys": [[0, 0.9], [1, 0.9]], "fluctuation": { "amplitude": 0.6, "period": 7 } } } }),
        ),
    ] {
        let mut whole = flat.clone();
        json_patch::merge(&mut whole, &patch);
        let mut sim = simulation(&whole, seed, 1);
        run(&mut sim, |s| {
            assert_sound(&s.section());
            for (p, q) in s.outer.p.iter().zip(s.outer.p.iter().cycle().skip(1)) {
                let turn = f64::from(p[0]) * f64::from(q[1]) - f64::from(p[1]) * f64::from(q[0]);
                assert!(turn > 0.0, "{patch} at step {}: {p:?} and {q:?} are out of order", s.time());
            }
        });
    }
}

/// Outlines with corners and notches, and folds that pass by at their maximum speed, with a wall
/// that follows the folds or does not.
#[test]
fn walls_never_cross_in_any_outline() {
    let notched: Vec<[f64; 2]> = (0..24)
        .map(|i| {
            let (angle, radius) = (std::f64::consts::TAU * f64::from(i) / 24.0, if i % 6 == 0 { 0.45 } else { 1.2 });
            [radius * angle.cos(), radius * angle.sin()]
        })
        .collect();
    let folds = |wall: f64| json!({ "depth": 0.5, "rows": 2, "period_mm": 60, "stagger": 0.5, "irregularity": 0.5, "wall": wall });
    let thin = json!({ "wall_um": 20, "squash": 0.5 });
    for (seed, patch) in [
        (1, json!({ "outline": { "kind": "superellipse", "exponent": 20 }, "containment": { "squash": 0.4 } })),
        (2, json!({ "outline": { "kind": "superellipse", "exponent": 0.7 } })),
        (
            3,
            json!({ "outline": { "kind": "polygon", "points": notched }, "containment": thin, "wall": { "lobing": 0 } }),
        ),
        (
            4,
            json!({ "outline": { "kind": "polygon", "points": notched,
            "strength": { "keys": [[0, 0.5], [1, 0.5]], "fluctuation": { "amplitude": 0.5, "period": 40 } } } }),
        ),
        (5, json!({ "steps": 600, "folds": folds(1.0) })),
        (
            6,
            json!({ "steps": 600, "folds": folds(0.0), "containment": thin, "wall": { "lobing": 0 },
            "outline": { "kind": "polygon", "points": notched }, "regulatory": { "strength": 1 } }),
        ),
    ] {
        let mut sim = simulation(&patch, seed, 1);
        assert!(!sim.plan.spokes.is_empty(), "{patch} is the ellipse");
        run(&mut sim, |s| assert_sound(&s.section()));
    }
}

/// The mucosa follows the outline if it is no longer than the wall.
#[test]
fn the_mucosa_follows_the_outline() {
    let square = [[1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]];
    let patch = json!({
        "outline": { "kind": "polygon", "points": square },
        "particles": { "total": 460, "outer": 60 }, "containment": { "spacing_um": 240, "squash": 1 }, "regulatory": { "strength": 1 },
        "contortion": { "fraction": 0 },
    });
    let mut sim = simulation(&patch, 1, 1);
    run(&mut sim, |_| ());
    let r_in = sim.plan.at(sim.time).r_in;
    let [mut sides, mut corners] = [0, 0];
    for (x, y) in sim.inner.x.iter().zip(&sim.inner.y) {
        let [x, y] = [x.abs() / r_in, y.abs() / r_in];
        assert!((0.85..1.1).contains(&x.max(y)), "{x} {y}");
        sides += u32::from(x.min(y) < 0.2);
        corners += u32::from(x.min(y) > 0.8);
    }
    assert!(sides > 40 && corners > 40, "{sides} {corners}");
}

/// A scaled model is the enlarged model.
#[test]
fn a_scaled_section_is_the_same_enlarged() {
    let [one, four] = [1, 4].map(|scale| {
        let mut sim = simulation(&json!({ "scale": scale, "steps": 40 }), 1, 1);
        run(&mut sim, |_| ());
        assert_eq!(sim.section(), sim.checkpoint().section(&sim.plan));
        sim.section()
    });
    let enlarged = |points: &[[f32; 2]]| points.iter().map(|p| p.map(|c| 4.0 * c)).collect::<Vec<_>>();
    assert_eq!((enlarged(&one.inner.points), enlarged(&one.outer.points)), (four.inner.points, four.outer.points));
    assert_eq!(one.z_um, four.z_um);
}

#[test]
fn counts_follow_the_schedule() {
    let mut sim = simulation(&json!({}), 1, 1);
    let (plan, mut recorded) = (sim.plan.clone(), 0);
    run(&mut sim, |s| {
        if s.time() >= 0 && s.time() % 10 == 0 {
            recorded += 1;
            let u = s.time() as f64 / f64::from(plan.steps);
            let wanted = (260.0 + 640.0 * u).round() as u32;
            assert!(s.particles().abs_diff(wanted) <= s.statistics().splits_deferred as u32, "step {}", s.time());
        }
    });
    assert_eq!(recorded, 16);
    assert_eq!(u64::from(sim.particles()) + sim.statistics().splits_missing, 900);
}

#[test]
fn ids_are_unique_and_persist() {
    let mut sim = simulation(&json!({}), 1, 1);
    let mut before: Vec<u32> = Vec::new();
    run(&mut sim, |s| {
        let now = &s.inner.id;
        let kept: Vec<u32> = now.iter().copied().filter(|id| before.contains(id)).collect();
        assert_eq!(kept, before, "old particles must stay, in their order");
        let mut sorted = now.clone();
        sorted.sort_unstable();
        sorted.dedup();
        assert_eq!(sorted.len(), now.len());
        before.clone_from(now);
    });
}

#[test]
fn threads_searches_and_vectors_give_the_same_state() {
    let start = simulation(&json!({}), 9, 1);
    let end = |search: Search, vectors: Vectors, threads: usize| {
        let mut sim = start.fork_with(search, Kernel::Vector, vectors, threads);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| run(&mut sim, |_| {}));
        let builds = sim.statistics().list_builds;
        ((sim.inner, sim.outer, sim.work.clearance().to_vec()), builds)
    };
    let (one, builds) = end(Search::Lists, Vectors::best(), 1);
    // Groups of 16 are tested on all processors: without AVX-512 they are compiled for the
    // baseline.
    let all = [Vectors::Baseline, Vectors::Avx2, Vectors::Avx512];
    for (vectors, threads) in all.into_iter().flat_map(|vectors| [1, 2, 3].map(|threads| (vectors, threads))) {
        let (state, built) = end(Search::Lists, vectors, threads);
        assert!(state == one, "{vectors:?} on {threads} threads");
        assert_eq!(built, builds, "{vectors:?} on {threads} threads");
    }
    for (search, vectors, threads) in [
        (Search::Grid, Vectors::best(), 1),
        (Search::Grid, Vectors::Avx512, 2),
        (Search::AllPairs, Vectors::best(), 1),
        (Search::AllPairs, Vectors::Baseline, 2),
    ] {
        assert!(end(search, vectors, threads).0 == one, "{search:?} with {vectors:?} on {threads} threads");
    }
}

/// Lists miss no segment if ranges differ strongly by side and by particle, and strands turn fast.
#[test]
fn lists_hold_whatever_is_in_range() {
    for (seed, patch) in [
        (1, json!({ "collision": { "tissue_um": 200, "gap_um": 6 } })),
        (2, json!({ "collision": { "tissue_um": 8, "gap_um": 120 } })),
        (3, json!({ "variation": { "amplitude": 1.0 }, "contortion": { "magnitude": 10, "fraction": 0.5 } })),
        (4, json!({ "sway": { "strength": 5 }, "collision": { "barrier_um": 20 } })),
        (5, json!({ "solver": { "integrator": "euler" }, "particles": { "edge_um": 40 } })),
    ] {
        let mut sim = simulation(&patch, seed, 1);
        let mut all_pairs = sim.fork(Search::AllPairs, Kernel::Vector, 1);
        while sim.time() < i64::from(sim.plan.steps) {
            sim.step().unwrap();
            all_pairs.step().unwrap();
            assert!(sim.checkpoint() == all_pairs.checkpoint(), "{patch} at step {}", sim.time());
        }
        let evaluations = 4 * 210;
        assert!(sim.statistics().list_builds < evaluations, "{patch}: lists were built in every evaluation");
    }
}

/// Two straight strands 40 µm apart that come within the range of a barrier that was off when the
/// lists were built.
#[test]
fn lists_follow_a_barrier_that_grows_between_growth_events() {
    let patch = json!({
        "steps": 20, "burn_in": 0, "particles": { "total": 260, "outer": 60, "every": 1000 },
        "collision": { "tissue_um": 12, "gap_um": 12, "barrier": 0.02, "barrier_um": { "keys": [[0, 0], [0.3, 20], [1, 20]] } },
    });
    let mut sim = simulation(&patch, 1, 1);
    let n = sim.inner.len();
    for row in &mut sim.plan.rows {
        let bare = StepRow { stiffness: 0.0, damping: 0.0, relaxation: 0.0, friction: 0.0, bending: 0.0, ..*row };
        *row = StepRow { containment: 0.0, regulatory: 0.0, contortion: [0.0; 3], repulsion: 0.0, ..bare };
    }
    let half = n / 2;
    for i in 0..n {
        let (side, k) = if i < half { (-1.0, i) } else { (1.0, n - 1 - i) };
        sim.inner.x[i] = 10.0 * (k as f32 - 0.5 * half as f32);
        sim.inner.y[i] = 20.0 * side;
        sim.inner.vy[i] = -1.1 * side;
    }
    let mut all_pairs = sim.fork(Search::AllPairs, Kernel::Vector, 1);
    let mut lists = sim.fork(Search::Lists, Kernel::Vector, 1);
    for _ in 0..12 {
        lists.step().unwrap();
        all_pairs.step().unwrap();
        assert!(lists.checkpoint() == all_pairs.checkpoint(), "at step {}", lists.time());
    }
    assert!(lists.inner.vy.iter().any(|v| v.abs() < 1.0999), "the barrier had nothing to do: the test shows nothing");
}

/// Two strands beyond each other's range, and a particle that flies from one to the other. Only the
/// lists near this particle are rebuilt.
#[test]
fn lists_near_restless_particles_are_mended() {
    let patch = json!({
        "burn_in": 0, "particles": { "total": 2400, "outer": 60, "every": 1000 },
        "collision": { "tissue_um": 14, "gap_um": 12 },
    });
    let mut sim = simulation(&patch, 1, 1);
    for row in &mut sim.plan.rows {
        let bare = StepRow { stiffness: 0.0, damping: 0.0, relaxation: 0.0, friction: 0.0, bending: 0.0, ..*row };
        *row = StepRow { containment: 0.0, regulatory: 0.0, contortion: [0.0; 3], ..bare };
    }
    let (n, half) = (sim.inner.len(), sim.inner.len() / 2);
    for i in 0..n {
        let (side, k) = if i < half { (-1.0, i) } else { (1.0, n - 1 - i) };
        sim.inner.x[i] = 8.0 * (k as f32 - 0.5 * half as f32);
        sim.inner.y[i] = 25.0 * side;
    }
    // The guard slows the particle down to 5 µm per step.
    sim.inner.vy[half / 3] = 80.0;
    let mut grid = sim.fork(Search::Grid, Kernel::Vector, 1);
    let mut lists = sim.fork(Search::Lists, Kernel::Vector, 2);
    for _ in 0..9 {
        lists.step().unwrap();
        grid.step().unwrap();
        assert!(lists.checkpoint() == grid.checkpoint(), "at step {}", lists.time());
    }
    assert_eq!(lists.statistics().list_builds, 1, "all lists were made anew");
    let is_pushed = (half..n).any(|i| lists.inner.y[i] > 25.0 + 1e-3);
    assert!(is_pushed, "the other strand was not met: the test shows nothing");
}

#[test]
fn a_resumed_simulation_continues_as_if_never_interrupted() {
    let mut sim = simulation(&json!({}), 2, 1);
    while sim.time() < 70 {
        sim.step().unwrap();
    }
    let mut resumed = CpuSimulation::resume(sim.plan.clone(), &sim.checkpoint(), 1);
    while sim.time() < 95 {
        sim.step().unwrap();
        resumed.step().unwrap();
    }
    assert!(sim.checkpoint() == resumed.checkpoint());
    assert!(sim.checkpoint().section(&sim.plan) == sim.section());
}

#[test]
fn the_scalar_kernel_goes_the_same_way() {
    let mut sim = simulation(&json!({}), 2, 1);
    run(&mut sim, |_| {});
    for (search, threads) in [(Search::AllPairs, 1), (Search::Lists, 2)] {
        let mut vector = sim.fork(Search::Lists, Kernel::Vector, 1);
        let mut scalar = sim.fork(search, Kernel::Scalar, threads);
        for _ in 0..5 {
            vector.step().unwrap();
            scalar.step().unwrap();
        }
        assert!(scalar.inner != vector.inner, "it is not another kernel");
        let far = |a: &[f32], b: &[f32]| a.iter().zip(b).fold(0f32, |m, (a, b)| m.max((a - b).abs()));
        assert!(far(&scalar.inner.x, &vector.inner.x) < 0.01);
        assert!(far(&scalar.inner.y, &vector.inner.y) < 0.01);
    }
}

#[test]
fn growth_leaves_the_contour_and_its_rest_length_unchanged() {
    let mut sim = simulation(&json!({}), 1, 1);
    run(&mut sim, |_| {});
    let mut row = *sim.plan.at(10);
    row.inner_target = sim.inner.len() as u32 + 100;
    let length = |s: &InnerLoop| -> f64 { s.rest.iter().map(|&r| f64::from(r)).sum() };
    let area = |s: &InnerLoop| crate::geometry::polygon::signed_area(&s.ring(1.0).points);
    let (rest, before) = (length(&sim.inner), area(&sim.inner));
    let deferred = growth::grow_inner(&sim.plan, 10, &row, &mut sim.inner, &[]);
    assert_eq!(sim.inner.len() as u32 + deferred, row.inner_target);
    assert!((length(&sim.inner) / rest - 1.0).abs() < 1e-6);
    assert!((area(&sim.inner) / before - 1.0).abs() < 1e-5);
}

/// Specification of a simulation without variety around the wall, except for the members of `of`.
fn with_variety(of: &Value) -> Value {
    let mut variety = json!({ "asymmetry": 0, "height": 0, "thickness": 0, "shift": 0, "waves": 6, "drift": 0 });
    json_patch::merge(&mut variety, of);
    json!({ "variety": variety, "variation": { "amplitude": 0 } })
}

#[test]
fn asymmetry_makes_the_mucosa_longer_on_one_side() {
    let mean_anchor = |asymmetry: f64| {
        let mut sim = simulation(&with_variety(&json!({ "asymmetry": asymmetry })), 3, 1);
        run(&mut sim, |_| {});
        let mean = |of: &[f32]| of.iter().map(|&x| f64::from(x)).sum::<f64>() / of.len() as f64;
        let phase = sim.plan.modes.first().map(|mode| std::f64::consts::TAU * mode.phases[0]);
        ([mean(&sim.inner.anchor_x), mean(&sim.inner.anchor_y)], phase)
    };
    let ([x, y], none) = mean_anchor(0.0);
    assert!(none.is_none() && x.hypot(y) < 0.05, "{x} {y}");
    let ([x, y], phase) = mean_anchor(0.6);
    // The maximum of cos(θ + phase) is at −phase. A density of particles that grows by exp(0.6 cos
    // θ) results in 0.36 when there are four times as many.
    let along = x * phase.unwrap().cos() - y * phase.unwrap().sin();
    assert!(along > 0.2 && along < 0.45 && along / x.hypot(y) > 0.95, "{x} {y} {along}");
}

#[test]
fn folds_of_different_thickness_have_ranges_that_follow_their_angle() {
    let mut sim = simulation(&with_variety(&json!({ "thickness": 0.3 })), 4, 1);
    run(&mut sim, |_| {});
    let s = &sim.inner;
    let logs: Vec<f64> = s.scale.iter().map(|&scale| f64::from(scale).ln()).collect();
    let mean = logs.iter().sum::<f64>() / logs.len() as f64;
    let deviation = (logs.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / logs.len() as f64).sqrt();
    assert!(deviation > 0.15 && deviation < 0.45, "{deviation}");
    assert!(logs.iter().all(|x| x.abs() <= 0.6 + 1e-6), "more than two standard deviations");
    // Particles with the same anchor have the same range.
    let mut by_angle: Vec<(f64, f64)> =
        (0..s.len()).map(|i| (f64::from(s.anchor_y[i]).atan2(f64::from(s.anchor_x[i])), logs[i])).collect();
    by_angle.sort_by(|a, b| a.0.total_cmp(&b.0));
    let jump =
        by_angle.windows(2).filter(|w| w[1].0 - w[0].0 < 1e-3).map(|w| (w[1].1 - w[0].1).abs()).fold(0.0, f64::max);
    assert!(jump < 0.01, "{jump}");
}

#[test]
fn a_shift_acts_only_where_the_schedules_change() {
    let mut patch = with_variety(&json!({ "shift": 10.0 / 150.0 }));
    let change = json!({ "keys": [[0, 60], [0.4, 60], [0.6, 30], [1, 30]] });
    json_patch::merge(&mut patch, &json!({ "collision": { "tissue_um": change, "gap_um": change } }));
    let mut sim = simulation(&patch, 6, 1);
    let mut spreads = Vec::new();
    run(&mut sim, |sim| {
        let (low, high) = sim.inner.scale.iter().fold((f32::MAX, f32::MIN), |(l, h), &s| (l.min(s), h.max(s)));
        spreads.push((sim.time(), high / low));
    });
    let at = |time: i64| spreads.iter().find(|of| of.0 == time).unwrap().1;
    // The last event was at step 70. Half of the change from 60 µm at step 60 to 40 µm at step 80
    // is 0.2 per standard deviation.
    assert!(at(75) > 1.3 && at(75) < 2.5, "{}", at(75));
    for constant in [20, 130] {
        assert!((at(constant) - 1.0).abs() < 1e-6, "{}", at(constant));
    }
}

#[test]
fn splits_wait_where_there_is_no_room() {
    let mut sim = simulation(&json!({}), 1, 1);
    run(&mut sim, |_| {});
    let mut row = *sim.plan.at(10);
    row.inner_target = sim.inner.len() as u32 + 50;
    let (n, touching) = (sim.inner.len(), vec![0.1; sim.inner.len()]);
    assert_eq!(growth::grow_inner(&sim.plan, 10, &row, &mut sim.inner, &touching), 50);
    assert_eq!(sim.inner.len(), n);
}

#[test]
fn a_free_loop_comes_to_rest() {
    // Without growth, contortion, sway and variety, friction removes all motion.
    let mut patch = with_variety(&json!({}));
    json_patch::merge(
        &mut patch,
        &json!({
            "steps": 2500, "sway": { "strength": 0 }, "particles": { "total": 300, "outer": 60 },
            "contortion": { "magnitude": 0 },
        }),
    );
    let mut sim = simulation(&patch, 2, 1);
    let speed = |s: &CpuSimulation| s.inner.vx.iter().chain(&s.inner.vy).fold(0f32, |m, v| m.max(v.abs()));
    run(&mut sim, |_| {});
    assert!(speed(&sim) < 0.05, "still moving at {} µm a step", speed(&sim));
}

#[test]
fn not_a_number_is_an_error_not_a_model() {
    let mut sim = simulation(&json!({}), 1, 1);
    sim.inner.x[3] = f32::NAN;
    assert_eq!(sim.step(), Err(SimError::NotFinite { step: -59 }));
}

/// Directions of anchors in turns.
fn turns(s: &InnerLoop) -> Vec<f64> {
    let turn = |(&x, &y): (&f32, &f32)| (f64::from(y).atan2(f64::from(x)) / std::f64::consts::TAU).rem_euclid(1.0);
    s.anchor_x.iter().zip(&s.anchor_y).map(turn).collect()
}

#[test]
fn clefts_are_far_from_each_other_at_any_number() {
    for seed in 1..20 {
        let plan = simulation(&json!({ "primary": { "clefts": 40 } }), seed, 1).plan;
        let turns: Vec<f64> = plan.clefts.iter().map(|&[x, y]| f64::from(y).atan2(f64::from(x))).collect();
        assert_eq!(turns.len(), 40);
        for count in 2..=40 {
            let mut first = turns[..count].to_vec();
            first.sort_by(f64::total_cmp);
            let gap = |k: usize| (first[(k + 1) % count] - first[k]).rem_euclid(std::f64::consts::TAU);
            let least = (0..count).map(gap).fold(f64::INFINITY, f64::min) * count as f64 / std::f64::consts::TAU;
            assert!(least > 0.25, "seed {seed}: two of {count} clefts are {least} of the mean distance apart");
        }
    }
}

#[test]
fn shares_of_clefts_follow_the_distance_along_the_wall() {
    let mut sim = simulation(&json!({ "primary": { "clefts": 2.4, "width_um": 40 } }), 3, 1);
    let (row, plan) = (*sim.plan.at(sim.time), sim.plan.clone());
    let share = |direction: [f32; 2], sim: &mut CpuSimulation| {
        (sim.inner.anchor_x[0], sim.inner.anchor_y[0]) = (direction[0], direction[1]);
        clefts::update(&plan, sim.time, &mut sim.inner);
        sim.inner.cleft[0]
    };
    for (cleft, expected) in plan.clefts.iter().zip([1.0, 1.0, 0.4]) {
        assert!((share(*cleft, &mut sim) - expected).abs() < 1e-6);
    }
    // 40 µm along the wall from the bottom of the first cleft.
    let [x, y] = plan.clefts[0].map(f64::from);
    let (sin, cos) = (40.0 / f64::from(row.r_in)).sin_cos();
    let aside = share([(x * cos - y * sin) as f32, (x * sin + y * cos) as f32], &mut sim);
    assert!((aside - (-1f32).exp()).abs() < 1e-3, "{aside}");
}

#[test]
fn primary_folds_stand_on_the_wall_between_clefts() {
    let grown = |primary: &Value| {
        let mut sim = simulation(&json!({ "primary": primary, "regulatory": { "strength": 0 } }), 8, 1);
        run(&mut sim, |_| {});
        sim
    };
    let none = grown(&json!({}));
    assert!(none.plan.clefts.is_empty() && none.inner.cleft.iter().all(|&share| share == 0.0));
    let with = grown(&json!({ "clefts": 6, "hold": 1, "width_um": 20, "guide": 0.3, "reach_um": 40 }));
    // Anchors keep their order around the loop: one turn in all.
    let turns = turns(&with.inner);
    let steps = turns.iter().zip(turns.iter().cycle().skip(1)).map(|(a, b)| (b - a + 0.5).rem_euclid(1.0) - 0.5);
    assert!(steps.clone().all(|step| step >= -1e-6), "anchors go back");
    assert!((steps.sum::<f64>() - 1.0).abs() < 1e-6);
    // At each cleft the mucosa lies at the wall.
    let s = &with.inner;
    let row = with.plan.at(with.time);
    let at_wall = |&[x, y]: &[f32; 2]| {
        let nearest = (0..s.len()).max_by(|&a, &b| {
            let along = |i: usize| s.anchor_x[i] * x + s.anchor_y[i] * y;
            along(a).total_cmp(&along(b))
        });
        nearest.map_or(0.0, |i| s.x[i].hypot(s.y[i] / row.squash) / row.r_in)
    };
    let reached: Vec<f32> = with.plan.clefts.iter().map(at_wall).collect();
    assert!(reached.iter().all(|&share| share > 0.8), "{reached:?}");
}

#[test]
fn compressed_edges_and_clefts_grow_less() {
    let grown = |patch: &Value| {
        let mut whole =
            json!({ "primary": { "clefts": 5, "width_um": 60, "spare": 0 }, "particles": { "tip_weight": 0 } });
        json_patch::merge(&mut whole, patch);
        let mut sim = simulation(&whole, 9, 1);
        run(&mut sim, |_| {});
        sim.inner
    };
    let share = |s: &InnerLoop| s.cleft.iter().filter(|&&share| share > 0.5).count() as f64 / s.len() as f64;
    let (even, spared) = (grown(&json!({})), grown(&json!({ "primary": { "spare": 1 } })));
    assert!(share(&spared) < 0.75 * share(&even), "{} and {}", share(&spared), share(&even));
    assert_ne!(grown(&json!({ "particles": { "room_weight": 10 } })).id.len(), 0);
}
